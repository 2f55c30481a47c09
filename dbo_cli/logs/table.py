"""The nouns of a log: columns, blocks of rows, how it is to be read, and the table that a reader makes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import UsageError
from dbo_cli.units import quantity, spell, split_header

ROWS_A_BLOCK = 65536
OVERLOAD = 9.9e30
"""Instruments write 9.9E37 and 1E+31, masks 1E+36, for what was not measured."""
NOT_A_TIME = int(np.iinfo(np.int64).min)
"""A stamp that is missing or cannot be read."""
LONGEST_CELL = 200
"""Characters; what is longer, padding counted, is no number, no name and no unit."""
TOO_LONG = f"(more than {LONGEST_CELL} characters)"
"""What stands in the place of a cell that is longer."""

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

    @classmethod
    def typed(cls, **options: Any) -> Reading:
        """Return how a log is to be read, of options whose figures are numbers or texts with a unit."""
        for name in ("sample_rate", "resample"):
            options[name] = quantity(name, options.get(name), "Hz")
        offset = options.get("clock_offset")
        options["clock_offset"] = quantity("clock_offset", offset, "s", "auto")
        return cls(**options)


def parse_rows(rows: str | None) -> tuple[int, int]:
    """Read ``rows``: the first and the last data row, counted from 1; either may be left out.

    Raises
    ------
    UsageError
        It is no range.
    """
    match = re.fullmatch(r"\s*(\d{0,15})\s*:\s*(\d{0,15})\s*", rows or ":", re.ASCII)
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
    return np.asarray(~(np.abs(array) < OVERLOAD))


class Table:
    """What a reader makes of a file: columns, and their arrays in blocks.

    Attributes
    ----------
    name
        How messages call the file.
    columns
        All of its columns.
    settings, decimal
        What it states beside the rows, and the decimal sign of that; the clock of a file
        without a time column is among it.
    guard
        A column that must hold numbers or stamps in every row, even if nothing is read
        of it: rows that begin with something else are no samples.
    hint
        What is appended to a refusal about columns.
    cure
        What helps where rows hold no numbers.
    has_found_offset
        Whether a clock offset was found when it was made of two files.
    remarks
        What the user is to be told, without the file's name in front.
    torn
        The rows (from 1) of the last block that have another number of cells.
    """

    decimal: str = "."
    guard: Column | None = None
    hint: str = ""
    cure: str = "`skip_bad` drops such rows"
    has_found_offset: bool = False

    def __init__(self, name: str) -> None:
        self.name = name
        self.columns: list[Column] = []
        self.settings: Settings = {}
        self.remarks: list[str] = []
        self.torn: list[int] = []

    def add(self, column: Column) -> Column:
        """Append a column; its name holds its unit where none is stated beside it."""
        number, name, unit = len(self.columns) + 1, column.name, column.unit
        if len(name) > LONGEST_CELL or name == TOO_LONG:
            self.remarks.append(f"column {number}: {TOO_LONG[1:-1]} are no name")
            name = ""
        unit = spell(unit) if unit and len(unit) <= LONGEST_CELL else None
        unit = unit or split_header(name)[1]
        column = replace(column, number=number, name=name, unit=unit)
        self.columns.append(column)
        return column

    def state(self, key: str, value: object, unit: str = "") -> None:
        """Note what the file states; a key may have several values."""
        self.settings.setdefault(key, []).append(f"{value} {unit}".strip())

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns in blocks, one array a column.

        Numbers are float64, NaN for other cells; stamps are int64 nanoseconds
        since 1970 or since midnight, ``NOT_A_TIME`` for other cells.
        """
        raise NotImplementedError

    def where(self, row: int, column: Column, value: object) -> str:
        """Say where a row (from 1) of the last block is, and which value a column has there."""
        return f"{self.name}: row {row}: {column.label} is {value}"

    def find(self, name: str) -> Column | None:
        """Find what the user names and no column is called; None where there is nothing."""
        return None

    def close(self) -> None:
        """Close the file."""

    def __enter__(self) -> Table:
        """Use the table as a context manager."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()
