"""The sample data: made by a seeded script, the same bytes every time, by an actuator that is not a DBO."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_actuator import PRESETS, VirtualActuator, read_drive

SAMPLES = Path(__file__).resolve().parent.parent / "sample_data"
FILES = ["identification.csv", "trajectory.csv"]


def table(name: str) -> Any:
    return np.loadtxt(SAMPLES / name, delimiter=",", skiprows=1)


def test_made_again_they_are_the_same_bytes(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, str(SAMPLES / "make_samples.py"), str(tmp_path)], check=True
    )
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (SAMPLES / name).read_bytes()


def test_hdf5_holds_the_same_numbers() -> None:
    import h5py

    for name in FILES:
        with h5py.File((SAMPLES / name).with_suffix(".h5")) as file:
            columns = [
                file[key][:]
                for key in ("time", "voltage", "displacement")
                if key in file
            ]
            units = {key: file[key].attrs["units"] for key in file}
        assert np.abs(np.column_stack(columns) - table(name)).max() < 1e-9
        assert units["displacement"] == "um"


def test_they_are_small() -> None:
    assert all(
        path.stat().st_size < 400_000 for path in SAMPLES.iterdir() if path.is_file()
    )


def test_the_trajectory_lies_within_reach() -> None:
    log, wanted = table("identification.csv"), table("trajectory.csv")
    assert log[:, 2].min() < wanted[:, 1].max() < log[:, 2].max() - 0.5
    assert wanted[0, 1] == wanted[:, 1].min() == pytest.approx(0.9)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_actuator_has_a_loop_and_its_sign(name: str) -> None:
    p = PRESETS[name]
    up = np.linspace(p.v_min, p.v_max, 400)
    drive = np.concatenate([up, up[::-1]])
    y = VirtualActuator(p).displacement(np.arange(800) / 100.0, drive)
    middle = (
        np.interp((p.v_min + p.v_max) / 2, up, y[:400]),
        np.interp((p.v_min + p.v_max) / 2, up, y[:399:-1]),
    )
    assert abs(middle[1] - middle[0]) > 0.03 * abs(p.stroke)
    assert np.sign(y[399] - y[0]) == np.sign(p.stroke)
    assert abs(y[399] - y[0]) == pytest.approx(abs(p.stroke), rel=0.1)


def test_the_same_seed_gives_the_same_noise_and_another_does_not() -> None:
    time, drive = np.arange(300) / 500.0, 50.0 + 40.0 * np.sin(np.arange(300) / 20.0)
    actuator = VirtualActuator()
    first = actuator.play(time, drive, seed=1)
    assert np.array_equal(first, actuator.play(time, drive, seed=1))
    assert not np.array_equal(first, actuator.play(time, drive, seed=2))
    assert np.std(first - actuator.displacement(time, drive)) == pytest.approx(
        0.006, rel=0.2
    )


def test_wiping_out_and_creep() -> None:
    """Without creep and lag a full sweep erases the past; with creep it does not quite."""
    import dataclasses

    still = dataclasses.replace(
        PRESETS["stack"], creep=(), amplifier_lag=0.0, sensor_lag=0.0
    )
    loop = np.concatenate([np.linspace(0, 100, 100), np.linspace(100, 0, 100)])
    other = np.concatenate([np.linspace(0, 60, 100), np.linspace(60, 0, 100)])
    time = np.arange(400) / 100.0
    for parameters, same in ((still, True), (PRESETS["stack"], False)):
        ends = [
            VirtualActuator(parameters).displacement(
                time, np.concatenate([past, loop])
            )[300:]
            for past in (loop, other)
        ]
        assert bool(np.abs(ends[0] - ends[1]).max() < 1e-9) is same


def test_a_drive_carries_what_was_desired(tmp_path: Path) -> None:
    drive = tmp_path / "drive.csv"
    drive.write_text("time_s,displacement_um,voltage_V\n0.0,1.0,5.0\n0.1,2.0,10.0\n")
    done = subprocess.run(
        [
            sys.executable,
            str(SAMPLES / "virtual_actuator.py"),
            str(drive),
            "--seed",
            "3",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[0] == "time_s,voltage_V,desired_um,displacement_um"
    columns = read_drive(io.StringIO(done.stdout))
    assert columns["desired"].tolist() == [1.0, 2.0]


@pytest.mark.usefixtures("identified_once")
def test_the_whole_road(dbo: Any, tmp_path: Path) -> None:
    """From the sample log to a compensated move: at most 0.06 of the straight line's error."""
    log, trajectory = SAMPLES / "identification.csv", SAMPLES / "trajectory.csv"
    assert dbo("identify", log, "-o", "model.json", "-q").code == 0
    done = dbo("compensate", "model.json", trajectory, "-o", "drive.csv")
    assert (done.code, done.out) == (0, "")
    begins, expected = done.err.splitlines()
    assert begins.endswith("is not known (--from VOLT says it, --approach ramps there)")
    stated = re.fullmatch(
        r"dbo: \S+: expected error of the move (0\.\d+) um RMS \(.* % of the move\): .*",
        expected,
    )
    assert stated is not None
    line = [
        sys.executable,
        str(SAMPLES / "straight_line.py"),
        str(log),
        str(trajectory),
        "-o",
        "line.csv",
    ]
    subprocess.run(line, check=True)
    for name, seed in (("line", "1"), ("drive", "2")):
        bench = [
            sys.executable,
            str(SAMPLES / "virtual_actuator.py"),
            f"{name}.csv",
            "--seed",
            seed,
        ]
        subprocess.run([*bench, "-o", f"{name}_measured.csv"], check=True)
    done = dbo("report", "line_measured.csv", "drive_measured.csv", "--format", "json")
    before, after = json.loads(done.out)["logs"]
    assert before["rmse"] > 0.4
    assert after["ratio_to_first"] <= 0.06
    assert 0.4 < after["rmse"] / float(stated[1]) < 1.4


def test_the_bench_of_the_closed_loop_is_the_actuator_a_sample_at_a_time() -> None:
    import closed_loop

    drive = 50.0 - 45.0 * np.cos(np.arange(2000) * 0.005) * np.exp(
        -np.arange(2000) / 1500.0
    )
    parameters = PRESETS["stack"]
    whole = VirtualActuator(parameters).displacement(
        np.arange(2000) / closed_loop.RATE, drive
    )
    bench = closed_loop.Bench(parameters)
    assert [bench.step(one)[0] for one in drive] == pytest.approx(
        whole.tolist(), abs=1e-9
    )


@pytest.mark.usefixtures("identified_once")
def test_the_page_about_closed_loops_shows_what_is_printed() -> None:
    import closed_loop

    page = (SAMPLES.parent / "docs" / "closed-loop.md").read_text(encoding="utf-8")
    shown = page.partition("```text\n")[2].partition("```")[0].splitlines()
    printed = closed_loop.table().splitlines()
    assert shown[0] == printed[0]
    for one, other in zip(shown[1:], printed[1:], strict=True):
        assert one[:24] == other[:24]
        assert np.array(one[24:].split(), float) == pytest.approx(
            np.array(other[24:].split(), float), abs=2e-4
        )
        errors = np.array(other[24:].split(), float)
        assert errors[6] < min(errors[[0, 1, 4]]), (
            "better than the controller or the drive alone"
        )
        assert (errors[5:7] < errors[2:4] / 3.0).all(), (
            "and than a straight line beside the controller"
        )
