"""Accumulators of a stream: sums, distributions, and what the figures of a log are drawn from.

They work in constant memory, and the result does not depend on how the stream was cut,
to the last bit: every accumulator takes batches of exactly ``BATCH`` samples, cut by
``sample_pairs.Batches`` from whatever pieces arrive, so that a sum is always formed
over the same samples in the same order. The sums of the batches are added with
compensation (Neumaier 1974), so 10^9 samples lose no more digits than 10^3 do.

Curves against time are thinned to the least and the greatest value of every stretch (so
no spike is lost), curves of one signal against another to the pixels they pass, the
error to a histogram and an averaged periodogram. A log of up to ``WHOLE`` samples is
kept as it is.

The error is *measured - desired* throughout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import cleaned
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports.sample_pairs import (
    BATCH,
    Batches,
    Floats,
    comparable,
    only,
    row_numbers,
)

# Bins are leading bits: 9 of the mantissa tell 0.1 %, 128 octaves from 2^-64 on cover
# any unit.
_MANTISSA_BITS = 9
_SHIFT = 52 - _MANTISSA_BITS  # float64 has 52
_LOWEST = (1023 - 64) << _MANTISSA_BITS  # 1023 is the exponent of 1 in float64
_BINS = 128 << _MANTISSA_BITS  # on either side of 0

SMALLEST_SPAN = 1e-290  # below it a span is taken for this, so that bins keep a width

# samples of a log that is kept as it is: some eight for every pixel of a figure
WHOLE = 8192
# stretches: at least one for every pixel, as they double from half of it
BUCKETS = 2048
PIXELS = 1024  # either way; a figure has about as many
WINDOW = 4096  # samples of a periodogram: 2,048 frequencies, two for every pixel
SIGNALS = ("desired", "measured", "error", "drive")


class DoublingBins:
    """Bins along one axis, a power of two wide; they double in width whenever the range outgrows them.

    No range need be known beforehand. What they hold is an array whose last axis they
    are.

    Parameters
    ----------
    most : int
        Bins to keep at most; more than half of them are in use once the signal has
        moved.
    still : float
        The range to begin with for a signal that does not move, as a part of its
        magnitude (at least 1).
    """

    def __init__(self, most: int, still: float) -> None:
        self._most = most
        self._still = still
        self.width = 0.0
        self.first = 0

    def fit(self, counts: NDArray[Any], values: Floats) -> NDArray[Any]:
        """Return what the bins hold, with bins for ``values`` (finite, not empty) too."""
        low, high = float(values.min()), float(values.max())
        if self.width == 0.0:
            span = high - low if high > low else max(abs(low), 1.0) * self._still
            self.width = 2.0 ** math.floor(
                math.log2(max(span, SMALLEST_SPAN) / self._most) + 1
            )
            self.first = math.floor(low / self.width)
        while True:
            first = min(self.first, math.floor(low / self.width))
            last = max(self.first + counts.shape[-1] - 1, math.floor(high / self.width))
            if last - first < self._most:
                break
            counts = self.double(counts)
        return self._padded(
            counts, self.first - first, last - (self.first + counts.shape[-1] - 1)
        )

    def double(self, counts: NDArray[Any]) -> NDArray[Any]:
        """Return what bins of twice the width hold: the sum (of truths: either) of two neighbours."""
        odd = self.first % 2
        padded = self._padded(counts, odd, (odd + counts.shape[-1]) % 2)
        self.first //= 2
        self.width *= 2.0
        merged: NDArray[Any] = padded[..., 0::2] + padded[..., 1::2]
        return merged

    def _padded(self, counts: NDArray[Any], before: int, after: int) -> NDArray[Any]:
        self.first -= before
        if before == after == 0:
            return counts
        return np.pad(counts, [(0, 0)] * (counts.ndim - 1) + [(before, after)])


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


Place = tuple[int, float | None]
"""A row of a log and its time in seconds, None where that is not known."""

# of a log that the error is added up over, at most; half of them at least are in use
STRETCHES = 4096


class ErrorParts:
    """Where along a log its error is made: the sums over stretches of equally many samples.

    The stretches double in length whenever there are too many of them.
    """

    def __init__(self) -> None:
        self._centre: float | None = None
        self._length = 1
        self._count = 0
        # the first and the last place of each stretch
        self._ends: list[tuple[Place, Place]] = []
        # samples, sum, sum of squares about the centre
        self._sums: list[tuple[int, float, float]] = []

    def add(self, error: Floats, pairs: SampleBlock) -> None:
        """Take one batch of errors (finite, not empty) and the rows that they are of."""
        if self._centre is None:
            self._centre = float(np.add.reduce(error)) / len(error)
        shifted = error - self._centre
        while math.ceil((self._count + len(error)) / self._length) > STRETCHES:
            self._double()
        begin = 0
        while begin < len(shifted):
            room = self._length - self._count % self._length
            part = shifted[begin : begin + room]
            last = begin + len(part) - 1
            ends = _place(pairs, begin), _place(pairs, last)
            sums = (
                len(part),
                float(np.add.reduce(part)),
                float(np.add.reduce(part * part)),
            )
            if room < self._length:
                self._join(ends, sums)
            else:
                self._ends.append(ends)
                self._sums.append(sums)
            self._count += len(part)
            begin += len(part)

    def half(self, offset: float) -> HalfOfError | None:
        """Return the shortest piece of the log that makes half of the squared error about ``offset``.

        It is None where there is no error.
        """
        if self._centre is None:
            return None
        counts, sums, squares = np.array(self._sums, dtype=np.float64).T
        by = offset - self._centre
        parts = np.maximum(squares - 2.0 * by * sums + counts * by * by, 0.0)
        total = float(parts.sum())
        if not 0.0 < total < math.inf:
            return None
        reached = np.concatenate([[0.0], np.cumsum(parts)])
        begins = np.arange(len(parts))
        ends = np.searchsorted(reached, reached[:-1] + 0.5 * total * (1.0 - 1e-12))
        fits = ends <= len(parts)
        samples = np.concatenate([[0.0], np.cumsum(counts)])
        lengths = samples[ends[fits]] - samples[begins[fits]]
        place = int(np.argmin(lengths))
        first, last = int(begins[fits][place]), int(ends[fits][place]) - 1
        inside = float(reached[last + 1] - reached[first])
        rest = self._count - lengths[place]
        return HalfOfError(
            first=self._ends[first][0],
            last=self._ends[last][1],
            part_of_rows=float(lengths[place]) / self._count,
            part_of_error=inside / total,
            rmse_elsewhere=math.sqrt(max(total - inside, 0.0) / rest) if rest else 0.0,
        )

    def _join(self, ends: tuple[Place, Place], sums: tuple[int, float, float]) -> None:
        """Add to the last stretch, which has room."""
        count, total, square = self._sums[-1]
        self._sums[-1] = count + sums[0], total + sums[1], square + sums[2]
        self._ends[-1] = self._ends[-1][0], ends[1]

    def _double(self) -> None:
        """Join every two stretches."""
        ends, sums = self._ends, self._sums
        self._ends, self._sums = ends[:1], sums[:1]
        for place in range(1, len(ends)):
            if place % 2:
                self._join(ends[place], sums[place])
            else:
                self._ends.append(ends[place])
                self._sums.append(sums[place])
        self._length *= 2


def _place(pairs: SampleBlock, index: int) -> Place:
    time = None if pairs.time is None else float(pairs.time[index])
    return int(pairs.rows[index]), time


@dataclass(frozen=True)
class HalfOfError:
    """The shortest piece of a log that makes half of its squared error.

    ``first`` and ``last`` are row and time (s, None where not known) of its ends;
    ``part_of_rows`` and ``part_of_error`` are parts of 1; ``rmse_elsewhere`` is what
    the other rows have.
    """

    first: Place
    last: Place
    part_of_rows: float
    part_of_error: float
    rmse_elsewhere: float


class ErrorDistribution:
    """The distribution of the error, exact for one batch and in fine logarithmic bins beyond.

    The bins are the leading bits of the number itself (9 bits of mantissa, 128 octaves,
    two signs) around ``centre``: 1 MB, whatever the unit and however far one spike
    lies. A quantile is then right to 0.1 % of its distance from ``centre``.
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


# --- what figures are drawn from ---


@dataclass(frozen=True)
class Curve:
    """A line to draw; the points are in the order they were recorded."""

    x: Floats
    y: Floats


@dataclass(frozen=True)
class Band:
    """A signal of many samples against time: the least and the greatest value of every stretch."""

    x: Floats
    low: Floats
    high: Floats

    def smooth(self, cycles: int = 80) -> Band:
        """Return a calmer band where there are more cycles than can be told apart.

        Neighbouring stretches are then joined until the edges are the envelope of the
        cycles instead of following every one of them.
        """
        if len(self.x) < 2:
            return self
        middle = 0.5 * (self.low + self.high)
        spread = 2.0 * float(np.subtract(*np.quantile(middle, [0.98, 0.02])))
        if np.abs(np.diff(middle)).sum() <= cycles * spread:
            return self
        band = self
        while len(band.x) > 256:
            if (
                np.abs(np.diff(band.high)).sum() + np.abs(np.diff(band.low)).sum()
                <= 4.0 * spread
            ):
                break
            starts = np.arange(0, len(band.x) // 2 * 2, 2)
            band = Band(
                band.x[starts],
                np.minimum.reduceat(band.low, starts),
                np.maximum.reduceat(band.high, starts),
            )
        return band


@dataclass(frozen=True)
class Raster:
    """The pixels that a curve of many samples passes; ``extent`` is left, right, bottom, top."""

    passed: NDArray[np.bool_]
    extent: tuple[float, float, float, float]


class Envelope:
    """Signals against time, thinned to the extremes of at most ``BUCKETS`` stretches of equal length.

    The stretch doubles whenever there are too many of them.
    """

    def __init__(self) -> None:
        self._length = 1
        # of each signal: time of least, least, time of greatest, greatest
        self._done = np.empty((0, 4, 0))
        self._pending: list[Floats] = []

    def add(self, time: Floats, signals: Sequence[Floats]) -> None:
        """Take one batch (``BATCH`` samples, the last one fewer) of all signals."""
        length = min(self._length, BATCH)
        while math.ceil(len(time) / length) > BUCKETS:
            length *= 2
        if length > self._length:
            self._grow(length)
        extremes = np.stack(
            [np.stack([time, values, time, values]) for values in signals]
        )
        self._pending.append(_merged(extremes, length))
        if len(self._pending) >= self._length // length:
            merged = _merged(
                np.concatenate(self._pending, axis=2), self._length // length
            )
            self._pending = []
            self._done = np.concatenate(
                [self._done.reshape(len(signals), 4, -1), merged], axis=2
            )
        while self._done.shape[2] > BUCKETS:
            self._grow(self._length * 2)

    def band(self, signal: int) -> Band:
        """Return the extremes, each drawn at the middle of the two times at which they were met."""
        extremes = np.concatenate([self._done, *self._pending], axis=2)[signal]
        return Band(
            0.5 * (extremes[0] + extremes[2]), extremes[1], extremes[3]
        ).smooth()

    def _grow(self, length: int) -> None:
        self._done = _merged(self._done, length // self._length)
        self._length = length


def _merged(extremes: Floats, count: int) -> Floats:
    """Merge every ``count`` neighbouring stretches into one."""
    if count == 1 or not extremes.size:
        return extremes
    short = -extremes.shape[2] % count
    if short:
        extremes = np.pad(extremes, ((0, 0), (0, 0), (0, short)), mode="edge")
    rows = extremes.reshape(len(extremes), 4, -1, count)
    places = rows[:, 1].argmin(axis=2), rows[:, 3].argmax(axis=2)
    at = np.stack([places[0], places[0], places[1], places[1]], axis=1)
    return np.take_along_axis(rows, at[..., np.newaxis], axis=3)[..., 0]


class Pixels:
    """One signal against another as the pixels its curve passes; the pixels double when the range grows."""

    def __init__(self) -> None:
        self._passed = np.zeros((1, 1), dtype=bool)
        # a signal that does not move is drawn in the middle of a range that rounding
        # does not fill
        self._across, self._up = DoublingBins(PIXELS, 1e-6), DoublingBins(PIXELS, 1e-6)
        self._last: tuple[Floats, Floats] = (np.empty(0), np.empty(0))

    def add(self, x: Floats, y: Floats) -> None:
        """Take one batch, drawn on from the last sample of the one before."""
        self._passed = self._across.fit(self._passed, x)
        self._passed = self._up.fit(self._passed.T, y).T
        x, y = np.concatenate([self._last[0], x]), np.concatenate([self._last[1], y])
        self._last = (x[-1:], y[-1:])
        across = x / self._across.width - self._across.first
        up = y / self._up.width - self._up.first
        self._mark(across, up)
        if len(x) == 1:
            return
        jump = np.maximum(np.abs(np.diff(across)), np.abs(np.diff(up)))
        typical = float(np.quantile(jump[:: 1 + len(jump) // 4096], 0.99))
        usual = min(math.ceil(max(typical, 1.0)), max(8, min(32, 8 * BATCH // len(x))))
        for step in range(1, usual):
            part = step / usual
            self._mark(
                (1.0 - part) * across[:-1] + part * across[1:],
                (1.0 - part) * up[:-1] + part * up[1:],
            )
        spikes = np.flatnonzero(jump > usual + 3.0)  # few, and not to be lost
        for at in spikes[np.argsort(-jump[spikes], kind="stable")[:200]].tolist():
            parts = np.linspace(0.0, 1.0, math.ceil(jump[at]) + 1)
            self._mark(
                *(side[at] + parts * (side[at + 1] - side[at]) for side in (across, up))
            )

    def _mark(self, across: Floats, up: Floats) -> None:
        # between two samples at the edge, rounding may step over it
        places = (up.astype(np.int64), across.astype(np.int64))
        self._passed[
            tuple(map(np.clip, places, (0, 0), np.array(self._passed.shape) - 1))
        ] = True

    def raster(self) -> Raster:
        """Return the pixels and where they lie."""
        left, bottom = (bins.first * bins.width for bins in (self._across, self._up))
        rows, columns = self._passed.shape
        extent = (
            left,
            left + columns * self._across.width,
            bottom,
            bottom + rows * self._up.width,
        )
        return Raster(self._passed, extent)


class Spectrum:
    """The amplitude spectral density of the error, by averaged periodograms (Welch 1967).

    Hann windows of ``WINDOW`` samples (a power of two no longer than a quarter of a
    shorter log), half overlapping, the mean of each taken off.
    """

    def __init__(self) -> None:
        self._tail = np.empty(0)
        self._power: Floats | None = None
        self._count = 0
        self._window = 0

    def add(self, error: Floats) -> None:
        """Take one batch."""
        if self._window == 0:
            quarter = max(len(error) // 4, 8)
            self._window = min(WINDOW, 1 << (quarter.bit_length() - 1))
        size, hop = self._window, self._window // 2
        error = np.concatenate([self._tail, error])
        count = (len(error) - size) // hop + 1 if len(error) >= size else 0
        if count:
            rows = np.lib.stride_tricks.sliding_window_view(error, size)[
                : count * hop : hop
            ]
            taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size)
            content = np.fft.rfft(
                (rows - rows.mean(axis=1, keepdims=True)) * taper, axis=1
            )
            power = (content.real**2 + content.imag**2).sum(axis=0) / (
                taper * taper
            ).sum()
            self._power = power if self._power is None else self._power + power
            self._count += count
        self._tail = error[count * hop :].copy()

    def density(self, sample_period: float) -> Curve | None:
        """Return frequency in 1/s and the root of the one-sided power density; None for too few samples."""
        if self._power is None:
            return None
        power = 2.0 * self._power[1:] / self._count * sample_period
        frequency = np.arange(1, len(power) + 1) / (self._window * sample_period)
        return Curve(frequency[:-1], np.sqrt(power[:-1]))


class FigureData:
    """Everything the figures of one log need.

    Parameters
    ----------
    drive_unit : str, optional
        Unit of the drive voltage, where the log has one.

    Attributes
    ----------
    samples : int
        Finite pairs seen.
    start : float
        Time (or row) of the first of them.
    has_time, has_drive : bool
        Whether the log came with times and with a drive voltage.
    """

    def __init__(self, drive_unit: str | None = None) -> None:
        self.drive_unit = None if drive_unit is None else cleaned(drive_unit)
        self.begin(("desired", "measured"))

    def begin(self, labels: tuple[str, str]) -> None:
        """Begin anew for what is compared: the loop of a model is drawn beside the measured one."""
        self.samples = 0
        self.start = 0.0
        self.has_time = False
        self.has_drive = False
        self.distribution = ErrorDistribution()
        self.spectrum = Spectrum()
        self._batches = Batches()
        self._whole: dict[str, Floats] | None = None
        self._extremes: list[
            tuple[float, float, float]
        ] = []  # least and greatest error: time, error, desired
        self._envelope = Envelope()
        self._pixels = {
            pair: Pixels() for pair in (("desired", "measured"), ("drive", "measured"))
        }
        if labels[0] == "model":
            self._pixels["drive", "desired"] = Pixels()

    def add(self, block: SampleBlock) -> None:
        """Take one block of pairs."""
        self.has_time = block.time is not None
        self.has_drive = "voltage" in block.values
        values = block.values
        finite = comparable(values["desired"], values["measured"])
        if "voltage" in values:
            finite &= comparable(values["voltage"], values["voltage"])
        for batch in self._batches.add(only(block, finite)):
            self._take(batch)

    def finish(self, distribution: ErrorDistribution) -> None:
        """Take what is left, and the error's distribution."""
        for batch in self._batches.rest():
            self._take(batch)
        self.distribution = distribution

    def against_time(self, name: str) -> Curve | Band:
        """Return ``desired``, ``measured``, ``error`` or ``drive`` against time (row, if not known)."""
        if self._whole is not None:
            return Curve(self._whole["time"], self._whole[name])
        return self._envelope.band(SIGNALS.index(name))

    def against(self, x: str, y: str) -> Curve | Raster:
        """Return ``desired`` or ``measured`` against ``drive``, or ``measured`` against ``desired``."""
        if self._whole is not None:
            return Curve(self._whole[x], self._whole[y])
        return self._pixels[x, y].raster()

    def at_largest(self, offset: float) -> tuple[float, float, float]:
        """Return time (or row) of the largest error about ``offset``, and between what it lies there.

        The two values are the lesser and the greater of desired and measured, that less
        ``offset``.
        """
        largest = max(self._extremes, key=lambda extreme: abs(extreme[1] - offset))
        time, error, desired = largest
        ends = sorted((desired, desired + error - offset))
        return time, ends[0], ends[1]

    def _take(self, block: SampleBlock) -> None:
        time = row_numbers(block) if block.time is None else block.time
        desired, measured = block.values["desired"], block.values["measured"]
        drive = block.values["voltage"] if self.has_drive else np.zeros(len(block))
        if self.samples == 0:
            self.start = float(time[0])
        self.samples += len(time)
        error = measured - desired
        self.spectrum.add(error)
        for place in (int(error.argmin()), int(error.argmax())):
            self._extremes.append(
                (float(time[place]), float(error[place]), float(desired[place]))
            )
        least = min(self._extremes, key=lambda extreme: extreme[1])
        self._extremes = [least, max(self._extremes, key=lambda extreme: extreme[1])]
        columns = dict(zip(SIGNALS, (desired, measured, error, drive), strict=True))
        if self.samples <= WHOLE:
            self._whole = {"time": time.copy()} | {
                name: column.copy() for name, column in columns.items()
            }
            return
        self._envelope.add(time, list(columns.values()))
        for (x, y), pixels in self._pixels.items():
            if self.has_drive or x != "drive":
                pixels.add(columns[x], columns[y])
