"""Figures of merit: how well one signal follows another.

The error is *measured - desired* throughout, in the unit of the two signals.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.signals import lag, noise, turns

LOOP_BINS = 32
"""Bins of the desired signal in which both directions are compared."""
FEWEST_IN_BIN = 3
"""Samples of either direction that a bin needs, lest the noise of one sample wins."""
TURN_IN_NOISE = 10.0
"""Standard deviations of the noise that a turn must exceed: 10,000 normal samples span 8."""
LARGEST_TURN = 0.1
"""Part of the range that a turn need not exceed: few samples a cycle look like noise."""
LAG_ROWS = 1 << 17
"""Rows that the lag left is looked for in, evenly picked."""
LARGEST_UNEXPLAINED = 0.5
"""Part of the measured signal's variance that a lag may leave unexplained at most."""


@dataclass(frozen=True)
class Merits:
    """How well the measured signal follows the desired one; lengths in the signals' unit.

    Attributes
    ----------
    samples
        Pairs that were compared.
    rmse, max_abs, p95_abs
        Root mean square, largest magnitude, and the magnitude that 95 % stay below.
    max_abs_index
        Index of the largest error.
    nrmse_percent
        RMSE in percent of the move, ``desired_max - desired_min``; None where it is 0.
    mean
        Mean error; 0 where it was removed.
    offset
        What was subtracted from the error beforehand.
    loop_width
        See ``loop_width``; None where no value was passed in both directions.
    lag
        See ``lag_left``, in samples; None where nothing moves back and forth.
    """

    samples: int
    rmse: float
    nrmse_percent: float | None
    max_abs: float
    max_abs_index: int
    mean: float
    p95_abs: float
    loop_width: float | None
    lag: float | None
    desired_min: float
    desired_max: float
    offset: float

    @property
    def loop_width_percent(self) -> float | None:
        """The loop's width in percent of the move."""
        if self.loop_width is None:
            return None
        return percent_of(self.loop_width, self.desired_max - self.desired_min)


def merits(desired: Floats, measured: Floats, remove_offset: bool = False) -> Merits:
    """Return the figures of merit of two signals.

    Parameters
    ----------
    desired, measured : array of shape (samples,)
        At least one sample, all finite.
    remove_offset : bool
        Take the mean error off before anything is said about it.
    """
    error = measured - desired
    offset = 0.0
    if remove_offset:
        offset = float(np.mean(error))
        error = error - offset
    magnitude = np.abs(error)
    index = int(np.argmax(magnitude))
    low, high = float(desired.min()), float(desired.max())
    rmse = math.sqrt(float(np.mean(np.square(error))))
    return Merits(
        samples=len(error),
        rmse=rmse,
        nrmse_percent=percent_of(rmse, high - low),
        max_abs=float(magnitude[index]),
        max_abs_index=index,
        mean=0.0 if remove_offset else float(np.mean(error)),
        p95_abs=float(np.quantile(magnitude, 0.95, method="inverted_cdf")),
        loop_width=loop_width(desired, error),
        lag=lag_left(desired, measured),
        desired_min=low,
        desired_max=high,
        offset=offset,
    )


def percent_of(value: float, span: float) -> float | None:
    """Return a value in percent of a range; None where the range is 0."""
    return 100.0 * value / span if span > 0.0 else None


def directions(values: Floats) -> NDArray[np.int8]:
    """Return the direction of each sample: 1 up, -1 down, 0 neither.

    A turn counts where the signal goes back by more than its noise does. Samples
    between the extreme and the place where that is certain have no direction: there the
    signal rests.
    """
    threshold = min(TURN_IN_NOISE * noise(values), LARGEST_TURN * float(np.ptp(values)))
    rows = turns(values, threshold)
    signs = np.zeros(len(values), dtype=np.int8)
    for begin, end in itertools.pairwise(rows.tolist()):
        change = values[begin + 1 : end + 1] - values[begin]
        if change.size and abs(change[-1]) > threshold:
            moving = int(np.argmax(np.abs(change) > threshold))
            signs[begin + 1 + moving : end + 1] = np.sign(change[-1])
    return signs


def loop_width(desired: Floats, error: Floats) -> float | None:
    """Return the hysteresis that is left: mean error going down less that going up, where it is largest.

    The means are taken in bins of the desired signal (IEC 61298-2: the largest
    difference between upscale and downscale readings at one input, averaged over the
    cycles). Positive: the output lags behind, as an uncompensated piezo does. A delay
    opens a loop, too. None where no bin was passed in both directions.
    """
    low, span = float(desired.min()), float(np.ptp(desired))
    if not span > 0.0:
        return None
    signs = directions(desired)
    bins = np.minimum((desired - low) / span * LOOP_BINS, LOOP_BINS - 1).astype(int)
    means = []
    counted = np.ones(LOOP_BINS, dtype=bool)
    for sign in (1, -1):
        mask = signs == sign
        counts = np.bincount(bins[mask], minlength=LOOP_BINS)
        sums = np.bincount(bins[mask], weights=error[mask], minlength=LOOP_BINS)
        means.append(sums / np.maximum(counts, 1))
        counted &= counts >= FEWEST_IN_BIN
    if not counted.any():
        return None
    widths = (means[1] - means[0])[counted]
    return float(widths[np.argmax(np.abs(widths))])


def lag_left(desired: Floats, measured: Floats) -> float | None:
    """Return by how many samples the measured signal follows the desired one, to a fraction.

    Hysteresis is a phase, too. None where the desired signal does not move back and
    forth, as a ramp, or where nothing of it is measured.
    """
    stride = -(-len(desired) // LAG_ROWS)
    shift = lag(measured[::stride], desired[::stride], float(stride))
    if (
        shift is None
        or shift.residual > LARGEST_UNEXPLAINED
        or math.isinf(shift.deviation)
    ):
        return None
    return shift.seconds if abs(shift.seconds) < len(desired) / 4.0 else None
