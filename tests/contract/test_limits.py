"""Limits hold, wherever a drive is made: the gate, inverse models, and ``check`` of one mind with them."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import dbo_cli

from .program import (
    DRIVE, MOVE, compensated, dbo, done, model, refused, simulated, store, table,
    values_of, write,
)  # fmt: skip

TIME = np.arange(400) / 1000.0
WANTED = 2.5 - 1.5 * np.cos(2.0 * np.pi * 5.0 * TIME)
VOLTS = 50.0 + 40.0 * np.sin(2.0 * np.pi * 5.0 * TIME)
PLAYED = "time_s,monitor_V"


@pytest.fixture(autouse=True)
def files(folder):
    write("wish.csv", MOVE, TIME, WANTED)
    write("drive.csv", DRIVE, TIME, VOLTS)


# --- no file starts outside the rating ---


def test_a_state_outside_the_rating_is_refused():
    write("high.csv", DRIVE, TIME[:3], [0.0, 50.0, 95.0])
    simulated("creep", "high.csv", "--save-state", "s.json")
    words = ("--state", "s.json", "--v-max", 80, "-o", "out.csv")
    refused(3, "compensate", model("creep"), "wish.csv", *words)


@pytest.mark.parametrize("start", [0.0, 20.0, 100.0])
def test_the_seconds_that_a_refused_approach_names_are_enough(start):
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
def test_an_approach_of_auto_lasts_a_tenth_of_a_second(more):
    phase = 2.0 * np.pi * np.arange(400) / 400
    write("wish.csv", MOVE, TIME, 3.2 + np.sin(phase))
    words = ("--from", 0, "--approach", "auto", "--max-slew", 2000, *more.split())
    written = compensated("creep", *words)
    assert np.sum(written["time_s"] < -1e-9) >= 99
    steps = np.abs(np.diff(np.concatenate([[0.0], written["voltage_V"]])))
    assert steps.max() <= 2.0 * (1.0 + 1e-9)


def test_milliseconds_taken_for_seconds_are_warned_of():
    actuator = dbo_cli.read_model(model("known"))
    with pytest.warns(dbo_cli.DboWarning):
        actuator.compensate(0.8 * WANTED, time=TIME * 1e3)


# --- odd moves against limits ---

MOVES = st.fixed_dictionaries(
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


UNSETTLED = {
    "name": "soft", "v_min": 20.0, "v_max": 95.0, "slew": None, "extrapolate": True, "start": None,
    "approach": None, "condition": False, "return_": None, "periodic": True, "seed": 58, "size": 0.1,
}  # fmt: skip
"""A loop that its limits keep from settling."""


def wanted_of(actuator, seed, size, periodic):
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
@given(case=MOVES)
@example(case=UNSETTLED)
def test_no_row_leaves_the_limits(case):
    """Whatever is asked: no row beyond the rating, no step faster than the slew, or a refusal."""
    actuator = dbo_cli.read_model(model(case["name"]))
    low, high = actuator.input.min, actuator.input.max
    bottom = low if case["v_min"] is None else case["v_min"]
    top = high if case["v_max"] is None else case["v_max"]
    options = {
        name: case[name] for name in ("approach", "periodic", "extrapolate", "v_min", "v_max")
    }  # fmt: skip
    options["condition"] = case["condition"] and not case["periodic"]
    if case["start"] is not None:
        options["from_"] = bottom + case["start"] * (top - bottom)
    if case["return_"] is not None and not case["periodic"]:
        options["return_"] = bottom + case["return_"] * (top - bottom)
    options |= {"max_slew": case["slew"], "on_limit": "clip", "details": True}
    wanted = wanted_of(actuator, case["seed"], case["size"], case["periodic"])
    try:
        drive = actuator.compensate(wanted, sample_rate=1000.0, **options)
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
        played = np.concatenate([[options.get("from_", voltage[0])], voltage])
        assert np.abs(np.diff(played)).max() <= case["slew"] / 1000.0 * (1.0 + 1e-9)


def test_the_line_says_which_limits_were_kept_and_where_a_drive_starts():
    words = ("compensate", model("creep"), "wish.csv", "-o", "out.csv")
    line = done(*words).said[1]
    first = table("out.csv")["voltage_V"][0]
    assert "within the identified range" in line and "within limits" not in line
    assert f"starts at {first:.4g} V" in line and "--from" in line
    for limit in (("--v-min", 0), ("--v-max", 99), ("--max-slew", 20000)):
        line = done(*words, *limit).said[1]
        assert "within limits" in line and f"starts at {first:.4g} V" in line
    line = done(*words, "--from", 0, "--approach", "auto").said[1]
    assert "starts at" not in line and "within the identified range" in line


@pytest.mark.parametrize("rows_a_second", [400, 1000, 3000])
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("creep", 0.9, 5.9),
        ("creep", 0.1, 6.3),
        ("creep", -0.3, 5.0),
        ("bent", 2.0, 5.0),
    ],
)
def test_the_limits_that_a_refusal_names_do(name, low, high, rows_a_second):
    """Where a curve before the gears needs more slew, too."""
    wave = low + (high - low) * np.sin(np.pi * np.arange(400) / 400) ** 2
    write("fast.csv", MOVE, np.arange(400) / rows_a_second, wave)
    words = ("compensate", model(name), "fast.csv", "--on-limit", "error")
    words = (*words, "--state", "empty", "-o", "drive.csv")
    error = refused(3, *words, "--v-max", 50, "--max-slew", 10)
    number = r"(-?[\d.e+]+)"
    needs = re.search(rf"needs {number} to {number} V, {number} V/s: give (.*)", error)
    least, greatest, slew, remedy = needs.groups()
    limits = [f"--v-min={least}", f"--v-max={greatest}", f"--max-slew={slew}"]
    if "--extrapolate" in remedy:
        limits.append("--extrapolate")
    done(*words, *limits)


def test_a_clipped_row_is_counted_among_the_rows_that_were_read():
    """Not among those of the output, which begins before the move, nor among those of the file."""
    write("wish.csv", MOVE, TIME, np.where(TIME < 0.05, 2.5, 8.0))
    line = "--rows 11: --v-max 80 --from 10 --approach auto --on-limit clip -o out.csv"
    outcome = done("compensate", model("creep"), "wish.csv", *line.split())
    text = "350 of 390 rows read (first: row 41)"
    assert any(text in warning for warning in outcome.warnings), outcome.err
    drive = table("out.csv")
    voltage = drive["voltage_V"][drive["time_s"] >= TIME[10]]
    assert voltage.argmax() + 1 == 41 and voltage[40] == 80.0


def test_the_gate_rounds_by_a_few_last_digits_and_no_more():
    """What passes beyond a slew limit is rounding; a range is kept exactly."""
    from dbo_cli.drive import Limits
    from dbo_cli.drive.limits import GateError
    from dbo_cli.model import Quantity

    limits = Limits.within(Quantity("voltage", "V", 0.0, 100.0), max_slew=1000.0)
    for part in ("move", "lead", "return"):
        limits.admit(np.array([51.0, 52.0 + 1e-14]), 50.0, 1e-3, part)
        with pytest.raises(GateError):
            limits.admit(np.array([53.0 + 1e-11]), 52.0 + 1e-14, 1e-3, part)
        for beyond in (np.nextafter(100.0, 200.0), -5e-324, np.nan):
            with pytest.raises(GateError):
                limits.admit(np.array([beyond]), None, 1e-3, part)


# --- the drive of an inverse model ---


def inverse_of(count, gain, top):
    """Write the inverse of even gears, 0 to 100 V and 10 um, with one relaxation term."""
    values = values_of("creep")
    widths = {"dx": [100.0 / count] * count, "dy": [10.0 / count] * count}
    term = {"on": "input", "reference": 0.0, "tau": [1.0], "gain": [gain]}
    gears = {"type": "backlash", "x0": 0.0, "y0": 0.0, **widths, "relaxation": term}
    values["output"] |= {"min": 0.0, "max": top}
    store("forward.json", values | {"stages": [gears]})
    done("invert", "forward.json", "-o", "inverse.json")
    return Path("inverse.json")


def step(top):
    return write("step.csv", MOVE, TIME, np.where(TIME < 0.05, 1.0, top))


def test_the_drive_of_an_inverse_model_is_said_held_or_refused():
    """Its gears reach 13 um by 100 V at rest, and 10 um at once: 12 um needs 114 V for a while."""
    words = ("simulate", inverse_of(50, 0.03, 13.0), step(12.0))
    outcome = done(*words)
    beyond = table(outcome)["voltage_V"] > 100.0
    assert beyond.sum() > 300 and table(outcome)["voltage_V"].max() > 114.0
    said = " ".join(outcome.warnings)
    assert f"{beyond.sum()} of 400" in said and "row 51" in said and "100 V" in said
    outcome = done(*words, "--outside", "hold")
    assert table(outcome)["voltage_V"].max() == 100.0 and outcome.warnings
    error = refused(3, *words, "--outside", "error", "-o", "out.csv")
    assert "row 51" in error and "100" in error and "--outside" in error
    for outside in ("hold", "error"):
        words = ("simulate", "inverse.json", step(9.0), "--outside", outside)
        assert not done(*words).warnings


def test_a_displacement_that_the_model_does_not_reach_is_refused():
    """What creeps back is reached for a moment only, by a voltage inside the range."""
    words = ("simulate", inverse_of(4, -0.03, 7.0), step(8.0), "--outside", "error")
    error = refused(3, *words, "-o", "out.csv")
    assert "row 51" in error and "8 um" in error and "7" in error
    done("simulate", "inverse.json", step(6.9), "--outside", "error")
    actuator = dbo_cli.read_model("inverse.json")
    wanted = np.where(TIME < 0.05, 1.0, 8.0)
    with pytest.raises(dbo_cli.LimitError, match="row 51"):
        actuator.simulate(wanted, time=TIME, outside="error")
    assert actuator.simulate(wanted, time=TIME).max() < 100.0


def test_rows_that_an_inverse_model_sent_stay_sent():
    rows = ["5.0"] * 150_000 + ["12.0"] * 10
    text = "displacement_um\n" + "\n".join(rows) + "\n"
    words = ("--sample-rate", 1000, "--outside", "error")
    outcome = dbo("simulate", inverse_of(50, 0.03, 13.0), "-", *words, stdin=text)
    assert outcome.code == 3
    sent = outcome.out.splitlines()
    assert 1000 < len(sent) < len(rows) and sent[-1].count(",") == 2


# --- ``check``: limits ---


def failed(*words):
    """Run a check that does not pass: exit 3, a report, and one line."""
    outcome = dbo("check", *words)
    assert outcome.code == 3, outcome.err
    assert len(outcome.lines[-1]) < 300
    return outcome


def test_a_drive_within_its_limits_passes():
    words = ("--v-min", 10, "--v-max", 90, "--max-slew", 1260, "--loop")
    outcome = done("check", "drive.csv", *words)
    for word in ("drive.csv", "400", "90"):
        assert word in outcome.out
    whole = np.round(VOLTS)  # limits that are touched exactly are kept
    write("edge.csv", DRIVE, TIME, whole)
    done("check", "edge.csv", "--v-min", whole.min(), "--v-max", whole.max())


@pytest.mark.parametrize(
    ("words", "row"),
    [
        ("--v-max 89", "row 44"),
        ("--v-min 11", "row 144"),
        ("--max-slew 1000", "row 2"),
        ("--max-slew 1V/ms", "row 2"),
        ("--from 0 --max-slew 2000", "row 1"),
        ("--rows 1:250 --loop", "loop"),
    ],
)
def test_the_first_row_that_breaks_a_limit_is_named(words, row):
    outcome = failed("drive.csv", *words.split())
    assert row in outcome.lines[-1] + outcome.out
    found = failed("drive.csv", *words.split(), "--format", "json").json
    assert found["format"] == "dbo-check" and found["passed"] is False
    assert row in " ".join(found["problems"])


def test_no_row_outside_passes_whatever_the_start():
    way = np.concatenate([np.linspace(1000.0, 50.0, 100), np.full(50, 50.0)])
    write("drive.csv", DRIVE, TIME[:150], way)
    for start in (1000, 300, 50):
        failed("drive.csv", "--v-min", -20, "--v-max", 120, "--from", start)


def test_a_limit_on_one_side_is_above_or_below():
    for words, side in (("--v-max 5", "above 5"), ("--v-min 60 --from 55", "below 60")):
        outcome = failed("drive.csv", *words.split())
        assert side in outcome.out and "inf" not in outcome.out


@pytest.mark.parametrize(
    "text",
    [
        "0.020,OVLD", "0.020,", "0.020,nan", "0.020,inf", "0.020", "0.020,50,50",
        "0.019,55\n0.020,55", "0.001,52",
    ],
)  # fmt: skip
def test_what_a_reader_would_drop_is_a_problem(text):
    """As strict as the writer: a row that is dropped, guessed or cut does not pass."""
    lines = Path("drive.csv").read_text().splitlines()
    lines[21] = text
    Path("drive.csv").write_text("\n".join(lines) + "\n")
    outcome = dbo("check", "drive.csv", "--v-min", 0, "--v-max", 100)
    assert outcome.code in (1, 3), outcome.err
    assert "2" in outcome.lines[-1]


@pytest.mark.parametrize("left", ["0.399", "0.399,"])
def test_a_file_that_is_cut_in_its_last_row_does_not_pass(left):
    lines = Path("drive.csv").read_text().splitlines()
    Path("cut.csv").write_text("\n".join([*lines[:400], left]))
    assert "40" in failed("cut.csv", "--v-min", 0, "--v-max", 100).lines[-1]


def test_a_gap_is_a_gap_on_an_even_clock_alone():
    words = ("--v-min", 0, "--v-max", 100)
    for lost in (2, 3, 51):
        for row in (1, 2, 3, 100, TIME.size - 3, TIME.size - 1):
            time = TIME.copy()
            time[row:] += (lost - 1) / 1000.0
            write("gap.csv", DRIVE, time, VOLTS)
            line = failed("gap.csv", *words).lines[-1]
            assert f"row {row + 1:,}: " in line and "gap" in line
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.0005, 0.0015, TIME.size))
    write("uneven.csv", DRIVE, uneven, VOLTS)
    done("check", "uneven.csv", *words)


@pytest.mark.parametrize("places", [None, 6])
def test_rounded_stamps_hide_no_step_that_is_too_fast(places):
    """A twentieth too fast is found, whatever the stamps look like; a sine that just fits passes."""
    time = 100.0290773748946 + TIME / 3.0
    stamp = time if places is None else np.round(time, places)
    drive = 50.0 + 40.0 * np.sin(2.0 * np.pi * 15.0 * time)
    fastest = 40.0 * 2.0 * np.pi * 15.0
    write("drive.csv", DRIVE, stamp, drive)
    done("check", "drive.csv", "--max-slew", fastest)
    failed("drive.csv", "--max-slew", fastest / 1.05)


def test_a_check_needs_something_to_check_and_bounds_that_are_bounds():
    write("jump.csv", DRIVE, TIME[:3], [0.0, 1e6, 0.0])
    for words in ((), ("--from", 0), ("--gain", 1), ("--rows", "1:2")):
        error = refused(2, "check", "jump.csv", *words)
        assert "--v-max" in error and "--loop" in error and "--against" in error
    failed("jump.csv", "--v-max", 100)
    failed("jump.csv", "--max-slew", 100)
    write("loop.csv", "voltage_V", np.sin(np.arange(64) * np.pi / 32.0))
    done("check", "loop.csv", "--loop")
    words = ("check", "loop.csv", "--against", "loop.csv")
    done(*words)
    assert "-1" in refused(2, *words, "--tolerance", -1)
    write("moved.csv", "desired_um,measured_um", TIME, TIME)
    for bound in ("--max-rmse", "--max-nrmse-percent"):
        assert bound in refused(2, "report", "moved.csv", bound, -1)


def test_a_loop_behind_its_run_in_asks_for_the_rows_of_the_period():
    period = 3.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(200) / 200.0)
    write("period.csv", MOVE, TIME[:200], period)
    words = ("--periodic", "--passes", 2, "-o", "loop.csv")
    done("compensate", model("creep"), "period.csv", *words)
    told = failed("loop.csv", "--loop")
    assert "--rows" in told.lines[-1] and "--rows" in told.out
    words = ("waveform", "loop.csv", "--to", "npy", "--loop", "-o", "loop.npy")
    assert "--rows" in dbo(*words).lines[-1]
    done("check", "loop.csv", "--loop", "--rows", "401:")
    done(*words, "--rows", "401:")


# --- ``check``: is it what was played ---


@pytest.mark.parametrize("seed", [0, 4, 8, 49])
def test_a_drive_is_what_it_is_to_the_last_digit(seed):
    values = np.random.default_rng(seed).normal(size=91)
    write("odd.csv", DRIVE, TIME[:91], values)
    done("check", "odd.csv", "--against", "odd.csv", "--tolerance", 0)


def odd_row():
    odd = VOLTS.copy()
    odd[217] += 3.0
    return odd


NOISE = np.random.default_rng(2).normal(0.0, 1.0, 400)
SLOW = np.arange(200) / 500.0


@pytest.mark.parametrize(
    ("columns", "words", "code", "held"),
    [
        ((TIME, VOLTS + 0.02 * NOISE), "--tolerance 0.2", 0, ""),
        ((TIME, 1.02 * VOLTS + 0.3), "--tolerance 0.1", 3, "1.02"),
        ((TIME[:150], VOLTS[:150]), "", 3, "250"),
        ((TIME, 50.0 + 20.0 * NOISE), "", 3, ""),
        ((SLOW, np.interp(SLOW, TIME, VOLTS)), "", 0, ""),
        ((SLOW, np.interp(SLOW, TIME, VOLTS) + 0.02 * NOISE[::2]), "", 0, ""),
        ((SLOW, np.interp(SLOW, TIME, VOLTS) - 0.02 * NOISE[::2]), "", 0, ""),
        ((TIME, odd_row()), "--tolerance 0.5", 3, ""),
        ((TIME, VOLTS / 20.0), "--gain 20", 0, ""),
        ((TIME, VOLTS / 20.0), "", 3, ""),
    ],
    ids="noisy gain part other rate late early row before amplifier".split(),
)
def test_a_recording_is_what_was_played(columns, words, code, held):
    write("played.csv", PLAYED, *columns)
    outcome = dbo("check", "played.csv", "--against", "drive.csv", *words.split())
    assert outcome.code == code, outcome.err
    assert held in outcome.out + outcome.err


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


def stamps(case):
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


@settings(max_examples=30)
@given(case=CLOCKS)
def test_what_was_written_passes_the_check(case):
    time = stamps(case)
    phase = 6.0 * np.arange(time.size) / time.size
    wanted = 3.2 - 2.5 * np.cos(phase + 0.1) * np.cos(2.7 * phase)
    write("wish.csv", MOVE, time, wanted)
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


def test_limits_hold_behind_the_amplifier_of_a_recording():
    write("played.csv", PLAYED, TIME, VOLTS / 20.0)
    words = ("check", "played.csv", "--against", "drive.csv", "--gain", 20)
    assert dbo(*words, "--v-max", 100).code == 0
    assert dbo(*words, "--v-max", 80).code == 3
