"""One log in several files: a column of another file beside those of the first (``FILE::COLUMN``).

Rows belong together by number.  Where both files have clocks, they must agree; where only one has, or none,
the files must be equally long.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.clock import JITTER, to_seconds
from dbo_cli.logs.columns import TIME_GUESSES, ColumnWish, find_column, guess_columns
from dbo_cli.logs.reading_options import Rows
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray, SampleBlock

if TYPE_CHECKING:
    from dbo_cli.logs.signal_log import Table

_CLOCK = "its clock"  # the role of the other file's time column, beside the roles asked for


@dataclass
class _Other:
    """Another file: the columns wanted of it, and its clock if it has one."""

    table: Table
    columns: dict[int, ColumnInfo]  # number in the joined log to column in the file
    clock: ColumnInfo | None


def other_file(selector: str | None) -> tuple[str, str] | None:
    """Take ``FILE::COLUMN`` or ``FILE::GROUP::COLUMN`` apart; None for a plain column name."""
    if selector is None or "::" not in selector:
        return None
    path, _, rest = selector.partition("::")
    if not os.path.isfile(path):
        return None
    inner, separator, column = rest.rpartition("::")
    return (f"{path}::{inner}", column) if separator else (path, rest)


def join_files(
    table: Table, want: Mapping[str, ColumnWish], open_other: Callable[[str, str], Table]
) -> tuple[Table, dict[str, ColumnWish]]:
    """Open the other files that wishes name, and put their columns behind those of the first.

    Parameters
    ----------
    table
        The first file.
    want
        Role to wish; those of the form ``FILE::COLUMN`` are replaced by column numbers of the joined log.
    open_other
        Opens an address, told the column that will be asked for.

    Raises
    ------
    InputError
        A file or a column is absent.
    """
    others: dict[str, _Other] = {}
    columns = list(table.columns)
    wishes = dict(want)
    try:
        for role, wish in want.items():
            named = other_file(wish.selector)
            if named is None:
                _refuse_missing(table, wish)
                continue
            address, selector = named
            if address not in others:
                others[address] = _Other(open_other(address, selector), {}, None)
            other = others[address]
            found = find_column(other.table.place, other.table.columns, selector, wish.option)
            columns.append(replace(found, name=f"{other.table.place}::{found.name}", number=len(columns) + 1))
            other.columns[len(columns)] = found
            wishes[role] = replace(wish, selector=str(len(columns)))
        for other in others.values():
            clocks = guess_columns(other.table.columns, TIME_GUESSES)
            clocks = [one for one in clocks if one not in other.columns.values()]
            other.clock = clocks[0] if len(clocks) == 1 else None
            if other.clock is not None and not guess_columns(columns, TIME_GUESSES):
                place = f"{other.table.place}::{other.clock.name}"
                columns.append(replace(other.clock, name=place, number=len(columns) + 1))
                other.columns[len(columns)] = other.clock
    except BaseException:
        for other in others.values():
            other.table.close()
        raise
    return (_JoinedTable(table, list(others.values()), columns) if others else table), wishes


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

    def __init__(self, first: Table, others: list[_Other], columns: list[ColumnInfo]) -> None:
        self.place = first.place
        self.columns = columns
        self.notes = first.notes
        self._first = first
        self._others = others

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
        clock = _clock_role(own)
        streams = [self._first.blocks(own, rows, skip_bad, block_rows)] if own else []
        names = [self._first.place] if own else []
        for number, other in enumerate(self._others):
            there = {
                role: other.columns[pick.number]
                for role, pick in picks.items()
                if pick.number in other.columns
            }
            if clock is not None and other.clock is not None:
                there[f"{_CLOCK} {number}"] = other.clock
            streams.append(other.table.blocks(there, rows, skip_bad, block_rows))
            names.append(other.table.place)
        checks = _ClockChecks(self.place, clock, picks, self._others)
        for block in _in_step(names, streams, skip_bad, self.notes):
            yield checks.checked(block)
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


def _clock_role(picks: Mapping[str, ColumnInfo]) -> str | None:
    """Tell which role is the time: the one that ``signal_log`` adds to those asked for, always the last."""
    from dbo_cli.logs.signal_log import CLOCK_ROLE

    return CLOCK_ROLE if CLOCK_ROLE in picks else None


@dataclass
class _ClockChecks:
    """Compares the clocks of all files with the first one's, row by row."""

    place: str
    clock: str | None
    picks: Mapping[str, ColumnInfo]
    others: Sequence[_Other]
    step: float = 0.0

    def checked(self, block: SampleBlock) -> SampleBlock:
        """Refuse a block whose clocks disagree (InputError); give it back without the other clocks."""
        values = {role: array for role, array in block.values.items() if not role.startswith(_CLOCK)}
        if self.clock is not None:
            here = to_seconds(values[self.clock], self.picks[self.clock].unit)
            for role, array in block.values.items():
                if role.startswith(_CLOCK):
                    other = self.others[int(role.removeprefix(_CLOCK))]
                    assert other.clock is not None
                    self._compare(block, here, to_seconds(array, other.clock.unit), other)
        return SampleBlock(block.rows, block.lines, block.time, values)

    def _compare(self, block: SampleBlock, here: FloatArray, there: FloatArray, other: _Other) -> None:
        if self.step == 0.0 and len(here) > 1:
            self.step = float(np.median(np.abs(np.diff(here))))
        apart = np.flatnonzero(~(np.abs(here - there) <= JITTER * self.step))
        if len(apart):
            index = int(apart[0])
            raise InputError(
                f"{self.place}: row {block.rows[index]}: its time {here[index]:.6g} s is {there[index]:.6g} "
                f"s in {other.table.place} (bring both to one clock; `sample_rate` HZ takes them row by row)"
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
