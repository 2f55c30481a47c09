"""How many calls one more block of samples costs on its way from CSV to CSV through ``dbo simulate``.

    python benchmarks/hops.py [--list] [FOLDER]

The same command runs over k and over k + 1 blocks of 65,536 rows while the interpreter reports every call of
a function of the package (``sys.setprofile``, in every thread); the difference is what a block costs. A
generator counts each time a block is asked of it: that is a hop, too. FOLDER, a checkout of another version
(run with that one's interpreter), tells what it was before; ``--list`` names the functions.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BLOCK = 65_536
BLOCKS = 6  # beyond the start, where the first 256 kB are looked at, and in front of the end
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


def log_file(folder: Path, blocks: int) -> str:
    """Write so many blocks of rows, all of one length, so that a block of text is a block of rows."""
    path = folder / f"{blocks}.csv"
    with path.open("w") as file:
        file.write("  time_s,voltage_V\n")
        for k in range(blocks * BLOCK):
            file.write(f"{k * 1e-4:8.4f},{50 + 45 * abs(k % 4000 / 2000 - 1):8.5f}\n")
    return str(path)


def calls(words: list[str]) -> Counter[str]:
    """Run one command line and count the calls of each function of the package."""
    import dbo_cli
    from dbo_cli.cli.app import main

    package = str(Path(dbo_cli.__file__).parent)
    counted: Counter[str] = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(package):
            counted[f"{code.co_filename[len(package) + 1 :]}: {code.co_qualname}"] += 1

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


def main() -> None:
    """Print the calls of one more block for several models."""
    words = [word for word in sys.argv[1:] if word != "--list"]
    sys.path.insert(0, words[0] if words else str(ROOT))
    print("model                                calls of one more block   functions")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = [log_file(folder, blocks) for blocks in (BLOCKS, BLOCKS + 1)]
        for what, stages in CASCADES.items():
            model = model_file(folder, stages)
            output = str(folder / "out.csv")
            command = ["simulate", model, "--block-rows", str(BLOCK), "-o", output, "--quiet"]
            calls([*command, logs[0]])  # what is imported and made once
            few, many = (calls([*command, log]) for log in logs)
            more = {where: many[where] - few[where] for where in many if many[where] != few[where]}
            print(f"{what:36} {sum(more.values()):23d} {len(more):11d}")
            if "--list" in sys.argv:
                for where, count in sorted(more.items()):
                    print(f"  {count:4d}  {where}")


if __name__ == "__main__":
    main()
