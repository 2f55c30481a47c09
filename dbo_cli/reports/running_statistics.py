"""Sums and distributions of a stream, in constant memory and the same for any chunk size.

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

LARGEST = 1e70
SMALLEST_SPAN = 1e-290  # below it a span is taken for this, so that bins keep a width


def comparable(desired: Floats, measured: Floats) -> NDArray[np.bool_]:
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
