"""A log: opened by what its first bytes say, a column for every role, and its rows in blocks.

The story: a reader makes a ``Table`` of the file; the clock and the columns of the
roles are chosen; blocks come as arrays by role, in seconds and in the units asked for.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.files import note_input
from dbo_cli.logs.clock import find_clock
from dbo_cli.logs.columns import ROLES, choose, named, scaled_column
from dbo_cli.logs.fence import closed_on_error, refuse_part
from dbo_cli.logs.formats import reader_of
from dbo_cli.logs.join import SENSORS, joined, resampled
from dbo_cli.logs.stream import TextStream
from dbo_cli.logs.table import (
    ROWS_A_BLOCK,
    Block,
    Column,
    Reading,
    Table,
    bad_cells,
    parse_rows,
)
from dbo_cli.logs.text import TextTable
from dbo_cli.units import kind_of, multiplied

_Numbers = NDArray[np.int64]  # of rows, from 1
_Arrays = list[NDArray[Any]]

_DRIVES = ("voltage", "input")  # roles that two recorders may both hold
_FIRST_BYTES = 1024  # MATLAB 7.3 has the mark of HDF5 at byte 512


class Log(AbstractContextManager["Log"]):
    """An open log.

    Attributes
    ----------
    name
        The file as it was typed.
    columns
        By role, the column; its unit is that of the values, after all conversions.
    titles
        Of a frame that was read from a file, the names of its columns there.
    clock
        Where the times come from.
    remarks
        What was assumed, skipped or noticed; complete after the last block.
    doubtful
        The remarks about rows that were left out or cut.
    left_out
        The numbers of the rows (from 1) that held no numbers; complete after the last block.
    """

    def __init__(
        self,
        source: Table,
        roles: Mapping[str, str | None],
        reading: Reading,
        units: Mapping[str, str | None],
        optional: Sequence[str],
    ) -> None:
        """Choose a clock and a column for every role, see ``open_log`` (InputError, UsageError)."""
        others = [role for role in roles if role != "time"]
        picks = {}
        for role, text in roles.items():
            if role != "time" and text is not None:
                picks[role] = named(source, text, role)
        self.clock = find_clock(source, reading, roles.get("time"), [*picks.values()])
        self.clock.holds_delay = source.has_found_offset
        clock_columns = [] if self.clock.column is None else [self.clock.column]
        columns = choose(source, others, picks, clock_columns, units, optional)
        for role, column in columns.items():
            scale = reading.scale
            columns[role] = scaled_column(source.name, role, column, scale, units)
        self.name, self.titles = source.name, source.titles
        self.columns = columns
        self.remarks = source.remarks
        self.doubtful: list[str] = []
        self._source = source
        self._reading = reading
        self._first, self._last = parse_rows(reading.rows)
        self.left_out: list[int] = []
        self._first_dropped = ""
        self._lost: tuple[int, str] | None = None
        self._count = 0
        self._rows: Block | None = None

    def join(
        self, second: Log, roles: Collection[str], clock_offset: float | str | None
    ) -> None:
        """Take roles of a second log; the rows are those of the log with the sensor, else the first's.

        Raises
        ------
        InputError
            They cannot be joined; see ``joined``.
        """
        base, guest = self, second
        if any(role in second.columns for role in SENSORS):
            base, guest = second, self
        taken = [r for r in guest.columns if (r in roles) == (guest is second)]
        rows, others = base.read(), guest.read()
        noted = len(base.clock.remarks)
        self._rows = joined(rows, base.clock, others, guest.clock, taken, clock_offset)
        self.clock, self.left_out = base.clock, base.left_out
        kept = {r: column for r, column in base.columns.items() if r not in taken}
        self.columns = kept | {role: guest.columns[role] for role in taken}
        self.remarks = [*base.remarks, *guest.remarks, *self.clock.remarks[noted:]]
        self.doubtful = [*base.doubtful, *guest.doubtful]

    def resample(self, rate: float) -> None:
        """Interpolate the log to an even rate (Hz), in memory (InputError, UsageError)."""
        self._rows, self.clock = resampled(self.read(), self.clock, rate)
        self.remarks += self.clock.remarks

    @property
    def row_count(self) -> int:
        """How many rows were read so far."""
        return self._count

    def warn_of_assumed(self) -> None:
        """Warn of columns whose unit is assumed, where no line says what was read."""
        for column in self.columns.values():
            if column.title.endswith(" assumed)"):
                warn(
                    f"{self.name}: {column.title}: state its unit in its name, or by `scale`"
                )

    def warn_of_doubts(self) -> None:
        """Warn of rows that were left out, cut or guessed."""
        for doubt in self.doubtful:
            warn(f"{self.name}: {doubt}")

    def blocks(self) -> Iterator[Block]:
        """Return the log once, in blocks of at most ``ROWS_A_BLOCK`` rows.

        Raises
        ------
        InputError
            A row holds no number, time goes back, or there is no row.
        """
        blocks = self._blocks()
        for block in blocks:
            if self._count == 1 and block.time is not None:
                following = next(blocks, None)  # tells the first row's step
                if following is not None:
                    dt = following.dt
                    dt = dt[:1] if isinstance(dt, np.ndarray) else dt
                    block = Block.joined([replace(block, dt=dt), following])
            for start in range(0, len(block), ROWS_A_BLOCK):
                yield block.part(start, start + ROWS_A_BLOCK)

    def read(self) -> Block:
        """Return the whole log.

        Raises
        ------
        InputError
            As for ``blocks``.
        """
        return Block.joined(list(self._blocks()))

    def _blocks(self) -> Iterator[Block]:
        """Read the file once, in its own blocks."""
        if self._rows is not None:
            self._count = len(self._rows)
            yield self._rows
            return
        columns = list(self.columns.values())
        if self.clock.is_read and self.clock.column is not None:
            columns.append(self.clock.column)
        time_place, guard = len(columns) - 1, self._source.guard
        if guard and guard.number not in [column.number for column in columns]:
            columns.append(guard)
        noted, row = len(self.remarks), 1
        for arrays in self._source.blocks(columns):
            numbers = np.arange(row, row + len(arrays[0]))
            inside = slice(max(self._first - row, 0), max(self._last + 1 - row, 0))
            row += len(numbers)
            inner = [array[inside] for array in arrays]
            numbers, arrays = self._good(numbers[inside], inner, columns)
            if len(numbers):
                self._require_time(int(numbers[-1]))
                self._count += len(numbers)
                time, dt = self.clock.read(numbers, arrays[time_place])
                values = {}
                for index, (role, column) in enumerate(self.columns.items()):
                    values[role] = multiplied(arrays[index], column.factor)
                yield Block(time, values, dt)
            if row > self._last:
                break
        self.doubtful += self.remarks[noted:]
        self._finish(row - 1)

    def _require_time(self, row: int) -> None:
        """Refuse a row behind one that may be no sample, where rows are counted (InputError)."""
        if self._lost is None or self.clock.kind != "rate" or row <= self._lost[0]:
            return
        lost, where = self._lost
        raise InputError(
            f"{where}: the time behind it is not known: cut with `rows` {self._first}:{lost - 1}"
        )

    def _finish(self, rows: int) -> None:
        """Remark on what was left out of so many rows (InputError where nothing is left)."""
        count = len(self.left_out)
        if count:
            s = "" if count == 1 else "s"
            text = f"{count:,} row{s} left out, the first: {self._first_dropped}"
            self.remarks.append(text)
            self.doubtful.append(text)
        if not self._count:
            raise InputError(
                f"{self.name}: `rows` {self._reading.rows or ':'}: none of its {rows:,} rows is inside and "
                "holds only numbers"
            )
        self.clock.close()
        self.remarks += self.clock.remarks

    def _good(
        self, numbers: _Numbers, arrays: _Arrays, columns: Sequence[Column]
    ) -> tuple[_Numbers, _Arrays]:
        """Return the rows that hold numbers.

        Raises
        ------
        InputError
            A row does not, and such rows are not to be left out.
        """
        bad = np.array([bad_cells(array) for array in arrays])
        is_bad = bad.any(axis=0)
        if not is_bad.any():
            return numbers, arrays
        at = int(np.argmax(is_bad))
        index = int(np.argmax(bad[:, at]))
        where = self._source.where(int(numbers[at]), columns[index], arrays[index][at])
        count = int(is_bad.sum())
        if not self._reading.skip_bad:
            more = f", and {count - 1:,} more such rows near it" if count > 1 else ""
            raise InputError(f"{where}{more} ({self._source.cure})")
        self._first_dropped = self._first_dropped or where
        self.left_out += numbers[is_bad].tolist()
        good = numbers[~is_bad]
        lost = list(self._source.torn)
        is_guarded = len(columns) > len(self.columns) + self.clock.is_read
        if is_guarded and columns[-1].kind != "stamp":
            lost += numbers[bad[-1]].tolist()  # the guard alone shows these
        for row in lost:
            is_behind = self._count or (len(good) and row > good[0])
            if is_behind and self._lost is None:
                self._lost = row, self._source.where(row, columns[-1], "")
        return good, [array[~is_bad] for array in arrays]

    def line(self) -> str:
        """Return one line on what was read; complete after the last block."""
        names = [column.title for column in self.columns.values()]
        s = "" if self._count == 1 else "s"
        line = f"{self.name}: {self._count:,} row{s}, {self.clock.describe()}"
        return f"{line}; {', '.join(names)}"

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


# --- opening ---


def open_log(
    path: str | os.PathLike[str] | Table,
    roles: Mapping[str, str | None],
    reading: Reading | None = None,
    units: Mapping[str, str | None] | None = None,
    optional: Sequence[str] = ("time",),
) -> Log:
    """Open a log and give every role its column.

    Parameters
    ----------
    path
        A file, ``FILE::PART``, ``-`` for standard input, or a table in memory.
    roles
        ``time``, ``voltage``, ``displacement``, ``input``, ``trajectory``, ``desired`` or
        ``measured``, each with what the user typed (a header name, a path, a number from
        1, or ``FILE::COLUMN``), or None.
    reading
        How the file is to be read.
    units
        By role, the unit that the values are wanted in; None of a model that states none.
    optional
        Roles that may be absent.

    Raises
    ------
    InputError
        The file cannot be read, or it is not clear which columns are meant.
    UsageError
        The options contradict each other or are malformed.
    """
    reading, units = reading or Reading(), units or {}
    elsewhere = {role: text for role, text in roles.items() if text and "::" in text}
    second = _second_file(elsewhere, reading)
    here = {role: text for role, text in roles.items() if role not in elsewhere}
    drives: list[str] = []  # that both files may hold
    if second and reading.clock_offset == "auto":
        drives = [role for role in _DRIVES if role in roles]
    source = path if isinstance(path, Table) else open_table(os.fspath(path), reading)
    with closed_on_error(source.close):
        here = {**dict.fromkeys(drives), **here}
        log = Log(source, here, reading, units, (*optional, *elsewhere))
        if second:
            names = {role: text.rpartition("::")[2] for role, text in elsewhere.items()}
            there = {**dict.fromkeys(drives), **names}
            whole = replace(reading, rows=None)
            with open_table(second, whole) as table:
                guest = Log(table, there, whole, units, drives)
                log.join(guest, elsewhere, reading.clock_offset)
        if reading.resample is not None:
            log.resample(reading.resample)
        _refuse_unused(log, reading.scale)
        _refuse_exchanged(log)
    return log


def _second_file(elsewhere: Mapping[str, str], reading: Reading) -> str:
    """Return the one file of columns ``FILE::COLUMN``, by role; empty where there are none (UsageError)."""
    files = {text.rpartition("::")[0] for text in elsewhere.values()}
    has_offset = reading.clock_offset is not None
    if "time" in elsewhere or len(files) > 1 or (has_offset and not files):
        listing = f" ({', '.join(sorted(files))})" * bool(files)
        raise UsageError(
            f"a log{listing} takes columns FILE::COLUMN of one second file, `time` never; these alone need "
            "`clock_offset`"
        )
    return files.pop() if files else ""


def _refuse_unused(log: Log, scale: Mapping[str, object]) -> None:
    """Refuse a scale of a role that the log does not have (UsageError)."""
    for role in scale:
        if role not in log.columns:
            listing = ", ".join(log.columns)
            raise UsageError(f"`scale` {role}=...: give one of {listing}")


def _refuse_exchanged(log: Log) -> None:
    """Refuse (InputError) a drive in a unit of a displacement beside a displacement in one of a drive."""
    drive = log.columns.get("voltage")
    sensor = next((role for role in SENSORS if role in log.columns), "")
    if drive is None or not sensor:
        return
    measured = log.columns[sensor]
    is_moved = kind_of(drive.unit) in ROLES[sensor].proving
    if not is_moved or kind_of(measured.unit) not in ROLES["voltage"].proving:
        return
    raise InputError(
        f"{log.name}: voltage, {drive.label}, is in {drive.unit}, {sensor}, {measured.label}, in "
        f"{measured.unit}: exchanged? Type `voltage` and `{sensor}`, or `scale` {sensor}="
        f"FACTOR{drive.unit}/{measured.unit}"
    )


def open_table(name: str, reading: Reading) -> Table:
    """Open a file with the reader that its first bytes ask for (InputError)."""
    path, _, inner = name.partition("::")
    note_input(path, "log")
    reader = None
    if os.path.isfile(path) and os.access(path, os.R_OK):
        with open(path, "rb") as file:
            reader = reader_of(path, file.read(_FIRST_BYTES))
    if reader is not None:
        return reader(path, inner, reading)
    refuse_part(path, inner)
    return TextTable(TextStream(path, reading.encoding), reading)
