"""The model in q31, whole numbers of 32 bits, as C: tables, steps, and a self-test within the bound."""

import math

import numpy as np

from dbo_cli.export import fixed_point
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan

STEP_PARTS = 2**26  # of a step, as dbo_q31_interpolation.h counts them
MOST_GEARS = 46_340
"""Up to here n gears find their row with a product of 32 bits, whatever the run."""
SLOWEST_REST = 2.0**-34
"""A memory that follows by less a step would stand still below 2^10 counts, 1e-6 of the range."""


def q31_sources(plan: Plan) -> c.Sources:
    """Return the model as C in q31, with how far it can be from the float64 model.

    Raises
    ------
    ModelError
        The model is beyond what whole numbers hold; or its memory has negative gains,
        for which no bound is known.
    """
    _check(plan)
    gears, starts = plan.gears, plan.forward.starts
    fixed = fixed_point.FixedPoint(plan)
    source, drive = fixed.source, fixed.drive
    bounds = fixed_point.bounds_of(fixed)
    kernel = ["dbo_q31.h", "dbo_q31.c"]
    low, high, change, positions = fixed_point.limits_of(fixed)
    tolerance = round(-math.log2(bounds["fraction"]))
    text = _gear_tables(fixed, tolerance)
    curves, numbers = _functions(fixed)
    limits = ", ".join(map(c.whole, positions))
    text += f"{curves}static const dboq_limits limits = {{{limits}}};\n"
    first = plan.forward.head.value(plan.first_drive)
    output = min(max(drive.count(plan.first_drive), low), high)
    spare, numbers["SPARE"] = c.spare(starts.empty, gears.n, 32)
    text += spare
    numbers |= {
        "COVERED": f"{starts.covered}U",
        "FIRST_AT_GEARS": c.whole(round((first - gears.x0) / fixed.y_axis.unit)),
        "FIRST_DRIVE": c.whole(output),
        "LOW": c.whole(low),
        "HIGH": c.whole(high),
        "Y_SHIFT": f"{fixed.y_axis.fine}U",
    }
    values = plan.sizes | {
        "IN_MIDDLE": repr(source.offset),
        "IN_SCALE": repr(1.0 / source.unit),
        "OUT_MIDDLE": repr(drive.offset),
        "OUT_SCALE": repr(drive.unit),
        "FRACTION": f"{bounds['fraction']:.2g}",
    }
    if change is not None:
        numbers["CHANGE"] = c.whole(change)
    if plan.delay_part:
        kernel.append("dbo_q31_interpolation.h")
        numbers["DELAY_WINDOW"] = values["DELAY_WINDOW"] = "DBOQ_WINDOW"
        numbers["DELAY_PART"] = str(round(plan.delay_part * STEP_PARTS))
    first_state = plan.resting(plan.first_drive, starts.empty)
    runs = plan.runs(first_state, source, drive)
    # counts beyond a bound: the library's outputs are rounded, and a slew limit, which
    # binds for some rows, is rounded in each
    slack = 1 if change is None else 1 + len(runs[0][1])
    unit = c.plain(plan.forward.input.suffix)
    for name in ("same", "close"):
        bound, percent = bounds[name], bounds[f"{name}_percent"]
        words = f"{bound:.3g}{unit} ({percent:.3g} % of the range)"
        values[name.upper()] = words
        counts = math.ceil(bound / drive.unit) + slack
        values[f"{name.upper()}_COUNTS"] = str(counts)
    return c.Sources(
        kernel,
        runs,
        lambda x: c.whole(source.count(x)),
        lambda y: c.whole(drive.count(y)),
        text,
        numbers,
        values,
        bounds,
    )


def _check(plan: Plan) -> None:
    """Refuse what q31 has no arithmetic or no bound for."""
    for stage in ("amplifier", "dynamics"):
        if getattr(plan.forward, stage) is not None:
            raise fixed_point.beyond_q31(stage)
    if np.any(plan.gears.gain < 0.0):  # no bound is proven for them
        raise fixed_point.beyond_q31(f"{plan.key}.relaxation.gain")
    if np.any(1.0 - plan.decay < SLOWEST_REST):
        slow = f"{plan.key}.relaxation.tau"
        raise fixed_point.beyond_q31(slow, "lower `sample_rate`, or ")
    if plan.gears.n > MOST_GEARS:
        raise fixed_point.beyond_q31(f"{plan.key}.dx", "lower `gears`, or ")


def _functions(fixed: fixed_point.FixedPoint) -> tuple[str, dict[str, str]]:
    """Return the curves around the gears as segments; and how many there are, and their shifts."""
    gears, at_drive = fixed.plan.gears, fixed.y_axis
    # where the gears begin on the input, which the memory widens
    begin = gears.y0 + fixed.plan.kappa * (gears.x0 - gears.reference)
    text, numbers = "", {}
    for name, curve, x, y in (
        ("before", fixed.before, fixed.source, (begin, fixed.x_axis.unit)),
        ("behind", fixed.after, (gears.x0, at_drive.count_unit), fixed.drive),
        ("drive", fixed.start, fixed.drive, (gears.x0, at_drive.unit)),
    ):
        rows, shift = fixed_point.segments_of(curve, x, y)
        text += c.array("dboq_segment", f"{name}_segments", rows, c.whole)
        numbers[f"{name.upper()}_ROWS"] = f"{len(rows)}U"
        numbers[f"{name.upper()}_SHIFT"] = f"{shift}U"
    return text, numbers


def _gear_tables(fixed: fixed_point.FixedPoint, tolerance: int) -> str:
    """Return the tables of the gears and of the memory, and the operator, whose tolerance is 2^-tolerance."""
    plan, memory, x_axis, y_axis = fixed.plan, fixed.memory, fixed.x_axis, fixed.y_axis
    n, run = plan.gears.n, plan.gears.equal_run
    slopes = y_axis.widths / x_axis.widths * (x_axis.unit / y_axis.unit)
    slope_shift = fixed_point.shift_for(float(slopes.max()))
    if slope_shift < 16:
        raise fixed_point.beyond_q31(f"{plan.key}.dy")
    numbers = [x_axis.widths / x_axis.unit, y_axis.widths / y_axis.unit]
    numbers.append(slopes * 2.0**slope_shift)
    rows = np.rint(np.column_stack(numbers)).astype(np.int64)
    counts = np.full(len(rows), run)
    counts[-1] = n - run * (len(rows) - 1)
    ends = np.cumsum(rows[:, :2] * counts[:, None], axis=0)
    begins = np.vstack([[0, 0], ends])
    part_shift, guide = _guide(begins[:, 0])
    text = c.array("dboq_gear", "gears", rows, c.whole)
    text += c.array("dboq_begin", "begins", begins, c.whole)
    text += c.array("dboq_place", "guide", guide)
    terms, memory_numbers = "0, 0", "0, 0, 0"
    if memory is not None:
        terms = f"terms, {len(memory.terms)}"
        offset = c.whole(round(memory.offset / memory.unit))
        memory_numbers = f"{memory.carried_shift}, {offset}, {memory.shift}"
        text += c.array("dboq_term", "terms", memory.terms, c.whole)
    # i * factor >> shift is i // run for all i <= n, in 32 bits
    shift = 0 if run == 1 else (n * run - 1).bit_length()
    factor = (2**shift + run - 1) // run
    half_run = 2 ** (run.bit_length() - 1)
    span = int(begins[-1, 0])
    return text + (
        f"static const dboq_backlash op = {{gears, begins, guide, {part_shift}, {n}, {run}, {half_run},"
        f" {factor}U, {shift}, {tolerance}, {terms},\n    {memory_numbers}, {slope_shift},"
        f" {c.whole(-span)}, {c.whole(2 * span)}}};\n"
    )


def _guide(starts: np.ndarray) -> tuple[int, list[int]]:
    """Return a shift that cuts positions into parts, one or two a row, and in which row each part begins."""
    span, rows = int(starts[-1]), len(starts) - 1
    shift = max((span // rows).bit_length() - 1, 0)
    parts = np.arange((span >> shift) + 2, dtype=np.int64) << shift
    first = np.searchsorted(starts, parts, side="right") - 1
    return shift, np.minimum(first, rows - 1).tolist()
