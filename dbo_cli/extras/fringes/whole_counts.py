"""Which whole numbers of fringes lie between the swings of a log: all turns weighed together.

Inside a swing fringes count by themselves; from swing to swing a whole number of them
is open. A linear fit of the actuator with an offset of its own for each swing says what
these offsets are and how well they are known together. A wrong count at all upper
turns, say, is a wider loop: no turn alone would show it. So the whole vector of counts
is searched, as receivers of satellite navigation search the whole wavelengths of their
carrier phases: the integers z with the least (d - z)' Q^-1 (d - z), and for each turn
the best vector that has another count there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dbo_cli.extras.fringes.actuator_prior import Columns
from dbo_cli.extras.fringes.branches import MOST_ODDS, NODES, TURN, Nodes
from dbo_cli.extras.fringes.swings import Floats, Indices

INSIDE_TRAVEL = 0.5
"""Fringes behind a turn that take no part in the fit: there the displacement is late."""
FEWEST_FRINGES = 0.75
"""Of a swing behind that; a smaller one has no count of its own."""
LEAST_NOISE = 0.02
"""Fringes; of the fit's residual."""
DISCREPANCY = 0.07
"""Fringes; by how much the offset of a swing may differ from the model's whatever its weights."""
SEARCHED = 40.0
"""Of the cost beyond the best: vectors that cost more are not looked at."""
MOST_VISITS = 30_000
"""Nodes of the search; behind them the log counts as undecided."""


@dataclass(frozen=True)
class Counts:
    """What the search found.

    ``swings`` numbers of the swings that have a count; ``counts`` whole fringes to add
    to each, so that the log fits best; ``odds`` for each gap between neighbours of
    ``swings``; ``complete`` False where the search was given up.
    """

    swings: Indices
    counts: Indices
    odds: Floats
    others: Floats
    complete: bool


def swing_counts(
    columns: Columns, nodes: Nodes, phase: Floats, half_stroke: float
) -> Counts:
    """Return the counts that fit best, beside those that a path has, and the odds of each gap.

    Parameters
    ----------
    columns
        Terms of the actuator at the nodes.
    nodes
        The blocks.
    phase
        The path, rad (nodes).
    half_stroke
        rad, about.
    """
    rows, owners = _rows_inside(nodes, phase)
    swings = np.unique(owners)
    none = np.zeros(max(swings.size - 1, 0))
    if swings.size < 2:
        return Counts(swings, np.zeros(swings.size, dtype=np.intp), none, none, True)
    own = (owners[:, None] == swings[None, :]).astype(np.float64)
    terms = columns.values.shape[1]
    design = np.column_stack([columns.values[rows], own])
    prior = np.concatenate(
        [1.0 / (columns.spread * half_stroke) ** 2, np.full(swings.size, 1e-8)]
    )
    expected = np.zeros(design.shape[1])
    expected[0] = half_stroke
    products = design.T @ design
    targets = design.T @ phase[rows]
    noise = 0.1 * TURN
    for _ in range(3):
        weight = 1.0 / (noise**2 * NODES)
        covariance = np.linalg.inv(weight * products + np.diag(prior))
        solution = covariance @ (weight * targets + prior * expected)
        residual = phase[rows] - design @ solution
        noise = max(float(np.sqrt(np.mean(residual**2))), LEAST_NOISE * TURN)
    offsets = solution[terms:] / TURN
    spread = covariance[terms:, terms:] / TURN**2 + DISCREPANCY**2 * np.eye(swings.size)
    difference = offsets[1:] - offsets[0]
    joint = spread[1:, 1:] - spread[1:, :1] - spread[:1, 1:] + spread[0, 0]
    best, vectors, costs, complete = search(difference, joint)
    counts = np.concatenate([[0], best])
    odds, others = _gap_odds(counts, vectors, costs)
    return Counts(swings, -counts, odds, others, complete)


def added_counts(nodes: Nodes, found: Counts) -> Floats:
    """Return the fringes to add at each block; swings without a count take that of the swing before."""
    added = np.zeros(nodes.starts.size)
    for swing, count in zip(found.swings, found.counts, strict=True):
        added[nodes.turns[swing] :] = count
    return added


def joint_odds(odds: Floats, others: Floats, found: Counts) -> tuple[Floats, Floats]:
    """Return the lower of each turn's odds and those of the gap it lies in; what else it could be, rad.

    Parameters
    ----------
    odds, others
        Of the inner turns by themselves.
    found
        The counts of the swings. Where a better vector of counts is left, no turn has
        odds.
    """
    odds = odds.copy()
    others = others.copy()
    if not found.complete or np.any(found.counts != 0):
        odds[:] = np.minimum(odds, 1.0)
        return odds, others
    for place, odd in enumerate(found.odds):
        between = slice(int(found.swings[place]), int(found.swings[place + 1]))
        lower = odds[between] > odd
        others[between] = np.where(lower, TURN * found.others[place], others[between])
        odds[between] = np.minimum(odds[between], odd)
    return odds, others


def _rows_inside(nodes: Nodes, phase: Floats) -> tuple[Indices, Indices]:
    """Return the blocks that are well inside their swing, and the number of the swing of each."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(phase)))]) / TURN
    chosen = []
    owners = []
    for number, (begin, end) in enumerate(
        zip(nodes.turns[:-1], nodes.turns[1:], strict=True)
    ):
        rows = np.arange(begin, end)
        rows = rows[travel[rows] - travel[begin] > INSIDE_TRAVEL]
        if rows.size < 3 or travel[rows[-1]] - travel[rows[0]] < FEWEST_FRINGES:
            continue
        chosen.append(rows)
        owners.append(np.full(rows.size, number))
    if not chosen:
        empty = np.empty(0, dtype=np.intp)
        return empty, empty
    return np.concatenate(chosen), np.concatenate(owners)


def _conditional_order(joint: Floats) -> tuple[Indices, Floats, Floats]:
    """Return an order of the unknowns, the best known next, with L and D of the ordered covariance."""
    size = joint.shape[0]
    rest = joint.copy()
    order = []
    lower = np.eye(size)
    variances = np.empty(size)
    gains = np.zeros((size, size))
    waiting = list(range(size))
    for place in range(size):
        pick = min(waiting, key=lambda unknown: rest[unknown, unknown])
        waiting.remove(pick)
        order.append(pick)
        variance = max(float(rest[pick, pick]), 1e-9)
        variances[place] = variance
        gains[:, place] = rest[:, pick] / variance
        rest = rest - np.outer(rest[:, pick], rest[pick]) / variance
    sequence = np.array(order, dtype=np.intp)
    lower = np.tril(gains[sequence], -1) + np.eye(size)
    return sequence, lower, variances


def search(difference: Floats, joint: Floats) -> tuple[Indices, Indices, Floats, bool]:
    """Return the best integers, all integer vectors near them with their costs, and if that was all.

    Parameters
    ----------
    difference
        The real-valued estimate (unknowns).
    joint
        Its covariance.

    Source: P. J. G. Teunissen, "The least-squares ambiguity decorrelation adjustment",
    J. Geodesy 70 (1995); here without the decorrelation, since the unknowns are few.
    """
    order, lower, variances = _conditional_order(joint)
    size = order.size
    value = difference[order]
    inverse_rows = [lower[row, :row] for row in range(size)]
    vectors: list[list[int]] = []
    costs: list[float] = []
    best = np.inf
    visits = 0
    stack: list[tuple[list[int], list[float], float]] = [([], [], 0.0)]
    while stack:
        chosen, rests, cost = stack.pop()
        visits += 1
        if visits > MOST_VISITS:
            break
        if cost > best + SEARCHED:
            continue
        place = len(chosen)
        if place == size:
            vectors.append(chosen)
            costs.append(cost)
            best = min(best, cost)
            continue
        centre = float(value[place]) - float(inverse_rows[place] @ np.array(rests))
        nearest = round(centre)
        trials = []
        for shift in (0, 1, -1, 2, -2):
            rest = centre - (nearest + shift)
            more = cost + rest * rest / float(variances[place])
            if more <= best + SEARCHED:
                trials.append((more, nearest + shift, rest))
        trials.sort(reverse=True)
        for more, whole, rest in trials:
            stack.append(([*chosen, whole], [*rests, rest], more))
    found = np.array(vectors, dtype=np.intp).reshape(len(vectors), size)
    unordered = np.empty_like(found)
    unordered[:, order] = found
    every = np.array(costs)
    keep = every <= best + SEARCHED
    winner = (
        unordered[int(np.argmin(every))]
        if every.size
        else np.round(difference).astype(np.intp)
    )
    return (
        winner,
        unordered[keep],
        every[keep],
        visits <= MOST_VISITS and every.size > 0,
    )


def _gap_odds(
    counts: Indices, vectors: Indices, costs: Floats
) -> tuple[Floats, Floats]:
    """Return for each gap the odds of its count against all vectors with another, and the best other."""
    padded = np.concatenate(
        [np.zeros((vectors.shape[0], 1), dtype=np.intp), vectors], axis=1
    )
    jumps = np.diff(padded, axis=1)
    taken = np.diff(counts)
    odds = np.full(taken.size, MOST_ODDS)
    others = np.ones(taken.size)
    if costs.size == 0:
        return np.ones(taken.size), others
    weights = np.exp(-0.5 * (costs - costs.min()))
    for gap in range(taken.size):
        same = jumps[:, gap] == taken[gap]
        rest = float(weights[~same].sum())
        if rest > 0.0:
            odds[gap] = min(float(weights[same].sum()) / rest, MOST_ODDS)
            likeliest = int(np.argmax(np.where(same, -1.0, weights)))
            others[gap] = float(jumps[likeliest, gap] - taken[gap])
        else:
            odds[gap] = min(float(np.exp(0.5 * SEARCHED)), MOST_ODDS)
    return odds, others
