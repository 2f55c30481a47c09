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

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.cascade import Direction, Stage, check_order, digest_of
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics
from dbo_cli.model.gears import NEGLIGIBLE, Gears, Window
from dbo_cli.model.points import Curves, Scale, through, value_through
from dbo_cli.model.state import START_NAMES, Quantity, Run, State, Steps, steps_of
from dbo_cli.model.undoing import Inverter
from dbo_cli.model.widths import CROSSING_TOLERANCE

Outside = Literal["extend", "hold", "error"]
Sign = Literal["rising", "falling"]

MOST_CANDIDATES = 5
_EVEN = 0.01  # of a step: what the steps of an even clock differ by at most
_TIME_IS_NEEDED = "this model needs a clock: add `time` COLUMN or `sample_rate` HZ"


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


@dataclass(eq=False)
class Cascade:
    """A cascade of stages from voltage to displacement (forward) or back (inverse); never changed.

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

    Attributes
    ----------
    is_forward : bool
        Whether the voltage goes in, and the displacement comes out.
    gears : Gears
        The gears as they stand in this model.
    head, tail : tuple of Points or Scale
        What stands before and behind the gears.
    dynamics : Dynamics, or None
        The dynamics.
    delay : Delay, or None
        The delay as it stands in this model; None where it is 0.
    delay_seconds : float
        Seconds by which the output lags; an inverse model must read its input that far
        ahead.

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
    is_forward: bool = field(init=False)
    gears: Gears = field(init=False)
    head: Curves = field(init=False, default=())
    tail: Curves = field(init=False, default=())
    dynamics: Dynamics | None = field(init=False, default=None)
    delay: Delay | None = field(init=False, default=None)
    delay_seconds: float = field(init=False, default=0.0)
    _inverse: Cascade | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        """Check the cascade, and name its parts."""
        check_order(self.stages, self.direction)
        self.is_forward = self.direction == "forward"
        for stage in self.stages:
            if isinstance(stage, Gears):
                self.gears, self.head, self.tail = stage, self.tail, ()
            elif isinstance(stage, Dynamics):
                self.dynamics = stage
            elif not isinstance(stage, Delay):
                self.tail = (*self.tail, stage)
            elif stage.seconds != 0.0:
                self.delay, self.delay_seconds = stage, abs(stage.seconds)
        if len(self.candidates) > MOST_CANDIDATES:
            raise ModelError(
                f"candidates: {len(self.candidates)} are more than {MOST_CANDIDATES}"
            )

    # ---- what it is ----

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
            f"{name}: a {direction} model is needed, this is an {self.direction} one: dbo invert "
            "turns it"
        )

    # ---- other models made of it ----

    def inverse(self) -> Cascade:
        """Return the inverse model (17)-(18): every stage inverted, the order reversed."""
        if self._inverse is None:
            direction: Direction = "inverse" if self.is_forward else "forward"
            stages = tuple(stage.inverse() for stage in reversed(self.stages))
            ends = self.output, self.input
            self._inverse = Cascade(
                direction, *ends, stages, self.fit, provenance=self.provenance
            )
        return self._inverse

    def forward(self) -> Cascade:
        """Return the forward model: itself, or its inverse."""
        if self.is_forward:
            return self
        return self.inverse()

    @functools.cached_property
    def static(self) -> Cascade:
        """The same model without dynamics and delay: gears, relaxation and curves."""
        if self.dynamics is None and self.delay is None:
            return self
        return self.with_stages((*self.head, self.gears, *self.tail))

    def with_stages(self, stages: tuple[Stage, ...]) -> Cascade:
        """Return a model of the same quantities with other stages, without candidates."""
        return replace(self, stages=stages, candidates=())

    def candidate_models(self) -> list[tuple[float, Cascade]]:
        """Return weight and model of every candidate of a forward model."""
        return [
            (part.weight, self.with_stages(part.stages)) for part in self.candidates
        ]

    # ---- starts: what the gears have been through before the first sample ----

    @functools.cached_property
    def moved(self) -> Gears:
        """The gears that a drive inside the range of a forward model moves.

        Spare gears may go on beyond the range, so that a drive that goes a little
        further turns there as it does inside. They come last in the table. No drive
        inside the range moves them: those that reach below it are crossed, the others
        open.
        """
        gears, (low, high) = self.gears, self._to_gears(self.input.min, self.input.max)
        count = _gears_within(gears, high - max(low, gears.x0))
        if count == gears.n:
            return gears
        below = gears.dx[count : _gears_within(gears, high - gears.x0)]
        begin = gears.x0 + float(below.sum())
        return Gears(gears.dx[:count], gears.dy[:count], begin)

    @functools.cached_property
    def full(self) -> int:
        """The bits of all gears, where the drive comes from the upper end of its range."""
        _, high = self._to_gears(self.input.min, self.input.max)
        return (1 << _gears_within(self.gears, high - self.gears.x0)) - 1

    @property
    def empty(self) -> int:
        """The bits of all gears, where the drive comes from the lower end of its range."""
        return self.full + 1 - (1 << self.moved.n)

    def start_bits(self, voltage: float, name: str = "auto") -> int:
        """Return the bits of the start ``name`` of a forward model.

        ``empty``: the actuator has been at or below the lower end of the drive's range.
        ``full``: likewise the upper end. ``settled``: after an oscillation that decays
        from the whole range to ``voltage``, as it reaches the gears. ``auto``: empty
        where that is at or below the lower end, else settled.

        Raises
        ------
        ModelError
            There is no start of that name.
        """
        if name not in START_NAMES:
            raise ModelError(f"`state` {name}: give {', '.join(START_NAMES)} or a file")
        if name == "full":
            return self.full
        if name == "empty":
            return self.empty
        return self.empty | self.moved.settled(voltage)

    def start(self, first_input: float, state: str | State = "auto") -> State:
        """Return the state before the first sample: one that is known, or by its name (``start_bits``).

        Of an inverse model the voltage is sought whose own start leads to the first
        displacement, so that the forward model, driven by the output, starts alike.
        """
        if isinstance(state, State):
            return state
        if not self.is_forward:
            return self.inverse().start_drive(first_input, state)
        value = value_through(self.head, float(first_input))
        return State(self.start_bits(value, state))

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
            The first displacement that the static part is to reach (after ``inverter``).
        state : State or name of a start
            An actuator that starts ``empty`` or ``full`` stands at that end of the
            drive's range, so a slew limit holds from the first row on.
        low, high : float
            Where the first voltage may be.
        """
        self.require("forward")
        if isinstance(state, State):
            return state
        ends = self._to_gears(low, high)
        if state in ("empty", "full"):
            at_end = self.moved.x_range[1 if state == "full" else 0]
            voltage = self._from_gears(min(max(at_end, ends[0]), ends[1]))
            bits = self.start_bits(at_end, state)
            return State(bits, drive=min(max(voltage, low), high))
        wanted = value_through(self.inverse().head, float(first))
        inner = self._settled_voltage(wanted, *ends)
        voltage = min(max(self._from_gears(inner), low), high)
        bits = self.start_bits(value_through(self.head, voltage), state)
        return State(bits, first=voltage)

    def _settled_voltage(self, output: float, low: float, high: float) -> float:
        """Return the voltage in [low, high] whose own settled state leads to ``output``, both at the gears.

        The output at rest in the settled state rises with the voltage, but by steps
        where the state changes: where it steps over ``output``, the voltage on the
        nearer side is taken. It is found by halving the range, and within the reach of
        one state exactly.
        """
        gears, inverse = self.gears, self.gears.inverse()

        def voltage_from(bits: int) -> float:
            return float(inverse.run([output], State(bits)).y[0])

        def off_at(voltage: float) -> float:
            state = State(self.start_bits(voltage))
            return abs(float(gears.run([voltage], state).y[0]) - output)

        below, above = self.moved.x_range
        voltage = voltage_from(self.empty)
        if voltage <= below:
            return min(max(voltage, low), high)
        voltage = voltage_from(self.full)
        if voltage >= above:
            return min(max(voltage, low), high)
        # a little off the step, so that a voltage that is rounded on its way still
        # starts on the same side
        off = CROSSING_TOLERANCE * (above - below)
        while above - below > 0.001 * off:
            middle = below + 0.5 * (above - below)
            bits = self.start_bits(middle)
            voltage = voltage_from(bits)
            if below <= voltage <= above and self.start_bits(voltage) == bits:
                return min(max(voltage, low), high)
            if voltage > middle:
                below = middle
            else:
                above = middle
        ends = [min(max(end, low), high) for end in (below - off, above + off)]
        return min(ends, key=off_at)

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
            Beyond the range: go on with the last slope, hold, or refuse.

        Raises
        ------
        InputError
            Time goes backwards, or is not even where it must be; or a sample is outside
            the range and that is refused.
        ModelError
            The time between samples is needed and not given.
        """
        signal = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        if dt is None and time is not None:
            dt = steps_of(time)
        undoing = None
        if not self.is_forward and signal.size:
            inverter = self.inverter(dt)
            if isinstance(state, State):
                undoing = inverter.behind(state)
            ahead = np.full(inverter.ahead, signal[-1])
            signal, _ = inverter.run(np.concatenate([signal, ahead]), undoing)
        state = self.start(float(signal[0]) if signal.size else 0.0, state)
        if outside == "error":
            self.require_inside(signal)
        done = self.run(signal, state, dt, outside)
        return done.y, done.state

    def run(
        self, x: ArrayLike, state: State, dt: Steps = None, outside: Outside = "extend"
    ) -> Run:
        """Return the output for one block; cut a signal as you like, the values stay the same.

        Of an inverse model this is the part without dynamics and delay: ``inverter``
        comes first. ``dt`` is as of ``simulate``; the first one of a state that has just
        been started does not matter. With ``outside`` error, ``require_inside`` comes
        first.
        """
        if not self.is_forward:
            return self.forward().drive(x, state, dt, outside=outside)
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        steps = self._checked_steps(dt, x.size)
        if x.size == 0:
            return Run(x, state)
        inner = through(self.head, x)
        extend = outside != "hold"
        if not extend and self.moved is not self.gears:
            inner = np.clip(inner, *self.moved.x_range)
        done = self.gears.run(inner, state, steps, extend=extend)
        y = through(self.tail, done.y)
        sections, waiting = state.sections, state.delay
        if self.dynamics is not None:
            y, sections = self.dynamics.run(y, steps, sections)
        if self.delay is not None:
            y, waiting = self.delay.run(y, steps, waiting)
        bits, memory = done.state.bits, done.state.memory
        after = State(bits, memory, float(x[-1]), sections=sections, delay=waiting)
        return Run(y, after)

    def _checked_steps(self, dt: Steps, count: int) -> float | Floats:
        """Return the time steps of ``count`` samples; ModelError where they are missing, more or fewer."""
        if dt is None:
            if self.needs_time:
                raise ModelError(_TIME_IS_NEEDED)
            return math.inf  # nothing depends on it
        if isinstance(dt, np.ndarray) and dt.shape != (count,):
            raise ModelError(f"{dt.size} time steps for {count} samples")
        return dt

    @functools.cached_property
    def covered(self) -> tuple[float, float]:
        """The range of this model's input: what it was identified on, or less where its gears end."""
        low, high = self.input.min, self.input.max
        if self.is_forward:
            ends = [self._from_gears(end) for end in self.gears.x_range]
            low, high = max(low, min(ends)), min(high, max(ends))
        slack = NEGLIGIBLE * self.input.span
        return low - slack, high + slack

    def outside(self, x: Floats) -> NDArray[np.bool_]:
        """Return which samples of the input lie outside the model's range."""
        low, high = self.covered
        return (x < low) | (x > high)

    def require_inside(self, x: Floats, before: int = 0, name: str = "") -> None:
        """Refuse a block of input with a sample outside the model's range (InputError).

        Parameters
        ----------
        x
            The block.
        before
            Rows before the block.
        name
            Of the signal, for the message.
        """
        beyond = self.outside(x)
        if not beyond.any():
            return
        row = int(np.argmax(beyond))
        low, high = self.covered
        raise InputError(
            f"{name}{': ' if name else ''}row {before + row + 1:,}: {x[row]:.6g} is outside the "
            f"model's range, {low:.6g} to {high:.6g} (`outside` extend)"
        )

    # ---- drive ----

    def inverter(self, dt: Steps) -> Inverter:
        """Return what undoes dynamics and delay on an even clock (``dt`` in s); nothing where there are none.

        Raises
        ------
        InputError
            The clock is not even, or does not resolve the dynamics.
        """
        if self.dynamics is None and self.delay is None:
            return _inverter(None, None, 0.0)
        if dt is None:
            raise ModelError(_TIME_IS_NEEDED)
        if isinstance(dt, np.ndarray):
            if dt.size > 1 and np.ptp(dt[1:]) < _EVEN * dt[1] < dt[0]:
                raise InputError(
                    f"row 1 comes {dt[0]:.6g} s after the state: dynamics and a delay are not undone over a "
                    "pause; leave `state` out"
                )
            raise InputError(
                "the model's delay and dynamics need an even clock: add `resample` HZ"
            )
        if not dt > 0.0:
            raise InputError(f"time step: {dt!r} s is not greater than 0")
        return _inverter(self.dynamics, self.delay, float(dt))

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
        window: Window | None = None,
        slew: float | None = None,
        outside: Outside = "extend",
    ) -> Run:
        """Return the drive that makes the static part reach one block of displacement.

        Where its limits clip, the state is that of the model driven by what is left.
        Dynamics and delay of the state follow the drive itself.

        Parameters
        ----------
        wanted : array_like
            Displacement, with dynamics and delay undone (``inverter``).
        state : State
            From ``start_drive``, ``drive`` or ``run``.
        dt : float, array, or None
            Seconds since the sample before; needed with relaxation or a slew limit.
        window : (float, float), optional
            Least and greatest voltage.
        slew : float, optional
            With a window, which wins over it: largest change of the voltage a second.
        outside : {"extend", "hold"}
            Beyond the range: go on with the last slope, or hold.
        """
        x = np.ascontiguousarray(wanted, dtype=np.float64).reshape(-1)
        steps = self._checked_steps(dt, x.size)
        if dt is None and slew is not None:
            raise ModelError(_TIME_IS_NEEDED)
        if x.size == 0:
            return Run(x, state)
        clipped = 0
        if state.first is not None:
            reached = self.static.run([state.first], state, 0.0).y
            missed = abs(float(x[0] - reached[0])) > NEGLIGIBLE * self.output.span
            if missed and window is not None:
                clipped = int(not window[0] < state.first < window[1])
            x = np.concatenate([reached, x[1:]])
        inner, inner_slew, begun = window, slew, state
        if window is not None:
            inner, inner_slew = self.inner_limits(window, slew)
        if state.drive is not None:
            begun = replace(state, drive=value_through(self.head, state.drive))
        inverse = self.inverse()
        done = self.gears.inverse().run(
            through(inverse.head, x), begun, steps,
            extend=outside != "hold", window=inner, slew=inner_slew,
        )  # fmt: skip
        voltage = through(inverse.tail, done.y)
        if window is not None and self.head:
            # rounding on the way back through the points
            voltage = np.clip(voltage, *window)
        after = State(done.state.bits, done.state.memory, float(voltage[-1]))
        if self.dynamics is not None or self.delay is not None:
            moved = self.run(voltage, state, dt).state
            after = replace(after, sections=moved.sections, delay=moved.delay)
        first_clipped = 0 if clipped else done.first_clipped
        return Run(voltage, after, done.clipped + clipped, first_clipped)

    def inner_limits(
        self, window: Window, slew: float | None
    ) -> tuple[Window, float | None]:
        """Return the limits of the drive as the gears meet them, behind what stands before them.

        The slew limit counts on the steepest step everywhere, so that it is kept with
        something to spare.
        """
        forward = self.forward()
        if not forward.head:
            return window, slew
        low, high = forward._to_gears(*window)
        if slew is not None:
            for curve in forward.head:
                slew *= curve.least_slope
            slew *= 1.0 - NEGLIGIBLE  # the points round
        # a window of a last digit may be empty behind the points
        return (low, max(high, math.nextafter(low, math.inf))), slew

    # ---- between the voltage and the gears of a forward model ----

    def _to_gears(self, low: float, high: float) -> tuple[float, float]:
        ends = [value_through(self.head, low), value_through(self.head, high)]
        return min(ends), max(ends)

    def _from_gears(self, value: float) -> float:
        return value_through(self.inverse().tail, value)


@functools.lru_cache(maxsize=8)
def _inverter(dynamics: Dynamics | None, delay: Delay | None, dt: float) -> Inverter:
    """Return what undoes dynamics and delay; a stream asks for it at every block."""
    return Inverter(dynamics, delay, dt)


def _gears_within(gears: Gears, width: float) -> int:
    """Return how many gears, the first ones, span ``width``, to half a gear."""
    ends = np.cumsum(gears.dx)
    last = int(np.searchsorted(ends, width - 0.5 * float(gears.dx[-1])))
    return min(last + 1, gears.n)
