"""Time and peak memory of ``dbo report`` with figures, beside reading the same file and doing nothing.

    python benchmarks/report_speed.py [ROWS]

Writes a log of ROWS rows (10 million): time, voltage, desired and measured
displacement, as CSV and as HDF5, into a temporary folder. Every figure is that of a
whole process, start included, the better of two. Targets: at most 400 MB, and at most 4
times the time of reading.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.whole_output import write_whole

READ = """
import sys
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.signal_log import open_log
want = {"drive": ColumnWish("voltage"), "desired": ColumnWish("desired"), "measured": ColumnWish("measured")}
with open_log(sys.argv[1], want) as log:
    for block in log.blocks():
        pass
"""
COLUMNS = (
    Column("time", "s", "time"),
    Column("voltage", "V", "voltage"),
    Column("desired", "um", "displacement"),
    Column("measured", "um", "displacement"),
)


def write_log(path: Path, rows: int) -> None:
    """Write a fading sine at 10 kHz with a lag and noise."""
    rng = np.random.default_rng(0)
    with signal_writer(str(path), COLUMNS) as writer:
        for start in range(0, rows, 1 << 18):
            now = np.arange(start, min(start + (1 << 18), rows)) / 10_000.0
            amplitude = 0.6 + 0.4 * np.cos(0.01 * now)
            wanted = -20.0 * amplitude * np.cos(2.0 * np.pi * 1.7 * now)
            late = -20.0 * amplitude * np.cos(2.0 * np.pi * 1.7 * now - 0.1)
            measured = np.round(late + rng.normal(0.0, 0.1, len(now)), 4)
            writer.write(
                now, np.round(1.8 + wanted * 0.09, 5), np.round(wanted, 5), measured
            )


def cost(command: list[str]) -> tuple[float, float]:
    """Return seconds and peak resident memory in MB of one process, the better of two runs."""
    best = (float("inf"), float("inf"))
    for _ in range(2):
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        took = time.perf_counter() - started
        if os.waitstatus_to_exitcode(status):
            raise SystemExit(f"failed: {' '.join(command)}")
        best = min(best, (took, usage.ru_maxrss / 1024.0))
    return best


def main() -> None:
    """Print one line a way."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000_000
    dbo = [sys.executable, "-m", "dbo_cli", "report"]
    with tempfile.TemporaryDirectory() as folder:
        write_whole(f"{folder}/read.py", READ.encode())
        for name in ("log.csv", "log.h5"):
            log = Path(folder, name)
            write_log(log, rows)
            figures = ["--voltage", "voltage", "--figures", f"{folder}/figures"]
            page = ["-o", f"{folder}/report.html"]
            ways = {
                "read and do nothing": [sys.executable, f"{folder}/read.py", str(log)],
                "report": [*dbo, str(log)],
                "report, automatic lag": [*dbo, str(log), "--lag", "auto"],
                "report by 10 s": [*dbo, str(log), "--segment", "10"],
                "report, 14 figure files": [*dbo, str(log), *figures],
                "report, page of 7 figures": [
                    *dbo,
                    str(log),
                    "--voltage",
                    "voltage",
                    *page,
                ],
                "report, both": [*dbo, str(log), *figures, *page],
            }
            print(f"{name}: {rows} rows, {log.stat().st_size / 1e6:.0f} MB")
            reading = 0.0
            for title, command in ways.items():
                took, memory = cost(command)
                reading = reading or took
                print(
                    f"  {title:<26}{took:7.2f} s {took / reading:6.2f} x {memory:7.0f} MB",
                    flush=True,
                )


if __name__ == "__main__":
    main()
