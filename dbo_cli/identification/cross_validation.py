"""Cross-validation: how well a fit predicts parts of the logs that it was made without."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Booleans, Floats, Integers
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.solve import Equations, Solution

FLOOR = 1e-4  # of the output's standard deviation: a smaller error is as good
PRICE = 0.1
"""What a family must gain in the logarithm of the error left out: each kind of memory, the past."""
DRIFT_PRICE = 0.4
"""The same for drift, and for memories that stood elsewhere than at a log's first value.

No new move has them: what a slow memory explains nearly as well is neither.
"""


def cross_validate(problem: Problem, fit: Solution, equations: Equations) -> Solution:
    """Return the fit with what it leaves of each part left out, and its score.

    A fit without a part is one step from the fit to all rows. ``equations`` are the fit's.

    Raises
    ------
    FitError
        A part leaves rows that determine nothing.
    """
    rows = equations.rows
    table = equations.table(fit)
    groups, of_row = problem.groups
    grams = np.empty((len(groups), table.shape[1], table.shape[1]))
    for index in range(len(groups)):
        group = table[of_row == index]
        grams[index] = group.T @ group
    total = np.add.reduce(grams)
    residuals = []
    for number, mask in enumerate(problem.parts):
        remaining = total - np.add.reduce(grams[groups[:, number]])
        share = float(rows.weights[mask].sum())
        error = equations.fit_of(equations.step(remaining / (1.0 - share))).error
        residuals.append(left_out(error, mask, problem))
    return replace(
        fit, residuals=tuple(residuals), score=score(problem, fit, residuals)
    )


def left_out(error: Floats, mask: Booleans, problem: Problem) -> Floats:
    """Return the errors of a part, less their mean over each log that it holds as a whole."""
    owner, error = problem.owner[mask], error[mask]
    for index, log in enumerate(problem.logs):
        rows = owner == index
        if np.count_nonzero(rows) == len(log.rows):
            error[rows] -= error[rows].mean()
    return error


def error_left_out(residuals: Sequence[Floats]) -> float:
    """Return the RMS over all parts, each as heavy as another, of what was left of them."""
    return math.sqrt(float(np.mean([np.mean(error**2) for error in residuals])))


def score(problem: Problem, fit: Solution, residuals: Sequence[Floats]) -> float:
    """Return the logarithm of what is left of a part, the mean of the RMS errors, and the price of the terms.

    Not the mean of their squares, since a part that nothing predicts must not decide alone.
    Rows weigh the less, the more another past of the gears would change them.
    """
    floor = FLOOR * float(problem.output.std())
    errors = []
    for mask, error in zip(problem.parts, residuals, strict=True):
        square = float(np.average(error**2, weights=problem.known[mask]))
        errors.append(math.sqrt(square))
    structure = fit.structure
    families = len(structure.memories) + structure.past
    families += structure.start != "settled"
    unlike_moves = structure.drift + (structure.level is not None)
    price = PRICE * families + DRIFT_PRICE * unlike_moves
    return math.log(max(float(np.mean(errors)), floor)) + price


def least_score(problem: Problem, fit: Solution) -> float:
    """Return what the score can be at best: no part is predicted better than it is fitted."""
    return score(problem, fit, [fit.error[mask] for mask in problem.parts])


def line_left_out(problem: Problem, straight: bool) -> float:
    """Return what a line or, where that is better, an offset leaves of the parts: RMS, in units of the fit.

    Beside them stand offsets of logs, and ``straight`` drifts where the fits have them.
    """
    drift = problem.drift(straight)
    offset = np.column_stack((np.ones(len(drift)), drift))
    drive = [log.fitted(log.drive) for log in problem.logs]
    errors = []
    for table in (offset, np.column_stack((offset, np.concatenate(drive)))):
        residuals = []
        for mask in problem.parts:
            kept = ~mask
            weights = np.linalg.lstsq(table[kept], problem.output[kept], rcond=None)[0]
            error = problem.output - table @ weights
            residuals.append(left_out(error, mask, problem))
        errors.append(error_left_out(residuals))
    return min(errors)


def unexplained_share(problem: Problem, residuals: Sequence[Floats]) -> float:
    """Return what is left of parts left out over the output there, both less their mean over each swing.

    Walks that have nothing to do with each other go along for a while, but not within a
    swing. About 1: the displacement does not follow the drive. Windows from swing to
    swing and from mid-swing to mid-swing; the smaller share counts.
    """
    shares = []
    for shift in (0.0, 0.5):
        windows = _windows(problem, shift)
        error = output = 0.0
        for mask, residual in zip(problem.parts, residuals, strict=True):
            error += _variance_within(residual, windows[mask])
            output += _variance_within(problem.output[mask], windows[mask])
        shares.append(math.sqrt(error / max(output, 1e-300)))
    return min(shares)


def _windows(problem: Problem, shift: float) -> Integers:
    """Return the number of each row's swing; swings begin a part ``shift`` of themselves later."""
    numbers, first = [], 0
    for log in problem.logs:
        begins = log.swings.turns[:-1] + shift * log.swings.rows
        numbers.append(first + np.searchsorted(begins, log.rows, side="right"))
        first += len(begins) + 1
    return np.concatenate(numbers)


def _variance_within(values: Floats, windows: Integers) -> float:
    """Return the mean square of values less their mean over each window."""
    _, index = np.unique(windows, return_inverse=True)
    mean = np.bincount(index, values) / np.bincount(index)
    return float(np.mean((values - mean[index]) ** 2))
