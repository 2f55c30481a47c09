"""Plays: against a slow reference, and inverse after forward."""

from __future__ import annotations

import numpy as np
import pytest

from dbo_cli.compare.plays import NOTHING, Plays
from dbo_cli.errors import FitError

KINDS = ("plays", "rate", "singular", "one-sided")


def operator(kind, n=12, seed=0, falling=False):
    """An operator of one kind with random weights that has an inverse."""
    rng = np.random.default_rng([seed, n])
    radii = np.arange(n) / n
    weights = rng.uniform(0.01, 0.3, n)
    if falling:
        weights[0] = 1.5 * weights[1:].sum() + 0.2
        weights[1:] *= -1.0
    if kind == "rate":
        return Plays(kind, radii, weights, rng.uniform(-0.005, 0.2, n), fastest=40.0)
    if kind == "singular":
        weights[0] = -0.1
        return Plays(kind, radii, weights)
    if kind == "one-sided":
        weights[0] = 0.0
        return Plays(kind, radii, weights, cubic=-0.1, linear=0.5)
    return Plays(kind, radii, weights)


def drive(op, rows=1500, seed=1):
    """A random walk that fills the range."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.standard_normal(rows))
    part = (walk - walk.min()) / np.ptp(walk)
    return op.low + (1.0 - op.low) * part


def share_of(op, x):
    if not op.by_rate.size:
        return NOTHING
    return np.minimum(np.abs(np.diff(x, prepend=x[0])) * 10.0, 1.0)


def slow(op, x, share):
    """The definition, sample by sample."""
    z = op.start(float(x[0])).copy()
    down = np.zeros(op.n) if op.kind == "one-sided" else op.radii
    y = []
    for k, value in enumerate(x):
        for i in range(op.n):
            z[i] = max(value - op.radii[i], min(value + down[i], z[i]))
        weights = op.weights
        if op.by_rate.size:
            weights = weights + share[k] * op.by_rate
        y.append(float(weights @ z) + op.cubic * value**3 + op.linear * value)
    return np.array(y)


@pytest.mark.parametrize("kind", KINDS)
def test_run_is_the_definition(kind):
    op = operator(kind)
    x = drive(op, 300)
    share = share_of(op, x)
    assert np.abs(op.run(x, share) - slow(op, x, share)).max() < 1e-13


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [1, 12, 50])
@pytest.mark.parametrize("seed", range(3))
def test_forward_after_inverse(kind, n, seed):
    if n == 1 and kind == "singular":
        pytest.skip("its only slope is not above 0")
    op = operator(kind, n, seed)
    x = drive(op, seed=seed + 10)
    share = share_of(op, x)
    wanted = op.run(x, share)
    found = op.solve(wanted, float(x[0]), share)
    assert np.abs(op.run(found, share) - wanted).max() < 1e-12
    if kind != "singular":
        assert np.abs(found - x).max() < 1e-10


@pytest.mark.parametrize("falling", [False, True])
@pytest.mark.parametrize("first", ["low", "middle", "high"])
def test_closed_form_is_the_general_one(falling, first):
    op = operator("plays", 25, falling=falling)
    x = drive(op)
    x[0] = {"low": -1.0, "middle": 0.1, "high": 1.0}[first]
    wanted = op.run(x)
    closed = op.closed_inverse(wanted, float(x[0]))
    assert np.abs(closed - op.solve(wanted, float(x[0]))).max() < 1e-11
    assert np.abs(closed - x).max() < 1e-11


def test_places_of_some_rows():
    op = operator("plays", 5)
    x = drive(op, 40_000)
    rows = np.array([0, 3, 16_383, 16_384, 39_999])
    places = op.at(x, rows)
    assert places.shape == (5, 5)
    assert np.array_equal(places[:, 0], x[rows])
    assert np.abs(places @ op.weights - op.run(x)[rows]).max() < 1e-13


def test_settled_start():
    op = operator("plays")
    assert np.abs(op.start(0.0)).max() == 0.0
    # an oscillation about 0.2 that decays from the whole range
    side = np.where(np.arange(4001) % 2, -1.0, 1.0)
    swing = np.clip(0.2 + 1.2 * np.linspace(1.0, 0.0, 4001) * side, -1.0, 1.0)
    end = op.at(swing, np.array([4000]))[0]
    assert np.abs(end - op.start(0.2)).max() < 0.01


@pytest.mark.parametrize(
    "weights", [[-0.1, 0.3, 0.1], [0.5, -0.6, 0.3], [0.0, 0.1, 0.1]]
)
def test_no_inverse_is_refused(weights):
    with pytest.raises(FitError, match="no inverse"):
        Plays("plays", np.arange(3) / 3.0, np.array(weights))
