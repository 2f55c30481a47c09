"""Orders chosen on data left out: blocked cross-validation and the one-standard-error rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.identification.normal_equations import (
    Structure,
    solve,
    squared_error,
)
from dbo_cli.hysteresis.identification.statistics import Statistics

Floats = NDArray[np.float64]

INDIFFERENCE = 0.02  # a gain in RMSE below this share is not worth a larger model, however certain

MAX_STANDARD_ERROR = 0.03  # of the RMSE: what one standard error can excuse at most


@dataclass(frozen=True)
class Score:
    """Cross-validated error of one candidate.

    ``mean_squares`` of each fold, shape (folds,), in the square of the normalised output; ``weights`` the
    folds' share of the rows.
    """

    mean_squares: Floats
    weights: Floats

    @property
    def rmse(self) -> float:
        """Root of the mean square over all rows left out in turn."""
        return float(np.sqrt(self.weights @ self.mean_squares))

    def excess_over(self, other: Score) -> Floats:
        """Logarithm of the ratio of the root mean squares, fold by fold; shape (folds,).

        Ratios let a small loop count as much as a large one, and a short log as much as a long one's part.
        """
        tiny = np.finfo(float).tiny
        ratios: Floats = 0.5 * np.log((self.mean_squares + tiny) / (other.mean_squares + tiny))
        return ratios


def cross_validate(statistics: Statistics, structure: Structure) -> Score:
    """Leave out each fold in turn, fit the others, and measure the error on the fold left out."""
    _, states = statistics.minimum(structure)
    errors = [
        statistics.left_out(structure, fold, states) / max(rows, 1) for fold, rows in enumerate(statistics.rows)
    ]
    rows_of = np.asarray(statistics.rows, dtype=float)
    return Score(np.asarray(errors), rows_of / rows_of.sum())


def fitted_rmse(statistics: Statistics, structure: Structure) -> float:
    """RMS error over all rows of a fit to all of them."""
    gram, rows = statistics.total()
    vector = solve(gram, statistics.columns, structure, rows).vector
    return float(np.sqrt(squared_error(gram, vector) / rows))


def no_worse(
    candidate: Score,
    best: Score,
    indifference: float = INDIFFERENCE,
    max_standard_error: float = MAX_STANDARD_ERROR,
) -> bool:
    """Whether ``candidate`` is within one standard error, or within the indifference, of ``best``.

    The standard error is that of the paired ratios between folds, which have most of their scatter in
    common. With few or uneven folds it says little, so it excuses a loss only up to ``max_standard_error``.
    """
    excess = candidate.excess_over(best)
    mean = float(excess.mean())
    error = float(excess.std()) / np.sqrt(max(len(excess) - 1, 1))
    return bool(mean <= max(min(error, max_standard_error), float(np.log1p(indifference))))


def simplest_of(
    scores: Sequence[Score],
    indifference: float = INDIFFERENCE,
    max_standard_error: float = MAX_STANDARD_ERROR,
) -> int:
    """Index of the first (simplest first) candidate that is no worse than the best of all."""
    best = min(scores, key=lambda score: float(score.excess_over(scores[0]).mean()))
    return next(
        k for k, score in enumerate(scores) if no_worse(score, best, indifference, max_standard_error)
    )
