"""A model in whole counts: piecewise linear functions, axes, memories, limits, and how far off they are.

Positions along the axes of the gears are finer than counts.

The bounds are derived from the tables, step by step. Every rounding is bounded by half a
unit, and followed to the output through the slopes. Two runs cross the same gears unless
the drive turns within the crossing tolerance of a gear's end. After such a turn their
remembered turning points differ by up to one gear's width until a larger move wipes them
out. The output depends on nested turning points m_1, m_2 ... by the difference of the
slopes at which the branches before and behind each end, and these differences add up to at
most the total variation of the slopes: hence one width times that variation.

Memory feeds an error back, and the bound comes from energy: with V = sum c_j e_j^2 / (2 b_j)
a disturbance r of the input gives V_k+1 <= V_k + r e - s e^2 - sum c_j ((b_j/2) e^2 +
(1 - b_j/2) e_j^2), so V <= r^2 / (4 (s + kappa/2) rho) with rho = min 2 b_j (1 - b_j/2),
and sum c_j a_j e_j <= r A by Cauchy-Schwarz. That takes c_j >= 0.
"""

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
INTERPOLATED = 4.0
"""Counts by which a value between two samples is rounded: dbo_q31_interpolation.h rounds so often."""
FINEST_TOLERANCE = 20
"""A crossing tolerance finer than 2^-20 of a gear gains nothing: the float64 model's own is 2^-30."""
COARSEST_TOLERANCE = 4
"""Where even 2^-4 of a gear drowns in rounding, whole numbers cannot hold the gears."""


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


# --- how far q31 can be from the float64 model ---


def bounds_of(fixed: FixedPoint) -> dict[str, float]:
    """Return bounds on the error inside the model's range.

    Returns
    -------
    dict
        ``same`` holds while both runs have crossed the same gears; ``close`` always, also
        after turns within ``fraction`` of a gear's width from its end. In the drive's
        unit, and in percent of its range (``same_percent``, ``close_percent``).

    Raises
    ------
    ModelError
        The gears are too narrow: rounding is beyond 1/16 of one.
    """
    plan, x_axis, y_axis, after = fixed.plan, fixed.x_axis, fixed.y_axis, fixed.after
    slopes = y_axis.exact / x_axis.exact
    steepest = float(slopes.max())
    # what each part rounds: the input, the gears' widths, the memory, and their heights
    unit, reach = fixed.source.unit, plan.forward.output.max
    input_error = _function_error(fixed.before, reach, unit, x_axis.unit)
    if plan.delay_part:
        input_error += INTERPOLATED * unit * float(np.abs(fixed.before.slope).max())
    input_error += _subset_error(x_axis)
    gain, growth = 0.0, 1.0
    if fixed.memory is not None:
        error, gain, growth = _memory_error(fixed, fixed.memory, steepest)
        input_error += error
    height = _height_error(x_axis, y_axis)
    inner = (steepest * input_error + height) * growth
    # by how much of the smallest gear rounding can shift a turn, and twice that
    shift = (input_error + gain * inner) / float(x_axis.exact.min())
    shift = max(shift, height / float(y_axis.exact.min()))
    power = min(math.floor(-math.log2(2.0 * shift)), FINEST_TOLERANCE)
    if power < COARSEST_TOLERANCE:
        raise beyond_q31(f"{plan.key}.dx", "lower `gears`, or ")
    # one gear's width on another branch
    variation = float(np.sum(np.abs(np.diff(slopes))))
    hop = float(x_axis.exact.max()) * variation * growth
    # and from the gears to the drive
    output_unit = fixed.drive.unit
    bend = float(np.abs(after.slope).max())
    end = plan.gears.x0 + float(y_axis.exact.sum())
    leaving = _function_error(after, end, y_axis.count_unit, output_unit)
    same = bend * (inner + 0.5 * y_axis.count_unit) + leaving + output_unit
    close = same + bend * hop
    percent = 100.0 / plan.forward.input.span
    return {
        "same": same,
        "same_percent": percent * same,
        "close": close,
        "close_percent": percent * close,
        "fraction": 2.0**-power,
    }


def _function_error(folded: Folded, end: float, x_unit: float, y_unit: float) -> float:
    """Bound the rounding in one piecewise linear function, up to ``end`` on its input."""
    longest = float(np.diff(folded.x, append=max(end, folded.x[-1])).max())
    steepest = float(np.abs(folded.slope).max())
    shift = shift_for(steepest * x_unit / y_unit)
    nodes = 0.5 * steepest * x_unit + 0.5 * y_unit
    return nodes + y_unit * (0.5 + longest / x_unit * 2.0 ** -(shift + 1))


def _subset_error(axis: Axis) -> float:
    """Bound what the roundings of any set of gears add up to."""
    errors = axis.errors
    return float(max(errors[errors > 0.0].sum(), -errors[errors < 0.0].sum()))


def _height_error(x_axis: Axis, y_axis: Axis) -> float:
    """Bound the rounding of the heights, and of the way inside a gear."""
    slopes = y_axis.exact / x_axis.exact
    inside = np.abs(y_axis.errors) + slopes * np.abs(x_axis.errors)
    shift = shift_for(float(slopes.max()) * x_axis.unit / y_axis.unit)
    widest = float(x_axis.exact.max()) / x_axis.unit
    rounded = y_axis.unit * (1.0 + widest * 2.0 ** -(shift + 1))
    return _subset_error(y_axis) + float(inside.max()) + rounded


def _memory_error(
    fixed: FixedPoint, memory: Memory, steepest: float
) -> tuple[float, float, float]:
    """Bound what the memories round, as the input meets it.

    Also return the gain of the loop through the memory, and how much a disturbance grows
    in it.
    """
    plan, a = fixed.plan, fixed.plan.decay
    b, c = 1.0 - a, plan.gears.gain
    carried = c * a
    counts = (float(fixed.y_axis.exact.sum()) + abs(memory.offset)) / memory.unit
    followed = 2.0 + 2.0 * counts * 2.0**-30 + 2.0**-24 / b
    recalled = 0.5 + carried.size * counts * 2.0 ** -(memory.carried_shift + 1)
    error = float(np.sum(carried * followed)) * memory.unit
    error += fixed.x_axis.unit * recalled
    stiff = max(1.0 / steepest - plan.kappa, 0.0) + 0.5 * plan.kappa
    rho = float(np.min(2.0 * b * (1.0 - 0.5 * b)))
    energy = float(np.sum(2.0 * b * c * a**2))
    growth = 1.0 + math.sqrt(energy / (4.0 * stiff * rho))
    return error, float(np.sum(carried)), growth
