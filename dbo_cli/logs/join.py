"""Two recorders, one log: joined by time."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, warn
from dbo_cli.logs.clock_offset import Pair, apart, find_offset
from dbo_cli.logs.log import Log
from dbo_cli.logs.table import Block

SENSORS = ("displacement", "measured")  # the rows are those of their file
DRIVES = ("voltage", "desired", "input")
GAP_STEPS = 2.5  # usual steps; in a longer one at least a row is missing


@dataclass(frozen=True)
class ClockOffset:
    """What is added to the clock of a file (s), and two standard deviations of it (s).

    ``auto``: it was found from the signals, so a delay of the actuator is part of it.
    """

    name: str
    seconds: float
    uncertainty: float = 0.0
    auto: bool = False

    def describe(self) -> str:
        """Return what was done, as the line on what was read has it."""
        within = f" ± {self.uncertainty:.1g}" if self.auto else ""
        name = os.path.basename(self.name)
        return f"{name} moved by {self.seconds:.4g}{within} s"


def joined(log: Log, second: Log, clock_offset: float | str | None) -> Log:
    """Join two logs of one move by time into one, which has the name of the first.

    The rows are those of the log that holds the displacement (or what was measured),
    else of the first one. The other is interpolated linearly onto them, where both have
    rows.

    Parameters
    ----------
    log, second
        The logs, each with its roles.
    clock_offset
        Seconds, or ``auto``, added to the clock of the drive's file.

    Raises
    ------
    InputError
        A log has no clock, they have no time in common, or the offset cannot be found.
    """
    base, guest = log, second
    if any(role in second.columns for role in SENSORS):
        base, guest = second, log
    pair_name = f"{base.name} and {guest.name}"
    rows, table = base.read(), guest.read()
    time = _time_beside(base, guest, table, clock_offset)
    offset = None
    if clock_offset is None:
        _warn_if_apart(pair_name, rows, time, table)
    else:
        seconds, deviation = _offset(pair_name, rows, time, table, clock_offset)
        offset = ClockOffset(guest.name, seconds, deviation, clock_offset == "auto")
        time = time + seconds
    matched = _beside(rows, time, table, pair_name)
    remarks = [*base.remarks, *guest.remarks]
    if len(matched) < len(rows):
        remarks.append(
            f"{len(rows) - len(matched):,} rows of {base.name} left out: {guest.name} has none there"
        )
    assert matched.time is not None
    first, last = float(matched.time[0]), float(matched.time[-1])
    clock = replace(base.clock, first=first, last=last, rows=len(matched))
    columns = {**base.columns, **guest.columns}
    result = Log.in_memory(log.name, columns, matched, clock, remarks)
    result.doubtful = [*base.doubtful, *guest.doubtful]
    result.clock_offset = offset
    return result


def _time_beside(
    base: Log, log: Log, table: Block, clock_offset: float | str | None
) -> Floats:
    """Return a log's times on the clock of the base (InputError)."""
    for member in (base, log):
        if member.clock.kind == "none":
            raise InputError(
                f"{member.name} has no clock to join by: add a time column, or `sample_rate` HZ if both "
                "have one rate"
            )
    assert table.time is not None
    base_stamp, log_stamp = base.clock.first_stamp, log.clock.first_stamp
    if base_stamp is not None and log_stamp is not None:
        if (base.clock.origin is None) == (log.clock.origin is None):
            shifted: Floats = table.time + (log_stamp - base_stamp) / 1e9
            return shifted
    if base_stamp is log_stamp or clock_offset is not None:
        return table.time
    raise InputError(
        f"{base.name} and {log.name}: only one clock has dates: give `clock_offset` SECONDS, or "
        "auto"
    )


def _beside(rows: Block, time: Floats, table: Block, pair_name: str) -> Block:
    """Put another log's signals beside rows, where it has some; none in its gaps.

    Raises
    ------
    InputError
        They have no time in common.
    """
    assert rows.time is not None
    at = rows.time
    covered = (at >= time[0]) & (at <= time[-1])
    if len(time) > 1:
        steps = np.diff(time)
        following = np.clip(np.searchsorted(time, at, side="right"), 1, len(time) - 1)
        in_gap = steps[following - 1] > GAP_STEPS * np.sort(steps)[len(steps) // 2]
        is_stamp = (at == time[following]) | (at == time[following - 1])
        covered &= ~in_gap | is_stamp
    if not covered.any():
        raise InputError(
            f"{pair_name}: no time in common, {at[0]:.9g} to {at[-1]:.9g} s and {time[0]:.9g} to "
            f"{time[-1]:.9g} s: try `clock_offset` {at[0] - time[0]:.9g}, or auto"
        )
    times = at[covered]
    values = {role: array[covered] for role, array in rows.values.items()}
    for role, array in table.values.items():
        values[role] = np.interp(times, time, array)
    dt = rows.dt
    if (
        isinstance(dt, np.ndarray)
        or np.diff(np.flatnonzero(covered)).max(initial=1) > 1
    ):
        steps = np.diff(times)
        dt = np.concatenate([steps[:1], steps])
    return Block(times, values, dt=dt)


def _pair(rows: Block, time: Floats, table: Block) -> Pair | None:
    """Return drive and displacement of two logs, if one has each (InputError)."""
    drives = [table.values[role] for role in DRIVES if role in table.values]
    sensors = [rows.values[role] for role in SENSORS if role in rows.values]
    if not drives or not sensors or rows.time is None:
        return None
    return Pair.of(time, drives[0], rows.time, sensors[0])


def _offset(
    pair_name: str, rows: Block, time: Floats, table: Block, clock_offset: float | str
) -> tuple[float, float]:
    """Return the offset (s) that is typed, or that the signals show, and two standard deviations of it.

    Raises
    ------
    InputError
        The signals do not show it.
    """
    if clock_offset != "auto":
        return float(clock_offset), 0.0
    try:
        pair = _pair(rows, time, table)
        if pair is None:
            raise InputError("a drive and a displacement are needed")
        fit = find_offset(pair)
    except InputError as problem:
        raise InputError(
            f"{pair_name}: `clock_offset` auto: {problem} (give SECONDS)"
        ) from None
    return fit.offset, 2.0 * fit.deviation


def _warn_if_apart(pair_name: str, rows: Block, time: Floats, table: Block) -> None:
    """Warn where the drive explains the displacement much better when its clock is moved."""
    try:
        pair = _pair(rows, time, table)
    except InputError:
        return
    offset = 0.0 if pair is None else apart(pair)
    if offset:
        warn(
            f"{pair_name}: drive and sensor do not line up in time (by {offset:+.3g} s): try "
            "`clock_offset` auto"
        )
