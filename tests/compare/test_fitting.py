"""Rivals fitted to plants that are of their own kind: the numbers come back."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from dbo_cli.compare import fitting
from dbo_cli.compare.fitting import RIVALS
from dbo_cli.compare.plays import Plays
from dbo_cli.errors import FitError
from dbo_cli.identification import Recording

RIVAL = {rival.name: rival for rival in RIVALS}
N = 25
RADII = 0.5 * np.arange(N) / N
GROWING = Plays(RADII, np.append(0.6, np.full(N - 1, 0.02)))
FALLING = Plays(RADII, np.append(1.5, np.full(N - 1, -0.03)))
ONE_SIDED = Plays(
    2.0 * RADII, np.append(0.0, np.full(N - 1, 0.015)), True, curve=np.array([0.2, 0.5])
)
SINGULAR = Plays(RADII, np.append(-0.05, np.full(N - 1, 0.04)))
RATE = Plays(RADII, GROWING.weights, by_rate=0.5 * GROWING.weights)


def recording(operator=GROWING, bend=0.0, delay=0.0, noise=0.0, scale=0.2, offset=3.0):
    """Return a log of a plant of plays under a fading sine over 0 to 100 V, from its lower end."""
    time = np.arange(4000) / 500.0
    sweep = 2.0 * np.pi * (time + 0.1 * time**2)
    x = 0.5 - 0.5 * np.exp(-time / 6.0) * np.cos(sweep)
    share = np.empty(0)
    if operator.by_rate.size:
        share = np.minimum(fitting.rates_of(x, time) / 4.0, 1.0)
    u = operator.run(x, share)
    u = (u - u.min()) / np.ptp(u)
    y = u + bend * u * (1.0 - u)
    y = np.interp(np.arange(len(y)) - delay, np.arange(len(y)), y)
    y = y + noise * np.random.default_rng(3).standard_normal(len(y))
    return Recording("log.csv", 100.0 * x, offset + scale * 100.0 * y, time)


def fitted(name, *logs):
    return fitting.fit(RIVAL[name], fitting.RivalProblem(logs))


def error(model, log):
    """Return what a model leaves, of the range."""
    off = model.predict(log) - log.displacement
    return float(np.std(off) / np.ptp(log.displacement))


@pytest.mark.parametrize(
    ("name", "plant", "scale"),
    [
        ("pi", GROWING, 0.2),
        ("pi", FALLING, -0.2),
        ("asymmetric", ONE_SIDED, 0.2),
        ("rate", RATE, 0.2),
        ("extended", SINGULAR, 0.2),
    ],
)
def test_operators_find_their_own_kind(name, plant, scale):
    log = recording(plant, scale=scale)
    model = fitted(name, log)
    assert error(model, log) < 2e-3
    assert error(fitted("line", log), log) > 10.0 * error(model, log)
    assert model.design.falling == (plant is FALLING)
    assert model.design.delay == 0.0 and model.design.plays == N
    assert model.expected(1.0) >= 1.0
    slopes = [np.cumsum(plays.weights) for plays in (model.operator[0], plant)]
    scale = slopes[0][-1] / slopes[1][-1]
    np.testing.assert_allclose(slopes[0], scale * slopes[1], atol=0.05 * scale)


BENT = recording(bend=0.4, noise=1e-4)


@functools.cache
def bent(name):
    """Return a rival fitted to a bent plant."""
    return fitted(name, BENT)


def test_a_bent_plant_needs_dead_zones():
    modified = bent("modified")
    assert modified.design.segments > 1
    assert error(modified, BENT) < 0.3 * error(bent("pi"), BENT)
    assert modified.parameters == modified.design.plays + modified.design.segments


@pytest.mark.parametrize("delay", [3.0, 1.5])
def test_a_delay_is_found(delay):
    model = fitted("pi", recording(delay=delay, noise=1e-5))
    assert model.design.delay == pytest.approx(delay, abs=0.13)
    assert model.parameters == model.design.plays + 2


@pytest.mark.parametrize("name", RIVAL)
def test_inverse_after_forward(name):
    model = bent(name)
    wanted = model.simulate(BENT.voltage, BENT.time)
    drive = model.invert(wanted, float(BENT.voltage[0]), BENT.time)
    off = (model.simulate(drive, BENT.time) - wanted) / np.ptp(wanted)
    # of [7] the rate is that of what is wanted
    assert np.sqrt(np.mean(off**2)) < (0.01 if name == "rate" else 1e-10)


def test_an_operator_without_an_inverse_is_refused():
    weights = np.append(-1.0, np.full(11, 0.05))
    with pytest.raises(FitError, match="no inverse"):
        fitting.plays_of(RIVAL["extended"], weights)


def test_rows_that_are_skipped_do_not_count():
    log = recording()
    wrong = np.where(log.time < 1.0, 90.0, log.displacement)
    spoilt = replace(log, displacement=wrong, good=log.time >= 1.0)
    assert fitted("pi", spoilt).fit_error < 1e-3


def test_a_short_log_beside_a_long_one_is_refused(monkeypatch):
    monkeypatch.setattr(fitting, "FIT_ROWS", 50)
    log = recording()
    with pytest.raises(FitError, match="rows to fit"):
        fitting.RivalProblem([log, replace(log, good=log.time >= log.time[-25])])
