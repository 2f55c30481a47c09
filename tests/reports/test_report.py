"""Reports as values, JSON, CSV, text, page and figures."""

from __future__ import annotations

import csv
import io
import json
from html.parser import HTMLParser

import numpy as np
import pytest

import dbo_cli as dbo
from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.reports import Expected, Pair, Report, expected_in
from dbo_cli.reports.plots import SCHEME, draw, envelope, file_stems, plots_of_report
from dbo_cli.reports.render import digits, short_name

LOG_KEYS = """name samples rmse nrmse_percent max_abs max_abs_row max_abs_time_s mean p95_abs
loop_width loop_width_percent lag_left_samples lag_left_s desired_min desired_max lag_samples lag_s
offset_removed sample_period_s not_finite clock_offset_s ratio_to_first expected_rmse""".split()
VOID = {"meta", "link", "br", "path", "use", "rect", "line", "image"}


def signals(rows=2000):
    rng = np.random.default_rng(19)
    time = np.arange(rows) / 500.0
    desired = 40.0 + 30.0 * np.sin(2.0 * np.pi * time)
    first = desired + 2.0 * np.cos(2.0 * np.pi * time) + 0.5
    second = desired + 0.1 * rng.standard_normal(rows)
    return time, desired, first, second


def two_logs(**options):
    time, desired, first, second = signals()
    drive = 1.2 * desired
    pairs = [
        Pair("logs/without.csv", desired, first, time=time, voltage=drive),
        Pair("logs/with <b>&.csv", desired, second, time=time, voltage=drive),
    ]
    return Report.of(pairs, unit="um", voltage_unit="V", **options)


def one_log():
    pair = two_logs().logs[1].pair
    return Report.of([pair], unit="um", voltage_unit="V")


@pytest.fixture(scope="module")
def page_text():
    """The page of two logs, one of them above its limit."""
    expected = Expected(0.1, footer="Limits 0 to 100 V")
    command = "dbo report a.csv -o r.html"
    return two_logs(max_rmse=0.5, command=command, expected=expected).to_html()


class Page(HTMLParser):
    """Checks that every element is closed, and collects texts, ids and references."""

    def __init__(self, text):
        super().__init__()
        self.open, self.texts, self.ids, self.used, self.sources = [], [], [], [], []
        self.cells = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if "id" in values:
            self.ids.append(values["id"])
        for key in ("href", "xlink:href", "src"):
            if key in values:
                self.sources.append(values[key])
        if tag == "td":
            self.cells.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)
        if self.open and self.open[-1] == "td":
            self.cells[-1] += data


def test_library_function():
    time, desired, measured, _ = signals()
    found = dbo.report(desired, measured, time, unit="um")
    error = measured - desired
    assert found.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-14)
    frame = found.to_frame()
    assert list(frame.columns) == LOG_KEYS[1:]
    assert frame.loc["log", "rmse"] == found.rmse
    by_rate = dbo.report(desired, measured, sample_rate=500.0)
    assert by_rate.logs[0].pair.step() == pytest.approx(0.002)
    with pytest.raises(UsageError):
        dbo.report(desired, measured, time, sample_rate=500.0)
    summary = {"expected_rmse": 0.25, "unit": "um", "model": "0123"}
    beside = dbo.report(desired, measured, time, unit="um", expected=summary)
    assert beside.logs[0].expected_rmse == 0.25


def test_json_form():
    content = json.loads(two_logs().render("json"))
    assert list(content) == [
        "format", "version", "unit", "compared", "offset_removed", "logs", "notes",
        "limits", "passed", "warnings",
    ]  # fmt: skip
    assert (content["format"], content["version"]) == ("dbo-report", 1)
    assert content["unit"] == "um"
    assert content["compared"] == ["desired", "measured"]
    assert content["passed"] is None and content["limits"] == []
    for log in content["logs"]:
        assert list(log) == LOG_KEYS
    first, second = content["logs"]
    assert first["ratio_to_first"] == 1.0
    assert second["ratio_to_first"] == pytest.approx(second["rmse"] / first["rmse"])
    assert first["sample_period_s"] == pytest.approx(0.002)
    row = first["max_abs_row"]
    assert first["max_abs_time_s"] == pytest.approx((row - 1) * 0.002)
    assert first["lag_left_s"] == pytest.approx(0.002 * first["lag_left_samples"])
    # numbers read back exactly
    assert first["rmse"] == two_logs().rmse


def test_csv_form():
    rows = list(csv.DictReader(io.StringIO(two_logs().render("csv"))))
    assert list(rows[0]) == [*LOG_KEYS, "unit"]
    assert float(rows[0]["rmse"]) == two_logs().rmse
    assert rows[0]["expected_rmse"] == "" and rows[0]["unit"] == "um"


def test_text_is_a_table_and_few_lines():
    text = two_logs().render("text")
    lines = text.splitlines()
    head = lines[0].split()
    assert head[0] == "log" and "RMSE" in head
    width = lines[0].index("RMSE") + 4
    for line in lines[1:3]:
        assert line[width - 1] != " " and line[width] == " "
    assert len(lines) == 5
    assert max(map(len, lines)) <= 120


def test_digits():
    cases = {1.679: "1.679", 0.0: "0", 12345.678: "12346", 0.012343: "0.01234",
             1.2e-5: "1.200e-05", 3e9: "3.000e+09", -2.5: "-2.500"}  # fmt: skip
    for value, text in cases.items():
        assert digits(value) == text
    assert digits(None) == "-"


def test_limits():
    found = two_logs(max_rmse=0.5, max_nrmse_percent=1.0)
    assert found.passed is False
    verdicts = json.loads(found.render("json"))["limits"]
    assert [verdict["passed"] for verdict in verdicts] == [False, False, True, True]
    assert [verdict["figure"] for verdict in verdicts[:2]] == ["rmse", "nrmse_percent"]
    assert found.render("text").startswith("FAILED\n")
    with pytest.raises(LimitError) as caught:
        found.require_passed()
    assert caught.value.exit_code == 3
    kept = two_logs(max_rmse=5.0)
    assert kept.passed is True
    kept.require_passed()


def test_a_limit_at_the_value_is_kept_and_an_undefined_one_is_missed():
    at = two_logs()
    assert two_logs(max_rmse=at.rmse).verdicts[0].passed
    still = Report.of([Pair("run", np.ones(5), np.ones(5))], max_nrmse_percent=1.0)
    assert still.passed is False


def test_more_than_expected_is_a_warning():
    _, desired, first, second = signals()
    expected = Expected(0.15)
    near, far = Pair("near", desired, second), Pair("far", desired, first)
    assert not Report.of([near], expected=expected).warnings
    found = Report.of([far], expected=expected)
    times = found.rmse / 0.15
    assert f"{times:.2g} times the expected" in found.warnings[0]
    above = Report.of([Pair("above", desired, second + 5.0)], expected=expected)
    assert "`remove_offset`" in above.warnings[0]
    record = found.logs[0].record()
    assert record["expected_rmse"] == 0.15
    assert "expected" in found.render("text")


SUMMARY = {
    "version": 1,
    "format": "dbo-summary",
    "unit": "um",
    "model": "0123456789abcdef",
    "expected_rmse": 0.1,
    "move_range": [10.0, 70.0],
    "move_time": [0.0, 2.0],
    "limits": {"unit": "V", "rating": [0.0, 100.0], "max_slew": 2000.0},
}


def expected_of(folder, **values):
    """Read a summary with other values."""
    path = folder / "summary.json"
    path.write_text(json.dumps(SUMMARY | values))
    return expected_in(str(path), "um")


def test_expected_of_another_move_is_a_warning(tmp_path):
    _, desired, _, second = signals()
    pair = Pair("run", desired, second)
    assert not Report.of([pair], expected=expected_of(tmp_path)).warnings
    another = expected_of(tmp_path, move_range=[0.0, 20.0])
    assert "0 to 20" in Report.of([pair], expected=another).warnings[0]


def test_expected_in_files(tmp_path):
    expected = expected_of(tmp_path)
    assert (expected.rmse, expected.move_time) == (0.1, (0.0, 2.0))
    for words in ("0 to 100 V", "2000", "0123456789ab"):
        assert words in expected.footer
    with pytest.raises(InputError, match="is in nm"):
        expected_of(tmp_path, unit="nm")


def test_page_holds_the_numbers_and_needs_no_other_file(page_text):
    text, found = page_text, two_logs()
    page = Page(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    for source in page.sources:
        assert source.startswith(("#", "data:"))
        if source.startswith("#"):
            assert source[1:] in page.ids
    for log in found.logs:
        assert digits(log.merits.rmse) in page.cells
        assert digits(log.merits.max_abs) in page.cells
    assert "with <b>&.csv" in "".join(page.texts)
    body = "".join(page.texts)
    assert body.index("Failed") < body.index("error 0.")
    assert "dbo report a.csv -o r.html" in body and "Limits 0 to 100 V" in body
    assert "<script" not in text and "http" not in text.replace("http://www.w3.org", "")
    assert "prefers-color-scheme: dark" in text


def test_page_and_figures_follow_the_colour_scheme(page_text):
    text = page_text
    body = text[text.index("<body>") :]
    for color, name in SCHEME.items():
        assert color not in body
        assert f"--{name}: {color}" in text


def test_same_input_same_bytes(tmp_path):
    first, second = one_log(), one_log()
    for form in ("text", "json", "csv", "html"):
        assert first.render(form) == second.render(form)
    one = first.figures(tmp_path / "one")
    two = second.figures(tmp_path / "two")
    assert [path.name for path in one] == [path.name for path in two]
    for a, b in zip(one, two, strict=True):
        assert a.read_bytes() == b.read_bytes()
    names = {path.name for path in one}
    for key in ("follow", "error", "loop", "spectrum"):
        assert {f"with_b_-{key}.png", f"with_b_-{key}.svg"} <= names


def test_figures_name_quantity_and_unit():
    labels = {}
    plots = plots_of_report(two_logs())
    for plot in plots[:4]:
        labels[plot.key] = draw(plot, "inline").decode()
    assert "Drive voltage (V)" in labels["1-without-loop"]
    assert "Displacement (µm)" in labels["1-without-loop"]
    assert "Time (s)" in labels["1-without-follow"]
    assert "Error density (µm/√Hz)" in labels["1-without-spectrum"]
    assert "± RMSE" in labels["1-without-error"]


def test_a_user_s_own_style_changes_nothing():
    import matplotlib

    plot = plots_of_report(two_logs())[1]
    before = draw(plot, "png")
    with matplotlib.rc_context({"lines.linewidth": 9.0, "font.size": 20.0}):
        assert draw(plot, "png") == before
        assert matplotlib.rcParams["font.size"] == 20.0


def test_without_a_clock_rows_are_shown():
    found = Report.of([Pair("run", np.sin(np.arange(200.0) / 9.0), np.zeros(200))])
    alike = Report.of(
        [Pair("run", np.arange(200.0), np.arange(200.0), np.arange(200.0))]
    )
    assert len(plots_of_report(alike)) == 3  # no error, no spectrum
    keys = [plot.key for plot in plots_of_report(found)]
    assert keys == ["run-follow", "run-error", "run-loop"]
    assert "Row" in draw(plots_of_report(found)[0], "inline").decode()
    assert found.logs[0].record()["max_abs_time_s"] is None


def test_envelope_keeps_every_spike():
    y = np.zeros(100_000)
    y[[777, 54_321]] = 5.0, -3.0
    x, shown = envelope(np.arange(100_000.0), y)
    assert len(x) == len(shown) == 2000
    assert (shown.max(), shown.min()) == (5.0, -3.0)


def test_file_stems_differ():
    names = ["a/run.csv", "b/run.csv", "x.h5::/g/one", "", "../../etc", "run.csv.gz"]
    stems = file_stems(names)
    assert len(set(stems)) == len(stems)
    for stem in stems:
        assert stem and "/" not in stem and not stem.startswith(".")
    assert short_name("x" * 100).count("x") < 40
