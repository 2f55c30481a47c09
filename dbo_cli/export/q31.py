"""The model in q31, whole numbers of 32 bits, as C: tables, steps, and a self-test within the bound."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan, trial_moves
from dbo_cli.export.q31_bounds import Bounds, bounds_of
from dbo_cli.export.q31_tables import (
    Axis,
    CountLimits,
    Memory,
    beyond_q31,
    counts_of_range,
    fold,
    limits_of,
    memory_of,
    segments_of,
    shift_for,
    to_counts,
)
from dbo_cli.model import Quantity

STEP_PARTS = 2**26  # of a step, as dbo_q31_interpolation.h counts them
MOST_GEARS = 46_340
"""Up to here n gears find their row with a product of 32 bits, whatever the run."""
SLOWEST_REST = 2.0**-34
"""A memory that follows by less a step would stand still below 2^10 counts, 1e-6 of the range."""


def q31_sources(plan: Plan) -> tuple[c.Sources, Bounds]:
    """Return the model as C in q31, and how far it can be from the float64 model.

    Raises
    ------
    ModelError
        The model is beyond what whole numbers hold; or its memory has negative gains,
        for which no bound is known.
    """
    _check(plan)
    gears, source, drive = plan.gears, plan.forward.output, plan.forward.input
    wide = gears.exchanged[:, 0] + plan.kappa * gears.exchanged[:, 1]
    x_axis = Axis.of(wide, gears.equal_run)
    y_axis = Axis.of(gears.exchanged[:, 1].copy(), gears.equal_run)
    memory = memory_of(plan, x_axis, y_axis)
    before = fold(plan.forward.tail.inverse(), source.min, source.max)
    height = float(y_axis.exact.sum())
    after = fold(plan.forward.head.inverse(), gears.x0, gears.x0 + height)
    drives = fold(plan.forward.head, drive.min, drive.max)
    bounds = bounds_of(plan, x_axis, y_axis, memory, before, after)
    limits = limits_of(plan, y_axis)
    runs = [_run(plan, None, 1), _run(plan, plan.trimmed, 2)]
    # where the gears begin on the input, which the memory widens
    begin = gears.y0 + plan.kappa * (gears.x0 - plan.gears.reference)
    source_counts, drive_counts = counts_of_range(source), counts_of_range(drive)
    functions = {
        "BEFORE": segments_of(before, source_counts, (begin, x_axis.unit)),
        "BEHIND": segments_of(after, (gears.x0, y_axis.count), drive_counts),
        "DRIVE": segments_of(drives, drive_counts, (gears.x0, y_axis.unit)),
    }
    tables = _gear_tables(plan, x_axis, y_axis, memory, bounds)
    values = _values(plan, y_axis, limits)
    for name, segments in functions.items():
        rows = c.structs(segments.rows, c.whole)
        tables += c.array("dboq_segment", f"{name.lower()}_segments", rows)
        values[f"{name}_ROWS"] = str(len(segments.rows))
        values[f"{name}_SHIFT"] = str(segments.shift)
    tables += f"static const dboq_limits limits = {c.structs([limits.positions], c.whole)[0]};\n"
    spare = c.words_of(plan.forward.starts.empty, gears.n, 32)
    if spare:
        tables += c.array("uint32_t", "spare", spare)
    values["TABLES"] = tables
    values["SPARE"] = "spare" if spare else "0"
    values |= _stated(bounds, drive, limits, len(runs[0].inputs))
    kernel = ["dbo_q31.h", "dbo_q31.c"]
    if plan.delay_samples[1]:
        kernel.append("dbo_q31_interpolation.h")
    return c.Sources(kernel, _members(plan), values=values, runs=runs), bounds


def _check(plan: Plan) -> None:
    """Refuse what q31 has no arithmetic or no bound for."""
    if plan.forward.amplifier is not None:
        raise beyond_q31("amplifier")
    if plan.forward.dynamics is not None:
        raise beyond_q31("dynamics")
    if np.any(plan.gears.gain < 0.0):  # no bound is proven for them
        raise beyond_q31(f"{plan.key}.relaxation.gain")
    if np.any(1.0 - plan.decay < SLOWEST_REST):
        raise beyond_q31(f"{plan.key}.relaxation.tau", "lower `sample_rate`, or ")
    if plan.gears.n > MOST_GEARS:
        raise beyond_q31(f"{plan.key}.dx", "lower `gears`, or ")


def _members(plan: Plan) -> list[str]:
    """Return the members of the state."""
    n, terms = plan.gears.n, plan.gears.gain.size
    members = ["dboq_backlash_state gears;", f"dboq_place turns[{n}];"]
    if plan.checkpoints:
        members.insert(0, f"dboq_checkpoint checkpoints[{plan.checkpoints}];")
    if terms:
        members.append(f"dboq_memory memory[{terms}];")
    members.append("uint32_t segments[3];")
    if plan.delay_samples[1]:
        members += ["int32_t wanted[6];", "int waiting;"]
    return members


def _values(plan: Plan, y_axis: Axis, limits: CountLimits) -> dict[str, str]:
    """Return what the state begins with, and what surrounds the gears in a step."""
    first = plan.first_drive
    at_gears = plan.forward.head.value(first)
    position = round((at_gears - plan.gears.x0) / y_axis.unit)
    output = min(max(to_counts(first, plan.forward.input), limits.low), limits.high)
    init = delay = slew = ""
    fraction = plan.delay_samples[1]
    if fraction:
        init = "    state->waiting = 1;"
        delay = c.fill("delay_q31.c", {"PART": str(round(fraction * STEP_PARTS))})
    if limits.change is not None:
        slew = c.fill("slew_q31.c", {"MOST_CHANGE": c.whole(limits.change)})
    return {
        "INIT": init,
        "STEP": delay.rstrip("\n"),
        "SLEW": slew.rstrip("\n"),
        "CHECKPOINTS": "state->checkpoints" if plan.checkpoints else "0",
        "MEMORY": "state->memory" if plan.gears.gain.size else "0",
        "COVERED": str(plan.forward.starts.inside.n),
        "FIRST_DRIVE": c.whole(position),
        "FIRST_OUTPUT": c.whole(output),
        "LEAST": c.whole(limits.low),
        "MOST": c.whole(limits.high),
        "Y_SHIFT": str(y_axis.fine),
        **_scales("IN", plan.forward.output),
        **_scales("OUT", plan.forward.input),
    }


def _scales(name: str, quantity: Quantity) -> dict[str, str]:
    """Return what NAME_IN and NAME_OUT convert by: counts for one unit, or one unit for counts."""
    middle, unit = counts_of_range(quantity)
    scale = 1.0 / unit if name == "IN" else unit
    return {f"{name}_MIDDLE": repr(middle), f"{name}_SCALE": repr(scale)}


def _stated(
    bounds: Bounds, drive: Quantity, limits: CountLimits, samples: int
) -> dict[str, str]:
    """Return the bounds, as README.md says them and in counts for the self-test."""
    slack = 1  # the outputs of the library are rounded
    if limits.change is not None:
        slack += samples
    unit, suffix = counts_of_range(drive)[1], c.plain(drive.suffix)
    return {
        "SAME": f"{bounds.same:.3g}{suffix} ({bounds.same_percent:.3g} % of the range)",
        "CLOSE": f"{bounds.close:.3g}{suffix} ({bounds.close_percent:.3g} % of the range)",
        "FRACTION": f"{bounds.fraction:.2g}",
        "SAME_COUNTS": str(math.ceil(bounds.same / unit) + slack),
        "CLOSE_COUNTS": str(math.ceil(bounds.close / unit) + slack),
    }


def _gear_tables(
    plan: Plan, x_axis: Axis, y_axis: Axis, memory: Memory | None, bounds: Bounds
) -> str:
    """Return the tables of the gears and of the memory, and the operator."""
    n, run = plan.gears.n, plan.gears.equal_run
    slopes = y_axis.widths / x_axis.widths * (x_axis.unit / y_axis.unit)
    slope_shift = shift_for(float(slopes.max()))
    if slope_shift < 16:
        raise beyond_q31(f"{plan.key}.dy")
    widths = np.rint(x_axis.widths / x_axis.unit).astype(np.int64)
    heights = np.rint(y_axis.widths / y_axis.unit).astype(np.int64)
    whole_slopes = np.rint(slopes * 2.0**slope_shift).astype(np.int64)
    rows = np.column_stack([widths, heights, whole_slopes])
    counts = np.full(len(rows), run)
    counts[-1] = n - run * (len(rows) - 1)
    ends = np.cumsum(rows[:, :2] * counts[:, None], axis=0)
    begins = np.vstack([[0, 0], ends])
    part_shift, guide = _guide(begins[:, 0])
    text = c.array("dboq_gear", "gears", c.structs(rows.tolist(), c.whole))
    text += c.array("dboq_begin", "begins", c.structs(begins.tolist(), c.whole))
    text += c.array("dboq_place", "guide", [str(row) for row in guide])
    terms, memory_numbers = "0, 0", "0, 0, 0"
    if memory is not None:
        terms = f"terms, {len(memory.terms)}"
        offset = c.whole(round(memory.offset / memory.unit))
        memory_numbers = f"{memory.carried_shift}, {offset}, {memory.shift}"
        text += c.array("dboq_term", "terms", c.structs(memory.terms, c.whole))
    # i * factor >> shift is i // run for all i <= n, in 32 bits
    shift = 0 if run == 1 else (n * run - 1).bit_length()
    factor = (2**shift + run - 1) // run
    half_run = 2 ** (run.bit_length() - 1)
    tolerance = round(-math.log2(bounds.fraction))
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


def _run(plan: Plan, reset: float | None, seed: int) -> c.SelfTestRun:
    """Return a run of the self-test: inputs in counts, and the library's output for them."""
    source, drive = plan.forward.output, plan.forward.input
    middle, unit = counts_of_range(source)
    inputs = []
    for move in trial_moves(source.min, source.max, seed).tolist():
        inputs.append(to_counts(move, source))
    reset_counts = None
    state = plan.resting(plan.first_drive, plan.forward.starts.empty)
    if reset is not None:
        start = to_counts(reset, drive)
        reset_counts = c.whole(start)
        drive_middle, drive_unit = counts_of_range(drive)
        state = plan.settled(start * drive_unit + drive_middle)
    outputs = plan.played(np.array(inputs) * unit + middle, state)
    expected = [c.whole(to_counts(y, drive)) for y in outputs.tolist()]
    return c.SelfTestRun(reset_counts, [c.whole(x) for x in inputs], expected)
