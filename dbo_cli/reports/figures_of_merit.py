"""How well one signal follows another: the figures of merit of a log of any length, in constant memory.

The error is *measured - desired* throughout. The result does not depend on how the stream was cut into
blocks, to the last bit: see ``running_statistics``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dbo_cli.reports.loop_and_lag import LoopWidth, NoiseLevel, PhaseLag
from dbo_cli.reports.running_statistics import (
    Batches,
    CompensatedSum,
    ErrorDistribution,
    Floats,
    comparable,
)

# Of a desired signal that was sampled more slowly than the log and held in between:
_ALIKE = 0.8  # of all plateaus have about the same length: held; those of a rounded sine differ severalfold
_ABOUT = 0.2  # of the length: a program that polls a setpoint is not punctual
_FEWEST_PLATEAUS = 8
# Where the measurement moves evenly through a plateau, no part of it does more than this much of the mean. A
# measurement that steps with the desired signal, or follows within the plateau, does several times as much.
_EVENLY = 1.5
_DEVIATIONS = 3.0  # of the noise in such a sum


@dataclass(frozen=True)
class TrackingFigures:
    """How well the measured signal follows the desired one; lengths in the signals' own unit.

    ``offset`` is what was subtracted from the error (0.0 unless it was asked for). Where a figure is not
    defined it is None: ``nrmse_percent`` for a desired signal that never changes, ``loop_width`` and its
    noise floor ``loop_noise`` where no value was passed both upward and downward, the lag where nothing
    moves.
    """

    samples: int
    not_finite: int
    desired_min: float
    desired_max: float
    rmse: float
    nrmse_percent: float | None
    mean: float
    max_abs: float
    max_abs_row: int
    max_abs_time: float | None
    p95_abs: float
    loop_width: float | None
    loop_width_percent: float | None
    lag_left: float | None
    phase_left: float | None
    offset: float
    sample_period: float | None
    loop_noise: float | None = None
    cycles_a_sample: float | None = None

    @property
    def frequency(self) -> float | None:
        """The desired signal's frequency in Hz, where it moves back and forth and the clock is known."""
        cycles, period = self.cycles_a_sample, self.sample_period
        return None if cycles is None or period is None else cycles / period

    @property
    def lag_left_seconds(self) -> float | None:
        """The lag that is left in seconds, where the clock is known."""
        lag, period = self.lag_left, self.sample_period
        return None if lag is None or period is None or not math.isfinite(lag * period) else lag * period


def percent_of(value: float, whole: float) -> float | None:
    """Return a value in percent of a range; None where there is none, or next to none."""
    percent = 100.0 * value / whole if whole > 0.0 else math.inf
    return percent if math.isfinite(percent) else None


class TrackingMetrics:
    """All figures of merit of one log or one segment, from blocks of any length.

    Parameters
    ----------
    remove_offset : bool
        Take the mean error off before anything else is said about it (a sensor's arbitrary zero).

    Attributes
    ----------
    distribution : ErrorDistribution
        Of the error before the offset is taken off.
    missing : list of two int
        Samples that are not numbers, desired and measured.
    """

    def __init__(self, *, remove_offset: bool = False) -> None:
        self._remove_offset = remove_offset
        self._batches = Batches()
        self.distribution = ErrorDistribution()
        self._loop = LoopWidth()
        self._phase = PhaseLag()
        self._hold: float | None = None
        self._last_desired = math.nan
        self._sums = (CompensatedSum(), CompensatedSum())
        self._extremes: list[tuple[float, float, float]] = []  # least and greatest error: value, row, time
        self._range = (math.inf, -math.inf)
        self._not_finite = 0
        self.missing = [0, 0]
        self._times: tuple[float, float] | None = None
        self._seen = 0

    def add(
        self, desired: Floats, measured: Floats, *, row: Floats | None = None, time: Floats | None = None
    ) -> None:
        """Take one block of equally long arrays; ``row`` counts from 1, ``time`` is in seconds."""
        length = len(desired)
        if row is None:
            row = np.arange(self._seen + 1.0, self._seen + length + 1.0)
        if time is None:
            time = np.full(length, np.nan)
        self._seen += length
        for batch in self._batches.add(desired, measured, row, time):
            self._take(*batch)

    def result(self) -> TrackingFigures | None:
        """Return the figures of everything taken so far; None where no sample was a number.

        The accumulator is spent by this call.
        """
        for batch in self._batches.rest():
            self._take(*batch)
        n = self.distribution.count
        if n == 0:
            return None
        shift = self.distribution.centre
        mean_shifted, square = self._sums[0].value / n, self._sums[1].value / n
        mean = shift + mean_shifted
        offset = mean if self._remove_offset else 0.0
        variance = max(square - mean_shifted * mean_shifted, 0.0)
        rmse = math.sqrt(variance + (mean - offset) ** 2)
        largest = max(self._extremes, key=lambda extreme: abs(extreme[0] - offset))
        low, high = self._range
        span = high - low
        loop, lag = self._loop.loop(), self._phase.lag()
        return TrackingFigures(
            samples=n,
            not_finite=self._not_finite,
            desired_min=low,
            desired_max=high,
            rmse=rmse,
            nrmse_percent=percent_of(rmse, span),
            mean=mean - offset,
            max_abs=abs(largest[0] - offset),
            max_abs_row=int(largest[1]),
            max_abs_time=None if math.isnan(largest[2]) else largest[2],
            p95_abs=self.distribution.quantile_abs(0.95, offset),
            loop_width=loop.width if loop else None,
            loop_width_percent=percent_of(loop.width, span) if loop else None,
            lag_left=lag[0] * (self._hold or 1.0) if lag else None,
            phase_left=lag[1] if lag else None,
            offset=offset,
            sample_period=self._sample_period(),
            loop_noise=loop.noise_floor if loop else None,
            cycles_a_sample=self._cycles_a_sample(),
        )

    def _cycles_a_sample(self) -> float | None:
        cycles = self._phase.cycles_a_sample
        return None if cycles is None else cycles / (self._hold or 1.0)

    def _sample_period(self) -> float | None:
        samples = self.distribution.count + self._not_finite
        if self._times is None or samples < 2:
            return None
        period = (self._times[1] - self._times[0]) / (samples - 1)
        return period if math.isfinite(period) and period > 0.0 else None

    def _take(self, desired: Floats, measured: Floats, row: Floats, time: Floats) -> None:
        first = self._times[0] if self._times else float(time[0])
        self._times = (first, float(time[-1]))
        finite = comparable(desired, measured)
        if not finite.all():
            self._not_finite += int(len(finite) - np.count_nonzero(finite))
            for which, column in enumerate((desired, measured)):
                self.missing[which] += int(len(column) - np.count_nonzero(comparable(column, column)))
            desired, measured, row, time = (array[finite] for array in (desired, measured, row, time))
        if len(desired) == 0:
            return
        error = measured - desired
        self._range = (min(self._range[0], float(desired.min())), max(self._range[1], float(desired.max())))
        self.distribution.add(error)
        shifted = error - self.distribution.centre
        self._sums[0].add(float(np.add.reduce(shifted)))
        self._sums[1].add(float(np.add.reduce(shifted * shifted)))
        places = int(error.argmin()), int(error.argmax())
        found = [*self._extremes, *((float(error[k]), float(row[k]), float(time[k])) for k in places)]
        self._extremes = [end(found, key=lambda extreme: extreme[0]) for end in (min, max)]
        self._take_motion(desired, measured)

    def _take_motion(self, desired: Floats, measured: Floats) -> None:
        """Feed loop and lag: with every sample, or with those at which a held desired signal is new."""
        if self._hold is None:
            self._hold = hold_length(desired, measured)
        if self._hold is not None and self._hold > 1.0:
            new = np.diff(desired, prepend=self._last_desired) != 0.0
            self._last_desired = float(desired[-1])
            desired, measured = desired[new], measured[new]
        self._phase.add(desired, measured)
        self._loop.add(desired, measured - desired)


def hold_length(desired: Floats, measured: Floats) -> float | None:
    """Return the samples between new values of a desired signal that is held while the measurement goes on.

    Of such a log only the samples at which the desired signal is new belong together: a value held for L
    samples is late by up to L - 1 of them, although nobody asked for that. Where the measurement moves in
    steps as the desired signal does, the hold is part of what was asked for, and every sample counts. A
    coarsely rounded triangle cannot be told from a held one, and counts as held.

    Returns 1 where every sample counts and None where the desired signal moves too little to tell.
    """
    changes = np.flatnonzero(np.diff(desired)) + 1
    if len(changes) <= _FEWEST_PLATEAUS:
        return None
    lengths = np.diff(changes)
    typical = float(np.median(lengths))
    alike = np.abs(lengths - typical) <= _ABOUT * typical
    if typical < 2.0 or np.mean(alike) < _ALIKE:
        return 1.0
    starts = changes[:-1][alike]
    way = np.sign(desired[starts] - desired[starts - 1])
    # How far the measurement goes the desired signal's way in the 1st, 2nd ... sample of all plateaus.
    steps = np.diff(measured)
    places = range(int(lengths[alike].min()))
    moved = np.array([float((way * steps[starts - 1 + place]).sum()) for place in places])
    noise = NoiseLevel()
    noise.add(measured)
    unsure = _DEVIATIONS * noise.deviation * math.sqrt(2.0 * len(starts))
    evenly = unsure < moved.sum() and moved.max() <= _EVENLY * moved.mean() + unsure
    return float(lengths[alike].mean()) if evenly else 1.0
