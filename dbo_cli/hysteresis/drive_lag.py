"""A first-order lag before the gears: what an amplifier makes of the drive on its way to the actuator.

A lag behind the gears delays the displacement; one before them also rounds every turn
of what they see, which at a fifth of the resonance is worth 1 % of the move (0.2 ms,
160 Hz). Its inverse is causal, since its zero is inside the unit circle (``dynamics``).
What the limits allow the drive, the lag passes on: after (p, u), the lag's output and
input before, the output is p + part (u - p) + rise (u' - u), so that limits on u' are
limits on the output, of that sample alone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.cascade import MemoryFree, least_slope, through
from dbo_cli.hysteresis.dynamics import DynamicsStage, SectionStates
from dbo_cli.hysteresis.kernel import Floats, window
from dbo_cli.hysteresis.model_state import (
    NEGLIGIBLE,
    DriveLimits,
    ModelState,
    Quantity,
    Simulated,
)
from dbo_cli.hysteresis.operators import (
    BacklashState,
    Counts,
    DiscreteBacklashOperator,
    Outside,
    steps_of,
)

Steps = float | Floats

FIRST_CHUNK = 16
"""Samples tried at once where a limit begins or ends to bind; doubled while all go alike. A guess: the
best number depends on how often limits bind.
"""
UNCLEAR = 1e-8
"""Of the drive's range: ten times what counts as clipped (``NEGLIGIBLE``). A demand this near to a bound is
tried alone, since rounding and the gears' tolerance may decide about it.
"""


def coefficients(stage: DynamicsStage, steps: Steps) -> Floats:
    """Return what of u - p and of u' - u reaches the lag's output: a row a time step (s), or one for all."""
    return stage.rows(steps)[:, 1:3]


def undone(
    numbers: Floats, w: Floats, state: SectionStates | None
) -> tuple[Floats, SectionStates | None]:
    """Return the drive that a lag makes ``w`` of, and the lag's state after it; at rest at first without one.

    u' = u + ((w' - w) - part (u - w))/rise is the recursion of a section, input and
    output exchanged. A sample in no time, which leaves the output where it was, has the
    drive of the one before.
    """
    if w.size == 0:
        return w, state
    p = u = float(w[0])
    if state is not None:
        p, _, u = state[0]
    # the lag's input and output, exchanged
    memory = np.array([[u, 0.0, p]])
    v = np.empty(w.size)
    kernel.CHOSEN.dynamics_run(
        np.zeros((1, 2)), memory, np.ascontiguousarray(w), v, undoing_rows(numbers)
    )
    return v, ((float(memory[0, 2]), 0.0, float(memory[0, 0])),)


def undoing_rows(numbers: Floats) -> Floats:
    """Return the section, one row a time step, that has the lag's output for its input."""
    rows = np.zeros((len(numbers), 6))
    part, rise = numbers.T
    moves = rise > 0.0
    rows[moves, 1] = part[moves] / rise[moves]
    rows[moves, 2] = 1.0 / rise[moves]
    return rows


class Block(NamedTuple):
    """Samples of what is wanted, their time steps, the lag's numbers for these, and the drive's limits."""

    x: Floats
    steps: Steps
    numbers: Floats
    limits: DriveLimits

    def of(self, rows: slice) -> Block:
        """Return some of the samples."""
        numbers = self.numbers
        if len(numbers) > 1:
            numbers = numbers[rows]
        steps = steps_of(self.steps, rows)
        return Block(self.x[rows], steps, numbers, self.limits)

    @property
    def largest_steps(self) -> list[float | None]:
        """The largest change of the drive in each sample; None where any is allowed."""
        most = self.limits.largest_step(self.steps)
        if most is None:
            return [None] * self.x.size
        steps: list[float | None] = np.broadcast_to(most, self.x.shape).tolist()
        return steps

    def window(self, sample: int, drive: float | None) -> tuple[float, float]:
        """Return the bounds of the drive in a sample, after the drive before it."""
        step = self.largest_steps[sample]
        return window(self.limits.v_min, self.limits.v_max, step, drive)


class Prompt(Protocol):
    """What is behind the lag: the same model for a drive that has passed it."""

    has_gears: bool

    def simulate(
        self,
        x: ArrayLike,
        state: ModelState,
        *,
        time_step: float | ArrayLike | None = None,
        outside: Outside = "extend",
        limits: DriveLimits | None = None,
    ) -> Simulated:
        """See ``ActuatorModel.simulate``."""

    def outer_drive(self, drive: float) -> float:
        """See ``ActuatorModel.outer_drive``."""

    def drive_of(self, state: ModelState) -> float | None:
        """See ``ActuatorModel.drive_of``."""

    def inner_limits(self, limits: DriveLimits) -> DriveLimits:
        """See ``ActuatorModel.inner_limits``."""

    def uncovered(self, x: Floats) -> NDArray[np.bool_]:
        """See ``ActuatorModel.uncovered``."""

    @property
    def drive(self) -> Quantity:
        """See ``ActuatorModel.drive``."""

    @property
    def forward_backlash(self) -> DiscreteBacklashOperator:
        """See ``ActuatorModel.forward_backlash``."""

    @property
    def head(self) -> MemoryFree:
        """See ``ActuatorModel.head``."""

    @property
    def tail(self) -> MemoryFree:
        """See ``ActuatorModel.tail``."""


def simulate(
    lag: DynamicsStage,
    rest: Prompt,
    x: Floats,
    state: ModelState,
    steps: Steps,
    outside: Outside,
    limits: DriveLimits | None,
) -> Simulated:
    """Return what ``ActuatorModel.simulate`` does, for a model of a lag and the rest behind it."""
    if not lag.inverted:
        w, memory = lag.run(x, steps, state.drive_lag)
        done = rest.simulate(w, state, time_step=steps, outside=outside)
        return done._replace(state=replace(done.state, drive_lag=memory))
    numbers = coefficients(lag, steps)
    if limits is None:
        done = rest.simulate(x, state, time_step=steps, outside=outside)
        v, memory = undone(numbers, done.y, state.drive_lag)
        return done._replace(y=v, state=replace(done.state, drive_lag=memory))
    return _limited(rest, Block(x, steps, numbers, limits), state)


def _limited(rest: Prompt, block: Block, state: ModelState) -> Simulated:
    """Return the drive within its limits; what they hold back does not reach the gears.

    As many samples at once as stay within the limits, or as one bound holds back; each
    other one alone. The bits are those of one sample after the other, however many are
    tried at once.
    """
    drives = [np.zeros(0)]
    total = Counts()
    missed = 0.0
    begin = 0
    count = block.x.size
    side = 0  # 1 or -1 while the upper or lower bound holds the drive back
    while begin < block.x.size:
        part = block.of(slice(begin, begin + count))
        if side:
            done = _held_run(rest, part, state, side)
        else:
            done = _free(rest, part, state)
        if done.y.size == part.x.size:
            count *= 2
        elif side or done.y.size:
            side = 0
            count = FIRST_CHUNK
        else:
            done, side = _held_back(rest, block.of(slice(begin, begin + 1)), state)
            if not rest.has_gears:
                # how far these go on without the inverse is known of gears alone
                side = 0
            count = FIRST_CHUNK
        total = total.then(done.counts, begin)
        missed = missed or done.first_missed
        drives.append(np.clip(done.y, block.limits.v_min, block.limits.v_max))
        state = done.state
        begin += done.y.size
    return Simulated(np.concatenate(drives), state, *total, missed)


def _free(rest: Prompt, block: Block, state: ModelState) -> Simulated:
    """Return the samples, the first ones, whose drive keeps its limits unbounded."""
    done, v = _unbounded(rest, block, state)
    bad = (v < block.limits.v_min) | (v > block.limits.v_max)
    most = block.limits.largest_step(block.steps)
    if most is not None:
        before = rest.drive_of(state)
        if before is None:
            before = v[0]
        bad |= np.abs(np.diff(v, prepend=before)) > most
    good = v.size
    if bad.any():
        good = int(np.argmax(bad))
    if good == 0:
        return Simulated(v[:0], state)
    if good < v.size:  # the same again, of the samples before the one that is held back
        done, v = _unbounded(rest, block.of(slice(0, good)), state)
    return done._replace(y=v)


def _unbounded(
    rest: Prompt, block: Block, state: ModelState
) -> tuple[Simulated, Floats]:
    """Return a block of which only the lag's output is kept within the range, and its drive."""
    wide = DriveLimits(block.limits.v_min, block.limits.v_max)
    done = rest.simulate(block.x, state, time_step=block.steps, limits=wide)
    v, memory = undone(block.numbers, done.y, state.drive_lag)
    return done._replace(state=replace(done.state, drive_lag=memory)), v


def _held_back(rest: Prompt, block: Block, state: ModelState) -> tuple[Simulated, int]:
    """Return one sample whose drive is the bound that holds it back, and which one that is."""
    unbounded, drives = _unbounded(rest, block, state)
    wanted = float(drives[0])
    bounds = block.window(0, rest.drive_of(state))
    lower, upper = bounds
    low, high = _passed_on(block, state, bounds)
    done = rest.simulate(
        block.x, state, time_step=block.steps, limits=DriveLimits(low, high)
    )
    w = done.y.item()
    side = 0
    if _stays(block, state):
        drive = _drive_before(state)
    elif min(w - low, high - w) > NEGLIGIBLE * (high - low):
        # only rounding was in the way
        drive = _drive_for(w, block, state)
    elif w - low <= high - w:
        side = -1
        drive = lower
    else:
        side = 1
        drive = upper
    drive = min(max(drive, lower), upper)
    drive = min(max(drive, block.limits.v_min), block.limits.v_max)
    # Where the lag has come to an end of the range, what is asked of the drive is
    # hardly beyond it: the range holds back what the lag is to pass on.
    beyond = max(wanted - upper, lower - wanted) > block.limits.slack(rest.drive.span)
    clipped = beyond or unbounded.clipped_count > 0
    after = replace(done.state, drive_lag=((w, 0.0, drive),))
    limited = Simulated(
        np.array([drive]),
        after,
        done.outside_count,
        0,
        int(clipped),
        0,
        done.first_missed,
    )
    return limited, side


def _passed_on(
    block: Block, state: ModelState, bounds: tuple[float, float]
) -> tuple[float, float]:
    """Return what the lag makes of the bounds of its drive in one sample."""
    low, high = bounds
    # without a state it is at rest at this sample: the lag passes on what it gets
    if state.drive_lag is not None:
        p, _, u = state.drive_lag[0]
        part, rise = block.numbers[0].tolist()
        low = high = p + part * (u - p)
        if rise:
            low = low + rise * (bounds[0] - u)
            high = high + rise * (bounds[1] - u)
    # the slew limit allows nothing in no time, or a lag passes nothing on in no time
    if not low < high:
        high = float(np.nextafter(low, np.inf))
    return low, high


def _stays(block: Block, state: ModelState) -> bool:
    """Whether a sample comes in no time, which moves nothing: the drive stays."""
    _, rise = block.numbers[0].tolist()
    return state.drive_lag is not None and not rise


def _drive_before(state: ModelState) -> float:
    """Return the drive of the sample before."""
    assert state.drive_lag is not None
    return state.drive_lag[0][2]


def _drive_for(w: float, block: Block, state: ModelState) -> float:
    """Return the drive of one sample of which the lag makes ``w``."""
    if state.drive_lag is None:
        return w
    p, _, u = state.drive_lag[0]
    part, rise = block.numbers[0].tolist()
    drive: float = u + ((w - p) - part * (u - p)) / rise
    return drive


def _held_run(rest: Prompt, block: Block, state: ModelState, side: int) -> Simulated:
    """Return the samples, the first ones, that one bound clearly holds back.

    Their drive is known: a ramp at the slew limit, or an end of the range. The gears
    follow it as those of the forward operator do; what these reach shows where the
    demand is no longer clearly beyond it.
    """
    drive, lagged, inner = _ramp(rest, block, state, side)
    y, after = _followed(rest, block, state, inner)
    limited = _clearly_held(
        rest, block.of(slice(0, drive.size)), side, lagged, inner, y
    )
    count = drive.size
    if not limited.all():
        count = int(np.argmin(limited))
    if count == 0:
        return Simulated(drive[:0], state)
    if count < drive.size:
        after = _followed(rest, block, state, inner[:count])[1]
    lag = ((float(lagged[count - 1]), 0.0, float(drive[count - 1])),)
    state = replace(
        state, backlash=after, drive=float(inner[count - 1]), time=None, drive_lag=lag
    )
    outside = rest.uncovered(block.x[:count])
    return Simulated(
        drive[:count],
        state,
        int(np.count_nonzero(outside)),
        int(np.argmax(outside)),
        count,
        0,
    )


def _ramp(
    rest: Prompt, block: Block, state: ModelState, side: int
) -> tuple[Floats, Floats, Floats]:
    """Return the drive that stays at one bound, what the lag makes of it, and what then reaches the gears.

    The same operations as in ``_held_back``; it ends where those would not give the
    bound.
    """
    assert state.drive_lag is not None
    p, _, u = state.drive_lag[0]
    rising = side * _sense(rest) > 0
    size = block.x.shape
    parts = np.broadcast_to(block.numbers[:, 0], size).tolist()
    rises = np.broadcast_to(block.numbers[:, 1], size).tolist()
    limited_rows: list[tuple[float, float, float]] = []
    for step, part, rise in zip(block.largest_steps, parts, rises, strict=True):
        lower, upper = window(block.limits.v_min, block.limits.v_max, step, u)
        low = p + part * (u - p) + rise * (lower - u)
        high = p + part * (u - p) + rise * (upper - u)
        if not low < high:
            break
        bound, end = (upper, high) if side > 0 else (lower, low)
        w = inner = end
        if rest.tail:  # rounding on the way through the points and back
            reach = rest.inner_limits(DriveLimits(low, high))
            inner = reach.v_max if rising else reach.v_min
            w = min(max(rest.outer_drive(inner), low), high)
            if abs(w - end) > NEGLIGIBLE * (high - low):
                break
        p = w
        u = bound
        limited_rows.append((u, w, inner))
    drive, lagged, reached = np.array(limited_rows).reshape(-1, 3).T.copy()
    return drive, lagged, reached


def _sense(rest: Prompt) -> float:
    """Return 1 where the voltage rises with what reaches the gears, -1 where a gain turns it."""
    low, high = (rest.outer_drive(end) for end in rest.forward_backlash.x_range)
    return math.copysign(1.0, high - low)


def _followed(
    rest: Prompt, block: Block, state: ModelState, inner: Floats
) -> tuple[Floats, BacklashState]:
    """Return what the gears make of a drive that reaches them, and their state after it."""
    gears = rest.forward_backlash
    decay = None
    if gears.relaxation:
        decay = gears.relaxation.decay(block.of(slice(0, inner.size)).steps)
    y, after, _ = gears.run(inner, state.backlash, decay=decay)
    return y, after


def _clearly_held(
    rest: Prompt, block: Block, side: int, lagged: Floats, inner: Floats, y: Floats
) -> NDArray[np.bool_]:
    """Return which samples ask for so much beyond what is reached that they are clipped, and counted so.

    Where the lag has come to the end of the range and the drive is bent behind it,
    rounding on the way there and back decides by which bound a sample is held: only
    sample by sample gives the same bits at any cut. Near the ends of the gears a sample
    counts as outside by how far the demand goes beyond them, which only the inverse
    knows, unless the model does not cover it anyhow.
    """
    gears = rest.forward_backlash
    unclear = UNCLEAR * rest.drive.span
    missing = (through(rest.head, block.x) - y) * (side * _sense(rest))
    slope = float(gears.gears[:, 2].max())
    if gears.relaxation:
        slope += sum(gears.relaxation.gain)
    outer = math.prod(least_slope(stage) for stage in rest.tail)
    room = lagged - block.limits.v_min
    if side > 0:
        room = block.limits.v_max - lagged
    tolerance = 2.0 * float((gears.gears[:, 0] * (1.0 - gears.gears[:, 3])).max())
    low, high = gears.x_range
    inside = (inner > low + tolerance) & (inner < high - tolerance)
    beyond = missing * outer / slope > unclear
    if rest.tail:
        beyond &= room > unclear
    return beyond & (inside | rest.uncovered(block.x))
