"""A move that is looped: one period in, the settled drive out, and a run-in before it.

What stands before the period is made of the settled drive itself: a ramp to its first row, or a
first pass in which it grows from where the amplifier stands, then whole passes of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.drive import Drive
from dbo_cli.drive.gate import Gate
from dbo_cli.drive.lead import MOST_ROWS, Around, ramp, standing_at
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loss import ALLOWED_PART, Loss, OnLimit
from dbo_cli.drive.outlook import Outlook
from dbo_cli.drive.settled import (
    Settled,
    apart,
    looped_state,
    settled_drive,
    settled_run,
)
from dbo_cli.drive.swings import soft_rise
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.model import Model, State

Floats = NDArray[np.float64]
NOTHING = np.zeros(0)

# of the drive's range: drives that agree to this are one; far above rounding
SAME_DRIVE = 1e-9
# tries for a start or a run-in that leads to the loop it ends on; two are usual
MOST_STARTS = 20
# of the move: a loop that the model repeats further off than this is not settled
LOOP_ERROR = 1e-6
FEWEST_ROWS = 4  # of a period: fewer have no shape
# times the largest step inside a period, from which on its last row does not meet its first
SEAM = 3.0


class Before(NamedTuple):
    """The voltages before a period, and the state in which they begin."""

    voltage: Floats
    begun: State


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
        Seconds of each row.
    dt
        Seconds a row.
    limits, around, on_limit, name
        As in ``plan``.
    """

    model: Model
    desired: Floats
    request: Floats
    time: Floats
    dt: float
    limits: Limits
    around: Around
    on_limit: OnLimit
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
        if passes < 0:
            raise UsageError(f"`passes` {passes}: give a whole number of passes")
        if passes * self.desired.size > MOST_ROWS:
            raise UsageError(f"`passes` {passes}: at most {MOST_ROWS:,} rows in all")
        around = self.around
        if around.condition or around.lead or around.return_to is not None:
            raise UsageError(
                "`periodic` excludes `condition`, `lead` and `return`: use `passes` N"
            )
        require_closed(self.name, self.request)
        undone = self.model.inverter(self.dt).loop(self.request)
        before, settled, voltage = self._led_to(undone, passes)
        loss = Loss(self.model, self.limits, self.on_limit, self.name)
        loss.see(self.desired, undone, settled.run, settled.before, self.dt)
        loss.require_little(self.dt * self.desired.size)
        warnings = self._require_settled(settled, undone, before)
        drive = self._drive(before, voltage, loss, settled)
        return replace(drive, warnings=(*warnings, *drive.warnings))

    # --- what stands before the period ---

    def _start(self, voltage: float) -> State:
        """Return the state in which the actuator starts, at a voltage where none is known."""
        state = self.around.state
        return state if isinstance(state, State) else self.model.start(voltage, state)

    def _led_to(self, undone: Floats, passes: int) -> tuple[Before, Settled, Floats]:
        """Return the rows before the period, the settled loop to which they lead, and its drive.

        The loop depends on the state in which it begins, and what stands before it on
        the loop: both are found by turns.
        """
        model, limits = self.model, self.limits
        begin = standing_at(limits, self.around)
        if begin is not None:
            state = self._start(begin)
        elif self.around.approach is not None:
            raise UsageError("`approach` needs `from` VOLT or a `state` file")
        else:
            name = self.around.state
            state = model.start_drive(float(undone[0]), name, *limits.move)
            if passes:
                begin = state.drive if state.first is None else state.first
        settled = settled_drive(model, undone, self.dt, state, limits.window)
        for _ in range(MOST_STARTS):
            voltage = self._closed(settled.run.y)
            before = self._before(voltage, begin, passes)
            led = before, settled, voltage
            state = model.run(before.voltage, before.begun, self.dt).state
            settled = settled_drive(model, undone, self.dt, state, limits.window)
            if apart(settled.run.y, led[1].run.y) <= SAME_DRIVE * model.input.span:
                break
        return led

    def _before(self, period: Floats, begin: float | None, passes: int) -> Before:
        """Return what leads to a period: a ramp, or a pass in which it grows, then whole passes of it.

        ``begin`` is where the amplifier stands; None: at the first row of the period.
        """
        if begin is None:
            begin = float(period[0])
        approach, dt, limits = self.around.approach, self.dt, self.limits
        voltage = NOTHING
        if approach is not None:
            ascent = ramp("approach", begin, float(period[0]), dt, approach, limits)
            voltage = np.concatenate([[begin], ascent, np.tile(period, passes)])
        elif passes:
            rise = soft_rise(np.linspace(0.0, 1.0, period.size))
            growing = begin + rise * (period - begin)
            growing = np.clip(growing, *limits.rating)  # rounding
            voltage = np.concatenate([growing, np.tile(period, passes - 1)])
            voltage = self._within_slew(voltage, begin)
            off = abs(float(voltage[-1] - period[-1]))
            if off > 0.0:
                raise LimitError(
                    f"{self.name}: the run-in ends {off:.3g}{limits.suffix} off the settled loop: raise "
                    "`passes` or `max_slew`"
                )
        return Before(voltage, self._start(begin))

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
                f"{self.name}: `max_slew` forbids the step from the last row, {voltage[-1]:.6g}, to the "
                f"first, {voltage[0]:.6g}"
            )
        return closed

    def _within_slew(self, voltage: Floats, last: float) -> Floats:
        """Return a drive whose rows follow ``last`` and one another within the slew limit."""
        most = self.limits.largest_step(self.dt)
        if most is None or (np.abs(np.diff(voltage, prepend=last)) <= most).all():
            return voltage
        most *= 1.0 - 1e-15
        values = voltage.tolist()
        for k, value in enumerate(values):
            last = values[k] = min(max(value, last - most), last + most)
        return np.array(values)

    def _require_settled(
        self, settled: Settled, undone: Floats, before: Before
    ) -> tuple[str, ...]:
        """Warn of a loop that the model does not repeat, or refuse it where it costs too much."""
        model, dt = self.model, self.dt
        static, period = model.static, settled.run.y
        size = max(float(np.ptp(undone)), LOOP_ERROR * model.output.span)
        state = static.run(before.voltage, before.begun, dt).state
        looped = looped_state(model, period, dt, state)
        aim = static.run(period, settled.before, dt).y
        away = apart(static.run(period, looped, dt).y, aim)
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
            raise LimitError(f"{text}; `on_limit` clip writes it anyway")
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
        earlier = self.time[0] - dt * np.arange(count, 0.0, -1.0)
        outlook = Outlook(loss)
        outlook.see(before.voltage, dt, "lead")
        outlook.see(voltage, dt, "move")
        state = replace(run.state, time=float(self.time[-1]))
        drive = outlook.drive(state, count * dt, self.around.past_known)
        settled_y = settled_run(model, voltage, dt, settled.before)
        away = float(np.sqrt(np.mean((run.y[count:] - settled_y) ** 2)))
        note = f"the first pass is {away:.3g}{model.output.suffix} off the settled one (RMS)"
        return replace(
            drive,
            time=np.concatenate([earlier, self.time]),
            desired=np.concatenate([run.y[:count], self.desired]),
            voltage=played,
            move=slice(count, count + voltage.size),
            notes=(f"{self.name}: {note}",),
        )

    def _admit(self, before: Floats, voltage: Floats) -> None:
        """Let the rows pass the gate: those before the period, the period, and its seam."""
        gate = Gate(self.limits, standing_at(self.limits, self.around))
        first = float(before[0]) if before.size else float(voltage[0])
        gate.require_reachable(first, first, self.dt)
        gate.admit(before, self.dt, "lead")
        gate.admit(voltage, self.dt)
        gate.admit(voltage[:1], self.dt)


def require_closed(name: str, period: Floats) -> None:
    """Refuse a period that is too short, or jumps from its last row to its first (InputError)."""
    if period.size < FEWEST_ROWS:
        raise InputError(
            f"{name}: {period.size} rows are too few for a loop; give {FEWEST_ROWS} or more"
        )
    if not np.isfinite(period).all():
        raise InputError(f"{name}: one row of the period holds no number")
    seam = apart(period[:1], period[-1:])
    inside = apart(period[1:], period[:-1])
    if seam > SEAM * inside:
        raise InputError(
            f"{name}: the loop is open: its seam is a step of {seam:.3g}, the largest inside "
            f"{inside:.3g}: give one whole period"
        )
