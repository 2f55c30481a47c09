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
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.judge import ALLOWED_PART
from dbo_cli.drive.lead import MOST_LEAD_ROWS, Lead, ramp
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.smooth import open_seam, soft_rise
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Cascade, Run, State

# relaxation settles within 60; limits that bind now and then take longer
MOST_PASSES = 200
# of the drive's range, by which a settled drive changes from pass to pass
SETTLED = 1e-12
# of the drive's range: drives that agree to this are one; far above rounding
ONE_LOOP = 1e-9
# tries for a start or a run-in that leads to the loop it ends on; two are usual
MOST_STARTS = 20
# of the move: a loop that the model repeats further off than this is not settled
LOOP_ERROR = 1e-6
FEWEST_PERIOD_ROWS = 4  # of a period: fewer have no shape


class SettledDrive(NamedTuple):
    """A drive that settles as it is repeated.

    Attributes
    ----------
    run : Run
        Of one period.
    before : State
        Before a pass of it.
    converged : bool
        Whether it stays.
    """

    run: Run
    before: State
    converged: bool


class LoopPlan(NamedTuple):
    """A loop and what leads to it.

    Attributes
    ----------
    begin : State
        Before the first row.
    lead_voltage, voltage : array
        What leads to the period, and the period.
    settled : SettledDrive
        The loop.
    """

    begin: State
    lead_voltage: Floats
    voltage: Floats
    settled: SettledDrive


@dataclass(frozen=True)
class Loop:
    """A loop on its way to the settled drive.

    Attributes
    ----------
    model, limits
        A forward model, and what its drive may do.
    target
        One period of what is asked of the model.
    dt
        Seconds a row.
    lead, begin, passes
        What stands before it: a way from where the amplifier stands, or a state; that
        voltage, if it is known; and passes of run-in.
    name
        Of the trajectory.
    hold
        Rows for which the amplifier stands still before a way to the loop.

    Raises
    ------
    InputError
        The period is too short, or does not close.
    UsageError
        ``passes`` is no number of passes, or too many.
    """

    model: Cascade
    limits: Limits
    target: Floats
    dt: float
    lead: Lead
    begin: float | None
    passes: int
    name: str
    hold: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no loop."""
        passes = self.passes
        if not isinstance(passes, int | np.integer) or passes < 0:
            raise UsageError(f"`passes` {passes}: give a whole number of passes")
        if passes * self.target.size > MOST_LEAD_ROWS:
            raise UsageError(
                f"`passes` {passes}: at most {MOST_LEAD_ROWS:,} rows in all"
            )
        period = self.target
        if period.size < FEWEST_PERIOD_ROWS:
            raise InputError(
                f"{self.name}: {period.size} rows are too few for a loop; give {FEWEST_PERIOD_ROWS} or more"
            )
        seam = open_seam(period)
        if seam:
            raise InputError(f"{self.name}: {seam}")

    @cached_property
    def static_target(self) -> Floats:
        """One period of what the static part is to follow, with dynamics and delay undone."""
        return self.model.inverter(self.dt).loop(self.target)

    def require_settled(self, plan: LoopPlan, on_limit: str) -> tuple[str, ...]:
        """Warn of a loop that the model does not repeat; refuse it where it costs too much (LimitError)."""
        model, dt, target = self.model, self.dt, self.static_target
        static, settled = model.static, plan.settled
        period = settled.run.y
        size = max(float(np.ptp(target)), LOOP_ERROR * model.output.span)
        state = static.run(plan.lead_voltage, plan.begin, dt).state
        looped = looped_state(model, period, dt, state)
        aim = static.run(period, settled.before, dt).y
        residual = largest_difference(static.run(period, looped, dt).y, aim)
        if settled.converged and residual <= LOOP_ERROR * size:
            return ()
        text = (
            f"{self.name}: the loop does not settle: however often it is repeated, it ends {residual:.3g}"
            f"{model.output.suffix} off (`passes` 1 or `state` empty fixes the start)"
        )
        if residual <= LOOP_ERROR * size:
            text = f"{self.name}: the drive still changes from pass to pass within its limits"
        costs = on_limit == "auto" and residual > ALLOWED_PART * size
        if costs or on_limit == "error":
            raise LimitError(f"{text}; `on_limit` clip writes it anyway")
        warn(text)
        return (text,)

    # --- what stands before the period ---

    def planned(self) -> LoopPlan:
        """Return the settled loop and what leads to it.

        The loop depends on the state in which it begins, and what stands before it on
        the loop: both are found by turns.

        Raises
        ------
        LimitError
            The loop does not close within the limits.
        """
        model, limits, start = self.model, self.limits, self.lead.state
        target = self.static_target
        begin = self.begin
        if begin is not None:
            state = model.start(begin, start)
        else:
            state = model.start_drive(float(target[0]), start, *limits.move)
            if self.passes:
                begin = state.drive if state.first is None else state.first
        settled = settled_drive(model, target, self.dt, state, limits)
        for _ in range(MOST_STARTS):
            last = settled
            voltage = self._closed(last.run.y)
            stands = float(voltage[0]) if begin is None else begin
            before = self._before(voltage, stands)
            begin_state = model.start(stands, start)
            state = model.run(before, begin_state, self.dt).state
            settled = settled_drive(model, target, self.dt, state, limits)
            change = largest_difference(settled.run.y, last.run.y)
            if change <= ONE_LOOP * model.input.span:
                break
        return LoopPlan(begin_state, before, voltage, last)

    def _before(self, period: Floats, begin: float) -> Floats:
        """Return what leads to a period: a ramp, or a pass in which it grows, then whole passes of it.

        ``begin`` is where the amplifier stands.
        """
        dt, limits, passes = self.dt, self.limits, self.passes
        seconds = self.lead.approach
        if seconds is not None:
            ascent = ramp("approach", begin, float(period[0]), dt, seconds, limits)
            still = np.full(1 + self.hold, begin)
            return np.concatenate([still, ascent, np.tile(period, passes)])
        if not passes:
            return np.empty(0)
        rise = soft_rise(np.linspace(0.0, 1.0, period.size))
        growing = begin + rise * (period - begin)
        growing = np.clip(growing, *limits.rating)  # rounding
        voltage = np.concatenate([growing, np.tile(period, passes - 1)])
        voltage = self._within_slew(voltage, begin)
        miss = abs(float(voltage[-1] - period[-1]))
        if miss > 0.0:
            raise LimitError(
                f"{self.name}: the run-in ends {miss:.3g}{limits.suffix} off the settled loop: raise "
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
        largest_step = self.limits.largest_step(self.dt)
        seam = largest_difference(closed[:1], closed[-1:])
        jumps = largest_step is not None and seam > largest_step
        change = largest_difference(closed, voltage)
        if jumps or change > ONE_LOOP * self.model.input.span:
            raise LimitError(
                f"{self.name}: does not close within `max_slew` {self.limits.slew:g}{self.limits.suffix}/s: "
                "raise it, or make the loop slower"
            )
        return closed

    def _within_slew(self, voltage: Floats, last: float) -> Floats:
        """Return a drive whose rows follow ``last`` and one another within the slew limit."""
        largest_step = self.limits.largest_step(self.dt)
        if largest_step is None:
            return voltage
        if (np.abs(np.diff(voltage, prepend=last)) <= largest_step).all():
            return voltage
        largest_step *= 1.0 - 1e-15
        values = voltage.tolist()
        for k, value in enumerate(values):
            last = values[k] = min(max(value, last - largest_step), last + largest_step)
        return np.array(values)


# --- the settled drive ---


def settled_drive(
    model: Cascade, target: Floats, dt: float, state: State, limits: Limits
) -> SettledDrive:
    """Return the drive to which a period settles.

    Parameters
    ----------
    model
        A forward model.
    target
        One period of what its static part is to follow (``Inverter.loop``).
    dt
        Seconds a row.
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    limits
        What the drive may do.
    """
    static, move, slew = model.static, limits.move, limits.slew
    run = static.drive(target, state, dt, move, slew)
    for _ in range(MOST_PASSES):
        before = looped_state(model, run.y, dt, state)
        again = static.drive(target, before, dt, move, slew)
        change = largest_difference(again.y, run.y)
        run = again
        if change <= SETTLED * model.input.span:
            return SettledDrive(run, before, True)
    return SettledDrive(run, before, False)


def largest_difference(values: Floats, others: Floats) -> float:
    """Return the largest difference between two signals."""
    return float(np.abs(values - others).max())


def looped_state(model: Cascade, voltage: Floats, dt: float, state: State) -> State:
    """Return gears and memory before a pass of a drive that was repeated for ever, begun in a state."""
    static = model.static
    begin_state = static.run(voltage, state, dt).state
    relaxation = model.gears.relaxation
    if relaxation is None or begin_state.memory is None:
        return begin_state
    after = static.run(voltage, begin_state, dt).state
    assert after.memory is not None
    memory = []
    for start, end, tau in zip(
        begin_state.memory, after.memory, relaxation.tau, strict=True
    ):
        exponent = -voltage.size * dt / tau
        memory.append((end - math.exp(exponent) * start) / -math.expm1(exponent))
    return replace(after, memory=tuple(memory))


def settled_run(model: Cascade, voltage: Floats, dt: float, state: State) -> Floats:
    """Return the displacement of one period of a drive that was repeated for ever."""
    before = looped_state(model, voltage, dt, state)
    return model.follow_loop(model.static.run(voltage, before, dt).y, dt)
