"""What every format gives: a table of columns, and blocks of samples that know their place in the file."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Places = range | NDArray[np.int64]

TIME = "the clock"  # the time column's place among the roles; no quantity of a model is called so


@dataclass(frozen=True)
class ColumnInfo:
    """One column of a log.

    ``name`` is the header as written (or the number where there is none), ``quantity`` the header without its
    unit, ``unit`` the normalised unit or None (units are never guessed), ``number`` counts from 1.
    ``written`` is ``numbers``, or how a column of time stamps is written: ``stamp``, ``clock``, ``minutes``,
    ``date`` (logs.text.time_stamps); such columns are read as seconds. Rows without a value in a column that
    ``may_be_blank`` are left out.
    """

    name: str
    unit: str | None
    quantity: str
    number: int
    written: str = "numbers"
    may_be_blank: bool = False


# What instruments send in place of a value that is beyond their range (9.9E37) or none (9.91E37): SCPI-99,
# volume 1, 7.2.1. Their 32-bit numbers are a little off.
_OVERFLOW_FROM, _OVERFLOW_TO = 9.899e37, 9.911e37


def is_overflow(value: float) -> bool:
    """Return whether a number is what an instrument sends in place of a value."""
    return _OVERFLOW_FROM < abs(value) < _OVERFLOW_TO


def are_measured(values: FloatArray) -> NDArray[np.bool_]:
    """Tell which numbers are finite and no instrument's overflow."""
    size = np.abs(values)
    usual: NDArray[np.bool_] = size < _OVERFLOW_FROM  # False for NaN and infinity as well
    if not usual.all():
        usual = usual | ((size >= _OVERFLOW_TO) & np.isfinite(values))
    return usual


@dataclass(frozen=True)
class SampleBlock:
    """Consecutive samples of a log.

    ``rows`` are data row numbers from 1 (a gap where bad rows were dropped), ``lines`` the line numbers in
    the file (None for formats that have none); ``time`` is in seconds, None where it is not known or not yet
    separated from the other columns; ``values`` holds one float64 array of the same length a role.
    """

    rows: Places
    lines: Places | None
    time: FloatArray | None
    values: Mapping[str, FloatArray]

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.rows)

    def part(self, start: int, stop: int) -> SampleBlock:
        """Return samples ``start`` to ``stop`` (from 0, ``stop`` not included) as a block of views."""
        if start <= 0 and stop >= len(self):
            return self
        return SampleBlock(
            self.rows[start:stop],
            None if self.lines is None else self.lines[start:stop],
            None if self.time is None else self.time[start:stop],
            {role: values[start:stop] for role, values in self.values.items()},
        )

    def within(self, rows: tuple[int, int | None]) -> SampleBlock:
        """Return the samples whose row numbers lie from the first to the last of ``rows``, both included."""
        stop = len(self) if rows[1] is None else bisect_right(self.rows, rows[1])
        start = bisect_left(self.rows, rows[0])
        return self.part(start, max(start, stop))

    def place(self, name: str, index: int) -> str:
        """Return where a sample stands: file and line, or row where there are no lines."""
        if self.lines is not None:
            return f"{name}:{int(self.lines[index])}"
        return f"{name}: row {int(self.rows[index])}"


def joined(parts: Sequence[SampleBlock]) -> SampleBlock:
    """Put consecutive blocks of one log together."""
    if len(parts) == 1:
        return parts[0]
    lines = [part.lines for part in parts if part.lines is not None]
    times = [part.time for part in parts if part.time is not None]
    return SampleBlock(
        join_places([part.rows for part in parts]),
        join_places(lines) if lines else None,
        np.concatenate(times) if times else None,
        {role: np.concatenate([part.values[role] for part in parts]) for role in parts[0].values},
    )


def join_places(parts: Sequence[Places]) -> Places:
    """Concatenate runs of row or line numbers; a range where they are gapless."""
    if not parts:
        return range(1, 1)
    first = int(parts[0][0]) if len(parts[0]) else 1
    following = first
    for part in parts:
        if not isinstance(part, range) or part.step != 1 or (len(part) and part[0] != following):
            return np.concatenate([np.asarray(part, dtype=np.int64) for part in parts])
        following += len(part)
    return range(first, following)


def dropped_note(first: str, count: int) -> str:
    """Return the note on rows that ``skip_bad`` dropped; ``first`` is the first one's message."""
    more = f" and {count - 1} more" if count > 1 else ""
    return f"{first}{more}: {count} row{'s' if count > 1 else ''} dropped"


class Table:
    """A log in some format: its columns at once, its rows in blocks, as the options that opened it ask."""

    place: str
    columns: list[ColumnInfo]
    notes: list[str]
    found_time: Any = None  # what ``time_column.find_time_column`` found, where it looked already

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Find the sample rate (Hz) that the file states for these columns, and the first row's time (s)."""
        raise NotImplementedError

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        raise NotImplementedError

    def blocks(self, picks: Mapping[str, ColumnInfo]) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks."""
        raise NotImplementedError

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for; a file can still be hashed as a whole."""
        return None

    def close(self) -> None:
        """Close the file."""
