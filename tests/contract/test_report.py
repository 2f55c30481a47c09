"""``dbo report``: what is compared, in which form, and bounds that end a script."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .program import Floats, dbo, done, model, refused, rms, table, write

TIME = np.arange(600) / 500.0
WANTED = 5.0 + 3.0 * np.sin(2.0 * np.pi * 2.0 * TIME)
PAIR = "time_s,desired_um,measured_um"


def noise(size: float, seed: int = 1) -> Floats:
    return np.random.default_rng(seed).normal(0.0, size, len(TIME))


@pytest.fixture(autouse=True)
def logs(folder: Path) -> None:
    write("good.csv", PAIR, TIME, WANTED, WANTED + noise(0.01))
    write("bad.csv", PAIR, TIME, WANTED, WANTED + 0.1 + noise(0.3, seed=2))


def merits(*words: object) -> Any:
    """Return the figures of the first log."""
    return done("report", *words, "--format", "json", "-q").json["logs"][0]


def test_three_logs_side_by_side() -> None:
    write("best.csv", PAIR, TIME, WANTED, WANTED + noise(0.005))
    words = ("report", "bad.csv", "good.csv", "best.csv", "--format", "json")
    bad, good, best = done(*words).json["logs"]
    assert best["ratio_to_first"] == pytest.approx(best["rmse"] / bad["rmse"])
    assert (bad["name"], good["name"]) == ("bad.csv", "good.csv")
    assert bad["rmse"] == pytest.approx(rms(0.1 + noise(0.3, seed=2)), rel=1e-9)
    assert good["rmse"] == pytest.approx(rms(noise(0.01)), rel=1e-9)
    assert good["ratio_to_first"] == pytest.approx(good["rmse"] / bad["rmse"])
    assert good["nrmse_percent"] == pytest.approx(100.0 * good["rmse"] / 6.0, rel=1e-3)


def test_text_has_a_verdict_and_aligned_columns() -> None:
    page = done("report", "bad.csv", "good.csv").out
    assert "bad.csv" in page and "good.csv" in page
    assert "0.01" in page and "um" in page
    assert max(map(len, page.splitlines())) <= 120


def test_csv_is_a_line_a_log() -> None:
    rows = list(
        csv.DictReader(
            io.StringIO(done("report", "bad.csv", "good.csv", "--format", "csv").out)
        )
    )
    assert len(rows) == 2
    assert any(
        float(value) == merits("good.csv")["rmse"]
        for value in rows[1].values()
        if is_number(value)
    )


def is_number(text: str) -> bool:
    return re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", text) is not None


def test_the_form_follows_the_name() -> None:
    for name, start in (
        ("r.json", "{"),
        ("r.html", "<!"),
        ("r.csv", ""),
        ("r.txt", ""),
    ):
        done("report", "good.csv", "-o", name)
        text = Path(name).read_text()
        assert text.startswith(start) and "good.csv" in text
    assert json.loads(Path("r.json").read_text())["format"] == "dbo-report"


def test_a_page_reaches_for_no_network_and_holds_the_verdict() -> None:
    done("report", "bad.csv", "good.csv", "-o", "r.html")
    page = Path("r.html").read_text()
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page)
    assert "<svg" in page or "data:image" in page
    assert "viewport" in page and "prefers-color-scheme" in page
    assert "dbo report bad.csv good.csv" in page
    done("report", "bad.csv", "good.csv", "-o", "r.html")
    assert Path("r.html").read_text() == page


def test_figures_are_png_and_svg() -> None:
    done("report", "good.csv", "--figures", "figures", "-o", "r.txt")
    drawn = {path.name: path.read_bytes() for path in Path("figures").iterdir()}
    stems = {Path(name).stem for name in drawn}
    assert len(stems) >= 3
    assert set(drawn) == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
    for name, content in drawn.items():
        assert content.startswith(b"\x89PNG" if name.endswith("png") else b"<?xml")


def test_a_bound_that_is_missed_is_exit_3_and_the_report_is_written() -> None:
    codes = {
        "--max-rmse 0.5": 0,
        "--max-rmse 0.2": 3,
        "--max-rmse 200nm": 3,
        "--max-rmse 0.001mm": 0,
        "--max-nrmse-percent 10": 0,
        "--max-nrmse-percent 5": 3,
    }
    for bound, code in codes.items():
        outcome = dbo("report", "bad.csv", *bound.split(), "-o", "r.json")
        assert outcome.code == code, outcome.err
        assert json.loads(Path("r.json").read_text())["passed"] is (code == 0)
        assert not code or "bad.csv" in outcome.lines[-1]


@pytest.mark.parametrize("late", [3, -4])
def test_a_late_sensor_is_late_in_samples_and_seconds(late: int) -> None:
    shifted = 5.0 + 3.0 * np.sin(2.0 * np.pi * 2.0 * (TIME - late / 500.0))
    write("late.csv", PAIR, TIME, WANTED, shifted)
    found = merits("late.csv")
    assert found["lag_left_samples"] == pytest.approx(late, abs=0.2)
    assert found["lag_left_s"] == pytest.approx(late / 500.0, abs=5e-4)
    if late > 0:
        assert merits("late.csv", "--lag", late)["rmse"] < 1e-9


def test_rows_and_the_lag_count_rows_of_desired() -> None:
    measured = WANTED.copy()
    measured[100:] += 1.0
    write("step.csv", PAIR, TIME, WANTED, measured)
    assert merits("step.csv", "--rows", "1:100")["rmse"] == 0.0
    assert merits("step.csv", "--rows", "1:100", "--lag", 1)["samples"] == 100


def test_offset_removed() -> None:
    write("up.csv", PAIR, TIME, WANTED, WANTED + 0.25)
    found = merits("up.csv", "--remove-offset")
    assert found["rmse"] < 1e-12
    assert found["offset_removed"] == pytest.approx(0.25)
    assert merits("up.csv")["mean"] == pytest.approx(0.25)


# --- the wish in a file of its own ---


def test_a_trajectory_of_its_own() -> None:
    write("wish.csv", "time_s,displacement_um", TIME, WANTED)
    write("measured.csv", "time_s,displacement_um", TIME, WANTED + noise(0.01))
    found = merits("measured.csv", "--trajectory", "wish.csv")
    assert found["rmse"] == pytest.approx(rms(noise(0.01)), rel=1e-9)


def test_a_drive_serves_as_trajectory_and_rows_before_the_move_do_not_count() -> None:
    write("wish.csv", "time_s,displacement_um", TIME, WANTED)
    words = ("--condition", "-o", "drive.csv", "-q")
    done("compensate", model("small"), "wish.csv", *words)
    done("simulate", model("small"), "drive.csv", "-o", "measured.csv", "-q")
    found = merits("measured.csv", "--trajectory", "drive.csv")
    assert found["samples"] <= 601
    assert found["rmse"] < 0.05


@pytest.mark.parametrize("early", [0.3, 1.0])
def test_a_recorder_that_began_early_is_aligned(early: float) -> None:
    before = round(early * 500)
    moved = np.concatenate([np.full(before, WANTED[0]), WANTED + noise(0.001)])
    clock = np.arange(len(moved)) / 500.0
    write("measured.csv", "time_s,displacement_um", clock, moved)
    write("wish.csv", "time_s,displacement_um", TIME, WANTED)
    found = merits("measured.csv", "--trajectory", "wish.csv")
    assert found["rmse"] < 0.02
    assert abs(found["clock_offset_s"]) == pytest.approx(early, abs=0.002)


def test_rows_of_two_rates_are_not_matched() -> None:
    half = np.arange(300) / 250.0
    write("measured.csv", "time_s,displacement_um", half, np.interp(half, TIME, WANTED))
    write("wish.csv", "time_s,displacement_um", TIME, WANTED)
    words = ("report", "measured.csv", "--trajectory", "wish.csv")
    error = refused(1, *words, "--match", "rows")
    assert "--match" in error or "rate" in error
    assert merits(*words[1:], "--match", "time")["rmse"] < 1e-3


# --- a model in the place of the wish ---


def model_log(name: str = "log.csv") -> Floats:
    drive = 5.0 - 5.0 * np.cos(2.0 * np.pi * 2.0 * TIME) * np.linspace(1.0, 0.5, 600)
    write("drive.csv", "time_s,voltage_V", TIME, drive)
    moved = table(done("simulate", model("small"), "drive.csv", "-q"))[
        "displacement_um"
    ]
    write(name, "time_s,voltage_V,displacement_um", TIME, drive, moved + noise(0.02))
    return noise(0.02)


def test_an_option_without_its_partner_is_refused() -> None:
    model_log()
    log = ("log.csv", "--desired", "displacement", "--measured", "voltage")
    assert "--state" in refused(2, "report", *log, "--state", "full")
    assert "--match" in refused(2, "report", *log, "--match", "rows")
    assert "log.csv" in refused(1, "report", *log)  # V beside um


def test_a_model_s_prediction() -> None:
    error = model_log()
    found = merits("log.csv", "--model", model("small"))
    assert found["rmse"] == pytest.approx(rms(error), rel=1e-9)


def test_rows_of_a_prediction_are_scored_in_a_run_from_the_first_row() -> None:
    error = model_log()
    words = ("--model", model("small"), "--rows", "401:500")
    assert merits("log.csv", *words)["rmse"] == pytest.approx(
        rms(error[400:500]), rel=1e-9
    )


def test_an_inverse_model_predicts_no_displacement() -> None:
    model_log()
    done("invert", model("small"), "-o", "inverse.json")
    assert "inver" in refused(1, "report", "log.csv", "--model", "inverse.json")


# --- what was expected ---


def test_an_error_beside_the_expected_one() -> None:
    wanted = 2.5 - np.cos(2.0 * np.pi * 2.0 * TIME)
    write("wish.csv", "time_s,displacement_um", TIME, wanted)
    words = ("--summary", "summary.json", "-o", "drive.csv", "-q")
    done("compensate", model("known"), "wish.csv", *words)
    expected = json.loads(Path("summary.json").read_text())["expected_rmse"]
    write("came.csv", PAIR, TIME, wanted, wanted + 20.0 * expected)
    outcome = done(
        "report", "came.csv", "--expected", "summary.json", "--format", "json"
    )
    told = outcome.json
    assert told["logs"][0]["expected_rmse"] == pytest.approx(expected)
    assert any("20" in text for text in [*told["warnings"], *outcome.lines])


# --- refusals ---


def test_refusals_name_what_is_wrong() -> None:
    write("wish.csv", "time_s,displacement_um", TIME, WANTED)
    write("late.csv", "time_s,displacement_um", TIME + 50.0, WANTED)
    write("bare.csv", "displacement_um", WANTED)
    wrong = {
        "good.csv --lag 600": "--lag",
        "good.csv --figures good.csv": "--figures",
        "late.csv --trajectory wish.csv --match time": "--match",
        "bare.csv --trajectory wish.csv --match time": "bare.csv: has no time",
        "wish.csv --trajectory bare.csv --match time": "bare.csv: has no time",
        "missing.csv": "missing.csv",
        "good.csv --desired nothing": "nothing",
        "good.csv --trajectory missing.csv": "missing.csv",
        "good.csv --model missing.json": "missing.json",
        "good.csv --expected missing.json": "missing.json",
        "good.csv --rows 601:700": "601",
        "good.csv -o no/where.html": "no/where.html",
    }
    for words, held in wrong.items():
        assert held in refused(1, "report", *words.split())


def test_a_log_without_desired_is_told_of_the_ways() -> None:
    write("measured.csv", "time_s,displacement_um", TIME, WANTED)
    error = refused(1, "report", "measured.csv")
    assert "--trajectory" in error or "--desired" in error


def test_units_of_the_two_are_brought_together() -> None:
    write("nm.csv", "time_s,desired_um,measured_nm", TIME, WANTED, 1000.0 * WANTED)
    assert merits("nm.csv")["rmse"] < 1e-9


def test_one_channel_without_a_number_is_counted() -> None:
    lines = Path("good.csv").read_text().splitlines()
    lines[100] = ",".join([*lines[100].split(",")[:2], "nan"])
    Path("gap.csv").write_text("\n".join(lines) + "\n")
    outcome = dbo("report", "gap.csv", "--format", "json")
    if outcome.code == 0:
        assert outcome.json["logs"][0]["not_finite"] == 1
    else:
        assert outcome.code == 1 and "--skip-bad" in outcome.err
    assert merits("gap.csv", "--skip-bad")["samples"] == 599
