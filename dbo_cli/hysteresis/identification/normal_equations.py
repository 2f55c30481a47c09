"""Solution of the problem from its sufficient statistics, under the sign rules that keep it invertible."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError

Floats = NDArray[np.float64]

SLOPE_FLOOR = 1e-3
"""Least slope of a gear, as a share of the mean: flatter ones drown in the rounding of the inverse."""

MAX_STEEPNESS = 15.0
"""Steepest slope of the asymmetry over its mean; a segment's width is bounded from below by its inverse. With
narrower segments the curves of a shape-memory wire and of an end stop fit no better (less than 1 %)."""

RIDGE = 1e-12
"""Added to each column's own square, as a share of it: a column that was never excited stays harmless."""

TIE = 1e3
"""Weight of the equation that makes the widths of the segments add up to one, over the data's own."""


@dataclass(frozen=True)
class Columns:
    """Where the groups of unknowns stand: gears, time constants, inner knots of the asymmetry, drift."""

    gears: int
    memories: int
    segments: int
    drift: int

    @property
    def hats(self) -> int:
        """Number of inner knots."""
        return max(self.segments - 1, 0)

    @property
    def total(self) -> int:
        """Number of unknowns."""
        return self.gears + self.memories + self.hats + self.drift


@dataclass(frozen=True)
class Structure:
    """One candidate: which unknowns take part and how they are held.

    ``slopes`` is 'growing', 'falling' or 'free'; ``memories`` the indices of the time constants that take
    part; ``segments`` the segments of the asymmetry (1: none), a divisor of the statistics' own;
    ``smoothness`` the weight of the slopes' squared second difference, ``knot_smoothness`` that of the
    asymmetry's.
    """

    slopes: str
    memories: tuple[int, ...]
    segments: int
    smoothness: float
    knot_smoothness: float = 1e-6


@dataclass(frozen=True)
class Solution:
    """Unknowns of the problem in natural terms, and what the fit left over.

    ``heights`` of the gears (sum about 1), ``gains`` of all memories (zero where pruned), ``knots`` the
    deviation of the inner knots from the diagonal on the statistics' finest grid, ``drift`` the coefficients.
    """

    heights: Floats
    gains: Floats
    knots: Floats
    drift: Floats
    vector: Floats


def slope_map(gears: int, slopes: str) -> Floats:
    """Matrix that turns non-negative unknowns into slopes; shape (gears, gears)."""
    if slopes == "growing":
        return np.tril(np.ones((gears, gears)))
    if slopes == "falling":
        return np.triu(np.ones((gears, gears)))
    return np.eye(gears)


def knot_map(fine: int, coarse: int) -> Floats:
    """Matrix that gives the hats of ``coarse`` segments as sums of those of ``fine``, a multiple."""
    if coarse < 2:
        return np.empty((max(fine - 1, 0), 0))
    inner = np.arange(1, fine) / fine
    corners = np.arange(coarse + 1) / coarse
    return np.column_stack([np.interp(inner, corners, np.eye(coarse + 1)[k]) for k in range(1, coarse)])


def second_differences(count: int) -> Floats:
    """Matrix of second differences of ``count`` values; shape (count - 2, count)."""
    if count < 3:
        return np.empty((0, count))
    rows = np.eye(count - 2, count)
    return rows - 2.0 * np.eye(count - 2, count, 1) + np.eye(count - 2, count, 2)


def penalties(columns: Columns, structure: Structure, weight: float) -> Floats:
    """Quadratic form (in heights, gains, knots, drift) that keeps slopes and asymmetry smooth.

    Scaled as integrals over the range, so that one value of ``smoothness`` means the same for any number
    of gears.
    """
    gears = columns.gears
    form = np.zeros((columns.total, columns.total))
    bending = second_differences(gears) * gears  # heights -> slopes on a unit range
    form[:gears, :gears] = structure.smoothness * weight * gears**3 * (bending.T @ bending)
    if columns.hats:
        at = gears + columns.memories
        bent = second_differences(columns.segments + 1)[:, 1:-1]
        form[at : at + columns.hats, at : at + columns.hats] = (
            structure.knot_smoothness * weight * columns.segments**3 * (bent.T @ bent)
        )
    return form


def solve(gram: Floats, columns: Columns, structure: Structure, weight: float) -> Solution:
    """Minimise the squared equation error under the structure's sign rules.

    Parameters
    ----------
    gram : shape (total + 1, total + 1), products of the columns and (last) the target
    columns : the layout of ``gram``
    structure : the candidate
    weight : number of rows that went into ``gram`` (scales the penalties)

    Raises
    ------
    FitError
        The solver did not reach the optimum.
    """
    total, gears = columns.total, columns.gears
    matrix = gram[:total, :total] + penalties(columns, structure, weight)
    right = gram[:total, total]
    fixed = np.zeros(total)
    fixed[:gears] = SLOPE_FLOOR / gears
    bounded = np.zeros((total, gears + len(structure.memories)))
    bounded[:gears, :gears] = slope_map(gears, structure.slopes) / gears
    for place, memory in enumerate(structure.memories):
        bounded[gears + memory, gears + place] = 1.0
    at = gears + columns.memories
    free = np.zeros((total, columns.drift))
    free[at + columns.hats :, :] = np.eye(columns.drift)
    tie = None
    if structure.segments > 1:
        least, widths, spare = _bounded_widths(columns.segments, structure.segments)
        tie = bounded.shape[1], spare
        bounded = np.hstack((bounded, np.zeros((total, structure.segments))))
        bounded[at : at + columns.hats, tie[0] :] = widths
        fixed[at : at + columns.hats] = least
    vector = fixed + bounded_minimum(matrix, right - matrix @ fixed, bounded, free, tie)
    return Solution(
        heights=vector[:gears],
        gains=vector[gears:at],
        knots=vector[at : at + columns.hats],
        drift=vector[at + columns.hats :],
        vector=vector,
    )


@lru_cache(maxsize=32)  # a search solves hundreds of problems of a handful of shapes
def _bounded_widths(fine: int, segments: int) -> tuple[Floats, Floats, float]:
    """Inner knots of an asymmetry whose segments are at least 1 / (MAX_STEEPNESS segments) wide.

    Returns the deviations of the inner knots of ``fine`` segments with all segments at the bound, shape
    (fine - 1,); what each segment adds per unit of width beyond it, shape (fine - 1, segments), the last one
    nothing; and what all add up to.
    """
    narrowest = 1.0 / (MAX_STEEPNESS * segments)
    knots = knot_map(fine, segments)
    at_bound: Floats = knots @ (np.arange(1, segments) * (narrowest - 1.0 / segments))
    wider = knots @ np.tril(np.ones((segments - 1, segments - 1)))
    return at_bound, np.hstack((wider, np.zeros((len(wider), 1)))), 1.0 - segments * narrowest


def bounded_minimum(
    matrix: Floats, right: Floats, bounded: Floats, free: Floats, tie: tuple[int, float] | None
) -> Floats:
    """Minimise x'Mx - 2r'x over x = bounded p + free q, p >= 0; the free unknowns are eliminated first.

    ``tie``: the unknowns p from this index on add up to this number.
    """
    from scipy.linalg import cholesky, qr, solve_triangular
    from scipy.optimize import nnls

    # The factor is taken in the gears' own coordinates, where neighbours differ, not in those of the slope
    # increments, whose columns are sums over gears and nearly collinear.
    scale = np.sqrt(np.maximum(np.diag(matrix), RIDGE * float(np.trace(matrix))))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += RIDGE
    factor = cholesky(scaled, check_finite=False)
    goal: Floats = solve_triangular(factor, right / scale, trans="T", check_finite=False)
    both = np.hstack((free, bounded))
    rows = factor @ (scale[:, None] * both)
    if tie is not None:
        weight = TIE * float(np.linalg.norm(goal))
        equation = np.zeros((1, both.shape[1]))
        equation[0, free.shape[1] + tie[0] :] = weight
        rows = np.vstack((rows, equation))
        goal = np.append(goal, weight * tie[1])
    length = np.linalg.norm(rows, axis=0)
    rotated = qr(np.column_stack((rows / length, goal)), mode="r", check_finite=False)[0]
    factor, target = rotated[: len(length), :-1], rotated[: len(length), -1]
    count = free.shape[1]
    corner = factor[count:, count:]
    try:
        positive, _ = nnls(corner, target[count:], maxiter=60 * corner.shape[1])
    except RuntimeError as problem:
        raise FitError(
            "the least-squares solver did not converge: give fewer gears (`gears`) or leave out bad rows"
        ) from problem
    _check_optimum(corner, target[count:], positive)
    others = solve_triangular(
        factor[:count, :count], target[:count] - factor[:count, count:] @ positive, check_finite=False
    )
    answer: Floats = both @ (np.concatenate((others, positive)) / length)
    return answer


def _check_optimum(matrix: Floats, target: Floats, answer: Floats) -> None:
    """Hold the Karush-Kuhn-Tucker conditions of the non-negative problem; a solver may stop early unsaid."""
    gradient = matrix.T @ (matrix @ answer - target)
    size = float(np.linalg.norm(matrix.T @ target)) or 1.0
    falls_short = max(
        float(-gradient.min(initial=0.0)), float(np.abs(gradient[answer > 0.0]).max(initial=0.0))
    )
    if not falls_short <= 1e-7 * size:
        raise FitError(
            f"the least-squares solver stopped away from the optimum (gradient {falls_short / size:.1e} of "
            "its size): give fewer gears (`gears`) or leave out bad rows"
        )


def least_squares(gram: Floats, products: Floats) -> Floats:
    """Solve symmetric normal equations; columns that say the same, or nothing, share or get zero."""
    return np.asarray(np.linalg.lstsq(gram, products, rcond=1e-10)[0], dtype=np.float64)


def squared_error(gram: Floats, vector: Floats) -> float:
    """Sum of squared equation errors of ``vector`` over the rows of ``gram``."""
    full = np.append(vector, -1.0)
    return max(float(full @ gram @ full), 0.0)


def squared_error_free_of(gram: Floats, vector: Floats, nuisance: slice) -> float:
    """Sum of squared errors over the rows of ``gram`` after the nuisance columns are refitted to those rows.

    On rows left out, what only they have (the sensor's offset of a log of its own) is not the model's to
    predict.
    """
    if nuisance.start == nuisance.stop:
        return squared_error(gram, vector)
    full = np.append(vector, -1.0)
    full[nuisance] = 0.0
    left = float(full @ gram @ full)
    products = gram[nuisance, :] @ full
    return max(left - float(products @ least_squares(gram[nuisance, nuisance], products)), 0.0)
