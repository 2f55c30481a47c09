"""What every format gives: a table of columns, and blocks of samples that know their place in the file.

Behind them the clock: what is odd about time stamps, and even sampling only where it is
asked for.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.interpolation.smooth import AFTER, WINDOW, interpolated

FloatArray = NDArray[np.float64]
Places = range | NDArray[np.int64]

# the time column's place among the roles; no quantity of a model is called so
TIME = "the clock"


@dataclass(frozen=True)
class Column:
    """One column of a log, or of an output.

    Attributes
    ----------
    name
        The header as written; the number where a log has none.
    unit
        The normalised unit, or None: units are never guessed.
    quantity
        What it measures: the header without its unit. In an output for HDF5 alone, the
        name where it is empty.
    number
        Its place in a log, from 1.
    written
        ``numbers``, or how a column of time stamps is written: ``stamp``, ``clock``,
        ``minutes``, ``date``; such columns are read as seconds.
    may_be_blank
        Rows of a log without a value here are left out; an output has an empty cell
        where it is NaN (HDF5: NaN).
    """

    name: str
    unit: str | None = None
    quantity: str = ""
    number: int = 0
    written: str = "numbers"
    may_be_blank: bool = False


# What instruments send in place of a value that is beyond their range (9.9E37) or none
# (9.91E37): SCPI-99, volume 1, 7.2.1. Their 32-bit numbers are a little off.
_OVERFLOW_FROM, _OVERFLOW_TO = 9.899e37, 9.911e37


def is_overflow(value: float) -> bool:
    """Return whether a number is what an instrument sends in place of a value."""
    return _OVERFLOW_FROM < abs(value) < _OVERFLOW_TO


def are_measured(values: FloatArray) -> NDArray[np.bool_]:
    """Tell which numbers are finite and no instrument's overflow."""
    size = np.abs(values)
    # False for NaN and infinity as well
    usual: NDArray[np.bool_] = size < _OVERFLOW_FROM
    if not usual.all():
        usual = usual | ((size >= _OVERFLOW_TO) & np.isfinite(values))
    return usual


@dataclass(frozen=True)
class SampleBlock:
    """Samples of a log in their order; rows may be missing between them.

    ``rows`` are data row numbers from 1, with gaps where bad rows were dropped:
    ``rows[index]`` is the row of a sample, and ``rows[0] + index`` need not be.
    ``lines`` are the line numbers in the file (None for formats that have none);
    ``time`` is in seconds, None where it is not known or not yet separated from the
    other columns; ``values`` holds one float64 array of the same length a role.
    """

    rows: Places
    lines: Places | None
    time: FloatArray | None
    values: Mapping[str, FloatArray]

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.rows)

    @property
    def before_move(self) -> bool:
        """Whether its rows stand before row 1: a drive's way to the move, not the move itself."""
        return bool(self.rows[0] < 1)

    def part(self, start: int, stop: int) -> SampleBlock:
        """Return samples ``start`` to ``stop`` (from 0, ``stop`` not included) as a block of views."""
        if start <= 0 and stop >= len(self):
            return self
        lines = self.lines
        time = self.time
        if lines is not None:
            lines = lines[start:stop]
        if time is not None:
            time = time[start:stop]
        values = {role: array[start:stop] for role, array in self.values.items()}
        return SampleBlock(self.rows[start:stop], lines, time, values)

    def chosen(self, mask: NDArray[np.bool_]) -> SampleBlock:
        """Return the samples that are marked."""
        lines = self.lines
        time = self.time
        if lines is not None:
            lines = np.asarray(lines)[mask]
        if time is not None:
            time = time[mask]
        values = {role: array[mask] for role, array in self.values.items()}
        return SampleBlock(np.asarray(self.rows)[mask], lines, time, values)

    def within(self, rows: tuple[int, int | None]) -> SampleBlock:
        """Return the samples whose row numbers lie from the first to the last of ``rows``, both included."""
        first, last = rows
        start = bisect_left(self.rows, first)
        stop = len(self)
        if last is not None:
            stop = bisect_right(self.rows, last)
        return self.part(start, max(start, stop))

    def place(self, name: str, index: int) -> str:
        """Return where a sample stands: file and line, or row where there are no lines."""
        if self.lines is None:
            return f"{name}: {self.where(index)}"
        return f"{name}:{int(self.lines[index])}"

    def where(self, index: int) -> str:
        """Return where in its file a sample stands: ``line 5``, or ``row 4`` where there are no lines."""
        if self.lines is None:
            return f"row {int(self.rows[index])}"
        return f"line {int(self.lines[index])}"


def joined(parts: Sequence[SampleBlock]) -> SampleBlock:
    """Put consecutive blocks of one log together."""
    if len(parts) == 1:
        return parts[0]
    lines = [part.lines for part in parts if part.lines is not None]
    times = [part.time for part in parts if part.time is not None]
    values = {}
    for role in parts[0].values:
        values[role] = np.concatenate([part.values[role] for part in parts])
    return SampleBlock(
        join_places([part.rows for part in parts]),
        join_places(lines) if lines else None,
        np.concatenate(times) if times else None,
        values,
    )


def join_places(parts: Sequence[Places]) -> Places:
    """Concatenate runs of row or line numbers; a range where they are gapless."""
    if not parts:
        return range(1, 1)
    first = int(parts[0][0]) if len(parts[0]) else 1
    following = first
    for part in parts:
        if (
            not isinstance(part, range)
            or part.step != 1
            or (len(part) and part[0] != following)
        ):
            return np.concatenate([np.asarray(part, dtype=np.int64) for part in parts])
        following += len(part)
    return range(first, following)


MOST_NAMED = 20  # rows that are named one by one; all are counted


class BadRow(NamedTuple):
    """A row that holds no number: its data row number (from 1), where that is for messages, and why."""

    row: int
    where: str
    problem: str

    def __str__(self) -> str:
        """Return place and problem."""
        return f"{self.where}: {self.problem}"


@dataclass
class DroppedRows:
    """Rows that were left out: how many, and the first ones with what is wrong there."""

    count: int = 0
    named: list[BadRow] = field(default_factory=list)

    def add(self, bad: BadRow) -> None:
        """Add a row."""
        if len(self.named) < MOST_NAMED:
            self.named.append(bad)
        self.count += 1

    def extend(self, later: DroppedRows) -> None:
        """Add what was left out elsewhere."""
        self.named = (self.named + later.named)[:MOST_NAMED]
        self.count += later.count

    def note(self) -> str:
        """Return in one line what was left out."""
        if self.count == 1:
            return f"{self.named[0]}: 1 row dropped"
        return f"{self.named[0]} and {self.count - 1} more: {self.count} rows dropped"


class Table:
    """A log in some format: its columns at once, its rows in blocks, as the options that opened it ask."""

    place: str
    columns: list[Column]
    notes: list[str]
    dropped: DroppedRows  # what ``skip_bad`` left out; complete after the last block
    # lines that were passed over in silence and may have been rows; likewise
    doubtful: list[str]
    others: Sequence[str] = ()  # the addresses of further files that were joined
    # what may spoil a result; complete after the last block
    warnings: Sequence[str] = ()
    # of ``clock.find_clock``, where the table looked for it already
    ready_clock: Any = None

    def even_clock(self, columns: Collection[Column]) -> tuple[float | None, float]:
        """Find the sample rate (Hz) that the file states for these columns, and the first row's time (s)."""
        raise NotImplementedError

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        raise NotImplementedError

    def blocks(self, picks: Mapping[str, Column]) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks."""
        raise NotImplementedError

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for; a file can still be hashed as a whole."""
        return None

    def close(self) -> None:
        """Close the file."""


# ---- the clock

# time stamps from which the usual step is taken, whatever the block size
_LEARNING = 1000
# usual steps; where more lie between two stamps, at least one sample is missing
GAP_STEPS = 1.5
# two clocks may differ by this fraction: chosen, ten times what quartz is off by
SAME_RATE = 1e-3
# of a step; what the clocks of operating systems jitter by, and no model notices
JITTER = 0.05


@dataclass
class Finding:
    """How often something odd happened, and where first."""

    count: int = 0
    where: str = ""
    before: float = 0.0
    after: float = 0.0

    def add(
        self,
        block: SampleBlock,
        at: NDArray[np.intp],
        before: FloatArray,
        after: FloatArray,
    ) -> None:
        """Count the places ``at`` (indices into the block)."""
        if len(at) and not self.count:
            index = int(at[0])
            self.where = block.where(index)
            self.before = float(before[index])
            self.after = float(after[index])
        self.count += len(at)


def median_step(steps: FloatArray) -> float:
    """Return the median of time steps; ``np.median`` would load ``numpy.ma``, 8 ms of every start."""
    ordered = np.sort(steps)
    half = len(ordered) // 2
    if len(ordered) % 2:
        return float(ordered[half])
    return float(0.5 * (ordered[half - 1] + ordered[half]))


@dataclass
class TimeCheck:
    """Watches time stamps block by block and notes what is odd about them, in constant memory.

    A clock that goes back by one of its ``periods`` (s) is a counter that wraps, and
    refused (InputError). The usual step (``step``, s; infinite where the clock stands)
    is the median of the first thousand, so that the verdict does not depend on the
    block size.  Feed every block, then ask for ``notes()``; only then are ``first`` and
    ``last``, the stamps at both ends, known.
    """

    place: str
    periods: tuple[float, ...] = ()
    step: float = 0.0
    backward: Finding = field(default_factory=Finding)
    restart: Finding = field(default_factory=Finding)
    repeat: Finding = field(default_factory=Finding)
    gap: Finding = field(default_factory=Finding)
    narrowest: float = np.inf
    widest: float = 0.0
    _kept: list[tuple[SampleBlock, FloatArray]] = field(default_factory=list)
    rows: int = 0
    last: float | None = None
    first: float = 0.0

    @property
    def is_even(self) -> bool:
        """Whether no step is far from the usual one, gaps aside."""
        return self.widest - self.narrowest <= JITTER * self.step

    def rate(self) -> float | None:
        """Return samples a second (Hz) where every step is about the usual one, else None."""
        self._learn()
        odd = (
            self.restart.count
            + self.backward.count
            + self.repeat.count
            + self.gap.count
        )
        if odd or self.rows < 2 or self.last is None or not self.is_even:
            return None
        return (self.rows - 1) / (self.last - self.first)

    def feed(self, block: SampleBlock) -> None:
        """Look at the time stamps (s) of one block."""
        if block.time is None or not len(block.time):
            return
        self.rows += len(block.time)
        if self.step == 0.0:
            self._kept.append((block, block.time))
            if self.rows >= _LEARNING:
                self._learn()
        else:
            self._judge(block, block.time)

    def notes(self) -> list[str]:
        """Return what was found, one line a finding, with the first place of each."""
        self._learn()
        notes = []
        for finding, text in (
            (self.restart, "the clock starts again at {place} ({jump})"),
            (self.backward, "time goes backwards at {place} ({jump})"),
            (self.repeat, "the time stamp {after} s repeats at {place}"),
            (self.gap, "a gap at {place} ({jump}, usual step {step:.4g} s)"),
        ):
            if finding.count:
                after = _stamp(finding.after)
                jump = f"from {_stamp(finding.before)} s to {after} s"
                text = text.format(
                    place=finding.where, jump=jump, after=after, step=self.step
                )
                if finding.count > 1:
                    text = f"{text}, and {finding.count - 1} more"
                notes.append(f"{self.place}: {text}")
        if not self.is_even and self.step > 0.0 and self.widest > 0.0:
            notes.append(
                f"{self.place}: time steps vary from {self.narrowest:.4g} s to {self.widest:.4g} s "
                f"(usual step {self.step:.4g} s)"
            )
        return notes

    def _learn(self) -> None:
        if not self._kept:
            return
        kept = self._kept
        self._kept = []
        steps = np.diff(np.concatenate([time for _, time in kept])[:_LEARNING])
        forward = steps[steps > 0.0]
        self.step = np.inf
        if len(forward):
            self.step = median_step(forward)
        for block, time in kept:
            self._judge(block, time)

    def _judge(self, block: SampleBlock, time: FloatArray) -> None:
        if self.last is None:
            self.first = self.last = float(time[0])
            block = block.part(1, len(time))
            time = time[1:]
            if not len(time):
                return
        before = np.concatenate([[self.last], time[:-1]])
        self.last = float(time[-1])
        steps = time - before
        usual = steps
        if steps.min() <= 0.0 or steps.max() > GAP_STEPS * self.step:
            begins = (np.abs(time - self.first) <= 2.0 * self.step) & (
                -steps > 2.0 * self.step
            )
            gap = steps > GAP_STEPS * self.step
            forward = not self.backward.count
            for finding, which in (
                (self.restart, (steps < 0.0) & begins),
                (self.backward, (steps < 0.0) & ~begins),
                (self.repeat, steps == 0.0),
                (self.gap, gap),
            ):
                finding.add(block, np.flatnonzero(which), before, time)
            if forward and self.backward.count:
                self._refuse_wrap()
            usual = steps[(steps > 0.0) & ~gap]
        if len(usual):
            self.narrowest = min(self.narrowest, float(usual.min()))
            self.widest = max(self.widest, float(usual.max()))

    def _refuse_wrap(self) -> None:
        """Refuse a clock that is a counter which began anew at the end of its range (InputError)."""
        found = self.backward
        for period in self.periods:
            if (
                abs(found.before - found.after + self.step - period)
                <= self.step
                <= period / 16.0
            ):
                raise InputError(
                    f"{self.place}: the time begins anew after {period:.10g} s at {found.where} (from "
                    f"{_stamp(found.before)} s to {_stamp(found.after)} s): its counter wraps "
                    "(`sample_rate` HZ gives the time instead)"
                )


def _stamp(time: float) -> str:
    """Write a time stamp (s); those that count from 1970 need more digits to differ."""
    if 1e6 <= abs(time) < 1e15:
        return f"{time:.3f}"
    return f"{time:.6g}"


def even_step(time: FloatArray) -> float | None:
    """Return the common step (s) of evenly sampled time stamps, or None where they are not even.

    Stamps count as even when none is further than 5 % of a step from the straight line
    through the first and the last, or, where the log has too few digits for that, when
    rounding to those digits explains the distance.
    """
    if len(time) < 2:
        return None
    step = float(time[-1] - time[0]) / (len(time) - 1)
    if not step > 0.0:
        return None
    away = float(np.abs(time - (time[0] + step * np.arange(len(time)))).max())
    if away <= JITTER * step:
        return step
    rounding = 1e-9 * max(1.0, float(np.abs(time).max()))
    for digits in range(0, 10):
        if np.abs(time - np.round(time, digits)).max() > rounding:
            continue
        last_digit = 10.0**-digits
        if away <= 1.01 * last_digit and last_digit <= step / 2.0:
            return step
        return None
    return None


def require_even(place: str, time: FloatArray, why: str) -> float:
    """Return the common step (s), or refuse with the remedy.

    Raises
    ------
    InputError
        The stamps are not evenly spaced.
    """
    step = even_step(time)
    if step is None:
        odd = "the samples are not evenly spaced in time"
        raise InputError(f"{place}: {odd}, and {why} (`resample` HZ interpolates)")
    return step


_NEW_ROWS = 1 << 16  # made at a time; chosen, half a megabyte a column
# more, and a rate or a time stamp is wrong
_MOST_NEW_ROWS, _MOST_FACTOR = 20_000_000, 100


def resampled(
    place: str, blocks: Iterator[SampleBlock], rate: float
) -> Iterator[SampleBlock]:
    """Interpolate blocks to ``rate`` (Hz), from the first time stamp to the last.

    The samples stand at first + k/rate and are made of their six neighbours
    (``interpolation.smooth``), so that the result does not depend on the block size.
    ``rows`` of the new blocks count the new samples; their ``lines`` are None.

    Raises
    ------
    InputError
        There is no time, or it stands still or goes backwards, at the line named.
    """
    start = None
    carried: list[SampleBlock] = []
    done = read = 0
    filled: Iterator[SampleBlock] = filter(len, blocks)
    for block in itertools.chain(filled, [None]):
        parts = carried
        if block is not None:
            parts = [*carried, block]
            read += len(block)
        if not parts:
            return
        piece = joined(parts)
        if piece.time is None:
            remedy = "`time` COLUMN or `sample_rate` HZ"
            raise InputError(f"{place}: there is no time to resample along ({remedy})")
        _require_advance(place, piece, piece.time)
        if start is None:
            start = float(piece.time[0])
        carried = [piece.part(max(len(piece) - _KNOWN_BEFORE, 0), len(piece))]
        known = len(piece)  # samples with enough behind them
        if block is not None:
            known -= AFTER
            if len(piece) < _KNOWN_BEFORE:
                continue
        seconds = float(piece.time[known - 1]) - start
        reached = int(np.floor(seconds * rate * (1.0 + 1e-12))) + 1
        if reached > _MOST_NEW_ROWS + _MOST_FACTOR * read:
            raise InputError(
                f"{place}: `resample` {rate:g} makes {reached:,} rows of {read:,}: give a lower rate"
            )
        for first in range(done, reached, _NEW_ROWS):
            rows = range(first, min(reached, first + _NEW_ROWS))
            yield _interpolated_at(piece, rows, start + np.array(rows) / rate)
        done = max(done, reached)


def _interpolated_at(piece: SampleBlock, rows: range, time: FloatArray) -> SampleBlock:
    """Return new rows (counted from 0) of a piece, interpolated to their times (s)."""
    assert piece.time is not None
    values = {}
    for role, signal in piece.values.items():
        values[role], _ = interpolated(piece.time, signal, time)
    return SampleBlock(range(rows.start + 1, rows.stop + 1), None, time, values)


_KNOWN_BEFORE = 2 * WINDOW
"""Samples that are kept from block to block: those that any new row between the last ones is made of."""


def _require_advance(place: str, piece: SampleBlock, time: FloatArray) -> None:
    """Refuse time that stands still or goes backwards (InputError)."""
    stuck = np.flatnonzero(np.diff(time) <= 0.0)
    if len(stuck):
        index = int(stuck[0]) + 1
        jump = f"from {_stamp(time[index - 1])} s to {_stamp(time[index])} s"
        cannot = "so it cannot be resampled (cut the log with `rows` A:B)"
        raise InputError(
            f"{place}: time does not advance at {piece.where(index)} ({jump}), {cannot}"
        )
