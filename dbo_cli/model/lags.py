"""First-order lags of the voltage (beyond the paper): relaxation beside the gears, an amplifier before them.

Relaxation is lag and creep, sum_j gain_j L_j; negative gains must leave enough of the slopes.

An amplifier: u_k = u_k-1 + (1 - a)(v_k - u_k-1), a = exp(-dt/seconds): v is the drive that is
logged and played, u the voltage that reaches the actuator. It is undone exactly, without reading
ahead: v_k = u_k-1 + (u_k - u_k-1)/(1 - a). Limits of v are a window of u that moves with
u_k-1. At rest at the first sample, u is v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats, Range
from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed, above_0, listed, number, number_list
from dbo_cli.model.points import Curves
from dbo_cli.model.state import Run, State


def checked_steps(dt: float | ArrayLike) -> Floats:
    """Return time steps (s) as an array; InputError where one is negative or not a number."""
    steps = np.asarray(dt, dtype=np.float64).reshape(-1)
    right = steps >= 0.0
    if right.all():
        return steps
    row = int(np.argmin(right))
    raise InputError(
        f"time step {row + 1}: {float(steps[row])!r} s; time must not go backwards"
    )


@dataclass(frozen=True)
class Relaxation(Keyed):
    """Lag and creep beside the gears: sum_j gain_j L_j, each L_j a first-order lag of the voltage.

    L_j,k = a_j L_j,k-1 + (1 - a_j)(v_k - reference), a_j = exp(-dt_k/tau_j). Beyond the
    paper.

    Attributes
    ----------
    reference : float
        Voltage at which nothing is remembered.
    tau : tuple of float
        Time constants in seconds, > 0.
    gain : tuple of float
        Output per volt, one for each time constant; may be negative (``Gears`` checks how
        much the slopes of the gears allow).
    """

    reference: float
    tau: tuple[float, ...]
    gain: tuple[float, ...]
    KEYS: ClassVar = {
        "reference": number,
        "tau": partial(listed, read=above_0),
        "gain": number_list,
    }

    def __post_init__(self) -> None:
        """Refuse what no actuator has, naming the key."""
        if not 0 < len(self.tau) == len(self.gain):
            raise ModelError(
                f"gain: has {len(self.gain)} entries where tau has {len(self.tau)}, and 1 is the least"
            )

    def decay(self, dt: float | ArrayLike) -> Floats:
        """Return a_j = exp(-dt/tau_j) as rows: one for a single time step (s), else one a sample.

        Raises
        ------
        InputError
            A time step is negative or not a number.
        """
        return (
            _even_decay(self.tau, dt) if isinstance(dt, float) else _decay(self.tau, dt)
        )

    def lags(
        self,
        voltage: ArrayLike,
        dt: float | ArrayLike,
        memory: Sequence[float] | None = None,
    ) -> tuple[Floats, tuple[float, ...]]:
        """Return L_j after each sample (rows x terms), and after the last.

        Without ``memory`` the actuator rests at the first sample.
        """
        drive = np.ascontiguousarray(voltage, dtype=np.float64)
        memories = np.array(memory or np.zeros(len(self.tau)), dtype=np.float64)
        rows = np.empty((drive.size, len(self.tau)))
        kernel.extension.memory_run(
            self.reference, memories, memory is None, drive, rows, self.decay(dt)
        )
        return rows, tuple(memories.tolist())


def _decay(tau: tuple[float, ...], dt: float | ArrayLike) -> Floats:
    factors: Floats = np.exp(-checked_steps(dt)[:, np.newaxis] / np.array(tau))
    factors.flags.writeable = False
    return factors


# of one time step; every block of a stream asks for it
_even_decay = lru_cache(maxsize=32)(_decay)


# --- the amplifier ---


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
