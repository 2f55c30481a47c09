"""From recorded logs to a model: least squares on the operator's own states, judged on data left out."""

from __future__ import annotations

from dbo_cli.hysteresis.identification.identify import identify
from dbo_cli.hysteresis.identification.recordings import (
    IdentificationOptions,
    Recording,
)
from dbo_cli.hysteresis.identification.static import Identification

__all__ = ["Identification", "IdentificationOptions", "Recording", "identify"]
