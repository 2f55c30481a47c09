# ruff: noqa: E501  (a message of one line stands on one line here)
"""Moves that people write by hand: their pieces, the command, and the same numbers from Python."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SMALL_MODEL

import dbo_cli as dbo_api
from dbo_cli.errors import UsageError
from dbo_cli.extras.moves.shapes import TrajectoryOptions, move, risen, started, turned

RESONANT = SMALL_MODEL | {
    "version": 2,
    "stages": [*SMALL_MODEL["stages"], {"type": "dynamics", "sections": [{"frequency": 120.0, "damping": 0.05}]}],
}  # fmt: skip


def made(shape: str, **asked: Any) -> tuple[np.ndarray[Any, Any], ...]:
    return move(TrajectoryOptions(shape, rate=1000.0, range=(2.0, 6.0), **asked)).axes


def test_a_turn_reaches_its_speed_times_its_rows_over_pi_further() -> None:
    turn = turned(5.0, 0.2, 100)
    assert turn.max() == pytest.approx(5.0 + 0.2 * 100 / math.pi)
    assert turn[-1] == pytest.approx(5.0, abs=1e-13)
    steps = np.diff(turn)
    assert steps[0] == pytest.approx(0.2, rel=2e-3) and steps[-1] == pytest.approx(
        -0.2, rel=2e-3
    )
    assert np.abs(np.diff(steps)).max() < 0.2 * math.pi / 100


def test_a_start_comes_from_rest_and_a_rise_is_one_period_of_acceleration() -> None:
    start = started(5.0, 0.2, 50)
    assert start[0] == 0.0 and start[-1] == pytest.approx(5.0) and start.size == 51
    assert (
        np.diff(start)[-1] == pytest.approx(0.2, rel=1e-3) and np.diff(start)[0] < 2e-4
    )
    rise = risen(1000)
    assert rise[-1] == 1.0
    acceleration = np.diff(rise, 2) * 1000.0**2
    assert acceleration.max() == pytest.approx(2.0 * math.pi, rel=1e-3)
    assert acceleration[499] == pytest.approx(0.0, abs=0.05)


def test_a_rasters_lines_are_straight_and_the_slow_axis_stands_still_meanwhile() -> (
    None
):
    fast, slow = made(
        "raster", lines=5, frequency=5.0, bandwidth=50.0, pixels=32, overscan=5.0
    )
    room, turn = 180.0 / 1.1, 20
    inside = math.ceil(room / 32) * 32
    extra = math.ceil(0.05 * inside)
    lead = math.floor(2.0 / math.pi * turn)
    for line in range(5):
        begin = lead + line * (inside + 2 * extra + turn)
        rows = slice(begin + extra, begin + extra + inside + 1)
        ends = (2.0, 6.0) if line % 2 == 0 else (6.0, 2.0)
        assert np.allclose(fast[rows], np.linspace(*ends, inside + 1), atol=1e-12)
        assert np.all(slow[rows] == slow[rows][0]) and slow[rows][0] == pytest.approx(
            2.0 + line
        )
    assert fast.size == slow.size == lead * 2 + 1 + 5 * (inside + 2 * extra) + 4 * turn


def test_one_way_lines_all_run_up() -> None:
    fast, slow = made(
        "raster",
        lines=3,
        frequency=5.0,
        bandwidth=50.0,
        one_way=True,
        slow_range=(0.0, 1.0),
    )
    assert sorted(set(slow[np.diff(slow, prepend=slow[0]) == 0.0].round(12))) == [
        0.0,
        0.5,
        1.0,
    ]
    still = np.diff(slow) == 0.0
    assert np.diff(fast)[still].min() > 0.0


@pytest.mark.parametrize(
    ("shape", "asked"),
    [
        ("raster", {"lines": 4, "frequency": 5.0}),
        ("triangle", {"cycles": 3, "frequency": 5.0}),
        ("sine", {"cycles": 3, "frequency": 5.0}),
        ("spiral", {"turns": 3, "frequency": 5.0}),
        ("staircase", {"steps": 4, "dwell": 0.1}),
    ],
)
def test_every_move_begins_and_ends_at_rest_without_a_jump_of_acceleration(
    shape: str, asked: Any
) -> None:
    for axis in made(shape, bandwidth=20.0, **asked):
        steps = np.diff(axis)
        acceleration = np.diff(steps)
        assert np.abs(steps[[0, -1]]).max() < 2e-3 * np.abs(steps).max()
        assert (
            np.abs(np.diff(acceleration, prepend=0.0)).max()
            < 0.2 * np.abs(acceleration).max()
        )


def test_what_is_not_rounded_keeps_its_corners() -> None:
    (triangle,) = made("triangle", frequency=5.0)
    assert np.allclose(
        triangle, 2.0 + 4.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, 201)))
    )
    (stairs,) = made("staircase", steps=2, dwell=0.003)
    assert stairs.tolist() == [2.0] * 4 + [4.0] * 4 + [6.0] * 4 + [4.0] * 4 + [2.0] * 4
    assert (
        made("staircase", steps=2, dwell=0.003, one_way=True)[0].tolist()
        == stairs.tolist()[:12]
    )
    (rested,) = made("staircase", steps=1, dwell=0.001, rest=0.002)
    assert rested.tolist() == [2.0] * 4 + [6.0] * 2 + [2.0] * 4


def test_tips_and_crests_reach_the_ends_and_no_further() -> None:
    for shape in ("sine", "triangle"):
        (axis,) = made(shape, cycles=3, frequency=5.0, bandwidth=20.0)
        assert (
            axis.max() == pytest.approx(6.0, abs=1e-3)
            and axis.min() >= 2.0
            and axis.max() <= 6.0
        )


def test_a_loop_goes_on_where_it_ended() -> None:
    (sine,) = made("sine", cycles=2, frequency=5.0, loop=True)
    assert np.allclose(sine, 4.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(400) / 200))
    (triangle,) = made("triangle", frequency=5.0, bandwidth=40.0, loop=True)
    assert triangle.size == 200
    around = np.concatenate([triangle, triangle])
    assert np.abs(np.diff(around, 2)).max() == pytest.approx(
        np.abs(np.diff(triangle, 2)).max()
    )


def test_a_spiral_is_archimedes() -> None:
    x, y = made("spiral", turns=4, frequency=5.0, slow_range=(-1.0, 1.0))
    radius = np.hypot((x - 4.0) / 2.0, y)
    middle = slice(300, 700)  # rows of constant speed
    assert np.allclose(np.diff(radius[middle]), 1.0 / (4 * 200), atol=1e-9)


SINE = ["sine", "--rate", 1000, "--frequency", 5, "--range", "2:6"]


def test_the_command_and_the_function_make_the_same_numbers(dbo: Any) -> None:
    words = [
        "raster",
        "--rate",
        2000,
        "--range",
        "2:6",
        "--lines",
        3,
        "--frequency",
        5,
        "--bandwidth",
        50,
    ]
    done = dbo("trajectory", *words, "--unit", "um", "-o", "scan.csv")
    assert done.code == 0
    assert done.err.splitlines() == [
        "dbo: raster: x 1.85853 to 6.14147 um, y 2 to 6 um; 1,211 rows, 0.6055 s",
        "dbo: raster: 3 lines, one in 0.2 s; of a line's 0.2 s 90 % are linear and inside the range",
        "dbo: dbo compensate MODEL scan.csv --displacement x_um -o drive.csv makes the drive, y_um that of the second axis",
    ]
    assert Path("scan.csv").read_text().startswith("time_s,x_um,y_um\n0.0,")
    frame = dbo_api.trajectory(
        "raster",
        rate=2000.0,
        range=(2.0, 6.0),
        lines=3,
        frequency=5.0,
        bandwidth=50.0,
        unit="um",
    )
    table = np.loadtxt("scan.csv", delimiter=",", skiprows=1)
    assert np.array_equal(table, frame.to_numpy()) and list(frame) == ["time", "x", "y"]
    assert frame.attrs["units"] == {"time": "s", "x": "um", "y": "um"}
    assert ["dbo: " + note for note in frame.attrs["notes"]] == done.err.splitlines()[
        :-1
    ]


def test_compensate_takes_an_axis_by_its_name_and_a_loop_as_a_period(
    dbo: Any, model_file: Path
) -> None:
    words = [
        "--rate",
        2000,
        "--lines",
        3,
        "--frequency",
        5,
        "--range",
        "2:6",
        "--bandwidth",
        50,
    ]
    assert (
        dbo(
            "trajectory", "raster", *words, "--model", model_file, "-o", "scan.csv"
        ).code
        == 0
    )
    for axis in ("x_um", "y_um"):
        done = dbo(
            "compensate",
            model_file,
            "scan.csv",
            "--displacement",
            axis,
            "-o",
            "drive.csv",
        )
        assert done.code == 0, done.err
    assert (
        dbo("trajectory", *SINE, "--loop", "--unit", "um", "-o", "loop.csv").code == 0
    )
    assert (
        dbo("compensate", model_file, "loop.csv", "--periodic", "-o", "drive.csv").code
        == 0
    )
    done = dbo("check", "drive.csv", "--loop", "--v-min", 0, "--v-max", 10)
    assert done.code == 0, done.err


def test_corners_are_rounded_to_what_the_model_can_be_trusted_to(dbo: Any) -> None:
    Path("fast.json").write_text(json.dumps(RESONANT))
    done = dbo(
        "trajectory", "triangle", *SINE[1:], "--model", "fast.json", "-o", "t.csv"
    )
    assert done.code == 0, done.err
    assert done.err.splitlines()[-2] == (
        "dbo: triangle: turns and steps take 25 ms: the model can be trusted to 40 Hz"
    )
    rounded = dbo(
        "trajectory",
        "triangle",
        *SINE[1:],
        "--unit",
        "um",
        "--bandwidth",
        40,
        "-o",
        "b.csv",
    )
    assert (
        rounded.code == 0 and Path("t.csv").read_bytes() == Path("b.csv").read_bytes()
    )
    faster = dbo(
        "trajectory",
        "sine",
        *SINE[1:3],
        "--frequency",
        40,
        "--range",
        "2:6",
        "--model",
        "fast.json",
    )
    assert (faster.code, faster.out) == (2, "")
    assert faster.err == (
        "dbo: error: --frequency 40: a sine as fast as the bandwidth of 40 Hz is all turns (below 40, or a higher "
        "--bandwidth)\n"
    )


RASTER = "raster --rate 1000 --range 0:10 --unit um --lines 4 "


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("circle --rate 1000 --range 0:1", "'circle' is none of raster, spiral, staircase, sine, triangle"),
        ("raster --range 0:10", "--rate is missing (dbo trajectory --help lists what there is)"),
        ("sine --rate 9 --range 9:0", "--range 9:0: 9 is not below 0"),
        ("sine --rate 9 --range 9", "--range 9: give LOW:HIGH"),
        (RASTER, "a raster needs --frequency"),
        (RASTER + "--frequency 9 --cycles 3", "--cycles belongs to another shape than raster"),
        ("sine --rate 1000 --range 0:1 --frequency 9", "--unit UNIT: say what the figures are in (um, nm, mrad), "
         "or give --model"),
        (RASTER + "--frequency 60 --bandwidth 50", "--frequency 60: a raster as fast as the bandwidth of 50 Hz is "
         "all turns (below 50, or a higher --bandwidth)"),
        (RASTER + "--frequency 10 --pixels 128", "--frequency 10: a line of 100 rows has no room for 128 pixels "
         "and a turn of 0 rows (at most 7.812 lines a second)"),
        (RASTER + "--frequency 500", "--frequency 500: 2 rows each at a --rate of 1000 (at most 250)"),
        (RASTER + "--frequency 1e-9", "the move takes 4e+09 s, more than the 100,000,000 rows that are written at "
         "most (a lower --rate, or a shorter move)"),
        ("sine --rate 1000 --range 2:10 --frequency 1 --unit um --loop --rest 1", "--loop and --rest exclude each "
         "other: a loop goes on"),
        ("sine --rate 1000 --range 2:10 --frequency 1 --unit um -o x.arb", "x.arb: .arb is a generator's file, "
         "which dbo waveform writes: call this one .csv"),
        ("sine --rate 1000 --range 2:8 --frequency 1 --unit nm --model model.json", "--unit: model.json is in um: "
         "give that"),
        ("sine --rate 1000 --range 2:8 --frequency 1 --model model.json --model model.json", "--model: 2 of them, and a sine has 1 (one an axis)"),
        ("triangle --rate 1000 --range 2:12 --frequency 1 --model model.json", "displacement goes from 2 to 12 um, "
         "turns included, and model.json reaches 1 to 9 (another --range, a lower --frequency or less --overscan)"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_refused(
    dbo: Any, model_file: Path, line: str, message: str
) -> None:
    done = dbo("trajectory", *line.split())
    assert (done.code, done.out, done.err) == (2, "", f"dbo: error: {message}\n")
    assert not Path("x.arb").exists()


def test_python_names_what_is_missing() -> None:
    with pytest.raises(UsageError, match="a sine needs `range`"):
        dbo_api.trajectory("sine", rate=100.0)
    with pytest.raises(UsageError, match="`speed` is no parameter of trajectory"):
        dbo_api.trajectory("sine", rate=100.0, range=(0.0, 1.0), speed=3)


def test_a_model_without_a_unit_makes_a_move_without_one(dbo: Any) -> None:
    plain = SMALL_MODEL | {
        key: SMALL_MODEL[key] | {"unit": None} for key in ("input", "output")
    }
    Path("plain.json").write_text(json.dumps(plain))
    done = dbo("trajectory", *SINE, "--model", "plain.json", "-o", "t.csv")
    assert done.code == 0, done.err
    assert Path("t.csv").read_text().startswith("time_s,displacement\n")
    assert "dbo: sine: displacement 2 to 6; " in done.err
