"""``dbo simulate``: any length, any block, any start, and what lies outside the range."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dbo_cli

from .program import (
    DRIVE, MOVE, done, load, model, refused, simulated, store, table, values_of, write,
)  # fmt: skip

MOVES = [0.0, 5.0, 10.0, 3.0, 8.0, 2.0, 6.0]
CLOCKED = ("creep", "moving", "late", "soft", "amplified")


def signal(rows, seed=3):
    """Return a drive of 0 to 100 V that turns often."""
    steps = np.random.default_rng(seed).normal(0.0, 6.0, rows)
    return np.abs((np.cumsum(steps) + 300.0) % 200.0 - 100.0)


@pytest.mark.parametrize("name", ["small", *CLOCKED])
def test_a_saved_state_goes_on_where_it_ended(name):
    time = np.arange(400) / 1000.0
    drive = signal(400) / (10.0 if name == "small" else 1.0)
    whole = simulated(name, write("whole.csv", DRIVE, time, drive))
    for cut in (1, 77):
        first = write("first.csv", DRIVE, time[:cut], drive[:cut])
        second = write("second.csv", DRIVE, time[cut:], drive[cut:])
        parts = [simulated(name, first, "--save-state", "state.json")]
        parts.append(simulated(name, second, "--state", "state.json"))
        np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0, atol=1e-12)
    assert load("state.json")["version"] == 1
    other = model("creep" if name == "small" else "small")  # a state is of one model
    words = ("simulate", other, "second.csv", "--state", "state.json")
    assert "state.json" in refused(1, *words)
    actuator = dbo_cli.read_model(model(name))  # and a clock may begin anew
    _, state = actuator.simulate(drive[:77], time[:77], return_state=True)
    again = actuator.simulate(drive[77:], time[: 400 - 77], state=state)
    np.testing.assert_allclose(again, whole[77:], rtol=0, atol=1e-12)


def test_arrays_with_uneven_stamps_go_on_as_their_frame_does():
    """The first row came 0 s after the state, of a frame and a file a step after it."""
    time = np.cumsum(np.random.default_rng(4).uniform(1e-3, 2e-3, 90)) - 1e-3
    actuator, drive = dbo_cli.read_model(model("creep")), signal(90)
    _, state = actuator.simulate(drive, time, return_state=True)
    frame = pd.DataFrame({"time_s": time - time[0], "voltage_V": drive})
    from_frame = actuator.simulate(frame, state=state)
    again = actuator.simulate(drive, time - time[0], state=state)
    np.testing.assert_array_equal(again, from_frame)


def test_a_single_row_with_a_rate_has_a_clock():
    write("one.csv", "displacement_um", [2.0])
    done("compensate", model("moving"), "one.csv", "--sample-rate", "1kHz", "-q")


def test_an_inverse_model_goes_on_from_a_state():
    time = np.arange(300) / 1000.0
    wanted = 3.0 + np.sin(20.0 * np.minimum(time, 0.1))
    done("invert", model("moving"), "-o", "inverse.json")
    inverse = Path("inverse.json")
    write("first.csv", MOVE, time[:200], wanted[:200])
    write("second.csv", MOVE, time[200:], wanted[200:])
    whole = simulated(inverse, write("whole.csv", MOVE, time, wanted))
    simulated(inverse, "first.csv", "--save-state", "s.json")
    second = simulated(inverse, "second.csv", "--state", "s.json")
    np.testing.assert_allclose(second, whole[200:], rtol=0, atol=1e-3)


def test_where_a_run_starts():
    """At 2 V: coming from 0 V, from 10 V, or after swings that faded; at an end it is clear."""
    write("drive.csv", "voltage_V", [2.0, 2.0])
    states = ("auto", "empty", "full", "settled")
    first = {one: simulated("small", "drive.csv", "--state", one)[0] for one in states}
    rising, falling = 2.0, 3.0
    assert first["empty"] == pytest.approx(rising)
    assert first["full"] == pytest.approx(falling)
    assert rising < first["settled"] == first["auto"] < falling
    write("drive.csv", "voltage_V", MOVES)
    runs = [simulated("small", "drive.csv", "--state", one) for one in states[:3]]
    auto, empty, full = runs
    np.testing.assert_array_equal(auto, empty)
    assert full[0] == pytest.approx(1.0)


OUTSIDE = {"extend": [9.0, 10.0, 0.6], "hold": [9.0, 9.0, 1.0]}


@pytest.mark.parametrize("outside", OUTSIDE)
def test_beyond_the_range(outside):
    write("drive.csv", "voltage_V", [10.0, 11.0, -1.0])
    outcome = done("simulate", model("small"), "drive.csv", "--outside", outside)
    written = table(outcome)["displacement_um"]
    # upwards the last gear goes on, 1.6 * 2.5 / 4 a volt; downwards the first
    np.testing.assert_allclose(written[:2], OUTSIDE[outside][:2], atol=1e-12)
    assert len(outcome.warnings) == 1
    assert "2 of 3" in outcome.warnings[0] and "row 2" in outcome.warnings[0]
    words = ("--outside", "error", "-o", "out.csv")  # or it is an error
    error = refused(1, "simulate", model("small"), "drive.csv", *words)
    assert "11" in error and "row 2" in error


def test_a_model_that_needs_time_asks_for_it():
    write("drive.csv", "voltage_V", MOVES)
    error = refused(1, "simulate", model("creep"), "drive.csv")
    assert "--sample-rate" in error and "--time" in error
    rated = done("simulate", model("creep"), "drive.csv", "--sample-rate", "1kHz")
    assert table(rated)["time_s"][:3].tolist() == [0.0, 0.001, 0.002]
    free = done("simulate", model("small"), "drive.csv")
    assert list(table(free)) == ["voltage_V", "displacement_um"]


def test_uneven_stamps_count_as_they_are():
    """A held drive creeps the same whether its stamps are near or far."""
    fine = np.arange(0.0, 1.0005, 0.001)
    coarse = np.concatenate([fine[:101], [0.5, 1.0]])
    moved = []
    for time in (fine, coarse):
        drive = np.interp(time, [0.0, 0.1], [0.0, 80.0])
        moved.append(simulated("creep", write("drive.csv", DRIVE, time, drive)))
    assert moved[1][-1] == pytest.approx(moved[0][-1], abs=1e-9)
    assert moved[1][-1] > moved[1][100] + 0.01


def test_time_that_goes_backwards_is_refused():
    write("drive.csv", DRIVE, [0.0, 0.1, 0.05, 0.2], [0, 1, 2, 3])
    error = refused(1, "simulate", model("small"), "drive.csv")
    assert "0.05" in error and ("4" in error or "3" in error)


@pytest.mark.parametrize("name", ["small", "moving"])
def test_long_files_give_what_short_blocks_give(name):
    """More than one block of the reader: the same values as the library on arrays."""
    time = np.arange(70_000) / 10_000.0
    drive = np.round(signal(time.size), 3) / (10.0 if name == "small" else 1.0)
    written = simulated(name, write("long.csv", DRIVE, time, drive))
    expected = dbo_cli.read_model(model(name)).simulate(drive, time=time)
    np.testing.assert_allclose(written, expected, rtol=0, atol=1e-9)


def test_other_quantities_keep_their_names():
    values = values_of("small")
    values["input"] |= {"quantity": "pressure", "unit": "bar"}
    values["output"] |= {"quantity": "angle", "unit": "mrad"}
    store("muscle.json", values)
    write("log.csv", "pressure_mbar", [0.0, 5000.0, 10000.0])
    written = table(done("simulate", "muscle.json", "log.csv"))
    assert list(written)[1] == "angle_mrad"
    np.testing.assert_allclose(written["angle_mrad"], [1.0, 4.2, 9.0], atol=1e-12)


def test_the_step_behind_a_gap_of_a_joined_log_is_the_gap():
    """A model that creeps tells each step of time: joined, or from one file without the gap's rows."""
    time = np.arange(400) / 500.0
    voltage = 50.0 - 50.0 * np.cos(8.0 * time)
    recorded = (time < 0.2) | (time > 0.5)
    write("base.csv", MOVE, time, 0.1 * voltage)
    write("guest.csv", DRIVE, time[recorded], voltage[recorded])
    write("one.csv", DRIVE, time[recorded], voltage[recorded])
    creep = model("creep")
    words = ("simulate", creep, "base.csv", "--input", "guest.csv::voltage_V")
    joined = table(done(*words, "--time", "time_s"))
    whole = table(done("simulate", creep, "one.csv"))
    for name, values in whole.items():
        np.testing.assert_allclose(joined[name], values, rtol=0.0, atol=1e-12)
