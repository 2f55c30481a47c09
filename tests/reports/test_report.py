"""Reports as values, JSON, CSV, text, page and figures."""

import numpy as np

from dbo_cli.reports import Pair, Report
from dbo_cli.reports.plots import draw, figure_of, file_stems
from dbo_cli.reports.words import digits


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
