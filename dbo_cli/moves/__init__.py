"""Moves to be followed, and drives as the files that generators take."""

from dbo_cli.moves.shapes import check_reach, trajectory
from dbo_cli.moves.waveform import side_by_side, waveform

__all__ = ["check_reach", "side_by_side", "trajectory", "waveform"]
