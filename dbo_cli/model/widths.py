"""Widths of gears and segments: what is refused, and the grid that makes their sums exact."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import ModelError
from dbo_cli.model.fields import Reader, number, widths

TABLE: dict[str, Reader] = {"x0": number, "y0": number, "dx": widths, "dy": widths}
"""Keys of gears and segments in a model file."""
CROSSING_TOLERANCE = 1e-9
"""A gear counts as crossed when all but this fraction of it is travelled (more where rounding is coarse)."""

# chosen: more than the additions of a signal's way lose
_ROUNDING_STEPS = 64.0 * np.finfo(np.float64).eps
# of the sum: the grid of 2^-53 then moves no width by more than 2^-12 of itself
_NARROWEST = 2.0**-42
_LARGEST_TOLERANCE = 1.0 / 16.0  # what 64 steps of rounding are of such a width


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


def gear_table(dx: Floats, dy: Floats, rounding: Floats) -> Floats:
    """Return a row (dx, dy, slope, crossing_fraction) for each gear, of widths on the binary grid.

    ``crossing_fraction`` is where a gear counts as crossed: all but 1e-9 of it, since a
    drive that turns on a breakpoint is the usual case and one unit in the last place
    must not decide which gear engages on the way back. Where a gear is so narrow beside
    the numbers that are added and subtracted that rounding exceeds that, the tolerance
    is 64 rounding steps. Exchanging the axes leaves it as it is, so an operator and its
    inverse decide alike.

    Parameters
    ----------
    dx, dy : array
        Widths and heights.
    rounding : array
        The largest numbers of an axis over what of a gear is told apart there, the
        greater of both axes.
    """
    tolerance = np.clip(
        _ROUNDING_STEPS * rounding, CROSSING_TOLERANCE, _LARGEST_TOLERANCE
    )
    return read_only(np.column_stack([dx, dy, dy / dx, 1.0 - tolerance]))


def kernel_table(gears: Floats, run: int = 1) -> tuple[Floats, NDArray[np.uint32]]:
    """Return the kernel's table, a row for each ``run`` of equal gears, and its guide.

    To the row of its gears, each row adds where the first of them begins; one more
    stands behind the last and begins where the last gear ends. The guide cuts the range
    of the input into as many equal parts as there are rows, and says in which row each
    begins.
    """
    ends = np.cumsum(gears[:, :2], axis=0)  # exact: the widths lie on one binary grid
    begins = np.vstack([[0.0, 0.0], ends[run - 1 : -1 : run], ends[-1]])
    rows = np.vstack([gears[::run], gears[-1]])
    table = read_only(np.hstack([rows, begins]))
    parts = np.linspace(0.0, ends[-1, 0], 2 * len(table) - 1)
    guide = np.searchsorted(begins[:-1, 0], parts, side="right") - 1
    return table, guide.astype(np.uint32)
