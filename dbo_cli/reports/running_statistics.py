"""Sums and distributions of a stream, in constant memory and the same for any chunk size.

Every accumulator takes its samples in batches of exactly ``BATCH`` samples, cut by ``sample_pairs.Batches``
from whatever pieces arrive. A sum is therefore always formed over the same samples in the same order, and the
result does not depend on how the stream was cut, to the last bit. The sums of the batches are added with
compensation (Neumaier 1974), so 10^9 samples lose no more digits than 10^3 do.

The error is *measured - desired* throughout.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

BATCH = 32768  # samples: four columns of them fit into a cache of 1 MB
Floats = NDArray[np.float64]

# Bins are leading bits: 9 of the mantissa tell 0.1 %, 128 octaves from 2^-64 on cover any unit.
_MANTISSA_BITS = 9
_SHIFT = 52 - _MANTISSA_BITS  # float64 has 52
_LOWEST = (1023 - 64) << _MANTISSA_BITS  # 1023 is the exponent of 1 in float64
_BINS = 128 << _MANTISSA_BITS  # on either side of 0

LARGEST = 1e70  # its fourth power is still a number
SMALLEST_SPAN = 1e-290  # below it a span is taken for this, so that bins keep a width


def comparable(desired: Floats, measured: Floats) -> NDArray[np.bool_]:
    """Return where a pair can be compared: both are numbers, and so small that their squares are too."""
    return (np.abs(desired) < LARGEST) & (np.abs(measured) < LARGEST)


class DoublingBins:
    """Bins along one axis, a power of two wide; they double in width whenever the range outgrows them.

    No range need be known beforehand. What they hold is an array whose last axis they are.

    Parameters
    ----------
    most : int
        Bins to keep at most; more than half of them are in use once the signal has moved.
    still : float
        The range to begin with for a signal that does not move, as a part of its magnitude (at least 1).
    """

    def __init__(self, most: int, still: float) -> None:
        self._most = most
        self._still = still
        self.width = 0.0
        self.first = 0

    def fit(self, held: NDArray[Any], values: Floats) -> NDArray[Any]:
        """Return what the bins hold, with bins for ``values`` (finite, not empty) too."""
        low, high = float(values.min()), float(values.max())
        if self.width == 0.0:
            span = high - low if high > low else max(abs(low), 1.0) * self._still
            self.width = 2.0 ** math.floor(math.log2(max(span, SMALLEST_SPAN) / self._most) + 1)
            self.first = math.floor(low / self.width)
        while True:
            first = min(self.first, math.floor(low / self.width))
            last = max(self.first + held.shape[-1] - 1, math.floor(high / self.width))
            if last - first < self._most:
                break
            held = self.double(held)
        return self._padded(held, self.first - first, last - (self.first + held.shape[-1] - 1))

    def double(self, held: NDArray[Any]) -> NDArray[Any]:
        """Return what bins of twice the width hold: the sum (of truths: either) of two neighbours."""
        odd = self.first % 2
        padded = self._padded(held, odd, (odd + held.shape[-1]) % 2)
        self.first //= 2
        self.width *= 2.0
        merged: NDArray[Any] = padded[..., 0::2] + padded[..., 1::2]
        return merged

    def _padded(self, held: NDArray[Any], before: int, after: int) -> NDArray[Any]:
        self.first -= before
        if before == after == 0:
            return held
        return np.pad(held, [(0, 0)] * (held.ndim - 1) + [(before, after)])


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
                self._count(self._bins, self._first)
                self._first = None
            assert self._bins is not None
            self._count(self._bins, error)
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

    def _count(self, bins: NDArray[np.int64], error: Floats) -> None:
        distance = error - self.centre
        bits = (np.abs(distance).view(np.int64) >> _SHIFT) - _LOWEST
        np.clip(bits, 0, _BINS - 1, out=bits)
        index = np.where(distance >= 0.0, bits + _BINS, _BINS - 1 - bits)
        low = int(index.min())
        counts = np.bincount(index - low)
        bins[low : low + len(counts)] += counts
