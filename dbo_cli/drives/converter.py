"""A digital-to-analogue converter: the code for a voltage, within the limits of a drive."""

from __future__ import annotations

import bisect
import itertools

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, UsageError
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.logs.sources import samples


class Converter:
    """A digital-to-analogue converter within the limits of a drive.

    One step between codes may be larger than the slew limit allows in a sample. Then the allowance of several
    samples is saved up for it: over any time the drive changes by no more than the slew limit allows in that
    time and one code, and in one sample by no more than the larger of the two.

    Parameters
    ----------
    volts : array_like
        The voltage of every code from 0 on, rising.
    limits : DriveLimits
        Of the drive; codes outside the range are never planned.
    most : float, optional
        Largest change in one sample, V.

    Raises
    ------
    UsageError
        The curve does not rise, or no code lies within the limits.
    """

    def __init__(self, volts: ArrayLike, limits: DriveLimits, most: float | None) -> None:
        curve = samples("dac", volts)
        if curve.size < 2 or not (np.diff(curve) > 0.0).all():
            raise UsageError("`dac`: give the voltage of every code from 0 on, rising from code to code")
        self.curve: list[float] = curve.tolist()
        self._low = bisect.bisect_left(self.curve, limits.v_min)
        self._high = bisect.bisect_right(self.curve, limits.v_max) - 1
        if self._low > self._high:
            raise UsageError(
                f"`dac`: no code lies within the limits of the drive, {limits.v_min:g} to {limits.v_max:g}"
            )
        self.step, self.saved = most, 0.0
        gaps: list[float] = [b - a for a, b in itertools.pairwise(self.curve)]
        self._widest = max(gaps)
        self._gaps: list[float] = [max(pair) for pair in itertools.pairwise([gaps[0], *gaps, gaps[-1]])]

    def volts(self, code: int | float) -> float:
        """Return the voltage of a code (InputError where there is none)."""
        if code != int(code) or not 0 <= code < len(self.curve):
            raise InputError(f"code {code} is not one of the converter's, 0 to {len(self.curve) - 1}")
        return self.curve[int(code)]

    def most(self, last: float | None) -> float | None:
        """Return the largest change that is allowed now, V; None where any is."""
        step = self.step
        if step is None or last is None:
            return None
        if step < self._widest:
            gap = self._gaps[min(bisect.bisect_left(self.curve, last), len(self._gaps) - 1)]
            return min(self.saved + step, max(step, gap))
        return step

    def code(self, volts: float, last: float | None, most: float | None) -> int:
        """Return the code nearest to a voltage, of those within range and slew; the last one, if none is."""
        curve, low, high = self.curve, self._low, self._high
        after = bisect.bisect_left(curve, volts)
        near = after - (0 < after < len(curve) and curve[after] - volts >= volts - curve[after - 1])
        near = low if near < low else high if near > high else near
        if most is None or last is None or -most <= curve[near] - last <= most:
            return near
        low = max(low, bisect.bisect_left(curve, last - most))
        high = min(high, bisect.bisect_right(curve, last + most) - 1)
        if low > high:  # from outside the range, or between two codes
            return min(max(bisect.bisect_left(curve, last), self._low), self._high)
        return low if near < low else high

    def commit(self, change: float, most: float | None) -> None:
        """Take what a change used off what was saved up."""
        if most is not None:
            self.saved = max(most - change, 0.0)
