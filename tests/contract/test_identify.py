"""``dbo identify``: errors within bounds, sign, delay, what is refused and what is said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from dbo_cli.library import Fit

from .conftest import creep_log
from .program import (
    SAMPLES,
    Floats,
    dbo,
    done,
    model,
    refused,
    rms,
    table,
    values_of,
    write,
)

QUICK = "--gears 20 --points 0 --delay 0 --relaxation 0 --dynamics 0".split()
"""A structure that is fitted in a moment."""
LOG = "time_s,voltage_V,displacement_um"
SCHEMA = SAMPLES.parent / "docs" / "model-file.schema.json"


def identified(*words: object) -> Any:
    """Identify into ``model.json`` and return its values."""
    done("identify", *words, "-o", "model.json", "-q")
    return json.loads(Path("model.json").read_text())


def swings(rows: int = 1200) -> tuple[Floats, Floats]:
    """Return time and a drive of 0 to 100 V in full and in smaller swings."""
    time = np.arange(rows) / 500.0
    part = time / time[-1]
    size = np.where(part < 0.5, 50.0, np.where(part < 0.75, 35.0, 20.0))
    return time, 50.0 - size * np.cos(2.0 * np.pi * 2.5 * time)


def played(time: Floats, drive: Floats) -> Floats:
    """Return where the gears of the stored model ``creep`` alone go: 0 to 5.12 um, no memory of time."""
    values = values_of("creep")
    del values["stages"][0]["relaxation"], values["stages"][1]
    Path("gears.json").write_text(json.dumps(values))
    write("played.csv", "time_s,voltage_V", time, drive)
    moved = table(done("simulate", "gears.json", "played.csv", "-q"))["displacement_um"]
    Path("played.csv").unlink()
    Path("gears.json").unlink()
    return moved


def moved_log(name: str, noise: float = 0.002) -> Path:
    """Write a log of those gears, with noise of a sensor (um)."""
    time, drive = swings()
    error = np.random.default_rng(4).normal(0.0, noise, len(time))
    return write(name, LOG, time, drive, played(time, drive) + error)


# --- the sample log ---


def test_the_sample_is_followed_within_a_hundredth_of_a_percent(
    sample_model: Path,
) -> None:
    """Sensor noise is 5 nm, the range 12 um; a straight line leaves 0.6 um."""
    fit = json.loads(sample_model.read_text())["fit"]
    assert fit["sign"] == "rising"
    assert 0.003 < fit["rmse"] < 0.012
    seen = np.hypot(fit["expected_rmse"], fit["noise_rms"])  # by this sensor
    assert fit["rmse"] < seen < 0.06
    assert fit["line_rmse"] > 0.3


def test_the_sample_s_bench_follows_the_drive(sample_model: Path) -> None:
    """Compensated on the bench that is no DBO, from rest at 0 V: what is stated comes, noise beside it."""
    from virtual_actuator import VirtualActuator

    noise = json.loads(sample_model.read_text())["fit"]["noise_rms"]
    words = (sample_model, SAMPLES / "trajectory.csv", "--from", 0, "-q")
    stated = []
    for state in ("empty", "auto"):
        outputs = ("-o", "drive.csv", "--summary", "summary.json")
        done("compensate", *words, "--state", state, *outputs)
        drive = table("drive.csv")
        came = VirtualActuator().play(drive["time_s"], drive["voltage_V"], 2)
        error = rms(came - drive["desired_um"])
        assert error < 0.05
        stated.append(json.loads(Path("summary.json").read_text())["expected_rmse"])
    assert 0.8 < error / np.hypot(stated[0], noise) < 1.2
    assert stated[1] > 2.0 * stated[0]  # where the past is unknown


def test_the_sample_s_model_fits_the_schema_and_knows_lag_and_range(
    sample_model: Path,
) -> None:
    values = json.loads(sample_model.read_text())
    schema = json.loads(SCHEMA.read_text())
    for found in (values, done("invert", sample_model).json):
        assert jsonschema.Draft202012Validator(schema).is_valid(found)
    assert set(values["fit"]) <= set(Fit.__annotations__)
    assert values["input"]["min"] == pytest.approx(0.0, abs=0.5)
    assert values["input"]["max"] == pytest.approx(100.0, abs=0.5)
    assert values["output"]["unit"] == "um"
    gears = next(one for one in values["stages"] if one["type"] == "backlash")
    assert gears["relaxation"]["tau"]


def test_candidates_and_origin_travel_with_the_model(sample_model: Path) -> None:
    values = json.loads(sample_model.read_text())
    candidates = values["candidates"]
    assert 1 <= len(candidates) <= 5
    assert sum(one["weight"] for one in candidates) == pytest.approx(1.0, abs=1e-6)
    origin = json.dumps(values["provenance"])
    assert "identification.csv" in origin
    assert "/" not in origin.replace("um/V", "")


# --- small logs ---


def test_a_log_of_gears_is_followed_to_its_noise() -> None:
    fit = identified(moved_log("log.csv"), "--relaxation", 0, "--delay", 0)["fit"]
    assert fit["rmse"] < 0.03 and fit["line_rmse"] > 0.2


def test_a_falling_actuator() -> None:
    time, drive = swings()
    moved = played(time, drive)
    write("log.csv", LOG, time, drive, 6.0 - moved)
    values = identified("log.csv", *QUICK)
    assert values["fit"]["sign"] == "falling"
    write("ends.csv", "voltage_V", [0.0, 100.0])
    came = table(done("simulate", "model.json", "ends.csv"))["displacement_um"]
    np.testing.assert_allclose(came, [6.0, 6.0 - 5.144], atol=0.05)


@pytest.mark.parametrize(("sign", "code"), [("rising", 0), ("falling", 3)])
def test_the_other_sign_is_refused(sign: str, code: int) -> None:
    words = ("identify", moved_log("log.csv"), *QUICK, "--sign", sign, "-o", "m.json")
    outcome = dbo(*words)
    assert outcome.code == code
    assert Path("m.json").exists() == (code == 0)


def test_a_delay_is_found() -> None:
    time, drive = swings(1200)
    late = np.interp(time - 0.006, time, drive)
    write("log.csv", LOG, time, drive, played(time, late))
    stages = identified("log.csv", "--relaxation", 0, "--dynamics", 0)["stages"]
    delays = [one["seconds"] for one in stages if one["type"] == "delay"]
    assert delays and abs(delays[0] - 0.006) < 0.001


def test_a_delay_that_is_typed_is_taken() -> None:
    words = [*QUICK[:4], "--delay", 0.004, "--relaxation", 0, "--dynamics", 0]
    stages = identified(moved_log("log.csv"), *words, "--force")["stages"]
    assert [one["seconds"] for one in stages if one["type"] == "delay"] == [0.004]


def test_a_sensor_s_delay_is_taken_off() -> None:
    time, drive = swings()
    moved = played(time, drive)
    write("log.csv", LOG, time, drive, np.interp(time - 0.004, time, moved))
    words = ("--sensor-delay", 0.004, *QUICK)
    with_it = identified("log.csv", *words)["fit"]["rmse"]
    without = identified("log.csv", *QUICK, "--force")["fit"]["rmse"]
    assert with_it < without


def test_gears_and_points_that_are_typed() -> None:
    words = ("--points", 6, "--gears", 64, *QUICK[4:], "--force")
    stages = identified(moved_log("log.csv"), *words)["stages"]
    assert done("show", "model.json", "--format", "json").json["gears"] == 64
    points = [one for one in stages if one["type"] == "point"]
    assert len(points) == 1


def test_time_constants_that_are_typed() -> None:
    words = ("--relaxation", "0.01,300ms", *QUICK[:6])
    stages = identified(creep_log("log.csv"), *words)["stages"]
    gears = next(one for one in stages if one["type"] == "backlash")
    assert gears["relaxation"]["tau"] == pytest.approx([0.01, 0.3])


def test_a_model_with_memory_is_better_where_there_is_creep() -> None:
    log = creep_log("log.csv")
    plain = identified(log, *QUICK, "--force")["fit"]["rmse"]
    timed = identified(log, *QUICK[:6], "--relaxation", "0.01,0.3")["fit"]["rmse"]
    assert timed < 0.8 * plain


def test_several_logs_are_fitted_together() -> None:
    first, second = creep_log("a.csv"), creep_log("b.csv", seed=2)
    values = identified(first, second, *QUICK, "--force")
    origin = json.dumps(values["provenance"])
    assert "a.csv" in origin and "b.csv" in origin
    assert [one["name"] for one in values["fit"]["logs"]] == ["a.csv", "b.csv"]


def test_another_log_judges() -> None:
    log, other = creep_log("a.csv"), creep_log("b.csv", seed=2)
    words = (*QUICK[:6], "--relaxation", "0.01,0.3", "--validate", other)
    found = identified(log, *words)["fit"]["validation"]
    assert found[0]["name"] == "b.csv" and 0.001 < found[0]["rmse"] < 0.1


@pytest.mark.parametrize(("zero", "shift"), [("first", 1.0), ("2.5", 2.5)])
def test_zero(zero: str, shift: float) -> None:
    """What the displacement counts from; 1 um stood at 0 V."""
    time, drive = swings()
    write("log.csv", LOG, time, drive, 1.0 + played(time, drive))
    identified("log.csv", *QUICK, "--zero", zero, "--force")
    write("ends.csv", "voltage_V", [0.0])
    came = table(done("simulate", "model.json", "ends.csv"))["displacement_um"]
    assert came[0] == pytest.approx(1.0 - shift, abs=0.05)


def test_skip_leaves_out_the_beginning() -> None:
    log = moved_log("log.csv")
    lines = log.read_text().splitlines()
    for row in range(1, 60):
        cells = lines[row].split(",")
        lines[row] = ",".join([*cells[:2], "50"])
    log.write_text("\n".join(lines) + "\n")
    fit = identified(log, *QUICK, "--skip", 0.2)["fit"]
    assert fit["rmse"] < 0.1
    assert fit["logs"][0]["rows"] == 1200 - 100


def test_a_prior_is_rescaled_from_a_short_log() -> None:
    """The shape is kept; gain and offset come from half a second."""
    log = creep_log("log.csv")
    values = table(log)
    some = slice(0, 500)
    scaled = 1.2 * values["displacement_um"] - 0.5
    write(
        "short.csv",
        LOG,
        values["time_s"][some],
        values["voltage_V"][some],
        scaled[some],
    )
    written = identified("short.csv", "--prior", model("creep"))
    assert "candidates" not in written
    write("all.csv", "time_s,voltage_V", values["time_s"], values["voltage_V"])
    came = table(done("simulate", "model.json", "all.csv"))["displacement_um"]
    assert rms(came - scaled) < 0.06


def test_the_method_of_the_paper() -> None:
    words = ("--method", "paper", "--gears", 25, "--zero", "mean", "--rows", "401:800")
    stages = identified(creep_log("log.csv"), *words, "--force")["stages"]
    gears = next(one for one in stages if one["type"] == "backlash")
    assert done("show", "model.json", "--format", "json").json["gears"] == 25
    assert gears["x0"] == pytest.approx(0.0, abs=5.0)


def test_spikes_do_not_spoil_a_model() -> None:
    log = moved_log("log.csv")
    clean = identified(log, *QUICK)["fit"]["rmse"]
    values = table(log)
    for row in (300, 555, 901):
        values["displacement_um"][row] += 30.0
    write("log.csv", LOG, *values.values())
    assert identified("log.csv", *QUICK)["fit"]["rmse"] < 1.3 * clean


def test_the_sample_period_of_several_logs_is_the_shortest(log: Path) -> None:
    columns = table(log)
    thinned = [values[::2] for values in columns.values()]
    write("slow.csv", "time_s,voltage_V,displacement_um", *thinned)
    for names in (("log.csv", "slow.csv"), ("slow.csv", "log.csv")):
        outputs = ("-o", "m.json", "--summary", "s.json", "-q")
        done("identify", *names, *QUICK, *outputs)
        stated = json.loads(Path("s.json").read_text())["sample_period"]
        assert stated == pytest.approx(0.002, rel=1e-9)


# --- refusals ---


def test_a_line_is_refused_and_force_keeps_it() -> None:
    """Noise instead of a displacement: no better than a straight line."""
    time, drive = swings()
    noise = np.random.default_rng(6).normal(0.0, 1.0, len(time))
    write("log.csv", LOG, time, drive, noise)
    error = refused(1, "identify", "log.csv", *QUICK, "-o", "model.json")
    assert "--force" in error
    assert dbo("identify", "log.csv", *QUICK, "--force", "-o", "m.json").code == 0


REFUSED: dict[str, tuple[Floats, Floats]] = {
    "a drive that stands still": (np.full(500, 5.0), np.linspace(0.0, 1.0, 500)),
    "a displacement that stands still": (
        5.0 + 5.0 * np.sin(np.arange(500) / 20.0),
        np.full(500, 3.0),
    ),
    "a drive that only rises": (
        np.linspace(0.0, 10.0, 500),
        np.linspace(0.0, 1.0, 500),
    ),
    "a few rows": (np.arange(9.0) % 4, np.arange(9.0) % 4),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_log_that_shows_nothing_is_refused(case: str) -> None:
    drive, moved = REFUSED[case]
    write("log.csv", LOG, np.arange(len(drive)) / 500.0, drive, moved)
    error = refused(1, "identify", "log.csv", "-o", "model.json")
    assert "log.csv" in error


def test_logs_of_different_units_are_not_mixed() -> None:
    first = moved_log("a.csv")
    text = first.read_text().replace("displacement_um", "displacement_mrad")
    Path("b.csv").write_text(text)
    words = ("--displacement", "3", *QUICK)
    error = refused(1, "identify", first, "b.csv", *words, "-o", "model.json")
    assert "um" in error and "mrad" in error


def test_a_model_is_no_log() -> None:
    assert "small.json" in refused(1, "identify", model("small"), "-o", "model.json")


# --- what is said and written ---


def test_what_to_expect_is_said() -> None:
    outcome = done("identify", moved_log("log.csv"), *QUICK, "-o", "model.json")
    last = outcome.said[-1]
    assert "model.json" in last and "expected error" in last and "um" in last
    assert "rising" in outcome.said[0]


def test_a_summary_of_the_fit() -> None:
    log = moved_log("log.csv")
    done("identify", log, *QUICK, "-o", "model.json", "--summary", "summary.json", "-q")
    told = json.loads(Path("summary.json").read_text())
    assert (told["format"], told["version"], told["unit"]) == ("dbo-summary", 1, "um")
    fit = json.loads(Path("model.json").read_text())["fit"]
    assert told["rmse"] == fit["rmse"] and told["expected_rmse"] == fit["expected_rmse"]


def test_one_amplitude_is_warned_of() -> None:
    time = np.arange(1500) / 500.0
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * 2.0 * time)
    moved = played(time, drive)
    noise = np.random.default_rng(3).normal(0.0, 0.01, len(time))
    write("log.csv", LOG, time, drive, moved + noise)
    outcome = done("identify", "log.csv", *QUICK, "--force", "-o", "model.json")
    assert any("amplitude" in line for line in outcome.warnings)


def test_other_units_and_quantities() -> None:
    values = table(moved_log("log.csv"))
    head = "time_s,pressure_bar,angle_mrad"
    write("muscle.csv", head, *values.values())
    words = ("--voltage", "pressure_bar", "--displacement", "angle_mrad")
    found = identified("muscle.csv", *words, *QUICK)
    assert (found["input"]["quantity"], found["input"]["unit"]) == ("pressure", "bar")
    assert found["output"]["unit"] == "mrad"


def test_nanometres_are_the_same_model_in_another_unit() -> None:
    values = table(moved_log("log.csv"))
    micro = identified("log.csv", *QUICK)
    nano = 1000.0 * values["displacement_um"]
    head = "time_s,voltage_V,displacement_nm"
    write("log.csv", head, values["time_s"], values["voltage_V"], nano)
    found = identified("log.csv", *QUICK)
    assert found["output"]["unit"] == "nm"
    ratio = found["fit"]["rmse"] / micro["fit"]["rmse"]
    assert ratio == pytest.approx(1000.0, rel=1e-3)
