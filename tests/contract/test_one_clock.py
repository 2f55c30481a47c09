"""Two recordings of one drive on one clock: ``report``, ``check``, ``--tracked``, ``--clock-offset``."""

import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from .program import (
    DRIVE, LOG, MOVE, PAIR, PASS, QUICK, dbo, done, load, model, refused, rms, simulated, store,
    table, values_of, write,
)  # fmt: skip

STEP = 1e-3
SUMMARY = {"format": "dbo-summary", "version": 1, "unit": "um", "model": "0" * 64}
TIME = STEP * np.arange(6000)
FIRST = ("compensate", model("creep"), "traj.csv", "--from", 0)
SWEPT = (*FIRST, "--condition")


def pink(rng, rows):
    """Return 1/f noise of standard deviation 1."""
    frequency = np.fft.rfftfreq(rows)
    frequency[0] = 1.0
    spectrum = np.fft.rfft(rng.standard_normal(rows)) / np.sqrt(frequency)
    noise = np.fft.irfft(spectrum, rows)
    return np.asarray((noise - noise.mean()) / noise.std())


def creep(values, tau):
    """Return what follows a signal with a time constant (s)."""
    keep = np.exp(-STEP / tau)
    begin = values[0]
    return begin + lfilter([1.0 - keep], [1.0, -keep], values - begin)


def recorded(seed):
    """Drive a slow sine with a sweep before it; return the drive, and what a stage makes of it."""
    drive, moved, texts = planned(seed)
    for name, text in texts.items():
        Path(name).write_text(text)
    return {name: column.copy() for name, column in drive.items()}, moved.copy()


@functools.cache
def planned(seed):
    """Return a drive, what a stage makes of it, and the texts of trajectory and drive, once a session."""
    rng = np.random.default_rng(seed)
    span = 6.0
    size = rng.uniform(0.2, 0.35) * span
    desired = 0.5 * span + size * np.sin(2.0 * np.pi * 0.5 * TIME + rng.uniform(0, 6))
    write("traj.csv", MOVE, TIME, desired)
    done(*SWEPT, "-o", "drive.csv")
    drive = table("drive.csv")
    moved = simulated("creep", "drive.csv")
    lagging = sum(moved - creep(moved, tau) for tau in (0.1, 1.0, 10.0))
    moved = moved - rng.uniform(1e-3, 2e-3) * lagging
    moved += 1e-3 * span * pink(rng, len(moved)) * rng.uniform(0.3, 1.0)
    moved += 2e-4 * rng.uniform(-1.0, 1.0) * np.arange(len(moved)) * STEP
    moved += 1e-3 * rng.standard_normal(len(moved))
    texts = {name: Path(name).read_text() for name in ("traj.csv", "drive.csv")}
    return drive, moved, texts


def reported(trajectory, *words):
    """Return the figures of ``pass.csv`` beside a trajectory or a drive."""
    line = ("report", "pass.csv", "--trajectory", trajectory, "--format", "json")
    return done(*line, *words).json["logs"][0]


@pytest.mark.parametrize(
    ("seed", "start"), [(0, 0.0), (1, 1.7e9), (2, 0.0), (3, 1.7e9)]
)
def test_a_recorder_that_counts_from_elsewhere_is_reported_as_by_rows(seed, start):
    """Creep and 1/f noise pull on a fit of loops: it was five rows off, 46 nm for 22.7."""
    drive, moved = recorded(seed)
    stamps = start + STEP * np.arange(len(moved))
    rng = np.random.default_rng(9)
    volts = drive["voltage_V"] + 0.02 * rng.standard_normal(len(moved))
    write("pass.csv", PASS, stamps, volts, moved)
    move = drive["time_s"] > -0.5 * STEP
    truth = rms((moved - drive["desired_um"])[move])
    for trajectory in ("traj.csv", "drive.csv"):
        log = reported(trajectory)
        assert log["rmse"] == pytest.approx(truth, rel=0.01), trajectory
        ahead = start - drive["time_s"][0]
        assert log["clock_offset_s"] == pytest.approx(ahead, abs=0.02 * STEP)


def test_a_drive_lays_recordings_over_each_other_to_a_part_of_a_row():
    """The actuator is late by 3.4 ms, which is an error; the recorder by .4 rows, which is none."""
    drive, _ = recorded(1)
    ahead, late = 0.4 * STEP, 3.4e-3
    time, desired, volts = drive.values()
    volts = volts[5:-5]
    moved = np.interp(time - late, time, desired)[5:-5]
    write("pass.csv", PASS, (time + ahead)[5:-5], volts, moved)
    log = reported("drive.csv")
    assert log["clock_offset_s"] == pytest.approx(ahead, abs=0.01 * STEP)
    assert log["lag_left_s"] == pytest.approx(late, abs=0.01 * STEP)


def test_another_drive_is_said():
    drive, moved = recorded(2)
    other = 50.0 + 40.0 * np.sin(np.arange(len(moved)) / 77.0)
    write("pass.csv", PASS, drive["time_s"], other, moved)
    store("s.json", {**SUMMARY, "expected_rmse": 1e-4})
    for expected in ((), ("--expected", "s.json")):
        outcome = done("report", "pass.csv", "--trajectory", "drive.csv", *expected)
        (told, *more) = outcome.warnings
        assert "drive is not that of drive.csv" in told
        assert len(more) == len(expected) // 2


def test_a_drive_of_a_few_rows_is_known_again():
    volts = 50.0 - 50.0 * np.cos(20.0 * np.pi * TIME[:100:10])
    for name, clock in (("drive.csv", TIME), ("pass.csv", TIME + 5.0)):
        write(name, "time_s,voltage_V", clock[:100:10], volts)
    done("check", "pass.csv", "--against", "drive.csv", "--v-max", 120)


def test_a_long_recording_is_laid_over_by_whole_rows():
    """Both are looked at by fewer rows; .641 V of a staircase were found to differ, and .048 do."""
    rng = np.random.default_rng(2)
    volts = np.repeat(rng.uniform(5.0, 95.0, 4000), 50)
    late = np.concatenate([np.full(777, volts[0]), volts])
    noise = rng.normal(0.0, 0.01, len(late))
    for name, values in (("drive.csv", volts), ("played.csv", late + noise)):
        write(name, "time_s,voltage_V", 1e-4 * np.arange(len(values)), values)
    outcome = done("check", "played.csv", "--against", "drive.csv", "--tolerance", 0.1)
    assert "777 rows late" in outcome.out


@pytest.mark.parametrize("late", [0.0, 17.0, 2.37])
def test_what_was_played_is_late_by_rows(late):
    drive, _ = recorded(3)
    rows = np.arange(len(drive["time_s"]))
    played = np.interp(rows - late, rows, drive["voltage_V"])
    write("played.csv", "time_s,monitor_V", STEP * rows, played)
    outcome = dbo("check", "played.csv", "--against", "drive.csv", "--tolerance", 0.5)
    assert f"{late:g} rows late" in outcome.out, outcome.out


@pytest.mark.parametrize("uneven", ["drive.csv", "played.csv", "both"])
def test_what_was_played_on_an_uneven_clock_is_compared_by_its_stamps(uneven):
    """It was taken for a row a second: "another drive was played", 0 rows late, a gain of .07."""
    drive, _ = recorded(3)
    time = drive["time_s"] - drive["time_s"][0]
    stamps = time + 0.3 * STEP * np.random.default_rng(1).uniform(-1, 1, len(time))
    for name, late in (("drive.csv", 0.0), ("played.csv", 0.02)):
        clock = stamps if uneven in (name, "both") else time
        volts = np.interp(clock - late, time, drive["voltage_V"])
        write(name, "time_s,voltage_V", clock, volts)
    line = ("check", "played.csv", "--against", "drive.csv", "--tolerance", 0.5)
    played = dbo(*line, "--format", "json").json["played"]
    assert played["lag_seconds"] == pytest.approx(0.02, abs=0.05 * STEP)
    assert played["largest_difference"] < 0.05
    assert played["gain"] == pytest.approx(1.0, abs=1e-3)


def test_a_drive_that_a_converter_holds_is_what_was_played():
    """Recorded ten times as fast it differed by up to a step of the drive, 3.5 V."""
    drive, _ = recorded(3)
    rows = np.arange(10 * len(drive["time_s"]))
    volts = drive["voltage_V"][rows // 10]
    for name, values in (("held.csv", volts), ("off.csv", volts + (rows == 40_003))):
        write(name, "time_s,voltage_V", 0.1 * STEP * rows, values)
    done("check", "held.csv", "--against", "drive.csv")
    outcome = dbo("check", "off.csv", "--against", "drive.csv")
    assert outcome.code == 3 and "differs by up to" in outcome.out


@pytest.mark.parametrize("fault", ["twice", "skipped", "missing"])
def test_rows_played_twice_skipped_or_missing_are_told(fault):
    """Between two rows of a drive of the same rate nothing else is right; a recorder may lose some."""
    rows = np.arange(4000)
    volts = 50.0 + 40.0 * np.sin(2.0 * np.pi * 3.0 * STEP * rows)
    picked = np.sort(np.append(rows, 2000)) if fault == "twice" else rows
    if fault == "skipped":
        picked = np.delete(rows, 2000)
    stamps = STEP * np.arange(len(picked))
    if fault == "missing":
        stamps += 0.3 * STEP * np.random.default_rng(1).uniform(-1.0, 1.0, 4000)
        picked, stamps = (
            np.delete(rows, slice(2700, 3000)),
            np.delete(stamps, slice(2700, 3000)),
        )
        volts_of = np.interp(stamps, STEP * rows, volts)
    else:
        volts_of = volts[picked]
    write("drive.csv", "time_s,voltage_V", STEP * rows, volts)
    write("played.csv", "time_s,voltage_V", stamps, volts_of)
    outcome = dbo("check", "played.csv", "--against", "drive.csv")
    told = "not in the recording" if fault == "missing" else "differs by up to"
    assert outcome.code == 3 and told in outcome.out


# --- the next pass ---


@pytest.mark.parametrize("start", [None, 0.0, 1.7e9])
def test_a_pass_is_learned_from_wherever_its_recorder_counts_from(start):
    """It was refused: "its drive belongs to another trajectory"."""
    drive, moved = recorded(0)
    stamps = drive["time_s"]
    write("true.csv", PASS, stamps, drive["voltage_V"], moved)
    known = table(done(*SWEPT, "--tracked", "true.csv"))["voltage_V"]
    if start is not None:
        stamps = start + STEP * np.arange(len(moved))
    write("pass.csv", PASS, stamps, drive["voltage_V"], moved)
    outcome = done(*SWEPT, "--tracked", "pass.csv", "--verbose")
    np.testing.assert_allclose(table(outcome)["voltage_V"], known, atol=1e-9)
    off = rms((moved - drive["desired_um"])[drive["time_s"] > -0.5 * STEP])
    assert "of it noise" in outcome.err
    said = next(line for line in outcome.lines if "expected error" in line)
    assert float(said.split()[3]) == pytest.approx(off, rel=0.02)


@pytest.mark.parametrize("scale", [1.5, 0.6])
def test_a_pass_in_another_scale_than_the_model_s_log_is_refused(scale):
    drive, moved = recorded(0)
    columns = drive["time_s"], drive["voltage_V"]
    write("true.csv", PASS, *columns, moved)
    write("pass.csv", PASS, *columns, scale * moved)
    told = refused(1, *SWEPT, "--tracked", "pass.csv")
    typed = told.split("--scale ")[1].split(",")[0]
    assert float(typed.removeprefix("measured=")) == pytest.approx(1 / scale, rel=0.05)
    known = table(done(*SWEPT, "--tracked", "true.csv"))["voltage_V"]
    scaled = ("--tracked", "pass.csv", "--scale", f"measured={1 / scale!r}")
    np.testing.assert_allclose(table(done(*SWEPT, *scaled))["voltage_V"], known)


def test_a_mean_that_is_not_learned_is_told():
    """The line stated .018 um where .110 came, nearly all mean; the drive had its sweep."""
    drive, moved = recorded(0)
    moved = moved + 0.3
    write("pass.csv", PASS, drive["time_s"], drive["voltage_V"], moved)
    mean = np.mean((moved - drive["desired_um"])[drive["time_s"] > -0.5 * STEP])
    learned = done(*SWEPT, "--tracked", "pass.csv", "--summary", "s.json").err
    assert load("s.json")["expected_rmse"] > abs(mean)  # what `report` compares with
    assert f"RMS without the mean, {mean:.2g} um (--absolute learns it)" in learned
    whole = done(*SWEPT, "--tracked", "pass.csv", "--absolute").err
    assert "expected error" in whole and "without the mean" not in whole


RUN_IN, WAY_IN = ("--passes", 2), ("--approach", 0.13)


@pytest.mark.parametrize(
    ("lead", "start", "lost"),
    [
        (RUN_IN, 0.0, 0), (RUN_IN, 1.7e9, 37), (RUN_IN, 0.0, 737),
        (WAY_IN, 1.7e9, 0), (WAY_IN, 0.0, 37), (WAY_IN, 1.7e9, 737),
    ],
)  # fmt: skip
def test_a_loop_is_learned_from_wherever_its_recorder_counts_from(lead, start, lost):
    """Its stamps were believed: a clock from 0 put what leads to the loop into its mean, or was refused."""
    time = STEP * np.arange(400)
    desired = 5.0 - 2.0 * np.cos(2.0 * np.pi * 2.5 * time)
    write("period.csv", MOVE, time, desired)
    words = ("compensate", model("small"), "period.csv", "--periodic", "--from", 0)
    done(*words, *lead, "-o", "loop.csv")
    drive = table("loop.csv")
    period = drive["voltage_V"][drive["time_s"] > -0.5 * STEP]
    voltage = np.concatenate([drive["voltage_V"], *[period] * 4])
    stamps = drive["time_s"][0] + STEP * np.arange(len(voltage))
    write("played.csv", DRIVE, stamps, voltage)
    moved = simulated("small", "played.csv")
    moved = 0.1 + 1.02 * moved + 0.01 * np.sin(2.0 * np.pi * 12.5 * stamps)
    write("true.csv", PASS, stamps, voltage, moved)
    known = table(done(*words, *lead, "--tracked", "true.csv"))["voltage_V"]
    elsewhere = start + STEP * np.arange(len(voltage) - lost)
    write("pass.csv", PASS, elsewhere, voltage[lost:], moved[lost:])
    found = table(done(*words, *lead, "--tracked", "pass.csv"))["voltage_V"]
    assert np.abs(known - drive["voltage_V"]).max() > 0.02
    np.testing.assert_allclose(found, known, atol=1e-9)


@pytest.mark.parametrize("start", [None, 0.0])
def test_what_was_learned_moves_the_first_value_and_no_row(start):
    """The way behind the sweep lasts as long as it is far: the third pass was laid over some rows off."""
    time = TIME[:3000]
    desired = 3.0 - 1.5 * np.cos(2.0 * np.pi * time)
    write("traj.csv", "time_s,displacement_um", time, desired)
    words = ["compensate", model("creep"), "traj.csv", "--condition", "--from", 0]
    words += ["-o", "drive.csv"]
    errors = []
    for _ in range(4):
        done(*words)
        drive = table("drive.csv")
        moved = simulated("creep", "drive.csv")
        moved = 0.05 + 1.03 * moved + 0.03 * np.sin(2.0 * moved)
        error = (moved - drive["desired_um"])[drive["time_s"] > -0.5 * STEP]
        errors.append(float(np.std(error)))
        stamps = drive["time_s"]
        if start is not None:
            stamps = start + STEP * np.arange(len(moved))
        write("pass.csv", PASS, stamps, drive["voltage_V"], moved)
        words[6:] = ["--tracked", "pass.csv", "--history", "h.json", "-o", "drive.csv"]
    assert max(errors[1:]) < 0.5 * errors[0], errors


@pytest.mark.parametrize("name", ["late", "moving", "creep"])
def test_rows_at_rest_behind_a_sweep_are_none_of_the_move(name):
    """A delay keeps some rows still behind the sweep: the move was taken to begin before them."""
    low, high = (values_of(name)["output"][end] for end in ("min", "max"))
    time = TIME[:3000]
    hump = np.sin(np.pi * np.clip((time - 0.5) / 2.0, 0.0, 1.0)) ** 2
    desired = low + (high - low) * (0.3 + 0.4 * hump)
    write("traj.csv", "time_s,displacement_um", time, desired)
    words = ("compensate", model(name), "traj.csv", "--condition", "-o")
    done(*words, "drive.csv")
    drive = table("drive.csv")
    moved = table(done("simulate", model(name), "drive.csv"))["displacement_um"]
    moved += 1e-3 * (high - low) * np.sin(np.arange(len(moved)) / 50.0)
    error = (moved - drive["desired_um"])[drive["time_s"] > -0.5 * STEP]
    stamps = STEP * np.arange(len(moved))
    write("pass.csv", PASS, stamps, drive["voltage_V"], moved)
    outcome = done(*words, "next.csv", "--tracked", "pass.csv", "--bandwidth", 20)
    told = next(line for line in outcome.lines if "expected error" in line)
    assert float(told.split()[3]) == pytest.approx(np.std(error), rel=0.05)


def test_what_was_learned_between_harmonics_ends_no_learning():
    """The second pass was learned below 1.3 Hz for 25, and the third was refused: its error grew."""
    time = STEP * np.arange(4000)
    fast = 0.05 * np.sin(2.0 * np.pi * 24.0 * time)
    desired = 3.0 + 1.5 * np.sin(2.0 * np.pi * time) + fast
    write("sines.csv", MOVE, time, desired)
    words = ["compensate", model("creep"), "sines.csv", "--from", 0, "--approach", 1]
    done(*words, "-o", "pass.csv")
    errors = []
    for seed in range(3):
        drive = table("pass.csv")
        moved = simulated("creep", "pass.csv")
        moved += 0.03 * np.sin(moved) + 0.03 * (creep(moved, 0.03) - moved)
        moved += 1e-3 * np.random.default_rng(seed).standard_normal(len(moved))
        columns = drive["time_s"], drive["voltage_V"], moved
        write("seen.csv", PASS, *columns)
        error = (moved - drive["desired_um"])[drive["time_s"] > -0.5 * STEP]
        errors.append(np.std(error))
        learned = ("--tracked", "seen.csv", "--history", "passes.json", "--verbose")
        outcome = done(*words, *learned, "-o", "pass.csv")
        cutoff = outcome.err.split("learned below")[1].split()[0]
        assert float(cutoff) == pytest.approx(25.4, rel=0.01)
    assert errors[2] < 1.05 * errors[1] < 0.1 * errors[0]


def test_a_pass_with_another_past_is_refused():
    drive, moved = recorded(1)
    write("swept.csv", PASS, drive["time_s"], drive["voltage_V"], moved)
    told = refused(1, *FIRST, "--approach", 1, "--tracked", "swept.csv")
    assert "past" in told and "--condition" in told
    done(*FIRST, "--approach", 1, "-o", "plain.csv")
    time, desired, volts = table("plain.csv").values()
    write("plain_pass.csv", PASS, time, volts, desired)
    told = refused(1, *SWEPT, "--tracked", "plain_pass.csv")
    assert "past" in told and "--condition" in told


# --- two recorders, one log ---


def two_recorders(delay, both):
    """Record a drive of 2 kHz by a sensor of 1 kHz whose clock is 1.3 s behind and 50 ppm fast."""
    done("excite", "--v-max", 100, "--sample-rate", 2000, "-o", "drive.csv")
    played = table("drive.csv")
    time = played["time_s"]
    rows = np.arange(0.3, time[-1], STEP)
    moved = simulated("creep", "drive.csv")
    columns = {
        "displacement_um": np.interp(rows - delay, time, moved),
        "voltage_V": np.interp(rows, time, played["voltage_V"]),
    }
    rng = np.random.default_rng(0)
    for values in columns.values():
        values += 5e-4 * np.ptp(values) * rng.standard_normal(len(rows))
    if not both:
        columns.pop("voltage_V")
    stamps = 1.00005 * rows - 1.3
    write("sensor.csv", ",".join(["time_s", *columns]), stamps, *columns.values())


@pytest.mark.parametrize("both", [True, False])
def test_clocks_of_two_recorders_are_found(both):
    """The actuator's own delay stays in the model where both hold the drive, else it is said."""
    two_recorders(4e-3, both)
    words = ("--voltage", "drive.csv::voltage_V", "--clock-offset", "auto")
    plain = ("--relaxation", 0, "--points", 0, "--dynamics", 0, "--gears", 20)
    words = ("identify", "sensor.csv", *words, *plain, "-o", "m.json", "--verbose")
    outcome = done(*words)
    assert f"moved by -1.{'3' if both else '29'}" in outcome.err
    assert ("by the drive" if both else "delay included") in outcome.err
    assert not both or "50 ppm fast" in outcome.err
    stages = load("m.json")["stages"]
    assert any(stage["type"] == "delay" for stage in stages) == both


@pytest.mark.parametrize(
    ("offset", "swings"),
    [(0.0, "many"), (0.03, "many"), (-0.03, "many"), (0.03, "one")],
)
def test_a_recorder_that_began_a_little_late_is_told_of_where_it_shows(offset, swings):
    """Up to 50 ms were taken in silence; one swing that repeats is as well a wider loop."""
    words = ("--v-max", 100, "--sample-rate", 200, "--duration", 10)
    done("excite", *words, "-o", "drive.csv")
    if swings == "one":
        time = np.arange(0.0, 20.0, 5e-3)
        write("drive.csv", DRIVE, time, 100.0 * abs(0.2 * time % 2 - 1))
    moved = simulated("creep", "drive.csv")
    moved += 1e-3 * np.random.default_rng(0).standard_normal(len(moved))
    stamps = offset + table("drive.csv")["time_s"]
    write("sensor.csv", MOVE, stamps, moved)
    words = ("sensor.csv", "--voltage", "drive.csv::voltage_V")
    outcome = done("identify", *words, *QUICK, "-o", "m.json", "--force")
    told = [text for text in outcome.warnings if "do not line up" in text]
    assert len(told) == (offset != 0.0 and swings == "many")
    for text in told:
        assert f"{offset:+.2g}"[:4] in text and "--clock-offset auto" in text
        assert ("or 0 if" in text) == (offset > 0.0)


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_what_a_report_cannot_tell_from_a_late_actuator_is_an_error(offset):
    desired = 3.0 + 2.0 * np.sin(2.0 * np.pi * 0.5 * TIME) * np.exp(-0.3 * TIME)
    rng = np.random.default_rng(4)
    write("traj.csv", MOVE, TIME, desired)
    measured = desired + 2e-3 * rng.standard_normal(len(TIME))
    write("pass.csv", "time_s,measured_um", TIME + offset, measured)
    log = reported("traj.csv")
    assert log["clock_offset_s"] is None
    assert log["lag_left_s"] == pytest.approx(offset, abs=1e-3)


def test_a_late_sensor_is_no_error():
    """It stands in the model and in a summary; reports and learning take it off."""
    late = 8e-3
    done("excite", "--v-max", 100, "--duration", 10, "-o", "drive.csv")
    time, volts = (table("drive.csv")[key] for key in ("time_s", "voltage_V"))
    moved = simulated("creep", "drive.csv")
    write("log.csv", LOG, time, volts, np.interp(time - late, time, moved))
    words = "--relaxation 0.01,0.3 --points 8 --delay 0 --dynamics 0 --slopes growing"
    words = ("log.csv", "--sensor-delay", "8ms", *words.split())
    done("identify", *words, "-o", "m.json")
    write("move.csv", MOVE, TIME, 3.0 - 2.0 * np.cos(np.pi * TIME))
    words = ("compensate", "m.json", "move.csv", "--condition", "--from", 0)
    done(*words, "-o", "d.csv", "--summary", "s.json")
    assert load("m.json")["fit"]["sensor_delay"] == late
    assert load("s.json")["sensor_delay"] == late
    stamps, desired, volts = table("d.csv").values()
    truth = simulated("creep", "d.csv")
    write("pass.csv", PASS, stamps, volts, np.interp(stamps - late, stamps, truth))
    off = rms((truth - desired)[stamps > -0.5 * STEP])
    assert reported("d.csv")["rmse"] > 1.3 * off
    known = reported("d.csv", "--expected", "s.json")
    assert known["rmse"] == pytest.approx(off, rel=0.05)
    done(*words, "--tracked", "pass.csv", "-o", "next.csv")
    stamps, desired, _ = table("next.csv").values()
    truth = simulated("creep", "next.csv")
    assert rms((truth - desired)[stamps > -0.5 * STEP]) < off


def told_of(measured, desired, expected):
    """Return the warnings of a report of a move with an expected error (um)."""
    write("run.csv", PAIR, TIME, desired, measured)
    ends = [desired.min(), desired.max()]
    store("s.json", {**SUMMARY, "expected_rmse": expected, "move_range": ends})
    return dbo("report", "run.csv", "--expected", "s.json").warnings


def test_an_error_far_above_the_expected_one_says_what_to_look_at_and_noise_is_none():
    rng = np.random.default_rng(3)
    desired = 3.0 + 2.0 * np.sin(2.0 * np.pi * 0.5 * TIME)
    white = 0.02 * rng.standard_normal(len(TIME))
    assert told_of(desired + white, desired, 0.002) == []
    (mean,) = told_of(desired + white + 0.1, desired, 0.005)
    assert "mean 0.1" in mean
    late = 3.0 + 2.0 * np.sin(2.0 * np.pi * 0.5 * (TIME - 8e-3))
    (lag,) = told_of(late + white, desired, 0.005)
    assert "lag 8.0 rows" in lag and "--sensor-delay" in lag
    jump = np.where((TIME > 2.0) & (TIME < 2.02), 1.0, 0.0)
    (rows,) = told_of(desired + white + jump, desired, 0.005)
    assert "row 2,0" in rows
    loop = 0.05 * np.cos(2.0 * np.pi * 1.0 * TIME)
    (again,) = told_of(desired + white + loop, desired, 0.005)
    assert "identify again" in again


def test_a_loop_keeps_its_period_at_other_points():
    """200 rows of 1 ms are 0.2 s; 100 points were 0.20101 s, with a step over the seam."""
    phase = 2.0 * np.pi * np.arange(200) / 200.0
    volts = 50.0 + 40.0 * np.sin(phase)
    write("loop.csv", DRIVE, STEP * np.arange(200), volts)
    words = ("waveform", "loop.csv", "--to", "npy", "--points", 100, "-o", "loop.npy")
    outcome = done(*words, "--loop")
    assert "500 Hz, 0.2 s" in outcome.err and "offset 50 V" in outcome.err
    points = np.load("loop.npy")
    assert points == pytest.approx(volts[::2], abs=1e-9)
    done(*words[:-4], "--rate", 500, "-o", "rate.npy", "--loop")
    assert np.array_equal(np.load("rate.npy"), points)
    ramp = np.linspace(0.0, 100.0, 200)
    write("open.csv", DRIVE, STEP * np.arange(200), ramp)
    words = ("waveform", "open.csv", "--to", "npy", "-o", "x.npy", "--loop")
    assert "loop" in refused(3, *words)


@pytest.mark.parametrize("early", [0.0, 0.13])
def test_a_first_period_that_is_worse_is_no_lag_of_a_period(early):
    time = STEP * np.arange(1000)
    desired = 5.0 - 3.0 * np.cos(2.0 * np.pi * 5.0 * time)
    error = 0.002 * np.random.default_rng(1).standard_normal(1000)
    error = error - 0.3 * np.exp(-time / 0.07)
    write("pair.csv", PAIR, time, desired, desired + error)
    log = done("report", "pair.csv", "--format", "json").json["logs"][0]
    assert abs(log["lag_left_samples"]) < 1.0
    write("move.csv", MOVE, time, desired)
    rest = np.full(round(early / STEP), 2.0)
    measured = np.concatenate([rest, desired + error])
    stamps = STEP * np.arange(len(measured))
    write("pass.csv", "time_s,measured_um", stamps, measured)
    log = reported("move.csv")
    assert log["samples"] == 1000
    assert (log["clock_offset_s"] or 0.0) == pytest.approx(early, abs=1.5 * STEP)
    assert log["rmse"] == pytest.approx(rms(error), rel=0.02)
