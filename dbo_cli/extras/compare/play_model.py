"""A model whose hysteresis is a weighted sum of plays: what ``ActuatorModel`` is to the gears.

Forward: a scale that brings the drive to the operator's range, the plays, points
(superposed dead zones are a curve of straight pieces) and scales, then perhaps a delay.
A straight line is one play of radius 0. With plays in the place of its gears a model of
gears keeps all other stages (``with_plays``). The commands take such a model as any
other; what is made for gears alone (``export``, the live controller) refuses it. Files
have the stage and its state as in docs/model-file.md: ``hysteresis.model_file`` asks
here when a file has a stage that it does not know.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.extras.compare.plays import NOTHING, Kind, PlayOperator, PlayState
from dbo_cli.hysteresis.cascade import DelayStage, ScaleStage, Stage, through
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.model import NEGLIGIBLE, ActuatorModel, PointStage, Steps
from dbo_cli.hysteresis.model_file import Node, StageInFiles, read_relaxation
from dbo_cli.hysteresis.model_state import (
    START_NAMES,
    DriveLimits,
    ModelState,
    StartName,
)
from dbo_cli.hysteresis.operators import (
    BacklashState,
    Counts,
    Floats,
    OutputLimits,
    Outside,
)


class RelativeModel(ActuatorModel):
    """A cascade with one stage of plays in the place of the gears; see ``ActuatorModel`` for what it does.

    Raises
    ------
    ModelError
        The cascade is not of that form; the message begins with the key.
    """

    has_gears = False

    def __post_init__(self) -> None:
        """Check the order of the stages; the direction tells how the plays act."""
        plays = [
            k for k, stage in enumerate(self.stages) if isinstance(stage, PlayOperator)
        ]
        if len(plays) != 1:
            raise ModelError("stages: exactly one stage of plays must be among them")
        self._take_apart(plays[0])
        for place, stage in enumerate(self.stages):
            if isinstance(stage, PlayOperator):
                if stage.relaxation is not None and stage.inverted == (
                    self.direction == "forward"
                ):
                    axis = "input" if stage.inverted else "output"
                    raise ModelError(
                        f"stages[{place}].relaxation.on: must be {axis!r} in this direction"
                    )
                self._turn(stage)
            elif not isinstance(
                stage, ScaleStage | PointStage | DynamicsStage | DelayStage
            ):
                raise ModelError(f"stages[{place}]: gears and plays do not go together")

    @cached_property
    def plays(self) -> PlayOperator:
        """The stage of plays."""
        return next(stage for stage in self.stages if isinstance(stage, PlayOperator))

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
        parts = (
            self.plays.by_rate.size,
            self.plays.relaxation,
            self.dynamics,
            self.drive_lag,
        )
        return any(parts) or (self.is_forward and self.delay_seconds > 0.0)

    @property
    def drive_end(self) -> float:
        """Upper end of the operator's range, in the drive's unit."""
        forward = self if self.is_forward else self.inverted
        return float(through(forward.head_inverse, np.array([1.0]))[0])

    def start(
        self,
        first_input: float,
        state: StartName | ModelState = "auto",
        limits: DriveLimits | None = None,
    ) -> ModelState:
        """Return the state before the first sample; see ``ActuatorModel.start``.

        ``settled`` beyond the end of the range is ``empty`` or ``full``, so that
        ``auto`` is ``settled``.
        """
        if isinstance(state, ModelState):
            return state
        if state not in START_NAMES:
            raise ModelError(
                f"no initial state is called {state!r}; there are: {', '.join(START_NAMES)}"
            )
        operator = self.plays
        if state in ("empty", "full"):
            end = operator.low if state == "empty" else 1.0
            return ModelState(_standing(operator.after(end)))
        value = float(self._before_backlash([first_input])[0])
        if self.direction == "inverse":
            value = operator.settled_at(value)
            if limits is not None:
                bound = self.inner_limits(limits)
                value = min(max(value, bound.v_min), bound.v_max)
        return ModelState(_standing(operator.settled(value)))

    def start_compensation(
        self, first_desired: float, state: StartName | ModelState, limits: DriveLimits
    ) -> ModelState:
        """Return the state of ``compensate`` in which ``simulate`` of its output starts."""
        self.require("forward")
        begun = self.inverted.start(first_desired, state, limits)
        if state in ("empty", "full") and limits.max_slew is not None:
            end = self.plays.low if state == "empty" else 1.0
            begun = dataclasses.replace(begun, drive=end)
        return begun

    def start_spread(self, begun: ModelState, first_input: float) -> float:
        """Return by how much the displacement at rest, where a run begins, depends on what was before."""
        operator = self.plays
        forward = self if self.is_forward else self.inverted
        value = float(self._before_backlash([first_input])[0])
        if self.direction == "inverse":
            value = operator.settled_at(value)
        ends = [
            operator.slow_output(value, operator.after(end))
            for end in (operator.low, 1.0)
        ]
        low, high = through(forward.tail, np.array(ends)).tolist()
        return float(abs(high - low))

    @cached_property
    def _covered(self) -> tuple[float, float]:
        return self.input.minimum, self.input.maximum

    def _held(self, x: Floats) -> Floats:
        ends = through(self.head, np.array(self._covered))
        return np.clip(x, ends.min(), ends.max())

    def inner_limits(self, limits: DriveLimits) -> DriveLimits:
        """Return limits on the drive as the plays of an inverse model give it."""
        if any(isinstance(stage, PointStage) for stage in self.tail):
            return super().inner_limits(limits)
        ends = through(self.tail_inverse, np.array([limits.v_min, limits.v_max]))
        slew = limits.max_slew
        if slew is not None:
            slew *= abs(float(ends[1] - ends[0])) / (limits.v_max - limits.v_min)
        return DriveLimits(float(ends.min()), float(ends.max()), slew)

    def _backlash_block(
        self,
        x: Floats,
        state: ModelState,
        steps: Steps | None,
        outside: Outside,
        limits: DriveLimits | None,
        room: Floats | None = None,
    ) -> tuple[Floats, ModelState, Counts, float]:
        """Pass a block through the plays, in the model's direction."""
        if x.size == 0:
            return x, state, Counts(), 0.0
        operator, before = self.plays, state.backlash
        if not isinstance(before, PlayState) or len(before.plays) != operator.n:
            raise ModelError("state: is not one of this model's plays")
        plays, clipped = np.array(before.plays), (0, 0)
        if self.direction == "forward":
            share = self._share(
                x, plays[0] if state.drive is not None else None, steps, 1.0
            )
            y, plays = operator.run(x, plays, share)
            after = _standing(plays)
            if operator.relaxation is not None and steps is not None:
                added, memory = operator.remembered(x, before.memory, steps)
                y, after = y + added, dataclasses.replace(after, memory=memory)
        elif operator.relaxation is not None and steps is not None:
            bounds = _bounds(limits, steps) or OutputLimits()
            y, after, clipped = operator.solve_beside(
                x, before, steps, bounds, state.drive
            )
        elif operator.kind == "plays" and limits is None:
            closed = operator.closed_inverse
            states = closed.states_of(plays)
            if before.inverse_plays:
                states = np.array(before.inverse_plays)
            y, states = closed.run(x, states)
            places = tuple(closed.plays_of(states).tolist())
            after = PlayState(0, None, places, tuple(states.tolist()))
        else:
            low, high = operator.ends
            share = self._share(
                x, before.wanted, steps, (high - low) / (1.0 - operator.low)
            )
            y, plays, clipped = operator.solve(
                x, plays, share, _bounds(limits, steps), state.drive
            )
            after = dataclasses.replace(_standing(plays), wanted=float(x[-1]))
        moved = dataclasses.replace(
            state, backlash=after, drive=after.plays[0], time=None
        )
        return y, moved, Counts(0, 0, *clipped), 0.0

    def _share(
        self, signal: Floats, last: float | None, steps: Steps | None, slope: float
    ) -> Floats:
        """Return the share of ``by_rate`` in every sample: the rate over the fastest one, at most 1.

        An inverse knows the rate of what is wanted, and takes the drive's for that over
        the loop's ``slope``.
        """
        operator = self.plays
        if not operator.by_rate.size:
            return NOTHING
        assert steps is not None
        if last is None:
            last = signal[0]
        change = np.abs(np.diff(signal, prepend=last))
        reach = np.broadcast_to(
            np.asarray(steps) * (operator.fastest * slope), signal.shape
        )
        share = np.divide(change, reach, out=np.zeros(signal.size), where=reach > 0.0)
        return np.minimum(share, 1.0)


def _bounds(limits: DriveLimits | None, steps: Steps | None) -> OutputLimits | None:
    """Return what the drive may do in each sample."""
    if limits is None:
        return None
    step = None
    if limits.max_slew is not None and steps is not None:
        step = limits.max_slew * np.asarray(steps, dtype=np.float64)
    return OutputLimits(
        limits.v_min, limits.v_max, step, NEGLIGIBLE * (limits.v_max - limits.v_min)
    )


def _standing(plays: Floats) -> PlayState:
    return PlayState(0, None, tuple(plays.tolist()))


def with_plays(model: ActuatorModel) -> RelativeModel:
    """Return a forward model of gears with one play for each of their slopes, every other stage kept.

    After a turn both follow one curve: slope s_i begins where d_i is travelled, and so
    does a play of radius d_i/2 and weight s_i - s_(i-1). The scaled drive goes from -1
    to 1 over the gears that the drive moves; what differs is a turn inside a gear.
    """
    gears = model.covered_gears
    slopes, travelled = gears.dy / gears.dx, np.cumsum(gears.dx)
    begins = np.flatnonzero(np.diff(slopes, prepend=0.0))
    per_volt = 2.0 / float(travelled[-1])
    radii = np.append(0.0, travelled)[begins] / travelled[-1]
    weights = np.diff(slopes[begins], prepend=0.0) / per_volt
    terms = gears.relaxation
    if terms is not None:
        reference, gain = (
            per_volt * (terms.reference - gears.x0) - 1.0,
            np.array(terms.gain) / per_volt,
        )
        terms = dataclasses.replace(
            terms, reference=reference, gain=tuple(gain.tolist())
        )
    plays = PlayOperator("plays", radii, weights, relaxation=terms)
    empty = float(weights @ (radii - 1.0))
    placed = (
        ScaleStage(per_volt, -1.0 - per_volt * gears.x0),
        plays,
        ScaleStage(1.0, gears.y0 - empty),
    )
    place = model.stages.index(model.backlash)
    stages = (*model.stages[:place], *placed, *model.stages[place + 1 :])
    return RelativeModel("forward", model.input, model.output, stages)


def _plays(node: Node) -> Stage:
    kind: Kind = node.text("type")  # type: ignore[assignment]
    required = ["type", "radii", "weights"]
    optional: tuple[str, ...] = ()
    if kind == "rate-plays":
        required += ["by_rate", "fastest"]
    elif kind == "one-sided-plays":
        required += ["cubic", "linear"]
    elif kind == "plays":
        optional = ("relaxation",)
    node.only(tuple(required), optional)
    values: dict[str, Any] = {}
    for key in ("radii", "weights", "by_rate"):
        if key in node.values:
            values[key] = node.numbers(key)
    for key in ("fastest", "cubic", "linear"):
        if key in node.values:
            values[key] = node.number(key)
    if "relaxation" in node.values:
        values["relaxation"], axis = read_relaxation(node, "relaxation")
        values["inverted"] = axis == "output"
    stage: Stage = node.build(lambda: PlayOperator(kind, **values))
    return stage


def read_places(node: Node, model: RelativeModel) -> BacklashState:
    """Return what the plays of a model remember."""
    terms = model.plays.relaxation
    node.only(
        ("places", "inverse_places", "wanted"),
        ("memory",) if terms else (),
    )
    places = tuple(node.numbers("places"))
    inverse = None
    if node.values["inverse_places"] is not None:
        inverse = tuple(node.numbers("inverse_places"))
    for key, values in (("places", places), ("inverse_places", inverse)):
        if values is not None and len(values) != model.plays.n:
            raise node.refuse(
                key,
                f"has {len(values)} entries where the model has {model.plays.n} plays",
            )
    wanted = memory = None
    if node.values["wanted"] is not None:
        wanted = node.number("wanted")
    if "memory" in node.values:
        memory = tuple(node.numbers("memory"))
    if memory is not None and terms and len(memory) != len(terms.tau):
        raise node.refuse(
            "memory",
            f"has {len(memory)} entries, and not as many as the model's relaxation",
        )
    return PlayState(0, memory, places, inverse, wanted)


IN_FILES = StageInFiles(_plays, RelativeModel, read_places)
"""How model and state files of plays are read."""
