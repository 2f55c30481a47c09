"""Model averaging: one model of the class, nearest to the weighted mean of the fits."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.identification.basis import PreparedLog, Structure
from dbo_cli.identification.problem import GOLDEN, Problem
from dbo_cli.identification.search import CURVES, likelihood
from dbo_cli.identification.solve import Equations, FittedRows, Solution
from dbo_cli.model.cascade import MOST_CANDIDATES

WIDTH = 0.15  # of the score: a fit that is worse by so much weighs exp(-1)
LEAST_WEIGHT = 1e-3
INVENTED_ROWS = 1500
INVENTED_WEIGHT = 0.5  # of a row, beside one of the logs
BEYOND = 0.05  # of the range: the invented drive goes so far beyond the logs'
REST = 0.25  # of a swing
SWING_ROWS = 40  # of the invented drive
SMOOTH_SLOPES = 1e-8  # of a mean prediction, which has no noise


def weighed(fits: Sequence[Solution]) -> list[Solution]:
    """Return the fits that begin as the best one does, weighed by their scores, the heaviest first.

    The weights have the sum 1.
    """
    start = min(fits, key=lambda fit: fit.score).structure.start
    fits = [fit for fit in fits if fit.structure.start == start]
    scores = np.asarray([fit.score for fit in fits])
    weights = np.exp(-(scores - scores.min()) / WIDTH)
    weights /= weights.sum()
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > LEAST_WEIGHT]
    weights /= weights[order].sum()
    return [replace(fits[index], weight=float(weights[index])) for index in order]


def mean_of(fits: Sequence[Solution], values: Floats) -> Floats:
    """Return the mean of what fits predict or leave, by their weights; ``values`` (fits, rows)."""
    weights = np.asarray([fit.weight for fit in fits])
    mean: Floats = np.einsum("k,kr->r", weights, values)
    return mean


def averaged_residuals(fits: Sequence[Solution]) -> list[Floats]:
    """Return what the mean prediction leaves of each part that was left out."""
    parts = zip(*(fit.residuals for fit in fits), strict=True)
    return [mean_of(fits, np.stack(residuals)) for residuals in parts]


def with_levels(
    weighed_fits: Sequence[Solution], fits: Sequence[Solution], swings: int
) -> list[Solution]:
    """Return weighed fits and, as heavy together, where memories may have stood before the logs.

    The level moves the zero. It shows in the first part, which the others do not predict
    when it is left out; so levels are weighed by how all rows are followed: the likelihood
    of a Gaussian error of one size a swing.

    Parameters
    ----------
    weighed_fits
        The first one's kind is taken at all levels.
    fits
        All there are.
    swings
        How many differ.
    """
    best = weighed_fits[0].structure
    levels: dict[float | None, Solution] = {}
    for fit in sorted(fits, key=lambda fit: fit.rmse):
        kind = fit.structure
        same = kind.memories == best.memories and kind.past == best.past
        if same and kind.start == best.start and not kind.drift:
            levels.setdefault(kind.level, fit)
    if len(levels) < 2:
        return list(weighed_fits)
    smallest = min(fit.rmse for fit in levels.values())
    weights = [likelihood(fit, smallest, swings) for fit in levels.values()]
    total = sum(weights)
    pairs = zip(levels.values(), weights, strict=True)
    return [
        *weighed_fits,
        *(replace(fit, weight=weight / total) for fit, weight in pairs),
    ]


def candidates(
    problem: Problem, invented: Problem, fits: Sequence[Solution]
) -> list[Solution]:
    """Return the fits that travel with a model: the heaviest, and those that add most to the spread.

    The heaviest has the weight of all that stay behind; the weights add up to 1. The
    spread is that of an invented move and of the logs.
    """
    weights = np.asarray([fit.weight for fit in fits])
    weights /= weights.sum()
    predicted = _predictions(problem, invented, fits)
    mean = np.einsum("k,kr->r", weights, predicted)
    adds = weights * np.mean((predicted - mean) ** 2, axis=1)
    heaviest = int(np.argmax(weights))
    adds[heaviest] = 0.0
    order = np.argsort(-adds, kind="stable")[: MOST_CANDIDATES - 1]
    added = [index for index in order.tolist() if adds[index] > 0.0]
    weights[heaviest] = 1.0 - weights[added].sum()
    return [
        replace(fits[index], weight=float(weights[index]))
        for index in (heaviest, *added)
    ]


def average_model(
    problem: Problem, invented: Problem, fits: Sequence[Solution]
) -> Solution:
    """Return the fit nearest to the mean prediction on the logs' drives and on an invented one."""
    if len(fits) == 1:
        return fits[0]
    mean = mean_of(fits, _predictions(problem, invented, fits))
    weights = np.full(len(mean), INVENTED_WEIGHT)
    weights[: len(problem.output)] = 1.0
    weights /= weights.sum()
    structure = _widest(fits)
    table = np.vstack((problem.columns(structure), invented.columns(structure)))
    free = np.zeros((len(mean), 0))
    rows = FittedRows(table, mean, weights, free, problem.cells.shares)
    nearest: Solution | None = None
    for smooth in CURVES:
        curved = replace(structure, smooth_curve=smooth)
        nearest = Equations(rows, curved).solve(nearest)
    assert nearest is not None
    return nearest


def _predictions(
    problem: Problem, invented: Problem, fits: Sequence[Solution]
) -> Floats:
    """Return what fits predict on the logs' rows and on an invented drive, memories settled before."""
    predicted = []
    for fit in fits:
        settled = replace(fit.structure, start="settled", level=None)
        rows = [fit.predict(each.columns(settled)) for each in (problem, invented)]
        predicted.append(np.concatenate(rows))
    return np.stack(predicted)


def _widest(fits: Sequence[Solution]) -> Structure:
    """Return a structure that holds all fits but for their delays and bends: those of most weight."""
    weights: dict[tuple[float, float], float] = {}
    for fit in fits:
        frame = fit.structure.delay, fit.structure.bend
        weights[frame] = weights.get(frame, 0.0) + fit.weight
    delay, bend = max(weights, key=lambda frame: weights[frame])
    slopes = {fit.structure.slopes for fit in fits}
    return Structure(
        slopes=slopes.pop() if len(slopes) == 1 else "free",
        memories=max((fit.structure.memories for fit in fits), key=len),
        smooth_slopes=SMOOTH_SLOPES,
        delay=delay,
        bend=bend,
        segments=fits[0].structure.segments,
    )


def invented_problem(problem: Problem) -> Problem:
    """Return the problem of an invented drive: nested turns over the range, resting at times.

    It is as fast as the logs' usual swings. A long swing has 40 rows: what is faster is
    told by the logs' own rows.
    """
    dt = float(max(problem.dt, problem.swing / SWING_ROWS))
    steps = max(round(problem.swing / dt), 4)
    here, parts, turn, rows = 0.0, [np.zeros(1)], 0, 1
    while rows < INVENTED_ROWS:
        turn += 1
        there = 1.0 if turn == 1 else (turn * GOLDEN) % 1.0
        speed = np.exp(1.4 * ((turn * GOLDEN**2 * 2.0) % 1.0) - 0.7)
        count = max(int(steps * abs(there - here) * speed), 3)
        parts.append(here + (there - here) * np.arange(1, count + 1) / count)
        if turn % 5 == 0:
            parts.append(np.full(max(int(REST * steps), 1), there))
        rows += len(parts[-1])
        here = there
    drive = (1.0 + 2.0 * BEYOND) * np.concatenate(parts) - BEYOND
    every = np.arange(len(drive))
    time = np.asarray(dt * every, dtype=np.float64)
    log = PreparedLog(drive, drive, time, dt, every, every + 1)
    return replace(problem, logs=(log,))
