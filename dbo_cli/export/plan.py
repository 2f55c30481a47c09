"""What a model comes to at a fixed time step: the numbers that every arithmetic is generated from."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import UsageError, require_positive
from dbo_cli.model import Cascade, Gears, Quantity, State
from dbo_cli.model.delay import AFTER, whole_and_part
from dbo_cli.model.dynamics import SectionInverse, inverses_of
from dbo_cli.model.gears import largest_step

COUNTS = 2.0**30
"""From the middle of a range to its end; that leaves a factor of two beyond it."""
SPACING = 64  # turns that share a checkpoint
Loss = dict[str, float]
"""What fewer gears change, over test moves: the largest (max) and the RMS difference (rms) of the output."""
TRIALS = 20  # test moves over which the loss of fewer gears is taken: 5,000 samples
MORE_REST = 5  # samples before a move, from which on a delay knows its past
TRIMMED = 0.37
"""Of the drive's range: the self-test resets to a little below the middle, inside of a gear."""


SelfTestRun = tuple[float | None, Floats, Floats]
"""The drive given to reset (None: init), what goes in, and what the library drives for it."""


class Grid(NamedTuple):
    """Whole counts of a quantity: count k is ``offset + k unit``."""

    offset: float
    unit: float

    @classmethod
    def of(cls, quantity: Quantity) -> Grid:
        """Return the counts of a quantity, 2^30 to either side of the middle of its range."""
        return cls(0.5 * (quantity.min + quantity.max), 0.5 * quantity.span / COUNTS)

    def count(self, value: float) -> int:
        """Return the nearest count, saturating at 32 bits."""
        return min(max(round((value - self.offset) / self.unit), -(2**31)), 2**31 - 1)

    def value(self, count: float) -> float:
        """Return the value of a count."""
        return count * self.unit + self.offset


class Plan:
    """The inverse of a model at one time step.

    Parameters
    ----------
    forward : Model
        The forward model.
    sample_rate : float, optional
        Steps a second (Hz); needed where something depends on time.
    limits : Limits
        Of the drive; the move's range and the slew count.

    Attributes
    ----------
    dt : float, or None
        Seconds between samples; None where nothing depends on them.
    gears, key : Gears, str
        The gears, and their key in the model file; the operator that is exported has their
        axes exchanged.
    window, step : (float, float), float or None
        The range of the drive as the gears meet it, and the largest change of their output
        in a step.
    decay : array
        a_j = exp(-dt/tau_j).
    kappa : float
        The immediate part of the memory, sum c_j (1 - a_j).
    delay_part : float
        The part of the delay beyond whole samples.
    undone : tuple of SectionInverse
        The inverse of each section of the dynamics, the last section first.
    ahead : int
        How many samples earlier the input is needed: for the delay, and the dynamics.
    empty : State
        The library's start ``empty``; no gear of the range is engaged.
    first_drive : float
        The drive of an actuator that has been at or below its lower end.

    Raises
    ------
    UsageError
        The sample rate is missing where something depends on it, or is no rate.
    InputError
        The rate does not resolve the dynamics.
    """

    def __init__(
        self, forward: Cascade, sample_rate: float | None, limits: Limits
    ) -> None:
        require_positive(sample_rate=sample_rate)
        if sample_rate is None and (forward.needs_time or limits.slew is not None):
            raise UsageError("the drive depends on time: add `sample_rate` HZ")
        self.forward = replace(forward, candidates=())
        self.limits = limits
        self.dt = dt = None if sample_rate is None else 1.0 / sample_rate
        self.gears = gears = forward.gears
        self.key = f"stages[{forward.stages.index(gears)}]"
        self.window, slew = forward.inner_limits(limits.move, limits.slew)
        step = largest_step(slew, dt)
        self.step = None if step is None else float(step)
        self.decay, samples, self.delay_part = np.empty(0), 0, 0.0
        self.undone: tuple[SectionInverse, ...] = ()
        if dt is not None:
            samples, self.delay_part = whole_and_part(forward.delay_seconds / dt)
            if gears.relaxation is not None:
                self.decay = gears.relaxation.decay(dt)[0]
            if forward.dynamics is not None:
                self.undone = inverses_of(forward.dynamics.sections, dt)[::-1]
        # term by term, as the kernel adds
        self.kappa = float(sum((gears.gain * (1.0 - self.decay)).tolist()))
        self.ahead = samples + (AFTER if self.delay_part else 0)
        self.ahead += sum(inverse.weight.size for inverse in self.undone)
        self.empty = forward.start_drive(forward.output.min, "empty", *limits.move)
        assert self.empty.drive is not None
        self.first_drive = self.empty.drive

    @property
    def sizes(self) -> dict[str, str]:
        """Places of a state, at least 1: turns, checkpoints (dbo_kernel.h, dbo_q31.h) and memories."""
        n, terms = self.gears.n, self.gears.gain.size
        counts = {"TURNS": n, "CHECKPOINTS": (n - 1) // SPACING, "TERMS": terms}
        return {name: str(count or 1) for name, count in counts.items()}

    # ---- starts and runs of the library, for the self-test ----

    def resting(self, drive: float, bits: int) -> State:
        """Return the state of an actuator that rests at a drive, its gears coming from ``bits``."""
        at_gears = self.forward.head.value(drive)
        state = self.gears.run([at_gears], State(bits)).state
        amplifier = None if self.forward.amplifier is None else drive
        return replace(state, drive=drive, amplifier=amplifier)

    def played(self, moves: Floats, state: State) -> Floats:
        """Return what the library drives for each input, as the exported step does, ahead."""
        before = np.full(self.ahead + MORE_REST, moves[0])
        inverter = self.forward.inverter(self.dt)
        after = np.full(inverter.ahead - self.ahead, moves[-1])
        target, _ = inverter.run(np.concatenate([before, moves, after]))
        move, slew = self.limits.move, self.limits.slew
        static = self.forward.static
        return static.drive(target[MORE_REST:], state, self.dt, move, slew).y

    def runs(
        self, first: State, source: Grid | None = None, drive: Grid | None = None
    ) -> list[SelfTestRun]:
        """Return the self-test: what the library drives from ``first``, and after ``NAME_reset``.

        Where numbers are counts, what goes in lies on the grids of the displacement
        (``source``) and of the drive.
        """
        low, high = self.limits.move
        trimmed = low + TRIMMED * (high - low)
        if drive is not None:
            trimmed = drive.value(drive.count(trimmed))
        bits = self.forward.starts.bits(self.forward.head.value(trimmed), "settled")
        runs: list[SelfTestRun] = []
        starts = (None, first), (trimmed, self.resting(trimmed, bits))
        for seed, (reset, state) in enumerate(starts, 1):
            reach = self.forward.output
            moves = trial_moves(reach.min, reach.max, seed)
            if source is not None:
                moves = np.array([source.value(source.count(x)) for x in moves])
            runs.append((reset, moves, self.played(moves, state)))
        return runs


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
    low, high = forward.starts.ends
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
    ends = forward.input.min, forward.input.max
    x = np.concatenate([trial_moves(*ends, seed) for seed in range(TRIALS)])
    step = None
    if full.relaxation is not None:
        step = max(full.relaxation.tau)
    elif forward.amplifier is not None:
        step = forward.amplifier.seconds
    error = reduced.static.simulate(x, dt=step)[0]
    error -= forward.static.simulate(x, dt=step)[0]
    rms = float(np.sqrt(np.mean(error**2)))
    return reduced, {"max": float(np.abs(error).max()), "rms": rms}
