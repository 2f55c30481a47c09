"""The Makefiles of workflow/ for a real day and for a move that is learned, over several logs at once."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_runs_repeated import actuator, move
from virtual_actuator import PRESETS, VirtualActuator, measure, read_drive, write_table

from dbo_cli.hysteresis.model_file import model_to_bytes

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(
    os.name != "posix" or shutil.which("make") is None,
    reason="needs make and a POSIX shell",
)


def makefile(name: str) -> str:
    return (ROOT / "workflow" / name).read_text(encoding="utf-8")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Return a folder with three logs and trajectories, the day's Makefile, and ``dbo`` on the path."""
    (tmp_path / "Makefile").write_text(makefile("day.mk"))
    shim = tmp_path / "bin" / "dbo"
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m dbo_cli "$@"\n')
    shim.chmod(0o755)
    swing = np.repeat([1.0, 1.0, 0.6, 0.3], 150) * (
        0.5 - 0.5 * np.cos(2 * np.pi * np.arange(600) / 150)
    )
    time = np.arange(600) / 100.0
    for folder in ("logs", "trajectories"):
        (tmp_path / folder).mkdir()
    for seed, name in enumerate(("a", "b", "c")):
        y = VirtualActuator(PRESETS["stack"]).play(time, 100.0 * swing, seed)
        columns = {
            "time_s": (time, ""),
            "voltage_V": (100.0 * swing, ""),
            "displacement_um": (y, ".4f"),
        }
        write_table(str(tmp_path / "logs" / f"{name}.csv"), columns)
        wanted = {"time_s": (time, ""), "displacement_um": (1.5 + 9.0 * swing, "")}
        write_table(str(tmp_path / "trajectories" / f"{name}.csv"), wanted)
    return tmp_path


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    # These tests may themselves run under make, of which the inner one must know
    # nothing.
    outer = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("MAKE", "MFLAGS"))
    }
    environment = outer | {
        "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    return subprocess.run(
        ["make", "-j3", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_three_actuators_at_once_and_only_what_changed(bench: Path) -> None:
    done = make(bench)
    assert done.returncode == 0, done.stderr
    drives = sorted(path.name for path in (bench / "drives").iterdir())
    assert drives == ["a.csv", "b.csv", "c.csv"]
    assert make(bench).stdout == "make: Nothing to be done for 'all'.\n"
    later = (bench / "models" / "b.json").stat().st_mtime + 10.0
    os.utime(bench / "logs" / "b.csv", (later, later))
    done = make(bench)
    assert [line for line in done.stdout.splitlines() if line.startswith("dbo")] == [
        "dbo identify logs/b.csv -o models/b.json",
        "dbo compensate models/b.json trajectories/b.csv --on-limit error -o drives/b.csv",
    ]
    (bench / "tracked").mkdir()
    with open(bench / "drives" / "a.csv", encoding="utf-8") as file:
        write_table(
            str(bench / "tracked" / "a.csv"), measure(read_drive(file), "stack", 9)
        )
    done = make(bench)
    assert done.returncode == 0, done.stderr
    [log] = json.loads((bench / "reports" / "a.json").read_text())["logs"]
    assert log["nrmse_percent"] < 2.0


def test_a_report_that_misses_its_limit_stays_missed(bench: Path) -> None:
    for name in ("a", "b"):
        (bench / "logs" / f"{name}.csv").unlink()
    (bench / "tracked").mkdir()
    rows = "".join(f"{k / 100},{k % 10},{k % 10 + 1}\n" for k in range(100))
    (bench / "tracked" / "c.csv").write_text(
        f"time_s,desired_um,displacement_um\n{rows}"
    )
    for _ in range(2):
        done = make(bench)
        assert done.returncode == 2
        assert (
            "dbo: error: c.csv: RMSE 11.1111 % of the move is above the limit of 2 %"
            in done.stderr
        )
        assert not (bench / "reports" / "c.json").exists()


def test_a_bad_log_stops_its_own_branch_only_and_leaves_no_output(bench: Path) -> None:
    (bench / "logs" / "b.csv").write_text(
        "time_s,voltage_V,displacement_um\n0,1,2\n0.1,OVLD,2\n"
    )
    done = make(bench)
    assert done.returncode == 2
    assert (
        "dbo: error: logs/b.csv:3: column 'voltage_V' is not a number: 'OVLD'"
        in done.stderr
    )
    assert not (bench / "models" / "b.json").exists()
    assert not list((bench / "models").glob(".*"))


def test_five_passes_learn_a_move(bench: Path) -> None:
    (bench / "Makefile").write_text(makefile("learning.mk"))
    plant, wrong = actuator(loop=0.45), actuator(loop=0.36)
    (bench / "plant.json").write_bytes(model_to_bytes(plant))
    (bench / "model.json").write_bytes(model_to_bytes(wrong))
    rate, count = 20_000.0, 6_000
    wanted = {"time_s": (np.arange(count) / rate, ""), "displacement_um": (move(), "")}
    write_table(str(bench / "trajectory.csv"), wanted)
    done = make(bench, "PLAY=dbo simulate plant.json")
    assert done.returncode == 0, done.stderr
    errors = []
    for number in range(1, 6):
        measured = np.loadtxt(
            bench / f"pass{number}.csv", delimiter=",", skiprows=1, usecols=2
        )
        errors.append(float(np.sqrt(np.mean((measured - move()) ** 2))))
    assert errors[1] < 0.2 * errors[0]
    assert errors[4] < 0.05 * errors[0]
    assert done.stdout.count("--tracked") == 4
