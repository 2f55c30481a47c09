"""The nouns of a log: columns, blocks of rows, how it is to be read, and the table that a reader makes."""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError, require_positive
from dbo_cli.logs.fence import fenced
from dbo_cli.units import kind_of, quantity, spell, split_header

ROWS_A_BLOCK = 65536
OVERLOAD = 9.9e30
"""Instruments write 9.9E37 and 1E+31, masks 1E+36, for what was not measured."""
NOT_A_TIME = int(np.iinfo(np.int64).min)
"""A stamp that is missing or cannot be read."""
LONGEST_CELL = 200
"""Characters; what is longer, padding counted, is no number, no name and no unit."""
TOO_LONG = f"(more than {LONGEST_CELL} characters)"
"""What stands in the place of a cell that is longer."""

_KINDS = defaultdict(lambda: "text", f="number", i="number", u="number", M="stamp")
"""The kind of a column by NumPy's letter of its type; truth values are no numbers."""

Settings = dict[str, list[str]]
"""What a file states beside its rows, by key: values with their units."""
Fetch = Callable[[int, int], Any]
"""Returns rows from a start to a stop, counted from 0."""


@dataclass(frozen=True)
class Column:
    """A column of a file or of a log.

    Attributes
    ----------
    number
        Counted from 1; 0 until it is in a table.
    name, unit
        As the file gives them; in a log the unit is that behind ``factor``.
    kind
        ``number``, ``stamp`` (a date or a clock time), or ``text`` or ``empty``, which
        cannot be read.
    sample
        The format of a text's stamps, or a cell of text.
    length, fetch
        How many rows it has and what fetches them, where it is no text.
    doubt
        Why its numbers may not be what they are taken for, and what to do.
    factor
        By what its figures are multiplied.
    title
        Its name with its unit, and with what is assumed where nothing states one.
    """

    number: int
    name: str = ""
    unit: str | None = None
    kind: str = "number"
    sample: str = ""
    length: int = 0
    fetch: Fetch = lambda start, stop: ()
    doubt: str = ""
    factor: Fraction = Fraction(1)
    title: str = ""

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
    rows: str | None = None
    skip_bad: bool = False
    resample: float | None = None
    delimiter: str | None = None
    decimal: str | None = None
    skip_lines: int | None = None
    encoding: str | None = None
    clock_offset: float | str | None = None

    def __post_init__(self) -> None:
        """Refuse rates, and numbers of lines, that are none (UsageError)."""
        require_positive(sample_rate=self.sample_rate, resample=self.resample)
        if self.skip_lines is not None and self.skip_lines < 0:
            raise UsageError(f"`skip_lines` {self.skip_lines}: give 0 or more")

    @classmethod
    def of_options(cls, options: Mapping[str, Any]) -> Reading:
        """Return how a log is to be read, by the typed options that have the names of its attributes."""
        names = [attribute.name for attribute in fields(cls)]
        values = {}
        for name in names:
            if options.get(name) is not None:
                values[name] = options[name]
        for name in ("sample_rate", "resample"):
            values[name] = quantity(name, options.get(name), "Hz")
        offset = options.get("clock_offset")
        values["clock_offset"] = quantity("clock_offset", offset, "s", "auto")
        return cls(**values)


def parse_rows(rows: str | None) -> tuple[int, int]:
    """Read ``rows``: the first and the last data row, counted from 1; either may be left out.

    Raises
    ------
    UsageError
        It is no range.
    """
    match = re.fullmatch(
        r"\s*(\d{0,15})\s*:\s*(\d{0,15})\s*", str(rows or ":"), re.ASCII
    )
    first = int(match[1] or 1) if match else 0
    last = int(match[2]) if match and match[2] else sys.maxsize
    if not 1 <= first <= last:
        raise UsageError(
            f"`rows` {rows}: give A:B, data rows counted from 1, both ends included"
        )
    return first, last


@dataclass
class Block:
    """Rows that travel together; a whole log in memory is one block, ``block["voltage"]``.

    Attributes
    ----------
    time
        Seconds, or None where the log has no clock.
    values
        An array by role.
    dt
        Seconds since the sample before: a number where the steps are even, else an
        array; None without a clock.
    """

    time: Floats | None
    values: dict[str, Floats]
    dt: float | Floats | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.values.values()), ()))

    def __getitem__(self, role: str) -> Floats:
        """Return the array of a role."""
        return self.values[role]

    @property
    def step(self) -> float | None:
        """The seconds from row to row; None where they are uneven, or no clock is known."""
        return self.dt if isinstance(self.dt, float) else None

    def part(self, start: int, stop: int) -> Block:
        """Return some of the rows."""
        values = {role: array[start:stop] for role, array in self.values.items()}
        time = None if self.time is None else self.time[start:stop]
        dt = self.dt[start:stop] if isinstance(self.dt, np.ndarray) else self.dt
        return Block(time, values, dt)

    @classmethod
    def joined(cls, blocks: Sequence[Block]) -> Block:
        """Make one block of those of a log."""
        if len(blocks) == 1:
            return blocks[0]
        values = {}
        for role in blocks[0].values:
            values[role] = np.concatenate([block.values[role] for block in blocks])
        times = [block.time for block in blocks if block.time is not None]
        steps = [block.dt for block in blocks if block.dt is not None]
        dt: float | Floats | None = steps[0] if steps else None
        if any(isinstance(step, np.ndarray) or step != dt for step in steps):
            pairs = zip(steps, map(len, blocks), strict=True)
            dt = np.concatenate([np.broadcast_to(step, rows) for step, rows in pairs])
        return cls(np.concatenate(times) if times else None, values, dt)


def bad_cells(array: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which cells are no numbers and no stamps."""
    if array.dtype.kind == "i":
        return np.asarray(array == NOT_A_TIME)
    if len(array) and array.max() < OVERLOAD and array.min() > -OVERLOAD:
        return np.zeros(len(array), dtype=bool)
    return np.asarray(~(np.abs(array) < OVERLOAD))


class Table(AbstractContextManager["Table"]):
    """What a reader makes of a file: columns of named arrays, in memory or handed out by a library.

    Parameters
    ----------
    name
        How messages call the file.
    close
        Closes the file.

    Attributes
    ----------
    columns
        All of its columns.
    settings, decimal
        What it states beside the rows, and the decimal sign of that; the clock of a file
        without a time column is among it.
    guard
        A column that must hold numbers, dates or nothing in every row, even if nothing is
        read of it: rows that begin with something else are no samples.
    hint
        What is appended to a refusal about columns.
    cure
        What helps where rows hold no numbers.
    titles
        Of a frame that was read from a file, the names of its columns there.
    has_found_offset
        Whether a clock offset was found when it was made of two files.
    remarks
        What the user is to be told, without the file's name in front.
    torn
        The rows (from 1) of the last block that have another number of cells.
    block_rows
        Rows of a block.
    doubt
        What is remarked behind the last row.
    find
        Finds what the user names and no column is called; None where there is nothing.
    paths
        What else it finds, where the file can list that.
    """

    decimal: str = "."
    guard: Column | None = None
    hint: str = ""
    cure: str = "`skip_bad` drops such rows"
    has_found_offset: bool = False
    block_rows: int = ROWS_A_BLOCK
    doubt: str = ""

    def __init__(self, name: str, close: Callable[[], object] = lambda: None) -> None:
        self.name = name
        self.close = close
        self.columns: list[Column] = []
        self.settings: Settings = {}
        self.titles: Mapping[str, str] = {}
        self.remarks: list[str] = []
        self.torn: list[int] = []
        self.find: Callable[[str], Column | None] = lambda name: None
        self.paths: list[str] = []

    def add(self, column: Column) -> Column:
        """Append a column; its name holds its unit where none is stated beside it, or one of that kind."""
        number, name, unit = len(self.columns) + 1, column.name, column.unit
        if len(name) > LONGEST_CELL or name == TOO_LONG:
            self.remarks.append(f"column {number}: {TOO_LONG[1:-1]} are no name")
            name = ""
        unit = spell(unit) if unit and len(unit) <= LONGEST_CELL else None
        titled = split_header(name)[1] or unit
        unit, doubt = unit or titled, column.doubt
        if titled != unit and kind_of(titled) == kind_of(unit):
            doubt = f"is in {titled} by its name, in {unit} beside it: type `scale` ROLE=1UNIT/{unit}"
        column = replace(column, number=number, name=name, unit=unit, doubt=doubt)
        self.columns.append(column)
        return column

    def state(self, key: str, value: object, unit: str = "") -> None:
        """Note what the file states; a key may have several values."""
        self.settings.setdefault(key, []).append(f"{value} {unit}".strip())

    def require_numbers(self, contents: Iterable[str]) -> Table:
        """Return the table; refuse (InputError) one without columns of numbers, whose contents are these."""
        if any(column.kind == "number" for column in self.columns):
            return self
        text = ", ".join(contents) or "nothing"
        raise InputError(
            f"{self.name}: no columns of numbers: it has {text[:300]}{self.hint}"
        )

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns in blocks, one array a column.

        Numbers are float64, NaN for other cells; stamps are int64 nanoseconds
        since 1970 or since midnight, ``NOT_A_TIME`` for other cells.

        Raises
        ------
        InputError
            The columns are of unequal length, or the library fails.
        """
        lengths = [column.length for column in columns]
        if len(set(lengths)) > 1:
            pairs = zip(columns, lengths, strict=True)
            text = ", ".join(f"{column.label} {rows:,} rows" for column, rows in pairs)
            raise InputError(f"{self.name}: the columns are of unequal length: {text}")
        rows = max(lengths, default=0)
        for start in range(0, rows, self.block_rows):
            stop = min(rows, start + self.block_rows)
            yield [self._rows(column, start, stop) for column in columns]
        if self.doubt:
            self.remarks.append(self.doubt)

    def _rows(self, column: Column, start: int, stop: int) -> NDArray[Any]:
        """Read rows of one column as float64, or dates as int64 nanoseconds."""
        with fenced(self.name, column.label):
            stored = np.asarray(column.fetch(start, stop))
            if stored.dtype.kind == "M":
                stored = stored.astype("datetime64[ns]").astype(np.int64)
            elif column.kind == "number":
                stored = np.ascontiguousarray(stored, dtype=np.float64)
        if len(stored) != stop - start:
            raise InputError(f"{self.name}: {column.label} ends early: damaged?")
        return stored

    def where(self, row: int, column: Column, value: object) -> str:
        """Say where a row (from 1) of the last block is, and which value a column has there."""
        return f"{self.name}: row {row}: {column.label} is {value}"

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


def columns_in(name: str, stored: Any) -> Iterator[Column]:
    """Take an array or a dataset apart: a vector, a matrix whose longer axis is time, or records.

    There are no parts of what holds neither numbers, nor dates, nor a row of texts.
    """
    kind, shape = stored.dtype, stored.shape
    if kind.names is not None and len(shape) == 1:
        for label in kind.names:
            if not kind[label].shape:
                yield column_of(label, kind[label], shape[0], _field_of(stored, label))
    elif len(shape) == 1:
        yield column_of(name, kind, shape[0], rows_of(stored))
    elif len(shape) == 2 and _KINDS[kind.kind] != "text":
        along = 0 if shape[0] >= shape[1] else 1
        width = shape[1 - along]
        for number in range(width):
            label = f"{name}[{number + 1}]" if name and width > 1 else name
            fetch = _column_of(stored, along, number)
            yield column_of(label, kind, shape[along], fetch)


def column_of(name: str, kind: Any, rows: int, fetch: Fetch) -> Column:
    """Return a column of so many rows of a type of NumPy's."""
    return Column(0, name, kind=_KINDS[kind.kind], length=rows, fetch=fetch)


def rows_of(stored: Any) -> Fetch:
    """Return what fetches rows of an array."""
    return lambda start, stop: stored[start:stop]


def _field_of(stored: Any, label: str) -> Fetch:
    return lambda start, stop: stored[start:stop][label]


def _column_of(stored: Any, along: int, number: int) -> Fetch:
    if along == 0:
        return lambda start, stop: stored[start:stop, number]
    return lambda start, stop: stored[number, start:stop]
