"""Digital-to-analogue converters: which code comes next, of one actuator and of many.

One step between codes may be larger than the slew limit allows in a sample. Then the
allowance of several samples is saved up for it: over any time the drive changes by no
more than the slew limit allows in that time and one code, and in one sample by no more
than the larger of the two. A drive that stands outside its range goes inwards, as far
as a step goes.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drives.gate import Bools, Floats
from dbo_cli.errors import InputError, UsageError
from dbo_cli.extras.live.rows import number
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.hysteresis.stepper import ROUNDING
from dbo_cli.logs.sources import samples

Step = tuple[int, float, float, float, bool]
"""A code, its voltage, the largest change that was allowed (V), what is saved up after it (V), and whether
the slew limit keeps a nearer one from coming.
"""


class Converter:
    """A digital-to-analogue converter within the limits of a drive.

    Parameters
    ----------
    volts : array_like
        The voltage of every code from 0 on, rising.
    limits : DriveLimits
        Of the drive; codes outside the range are not planned, but on the way into it.
    step : float, optional
        Largest change in one sample, V.

    Raises
    ------
    UsageError
        The curve does not rise, or no code lies within the limits.
    """

    def __init__(
        self, volts: ArrayLike, limits: DriveLimits, step: float | None
    ) -> None:
        curve = samples("dac", volts)
        if curve.size < 2 or not (np.diff(curve) > 0.0).all():
            raise UsageError(
                "`dac`: give the voltage of every code from 0 on, rising from code to code"
            )
        self.curve: list[float] = curve.tolist()
        self._low = bisect.bisect_left(self.curve, limits.v_min)
        self._high = bisect.bisect_right(self.curve, limits.v_max) - 1
        if self._low > self._high:
            raise UsageError(
                f"`dac`: no code lies within the limits of the drive, {limits.v_min:g} to {limits.v_max:g}"
            )
        self.step = math.inf if step is None else step
        gaps: list[float] = [b - a for a, b in itertools.pairwise(self.curve)]
        self._widest = max(gaps)
        self._gaps: list[float] = [
            max(pair) for pair in itertools.pairwise([gaps[0], *gaps, gaps[-1]])
        ]

    def require_within(self, name: str, volts: float) -> None:
        """Refuse a voltage that the converter cannot stand at: further than a code beyond its ends."""
        low, high = self.curve[0] - self._gaps[0], self.curve[-1] + self._gaps[-1]
        if not low <= volts <= high:
            raise UsageError(
                f"`{name}`: the drive stands at {volts:g}, and the converter gives {self.curve[0]:g} to"
                f" {self.curve[-1]:g} (`dac`)"
            )

    def code_of(self, code: object) -> int:
        """Return what was applied as a code (InputError where it is none)."""
        value = number("the code that was applied", code)
        if not 0 <= value < len(self.curve) or value != int(value):
            raise InputError(
                f"code {value:g} is not one of the converter's, 0 to {len(self.curve) - 1}"
            )
        return int(value)

    def most(self, last: float, saved: float) -> float:
        """Return the largest change that is allowed now, V; infinite where any is."""
        step = self.step
        if step >= self._widest:
            return step
        gap = self._gaps[min(bisect.bisect_left(self.curve, last), len(self._gaps) - 1)]
        return min(saved + step, max(step, gap))

    def left(self, change: float, most: float) -> float:
        """Return what is saved up after a change."""
        return 0.0 if most == math.inf else max(most - change, 0.0)

    def next(self, volts: float, last: float, saved: float) -> Step:
        """Return the code nearest to a voltage, of those within range and slew.

        ``last`` is the voltage that stands; NaN: any code may come.
        """
        curve = self.curve
        near = min(max(self._nearest(volts), self._low), self._high)
        if self.step == math.inf or math.isnan(last):
            return near, curve[near], math.inf, 0.0, False
        most, code = self.most(last, saved), near
        if not -most <= curve[near] - last <= most:
            code = self._within(near, last, most)
        change = abs(curve[code] - last)
        if change > most and self._is_between(last):
            most = change
        return code, curve[code], most, self.left(change, most), code != near

    def _nearest(self, volts: float) -> int:
        """Return the code nearest to a voltage, the lower of two that are as near."""
        after = bisect.bisect_left(self.curve, volts)
        if after == len(self.curve):
            return after - 1
        if after > 0 and self.curve[after] - volts >= volts - self.curve[after - 1]:
            return after - 1
        return after

    def _is_between(self, volts: float) -> bool:
        """Return whether a voltage is that of no code: the converter cannot stay there."""
        place = bisect.bisect_left(self.curve, volts)
        return place == len(self.curve) or self.curve[place] != volts

    def _within(self, near: int, last: float, most: float) -> int:
        """Return the code nearest to ``near`` within a change; from outside the range, the innermost."""
        curve = self.curve
        least, greatest = (
            bisect.bisect_left(curve, last - most),
            bisect.bisect_right(curve, last + most) - 1,
        )
        # A code exactly as far away as the largest change is not to be lost to the
        # rounding of a sum.
        if least > 0 and last - curve[least - 1] <= most:
            least -= 1
        if greatest + 1 < len(curve) and curve[greatest + 1] - last <= most:
            greatest += 1
        low, high = max(self._low, least), min(self._high, greatest)
        if low <= high:
            return min(max(near, low), high)
        # From outside the range as far inwards as a step goes, or to the next code
        # where none stands.
        above = bisect.bisect_left(curve, last)
        below = bisect.bisect_right(curve, last) - 1
        if last > curve[self._high]:
            return max(min(least, below), self._high)
        if last < curve[self._low]:
            return min(max(greatest, above), self._low)
        return above if curve[above] - last < last - curve[below] else below


class Codes:
    """One converter's curve for many channels; the rules of ``Converter``, on arrays.

    Parameters
    ----------
    converters
        Of the channels, each with its own limits.
    """

    def __init__(self, converters: Sequence[Converter]) -> None:
        first = converters[0]
        self._curve = np.array(first.curve)
        self._gaps, self._widest = np.array(first._gaps), first._widest
        self._low = np.array([one._low for one in converters])
        self._high = np.array([one._high for one in converters])
        self._step = np.array([one.step for one in converters])

    def next(
        self, volts: Floats, last: Floats, saved: Floats
    ) -> tuple[NDArray[np.int64], Floats, Floats, Floats, Bools]:
        """Return what ``Converter.next`` does, an array of each."""
        curve = self._curve
        most = self._most(last, saved)
        codes = near = self._nearest(volts)
        change = np.abs(curve[near] - last)
        if not (change <= most).all():
            above = np.searchsorted(curve, last, "left")
            inner = self._within(near, last, most, above)
            codes = np.where(change <= most, near, inner)
            change = np.abs(curve[codes] - last)
            between = curve[np.minimum(above, len(curve) - 1)] != last
            most = np.where((change > most) & between, change, most)
        left = np.where(np.isinf(most), 0.0, np.maximum(most - change, 0.0))
        return codes, curve[codes], most, left, codes != near

    def left(self, volts: Floats, last: Floats, saved: Floats) -> Floats:
        """Return what is saved up after voltages that were not planned here."""
        most = self._most(last, saved)
        return np.where(
            np.isinf(most), 0.0, np.maximum(most - np.abs(volts - last), 0.0)
        )

    def volts_of(self, codes: Floats, channels: Sequence[str]) -> Floats:
        """Return the voltages of codes that were applied (InputError where one is none)."""
        good = (codes == np.floor(codes)) & (codes >= 0) & (codes < len(self._curve))
        if not good.all():
            place = int(np.argmin(good))
            raise InputError(
                f"channel {channels[place]}: code {codes[place]:g} is not one of the converter's, 0 to"
                f" {len(self._curve) - 1}"
            )
        return self._curve[codes.astype(np.int64)]

    def _most(self, last: Floats, saved: Floats) -> Floats:
        """Return the largest change of each channel that is allowed now."""
        places = np.minimum(
            np.searchsorted(self._curve, last, "left"), len(self._curve) - 1
        )
        fine = np.maximum(self._step, self._gaps[places])
        return np.where(
            self._step < self._widest, np.minimum(saved + self._step, fine), self._step
        )

    def _nearest(self, volts: Floats) -> NDArray[np.int64]:
        """Return the codes of the range nearest to voltages, the lower of two that are as near."""
        curve, end = self._curve, len(self._curve) - 1
        after = np.searchsorted(curve, volts, "left")
        inside = (after > 0) & (after <= end)
        above, below = curve[np.minimum(after, end)], curve[np.maximum(after - 1, 0)]
        near = after - (inside & (above - volts >= volts - below))
        within: NDArray[np.int64] = np.minimum(np.maximum(near, self._low), self._high)
        return within

    def _within(
        self,
        near: NDArray[np.int64],
        last: Floats,
        most: Floats,
        above: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return what ``Converter._within`` does, an array of it."""
        curve, end = self._curve, len(self._curve) - 1
        least = np.searchsorted(curve, last - most, "left")
        greatest = np.searchsorted(curve, last + most, "right") - 1
        least -= (least > 0) & (last - curve[np.maximum(least - 1, 0)] <= most)
        greatest += (greatest < end) & (
            curve[np.minimum(greatest + 1, end)] - last <= most
        )
        low, high = np.maximum(self._low, least), np.minimum(self._high, greatest)
        inside = np.minimum(np.maximum(near, low), high)
        below = np.searchsorted(curve, last, "right") - 1
        down = np.maximum(np.minimum(least, below), self._high)
        up = np.minimum(np.maximum(greatest, above), self._low)
        upper, lower = np.minimum(above, end), np.maximum(below, 0)
        nearer = np.where(curve[upper] - last < last - curve[lower], upper, lower)
        outside = np.where(
            last > curve[self._high],
            down,
            np.where(last < curve[self._low], up, nearer),
        )
        return np.where(low <= high, inside, outside)


def codes_may_follow(
    volts: Floats, last: Floats, low: Floats, high: Floats, most: Floats
) -> Bools:
    """Return where voltages may follow the last ones: ``stepper.may_follow`` on arrays."""
    inside = (low <= volts) & (volts <= high)
    inside |= (last < low) & (last <= volts) & (volts <= low)
    inside |= (last > high) & (high <= volts) & (volts <= last)
    digits = ROUNDING * np.maximum(np.abs(last), np.abs(volts))
    return inside & (np.abs(volts - last) <= most + digits)
