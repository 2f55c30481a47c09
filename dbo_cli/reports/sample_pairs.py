"""Pairs of desired and measured samples: joined from two files, checked, and lagged against each other.

A pair is a sample of a block with the roles ``desired`` (what the measurement is
compared with: a wish, or a model's prediction), ``measured`` and perhaps ``voltage``,
which only figures use.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.hysteresis.cascade import interpolated
from dbo_cli.logs.request import Rows
from dbo_cli.logs.sample_block import SampleBlock, joined

Floats = NDArray[np.float64]
BATCH = 32768  # samples: four columns of them fit into a cache of 1 MB
LARGEST = 1e70  # its fourth power is still a number
# samples in which a lag is looked for: 26 s at 10,000 a second, 4 MB
LAG_WINDOW = 1 << 18
# of a step: a stamp so little beyond the trajectory's last one is the same stamp
_AT_THE_END = 1e-6
SAME = 1e-9  # of the seconds of a dwell: what rounded time stamps may lack


def comparable(desired: Floats, measured: Floats) -> NDArray[np.bool_]:
    """Return where a pair can be compared: both are numbers, and so small that their squares are too."""
    return (np.abs(desired) < LARGEST) & (np.abs(measured) < LARGEST)


def row_numbers(block: SampleBlock) -> Floats:
    """Return the data row of every sample."""
    # numpy would walk through it one integer at a time
    if isinstance(block.rows, range):
        return np.arange(
            block.rows.start, block.rows.stop, block.rows.step, dtype=np.float64
        )
    return block.rows.astype(np.float64)


def only(block: SampleBlock, mask: NDArray[np.bool_]) -> SampleBlock:
    """Return the samples that are kept, as rows without lines."""
    if mask.all():
        return block
    values = {role: column[mask] for role, column in block.values.items()}
    rows = np.asarray(block.rows, dtype=np.int64)[mask]
    time = None if block.time is None else block.time[mask]
    return SampleBlock(rows, None, time, values)


def with_values(block: SampleBlock, **values: Floats) -> SampleBlock:
    """Return a block with other values of some roles: what a model predicts as ``desired``."""
    return replace(block, values={**block.values, **values})


def rows_to_read(rows: Rows, lag: int) -> Rows:
    """Return the rows to read so that each desired row of ``rows`` finds its measured one, ``lag`` on."""
    first, last = rows
    first = max(1, first + min(lag, 0))
    if last is not None:
        last += max(lag, 0)
    return first, last


def scored(blocks: Iterable[SampleBlock], rows: Rows) -> Iterator[SampleBlock]:
    """Yield the pairs whose desired sample stands in ``rows``; nothing behind the last of them is read."""
    for block in blocks:
        part = block.within(rows)
        if len(part):
            yield part
        if len(block) and rows[1] is not None and block.rows[-1] >= rows[1]:
            return


class BeforeZero:
    """Tell the rows before time 0, with which a log may begin, from those of the trajectory itself.

    A conditioning sweep stands there, and says nothing about tracking. Nothing is held
    back: whoever has worked on ``before()`` learns from ``present`` whether the
    trajectory is still to come from ``after()``.

    Attributes
    ----------
    present : bool
        Whether the log begins with times below 0 and goes on with others.
    count : int
        Rows before time 0.
    """

    def __init__(self, blocks: Iterable[SampleBlock]) -> None:
        self._blocks: Iterator[SampleBlock] = iter(blocks)
        self.present = False
        self.count = 0

    def before(self) -> Iterator[SampleBlock]:
        """Yield everything up to the first time that is not below 0; all of a log that begins otherwise."""
        for block in self._blocks:
            if not len(block):
                continue
            if block.time is None or (self.count == 0 and not block.time[0] < 0.0):
                yield block
                yield from self._blocks
                return
            reached = np.flatnonzero(block.time >= 0.0)
            stop = len(block)
            if len(reached):
                stop = int(reached[0])
            self.count += stop
            if stop:
                yield block.part(0, stop)
            if len(reached):
                self.present = True
                rest = block.part(stop, len(block))
                self._blocks = chain([rest], self._blocks)
                return

    def after(self) -> Iterator[SampleBlock]:
        """Return the rest."""
        return self._blocks


@dataclass
class TrajectoryMatch:
    """Give every sample of a recording the desired value that belongs to it.

    By time, the desired signal is interpolated linearly at the recording's times; what
    lies outside the trajectory's time, or goes back in time, takes no part. By rows,
    the first recorded row belongs to the first of the trajectory, and the time is the
    trajectory's, where it has one; what one of them has more takes no part. Both are
    read once and side by side, never held whole, and how they are cut into blocks
    changes no digit.

    Parameters
    ----------
    name, trajectory_name : str
        How messages call the two.
    recording : iterable of SampleBlock
        Roles ``measured`` and perhaps ``voltage``.
    trajectory : iterable of SampleBlock
        Role ``desired``.
    by_time : bool
        Both must carry time, then.

    Attributes
    ----------
    left_out : int
        Samples of the recording that found no partner; complete after the last pair.
    goes_on : bool
        By rows, whether the trajectory has more samples than the recording.
    """

    name: str
    trajectory_name: str
    recording: Iterable[SampleBlock]
    trajectory: Iterable[SampleBlock]
    by_time: bool = field(kw_only=True)
    left_out: int = field(default=0, init=False)
    goes_on: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        """Begin with the trajectory's first samples."""
        self._coming = (block for block in self.trajectory if len(block))

    def pairs(self) -> Iterator[SampleBlock]:
        """Yield the recording's samples with their desired values.

        Raises
        ------
        InputError
            The trajectory's time goes backwards, or no sample found a partner.
        """
        pairs = self._pairs_by_time() if self.by_time else self._pairs_by_row()
        any_pair = False
        for pair in pairs:
            any_pair = True
            yield pair
        if any_pair:
            return
        if not self.by_time:
            raise InputError(
                f"{self.name}: no row to compare with {self.trajectory_name}"
            )
        raise InputError(
            f"{self.name}: no sample lies within the times of {self.trajectory_name}"
            " (where their clocks differ, `match` them by rows)"
        )

    def notes(self) -> list[str]:
        """Return what was left out, a line each."""
        notes = []
        if self.left_out:
            what = "outside the time of" if self.by_time else "more than in"
            notes.append(
                f"{self.name}: {self.left_out:,} rows {what} {self.trajectory_name} take no part"
            )
        if self.goes_on:
            notes.append(
                f"{self.trajectory_name}: goes on behind the last row of {self.name}"
            )
        return notes

    def _pairs_by_time(self) -> Iterator[SampleBlock]:
        times, values = np.empty(0), np.empty(0)
        # the recording's latest time; a sample before it has no place any more
        reached = -math.inf
        for block in self.recording:
            if not len(block):
                continue
            assert block.time is not None
            onward = np.maximum.accumulate(np.concatenate([[reached], block.time]))
            reached = float(onward[-1])
            while not len(times) or times[-1] < reached:
                following = next(self._coming, None)
                if following is None:
                    break
                times, values = self._appended(times, values, following)
            if not len(times):
                self.left_out += len(block)
                continue
            end = times[-1]
            if len(times) > 1:
                end = end + _AT_THE_END * (times[-1] - times[-2])
            inside = (block.time >= times[0]) & (block.time <= end)
            inside &= block.time >= onward[:-1]
            self.left_out += int(len(block) - np.count_nonzero(inside))
            if inside.any():
                desired, _ = interpolated(times, values, block.time)
                yield only(with_values(block, desired=desired), inside)
            # two stay: the one to interpolate from, and one more, whose step tells
            # where the end is
            keep = max(int(np.searchsorted(times, reached, side="right")) - 2, 0)
            times, values = times[keep:], values[keep:]

    def _appended(
        self, times: Floats, values: Floats, block: SampleBlock
    ) -> tuple[Floats, Floats]:
        assert block.time is not None
        together = np.concatenate([times, block.time])
        back = np.flatnonzero(np.diff(together[max(len(times) - 1, 0) :]) < 0.0)
        if len(back):
            place = block.place(self.trajectory_name, int(back[0]) + (len(times) == 0))
            raise InputError(
                f"{place}: time goes backwards (cut the trajectory there, or `match` by rows)"
            )
        return together, np.concatenate([values, block.values["desired"]])

    def _pairs_by_row(self) -> Iterator[SampleBlock]:
        wanted: SampleBlock | None = None
        for block in self.recording:
            done = 0
            while done < len(block):
                if wanted is None or not len(wanted):
                    wanted = next(self._coming, None)
                    if wanted is None:
                        self.left_out += len(block) - done
                        break
                count = min(len(block) - done, len(wanted))
                part = block.part(done, done + count)
                partner = wanted.part(0, count)
                if partner.time is not None:
                    part = replace(part, time=partner.time)
                yield with_values(part, desired=partner.values["desired"])
                done += count
                wanted = wanted.part(count, len(wanted))
        left = wanted is not None and len(wanted) > 0
        self.goes_on = left or next(self._coming, None) is not None


def lagged(name: str, blocks: Iterable[SampleBlock], lag: int) -> Iterator[SampleBlock]:
    """Pair every desired sample with the one measured ``lag`` samples later (earlier where negative).

    ``|lag|`` samples are held back, no more. Raises InputError where nothing is left to
    compare.
    """
    late, early = max(lag, 0), max(-lag, 0)
    last: SampleBlock | None = None
    paired = total = 0
    for block in blocks:
        total += len(block)
        whole = block if last is None else joined([last, block])
        count = max(len(whole) - abs(lag), 0)
        measured = whole.values["measured"][late : late + count]
        ready = with_values(whole.part(early, early + count), measured=measured)
        last = whole.part(count, len(whole)) if lag else None
        if len(ready):
            paired += len(ready)
            yield ready
    if total == 0:
        raise InputError(f"{name}: no data rows to compare (look at `rows`)")
    if paired == 0:
        raise InputError(
            f"{name}: a lag of {lag} samples leaves nothing of {total} rows"
            " (`lag` must be shorter than the log)"
        )


def find_lag(
    name: str, blocks: Iterable[SampleBlock]
) -> tuple[int, Iterator[SampleBlock]]:
    """Return the lag in samples at which measured follows desired best, and all blocks once more.

    The lag with the least offset-free RMSE over the first ``LAG_WINDOW`` samples, which
    are held in memory meanwhile; searched up to the first zero of the desired signal's
    autocorrelation (a quarter of a period of a sine), so that a periodic signal is not
    matched with its next period.
    """
    source = iter(blocks)
    window: list[SampleBlock] = []
    samples = 0
    for block in source:
        window.append(block)
        samples += len(block)
        if samples >= LAG_WINDOW:
            break
    if not samples:
        return 0, iter(window)
    values = joined(window).values
    desired = values["desired"][:LAG_WINDOW]
    measured = values["measured"][:LAG_WINDOW]
    finite = comparable(desired, measured)
    if not finite.any():
        raise InputError(f"{name}: no sample is a number, so no lag can be found")
    desired = _about_mean(desired, finite)
    measured = _about_mean(measured, finite)
    scale = max(float(np.abs(desired).max()), float(np.abs(measured).max()), 1e-290)
    return _best_lag(desired / scale, measured / scale), chain(window, source)


def _about_mean(column: Floats, finite: NDArray[np.bool_]) -> Floats:
    """Return a column less the mean of its numbers, 0 in the place of what is none."""
    return np.where(finite, column, 0.0) - np.where(finite, column[finite].mean(), 0.0)


class Batches:
    """Cut a stream of blocks into batches of one fixed length, the last one shorter.

    Whatever works on these gives the same result for any block length of the reader.
    """

    def __init__(self, size: int = BATCH) -> None:
        self._size = size
        self._waiting: list[SampleBlock] = []
        self._count = 0

    def add(self, block: SampleBlock) -> Iterator[SampleBlock]:
        """Yield the batches that a block completes; what is left waits for the next call."""
        self._waiting.append(block)
        self._count += len(block)
        while self._count >= self._size:
            self._count -= self._size
            yield joined(list(released(self._waiting, self._size)))

    def rest(self) -> Iterator[SampleBlock]:
        """Yield what has not filled a batch, as one; nothing where nothing is left."""
        if self._count:
            yield joined(self._waiting)
        self._waiting, self._count = [], 0


def batched(blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
    """Yield the same samples in batches."""
    batches = Batches()
    for block in blocks:
        yield from batches.add(block)
    yield from batches.rest()


def released(blocks: list[SampleBlock], count: int) -> Iterator[SampleBlock]:
    """Take the first ``count`` samples out of ``held``."""
    while count > 0 and blocks:
        block = blocks.pop(0)
        if len(block) > count:
            blocks.insert(0, block.part(count, len(block)))
            block = block.part(0, count)
        count -= len(block)
        yield block


def _best_lag(desired: Floats, measured: Floats) -> int:
    """Return the lag of least offset-free mean square error, by Fourier transform."""
    n = len(desired)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(desired, size)
    auto = np.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    if auto[0] <= 0.0:
        return 0
    reach = max(n // 2, 1) - 1
    falling = np.flatnonzero(auto <= 0.0)
    if len(falling):
        reach = min(int(falling[0]) - 1, reach)
    if reach < 1:
        return 0
    cross = np.fft.irfft(np.conj(spectrum) * np.fft.rfft(measured, size), size)
    lags = np.arange(-reach, reach + 1)
    overlap = n - np.abs(lags)
    # sums of either signal over the overlap, from the ends inward
    head_d, head_m = _heads(desired), _heads(measured)
    head_dd, head_mm = _heads(desired * desired), _heads(measured * measured)
    late, early = np.maximum(lags, 0), np.maximum(-lags, 0)
    square = (
        (head_mm[n - early] - head_mm[late])
        + (head_dd[n - late] - head_dd[early])
        - 2.0 * cross[lags]
    ) / overlap
    mean = (
        head_m[n - early] - head_m[late] - head_d[n - late] + head_d[early]
    ) / overlap
    error = square - mean**2
    best = np.flatnonzero(error <= error.min() + 1e-12 * auto[0] / n)
    return int(lags[best[np.argmin(np.abs(lags[best]))]])


def _heads(values: Floats) -> Floats:
    """Return the sums of the first 0, 1, 2 ... values."""
    return np.concatenate([[0.0], np.cumsum(values)])


class Dwells:
    """Takes out the pairs whose desired value has not changed for some seconds.

    Parameters
    ----------
    name : str
        How messages call the log.
    seconds : float
        How long it is held before a pair counts; 0: from the second row on.
    sample_rate : float, optional
        Rows a second (Hz), of a log without times.
    """

    def __init__(self, name: str, seconds: float, sample_rate: float | None) -> None:
        self._name, self._seconds, self._rate = name, seconds, sample_rate
        self.counted = self.read = 0

    def of(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the pairs that count; how they are cut into blocks changes none.

        Raises
        ------
        InputError
            There is no time, or nothing is held so long.
        """
        level, since = math.nan, math.nan
        for block in blocks:
            desired = block.values["desired"]
            if not len(block):
                continue
            if block.time is not None:
                time = block.time
            elif self._rate is not None:
                time = row_numbers(block) / self._rate
            else:
                raise InputError(
                    f"{self._name}: no time is given, and `dwell` depends on it (`time` or `sample_rate` HZ)"
                )
            # a blank is never held
            new = desired != np.concatenate([[level], desired[:-1]])
            begun = np.maximum.accumulate(np.where(new, np.arange(len(block)), -1))
            start = np.where(begun >= 0, time[begun], since)
            dwelling = only(
                block, ~new & (time - start >= self._seconds * (1.0 - SAME))
            )
            level, since = float(desired[-1]), float(start[-1])
            self.read += len(block)
            self.counted += len(dwelling)
            yield dwelling
        if self.read and not self.counted:
            raise InputError(
                f"{self._name}: what is desired is nowhere held for {self._seconds:g} s (`dwell`)"
            )

    def note(self) -> str:
        """Return how many pairs counted."""
        rows = f"{self.counted:,} of {self.read:,} rows"
        return f"{self._name}: {rows} count, at which what is desired has been held for {self._seconds:g} s"
