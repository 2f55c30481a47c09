"""The model of an actuator: a cascade of stages, its inverse, its states, simulation and compensation.

displacement = Y0 + K · S(Γ(v − X0)): Γ the backlash operator, S the point operator, K
and Y0 a scale stage. Dynamics stand behind them, and a delay last, on the output.
Beyond the paper, points may also stand before Γ: an asymmetry that acts on the drive;
and a lag before all, that of the amplifier. The inverse (17)-(18) inverts every stage
and reverses their order; started in the same state, model and inverse compose to the
identity, to rounding.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis import cascade, drive_lag, model_state, operators
from dbo_cli.hysteresis.cascade import (
    DelayStage,
    ScaleStage,
    Stage,
    slow_output_range,
    through,
)
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag
from dbo_cli.hysteresis.model_state import (
    NEGLIGIBLE,
    DriveLimits,
    ModelState,
    Quantity,
    Simulated,
    StartName,
)
from dbo_cli.hysteresis.operators import (
    Counts,
    DiscreteBacklashOperator,
    OutputLimits,
    Outside,
    Relaxation,
)

__all__ = [
    "NEGLIGIBLE",
    "SIGN_VERBS",
    "ActuatorModel",
    "BacklashStage",
    "DelayStage",
    "DriveLimits",
    "DynamicsStage",
    "ModelState",
    "PointStage",
    "Quantity",
    "Relaxation",
    "ScaleStage",
    "Sign",
    "Simulated",
    "Stage",
    "slow_output_range",
]

Floats = NDArray[np.float64]
Steps = float | Floats  # seconds since the sample before: one number, or one for each
Direction = Literal["forward", "inverse"]
Sign = Literal["rising", "falling"]
WITH_ARTICLE: Mapping[Direction, str] = {
    "forward": "a forward",
    "inverse": "an inverse",
}
SIGN_VERBS: Mapping[Sign, str] = {"rising": "rises", "falling": "falls"}
BacklashStage = DiscreteBacklashOperator
PointStage = operators.DiscretePointOperator


@dataclass(frozen=True)
class ActuatorModel:
    """A cascade of stages from voltage to displacement (forward) or back (inverse).

    Parameters
    ----------
    direction : {"forward", "inverse"}
        Forward: one backlash stage, points and scales around it, then dynamics and a
        delay, each once at most; dynamics of one lag may also stand first. Inverse: the
        mirror image.
    input, output : Quantity
        What goes in and comes out; the output's range is what the model reaches slowly.
    stages : tuple of Stage
        The cascade, in the order a signal passes it.
    fit, provenance : mapping
        Figures of the identification and where the model comes from; carried along.

    Attributes
    ----------
    head, tail : tuple of points and scales
        Before the gears, and behind them.
    drive_lag, dynamics : DynamicsStage, or None
        The lag on the drive's side of the gears, and the dynamics on the other, as they
        stand in this model.
    delay : DelayStage, or None
        The delay as it stands in this model.

    Raises
    ------
    ModelError
        The cascade is not of that form; the message begins with the key.
    """

    direction: Direction
    input: Quantity
    output: Quantity
    stages: tuple[Stage, ...]
    fit: Mapping[str, object] = field(default_factory=dict)
    provenance: Mapping[str, object] = field(default_factory=dict)
    head: cascade.MemoryFree = field(init=False, repr=False, compare=False)
    tail: cascade.MemoryFree = field(init=False, repr=False, compare=False)
    drive_lag: DynamicsStage | None = field(init=False, repr=False, compare=False)
    dynamics: DynamicsStage | None = field(init=False, repr=False, compare=False)
    delay: DelayStage | None = field(init=False, repr=False, compare=False)

    has_gears = True
    """Whether its hysteresis is that of gears."""

    def __post_init__(self) -> None:
        """Check the order of the stages."""
        places = [
            place
            for place, stage in enumerate(self.stages)
            if isinstance(stage, DiscreteBacklashOperator)
        ]
        if not places:
            raise ModelError("stages: no backlash stage is among them")
        if len(places) > 1:
            raise ModelError(
                f"stages[{places[1]}]: only one backlash stage is possible"
            )
        self._check_drive_axis(places[0])
        self._take_apart(places[0])

    def _check_drive_axis(self, place: int) -> None:
        """See that the memory of the backlash stage follows the drive, as the direction tells."""
        backlash = self.stages[place]
        assert isinstance(backlash, DiscreteBacklashOperator)
        axis: operators.Axis = "input" if self.is_forward else "output"
        if backlash.memory_on == axis:
            return
        if backlash.relaxation is not None:
            raise ModelError(
                f"stages[{place}].relaxation.on: must be {axis!r} in this direction"
            )
        # Without relaxation a file does not say which axis is the drive's; the
        # direction does.
        turned = DiscreteBacklashOperator(
            backlash.dx, backlash.dy, backlash.x0, backlash.y0, None, axis
        )
        self._put(backlash, turned)

    def _take_apart(self, hysteresis: int) -> None:
        """Check what stands beside the hysteresis, and name it."""
        self._check_dynamics(hysteresis)
        self._check_delay()
        before = self.stages[:hysteresis]
        behind = self.stages[hysteresis + 1 :]
        parts: dict[str, object] = {
            "head": cascade.memory_free(before),
            "tail": cascade.memory_free(behind),
            "drive_lag": _dynamics_among(before),
            "dynamics": _dynamics_among(behind),
            "delay": None,
        }
        if not self.is_forward:
            parts["drive_lag"] = _dynamics_among(behind)
            parts["dynamics"] = _dynamics_among(before)
        for stage in self.stages:
            if isinstance(stage, DelayStage):
                parts["delay"] = stage
        self.__dict__.update(parts)

    def _check_dynamics(self, hysteresis: int) -> None:
        """Refuse dynamics in another place than theirs; the direction tells how they act."""
        for place, stage in enumerate(self.stages):
            if not isinstance(stage, DynamicsStage):
                continue
            if (place < hysteresis) == self.is_forward:
                self._check_drive_lag(place, stage)
            elif self.is_forward:
                self._check_outermost(place, self.stages[place + 1 :], "after")
            else:
                self._check_outermost(place, self.stages[:place], "before")
            self._turn(stage)

    def _check_drive_lag(self, place: int, stage: DynamicsStage) -> None:
        """Refuse dynamics on the drive's side that are not one lag at the very end."""
        end = "first" if self.is_forward else "last"
        outermost = 0 if self.is_forward else len(self.stages) - 1
        if place != outermost:
            raise ModelError(
                f"stages[{place}]: dynamics on the drive's side stand {end}, and once"
            )
        lag = stage.sections[0]
        is_lag = isinstance(lag, Lag) and lag.lead == 0.0
        if len(stage.sections) > 1 or not is_lag:
            raise ModelError(f"stages[{place}].sections: one lag alone may stand {end}")

    def _check_outermost(self, place: int, outer: tuple[Stage, ...], side: str) -> None:
        """Refuse dynamics beyond which anything but a delay stands."""
        for stage in outer:
            if not isinstance(stage, DelayStage):
                raise ModelError(
                    f"stages[{place}]: dynamics stand {side} all stages but a delay, and once"
                )

    def _check_delay(self) -> None:
        """Refuse a delay in another place than its own, or of the other direction's sign."""
        for place, stage in enumerate(self.stages):
            if not isinstance(stage, DelayStage):
                continue
            if self.is_forward and place != len(self.stages) - 1:
                raise ModelError(f"stages[{place}]: a delay stands last")
            if not self.is_forward and place != 0:
                raise ModelError(f"stages[{place}]: a delay stands first")
            forward_seconds = stage.seconds if self.is_forward else -stage.seconds
            if forward_seconds < 0.0:
                raise ModelError(
                    f"stages[{place}].seconds: {stage.seconds!r} has the wrong sign here"
                )

    def _turn(self, stage: DynamicsStage | cascade.OtherHysteresis) -> None:
        """Let a stage act, or be undone, as the direction tells."""
        if stage.inverted == self.is_forward:
            self._put(stage, stage.inverse())

    def _put(self, old: Stage, new: Stage) -> None:
        """Put a stage in another's place, while the model is made."""
        stages = list(self.stages)
        for place, stage in enumerate(self.stages):
            if stage is old:
                stages[place] = new
        object.__setattr__(self, "stages", tuple(stages))

    @property
    def is_forward(self) -> bool:
        """Whether the voltage goes in, and the displacement comes out."""
        return self.direction == "forward"

    def require(self, direction: Direction, place: str = "the model") -> None:
        """Raise ModelError, with the remedy, where the model is of the other direction."""
        if self.direction != direction:
            model = WITH_ARTICLE[self.direction]
            needed = WITH_ARTICLE[direction]
            raise ModelError(
                f"{place}: is {model} model where {needed} one is needed (dbo invert turns it)"
            )

    def inverse(self) -> Self:
        """Return the inverse model (17)-(18): every stage inverted, the order reversed."""
        direction: Direction = "inverse" if self.is_forward else "forward"
        stages = tuple(stage.inverse() for stage in reversed(self.stages))
        return type(self)(
            direction, self.output, self.input, stages, self.fit, self.provenance
        )

    @cached_property
    def backlash(self) -> DiscreteBacklashOperator:
        """The backlash stage as it stands in this model."""
        return next(
            stage
            for stage in self.stages
            if isinstance(stage, DiscreteBacklashOperator)
        )

    @cached_property
    def forward_backlash(self) -> DiscreteBacklashOperator:
        """The backlash stage from voltage to displacement, whatever the direction of the model."""
        return self.backlash if self.is_forward else self.backlash.inverse()

    @cached_property
    def covered_gears(self) -> DiscreteBacklashOperator:
        """The forward gears that a drive inside the covered range moves; others take no part in starts."""
        return cascade.covered_gears(self.forward_backlash, *self._drive_at_gears)

    @cached_property
    def spare_bits(self) -> int:
        """The bits of the forward gears that such a drive does not move."""
        return cascade.spare_bits(self.forward_backlash, *self._drive_at_gears)

    @property
    def _drive_at_gears(self) -> tuple[float, float]:
        """The covered range of the drive, as it reaches the forward gears."""
        bent = self.head if self.is_forward else self.tail_inverse
        ends = through(bent, np.array([self.drive.minimum, self.drive.maximum]))
        return float(ends.min()), float(ends.max())

    def of_all_gears(self, state: operators.BacklashState) -> operators.BacklashState:
        """Return a state of the covered gears as one of all gears."""
        return operators.BacklashState(state.bits | self.spare_bits, state.memory)

    @cached_property
    def head_inverse(self) -> cascade.MemoryFree:
        """What undoes ``head``."""
        return tuple(stage.inverse() for stage in reversed(self.head))

    @cached_property
    def tail_inverse(self) -> cascade.MemoryFree:
        """What undoes ``tail``."""
        return tuple(stage.inverse() for stage in reversed(self.tail))

    @cached_property
    def without_drive_lag(self) -> ActuatorModel:
        """The same model for a drive that has passed the lag."""
        return self.without(self.drive_lag)

    @cached_property
    def without_lag(self) -> Self:
        """The same model without dynamics, drive lag and delay: gears, memories and curves."""
        return self.without(self.drive_lag, self.dynamics, self.delay)

    @property
    def without_dynamics_and_delay(self) -> Self:
        """The same model without what changes with time behind its gears and points."""
        return self.without(self.dynamics, self.delay)

    def without(self, *dropped: Stage | None) -> Self:
        """Return the same model without some of its stages."""
        stages = tuple(
            stage for stage in self.stages if not any(stage is gone for gone in dropped)
        )
        return dataclasses.replace(self, stages=stages)

    def drive_of(self, state: ModelState) -> float | None:
        """Return the voltage at which a state was left, where it knows."""
        if state.drive_lag is not None:
            return state.drive_lag[0][2]
        if state.drive is None:
            return None
        inverse = self.inverted if self.is_forward else self
        return inverse.outer_drive(state.drive)

    def displacement_of(self, state: ModelState) -> float:
        """Return the displacement that gears and memories of a state hold, at its own voltage."""
        assert state.drive is not None
        slow = self.without_lag
        at_rest = dataclasses.replace(
            state, dynamics=None, drive_lag=None, history=None, undoing=None
        )
        voltage = self.inverted.outer_drive(state.drive)
        return float(slow.simulate([voltage], at_rest, time_step=0.0).y[0])

    @property
    def sign(self) -> Sign:
        """Whether the displacement rises or falls as the voltage rises."""
        gains = [stage.gain for stage in self.stages if isinstance(stage, ScaleStage)]
        return "falling" if math.prod(gains) < 0.0 else "rising"

    @property
    def delay_seconds(self) -> float:
        """Seconds by which the output lags; an inverse model must read its input that far ahead."""
        return abs(self.delay.seconds) if self.delay else 0.0

    @cached_property
    def needs_time(self) -> bool:
        """Whether the time between samples matters."""
        parts = self.backlash.relaxation, self.dynamics, self.drive_lag
        return any(parts) or (self.is_forward and self.delay_seconds > 0.0)

    @property
    def size(self) -> str:
        """How large the hysteresis operator is, in words."""
        return f"{self.backlash.n} gears"

    def state_values(self, state: operators.BacklashState) -> dict[str, Any]:
        """Return what the hysteresis remembers as the state file has it: key and values."""
        return {"backlash": {"gears": self.backlash.n, **state.to_json_dict()}}

    @property
    def drive_end(self) -> float:
        """Upper end of what the gears span on the drive's side, where every one is engaged."""
        return self.forward_backlash.x_range[1]

    @cached_property
    def digest(self) -> str:
        """A name for everything a state refers to: equal for a model and its inverse."""
        forward = self if self.is_forward else self.inverse()
        return cascade.digest_of(forward.stages)

    def _before_backlash(self, x: ArrayLike) -> Floats:
        """Return what reaches the backlash stage of this model."""
        return through(self.head, np.ascontiguousarray(x, dtype=np.float64).reshape(-1))

    def inner_limits(self, limits: DriveLimits) -> DriveLimits:
        """Return limits on the drive as the backlash stage of an inverse model meets them.

        Where points stand between, the steepest step they may let through is counted on
        everywhere, so that the slew limit is kept with something to spare.
        """
        if not self.tail:
            return limits
        ends = through(self.tail_inverse, np.array([limits.v_min, limits.v_max]))
        slew = limits.max_slew
        if slew is not None:
            for stage in self.tail_inverse:
                slew *= cascade.least_slope(stage)
            slew *= 1.0 - NEGLIGIBLE  # the points round
        # a window of a last digit may be none behind the points
        low = float(ends.min())
        return DriveLimits(
            low, max(float(ends.max()), math.nextafter(low, math.inf)), slew
        )

    def output_limits(self, limits: DriveLimits, steps: Steps | None) -> OutputLimits:
        """Return limits that the backlash stage of an inverse model meets, in the operator's terms."""
        low, high = self.backlash.y_range
        return OutputLimits(
            limits.v_min,
            limits.v_max,
            limits.largest_step(steps),
            limits.slack(high - low),
        )

    def start(
        self,
        first_input: float,
        state: StartName | ModelState = "auto",
        limits: DriveLimits | None = None,
    ) -> ModelState:
        """Return the state before the first sample.

        For an inverse model ``auto`` and ``settled`` ask for the voltage (within
        ``limits``) whose own start leads to the first displacement, so that the forward
        model, driven by the output, starts alike.
        """
        if isinstance(state, ModelState):
            return state
        value = float(self._before_backlash([first_input])[0])
        covered = self.covered_gears
        if self.is_forward or state in {"empty", "full"}:
            begun = model_state.start_state(covered, value, state)
            return ModelState(self.of_all_gears(begun))
        model_state.start_state(covered, value, state)  # refuses a name that is none
        low, high = -math.inf, math.inf
        if limits is not None:
            inner = self.inner_limits(limits)
            low, high = inner.v_min, inner.v_max
        first = model_state.start_drive(covered, value, low, high)
        first = first._replace(state=self.of_all_gears(first.state))
        return ModelState(first.state, first=first)

    def simulate(
        self,
        x: ArrayLike,
        state: ModelState,
        *,
        time_step: float | ArrayLike | None = None,
        outside: Outside = "extend",
        limits: DriveLimits | None = None,
    ) -> Simulated:
        """Return the output for one block; cut a signal as you like, the bits stay the same.

        Parameters
        ----------
        x : array_like
            The input. An inverse model with a delay gets it read ahead
            (``cascade.read_ahead``), one with dynamics with these undone
            (``dynamics.undone``): both need samples that come later.
        state : ModelState
            From ``start``, or from the block before.
        time_step : float or array_like, optional
            Seconds since the sample before, one number or one for each; that of the
            very first sample does not matter. Needed with relaxation, a delay or a slew
            limit.
        outside : {"extend", "hold", "error"}
            Beyond the range: go on with the last slope, hold, or raise OutsideError.
        limits : DriveLimits, optional
            Of an inverse model: clip the voltage; the state is that of the forward
            model it drives.

        Raises
        ------
        ModelError
            The time between samples is needed and not given.
        OutsideError
            ``outside`` is ``error`` and a sample is outside.
        """
        if limits is not None:
            self.require("inverse")
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        steps = self._steps(time_step, x.size, state, limits)
        if self.drive_lag is None:
            done = self._simulate_prompt(x, state, steps, outside, limits)
        else:
            assert steps is not None
            behind = self.without_drive_lag
            done = drive_lag.simulate(
                self.drive_lag, behind, x, state, steps, outside, limits
            )
            if self.direction == "inverse":
                return done
        beyond = self._beyond(x)  # of the model's input range, too
        count = max(beyond.size, done.outside_count)
        first = done.first_outside
        if beyond.size and (not done.outside_count or beyond[0] < first):
            first = int(beyond[0])
        if outside == "error" and count:
            raise model_state.OutsideError(first, float(x[first]), *self._covered)
        return done._replace(outside_count=count, first_outside=first)

    def _simulate_prompt(
        self,
        x: Floats,
        state: ModelState,
        steps: Steps | None,
        outside: Outside,
        limits: DriveLimits | None,
    ) -> Simulated:
        """Return what ``simulate`` does, for a model without a lag before its gears."""
        signal = x  # the caller's, not to be written into
        x = through(self.head, x)
        if outside == "hold":
            x = self._held(x)
        inner = None if limits is None else self.inner_limits(limits)
        room = None if x is signal else x
        drive = float(x[-1]) if x.size else None
        y, after, counts, missed = self._backlash_block(
            x, state, steps, outside, inner, room
        )
        y = through(self.tail, y, overwrite=y is not signal)
        if limits is not None and self.tail:
            # rounding on the way back through the points
            y = np.clip(y, limits.v_min, limits.v_max)
        if not self.is_forward:
            return Simulated(y, after, *counts, missed)
        if drive is not None:
            after = dataclasses.replace(after, drive=drive)
        if steps is not None and self.dynamics:
            y, sections = self.dynamics.run(y, steps, state.dynamics)
            after = dataclasses.replace(after, dynamics=sections)
        if steps is not None and self.delay and self.delay.seconds > 0.0:
            y, history = self.delay.lag(
                y, steps, state.history, overwrite=y is not signal
            )
            after = dataclasses.replace(after, history=history)
        return Simulated(y, after, *counts, missed)

    @property
    def drive(self) -> Quantity:
        """The voltages that the model covers: what goes into it, or comes out of an inverse."""
        return self.input if self.is_forward else self.output

    def outer_drive(self, drive: float) -> float:
        """Return the voltage of an inverse model for a drive at its backlash stage."""
        return float(through(self.tail, np.array([drive]))[0])

    def _held(self, x: Floats) -> Floats:
        """Return what reaches the gears, kept within those that the model covers."""
        core = self.covered_gears
        if not self.is_forward or core.n == self.backlash.n:
            return x
        return np.clip(x, *core.x_range)

    def _steps(
        self,
        time_step: float | ArrayLike | None,
        count: int,
        state: ModelState,
        limits: DriveLimits | None,
    ) -> Steps | None:
        """Return the time steps, checked; that of a first sample is set to 0."""
        if time_step is None:
            if self.needs_time or (limits is not None and limits.max_slew is not None):
                raise ModelError(
                    "this needs the time between samples (a time column, or `sample_rate`)"
                )
            return None
        if np.ndim(time_step) == 0:
            return float(np.asarray(time_step))
        steps = np.array(time_step, dtype=np.float64)
        if steps.shape != (count,):
            raise ModelError(f"{steps.size} time steps for {count} samples")
        begun = (state.drive, state.history, state.dynamics) != (None, None, None)
        if count and not begun:
            steps[0] = 0.0
        return steps

    def _backlash_block(
        self,
        x: Floats,
        state: ModelState,
        steps: Steps | None,
        outside: Outside,
        limits: DriveLimits | None,
        room: Floats | None = None,
    ) -> tuple[Floats, ModelState, Counts, float]:
        """Return the backlash stage's block, the state after, the counts, and the first value missed.

        ``room``: where the block may go; it may be ``x``.
        """
        if x.size == 0:
            return x, state, Counts(), 0.0
        if state.first is not None:
            return self._first_block(x, state, state.first, steps, outside, limits)
        relaxation = self.backlash.relaxation
        decay = None
        if relaxation and steps is not None:
            decay = relaxation.decay(steps)
        bound = None if limits is None else self.output_limits(limits, steps)
        y, backlash, counts = self.backlash.run(
            x,
            state.backlash,
            decay=decay,
            outside=outside,
            limits=bound,
            last=state.drive,
            out=room,
        )
        after = dataclasses.replace(
            state, backlash=backlash, drive=float(y[-1]), time=None
        )
        return y, after, counts, 0.0

    def _first_block(
        self,
        x: Floats,
        state: ModelState,
        first: model_state.DriveStart,
        steps: Steps | None,
        outside: Outside,
        limits: DriveLimits | None,
    ) -> tuple[Floats, ModelState, Counts, float]:
        """Return what ``_backlash_block`` does, for a block whose first voltage ``start`` has found."""
        _, backlash, _ = self.forward_backlash.run([first.voltage], state.backlash)
        begun = dataclasses.replace(
            state, backlash=backlash, drive=first.voltage, first=None, time=None
        )
        later_steps = None
        if steps is not None:
            later_steps = operators.steps_of(steps, slice(1, None))
        y, after, later, _ = self._backlash_block(
            x[1:], begun, later_steps, outside, limits
        )
        y = np.concatenate([[first.voltage], y])
        _, _, unbound = self.backlash.run(x[:1], state.backlash)
        low, high = self.backlash.x_range
        missed = float(x[0]) - first.reached
        short = abs(missed) > NEGLIGIBLE * (high - low)
        clipped = short and limits is not None and first.at_limit
        counts = Counts(unbound.outside, 0, int(clipped), 0).then(later, 1)
        if clipped or unbound.outside or not short:
            missed = 0.0
        # By the mean size of this model's input per unit of the stage's input.
        return y, after, counts, missed * (self.input.span / (high - low))

    @cached_property
    def _covered(self) -> tuple[float, float]:
        """The range of this model's input: what it was identified on, or less where its gears end."""
        low, high = self.input.minimum, self.input.maximum
        if not self.is_forward:
            return low, high
        ends = through(self.head_inverse, np.array(self.backlash.x_range))
        return max(low, float(ends.min())), min(high, float(ends.max()))

    def _beyond(self, x: Floats) -> NDArray[np.intp]:
        """Return the samples beyond the model's input range; usually there are none, which the ends tell."""
        low, high = self._covered
        if x.size and x.min() >= low and x.max() <= high:
            return np.empty(0, np.intp)
        return np.flatnonzero(self.uncovered(x))

    def uncovered(self, x: Floats) -> NDArray[np.bool_]:
        """Return which samples lie beyond the model's input range; gears may go on a little further."""
        low, high = self._covered
        slack = NEGLIGIBLE * self.input.span
        return (x < low - slack) | (x > high + slack)

    def compensate(
        self,
        desired: ArrayLike,
        state: ModelState,
        *,
        limits: DriveLimits,
        time_step: float | ArrayLike | None = None,
    ) -> Simulated:
        """Return the drive of a forward model for one block of desired displacement; see ``simulate``.

        The state may have come from ``start_compensation``, or from ``simulate`` of
        this model.
        """
        self.require("forward")
        done = self.inverted.simulate(
            desired, state, time_step=time_step, limits=limits
        )
        if self.dynamics is None or done.y.size == 0:
            return done
        # What the limits cut off does not reach the actuator, so its dynamics follow
        # the drive itself.
        moved = self.follow(done.y, state, time_step).state
        after = dataclasses.replace(
            done.state, dynamics=moved.dynamics, history=moved.history
        )
        return done._replace(state=after)

    def follow(
        self, drive: ArrayLike, state: ModelState, time_step: float | ArrayLike | None
    ) -> Simulated:
        """Return what this forward model makes of a drive that ``compensate`` computed from a state."""
        if state.first is not None:
            state = dataclasses.replace(state, first=None, drive=None)
        return self.simulate(drive, state, time_step=time_step)

    def start_compensation(
        self, first_desired: float, state: StartName | ModelState, limits: DriveLimits
    ) -> ModelState:
        """Return the state of ``compensate`` in which ``simulate`` of its output starts.

        An actuator that starts ``empty`` or ``full`` stands at that end of the drive's
        range, so a slew limit holds from the first sample on.
        """
        self.require("forward")
        begun = self.inverted.start(first_desired, state, limits)
        inner = self.inverted.inner_limits(limits)
        if state in ("empty", "full") and inner.max_slew is not None:
            low, high = self.covered_gears.x_range
            drive = low if state == "empty" else high
            begun = dataclasses.replace(
                begun, drive=min(max(drive, inner.v_min), inner.v_max)
            )
        return begun

    def start_spread(self, begun: ModelState, first_input: float) -> float:
        """Return by how much the displacement at rest, where a run begins, depends on what was before.

        ``begun`` is what ``start`` gave for the first input; the result is in the
        displacement's unit.
        """
        gears = self.forward_backlash
        if begun.first is not None:
            drive = begun.first.voltage
        else:
            drive = float(self._before_backlash([first_input])[0])
        covered = self.covered_gears
        ends = [
            gears.run([drive], self.of_all_gears(past))[0]
            for past in (covered.empty(), covered.full())
        ]
        bent = self.tail if self.is_forward else self.head_inverse
        low, high = through(bent, np.concatenate(ends))
        return abs(float(high) - float(low))

    @cached_property
    def inverted(self) -> Self:
        """The inverse, kept."""
        return self.inverse()


def _dynamics_among(stages: tuple[Stage, ...]) -> DynamicsStage | None:
    """Return the dynamics among stages, where there are any."""
    for stage in stages:
        if isinstance(stage, DynamicsStage):
            return stage
    return None
