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

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.addresses import HDF5_SIGNATURE, Address, parse_address
from dbo_cli.logs.clock import TimeCheck, parse_rows, resampled, to_seconds
from dbo_cli.logs.columns import TIME_GUESSES, ColumnWish, choose_columns, find_column, guess_columns
from dbo_cli.logs.provenance import InputRecord, input_record
from dbo_cli.logs.sample_block import Block, ColumnInfo, RawBlock, join_places
from dbo_cli.logs.text_dialect import DialectOptions
from dbo_cli.logs.text_logs import TextTable

BLOCK_ROWS = 1 << 16


class Table(Protocol):
    """What a format gives: its columns at once, its rows in blocks."""

    place: str
    columns: list[ColumnInfo]
    sample_rate: float | None
    notes: list[str]

    def describe(self) -> str:
        """Tell in one line how the log is written."""

    def blocks(
        self, picks: Sequence[ColumnInfo], rows: tuple[int, int | None], skip_bad: bool, block_rows: int
    ) -> Iterator[RawBlock]:
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
        rows: tuple[int, int | None],
        skip_bad: bool,
        block_rows: int,
        resample: float | None = None,
    ) -> None:
        self.name = table.place
        self._address = address
        self.columns = columns
        self.time = time
        self.sample_rate = sample_rate
        self.notes = table.notes
        self._table = table
        self._rows = rows
        self._skip_bad = skip_bad
        self._block_rows = max(1, block_rows)
        self._resample = resample
        self.rows_read = 0

    def __enter__(self) -> SignalLog:
        """Use the log as a context manager that closes it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the log."""
        self.close()

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

    def blocks(self) -> Iterator[Block]:
        """Read the samples in blocks; the blocks may be of any length, their samples always the same.

        Raises
        ------
        InputError
            A bad row, or no data row at all.
        """
        blocks = self._as_recorded()
        return blocks if self._resample is None else resampled(self.name, blocks, self._resample)

    def read(self) -> Block:
        """Read all samples as one block."""
        parts = list(self.blocks())
        if len(parts) == 1:
            return parts[0]
        time = (
            None
            if parts[0].time is None
            else np.concatenate([part.time for part in parts if part.time is not None])
        )
        values = {role: np.concatenate([part.values[role] for part in parts]) for role in self.columns}
        lines = [part.lines for part in parts if part.lines is not None]
        return Block(
            join_places([part.rows for part in parts]), join_places(lines) if lines else None, time, values
        )

    def close(self) -> None:
        """Close the file."""
        self._table.close()

    def record(self) -> InputRecord:
        """Record this log for a model's provenance, once it has been read (a stream: with ``digest``)."""
        return input_record(self._address, self.rows_read, self._table.sha256)

    def _as_recorded(self) -> Iterator[Block]:
        picks = [*self.columns.values(), *([self.time] if self.time is not None else [])]
        check: TimeCheck | None = None
        empty = True
        for raw in self._table.blocks(picks, self._rows, self._skip_bad, self._block_rows):
            for start in range(0, len(raw.rows), self._block_rows):
                block = self._block(raw.part(start, start + self._block_rows))
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
        if self._rows != (1, None):
            return f"`rows` {self._rows[0]}:{self._rows[1] or ''} is beyond the last data row"
        return "no good data row" if self._skip_bad else "no data rows"

    def _block(self, raw: RawBlock) -> Block:
        values = dict(zip(self.columns, raw.arrays, strict=False))
        time = None
        if self.time is not None:
            time = to_seconds(raw.arrays[-1], self.time.unit)
        elif self.sample_rate is not None:
            time = (np.asarray(raw.rows, dtype=np.float64) - 1.0) / self.sample_rate
        return Block(raw.rows, raw.lines, time, values)


def open_log(
    address: str,
    want: Mapping[str, ColumnWish],
    *,
    time: str | None = None,
    sample_rate: float | None = None,
    rows: str | None = None,
    skip_bad: bool = False,
    format: str | None = None,
    dialect: DialectOptions | None = None,
    block_rows: int = BLOCK_ROWS,
    live: bool = False,
    digest: bool = False,
    resample: float | None = None,
) -> SignalLog:
    """Open a log and find the columns that are wished for.

    Parameters
    ----------
    address
        A file, ``FILE::/group`` of an HDF5 file, or ``-`` for standard input.
    want
        Role to wish.
    time
        The time column's name or number; None guesses.
    sample_rate
        Samples a second (Hz), for a log without a time column; it replaces a guessed one.
    rows
        ``A:B``, data rows counted from 1, both ends included.
    skip_bad
        Drop and count rows with bad cells instead of refusing them.
    format
        ``csv``, ``tsv`` or ``hdf5``, where the name does not tell.
    dialect
        What is forced about a text log.
    block_rows
        The most rows in a block.
    live
        Give each row as it arrives (for ``tail -f``).
    digest
        Hash what is read from standard input, for the provenance record.
    resample
        Interpolate linearly to this rate (Hz).

    Raises
    ------
    InputError
        The log or a column is absent, unreadable or empty.
    UsageError
        The options contradict each other.
    """
    if sample_rate is not None and not (np.isfinite(sample_rate) and sample_rate > 0.0):
        raise UsageError(f"`sample_rate` {sample_rate:g}: give a positive number of samples a second")
    if resample is not None and not (np.isfinite(resample) and resample > 0.0):
        raise UsageError(f"`resample` {resample:g}: give a positive number of samples a second")
    if time is not None and sample_rate is not None:
        raise UsageError(
            "`time` and `sample_rate` exclude each other: the log has the one or needs the other"
        )
    limits = parse_rows(rows)
    named = [wish.selector for wish in want.values() if wish.selector] + ([time] if time else [])
    table = _open_table(parse_address(address, format), dialect or DialectOptions(), live, digest, named)
    try:
        clock, notes = _find_time(table, time, sample_rate, want)
        columns = choose_columns(table.place, table.columns, want, [clock] if clock else [])
    except BaseException:
        table.close()
        raise
    table.notes.extend(notes)
    rate = sample_rate if sample_rate is not None else (None if clock else table.sample_rate)
    if sample_rate is not None:
        clock = None
    return SignalLog(address, table, columns, clock, rate, limits, skip_bad, block_rows, resample)


def _open_table(
    address: Address, dialect: DialectOptions, live: bool, digest: bool, named: Sequence[str]
) -> Table:
    kind = address.kind
    if not address.is_stream and os.path.isfile(address.path) and os.access(address.path, os.R_OK):
        with open(address.path, "rb") as file:  # what a file is called matters less than what it is
            if file.read(8) == HDF5_SIGNATURE:
                kind = "hdf5"
    if kind == "hdf5":
        from dbo_cli.logs.hdf5_logs import Hdf5Table

        return Hdf5Table(address, named)
    return TextTable(address, dialect, live=live, digest=digest)


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
