"""The files around the sources: build files, an example, the Arduino layout, the page and its figures.

What is compiled for this computer, too: a flat C library, which LabVIEW, MATLAB, Julia
and ctypes can call, and an FMI 2.0 co-simulation unit, which has a model description,
the sources and this computer's binary. The folder of an export appears whole or not at
all, and only ever replaces an export.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import secrets
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

from dbo_cli.errors import OutputError
from dbo_cli.extras.export.cascade_plan import CascadePlan
from dbo_cli.extras.export.source_text import ModelCode, Values, fill
from dbo_cli.hysteresis.model import Quantity

MANIFEST = "export.json"
FORMAT = "dbo-export"
# zip's first date: the same export gives the same bytes
_EARLIEST = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class ExportSummary:
    """Figures of one export; the README beside the sources shows the same.

    Attributes
    ----------
    folder, name, direction, arithmetic : str
        Where and what was exported.
    files : tuple of str
        Names in the folder.
    gears, table_rows, run : int
        Gears, rows of the gear table, and how many equal gears a row stands for.
    table_bytes, state_bytes : int
        Constant tables (flash), and the state (RAM) on a 32-bit target.
    worst_runs : int
        A bound on the work of one step: the most runs of gears it crosses one by one.
    bounds : mapping
        Derived bounds on the error against the float64 model, in the output's unit and
        in % of its range; empty for double, which gives the same bits.
    gears_loss : mapping
        Where gears were taken away: the largest and the RMS difference this makes on
        test moves.
    vectors : int
        Samples in the self-test.
    notes, warnings : tuple of str
        What the caller must know or do, and what may spoil the result.
    """

    folder: str
    name: str
    direction: str
    arithmetic: str
    files: tuple[str, ...]
    gears: int
    table_rows: int
    run: int
    table_bytes: int
    state_bytes: int
    worst_runs: int
    vectors: int
    bounds: Mapping[str, float] = field(default_factory=dict)
    gears_loss: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Translated(NamedTuple):
    """A model as C: how it is computed, its code, its figures, and what every file of it knows."""

    plan: CascadePlan
    code: ModelCode
    summary: ExportSummary
    words: Values


def project_files(
    translation: Translated, sources: Mapping[str, str], test: str, arduino: bool
) -> dict[str, str]:
    """Return every file by its path in the folder: the sources, and what stands around them."""
    plan, code, summary, words = translation
    name = summary.name
    values = {
        **build_values(words, code.number, sources, [f"{name}_test.c"]), "SAMPLE": code.sample_input,
        "INPUT_TEXT": _capitalised(plan.model.input), "OUTPUT_TEXT": _capitalised(plan.model.output),
    }  # fmt: skip
    page = fill("README.md", {**values, **shown_figures(translation)})
    if arduino:
        return {
            **{f"src/{file}": text for file, text in sources.items()},
            f"extras/{name}_test.c": test,
            f"examples/{name}/{name}.ino": fill("NAME.ino", values),
            "library.properties": fill("library.properties", values),
            "README.md": page,
        }
    example = fill("example_main.c", values)
    written = {f"{name}_test.c": test, "example_main.c": example, "README.md": page}
    return {**sources, **written, **build_files(values)}


def build_values(
    words: Values, number: str, sources: Mapping[str, str], tests: Sequence[str]
) -> dict[str, str | bool]:
    """Return what build files and pages know of an export's sources and of the files of its self-test."""
    small = number == "double"
    compiled = " ".join(file for file in _ordered(sources) if file.endswith(".c"))
    return {
        **words, "NUMBER": number, "small": small, "counts": number == "int32_t",
        "DEFINES": "-DDBO_SMALL" if small else "", "SOURCE_FILES": compiled,
        "COMPILED_FILES": f"-DDBO_SMALL {compiled}" if small else compiled,
        "HEADER_FILES": " ".join(file for file in _ordered(sources) if file.endswith(".h")),
        "TEST_FILES": " ".join(tests), "TEST_FILTERS": ", ".join(f'"-<{file}>"' for file in tests),
    }  # fmt: skip


def build_files(values: Values) -> dict[str, str]:
    """Return what builds the sources: for make, CMake, PlatformIO and Zephyr."""
    name = values["NAME"]
    target = {**values, "TARGET_NAME": name, "CONFIG_FILE": f"{name}Config.cmake"}
    del target["NAME"]  # a word of CMake's own
    return {
        "Makefile": fill("Makefile", values),
        "CMakeLists.txt": fill("CMakeLists.txt", target),
        "library.json": fill("library.json", values),
        "zephyr/module.yml": fill("zephyr_module.yml", target),
        "zephyr/CMakeLists.txt": fill("zephyr_CMakeLists.txt", target),
    }


def _ordered(sources: Mapping[str, str]) -> list[str]:
    """Return the sources' names, those of the model before those of the kernel."""
    return sorted(sources, key=lambda file: (file.startswith("dbo_"), file))


def _capitalised(quantity: Quantity) -> str:
    unit = f" ({quantity.unit})" if quantity.unit else ""
    return f"{quantity.quantity[:1].upper()}{quantity.quantity[1:]}{unit}"


def shown_figures(translation: Translated) -> Values:
    """Return what README.md shows of an export's figures."""
    plan, _, summary, _ = translation
    drive, result = plan.model.drive, plan.model.output
    figures = {key.upper(): str(value) for key, value in asdict(summary).items()}
    for key in ("same_gears", "after_close_turn"):
        most, percent = (
            summary.bounds.get(key, 0.0),
            summary.bounds.get(f"{key}_percent", 0.0),
        )
        figures[key.upper()] = f"{most:.3g}{result.suffix} ({percent:.3g} %"
    figures["CLOSE_TURN"] = f"{summary.bounds.get('close_turn_fraction', 0.0):.2g}"
    figures["LOWEST_DRIVE"] = f"{drive.minimum!r}{drive.suffix}"
    for side, quantity in (("INPUT", plan.model.input), ("OUTPUT", result)):
        ends = f"{quantity.minimum:.9g} to {quantity.maximum:.9g}{quantity.suffix}"
        figures |= {f"{side}_NAME": quantity.quantity, f"{side}_RANGE": ends}
    return {
        **figures, "moving": plan.model.dynamics is not None,
        "duties": "".join(f"- {note}\n" for note in (*summary.notes, *summary.warnings)),
    }  # fmt: skip


def check_folder(folder: str, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, before the work.

    Raises
    ------
    OutputError
        There is something of that name and ``overwrite`` is not given, or what is there
        is no export.
    """
    target = Path(folder)
    if not target.parent.is_dir():
        raise OutputError(
            f"{folder}: there is no folder '{target.parent}': create it first"
        )
    if not os.access(target.parent, os.W_OK):
        raise OutputError(f"{folder}: the folder '{target.parent}' is not writable")
    if not os.path.lexists(target):
        return
    if not target.is_dir() or target.is_symlink():
        raise OutputError(f"{folder}: is no folder: choose another name")
    if not overwrite:
        raise OutputError(
            f"{folder}: the folder exists already (`overwrite` replaces an export)"
        )
    try:
        listed = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        known = set(listed["files"]) if listed["format"] == FORMAT else set()
        made = {path.removesuffix(".c") + ".o" for path in known}  # by make
        known |= made | {f"{listed['name']}_test", "example"}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        known = set()
    strangers = []
    for path in target.rglob("*"):
        name = path.relative_to(target).as_posix()
        if name not in known and not path.is_dir():
            strangers.append(name)
    if strangers:
        raise OutputError(
            f"{folder}: holds '{min(strangers)}', which no export wrote: it is not overwritten"
            " (move it, or choose another folder)"
        )


def write_folder(
    folder: str,
    files: Mapping[str, str | bytes],
    figures: Mapping[str, Any],
    overwrite: bool,
) -> None:
    """Write files under a temporary name beside ``folder``, then rename; an old export makes way whole.

    Beside the files lie their ``figures``, for programs.

    Raises
    ------
    OutputError
        Writing failed; nothing new is left, and what stood there stays.
    """
    check_folder(folder, overwrite)
    target = Path(folder)
    manifest = (
        json.dumps(
            {"format": FORMAT, "version": 1, **figures}, indent=2, ensure_ascii=False
        )
        + "\n"
    )
    mark = f"{os.getpid()}-{secrets.token_hex(4)}"
    partial = target.parent / f".{target.name[:100]}.{mark}.partial"
    old = target.parent / f".{target.name[:100]}.{mark}.old"
    try:
        for name, content in {**files, MANIFEST: manifest}.items():
            path = partial / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        if target.exists():
            target.rename(old)
        try:
            partial.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    except OSError as problem:
        raise OutputError(
            f"{folder}: cannot be written: {problem.strerror or problem}"
        ) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def library_files(words: Values, code: Mapping[str, str]) -> dict[str, str | bytes]:
    """Return header, source and binary of the flat library of an export in float64.

    Raises
    ------
    OutputError
        There is no compiler, or it refuses.
    """
    name = words["NAME"]
    flat = {
        f"{name}_library.{kind}": fill(f"NAME_library.{kind}", words)
        for kind in ("h", "c")
    }
    return {**flat, f"lib{name}{_library_suffix()}": _compile({**code, **flat})}


def _library_suffix() -> str:
    """Return what a shared library's name ends with on this computer."""
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _compile(sources: Mapping[str, str]) -> bytes:
    """Return sources as a shared library of this computer, by the environment's CC or a usual compiler."""
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    command = next((name for name in names if name and shutil.which(name)), None)
    if command is None:
        raise OutputError(
            "no C compiler (cc, gcc, clang, or the one CC names) is here for `shared` and `fmu`:"
            " install one, or export the sources alone"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        files = sorted(name for name in sources if name.endswith(".c"))
        done = subprocess.run(
            [command, "-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared",
             *files, "-lm", "-o", "library"],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            reason = (
                done.stderr.strip() or f"exit code {done.returncode}"
            ).splitlines()[0]
            raise OutputError(
                f"the C compiler '{command}' refuses the sources: {reason}"
            )
        return (Path(folder) / "library").read_bytes()


def _platform_folder() -> str:
    """Return the standard's name of this computer's folder of binaries."""
    system = {"linux": "linux", "win32": "win", "darwin": "darwin"}.get(sys.platform)
    if system is None or platform.machine().lower() not in {"x86_64", "amd64"}:
        raise OutputError(
            f"FMI 2.0 has no binaries for {platform.system()} on {platform.machine()}:"
            " export on a 64-bit Intel or AMD computer, or without `fmu`"
        )
    return f"{system}64"


def _attribute(text: str) -> str:
    return escape(text, {'"': "&quot;"})


def fmu_bytes(plan: CascadePlan, words: Values, code: Mapping[str, str]) -> bytes:
    """Return the unit as a zip archive: the same model gives the same bytes from the same compiler.

    Raises
    ------
    OutputError
        There is no compiler, or no name for this computer in FMI 2.0.
    """
    folder, name = _platform_folder(), str(words["NAME"])
    source, result = plan.model.input, plan.model.output
    parts = "".join(code[file] for file in sorted(code))
    units = sorted({quantity.unit for quantity in (source, result) if quantity.unit})
    values: dict[str, str | bool] = {
        "NAME": name, "GUID": hashlib.sha256(f"{name}{words['TITLE']}{parts}".encode()).hexdigest()[:32],
        "START_DRIVE": repr(plan.model.drive.minimum), "timed": plan.time_step is not None,
        "TIME_STEP": repr(plan.time_step), "VARIABLE_STEP": "true" if plan.time_step is None else "false",
    }  # fmt: skip
    sources = {**code, f"{name}_fmu.c": fill("NAME_fmu.c", values)}
    listed = sorted(file for file in sources if file.endswith(".c"))
    values |= {
        "TITLE": _attribute(str(words["TITLE"])),
        "source_files": "".join(f'      <File name="{file}"/>\n' for file in listed),
        "unit_rows": "".join(f'    <Unit name="{_attribute(unit)}"/>\n' for unit in units),
        "INPUT_NAME": _attribute(source.quantity), "OUTPUT_NAME": _attribute(result.quantity),
        "input_unit": bool(source.unit), "INPUT_UNIT": _attribute(source.unit or ""),
        "output_unit": bool(result.unit), "OUTPUT_UNIT": _attribute(result.unit or ""),
    }  # fmt: skip
    files = {"modelDescription.xml": fill("modelDescription.xml", values).encode()}
    files |= {f"sources/{file}": text.encode() for file, text in sources.items()}
    files[f"binaries/{folder}/{name}{_library_suffix()}"] = _compile(sources)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in files.items():
            archive.writestr(
                zipfile.ZipInfo(path, _EARLIEST), content, zipfile.ZIP_DEFLATED
            )
    return packed.getvalue()
