"""The report's values and its text, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from trials import pairs

from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.reports import report as report_module
from dbo_cli.reports.accumulators import FigureData
from dbo_cli.reports.renderers import headline, to_csv, to_html, to_json, to_text
from dbo_cli.reports.report import (
    Expected,
    LogReport,
    Report,
    ReportOptions,
    SummaryExpected,
    check_limits,
    common_unit,
    digits,
    evaluate,
)
from dbo_cli.reports.sample_pairs import rows_to_read

PAPER = Path(
    os.environ.get(
        "DBO_PAPER_DATA", Path(__file__).parents[2] / "shared" / "data" / "paper"
    )
)


def blocks_of(desired, measured, chunk=1000, time=None):
    for start in range(0, len(desired), chunk):
        stop = min(start + chunk, len(desired))
        clock = None if time is None else time[start:stop]
        yield pairs(
            range(start + 1, stop + 1), desired[start:stop], measured[start:stop], clock
        )


def sine(samples=1000, period=200.0):
    return 20.0 * np.sin(2.0 * np.pi * np.arange(samples) / period)


def report_of(errors, options=None, unit="um", rate=200.0):
    options = options or ReportOptions()
    logs = [
        evaluate(name, blocks_of(sine(), sine() + error), options, sample_rate=rate)
        for name, error in errors.items()
    ]
    return Report.of(logs, options, unit)


LOG_KEYS = [
    "name",
    "samples",
    "rmse",
    "nrmse_percent",
    "max_abs",
    "max_abs_row",
    "max_abs_time_s",
    "mean",
    "p95_abs",
    "loop_width",
    "loop_width_percent",
    "lag_left_samples",
    "lag_left_s",
    "phase_left_degrees",
    "desired_min",
    "desired_max",
    "lag_samples",
    "lag_s",
    "offset_removed",
    "sample_period_s",
    "not_finite",
    "ratio_to_first",
    "loop_noise",
    "rmse_percent_of_move",
    "rmse_percent_of_range",
    "expected_rmse",
    "half_of_error_first_row",
    "half_of_error_last_row",
    "half_of_error_percent_of_rows",
    "rmse_elsewhere",
    "segments",
]


def test_json_keys_are_a_contract():
    report = report_of({"a.csv": 1.0, "b.csv": 0.25}, ReportOptions(segment="cycles"))
    content = json.loads(to_json(report))
    assert list(content) == ["format", "version", "unit", "compared", "offset_removed", "logs", "notes",
                             "limits", "passed", "warnings"]  # fmt: skip
    assert (content["format"], content["version"], content["unit"]) == (
        "dbo-report",
        1,
        "um",
    )
    assert content["compared"] == ["desired", "measured"]
    assert list(content["logs"][0]) == LOG_KEYS
    part = content["logs"][0]["segments"][0]
    assert list(part) == ["number", "first_row", "last_row", *LOG_KEYS[1:16], "offset_removed", "loop_noise",
                          "frequency_hz"]  # fmt: skip
    assert content["logs"][0]["rmse"] == 1.0
    assert [log["ratio_to_first"] for log in content["logs"]] == [1.0, 0.25]


def test_json_numbers_read_back_exactly():
    report = report_of({"a.csv": np.random.default_rng(0).normal(size=1000)})
    log = json.loads(to_json(report))["logs"][0]
    assert log["rmse"] == report.logs[0].figures.rmse
    assert log["lag_left_samples"] == report.logs[0].figures.lag_left


def test_csv_is_one_line_a_log():
    report = report_of({"a.csv": 1.0, "b, c.csv": 0.5}, rate=None)
    rows = list(csv.DictReader(io.StringIO(to_csv(report))))
    assert list(rows[0]) == [*LOG_KEYS[:-1], "unit"]
    assert [row["name"] for row in rows] == ["a.csv", "b, c.csv"]
    assert (rows[1]["rmse"], rows[1]["lag_left_s"], rows[1]["unit"]) == (
        "0.5",
        "",
        "um",
    )
    assert to_csv(report).count("\n") == 3


def test_text():
    report = report_of({"uncompensated.csv": 1.0, "compensated.csv": -0.25})
    assert to_text(report) == (
        "compensated.csv: 0.25 um RMSE, 4.0 times less than uncompensated.csv\n"
        "\n"
        "Error = measured - desired in um\n"
        "\n"
        "log                samples    RMSE  % move    95 %  largest     mean   ratio\n"
        "uncompensated.csv     1000   1.000   2.500   1.000    1.000    1.000   1.000\n"
        "compensated.csv       1000  0.2500  0.6250  0.2500   0.2500  -0.2500  0.2500\n"
        "\n"
        "Left over: hysteresis (loop: error going down less going up) and delay (lag)\n"
        + to_text(report).partition("(lag)\n")[2]
    )
    head = to_text(report).partition("(lag)\n")[2].splitlines()[0]
    assert head.split("  ")[0] == "log" and head.endswith("phase largest at row")


@pytest.mark.parametrize(
    ("offsets", "sentence"),
    [
        ({"a.csv": 0.5}, "a.csv: 0.50 um RMSE, 1.2 % of the move"),
        (
            {"a.csv": 0.5, "b.csv": 0.0081},
            "b.csv: 0.0081 um RMSE, 62 times less than a.csv",
        ),
        ({"a.csv": 0.5, "b.csv": 0.51}, "b.csv: 0.51 um RMSE, as much as a.csv"),
        ({"a.csv": 0.5, "b.csv": 1.0}, "b.csv: 1.0 um RMSE, 2.0 times more than a.csv"),
        (
            {"a.csv": 1.0, "b.csv": 0.5, "c.csv": 0.1, "d.csv": 0.2},
            "c.csv: 0.10 um RMSE, 10 times less than a.csv",
        ),
        ({"a.csv": 1.0, "b.csv": 0.0}, "b.csv: 0 um RMSE; a.csv: 1.0 um RMSE"),
        ({"a.csv": 0.0, "b.csv": 1.0}, "b.csv: 1.0 um RMSE; a.csv: 0 um RMSE"),
    ],
)
def test_one_sentence_first(offsets, sentence):
    assert headline(report_of(offsets)) == sentence
    assert to_text(report_of(offsets)).splitlines()[0] == sentence


def test_a_name_is_never_cut_in_a_table():
    name = "recordings/2024-05-02/bench-3/a_name_that_needs_a_line_of_its_own.csv"
    lines = to_text(report_of({name: 1.0, "b.csv": 0.5})).splitlines()
    assert lines.count(name) == 2
    assert lines[lines.index(name) + 1].split() == [
        "1000",
        "1.000",
        "2.500",
        "1.000",
        "1.000",
        "1.000",
        "1.000",
    ]
    assert "…" not in "".join(lines)


@pytest.mark.parametrize("segment", [None, "cycles", 1.0])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 12345.678, 1e9])
def test_text_fits_80_columns(segment, scale):
    options = ReportOptions(segment=segment, remove_offset=True)
    name = "recordings/2024-05-02/bench-3/" + "long" * 10 + ".csv"
    rng = np.random.default_rng(4)
    logs = [
        evaluate(
            name,
            blocks_of(sine() * scale, (sine() + rng.normal(size=1000)) * scale),
            options,
            sample_rate=1e4,
        )
        for _ in range(2)
    ]
    text = to_text(Report.of(logs, options, "um"))
    assert max(map(len, text.splitlines())) <= 80


def test_undefined_figures_are_null_and_said():
    options = ReportOptions()
    flat = evaluate(
        "flat.csv", blocks_of(np.full(100, 2.0), np.linspace(1.9, 2.1, 100)), options
    )
    report = Report.of([flat], options, None)
    log = json.loads(to_json(report))["logs"][0]
    assert (log["nrmse_percent"], log["loop_width"], log["lag_left_samples"]) == (
        None,
        None,
        None,
    )
    assert log["samples"] == 100
    assert report.notes == [
        "flat.csv: desired never changes, so NRMSE, loop width and lag are undefined"
    ]
    assert "Note: flat.csv: desired never changes" in to_text(report)
    assert "(unit not known)" in to_text(report)


def test_ratio_to_a_perfect_first_log_is_undefined():
    assert [log.ratio_to_first for log in report_of({"a": 0.0, "b": 1.0}).logs] == [
        None,
        None,
    ]


def test_rows_that_are_not_numbers_are_said():
    measured = sine()
    measured[5] = np.nan
    log = evaluate("a.csv", blocks_of(sine(), measured), ReportOptions())
    assert log.notes == (
        "a.csv: 1 sample without a number in desired or measured left out",
    )


def test_a_column_without_any_number():
    nothing = np.full(1000, np.nan)
    with pytest.raises(InputError) as caught:
        evaluate("a.csv", blocks_of(sine(), nothing), ReportOptions())
    assert str(caught.value) == (
        "a.csv: measured holds no number in 1000 rows (choose another column with `measured`)"
    )
    with pytest.raises(InputError) as caught:
        evaluate("a.csv", blocks_of(nothing, nothing), ReportOptions())
    assert str(caught.value) == (
        "a.csv: no row has a number in both desired and measured (choose other columns or `rows`)"
    )


def test_automatic_lag_is_said():
    desired = sine(3000)
    log = evaluate(
        "a.csv", blocks_of(desired[10:], desired[7:-3]), ReportOptions(lag="auto")
    )
    assert log.lag == 3
    assert log.notes == ("a.csv: measured follows best at a lag of 3 samples",)
    assert log.figures.rmse == 0.0
    assert log.record()["lag_samples"] == 3


@pytest.mark.parametrize("segment", [None, "cycles", 0.7])
@pytest.mark.parametrize("chunk", [1, 77, 100000])
def test_chunk_size_does_not_matter(segment, chunk):
    rng = np.random.default_rng(8)
    measured = sine() + rng.normal(size=1000)
    options = ReportOptions(lag=2, remove_offset=True, segment=segment)
    time = np.arange(1000) / 200.0
    whole = evaluate("a.csv", blocks_of(sine(), measured, 1000, time), options)
    assert evaluate("a.csv", blocks_of(sine(), measured, chunk, time), options) == whole


def test_segments_add_up():
    rng = np.random.default_rng(9)
    log = evaluate(
        "a.csv",
        blocks_of(sine(), sine() + rng.normal(size=1000)),
        ReportOptions(segment="cycles"),
    )
    parts = [part.figures for part in log.segments]
    assert sum(part.samples for part in parts) == 1000
    square = sum(part.samples * part.rmse**2 for part in parts) / 1000
    assert square == pytest.approx(log.figures.rmse**2, rel=1e-12)
    assert [part.number for part in log.segments] == list(range(1, len(parts) + 1))
    assert log.segments[0].first_row == 1
    assert log.segments[-1].last_row == 1000


def test_frames():
    report = report_of({"a.csv": 1.0, "b.csv": 0.5}, ReportOptions(segment="cycles"))
    frame = report.to_frame()
    assert frame.loc["b.csv", "rmse"] == 0.5
    assert list(frame.columns) == LOG_KEYS[1:-1]
    parts = report.segments_to_frame()
    assert parts.index.names == ["name", "number"]
    assert parts.loc[("b.csv", 2), "rmse"] == 0.5
    assert report_of({"a.csv": 1.0}).segments_to_frame().empty


class TestLimits:
    def test_met(self):
        check_limits(
            report_of({"a.csv": 1.0}), max_rmse=1.0, max_abs=1.5, max_nrmse_percent=2.5
        )
        check_limits(report_of({"a.csv": 1.0}))

    def test_missed(self):
        report = report_of({"a.csv": 0.1, "b.csv": 1.0})
        with pytest.raises(LimitError) as caught:
            check_limits(report, max_rmse=0.58)
        assert (
            str(caught.value)
            == "b.csv: RMSE 1 um is above the limit of 0.58 um by 0.42 (`max_rmse`)"
        )
        assert caught.value.exit_code == 3
        with pytest.raises(LimitError) as caught:
            check_limits(report, max_abs=0.05)
        assert str(caught.value) == (
            "a.csv: largest error 0.1 um is above the limit of 0.05 um by 0.05 (`max_abs`); 1 more missed"
        )
        with pytest.raises(LimitError) as caught:
            check_limits(report, max_nrmse_percent=1.0)
        assert str(caught.value) == (
            "b.csv: RMSE 2.5 % of the move is above the limit of 1 % of the move by 1.5 (`max_nrmse_percent`)"
        )

    def test_that_cannot_be_judged_is_not_passed(self):
        options = ReportOptions()
        flat = evaluate("flat.csv", blocks_of(np.ones(9), np.ones(9)), options)
        with pytest.raises(LimitError) as caught:
            check_limits(Report.of([flat], options, "um"), max_nrmse_percent=5.0)
        assert (
            str(caught.value)
            == "flat.csv: RMSE is undefined, so `max_nrmse_percent` 5 is not met"
        )


def test_one_report_speaks_one_unit():
    assert common_unit([("a", "um"), ("b", None), ("c", "um")]) == "um"
    assert common_unit([("a", None)]) is None
    with pytest.raises(InputError) as caught:
        common_unit([("a.csv", "um"), ("b.csv", "nm")])
    assert str(caught.value) == (
        "b.csv: is in nm, but a.csv in um (one report speaks one unit: convert one of them)"
    )


def test_too_many_segments(monkeypatch):
    assert report_module.MOST_SEGMENTS == 10_000
    # ten thousand of them take seconds to find
    monkeypatch.setattr(report_module, "MOST_SEGMENTS", 50)
    desired = np.tile([0.0, 1.0], 53)
    with pytest.raises(
        UsageError,
        match=r"^a\.csv: more than 50 segments \(`segment` with more SECONDS\)$",
    ):
        evaluate(
            "a.csv", blocks_of(desired, desired, 30), ReportOptions(segment="cycles")
        )
    enough = evaluate(
        "a.csv",
        blocks_of(desired[:100], desired[:100], 30),
        ReportOptions(segment="cycles"),
    )
    assert len(enough.segments) <= 50


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (0.0, "0"),
        (1.6790697, "1.679"),
        (-96.222, "-96.22"),
        (12345.6, "12346"),
        (999999.9, "1000000"),
        (1234.0, "1234"),
        (0.001234, "0.001234"),
        (1.5e-7, "1.500e-07"),
        (2.5e9, "2.500e+09"),
    ],
)
def test_digits(value, text):
    assert digits(value) == text


@pytest.mark.skipif(
    not (PAPER / "uncompensated.dat").exists(),
    reason="the authors' recordings are not there",
)
def test_published_figure():
    table = np.loadtxt(PAPER / "uncompensated.dat", usecols=(8, 4))[5051:6052]
    log = evaluate(
        "uncompensated.dat",
        blocks_of(*table.T),
        ReportOptions(lag=1, remove_offset=True),
    )
    assert log.figures.samples == 1000
    assert log.figures.rmse == pytest.approx(1.6791, abs=5e-4)


class TestRowsThatCount:
    """A model's prediction depends on all rows before: it is run from the first, and some rows count."""

    def blocks(self, chunk, time=None):
        rng = np.random.default_rng(3)
        return blocks_of(sine(), sine() + rng.normal(size=1000), chunk, time)

    @pytest.mark.parametrize("lag", [0, 3, -3])
    @pytest.mark.parametrize(
        "rows", [(1, None), (101, 600), (600, 601), (990, None), (5, 5)]
    )
    def test_figures_are_those_of_the_rows_alone(self, rows, lag):
        first, last = rows
        read = rows_to_read(rows, lag)
        part = slice(read[0] - 1, read[1])
        whole = next(self.blocks(1000))
        cut = pairs(
            range(1, 1001)[part],
            whole.values["desired"][part],
            whole.values["measured"][part],
        )
        options = ReportOptions(lag=lag)
        expected = evaluate("a.csv", [cut], options)
        for chunk in (1, 7, 1000):
            found = evaluate("a.csv", self.blocks(chunk), options, score_rows=rows)
            assert found.figures == expected.figures
        assert found.figures.samples <= (1000 if last is None else last - first + 1)

    def test_nothing_behind_the_last_row_is_read(self):
        given = 0

        def blocks():
            nonlocal given
            for block in self.blocks(10):
                given += 1
                yield block

        evaluate("a.csv", blocks(), ReportOptions(lag=2), score_rows=(20, 40))
        assert given == 5

    def test_rows_that_are_not_there(self):
        with pytest.raises(InputError):
            evaluate(
                "a.csv", self.blocks(100), ReportOptions(), score_rows=(2000, None)
            )

    def test_an_automatic_lag_is_that_of_the_rows(self):
        desired = sine(3000)
        log = evaluate(
            "a.csv",
            blocks_of(desired[10:], desired[7:-3]),
            ReportOptions(lag="auto"),
            score_rows=(500, 2000),
        )
        assert (log.lag, log.figures.samples, log.figures.rmse) == (3, 1498, 0.0)


class TestConditioningSweep:
    """Rows before time 0 say nothing about tracking, and their range is not that of the trajectory."""

    time = np.arange(1000) / 100.0 - 4.0
    wanted = np.where(time < 0.0, 5.0 * sine(), sine())
    measured = wanted + np.where(time < 0.0, 3.0, 0.5)

    def log(self, chunk=100, time=None, **options):
        clock = self.time if time is None else time
        return evaluate(
            "a.csv",
            blocks_of(self.wanted, self.measured, chunk, clock),
            ReportOptions(),
            **options,
        )

    @pytest.mark.parametrize("chunk", [1, 7, 400, 1000])
    def test_it_takes_no_part(self, chunk):
        log = self.log(chunk)
        assert (log.figures.samples, log.figures.rmse) == (600, 0.5)
        assert log.figures.max_abs_row > 400
        assert log.figures.desired_max == 20.0
        assert log.notes == (
            "a.csv: 400 rows before time 0, on the way to the move, left out",
            "a.csv: without the mean error 0 % of the RMSE is left: where the mean is the sensor's zero, "
            "`remove_offset` takes it off",
        )
        assert log == self.log(100)

    def test_figures_show_the_trajectory_alone(self):
        figure_data = FigureData()
        self.log(figure_data=figure_data)
        assert figure_data.samples == 600
        assert float(figure_data.against_time("error").x[0]) == 0.0

    def test_it_counts_where_it_is_asked_for(self):
        assert self.log(count_sweep=True).figures.samples == 1000
        assert self.log(score_rows=(1, None)).figures.samples == 1000
        assert self.log(score_rows=(301, None)).figures.samples == 700
        assert self.log(count_sweep=True).notes == ()

    def test_a_log_that_ends_before_zero_or_knows_no_time_is_counted(self):
        assert self.log(time=self.time - 20.0).figures.samples == 1000
        assert self.log(time=self.time - 20.0).notes == ()
        log = evaluate("a.csv", blocks_of(self.wanted, self.measured), ReportOptions())
        assert log.figures.samples == 1000

    def test_a_sweep_without_numbers_is_left_out_too(self):
        wanted = np.where(self.time < 0.0, np.nan, self.wanted)
        log = evaluate(
            "a.csv", blocks_of(wanted, self.measured, 100, self.time), ReportOptions()
        )
        assert (log.figures.samples, log.figures.not_finite) == (600, 0)

    def test_a_fault_of_the_log_is_told_all_the_same(self):
        def broken():
            yield from blocks_of(
                self.wanted[:300], self.measured[:300], 100, self.time[:300]
            )
            raise InputError("a.csv:302: no number")

        with pytest.raises(InputError, match=r"^a\.csv:302: no number$"):
            evaluate("a.csv", broken(), ReportOptions())


def test_csv_keeps_the_segments():
    report = report_of({"a.csv": 1.0, "b.csv": 0.5}, ReportOptions(segment=1.0))
    rows = list(csv.DictReader(io.StringIO(to_csv(report))))
    assert list(rows[0])[-4:] == ["unit", "segment", "first_row", "last_row"]
    assert [row["segment"] for row in rows] == ["", "1", "2", "3", "4", "5"] * 2
    assert [row["name"] for row in rows] == ["a.csv"] * 6 + ["b.csv"] * 6
    assert (rows[8]["rmse"], rows[8]["first_row"], rows[8]["last_row"]) == (
        "0.5",
        "201",
        "400",
    )
    assert (
        rows[8]["unit"] == "um"
        and rows[8]["lag_samples"] == ""
        and rows[6]["lag_samples"] == "0"
    )


@pytest.mark.parametrize(
    "name", ["=cmd|' /C calc'!A1.csv", "+1.csv", "-1+2.csv", "@SUM(A1).csv"]
)
def test_no_name_is_a_formula_in_a_spreadsheet(name):
    rows = list(csv.reader(io.StringIO(to_csv(report_of({name: 1.0}, unit=name)))))
    assert rows[1][0] == f"'{name}"
    assert rows[1][-1] == f"'{name}"
    assert list(csv.reader(io.StringIO(to_csv(report_of({"-": 1.0})))))[1][0] == "-"


def test_names_and_units_obey_no_terminal():
    report = report_of(
        {"\x1b[1mred\x07\u202e.csv\ud800\x9b2J": 1.0}, unit="u\x1b]0;m\n"
    )
    assert (report.logs[0].name, report.unit) == ("[1mred .csv 2J", "u ]0;m")
    for text in (to_text(report), to_csv(report), to_json(report)):
        assert not any(sign in text for sign in "\x1b\x07\u202e\ud800\x9b")
        assert "\\u001b" not in text
        text.encode()


def test_wide_letters_keep_their_columns():
    report = report_of({"駆動電圧の記録.csv": 1.0, "b.csv": 0.5})
    table = to_text(report).split("\n\n")[2].splitlines()
    wide = [
        len(line) + sum(unicodedata.east_asian_width(sign) in "WF" for sign in line)
        for line in table
    ]
    assert len(set(wide)) == 1


@pytest.mark.parametrize("step", [1e-300, 1e-3, 1e306])
@pytest.mark.parametrize("scale", [1e-300, 1e-60, 1.0, 1e69])
@pytest.mark.parametrize("gain", [1e-60, 0.9, 1e308])
def test_no_scale_writes_what_is_no_number(scale, gain, step):
    desired, measured = (
        sine() * scale / 20.0,
        np.roll(sine(), 20) * min(scale * gain, 1e69) / 20.0,
    )
    time = (
        np.arange(1000) * step
        if step < 1.0
        else np.linspace(-1.0, 1.0, 1000) * 1e308 / 2.0
    )
    logs = [
        evaluate(
            name,
            blocks_of(desired, values, 1000, time),
            ReportOptions(lag=lag),
            count_sweep=True,
        )
        for name, values, lag in (("a", desired * (1.0 + 1e-9), 0), ("b", measured, 3))
    ]
    report = Report.of(logs, ReportOptions(), "um")
    for text in (to_json(report), to_csv(report), to_text(report)):
        assert "nan" not in text.lower() and "inf" not in text.lower()


def late_and_noisy() -> Report:
    """Return a report of one log: late by three samples, a loop of 0.8 um, three rows without a number."""
    desired = sine()
    noise = 0.02 * np.random.default_rng(3).normal(size=desired.size)
    direction = np.sign(np.gradient(desired))
    measured = np.roll(desired, 3) + noise + 0.8 * direction
    measured[[10, 500, 900]] = np.nan
    options = ReportOptions(segment=2.0)
    log = evaluate("a.csv", blocks_of(desired, measured), options, sample_rate=200.0)
    return Report.of([log], options, "um")


def test_every_figure_of_a_table_is_the_one_of_its_column():
    report = late_and_noisy()
    log = json.loads(to_json(report))["logs"][0]
    assert log["not_finite"] == 3
    assert log["p95_abs"] < log["max_abs"]
    shown = [
        digits(log[key])
        for key in ("rmse", "nrmse_percent", "p95_abs", "max_abs", "mean")
    ]
    lines = to_text(report).splitlines()
    errors = next(line for line in lines if line.startswith("a.csv   "))
    assert errors.split() == ["a.csv", str(log["samples"]), *shown]
    left = [line for line in lines if line.startswith("a.csv   ")][1]
    assert left.split() == [
        "a.csv",
        digits(log["loop_width"]),
        digits(log["loop_width_percent"]),
        digits(log["loop_noise"], 2),
        digits(log["lag_left_samples"], 3),
        digits(log["lag_left_s"], 3),
        digits(log["phase_left_degrees"], 3) + "°",
        str(log["max_abs_row"]),
    ]
    rows = [line.split()[:2] for line in lines if re.match(r"[123] ", line)]
    assert rows == [["1", "1:400"], ["2", "401:800"], ["3", "801:1000"]]
    assert log["lag_left_s"] == pytest.approx(log["lag_left_samples"] / 200.0)
    for part in log["segments"]:
        assert part["loop_noise"] < 0.1 < abs(part["loop_width"])


def test_the_page_gives_the_delay_in_milliseconds():
    report = late_and_noisy()
    log = json.loads(to_json(report))["logs"][0]
    page = to_html(report, [[]], program="dbo")
    assert "Delay left (ms)" in page
    milliseconds = digits(1e3 * log["lag_left_s"], 3)
    assert float(milliseconds) == pytest.approx(6.9, abs=0.1)
    assert f">{milliseconds}<" in page


def test_percent_of_the_range_is_the_rmse_over_the_range_of_the_model():
    log = late_and_noisy().logs[0]
    expected = Expected(0.5, 0.4, 80.0, "model.json")
    judged = LogReport("a.csv", log.figures, 0, expected=expected)
    assert judged.percent_of_range == pytest.approx(100.0 * log.figures.rmse / 80.0)
    assert log.percent_of_range is None


@pytest.mark.parametrize(
    ("high", "same"), [(100.0, True), (100.9, True), (101.2, False), (98.8, False)]
)
def test_a_summary_is_of_a_move_whose_ends_lie_within_a_hundredth(high, same):
    stated = SummaryExpected(0.5, 0.4, 120.0, "d.json", move_range=(0.0, 100.0))
    expected, warning = stated.of_move(0.0, high, " um")
    if same:
        assert warning is None
        assert expected.source == "d.json for this move"
    else:
        assert f"a move from 0 to 100 um, the one compared has 0 to {high:g} um" in (
            warning
        )
