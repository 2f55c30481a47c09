#!/usr/bin/env python3
"""gcc that keeps the kernels it has compiled: exports share them, and one takes it up to 4 seconds.

Called as gcc is, for sources that become a program or a library; anything else goes
straight on. What is kept is an object for each preprocessed kernel (``KERNEL``) and
its flags, in the folder that ``DBO_TEST_OBJECTS`` names. All of gcc's warnings that the
tests ask for are errors there, whoever calls.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path

REAL = "gcc"
KERNEL = re.compile(r"(.*/)?(dbo_\w+|kernel_reference|kernel_harness)\.c")
"""Sources that hold a kernel or include one."""
STRICT = "-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror".split()


def compiled(source: str, flags: list[str], folder: Path, kept: Path) -> Path:
    """Return the object of a kernel, made now or before; raises CalledProcessError where it fails."""
    chosen = [flag for flag in flags if flag.startswith("-Wno-") or flag[:2] != "-W"]
    flags = [*STRICT, *chosen]
    # Preprocessed, since its header of names holds those of other kernels, too; -P:
    # without folders in it.
    seen = subprocess.run(
        [REAL, *flags, "-E", "-P", source],
        cwd=folder,
        check=True,
        stdout=subprocess.PIPE,
    )
    text = "\0".join((*flags, "")).encode() + seen.stdout
    target = kept / f"{hashlib.sha256(text).hexdigest()}.o"
    if not target.exists():
        fresh = kept / f"{target.stem}.{os.getpid()}.o"
        subprocess.run(
            [REAL, *flags, "-c", source, "-o", str(fresh)], cwd=folder, check=True
        )
        fresh.replace(target)
    os.utime(target)  # used today: ``conftest.py`` removes what nobody uses
    return target


def run(words: list[str], folder: Path) -> None:
    """Compile and link as gcc does in a folder; raises CalledProcessError where it fails."""
    kernels = [word for word in words if KERNEL.fullmatch(word)]
    kept = os.environ.get("DBO_TEST_OBJECTS")
    if (
        kept is not None
        and kernels
        and "-o" in words
        and not {"-c", "-E", "-S", "-M", "-MM"} & set(words)
    ):
        at = words.index("-o")
        others = (*words[:at], *words[at + 2 :])
        flags = [
            word
            for word in others
            if word.startswith("-") and word[:2] != "-l" and word != "-shared"
        ]
        objects = {
            source: str(compiled(source, flags, folder, Path(kept)))
            for source in kernels
        }
        words = [objects.get(word, word) for word in words]
    subprocess.run([REAL, *words], cwd=folder, check=True)


if __name__ == "__main__":
    try:
        run(sys.argv[1:], Path.cwd())
    except subprocess.CalledProcessError as failed:
        sys.exit(failed.returncode)
