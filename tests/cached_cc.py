#!/usr/bin/env python3
"""gcc that keeps what it has compiled: exports share their kernel, which takes it 1 to 6 seconds each time.

Called as gcc is, for sources that become a program or a library; anything else goes straight on. What is kept
is an object for each preprocessed source and its flags, in the folder that ``DBO_TEST_OBJECTS`` names.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

REAL = "gcc"


def compiled(source: str, flags: list[str], kept: Path) -> Path:
    """Return the object of a source, made now or before; leaves with the compiler's code where it fails."""
    # -P: without the marks that say where a line came from, the folder among them with -g.
    seen = subprocess.run([REAL, *flags, "-E", "-P", source], capture_output=True)
    key = hashlib.sha256("\0".join([*flags, ""]).encode() + seen.stdout).hexdigest()
    target = kept / f"{key}.o"
    if seen.returncode or not target.exists():
        fresh = kept / f"{key}.{os.getpid()}.o"
        code = subprocess.call([REAL, *flags, "-c", source, "-o", str(fresh)])
        if code:
            sys.exit(code)
        fresh.replace(target)
    return target


def main(words: list[str]) -> int:
    """Compile and link."""
    sources = [word for word in words if word.endswith(".c")]
    folder = os.environ.get("DBO_TEST_OBJECTS")
    if folder is None or not sources or "-o" not in words or {"-c", "-E", "-S", "-M", "-MM"} & set(words):
        os.execvp(REAL, [REAL, *words])
    at = words.index("-o")
    libraries = [word for word in words if word.startswith("-l")]
    rest = [word for word in words[:at] + words[at + 2 :] if word not in {*sources, *libraries}]
    flags = [word for word in rest if word != "-shared"]
    objects = [str(compiled(source, flags, Path(folder))) for source in sources]
    return subprocess.call([REAL, *rest, *objects, *libraries, "-o", words[at + 1]])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
