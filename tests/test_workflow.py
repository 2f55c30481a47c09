"""The batch workflows make everything, then nothing, then only what changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

WORKFLOW = Path(__file__).resolve().parent.parent / "workflow"
MAKE, SNAKEMAKE = shutil.which("make"), shutil.which("snakemake")
DBO = f"{sys.executable} -m dbo_cli"
NAMES = ("left", "right", "spare")
OPTIONS = "--gears 8 --points 0 --delay 0 --relaxation 0"
KINDS = ("model.json", "drive.csv", "report.json", "report.csv")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with three small logs of different forms and a trajectory."""
    from dbo_cli.logs.signal_writer import OutColumn, signal_writer

    (tmp_path / "logs").mkdir()
    time = np.arange(600) / 100
    drive = 5.0 - 5.0 * np.cos(2 * np.pi * time)
    for name, ending, gain in zip(NAMES, (".csv", ".h5", ".csv.gz"), (1.0, 1.2, 0.8), strict=True):
        columns = [OutColumn("time", "s"), OutColumn("voltage", "V"), OutColumn("displacement", "um")]
        with signal_writer(str(tmp_path / "logs" / (name + ending)), columns) as writer:
            displacement = gain * (
                drive + 0.02 * drive**2 + 0.3 * np.sign(np.gradient(drive)) * np.sqrt(drive * (10 - drive))
            )
            writer.write(time, drive, displacement)
    with signal_writer(
        str(tmp_path / "trajectory.csv"), [OutColumn("time", "s"), OutColumn("displacement", "um")]
    ) as out:
        out.write(time, 2.0 + np.sin(time))
    return tmp_path


def by_make(folder: Path) -> str:
    words = [str(MAKE), "-f", str(WORKFLOW / "Makefile"), "-j2", f"DBO={DBO}", f"IDENTIFY={OPTIONS}"]
    return finished(words, folder)


def by_snakemake(folder: Path) -> str:
    settings = [f"dbo={DBO}", f"identify={OPTIONS}"]
    words = [str(SNAKEMAKE), "-s", str(WORKFLOW / "Snakefile"), "--cores", "2", "--rerun-triggers", "mtime"]
    return finished([*words, "--config", *settings], folder)


def finished(words: list[str], folder: Path) -> str:
    environment = os.environ | {"PYTHONPATH": str(WORKFLOW.parent), "MAKEFLAGS": ""}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def made_at(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "results").iterdir()}


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(by_make, marks=pytest.mark.skipif(MAKE is None, reason="make is not here"), id="make"),
        pytest.param(
            by_snakemake,
            marks=pytest.mark.skipif(SNAKEMAKE is None, reason="Snakemake is not here"),
            id="snakemake",
        ),
    ],
)
def test_only_what_changed_is_made_again(engine, bench: Path) -> None:  # type: ignore[no-untyped-def]
    engine(bench)
    first = made_at(bench)
    assert set(first) == {f"{name}.{kind}" for name in NAMES for kind in KINDS} | {"summary.csv"}
    summary = (bench / "results" / "summary.csv").read_text().splitlines()
    assert len(summary) == 1 + len(NAMES)
    assert [line.split(",")[0] for line in summary[1:]] == ["left.csv", "right.h5", "spare.csv.gz"]

    engine(bench)
    assert made_at(bench) == first

    with open(bench / "logs" / "left.csv", "a") as log:
        log.write("6.0,0.0,0.0\n")
    engine(bench)
    changed = {name for name, stamp in made_at(bench).items() if stamp != first[name]}
    assert changed == {f"left.{kind}" for kind in KINDS} | {"summary.csv"}
