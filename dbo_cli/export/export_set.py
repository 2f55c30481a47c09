"""A model set as one folder of C sources: one kernel, the tables of every channel, and calls of all."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from typing import Any

from dbo_cli.errors import DboError, UsageError
from dbo_cli.export import source_text as c
from dbo_cli.export.cascade_plan import Direction
from dbo_cli.export.export import (
    Arithmetic,
    Translated,
    check_choices,
    kernel_files,
    translated,
    write_export,
)
from dbo_cli.export.project_files import (
    MANIFEST,
    ExportSummary,
    build_files,
    build_values,
    check_folder,
    shown_figures,
)
from dbo_cli.hysteresis.model import ActuatorModel

_OF_THE_SET = {"folder", "files", "warnings", "direction", "arithmetic"}  # not of a channel in export.json


def export_set(
    models: Mapping[str, ActuatorModel], folder: str, *, name: str = "actuator",
    direction: Direction = "inverse", arithmetic: Arithmetic = "double", lookup: bool = False,
    overwrite: bool = False, arduino: bool = False, fmu: bool = False, shared: bool = False, **options: Any,
) -> dict[str, ExportSummary]:  # fmt: skip
    """Write the models of a set as C sources with one kernel, and return what each channel amounts to.

    ``name`` begins the names of the set, with the channel behind it (``NAME_CHANNEL``) those of a channel.
    ``options`` are those of ``export_model``, the same for all channels.

    Raises
    ------
    DboError
        As ``export_model``, with the channel's name.
    UsageError
        Two channels would have the same names in C, or an option is of single models alone.
    """
    for option, wanted in {"arduino": arduino, "fmu": fmu, "shared": shared}.items():
        if wanted:
            raise UsageError(
                f"`{option}` is of one model: export a folder a channel (-o '{folder}/{{channel}}')"
            )
    c.check_name(name)
    check_choices(arithmetic, direction, {"lookup": lookup})
    check_folder(folder, overwrite)
    made = {}
    for channel, own in _names(models, name).items():
        try:
            c.check_name(own)
            made[channel] = translated(
                models[channel], folder, name=own, direction=direction, arithmetic=arithmetic, lookup=lookup,
                **options,
            )  # fmt: skip
        except DboError as problem:
            raise type(problem)(f"channel {channel}: {problem}") from None
    files = _files(made, name)
    listed = [*sorted(files), MANIFEST]
    figures = {
        "name": name, "direction": direction, "arithmetic": arithmetic, "files": listed,
        "channels": {
            channel: {key: value for key, value in asdict(one.summary).items() if key not in _OF_THE_SET}
            for channel, one in made.items()
        },
    }  # fmt: skip
    write_export(folder, files, figures, overwrite)
    return {channel: replace(one.summary, files=tuple(listed)) for channel, one in made.items()}


def _names(channels: Iterable[str], name: str) -> dict[str, str]:
    """Return what begins each channel's names, never different in case alone: some disks do not see it."""
    found, taken = {}, {"names", "test"}
    for channel in channels:
        word = re.sub(r"[^A-Za-z0-9_]", "_", channel)
        files = {word.lower(), f"{word.lower()}_test"}
        if files & taken or word.lower().startswith("dbo_"):
            raise UsageError(
                f"channel '{channel}': {name}_{word} is what files of the set or of another channel are"
                " called: rename the channel"
            )
        taken |= files
        found[channel] = f"{name}_{word}"
    return found


def _files(made: Mapping[str, Translated], name: str) -> dict[str, str]:
    """Return the content of every file."""
    one = next(iter(made.values()))
    arithmetic = one.summary.arithmetic
    words: dict[str, str | bool] = {
        **one.words, "NAME": name, "GUARD": name.upper(), "alone": False, "FIRST": one.summary.name,
        "TITLE": f"The {one.plan.direction} hysteresis models of {len(made)} actuators",
        "ORIGIN": "Written by dbo export from a model set.", "COUNT": str(len(made)),
        "VECTORS": str(sum(each.summary.vectors for each in made.values())), "ARITHMETIC": arithmetic,
        "moving": any(each.plan.model.dynamics is not None for each in made.values()),
    }  # fmt: skip
    headers = tuple(dict.fromkeys(header for each in made.values() for header in each.code.headers))
    sources, tests = kernel_files(words, arithmetic, headers), {}
    for each in made.values():
        own = c.model_sources({**each.words, "alone": False}, each.code)
        test = f"{each.summary.name}_test.c"
        tests[test] = own.pop(test)
        sources |= own
    lines = _lines(made, name)
    known = words | lines | {"NUMBER": one.code.number}
    sources |= {f"{name}.{kind}": c.fill(f"SET.{kind}", known) for kind in "hc"}
    values = build_values(words, one.code.number, sources, [f"{name}_test.c", *tests]) | lines
    pages = {"SET_main.c": "example_main.c", "SET_README.md": "README.md", "SET_test.c": f"{name}_test.c"}
    around = {file: c.fill(page, values) for page, file in pages.items()}
    return {**sources, **tests, **around, **build_files(values)}


def _lines(made: Mapping[str, Translated], name: str) -> dict[str, str | bool]:
    """Return the lines that a set's files have for each channel."""
    found: dict[str, list[str]] = {}
    duties: dict[str, list[str]] = {}
    for place, (channel, one) in enumerate(made.items()):
        own, shown = one.summary.name, c.plain(channel).replace("|", "/")
        figures = shown_figures(one.plan, one.summary)
        cells = (
            shown, f"`{own}_...`",
            *(f"{figures[f'{way}_NAME']}, {figures[f'{way}_RANGE']}" for way in ("INPUT", "OUTPUT")),
            *(str(figures[key]) for key in ("GEARS", "TABLE_BYTES", "STATE_BYTES")),
            f"{figures['WORST_BLOCKS']}, {figures['WORST_GEARS']}",
        )  # fmt: skip
        for key, line in {
            "headers": f'#include "{own}.h"',
            "states": f"    {own}_state of_{place}; /* channel {shown} */",
            "inits": f"    {own}_init(&state->of_{place});",
            "resets": f"    {own}_reset(&state->of_{place}, drives[{place}]);",
            "steps": f"    out[{place}] = {own}_step(&state->of_{place}, in[{place}]);",
            "prototypes": f"unsigned {own}_self_test(void);",
            "runs": f"    wrong += {own}_self_test();",
            "rows": f"| {' | '.join(cells)} |",
            "errors": f"- {shown}: {figures['SAME_GEARS']}), {figures['AFTER_CLOSE_TURN']})",
        }.items():
            found.setdefault(key, []).append(line)
        for note in (*one.summary.notes, *one.summary.warnings):
            duties.setdefault(note.replace(f"{own.upper()}_", f"{name.upper()}_CHANNEL_"), []).append(shown)
    samples = [one.code.vectors[0].inputs[10] for one in made.values()]
    found["duties"] = [
        f"- {note}" + (f" (channel {', '.join(of)})" if len(of) < len(made) else "")
        for note, of in duties.items()
    ]
    found["samples"] = [c.array(next(iter(made.values())).code.number, "samples", samples).rstrip()]
    return {key: "\n".join(lines) + "\n" for key, lines in found.items()}
