"""The phase of a log and what is known about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

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
        One for each inner turn of the drive; none of two photodiodes, whose phase needs
        no drive.
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


def joined(tracks: Sequence[Track]) -> Track:
    """Return the tracks of parts as one; each begins within half a turn of where the one before ended."""
    phases = [tracks[0].phase]
    turns = list(tracks[0].turns)
    rows = tracks[0].phase.size
    for track in tracks[1:]:
        whole = np.round((phases[-1][-1] - track.phase[0]) / (2.0 * np.pi))
        phases.append(track.phase + 2.0 * np.pi * whole)
        turns += [replace(turn, row=turn.row + rows) for turn in track.turns]
        rows += track.phase.size
    channels = [
        _joined_channel(same)
        for same in zip(*(track.channels for track in tracks), strict=True)
    ]
    return Track(
        np.concatenate(phases),
        np.concatenate([track.deviation for track in tracks]),
        turns,
        max(track.noise for track in tracks),
        channels,
        min(track.rounds for track in tracks),
        sum(track.clipped for track in tracks),
    )


def _joined_channel(parts: Sequence[Channel]) -> Channel:
    """Return what a photodiode shows in parts as one, with the largest noise."""
    arrays = {}
    for field in fields(Channel):
        if field.name != "noise":
            arrays[field.name] = np.concatenate(
                [getattr(part, field.name) for part in parts]
            )
    return Channel(**arrays, noise=max(part.noise for part in parts))
