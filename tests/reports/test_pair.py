"""Rows that count, and recordings matched to a trajectory in another file."""

import numpy as np
import pytest

from dbo_cli.reports import Expected, Pair, Report
from dbo_cli.reports import match as matched


def move(time):
    """A move of 10 s at 50 um; before it two seconds of way in."""
    inside = np.clip(time, 0.0, 10.0)
    fading = 40.0 * np.sin(2.0 * np.pi * 0.7 * inside) * np.exp(-inside / 8.0)
    return 50.0 * np.clip((time + 2.0) / 1.5, 0.0, 1.0) + fading


def match(name, measured, desired, measured_time=None, desired_time=None, **options):
    """Match a recording of these columns."""
    recording = Pair(name, measured, measured, measured_time)
    trajectory = Pair("the trajectory", desired, desired, desired_time)
    return matched(recording, trajectory, **options)


def rmse(pair, **options):
    return Report([pair], unit="um", **options).rmse


def test_rows_before_time_0_take_no_part():
    time = np.arange(-50, 100) / 100.0
    error = np.where(time < 0.0, 9.0, 1.0)
    pair = Pair("run", np.zeros(150), error, time=time)
    assert rmse(pair) == 1.0
    assert rmse(Pair("run", np.zeros(150), error, time=time, rows=(1, 50))) == 9.0
    late = np.where((time < 0.0) | (time > 0.5), 9.0, 1.0)
    expected = Expected(1.0, move_time=(0.0, 0.5))
    # a summary tells the end of the move by the drive's clock; another recorder may count from elsewhere
    shifted = Pair("run", np.zeros(150), late, time=time + 1.0)
    assert rmse(shifted, expected=expected) == rmse(shifted)
    # where all are before 0, they are the move
    assert rmse(Pair("run", np.zeros(50), error[:50], time=time[:50])) == 9.0


def test_match_by_rows_takes_the_trajectory_s_time():
    times = np.arange(90) / 100.0, np.arange(-20, 80) / 100.0
    pair = match("run", np.ones(90), np.zeros(100), *times, by="rows")
    assert len(pair) == 90
    assert pair.time[0] == -0.2


def test_a_trajectory_that_ends_before_time_0_is_matched():
    """It ended in a traceback: there were no rows of a move to look at."""
    time = np.arange(-500, -100) / 100.0
    desired = np.sin(time)
    pair = match("run", desired + 0.1, desired, time, time)
    assert rmse(pair) == pytest.approx(0.1)


@pytest.mark.parametrize("cycles", [1, 6])
def test_a_move_that_fits_at_several_times_is_not_shifted(cycles):
    """A loop that was played longer than its trajectory fits a cycle later as well."""
    time = np.arange(0.0, 4.0, 0.002)
    desired = np.sin(2.0 * np.pi * time)
    clock = np.arange(0.0, 5.0 + cycles, 0.002)
    measured = np.where(clock < 0.5, 0.0, np.sin(2.0 * np.pi * (clock - 0.5)))
    pair = match("run", measured, desired, clock, time)
    assert pair.clock_offset is None and "not sure" in pair.warnings[0]
