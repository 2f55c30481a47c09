"""Identification: from recordings to a model."""

from dbo_cli.identify.figures import describe
from dbo_cli.identify.identify import identify
from dbo_cli.identify.recording import Options, Recording

__all__ = ["Options", "Recording", "describe", "identify"]
