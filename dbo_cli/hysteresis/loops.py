"""A loop after infinitely many passes: the drive that settles, and what a drive settles to.

Gears repeat after a pass or two. Relaxation would take as many passes as its longest time constant lasts; its
memory is linear in the drive, so that the memory that a periodic drive leaves unchanged is computed at once,
and the drive, which depends on it a little, again, until both stay.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Simulated
from dbo_cli.hysteresis.operators import BacklashState

Floats = NDArray[np.float64]

MOST_PASSES = 200
"""Relaxation of half the gears' own slope settles within 60; limits that bind now and then take longer."""
SETTLED = 1e-12  # of the drive's range, by which a settled drive changes from pass to pass


class Settled(NamedTuple):
    """One period of a settled loop: the run of its last pass, the state before it, and the passes it took."""

    done: Simulated
    before: ModelState
    passes: int
    converged: bool


def shifted(x: Floats, samples: float) -> Floats:
    """Return one period read ahead by so many samples (behind, where negative), linear between them."""
    whole = math.floor(samples + 1e-9)
    part = max(samples - whole, 0.0)
    near = np.roll(x, -whole)
    return near if part <= 1e-9 else near + part * (np.roll(near, -1) - near)


def undone_loop(model: ActuatorModel, desired: Floats, step: float) -> Floats:
    """Return what a forward model's dynamics and delay are to be given for one period of their output."""
    ahead = shifted(desired, model.delay_seconds / step)
    return ahead if model.dynamics is None else model.dynamics.inverter(step).loop(ahead)


def settled_drive(
    model: ActuatorModel, undone: Floats, step: float, state: ModelState, limits: DriveLimits
) -> Settled:
    """Return the drive of one period, its own state's end its beginning.

    Parameters
    ----------
    model
        The forward model.
    undone
        One period, dynamics and delay undone (``undone_loop``).
    step
        The even time step (s).
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    limits
        Of the drive.
    """
    inverse = model.inverse()
    time_step = step if model.needs_time or limits.max_slew is not None else None
    done = inverse.simulate(undone, state, time_step=time_step, limits=limits)
    before, converged, passes = state, False, 1
    while not converged and passes < MOST_PASSES:
        passes += 1
        before = _periodic(model, state, done.state, undone.size * step)
        again = inverse.simulate(undone, before, time_step=time_step, limits=limits)
        away = float(np.abs(again.y - done.y).max())
        same = before.backlash.bits == again.state.backlash.bits
        state, done = before, again
        converged = same and away <= SETTLED * model.input.span
    return Settled(done, before, passes, converged)


def _periodic(model: ActuatorModel, before: ModelState, after: ModelState, seconds: float) -> ModelState:
    """Return the state after a pass, with the memory that further passes of the same drive would lead to."""
    memory = after.backlash.memory
    if memory is None:
        return after  # no relaxation
    terms = model.backlash.relaxation
    if terms is not None:
        begun = before.backlash.memory
        if begun is not None:
            kept = [math.exp(-seconds / tau) for tau in terms.tau]
            memory = tuple(
                (end - part * start) / -math.expm1(-seconds / tau)
                for start, end, part, tau in zip(begun, memory, kept, terms.tau, strict=True)
            )
    return dataclasses.replace(after, backlash=BacklashState(after.backlash.bits, memory))


def settled_output(
    model: ActuatorModel, drive: Floats, step: float, start: StartName | ModelState = "auto"
) -> Floats:
    """Return the output of one period of a drive that has been repeated for ever."""
    return settled_run(model, drive, step, model.start(float(drive[0]), start)).y


def settled_run(model: ActuatorModel, drive: Floats, step: float, state: ModelState) -> Simulated:
    """Return the settled period of a repeated drive, and the state at its end."""
    others = (model.dynamics, model.delay, model.drive_lag)
    inner = dataclasses.replace(
        model, stages=tuple(stage for stage in model.stages if not any(stage is other for other in others))
    )
    time_step = step if inner.needs_time else None
    begun = dataclasses.replace(state, dynamics=None, undoing=None, history=None, drive_lag=None)
    lagging = None
    if model.drive_lag is not None:
        drive, lagging = model.drive_lag.loop(drive, step)
    for _ in range(3):  # one pass for the gears, one for the memory of the drive, one to see it
        done = inner.simulate(drive, begun, time_step=time_step)
        begun = _periodic(inner, begun, done.state, drive.size * step)
    done = inner.simulate(drive, begun, time_step=time_step)
    y, sections = done.y, None
    if model.dynamics is not None:
        y, sections = model.dynamics.loop(y, step)
    after = dataclasses.replace(done.state, dynamics=sections, drive_lag=lagging)
    return done._replace(y=shifted(y, -model.delay_seconds / step), state=after)
