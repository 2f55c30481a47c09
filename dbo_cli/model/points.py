"""Stages without memory: the Discrete Point Operator (13)-(16), and a scale.

Widths of segments, as those of gears, lie on a grid that makes their sums exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats, Range
from dbo_cli.errors import ModelError
from dbo_cli.model import kernel
from dbo_cli.model.fields import Keyed, Reader, number, widths
from dbo_cli.model.state import Run, State

TABLE: dict[str, Reader] = {"x0": number, "y0": number, "dx": widths, "dy": widths}
"""Keys of gears and segments in a model file."""
# of the sum: the grid of 2^-53 then moves no width by more than 2^-12 of itself
_NARROWEST = 2.0**-42


def axes(dx: ArrayLike, dy: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
    """Return read-only copies of both axes' widths, and both on their binary grids.

    Raises
    ------
    ModelError
        Their numbers differ, or a width is none; the message begins with the key.
    """
    x, y = (
        read_only(np.array(axis, dtype=np.float64).reshape(-1)) for axis in (dx, dy)
    )
    if x.size != y.size:
        raise ModelError(f"dy: has {y.size} entries where dx has {x.size}")
    return x, y, on_binary_grid("dx", x), on_binary_grid("dy", y)


def read_only(values: Floats) -> Floats:
    """Return a table as the kernel takes it, which nobody can write to: models are values."""
    table: Floats = np.ascontiguousarray(values)
    table.flags.writeable = False
    return table


def on_binary_grid(key: str, widths: Floats) -> Floats:
    """Round widths to multiples of the power of two that makes every sum of them exact in float64.

    The grid is 2^-53 of the power of two above their sum, so no width moves by more
    than 2^-53 of the sum. Adding and subtracting them, (6)-(9), then never rounds: X_B
    and Y_B equal (2)-(3) exactly after any number of transitions. Rounding what is
    rounded changes nothing.

    Raises
    ------
    ModelError
        A width is not above 2^-42 of the sum, or the sum is 0 or beyond what float64
        holds.
    """
    while True:
        total = math.fsum(widths.tolist())
        if not 1e-120 < total < 1e120:  # slopes stay finite, too
            raise ModelError(
                f"{key}: the widths add up to {total!r}, beyond the range of the arithmetic"
            )
        grid = math.ldexp(1.0, math.frexp(total)[1] - 53)
        rounded: Floats = np.rint(widths / grid) * grid
        narrow = np.flatnonzero(rounded < _NARROWEST * total)
        if narrow.size:
            index = int(narrow[0])
            raise ModelError(
                f"{key}[{index}]: {float(widths[index])!r} is less than 2^-42 of the sum of all widths,"
                f" {total!r}"
            )
        if np.array_equal(rounded, widths):
            return rounded
        widths = rounded


# --- curves ---


class _Curve(Keyed):
    """A function of the present sample alone: what its kinds have in common as stages."""

    def __call__(self, x: ArrayLike) -> Floats:
        """Return the output for one block."""
        raise NotImplementedError

    def run(self, x: Floats, state: State, dt: float | Floats) -> Run:
        """Return the output for one block; the state stays as it is."""
        return Run(self(x), state)


class Points(_Curve):
    """The Discrete Point Operator of m segments, (13)-(16): memory-free, increasing, piecewise linear.

    Parameters
    ----------
    dx, dy : array_like
        dX_i and dY_i of (15), > 0, lowest segment first.
    x0, y0 : float
        X_0 and Y_0, where the first segment begins. The end segments extend beyond the
        range.

    Raises
    ------
    ModelError
        Lengths differ or a width is not > 0; the message begins with the key.
    """

    KEYS: ClassVar = TABLE

    def __init__(
        self, dx: ArrayLike, dy: ArrayLike, x0: float = 0.0, y0: float = 0.0
    ) -> None:
        self.dx, self.dy, widths, heights = axes(dx, dy)
        self.x0, self.y0 = float(x0), float(y0)
        x = np.concatenate([[0.0], np.cumsum(widths)])
        y = np.concatenate([[0.0], np.cumsum(heights)])
        slopes = heights / widths
        self.segments = read_only(np.column_stack([x[:-1], y[:-1], slopes]))

    @cached_property
    def inverse(self) -> Points:
        """The inverse (17)-(18): dX and dY exchanged in every segment, and the origins."""
        return Points(self.dy, self.dx, self.y0, self.x0)

    @property
    def least_slope(self) -> float:
        """The least slope of the segments."""
        return float(np.min(self.dy / self.dx))

    def __call__(self, x: ArrayLike) -> Floats:
        """Return the output of (13)-(16) for one block."""
        x = np.ascontiguousarray(x, dtype=np.float64).reshape(-1)
        y = np.empty_like(x)
        kernel.extension.point_run(self.segments, self.x0, self.y0, x, y)
        return y

    def value(self, x: float) -> float:
        """Return the output for one number; live control asks for it in every row."""
        y = np.array([x])
        kernel.extension.point_run(self.segments, self.x0, self.y0, y, y)
        return float(y[0])

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to."""
        return [[self.dx.tolist(), self.dy.tolist(), self.x0, self.y0]]


@dataclass(frozen=True)
class Scale(_Curve):
    """A gain and an offset: y = gain x + offset, as K and Y_0 in the paper's Section V.

    Raises
    ------
    ModelError
        The gain is 0, or a number is not finite; the message begins with the key.
    """

    gain: float
    offset: float
    KEYS: ClassVar = {"gain": number, "offset": number}

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        if self.gain == 0.0 or not 0.0 < abs(1.0 / self.gain) < math.inf:
            raise ModelError(f"gain: {self.gain!r} is not a finite number other than 0")
        if not math.isfinite(self.offset) or not math.isfinite(self.offset / self.gain):
            raise ModelError(f"offset: {self.offset!r} is not a finite number")

    def __call__(self, x: ArrayLike) -> Floats:
        """Return the output for one block."""
        y: Floats = np.multiply(self.gain, x, dtype=np.float64)
        y += self.offset
        return y

    @cached_property
    def inverse(self) -> Scale:
        """The stage that undoes this one, to rounding."""
        return Scale(1.0 / self.gain, -self.offset / self.gain)

    def value(self, x: float) -> float:
        """Return the output for one number."""
        return self.gain * x + self.offset

    @property
    def least_slope(self) -> float:
        """The gain without its sign."""
        return abs(self.gain)

    def identity(self) -> list[object]:
        """Return what a state of the stage refers to; inverted twice, the last digits may differ."""
        return [[f"{self.gain:.9e}", f"{self.offset + 0.0:.9e}"]]


Curve = Points | Scale


class Curves(tuple[Curve, ...]):
    """Curves that a signal passes one after the other; none leave it as it is."""

    def __call__(self, x: Floats) -> Floats:
        """Return the output for one block."""
        for curve in self:
            x = curve(x)
        return x

    def value(self, x: float) -> float:
        """Return the output for one number."""
        for curve in self:
            x = curve.value(x)
        return x

    def ends(self, low: float, high: float) -> Range:
        """Return the range of the output for an input from ``low`` to ``high``."""
        ends = self.value(low), self.value(high)
        return min(ends), max(ends)

    @property
    def least_slope(self) -> float:
        """What the least slopes of all come to at most: no place is flatter."""
        return math.prod(curve.least_slope for curve in self)

    @cached_property
    def inverse(self) -> Curves:
        """The curves that undo these."""
        return Curves(curve.inverse for curve in reversed(self))
