"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

Undoing dynamics and delay takes samples of the future: they are held back in windows,
so that an output belongs to the input of so many samples ago.
"""

import math

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.export import text as c
from dbo_cli.export.plan import Plan
from dbo_cli.model import Quantity, Scale
from dbo_cli.model.gears import kernel_table
from dbo_cli.model.points import Curve

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
    forward, starts = plan.forward, plan.forward.starts
    before, behind = forward.tail.inverse, forward.head.inverse
    curves = [*before, *forward.head, *behind]
    low, high = map(c.real, plan.limits.move)
    numbers = {
        "FIRST_DRIVE": c.real(plan.first_drive),
        "FIRST_AT_GEARS": c.real(forward.head.value(plan.first_drive)),
        "LOW": low,
        "HIGH": high,
        "REACH": _ignored_beyond(forward.output),
        "DRIVE_REACH": _ignored_beyond(forward.input),
        "COVERED": f"{starts.covered}U",
        "TO_GEARS": str(len(before)),
        "TO_DRIVE": str(len(curves) - len(behind)),
        "CURVES": str(len(curves)),
        "TERMS": str(plan.gears.gain.size),
    }
    kernel = ["dbo_kernel.h", "dbo_kernel.c"]
    tables = _curves(curves)
    sizes = {"CURVES": str(len(curves) or 1), "GEARS_STATE": "dbo_lookup_state"}
    if plan.delay_part:
        kernel.append("dbo_interpolation.h")
        tables += c.array("double", "times", range(6), c.real)
        numbers["DELAY_WINDOW"] = sizes["DELAY_WINDOW"] = "DBO_WINDOW"
        numbers["DELAY_PART"] = c.real(plan.delay_part)
    if plan.undone:
        kernel += ["dbo_dynamics.h", "dbo_dynamics.c"]
        tables += _sections(plan)
        numbers["SECTIONS"] = sizes["SECTIONS"] = str(len(plan.undone))
        windows = sum(inverse.weight.size + 1 for inverse in plan.undone)
        sizes["WINDOWS"] = str(windows)
    if forward.amplifier is not None:
        change = plan.limits.largest_step(plan.dt)
        assert plan.dt is not None
        numbers["AMPLIFIER"] = c.real(float(forward.amplifier.share(plan.dt)[0]))
        numbers["CHANGE"] = c.real(1e300 if change is None else float(change))
    if lookup:
        kernel += ["dbo_lookup.h", "dbo_lookup.c"]
        tables += _operator(plan, 1) + _lookup_table(plan)
        numbers |= {"LOOKUP": "1", "SPARE": f"{starts.empty}U"}
    else:
        tables += _operator(plan, plan.gears.equal_run) + _fixed_step(plan)
        text, numbers["SPARE"] = c.spare(starts.empty, plan.gears.n, 64)
        tables += text
        sizes |= plan.sizes | {"GEARS_STATE": "dbo_backlash_state"}
    runs = plan.runs(plan.empty)
    return c.Sources(kernel, runs, c.real, c.real, tables, numbers, sizes)


def _ignored_beyond(quantity: Quantity) -> str:
    """Return the value beyond which a number counts as none: a power of two."""
    largest = max(quantity.span, abs(quantity.min), abs(quantity.max))
    return repr(2.0 ** math.ceil(math.log2(IGNORED_BEYOND * largest)))


def _curves(curves: list[Curve]) -> str:
    """Return the table of points and scales, in the order in which a signal passes them."""
    text, rows = "", []
    for number, stage in enumerate(curves):
        if isinstance(stage, Scale):
            rows.append(["0", "0", c.real(stage.gain), c.real(stage.offset)])
            continue
        name = f"points_{number}"
        text += c.array("dbo_segment", name, stage.segments, c.real)
        rows.append(
            [name, str(len(stage.segments)), c.real(stage.x0), c.real(stage.y0)]
        )
    return text + c.array("curve", "curves", rows or [["0", "0", "0.0", "0.0"]])


def _sections(plan: Plan) -> str:
    """Return the tables of what undoes the dynamics, the last section first."""
    text, rows = "", []
    for number, inverse in enumerate(plan.undone):
        ahead, weights = inverse.weight.size, "0"
        if ahead:
            weights = f"weights_{number}"
            text += c.array("double", weights, inverse.weight, c.real)
        rows.append([*map(c.real, inverse.numbers), str(ahead), weights])
    return text + c.array("dbo_section_inverse", "sections", rows)


def _operator(plan: Plan, run: int) -> str:
    """Return the table of the gears, a row for each ``run`` of them, the operator, and the limits."""
    gears = plan.gears
    table, _ = kernel_table(gears.exchanged, run)
    text = c.array("dbo_gear", "gears", table, c.real)
    text += c.array("double", "gain", [*gears.gain, 0.0], c.real)
    origin = f"{c.real(gears.y0)}, {c.real(gears.x0)}"
    text += (
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, DBO_ROW_FACTOR({run}), 0, 0, 0.0,\n"
        f"    {origin}, 1, TERMS, gain, {c.real(gears.reference)}, 1}};\n"
    )
    if plan.forward.amplifier is not None:  # the step works them out
        return text
    largest = "0"
    if plan.step is not None:
        largest = "&largest_step"
        text += f"static const double largest_step = {c.real(plan.step)};\n"
    low, high = map(c.real, plan.window)
    return (
        text
        + f"static const dbo_limits limits = {{{low}, {high}, 0.0, {largest}, 0}};\n"
    )


def _fixed_step(plan: Plan) -> str:
    """Return what a time step makes constant, as dbo_prepare_fixed_step computes it."""
    rows = kernel_table(plan.gears.exchanged, plan.gears.equal_run)[0][:-1]
    wide = rows[:, 0] + plan.kappa * rows[:, 1]
    begins = rows[:, 4] + plan.kappa * rows[:, 5]
    steps = np.column_stack(
        [wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3], begins]
    )
    text = c.array("dbo_fixed_gear", "fixed_gears", steps, c.real)
    factors = {
        "decay": plan.decay,
        "rest": 1.0 - plan.decay,
        "at_rest": 0.0 * plan.decay,
    }
    for name, values in factors.items():
        text += c.array("double", name, [*values, 0.0], c.real)
    kappa = c.real(plan.kappa)
    return (
        text
        + f"static const dbo_fixed_step fixed = {{{kappa}, decay, rest, fixed_gears, 0, 0.0}};\n"
    )


def _lookup_table(plan: Plan) -> str:
    """Return the table of all states of the gears (ModelError: too many, or a memory beside them)."""
    n = plan.gears.n
    if n > MOST_LOOKUP_GEARS or plan.gears.gain.size:
        raise ModelError(
            f"{plan.key}: `lookup` takes `gears` {MOST_LOOKUP_GEARS} at most, and no relaxation (identify "
            "with `relaxation` 0)"
        )
    states = np.arange(2**n)
    engaged = (states[:, None] >> np.arange(n) & 1).astype(np.float64)
    # exact: the widths lie on one binary grid
    corners = engaged @ plan.gears.exchanged[:, :2]
    lowest = [n, *((state & -state).bit_length() - 1 for state in range(1, 2**n))]
    text = c.array("dbo_corner", "corners", corners, c.real)
    text += c.array("uint8_t", "lowest", map(str, lowest))
    return text + "static const dbo_lookup lookup = {&op, corners, lowest};\n"
