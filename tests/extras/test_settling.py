"""How long to wait: settling times against long simulations, steps between levels, what `show` says of it."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_runs_repeated import RATE, actuator

import dbo_cli
from dbo_cli import InputError, LimitError, UsageError
from dbo_cli.drives.gate import DriveFigures
from dbo_cli.extras.moves.settling import StepTimes, distance_in, settling_seconds
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import BacklashStage, Relaxation
from dbo_cli.hysteresis.model_file import model_to_bytes
from dbo_cli.runs.api import Model


@pytest.mark.parametrize("seed", [6, 7, 10, 11, 13, 15, 16, 28, 34])
def test_a_random_actuator_settles_when_it_says(seed: int) -> None:
    """A step of a random actuator, to a random distance: some settle within few periods of the resonance."""
    rng = np.random.default_rng(seed)
    frequency, damping = (
        float(rng.uniform(100.0, 1500.0)),
        float(10.0 ** rng.uniform(-2.2, -0.8)),
    )
    taus = tuple(sorted((10.0 ** rng.uniform(-1.5, 1.2, 2)).tolist()))
    creep = Relaxation(0.0, taus, tuple(rng.uniform(0.0005, 0.004, 2).tolist()))
    plant = actuator(frequency=None)
    gears = plant.stages[0]
    assert isinstance(gears, BacklashStage)
    stages = (BacklashStage(gears.dx, gears.dy, 0.0, 0.0, creep), *plant.stages[1:])
    if seed % 3:
        ring = Resonance(frequency, damping)
        late = () if seed % 2 else (Lag(float(10.0 ** rng.uniform(-4.0, -2.5))),)
        stages = (*stages, DynamicsStage((*late, ring)))
    plant = dataclasses.replace(plant, stages=stages)
    begin, end = rng.uniform(0.0, 100.0, 2).tolist()
    if abs(begin - end) < 10.0:
        end = begin + 20.0 if begin < 50.0 else begin - 20.0
    distance = abs(end - begin) * 0.12 * 10.0 ** rng.uniform(-3.5, -0.7)
    seconds = settling_seconds(plant, begin, end, distance)
    rest = plant.simulate(
        np.full(int(5000.0 * taus[1]), begin), plant.start(begin), time_step=0.005
    ).state
    y = plant.simulate(
        np.full(int((25.0 * taus[1] + 1.0) * RATE), end), rest, time_step=1.0 / RATE
    ).y
    beyond = int(np.flatnonzero(np.abs(y - y[-1]) > distance)[-1]) + 1
    assert seconds == pytest.approx(beyond / RATE, rel=0.1)


def stairs(levels: Any, dwell: int = 60) -> np.ndarray[Any, Any]:
    """Return levels that are held, with straight ways of 20 rows between them."""
    values = np.asarray(levels, dtype=np.float64)
    ways = [np.linspace(a, b, 22)[1:-1] for a, b in itertools.pairwise(values)]
    rows = [np.full(dwell, values[0])]
    for way, level in zip(ways, values[1:], strict=True):
        rows += [way, np.full(dwell, level)]
    return np.concatenate(rows)


@pytest.mark.parametrize("cut", [1, 7, 60, 10_000])
def test_levels_are_found_however_blocks_are_cut(cut: int) -> None:
    wanted = stairs([1.0, 3.0, 2.0, 2.0, 6.0])
    drive = np.arange(wanted.size, dtype=np.float64)
    held = StepTimes(actuator(frequency=None), 0.01)
    for k in range(0, wanted.size, cut):
        held.add(wanted[k : k + cut], drive[k : k + cut])
    # The level of 2 is held on: its "step" is none.
    assert [one[:2] for one in held.times()] == [
        (9.0, 89.0),
        (89.0, 169.0),
        (169.0, 329.0),
    ]
    sine = StepTimes(actuator(frequency=None), 0.01)
    sine.add(np.sin(np.arange(400) / 20.0), drive[:400])
    assert sine.times() == []


def test_compensate_says_how_long_each_step_of_a_staircase_takes() -> None:
    plant = actuator(frequency=None)
    done = Model(plant).compensate(
        stairs([2.0, 3.0, 7.0, 5.0], 2000),
        sample_rate=RATE,
        state="empty",
        settle="10nm",
        details=True,
    )
    (note,) = (note for note in done.notes if "held levels" in note)
    found = re.fullmatch(
        r"`wanted`: within 0.01 um, steps between held levels take (.*)", note
    )
    assert found is not None
    steps = [
        [float(text) for text in re.findall(r"[\d.]+", one)]
        for one in found[1].split(" V)")[:-1]
    ]
    assert len(steps) == 3 and steps[0][2] == steps[1][1] and steps[1][2] == steps[2][1]
    for seconds, begin, end in steps:
        assert seconds == pytest.approx(
            settling_seconds(plant, begin, end, 0.01), rel=0.01
        )


def test_very_many_steps_are_timed_from_the_smallest_to_the_largest() -> None:
    plant = actuator(frequency=None)
    steps = [(50.0, 50.0 + 0.1 * k) for k in range(1, 401)]
    timed = StepTimes(plant, 0.01)
    timed.steps = steps
    times = timed.times()
    assert len(times) == 300 and times[0][:2] == steps[0] and times[-1][:2] == steps[-1]
    (_, note) = timed.notes("log", DriveFigures(low=0.0, high=90.0, rows=2))
    assert "of 400 steps between held levels (300 looked at) the shortest takes" in note


def test_many_steps_are_told_by_the_shortest_and_the_summary(dbo: Any) -> None:
    plant, wanted = (
        actuator(frequency=None),
        stairs(np.random.default_rng(2).uniform(2.0, 9.0, 20), 40),
    )
    Path("plant.json").write_bytes(model_to_bytes(plant))
    np.savetxt("wish.csv", np.column_stack([np.arange(wanted.size) / RATE, wanted]), delimiter=",",
               header="time_s,desired_um", comments="")  # fmt: skip
    done = dbo(
        "compensate",
        "plant.json",
        "wish.csv",
        "-o",
        "d.csv",
        "--settle",
        "50nm",
        "--summary",
        "s.json",
    )
    assert done.code == 0, done.err
    told = json.loads(Path("s.json").read_text())["settling"]
    assert len(told) == 19
    for one in told[::6]:
        assert one["seconds"] == settling_seconds(plant, one["begin"], one["end"], 0.05)
    ends = [
        f"{one['seconds']:.3g} s"
        for one in sorted(told, key=lambda one: one["seconds"])
    ]
    assert f"of 19 steps between held levels the shortest takes {ends[0]}" in done.err
    assert f"the longest {ends[-1]}" in done.err and "(--summary has each)" in done.err


def test_distances_have_units_or_the_model_s() -> None:
    assert distance_in("5nm", "um") == 0.005
    assert distance_in("5 nm", "nm") == 5.0
    assert distance_in("0.01", "um") == distance_in(0.01, None) == 0.01
    for text, why in {
        "5 V": "5 V: cannot be converted; a figure in um is needed",
        "0nm": "0nm: give a distance above 0, such as 0.005 or 5nm",
        "near": "near: give a number, or one with its unit such as 5um",
        "-1nm": "-1nm: give a distance above 0, such as 0.005 or 5nm",
    }.items():
        with pytest.raises(UsageError) as raised:
            distance_in(text, "um")
        assert str(raised.value) == f"`settle` {why}"


def test_show_says_how_long_to_wait(dbo: Any) -> None:
    with open("plant.json", "wb") as file:
        file.write(model_to_bytes(actuator()))
    plain = dbo("show", "plant.json")
    asked = dbo("show", "plant.json", "--settle", "50nm")
    plant = actuator()
    seconds = max(
        settling_seconds(plant, 0.0, 100.0, 0.05),
        settling_seconds(plant, 100.0, 0.0, 0.05),
    )
    line = (
        f"settling: {seconds:.3g} s after a step over the whole drive,"
        " until creep and ringing stay within "
    )
    assert line + "0.05 um" in " ".join(asked.out.split())
    assert "settling" not in plain.out
    content = json.loads(
        dbo("show", "plant.json", "--settle", "0.05", "--format", "json").out
    )
    assert content["settling"] == {"distance": 0.05, "unit": "um", "seconds": seconds}
    with open("sure.json", "wb") as file:
        file.write(
            model_to_bytes(dataclasses.replace(plant, fit={"expected_rmse": 0.004}))
        )
    below = json.loads(
        dbo("show", "sure.json", "--settle", "3nm", "--format", "json").out
    )["settling"]
    assert below["hint"] == "below the model's expected error of 0.004 um"
    assert "(below the model's expected error" in " ".join(
        dbo("show", "sure.json", "--settle", "3nm").out.split()
    )
    assert "hint" not in content["settling"]
    wrong = dbo("show", "plant.json", "--settle", "5mrad")
    assert wrong.code == 2
    assert (
        wrong.err
        == "dbo: error: --settle 5mrad: cannot be converted; a figure in um is needed\n"
    )


def test_a_run_in_beyond_the_limits_counts_its_own_rows() -> None:
    period = 6.0 + 5.0 * np.sin(2.0 * np.pi * np.arange(400) / 400.0)
    with pytest.raises(LimitError) as raised:
        Model(actuator(frequency=None)).compensate(
            period,
            sample_rate=RATE,
            periodic=True,
            passes=2,
            state="empty",
            v_max=60.0,
            on_limit="error",
        )
    assert re.search(
        r": [\d,]+ of 800 samples \(first in the rows before row 1\) beyond",
        str(raised.value),
    )


def test_a_run_in_says_what_it_costs() -> None:
    period = 6.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(400) / 400.0)
    done = Model(actuator(frequency=None)).compensate(
        period, sample_rate=RATE, periodic=True, passes=2, state="empty", details=True
    )
    assert done.values.size == 1200
    low, high = done.values[:800].min(), done.values[:800].max()
    told = f"800 rows, 0.04 s, from {low:.6g} to {high:.6g} V, 2 passes of run-in among them"
    assert f"`wanted`: before the first period stand {told}" in done.notes


@pytest.mark.parametrize("role", ["voltage", "time"])
def test_an_array_beside_a_log_is_refused(tmp_path: Any, role: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,desired_um,measured_um\n0,1,1\n1,2,2\n")
    with pytest.raises(UsageError) as raised:
        dbo_cli.report(str(path), **{role: np.zeros(2)})
    assert (
        str(raised.value)
        == f"`{role}`: beside tables and files give the name or number of their column"
    )


def test_dwells_alone_are_scored(dbo: Any) -> None:
    """The measurement is 0.5 off on the ways and for 10 rows after them, and 0.01 off on the stairs."""
    wanted = stairs([1.0, 4.0, 2.0], 60)
    off = np.full(wanted.size, 0.5)
    for k in (0, 80, 160):
        off[k + (10 if k else 0) : k + 60] = 0.01
    table = np.column_stack([np.arange(wanted.size) / 1000.0, wanted, wanted + off])
    np.savetxt(
        "log.csv",
        table,
        delimiter=",",
        header="time_s,desired_um,measured_um",
        comments="",
        fmt="%.9g",
    )
    for text in (["--block-rows", "13"], []):
        done = json.loads(
            dbo("report", "log.csv", "--dwell", "0.01", "--format", "json", *text).out
        )
        (log,) = done["logs"]
        assert log["samples"] == 50 + 50 + 50
        assert log["rmse"] == pytest.approx(0.01, rel=1e-9)
        assert done["notes"][0] == (
            "log.csv: 150 of 220 rows count, at which what is desired has been held for 0.01 s"
        )
    assert (
        json.loads(dbo("report", "log.csv", "--format", "json").out)["logs"][0][
            "samples"
        ]
        == 220
    )
    assert (
        json.loads(dbo("report", "log.csv", "--dwell", "0", "--format", "json").out)[
            "logs"
        ][0]["samples"]
        == 177
    )
    never = dbo("report", "log.csv", "--dwell", "1")
    assert (never.code, never.err) == (
        1, "dbo: error: log.csv: what is desired is nowhere held for 1 s (--dwell)\n"
    )  # fmt: skip
    with pytest.raises(
        InputError, match=r"^log: no time is given, and `dwell` depends on it"
    ):
        dbo_cli.report(wanted, wanted + off, dwell=0.01)
    with pytest.raises(UsageError, match=r"^`dwell` and `model` exclude each other: "):
        dbo_cli.report(
            wanted, wanted, sample_rate=1e3, dwell=0.01, model=Model(actuator())
        )


@pytest.mark.usefixtures("identified_once")
def test_the_page_on_stepping_runs_as_it_stands_there(dbo: Any) -> None:
    root = Path(__file__).resolve().parents[2]
    page = (root / "docs" / "stepping.md").read_text(encoding="utf-8")
    shutil.copy(root / "sample_data" / "identification.csv", ".")
    written = ""
    for kind, block in re.findall(
        r"^```(\w+)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
    ):
        if kind == "text":
            assert " ".join(block.split()) in written
            continue
        for line in block.splitlines():
            program, *words = line.split()
            assert program == "dbo"
            done = dbo(*words)
            assert done.code == 0, done.err
            written = " ".join((done.out + done.err).split())
