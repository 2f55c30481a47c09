"""A drive at another number of points or another rate, and by how much that moves it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError

Floats = NDArray[np.float64]
WHOLE = 1e-6  # of a point: stamps of a file are rounded to some microseconds of their step


class Points(NamedTuple):
    """Signals as they are played.

    Attributes
    ----------
    volts : array of shape (channels, points)
    rate : float
        Points a second.
    moved : float
        The largest difference, at the drive's own rows, from what it was.
    held : int
        Points at the end that only repeat the last value.
    """

    volts: Floats
    rate: float
    moved: float = 0.0
    held: int = 0


def at_points(drive: Floats, rate: float, points: int | None, new_rate: float | None, loop: bool) -> Points:
    """Return signals at so many points, or at another rate, over the same time; linear between rows.

    Parameters
    ----------
    drive
        Signals of shape (channels, rows).
    rate
        Their rows a second.
    points, new_rate
        Points wanted, and points a second; with both, the last value fills what is left.
    loop
        The signals repeat: their time is one row longer, and nothing can be filled up.

    Raises
    ------
    UsageError
        The time is no whole number of points, or needs more than there are.
    """
    rows = drive.shape[1]
    seconds = (rows if loop else rows - 1) / rate
    count = points or rows
    if new_rate is not None:
        exact = seconds * new_rate
        count = math.ceil(exact - WHOLE) + (0 if loop else 1)
        fitting = points or max(round(exact), 2)
        if loop and (abs(exact - round(exact)) > WHOLE * max(1.0, exact) or count != (points or count)):
            raise UsageError(
                f"`rate` {new_rate:g}: the loop of {seconds:.6g} s is {exact:.6g} points (a `rate` of "
                f"{fitting / seconds:.9g} makes {fitting:,})"
            )
        if points is not None and count > points:
            raise UsageError(
                f"`points` {points:,}: the drive takes {count:,} at {new_rate:g} a second (leave `rate` out, "
                f"or at most {(points - 1) / seconds:.6g})"
            )
    elif count < 2:
        raise UsageError(f"`points` {count}: a drive needs two")
    else:
        new_rate = (count if loop else count - 1) / seconds if count != rows else rate
    held = 0 if points is None else points - count
    if count == rows and abs(new_rate / rate - 1.0) < WHOLE / count:
        found, moved = drive, 0.0
    else:
        own, new = np.arange(rows) / rate, np.arange(count) / new_rate
        period = seconds if loop else None
        found = np.stack([np.interp(new, own, one, period=period) for one in drive])
        back = np.stack([np.interp(own, new, one, period=period) for one in found])
        moved = float(np.abs(back - drive).max())
    return Points(np.pad(found, ((0, 0), (0, held)), mode="edge"), new_rate, moved, held)
