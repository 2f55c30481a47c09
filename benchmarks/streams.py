"""Reading, writing and simulating a CSV of many rows, beside polars in the same run; and memory.

    python benchmarks/streams.py [ROWS]                      1,000,000 rows of three columns

Every figure is a process of its own on one thread, the least CPU time of three, by
turns with polars. ``read`` and ``read and write`` count the work alone, ``simulate`` a
model of ``dbo identify`` (from ``sample_data``) and everything from the start of the
process on, beside a process in which polars reads and writes the same. Memory is the
peak of the process. Exit 1 where one is above its bound.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MOST_MEMORY = 150.0  # MB
POLARS_READ = """
import time, polars
begun = time.process_time()
polars.read_csv("log.csv")
print(time.process_time() - begun)
"""
POLARS_BOTH = """
import time, polars
begun = time.process_time()
polars.read_csv("log.csv").write_csv("out.csv")
print(time.process_time() - begun)
"""
OURS_READ = """
import time
from dbo_cli.logs import open_log
import polars
begun = time.process_time()
with open_log("log.csv", {"time": None, "voltage": None, "displacement": None}) as log:
    rows = sum(len(block) for block in log.blocks())
print(time.process_time() - begun)
"""
OURS_BOTH = """
import time
from dbo_cli.logs import create, open_log
import polars
begun = time.process_time()
columns = [("time", "s"), ("voltage", "V"), ("displacement", "um")]
with open_log("log.csv", {"time": None, "voltage": None, "displacement": None}) as log:
    with create("out.csv", columns) as out:
        for block in log.blocks():
            out.write(block.time, block.values["voltage"], block.values["displacement"])
print(time.process_time() - begun)
"""
PREPARE = """
import sys
import numpy
from dbo_cli.logs import create
time = numpy.arange(int(sys.argv[1])) / 2000.0
voltage = 50.0 + 50.0 * numpy.sin(0.7 * time) * numpy.cos(40.0 * time)
with create("log.csv", [("time", "s"), ("voltage", "V"), ("displacement", "um")]) as out:
    out.write(time, numpy.round(voltage, 9), numpy.round(0.12 * voltage + 0.8, 9))
"""
SIMULATE = [
    "-m", "dbo_cli", "simulate", "model.json", "log.csv", "-o", "out.csv", "--quiet",
]  # fmt: skip
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "",
}  # fmt: skip


def run(words: list[str], folder: Path) -> tuple[float, float, float]:
    """Run Python once; return what it printed (s), all its CPU time (s), its peak memory (MB)."""
    with open(folder / "printed", "w+") as printed:
        line = [sys.executable, *words]
        environment = {**os.environ, **ENVIRONMENT}
        # compiled modules are kept, as those of an installed program are
        environment["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
        running = subprocess.Popen(line, cwd=folder, env=environment, stdout=printed)
        _, status, usage = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
        if running.returncode != 0:
            raise SystemExit(f"{' '.join(words)[:80]} ended with {running.returncode}")
        printed.seek(0)
        said = printed.read().strip()
    own = float(said) if said else 0.0
    return own, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0


def beside(
    ours: list[str], theirs: list[str], folder: Path, whole: bool
) -> tuple[float, float, float]:
    """Return our seconds, those of polars, and our peak memory, each the least of three by turns."""
    runs = [(run(ours, folder), run(theirs, folder)) for _ in range(3)]
    place = 1 if whole else 0
    seconds = min(own[place] for own, _ in runs)
    other = min(polars[place] for _, polars in runs)
    return seconds, other, min(own[2] for own, _ in runs)


def main() -> int:
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    sample = str(ROOT / "sample_data" / "identification.csv")
    missed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # In processes of their own: the memory of this one would count as theirs.
        run(["-m", "dbo_cli", "identify", sample, "-q", "-o", "model.json"], folder)
        run(["-c", PREPARE, str(rows)], folder)
        cases = {
            "read": (["-c", OURS_READ], ["-c", POLARS_READ], False, 1.15),
            "read and write": (["-c", OURS_BOTH], ["-c", POLARS_BOTH], False, 1.35),
            "simulate": (SIMULATE, ["-c", POLARS_BOTH], True, 1.5),
        }
        print(f"{rows:,} rows of three columns; s of CPU, ratio, peak memory")
        for case, (ours, theirs, whole, bound) in cases.items():
            seconds, other, memory = beside(ours, theirs, folder, whole)
            good = seconds <= bound * other and memory <= MOST_MEMORY
            missed += not good
            mark = "" if good else "  MISSED"
            print(f"{case:16}{seconds:7.2f}   polars{other:6.2f}   {seconds / other:5.2f} "
                  f"(at most {bound}){memory:6.0f} MB{mark}", flush=True)  # fmt: skip
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
