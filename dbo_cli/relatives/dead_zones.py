"""Superposed dead zones, the memory-free part of [6] Kuhnen (2003), and the point stage that equals them.

S(x) = v_0 x + Σ v_j D_j(x) with D_j(x) = max(x − r_j, 0) for r_j > 0 and min(x − r_j, 0) for r_j < 0: each side
is counted from 0. A sum of straight pieces is a curve through points, so that a model holds it as a point stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import ModelError
from dbo_cli.hysteresis.operators import DiscretePointOperator

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DeadZones:
    """Superposed dead zones.

    Parameters
    ----------
    linear : float
        v_0, the weight of the identity.
    thresholds : array
        r_j of one side after the other, none of them 0; each side goes outwards.
    weights : array
        v_j.

    Raises
    ------
    ModelError
        A slope is not above 0, so that there is no inverse.
    """

    linear: float
    thresholds: Floats
    weights: Floats

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        for side in (self.thresholds > 0.0, self.thresholds < 0.0):
            if not (self.linear + np.cumsum(np.append(0.0, self.weights[side])) > 0.0).all():
                raise ModelError("weights: the dead zones make a slope that is not above 0")

    def run(self, x: Floats) -> Floats:
        """Return S(x), dead zone by dead zone."""
        y = self.linear * x
        for threshold, weight in zip(self.thresholds.tolist(), self.weights.tolist(), strict=True):
            beyond = np.maximum(x - threshold, 0.0) if threshold > 0.0 else np.minimum(x - threshold, 0.0)
            y = y + weight * beyond
        return y

    def inverse(self) -> DeadZones:
        """Return the inverse, dead zones again: v'_0 = 1/v_0, v'_j = −v_j/(V_j V_{j−1}), r'_j = S(r_j)."""
        weights = np.empty_like(self.weights)
        for side in (self.thresholds > 0.0, self.thresholds < 0.0):
            sums = self.linear + np.cumsum(np.append(0.0, self.weights[side]))
            weights[side] = -self.weights[side] / (sums[1:] * sums[:-1])
        return DeadZones(1.0 / self.linear, self.run(self.thresholds), weights)

    def points(self) -> DiscretePointOperator:
        """Return the point operator that equals this one; its end segments go on beyond the outer thresholds."""
        inner = np.unique(np.append(self.thresholds, 0.0))
        width = float(np.ptp(inner)) or 1.0
        x = np.concatenate(([inner[0] - width], inner, [inner[-1] + width]))
        y = self.run(x)
        return DiscretePointOperator(np.diff(x), np.diff(y), float(x[0]), float(y[0]))
