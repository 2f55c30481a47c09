"""What is compiled for this computer: a flat C library, and an FMI 2.0 co-simulation unit.

The library is what LabVIEW, MATLAB, Julia and ctypes can call; the unit has a model description, the sources
and this computer's binary.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape

from dbo_cli.errors import OutputError
from dbo_cli.export.cascade_plan import CascadePlan
from dbo_cli.export.source_text import Values, fill

_EARLIEST = (1980, 1, 1, 0, 0, 0)  # zip's first date: the same export gives the same bytes


def library_files(words: Values, code: Mapping[str, str]) -> dict[str, str | bytes]:
    """Return header, source and binary of the flat library of an export in float64.

    Raises
    ------
    OutputError
        There is no compiler, or it refuses.
    """
    name = words["NAME"]
    flat = {f"{name}_library.{kind}": fill(f"NAME_library.{kind}", words) for kind in ("h", "c")}
    return {**flat, f"lib{name}{_library_suffix()}": _compile({**code, **flat})}


def _library_suffix() -> str:
    """Return what a shared library's name ends with on this computer."""
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _compiler() -> str:
    """Return the C compiler: the environment's CC, else the usual names."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and shutil.which(name):
            return name
    raise OutputError(
        "no C compiler (cc, gcc, clang, or the one CC names) is here for `shared` and `fmu`:"
        " install one, or export the sources alone"
    )


def _compile(sources: Mapping[str, str]) -> bytes:
    """Return sources as a shared library of this computer."""
    command = _compiler()
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
            reason = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[0]
            raise OutputError(f"the C compiler '{command}' refuses the sources: {reason}")
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
        "START_DRIVE": repr(plan.drive.minimum), "timed": plan.time_step is not None,
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
            archive.writestr(zipfile.ZipInfo(path, _EARLIEST), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
