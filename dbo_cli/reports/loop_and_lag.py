"""The loop and the lag that are left between desired and measured, from a stream, in constant memory.

A loop is a difference between up and down, so first of all: which way a signal is going, sample by sample,
whatever noise, rounding and holding do to its steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.reports.running_statistics import CompensatedSum, DoublingBins, Floats

# A turn must be larger than this many standard deviations of the noise: the greatest and the least of 10,000
# normal samples lie 8 apart.
TURN_IN_NOISE = 10.0
# ... but never need be larger than this part of the range, lest the turns of a signal of few samples a cycle,
# whose second difference is motion and not noise, go unseen.
LARGEST_TURN = 0.1
# Mean of |second difference| to standard deviation, for normal noise: the difference has the variance 6.
_TO_DEVIATION = math.sqrt(math.pi / 2.0) / math.sqrt(6.0)

_FINE_BINS = 256  # kept; so many that doubling their width loses no more than a factor 2 in place
_MOST_BINS = 64
_FEWEST_BINS = 8
_LEAST_SAMPLES = 3  # of either direction, for a bin to count ...
_LEAST_PART = 0.1  # ... and this part of what a bin has on average, lest the noise of a few samples wins
# Bins are joined until the noise floor is below this part of the width: of a true loop of 0.50 in noise of
# 0.2 and 4,000 samples, 64 bins read 0.62 (the largest of many noisy means), joined ones 0.52.
_CLEAR = 0.1

_PLACE_OF_WAY = np.array([1, 3, 0])  # among the sums: of down, of neither, of up
_UP, _DOWN, _OPEN = slice(0, 2), slice(2, 4), slice(4, 6)  # rows of the sums: count and sum of the error

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


class NoiseLevel:
    """Standard deviation of what changes from sample to sample, from the mean |second difference|.

    For white noise it is that of the noise; what bends slowly hardly counts, and a jump counts once, not with
    its square. An upper bound, therefore: for signals of few samples a cycle a high one.
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
        return _TO_DEVIATION * self._sum / self._count if self._count else 0.0


@dataclass(frozen=True)
class Directions:
    """The way every sample of a batch goes: 1 up, -1 down, 0 neither.

    From the place ``open_from`` on it is not known yet (the zeros there mean nothing). ``earlier`` says what
    became of the samples that were open before this batch: 1, -1, 0 (neither), or None: still open.
    """

    ways: NDArray[np.int8]
    open_from: int
    earlier: int | None


class _Turn(NamedTuple):
    """Where the way changed: what was settled before it, and the first sample of the new way."""

    settled: int
    first: int
    way: int


class DirectionTracker:
    """Tell up from down by the last turn that stands out of the noise.

    A sample that has gone further than any since the turn settles all before it: they went the same way, so
    a held or rounded signal keeps its direction on every plateau. One that has gone back by more than the
    least turn starts the other way. The samples between the furthest one and that (the rest at a turn, the
    noise around it) belong to neither way; so do those before the first way and after the last.
    """

    def __init__(self) -> None:
        self._noise = NoiseLevel()
        self._low, self._high = math.inf, -math.inf
        self._way = 0
        self._furthest = 0.0  # of the samples since the last turn

    def add(self, values: Floats) -> Directions:
        """Take one batch (finite, not empty)."""
        self._noise.add(values)
        before = self._way, self._low, self._high
        self._low, self._high = min(self._low, float(values.min())), max(self._high, float(values.max()))
        least = min(TURN_IN_NOISE * self._noise.deviation, LARGEST_TURN * (self._high - self._low))
        turns, settled = self._turns(values, least, *before[1:])
        stops, ways = [], []
        way = before[0]
        for turn in turns:
            stops += [turn.settled, turn.first]
            ways += [way, 0]
            way = turn.way
        lengths = np.diff([0, *stops, settled, len(values)])
        known = turns[0].settled if turns else settled
        return Directions(
            np.repeat(np.array([*ways, way, 0], dtype=np.int8), lengths),
            settled,
            before[0] if known else 0 if turns else None,
        )

    def _turns(self, values: Floats, least: float, low: float, high: float) -> tuple[list[_Turn], int]:
        """Return the turns of a batch, and how many samples of it are settled. Every turning point is met."""
        turns: list[_Turn] = []
        way, furthest, settled = self._way, self._furthest, 0
        begin = 0  # of the monotone stretch that ends at ``place``
        places = monotone_ends(values)
        for place, value in zip(places.tolist(), values[places].tolist(), strict=True):
            turned = 0
            if way:
                ahead = way * (value - furthest)
                if ahead > 0.0:
                    furthest, settled = value, place + 1
                elif -ahead > least:
                    turned = -way
            else:
                low, high = min(low, value), max(high, value)
                turned = 1 if value - low > least else -1 if high - value > least else 0
                furthest = low if turned > 0 else high
            if turned:
                # the stretch is monotone: its first sample that is further back than the least turn
                back = turned * (values[begin : place + 1] - furthest)
                turns.append(_Turn(settled, begin + int(np.searchsorted(back, least, "right")), turned))
                way, furthest, settled = turned, value, place + 1
            begin = place + 1
        self._way, self._furthest = way, furthest
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

    For every bin of the desired signal, the mean error on the way down less the mean error on the way up;
    the width is the one of largest magnitude. Positive: the output lags behind, as an uncompensated piezo
    does; negative: it is compensated too much. This is the hysteresis error of IEC 61298-2 (largest
    difference between upscale and downscale readings at one input), averaged over the cycles of the log.
    A delay and a drift of the sensor open such a loop, too. Which way the signal goes, ``DirectionTracker``
    finds out.

    The noise floor is what the largest of so many bins would read if there were no loop, only what changes
    in the error from sample to sample: sqrt(2 ln 2B) times the root mean square of the bins' standard errors.
    """

    def __init__(self) -> None:
        self._directions = DirectionTracker()
        self._noise = NoiseLevel()
        self._bins = DoublingBins(_FINE_BINS, 2.0**-40)  # a still signal: its rounding is in one bin
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
            if directions.earlier:
                self._sums[_UP if directions.earlier > 0 else _DOWN] += self._sums[_OPEN]
            self._sums[_OPEN] = 0.0
        # the ways side by side: up, down, open, neither
        bins = self._sums.shape[1]
        place = _PLACE_OF_WAY[directions.ways + 1] * bins + index
        place[directions.open_from :] = 2 * bins + index[directions.open_from :]
        self._sums[0::2] += np.bincount(place, minlength=4 * bins).reshape(4, bins)[:3]
        self._sums[1::2] += np.bincount(place, weights=error, minlength=4 * bins).reshape(4, bins)[:3]

    def loop(self) -> Loop | None:
        """Return width and noise floor, or None where no bin was passed in both directions."""
        while self._sums.shape[1] > _MOST_BINS:
            self._sums = self._bins.double(self._sums)
        found = self._largest()
        while self._sums.shape[1] >= 2 * _FEWEST_BINS:
            if found is not None and found.noise_floor <= _CLEAR * abs(found.width):
                break
            self._sums = self._bins.double(self._sums)
            found = self._largest() or found
        return found

    def _largest(self) -> Loop | None:
        up, down = self._sums[0], self._sums[2]
        counted = np.ones(self._sums.shape[1], dtype=bool)
        for samples in (up, down):
            counted &= samples >= max(_LEAST_SAMPLES, _LEAST_PART * float(samples.mean()))
        if not counted.any():
            return None
        up_count, up_sum, down_count, down_sum = self._sums[:4, counted]
        widths = down_sum / down_count - up_sum / up_count
        variance = float(np.mean(1.0 / up_count + 1.0 / down_count))
        floor = self._noise.deviation * math.sqrt(2.0 * math.log(2.0 * len(widths)) * variance)
        return Loop(float(widths[np.argmax(np.abs(widths))]), floor)


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
