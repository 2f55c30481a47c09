"""The kernel of ``firmware/dbo_kernel_single.c`` in readable Python: the same bits in float32 and in q31.

It computes what the self-test expects, where no compiler may be. Gears are crossed one
by one here; the C file crosses many at once and ends in the same state, because what is
left to travel falls with every gear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dbo_cli.hysteresis.cascade import window_place
from dbo_cli.hysteresis.kernel import find_first_one, find_first_zero
from dbo_cli.interpolation.smooth import WINDOW, between, nearer

F = np.float32
# as in dbo_kernel_single.c: beyond every position, and a difference of two fits 64 bits
FARTHEST = 1 << 60
INT32 = (-(2**31), 2**31 - 1)  # what an int32_t holds

Number = Any
"""What is float32 in one arithmetic and a whole number in the other; positions are whole in both."""

MOST_COUNTS = F(2147483520.0)
"""The greatest float32 below 2^31."""


@dataclass(frozen=True)
class Segments:
    """A piecewise linear function: rows (x, y, slope), the slope in q31 times 2^shift."""

    rows: list[tuple[Number, Number, Number]]
    shift: int

    def row(self, u: Number) -> tuple[Number, Number, Number]:
        """Return the segment in which ``u`` lies; the end segments go on."""
        reached = [row for row in self.rows[1:] if u >= row[0]]
        return reached[-1] if reached else self.rows[0]


@dataclass(frozen=True)
class SingleTables:
    """All constants of one export in float32 or q31; see ``dbo_kernel_single.h`` for each.

    Gears are rows (width, height, slope), one for ``run`` gears; terms are (carried,
    rest, rest_shift). ``slope_shift`` means nothing in float32. ``clip`` is what the
    output may be, ``change`` how far it may go in a step; ``first`` is the one before
    the first sample.
    """

    q31: bool
    rows: list[tuple[int, int, Number]]
    n: int
    run: int
    tolerance: int
    terms: list[tuple[int, int, int]]
    carried_shift: int
    memory_on_output: bool
    drive_offset: int
    drive_shift: int
    slope_shift: int
    x_shift: int
    y_shift: int
    least: int
    most: int
    limits: tuple[int, int, int] | None
    covered: int
    spare_bits: int
    before: Segments
    behind: Segments
    drive: Segments
    clip: tuple[Number, Number] | None
    change: Number | None
    first: Number
    delay: tuple[int, Number]
    smooth: bool


def scaled_down(value: int, shift: int) -> int:
    """Return value / 2^shift, rounded to nearest, halves up."""
    return value if shift == 0 else (value + (1 << (shift - 1))) >> shift


def clamped(value: int, bounds: tuple[int, int] = INT32) -> int:
    """Return ``value`` within bounds."""
    return min(max(value, bounds[0]), bounds[1])


WEIGHTS = (
    (-25, 48, -36, 16, -3),
    (-3, -10, 18, -6, 1),
    (1, -8, 0, 8, -1),
    (-1, 6, -18, 10, 3),
    (3, -16, 36, -48, 25),
)
"""Twelve times the slope of the polynomial through five samples at each of them."""

PARTS = 2**26
"""Of a step, as ``dbo_interpolation_q31.h`` counts them."""


def between_counts(y: list[int], k: int, part: int) -> int:
    """Return the signal the part / 2^26 of a step behind sample k of six, as ``dbo_between`` does in q31."""
    rise = y[k + 1] - y[k]
    begins, ends = slope_of_counts(y, k) - rise, slope_of_counts(y, k + 1) - rise
    rest = PARTS - part
    bend = scaled_down(rest * scaled_down(rest * begins - part * ends, 26), 26)
    return clamped(scaled_down(y[k] * PARTS + part * (rise + bend), 26))


def slope_of_counts(y: list[int], a: int) -> int:
    """Return the slope at sample a of six, limited, as ``dbo_slope`` does in q31."""
    last = WINDOW - 1
    start = 0 if a < 3 else 1
    secant = [y[i + 1] - y[i] for i in range(last)]
    curve = [secant[i + 1] - secant[i] for i in range(last - 1)]
    slope = 0
    for weight, value in zip(WEIGHTS[a - start], y[start : start + 5], strict=True):
        slope += weight * value
    left = right = 0
    if a > 0:
        before = curve[a - 2] if a > 1 else curve[a - 1]
        inner = curve[a - 1] if a < last else before
        left = 2 * secant[a - 1] + int(nearer(before, inner))
    if a < last:
        after = curve[a] if a < last - 1 else curve[a - 1]
        inner = curve[a - 1] if a > 0 else after
        right = 2 * secant[a] - int(nearer(inner, after))
    if a == 0:
        chord, parabola = secant[0], right
    elif a == last:
        chord, parabola = secant[last - 1], left
    else:
        chord, parabola = (
            int(nearer(secant[a - 1], secant[a])),
            int(nearer(left, right)),
        )
    slope = max(slope, min(0, 36 * chord, 9 * parabola))
    slope = min(slope, max(0, 36 * chord, 9 * parabola))
    return -((6 - slope) // 12) if slope < 0 else (slope + 6) // 12


class SingleKernel:
    """One actuator's state and its steps, in the arithmetic of the tables."""

    def __init__(self, tables: SingleTables) -> None:
        self.t = tables
        self.bits = tables.spare_bits
        self.load()
        self.last, self.output = self.y, tables.first
        self.memory = [0] * len(tables.terms)
        self.delayed: list[Number] = []

    # ---- what differs between the arithmetics

    def along(self, slope: Number, distance: Number, shift: int) -> Number:
        """Return slope x way of a piecewise linear function."""
        if not self.t.q31:
            return slope * distance
        if INT32[0] <= distance <= INT32[1]:
            return scaled_down(slope * distance, shift)
        return scaled_down(slope * clamped(scaled_down(distance, 16)), shift - 16)

    def along_gear(self, slope: Number, distance: int) -> int:
        """Return slope x way of a gear, in positions."""
        if self.t.q31:
            return int(self.along(slope, distance, self.t.slope_shift))
        if INT32[0] <= distance <= INT32[1]:
            return self.position_of(slope * F(distance), 0)
        return self.position_of(
            slope * F(self.counts_of(distance, self.t.y_shift)), self.t.y_shift
        )

    def position_of(self, signal: Number, shift: int) -> int:
        """Return a signal as positions."""
        if self.t.q31:
            return int(signal)
        coarse = 0 if -MOST_COUNTS <= signal <= MOST_COUNTS else 8
        signal = signal * F(2.0**-coarse)
        return int(min(max(signal, -MOST_COUNTS), MOST_COUNTS)) << (shift + coarse)

    @staticmethod
    def counts_of(value: int, shift: int) -> int:
        """Return a position in counts."""
        return clamped(scaled_down(value, shift))

    # ---- memories

    def drive_of(self, value: int) -> int:
        """Return the remembered signal as the memories hold it."""
        return clamped(self.counts_of(value, self.t.drive_shift) + self.t.drive_offset)

    def remember(self, drive: int) -> None:
        """Let the memories follow."""
        for j, (_, rest, shift) in enumerate(self.t.terms):
            self.memory[j] += (drive - (self.memory[j] >> 24)) * rest >> (shift - 24)

    # ---- the procedure

    def load(self) -> None:
        """Work out X_B and Y_B from the bits."""
        self.x = self.y = 0
        for i in range(self.t.n):
            if self.bits >> i & 1:
                self.x = self.x + self.t.rows[i // self.t.run][0]
                self.y = self.y + self.t.rows[i // self.t.run][1]

    def _next(self, rising: bool) -> int:
        """Return the next gear to be crossed, n where there is none."""
        if rising:
            return find_first_zero(self.bits)
        return find_first_one(self.bits, self.t.n)

    def pass_gears(self, u: int, bound: int, rising: bool) -> int:
        """Cross gears one way; return the last one crossed, n where there was none."""
        last = self.t.n
        sign = 1 if rising else -1
        while (gear := self._next(rising)) < self.t.n:
            width, height, _ = self.t.rows[gear // self.t.run]
            tolerance = self.t.tolerance
            if sign * (u - self.x) < width - (width >> tolerance):
                break
            if sign * (bound - self.y) < height - (height >> tolerance):
                break
            last = gear
            self.x += sign * width
            self.y += sign * height
            self.bits ^= 1 << gear
        return last

    def follow_output(self, y: int, rising: bool) -> None:
        """Drive the operator with exchanged axes one way."""
        self.pass_gears(FARTHEST if rising else -FARTHEST, y, rising)

    def solve(self, u: int, low: int, high: int) -> int:
        """Return the output for the input ``u``."""
        rising = u >= self.x
        bound = high if rising else low
        last = self.pass_gears(u, bound, rising)
        following = self._next(rising)
        d = u - self.x
        falls_short = d < 0 if rising else d > 0
        if last < self.t.n and falls_short:
            following = last
        slope = self.t.rows[min(following, self.t.n - 1) // self.t.run][2]
        return self.y + self.along_gear(slope, d)

    def solve_within(self, u: int, low: int, high: int) -> int:
        """Return the output within low ... high."""
        rising = u >= self.x
        if rising and high < self.y:
            self.follow_output(high, False)
            return high
        if not rising and low > self.y:
            self.follow_output(low, True)
            return low
        y = self.solve(u, low, high)
        if y > high:
            if not rising:
                self.follow_output(high, False)
            return high
        if y < low:
            if rising:
                self.follow_output(low, True)
            return low
        return y

    def _window(self) -> tuple[int, int]:
        assert self.t.limits is not None
        low, high, step = self.t.limits
        if step < 0:
            return low, high
        least, most = self.last - step, self.last + step
        return min(max(least, low), high), max(min(most, high), low)

    def gears_step(self, u: Number) -> int:
        """Return the backlash stage's output for one input, in positions."""
        x = self.position_of(u, self.t.x_shift)
        if not self.t.memory_on_output:
            self.remember(self.drive_of(x))
        parts = zip(self.t.terms, self.memory, strict=True)
        total = sum(carried * (memory >> 24) for (carried, _, _), memory in parts)
        remembered = scaled_down(total, self.t.carried_shift)  # in positions
        if self.t.memory_on_output:
            x -= remembered
        x = clamped(x, (self.t.least, self.t.most))
        if self.t.limits is None:
            y = self.solve(x, -FARTHEST, FARTHEST)
        else:
            y = self.solve_within(x, *self._window())
        self.last = y
        if not self.t.memory_on_output:
            return y + remembered
        self.remember(self.drive_of(y))
        return y

    # ---- the model around it

    def through(self, segments: Segments, u: Number) -> Number:
        """Return a piecewise linear function's value."""
        x, y, slope = segments.row(u)
        return y + self.along(slope, u - x, segments.shift)

    def reset(self, drive: Number) -> None:
        """Do what ``NAME_reset`` does to the state of ``NAME_init``, which a new kernel has."""
        if self.t.clip is not None:  # of an inverse, whose output is the drive
            self.output = self._kept(drive)
        axis, shift, begin = 0, self.t.x_shift, self.x
        if self.t.memory_on_output:
            axis, shift, begin = 1, self.t.y_shift, self.y
        place = self.position_of(self.through(self.t.drive, drive), shift)
        target = place - begin
        widths = [self.t.rows[i // self.t.run][axis] for i in range(self.t.covered)]
        low, high = 0, sum(widths)
        slack = high // 1048576
        if target <= 0:
            widths = []
        for i, width in reversed(list(enumerate(widths))):
            if target - low >= (high - target) - slack:
                self.bits |= 1 << i
                low += width
            else:
                high -= width
        self.memory = [self.drive_of(place) << 24] * len(self.t.terms)
        self.load()
        if self.t.memory_on_output:
            self.follow_output(place, place >= self.y)
        elif place >= self.x:
            self.pass_gears(place, FARTHEST, True)
        else:
            self.pass_gears(place, -FARTHEST, False)
        self.last = place

    def step(self, x: Number) -> Number:
        """Do what ``NAME_step`` does."""
        y = self.gears_step(self.through(self.t.before, x))
        counts = self.counts_of(y, self.t.y_shift)
        if self.t.q31:
            out: Number = self.counts_of(self.through(self.t.behind, counts), 0)
        else:
            out = self.through(self.t.behind, F(counts))
        if self.t.change is not None:
            out = min(
                max(out, self.output - self.t.change), self.output + self.t.change
            )
        self.output = out = self._kept(out)
        whole, part = self.t.delay
        if whole < 0:
            return out
        if self.t.smooth:
            return self._smoothly_delayed(out, whole, part)
        if not self.delayed:
            self.delayed = [out] * (whole + 2)
        self.delayed = [*self.delayed[1:], out]
        later, earlier = self.delayed[-1 - whole], self.delayed[-2 - whole]
        if self.t.q31:
            return later + scaled_down((earlier - later) * part, 30)
        if not part:
            return later
        return later + part * (earlier - later)

    def _smoothly_delayed(self, out: Number, whole: int, part: Number) -> Number:
        """Return what a smooth delay line gives for the newest sample."""
        place = window_place(whole)
        size = whole + 2 + place
        if not self.delayed:
            self.delayed = [out] * size
        self.delayed = [*self.delayed[1:], out]
        window = self.delayed[:WINDOW]
        if self.t.q31:
            return between_counts(window, place, part)
        return F(between([float(k) for k in range(WINDOW)], window, place, part))

    def _kept(self, out: Number) -> Number:
        """Return an output within the limits."""
        if self.t.clip is None:
            return out
        return min(max(out, self.t.clip[0]), self.t.clip[1])
