"""Widths of gears and segments: what is refused, and the binary grid that makes their sums exact."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import ModelError

Floats = NDArray[np.float64]

CROSSING_TOLERANCE = 1e-9
"""A gear counts as crossed when all but this fraction of it is travelled (more where rounding is coarse)."""

_LARGEST_TOLERANCE = 1.0 / 16.0
_ROUNDING_STEPS = 64.0 * np.finfo(np.float64).eps
_NARROWEST = 2.0**-42


def checked_widths(key: str, widths: ArrayLike) -> Floats:
    """Return a read-only copy of ``widths``; raise ModelError naming the key of what is wrong in it."""
    values = np.array(widths, dtype=np.float64).reshape(-1)
    if values.size == 0:
        raise ModelError(f"{key}: is empty; at least one width is needed")
    for i in np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))[:1]:
        raise ModelError(f"{key}[{i}]: {float(values[i])!r} is not a finite width greater than 0")
    values.flags.writeable = False
    return values


def checked_pair(dx: ArrayLike, dy: ArrayLike, x0: float, y0: float) -> tuple[Floats, Floats]:
    """Return both axes' widths, checked against each other and the origins."""
    widths, heights = checked_widths("dx", dx), checked_widths("dy", dy)
    if widths.size != heights.size:
        raise ModelError(f"dy: has {heights.size} entries where dx has {widths.size}")
    for key, value in (("x0", x0), ("y0", y0)):
        if not math.isfinite(value):
            raise ModelError(f"{key}: {value!r} is not a finite number")
    return widths, heights


def on_binary_grid(key: str, widths: Floats) -> Floats:
    """Round widths to multiples of the power of two that makes every sum of them exact in float64.

    The grid is 2^-53 of the power of two above their sum, so no width moves by more than 2^-53 of the
    sum. Adding and subtracting them, (6)-(9), then never rounds: X_B and Y_B equal (2)-(3) exactly after
    any number of transitions. Rounding what is rounded changes nothing.

    Raises
    ------
    ModelError
        A width is smaller than 2^-42 of the sum, or the sum is beyond what float64 holds.
    """
    while True:
        total = math.fsum(widths.tolist())
        if not 1e-280 < total < 1e280:
            raise ModelError(f"{key}: the widths add up to {total!r}, beyond the range of the arithmetic")
        grid = math.ldexp(1.0, math.frexp(total)[1] - 53)
        rounded: Floats = np.rint(widths / grid) * grid
        for i in np.flatnonzero(rounded < _NARROWEST * total)[:1]:
            raise ModelError(
                f"{key}[{i}]: {float(widths[i])!r} is less than 2^-42 of the sum of all widths, {total!r}"
            )
        if np.array_equal(rounded, widths):
            return rounded
        widths = rounded


def gear_table(dx: Floats, dy: Floats, scale_x: float, scale_y: float) -> Floats:
    """Return the kernel's rows (dx, dy, slope, crossing_fraction) for widths on the binary grid.

    ``crossing_fraction`` is where a gear counts as crossed: all but 1e-9 of it, since a drive
    that turns on a breakpoint is the usual case and one unit in the last place must not decide which gear
    engages on the way back. Where a gear is so narrow beside the numbers that are added and subtracted
    (``scale_x``, ``scale_y``) that rounding exceeds that, the tolerance is 64 rounding steps of the coarser
    axis. Exchanging the axes leaves it as it is, so an operator and its inverse decide alike.

    Raises
    ------
    ModelError
        A slope is beyond what float64 holds.
    """
    with np.errstate(over="ignore", under="ignore"):
        rounding = _ROUNDING_STEPS * np.maximum(scale_x / dx, scale_y / dy)
        fraction = 1.0 - np.clip(rounding, CROSSING_TOLERANCE, _LARGEST_TOLERANCE)
        slope, inverse_slope = dy / dx, dx / dy
    for i in np.flatnonzero(~np.isfinite(slope) | ~np.isfinite(inverse_slope))[:1]:
        raise ModelError(
            f"dy[{i}]: {float(dy[i])!r} over dx[{i}], {float(dx[i])!r}, is beyond the range of the arithmetic"
        )
    gears: Floats = np.ascontiguousarray(np.column_stack([dx, dy, slope, fraction]))
    gears.flags.writeable = False
    return gears


def equal_run(gears: Floats) -> int:
    """Return how many neighbours are equal from every multiple of that number on.

    The last run may be shorter. Identification gives many gears one slope, so that runs are long; 1 where
    nothing repeats.
    """
    starts = np.flatnonzero(np.any(gears[1:] != gears[:-1], axis=1)) + 1
    run = math.gcd(*starts.tolist()) or len(gears)
    return run if run * len(gears) < 2**32 else 1  # the kernel divides by a 32-bit multiplication
