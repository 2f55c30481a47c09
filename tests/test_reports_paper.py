"""Section V from the authors' recordings, as ``make paper`` prints it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAPER = Path(os.environ.get("DBO_PAPER_DATA", ROOT.parent / "shared" / "data" / "paper"))


def run(folder: Path, out: Path) -> subprocess.CompletedProcess[str]:
    script = str(ROOT / "benchmarks" / "paper.py")
    return subprocess.run([sys.executable, script, str(folder), str(out)], capture_output=True, text=True)


@pytest.mark.skipif(
    not (PAPER / "uncompensated.dat").exists(), reason="the authors' recordings are not there"
)
def test_section_v(tmp_path):
    done = run(PAPER, tmp_path / "paper")
    assert (done.returncode, done.stderr) == (0, "")
    lines = [line.split("  ") for line in done.stdout.splitlines()]
    found = {line[0]: [word.strip() for word in line[1:] if word.strip()] for line in lines}
    assert found["K of the identified model (n = 25)"] == ["12.53 um/V", "12.5335 um/V", "ok"]
    assert found["Y_0"] == ["-22.97 um", "-22.9726 um", "ok"]
    assert found["RMSE without compensation (Figs. 8 to 10)"] == ["1.68 um", "1.6791 um", "ok"]
    drawn = {path.name for path in (tmp_path / "paper").iterdir()}
    assert {
        "fig05-drive.png",
        "fig07-loop.svg",
        "fig10-output.png",
        "model-gears.svg",
        "report.html",
    } <= drawn


def test_folder_without_recordings(tmp_path):
    done = run(tmp_path, tmp_path / "paper")
    assert done.returncode == 1
    assert done.stderr == (
        f"paper: {tmp_path}: neither identification.dat nor Model_Vi_Do.dat is there"
        " (README.md says where they are public)\n"
    )
