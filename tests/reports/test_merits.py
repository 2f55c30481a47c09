"""Figures of merit on arrays that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dbo_cli.reports.merits import directions, lag_left, loop_width, merits


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


def test_p95_is_a_value_that_95_percent_do_not_exceed():
    error = np.arange(1.0, 101.0)
    assert merits(np.zeros(100), error).p95_abs == 95.0


def test_no_move_no_percentage():
    figures = merits(np.ones(5), np.zeros(5))
    assert figures.rmse == 1.0
    assert figures.nrmse_percent is None
    assert figures.loop_width is None and figures.loop_width_percent is None
    assert figures.lag is None


def test_one_row():
    figures = merits(np.array([3.0]), np.array([5.0]))
    assert (figures.samples, figures.rmse, figures.loop_width) == (1, 2.0, None)


def triangle(cycles: int, rows: int) -> np.ndarray:
    """A triangle of so many cycles from 0 to 1 and back."""
    up = np.arange(rows) / rows
    return np.tile(np.concatenate([up, 1.0 - up]), cycles)


def test_directions_with_noise_and_rests():
    rng = np.random.default_rng(5)
    clean = np.repeat(triangle(3, 200), 3)  # held: three rows a value
    ways = directions(clean + 0.002 * rng.standard_normal(len(clean)))
    slope = np.gradient(triangle(3, 200)).repeat(3)
    known = ways != 0
    assert known.mean() > 0.9
    assert (np.sign(slope[known]) == ways[known]).mean() > 0.97


@pytest.mark.parametrize("width", [0.2, -0.3])
def test_loop_width_is_falling_less_rising(width):
    desired = triangle(4, 200)
    rising = np.gradient(desired) > 0.0
    error = np.where(rising, 0.0, width) + 0.1 * desired
    assert loop_width(desired, error) == pytest.approx(width, rel=0.05)


def test_loop_width_averages_noise():
    rng = np.random.default_rng(7)
    desired = triangle(20, 500)
    error = 0.05 * rng.standard_normal(len(desired))
    assert abs(loop_width(desired, error)) < 0.02


@pytest.mark.parametrize("lag", [-3.4, 0.0, 0.25, 12.0])
def test_lag_of_a_sine_is_exact(lag):
    rows = np.arange(3000.0)
    desired = 5.0 + np.sin(2.0 * np.pi * rows / 300.0)
    measured = 1.3 * np.sin(2.0 * np.pi * (rows - lag) / 300.0)
    assert lag_left(desired, measured) == pytest.approx(lag, abs=1e-6)
