"""How the cost of every command grows with the rows of its logs, start-up taken off.

    python benchmarks/exponents.py [--most ROWS] [--only WORD] [--runs N]

Whole processes, the processor's time, the least of N (default 3). A command's time over
ten rows is its start-up. Between one size and ten times that the time beyond it grows
10^e times: e is the exponent, and 1 is linear. Rows that take less than a tenth of the
start-up tell nothing, and have no exponent.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import dbo_cli as dbo

ROOT = Path(__file__).resolve().parent.parent
FEW = 10
"""Rows that cost no more than a start."""

LARGEST = {"identify": 1_000_000}
"""Rows of a command's largest log where that is less than 10^7: it is read whole."""

Words = list[str]


def write_logs(folder: Path, model: dbo.Model, rows: int) -> None:
    """Write a drive with what a model makes of it, and a move with what was measured of it, at 500 Hz."""
    rng = np.random.default_rng(rows)
    time = np.arange(rows) * 2e-3
    phase = 2.0 * np.pi * time
    volts = 50.0 - 50.0 * np.cos(phase) * (1.0 - 0.6 * np.sin(phase / 14.0) ** 2)
    moved = model.simulate(volts, sample_rate=500.0) + rng.normal(0.0, 0.005, rows)
    wanted = 5.0 - 3.0 * np.cos(phase)
    followed = wanted + rng.normal(0.0, 0.01, rows)
    tables = {
        "log": ("time_s,voltage_V,displacement_um", (time, volts, moved)),
        "move": ("time_s,desired_um,measured_um", (time, wanted, followed)),
    }
    for name, (header, columns) in tables.items():
        table = np.column_stack(columns)
        with (folder / f"{name}_{rows}.csv").open("w") as file:
            file.write(header + "\n")
            for begin in range(0, rows, 100_000):
                np.savetxt(
                    file, table[begin : begin + 100_000], fmt="%.6f", delimiter=","
                )


def commands(folder: Path, rows: int) -> dict[str, Words]:
    """Return the words of every command that goes through the rows of a log."""
    log, move = str(folder / f"log_{rows}.csv"), str(folder / f"move_{rows}.csv")
    model, out = str(folder / "model.json"), str(folder / "out.csv")
    limits = ["--v-min", "0V", "--v-max", "100V"]
    return {
        "simulate": ["simulate", model, log, "-o", out],
        "compensate": [
            "compensate",
            model,
            move,
            "--displacement",
            "desired_um",
            "-o",
            out,
        ],
        "report": ["report", move, "-o", str(folder / "out.txt")],
        "report --model": [
            "report",
            log,
            "--model",
            model,
            "-o",
            str(folder / "out.txt"),
        ],
        "check": ["check", log, "--voltage", "voltage_V", *limits],
        "check --against": [
            "check",
            log,
            "--voltage",
            "voltage_V",
            *limits,
            "--against",
            log,
        ],
        "waveform": ["waveform", log, "--to", "npy", "-o", str(folder / "out.npy")],
        "identify": ["identify", log, "-o", str(folder / "out.json")],
    }


def seconds(words: Words) -> float:
    """Return the processor's seconds of one process."""
    before = os.times()
    done = subprocess.run(
        [sys.executable, "-m", "dbo_cli", *words, "-q"],
        capture_output=True,
        text=True,
        check=False,
    )
    after = os.times()
    if done.returncode not in (0, 3):
        raise SystemExit(f"dbo {' '.join(words)}: {done.stderr}")
    user = after.children_user - before.children_user
    return user + after.children_system - before.children_system


def main() -> None:
    """Print seconds beyond the start-up and exponents."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=int, default=1_000_000)
    parser.add_argument("--only", default="")
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    sizes = [10**power for power in range(3, 8) if 10**power <= options.most]
    print("processor's seconds beyond the start-up, and between two sizes the exponent")
    print(
        "command           start-up" + "".join(f"  {size:>10,}      " for size in sizes)
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = dbo.identify(str(ROOT / "sample_data" / "identification.csv"))
        model.save(folder / "model.json")
        for rows in (FEW, *sizes):
            write_logs(folder, model, rows)
        for command in commands(folder, FEW):
            if options.only not in command:
                continue
            few = 1_000 if command == "identify" else FEW
            start = min(
                seconds(commands(folder, few)[command]) for _ in range(options.runs)
            )
            text, last = f"{command:16}  {start:8.2f}", None
            for size in sizes:
                if size > LARGEST.get(command, size):
                    break
                took = (
                    min(
                        seconds(commands(folder, size)[command])
                        for _ in range(options.runs)
                    )
                    - start
                )
                exponent = "      "
                if last is not None and last > 0.1 * start and took > 0.0:
                    exponent = f"{math.log10(took / last):6.2f}"
                text += f"  {took:10.3f}{exponent}"
                last = took
            print(text, flush=True)


if __name__ == "__main__":
    main()
