"""The loop that is left between desired and measured, from a stream, in constant memory."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.reports.direction import Directions, DirectionTracker, NoiseLevel
from dbo_cli.reports.running_statistics import SMALLEST_SPAN, Floats

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
    tells.

    The noise floor is what the largest of so many bins would read if there were no loop, only what changes
    in the error from sample to sample: sqrt(2 ln 2B) times the root mean square of the bins' standard errors.

    The bins are powers of two wide and double whenever the range outgrows them, so no range need be known
    beforehand.
    """

    def __init__(self) -> None:
        self._directions = DirectionTracker()
        self._noise = NoiseLevel()
        self._width = 0.0
        self._first = 0
        self._sums = np.zeros((6, 0))

    def add(self, desired: Floats, error: Floats) -> None:
        """Count one batch (finite numbers, in the order of the log)."""
        if not len(desired):
            return
        told = self._directions.add(desired)
        self._noise.add(error)
        index = self._index(desired)
        if told.earlier is not None:
            if told.earlier:
                self._sums[_UP if told.earlier > 0 else _DOWN] += self._sums[_OPEN]
            self._sums[_OPEN] = 0.0
        self._count(index, error, told)

    def loop(self) -> Loop | None:
        """Return width and noise floor, or None where no bin was passed in both directions."""
        if self._width == 0.0:
            return None
        while self._sums.shape[1] > _MOST_BINS:
            self._double()
        found = self._largest()
        while self._sums.shape[1] >= 2 * _FEWEST_BINS:
            if found is not None and found.noise_floor <= _CLEAR * abs(found.width):
                break
            self._double()
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

    def _count(self, index: NDArray[np.int64], error: Floats, told: Directions) -> None:
        """Add a batch to the sums, the ways side by side: up, down, open, neither."""
        bins = self._sums.shape[1]
        place = _PLACE_OF_WAY[told.ways + 1] * bins + index
        place[told.open_from :] = 2 * bins + index[told.open_from :]
        counts = np.bincount(place, minlength=4 * bins).reshape(4, bins)
        sums = np.bincount(place, weights=error, minlength=4 * bins).reshape(4, bins)
        self._sums[0::2] += counts[:3]
        self._sums[1::2] += sums[:3]

    def _index(self, desired: Floats) -> NDArray[np.int64]:
        low, high = float(desired.min()), float(desired.max())
        if self._width == 0.0:
            span = high - low
            scale = max(span if span > 0.0 else max(abs(low), 1.0) * 2.0**-40, SMALLEST_SPAN)
            self._width = 2.0 ** math.floor(math.log2(scale / _FINE_BINS) + 1)
            self._first = math.floor(low / self._width)
        while True:
            first = min(self._first, math.floor(low / self._width))
            last = max(self._first + self._sums.shape[1] - 1, math.floor(high / self._width))
            if last - first < _FINE_BINS:
                break
            self._double()
        pad = (self._first - first, last - (self._first + self._sums.shape[1] - 1))
        self._sums = np.pad(self._sums, ((0, 0), pad))
        self._first = first
        return np.floor(desired / self._width).astype(np.int64) - first

    def _double(self) -> None:
        lead = self._first % 2
        bins = self._sums.shape[1]
        padded = np.pad(self._sums, ((0, 0), (lead, (lead + bins) % 2)))
        self._sums = padded[:, 0::2] + padded[:, 1::2]
        self._first //= 2
        self._width *= 2.0
