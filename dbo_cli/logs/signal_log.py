"""Recorded logs and trajectories: one way to read them, whatever their format.

What a file is called matters less than what it is: its first bytes choose the reader,
and a library is imported only then. A column of another file (``FILE::COLUMN``) stands
beside those of the first, joined by time (``logs.joined_files``)::

    with open_log("run.csv", {"voltage": ColumnWish(None, ("voltage", "drive"))}) as log:
        for block in log.blocks():
            block.time, block.values["voltage"]
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dbo_cli import extensions
from dbo_cli.errors import InputError, Remarks, UsageError, cleaned
from dbo_cli.logs.clock import Clock, find_clock
from dbo_cli.logs.columns import (
    ColumnWish,
    choose_columns,
    contradicted_unit,
    find_column,
)
from dbo_cli.logs.joined_files import JoinedTable, names_file
from dbo_cli.logs.request import (
    ALL_ROWS,
    Address,
    Given,
    ReadingOptions,
    Request,
    other_file,
    parse_address,
    without_folder,
)
from dbo_cli.logs.sample_block import (
    Column,
    DroppedRows,
    FloatArray,
    SampleBlock,
    Table,
    TimeCheck,
    joined,
    resampled,
)
from dbo_cli.logs.text.line_blocks import HDF5
from dbo_cli.logs.text.text_table import TextTable
from dbo_cli.logs.units import (
    ONE,
    Scale,
    UnitFactor,
    kind_of_unit,
    quantity_name,
    unit_factor,
)

_USER_BLOCKS = (0, 512, 1024, 2048)  # where an HDF5 file may begin (MATLAB v7.3: 512)
# endings of text; others may be an extra's
_TEXT = (".csv", ".tsv", ".txt", ".dat", ".gz", "")


def open_table(request: Request) -> Table:
    """Open a log with the reader that its first bytes (or its name) ask for.

    Raises
    ------
    InputError
        The file cannot be read, or a library that reads it is not installed.
    """
    address = request.address
    if address.table is not None:
        held: Table = address.table.opened(request.options)
        return held
    read = _reader_by_content(address)
    if read is None:
        table: Table = TextTable(request)
        by_names = extensions.find_installed("reader", "rows of values")
        if by_names is not None:
            table = by_names(request, table)
        return table
    return read(request)


def _reader_by_content(address: Address) -> Callable[[Request], Table] | None:
    """Return what opens a file of such content; None for text and streams.

    Raises
    ------
    InputError
        It is what this program wrote and no log.
    """
    by_name = _open_hdf5 if address.kind == "hdf5" else None
    readable = os.path.isfile(address.path) and os.access(address.path, os.R_OK)
    if address.is_stream or not readable:
        return by_name
    with open(address.path, "rb") as file:
        head = file.read(2056)
    _refuse_own_documents(address.text, head)
    if any(head[at : at + len(HDF5)] == HDF5 for at in _USER_BLOCKS):
        return _open_hdf5
    reader: Callable[[Request], Table]
    kind_of = extensions.find_installed("reader", "by content")
    if kind_of is not None:
        kind = kind_of(head, address.path)
        if kind is not None:
            reader = kind.open
            return reader
    ending = os.path.splitext(address.path.lower())[1]
    if by_name is None and ending not in _TEXT:
        reader = extensions.find("reader", ending)
        return reader
    return by_name


def _refuse_own_documents(place: str, head: bytes) -> None:
    """Refuse what this program wrote and no log (InputError)."""
    match = re.match(rb'\{\s*"format":\s*"dbo-(model|model-set|state|report)"', head)
    if match is None:
        return
    kind = match[1].decode()
    remedy = "; a report takes a model as `model`" if kind == "model" else ""
    raise InputError(f"{place}: this is a {kind}, not a log (give a recording{remedy})")


def _open_hdf5(request: Request) -> Table:
    """Open an HDF5 file; its library is imported only then."""
    from dbo_cli.logs.hdf5.reader import open_hdf5

    return open_hdf5(request)


# --- what a run needs of a log ---


@dataclass(eq=False)
class Source:
    """What a run needs of a log: files (``SignalLog``), arrays and tables (``logs.sources``) are sources.

    Attributes
    ----------
    name
        How messages call it.
    columns
        Role to column; the unit is the one that the samples are handed out in.
    has_time
        Whether samples carry a time.
    even_rate
        Samples a second (Hz) where they are evenly spaced by definition, else None.
    stated_rate
        Samples a second (Hz) as it was given, rows that were dropped aside, or None.
    notes, warnings
        What is worth knowing, and what may spoil a result; complete after the last
        block.
    """

    name: str
    columns: dict[str, Column]
    has_time: bool
    even_rate: float | None = None
    stated_rate: float | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    _factors: dict[str, UnitFactor] = field(default_factory=dict)
    no_time = "no time is given, and {why} (`time` or `sample_rate` HZ)"
    warns_of_units = False  # figures of an unknown unit are taken as they are

    def require_time(self, why: str) -> None:
        """Refuse a source without time, naming the remedy (InputError)."""
        if not self.has_time:
            raise InputError(f"{self.name}: {self.no_time.format(why=why)}")

    def convert(self, role: str, wanted: str | None, taker: str) -> None:
        """Hand a role's samples out in another unit from now on, with a note.

        Parameters
        ----------
        role
            Whose samples.
        wanted
            The unit that is worked in, or None where it is not known.
        taker
            Who works in it, for messages: ``model.json takes voltage``.

        Raises
        ------
        InputError
            The units measure unlike things, or one of them is not known.
        """
        unit = self.columns[role].unit
        called = f"{self.name}: column '{self.columns[role].name}'"
        factor = unit_factor(unit, wanted)
        if unit == wanted:
            return
        if unit is None or wanted is None:
            if unit is None:
                unlike = (
                    f"has no unit, but {taker} in {wanted}: its figures are taken as {wanted} "
                    "(name the unit in the header, or convert with `scale`)"
                )
            else:
                unlike = (
                    f"is in {unit}, but {taker} without a unit: the figures are used as they are "
                    "(convert with `scale` if they are not alike)"
                )
            if self.warns_of_units:
                self.warnings.append(f"{called} {unlike}")
            return
        if factor is None:
            remedy = f"`scale` ROLE=FACTOR{wanted}/{unit} converts it"
            raise InputError(
                f"{called} is in {unit}, but {taker} in {wanted} ({remedy})"
            )
        self.notes.append(f"{called} is converted from {unit} to {wanted}")
        if factor != ONE:
            self.columns[role] = replace(self.columns[role], unit=wanted)
            self._factors[role] = self._factors.get(role, ONE).times(*factor)

    def in_units(self, values: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return samples by role in the units that they are to be handed out in."""
        if not self._factors:
            return dict(values)
        converted = {}
        for role, array in values.items():
            converted[role] = self._factors.get(role, ONE).apply(array)
        return converted

    def reading_line(self) -> str | None:
        """Describe what was read, once it was; None where nothing was."""
        return None

    def blocks(self) -> Iterator[SampleBlock]:
        """Return the samples in blocks, by role."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the file, where there is one."""


def remarks_of(source: Source) -> Remarks:
    """Return notes, warnings and reading line of a source that was read."""
    remarks = Remarks(source.notes, source.warnings)
    line = source.reading_line()
    if line is not None:
        remarks.read.append(line)
    return remarks


# --- the log ---


class SignalLog(Source):
    """An open log: the columns that were wished for, and their samples in blocks.

    Attributes beside those of every source
    ---------------------------------------
    time
        The time column, or None.
    sample_rate
        Samples a second as given by the user or by an attribute of the file, or None.
    rows_read
        The recorded rows handed out so far (before any resampling).
    """

    no_time = "no time column and no sample rate, and {why} (`time` COLUMN or `sample_rate` HZ)"
    warns_of_units = True

    def __init__(
        self,
        address: Address,
        table: Table,
        wishes: Mapping[str, ColumnWish],
        options: ReadingOptions,
    ) -> None:
        """Choose columns and clock of an opened table."""
        place = table.place
        named = []
        for wish in wishes.values():
            if wish.selector is not None:
                named.append(
                    find_column(place, table.columns, wish.selector, wish.option)
                )
        clock: Clock = table.ready_clock or find_clock(
            place, table.columns, options, named
        )
        if clock.column is None and options.time_unit is not None:
            raise InputError(
                f"{place}: no column is recognised as the time (`time` COLUMN names it)"
            )
        picks = choose_columns(
            place, table.columns, wishes, clock.taken, clock.is_known, table.notes
        )
        if not clock.is_known:
            clock.rate, clock.start = table.even_clock(picks.values())
        rate = clock.rate
        even_rate = rate
        if options.skip_bad or any(column.may_be_blank for column in picks.values()):
            even_rate = None  # rows may be missing
        super().__init__(
            place,
            dict(picks),
            clock.is_known,
            options.resample or even_rate,
            options.resample or rate,
        )
        self._scales = _scales_by_role(options, wishes, picks)
        for role, scale in self._scales.items():
            self._factors[role], self.columns[role] = scale.applied_to(
                self.name, picks[role]
            )
        table.notes.extend(clock.notes)
        clock.notes = []  # later ones are added when all rows were read
        self.notes = table.notes
        doubts = [_doubtful_unit(self.name, column) for column in picks.values()]
        self.warnings = list(filter(None, doubts))
        self._address = address
        self._options = options
        self._table = table
        self._picks = picks
        self._clock = clock
        self.time = clock.column
        self.sample_rate = rate
        self.rows_read = 0
        self._check: TimeCheck | None = None
        # s, of the first and the last sample
        self._times: tuple[float, float] | None = None

    def __enter__(self) -> SignalLog:
        """Use the log as a context manager that closes it."""
        return self

    def __exit__(self, *problem: object) -> None:
        """Close the log."""
        self.close()

    def describe(self) -> str:
        """Describe in one line how the log is written and what was chosen, for ``verbose``."""
        chosen = [
            f"{role} is column {column.number}" for role, column in self.columns.items()
        ]
        if self.time is not None:
            chosen.insert(0, f"time is column {self.time.number}")
        return f"{self._table.describe()}; {', '.join(chosen)}"

    def opening_line(self) -> str:
        """Describe what is being read, as far as it is known before the first block (for streams)."""
        known = [] if self.has_time else ["no time"]
        return self._line(known, self.sample_rate)

    def reading_line(self) -> str:
        """Describe what was read, once all blocks were: rows, duration, rate, and the column of each role."""
        rate, seconds = self._rate_and_seconds()
        known = [f"{self.rows_read:,} {'row' if self.rows_read == 1 else 'rows'}"]
        if not self.has_time:
            known.append("no time")
        return self._line(known, rate, seconds)

    def _line(
        self, known: list[str], rate: float | None, seconds: float | None = None
    ) -> str:
        if rate is not None:
            text = self._rate_text(rate)
            if seconds is not None:
                text = f"{_plain(seconds, 3)} s at {text}"
            known = [*known, text]
        read = []
        for role, column, unit in self._used():  # voltage 'CH1' (V)
            called = f"column {column.number}"
            if column.quantity:
                called = f"'{column.name}'"
            scale = ""
            if role in self._scales:
                scale = f", {self._scale_text(role)}"
            quantity = quantity_name(role, unit)
            read.append(f"{quantity} {called} ({unit or 'no unit'}{scale})")
        parts = [", ".join(known), ", ".join(read)]
        return f"{self.name}: {'; '.join(filter(None, parts))}"

    def _rate_text(self, rate: float) -> str:
        """Write a rate (Hz), where it comes from, and whether the steps are even: ``500 samples/s``."""
        text = "1 sample/s"
        if _plain(rate) != "1":
            text = f"{_plain(rate)} samples/s"
        if self._check is not None and not self._check.is_even:
            text = f"about {text}"
        if self.sample_rate is None:
            return text
        if self._options.sample_rate is None:
            return f"{text} (from the file)"
        return f"{text} (given)"

    def _used(self) -> list[tuple[str, Column, str | None]]:
        """List role, column and unit of what is read, the time first."""
        used: list[tuple[str, Column, str | None]] = []
        if self.time is not None:
            used.append(("time", self.time, self._clock.reading()))
        for role, column in self._picks.items():
            used.append((role, column, column.unit))
        return used

    def reading_record(self) -> dict[str, Any]:
        """Return what ``reading_line`` states as plain values, for a model's provenance."""
        rate, seconds = self._rate_and_seconds()
        columns = {}
        time = None
        for number, (role, column, unit) in enumerate(self._used()):
            name = column.name
            if self._table.others:
                name = without_folder(name)
            scale = self._scale_text(role)
            record = _without_none({"column": name, "unit": unit, "scale": scale})
            if number == 0 and self.time is not None:
                time = record
            else:
                columns[role] = record
        return _without_none(
            {
                "rows": self.rows_read,
                "seconds": seconds,
                "sample_rate": rate,
                "time": time,
                "columns": columns,
            }
        )

    def _rate_and_seconds(self) -> tuple[float | None, float | None]:
        """Return samples a second and the time (s) from the first sample to the last, as far as known."""
        rate = self.sample_rate
        seconds = None
        if self._times is not None:
            first, last = self._times
            seconds = last - first
        step = 0.0 if self._check is None else self._check.step
        if self.rows_read and 0.0 < step < np.inf:
            rate = 1.0 / step
        return rate, seconds

    def _scale_text(self, role: str) -> str | None:
        scale = self._scales.get(role)
        if scale is None:
            return None
        factor = str(scale).partition("=")[2]
        return f"times {factor}"

    def blocks(self) -> Iterator[SampleBlock]:
        """Read the samples in blocks; the blocks may be of any length, their samples always the same.

        Raises
        ------
        InputError
            A bad row, or no data row at all.
        """
        blocks = self._as_recorded()
        rate = self._options.resample
        if rate is None:
            return blocks
        return resampled(self.name, blocks, rate)

    def read(self) -> SampleBlock:
        """Read all samples as one block."""
        return joined(list(self.blocks()))

    @property
    def dropped(self) -> DroppedRows:
        """Rows that ``skip_bad`` left out; complete after the last block."""
        return self._table.dropped

    @property
    def doubtful(self) -> list[str]:
        """What was passed over in silence and may have been rows; complete after the last block."""
        return self._table.doubtful

    @property
    def unread(self) -> list[str]:
        """Names of the columns of numbers that nothing was read from."""
        read = {column.number for column in self._picks.values()}
        if self.time is not None:
            read.add(self.time.number)
        names = []
        for column in self._table.columns:
            if column.number not in read and column.written == "numbers":
                names.append(column.name)
        return names

    def close(self) -> None:
        """Close the file."""
        self._table.close()

    def record(self) -> dict[str, Any]:
        """Record this log for a model's provenance, once it has been read (a stream: with ``digest``)."""
        return input_record(
            self._address, self.rows_read, self._table.sha256, self._table.others
        )

    def _as_recorded(self) -> Iterator[SampleBlock]:
        clock = self._clock
        most = self._options.block_rows
        blocks = clock.held_back(self._table.blocks(self._picks | clock.picks))
        check = None
        if clock.column is not None:
            check = TimeCheck(self.name, clock.periods())
        for raw in blocks:
            for start in range(0, len(raw.rows), most):
                part = raw.part(start, start + most)
                values = dict(part.values)
                time = clock.times(part.rows, values)
                block = replace(part, time=time, values=self.in_units(values))
                if time is not None and len(time):
                    first = float(time[0])
                    if self._times is not None:
                        first, _ = self._times
                    self._times = first, float(time[-1])
                    if check is not None:
                        check.feed(block)
                self.rows_read += len(block.rows)
                yield block
        if check is not None:
            self.notes.extend([*clock.notes, *check.notes()])
            # a clock in another unit makes all else wrong
            self.warnings[:0] = clock.warnings(check)
        self.warnings.extend(self._table.warnings)
        self._check = check
        if not self.rows_read:
            raise InputError(f"{self.name}: {self._nothing()}")

    def _nothing(self) -> str:
        first, last = self._options.rows
        if (first, last) != ALL_ROWS:
            return f"`rows` {first}:{last or ''} is beyond the last data row"
        return "no good data row" if self._options.skip_bad else "no data rows"


def _without_none(record: dict[str, Any]) -> dict[str, Any]:
    """Return what is known of a record."""
    return {key: value for key, value in record.items() if value is not None}


def _plain(value: float, digits: int = 4) -> str:
    """Write a number without an exponent where people would: 48,000 and not 4.8e+04."""
    if 999.5 <= abs(value) < 1e9:
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def _doubtful_unit(place: str, column: Column) -> str:
    """Return what is odd about the unit of a column, if anything is."""
    unit_in_name = contradicted_unit(column)
    if unit_in_name is not None:
        return (
            f"{place}: column '{column.name}' is in {unit_in_name} by its name and in {column.unit} "
            f"by its unit: {column.unit} is taken (`scale` converts)"
        )
    if column.unit is not None and kind_of_unit(column.unit) is None:
        return (
            f"{place}: the unit '{column.unit}' of column '{column.name}' is not known and carried as it is "
            "(`scale` ROLE=FACTORUNIT/UNIT converts)"
        )
    return ""


def open_log(
    address: Given,
    wishes: Mapping[str, ColumnWish],
    options: ReadingOptions | None = None,
    *,
    live: bool = False,
    digest: bool = False,
) -> SignalLog:
    """Open a log and find the columns that are wished for.

    Parameters
    ----------
    address
        A file, ``FILE::/group`` of an HDF5 file, or ``-`` for standard input.
        ``options.format`` is forced on a name, and goes to an address whose own name
        does not tell its format.
    wishes
        Role to wish.
    options
        How the log is to be read.
    live
        Give each row as it arrives (for ``tail -f``).
    digest
        Hash what is read from standard input, for the provenance record.

    Raises
    ------
    InputError
        The log or a column is absent, unreadable or empty.
    UsageError
        The address or a column's number is none.
    """
    options = options or ReadingOptions()
    selectors = [wish.selector for wish in wishes.values() if wish.selector]
    if options.time:
        selectors.append(options.time)
    named = []  # columns of this log
    for selector in selectors:
        if other_file(selector) is None and not os.path.isfile(selector):
            named.append(selector)
    if options.clock_offset is not None and len(named) == len(selectors):
        raise UsageError(
            "`clock_offset` joins two files: name the other one's column, FILE::COLUMN"
        )
    if isinstance(address, Address):
        target = address.or_format(options.format)
    else:
        target = parse_address(address, options.format)
    table = open_table(Request(target, options, named, live, digest))
    for selector in selectors:
        if "::" in selector or names_file(selector, table.columns):
            return _open_joined(target, table, wishes, options)
    try:
        return SignalLog(target, table, wishes, options)
    except BaseException:
        table.close()
        raise


def _open_joined(
    address: Address,
    first: Table,
    wishes: Mapping[str, ColumnWish],
    options: ReadingOptions,
) -> SignalLog:
    """Open a log some of whose columns are in other files; the first one is open already."""
    table = JoinedTable(first, options, open_table)
    try:
        by_number = {}
        for role, wish in wishes.items():
            number = table.number_of(wish, role)
            by_number[role] = replace(wish, selector=number)
        if options.time is not None:
            number = table.number_of(ColumnWish(options.time, option="time"))
            options = replace(options, time=number)
        table.find_clocks(options)
        if table.others:
            return SignalLog(address, table, by_number, options)
        return SignalLog(address, first, by_number, options)
    except BaseException:
        table.close()
        raise


def _scales_by_role(
    options: ReadingOptions,
    wishes: Mapping[str, ColumnWish],
    columns: Mapping[str, Column],
) -> dict[str, Scale]:
    """Give each scale its role, which may be called as the parameter that names its column is.

    Raises
    ------
    UsageError
        There is no such role here, or one is scaled twice.
    """
    names = {}
    for role, wish in wishes.items():
        names[wish.option.lower()] = role
        names[role.lower()] = role
    if "measured" in wishes:
        names.setdefault("displacement", "measured")
    scales: dict[str, Scale] = {}
    for scale in options.scales:
        scaled = names.get(scale.role)
        if scaled is None:
            known = ", ".join(dict.fromkeys(names.values()))
            raise UsageError(
                f"`scale` {scale}: there is no {scale.role} here, but {known}"
            )
        if scaled in scales:
            raise UsageError(f"`scale` {scale}: {scaled} is scaled twice")
        if scaled in columns:
            scales[scaled] = scale
    return scales


# --- where a model comes from ---


def file_sha256(path: str) -> str:
    """Hash a file's bytes (hexadecimal SHA-256).

    Raises
    ------
    InputError
        It cannot be read.
    """
    import hashlib

    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(
            f"{path}: cannot be read: {problem.strerror or problem}"
        ) from None


def input_record(
    address: Given, rows: int, sha256: str | None = None, joined: Sequence[Given] = ()
) -> dict[str, Any]:
    """Record an input: its name without folders (they differ between machines), its digest and the rows used.

    ``sha256`` must be given for standard input, which cannot be read twice
    (``SignalLog.sha256``); ``others`` are the addresses of further files of the same
    log, whose records are ``joined``.
    """
    parsed = parse_address(address)
    name = os.path.basename(parsed.path)
    if parsed.group:
        name = f"{name}::{parsed.group}"
    record: dict[str, Any] = {
        "name": cleaned(name),
        "sha256": sha256 or file_sha256(parsed.path),
        "rows": rows,
    }
    if joined:
        record["joined"] = [input_record(address, rows) for address in joined]
    return record
