"""Identification: from recordings to a model."""

from dbo_cli.identify.identify import describe, identify
from dbo_cli.identify.recording import Options, Recording

__all__ = ["Options", "Recording", "describe", "identify"]
