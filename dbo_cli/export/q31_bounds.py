"""How far q31 can be from the float64 model: bounds that are derived from the tables, step by step.

Every rounding is bounded by half a unit, and followed to the output through the slopes.
Two runs cross the same gears unless the drive turns within the crossing tolerance of a
gear's end. After such a turn their remembered turning points differ by up to one gear's
width until a larger move wipes them out. The output depends on nested turning points
m_1, m_2 ... by the difference of the slopes at which the branches before and behind each
end, and these differences add up to at most the total variation of the slopes: hence one
width times that variation.

Memory feeds an error back, and the bound comes from energy: with V = sum c_j e_j^2 / (2 b_j)
a disturbance r of the input gives V_k+1 <= V_k + r e - s e^2 - sum c_j ((b_j/2) e^2 +
(1 - b_j/2) e_j^2), so V <= r^2 / (4 (s + kappa/2) rho) with rho = min 2 b_j (1 - b_j/2),
and sum c_j a_j e_j <= r A by Cauchy-Schwarz. That takes c_j >= 0.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.export import q31_tables as tables

INTERPOLATED = 4.0
"""Counts by which a value between two samples is rounded: dbo_q31_interpolation.h rounds so often."""
FINEST_TOLERANCE = 20
"""A crossing tolerance finer than 2^-20 of a gear gains nothing: the float64 model's own is 2^-30."""
COARSEST_TOLERANCE = 4
"""Where even 2^-4 of a gear drowns in rounding, whole numbers cannot hold the gears."""


def bounds_of(fixed: tables.FixedPoint) -> dict[str, float]:
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
        raise tables.beyond_q31(f"{plan.key}.dx", "lower `gears`, or ")
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


def _function_error(
    folded: tables.Folded, end: float, x_unit: float, y_unit: float
) -> float:
    """Bound the rounding in one piecewise linear function, up to ``end`` on its input."""
    longest = float(np.diff(folded.x, append=max(end, folded.x[-1])).max())
    steepest = float(np.abs(folded.slope).max())
    shift = tables.shift_for(steepest * x_unit / y_unit)
    nodes = 0.5 * steepest * x_unit + 0.5 * y_unit
    return nodes + y_unit * (0.5 + longest / x_unit * 2.0 ** -(shift + 1))


def _subset_error(axis: tables.Axis) -> float:
    """Bound what the roundings of any set of gears add up to."""
    errors = axis.errors
    return float(max(errors[errors > 0.0].sum(), -errors[errors < 0.0].sum()))


def _height_error(x_axis: tables.Axis, y_axis: tables.Axis) -> float:
    """Bound the rounding of the heights, and of the way inside a gear."""
    slopes = y_axis.exact / x_axis.exact
    inside = np.abs(y_axis.errors) + slopes * np.abs(x_axis.errors)
    shift = tables.shift_for(float(slopes.max()) * x_axis.unit / y_axis.unit)
    widest = float(x_axis.exact.max()) / x_axis.unit
    rounded = y_axis.unit * (1.0 + widest * 2.0 ** -(shift + 1))
    return _subset_error(y_axis) + float(inside.max()) + rounded


def _memory_error(
    fixed: tables.FixedPoint, memory: tables.Memory, steepest: float
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
