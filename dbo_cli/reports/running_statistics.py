"""Sums, distributions, loops and lags of a stream, in constant memory and the same for any chunk size.

Every accumulator takes its samples in batches of exactly ``BATCH`` samples, cut by ``Batches`` from whatever
pieces arrive. A sum is therefore always formed over the same samples in the same order, and the result does
not depend on how the stream was cut, to the last bit. The sums of the batches are added with compensation
(Neumaier 1974), so 10^9 samples lose no more digits than 10^3 do.

The error is *measured - desired* throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

BATCH = 32768
Floats = NDArray[np.float64]

_MANTISSA_BITS = 9
_SHIFT = 52 - _MANTISSA_BITS
_LOWEST = (1023 - 64) << _MANTISSA_BITS
_BINS = 128 << _MANTISSA_BITS

_GRID_BINS = 256
_LOOP_BINS = 64
_LOOP_LEAST = 3


LARGEST = 1e70
_SMALLEST_SPAN = 1e-290


def usable(desired: Floats, measured: Floats) -> NDArray[np.bool_]:
    """Return where a pair can be compared: both are numbers, and so small that their squares are too."""
    return (np.abs(desired) < LARGEST) & (np.abs(measured) < LARGEST)


class Batches:
    """Cut a stream of equally long columns into batches of one fixed length.

    Parameters
    ----------
    columns : int
        Number of arrays that travel together.
    size : int
        Samples in a batch.
    """

    def __init__(self, columns: int, size: int = BATCH) -> None:
        self._size = size
        self._columns = columns
        self._buffer: Floats | None = None  # a short log, a cycle of a thousand, needs no full batch
        self._filled = 0

    def add(self, *arrays: Floats) -> Iterator[tuple[Floats, ...]]:
        """Yield the batches that ``arrays`` complete; what is left waits for the next call."""
        length = len(arrays[0])
        taken = 0
        while taken < length:
            if self._filled == 0 and length - taken >= self._size:
                yield tuple(array[taken : taken + self._size] for array in arrays)
                taken += self._size
                continue
            count = min(length - taken, self._size - self._filled)
            buffer = self._room_for(self._filled + count)
            for row, array in zip(buffer, arrays, strict=True):
                row[self._filled : self._filled + count] = array[taken : taken + count]
            self._filled += count
            taken += count
            if self._filled == self._size:
                self._filled = 0
                yield tuple(buffer)

    def rest(self) -> tuple[Floats, ...]:
        """Return what has not filled a batch (possibly arrays of length 0)."""
        return tuple(self._room_for(self._filled)[:, : self._filled])

    def _room_for(self, samples: int) -> Floats:
        old = self._buffer
        if old is None or old.shape[1] < samples:
            room = min(self._size, max(1024, 1 << max(samples - 1, 0).bit_length()))
            self._buffer = np.empty((self._columns, room))
            if old is not None:
                self._buffer[:, : self._filled] = old[:, : self._filled]
            return self._buffer
        return old


class CompensatedSum:
    """A running sum that keeps what rounding takes from it (Neumaier 1974)."""

    def __init__(self) -> None:
        self._sum = 0.0
        self._lost = 0.0

    def add(self, value: float) -> None:
        """Add one number."""
        total = self._sum + value
        if abs(self._sum) >= abs(value):
            self._lost += (self._sum - total) + value
        else:
            self._lost += (value - total) + self._sum
        self._sum = total

    @property
    def value(self) -> float:
        """The sum so far."""
        return self._sum + self._lost


class ErrorDistribution:
    """The distribution of the error, exact for one batch and in fine logarithmic bins beyond.

    The bins are the leading bits of the number itself (9 bits of mantissa, 128 octaves, two signs) around
    ``centre``: 1 MB, whatever the unit and however far one spike lies. A quantile is then right to 0.1 % of
    its distance from ``centre``.
    """

    def __init__(self) -> None:
        self.centre = 0.0
        self.count = 0
        self._first: Floats | None = None
        self._bins: NDArray[np.int64] | None = None

    def add(self, error: Floats) -> None:
        """Count one batch of errors (finite, not empty)."""
        if self.count == 0:
            self.centre = float(np.add.reduce(error)) / len(error)
            self._first = error.copy()
        else:
            if self._bins is None and self._first is not None:
                self._bins = np.zeros(2 * _BINS, dtype=np.int64)
                self._count(self._first)
                self._first = None
            self._count(error)
        self.count += len(error)

    def values(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return error values in rising order and how many samples stand for each."""
        if self._first is not None:
            return np.sort(self._first), np.ones(len(self._first), dtype=np.int64)
        if self._bins is None:
            return np.empty(0), np.empty(0, dtype=np.int64)
        index = np.flatnonzero(self._bins)
        bits = np.where(index >= _BINS, index - _BINS, _BINS - 1 - index) + _LOWEST
        low = (bits << _SHIFT).view(np.float64)
        high = ((bits + 1) << _SHIFT).view(np.float64)
        middle = np.where(index >= _BINS, 0.5, -0.5) * (low + high)
        return middle + self.centre, self._bins[index]

    def quantile_abs(self, fraction: float, offset: float = 0.0) -> float:
        """Return the smallest |error - offset| that ``fraction`` of all samples do not exceed."""
        values, counts = self.values()
        distance = np.abs(values - offset)
        order = np.argsort(distance, kind="stable")
        reached = np.cumsum(counts[order])
        place = int(np.searchsorted(reached, math.ceil(fraction * self.count)))
        return float(distance[order[min(place, len(order) - 1)]])

    def _count(self, error: Floats) -> None:
        if self._bins is None:
            return
        distance = error - self.centre
        bits = (np.abs(distance).view(np.int64) >> _SHIFT) - _LOWEST
        np.clip(bits, 0, _BINS - 1, out=bits)
        index = np.where(distance >= 0.0, bits + _BINS, _BINS - 1 - bits)
        low = int(index.min())
        counts = np.bincount(index - low)
        self._bins[low : low + len(counts)] += counts


class LoopWidth:
    """The loop that is left between desired and measured, the remaining hysteresis.

    For every bin of the desired signal, the mean error on the way down less the mean error on the way up;
    the width is the one of largest magnitude. Positive: the output lags behind, as an uncompensated piezo
    does; negative: it is compensated too much. This is the hysteresis error of IEC 61298-2 (largest
    difference between upscale and downscale readings at one input), averaged over the cycles of the log.

    The bins are powers of two wide and double whenever the range outgrows them, so no range need be known
    beforehand. A bin counts when it holds three samples of either direction.
    """

    def __init__(self) -> None:
        self._width = 0.0
        self._first = 0
        self._sums = np.zeros((4, 0))

    def add(self, desired: Floats, error: Floats, slope: Floats) -> None:
        """Count one batch; ``slope`` is positive on the way up, negative on the way down."""
        moving = slope != 0.0
        if not moving.any():
            return
        if not moving.all():
            desired, error, slope = desired[moving], error[moving], slope[moving]
        index = self._index(desired)
        up = slope > 0.0
        down = ~up
        bins = self._sums.shape[1]
        self._sums[0] += np.bincount(index[up], minlength=bins)
        self._sums[1] += np.bincount(index[up], weights=error[up], minlength=bins)
        self._sums[2] += np.bincount(index[down], minlength=bins)
        self._sums[3] += np.bincount(index[down], weights=error[down], minlength=bins)

    def width(self) -> float | None:
        """Return the width in the signal's unit, or None where no bin was passed in both directions."""
        if self._width == 0.0:
            return None
        while self._sums.shape[1] > _LOOP_BINS:
            self._double()
        counted = (self._sums[0] >= _LOOP_LEAST) & (self._sums[2] >= _LOOP_LEAST)
        if not counted.any():
            return None
        up_count, up_sum, down_count, down_sum = self._sums[:, counted]
        widths = down_sum / down_count - up_sum / up_count
        return float(widths[np.argmax(np.abs(widths))])

    def _index(self, desired: Floats) -> NDArray[np.int64]:
        low, high = float(desired.min()), float(desired.max())
        if self._width == 0.0:
            span = high - low
            scale = max(span if span > 0.0 else max(abs(low), 1.0) * 2.0**-40, _SMALLEST_SPAN)
            self._width = 2.0 ** math.floor(math.log2(scale / _GRID_BINS) + 1)
            self._first = math.floor(low / self._width)
        while True:
            first = min(self._first, math.floor(low / self._width))
            last = max(self._first + self._sums.shape[1] - 1, math.floor(high / self._width))
            if last - first < _GRID_BINS:
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


class PhaseLag:
    """The delay that is left, to a fraction of a sample.

    The measured signal is fitted by a desired + b slope + constant, slope being the central difference of
    the desired signal (in units a sample). With w the frequency of the desired signal in rad a sample, from
    the regression of its second difference on itself, -4 sin(w/2)^2, the phase left is
    atan2(-b sin w, a) and the lag is the phase over w. For a sine this is exact at any amplitude ratio, any
    length of the log and any lag below half a period; for other signals it is right to first order, so a lag
    of many samples should be taken out first. Hysteresis shows as a phase too; it is part of what is left.
    """

    def __init__(self) -> None:
        self._sums = [CompensatedSum() for _ in range(10)]
        self._count = 0
        self._shift: tuple[float, float] | None = None

    def add(self, desired: Floats, measured: Floats) -> None:
        """Take one run of samples; the first and the last serve for the differences alone."""
        if len(desired) < 3:
            return
        if self._shift is None:
            self._shift = (float(desired[0]), float(measured[0]))
        d = desired[1:-1] - self._shift[0]
        m = measured[1:-1] - self._shift[1]
        s = 0.5 * (desired[2:] - desired[:-2])
        bend = (desired[2:] - desired[1:-1]) - (desired[1:-1] - desired[:-2])
        terms = (d, s, m, bend, d * d, d * s, s * s, d * m, s * m, d * bend)
        for total, term in zip(self._sums, terms, strict=True):
            total.add(float(np.add.reduce(term)))
        self._count += len(d)

    def lag(self) -> tuple[float, float] | None:
        """Return (samples, degrees), or None where the desired signal does not move back and forth."""
        if self._count < 4:
            return None
        d, s, m, bend, dd, ds, ss, dm, sm, db = (total.value / self._count for total in self._sums)
        dd, ds, ss, dm, sm = dd - d * d, ds - d * s, ss - s * s, dm - d * m, sm - s * m
        determinant = dd * ss - ds * ds
        turning = -(db - d * bend)
        if determinant <= 1e-12 * dd * ss or turning <= 0.0:
            return None
        along = (dm * ss - sm * ds) / determinant
        across = (sm * dd - dm * ds) / determinant
        frequency = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(turning / dd)))
        phase = math.atan2(-across * math.sin(frequency), along)
        return phase / frequency, math.degrees(phase)
