"""The settled drive of a loop: a fixed point of the pass.

Gears and memory are those to which the last drive leads when it is repeated for ever,
the next drive is the inverse's in that state, until it stays. Gears repeat after a
pass; relaxation is linear in the drive, so that the memory that a periodic drive leaves
unchanged is computed at once.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.drive.limits import Limits
from dbo_cli.model import Model, Run, State

Floats = NDArray[np.float64]

# relaxation settles within 60; limits that bind now and then take longer
MOST_PASSES = 200
# of the drive's range, by which a settled drive changes from pass to pass
SETTLED = 1e-12


class Settled(NamedTuple):
    """The run of one period of a settled drive, the state before it, and whether it stays."""

    run: Run
    before: State
    converged: bool


def settled_drive(
    model: Model, undone: Floats, dt: float, state: State, limits: Limits
) -> Settled:
    """Return the drive of one period whose end is its own beginning.

    Parameters
    ----------
    model
        A forward model.
    undone
        One period of what its static part is to follow (``Inverter.loop``).
    dt
        Seconds a row.
    state
        Before the first pass ever: gears that the loop does not reach keep it.
    limits
        What the drive may do.
    """
    static, move, slew = model.static, limits.move, limits.slew
    done = static.drive(undone, state, dt, move, slew)
    for _ in range(MOST_PASSES):
        before = looped_state(model, done.y, dt, state)
        again = static.drive(undone, before, dt, move, slew)
        away = apart(again.y, done.y)
        done = again
        if away <= SETTLED * model.input.span:
            return Settled(done, before, True)
    return Settled(done, before, False)


def apart(values: Floats, beside: Floats) -> float:
    """Return the largest difference between two signals."""
    return float(np.abs(values - beside).max())


def looped_state(model: Model, voltage: Floats, dt: float, state: State) -> State:
    """Return gears and memory before a pass of a drive that was repeated for ever, begun in a state."""
    static = model.static
    begun = static.run(voltage, state, dt).state
    relaxation = model.gears.relaxation
    if relaxation is None or begun.memory is None:
        return begun
    after = static.run(voltage, begun, dt).state
    assert after.memory is not None
    memory = []
    for start, end, tau in zip(begun.memory, after.memory, relaxation.tau, strict=True):
        left = -voltage.size * dt / tau
        memory.append((end - math.exp(left) * start) / -math.expm1(left))
    return replace(after, memory=tuple(memory))


def settled_run(model: Model, voltage: Floats, dt: float, state: State) -> Floats:
    """Return the displacement of one period of a drive that was repeated for ever."""
    before = looped_state(model, voltage, dt, state)
    return model.follow_loop(model.static.run(voltage, before, dt).y, dt)
