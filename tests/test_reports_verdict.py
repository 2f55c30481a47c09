# ruff: noqa: E501  (a message of one line stands on one line here)
"""What a report says first: limits kept or missed, expected beside actual, and the few rows that make the error."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dbo_cli
from dbo_cli.errors import UsageError
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.reports import drawing
from dbo_cli.reports.accumulators import Curve, FigureData
from dbo_cli.reports.renderers import to_json
from dbo_cli.reports.report import Expected, Report, ReportOptions, evaluate

RATE = 100.0
ROWS = 2000
CLOCK = np.arange(ROWS) / RATE
SUMMARY = {
    **{"format": "dbo-summary", "version": 1, "unit": "um"},
    **{"model_range": [0.0, 40.0], "move_range": [1.0, 9.0]},
}
WANTED = 5.0 - 4.0 * np.cos(2.0 * np.pi * 0.5 * CLOCK)  # a move of 8 um


def write(name: str, measured: Any, wanted: Any = WANTED) -> None:
    rows = zip(CLOCK.tolist(), wanted.tolist(), measured.tolist(), strict=True)
    lines = "".join(f"{t!r},{d!r},{m!r}\n" for t, d, m in rows)
    Path(name).write_text(f"time_s,desired_um,measured_um\n{lines}")


@pytest.fixture
def small_log() -> None:
    """Write the log of a straight actuator with a little loop, which the runner works beside."""
    clock = np.arange(600) / RATE
    drive = 50.0 - 50.0 * np.cos(2.0 * np.pi * clock / 1.5) * np.where(
        clock < 3.0, 1.0, 0.6
    )
    moved = 0.2 * drive + 0.6 * np.sin(2.0 * np.pi * clock / 1.5) * np.where(
        clock < 3.0, 1.0, 0.6
    )
    rows = zip(clock.tolist(), drive.tolist(), moved.tolist(), strict=True)
    lines = "".join(f"{t!r},{v!r},{y!r}\n" for t, v, y in rows)
    Path("log.csv").write_text(f"time_s,voltage_V,displacement_um\n{lines}")


def begun_wrong(size: float = 1.0) -> Any:
    """Return what a scan shows that begins wrong: noise of 0.01 um, and ``size`` um that decay in 50 ms."""
    noise = 0.01 * np.random.default_rng(5).normal(size=ROWS)
    return WANTED + noise + size * np.exp(-CLOCK / 0.05)


def test_a_limit_that_is_kept_is_the_first_line_in_words_and_in_green(dbo: Any) -> None:
    write("run.csv", WANTED + 0.04)
    done = dbo("report", "run.csv", "--max-nrmse-percent", "1")
    assert done.code == 0
    assert (
        done.out.splitlines()[0]
        == "PASSED: RMSE 0.5000 % of the move, within the limit of 1 % of the move"
    )
    assert (
        dbo("report", "run.csv", "--max-nrmse-percent", "1", "-o", "run.html").code == 0
    )
    page = Path("run.html").read_text(encoding="utf-8")
    body = page[page.index("<h1>") :]
    assert re.match(
        r'<h1>[^<]*</h1>\s*<p class="verdict passed"><strong>PASSED: RMSE 0\.5000 % of the move',
        body,
    )
    assert "FAILED" not in page


def test_a_limit_that_is_missed_is_the_first_line_with_both_values(dbo: Any) -> None:
    write("run.csv", WANTED + 0.04)
    limits = ("--max-nrmse-percent", "0.4", "--max-rmse", "0.05")
    done = dbo("report", "run.csv", *limits, "-o", "run.html")
    assert done.code == 3
    page = Path("run.html").read_text(encoding="utf-8")
    assert (
        '<p class="verdict failed"><strong>FAILED: 1 of 2 limits missed</strong>'
        in page
    )
    assert "RMSE 0.5000 % of the move, above the limit of 0.4 % of the move" in page
    content = json.loads(dbo("report", "run.csv", *limits, "--format", "json").out)
    assert content["passed"] is False
    assert content["limits"] == [
        {
            "name": "run.csv",
            "figure": "rmse",
            "limit": 0.05,
            "value": pytest.approx(0.04),
            "passed": True,
        },
        {
            "name": "run.csv",
            "figure": "nrmse_percent",
            "limit": 0.4,
            "value": pytest.approx(0.5),
            "passed": False,
        },
    ]


def test_without_a_limit_there_is_no_verdict(dbo: Any) -> None:
    write("run.csv", WANTED + 0.04)
    done = dbo("report", "run.csv")
    assert done.out.startswith("run.csv: 0.040 um RMSE, 0.50 % of the move\n")
    assert "PASSED" not in done.out and "FAILED" not in done.out
    assert (
        json.loads(dbo("report", "run.csv", "--format", "json").out)["passed"] is None
    )


def test_the_move_and_the_range_are_two_denominators(dbo: Any) -> None:
    """A move of 8 um of a model of 40 um: one error of 0.04 um, two percentages."""
    summary = SUMMARY | {"model_range": [-10.0, 30.0]}
    Path("s.json").write_text(json.dumps(summary | {"expected_rmse": None}))
    write("run.csv", WANTED + 0.04)
    log = json.loads(
        dbo("report", "run.csv", "--expected", "s.json", "--format", "json").out
    )["logs"][0]
    assert log["nrmse_percent"] == log["rmse_percent_of_move"] == pytest.approx(0.5)
    assert log["rmse_percent_of_range"] == pytest.approx(0.1)
    by_move = dbo(
        "report", "run.csv", "--max-nrmse-percent", "0.3", "--expected", "s.json"
    )
    by_range = dbo(
        "report", "run.csv", "--max-percent-of-range", "0.3", "--expected", "s.json"
    )
    assert (by_move.code, by_range.code) == (3, 0)
    assert by_range.out.startswith(
        "PASSED: RMSE 0.1000 % of the model's range, within the limit of 0.3 % of the\n      model's range\n"
    )
    refused = dbo("report", "run.csv", "--max-percent-of-range", "1")
    assert refused.code == 2
    assert (
        "--max-percent-of-range needs the range of a model (--model, or --expected MODEL)"
        in refused.err
    )


def test_expected_stands_beside_actual_out_of_a_summary(dbo: Any) -> None:
    Path("s.json").write_text(
        json.dumps(SUMMARY | {"expected_rmse": 0.05, "expected_shape_rmse": 0.03})
    )
    write("run.csv", WANTED + 0.02 + np.where(np.arange(ROWS) % 2, 0.06, -0.06))
    text = dbo("report", "run.csv", "--expected", "s.json").out
    assert (
        "Expected 0.050 um RMSE (by s.json for this move), actual 0.063 um, 1.3 times as"
        in text
    )
    shape = dbo("report", "run.csv", "--expected", "s.json", "--remove-offset").out
    assert (
        "Expected 0.030 um RMSE (by s.json for this move), actual 0.060 um, 2.0 times as"
        in shape
    )
    other = SUMMARY | {"expected_rmse": 0.05, "unit": "nm"}
    Path("s.json").write_text(json.dumps(other))
    refused = dbo("report", "run.csv", "--expected", "s.json")
    assert refused.code == 1
    assert "s.json: is in nm, the comparison in um" in refused.err


def test_a_start_that_makes_half_of_the_error_is_said_with_its_rows(dbo: Any) -> None:
    measured = begun_wrong()
    write("run.csv", measured)
    log = json.loads(dbo("report", "run.csv", "--format", "json").out)["logs"][0]
    error = measured - WANTED
    last = log["half_of_error_last_row"]
    assert log["half_of_error_first_row"] == 1
    assert float(np.sum(error[:last] ** 2)) >= 0.5 * float(np.sum(error**2))
    assert float(np.sum(error[: last - 1] ** 2)) < 0.5 * float(np.sum(error**2))
    assert log["half_of_error_percent_of_rows"] == pytest.approx(100.0 * last / ROWS)
    assert log["rmse_elsewhere"] == pytest.approx(
        float(np.sqrt(np.mean(error[last:] ** 2))), rel=1e-9
    )
    text = dbo("report", "run.csv").out
    part = float(np.sqrt(np.mean(error[last:] ** 2) / np.mean(error**2)))
    assert f"without them the RMSE is {part:.2f} of it" in " ".join(text.split())
    percent = log["half_of_error_percent_of_rows"]
    assert f", {percent:.2g} % of all, make " in " ".join(text.split())
    assert (
        "half of the squared error" in dbo("report", "run.csv", "--format", "html").out
    )


def test_even_errors_have_no_such_rows(dbo: Any) -> None:
    write("run.csv", WANTED + np.where(np.arange(ROWS) % 2, 0.1, -0.1))
    log = json.loads(dbo("report", "run.csv", "--format", "json").out)["logs"][0]
    assert log["half_of_error_percent_of_rows"] == pytest.approx(50.0, abs=0.1)
    assert log["rmse_elsewhere"] == pytest.approx(0.1)
    assert "squared error" not in dbo("report", "run.csv").out


@pytest.mark.parametrize("rows", [1, 500, 70_000])
def test_half_of_the_error_does_not_hang_on_how_a_log_is_cut(rows: int) -> None:
    rng = np.random.default_rng(rows)
    wanted = np.sin(np.arange(rows) / 50.0)
    measured = (
        wanted
        + 0.1 * rng.normal(size=rows)
        + 3.0 * np.exp(-0.5 * ((np.arange(rows) - 0.3 * rows) / 9.0) ** 2)
    )
    halves = []
    for cut in (rows, 997, 31):
        blocks = [
            SampleBlock(
                range(first + 1, min(first + cut, rows) + 1),
                None,
                None,
                {
                    "desired": wanted[first : first + cut],
                    "measured": measured[first : first + cut],
                },
            )
            for first in range(0, rows, cut)
        ]
        halves.append(
            evaluate("a", blocks, ReportOptions(remove_offset=True)).figures.half
        )
    assert halves[0] == halves[1] == halves[2]
    if rows == 70_000:
        half = halves[0]
        assert half is not None
        error = measured - wanted - (measured - wanted).mean()
        place = slice(half.first[0] - 1, half.last[0])
        assert float(np.sum(error[place] ** 2)) == pytest.approx(
            half.part_of_error * float(np.sum(error**2)), rel=1e-9
        )


def test_a_lag_in_seconds_is_its_samples_times_the_period() -> None:
    blocks = SampleBlock(
        range(1, ROWS + 1),
        None,
        CLOCK,
        {"desired": WANTED, "measured": np.roll(WANTED, 3)},
    )
    log = evaluate("a", [blocks], ReportOptions(lag=3))
    record = json.loads(
        to_json(Report.of([log], log_options := ReportOptions(lag=3), "um"))
    )["logs"][0]
    assert log_options.lag == 3
    assert (record["lag_samples"], record["lag_s"]) == (3, pytest.approx(3.0 / RATE))
    assert record["sample_period_s"] == pytest.approx(1.0 / RATE)
    late = evaluate("a", [blocks], ReportOptions())
    assert late.figures.lag_left == pytest.approx(3.0, rel=0.01)
    assert late.figures.lag_left_seconds == pytest.approx(0.03, rel=0.01)


def test_a_row_without_a_voltage_is_refused_or_dropped_and_counted(dbo: Any) -> None:
    volts = WANTED * 10.0
    volts[7] = np.nan
    rows = zip(
        CLOCK.tolist(),
        volts.tolist(),
        WANTED.tolist(),
        (WANTED + 0.1).tolist(),
        strict=True,
    )
    text = "".join(
        f"{t!r},{'nan' if v != v else repr(v)},{d!r},{m!r}\n" for t, v, d, m in rows
    )
    Path("run.csv").write_text(f"time_s,voltage_V,desired_um,measured_um\n{text}")
    refused = dbo("report", "run.csv")
    assert refused.code == 1
    assert (
        "run.csv:9: column 'voltage_V' is not finite: 'nan' (--skip-bad drops such rows)"
        in refused.err
    )
    done = dbo("report", "run.csv", "--format", "json", "--skip-bad")
    log = json.loads(done.out)["logs"][0]
    assert (log["samples"], log["rmse"]) == (ROWS - 1, pytest.approx(0.1))
    assert (
        "run.csv:9: column 'voltage_V' is not finite: 'nan': 1 row dropped" in done.err
    )


def test_figures_leave_out_samples_whose_drive_is_no_number() -> None:
    volts = WANTED * 10.0
    volts[7] = np.nan
    block = SampleBlock(
        range(1, ROWS + 1),
        None,
        CLOCK,
        {"desired": WANTED, "measured": WANTED + 0.1, "voltage": volts},
    )
    data = FigureData("V")
    log = evaluate("a", [block], ReportOptions(), figure_data=data)
    assert (log.figures.samples, data.samples) == (ROWS, ROWS - 1)
    drawn = data.against("drive", "measured")
    assert isinstance(drawn, Curve)
    assert len(drawn.x) == ROWS - 1
    assert np.isfinite(drawn.x).all() and np.isfinite(drawn.y).all()


@pytest.mark.parametrize("rate", [np.inf, np.nan, 0.0, -5.0])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="sample_rate"):
        dbo_cli.report(WANTED, WANTED + 0.1, sample_rate=rate)


def test_expected_without_its_mean_where_the_offset_is_removed() -> None:
    blocks = SampleBlock(
        range(1, ROWS + 1), None, CLOCK, {"desired": WANTED, "measured": WANTED + 0.5}
    )
    stated = Expected(0.5, 0.3, 40.0, "m")
    for remove, figure in ((False, 0.5), (True, 0.3)):
        log = evaluate("a", [blocks], ReportOptions(remove_offset=remove))
        log = type(log)(log.name, log.figures, log.lag, expected=stated)
        assert log.expected_rmse == figure


def test_a_state_is_where_the_prediction_begins(dbo: Any, small_log: Path) -> None:
    assert dbo("identify", "log.csv", "--gears", "64", "-o", "m.json", "-q").code == 0
    rows = [line.split(",") for line in Path("log.csv").read_text().splitlines()]
    middle = [row for row in rows[1:] if row][200:320]
    Path("part.csv").write_text(
        "\n".join(",".join(row) for row in [rows[0], *middle]) + "\n"
    )
    errors = {}
    for start in ("auto", "empty", "full"):
        done = dbo(
            "report",
            "part.csv",
            "--model",
            "m.json",
            "--state",
            start,
            "--format",
            "json",
        )
        assert done.code == 0, done.err
        errors[start] = json.loads(done.out)["logs"][0]["rmse"]
    assert len({round(value, 9) for value in errors.values()}) > 1
    alone = dbo(
        "report", "part.csv", "--desired", "1", "--measured", "2", "--state", "empty"
    )
    assert (alone.code, alone.err.strip().splitlines()[-1]) == (
        2,
        "dbo: error: --state is where a model starts (--model)",
    )


def test_the_remedy_for_an_unknown_start_is_an_option_of_the_command(
    dbo: Any, small_log: Path
) -> None:
    assert dbo("identify", "log.csv", "--gears", "64", "-o", "m.json", "-q").code == 0
    rows = [line.split(",") for line in Path("log.csv").read_text().splitlines()]
    Path("part.csv").write_text(
        "\n".join(",".join(row) for row in [rows[0], *rows[230:420]]) + "\n"
    )
    done = dbo("report", "part.csv", "--model", "m.json")
    help_page = dbo("report", "--help-all").out
    for option in re.findall(r"--[a-z-]+", done.err):
        assert option in help_page


def test_no_window_without_a_display(dbo: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(drawing.sys, "platform", "linux")
    write("run.csv", WANTED + 0.04)
    done = dbo("report", "run.csv", "--show", "-o", "report.txt")
    assert (done.code, done.out) == (2, "")
    assert done.err.strip().splitlines()[-1] == (
        "dbo: error: --show: there is no display to open a window on (--figures DIR writes files)"
    )
    assert not Path("report.txt").exists()


def test_windows_are_refused_where_no_toolkit_is_installed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(drawing, "TOOLKITS", ("NoSuchAgg",))
    monkeypatch.setattr(drawing.sys, "platform", "linux")
    from matplotlib import pyplot

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(pyplot, "switch_backend", missing)
    with pytest.raises(
        UsageError, match="nothing that opens windows is installed for matplotlib"
    ):
        drawing.show_in_windows([])


def noisy(size: float) -> Any:
    return WANTED + np.where(np.arange(ROWS) % 2, size, -size)


def expected_of(rmse: float, shape: float) -> None:
    Path("s.json").write_text(
        json.dumps(SUMMARY | {"expected_rmse": rmse, "expected_shape_rmse": shape})
    )


def test_far_more_than_was_expected_is_a_warning_with_a_remedy(dbo: Any) -> None:
    expected_of(0.02, 0.01)
    write("run.csv", noisy(0.05))
    done = dbo("report", "run.csv", "--expected", "s.json", "-o", "run.html")
    remedy = (
        "run.csv: 2.5 times as much came as was expected: the actuator came from elsewhere than the model takes it "
        "to (a sweep before the move, --condition), it has changed (identify it again, or with --prior), or the "
        "logs of the identification had no such moves"
    )
    assert f"dbo: warning: {remedy}" in done.err
    assert f"<strong>Warning:</strong> {remedy}" in Path("run.html").read_text(
        encoding="utf-8"
    )
    text = " ".join(dbo("report", "run.csv", "--expected", "s.json").out.split())
    assert f"Warning: {remedy}" in text
    content = json.loads(
        dbo("report", "run.csv", "--expected", "s.json", "--format", "json").out
    )
    assert content["warnings"] == [
        remedy.replace("--condition", "`condition`").replace("--prior", "`prior`")
    ]


def test_a_mean_error_far_beyond_what_was_expected_names_the_zero(dbo: Any) -> None:
    expected_of(0.02, 0.01)
    write("run.csv", noisy(0.012) + 0.08)
    done = dbo("report", "run.csv", "--expected", "s.json")
    assert (
        "run.csv: 4.0 times as much came as was expected: most of it is the mean error: the zero has moved (--remove-offset "
        "takes the mean off), the gain has changed (identify it again, or with --prior), or the actuator came from "
        "elsewhere than the model takes it to (a sweep before the move, --condition)"
    ) in done.err
    taken_off = dbo("report", "run.csv", "--expected", "s.json", "--remove-offset")
    assert "was expected:" not in taken_off.err
    write("run.csv", noisy(0.039))
    assert "was expected:" not in dbo("report", "run.csv", "--expected", "s.json").err


def test_as_many_times_in_the_warning_as_in_the_report(dbo: Any) -> None:
    expected_of(0.0002, 0.0001)
    write("run.csv", noisy(0.05))
    done = dbo("report", "run.csv", "--expected", "s.json")
    assert "warning: run.csv: 250 times as much came as was expected" in done.err
    assert "250 times as much came" in " ".join(done.out.split()).replace(
        "Warning: run.csv: 250 times", ""
    )


@pytest.mark.parametrize(
    ("stated", "move"),
    [
        (
            {"move_range": [1.0, 5.0]},
            "a move from 1 to 5 um, the one compared has 1 to 9 um",
        ),
        (
            {"move_range": [3.0, 11.0]},
            "a move from 3 to 11 um, the one compared has 1 to 9 um",
        ),
        (
            {"expected_percent_of_move": 1.0},
            "a move of 5 um, the one compared has 8 um",
        ),
        ({}, "a move that it does not describe, the one compared has 1 to 9 um"),
    ],
)
def test_the_summary_of_another_move_is_not_taken_for_this_one(
    dbo: Any, stated: Any, move: str
) -> None:
    summary = {key: value for key, value in SUMMARY.items() if key != "move_range"}
    Path("s.json").write_text(json.dumps(summary | {"expected_rmse": 0.05} | stated))
    write("run.csv", noisy(0.3))
    done = dbo("report", "run.csv", "--expected", "s.json")
    warning = (
        f"run.csv: s.json states the error of {move}: the expected error may be another move's (give the summary "
        "of this move)"
    )
    assert f"dbo: warning: {warning}\n" in done.err
    assert "for this move" not in done.out + done.err
    assert f"(by s.json for {move.partition(',')[0]})" in " ".join(done.out.split())


@pytest.mark.parametrize(
    "stated", [{"move_range": [1.05, 9.05]}, {"expected_percent_of_move": 0.627}]
)
def test_the_summary_of_this_move_to_a_hundredth(dbo: Any, stated: Any) -> None:
    summary = {key: value for key, value in SUMMARY.items() if key != "move_range"}
    Path("s.json").write_text(json.dumps(summary | {"expected_rmse": 0.05} | stated))
    write("run.csv", noisy(0.05))
    done = dbo("report", "run.csv", "--expected", "s.json")
    assert "by s.json for this move" in done.out and "warning" not in done.err


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("version", 9, "'version' is 9, this program reads 1"),
        ("unit", 5, "'unit' is 5, a text is needed"),
        (
            "model_range",
            "x",
            "'model_range' is \"x\", two numbers are needed, the lesser one first",
        ),
        (
            "model_range",
            [5],
            "'model_range' is [5], two numbers are needed, the lesser one first",
        ),
        (
            "model_range",
            [None, 3],
            "'model_range' is [null, 3], two numbers are needed, the lesser one first",
        ),
        (
            "model_range",
            [5, 1],
            "'model_range' is [5, 1], two numbers are needed, the lesser one first",
        ),
        (
            "model_range",
            [1, 1],
            "'model_range' is [1, 1], two different numbers are needed",
        ),
        (
            "move_range",
            [9, 1],
            "'move_range' is [9, 1], two numbers are needed, the lesser one first",
        ),
        (
            "expected_rmse",
            "a",
            "'expected_rmse' is \"a\", a number of at least 0 or null is needed",
        ),
        (
            "expected_rmse",
            -1,
            "'expected_rmse' is -1, a number of at least 0 or null is needed",
        ),
        (
            "expected_rmse",
            0,
            "'expected_rmse' is 0, a number above 0 or null is needed",
        ),
        (
            "expected_rmse",
            np.inf,
            "'expected_rmse' is Infinity, a number of at least 0 or null is needed",
        ),
        (
            "expected_rmse",
            True,
            "'expected_rmse' is true, a number of at least 0 or null is needed",
        ),
        (
            "expected_shape_rmse",
            "b",
            "'expected_shape_rmse' is \"b\", a number of at least 0 or null is needed",
        ),
        (
            "expected_percent_of_move",
            [],
            "'expected_percent_of_move' is [], a number of at least 0 or null is needed",
        ),
    ],
)
def test_a_summary_that_states_nonsense_is_refused_by_its_key(
    dbo: Any, key: str, value: Any, words: str
) -> None:
    Path("s.json").write_text(
        json.dumps(SUMMARY | {"expected_rmse": 0.05} | {key: value})
    )
    write("run.csv", noisy(0.05))
    done = dbo("report", "run.csv", "--expected", "s.json")
    assert (done.code, done.out) == (1, "")
    assert done.err.strip().splitlines()[-1].startswith(f"dbo: error: s.json: {words}")


def test_a_summary_without_an_expected_error_is_said_to_have_none(dbo: Any) -> None:
    Path("s.json").write_text(json.dumps(SUMMARY | {"expected_rmse": None}))
    write("run.csv", noisy(0.05))
    done = dbo("report", "run.csv", "--expected", "s.json")
    assert done.code == 0
    assert "dbo: warning: run.csv: s.json states no expected error\n" in done.err


def test_limits_of_the_error_take_a_unit(dbo: Any) -> None:
    write("run.csv", WANTED + 0.04)
    assert (
        dbo("report", "run.csv", "--max-rmse", "41nm", "--max-abs", "4.1e-5mm").code
        == 0
    )
    missed = dbo("report", "run.csv", "--max-rmse", "10nm")
    assert missed.code == 3
    assert (
        "RMSE 0.04 um is above the limit of 0.01 um by 0.03 (--max-rmse)" in missed.err
    )
    volts = dbo("report", "run.csv", "--max-abs", "10mV")
    assert (volts.code, volts.out) == (2, "")
    assert "--max-abs 10mV: cannot be converted; a figure in um is needed" in volts.err
    for option in ("--max-rmse", "--max-abs"):
        below = dbo("report", "run.csv", f"{option}=-1nm")
        assert below.code == 2 and "must not be below 0" in below.err
