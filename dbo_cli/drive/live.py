"""Live control: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage to the hardware, and
calls ``commit`` once the hardware has acknowledged it. A plan that is never committed
leaves no trace. The values are those of ``compensate``.
"""

import contextlib
import dataclasses
import math
from typing import Any, Literal

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.lead import Lead
from dbo_cli.drive.limits import STEP_ROUNDING, GateError, Limits
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import Cascade, State, Undoing
from dbo_cli.model.amplifier import Reach
from dbo_cli.units import Typed

WANTED_SPANS = 1e12
"""A wanted value so many ranges away is no displacement but a fault of the loop."""
APPLIED_SPANS = 1e3
"""Likewise of an applied voltage."""


# a planned sample: voltage, whether a limit held it, the amplifier's output, what is
# wanted from now on, and what undoing remembers; a plain tuple, since a record takes time
Planned = tuple[float, bool, float, Floats | None, Undoing | None]


class Controller:
    """Drives an actuator sample by sample.

    Parameters
    ----------
    model : Cascade
        A forward model.
    sample_rate : float
        Samples a second (Hz), above 0.
    limits : Limits
        What the drive may do.
    state : State, or name of a start
        What was before the first sample.
    from_ : float or str, optional
        Where the amplifier stands; a slew limit then holds for the first sample, too.
    lookahead : float or "auto", optional
        Seconds by which what is passed is wanted later: a model with dynamics or a delay
        needs it. auto: the shortest time that does. Before the first value the same
        value holds.

    Attributes
    ----------
    lookahead : int
        That time in samples.
    limits : Limits
        What the drive may do.
    last : float or None
        The voltage at which the amplifier stands; None before the first, if it is not
        known.
    clipped : int
        Committed samples that a limit held back.

    Raises
    ------
    ModelError
        The model is an inverse.
    LimitError
        ``from_`` is outside the limits.
    UsageError
        ``lookahead`` is missing or too short.
    """

    def __init__(
        self,
        model: Cascade,
        sample_rate: float,
        limits: Limits,
        *,
        state: State | str = "auto",
        from_: Typed | None = None,
        lookahead: float | Literal["auto"] | None = None,
    ) -> None:
        self.limits = limits
        self.clipped = 0
        self._model = model
        self._dt = 1.0 / sample_rate
        step = self.limits.largest_step(self._dt)
        self._step = math.inf if step is None else float(step)
        lead = Lead(model, limits, state, from_)
        self.last = lead.standing
        self._begin, *_ = lead.planned(0.0, self._dt, None)
        self._stepper: Any = None
        self._plan: Planned | None = None  # and not committed yet
        # of a first row: the state before it, and that behind it, of an amplifier
        self._first: State | None = None
        self._first_run: State | None = None
        self._output = 0.0  # of the amplifier, now
        if model.amplifier is not None:
            self._share = float(model.amplifier.share(self._dt)[0])
        self._inverter = model.inverter(self._dt)
        needed = self.lookahead = self._inverter.ahead
        if lookahead != "auto":
            self.lookahead = math.ceil((lookahead or 0.0) / self._dt - 1e-9)
        if self.lookahead < needed:
            raise UsageError(
                f"`lookahead` {lookahead}: this model needs {needed * self._dt:.6g} s: give them, or "
                '"auto", and plan that far ahead'
            )
        self._queue: Floats | None = None
        self._memory: Undoing | None = None
        if isinstance(self._begin, State):
            self._memory = self._inverter.behind(self._begin)

    @property
    def state(self) -> State | None:
        """The state after the last sample committed, of gears and memories; None before the first."""
        if self._stepper is None:
            return self._begin if isinstance(self._begin, State) else None
        return dataclasses.replace(
            self._model.gears.committed(self._stepper),
            drive=self.last,
            undoing=self._memory,
            model=self._model.digest,
            amplifier=None if self._model.amplifier is None else self._output,
        )

    def plan(self, wanted: float) -> float:
        """Return the voltage for what is wanted now (or ``lookahead`` later); nothing has changed yet.

        Raises
        ------
        InputError
            What is wanted is no number, or absurdly far away; nothing is left to commit.
        """
        self._plan = None
        reach = self._model.output
        value = _number(wanted, "wanted", reach.min, reach.max, WANTED_SPANS)
        target, queue, memory = self._undone(value)
        voltage, clipped, output = self._way_in(), True, 0.0
        if self._stepper is None:
            self._first_run = None
            (low, high), slew = self.limits.move, self.limits.slew
            start = self._model.start_drive(target, self._begin, low, high)
            if voltage is None:
                row = np.array([target])
                run = self._model.drive(row, start, self._dt, (low, high), slew)
                voltage, clipped = float(run.y[0]), bool(run.clipped)
                if self._model.amplifier is not None:
                    self._first_run = run.state
            self._first = start
        elif voltage is None:
            voltage, clipped, output = self._planned(target)
        else:
            output = self._follow(voltage)
        self._admit(voltage)
        self._plan = voltage, clipped, output, queue, memory
        return voltage

    def commit(self, applied: float | None = None) -> None:
        """Go on: the hardware took the planned voltage, or ``applied`` in its place.

        Raises
        ------
        UsageError
            Nothing is planned.
        InputError
            ``applied`` is no number, or absurdly far away; nothing has moved.
        """
        if self._plan is None:
            raise UsageError("`commit`: nothing is planned (`plan` comes first)")
        voltage, clipped, output, queue, memory = self._plan
        if applied is not None:
            voltage = _number(applied, "applied", *self.limits.rating, APPLIED_SPANS)
            self._first_run = None
        if self._stepper is None:
            output = self._set_out(voltage)
        else:
            if applied is not None:
                output = self._follow(voltage)
            self._stepper.commit()
        self.last, self._output = voltage, output
        self._queue, self._memory = queue, memory
        self.clipped += clipped
        self._plan = None

    def _set_out(self, voltage: float) -> float:
        """Commit the first voltage; return what comes out of the amplifier."""
        model, state = self._model, self._first_run
        if state is None:
            assert self._first is not None
            state = model.static.run(np.array([voltage]), self._first, self._dt).state
        window, slew = model.inner_limits(self.limits.move, self.limits.slew)
        at_gears = dataclasses.replace(state, drive=model.head.value(voltage))
        self._stepper = model.gears.stepper(at_gears, self._dt, window, slew)
        return state.amplifier or 0.0

    def step(self, wanted: float) -> float:
        """Plan and commit at once."""
        voltage = self.plan(wanted)
        self.commit()
        return voltage

    def _undone(self, desired: float) -> tuple[float, Floats | None, Undoing | None]:
        """Return what the gears are to reach now, what is wanted from now on, and what undoing remembers."""
        if not self.lookahead and self._inverter.dynamics is None:
            return desired, None, None
        if self._queue is None:
            queue = np.full(self.lookahead + 1, desired)
        else:
            queue = np.empty(self.lookahead + 1)
            queue[:-1] = self._queue[1:]
            queue[-1] = desired
        ahead = queue[: self._inverter.ahead + 1]
        target, memory = self._inverter.run(ahead, self._memory)
        return float(target[0]), queue, memory

    def _follow(self, voltage: float) -> float:
        """Plan a voltage that was not asked of the gears; return what comes out of the amplifier."""
        output = 0.0
        if self._model.amplifier is not None:
            before = State(amplifier=self._output)
            block = np.array([voltage])
            run = self._model.amplifier.run(block, before, self._dt)
            voltage = output = float(run.y[0])
        self._stepper.follow(self._model.head.value(voltage))
        return output

    def _planned(self, target: float) -> tuple[float, bool, float]:
        """Return the voltage of a later row, whether a limit held it, and the amplifier's output."""
        stepper, model = self._stepper, self._model
        at_gears = model.tail.inverse.value(target)
        if model.amplifier is None:
            voltage, output = stepper.plan(at_gears), 0.0
            if model.head:
                low, high = self.limits.move
                voltage = min(max(model.head.inverse.value(voltage), low), high)
            return voltage, bool(stepper.clipped), output
        (low, high), last = self.limits.move, self.last
        assert last is not None
        low, high = max(low, last - self._step), min(high, last + self._step)
        reach = Reach(model.head, self._output, self._share, low, high)
        low, high = reach.window
        stepper.limit(low, high, model.gears.slack(low, high))
        voltage, output = reach.drive(stepper.plan(at_gears))
        return voltage, bool(stepper.clipped), output

    def _way_in(self) -> float | None:
        """Return the next voltage from outside the range of a move; None where the amplifier is inside."""
        low, high = self.limits.move
        last = self.last
        if last is None or low <= last <= high:
            return None
        end = low if last < low else high
        if abs(end - last) <= self._step:
            return end
        return last + math.copysign(self._step, end - last)

    def _admit(self, voltage: float) -> None:
        """Let a voltage pass as the gate does: range and slew, or inwards from outside."""
        low, high = self.limits.move
        last = self.last
        inside, slow = low <= voltage <= high, True
        if last is not None:
            digits = STEP_ROUNDING * max(abs(voltage), abs(last))
            slow = abs(voltage - last) <= self._step + digits
            inside = inside or high <= voltage < last or last < voltage <= low
        if not (inside and slow):
            raise GateError(
                f"internal error: {voltage} after {last} breaks the limits (please report it)"
            )


def _number(value: float, name: str, low: float, high: float, spans: float) -> float:
    """Return a value as a float; InputError where it is not a number, or too many ranges away."""
    number = math.nan
    if type(value) is float:
        number = value
    elif not isinstance(value, (bool, np.bool_, str, bytes)):
        with contextlib.suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    far = spans * (high - low)
    if not low - far <= number <= high + far:  # NaN as well
        raise InputError(
            f"`{name}` {value!r}: give a number near the range, {low:.6g} to {high:.6g}"
        )
    return number
