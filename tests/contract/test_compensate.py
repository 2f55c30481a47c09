"""``dbo compensate``: the drive of a move, what stands before and behind it, and what to expect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import dbo_cli

from .program import Floats, dbo, done, model, refused, rms, table, values_of, write

TIME = np.arange(400) / 1000.0
pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")


def sine(top: float, low: float = 2.0) -> Floats:
    """Return two swings between ``low`` and ``top`` um, from rest at ``low``."""
    return low + 0.5 * (top - low) * (1.0 - np.cos(2.0 * np.pi * 5.0 * TIME))


def move(name: str, wanted: Floats) -> Path:
    return write(name, "time_s,displacement_um", TIME, wanted)


def drive_of(
    *words: object, name: str = "small", wish: str = "wish.csv"
) -> dict[str, Floats]:
    """Return what ``compensate`` writes."""
    done("compensate", model(name), wish, *words, "-o", "drive.csv", "-q")
    return table("drive.csv")


def summary_of(*words: object, name: str = "small") -> Any:
    """Return the summary of a drive."""
    drive_of(*words, "--summary", "summary.json", name=name)
    return json.loads(Path("summary.json").read_text())


# --- what limits cut off ---


def test_what_costs_little_is_clipped_and_said() -> None:
    move("wish.csv", sine(9.1))
    outcome = done("compensate", model("small"), "wish.csv", "-o", "drive.csv")
    voltage = table("drive.csv")["voltage_V"]
    assert voltage.max() == 10.0
    clipped = int(np.sum(sine(9.1) > 9.0))
    assert any(f"{clipped}" in line and "clip" in line for line in outcome.lines)


def test_what_costs_much_is_refused_unless_asked_for() -> None:
    move("wish.csv", sine(11.0))
    words = ("compensate", model("small"), "wish.csv", "-o", "drive.csv")
    error = refused(3, *words, "--summary", "s.json")
    lost = rms(np.maximum(sine(11.0) - 9.0, 0.0))
    assert f"{lost:.3g}" in error and "--on-limit" in error
    assert done(*words, "--on-limit", "clip").code == 0
    assert table("drive.csv")["voltage_V"].max() == 10.0


def test_error_refuses_whatever_it_costs() -> None:
    move("wish.csv", sine(9.001))
    words = ("compensate", model("small"), "wish.csv", "-o", "drive.csv")
    refused(3, *words, "--on-limit", "error")
    assert done(*words).code == 0


def test_to_stdout_auto_clips_and_says_so() -> None:
    """Rows already sent cannot be taken back."""
    wish = move("wish.csv", sine(11.0)).read_bytes()
    outcome = done("compensate", model("small"), "-", stdin=wish)
    assert table(outcome)["voltage_V"].max() == 10.0
    assert any("clip" in line for line in outcome.warnings)


def test_extrapolate_leaves_the_identified_range_as_far_as_typed() -> None:
    move("wish.csv", sine(9.5))
    voltage = drive_of("--v-max", 12, "--on-limit", "clip")["voltage_V"]
    assert voltage.max() == 10.0
    voltage = drive_of("--v-max", 12, "--extrapolate")["voltage_V"]
    assert 10.0 < voltage.max() < 12.0


def test_a_slew_limit_holds_for_every_step() -> None:
    move("wish.csv", sine(8.0))
    free = drive_of()["voltage_V"]
    slew = 0.5 * np.abs(np.diff(free)).max() * 1000.0
    words = ("--max-slew", slew, "--on-limit", "clip")
    limited = drive_of(*words)["voltage_V"]
    assert np.abs(np.diff(limited)).max() <= slew / 1000.0 * (1.0 + 1e-12)
    assert not np.array_equal(limited, free)


def test_limits_take_units() -> None:
    move("wish.csv", sine(8.0))
    same = {
        "--v-max 8V": "--v-max 8",
        "--v-max 8000mV": "--v-max 8",
        "--v-max 0.008kV": "--v-max 8",
        "--max-slew 0.05V/ms": "--max-slew 50",
        "--max-slew 50V/s": "--max-slew 50",
    }
    for typed, plain in same.items():
        first = drive_of(*typed.split(), "--on-limit", "clip")
        second = drive_of(*plain.split(), "--on-limit", "clip")
        assert np.array_equal(first["voltage_V"], second["voltage_V"]), typed
    for wrong in ("--v-max 8um", "--v-max 8V/s", "--max-slew 5Hz", "--v-max nan"):
        words = wrong.split()
        assert words[0] in refused(2, "compensate", model("small"), "wish.csv", *words)


def test_another_unit_of_displacement_is_converted() -> None:
    move("wish.csv", sine(8.0))
    write("nm.csv", "time_s,displacement_nm", TIME, 1000.0 * sine(8.0))
    first, second = drive_of(), drive_of(wish="nm.csv")
    assert "desired_um" in second
    np.testing.assert_allclose(second["voltage_V"], first["voltage_V"], atol=1e-9)


# --- before and behind the move ---


def test_an_approach_leads_from_where_the_amplifier_stands() -> None:
    move("wish.csv", sine(8.0, 3.0))
    words = ("--from", 0, "--approach", 0.2)
    written = drive_of(*words)
    time, voltage = written["time_s"], written["voltage_V"]
    before = time < -1e-9
    assert abs(before.sum() - 200) <= 1
    assert abs(voltage[0]) < 0.5
    assert np.abs(np.diff(voltage)).max() < 0.5
    np.testing.assert_allclose(time[~before], TIME, atol=1e-12)
    np.testing.assert_allclose(
        written["desired_um"][~before], sine(8.0, 3.0), atol=1e-12
    )


def test_without_an_approach_a_step_beyond_the_slew_limit_is_not_taken() -> None:
    """The first row is held within the slew of where the amplifier stands, or the move is refused."""
    move("wish.csv", sine(8.0, 3.0))
    words = ("--from", 0, "--max-slew", 400, "-o", "drive.csv")
    outcome = dbo(
        "compensate", model("small"), "wish.csv", *words, "--on-limit", "clip"
    )
    assert outcome.code in (0, 3)
    if outcome.code == 0:
        assert table("drive.csv")["voltage_V"][0] <= 0.4 * (1.0 + 1e-9)


@pytest.mark.parametrize("name", ["small", "creep"])
def test_condition_sweeps_the_range_first(name: str) -> None:
    values = values_of(name)
    low, high = values["input"]["min"], values["input"]["max"]
    top = values["output"]["max"]
    move("wish.csv", sine(0.8 * top, 0.4 * top))
    written = drive_of("--condition", name=name)
    before = written["time_s"] < -1e-9
    sweep = written["voltage_V"][before]
    assert sweep.min() < low + 0.05 * (high - low)
    assert sweep.max() > high - 0.05 * (high - low)
    join = int(before.sum())
    steps = np.abs(np.diff(written["voltage_V"]))
    assert steps[join - 3 : join + 3].max() <= steps.max() * (1.0 + 1e-9)
    came = table(done("simulate", model(name), "drive.csv", "--state", "full"))
    error = came["displacement_um"][~before] - written["desired_um"][~before]
    assert np.abs(error[1:]).max() < 0.02 * top


def test_condition_makes_the_past_known() -> None:
    """From any start the conditioned move ends up the same, to the last digits."""
    move("wish.csv", sine(7.0, 4.0))
    drive_of("--condition")
    came = []
    for state in ("empty", "full", "settled"):
        written = table(done("simulate", model("small"), "drive.csv", "--state", state))
        came.append(written["displacement_um"][-len(TIME) :])
    np.testing.assert_allclose(came[1], came[0], atol=1e-9)
    np.testing.assert_allclose(came[2], came[0], atol=1e-9)


def test_a_first_row_far_from_where_the_amplifier_stands_is_said() -> None:
    move("wish.csv", sine(7.0, 4.0))
    words = ("compensate", model("small"), "wish.csv", "--from", 0, "-o", "drive.csv")
    assert "add --approach auto" in done(*words).err
    assert "warning" not in done(*words, "--approach", "auto").err


def test_return_ends_at_a_voltage() -> None:
    move("wish.csv", sine(8.0, 3.0))
    written = drive_of("--return", 1.5, "--max-slew", 400, "--on-limit", "clip")
    voltage, time = written["voltage_V"], written["time_s"]
    assert voltage[-1] == pytest.approx(1.5, abs=1e-9)
    assert time[-1] > TIME[-1]
    assert np.abs(np.diff(voltage)).max() <= 0.4 * (1.0 + 1e-9)


def test_the_way_in_may_use_the_rating() -> None:
    """From 0 V into a model of 0.236 to 3.424 V: the move's rows keep the identified range."""
    values = values_of("small")
    values["input"] |= {"min": 0.236, "max": 3.424}
    values["stages"][0] |= {"x0": 0.236, "dx": [0.797] * 4}
    Path("narrow.json").write_text(json.dumps(values))
    move("wish.csv", sine(8.0))
    words = ("--from", 0, "--v-min", 0, "--v-max", 5, "--approach", 0.1)
    done("compensate", "narrow.json", "wish.csv", *words, "-o", "drive.csv")
    written = table("drive.csv")
    lead = written["time_s"] < -1e-9
    assert written["voltage_V"][lead].min() < 0.236
    assert written["voltage_V"][~lead].min() >= 0.236


@pytest.mark.parametrize("name", ["moving", "late"])
def test_a_lead_is_never_long(name: str) -> None:
    move("wish.csv", sine(4.0, 1.5))
    words = ("--lead", "auto", "--condition", "--from", 0, "--approach", "auto")
    written = drive_of(*words, name=name)
    assert written["time_s"][0] < 0.0
    assert -written["time_s"][0] <= 60.0


# --- dynamics and delay ---


@pytest.mark.parametrize("name", ["moving", "late"])
def test_delay_and_dynamics_are_undone(name: str) -> None:
    move("wish.csv", sine(4.0, 1.5))
    drive_of("--lead", "auto", name=name)
    written, drive = (
        table(done("simulate", model(name), "drive.csv")),
        table("drive.csv"),
    )
    middle = (drive["time_s"] > 0.02) & (drive["time_s"] < 0.38)
    error = written["displacement_um"] - drive["desired_um"]
    assert rms(error[middle]) < 0.002 * 2.5


def test_an_uneven_clock_is_refused_for_dynamics() -> None:
    time = TIME + 0.0003 * np.sin(np.arange(400))
    write("wish.csv", "time_s,displacement_um", time, sine(4.0, 1.5))
    error = refused(1, "compensate", model("moving"), "wish.csv", "-o", "drive.csv")
    assert "--resample" in error


def test_a_resonance_near_half_the_rate_is_refused() -> None:
    values = values_of("moving")
    values["stages"][1]["sections"][1]["frequency"] = 310.0
    Path("fast.json").write_text(json.dumps(values))
    move("wish.csv", sine(4.0, 1.5))
    assert "310" in refused(1, "compensate", "fast.json", "wish.csv", "-o", "drive.csv")


@pytest.mark.parametrize("name", ["creep", "moving"])
def test_a_long_file_gives_what_one_array_gives(name: str) -> None:
    """Block by block through the shell, whole in the library: the same voltages to rounding."""
    time = np.arange(80_000) / 1000.0
    wanted = 2.5 + np.sin(3.0 * time) * np.cos(0.7 * time)
    write("wish.csv", "time_s,displacement_um", time, wanted)
    words = ("--on-limit", "clip", "--max-slew", 300)
    written = drive_of(*words, name=name)["voltage_V"]
    whole = dbo_cli.read_model(model(name)).compensate(
        wanted, time=time, on_limit="clip", max_slew=300.0
    )
    np.testing.assert_allclose(written, whole, rtol=0, atol=1e-9)


# --- loops and learning ---


@pytest.mark.parametrize("name", ["creep", "moving", "late"])
def test_a_periodic_drive_closes(name: str) -> None:
    """Played again and again, the settled drive of a loop brings the wish in every pass."""
    top = values_of(name)["output"]["max"]
    phase = 2.0 * np.pi * np.arange(400) / 400
    wanted = 0.5 * top + 0.25 * top * np.sin(2.0 * phase)
    move("wish.csv", wanted)
    written = drive_of("--periodic", name=name)
    loop = written["voltage_V"][-400:]
    time = np.arange(400 * 12) / 1000.0
    write("played.csv", "time_s,voltage_V", time, np.tile(loop, 12))
    came = table(done("simulate", model(name), "played.csv"))["displacement_um"]
    last, one_before = came[-400:], came[-800:-400]
    assert np.abs(last - one_before).max() < 1e-3 * top
    assert rms(last - last.mean() - (wanted - wanted.mean())) < 2e-3 * top


def test_passes_come_before_the_settled_one() -> None:
    phase = 2.0 * np.pi * np.arange(400) / 400
    wanted = 2.5 + np.sin(phase)
    move("wish.csv", wanted)
    one = drive_of("--periodic", name="creep")
    three = drive_of("--periodic", "--passes", 2, name="creep")
    assert len(three["time_s"]) - len(one["time_s"]) in (400, 800)
    came = table(done("simulate", model("creep"), "drive.csv"))["displacement_um"]
    assert rms(came[-400:] - wanted) < 0.01


def test_an_option_without_its_partner_is_refused() -> None:
    move("wish.csv", np.linspace(3.0, 7.0, 400))
    for option in ("--passes 2", "--voltage 2", "--measured 2", "--history h.json"):
        words = (*option.split(), "-o", "d.csv")
        refused(2, "compensate", model("small"), "wish.csv", *words)
    Path("h.json").write_bytes(bytes(range(128, 256)))
    done("compensate", model("small"), "wish.csv", "-o", "drive.csv", "-q")
    done("simulate", model("small"), "drive.csv", "-o", "came.csv", "-q")
    words = ("--tracked", "came.csv", "--history", "h.json", "-o", "d.csv")
    assert "h.json" in refused(1, "compensate", model("small"), "wish.csv", *words)


def test_a_loop_that_does_not_close_is_refused() -> None:
    move("wish.csv", np.linspace(3.0, 7.0, 400))
    outcome = dbo("compensate", model("small"), "wish.csv", "--periodic", "-o", "d.csv")
    assert outcome.code in (1, 3) and "period" in outcome.lines[-1]


@pytest.fixture
def wrong_model() -> Path:
    """Return a model whose displacement is 5 % more than that of the stored model ``creep``."""
    values = values_of("creep")
    values["stages"][1]["dy"] = [1.05 * dy for dy in values["stages"][1]["dy"]]
    values["output"]["max"] = sum(values["stages"][1]["dy"])
    path = Path("wrong.json")
    path.write_text(json.dumps(values))
    return path


def test_learning_brings_the_error_down(wrong_model: Path) -> None:
    """Three passes on an actuator that is not the model; the history keeps each error."""
    move("wish.csv", sine(4.0, 1.5))
    done("compensate", wrong_model, "wish.csv", "-o", "drive.csv", "-q")
    errors = []
    for _ in range(3):
        done("simulate", model("creep"), "drive.csv", "-o", "came.csv", "-q")
        played, came = table("drive.csv"), table("came.csv")
        error = came["displacement_um"] - played["desired_um"]
        errors.append(rms(error - error.mean()))
        tracked = ("--tracked", "came.csv", "--history", "passes.json")
        done("compensate", wrong_model, "wish.csv", *tracked, "-o", "drive.csv", "-q")
    assert errors[2] < 0.3 * errors[0]
    history = json.loads(Path("passes.json").read_text())
    assert "rmse" in json.dumps(history)


def test_bandwidth_rounds_the_corners() -> None:
    corners = np.interp(TIME, [0.0, 0.1, 0.3, 0.4], [2.0, 2.0, 7.0, 7.0])
    move("wish.csv", corners)
    sharp = drive_of()["voltage_V"]
    round_ = drive_of("--bandwidth", 20)["voltage_V"]
    bend = [np.abs(np.diff(one, 2)).max() for one in (sharp, round_)]
    assert bend[1] < bend[0]


def test_resample_writes_at_the_rate_of_the_card() -> None:
    move("wish.csv", sine(8.0))
    written = drive_of("--resample", "2kHz")
    np.testing.assert_allclose(np.diff(written["time_s"]), 0.0005, rtol=1e-9)
    assert len(written["time_s"]) == 799


# --- what is said of it ---


SUMMARY = (
    "format version model unit rows voltage_range move_range limits lead clipped lost_rms lost_most "
    "expected_rmse expected_rmse_past_known past_known warnings"
).split()


def test_a_summary_is_of_this_drive() -> None:
    """Figures as the written rows have them, limits as typed, and the model by its name."""
    wanted = sine(9.5)
    move("wish.csv", wanted)
    limits = ("--v-min", -1, "--v-max", 12, "--max-slew", 5000, "--on-limit", "clip")
    told = summary_of(*limits, "--from", -0.5, "--approach", 0.1)
    assert set(SUMMARY) <= set(told)
    assert (told["format"], told["version"], told["unit"]) == ("dbo-summary", 1, "um")
    drive = table("drive.csv")
    voltage, before = drive["voltage_V"], drive["time_s"] < -1e-9
    assert told["rows"] == len(voltage)
    assert told["voltage_range"] == [voltage.min(), voltage.max()]
    assert told["move_range"] == pytest.approx([2.0, 9.5], abs=1e-3)
    assert told["lead"]["rows"] == before.sum() > 90
    assert told["lead"]["seconds"] == pytest.approx(before.sum() / 1000.0)
    assert told["limits"]["rating"] == [-1.0, 12.0]
    assert told["limits"]["move"] == told["limits"]["identified"] == [0.0, 10.0]
    assert told["limits"]["max_slew"] == 5000.0
    came = table(done("simulate", model("small"), "drive.csv", "--state", "empty"))
    lost = (wanted - came["displacement_um"][~before])[1:]
    assert told["lost_rms"] == pytest.approx(np.sqrt(np.sum(lost**2) / 400), rel=1e-6)
    assert told["lost_most"] == pytest.approx(lost.max(), rel=1e-9)
    assert told["clipped"] == np.sum(lost > 1e-9)
    assert any(f"{told['clipped']} of 400 rows" in text for text in told["warnings"])
    assert len(told["model"]) == 64 and told["expected_rmse"] is None


def simulated(drive: dict[str, Floats], stages: Any, state: str = "auto") -> Floats:
    """Return what other stages of the stored model ``known`` make of a drive."""
    values = values_of("known") | {"stages": stages, "candidates": []}
    Path("other.json").write_text(json.dumps(values))
    other = dbo_cli.read_model("other.json")
    return other.simulate(drive["voltage_V"], time=drive["time_s"], state=state)


def test_a_summary_states_what_to_expect() -> None:
    """Left out, the spread of candidates and, for an unknown past, that of the starts (theory, 7)."""
    move("wish.csv", sine(4.0, 1.5))
    unknown = summary_of(name="known")
    drive, stored = table("drive.csv"), values_of("known")
    came = simulated(drive, stored["stages"])
    square = stored["fit"]["left_out_rmse"] ** 2
    for candidate in stored["candidates"]:
        spread = simulated(drive, candidate["stages"]) - came
        square += candidate["weight"] * rms(spread) ** 2
    assert unknown["expected_rmse_past_known"] == pytest.approx(square**0.5, rel=1e-6)
    for start in ("empty", "full", "settled"):
        square += rms(simulated(drive, stored["stages"], start) - came) ** 2 / 3.0
    assert unknown["expected_rmse"] > square**0.5  # and what memories may hold
    known = summary_of("--condition", name="known")
    assert (unknown["past_known"], known["past_known"]) == (False, True)
    assert 0.0 < known["expected_rmse"] < unknown["expected_rmse"]
    assert unknown["expected_rmse_past_known"] < unknown["expected_rmse"]


def test_hdf5_holds_units_model_and_limits() -> None:
    move("wish.csv", sine(8.0))
    done("compensate", model("small"), "wish.csv", "--v-max", 9.5, "-o", "drive.h5")
    with h5py.File("drive.h5") as file:
        assert set(file) == {"time", "desired", "voltage"}
        assert file["voltage"].attrs["units"] == "V"
        assert file["desired"].attrs["units"] == "um"
        attributes = {key: str(value) for key, value in file.attrs.items()}
        stored = file["voltage"][:]
    assert "9.5" in json.dumps(attributes)
    np.testing.assert_array_equal(stored, drive_of("--v-max", 9.5)["voltage_V"])


def test_a_saved_state_joins_two_moves() -> None:
    first, second = TIME[:200], TIME[200:]
    wanted = sine(4.0, 1.5)
    write("first.csv", "time_s,displacement_um", first, wanted[:200])
    write("second.csv", "time_s,displacement_um", second, wanted[200:])
    move("wish.csv", wanted)
    whole = drive_of(name="creep")["voltage_V"]
    one = drive_of("--save-state", "s.json", name="creep", wish="first.csv")
    two = drive_of("--state", "s.json", name="creep", wish="second.csv")
    joined = np.concatenate([one["voltage_V"], two["voltage_V"]])
    np.testing.assert_allclose(joined, whole, atol=1e-9)
