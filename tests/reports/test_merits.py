"""Figures of merit on arrays that can be worked out by hand."""

import math

import numpy as np
import pytest

from dbo_cli.reports.merits import merits


def test_values_by_hand():
    desired = np.array([0.0, 2.0, 4.0, 2.0])
    measured = np.array([1.0, 2.0, 1.0, 2.0])
    figures = merits(desired, measured)
    assert figures.rmse == pytest.approx(math.sqrt(10.0 / 4.0), rel=1e-15)
    assert figures.nrmse_percent == pytest.approx(100.0 * math.sqrt(2.5) / 4.0)
    assert (figures.max_abs, figures.max_abs_index) == (3.0, 2)
    assert figures.mean == -0.5
    assert figures.p95_abs == 3.0
    assert (figures.desired_min, figures.desired_max) == (0.0, 4.0)
    assert figures.offset == 0.0


def test_no_move_no_percentage():
    figures = merits(np.ones(5), np.zeros(5))
    assert figures.rmse == 1.0
    assert figures.nrmse_percent is None
    assert figures.loop_width is None and figures.loop_width_percent is None
    assert figures.lag is None


def test_one_row():
    figures = merits(np.array([3.0]), np.array([5.0]))
    assert (figures.samples, figures.rmse, figures.loop_width) == (1, 2.0, None)
