"""Drives: what an amplifier may do, the drive of a move, and the gate that every row passes."""

from dbo_cli.drive.compensate import Driver
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.limits import Limits, voltage_in

__all__ = ["Drive", "Driver", "Lead", "Limits", "voltage_in"]
