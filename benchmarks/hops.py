"""How many calls one more block costs in ``dbo simulate`` and ``dbo compensate``, and what a command opens.

    python benchmarks/hops.py [--list] [FOLDER]

The same command runs over k and over k + 1 blocks of 131,072 rows while the interpreter
reports every call of a function of the package (``sys.setprofile``, in every thread);
the difference is what a block costs. A generator counts each time a block is asked of
it: that is a hop, too. Then a small ``compensate`` and a small ``identify`` are run
once: how many files and functions (comprehensions and the bodies of modules and classes
aside) are called, that is, what a reader of that command opens. FOLDER, a checkout of
another version, tells what it was before; ``--list`` names the functions.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BLOCK = 131_072
# beyond the start, where the first 256 kB are looked at, and in front of the end
BLOCKS = 6
HEIGHTS = [0.01 + 0.001 * k for k in range(25)]
GEARS = {"type": "backlash", "x0": 0.0, "y0": 0.0, "dx": [4.0] * 25, "dy": HEIGHTS}
POINTS = {"type": "point", "x0": 0.0, "y0": 0.0, "dx": [0.25, 0.35], "dy": [0.3, 0.3]}
MEMORY = {"on": "input", "reference": 0.0, "tau": [0.01, 1.0], "gain": [0.0005, 0.0005]}
SCALE = {"type": "scale", "gain": 20.0, "offset": 0.0}
DELAY = {"type": "delay", "seconds": 0.0002}
REMEMBERING = [GEARS | {"relaxation": MEMORY}, POINTS, SCALE]
CASCADES: dict[str, list[dict[str, Any]]] = {
    "gears and scale": [GEARS, SCALE],
    "gears, relaxation, points, scale": REMEMBERING,
    "the same with a delay": [*REMEMBERING, DELAY],
}


def model_file(folder: Path, stages: list[dict[str, Any]]) -> str:
    """Write a model (version 1, which every version reads) and return its name."""
    path = folder / "model.json"
    ends = {"min": 0.0, "max": 100.0}
    model = {
        "format": "dbo-model",
        "version": 1,
        "direction": "forward",
        "input": {"quantity": "voltage", "unit": "V"} | ends,
        "output": {"quantity": "displacement", "unit": "um"} | ends,
        "stages": stages,
    }
    path.write_text(json.dumps(model))
    return str(path)


def log_file(folder: Path, header: str, top: float, rows: int) -> str:
    """Write so many rows, all of one length, so that a block of text is a block of rows."""
    path = folder / f"{header.strip()}-{rows}.csv"
    with path.open("w") as file:
        file.write(f"  time_s,{header}\n")
        for k in range(rows):
            file.write(
                f"{k * 1e-4:8.4f},{top * (0.5 + 0.45 * abs(k % 4000 / 2000 - 1)):8.5f}\n"
            )
    return str(path)


def calls(words: list[str]) -> Counter[str]:
    """Run one command line and count the calls of each function of the package."""
    import dbo_cli
    from dbo_cli.cli.app import main

    package = str(Path(dbo_cli.__file__).parent) + os.sep
    counted: Counter[str] = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        # a module's or a class's body is none
        function = code.co_flags & inspect.CO_OPTIMIZED
        file = code.co_filename.removeprefix(package)
        if event == "call" and function and file != code.co_filename:
            counted[f"{file}: {code.co_qualname}"] += 1

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        code = main(words)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    if code:
        raise SystemExit(f"dbo {' '.join(words)}: exit code {code}")
    return counted


def print_opened(words: list[str]) -> None:
    """Print how many files and functions one command line takes."""
    # nor comprehensions
    functions = {where for where in calls(words) if not where.endswith(">")}
    files = {where.partition(": ")[0] for where in functions}
    print(f"{words[0]:48} {len(files):11d} files {len(functions):7d} functions")
    if "--list" in sys.argv:
        for file in sorted(files):
            named = sorted(
                where.partition(": ")[2]
                for where in functions
                if where.startswith(f"{file}: ")
            )
            print(f"  {len(named):4d}  {file}: {', '.join(named)}")


def main() -> None:
    """Print the calls of one more block for several models, and what two commands open."""
    words = [word for word in sys.argv[1:] if word != "--list"]
    sys.path.insert(0, words[0] if words else str(ROOT))
    print(
        "command and model                                calls of one more block   functions"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        output = ["-o", str(folder / "out.csv"), "--quiet"]
        for command, (header, top) in {
            "simulate": ("voltage_V", 100.0),
            "compensate": (" displ_um", 11.0),
        }.items():
            logs = [
                log_file(folder, header, top, blocks * BLOCK)
                for blocks in (BLOCKS, BLOCKS + 1)
            ]
            more_words = ["--displacement", "2"] if command == "compensate" else []
            for what, stages in CASCADES.items():
                line = [
                    command,
                    model_file(folder, stages),
                    "--block-rows",
                    str(BLOCK),
                    *more_words,
                    *output,
                ]
                calls([*line, logs[0]])  # what is imported and made once
                few, many = (calls([*line, log]) for log in logs)
                more = {
                    where: many[where] - few[where]
                    for where in many
                    if many[where] != few[where]
                }
                print(
                    f"{f'{command}: {what}':48} {sum(more.values()):23d} {len(more):11d}"
                )
                if "--list" in sys.argv:
                    for where, count in sorted(more.items()):
                        print(f"  {count:4d}  {where}")
        small = log_file(folder, " displ_um", 11.0, 4000)
        print_opened(
            [
                "compensate",
                model_file(folder, REMEMBERING),
                small,
                "--displacement",
                "2",
                *output,
            ]
        )
        recording = str(ROOT / "sample_data" / "identification.csv")
        print_opened(
            [
                "identify",
                recording,
                "--gears",
                "20",
                "-o",
                str(folder / "model.json"),
                "--quiet",
            ]
        )


if __name__ == "__main__":
    main()
