"""What the gears have been through before the first sample.

It is one of four: ``empty`` (the actuator has been at or below the lower end of the
model's drive range), ``full``, ``settled`` (after an oscillation that decays from the
whole range to the first sample) and ``auto``: ``empty`` where the first voltage is at or
below the lower end, else ``settled``. Where the first value known is a displacement, the
voltage is sought whose own start leads to it.

Gears may go on beyond the range, so that a drive that goes a little further turns there
as it does inside. These spare gears come last in the table. No drive inside the range
moves them: those that reach below it are crossed, the others open.
"""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.model.gears import Gears
from dbo_cli.model.state import START_NAMES
from dbo_cli.model.widths import CROSSING_TOLERANCE


def require_start(name: str) -> None:
    """Refuse a name that no start has (ModelError)."""
    if name not in START_NAMES:
        raise ModelError(f"`state` {name}: give {', '.join(START_NAMES)} or a file")


class Starts:
    """The states in which forward gears may begin.

    Parameters
    ----------
    gears : Gears
        Those of a forward model.
    low, high : float
        The range of the drive, as it reaches the gears.

    Attributes
    ----------
    moved : Gears
        The gears that a drive inside the range moves.
    empty, full : int
        The bits of all gears, where the drive comes from the lower or the upper end.
    """

    def __init__(self, gears: Gears, low: float, high: float) -> None:
        self.gears = gears
        count = _gears_within(gears, high - max(low, gears.x0))
        up_to_high = _gears_within(gears, high - gears.x0)
        self.empty = (1 << up_to_high) - (1 << count)
        self.full = (1 << up_to_high) - 1
        self.moved = gears
        if count < gears.n:
            begin = gears.x0 + float(gears.dx[count:up_to_high].sum())
            self.moved = Gears(gears.dx[:count], gears.dy[:count], begin)

    @property
    def some_are_spare(self) -> bool:
        """Whether gears go on beyond the range."""
        return self.moved is not self.gears

    @property
    def ends(self) -> tuple[float, float]:
        """The drive at ``empty`` and at ``full``."""
        return self.moved.x_range

    def bits(self, voltage: float, name: str = "auto") -> int:
        """Return the bits of the start ``name`` where ``voltage`` comes first.

        Raises
        ------
        ModelError
            There is no start of that name.
        """
        require_start(name)
        if name == "full":
            return self.full
        if name == "empty":
            return self.empty
        return self.empty | self.moved.settled(voltage)

    def voltage(self, output: float, low: float, high: float) -> float:
        """Return the voltage in [low, high] whose own settled state leads to ``output``.

        The output at rest in the settled state rises with the voltage, but by steps
        where the state changes: where it steps over ``output``, the voltage on the
        nearer side is taken. It is found by halving the range, and within the reach of
        one state exactly.
        """
        inverse = self.gears.inverse()
        below, above = self.ends
        from_empty = float(inverse.run([output], self.empty).y[0])
        if from_empty <= below:
            return min(max(from_empty, low), high)
        from_full = float(inverse.run([output], self.full).y[0])
        if from_full >= above:
            return min(max(from_full, low), high)
        # a little off the step, so that a voltage that is rounded on its way still
        # starts on the same side
        off = CROSSING_TOLERANCE * (above - below)
        while above - below > 0.001 * off:
            middle = below + 0.5 * (above - below)
            bits = self.bits(middle)
            voltage = float(inverse.run([output], bits).y[0])
            if below <= voltage <= above and self.bits(voltage) == bits:
                return min(max(voltage, low), high)
            if voltage > middle:
                below = middle
            else:
                above = middle
        ends = [min(max(end, low), high) for end in (below - off, above + off)]
        return min(ends, key=lambda end: abs(self._settled_output(end) - output))

    def _settled_output(self, voltage: float) -> float:
        """Return the output at rest of gears that have settled at ``voltage``."""
        return float(self.gears.run([voltage], self.bits(voltage)).y[0])


def _gears_within(gears: Gears, width: float) -> int:
    """Return how many gears, the first ones, span ``width``, to half a gear."""
    ends = np.cumsum(gears.dx)
    last = int(np.searchsorted(ends, width - 0.5 * float(gears.dx[-1])))
    return min(last + 1, gears.n)
