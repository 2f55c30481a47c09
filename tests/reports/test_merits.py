"""Figures of merit on arrays that can be worked out by hand."""

import math

import numpy as np
import pytest

from dbo_cli.reports import Pair
from dbo_cli.reports.merits import merits


def figures_of(desired, measured):
    return merits(Pair("log", np.asarray(desired), np.asarray(measured)))


def test_values_by_hand():
    figures = figures_of([0.0, 2.0, 4.0, 2.0], [1.0, 2.0, 1.0, 2.0])
    assert figures["rmse"] == pytest.approx(math.sqrt(10.0 / 4.0), rel=1e-15)
    assert figures["nrmse_percent"] == pytest.approx(100.0 * math.sqrt(2.5) / 4.0)
    assert (figures["max_abs"], figures["max_abs_row"]) == (3.0, 3)
    assert figures["mean"] == -0.5
    assert figures["p95_abs"] == 3.0
    assert (figures["desired_min"], figures["desired_max"]) == (0.0, 4.0)
    assert figures["offset_removed"] == 0.0


def test_no_move_no_percentage():
    figures = figures_of(np.ones(5), np.zeros(5))
    assert figures["rmse"] == 1.0
    undefined = (
        "nrmse_percent loop_width loop_width_percent lag_left_samples lag_left_s"
    )
    for key in undefined.split():
        assert figures[key] is None


def test_one_row():
    figures = figures_of([3.0], [5.0])
    assert (figures["samples"], figures["rmse"]) == (1, 2.0)
    assert figures["loop_width"] is None
