"""What to expect of a drive, what to warn of, and what would fit where limits forbid a move."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import warn
from dbo_cli.model import Steps

if TYPE_CHECKING:
    from dbo_cli.drive.drive import Drive


OFF_AT_FIRST = 1e-3  # of the range: so far off its first value may a drive begin unsaid
LONG_HOLD = 100.0  # times the longest time constant: what creeps has come to rest


def conclude(drive: Drive) -> None:
    """Give a drive of which all rows were seen the error to expect, and warn of what is unusual."""
    voltage, dt = _first_rows(drive)
    beyond = _beyond(drive)
    if not beyond:
        drive.expected_error = _expected(drive, voltage, dt, drive.past_known)
        if not drive.past_known:
            drive.expected_known = _expected(drive, voltage, dt, True)
    warnings = [*_start_warnings(drive), *beyond]
    warnings += _move_warnings(drive, voltage, dt)
    warnings += _creeping_hold(drive)
    for text in warnings:
        warn(f"{drive.name}: {text}")
        drive.warnings += (f"{drive.name}: {text}",)


def _first_rows(drive: Drive) -> tuple[Floats, Steps]:
    """Return the rows before the move and the first ones of it, and their time steps."""
    voltage = np.concatenate([rows for rows, _ in drive.first_rows])
    steps = []
    for rows, dt in drive.first_rows:
        if dt is None:
            return voltage, None
        steps.append(np.broadcast_to(dt, rows.shape))
    joined = np.concatenate(steps)
    if (joined == joined[0]).all():
        return voltage, float(joined[0])
    return voltage, joined


def _expected(
    drive: Drive, voltage: Floats, dt: Steps, past_known: bool
) -> float | None:
    """Return the error to expect of the move (RMS), with what is clipped; None where it is not known."""
    from dbo_cli.model.expect import expected_error

    error = expected_error(drive.model, voltage, dt, past_known, drive.lead_rows)
    return None if error is None else math.hypot(error, drive.lost_rms)


# --- warnings, without the name of the trajectory ---


def _start_warnings(drive: Drive) -> list[str]:
    """Return what was clipped, and how the drive begins."""
    unit, span = drive.model.output.suffix, drive.model.output.span
    texts = []
    if drive.clipped:
        texts.append(
            f"{drive.clipping()}: clipped; the move misses {drive.lost_rms:.3g}{unit} RMS, at most "
            f"{drive.lost_most:.3g}{unit}"
        )
    if abs(drive.missed) > OFF_AT_FIRST * span:
        texts.append(
            f"row 1 starts {abs(drive.missed):.3g}{unit} off, where no settled actuator is: try "
            "`condition` or `state` empty"
        )
    if abs(drive.off) > OFF_AT_FIRST * span:
        texts.append("the move starts in motion and rings at first: add `lead` auto")
    return texts


def _beyond(drive: Drive) -> list[str]:
    """Return a warning where the drive leaves the identified range."""
    (low, high), limits = drive.limits.identified, drive.limits
    least, greatest = drive.voltage_range or (low, high)
    if not limits.extrapolate or low <= least <= greatest <= high:
        return []
    unit = limits.suffix
    return [
        f"the drive goes from {least:.6g} to {greatest:.6g}{unit}, beyond the identified range, "
        f"{low:.6g} to {high:.6g}{unit}"
    ]


def _move_warnings(drive: Drive, voltage: Floats, dt: Steps) -> list[str]:
    """Return what of the move the logs do not show."""
    from dbo_cli.model.expect import move_warnings

    texts = move_warnings(drive.model, voltage, dt)
    expected, line = drive.expected_error, drive.model.fit.get("line_rmse")
    if expected is None or not isinstance(line, float):
        return texts
    if expected >= max(line, drive.lost_rms):
        unit = drive.model.output.suffix
        texts.append(
            f"expected error {expected:.3g}{unit}, a straight line's is {line:.3g}: identify with a log "
            "of such moves"
        )
    return texts


def _creeping_hold(drive: Drive) -> list[str]:
    """Return a warning where holding the last position drives the voltage out of the limits."""
    relaxation, state = drive.model.gears.relaxation, drive.state
    if relaxation is None or state is None or state.drive is None:
        return []
    if min(relaxation.gain) >= 0.0:
        return []
    static = drive.model.static
    still = replace(state, sections=None, delay=None, undoing=None)
    position = static.run(np.array([state.drive]), still, 0.0).y
    seconds = LONG_HOLD * max(relaxation.tau)
    voltage = float(static.drive(position, still, seconds).y[0])
    low, high = drive.limits.move
    if low <= voltage <= high:
        return []
    unit = drive.limits.suffix
    return [
        f"holding the last position takes the drive to {voltage:.6g}{unit} in the long run, outside "
        f"{low:.6g} to {high:.6g}{unit}"
    ]


# --- what would fit ---


def would_fit(drive: Drive, period: float | None = None) -> str:
    """Return what would fit, where that is one number; else an empty text.

    ``period`` is that of a loop in seconds.
    """
    texts = _reach_texts(drive)
    slower = _times_slower(drive)
    if not texts and slower > 1.0:
        what = f"it {_rounded_up(slower):g} times slower"
        if period is not None:
            what = f"{1.0 / (slower * period):.2g} Hz"
        texts.append(f"{drive.limits.slew:g}{drive.limits.suffix}/s allows {what}")
    return f"; {', '.join(texts)}" if texts else ""


def _reach_texts(drive: Drive) -> list[str]:
    """Return what the ends of the range reach, where the move goes beyond that."""
    static, limits = drive.model.static, drive.limits
    assert drive.move_range is not None
    least, greatest = drive.move_range
    ends = []
    for voltage, start in zip(limits.move, ("full", "empty"), strict=True):
        state = static.start(voltage, start)
        ends.append(float(static.run(np.array([voltage]), state, 1.0).y[0]))
    texts = []
    for voltage, end in zip(limits.move, ends, strict=True):
        above = end == max(ends) and greatest > end
        below = end == min(ends) and least < end
        if above or below:
            texts.append(
                f"{voltage:.6g}{limits.suffix} reaches {end:.4g}{drive.model.output.suffix}"
            )
    return texts


def _times_slower(drive: Drive) -> float:
    """Return how many times the slew limit the move needs; 0 where that is not known."""
    if drive.limits.slew is None or not drive.first_asked:
        return 0.0
    fastest, state = 0.0, drive.first_asked[0][1]
    for wanted, _, dt in drive.first_asked:
        done = drive.model.drive(wanted, state, dt, drive.limits.move)
        state = done.state
        seconds = np.broadcast_to(np.asarray(dt), wanted.shape)[1:]
        steps = np.abs(np.diff(done.y))[seconds > 0.0]
        rates = steps / seconds[seconds > 0.0]
        fastest = max(fastest, float(rates.max(initial=0.0)))
    return fastest / drive.limits.slew


def _rounded_up(value: float) -> float:
    """Return a bound to two digits, no smaller than it is."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit
