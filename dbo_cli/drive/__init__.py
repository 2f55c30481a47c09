"""Drives: what an amplifier may do, the drive of a move, and the gate that every row passes."""

from __future__ import annotations

from dbo_cli.drive.compensate import plan, stream
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.gate import Gate, GateError
from dbo_cli.drive.learning import PassRecord, Tracked, dumps_history, parse_history
from dbo_cli.drive.limits import Limits, voltage_in

__all__ = [
    "Drive",
    "Gate",
    "GateError",
    "Limits",
    "PassRecord",
    "Tracked",
    "dumps_history",
    "parse_history",
    "plan",
    "stream",
    "voltage_in",
]
