"""Which branch of its phase one photodiode's signal is on, and with what odds at each turn of the drive.

The signal A + B cos(phase) gives the phase up to its sign and whole turns. Between
turns of the drive the displacement is monotone, so that crossings of the middle of the
fringes count. How the count goes on behind a turn is chosen by a model of the actuator
(``actuator_prior``):

1. ``first_fit``: crossings inside each swing, whole fringes between swings unknown; a
   linear fit with a count for each swing, and these counts made whole in the order of
   how well they are known.
2. ``follow``: a hidden Markov chain whose state is the phase less the model's, on a
   grid. It is a random walk that may step further behind a turn.
3. ``refit``: the model fitted to the phase on that path, with a random step at each
   turn. How large these steps are, and how well the other turns of the log foretell
   each, is what the chain allows next.
4. ``turn_odds``: at each turn the probability of the branch taken over that of all
   others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dbo_cli.extras.fringes.actuator_prior import Columns
from dbo_cli.extras.fringes.swings import Floats, Indices

TURN = 2.0 * np.pi
"""rad; the phase of a fringe."""
GRID = 48
"""States of the chain in a fringe."""
NODES = 24
"""Blocks of rows in a fringe, at the mean slope of the displacement over the drive."""
REACH = 1.5
"""Fringes to either side of the model that the chain may be away from it."""
START = 0.5
"""Fringes; largest distance from the model at the first row: whole fringes more are another zero."""
SAME_BRANCH = 0.25
"""Fringes: paths nearer than this count as the same branch."""

CROSSING_NOISE = 0.3
"""rad; how far a crossing may be off the model in the first fit."""
STEP_BEFORE = 0.15
"""Fringes; how far the model is thought to be off behind a turn before any turn was looked at."""
STEP_COUNT = 3.0
"""Turns that ``STEP_BEFORE`` counts as."""
WANDER_BEFORE = 0.15
"""Fringes in the first fringe; how far the model wanders inside a swing, before it was looked at."""
WANDER_LENGTHS = (0.25, 1.0)
"""Fringes over which the wandering is looked at: a drive that was recorded coarsely wanders quickly."""
FEWEST_CHANGES = 5
"""Of the wandering, to say how large it is."""
LEAST_WANDER = 0.03
"""Fringes in the first fringe."""
FREE_TRAVEL = 1.0
"""Fringes behind a turn within which the phase may still run the old way."""
NODE_NOISE = 0.01
"""rad; what the chain may wander from block to block where the drive rests."""
LEAST_REACH = 5
"""Steps of the grid from block to block that are always possible, but where the drive rests."""
BACKWARDS = 1e-3
"""How probable a step of the grid against the drive's direction is inside a swing: a shake, no turn."""
TAIL = 1e-5
"""Of the most probable step: what any step within reach has at least."""
GRID_NOISE = 0.03
"""Of the amplitude; what a block's phase being one number costs."""
MOST_ODDS = 1e12
"""What is said instead of larger odds."""


@dataclass(frozen=True)
class Nodes:
    """Blocks of rows on which branches are chosen.

    ``starts`` first rows of the blocks; ``turns`` the blocks that begin at a turn of
    the drive, the first and the last block included.
    """

    starts: Indices
    turns: Indices


@dataclass(frozen=True)
class Light:
    """What the photodiode would show: offset, amplitude and noise; ``weight`` 0 where a row says nothing."""

    offset: Floats
    amplitude: Floats
    noise: float
    weight: Floats


@dataclass(frozen=True)
class Fit:
    """A model of the phase at the nodes, and what it is thought to be off by.

    ``phase`` rad (nodes); ``step`` standard deviation behind each inner turn, rad;
    ``wander`` standard deviation over the first fringe inside a swing, rad.
    """

    phase: Floats
    step: Floats
    wander: float


def make_nodes(
    time: Floats, drive: Floats, turns: Indices, fringes_a_volt: float
) -> Nodes:
    """Cut rows into blocks, ``NODES`` in a fringe, with a cut at every turn; rests are cut by time."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(drive)))])
    length = float(time[-1] - time[0])
    pace = 100.0 * turns.size / length
    place = travel * fringes_a_volt * NODES + (time - time[0]) * pace
    cut = np.diff(np.floor(place)) > 0.0
    first = np.zeros(drive.size, dtype=bool)
    first[0] = True
    first[1:] = cut
    first[turns] = True
    starts = np.flatnonzero(first)
    return Nodes(starts, np.searchsorted(starts, turns))


def first_fit(
    columns: Columns,
    places: Floats,
    phases: Floats,
    swings: NDArray[np.int_],
    half_stroke: float,
    turn_count: int,
) -> Fit:
    """Return a model from crossings whose whole fringes are known inside a swing alone.

    Parameters
    ----------
    columns
        Terms of the actuator at the nodes.
    places, phases, swings
        Of the crossings: where among the nodes, the phase (rad, of an unknown whole
        number of fringes for each swing), and in which swing.
    half_stroke
        rad, about.
    turn_count
        Inner turns.
    """
    terms = columns.values.shape[1]
    nodes = np.arange(columns.values.shape[0])
    at_crossings = [
        np.interp(places, nodes, columns.values[:, term]) for term in range(terms)
    ]
    names, which = np.unique(swings, return_inverse=True)
    counts = np.zeros((places.size, names.size))
    counts[np.arange(places.size), which] = 1.0
    rows = np.column_stack([*at_crossings, counts]) / CROSSING_NOISE
    prior = np.concatenate(
        [1.0 / (columns.spread * half_stroke) ** 2, np.full(names.size, 1e-8)]
    )
    expected = np.zeros(terms + names.size)
    expected[0] = half_stroke
    information = rows.T @ rows + np.diag(prior)
    covariance: Floats = np.asarray(np.linalg.inv(information), dtype=np.float64)
    solution: Floats = covariance @ (
        rows.T @ (phases / CROSSING_NOISE) + prior * expected
    )
    solution = _with_whole_counts(solution, covariance, terms, names.size)
    step = np.full(turn_count, 2.0 * STEP_BEFORE * TURN)
    phase = columns.values @ solution[:terms] + solution[terms]
    return Fit(phase, step, WANDER_BEFORE * TURN)


def _with_whole_counts(
    solution: Floats, covariance: Floats, terms: int, swings: int
) -> Floats:
    """Return the solution once the counts of all swings differ by whole fringes.

    The best known difference first, and the others conditioned on it. The first swing's
    count is the zero.
    """
    solution = solution.copy()
    covariance = covariance.copy()
    settled = [terms]
    waiting = list(range(terms + 1, terms + swings))
    while waiting:
        zero = settled[0]
        variances = [
            covariance[count, count]
            + covariance[zero, zero]
            - 2.0 * covariance[count, zero]
            for count in waiting
        ]
        count = waiting.pop(int(np.argmin(variances)))
        difference = covariance[:, count] - covariance[:, zero]
        variance = float(difference[count] - difference[zero])
        value = float(solution[count] - solution[zero])
        whole = TURN * round(value / TURN)
        settled.append(count)
        if variance > 1e-9:
            gain = difference / variance
            solution += gain * (whole - value)
            covariance -= np.outer(gain, difference)
    return solution


def block_likelihood(
    nodes: Nodes, signal: Floats, light: Light, phase: Floats, grid: Floats
) -> Floats:
    """Return the log-likelihood of each block (rows) for each distance from the model's phase (columns).

    The sum over a block of (s - A - B cos(p + e))^2 is a quadratic form of cos e and
    sin e, so that rows are gone through once whatever the grid.
    """
    rest = signal - light.offset
    cosine = light.amplitude * np.cos(phase)
    sine = light.amplitude * np.sin(phase)
    weight = light.weight
    products = [
        weight * rest * rest,
        weight * rest * cosine,
        weight * rest * sine,
        weight * cosine * cosine,
        weight * cosine * sine,
        weight * sine * sine,
        weight,
        weight * light.amplitude**2,
    ]
    sums = [np.add.reduceat(product, nodes.starts)[:, None] for product in products]
    c, s = np.cos(grid), np.sin(grid)
    squares = (
        sums[0]
        - 2.0 * c * sums[1]
        + 2.0 * s * sums[2]
        + c * c * sums[3]
        - 2.0 * s * c * sums[4]
        + s * s * sums[5]
    )
    variance = light.noise**2 + GRID_NOISE**2 * sums[7]
    likelihood: Floats = -0.5 * squares / variance
    return likelihood


def step_variances(nodes: Nodes, fit: Fit) -> Floats:
    """Return the variance of the chain's step into each block but the first, rad^2.

    Behind a turn the step of that turn is spread over the first fringe that the model
    goes.
    """
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(fit.phase)))]) / TURN
    variances = fit.wander**2 * np.diff(travel) + NODE_NOISE**2
    for turn, deviation in zip(nodes.turns[1:-1], fit.step, strict=True):
        past = travel[turn:] - travel[turn]
        share = np.diff(np.minimum(past, 1.0))
        inside = np.flatnonzero(past[:-1] < 1.0)
        if inside.size == 0:
            continue
        near = slice(turn, turn + inside.size)
        part = share[: inside.size]
        total = float(part.sum())
        if total < 0.05:
            part = np.full(inside.size, 1.0 / inside.size)
            total = 1.0
        variances[near] += deviation**2 * part / total
    return variances


def _kernel(variance: float, spacing: float, direction: int, most_back: int) -> Floats:
    """Return the chain's step as weights on the grid, an odd number of them.

    Parameters
    ----------
    variance
        rad^2.
    spacing
        Of the grid, rad.
    direction
        Where the phase runs, +1 or -1; 0 where it may run both ways.
    most_back
        Steps against that direction that only make up for what the model has gone.
    """
    ratio = variance / spacing**2
    if ratio < 0.25:
        steps = np.array([-1.0, 0.0, 1.0])
        weights = np.array([0.5 * ratio, 1.0 - ratio, 0.5 * ratio])
    else:
        reach = max(int(np.ceil(4.5 * np.sqrt(ratio))) + 1, LEAST_REACH)
        steps = np.arange(-reach, reach + 1.0)
        weights = np.exp(-0.5 * steps**2 / ratio) + TAIL
    if direction != 0:
        against = np.maximum(-direction * steps - most_back, 0.0)
        weights = weights * BACKWARDS**against
    return np.asarray(weights / weights.sum())


def one_way(nodes: Nodes, fit: Fit) -> tuple[Indices, Indices]:
    """Return for the step into each block but the first where the phase runs, and the steps it may lose.

    Inside a swing the displacement is monotone, but for shakes: the phase's distance
    from the model may fall by no more than the model has gone. Within ``FREE_TRAVEL``
    fringes behind a turn it may still run the old way. The first swing has no turn
    before it.
    """
    count = fit.phase.size - 1
    direction = np.zeros(count, dtype=np.intp)
    back = np.zeros(count, dtype=np.intp)
    spacing = TURN / GRID
    for number, (begin, end) in enumerate(
        zip(nodes.turns[:-1], nodes.turns[1:], strict=True)
    ):
        sign = 1 if fit.phase[end] > fit.phase[begin] else -1
        gone = np.maximum.accumulate(
            sign * (fit.phase[begin : end + 1] - fit.phase[begin])
        )
        back[begin:end] = np.diff(np.floor(gone / spacing)).astype(np.intp)
        free = FREE_TRAVEL * TURN if number > 0 else 0.0
        direction[begin:end] = np.where(gone[:-1] >= free, sign, 0)
    return direction, back


@dataclass(frozen=True)
class Chain:
    """The chain of distances from the model: its grid, likelihoods, steps and messages both ways."""

    grid: Floats
    start: Floats
    weights: Floats
    kernels: list[Floats]
    forward: Floats
    backward: Floats

    @property
    def distance(self) -> Floats:
        """The most probable path (Viterbi's), rad (nodes)."""
        count, size = self.weights.shape
        logs = np.log(self.weights)
        best = self.start + logs[0]
        back = np.empty((count, size), dtype=np.int16)
        places = np.arange(size)
        for node in range(1, count):
            kernel = np.log(np.maximum(self.kernels[node - 1][::-1], 1e-300))
            reach = kernel.size // 2
            padded = np.full(size + 2 * reach, -np.inf)
            padded[reach : reach + size] = best
            ways = sliding_window_view(padded, kernel.size) + kernel
            choice = np.argmax(ways, axis=1)
            back[node] = places + choice - reach
            best = ways[places, choice] + logs[node]
        path = np.empty(count, dtype=np.intp)
        path[-1] = int(np.argmax(best))
        for node in range(count - 1, 0, -1):
            path[node - 1] = back[node, path[node]]
        return self.grid[path]

    def moved(self, belief: Floats, first: int, last: int) -> Floats:
        """Return a belief at block ``first`` brought to block ``last``, normalised."""
        for node in range(first, last):
            belief = _step(belief, self.kernels[node]) * self.weights[node + 1]
            belief = belief / belief.sum()
        return belief


def _step(belief: Floats, kernel: Floats) -> Floats:
    """Return a belief after one step; what leaves the grid is lost."""
    reach = kernel.size // 2
    return np.convolve(belief, kernel)[reach : reach + belief.size]


def follow(
    nodes: Nodes,
    signal: Floats,
    light: Light,
    fit: Fit,
    phase: Floats,
    reach: float = REACH,
) -> Chain:
    """Run the chain over all blocks, forwards and backwards.

    Parameters
    ----------
    nodes, signal, light
        The blocks; the photodiode's rows; what it would show.
    fit
        The model at the nodes.
    phase
        The model at every row, rad.
    reach
        Fringes to either side.
    """
    side = round(reach * GRID)
    spacing = TURN / GRID
    grid: Floats = spacing * np.arange(-side, side + 1.0)
    logs = block_likelihood(nodes, signal, light, phase, grid)
    weights = np.exp(logs - logs.max(axis=1, keepdims=True)) + 1e-30
    direction, back = one_way(nodes, fit)
    kernels = []
    for step, variance in enumerate(step_variances(nodes, fit).tolist()):
        kernels.append(
            _kernel(variance, spacing, int(direction[step]), int(back[step]))
        )
    count = weights.shape[0]
    forward = np.empty_like(weights)
    backward = np.empty_like(weights)
    start = np.where(np.abs(grid) <= START * TURN + 0.5 * spacing, 0.0, -1e4)
    belief = weights[0] * np.exp(start)
    forward[0] = belief / belief.sum()
    for node in range(1, count):
        belief = _step(forward[node - 1], kernels[node - 1]) * weights[node]
        forward[node] = belief / belief.sum()
    backward[-1] = 1.0
    for node in range(count - 2, -1, -1):
        belief = _step(backward[node + 1] * weights[node + 1], kernels[node][::-1])
        backward[node] = belief / belief.max()
    return Chain(grid, start, weights, kernels, forward, backward)


def refit(columns: Columns, nodes: Nodes, phase: Floats, half_stroke: float) -> Fit:
    """Fit the model to a path, with a random step at every inner turn.

    A step is thought to be as large as the steps of this log are (with ``STEP_COUNT``
    turns of ``STEP_BEFORE`` beside them), and to be known as well as the other turns
    foretell it: its estimate with the turn's own prior taken off.

    Parameters
    ----------
    columns
        Terms of the actuator at the nodes.
    nodes
        The blocks.
    phase
        rad, at the nodes.
    half_stroke
        rad, about.
    """
    terms = columns.values.shape[1]
    inner = nodes.turns[1:-1]
    count = columns.values.shape[0]
    steps = (np.arange(count)[:, None] >= inner[None, :]).astype(np.float64)
    rows = np.column_stack([columns.values, np.ones(count), steps])
    expected = np.zeros(rows.shape[1])
    expected[0] = half_stroke
    before = (STEP_BEFORE * TURN) ** 2
    variance = before
    noise = 0.05 * TURN
    products = rows.T @ rows
    targets = rows.T @ phase
    prior = np.concatenate(
        [1.0 / (columns.spread * half_stroke) ** 2, [1e-8], np.zeros(inner.size)]
    )
    first = terms + 1
    for _ in range(6):
        prior[first:] = 1.0 / variance
        weight = 1.0 / (noise**2 * NODES)
        covariance = np.linalg.inv(weight * products + np.diag(prior))
        solution = covariance @ (weight * targets + prior * expected)
        residual = phase - rows @ solution
        noise = max(float(np.sqrt(np.mean(residual**2))), 0.1)
        spread = np.diag(covariance)[first:]
        found = solution[first:] ** 2 + spread
        variance = float(
            (found.sum() + STEP_COUNT * before) / (inner.size + STEP_COUNT)
        )
    rest = 1.0 / np.maximum(1.0 / spread - 1.0 / variance, 1e-6)
    model = rows[:, :first] @ solution[:first]
    return Fit(model, np.sqrt(variance + rest), _wander_of(nodes, phase - model, model))


def _wander_of(nodes: Nodes, distance: Floats, model: Floats) -> float:
    """Return by how much the distance from the model changes in a fringe inside a swing, rad (RMS)."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(model)))]) / TURN
    largest = LEAST_WANDER * TURN
    for length in WANDER_LENGTHS:
        changes = []
        for begin, end in pairwise(nodes.turns):
            inside = travel[begin : end + 1]
            marks = np.arange(inside[0] + length, inside[-1], length)
            values = np.interp(marks, inside, distance[begin : end + 1])
            changes.append(np.diff(values))
        every = np.concatenate(changes)
        if every.size < FEWEST_CHANGES:
            return WANDER_BEFORE * TURN
        largest = max(largest, float(np.sqrt(np.mean(every**2) / length)))
    return largest


def doubt(chain: Chain, distance: Floats) -> Floats:
    """Return the variance of the phase at each block that comes from other branches, rad^2.

    At the top of a fringe the phase may have turned before it or behind it and nobody
    sees which.
    """
    belief = chain.forward * chain.backward
    belief /= belief.sum(axis=1, keepdims=True)
    away = chain.grid[None, :] - distance[:, None]
    far = np.abs(away) > 0.5 * SAME_BRANCH * TURN
    variance: Floats = np.sum(np.where(far, belief * away * away, 0.0), axis=1)
    return variance


def anchors_of(nodes: Nodes, model: Floats) -> Indices:
    """Return the block in the middle of each swing, by the model's travel."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(model)))])
    middles = []
    for begin, end in zip(nodes.turns[:-1], nodes.turns[1:], strict=True):
        half = 0.5 * (travel[begin] + travel[end])
        middles.append(int(np.searchsorted(travel[begin : end + 1], half)) + int(begin))
    return np.array(middles, dtype=np.intp)


def turn_odds(
    chain: Chain, distance: Floats, anchors: Indices
) -> tuple[Floats, Floats]:
    """Return for each inner turn the odds of the branch taken over all others, and what else it could be.

    From the middle of the swing before, on the branch taken there, to the middle of the
    swing behind, with all that comes later: the probability near the path over the
    rest. The second array is how far the most probable of the others is from the path,
    rad.
    """
    odds = np.empty(max(anchors.size - 1, 0))
    others = np.empty(odds.size)
    for place, (before, after) in enumerate(pairwise(anchors)):
        away = np.abs(chain.grid - distance[before]) > SAME_BRANCH * TURN
        belief = np.where(away, 0.0, chain.forward[before])
        belief = chain.moved(belief, int(before), int(after)) * chain.backward[after]
        belief = belief / belief.sum()
        away = np.abs(chain.grid - distance[after]) > SAME_BRANCH * TURN
        rest = float(belief[away].sum())
        odds[place] = min((1.0 - rest) / max(rest, 1.0 / MOST_ODDS), MOST_ODDS)
        others[place] = (
            chain.grid[int(np.argmax(np.where(away, belief, -1.0)))] - distance[after]
        )
    return odds, others
