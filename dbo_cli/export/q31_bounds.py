"""How far q31 can be from the float64 model: bounds that are derived from the tables, step by step.

Every rounding is bounded by half a unit, and followed to the output through the slopes.
Two runs cross the same gears unless the drive turns within the crossing tolerance of a
gear's end. After such a turn their remembered turning points differ by up to one gear's
width until a larger move wipes them out. The output depends on nested turning points
m_1, m_2 ... by the difference of the slopes at which the branches before and behind each
end, and these differences add up to at most the total variation of the slopes: hence one
width times that variation.

Memory feeds an error back. Where the loop gain is below one, errors grow by 1/(1 - gain).
Else a bound comes from energy: with V = sum c_j e_j^2 / (2 b_j) a disturbance r of the
input gives V_k+1 <= V_k + r e - s e^2 - sum c_j ((b_j/2) e^2 + (1 - b_j/2) e_j^2), so
V <= r^2 / (4 (s + kappa/2) rho) with rho = min 2 b_j (1 - b_j/2), and sum c_j a_j e_j <= r A
by Cauchy-Schwarz. That takes c_j >= 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export.plan import Plan
from dbo_cli.export.q31_tables import (
    Axes,
    Folded,
    carried,
    counts_of_range,
    fold,
    remembered,
    shift_for,
)
from dbo_cli.model import Quantity

Floats = NDArray[np.float64]

INTERPOLATED = 4.0
"""Counts by which a value between two samples is rounded: dbo_q31_interpolation.h rounds so often."""
LEAST_TOLERANCE = 20
"""A crossing tolerance finer than 2^-20 of a gear gains nothing: the float64 model's own is 2^-30."""
COARSEST_TOLERANCE = 4
"""Where even 2^-4 of a gear drowns in rounding, whole numbers cannot hold the gears."""


class Bounds(NamedTuple):
    """Bounds on the error inside the model's range, in the drive's unit and in percent of its range.

    ``same`` holds while both runs have crossed the same gears; ``close`` always, also
    after turns within ``fraction`` of a gear's width from its end; both in counts
    for the self-test.
    """

    same: float
    same_percent: float
    close: float
    close_percent: float
    fraction: float
    same_counts: int
    close_counts: int

    def text(self, drive: Quantity, gears: int) -> str:
        """Return what README.md says of them."""
        return (
            "**Error against `dbo compensate`**, inside the range, derived from the tables:\n\n"
            f"- {self.same:.3g}{drive.suffix} ({self.same_percent:.3g} % of the range) as long as both cross"
            f" the same gears. They do unless the drive turns within {self.fraction:.2g} of a gear's width"
            " from the gear's end.\n"
            f"- {self.close:.3g}{drive.suffix} ({self.close_percent:.3g} % of the range) after such a turn,"
            " until a larger move wipes it out: the two then remember neighbouring gears. It is the"
            f" resolution of {gears} gears, and shrinks as they grow in number.\n"
            "- Where the slew limit binds, one count more for each step."
        )


class NarrowGearsError(ModelError):
    """The gears are too narrow for whole numbers; fewer would do."""


def bounds_of(plan: Plan, axes: Axes, samples: int) -> Bounds:
    """Return the bounds; ``samples`` are those of a run of the self-test.

    Raises
    ------
    ModelError
        The gears are too narrow: rounding is beyond 1/16 of one.
    """
    result = plan.model.output
    slopes = axes.high / axes.wide
    steepest = float(slopes.max())
    rounding, gain, growth = _loop(plan, axes, steepest)
    entering = _entering(plan, axes)
    across = entering + _subset_error(axes.widths, axes.wide, plan.gears.equal_run)
    rising = _rising(plan, axes, slopes)
    inner = (steepest * (across + rounding) + rising) * growth
    place = across + rounding + gain * inner
    fraction = _tolerance(plan, axes, place, rising)
    variation = float(np.sum(np.abs(np.diff(slopes))))
    hop = float(axes.wide.max()) * variation * growth
    bend, leaving = _leaving(plan, axes)
    same = bend * inner + leaving
    close = same + bend * hop
    unit = counts_of_range(result)[1]
    slack = 1  # the outputs of the library are rounded
    if plan.limits.slew is not None:
        slack += samples
    counts = math.ceil(same / unit) + slack, math.ceil(close / unit) + slack
    percent = 100.0 / result.span
    return Bounds(same, percent * same, close, percent * close, fraction, *counts)


def _entering(plan: Plan, axes: Axes) -> float:
    """Bound the rounding of the input on its way to the gears."""
    source = plan.model.input
    unit = counts_of_range(source)[1]
    before = fold(plan.model.head, source.min, source.max)
    error = _function_error(before, source.max, unit, axes.x_unit)
    if plan.delay_samples[1]:
        error += INTERPOLATED * unit * float(np.abs(before.slope).max())
    return error


def _rising(plan: Plan, axes: Axes, slopes: Floats) -> float:
    """Bound the rounding of the heights, and of the way inside a gear."""
    run, n = plan.gears.equal_run, plan.gears.n
    off_x = np.repeat(axes.widths, run)[:n] - axes.wide
    off_y = np.repeat(axes.heights, run)[:n] - axes.high
    rising = _subset_error(axes.heights, axes.high, run)
    rising += float(np.max(np.abs(off_y) + slopes * np.abs(off_x)))
    shift = shift_for(float(slopes.max()) * axes.x_unit / axes.y_unit)
    widest = float(axes.wide.max()) / axes.x_unit
    return rising + axes.y_unit * (1.0 + widest * 2.0 ** -(shift + 1))


def _leaving(plan: Plan, axes: Axes) -> tuple[float, float]:
    """Return the steepest slope behind the gears, and a bound on the rounding there."""
    gears, unit = plan.gears, counts_of_range(plan.model.output)[1]
    height = float(axes.high.sum())
    behind = fold(plan.model.tail, gears.y0, gears.y0 + height)
    bend = float(np.abs(behind.slope).max())
    shifted = Folded(behind.x - gears.y0, behind.y, behind.slope)
    leaving = _function_error(shifted, height, axes.y_count, unit)
    return bend, leaving + bend * 0.5 * axes.y_count + unit


def _function_error(folded: Folded, end: float, x_unit: float, y_unit: float) -> float:
    """Bound the rounding in one piecewise linear function, up to ``end`` on its input."""
    lengths = np.abs(np.diff(np.append(folded.x, max(end, folded.x[-1]))))
    steepest = float(np.abs(folded.slope).max())
    shift = shift_for(steepest * x_unit / y_unit)
    nodes = 0.5 * steepest * x_unit + 0.5 * y_unit
    longest = float(lengths.max()) / x_unit
    return nodes + y_unit * (0.5 + longest * 2.0 ** -(shift + 1))


def _subset_error(table: Floats, wanted: Floats, run: int) -> float:
    """Bound what the roundings of any set of gears add up to."""
    off = np.repeat(table, run)[: len(wanted)] - wanted
    return float(max(off[off > 0.0].sum(), -off[off < 0.0].sum()))


def _loop(plan: Plan, axes: Axes, steepest: float) -> tuple[float, float, float]:
    """Bound what memory adds: its own rounding, as the input meets it, and how errors come back through it.

    Returns the rounding, the gain of the loop, and how much a disturbance grows.
    """
    if not plan.gain.size:
        return 0.0, 0.0, 1.0
    c, a = plan.gain, plan.decay
    b = 1.0 - a
    held = remembered(plan, axes)
    drive = float(axes.high.sum()) + abs(held.offset)
    counts = drive / held.unit
    rounded = held.unit * (2.0 + 2.0 * counts * 2.0**-30 + 2.0**-24 / b)
    shift = shift_for(float(carried(plan, axes).sum()))
    recall = axes.x_unit * (0.5 + c.size * counts * 2.0 ** -(shift + 1))
    rounding = float(np.sum(c * a * rounded)) + recall
    gain = float(np.sum(c * a))
    stiff = max(1.0 / steepest - axes.kappa, 0.0) + 0.5 * axes.kappa
    rho = float(np.min(2.0 * b * (1.0 - 0.5 * b)))
    energy = float(np.sum(2.0 * b * c * a**2))
    growth = 1.0 + math.sqrt(energy / (4.0 * stiff * rho))
    if steepest * gain < 1.0:
        growth = min(1.0 / (1.0 - steepest * gain), growth)
    return rounding, gain, growth


def _tolerance(plan: Plan, axes: Axes, place: float, rising: float) -> float:
    """Return a power of two, twice what rounding can shift a turn by, as a part of the smallest gear."""
    part = 2.0 * max(place / float(axes.wide.min()), rising / float(axes.high.min()))
    power = LEAST_TOLERANCE
    if part > 0.0:
        power = min(math.floor(-math.log2(part)), LEAST_TOLERANCE)
    if power < COARSEST_TOLERANCE:
        raise NarrowGearsError(
            f"{plan.gears.n} gears are too narrow for q31: its rounding is {100.0 * part:.2g} % of the"
            " smallest (`gears` fewer, or `arithmetic` double)"
        )
    return 2.0**-power
