"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

A forward export passes its output through the dynamics. An inverse undoes them on what is wanted, for which
it must know some samples of the future: it holds them back in a window, so that its output belongs to the
input of that many samples ago.

With a lag before the gears, an inverse asks what drive the lag makes of what its other stages wish for; where
the limits forbid that drive, the sample is done again with what they leave, so that the gears see what the
actuator is driven by. It is what ``hysteresis.drive_lag`` does, as C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.export.cascade_plan import CascadePlan, ignored_beyond, self_test_moves
from dbo_cli.export.source_text import (
    ModelCode,
    Vectors,
    array,
    declared,
    delay_line,
    double_rows,
    fill,
    hex_double,
    struct_rows,
)
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.kernel import buffer_words
from dbo_cli.hysteresis.model import NEGLIGIBLE

Floats = NDArray[np.float64]

MOST_LOOKUP_GEARS = 12
"""2^12 states are 70 kB of table; one gear more doubles it."""


@dataclass
class _Parts:
    """What the stages of a plan put into the sources: tables and their bytes, members, and steps on ``x``."""

    tables: str = ""
    size: int = 0
    members: list[str] = field(default_factory=list)
    before: str = ""
    gears: str = ""
    behind: str = ""
    drive: str = ""
    segments: int = 0
    undo: str = ""
    dynamics: str = ""

    @property
    def once(self) -> str:
        """The memory-free stages with the gears between them."""
        return self.before + self.gears + self.behind


def double_code(plan: CascadePlan, lookup: bool) -> ModelCode:
    """Return the model as C in float64; with ``lookup`` the gears are a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears for such a table.
    """
    parts = _Parts()
    limits = _limits(plan)
    _gears(plan, parts, limits[1], lookup)
    parts.tables += limits[0]
    _memory_free(plan, parts)
    _dynamics(plan, parts)
    gear_members = [*parts.members, *([f"double memory[{plan.terms}];"] if plan.terms else [])]
    lag = plan.model.drive_lag is not None
    step = _lag_step(plan, parts, gear_members) if lag else parts.once
    members = _members(plan, parts)
    delay = ""
    if plan.delay_samples is not None:
        whole, part = plan.delay_samples
        between = f"later + {hex_double(part)} * (earlier - later)" if part else "later"
        more, delay = delay_line(whole, "double", between)
        members += more
    dynamics, spare = plan.model.dynamics is not None, plan.spare_words(64)
    values: dict[str, str | bool] = {
        "inverse": plan.direction == "inverse", "counts": False, "lookup": lookup, "lag": lag,
        "moving": dynamics, "terms": plan.terms > 0, "points": parts.segments > 0, "spare": bool(spare),
        "delay": bool(delay),
        "TERMS": str(plan.terms), "SEGMENTS": str(parts.segments), "COVERED": str(plan.covered),
        "WORDS": str(buffer_words(plan.backlash.n)), "SPARE_WORDS": str(len(spare)),
        "MEMORY": "state->memory" if plan.terms else "0", "SPARE": "spare" if spare else "0",
        "SPARE_STATE": str(plan.spare_bits),
        "LOWEST_DRIVE": hex_double(plan.lowest_drive),
        "FIRST_OUTPUT": hex_double(plan.first_output),
        "REACH": ignored_beyond(plan.model.input), "DRIVE_REACH": ignored_beyond(plan.drive),
        "LOWEST_OUTPUT": hex_double(plan.limits.v_min) if plan.limits else "",
        "HIGHEST_OUTPUT": hex_double(plan.limits.v_max) if plan.limits else "",
        "tables": parts.tables, "drive_steps": parts.drive, "step": parts.undo + step + parts.dynamics,
        "delay_line": delay,
    }  # fmt: skip
    headers = ("dbo_lookup.h", lookup), ("dbo_dynamics.h", dynamics or lag)
    used = tuple(header for header, needed in headers if needed)
    return ModelCode(
        "double", members, "double.c", values, plan.macros, _vectors(plan), used, parts.size, {}
    )


def _members(plan: CascadePlan, parts: _Parts) -> list[str]:
    """Return the state's members, but for a delay."""
    members = [*parts.members]
    if plan.model.dynamics is not None:
        members += _dynamics_members(plan)
    if plan.model.drive_lag is not None:
        members += ["dbo_section_state lag;", "int lagging;"]
    if plan.terms:
        members.append(f"double memory[{plan.terms}];")
    if parts.segments:
        members.append(f"size_t segments[{parts.segments}];")
    return members


# ---- the gears


def _gears(plan: CascadePlan, parts: _Parts, limits: str, lookup: bool) -> None:
    """Add the gears: run by the package's kernel, or a table of all their states."""
    gears = plan.backlash
    on_output = plan.terms > 0 and gears.memory_on == "output"
    if lookup:
        if gears.n > MOST_LOOKUP_GEARS:
            raise ModelError(
                f"dx: {gears.n} gears are too many for a table of all states, {MOST_LOOKUP_GEARS} at most"
                f" (`gears` {MOST_LOOKUP_GEARS}, or without `lookup`)"
            )
        _operator(plan, parts, 1)
        _fixed_step(plan, parts, 1)
        _corners(plan, parts)
        parts.members = ["dbo_lookup_state gears;"]
        parts.gears = f"    x = dbo_lookup_step(&lookup, &state->gears, x, {limits});\n"
        return
    _operator(plan, parts, gears.equal_run)
    if plan.limits is not None or on_output:
        _fixed_step(plan, parts, gears.equal_run)
        parts.gears = f"    x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, {limits}, 0);\n"
    else:
        decay = "decay" if plan.terms else "0"
        parts.gears = f"    x = dbo_backlash_step(&op, &state->gears, x, {decay}, 0, 0);\n"
    spare = plan.spare_words(64)
    if spare:
        parts.tables += array("uint64_t", "spare", spare)
    parts.members = [f"uint64_t words[{buffer_words(gears.n)}];", "dbo_backlash_state gears;"]


def _operator(plan: CascadePlan, parts: _Parts, run: int) -> None:
    """Add the gear table, one row a run, the terms and the operator."""
    gears, rows = plan.backlash, plan.backlash.gears[::run]
    parts.tables += array("dbo_gear", "gears", double_rows(rows))
    if plan.terms:
        parts.tables += array("double", "gain", [hex_double(v) for v in plan.gain])
        parts.tables += array("double", "decay", [hex_double(v) for v in plan.decay])
    parts.tables += (
        f"static const dbo_backlash op = {{gears, {gears.n}, {run}, 1, DBO_ROW_FACTOR({run}),\n"
        f"    {hex_double(gears.x0)}, {hex_double(gears.y0)}, 1, {plan.terms}, {'gain' if plan.terms else 0},"
        f" {hex_double(plan.reference)}, {int(gears.memory_on == 'output')}}};\n"
    )
    parts.size += 32 * len(rows) + 16 * plan.terms


def _fixed_step(plan: CascadePlan, parts: _Parts, run: int) -> None:
    """Add what the time step makes constant, as ``dbo_prepare_fixed_step`` computes it."""
    rows, kappa, rest = plan.backlash.gears[::run], 0.0, 1.0 - plan.decay
    if plan.backlash.memory_on == "output":
        for c, b in zip(plan.gain.tolist(), rest.tolist(), strict=True):
            kappa += c * b
    wide = rows[:, 0] + kappa * rows[:, 1]
    fixed = np.column_stack([wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3]])
    parts.tables += array("dbo_fixed_gear", "fixed_gears", double_rows(fixed))
    if plan.terms:
        parts.tables += array("double", "rest", [hex_double(v) for v in rest])
    names = "decay, rest" if plan.terms else "0, 0"
    parts.tables += f"static const dbo_fixed_step fixed = {{{hex_double(kappa)}, {names}, fixed_gears}};\n"
    parts.size += 24 * len(rows) + 8 * plan.terms


def _corners(plan: CascadePlan, parts: _Parts) -> None:
    """Add the corner of every state."""
    gears = plan.backlash
    states = np.arange(2**gears.n)
    engaged = (states[:, None] >> np.arange(gears.n) & 1).astype(np.float64)
    corners = engaged @ gears.gears[:, :2]  # exact: the widths lie on one binary grid
    lowest = [gears.n, *((int(b) & -int(b)).bit_length() - 1 for b in states[1:])]
    parts.tables += array("dbo_corner", "corners", double_rows(corners))
    parts.tables += array("uint8_t", "lowest", [str(v) for v in lowest])
    parts.tables += "static const dbo_lookup lookup = {&op, &fixed, corners, lowest};\n"
    parts.size += 17 * len(states)


def _limits(plan: CascadePlan) -> tuple[str, str]:
    """Return the limits' table and how to name them in a call."""
    inner = plan.inner_limits
    if inner is None:
        return "", "0"
    if plan.model.drive_lag is not None:
        return "", "&within"  # made anew for each sample
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


# ---- the stages around them


def _memory_free(plan: CascadePlan, parts: _Parts) -> None:
    """Add the memory-free stages; a drive given to reset passes them as far as the gears."""
    parts.before = _stage_steps(plan.head, "before", parts)
    parts.behind = _stage_steps(plan.tail, "behind", parts)
    parts.drive = _stage_steps(plan.drive_stages, "drive", parts)
    if plan.limits is not None and plan.tail:  # rounding on the way through the points
        low, high = ("low", "high") if plan.model.drive_lag is not None else (
            hex_double(plan.limits.v_min), hex_double(plan.limits.v_max)
        )  # fmt: skip
        parts.behind += f"    x = x < {low} ? {low} : x > {high} ? {high} : x;\n"


def _stage_steps(stages: MemoryFree, label: str, parts: _Parts) -> str:
    """Add the tables of points and scales; return their statements on ``x``."""
    steps = ""
    for k, stage in enumerate(stages):
        if isinstance(stage, ScaleStage):
            steps += f"    x = {hex_double(stage.gain)} * x + {hex_double(stage.offset)};\n"
            continue
        parts.tables += array("dbo_segment", f"{label}_{k}", double_rows(stage.segments))
        parts.size += 24 * stage.m
        steps += (
            f"    x = dbo_point_step({label}_{k}, {stage.m}, {hex_double(stage.x0)},\n"
            f"                       {hex_double(stage.y0)}, &state->segments[{parts.segments}], x);\n"
        )
        parts.segments += 1
    return steps


def _dynamics_members(plan: CascadePlan) -> list[str]:
    """Return what the dynamics keep in the state."""
    if plan.inverter is None:
        assert plan.model.dynamics is not None
        return [f"dbo_section_state sections[{len(plan.model.dynamics.sections)}];", "int moving;"]
    undone = plan.inverter.parts[::-1]
    windows = [f"double window_{k}[{part.weight.size + 1}];" for k, part in enumerate(undone)]
    return [*windows, f"dbo_inverse_state sections[{len(undone)}];", "int moving;"]


def _dynamics(plan: CascadePlan, parts: _Parts) -> None:
    """Add the dynamics behind the gears: on a forward model's output, undone on an inverse's input."""
    stage = plan.model.dynamics
    if stage is None:
        return
    assert plan.time_step is not None
    if plan.inverter is not None:
        _undone_dynamics(plan, parts)
        return
    count = len(stage.sections)
    steps = stage.rows(plan.time_step).reshape(count, 6)
    parts.tables += array("dbo_section_step", "section_steps", double_rows(steps))
    parts.tables += array(
        "dbo_section_output", "section_outputs", double_rows(section.output for section in stage.sections)
    )
    parts.size += 64 * count
    parts.dynamics = fill("dynamics_forward.c", {"SECTIONS": str(count)})


def _undone_dynamics(plan: CascadePlan, parts: _Parts) -> None:
    """Add the inverse of the dynamics, the last section first, each with its window on the future."""
    assert plan.inverter is not None
    undone, rows, windows, steps = plan.inverter.parts[::-1], [], "", ""
    for k, part in enumerate(undone):
        ahead, weights = part.weight.size, "0"
        if ahead:
            weights = f"weights_{k}"
            parts.tables += array("double", weights, [hex_double(v) for v in part.weight])
            steps += (
                f"    for (size_t k = 0; k < {ahead}; k++) state->window_{k}[k] = state->window_{k}[k + 1];\n"
            )
        rows.append([*(hex_double(v) for v in np.ravel(part.numbers)), str(ahead), weights])
        windows += f"        for (size_t k = 0; k < {ahead + 1}; k++) state->window_{k}[k] = x;\n"
        steps += (
            f"    state->window_{k}[{ahead}] = x;\n"
            f"    dbo_dynamics_undo(&sections[{k}], &state->sections[{k}], state->window_{k}, &x, 1);\n"
        )
    parts.tables += array("dbo_section_inverse", "sections", struct_rows(rows))
    parts.size += 72 * len(undone) + 8 * plan.inverter.ahead
    parts.undo = fill(
        "dynamics_inverse.c", {"SECTIONS": str(len(undone)), "fill_windows": windows, "undo_sections": steps}
    )


# ---- a lag before the gears


def _lag_step(plan: CascadePlan, parts: _Parts, gear_members: Sequence[str]) -> str:
    """Add the lag's tables; return the whole step of the other stages behind it, or of its inverse."""
    lag = plan.model.drive_lag
    assert lag is not None
    assert plan.time_step is not None
    output = "static const dbo_section_output lag_output = {0.0, 0.0};\n"
    parts.size += 64
    if plan.direction == "forward":
        parts.tables += array("dbo_section_step", "lag_step", double_rows(lag.rows(plan.time_step))) + output
        return fill("lag_forward.c", {"once": parts.once})
    assert plan.limits is not None
    assert plan.inner_limits is not None
    low, high, slew = plan.limits.v_min, plan.limits.v_max, plan.limits.max_slew
    numbers, slack = coefficients(lag, plan.time_step), NEGLIGIBLE * (high - low)
    parts.tables += array("dbo_section_step", "lag_undone", double_rows(undoing_rows(numbers)))
    parts.tables += output + fill("next_above.c", {})
    change = 0.0 if slew is None else slew * plan.time_step
    constants = {
        "LEAST": low, "MOST": high, "LEAST_SLACK": low - slack, "MOST_SLACK": high + slack,
        "CHANGE": change, "CHANGE_SLACK": change + slack, "PART": float(numbers.part[0]),
        "RISE": float(numbers.rise[0]), "BEGUN": plan.model.outer_drive(plan.lowest_drive),
        "INNER_LEAST": plan.inner_limits.v_min, "INNER_MOST": plan.inner_limits.v_max,
    }  # fmt: skip
    kept = [_kept(member) for member in gear_members]
    texts: dict[str, str | bool] = {
        "slew": slew is not None, "once": parts.once, "once_again": _indented(parts.once),
        "drive_steps": _indented(parts.drive), "keep": "".join(keep for keep, _ in kept),
        "bring_back": _indented("".join(back for _, back in kept)),
    }  # fmt: skip
    return fill("lag_inverse.c", texts | {key: hex_double(value) for key, value in constants.items()})


def _indented(text: str) -> str:
    return "".join(f"    {line}\n" for line in text.splitlines())


def _kept(member: str) -> tuple[str, str]:
    """Return the C that keeps a member of the state, and what brings it back."""
    kind, name, count = declared(member)
    if not count:
        return f"    const {kind} kept_{name} = state->{name};\n", f"    state->{name} = kept_{name};\n"
    each = f"    for (size_t k = 0; k < {count}; k++)"
    return (
        f"    {kind} kept_{name}[{count}];\n{each} kept_{name}[k] = state->{name}[k];\n",
        f"{each} state->{name}[k] = kept_{name}[k];\n",
    )


# ---- the self-test


def _vectors(plan: CascadePlan) -> list[Vectors]:
    trimmed = plan.trimmed_drive
    runs = ("after init", None, plan.empty_state()), (
        "after reset", hex_double(trimmed), plan.settled_state(trimmed),
    )  # fmt: skip
    found = []
    for seed, (label, reset, state) in enumerate(runs, 1):
        moves = self_test_moves(plan.model.input.minimum, plan.model.input.maximum, seed)
        given = _after_dynamics(plan, moves)
        y = plan.model.simulate(given, state, time_step=plan.time_step, limits=plan.limits).y
        texts = ([hex_double(v) for v in values] for values in (moves, y))
        found.append(Vectors(label, reset, *texts))
    return found


def _after_dynamics(plan: CascadePlan, moves: Floats) -> Floats:
    """Return what reaches an inverse model's other stages while ``moves`` go into the window."""
    if plan.inverter is None:
        return moves
    held = np.concatenate([np.full(plan.inverter.ahead, moves[0]), moves])
    return plan.inverter.run(held, plan.inverter.rest(float(moves[0])))[0]
