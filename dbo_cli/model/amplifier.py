"""The lag of an amplifier before the gears (beyond the paper).

u_k = u_k-1 + (1 - a)(v_k - u_k-1), a = exp(-dt/seconds): v is the drive that is logged and
played, u the voltage that reaches the actuator. It is undone exactly, without reading
ahead: v_k = u_k-1 + (u_k - u_k-1)/(1 - a). Limits of v are a window of u that moves with
u_k-1. At rest at the first sample, u is v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed, number, require_above_0
from dbo_cli.model.gears import Gears, Window, largest_step
from dbo_cli.model.points import Curves
from dbo_cli.model.relaxation import checked_steps
from dbo_cli.model.state import Run, State

AT_REST = 0.0, 1.0
"""Output before, and share, of the first sample of a record: u is v."""


@dataclass(frozen=True)
class Amplifier(Keyed):
    """A first-order lag of the drive.

    Parameters
    ----------
    seconds : float
        Its time constant, > 0.

    Raises
    ------
    ModelError
        ``seconds`` is not a finite time above 0.
    """

    seconds: float
    needs_time: ClassVar[bool] = True
    KEYS: ClassVar = {"seconds": number}

    def __post_init__(self) -> None:
        """Refuse what is not a time."""
        require_above_0("seconds", self.seconds)

    def share(self, dt: float | Floats) -> Floats:
        """Return 1 - a for one time step (s), or for each (InputError: one is negative)."""
        share: Floats = 1.0 - np.exp(-checked_steps(dt) / self.seconds)
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
        if before is None:
            before, shares[0] = AT_REST
        still = np.flatnonzero(shares == 0.0)
        if still.size:
            raise InputError(
                f"time step {int(still[0]) + 1}: 0 s: the amplifier's lag cannot be undone where "
                "time stands still (`resample` HZ)"
            )
        return before, shares

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return the voltage behind the amplifier for one block, and the state after it."""
        if x.size == 0:
            return Run(x, state)
        decay = np.exp(-checked_steps(dt) / self.seconds)
        memory, output = np.array([state.amplifier or 0.0]), np.empty(x.size)
        kernel.extension.memory_run(
            0.0, memory, state.amplifier is None, np.ascontiguousarray(x), output, decay
        )
        return Run(output, replace(state, amplifier=float(memory[0])))

    def undo(self, y: Floats, state: State, dt: float | Floats) -> Run:
        """Return the drive for one block of the voltage behind the amplifier, and the state after it."""
        if y.size == 0:
            return Run(y, state)
        before, shares = self.shares(state, dt, y.size)
        previous = np.concatenate([[before], y[:-1]])
        drive = previous + (y - previous) / shares
        return Run(drive, replace(state, amplifier=float(y[-1])))

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        return [{"amplifier": self.seconds}]


class AmplifiedRow(NamedTuple):
    """One row of a drive behind another one.

    Attributes
    ----------
    before : float
        Output of the amplifier at the row before.
    share : float
        1 - a.
    low, high : float
        Least and greatest drive.
    """

    before: float
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class AmplifiedGears:
    """Gears behind an amplifier and curves, undone together: limits of the drive reach through all."""

    amplifier: Amplifier
    head: Curves
    gears: Gears

    def window(self, row: AmplifiedRow) -> Window:
        """Return the range of the voltage at the gears for the drive of a row."""
        before, share = row.before, row.share
        lowest = before + share * (row.low - before)
        return self.head.ends(lowest, before + share * (row.high - before))

    def drive(self, voltage: float, row: AmplifiedRow) -> tuple[float, float]:
        """Return the drive of a row for a voltage at the gears, and what comes out of the amplifier."""
        output = self.head.inverse().value(voltage)
        drive = row.before + (output - row.before) / row.share
        return min(max(drive, row.low), row.high), output  # rounding on the way back

    def undo(
        self,
        output: Floats,
        state: State,
        dt: float | Floats,
        window: Window | None,
        slew: float | None,
    ) -> Run:
        """Return the drive for one block of the gears' output; see ``Gears.undo``.

        Rows are undone in blocks as if there were no limits. From the first one on that a
        limit may hold back, each is undone within its own window; then blocks grow again.
        """
        _, shares = self.amplifier.shares(state, dt, output.size)
        if window is None:
            return self._undo_freely(output, state, dt)[0]
        changes = np.broadcast_to(np.inf, output.shape)
        if slew is not None:
            changes = np.broadcast_to(largest_step(slew, dt), output.shape)
        drive = np.empty_like(output)
        row, size, clipped, first_clipped = 0, output.size, 0, 0
        while row < output.size:
            rows = slice(row, row + size)
            block = output[rows]
            steps = dt[rows] if isinstance(dt, np.ndarray) else dt
            done = self._undo_block(
                block, state, steps, shares[rows], changes[rows], window
            )
            count = done.y.size
            drive[row : row + count] = done.y
            if done.clipped and not clipped:
                first_clipped = row
            clipped += done.clipped
            row, state = row + count, done.state
            size = 1 if done.clipped or count < block.size else 2 * size
        return Run(drive, state, clipped, first_clipped)

    def _undo_freely(
        self, output: Floats, state: State, dt: float | Floats
    ) -> tuple[Run, Floats]:
        """Return the drive as if there were no limits, and the voltage at the gears."""
        done = self.gears.undo(output, state, dt)
        amplified = self.head.inverse()(done.y)
        run = self.amplifier.undo(amplified, done.state, dt)
        last = float(run.y[-1])
        return Run(run.y, replace(run.state, drive=last)), done.y

    def _undo_block(
        self,
        output: Floats,
        state: State,
        dt: float | Floats,
        shares: Floats,
        changes: Floats,
        window: Window,
    ) -> Run:
        """Return the drive of one row within its window, or of the rows before the first that is held.

        ``shares`` are 1 - a and ``changes`` the largest changes of the drive, row by row.
        """
        before = state.amplifier or 0.0
        stands = np.array([math.nan if state.drive is None else state.drive])
        if output.size == 1:
            low, high = (float(end[0]) for end in _range(stands, changes, window))
            row = AmplifiedRow(before, float(shares[0]), low, high)
            done = self.gears.undo(output, state, dt, self.window(row))
            drive, amplified = self.drive(float(done.y[0]), row)
            after = replace(done.state, amplifier=amplified, drive=drive)
            return Run(np.array([drive]), after, done.clipped)
        free, voltage = self._undo_freely(output, state, dt)
        previous = np.concatenate([[before], self.head.inverse()(voltage)[:-1]])
        lows, highs = _range(np.concatenate([stands, free.y[:-1]]), changes, window)
        ends = [
            self.head(previous + shares * (end - previous)) for end in (lows, highs)
        ]
        held = (free.y < lows) | (free.y > highs)
        held |= (voltage < np.minimum(*ends)) | (voltage > np.maximum(*ends))
        if not held.any():
            return free
        count = int(np.argmax(held))
        if count == 0:
            return Run(free.y[:0], state)
        steps = dt[:count] if isinstance(dt, np.ndarray) else dt
        return self._undo_freely(output[:count], state, steps)[0]


def _range(last: Floats, changes: Floats, window: Window) -> tuple[Floats, Floats]:
    """Return the least and greatest drive of each row behind ``last``; the window wins over the change."""
    low, high = window
    with np.errstate(invalid="ignore"):
        least, largest = last - changes, last + changes
    least[~(least >= low)] = low
    largest[~(largest <= high)] = high
    return np.minimum(least, high), np.maximum(largest, low)
