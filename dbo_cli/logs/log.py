"""A log: opened by what its first bytes say, a column for every role, and its rows in blocks.

The story: a reader makes a ``Source`` of the file; the clock and the columns of the
roles are chosen; blocks come as arrays by role, in seconds and in the units asked for.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.columns import choose, named
from dbo_cli.logs.rows import Rows, parse_rows, scales_of
from dbo_cli.logs.source import (
    BLOCK_ROWS,
    Block,
    Column,
    FloatArray,
    Reading,
    Source,
)
from dbo_cli.logs.time_column import find_clock
from dbo_cli.units import split_header

if TYPE_CHECKING:
    from dbo_cli.logs.join import ClockOffset

_FIRST_BYTES = 1024  # MATLAB 7.3 has the mark of HDF5 at byte 512


class Log:
    """An open log.

    Attributes
    ----------
    name
        The file as it was typed.
    columns
        By role, the column; its unit is that of the values, after all conversions.
    clock
        Where the times come from.
    remarks
        What was assumed, skipped or noticed; complete after the last block.
    doubtful
        The remarks about rows that were left out or cut.
    clock_offset
        What was added to the clock of a second file, if any.
    """

    def __init__(
        self,
        name: str,
        columns: Mapping[str, Column],
        clock: Clock,
        stream: Callable[[], Iterator[Block]],
        remarks: list[str],
        close: Callable[[], object] = lambda: None,
    ) -> None:
        self.name = name
        self.columns = dict(columns)
        self.clock = clock
        self.remarks = remarks
        self.doubtful: list[str] = []
        self.clock_offset: ClockOffset | None = None
        self._stream = stream
        self._close = close
        self._rows = 0

    @classmethod
    def of_table(
        cls,
        name: str,
        columns: Mapping[str, Column],
        table: Block,
        clock: Clock,
        remarks: list[str],
    ) -> Log:
        """Make a log of arrays in memory, as a joined or resampled one is."""
        return cls(name, columns, clock, lambda: iter([table]), remarks)

    def provided(self, role: str) -> bool:
        """Return whether the log has a column for a role, or a clock for ``time``."""
        if role == "time":
            return self.clock.kind != "none"
        return role in self.columns

    @property
    def has_found_offset(self) -> bool:
        """Whether a clock offset was found from the signals, so that the actuator's delay is in it."""
        return self.clock_offset is not None and self.clock_offset.auto

    def blocks(self, rows: int = BLOCK_ROWS) -> Iterator[Block]:
        """Return the log once, in blocks of at most so many rows.

        Raises
        ------
        InputError
            A row holds no number, time goes back, or there is no row.
        """
        for block in self._stream():
            self._rows += len(block)
            for start in range(0, len(block), rows):
                yield _part(block, start, start + rows)

    def read(self) -> Block:
        """Return the whole log.

        Raises
        ------
        InputError
            As for ``blocks``.
        """
        blocks = list(self.blocks(rows=1 << 40))
        values = {}
        for role in self.columns:
            values[role] = np.concatenate([block.values[role] for block in blocks])
        times = [block.time for block in blocks if block.time is not None]
        time = np.concatenate(times) if times else None
        return Block(time, values, dt=_steps_of(blocks))

    def line(self) -> str:
        """Return one line on what was read; complete after the last block."""
        names = []
        for role, column in self.columns.items():
            names.append(column.name or f"column {column.number} ({role})")
        s = "" if self._rows == 1 else "s"
        line = f"{self.name}: {self._rows:,} row{s}, {self.clock.describe()}"
        if self.clock_offset is not None:
            line += f", {self.clock_offset.describe()}"
        return f"{line}; {', '.join(names)}"

    def close(self) -> None:
        """Close the file."""
        self._close()

    def __enter__(self) -> Log:
        """Use the log as a context manager."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


def _part(block: Block, start: int, stop: int) -> Block:
    """Return rows of a block."""
    if start == 0 and stop >= len(block):
        return block
    values = {role: array[start:stop] for role, array in block.values.items()}
    time = None if block.time is None else block.time[start:stop]
    dt = block.dt[start:stop] if isinstance(block.dt, np.ndarray) else block.dt
    return Block(time, values, block.first_row + start, dt)


def _steps_of(blocks: Sequence[Block]) -> float | FloatArray | None:
    """Return the steps of all blocks: one number where all have the same."""
    first = blocks[0].dt
    if len(blocks) == 1 or first is None:
        return first
    if all(isinstance(block.dt, float) and block.dt == first for block in blocks):
        return first
    steps = [np.broadcast_to(np.asarray(b.dt, np.float64), len(b)) for b in blocks]
    return np.concatenate(steps)


# --- opening ---


def open_log(
    path: str | os.PathLike[str],
    roles: Mapping[str, str | None],
    reading: Reading | None = None,
    units: Mapping[str, str] | None = None,
    optional: Sequence[str] = ("time",),
) -> Log:
    """Open a log and give every role its column.

    Parameters
    ----------
    path
        A file, ``FILE::PART``, or ``-`` for standard input.
    roles
        ``time``, ``voltage``, ``displacement``, ``input``, ``trajectory``, ``desired`` or
        ``measured``, each with what the user typed (a header name, a path, a number from
        1, or ``FILE::COLUMN``), or None.
    reading
        How the file is to be read.
    units
        By role, the unit that the values are wanted in.
    optional
        Roles that may be absent.

    Raises
    ------
    InputError
        The file cannot be read, or it is not clear which columns are meant.
    UsageError
        The options contradict each other or are malformed.
    """
    reading = reading or Reading()
    units = units or {}
    name = os.fspath(path)
    elsewhere = {role: text for role, text in roles.items() if text and "::" in text}
    if "time" in elsewhere:
        raise UsageError(
            f"`time` {elsewhere['time']}: the time must be in the log itself"
        )
    if reading.resample is not None and not 0.0 < reading.resample < np.inf:
        raise UsageError(f"`resample` {reading.resample:g}: give a rate above 0 Hz")
    for role in reading.scale:
        if role not in roles:
            raise UsageError(f"`scale` {role}=...: give one of {', '.join(roles)}")
    here = {role: text for role, text in roles.items() if role not in elsewhere}
    log = _open_file(name, here, reading, units, optional)
    if elsewhere:
        log = _with_columns_of(log, elsewhere, reading, units)
    if reading.resample is not None:
        from dbo_cli.logs.resample import resampled

        log = resampled(log, reading.resample)
    return log


def _with_columns_of(
    log: Log, elsewhere: Mapping[str, str], reading: Reading, units: Mapping[str, str]
) -> Log:
    """Join columns of other files to a log."""
    from dbo_cli.logs.join import joined

    by_file: dict[str, dict[str, str | None]] = {}
    for role, text in elsewhere.items():
        file, _, column = text.rpartition("::")
        by_file.setdefault(file, {})[role] = column
    logs = [log]
    try:
        for file, roles in by_file.items():
            logs.append(_open_file(file, roles, replace(reading, rows=None), units, ()))
        return joined(logs, reading.clock_offset)
    finally:
        for part in logs:
            part.close()


def columns_of(
    path: str | os.PathLike[str], reading: Reading | None = None
) -> list[Column]:
    """Return all columns of a log.

    Raises
    ------
    InputError
        It cannot be read.
    """
    source = open_source(os.fspath(path), reading or Reading())
    source.close()
    return source.columns


def columns_of_names(
    names: Sequence[str],
    roles: Mapping[str, str | None],
    units: Mapping[str, str] | None = None,
) -> dict[str, Column]:
    """Return the columns of a frame by its header names; the time is left out where there is none.

    Raises
    ------
    InputError
        It is not clear which columns are meant.
    """
    source = Source("the frame", ())
    for number, name in enumerate(names, start=1):
        source.columns.append(Column(number, name, split_header(name)[1]))
    clock, picks = _chosen(source, roles, Reading(), units or {}, ("time",))
    if clock.column is not None:
        picks["time"] = clock.column
    return picks


def open_source(name: str, reading: Reading) -> Source:
    """Open a file with the reader that its first bytes ask for (InputError)."""
    from dbo_cli.logs.text import open_text

    path, _, part = name.partition("::")
    if os.path.isfile(path):
        from dbo_cli.logs.formats import reader_of

        reader = reader_of(path, _start_of(path))
        if reader is not None:
            return reader(path, part, reading)
    return open_text(path, part, reading)


def _start_of(path: str) -> bytes:
    """Return the first bytes of a file; none where it cannot be read, which the reader says."""
    try:
        with open(path, "rb") as file:
            return file.read(_FIRST_BYTES)
    except OSError:
        return b""


def _open_file(
    name: str,
    roles: Mapping[str, str | None],
    reading: Reading,
    units: Mapping[str, str],
    optional: Sequence[str],
) -> Log:
    """Open one file as a log."""
    rows = parse_rows(reading.rows)
    factors = {role: text for role, text in reading.scale.items() if role in roles}
    source = open_source(name, reading)
    try:
        clock, picks = _chosen(source, roles, reading, units, optional)
        scales = scales_of(source.name, picks, factors, units, source.remarks)
    except BaseException:
        source.close()
        raise
    stream = Rows(source, clock, picks, scales, rows, reading.skip_bad)
    columns = {role: replace(picks[role], unit=scales[role].unit) for role in picks}
    log = Log(source.name, columns, clock, stream.blocks, source.remarks, source.close)
    log.doubtful = stream.doubtful
    return log


def _chosen(
    source: Source,
    roles: Mapping[str, str | None],
    reading: Reading,
    units: Mapping[str, str],
    optional: Sequence[str],
) -> tuple[Clock, dict[str, Column]]:
    """Choose the clock and the columns of the roles."""
    selectors = {role: text for role, text in roles.items() if role != "time"}
    used = []
    for role, text in selectors.items():
        if text is not None:
            used.append(named(source, text, role))
    clock = find_clock(source, reading, roles.get("time"), used)
    taken = [] if clock.column is None else [clock.column]
    return clock, choose(source, selectors, taken, units, optional)
