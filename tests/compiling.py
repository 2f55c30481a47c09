"""C sources compiled by the tests: with what, and each of them once."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import cached_cc

WARNINGS = ["-std=c99", *cached_cc.STRICT, "-ffp-contract=off"]
# Not optimised: nothing is left out before it is watched, and the kernel takes half as
# long to compile.
SANITIZERS = ["-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
CACHED = os.environ["CC"] if "DBO_TEST_OBJECTS" in os.environ else cached_cc.__file__
COMPILERS = [CACHED] * bool(shutil.which("gcc")) + ["clang"] * bool(
    shutil.which("clang")
)


def compile_c(folder: Path, *words: str, compiler: str = CACHED) -> None:
    """Compile in a folder; the cached compiler in this process, where Python need not start for it."""
    if compiler == CACHED:
        cached_cc.run(list(words), folder)
    else:
        subprocess.run([compiler, *words], cwd=folder, check=True)
