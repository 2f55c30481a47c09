"""Cross-validation: how well a fit predicts parts of the logs that it was made without."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Booleans, Floats
from dbo_cli.errors import FitError
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.solve import Equations, Fit

FLOOR = 1e-4  # of the output's standard deviation: a smaller error is as good
PRICE = 0.1
"""What a family must gain in the logarithm of the error left out: each kind of memory, the past."""
DRIFT_PRICE = 0.4
"""The same for drift, and for memories that stood elsewhere than at a log's first value.

No new move has them: what a slow memory explains nearly as well is neither.
"""


def cross_validate(problem: Problem, fit: Fit, equations: Equations) -> Fit:
    """Return the fit with what it leaves of each part left out, and its score.

    A fit without a part is one step from the fit to all rows. ``equations`` are the fit's.
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
        error = fit.error
        try:
            share = float(rows.weights[mask].sum())
            step = equations.step(remaining / (1.0 - share))
            error = equations.fit_of(step).error
        except FitError:
            pass
        residuals.append(without_lost_offsets(error, mask, problem)[mask])
    return replace(
        fit, residuals=tuple(residuals), score=score(problem, fit, residuals)
    )


def without_lost_offsets(error: Floats, mask: Booleans, problem: Problem) -> Floats:
    """Return errors less their mean over each log that was left out as a whole."""
    owner, error = problem.owner, error.copy()
    for index in range(len(problem.logs)):
        mine = owner == index
        if len(problem.logs) > 1 and not (mine & ~mask).any():
            error[mine] -= error[mine].mean()
    return error


def error_left_out(residuals: Sequence[Floats]) -> float:
    """Return the RMS over all parts, each as heavy as another, of what was left of them."""
    return math.sqrt(float(np.mean([np.mean(error**2) for error in residuals])))


def score(problem: Problem, fit: Fit, residuals: Sequence[Floats]) -> float:
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
    unlike_moves = structure.drift + (structure.level is not None)
    price = PRICE * families + DRIFT_PRICE * unlike_moves
    return math.log(max(float(np.mean(errors)), floor)) + price


def least_score(problem: Problem, fit: Fit) -> float:
    """Return what the score can be at best: no part is predicted better than it is fitted."""
    return score(problem, fit, [fit.error[mask] for mask in problem.parts])
