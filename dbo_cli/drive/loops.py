"""A move that is looped: one period in, the settled drive out, and a run-in before it.

The settled drive is a fixed point of the pass: gears and memory are those to which the
last drive leads when it is repeated for ever, the next drive is the inverse's in that
state, until it stays. Gears repeat after a pass; relaxation is linear in the drive, so
that the memory that a periodic drive leaves unchanged is computed at once. The run-in
follows the trajectory, fades over into the settled drive and ends on it.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Drive
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.lead import (
    Around,
    plan_lead,
    ramp,
    require_short,
    soft_rise,
    standing_at,
)
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loss import ALLOWED_PART, Loss
from dbo_cli.drive.outlook import Outlook
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Model, State, VoltageWindow

Floats = NDArray[np.float64]
NOTHING = np.zeros(0)

# relaxation settles within 60; limits that bind now and then take longer
MOST_PASSES = 200
# of the drive's range, by which a settled drive changes from pass to pass
SETTLED = 1e-12
# of the drive's range: drives that agree to this are one; far above rounding
SAME_DRIVE = 1e-9
# tries for a start, ramp or run-in that leads to the loop it ends on; two are usual
MOST_STARTS = 20
# of the move: a loop that the model repeats further off than this is none
LOOP_ERROR = 1e-6
FEWEST_ROWS = 4  # of a period: fewer have no shape
# times the largest step inside a period, from which on its last row does not meet its first
SEAM = 3.0
# where the run-in fades over, in parts of it before its end (begin, end); measured before 1.0
FADE = 0.5, 0.1


class Settled(NamedTuple):
    """One period of a settled drive, the state before it, what was clipped, and whether it stays."""

    voltage: Floats
    before: State
    clipped: int
    first_clipped: int
    converged: bool


class Before(NamedTuple):
    """The rows before a period: displacement, voltage, and the state in which they begin."""

    desired: Floats
    voltage: Floats
    begun: State


def settled_drive(
    model: Model, undone: Floats, dt: float, state: State, window: VoltageWindow
) -> Settled:
    """Return the drive of one period whose end is its own beginning.

    Parameters
    ----------
    model
        A forward model.
    undone
        One period of what its static part is to follow (``Model.undo_loop``).
    dt
        Seconds a row.
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    window
        What the drive may do.
    """
    static = model.static
    done = static.drive(undone, state, dt, window)
    for _ in range(MOST_PASSES):
        before = looped_state(model, done.voltage, dt, state)
        again = static.drive(undone, before, dt, window)
        away = apart(again.voltage, done.voltage)
        done = again
        if away <= SETTLED * model.input.span:
            return Settled(done.voltage, before, done.clipped, done.first_clipped, True)
    return Settled(done.voltage, before, done.clipped, done.first_clipped, False)


def apart(values: Floats, others: Floats) -> float:
    """Return the largest difference between two signals."""
    return float(np.abs(values - others).max())


def looped_state(model: Model, voltage: Floats, dt: float, state: State) -> State:
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
    return dataclasses.replace(after, memory=tuple(memory))


def slow_output(model: Model, voltage: Floats, dt: float, before: State) -> Floats:
    """Return what gears, curves and memory make of one period, without dynamics and delay."""
    return model.static.run(voltage, before, dt).y


def settled_run(model: Model, voltage: Floats, dt: float, state: State) -> Floats:
    """Return the displacement of one period of a drive that was repeated for ever."""
    before = looped_state(model, voltage, dt, state)
    return model.follow_loop(slow_output(model, voltage, dt, before), dt)


@dataclass(frozen=True)
class Loop:
    """Plans the drive of a loop.

    Attributes
    ----------
    model
        A forward model.
    desired, request
        One period of the trajectory, and of what is asked of the model for it.
    time
        Seconds of each row; None: they begin at 0.
    dt
        Seconds a row.
    limits, around, on_limit, name
        As in ``plan``.
    """

    model: Model
    desired: Floats
    request: Floats
    time: Floats | None
    dt: float
    limits: Limits
    around: Around
    on_limit: str
    name: str

    def plan(self, passes: int) -> Drive:
        """Return one period of the settled drive, with so many passes of run-in before it.

        Raises
        ------
        InputError
            The period is too short, or does not close.
        LimitError
            The loop does not settle within the limits, or they cost too much of it.
        UsageError
            Options exclude each other.
        """
        self._check(passes)
        undone = self.model.undo_loop(self.request, self.dt)
        if passes:
            before, settled, voltage = self._run_in(undone, passes)
        else:
            before, settled = self._led_to(undone)
            voltage = self._closed(settled.voltage)
        loss = self._loss(settled, undone)
        warnings = self._require_settled(settled, undone, before)
        drive = self._drive(before, voltage, loss, settled)
        return dataclasses.replace(drive, warnings=(*warnings, *drive.warnings))

    def _check(self, passes: int) -> None:
        around = self.around
        if passes < 0:
            raise UsageError(f"`passes` {passes}: give a whole number of passes")
        if around.condition:
            raise UsageError(
                "`periodic` and `condition` exclude each other (`passes` N runs a loop in)"
            )
        if around.return_to is not None:
            raise UsageError(
                "`periodic` and `return` exclude each other: a loop goes on"
            )
        if around.lead is not None and not passes:
            raise UsageError("`lead` rests before the run-in of a loop: give `passes`")
        require_closed(self.name, self.request)

    # --- what stands before the period ---

    def _settled(self, undone: Floats, state: State) -> Settled:
        return settled_drive(self.model, undone, self.dt, state, self.limits.window)

    def _start(self, voltage: float) -> State:
        """Return the state in which the actuator starts, at a voltage where none is known."""
        state = self.around.state
        return state if isinstance(state, State) else self.model.start(voltage, state)

    def _run_in(self, undone: Floats, passes: int) -> tuple[Before, Settled, Floats]:
        """Return the rows before the period, the settled loop that they lead to, and its drive."""
        model, dt, loop = self.model, self.dt, self.request
        first = float(loop[0])
        lead = plan_lead(model, first, dt, self.limits, self.around)
        require_short(lead, loop.size * dt, self.limits)
        wanted = first + _rise(loop.size, passes) * (np.tile(loop, passes) - first)
        desired = np.concatenate([lead.desired, wanted])
        followed = self._followed(desired, lead.state)
        begun = lead.state or self._start(float(followed[0]))
        settled = self._settled(undone, begun)
        for _ in range(MOST_STARTS):
            closed = self._closed(settled.voltage)
            run_in = self._faded_over(followed, closed, passes)
            state = model.run(run_in, begun, dt).state
            again = self._settled(undone, state)
            away = apart(again.voltage, settled.voltage)
            settled = again
            if away <= SAME_DRIVE * model.input.span:
                break
        if lead.voltage.size:
            begun = self._start(float(lead.voltage[0]))
        voltage = np.concatenate([lead.voltage, run_in])
        desired = np.concatenate([lead.expected, desired])
        return Before(desired, voltage, begun), settled, closed

    def _followed(self, desired: Floats, state: State | None) -> Floats:
        """Return the drive that follows displacements up to the loop, which is read ahead."""
        model, dt = self.model, self.dt
        ahead = model.ahead(dt)
        signal = np.concatenate([desired, np.resize(self.request, ahead)])
        undoing = None if state is None else model.undoing_of(state, dt)
        undone = model.undo(signal, undoing, dt)[0]
        if state is None:
            assert isinstance(self.around.state, str)
            state = model.start_drive(
                float(undone[0]), self.around.state, *self.limits.move
            )
        return model.static.drive(undone, state, dt, self.limits.window).voltage

    def _faded_over(self, followed: Floats, settled: Floats, passes: int) -> Floats:
        """Return a run-in that ends on the settled drive, within the limits.

        Both drives keep the limits, and so does what lies between; only the change from
        the one to the other may be too fast, and then it takes longer.
        """
        rows, length = followed.size, settled.size * passes
        tail = np.resize(settled, rows + (-rows) % settled.size)[-rows:]
        left = (rows - np.arange(rows)) / length
        begin, end = FADE
        rise = soft_rise(np.clip((begin - left) / (begin - end), 0.0, 1.0))
        drive = np.where(rise < 1.0, followed + rise * (tail - followed), tail)
        drive = np.clip(drive, *self.limits.move)
        drive = self._within_slew(drive, float(drive[0]))
        off = apart(drive[-1:], settled[-1:])
        if off > 0.0:
            raise LimitError(
                f"{self.name}: the run-in ends {off:.3g}{self.limits.suffix} off the settled loop (more "
                "`passes`, or a larger `max_slew`)"
            )
        return drive

    def _led_to(self, undone: Floats) -> tuple[Before, Settled]:
        """Return the ramp to the loop, where one is asked for, and the loop that it leads to."""
        last = standing_at(self.model, self.limits, self.around)
        approach = self.around.approach
        if approach is not None and last is None:
            raise UsageError(
                "`approach` needs `from` VOLT (where the amplifier stands) or a `state`"
            )
        if approach is None or last is None:
            return self._own_start(undone, last)
        begun = self._start(last)
        settled = self._settled(undone, begun)
        for _ in range(MOST_STARTS):
            end = settled.voltage[:1]
            way = ramp("approach", last, float(end[0]), self.dt, approach, self.limits)
            voltage = np.concatenate([[last], way])
            run = self.model.run(voltage, begun, self.dt)
            settled = self._settled(undone, run.state)
            if apart(settled.voltage[:1], end) <= SAME_DRIVE * self.model.input.span:
                return Before(run.y, voltage, begun), settled
        raise LimitError(
            f"{self.name}: no ramp was found that ends where the loop begins (`passes` runs it in)"
        )

    def _own_start(self, undone: Floats, last: float | None) -> tuple[Before, Settled]:
        """Return the loop whose first row's own start leads to it, or that of where the amplifier stands."""
        if last is not None:
            begun = self._start(last)
            return Before(NOTHING, NOTHING, begun), self._settled(undone, begun)
        assert isinstance(self.around.state, str)
        state = self.model.start_drive(
            float(undone[0]), self.around.state, *self.limits.move
        )
        settled = self._settled(undone, state)
        for _ in range(MOST_STARTS):
            begun = self._start(float(settled.voltage[0]))
            again = self._settled(undone, begun)
            away = apart(again.voltage[:1], settled.voltage[:1])
            settled = again
            if away <= SAME_DRIVE * self.model.input.span:
                break
        begun = self._start(float(settled.voltage[0]))
        return Before(NOTHING, NOTHING, begun), settled

    # --- the period ---

    def _closed(self, voltage: Floats) -> Floats:
        """Return a settled drive whose seam keeps the slew limit to the last digit (LimitError: it jumps).

        A drive that has settled differs from the pass before in its last digits, and
        its first row was held behind the last row of that pass.
        """
        closed = self._within_slew(voltage, float(voltage[-1]))
        most = self.limits.largest_step(self.dt)
        seam = apart(closed[:1], closed[-1:])
        jumps = most is not None and seam > most
        if jumps or apart(closed, voltage) > SAME_DRIVE * self.model.input.span:
            raise LimitError(
                f"{self.name}: the loop does not close within the limits: from its last row, "
                f"{voltage[-1]:.6g}, to its first, {voltage[0]:.6g}, is a step that `max_slew` forbids"
            )
        return closed

    def _within_slew(self, voltage: Floats, last: float) -> Floats:
        """Return a drive whose rows follow ``last`` and one another within the slew limit."""
        most = self.limits.largest_step(self.dt)
        if most is None or (np.abs(np.diff(voltage, prepend=last)) <= most).all():
            return voltage
        values = voltage.tolist()
        for k, value in enumerate(values):
            lowest = last - most * (1.0 - 1e-15)
            highest = last + most * (1.0 - 1e-15)
            last = values[k] = min(max(value, lowest), highest)
        return np.array(values)

    def _loss(self, settled: Settled, undone: Floats) -> Loss:
        """Count what the limits cut off the period, or refuse it."""
        loss = Loss(self.model, self.limits, self.name)
        loss.keep(undone, self.dt, settled.before)
        loss.see(self.desired, settled.clipped, settled.first_clipped)
        if self.on_limit == "error":
            loss.require_none()
        if settled.clipped:
            reached = slow_output(self.model, settled.voltage, self.dt, settled.before)
            loss.add_displacement(self.model.follow_loop(undone - reached, self.dt))
        if not isinstance(self.around.state, State):
            loss.require_reachable()
        if self.on_limit == "auto":
            loss.require_little(self.dt * self.desired.size)
        return loss

    def _require_settled(
        self, settled: Settled, undone: Floats, before: Before
    ) -> tuple[str, ...]:
        """Warn of a loop that the model does not repeat, or refuse it where it costs too much."""
        model, dt = self.model, self.dt
        size = max(float(np.ptp(undone)), LOOP_ERROR * model.output.span)
        state = model.static.run(before.voltage, before.begun, dt).state
        looped = looped_state(model, settled.voltage, dt, state)
        aim = slow_output(model, settled.voltage, dt, settled.before)
        away = apart(slow_output(model, settled.voltage, dt, looped), aim)
        if settled.converged and away <= LOOP_ERROR * size:
            return ()
        text = (
            f"{self.name}: the loop does not settle: however often it is repeated, it ends {away:.3g}"
            f"{model.output.suffix} off (`passes` 1 or `state` empty fixes the start)"
        )
        if away <= LOOP_ERROR * size:
            text = f"{self.name}: the drive still changes from pass to pass within its limits"
        costs = self.on_limit == "auto" and away > ALLOWED_PART * size
        if costs or self.on_limit == "error":
            raise LimitError(f"{text}; `on_limit` clip writes it all the same")
        warn(text)
        return (text,)

    def _drive(
        self, before: Before, voltage: Floats, loss: Loss, settled: Settled
    ) -> Drive:
        """Let all rows pass the gate, and return them."""
        model, dt, count = self.model, self.dt, before.voltage.size
        self._admit(before.voltage, voltage)
        played = np.concatenate([before.voltage, voltage])
        run = model.run(played, before.begun, dt)
        period = dt * np.arange(voltage.size) if self.time is None else self.time
        time = np.concatenate([period[0] - dt * np.arange(count, 0.0, -1.0), period])
        outlook = Outlook(model, loss)
        outlook.see(before.voltage, dt, "lead")
        outlook.see(voltage, dt, "move")
        state = dataclasses.replace(run.state, time=float(time[-1]))
        known = isinstance(self.around.state, State)
        drive = outlook.drive(state, count * dt, known)
        settled_y = settled_run(model, voltage, dt, settled.before)
        away = float(np.sqrt(np.mean((run.y[count:] - settled_y) ** 2)))
        note = f"the first pass is {away:.3g}{model.output.suffix} off the settled one (RMS)"
        return dataclasses.replace(
            drive,
            time=time,
            desired=np.concatenate([before.desired, self.desired]),
            voltage=played,
            move=slice(count, count + voltage.size),
            notes=(f"{self.name}: {note}",),
        )

    def _admit(self, before: Floats, voltage: Floats) -> None:
        """Let the rows pass the gate: those before the period, the period, and its seam."""
        last = standing_at(self.model, self.limits, self.around)
        gate = Gate(self.limits, last)
        first = float(before[0]) if before.size else float(voltage[0])
        gate.require_reachable(first, first, self.dt)
        gate.admit(before, self.dt, "lead")
        gate.admit(voltage, self.dt)
        gate.admit(voltage[:1], self.dt)


def _rise(count: int, passes: int) -> Floats:
    """Return how much of a run-in's rows is the period: it fades in, during the first pass, from a rest."""
    first = soft_rise(np.arange(count) / count)
    return np.concatenate([first, np.ones(count * (passes - 1))])


def require_closed(name: str, period: Floats) -> None:
    """Refuse a period that is too short, or jumps from its last row to its first (InputError)."""
    if period.size < FEWEST_ROWS:
        raise InputError(
            f"{name}: {period.size} rows are no period of a loop (at least {FEWEST_ROWS})"
        )
    if not np.isfinite(period).all():
        raise InputError(f"{name}: a row of the period holds no number")
    seam = apart(period[:1], period[-1:])
    inside = apart(period[1:], period[:-1])
    if seam > SEAM * inside:
        raise InputError(
            f"{name}: the period does not close: from the last row, {period[-1]:.6g}, to the first, "
            f"{period[0]:.6g}, is a step of {seam:.3g} where the largest inside is {inside:.3g} (give one "
            "whole period, without its first row again at the end)"
        )
