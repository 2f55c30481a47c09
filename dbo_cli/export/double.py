"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

Undoing dynamics and delay takes samples of the future: they are held back in windows,
so that an output belongs to the input of so many samples ago.
"""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan
from dbo_cli.model import Quantity, Scale
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
    forward = plan.forward
    kernel = ["dbo_kernel.h", "dbo_kernel.c"]
    sources = c.Sources(kernel, plan.runs(plan.empty), c.real, c.real)
    low, high = map(c.real, plan.limits.move)
    if plan.delay_part:
        kernel.append("dbo_interpolation.h")
        sources.tables += (
            "static const double times[DBO_WINDOW] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0};\n"
        )
        between = f"dbo_between(times, state->wanted, 2, {c.real(plan.delay_part)})"
        sources.add("delay.c", NUMBER="double", WINDOW="DBO_WINDOW", BETWEEN=between)
    if plan.undone:
        _undo_dynamics(plan, sources)
    sources.step += _curves(forward.tail.inverse, "before", sources)
    if forward.amplifier is not None:
        _limit_amplifier(plan, sources)
    sources.reset += _curves(forward.head, "drive", sources)
    if lookup:
        _look_gears_up(plan, sources)
    else:
        _drive_gears(plan, sources)
    to_drive = forward.head.inverse
    sources.step += _curves(to_drive, "behind", sources)
    if forward.amplifier is not None:
        sources.add("amplifier.c")
    if to_drive:  # rounding on the way back through the points
        sources.step.append(f"    x = x < {low} ? {low} : x > {high} ? {high} : x;")
    sources.values = {
        "FIRST_OUTPUT": c.real(plan.first_drive),
        "LEAST": low,
        "MOST": high,
        "REACH": _ignored_beyond(forward.output),
        "DRIVE_REACH": _ignored_beyond(forward.input),
    }
    return sources


def _ignored_beyond(quantity: Quantity) -> str:
    """Return the value beyond which a number counts as none: a power of two."""
    largest = max(quantity.span, abs(quantity.min), abs(quantity.max))
    return repr(2.0 ** math.ceil(math.log2(IGNORED_BEYOND * largest)))


# ---- the gears


def _add_operator(plan: Plan, sources: c.Sources, run: int) -> None:
    """Add the table of the gears, the operator, and the limits."""
    gears, terms = plan.gears, plan.gears.gain.size
    table, _ = kernel_table(gears.exchanged, run)
    sources.tables += c.array("dbo_gear", "gears", table, c.real)
    if terms:
        sources.tables += c.array("double", "gain", gears.gain, c.real)
    origin = f"{c.real(gears.y0)}, {c.real(gears.x0)}"
    gain = "gain" if terms else "0"
    sources.tables += (
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, DBO_ROW_FACTOR({run}), 0, 0, 0.0,\n"
        f"    {origin}, 1, {terms}, {gain}, {c.real(gears.reference)}, 1}};\n"
    )
    if plan.forward.amplifier is not None:
        return
    window, step = plan.inner
    largest = "0"
    if step is not None:
        largest = "&largest_step"
        sources.tables += f"static const double largest_step = {c.real(step)};\n"
    low, high = map(c.real, window)
    sources.tables += (
        f"static const dbo_limits limits = {{{low}, {high}, 0.0, {largest}, 0}};\n"
    )


def _drive_gears(plan: Plan, sources: c.Sources) -> None:
    """Add the gears, run by the package's kernel, and what a time step makes constant."""
    n, run, terms = plan.gears.n, plan.gears.equal_run, plan.gears.gain.size
    _add_operator(plan, sources, run)
    # as dbo_prepare_fixed_step computes it
    rows = kernel_table(plan.gears.exchanged, run)[0][:-1]
    wide = rows[:, 0] + plan.kappa * rows[:, 1]
    begins = rows[:, 4] + plan.kappa * rows[:, 5]
    steps = np.column_stack(
        [wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3], begins]
    )
    sources.tables += c.array("dbo_fixed_gear", "fixed_gears", steps, c.real)
    memory = "0, 0"
    if terms:
        memory = "decay, rest"
        sources.tables += c.array("double", "decay", plan.decay, c.real)
        sources.tables += c.array("double", "rest", 1.0 - plan.decay, c.real)
    sources.tables += (
        f"static const dbo_fixed_step fixed = {{{c.real(plan.kappa)}, {memory},"
        " fixed_gears, 0, 0.0};\n"
    )
    spare = c.words_of(plan.forward.starts.empty, n, 64)
    if spare:
        sources.tables += c.array("uint64_t", "spare", spare)
    step = "x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, &limits, 0);"
    if terms:
        sources.tables += c.array("double", "at_rest", np.zeros(terms), c.real)
        step = c.fill("first_step.c", {"STEP": step}).strip()
    # an amplifier has this mark itself
    is_marked = bool(terms) and plan.forward.amplifier is None
    sources.add(
        "gears.c",
        GEARS=str(n),
        CHECKPOINTS=str(plan.checkpoints or ""),
        CHECKPOINT_NAME="state->checkpoints" if plan.checkpoints else "0",
        TERMS=str(terms or ""),
        MEMORY_NAME="state->memory" if terms else "0",
        MARK="begun" if is_marked else "",
        SPARE="spare" if spare else "0",
        LAST=c.real(plan.forward.head.value(plan.first_drive)),
        INSIDE=str(plan.forward.starts.covered),
        STEP=step,
    )


def _look_gears_up(plan: Plan, sources: c.Sources) -> None:
    """Add the gears as a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears, or a memory beside them.
    """
    n, starts = plan.gears.n, plan.forward.starts
    if n > MOST_LOOKUP_GEARS:
        raise ModelError(
            f"{plan.key}.dx: {n} gears: `lookup` takes `gears` {MOST_LOOKUP_GEARS} at most"
        )
    if plan.gears.gain.size:
        raise ModelError(
            f"{plan.key}.relaxation: not possible with `lookup`: identify with `relaxation` 0"
        )
    _add_operator(plan, sources, 1)
    states = np.arange(2**n)
    engaged = (states[:, None] >> np.arange(n) & 1).astype(np.float64)
    # exact: the widths lie on one binary grid
    corners = engaged @ plan.gears.exchanged[:, :2]
    lowest = [n, *((state & -state).bit_length() - 1 for state in range(1, 2**n))]
    sources.tables += c.array("dbo_corner", "corners", corners, c.real)
    sources.tables += c.array("uint8_t", "lowest", lowest)
    sources.tables += "static const dbo_lookup lookup = {&op, corners, lowest};\n"
    sources.kernel += ["dbo_lookup.h", "dbo_lookup.c"]
    sources.add(
        "lookup.c",
        EMPTY=str(starts.empty),
        INSIDE=str(starts.covered),
        LAST=c.real(plan.forward.head.value(plan.first_drive)),
    )


# ---- the stages around them


def _curves(curves: Curves, label: str, sources: c.Sources) -> list[str]:
    """Add the tables of points; return the statements of points and scales on ``x``."""
    steps = []
    for number, stage in enumerate(curves):
        if isinstance(stage, Scale):
            steps.append(f"    x = {c.real(stage.gain)} * x + {c.real(stage.offset)};")
            continue
        name = f"{label}_{number}"
        sources.tables += c.array("dbo_segment", name, stage.segments, c.real)
        sources.add("points.c", NAME=name)
        begin = f"{stage.m}, {c.real(stage.x0)}, {c.real(stage.y0)}"
        steps.append(
            f"    x = dbo_point_step({name}, {begin}, &state->{name}_segment, x);"
        )
    return steps


def _limit_amplifier(plan: Plan, sources: c.Sources) -> None:
    """Add the window that the limits of the drive leave of the voltage at the gears."""
    amplifier, (low, high) = plan.forward.amplifier, plan.limits.move
    assert amplifier is not None and plan.dt is not None
    largest = plan.limits.largest_step(plan.dt)
    sources.add(
        "amplifier_limits.c",
        LEAST=c.real(low),
        MOST=c.real(high),
        SHARE=c.real(float(amplifier.share(plan.dt)[0])),
        STEP="" if largest is None else c.real(float(largest)),
        LOW_END="\n".join(_curves(plan.forward.head, "low", sources)),
        HIGH_END="\n".join(_curves(plan.forward.head, "high", sources)),
    )


def _undo_dynamics(plan: Plan, sources: c.Sources) -> None:
    """Undo the dynamics, the last section first, each with its window ahead."""
    sources.kernel += ["dbo_dynamics.h", "dbo_dynamics.c"]
    rows = []
    for number, inverse in enumerate(plan.undone):
        ahead, weights = inverse.weight.size, "0"
        if ahead:
            weights = f"weights_{number}"
            sources.tables += c.array("double", weights, inverse.weight, c.real)
        rows.append([*map(c.real, inverse.numbers), str(ahead), weights])
        places = {"AHEAD": str(ahead), "WINDOW": str(ahead + 1)}
        sources.add("section.c", PLACE=str(number), **places)
    sources.tables += c.array("dbo_section_inverse", "sections", rows)
    sources.add("dynamics.c", SECTIONS=str(len(rows)))
