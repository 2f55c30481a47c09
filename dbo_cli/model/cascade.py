"""The cascade of a model: run forward, undone backward, driven within limits.

displacement = Y0 + K S(Gamma(v - X0)): Gamma the gears, S points, K and Y0 a scale.
Dynamics stand behind them, and a delay last, on the output. Beyond the paper, an
amplifier's lag and points may also stand before the gears. The inverse (17)-(18) undoes
every stage in reversed order; started in the same state, both compose to the identity,
to rounding.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Booleans, Floats, Range
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model.amplifier import Amplifier, Reach, allowed_drive, output_behind
from dbo_cli.model.delay import Delay
from dbo_cli.model.dynamics import Dynamics, Inverter, Resonance
from dbo_cli.model.gears import NEGLIGIBLE, Gears, largest_step
from dbo_cli.model.points import Curve, Curves, Points, Scale
from dbo_cli.model.start import Starts
from dbo_cli.model.state import Quantity, Run, State, Steps, steps_of

Stage = Amplifier | Gears | Curve | Dynamics | Delay
Direction = Literal["forward", "inverse"]
Outside = Literal["extend", "hold", "error"]
Sign = Literal["rising", "falling"]

MOST_CANDIDATES = 5
RESONANCE_SHARE = 3.0
"""A model is trusted to its lowest resonance over this. Measured on invented benches."""
_TIME_IS_NEEDED = "this model needs a clock: add `time` COLUMN or `sample_rate` HZ"


# what undoes dynamics and delay; a stream asks for it at every block
_inverter = functools.lru_cache(maxsize=8)(Inverter)


def _curves(stages: Sequence[Stage]) -> Curves:
    """Return the curves among stages."""
    return Curves(stage for stage in stages if isinstance(stage, Points | Scale))


def _outside(values: Floats, low: float | Floats, high: float | Floats) -> Booleans:
    """Return which values lie outside a range."""
    return (values < low) | (values > high)


@dataclass(frozen=True)
class Candidate:
    """Another model that explains the logs: its weight, and its stages as of a forward model."""

    weight: float
    stages: tuple[Stage, ...]


@dataclass(eq=False)
class Cascade:
    """A cascade of stages between voltage and displacement; never changed.

    Parameters
    ----------
    direction : {"forward", "inverse"}
        Which way ``simulate`` goes: through the stages, or back through them.
    input, output : Quantity
        What goes in and comes out; the output's range is what the model reaches slowly.
    stages : tuple of Amplifier, Gears, Points, Scale, Dynamics or Delay
        From voltage to displacement, whatever the direction: at most one amplifier, curves
        around the gears, at most one dynamics and at most one delay.
    fit : mapping
        Figures of the identification.
    candidates : tuple of Candidate
        At most five other models that explain the logs, for the error of a very move.
    provenance : mapping
        Where the model comes from; carried along.
    auto_start : {"settled", "empty", "full", "below", "above"}
        How the gears stand where ``auto`` starts inside the range: as the logs began.

    Attributes
    ----------
    amplifier : Amplifier, or None
        The lag before everything else.
    head, tail : tuple of Points or Scale
        The curves before and behind the gears.
    gears : Gears
        The gears.
    dynamics : Dynamics, or None
        The dynamics.
    delay : Delay, or None
        The delay; None where it is 0.
    """

    direction: Direction
    input: Quantity
    output: Quantity
    stages: tuple[Stage, ...]
    fit: Mapping[str, Any] = field(default_factory=dict)
    candidates: tuple[Candidate, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    auto_start: str = "settled"
    amplifier: Amplifier | None = field(init=False)
    head: Curves = field(init=False)
    gears: Gears = field(init=False)
    tail: Curves = field(init=False)
    dynamics: Dynamics | None = field(init=False)
    delay: Delay | None = field(init=False)

    def __post_init__(self) -> None:
        """Name the stages."""
        kinds: dict[type[Stage], Any] = {type(stage): stage for stage in self.stages}
        self.gears = kinds[Gears]
        self.amplifier = kinds.get(Amplifier)
        self.dynamics = kinds.get(Dynamics)
        delay = kinds.get(Delay)
        self.delay = delay if delay is not None and delay.seconds else None
        index = self.stages.index(self.gears)
        self.head = _curves(self.stages[:index])
        self.tail = _curves(self.stages[index:])

    # ---- what it is ----

    @property
    def sign(self) -> Sign:
        """Whether the displacement rises or falls as the voltage rises."""
        gains = [stage.gain for stage in self.stages if isinstance(stage, Scale)]
        if math.prod(math.copysign(1.0, gain) for gain in gains) < 0.0:
            return "falling"
        return "rising"

    @property
    def is_forward(self) -> bool:
        """Whether the voltage goes in, and the displacement comes out."""
        return self.direction == "forward"

    @property
    def delay_seconds(self) -> float:
        """Seconds by which the displacement lags."""
        return 0.0 if self.delay is None else self.delay.seconds

    @property
    def sensor_delay(self) -> float:
        """Seconds by which the logs' sensor is late; no stage has them."""
        return float(self.fit.get("sensor_delay") or 0.0)

    @property
    def trusted_frequency(self) -> float | None:
        """The frequency (Hz) up to which the model can be trusted; None where it has no resonance."""
        sections = () if self.dynamics is None else self.dynamics.sections
        frequencies = [
            each.frequency for each in sections if isinstance(each, Resonance)
        ]
        return min(frequencies) / RESONANCE_SHARE if frequencies else None

    @property
    def needs_time(self) -> bool:
        """Whether the time between samples matters."""
        timed = self.amplifier, self.gears.relaxation, self.dynamics, self.delay
        return any(stage is not None for stage in timed)

    @functools.cached_property
    def digest(self) -> str:
        """A name for everything a state refers to: equal for a model and its inverse."""
        identity: list[object] = []
        for stage in self.stages:
            identity += stage.identity()
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()

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
        """Return the same cascade for the other direction, without candidates."""
        return replace(
            self,
            direction="inverse" if self.is_forward else "forward",
            input=self.output,
            output=self.input,
            candidates=(),
        )

    def forward(self) -> Cascade:
        """Return the model for the forward direction."""
        return self if self.is_forward else self.inverse()

    @functools.cached_property
    def static(self) -> Cascade:
        """The same model without dynamics and delay."""
        if self.dynamics is None and self.delay is None:
            return self
        stages = [
            each for each in self.stages if not isinstance(each, Dynamics | Delay)
        ]
        return self.with_stages(tuple(stages))

    def with_stages(self, stages: tuple[Stage, ...]) -> Cascade:
        """Return a model of the same quantities with other stages, without candidates."""
        return replace(self, stages=stages, candidates=())

    @functools.cached_property
    def candidate_models(self) -> list[tuple[float, Cascade]]:
        """Weight and model of every candidate of a forward model."""
        models = [self.with_stages(candidate.stages) for candidate in self.candidates]
        weights = [candidate.weight for candidate in self.candidates]
        return list(zip(weights, models, strict=True))

    # ---- starts ----

    @functools.cached_property
    def starts(self) -> Starts:
        """The starts of a forward model's gears; their voltage is that behind the curves before them."""
        return Starts(self.gears, *self.head.ends(self.input.min, self.input.max))

    def start(self, voltage: float, state: str | State = "auto") -> State:
        """Return the state before the first sample: one that is known, or by its name (``Starts.bits``)."""
        self.require("forward")
        if isinstance(state, State):
            return state
        at_gears = self.head.value(float(voltage))
        name = self.auto_start if state == "auto" else state
        return State(self.starts.bits(at_gears, name))

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
        starts, ends = self.starts, self.head.ends(low, high)

        def drive_of(at_gears: float) -> float:
            return min(max(self.head.inverse.value(at_gears), low), high)

        if state in ("empty", "full"):
            at_end = starts.ends[1 if state == "full" else 0]
            drive = drive_of(min(max(at_end, ends[0]), ends[1]))
            return State(starts.bits(at_end, state), drive=drive)
        output = self.tail.inverse.value(float(first))
        name = self.auto_start if state == "auto" else state
        if name != "settled":
            bits = starts.bits(0.0, name)
            at_gears = float(self.gears.undo([output], State(bits)).y[0])
            return State(bits, first=drive_of(at_gears))
        drive = drive_of(starts.voltage_settled_at(output, *ends))
        return State(starts.bits(self.head.value(drive), name), first=drive)

    # ---- simulation ----

    def simulate(
        self,
        x: ArrayLike,
        time: ArrayLike | None = None,
        dt: Steps = None,
        state: str | State = "auto",
    ) -> tuple[Floats, State]:
        """Return the displacement of a forward model for a whole drive, and the state after it.

        Parameters
        ----------
        x : array_like
            The drive.
        time : array_like, optional
            Time stamps (s); or
        dt : float or array, optional
            Seconds since the sample before. One of the two is needed with an amplifier,
            relaxation, dynamics or a delay.
        state : State or name of a start
            Before the first sample.

        Raises
        ------
        InputError
            Time goes backwards.
        ModelError
            The time between samples is needed and not given.
        """
        drive = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        if dt is None and time is not None:
            dt = steps_of(time)
        state = self.start(float(drive[0]) if drive.size else 0.0, state)
        result = self.run(drive, state, dt)
        return result.y, result.state

    def run(
        self, x: ArrayLike, state: State, dt: Steps = None, outside: Outside = "extend"
    ) -> Run:
        """Return the displacement for one block; cut a drive as you like, the values stay the same.

        ``dt`` is as of ``simulate``; the first one of a state that has just been started
        does not matter. Beyond the range ``extend`` goes on with the last slope, and
        ``hold`` holds the output.
        """
        self.require("forward")
        y = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        steps = self._checked_steps(dt, y.size)
        if y.size == 0:
            return Run(y, state)
        extend = outside != "hold"
        after = replace(state, time=None, undoing=None, first=None, model="")
        last = float(y[-1])
        for stage in self.stages:
            if not isinstance(stage, Gears):
                y, after, *_ = stage.run(y, after, steps)
                continue
            if not extend and self.starts.covered < stage.n:
                y = np.clip(y, *self.starts.ends)
            y, after, *_ = stage.run(y, after, steps, extend)
        if after.drive != last:  # the gears have it as they meet it
            after = after.behind(after.bits, after.memory, last)
        return Run(y, after)

    def _checked_steps(
        self, dt: Steps, count: int, is_timed: bool = False
    ) -> float | Floats:
        """Return the time steps of ``count`` samples; ModelError where they are missing, more or fewer."""
        if dt is None:
            if is_timed or self.needs_time:
                raise ModelError(_TIME_IS_NEEDED)
            return math.inf  # nothing depends on it
        if isinstance(dt, np.ndarray) and dt.shape != (count,):
            raise ModelError(f"{dt.size} time steps for {count} samples")
        return dt

    @functools.cached_property
    def covered(self) -> Range:
        """The range of this model's input: what it was identified on, or less where its gears end."""
        low, high = self.input.min, self.input.max
        if self.is_forward:
            lowest, highest = self.head.inverse.ends(*self.gears.x_range)
            low, high = max(low, lowest), min(high, highest)
        slack = NEGLIGIBLE * self.input.span
        return low - slack, high + slack

    def outside(self, x: Floats) -> Booleans:
        """Return which samples of the input lie outside the model's range."""
        return _outside(x, *self.covered)

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
        if isinstance(dt, np.ndarray) or not dt > 0.0:
            raise InputError(
                "the model's delay and dynamics need an even clock that advances: add `resample` HZ, or "
                "behind a pause leave `state` out"
            )
        return _inverter(self.dynamics, self.delay, float(dt))

    def follow_loop(self, y: Floats, dt: float) -> Floats:
        """Return the displacement behind dynamics and delay, for one period of a static one that repeats."""
        for stage in (self.dynamics, self.delay):
            if stage is not None:
                y = stage.loop(y, dt)
        return y

    def drive(
        self,
        desired: ArrayLike,
        state: State,
        dt: Steps = None,
        window: Range | None = None,
        slew: float | None = None,
    ) -> Run:
        """Return the drive that makes the static part reach one block of displacement.

        Where its limits clip, the state is that of the model driven by what is left.
        Dynamics and delay of the state follow the drive itself.

        Parameters
        ----------
        desired : array_like
            Displacement, with dynamics and delay undone (``inverter``).
        state : State
            From ``start_drive``, ``drive`` or ``run``.
        dt : float, array, or None
            Seconds since the sample before; needed with relaxation, an amplifier or a
            slew limit.
        window : (float, float), optional
            Least and greatest voltage.
        slew : float, optional
            With a window, which wins over it: largest change of the voltage a second.
        """
        y = np.ascontiguousarray(desired, dtype=np.float64).reshape(-1)
        steps = self._checked_steps(dt, y.size, slew is not None)
        if y.size == 0:
            return Run(y, state)
        y, clipped = self._from_first(y, state, window)
        output = self.tail.inverse(y)
        if self.amplifier is None:
            result = self._undo_gears(output, state, steps, window, slew)
        else:
            result = self._undo_amplified(output, state, steps, window, slew)
        bits, memory = result.state.bits, result.state.memory
        last = float(result.y[-1])
        after = State(bits, memory, last, amplifier=result.state.amplifier)
        if self.dynamics is not None or self.delay is not None:
            driven = self.run(result.y, state, dt).state
            after = replace(after, sections=driven.sections, delay=driven.delay)
        first_clipped = 0 if clipped else result.first_clipped
        return Run(result.y, after, result.clipped + clipped, first_clipped)

    def _from_first(
        self, y: Floats, state: State, window: Range | None
    ) -> tuple[Floats, int]:
        """Return a displacement from the row of a start's first voltage on, and whether limits clip it."""
        if state.first is None:
            return y, 0
        reached = self.static.run([state.first], state, 0.0).y
        missed = abs(float(y[0] - reached[0])) > NEGLIGIBLE * self.output.span
        clipped = 0
        if missed and window is not None:
            clipped = int(not window[0] < state.first < window[1])
        return np.append(reached, y[1:]), clipped

    def _undo_gears(
        self,
        output: Floats,
        state: State,
        steps: float | Floats,
        window: Range | None,
        slew: float | None,
    ) -> Run:
        """Return the voltage before gears and head for an output of the gears."""
        inner, inner_slew = window, slew
        if window is not None:
            inner, inner_slew = self.inner_limits(window, slew)
        if self.head and state.drive is not None:
            at_gears = self.head.value(state.drive)
            state = state.behind(state.bits, state.memory, at_gears)
        result = self.gears.undo(output, state, steps, inner, inner_slew)
        voltage = self.head.inverse(result.y)
        if window is not None and self.head:
            # rounding on the way back through the points
            voltage = np.clip(voltage, *window)
        return result._replace(y=voltage)

    def _undo_amplified(
        self,
        output: Floats,
        state: State,
        dt: float | Floats,
        window: Range | None,
        slew: float | None,
    ) -> Run:
        """Return the drive before an amplifier, whose limits reach through amplifier, head and gears.

        A block is undone as if there were no limits; from the first row on that one may hold
        back, each row is undone within its own window.
        """
        assert self.amplifier is not None
        before, shares = self.amplifier.shares(state, dt, output.size)
        at_gears = self.gears.undo(output, state, dt)
        amplified = self.head.inverse(at_gears.y)
        free = self.amplifier.undo(amplified, at_gears.state, dt)
        free = free._replace(state=replace(free.state, drive=float(free.y[-1])))
        if window is None:
            return free
        step = largest_step(slew, dt)
        changes = np.broadcast_to(np.inf if step is None else step, output.shape)
        last = math.nan if state.drive is None else state.drive
        limits = allowed_drive(np.append(last, free.y[:-1]), changes, window)
        previous = np.append(before, amplified[:-1])
        ends = [self.head(output_behind(previous, shares, end)) for end in limits]
        held = _outside(free.y, *limits) | _outside(at_gears.y, *np.sort(ends, axis=0))
        if not held.any():
            return free
        steps = np.broadcast_to(dt, output.shape)
        first = int(np.argmax(held))
        if first:
            begin = dt[:first] if isinstance(dt, np.ndarray) else dt
            state = self._undo_amplified(output[:first], state, begin, None, None).state
        drive = free.y.copy()
        clipped = first_clipped = 0
        for row in range(first, output.size):
            last = math.nan if state.drive is None else state.drive
            low, high = allowed_drive(last, changes[row], window)
            reached, share = state.amplifier or 0.0, float(shares[row])
            reach = Reach(self.head, reached, share, float(low), float(high))
            step = float(steps[row])
            solved = self.gears.undo(output[row : row + 1], state, step, reach.window)
            drive[row], reached = reach.drive(float(solved.y[0]))
            state = replace(solved.state, amplifier=reached, drive=float(drive[row]))
            if solved.clipped and not clipped:
                first_clipped = row
            clipped += solved.clipped
        return Run(drive, state, clipped, first_clipped)

    def inner_limits(
        self, window: Range, slew: float | None
    ) -> tuple[Range, float | None]:
        """Return the limits of the voltage before the curves as the gears meet them.

        The slew limit counts on the steepest step everywhere, so that it is kept with
        something to spare.
        """
        if not self.head:
            return window, slew
        low, high = self.head.ends(*window)
        if slew is not None:
            slew *= self.head.least_slope
            slew *= 1.0 - NEGLIGIBLE  # the points round
        # a window of a last digit may be empty behind the points
        return (low, max(high, math.nextafter(low, math.inf))), slew
