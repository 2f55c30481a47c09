"""Phases and their standard deviations from a photodiode's rows, once the branches are known.

The phase p at the rows minimises

    sum (s - A - B cos p)^2 / noise^2 + sum (second differences of p)^2 / q:

near the ends of a fringe, where the signal says little, its neighbours decide. q is the
one under which the signal is most probable (Laplace's approximation). No model of the
actuator takes part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solveh_banded

Floats = NDArray[np.float64]

PASSES = 8
"""Gauss-Newton passes at most; chosen."""
LARGEST_CHANGE = 0.4
"""rad in one pass."""
ROUGHNESS = np.logspace(-9.0, -1.0, 9)
"""Of q, rad^2: tried in this order."""


def second_differences(time: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the three factors of p in each second difference, in rad a mean step, squared time taken out.

    (p2 - p1) / t12 - (p1 - p0) / t01, times the mean step.
    """
    steps = np.diff(time)
    mean = float(np.mean(steps))
    relative = np.maximum(steps / mean, 0.05)
    before = 1.0 / relative[:-1]
    after = 1.0 / relative[1:]
    middle: Floats = -(before + after)
    return before, middle, after


def penalty_bands(time: Floats, give: Floats) -> Floats:
    """Return the bands (upper form) of sum (second differences)^2 / give."""
    first, middle, last = second_differences(time)
    count = time.size
    bands = np.zeros((3, count))
    weight = 1.0 / give
    bands[2, :-2] += weight * first * first
    bands[2, 1:-1] += weight * middle * middle
    bands[2, 2:] += weight * last * last
    bands[1, 1:-1] += weight * first * middle
    bands[1, 2:] += weight * middle * last
    bands[0, 2:] += weight * first * last
    return bands


def _penalty(bands: Floats, phase: Floats) -> Floats:
    """Return the product of the banded matrix and the phase."""
    product: Floats = bands[2] * phase
    product[:-1] += bands[1, 1:] * phase[1:]
    product[1:] += bands[1, 1:] * phase[:-1]
    product[:-2] += bands[0, 2:] * phase[2:]
    product[2:] += bands[0, 2:] * phase[:-2]
    return product


def diagonal_of_inverse(bands: Floats) -> Floats:
    """Return the diagonal of the inverse of a positive matrix of two side bands (upper form).

    Takahashi's recursion on the Cholesky factor, from the last row to the first.
    """
    upper = cholesky_banded(bands)
    main = upper[2].tolist()
    next_one = np.append(upper[1, 1:], 0.0).tolist()
    next_two = np.append(upper[0, 2:], [0.0, 0.0]).tolist()
    count = len(main)
    diagonal = np.empty(count)
    z11 = z12 = z22 = 0.0
    for row in range(count - 1, -1, -1):
        scale = 1.0 / main[row]
        one = next_one[row] * scale
        two = next_two[row] * scale
        z01 = -one * z11 - two * z12
        z02 = -one * z12 - two * z22
        z00 = scale * scale - one * z01 - two * z02
        diagonal[row] = z00
        z22 = z11
        z12 = z01
        z11 = z00
    return diagonal


@dataclass(frozen=True)
class Channel:
    """A photodiode: signal = offset + cosine cos p + sine sin p + noise, each at every row.

    ``weight`` is 0 where a row says nothing (clipped, interrupted), else 1.
    """

    signal: Floats
    offset: Floats
    cosine: Floats
    sine: Floats
    noise: float
    weight: Floats

    def shown(self, phase: Floats) -> Floats:
        """Return what the photodiode shows at these phases."""
        out: Floats = (
            self.offset + self.cosine * np.cos(phase) + self.sine * np.sin(phase)
        )
        return out

    def slope(self, phase: Floats) -> Floats:
        """Return the change of the signal in a radian."""
        out: Floats = self.sine * np.cos(phase) - self.cosine * np.sin(phase)
        return out


@dataclass(frozen=True)
class Smoothed:
    """Phases (rad), their standard deviations, and each channel's noise as its rows show it."""

    phase: Floats
    deviation: Floats
    noise: list[float]


def smooth(
    time: Floats, channels: list[Channel], phase: Floats, kinks: Floats
) -> Smoothed:
    """Return the phases of the rows.

    Parameters
    ----------
    time
        s (rows).
    channels
        One photodiode or two.
    phase
        Where to begin, rad: on the right branch.
    kinks
        How sharply the phase may turn at a row beyond its usual smoothness, rad^2
        (rows).
    """
    best = ROUGHNESS[-1]
    least = np.inf
    trial = phase
    for roughness in ROUGHNESS[::-1]:
        bands = penalty_bands(time, roughness + kinks[1:-1])
        trial = _solved(bands, channels, trial, PASSES // 2)
        cost = _cost(bands, channels, trial, roughness + kinks[1:-1])
        if cost < least:
            least = cost
            best = roughness
    bands = penalty_bands(time, best + kinks[1:-1])
    phase = _solved(bands, channels, phase, PASSES)
    whole = bands.copy()
    whole[2] += _information(channels, phase)
    variance = diagonal_of_inverse(whole)
    noise = []
    for channel in channels:
        leverage = (
            channel.weight * (channel.slope(phase) / channel.noise) ** 2 * variance
        )
        rows = float(channel.weight.sum() - leverage.sum())
        squares = float(
            np.sum(channel.weight * (channel.signal - channel.shown(phase)) ** 2)
        )
        noise.append(float(np.sqrt(squares / max(rows, 1.0))))
    return Smoothed(phase, np.sqrt(variance), noise)


def _information(channels: list[Channel], phase: Floats) -> Floats:
    """Return what the rows say about the phase, 1/rad^2."""
    total = np.zeros(phase.size)
    for channel in channels:
        total += channel.weight * (channel.slope(phase) / channel.noise) ** 2
    return total


def _solved(
    bands: Floats, channels: list[Channel], phase: Floats, passes: int
) -> Floats:
    """Return the phase after some Gauss-Newton passes."""
    for _ in range(passes):
        whole = bands.copy()
        whole[2] += _information(channels, phase)
        pull = -_penalty(bands, phase)
        for channel in channels:
            misfit = channel.weight * (channel.signal - channel.shown(phase))
            pull += misfit * channel.slope(phase) / channel.noise**2
        change = solveh_banded(whole, pull)
        phase = phase + np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE)
        if float(np.max(np.abs(change))) < 1e-6:
            break
    return phase


def _cost(bands: Floats, channels: list[Channel], phase: Floats, give: Floats) -> float:
    """Return twice the negative logarithm of how probable the signals are, up to a constant."""
    whole = bands.copy()
    whole[2] += _information(channels, phase)
    cost = float(np.sum(phase * _penalty(bands, phase))) + float(np.sum(np.log(give)))
    for channel in channels:
        misfit = channel.signal - channel.shown(phase)
        cost += float(np.sum(channel.weight * misfit**2)) / channel.noise**2
    factor = cholesky_banded(whole)
    return cost + 2.0 * float(np.sum(np.log(factor[2])))
