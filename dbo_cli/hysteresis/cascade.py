"""The cascade of stages: the scale stage, and what is asked of several stages at once."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.delay import DelayStage
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator, DiscretePointOperator


@dataclass(frozen=True)
class ScaleStage:
    """A gain and an offset: y = gain x + offset, as K and Y_0 in the paper's Section V.

    Raises
    ------
    ModelError
        The gain is 0, or a number is not finite; the message begins with the key.
    """

    gain: float
    offset: float

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        if not math.isfinite(self.gain) or self.gain == 0.0 or not math.isfinite(1.0 / self.gain):
            raise ModelError(f"gain: {self.gain!r} is not a finite number other than 0")
        if not math.isfinite(self.offset) or not math.isfinite(self.offset / self.gain):
            raise ModelError(f"offset: {self.offset!r} is not a finite number")

    def run(self, x: Floats) -> Floats:
        """Return the output for one block."""
        y: Floats = self.gain * x + self.offset
        return y

    def inverse(self) -> ScaleStage:
        """Return the stage that undoes this one, to rounding."""
        return ScaleStage(1.0 / self.gain, -self.offset / self.gain)


class OtherHysteresis(ABC):
    """A stage with another hysteresis than that of gears; its room runs the models it stands in."""

    inverted: bool

    @abstractmethod
    def inverse(self) -> OtherHysteresis:
        """Return the stage that undoes this one."""

    @abstractmethod
    def file_values(self) -> dict[str, Any]:
        """Return the stage as plain values for the model file, its ``type`` first."""


MemoryFreeStage = DiscretePointOperator | ScaleStage
MemoryFree = tuple[MemoryFreeStage, ...]
Stage = DiscreteBacklashOperator | MemoryFreeStage | DynamicsStage | DelayStage | OtherHysteresis


def memory_free(stages: Sequence[Stage]) -> MemoryFree:
    """Return the points and scales among stages."""
    return tuple(stage for stage in stages if isinstance(stage, DiscretePointOperator | ScaleStage))


def through(stages: Sequence[MemoryFreeStage], x: Floats) -> Floats:
    """Pass a block through memory-free stages."""
    for stage in stages:
        x = stage.run(x)
    return x


def least_slope(stage: MemoryFreeStage) -> float:
    """Return the least slope of a memory-free stage, without its sign."""
    if isinstance(stage, ScaleStage):
        return abs(stage.gain)
    return float(np.min(stage.dy / stage.dx))


def slow_output_range(stages: Sequence[Stage], v_min: float, v_max: float) -> tuple[float, float]:
    """Return the least and the greatest output of a forward cascade at rest at the ends of its input.

    Slowly: relaxation has come to rest at either end; dynamics and a delay do not matter. The voltage goes
    from empty to ``v_max``, then to ``v_min``; a negative gain exchanges the two.
    """
    place, operator = next((k, s) for k, s in enumerate(stages) if isinstance(s, DiscreteBacklashOperator))
    head, tail = memory_free(stages[:place]), memory_free(stages[place:])
    state, ends = operator.empty(), []
    for voltage in (v_max, v_min):
        y, after, _ = operator.run(through(head, np.array([voltage])), state)
        state = BacklashState(after.bits)
        ends.append(float(through(tail, y)[0]))
    return min(ends), max(ends)


class CoveredGears(NamedTuple):
    """The gears that a drive inside the covered range moves, and the bits of all others while it does."""

    operator: DiscreteBacklashOperator
    spare_bits: int

    def whole(self, state: BacklashState) -> BacklashState:
        """Return a state of the covered gears as a state of all gears."""
        return BacklashState(state.bits | self.spare_bits, state.memory)


def covered_gears(gears: DiscreteBacklashOperator, low: float, top: float) -> CoveredGears:
    """Return the gears of a forward operator that a drive from ``low`` to ``top`` moves.

    A model may have gears to spare, so that a drive that goes a little further turns there as it does
    inside. They come last in the table, so that the bits of the others keep their places. Where some reach
    below ``low``, the drive finds them engaged after one swing over the covered range, and there they stay.
    """
    core, bits, x0, y0 = gears, 0, gears.x0, gears.y0
    if low > gears.x0 + 0.5 * float(gears.dx[-1]):
        at_once = np.zeros((1, len(gears.relaxation.tau))) if gears.relaxation else None
        _, state, _ = gears.run([top, low], gears.empty(), decay=at_once)  # relaxation plays no part
        count = _gears_within(gears, top - low)
        if state.bits & ((1 << count) - 1) == 0:  # else the gears do not divide the range: nothing to spare
            bits, x0 = state.bits, low
            y0 = gears.coordinates(BacklashState(bits))[1]
    count = _gears_within(gears, top - x0)
    if count < gears.n or bits:
        core = DiscreteBacklashOperator(
            gears.dx[:count], gears.dy[:count], x0, y0, gears.relaxation, gears.memory_on
        )
    return CoveredGears(core, bits)


def _gears_within(gears: DiscreteBacklashOperator, width: float) -> int:
    """Return how many gears, the first ones, are needed to span ``width``."""
    count = int(np.searchsorted(np.cumsum(gears.dx), width - 0.5 * float(gears.dx[-1]))) + 1
    return min(count, gears.n)


def digest_of(stages: Sequence[Stage]) -> str:
    """Return a name for a forward cascade; a gain inverted twice may differ in its last digits."""
    parts: list[object] = []
    for stage in stages:
        if isinstance(stage, ScaleStage):
            parts.append([f"{stage.gain:.9e}", f"{stage.offset:.9e}"])
        elif isinstance(stage, DelayStage):
            parts.append(stage.seconds)
        elif isinstance(stage, DynamicsStage):
            parts.append([dataclasses.asdict(section) for section in stage.sections])
        elif isinstance(stage, OtherHysteresis):
            parts.append(stage.file_values())
        else:
            parts.append([stage.dx.tolist(), stage.dy.tolist(), stage.x0, stage.y0])
            if isinstance(stage, DiscreteBacklashOperator) and stage.relaxation:
                parts.append(dataclasses.asdict(stage.relaxation))
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
