"""What the figures of a log are drawn from, gathered while the log streams by, in constant memory.

Curves against time are thinned to the least and the greatest value of every stretch (so no spike is lost),
curves of one signal against another to the pixels they pass, the error to a histogram and an averaged
periodogram. A log of up to ``WHOLE`` samples is kept as it is. As in ``running_statistics``, everything works
on batches of one fixed length, so the figures do not depend on how the log was cut.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.logs.plain_text import cleaned
from dbo_cli.reports.figures_of_merit import TrackingFigures
from dbo_cli.reports.running_statistics import BATCH, Batches, ErrorDistribution, Floats, comparable
from dbo_cli.reports.sample_pairs import PairBlock

WHOLE = 8192
BUCKETS = 2048
PIXELS = 1024
WINDOW = 4096


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

        Neighbouring stretches are then joined until the edges are the envelope of the cycles instead of
        following every one of them.
        """
        if len(self.x) < 2:
            return self
        middle = 0.5 * (self.low + self.high)
        spread = 2.0 * float(np.subtract(*np.quantile(middle, [0.98, 0.02])))
        if np.abs(np.diff(middle)).sum() <= cycles * spread:
            return self
        band = self
        while len(band.x) > 256:
            if np.abs(np.diff(band.high)).sum() + np.abs(np.diff(band.low)).sum() <= 4.0 * spread:
                break
            starts = np.arange(0, len(band.x) // 2 * 2, 2)
            band = Band(
                band.x[starts], np.minimum.reduceat(band.low, starts), np.maximum.reduceat(band.high, starts)
            )
        return band


@dataclass(frozen=True)
class Raster:
    """The pixels that a curve of many samples passes; ``extent`` is left, right, bottom, top."""

    passed: NDArray[np.bool_]
    extent: tuple[float, float, float, float]


class Envelope:
    """One signal against time, thinned to the extremes of at most ``BUCKETS`` stretches of equal length.

    The stretch doubles whenever there are too many of them.
    """

    def __init__(self) -> None:
        self._length = 1
        self._done = np.empty((4, 0))  # time of least, least, time of greatest, greatest
        self._pending: list[Floats] = []

    def add(self, time: Floats, values: Floats) -> None:
        """Take one batch (``BATCH`` samples, the last one fewer)."""
        length = min(self._length, BATCH)
        while math.ceil(len(values) / length) > BUCKETS:
            length *= 2
        if length > self._length:
            self._grow(length)
        self._pending.append(_extremes(time, values, length))
        if len(self._pending) >= self._length // length:
            merged = np.concatenate(self._pending, axis=1)
            self._pending = []
            if self._length > BATCH:
                merged = _pairwise(merged, merged.shape[1])
            self._done = np.concatenate([self._done, merged], axis=1)
        while self._done.shape[1] > BUCKETS:
            self._grow(self._length * 2)

    def band(self) -> Band:
        """Return the extremes, each drawn at the middle of the two times at which they were met."""
        found = np.concatenate([self._done, *self._pending], axis=1)
        return Band(0.5 * (found[0] + found[2]), found[1], found[3]).smooth()

    def _grow(self, length: int) -> None:
        self._done = _pairwise(self._done, length // self._length)
        self._length = length


class Pixels:
    """One signal against another as the pixels its curve passes; the pixels double when the range grows."""

    def __init__(self) -> None:
        self._passed = np.zeros((PIXELS, PIXELS), dtype=bool)
        self._width = [0.0, 0.0]
        self._first = [0, 0]
        self._last: tuple[float, float] | None = None

    def add(self, x: Floats, y: Floats) -> None:
        """Take one batch, drawn on from the last sample of the one before."""
        self._fit(0, x)
        self._fit(1, y)
        if self._last is not None:
            x = np.concatenate([[self._last[0]], x])
            y = np.concatenate([[self._last[1]], y])
        self._last = (float(x[-1]), float(y[-1]))
        across, up = x / self._width[0] - self._first[0], y / self._width[1] - self._first[1]
        if len(x) == 1:
            self._mark(across, up)
            return
        jump = np.diff(across)
        np.abs(jump, out=jump)
        rise = np.diff(up)
        np.maximum(jump, np.abs(rise, out=rise), out=jump)
        typical = float(np.quantile(jump[:: 1 + len(jump) // 4096], 0.99))
        usual = min(math.ceil(max(typical, 1.0)), max(8, min(32, 8 * BATCH // len(x))))
        self._mark(across, up)
        for step in range(1, usual):
            part = step / usual
            self._mark((1.0 - part) * across[:-1] + part * across[1:], (1.0 - part) * up[:-1] + part * up[1:])
        spikes = np.flatnonzero(jump > usual + 3.0)  # few, and not to be lost
        for at in spikes[np.argsort(-jump[spikes], kind="stable")[:200]].tolist():
            parts = np.linspace(0.0, 1.0, math.ceil(jump[at]) + 1)
            between = (side[at] + parts * (side[at + 1] - side[at]) for side in (across, up))
            self._mark(*between)

    def _mark(self, across: Floats, up: Floats) -> None:
        column, row = across.astype(np.int64), up.astype(np.int64)
        for place in (column, row):  # between two samples at the edge, rounding may step over it
            np.clip(place, 0, PIXELS - 1, out=place)
        self._passed.ravel()[row * PIXELS + column] = True

    def raster(self) -> Raster:
        """Return the pixels and where they lie."""
        left, bottom = (self._first[k] * self._width[k] for k in (0, 1))
        extent = (left, left + PIXELS * self._width[0], bottom, bottom + PIXELS * self._width[1])
        return Raster(self._passed, extent)

    def _fit(self, axis: int, values: Floats) -> None:
        low, high = float(values.min()), float(values.max())
        width = self._width[axis]
        if width == 0.0:
            span = max(high - low if high > low else max(abs(high), 1.0) * 1e-6, 1e-290)
            width = 2.0 ** math.floor(math.log2(span / PIXELS) + 1)
            self._width[axis], self._first[axis] = width, math.floor(low / width)
        while True:
            width, first = self._width[axis], self._first[axis]
            lowest = min(first, math.floor(low / width)) if not self._is_empty() else math.floor(low / width)
            if math.floor(high / width) - lowest < PIXELS and (
                first == lowest or first - lowest <= self._free(axis)
            ):
                break
            self._double(axis)
        shift = first - lowest
        if shift:
            self._passed = np.roll(self._passed, shift, axis=1 - axis)
            self._first[axis] = lowest

    def _is_empty(self) -> bool:
        return self._last is None

    def _free(self, axis: int) -> int:
        """Return how many columns (rows) at the far end hold nothing, so that they may move to the front."""
        used = np.flatnonzero(self._passed.any(axis=axis))
        return PIXELS - 1 - int(used[-1]) if len(used) else PIXELS

    def _double(self, axis: int) -> None:
        odd = self._first[axis] % 2
        passed = self._passed if axis == 0 else self._passed.T
        padded = np.pad(passed, ((0, 0), (odd, odd)))
        merged = padded[:, 0::2] | padded[:, 1::2]
        passed = np.zeros_like(self._passed)
        passed[:, : merged.shape[1]] = merged
        self._passed = passed if axis == 0 else np.ascontiguousarray(passed.T)
        self._first[axis] //= 2
        self._width[axis] *= 2.0


class Spectrum:
    """The amplitude spectral density of the error, by averaged periodograms (Welch 1967).

    Hann windows of ``WINDOW`` samples (a power of two no longer than a quarter of a shorter log), half
    overlapping, the mean of each taken off.
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
            rows = np.lib.stride_tricks.sliding_window_view(error, size)[: count * hop : hop]
            taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size)
            content = np.fft.rfft((rows - rows.mean(axis=1, keepdims=True)) * taper, axis=1)
            power = (content.real**2 + content.imag**2).sum(axis=0) / (taper * taper).sum()
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
        self.figures: TrackingFigures | None = None
        self.distribution = ErrorDistribution()
        self.spectrum = Spectrum()
        self._batches = Batches(4)
        self._whole: tuple[Floats, ...] | None = None
        self._envelopes = {name: Envelope() for name in ("desired", "measured", "error", "drive")}
        self._pixels = {pair: Pixels() for pair in (("desired", "measured"), ("drive", "measured"))}
        if labels[0] == "model":
            self._pixels["drive", "desired"] = Pixels()

    def add(self, block: PairBlock) -> None:
        """Take one block of pairs."""
        self.has_time = self.has_time or block.time is not None
        self.has_drive = self.has_drive or block.drive is not None
        time = block.row_numbers() if block.time is None else block.time
        drive = np.zeros(len(block)) if block.drive is None else block.drive
        columns = (time, block.desired, block.measured, drive)
        finite = comparable(block.desired, block.measured) & comparable(drive, drive)
        if not finite.all():
            columns = (time[finite], block.desired[finite], block.measured[finite], drive[finite])
        for batch in self._batches.add(*columns):
            self._take(*batch)

    def finish(self, figures: TrackingFigures, distribution: ErrorDistribution) -> None:
        """Take what is left, and the results that the figures refer to."""
        self._take(*self._batches.rest())
        self.figures = figures
        self.distribution = distribution

    def against_time(self, name: str) -> Curve | Band:
        """Return ``desired``, ``measured``, ``error`` or ``drive`` against time (row, if not known)."""
        if self._whole is not None:
            time, desired, measured, drive = self._whole
            columns = {"desired": desired, "measured": measured, "error": measured - desired, "drive": drive}
            return Curve(time, columns[name])
        return self._envelopes[name].band()

    def against(self, x: str, y: str) -> Curve | Raster:
        """Return ``desired`` or ``measured`` against ``drive``, or ``measured`` against ``desired``."""
        if self._whole is not None:
            columns = dict(zip(("time", "desired", "measured", "drive"), self._whole, strict=True))
            return Curve(columns[x], columns[y])
        return self._pixels[x, y].raster()

    def _take(self, time: Floats, desired: Floats, measured: Floats, drive: Floats) -> None:
        if not len(time):
            return
        if self.samples == 0:
            self.start = float(time[0])
            if len(time) <= WHOLE:
                self._whole = (time.copy(), desired.copy(), measured.copy(), drive.copy())
        self.samples += len(time)
        error = measured - desired
        self.spectrum.add(error)
        if self._whole is not None:
            return
        columns = {"desired": desired, "measured": measured, "error": error}
        if self.has_drive:
            columns["drive"] = drive
        for name, column in columns.items():
            self._envelopes[name].add(time, column)
        for (x, y), pixels in self._pixels.items():
            if x in columns:
                pixels.add(columns[x], columns[y])


def _extremes(time: Floats, values: Floats, length: int) -> Floats:
    """Return time of least, least, time of greatest and greatest of every ``length`` samples."""
    if length == 1:
        return np.stack([time, values, time, values])
    short = -len(values) % length
    if short:
        time, values = np.pad(time, (0, short), mode="edge"), np.pad(values, (0, short), mode="edge")
    times, rows = time.reshape(-1, length), values.reshape(-1, length)
    each = np.arange(len(rows))
    least, greatest = rows.argmin(axis=1), rows.argmax(axis=1)
    return np.stack([times[each, least], rows[each, least], times[each, greatest], rows[each, greatest]])


def _pairwise(found: Floats, count: int) -> Floats:
    """Merge every ``count`` neighbouring stretches into one."""
    if count <= 1 or not found.shape[1]:
        return found
    short = -found.shape[1] % count
    if short:
        found = np.pad(found, ((0, 0), (0, short)), mode="edge")
    rows = found.reshape(4, -1, count)
    each = np.arange(rows.shape[1])
    least, greatest = rows[1].argmin(axis=1), rows[3].argmax(axis=1)
    return np.stack(
        [rows[0, each, least], rows[1, each, least], rows[2, each, greatest], rows[3, each, greatest]]
    )
