"""How far float32 and q31 can be from the float64 model: derived from the tables, step by step.

Every rounding is bounded by half a unit (q31) or by 2^-24 of the largest number that can stand there
(float32), and followed to the output through the slopes. Two runs cross the same gears unless the drive
turns within the crossing tolerance of a gear's end. After such a turn their remembered turning points differ
by up to one gear's width until a larger move wipes them out. The output depends on nested turning points
m_1, m_2 ... by the difference of the slopes at which the branches before and behind each end, and these
differences add up to at most the total variation of the slopes: hence one width times that variation.

Memory on the output feeds an error back. Where the loop gain is below one, errors grow by 1/(1 - gain).
Else a bound comes from energy: with V = sum c_j e_j^2 / (2 b_j) a disturbance r of the input gives
V_k+1 <= V_k + r e - s e^2 - sum c_j ((b_j/2) e^2 + (1 - b_j/2) e_j^2), so V <= r^2 / (4 (s + kappa/2) rho)
with rho = min 2 b_j (1 - b_j/2), and sum c_j a_j e_j <= r A by Cauchy-Schwarz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.single_tables import Axes, Folded, counts_of_range, fold, shift_for

Floats = NDArray[np.float64]

EPS = 2.0**-24
"""Half a unit in the last place of a float32, as a part of the number."""

LEAST_TOLERANCE = 20
"""A crossing tolerance finer than 2^-20 of a gear gains nothing: the float64 model's own is 2^-30."""

COARSEST_TOLERANCE = 4
"""Where even 2^-4 of a gear drowns in rounding, the arithmetic cannot hold the gears."""


def _function_error(
    folded: Folded, q31: bool, end: float, offset: float, x_unit: float, y_unit: float
) -> float:
    """Bound the rounding in one piecewise linear function, up to ``end`` on its input."""
    lengths = np.abs(np.diff(np.append(folded.x, max(end, folded.x[-1]))))
    rises = np.abs(folded.slope) * lengths
    if q31:
        shift = shift_for(float(np.abs(folded.slope).max()) * x_unit / y_unit)
        nodes = 0.5 * float(np.abs(folded.slope).max()) * x_unit + 0.5 * y_unit
        return nodes + y_unit * (0.5 + float(lengths.max()) / x_unit * 2.0 ** -(shift + 1))
    largest = float(np.abs(folded.y - offset).max() + rises.max())
    constant = float((np.abs(folded.slope) * np.abs(folded.x)).max())
    return EPS * (3.0 * float(rises.max()) + constant + 2.0 * largest)  # and x - x_c, the product, the sum


def _subset_error(table: Floats, wanted: Floats, run: int) -> float:
    """Bound what the roundings of any set of gears add up to."""
    off = np.repeat(table, run)[: len(wanted)] - wanted
    return float(max(off[off > 0.0].sum(), -off[off < 0.0].sum()))


@dataclass(frozen=True)
class _Loop:
    """What memory adds: its own rounding, and how a disturbance comes back through it."""

    own: float
    gain: float
    amplification: float


def _loop(plan: CascadePlan, axes: Axes, q31: bool, steepest: float) -> _Loop:
    """Bound the rounding of the memories, as the input meets it, and the feedback of errors."""
    c, a = plan.gain, plan.decay
    if not plan.terms:
        return _Loop(0.0, 0.0, 1.0)
    on_output = plan.backlash.memory_on == "output"
    b, carried = 1.0 - a, (c * a if on_output else c)
    offset = abs((plan.backlash.y0 if on_output else plan.backlash.x0) - plan.reference)
    drive = float((axes.high if on_output else axes.wide).sum()) + offset
    count = axes.y_count if on_output else axes.x_count
    if q31:
        other = axes.x_unit if on_output else axes.y_unit
        held = count * (1.5 + 2.0 * drive / count * 2.0**-30 + 2.0**-25 / b)
        factors = np.array([shift_for(float(v)) if v > 0.0 else 30 for v in carried * count / other])
        recall = other * (0.5 + drive / count * 2.0 ** -(factors + 1.0))
    else:
        held = np.full(plan.terms, 8.0 * EPS * drive + count)
        recall = EPS * (2.0 + plan.terms) * carried * drive
    own = float(np.sum(carried * held) + np.sum(recall))
    if not on_output:
        return _Loop(own, float(np.sum(c)), 1.0)
    loop = steepest * float(np.sum(carried))
    stiff = max(1.0 / steepest - axes.kappa, 0.0) + 0.5 * axes.kappa
    rho = float(np.min(2.0 * b * (1.0 - 0.5 * b)))
    energy = 1.0 + math.sqrt(float(np.sum(2.0 * b * c * a**2)) / (4.0 * stiff * rho))
    return _Loop(own, float(np.sum(carried)), min(1.0 / (1.0 - loop) if loop < 1.0 else math.inf, energy))


class NarrowGearsError(ModelError):
    """The gears are too narrow for the arithmetic; fewer would do."""


def derive_bounds(plan: CascadePlan, axes: Axes, q31: bool) -> dict[str, float]:
    """Return the bounds for inputs inside the model's range, in the output's unit and in % of its range.

    ``same_gears`` holds while both have crossed the same gears, and with memory always did;
    ``after_close_turn`` always, also after turns within ``close_turn_fraction`` of a gear's end. That is the
    part of a gear that may be missing when it counts as crossed, a power of two.

    Raises
    ------
    ModelError
        The gears are too narrow for the arithmetic: its rounding is beyond 1/16 of one.
    """
    gears, source, result = plan.backlash, plan.model.input, plan.model.output
    run, on_output = gears.equal_run, gears.memory_on == "output"
    slopes = axes.high / axes.wide
    steepest, span, height = float(slopes.max()), float(axes.wide.sum()), float(axes.high.sum())
    loop = _loop(plan, axes, q31, steepest)
    base = gears.x0 + (axes.kappa * (gears.y0 - plan.reference) if on_output else 0.0)
    x_in, y_out = counts_of_range(source)[1], counts_of_range(result)[1]
    before = fold(plan.head, source.minimum, source.maximum)
    entering = _function_error(before, q31, source.maximum, base, x_in, axes.x_unit)
    across = entering + _subset_error(axes.widths, axes.wide, run)
    off_x = np.repeat(axes.widths, run)[: gears.n] - axes.wide
    off_y = np.repeat(axes.heights, run)[: gears.n] - axes.high
    rising = _subset_error(axes.heights, axes.high, run)
    rising += float(np.max(np.abs(off_y) + slopes * np.abs(off_x)))
    if q31:
        shift = shift_for(steepest * axes.x_unit / axes.y_unit)
        rising += axes.y_unit * (1.0 + float(axes.wide.max()) / axes.x_unit * 2.0 ** -(shift + 1))
    else:
        across += EPS * (2.0 * span + loop.gain * height * on_output) + axes.x_count
        rising += EPS * 4.0 * float(axes.high.max()) + axes.y_unit
    if on_output:
        steady = steepest * (across + loop.own) + rising
        inner = steady * loop.amplification if loop.amplification < math.inf else math.inf
        place = across + loop.own + loop.gain * inner
    else:
        inner = steepest * across + loop.gain * entering + loop.own + rising + axes.y_count
        place = across
    tolerance = _tolerance(place, float(axes.wide.min()), rising, float(axes.high.min()), plan)
    hop = float(axes.wide.max()) * float(np.sum(np.abs(np.diff(slopes)))) * loop.amplification
    behind = fold(plan.tail, gears.y0, gears.y0 + height)
    bend = float(np.abs(behind.slope).max())
    leaving = _function_error(
        Folded(behind.x - gears.y0, behind.y, behind.slope), q31, height, 0.0, axes.y_count, y_out
    ) + bend * 0.5 * axes.y_count + (y_out if q31 else EPS * bend * height)  # fmt: skip
    if plan.delay and not on_output and not q31:
        leaving += 3.0 * EPS * max(abs(result.minimum), abs(result.maximum))
    same = bend * inner + leaving
    found: dict[str, float] = {}
    for key, value in (("same_gears", same), ("after_close_turn", same + bend * hop)):
        found |= {key: value, f"{key}_percent": 100.0 * value / result.span}
    return {**found, "close_turn_fraction": tolerance}


def _tolerance(place: float, narrow: float, rising: float, low: float, plan: CascadePlan) -> float:
    """Return a power of two, twice what rounding can shift a turn by, as a part of the smallest gear."""
    part = 2.0 * max(place / narrow, rising / low)
    power = min(math.floor(-math.log2(part)) if part > 0.0 else LEAST_TOLERANCE, LEAST_TOLERANCE)
    if power < COARSEST_TOLERANCE:
        raise NarrowGearsError(
            f"{plan.backlash.n} gears are too narrow for this arithmetic: its rounding is {100.0 * part:.2g}"
            " % of the smallest"
        )
    return 2.0**-power
