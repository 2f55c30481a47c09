"""The moves that a self-test plays: everything a controller may meet, in a few hundred samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def self_test_moves(low: float, high: float, seed: int = 1) -> Floats:
    """Return inputs between ``low`` and ``high`` and a little beyond: about 300 samples, always the same.

    A slow sweep there and back, an oscillation that decays around the middle, a random walk, random jumps, a
    turn at each end exactly, a rest, and 3 % beyond either end.
    """
    rng = np.random.default_rng(seed)
    span = high - low
    way = np.linspace(0.0, 1.0, 31)
    decaying = 0.5 + 0.5 * np.exp(-np.arange(80) / 30.0) * np.cos(np.arange(80) * 0.55)
    walk = 0.5 + np.cumsum(rng.normal(0.0, 0.02, 70))
    parts = [
        way, way[::-1], decaying, np.clip(walk, 0.0, 1.0), rng.uniform(0.0, 1.0, 30),
        np.array([0.0, 1.0, 0.4, 1.0, 0.0, 0.6, 0.2]), np.full(8, 0.3),
        np.array([1.0, 1.03, 0.9, -0.03, 0.1, 0.7]),
    ]  # fmt: skip
    return low + span * np.concatenate(parts)
