"""The linear dynamics behind the gears, in float64 at the fixed step: the package's own kernel for them.

A forward export passes its output through them. An inverse undoes them on what is wanted, for which it
must know some samples of the future: it holds them back in a window, so that its output belongs to the
input of that many samples ago.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.export.c_text import array, hex_double, struct_rows
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.hysteresis.dynamics import DynamicsInverter

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DynamicsParts:
    """Tables and their bytes, members of the state, what clears them, and the statements on ``x``."""

    tables: str = ""
    size: int = 0
    members: tuple[str, ...] = ()
    clear: str = ""
    before: str = ""
    behind: str = ""


def dynamics_parts(plan: CascadePlan) -> DynamicsParts:
    """Return what the dynamics of a plan add to the sources; nothing where there are none."""
    if plan.model.dynamics is None:
        return DynamicsParts()
    return _forward(plan) if plan.direction == "forward" else _inverse(plan)


def undone_moves(plan: CascadePlan, moves: Floats) -> Floats:
    """Return what reaches an inverse model's other stages while ``moves`` go into the window."""
    inverter = inverter_of(plan)
    if inverter is None:
        return moves
    held = np.concatenate([np.full(inverter.ahead, moves[0]), moves])
    return inverter.run(held, inverter.rest(float(moves[0])))[0]


def inverter_of(plan: CascadePlan) -> DynamicsInverter | None:
    """Return what undoes the dynamics of an inverse model, or None."""
    if plan.direction == "forward" or plan.model.dynamics is None:
        return None
    assert plan.time_step is not None
    return plan.model.dynamics.inverter(plan.time_step)


def _forward(plan: CascadePlan) -> DynamicsParts:
    stage = plan.model.dynamics
    assert stage is not None
    assert plan.time_step is not None
    count = len(stage.sections)
    steps = stage.rows(plan.time_step).reshape(count, 6)
    outputs = np.array([section.output for section in stage.sections], dtype=np.float64)
    tables = array("dbo_section_step", "section_steps", _rows(steps))
    tables += array("dbo_section_output", "section_outputs", _rows(outputs))
    step = (
        f"    if (!state->moving) {{ /* at rest at the first sample */\n"
        f"        for (size_t k = 0; k < {count}; k++) {{\n"
        "            state->sections[k].p = state->sections[k].u = x;\n"
        "            state->sections[k].q = 0.0;\n        }\n        state->moving = 1;\n    }\n"
        f"    dbo_dynamics_run({count}, section_outputs, state->sections, &x, &x, 1, section_steps, 0);\n"
    )
    members = (f"dbo_section_state sections[{count}];", "int moving;")
    return DynamicsParts(tables, 64 * count, members, "    state->moving = 0;\n", behind=step)


def _inverse(plan: CascadePlan) -> DynamicsParts:
    inverter = inverter_of(plan)
    assert inverter is not None
    parts = inverter.parts[::-1]  # the last section is undone first
    tables, rows, members, fill, steps = "", [], [], "", ""
    for k, part in enumerate(parts):
        ahead = part.weight.size
        weights = "0"
        if ahead:
            tables += array("double", f"weights_{k}", [hex_double(v) for v in part.weight])
            weights = f"weights_{k}"
            steps += (
                f"    for (size_t k = 0; k < {ahead}; k++) state->window_{k}[k] = state->window_{k}[k + 1];\n"
            )
        rows.append([*(hex_double(v) for v in np.ravel(part.numbers)), str(ahead), weights])
        members.append(f"double window_{k}[{ahead + 1}];")
        fill += f"        for (size_t k = 0; k < {ahead + 1}; k++) state->window_{k}[k] = x;\n"
        steps += (
            f"    state->window_{k}[{ahead}] = x;\n"
            f"    dbo_dynamics_undo(&sections[{k}], &state->sections[{k}], state->window_{k}, &x, 1);\n"
        )
    tables += array("dbo_section_inverse", "sections", struct_rows(rows))
    count = len(parts)
    start = (
        "    if (!state->moving) { /* at rest at the first sample */\n" + fill
        + f"        for (size_t k = 0; k < {count}; k++) {{\n            state->sections[k].y = x;\n"
        "            state->sections[k].a = state->sections[k].b = 0.0;\n        }\n"
        "        state->moving = 1;\n    }\n"
    )  # fmt: skip
    members += [f"dbo_inverse_state sections[{count}];", "int moving;"]
    size = 72 * count + 8 * inverter.ahead
    return DynamicsParts(tables, size, tuple(members), "    state->moving = 0;\n", before=start + steps)


def _rows(table: Floats) -> list[str]:
    return struct_rows([hex_double(v) for v in row] for row in table)
