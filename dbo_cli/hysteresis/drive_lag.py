"""A first-order lag before the gears: what an amplifier makes of the drive on its way to the actuator.

A lag behind the gears delays the displacement; one before them also rounds every turn of what they see, which
at a fifth of the resonance is worth 1 % of the move (0.2 ms, 160 Hz). Its inverse is causal, since its zero
is inside the unit circle (``linear_sections``). What the limits allow the drive, the lag passes on: after
(p, u), the lag's output and input before, the output is p + part (u - p) + rise (u' - u), so that limits on
u' are limits on the output, of that sample alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.dynamics import DynamicsStage, SectionStates
from dbo_cli.hysteresis.kernel import towards
from dbo_cli.hysteresis.model_state import NEGLIGIBLE, DriveLimits, ModelState, Simulated
from dbo_cli.hysteresis.operators import Counts, Outside

Floats = NDArray[np.float64]
Steps = float | Floats

FIRST_CHUNK = 16  # samples tried at once after one that the limits hold back; doubled while none is


class Coefficients(NamedTuple):
    """For each sample of a block, or once for all: the parts of u - p and of u' - u that reach the output."""

    part: Floats
    rise: Floats

    def of(self, rows: slice) -> Coefficients:
        """Return those of some samples."""
        return self if self.part.size == 1 else Coefficients(self.part[rows], self.rise[rows])


def coefficients(stage: DynamicsStage, steps: Steps) -> Coefficients:
    """Return the numbers of the lag for time steps (s)."""
    rows = stage.rows(steps)
    return Coefficients(rows[:, 1], rows[:, 2])


def undone(
    numbers: Coefficients, w: Floats, state: SectionStates | None
) -> tuple[Floats, SectionStates | None]:
    """Return the drive that a lag makes ``w`` of, and the lag's state after it; at rest at first without one.

    u' = u + ((w' - w) - part (u - w))/rise is the recursion of a section, input and output exchanged.
    A sample in no time, which leaves the output where it was, has the drive of the one before.
    """
    if w.size == 0:
        return w, state
    p, _, u = (float(w[0]), 0.0, float(w[0])) if state is None else state[0]
    held, v = np.array([[u, 0.0, p]]), np.empty(w.size)
    kernel.CHOSEN.dynamics_run(np.zeros((1, 2)), held, np.ascontiguousarray(w), v, undoing_rows(numbers))
    return v, ((float(held[0, 2]), 0.0, float(held[0, 0])),)


def undoing_rows(numbers: Coefficients) -> Floats:
    """Return the section, one row a time step, that has the lag's output for its input."""
    rows = np.zeros((numbers.part.size, 6))
    moves = numbers.rise > 0.0
    rows[moves, 1] = numbers.part[moves] / numbers.rise[moves]
    rows[moves, 2] = 1.0 / numbers.rise[moves]
    return rows


class Prompt(Protocol):
    """What is behind the lag: the same model for a drive that has passed it."""

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

    @property
    def drive_span(self) -> float:
        """See ``ActuatorModel.drive_span``."""


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
        w, held = lag.run(x, steps, state.drive_lag)
        done = rest.simulate(w, state, time_step=steps, outside=outside)
        return done._replace(state=replace(done.state, drive_lag=held))
    numbers = coefficients(lag, steps)
    if limits is None:
        done = rest.simulate(x, state, time_step=steps, outside=outside)
        v, held = undone(numbers, done.y, state.drive_lag)
        return done._replace(y=v, state=replace(done.state, drive_lag=held))
    return _limited(rest, x, state, steps, numbers, limits, rest.drive_span)


def _limited(
    rest: Prompt,
    x: Floats,
    state: ModelState,
    steps: Steps,
    numbers: Coefficients,
    limits: DriveLimits,
    span: float,
) -> Simulated:
    """Return the drive within its limits; what they hold back does not reach the gears.

    As many samples at once as stay within the limits, each other one alone: the bits are those of one sample
    after the other, however many are tried at once.
    """
    wide, slack = DriveLimits(limits.v_min, limits.v_max), limits.slack(span)
    drives, total, missed, at, chunk = [np.zeros(0)], Counts(), 0.0, 0, x.size
    while at < x.size:
        part = slice(at, min(at + chunk, x.size))
        own = numbers.of(part)
        slices = _part(steps, part)
        most = limits.largest_step(slices)
        allowed = None if most is None else np.broadcast_to(most, x[part].shape)
        before = _last_drive(rest, state)
        done = rest.simulate(x[part], state, time_step=slices, limits=wide)
        v, held = undone(own, done.y, state.drive_lag)
        good = _within(v, before, allowed, limits)
        if good < v.size:
            chunk = FIRST_CHUNK
            if good:  # the same again, of the samples before the one that is held back
                part = slice(at, at + good)
                done = rest.simulate(x[part], state, time_step=_part(steps, part), limits=wide)
                v, held = undone(numbers.of(part), done.y, state.drive_lag)
            else:
                part, slices = slice(at, at + 1), _part(steps, slice(at, at + 1))
                step = None if allowed is None else float(allowed[0])
                bounds = _bounds(before, step, limits)
                beyond = max(float(v[0]) - bounds[1], bounds[0] - float(v[0]))
                lag = (float(own.part[0]), float(own.rise[0]))
                done, v, held = _held_back(rest, x[part], state, slices, lag, bounds)
                done = done._replace(clipped_count=int(beyond > slack), first_clipped=0)
        else:
            chunk = min(2 * chunk, x.size)
        total = total + Counts(
            done.outside_count, done.first_outside, done.clipped_count, done.first_clipped
        ).shifted(at)
        missed = missed or done.first_missed
        state = replace(done.state, drive_lag=held)
        drives.append(np.clip(v, limits.v_min, limits.v_max))
        at = part.stop
    return Simulated(np.concatenate(drives), state, *total, missed)


def _part(steps: Steps, rows: slice) -> Steps:
    return steps[rows] if isinstance(steps, np.ndarray) else steps


def _last_drive(rest: Prompt, state: ModelState) -> float | None:
    """Return the drive before a block, from which a slew limit goes on."""
    if state.drive_lag is not None:
        return state.drive_lag[0][2]
    return None if state.drive is None else rest.outer_drive(state.drive)


def _within(v: Floats, before: float | None, allowed: Floats | None, limits: DriveLimits) -> int:
    """Return how many samples, the first ones, keep the limits."""
    bad = (v < limits.v_min) | (v > limits.v_max)
    if allowed is not None:
        bad |= np.abs(np.diff(v, prepend=v[0] if before is None else before)) > allowed
    return int(np.argmax(bad)) if bad.any() else v.size


def _bounds(before: float | None, step: float | None, limits: DriveLimits) -> tuple[float, float]:
    """Return the least and the largest drive of one sample; the range wins over the slew limit."""
    if before is None or step is None:
        return limits.v_min, limits.v_max
    low, high = towards(before, -step), towards(before, step)
    return min(max(low, limits.v_min), limits.v_max), max(min(high, limits.v_max), limits.v_min)


def _held_back(
    rest: Prompt,
    x: Floats,
    state: ModelState,
    steps: Steps,
    numbers: tuple[float, float],
    bounds: tuple[float, float],
) -> tuple[Simulated, Floats, SectionStates]:
    """Return one sample whose drive is the bound that holds it back."""
    part, rise = numbers
    p, _, u = (0.0, 0.0, 0.0) if state.drive_lag is None else state.drive_lag[0]
    low, high = bounds
    if state.drive_lag is not None:  # else at rest at this sample: the lag passes on what it gets
        low, high = (p + part * (u - p) + rise * (bound - u) for bound in bounds)
    if not low < high:  # the slew limit allows nothing in no time
        high = np.nextafter(low, np.inf)
    done = rest.simulate(x, state, time_step=steps, limits=DriveLimits(low, high))
    w = done.y.item()
    if min(w - low, high - w) <= NEGLIGIBLE * (high - low):
        drive = bounds[0] if w - low <= high - w else bounds[1]
    else:  # only rounding was in the way
        drive = w if state.drive_lag is None else u + ((w - p) - part * (u - p)) / rise
        drive = min(max(drive, bounds[0]), bounds[1])
    return done, np.array([drive]), ((w, 0.0, drive),)
