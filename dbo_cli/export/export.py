"""A model as a folder of C sources with tables, self-test, and one page to read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dbo_cli.drive.limits import Limits
from dbo_cli.errors import UsageError
from dbo_cli.export import text as c
from dbo_cli.export.double import double_sources
from dbo_cli.export.plan import Loss, Plan, plan_of, with_fewer_gears
from dbo_cli.export.q31 import q31_sources
from dbo_cli.model import Cascade, Quantity

NUMBER_TYPES = {"double": "double", "q31": "int32_t"}
"""The arithmetics, and the type of what goes in and comes out."""


@dataclass(frozen=True)
class Export:
    """A model as C.

    Attributes
    ----------
    files : dict
        Texts by the names of their files.
    figures : dict
        Gears, samples ahead, bounds and losses, for programs.
    """

    files: dict[str, str]
    figures: dict[str, Any]


def export_model(
    model: Cascade,
    limits: Limits,
    *,
    name: str = "actuator",
    arithmetic: str = "double",
    sample_rate: float | None = None,
    gears: int | None = None,
    lookup: bool = False,
) -> Export:
    """Return the drive of a model as C99 for a controller.

    Parameters
    ----------
    model : Model
        Forward or inverse.
    limits : Limits
        Of the drive, as in ``plan``.
    name : str
        What begins the names of files, types and functions.
    arithmetic : {"double", "q31"}
        double gives the bits of ``plan``; q31, whole numbers of 32 bits, comes with a
        bound that is derived from its tables.
    sample_rate : float, optional
        Steps a second (Hz); needed where relaxation, slew, dynamics or a delay depend
        on it.
    gears : int, optional
        Fewer gears than the model has; the loss is in the figures.
    lookup : bool
        The gears as a table of all states, for 12 gears at most and no relaxation.

    Raises
    ------
    UsageError
        An argument contradicts another, or ``name`` is no usable identifier.
    ModelError
        The model does not fit the arithmetic.
    InputError
        The rate does not resolve the dynamics.
    """
    c.check_name(name)
    if arithmetic not in NUMBER_TYPES:
        raise UsageError(
            f"`arithmetic` {arithmetic}: give one of {', '.join(NUMBER_TYPES)}"
        )
    if lookup and arithmetic != "double":
        raise UsageError("`lookup` needs `arithmetic` double")
    forward, loss = model.forward(), None
    if gears is not None:
        forward, loss = with_fewer_gears(forward, gears)
    plan = plan_of(forward, sample_rate, limits)
    figures = {
        "name": name,
        "arithmetic": arithmetic,
        "sample_rate": sample_rate,
        "limits": limits.as_dict(),
        "gears": plan.gears.n,
        "ahead": plan.ahead,
    }
    if loss is not None:
        figures["loss"] = loss
    if arithmetic == "double":
        sources = double_sources(plan, lookup)
    else:
        sources, bounds = q31_sources(plan)
        figures["bounds"] = bounds._asdict()
    values = {
        "NAME": name,
        "GUARD": name.upper(),
        "NUMBER": NUMBER_TYPES[arithmetic],
        "ARITHMETIC": arithmetic,
        "ORIGIN": f"Written by dbo export from the model {model.digest[:16]}.",
        **_about_model(plan),
        **_duties(plan, name.upper(), sample_rate, loss),
        **_self_test(name, NUMBER_TYPES[arithmetic], sources),
        **sources.values,
    }
    return Export(_files(values, sources), figures)


def _files(values: dict[str, str], sources: c.Sources) -> dict[str, str]:
    """Return every file, filled in."""
    name, arithmetic = values["NAME"], values["ARITHMETIC"]
    headers = [file for file in sources.kernel if file.endswith(".h")]
    compiled = [file for file in sources.kernel if file.endswith(".c")]
    values["SOURCES"] = " ".join([f"{name}.c", *compiled])
    values["INCLUDES"] = "".join(f'#include "{header}"\n' for header in headers)
    values["MEMBERS"] = "\n".join(f"    {member}" for member in sources.members)
    values["ABOUT"] = c.fill(f"readme_{arithmetic}.md", values)
    values["DIFFERENCE"] = c.fill(f"same_{arithmetic}.c", values)
    if arithmetic == "q31":
        values["CONSTANTS"] += c.fill("counts_q31.h", values)
    files = {file: c.kernel_file(file) for file in sources.kernel}
    files[f"{name}.h"] = c.fill("model.h", values)
    files[f"{name}.c"] = c.fill(f"{arithmetic}.c", values)
    files[f"{name}_test.c"] = c.fill("test.c", values)
    files["README.md"] = c.fill("README.md", values)
    return files


def _about_model(plan: Plan) -> dict[str, str]:
    """Return what goes in and comes out, in words."""
    displacement, drive = plan.forward.output, plan.forward.input
    into, out = c.plain(displacement.quantity), c.plain(drive.quantity)
    low, high = plan.limits.move
    unit = c.plain(plan.limits.suffix)
    drive_range = f"{low!r} to {high!r}{unit}"
    if plan.limits.slew is not None:
        drive_range += f", changing by at most {plan.limits.slew!r}{unit} a second"
    return {
        "TITLE": f"The drive of an actuator, {into} to {out}",
        "INPUT_NAME": into,
        "INPUT_RANGE": _range(displacement),
        "OUTPUT_NAME": out,
        "OUTPUT_RANGE": _range(drive),
        "LOWEST": f"{drive.min!r}{c.plain(drive.suffix)}",
        "KEPT": drive_range,
        "GEARS": str(plan.gears.n),
    }


def _range(quantity: Quantity) -> str:
    """Return a range with its unit, which ends no comment that it stands in."""
    return f"{quantity.min:.9g} to {quantity.max:.9g}{c.plain(quantity.suffix)}"


def _duties(
    plan: Plan, guard: str, sample_rate: float | None, loss: Loss | None
) -> dict[str, str]:
    """Return what a caller must do at a fixed rate and ahead, and what fewer gears lose."""
    constants = rate = ahead = lost = ""
    if sample_rate is not None:
        constants = f"#define {guard}_SAMPLE_RATE_HZ {sample_rate!r} /* call the step so often */\n"
        rate = (
            f"Call the step at a fixed {sample_rate:.12g} Hz: what depends on time is in the tables for that"
            " step; another rate is another export."
        )
    if plan.ahead:
        assert plan.dt is not None
        constants += f"#define {guard}_AHEAD {plan.ahead} /* samples: give the input so much earlier */\n"
        ahead = (
            f"Give the displacement that is wanted {plan.ahead} samples later ({plan.ahead * plan.dt:.9g} s):"
            " the drive is ahead of the actuator. Before a move, hold its first sample until what moves"
            " behind the gears has rung out."
        )
    if loss is not None:
        span, suffix = plan.forward.output.span, c.plain(plan.forward.output.suffix)
        lost = (
            f"{plan.gears.n} gears instead of the model's: {loss['max']:.3g}{suffix}"
            f" ({100.0 * loss['max'] / span:.2g} % of the range) at most, {loss['rms']:.3g}{suffix} RMS on"
            " test moves."
        )
    return {
        "CONSTANTS": constants,
        "RATE_DUTY": rate,
        "AHEAD_DUTY": ahead,
        "LOSS": lost,
    }


def _self_test(name: str, number: str, sources: c.Sources) -> dict[str, str]:
    """Return the vectors of NAME_test.c, and the calls that play them."""
    vectors, runs, count = "", "", 0
    for index, run in enumerate(sources.runs):
        vectors += c.array(number, f"inputs_{index}", run.inputs)
        vectors += c.array(number, f"expected_{index}", run.outputs)
        label, call = "after init", f"{name}_init(&state);"
        if run.reset is not None:
            label, call = "after reset", f"{name}_reset(&state, {run.reset});"
        arguments = f"inputs_{index}, expected_{index}, {len(run.inputs)}U"
        runs += f'    {call}\n    wrong += play("{label}", &state, {arguments});\n'
        count += len(run.inputs)
    return {"VECTORS": vectors, "RUNS": runs.rstrip("\n"), "COUNT": str(count)}
