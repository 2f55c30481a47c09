"""Any program's drive against limits, and a recording against the drive that was to be played."""

import json
import math

import numpy as np
import pytest

from dbo_cli.drive import Limits
from dbo_cli.drive.check import check_drive, check_played
from dbo_cli.errors import InputError, LimitError

STEP = 1e-3


def limits(low=-math.inf, high=math.inf, slew=None) -> Limits:
    return Limits((low, high), (low, high), (low, high), slew, "V")


def drive(rows: int = 500) -> tuple[np.ndarray, np.ndarray]:
    time = STEP * np.arange(rows)
    return time, 50 - 40 * np.cos(2 * np.pi * 3 * time) + 5 * np.sin(
        2 * np.pi * 17 * time
    )


def test_figures_and_a_pass():
    time, voltage = drive()
    checked = check_drive(voltage, time, limits(0, 100, 2000))
    assert not checked.problems
    assert (checked.rows, checked.least, checked.greatest) == (
        500,
        voltage.min(),
        voltage.max(),
    )
    assert checked.fastest == pytest.approx(np.abs(np.diff(voltage)).max() / STEP)
    checked.require_passed()
    assert json.loads(checked.json())["passed"] is True


@pytest.mark.parametrize("row", [0, 1, 250, 499])
@pytest.mark.parametrize("value", [100.0000001, -1e-9, math.nan, math.inf])
def test_a_row_outside_is_named(row, value):
    time, voltage = drive()
    voltage[row] = value
    checked = check_drive(voltage, time, limits(0, 100))
    assert f"row {row + 1}:" in checked.problems[0]
    with pytest.raises(LimitError):
        checked.require_passed()


def test_a_step_too_fast_is_named_also_the_first_and_the_seam():
    time, voltage = drive()
    fastest = np.abs(np.diff(voltage)).max() / STEP
    assert not check_drive(
        voltage, time, limits(0, 100, fastest * (1 + 1e-12))
    ).problems
    assert check_drive(voltage, time, limits(0, 100, fastest * 0.999)).problems
    assert not check_drive(
        voltage, time, limits(0, 100, 2000), start=voltage[0] + 1.9
    ).problems
    assert (
        "row 1:"
        in check_drive(
            voltage, time, limits(0, 100, 2000), start=voltage[0] + 2.1
        ).problems[0]
    )
    assert (
        not check_drive(
            voltage[:333], time[:333], limits(0, 100, 2000), loop=True
        ).problems
        == []
    )
    open_loop = voltage.copy()
    open_loop[-1] = open_loop[-2]
    assert check_drive(
        np.linspace(0, 50, 100), time[:100], limits(0, 100), loop=True
    ).problems


def test_a_start_outside_is_a_problem_whatever_follows():
    time, voltage = drive()
    assert check_drive(voltage, time, limits(-20, 120), start=300.0).problems
    inwards = np.linspace(300.0, 100.0, 200)
    assert check_drive(inwards, time[:200], limits(-20, 120), start=300.0).problems


def test_odd_clocks_are_problems():
    time, voltage = drive()
    for row, shift in ((100, -5e-3), (100, -STEP)):
        odd = time.copy()
        odd[row] += shift
        assert check_drive(voltage, odd, limits()).problems
    gap = time.copy()
    gap[300:] += 0.02
    assert "row 301" in check_drive(voltage, gap, limits()).problems[0]
    with pytest.raises(InputError):
        check_drive(voltage, None, limits(slew=5.0))
    assert check_drive(voltage, None, limits(), doubts=["line 3: cut"]).problems == [
        "line 3: cut"
    ]


@pytest.mark.parametrize("late", [0, 37, -20])
def test_a_recording_that_is_late_or_early(late):
    _, voltage = drive()
    recorded = (
        np.roll(voltage, late)[: 500 - abs(late)]
        if late <= 0
        else np.r_[np.full(late, voltage[0]), voltage]
    )
    checked = check_drive(recorded, STEP * np.arange(recorded.size), limits())
    check_played(checked, voltage, recorded, (STEP, STEP))
    assert checked.played is not None
    assert checked.played.lag_rows == late
    assert checked.played.rows == min(500, 500 - max(0, -late))


def test_what_was_played_differs():
    time, voltage = drive()
    rng = np.random.default_rng(1)
    noisy = voltage + 0.02 * rng.standard_normal(voltage.size)
    for recorded, passes in (
        (noisy, True),
        (np.interp(time - 0.4 * STEP, time, voltage), True),
        (1.01 * voltage, False),
        (voltage + 0.5, False),
        (np.clip(voltage, 0, 80), False),
        (voltage[:400], False),
        (rng.standard_normal(500), False),
    ):
        checked = check_drive(recorded, time[: recorded.size], limits())
        check_played(checked, voltage, recorded, (STEP, STEP))
        assert (not checked.problems) == passes, checked.problems
    assert checked.played is not None


def test_a_recording_at_another_rate_is_compared_in_time():
    time, voltage = drive()
    slow = np.interp(np.arange(0, time[-1], 2.5 * STEP), time, voltage)
    checked = check_drive(slow, None, limits())
    check_played(checked, voltage, slow, (STEP, 2.5 * STEP), tolerance=0.5)
    assert not checked.problems
    assert checked.played is not None and checked.played.gain == pytest.approx(
        1.0, abs=1e-3
    )
