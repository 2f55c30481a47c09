"""A model whose hysteresis is a weighted sum of plays: what ``ActuatorModel`` is to the gears.

Forward: a scale that brings the drive to the operator's range, the plays, points (superposed dead zones are
a curve of straight pieces) and scales, then perhaps a delay. A straight line is one play of radius 0. The
commands take such a model as any other; what is made for gears alone (``export``, the live controller)
refuses it. Files have the stage and its state as in
docs/model-file.md: ``hysteresis.model_file`` asks here when a file has a stage that it does not know.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.cascade import ScaleStage, Stage, through
from dbo_cli.hysteresis.delay import DelayStage
from dbo_cli.hysteresis.model import NEGLIGIBLE, ActuatorModel
from dbo_cli.hysteresis.model_file import Node
from dbo_cli.hysteresis.model_state import (
    START_NAMES,
    DriveLimits,
    ModelState,
    OutsideError,
    Simulated,
    StartName,
)
from dbo_cli.hysteresis.operators import BacklashState, Counts, DiscretePointOperator, Outside
from dbo_cli.relatives.plays import KINDS, NOTHING, Bounds, Kind, PlayOperator, PlayState

Floats = NDArray[np.float64]


class RelativeModel(ActuatorModel):
    """A cascade with one stage of plays in the place of the gears; see ``ActuatorModel`` for what it does.

    Raises
    ------
    ModelError
        The cascade is not of that form; the message begins with the key.
    """

    def __post_init__(self) -> None:
        """Check the order of the stages; the direction tells how the plays act."""
        plays = [k for k, stage in enumerate(self.stages) if isinstance(stage, PlayOperator)]
        if len(plays) != 1:
            raise ModelError("stages: exactly one stage of plays must be among them")
        self._check_delay()
        for place, stage in enumerate(self.stages):
            if isinstance(stage, PlayOperator):
                self._turn(stage)
            elif not isinstance(stage, ScaleStage | DiscretePointOperator | DelayStage):
                raise ModelError(f"stages[{place}]: only plays, points, scales and a delay go together")

    @cached_property
    def _place(self) -> int:
        return next(k for k, stage in enumerate(self.stages) if isinstance(stage, PlayOperator))

    @cached_property
    def plays(self) -> PlayOperator:
        """The stage of plays."""
        stage: object = self.stages[self._place]
        assert isinstance(stage, PlayOperator)
        return stage

    @property
    def backlash(self) -> NoReturn:
        """Refuse: there are no gears in it."""
        raise ModelError(
            f"the model is one of {self.plays.n} plays, to compare with: this needs the gears of the Discrete"
            " Backlash Operator (dbo identify makes such a model)"
        )

    forward_backlash = backlash

    @property
    def size(self) -> str:
        """How large the operator is, in words."""
        return f"{self.plays.n} plays"

    def state_values(self, state: BacklashState) -> dict[str, Any]:
        """Return what the plays remember as the state file has it."""
        assert isinstance(state, PlayState)
        return {"plays": state.to_json_dict()}

    @cached_property
    def needs_time(self) -> bool:
        """Whether the time between samples matters."""
        return bool(self.plays.by_rate.size) or (self.direction == "forward" and self.delay_seconds > 0.0)

    @property
    def drive_end(self) -> float:
        """Upper end of the operator's range, in the drive's unit."""
        forward = self if self.direction == "forward" else self.inverted
        return float(through(forward.head_inverse, np.array([1.0]))[0])

    def start(
        self,
        first_input: float,
        state: StartName | ModelState = "auto",
        limits: DriveLimits | None = None,
    ) -> ModelState:
        """Return the state before the first sample; see ``ActuatorModel.start``.

        ``settled`` beyond the end of the range is ``empty`` or ``full``, so that ``auto`` is ``settled``.
        """
        if isinstance(state, ModelState):
            return state
        if state not in START_NAMES:
            raise ModelError(f"no initial state is called {state!r}; there are: {', '.join(START_NAMES)}")
        operator = self.plays
        if state in ("empty", "full"):
            return ModelState(_held(operator.after(operator.low if state == "empty" else 1.0)))
        value = float(self._before_backlash([first_input])[0])
        if self.direction == "inverse":
            value = operator.settled_at(value)
            if limits is not None:
                bound = self._bounds(limits, None)
                value = min(max(value, bound.low), bound.high)
        return ModelState(_held(operator.settled(value)))

    def start_compensation(
        self, first_desired: float, state: StartName | ModelState, limits: DriveLimits
    ) -> ModelState:
        """Return the state of ``compensate`` in which ``simulate`` of its output starts."""
        self.require("forward")
        begun = self.inverted.start(first_desired, state, limits)
        if state in ("empty", "full") and limits.max_slew is not None:
            ends = self.plays.low if state == "empty" else 1.0
            begun = dataclasses.replace(begun, drive=ends)
        return begun

    def start_spread(self, begun: ModelState, first_input: float) -> float:
        """Return by how much the displacement at rest, where a run begins, depends on what was before."""
        operator = self.plays
        forward = self if self.direction == "forward" else self.inverted
        value = float(self._before_backlash([first_input])[0])
        if self.direction == "inverse":
            value = operator.settled_at(value)
        still = np.zeros(1) if operator.by_rate.size else NOTHING
        ends = [operator.run(np.array([value]), operator.after(end), still)[0] for end in (operator.low, 1.0)]
        low, high = (float(through(forward.tail, end)[0]) for end in ends)
        return abs(high - low)

    def simulate(
        self,
        x: ArrayLike,
        state: ModelState,
        *,
        time_step: float | ArrayLike | None = None,
        outside: Outside = "extend",
        limits: DriveLimits | None = None,
    ) -> Simulated:
        """Return the output for one block; see ``ActuatorModel.simulate``."""
        if limits is not None:
            self.require("inverse")
        given: Floats = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        counts = self._with_uncovered(given, Counts())
        if outside == "error" and counts.outside:
            first = counts.first_outside
            raise OutsideError(first, float(given[first]), *self._covered)
        held = np.clip(given, *self._covered) if outside == "hold" else given
        signal = self._before_backlash(held)
        steps = self._steps(time_step, signal.size, state, limits)
        y, after, clipped = self._plays_block(signal, state, steps, limits)
        for stage in self.tail:
            y = stage.run(y)
        if limits is not None:
            y = np.clip(y, limits.v_min, limits.v_max)  # rounding on the way back through the scale
            counts = counts._replace(clipped=clipped[0], first_clipped=clipped[1])
        if self.direction == "forward" and steps is not None:
            y, after = self._lagging(y, after, steps, state)
        return Simulated(y, after, *counts)

    @cached_property
    def _covered(self) -> tuple[float, float]:
        return self.input.minimum, self.input.maximum

    def _plays_block(
        self, signal: Floats, state: ModelState, steps: float | Floats | None, limits: DriveLimits | None
    ) -> tuple[Floats, ModelState, tuple[int, int]]:
        """Pass a block through the plays, in the model's direction."""
        if signal.size == 0:
            return signal, state, (0, 0)
        operator, before = self.plays, state.backlash
        if not isinstance(before, PlayState) or len(before.plays) != operator.n:
            raise ModelError("state: is not one of this model's plays")
        plays, clipped = np.array(before.plays), (0, 0)
        if self.direction == "forward":
            share = self._share(signal, plays[0] if state.drive is not None else None, steps, 1.0)
            y, plays = operator.run(signal, plays, share)
            after = _held(plays)
        elif operator.kind == "plays" and limits is None:
            closed = operator.closed_inverse
            states = np.array(before.inverse_plays) if before.inverse_plays else closed.states_of(plays)
            y, states = closed.run(signal, states)
            after = PlayState(0, None, tuple(closed.plays_of(states).tolist()), tuple(states.tolist()))
        else:
            low, high = operator.ends
            share = self._share(signal, before.wanted, steps, (high - low) / (1.0 - operator.low))
            bounds = None if limits is None else self._bounds(limits, steps)
            y, plays, clipped = operator.solve(signal, plays, share, bounds, state.drive)
            after = dataclasses.replace(_held(plays), wanted=float(signal[-1]))
        return y, dataclasses.replace(state, backlash=after, drive=after.plays[0], time=None), clipped

    def _share(
        self, signal: Floats, last: float | None, steps: float | Floats | None, slope: float
    ) -> Floats:
        """Return the share of ``by_rate`` in every sample: the rate over the fastest one, at most 1.

        An inverse knows the rate of what is wanted, and takes the drive's for that over the loop's ``slope``.
        """
        operator = self.plays
        if not operator.by_rate.size:
            return NOTHING
        assert steps is not None
        change = np.abs(np.diff(signal, prepend=signal[0] if last is None else last))
        reach = np.broadcast_to(np.asarray(steps) * (operator.fastest * slope), signal.shape)
        share = np.divide(change, reach, out=np.zeros(signal.size), where=reach > 0.0)
        return np.minimum(share, 1.0)

    def _bounds(self, limits: DriveLimits, steps: float | Floats | None) -> Bounds:
        """Limits on the drive as the plays of an inverse model give it."""
        ends = through(self.tail_inverse, np.array([limits.v_min, limits.v_max]))
        per_volt = abs(float(ends[1] - ends[0])) / (limits.v_max - limits.v_min)
        low, high = float(ends.min()), float(ends.max())
        step = None
        if limits.max_slew is not None and steps is not None:
            step = limits.max_slew * per_volt * np.asarray(steps, dtype=np.float64)
        return Bounds(low, high, NEGLIGIBLE * (high - low), step)


def _held(plays: Floats) -> PlayState:
    return PlayState(0, None, tuple(plays.tolist()))


def _plays(node: Node) -> Stage:
    kind: Kind = node.text("type")  # type: ignore[assignment]
    more: tuple[str, ...] = ()
    if kind == "rate-plays":
        more = ("by_rate", "fastest")
    elif kind == "one-sided-plays":
        more = ("cubic", "linear")
    node.only(("type", "radii", "weights", *more))
    lists = {key: node.numbers(key) for key in ("radii", "weights", "by_rate") if key in node.values}
    numbers = {key: node.number(key) for key in ("fastest", "cubic", "linear") if key in node.values}
    stage: Stage = node.build(lambda: PlayOperator(kind, **lists, **numbers))  # type: ignore[arg-type]
    return stage


READERS = dict.fromkeys(KINDS, _plays)


def read_places(node: Node, model: RelativeModel) -> BacklashState:
    """Return what the plays of a model remember."""
    node.only(("places", "inverse_places", "wanted"))
    found = []
    for key in ("places", "inverse_places"):
        values = None if node.values[key] is None and key != "places" else node.numbers(key)
        if values is not None and len(values) != model.plays.n:
            raise node.refuse(key, f"has {len(values)} entries where the model has {model.plays.n} plays")
        found.append(values)
    wanted = None if node.values["wanted"] is None else node.number("wanted")
    places, inverse = found
    assert places is not None
    return PlayState(0, None, tuple(places), None if inverse is None else tuple(inverse), wanted)
