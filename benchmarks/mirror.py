#!/usr/bin/env python3
"""What coupling and a shared shape are worth: a virtual mirror's or scanner's error, against its noise.

    python benchmarks/mirror.py [ACTUATORS] [-j N] [--folder DIR]

Drives are written (dbo excite --channels), played by sample_data/virtual_mirror.py, and
models identified in four ways; each compensates the same move, which is played again.
The error is what the actuators do, without the sensors' noise, minus what was wanted,
in % of the stroke; offsets aside, since a sensor's zero is its own. Ways without
coupling get the rows in which all move together alone. Up to four actuators are a
scanner with 1 % of crosstalk (1 kHz), more a mirror with 2 % of its neighbours (400
Hz).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "sample_data"))

from virtual_mirror import VirtualMirror, read_table, save_table  # noqa: E402

from dbo_cli.cli.app import main as dbo  # noqa: E402

WAYS = {
    "own models": (),
    "--shared-shape": ("--shared-shape",),
    "--coupling": ("--coupling",),
}
WAYS["both"] = ("--shared-shape", "--coupling", "--force")
COLUMNS = ("--voltage", "voltage_{}", "--displacement", "displacement_{}")


def run(*words: object) -> float:
    """Run a command; return its seconds."""
    begin = time.perf_counter()
    if dbo([str(word) for word in words]) != 0:
        raise SystemExit(f"failed: dbo {' '.join(map(str, words))}")
    return time.perf_counter() - begin


def errors(mirror: VirtualMirror, drives: Path) -> np.ndarray:
    """Return the RMS error of each actuator over the move, in % of its stroke, offsets aside."""
    table = read_table(str(drives))
    count = len(mirror.actuators)
    volts, wanted = (
        np.column_stack([table[f"{name}_{k}"] for k in range(1, count + 1)])
        for name in ("voltage", "desired")
    )
    found: np.ndarray = (
        100.0
        * np.std(mirror.displacement(table["time"], volts) - wanted, axis=0)
        / mirror.strokes
    )
    return found


def main() -> None:
    """Print a table of the ways."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("actuators", nargs="?", type=int, default=128)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp())
    folder.mkdir(exist_ok=True, parents=True)
    mirror = VirtualMirror(options.actuators)
    pace = (
        ("--sample-rate", 1000)
        if options.actuators <= 4
        else ("--sample-rate", 400, "--frequency", 4)
    )
    run(
        "excite",
        "--v-max",
        100,
        *pace,
        "--channels",
        options.actuators,
        "-q",
        "-o",
        folder / "drives.h5",
    )
    table = read_table(str(folder / "drives.h5"))
    volts = np.column_stack(
        [table[f"voltage_{k}"] for k in range(1, options.actuators + 1)]
    )
    together = int(np.argmax((volts != 0.0).sum(axis=1)[::-1] > 1))
    together = len(volts) - together
    shown = mirror.play(table["time"], volts, seed=1)
    columns = {"time_s": table["time"]}
    for k in range(options.actuators):
        columns |= {
            f"voltage_{k + 1}_V": volts[:, k],
            f"displacement_{k + 1}_um": shown[:, k],
        }
    save_table(str(folder / "log.h5"), columns)
    seconds, wanted = mirror.move()
    move = {f"desired_{k}_um": column for k, column in enumerate(wanted.T, 1)}
    save_table(str(folder / "move.h5"), {"time_s": seconds} | move)
    noise = 100.0 * float(np.mean(mirror.noise / mirror.strokes))
    print(
        f"{options.actuators} actuators, {len(volts):,} rows, noise {noise:.3f} % of the stroke"
    )
    print("models          median    90 %   worst   identify  compensate")
    for name, more in WAYS.items():
        if "--shared-shape" in more and options.actuators < 4:
            continue
        model, drives = (
            folder / f"{name.strip('-')}.json",
            folder / f"{name.strip('-')}.drive.h5",
        )
        words = ("-q", "-j", options.jobs, "-o")
        rows = () if "--coupling" in more else ("--rows", f"1:{together}")
        taken = run(
            "identify", folder / "log.h5", *COLUMNS, *more, *rows, *words, model
        )
        played = run(
            "compensate",
            model,
            folder / "move.h5",
            "--displacement",
            "desired_{}",
            *words,
            drives,
        )
        low, high, worst = np.quantile(errors(mirror, drives), (0.5, 0.9, 1.0))
        print(
            f"{name:14} {low:7.3f} {high:7.3f} {worst:7.3f} {taken:8.0f} s {played:9.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
