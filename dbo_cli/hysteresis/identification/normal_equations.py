"""Solution of the problem from its sufficient statistics, under the sign rules that keep it invertible.

The unknowns of the gears, the memories, the asymmetry and the drift are linear in
others for which the rules are plain signs: the steps from slope to slope, the gains,
the widths of segments beyond the least. The products of all rows are brought into these
once; after that a structure is a choice of unknowns and two penalties, and costs a
fifth of a millisecond to solve.

The two loops of an identification stand here in Python and compiled (``_fit.c``), bit
for bit the same. Every sum is taken in one fixed order: no library that deals its work
out to threads takes part, so that the same logs give the same model, to the last bit,
wherever it is identified.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis import kernel

Floats = NDArray[np.float64]
States = NDArray[np.uint8]

AT_ZERO, POSITIVE, FREE, ABSENT = range(4)  # of an unknown of ``minimise``

ROWS = 32  # of a table whose products are held at once: 3 MB with 100 columns
# steps without progress before unknowns are exchanged one by one (Júdice and Pires,
# 1994)
PATIENCE = 3


def add_products(table: Floats, columns: int, matrix: Floats) -> None:
    """Add the products of all pairs of columns to the upper triangle of ``matrix``, row after row."""
    rows = table.reshape(-1, columns)
    for first in range(0, len(rows), ROWS):
        part = rows[first : first + ROWS]
        products = part[:, :, None] * part[:, None, :]
        for of_row in products:
            matrix += of_row


def _solved(matrix: Floats, right: Floats) -> Floats | None:
    """Solve positive definite equations by Cholesky's factor; None where they are not."""
    upper, x = matrix.copy(), right.copy()
    count = len(right)
    for j in range(count):
        if not upper[j, j] > 0.0:
            return None
        upper[j, j] = root = np.sqrt(upper[j, j])
        row = upper[j, j + 1 :]
        row /= root
        upper[j + 1 :, j + 1 :] -= row[:, None] * row
        x[j] /= root
        x[j + 1 :] -= row * x[j]
    for j in range(count - 1, -1, -1):
        x[j] /= upper[j, j]
        x[:j] -= upper[:j, j] * x[j]
    return x


def minimise(
    matrix: Floats, right: Floats, state: States, x: Floats, tolerance: float, most: int
) -> int:
    """Minimise x'Hx - 2 g'x, x >= 0 but for the free unknowns, by block principal pivoting.

    Unknowns are guessed to be zero or positive (``state``, changed in place); all that
    turn out on the wrong side change sides at once, and one by one where that does not
    get on (Júdice and Pires, 1994; Kim and Park, 2011). Returns the number of steps, 0
    where ``most`` do not end it, -1 where H is not positive definite. A gradient counts
    as negative beyond ``tolerance``.
    """
    fewest, patience = len(right) + 1, PATIENCE
    for step in range(1, most + 1):
        at = np.flatnonzero((state == POSITIVE) | (state == FREE))
        part = _solved(matrix[np.ix_(at, at)], right[at])
        if part is None:
            return -1
        x[:] = 0.0
        x[at] = part
        dual = -right
        for row, value in zip(at.tolist(), part.tolist(), strict=True):
            dual += matrix[row] * value
        wrong = ((state == POSITIVE) & (x < 0.0)) | (
            (state == AT_ZERO) & (dual < -tolerance)
        )
        count = int(wrong.sum())
        if not count:
            return step
        if count < fewest:
            fewest, patience = count, PATIENCE
        else:
            patience -= 1
        if patience < 0:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        state[wrong] = POSITIVE - state[wrong]  # the one becomes the other
    return 0


def _choose() -> Any:
    """Return the extension where the compiled kernel is chosen and it was built, else this module."""
    if kernel.KIND == "compiled":
        with contextlib.suppress(ImportError):
            from dbo_cli.hysteresis import _fit  # type: ignore[attr-defined,unused-ignore]

            return _fit
    return sys.modules[__name__]


CHOSEN = _choose()

SLOPE_FLOOR = 1e-3
"""Least slope of a gear, as a share of the mean: flatter ones drown in the rounding of the inverse. And of a
memory, which is pruned below (half and double: 0.1 % on new moves).
"""

MAX_STEEPNESS = 15.0
"""Steepest slope of the asymmetry over its mean; a segment's width is bounded from below by its inverse.
Measured: docs/choices.md.
"""

RIDGES = (1e-12, 1e-10, 1e-8, 1e-6)
"""Added to each column's own square, as a share of it: a column that was never excited stays harmless. The
first does but where rounding leaves products of hundreds of nearly equal columns
without a root.
"""

TIE = 1e4
"""Weight, over the data's own, of the equation that makes the widths of the segments add up to one, where the
last of them is at its bound (elsewhere it is what the others leave).
"""

TOLERANCE = 1e-8
"""Of the largest gradient at the start: a gradient below it lowers the sum of squares by 1e-16 of itself."""

KNOT_SMOOTHNESS = 1e-6  # of few segments of the asymmetry, whose kinks are the curve
MOST_STEPS = 1000  # of the solver, which takes 3 to 30


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

    ``slopes`` is 'growing', 'falling' or 'free'; ``memories`` the indices of the time
    constants that take part; ``segments`` the segments of the asymmetry (1: none), a
    divisor of the statistics' own; ``smoothness`` the weight of the slopes' squared
    second difference, ``knot_smoothness`` that of the asymmetry's.
    """

    slopes: str
    memories: tuple[int, ...]
    segments: int
    smoothness: float
    knot_smoothness: float = KNOT_SMOOTHNESS


@dataclass(frozen=True)
class Solution:
    """Unknowns of the problem in natural terms, and what the fit left over.

    ``heights`` of the gears (sum about 1), ``gains`` of all memories (zero where
    pruned), ``knots`` the deviation of the inner knots from the diagonal on the
    statistics' finest grid, ``drift`` the coefficients.
    """

    heights: Floats
    gains: Floats
    knots: Floats
    drift: Floats

    @property
    def vector(self) -> Floats:
        """All unknowns, in the order of the statistics' columns."""
        return np.concatenate((self.heights, self.gains, self.knots, self.drift))


def knot_map(fine: int, coarse: int) -> Floats:
    """Matrix that gives the hats of ``coarse`` segments as sums of those of ``fine``, a multiple."""
    if coarse < 2:
        return np.empty((max(fine - 1, 0), 0))
    inner = np.arange(1, fine) / fine
    corners = np.arange(coarse + 1) / coarse
    return np.column_stack(
        [np.interp(inner, corners, np.eye(coarse + 1)[k]) for k in range(1, coarse)]
    )


def second_differences(count: int) -> Floats:
    """Matrix of second differences of ``count`` values; shape (count - 2, count)."""
    if count < 3:
        return np.empty((0, count))
    rows = np.eye(count - 2, count)
    return rows - 2.0 * np.eye(count - 2, count, 1) + np.eye(count - 2, count, 2)


@lru_cache(maxsize=32)
def penalties(columns: Columns) -> tuple[Floats, Floats]:
    """Quadratic forms, in all unknowns and the target, of what bends slopes and asymmetry.

    Scaled as integrals over the range, so that one value of ``smoothness`` means the
    same for any number of gears.
    """
    gears, at = columns.gears, columns.gears + columns.memories
    slopes, knots = np.zeros((2, columns.total + 1, columns.total + 1))
    bending = second_differences(gears) * gears  # heights -> slopes on a unit range
    slopes[:gears, :gears] = gears**3 * np.einsum("ki,kj->ij", bending, bending)
    bent = second_differences(columns.segments + 1)[:, 1:-1]
    inner = slice(at, at + columns.hats)
    knots[inner, inner] = columns.segments**3 * np.einsum("ki,kj->ij", bent, bent)
    return slopes, knots


@dataclass(frozen=True)
class SignedUnknowns:
    """The unknowns that have a sign, and what the columns' own are of them.

    heights = floor + steps added up, from the first (growing slopes) or from the last
    (falling); gains as they are; inner knots = those of the least widths + widths
    beyond them added up, all but the last segment's, which is what is left; drift as it
    is.
    """

    columns: Columns
    slopes: str
    segments: int

    @property
    def total(self) -> int:
        """Number of unknowns."""
        return (
            self.columns.gears
            + self.columns.memories
            + self.widths
            + self.columns.drift
        )

    @property
    def widths(self) -> int:
        """Number of unknown widths."""
        return self.segments - 1

    @property
    def spare(self) -> float:
        """What the widths beyond the least ones may add up to."""
        return 1.0 - 1.0 / MAX_STEEPNESS

    def states(self, memories: Sequence[int]) -> States:
        """Return the states from which the solver begins: no guess which unknowns are zero."""
        gears, count = self.columns.gears, self.columns.memories
        states = np.full(self.total, POSITIVE, np.uint8)
        states[gears : gears + count] = ABSENT
        states[[gears + k for k in memories]] = POSITIVE
        states[self.total - self.columns.drift :] = FREE
        return states

    def _along(self, table: Floats) -> Floats:
        """Return the transpose of the map, applied to rows for all columns and the target."""
        columns = self.columns
        gears, at = columns.gears, columns.gears + columns.memories
        heights = table[:gears] / gears
        steps = heights
        if self.slopes == "growing":
            steps = np.cumsum(heights[::-1], axis=0)[::-1]
        elif self.slopes == "falling":
            steps = np.cumsum(heights, axis=0)
        knots = table[at : at + columns.hats]
        constant = SLOPE_FLOOR * np.add.reduce(heights, axis=0) - table[-1]
        if self.widths:
            at_bound, wider = _segment_widths(columns.segments, self.segments)
            constant = constant + np.einsum("h,hc->c", at_bound, knots)
            knots = np.einsum("hw,hc->wc", wider, knots)
        else:
            knots = knots[:0]
        return np.vstack(
            (steps, table[gears:at], knots, table[at + columns.hats : -1], constant)
        )

    def products(self, gram: Floats) -> Floats:
        """Return the products of rows in these unknowns and (last) what is constant; (total + 1) square."""
        return self._along(self._along(gram).T)

    def solution(self, unknowns: Floats) -> Solution:
        """Return the columns' own unknowns."""
        columns = self.columns
        gears, at = columns.gears, columns.gears + columns.memories
        steps = unknowns[:gears]
        if self.slopes == "growing":
            steps = np.cumsum(steps)
        elif self.slopes == "falling":
            steps = np.cumsum(steps[::-1])[::-1]
        knots = np.zeros(columns.hats)
        if self.widths:
            at_bound, wider = _segment_widths(columns.segments, self.segments)
            knots = at_bound + np.einsum(
                "hw,w->h", wider, unknowns[at : at + self.widths]
            )
        drift = unknowns[self.total - columns.drift :]
        return Solution((SLOPE_FLOOR + steps) / gears, unknowns[gears:at], knots, drift)


@lru_cache(maxsize=32)
def _segment_widths(fine: int, segments: int) -> tuple[Floats, Floats]:
    """Inner knots of an asymmetry whose segments are at least 1 / (MAX_STEEPNESS segments) wide.

    Returns the deviations of the inner knots of ``fine`` segments with all segments at
    the bound, shape (fine - 1,), and what each segment but the last adds per unit of
    width beyond it, shape (fine - 1, segments - 1).
    """
    narrowest = 1.0 / (MAX_STEEPNESS * segments)
    knots = knot_map(fine, segments)
    at_bound = np.einsum(
        "hk,k->h", knots, np.arange(1, segments) * (narrowest - 1.0 / segments)
    )
    return at_bound, np.cumsum(knots[:, ::-1], axis=1)[:, ::-1].copy()


@lru_cache(maxsize=32)
def _signed_penalties(unknowns: SignedUnknowns) -> tuple[Floats, Floats]:
    slopes, knots = penalties(unknowns.columns)
    return unknowns.products(slopes), unknowns.products(knots)


def minimum(
    products: Floats,
    unknowns: SignedUnknowns,
    structure: Structure,
    weight: float,
    states: States,
) -> Floats:
    """Return the signed unknowns of least penalised error; ``states`` is the guess, and becomes the answer.

    Parameters
    ----------
    products : of rows, in these unknowns (see ``SignedUnknowns.products``)
    weight : number of rows that went into them (scales the penalties)

    Raises
    ------
    FitError
        The solver did not reach the optimum.
    """
    slopes, knots = _signed_penalties(unknowns)
    form = products + weight * (
        structure.smoothness * slopes + structure.knot_smoothness * knots
    )
    at = unknowns.columns.gears + unknowns.columns.memories
    widths = slice(at, at + unknowns.widths)
    return _least_within(form[:-1, :-1], -form[:-1, -1], states, widths, unknowns.spare)


def bounded_minimum(
    matrix: Floats,
    right: Floats,
    bounded: Floats,
    free: Floats,
    tie: tuple[int, float] | None,
) -> Floats:
    """Minimise x'Mx - 2r'x over x = bounded p + free q, p >= 0.

    ``tie``: the unknowns p from this index on add up to this number; the last of them
    moves nothing.
    """
    begin, spare = tie or (bounded.shape[1] + 1, 0.0)
    both = np.hstack((bounded[:, : bounded.shape[1] - (tie is not None)], free))
    count = both.shape[1] - free.shape[1]
    states = np.full(both.shape[1], POSITIVE, np.uint8)
    states[count:] = FREE
    form = np.einsum("ij,jk->ik", np.einsum("ji,jk->ik", both, matrix), both)
    goal = np.einsum("ji,j->i", both, right)
    unknowns = _least_within(form, goal, states, slice(begin, count), spare)
    answer: Floats = np.einsum("ij,j->i", both, unknowns)
    return answer


def _least_within(
    matrix: Floats, right: Floats, states: States, widths: slice, spare: float
) -> Floats:
    """Return the x of least x'Mx - 2 r'x under the signs of ``states``, its ``widths`` at most ``spare``."""
    x = _least(matrix, right, states)
    if float(x[widths].sum()) > spare:
        # One inequality is broken, so it holds as an equation where the error is least.
        tied, goal = matrix.copy(), right.copy()
        heavy = TIE * float(np.diagonal(tied)[widths].max())
        tied[widths, widths] += heavy
        goal[widths] += heavy * spare
        x = _least(tied, goal, states)
    return x


def _least(matrix: Floats, right: Floats, states: States) -> Floats:
    """Return the x of least x'Mx - 2 r'x under the signs of ``states``."""
    size = np.diagonal(matrix)
    scale = np.sqrt(
        np.maximum(size, max(RIDGES[0] * float(size.sum()), np.finfo(float).tiny))
    )
    scaled = matrix / scale[:, None] / scale
    goal = right / scale
    least = TOLERANCE * float(np.abs(goal).max(initial=0.0))
    for ridge in RIDGES:
        np.einsum("ii->i", scaled)[...] += ridge  # a view of the diagonal
        x, tried = np.zeros(len(goal)), states.copy()
        tolerance = least * float(np.sqrt(ridge / RIDGES[0]))
        # the guess led nowhere: begin without one, and less exactly
        if ridge > RIDGES[0]:
            tried[tried == AT_ZERO] = POSITIVE
        if (
            CHOSEN.minimise(
                np.ascontiguousarray(scaled), goal, tried, x, tolerance, MOST_STEPS
            )
            > 0
        ):
            states[:] = tried
            return x / scale
    raise FitError(
        "the least-squares solver did not converge: give fewer gears (`gears`) or leave out bad rows"
    )


def solve(
    gram: Floats, columns: Columns, structure: Structure, weight: float
) -> Solution:
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
    unknowns = SignedUnknowns(columns, structure.slopes, structure.segments)
    states = unknowns.states(structure.memories)
    return unknowns.solution(
        minimum(unknowns.products(gram), unknowns, structure, weight, states)
    )


def dot(a: Floats, b: Floats) -> float:
    """Return the sum of products of two signals.

    Not ``a @ b``: BLAS shares long sums among its threads, whose number then shows in
    the last digit.
    """
    return float(np.sum(a * b))


def sum_of_squares(values: Floats) -> float:
    """Return the sum of squares of a signal; see ``dot``."""
    return dot(values, values)


def least_squares(gram: Floats, products: Floats) -> Floats:
    """Solve symmetric normal equations; columns that say the same, or nothing, share or get zero."""
    states = np.full(len(products), FREE, np.uint8)
    return _least(gram, products, states) if len(products) else np.zeros(0)


def quadratic(form: Floats, vector: Floats) -> float:
    """Return x'Qx."""
    return float(np.sum(np.einsum("ij,j->i", form, vector) * vector))


def squared_error(gram: Floats, vector: Floats) -> float:
    """Sum of squared equation errors of ``vector`` over the rows of ``gram``."""
    return max(quadratic(gram, np.append(vector, -1.0)), 0.0)


def squared_error_free_of(
    gram: Floats, vector: Floats, nuisance: slice, last: float = -1.0
) -> float:
    """Sum of squared errors over the rows of ``gram`` after the nuisance columns are refitted to those rows.

    On rows left out, what only they have (the sensor's offset of a log of its own) is
    not the model's to predict. ``last`` is the factor of the last column: -1 of the
    target, 1 of what is constant.
    """
    rest = np.append(vector, last)
    if nuisance.start == nuisance.stop:
        return max(quadratic(gram, rest), 0.0)
    rest[nuisance] = 0.0
    products = np.einsum("ij,j->i", gram[nuisance], rest)
    refitted = least_squares(gram[nuisance, nuisance], products)
    return max(quadratic(gram, rest) - float(np.sum(products * refitted)), 0.0)
