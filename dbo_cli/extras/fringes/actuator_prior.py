"""How an actuator follows its drive, in a few numbers: the prior that chooses branches of the phase.

Plays of the drive, bends before and after them, and lags from a swing's fraction to the
log's length. All are linear in their weights, so that a fit is one linear problem with
a Gaussian prior of the weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

RADII = (0.02, 0.05, 0.1, 0.2, 0.35, 0.55, 0.8)
"""Of half the drive's range: thresholds of the plays."""
LAGS = 8
"""Time constants, spread evenly in their logarithm."""
SHORTEST_LAG = 0.01
"""Of the median time between turns."""

PLAY_DENSITY = 2.0
"""Weight of the plays in a unit of radius; a smooth density, so that near radii share it."""
START_SHARE = 0.3
"""Of a play's weight: how far what it remembers from before the log may count."""
BEND_WEIGHT = 0.2
"""Standard deviation of a bend's weight before the fit, of half the stroke; as the next two, chosen."""
LAG_WEIGHT = 0.1
"""The same of a lag's weight."""
GAIN_WEIGHT = 3.0
"""The same of the gain."""


@dataclass(frozen=True)
class Columns:
    """The terms of an actuator at some rows.

    ``values`` (rows, terms); ``spread`` (terms), standard deviation of each weight
    before the fit, in half strokes.
    """

    values: Floats
    spread: Floats


def play(drive: Floats, radius: float, start: float) -> Floats:
    """Return a play's output; ``start`` is its output before the first row."""
    out = np.empty(drive.size)
    state = start
    for row, value in enumerate(drive.tolist()):
        if state < value - radius:
            state = value - radius
        elif state > value + radius:
            state = value + radius
        out[row] = state
    return out


def lagging(time: Floats, signal: Floats, tau: float) -> Floats:
    """Return what follows ``signal`` with a time constant, at rest at first; straight between rows."""
    out = np.empty(signal.size)
    ratio = np.maximum(np.diff(time), 1e-12 * tau) / tau
    decay = np.exp(-ratio)
    hold = -np.expm1(-ratio) / ratio
    push = signal[1:] * (1.0 - hold) + signal[:-1] * (hold - decay)
    state = float(signal[0])
    out[0] = state
    for row, (keep, add) in enumerate(
        zip(decay.tolist(), push.tolist(), strict=True), start=1
    ):
        state = keep * state + add
        out[row] = state
    return out


def normalised(values: Floats) -> Floats:
    """Return values stretched to -1 to 1."""
    middle = 0.5 * (values.max() + values.min())
    half = 0.5 * (values.max() - values.min())
    scaled: Floats = (values - middle) / half
    return scaled


def time_constants(time: Floats, turns: int) -> Floats:
    """Return the time constants of a log's lags, s: from a part of a swing to the whole log."""
    length = float(time[-1] - time[0])
    shortest = SHORTEST_LAG * length / max(turns, 1)
    return np.geomspace(shortest, length, LAGS)


def columns_of(
    time: Floats, drive: Floats, turns: int, phase: Floats | None = None
) -> Columns:
    """Return the terms of an actuator.

    Parameters
    ----------
    time, drive
        Seconds and volts of the rows.
    turns
        How many swings the log has.
    phase
        The phase of an earlier fit at the same rows: bends and lags then act on it
        instead of on the drive.
    """
    level = normalised(drive)
    terms = [level]
    spread = [GAIN_WEIGHT]
    for radius, width in zip(RADII, np.gradient(RADII), strict=True):
        weight = PLAY_DENSITY * float(width)
        settled = play(level, radius, float(level[0]))
        above = play(level, radius, float(level[0]) + radius)
        below = play(level, radius, float(level[0]) - radius)
        terms += [settled, above - settled, below - settled]
        spread += [weight, START_SHARE * weight, START_SHARE * weight]
    terms += [level**2, level**3]
    spread += [BEND_WEIGHT, BEND_WEIGHT]
    source = level
    if phase is not None:
        source = normalised(phase)
        terms += [source**2, source**3]
        spread += [BEND_WEIGHT, BEND_WEIGHT]
    for tau in time_constants(time, turns):
        terms.append(lagging(time, source, float(tau)) - source)
        spread.append(LAG_WEIGHT)
    return Columns(np.column_stack(terms), np.array(spread))
