"""What a photodiode sees beside the phase: drifting offset and amplitude, noise, clipping, a dark beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.swings import Floats

FRINGES_A_KNOT = 2.5
"""Fringes on the way between knots of the drifting offset and amplitude."""
MOST_KNOTS = 24
"""Of a log; drift is slow."""
DRIFT = 0.02
"""Of the amplitude; what offset and amplitude are thought to drift by from knot to knot; chosen."""
FIRST_DRIFT = 0.005
"""The same while the phase is not yet sure: else the light would make up for a wrong phase."""
FIRST_NOISE = 0.1
"""Of the amplitude, before it was looked at."""
CLIPPED_ROWS = 0.02
"""Of all rows: as many at the very same extreme value mean that the photodiode is clipped."""
DARK = 0.25
"""Of the fringes' height: a level this far outside them is no fringe."""
DARK_ROWS = 5
"""So many rows in sequence outside the fringes are an interrupted beam."""


def percentile_ends(signal: Floats) -> tuple[float, float]:
    """Return the lower and upper end of the fringes, about."""
    low, high = np.percentile(signal, [1.0, 99.0])
    return float(low), float(high)


def clipped_rows(signal: Floats) -> NDArray[np.bool_]:
    """Return the rows at which the photodiode is at the end of its range.

    Those at the very highest (or lowest) value of the log, where they are more than
    ``CLIPPED_ROWS`` and three times as many as are within one step (of the digits) of
    it.
    """
    clipped = np.zeros(signal.size, dtype=bool)
    values, counts = np.unique(signal, return_counts=True)
    if values.size < 10:
        return clipped
    for end, neighbours in ((0, counts[1:4]), (-1, counts[-4:-1])):
        many = counts[end] > CLIPPED_ROWS * signal.size
        if many and counts[end] > 3 * int(neighbours.max()):
            clipped |= signal == values[end]
    return clipped


def dark_parts(signal: Floats) -> list[tuple[int, int]]:
    """Return the rows (first, behind the last) in which the signal is far outside the fringes."""
    low, high = np.percentile(signal, [10.0, 90.0])
    middle = 0.5 * (low + high)
    half = 0.5 * (high - low) / np.cos(0.1 * np.pi)
    outside = np.abs(signal - middle) > (1.0 + 2.0 * DARK) * half
    edges = np.flatnonzero(np.diff(np.concatenate([[0], outside.astype(np.int8), [0]])))
    parts = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin >= DARK_ROWS:
            parts.append((int(begin), int(end)))
    return parts


def drift_basis(place: Floats, fringes: float) -> Floats:
    """Return smooth functions of ``place`` (0 to 1): cubic splines, more of them the more fringes went by."""
    knots = int(np.clip(fringes / FRINGES_A_KNOT, 1, MOST_KNOTS))
    degree = min(3, knots - 1)
    inner = np.linspace(0.0, 1.0, knots - degree + 1)
    sequence = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    dense: Floats = BSpline.design_matrix(place, sequence, degree).toarray()
    return dense


def _stiffness(knots: int, factors: int) -> Floats:
    """Return the matrix of the sum of squared differences of neighbouring knots, for several factors."""
    bent = np.diff(np.eye(knots), axis=0)
    single = bent.T @ bent + 1e-9 * np.eye(knots)
    return np.asarray(np.kron(np.eye(factors), single), dtype=np.float64)


def fit_light(
    signal: Floats,
    terms: list[Floats],
    fringes: Floats,
    weight: Floats,
    drift: float = DRIFT,
) -> tuple[list[Floats], float]:
    """Fit a signal by 1 and given functions of the phase, each times a drifting factor.

    Parameters
    ----------
    signal
        The photodiode (rows).
    terms
        Functions of the phase: its cosine, for two signals its sine, too.
    fringes
        Fringes gone by until each row: drift is smooth over these, so that each part
        has fringes enough.
    weight
        0 where a row says nothing, else 1.
    drift
        How far the factors are thought to drift from knot to knot, of the amplitude.

    Returns
    -------
    list of arrays
        The offset, and the factor of each term, at every row.
    float
        Standard deviation of what is left.
    """
    place = fringes / fringes[-1]
    basis = drift_basis(place, float(fringes[-1]))
    rows = np.column_stack([basis, *(basis * term[:, None] for term in terms)])
    products = (rows * weight[:, None]).T @ rows
    targets = rows.T @ (weight * signal)
    free = max(float(weight.sum()) - rows.shape[1], 1.0)
    amplitude = np.sqrt(2.0) * float(np.std(signal[weight > 0.0]))
    stiffness = _stiffness(basis.shape[1], 1 + len(terms)) / (drift * amplitude) ** 2
    noise = FIRST_NOISE * amplitude
    for _ in range(3):
        solution: Floats = np.linalg.solve(products + noise**2 * stiffness, targets)
        residual = signal - rows @ solution
        noise = float(np.sqrt(np.sum(weight * residual**2) / free))
    width = basis.shape[1]
    factors = [
        basis @ solution[k * width : (k + 1) * width] for k in range(1 + len(terms))
    ]
    return factors, noise


def travelled(phase: Floats) -> Floats:
    """Return the fringes gone by until each row, a little for each row beside (rests drift, too)."""
    steps = np.abs(np.diff(phase)) / TURN
    rest = 0.1 * float(steps.sum()) / max(steps.size, 1)
    return np.concatenate([[0.0], np.cumsum(steps + rest)])
