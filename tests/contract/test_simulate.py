"""``dbo simulate``: any length, any block, any start, and what lies outside the range."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import dbo_cli

from .program import dbo, done, model, refused, table, values_of, write

MOVES = [0.0, 5.0, 10.0, 3.0, 8.0, 2.0, 6.0]
CLOCKED = ("creep", "moving", "late", "soft")


def signal(rows: int, seed: int = 3) -> np.ndarray:
    """Return a drive of 0 to 100 V that turns often."""
    steps = np.random.default_rng(seed).normal(0.0, 6.0, rows)
    return np.abs((np.cumsum(steps) + 300.0) % 200.0 - 100.0)


@pytest.mark.parametrize("name", ["small", *CLOCKED])
def test_a_saved_state_goes_on_where_it_ended(name: str) -> None:
    time = np.arange(400) / 1000.0
    drive = signal(400) / (10.0 if name == "small" else 1.0)
    write("whole.csv", "time_s,voltage_V", time, drive)
    whole = table(done("simulate", model(name), "whole.csv"))["displacement_um"]
    for cut in (1, 77):
        write("first.csv", "time_s,voltage_V", time[:cut], drive[:cut])
        write("second.csv", "time_s,voltage_V", time[cut:], drive[cut:])
        parts = []
        for word, part in (("--save-state", "first.csv"), ("--state", "second.csv")):
            written = table(done("simulate", model(name), part, word, "state.json"))
            parts.append(written["displacement_um"])
        np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0, atol=1e-12)


def test_an_inverse_model_goes_on_from_a_state() -> None:
    time = np.arange(300) / 1000.0
    wanted = 3.0 + np.sin(20.0 * np.minimum(time, 0.1))
    done("invert", model("moving"), "-o", "inverse.json")
    write("first.csv", "time_s,displacement_um", time[:200], wanted[:200])
    write("second.csv", "time_s,displacement_um", time[200:], wanted[200:])
    write("whole.csv", "time_s,displacement_um", time, wanted)
    whole = table(done("simulate", "inverse.json", "whole.csv"))["voltage_V"]
    done("simulate", "inverse.json", "first.csv", "--save-state", "s.json", "-q")
    second = table(done("simulate", "inverse.json", "second.csv", "--state", "s.json"))
    np.testing.assert_allclose(second["voltage_V"], whole[200:], rtol=0, atol=1e-3)


def test_a_state_goes_on_under_a_clock_that_begins_anew() -> None:
    creep = dbo_cli.read_model(model("creep"))
    time, drive = np.arange(50) / 1000.0, signal(100)
    _, state = creep.simulate(drive[:50], time, return_state=True)
    again = creep.simulate(drive[50:], time, state=state)
    np.testing.assert_allclose(again, creep.simulate(drive, sample_rate=1e3)[50:])


def test_a_state_belongs_to_one_model(drive: Path) -> None:
    done("simulate", model("small"), drive, "--save-state", "s.json", "-o", "o.csv")
    values = json.loads(Path("s.json").read_text())
    assert values["version"] == 1
    error = refused(1, "simulate", model("creep"), drive, "--state", "s.json")
    assert "s.json" in error


def test_where_a_run_starts() -> None:
    """At 2 V: coming from 0 V, from 10 V, or after swings that faded."""
    write("drive.csv", "voltage_V", [2.0, 2.0])
    first = {}
    for state in ("auto", "empty", "full", "settled"):
        written = table(done("simulate", model("small"), "drive.csv", "--state", state))
        first[state] = written["displacement_um"][0]
    rising, falling = 2.0, 3.0
    assert first["empty"] == pytest.approx(rising)
    assert first["full"] == pytest.approx(falling)
    assert rising < first["settled"] < falling
    assert first["auto"] == first["settled"]


def test_auto_is_empty_at_the_lower_end() -> None:
    write("drive.csv", "voltage_V", MOVES)
    auto = done("simulate", model("small"), "drive.csv").raw
    assert done("simulate", model("small"), "drive.csv", "--state", "empty").raw == auto
    other = done("simulate", model("small"), "drive.csv", "--state", "full")
    first = table(other)["displacement_um"]
    assert first[0] == pytest.approx(1.0)


OUTSIDE = {"extend": [9.0, 10.0, 0.6], "hold": [9.0, 9.0, 1.0]}


@pytest.mark.parametrize("outside", OUTSIDE)
def test_beyond_the_range(outside: str) -> None:
    write("drive.csv", "voltage_V", [10.0, 11.0, -1.0])
    outcome = done("simulate", model("small"), "drive.csv", "--outside", outside)
    written = table(outcome)["displacement_um"]
    # upwards the last gear goes on, 1.6 * 2.5 / 4 a volt; downwards the first
    np.testing.assert_allclose(written[:2], OUTSIDE[outside][:2], atol=1e-12)
    assert len(outcome.warnings) == 1
    for word in ("2 of 3", "row 2"):
        assert word in outcome.warnings[0]


def test_beyond_the_range_may_be_an_error() -> None:
    write("drive.csv", "voltage_V", [0.0, 10.0, 11.0, -1.0])
    words = ("simulate", model("small"), "drive.csv", "--outside", "error")
    outcome = dbo(*words, "-o", "out.csv")
    assert outcome.code in (1, 3)
    assert "11" in outcome.lines[-1]
    assert "drive.csv:4" in outcome.err or "row 3" in outcome.err
    assert not Path("out.csv").exists()


def test_a_model_that_needs_time_asks_for_it() -> None:
    write("drive.csv", "voltage_V", signal(20))
    error = refused(1, "simulate", model("creep"), "drive.csv")
    assert "--sample-rate" in error and "--time" in error
    rated = done("simulate", model("creep"), "drive.csv", "--sample-rate", "1kHz")
    assert table(rated)["time_s"][:3].tolist() == [0.0, 0.001, 0.002]


def test_a_model_without_time_needs_none() -> None:
    write("drive.csv", "voltage_V", MOVES)
    assert list(table(done("simulate", model("small"), "drive.csv"))) == [
        "voltage_V",
        "displacement_um",
    ]


def test_uneven_stamps_count_as_they_are() -> None:
    """A held drive creeps the same whether its stamps are near or far."""
    fine = np.arange(0.0, 1.0005, 0.001)
    coarse = np.concatenate([fine[:101], [0.5, 1.0]])
    for name, time in (("fine.csv", fine), ("coarse.csv", coarse)):
        drive = np.interp(time, [0.0, 0.1], [0.0, 80.0])
        write(name, "time_s,voltage_V", time, drive)
    one = table(done("simulate", model("creep"), "fine.csv"))["displacement_um"]
    two = table(done("simulate", model("creep"), "coarse.csv"))["displacement_um"]
    assert two[-1] == pytest.approx(one[-1], abs=1e-9)
    assert two[-1] > two[100] + 0.01


def test_time_that_goes_backwards_is_refused() -> None:
    write("drive.csv", "time_s,voltage_V", [0.0, 0.1, 0.05, 0.2], [0, 1, 2, 3])
    error = refused(1, "simulate", model("small"), "drive.csv")
    assert "0.05" in error and ("4" in error or "3" in error)


@pytest.mark.parametrize("name", ["small", "moving"])
def test_long_files_give_what_short_blocks_give(name: str) -> None:
    """More than one block of the reader: the same values as the library on arrays."""
    rows = 80_000
    time = np.arange(rows) / 10_000.0
    drive = np.round(signal(rows), 3) / (10.0 if name == "small" else 1.0)
    write("long.csv", "time_s,voltage_V", time, drive)
    written = table(done("simulate", model(name), "long.csv"))
    actuator = dbo_cli.read_model(model(name))
    expected = actuator.simulate(drive, time=time)
    np.testing.assert_allclose(written["displacement_um"], expected, rtol=0, atol=1e-9)


def test_units_of_the_log_become_those_of_the_model() -> None:
    write("volts.csv", "voltage_V", MOVES)
    write("millivolts.csv", "voltage_mV", 1000.0 * np.array(MOVES))
    one = table(done("simulate", model("small"), "volts.csv"))
    two = table(done("simulate", model("small"), "millivolts.csv"))
    np.testing.assert_allclose(
        two["displacement_um"], one["displacement_um"], atol=1e-12
    )


def test_kinds_that_do_not_match_are_refused() -> None:
    write("log.csv", "voltage_um", MOVES)
    error = refused(1, "simulate", model("small"), "log.csv", "--input", "voltage_um")
    assert "um" in error and "V" in error


def test_an_inverse_model_takes_a_displacement(wish: Path) -> None:
    done("invert", model("small"), "-o", "inverse.json")
    written = table(done("simulate", "inverse.json", wish))
    assert list(written) == ["time_s", "displacement_um", "voltage_V"]
    direct = dbo_cli.read_model(model("small")).compensate(written["displacement_um"])
    np.testing.assert_allclose(written["voltage_V"], direct, atol=1e-12)


def test_other_quantities_keep_their_names() -> None:
    values = values_of("small")
    values["input"] |= {"quantity": "pressure", "unit": "bar"}
    values["output"] |= {"quantity": "angle", "unit": "mrad"}
    Path("muscle.json").write_text(json.dumps(values))
    write("log.csv", "pressure_mbar", [0.0, 5000.0, 10000.0])
    written = table(done("simulate", "muscle.json", "log.csv"))
    assert list(written)[1] == "angle_mrad"
    np.testing.assert_allclose(written["angle_mrad"], [1.0, 4.2, 9.0], atol=1e-12)


def test_negative_gains_come_back_exactly() -> None:
    """A memory with a negative gain: the drive of a wish brings the wish."""
    time = np.arange(300) / 500.0
    wanted = 2.0 + 1.5 * np.sin(2.0 * np.pi * 7.0 * time)
    write("wish.csv", "time_s,displacement_um", time, wanted)
    done("compensate", model("soft"), "wish.csv", "--state", "full", "-o", "drive.csv")
    written = table(done("simulate", model("soft"), "drive.csv", "--state", "full"))
    np.testing.assert_allclose(written["displacement_um"][1:], wanted[1:], atol=1e-11)


def test_the_step_behind_a_gap_of_a_joined_log_is_the_gap() -> None:
    """A model that creeps tells each step of time: joined, or from one file without the gap's rows."""
    time = np.arange(400) / 500.0
    voltage = 50.0 - 50.0 * np.cos(8.0 * time)
    recorded = (time < 0.2) | (time > 0.5)
    write("base.csv", "time_s,displacement_um", time, 0.1 * voltage)
    write("guest.csv", "time_s,voltage_V", time[recorded], voltage[recorded])
    write("one.csv", "time_s,voltage_V", time[recorded], voltage[recorded])
    creep = model("creep")
    words = ("simulate", creep, "base.csv", "--input", "guest.csv::voltage_V")
    joined = table(done(*words, "--time", "time_s"))
    whole = table(done("simulate", creep, "one.csv"))
    for name, values in whole.items():
        np.testing.assert_allclose(joined[name], values, rtol=0.0, atol=1e-12)
