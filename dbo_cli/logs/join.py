"""Rows on other times: beside those of a second recorder, or at an even rate; by linear interpolation."""

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.alignment import (
    ACTUATOR_LAG,
    Alignment,
    Trace,
    align_displacements,
    align_drives,
    are_apart,
)
from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, warn
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.table import Block
from dbo_cli.signals import even

SENSORS = ("displacement", "measured")  # the rows are those of their file
_DRIVES = ("voltage", "desired", "input")
_EXPLAINED = 0.09  # of the displacement's variance may be left unexplained
_KNOWN_TO = 0.5  # samples of the slower clock, two standard deviations, or
_TOLERABLE = 0.005  # of the drive (RMS), by which it changes in that time
_GAP_STEPS = 2.5  # usual steps; in a longer one at least a row is missing
_MOST_ROWS = 100_000_000  # of a log at an even rate: some gigabytes


def joined(
    rows: Block,
    clock: Clock,
    guest: Block,
    guest_clock: Clock,
    taken: Sequence[str],
    clock_offset: float | str | None,
) -> Block:
    """Put the signals of a second log beside the rows of a first, by time.

    They are interpolated linearly, where both logs have rows; ``clock`` becomes that of
    the rows which are left, and tells of the offset.

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
    at, time = _on_one_clock(rows, clock, guest, guest_clock, clock_offset)
    if clock_offset is None:
        _warn_if_apart(names, at, rows, time, guest)
    else:
        seconds, how = clock_offset, ""
        if isinstance(seconds, str):
            alignment, by_drive = _found(names, at, rows, time, guest)
            time, seconds = alignment.recorded_time(time), alignment.ahead
            how = ", by the drive" if by_drive else ", delay included"
            clock.holds_delay |= not by_drive
            clock.remarks.append(
                f"{clock.name}: its clock is {seconds:.6g} ± {2.0 * alignment.lag.deviation:.1g} s "
                f"ahead of that of {guest_clock.name} and {1e6 * alignment.lag.rate:.2g} ppm fast{how}"
            )
        else:
            time = time + seconds
        file = os.path.basename(guest_clock.name)
        clock.note = f", {file} moved by {seconds:.4g} s{how}{clock.note}"
    covered = _covered(at, time)
    if not covered.any():
        raise InputError(
            f"{names}: no time in common, {at[0]:.9g} to {at[-1]:.9g} s and {time[0]:.9g} to "
            f"{time[-1]:.9g} s: try `clock_offset` {at[0] - time[0]:.9g}, or auto"
        )
    left_out = len(at) - np.count_nonzero(covered)
    if left_out:
        clock.remarks.append(
            f"{left_out:,} rows of {clock.name} left out: {guest_clock.name} has none there"
        )
    at, dt = at[covered], rows.dt
    if isinstance(dt, np.ndarray) or even(at, dt) is None:  # where a row is missing
        steps = np.diff(at)
        dt = np.concatenate([steps[:1], steps])
    values = {r: array[covered] for r, array in rows.values.items() if r not in taken}
    for role in taken:
        values[role] = np.interp(at, time, guest[role])
    clock.first, clock.last, clock.rows = float(at[0]), float(at[-1]), len(at)
    return Block(at, values, dt)


def _on_one_clock(
    rows: Block,
    clock: Clock,
    guest: Block,
    guest_clock: Clock,
    clock_offset: float | str | None,
) -> tuple[Floats, Floats]:
    """Return the times of two logs, the second's on the clock of the first (InputError)."""
    start, guest_start = clock.first_stamp, guest_clock.first_stamp
    if rows.time is not None and guest.time is not None:
        if start is not None and guest_start is not None:
            return rows.time, guest.time + (guest_start - start) / 1e9
        if start == guest_start or clock_offset is not None:
            return rows.time, guest.time
    raise InputError(
        f"{clock.name} and {guest_clock.name} have no clock in common, with stamps in both or in none: "
        "add a time column, `sample_rate` HZ, or `clock_offset` SECONDS or auto"
    )


def _covered(at: Floats, time: Floats) -> NDArray[np.bool_]:
    """Return which times lie within those of another log, and in none of its gaps."""
    covered: NDArray[np.bool_] = (at >= time[0]) & (at <= time[-1])
    if len(time) > 1:
        steps = np.diff(time)
        following = np.clip(np.searchsorted(time, at, side="right"), 1, len(time) - 1)
        in_gap = steps[following - 1] > _GAP_STEPS * np.sort(steps)[len(steps) // 2]
        is_stamp = (at == time[following]) | (at == time[following - 1])
        covered &= ~in_gap | is_stamp
    return covered


def _beside_drive(
    at: Floats, rows: Block, time: Floats, guest: Block
) -> tuple[Alignment, Trace, Trace] | None:
    """Return how the displacement of one log lies over the drive of another, and both; None if unknown."""
    drives = [guest[role] for role in _DRIVES if role in guest.values]
    sensors = [rows[role] for role in SENSORS if role in rows.values]
    if not drives or not sensors:
        return None
    sensor, drive = Trace(at, sensors[0]), Trace(time, drives[0])
    found = align_displacements(sensor, drive, rate=True, inverted=True)
    return None if found is None else (found, sensor, drive)


def _found(
    names: str, at: Floats, rows: Block, time: Floats, guest: Block
) -> tuple[Alignment, bool]:
    """Return how two logs lie over each other, and whether a drive in both says so.

    Raises
    ------
    InputError
        The signals do not show it to half a row of the slower clock.
    """
    for role in _DRIVES:
        if role in rows.values and role in guest.values:
            drive = Trace(at, rows[role])
            by_drive = align_drives(drive, Trace(time, guest[role]))
            if by_drive is not None:
                return by_drive, True
    pair = _beside_drive(at, rows, time, guest)
    if pair is None:
        problem = "a drive and a displacement are needed that both move, over a time that both hold"
    else:
        found, _, (_, voltage) = pair
        lag, ahead = found.lag, found.ahead
        path = float(np.abs(np.diff(voltage)).sum())
        tolerable = _TOLERABLE * float(np.std(voltage)) / path * float(np.ptp(time))
        is_known = 2.0 * lag.deviation <= max(_KNOWN_TO * found.step, tolerable)
        if is_known and lag.residual <= _EXPLAINED and lag.rival is None:
            return found, False
        problem = f"{ahead:.6g} s is not sure: record a drive that does not repeat in both files"
    raise InputError(f"{names}: `clock_offset` auto: {problem} (give SECONDS)")


def _warn_if_apart(
    names: str, at: Floats, rows: Block, time: Floats, guest: Block
) -> None:
    """Warn where the drive explains the displacement much better when its clock is moved."""
    pair = _beside_drive(at, rows, time, guest)
    if pair is None or pair[0].lag.residual > _EXPLAINED:
        return
    found, sensor, drive = pair
    if not are_apart(found, sensor, drive):
        return
    remedy = "try `clock_offset` auto"
    if 0.0 < found.ahead <= ACTUATOR_LAG:
        remedy += ", or 0 if the actuator is that late"
    warn(
        f"{names}: drive and sensor do not line up in time (by {found.ahead:+.3g} s): {remedy}"
    )


# --- an even rate ---


def resampled(rows: Block, clock: Clock, rate: float) -> tuple[Block, Clock]:
    """Return rows at an even rate (Hz), and their clock.

    Raises
    ------
    InputError
        They have no clock, or last less than a step.
    """
    first, last = (0.0, 0.0) if rows.time is None else rows.time[[0, -1]].tolist()
    count = int(np.floor((last - first) * rate * (1.0 + 1e-12))) + 1
    if rows.time is None or not 2 <= count <= _MOST_ROWS:
        raise InputError(
            f"{clock.name}: `resample` {rate:g}: its clock lasts {last - first:.4g} s: give another rate, "
            "`time` COLUMN or `sample_rate` HZ"
        )
    time = first + np.arange(count) / rate
    values = {}
    for role, array in rows.values.items():
        values[role] = np.interp(time, rows.time, array)
    remark = f"{len(rows):,} rows are interpolated to {count:,} at {rate:g} Hz"
    even_clock = replace(clock, kind="rate", column=None, rate=rate, irregular=0)
    even_clock.step, even_clock.remarks, even_clock.rows = 1.0 / rate, [remark], count
    even_clock.start, even_clock.first, even_clock.last = first, first, float(time[-1])
    return Block(time, values, dt=even_clock.step), even_clock
