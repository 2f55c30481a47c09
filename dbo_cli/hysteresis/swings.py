"""Swings of a drive between turns, and how unlike those of the logs the swings of a move are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SMALLEST_TURN = 0.02  # a reversal smaller than this share of the drive's range is noise, not a turn
MOST = 256  # swings are kept with a model: some 4 kB
NEAREST = 0.02  # of the range: swings that lie closer together are kept once


def turning_points(signal: Floats, threshold: float) -> Integers:
    """Rows where ``signal`` reverses by more than ``threshold``: alternating maxima and minima.

    The first sample of a plateau counts as the turn. The two ends of the signal are not turning points.
    """
    slope = np.sign(np.diff(signal))
    moving = np.flatnonzero(slope)
    if len(moving) == 0:
        return np.empty(0, np.int64)
    changes = np.flatnonzero(np.diff(slope[moving]))
    candidates = np.concatenate(([0], moving[changes] + 1, [len(signal) - 1]))
    values = signal[candidates]
    turns: list[int] = []
    best = 0
    direction = 0.0
    for place in range(1, len(candidates)):
        change = values[place] - values[best]
        if direction == 0.0:
            if abs(change) > threshold:
                direction = np.sign(change)
                best = place
        elif change * direction >= 0.0:
            best = place
        elif abs(change) > threshold:
            turns.append(int(candidates[best]))
            direction = -direction
            best = place
    return np.asarray(turns, dtype=np.int64)


def swings_between_turns(drive: Floats, span: float) -> tuple[Integers, Floats]:
    """Return the rows between which a drive swings, (swings + 1,), and from where to where, (swings, 2)."""
    turns = turning_points(drive, SMALLEST_TURN * span)
    edges = np.concatenate(([0], turns, [len(drive) - 1]))
    return edges, np.column_stack((drive[edges[:-1]], drive[edges[1:]]))


def thinned(swings: Floats, span: float) -> Floats:
    """Return at most ``MOST`` of the swings, one of those that lie close together."""
    near = NEAREST * span
    while True:
        kept: Floats = swings[np.unique(np.round(swings / near), axis=0, return_index=True)[1]]
        if len(kept) <= MOST:
            return kept
        near *= 2.0


def unlike(drive: Floats, known: Floats, span: float, begin: int = 0) -> float:
    """Return how far the swings of a drive are from the nearest known ones, in units of the range, RMS.

    A swing is a point: where it comes from and where it goes. Swings count as long as they take, from the row
    ``begin`` on.
    """
    edges, swings = swings_between_turns(drive, span)
    rows = np.maximum(edges[1:] - np.maximum(edges[:-1], begin), 0)
    if not rows.any():
        return 0.0
    squares = ((swings[:, None] - known) ** 2).sum(axis=2).min(axis=1)
    return float(np.sqrt(rows @ squares / rows.sum())) / span
