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
    p, _, u = (float(w[0]), 0.0, float(w[0])) if state is None else state[0]
    memory, v = np.array([[u, 0.0, p]]), np.empty(w.size)
    kernel.CHOSEN.dynamics_run(
        np.zeros((1, 2)), memory, np.ascontiguousarray(w), v, undoing_rows(numbers)
    )
    return v, ((float(memory[0, 2]), 0.0, float(memory[0, 0])),)


def undoing_rows(numbers: Floats) -> Floats:
    """Return the section, one row a time step, that has the lag's output for its input."""
    rows, (part, rise) = np.zeros((len(numbers), 6)), numbers.T
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
        steps = self.steps[rows] if isinstance(self.steps, np.ndarray) else self.steps
        numbers = self.numbers if len(self.numbers) == 1 else self.numbers[rows]
        return Block(self.x[rows], steps, numbers, self.limits)


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
    drives, total, missed = [np.zeros(0)], Counts(), 0.0
    # side: 1 or -1 while the upper or lower bound holds the drive back
    at, count, side = 0, block.x.size, 0
    while at < block.x.size:
        part = block.of(slice(at, at + count))
        done = _held_run(rest, part, state, side) if side else _free(rest, part, state)
        if done.y.size == part.x.size:
            count *= 2
        elif side or done.y.size:
            side, count = 0, FIRST_CHUNK
        else:
            done, side = _held_back(rest, block.of(slice(at, at + 1)), state)
            # how far these go on without the inverse is known of gears alone
            side *= rest.has_gears
            count = FIRST_CHUNK
        counts = Counts(
            done.outside_count,
            done.first_outside,
            done.clipped_count,
            done.first_clipped,
        )
        total, missed = total.then(counts, at), missed or done.first_missed
        drives.append(np.clip(done.y, block.limits.v_min, block.limits.v_max))
        state, at = done.state, at + done.y.size
    return Simulated(np.concatenate(drives), state, *total, missed)


def _free(rest: Prompt, block: Block, state: ModelState) -> Simulated:
    """Return the samples, the first ones, whose drive keeps its limits unbounded."""
    done, v = _unbounded(rest, block, state)
    bad = (v < block.limits.v_min) | (v > block.limits.v_max)
    most = block.limits.largest_step(block.steps)
    if most is not None:
        before = rest.drive_of(state)
        bad |= np.abs(np.diff(v, prepend=v[0] if before is None else before)) > most
    good = int(np.argmax(bad)) if bad.any() else v.size
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
    part, rise = block.numbers[0].tolist()
    most = block.limits.largest_step(block.steps)
    step = None if most is None else float(np.ravel(most)[0])
    bounds = window(block.limits.v_min, block.limits.v_max, step, rest.drive_of(state))
    p, _, u = (0.0, 0.0, 0.0) if state.drive_lag is None else state.drive_lag[0]
    low, high = bounds
    # else at rest at this sample: the lag passes on what it gets
    if state.drive_lag is not None:
        low, high = (
            p + part * (u - p) + (rise * (bound - u) if rise else 0.0)
            for bound in bounds
        )
    # the slew limit allows nothing in no time, or a lag passes nothing on in no time
    if not low < high:
        high = np.nextafter(low, np.inf)
    done = rest.simulate(
        block.x, state, time_step=block.steps, limits=DriveLimits(low, high)
    )
    w, side = done.y.item(), 0
    # what comes in no time moves nothing: the drive stays
    if state.drive_lag is not None and not rise:
        drive = min(max(u, bounds[0]), bounds[1])
    elif min(w - low, high - w) <= NEGLIGIBLE * (high - low):
        side = -1 if w - low <= high - w else 1
        drive = bounds[0] if side < 0 else bounds[1]
    else:  # only rounding was in the way
        drive = w if state.drive_lag is None else u + ((w - p) - part * (u - p)) / rise
        drive = min(max(drive, bounds[0]), bounds[1])
    drive = min(max(drive, block.limits.v_min), block.limits.v_max)
    # Where the lag has come to an end of the range, what is asked of the drive is
    # hardly beyond it: the range holds back what the lag is to pass on.
    beyond = max(wanted - bounds[1], bounds[0] - wanted) > block.limits.slack(
        rest.drive.span
    )
    clipped = beyond or unbounded.clipped_count > 0
    after = replace(done.state, drive_lag=((w, 0.0, drive),))
    row = np.array([drive])
    limited = Simulated(
        row, after, done.outside_count, 0, int(clipped), 0, done.first_missed
    )
    return limited, side


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
    count = drive.size if limited.all() else int(np.argmin(limited))
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
    most = block.limits.largest_step(block.steps)
    size, rising = block.x.shape, side * _sense(rest) > 0
    steps = (
        [None] * block.x.size if most is None else np.broadcast_to(most, size).tolist()
    )
    parts, rises = (
        np.broadcast_to(numbers, size).tolist() for numbers in block.numbers.T
    )
    limited_rows: list[tuple[float, float, float]] = []
    for step, part, rise in zip(steps, parts, rises, strict=True):
        bounds = window(block.limits.v_min, block.limits.v_max, step, u)
        low, high = (p + part * (u - p) + rise * (bound - u) for bound in bounds)
        if not low < high:
            break
        w = inner = high if side > 0 else low
        if rest.tail:  # rounding on the way through the points and back
            reach = rest.inner_limits(DriveLimits(low, high))
            inner = reach.v_max if rising else reach.v_min
            w = min(max(rest.outer_drive(inner), low), high)
            if abs(w - (high if side > 0 else low)) > NEGLIGIBLE * (high - low):
                break
        p, u = w, bounds[side > 0]
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
    decay = (
        gears.relaxation.decay(block.of(slice(0, inner.size)).steps)
        if gears.relaxation
        else None
    )
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
    gears, unclear = rest.forward_backlash, UNCLEAR * rest.drive.span
    missing = (through(rest.head, block.x) - y) * (side * _sense(rest))
    slope = float(gears.gears[:, 2].max()) + (
        sum(gears.relaxation.gain) if gears.relaxation else 0.0
    )
    outer = math.prod(least_slope(stage) for stage in rest.tail)
    room = block.limits.v_max - lagged if side > 0 else lagged - block.limits.v_min
    tolerance = 2.0 * float((gears.gears[:, 0] * (1.0 - gears.gears[:, 3])).max())
    low, high = gears.x_range
    inside = (inner > low + tolerance) & (inner < high - tolerance)
    beyond = missing * outer / slope > unclear
    if rest.tail:
        beyond &= room > unclear
    return beyond & (inside | rest.uncovered(block.x))
