"""A model as a folder of C sources with tables, self-test, build files and one page to read."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from importlib import resources
from typing import Literal

from dbo_cli.errors import UsageError
from dbo_cli.export import project_files
from dbo_cli.export.c_frame import SourceParts, header, self_test, source
from dbo_cli.export.c_text import check_name
from dbo_cli.export.cascade_plan import CascadePlan, Direction, plan_cascade
from dbo_cli.export.double_code import double_parts, read_ahead
from dbo_cli.export.export_folder import FORMAT, MANIFEST, check_folder, write_folder
from dbo_cli.export.fewer_gears import with_fewer_gears
from dbo_cli.export.fmu import fmu_bytes
from dbo_cli.export.host_library import compile_library, library_sources, library_suffix
from dbo_cli.export.single_code import single_parts
from dbo_cli.export.summary import ExportSummary
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits

Arithmetic = Literal["double", "float", "q31"]
ARITHMETICS = ("double", "float", "q31")


def export_model(
    model: ActuatorModel,
    folder: str,
    *,
    name: str = "actuator",
    direction: Direction = "inverse",
    arithmetic: Arithmetic = "double",
    sample_rate: float | None = None,
    gears: int | None = None,
    v_min: float | None = None,
    v_max: float | None = None,
    max_slew: float | None = None,
    lookup: bool = False,
    arduino: bool = False,
    fmu: bool = False,
    shared: bool = False,
    overwrite: bool = False,
) -> ExportSummary:
    """Write a model as C sources for a controller, and return what they amount to.

    Parameters
    ----------
    model : ActuatorModel
        Forward or inverse; it is turned as ``direction`` says.
    folder : str
        Where the files go; appears whole or not at all.
    name : str
        Begins the names of files, types and functions: a C identifier.
    direction : {"inverse", "forward"}
        Inverse: displacement in, drive out, as ``compensate``. Forward: drive in, displacement out.
    arithmetic : {"double", "float", "q31"}
        double gives the bits of ``simulate`` and ``compensate``; the others come with a derived bound.
    sample_rate : float, optional
        Samples per second; needed where relaxation, a slew limit or a delay depends on it.
    gears : int, optional
        Fewer gears than the model has; the loss is in the summary.
    v_min, v_max : float, optional
        Limits of an inverse's drive; the model's range where not given.
    max_slew : float, optional
        The largest change of an inverse's drive in one second.
    lookup : bool
        A table of all states in place of the recursion: 12 gears at most, double only.
    arduino : bool
        Lay the files out as an Arduino library.
    fmu : bool
        Add NAME.fmu, an FMI 2.0 co-simulation unit with sources and this computer's binary; double only.
    shared : bool
        Add a flat C library with its header, compiled for this computer; double only.
    overwrite : bool
        Replace a folder that an earlier export wrote.

    Raises
    ------
    UsageError
        An argument contradicts another or is out of range; ``name`` is no usable identifier.
    ModelError
        A stage cannot be exported, or not in this arithmetic.
    OutputError
        The folder exists already or cannot be written; ``fmu`` or ``shared`` find no C compiler.
    """
    check_name(name)
    _check_choices(arithmetic, direction, {"lookup": lookup, "fmu": fmu, "shared": shared}, arduino)
    check_folder(folder, overwrite)
    loss: dict[str, float] = {}
    if gears is not None:
        model, loss = with_fewer_gears(model, gears)
    plan = plan_cascade(model, direction, sample_rate, _limits(model, direction, v_min, v_max, max_slew))
    parts, table_bytes, bounds = _parts(plan, arithmetic, lookup)
    title, origin = _title(plan), _origin(model)
    run = plan.backlash.equal_run
    rows = -(-plan.backlash.n // run)
    again = direction == "inverse" and plan.model.drive_lag is not None  # a sample that the limits hold back
    summary = ExportSummary(
        folder=folder, name=name, direction=direction, arithmetic=arithmetic, files=(),
        gears=plan.backlash.n, table_rows=rows, run=run, table_bytes=table_bytes,
        state_bytes=_state_bytes(parts), worst_runs=rows * (2 if again else 1),
        vectors=sum(len(run.inputs) for run in parts.vectors), bounds=bounds, gears_loss=loss,
        notes=tuple(_notes(plan, loss)),
    )  # fmt: skip
    files: dict[str, str | bytes] = dict(_files(plan, parts, summary, title, origin, arduino))
    files |= _host_files(plan, name, title, files, fmu, shared)
    summary = dataclasses.replace(summary, files=(*sorted(files), MANIFEST))
    manifest = {"format": FORMAT, "version": 1, **dataclasses.asdict(summary)}
    del manifest["folder"]
    files[MANIFEST] = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
    content = {key: text.encode() if isinstance(text, str) else text for key, text in files.items()}
    write_folder(folder, content, overwrite)
    return summary


def _check_choices(arithmetic: str, direction: str, double_only: dict[str, bool], arduino: bool) -> None:
    """Refuse choices that do not exist or contradict each other."""
    if arithmetic not in ARITHMETICS:
        raise UsageError(f"`arithmetic` {arithmetic!r}: there are {', '.join(ARITHMETICS)}")
    if direction not in ("inverse", "forward"):
        raise UsageError(f"`direction` {direction!r}: there are inverse, forward")
    for option, wanted in double_only.items():
        if wanted and arithmetic != "double":
            raise UsageError(f"`{option}` needs `arithmetic` double")
    if arduino and (double_only["fmu"] or double_only["shared"]):
        raise UsageError("`arduino` goes with neither `fmu` nor `shared`: export twice")


def _limits(
    model: ActuatorModel, direction: Direction, v_min: float | None, v_max: float | None,
    max_slew: float | None,
) -> DriveLimits | None:  # fmt: skip
    """Return the limits of an inverse's drive: those given, else the model's range."""
    given = v_min is not None or v_max is not None or max_slew is not None
    if direction == "forward":
        if given:
            raise UsageError("limits on the drive (`v_min`, `v_max`, `max_slew`) need `direction` inverse")
        return None
    drive = model.input if model.direction == "forward" else model.output
    return DriveLimits(
        drive.minimum if v_min is None else v_min, drive.maximum if v_max is None else v_max, max_slew
    )


def _parts(
    plan: CascadePlan, arithmetic: Arithmetic, lookup: bool
) -> tuple[SourceParts, int, dict[str, float]]:
    if arithmetic == "double":
        return *double_parts(plan, lookup), {}
    return single_parts(plan, arithmetic == "q31")


def _title(plan: CascadePlan) -> str:
    before, behind = plan.model.input, plan.model.output
    arrow = f"{before.quantity} to {behind.quantity}"
    return f"The {plan.direction} hysteresis model of an actuator, {arrow}"


def _origin(model: ActuatorModel) -> str:
    return f"Written by dbo export from the model {model.digest[:16]}."


def _state_bytes(parts: SourceParts) -> int:
    """Return the size of the state on a 32-bit chip, its members at their natural alignment."""
    sizes = {
        "uint64_t": (8, 8), "double": (8, 8), "float": (4, 4), "int32_t": (4, 4), "uint32_t": (4, 4),
        "size_t": (4, 4), "int": (4, 4), "dbo_backlash_state": (40, 8), "dbo_lookup_state": (16, 8),
        "dbo_section_state": (24, 8), "dbo_inverse_state": (24, 8),
        "dbo_memory": (8, 4 if parts.number == "float" else 8),
    }  # fmt: skip
    total = 0
    for member in [*parts.members, f"{parts.number} output;"]:
        kind, declared = member.removesuffix(";").split(" ", 1)
        count = int(declared.split("[")[1].rstrip("]")) if "[" in declared else 1
        size, alignment = sizes[kind]
        total = -(-total // alignment) * alignment + size * count
    return -(-total // 8) * 8


def _notes(plan: CascadePlan, loss: dict[str, float]) -> list[str]:
    notes = []
    unit = f" {plan.model.output.unit}" if plan.model.output.unit else ""
    if plan.time_step is not None:
        notes.append(
            f"Call the step at a fixed {1.0 / plan.time_step:.12g} Hz: lag, creep and slew are in the tables"
            " for that step; another rate is another export."
        )
    ahead = read_ahead(plan)
    if ahead > 0.0:
        steps = 0.0 if plan.time_step is None else round(ahead / plan.time_step, 6)
        samples = "" if plan.time_step is None else f" ({steps:.6g} sample{'s' if steps > 1 else ''})"
        notes.append(
            f"Read {ahead:.9g} s{samples} ahead: give the displacement that is wanted so much later. Where"
            " the trajectory is not known in advance, the actuator lags by that time."
        )
    if plan.limits is not None:
        slew = (
            "" if plan.limits.max_slew is None else f", changing by at most {plan.limits.max_slew!r} a second"
        )
        notes.append(
            f"The drive is kept within {plan.limits.v_min!r} ... {plan.limits.v_max!r}{unit}{slew};"
            " the range wins over the slew limit. Where a limit binds, the state is that of the actuator as"
            " it is driven."
        )
    if loss:
        forward_unit = plan.model.input.unit if plan.direction == "inverse" else plan.model.output.unit
        tail = f" {forward_unit}" if forward_unit else ""
        notes.append(
            f"{plan.backlash.n} gears instead of the model's: {loss['max']:.3g}{tail}"
            f" ({loss['max_percent']:.2g} % of the range) at most, {loss['rms']:.3g}{tail} RMS on test moves."
        )
    notes.append("Inputs that are no numbers, or absurd, are ignored: the last output comes again.")
    return notes


def _firmware(file: str) -> str:
    return (resources.files("dbo_cli.hysteresis") / file).read_text(encoding="utf-8")


def _kernel_files(arithmetic: str, headers: tuple[str, ...]) -> dict[str, str]:
    """Return the kernel's sources under the names they have in every export."""
    folder = resources.files("dbo_cli.export") / "firmware"
    if arithmetic == "double":
        files = {file: _firmware(file) for file in ("dbo_kernel.c", "dbo_kernel.h")}
        if "dbo_dynamics.h" in headers:
            files |= {file: _firmware(file) for file in ("dbo_dynamics.c", "dbo_dynamics.h")}
        if "dbo_lookup.h" in headers:
            files |= {f: (folder / f).read_text(encoding="utf-8") for f in ("dbo_lookup.c", "dbo_lookup.h")}
        return files
    chosen = "#define DBO_Q31\n" if arithmetic == "q31" else "#define DBO_FLOAT\n"
    head = (folder / "dbo_kernel_single.h").read_text(encoding="utf-8")
    return {
        "dbo_kernel.c": (folder / "dbo_kernel_single.c").read_text(encoding="utf-8"),
        "dbo_kernel.h": head.replace("/* the arithmetic: DBO_FLOAT or DBO_Q31 */\n", chosen),
    }


def _files(
    plan: CascadePlan, parts: SourceParts, summary: ExportSummary, title: str, origin: str, arduino: bool
) -> dict[str, str]:
    """Return the text of every file by its path in the folder."""
    name = summary.name
    what = "the displacement wanted in, the drive out" if plan.direction == "inverse" else (
        "the drive in, the displacement out"
    )  # fmt: skip
    small = summary.arithmetic == "double"
    code = {
        f"{name}.h": header(name, title, origin, parts, what),
        f"{name}.c": source(name, title, origin, parts),
        **_kernel_files(summary.arithmetic, parts.kernel_headers),
    }
    test = self_test(name, title, parts)
    sources = " ".join([f"{name}.c", *sorted(f for f in code if f.startswith("dbo_") and f.endswith(".c"))])
    headers = " ".join([f"{name}.h", *sorted(f for f in code if f.startswith("dbo_") and f.endswith(".h"))])
    units = _units(plan, name, summary.arithmetic)
    page = project_files.readme(plan, summary, title, origin, units, sources)
    if arduino:
        return {
            **{f"src/{file}": text for file, text in code.items()},
            f"extras/{name}_test.c": test,
            f"examples/{name}/{name}.ino": project_files.arduino_sketch(name, parts.number),
            "library.properties": project_files.arduino_properties(name, title, "1.0.0"),
            "README.md": page,
        }
    middle = parts.vectors[0].inputs[10]
    return {
        **code,
        f"{name}_test.c": test,
        "example_main.c": project_files.example(plan, name, parts.number, f"k < 10U ? {middle} : 0"),
        "Makefile": project_files.makefile(name, sources, headers, "-DDBO_SMALL" if small else ""),
        "CMakeLists.txt": project_files.cmake(name, sources, "DBO_SMALL" if small else ""),
        "README.md": page,
    }


def _host_files(
    plan: CascadePlan, name: str, title: str, files: Mapping[str, str | bytes], fmu: bool, shared: bool
) -> dict[str, str | bytes]:
    """Return what is compiled for this computer: the FMU, the flat library with its sources."""
    kernel = [file for file in files if file.startswith("dbo_") or file in (f"{name}.c", f"{name}.h")]
    code = {file: text for file in kernel if isinstance(text := files[file], str)}
    found: dict[str, str | bytes] = {}
    if shared:
        rate = 0.0 if plan.time_step is None else 1.0 / plan.time_step
        flat = library_sources(name, title, rate, read_ahead(plan))
        found |= flat
        found[f"lib{name}{library_suffix()}"] = compile_library({**code, **flat})
    if fmu:
        found[f"{name}.fmu"] = fmu_bytes(plan, name, title, code)
    return found


def _units(plan: CascadePlan, name: str, arithmetic: str) -> str:
    parts = []
    for way, quantity in (("in", plan.model.input), ("out", plan.model.output)):
        unit = f" {quantity.unit}" if quantity.unit else ""
        parts.append(f"{quantity.quantity} {way}, {quantity.minimum:.9g} to {quantity.maximum:.9g}{unit}")
    if arithmetic != "q31":
        return "; ".join(parts) + "; beyond the range the last slope goes on."
    return (
        "; ".join(parts)
        + f". As 32-bit counts: the middle of a range is 0, its ends are ±2^30; `{name.upper()}_IN(x)`"
        f" and `{name.upper()}_OUT(y)` convert constants and results."
    )
