"""Starts: what the gears have been through before the first sample, by name."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dbo_cli.arrays import Range
from dbo_cli.errors import ModelError
from dbo_cli.model import kernel
from dbo_cli.model.gears import CROSSING_TOLERANCE, Gears
from dbo_cli.model.points import on_binary_grid
from dbo_cli.model.state import START_NAMES, State


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts of gears whose voltage stays between ``low`` and ``high``.

    Spare gears may go on beyond that range, so that a drive that goes a little further
    turns there as it does inside. They come last in the table. No drive inside the range
    moves them: those that reach below it are crossed, the others open.
    """

    gears: Gears
    low: float
    high: float

    @cached_property
    def covered(self) -> int:
        """How many gears, the first ones, a drive inside the range moves."""
        return self._count(self.high - max(self.low, self.gears.x0))

    @cached_property
    def ends(self) -> Range:
        """The voltages between which it moves them."""
        gears, count = self.gears, self.covered
        if count == gears.n:
            return gears.x_range
        below = gears.dx[count : self._count(self.high - gears.x0)]
        low = gears.x0 + float(below.sum())
        return low, low + math.fsum(on_binary_grid("dx", gears.dx[:count]).tolist())

    @cached_property
    def full(self) -> int:
        """The bits of all gears, where the drive comes from the upper end of its range."""
        return (1 << self._count(self.high - self.gears.x0)) - 1

    @cached_property
    def empty(self) -> int:
        """The bits of all gears, where the drive comes from the lower end of its range."""
        return self.full + 1 - (1 << self.covered)

    def _count(self, width: float) -> int:
        """Return how many gears, the first ones, span ``width``, to half a gear."""
        ends = np.cumsum(self.gears.dx)
        last = int(np.searchsorted(ends, width - 0.5 * float(self.gears.dx[-1])))
        return min(last + 1, self.gears.n)

    def bits(self, voltage: float, name: str = "auto") -> int:
        """Return the bits of the start ``name``.

        ``empty``: the actuator has been at or below the lower end of the drive's range.
        ``full``: likewise the upper end. ``settled``: after an oscillation that decays
        from the whole range to ``voltage``. ``below``, ``above``: the drive comes from
        beyond the spare gears of that end. ``auto``: empty where ``voltage`` is at or
        below the lower end, else settled (a model may keep another one:
        ``Cascade.auto_start``).

        Raises
        ------
        ModelError
            There is no start of that name.
        """
        fixed = {"below": 0, "above": (1 << self.gears.n) - 1}
        fixed |= {"full": self.full, "empty": self.empty}
        if name in fixed:
            return fixed[name]
        if name not in START_NAMES:
            raise ModelError(f"`state` {name}: give {', '.join(START_NAMES)} or a file")
        return self.gears.settled(voltage, self.covered, self.empty)

    def voltage_settled_at(self, output: float, low: float, high: float) -> float:
        """Return the voltage in [low, high] whose own settled state leads to ``output``.

        The output at rest in the settled state rises with the voltage, but by steps
        where the state changes: where it steps over ``output``, the voltage on the
        nearer side is taken. It is found by halving the range, and within the reach of
        one state exactly.
        """

        def miss_at(voltage: float) -> float:
            state = State(self.bits(voltage))
            return abs(float(self.gears.run([voltage], state).y[0]) - output)

        below, above = self.ends
        # a little beside the step, so that a voltage that is rounded on its way still
        # starts on the same side
        margin = CROSSING_TOLERANCE * (above - below)
        halved: tuple[float, float, float] = kernel.extension.backlash_settled_at(
            self.gears.operator(True, is_inverse=True), self.gears.words(self.empty),
            self.covered, output, below, above, 0.001 * margin,
        )  # fmt: skip
        below, above, voltage = halved
        if not math.isnan(voltage):
            return min(max(voltage, low), high)
        ends = [min(max(end, low), high) for end in (below - margin, above + margin)]
        return min(ends, key=miss_at)
