"""A move that is looped: one period in, the settled drive out, and a run-in before it.

The settled drive is a fixed point of the pass. Gears and memory are those to which the last
drive leads when it is repeated for ever, the next drive is the inverse's in that state, until
it stays. Gears repeat after a pass; relaxation is linear in the drive, so that the memory that
a periodic drive leaves unchanged is computed at once.

What stands before the period is made of the settled drive itself: a ramp to its first row, or a
first pass in which it grows from where the amplifier stands, then whole passes of it.
"""

import math
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.judge import ALLOWED_PART
from dbo_cli.drive.lead import Lead, ramp, require_time
from dbo_cli.drive.smooth import MOST_SIGNAL_ROWS, open_seam, soft_rise
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


class Loop:
    """A period that settles as it is repeated, and what leads to it.

    Parameters
    ----------
    lead
        A forward model, what its drive may do, and what stands before the loop: a way
        from where the amplifier stands, or a state.
    period
        One period of what is asked of the model.
    dt
        Seconds a row.
    passes
        Of run-in.
    name
        Of the trajectory.

    Attributes
    ----------
    target
        One period of what the static part is to follow, with dynamics and delay undone.
    begin, reached
        States before the first row, and behind what leads to the period.
    lead_voltage, voltage
        What leads to the period, and the period.
    run, state
        The settled drive of the period, and the state before a pass of it.

    Raises
    ------
    InputError
        The period does not close.
    LimitError
        The loop does not close within the limits.
    UsageError
        ``passes`` is no number of passes, or too many.
    """

    def __init__(
        self, lead: Lead, period: Floats, dt: float, passes: int, name: str
    ) -> None:
        is_count = isinstance(passes, int | np.integer)
        if not is_count or not 0 <= passes * period.size <= MOST_SIGNAL_ROWS:
            raise UsageError(
                f"`passes` {passes}: give a whole number, of at most {MOST_SIGNAL_ROWS:,} rows in all"
            )
        seam = open_seam(period)
        if seam:
            raise InputError(f"{name}: {seam}")
        self.lead, self.model, self.limits = lead, lead.model, lead.limits
        self.dt, self.passes, self.name = dt, passes, name
        self.target = self.model.inverter(dt).loop(period)
        self._settle()

    def require_settled(self, on_limit: str) -> tuple[str, ...]:
        """Warn of a loop that the model does not repeat; refuse it where it costs too much (LimitError)."""
        model, dt, target, period = self.model, self.dt, self.target, self.run.y
        static = model.static
        size = max(float(np.ptp(target)), LOOP_ERROR * model.output.span)
        looped = looped_state(model, period, dt, self.reached)
        aim = static.run(period, self.state, dt).y
        residual = largest_difference(static.run(period, looped, dt).y, aim)
        if residual <= LOOP_ERROR * size:
            return ()
        text = (
            f"{self.name}: the loop does not settle within its limits: repeated, it ends {residual:.3g}"
            f"{model.output.suffix} off (`passes` 1 or `state` empty fixes the start)"
        )
        costs = on_limit == "auto" and residual > ALLOWED_PART * size
        if costs or on_limit == "error":
            raise LimitError(f"{text}; `on_limit` clip writes it anyway")
        warn(text)
        return (text,)

    def _settle(self) -> None:
        """Find the settled loop and what leads to it.

        The loop depends on the state in which it begins, and what stands before it on
        the loop: both are found by turns.
        """
        model, limits, start = self.model, self.limits, self.lead.state
        begin = self.lead.standing
        if begin is not None:
            state = model.start(begin, start)
        else:
            state = model.start_drive(float(self.target[0]), start, *limits.move)
            if self.passes:
                begin = state.drive if state.first is None else state.first
        following = self._repeated(state)
        for _ in range(MOST_STARTS):
            self.run, self.state = following
            self.voltage = self._closed(self.run.y)
            stands = float(self.voltage[0]) if begin is None else begin
            self.lead_voltage = self._before(self.voltage, stands)
            self.begin = model.start(stands, start)
            self.reached = model.run(self.lead_voltage, self.begin, self.dt).state
            following = self._repeated(self.reached)
            change = largest_difference(following[0].y, self.run.y)
            if change <= ONE_LOOP * model.input.span:
                break

    def _repeated(self, state: State) -> tuple[Run, State]:
        """Return the drive to which the period settles, and the state before a pass of it.

        ``state`` is that before the first pass ever: gears that the loop does not reach keep it.
        """
        model, limits, dt, target = self.model, self.limits, self.dt, self.target
        static, before = model.static, state
        run = static.drive(target, state, dt, limits.move, limits.slew)
        for _ in range(MOST_PASSES):
            before = looped_state(model, run.y, dt, state)
            again = static.drive(target, before, dt, limits.move, limits.slew)
            change = largest_difference(again.y, run.y)
            run = again
            if change <= SETTLED * model.input.span:
                break
        return run, before

    def _before(self, period: Floats, begin: float) -> Floats:
        """Return what leads to a period: a ramp, or a pass in which it grows, then whole passes of it.

        ``begin`` is where the amplifier stands.
        """
        dt, limits, passes = self.dt, self.limits, self.passes
        approach = self.lead.approach
        if approach is not None:
            seconds = approach if isinstance(approach, float) else None
            ascent = ramp(begin, float(period[0]), dt, seconds, limits)
            require_time(seconds, ascent.size * dt, dt)
            still = np.full(1 + self.lead.hold, begin)
            return np.concatenate([still, ascent, np.tile(period, passes)])
        if not passes:
            return np.empty(0)
        rise = soft_rise(np.linspace(0.0, 1.0, period.size))
        growing = begin + rise * (period - begin)
        growing = np.clip(growing, *limits.rating)  # rounding
        growing[-1] = period[-1]
        voltage = np.concatenate([growing, np.tile(period, passes - 1)])
        voltage = self._within_slew(voltage, begin)
        miss = abs(float(voltage[-1] - period[-1]))
        if miss > 0.0:
            raise LimitError(
                f"{self.name}: the run-in ends {miss:.3g}{limits.suffix} off the settled loop: raise "
                "`passes` or `max_slew`"
            )
        return voltage

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
        change = np.abs(np.diff(voltage, prepend=last))
        if largest_step is None or (change <= largest_step).all():
            return voltage
        largest_step *= 1.0 - 1e-15
        values = voltage.tolist()
        for k, value in enumerate(values):
            last = values[k] = min(max(value, last - largest_step), last + largest_step)
        return np.array(values)


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
