"""How well one signal follows another: the figures of merit of a log of any length, in constant memory.

The error is *measured - desired* throughout. The result does not depend on how the
stream was cut into blocks, to the last bit: see ``accumulators``.

Among them are the loop and the lag that are left. A loop is a difference between up and
down, so first: which way a signal is going, sample by sample, whatever noise, rounding
and holding do to its steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.accumulators import (
    CompensatedSum,
    DoublingBins,
    ErrorDistribution,
    ErrorParts,
    HalfOfError,
)
from dbo_cli.reports.sample_pairs import Batches, Floats, comparable, only

# A turn must be larger than this many standard deviations of the noise: the greatest
# and the least of 10,000 normal samples lie 8 apart.
TURN_IN_NOISE = 10.0
# ... but never need be larger than this part of the range, lest the turns of a signal of few samples a cycle,
# whose second difference is motion and not noise, go unseen.
LARGEST_TURN = 0.1
# Mean of |second difference| to standard deviation, for normal noise: the difference
# has the variance 6.
_TO_DEVIATION = math.sqrt(math.pi / 2.0) / math.sqrt(6.0)

# kept; so many that doubling their width loses no more than a factor 2 in place
_FINE_BINS = 256
_MOST_BINS = 64
"""Bins of the loop, at most. Measured: docs/choices.md."""
_FEWEST_BINS = 8
"""Bins of the loop, at least, where they are joined. Measured: docs/choices.md."""
_LEAST_SAMPLES = 3  # of either direction, for a bin to count ...
# ... and this part of what a bin has on average, lest the noise of a few samples wins
_LEAST_PART = 0.1
_CLEAR = 0.1
"""Bins are joined until the noise floor is below this part of the width. Measured: docs/choices.md."""

_PLACE_OF_WAY = np.array([1, 3, 0])  # among the sums: of down, of neither, of up
# rows of the sums: count and sum of the error
_UP, _DOWN, _OPEN = slice(0, 2), slice(2, 4), slice(4, 6)

# Differences are taken so far apart that the signal moves by this many standard
# deviations of its noise: the noise then dilutes the slope by less than 1 % ...
_MOTION_IN_NOISE = 20.0
# ... or by this part of its range, lest the bends of a signal of few samples a cycle pass for noise.
_MOTION_IN_RANGE = 1.0 / 16.0
# ... and at least so many plateaus apart, where a signal is held or rounded
_PLATEAUS = 2
_MOST_OF_BATCH = 8  # ... but no further than a batch allows, divided by this
# A batch in which the steps are no smaller than white noise makes them (the mean
# |second difference| of white noise is 1.73 times that of the first), and whose range
# noise alone would show, is a rest.
_WHITE = 1.0 / 0.6
# standard deviations: three times the range of a batch of normal noise (8.2)
_RANGE_OF_NOISE = 25.0
# Of a desired signal that was sampled more slowly than the log and held in between:
# of all plateaus have about the same length: held; those of a rounded sine differ
# severalfold
_ALIKE = 0.8
_ABOUT = 0.2  # of the length: a program that polls a setpoint is not punctual
_FEWEST_PLATEAUS = 8  # chosen: of fewer nothing can be said of most
# Where the measurement moves evenly through a plateau, no part of it does more than
# this much of the mean. A measurement that steps with the desired signal, or follows
# within the plateau, does several times as much.
_EVENLY = 1.5
_DEVIATIONS = 3.0  # of the noise in such a sum


Turn = tuple[int, int, int]
"""Samples settled before a turn, the first sample behind it, and the new direction (1 or -1)."""


class NoiseLevel:
    """Standard deviation of what changes from sample to sample, from the mean |second difference|.

    For white noise it is that of the noise; what bends slowly hardly counts, and a jump
    counts once, not with its square. An upper bound, therefore: for signals of few
    samples a cycle a high one.
    """

    def __init__(self) -> None:
        self._sum = 0.0
        self._count = 0

    def add(self, values: Floats) -> None:
        """Take one batch."""
        if len(values) > 2:
            self._sum += float(np.abs(np.diff(values, 2)).sum())
            self._count += len(values) - 2

    @property
    def deviation(self) -> float:
        """Standard deviation so far; 0 before the third sample."""
        if not self._count:
            return 0.0
        return _TO_DEVIATION * self._sum / self._count


@dataclass(frozen=True)
class Directions:
    """The way every sample of a batch goes: 1 up, -1 down, 0 neither.

    From the place ``open_from`` on it is not known yet (the zeros there mean nothing).
    ``earlier`` says what became of the samples that were open before this batch: 1, -1,
    0 (neither), or None: still open.
    """

    ways: NDArray[np.int8]
    open_from: int
    earlier: int | None


class DirectionTracker:
    """Tell up from down by the last turn that stands out of the noise.

    A sample that has gone further than any since the turn settles all before it: they
    went the same way, so a held or rounded signal keeps its direction on every plateau.
    One that has gone back by more than the least turn starts the other way. The samples
    between the furthest one and that (the rest at a turn, the noise around it) belong
    to neither way; so do those before the first way and after the last.
    """

    def __init__(self) -> None:
        self._noise = NoiseLevel()
        self._low, self._high = math.inf, -math.inf
        self._direction = 0
        self._furthest = 0.0  # of the samples since the last turn

    def add(self, values: Floats) -> Directions:
        """Take one batch (finite, not empty)."""
        self._noise.add(values)
        direction = before = self._direction
        low, high = self._low, self._high
        self._low = min(low, float(values.min()))
        self._high = max(high, float(values.max()))
        least = min(
            TURN_IN_NOISE * self._noise.deviation,
            LARGEST_TURN * (self._high - self._low),
        )
        turns, settled = self._turns(values, least, low, high)
        stops = []
        directions = []
        for before_turn, first, following in turns:
            stops += [before_turn, first]
            directions += [direction, 0]
            direction = following
        lengths = np.diff([0, *stops, settled, len(values)])
        earlier: int | None = None
        goes_on = turns[0][0] if turns else settled
        if goes_on:
            earlier = before
        elif turns:
            # what was open lies behind the furthest sample
            earlier = 0
        ways = np.repeat(np.array([*directions, direction, 0], dtype=np.int8), lengths)
        return Directions(ways, settled, earlier)

    def _turns(
        self, values: Floats, least: float, low: float, high: float
    ) -> tuple[list[Turn], int]:
        """Return the turns of a batch, and how many samples of it are settled. Every turning point is met."""
        turns: list[Turn] = []
        direction, furthest, settled = self._direction, self._furthest, 0
        begin = 0  # of the monotone stretch that ends at ``place``
        places = monotone_ends(values)
        for place, value in zip(places.tolist(), values[places].tolist(), strict=True):
            turned = 0
            if direction:
                ahead = direction * (value - furthest)
                if ahead > 0.0:
                    furthest, settled = value, place + 1
                elif -ahead > least:
                    turned = -direction
            else:
                low = min(low, value)
                high = max(high, value)
                if value - low > least:
                    turned = 1
                    furthest = low
                elif high - value > least:
                    turned = -1
                    furthest = high
            if turned:
                # the stretch is monotone: its first sample that is further back than
                # the least turn
                back = turned * (values[begin : place + 1] - furthest)
                first = begin + int(np.searchsorted(back, least, "right"))
                turns.append((settled, first, turned))
                direction = turned
                furthest = value
                settled = place + 1
            begin = place + 1
        self._direction, self._furthest = direction, furthest
        return turns, settled


def monotone_ends(values: Floats) -> NDArray[np.int64]:
    """Return the places where the direction changes and the two ends; in between nothing can turn."""
    if len(values) < 2:
        return np.arange(len(values))
    step = np.sign(np.diff(values))
    inner = np.flatnonzero(step[1:] != step[:-1]) + 1
    return np.concatenate([[0], inner, [len(values) - 1]])


class Loop(NamedTuple):
    """Width of a loop and what noise alone would show in its place; both in the signal's unit."""

    width: float
    noise_floor: float


class LoopWidth:
    """The remaining hysteresis between desired and measured.

    For every bin of the desired signal, the mean error on the way down less the mean
    error on the way up; the width is the one of largest magnitude. Positive: the output
    lags behind, as an uncompensated piezo does; negative: it is compensated too much.
    This is the hysteresis error of IEC 61298-2 (largest difference between upscale and
    downscale readings at one input), averaged over the cycles of the log. A delay and a
    drift of the sensor open such a loop, too. Which way the signal goes,
    ``DirectionTracker`` finds out.

    The noise floor is what the largest of so many bins would read if there were no
    loop, only what changes in the error from sample to sample: sqrt(2 ln 2B) times the
    root mean square of the bins' standard errors.
    """

    def __init__(self) -> None:
        self._directions = DirectionTracker()
        self._noise = NoiseLevel()
        # a still signal: its rounding is in one bin
        self._bins = DoublingBins(_FINE_BINS, 2.0**-40)
        self._sums = np.zeros((6, 1))

    def add(self, desired: Floats, error: Floats) -> None:
        """Count one batch (finite numbers, in the order of the log)."""
        if not len(desired):
            return
        directions = self._directions.add(desired)
        self._noise.add(error)
        self._sums = self._bins.fit(self._sums, desired)
        index = np.floor(desired / self._bins.width).astype(np.int64) - self._bins.first
        if directions.earlier is not None:
            if directions.earlier > 0:
                self._sums[_UP] += self._sums[_OPEN]
            elif directions.earlier < 0:
                self._sums[_DOWN] += self._sums[_OPEN]
            self._sums[_OPEN] = 0.0
        # the ways side by side: up, down, open, neither
        bins = self._sums.shape[1]
        place = _PLACE_OF_WAY[directions.ways + 1] * bins + index
        place[directions.open_from :] = 2 * bins + index[directions.open_from :]
        counts = np.bincount(place, minlength=4 * bins)
        totals = np.bincount(place, weights=error, minlength=4 * bins)
        self._sums[0::2] += counts.reshape(4, bins)[:3]
        self._sums[1::2] += totals.reshape(4, bins)[:3]

    def loop(self) -> Loop | None:
        """Return width and noise floor, or None where no bin was passed in both directions."""
        while self._sums.shape[1] > _MOST_BINS:
            self._sums = self._bins.double(self._sums)
        loop = self._largest()
        while self._sums.shape[1] >= 2 * _FEWEST_BINS:
            if loop is not None and loop.noise_floor <= _CLEAR * abs(loop.width):
                break
            self._sums = self._bins.double(self._sums)
            loop = self._largest() or loop
        return loop

    def _largest(self) -> Loop | None:
        up, down = self._sums[0], self._sums[2]
        counted = np.ones(self._sums.shape[1], dtype=bool)
        for samples in (up, down):
            counted &= samples >= max(
                _LEAST_SAMPLES, _LEAST_PART * float(samples.mean())
            )
        if not counted.any():
            return None
        up_count, up_sum, down_count, down_sum = self._sums[:4, counted]
        widths = down_sum / down_count - up_sum / up_count
        variance = float(np.mean(1.0 / up_count + 1.0 / down_count))
        floor = self._noise.deviation * math.sqrt(
            2.0 * math.log(2.0 * len(widths)) * variance
        )
        return Loop(float(widths[np.argmax(np.abs(widths))]), floor)


class PhaseLag:
    """The delay that is left, to a fraction of a sample.

    The measured signal is fitted by a desired + b slope + constant, slope being half
    the difference of the desired signal ``h`` samples later and ``h`` samples earlier.
    With w the frequency of the desired signal in rad a sample, from the regression of
    its second difference at the same spacing on itself, -4 sin(w h/2)^2, the phase left
    is atan2(-b sin(w h), a) and the lag is the phase over w. For a sine this is exact
    at any amplitude ratio, any length of the log and any lag below half a period; for
    other signals it is right to first order, so a lag of many samples should be taken
    out first. Hysteresis shows as a phase too; it is part of what is left. After
    ``lag``, ``cycles_a_sample`` is the frequency of the desired signal.

    ``h`` is 1 for a smooth signal. A held, rounded or noisy one says nothing about its
    slope from one sample to the next, so ``h`` grows with its plateaus and its noise;
    it is chosen on the first batch that moves.
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
        # means of desired, slope, measured, second difference, and of the products that
        # `add` sums
        d, s, m, bend, dd, ds, ss, dm, sm, db = (
            total.value / self._count for total in self._sums
        )
        desired_variance = dd - d * d
        slope_variance = ss - s * s
        desired_slope = ds - d * s  # covariances from here on
        desired_measured = dm - d * m
        slope_measured = sm - s * m
        desired_bend = db - d * bend
        determinant = desired_variance * slope_variance - desired_slope * desired_slope
        if determinant <= 1e-12 * desired_variance * slope_variance:
            return None
        if desired_bend >= 0.0:
            return None  # a signal that goes back and forth bends towards its mean
        along = (
            desired_measured * slope_variance - slope_measured * desired_slope
        ) / determinant
        across = (
            slope_measured * desired_variance - desired_measured * desired_slope
        ) / determinant
        half_chord = 0.5 * math.sqrt(-desired_bend / desired_variance)
        step = 2.0 * math.asin(min(1.0, half_chord))  # phase in h samples
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
    plateau = 1.0
    if len(changes) > 1:
        plateau = float(np.median(np.diff(changes)))
    motion = min(_MOTION_IN_NOISE * noise.deviation, _MOTION_IN_RANGE * span)
    if plateau <= 1.0 and step >= motion:
        return 1
    most = max(len(desired) // _MOST_OF_BATCH, 1)
    spacing = min(math.ceil(_PLATEAUS * plateau), most)
    while (
        spacing < most
        and float(np.abs(desired[spacing:] - desired[:-spacing]).mean()) < motion
    ):
        spacing *= 2
    return min(spacing, most)


@dataclass(frozen=True)
class TrackingFigures:
    """How well the measured signal follows the desired one; lengths in the signals' own unit.

    ``offset`` is what was subtracted from the error (0.0 unless it was asked for).
    Where a figure is not defined it is None: ``nrmse_percent`` for a desired signal
    that never changes, ``loop_width`` and its noise floor ``loop_noise`` where no value
    was passed both upward and downward, the lag where nothing moves. ``half`` is the
    shortest piece that makes half of the squared error, where that was looked for.
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
    half: HalfOfError | None = None

    @property
    def frequency(self) -> float | None:
        """The desired signal's frequency in Hz, where it moves back and forth and the clock is known."""
        if self.cycles_a_sample is None or self.sample_period is None:
            return None
        return self.cycles_a_sample / self.sample_period

    @property
    def lag_left_seconds(self) -> float | None:
        """The lag that is left in seconds, where the clock is known."""
        if self.lag_left is None or self.sample_period is None:
            return None
        seconds = self.lag_left * self.sample_period
        return seconds if math.isfinite(seconds) else None


def percent_of(value: float, whole: float) -> float | None:
    """Return a value in percent of a range; None where there is none, or next to none."""
    if not whole > 0.0:
        return None
    percent = 100.0 * value / whole
    return percent if math.isfinite(percent) else None


class TrackingMetrics:
    """All figures of merit of one log or one segment, from blocks of any length.

    Parameters
    ----------
    remove_offset : bool
        Take the mean error off before anything else is said about it (a sensor's
        arbitrary zero).
    sample_rate : float, optional
        Samples a second (Hz), where no times tell it.
    by_parts : bool
        Find the shortest piece that makes half of the error.

    Attributes
    ----------
    rows : (int, int), optional
        The first and the last row taken.
    distribution : ErrorDistribution
        Of the error before the offset is taken off.
    missing : list of two int
        Samples that are not numbers, desired and measured.
    """

    def __init__(
        self,
        *,
        remove_offset: bool = False,
        sample_rate: float | None = None,
        by_parts: bool = False,
    ) -> None:
        self._remove_offset, self._sample_rate = remove_offset, sample_rate
        self._parts = ErrorParts() if by_parts else None
        self.rows: tuple[int, int] | None = None
        self._batches = Batches()
        self.distribution = ErrorDistribution()
        self._loop = LoopWidth()
        self._phase = PhaseLag()
        self._hold: float | None = None
        self._last_desired = math.nan
        self._sums = (CompensatedSum(), CompensatedSum())
        # least and greatest error: value, row, time
        self._extremes: list[tuple[float, int, float]] = []
        self._range = (math.inf, -math.inf)
        self._not_finite = 0
        self.missing = [0, 0]
        self._times: tuple[float, float] | None = None

    def add(self, pairs: SampleBlock) -> None:
        """Take one block."""
        if not len(pairs):
            return
        first = int(pairs.rows[0])
        if self.rows is not None:
            first = self.rows[0]
        self.rows = (first, int(pairs.rows[-1]))
        for batch in self._batches.add(pairs):
            self._take(batch)

    def result(self) -> TrackingFigures | None:
        """Return the figures of everything taken so far; None where no sample was a number.

        The accumulator is spent by this call.
        """
        for batch in self._batches.rest():
            self._take(batch)
        n = self.distribution.count
        if n == 0:
            return None
        shift = self.distribution.centre
        mean_shifted, square = self._sums[0].value / n, self._sums[1].value / n
        mean = shift + mean_shifted
        offset = 0.0
        if self._remove_offset:
            offset = mean
        variance = max(square - mean_shifted * mean_shifted, 0.0)
        rmse = math.sqrt(variance + (mean - offset) ** 2)
        largest = max(self._extremes, key=lambda extreme: abs(extreme[0] - offset))
        low, high = self._range
        span = high - low
        figures = TrackingFigures(
            samples=n,
            not_finite=self._not_finite,
            desired_min=low,
            desired_max=high,
            rmse=rmse,
            nrmse_percent=percent_of(rmse, span),
            mean=mean - offset,
            max_abs=abs(largest[0] - offset),
            max_abs_row=largest[1],
            max_abs_time=None if math.isnan(largest[2]) else largest[2],
            p95_abs=self.distribution.quantile_abs(0.95, offset),
            loop_width=None,
            loop_width_percent=None,
            lag_left=None,
            phase_left=None,
            offset=offset,
            sample_period=self._sample_period(),
        )
        if self._parts is not None:
            figures = replace(figures, half=self._parts.half(offset))
        return self._with_loop_and_lag(figures, span)

    def _with_loop_and_lag(
        self, figures: TrackingFigures, span: float
    ) -> TrackingFigures:
        """Return figures with the loop and the lag that are left, where there are any."""
        loop = self._loop.loop()
        if loop is not None:
            figures = replace(
                figures,
                loop_width=loop.width,
                loop_width_percent=percent_of(loop.width, span),
                loop_noise=loop.noise_floor,
            )
        hold = self._hold or 1.0  # samples that one of the desired signal lasts
        lag = self._phase.lag()
        if lag is not None:
            samples, degrees = lag
            figures = replace(figures, lag_left=samples * hold, phase_left=degrees)
        cycles = self._phase.cycles_a_sample
        if cycles is not None:
            figures = replace(figures, cycles_a_sample=cycles / hold)
        return figures

    def _sample_period(self) -> float | None:
        samples = self.distribution.count + self._not_finite
        period = 0.0
        if self._times is not None and samples > 1:
            period = (self._times[1] - self._times[0]) / (samples - 1)
        if math.isfinite(period) and period > 0.0:
            return period
        if self._sample_rate is None:
            return None
        return 1.0 / self._sample_rate

    def _take(self, pairs: SampleBlock) -> None:
        if pairs.time is not None:
            first = float(pairs.time[0])
            if self._times is not None:
                first = self._times[0]
            self._times = (first, float(pairs.time[-1]))
        desired, measured = pairs.values["desired"], pairs.values["measured"]
        finite = comparable(desired, measured)
        if not finite.all():
            self._not_finite += int(len(finite) - np.count_nonzero(finite))
            for which, column in enumerate((desired, measured)):
                self.missing[which] += int(
                    len(column) - np.count_nonzero(comparable(column, column))
                )
            pairs = only(pairs, finite)
            desired, measured = desired[finite], measured[finite]
        if len(desired) == 0:
            return
        time = np.full(len(pairs), np.nan) if pairs.time is None else pairs.time
        error = measured - desired
        self._range = (
            min(self._range[0], float(desired.min())),
            max(self._range[1], float(desired.max())),
        )
        self.distribution.add(error)
        if self._parts is not None:
            self._parts.add(error, pairs)
        shifted = error - self.distribution.centre
        self._sums[0].add(float(np.add.reduce(shifted)))
        self._sums[1].add(float(np.add.reduce(shifted * shifted)))
        for place in (int(error.argmin()), int(error.argmax())):
            extreme = (float(error[place]), int(pairs.rows[place]), float(time[place]))
            self._extremes.append(extreme)
        least = min(self._extremes, key=lambda extreme: extreme[0])
        greatest = max(self._extremes, key=lambda extreme: extreme[0])
        self._extremes = [least, greatest]
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

    Of such a log only the samples at which the desired signal is new belong together: a
    value held for L samples is late by up to L - 1 of them, although nobody asked for
    that. Where the measurement moves in steps as the desired signal does, the hold is
    part of what was asked for, and every sample counts. A coarsely rounded triangle
    cannot be told from a held one, and counts as held.

    Returns 1 where every sample counts and None where the desired signal moves too
    little to tell.
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
    direction = np.sign(desired[starts] - desired[starts - 1])
    # How far the measurement goes the desired signal's way in the 1st, 2nd ... sample
    # of all plateaus.
    steps = np.diff(measured)
    places = range(int(lengths[alike].min()))
    moved = np.array(
        [float((direction * steps[starts - 1 + place]).sum()) for place in places]
    )
    noise = NoiseLevel()
    noise.add(measured)
    unsure = _DEVIATIONS * noise.deviation * math.sqrt(2.0 * len(starts))
    evenly = unsure < moved.sum() and moved.max() <= _EVENLY * moved.mean() + unsure
    if not evenly:
        return 1.0
    return float(lengths[alike].mean())
