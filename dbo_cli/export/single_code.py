"""The model in float32 or q31 as C: tables, steps and self-test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export.cascade_plan import CascadePlan, ignored_beyond, self_test_moves
from dbo_cli.export.single_kernel import F, Segments, SingleKernel, SingleTables
from dbo_cli.export.single_tables import (
    axes_of,
    check_memories,
    counts_of_range,
    derive_bounds,
    single_tables,
    to_counts,
)
from dbo_cli.export.source_text import ModelCode, Vectors, array, delay_line, hex_float, integer, struct_rows

Text = Callable[[Any], str]


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
    if q31:
        check_memories(plan)
    bounds = derive_bounds(plan, axes, q31)
    t = single_tables(plan, axes, q31, bounds["close_turn_fraction"])
    text: Text = integer if q31 else hex_float
    number = "int32_t" if q31 else "float"
    spare = plan.spare_words(32)
    tables, size = _tables(t, text)
    if spare:
        tables += array("uint32_t", "spare", spare)
    words = (t.n + 31) // 32 + 8 * -(-t.n // 64)  # DBO_WORDS(n)
    members = [f"uint32_t words[{words}];", "uint32_t segments[3];", "dbo_backlash_state gears;"]
    if t.terms:
        members.append(f"dbo_memory memory[{len(t.terms)}];")
    delay = ""
    if t.delay[0] >= 0:
        more, delay = delay_line(t.delay[0], number, _between(t, text))
        members += more
    low, high = ("", "") if t.clip is None else map(text, t.clip)
    values: dict[str, str | bool] = {
        "counts": q31, "inverse": plan.direction == "inverse", "terms": bool(t.terms), "spare": bool(spare),
        "delay": bool(delay), "tables": tables, "delay_line": delay,
        "SPARE_WORDS": str(len(spare or ())),
        "WORDS": str(words), "TERMS": str(len(t.terms)), "COVERED": str(plan.model.covered_gears.operator.n),
        "MEMORY": "state->memory" if t.terms else "0", "SPARE": "spare" if spare else "0",
        "LIMITS": "0" if t.limits is None else "&limits", "LOWEST_OUTPUT": low, "HIGHEST_OUTPUT": high,
        "FIRST_OUTPUT": text(t.first), "slew": t.change is not None,
        "CHANGE": "" if t.change is None else text(t.change), "DRIVE_REACH": f"{ignored_beyond(plan.drive)}F",
        "REACH": f"{ignored_beyond(plan.model.input)}F",
        "Y_SHIFT": str(t.y_shift),
    }  # fmt: skip
    for label, segments in (("BEFORE", t.before), ("BEHIND", t.behind), ("DRIVE", t.drive)):
        values |= {f"{label}_ROWS": str(len(segments.x)), f"{label}_SHIFT": str(segments.shift)}
    for way, quantity in (("INPUT", plan.model.input), ("OUTPUT", plan.model.output)):
        middle, unit = counts_of_range(quantity)
        values |= {
            f"{way}_MIDDLE": repr(middle), f"{way}_COUNT": repr(unit), f"{way}_COUNTS": repr(1.0 / unit),
            f"{way}_LABEL": f"{quantity.quantity}{f' ({quantity.unit})' if quantity.unit else ''}",
        }  # fmt: skip
    return ModelCode(number, members, "single.c", values, _vectors(plan, t, text), (), size, bounds)


def _tables(t: SingleTables, text: Text) -> tuple[str, int]:
    """Return all tables but that of the spare gears, and their bytes."""
    rows = [[integer(width), integer(height), text(slope)] for width, height, slope in t.rows]
    out, size = array("dbo_gear", "gears", struct_rows(rows)), 12 * len(t.rows)
    if t.terms:
        factors = [
            [text(carried), text(rest), *([f"{up}U", f"{down}U"] if t.q31 else [])]
            for carried, rest, up, down in t.terms
        ]
        out += array("dbo_term", "terms", struct_rows(factors))
        size += (12 if t.q31 else 8) * len(factors)
    shift = row_shift(t.n, t.run)
    factor = (2**shift + t.run - 1) // t.run
    out += (
        f"static const dbo_backlash op = {{gears, {t.n}U, {factor}U, {shift}U, {t.tolerance}U,"
        f" {'terms' if t.terms else '0'}, {len(t.terms)}U,\n"
        f"    {int(t.memory_on_output)}, {text(t.drive_offset)},"
        f" {t.slope_shift}U, {t.x_shift}U, {t.y_shift}U, {integer(t.least)}, {integer(t.most)}}};\n"
    )
    if t.limits is not None:
        out += f"static const dbo_limits limits = {{{', '.join(integer(v) for v in t.limits)}}};\n"
    for label, segments in (("before", t.before), ("behind", t.behind), ("drives", t.drive)):
        out += array("dbo_segment", label, _segment_rows(segments, text))
        size += (24 if t.q31 else 12) * len(segments.x)
    return out, size


def _segment_rows(segments: Segments, text: Text) -> list[str]:
    rows = zip(segments.x, segments.y, segments.slope, strict=True)
    return struct_rows([text(value) for value in row] for row in rows)


def row_shift(n: int, run: int) -> int:
    """Return a shift with which i * ceil(2^shift / run) >> shift is i // run for all i < n, in 32 bits."""
    shift = 0
    while 2**shift < n * run and run > 1:
        shift += 1
    return shift


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
    source, found = plan.model.input, []
    start = to_counts(plan.trimmed_drive, plan.drive) if t.q31 else F(plan.trimmed_drive)
    for seed, reset in enumerate((None, start), 1):
        moves = self_test_moves(source.minimum, source.maximum, seed)
        inputs: list[Any] = [to_counts(v, source) if t.q31 else F(v) for v in moves.tolist()]
        kernel = SingleKernel(t)
        with np.errstate(over="ignore", under="ignore"):
            if reset is not None:
                kernel.reset(reset)
            outputs = [kernel.step(x) for x in inputs]
        texts = ([text(v) for v in values] for values in (inputs, outputs))
        found.append(Vectors(None if reset is None else text(reset), *texts))
    return found
