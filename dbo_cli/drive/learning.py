"""Learning (placeholder, being written)."""

from __future__ import annotations

from typing import NamedTuple


class PassRecord(NamedTuple):
    """A pass in a history: the digest of its drive, and the RMS of its error in the output's unit."""

    drive_sha256: str
    rmse: float
