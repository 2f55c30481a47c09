"""Moves to be followed, and drives as the files that generators take."""

from __future__ import annotations

from dbo_cli.moves.shapes import SHAPES, Trajectory, trajectory
from dbo_cli.moves.trust import check_reach, trusted_frequency
from dbo_cli.moves.waveform import Waveform, side_by_side, waveform

__all__ = [
    "SHAPES",
    "Trajectory",
    "Waveform",
    "check_reach",
    "side_by_side",
    "trajectory",
    "trusted_frequency",
    "waveform",
]
