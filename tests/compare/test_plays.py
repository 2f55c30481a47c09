"""Plays: against a slow reference, and inverse after forward."""

import numpy as np
import pytest

from dbo_cli.compare.plays import EMPTY, Plays, places

KINDS = ("plays", "falling", "rate", "singular", "one-sided")


def operator(kind, n=12):
    """Return an operator of one kind with random weights that has an inverse."""
    rng = np.random.default_rng(n)
    radii = 0.5 * np.arange(n) / n
    weights = rng.uniform(0.01, 0.3, n)
    if kind == "falling":
        weights[0] = 1.5 * weights[1:].sum() + 0.2
        weights[1:] *= -1.0
    if kind == "rate":
        return Plays(radii, weights, by_rate=rng.uniform(-0.005, 0.2, n))
    if kind == "singular":
        weights[0] = -0.1
    if kind == "one-sided":
        weights[0] = 0.0
        return Plays(2.0 * radii, weights, True, curve=np.array([-0.1, 0.5]))
    return Plays(radii, weights)


def drive(rows=1500):
    """Return a random walk that fills the range."""
    walk = np.cumsum(np.random.default_rng(1).standard_normal(rows))
    return (walk - walk.min()) / np.ptp(walk)


def share_of(op, x):
    if not op.by_rate.size:
        return EMPTY
    return np.minimum(np.abs(np.diff(x, prepend=x[0])) * 20.0, 1.0)


def slow(op, x, share):
    """Return the definition, sample by sample."""
    n = op.radii.size
    z = op.start(float(x[0])).copy()
    down = np.zeros(n) if op.one_sided else op.radii
    cubic, linear = op.curve if op.one_sided else (0.0, 0.0)
    y = []
    for k, value in enumerate(x):
        for i in range(n):
            z[i] = max(value - op.radii[i], min(value + down[i], z[i]))
        weights = op.weights
        if op.by_rate.size:
            weights = weights + share[k] * op.by_rate
        y.append(float(weights @ z[:n]) + cubic * value**3 + linear * value)
    return np.array(y)


@pytest.mark.parametrize("kind", KINDS)
def test_run_is_the_definition(kind):
    op, x = operator(kind), drive(300)
    share = share_of(op, x)
    assert np.abs(op.run(x, share) - slow(op, x, share)).max() < 1e-13


@pytest.mark.parametrize("n", [12, 50])
@pytest.mark.parametrize("kind", KINDS)
def test_forward_after_inverse(kind, n):
    op, x = operator(kind, n), drive()
    share = share_of(op, x)
    wanted = op.run(x, share)
    found = op.solve(wanted, float(x[0]), share)
    assert np.abs(op.run(found, share) - wanted).max() < 1e-12
    if kind != "singular":
        assert np.abs(found - x).max() < 1e-10


def test_starts():
    op = operator("plays", 5)
    assert np.array_equal(op.start(0.0)[:5], op.radii)
    assert np.array_equal(op.start(1.0)[:5], 1.0 - op.radii)
    # an oscillation about 0.6 that decays from the whole range
    side = np.where(np.arange(4001) % 2, -1.0, 1.0)
    swing = np.clip(0.6 + 0.6 * np.linspace(1.0, 0.0, 4001) * side, 0.0, 1.0)
    end = places(op.radii, False, swing, np.array([4000]))[0]
    assert np.abs(end - op.start(0.6)[:5]).max() < 0.005
