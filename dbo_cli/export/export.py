"""A model as a folder of C sources with tables, self-test, and one page to read.

The files of a folder appear together or not at all, and only ever replace an export.
"""

import contextlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from dbo_cli.drive.limits import Limits
from dbo_cli.errors import OutputError, UsageError
from dbo_cli.export import text as c
from dbo_cli.export.double import double_sources
from dbo_cli.export.plan import Loss, Plan, with_fewer_gears
from dbo_cli.export.q31 import q31_sources
from dbo_cli.files import telling, write_all
from dbo_cli.model import Cascade
from dbo_cli.reports.words import json_text

IDENTIFIER = re.compile(r"(?!dboq?_)[A-Za-z][A-Za-z0-9_]{0,39}")  # dbo_: the kernel's
NUMBER_TYPES = {"double": "double", "q31": "int32_t"}
"""The arithmetics, and the type of what goes in and comes out."""
MANIFEST = "export.json"


class Export(NamedTuple):
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
    if not IDENTIFIER.fullmatch(name):
        raise UsageError(
            f"`name` {name}: give a C identifier of at most 40 letters, digits and underscores"
        )
    if lookup and arithmetic != "double":
        raise UsageError("`lookup` needs `arithmetic` double")
    forward, loss = model.forward(), None
    if gears is not None:
        forward, loss = with_fewer_gears(forward, gears)
    plan = Plan(forward, sample_rate, limits)
    figures: dict[str, Any] = {
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
        sources = q31_sources(plan)
        figures["bounds"] = sources.bounds
    values = {
        "NAME": name,
        "GUARD": name.upper(),
        "NUMBER": NUMBER_TYPES[arithmetic],
        "ARITHMETIC": arithmetic,
        "ORIGIN": f"Written by dbo export from the model {model.digest[:16]}.",
        **_about(plan, sample_rate, loss),
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
    values["TABLES"] = sources.tables
    defines = [f"#define {key} {value}\n" for key, value in sources.numbers.items()]
    values["NUMBERS"] = "".join(defines)
    values["MEMBERS"] = c.fill(f"state_{arithmetic}.c", values).rstrip()
    values["ABOUT"] = c.fill(f"readme_{arithmetic}.md", values)
    values["DIFFERENCE"] = c.fill(f"same_{arithmetic}.c", values)
    if sources.bounds:
        values["COUNTS"] = c.fill("counts_q31.h", values)
    files = {file: c.template_text(file) for file in sources.kernel}
    files[f"{name}.h"] = c.fill("model.h", values)
    files[f"{name}.c"] = c.fill(f"{arithmetic}.c", values)
    files[f"{name}_test.c"] = c.fill("test.c", values)
    files["README.md"] = c.fill("README.md", values)
    return files


def _about(plan: Plan, rate: float | None, loss: Loss | None) -> dict[str, str]:
    """Return what goes in and comes out, how a caller must call, and what fewer gears lose, in words."""
    displacement, drive, limits = plan.forward.output, plan.forward.input, plan.limits
    into, out = c.plain(displacement.quantity), c.plain(drive.quantity)
    unit, suffix = c.plain(limits.suffix), c.plain(displacement.suffix)
    low, high = limits.move
    values = {
        "TITLE": f"The drive of an actuator, {into} to {out}",
        "INPUT": f"{into} ({displacement.min:.9g} to {displacement.max:.9g}{suffix})",
        "OUTPUT": f"{out} ({drive.min:.9g} to {drive.max:.9g}{unit})",
        "LOWEST": f"{drive.min!r}{unit}",
        "KEPT": f"{low!r} to {high!r}{unit}",
        "GEARS": str(plan.gears.n),
    }
    if limits.slew is not None:
        values["KEPT"] += f", changing by at most {limits.slew!r}{unit} a second"
    if rate is not None:
        values |= {"RATE": repr(rate), "RATE_TEXT": f"{rate:.12g}"}
    if plan.ahead:
        values["AHEAD"] = str(plan.ahead)
    if loss is not None:
        values["LOSS"] = f"{loss['max']:.3g}{suffix} at most, {loss['rms']:.3g} RMS"
    return values


def _self_test(name: str, number: str, sources: c.Sources) -> dict[str, str]:
    """Return the vectors of NAME_test.c, and the calls that play them."""
    vectors, calls, count = "", [], 0
    for index, (reset, inputs, outputs) in enumerate(sources.runs):
        vectors += c.array(number, f"inputs_{index}", inputs, sources.input)
        vectors += c.array(number, f"expected_{index}", outputs, sources.drive)
        label, call = "after init", f"{name}_init(&state);"
        if reset is not None:
            label = "after reset"
            call = f"{name}_reset(&state, {sources.drive(reset)});"
        arguments = f"inputs_{index}, expected_{index}, {len(inputs)}U"
        calls.append(f"    {call}")
        calls.append(f'    wrong += play("{label}", &state, {arguments});')
        count += len(inputs)
    return {"VECTORS": vectors, "RUNS": "\n".join(calls), "COUNT": str(count)}


# --- the folder ---


def write_folder(
    folder: str, files: Mapping[str, str], figures: Mapping[str, Any]
) -> None:
    """Write files, and their ``figures`` as export.json, into a folder; an older export is replaced.

    Raises
    ------
    OutputError
        Writing failed, or the folder holds something else; what stood there stays.
    """
    names = [*sorted(files), MANIFEST]
    manifest = {"format": "dbo-export", "version": 1, **figures, "files": names}
    target, older = Path(folder), set()
    if target.is_dir():
        older = _files_of_export(target)
    contents = {**files, MANIFEST: json_text(manifest)}
    write_all(folder, {name: data.encode() for name, data in contents.items()})
    with telling(folder):
        for name in older - set(names):
            (target / name).unlink()


def _files_of_export(target: Path) -> set[str]:
    """Return what is in the folder of an older export; refuse what is neither its nor built from it."""
    names: set[str] = set()
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        manifest = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        if manifest["format"] == "dbo-export":
            names = {*manifest["files"], f"{manifest['name']}_test"}
    present = set(os.listdir(target))
    for name in sorted(present - names):
        if not name.endswith(".o"):
            raise OutputError(
                f"{target}: holds '{name}', which is not of an export: choose another folder"
            )
    return present
