"""A log as a list of columns that can be sliced: what every format but text comes down to.

A reader of a format finds the columns, their units, scales and the clock; everything a
user meets afterwards (blocks, bad values, unequal lengths, conflicting rates, a file
that changes) is here, once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError, clean_text, counted
from dbo_cli.logs.clock import Statement, agreed_rate, read_statements
from dbo_cli.logs.columns import column_label, parse_column
from dbo_cli.logs.request import Request, remedy_for
from dbo_cli.logs.sample_block import (
    MOST_NAMED,
    BadRow,
    Column,
    DroppedRows,
    FloatArray,
    SampleBlock,
    Table,
    are_measured,
)

Fetch = Callable[[int, int], Any]
"""Gives the stored values of rows start..stop (from 0, stop not included)."""


# Of two formats: before and since version 7.3.
MATLAB_OBJECTS = (
    " (MATLAB objects (table, timetable, timeseries, string) can be taken apart by MATLAB only: save plain "
    "vectors, t, voltage and displacement, with save('run.mat', 't', 'voltage', 'displacement'))"
)


_LOOKED_AT = 20
"""Rows of a column of texts, by which it is known whether they write time stamps; as text files' are."""


@dataclass(frozen=True)
class ColumnSource:
    """One column of a file, and how its stored values become numbers.

    Attributes
    ----------
    label
        The column's name; a path (``run/voltage``) where groups are mixed.
    length
        The number of rows.
    fetch
        Reads stored values.
    unit
        As the file gives it, or None.
    scale, offset
        The value is stored · scale + offset (netCDF's ``scale_factor`` and
        ``add_offset``).
    missing
        Stored values that stand for "no value" (netCDF's ``_FillValue``).
    clock
        What the file states of this column's own sample rate.
    start
        The time (s) of the first row, as far as the file states it.
    remarks
        Notes for the user where this column is used.
    problem
        Why this column cannot be used, or an empty text.
    written
        ``numbers``, or how its texts write time stamps (``stamp``, ``clock``,
        ``minutes``, ``date``).
    """

    label: str
    length: int
    fetch: Fetch
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    missing: tuple[float, ...] = ()
    clock: tuple[Statement, ...] = ()
    start: float = 0.0
    remarks: tuple[str, ...] = ()
    problem: str = ""
    written: str = "numbers"

    def read(self, start: int, stop: int) -> FloatArray:
        """Read rows start..stop (from 0, stop not included) as float64; what is missing as NaN."""
        stored = np.asarray(self.fetch(start, stop))
        if self.written != "numbers":
            return _stamps_of(stored, self.written)
        values = np.ascontiguousarray(stored, dtype=np.float64)
        if self.missing:
            absent = np.logical_or.reduce([stored == code for code in self.missing])
            if absent.any():
                values = np.where(absent, np.nan, values)
        if self.scale != 1.0:
            values = values * self.scale
        return values + self.offset if self.offset != 0.0 else values


def _stamps_of(cells: Any, written: str) -> FloatArray:
    """Return texts that write time stamps as seconds; what writes none as NaN."""
    from dbo_cli.logs.text.lines import READERS

    read = READERS[written]
    seconds = [read(clean_text(cell).strip()) for cell in cells.tolist()]
    return np.array(
        [np.nan if second is None else second for second in seconds], dtype=np.float64
    )


def text_source(label: str, length: int, fetch: Fetch) -> ColumnSource | None:
    """Make a column of texts that write time stamps, by the first rows; None where they write none."""
    from dbo_cli.logs.text.lines import writing_of

    cells = np.asarray(fetch(0, min(length, _LOOKED_AT))).tolist()
    if not all(isinstance(cell, str | bytes) for cell in cells):
        return None
    written = writing_of([clean_text(cell).strip() for cell in cells])
    return (
        None if written is None else ColumnSource(label, length, fetch, written=written)
    )


def from_first_row(source: ColumnSource, unit: str) -> ColumnSource:
    """Turn dates (and durations) that are stored as counts of a unit into seconds from the first row on.

    As numbers since 1970 they would leave no digits for microseconds.
    """
    per_second = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}[unit]
    first: list[int] = []

    def fetch(start: int, stop: int) -> Any:
        if not first:
            first.append(int(np.asarray(source.fetch(0, 1))[0]))
        counts = np.asarray(source.fetch(start, stop))
        return (
            (counts.astype(np.int64) if counts.dtype.kind in "iu" else counts)
            - first[0]
        ) / per_second

    return replace(source, fetch=fetch, unit="s")


def array_source(label: str, values: Any, unit: str | None = None) -> ColumnSource:
    """Make a column of an array in memory."""
    return ColumnSource(
        label, len(values), lambda start, stop: values[start:stop], unit
    )


def listed_source(name: str, values: list[Any]) -> ColumnSource | None:
    """Make a column of numbers, or of time stamps in seconds from the first on; None where most are neither.

    A value that is absent (None) is NaN.
    """
    from dbo_cli.logs.text.lines import stamp_seconds, to_number

    first = next((value for value in values if value is not None), None)
    stamps, unit = isinstance(first, str), None
    start = stamp_seconds(first) if isinstance(first, str) else None
    numbers, bad = np.full(len(values), np.nan), []
    for index, value in enumerate(values):
        if stamps and isinstance(value, str):
            value = to_number(value, ".") if start is None else stamp_seconds(value)
            if value is not None and start is not None:
                # a float64 of seconds since 1970 has no more
                value, unit = round(value - start, 6), "s"
        if isinstance(value, int | float):
            numbers[index] = value
        elif value is not None or stamps:
            bad.append(index)
    if 2 * len(bad) >= len(values):
        return None
    odd = [
        f"is not a number in record {k + 1}: {values[k]!r} (leave it out)"
        for k in bad[:1]
    ]
    return replace(
        array_source(name, numbers, unit),
        problem=f"column '{name}' {odd[0]}" if odd else "",
    )


def matrix_sources(name: str, array: Any) -> list[ColumnSource]:
    """Make columns of a vector or a matrix, whose longer axis is time; none of what holds no numbers."""
    if array.dtype.kind not in "fiub" or array.ndim not in (1, 2) or not array.size:
        return []
    if array.ndim == 1:
        return [array_source(name, array)]
    table = array if array.shape[0] >= array.shape[1] else array.T
    width = table.shape[1]
    labels = (
        [f"{name}[{number}]" for number in range(1, width + 1)] if width > 1 else [name]
    )
    return [array_source(label, table[:, index]) for index, label in enumerate(labels)]


def without_scalars(sources: Sequence[ColumnSource]) -> list[ColumnSource]:
    """Leave out single values (a sample rate, a remark) beside columns of more rows."""
    longest = max((source.length for source in sources), default=0)
    return [source for source in sources if source.length > 1 or longest <= 1]


def with_unit(source: ColumnSource, member: Callable[[str], Any]) -> ColumnSource:
    """Take a unit from a text beside the column (``voltage_unit``) where it has none itself."""
    if source.unit:
        return source
    texts = (
        member(f"{source.label}{ending}") for ending in ("_units", "_unit", "Unit")
    )
    return replace(
        source,
        unit=next((text for text in texts if isinstance(text, str) and text), None),
    )


def statements_in(values: Mapping[str, Any]) -> list[Statement]:
    """Read what named values state of the sample rate; its unit is ``NAME_units`` or ``NAME_unit``."""
    statements: list[Statement] = []
    for name, value in values.items():
        statements += read_statements(
            name, value, values.get(f"{name}_units", values.get(f"{name}_unit"))
        )
    return statements


# What netCDF's library leaves where nothing was written: NC_FILL_FLOAT and
# NC_FILL_DOUBLE, one number.
NETCDF_FILL = 9.969209968386869e36


def number_in(value: Any, index: int = 0) -> float | None:
    """Give a stored number, or number ``index`` of a list; None for text and for what is absent."""
    values = np.ravel(value)
    if values.dtype.kind not in "fiu" or not (values.size == 1 or index < values.size):
        return None
    return float(values[index if values.size > 1 else 0])


def unpacked(
    source: ColumnSource,
    number: Callable[[str], float | None],
    unsigned: bool,
    filled: bool,
) -> ColumnSource:
    """Apply netCDF's conventions: packed values, values that stand for none.

    Parameters
    ----------
    source
        The column as it is stored.
    number
        Gives the number that an attribute holds, or None.
    unsigned
        Whether the attribute ``_Unsigned`` is true, which is not read.
    filled
        Whether netCDF's library fills with its own value where the file names none.
    """
    values = (number("_FillValue"), number("missing_value"))
    missing = tuple(value for value in values if value is not None and value == value)
    return replace(
        source,
        scale=number("scale_factor") or 1.0,
        offset=number("add_offset") or 0.0,
        missing=missing or ((NETCDF_FILL,) if filled else ()),
        problem=f"column '{source.label}' is stored as _Unsigned, which is not read"
        if unsigned
        else "",
    )


@dataclass
class ColumnTable(Table):
    """A log made of columns.

    Attributes
    ----------
    request
        What was asked for.
    kind
        What kind of file it is, as messages call it (``HDF5``).
    sources
        The columns.
    clock
        What the file states of its sample rate as a whole.
    start
        The time (s) of the first row.
    where
        Where in the file the columns are (`` in /run1``), for ``describe``.
    at_close
        Called once the log is no longer needed.
    damaged
        The errors that the format's library raises for a damaged file while it is read.
    held, remedy
        What the file holds instead, where there is no column of numbers, and what to do
        about it.

    Raises
    ------
    InputError
        There is no column of numbers.
    """

    request: Request
    kind: str
    sources: Sequence[ColumnSource]
    clock: Sequence[Statement] = ()
    start: float = 0.0
    where: str = ""
    at_close: Callable[[], object] | None = None
    damaged: tuple[type[BaseException], ...] = (
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
    )
    held: Iterable[str] = ()
    remedy: str = ""

    def __post_init__(self) -> None:
        """Describe each column by the last part of its label and the unit that the file gives."""
        self.place = self.request.place
        if not self.sources:
            instead = ", ".join(self.held) or "nothing"
            raise InputError(
                f"{self.place}: no columns of numbers: it holds {instead}{self.remedy}"
            )
        self.notes, self.columns = [], []
        self.dropped, self.doubtful = DroppedRows(), []
        for number, source in enumerate(self.sources, start=1):
            info = parse_column(source.label.rsplit("/", 1)[-1], number, source.unit)
            self.columns.append(
                replace(info, name=source.label, written=source.written)
            )

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        stated = [statement for statement in self.clock if statement.rate]
        rate = f", {stated[0].rate:g} samples a second" if stated else ""
        return f"{self.place}: {self.kind}, {counted(len(self.sources), 'column')}{self.where}{rate}"

    def even_clock(self, columns: Collection[Column]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) that the file states for these columns, and the first row's time (s).

        Raises
        ------
        InputError
            The rate cannot be read, or the columns are sampled at different rates.
        """
        picked = [self.sources[column.number - 1] for column in columns]
        statements = [statement for source in picked for statement in source.clock]
        # What a column states of itself goes before what the file states as a whole.
        rate = agreed_rate(self.place, statements or self.clock, self.notes)
        starts = {source.start for source in picked}
        if len(starts) > 1:
            listed = ", ".join(
                f"'{source.label}' at {source.start:g} s" for source in picked
            )
            raise InputError(
                f"{self.place}: the columns do not start at the same time: {listed} "
                "(`sample_rate` HZ takes them row by row)"
            )
        return rate, starts.pop() or self.start if starts else self.start

    def blocks(self, picks: Mapping[str, Column]) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of ``block_rows`` rows.

        Raises
        ------
        InputError
            The columns are of unequal length, a value is not finite (unless
            ``skip_bad``), or the file changes while it is read.
        """
        wanted = list(picks.values())
        sources = [self.sources[pick.number - 1] for pick in wanted]
        for source in sources:
            if source.problem:
                raise InputError(f"{self.place}: {source.problem}")
            self.notes.extend(f"{self.place}: {remark}" for remark in source.remarks)
        lengths, options = [source.length for source in sources], self.request.options
        if len(set(lengths)) > 1:
            listed = ", ".join(
                f"'{s.label}' {n}" for s, n in zip(sources, lengths, strict=True)
            )
            raise InputError(
                f"{self.place}: the columns are of unequal length: {listed}"
            )
        end = min(lengths[0], options.rows[1] or lengths[0])
        for start in range(options.rows[0] - 1, end, options.block_rows):
            stop = min(end, start + options.block_rows)
            with self.request.reading(self.kind, self.damaged):
                arrays = [source.read(start, stop) for source in sources]
            block = SampleBlock(
                range(start + 1, stop + 1),
                None,
                None,
                dict(zip(picks, arrays, strict=True)),
            )
            good = [are_measured(array) for array in arrays]
            whole = np.logical_and.reduce(good)
            if not whole.all():
                blank = [
                    pick.may_be_blank & np.isnan(array)
                    for pick, array in zip(wanted, arrays, strict=True)
                ]
                # row and column, the first row first
                bad = np.argwhere(~np.logical_or(good, blank).T)
                if len(bad):
                    rows, first = np.unique(bad[:, 0], return_index=True)
                    named = (
                        self._bad_row(start, wanted, arrays, row, number)
                        for row, number in bad[first[:MOST_NAMED]].tolist()
                    )
                    if not options.skip_bad:
                        remedy = remedy_for(
                            len(rows) - 1, len(block) - 1 - int(rows[0])
                        )
                        raise InputError(f"{next(named)} {remedy}")
                    self.dropped.extend(DroppedRows(len(rows), list(named)))
                block = block.chosen(whole)
            yield block
        if self.dropped.count:
            self.notes.append(self.dropped.note())

    def _bad_row(
        self,
        start: int,
        wanted: Sequence[Column],
        arrays: Sequence[FloatArray],
        row: int,
        number: int,
    ) -> BadRow:
        """Name a row of a block that begins at ``start`` by the column that holds no number there."""
        value = str(float(arrays[number][row]))
        at = start + row + 1
        return BadRow(
            at,
            f"{self.place}: row {at}",
            f"{column_label(wanted[number])} is not finite: {value!r}",
        )

    def close(self) -> None:
        """Close the file."""
        if self.at_close is not None:
            self.at_close()
