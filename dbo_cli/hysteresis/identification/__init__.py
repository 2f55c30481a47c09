"""From recorded logs to a model: least squares on the operator's own states, judged on data left out."""

from __future__ import annotations

from dbo_cli.hysteresis.identification.identify import Identification
from dbo_cli.hysteresis.identification.methods import identify
from dbo_cli.hysteresis.identification.recordings import (
    IdentificationOptions,
    Recording,
)

__all__ = ["Identification", "IdentificationOptions", "Recording", "identify"]
