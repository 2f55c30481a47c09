# ruff: noqa: E501  (a message of one line stands on one line here)
"""report through the command line: forms, limits, lag, models, figures and refusals."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import folder_content

T = np.arange(200) / 100.0
DESIRED = 5.0 - 4.0 * np.cos(2 * np.pi * T)


def write_log(
    name: str, error: Any, header: str = "time_s,desired_um,displacement_um"
) -> Path:
    """Write desired and measured, which is desired plus ``error``."""
    rows = zip(T.tolist(), DESIRED.tolist(), (DESIRED + error).tolist(), strict=True)
    path = Path(name)
    path.write_text(header + "\n" + "".join(f"{t!r},{d!r},{m!r}\n" for t, d, m in rows))
    return path


@pytest.fixture
def logs(dbo: Any) -> Any:
    """Return the runner beside two logs with errors of ±0.5 and ±0.1 µm."""
    sign = np.where(np.arange(200) % 2, 1.0, -1.0)
    write_log("before.csv", 0.5 * sign)
    write_log("after.csv", 0.1 * sign)
    return dbo


def test_text_has_both_and_their_ratio(logs: Any) -> None:
    done = logs("report", "before.csv", "after.csv")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith(
        "after.csv: 0.10 um RMSE, 5.0 times less than before.csv\n\nError = measured - desired in um\n"
    )
    assert max(map(len, done.out.splitlines())) <= 80
    rows = {
        line.split()[0]: line.split()
        for line in reversed(done.out.splitlines())
        if line.split()
    }
    assert (rows["before.csv"][2], rows["before.csv"][-1]) == ("0.5000", "1.000")
    assert (rows["after.csv"][2], rows["after.csv"][-1]) == ("0.1000", "0.2000")


def test_json(logs: Any) -> None:
    report = json.loads(
        logs("report", "before.csv", "after.csv", "--format", "json").out
    )
    assert (report["format"], report["version"], report["unit"]) == (
        "dbo-report",
        1,
        "um",
    )
    first, second = report["logs"]
    assert (first["name"], first["samples"]) == ("before.csv", 200)
    assert first["rmse"] == pytest.approx(0.5, rel=1e-12)
    assert first["nrmse_percent"] == pytest.approx(100 * 0.5 / 8.0, rel=1e-12)
    assert first["max_abs"] == pytest.approx(0.5, rel=1e-12)
    assert second["ratio_to_first"] == pytest.approx(0.2, rel=1e-12)


def test_a_late_sensor_is_late_in_samples_seconds_and_milliseconds(dbo: Any) -> None:
    late = np.roll(np.tile(DESIRED, 2), 3)[200:]  # 3 rows of 10 ms
    write_log("late.csv", late - DESIRED)
    (log,) = json.loads(dbo("report", "late.csv", "--format", "json").out)["logs"]
    assert log["sample_period_s"] == pytest.approx(0.01, rel=1e-9)
    assert log["lag_left_samples"] == pytest.approx(3.0, rel=0.02)
    assert log["lag_left_s"] == pytest.approx(0.01 * log["lag_left_samples"], rel=1e-9)
    (row,) = csv.DictReader(
        io.StringIO(dbo("report", "late.csv", "--format", "csv").out)
    )
    assert float(row["lag_left_s"]) == pytest.approx(log["lag_left_s"], rel=1e-4)
    text = dbo("report", "late.csv").out.splitlines()[-1].split()
    assert text[4:6] == ["3.00", "0.0300"]  # samples and seconds


def test_csv_has_one_line_a_log(logs: Any) -> None:
    rows = list(
        csv.DictReader(
            io.StringIO(
                logs("report", "before.csv", "after.csv", "--format", "csv").out
            )
        )
    )
    assert [row["name"] for row in rows] == ["before.csv", "after.csv"]
    assert float(rows[1]["rmse"]) == pytest.approx(0.1)


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("r.json", "{"),
        ("r.csv", "name,"),
        ("r.html", "<!doctype html>"),
        ("r.txt", "after.csv: 0.10 um RMSE, 1.2 % of the move\n\nError"),
    ],
)
def test_the_form_follows_the_name_of_the_output(
    logs: Any, name: str, start: str
) -> None:
    assert logs("report", "after.csv", "-o", name) == (0, "", "")
    assert Path(name).read_text().lower().startswith(start.lower())


def test_html_reaches_for_no_network(logs: Any) -> None:
    logs("report", "before.csv", "after.csv", "-o", "r.html")
    text = Path("r.html").read_text()
    assert "http://" not in text.replace("http://www.w3.org/", "")
    assert "https://" not in text and "<script" not in text and "@import" not in text


def test_the_same_logs_give_the_same_bytes(logs: Any) -> None:
    for form in ("text", "json", "csv"):
        words = ["report", "before.csv", "after.csv", "--format", form]
        assert logs(*words) == logs(*words)
    words = ["report", "after.csv", "--format", "html"]
    assert logs(*words) == logs(*words)


def test_rows_count_desired_and_lag_takes_measured_later(dbo: Any) -> None:
    rows = zip(DESIRED.tolist(), np.roll(DESIRED, 3).tolist(), strict=True)
    Path("late.csv").write_text("".join(f"{d!r},{m!r}\n" for d, m in rows))
    words = [
        "report",
        "late.csv",
        "--desired",
        "1",
        "--measured",
        "2",
        "--format",
        "json",
    ]
    [log] = json.loads(dbo(*words, "--lag", "3").out)["logs"]
    assert (log["rmse"], log["samples"], log["lag_samples"]) == (0.0, 197, 3)
    [log] = json.loads(dbo(*words, "--lag", "3", "--rows", "11:60").out)["logs"]
    assert (log["rmse"], log["samples"]) == (0.0, 50)
    [log] = json.loads(dbo(*words, "--lag", "auto").out)["logs"]
    assert (log["lag_samples"], log["rmse"]) == (3, 0.0)


def test_offset_removed(dbo: Any) -> None:
    write_log("off.csv", np.full(200, 2.5))
    [log] = json.loads(
        dbo("report", "off.csv", "--remove-offset", "--format", "json").out
    )["logs"]
    assert log["rmse"] == pytest.approx(0.0, abs=1e-12)
    assert log["offset_removed"] == pytest.approx(2.5)


def test_limits_exit_with_3_and_write_the_report_all_the_same(logs: Any) -> None:
    done = logs("report", "before.csv", "--max-rmse", "0.4", "-o", "r.json")
    assert done.code == 3
    assert (
        done.err
        == "dbo: error: before.csv: RMSE 0.5 um is above the limit of 0.4 um by 0.1 (--max-rmse)\n"
    )
    assert json.loads(Path("r.json").read_text())["logs"][0]["samples"] == 200
    assert (
        logs(
            "report",
            "before.csv",
            "--max-rmse",
            "0.6",
            "--max-abs",
            "0.6",
            "-o",
            "r.json",
        ).code
        == 0
    )
    assert logs("report", "before.csv", "--max-abs", "0.4", "-o", "r.json").code == 3
    assert (
        logs("report", "before.csv", "--max-nrmse-percent", "5", "-o", "r.json").code
        == 3
    )


def test_segments(logs: Any) -> None:
    report = json.loads(
        logs("report", "after.csv", "--segment", "0.5", "--format", "json").out
    )
    parts = report["logs"][0]["segments"]
    assert [part["samples"] for part in parts] == [50, 50, 50, 50]
    assert all(math.isclose(part["rmse"], 0.1, rel_tol=1e-9) for part in parts)


def test_a_model_takes_the_place_of_desired(dbo: Any, model_file: Path) -> None:
    drive = 5.0 - 5.0 * np.cos(2 * np.pi * T)
    Path("drive.csv").write_text(
        "time_s,voltage_V\n"
        + "".join(
            f"{t!r},{v!r}\n" for t, v in zip(T.tolist(), drive.tolist(), strict=True)
        )
    )
    dbo("simulate", "model.json", "drive.csv", "-o", "played.csv")
    done = dbo("report", "played.csv", "--model", "model.json", "--format", "json")
    report = json.loads(done.out)
    assert report["compared"] == ["model", "measured"]
    assert report["logs"][0]["rmse"] == 0.0


def test_rows_of_a_model_are_scored_by_a_run_from_the_first_row(
    dbo: Any, model_file: Path
) -> None:
    """Started at row 61, in the middle of a swing, the model would guess a state and be wrong."""
    drive = 5.0 - 5.0 * np.cos(2 * np.pi * T) * np.exp(-0.8 * T)
    rows = zip(T.tolist(), drive.tolist(), strict=True)
    Path("drive.csv").write_text(
        "time_s,voltage_V\n" + "".join(f"{t!r},{v!r}\n" for t, v in rows)
    )
    dbo("simulate", "model.json", "drive.csv", "--state", "empty", "-o", "played.csv")
    words = ["report", "played.csv", "--model", "model.json", "--format", "json"]
    whole = json.loads(dbo(*words).out)["logs"][0]
    for block in ("1", "17", "1000"):
        [log] = json.loads(dbo(*words, "--rows", "61:150", "--block-rows", block).out)[
            "logs"
        ]
        assert (log["samples"], log["rmse"]) == (90, 0.0)
    assert whole["rmse"] == 0.0
    done = dbo(*words, "--rows", "61:150", "--resample", "50")
    assert done.code == 2
    assert done.err == (
        "dbo: error: --rows are those that were recorded, and after --resample there are others (give one of"
        " them)\n"
    )


def test_the_conditioning_sweep_is_left_out_and_said(
    dbo: Any, model_file: Path
) -> None:
    rows = zip(T.tolist(), (5.0 - 2.0 * np.cos(2 * np.pi * T)).tolist(), strict=True)
    Path("wish.csv").write_text(
        "time_s,displacement_um\n" + "".join(f"{t!r},{d!r}\n" for t, d in rows)
    )
    dbo("compensate", "model.json", "wish.csv", "--condition", "-o", "drive.csv", "-q")
    table = np.loadtxt("drive.csv", delimiter=",", skiprows=1)
    sweep = int((table[:, 0] < 0.0).sum())
    assert sweep > 100
    measured = table[:, 1] + np.where(table[:, 0] < 0.0, 1.0, 0.25)
    np.savetxt(
        "run.csv",
        np.column_stack([table[:, :2], measured]),
        delimiter=",",
        header="time_s,desired_um,displacement_um",
        comments="",
    )
    done = dbo("report", "run.csv", "--format", "json")
    [log] = json.loads(done.out)["logs"]
    assert (log["samples"], log["rmse"]) == (200, pytest.approx(0.25))
    begins, offset = done.err.splitlines()
    assert (
        begins
        == f"dbo: run.csv: {sweep} rows before time 0, on the way to the move, left out"
    )
    assert offset.startswith(
        "dbo: run.csv: without the mean error 0 % of the RMSE is left: "
    )
    for words in (["--count-sweep"], ["--rows", f"1:{sweep + 200}"]):
        [log] = json.loads(dbo("report", "run.csv", "--format", "json", *words).out)[
            "logs"
        ]
        assert log["samples"] == sweep + 200


def test_the_desired_signal_may_lie_in_another_file(logs: Any) -> None:
    """A recording at twice the rate, begun 0.1 s early, beside the file that was played."""
    write_log("drive.csv", 0.0)
    time = np.arange(430) / 200.0 - 0.1
    wanted = np.interp(time, T, DESIRED)
    np.savetxt(
        "sensor.csv",
        np.column_stack([time, wanted + 0.5]),
        delimiter=",",
        header="t (s),pos (um)",
        comments="",
    )
    done = logs(
        "report",
        "sensor.csv",
        "--trajectory",
        "drive.csv",
        "--desired",
        "desired_um",
        "--format",
        "json",
    )
    [log] = json.loads(done.out)["logs"]
    inside = int(((time >= 0.0) & (time <= T[-1] + 1e-9)).sum())
    assert (log["samples"], log["rmse"]) == (inside, pytest.approx(0.5))
    outside = done.err.splitlines()[0]
    assert (
        outside
        == f"dbo: sensor.csv: {430 - inside} rows outside the time of drive.csv take no part"
    )
    np.savetxt("plain.csv", DESIRED + 0.25, header="pos (um)", comments="")
    words = [
        "report",
        "plain.csv",
        "--trajectory",
        "drive.csv",
        "--desired",
        "2",
        "--format",
        "json",
    ]
    [log] = json.loads(logs(*words).out)["logs"]
    assert (log["samples"], log["rmse"]) == (200, pytest.approx(0.25))
    assert logs(*words, "--match", "time").code == 1
    done = logs(
        "report", "after.csv", "--trajectory", "drive.csv", "--model", "drive.csv"
    )
    assert (done.code, done.err.split(":")[2]) == (
        2,
        " --trajectory and --model exclude each other",
    )


def test_figures_are_drawn(logs: Any) -> None:
    assert logs("report", "after.csv", "--figures", "figures", "-o", "r.txt") == (
        0,
        "",
        "",
    )
    names = folder_content(Path("figures"))
    for key in ("tracking", "error", "output", "histogram"):
        assert {f"after-{key}.png", f"after-{key}.svg"} <= names
    assert Path("figures/after-error.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("blank_figures")
def test_the_errors_of_all_logs_stand_above_those_of_each(logs: Any) -> None:
    assert (
        logs(
            "report", "before.csv", "after.csv", "--figures", "both", "-o", "r.html"
        ).code
        == 0
    )
    assert {"all-logs-errors.png", "all-logs-errors.svg"} <= folder_content(
        Path("both")
    )
    page = Path("r.html").read_text()
    assert page.index("Error of all logs against time") < page.index("<section>")


REFUSED = {
    "none.csv": "none.csv: ",
    "plain.csv": "plain.csv: no column is recognised as the desired",
    "mixed.csv": "mixed.csv: column 'desired_V' is in V, but the comparison is in um",
    "after.csv --lag 500": "after.csv: a lag of 500 samples leaves nothing of 200 rows",
    "after.csv angle.csv": "angle.csv: column 'displacement_rad' is in rad, but the comparison is in um",
    "after.csv --model inverse.json": "inverse.json: is an inverse model where a forward one is needed (dbo invert turns it)",
    "after.csv --model model.json": "after.csv: no column is recognised as the voltage",
    "after.csv --figures after.csv/figures": "after.csv/figures: figures cannot be written there: ",
    "after.csv -o none/r.txt": "none/r.txt: there is no folder 'none': create it first",
}


@pytest.mark.parametrize("line", REFUSED)
def test_refusals_are_one_line_and_leave_nothing(
    logs: Any, model_file: Path, line: str
) -> None:
    Path("plain.csv").write_text("time_s,displacement_um\n0,1\n1,2\n")
    write_log("mixed.csv", 0.0 * T, "time_s,desired_V,displacement_um")
    write_log("angle.csv", 0.1 + 0.0 * T, "time_s,desired_rad,displacement_rad")
    logs("invert", "model.json", "-o", "inverse.json")
    before = folder_content(Path())
    done = logs("report", *line.split())
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith(f"dbo: error: {REFUSED[line]}")
    assert done.err.count("\n") == 1
    assert folder_content(Path()) == before


def test_a_log_without_a_desired_column_is_told_of_the_trajectory_and_the_model(
    logs: Any,
) -> None:
    Path("plain.csv").write_text("time_s,displacement_um\n0,1\n1,2\n")
    assert logs("report", "plain.csv").err == (
        "dbo: error: plain.csv: no column is recognised as the desired signal: it has 1 time_s, "
        "2 displacement_um (choose with --desired NAME or NUMBER, or --trajectory FILE where it lies "
        "elsewhere, or --model MODEL to compare with a model)\n"
    )


@pytest.mark.usefixtures("blank_figures")
def test_notes_for_readers_spell_options_as_the_shell_does(dbo: Any) -> None:
    write_log("off.csv", 0.5 + 0.0 * T)
    text = " ".join(dbo("report", "off.csv").out.split())
    assert "where the mean is the sensor's zero, --remove-offset takes it off" in text
    page = dbo("report", "off.csv", "--format", "html").out
    assert "--remove-offset takes it off" in page
    assert "`remove_offset`" not in text + page
    (note,) = json.loads(dbo("report", "off.csv", "--format", "json").out)["notes"]
    # read by programs, as the Python call has it
    assert "`remove_offset` takes it off" in note


def write_track(header: str) -> None:
    """Write desired, measured, and the desired signal again in every further column."""
    more = header.count(",") - 2
    rows = zip(T.tolist(), DESIRED.tolist(), strict=True)
    lines = [f"{t!r},{d!r},{d + 0.1!r}" + f",{d!r}" * more for t, d in rows]
    Path("track.csv").write_text("\n".join([header, *lines]) + "\n")


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("header", ["pressure_bar", "current_A", "Dev1/ao0"])
def test_a_drive_of_any_quantity_is_drawn(dbo: Any, header: str) -> None:
    write_track(f"time_s,desired_um,displacement_um,{header}")
    done = dbo("report", "track.csv", "--figures", "figures", "-o", "r.txt")
    assert done.code == 0
    assert done.err.startswith(f"dbo: track.csv: '{header}' is taken for the drive: ")
    assert {"track-drive.png", "track-loop.png"} <= folder_content(Path("figures"))


def test_the_drive_of_a_page_is_called_by_its_quantity(dbo: Any) -> None:
    write_track("time_s,desired_um,displacement_um,pressure_bar")
    page = dbo("report", "track.csv", "--format", "html").out
    assert "Hysteresis loop: displacement against drive pressure" in page
    assert (
        "Drive pressure (bar)" in page
        and "rive voltage" not in page.split("<section", 1)[1]
    )


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize(
    "header",
    [
        "temperature_degC",
        "current_A,pressure_bar",
        "pressure target (bar)",
        "current monitor (A)",
    ],
)
def test_what_may_not_be_the_drive_is_not_drawn(dbo: Any, header: str) -> None:
    write_track(f"time_s,desired_um,displacement_um,{header}")
    assert dbo("report", "track.csv", "--figures", "figures", "-o", "r.txt") == (
        0,
        "",
        "",
    )
    assert not {"track-drive.png", "track-loop.png"} & folder_content(Path("figures"))


def test_the_only_analog_input_is_what_was_measured(logs: Any) -> None:
    write_log("wanted.csv", 0.0 * T, "time_s,desired_um,x")
    write_log("card.csv", 0.1 + 0.0 * T, "time_s,ao0,ai0")
    done = logs("report", "card.csv", "--trajectory", "wanted.csv", "--format", "json")
    assert json.loads(done.out)["logs"][0]["rmse"] == pytest.approx(0.1)
    assert (
        "dbo: card.csv: 'ai0' is taken for the measured signal: the only analog input (--measured names "
        "another)\n" in done.err
    )
    assert (
        "dbo: card.csv: 'ao0' is taken for the drive: the only analog output"
        in done.err
    )


# --- a recording as an oscilloscope writes it, beside the drive that was played ---


def write_scope(start: float) -> None:
    """Write a drive with 20 rows before the move, and a recording of it in volts whose clock begins at ``start``."""
    rows = np.arange(-20, 200)
    wanted = np.where(rows < 0, 1.0, 5.0 - 4.0 * np.cos(2 * np.pi * rows / 100.0))
    drive = "".join(
        f"{row / 100.0!r},{y!r},{10 * y!r}\n"
        for row, y in zip(rows.tolist(), wanted.tolist(), strict=True)
    )
    Path("drive.csv").write_text("time_s,desired_um,voltage_V\n" + drive)
    lines = []
    for k, y in enumerate(wanted.tolist()):
        lines.append(f"{start + k / 100.0!r},{y!r},{(y + 0.1) / 10.0!r}\n")
    Path("scope.csv").write_text("time_s,CH1 (V),CH2 (V)\n" + "".join(lines))


SCOPE = [
    "report",
    "scope.csv",
    "--trajectory",
    "drive.csv",
    "--measured",
    "CH2",
    "--format",
    "json",
]


def test_a_recorder_that_starts_its_own_clock_is_asked_about(dbo: Any) -> None:
    write_scope(0.0)
    done = dbo(*SCOPE, "--scale", "measured=10um/V")
    assert (done.code, done.out) == (1, "")
    assert done.err.splitlines()[-1] == (
        "dbo: error: scope.csv: it begins at 0 s, and drive.csv at -0.2 s, with rows before the move: did the "
        "recorder start its clock with the first of them (--match rows), or do both have one clock (--match time)?"
    )
    report = json.loads(
        dbo(*SCOPE, "--scale", "measured=10um/V", "--match", "rows").out
    )
    assert report["logs"][0]["rmse"] == pytest.approx(0.1, rel=1e-9)
    write_scope(-0.2)
    report = json.loads(dbo(*SCOPE, "--scale", "measured=10um/V").out)
    assert report["logs"][0]["rmse"] == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("role", ["measured", "displacement"])
def test_a_scale_belongs_to_the_recording_and_not_to_the_trajectory(
    dbo: Any, role: str
) -> None:
    write_scope(-0.2)
    done = dbo(
        *SCOPE, "--scale", f"{role}=10um/V", "--voltage", "CH1", "--scale", "voltage=10"
    )
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert report["unit"] == "um"
    assert report["logs"][0]["rmse"] == pytest.approx(0.1, rel=1e-9)
    doubled = json.loads(
        dbo(*SCOPE, "--scale", "measured=20um/V", "--scale", "desired=2").out
    )
    assert doubled["logs"][0]["rmse"] == pytest.approx(0.2, rel=1e-9)


def test_what_was_played_is_scaled_and_the_drive_is_not(dbo: Any) -> None:
    write_scope(-0.2)
    words = [
        "check",
        "scope.csv",
        "--voltage",
        "CH1",
        "--scale",
        "voltage=10",
        "--against",
        "drive.csv",
    ]
    done = dbo(*words, "--v-min", 0, "--v-max", 100)
    assert done.code == 0, done.err
    assert "gain 1, offset" in done.out
