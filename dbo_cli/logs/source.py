"""The nouns of a log: its columns, how it is to be read, its blocks, and what readers hand over."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.units import split_header

FloatArray = NDArray[np.float64]
BLOCK_ROWS = 65536
NOT_A_TIME = int(np.iinfo(np.int64).min)
"""A stamp that is missing or cannot be read."""


@dataclass(frozen=True)
class Column:
    """A column: its number (from 1), and the name and the unit that the file gives it.

    ``kind`` is ``number``, ``stamp`` (a date or a clock time), or ``text`` or ``empty``,
    which cannot be read.
    """

    number: int
    name: str = ""
    unit: str | None = None
    kind: str = "number"

    @property
    def label(self) -> str:
        """How messages call it."""
        return f"column '{self.name}'" if self.name else f"column {self.number}"

    @property
    def quantity(self) -> str:
        """The name without its unit, and without the path above it."""
        name = split_header(self.name.rsplit("::", 1)[-1])[0]
        return name.strip(" /_").rsplit("/", 1)[-1].strip()


@dataclass(frozen=True)
class Reading:
    """How a log is to be read, as far as the user says so; None: it is found out.

    Attributes
    ----------
    time_unit
        The unit of the time column (``ms``, ``10us``).
    sample_rate
        Samples a second (Hz), instead of a time column.
    scale
        By role, a factor (``20``) or a factor with units (``10um/V``).
    rows
        First and last data row, counted from 1, both included: ``"100:2000"``.
    skip_bad
        Whether to leave out rows that hold no numbers.
    resample
        The rate (Hz) to interpolate to.
    delimiter, decimal, skip_lines, encoding
        How a text is written.
    clock_offset
        Seconds, or ``auto``: what is added to the clock of a second file.
    """

    time_unit: str | None = None
    sample_rate: float | None = None
    scale: Mapping[str, str | float] = field(default_factory=dict)
    rows: str | tuple[int, int | None] | None = None
    skip_bad: bool = False
    resample: float | None = None
    delimiter: str | None = None
    decimal: str | None = None
    skip_lines: int | None = None
    encoding: str | None = None
    clock_offset: float | str | None = None


@dataclass
class Block:
    """Rows that travel together.

    Attributes
    ----------
    time
        Seconds, or None where the log has no clock.
    values
        An array by role.
    first_row
        The number of the first row among the log's data rows, from 1.
    dt
        Seconds since the sample before: a number where the steps are even, else an
        array; None without a clock.
    """

    time: FloatArray | None
    values: dict[str, FloatArray]
    first_row: int
    dt: float | FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.values.values()), ()))


@dataclass
class Table:
    """A whole log in memory: ``table["voltage"]``, and its clock as in a Block.

    ``origin`` is what time 0 is in seconds since 1970, where the log states it.
    """

    time: FloatArray | None
    values: dict[str, FloatArray]
    dt: float | FloatArray | None = None
    origin: float | None = None

    def __getitem__(self, role: str) -> FloatArray:
        """Return the array of a role."""
        return self.values[role]

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(next(iter(self.values.values()), ()))


class Source:
    """What a reader makes of a file: columns, and their arrays in blocks.

    Attributes
    ----------
    name
        How messages call the file.
    columns
        All of its columns.
    rate
        The sample rate (Hz) that the file states, or None.
    rate_problem, rate_remarks
        Why a stated rate cannot be used, and what was assumed for it; told only where
        the rate is needed.
    start
        The time (s) of the first row where the rate is used.
    hint
        What is appended to a refusal about columns (`` (or run.h5::/run1)``).
    remarks
        What the user is to be told, without the file's name in front.
    """

    name: str
    columns: list[Column]
    rate: float | None = None
    rate_problem: str = ""
    rate_remarks: Sequence[str] = ()
    start: float = 0.0
    hint: str = ""
    remarks: list[str]

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns in blocks, one array a column.

        Numbers are float64, with NaN for what is none; stamps are int64 nanoseconds
        since 1970 or since midnight, with ``NOT_A_TIME`` for what is none.
        """
        raise NotImplementedError

    def where(self, row: int, column: Column) -> str:
        """Say where a row (from 1) of the last block is, and what stands in a column of it."""
        raise NotImplementedError

    def find(self, name: str) -> Column | None:
        """Find what the user names and no column is called; None where there is nothing."""
        return None

    def close(self) -> None:
        """Close the file."""


Fetch = Callable[[int, int], Any]


class ArraySource(Source):
    """Columns that a library hands out by rows.

    Parameters
    ----------
    fetch
        For each column, what returns its rows start to stop (from 0, stop not
        included).
    lengths
        The number of rows of each column.
    close
        Called at the end.
    """

    def __init__(
        self,
        name: str,
        columns: Sequence[Column],
        fetch: Sequence[Fetch],
        lengths: Sequence[int],
        rate: float | None = None,
        start: float = 0.0,
        remarks: Sequence[str] = (),
        close: Callable[[], object] | None = None,
    ) -> None:
        self.name = name
        self.columns = list(columns)
        self.rate = rate
        self.start = start
        self.remarks = list(remarks)
        self._fetch = fetch
        self._lengths = lengths
        self._close = close
        self._arrays: dict[int, NDArray[Any]] = {}
        self._first = 1

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Source``.

        Raises
        ------
        InputError
            The columns are of unequal length, or the library fails.
        """
        lengths = [self._lengths[column.number - 1] for column in chosen]
        if len(set(lengths)) > 1:
            pairs = zip(chosen, lengths, strict=True)
            listed = ", ".join(f"{column.label} {rows}" for column, rows in pairs)
            raise InputError(
                f"{self.name}: the columns are of unequal length: {listed}"
            )
        end = lengths[0] if lengths else 0
        for start in range(0, end, BLOCK_ROWS):
            stop = min(end, start + BLOCK_ROWS)
            self._first = start + 1
            self._arrays = {}
            for column in chosen:
                self._arrays[column.number] = self._read(column, start, stop)
            yield [self._arrays[column.number] for column in chosen]

    def _read(self, column: Column, start: int, stop: int) -> NDArray[Any]:
        """Read rows of one column as float64, or dates as int64 nanoseconds."""
        try:
            stored = np.asarray(self._fetch[column.number - 1](start, stop))
            if stored.dtype.kind == "M":
                return stored.astype("datetime64[ns]").astype(np.int64)
            if column.kind == "stamp":
                return stored.astype(np.int64)
            values = np.ascontiguousarray(stored, dtype=np.float64)
        except (OSError, ValueError, TypeError, RuntimeError) as problem:
            reason = str(problem).splitlines()[0] if str(problem) else "no reason given"
            raise InputError(
                f"{self.name}: {column.label} cannot be read: {reason}"
            ) from None
        if len(values) != stop - start:
            raise InputError(f"{self.name}: {column.label} ends early: damaged?")
        return values

    def where(self, row: int, column: Column) -> str:
        """Say where a row of the last block is, and what stands in a column of it."""
        value = self._arrays[column.number][row - self._first]
        return f"{self.name}: row {row}: {column.label} is {value}"

    def close(self) -> None:
        """Close the file."""
        if self._close is not None:
            self._close()
