"""Figures of merit: how well one signal follows another.

The error is *measured - desired* throughout, in the unit of the two signals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats

LOOP_BINS = 32
"""Bins of the desired signal in which both directions are compared."""
FEWEST_IN_BIN = 3
"""Samples of either direction that a bin needs, lest the noise of one sample wins."""
TURN_IN_NOISE = 10.0
"""Standard deviations of the noise that a turn must exceed: 10,000 normal samples span 8."""
LARGEST_TURN = 0.1
"""Part of the range that a turn need not exceed: few samples a cycle look like noise."""
SECOND_DIFFERENCE = math.sqrt(math.pi / 2.0) / math.sqrt(6.0)
"""Standard deviation of white noise over the mean |second difference| of it."""
MOTION_IN_NOISE = 20.0
"""Standard deviations that the signal moves between two points of a slope (1 % of dilution)."""
MOTION_IN_RANGE = 1.0 / 16.0
"""Part of the range that is enough for a slope, whatever the noise."""


@dataclass(frozen=True)
class Merits:
    """How well the measured signal follows the desired one; lengths in the signals' unit.

    Attributes
    ----------
    samples
        Pairs that were compared.
    rmse, max_abs, p95_abs
        Root mean square, largest magnitude, and the magnitude that 95 % stay below.
    max_abs_place
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
    max_abs_place: int
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
    place = int(np.argmax(magnitude))
    low, high = float(desired.min()), float(desired.max())
    rmse = math.sqrt(float(np.mean(np.square(error))))
    return Merits(
        samples=len(error),
        rmse=rmse,
        nrmse_percent=percent_of(rmse, high - low),
        max_abs=float(magnitude[place]),
        max_abs_place=place,
        mean=0.0 if remove_offset else float(np.mean(error)),
        p95_abs=float(np.quantile(magnitude, 0.95, method="inverted_cdf")),
        loop_width=loop_width(desired, error),
        lag=lag_left(desired, measured),
        desired_min=low,
        desired_max=high,
        offset=offset,
    )


def percent_of(value: float, whole: float) -> float | None:
    """Return a value in percent of a range; None where the range is 0."""
    return 100.0 * value / whole if whole > 0.0 else None


def noise_of(values: Floats) -> float:
    """Return the standard deviation of what changes from sample to sample; 0 for fewer than three."""
    if len(values) < 3:
        return 0.0
    return SECOND_DIFFERENCE * float(np.mean(np.abs(np.diff(values, 2))))


def directions(values: Floats) -> NDArray[np.int8]:
    """Return the direction of each sample: 1 up, -1 down, 0 neither.

    A turn counts where the signal goes back by more than its noise does. Samples
    between the extreme and the place where that is certain have no direction: there the
    signal rests.
    """
    signs = np.zeros(len(values), dtype=np.int8)
    span = float(np.ptp(values))
    least = min(TURN_IN_NOISE * noise_of(values), LARGEST_TURN * span)
    sign = 0
    low = high = extreme = float(values[0])
    begin = last = 0  # of the direction that goes on, and its extreme
    for place in turning_places(values).tolist():
        value = float(values[place])
        if sign == 0:
            low, high = min(low, value), max(high, value)
            if value - low > least:
                sign, extreme, last = 1, value, place
            elif high - value > least:
                sign, extreme, last = -1, value, place
        elif sign * (value - extreme) >= 0.0:
            extreme, last = value, place
        elif sign * (extreme - value) > least:
            signs[begin : last + 1] = sign
            back = np.abs(values[last + 1 : place + 1] - extreme)
            begin = last + 1 + int(np.argmax(back > least))
            sign, extreme, last = -sign, value, place
    if sign != 0:
        signs[begin : last + 1] = sign
    return signs


def turning_places(values: Floats) -> NDArray[np.int64]:
    """Return both ends and the places where the sign of the step changes."""
    if len(values) < 2:
        return np.arange(len(values))
    step = np.sign(np.diff(values))
    inner = np.flatnonzero(step[1:] != step[:-1]) + 1
    return np.concatenate([[0], inner, [len(values) - 1]])


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
        taken = signs == sign
        counts = np.bincount(bins[taken], minlength=LOOP_BINS)
        sums = np.bincount(bins[taken], weights=error[taken], minlength=LOOP_BINS)
        means.append(sums / np.maximum(counts, 1))
        counted &= counts >= FEWEST_IN_BIN
    if not counted.any():
        return None
    widths = (means[1] - means[0])[counted]
    return float(widths[np.argmax(np.abs(widths))])


def lag_left(desired: Floats, measured: Floats) -> float | None:
    """Return by how many samples the measured signal follows the desired one, to a fraction.

    Measured is fitted by a desired + b slope + constant. With w the frequency of the
    desired signal (rad a sample), from the regression of its second difference on
    itself, the phase is atan2(-b sin(w h), a), and the lag is the phase over w. Exact
    for a sine; right to first order for other signals. Hysteresis is a phase, too. None
    where the desired signal does not move back and forth, as a ramp.
    """
    h = slope_spacing(desired)
    if h is None or len(desired) < 2 * h + 4:
        return None
    d = desired[h:-h] - np.mean(desired[h:-h])
    m = measured[h:-h] - np.mean(measured[h:-h])
    slope = 0.5 * (desired[2 * h :] - desired[: -2 * h])
    slope = slope - np.mean(slope)
    bend = desired[2 * h :] - 2.0 * desired[h:-h] + desired[: -2 * h]
    dd, ds, ss = np.mean(d * d), np.mean(d * slope), np.mean(slope * slope)
    dm, sm = np.mean(d * m), np.mean(slope * m)
    determinant = dd * ss - ds * ds
    curvature = float(np.mean(d * bend))
    if not determinant > 1e-12 * dd * ss or curvature >= 0.0:
        return None
    along = float((dm * ss - sm * ds) / determinant)
    across = float((sm * dd - dm * ds) / determinant)
    half_chord = 0.5 * math.sqrt(-curvature / float(dd))
    step = 2.0 * math.asin(min(1.0, half_chord))  # phase in h samples
    lag = math.atan2(-across * math.sin(step), along) / step * h
    return lag if abs(lag) < len(desired) / 4.0 else None


def slope_spacing(desired: Floats) -> int | None:
    """Return how many samples apart a slope is taken; None for a signal that rests.

    One for a smooth signal; more where it is held, rounded or noisy.
    """
    span = float(np.ptp(desired))
    changes = np.flatnonzero(np.diff(desired))
    if not span > 0.0 or not len(changes):
        return None
    h = 1
    if len(changes) > 1:
        plateau = float(np.median(np.diff(changes)))
        if plateau > 1.0:
            h = math.ceil(2.0 * plateau)
    motion = min(MOTION_IN_NOISE * noise_of(desired), MOTION_IN_RANGE * span)
    most = max(len(desired) // 8, 1)
    while h < most and np.mean(np.abs(desired[h:] - desired[:-h])) < motion:
        h *= 2
    return min(h, most)
