"""``dbo compensate``: the drive of a move, what stands before and behind it, and what to expect."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest

import dbo_cli

from .program import (
    DRIVE, MOVE, compensated, dbo, done, load, model, refused, rms, simulated, store, table,
    values_of, write,
)  # fmt: skip

TIME = np.arange(400) / 1000.0
PHASE = 2.0 * np.pi * np.arange(400) / 400
SMALL = ("compensate", model("small"), "wish.csv")
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def sine(top, low=2.0):
    """Return two swings between ``low`` and ``top`` um, from rest at ``low``."""
    return low + 0.5 * (top - low) * (1.0 - np.cos(2.0 * np.pi * 5.0 * TIME))


def move(wanted, name="wish.csv"):
    return write(name, MOVE, TIME, wanted)


def summary_of(*words, name="small"):
    """Return the summary of a drive."""
    compensated(name, *words, "--summary", "summary.json")
    return load("summary.json")


# --- what limits cut off ---


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_named_pipe_clips_as_standard_output_does():
    """Its reader has played the rows long before they could be refused."""
    move(sine(11.0))
    os.mkfifo("player.csv")
    with ThreadPoolExecutor(1) as pool:
        played = pool.submit(Path("player.csv").read_bytes)
        outcome = done(*SMALL, "-o", "player.csv")
        assert played.result().count(b"\n") == 1 + len(TIME)
    assert any("clip" in line for line in outcome.warnings)


def test_what_costs_little_is_clipped_and_said_unless_error_was_typed():
    move(sine(9.1))
    outcome = done(*SMALL, "-o", "drive.csv")
    assert table("drive.csv")["voltage_V"].max() == 10.0
    clipped = int(np.sum(sine(9.1) > 9.0))
    assert any(f"{clipped}" in line and "clip" in line for line in outcome.lines)
    refused(3, *SMALL, "--on-limit", "error", "-o", "x.csv")


@pytest.mark.parametrize("loop", [[], ["--periodic"]])
def test_what_limits_cost_behind_a_resonance_is_what_the_displacement_misses(loop):
    """It was taken before the resonance is undone, where it rings: seven times too much."""
    time = np.arange(600) / 2000.0
    wanted = 3.0 + 1.5 * np.sign(np.sin(2.0 * np.pi * 10.0 * time + 1e-6))
    write("wish.csv", MOVE, time, wanted)
    limits = ("--max-slew", 6000, "--on-limit", "clip", "--from", 50)
    told = summary_of(*limits, "--approach", "auto", *loop, name="moving")
    drive = table("drive.csv")
    begin = int(np.sum(drive["time_s"] < -1e-9))
    assert len(drive["time_s"]) == begin + 600
    voltage = drive["voltage_V"]
    repeated = np.concatenate([voltage, *[voltage[begin:]] * 5 * len(loop)])
    moved = dbo_cli.read_model(model("moving")).simulate(repeated, sample_rate=2000.0)
    missed = moved[-600:] - wanted
    assert told["lost_rms"] == pytest.approx(rms(missed), rel=0.05)
    assert told["lost_most"] == pytest.approx(np.abs(missed).max(), rel=0.05)


def test_what_costs_much_is_refused_unless_asked_for():
    wish = move(sine(11.0)).read_bytes()
    error = refused(3, *SMALL, "-o", "drive.csv", "--summary", "s.json")
    lost = rms(np.maximum(sine(11.0) - 9.0, 0.0))
    assert f"{lost:.3g}" in error and "--on-limit" in error
    clipped = compensated("small", "--on-limit", "clip")
    assert clipped["voltage_V"].max() == 10.0
    # rows that were sent cannot be taken back: to stdout, auto clips and says so
    for sink in ("-", "/dev/stdout"):
        outcome = done("compensate", model("small"), "-", "-o", sink, stdin=wish)
        assert table(outcome)["voltage_V"].max() == 10.0
        assert any("clip" in line for line in outcome.warnings)


def test_what_a_late_row_needs_is_said_too():
    rows = np.append(np.full(140_000, 3.0), sine(9.5))
    write("wish.csv", MOVE, np.arange(len(rows)) / 1e3, rows)
    told = refused(3, *SMALL, "--on-limit", "error", "-o", "x.csv")
    assert "it needs 1 to 10.5 V" in told


@pytest.mark.parametrize("start", ["--from 0 --state empty", "--state empty"])
def test_a_jump_to_row_1_that_limits_forbid_is_answered_with_a_way_there(start):
    move(sine(5.0))
    words = ("compensate", model("creep"), "wish.csv", "--max-slew", 5000)
    told = refused(3, *words, *start.split(), "-o", "drive.csv")
    assert "--from VOLT, --approach auto" in told
    words = (*words, "--from", 0)
    ways = ("--state empty --approach auto", "--condition")
    for way in ways:
        done(*words, *way.split())
        told = refused(3, *words, *way.split(), "--v-max", 1, "-o", "x.csv")
        assert "--bandwidth HZ" in told


def test_extrapolate_leaves_the_identified_range_as_far_as_typed():
    move(sine(9.5))
    words = ("--v-max", 12)
    assert compensated("small", *words, "--on-limit", "clip")["voltage_V"].max() == 10.0
    beyond = compensated("small", *words, "--extrapolate")["voltage_V"].max()
    assert 10.0 < beyond < 12.0


def test_limits_and_trajectories_take_units():
    move(sine(8.0))
    same = {
        "--v-max 8V": "--v-max 8",
        "--v-max 8000mV": "--v-max 8",
        "--v-max 0.008kV": "--v-max 8",
        "--max-slew 0.05V/ms": "--max-slew 50",
        "--max-slew 50V/s": "--max-slew 50",
    }
    for typed, plain in same.items():
        first = compensated("small", *typed.split(), "--on-limit", "clip")
        second = compensated("small", *plain.split(), "--on-limit", "clip")
        assert np.array_equal(first["voltage_V"], second["voltage_V"]), typed
    for wrong in ("--v-max 8um", "--v-max 8V/s", "--max-slew 5Hz", "--v-max nan"):
        assert wrong.split()[0] in refused(2, *SMALL, *wrong.split())
    write("nm.csv", "time_s,displacement_nm", TIME, 1000.0 * sine(8.0))
    first, second = compensated("small"), compensated("small", wish="nm.csv")
    assert "desired_um" in second
    np.testing.assert_allclose(second["voltage_V"], first["voltage_V"], atol=1e-9)


# --- before and behind the move ---


def test_an_approach_leads_from_where_the_amplifier_stands():
    move(sine(8.0, 3.0))
    assert "add --approach auto" in done(*SMALL, "--from", 0, "-o", "drive.csv").err
    outcome = done(*SMALL, "--from", 0, "--approach", 0.2, "-o", "drive.csv")
    assert "warning" not in outcome.err
    time, desired, voltage = table("drive.csv").values()
    before = time < -1e-9
    assert abs(before.sum() - 200) <= 1
    assert abs(voltage[0]) < 0.5
    assert np.abs(np.diff(voltage)).max() < 0.5
    np.testing.assert_allclose(time[~before], TIME, atol=1e-12)
    np.testing.assert_allclose(desired[~before], sine(8.0, 3.0), atol=1e-12)


def test_a_start_and_an_end_outside_the_rating_go_by_the_names_to_type():
    actuator = dbo_cli.read_model(model("small"))
    for name in ("from_", "return_"):
        with pytest.raises(dbo_cli.LimitError, match=f"`{name}` 99 V is outside"):
            actuator.compensate(sine(7.0), time=TIME, **{name: 99.0})
        option = "--" + name.strip("_")
        move(sine(7.0))
        assert f"{option} 99 V" in refused(3, *SMALL, option, 99, "-o", "drive.csv")


def test_condition_makes_the_past_known():
    """From any start the conditioned move ends up the same, to the last digits."""
    move(sine(7.0, 4.0))
    compensated("small", "--condition")
    starts = ("empty", "full", "settled")
    came = [simulated("small", "drive.csv", "--state", one)[-400:] for one in starts]
    np.testing.assert_allclose(came[1:], [came[0]] * 2, atol=1e-9)


def test_the_way_in_may_use_the_rating():
    """From 0 V into a model of 0.236 to 3.424 V: the move's rows keep the identified range."""
    values = values_of("small")
    values["input"] |= {"min": 0.236, "max": 3.424}
    values["stages"][0] |= {"x0": 0.236, "dx": [0.797] * 4}
    store("narrow.json", values)
    move(sine(4.0))
    words = ("--v-min", 0, "--v-max", 5, "--approach", 0.1, "-o", "drive.csv")
    drives = ("compensate", "narrow.json", "wish.csv", *words, "--from")
    near = done(*drives, 0)
    time, _, voltage = table("drive.csv").values()
    lead = time < -1e-9
    assert voltage[lead].min() < 0.236 <= voltage[~lead].min()
    # from farther away, gears turn that no log has shown
    for outcome, warns in ((near, False), (done(*drives, 4.5), True)):
        assert any("the logs from" in line for line in outcome.lines) is warns


def test_rows_before_the_move_do_not_count_in_the_expected_error():
    """A sweep is played, and the error to expect is that of the move behind it."""
    from dbo_cli.model.expect import expected_error

    actuator = dbo_cli.read_model(model("known"))
    span = actuator.output.max - actuator.output.min
    wanted = actuator.output.min + span * (0.4 + 0.1 * np.sin(20.0 * TIME))
    swept = {"condition": True, "return_": actuator.input.min}
    drive = actuator.compensate(wanted, time=TIME, details=True, **swept)
    assert drive.lead_rows > 1000
    played = drive.voltage[: drive.move.stop]
    alone = expected_error(drive.model, played, 1e-3, drive.lead_rows)
    whole = expected_error(drive.model, played, 1e-3)
    assert alone is not None and whole is not None
    assert drive.expected_error == alone.known != whole.known
    assert drive.expected_unrested == pytest.approx(np.hypot(alone.known, alone.memory))


def test_a_sweep_of_a_part_of_the_range_leaves_what_the_rest_remembers():
    """Turns outside the sweep are not wiped out, and the error to expect counts them."""
    actuator = dbo_cli.read_model(model("known"))
    low, high = actuator.input.min, actuator.input.max
    limits = {
        "v_min": low + 0.35 * (high - low),
        "v_max": low + 0.65 * (high - low),
    }
    middle = 0.5 * (actuator.output.min + actuator.output.max)
    wanted = middle + 0.03 * actuator.output.span * np.sin(20.0 * TIME)
    asked = {"time": TIME, "condition": True, "details": True}
    drive = actuator.compensate(wanted, from_=limits["v_min"], **limits, **asked)
    errors = []
    for start in ("empty", "full", "settled"):
        reached = actuator.simulate(drive.voltage, time=drive.time, state=start)
        errors.append(rms(reached[drive.move] - wanted))
    assert 0.7 < drive.expected_error / rms(np.array(errors)) < 1.5
    whole = actuator.compensate(wanted, **asked)
    assert drive.expected_error > 2.0 * whole.expected_error


# --- dynamics and delay ---


@pytest.mark.parametrize("name", ["moving", "late"])
def test_delay_and_dynamics_are_undone(name):
    move(sine(4.0, 1.5))
    time, desired, _ = compensated(name, "--lead", "auto").values()
    middle = (time > 0.02) & (time < 0.38)
    error = simulated(name, "drive.csv") - desired
    assert rms(error[middle]) < 0.002 * 2.5
    words = ("--lead", "auto", "--condition", "--from", 0, "--approach", "auto")
    assert 0.0 < -compensated(name, *words)["time_s"][0] <= 60.0


def test_what_the_clock_cannot_carry_is_refused():
    """Dynamics need an even clock, and a resonance well below half its rate."""
    time = TIME + 0.0003 * np.sin(np.arange(400))
    write("wish.csv", MOVE, time, sine(4.0, 1.5))
    words = ("wish.csv", "-o", "drive.csv")
    assert "--resample" in refused(1, "compensate", model("moving"), *words)
    values = values_of("moving")
    values["stages"][1]["sections"][1]["frequency"] = 310.0
    store("fast.json", values)
    move(sine(4.0, 1.5))
    assert "310" in refused(1, "compensate", "fast.json", *words)


@pytest.mark.parametrize("name", ["creep", "moving"])
def test_a_long_file_gives_what_one_array_gives(name):
    """Block by block through the shell, whole in the library: the same voltages to rounding."""
    time = np.arange(70_000) / 1000.0
    wanted = 2.5 + np.sin(3.0 * time) * np.cos(0.7 * time)
    write("wish.csv", MOVE, time, wanted)
    written = compensated(name, "--on-limit", "clip", "--max-slew", 300)["voltage_V"]
    limited = {"time": time, "on_limit": "clip", "max_slew": 300.0}
    whole = dbo_cli.read_model(model(name)).compensate(wanted, **limited)
    np.testing.assert_allclose(written, whole, rtol=0, atol=1e-9)


# --- loops and learning ---


@pytest.mark.parametrize("name", ["creep", "moving", "late"])
def test_a_periodic_drive_closes(name):
    """Played again and again, the settled drive of a loop brings the wish in every pass."""
    top = values_of(name)["output"]["max"]
    wanted = 0.5 * top + 0.25 * top * np.sin(2.0 * PHASE)
    move(wanted)
    loop = compensated(name, "--periodic")["voltage_V"][-400:]
    time = np.arange(400 * 12) / 1000.0
    came = simulated(name, write("played.csv", DRIVE, time, np.tile(loop, 12)))
    last, one_before = came[-400:], came[-800:-400]
    assert np.abs(last - one_before).max() < 1e-3 * top
    assert rms(last - last.mean() - (wanted - wanted.mean())) < 2e-3 * top


@pytest.mark.parametrize(
    ("name", "slew", "code"), [("small", 30, 3), ("small", 100, 0), ("creep", 300, 0)]
)
def test_a_loop_keeps_the_slew_over_its_seam(name, slew, code):
    """Too fast for the limit, it is clipped in every pass alike, or refused where it does not close."""
    top = values_of(name)["output"]["max"]
    move(0.5 * top + 0.4 * top * np.sin(PHASE + 1.0))
    words = ("--periodic", "--max-slew", slew, "-o", "drive.csv")
    line = ("compensate", model(name), "wish.csv", *words, "--on-limit")
    refused(3, *line, "error")
    outcome = dbo(*line, "clip")
    assert outcome.code == code, outcome.err
    if code == 0:
        loop = table("drive.csv")["voltage_V"]
        steps = np.abs(np.diff(np.append(loop, loop[0])))
        assert steps.max() <= slew / 1000.0 * (1.0 + 1e-9)


@pytest.mark.parametrize("phase", [0.0, 0.25])
def test_a_run_in_ends_on_the_loop_to_the_last_digit(phase):
    """From 7 of 60 voltages it ended 7e-15 V off, and was refused for that."""
    actuator = dbo_cli.read_model(model("creep"))
    wanted = 3.0 + 1.5 * np.sin(2.0 * np.pi * (np.arange(50) / 50.0 + phase))
    options = {"periodic": True, "passes": 1, "v_min": 0, "v_max": 60.1}
    for start in np.linspace(0.0, 60.0, 60):
        drive = actuator.compensate(
            wanted, sample_rate=1000, from_=start, on_limit="clip", **options
        )
        assert drive[49] == drive[-1]


def test_a_loop_that_does_not_close_and_options_without_a_partner_are_refused():
    move(np.linspace(3.0, 7.0, 400))
    outcome = dbo(*SMALL, "--periodic", "-o", "d.csv")
    assert outcome.code in (1, 3) and "period" in outcome.lines[-1]
    for option in ("--voltage 2", "--measured 2"):
        refused(2, *SMALL, *option.split(), "-o", "d.csv")


def test_the_error_to_expect_counts_what_a_low_pass_takes():
    actuator = dbo_cli.read_model(model("known"))
    wanted = actuator.output.min + actuator.output.span * (
        0.5 + 0.2 * np.sin(2.0 * np.pi * 20.0 * TIME)
    )
    asked = {"time": TIME, "condition": True, "details": True}
    sharp = actuator.compensate(wanted, **asked)
    drive = actuator.compensate(wanted, bandwidth=20.0, **asked)
    reached = actuator.simulate(drive.voltage, time=drive.time)[drive.move]
    error = np.hypot(rms(reached - wanted), sharp.expected_error)
    assert drive.expected_error == pytest.approx(error, rel=0.02)


def test_bandwidth_rounds_the_corners_and_resample_writes_at_the_card_s_rate():
    move(np.interp(TIME, [0.0, 0.1, 0.3, 0.4], [2.0, 2.0, 7.0, 7.0]))
    sharp, round_ = compensated("small"), compensated("small", "--bandwidth", 20)
    bend = [np.abs(np.diff(one["voltage_V"], 2)).max() for one in (sharp, round_)]
    assert bend[1] < bend[0]
    written = compensated("small", "--resample", "2kHz")
    np.testing.assert_allclose(np.diff(written["time_s"]), 0.0005, rtol=1e-9)
    assert len(written["time_s"]) == 799


# --- what is said of it ---

SUMMARY = (
    "format version model unit rows voltage_range move_range limits lead clipped lost_rms lost_most "
    "expected_rmse expected_rmse_past_known past_known warnings"
).split()


def test_a_summary_is_of_this_drive():
    """Figures as the written rows have them, limits as typed, and the model by its name."""
    wanted = sine(9.5)
    move(wanted)
    limits = ("--v-min", -1, "--v-max", 12, "--max-slew", 5000, "--on-limit", "clip")
    told = summary_of(*limits, "--from", -0.5, "--approach", 0.1)
    assert set(SUMMARY) <= set(told)
    assert (told["format"], told["version"], told["unit"]) == ("dbo-summary", 1, "um")
    time, _, voltage = table("drive.csv").values()
    before = time < -1e-9
    assert told["rows"] == len(voltage)
    assert told["voltage_range"] == [voltage.min(), voltage.max()]
    assert told["move_range"] == pytest.approx([2.0, 9.5], abs=1e-3)
    assert told["lead"]["rows"] == before.sum() > 90
    assert told["lead"]["seconds"] == pytest.approx(before.sum() / 1000.0)
    assert told["limits"]["rating"] == [-1.0, 12.0]
    assert told["limits"]["move"] == told["limits"]["identified"] == [0.0, 10.0]
    assert told["limits"]["max_slew"] == 5000.0
    came = simulated("small", "drive.csv", "--state", "empty")
    lost = (wanted - came[~before])[1:]
    assert told["lost_rms"] == pytest.approx(np.sqrt(np.sum(lost**2) / 400), rel=1e-6)
    assert told["lost_most"] == pytest.approx(lost.max(), rel=1e-9)
    assert told["clipped"] == np.sum(lost > 1e-9)
    assert any(f"{told['clipped']} of 400 rows" in text for text in told["warnings"])
    assert len(told["model"]) == 64 and told["expected_rmse"] is None


def played_by(stages, drive, state="auto"):
    """Return what other stages of the stored model ``known`` make of a drive."""
    values = values_of("known") | {"stages": stages, "candidates": []}
    other = dbo_cli.read_model(store("other.json", values))
    return other.simulate(drive["voltage_V"], time=drive["time_s"], state=state)


def test_a_summary_states_what_to_expect():
    """Left out, the spread of candidates and, for an unknown past, that of the starts (theory, 7)."""
    move(sine(4.0, 1.5))
    unknown = summary_of(name="known")
    drive, stored = table("drive.csv"), values_of("known")
    came = played_by(stored["stages"], drive)
    square = stored["fit"]["left_out_rmse"] ** 2
    for candidate in stored["candidates"]:
        spread = played_by(candidate["stages"], drive) - came
        square += candidate["weight"] * rms(spread) ** 2
    assert unknown["expected_rmse_past_known"] == pytest.approx(square**0.5, rel=1e-6)
    for start in ("empty", "full", "settled"):
        square += rms(played_by(stored["stages"], drive, start) - came) ** 2 / 3.0
    assert unknown["expected_rmse"] > square**0.5  # and what memories may hold
    known = summary_of("--condition", name="known")
    assert (unknown["past_known"], known["past_known"]) == (False, True)
    assert 0.0 < known["expected_rmse"] < unknown["expected_rmse"]
    assert unknown["expected_rmse_past_known"] < unknown["expected_rmse"]


@pytest.mark.parametrize("form", ["hold", "swing"])
@pytest.mark.parametrize(("seconds", "warns"), [(2.0, False), (4.0, True)])
def test_a_move_slower_than_three_times_the_logs_is_warned_of(form, seconds, warns):
    """What stands before the move takes as long as it likes; the logs' longest swing takes 1 s."""
    values = values_of("known")
    values["fit"] |= {"longest_swing": 1.0}
    goes = [0.0, 0.2, 0.2 + seconds] if form == "hold" else [0.0, seconds, seconds]
    time = np.arange(0.0, goes[2], 0.01)
    write("wish.csv", MOVE, time, np.interp(time, goes, [2.0, 6.0, 6.0]))
    slow = ("compensate", store("slow.json", values), "wish.csv", "-o", "drive.csv")
    outcome = done(*slow, "--from", 0.0, "--approach", 20.0)
    assert any("turn to turn" in line for line in outcome.lines) is warns


def test_hdf5_holds_units_model_and_limits():
    move(sine(8.0))
    done(*SMALL, "--v-max", 9.5, "-o", "drive.h5")
    with h5py.File("drive.h5") as file:
        assert set(file) == {"time", "desired", "voltage"}
        assert file["voltage"].attrs["units"] == "V"
        assert file["desired"].attrs["units"] == "um"
        attributes = {key: str(value) for key, value in file.attrs.items()}
        stored = file["voltage"][:]
    assert "9.5" in json.dumps(attributes)
    text = compensated("small", "--v-max", 9.5)["voltage_V"]
    np.testing.assert_array_equal(stored, text)


def test_a_saved_state_joins_two_moves():
    wanted = sine(4.0, 1.5)
    write("first.csv", MOVE, TIME[:200], wanted[:200])
    write("second.csv", MOVE, TIME[200:], wanted[200:])
    move(wanted)
    whole = compensated("creep")["voltage_V"]
    one = compensated("creep", "--save-state", "s.json", wish="first.csv")
    two = compensated("creep", "--state", "s.json", wish="second.csv")
    joined = np.concatenate([one["voltage_V"], two["voltage_V"]])
    np.testing.assert_allclose(joined, whole, atol=1e-9)
