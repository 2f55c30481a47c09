"""What a model comes to at a fixed time step: the constants that every arithmetic is generated from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError, UsageError
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.delay import DelayStage
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    DiscretePointOperator,
)

Floats = NDArray[np.float64]
Direction = Literal["forward", "inverse"]


@dataclass(frozen=True)
class CascadePlan:
    """One direction of a model at one time step.

    Attributes
    ----------
    model : ActuatorModel
        The model in the direction that is exported.
    time_step : float, or None
        Seconds between samples; None where nothing depends on them.
    limits : DriveLimits, or None
        Of an inverse: range and slew of the drive. A forward model has none.
    inner_limits : DriveLimits, or None
        The same as the backlash stage meets them, before the stages behind it.
    covered : int
        Gears that take part in a settled start: the first ones. Those beyond the model's voltages do not.
    spare_bits : int
        The bits of those others: they stay engaged while the drive is within the model's voltages.
    start_drive : float
        The drive at which none of the covered gears is engaged, as the backlash stage meets it.
    delay : float
        Seconds of the output's delay. A forward export delays its output; an inverse reads ahead.
    """

    model: ActuatorModel
    time_step: float | None
    limits: DriveLimits | None
    inner_limits: DriveLimits | None
    covered: int
    spare_bits: int
    start_drive: float
    delay: float

    @property
    def direction(self) -> Direction:
        """The direction that is exported."""
        return self.model.direction

    @property
    def backlash(self) -> DiscreteBacklashOperator:
        """The backlash stage in that direction."""
        return self.model.backlash

    @property
    def head(self) -> MemoryFree:
        """The memory-free stages before the backlash stage."""
        return self.model._head

    @property
    def tail(self) -> MemoryFree:
        """The memory-free stages behind it."""
        return self.model._tail

    @property
    def terms(self) -> int:
        """How many relaxation terms there are."""
        return len(self.backlash.relaxation.tau) if self.backlash.relaxation else 0

    @property
    def gain(self) -> Floats:
        """c_j, output of the forward backlash stage per unit of its input."""
        return np.array(self.backlash.relaxation.gain if self.backlash.relaxation else (), dtype=np.float64)

    @property
    def decay(self) -> Floats:
        """a_j = exp(-dt/tau_j)."""
        relaxation = self.backlash.relaxation
        if relaxation is None or self.time_step is None:
            return np.empty(0)
        factors: Floats = relaxation.decay(self.time_step)[0]
        return factors

    @property
    def reference(self) -> float:
        """The drive, as the backlash stage meets it, at which nothing is remembered."""
        return self.backlash.relaxation.reference if self.backlash.relaxation else 0.0

    @property
    def slew_step(self) -> float | None:
        """The largest change of the backlash stage's output in one step."""
        if self.inner_limits is None or self.inner_limits.max_slew is None or self.time_step is None:
            return None
        return self.inner_limits.max_slew * self.time_step

    def inner_drive(self, drive: float) -> float:
        """Return a drive (V) as the backlash stage meets it."""
        if self.direction == "forward":
            return float(through(self.head, np.array([drive]))[0])
        return float(through(_undone(self.tail), np.array([drive]))[0])

    def empty_state(self) -> tuple[BacklashState, float]:
        """Return the state before any covered gear is engaged, nothing remembered, and the drive there."""
        return BacklashState(self.spare_bits, (0.0,) * self.terms if self.terms else None), self.start_drive

    def spare_words(self, width: int) -> list[str]:
        """Return the spare gears' bits as C constants of ``width`` bits; empty where there are none."""
        if not self.spare_bits:
            return []
        count, mask = -(-self.backlash.n // width), (1 << width) - 1
        form = "UINT64_C(0x{:x})" if width == 64 else "0x{:x}U"
        return [form.format(self.spare_bits >> width * k & mask) for k in range(count)]


def _undone(stages: MemoryFree) -> MemoryFree:
    return tuple(stage.inverse() for stage in reversed(stages))


_KINDS = DiscreteBacklashOperator | DiscretePointOperator | ScaleStage | DynamicsStage | DelayStage


def plan_cascade(
    model: ActuatorModel,
    direction: Direction,
    sample_rate: float | None,
    limits: DriveLimits | None,
) -> CascadePlan:
    """Return the plan of one direction of a model; limits are for an inverse.

    Raises
    ------
    UsageError
        The sample rate is missing where something depends on it, or is no rate; limits for a forward model.
    ModelError
        A stage cannot be exported.
    """
    if sample_rate is not None and not (math.isfinite(sample_rate) and sample_rate > 0.0):
        raise UsageError(f"`sample_rate` {sample_rate!r}: must be a frequency in Hz greater than 0")
    turned = model if model.direction == direction else model.inverse()
    _ = turned.backlash  # a model that has no gears says so
    for place, stage in enumerate(turned.stages):
        if not isinstance(stage, _KINDS):
            raise ModelError(f"stages[{place}]: a {type(stage).__name__} cannot be exported")
    if direction == "forward" and limits is not None:
        raise UsageError("limits on the drive belong to `direction` inverse")
    timed = turned.needs_time or (limits is not None and limits.max_slew is not None)
    if timed and sample_rate is None:
        raise UsageError("the model depends on the time between samples: give `sample_rate` in Hz")
    backlash = turned.backlash
    delay, covered = turned.delay_seconds, turned._covered_gears
    plan = CascadePlan(
        turned,
        None if sample_rate is None else 1.0 / sample_rate,
        limits,
        None if limits is None else turned.inner_limits(limits),
        covered.operator.n,
        covered.spare_bits,
        covered.operator.x0,
        delay,
    )
    if backlash.relaxation is not None and np.any(plan.decay >= 1.0):
        raise ModelError(
            f"relaxation.tau: {max(backlash.relaxation.tau)!r} s is too slow for {sample_rate!r} Hz"
            " (`sample_rate` lower)"
        )
    return plan
