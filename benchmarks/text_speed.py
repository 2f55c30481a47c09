"""Text in and out: `dbo simulate` against a pandas script, and against the fastest library alone.

    python benchmarks/text_speed.py [ROWS]

Whole processes on a CSV of 1,000,000 rows x 2 columns, in turn, the least of five each;
then the parsers and writers in one process, and the size from which importing polars
pays. The limits are those the project promises, with room for a busy machine. What is
left above polars is at 1,000,000 rows the start: numpy and this program take as long to
load as polars needs for 300,000 rows (`startup.py`).
"""

from __future__ import annotations

import io
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from machine import verdict

ROOT = Path(__file__).resolve().parent.parent
RUNS = 5
FEW = 10  # rows that cost a start-up and no more
# of polars' time of the processors
PROMISED = {"simulate, 25 gears": 1.3, "simulate, identified": 1.45}
LINEAR = {"simulate, identified": 1.35}  # the same with the start-up taken off both
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
PANDAS = (
    "import sys, pandas; pandas.read_csv(sys.argv[1]).to_csv(sys.argv[2], index=False)"
)
POLARS = (
    "import sys, polars; log = polars.read_csv(sys.argv[1]);"
    "log.with_columns((log['voltage_V'] * 0.11).alias('displacement_um')).write_csv(sys.argv[2])"
)


def write_log(path: Path, rows: int) -> None:
    """Write a drive of many amplitudes with full digits, as simulations and converted logs have them."""
    from dbo_cli.logs.sample_block import Column
    from dbo_cli.logs.signal_writer import signal_writer

    time_s = np.arange(rows) / 2000.0
    drive = 50.0 + 50.0 * np.sin(0.7 * time_s) * np.cos(40.0 * time_s)
    with signal_writer(
        str(path), [Column("time", "s"), Column("voltage", "V")]
    ) as writer:
        writer.write(time_s, drive)


def least(function: Callable[[], object], runs: int = RUNS) -> float:
    """Return the least time of several calls."""
    best = float("inf")
    for _ in range(runs):
        begin = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - begin)
    return best


def cost(words: list[str]) -> tuple[float, float]:
    """Return the seconds that a process takes, of the clock and of the processors."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *words], check=True, cwd=ROOT, capture_output=True)
    after, wall = (
        resource.getrusage(resource.RUSAGE_CHILDREN),
        time.perf_counter() - begin,
    )
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def whole_processes(folder: Path, rows: int) -> bool:
    """Compare whole processes; tell whether the promises are kept."""
    log, model, out = folder / "log.csv", folder / "model.json", folder / "out.csv"
    identified = folder / "identified.json"
    model.write_text(json.dumps(MODEL))
    cost(
        [
            "-m",
            "dbo_cli",
            "identify",
            str(ROOT / "sample_data/identification.csv"),
            "-o",
            str(identified),
        ]
    )
    write_log(log, rows)

    def commands(log: Path) -> dict[str, list[str]]:
        """Return the words of each process over one log."""
        simulate = ["-m", "dbo_cli", "simulate"]
        return {
            "pandas, reads and writes it back": ["-c", PANDAS, str(log), str(out)],
            "polars, a column more": ["-c", POLARS, str(log), str(out)],
            "simulate, 25 gears": [*simulate, str(model), str(log), "-o", str(out)],
            "simulate, identified": [
                *simulate,
                str(identified),
                str(log),
                "-o",
                str(out),
            ],
        }

    few = folder / "few.csv"
    write_log(few, FEW)
    runs = [
        {name: cost(words) for name, words in commands(log).items()}
        for _ in range(RUNS)
    ]
    least_of = {
        name: np.min([run[name] for run in runs], axis=0).tolist() for name in runs[0]
    }
    starts = [
        {name: cost(words)[1] for name, words in commands(few).items()}
        for _ in range(RUNS)
    ]
    start_of = {name: min(run[name] for run in starts) for name in runs[0]}
    print(
        f"{rows} rows x 2 columns in, 3 out, whole processes; seconds of the clock, of the processors:"
    )
    for name, (wall, busy) in least_of.items():
        print(f"  {name:34} {wall:6.2f} {busy:6.2f}")
    kept = True
    for own, most in PROMISED.items():
        for other, limit in (
            ("pandas, reads and writes it back", 0.3),
            ("polars, a column more", most),
        ):
            wall, busy = (
                own_s / other_s
                for own_s, other_s in zip(least_of[own], least_of[other], strict=True)
            )
            kept = kept and busy <= limit
            print(
                f"  {own} / {other}: {wall:.2f} {busy:.2f}  (promised of the processors: {limit:g})"
            )
    beyond = {name: least_of[name][1] - start for name, start in start_of.items()}
    for own, limit in LINEAR.items():
        ratio = beyond[own] / beyond["polars, a column more"]
        kept = kept and ratio <= limit
        print(
            f"  {own} / polars, start-up taken off both: {ratio:.2f}  (promised: {limit:g})"
        )
    return kept


def parsers(rows: int) -> None:
    """Show what each way of reading and writing costs inside a process."""
    from dbo_cli.logs import signal_writer as numbers
    from dbo_cli.logs.sample_block import Column
    from dbo_cli.logs.text import text_table as parsing
    from dbo_cli.logs.text.dialect import Dialect

    values = np.random.default_rng(1).normal(size=(2, rows))
    written = io.BytesIO()
    numbers.write_rows(written, list(values), ",")  # of so many rows polars writes
    text = written.getvalue()
    dialect = Dialect(",", ".", "#%", 2, 1, (), ())
    picks = [Column(name, None, name, number) for number, name in enumerate("ab", 1)]
    print(f"one process, {rows} rows x 2 columns:")
    ways: dict[str, Callable[[], object]] = {
        "read, polars": lambda: parsing._parse_fast(text, rows, picks, dialect),
        "read, plain Python": lambda: parsing._parse_plain(text, rows, picks, dialect),
        "write, polars": lambda: numbers.write_rows(
            io.BytesIO(), list(values), ",", blanks=False
        ),
        "write, plain Python": lambda: numbers._plain_rows(list(values), ","),
    }
    costs = {name: least(way, 3) for name, way in ways.items()}
    for name, value in costs.items():
        print(f"  {name:34} {1e9 * value / rows:6.0f} ns a row")
    load = least(
        lambda: subprocess.run(
            [sys.executable, "-c", "import numpy, polars"], check=True
        )
    )
    load -= least(
        lambda: subprocess.run([sys.executable, "-c", "import numpy"], check=True)
    )
    reading = (costs["read, plain Python"] - costs["read, polars"]) / rows
    writing = (costs["write, plain Python"] - costs["write, polars"]) / rows
    pays = load / (reading + 1.5 * writing)
    print(f"  importing polars takes {1e3 * load:.0f} ms: it pays from {pays:.0f} rows")


def main() -> None:
    """Measure, print, and exit with 1 where a promise is not kept (2 on a busy machine)."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        kept = whole_processes(Path(folder), rows)
    parsers(min(rows, 200_000))
    sys.exit(verdict(kept))


if __name__ == "__main__":
    main()
