"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

Undoing dynamics and delay takes samples of the future: they are held back in windows,
so that an output belongs to the input of so many samples ago.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan, trial_moves
from dbo_cli.model import Points, Quantity, Scale
from dbo_cli.model.points import Curves
from dbo_cli.model.widths import kernel_table

MOST_LOOKUP_GEARS = 12
"""2^12 states are 70 kB of table; one gear more doubles it."""
IGNORED_BEYOND = 1e6
"""Ranges: an input so far away counts as no number; what it leads to is not finite."""


def double_sources(plan: Plan, lookup: bool) -> c.Sources:
    """Return the model as C in float64; with ``lookup`` the gears are a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears for such a table, or a memory beside them.
    """
    parts = c.Sources(["dbo_kernel.h", "dbo_kernel.c"])
    low, high = plan.limits.move
    _undo_delay(plan, parts)
    _undo_dynamics(plan, parts)
    parts.step += _curves(plan.forward.tail.inverse(), "before", parts)
    if plan.forward.amplifier is not None:
        parts.reset += ["state->amplifier = x;", "state->begun = 1;"]
        _limit_amplifier(plan, parts)
    parts.reset += _curves(plan.forward.head, "drive", parts)
    if lookup:
        _lookup_gears(plan, parts)
    else:
        _gears(plan, parts)
    to_drive = plan.forward.head.inverse()
    parts.step += _curves(to_drive, "behind", parts)
    if plan.forward.amplifier is not None:
        parts.step.append(c.fill("amplifier.c", {}).rstrip("\n"))
    lowest, highest = c.real(low), c.real(high)
    if to_drive:  # rounding on the way back through the points
        parts.step.append(
            f"x = x < {lowest} ? {lowest} : x > {highest} ? {highest} : x;"
        )
    parts.values = {
        "TABLES": "".join(parts.tables),
        "INIT": _statements(parts.init),
        "RESET": _statements(parts.reset),
        "STEP": _statements(parts.step),
        "FIRST_OUTPUT": c.real(plan.first_drive),
        "LEAST": lowest,
        "MOST": highest,
        "REACH": repr(_ignored_beyond(plan.forward.output)),
        "DRIVE_REACH": repr(_ignored_beyond(plan.forward.input)),
    }
    parts.runs = [_run(plan, None, 1), _run(plan, plan.trimmed, 2)]
    return parts


def _statements(lines: list[str]) -> str:
    """Return statements, a line each; those of a template have their indent."""
    return "\n".join(line if line[0] == " " else f"    {line}" for line in lines)


def _ignored_beyond(quantity: Quantity) -> float:
    """Return the value beyond which a number counts as none: a power of two."""
    largest = max(quantity.span, abs(quantity.min), abs(quantity.max))
    return float(2.0 ** math.ceil(math.log2(IGNORED_BEYOND * largest)))


def _run(plan: Plan, reset: float | None, seed: int) -> c.SelfTestRun:
    """Return a run of the self-test, as the library computes it."""
    moves = trial_moves(plan.forward.output.min, plan.forward.output.max, seed)
    state, start = plan.empty, None
    if reset is not None:
        state, start = plan.settled(reset), c.real(reset)
    outputs = plan.played(moves, state)
    return c.SelfTestRun(
        start, [c.real(x) for x in moves], [c.real(y) for y in outputs]
    )


# ---- the gears


def _operator(plan: Plan, parts: c.Sources, run: int) -> None:
    """Add the table of the gears, the operator, and the limits."""
    gears, terms = plan.gears, plan.gears.gain.size
    table, _ = kernel_table(gears.exchanged, run)
    parts.tables.append(c.array("dbo_gear", "gears", c.structs(table, c.real)))
    gain = "0"
    if terms:
        gain = "gain"
        parts.tables.append(c.reals("gain", plan.gears.gain))
    parts.tables.append(
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, DBO_ROW_FACTOR({run}), 0, 0, 0.0,\n"
        f"    {c.real(gears.y0)}, {c.real(gears.x0)}, 1, {terms}, {gain}, {c.real(gears.reference)}, 1}};\n"
    )
    ends = ", ".join(map(c.real, plan.inner))
    largest = "0"
    if plan.inner_step is not None and plan.forward.amplifier is None:
        largest = "&largest_step"
        step = c.real(plan.inner_step)
        parts.tables.append(f"static const double largest_step = {step};\n")
    if plan.forward.amplifier is None:
        parts.tables.append(
            f"static const dbo_limits limits = {{{ends}, 0.0, {largest}, 0}};\n"
        )


def _fixed_step(plan: Plan, parts: c.Sources, run: int) -> None:
    """Add what the time step makes constant, as dbo_prepare_fixed_step computes it."""
    rows = kernel_table(plan.gears.exchanged, run)[0][:-1]
    wide = rows[:, 0] + plan.kappa * rows[:, 1]
    begins = rows[:, 4] + plan.kappa * rows[:, 5]
    steps = np.column_stack(
        [wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3], begins]
    )
    parts.tables.append(
        c.array("dbo_fixed_gear", "fixed_gears", c.structs(steps, c.real))
    )
    decay = complement = "0"
    if plan.gears.gain.size:
        decay, complement = "decay", "rest"
        parts.tables.append(c.reals("decay", plan.decay))
        parts.tables.append(c.reals("rest", 1.0 - plan.decay))
    parts.tables.append(
        f"static const dbo_fixed_step fixed = {{{c.real(plan.kappa)}, {decay}, {complement},"
        " fixed_gears, 0, 0.0};\n"
    )


def _gears(plan: Plan, parts: c.Sources) -> None:
    """Add the gears, run by the package's kernel."""
    n, run, terms = plan.gears.n, plan.gears.equal_run, plan.gears.gain.size
    _operator(plan, parts, run)
    _fixed_step(plan, parts, run)
    words = "0"
    spare = c.words_of(plan.forward.starts.empty, n, 64)
    if spare:
        words = "spare"
        parts.tables.append(c.array("uint64_t", "spare", spare))
    checkpoints, memory = "0", "0"
    if plan.checkpoints:
        checkpoints = "state->checkpoints"
        parts.members.append(f"dbo_checkpoint checkpoints[{plan.checkpoints}];")
    parts.members += ["dbo_backlash_state gears;", f"dbo_place turns[{n}];"]
    step = "x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, &limits, 0);"
    if terms:
        memory = "state->memory"
        parts.tables.append(c.reals("at_rest", np.zeros(terms)))
        parts.members.append(f"double memory[{terms}];")
        parts.init.append(f"for (int k = 0; k < {terms}; k++) state->memory[k] = 0.0;")
        if plan.forward.amplifier is None:
            parts.members.append("int begun;")
            parts.init.append("state->begun = 0;")
            parts.reset.append("state->begun = 1;")
        first = "x = dbo_backlash_step(&op, &state->gears, x, at_rest, &limits, 0);"
        step = f"if (state->begun) {step}\n    else {first}\n    state->begun = 1;"
    pointers = [  # a state may be a copy of another
        "state->gears.turns = state->turns;",
        f"state->gears.checkpoints = {checkpoints};",
        f"state->gears.memory = {memory};",
    ]
    parts.init += [
        *pointers,
        f"dbo_backlash_load(&op, &state->gears, {words});",
        f"state->gears.last = {c.real(plan.forward.head.value(plan.first_drive))};",
    ]
    inside = plan.forward.starts.inside.n
    parts.reset.append(
        f"dbo_backlash_settle(&op, &state->gears, {inside}, {words}, x);"
    )
    parts.step += [*pointers, step]


def _lookup_gears(plan: Plan, parts: c.Sources) -> None:
    """Add the gears as a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears, or a memory beside them.
    """
    n, empty = plan.gears.n, plan.forward.starts.empty
    if n > MOST_LOOKUP_GEARS:
        raise ModelError(
            f"{plan.key}.dx: {n} gears: `lookup` takes `gears` {MOST_LOOKUP_GEARS} at most"
        )
    if plan.gears.gain.size:
        raise ModelError(
            f"{plan.key}.relaxation: not possible with `lookup`: identify with `relaxation` 0"
        )
    _operator(plan, parts, 1)
    states = np.arange(2**n)
    engaged = (states[:, None] >> np.arange(n) & 1).astype(np.float64)
    # exact: the widths lie on one binary grid
    corners = engaged @ plan.gears.exchanged[:, :2]
    lowest = [str(n)]
    for state in range(1, 2**n):
        lowest.append(str((state & -state).bit_length() - 1))
    parts.tables.append(c.array("dbo_corner", "corners", c.structs(corners, c.real)))
    parts.tables.append(c.array("uint8_t", "lowest", lowest))
    parts.tables.append("static const dbo_lookup lookup = {&op, corners, lowest};\n")
    parts.kernel += ["dbo_lookup.h", "dbo_lookup.c"]
    parts.members.append("dbo_lookup_state gears;")
    first = c.real(plan.forward.head.value(plan.first_drive))
    parts.init += [
        f"state->gears.state = {empty}U;",
        f"state->gears.last = {first};",
    ]
    covered = f"{plan.forward.starts.inside.n}U, {empty}U"
    parts.reset.append(f"dbo_lookup_settle(&lookup, &state->gears, {covered}, x);")
    parts.step.append("x = dbo_lookup_step(&lookup, &state->gears, x, &limits);")


# ---- the stages around them


def _curves(curves: Curves, label: str, parts: c.Sources) -> list[str]:
    """Add the tables of points; return the statements of points and scales on ``x``."""
    steps = []
    for number, stage in enumerate(curves):
        if isinstance(stage, Scale):
            steps.append(f"x = {c.real(stage.gain)} * x + {c.real(stage.offset)};")
            continue
        assert isinstance(stage, Points)
        name = f"{label}_{number}"
        rows = c.structs(stage.segments, c.real)
        parts.tables.append(c.array("dbo_segment", name, rows))
        parts.members.append(f"size_t {name}_segment;")
        parts.init.append(f"state->{name}_segment = 0;")
        begin = f"{stage.m}, {c.real(stage.x0)}, {c.real(stage.y0)}"
        steps.append(f"x = dbo_point_step({name}, {begin}, &state->{name}_segment, x);")
    return steps


def _limit_amplifier(plan: Plan, parts: c.Sources) -> None:
    """Add the window that the limits of the drive leave of the voltage at the gears."""
    amplifier = plan.forward.amplifier
    assert amplifier is not None and plan.dt is not None
    parts.members += ["double amplifier;", "int begun;"]
    parts.init += ["state->amplifier = 0.0;", "state->begun = 0;"]
    low, high = plan.limits.move
    slew = ""
    largest = plan.limits.largest_step(plan.dt)
    if largest is not None:
        step = c.real(float(largest))
        slew = c.fill("amplifier_slew.c", {"STEP": step}).rstrip("\n")
    values = {
        "LEAST": c.real(low),
        "MOST": c.real(high),
        "SHARE": c.real(float(amplifier.share(plan.dt)[0])),
        "SLEW": slew,
        "LOW_END": _statements(_curves(plan.forward.head, "low", parts)),
        "HIGH_END": _statements(_curves(plan.forward.head, "high", parts)),
    }
    parts.step.append(c.fill("amplifier_limits.c", values).rstrip("\n"))


def _undo_delay(plan: Plan, parts: c.Sources) -> None:
    """Read ahead by the part of a sample that a delay has beyond whole ones."""
    fraction = plan.delay_samples[1]
    if not fraction:
        return
    parts.kernel.append("dbo_interpolation.h")
    parts.members += ["double wanted[DBO_WINDOW];", "int waiting;"]
    parts.init.append("state->waiting = 1;")
    parts.step.append(c.fill("delay.c", {"PART": c.real(fraction)}).rstrip("\n"))


def _undo_dynamics(plan: Plan, parts: c.Sources) -> None:
    """Undo the dynamics, the last section first, each with its window ahead."""
    if not plan.undone:
        return
    parts.kernel += ["dbo_dynamics.h", "dbo_dynamics.c"]
    rows = []
    for number, inverse in enumerate(plan.undone):
        ahead, weights = inverse.weight.size, "0"
        if ahead:
            weights = f"weights_{number}"
            parts.tables.append(c.reals(weights, inverse.weight))
        numbers = [c.real(value) for value in inverse.numbers]
        rows.append([*numbers, str(ahead), weights])
        parts.members.append(f"double window_{number}[{ahead + 1}];")
        statements = c.fill("section.c", {"PLACE": str(number), "AHEAD": str(ahead)})
        parts.step.append(statements.rstrip("\n"))
    parts.tables.append(c.array("dbo_section_inverse", "sections", c.structs(rows)))
    parts.members += [f"dbo_inverse_state sections[{len(rows)}];", "int moving;"]
    parts.init.append("state->moving = 0;")
    parts.step.append("state->moving = 1;")
