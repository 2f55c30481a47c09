"""Half-cosine swings of a voltage: at rest where they turn, and never beyond their turns."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dbo_cli.arrays import Floats

WHOLE = 1e-9  # of a row: what rounding may add to a number of rows


def swings(turns: Sequence[float], rows: Sequence[int]) -> Floats:
    """Return half-cosine swings through ``turns``, in order; swing i takes ``rows[i]`` steps."""
    voltage = np.empty(1 + sum(rows))
    voltage[0] = turns[0]
    row = 1
    for begin, end, count in zip(turns[:-1], turns[1:], rows, strict=True):
        swing = voltage[row : row + count]
        phase = np.pi * np.arange(1, count + 1) / count
        swing[:] = begin + (end - begin) * (0.5 - 0.5 * np.cos(phase))
        np.clip(swing, min(begin, end), max(begin, end), out=swing)
        swing[-1:] = end
        row += count
    return voltage


def swing_rows(
    distance: float, dt: float, seconds: float, slew: float | None = None
) -> int:
    """Return the steps of a swing that takes ``seconds``, or longer where the slew is limited.

    The steepest part of a swing rises by pi/2 times its mean slope.
    """
    if slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / slew)
    return max(math.ceil(seconds / dt - WHOLE), 1)


def soft_rise(t: Floats) -> Floats:
    """Return a rise from 0 at t = 0 to 1 at t = 1; speed and acceleration are zero at either end."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
