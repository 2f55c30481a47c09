"""Where nobody can count the fringes: a dark beam, a gap in the record, a mirror that moves by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dbo_cli.extras.fringes.light import dark_parts, percentile_ends
from dbo_cli.extras.fringes.swings import (
    Floats,
    crossings,
    drive_threshold,
    turning_points,
)

STILL = 0.05
"""Of the drive's way for half a fringe, which a drive that stands still does not leave. At a rest it does so
for twice the time that half a fringe usually takes, or longer; at a turn it does not
stay so long.
"""


GAP = 10.0
"""Usual steps of the time; in a longer one, that takes as long as half a fringe does on average, fringes may
have gone by.
"""


@dataclass(frozen=True)
class Break:
    """Rows that are left out: the first of them, the one behind the last, and why, in words."""

    first: int
    behind: int
    why: str


def record_breaks(time: Floats, signals: Sequence[Floats]) -> list[Break]:
    """Return the breaks that are seen in the record alone: dark beams, and gaps in time."""
    breaks = []
    for signal in signals:
        for first, behind in dark_parts(signal):
            breaks.append(
                Break(first, behind, f"the beam was interrupted at {time[first]:.6g} s")
            )
    steps = np.diff(time)
    longest = max(_seconds_a_half(time, signals[0]), GAP * float(np.median(steps)))
    for row in np.flatnonzero(steps > longest).tolist():
        why = f"nothing was recorded from {time[row]:.6g} s to {time[row + 1]:.6g} s"
        breaks.append(Break(row + 1, row + 1, why))
    return sorted(breaks, key=lambda gap: (gap.first, gap.behind))


def rest_breaks(time: Floats, drive: Floats, signal: Floats) -> list[Break]:
    """Return the rests of the drive in which the light goes through the middle of a fringe.

    There the mirror moves by itself (creep, or warmth), in a direction that one
    photodiode does not show.
    """
    places = _crossings(signal)
    if places.size < 2:
        return []
    turns = drive[turning_points(drive, drive_threshold(drive))]
    volts = float(np.abs(np.diff(turns)).sum()) / places.size
    rows = max(round(time.size / places.size), 1)
    highest = maximum_filter1d(drive, rows, mode="nearest")
    lowest = minimum_filter1d(drive, rows, mode="nearest")
    still = highest - lowest < STILL * volts
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    breaks = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - begin < rows:
            continue
        first = max(begin - rows // 2, 0)
        behind = min(end + rows // 2, time.size)
        passed = int(np.count_nonzero((places >= first) & (places < behind)))
        if passed > 0:
            during = f"{time[first]:.6g} s to {time[behind - 1]:.6g} s"
            halves = "half a fringe" if passed == 1 else f"some {passed} half fringes"
            why = f"the mirror moved by itself by {halves} while the drive stood still, {during}"
            breaks.append(Break(first, behind, why))
    return breaks


def _crossings(signal: Floats) -> Floats:
    """Return where a signal crosses the middle between its ends, in rows."""
    low, high = percentile_ends(signal)
    middle = np.full(signal.size, 0.5 * (low + high))
    amplitude = np.full(signal.size, max(0.5 * (high - low), 1e-300))
    return crossings(signal, middle, amplitude)[0]


def _seconds_a_half(time: Floats, signal: Floats) -> float:
    """Return how long half a fringe takes on average (s)."""
    count = _crossings(signal).size
    return float(time[-1] - time[0]) / max(count, 1)
