"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dbo_cli.export.c_frame import SourceParts, Vectors, delay_line
from dbo_cli.export.c_text import array, hex_double, struct_rows
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.self_test_moves import self_test_moves
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.kernel import buffer_words
from dbo_cli.hysteresis.model import NEGLIGIBLE, ModelState
from dbo_cli.hysteresis.operators import BacklashState

Floats = NDArray[np.float64]

IGNORED_BEYOND = 1e6
"""An input so many ranges beyond the model's counts as no number: what it leads to would not be finite."""


def stage_code(stages: MemoryFree, label: str, first_segment: int) -> tuple[str, str, int]:
    """Return tables, statements on ``x``, and how many point stages there are, each with a segment."""
    tables, steps, segment = "", [], first_segment
    for k, stage in enumerate(stages):
        if isinstance(stage, ScaleStage):
            steps.append(f"    x = {hex_double(stage.gain)} * x + {hex_double(stage.offset)};")
            continue
        rows = struct_rows([hex_double(v) for v in row] for row in stage.segments)
        tables += array("dbo_segment", f"{label}_{k}", rows)
        steps.append(
            f"    x = dbo_point_step({label}_{k}, {stage.m}, {hex_double(stage.x0)},\n"
            f"                       {hex_double(stage.y0)}, &state->segments[{segment}], x);"
        )
        segment += 1
    return tables, "\n".join(steps), segment


def _gear_tables(plan: CascadePlan) -> tuple[str, int, bool]:
    """Return the gears' tables, their bytes, and whether the kernel of a fixed step with limits serves."""
    gears = plan.backlash
    rows = gears.gears[:: gears.equal_run]
    text = array("dbo_gear", "gears", struct_rows([hex_double(v) for v in row] for row in rows))
    size = 32 * len(rows)
    general = plan.limits is not None or (plan.terms > 0 and gears.memory_on == "output")
    gain, decay = plan.gain, plan.decay
    if plan.terms:
        text += array("double", "gain", [hex_double(v) for v in gain])
        text += array("double", "decay", [hex_double(v) for v in decay])
        size += 16 * plan.terms
    text += (
        f"static const dbo_backlash op = {{gears, {gears.n}, {gears.equal_run}, 1,"
        f" DBO_ROW_FACTOR({gears.equal_run}),\n    {hex_double(gears.x0)}, {hex_double(gears.y0)}, 1,"
        f" {plan.terms}, {'gain' if plan.terms else '0'}, {hex_double(plan.reference)},"
        f" {int(gears.memory_on == 'output')}}};\n"
    )
    if not general:
        return text, size, False
    # As dbo_prepare_fixed_step computes them, in the same order.
    kappa, rest = 0.0, 1.0 - decay
    for c, b in zip(gain.tolist(), rest.tolist(), strict=True):
        kappa += c * b
    wide = rows[:, 0] + kappa * rows[:, 1]
    fixed = np.column_stack([wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3]])
    text += array("dbo_fixed_gear", "fixed_gears", struct_rows([hex_double(v) for v in row] for row in fixed))
    size += 24 * len(rows)
    if plan.terms:
        text += array("double", "rest", [hex_double(v) for v in rest])
        size += 8 * plan.terms
    names = ("decay", "rest") if plan.terms else ("0", "0")
    text += (
        f"static const dbo_fixed_step fixed = {{{hex_double(kappa)}, {names[0]}, {names[1]}, fixed_gears}};\n"
    )
    return text, size, True


def _limits(plan: CascadePlan) -> tuple[str, str]:
    """Return the limits' table and how to name them in a call."""
    inner = plan.inner_limits
    if inner is None:
        return "", "0"
    text, step = "", "0"
    if plan.slew_step is not None:
        text += f"static const double largest_change = {hex_double(plan.slew_step)};\n"
        step = "&largest_change"
    slack = NEGLIGIBLE * (inner.v_max - inner.v_min)
    text += (
        f"static const dbo_limits limits = {{{hex_double(inner.v_min)}, {hex_double(inner.v_max)},"
        f" {hex_double(slack)}, {step}, 0}};\n"
    )
    return text, "&limits"


def _delay_samples(plan: CascadePlan) -> tuple[int, float]:
    """Return a forward model's delay in whole samples and the part beyond, as the delay stage counts."""
    assert plan.time_step is not None
    samples = plan.delay / plan.time_step
    whole = math.floor(samples + 1e-9)
    part = max(samples - whole, 0.0)
    return whole, part if part > 1e-9 else 0.0


def double_parts(plan: CascadePlan) -> tuple[SourceParts, int]:
    """Return the sources' parts in float64 and the bytes of the tables."""
    gears = plan.backlash
    gear_text, size, general = _gear_tables(plan)
    limit_text, limit_name = _limits(plan)
    head_text, head_steps, segments = stage_code(plan.head, "before", 0)
    tail_text, tail_steps, segments = stage_code(plan.tail, "behind", segments)
    drive_stages = plan.head if plan.direction == "forward" else tuple(
        stage.inverse() for stage in reversed(plan.tail)
    )  # fmt: skip
    drive_text, drive_steps, segments = stage_code(drive_stages, "drive", segments)
    points = [s for s in (*plan.head, *plan.tail, *drive_stages) if not isinstance(s, ScaleStage)]
    size += 24 * sum(stage.m for stage in points)
    members = [f"uint64_t words[{buffer_words(gears.n)}];"]
    if plan.terms:
        members.append(f"double memory[{plan.terms}];")
    if segments:
        members.append(f"size_t segments[{segments}];")
    attach = "    state->gears.words = state->words;\n" + (
        "    state->gears.memory = state->memory;\n" if plan.terms else "    state->gears.memory = 0;\n"
    )
    members.append("dbo_backlash_state gears;")
    initialise = f"    for (size_t k = 0; k < {buffer_words(gears.n)}; k++) state->words[k] = 0;\n"
    if plan.terms:
        initialise += f"    for (size_t k = 0; k < {plan.terms}; k++) state->memory[k] = 0.0;\n"
    if segments:
        initialise += f"    for (size_t k = 0; k < {segments}; k++) state->segments[k] = 0;\n"
    initialise += (
        attach + "    dbo_backlash_load(&op, &state->gears);\n"
        f"    state->gears.last = {hex_double(plan.drive_origin)};"
    )
    start = (drive_steps + "\n" if drive_steps else "") + (
        f"    dbo_backlash_settle(&op, &state->gears, {plan.covered}, x);"
    )
    step = attach + (head_steps + "\n" if head_steps else "")
    if general:
        step += f"    x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, {limit_name}, &counts);"
    else:
        decay = "decay" if plan.terms else "0"
        step += f"    x = dbo_backlash_step(&op, &state->gears, x, {decay}, 0, &counts);"
    step = "    dbo_counts counts = {0, 0, 0, 0};\n" + step
    if tail_steps:
        step += "\n" + tail_steps
    if plan.limits is not None and plan.tail:
        low, high = hex_double(plan.limits.v_min), hex_double(plan.limits.v_max)
        step += f"\n    x = x < {low} ? {low} : x > {high} ? {high} : x;"
    if plan.direction == "forward" and plan.delay > 0.0:
        whole, part = _delay_samples(plan)
        lagged = f"later + {hex_double(part)} * (earlier - later)" if part else "later"
        more, clear, line = delay_line(whole, "double", lagged)
        members += more
        initialise += "\n" + clear
        step += "\n" + line
    source = plan.model.input
    reach = IGNORED_BEYOND * max(source.span, abs(source.minimum), abs(source.maximum))
    return (
        SourceParts(
            number="double",
            tables=gear_text + limit_text + head_text + tail_text + drive_text,
            members=members,
            initialise=initialise,
            start=start,
            step=step,
            lowest=hex_double(-reach),
            highest=hex_double(reach),
            first_output=hex_double(first_output(plan)),
            drive_is_output=plan.direction == "inverse",
            macros=common_macros(plan),
            vectors=_vectors(plan),
        ),
        size,
    )


def common_macros(plan: CascadePlan) -> list[tuple[str, str, str]]:
    """Return what every header defines: the clock, and the delay that the caller must read ahead."""
    macros = []
    if plan.time_step is not None:
        macros.append(("SAMPLE_RATE_HZ", repr(1.0 / plan.time_step), "call the step so often"))
    if plan.direction == "inverse" and plan.delay > 0.0:
        macros.append(("READ_AHEAD_S", repr(plan.delay), "give the input this much earlier"))
    return macros


def first_output(plan: CascadePlan) -> float:
    """Return the output at B = 0 after a rest at the lower end."""
    y = float(through(plan.tail, np.array([plan.backlash.y0]))[0])
    if plan.limits is not None:
        y = min(max(y, plan.limits.v_min), plan.limits.v_max)
    return y


def settled_state(plan: CascadePlan, drive: float) -> ModelState:
    """Return the state of ``NAME_reset``: settled and at rest at a drive, in the model's own words."""
    inner = plan.inner_drive(drive)
    forward = plan.model.forward_backlash
    operator = plan.model._core
    start = operator.empty() if inner <= operator.x0 else operator.settled(inner)
    _, after, _ = forward.run([inner], start)
    memory = tuple(0.0 + (inner - plan.reference) for _ in range(plan.terms)) if plan.terms else None
    return ModelState(BacklashState(after.bits, memory), drive=inner)


def _vectors(plan: CascadePlan) -> list[Vectors]:
    model = plan.model
    quantity = model.input
    drive = model.output if model.direction == "inverse" else model.input
    trimmed = drive.minimum + 0.37 * drive.span
    empty, origin = plan.empty_state()
    states: list[tuple[str, str | None, ModelState]] = [
        ("after init", None, ModelState(empty, drive=origin)),
        ("after reset", hex_double(trimmed), settled_state(plan, trimmed)),
    ]
    found = []
    for seed, (label, reset, state) in enumerate(states, 1):
        moves = self_test_moves(quantity.minimum, quantity.maximum, seed)
        y = model.simulate(moves, state, time_step=plan.time_step, limits=plan.limits).y
        found.append(
            Vectors(label, reset, [hex_double(v) for v in moves], [hex_double(v) for v in y.tolist()])
        )
    return found
