"""The gate: no row leaves for an amplifier that breaks a limit, wherever it was computed.

Planning keeps the limits; the gate only looks, row by row, and knows nothing of how the
rows were made. What it finds is a fault of this program, and nothing more is written.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.arrays import Booleans, Floats
from dbo_cli.drive.limits import Limits
from dbo_cli.errors import DboError, LimitError

ROUNDING = 8.0 * 2.0**-52
"""Of the larger of two voltages: the last digits of a step, each voltage being rounded once or twice on its
way through points and scales. A slew limit is kept to that, a range exactly.
"""


class GateError(DboError):
    """The program computed a drive that breaks its own limits: exit 1, nothing more is written."""


class Gate:
    """Watches rows go by: range, slew, and the row before.

    Parameters
    ----------
    limits : Limits
        What the drive may do.
    last : float, optional
        Where the amplifier stands before the first row; not given, any first row inside
        the range may come.

    Attributes
    ----------
    last : float or None
        The last row that was seen.
    """

    def __init__(self, limits: Limits, last: float | None = None) -> None:
        self.limits = limits
        self.last = last

    def broken(
        self, voltage: Floats, dt: float | Floats | None = None, part: str = "move"
    ) -> Booleans:
        """Return which rows break a limit; the gate goes on behind the last row.

        Parameters
        ----------
        voltage : array
            Consecutive rows.
        dt : float or array, optional
            Seconds since the row before; needed with a slew limit.
        part : {"move", "lead", "return"}
            What the rows are: rows of a move keep the move's range, others the rating.

        Raises
        ------
        InputError
            There is a slew limit and no ``dt``.
        """
        if voltage.size == 0:
            return np.zeros(0, dtype=np.bool_)
        low, high = self.limits.range_of(part)
        inside = np.isfinite(voltage) & (voltage >= low) & (voltage <= high)
        bad: Booleans = ~inside
        most = self.limits.largest_step(dt)
        if most is not None:
            before = self._before(voltage)
            digits = ROUNDING * np.maximum(np.abs(voltage), np.abs(before))
            slow = np.abs(voltage - before) <= most + digits
            if self.last is None:
                slow[0] = True
            bad |= ~slow
        self.last = float(voltage[-1])
        return bad

    def admit(
        self, voltage: Floats, dt: float | Floats | None = None, part: str = "move"
    ) -> None:
        """Let rows pass; see ``broken``.

        Raises
        ------
        GateError
            A row breaks a limit.
        """
        before = self._before(voltage)
        bad = self.broken(voltage, dt, part)
        if not bad.any():
            return
        row = int(np.argmax(bad))
        reason = self.reason(float(voltage[row]), float(before[row]), part)
        raise GateError(
            f"internal error: a computed row breaks the limits: {reason}; the output ends here "
            "(please report it)"
        )

    def reason(self, voltage: float, before: float, part: str = "move") -> str:
        """Say why a row behind another one breaks a limit."""
        low, high = self.limits.range_of(part)
        unit = self.limits.suffix
        if not math.isfinite(voltage):
            return f"{voltage} is no voltage"
        if voltage > high:
            return f"{voltage:.9g}{unit} is above {high:.9g}{unit}"
        if voltage < low:
            return f"{voltage:.9g}{unit} is below {low:.9g}{unit}"
        return (
            f"{before:.9g} to {voltage:.9g}{unit} in one row is faster than "
            f"{self.limits.slew:g}{unit}/s"
        )

    def require_reachable(
        self, low: float, high: float, dt: float | Floats | None
    ) -> None:
        """Refuse a first row between ``low`` and ``high`` that one step does not reach (LimitError).

        Nothing is known before the first row where ``last`` is None.
        """
        first = float(dt[0]) if isinstance(dt, np.ndarray) else dt
        most = self.limits.largest_step(first)
        if self.last is None or most is None:
            return
        if max(low - self.last, self.last - high) > most:
            unit = self.limits.suffix
            aim = f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
            raise LimitError(
                f"the amplifier is at {self.last:.6g}{unit}; {self.limits.slew:g}{unit}/s does not reach "
                f"{aim}{unit} in one row: add `approach` auto"
            )

    def _before(self, voltage: Floats) -> Floats:
        """Return the row before each row."""
        first = voltage[:1] if self.last is None else [self.last]
        return np.concatenate([first, voltage[:-1]])
