"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export.c_frame import SourceParts, Vectors, delay_line
from dbo_cli.export.c_text import array, hex_double, struct_rows
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.dynamics_code import dynamics_parts, inverter_of, undone_moves
from dbo_cli.export.lag_code import Rest, lag_parts
from dbo_cli.export.self_test_moves import self_test_moves
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage, through
from dbo_cli.hysteresis.kernel import buffer_words
from dbo_cli.hysteresis.model import NEGLIGIBLE, ModelState, Quantity
from dbo_cli.hysteresis.operators import BacklashState

Floats = NDArray[np.float64]

IGNORED_BEYOND = 1e6
"""An input so many ranges beyond the model's counts as no number: what it leads to would not be finite."""


def ignored_beyond(source: Quantity) -> str:
    """Return the C constant beyond which an input counts as no number: a power of two, in decimals."""
    largest = IGNORED_BEYOND * max(source.span, abs(source.minimum), abs(source.maximum))
    return repr(2.0 ** min(math.ceil(math.log2(largest)), 126))


MOST_LOOKUP_GEARS = 12
"""2^12 states are 70 kB of table; one gear more doubles it."""


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
    return tables, "".join(f"{step}\n" for step in steps), segment


@dataclass(frozen=True)
class _Gears:
    """The gears' tables: their text and bytes, and the C of the state's start and of one step on ``x``."""

    tables: str
    size: int
    members: list[str]
    attach: str
    initialise: str
    settle: str
    step: str


def _operator(plan: CascadePlan, run: int) -> tuple[str, int]:
    """Return the gear table, one row a run, the terms and the operator, and their bytes."""
    gears, rows = plan.backlash, plan.backlash.gears[::run]
    text = array("dbo_gear", "gears", struct_rows([hex_double(v) for v in row] for row in rows))
    if plan.terms:
        text += array("double", "gain", [hex_double(v) for v in plan.gain])
        text += array("double", "decay", [hex_double(v) for v in plan.decay])
    return text + (
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, 1, DBO_ROW_FACTOR({run}),\n"
        f"    {hex_double(gears.x0)}, {hex_double(gears.y0)}, 1, {plan.terms}, {'gain' if plan.terms else 0},"
        f" {hex_double(plan.reference)}, {int(gears.memory_on == 'output')}}};\n"
    ), 32 * len(rows) + 16 * plan.terms


def _fixed_step(plan: CascadePlan, run: int) -> tuple[str, int]:
    """Return what the time step makes constant, as ``dbo_prepare_fixed_step`` computes it, and its bytes."""
    rows, kappa, rest = plan.backlash.gears[::run], 0.0, 1.0 - plan.decay
    if plan.backlash.memory_on == "output":
        for c, b in zip(plan.gain.tolist(), rest.tolist(), strict=True):
            kappa += c * b
    wide = rows[:, 0] + kappa * rows[:, 1]
    fixed = np.column_stack([wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3]])
    text = array("dbo_fixed_gear", "fixed_gears", struct_rows([hex_double(v) for v in row] for row in fixed))
    if plan.terms:
        text += array("double", "rest", [hex_double(v) for v in rest])
    names = "decay, rest" if plan.terms else "0, 0"
    text += f"static const dbo_fixed_step fixed = {{{hex_double(kappa)}, {names}, fixed_gears}};\n"
    return text, 24 * len(rows) + 8 * plan.terms


def _recursion(plan: CascadePlan, limits: str) -> _Gears:
    """Return the gears run by the package's kernel."""
    gears = plan.backlash
    text, size = _operator(plan, gears.equal_run)
    if plan.limits is not None or (plan.terms > 0 and gears.memory_on == "output"):
        more, extra = _fixed_step(plan, gears.equal_run)
        text, size = text + more, size + extra
        step = f"    x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, {limits}, 0);"
    else:
        step = f"    x = dbo_backlash_step(&op, &state->gears, x, {'decay' if plan.terms else '0'}, 0, 0);"
    words, spare, engage = buffer_words(gears.n), plan.spare_words(64), ""
    if spare:
        text += array("uint64_t", "spare", spare)
        engage = f"    for (size_t k = 0; k < {len(spare)}; k++) state->words[k] = spare[k];\n"
    memory = "state->memory" if plan.terms else "0"
    return _Gears(
        text, size, [f"uint64_t words[{words}];", "dbo_backlash_state gears;"],
        f"    state->gears.words = state->words;\n    state->gears.memory = {memory};\n",
        f"    for (size_t k = 0; k < {words}; k++) state->words[k] = 0;\n" + engage +
        "    dbo_backlash_load(&op, &state->gears);\n"
        f"    state->gears.last = {hex_double(plan.start_drive)};",
        f"    dbo_backlash_settle(&op, &state->gears, {plan.covered}, {'spare' if spare else '0'}, x);",
        step,
    )  # fmt: skip


def _lookup(plan: CascadePlan, limits: str) -> _Gears:
    """Return the gears as a table of all their states.

    Raises
    ------
    ModelError
        There are more than 12 gears: 2^13 states are 128 kB.
    """
    gears = plan.backlash
    if gears.n > MOST_LOOKUP_GEARS:
        raise ModelError(
            f"dx: {gears.n} gears are too many for a table of all states, {MOST_LOOKUP_GEARS} at most"
            f" (`gears` {MOST_LOOKUP_GEARS}, or without `lookup`)"
        )
    text, size = _operator(plan, 1)
    more, extra = _fixed_step(plan, 1)
    states = np.arange(2**gears.n)
    engaged = (states[:, None] >> np.arange(gears.n) & 1).astype(np.float64)
    corners = engaged @ gears.gears[:, :2]  # exact: the widths lie on one binary grid
    lowest = [gears.n, *((int(b) & -int(b)).bit_length() - 1 for b in states[1:])]
    more += array("dbo_corner", "corners", struct_rows([hex_double(v) for v in row] for row in corners))
    more += array("uint8_t", "lowest", [str(v) for v in lowest])
    more += "static const dbo_lookup lookup = {&op, &fixed, corners, lowest};\n"
    memory = "state->memory" if plan.terms else "0"
    return _Gears(
        text + more, size + extra + 17 * len(states), ["dbo_lookup_state gears;"],
        f"    state->gears.memory = {memory};\n",
        f"    state->gears.state = {plan.spare_bits}U;\n"
        f"    state->gears.last = {hex_double(plan.start_drive)};",
        f"    dbo_lookup_settle(&lookup, &state->gears, {plan.covered}U, {plan.spare_bits}U, x);",
        f"    x = dbo_lookup_step(&lookup, &state->gears, x, {limits});",
    )  # fmt: skip


def _limits(plan: CascadePlan) -> tuple[str, str]:
    """Return the limits' table and how to name them in a call."""
    inner = plan.inner_limits
    if inner is None:
        return "", "0"
    if plan.model.drive_lag is not None:
        return "", "&within"  # made anew for each sample (lag_code)
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


@dataclass(frozen=True)
class _Stages:
    """What stands around the gears: tables, their bytes, the steps before and behind, and a drive's way."""

    tables: str
    size: int
    before: str
    behind: str
    drive: str
    segments: int
    clip: str


def _stages(plan: CascadePlan) -> _Stages:
    """Return the memory-free stages; a drive given to reset passes them as far as the gears."""
    undone = tuple(stage.inverse() for stage in reversed(plan.tail))
    drives = plan.head if plan.direction == "forward" else undone
    tables, texts, segments = "", [], 0
    for label, stages in (("before", plan.head), ("behind", plan.tail), ("drive", drives)):
        more, steps, segments = stage_code(stages, label, segments)
        tables += more
        texts.append(steps)
    clip = ""
    if plan.limits is not None and plan.tail:
        low, high = hex_double(plan.limits.v_min), hex_double(plan.limits.v_max)
        clip = f"    x = x < {low} ? {low} : x > {high} ? {high} : x;\n"
    points = [s for s in (*plan.head, *plan.tail, *drives) if not isinstance(s, ScaleStage)]
    size = 24 * sum(stage.m for stage in points)
    return _Stages(tables, size, texts[0], texts[1], texts[2], segments, clip)


def double_parts(plan: CascadePlan, lookup: bool = False) -> tuple[SourceParts, int]:
    """Return the sources' parts in float64 and the bytes of the tables."""
    limit_text, limits = _limits(plan)
    gears = _lookup(plan, limits) if lookup else _recursion(plan, limits)
    stages, dynamics = _stages(plan), dynamics_parts(plan)
    memory = [f"double memory[{plan.terms}];"] if plan.terms else []
    step = stages.before + gears.step + "\n" + stages.behind + stages.clip
    lagging: tuple[str, ...] = ()
    tables, start, clear = gears.tables + limit_text + stages.tables + dynamics.tables, "", dynamics.clear
    size = gears.size + stages.size + dynamics.size
    if plan.model.drive_lag is not None:
        rest = Rest(stages.before, gears.step, stages.behind, stages.drive, [*gears.members, *memory])
        lag = lag_parts(plan, rest)
        step, lagging, start, clear = lag.step, lag.members, lag.start, clear + lag.clear
        tables, size = tables + lag.tables, size + lag.size
    members = [*gears.members, *dynamics.members, *lagging, *memory]
    if plan.terms:
        clear += f"    for (size_t k = 0; k < {plan.terms}; k++) state->memory[k] = 0;\n"
    if stages.segments:
        members.append(f"size_t segments[{stages.segments}];")
        clear += f"    for (size_t k = 0; k < {stages.segments}; k++) state->segments[k] = 0;\n"
    initialise = clear + gears.attach + gears.initialise
    step = (gears.attach + dynamics.before + step + dynamics.behind).rstrip("\n")
    if plan.direction == "forward" and plan.delay > 0.0:
        whole, part = _delay_samples(plan)
        lagged = f"later + {hex_double(part)} * (earlier - later)" if part else "later"
        more, empty, line = delay_line(whole, "double", lagged)
        members += more
        initialise, step = initialise + "\n" + empty, step + "\n" + line
    headers = ("dbo_lookup.h", lookup), ("dbo_dynamics.h", bool(dynamics.members or lagging))
    reach = ignored_beyond(plan.model.input)
    parts = SourceParts(
        number="double",
        tables=tables,
        members=members,
        initialise=initialise,
        start=stages.drive + gears.settle + start,
        step=step,
        lowest=f"-{reach}",
        highest=reach,
        first_output=hex_double(first_output(plan)),
        drive_is_output=plan.direction == "inverse",
        macros=common_macros(plan),
        vectors=_vectors(plan),
        kernel_headers=tuple(name for name, used in headers if used),
    )
    return parts, size


def common_macros(plan: CascadePlan) -> list[tuple[str, str, str]]:
    """Return what every header defines: the clock, and the delay that the caller must read ahead."""
    macros = []
    if plan.time_step is not None:
        macros.append(("SAMPLE_RATE_HZ", repr(1.0 / plan.time_step), "call the step so often"))
    ahead = read_ahead(plan)
    if ahead > 0.0:
        macros.append(("READ_AHEAD_S", repr(ahead), "give the input this much earlier"))
    return macros


def read_ahead(plan: CascadePlan) -> float:
    """Return how many seconds earlier an inverse needs its input: for its delay, and its dynamics."""
    if plan.direction == "forward":
        return 0.0
    inverter = inverter_of(plan)
    return plan.delay + (0.0 if inverter is None else inverter.ahead * inverter.time_step)


def first_output(plan: CascadePlan) -> float:
    """Return the output after a rest at the lower end, no covered gear engaged."""
    covered = plan.model._covered_gears.operator
    at = covered.x0 if plan.direction == "inverse" else covered.y0
    y = float(through(plan.tail, np.array([at]))[0])
    if plan.limits is not None:
        y = min(max(y, plan.limits.v_min), plan.limits.v_max)
    return y


def settled_state(plan: CascadePlan, drive: float) -> ModelState:
    """Return the state of ``NAME_reset``: settled and at rest at a drive, in the model's own words."""
    inner = plan.inner_drive(drive)
    forward = plan.model.forward_backlash
    covered = plan.model._covered_gears
    operator = covered.operator
    start = covered.whole(operator.empty() if inner <= operator.x0 else operator.settled(inner))
    _, after, _ = forward.run([inner], start)
    memory = tuple(0.0 + (inner - plan.reference) for _ in range(plan.terms)) if plan.terms else None
    lagging = None if plan.model.drive_lag is None else ((drive, 0.0, drive),)
    return ModelState(BacklashState(after.bits, memory), drive=inner, drive_lag=lagging)


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
        y = model.simulate(undone_moves(plan, moves), state, time_step=plan.time_step, limits=plan.limits).y
        found.append(
            Vectors(label, reset, [hex_double(v) for v in moves], [hex_double(v) for v in y.tolist()])
        )
    return found
