"""A lag before the gears, in float64 at the fixed step: what ``hysteresis.drive_lag`` does, as C.

A forward export passes its input through the lag. An inverse asks what drive the lag makes of what its other
stages wish for; where the limits forbid that drive, the sample is done again with what they leave, so that
the gears see what the actuator is driven by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dbo_cli.export.c_text import array, hex_double, struct_rows
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.hysteresis.drive_lag import coefficients, undoing_rows
from dbo_cli.hysteresis.dynamics import DynamicsStage
from dbo_cli.hysteresis.model import NEGLIGIBLE

NEXT_ABOVE = """\
static double next_above(double value) {
    union {
        double value;
        uint64_t bits;
    } u;
    u.value = value;
    u.bits = value == 0.0 ? 1 : value > 0.0 ? u.bits + 1 : u.bits - 1;
    return u.value;
}

"""


@dataclass(frozen=True)
class LagParts:
    """Tables, and the whole step on ``x``; what is the same for all: bytes, members, and their start."""

    tables: str
    step: str
    size: int = 64
    members: tuple[str, ...] = ("dbo_section_state lag;", "int lagging;")
    clear: str = "    state->lagging = 0;\n"
    start: str = (
        "    state->lag.p = state->lag.u = drive;\n    state->lag.q = 0.0;\n    state->lagging = 1;\n"
    )


@dataclass(frozen=True)
class Rest:
    """The stages but the lag, as C on ``x``.

    Attributes
    ----------
    before, gears, behind : str
        The stages before the gears, the gears (of an inverse: with the limits ``&within``), and those behind.
    drive : str
        What turns a drive into what the gears of an inverse give.
    members : sequence of str
        The members of the state that a step of the gears changes.
    """

    before: str
    gears: str
    behind: str
    drive: str
    members: Sequence[str]


def lag_parts(plan: CascadePlan, rest: Rest) -> LagParts:
    """Return what a plan's lag before the gears adds to the sources, its step around the rest's."""
    lag = plan.model.drive_lag
    assert lag is not None
    assert plan.time_step is not None
    return _forward(lag, plan.time_step, rest) if plan.direction == "forward" else _inverse(plan, lag, rest)


def _forward(lag: DynamicsStage, time_step: float, rest: Rest) -> LagParts:
    rows = struct_rows([hex_double(v) for v in row] for row in lag.rows(time_step))
    tables = array("dbo_section_step", "lag_step", rows)
    tables += "static const dbo_section_output lag_output = {0.0, 0.0};\n"
    step = (
        "    if (!state->lagging) { /* at rest at the first sample */\n"
        "        state->lag.p = state->lag.u = x;\n        state->lag.q = 0.0;\n"
        "        state->lagging = 1;\n    }\n"
        "    dbo_dynamics_run(1, &lag_output, &state->lag, &x, &x, 1, lag_step, 0);\n"
    )
    step += rest.before + rest.gears + "\n" + rest.behind
    return LagParts(tables, step)


def _inverse(plan: CascadePlan, lag: DynamicsStage, rest: Rest) -> LagParts:
    assert plan.time_step is not None
    assert plan.limits is not None
    assert plan.inner_limits is not None
    low, high, slew = plan.limits.v_min, plan.limits.v_max, plan.limits.max_slew
    numbers, slack = coefficients(lag, plan.time_step), NEGLIGIBLE * (high - low)
    rows = struct_rows([hex_double(v) for v in row] for row in undoing_rows(numbers))
    tables = array("dbo_section_step", "lag_undone", rows)
    tables += "static const dbo_section_output lag_output = {0.0, 0.0};\n" + NEXT_ABOVE
    allowed = f"v < {hex_double(low - slack)} || v > {hex_double(high + slack)}"
    least, most, before = hex_double(low), hex_double(high), ""
    if slew is not None:
        change = slew * plan.time_step
        begun = hex_double(plan.model.outer_drive(plan.start_drive))
        before = f"    const double last = state->lagging ? state->lag.u : {begun};\n"
        allowed += f" || (v > last ? v - last : last - v) > {hex_double(change + slack)}"
    text = before + "    const double wanted = x;\n    double low = " + least + ", high = " + most + ", v;\n"
    text += "    dbo_limits within = {" + ", ".join(
        hex_double(v) for v in (plan.inner_limits.v_min, plan.inner_limits.v_max)
    ) + ", 0.0, 0, 0};\n    dbo_section_state undone;\n"  # fmt: skip
    keep, back = _kept(rest.members)
    text += keep
    clip = "    x = x < low ? low : x > high ? high : x;\n" if rest.behind else ""
    once = rest.before + rest.gears + "\n" + rest.behind + clip
    text += once
    text += (
        "    undone.p = state->lagging ? state->lag.u : x;\n    undone.q = 0.0;\n"
        "    undone.u = state->lagging ? state->lag.p : x;\n"
        "    dbo_dynamics_run(1, &lag_output, &undone, &x, &v, 1, lag_undone, 0);\n"
        "    state->lag.q = 0.0;\n"
        f"    if ({allowed}) {{ /* again, with the drive that the limits leave */\n"
    )
    again = f"    double least = {least}, most = {most};\n"
    if slew is not None:
        again += (
            f"    const double held = last < {least} ? {least} : last > {most} ? {most} : last;\n"
            f"    if (held - {hex_double(change)} > least) least = held - {hex_double(change)};\n"
            f"    if (held + {hex_double(change)} < most) most = held + {hex_double(change)};\n"
        )
    part, rise = hex_double(float(numbers.part[0])), hex_double(float(numbers.rise[0]))
    again += (
        "    low = least;\n    high = most;\n"
        "    if (state->lagging) {\n"
        "        const double p = state->lag.p, u = state->lag.u;\n"
        f"        low = p + {part} * (u - p) + {rise} * (least - u);\n"
        f"        high = p + {part} * (u - p) + {rise} * (most - u);\n    }}\n"
        "    if (!(low < high)) high = next_above(low);\n" + back
        + "    x = low;\n" + rest.drive + "    within.low = x;\n    x = high;\n" + rest.drive
        + "    within.high = x;\n"
        "    if (x < within.low) {\n        within.high = within.low;\n        within.low = x;\n    }\n"
        "    x = wanted;\n" + once +
        "    v = x - low <= high - x ? least : most;\n"
        "    undone.u = x;\n    undone.p = v;\n"
    )  # fmt: skip
    text += "".join(f"    {line}\n" for line in again.splitlines()) + "    }\n"
    text += (
        "    state->lag.p = undone.u;\n    state->lag.u = undone.p;\n    state->lagging = 1;\n"
        f"    x = v < {least} ? {least} : v > {most} ? {most} : v;\n"
    )
    return LagParts(tables, text)


def _kept(members: Sequence[str]) -> tuple[str, str]:
    """Return the C that keeps members of the state, and what brings them back."""
    keep, back = "", ""
    for member in members:
        kind, declared = member.split(";")[0].split(" ", 1)
        name, _, count = declared.rstrip("]").partition("[")
        if count:
            keep += f"    {kind} kept_{name}[{count}];\n"
            keep += f"    for (size_t k = 0; k < {count}; k++) kept_{name}[k] = state->{name}[k];\n"
            back += f"    for (size_t k = 0; k < {count}; k++) state->{name}[k] = kept_{name}[k];\n"
        else:
            keep += f"    const {kind} kept_{name} = state->{name};\n"
            back += f"    state->{name} = kept_{name};\n"
    return keep, back
