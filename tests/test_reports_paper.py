"""Section V from the authors' recordings, as ``make paper`` prints it."""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAPER = Path(
    os.environ.get("DBO_PAPER_DATA", ROOT.parent / "shared" / "data" / "paper")
)


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs the script and returns its exit code, output and errors."""

    def ran(folder: Path, out: Path) -> tuple[int, str, str]:
        script = str(ROOT / "benchmarks" / "paper.py")
        monkeypatch.setattr(sys, "argv", [script, str(folder), str(out)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(script, run_name="__main__")
        return (ended.value.code, *capsys.readouterr())

    return ran


@pytest.mark.skipif(
    not (PAPER / "uncompensated.dat").exists(),
    reason="the authors' recordings are not there",
)
def test_section_v(tmp_path, run):
    code, printed, trouble = run(PAPER, tmp_path / "paper")
    assert (code, trouble) == (0, "")
    lines = [line.split("  ") for line in printed.splitlines()]
    found = {
        line[0]: [word.strip() for word in line[1:] if word.strip()] for line in lines
    }
    assert found["K of the identified model (n = 25)"] == [
        "12.53 um/V",
        "12.5335 um/V",
        "ok",
    ]
    assert found["Y_0"] == ["-22.97 um", "-22.9726 um", "ok"]
    assert found["RMSE without compensation (Figs. 8 to 10)"] == [
        "1.68 um",
        "1.6791 um",
        "ok",
    ]
    drawn = {path.name for path in (tmp_path / "paper").iterdir()}
    assert {
        "fig05-drive.png",
        "fig07-loop.svg",
        "fig10-output.png",
        "model-gears.svg",
        "report.html",
    } <= drawn


def test_folder_without_recordings(tmp_path, run):
    code, _, trouble = run(tmp_path, tmp_path / "paper")
    assert code == 1
    assert trouble == (
        f"paper: {tmp_path}: neither identification.dat nor Model_Vi_Do.dat is there"
        " (README.md says where they are public)\n"
    )
