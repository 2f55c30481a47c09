"""Where a drive turns, and where a signal crosses the middle of its fringes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

SMALLEST_SWING = 0.005
"""Of the drive's range: a shorter way back is no turn."""
NOISE_FACTOR = 6.0
"""Standard deviations of the drive's noise: a shorter way back is no turn."""
SCHMITT_LEVEL = 0.35
"""Of the amplitude, either side of the middle: a crossing goes from beyond one to beyond the other.

Three and a half standard deviations of a noise of 10 %.
"""


KINK_REACH = 4
"""Rows to either side over which a drive's second differences are taken."""


def noise_of(values: Floats) -> float:
    """Return the standard deviation of a signal's white noise, from its second differences.

    The median of their magnitudes; where more than half are 0, the noise counts as 0.
    """
    if values.size < 3:
        return 0.0
    second = np.abs(np.diff(values, 2))
    return float(np.median(second) / (0.6745 * np.sqrt(6.0)))


def turning_points(drive: Floats, threshold: float) -> Indices:
    """Return the rows of a drive's turns, its first and last row included.

    A turn is an extreme from which the drive comes back by more than ``threshold``. Of
    equal values the first counts.
    """
    values = drive.tolist()
    turns = [0]
    low = high = 0
    direction = 0
    for row, value in enumerate(values):
        if value > values[high]:
            high = row
        if value < values[low]:
            low = row
        if direction >= 0 and values[high] - value > threshold:
            if direction > 0 or high > 0:
                turns.append(high)
            direction = -1
            low = row
            high = row
        elif direction <= 0 and value - values[low] > threshold:
            if direction < 0 or low > 0:
                turns.append(low)
            direction = 1
            low = row
            high = row
    last = len(values) - 1
    if turns[-1] != last:
        turns.append(last)
    return np.array(turns, dtype=np.intp)


def drive_threshold(drive: Floats) -> float:
    """Return the way back that makes a turn of a drive."""
    return max(SMALLEST_SWING * float(np.ptp(drive)), NOISE_FACTOR * noise_of(drive))


def crossings(
    signal: Floats, middle: Floats, amplitude: Floats
) -> tuple[Floats, NDArray[np.int_]]:
    """Return where a signal crosses its middle, in rows and parts of rows, and +1 (rises) or -1 (falls).

    A crossing counts when the signal goes from beyond one of two levels,
    ``SCHMITT_LEVEL`` of the amplitude either side, to beyond the other: noise that is
    smaller makes none.
    """
    height = (signal - middle) / amplitude
    beyond = np.where(
        height > SCHMITT_LEVEL, 1, np.where(height < -SCHMITT_LEVEL, -1, 0)
    )
    rows = np.flatnonzero(beyond)
    sides = beyond[rows]
    changes = np.flatnonzero(np.diff(sides))
    before = rows[changes]
    after = rows[changes + 1]
    rise = height[after] - height[before]
    places = before - height[before] / rise * (after - before)
    slopes = np.where(rise > 0.0, 1, -1)
    return np.asarray(places, dtype=np.float64), slopes


def kinks_of(drive: Floats, fringes_a_volt: float) -> Floats:
    """Return how sharply the phase may turn because the drive does, rad^2 (rows).

    The square of the drive's second difference, in phase; the largest within
    ``KINK_REACH`` rows, since the displacement turns a little later.
    """
    reach = min(KINK_REACH, (drive.size - 1) // 2)
    second = np.zeros(drive.size)
    if reach < 1:
        return second
    bent = drive[2 * reach :] - 2.0 * drive[reach:-reach] + drive[: -2 * reach]
    second[reach:-reach] = np.abs(bent) / reach**2
    sharp = 2.0 * np.pi * fringes_a_volt * second
    wide: Floats = maximum_filter1d(sharp, 2 * reach + 1, mode="nearest") ** 2
    return wide
