"""Recorded logs and trajectories: one way to read them, whatever their format.

with open_log("run.csv", {"voltage": ColumnWish(None, ("voltage", "drive"))}) as log:
    for block in log.blocks():
        block.time, block.values["voltage"]
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NotRequired, TypedDict

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.addresses import Address, Given, other_file, parse_address, without_folder
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.clock import TimeCheck, resampled
from dbo_cli.logs.columns import ColumnWish, choose_columns, contradicted_unit, find_column
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions
from dbo_cli.logs.sample_block import ColumnInfo, SampleBlock, Table, joined
from dbo_cli.logs.sources import Source
from dbo_cli.logs.tables import join_files, open_table
from dbo_cli.logs.time_column import FoundTime, find_time_column
from dbo_cli.logs.units import Scale, kind_of_unit


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
        want: Mapping[str, ColumnWish],
        options: ReadingOptions,
        others: Sequence[str] = (),
    ) -> None:
        """Choose columns and clock of an opened table; ``others`` are the addresses of files joined to it."""
        place, there = table.place, table.columns
        chosen = [one for one in want.values() if one.selector is not None]
        named = [find_column(place, there, one.selector or "", one.option) for one in chosen]
        found: FoundTime = table.found_time or find_time_column(place, there, options, named)
        clock, rate, start = found.clock, options.sample_rate, 0.0
        if clock is None and options.time_unit is not None:
            raise InputError(f"{place}: no column is recognised as the time (`time` COLUMN names it)")
        timed = clock is not None or rate is not None
        picks = choose_columns(place, there, want, found.taken, timed, table.notes)
        if rate is None and clock is None:
            rate, start = table.even_clock(picks.values())
        gaps = options.skip_bad or any(column.may_be_blank for column in picks.values())
        even, timed = None if gaps else rate, clock is not None or rate is not None
        super().__init__(place, picks, timed, options.resample or even, options.resample or rate)
        self._scales = _scales_by_role(options, want, picks)
        for role, scale in self._scales.items():
            self._factors[role], self.columns[role] = scale.applied_to(self.name, picks[role])
        table.notes.extend(found.notes)
        self.notes = table.notes
        self.warnings = [text for one in picks.values() if (text := _doubtful_unit(self.name, one))]
        self._address, self._others, self._options = address, others, options
        self._table, self._picks, self._clock, self._start_time = table, picks, clock, start
        self.time = None if clock is None else clock.column
        self.sample_rate = rate
        self.rows_read = 0
        self._check: TimeCheck | None = None
        self._times: tuple[float, float] | None = None  # s, of the first and the last sample

    def __enter__(self) -> SignalLog:
        """Use the log as a context manager that closes it."""
        return self

    def __exit__(self, *problem: object) -> None:
        """Close the log."""
        self.close()

    def describe(self) -> str:
        """Describe in one line how the log is written and what was chosen, for ``verbose``."""
        chosen = [f"{role} is column {column.number}" for role, column in self.columns.items()]
        if self.time is not None:
            chosen.insert(0, f"time is column {self.time.number}")
        return f"{self._table.describe()}; {', '.join(chosen)}"

    def opening_line(self) -> str:
        """Describe what is being read, as far as it is known before the first block (for streams)."""
        return self._line([] if self.has_time else ["no time"], self.sample_rate)

    def reading_line(self) -> str:
        """Describe what was read, once all blocks were: rows, duration, rate, and the column of each role."""
        rate, seconds = self._rate_and_seconds()
        known = [f"{self.rows_read:,} row{'s' if self.rows_read != 1 else ''}"]
        return self._line(known if self.has_time else [*known, "no time"], rate, seconds)

    def _line(self, known: list[str], rate: float | None, seconds: float | None = None) -> str:
        if rate is not None:
            source = ""
            if self.sample_rate is not None:
                source = " (given)" if self._options.sample_rate is not None else " (from the file)"
            about = "about " if self._check is not None and not self._check.is_even else ""
            plural = "" if _plain(rate) == "1" else "s"
            text = f"{about}{_plain(rate)} sample{plural}/s{source}"
            known = [*known, text if seconds is None else f"{_plain(seconds, 3)} s at {text}"]
        read = []
        for role, column, unit in self._used():  # voltage 'CH1' (V)
            called = f"'{column.name}'" if column.quantity else f"column {column.number}"
            scale = f", {self._scale_text(role)}" if role in self._scales else ""
            read.append(f"{role} {called} ({unit or 'no unit'}{scale})")
        return f"{self.name}: {'; '.join(filter(None, [', '.join(known), ', '.join(read)]))}"

    def _used(self) -> list[tuple[str, ColumnInfo, str | None]]:
        """List role, column and unit of what is read, the time first."""
        clock = self._clock
        timed = [] if clock is None else [("time", clock.column, clock.reading())]
        return timed + [(role, column, column.unit) for role, column in self._picks.items()]

    def reading_record(self) -> dict[str, Any]:
        """Return what ``reading_line`` states as plain values, for a model's provenance."""
        rate, seconds = self._rate_and_seconds()
        columns = []
        for role, column, unit in self._used():
            name = without_folder(column.name) if self._others else column.name
            found = {"column": name, "unit": unit, "scale": self._scale_text(role)}
            columns.append((role, {key: value for key, value in found.items() if value is not None}))
        time = None if self._clock is None else columns.pop(0)[1]
        record: dict[str, Any] = {"rows": self.rows_read, "seconds": seconds, "sample_rate": rate}
        record |= {"time": time, "columns": dict(columns)}
        return {key: value for key, value in record.items() if value is not None}

    def _rate_and_seconds(self) -> tuple[float | None, float | None]:
        """Return samples a second and the time (s) from the first sample to the last, as far as known."""
        rate, seconds = self.sample_rate, None
        if self._times is not None:
            seconds = self._times[1] - self._times[0]
        if self.rows_read and self._check is not None and 0.0 < self._check.step < np.inf:
            rate = 1.0 / self._check.step
        return rate, seconds

    def _scale_text(self, role: str) -> str | None:
        scale = self._scales.get(role)
        return None if scale is None else f"times {str(scale).partition('=')[2]}"

    def blocks(self) -> Iterator[SampleBlock]:
        """Read the samples in blocks; the blocks may be of any length, their samples always the same.

        Raises
        ------
        InputError
            A bad row, or no data row at all.
        """
        blocks = self._as_recorded()
        rate = self._options.resample
        return blocks if rate is None else resampled(self.name, blocks, rate)

    def read(self) -> SampleBlock:
        """Read all samples as one block."""
        return joined(list(self.blocks()))

    def close(self) -> None:
        """Close the file."""
        self._table.close()

    def record(self) -> InputRecord:
        """Record this log for a model's provenance, once it has been read (a stream: with ``digest``)."""
        return input_record(self._address, self.rows_read, self._table.sha256, self._others)

    def _as_recorded(self) -> Iterator[SampleBlock]:
        clock = self._clock
        picks = self._picks | ({} if clock is None else clock.picks)
        check: TimeCheck | None = None
        most = self._options.block_rows
        found = self._table.blocks(picks)
        for raw in found if clock is None else clock.held_back(found):
            for start in range(0, len(raw.rows), most):
                block = self._with_time(raw.part(start, start + most))
                if block.time is not None and len(block.rows):
                    first = block.time[0] if self._times is None else self._times[0]
                    self._times = float(first), float(block.time[-1])
                    if clock is not None:
                        check = check or TimeCheck(self.name, block.lines is not None, clock.periods())
                        check.feed(block.time, block.rows, block.lines)
                self.rows_read += len(block.rows)
                yield block
        if check is not None and clock is not None:
            self.notes.extend([*clock.notes, *check.notes()])
            self.warnings.extend(clock.warnings(check))
        self._check = check
        if not self.rows_read:
            raise InputError(f"{self.name}: {self._nothing()}")

    def _nothing(self) -> str:
        first, last = self._options.rows
        if (first, last) != ALL_ROWS:
            return f"`rows` {first}:{last or ''} is beyond the last data row"
        return "no good data row" if self._options.skip_bad else "no data rows"

    def _with_time(self, raw: SampleBlock) -> SampleBlock:
        """Take the time out of the columns, or make it from the sample rate; apply the scales."""
        values = dict(raw.values)
        time = None
        if self._clock is not None:
            time = self._clock.seconds(values)
        elif self.sample_rate is not None:
            time = self._start_time + (np.asarray(raw.rows, dtype=np.float64) - 1.0) / self.sample_rate
        return SampleBlock(raw.rows, raw.lines, time, self.in_units(values))


def _plain(value: float, digits: int = 4) -> str:
    """Write a number without an exponent where people would: 48,000 and not 4.8e+04."""
    return f"{value:,.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.{digits}g}"


def _doubtful_unit(place: str, column: ColumnInfo) -> str:
    """Return what is odd about the unit of a column, if anything is."""
    own = contradicted_unit(column)
    if own is not None:
        return (
            f"{place}: column '{column.name}' is in {own} by its name and in {column.unit} by its unit: "
            f"{column.unit} is taken (`scale` converts)"
        )
    if column.unit is not None and kind_of_unit(column.unit) is None:
        return (
            f"{place}: the unit '{column.unit}' of column '{column.name}' is not known and carried as it is "
            "(`scale` ROLE=FACTORUNIT/UNIT converts)"
        )
    return ""


def open_log(
    address: Given,
    want: Mapping[str, ColumnWish],
    options: ReadingOptions | None = None,
    *,
    live: bool = False,
    digest: bool = False,
) -> SignalLog:
    """Open a log and find the columns that are wished for.

    Parameters
    ----------
    address
        A file, ``FILE::/group`` of an HDF5 file, or ``-`` for standard input. ``options.format`` is forced on
        a name, and goes to an address whose own name does not tell its format.
    want
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
    selectors = [one for one in (*(wish.selector for wish in want.values()), options.time) if one]
    named = [one for one in selectors if other_file(one) is None]
    if isinstance(address, Address):
        target = address.or_format(options.format)
    else:
        target = parse_address(address, options.format)
    table = open_table(Request(target, options, named, live, digest))
    try:
        others: list[str] = []
        if any("::" in one for one in selectors):
            table, want, options, others = join_files(table, want, options)
        return SignalLog(target, table, want, options, others)
    except BaseException:
        table.close()
        raise


def _scales_by_role(
    options: ReadingOptions, want: Mapping[str, ColumnWish], columns: Mapping[str, ColumnInfo]
) -> dict[str, Scale]:
    """Give each scale its role, which may be called as the parameter that names its column is.

    Raises
    ------
    UsageError
        There is no such role here, or one is scaled twice.
    """
    names = {name: role for role, wish in want.items() for name in (wish.option.lower(), role.lower())}
    found: dict[str, Scale] = {}
    for scale in options.scales:
        role = names.get(scale.role)
        if role is None:
            there = ", ".join(dict.fromkeys(names.values()))
            raise UsageError(f"`scale` {scale}: there is no {scale.role} here, but {there}")
        if role in found:
            raise UsageError(f"`scale` {scale}: {role} is scaled twice")
        if role in columns:
            found[role] = scale
    return found


# --- where a model comes from ------------------------------------------------------------------------


class InputRecord(TypedDict):
    """What a model keeps of one of its inputs; ``joined`` are the other files that columns came from."""

    name: str
    sha256: str
    rows: int
    joined: NotRequired[list[InputRecord]]


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
        raise InputError(f"{path}: cannot be read: {problem.strerror or problem}") from None


def input_record(
    address: Given, rows: int, sha256: str | None = None, others: Sequence[Given] = ()
) -> InputRecord:
    """Record an input: its name without folders (they differ between machines), its digest and the rows used.

    ``sha256`` must be given for standard input, which cannot be read twice (``SignalLog.sha256``); ``others``
    are the addresses of further files of the same log.
    """
    parsed = parse_address(address)
    name = os.path.basename(parsed.path) + (f"::{parsed.group}" if parsed.group else "")
    record = InputRecord(name=cleaned(name), sha256=sha256 or file_sha256(parsed.path), rows=rows)
    if others:
        record["joined"] = [input_record(other, rows) for other in others]
    return record
