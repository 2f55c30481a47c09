"""Two recorders, one log: joined by time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.alignment import ACTUATOR_LAG, Alignment, align_displacements, align_drives
from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, warn
from dbo_cli.logs.log import Log
from dbo_cli.logs.table import Block, Column

SENSORS = ("displacement", "measured")  # the rows are those of their file
DRIVES = ("voltage", "desired", "input")
BY_DRIVE, WITH_DELAY = "by the drive", "delay included"
EXPLAINED = 0.09  # of the displacement's variance may be left unexplained
KNOWN_TO = 0.5  # samples of the slower clock, two standard deviations, or
TOLERABLE = 0.005  # of the drive (RMS), by which it changes in that time
CLEARLY_APART = 5.0  # standard deviations from which on two clocks count as apart
GAP_STEPS = 2.5  # usual steps; in a longer one at least a row is missing


@dataclass(frozen=True)
class ClockOffset:
    """What is added to the clock of a file (s), and how it was found.

    Attributes
    ----------
    name
        The file.
    seconds
        At its beginning.
    found
        By what: ``BY_DRIVE``, which both hold, or ``WITH_DELAY`` of the actuator in it; "":
        it was typed.
    """

    name: str
    seconds: float
    found: str = ""

    @property
    def holds_delay(self) -> bool:
        """Whether a delay of the actuator is part of it."""
        return self.found == WITH_DELAY

    def describe(self) -> str:
        """Return what was done, as the line on what was read has it."""
        text = f"{os.path.basename(self.name)} moved by {self.seconds:.4g} s"
        return f"{text}, {self.found}" if self.found else text


def joined(
    log: Log, second: Log, own: Sequence[str], clock_offset: float | str | None
) -> Log:
    """Join two logs of one move by time into one, which has the name of the first.

    The rows are those of the log that holds the displacement (or what was measured),
    else of the first one. The other is interpolated linearly onto them, where both have
    rows.

    Parameters
    ----------
    log, second
        The logs, each with its roles; a drive in both may lay them over each other.
    own
        The roles that are taken from ``second``; all others are those of ``log``.
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
    remarks = [*base.remarks, *guest.remarks]
    offset = None
    if clock_offset is None:
        _warn_if_apart(pair_name, rows, time, table)
    elif clock_offset == "auto":
        found, kind = _found(pair_name, rows, time, table)
        offset = ClockOffset(guest.name, found.ahead, kind)
        time = found.late_time(time)
        remarks.append(
            f"{base.name}: its clock is {found.ahead:.6g} ± {2.0 * found.lag.deviation:.1g} s ahead of "
            f"that of {guest.name} and {1e6 * found.lag.rate:.2g} ppm fast, {kind}"
        )
    else:
        offset = ClockOffset(guest.name, float(clock_offset))
        time = time + offset.seconds
    columns: dict[str, Column] = {}
    for member, block in ((base, rows), (guest, table)):
        for role, column in member.columns.items():
            if (role in own) == (member is second):
                columns[role] = column
            else:
                del block.values[role]
    matched = _beside(rows, time, table, pair_name)
    if len(matched) < len(rows):
        remarks.append(
            f"{len(rows) - len(matched):,} rows of {base.name} left out: {guest.name} has none there"
        )
    assert matched.time is not None
    first, last = float(matched.time[0]), float(matched.time[-1])
    clock = replace(base.clock, first=first, last=last, rows=len(matched))
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


def _beside_drive(rows: Block, time: Floats, table: Block) -> Alignment | None:
    """Return how the displacement of one log lies over the drive of another; None where it does not tell."""
    drives = [table.values[role] for role in DRIVES if role in table.values]
    sensors = [rows.values[role] for role in SENSORS if role in rows.values]
    if not drives or not sensors or rows.time is None:
        return None
    return align_displacements(
        rows.time, sensors[0], time, drives[0], rate=True, inverted=True
    )


def _found(
    pair_name: str, rows: Block, time: Floats, table: Block
) -> tuple[Alignment, str]:
    """Return how two logs lie over each other, and by what.

    Raises
    ------
    InputError
        The signals do not show it to half a row of the slower clock.
    """
    assert rows.time is not None
    for role in DRIVES:
        if role in rows.values and role in table.values:
            by_drive = align_drives(rows.time, rows[role], time, table[role])
            if by_drive is not None:
                return by_drive, BY_DRIVE
    found = _beside_drive(rows, time, table)
    problem = ""
    if found is None:
        problem = "a drive and a displacement are needed that both move, over a time that both hold"
    elif found.lag.residual > EXPLAINED:
        share = 100.0 * (1.0 - found.lag.residual)
        problem = f"the drive explains at most {share:.0f} % of the displacement"
    elif found.lag.rival is not None:
        other = found.ahead + found.lag.rival - found.lag.seconds
        problem = (
            f"{found.ahead:.6g} s and {other:.6g} s fit equally: the drive repeats"
        )
    elif 2.0 * found.lag.deviation > _tolerable(found, time, table):
        problem = (
            f"{found.ahead:.6g} s is uncertain by {2.0 * found.lag.deviation:.2g} s"
        )
    if problem or found is None:
        raise InputError(f"{pair_name}: `clock_offset` auto: {problem} (give SECONDS)")
    return found, WITH_DELAY


def _tolerable(found: Alignment, time: Floats, table: Block) -> float:
    """Return the seconds by which clocks may be apart."""
    drive = next(table[role] for role in DRIVES if role in table.values)
    path = float(np.abs(np.diff(drive)).sum())
    seconds = TOLERABLE * float(np.std(drive)) / path * float(np.ptp(time))
    return max(KNOWN_TO * found.step, seconds)


def _warn_if_apart(pair_name: str, rows: Block, time: Floats, table: Block) -> None:
    """Warn where the drive explains the displacement much better when its clock is moved."""
    found = _beside_drive(rows, time, table)
    if found is None or found.lag.residual > EXPLAINED:
        return
    clearly = found.step + CLEARLY_APART * found.lag.deviation
    if not -clearly <= found.ahead <= clearly + ACTUATOR_LAG:
        warn(
            f"{pair_name}: drive and sensor do not line up in time (by {found.ahead:+.3g} s): try "
            "`clock_offset` auto"
        )
