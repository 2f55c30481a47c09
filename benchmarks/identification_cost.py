"""What identification costs: whole processes, everything automatic, for logs of 1,000 to 1,000,000 samples.

Seconds of the processors, the least of three, and the largest peak of memory; exit code
1 where one is beyond what the project promises. With --beside it runs the version of
another Python by turns, on the same logs.

    python benchmarks/identification_cost.py [--beside PYTHON]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from machine import verdict

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sample_data"))
from virtual_actuator import PRESETS, VirtualActuator

PROMISED = {1_000: 1.0, 10_000: 1.5, 100_000: 2.0, 1_000_000: 4.0}  # s of CPU
MOST_MB = 500.0
RUNS = 3


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


def cost(*words: str) -> tuple[float, float]:
    """Seconds of the processors and peak resident MB of one process."""
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(words)} failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0


def main() -> None:
    """Print one line a size and version."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--beside", help="the Python of another version")
    beside, kept = parser.parse_args().beside, True
    print("  samples     CPU s  promised   peak MB")
    with tempfile.TemporaryDirectory() as folder:
        for samples, promised in PROMISED.items():
            log, model = Path(folder) / "log.csv", Path(folder) / "model.json"
            write_log(log, samples)
            pythons = list(filter(None, (sys.executable, beside)))
            words = [
                (python, "-m", "dbo_cli", "identify", str(log), "-o", str(model))
                for python in pythons
            ]
            tries = [[cost(*one) for one in words] for _ in range(RUNS)]
            for python, runs in zip(pythons, zip(*tries, strict=True), strict=True):
                seconds, peak = min(runs)[0], max(run[1] for run in runs)
                other = "  other version" if python == beside else ""
                kept = kept and (
                    bool(other) or (seconds <= promised and peak <= MOST_MB)
                )
                print(
                    f"{samples:9,}  {seconds:8.2f}  {promised:8.1f}  {peak:8.0f}{other}",
                    flush=True,
                )
    sys.exit(verdict(kept))


if __name__ == "__main__":
    main()
