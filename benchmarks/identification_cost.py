"""What identification costs: whole processes, everything automatic, for logs of 8,000 to 1,000,000 samples.

Bounds: 8,000 samples in 2 s; 1,000,000 in 20 s and 500 MB, and 1.3 times another version; about linear in
between. With --beside it runs the version of another Python by turns, on the same logs.

    python benchmarks/identification_cost.py [--beside PYTHON]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_data"))
from virtual_actuator import PRESETS, VirtualActuator

SIZES = (8_000, 100_000, 300_000, 1_000_000)
MANY = 100_000  # above, once is enough


def write_log(path: Path, samples: int) -> None:
    """Write a log of ``samples`` rows: cycles of fading amplitude, 2,000 samples each (200 where few)."""
    period = 200 if samples < 20_000 else 2000
    phase = 2.0 * np.pi * np.arange(samples) / period
    voltage = 50.0 - 50.0 * np.cos(phase) * np.linspace(1.0, 0.2, samples)
    clock = np.arange(samples) / 1000.0
    displacement = VirtualActuator(PRESETS["stack"]).play(clock, voltage, 1)
    table = np.column_stack((clock, voltage, displacement))
    np.savetxt(path, table, fmt=("%.3f", "%.6f", "%.4f"), delimiter=",",
               header="time_s,voltage_V,displacement_um", comments="")  # fmt: skip


def peak_and_time(*words: str) -> tuple[float, float]:
    """Wall seconds and peak resident MB of one process."""
    begin = time.perf_counter()
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(words)} failed")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024.0


def main() -> None:
    """Print one line a size and version."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--beside", help="the Python of another version")
    beside = parser.parse_args().beside
    print("  samples    wall s   us/sample   peak MB")
    with tempfile.TemporaryDirectory() as folder:
        for samples in SIZES:
            log, model = Path(folder) / "log.csv", Path(folder) / "model.json"
            write_log(log, samples)
            for python in filter(None, (sys.executable, beside)):
                words = (python, "-m", "dbo_cli", "identify", str(log), "-o", str(model))
                tries = [peak_and_time(*words) for _ in range(1 if samples > MANY else 3)]
                wall, peak = min(tries)
                line = f"{samples:9,}  {wall:8.2f}  {1e6 * wall / samples:10.1f}  {peak:8.0f}"
                print(f"{line}{'  other version' if python == beside else ''}", flush=True)


if __name__ == "__main__":
    main()
