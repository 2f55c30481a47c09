"""Identification: from recordings to a model."""

from dbo_cli.identification.figures import describe
from dbo_cli.identification.identify import identify
from dbo_cli.identification.recording import Options, Recording

__all__ = ["Options", "Recording", "describe", "identify"]
