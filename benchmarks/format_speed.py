"""How long each format takes to be read, beside text, and how much memory: ratios of one run.

    python -m benchmarks.format_speed [ROWS]    (Linux, which tells the peak of a process's memory)

Each file is read by a process of its own: three columns in blocks, as every command
reads them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SCRIPT = """
import sys, time
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.signal_log import open_log
at = time.perf_counter()
rows = 0
with open_log(sys.argv[1], {"u": ColumnWish("voltage_V"), "y": ColumnWish("displacement_um")}) as log:
    for block in log.blocks():
        rows += len(block)
used = time.perf_counter() - at
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print(rows, used, peak)
"""


def write_all(folder: Path, rows: int) -> list[Path]:
    """Write the same table in every format."""
    import nptdms
    import pandas
    import scipy.io

    rng = np.random.default_rng(1)
    columns = {
        "time_s": np.arange(rows) / 1000.0,
        "voltage_V": rng.normal(size=rows),
        "displacement_um": rng.normal(size=rows),
    }
    table = pandas.DataFrame(columns)
    table.to_csv(folder / "log.csv", index=False)
    table.to_parquet(folder / "log.parquet")
    table.to_feather(folder / "log.feather")
    table.to_hdf(folder / "log.h5", key="log", format="fixed")
    table.to_hdf(folder / "table.h5", key="log", format="table")
    np.savez(folder / "log.npz", **columns)
    np.save(folder / "log.npy", table.to_records(index=False))
    scipy.io.savemat(folder / "log.mat", columns)
    channels = [
        nptdms.ChannelObject("run", name, values) for name, values in columns.items()
    ]
    with nptdms.TdmsWriter(folder / "log.tdms") as file:
        file.write_segment(channels)
    if rows <= 300_000:  # openpyxl takes a minute to write a million rows
        table.to_excel(folder / "log.xlsx", index=False)
    return sorted(folder.iterdir(), key=lambda path: (path.suffix != ".csv", path.name))


def main() -> None:
    """Print a line a format."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    with tempfile.TemporaryDirectory() as name:
        base = 0.0
        print(
            f"{rows:,} rows\n{'file':12s} {'size MB':>8s} {'time / CSV':>11s} {'memory MB':>10s}"
        )
        for path in write_all(Path(name), rows):
            done = subprocess.run(
                [sys.executable, "-c", SCRIPT, str(path)],
                capture_output=True,
                text=True,
                check=True,
            )
            found, seconds, memory = done.stdout.split()
            assert int(found) == rows, path
            base = base or float(seconds)
            size = path.stat().st_size / 1e6
            print(
                f"{path.name:12s} {size:8.1f} {float(seconds) / base:11.2f} {int(memory) / 1e3:10.0f}"
            )


if __name__ == "__main__":
    main()
