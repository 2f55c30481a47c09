"""Rivals fitted to plants that are of their own kind: the numbers come back."""

from __future__ import annotations

import numpy as np
import pytest

from dbo_cli.compare import fitting
from dbo_cli.compare.compare import PlayModel
from dbo_cli.compare.fitting import RIVALS, Design
from dbo_cli.compare.plays import Plays
from dbo_cli.errors import FitError
from dbo_cli.identification import Recording

RIVAL = {rival.name: rival for rival in RIVALS}


def voltage(rows=4000, rate=500.0):
    """A fading sine over 0 to 100 V, from its lower end."""
    time = np.arange(rows) / rate
    fading = np.exp(-time / 6.0)
    return 50.0 - 50.0 * fading * np.cos(2.0 * np.pi * time), time


def recording(operator, bend=0.0, delay=0.0, noise=0.0, scale=0.2, offset=3.0):
    """A log of a plant of plays."""
    drive, time = voltage()
    x = drive / 50.0 - 1.0
    if operator.kind == "one-sided":
        x = drive / 100.0
    u = operator.run(x)
    u = (u - u.min()) / np.ptp(u)
    y = u + bend * u * (1.0 - u)
    y = np.interp(np.arange(len(y)) - delay, np.arange(len(y)), y)
    y = y + noise * np.random.default_rng(3).standard_normal(len(y))
    return Recording("log.csv", drive, offset + scale * 100.0 * y, time)


def growing(n=25):
    weights = np.full(n, 0.02)
    weights[0] = 0.6
    return Plays("plays", np.arange(n) / n, weights)


def fitted(name, log):
    problem = fitting.prepare([log])
    design, solution, ratio = fitting.fit(RIVAL[name], problem)
    return PlayModel.of(design, solution, problem), design, ratio


def error(model, log):
    return float(np.std(model.predict(log) - log.displacement))


def test_plays_find_plays():
    log = recording(growing())
    model, design, ratio = fitted("pi", log)
    assert design.delay == 0.0 and not design.falling
    assert error(model, log) < 1e-3 * np.ptp(log.displacement)
    assert ratio >= 1.0
    line, _, _ = fitted("line", log)
    assert error(line, log) > 20.0 * error(model, log)


def test_a_bent_plant_needs_dead_zones():
    log = recording(growing(), bend=0.4, noise=1e-4)
    plain, _, _ = fitted("pi", log)
    modified, design, _ = fitted("modified", log)
    assert design.segments > 1
    assert error(modified, log) < 0.3 * error(plain, log)


def test_falling_slopes_and_falling_displacement():
    n = 25
    weights = np.full(n, -0.03)
    weights[0] = 1.5
    log = recording(Plays("plays", np.arange(n) / n, weights), scale=-0.2)
    model, design, _ = fitted("pi", log)
    assert design.falling
    assert error(model, log) < 2e-3 * np.ptp(log.displacement)


@pytest.mark.parametrize("delay", [3.0, 1.5])
def test_a_delay_is_found(delay):
    log = recording(growing(), delay=delay, noise=1e-5)
    _, design, _ = fitted("pi", log)
    assert design.delay == pytest.approx(delay, abs=0.13)


def test_one_sided_plays_find_their_own():
    n = 25
    weights = np.full(n, 0.015)
    weights[0] = 0.0
    plant = Plays("one-sided", np.arange(n) / n, weights, cubic=0.2, linear=0.5)
    log = recording(plant)
    model, _, _ = fitted("asymmetric", log)
    assert error(model, log) < 1e-3 * np.ptp(log.displacement)


@pytest.mark.parametrize("name", [name for name in RIVAL if name != "rate"])
def test_inverse_after_forward(name):
    log = recording(growing(), bend=0.3, noise=1e-4)
    model, _, _ = fitted(name, log)
    wanted = model.simulate(log.voltage)
    drive = model.invert(wanted, float(log.voltage[0]))
    assert np.abs(model.simulate(drive) - wanted).max() < 1e-10 * np.ptp(wanted)


def test_rate_needs_a_clock_and_follows_it():
    log = recording(growing(), noise=1e-4)
    without = Recording("log.csv", log.voltage, log.displacement)
    with pytest.raises(FitError, match="clock"):
        fitted("rate", without)
    model, _, _ = fitted("rate", log)
    assert error(model, log) < 2e-3 * np.ptp(log.displacement)
    wanted = model.simulate(log.voltage, log.time)
    drive = model.invert(wanted, float(log.voltage[0]), log.time)
    back = model.simulate(drive, log.time)
    assert np.sqrt(np.mean((back - wanted) ** 2)) < 0.01 * np.ptp(wanted)


def test_offset_and_drift_of_each_log_are_its_own():
    first, second = recording(growing()), recording(growing(), offset=40.0)
    slope = np.linspace(0.0, 1.0, len(second.voltage))
    second = Recording("b", second.voltage, second.displacement + slope, second.time)
    problem = fitting.prepare([first, second])
    design, solution, _ = fitting.fit(RIVAL["pi"], problem)
    rows = fitting.equations(problem, design)
    assert fitting.fit_error(rows, solution) < 1e-3
    assert len(solution.drift) == 4


def test_bounds_are_kept():
    rng = np.random.default_rng(5)
    matrix, drift = rng.standard_normal((200, 6)), np.ones((200, 1))
    least = np.array([0.1, 0.0, 0.0, -np.inf, 0.0, 0.0])
    right = matrix @ np.array([-1.0, 0.5, -0.2, -3.0, 0.0, 1.0]) + 7.0
    x, z = fitting.bounded_minimum(matrix, drift, right, least)
    assert (x >= least).all() and x[0] == 0.1
    gradient = matrix.T @ (matrix @ x + drift @ z - right)
    assert np.abs(gradient[x > least]).max() < 1e-9
    assert (gradient[x == least] > -1e-9).all()


def test_dead_zones_curve_and_its_inverse():
    knots = np.array([0.0, 0.1, 0.5, 1.0])
    u = np.linspace(-0.5, 1.5, 101)
    assert (
        np.abs(fitting.curve_inverse(fitting.curve(u, knots), knots) - u).max() < 1e-14
    )
    assert fitting.curve(np.array([0.1]), knots)[0] == pytest.approx(1.0 / 3.0)


def test_parameters():
    assert Design("plays", 25).parameters == 26
    assert Design("plays", 12, segments=4, delay=1.0).parameters == 17
    assert Design("rate", 12).parameters == 25
    assert Design("one-sided", 12).parameters == 14
