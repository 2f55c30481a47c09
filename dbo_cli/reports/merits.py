"""Figures of merit: how well one signal follows another.

The error is *measured - desired* throughout, in the unit of the two signals. A positive
``loop_width`` lags behind; ``p95_abs`` is the magnitude that 95 % of the errors stay below.
"""

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.reports.pair import Pair
from dbo_cli.reports.words import digits
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

SAME_MOVE = 0.01
"""Part of the move by which the ends of a summary's move may differ from the log's."""
BEYOND_EXPECTED = 2.0
"""Times the expected error, from which on a warning says so."""


def merits(pair: Pair, lag: int = 0, remove_offset: bool = False) -> dict[str, Any]:
    """Return how well measured follows desired, under the keys of the JSON form of a report.

    Lengths are in the signals' unit, rows are counted from 1 in the file. None: not
    defined (no move, no clock), or not known.

    Parameters
    ----------
    pair
        At least one row, all finite.
    lag
        Rows by which measured was taken later.
    remove_offset
        Take the mean error off before anything is said about it.
    """
    desired, time, step = pair.desired, pair.time, pair.step
    error = pair.measured - desired
    offset = 0.0
    if remove_offset:
        offset = float(np.mean(error))
        error = error - offset
    magnitude = np.abs(error)
    largest = int(np.argmax(magnitude))
    low, high = float(desired.min()), float(desired.max())
    rmse = math.sqrt(float(np.mean(np.square(error))))
    width, lag_left = loop_width(desired, error), lag_of(desired, pair.measured)
    return {
        "name": pair.name,
        "samples": len(error),
        "rmse": rmse,
        "nrmse_percent": percent_of(rmse, high - low),
        "max_abs": float(magnitude[largest]),
        "max_abs_row": pair.first_row + largest,
        "max_abs_time_s": None if time is None else float(time[largest]),
        "mean": 0.0 if remove_offset else float(np.mean(error)),
        "p95_abs": float(np.quantile(magnitude, 0.95, method="inverted_cdf")),
        "loop_width": width,
        "loop_width_percent": percent_of(width, high - low),
        "lag_left_samples": lag_left,
        "lag_left_s": None if step is None or lag_left is None else lag_left * step,
        "desired_min": low,
        "desired_max": high,
        "lag_samples": lag,
        "lag_s": None if step is None else lag * step,
        "offset_removed": offset,
        "sample_period_s": step,
        "clock_offset_s": pair.clock_offset,
        "ratio_to_first": None,
        "expected_rmse": pair.expected.rmse,
    }


def percent_of(value: float | None, span: float) -> float | None:
    """Return a value in percent of a range; None where the range is 0."""
    return None if value is None or not span > 0.0 else 100.0 * value / span


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


def lag_of(desired: Floats, measured: Floats) -> float | None:
    """Return by how many samples the measured signal follows the desired one, to a fraction.

    Hysteresis is a phase, too. None where the desired signal does not move back and
    forth, as a ramp, or where nothing of it is measured.
    """
    stride = -(-len(desired) // LAG_ROWS)
    shift = lag(measured[::stride], desired[::stride], float(stride))
    if shift is None or shift.residual > LARGEST_UNEXPLAINED:
        return None
    is_told = math.isfinite(shift.deviation) and abs(shift.seconds) < len(desired) / 4.0
    return shift.seconds if is_told else None


def excess(pair: Pair, figures: Mapping[str, Any]) -> str:
    """Return a warning where the error is far above the expected one, or that is another move's.

    The sensor's noise is no error of the actuator: it is taken out first. ``figures``
    are those of ``merits``.
    """
    expected, low, high = pair.expected, figures["desired_min"], figures["desired_max"]
    first, last = expected.move or (low, high)
    if max(abs(first - low), abs(last - high)) > SAME_MOVE * (high - low):
        return (
            f"the move is {low:.4g} to {high:.4g}, the expected error is for"
            f" {first:.4g} to {last:.4g}: use the summary of this move"
        )
    white = noise(pair.measured)
    error = math.sqrt(max(figures["rmse"] ** 2 - white**2, 0.0))
    if expected.rmse is None or error <= BEYOND_EXPECTED * expected.rmse:
        return ""
    return (
        f"the error is {error / expected.rmse:.2g} times the expected one (mean {figures['mean']:.3g}, lag "
        f"{digits(figures['lag_left_samples'], 2)} rows, largest in row {figures['max_abs_row']:,}): look at "
        "the sensor's zero and delay (`sensor_delay`), at what was before the move and at that row; else "
        "identify again"
    )
