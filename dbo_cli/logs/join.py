"""Rows on other times: beside those of a second recorder, or at an even rate; by linear interpolation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dbo_cli.alignment import (
    ACTUATOR_LAG,
    USUAL_LAG,
    Alignment,
    align_displacements,
    align_drives,
    are_apart,
)
from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.table import Block

SENSORS = ("displacement", "measured")  # the rows are those of their file
_DRIVES = ("voltage", "desired", "input")
BY_DRIVE, WITH_DELAY = "by the drive", "delay included"
_EXPLAINED = 0.09  # of the displacement's variance may be left unexplained
_KNOWN_TO = 0.5  # samples of the slower clock, two standard deviations, or
_TOLERABLE = 0.005  # of the drive (RMS), by which it changes in that time
_CLEARLY_APART = 5.0  # standard deviations from which on two clocks count as apart
_GAP_STEPS = 2.5  # usual steps; in a longer one at least a row is missing
_MOST_ROWS = 100_000_000  # of a log at an even rate: some gigabytes


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
    rows: Block,
    clock: Clock,
    guest: Block,
    guest_clock: Clock,
    taken: Sequence[str],
    clock_offset: float | str | None,
) -> tuple[Block, ClockOffset | None]:
    """Put the signals of a second log beside the rows of a first, by time.

    They are interpolated linearly, where both logs have rows; ``clock`` becomes that of
    the rows which are left.

    Parameters
    ----------
    rows, clock
        The log whose rows stay: that of the displacement, or of what was measured.
    guest, guest_clock
        The other one; a drive in both may lay them over each other.
    taken
        The roles that are taken from it.
    clock_offset
        Seconds, or ``auto``, added to the clock of the drive's file.

    Raises
    ------
    InputError
        A log has no clock, they have no time in common, or the offset cannot be found.
    """
    names = f"{clock.name} and {guest_clock.name}"
    time = _time_on(clock, guest_clock, guest, clock_offset)
    offset = None
    if clock_offset is None:
        _warn_if_apart(names, rows, time, guest)
    elif clock_offset == "auto":
        alignment, kind = _found(names, rows, time, guest)
        offset = ClockOffset(guest_clock.name, alignment.ahead, kind)
        time = alignment.recorded_time(time)
        clock.remarks.append(
            f"{clock.name}: its clock is {alignment.ahead:.6g} ± {2.0 * alignment.lag.deviation:.1g} s "
            f"ahead of that of {guest_clock.name} and {1e6 * alignment.lag.rate:.2g} ppm fast, {kind}"
        )
    else:
        offset = ClockOffset(guest_clock.name, float(clock_offset))
        time = time + offset.seconds
    for role in taken:
        rows.values.pop(role, None)
    guest.values = {role: guest.values[role] for role in taken}
    matched = _side_by_side(rows, time, guest, names)
    assert matched.time is not None
    clock.first, clock.last = float(matched.time[0]), float(matched.time[-1])
    clock.rows = len(matched)
    return matched, offset


def _time_on(
    clock: Clock, guest_clock: Clock, guest: Block, clock_offset: float | str | None
) -> Floats:
    """Return a second log's times on the clock of the first (InputError)."""
    for member in (clock, guest_clock):
        if member.kind == "none":
            raise InputError(
                f"{member.name} has no clock to join by: add a time column, or `sample_rate` HZ if both "
                "have one rate"
            )
    assert guest.time is not None
    stamp, guest_stamp = clock.first_stamp, guest_clock.first_stamp
    if stamp is not None and guest_stamp is not None:
        if (clock.origin is None) == (guest_clock.origin is None):
            shifted: Floats = guest.time + (guest_stamp - stamp) / 1e9
            return shifted
    if stamp is guest_stamp or clock_offset is not None:
        return guest.time
    raise InputError(
        f"{clock.name} and {guest_clock.name}: only one clock has dates: give `clock_offset` SECONDS, "
        "or auto"
    )


def _side_by_side(rows: Block, time: Floats, table: Block, pair_name: str) -> Block:
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
        in_gap = steps[following - 1] > _GAP_STEPS * np.sort(steps)[len(steps) // 2]
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
    return Block(times, values, dt)


def _sensor_and_drive(rows: Block, table: Block) -> tuple[Floats, Floats] | None:
    """Return the displacement of one log and the drive of another; None where they hold none."""
    drives = [table.values[role] for role in _DRIVES if role in table.values]
    sensors = [rows.values[role] for role in SENSORS if role in rows.values]
    if not drives or not sensors or rows.time is None:
        return None
    return sensors[0], drives[0]


def _beside_drive(rows: Block, time: Floats, table: Block) -> Alignment | None:
    """Return how the displacement of one log lies over the drive of another; None where it does not tell."""
    signals = _sensor_and_drive(rows, table)
    if signals is None or rows.time is None:
        return None
    sensor, drive = signals
    return align_displacements(rows.time, sensor, time, drive, rate=True, inverted=True)


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
    for role in _DRIVES:
        if role in rows.values and role in table.values:
            by_drive = align_drives(rows.time, rows[role], time, table[role])
            if by_drive is not None:
                return by_drive, BY_DRIVE
    found = _beside_drive(rows, time, table)
    problem = ""
    if found is None:
        problem = "a drive and a displacement are needed that both move, over a time that both hold"
    elif found.lag.residual > _EXPLAINED:
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
    drive = next(table[role] for role in _DRIVES if role in table.values)
    path = float(np.abs(np.diff(drive)).sum())
    seconds = _TOLERABLE * float(np.std(drive)) / path * float(np.ptp(time))
    return max(_KNOWN_TO * found.step, seconds)


def _warn_if_apart(pair_name: str, rows: Block, time: Floats, table: Block) -> None:
    """Warn where the drive explains the displacement much better when its clock is moved."""
    found, signals = _beside_drive(rows, time, table), _sensor_and_drive(rows, table)
    if found is None or signals is None or found.lag.residual > _EXPLAINED:
        return
    clearly = found.step + _CLEARLY_APART * found.lag.deviation
    if -clearly <= found.ahead <= clearly + USUAL_LAG:
        return
    sensor, drive = signals
    assert rows.time is not None
    if not are_apart(found, rows.time, sensor, time, drive):
        return
    remedy = "try `clock_offset` auto"
    if 0.0 < found.ahead <= ACTUATOR_LAG:
        remedy += ", or 0 if the actuator is that late"
    warn(
        f"{pair_name}: drive and sensor do not line up in time (by {found.ahead:+.3g} s): {remedy}"
    )


# --- an even rate ---


def resampled(rows: Block, clock: Clock, rate: float) -> tuple[Block, Clock]:
    """Return rows at an even rate (Hz), and their clock.

    Raises
    ------
    InputError
        They have no clock, or last less than a step.
    UsageError
        The rate is not above 0.
    """
    if not 0.0 < rate < np.inf:
        raise UsageError(f"`resample` {rate:g}: give a rate above 0 Hz")
    if rows.time is None:
        raise InputError(
            f"{clock.name}: `resample` needs a clock (`time` COLUMN or `sample_rate` HZ)"
        )
    first = float(rows.time[0])
    span = float(rows.time[-1]) - first
    count = int(np.floor(span * rate * (1.0 + 1e-12))) + 1
    if count < 2 or count > _MOST_ROWS:
        raise InputError(
            f"{clock.name}: `resample` {rate:g}: the log lasts {span:.4g} s"
        )
    time = first + np.arange(count) / rate
    values = {}
    for role, array in rows.values.items():
        values[role] = np.interp(time, rows.time, array)
    even = Clock(clock.name, "rate", rate=rate, start=first, origin=clock.origin)
    even.step = 1.0 / rate
    even.rows, even.first, even.last = count, first, float(time[-1])
    even.remarks.append(
        f"{len(rows):,} rows are interpolated to {count:,} at {rate:g} Hz"
    )
    return Block(time, values, dt=even.step), even
