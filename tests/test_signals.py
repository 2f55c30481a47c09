"""Even clocks, noise, turns, and the lag between two signals."""

import numpy as np
import pytest

from dbo_cli.alignment import PLAYS, loop_columns
from dbo_cli.signals import between, even, lag, noise, usual_step

ROWS = np.arange(20_000.0)


def drive_of(seed, rows=6_000):
    """Return a smooth drive that repeats nowhere."""
    steps = np.random.default_rng(seed).standard_normal(rows + 40)
    return np.convolve(np.cumsum(steps), np.hanning(41) / 20.0, "valid")


@pytest.mark.parametrize(
    "stamps",
    [
        [0.0, 1.0, 3.0],
        [0.0, 0.0, 0.0],
        [0.0, 1.0, 0.5],
        [0.0, 1.00123, 2.0, 3.0],
        np.round(np.arange(100) / 30.0, 1),  # the decimal is no small part of a step
    ],
)
def test_uneven_stamps_have_no_step(stamps):
    assert even(np.asarray(stamps)) is None


def test_a_clock_that_goes_on_keeps_its_step():
    assert even(np.array([9.0, 10.0]), 1.0) == 1.0
    assert even(np.array([9.0, 11.0]), 1.0) is None
    assert even(np.array([9.0]), 1.0) == 1.0


def test_jumps_turns_and_spikes_are_no_noise():
    rng = np.random.default_rng(2)
    staircase = np.repeat(rng.uniform(size=40), 500)
    triangle = np.abs(ROWS % 1000 - 500.0)
    spiked = triangle + 100.0 * (rng.uniform(size=ROWS.size) < 0.01)
    assert [noise(values) for values in (staircase, triangle)] == [0.0, 0.0]
    assert noise(spiked) < 1e-9
    white = 0.3 * rng.standard_normal(ROWS.size)
    assert noise(triangle + white) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("shift", [-1234.3, -2.5, 0.004, 17.25, 830.77])
def test_a_lag_is_found_to_a_hundredth_of_a_row(shift):
    early, rows = drive_of(3), np.arange(5_000.0)
    inside = (rows - shift >= 0.0) & (rows - shift <= len(early) - 1)
    late = 5.0 + 3.0 * between(early, (rows - shift)[inside])
    truth = shift - rows[inside][0]
    found = lag(late, early)
    assert found is not None and found.rival is None
    assert found.seconds == pytest.approx(truth, abs=1e-6)
    white = 1e-3 * np.ptp(late) * np.random.default_rng(4).standard_normal(late.size)
    noisy = lag(late + white, early, 1e-3)
    assert abs(noisy.seconds - 1e-3 * truth) < 1e-5 + 4.0 * noisy.deviation
    assert noisy.deviation < 2e-5


def test_a_signal_that_repeats_has_a_rival_and_one_that_rests_has_no_lag():
    sine = np.sin(2.0 * np.pi * np.arange(5_000) / 500)
    found = lag(sine[100:4_100], sine)
    assert found is not None and found.rival is not None
    assert found.seconds == pytest.approx(-100.0)
    assert abs(found.rival + 100.0) % 500.0 == pytest.approx(0.0, abs=0.1)
    assert lag(np.zeros(100), sine) is None
    assert lag(sine, np.ones(100)) is None


def test_a_ramp_against_its_mirror_image_divides_by_no_zero():
    ramp = np.linspace(0.0, 1.0, 50)
    with np.errstate(invalid="raise"):
        lag(ramp, -ramp)


def test_short_signals_are_laid_over_by_whole_rows():
    found = lag(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0, 2.0]))
    assert found.seconds == -1.0 and np.isinf(found.deviation)


@pytest.mark.parametrize("rows", [2, 3, 10, 101, 1000])
def test_plays_beside_a_lag_are_those_of_walking_row_by_row(rows):
    rng = np.random.default_rng(rows)
    signal = np.cumsum(rng.standard_normal(rows))
    begin, columns = loop_columns(signal)
    level = ((signal - signal.min()) / np.ptp(signal))[begin:]
    half = np.minimum(PLAYS, 0.5)
    state = np.clip(level[0], half, 1.0 - half)
    for row, value in enumerate(level):
        state = np.clip(state, value - PLAYS, value + PLAYS)
        assert np.array_equal(columns[row, 3:], state)


def test_the_usual_step_leaves_out_stamps_that_repeat():
    assert usual_step(np.array([0.0, 0.2, 0.0, 0.1, 0.2, 5.0])) == 0.2
    assert usual_step(np.zeros(3)) == usual_step(np.empty(0)) == 0.0
