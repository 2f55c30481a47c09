"""The phase of a log and what is known about it."""

from __future__ import annotations

from dataclasses import dataclass

from dbo_cli.extras.fringes.phase_smoother import Channel
from dbo_cli.extras.fringes.swings import Floats


@dataclass(frozen=True)
class TurnOdds:
    """A turn of the drive: its row, the odds of the branch taken, and what else it could be (fringes)."""

    row: int
    odds: float
    other: float


@dataclass(frozen=True)
class Track:
    """The phase of a log.

    Attributes
    ----------
    phase, deviation : arrays
        rad (rows).
    turns : list of TurnOdds
        One for each inner turn of the drive; none of two photodiodes, whose phase needs no drive.
    noise : float
        Of the first photodiode, in parts of the fringes' amplitude.
    channels : list of Channel
        What each photodiode shows beside the phase.
    rounds : int
        Until nothing changed; 0 where it did not come to rest.
    clipped : int
        Rows at the end of a photodiode's range, which say nothing.
    """

    phase: Floats
    deviation: Floats
    turns: list[TurnOdds]
    noise: float
    channels: list[Channel]
    rounds: int
    clipped: int
