"""The gate: no row leaves for an amplifier that breaks a limit, wherever it was computed.

Planning keeps the limits; the gate only looks. What it finds is a fault of this program
(GateError), and nothing is written. ``dbo check`` asks the same gate about drives of
other programs. What passes is measured (``DriveFigures``).
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, LimitError
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.hysteresis.stepper import ROUNDING

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
LARGEST = sys.float_info.max  # beyond it is infinity, which no limit allows


class GateError(DboError):
    """The program computed a drive that breaks its own limits: exit 1, nothing written."""


class DriveGate:
    """Watches rows go by: range, slew, and the row before, wherever that came from.

    Parameters
    ----------
    limits : DriveLimits
        What the drive may do.
    last : float, optional
        Where the drive stands before the first row, where that is known. From outside
        the range it may only come inwards.
    suffix : str
        The unit, behind a blank, for messages.
    may_wait : bool
        Whether a drive that comes from outside may stand still there: a converter does,
        which saves up for a step larger than its slew limit. Otherwise its first row
        alone may be where it stood.

    Attributes
    ----------
    outside : int
        How many rows came from outside the range and were outside still.
    """

    def __init__(
        self,
        limits: DriveLimits,
        last: float | None = None,
        suffix: str = "",
        may_wait: bool = True,
    ) -> None:
        self.limits = limits
        self.last = last
        self.suffix = suffix
        self.may_wait = may_wait
        self.outside = 0
        self._begun = False

    def broken(self, drive: Floats, time_step: float | Floats | None = None) -> Bools:
        """Return which rows break a limit; the gate goes on behind the last row.

        Parameters
        ----------
        drive : array
            Consecutive rows.
        time_step : float or array, optional
            Seconds since the row before; needed with a slew limit.
        """
        limits, last = self.limits, self.last
        low, high = max(limits.v_min, -LARGEST), min(limits.v_max, LARGEST)
        bad: Bools = ~((drive >= low) & (drive <= high))
        if last is not None and not low <= last <= high:
            coming = self._inwards(drive, last)
            bad[:coming] = ~np.isfinite(drive[:coming])
            self.outside += coming
        step = limits.largest_step(time_step)
        if step is not None:
            before = _before(drive, last)
            change = drive - before
            np.abs(change, out=change)
            if not (change <= step).all():  # else the last digits need no look
                digits = ROUNDING * np.maximum(np.abs(drive), np.abs(before))
                bad |= ~(change <= step + digits)
        if drive.size:
            self.last = float(drive[-1])
            self._begun = True
        return bad

    def _inwards(self, drive: Floats, last: float) -> int:
        """Return how many rows, the first ones, come inwards from outside the range and are outside still."""
        if last > self.limits.v_max:
            bound, sign = self.limits.v_max, 1.0
        else:
            bound, sign = self.limits.v_min, -1.0
        before = _before(drive, last)
        outwards: Bools = sign * drive > sign * before
        refused = outwards
        if not self.may_wait:
            refused = outwards | (drive == before)
        if not self._begun:
            refused[:1] = outwards[:1]  # the first row may be where the drive stood
        coming = (sign * drive > sign * bound) & ~refused
        if coming.all():
            return drive.size
        return int(np.argmin(coming))

    def violation(self, drive: Floats, time_step: float | Floats | None = None) -> str:
        """Say why the first row that breaks a limit does so, nothing where none does; see ``broken``."""
        last = self.last
        bad = self.broken(drive, time_step)
        if not bad.any():
            return ""
        row = int(np.argmax(bad))
        return self.reason(float(drive[row]), float(_before(drive, last)[row]))

    def reason(self, drive: float, before: float) -> str:
        """Say why a row behind another one breaks a limit."""
        limits, unit = self.limits, self.suffix
        if not math.isfinite(drive):
            return f"{drive} is no voltage"
        if not limits.v_min <= drive <= limits.v_max:
            return f"{drive:.9g}{unit} is outside {limits.v_min:.9g} to {limits.v_max:.9g}{unit}"
        most = f"{limits.max_slew:g}{unit} per second"
        return (
            f"from {before:.9g} to {drive:.9g}{unit} in one row is faster than {most}"
        )

    def admit(self, drive: Floats, time_step: float | Floats | None = None) -> None:
        """Let rows pass.

        Raises
        ------
        GateError
            A row breaks a limit.
        """
        if reason := self.violation(drive, time_step):
            raise GateError(
                f"this program computed a drive that breaks its limits: {reason}; nothing more is written "
                "(please report it)"
            )

    def require_start(
        self, time_step: float | None, first: float | None = None
    ) -> None:
        """Refuse a first row that cannot be reached from where the amplifier stands.

        Parameters
        ----------
        time_step : float, optional
            Seconds from there to the first row.
        first : float, optional
            The first row; not given, any row inside the range will do.

        Raises
        ------
        LimitError
            It is further away than the slew limit allows in one time step.
        """
        limits, last, unit = self.limits, self.last, self.suffix
        step = limits.largest_change(time_step)
        if last is None or step is None:
            return
        if first is None:
            low, high = limits.v_min, limits.v_max
            aim = f"its limits, {low:.6g} to {high:.6g}"
        else:
            low = high = first
            aim = f"{first:.6g}"
        if max(low - last, last - high) > step:
            raise LimitError(
                f"the drive comes from {last:.6g}{unit}, and {limits.max_slew:g}{unit} per second does not "
                f"bring it to {aim}{unit}, in one row (`approach` SECONDS ramps there)"
            )


def _before(drive: Floats, last: float | None) -> Floats:
    """Return the row before each, ``last`` before the first one."""
    if last is None:
        return np.concatenate([drive[:1], drive[:-1]])
    return np.concatenate([[last], drive[:-1]])


@dataclass
class DriveFigures:
    """What a drive asks of an amplifier, row by row.

    Attributes
    ----------
    low, high : float
        The least and the greatest row.
    first, last : float, or None
        The first row and the last one seen.
    rows : int
        How many rows were seen.
    largest_step : float
        Between two rows, that to the first one aside.
    travel, work, seconds, fastest : float
        Sums of |dv| and of |v dv|, the time they took (s), and the greatest |dv|/dt.
    """

    low: float = math.inf
    high: float = -math.inf
    first: float | None = None
    last: float | None = None
    rows: int = 0
    largest_step: float = 0.0
    travel: float = 0.0
    work: float = 0.0
    seconds: float = 0.0
    fastest: float = 0.0

    def see(self, drive: Floats, steps: float | Floats | None) -> None:
        """See consecutive rows."""
        if not drive.size:
            return
        self.low = min(self.low, float(drive.min()))
        self.high = max(self.high, float(drive.max()))
        before = drive[0] if self.last is None else self.last
        change = np.abs(np.diff(drive, prepend=before))
        if steps is not None:
            self._see_rates(change, steps)
        self.largest_step = max(self.largest_step, float(change.max()))
        self.travel += float(change.sum())
        self.work += float((np.abs(drive) * change).sum())
        if self.first is None:
            self.first = float(drive[0])
        self.last = float(drive[-1])
        self.rows += drive.size

    def _see_rates(self, change: Floats, steps: float | Floats) -> None:
        """See how fast the rows change; before the very first one there is no step."""
        begin = 1 if self.last is None else 0
        time = np.broadcast_to(steps, change.shape)[begin:]
        moved = change[begin:]
        self.seconds += float(time.sum())
        with np.errstate(over="ignore"):  # in steps of next to no time
            rates = moved[time > 0.0] / time[time > 0.0]
        self.fastest = max(self.fastest, float(rates.max(initial=0.0)))
