"""The lag of an amplifier before the gears (beyond the paper).

u_k = u_k-1 + (1 - a)(v_k - u_k-1), a = exp(-dt/seconds): v is the drive that is logged and
played, u the voltage that reaches the actuator. It is undone exactly, without reading
ahead: v_k = u_k-1 + (u_k - u_k-1)/(1 - a). Limits of v are a window of u that moves with
u_k-1. At rest at the first sample, u is v.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats, Range
from dbo_cli.errors import InputError
from dbo_cli.model.fields import Keyed, above_0
from dbo_cli.model.points import Curves
from dbo_cli.model.relaxation import Relaxation
from dbo_cli.model.state import Run, State


@dataclass(frozen=True)
class Amplifier(Keyed):
    """A first-order lag of the drive.

    Parameters
    ----------
    seconds : float
        Its time constant, > 0.
    """

    seconds: float
    KEYS: ClassVar = {"seconds": above_0}

    @cached_property
    def _lag(self) -> Relaxation:
        return Relaxation(0.0, (self.seconds,), (1.0,))

    def share(self, dt: float | Floats) -> Floats:
        """Return 1 - a for one time step (s), or for each (InputError: one is negative)."""
        share: Floats = 1.0 - self._lag.decay(dt)[:, 0]
        return share

    def shares(
        self, state: State, dt: float | Floats, count: int
    ) -> tuple[float, Floats]:
        """Return the output before a block of samples, and 1 - a for each of them.

        Raises
        ------
        InputError
            The clock stands still: no drive changes the output in no time.
        """
        shares = np.array(np.broadcast_to(self.share(dt), (count,)))
        before = state.amplifier
        if before is None:  # u is v
            before, shares[0] = 0.0, 1.0
        still = np.flatnonzero(shares == 0.0)
        if still.size:
            raise InputError(
                f"time step {int(still[0]) + 1}: 0 s: the amplifier's lag cannot be undone where "
                "time stands still (`resample` HZ)"
            )
        return before, shares

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return the voltage behind the amplifier for one block, and the state after it."""
        before = None if state.amplifier is None else (state.amplifier,)
        rows, after = self._lag.lags(x, dt, before)
        return Run(rows[:, 0], replace(state, amplifier=after[0]))

    def undo(self, y: Floats, state: State, dt: float | Floats) -> Run:
        """Return the drive for one block of the voltage behind the amplifier, and the state after it."""
        before, shares = self.shares(state, dt, y.size)
        previous = np.concatenate([[before], y[:-1]])
        drive = previous + (y - previous) / shares
        return Run(drive, replace(state, amplifier=float(y[-1])))

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        return [{"amplifier": self.seconds}]


def output_behind(before: Any, share: Any, drive: Any) -> Any:
    """Return the amplifier's output for a drive: ``before`` at the row before, ``share`` 1 - a."""
    return before + share * (drive - before)


class Reach(NamedTuple):
    """What the limits of a row's drive leave to the gears behind an amplifier.

    Attributes
    ----------
    head : Curves
        Between the amplifier and the gears.
    before : float
        Output of the amplifier at the row before.
    share : float
        1 - a.
    low, high : float
        Least and greatest drive of the row.
    """

    head: Curves
    before: float
    share: float
    low: float
    high: float

    @property
    def window(self) -> Range:
        """The range of the voltage at the gears."""
        low = output_behind(self.before, self.share, self.low)
        high = output_behind(self.before, self.share, self.high)
        return self.head.ends(low, high)

    def drive(self, voltage: float) -> tuple[float, float]:
        """Return the row's drive for a voltage at the gears, and the amplifier's output."""
        output = self.head.inverse.value(voltage)
        drive = self.before + (output - self.before) / self.share
        return min(max(drive, self.low), self.high), output  # rounding on the way back


def allowed_drive(last: Any, change: Any, window: Range) -> tuple[Any, Any]:
    """Return the least and greatest drive behind ``last`` (NaN: unknown); the window wins over the change."""
    low, high = window
    lowest = np.fmin(np.fmax(last - change, low), high)
    highest = np.fmax(np.fmin(last + change, high), low)
    return lowest, highest
