"""What a model comes to at a fixed time step: the constants that every arithmetic is generated from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from dbo_cli.errors import ModelError, UsageError
from dbo_cli.hysteresis.cascade import (
    DelayStage,
    MemoryFree,
    ScaleStage,
    through,
    whole_and_part,
)
from dbo_cli.hysteresis.dynamics import DynamicsInverter, DynamicsStage
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits, ModelState, Quantity
from dbo_cli.hysteresis.operators import (
    BacklashState,
    DiscreteBacklashOperator,
    DiscretePointOperator,
)

Direction = Literal["forward", "inverse"]

_TRIALS = 20  # test moves over which the loss of fewer gears is taken: 5,000 samples
# an input so many ranges away counts as no number: what it leads to is not finite
_IGNORED_BEYOND = 1e6


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
    gain, decay : array
        Of each relaxation term c_j, output of the forward backlash stage per unit of
        its input, and a_j = exp(-dt/tau_j).
    reference : float
        The drive, as the backlash stage meets it, at which nothing is remembered.
    """

    model: ActuatorModel
    time_step: float | None
    limits: DriveLimits | None
    gain: Floats
    decay: Floats
    reference: float

    @property
    def drive_stages(self) -> MemoryFree:
        """The memory-free stages from a drive to the backlash stage."""
        return self.model.head if self.model.is_forward else self.model.tail_inverse

    @cached_property
    def inner_limits(self) -> DriveLimits | None:
        """The limits as the backlash stage meets them, before the stages behind it."""
        if self.limits is None:
            return None
        return self.model.inner_limits(self.limits)

    @property
    def delay_samples(self) -> tuple[int, float] | None:
        """A forward model's delay as the delay stage counts: whole samples and the part beyond; or None."""
        if not self.model.is_forward or self.model.delay_seconds == 0.0:
            return None
        assert self.time_step is not None
        return whole_and_part(self.model.delay_seconds / self.time_step)

    @property
    def delay_is_smooth(self) -> bool:
        """Whether a forward model's delay takes values between samples, and smoothly."""
        whole_and_rest = self.delay_samples
        if whole_and_rest is None or not whole_and_rest[1]:
            return False
        return self.model.delay is not None and self.model.delay.between == "smooth"

    @property
    def terms(self) -> int:
        """How many relaxation terms there are."""
        return self.gain.size

    @property
    def kappa(self) -> float:
        """The immediate part of the memory on an inverse's output: sum c_j (1 - a_j), term by term."""
        if self.model.backlash.memory_on == "input":
            return 0.0
        return float(sum((self.gain * (1.0 - self.decay)).tolist()))

    @property
    def slew_step(self) -> float | None:
        """The largest change of the backlash stage's output in one step."""
        if self.inner_limits is None:
            return None
        return self.inner_limits.largest_change(self.time_step)

    @cached_property
    def inverter(self) -> DynamicsInverter | None:
        """What undoes the dynamics of an inverse model, or None."""
        if self.model.is_forward or self.model.dynamics is None:
            return None
        assert self.time_step is not None
        return self.model.dynamics.inverter(self.time_step)

    @property
    def read_ahead(self) -> float:
        """How many seconds earlier an inverse needs its input: for its delay, and its dynamics."""
        if self.model.is_forward:
            return 0.0
        if self.inverter is None:
            return self.model.delay_seconds
        undoing = self.inverter.ahead * self.inverter.time_step
        return self.model.delay_seconds + undoing

    @property
    def first_output(self) -> float:
        """The output after a rest at the lower end, no covered gear engaged."""
        covered = self.model.covered_gears
        at = covered.y0 if self.model.is_forward else covered.x0
        y = float(through(self.model.tail, np.array([at]))[0])
        if self.limits is None:
            return y
        return min(max(y, self.limits.v_min), self.limits.v_max)

    @property
    def trimmed_drive(self) -> float:
        """The drive that the self-test resets to: a little below the middle, inside of a gear."""
        return self.model.drive.minimum + 0.37 * self.model.drive.span

    def empty_state(self) -> ModelState:
        """Return the state of ``NAME_init``: no covered gear engaged, nothing remembered."""
        state = BacklashState(self.model.spare_bits, self._memories(0.0))
        return ModelState(state, drive=self.model.covered_gears.x0)

    def _memories(self, value: float) -> tuple[float, ...] | None:
        """Return a memory in which every term remembers ``value``; None without terms."""
        if not self.terms:
            return None
        return (value,) * self.terms

    def settled_state(self, drive: float) -> ModelState:
        """Return the state of ``NAME_reset``: settled and at rest at a drive (V)."""
        inner = float(through(self.drive_stages, np.array([drive]))[0])
        covered = self.model.covered_gears
        start = covered.empty() if inner <= covered.x0 else covered.settled(inner)
        start = self.model.of_all_gears(start)
        _, after, _ = self.model.forward_backlash.run([inner], start)
        state = BacklashState(
            after.bits, self._memories(0.0 + (inner - self.reference))
        )
        begun = ModelState(state, drive=inner)
        if self.model.drive_lag is None:
            return begun
        return replace(begun, drive_lag=((drive, 0.0, drive),))

    def spare_words(self, width: int) -> list[str]:
        """Return the spare gears' bits as C constants of ``width`` bits; empty where there are none."""
        bits = self.model.spare_bits
        if not bits:
            return []
        count = -(-self.model.backlash.n // width)
        mask = (1 << width) - 1
        form = "UINT64_C(0x{:x})" if width == 64 else "0x{:x}U"
        return [form.format(bits >> width * k & mask) for k in range(count)]


_KINDS = (
    DiscreteBacklashOperator
    | DiscretePointOperator
    | ScaleStage
    | DynamicsStage
    | DelayStage
)


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
        The sample rate is missing where something depends on it, or is no rate; limits
        for a forward model.
    ModelError
        A stage cannot be exported.
    """
    if sample_rate is not None and not (
        math.isfinite(sample_rate) and sample_rate > 0.0
    ):
        raise UsageError(
            f"`sample_rate` {sample_rate!r}: must be a frequency in Hz greater than 0"
        )
    turned = model
    if model.direction != direction:
        turned = model.inverse()
    relaxation = turned.backlash.relaxation  # a model that has no gears is refused here
    for place, stage in enumerate(turned.stages):
        if not isinstance(stage, _KINDS):
            raise ModelError(
                f"stages[{place}]: a {type(stage).__name__} cannot be exported"
            )
    if direction == "forward" and limits is not None:
        raise UsageError("limits on the drive belong to `direction` inverse")
    timed = turned.needs_time or (limits is not None and limits.max_slew is not None)
    if timed and sample_rate is None:
        raise UsageError(
            "the model depends on the time between samples: give `sample_rate` in Hz"
        )
    step = None if sample_rate is None else 1.0 / sample_rate
    if relaxation is None:
        return CascadePlan(turned, step, limits, np.empty(0), np.empty(0), 0.0)
    assert step is not None
    decay = relaxation.decay(step)[0]
    if np.any(decay >= 1.0):
        raise ModelError(
            f"relaxation.tau: {max(relaxation.tau)!r} s is too slow for {sample_rate!r} Hz"
            " (`sample_rate` lower)"
        )
    gain = np.array(relaxation.gain, dtype=np.float64)
    return CascadePlan(turned, step, limits, gain, decay, relaxation.reference)


def ignored_beyond(quantity: Quantity) -> str:
    """Return the C constant beyond which a value counts as no number: a power of two, in decimals."""
    largest = _IGNORED_BEYOND * max(
        quantity.span, abs(quantity.minimum), abs(quantity.maximum)
    )
    # 2^126 is a float32, too
    return repr(2.0 ** min(math.ceil(math.log2(largest)), 126))


def self_test_moves(low: float, high: float, seed: int = 1) -> Floats:
    """Return inputs between ``low`` and ``high`` and a little beyond: about 300 samples, always the same.

    A slow sweep there and back, an oscillation that decays around the middle, a random
    walk, random jumps, a turn at each end exactly, a rest, and 3 % beyond either end.
    """
    rng = np.random.default_rng(seed)
    span = high - low
    up = np.linspace(0.0, 1.0, 31)
    decaying = 0.5 + 0.5 * np.exp(-np.arange(80) / 30.0) * np.cos(np.arange(80) * 0.55)
    walk = 0.5 + np.cumsum(rng.normal(0.0, 0.02, 70))
    parts = [
        up, up[::-1], decaying, np.clip(walk, 0.0, 1.0), rng.uniform(0.0, 1.0, 30),
        np.array([0.0, 1.0, 0.4, 1.0, 0.0, 0.6, 0.2]), np.full(8, 0.3),
        np.array([1.0, 1.03, 0.9, -0.03, 0.1, 0.7]),
    ]  # fmt: skip
    return low + span * np.concatenate(parts)


def with_fewer_gears(
    model: ActuatorModel, gears: int
) -> tuple[ActuatorModel, dict[str, float]]:
    """Return a forward model with ``gears`` even gears on the same loading curve, and what is lost.

    The loading curve keeps its value at every new breakpoint; turns between them are
    what gets coarser. The loss is the difference of the two models' outputs over 20
    test moves: ``max``, ``rms`` in the output's unit, and ``max_percent`` of its range.

    Raises
    ------
    UsageError
        ``gears`` is not between 1 and the number that the model has.
    """
    full = model.forward_backlash
    if not 1 <= gears <= full.n:
        raise UsageError(
            f"`gears` {gears}: the model has {full.n}; give a number from 1 to that"
        )
    forward = model if model.is_forward else model.inverse()
    if gears == full.n:
        return forward, {}
    across = np.concatenate([[0.0], np.cumsum(full.dx)])
    up = np.concatenate([[0.0], np.cumsum(full.dy)])
    ends = across[-1] * np.arange(gears + 1) / gears
    heights = np.diff(np.interp(ends, across, up))
    reduced = DiscreteBacklashOperator(
        np.full(gears, across[-1] / gears),
        heights,
        full.x0,
        full.y0,
        full.relaxation,
        "input",
    )
    stages = list(forward.stages)
    stages[stages.index(forward.backlash)] = reduced
    fewer = replace(forward, stages=tuple(stages))
    return fewer, _loss(forward, fewer)


def _loss(full: ActuatorModel, fewer: ActuatorModel) -> dict[str, float]:
    differences = []
    step = None
    if full.backlash.relaxation:
        step = max(full.backlash.relaxation.tau)
    elif full.needs_time:
        step = max(full.delay_seconds, 1e-9)  # any step will do for a delay alone
    for seed in range(_TRIALS):
        moves = self_test_moves(full.input.minimum, full.input.maximum, seed)
        first = float(moves[0])
        exact = full.simulate(moves, full.start(first), time_step=step).y
        coarse = fewer.simulate(moves, fewer.start(first), time_step=step).y
        differences.append(coarse - exact)
    every = np.concatenate(differences)
    worst = float(np.max(np.abs(every)))
    rms = float(np.sqrt(np.mean(every**2)))
    return {"max": worst, "rms": rms, "max_percent": 100.0 * worst / full.output.span}
