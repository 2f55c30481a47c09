"""``dbo report``: what is compared, in which form, and bounds that end a script."""

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

from .program import (
    DRIVE, LOG, MOVE, PAIR, dbo, done, load, model, refused, rms, simulated, store, table, write,
)  # fmt: skip

TIME = np.arange(600) / 500.0
SUMMARY = {"format": "dbo-summary", "version": 1, "unit": "um", "expected_rmse": 0.01}
WANTED = 5.0 + 3.0 * np.sin(2.0 * np.pi * 2.0 * TIME)


def noise(size, seed=1):
    return np.random.default_rng(seed).normal(0.0, size, len(TIME))


@pytest.fixture(autouse=True)
def logs(folder):
    write("good.csv", PAIR, TIME, WANTED, WANTED + noise(0.01))
    write("bad.csv", PAIR, TIME, WANTED, WANTED + 0.1 + noise(0.3, seed=2))
    write("wish.csv", MOVE, TIME, WANTED)


def merits(*words):
    """Return the figures of the first log."""
    return done("report", *words, "--format", "json", "-q").json["logs"][0]


# --- forms ---


def test_three_logs_side_by_side():
    write("best.csv", PAIR, TIME, WANTED, WANTED + noise(0.005))
    words = ("report", "bad.csv", "good.csv", "best.csv", "--format", "json")
    bad, good, best = done(*words).json["logs"]
    assert best["ratio_to_first"] == pytest.approx(best["rmse"] / bad["rmse"])
    assert (bad["name"], good["name"]) == ("bad.csv", "good.csv")
    assert bad["rmse"] == pytest.approx(rms(0.1 + noise(0.3, seed=2)), rel=1e-9)
    assert good["rmse"] == pytest.approx(rms(noise(0.01)), rel=1e-9)
    assert good["ratio_to_first"] == pytest.approx(good["rmse"] / bad["rmse"])
    assert good["nrmse_percent"] == pytest.approx(100.0 * good["rmse"] / 6.0, rel=1e-3)


def test_text_is_aligned_and_csv_is_a_line_a_log():
    page = done("report", "bad.csv", "good.csv").out
    assert "bad.csv" in page and "good.csv" in page
    assert "0.01" in page and "um" in page
    assert max(map(len, page.splitlines())) <= 120
    text = done("report", "bad.csv", "good.csv", "--format", "csv").out
    bad, good = csv.DictReader(io.StringIO(text))
    assert repr(merits("good.csv")["rmse"]) in good.values()
    assert repr(merits("bad.csv")["rmse"]) in bad.values()


def test_the_form_follows_the_name(unpainted):
    starts = {"r.json": "{", "r.html": "<!", "r.csv": "", "r.txt": ""}
    for name, start in starts.items():
        done("report", "good.csv", "-o", name)
        text = Path(name).read_text()
        assert text.startswith(start) and "good.csv" in text
    assert load("r.json")["format"] == "dbo-report"


def test_a_page_reaches_for_no_network_and_figures_are_png_and_svg():
    words = ("report", "bad.csv", "-o", "r.html")
    done(*words, "--figures", "figures")
    page = Path("r.html").read_text()
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page)
    assert "<svg" in page or "data:image" in page
    assert "viewport" in page and "prefers-color-scheme" in page
    assert "dbo report bad.csv" in page
    drawn = {path.name: path.read_bytes() for path in Path("figures").iterdir()}
    stems = {Path(name).stem for name in drawn}
    assert len(stems) >= 3
    assert set(drawn) == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
    for name, content in drawn.items():
        assert content.startswith(b"\x89PNG" if name.endswith("png") else b"<?xml")


@pytest.mark.parametrize(
    ("bound", "code"),
    [
        ("--max-rmse 0.5", 0),
        ("--max-rmse 0.2", 3),
        ("--max-rmse 200nm", 3),
        ("--max-rmse 0.001mm", 0),
        ("--max-nrmse-percent 10", 0),
        ("--max-nrmse-percent 5", 3),
    ],
)
def test_a_bound_that_is_missed_is_exit_3_and_the_report_is_written(bound, code):
    outcome = dbo("report", "bad.csv", *bound.split(), "-o", "r.json")
    assert outcome.code == code, outcome.err
    assert load("r.json")["passed"] is (code == 0)
    assert not code or "bad.csv" in outcome.lines[-1]


# --- rows, lag and offset ---


@pytest.mark.parametrize("late", [3, -4])
def test_a_late_sensor_is_late_in_samples_and_seconds(late):
    shifted = 5.0 + 3.0 * np.sin(2.0 * np.pi * 2.0 * (TIME - late / 500.0))
    write("late.csv", PAIR, TIME, WANTED, shifted)
    found = merits("late.csv")
    assert found["lag_left_samples"] == pytest.approx(late, abs=0.2)
    assert found["lag_left_s"] == pytest.approx(late / 500.0, abs=5e-4)
    if late > 0:
        assert merits("late.csv", "--lag", late)["rmse"] < 1e-9
        found = merits("late.csv", "--lag", late - 2)
        assert (found["lag_samples"], found["lag_s"]) == (1, pytest.approx(0.002))
        assert found["lag_left_s"] == pytest.approx(0.004, abs=5e-4)


def test_units_of_the_two_are_brought_together():
    write("nm.csv", "time_s,desired_um,measured_nm", TIME, WANTED, 1000.0 * WANTED)
    assert merits("nm.csv")["rmse"] < 1e-9


def test_a_row_without_a_number_is_refused():
    lines = Path("good.csv").read_text().splitlines()
    lines[100] = ",".join([*lines[100].split(",")[:2], "nan"])
    Path("gap.csv").write_text("\n".join(lines) + "\n")
    assert "--skip-bad" in refused(1, "report", "gap.csv")
    assert merits("gap.csv", "--skip-bad")["samples"] == 599


# --- the wish in a file of its own ---


def test_rows_of_the_way_back_are_none_of_the_move_or_it_is_told():
    words = ("--from", 0, "--approach", "auto", "--return", 0)
    write("wish.csv", MOVE, TIME, 0.5 * WANTED)
    words = (*words, "-o", "d.csv", "--summary", "s.json")
    done("compensate", model("creep"), "wish.csv", *words)
    moved = simulated("creep", "d.csv")
    write("log.csv", "time_s,measured_um", table("d.csv")["time_s"], moved)
    words = ("report", "log.csv", "--trajectory", "d.csv")
    known = done(*words, "--expected", "s.json", "--format", "json").json
    assert known["logs"][0]["samples"] == len(TIME)
    assert not any("way back" in note for note in known["notes"])
    told = done(*words, "--format", "json").json
    assert told["logs"][0]["samples"] > len(TIME)
    assert any("`expected`" in note for note in told["notes"])
    words = ("report", "log.csv", "--trajectory", "wish.csv", "--format", "json")
    plain = done(*words).json
    assert plain["logs"][0]["samples"] == len(TIME)
    assert not any("way back" in note for note in plain["notes"])


def test_the_first_row_of_the_move_counts_by_any_clock():
    words = ("--from", 0, "--approach", "auto", "-o", "d.csv")
    write("wish.csv", MOVE, TIME, 0.5 * WANTED)
    done("compensate", model("creep"), "wish.csv", *words)
    drive, moved = table("d.csv"), simulated("creep", "d.csv")
    for ahead in (0.0, 0.69, 2.07, 4.83):
        time = np.round(drive["time_s"] + ahead, 4)
        write("log.csv", LOG, time, drive["voltage_V"], moved)
        words = ("log.csv", "--measured", "displacement_um", "--trajectory", "d.csv")
        assert merits(*words)["samples"] == len(TIME), ahead


def test_a_summary_in_another_unit_is_converted_or_refused():
    words = ("good.csv", "--expected", "s.json")
    move = {"move_range": [2000.0, 8000.0], "expected_rmse": 10.0, "unit": "nm"}
    store("s.json", SUMMARY | move)
    assert merits(*words)["expected_rmse"] == pytest.approx(0.01)
    store("s.json", SUMMARY | {"unit": "V"})
    assert "V" in refused(1, "report", *words)


def test_rows_of_two_rates_are_not_matched():
    half = np.arange(300) / 250.0
    write("measured.csv", MOVE, half, np.interp(half, TIME, WANTED))
    words = ("report", "measured.csv", "--trajectory", "wish.csv")
    error = refused(1, *words, "--match", "rows")
    assert "--match" in error or "rate" in error
    assert merits(*words[1:], "--match", "time")["rmse"] < 1e-3


# --- a model in the place of the wish, and what was expected ---


def test_a_model_s_prediction_runs_from_the_first_row():
    drive = 5.0 - 5.0 * np.cos(2.0 * np.pi * 2.0 * TIME) * np.linspace(1.0, 0.5, 600)
    moved = simulated("small", write("drive.csv", DRIVE, TIME, drive))
    error = noise(0.02)
    write("log.csv", LOG, TIME, drive, moved + error)
    words = ("log.csv", "--model", model("small"))
    assert merits(*words)["rmse"] == pytest.approx(rms(error), rel=1e-9)
    some = merits(*words, "--rows", "401:500")["rmse"]
    assert some == pytest.approx(rms(error[400:500]), rel=1e-9)
    done("invert", model("small"), "-o", "inverse.json")
    assert "inver" in refused(1, "report", "log.csv", "--model", "inverse.json")
    write("wide.csv", LOG, TIME, 1.1 * drive, moved)
    assert "no error is stated" in done("report", "wide.csv", *words[1:]).out
    columns = ("log.csv", "--desired", "displacement", "--measured", "voltage")
    assert "log.csv" in refused(1, "report", *columns)  # V beside um
    for option, value in (("--state", "full"), ("--match", "rows")):
        assert option in refused(2, "report", *columns, option, value)


def test_a_column_without_a_unit_is_told_of_beside_a_model_or_a_trajectory():
    drive = 5.0 - 5.0 * np.cos(2.0 * np.pi * 2.0 * TIME)
    moved = simulated("small", write("drive.csv", DRIVE, TIME, drive))
    write("bare.csv", "time_s,voltage_V,displacement", TIME, drive, 1000.0 * moved)
    write("wish.csv", MOVE, TIME, moved)
    for option, value in (("--model", model("small")), ("--trajectory", "wish.csv")):
        words = ("report", "bare.csv", option, value)
        [warning] = done(*words, "--measured", "displacement").warnings
        assert "displacement (um assumed)" in warning and "--scale" in warning
        said = done(*words, "--scale", "measured=1nm/nm", "--measured", "displacement")
        assert not said.warnings


REFUSED = {
    "good.csv --lag 600": "--lag",
    "good.csv --figures good.csv": "good.csv",
    "late.csv --trajectory wish.csv --match time": "--match",
    "bare.csv --trajectory wish.csv --match time": "bare.csv: has no time",
    "wish.csv --trajectory bare.csv --match time": "bare.csv: has no time",
    "wish.csv": "FILE::COLUMN",
    "missing.csv": "missing.csv",
    "good.csv --desired nothing": "nothing",
    "good.csv --trajectory missing.csv": "missing.csv",
    "good.csv --model missing.json": "missing.json",
    "good.csv --expected missing.json": "missing.json",
    "good.csv --rows 601:700": "601",
    "good.csv -o no/where.html": "no/where.html",
}


def test_refusals_name_what_is_wrong(unpainted):
    write("late.csv", MOVE, TIME + 50.0, WANTED)
    write("bare.csv", "displacement_um", WANTED)
    for words, held in REFUSED.items():
        assert held in refused(1, "report", *words.split())


def test_what_was_expected_of_another_move_is_told():
    words = ("report", "good.csv", "--expected", store("s.json", SUMMARY))
    assert not done(*words).warnings
    store("s.json", {**SUMMARY, "move_range": [0.0, 20.0]})
    assert "0 to 20" in done(*words).warnings[0]


def test_an_expected_error_beside_one_without_its_mean_is_said_to_count_it():
    write("off.csv", PAIR, TIME, WANTED, WANTED + 3.0 + noise(0.1))
    words = ("report", "off.csv", "--expected", store("s.json", SUMMARY))
    removed = done(*words, "--remove-offset", "-o", "r.txt")
    assert "0.010 expected" in removed.said[0]
    assert "mean removed, which the expected error counts" in Path("r.txt").read_text()
    assert "identify again" in done(*words).warnings[0]


def test_the_column_of_a_trajectory_is_asked_for_by_the_option_to_type():
    write("seen.csv", "time_s,measured_um", TIME, WANTED)
    write("axes.csv", "time_s,desired_x_um,desired_y_um", TIME, WANTED, WANTED)
    told = refused(1, "report", "seen.csv", "--trajectory", "axes.csv")
    assert "--desired NAME" in told
    done("report", "seen.csv", "--trajectory", "axes.csv", "--desired", "desired_x_um")


@pytest.mark.parametrize("ending", ["txt", "html"])
def test_the_shell_s_pages_name_options_as_they_are_typed(ending, unpainted):
    write("off.csv", PAIR, TIME, WANTED, WANTED + 3.0)
    store("expected.json", SUMMARY)
    words = ("report", "off.csv", "--expected", "expected.json")
    done(*words, "-o", f"r.{ending}")
    page = Path(f"r.{ending}").read_text()
    assert "--sensor-delay" in page and "`sensor_delay`" not in page
