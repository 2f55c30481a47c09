"""Numbers of a model in whole counts: piecewise linear functions, axes, terms and limits.

A range is 2^30 counts to either side of its middle, which leaves a factor of two beyond
it. Positions along the axes of the gears are finer than counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export.plan import Plan
from dbo_cli.model import Quantity, Scale
from dbo_cli.model.points import Curves, through

Floats = NDArray[np.float64]

COUNTS = 2.0**30
MOST_FINE_BITS = 12
"""Positions are finer than counts by so many bits at most: slopes keep the 16 bits that far inputs lose."""
INT32 = (-(2**31), 2**31 - 1)
APART = 1e-9  # of a range: nodes that are closer are one


class Segments(NamedTuple):
    """A piecewise linear function: rows (x, y, slope), the slope times 2^shift."""

    rows: list[tuple[int, int, int]]
    shift: int


class Folded(NamedTuple):
    """Points and scales as one piecewise linear function in float64: its nodes, and the slope of each."""

    x: Floats
    y: Floats
    slope: Floats


@dataclass(frozen=True)
class Axes:
    """The gears at the time step, and how counts hold them.

    ``wide`` and ``high`` are the widths wanted, per gear; ``widths`` and ``heights``
    those of the tables, one a run, in the same units; positions are multiples of
    ``x_unit`` and ``y_unit``. ``fine`` are the bits by which positions are finer than
    counts, on either axis.
    """

    kappa: float
    wide: Floats
    high: Floats
    widths: Floats
    heights: Floats
    x_unit: float
    y_unit: float
    fine: tuple[int, int]

    @property
    def y_count(self) -> float:
        """One count of the output axis."""
        return self.y_unit * 2.0 ** self.fine[1]


class Remembered(NamedTuple):
    """How memories hold the drive: the shift from positions, their unit, and where the axis begins."""

    shift: int
    unit: float
    offset: float


def fold(curves: Curves, low: float, high: float) -> Folded:
    """Return points and scales, composed, as one function of an input between ``low`` and ``high``.

    Exact up to float64's rounding: its nodes are the points of every stage, led back to
    the input.
    """
    nodes = [low]
    for place, stage in enumerate(curves):
        if isinstance(stage, Scale):
            continue
        inner = np.ascontiguousarray(stage.segments[1:, 0] + stage.x0)
        back = tuple(before.inverse() for before in reversed(curves[:place]))
        nodes += through(back, inner).tolist()
    span = high - low
    begins: list[float] = []
    for node in sorted(nodes):
        if not begins or node - begins[-1] > APART * span:
            begins.append(node)
    x = np.array([*begins, max(begins[-1] + span, high)])
    y = through(curves, x.copy())
    return Folded(x[:-1], y[:-1], np.diff(y) / np.diff(x))


def axes_of(plan: Plan) -> Axes:
    """Return the gears with kappa in their widths, and the units of positions."""
    gears = plan.gears
    kappa = plan.kappa(plan.decay)
    wide = gears.table[:, 0] + kappa * gears.table[:, 1]
    high = gears.table[:, 1].copy()
    fine, units = [], []
    for widths in (wide, high):
        total = float(widths.sum())
        most = float(widths.max()) / total * COUNTS
        bits = min(math.floor(math.log2((2.0**31 - 1024.0) / most)), MOST_FINE_BITS)
        fine.append(bits)
        units.append(total / COUNTS / 2.0**bits)
    run = gears.equal_run
    widths = quantised(wide, run, units[0])
    heights = quantised(high, run, units[1])
    return Axes(
        kappa, wide, high, widths, heights, units[0], units[1], (fine[0], fine[1])
    )


def quantised(wanted: Floats, run: int, unit: float) -> Floats:
    """Return one width a run, whole multiples of ``unit``, whose running sums follow the exact ones."""
    widths, total, reached = [], 0.0, 0.0
    for begin in range(0, len(wanted), run):
        count = min(run, len(wanted) - begin)
        total += float(wanted[begin]) * count
        width = max(round((total - reached) / count / unit), 1) * unit
        widths.append(width)
        reached += width * count
    return np.array(widths)


def shift_for(largest: float) -> int:
    """Return the shift, 62 at most, that brings a factor just below 2^31, as a whole number."""
    if not largest > 0.0:
        return 30
    return min(math.floor(math.log2((2.0**31 - 1.0) / largest)), 62)


def segments_of(
    folded: Folded, x: tuple[float, float], y: tuple[float, float]
) -> Segments:
    """Return a folded function in whole numbers; ``x`` and ``y`` are (offset, unit) of either axis."""
    at = np.rint((folded.x - x[0]) / x[1])
    up = np.rint((folded.y - y[0]) / y[1])
    slopes = folded.slope * x[1] / y[1]
    slopes[:-1] = np.diff(up) / np.maximum(np.diff(at), 1.0)
    shift = shift_for(float(np.abs(slopes).max()))
    if shift < 16 or float(np.abs(at).max()) >= 2.0**31:
        raise ModelError(
            "points or scales beyond the range of q31 (`arithmetic` double)"
        )
    rows = []
    for a, b, slope in zip(at.tolist(), up.tolist(), slopes.tolist(), strict=True):
        rows.append((int(a), int(b), round(slope * 2.0**shift)))
    return Segments(rows, shift)


def counts_of_range(quantity: Quantity) -> tuple[float, float]:
    """Return where a range has its count 0, and how much one count is."""
    return 0.5 * (quantity.min + quantity.max), 0.5 * quantity.span / COUNTS


def to_counts(value: float, quantity: Quantity) -> int:
    """Return a value in counts, saturating."""
    middle, unit = counts_of_range(quantity)
    return min(max(round((value - middle) / unit), INT32[0]), INT32[1])


def begin_of_axis(plan: Plan, axes: Axes) -> float:
    """Return where the gears begin on the input, which the memory widens."""
    gears = plan.gears
    return gears.x0 + axes.kappa * (gears.y0 - plan.reference)


# ---- memories


def remembered(plan: Plan, axes: Axes) -> Remembered:
    """Return how memories hold the drive.

    One of their counts is one of the output axis, or coarser where the reference is far
    away: they have 31 bits.
    """
    offset = plan.gears.y0 - plan.reference
    coarse = 0
    if plan.gain.size:
        coarse = max(math.frexp(abs(offset) / axes.y_count / COUNTS)[1], 0)
    return Remembered(axes.fine[1] + coarse, axes.y_count * 2.0**coarse, offset)


def carried(plan: Plan, axes: Axes) -> Floats:
    """Return what each memory adds, in positions, for one of its counts."""
    return plan.gain * plan.decay * (remembered(plan, axes).unit / axes.x_unit)


def terms_of(plan: Plan, axes: Axes) -> tuple[list[tuple[int, int, int]], int]:
    """Return (carried, rest, rest_shift) of each relaxation term, and the shift of what is carried."""
    factors = carried(plan, axes)
    shift = shift_for(float(factors.sum()))
    if shift < 0:
        raise ModelError(
            "relaxation.gain: beyond the range of q31 (`arithmetic` double)"
        )
    terms = []
    for factor, rest in zip(factors.tolist(), (1.0 - plan.decay).tolist(), strict=True):
        down = math.floor(math.log2(COUNTS / rest))
        terms.append((round(factor * 2.0**shift), round(rest * 2.0**down), down))
    return terms, shift


# ---- limits, rounded inwards


class CountLimits(NamedTuple):
    """What the drive may do: as it comes out, in counts, and as the gears meet it, in positions.

    ``change`` is the largest in a step, None without a slew limit; ``positions`` are
    low, high and step (-1: no limit).
    """

    low: int
    high: int
    change: int | None
    positions: tuple[int, int, int]


def limits_of(plan: Plan, axes: Axes) -> CountLimits:
    """Return the limits of the drive; none of them is outside of the model's own.

    Raises
    ------
    ModelError
        They are beyond what counts hold, or finer than they resolve.
    """
    low, high = _clip(plan)
    inner, step, change = plan.inner, -1.0, None
    largest, inner_largest = plan.window.largest_step(plan.dt), plan.inner_step
    if largest is not None and inner_largest is not None:
        unit = counts_of_range(plan.model.output)[1]
        # 2^32: more than from one end to the other
        change = min(math.floor(float(largest) / unit), 2**32)
        kept = min(change * unit, float(largest)) / float(largest)
        step = inner_largest * kept / axes.y_unit
        if step < 4.0:
            raise ModelError(
                "`max_slew`: less than q31 resolves in one step (`sample_rate` lower)"
            )
    y0 = plan.gears.y0
    least, most = (inner.low - y0) / axes.y_unit, (inner.high - y0) / axes.y_unit
    if max(abs(least), abs(most), step) >= 2.0**59:
        raise ModelError(
            "`v_min`, `v_max`: beyond what q31 holds (`arithmetic` double)"
        )
    positions = (math.ceil(least), math.floor(most), math.floor(step))
    return CountLimits(low, high, change, positions)


def _clip(plan: Plan) -> tuple[int, int]:
    """Return the range of the drive in counts; as ``NAME_OUT`` converts them, within that asked for."""
    middle, unit = counts_of_range(plan.model.output)
    least, most = plan.limits.move
    low, high = round((least - middle) / unit), round((most - middle) / unit)
    while low * unit + middle < least:
        low += 1
    while high * unit + middle > most:
        high -= 1
    if not low < high:
        raise ModelError("`v_min`, `v_max`: too close for q31 (`arithmetic` double)")
    return low, high
