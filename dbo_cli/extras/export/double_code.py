"""The model in float64: the kernel of the package, unchanged, and tables that give the same bits as it.

A forward export passes its output through the dynamics. An inverse undoes them on what
is wanted, for which it must know some samples of the future: it holds them back in a
window, so that its output belongs to the input of that many samples ago.

With a lag before the gears, an inverse asks what drive the lag makes of what its other
stages wish for; where the limits forbid that drive, the sample is done again with what
they leave, so that the gears see what the actuator is driven by. It is what
``hysteresis.drive_lag`` does, as C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dbo_cli.errors import ModelError
from dbo_cli.extras.export import source_text as c
from dbo_cli.extras.export.cascade_plan import (
    CascadePlan,
    ignored_beyond,
    self_test_moves,
)
from dbo_cli.hysteresis.cascade import MemoryFree, ScaleStage
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import NEGLIGIBLE
from dbo_cli.hysteresis.operators import kernel_table

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


def double_code(plan: CascadePlan, lookup: bool) -> c.ModelCode:
    """Return the model as C in float64; with ``lookup`` the gears are a table of all their states.

    Raises
    ------
    ModelError
        There are too many gears for such a table.
    """
    parts = _Parts()
    _gears(plan, parts, lookup)
    _memory_free(plan, parts)
    memory = [f"double memory[{plan.terms}];"] if plan.terms else []
    # What a step of the gears changes; it writes to no turn that the state before it
    # has.
    changed = [
        member
        for member in (*parts.members, *memory)
        if not member.startswith("dbo_place ")
    ]
    _dynamics(plan, parts)
    lag = plan.model.drive_lag is not None
    step = parts.once
    if lag:
        step = _lag_step(plan, parts, changed)
    members = [*parts.members, *memory]
    if parts.segments:
        members.append(f"size_t segments[{parts.segments}];")
    more, delay = _delay_line(plan)
    members += more
    dynamics = plan.model.dynamics is not None
    spare = plan.spare_words(64)
    covered = plan.model.covered_gears
    lowest_output = highest_output = ""
    if plan.limits is not None:
        lowest_output = c.hex_double(plan.limits.v_min)
        highest_output = c.hex_double(plan.limits.v_max)
    values: dict[str, str | bool] = {
        "inverse": plan.model.direction == "inverse", "counts": False, "lookup": lookup, "lag": lag,
        "moving": dynamics, "terms": plan.terms > 0, "points": parts.segments > 0, "spare": bool(spare),
        "delay": bool(delay),
        "TERMS": str(plan.terms), "SEGMENTS": str(parts.segments), "COVERED": str(covered.n),
        "CHECKPOINTS": c.checkpoints_of(plan.model.backlash.n, "double"),
        "MEMORY": "state->memory" if plan.terms else "0", "SPARE": "spare" if spare else "0",
        "SPARE_STATE": str(plan.model.spare_bits),
        "LOWEST_DRIVE": c.hex_double(covered.x0),
        "FIRST_OUTPUT": c.hex_double(plan.first_output),
        "REACH": ignored_beyond(plan.model.input), "DRIVE_REACH": ignored_beyond(plan.model.drive),
        "LOWEST_OUTPUT": lowest_output, "HIGHEST_OUTPUT": highest_output,
        "tables": parts.tables, "drive_steps": parts.drive, "step": parts.undo + step + parts.dynamics,
        "delay_line": delay,
    }  # fmt: skip
    headers = (
        ("dbo_lookup.h", lookup),
        ("dbo_dynamics.h", dynamics or lag),
        (c.INTERPOLATION, plan.delay_is_smooth),
    )
    used = tuple(header for header, needed in headers if needed)
    return c.ModelCode(
        "double", members, "double.c", values, _vectors(plan), used, parts.size, {}
    )


def _delay_line(plan: CascadePlan) -> tuple[list[str], str]:
    """Return the members of a delay line and its statements; nothing where there is no delay."""
    if plan.delay_samples is None:
        return [], ""
    whole, part = plan.delay_samples
    if plan.delay_is_smooth:
        return c.smooth_delay_line(whole, c.hex_double(1.0 - part), "double", "")
    between = "later"
    if part:
        between = f"later + {c.hex_double(part)} * (earlier - later)"
    return c.delay_line(whole, "double", between)


# ---- the gears


def _gears(plan: CascadePlan, parts: _Parts, lookup: bool) -> None:
    """Add the gears: run by the package's kernel, or a table of all their states."""
    gears, rest = plan.model.backlash, 1.0 - plan.decay
    run = 1 if lookup else gears.equal_run
    limits, kappa, terms, corners = plan.inner_limits, plan.kappa, "", ""
    fixed = lookup or limits is not None
    if plan.terms:
        terms = _doubles("gain", plan.gain) + _doubles("decay", plan.decay)
    table, _ = kernel_table(gears.gears, run)
    rows = table[:-1]
    parts.size = (
        48 * len(table) + 16 * plan.terms + fixed * (32 * len(rows) + 8 * plan.terms)
    )
    # As dbo_prepare_fixed_step computes it.
    wide = rows[:, 0] + kappa * rows[:, 1]
    begins = rows[:, 4] + kappa * rows[:, 5]
    steps = np.column_stack(
        [wide * rows[:, 3], rows[:, 1] / wide, rows[:, 1] * rows[:, 3], begins]
    )
    if lookup:
        corners = _corners(plan)
        parts.size += 17 * 2**gears.n
        parts.members = ["dbo_lookup_state gears;"]
    else:
        parts.members = [
            *c.turns_members(gears.n, "double"),
            "dbo_backlash_state gears;",
        ]
    spare = [] if lookup else plan.spare_words(64)
    # then the limits are made anew for each sample
    lagging = plan.model.drive_lag is not None
    values: dict[str, str | bool] = {
        "terms": plan.terms > 0, "fixed": fixed, "lookup": lookup, "limits": limits is not None,
        "constant_limits": limits is not None and not lagging,
        "slew": plan.slew_step is not None,
        "gear_rows": c.array("dbo_gear", "gears", c.double_rows(table)), "term_tables": terms,
        "fixed_rows": c.array("dbo_fixed_gear", "fixed_gears", c.double_rows(steps)),
        "rest_table": _doubles("rest", rest) if plan.terms else "", "corner_tables": corners,
        "spare_table": c.array("uint64_t", "spare", spare) if spare else "",
        "GEARS": str(gears.n), "RUN": str(run), "TERMS": str(plan.terms),
        "ON_OUTPUT": str(int(gears.memory_on == "output")),
        "CHANGE": c.hex_double(plan.slew_step or 0.0), "LIMITS": "&within" if lagging else "&limits",
    }  # fmt: skip
    least = most = 0.0
    if limits is not None:
        least, most = limits.v_min, limits.v_max
    numbers = {
        "X_START": gears.x0, "Y_START": gears.y0, "REFERENCE": plan.reference, "KAPPA": kappa,
        "LEAST": least, "MOST": most, "SLACK": NEGLIGIBLE * (most - least),
    }  # fmt: skip
    values |= {key: c.hex_double(value) for key, value in numbers.items()}
    parts.tables = c.fill("double_tables.c", values)
    parts.gears = c.fill("double_gears.c", values)


def _doubles(name: str, values: Floats) -> str:
    return c.array("double", name, [c.hex_double(value) for value in values])


def _corners(plan: CascadePlan) -> str:
    """Return the corner of every state.

    Raises
    ------
    ModelError
        There are too many gears.
    """
    n = plan.model.backlash.n
    if n > MOST_LOOKUP_GEARS:
        raise ModelError(
            f"dx: {n} gears are too many for a table of all states, {MOST_LOOKUP_GEARS} at most"
            f" (`gears` {MOST_LOOKUP_GEARS}, or without `lookup`)"
        )
    states = np.arange(2**n)
    engaged = (states[:, None] >> np.arange(n) & 1).astype(np.float64)
    # exact: the widths lie on one binary grid
    corners = engaged @ plan.model.backlash.gears[:, :2]
    lowest = [n, *((int(b) & -int(b)).bit_length() - 1 for b in states[1:])]
    return c.array("dbo_corner", "corners", c.double_rows(corners)) + c.array(
        "uint8_t", "lowest", [str(v) for v in lowest]
    )


# ---- the stages around them


def _memory_free(plan: CascadePlan, parts: _Parts) -> None:
    """Add the memory-free stages; a drive given to reset passes them as far as the gears."""
    parts.before = _stage_steps(plan.model.head, "before", parts)
    parts.behind = _stage_steps(plan.model.tail, "behind", parts)
    parts.drive = _stage_steps(plan.drive_stages, "drive", parts)
    # rounding on the way through the points
    if plan.limits is not None and plan.model.tail:
        low, high = "low", "high"
        if plan.model.drive_lag is None:
            low = c.hex_double(plan.limits.v_min)
            high = c.hex_double(plan.limits.v_max)
        parts.behind += f"    x = x < {low} ? {low} : x > {high} ? {high} : x;\n"


def _stage_steps(stages: MemoryFree, label: str, parts: _Parts) -> str:
    """Add the tables of points and scales; return their statements on ``x``."""
    steps = ""
    for k, stage in enumerate(stages):
        if isinstance(stage, ScaleStage):
            steps += f"    x = {c.hex_double(stage.gain)} * x + {c.hex_double(stage.offset)};\n"
            continue
        parts.tables += c.array(
            "dbo_segment", f"{label}_{k}", c.double_rows(stage.segments)
        )
        parts.size += 24 * stage.m
        steps += (
            f"    x = dbo_point_step({label}_{k}, {stage.m}, {c.hex_double(stage.x0)},\n"
            f"                       {c.hex_double(stage.y0)}, &state->segments[{parts.segments}], x);\n"
        )
        parts.segments += 1
    return steps


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
    parts.tables += c.array("dbo_section_step", "section_steps", c.double_rows(steps))
    parts.tables += c.array(
        "dbo_section_output",
        "section_outputs",
        c.double_rows(section.output for section in stage.sections),
    )
    parts.size += 64 * count
    parts.members += [f"dbo_section_state sections[{count}];", "int moving;"]
    parts.dynamics = c.fill("dynamics_forward.c", {"SECTIONS": str(count)})


def _undone_dynamics(plan: CascadePlan, parts: _Parts) -> None:
    """Add the inverse of the dynamics, the last section first, each with its window on the future."""
    assert plan.inverter is not None
    undone = plan.inverter.parts[::-1]
    rows = []
    windows = steps = ""
    for k, part in enumerate(undone):
        ahead = part.weight.size
        window = f"window_{k}"
        weights = "0"
        if ahead:
            weights = f"weights_{k}"
            parts.tables += _doubles(weights, part.weight)
        parts.members.append(f"double {window}[{ahead + 1}];")
        rows.append(
            [*(c.hex_double(v) for v in np.ravel(part.numbers)), str(ahead), weights]
        )
        windows += f"        for (size_t k = 0; k < {ahead + 1}; k++) state->{window}[k] = x;\n"
        words: c.Values = {
            "WINDOW": window,
            "AHEAD": str(ahead),
            "PLACE": str(k),
            "ahead": ahead > 0,
        }
        steps += c.fill("dynamics_undo.c", words)
    parts.tables += c.array("dbo_section_inverse", "sections", c.struct_rows(rows))
    parts.size += 72 * len(undone) + 8 * plan.inverter.ahead
    parts.members += [f"dbo_inverse_state sections[{len(undone)}];", "int moving;"]
    parts.undo = c.fill(
        "dynamics_inverse.c",
        {"SECTIONS": str(len(undone)), "fill_windows": windows, "undo_sections": steps},
    )


# ---- a lag before the gears


def _lag_step(plan: CascadePlan, parts: _Parts, gear_members: Sequence[str]) -> str:
    """Add the lag's tables; return the whole step of the other stages behind it, or of its inverse."""
    lag = plan.model.drive_lag
    assert lag is not None
    assert plan.time_step is not None
    output = "static const dbo_section_output lag_output = {0.0, 0.0};\n"
    parts.size += 64
    parts.members += ["dbo_section_state lag;", "int lagging;"]
    if plan.model.direction == "forward":
        rows = c.double_rows(lag.rows(plan.time_step))
        parts.tables += c.array("dbo_section_step", "lag_step", rows) + output
        return c.fill("lag_forward.c", {"once": parts.once})
    assert plan.limits is not None
    assert plan.inner_limits is not None
    low, high, slew = plan.limits.v_min, plan.limits.v_max, plan.limits.max_slew
    numbers = coefficients(lag, plan.time_step)
    parts.tables += c.array(
        "dbo_section_step", "lag_undone", c.double_rows(undoing_rows(numbers))
    )
    parts.tables += output + c.fill("next_above.c", {})
    if slew is not None:
        parts.tables += c.fill("towards.c", {})
    constants = {
        "LEAST": low, "MOST": high,
        "CHANGE": plan.limits.largest_change(plan.time_step) or 0.0, "PART": float(numbers[0, 0]),
        "RISE": float(numbers[0, 1]), "BEGUN": plan.model.outer_drive(plan.model.covered_gears.x0),
        "INNER_LEAST": plan.inner_limits.v_min, "INNER_MOST": plan.inner_limits.v_max,
    }  # fmt: skip
    members = [_kept(member) for member in gear_members]
    texts: dict[str, str | bool] = {
        "slew": slew is not None, "once": parts.once, "once_again": _indented(parts.once),
        "drive_steps": _indented(parts.drive), "keep": "".join(keep for keep, _ in members),
        "bring_back": _indented("".join(back for _, back in members)),
    }  # fmt: skip
    return c.fill(
        "lag_inverse.c",
        texts | {key: c.hex_double(value) for key, value in constants.items()},
    )


def _indented(text: str) -> str:
    return "".join(f"    {line}\n" for line in text.splitlines())


def _kept(member: str) -> tuple[str, str]:
    """Return the C that keeps a member of the state, and what brings it back."""
    kind, name, count = c.declared(member)
    if not count:
        return (
            f"    const {kind} kept_{name} = state->{name};\n",
            f"    state->{name} = kept_{name};\n",
        )
    each = f"    for (size_t k = 0; k < {count}; k++)"
    return (
        f"    {kind} kept_{name}[{count}];\n{each} kept_{name}[k] = state->{name}[k];\n",
        f"{each} state->{name}[k] = kept_{name}[k];\n",
    )


# ---- the self-test


def _vectors(plan: CascadePlan) -> list[c.Vectors]:
    trimmed, vectors = plan.trimmed_drive, []
    for seed, reset in enumerate((None, trimmed), 1):
        state = plan.empty_state() if reset is None else plan.settled_state(reset)
        moves = self_test_moves(
            plan.model.input.minimum, plan.model.input.maximum, seed
        )
        played = moves
        # what reaches the other stages while the moves go into the window
        if plan.inverter is not None:
            extended = np.concatenate([np.full(plan.inverter.ahead, moves[0]), moves])
            played = plan.inverter.run(extended, plan.inverter.rest(float(moves[0])))[0]
        y = plan.model.simulate(
            played, state, time_step=plan.time_step, limits=plan.limits
        ).y
        start = None if reset is None else c.hex_double(reset)
        inputs = [c.hex_double(move) for move in moves]
        vectors.append(c.Vectors(start, inputs, [c.hex_double(v) for v in y]))
    return vectors
