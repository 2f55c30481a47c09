"""README's day on a bench that reads the voltage back with noise; benchmarks/noisy_benches.py has twenty."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import noisy_benches


def test_the_day_of_readme_passes_with_half_a_percent_of_noise(tmp_path: Path) -> None:
    found = noisy_benches.day(seed=3, noise=0.5, rate=500.0, folder=tmp_path)
    assert found.codes == [0, 0, 0, 0, 0]
    assert found.model == (0.0, 100.0)
    assert found.passed
    with open(tmp_path / "recorded.csv", encoding="utf-8") as file:
        recorded = noisy_benches.read_drive(file)
    assert recorded["voltage"].min() < -1.0 and recorded["voltage"].max() > 101.0
