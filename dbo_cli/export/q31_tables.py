"""Numbers of a model in whole counts: piecewise linear functions, axes, memories and limits.

Positions along the axes of the gears are finer than counts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import ModelError
from dbo_cli.export.plan import COUNTS, Grid, Plan
from dbo_cli.model import Scale
from dbo_cli.model.points import Curves

MOST_FINE_BITS = 12
"""Positions are finer than counts by so many bits at most: slopes keep the 16 bits that far inputs lose."""
SAME_NODE = 1e-9  # of a range: nodes that are closer are one


def beyond_q31(key: str, remedy: str = "") -> ModelError:
    """Return the refusal of what whole numbers cannot hold, or have no bound for."""
    return ModelError(f"{key}: beyond q31: {remedy}use `arithmetic` double")


class Folded(NamedTuple):
    """Points and scales as one piecewise linear function in float64: its nodes, and the slope of each."""

    x: Floats
    y: Floats
    slope: Floats


class Axis:
    """The gears along the input or the output, and how counts hold them.

    Parameters
    ----------
    exact : array of shape (n,)
        The width of each gear; on the input kappa times its height is part of it.
    run : int
        So many neighbouring ones are equal.

    Attributes
    ----------
    widths : array of shape (rows,)
        Those of the tables, one a run, whole multiples of ``unit`` whose running sums
        follow the exact ones.
    errors : array of shape (n,)
        By how much the tables round each gear.
    unit : float
        Positions are multiples of it.
    fine : int
        A count is 2^fine positions.
    count_unit : float
        One count.
    """

    def __init__(self, exact: Floats, run: int) -> None:
        self.exact = exact
        sum_of_all, widest = float(exact.sum()), float(exact.max())
        counts = widest / sum_of_all * COUNTS
        finest = math.floor(math.log2((2.0**31 - 1024.0) / counts))
        self.fine = min(finest, MOST_FINE_BITS)
        self.unit = unit = sum_of_all / COUNTS / 2.0**self.fine
        self.count_unit = unit * 2.0**self.fine
        widths, total, reached = [], 0.0, 0.0
        for begin in range(0, len(exact), run):
            count = min(run, len(exact) - begin)
            total += float(exact[begin]) * count
            width = max(round((total - reached) / count / unit), 1) * unit
            widths.append(width)
            reached += width * count
        self.widths = np.array(widths)
        self.errors: Floats = np.repeat(widths, run)[: len(exact)] - exact


def fold(curves: Curves, low: float, high: float) -> Folded:
    """Return points and scales, composed, as one function of an input between ``low`` and ``high``.

    Exact up to float64's rounding: its nodes are the points of every stage, led back to
    the input.
    """
    nodes = [low]
    for number, stage in enumerate(curves):
        if isinstance(stage, Scale):
            continue
        inner = np.ascontiguousarray(stage.segments[1:, 0] + stage.x0)
        back = Curves(curves[:number]).inverse
        nodes += back(inner).tolist()
    span = high - low
    begins: list[float] = []
    for node in sorted(nodes):
        if not begins or node - begins[-1] > SAME_NODE * span:
            begins.append(node)
    x = np.array([*begins, max(begins[-1] + span, high)])
    y = curves(x.copy())
    return Folded(x[:-1], y[:-1], np.diff(y) / np.diff(x))


def shift_for(largest: float) -> int:
    """Return the shift, 62 at most, that brings a factor just below 2^31, as a whole number."""
    return min(math.floor(math.log2((2.0**31 - 1.0) / largest)), 62)


def segments_of(
    folded: Folded, x: tuple[float, float], y: tuple[float, float]
) -> tuple[list[list[int]], int]:
    """Return a folded function in whole numbers: rows (x, y, slope), the slope times 2^shift, and the shift.

    ``x`` and ``y`` are (offset, unit) of either axis.
    """
    at = np.rint((folded.x - x[0]) / x[1])
    up = np.rint((folded.y - y[0]) / y[1])
    slopes = folded.slope * x[1] / y[1]
    slopes[:-1] = np.diff(up) / np.maximum(np.diff(at), 1.0)
    shift = shift_for(float(np.abs(slopes).max()))
    if shift < 16 or float(np.abs(at).max()) >= 2.0**31:
        raise beyond_q31("points or scales")
    rows = np.column_stack([at, up, np.rint(slopes * 2.0**shift)])
    return rows.astype(np.int64).tolist(), shift


class Memory:
    """The relaxation terms in whole numbers.

    One of its counts is one of the output axis, or coarser where the reference is far
    away: it has 31 bits.

    Attributes
    ----------
    terms : list of (carried, rest, rest_shift)
        Of each term, as dboq_term has them.
    carried_shift : int
        Of what all carry.
    offset : float
        The drive at Y_0, from the reference on.
    unit, shift : float, int
        The memories' count, and that it is 2^shift positions of the output.
    """

    def __init__(self, plan: Plan, x_axis: Axis, y_axis: Axis) -> None:
        self.offset = plan.gears.x0 - plan.gears.reference
        distance = abs(self.offset) / y_axis.count_unit / COUNTS
        coarse = max(math.frexp(distance)[1], 0)
        self.unit = y_axis.count_unit * 2.0**coarse
        self.shift = y_axis.fine + coarse
        carried = plan.gears.gain * plan.decay * (self.unit / x_axis.unit)
        self.carried_shift = shift_for(float(carried.sum()))
        if self.carried_shift < 0:
            raise beyond_q31(f"{plan.key}.relaxation.gain")
        self.terms: list[tuple[int, int, int]] = []
        for factor, follow in zip(carried, 1.0 - plan.decay, strict=True):
            down = math.floor(math.log2(COUNTS / follow))
            scaled = round(float(factor) * 2.0**self.carried_shift)
            self.terms.append((scaled, round(float(follow) * 2.0**down), down))


class FixedPoint:
    """A plan as whole numbers hold it.

    Parameters
    ----------
    plan : Plan
        What is exported.

    Attributes
    ----------
    source, drive : Grid
        Counts of the displacement that goes in, and of the drive that comes out.
    x_axis, y_axis : Axis
        The gears along the input and the output.
    memory : Memory, or None
        The relaxation terms.
    before, after, start : Folded
        Points and scales: from the input to the gears, from them to the drive, and from
        the drive to them.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan, gears = plan, plan.gears
        source, drive = plan.forward.output, plan.forward.input
        self.source, self.drive = Grid.of(source), Grid.of(drive)
        heights = gears.exchanged[:, 1].copy()
        wide = gears.exchanged[:, 0] + plan.kappa * heights
        self.x_axis = Axis(wide, gears.equal_run)
        self.y_axis = Axis(heights, gears.equal_run)
        self.memory = None
        if gears.gain.size:
            self.memory = Memory(plan, self.x_axis, self.y_axis)
        end = gears.x0 + float(heights.sum())
        self.before = fold(plan.forward.tail.inverse, source.min, source.max)
        self.after = fold(plan.forward.head.inverse, gears.x0, end)
        self.start = fold(plan.forward.head, drive.min, drive.max)


def limits_of(fixed: FixedPoint) -> tuple[int, int, int | None, tuple[int, int, int]]:
    """Return the limits of the drive, rounded inwards.

    Returns
    -------
    low, high : int
        As it comes out, in counts.
    change : int, or None
        The largest in a step, in counts; None without a slew limit.
    positions : (int, int, int)
        Low, high and step (-1: no limit) at the gears, in positions.

    Raises
    ------
    ModelError
        They are beyond what counts hold, or finer than they resolve.
    """
    plan, drive, position = fixed.plan, fixed.drive, fixed.y_axis.unit
    lowest, highest = plan.limits.move
    low = round((lowest - drive.offset) / drive.unit)
    high = round((highest - drive.offset) / drive.unit)
    # within the limits as NAME_OUT converts them
    while drive.value(low) < lowest:
        low += 1
    while drive.value(high) > highest:
        high -= 1
    inner_low, inner_high = ((end - plan.gears.x0) / position for end in plan.window)
    if not low < high or max(abs(inner_low), abs(inner_high)) >= 2.0**59:
        raise beyond_q31("`v_min`, `v_max`")
    step, change = -1, None
    largest = plan.limits.largest_step(plan.dt)
    if largest is not None and plan.step is not None:
        # 2^32: more than from one end to the other
        change = min(math.floor(float(largest) / drive.unit), 2**32)
        share = min(change * drive.unit / float(largest), 1.0)
        step = math.floor(min(plan.step * share / position, 2.0**59))
        if step < 4:
            raise beyond_q31("`max_slew`", "lower `sample_rate`, or ")
    return low, high, change, (math.ceil(inner_low), math.floor(inner_high), step)
