"""A flat C library of a model for this computer: what LabVIEW, MATLAB, Julia and ctypes can call."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from string import Template

from dbo_cli.errors import OutputError

_HEADER = Template("""\
/* $title: a flat library. Handles are opaque pointers; every call gives 0, or -1 for a handle that is none.
 * For LabVIEW, MATLAB loadlibrary, Julia ccall and ctypes: plain types only. */
#ifndef ${guard}_LIBRARY_H
#define ${guard}_LIBRARY_H

#if defined(_WIN32)
#define ${guard}_API __declspec(dllexport)
#elif defined(__GNUC__)
#define ${guard}_API __attribute__((visibility("default")))
#else
#define ${guard}_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* A new actuator, in the state after a drive at its lower end; NULL where there is no memory. */
${guard}_API void *${name}_create(void);
${guard}_API int ${name}_destroy(void *handle);

/* The start after a drive at its lower end, or trimmed to a drive and resting there. */
${guard}_API int ${name}_start_empty(void *handle);
${guard}_API int ${name}_start_settled(void *handle, double drive);

/* `count` samples at the fixed rate; output may be input. */
${guard}_API int ${name}_run(void *handle, const double *input, double *output, int count);

/* Samples per second (0: time plays no part), and seconds to read the input ahead. */
${guard}_API double ${name}_sample_rate(void);
${guard}_API double ${name}_read_ahead(void);

#ifdef __cplusplus
}
#endif

#endif
""")

_SOURCE = Template("""\
/* See ${name}_library.h. */
#include "${name}_library.h"
#include "$name.h"

#include <stdlib.h>

void *${name}_create(void) {
    ${name}_state *state = (${name}_state *)malloc(sizeof *state);
    if (state != NULL) ${name}_init(state);
    return state;
}

int ${name}_destroy(void *handle) {
    free(handle);
    return handle == NULL ? -1 : 0;
}

int ${name}_start_empty(void *handle) {
    if (handle == NULL) return -1;
    ${name}_init((${name}_state *)handle);
    return 0;
}

int ${name}_start_settled(void *handle, double drive) {
    if (handle == NULL) return -1;
    ${name}_reset((${name}_state *)handle, drive);
    return 0;
}

int ${name}_run(void *handle, const double *input, double *output, int count) {
    if (handle == NULL || count < 0 || (count > 0 && (input == NULL || output == NULL))) return -1;
    for (int k = 0; k < count; k++) output[k] = ${name}_step((${name}_state *)handle, input[k]);
    return 0;
}

double ${name}_sample_rate(void) { return $rate; }
double ${name}_read_ahead(void) { return $ahead; }
""")


def library_sources(name: str, title: str, rate: float, ahead: float) -> dict[str, str]:
    """Return the header and the source of the flat library of an export in float64."""
    words = {"name": name, "title": title, "guard": name.upper(), "rate": repr(rate), "ahead": repr(ahead)}
    return {
        f"{name}_library.h": _HEADER.substitute(words),
        f"{name}_library.c": _SOURCE.substitute(words),
    }


def library_suffix() -> str:
    """Return what a shared library's name ends with on this computer."""
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def compiler() -> str:
    """Return the C compiler: the environment's CC, else the usual names.

    Raises
    ------
    OutputError
        There is none.
    """
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and shutil.which(name):
            return name
    raise OutputError(
        "no C compiler (cc, gcc, clang, or the one CC names) is here for `shared` and `fmu`:"
        " install one, or export the sources alone"
    )


def compile_library(sources: Mapping[str, str]) -> bytes:
    """Return sources as a shared library of this computer.

    Raises
    ------
    OutputError
        There is no compiler, or it refuses.
    """
    command = compiler()
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
