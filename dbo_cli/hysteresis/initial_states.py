"""Initial states: what the operator has been through before the first sample.

``empty`` (the actuator has been at or below its lower end), ``full``, ``settled`` (after an oscillation
that decays from the whole range to the first sample) and ``auto``: ``empty`` where the first voltage is at
or below the lower end, else ``settled``. Where the first voltage is not given but asked for, because the
first value known is a displacement, it is the one whose own start leads to that displacement.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.gear_table import CROSSING_TOLERANCE
from dbo_cli.hysteresis.operators import BacklashState, DiscreteBacklashOperator

StartName = Literal["auto", "empty", "full", "settled"]
START_NAMES: tuple[StartName, ...] = ("auto", "empty", "full", "settled")


class DriveStart(NamedTuple):
    """The first voltage of an inverse, the state before it, and the displacement it reaches."""

    voltage: float
    state: BacklashState
    reached: float


def start_state(operator: DiscreteBacklashOperator, voltage: float, name: StartName) -> BacklashState:
    """Return the state named ``name`` for a forward operator whose first input is ``voltage``.

    Raises
    ------
    ModelError
        There is no state of that name.
    """
    if name not in START_NAMES:
        raise ModelError(f"no initial state is called {name!r}; there are: {', '.join(START_NAMES)}")
    if name == "full":
        return operator.full()
    if name == "empty" or (name == "auto" and voltage <= operator.x0):
        return operator.empty()
    return operator.settled(voltage)


def _reached(operator: DiscreteBacklashOperator, voltage: float, state: BacklashState) -> float:
    """Return the output at rest at ``voltage``, from ``state``."""
    return float(operator.run([voltage], state)[0][0])


def start_drive(
    operator: DiscreteBacklashOperator, displacement: float, low: float = -math.inf, high: float = math.inf
) -> DriveStart:
    """Return the voltage in [low, high] whose own start, ``auto``, leads to ``displacement``.

    The output at rest after that start rises with the voltage, but by steps where the start changes: where
    it steps over ``displacement``, the voltage on the nearer side of the step is taken. ``operator`` is the
    forward one. The voltage is found by halving the range, and within the reach of one state exactly.
    """
    inverse = operator.inverse()
    for end in (operator.empty(), operator.full()):
        voltage = float(inverse.run([displacement], end)[0][0])
        if voltage <= operator.x_range[0] if end.bits == 0 else voltage >= operator.x_range[1]:
            return _within(operator, voltage, low, high)
    below, above = operator.x_range
    for _ in range(2000):
        middle = below + 0.5 * (above - below)
        if not below < middle < above:
            break
        state = start_state(operator, middle, "auto")
        voltage = float(inverse.run([displacement], state)[0][0])
        if start_state(operator, voltage, "auto") == state:
            return _within(operator, voltage, low, high)
        if _reached(operator, middle, state) < displacement:
            below = middle
        else:
            above = middle
    # A little off the step, so that a voltage that was rounded on its way still starts on the same side.
    off = CROSSING_TOLERANCE * (operator.x_range[1] - operator.x_range[0])
    ends = (_within(operator, below - off, low, high), _within(operator, above + off, low, high))
    return min(ends, key=lambda end: abs(end.reached - displacement))


def _within(operator: DiscreteBacklashOperator, voltage: float, low: float, high: float) -> DriveStart:
    """Return the start at ``voltage``, or at the limit that is in the way."""
    allowed = min(max(voltage, low), high)
    state = start_state(operator, allowed, "auto")
    return DriveStart(allowed, state, _reached(operator, allowed, state))
