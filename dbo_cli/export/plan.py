"""What a model comes to at a fixed time step: the numbers that every arithmetic is generated from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import ModelError, UsageError
from dbo_cli.model import Cascade, Gears, State
from dbo_cli.model.delay import AFTER, whole_and_part
from dbo_cli.model.dynamics import inverses_of
from dbo_cli.model.gears import Window, largest_step
from dbo_cli.model.undoing import SectionInverse

SPACING = 64  # turns that share a checkpoint
Loss = dict[str, float]
"""What fewer gears change, over test moves: the largest (max) and the RMS difference (rms) of the output."""
TRIALS = 20  # test moves over which the loss of fewer gears is taken: 5,000 samples
MORE_REST = 5  # samples before a move, from which on a delay knows its past


@dataclass(frozen=True)
class Plan:
    """The inverse of a model at one time step.

    Attributes
    ----------
    forward : Model
        The forward model.
    dt : float, or None
        Seconds between samples; None where nothing depends on them.
    limits : Limits
        Of the drive; the move's range and the slew count.
    """

    forward: Cascade
    dt: float | None
    limits: Limits

    @property
    def gears(self) -> Gears:
        """The gears; the operator that is exported has their axes exchanged."""
        return self.forward.gears

    @property
    def key(self) -> str:
        """The gears' key in the model file."""
        return f"stages[{self.forward.stages.index(self.gears)}]"

    @property
    def inner(self) -> Window:
        """The range of the drive as the gears meet it."""
        return self.forward.inner_limits(self.limits.move, None)[0]

    @property
    def inner_step(self) -> float | None:
        """The largest change of the gears' output in a step."""
        _, slew = self.forward.inner_limits(self.limits.move, self.limits.slew)
        step = largest_step(slew, self.dt)
        return None if step is None else float(step)

    @property
    def checkpoints(self) -> int:
        """How many checkpoints a state keeps of its turns, as dbo_kernel.h and dbo_q31.h have it."""
        return (self.gears.n - 1) // SPACING

    @cached_property
    def decay(self) -> Floats:
        """a_j = exp(-dt/tau_j)."""
        if self.gears.relaxation is None:
            return np.empty(0)
        assert self.dt is not None
        decay: Floats = self.gears.relaxation.decay(self.dt)[0]
        return decay

    @property
    def kappa(self) -> float:
        """The immediate part of the memory, sum c_j (1 - a_j), added term by term as the kernel does."""
        return float(sum((self.gears.gain * (1.0 - self.decay)).tolist()))

    # ---- reading ahead ----

    @cached_property
    def delay_samples(self) -> tuple[int, float]:
        """The delay in whole samples, and the part beyond."""
        if self.forward.delay is None:
            return 0, 0.0
        assert self.dt is not None
        return whole_and_part(self.forward.delay_seconds / self.dt)

    @cached_property
    def undone(self) -> list[SectionInverse]:
        """The inverse of each section of the dynamics, the last section first."""
        if self.forward.dynamics is None:
            return []
        assert self.dt is not None
        inverses = inverses_of(self.forward.dynamics.sections, self.dt)
        return list(reversed(inverses))

    @property
    def ahead(self) -> int:
        """How many samples earlier the input is needed: for the delay, and the dynamics."""
        samples, fraction = self.delay_samples
        rows = samples + (AFTER if fraction else 0)
        return rows + sum(inverse.weight.size for inverse in self.undone)

    # ---- starts and runs of the library, for the self-test ----

    @cached_property
    def empty(self) -> State:
        """The library's start ``empty``; no gear of the range is engaged."""
        low, high = self.limits.move
        return self.forward.start_drive(self.forward.output.min, "empty", low, high)

    @property
    def first_drive(self) -> float:
        """The drive of an actuator that has been at or below its lower end."""
        assert self.empty.drive is not None
        return self.empty.drive

    def resting(self, drive: float, bits: int) -> State:
        """Return the state of an actuator that rests at a drive, its gears coming from ``bits``."""
        at_gears = self.forward.head.value(drive)
        state = self.forward.gears.run([at_gears], State(bits)).state
        amplifier = None if self.forward.amplifier is None else drive
        return replace(state, drive=drive, amplifier=amplifier)

    def settled(self, drive: float) -> State:
        """Return the state after ``NAME_reset``."""
        bits = self.forward.starts.bits(self.forward.head.value(drive), "settled")
        return self.resting(drive, bits)

    @property
    def trimmed(self) -> float:
        """The drive that the self-test resets to: a little below the middle, inside of a gear."""
        low, high = self.limits.move
        return low + 0.37 * (high - low)

    def played(self, moves: Floats, state: State) -> Floats:
        """Return what the library drives for each input, as the exported step does, ahead."""
        before = np.full(self.ahead + MORE_REST, moves[0])
        rows = self.forward.inverter(self.dt).ahead
        after = np.full(rows - self.ahead, moves[-1])
        desired = np.concatenate([before, moves, after])
        target, _ = self.forward.inverter(self.dt).run(desired)
        static = self.forward.static
        move, slew = self.limits.move, self.limits.slew
        return static.drive(target[MORE_REST:], state, self.dt, move, slew).y


def plan_of(forward: Cascade, sample_rate: float | None, limits: Limits) -> Plan:
    """Return the plan of a forward model.

    Raises
    ------
    UsageError
        The sample rate is missing where something depends on it, or is no rate.
    ModelError
        A memory is too slow for the rate.
    """
    if sample_rate is not None and not 0.0 < sample_rate < math.inf:
        raise UsageError(f"`sample_rate` {sample_rate:g}: give a number of Hz above 0")
    timed = forward.needs_time or limits.slew is not None
    if timed and sample_rate is None:
        raise UsageError("the drive depends on time: add `sample_rate` HZ")
    dt = None if sample_rate is None else 1.0 / sample_rate
    plan = Plan(replace(forward, candidates=()), dt, limits)
    if np.any(plan.decay >= 1.0):
        raise ModelError(
            f"{plan.key}.relaxation.tau: too slow for {sample_rate:g} Hz: lower `sample_rate`"
        )
    return plan


def trial_moves(low: float, high: float, seed: int = 1) -> Floats:
    """Return inputs between ``low`` and ``high`` and a little beyond: about 300 samples, always the same.

    A slow sweep there and back, an oscillation that decays around the middle, a random
    walk, random jumps, a turn at each end exactly, a rest, and 3 % beyond either end.
    """
    rng = np.random.default_rng(seed)
    up = np.linspace(0.0, 1.0, 31)
    time = np.arange(80.0)
    decaying = 0.5 + 0.5 * np.exp(-time / 30.0) * np.cos(0.55 * time)
    walk = 0.5 + np.cumsum(rng.normal(0.0, 0.02, 70))
    parts = [
        up, up[::-1], decaying, np.clip(walk, 0.0, 1.0), rng.uniform(0.0, 1.0, 30),
        np.array([0.0, 1.0, 0.4, 1.0, 0.0, 0.6, 0.2]), np.full(8, 0.3),
        np.array([1.0, 1.03, 0.9, -0.03, 0.1, 0.7]),
    ]  # fmt: skip
    return low + (high - low) * np.concatenate(parts)


def with_fewer_gears(forward: Cascade, gears: int) -> tuple[Cascade, Loss | None]:
    """Return a forward model with ``gears`` even gears on the same loading curve, and what is lost.

    The loading curve keeps its value at every new breakpoint; turns between them are
    what gets coarser. Gears beyond the range are left out.

    Raises
    ------
    UsageError
        ``gears`` is not between 1 and the number that the model has.
    """
    full = forward.gears
    if not 1 <= gears <= full.n:
        raise UsageError(f"`gears` {gears}: give 1 to {full.n}")
    if gears == full.n:
        return forward, None
    low, high = forward.starts.inside.x_range
    width = (high - low) / gears
    bare = Gears(full.dx, full.dy, full.x0, full.y0)
    sweep = low + width * np.arange(gears + 1.0)
    up = bare.run(sweep, State(forward.starts.empty)).y
    widths, heights = np.full(gears, width), np.diff(up)
    fewer = Gears(widths, heights, low, float(up[0]), full.relaxation)
    stages = tuple(
        fewer if isinstance(stage, Gears) else stage for stage in forward.stages
    )
    reduced = forward.with_stages(stages)
    return reduced, _loss(forward, reduced)


def _loss(full: Cascade, fewer: Cascade) -> Loss:
    """Return the difference of two forward models."""
    step = None
    if full.gears.relaxation is not None:
        step = max(full.gears.relaxation.tau)
    moves = []
    for seed in range(TRIALS):
        moves.append(trial_moves(full.input.min, full.input.max, seed))
    x = np.concatenate(moves)
    exact, _ = full.static.simulate(x, dt=step)
    coarse, _ = fewer.static.simulate(x, dt=step)
    error = coarse - exact
    return {"max": float(np.abs(error).max()), "rms": float(np.sqrt(np.mean(error**2)))}
