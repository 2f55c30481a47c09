"""A move that is looped: one period in, the settled drive out, and a run-in before it.

The settled drive is a fixed point of the pass. Gears and memory are those to which the last
drive leads when it is repeated for ever, the next drive is the inverse's in that state, until
it stays. Gears repeat after a pass; relaxation is linear in the drive, so that the memory that
a periodic drive leaves unchanged is computed at once.

What stands before the period is made of the settled drive itself: a ramp to its first row, or a
first pass in which it grows from where the amplifier stands, then whole passes of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import ALLOWED_PART, Drive
from dbo_cli.drive.lead import MOST_ROWS, Lead, ramp, standing_at
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.outlook import conclude
from dbo_cli.drive.swings import soft_rise
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Cascade, Run, State

NOTHING = np.zeros(0)

# relaxation settles within 60; limits that bind now and then take longer
MOST_PASSES = 200
# of the drive's range, by which a settled drive changes from pass to pass
SETTLED = 1e-12
# of the drive's range: drives that agree to this are one; far above rounding
SAME_DRIVE = 1e-9
# tries for a start or a run-in that leads to the loop it ends on; two are usual
MOST_STARTS = 20
# of the move: a loop that the model repeats further off than this is not settled
LOOP_ERROR = 1e-6
FEWEST_ROWS = 4  # of a period: fewer have no shape
# times the largest step inside a period, from which on its last row does not meet its first
SEAM = 3.0


def plan_loop(
    drive: Drive,
    desired: Floats,
    request: Floats,
    time: Floats,
    dt: float,
    lead: Lead,
    passes: int,
) -> None:
    """Give a drive the rows of one period of the settled drive, with passes of run-in before it.

    Parameters
    ----------
    drive
        Takes rows and figures.
    desired, request
        One period of the trajectory, and of what is asked of the model for it.
    time, dt
        Seconds of each row, and seconds a row.
    lead
        What stands before it: a way from where the amplifier stands, or a state.
    passes
        Of the run-in.

    Raises
    ------
    InputError
        The period is too short, or does not close.
    LimitError
        The loop does not settle within the limits, or they cost too much of it.
    UsageError
        Options exclude each other.
    """
    if not isinstance(passes, int | np.integer) or passes < 0:
        raise UsageError(f"`passes` {passes}: give a whole number of passes")
    if passes * desired.size > MOST_ROWS:
        raise UsageError(f"`passes` {passes}: at most {MOST_ROWS:,} rows in all")
    if lead.condition or lead.rest:
        raise UsageError(
            "`periodic` excludes `condition`, `lead` and `return`: use `passes` N"
        )
    model = drive.model
    require_closed(drive.name, request)
    undone = model.inverter(dt).loop(request)
    loop = Loop(drive, undone, dt, lead, passes)
    begun, before, settled, voltage = loop.led_to()
    done, state = settled.run, settled.before
    drive.clip(desired, undone, done, state, dt)
    drive.require_reached(dt * desired.size)
    loop.require_settled(settled, begun, before)
    first = float(before[0]) if before.size else float(voltage[0])
    drive.gate.require_reachable(first, first, dt)
    drive.admit(before, dt, "lead")
    drive.admit(voltage, dt, "move")
    drive.gate.admit(voltage[:1], dt)  # the seam
    count = before.size
    drive.voltage = np.concatenate([before, voltage])
    drive.move = slice(count, drive.voltage.size)
    run = model.run(drive.voltage, begun, dt)
    drive.state = replace(run.state, time=float(time[-1]))
    drive.time = np.concatenate([time[0] - dt * np.arange(count, 0.0, -1.0), time])
    drive.desired = np.concatenate([run.y[:count], desired])
    drive.lead_seconds, drive.past_known = count * dt, lead.past_known
    conclude(drive)
    settled_y = settled_run(model, voltage, dt, settled.before)
    away = float(np.sqrt(np.mean((run.y[count:] - settled_y) ** 2)))
    unit = model.output.suffix
    note = f"the first pass is {away:.3g}{unit} off the settled one (RMS)"
    drive.notes += (f"{drive.name}: {note}",)


@dataclass(frozen=True)
class Loop:
    """A loop on its way to the settled drive: one period of what the static part is to follow.

    Attributes
    ----------
    drive
        Its model, limits and name.
    undone
        One period, with dynamics and delay undone.
    dt
        Seconds a row.
    lead, passes
        What stands before it.
    """

    drive: Drive
    undone: Floats
    dt: float
    lead: Lead
    passes: int

    # --- what stands before the period ---

    def led_to(self) -> tuple[State, Floats, Settled, Floats]:
        """Return state and rows before the period, the settled loop to which they lead, and its drive.

        The loop depends on the state in which it begins, and what stands before it on
        the loop: both are found by turns.
        """
        model, limits, start = self.drive.model, self.drive.limits, self.lead.state
        begin = standing_at(limits, self.lead)
        if begin is not None:
            state = model.start(begin, start)
        elif self.lead.approach is not None:
            raise UsageError("`approach` needs `from` VOLT or a `state` file")
        else:
            state = model.start_drive(float(self.undone[0]), start, *limits.move)
            if self.passes:
                begin = state.drive if state.first is None else state.first
        settled = settled_drive(model, self.undone, self.dt, state, limits)
        for _ in range(MOST_STARTS):
            last = settled
            voltage = self._closed(last.run.y)
            stands = float(voltage[0]) if begin is None else begin
            before, begun = self._before(voltage, stands), model.start(stands, start)
            state = model.run(before, begun, self.dt).state
            settled = settled_drive(model, self.undone, self.dt, state, limits)
            if apart(settled.run.y, last.run.y) <= SAME_DRIVE * model.input.span:
                break
        return begun, before, last, voltage

    def _before(self, period: Floats, begin: float) -> Floats:
        """Return what leads to a period: a ramp, or a pass in which it grows, then whole passes of it.

        ``begin`` is where the amplifier stands.
        """
        dt, limits, passes = self.dt, self.drive.limits, self.passes
        seconds = self.lead.approach
        if seconds is not None:
            ascent = ramp("approach", begin, float(period[0]), dt, seconds, limits)
            return np.concatenate([[begin], ascent, np.tile(period, passes)])
        if not passes:
            return NOTHING
        rise = soft_rise(np.linspace(0.0, 1.0, period.size))
        growing = begin + rise * (period - begin)
        growing = np.clip(growing, *limits.rating)  # rounding
        voltage = np.concatenate([growing, np.tile(period, passes - 1)])
        voltage = self._within_slew(voltage, begin)
        off = abs(float(voltage[-1] - period[-1]))
        if off > 0.0:
            raise LimitError(
                f"{self.drive.name}: the run-in ends {off:.3g}{limits.suffix} off the settled loop: raise "
                "`passes` or `max_slew`"
            )
        return voltage

    # --- the period ---

    def _closed(self, voltage: Floats) -> Floats:
        """Return a settled drive whose seam keeps the slew limit to the last digit (LimitError: it jumps).

        A drive that has settled differs from the pass before in its last digits, and
        its first row was held behind the last row of that pass.
        """
        closed = self._within_slew(voltage, float(voltage[-1]))
        most = self.drive.limits.largest_step(self.dt)
        jumps = most is not None and apart(closed[:1], closed[-1:]) > most
        if jumps or apart(closed, voltage) > SAME_DRIVE * self.drive.model.input.span:
            raise LimitError(
                f"{self.drive.name}: `max_slew` forbids the step from the last row, {voltage[-1]:.6g}, to "
                f"the first, {voltage[0]:.6g}"
            )
        return closed

    def _within_slew(self, voltage: Floats, last: float) -> Floats:
        """Return a drive whose rows follow ``last`` and one another within the slew limit."""
        most = self.drive.limits.largest_step(self.dt)
        if most is None or (np.abs(np.diff(voltage, prepend=last)) <= most).all():
            return voltage
        most *= 1.0 - 1e-15
        values = voltage.tolist()
        for k, value in enumerate(values):
            last = values[k] = min(max(value, last - most), last + most)
        return np.array(values)

    def require_settled(self, settled: Settled, begun: State, before: Floats) -> None:
        """Warn of a loop that the model does not repeat, or refuse it where it costs too much."""
        drive, dt = self.drive, self.dt
        model, static, period = drive.model, drive.model.static, settled.run.y
        size = max(float(np.ptp(self.undone)), LOOP_ERROR * model.output.span)
        state = static.run(before, begun, dt).state
        looped = looped_state(model, period, dt, state)
        aim = static.run(period, settled.before, dt).y
        away = apart(static.run(period, looped, dt).y, aim)
        if settled.converged and away <= LOOP_ERROR * size:
            return
        text = (
            f"{drive.name}: the loop does not settle: however often it is repeated, it ends {away:.3g}"
            f"{model.output.suffix} off (`passes` 1 or `state` empty fixes the start)"
        )
        if away <= LOOP_ERROR * size:
            text = f"{drive.name}: the drive still changes from pass to pass within its limits"
        costs = drive.on_limit == "auto" and away > ALLOWED_PART * size
        if costs or drive.on_limit == "error":
            raise LimitError(f"{text}; `on_limit` clip writes it anyway")
        warn(text)
        drive.warnings += (text,)


def require_closed(name: str, period: Floats) -> None:
    """Refuse a period that is too short, or jumps from its last row to its first (InputError)."""
    if period.size < FEWEST_ROWS:
        raise InputError(
            f"{name}: {period.size} rows are too few for a loop; give {FEWEST_ROWS} or more"
        )
    seam = apart(period[:1], period[-1:])
    inside = apart(period[1:], period[:-1])
    if seam > SEAM * inside:
        raise InputError(
            f"{name}: the loop is open: its seam is a step of {seam:.3g}, the largest inside "
            f"{inside:.3g}: give one whole period"
        )


# --- the settled drive ---


class Settled(NamedTuple):
    """The run of one period of a settled drive, the state before it, and whether it stays."""

    run: Run
    before: State
    converged: bool


def settled_drive(
    model: Cascade, undone: Floats, dt: float, state: State, limits: Limits
) -> Settled:
    """Return the drive of one period whose end is its own beginning.

    Parameters
    ----------
    model
        A forward model.
    undone
        One period of what its static part is to follow (``Inverter.loop``).
    dt
        Seconds a row.
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    limits
        What the drive may do.
    """
    static, move, slew = model.static, limits.move, limits.slew
    done = static.drive(undone, state, dt, move, slew)
    for _ in range(MOST_PASSES):
        before = looped_state(model, done.y, dt, state)
        again = static.drive(undone, before, dt, move, slew)
        away = apart(again.y, done.y)
        done = again
        if away <= SETTLED * model.input.span:
            return Settled(done, before, True)
    return Settled(done, before, False)


def apart(values: Floats, beside: Floats) -> float:
    """Return the largest difference between two signals."""
    return float(np.abs(values - beside).max())


def looped_state(model: Cascade, voltage: Floats, dt: float, state: State) -> State:
    """Return gears and memory before a pass of a drive that was repeated for ever, begun in a state."""
    static = model.static
    begun = static.run(voltage, state, dt).state
    relaxation = model.gears.relaxation
    if relaxation is None or begun.memory is None:
        return begun
    after = static.run(voltage, begun, dt).state
    assert after.memory is not None
    memory = []
    for start, end, tau in zip(begun.memory, after.memory, relaxation.tau, strict=True):
        left = -voltage.size * dt / tau
        memory.append((end - math.exp(left) * start) / -math.expm1(left))
    return replace(after, memory=tuple(memory))


def settled_run(model: Cascade, voltage: Floats, dt: float, state: State) -> Floats:
    """Return the displacement of one period of a drive that was repeated for ever."""
    before = looped_state(model, voltage, dt, state)
    return model.follow_loop(model.static.run(voltage, before, dt).y, dt)
