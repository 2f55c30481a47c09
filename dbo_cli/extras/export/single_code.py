"""The model in float32 or q31 as C: tables, how far they can be from the float64 model, steps and self-test.

The bounds on the error are derived from the tables, step by step. Every rounding is
bounded by half a unit (q31) or by 2^-24 of the largest number that can stand there
(float32), and followed to the output through the slopes. Two runs cross the same gears
unless the drive turns within the crossing tolerance of a gear's end. After such a turn
their remembered turning points differ by up to one gear's width until a larger move
wipes them out. The output depends on nested turning points m_1, m_2 ... by the
difference of the slopes at which the branches before and behind each end, and these
differences add up to at most the total variation of the slopes: hence one width times
that variation.

Memory on the output feeds an error back. Where the loop gain is below one, errors grow
by 1/(1 - gain). Else a bound comes from energy: with V = sum c_j e_j^2 / (2 b_j) a
disturbance r of the input gives V_k+1 <= V_k + r e - s e^2 - sum c_j ((b_j/2) e^2 + (1
- b_j/2) e_j^2), so V <= r^2 / (4 (s + kappa/2) rho) with rho = min 2 b_j (1 - b_j/2),
and sum c_j a_j e_j <= r A by Cauchy-Schwarz.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.extras.export.cascade_plan import (
    CascadePlan,
    ignored_beyond,
    self_test_moves,
)
from dbo_cli.extras.export.single_kernel import (
    PARTS,
    F,
    Segments,
    SingleKernel,
    SingleTables,
    clamped,
)
from dbo_cli.extras.export.source_text import (
    INTERPOLATION,
    ModelCode,
    Vectors,
    array,
    checkpoints_of,
    delay_line,
    hex_float,
    integer,
    smooth_delay_line,
    struct_rows,
    turns_members,
)
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import DriveLimits, Quantity

Text = Callable[[Any], str]

COUNTS = 2.0**30
"""A range is so many counts of q31 to either side of its middle, which leaves a factor of two beyond it."""

MOST_FINE_BITS = 12
"""Positions are finer than counts by so many bits at most: slopes keep the 16 bits that far inputs lose."""

MOST_GEARS = 46_340
"""Up to here n gears find their row with a product of 32 bits, whatever the run."""

SLOWEST_REST = 2.0**-34
"""A memory that follows by less a step would stand still below 2^10 counts, 1e-6 of the range."""

SMOOTH_GROWTH = 4.0
"""An error of every sample grows by no more than 3.1 between samples: one-sided slopes weigh 128/12 of it."""

EPS = 2.0**-24
"""Half a unit in the last place of a float32, as a part of the number."""

LEAST_TOLERANCE = 20
"""A crossing tolerance finer than 2^-20 of a gear gains nothing: the float64 model's own is 2^-30."""

COARSEST_TOLERANCE = 4
"""Where even 2^-4 of a gear drowns in rounding, the arithmetic cannot hold the gears."""


@dataclass(frozen=True)
class Folded:
    """Points and scales as one piecewise linear function in float64: its nodes, and the slope of each."""

    x: Floats
    y: Floats
    slope: Floats


@dataclass(frozen=True)
class Axes:
    """The gears at the time step, and how the arithmetic holds them.

    ``wide`` and ``high`` are the widths wanted, per gear; ``widths`` and ``heights``
    those of the tables, in the same units; positions are multiples of ``x_unit`` and
    ``y_unit``. ``fine`` are the bits by which positions are finer than counts, on
    either axis.
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
    def x_count(self) -> float:
        """One count of the input axis."""
        return self.x_unit * 2.0 ** self.fine[0]

    @property
    def y_count(self) -> float:
        """One count of the output axis."""
        return self.y_unit * 2.0 ** self.fine[1]


def fold(stages: MemoryFree, low: float, high: float) -> Folded:
    """Return points and scales, composed, as one function of an input between ``low`` and ``high``.

    Exact up to float64's rounding: its nodes are the points of every stage, led back to
    the input.
    """
    nodes = [low]
    for place, stage in enumerate(stages):
        if isinstance(stage, ScaleStage):
            continue
        inner = stage.segments[1:, 0] + stage.x0
        back = tuple(stage.inverse() for stage in reversed(stages[:place]))
        nodes += through(back, np.ascontiguousarray(inner)).tolist()
    span = high - low
    begins: list[float] = []
    for node in sorted(nodes):
        if not begins or node - begins[-1] > 1e-9 * span:
            begins.append(node)
    x = np.array([*begins, max(begins[-1] + span, high)])
    y = through(stages, x.copy())
    return Folded(x[:-1], y[:-1], np.diff(y) / np.diff(x))


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


def axes_of(plan: CascadePlan) -> Axes:
    """Return the gears with kappa in their widths, and the units of positions."""
    gears = plan.model.backlash
    kappa = plan.kappa
    wide, high = gears.gears[:, 0] + kappa * gears.gears[:, 1], gears.gears[:, 1].copy()
    totals = [float(wide.sum()), float(high.sum())]
    if gears.memory_on == "input" and plan.terms:
        totals[1] += float(np.sum(plan.gain)) * totals[0]
    fine = [0, 0]
    units = []
    for axis, (total, widths) in enumerate(zip(totals, (wide, high), strict=True)):
        most = float(widths.max()) / total * COUNTS
        fine[axis] = min(
            math.floor(math.log2((2.0**31 - 1024.0) / most)), MOST_FINE_BITS
        )
        units.append(total / COUNTS / 2.0 ** fine[axis])
    run = gears.equal_run
    return Axes(
        kappa, wide, high, quantised(wide, run, units[0]), quantised(high, run, units[1]),
        units[0], units[1], (fine[0], fine[1]),
    )  # fmt: skip


def shift_for(largest: float) -> int:
    """Return the shift, 62 at most, that brings a factor just below 2^31, as a whole number."""
    if not largest > 0.0:
        return 30
    return min(math.floor(math.log2((2.0**31 - 1.0) / largest)), 62)


def segments_of(
    folded: Folded, q31: bool, x: tuple[float, float], y: tuple[float, float]
) -> Segments:
    """Return a folded function in the arithmetic; ``x`` and ``y`` are (offset, unit) of either axis."""
    at = (folded.x - x[0]) / x[1]
    up = (folded.y - y[0]) / y[1]
    slopes = folded.slope * x[1] / y[1]
    if not q31:
        floats = [(F(a), F(b), F(s)) for a, b, s in zip(at, up, slopes, strict=True)]
        return Segments(floats, 0)
    at = np.rint(at)
    up = np.rint(up)
    slopes[:-1] = np.diff(up) / np.maximum(np.diff(at), 1.0)
    shift = shift_for(float(np.abs(slopes).max()))
    if shift < 16 or float(np.abs(at).max()) >= 2.0**31:
        raise ModelError(
            "points or scales beyond the range of q31 (`arithmetic` float or double)"
        )
    counts = []
    for a, b, slope in zip(at.tolist(), up.tolist(), slopes.tolist(), strict=True):
        counts.append((int(a), int(b), round(slope * 2.0**shift)))
    return Segments(counts, shift)


def counts_of_range(quantity: Quantity) -> tuple[float, float]:
    """Return where a range has its count 0, and how much one count is."""
    return 0.5 * (quantity.minimum + quantity.maximum), 0.5 * quantity.span / COUNTS


def _remembered(plan: CascadePlan, axes: Axes) -> tuple[int, float, float]:
    """Return the shift from positions to what memories count, one of those, and where the axis begins.

    It is a count of the remembered axis, or coarser where the reference is far away:
    they have 31 bits.
    """
    gears = plan.model.backlash
    begin, count, fine = gears.x0, axes.x_count, axes.fine[0]
    if gears.memory_on == "output":
        begin, count, fine = gears.y0, axes.y_count, axes.fine[1]
    offset = begin - plan.reference
    coarse = 0
    if plan.terms:
        coarse = max(math.frexp(abs(offset) / count / COUNTS)[1], 0)
    return fine + coarse, count * 2.0**coarse, offset


def _carried(plan: CascadePlan, axes: Axes) -> Floats:
    """Return what each memory adds, in positions, for one of its counts."""
    count = _remembered(plan, axes)[1]
    if plan.model.backlash.memory_on == "output":
        return plan.gain * plan.decay * (count / axes.x_unit)
    return plan.gain * (count / axes.y_unit)


def _terms(plan: CascadePlan, axes: Axes) -> tuple[list[tuple[int, int, int]], int]:
    """Return (carried, rest, rest_shift) of each relaxation term, and the shift of what is carried."""
    factors = _carried(plan, axes)
    shift = shift_for(float(factors.sum()))
    if shift < 0:
        raise ModelError(
            "relaxation.gain: beyond the range of this arithmetic (`arithmetic` double)"
        )
    terms = []
    rests = 1.0 - plan.decay
    for factor, rest in zip(factors.tolist(), rests.tolist(), strict=True):
        down = math.floor(math.log2(COUNTS / rest))
        terms.append((round(factor * 2.0**shift), round(rest * 2.0**down), down))
    return terms, shift


def _rows(axes: Axes, q31: bool) -> tuple[list[tuple[int, int, Any]], int]:
    """Return the gear table and, in q31, the shift of its slopes."""
    slopes = axes.heights / axes.widths * (axes.x_unit / axes.y_unit)
    numbers: list[Any]
    if q31:
        shift = shift_for(float(slopes.max()))
        if shift < 16:
            raise ModelError(
                "dy: a gear too steep for q31 (`arithmetic` float or double)"
            )
        numbers = [round(slope * 2.0**shift) for slope in slopes.tolist()]
    else:
        shift = 0
        numbers = [F(slope) for slope in slopes.tolist()]
    widths = [round(width / axes.x_unit) for width in axes.widths.tolist()]
    heights = [round(height / axes.y_unit) for height in axes.heights.tolist()]
    return list(zip(widths, heights, numbers, strict=True)), shift


def _begin_of_axis(plan: CascadePlan, axes: Axes) -> float:
    """Return where the gears begin, on the axis that an inverse's memory widens."""
    gears = plan.model.backlash
    if gears.memory_on == "input":
        return gears.x0 + 0.0
    return gears.x0 + axes.kappa * (gears.y0 - plan.reference)


def single_tables(
    plan: CascadePlan, axes: Axes, q31: bool, tolerance: float
) -> SingleTables:
    """Return every constant; ``tolerance`` is the part of a gear that may be missing when it is crossed.

    Raises
    ------
    ModelError
        Something is beyond what the arithmetic holds.
    """
    gears = plan.model.backlash
    if gears.n > MOST_GEARS:
        raise ModelError(
            f"dx: {gears.n} gears are more than {MOST_GEARS} (`gears` fewer, or double)"
        )
    on_output = gears.memory_on == "output"
    source, result = plan.model.input, plan.model.output
    rows, slope_shift = _rows(axes, q31)
    base = _begin_of_axis(plan, axes)
    taken = goes_in = (0.0, 1.0)
    x_step, y_step = axes.x_count, axes.y_count
    if q31:
        taken = counts_of_range(source)
        goes_in = counts_of_range(result)
        x_step, y_step = axes.x_unit, axes.y_unit
    before = fold(plan.model.head, source.minimum, source.maximum)
    behind = fold(plan.model.tail, gears.y0, gears.y0 + float(axes.high.sum()))
    if plan.model.direction == "forward":
        drive = segments_of(before, q31, taken, (gears.x0, x_step))
    else:
        undone = fold(plan.drive_stages, result.minimum, result.maximum)
        drive = segments_of(undone, q31, goes_in, (gears.y0, y_step))
    clip, change, positions = _limits(plan, axes, q31)
    first = _number(plan.first_output, result, q31)
    if clip is not None:
        first = min(max(first, clip[0]), clip[1])
    whole, part = plan.delay_samples or (-1, 0.0)
    smooth = plan.delay_is_smooth
    if smooth:
        part = 1.0 - part  # of the step in which the value lies
    number: Any = F(part)
    if q31:
        number = round(part * (PARTS if smooth else COUNTS))
    delay = whole, number
    drive_shift, drive_count, offset = _remembered(plan, axes)
    terms, carried_shift = _terms(plan, axes)
    span = sum(rows[i // gears.equal_run][0] for i in range(gears.n))
    return SingleTables(
        q31=q31, rows=rows, n=gears.n, run=gears.equal_run, tolerance=round(-math.log2(tolerance)),
        terms=terms, carried_shift=carried_shift, memory_on_output=on_output,
        drive_offset=round(offset / drive_count) if plan.terms else 0, drive_shift=drive_shift,
        slope_shift=slope_shift, x_shift=axes.fine[0], y_shift=axes.fine[1],
        least=-span, most=2 * span, limits=positions,
        covered=plan.model.covered_gears.n, spare_bits=plan.model.spare_bits,
        before=segments_of(before, q31, taken, (base, x_step)),
        behind=segments_of(behind, q31, (gears.y0, axes.y_count), goes_in),
        drive=drive, clip=clip, change=change, first=first, delay=delay, smooth=smooth,
    )  # fmt: skip


def _number(value: float, quantity: Quantity, q31: bool) -> Any:
    """Return a value of a quantity in the arithmetic: in counts, or as float32."""
    if q31:
        return to_counts(value, quantity)
    return F(value)


def to_counts(value: float, quantity: Quantity) -> int:
    """Return a value in counts of q31, saturating."""
    middle, unit = counts_of_range(quantity)
    return clamped(round((value - middle) / unit))


def _limits(
    plan: CascadePlan, axes: Axes, q31: bool
) -> tuple[tuple[Any, Any] | None, Any, tuple[int, int, int] | None]:
    """Return the limits on the output in the arithmetic, rounded inwards: clip, change and positions.

    ``clip`` and ``change`` are numbers as they come out; ``positions`` are low, high
    and step (-1: no slew limit) as the gears meet them. None of them is outside of the
    model's own.
    """
    limits, inner = plan.limits, plan.inner_limits
    if limits is None or inner is None:
        return None, None, None
    clip: tuple[Any, Any]
    if q31:
        clip = _count_clip(limits, plan.model.drive)
    else:
        clip = _float_clip(limits)
    if not clip[0] < clip[1]:
        raise ModelError(
            "`v_min`, `v_max`: too close for this arithmetic (`arithmetic` double)"
        )
    change: Any = None
    step = -1.0
    slew, slew_step = limits.max_slew, plan.slew_step
    if slew is not None and slew_step is not None and plan.time_step is not None:
        largest = slew * plan.time_step
        if q31:
            change, reached = _count_change(largest, plan.model.drive)
        else:
            change, reached = _float_change(largest, clip)
        step = slew_step * (reached / largest) / axes.y_unit
        if step < 4.0:
            raise ModelError(
                "`max_slew`: less than this arithmetic resolves in one step (`sample_rate` lower)"
            )
    y0 = plan.model.backlash.y0
    low = (inner.v_min - y0) / axes.y_unit
    high = (inner.v_max - y0) / axes.y_unit
    if max(abs(low), abs(high), step) >= 2.0**59:
        raise ModelError(
            "`v_min`, `v_max`: beyond what this arithmetic holds (`arithmetic` double)"
        )
    return clip, change, (math.ceil(low), math.floor(high), math.floor(step))


def _float_clip(limits: DriveLimits) -> tuple[Any, Any]:
    """Return the limits in float32, rounded inwards."""
    low = F(limits.v_min)
    if float(low) < limits.v_min:
        low = np.nextafter(low, F(np.inf))
    high = F(limits.v_max)
    if float(high) > limits.v_max:
        high = np.nextafter(high, F(-np.inf))
    return low, high


def _count_clip(limits: DriveLimits, drive: Quantity) -> tuple[int, int]:
    """Return the limits in counts, each, as ``NAME_OUT`` converts it, within the limits asked for."""
    middle, unit = counts_of_range(drive)
    low = round((limits.v_min - middle) / unit)
    high = round((limits.v_max - middle) / unit)
    if max(abs(low), abs(high)) >= 2**31 - 1:
        raise ModelError(
            "`v_min`, `v_max`: beyond twice the model's range, which q31 does not hold"
        )
    while low * unit + middle < limits.v_min:
        low += 1
    while high * unit + middle > limits.v_max:
        high -= 1
    return low, high


def _float_change(largest: float, clip: tuple[Any, Any]) -> tuple[Any, float]:
    """Return the change that adding to an output may round up to the one asked for, and what is sure.

    A sum is off by half a unit in the last place of the largest output, and the change
    itself by as much.
    """
    place = float(np.spacing(max(abs(clip[0]), abs(clip[1]))))
    change = F(max(largest - 0.5 * place, 0.0))
    if float(change) > largest - 0.5 * place:
        change = np.nextafter(change, F(0.0))
    return change, max(largest - 2.0 * place, 0.0)


def _count_change(largest: float, drive: Quantity) -> tuple[int, float]:
    """Return the change in whole counts, and what that is."""
    unit = counts_of_range(drive)[1]
    # 2^32: more than from one end to the other
    change = min(math.floor(largest / unit), 2**32)
    return change, min(change * unit, largest)


def _function_error(
    folded: Folded, q31: bool, end: float, offset: float, x_unit: float, y_unit: float
) -> float:
    """Bound the rounding in one piecewise linear function, up to ``end`` on its input."""
    lengths = np.abs(np.diff(np.append(folded.x, max(end, folded.x[-1]))))
    rises = np.abs(folded.slope) * lengths
    if q31:
        shift = shift_for(float(np.abs(folded.slope).max()) * x_unit / y_unit)
        nodes = 0.5 * float(np.abs(folded.slope).max()) * x_unit + 0.5 * y_unit
        return nodes + y_unit * (
            0.5 + float(lengths.max()) / x_unit * 2.0 ** -(shift + 1)
        )
    largest = float(np.abs(folded.y - offset).max() + rises.max())
    constant = float((np.abs(folded.slope) * np.abs(folded.x)).max())
    # and x - x_c, the product, the sum
    return EPS * (3.0 * float(rises.max()) + constant + 2.0 * largest)


def _subset_error(table: Floats, wanted: Floats, run: int) -> float:
    """Bound what the roundings of any set of gears add up to."""
    off = np.repeat(table, run)[: len(wanted)] - wanted
    return float(max(off[off > 0.0].sum(), -off[off < 0.0].sum()))


def _loop(plan: CascadePlan, axes: Axes, steepest: float) -> tuple[float, float, float]:
    """Bound what memory adds: its own rounding, as the input meets it, and how errors come back through it.

    Returns the rounding, the gain of the loop, and how much a disturbance grows.
    """
    if not plan.terms:
        return 0.0, 0.0, 1.0
    c, a = plan.gain, plan.decay
    b = 1.0 - a
    on_output = plan.model.backlash.memory_on == "output"
    carried, widths, unit = c, axes.wide, axes.y_unit
    if on_output:
        carried, widths, unit = c * a, axes.high, axes.x_unit
    _, count, offset = _remembered(plan, axes)
    drive = float(widths.sum()) + abs(offset)
    rounded = count * (2.0 + 2.0 * drive / count * 2.0**-30 + 2.0**-24 / b)
    shift = shift_for(float(_carried(plan, axes).sum()))
    recall = unit * (0.5 + plan.terms * drive / count * 2.0 ** -(shift + 1))
    rounding = float(np.sum(carried * rounded)) + recall
    if not on_output:
        return rounding, float(np.sum(c)), 1.0
    loop = steepest * float(np.sum(carried))
    stiff = max(1.0 / steepest - axes.kappa, 0.0) + 0.5 * axes.kappa
    rho = float(np.min(2.0 * b * (1.0 - 0.5 * b)))
    growth = 1.0 + math.sqrt(float(np.sum(2.0 * b * c * a**2)) / (4.0 * stiff * rho))
    if loop < 1.0:
        growth = min(1.0 / (1.0 - loop), growth)
    return rounding, float(np.sum(carried)), growth


class NarrowGearsError(ModelError):
    """The gears are too narrow for the arithmetic; fewer would do."""


def derive_bounds(plan: CascadePlan, axes: Axes, q31: bool) -> dict[str, float]:
    """Return the bounds for inputs inside the model's range, in the output's unit and in % of its range.

    ``same_gears`` holds while both have crossed the same gears, and with memory always
    did; ``after_close_turn`` always, also after turns within ``close_turn_fraction`` of
    a gear's end. That is the part of a gear that may be missing when it counts as
    crossed, a power of two.

    Raises
    ------
    ModelError
        The gears are too narrow for the arithmetic: its rounding is beyond 1/16 of one.
    """
    gears, source, result = plan.model.backlash, plan.model.input, plan.model.output
    run = gears.equal_run
    on_output = gears.memory_on == "output"
    slopes = axes.high / axes.wide
    steepest = float(slopes.max())
    span = float(axes.wide.sum())
    height = float(axes.high.sum())
    remembered, gain, growth = _loop(plan, axes, steepest)
    base = _begin_of_axis(plan, axes)
    _, x_in = counts_of_range(source)
    _, y_out = counts_of_range(result)
    before = fold(plan.model.head, source.minimum, source.maximum)
    entering = _function_error(before, q31, source.maximum, base, x_in, axes.x_unit)
    across = entering + _subset_error(axes.widths, axes.wide, run)
    off_x = np.repeat(axes.widths, run)[: gears.n] - axes.wide
    off_y = np.repeat(axes.heights, run)[: gears.n] - axes.high
    rising = _subset_error(axes.heights, axes.high, run)
    rising += float(np.max(np.abs(off_y) + slopes * np.abs(off_x)))
    if q31:
        shift = shift_for(steepest * axes.x_unit / axes.y_unit)
        rising += axes.y_unit * (
            1.0 + float(axes.wide.max()) / axes.x_unit * 2.0 ** -(shift + 1)
        )
    else:
        across += EPS * 2.0 * span + axes.x_count
        rising += EPS * 4.0 * float(axes.high.max()) + axes.y_unit
    if on_output:
        inner = (steepest * (across + remembered) + rising) * growth
        place = across + remembered + gain * inner
    else:
        inner = steepest * across + gain * entering + remembered + rising + axes.y_count
        place = across
    tolerance = _tolerance(
        place, float(axes.wide.min()), rising, float(axes.high.min()), plan
    )
    hop = float(axes.wide.max()) * float(np.sum(np.abs(np.diff(slopes)))) * growth
    behind = fold(plan.model.tail, gears.y0, gears.y0 + height)
    bend = float(np.abs(behind.slope).max())
    shifted = Folded(behind.x - gears.y0, behind.y, behind.slope)
    leaving = _function_error(shifted, q31, height, 0.0, axes.y_count, y_out)
    leaving += bend * 0.5 * axes.y_count
    leaving += y_out if q31 else EPS * bend * height
    if plan.model.delay_seconds and not on_output and not q31:
        leaving += 3.0 * EPS * max(abs(result.minimum), abs(result.maximum))
    same = bend * inner + leaving
    if plan.delay_is_smooth:
        rounding = 8.0 * EPS * max(abs(result.minimum), abs(result.maximum))
        if q31:
            rounding = 4.0 * y_out
        same = SMOOTH_GROWTH * same + rounding
    close = same + bend * hop
    return {
        "same_gears": same,
        "same_gears_percent": 100.0 * same / result.span,
        "after_close_turn": close,
        "after_close_turn_percent": 100.0 * close / result.span,
        "close_turn_fraction": tolerance,
    }


def _tolerance(
    place: float, narrow: float, rising: float, low: float, plan: CascadePlan
) -> float:
    """Return a power of two, twice what rounding can shift a turn by, as a part of the smallest gear."""
    part = 2.0 * max(place / narrow, rising / low)
    power = LEAST_TOLERANCE
    if part > 0.0:
        power = min(math.floor(-math.log2(part)), LEAST_TOLERANCE)
    if power < COARSEST_TOLERANCE:
        raise NarrowGearsError(
            f"{plan.model.backlash.n} gears are too narrow for this arithmetic: its rounding is "
            f"{100.0 * part:.2g} % of the smallest"
        )
    return 2.0**-power


def single_code(plan: CascadePlan, q31: bool) -> ModelCode:
    """Return the model as C in float32 or in q31.

    Raises
    ------
    ModelError
        The model is beyond what the arithmetic holds.
    """
    if plan.model.dynamics is not None or plan.model.drive_lag is not None:
        raise ModelError(
            "dynamics are beyond float and q31 (`arithmetic` double, or identify with `dynamics` 0)"
        )
    axes = axes_of(plan)
    if plan.terms and float((1.0 - plan.decay).min()) < SLOWEST_REST:
        raise ModelError(
            "relaxation.tau: a memory this slow at this rate stands still in this arithmetic"
            " (`sample_rate` lower, or `arithmetic` double)"
        )
    bounds = derive_bounds(plan, axes, q31)
    t = single_tables(plan, axes, q31, bounds["close_turn_fraction"])
    text: Text = integer if q31 else hex_float
    number = "int32_t" if q31 else "float"
    arithmetic = "q31" if q31 else "float"
    spare = plan.spare_words(32)
    tables, size = _tables(t, text)
    if spare:
        tables += array("uint32_t", "spare", spare)
    members = [
        *turns_members(t.n, arithmetic),
        "uint32_t segments[3];",
        "dbo_backlash_state gears;",
    ]
    if t.terms:
        members.append(f"dbo_memory memory[{len(t.terms)}];")
    more, delay = _delay_line(t, text, number)
    members += more
    low = high = change = ""
    if t.clip is not None:
        low, high = text(t.clip[0]), text(t.clip[1])
    if t.change is not None:
        change = text(t.change)
    values: dict[str, str | bool] = {
        "counts": q31, "inverse": plan.model.direction == "inverse", "terms": bool(t.terms),
        "spare": bool(spare), "delay": bool(delay), "tables": tables, "delay_line": delay,
        "TERMS": str(len(t.terms)), "COVERED": str(plan.model.covered_gears.n),
        "MEMORY": "state->memory" if t.terms else "0", "SPARE": "spare" if spare else "0",
        "CHECKPOINTS": checkpoints_of(t.n, arithmetic),
        "LIMITS": "0" if t.limits is None else "&limits", "LOWEST_OUTPUT": low, "HIGHEST_OUTPUT": high,
        "FIRST_OUTPUT": text(t.first), "slew": t.change is not None,
        "CHANGE": change, "REACH": f"{ignored_beyond(plan.model.input)}F",
        "DRIVE_REACH": f"{ignored_beyond(plan.model.drive)}F",
        "Y_SHIFT": str(t.y_shift),
    }  # fmt: skip
    for label, segments in (
        ("BEFORE", t.before),
        ("BEHIND", t.behind),
        ("DRIVE", t.drive),
    ):
        values |= {
            f"{label}_ROWS": str(len(segments.rows)),
            f"{label}_SHIFT": str(segments.shift),
        }
    values |= _words_of("INPUT", plan.model.input)
    values |= _words_of("OUTPUT", plan.model.output)
    headers = (INTERPOLATION,) if t.smooth else ()
    return ModelCode(
        number,
        members,
        "single.c",
        values,
        _vectors(plan, t, text),
        headers,
        size,
        bounds,
    )


def _delay_line(t: SingleTables, text: Text, number: str) -> tuple[list[str], str]:
    """Return the members of a delay line and its statements; nothing where there is no delay."""
    whole, part = t.delay
    if whole < 0:
        return [], ""
    if not t.smooth:
        return delay_line(whole, number, _between(t, text))
    suffix = "" if t.q31 else "F"
    return smooth_delay_line(whole, text(part), number, suffix)


def _words_of(side: str, quantity: Quantity) -> dict[str, str]:
    """Return what the files say of one side: its range in counts, and its label."""
    middle, unit = counts_of_range(quantity)
    label = quantity.quantity
    if quantity.unit:
        label += f" ({quantity.unit})"
    return {
        f"{side}_MIDDLE": repr(middle),
        f"{side}_COUNT": repr(unit),
        f"{side}_COUNTS": repr(1.0 / unit),
        f"{side}_LABEL": label,
    }


def _tables(t: SingleTables, text: Text) -> tuple[str, int]:
    """Return all tables but that of the spare gears, and their bytes."""
    rows = [
        [integer(width), integer(height), text(slope)]
        for width, height, slope in t.rows
    ]
    out = array("dbo_gear", "gears", struct_rows(rows))
    size = 12 * len(t.rows)
    begins = _begins(t)
    begin_rows = [[integer(x), integer(y)] for x, y in begins]
    out += array("dbo_begin", "begins", struct_rows(begin_rows))
    part_shift, guide = _guide(begins)
    out += array("dbo_place", "guide", [str(row) for row in guide])
    size += 16 * len(begins) + 2 * len(guide)
    if t.terms:
        factors = [
            [integer(carried), integer(rest), f"{shift}U"]
            for carried, rest, shift in t.terms
        ]
        out += array("dbo_term", "terms", struct_rows(factors))
        size += 12 * len(factors)
    shift = row_shift(t.n, t.run)
    factor = (2**shift + t.run - 1) // t.run
    half_run = 2 ** (t.run.bit_length() - 1)
    out += (
        f"static const dbo_backlash op = {{gears, begins, guide, {part_shift}U,\n    {t.n}U, {t.run}U,"
        f" {half_run}U, {factor}U, {shift}U, {t.tolerance}U,"
        f" {'terms' if t.terms else '0'}, {len(t.terms)}U,\n"
        f"    {t.carried_shift}U, {int(t.memory_on_output)}, {integer(t.drive_offset)}, {t.drive_shift}U,"
        f" {t.slope_shift}U, {t.x_shift}U, {t.y_shift}U, {integer(t.least)}, {integer(t.most)}}};\n"
    )
    if t.limits is not None:
        out += f"static const dbo_limits limits = {{{', '.join(integer(v) for v in t.limits)}}};\n"
    for label, segments in (
        ("before", t.before),
        ("behind", t.behind),
        ("drives", t.drive),
    ):
        rows = [[text(value) for value in row] for row in segments.rows]
        out += array("dbo_segment", label, struct_rows(rows))
        size += (24 if t.q31 else 12) * len(rows)
    return out, size


def _begins(t: SingleTables) -> list[tuple[int, int]]:
    """Return where each row of gears begins, and where the last gear ends."""
    begins = [(0, 0)]
    for first, (width, height, _) in zip(range(0, t.n, t.run), t.rows, strict=True):
        count = min(t.run, t.n - first)
        x, y = begins[-1]
        begins.append((x + count * width, y + count * height))
    return begins


def _guide(begins: list[tuple[int, int]]) -> tuple[int, list[int]]:
    """Return a shift that cuts positions into parts, one or two a row, and in which row each part begins."""
    starts = np.array([x for x, _ in begins], np.int64)
    span, rows = int(starts[-1]), len(begins) - 1
    shift = max((span // rows).bit_length() - 1, 0)
    parts = np.arange((span >> shift) + 2, dtype=np.int64) << shift
    rows_of_parts = np.searchsorted(starts, parts, side="right") - 1
    return shift, np.minimum(rows_of_parts, rows - 1).tolist()


def row_shift(n: int, run: int) -> int:
    """Return a shift with which i * ceil(2^shift / run) >> shift is i // run for all i <= n, in 32 bits."""
    if run == 1:
        return 0
    return (n * run - 1).bit_length()


def _between(t: SingleTables, text: Text) -> str:
    """Return the expression between two samples of a delay line."""
    part = t.delay[1]
    if not part:
        return "later"
    if not t.q31:
        return f"later + {text(part)} * (earlier - later)"
    both = f"(int64_t)later * {2**30} + (int64_t){part} * ((int64_t)earlier - later)"
    return f"dbo_counts_of({both}, 30U)"


def _vectors(plan: CascadePlan, t: SingleTables, text: Text) -> list[Vectors]:
    """Return two runs, computed by the readable twin of the kernel."""
    source = plan.model.input
    vectors = []
    start = _number(plan.trimmed_drive, plan.model.drive, t.q31)
    for seed, reset in enumerate((None, start), 1):
        moves = self_test_moves(source.minimum, source.maximum, seed)
        inputs = [_number(move, source, t.q31) for move in moves.tolist()]
        kernel = SingleKernel(t)
        with np.errstate(over="ignore", under="ignore"):
            if reset is not None:
                kernel.reset(reset)
            outputs = [kernel.step(x) for x in inputs]
        begun = None if reset is None else text(reset)
        vectors.append(
            Vectors(begun, [text(x) for x in inputs], [text(y) for y in outputs])
        )
    return vectors
