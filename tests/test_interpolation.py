"""One interpolator: exact for whole samples, of high order where samples are smooth, never beyond a step."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hysteresis_model import build

import dbo_cli as dbo
from dbo_cli.hysteresis.cascade import (
    DelayLeft,
    DelayStage,
    late_loop,
    read_ahead,
    window_place,
)
from dbo_cli.interpolation import smooth

BOUNDS = {5: 2.5, 10: 0.15, 20: 0.004, 50: 1e-4}
"""Percent of peak to peak (RMS) that a delay between samples leaves, by samples a period."""


def percent(left: np.ndarray, whole: np.ndarray) -> float:
    return 100.0 * math.sqrt(float(np.mean(left**2))) / float(np.ptp(whole))


@pytest.mark.parametrize("period", BOUNDS)
@pytest.mark.parametrize("whole", [0, 1, 2, 5])
@pytest.mark.parametrize("by_time", [True, False])
def test_a_delay_between_samples_is_undone(
    period: int, whole: int, by_time: bool
) -> None:
    """There and back, and against the analytic signal that reading ahead alone must give."""
    rows, delay = 20 * period, DelayStage(whole + 0.5)
    time = np.arange(float(rows))
    for phase in (0.0, 0.3, 0.7):
        wanted = np.sin(2.0 * np.pi * (time / period + phase))
        ((_, ahead),) = read_ahead([(None, time, wanted)], delay.seconds)
        back, _ = delay.lag(ahead, np.diff(time, prepend=0.0) if by_time else 1.0, None)
        used = slice(2 * period, -2 * period)
        assert percent((back - wanted)[used], wanted) < BOUNDS[period]
        analytic = np.sin(2.0 * np.pi * ((time + delay.seconds) / period + phase))
        assert percent((ahead - analytic)[used], wanted) < BOUNDS[period]


@pytest.mark.parametrize("whole", [0, 1, 2, 9])
def test_whole_samples_are_exact(whole: int) -> None:
    time, values = 0.001 * np.arange(50.0), np.random.default_rng(1).normal(size=50)
    found, _ = smooth.interpolated(time, values, time + 0.001 * whole)
    assert found[: 50 - whole].tolist() == values[whole:].tolist()
    assert late_loop(values, float(whole)).tolist() == np.roll(values, whole).tolist()


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.lists(st.sampled_from([0.0, 0.0, 1.0, -1.0, 5.0]), min_size=6, max_size=30),
    st.lists(st.floats(0.2, 5.0), min_size=30, max_size=30),
)
def test_steps_and_ramps_are_not_overshot(
    changes: list[float], gaps: list[float]
) -> None:
    """Between two samples of steps and ramps, each rest and each ramp two samples long, nothing turns."""
    values = np.cumsum(np.repeat(changes, 2))
    times = np.cumsum(np.resize(gaps, values.size))
    wanted = np.linspace(times[0], times[-1], 2000)
    found, _ = smooth.interpolated(times, values, wanted)
    place = np.clip(
        np.searchsorted(times, wanted, side="right") - 1, 0, values.size - 2
    )
    low = np.minimum(values[place], values[place + 1])
    high = np.maximum(values[place], values[place + 1])
    second = np.diff(np.diff(values) / np.diff(times))
    # steps on both sides of which the signal bends one way
    bent = np.zeros(values.size - 1, dtype=bool)
    bent[1:-1] = second[:-1] * second[1:] > 0.0
    bent[[0, -1]] = True
    flat = ~bent[place]
    slack = 1e-12 * (1.0 + np.abs(values).max())
    assert (found >= low - slack)[flat].all()
    assert (found <= high + slack)[flat].all()


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.integers(1, 40), st.booleans())
def test_the_extension_has_the_bits_of_its_twin(
    seed: int, count: int, causal: bool
) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([1.0, 1.0, 0.5, 2.0, 0.0, 1e-3, 50.0], count))
    values = rng.choice([rng.normal(size=count), np.sin(times), np.sign(np.sin(times))])
    wanted = np.sort(rng.uniform(times[0] - 2.0, times[-1] + 2.0, 60))
    newest = int(rng.integers(0, count)) if causal else count - 1
    found = [np.empty(60), np.empty(60)]
    ends = [
        kind.smooth(times, values, wanted, into, newest, smooth.WHOLE)
        for kind, into in zip((smooth, smooth.CHOSEN), found, strict=True)
    ]
    assert ends[0] == ends[1]
    assert found[0].tobytes() == found[1].tobytes()
    six = rng.normal(size=65)
    part, place = float(rng.uniform()), int(rng.integers(0, 5))
    smooth.smooth_even(six, found[0], place, part)
    smooth.CHOSEN.smooth_even(six, found[1], place, part)
    assert found[0].tobytes() == found[1].tobytes()


@pytest.mark.parametrize("seconds", [0.4, 1.6, 2.5, 7.3])
@pytest.mark.parametrize("by_time", [True, False])
def test_a_delay_takes_nothing_that_has_not_come(seconds: float, by_time: bool) -> None:
    """One sample at a time, any blocks and the whole give the same bits; what follows changes nothing."""
    rng = np.random.default_rng(3)
    x, steps = rng.normal(size=60), rng.uniform(0.5, 2.0, 60) if by_time else 1.0
    delay = DelayStage(seconds)
    whole, _ = delay.lag(x, steps, None)
    for size in (1, 7):
        history, parts = None, []
        for k in range(0, 60, size):
            step = steps[k : k + size] if isinstance(steps, np.ndarray) else steps
            y, history = delay.lag(x[k : k + size], step, history)
            parts.append(y)
        assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert [window_place(k) for k in (0, 1, 2, 3)] == [4, 3, 2, 2]


def test_what_a_delay_leaves_is_known_from_the_move() -> None:
    time = np.arange(400.0)
    wanted = np.sin(2.0 * np.pi * time / 10.0)
    ((_, ahead),) = read_ahead([(None, time, wanted)], 1.5)
    back, _ = DelayStage(1.5).lag(ahead, np.diff(time, prepend=0.0), None)
    left = DelayLeft(DelayStage(1.5), 1000)
    for k in range(0, 400, 90):
        left.add(time[k : k + 90], wanted[k : k + 90], ahead[k : k + 90])
    assert left.rms == pytest.approx(
        math.sqrt(float(np.mean((back - wanted)[2:] ** 2))), rel=1e-12
    )


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 1000),
    samples=st.floats(0.05, 6.0),
    period=st.integers(12, 80),
    uneven=st.booleans(),
    relaxing=st.booleans(),
)
def test_the_round_trip_is_within_what_is_stated(
    seed: int, samples: float, period: int, uneven: bool, relaxing: bool
) -> None:
    """simulate(compensate(x)) against x, through all stages: the delay leaves what it is said to leave."""
    rng = np.random.default_rng(seed)
    plain = build(seed % 8, relaxation=relaxing)
    step = 0.002
    delay = DelayStage(samples * step)
    actuator = dataclasses.replace(plain, stages=(*plain.stages, delay))
    model = dbo.Model(actuator)
    time = step * np.arange(15.0 * period)
    if uneven:
        time = time + step * rng.uniform(-0.2, 0.2, time.size)
    low, span = model.output.minimum, model.output.span
    wanted = low + span * (0.5 - 0.3 * np.cos(2.0 * np.pi * time / (step * period)))
    ((_, ahead),) = read_ahead([(None, time, wanted)], delay.seconds)
    left = DelayLeft(delay, wanted.size)
    left.add(time, wanted, ahead)
    begun = time >= time[0] + delay.seconds + 3.0 * step
    done = model.compensate(wanted, time=time, on_limit="clip", details=True)
    back = model.simulate(done.values, time=time)
    error = math.sqrt(float(np.mean((back - wanted)[begun] ** 2)))
    missed = abs(float(ahead[0] - model.simulate(done.values[:2], time=time[:2])[0]))
    if missed < 1e-6 * span:  # the settled curve does not step over the first value
        assert error <= 1.2 * left.rms + 1e-9 * span
