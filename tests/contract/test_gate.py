"""The gate: whatever voltage leaves the program keeps the limits, and ``check`` is of one mind with it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dbo_cli

from .program import Floats, dbo, done, model, refused, table, values_of, write

TIME = np.arange(400) / 1000.0


# --- what the program wrote passes its own check ---

CLOCKS = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["even", "jitter", "uneven", "waits", "two rates"]),
        "step": st.sampled_from([1e-3, 1.0 / 3000.0, 0.0123]),
        "start": st.sampled_from([0.0, 100.0290773748946, -3.7, 1.7e6]),
        "decimals": st.sampled_from([None, None, 6, 9]),
        "rows": st.integers(20, 150),
        "seed": st.integers(0, 10**6),
        "slew": st.sampled_from([None, 60.0, 700.0]),
        "top": st.sampled_from([88.0, 100.0]),
        "words": st.sampled_from(
            ["", "--from 3 --approach auto", "--from 3 --approach 2", "--condition"]
        ),
        "back": st.sampled_from([None, 5.0, 60.0]),
    }
)


def stamps(case: dict[str, Any]) -> Floats:
    """Return the times of a trajectory: even, nearly even, or not at all."""
    random, rows = np.random.default_rng(case["seed"]), case["rows"]
    steps = {
        "even": np.ones(rows),
        "jitter": random.uniform(0.98, 1.02, rows),
        "uneven": random.uniform(0.5, 1.5, rows),
        "waits": random.exponential(1.0, rows) + 0.01,
        "two rates": np.where(np.arange(rows) % 40 < 20, 1.0, 10.0),
    }[case["kind"]]
    time = case["start"] + case["step"] * np.cumsum(steps)
    return time if case["decimals"] is None else np.round(time, case["decimals"])


@settings(max_examples=40)
@given(case=CLOCKS)
def test_what_was_written_passes_the_check(case: dict[str, Any]) -> None:
    time = stamps(case)
    phase = 6.0 * np.arange(time.size) / time.size
    wanted = 3.2 - 2.5 * np.cos(phase + 0.1) * np.cos(2.7 * phase)
    write("wish.csv", "time_s,displacement_um", time, wanted)
    limits = ["--v-min", 3, "--v-max", case["top"]]
    if case["slew"] is not None:
        limits += ["--max-slew", case["slew"]]
    words = [*limits, "--on-limit", "clip", *case["words"].split()]
    if case["back"] is not None:
        words += ["--return", case["back"]]
    done("compensate", model("creep"), "wish.csv", *words, "-o", "drive.csv", "-q")
    start = ["--from", 3] if "--from" in words else []
    outcome = dbo("check", "drive.csv", *limits, *start)
    assert outcome.code == 0, outcome.err


def test_a_gap_is_a_gap_on_an_even_clock_alone() -> None:
    drive = 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * TIME)
    words = ("--v-min", 0, "--v-max", 100)
    for lost in (2, 3, 51):
        for row in (1, 2, 3, 100, TIME.size - 3, TIME.size - 1):
            time = TIME.copy()
            time[row:] += (lost - 1) / 1000.0
            write("drive.csv", "time_s,voltage_V", time, drive)
            line = dbo("check", "drive.csv", *words).lines[-1]
            assert f"row {row + 1:,}: a gap in time" in line
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.0005, 0.0015, TIME.size))
    write("drive.csv", "time_s,voltage_V", uneven, drive)
    done("check", "drive.csv", *words)


@pytest.mark.parametrize("places", [None, 6])
def test_rounded_stamps_hide_no_step_that_is_too_fast(places: int | None) -> None:
    """A twentieth too fast is found, whatever the stamps look like; a sine that just fits passes."""
    time = 100.0290773748946 + TIME / 3.0
    stamp = time if places is None else np.round(time, places)
    drive = 50.0 + 40.0 * np.sin(2.0 * np.pi * 15.0 * time)
    fastest = 40.0 * 2.0 * np.pi * 15.0
    write("drive.csv", "time_s,voltage_V", stamp, drive)
    done("check", "drive.csv", "--max-slew", fastest)
    assert dbo("check", "drive.csv", "--max-slew", fastest / 1.05).code == 3


# --- a check of nothing, and bounds that are none ---


def test_a_check_needs_something_to_check() -> None:
    write("drive.csv", "time_s,voltage_V", TIME[:3], [0.0, 1e6, 0.0])
    for words in ((), ("--from", 0), ("--gain", 1), ("--rows", "1:2")):
        error = refused(2, "check", "drive.csv", *words)
        assert "--v-max" in error and "--loop" in error and "--against" in error
    assert dbo("check", "drive.csv", "--v-max", 100).code == 3
    assert dbo("check", "drive.csv", "--max-slew", 100).code == 3
    write("loop.csv", "voltage_V", np.sin(np.arange(64) * np.pi / 32.0))
    done("check", "loop.csv", "--loop")
    done("check", "loop.csv", "--against", "loop.csv")


def test_a_bound_below_zero_is_refused() -> None:
    write("drive.csv", "time_s,voltage_V", TIME, np.sin(TIME))
    write("moved.csv", "desired_um,measured_um", TIME, TIME)
    words = ("check", "drive.csv", "--against", "drive.csv", "--tolerance")
    assert "-1" in refused(2, *words, -1)
    done(*words, 0)
    for bound in ("--max-rmse", "--max-nrmse-percent"):
        assert bound in refused(2, "report", "moved.csv", bound, -1)


# --- what is said of limits that nobody gave, and of a start that nobody knows ---


def test_the_line_says_which_limits_were_kept_and_where_a_drive_starts() -> None:
    phase = 2.0 * np.pi * 5.0 * TIME
    write("wish.csv", "time_s,displacement_um", TIME, 3.0 + np.sin(phase))
    words = ("compensate", model("creep"), "wish.csv", "-o", "drive.csv")
    line = done(*words).said[1]
    first = table("drive.csv")["voltage_V"][0]
    assert "within the identified range" in line and "within limits" not in line
    assert f"starts at {first:.4g} V" in line and "--from" in line
    for limit in (("--v-min", 0), ("--v-max", 99), ("--max-slew", 20000)):
        line = done(*words, *limit).said[1]
        assert "within limits" in line and f"starts at {first:.4g} V" in line
    line = done(*words, "--from", 0, "--approach", "auto").said[1]
    assert "starts at" not in line and "within the identified range" in line


# --- the drive of an inverse model ---


def inverse_of(name: str, count: int, gain: float, top: float) -> Path:
    """Write a model of even gears, 0 to 100 V and 10 um, with one relaxation term, and its inverse."""
    values = values_of("creep")
    widths = {"dx": [100.0 / count] * count, "dy": [10.0 / count] * count}
    term = {"on": "input", "reference": 0.0, "tau": [1.0], "gain": [gain]}
    gears = {"type": "backlash", "x0": 0.0, "y0": 0.0, **widths, "relaxation": term}
    values["output"] |= {"min": 0.0, "max": top}
    Path(f"{name}.json").write_text(json.dumps(values | {"stages": [gears]}))
    done("invert", f"{name}.json", "-o", "inverse.json")
    return Path("inverse.json")


@pytest.fixture
def creeping() -> Path:
    """Return an inverse whose gears reach 13 um by 100 V at rest, and 10 um at once."""
    return inverse_of("creeping", 50, 0.03, 13.0)


def step(top: float) -> Path:
    wanted = np.where(TIME < 0.05, 1.0, top)
    return write("step.csv", "time_s,displacement_um", TIME, wanted)


def test_an_inverse_model_says_where_its_drive_leaves_the_range(creeping: Path) -> None:
    outcome = done("simulate", creeping, step(12.0))
    beyond = table(outcome)["voltage_V"] > 100.0
    assert beyond.sum() > 300 and table(outcome)["voltage_V"].max() > 114.0
    said = " ".join(outcome.warnings)
    assert f"{beyond.sum()} of 400" in said and "row 51" in said and "100 V" in said


def test_an_inverse_model_holds_its_drive_in_the_range(creeping: Path) -> None:
    outcome = done("simulate", creeping, step(12.0), "--outside", "hold")
    voltage = table(outcome)["voltage_V"]
    assert voltage.max() == 100.0 and outcome.warnings
    assert not done("simulate", creeping, step(9.0), "--outside", "hold").warnings


def test_an_inverse_model_refuses_a_drive_outside_the_range(creeping: Path) -> None:
    words = ("simulate", creeping, step(12.0), "--outside", "error", "-o", "out.csv")
    error = refused(3, *words)
    assert "row 51" in error and "100" in error and "--outside" in error
    done("simulate", creeping, step(9.0), "--outside", "error")


def test_a_displacement_that_the_model_does_not_reach_is_refused() -> None:
    """What creeps back is reached for a moment only, by a voltage inside the range."""
    inverse_of("soft", 4, -0.03, 7.0)
    words = ("simulate", "inverse.json", step(8.0), "--outside", "error")
    error = refused(3, *words, "-o", "out.csv")
    assert "row 51" in error and "8 um" in error and "7" in error
    done("simulate", "inverse.json", step(6.9), "--outside", "error")
    actuator = dbo_cli.read_model("inverse.json")
    wanted = np.where(TIME < 0.05, 1.0, 8.0)
    with pytest.raises(dbo_cli.LimitError, match="row 51"):
        actuator.simulate(wanted, time=TIME, outside="error")
    assert actuator.simulate(wanted, time=TIME).max() < 100.0


def test_rows_that_an_inverse_model_sent_stay_sent(creeping: Path) -> None:
    rows = 400_000
    wanted = np.full(rows, 5.0)
    wanted[-10:] = 12.0
    clock = np.arange(rows) / 1000.0
    text = "time_s,displacement_um\n" + "".join(
        f"{t!r},{x!r}\n" for t, x in zip(clock.tolist(), wanted.tolist(), strict=True)
    )
    outcome = dbo("simulate", creeping, "-", "--outside", "error", stdin=text)
    assert outcome.code == 3
    sent = outcome.out.splitlines()
    assert 1000 < len(sent) < rows and sent[-1].count(",") == 2


def test_the_library_judges_an_inverse_model_alike(creeping: Path) -> None:
    wanted = np.where(TIME < 0.05, 1.0, 12.0)
    inverse = dbo_cli.read_model(creeping)
    for actuator in (inverse, dbo_cli.read_model("creeping.json").inverse()):
        with pytest.warns(dbo_cli.DboWarning, match="350 of 400"):
            actuator.simulate(wanted, time=TIME)
        with pytest.raises(dbo_cli.LimitError, match="row 51"):
            actuator.simulate(wanted, time=TIME, outside="error")
        with pytest.warns(dbo_cli.DboWarning):
            held = actuator.simulate(wanted, time=TIME, outside="hold")
        assert held.max() == 100.0


# --- the gate itself ---


def test_the_gate_rounds_by_a_few_last_digits_and_no_more() -> None:
    """What passes beyond a slew limit is rounding; a range is kept exactly."""
    from dbo_cli.drive import Limits
    from dbo_cli.drive.limits import Gate, GateError
    from dbo_cli.model import Quantity

    limits = Limits.within(Quantity("voltage", "V", 0.0, 100.0), max_slew=1000.0)
    for part in ("move", "lead", "return"):
        gate = Gate(limits, 50.0)
        gate.admit(np.array([51.0, 52.0 + 1e-14]), 1e-3, part)
        with pytest.raises(GateError):
            gate.admit(np.array([53.0 + 1e-11]), 1e-3, part)
        for beyond in (np.nextafter(100.0, 200.0), -5e-324, np.nan):
            with pytest.raises(GateError):
                Gate(limits).admit(np.array([beyond]), 1e-3, part)


def test_rows_before_the_move_do_not_count_in_the_expected_error() -> None:
    """A sweep is played, and the error to expect is that of the move behind it."""
    actuator = dbo_cli.read_model(model("known"))
    span = actuator.output.max - actuator.output.min
    wanted = actuator.output.min + span * (0.4 + 0.1 * np.sin(20.0 * TIME))
    behind = actuator.compensate(
        wanted, time=TIME, condition=True, details=True, return_=actuator.input.min
    )
    again = actuator.compensate(
        np.concatenate((wanted, wanted[::-1], wanted)),
        sample_rate=1000.0,
        condition=True,
        details=True,
    )
    from dbo_cli.model.expect import expected_error

    cascade = behind.model
    played = behind.voltage[: behind.move.stop]
    alone = expected_error(cascade, played, 1e-3, behind.lead_rows)
    whole = expected_error(cascade, played, 1e-3)
    assert alone is not None and whole is not None
    assert behind.expected_error == alone.known
    assert behind.expected_unrested == alone.rms(past_known=True)
    assert alone.known != whole.known
    assert again.lead_rows == behind.lead_rows > 1000
