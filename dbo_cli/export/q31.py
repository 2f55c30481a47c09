"""The model in q31, whole numbers of 32 bits, as C: tables, steps, and a self-test within the bound."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan, trial_moves
from dbo_cli.export.q31_bounds import Bounds, bounds_of
from dbo_cli.export.q31_tables import (
    Axes,
    Segments,
    axes_of,
    begin_of_axis,
    counts_of_range,
    fold,
    limits_of,
    remembered,
    segments_of,
    shift_for,
    terms_of,
    to_counts,
)
from dbo_cli.model import State

PARTS = 2**26  # of a step, as dbo_q31_interpolation.h counts them
MOST_GEARS = 46_340
"""Up to here n gears find their row with a product of 32 bits, whatever the run."""
SLOWEST_REST = 2.0**-34
"""A memory that follows by less a step would stand still below 2^10 counts, 1e-6 of the range."""
SPACING = 64  # turns that share a checkpoint, as in dbo_q31.h


def q31_sources(plan: Plan) -> tuple[c.Sources, Bounds]:
    """Return the model as C in q31, and how far it can be from the float64 model.

    Raises
    ------
    ModelError
        The model is beyond what whole numbers hold; or its memory has negative gains,
        for which no bound is known.
    """
    _check(plan)
    axes = axes_of(plan)
    source = plan.model.input
    moves = trial_moves(source.min, source.max)
    bounds = bounds_of(plan, axes, moves.size)
    kernel = ["dbo_q31.h", "dbo_q31.c"]
    if plan.delay_samples[1]:
        kernel.append("dbo_q31_interpolation.h")
    runs = [_run(plan, None, 1), _run(plan, plan.trimmed, 2)]
    values = _values(plan, axes, bounds)
    return c.Sources(values, _members(plan), kernel, runs), bounds


def _check(plan: Plan) -> None:
    """Refuse what q31 has no arithmetic or no bound for."""
    if plan.forward.dynamics is not None:
        raise ModelError(
            "dynamics are beyond q31 (`arithmetic` double, or identify with `dynamics` 0)"
        )
    if np.any(plan.gain < 0.0):
        raise ModelError(
            "relaxation.gain: q31 has no proven bound for negative gains (`arithmetic` double)"
        )
    if plan.gain.size and float((1.0 - plan.decay).min()) < SLOWEST_REST:
        raise ModelError(
            "relaxation.tau: a memory this slow at this rate stands still in q31 (`sample_rate` lower, or"
            " `arithmetic` double)"
        )
    if plan.gears.n > MOST_GEARS:
        raise ModelError(
            f"dx: {plan.gears.n} gears are more than {MOST_GEARS} (`gears` fewer, or `arithmetic` double)"
        )


def _values(plan: Plan, axes: Axes, bounds: Bounds) -> dict[str, str]:
    """Return what the template is filled with."""
    n, terms = plan.gears.n, plan.gain.size
    source, drive, gears = plan.model.input, plan.model.output, plan.gears
    limits = limits_of(plan, axes)
    taken, given = counts_of_range(source), counts_of_range(drive)
    begin = (begin_of_axis(plan, axes), axes.x_unit)
    height = float(axes.high.sum())
    before = segments_of(fold(plan.model.head, source.min, source.max), taken, begin)
    behind = segments_of(
        fold(plan.model.tail, gears.y0, gears.y0 + height),
        (gears.y0, axes.y_count),
        given,
    )
    drives = segments_of(
        fold(plan.drive_curves, drive.min, drive.max), given, (gears.y0, axes.y_unit)
    )
    spare = c.words_of(plan.starts.empty, n, 32)
    tables = _gear_tables(plan, axes, bounds)
    low, high, step = limits.positions
    tables += f"static const dboq_limits limits = {{{c.whole(low)}, {c.whole(high)}, {c.whole(step)}}};\n"
    for label, segments in (("before", before), ("behind", behind), ("drives", drives)):
        tables += _segments(label, segments)
    if spare:
        tables += c.array("uint32_t", "spare", spare)
    place = round((plan.at_gears(plan.first_drive) - gears.y0) / axes.y_unit)
    output = min(max(to_counts(plan.first_drive, drive), limits.low), limits.high)
    init = ""
    if plan.delay_samples[1]:
        init = "    state->waiting = 1;"
    return {
        "TABLES": tables,
        "INIT": init,
        "STEP": _between(plan),
        "SLEW": _slew(limits.change),
        "CHECKPOINTS": "state->checkpoints" if (n - 1) // SPACING else "0",
        "MEMORY": "state->memory" if terms else "0",
        "SPARE": "spare" if spare else "0",
        "COVERED": str(plan.starts.moved.n),
        "FIRST_DRIVE": c.whole(place),
        "FIRST_OUTPUT": c.whole(output),
        "LEAST": c.whole(limits.low),
        "MOST": c.whole(limits.high),
        "Y_SHIFT": str(axes.fine[1]),
        **_sizes("BEFORE", before),
        **_sizes("BEHIND", behind),
        **_sizes("DRIVE", drives),
    }


def _sizes(label: str, segments: Segments) -> dict[str, str]:
    return {
        f"{label}_ROWS": str(len(segments.rows)),
        f"{label}_SHIFT": str(segments.shift),
    }


def _segments(label: str, segments: Segments) -> str:
    rows = [[c.whole(value) for value in row] for row in segments.rows]
    return c.array("dboq_segment", label, c.structs(rows))


def _members(plan: Plan) -> list[str]:
    """Return the members of the state."""
    n, terms = plan.gears.n, plan.gain.size
    members = ["dboq_backlash_state gears;", f"dboq_place turns[{n}];"]
    checkpoints = (n - 1) // SPACING
    if checkpoints:
        members.insert(0, f"dboq_checkpoint checkpoints[{checkpoints}];")
    if terms:
        members.append(f"dboq_memory memory[{terms}];")
    members.append("uint32_t segments[3];")
    if plan.delay_samples[1]:
        members += ["int32_t wanted[6];", "int waiting;"]
    return members


def _between(plan: Plan) -> str:
    """Return the statements that read ahead by the part of a sample that a delay has beyond whole ones."""
    part = plan.delay_samples[1]
    if not part:
        return ""
    return (
        "    for (int k = 0; k < 6; k++) /* at rest before the first sample */\n"
        "        state->wanted[k] = state->waiting || k == 5 ? x : state->wanted[k + 1];\n"
        "    state->waiting = 0;\n"
        f"    x = dboq_between(state->wanted, 2, {round(part * PARTS)});"
    )


def _slew(change: int | None) -> str:
    """Return the statements that keep the largest change."""
    if change is None:
        return ""
    most = c.whole(change)
    return (
        f"    if ((int64_t)x - state->output < -{most}) x = (int32_t)(state->output - {most});\n"
        f"    if ((int64_t)x - state->output > {most}) x = (int32_t)(state->output + {most});"
    )


def _gear_tables(plan: Plan, axes: Axes, bounds: Bounds) -> str:
    """Return the tables of the gears and of the memory, and the operator."""
    n, run = plan.gears.n, plan.gears.equal_run
    rows, slope_shift = _rows(axes)
    begins = _begins(rows, n, run)
    part_shift, guide = _guide(begins)
    text = c.array("dboq_gear", "gears", _whole_structs(rows))
    text += c.array("dboq_begin", "begins", _whole_structs(begins))
    text += c.array("dboq_place", "guide", [str(row) for row in guide])
    terms, carried_shift = terms_of(plan, axes)
    if terms:
        factors = []
        for carried, rest, shift in terms:
            factors.append([c.whole(carried), c.whole(rest), f"{shift}U"])
        text += c.array("dboq_term", "terms", c.structs(factors))
    held = remembered(plan, axes)
    offset = round(held.offset / held.unit) if terms else 0
    shift = _row_shift(n, run)
    factor = (2**shift + run - 1) // run
    half_run = 2 ** (run.bit_length() - 1)
    span = begins[-1][0]
    return text + (
        f"static const dboq_backlash op = {{gears, begins, guide, {part_shift}U,\n    {n}U, {run}U,"
        f" {half_run}U, {factor}U, {shift}U, {round(-math.log2(bounds.fraction))}U,"
        f" {'terms' if terms else '0'}, {len(terms)}U,\n"
        f"    {carried_shift}U, {c.whole(offset)}, {held.shift}U,"
        f" {slope_shift}U, {axes.fine[0]}U, {axes.fine[1]}U, {c.whole(-span)}, {c.whole(2 * span)}}};\n"
    )


def _whole_structs(rows: list[tuple[int, ...]]) -> list[str]:
    return c.structs([c.whole(value) for value in row] for row in rows)


def _rows(axes: Axes) -> tuple[list[tuple[int, ...]], int]:
    """Return the gear table (width, height, slope), one row a run, and the shift of its slopes."""
    slopes = axes.heights / axes.widths * (axes.x_unit / axes.y_unit)
    shift = shift_for(float(slopes.max()))
    if shift < 16:
        raise ModelError("dy: a gear too steep for q31 (`arithmetic` double)")
    rows: list[tuple[int, ...]] = []
    for width, height, slope in zip(axes.widths, axes.heights, slopes, strict=True):
        whole = round(width / axes.x_unit), round(height / axes.y_unit)
        rows.append((*whole, round(slope * 2.0**shift)))
    return rows, shift


def _begins(rows: list[tuple[int, ...]], n: int, run: int) -> list[tuple[int, ...]]:
    """Return where each row of gears begins, and where the last gear ends."""
    begins: list[tuple[int, ...]] = [(0, 0)]
    for first, row in zip(range(0, n, run), rows, strict=True):
        count = min(run, n - first)
        x, y = begins[-1]
        begins.append((x + count * row[0], y + count * row[1]))
    return begins


def _guide(begins: list[tuple[int, ...]]) -> tuple[int, list[int]]:
    """Return a shift that cuts positions into parts, one or two a row, and in which row each part begins."""
    starts = np.array([begin[0] for begin in begins], np.int64)
    span, rows = int(starts[-1]), len(begins) - 1
    shift = max((span // rows).bit_length() - 1, 0)
    parts = np.arange((span >> shift) + 2, dtype=np.int64) << shift
    found = np.searchsorted(starts, parts, side="right") - 1
    return shift, np.minimum(found, rows - 1).tolist()


def _row_shift(n: int, run: int) -> int:
    """Return a shift with which i * ceil(2^shift / run) >> shift is i // run for all i <= n, in 32 bits."""
    if run == 1:
        return 0
    return (n * run - 1).bit_length()


def _run(plan: Plan, reset: float | None, seed: int) -> c.Run:
    """Return a run of the self-test: inputs in counts, and the library's output for them."""
    source, drive = plan.model.input, plan.model.output
    middle, unit = counts_of_range(source)
    inputs = []
    for move in trial_moves(source.min, source.max, seed).tolist():
        inputs.append(to_counts(move, source))
    start = None
    if reset is None:
        state = _at(plan, plan.first_drive, plan.starts.empty)
    else:
        start = to_counts(reset, drive)
        drive_middle, drive_unit = counts_of_range(drive)
        state = plan.settled(start * drive_unit + drive_middle)
    outputs = plan.played(np.array(inputs) * unit + middle, state)
    begun = None if start is None else c.whole(start)
    expected = [c.whole(to_counts(y, drive)) for y in outputs.tolist()]
    return c.Run(begun, [c.whole(x) for x in inputs], expected)


def _at(plan: Plan, drive: float, bits: int) -> State:
    """Return the state of an actuator that rests at a drive, its gears coming from ``bits``."""
    moved = plan.forward.gears.run([plan.at_gears(drive)], bits)
    return State(moved.bits, moved.memory, drive)
