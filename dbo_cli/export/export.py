"""A model as a folder of C sources with tables, self-test, and one page to read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dbo_cli.drive.limits import Limits
from dbo_cli.errors import UsageError
from dbo_cli.export import text as c
from dbo_cli.export.double import double_sources
from dbo_cli.export.plan import Loss, Plan, plan_of, with_fewer_gears
from dbo_cli.export.q31 import q31_sources
from dbo_cli.export.q31_bounds import Bounds
from dbo_cli.model import Model, Quantity

ARITHMETICS = ("double", "q31")
CLOSE_TURNS = 2
"""One in so many samples of the self-test of q31 may come after a turn on a gear's end.
Of 276 random models one left the first bound in 48 % of the samples of a move, the others in 7 % at most.
"""
_NUMBERS = {"double": "double", "q31": "int32_t"}


@dataclass(frozen=True)
class Export:
    """A model as C.

    Attributes
    ----------
    files : dict
        Texts by the names of their files.
    figures : dict
        Gears, samples ahead, bounds and losses, for programs.
    notes : list of str
        What the caller must know or do.
    """

    files: dict[str, str]
    figures: dict[str, Any]
    notes: list[str]


def export_model(
    model: Model,
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
        Fewer gears than the model has; what is lost is said.
    lookup : bool
        The gears as a table of all states, for 12 gears at most.

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
    if arithmetic not in ARITHMETICS:
        raise UsageError(
            f"`arithmetic` {arithmetic}: there are {', '.join(ARITHMETICS)}"
        )
    if lookup and arithmetic != "double":
        raise UsageError("`lookup` needs `arithmetic` double")
    forward, loss = model.forward(), None
    if gears is not None:
        forward, loss = with_fewer_gears(forward, gears)
    plan = plan_of(forward, sample_rate, limits)
    bounds = None
    if arithmetic == "double":
        sources = double_sources(plan, lookup)
    else:
        sources, bounds = q31_sources(plan)
    return _assembled(plan, sources, bounds, loss, name, arithmetic, model.digest)


def _assembled(
    plan: Plan,
    sources: c.Sources,
    bounds: Bounds | None,
    loss: Loss | None,
    name: str,
    arithmetic: str,
    digest: str,
) -> Export:
    """Return every file, filled in."""
    notes = _notes(plan, loss, name, arithmetic)
    number = _NUMBERS[arithmetic]
    drive, wanted = _plain(plan.model.output), _plain(plan.model.input)
    values = {
        **sources.values,
        "NAME": name,
        "GUARD": name.upper(),
        "NUMBER": number,
        "ARITHMETIC": arithmetic,
        "TITLE": f"The drive of an actuator, {wanted.quantity} to {drive.quantity}",
        "ORIGIN": f"Written by dbo export from the model {digest[:16]}.",
        "INCLUDES": _includes(sources),
        "CONSTANTS": _constants(plan, name, arithmetic),
        "MEMBERS": "".join(f"    {member}\n" for member in sources.members).rstrip(
            "\n"
        ),
        "EMPTY": _empty(plan, arithmetic),
    }
    files = {file: c.kernel_file(file) for file in sources.kernel}
    files[f"{name}.h"] = c.fill("model.h", values)
    files[f"{name}.c"] = c.fill(f"{arithmetic}.c", values)
    files[f"{name}_test.c"] = _self_test(values, sources, bounds)
    figures = _figures(plan, sources, bounds, loss, name, arithmetic)
    page = _page(plan, sources, bounds, figures, notes)
    files["README.md"] = c.fill("README.md", {**values, **page})
    return Export(files, figures, notes)


def _plain(quantity: Quantity) -> Quantity:
    """Return a quantity whose name and unit end no comment that they stand in."""
    unit = quantity.unit and c.plain(quantity.unit)
    return replace(quantity, quantity=c.plain(quantity.quantity), unit=unit)


def _includes(sources: c.Sources) -> str:
    headers = [file for file in sources.kernel if file.endswith(".h")]
    return "".join(f'#include "{header}"\n' for header in headers)


def _constants(plan: Plan, name: str, arithmetic: str) -> str:
    """Return what a caller needs of a model: its rate, how far it reads ahead, counts of q31."""
    guard, text = name.upper(), ""
    if plan.dt is not None:
        text += f"#define {guard}_SAMPLE_RATE_HZ {1.0 / plan.dt!r} /* call the step so often */\n"
    if plan.ahead:
        text += f"#define {guard}_AHEAD {plan.ahead} /* samples: give the input so much earlier */\n"
    if arithmetic == "double":
        return text
    wanted, drive = plan.model.input, plan.model.output
    middle, per_unit = 0.5 * (wanted.min + wanted.max), 2.0**31 / wanted.span
    scaled = f"(((x) - {middle!r}) * {per_unit!r})"
    return text + (
        f"#define {guard}_IGNORED (-2147483647 - 1) /* no number: the last output comes again */\n"
        f"/* {c.plain(wanted.quantity)}{c.plain(wanted.suffix)} to counts, IGNORED beyond twice the range;"
        f" and counts to {c.plain(drive.quantity)}{c.plain(drive.suffix)} */\n"
        f"#define {guard}_IN(x) \\\n    ({scaled} > -2147483648.0 && {scaled} < 2147483648.0 \\\n"
        f"         ? (int32_t){scaled} : {guard}_IGNORED)\n"
        f"#define {guard}_OUT(q) ((q) * {drive.span / 2.0**31!r} + {0.5 * (drive.min + drive.max)!r})\n"
    )


def _empty(plan: Plan, arithmetic: str) -> str:
    """Say what NAME_init takes for granted."""
    if not plan.gain.size:
        return "no gear of the range is engaged"
    if arithmetic == "double":
        return "no gear of the range is engaged, and the actuator rests at the first sample"
    return "no gear of the range is engaged, and the actuator rests there"


def _notes(plan: Plan, loss: Loss | None, name: str, arithmetic: str) -> list[str]:
    """Return what the caller must know or do."""
    notes = []
    if plan.dt is not None:
        notes.append(
            f"Call the step at a fixed {1.0 / plan.dt:.12g} Hz: what depends on time is in the tables for"
            " that step; another rate is another export."
        )
    if plan.ahead:
        assert plan.dt is not None
        notes.append(
            f"Give the displacement that is wanted {plan.ahead} samples later ({plan.ahead * plan.dt:.9g} s):"
            " the drive is ahead of the actuator. Where the move is not known in advance, it comes so much"
            " late."
        )
    low, high = plan.limits.move
    unit = plan.limits.suffix
    kept = f"{low!r} to {high!r}{unit}"
    if plan.limits.slew is not None:
        kept += f", changing by at most {plan.limits.slew!r}{unit} a second"
    notes.append(
        f"The drive is kept within {kept}; the range wins over the slew limit. Where a limit binds, the"
        " state is that of the actuator as it is driven."
    )
    if loss is not None:
        span, suffix = plan.model.input.span, plan.model.input.suffix
        notes.append(
            f"{plan.gears.n} gears instead of the model's: {loss.most:.3g}{suffix}"
            f" ({100.0 * loss.most / span:.2g} % of the range) at most, {loss.rms:.3g}{suffix} RMS on test"
            " moves."
        )
    ignored = "Inputs that are no numbers, or absurd, are ignored: the last output comes again."
    if arithmetic == "q31":
        ignored = (
            f"`{name.upper()}_IN(x)` gives `{name.upper()}_IGNORED` for what is no number or beyond twice the"
            " range, and the last output comes again; it reads x more than once."
        )
    return [*notes, ignored]


def _figures(
    plan: Plan,
    sources: c.Sources,
    bounds: Bounds | None,
    loss: Loss | None,
    name: str,
    arithmetic: str,
) -> dict[str, Any]:
    """Return the figures of an export."""
    run = plan.gears.equal_run
    figures: dict[str, Any] = {
        "name": name,
        "arithmetic": arithmetic,
        "sample_rate": None if plan.dt is None else 1.0 / plan.dt,
        "limits": plan.limits.as_dict(),
        "gears": plan.gears.n,
        "table_rows": -(-plan.gears.n // run),
        "run": run,
        "ahead": plan.ahead,
        "self_test": sum(len(run.inputs) for run in sources.runs),
    }
    if bounds is not None:
        figures["bounds"] = bounds._asdict()
    if loss is not None:
        figures["loss"] = {"max": loss.most, "rms": loss.rms}
    return figures


def _self_test(
    values: dict[str, str], sources: c.Sources, bounds: Bounds | None
) -> str:
    """Return NAME_test.c."""
    number, name = values["NUMBER"], values["NAME"]
    vectors, runs = "", ""
    for place, run in enumerate(sources.runs):
        vectors += c.array(number, f"inputs_{place}", run.inputs)
        vectors += c.array(number, f"expected_{place}", run.outputs)
        label, call = "after init", f"{name}_init(&state);"
        if run.reset is not None:
            label, call = "after reset", f"{name}_reset(&state, {run.reset});"
        runs += (
            f"    {call}\n"
            f'    wrong += play("{label}", &state, inputs_{place}, expected_{place}, {len(run.inputs)}U);\n'
        )
    how, passed, allowed = ", to the last bit", "every bit as expected", 0
    difference = (
        "static unsigned difference(double got, double expected) {\n"
        "    union {\n        double value;\n        uint64_t bits;\n    } a, b;\n"
        "    a.value = got;\n    b.value = expected;\n    return a.bits != b.bits;\n}\n"
    )
    count = sum(len(run.inputs) for run in sources.runs)
    if bounds is not None:
        how, passed = ", within the bounds of README.md", "all within the bounds"
        allowed = count // CLOSE_TURNS
        difference = (
            "/* In counts; after a turn on a gear's end the wider bound holds. */\n"
            "static unsigned difference(int32_t got, int32_t expected) {\n"
            "    const int64_t way = (int64_t)got - expected, apart = way < 0 ? -way : way;\n"
            f"    if (apart <= {bounds.same_counts}) return 0U;\n"
            f"    return apart <= {bounds.close_counts} ? 1U : {count}U;\n}}\n"
        )
    made = {
        "VECTORS": vectors, "RUNS": runs.rstrip("\n"), "DIFFERENCE": difference,
        "ALLOWED": str(allowed), "HOW": how, "PASSED": passed,
        "COUNT": str(count),
    }  # fmt: skip
    return c.fill("test.c", {**values, **made})


def _page(
    plan: Plan,
    sources: c.Sources,
    bounds: Bounds | None,
    figures: dict[str, Any],
    notes: Sequence[str],
) -> dict[str, str]:
    """Return what README.md shows."""
    wanted, drive = _plain(plan.model.input), _plain(plan.model.output)
    name = figures["name"]
    compiled = [f"{name}.c"]
    compiled += [file for file in sources.kernel if file.endswith(".c")]
    page = {
        "SOURCES": " ".join(compiled),
        "PLACE": "DBO_PLACE",
        "FLAGS": "`-ffp-contract=off`, never `-ffast-math`: a fused multiply-add rounds once where the tables"
        " expect two roundings. `-DDBO_SMALL` more than halves the kernel's code and changes no bit.",
        "GEARS": str(figures["gears"]),
        "TABLE_ROWS": str(figures["table_rows"]),
        "RUN": str(figures["run"]),
        "COUNT": str(figures["self_test"]),
        "INPUT_NAME": wanted.quantity,
        "INPUT_RANGE": f"{wanted.min:.9g} to {wanted.max:.9g}{wanted.suffix}",
        "OUTPUT_NAME": drive.quantity,
        "OUTPUT_RANGE": f"{drive.min:.9g} to {drive.max:.9g}{drive.suffix}",
        "COUNTS": "",
        "LOWEST": f"{drive.min!r}{drive.suffix}",
        "MOVING": "",
        "DUTIES": "\n".join(f"- {note}" for note in notes),
        "ERRORS": "The output is that of `dbo compensate` from the same state, bit for bit.",
    }
    if plan.ahead:
        page["MOVING"] = (
            " What moves behind the gears is at rest at the first sample: hold that until it has rung out."
        )
    if bounds is not None:
        page |= {
            "PLACE": "DBOQ_PLACE",
            "FLAGS": "Any: all arithmetic is in whole numbers.",
            "COUNTS": f" As 32-bit counts: the middle of a range is 0, its ends are ±2^30;"
            f" `{name.upper()}_IN(x)` and `{name.upper()}_OUT(y)` convert.",
            "ERRORS": bounds.text(drive, figures["gears"]),
        }
    return page
