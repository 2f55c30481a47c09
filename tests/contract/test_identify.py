"""``dbo identify``: errors within bounds, sign, delay, past, what is refused and what is said."""

import json
import re
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import scipy.signal

import dbo_cli
from dbo_cli.errors import FitError
from dbo_cli.identification.problem import drive_range
from dbo_cli.identification.recording import begins_in_motion
from dbo_cli.library import Fit
from dbo_cli.model import Candidate, Cascade, Gears, Quantity, Relaxation
from dbo_cli.model.expect import expected_error

from .conftest import creep_log
from .program import (
    LOG, MODELS, QUICK, SAMPLES, dbo, done, load, plays_of, refused, rms, simulated, store,
    table, values_of, write,
)  # fmt: skip

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
ROOT = SAMPLES.parent
FITTED = Path("model.json")


def identified(*words):
    """Identify into ``model.json`` and return its values."""
    done("identify", *words, "-o", FITTED, "-q")
    return load(FITTED)


def swings(rows=1200):
    """Return time and a drive of 0 to 100 V in full and in smaller swings."""
    time = np.arange(rows) / 500.0
    part = time / time[-1]
    size = np.where(part < 0.5, 50.0, np.where(part < 0.75, 35.0, 20.0))
    return time, 50.0 - size * np.cos(2.0 * np.pi * 2.5 * time)


def played(drive):
    """Return where the gears of the stored model ``creep`` alone go: 0 to 5.12 um, no memory of time."""
    values = values_of("creep")
    del values["stages"][0]["relaxation"], values["stages"][1]
    return dbo_cli.read_model(store("gears.json", values)).simulate(drive)


def moved_log(name="log.csv", noise=0.002):
    """Write a log of those gears, with noise of a sensor (um)."""
    time, drive = swings()
    error = np.random.default_rng(4).normal(0.0, noise, len(time))
    return write(name, LOG, time, drive, played(drive) + error)


# --- the sample log ---


def test_the_sample_is_followed_within_a_hundredth_of_a_percent(sample_model):
    """Sensor noise is 5 nm, the range 12 um; a straight line leaves 0.6 um."""
    fit = load(sample_model)["fit"]
    assert fit["sign"] == "rising"
    assert 0.003 < fit["rmse"] < 0.012
    seen = np.hypot(fit["expected_rmse"], fit["noise_rms"])  # by this sensor
    assert fit["rmse"] < seen < 0.06
    assert fit["line_rmse"] > 0.3


def test_the_sample_s_bench_follows_the_drive(sample_model):
    """Compensated on the bench that is no DBO, from rest at 0 V: what is stated comes, noise beside it."""
    from virtual_actuator import VirtualActuator

    noise = load(sample_model)["fit"]["noise_rms"]
    words = (sample_model, SAMPLES / "trajectory.csv", "--from", 0, "-q")
    stated = []
    for state in ("empty", "auto"):
        outputs = ("-o", "drive.csv", "--summary", "summary.json")
        done("compensate", *words, "--state", state, *outputs)
        drive = table("drive.csv")
        came = VirtualActuator().play(drive["time_s"], drive["voltage_V"], 2)
        error = rms(came - drive["desired_um"])
        assert error < 0.05
        stated.append(load("summary.json")["expected_rmse"])
    assert 0.8 < error / np.hypot(stated[0], noise) < 1.2
    assert stated[1] > 2.0 * stated[0]  # where the past is unknown


def test_the_sample_s_model_fits_the_schema_and_holds_what_a_model_does(sample_model):
    values = load(sample_model)
    schema = load(ROOT / "docs" / "model-file.schema.json")
    for found in (values, done("invert", sample_model).json):
        assert jsonschema.Draft202012Validator(schema).is_valid(found)
    assert set(values["fit"]) <= set(Fit.__annotations__)
    assert values["input"]["min"] == pytest.approx(0.0, abs=0.5)
    assert values["input"]["max"] == pytest.approx(100.0, abs=0.5)
    assert values["output"]["unit"] == "um"
    gears = next(one for one in values["stages"] if one["type"] == "backlash")
    assert gears["relaxation"]["tau"]
    candidates = values["candidates"]
    assert 1 <= len(candidates) <= 5
    assert sum(one["weight"] for one in candidates) == pytest.approx(1.0, abs=1e-6)
    origin = json.dumps(values["provenance"])
    assert "identification.csv" in origin
    assert "/" not in origin.replace("um/V", "")


# --- small logs ---


@pytest.mark.parametrize(
    ("sign", "words", "ends"),
    [
        (-1.0, "", (6.0, 6.0 - 5.144)),
        (1.0, "--zero first", (0.0, 5.144)),
        (1.0, "--zero 2.5", (3.5, 8.644)),
    ],
)
def test_sign_and_zero(sign, words, ends):
    """Where the displacement counts from; 6 um stood at 0 V."""
    time, drive = swings()
    write("log.csv", LOG, time, drive, 6.0 + sign * played(drive))
    fit = identified("log.csv", *QUICK, *words.split())["fit"]
    assert fit["sign"] == ("rising" if sign > 0.0 else "falling")
    came = simulated(FITTED, write("ends.csv", "voltage_V", [0.0, 100.0]))
    np.testing.assert_allclose(came, ends, atol=0.05)


@pytest.mark.parametrize(("sign", "code"), [("rising", 0), ("falling", 3)])
def test_the_other_sign_is_refused(sign, code):
    words = ("identify", moved_log(), *QUICK, "--sign", sign, "-o", FITTED)
    assert dbo(*words).code == code
    assert FITTED.exists() == (code == 0)


def test_a_delay_is_found():
    time, drive = swings()
    write("log.csv", LOG, time, drive, played(np.interp(time - 0.006, time, drive)))
    stages = identified("log.csv", "--relaxation", 0, "--dynamics", 0)["stages"]
    delays = [one["seconds"] for one in stages if one["type"] == "delay"]
    assert delays and abs(delays[0] - 0.006) < 0.001


def test_a_structure_that_is_typed_is_taken():
    words = "--points 6 --gears 64 --relaxation 0.01,300ms --delay 0.004".split()
    stages = identified(moved_log(), *words, "--dynamics", 0, "--force")["stages"]
    kinds = [one["type"] for one in stages]
    assert done("show", FITTED, "--format", "json").json["gears"] == 64
    assert kinds.count("point") == 1
    assert stages[kinds.index("delay")]["seconds"] == 0.004
    relaxation = stages[kinds.index("backlash")]["relaxation"]
    assert relaxation["tau"] == pytest.approx([0.01, 0.3])


def test_a_library_of_many_threads_writes_the_file_of_the_shell():
    """The same numbers from both, however many threads linear algebra has in a process."""
    moved_log()
    words = ("--points", 0, "--delay", 0, "--slopes", "growing")
    done("identify", "log.csv", *words, "-o", "shell.json")
    call = "identify('log.csv', points=0, delay=0.0, slopes='growing')"
    script = f"import dbo_cli; dbo_cli.{call}.save('library.json')"
    many = {**os.environ, "OPENBLAS_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", script], env=many, check=True)
    assert Path("library.json").read_bytes() == Path("shell.json").read_bytes()


def test_several_logs_are_fitted_together():
    """Their error is that of all rows, the sample period the shortest."""
    first = table(creep_log("a.csv"))
    second = {name: values[:1400:2].copy() for name, values in first.items()}
    second["displacement_um"] += np.random.default_rng(5).normal(0.0, 0.3, 700)
    write("b.csv", LOG, *second.values())
    for names in (("a.csv", "b.csv"), ("b.csv", "a.csv")):
        values = identified(*names, *QUICK, "--force", "--summary", "s.json")
        origin = json.dumps(values["provenance"])
        assert "a.csv" in origin and "b.csv" in origin
        fit = load("s.json")
        assert fit["sample_period"] == pytest.approx(0.002, rel=1e-9)
        errors = {log["name"]: log["rmse"] for log in fit["logs"]}
        assert list(errors) == list(names) and errors["b.csv"] > 2.0 * errors["a.csv"]
        squares = sum(log["rows"] * log["rmse"] ** 2 for log in fit["logs"])
        rows = sum(log["rows"] for log in fit["logs"])
        assert rows == 700 + len(first["time_s"])
        assert fit["rmse"] == pytest.approx(math.sqrt(squares / rows), rel=1e-9)


def test_skip_leaves_out_the_beginning():
    columns = table(moved_log())
    columns["displacement_um"][:59] = 50.0
    log = write("log.csv", LOG, *columns.values())
    fit = identified(log, *QUICK, "--skip", 0.2)["fit"]
    assert fit["rmse"] < 0.1
    assert fit["logs"][0]["rows"] == 1200 - 100


@pytest.mark.parametrize("wrong", [150.0, -500.0, -20.0])
def test_a_voltage_that_stands_alone_makes_no_range(wrong):
    """A row of 150 V in a log of 0 to 100 made a model of 0 to 150 V, where a drive would go."""
    time, drive = swings()
    read = drive.copy()
    read[700] = wrong
    write("log.csv", LOG, time, read, played(drive))
    told = refused(1, "identify", "log.csv", "-o", FITTED, *QUICK)
    assert "row 701" in told and f"{wrong:g}" in told and "--force" in told
    assert not FITTED.exists()


def test_spikes_do_not_spoil_a_model():
    log = moved_log()
    clean = identified(log, *QUICK)["fit"]["rmse"]
    columns = table(log)
    columns["displacement_um"][[300, 555, 901]] += 30.0
    write("log.csv", LOG, *columns.values())
    assert identified("log.csv", *QUICK)["fit"]["rmse"] < 1.3 * clean
    told = done("identify", "log.csv", "-o", FITTED, *QUICK).err
    assert "warning: log.csv: 3 rows left out (first: row 301)" in told


def test_the_method_of_the_paper():
    words = ("--method", "paper", "--gears", 25, "--zero", "mean", "--rows", "401:800")
    stages = identified(creep_log("log.csv"), *words, "--force")["stages"]
    gears = next(one for one in stages if one["type"] == "backlash")
    assert done("show", FITTED, "--format", "json").json["gears"] == 25
    assert gears["x0"] == pytest.approx(0.0, abs=5.0)


def test_other_units_and_quantities():
    time, volts, moved = table(moved_log()).values()
    micro = identified("log.csv", *QUICK)["fit"]["rmse"]
    write("log.csv", "time_s,voltage_V,displacement_nm", time, volts, 1000.0 * moved)
    found = identified("log.csv", *QUICK)
    assert found["output"]["unit"] == "nm"
    assert found["fit"]["rmse"] == pytest.approx(1000.0 * micro, rel=1e-3)
    write("muscle.csv", "time_s,pressure_bar,angle_mrad", time, volts, moved)
    words = ("--voltage", "pressure_bar", "--displacement", "angle_mrad")
    found = identified("muscle.csv", *words, *QUICK)
    assert (found["input"]["quantity"], found["input"]["unit"]) == ("pressure", "bar")
    assert found["output"]["unit"] == "mrad"


# --- refusals ---


def test_a_line_is_refused_and_force_keeps_it():
    """Noise instead of a displacement: no better than a straight line."""
    time, drive = swings()
    noise = np.random.default_rng(6).normal(0.0, 1.0, len(time))
    write("log.csv", LOG, time, drive, noise)
    error = refused(1, "identify", "log.csv", *QUICK, "-o", FITTED)
    assert "--force" in error
    identified("log.csv", *QUICK, "--force")


RAMP, STILL = np.linspace(0.0, 10.0, 500), np.full(500, 5.0)
SINE = 5.0 + 5.0 * np.sin(np.arange(500) / 20.0)


@pytest.mark.parametrize(
    ("drive", "moved"),
    [(STILL, RAMP), (SINE, STILL), (RAMP, 0.1 * RAMP), (np.arange(9.0) % 4, np.arange(9.0) % 4)],
    ids=["a drive at rest", "a displacement at rest", "a drive that only rises", "a few rows"],
)  # fmt: skip
def test_a_log_that_shows_nothing_is_refused(drive, moved):
    write("log.csv", LOG, np.arange(len(drive)) / 500.0, drive, moved)
    assert "log.csv" in refused(1, "identify", "log.csv", "-o", FITTED)


def test_logs_of_different_units_are_not_mixed_and_a_model_is_no_log():
    first = moved_log("a.csv")
    text = first.read_text().replace("displacement_um", "displacement_mrad")
    Path("b.csv").write_text(text)
    words = ("--displacement", "3", *QUICK)
    error = refused(1, "identify", first, "b.csv", *words, "-o", FITTED)
    assert "um" in error and "mrad" in error
    assert "small.json" in refused(1, "identify", MODELS / "small.json", "-o", FITTED)


# --- what is said and written ---


def test_what_to_expect_is_said_and_stands_in_a_summary():
    words = ("-o", FITTED, "--summary", "summary.json")
    outcome = done("identify", moved_log(), *QUICK, *words)
    last = outcome.said[-1]
    assert "model.json" in last and "expected error" in last and "um" in last
    assert "rising" in outcome.said[0]
    told, fit = load("summary.json"), load(FITTED)["fit"]
    assert (told["format"], told["version"], told["unit"]) == ("dbo-summary", 1, "um")
    assert told["rmse"] == fit["rmse"] and told["expected_rmse"] == fit["expected_rmse"]


def test_one_amplitude_is_warned_of():
    time = np.arange(1500) / 500.0
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * 2.0 * time)
    noise = np.random.default_rng(3).normal(0.0, 0.01, len(time))
    write("log.csv", LOG, time, drive, played(drive) + noise)
    outcome = done("identify", "log.csv", *QUICK, "--force", "-o", FITTED)
    assert any("amplitude" in line for line in outcome.warnings)


# --- the past of a log is unknown, and the stated error is the one that a user meets ---

RATE = 100.0
TIME = np.arange(1200) / RATE
REACH = np.linspace(0.0, 40.0, 9)
SPRINGS = np.linspace(2.0, 0.4, 9)
FADING = 50.0 - 50.0 * np.cos(2.0 * np.pi * 0.5 * TIME) * np.exp(-TIME / 6.0)


def moved_by(drive, before=100.0):
    """Return a sum of plays of a drive that was at 0 and then at ``before`` first."""
    plays = np.clip(np.full(9, before), before - REACH, before + REACH)
    return 0.05 * plays_of(drive, REACH, plays) @ SPRINGS


def fitted(drive, moved):
    plain = {"relaxation": (0.0,), "delay": 0.0, "points": 0}
    return dbo_cli.identify(drive, moved, sample_rate=RATE, **plain)


def error_behind_the_first_swings(model, drive, came):
    """Return the error (RMS) where no past shows."""
    left = model.simulate(drive, sample_rate=RATE) - came
    return float(np.std(left[300:]))


@pytest.mark.parametrize("cut", [0.02, 0.05])
def test_a_beginning_that_is_cut_off_makes_little_difference(cut):
    came = moved_by(FADING)
    first = int(cut * len(FADING))
    test = 50.0 - 45.0 * np.cos(2.0 * np.pi * 0.4 * TIME) * (0.6 + 0.4 * TIME / 12.0)
    truth = moved_by(test)
    models = fitted(FADING, came), fitted(FADING[first:], came[first:])
    errors = [error_behind_the_first_swings(one, test, truth) for one in models]
    assert errors[1] < 2.0 * errors[0] + 2e-3 * np.ptp(came)


def test_a_log_that_begins_inside_its_range_keeps_all_its_rows():
    drive = np.concatenate([np.linspace(60.0, 0.0, 100), FADING])[: len(TIME)]
    came = moved_by(drive, 0.0)
    model = fitted(drive, came)
    assert not any("left out" in note for note in model.fit["notes"])
    assert model.fit["logs"][0]["rows"] == len(drive)
    error = error_behind_the_first_swings(model, FADING, moved_by(FADING))
    assert error < 0.01 * np.ptp(came)


def test_walks_apart_and_a_drift_above_the_range_are_refused():
    rng = np.random.default_rng(0)
    drive, other = np.cumsum(rng.standard_normal((2, 800)), axis=1)
    with pytest.raises(FitError, match="force"):
        fitted(drive, other)
    came = moved_by(FADING)
    with pytest.raises(FitError, match="drift"):
        fitted(FADING, came + 3.0 * np.ptp(came) * TIME / TIME[-1])


def test_noise_of_the_sensor_is_no_error_of_the_actuator():
    came = moved_by(FADING)
    size = 0.02 * float(np.ptp(came))
    model = fitted(FADING, came + size * np.random.default_rng(1).normal(size=1200))
    assert model.fit["noise_rms"] == pytest.approx(size, rel=0.15)
    assert model.fit["expected_rmse"] < 0.8 * size < model.fit["rmse"]


def even_gears(count, low, relaxation=None):
    """Return a model of gears of 1 V that states .01 um, identified from 0 to 100 V."""
    width = np.full(count, 1.0)
    gears = Gears(width, 0.1 * width, low, 0.1 * low, relaxation)
    volts, microns = Quantity("voltage", "V", 0, 100), Quantity("d", "um", 0, 12)
    stated = {"fit": {"left_out_rmse": 0.01}, "candidates": (Candidate(1.0, (gears,)),)}
    return Cascade("forward", volts, microns, (gears,), **stated)


def test_memories_that_may_have_rested_elsewhere_are_in_the_stated_error():
    model = even_gears(100, 0.0, Relaxation(0.0, (1e4,), (0.02,)))
    error = expected_error(model, 50.0 + 10.0 * np.sin(TIME), 0.01)
    assert error.known == pytest.approx(0.01)
    # 100 V times 0.02 um/V, equally likely anywhere: a twelfth of the square
    unknown = np.hypot(error.known, error.memory)
    assert unknown == pytest.approx(2.0 / np.sqrt(12.0), rel=0.01)


def test_a_kept_start_may_be_wrong_at_an_end_of_the_range_too():
    model = replace(even_gears(120, -10.0), auto_start="above")
    drive = 5.0 - 5.0 * np.cos(TIME)
    kept, settled = (
        model.simulate(drive, dt=0.01, state=s)[0] for s in ("auto", "settled")
    )
    off = float(np.sqrt(np.mean((kept - settled) ** 2)))
    error = expected_error(model, drive, 0.01)
    assert np.linalg.norm(error) == pytest.approx(np.hypot(0.01, off), rel=0.01)
    assert expected_error(replace(model, auto_start="settled"), drive, 0.01).past == 0.0


def test_the_range_is_that_of_the_drive_and_not_of_its_noise():
    came = moved_by(FADING)
    noisy = FADING + 0.5 * np.random.default_rng(2).normal(size=FADING.size)
    for drive in (FADING, np.round(FADING, 2)):
        found = fitted(drive, came).input
        assert (found.min, found.max) == (drive.min(), drive.max())
    low = fitted(noisy, came).input.min
    assert -0.7 < low < 0.7
    assert noisy.min() <= low <= noisy.min() + 2.0


@pytest.mark.parametrize("held", [1, 2, 5, 50])
def test_a_drive_that_is_held_or_goes_in_steps_keeps_its_ends(held):
    """Two rows of a converter each looked like noise; without repeats the levels of steps do."""
    sine = 50.0 - 50.0 * np.cos(2.0 * np.pi * np.arange(0.0, 4.0, held * 2e-3))
    levels = np.random.default_rng(held).uniform(0.0, 100.0, 120)
    for drive in (np.repeat(sine, held), np.repeat(levels, 50)):
        assert drive_range(drive) == (drive.min(), drive.max())


def test_the_development_table_refuses_a_constant_that_is_none(tmp_path):
    script = ROOT / "benchmarks" / "identification.py"
    command = [sys.executable, script, tmp_path, "none", "--set", "search.BENDS=()"]
    run = subprocess.run([*command, "--set", "search.NOPE=1"], capture_output=True)
    assert run.returncode != 0
    assert b"NOPE" in run.stderr and b"BENDS" not in run.stderr.splitlines()[-1]


def bent_plays(drive):
    """Return what 33 plays that begin empty, and a bend behind them, make of a drive (V)."""
    reach = np.linspace(0.0, 40.0, 33)
    moved = 0.1 * drive + 0.002 * plays_of(drive, reach, reach).sum(axis=1)
    return moved + 0.002 * moved**2


def test_the_start_of_logs_that_come_from_beyond_their_range_is_kept():
    """A scanner comes from its whole stroke to a part of it. Taken for settled, such a log was .27 um off."""
    time = np.arange(2400) / 200.0
    moves = 20.0 * np.linspace(1.0, 0.3, 2400) * np.cos(np.pi * time)
    noise = np.random.default_rng(3).normal(0.0, 0.003, len(moves))
    for beyond, drive, start, typed in (
        (250.0, 50.0 + moves, "above", ("--slopes", "growing")),
        (-150.0, 50.0 - moves, "below", ("--relaxation", 0)),
    ):
        way = np.linspace(beyond, drive[0], 400)
        moved = bent_plays(np.concatenate([way, drive]))[400:]
        write("log.csv", LOG, time, drive, moved + noise)
        identified("log.csv", "--delay", 0, *typed)
        model = dbo_cli.read_model(FITTED)
        assert load(FITTED)["past"] == start
        assert rms(model.simulate(drive, time=time) - moved) < 0.005
        for rows in (slice(0, 800), slice(300, 1100)):
            wanted = model.simulate(drive[rows], time=time[rows])
            voltage = model.compensate(wanted, time=time[rows])
            followed = model.simulate(voltage, time=time[rows])
            assert np.abs(followed - wanted).max() < 1e-9


def test_the_start_of_a_log_that_a_recorder_began_late_is_kept():
    """The first way up was half gone. From the settled start such a record was followed .056 off."""
    time = np.arange(3200) / 200.0
    drive = 50.0 - 50.0 * np.linspace(1.0, 0.15, 3200) * np.cos(2.0 * np.pi * time)
    moved = bent_plays(drive)
    noise = np.random.default_rng(3).normal(0.0, 0.003, len(drive))
    errors = []
    for first in (0, 60):
        rows = slice(first, None)
        write("log.csv", LOG, time[rows], drive[rows], (moved + noise)[rows])
        identified("log.csv", "--delay", 0, "--relaxation", 0, "--slopes", "growing")
        model = dbo_cli.read_model(FITTED)
        errors.append(rms(model.simulate(drive, time=time) - moved))
    assert errors[1] < 5.0 * errors[0]
    assert load(FITTED)["past"] == "empty"
    assert rms(model.simulate(drive[60:], time=time[60:]) - moved[60:]) < 0.02
    wanted = model.simulate(drive[60:1000], time=time[60:1000])
    voltage = model.compensate(wanted, time=time[60:1000])
    assert np.abs(model.simulate(voltage, time=time[60:1000]) - wanted).max() < 1e-9


def crept(driven, *terms):
    """Return what lags behind a drive of 200 rows a second: time constants (s), each with its share."""
    total = np.zeros(len(driven))
    for tau, share in terms:
        decay = np.exp(-0.005 / tau)
        total += share * scipy.signal.lfilter([1.0 - decay], [1.0, -decay], driven)
    return total


@pytest.mark.parametrize("first", [100, 360], ids=["at 100 V", "falling at 81 V"])
def test_a_log_that_begins_in_motion_keeps_its_zero(first):
    """What slow creep held of the time before a log was taken for its zero: ten times the stated error."""
    drive = table(done("excite", "--v-max", 100, "--sample-rate", 200))["voltage_V"]
    reach = np.linspace(0.0, 50.0, 41)
    share = 0.1 * np.exp(-reach / 15.0) / np.exp(-reach / 15.0).sum()
    jumped = plays_of(drive, reach, np.zeros(41)) @ share
    moved = jumped + crept(jumped, (0.3, 0.02), (10.0, 0.03))
    noise = np.random.default_rng(3).normal(0.0, 0.002, len(drive))
    time = np.arange(len(drive)) / 200.0
    rows = slice(first, None)
    write("log.csv", LOG, time[rows], drive[rows], (moved + noise)[rows])
    plain = ("--points", 0, "--delay", 0, "--slopes", "growing")
    stated = identified("log.csv", *plain)["fit"]["expected_rmse"]
    followed = dbo_cli.read_model(FITTED).simulate(drive, time=time)
    error = rms((followed - moved)[rows])
    assert error < 0.003 * np.ptp(moved)
    assert error < 2.0 * stated


def piezo(drive, before):
    """Plays and creep of three speeds, 200 rows a second, after a past of its own; um for V."""
    driven = np.concatenate((before, drive))
    reach = np.linspace(2.0, 60.0, 30)
    weights = np.exp(-np.arange(30) / 8.0)
    weights *= 0.3 / weights.sum()
    plays = plays_of(driven, reach, np.maximum(driven[0] - reach, 0.0))
    moved = 0.85 * driven + plays @ weights
    moved += crept(driven, (0.02, 0.02), (0.5, 0.03), (12.0, 0.03))
    return 0.11 * moved[len(before) :]


def test_a_decay_that_begins_on_a_way_from_rest_tells_new_moves():
    """Gears and memories taken for settled at its first row: new moves were .39 um off."""
    time = np.arange(4000) / 200.0
    drive = 50.0 + 50.0 * np.sin(np.pi * time) * np.exp(-time / 18.0)
    noise = np.random.default_rng(3).normal(0.0, 0.005, len(drive))
    moved = piezo(drive, np.linspace(0.0, 50.0, 100))
    plain = {"points": 0, "delay": 0.0, "slopes": "growing"}
    model = dbo_cli.identify(drive, moved + noise, time=time, **plain)
    turns = np.random.default_rng(5).uniform(0.0, 100.0, 21)
    new = np.interp(time, np.arange(21.0), turns)
    error = model.simulate(new, time=time) - piezo(new, np.zeros(1))
    assert np.std(error[1000:]) < 0.15


def test_the_number_holds_a_zero_that_a_log_begun_in_motion_does_not_show():
    """.009 um was stated for a conditioned move, and .26 came, all of it the zero."""
    time = np.arange(4000) / 200.0
    drive = 50.0 + 45.0 * np.sin(1.4 * np.pi * time + 1.0) * np.cos(0.12 * np.pi * time)
    before = np.interp(np.arange(600), [0, 200, 400, 600], [0, 90, 10, drive[0]])
    noise = np.random.default_rng(5).normal(0.0, 0.005, len(drive))
    moved = piezo(drive, before) + noise
    plain = {"points": 0, "delay": 0.0, "slopes": "growing"}
    model = dbo_cli.identify(drive, moved, sample_rate=200.0, **plain)
    wanted = 5.5 - 3.0 * np.cos(2.0 * np.pi * np.arange(800) / 200.0)
    amplifier = {"from_": 0.0, "v_min": 0.0, "v_max": 100.0, "max_slew": 2000.0}
    plan = model.compensate(
        wanted, sample_rate=200.0, condition=True, details=True, **amplifier
    )
    moved = piezo(plan.voltage, np.zeros(1))[plan.lead_rows :][: len(wanted)]
    assert rms(moved - wanted) < 2.5 * plan.expected_error


def test_a_zero_that_creep_from_before_a_log_may_shift_is_told():
    """Begun on a way, a log stated .009 um, and .022 came, most of it the zero."""
    drive = table(done("excite", "--v-max", 100, "--sample-rate", 200))["voltage_V"]
    noise = np.random.default_rng(3).normal(0.0, 0.002, len(drive))
    moved = piezo(drive, np.zeros(1)) + noise
    plain = {"points": 0, "delay": 0.0, "slopes": "growing", "sample_rate": 200.0}
    texts = []
    for first in (0, 250):
        model = dbo_cli.identify(drive[first:], moved[first:], **plain)
        texts.append([text for text in model.fit["warnings"] if "in motion" in text])
    assert not texts[0]
    rested = np.concatenate([drive, np.full(4 * len(drive), drive[-1])])
    assert not begins_in_motion(rested, np.arange(len(rested)) / 200.0)
    error = (model.simulate(drive, sample_rate=200.0) - moved)[1000:]
    shift = float(re.search(r"zero by (\d+\.\d+)", texts[1][0])[1])
    assert model.fit["expected_rmse"] < abs(np.mean(error)) < shift
