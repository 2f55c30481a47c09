"""Live control: one sample at a time, forward in time only.

A control loop calls ``plan`` with what is wanted, hands the voltage to the hardware, and
calls ``commit`` once the hardware has acknowledged it. A plan that is never committed
leaves no trace. The values are those of ``compensate``.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import Literal, NamedTuple

import numpy as np

from dbo_cli.drive.gate import ROUNDING, GateError
from dbo_cli.drive.limits import Figure, Limits, voltage_in
from dbo_cli.errors import InputError, ModelError, UsageError
from dbo_cli.model import NEGLIGIBLE, Model, State, Stepper, Undoing, Window
from dbo_cli.model.points import inverse_curves, value_through

WANTED_SPANS = 1e12
"""A wanted value so many ranges away is no displacement but a fault of the loop."""
APPLIED_SPANS = 1e3
"""Likewise of an applied voltage."""


class Ahead(NamedTuple):
    """What is wanted from now on, and what undoing dynamics and delay remembers."""

    wanted: deque[float]
    undoing: Undoing | None


class Pending(NamedTuple):
    """A plan that may be committed.

    Attributes
    ----------
    voltage : float
        What was planned.
    ahead : Ahead, or None
        What is held after it.
    begun, after : State, or None
        The states before and after the first row; later ones are in the stepper.
    clipped : bool
        Whether a limit held it back.
    """

    voltage: float
    ahead: Ahead | None
    clipped: bool
    begun: State | None = None
    after: State | None = None


class Controller:
    """Drives an actuator sample by sample.

    Parameters
    ----------
    model : Model
        A forward model.
    sample_rate : float
        Samples a second (Hz).
    v_min, v_max, max_slew, extrapolate
        Limits, as of ``compensate``.
    state : State or name of a start
        What was before the first sample.
    from_ : float, optional
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
    clipped : int
        Committed samples that a limit held back.

    Raises
    ------
    ModelError
        The model needs ``lookahead``, or is an inverse.
    LimitError
        ``from_`` is outside the limits.
    UsageError
        The rate is not above 0, or ``lookahead`` is too short.
    """

    def __init__(
        self,
        model: Model,
        sample_rate: float,
        *,
        v_min: Figure = None,
        v_max: Figure = None,
        max_slew: Figure = None,
        extrapolate: bool = False,
        state: State | str = "auto",
        from_: float | None = None,
        lookahead: float | Literal["auto"] | None = None,
    ) -> None:
        model.require("forward")
        if not (isinstance(sample_rate, (int, float)) and 0.0 < sample_rate < math.inf):
            raise UsageError(
                f"`sample_rate` {sample_rate!r}: give a number of Hz above 0"
            )
        self.limits = Limits.within(model.input, v_min, v_max, max_slew, extrapolate)
        self.clipped = 0
        self._model = model
        self._dt = 1.0 / sample_rate
        self._step = (
            None
            if self.limits.slew is None
            else float(self.limits.largest_step(self._dt) or 0.0)
        )
        self._window = self.limits.window
        self._inverse = model.inverse()
        self._to_gears = self._inverse.head
        self._from_gears = self._inverse.tail
        self._back_to_gears = inverse_curves(self._from_gears)
        self._begin: State | str = state
        self._last: float | None = state.drive if isinstance(state, State) else None
        if from_ is not None:
            self._last = voltage_in("from_", from_, model.input)
            self.limits.require_start(self._last, "`from_`")
        elif self._last is not None:
            self.limits.require_start(self._last, "`state`")
        self._stepper: Stepper | None = None
        self._pending: Pending | None = None
        self._ahead: Ahead | None = None
        self.lookahead = self._samples_ahead(lookahead)

    def _samples_ahead(self, lookahead: float | Literal["auto"] | None) -> int:
        """Return how many samples what is wanted is read ahead."""
        needed = self._model.ahead(self._dt)
        if self._model.dynamics is None and self._model.delay is None:
            needed = 0
        elif lookahead is None:
            raise ModelError(
                "this model has a delay or dynamics, which only what is wanted later can undo"
                ' (`lookahead` "auto", and pass what is wanted that much later)'
            )
        if lookahead is None or lookahead == "auto":
            return needed
        samples = math.ceil(lookahead / self._dt - 1e-9)
        if samples < needed:
            raise UsageError(
                f"`lookahead` {lookahead:g} s is too short: this model needs {needed * self._dt:.6g} s"
            )
        return samples

    @property
    def last(self) -> float | None:
        """The voltage at which the amplifier stands; None before the first, if it is not known."""
        return self._last

    @property
    def state(self) -> State | None:
        """The state after the last sample committed, of gears and memories; None before the first."""
        if self._stepper is None:
            return self._begin if isinstance(self._begin, State) else None
        undoing = None if self._ahead is None else self._ahead.undoing
        return State(
            self._stepper.bits, self._stepper.memory, drive=self._last, undoing=undoing
        )

    def plan(self, wanted: float) -> float:
        """Return the voltage for what is wanted now (or ``lookahead`` later); nothing has changed yet.

        Raises
        ------
        InputError
            What is wanted is no number, or absurdly far away; nothing is left to commit.
        """
        self._pending = None
        value = _number(
            wanted,
            "wanted",
            self._model.output.min,
            self._model.output.max,
            WANTED_SPANS,
        )
        u, ahead = self._undone(value)
        if self._stepper is None:
            pending = self._planned_first(u, ahead)
        else:
            pending = self._planned(u, ahead, self._stepper)
        self._admit(pending.voltage)
        self._pending = pending
        return pending.voltage

    def commit(self, applied: float | None = None) -> None:
        """Go on: the hardware took the planned voltage, or ``applied`` in its place.

        Raises
        ------
        UsageError
            Nothing is planned.
        InputError
            ``applied`` is no number, or absurdly far away; nothing has moved.
        """
        pending = self._pending
        if pending is None:
            raise UsageError("`commit`: nothing is planned (`plan` comes first)")
        voltage = pending.voltage
        if applied is not None:
            low, high = self.limits.rating
            voltage = _number(applied, "applied", low, high, APPLIED_SPANS)
        if self._stepper is None:
            self._stepper = self._stepper_after(pending, voltage)
        else:
            if applied is not None:
                self._stepper.follow(value_through(self._back_to_gears, voltage))
            self._stepper.commit()
        self._last = voltage
        self._ahead = pending.ahead
        self.clipped += pending.clipped
        self._pending = None

    def step(self, wanted: float) -> float:
        """Plan and commit at once."""
        voltage = self.plan(wanted)
        self.commit()
        return voltage

    def _undone(self, wanted: float) -> tuple[float, Ahead | None]:
        """Return what the gears are to reach now, and what is held then."""
        if (
            not self.lookahead
            and self._model.dynamics is None
            and self._model.delay is None
        ):
            return wanted, None
        if self._ahead is None:
            held = deque([wanted] * (self.lookahead + 1), self.lookahead + 1)
            undoing = None
            if isinstance(self._begin, State):
                undoing = self._model.undoing_of(self._begin, self._dt)
        else:
            held = self._ahead.wanted.copy()
            held.append(wanted)
            undoing = self._ahead.undoing
        known = np.fromiter(held, np.float64, len(held))[
            : self._model.ahead(self._dt) + 1
        ]
        undone, undoing = self._model.undo(known, undoing, self._dt)
        return float(undone[0]), Ahead(held, undoing)

    def _planned_first(self, u: float, ahead: Ahead | None) -> Pending:
        """Plan the first row: the start is found for it."""
        begun = self._begun(u)
        if self._last is not None and self._is_outside(self._last):
            voltage = self._inwards(self._last)
            moved = self._model.static.run(np.array([voltage]), begun, self._dt)
            return Pending(voltage, ahead, True, begun, moved.state)
        done = self._model.drive(np.array([u]), begun, self._dt, self._window)
        return Pending(
            float(done.voltage[0]), ahead, bool(done.clipped), begun, done.state
        )

    def _begun(self, u: float) -> State:
        """Return the state before the first row."""
        begun = self._model.start_drive(u, self._begin, *self.limits.move)
        if self._last is None or isinstance(self._begin, State):
            return begun
        if (
            begun.first is not None
        ):  # a start that was chosen for the voltage at which the amplifier stands
            name = self._begin if isinstance(self._begin, str) else "auto"
            begun = self._model.static.start(self._last, name)
        return dataclasses.replace(begun, drive=self._last, first=None)

    def _stepper_after(self, pending: Pending, voltage: float) -> Stepper:
        """Return the stepper behind the first row."""
        begun, after = pending.begun, pending.after
        assert begun is not None and after is not None
        bits, memory = after.bits, after.memory
        if voltage != pending.voltage:
            moved = self._model.static.run(
                np.array([voltage]), dataclasses.replace(begun, first=None), self._dt
            )
            bits, memory = moved.state.bits, moved.state.memory
        inner = self._inverse.inner_window(self._window)
        gears = self._inverse.gears
        low, high = gears.y_range
        slack = NEGLIGIBLE * min(inner.high - inner.low, high - low)
        window = Window(inner.low, inner.high, inner.largest_step(self._dt), slack)
        last = value_through(self._back_to_gears, voltage)
        return Stepper(gears, bits, memory, last, self._dt, window)

    def _planned(self, u: float, ahead: Ahead | None, stepper: Stepper) -> Pending:
        """Plan a row behind another one."""
        assert self._last is not None
        if self._is_outside(self._last):
            voltage = self._inwards(self._last)
            stepper.follow(value_through(self._back_to_gears, voltage))
            return Pending(voltage, ahead, True)
        y = stepper.plan(value_through(self._to_gears, u))
        clipped = stepper.clipped
        voltage = y
        if self._from_gears:
            low, high = self.limits.move
            voltage = min(max(value_through(self._from_gears, y), low), high)
        return Pending(voltage, ahead, clipped)

    def _is_outside(self, voltage: float) -> bool:
        """Tell whether a voltage lies outside the range of a move."""
        low, high = self.limits.move
        return not low <= voltage <= high

    def _inwards(self, last: float) -> float:
        """Return the next voltage on the way in from where the amplifier stands."""
        low, high = self.limits.move
        near = low if last < low else high
        if self._step is None or abs(near - last) <= self._step:
            return near
        return last + math.copysign(self._step, near - last)

    def _admit(self, voltage: float) -> None:
        """Let a voltage pass as the gate does: range and slew, or inwards from outside."""
        low, high = self.limits.move
        last = self._last
        inside = low <= voltage <= high
        slow = True
        if last is not None:
            digits = ROUNDING * max(abs(voltage), abs(last))
            slow = self._step is None or abs(voltage - last) <= self._step + digits
            inwards = (last > high and high <= voltage < last) or (
                last < low and last < voltage <= low
            )
            inside = inside or inwards
        if not (inside and slow):
            raise GateError(
                f"this program computed {voltage!r} after {last!r}: beyond its limits (please report it)"
            )


def _number(value: float, name: str, low: float, high: float, spans: float) -> float:
    """Return a value as a float; InputError where it is no number, or so many ranges away."""
    if type(value) is not float:
        if isinstance(value, (bool, np.bool_, str, bytes)):
            raise InputError(f"`{name}` {value!r}: not a number")
        try:
            value = float(value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"`{name}` {value!r}: not a number") from None
    far = spans * (high - low)
    if not low - far <= value <= high + far:  # NaN as well
        raise InputError(
            f"`{name}` {value!r}: no value near the range, {low:.6g} to {high:.6g}"
        )
    return value
