"""What the gears have been through before the first sample.

It is one of four: ``empty`` (the actuator has been at or below its lower end), ``full``,
``settled`` (after an oscillation that decays from the whole range to the first sample)
and ``auto``: ``empty`` where the first voltage is at or below the lower end, else
``settled``. Where the first value known is a displacement, the voltage is sought whose
own start leads to it.
"""

from __future__ import annotations

from dbo_cli.errors import ModelError
from dbo_cli.model.gears import Gears
from dbo_cli.model.state import START_NAMES
from dbo_cli.model.widths import CROSSING_TOLERANCE


def start_bits(gears: Gears, voltage: float, name: str) -> int:
    """Return the bits of the start ``name`` of forward gears whose first input is ``voltage``.

    Raises
    ------
    ModelError
        There is no start of that name.
    """
    require_start(name)
    if name == "full":
        return gears.all_bits
    if name == "empty":
        return 0
    return gears.settled(voltage)


def require_start(name: str) -> None:
    """Refuse a name that no start has (ModelError)."""
    if name not in START_NAMES:
        raise ModelError(
            f"no start is called {name!r}; there are: {', '.join(START_NAMES)}"
        )


def settled_voltage(gears: Gears, output: float, low: float, high: float) -> float:
    """Return the voltage in [low, high] whose own settled state leads to ``output`` of forward gears.

    The output at rest in the settled state rises with the voltage, but by steps where
    the state changes: where it steps over ``output``, the voltage on the nearer side is
    taken. It is found by halving the range, and within the reach of one state exactly.
    """
    inverse = gears.inverse()
    lowest, highest = gears.x_range
    from_empty = float(inverse.run([output], 0).y[0])
    if from_empty <= lowest:
        return min(max(from_empty, low), high)
    from_full = float(inverse.run([output], gears.all_bits).y[0])
    if from_full >= highest:
        return min(max(from_full, low), high)
    below, above = lowest, highest
    while True:
        middle = below + 0.5 * (above - below)
        if not below < middle < above:
            break
        bits = gears.settled(middle)
        voltage = float(inverse.run([output], bits).y[0])
        if gears.settled(voltage) == bits:
            return min(max(voltage, low), high)
        if gears.run([middle], bits).y[0] < output:
            below = middle
        else:
            above = middle
    # a little off the step, so that a voltage that is rounded on its way still starts
    # on the same side
    off = CROSSING_TOLERANCE * (highest - lowest)
    ends = [min(max(end, low), high) for end in (below - off, above + off)]
    return min(ends, key=lambda end: abs(settled_output(gears, end) - output))


def settled_output(gears: Gears, voltage: float) -> float:
    """Return the output at rest of forward gears that have settled at ``voltage``."""
    return float(gears.run([voltage], gears.settled(voltage)).y[0])
