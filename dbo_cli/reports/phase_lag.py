"""The delay that is left between desired and measured, from a stream, in constant memory."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.reports.direction import NoiseLevel
from dbo_cli.reports.running_statistics import CompensatedSum, Floats

# Differences are taken so far apart that the signal moves by this many standard deviations of its noise: the
# noise then dilutes the slope by less than 1 % ...
_MOTION_IN_NOISE = 20.0
# ... or by this part of its range, lest the bends of a signal of few samples a cycle pass for noise.
_MOTION_IN_RANGE = 1.0 / 16.0
_PLATEAUS = 2  # ... and at least so many plateaus apart, where a signal is held or rounded
_MOST_OF_BATCH = 8  # ... but no further than a batch allows, divided by this
# A batch in which the steps are no smaller than white noise makes them (the mean |second difference| of white
# noise is 1.73 times that of the first), and whose range noise alone would show, is a rest.
_WHITE = 1.0 / 0.6
_RANGE_OF_NOISE = 25.0


class PhaseLag:
    """The delay that is left, to a fraction of a sample.

    The measured signal is fitted by a desired + b slope + constant, slope being half the difference of the
    desired signal ``h`` samples later and ``h`` samples earlier. With w the frequency of the desired signal
    in rad a sample, from the regression of its second difference at the same spacing on itself,
    -4 sin(w h/2)^2, the phase left is atan2(-b sin(w h), a) and the lag is the phase over w. For a sine this
    is exact at any amplitude ratio, any length of the log and any lag below half a period; for other signals
    it is right to first order, so a lag of many samples should be taken out first. Hysteresis shows as a
    phase too; it is part of what is left. After ``lag``, ``cycles_a_sample`` is the frequency of the desired
    signal.

    ``h`` is 1 for a smooth signal. A held, rounded or noisy one says nothing about its slope from one sample
    to the next, so ``h`` grows with its plateaus and its noise; it is chosen on the first batch that moves.
    """

    def __init__(self) -> None:
        self.cycles_a_sample: float | None = None
        self._sums = [CompensatedSum() for _ in range(10)]
        self._count = 0
        self._shift = (0.0, 0.0)
        self._spacing: int | None = None
        self._tail: tuple[Floats, Floats] = (np.empty(0), np.empty(0))

    def add(self, desired: Floats, measured: Floats) -> None:
        """Take one batch (finite numbers, in the order of the log)."""
        if not len(desired):
            return
        if self._spacing is None:
            self._spacing = _spacing_of(desired)
            if self._spacing is None:
                return
            self._shift = (float(desired[0]), float(measured[0]))
        h = self._spacing
        desired = np.concatenate([self._tail[0], desired])
        measured = np.concatenate([self._tail[1], measured])
        self._tail = (desired[-2 * h :].copy(), measured[-2 * h :].copy())
        if len(desired) <= 2 * h:
            return
        d = desired[h:-h] - self._shift[0]
        m = measured[h:-h] - self._shift[1]
        s = 0.5 * (desired[2 * h :] - desired[: -2 * h])
        bend = (desired[2 * h :] - desired[h:-h]) - (desired[h:-h] - desired[: -2 * h])
        terms = (d, s, m, bend, d * d, d * s, s * s, d * m, s * m, d * bend)
        for total, term in zip(self._sums, terms, strict=True):
            total.add(float(np.add.reduce(term)))
        self._count += len(d)

    def lag(self) -> tuple[float, float] | None:
        """Return (samples, degrees), or None where the desired signal does not move back and forth."""
        if self._count < 4 or self._spacing is None:
            return None
        d, s, m, bend, dd, ds, ss, dm, sm, db = (total.value / self._count for total in self._sums)
        dd, ds, ss, dm, sm = dd - d * d, ds - d * s, ss - s * s, dm - d * m, sm - s * m
        determinant = dd * ss - ds * ds
        turning = -(db - d * bend)
        if determinant <= 1e-12 * dd * ss or turning <= 0.0:
            return None
        along = (dm * ss - sm * ds) / determinant
        across = (sm * dd - dm * ds) / determinant
        step = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(turning / dd)))  # phase in h samples
        phase = math.atan2(-across * math.sin(step), along)
        self.cycles_a_sample = step / (2.0 * math.pi * self._spacing)
        return phase / step * self._spacing, math.degrees(phase)


def _spacing_of(desired: Floats) -> int | None:
    """Return how many samples apart differences say something about the slope; None for a rest."""
    if len(desired) < 3:
        return 1
    steps = np.diff(desired)
    step = float(np.abs(steps).mean())
    if step == 0.0:
        return None
    noise = NoiseLevel()
    noise.add(desired)
    span = float(np.ptp(desired))
    white = float(np.abs(np.diff(steps)).mean()) >= _WHITE * step
    if white and span < _RANGE_OF_NOISE * noise.deviation:
        return None
    changes = np.flatnonzero(steps)
    plateau = float(np.median(np.diff(changes))) if len(changes) > 1 else 1.0
    motion = min(_MOTION_IN_NOISE * noise.deviation, _MOTION_IN_RANGE * span)
    if plateau <= 1.0 and step >= motion:
        return 1
    most = max(len(desired) // _MOST_OF_BATCH, 1)
    spacing = min(math.ceil(_PLATEAUS * plateau), most)
    while spacing < most and float(np.abs(desired[spacing:] - desired[:-spacing]).mean()) < motion:
        spacing *= 2
    return min(spacing, most)
