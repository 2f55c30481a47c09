"""The readable twin of ``dbo_plays.c``: the same arguments, the same bits.

Every floating-point operation is written in the same order in both; sums run over lanes of ``LANES`` plays.
The rows of ``table`` are up, down, weight and, where weights depend on the rate, by_rate, padded to whole
groups of lanes; ``curve`` is empty or (cubic, linear). See ``dbo_plays.h`` for their meaning.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LANES = 8
MOST_STEPS = 64


def _follow(table: Floats, z: Floats, v: float) -> None:
    """Move all plays to the input."""
    low, high = v - table[0], v + table[1]
    held = np.where(z > high, high, z)
    z[:] = np.where(held < low, low, held)


def _weighted(table: Floats, z: Floats, share: float) -> float:
    weight = table[2] + share * table[3] if len(table) > 3 else table[2]
    total = np.zeros(LANES)
    for group in (weight * z).reshape(-1, LANES):
        total = total + group
    s: list[float] = total.tolist()
    return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]))


def _curve(curve: Floats, x: float) -> float:
    cubic, linear = float(curve[0]), float(curve[1])
    if x <= 0.0:
        return linear * x
    if x >= 1.0:
        return (cubic + linear) + (3.0 * cubic + linear) * (x - 1.0)
    return (cubic * (x * x) + linear) * x


def _curve_slope(curve: Floats, x: float) -> float:
    cubic, linear = float(curve[0]), float(curve[1])
    if x <= 0.0:
        return linear
    if x >= 1.0:
        return 3.0 * cubic + linear
    return 3.0 * cubic * (x * x) + linear


def plays_run(n: int, table: Floats, curve: Floats, z: Floats, x: Floats, y: Floats, share: Floats) -> None:
    """Fill ``y`` with the output for ``x``; ``z`` becomes the state after it."""
    shares = share.tolist() if share.size else [0.0] * x.size
    for k, v in enumerate(x.tolist()):
        _follow(table, z, v)
        y[k] = _weighted(table, z, shares[k])
        if curve.size:
            y[k] = float(y[k]) + _curve(curve, v)


def plays_rows(n: int, table: Floats, z: Floats, x: Floats, rows: Floats) -> None:
    """Fill ``rows`` (samples × n) with the plays themselves; ``z`` becomes the state after them."""
    for k, v in enumerate(x.tolist()):
        _follow(table, z, v)
        rows[k] = z[:n]


def _on_curve(curve: Floats, at: float, slope: float, wanted: float) -> float:
    """Return where curve(x) - curve(at) + slope (x - at) = wanted, going from ``at`` towards it."""
    begin = _curve(curve, at)
    way = wanted / (slope + _curve_slope(curve, at))
    near, far = at, at + way
    for _ in range(MOST_STEPS):
        missing = wanted - ((_curve(curve, far) - begin) + slope * (far - at))
        if missing <= 0.0 if wanted > 0.0 else missing >= 0.0:
            break
        near = far
        way = way + way
        far = at + way
    x = far
    for _ in range(MOST_STEPS):
        missing = wanted - ((_curve(curve, x) - begin) + slope * (x - at))
        if missing == 0.0:
            break
        if missing > 0.0 if wanted > 0.0 else missing < 0.0:
            near = x
        else:
            far = x
        following = x + missing / (slope + _curve_slope(curve, x))
        if not (near < following < far if near < far else far < following < near):
            following = near + 0.5 * (far - near)
        if following == x:
            break
        x = following
    return x


def _solved(n: int, table: Floats, curve: Floats, z: Floats, y: float, share: float) -> float:
    """Return the input at which the output is ``y``."""
    places: list[float] = z[:n].tolist()
    up, down, weight = (row[:n].tolist() for row in table[:3])
    by_rate: list[float] = table[3, :n].tolist() if len(table) > 3 else []
    at, reached = places[0], _weighted(table, z, share)
    if curve.size:
        reached = reached + _curve(curve, at)
    if y == reached:
        return at
    rising = y > reached
    slope: float = weight[0]
    if by_rate:
        slope = slope + share * by_rate[0]
    for i in range(1, n):
        edge = places[i] + up[i] if rising else places[i] - down[i]
        edge = max(edge, at) if rising else min(edge, at)
        gained = slope * (edge - at)
        if curve.size:
            gained = gained + (_curve(curve, edge) - _curve(curve, at))
        gained = reached + gained
        if gained >= y if rising else gained <= y:
            break
        reached = gained
        at = edge
        slope = slope + weight[i]
        if by_rate:
            slope = slope + share * by_rate[i]
    return _on_curve(curve, at, slope, y - reached) if curve.size else at + (y - reached) / slope


def plays_solve(
    n: int,
    table: Floats,
    curve: Floats,
    z: Floats,
    y: Floats,
    x: Floats,
    share: Floats,
    limited: bool,
    low: float,
    high: float,
    slack: float,
    step: Floats,
    last: float,
) -> tuple[int, int]:
    """Fill ``x`` with the input whose output is ``y``; return how many were clipped, and the first."""
    shares = share.tolist() if share.size else [0.0] * y.size
    clipped = first = 0
    for k, value in enumerate(y.tolist()):
        wanted = v = _solved(n, table, curve, z, value, shares[k])
        if limited:
            if step.size and not math.isnan(last):
                most = float(step[k if step.size > 1 else 0])
                v = last + most if v > last + most else v
                v = last - most if v < last - most else v
            v = high if v > high else v
            v = low if v < low else v
            if abs(v - wanted) > slack:
                first = first if clipped else k
                clipped += 1
        _follow(table, z, v)
        x[k] = last = v
    return clipped, first
