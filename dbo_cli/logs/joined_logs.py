"""One log in several files: a column of another file beside those of the first (``FILE::COLUMN``).

Rows belong together by number.  Where both files have clocks, they must agree; where only one has, or none,
the files must be equally long.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import other_file, parse_address
from dbo_cli.logs.clock import JITTER, median_step
from dbo_cli.logs.columns import ColumnWish, find_column
from dbo_cli.logs.file_kinds import open_table
from dbo_cli.logs.reading_options import ReadingOptions, Rows
from dbo_cli.logs.sample_block import TIME, ColumnInfo, FloatArray, SampleBlock
from dbo_cli.logs.time_column import TimeColumn, find_time_column, time_column

if TYPE_CHECKING:
    from dbo_cli.logs.sample_block import Table

_CLOCK = "the clock of file "  # the role of a file's seconds while clocks are compared


@dataclass
class _Other:
    """Another file: the columns wanted of it, and its clock if it has one."""

    table: Table
    columns: dict[int, ColumnInfo]  # number in the joined log to column in the file
    clock: TimeColumn | None = None


class Joined(NamedTuple):
    """The files of a log as one.

    Attributes
    ----------
    table
        All columns; the first file itself where there is no other.
    want, options
        As they were asked for, the columns of other files by their numbers in ``table``.
    others
        The addresses of the other files.
    """

    table: Table
    want: dict[str, ColumnWish]
    options: ReadingOptions
    others: list[str]


def join_files(table: Table, want: Mapping[str, ColumnWish], options: ReadingOptions) -> Joined:
    """Open the other files that wishes name, and put their columns behind those of the first.

    Parameters
    ----------
    table
        The first file.
    want
        Role to wish; those of the form ``FILE::COLUMN`` are replaced by column numbers of the joined log.
    options
        How all files are to be read; ``time`` names a column of the first, or of another file.

    Raises
    ------
    InputError
        A file or a column is absent.
    """
    others: dict[str, _Other] = {}
    columns = list(table.columns)
    wishes = dict(want)
    there = replace(options, format=None, time=None)

    def number_of(wish: ColumnWish) -> str | None:
        named = other_file(wish.selector)
        if named is None:
            _refuse_missing(table, wish)
            return wish.selector
        address, selector = named
        if address not in others:
            opened = open_table(parse_address(address), there, False, False, [selector])
            others[address] = _Other(opened, {})
        found = find_column(others[address].table.place, others[address].table.columns, selector, wish.option)
        _append(columns, others[address], found)
        return f"number={len(columns)}"

    try:
        for role, wish in want.items():
            wishes[role] = replace(wish, selector=number_of(wish))
        if options.time is not None:
            options = replace(options, time=number_of(ColumnWish(options.time, option="time")))
        _find_clocks(table, columns, list(others.values()), options)
    except BaseException:
        for other in others.values():
            other.table.close()
        raise
    if others:
        table = _JoinedTable(table, list(others.values()), columns, options)
    return Joined(table, wishes, options, list(others))


def _append(columns: list[ColumnInfo], other: _Other, found: ColumnInfo) -> None:
    columns.append(replace(found, name=f"{other.table.place}::{found.name}", number=len(columns) + 1))
    other.columns[len(columns)] = found


def _find_clocks(
    table: Table, columns: list[ColumnInfo], others: Sequence[_Other], options: ReadingOptions
) -> None:
    """Find the other files' clocks; where the first file has none, another's becomes that of the log."""
    if options.sample_rate is not None:
        return  # the clocks are replaced
    mine = columns if options.time is not None else list(table.columns)
    own = find_time_column(table.place, list(mine), options, [])
    for other in others:
        wanted = list(other.columns.values())
        plain = replace(options, time=None)
        other.clock = find_time_column(other.table.place, other.table.columns, plain, wanted).clock
        if own.clock is None and other.clock is not None:
            for found in other.clock.picks.values():
                _append(columns, other, found)
            own = find_time_column(table.place, columns, options, [])


def _refuse_missing(table: Table, wish: ColumnWish) -> None:
    """Say that a file is missing where ``FILE::COLUMN`` was meant."""
    if wish.selector is None or "::" not in wish.selector:
        return
    if all(wish.selector not in (column.name, column.quantity) for column in table.columns):
        path = wish.selector.partition("::")[0]
        raise InputError(
            f"{path}: no such file (`{wish.option}` FILE::COLUMN takes a column of another file)"
        )


class _JoinedTable:
    """Several files as one table; fulfils the protocol of ``signal_log.Table``."""

    def __init__(
        self, first: Table, others: list[_Other], columns: list[ColumnInfo], options: ReadingOptions
    ) -> None:
        self.place = first.place
        self.columns = columns
        self.notes = first.notes
        self._first = first
        self._others = others
        self._options = options

    def describe(self) -> str:
        """Tell in one line how each file is written."""
        return "; ".join([self._first.describe(), *(other.table.describe() for other in self._others)])

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Give the sample rate (Hz) on which all files that state one agree, and the first row's time (s).

        Raises
        ------
        InputError
            They do not agree.
        """
        own = [column for column in columns if column.number <= len(self._first.columns)]
        rate, start = self._first.even_clock(own)
        for other in self._others:
            rate_there, start_there = other.table.even_clock(list(other.columns.values()))
            if rate is None:
                rate, start = rate_there, start_there
            elif rate_there is not None and (abs(rate_there - rate) > 1e-6 * rate or start_there != start):
                raise InputError(
                    f"{self.place} has {rate:g} samples a second from {start:g} s on, {other.table.place} "
                    f"{rate_there:g} from {start_there:g} s on (`sample_rate` HZ takes them row by row)"
                )
        return rate, start

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns of all files in blocks; a row dropped in one is dropped in all.

        Raises
        ------
        InputError
            The files are not equally long, or their clocks do not agree.
        """
        own = {role: pick for role, pick in picks.items() if pick.number <= len(self._first.columns)}
        streams, names = [], []
        if own:
            blocks = self._first.blocks(own, rows, skip_bad, block_rows)
            if TIME in own:
                unit = self._options.time_unit
                clock = time_column(self.place, own[TIME], list(self._first.columns), unit)
                blocks = _with_seconds(clock, blocks, _CLOCK, {})
            streams.append(blocks)
            names.append(self.place)
        for other in self._others:
            there = {
                role: other.columns[n] for role, pick in picks.items() if (n := pick.number) in other.columns
            }
            own_clock = TIME in there  # the log's clock is this file's: nothing to compare it with
            extra = {} if other.clock is None or own_clock or TIME not in own else dict(other.clock.picks)
            blocks = other.table.blocks(there | extra, rows, skip_bad, block_rows)
            if extra and other.clock is not None:
                blocks = _with_seconds(other.clock, blocks, _CLOCK + other.table.place, extra)
            streams.append(blocks)
            names.append(other.table.place)
        check = _ClockCheck(self.place)
        for block in _in_step(names, streams, skip_bad, self.notes):
            yield check.checked(block)
        for other in self._others:
            self.notes.extend(other.table.notes)

    def close(self) -> None:
        """Close all files."""
        self._first.close()
        for other in self._others:
            other.table.close()

    @property
    def sha256(self) -> str | None:
        """The digest of the first file, where it was asked for."""
        return self._first.sha256


def _with_seconds(
    clock: TimeColumn, blocks: Iterator[SampleBlock], role: str, extra: Mapping[str, ColumnInfo]
) -> Iterator[SampleBlock]:
    """Add the seconds of a file's clock under a role; the columns in ``extra`` were read for that alone."""
    for block in clock.held_back(blocks):
        seconds = clock.seconds(dict(block.values))
        values = {name: array for name, array in block.values.items() if name not in extra}
        yield SampleBlock(block.rows, block.lines, block.time, values | {role: seconds})


@dataclass
class _ClockCheck:
    """Compares the clocks of all files with the first one's, row by row."""

    place: str
    step: float = 0.0

    def checked(self, block: SampleBlock) -> SampleBlock:
        """Refuse a block whose clocks disagree (InputError); give it back without the compared clocks."""
        clocks = {role: array for role, array in block.values.items() if role.startswith(_CLOCK)}
        if not clocks:
            return block
        values = {role: array for role, array in block.values.items() if role not in clocks}
        here = clocks.pop(_CLOCK, None)
        if here is not None:
            for role, there in clocks.items():
                self._compare(block, here, there, role.removeprefix(_CLOCK))
        return SampleBlock(block.rows, block.lines, block.time, values)

    def _compare(self, block: SampleBlock, here: FloatArray, there: FloatArray, name: str) -> None:
        if self.step == 0.0 and len(here) > 1:
            self.step = median_step(np.abs(np.diff(here)))
        apart = np.flatnonzero(~(np.abs(here - there) <= JITTER * self.step))
        if len(apart):
            index = int(apart[0])
            raise InputError(
                f"{self.place}: row {block.rows[index]}: its time {here[index]:.6g} s is {there[index]:.6g} "
                f"s in {name} (bring both to one clock; `sample_rate` HZ takes them row by row)"
            )


def _in_step(
    names: list[str], streams: list[Iterator[SampleBlock]], skip_bad: bool, notes: list[str]
) -> Iterator[SampleBlock]:
    """Merge blocks of several files by row number."""
    pending: list[SampleBlock | None] = [None] * len(streams)
    last = [0] * len(streams)
    while True:
        for number, stream in enumerate(streams):
            while pending[number] is None or not len(pending[number] or ()):
                block = next(stream, None)
                pending[number] = block
                if block is None:
                    break
                if len(block):
                    last[number] = int(block.rows[-1])
        here = [block for block in pending if block is not None]
        if len(here) < len(streams):
            if here:
                _unequal(names, streams, pending, last, skip_bad, notes)
            return
        upto = min(int(block.rows[-1]) for block in here)
        cuts = [int(np.searchsorted(np.asarray(block.rows), upto, side="right")) for block in here]
        yield _merged(
            [block.part(0, cut) if cut else block.part(0, 0) for block, cut in zip(here, cuts, strict=True)]
        )
        pending = [
            block.part(cut, len(block)) if cut else block for block, cut in zip(here, cuts, strict=True)
        ]


def _unequal(
    names: list[str],
    streams: list[Iterator[SampleBlock]],
    pending: list[SampleBlock | None],
    last: list[int],
    skip_bad: bool,
    notes: list[str],
) -> None:
    for number, stream in enumerate(
        streams
    ):  # count to the end, so that the message says how far they are apart
        for block in stream if pending[number] is not None else ():
            last[number] = int(block.rows[-1]) if len(block) else last[number]
    told = ", ".join(f"{name} {count}" for name, count in zip(names, last, strict=True))
    if not skip_bad:
        raise InputError(f"the files are not equally long: {told} rows (`rows` A:B cuts all of them)")
    notes.append(f"the files do not end at the same row: {told}: the rows beyond the shortest are left out")


def _merged(parts: list[SampleBlock]) -> SampleBlock:
    first = parts[0]
    values = {role: array for part in parts for role, array in part.values.items()}
    if all(len(part) == len(first) and np.array_equal(part.rows, first.rows) for part in parts[1:]):
        return SampleBlock(first.rows, first.lines, first.time, values)
    common = np.asarray(first.rows)
    for part in parts[1:]:
        common = np.intersect1d(common, np.asarray(part.rows), assume_unique=True)
    kept = {
        role: array[np.isin(np.asarray(part.rows), common)]
        for part in parts
        for role, array in part.values.items()
    }
    lines = None if first.lines is None else np.asarray(first.lines)[np.isin(np.asarray(first.rows), common)]
    return SampleBlock(common, lines, None, kept)
