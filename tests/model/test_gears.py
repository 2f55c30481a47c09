"""The kernel against the paper's procedure in exact rationals, gear by gear."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_actuators import DT, random_drive, random_gears, random_points

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import Amplifier, Gears, Relaxation, State
from tests import reference

ROWS = 30  # exact rationals grow with every sample of a memory
widths = st.lists(st.integers(1, 6).map(lambda k: k / 4), min_size=1, max_size=9)
signals = st.lists(st.integers(-8, 60).map(lambda k: k / 8), min_size=1, max_size=40)


def both(dx):
    return [0.25 + 0.5 * ((3 * k) % 5) for k in range(len(dx))]


@settings(max_examples=300, derandomize=True, deadline=None)
@given(widths, signals, st.integers(0, 2**9 - 1))
def test_gears_are_the_papers(dx, signal, state):
    """Widths and inputs lie on one grid, so that most samples turn on a breakpoint."""
    dy = both(dx)
    bits = state & (1 << len(dx)) - 1
    paper = reference.Backlash(dx, dy, -0.5, 1.25, bits)
    expected = [float(paper.step(value)) for value in signal]
    done = Gears(dx, dy, -0.5, 1.25).run(signal, State(bits))
    np.testing.assert_allclose(done.y, expected, rtol=0, atol=1e-9)


def paper_of(gears):
    """The same gears, as the paper has them, with their memories."""
    dx, dy = gears.table[:, 0].tolist(), gears.table[:, 1].tolist()
    paper = reference.Backlash(dx, dy, gears.x0, gears.y0)
    if gears.relaxation is None:
        return reference.Relaxed(paper, 0.0, ())
    return reference.Relaxed(paper, gears.relaxation.reference, gears.relaxation.gain)


@pytest.mark.parametrize("seed", range(12))
def test_gears_with_memory_are_the_papers(seed):
    rng = np.random.default_rng(seed)
    gears = random_gears(rng)
    drive = random_drive(rng, *gears.x_range, ROWS)
    steps = rng.uniform(1e-4, 1e-2, ROWS)
    decay = np.empty((ROWS, 0))
    if gears.relaxation is not None:
        decay = np.exp(-steps[:, None] / np.asarray(gears.relaxation.tau))
    paper = paper_of(gears)
    rows = zip(drive.tolist(), decay.tolist(), strict=True)
    expected = [float(paper.step(value, row)) for value, row in rows]
    done = gears.run(drive, State(0), steps)
    low, high = gears.y_range
    np.testing.assert_allclose(done.y, expected, rtol=0, atol=1e-9 * (high - low))
    assert done.state.bits == paper.gears.state


@pytest.mark.parametrize("seed", range(12))
def test_the_inverse_within_limits_is_the_papers(seed):
    """The window holds back some rows; what follows starts from the voltage that was applied."""
    rng = np.random.default_rng(seed)
    forward = random_gears(rng)
    low, high = forward.x_range
    window = low + 0.15 * (high - low), high - 0.2 * (high - low)
    targets = random_drive(rng, *forward.y_range, ROWS)
    paper = paper_of(forward)
    decay = np.empty((ROWS, 0))
    if forward.relaxation is not None:
        decay = np.repeat(forward.relaxation.decay(DT), ROWS, axis=0)
    rows = zip(targets.tolist(), decay.tolist(), strict=True)
    expected = [float(paper.undo(target, row, *window)) for target, row in rows]
    done = forward.undo(targets, State(0), DT, window)
    np.testing.assert_allclose(done.y, expected, rtol=0, atol=1e-9 * (high - low))
    assert done.state.bits == paper.gears.state
    at_an_end = np.isin(done.y, window)
    assert done.clipped == int(at_an_end.sum())


@pytest.mark.parametrize("seed", range(20))
def test_points_are_the_papers(seed):
    rng = np.random.default_rng(seed)
    points = random_points(rng, -1.0, 3.0)
    signal = rng.uniform(-2.0, 4.0, 50)
    widths, heights = points.dx.tolist(), points.dy.tolist()
    origin = points.x0, points.y0
    expected = reference.point(widths, heights, *origin, signal.tolist())
    got = points(signal)
    np.testing.assert_allclose(got, [float(y) for y in expected], rtol=0, atol=1e-12)
    np.testing.assert_allclose(points.inverse(got), signal, rtol=0, atol=1e-13)


def test_negative_gains_must_leave_three_percent_of_the_mean_slope():
    dx, dy = [1.0, 1.0], [1.0, 3.0]  # mean slope 2, least 1
    Gears(dx, dy, 0, 0, Relaxation(0.0, (1.0, 1.0), (-0.5, -0.43)))
    with pytest.raises(ModelError) as problem:
        Gears(dx, dy, 0, 0, Relaxation(0.0, (1.0, 1.0, 2.0), (-0.5, -0.45, 9.0)))
    assert str(problem.value).startswith("relaxation.gain: ")
    assert "gear 0" in str(problem.value)


def test_time_must_not_go_backwards_nor_stand_still_behind_an_amplifier():
    with pytest.raises(InputError, match="time step 2"):
        Relaxation(0.0, (1.0,), (1.0,)).decay([0.1, -0.1])
    with pytest.raises(InputError, match="time step 3: 0 s"):
        Amplifier(1e-3).undo(np.ones(3), State(0), np.array([0.0, DT, 0.0]))
