"""Several files as one log: what each has of the same moments stands beside each other.

Rows belong together by time. Every file needs a clock for that, a column or a rate that
it states; what has other rows than the displacement's file is interpolated onto the
rows of that one. Without clocks rows belong together by number, but only where
``sample_rate`` says so (or ``time`` names a column of another file), and the files must
be equally long.
"""

from __future__ import annotations

import itertools
import os
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.interpolation.smooth import interpolated
from dbo_cli.logs.clock import DATE, Clock, clock_of, find_clock
from dbo_cli.logs.clock_offset import ClockOffset, find_offset
from dbo_cli.logs.columns import ColumnWish, choose_columns, find_column
from dbo_cli.logs.request import ReadingOptions, Request, other_file, parse_address
from dbo_cli.logs.sample_block import (
    GAP_STEPS,
    JITTER,
    TIME,
    Column,
    DroppedRows,
    FloatArray,
    SampleBlock,
    Table,
    joined,
    median_step,
)

TARGETS = ("displacement", "measured")
"""Roles whose file has the rows that all else is interpolated onto; else the first file has them."""

DRIVES = ("voltage", "desired")
"""Roles that a clock's offset is looked for with."""

APART = 5.0
"""Standard deviations from which on two clocks count as apart, beyond a sample of the slower one."""

LOST_ZERO = 1e8
"""Seconds: a clock beyond counts from a calendar's zero, one within from its own."""


@dataclass
class _File:
    """One of the files: the columns wanted of it, by number in the joined log, and its clock."""

    table: Table
    columns: dict[int, Column]
    time: Column | None = None
    # samples a second, and the first row's time (s)
    rate: tuple[float, float] | None = None
    wishes: list[str] = field(default_factory=list)

    @property
    def place(self) -> str:
        """How messages call the file."""
        return self.table.place

    def clock(self, time_unit: str | None) -> Clock:
        """Return its clock, ready to be read from the first row on."""
        if self.time is None:
            rate, start = self.rate or (None, 0.0)
            return Clock(self.place, rate=rate, start=start)
        return clock_of(self.place, self.time, self.table.columns, time_unit)


class _Timed(NamedTuple):
    """All rows of one file with their times (s)."""

    block: SampleBlock
    time: FloatArray


class JoinedTable(Table):
    """Several files as one: columns of others behind those of the first, which has the place and the notes.

    Parameters
    ----------
    first
        The first file.
    options
        How all files are to be read.
    open_table
        Opens another file.
    """

    def __init__(
        self,
        first: Table,
        options: ReadingOptions,
        open_table: Callable[[Request], Table],
    ) -> None:
        self.place, self.notes = first.place, first.notes
        self.dropped, self.doubtful = DroppedRows(), first.doubtful
        self.columns = list(first.columns)
        self.files = {
            "": _File(first, {column.number: column for column in first.columns})
        }
        self.warnings: list[str] = []
        self._options = options
        self._open_table = open_table
        self._target = self.files[""]
        self._by_time = False

    def number_of(self, wish: ColumnWish, role: str = "") -> str | None:
        """Return the selector of a wished column, by its number here where it is another file's.

        Raises
        ------
        InputError
            A file or a column is absent.
        """
        if names_file(wish.selector, self.columns):
            return self._guessed_in(wish, role)
        named = other_file(wish.selector)
        if named is None:
            path, mark, _ = (wish.selector or "").partition("::")
            if mark and all(
                wish.selector not in (one.name, one.quantity) for one in self.columns
            ):
                takes = f"`{wish.option}` FILE::COLUMN takes a column of another file"
                raise InputError(f"{path}: no such file ({takes})")
            return wish.selector
        address, selector = named
        if address not in self.files:
            there = replace(self._options, format=None, time=None)
            self.others = [*self.others, address]
            table = self._open_table(Request(parse_address(address), there, [selector]))
            self.files[address] = _File(table, {})
        file = self.files[address]
        file.wishes.append(role)
        self._append(
            file, find_column(file.place, file.table.columns, selector, wish.option)
        )
        return f"number={len(self.columns)}"

    def _guessed_in(self, wish: ColumnWish, role: str) -> str:
        """Return the selector of the column that a role takes in a file of which only the name is given."""
        address = wish.selector or ""
        if address not in self.files:
            there = replace(self._options, format=None, time=None)
            self.others = [*self.others, address]
            self.files[address] = _File(
                self._open_table(Request(parse_address(address), there, [])), {}
            )
        file = self.files[address]
        file.wishes.append(role)
        columns = file.table.columns
        clock = find_clock(file.place, columns, replace(self._options, time=None), [])
        guessed = choose_columns(
            file.place, columns, {role: replace(wish, selector=None)}, clock.taken
        )
        self._append(file, guessed[role])
        return f"number={len(self.columns)}"

    def _append(self, file: _File, column: Column) -> Column:
        """Add a column of another file to those of the log; return it as it stands there."""
        number = len(self.columns) + 1
        added = replace(column, name=f"{file.place}::{column.name}", number=number)
        self.columns.append(added)
        file.columns[number] = column
        return added

    # ---- clocks

    def find_clocks(self, options: ReadingOptions) -> None:
        """Find every file's clock.

        Raises
        ------
        InputError
            A file has none, and nothing says that rows belong together by number.
        """
        if options.sample_rate is not None or (
            options.time is not None and "number=" in options.time
        ):
            self._refuse_offset("rows belong together by number here")
            return
        first, *others = self.files.values()
        self._target = next(
            (file for file in others if set(file.wishes) & set(TARGETS)), first
        )
        for file in self.files.values():
            self._find_clock(file, options)
        needed = [
            file
            for file in self.files.values()
            if file is not first or self._first_is_used()
        ]
        for file in needed:
            if file.time is None and file.rate is None:
                raise InputError(
                    f"{file.place}: has no clock, and rows of two files belong together by time (`time` "
                    "COLUMN names it; where both were recorded row by row, `sample_rate` HZ or `time` "
                    "FILE::COLUMN is the clock of both)"
                )
        self._by_time = True
        self.ready_clock = self._clock_of_target(options)

    def _refuse_offset(self, why: str) -> None:
        if self._options.clock_offset is not None:
            raise InputError(f"{self.place}: `clock_offset` moves a clock, and {why}")

    def _first_is_used(self) -> bool:
        """Tell whether the first file has columns of its own to be read beside its clock."""
        return self._target is self.files[""] or not any(
            set(file.wishes) & set(DRIVES) for file in self.files.values()
        )

    def _find_clock(self, file: _File, options: ReadingOptions) -> None:
        """Find the time column of a file, or the rate that it states."""
        first = file is self.files[""]
        wanted = list(file.columns.values()) if not first else []
        own = options if first else replace(options, time=None)
        clock = find_clock(file.place, list(file.table.columns), own, wanted)
        if clock.column is not None:
            file.time = clock.column
            return
        columns = list(file.columns.values())
        rate, start = file.table.even_clock(columns)
        if rate is not None:
            file.rate = rate, start

    def _clock_of_target(self, options: ReadingOptions) -> Clock:
        """Return the clock of the file whose rows are kept, by its columns' numbers in the log."""
        first = self.files[""]
        taken = [] if first.time is None else [first.time]
        clock = self._target.clock(options.time_unit)
        if clock.column is None:  # its rate is what ``even_clock`` finds
            return Clock(self.place, taken=taken)
        if self._target is first:
            clock.taken = [*taken, *clock.picks.values()]
            return clock
        added = {
            role: self._append(self._target, column)
            for role, column in clock.picks.items()
        }
        clock.column = replace(
            added[TIME], unit=clock.column.unit, written=clock.column.written
        )
        clock.date = added.get(DATE)
        clock.taken = [*taken, *added.values()]
        return clock

    def even_clock(self, columns: Collection[Column]) -> tuple[float | None, float]:
        """Return the stated sample rate (Hz) of the rows that are kept, and the first one's time (s)."""
        if self._by_time:
            return self._target.rate or (None, 0.0)
        return self.files[""].table.even_clock(
            [column for column in columns if column.number in self.files[""].columns]
        )

    def describe(self) -> str:
        """Describe in one line how each file is written."""
        return "; ".join(file.table.describe() for file in self.files.values())

    # ---- rows

    def blocks(self, picks: Mapping[str, Column]) -> Iterator[SampleBlock]:
        """Read the wanted columns of all files in blocks.

        Raises
        ------
        InputError
            Files without clocks are not equally long; or clocks have no moment in
            common.
        """
        wanted = {}
        for address, file in self.files.items():
            own = {
                role: replace(file.columns[pick.number], may_be_blank=pick.may_be_blank)
                for role, pick in picks.items()
                if pick.number in file.columns
            }
            if own:
                wanted[address] = own
        if self._by_time and len(wanted) > 1:
            yield from self._joined_by_time(wanted)
        else:
            yield from self._joined_by_row(wanted)
        for address, file in self.files.items():
            self.dropped.extend(file.table.dropped)
            if address:
                self.notes.extend(file.table.notes)
                self.doubtful.extend(
                    f"{file.place}: {text}" for text in file.table.doubtful
                )

    def _joined_by_row(
        self, wanted: Mapping[str, Mapping[str, Column]]
    ) -> Iterator[SampleBlock]:
        """Put rows of equal number beside each other; a row dropped in one file is dropped in all."""
        places = [self.files[address].place for address in wanted]
        streams = [
            self.files[address].table.blocks(own) for address, own in wanted.items()
        ]
        unequal: list[str] = []
        for parts in _in_step(places, streams, self._options.skip_bad, unequal):
            yield _merged(parts)
        self.notes.extend(unequal)
        self.doubtful.extend(unequal)

    def _joined_by_time(
        self, wanted: Mapping[str, Mapping[str, Column]]
    ) -> Iterator[SampleBlock]:
        """Interpolate what other files have onto the rows of one."""
        target = self._target
        own = next(
            (
                columns
                for address, columns in wanted.items()
                if self.files[address] is target
            ),
            {},
        )
        rows = self._read(target, own)
        _require_forward(target.place, rows)
        keep = np.ones(len(rows.block), dtype=bool)
        values = dict(rows.block.values)
        for address, columns in wanted.items():
            file = self.files[address]
            if file is target:
                continue
            given = self._on_clock_of(rows, file, self._read(file, columns), columns)
            if _same_rows(rows, given):
                values |= given.block.values
                continue
            inside = self._covered(rows, file, given)
            keep &= inside
            for role in columns:
                values[role] = _between_gaps(given, role, rows.time)
            names = ", ".join(f"'{column.name}'" for column in columns.values())
            self.notes.append(
                f"{file.place}: {names} joined by time: interpolated onto the rows of {target.place}"
            )
        whole = replace(rows.block, time=None, values=values)
        yield whole if keep.all() else whole.chosen(keep)

    def _read(self, file: _File, columns: Mapping[str, Column]) -> _Timed:
        """Read all rows of a file, with their times."""
        clock = file.clock(self._options.time_unit)
        picks = {**columns, **clock.picks}
        pieces, times = [], []
        for block in filter(len, clock.held_back(file.table.blocks(picks))):
            time = clock.times(block.rows, dict(block.values))
            assert time is not None
            times.append(time)
            values = {role: block.values[role] for role in columns}
            pieces.append(replace(block, values=values))
        if not pieces:
            raise InputError(f"{file.place}: no data rows")
        return _Timed(joined(pieces), np.concatenate(times))

    def _on_clock_of(
        self,
        rows: _Timed,
        file: _File,
        given: _Timed,
        columns: Mapping[str, Column],
    ) -> _Timed:
        """Return another file's rows on the clock of the one whose rows are kept, each stamp once.

        Raises
        ------
        InputError
            Its time goes backwards, or the offset that is asked for cannot be found.
        """
        asked = self._options.clock_offset
        _require_forward(file.place, given)
        if asked is None and (_same_rows(rows, given) or len(given.time) < 2):
            return given
        given = _each_stamp_once(given)
        place = f"{file.place} and {self._target.place}"
        if isinstance(asked, float):
            return given._replace(time=given.time + asked)
        drive = next(
            (given.block.values[role] for role in columns if role in DRIVES), None
        )
        sensor = next(
            (rows.block.values[role] for role in rows.block.values if role in TARGETS),
            None,
        )
        if drive is None or sensor is None:
            if asked == "auto":
                raise InputError(
                    f"{place}: `clock_offset` auto needs a drive and a displacement"
                )
            return given
        if asked == "auto":
            moved = find_offset(given.time, drive, rows.time, sensor, place)
            self._say(file, moved)
            return given._replace(time=moved.moved(given.time))
        self._warn_of_offset(file, rows, given, drive, sensor, place)
        return given

    def _say(self, file: _File, moved: ClockOffset) -> None:
        text = (
            f"{file.place}: `clock_offset` auto: its clock is moved by {moved.seconds:.6g} s "
            f"(± {2.0 * moved.deviation:.2g} s; a delay of the actuator is part of it)"
        )
        if moved.drift:
            text += f", and runs {1e6 * moved.drift:.3g} ppm (± {2e6 * moved.drift_deviation:.2g}) slower"
        self.notes.append(text)

    def _warn_of_offset(
        self,
        file: _File,
        rows: _Timed,
        given: _Timed,
        drive: FloatArray,
        sensor: FloatArray,
        place: str,
    ) -> None:
        """Warn where the two clocks are apart by what the signals show."""
        if _overlap(rows.time, given.time) <= 0.0:
            return
        try:
            apart = find_offset(given.time, drive, rows.time, sensor, place)
        except InputError:
            return
        slower = max(
            median_step(np.diff(given.time)),
            float(np.ptp(rows.time)) / max(len(rows.time) - 1, 1),
        )
        if abs(apart.seconds) > slower + APART * apart.deviation:
            self.warnings.append(
                f"{place}: by what they recorded their clocks are {abs(apart.seconds):.3g} s apart "
                "(`clock_offset` auto moves the drive's; a delay of the actuator looks the same)"
            )
        elif apart.drift:
            faster, known = abs(1e6 * apart.drift), 2e6 * apart.drift_deviation
            self.warnings.append(
                f"{place}: one clock runs {faster:.3g} ppm (± {known:.2g}) "
                "faster than the other (`clock_offset` auto takes it off)"
            )

    def _covered(self, rows: _Timed, file: _File, given: _Timed) -> NDArray[np.bool_]:
        """Return which rows another file covers, and say what is left out.

        Raises
        ------
        InputError
            None are.
        """
        before, behind = rows.time < given.time[0], rows.time > given.time[-1]
        if (before | behind).all():
            apart = float(rows.time[0] - given.time[0])
            raise InputError(
                f"{self._target.place} and {file.place} have no time in common: {_span(rows.time)} and "
                f"{_span(given.time)} (`clock_offset` {apart:.12g} lets both begin together, auto finds it)"
            )
        place = np.searchsorted(given.time, rows.time, side="right") - 1
        exact = given.time[np.clip(place, 0, None)] == rows.time
        gaps = np.isin(place, np.flatnonzero(_gaps(given))) & ~exact
        for left, why in (
            (before, "before it begins"),
            (behind, "after it ends"),
            (gaps, "in its gaps"),
        ):
            if left.any():
                self.notes.append(
                    f"{self._target.place}: {int(np.count_nonzero(left)):,} rows are left out: "
                    f"{file.place} has "
                    f"none {why}"
                )
        covered: NDArray[np.bool_] = ~(before | behind | gaps)
        return covered

    def close(self) -> None:
        """Close all files."""
        for file in self.files.values():
            file.table.close()

    @property
    def sha256(self) -> str | None:
        """The digest of the first file, where it was asked for."""
        return self.files[""].table.sha256


def names_file(selector: str | None, columns: Sequence[Column]) -> bool:
    """Tell whether a selector is the name of a file alone, and of no column."""
    if selector is None or "::" in selector or not os.path.isfile(selector):
        return False
    return all(selector not in (column.name, column.quantity) for column in columns)


def _span(time: FloatArray) -> str:
    """Write from when to when a clock goes."""
    digits = "15g" if abs(float(time[0])) > LOST_ZERO else "6g"
    return f"{float(time[0]):.{digits}} to {float(time[-1]):.{digits}} s"


def _overlap(here: FloatArray, there: FloatArray) -> float:
    """Return how long two clocks go together (s)."""
    return min(float(here[-1]), float(there[-1])) - max(float(here[0]), float(there[0]))


def _same_rows(rows: _Timed, given: _Timed) -> bool:
    """Tell whether two files have the same rows at the same times, to a twentieth of a step."""
    if len(rows.time) != len(given.time) or not np.array_equal(
        rows.block.rows, given.block.rows
    ):
        return False
    if len(rows.time) < 2:
        return bool(np.array_equal(rows.time, given.time))
    step = median_step(np.abs(np.diff(rows.time)))
    return bool((np.abs(rows.time - given.time) <= JITTER * step).all())


def _require_forward(place: str, given: _Timed) -> None:
    """Refuse a clock that goes backwards (InputError)."""
    back = np.flatnonzero(np.diff(given.time) < 0.0)
    if len(back):
        raise InputError(
            f"{given.block.place(place, int(back[0]) + 1)}: time goes backwards, so its rows cannot be "
            "joined by time (`rows` A:B cuts all files)"
        )


def _gaps(given: _Timed) -> NDArray[np.bool_]:
    """Return after which rows at least one is missing."""
    # rows that were left out as they were read
    missing = np.diff(np.asarray(given.block.rows)) > 1
    steps = np.diff(given.time)
    if len(steps):
        missing |= steps > GAP_STEPS * median_step(steps)
    return missing


def _between_gaps(given: _Timed, role: str, wanted: FloatArray) -> FloatArray:
    """Return a signal at other times, made of the samples on the same side of every gap."""
    values = given.block.values[role]
    found = np.empty(len(wanted))
    ends = [*(np.flatnonzero(_gaps(given)) + 1).tolist(), len(values)]
    begin = done = 0
    for end in ends:
        last = len(wanted)
        if end < len(values):
            last = int(np.searchsorted(wanted, given.time[end], side="left"))
        piece = slice(begin, end)
        found[done:last], _ = interpolated(
            given.time[piece], values[piece], wanted[done:last]
        )
        begin, done = end, last
    return found


def _each_stamp_once(given: _Timed) -> _Timed:
    """Return rows with the mean of those that have one stamp."""
    stamps, begins, counts = np.unique(
        given.time, return_index=True, return_counts=True
    )
    if len(stamps) == len(given.time):
        return given
    values = {
        role: np.add.reduceat(signal, begins) / counts
        for role, signal in given.block.values.items()
    }
    first_of_stamp = np.zeros(len(given.time), dtype=bool)
    first_of_stamp[begins] = True
    block = given.block.chosen(first_of_stamp)
    return _Timed(replace(block, values=values), stamps)


def _merged(parts: Sequence[SampleBlock]) -> SampleBlock:
    """Put parts of several files beside each other; rows that one of them lacks are left out."""
    common = np.asarray(parts[0].rows)
    for part in parts[1:]:
        if len(part) != len(common) or not np.array_equal(part.rows, common):
            common = np.intersect1d(common, np.asarray(part.rows), assume_unique=True)
    parts = [
        one if len(one) == len(common) else one.chosen(np.isin(one.rows, common))
        for one in parts
    ]
    values = dict(itertools.chain.from_iterable(part.values.items() for part in parts))
    return replace(parts[0], time=None, values=values)


def _in_step(
    places: Sequence[str],
    found: Sequence[Iterator[SampleBlock]],
    skip_bad: bool,
    notes: list[str],
) -> Iterator[list[SampleBlock]]:
    """Cut the blocks of several files at common rows.

    Raises
    ------
    InputError
        The files are not equally long (with ``skip_bad`` that is a note).
    """
    streams = [filter(len, blocks) for blocks in found]  # a block may be empty
    pending = [next(stream, None) for stream in streams]
    last = [0] * len(streams)
    while all(pending):
        blocks = [block for block in pending if block is not None]
        upto = min(int(block.rows[-1]) for block in blocks)
        cuts = [bisect_right(block.rows, upto) for block in blocks]
        yield [block.part(0, cut) for block, cut in zip(blocks, cuts, strict=True)]
        last = [int(block.rows[-1]) for block in blocks]
        rests = [
            block.part(cut, len(block)) for block, cut in zip(blocks, cuts, strict=True)
        ]
        pending = [
            rest if len(rest) else next(one, None)
            for rest, one in zip(rests, streams, strict=True)
        ]
    if not any(pending):
        return
    for number, block in enumerate(pending):
        # how far are they apart?
        for rest in [block, *streams[number]] if block is not None else []:
            last[number] = int(rest.rows[-1])
    counts = ", ".join(
        f"{name} {count}" for name, count in zip(places, last, strict=True)
    )
    if not skip_bad:
        raise InputError(
            f"the files are not equally long: {counts} rows (`rows` A:B cuts all of them)"
        )
    notes.append(
        f"the files do not end at the same row: {counts}: the rows beyond the shortest are left out"
    )
