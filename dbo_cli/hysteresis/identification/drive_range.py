"""The range of a drive from its recordings: its ends, without the noise with which they were read back.

The least and the greatest of noisy readings lie outside what the amplifier gave: a
model that took them for its range would send a unipolar amplifier below zero. So the
drive is found in each row from parabolas through the rows before it and behind it,
which may meet in a corner. Where readings have no noise, every digit of their least and
greatest is kept.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.hysteresis.identification.cleaning import OF_NORMAL
from dbo_cli.hysteresis.identification.recordings import Floats, Integers, Recording
from dbo_cli.hysteresis.move_error import turning_points

# rows: the standard deviation of noise is known to a tenth from so many
FEWEST_READINGS = 200
# of the differences that are compared: a smooth drive is far smaller in the second
ORDERS = (4, 10)
# ratio of white noise by the two orders; a sine of a third of the rate has 0.53
ALIKE = (0.7, 1.4)
MOST_NOISE = 0.05  # of the range: a larger scatter is the drive itself
LEAST_NOISE = 1e-9  # of the range: less is the rounding of a computed drive
# of the rows: so many readings turn where the drive does not; by rounding none does
REVERSALS = 0.01
TURN = 8.0  # standard deviations of the noise: a turn of the drive, not of the noise

# rows of a parabola; longer ones say no more than is asked for
SHORTEST, LONGEST = 4, 1 << 12
# standard errors within which a longer parabola agrees with each shorter one
AGREE = 1.0
SURE = 2.0  # standard errors by which a level is known, where the highest is looked for
SAME = 2.0  # standard errors within which a swing reaches the top as the highest does
# standard deviations of the noise: the largest step of the last digit of an end
LAST_DIGIT = 2.0


def drive_range(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the least and the greatest voltage of the drive over all logs, without read-back noise."""
    ends = [_ends(log.voltage) for log in recordings]
    lowest = min(low for low, _ in ends)
    highest = max(high for _, high in ends)
    return lowest, highest


def within(
    recordings: Sequence[Recording], ends: tuple[float, float]
) -> list[Recording]:
    """Return the logs with their voltages inside the drive's range: what lies beyond is noise."""
    return [replace(log, voltage=np.clip(log.voltage, *ends)) for log in recordings]


def read_back_noise(voltage: Floats) -> float:
    """Return the standard deviation of the noise of a recorded drive; 0 where none is evident.

    Noise is white: differences of any order tell the same standard deviation of it. So
    does rounding, but that is smaller than the distance between neighbouring levels,
    and readings do not go back and forth by it where the drive does not turn.
    """
    if len(voltage) < FEWEST_READINGS:
        return 0.0
    noise, again = (_scatter(voltage, order) for order in ORDERS)
    span = float(np.ptp(voltage))
    if not LEAST_NOISE * span < noise <= MOST_NOISE * span:
        return 0.0
    if not ALIKE[0] <= again / noise <= ALIKE[1]:
        return 0.0
    if noise < _distance_of_levels(voltage) and not _goes_back_and_forth(
        voltage, noise
    ):
        return 0.0
    return noise


def _distance_of_levels(voltage: Floats) -> float:
    """Return the usual distance between neighbours among all different readings."""
    return float(np.median(np.diff(np.unique(voltage))))


def _goes_back_and_forth(voltage: Floats, noise: float) -> bool:
    """Whether many readings turn where the drive does not."""
    steps = np.diff(voltage)
    directions = np.sign(steps[steps != 0.0])
    reversals = int(np.count_nonzero(np.diff(directions)))
    turns = len(turning_points(voltage, TURN * noise))
    return reversals - turns > REVERSALS * len(voltage)


def _scatter(voltage: Floats, order: int) -> float:
    """Return the standard deviation of white noise by the median of the differences of an order."""
    differences = np.abs(np.diff(voltage, order))
    return (
        OF_NORMAL
        * float(np.median(differences))
        / math.sqrt(math.comb(2 * order, order))
    )


def _ends(voltage: Floats) -> tuple[float, float]:
    """Return both ends of one log's drive."""
    lowest, highest = float(voltage.min()), float(voltage.max())
    noise = read_back_noise(voltage)
    if noise == 0.0:
        return lowest, highest
    low = max(_rounded(-_top(-voltage, noise), noise), lowest)
    high = min(_rounded(_top(voltage, noise), noise), highest)
    return (low, high) if low < high else (lowest, highest)


def _top(voltage: Floats, noise: float) -> float:
    """Return the greatest voltage of the drive.

    Every second row says where the drive is highest, and the rows in between, whose
    noise is another, say how high that is; then the other way round.
    """
    rows = len(voltage) // 2
    halves = [voltage[0 : 2 * rows : 2], voltage[1 : 2 * rows : 2]]
    known = [_levels(half, noise) for half in halves]
    tops, weights = [], []
    for finding, telling in ((0, 1), (1, 0)):
        at = _highest_rows(halves[finding], noise, *known[finding])
        level, error = known[telling]
        weight = error[at] ** -2.0
        tops.append(float(level[at] @ weight / weight.sum()))
        weights.append(float(weight.sum()))
    top = float(np.average(tops, weights=weights))
    # So many readings above it are higher by noise alone: a drive of few rows a turn is
    # seen better so.
    above = max(int(np.count_nonzero(voltage > top)), 1)
    by_noise = noise * math.sqrt(2.0 * math.log(above))
    return max(top, float(voltage.max()) - by_noise)


def _highest_rows(
    voltage: Floats, noise: float, level: Floats, error: Floats
) -> Integers:
    """Return the row in which each swing is highest, for the swings that reach the top."""
    turns = turning_points(voltage, TURN * noise)
    lows = turns[voltage[turns] < voltage.mean()]
    edges = np.unique(np.concatenate(([0], lows, [len(voltage)])))
    sure = level - SURE * error
    swings = itertools.pairwise(edges.tolist())
    rows = np.asarray(
        [begin + int(np.argmax(sure[begin:end])) for begin, end in swings]
    )
    best = rows[np.argmax(sure[rows])]
    below = level[best] - level[rows]
    as_high: Integers = rows[below <= SAME * np.hypot(error[rows], error[best])]
    return as_high


def _levels(voltage: Floats, noise: float) -> tuple[Floats, Floats]:
    """Return the drive in each row without noise, and its standard error; both have shape (samples,)."""
    before, error_before = _one_sided(voltage, noise)
    after, error_after = (values[::-1] for values in _one_sided(voltage[::-1], noise))
    weight_before, weight_after = error_before**-2.0, error_after**-2.0
    weight = weight_before + weight_after
    level: Floats = (weight_before * before + weight_after * after) / weight
    return level, weight**-0.5


def _one_sided(voltage: Floats, noise: float) -> tuple[Floats, Floats]:
    """Return the end of a parabola through the readings up to each row, and its standard error.

    A parabola is as long as its end agrees with those of all shorter ones (Lepski's
    rule).
    """
    from scipy.signal import oaconvolve

    middle = float(voltage.mean())
    readings = voltage - middle
    level, error = readings.copy(), np.full(len(voltage), noise)
    lowest, highest = readings - AGREE * noise, readings + AGREE * noise
    growing = np.ones(len(voltage), bool)
    rows = SHORTEST
    while rows <= min(LONGEST, len(voltage)):
        weights = _weights_of_the_end(rows)
        end = oaconvolve(readings, weights[::-1], mode="full")[: len(voltage)]
        end_error = noise * float(np.sqrt(weights @ weights))
        np.maximum(lowest, end - AGREE * end_error, out=lowest)
        np.minimum(highest, end + AGREE * end_error, out=highest)
        growing &= lowest <= highest
        growing[: rows - 1] = False
        level[growing] = end[growing]
        error[growing] = end_error
        rows *= 2
    return level + middle, error


def _weights_of_the_end(rows: int) -> Floats:
    """Return the weights of so many readings in the end of the parabola through them."""
    place = np.linspace(-1.0, 1.0, rows)
    columns = np.column_stack((np.ones(rows), place, place**2))
    weights: Floats = columns @ np.linalg.solve(columns.T @ columns, columns[-1])
    return weights


def _rounded(level: float, noise: float) -> float:
    """Return a level with the digits that noise leaves of it; the last is a multiple of 1, 2 or 5.

    None is left of a level that noise does not tell from 0.
    """
    largest = LAST_DIGIT * noise
    if abs(level) < largest:
        return 0.0
    exponent = math.floor(math.log10(largest))
    factor = max(
        factor
        for factor in (1, 2, 5)
        if factor == 1 or factor * 10.0**exponent <= largest
    )
    steps = round(level / (factor * 10.0**exponent))
    return float(f"{steps * factor}e{exponent}")
