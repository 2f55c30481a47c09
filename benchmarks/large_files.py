"""Logs larger than memory: time and peak memory of `dbo simulate`, from a file and through a pipe.

    python benchmarks/large_files.py [MILLIONS_OF_ROWS]

The log (two columns, 1.4 GB for the default of 50 million rows) is made on the fly; a
tenth of it goes first, so that linearity shows. The limits are those the project
promises.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from text_speed import MODEL, ROOT

MOST_MEMORY_MB = 400
LINEAR_WITHIN = 1.5  # time a row of the whole log, against that of its tenth
PART = 500_000


class Run(NamedTuple):
    """Seconds and peak resident memory (MB) of a process."""

    seconds: float
    memory: float


def write_log(path: Path, rows: int) -> None:
    """Write a drive of many amplitudes, part by part."""
    from dbo_cli.logs.sample_block import Column
    from dbo_cli.logs.signal_writer import signal_writer

    with signal_writer(
        str(path), [Column("time", "s"), Column("voltage", "V")]
    ) as writer:
        for start in range(0, rows, PART):
            time_s = np.arange(start, min(rows, start + PART)) / 2000.0
            writer.write(
                time_s,
                np.round(50.0 + 50.0 * np.sin(0.7 * time_s) * np.cos(40.0 * time_s), 9),
            )


def simulate(model: Path, log: Path, out: Path, piped: bool) -> Run:
    """Run ``dbo simulate`` from the file, or with the file poured through pipes on both sides."""
    begin = time.perf_counter()
    if piped:
        with open(out, "wb") as sink:
            pouring = subprocess.Popen(["cat", str(log)], stdout=subprocess.PIPE)
            words = [sys.executable, "-m", "dbo_cli", "simulate", str(model), "-"]
            running = subprocess.Popen(
                words, stdin=pouring.stdout, stdout=subprocess.PIPE, cwd=ROOT
            )
            draining = subprocess.Popen(["cat"], stdin=running.stdout, stdout=sink)
            assert pouring.stdout is not None and running.stdout is not None
            pouring.stdout.close()
            running.stdout.close()
            _, status, usage = os.wait4(running.pid, 0)
            pouring.wait()
            draining.wait()
    else:
        words = [
            sys.executable,
            "-m",
            "dbo_cli",
            "simulate",
            str(model),
            str(log),
            "-o",
            str(out),
        ]
        running = subprocess.Popen(words, cwd=ROOT)
        _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    assert running.returncode == 0, f"dbo simulate ended with {running.returncode}"
    return Run(time.perf_counter() - begin, usage.ru_maxrss / 1024.0)


def main() -> None:
    """Measure, print, and exit with 1 where a promise is not kept."""
    rows = int(1e6 * float(sys.argv[1])) if len(sys.argv) > 1 else 50_000_000
    kept = True
    with tempfile.TemporaryDirectory() as folder:
        model, log, out = (
            Path(folder, name) for name in ("model.json", "log.csv", "out.csv")
        )
        model.write_text(json.dumps(MODEL))
        runs: dict[tuple[int, str], Run] = {}
        for size in (rows // 10, rows):
            write_log(log, size)
            told = f"{size / 1e6:5.1f} million rows, {log.stat().st_size / 1e9:.2f} GB"
            for way in ("file", "pipes"):
                run = runs[size, way] = simulate(model, log, out, way == "pipes")
                pace = f"{run.seconds:6.1f} s, {1e9 * run.seconds / size:4.0f} ns a row"
                print(
                    f"{told}, {way}: {pace}, peak memory {run.memory:4.0f} MB",
                    flush=True,
                )
                out.unlink()
        for way in ("file", "pipes"):
            memory = runs[rows, way].memory
            growth = runs[rows, way].seconds / runs[rows // 10, way].seconds / 10.0
            print(
                f"{way}: peak memory {memory:.0f} MB (promised: at most {MOST_MEMORY_MB})"
            )
            print(
                f"{way}: time a row, whole / tenth: {growth:.2f} (linear: at most {LINEAR_WITHIN:g})"
            )
            kept = kept and memory <= MOST_MEMORY_MB and growth <= LINEAR_WITHIN
    sys.exit(0 if kept else 1)


if __name__ == "__main__":
    main()
