"""A model as a folder of C sources with tables, self-test, build files and one page to read.

A model set, too, is one folder: one kernel, the tables of every channel, and calls of
all.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from importlib import resources
from typing import Any, Literal

from dbo_cli.drives.options import beyond_range, drive_limits
from dbo_cli.errors import DboError, ModelError, UsageError
from dbo_cli.extras.export import project_files as project
from dbo_cli.extras.export import source_text as c
from dbo_cli.extras.export.cascade_plan import (
    CascadePlan,
    Direction,
    plan_cascade,
    with_fewer_gears,
)
from dbo_cli.extras.export.double_code import double_code
from dbo_cli.extras.export.project_files import ExportSummary, Translated
from dbo_cli.extras.export.single_code import NarrowGearsError, single_code
from dbo_cli.hysteresis.model import ActuatorModel, DriveLimits

Arithmetic = Literal["double", "float", "q31"]
ARITHMETICS = ("double", "float", "q31")
# not of a channel in export.json
_OF_THE_SET = {"folder", "files", "warnings", "direction", "arithmetic"}
# types and functions, but not the names of files
_KERNEL_NAME = re.compile(r"\bdbo_\w+\b(?!\.)")


def export_model(
    model: ActuatorModel,
    folder: str,
    *,
    name: str = "actuator",
    direction: Direction = "inverse",
    arithmetic: Arithmetic = "double",
    sample_rate: float | None = None,
    gears: int | None = None,
    v_min: float | str | None = None,
    v_max: float | str | None = None,
    max_slew: float | str | None = None,
    extrapolate: bool = False,
    lookup: bool = False,
    arduino: bool = False,
    fmu: bool = False,
    shared: bool = False,
    overwrite: bool = False,
) -> ExportSummary:
    """Write a model as C sources for a controller, and return what they amount to.

    ``model`` is forward or inverse; it is turned as ``direction`` says. ``folder``
    appears whole or not at all; ``overwrite`` replaces one that an earlier export
    wrote. ``name`` begins the names of files, types and functions. An inverse takes
    displacement and gives the drive, as ``compensate``, within the range on which the
    model was identified, cut by ``v_min`` and ``v_max`` (beyond it with
    ``extrapolate``), and changing by at most ``max_slew`` a second (texts may have a
    unit, ``2kV/s``); a forward export takes the drive. double gives the bits of
    ``simulate`` and ``compensate``; float and q31 come with a derived bound.
    ``sample_rate`` is needed where relaxation, slew or a delay depends on it. ``gears``
    takes fewer than the model has. In double only: ``lookup`` (12 gears at most) is a
    table of all states, ``fmu`` adds an FMI 2.0 unit and ``shared`` a flat library,
    both compiled for this computer. ``arduino`` lays the files out as an Arduino
    library.

    Raises
    ------
    UsageError
        An argument contradicts another or is out of range; ``name`` is no usable
        identifier.
    ModelError
        A stage cannot be exported, or not in this arithmetic.
    OutputError
        The folder exists already or cannot be written; ``fmu`` or ``shared`` find no C
        compiler.
    """
    c.check_name(name)
    check_choices(
        arithmetic, direction, {"lookup": lookup, "fmu": fmu, "shared": shared}, arduino
    )
    project.check_folder(folder, overwrite)
    translation = translated(
        model, folder, name=name, direction=direction, arithmetic=arithmetic, sample_rate=sample_rate,
        gears=gears, v_min=v_min, v_max=v_max, max_slew=max_slew, extrapolate=extrapolate, lookup=lookup,
    )  # fmt: skip
    files = _files(translation, arduino, fmu, shared)
    summary = replace(translation.summary, files=(*sorted(files), project.MANIFEST))
    figures = asdict(summary)
    del figures["folder"], figures["warnings"]
    project.write_folder(folder, files, figures, overwrite)
    return summary


def translated(
    model: ActuatorModel, folder: str, *, name: str, direction: Direction, arithmetic: Arithmetic,
    lookup: bool, sample_rate: float | None = None, gears: int | None = None,
    v_min: float | str | None = None, v_max: float | str | None = None, max_slew: float | str | None = None,
    extrapolate: bool = False,
) -> Translated:  # fmt: skip
    """Translate a model into C; see ``export_model``."""
    model = replace(
        model,
        input=c.plain_quantity(model.input),
        output=c.plain_quantity(model.output),
    )
    loss: dict[str, float] = {}
    if gears is not None:
        model, loss = with_fewer_gears(model, gears)
    limits = _limits(model, direction, v_min, v_max, max_slew, extrapolate)
    plan = plan_cascade(model, direction, sample_rate, limits)
    try:
        if arithmetic == "double":
            code = double_code(plan, lookup)
        else:
            code = single_code(plan, arithmetic == "q31")
    except NarrowGearsError as problem:
        instead = "`arithmetic` double"
        if arithmetic == "float":
            instead = "`arithmetic` double or q31"
        raise ModelError(
            f"{problem} ({_gears_that_do(model, plan, arithmetic)}{instead})"
        ) from None
    words = _words(plan, name, arithmetic)
    count, run = plan.model.backlash.n, plan.model.backlash.equal_run
    # Towards the input; an inverse then to its limits, and back to where a drive lag's
    # own limits hold it.
    passes = 1
    if not plan.model.is_forward:
        passes = 2 if plan.model.drive_lag is None else 3
    warnings: tuple[str, ...] = ()
    if plan.limits is not None:
        beyond = beyond_range(plan.model.drive, plan.limits.v_min, plan.limits.v_max)
        if beyond:
            warnings = (f"the limits allow {beyond}",)
    summary = ExportSummary(
        folder=folder, name=name, direction=plan.model.direction, arithmetic=arithmetic, files=(),
        gears=count, table_rows=-(-count // run), run=run, table_bytes=code.table_bytes,
        state_bytes=code.state_bytes(count), worst_runs=most_runs(count, arithmetic) * passes,
        vectors=sum(len(part.inputs) for part in code.vectors), bounds=code.bounds, gears_loss=loss,
        notes=tuple(_notes(plan, loss, words)), warnings=warnings,
    )  # fmt: skip
    return Translated(plan, code, summary, words)


def _gears_that_do(model: ActuatorModel, plan: CascadePlan, arithmetic: str) -> str:
    """Return the remedy for gears that are too narrow: how many, halved until they do, are wide enough."""
    gears = plan.model.backlash.n // 2
    rate = None if plan.time_step is None else 1.0 / plan.time_step
    while gears:
        fewer, _ = with_fewer_gears(model, gears)
        coarse = plan_cascade(fewer, plan.model.direction, rate, plan.limits)
        try:
            single_code(coarse, arithmetic == "q31")
        except NarrowGearsError:
            gears //= 2
        else:
            return f"`gears` {gears}, or "
    return ""


def check_choices(
    arithmetic: str, direction: str, double_only: dict[str, bool], arduino: bool = False
) -> None:
    """Refuse choices that do not exist or contradict each other."""
    if arithmetic not in ARITHMETICS:
        raise UsageError(
            f"`arithmetic` {arithmetic!r}: there are {', '.join(ARITHMETICS)}"
        )
    if direction not in ("inverse", "forward"):
        raise UsageError(f"`direction` {direction!r}: there are inverse, forward")
    for option, wanted in double_only.items():
        if wanted and arithmetic != "double":
            raise UsageError(f"`{option}` needs `arithmetic` double")
    if arduino and (double_only["fmu"] or double_only["shared"]):
        raise UsageError("`arduino` goes with neither `fmu` nor `shared`: export twice")


def _limits(
    model: ActuatorModel, direction: Direction, v_min: float | str | None, v_max: float | str | None,
    max_slew: float | str | None, extrapolate: bool,
) -> DriveLimits | None:  # fmt: skip
    """Return the limits of an inverse's drive; a forward model has none."""
    if direction == "forward":
        if extrapolate or (v_min, v_max, max_slew) != (None, None, None):
            raise UsageError(
                "limits on the drive (`v_min`, `v_max`, `max_slew`, `extrapolate`) need `direction` inverse"
            )
        return None
    return drive_limits(model.drive, v_min, v_max, max_slew, extrapolate=extrapolate)


def most_runs(gears: int, arithmetic: str) -> int:
    """Return the most runs of gears that are crossed one way, one by one.

    Every other gear is a run at most. Behind the first gears, which are crossed before
    anything is looked up, the way goes on from a checkpoint, and every other turn up to
    the next checkpoint ends a run.
    """
    first_gears = 8 if arithmetic == "double" else 2  # SINGLE of the kernels
    return min(
        (gears + 1) // 2, first_gears + c.checkpoint_spacing(gears, arithmetic) // 2 + 1
    )


def _words(plan: CascadePlan, name: str, arithmetic: str) -> c.Values:
    """Return what every file of an export knows."""
    model = plan.model
    inverse = not model.is_forward
    takes, gives = "drive", "displacement"
    if inverse:
        takes, gives = "displacement wanted", "drive"
    rate = 0.0
    if plan.time_step is not None:
        rate = 1.0 / plan.time_step
    return {
        "NAME": name, "GUARD": name.upper(),
        "TITLE": f"The {plan.model.direction} hysteresis model of an actuator,"
        f" {model.input.quantity} to {model.output.quantity}",
        "ORIGIN": f"Written by dbo export from the model {model.digest[:16]}.",
        "MEANING": f"the {takes} in, the {gives} out",
        "timed": plan.time_step is not None, "ahead": plan.read_ahead > 0.0, "inverse": inverse,
        "alone": True, "counts": arithmetic == "q31", "AHEAD": repr(plan.read_ahead),
        **_places(model.backlash.n, arithmetic),
        "RATE": repr(rate),
    }  # fmt: skip


def _places(gears: int, arithmetic: str) -> dict[str, str]:
    """Return how the kernel counts gears and turns, where one operator has so many gears and none more."""
    return {
        "PLACE": f"uint{c.place_bits(gears)}_t",
        "SPACING": str(c.checkpoint_spacing(gears, arithmetic)),
    }


def _notes(plan: CascadePlan, loss: dict[str, float], words: c.Values) -> list[str]:
    """Return what the caller must know or do."""
    values: dict[str, str | bool] = {
        "loss": bool(loss),
        "GEARS": str(plan.model.backlash.n),
    }
    if plan.time_step is not None:
        steps = round(plan.read_ahead / plan.time_step, 6)
        values["SHOWN_RATE"] = f"{1.0 / plan.time_step:.12g}"
        samples = "samples" if steps > 1 else "sample"
        values["SHOWN_AHEAD"] = f"{plan.read_ahead:.9g} s ({steps:.6g} {samples})"
    if plan.limits is not None:
        unit = plan.model.drive.suffix
        most = f"{plan.limits.v_max!r}{unit}"
        if plan.limits.max_slew is not None:
            most += f", changing by at most {plan.limits.max_slew!r}{unit} a second"
        values["LEAST"] = repr(plan.limits.v_min)
        values["MOST_SLEW"] = most
    if loss:
        displacement = plan.model.output if plan.model.is_forward else plan.model.input
        unit = displacement.suffix
        values["LOSS"] = (
            f"{loss['max']:.3g}{unit} ({loss['max_percent']:.2g} % of the range) at most, "
            f"{loss['rms']:.3g}{unit}"
        )
    return c.fill("notes.md", {**words, **values}).splitlines()


def _files(
    translation: Translated, arduino: bool, fmu: bool, shared: bool
) -> dict[str, str | bytes]:
    """Return the content of every file by its path in the folder."""
    plan, code, summary, words = translation
    name = summary.name
    model_files = c.model_sources(words, code)
    test = model_files.pop(f"{name}_test.c")
    sources = model_files | kernel_files(words, summary.arithmetic, code.headers)
    files: dict[str, str | bytes] = {
        **project.project_files(translation, sources, test, arduino)
    }
    if shared:
        files |= project.library_files(words, sources)
    if fmu:
        files[f"{name}.fmu"] = project.fmu_bytes(plan, words, sources)
    return files


def kernel_files(
    words: c.Values, arithmetic: str, headers: tuple[str, ...]
) -> dict[str, str]:
    """Return the kernel's sources as they are, and headers that make their names this export's own."""
    name, guard = words["NAME"], words["GUARD"]
    package = resources.files("dbo_cli.hysteresis")
    firmware = resources.files("dbo_cli.extras.export") / "firmware"
    files: dict[str, str] = {}
    if c.INTERPOLATION in headers:
        files[c.INTERPOLATION] = c.interpolation_header(arithmetic)
    kernels = [
        header.removesuffix(".h") for header in headers if header != c.INTERPOLATION
    ]
    for file in ("dbo_kernel", *kernels):
        for kind in ("c", "h"):
            path = package / f"{file}.{kind}"
            if file == "dbo_lookup":
                path = firmware / f"{file}.{kind}"
            if arithmetic != "double":
                path = firmware / f"{file}_single.{kind}"
            files[f"{file}.{kind}"] = path.read_text(encoding="utf-8")
    names = sorted(
        {word for text in files.values() for word in _KERNEL_NAME.findall(text)}
    )
    for file in [file for file in files if file.endswith(".h")]:
        kernel_guard = file.upper().replace(".", "_")
        guards = {"OWN_GUARD": f"{guard}_{kernel_guard}", "KERNEL_GUARD": kernel_guard}
        files[file] = c.fill(
            "kernel_header.h", {"NAME": name, **guards, "text": files[file]}
        )
    defined = "".join(
        f"#undef {word}\n#define {word} {name}_{word}\n" for word in names
    )
    chosen = {key: arithmetic == key for key in ("float", "q31")}
    known = {
        **chosen,
        "names": defined,
        "PLACE": words["PLACE"],
        "SPACING": words["SPACING"],
    }
    return {**files, f"{name}_names.h": c.fill("NAME_names.h", known)}


def export_set(
    models: Mapping[str, ActuatorModel], folder: str, *, name: str = "actuator",
    direction: Direction = "inverse", arithmetic: Arithmetic = "double", lookup: bool = False,
    overwrite: bool = False, arduino: bool = False, fmu: bool = False, shared: bool = False, **options: Any,
) -> dict[str, ExportSummary]:  # fmt: skip
    """Write the models of a set as C sources with one kernel, and return what each channel amounts to.

    ``name`` begins the names of the set, with the channel behind it (``NAME_CHANNEL``)
    those of a channel. ``options`` are those of ``export_model``, the same for all
    channels.

    Raises
    ------
    DboError
        As ``export_model``, with the channel's name.
    UsageError
        Two channels would have the same names in C, or an option is of single models
        alone.
    """
    for option, wanted in {"arduino": arduino, "fmu": fmu, "shared": shared}.items():
        if wanted:
            raise UsageError(
                f"`{option}` is of one model: export a folder a channel (-o '{folder}/{{channel}}')"
            )
    c.check_name(name)
    check_choices(arithmetic, direction, {"lookup": lookup})
    project.check_folder(folder, overwrite)
    made = {}
    for channel, channel_name in _names(models, name).items():
        try:
            c.check_name(channel_name)
            made[channel] = translated(
                models[channel], folder, name=channel_name, direction=direction, arithmetic=arithmetic,
                lookup=lookup,
                **options,
            )  # fmt: skip
        except DboError as problem:
            raise type(problem)(f"channel {channel}: {problem}") from None
    most = max(translation.summary.gears for translation in made.values())
    for channel, translation in made.items():
        size = translation.code.state_bytes(most)
        made[channel] = translation._replace(
            summary=replace(translation.summary, state_bytes=size)
        )
    files = _set_files(made, name)
    listed = [*sorted(files), project.MANIFEST]
    channels = {}
    for channel, translation in made.items():
        summary = asdict(translation.summary)
        channels[channel] = {
            key: value for key, value in summary.items() if key not in _OF_THE_SET
        }
    figures = {
        "name": name,
        "direction": direction,
        "arithmetic": arithmetic,
        "files": listed,
        "channels": channels,
    }
    project.write_folder(folder, files, figures, overwrite)
    return {
        channel: replace(translation.summary, files=tuple(listed))
        for channel, translation in made.items()
    }


def _names(channels: Iterable[str], name: str) -> dict[str, str]:
    """Return what begins each channel's names, never different in case alone: some disks do not see it."""
    channel_names = {}
    taken = {"names", "test"}
    for channel in channels:
        word = re.sub(r"[^A-Za-z0-9_]", "_", channel)
        files = {word.lower(), f"{word.lower()}_test"}
        if files & taken or word.lower().startswith("dbo_"):
            raise UsageError(
                f"channel '{channel}': {name}_{word} is what files of the set or of another channel are"
                " called: rename the channel"
            )
        taken |= files
        channel_names[channel] = f"{name}_{word}"
    return channel_names


def _set_files(made: Mapping[str, Translated], name: str) -> dict[str, str]:
    """Return the content of every file."""
    first = next(iter(made.values()))
    arithmetic = first.summary.arithmetic
    words: dict[str, str | bool] = {
        **first.words, "NAME": name, "GUARD": name.upper(), "alone": False, "FIRST": first.summary.name,
        **_places(max(each.summary.gears for each in made.values()), arithmetic),
        "TITLE": f"The {first.plan.model.direction} hysteresis models of {len(made)} actuators",
        "ORIGIN": "Written by dbo export from a model set.", "COUNT": str(len(made)),
        "VECTORS": str(sum(each.summary.vectors for each in made.values())), "ARITHMETIC": arithmetic,
        "moving": any(each.plan.model.dynamics is not None for each in made.values()),
    }  # fmt: skip
    headers: dict[str, None] = {}  # each once, in their order
    for each in made.values():
        headers |= dict.fromkeys(each.code.headers)
    sources = kernel_files(words, arithmetic, tuple(headers))
    tests = {}
    for each in made.values():
        channel_files = c.model_sources({**each.words, "alone": False}, each.code)
        test = f"{each.summary.name}_test.c"
        tests[test] = channel_files.pop(test)
        sources |= channel_files
    lines = _lines(made, name)
    known = words | lines | {"NUMBER": first.code.number}
    sources |= {f"{name}.{kind}": c.fill(f"SET.{kind}", known) for kind in "hc"}
    values = (
        project.build_values(
            words, first.code.number, sources, [f"{name}_test.c", *tests]
        )
        | lines
    )
    pages = {
        "SET_main.c": "example_main.c",
        "SET_README.md": "README.md",
        "SET_test.c": f"{name}_test.c",
    }
    around = {file: c.fill(page, values) for page, file in pages.items()}
    return {**sources, **tests, **around, **project.build_files(values)}


CHANNEL_LINES = {
    "headers": '#include "{prefix}.h"',
    "states": "    {prefix}_state of_{place}; /* channel {channel} */",
    "inits": "    {prefix}_init(&state->of_{place});",
    "resets": "    {prefix}_reset(&state->of_{place}, drives[{place}]);",
    "steps": "    out[{place}] = {prefix}_step(&state->of_{place}, in[{place}]);",
    "prototypes": "unsigned {prefix}_self_test(void);",
    "runs": "    wrong += {prefix}_self_test();",
    "rows": "| {cells} |",
    "errors": "- {channel}: {SAME_GEARS}), {AFTER_CLOSE_TURN})",
}
"""The line that a set's files have for each channel, by the place that the lines take in the templates."""

CHANNEL_CELLS = (
    "{channel}",
    "`{prefix}_...`",
    "{INPUT_NAME}, {INPUT_RANGE}",
    "{OUTPUT_NAME}, {OUTPUT_RANGE}",
    "{GEARS}",
    "{TABLE_BYTES}",
    "{STATE_BYTES}",
    "{WORST_RUNS}",
)
"""The cells of a channel's row in the table of README.md."""


def _lines(made: Mapping[str, Translated], name: str) -> dict[str, str | bool]:
    """Return the lines that a set's files have for each channel."""
    lines: dict[str, list[str]] = {key: [] for key in CHANNEL_LINES}
    channels_of_note: dict[str, list[str]] = {}
    for place, (channel, translated) in enumerate(made.items()):
        prefix = translated.summary.name
        shown = c.plain(channel).replace("|", "/")
        values: dict[str, object] = {
            **project.shown_figures(translated),
            "place": place,
            "prefix": prefix,
            "channel": shown,
        }
        cells = [cell.format_map(values) for cell in CHANNEL_CELLS]
        values["cells"] = " | ".join(cells)
        for key, template in CHANNEL_LINES.items():
            lines[key].append(template.format_map(values))
        for note in (*translated.summary.notes, *translated.summary.warnings):
            of_set = note.replace(f"{prefix.upper()}_", f"{name.upper()}_CHANNEL_")
            channels_of_note.setdefault(of_set, []).append(shown)
    lines["duties"] = []
    for note, channels in channels_of_note.items():
        where = ""
        if len(channels) < len(made):
            where = f" (channel {', '.join(channels)})"
        lines["duties"].append(f"- {note}{where}")
    samples = [translated.code.sample_input for translated in made.values()]
    number = next(iter(made.values())).code.number
    lines["samples"] = [c.array(number, "samples", samples).rstrip()]
    return {key: "\n".join(rows) + "\n" for key, rows in lines.items()}
