"""The model of an actuator: a cascade of stages, its inverse, its states, simulation and drive.

displacement = Y0 + K S(Gamma(v - X0)): Gamma the gears, S points, K and Y0 a scale.
Dynamics stand behind them, and a delay last, on the output. Beyond the paper, points may
also stand before the gears: an asymmetry that acts on the drive. The inverse (17)-(18)
inverts every stage and reverses their order; started in the same state, model and
inverse compose to the identity, to rounding.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.cascade import Direction, Stage, check_order, digest_of, turned
from dbo_cli.model.delay import BEFORE, Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.gears import Gears, GearsRun, Window, joined
from dbo_cli.model.points import (
    Curves,
    Points,
    Scale,
    inverse_curves,
    through,
    value_through,
)
from dbo_cli.model.start import Starts, require_start
from dbo_cli.model.state import (
    NEGLIGIBLE,
    Driven,
    OutsideError,
    Quantity,
    Run,
    State,
    VoltageWindow,
    steps_of,
)
from dbo_cli.model.undoing import Inverter, Undoing

Floats = NDArray[np.float64]
Steps = (
    float | Floats | None
)  # seconds since the sample before: one number, or one each
Outside = Literal["extend", "hold", "error"]
Sign = Literal["rising", "falling"]

MOST_CANDIDATES = 5
_TIME_IS_NEEDED = (
    "this model depends on time, and there is none (`time` COLUMN or `sample_rate` HZ)"
)


@dataclass(frozen=True)
class Candidate:
    """Another model that explains the logs: its weight, and its stages as of a forward model."""

    weight: float
    stages: tuple[Stage, ...]

    def __post_init__(self) -> None:
        """Refuse a weight that is not above 0, and stages that are no model."""
        if not (math.isfinite(self.weight) and self.weight > 0.0):
            raise ModelError(
                f"weight: {self.weight!r} is not a finite number greater than 0"
            )
        check_order(self.stages, "forward")


@dataclass(frozen=True, eq=False)
class Model:
    """A cascade of stages from voltage to displacement (forward) or back (inverse).

    Parameters
    ----------
    direction : {"forward", "inverse"}
        Forward: one stage of gears, points and scales around it, then dynamics and a
        delay, each once at most. Inverse: the mirror image.
    input, output : Quantity
        What goes in and comes out; the output's range is what the model reaches slowly.
    stages : tuple of Gears, Points, Scale, Dynamics or Delay
        The cascade, in the order a signal passes it.
    fit : mapping
        Figures of the identification.
    candidates : tuple of Candidate
        At most five other models that explain the logs, for the error of a very move.
    provenance : mapping
        Where the model comes from; carried along.

    Raises
    ------
    ModelError
        The cascade is not of that form; the message begins with the key.
    """

    direction: Direction
    input: Quantity
    output: Quantity
    stages: tuple[Stage, ...]
    fit: Mapping[str, Any] = field(default_factory=dict)
    candidates: tuple[Candidate, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the cascade; the direction tells on which side of the gears the drive is."""
        object.__setattr__(self, "stages", turned(self.stages, self.direction))
        object.__setattr__(self, "candidates", tuple(self.candidates))
        check_order(self.stages, self.direction)
        if len(self.candidates) > MOST_CANDIDATES:
            raise ModelError(
                f"candidates: {len(self.candidates)} are more than {MOST_CANDIDATES}"
            )

    # ---- what it is made of ----

    @property
    def is_forward(self) -> bool:
        """Whether the voltage goes in, and the displacement comes out."""
        return self.direction == "forward"

    @functools.cached_property
    def _gears_place(self) -> int:
        return next(k for k, part in enumerate(self.stages) if isinstance(part, Gears))

    @functools.cached_property
    def gears(self) -> Gears:
        """The gears as they stand in this model."""
        gears = self.stages[self._gears_place]
        assert isinstance(gears, Gears)
        return gears

    @functools.cached_property
    def head(self) -> Curves:
        """The points and scales before the gears."""
        return _curves(self.stages[: self._gears_place])

    @functools.cached_property
    def tail(self) -> Curves:
        """The points and scales behind the gears."""
        return _curves(self.stages[self._gears_place :])

    @functools.cached_property
    def dynamics(self) -> Dynamics | None:
        """The dynamics, where there are any."""
        for stage in self.stages:
            if isinstance(stage, Dynamics):
                return stage
        return None

    @functools.cached_property
    def delay(self) -> Delay | None:
        """The delay as it stands in this model; None where it is 0."""
        for stage in self.stages:
            if isinstance(stage, Delay) and stage.seconds != 0.0:
                return stage
        return None

    @property
    def delay_seconds(self) -> float:
        """Seconds by which the output lags; an inverse model must read its input that far ahead."""
        if self.delay is None:
            return 0.0
        return abs(self.delay.seconds)

    @property
    def drive_quantity(self) -> Quantity:
        """The voltages that the model covers: what goes into it, or comes out of an inverse."""
        if self.is_forward:
            return self.input
        return self.output

    @property
    def sign(self) -> Sign:
        """Whether the displacement rises or falls as the voltage rises."""
        gains = [stage.gain for stage in self.stages if isinstance(stage, Scale)]
        if math.prod(math.copysign(1.0, gain) for gain in gains) < 0.0:
            return "falling"
        return "rising"

    @property
    def needs_time(self) -> bool:
        """Whether the time between samples matters."""
        return (
            self.gears.relaxation is not None
            or self.dynamics is not None
            or self.delay is not None
        )

    @functools.cached_property
    def digest(self) -> str:
        """A name for everything a state refers to: equal for a model and its inverse."""
        return digest_of(self.forward().stages)

    def require(self, direction: Direction, name: str = "the model") -> None:
        """Raise ModelError, with the remedy, where the model is of the other direction."""
        if self.direction == direction:
            return
        raise ModelError(
            f"{name}: the model is {self.direction}, but a model of direction {direction} is needed"
            " (dbo invert turns it)"
        )

    # ---- other models made of it ----

    def inverse(self) -> Model:
        """Return the inverse model (17)-(18): every stage inverted, the order reversed."""
        return self._inverse

    @functools.cached_property
    def _inverse(self) -> Model:
        direction: Direction = "inverse" if self.is_forward else "forward"
        stages = tuple(stage.inverse() for stage in reversed(self.stages))
        return Model(
            direction,
            self.output,
            self.input,
            stages,
            self.fit,
            provenance=self.provenance,
        )

    def forward(self) -> Model:
        """Return the forward model: itself, or its inverse."""
        if self.is_forward:
            return self
        return self.inverse()

    @functools.cached_property
    def static(self) -> Model:
        """The same model without dynamics and delay: gears, relaxation and curves."""
        if self.dynamics is None and self.delay is None:
            return self
        kept = [
            stage for stage in self.stages if isinstance(stage, Gears | Points | Scale)
        ]
        return self.with_stages(tuple(kept))

    def with_stages(self, stages: tuple[Stage, ...]) -> Model:
        """Return a model of the same quantities with other stages, without candidates."""
        return replace(self, stages=stages, candidates=())

    def candidate_models(self) -> list[tuple[float, Model]]:
        """Return weight and model of every candidate; ModelError for an inverse model."""
        self.require("forward")
        return [
            (part.weight, self.with_stages(part.stages)) for part in self.candidates
        ]

    # ---- starts ----

    @functools.cached_property
    def _starts(self) -> Starts:
        """The starts of a forward model; gears may go on beyond its input range."""
        return Starts(self.gears, *self._to_gears(self.input.min, self.input.max))

    def start(self, first_input: float, name: str = "auto") -> State:
        """Return the state before the first sample; see ``start.py``.

        Of an inverse model the voltage is sought whose own start leads to the first
        displacement, so that the forward model, driven by the output, starts alike.

        Raises
        ------
        ModelError
            There is no start of that name.
        """
        if not self.is_forward:
            return self.inverse().start_drive(first_input, name)
        value = value_through(self.head, float(first_input))
        return State(self._starts.bits(value, name))

    def start_drive(
        self,
        first: float,
        state: str | State = "auto",
        low: float = -math.inf,
        high: float = math.inf,
    ) -> State:
        """Return the state of ``drive`` in which ``run`` of its output starts.

        Parameters
        ----------
        first : float
            The first displacement that the static part is to reach (after ``undo``).
        state : State or name of a start
            An actuator that starts ``empty`` or ``full`` stands at that end of the
            drive's range, so a slew limit holds from the first row on.
        low, high : float
            Where the first voltage may be.
        """
        self.require("forward")
        if isinstance(state, State):
            return state
        require_start(state)
        ends = self._to_gears(low, high)
        if state in ("empty", "full"):
            at_end = self._starts.ends[1 if state == "full" else 0]
            voltage = self._from_gears(min(max(at_end, ends[0]), ends[1]))
            return State(
                self._starts.bits(at_end, state),
                drive=min(max(voltage, low), high),
            )
        wanted = value_through(self._tail_inverse, float(first))
        inner = self._starts.voltage(wanted, *ends)
        voltage = min(max(self._from_gears(inner), low), high)
        bits = self._starts.bits(value_through(self.head, voltage))
        return State(bits, first=voltage)

    # ---- simulation ----

    def simulate(
        self,
        x: ArrayLike,
        time: ArrayLike | None = None,
        dt: Steps = None,
        state: str | State = "auto",
        outside: Outside = "extend",
    ) -> tuple[Floats, State]:
        """Return the output for a whole signal, and the state after it.

        Parameters
        ----------
        x : array_like
            The input. An inverse model reads it ahead where it has dynamics or a delay;
            beyond its end the last value holds.
        time : array_like, optional
            Time stamps (s); or
        dt : float or array, optional
            Seconds since the sample before. One of the two is needed with relaxation,
            dynamics or a delay.
        state : State or name of a start
            Before the first sample.
        outside : {"extend", "hold", "error"}
            Beyond the range: go on with the last slope, hold, or raise OutsideError.

        Raises
        ------
        InputError
            Time goes backwards, or is not even where it must be.
        ModelError
            The time between samples is needed and not given.
        """
        signal = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        if dt is None and time is not None:
            dt = steps_of(time)
        undoing = None
        if not self.is_forward and signal.size:
            if isinstance(state, State):
                undoing = self.undoing_of(state, dt)
            ahead = np.full(self.ahead(dt), signal[-1])
            known = np.concatenate([signal, ahead])
            signal, undoing = self.undo(known, undoing, dt)
        if not isinstance(state, State):
            first = float(signal[0]) if signal.size else 0.0
            state = self.start(first, state)
        done = self.run(signal, state, dt, outside)
        if undoing is None:
            return done.y, done.state
        return done.y, replace(done.state, undoing=undoing)

    def run(
        self, x: ArrayLike, state: State, dt: Steps = None, outside: Outside = "extend"
    ) -> Run:
        """Return the output for one block; cut a signal as you like, the values stay the same.

        Of an inverse model this is the part without dynamics and delay: ``undo`` comes
        first. ``dt`` and errors are as of ``simulate``; the first one of a state that
        has just been started does not matter.
        """
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        steps = self._steps(dt, x.size, state)
        if not self.is_forward:
            done = self._drive_block(x, state, steps, None, outside)
            y, after = done.voltage, done.state
            count, first = done.outside, done.first_outside
        else:
            y, after, count, first = self._forward_block(x, state, steps, outside)
        if outside == "error" and count:
            raise OutsideError(first, float(x[first]), *self._covered)
        return Run(y, after, count, first)

    def _forward_block(
        self, x: Floats, state: State, steps: Steps, outside: Outside
    ) -> tuple[Floats, State, int, int]:
        """Return a block of a forward model, the state after it, and what lies outside."""
        if x.size == 0:
            return x, state, 0, 0
        inner = through(self.head, x)
        if outside == "hold" and self._starts.some_are_spare:
            inner = np.clip(inner, *self._starts.ends)
        done = self._gears_block(self.gears, inner, state, steps, outside != "hold")
        y = through(self.tail, done.y)
        sections, held = state.sections, state.delay
        if self.dynamics is not None:
            y, sections = self.dynamics.run(y, _needed(steps), sections)
        if self.delay is not None:
            y, held = self.delay.run(y, _needed(steps), held)
        after = State(
            done.bits, done.memory, float(x[-1]), sections=sections, delay=held
        )
        return y, after, *self._outside(x, done)

    def _gears_block(
        self,
        gears: Gears,
        x: Floats,
        state: State,
        steps: Steps,
        extend: bool,
        window: Window | None = None,
        last: float | None = None,
    ) -> GearsRun:
        """Run the gears over a block."""
        decay = None
        if gears.relaxation is not None:
            decay = gears.relaxation.decay(_needed(steps))
        return gears.run(
            x, state.bits, state.memory, decay, extend=extend, window=window, last=last
        )

    def _steps(self, dt: Steps, count: int, state: State) -> Steps:
        """Return the time steps, checked; the first of a state that has just been started becomes 0."""
        if dt is None:
            if self.needs_time:
                raise ModelError(_TIME_IS_NEEDED)
            return None
        if not isinstance(dt, np.ndarray):
            return float(dt)
        if dt.shape != (count,):
            raise ModelError(f"{dt.size} time steps for {count} samples")
        begun = state.drive is not None or state.delay or state.sections
        if count and not begun:
            dt = dt.copy()
            dt[0] = 0.0
        return dt

    @functools.cached_property
    def _covered(self) -> tuple[float, float]:
        """The range of this model's input: what it was identified on, or less where its gears end."""
        low, high = self.input.min, self.input.max
        if not self.is_forward:
            return low, high
        ends = [self._from_gears(end) for end in self.gears.x_range]
        return max(low, min(ends)), min(high, max(ends))

    def _outside(self, x: Floats, done: GearsRun) -> tuple[int, int]:
        """Return how many samples lie outside the model's range, and the first of them."""
        low, high = self._covered
        slack = NEGLIGIBLE * self.input.span
        low, high = low - slack, high + slack
        if x.min() >= low and x.max() <= high:
            return done.outside, done.first_outside
        beyond = np.flatnonzero((x < low) | (x > high))
        first = int(beyond[0])
        if done.outside:
            first = min(first, done.first_outside)
        return max(beyond.size, done.outside), first

    # ---- drive ----

    def ahead(self, dt: Steps) -> int:
        """Return how many rows beyond a block ``undo`` needs; 0 without dynamics and delay.

        Raises
        ------
        InputError
            The clock is not even, or does not resolve the dynamics.
        """
        if self.dynamics is None and self.delay is None:
            return 0
        step = _even(dt)
        rows = 0
        if self.delay is not None:
            rows += self.delay.rows_ahead(step)
        if self.dynamics is not None:
            rows += _inverter(self.dynamics, step).ahead
        return rows

    def undo(
        self, wanted: Floats, undoing: Undoing | None, dt: Steps
    ) -> tuple[Floats, Undoing | None]:
        """Return what the static part must reach for a wanted displacement, and what comes next goes on from.

        Parameters
        ----------
        wanted : array
            A block and ``ahead(dt)`` rows of what follows it.
        undoing : Undoing, or None
            From the block before, or ``undoing_of``; None: at rest at the first value.
        dt : float
            Seconds between samples.
        """
        if self.dynamics is None and self.delay is None:
            return wanted, None
        step = _even(dt)
        count = wanted.size - self.ahead(step)
        if undoing is not None and undoing.dt != step:
            undoing = None
        past = () if undoing is None else undoing.past
        signal = wanted
        if self.delay is not None:
            signal = self.delay.read_ahead(wanted, step, past)
            past = (*past, *wanted[max(count - BEFORE, 0) : count].tolist())[-BEFORE:]
        memory = () if undoing is None else undoing.sections
        if self.dynamics is not None:
            inverter = _inverter(self.dynamics, step)
            if not memory:
                memory = inverter.rest(float(signal[0]))
            signal, memory = inverter.run(signal, memory)
        return signal, Undoing(step, memory, past)

    def undoing_of(self, state: State, dt: Steps) -> Undoing | None:
        """Return what ``undo`` goes on from behind a state; None where nothing is known of it."""
        if self.dynamics is None and self.delay is None:
            return None
        step = _even(dt)
        if state.undoing is not None and state.undoing.dt == step:
            return state.undoing
        if self.dynamics is None or state.sections is None:
            return None
        return Undoing(step, _inverter(self.dynamics, step).memory_of(state.sections))

    def undo_loop(self, wanted: Floats, dt: float) -> Floats:
        """Return what ``undo`` does, for one period of a displacement that repeats for ever."""
        signal = wanted
        if self.delay is not None:
            signal = self.delay.early_loop(signal, dt)
        if self.dynamics is not None:
            signal = _inverter(self.dynamics, dt).loop(signal)
        return signal

    def follow_loop(self, y: Floats, dt: float) -> Floats:
        """Return the displacement behind dynamics and delay, for one period of a static one that repeats."""
        if self.dynamics is not None:
            y = self.dynamics.loop(y, dt)
        if self.delay is not None:
            y = self.delay.late_loop(y, dt)
        return y

    def drive(
        self,
        wanted: ArrayLike,
        state: State,
        dt: Steps = None,
        window: VoltageWindow | None = None,
    ) -> Driven:
        """Return the drive that makes the static part reach one block of displacement.

        Where the window clips, the state is that of the model driven by what is left.
        Dynamics and delay of the state follow the drive itself.

        Parameters
        ----------
        wanted : array_like
            Displacement, with dynamics and delay undone (``undo``).
        state : State
            From ``start_drive``, ``drive`` or ``run``.
        dt : float, array, or None
            Seconds since the sample before; needed with relaxation or a slew limit.
        window : VoltageWindow, optional
            Limits. The range wins over the slew: begin inside it.
        """
        self.require("forward")
        wanted = np.ascontiguousarray(wanted, dtype=np.float64).reshape(-1)
        if dt is None and window is not None and window.slew is not None:
            raise ModelError(_TIME_IS_NEEDED)
        steps = self._steps(dt, wanted.size, state)
        done = self.inverse()._drive_block(wanted, state, steps, window, "extend")
        if wanted.size == 0 or (self.dynamics is None and self.delay is None):
            return done
        moved = self._forward_block(done.voltage, state, steps, "extend")[1]
        after = replace(done.state, sections=moved.sections, delay=moved.delay)
        return done._replace(state=after)

    def inner_window(self, window: VoltageWindow) -> VoltageWindow:
        """Return limits on the drive as the gears meet them, behind what stands before them.

        The slew limit counts on the steepest step everywhere, so that it is kept with
        something to spare.
        """
        forward = self.forward()
        if not forward.head:
            return window
        low, high = forward._to_gears(window.low, window.high)
        slew = window.slew
        if slew is not None:
            for curve in forward.head:
                slew *= curve.least_slope
            slew *= 1.0 - NEGLIGIBLE  # the points round
        # a window of a last digit may be empty behind the points
        return VoltageWindow(low, max(high, math.nextafter(low, math.inf)), slew)

    def _drive_block(
        self,
        x: Floats,
        state: State,
        steps: Steps,
        window: VoltageWindow | None,
        outside: Outside,
    ) -> Driven:
        """Return a block of an inverse model's voltage; see ``drive``."""
        if x.size == 0:
            return Driven(x, state)
        if state.first is not None:
            return self._first_block(x, state, state.first, steps, window, outside)
        bound = None
        if window is not None:
            inner = self.inner_window(window)
            low, high = self.gears.y_range
            slack = NEGLIGIBLE * min(inner.high - inner.low, high - low)
            bound = Window(inner.low, inner.high, inner.largest_step(steps), slack)
        last = None
        if state.drive is not None:
            last = value_through(self.inverse().head, state.drive)
        inner_x = through(self.head, x)
        done = self._gears_block(
            self.gears, inner_x, state, steps, outside != "hold", bound, last
        )
        voltage = through(self.tail, done.y)
        if window is not None and self.tail:
            # rounding on the way back through the points
            voltage = np.clip(voltage, window.low, window.high)
        after = State(
            done.bits,
            done.memory,
            float(voltage[-1]),
            sections=state.sections,
            delay=state.delay,
        )
        beyond = self._outside(x, done)
        return Driven(voltage, after, done.clipped, done.first_clipped, *beyond)

    def _first_block(
        self,
        x: Floats,
        state: State,
        first: float,
        steps: Steps,
        window: VoltageWindow | None,
        outside: Outside,
    ) -> Driven:
        """Return a block of an inverse model whose first voltage ``start_drive`` has found."""
        forward = self.inverse()
        inner = value_through(forward.head, first)
        moved = forward.gears.run([inner], state.bits)
        reached = value_through(forward.tail, float(moved.y[0]))
        begun = replace(
            state, bits=moved.bits, memory=moved.memory, drive=first, first=None
        )
        later = steps
        if isinstance(steps, np.ndarray):
            later = steps[1:]
        rest = self._drive_block(x[1:], begun, later, window, outside)
        beyond = int(not self.input.min <= x[0] <= self.input.max)
        missed = float(x[0]) - reached
        if abs(missed) <= NEGLIGIBLE * self.input.span:
            missed = 0.0
        clipped = 0
        if missed and window is not None:
            clipped = int(first <= window.low or first >= window.high)
        if clipped or beyond:
            missed = 0.0
        return Driven(
            np.concatenate([[first], rest.voltage]),
            rest.state,
            *joined(clipped, rest.clipped, rest.first_clipped),
            *joined(beyond, rest.outside, rest.first_outside),
            missed,
        )

    # ---- between the voltage and the gears of a forward model ----

    def _to_gears(self, low: float, high: float) -> tuple[float, float]:
        ends = [value_through(self.head, low), value_through(self.head, high)]
        return min(ends), max(ends)

    def _from_gears(self, value: float) -> float:
        return value_through(inverse_curves(self.head), value)

    @functools.cached_property
    def _tail_inverse(self) -> Curves:
        return inverse_curves(self.tail)


@functools.lru_cache(maxsize=8)
def _inverter(dynamics: Dynamics, dt: float) -> Inverter:
    """Return what undoes dynamics on a clock; a stream asks for it at every block."""
    return Inverter(dynamics, dt)


def _curves(stages: tuple[Stage, ...]) -> Curves:
    """Return the points and scales among stages."""
    return tuple(stage for stage in stages if isinstance(stage, Points | Scale))


def _needed(steps: Steps) -> float | Floats:
    """Return time steps, or raise ModelError where there are none."""
    if steps is None:
        raise ModelError(_TIME_IS_NEEDED)
    return steps


def _even(dt: Steps) -> float:
    """Return the step (s) of an even clock; InputError where it is not even."""
    if dt is None:
        raise ModelError(_TIME_IS_NEEDED)
    if isinstance(dt, np.ndarray):
        raise InputError(
            "undoing the model's dynamics and delay needs an even clock (`resample` HZ interpolates)"
        )
    if not dt > 0.0:
        raise InputError(f"time step: {dt!r} s is not greater than 0")
    return float(dt)
