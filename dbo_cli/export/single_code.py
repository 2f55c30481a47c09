"""The model in float32 or q31: tables, steps, self-test vectors and bounds as parts of the frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export.c_frame import SourceParts, Vectors, delay_line
from dbo_cli.export.c_text import array, hex_float, integer, struct_rows
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.double_code import common_macros, first_output, ignored_beyond
from dbo_cli.export.error_bounds import derive_bounds
from dbo_cli.export.self_test_moves import self_test_moves
from dbo_cli.export.single_kernel import F, Segments, SingleKernel, SingleTables, clamped
from dbo_cli.export.single_tables import axes_of, check_memories, counts_unit, single_tables

Text = Callable[[Any], str]


def tables_and_bounds(plan: CascadePlan, q31: bool) -> tuple[SingleTables, dict[str, float]]:
    """Return the constants of one arithmetic and the derived bounds by name.

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
    if q31:
        check_memories(plan)
    bounds = derive_bounds(plan, axes, q31)
    return single_tables(plan, axes, q31, bounds.tolerance), bounds.figures(plan.model.output.span)


def _segments(name: str, segments: Segments, text: Text) -> tuple[str, int]:
    rows = struct_rows(
        (text(x), text(y), text(s)) for x, y, s in zip(segments.x, segments.y, segments.slope, strict=True)
    )
    return array("dbo_segment", name, rows), len(rows)


def _operator(t: SingleTables, text: Text) -> tuple[str, int]:
    """Return the gears' tables and the operator, and their bytes."""
    rows = [[integer(width), integer(height), text(slope)] for width, height, slope in t.rows]
    out = array("dbo_gear", "gears", struct_rows(rows))
    size = 12 * len(t.rows)
    terms = "0"
    if t.terms:
        factors = [
            [text(carried), text(rest), *([f"{up}U", f"{down}U"] if t.q31 else [])]
            for carried, rest, up, down in t.terms
        ]
        out += array("dbo_term", "terms", struct_rows(factors))
        size += (12 if t.q31 else 8) * len(factors)
        terms = "terms"
    shift = row_shift(t.n, t.run)
    factor = (2**shift + t.run - 1) // t.run
    out += (
        f"static const dbo_backlash op = {{gears, {t.n}U, {t.run}U, {factor}U, {shift}U, {t.tolerance}U,"
        f" {terms}, {len(t.terms)}U,\n    {int(t.memory_on_output)}, {text(t.drive_offset)},"
        f" {t.slope_shift}U, {t.x_shift}U, {t.y_shift}U, {integer(t.least)}, {integer(t.most)}}};\n"
    )
    if t.limits is not None:
        out += f"static const dbo_limits limits = {{{', '.join(integer(v) for v in t.limits)}}};\n"
    return out, size


def row_shift(n: int, run: int) -> int:
    """Return a shift with which i * ceil(2^shift / run) >> shift is i // run for all i < n, in 32 bits."""
    shift = 0
    while 2**shift < n * run and run > 1:
        shift += 1
    return shift


_LOOKUP = "dbo_segments_step({}, {}U, {}U, &state->segments[{}], {})"


def _step(plan: CascadePlan, t: SingleTables, counts: list[int], attach: str, text: Text) -> str:
    """Return the statements of one sample, but for a delay."""
    before = _LOOKUP.format("before", counts[0], t.before.shift, 0, "x")
    passed = f"{'' if t.q31 else '(float)'}dbo_counts_of(y, {t.y_shift}U)"
    result = _LOOKUP.format("behind", counts[1], t.behind.shift, 1, passed)
    step = (
        f"    dbo_signal u;\n    dbo_position y;\n{attach}    u = {before};\n"
        f"    y = dbo_backlash_step(&op, &state->gears, u, {'0' if t.limits is None else '&limits'});\n"
        f"    x = {f'dbo_counts_of({result}, 0U)' if t.q31 else result};"
    )
    if t.clip is not None:
        low, high = text(t.clip[0]), text(t.clip[1])
        step += f"\n    x = x < {low} ? {low} : x > {high} ? {high} : x;"
    return step


def _lagged(t: SingleTables, text: Text) -> str:
    """Return the expression between two samples of a delay line."""
    part = t.delay[1]
    if not part:
        return "later"
    if not t.q31:
        return f"later + {text(part)} * (earlier - later)"
    both = f"(int64_t)later * {2**30} + (int64_t){part} * ((int64_t)earlier - later)"
    return f"dbo_counts_of({both}, 30U)"


def _start(t: SingleTables) -> tuple[list[str], str, str]:
    """Return the state's members, the statements that attach its arrays, and those that clear it."""
    words = (t.n + 31) // 32 + 8 * -(-t.n // 64)  # DBO_WORDS(n)
    members = [f"uint32_t words[{words}];", "uint32_t segments[3];", "dbo_backlash_state gears;"]
    clear = f"    for (uint32_t k = 0U; k < {words}U; k++) state->words[k] = 0U;\n"
    clear += "    for (uint32_t k = 0U; k < 3U; k++) state->segments[k] = 0U;\n"
    if t.terms:
        members.append(f"dbo_memory memory[{len(t.terms)}];")
        zero = "state->memory[k] = 0;" if t.q31 else "state->memory[k].value = state->memory[k].lost = 0.0F;"
        clear += f"    for (uint32_t k = 0U; k < {len(t.terms)}U; k++) {zero}\n"
    memory = "state->memory" if t.terms else "0"
    return members, f"    state->gears.words = state->words;\n    state->gears.memory = {memory};\n", clear


def single_parts(plan: CascadePlan, q31: bool) -> tuple[SourceParts, int, dict[str, float]]:
    """Return the sources' parts, the bytes of the tables, and the bounds."""
    t, bounds = tables_and_bounds(plan, q31)
    text: Text = integer if q31 else hex_float
    number = "int32_t" if q31 else "float"
    tables, size = _operator(t, text)
    counts = []
    for label, segments in (("before", t.before), ("behind", t.behind), ("drives", t.drive)):
        more, count = _segments(label, segments, text)
        tables, size = tables + more, size + (24 if q31 else 12) * count
        counts.append(count)
    spare = plan.spare_words(32)
    members, attach, clear = _start(t)
    if spare:
        tables += array("uint32_t", "spare", spare)
        clear += f"    for (uint32_t k = 0U; k < {len(spare)}U; k++) state->words[k] = spare[k];\n"
    step = _step(plan, t, counts, attach, text)
    initialise = (
        clear + attach + "    dbo_backlash_load(&op, &state->gears);\n    state->gears.last = state->gears.y;"
    )
    if t.delay[0] >= 0:
        more_members, empty, line = delay_line(t.delay[0], number, _lagged(t, text))
        members, initialise, step = members + more_members, initialise + "\n" + empty, step + "\n" + line
    drive = _LOOKUP.format("drives", counts[2], t.drive.shift, 2, "x")
    source = plan.model.input
    reach = ignored_beyond(source)
    at_start = first_output(plan)
    parts = SourceParts(
        number=number,
        tables=tables,
        members=members,
        initialise=initialise,
        start=(
            f"    dbo_backlash_settle(&op, &state->gears, {t.covered}U, {'spare' if spare else '0'},\n"
            f"                        {drive});"
        ),
        step=step,
        lowest=None if q31 else f"-{reach}F",
        highest=None if q31 else f"{reach}F",
        first_output=integer(to_counts(plan, at_start, "output")) if q31 else hex_float(at_start),
        drive_is_output=plan.direction == "inverse",
        macros=common_macros(plan) + (_count_macros(plan) if q31 else []),
        vectors=_vectors(plan, t, text),
    )
    return parts, size, bounds


def to_counts(plan: CascadePlan, value: float, which: str) -> int:
    """Return a value of the model's input or output in counts of q31, saturating."""
    quantity = plan.model.input if which == "input" else plan.model.output
    middle, unit = (
        0.5 * (quantity.minimum + quantity.maximum),
        counts_unit(quantity.minimum, quantity.maximum),
    )
    return clamped(round((value - middle) / unit))


def _count_macros(plan: CascadePlan) -> list[tuple[str, str, str]]:
    macros = []
    for way, quantity in (("IN", plan.model.input), ("OUT", plan.model.output)):
        middle = 0.5 * (quantity.minimum + quantity.maximum)
        unit = counts_unit(quantity.minimum, quantity.maximum)
        said = f"{quantity.quantity}{f' ({quantity.unit})' if quantity.unit else ''}"
        if way == "IN":
            value = f"((int32_t)(((x) - {middle!r}) * {1.0 / unit!r}))"
            macros.append(("IN(x)", value, f"{said} to counts; within twice the range"))
        else:
            macros.append(("OUT(q)", f"((q) * {unit!r} + {middle!r})", f"counts to {said}"))
    return macros


def _vectors(plan: CascadePlan, t: SingleTables, text: Text) -> list[Vectors]:
    """Return two runs, computed by the readable twin of the kernel."""
    source = plan.model.input
    drive = plan.model.output if plan.direction == "inverse" else plan.model.input
    trimmed = drive.minimum + 0.37 * drive.span
    found = []
    for seed, label in enumerate(("after init", "after reset"), 1):
        moves = self_test_moves(source.minimum, source.maximum, seed)
        if t.q31:
            inputs: list[Any] = [to_counts(plan, v, "input") for v in moves.tolist()]
            start: Any = to_counts(plan, trimmed, "output" if plan.direction == "inverse" else "input")
        else:
            inputs, start = [F(v) for v in moves], F(trimmed)
        kernel = SingleKernel(t)
        with np.errstate(over="ignore", under="ignore"):
            kernel.init() if label == "after init" else kernel.reset(start)
            outputs = [kernel.step(x) for x in inputs]
        reset = None if label == "after init" else text(start)
        found.append(Vectors(label, reset, [text(v) for v in inputs], [text(v) for v in outputs]))
    return found
