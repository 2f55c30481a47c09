"""Start-up: what the program adds to Python, numpy and the libraries that it is built on.

    python benchmarks/startup.py [RUNS]

Whole processes, in turn; the time of the processors, the least of RUNS (default 15)
each. The limits are those the project promises. The floor of a run is `import numpy`: a
usual command line loads no command-line library, and polars is loaded for long logs
only.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from machine import verdict

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # as dbo sets it
HEIGHTS = [0.01 + 0.001 * k for k in range(25)]
MODEL = {
    "format": "dbo-model",
    "version": 1,
    "direction": "forward",
    "input": {"quantity": "voltage", "unit": "V", "min": 0.0, "max": 100.0},
    "output": {"quantity": "displacement", "unit": "um", "min": 0.0, "max": 12.0},
    "stages": [
        {"type": "backlash", "x0": 0.0, "y0": 0.0, "dx": [4.0] * 25, "dy": HEIGHTS},
        {"type": "scale", "gain": 21.8, "offset": 0.0},
    ],
}


def seconds(words: list[str]) -> float:
    """Return how long one process keeps the processors busy."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *words],
        check=True,
        cwd=ROOT,
        env=ENVIRONMENT,
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure, print a table, and exit with 1 where a promise is not kept (2 on a busy machine)."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    with tempfile.TemporaryDirectory() as folder:
        model, drive = Path(folder, "model.json"), Path(folder, "drive.csv")
        model.write_text(json.dumps(MODEL))
        rows = "".join(
            f"{k / 1000},{50 - 50 * abs(k % 200 - 100) / 100}\n" for k in range(10)
        )
        drive.write_text("time_s,voltage_V\n" + rows)
        commands = {
            "python -c pass": ["-c", "pass"],
            "import typer": ["-c", "import typer"],
            "import numpy": ["-c", "import numpy"],
            "import numpy, typer": ["-c", "import numpy, typer"],
            "dbo --version": ["-m", "dbo_cli", "--version"],
            "dbo --help": ["-m", "dbo_cli", "--help"],
            "dbo simulate, 10 rows": [
                "-m",
                "dbo_cli",
                "simulate",
                str(model),
                str(drive),
            ],
        }
        best = dict.fromkeys(commands, float("inf"))
        for _ in range(runs):
            for name, words in commands.items():
                best[name] = min(best[name], seconds(words))
    for name, value in best.items():
        print(f"{name:30} {1e3 * value:7.1f} ms")
    promises = [
        ("dbo --version", "import typer", 1.5),
        ("dbo simulate, 10 rows", "import numpy, typer", 1.2),
        ("dbo simulate, 10 rows", "import numpy", 1.4),
        ("dbo simulate, 10 rows", "python -c pass", 5.0),
    ]
    kept = True
    for name, other, limit in promises:
        ratio = best[name] / best[other]
        kept = kept and ratio <= limit
        print(f"{name} / {other}: {ratio:.2f}  (promised: at most {limit:g})")
    sys.exit(verdict(kept))


if __name__ == "__main__":
    main()
