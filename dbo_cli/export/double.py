"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

Undoing dynamics and delay takes samples of the future: they are held back in windows,
so that an output belongs to the input of so many samples ago.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan, ignored_beyond, trial_moves
from dbo_cli.model import Points, Scale
from dbo_cli.model.points import Curves
from dbo_cli.model.widths import kernel_table

Floats = NDArray[np.float64]

MOST_LOOKUP_GEARS = 12
"""2^12 states are 70 kB of table; one gear more doubles it."""
SPACING = 64  # turns that share a checkpoint, as in dbo_kernel.h


class _Parts:
    """Tables, members and steps, as the stages of a plan add them."""

    def __init__(self) -> None:
        self.kernel: list[str] = []
        self.members: list[str] = []
        self.tables: list[str] = []
        self.init: list[str] = []
        self.reset: list[str] = []
        self.step: list[str] = []


def double_sources(plan: Plan, lookup: bool) -> c.Sources:
    """Return the model as C in float64; with ``lookup`` the gears are a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears for such a table.
    """
    parts = _Parts()
    if lookup:
        _lookup_gears(plan, parts)
    else:
        _gears(plan, parts)
    low, high = plan.limits.move
    undoing = _undo_delay(plan, parts) + _undo_dynamics(plan, parts)
    before = _curves(plan.model.head, "before", parts)
    behind = _curves(plan.model.tail, "behind", parts)
    drive = _curves(plan.drive_curves, "drive", parts)
    if plan.model.tail:  # rounding on the way back through the points
        behind += f"    x = x < {c.real(low)} ? {c.real(low)} : x > {c.real(high)} ? {c.real(high)} : x;\n"
    begin = parts.step.pop(0)
    values = {
        "TABLES": "".join(parts.tables),
        "INIT": "".join(parts.init).rstrip("\n"),
        "RESET": (drive + "".join(parts.reset)).rstrip("\n"),
        "STEP": (begin + undoing + before + "".join(parts.step) + behind).rstrip("\n"),
        "FIRST_OUTPUT": c.real(plan.first_drive),
        "LEAST": c.real(low),
        "MOST": c.real(high),
        "REACH": repr(ignored_beyond(plan.model.input)),
        "DRIVE_REACH": repr(ignored_beyond(plan.model.output)),
    }
    return c.Sources(values, parts.members, parts.kernel, _runs(plan))


# ---- the gears


def _tables(plan: Plan, parts: _Parts, run: int) -> None:
    """Add the table of the gears, the operator, what a fixed step makes constant, and the limits."""
    gears, terms = plan.gears, plan.gain.size
    table, _ = kernel_table(gears.table, run)
    parts.tables.append(c.array("dbo_gear", "gears", c.real_structs(table)))
    gain = "0"
    if terms:
        gain = "gain"
        parts.tables.append(c.reals("gain", plan.gain))
        parts.tables.append(c.reals("at_rest", np.zeros(terms)))
    parts.tables.append(
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, DBO_ROW_FACTOR({run}), 0, 0, 0.0,\n"
        f"    {c.real(gears.x0)}, {c.real(gears.y0)}, 1, {terms}, {gain}, {c.real(plan.reference)}, 1}};\n"
    )
    _fixed_step(parts, plan, table, "fixed", plan.decay)
    inner, step, largest = plan.inner, plan.inner_step, "0"
    if step is not None:
        largest = "&largest_step"
        parts.tables.append(f"static const double largest_step = {c.real(step)};\n")
    ends = f"{c.real(inner.low)}, {c.real(inner.high)}"
    parts.tables.append(
        f"static const dbo_limits limits = {{{ends}, 0.0, {largest}, 0}};\n"
    )


def _fixed_step(
    parts: _Parts, plan: Plan, table: Floats, name: str, decay: Floats
) -> None:
    """Add what a time step makes constant, as dbo_prepare_fixed_step computes it."""
    kappa = plan.kappa(decay)
    rows = table[:-1]
    wide = rows[:, 0] + kappa * rows[:, 1]
    begins = rows[:, 4] + kappa * rows[:, 5]
    steps = np.column_stack(
        [wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3], begins]
    )
    parts.tables.append(
        c.array("dbo_fixed_gear", f"{name}_gears", c.real_structs(steps))
    )
    decays = rests = "0"
    if decay.size and name == "fixed":
        decays, rests = "decay", "rest"
        parts.tables.append(c.reals("decay", decay))
        parts.tables.append(c.reals("rest", 1.0 - decay))
    elif decay.size:
        decays, rests = "at_rest", "all_of_it"
    parts.tables.append(
        f"static const dbo_fixed_step {name} = {{{c.real(kappa)}, {decays}, {rests},\n"
        f"    {name}_gears, 0, 0.0}};\n"
    )


def _memory(plan: Plan, parts: _Parts) -> str:
    """Add what relaxation remembers; return the statement that points a state, perhaps a copy, to it."""
    terms = plan.gain.size
    if not terms:
        return "    state->gears.memory = 0;\n"
    parts.members += [f"double memory[{terms}];", "int begun;"]
    parts.init.append(
        f"    for (size_t k = 0; k < {terms}; k++) state->memory[k] = 0.0;\n"
        "    state->begun = 0;\n"
    )
    parts.reset.append("    state->begun = 1;\n")
    return "    state->gears.memory = state->memory;\n"


def _gears(plan: Plan, parts: _Parts) -> None:
    """Add the gears, run by the package's kernel."""
    n = plan.gears.n
    _tables(plan, parts, plan.gears.equal_run)
    spare = c.words_of(plan.starts.empty, n, 64)
    if spare:
        parts.tables.append(c.array("uint64_t", "spare", spare))
    words = "spare" if spare else "0"
    parts.kernel = ["dbo_kernel.h", "dbo_kernel.c"]
    checkpoints = (n - 1) // SPACING
    pointed = "    state->gears.turns = state->turns;\n"
    pointed += f"    state->gears.checkpoints = {'state->checkpoints' if checkpoints else '0'};\n"
    if checkpoints:
        parts.members.append(f"dbo_checkpoint checkpoints[{checkpoints}];")
    parts.members.append("dbo_backlash_state gears;")
    pointed += _memory(plan, parts)
    parts.members.append(f"dbo_place turns[{n}];")
    parts.init.append(
        f"{pointed}    dbo_backlash_load(&op, &state->gears, {words});\n"
        f"    state->gears.last = {c.real(plan.at_gears(plan.first_drive))};\n"
    )
    parts.reset.append(
        f"    dbo_backlash_settle(&op, &state->gears, {plan.starts.moved.n}, {words}, x);\n"
    )
    step = "x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, &limits, 0);\n"
    first = "x = dbo_backlash_step(&op, &state->gears, x, at_rest, &limits, 0);\n"
    parts.step = [pointed, _at_rest_first(plan, first, step)]


def _at_rest_first(plan: Plan, first: str, step: str) -> str:
    """Return a step of which the first, with a memory, finds the actuator at rest."""
    if not plan.gain.size:
        return f"    {step}"
    return f"    if (state->begun) {step.rstrip()}\n    else {first}    state->begun = 1;\n"


def _lookup_gears(plan: Plan, parts: _Parts) -> None:
    """Add the gears as a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears.
    """
    n, terms = plan.gears.n, plan.gain.size
    if n > MOST_LOOKUP_GEARS:
        raise ModelError(
            f"dx: {n} gears are too many for a table of all states, {MOST_LOOKUP_GEARS} at most"
            f" (`gears` {MOST_LOOKUP_GEARS}, or without `lookup`)"
        )
    _tables(plan, parts, 1)
    states = np.arange(2**n)
    engaged = (states[:, None] >> np.arange(n) & 1).astype(np.float64)
    # exact: the widths lie on one binary grid
    corners = engaged @ plan.gears.table[:, :2]
    lowest = [str(n)]
    for state in range(1, 2**n):
        lowest.append(str((state & -state).bit_length() - 1))
    parts.tables.append(c.array("dbo_corner", "corners", c.real_structs(corners)))
    parts.tables.append(c.array("uint8_t", "lowest", lowest))
    parts.tables.append(
        "static const dbo_lookup lookup = {&op, &fixed, corners, lowest};\n"
    )
    parts.kernel = [
        "dbo_lookup.h",
        "dbo_lookup.c",
        "dbo_kernel.h",
        "dbo_kernel.c",
    ]
    parts.members.append("dbo_lookup_state gears;")
    pointed = _memory(plan, parts)
    if terms:
        table, _ = kernel_table(plan.gears.table, 1)
        parts.tables.append(c.reals("all_of_it", np.ones(terms)))
        _fixed_step(parts, plan, table, "resting", np.zeros(terms))
        parts.tables.append(
            "static const dbo_lookup resting_lookup = {&op, &resting, corners, lowest};\n"
        )
    parts.init.append(
        f"{pointed}    state->gears.state = {plan.starts.empty}U;\n"
        f"    state->gears.last = {c.real(plan.at_gears(plan.first_drive))};\n"
    )
    covered = f"{plan.starts.moved.n}U, {plan.starts.empty}U"
    parts.reset.append(
        f"    dbo_lookup_settle(&lookup, &state->gears, {covered}, x);\n"
    )
    step = "x = dbo_lookup_step(&lookup, &state->gears, x, &limits);\n"
    first = "x = dbo_lookup_step(&resting_lookup, &state->gears, x, &limits);\n"
    parts.step = [pointed, _at_rest_first(plan, first, step)]


# ---- the stages around them


def _curves(curves: Curves, label: str, parts: _Parts) -> str:
    """Add the tables of points; return the statements of points and scales on ``x``."""
    steps = ""
    for number, stage in enumerate(curves):
        if isinstance(stage, Scale):
            steps += f"    x = {c.real(stage.gain)} * x + {c.real(stage.offset)};\n"
            continue
        assert isinstance(stage, Points)
        name = f"{label}_{number}"
        rows = c.real_structs(stage.segments)
        parts.tables.append(c.array("dbo_segment", name, rows))
        parts.members.append(f"size_t {name}_segment;")
        parts.init.append(f"    state->{name}_segment = 0;\n")
        steps += (
            f"    x = dbo_point_step({name}, {stage.m}, {c.real(stage.x0)}, {c.real(stage.y0)},\n"
            f"                       &state->{name}_segment, x);\n"
        )
    return steps


def _undo_delay(plan: Plan, parts: _Parts) -> str:
    """Return the statements that read ahead by the part of a sample that a delay has beyond whole ones."""
    _, part = plan.delay_samples
    if not part:
        return ""
    parts.kernel.append("dbo_interpolation.h")
    parts.members.append("double wanted[DBO_WINDOW];")
    parts.members.append("int waiting;")
    parts.init.append("    state->waiting = 1;\n")
    return (
        "    for (int k = 0; k < DBO_WINDOW; k++) /* at rest before the first sample */\n"
        "        state->wanted[k] = state->waiting || k == DBO_WINDOW - 1 ? x : state->wanted[k + 1];\n"
        "    state->waiting = 0;\n"
        "    {\n"
        "        static const double times[DBO_WINDOW] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0};\n"
        f"        x = dbo_between(times, state->wanted, 2, {c.real(part)});\n"
        "    }\n"
    )


def _undo_dynamics(plan: Plan, parts: _Parts) -> str:
    """Return the statements that undo the dynamics, the last section first, each with its window ahead."""
    if not plan.undone:
        return ""
    parts.kernel += ["dbo_dynamics.h", "dbo_dynamics.c"]
    rows, begin, steps = [], "", ""
    for number, part in enumerate(plan.undone):
        ahead = part.weight.size
        weights, window = "0", f"state->window_{number}"
        if ahead:
            weights = f"weights_{number}"
            parts.tables.append(c.reals(weights, part.weight))
            steps += f"    for (size_t k = 0; k < {ahead}; k++) {window}[k] = {window}[k + 1];\n"
        numbers = [c.real(value) for value in part.numbers]
        rows.append([*numbers, str(ahead), weights])
        parts.members.append(f"double window_{number}[{ahead + 1}];")
        begin += f"        for (size_t k = 0; k < {ahead + 1}; k++) {window}[k] = x;\n"
        begin += f"        state->sections[{number}].y = x;\n"
        begin += f"        state->sections[{number}].a = state->sections[{number}].b = 0.0;\n"
        steps += f"    {window}[{ahead}] = x;\n"
        steps += f"    dbo_dynamics_undo(&sections[{number}], &state->sections[{number}], {window}, &x, 1);\n"
    parts.tables.append(c.array("dbo_section_inverse", "sections", c.structs(rows)))
    parts.members.append(f"dbo_inverse_state sections[{len(rows)}];")
    parts.members.append("int moving;")
    parts.init.append("    state->moving = 0;\n")
    at_rest = "    if (!state->moving) { /* at rest before the first sample */\n"
    return f"{at_rest}{begin}        state->moving = 1;\n    }}\n{steps}"


def _runs(plan: Plan) -> list[c.Run]:
    """Return two runs of the self-test, as the library computes them: after init, and after reset."""
    source = plan.model.input
    runs = []
    for seed, reset in enumerate((None, plan.trimmed), 1):
        moves = trial_moves(source.min, source.max, seed)
        state, start = plan.empty, None
        if reset is not None:
            state, start = plan.settled(reset), c.real(reset)
        outputs = plan.played(moves, state)
        runs.append(
            c.Run(start, [c.real(x) for x in moves], [c.real(y) for y in outputs])
        )
    return runs
