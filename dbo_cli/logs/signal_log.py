"""Recorded logs and trajectories: one way to read them, whatever their format.

with open_log("run.csv", {"voltage": ColumnWish(None, ("voltage", "drive"))}) as log:
    for block in log.blocks():
        block.time, block.values["voltage"]
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Protocol

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import HDF5_SIGNATURE, Address, parse_address
from dbo_cli.logs.clock import TimeCheck, resampled, to_seconds
from dbo_cli.logs.columns import TIME_GUESSES, ColumnWish, choose_columns, find_column, guess_columns
from dbo_cli.logs.provenance import InputRecord, input_record
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions, Rows
from dbo_cli.logs.sample_block import ColumnInfo, SampleBlock, joined
from dbo_cli.logs.text_logs import TextTable

_TIME = "the clock"  # its place among the roles; no quantity of a model is called so


class Table(Protocol):
    """What a format gives: its columns at once, its rows in blocks."""

    place: str
    columns: list[ColumnInfo]
    sample_rate: float | None
    notes: list[str]

    def describe(self) -> str:
        """Tell in one line how the log is written."""

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks."""

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for."""

    def close(self) -> None:
        """Close the file."""


class SignalLog:
    """An open log: the columns that were wished for, and their samples in blocks.

    Attributes
    ----------
    name
        How messages call the log.
    columns
        Role to column.
    time
        The time column, or None.
    sample_rate
        Samples a second as given by the user or by an attribute of the file, or None.
    notes
        What is worth saying about the log (odd time stamps, dropped rows); complete after the last block.
    rows_read
        The recorded rows handed out so far (before any resampling).
    """

    def __init__(
        self,
        address: str,
        table: Table,
        columns: dict[str, ColumnInfo],
        time: ColumnInfo | None,
        sample_rate: float | None,
        options: ReadingOptions,
    ) -> None:
        self.name = table.place
        self._address = address
        self.columns = columns
        self.time = time
        self.sample_rate = sample_rate
        self.notes = table.notes
        self.rows_read = 0
        self._table = table
        self._options = options

    def __enter__(self) -> SignalLog:
        """Use the log as a context manager that closes it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the log."""
        self.close()

    @property
    def even_rate(self) -> float | None:
        """Samples a second (Hz) where they are evenly spaced by definition: resampled, or without a clock."""
        if self._options.resample is not None:
            return self._options.resample
        return None if self._options.skip_bad else self.sample_rate

    @property
    def stated_rate(self) -> float | None:
        """Samples a second (Hz) as asked for or as known, rows that were dropped aside."""
        return self._options.resample or self.sample_rate

    @property
    def has_time(self) -> bool:
        """Whether samples carry a time, from a column or a sample rate."""
        return self.time is not None or self.sample_rate is not None

    def describe(self) -> str:
        """Tell in one line how the log is written and what was chosen, for ``verbose``."""
        chosen = [f"{role} is column {column.number}" for role, column in self.columns.items()]
        if self.time is not None:
            chosen.insert(0, f"time is column {self.time.number}")
        return f"{self._table.describe()}; {', '.join(chosen)}"

    def require_time(self, why: str) -> None:
        """Refuse a log without time, naming the remedy.

        Raises
        ------
        InputError
            There is neither a time column nor a sample rate.
        """
        if not self.has_time:
            raise InputError(
                f"{self.name}: no time column and no sample rate, and {why} "
                "(`time` COLUMN or `sample_rate` HZ)"
            )

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
        return input_record(self._address, self.rows_read, self._table.sha256)

    def _as_recorded(self) -> Iterator[SampleBlock]:
        picks = dict(self.columns)
        if self.time is not None:
            picks[_TIME] = self.time
        check: TimeCheck | None = None
        empty = True
        most = self._options.block_rows
        for raw in self._table.blocks(picks, self._options.rows, self._options.skip_bad, most):
            for start in range(0, len(raw.rows), most):
                block = self._with_time(raw.part(start, start + most))
                if self.time is not None and block.time is not None:
                    check = check or TimeCheck(self.name, has_lines=block.lines is not None)
                    check.feed(block.time, block.rows, block.lines)
                empty = False
                self.rows_read += len(block)
                yield block
        if check is not None:
            self.notes.extend(check.notes())
        if empty:
            raise InputError(f"{self.name}: {self._nothing()}")

    def _nothing(self) -> str:
        first, last = self._options.rows
        if (first, last) != ALL_ROWS:
            return f"`rows` {first}:{last or ''} is beyond the last data row"
        return "no good data row" if self._options.skip_bad else "no data rows"

    def _with_time(self, raw: SampleBlock) -> SampleBlock:
        """Take the time out of the columns, or make it from the sample rate."""
        values = dict(raw.values)
        time = None
        if self.time is not None:
            time = to_seconds(values.pop(_TIME), self.time.unit)
        elif self.sample_rate is not None:
            time = (np.asarray(raw.rows, dtype=np.float64) - 1.0) / self.sample_rate
        return SampleBlock(raw.rows, raw.lines, time, values)


def open_log(
    address: str,
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
        A file, ``FILE::/group`` of an HDF5 file, or ``-`` for standard input.
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
    named = [wish.selector for wish in want.values() if wish.selector]
    if options.time:
        named.append(options.time)
    table = _open_table(parse_address(address, options.format), options, live, digest, named)
    try:
        clock, notes = _find_time(table, options.time, options.sample_rate, want)
        columns = choose_columns(table.place, table.columns, want, [clock] if clock else [])
    except BaseException:
        table.close()
        raise
    table.notes.extend(notes)
    if options.sample_rate is not None:
        clock = None
    rate = options.sample_rate or (None if clock else table.sample_rate)
    return SignalLog(address, table, columns, clock, rate, options)


def _open_table(
    address: Address, options: ReadingOptions, live: bool, digest: bool, named: Sequence[str]
) -> Table:
    kind = address.kind
    if not address.is_stream and os.path.isfile(address.path) and os.access(address.path, os.R_OK):
        with open(address.path, "rb") as file:  # what a file is called matters less than what it is
            if file.read(8) == HDF5_SIGNATURE:
                kind = "hdf5"
    if kind == "hdf5":
        from dbo_cli.logs.hdf5_logs import Hdf5Table

        return Hdf5Table(address, named)
    return TextTable(address, options, live=live, digest=digest)


def _find_time(
    table: Table, selector: str | None, sample_rate: float | None, want: Mapping[str, ColumnWish]
) -> tuple[ColumnInfo | None, list[str]]:
    """Find the time column; a sample rate given by the user replaces one that was only guessed."""
    if selector is not None:
        return find_column(table.place, table.columns, selector, "time"), []
    named = []
    for wish in want.values():
        if wish.selector is not None:
            named.append(find_column(table.place, table.columns, wish.selector, wish.option).number)
    found = [column for column in guess_columns(table.columns, TIME_GUESSES) if column.number not in named]
    if sample_rate is not None:
        notes = [f"{table.place}: `sample_rate` replaces the column '{one.name}'" for one in found[:1]]
        return (found[0] if len(found) == 1 else None), notes
    if len(found) > 1:
        names = " or ".join(f"'{column.name}'" for column in found)
        raise InputError(
            f"{table.place}: which column is the time, {names}? (choose with `time` NAME or NUMBER)"
        )
    return (found[0] if found else None), []
