"""Limits hold, wherever a drive is made; the five faults that were dangerous, and thousands of odd moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dbo_cli

from .program import SAMPLES, dbo, done, model, refused, rms, table, write

TIME = np.arange(300) / 1000.0


@pytest.fixture
def move() -> Path:
    wanted = 2.5 - 1.5 * np.cos(2.0 * np.pi * 5.0 * TIME)
    return write("move.csv", "time_s,displacement_um", TIME, wanted)


# --- 1: no file starts outside the rating ---

STARTS = {
    "typed limits": "--from 1000 --approach 1 --v-min -20 --v-max 120 --max-slew 2000",
    "the identified range": "--from 101 --approach 1",
    "below": "--from -0.5 --approach auto --max-slew 2000",
    "without a way in": "--from 1000",
    "with a sweep": "--from 1000 --condition --v-min 0 --v-max 110",
    "in kilovolts": "--from 1kV --approach 1 --v-min -20 --v-max 120",
}


@pytest.mark.parametrize("case", STARTS)
def test_a_start_outside_the_rating_is_refused(move: Path, case: str) -> None:
    typed = STARTS[case].split()[1].replace("1kV", "1000")
    for on_limit in ("auto", "clip", "error"):
        words = (*STARTS[case].split(), "--on-limit", on_limit, "-o", "drive.csv")
        error = refused(3, "compensate", model("creep"), move, *words)
        assert typed in error.replace("1,000", "1000")


def test_a_start_outside_the_rating_is_refused_in_python() -> None:
    actuator = dbo_cli.read_model(model("creep"))
    wanted = 2.5 - 1.5 * np.cos(2.0 * np.pi * 5.0 * TIME)
    limits = {"v_min": -20, "v_max": 120, "max_slew": 2000, "on_limit": "clip"}
    for start in (1000.0, -21.0, 120.5):
        with pytest.raises(dbo_cli.LimitError):
            actuator.compensate(wanted, time=TIME, from_=start, approach=1, **limits)


def test_a_state_outside_the_rating_is_refused(move: Path) -> None:
    write("high.csv", "time_s,voltage_V", TIME[:3], [0.0, 50.0, 95.0])
    done("simulate", model("creep"), "high.csv", "--save-state", "s.json", "-o", "h")
    words = ("--state", "s.json", "--v-max", 80, "-o", "drive.csv")
    refused(3, "compensate", model("creep"), move, *words)


def test_check_passes_no_row_outside_whatever_the_start() -> None:
    way = np.concatenate([np.linspace(1000.0, 50.0, 100), np.full(50, 50.0)])
    write("drive.csv", "time_s,voltage_V", np.arange(150) / 1000.0, way)
    words = ("--v-min", -20, "--v-max", 120)
    for start in (1000, 300, 50):
        outcome = dbo("check", "drive.csv", *words, "--from", start, "-o", "c.txt")
        assert outcome.code == 3


# --- 2: an approach of auto takes its time ---


@pytest.mark.parametrize("start", [0.0, 20.0, 100.0])
def test_the_seconds_that_a_refused_approach_names_are_enough(start: float) -> None:
    """It named those of a voltage that was tried on the search for where the move goes on."""
    displacement = 4.5 + 0.2 * np.sin(2.0 * np.pi * TIME)
    write("high.csv", "time_s,displacement_um", TIME, displacement)
    words = ("compensate", model("creep"), "high.csv", "--from", start)
    limits = ("--max-slew", 200, "-o", "drive.csv")
    error = refused(3, *words, "--approach", 0.01, *limits)
    seconds = float(error.partition("at least ")[2].split()[0])
    done(*words, "--approach", seconds, *limits)
    assert "at least" in refused(3, *words, "--approach", 0.9 * seconds, *limits)


@pytest.mark.parametrize("more", ["", "--periodic", "--condition"])
def test_an_approach_of_auto_lasts_a_tenth_of_a_second(more: str) -> None:
    phase = 2.0 * np.pi * np.arange(300) / 300
    write("loop.csv", "time_s,displacement_um", TIME, 3.2 + np.sin(phase))
    words = ("--from", 0, "--approach", "auto", "--max-slew", 2000, *more.split())
    done("compensate", model("creep"), "loop.csv", *words, "-o", "drive.csv")
    written = table("drive.csv")
    before = written["time_s"] < -1e-9
    assert before.sum() >= 99
    steps = np.abs(np.diff(np.concatenate([[0.0], written["voltage_V"]])))
    assert steps.max() <= 2.0 * (1.0 + 1e-9)


# --- 3: a lone quote at the end of a file ---


@pytest.mark.parametrize("blank", [" ", "\t", ","])
def test_a_lone_quote_at_the_end_is_no_internal_error(blank: str) -> None:
    rows = "".join(f"{k / 100}{blank}{k % 10}\n" for k in range(100))
    Path("log.txt").write_text(f'time_s{blank}voltage_V\n{rows}"')
    outcome = dbo("simulate", model("small"), "log.txt", "-o", "out.csv")
    assert outcome.code in (0, 1)
    assert "internal" not in outcome.err


# --- 4: Python warns where the shell warns ---


def test_milliseconds_taken_for_seconds_are_warned_of() -> None:
    actuator = dbo_cli.read_model(model("known"))
    trajectory = table(SAMPLES / "trajectory.csv")
    wanted, time = trajectory["displacement_um"], trajectory["time_s"]
    with pytest.warns(dbo_cli.DboWarning):
        actuator.compensate(0.4 * wanted, time=time * 1e3)


# --- 5: a time index counts ---


def test_a_time_index_of_a_frame_counts(log: Path) -> None:
    values = table(log)
    seconds = values["time_s"]
    lasting = pd.to_timedelta(seconds, unit="s")
    voltage, displacement = values["voltage_V"], values["displacement_um"]
    plain = {"gears": 20, "points": 0, "delay": 0.0, "relaxation": (0.01, 0.3)}
    arrays = dbo_cli.identify(voltage, displacement, time=seconds, **plain)
    for index in (seconds, lasting, pd.Timestamp("2026-01-02T03:04:05") + lasting):
        frame = pd.DataFrame(
            {"voltage": voltage, "displacement": displacement},
            index=pd.Index(index, name="time"),
        )
        found = dbo_cli.identify(frame, **plain)
        assert found.fit["rmse"] == pytest.approx(arrays.fit["rmse"], rel=1e-6)


# --- odd moves against limits ---

DRIVES = st.fixed_dictionaries(
    {
        "name": st.sampled_from(["small", "creep", "bent", "soft", "late", "moving"]),
        "v_min": st.sampled_from([None, -30.0, 5.0, 20.0]),
        "v_max": st.sampled_from([None, 60.0, 95.0, 150.0]),
        "slew": st.sampled_from([None, 100.0, 3000.0]),
        "extrapolate": st.booleans(),
        "start": st.sampled_from([None, None, 0.0, 0.3, 1.0]),
        "approach": st.sampled_from([None, 0.05, "auto"]),
        "condition": st.booleans(),
        "return_": st.sampled_from([None, 0.2, 0.9]),
        "periodic": st.booleans(),
        "seed": st.integers(0, 10**6),
        "size": st.sampled_from([0.1, 0.5, 1.5, 1e6]),
    }
)


def wanted_of(actuator: Any, seed: int, size: float, periodic: bool) -> np.ndarray:
    """Return a move of 120 rows that may leave the range by far."""
    random = np.random.default_rng(seed)
    middle = 0.5 * (actuator.output.min + actuator.output.max)
    span = actuator.output.max - actuator.output.min
    phase = 2.0 * np.pi * np.arange(120) / 120
    if periodic:
        return middle + 0.5 * size * span * np.sin(phase + random.uniform(0.0, 6.0))
    steps = random.standard_normal(120).cumsum() / 8.0
    return middle + 0.5 * size * span * (steps + np.sin(random.integers(1, 9) * phase))


@pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
@settings(max_examples=100)
@given(case=DRIVES)
def test_no_row_leaves_the_limits(case: dict[str, Any]) -> None:
    """Whatever is asked: no row beyond the rating, no step faster than the slew, or a refusal."""
    actuator = dbo_cli.read_model(model(case["name"]))
    low, high = actuator.input.min, actuator.input.max
    bottom = low if case["v_min"] is None else case["v_min"]
    top = high if case["v_max"] is None else case["v_max"]
    options: dict[str, Any] = {
        "approach": case["approach"],
        "condition": case["condition"] and not case["periodic"],
        "periodic": case["periodic"],
        "extrapolate": case["extrapolate"],
        "on_limit": "clip",
    }
    if case["start"] is not None:
        options["from_"] = bottom + case["start"] * (top - bottom)
    if case["return_"] is not None and not case["periodic"]:
        options["return_"] = bottom + case["return_"] * (top - bottom)
    time = np.arange(120) / 1000.0
    wanted = wanted_of(actuator, case["seed"], case["size"], case["periodic"])
    try:
        drive = actuator.compensate(
            wanted,
            time=time,
            v_min=case["v_min"],
            v_max=case["v_max"],
            max_slew=case["slew"],
            details=True,
            **options,
        )
    except dbo_cli.DboError as problem:
        assert "internal" not in str(problem)
        assert type(problem).__name__ != "GateError", problem
        return
    voltage = drive.voltage
    assert np.isfinite(voltage).all()
    assert voltage.min() >= bottom and voltage.max() <= top
    inside = voltage[drive.move]
    if not case["extrapolate"]:
        assert inside.min() >= max(bottom, low) and inside.max() <= min(top, high)
    if case["slew"] is not None:
        played = voltage
        if case["start"] is not None:
            played = np.concatenate([[options["from_"]], voltage])
        assert np.abs(np.diff(played)).max() <= case["slew"] / 1000.0 * (1.0 + 1e-9)


def test_the_state_follows_what_was_really_driven() -> None:
    """A clipped move: what comes behind it is driven from where the actuator is."""
    wanted = np.concatenate([np.linspace(2.0, 14.0, 50), np.linspace(14.0, 3.0, 50)])
    write("wish.csv", "displacement_um", wanted)
    words = ("--on-limit", "clip", "--state", "empty")
    done("compensate", model("small"), "wish.csv", *words, "-o", "drive.csv", "-q")
    came = table(done("simulate", model("small"), "drive.csv", "--state", "empty"))
    reachable = np.minimum(wanted, 9.0)
    assert rms(came["displacement_um"] - reachable) < 1e-12
