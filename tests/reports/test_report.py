"""Reports as values, JSON, CSV, text, page and figures."""

import json

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.reports import Pair, Report, expected_in
from dbo_cli.reports.plots import draw, figure_of, file_stems
from dbo_cli.reports.words import digits, shortened


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
    return Report(pairs, unit="um", voltage_unit="V", **options)


def plots_of(report):
    """Return all figures of a report."""
    return [plot for _, section in report._sections() for plot in section]


def test_digits():
    cases = {1.679: "1.679", 0.0: "0", 12345.678: "12346", 0.012343: "0.01234",
             1.2e-5: "1.200e-05", 3e9: "3.000e+09", -2.5: "-2.500"}  # fmt: skip
    for value, text in cases.items():
        assert digits(value) == text
    assert digits(None) == "-"


def test_a_limit_at_the_value_is_kept_and_an_undefined_one_is_missed():
    at = two_logs()
    assert two_logs(max_rmse=at.rmse).limits[0]["passed"]
    still = Report([Pair("run", np.ones(5), np.ones(5))], max_nrmse_percent=1.0)
    assert still.passed is False


def test_one_row_has_no_loop():
    figures = Report([Pair("run", np.array([3.0]), np.array([5.0]))]).logs[0]
    assert (figures["samples"], figures["rmse"]) == (1, 2.0)
    assert figures["loop_width"] is None


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
    assert not Report([pair], expected=expected_of(tmp_path)).warnings
    another = expected_of(tmp_path, move_range=[0.0, 20.0])
    assert "0 to 20" in Report([pair], expected=another).warnings[0]


def test_expected_in_files(tmp_path):
    expected = expected_of(tmp_path)
    assert (expected.rmse, expected.move_time) == (0.1, (0.0, 2.0))
    assert expected_of(tmp_path, unit="mm").rmse == pytest.approx(100.0)
    with pytest.raises(InputError, match="V cannot be converted to um"):
        expected_of(tmp_path, unit="V")


def test_a_user_s_own_style_changes_nothing():
    import matplotlib

    plot = plots_of(two_logs())[1]
    before = draw(plot, "png")
    with matplotlib.rc_context({"lines.linewidth": 9.0, "font.size": 20.0}):
        assert draw(plot, "png") == before
        assert matplotlib.rcParams["font.size"] == 20.0


def test_without_a_clock_rows_are_shown():
    found = Report([Pair("run", np.sin(np.arange(200.0) / 9.0), np.zeros(200))])
    alike = Report([Pair("run", *[np.arange(200.0)] * 3)])
    assert len(plots_of(alike)) == 3  # no error, no spectrum
    keys = [plot.key for plot in plots_of(found)]
    assert keys == ["run-follow", "run-error", "run-loop"]
    assert figure_of(plots_of(found)[0]).axes[0].get_xlabel() == "Row"
    assert found.logs[0]["max_abs_time_s"] is None


def test_a_long_curve_keeps_every_spike_as_a_picture():
    y = np.zeros(100_000)
    y[[777, 54_321]] = 5.0, -3.0
    long = Report([Pair("run", np.zeros(len(y)), y)])
    curve = figure_of(plots_of(long)[1]).axes[0].get_lines()[0]
    assert curve.get_rasterized()
    assert (curve.get_ydata().max(), curve.get_ydata().min()) == (5.0, -3.0)


def test_file_stems_differ():
    names = ["a/run.csv", "b/run.csv", "x.h5::/g/one", "", "../../etc", "run.csv.gz"]
    stems = file_stems(names)
    assert len(set(stems)) == len(stems)
    for stem in stems:
        assert stem and "/" not in stem and not stem.startswith(".")
    assert shortened("x" * 100).count("x") < 40
