"""One regularised output-error problem: Gauss-Newton steps, each a bounded least-squares problem.

The output is y = S(u) + drift with u = u0 + sum p_i E_i + sum c_j L_j + sum d_j (x - L_j).
S goes from 0 at 0 with slopes s over equal segments of [0, 1], whose mean is 1, and on
beyond. Bounds: p by the rule for the slopes, c and d >= 0, floors of p and s.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.linalg.lapack import dposv
from scipy.optimize import nnls

from dbo_cli.arrays import Booleans, Floats
from dbo_cli.errors import FitError
from dbo_cli.identification.basis import Structure

LEAST_SLOPE = 1e-3  # of the mean slope of the cells
LEAST_WITH_NEGATIVE = 0.031  # the same beside negative gains: a model must have 0.03
LEAST_CURVE = 0.03  # of the mean slope of the curve
PAST_COST = 1e-3  # of a squared coefficient of the unknown past, at most about 1
BELIEF = 0.1
"""Of the error's mean square: cost of a squared gain whose memory the logs show as much as the drive."""
HOLD = 1e2  # weight of the curve's mean slope: the scale is nobody's
RIDGE = 1e-9
STEPS = 12
ENOUGH = 1e-4  # relative gain of a step that ends the iteration
HALVINGS = 5
NOT_SOLVED = "the least-squares solver did not converge; leave out bad rows"
NNLS_ITERATIONS = 100  # for each unknown, of the bounded solver
TURNS = 5  # in which bounded unknowns change sides: where more are needed, scipy solves from the start
EXACT = 1e-10  # of the largest right side: gradients below are zero
DAMPED = 1e-13
"""Added to a diagonal of ones where rounding cannot tell the unknowns apart; then hundreds of times that."""


@dataclass(frozen=True)
class FittedRows:
    """The rows that are fitted: columns, output and drift.

    Attributes
    ----------
    columns : shape (rows, cells + 2 terms)
    output, weights : shape (rows,); weights have the sum 1
    drift : shape (rows, k), free columns beside the model
    widths : shape (cells,), of each slope cell as a share of all
    past : how many columns of the drift, the last ones, are of an unknown past
    """

    columns: Floats
    output: Floats
    weights: Floats
    drift: Floats
    widths: Floats
    past: int = 0


@dataclass(frozen=True)
class Solution:
    """Unknowns of one structure, in normalised units.

    Attributes
    ----------
    slopes : shape (cells,)
    gains : shape (memories,) >= 0, of lags and then of drives less their lags
    curve : shape (segments,)
    offset : u0
    drift : shape (k,)
    error : shape (rows,), what it leaves
    penalised : what was minimised
    residuals : what each part leaves where it was left out (``cross_validate``)
    score : logarithm of the mean of that, and the price of the terms (``score``)
    weight : in a mean of fits
    """

    structure: Structure
    slopes: Floats
    gains: Floats
    curve: Floats
    offset: float
    drift: Floats
    error: Floats = field(default_factory=lambda: np.zeros(0))
    penalised: float = np.inf
    residuals: tuple[Floats, ...] = ()
    score: float = np.inf
    weight: float = 1.0

    @property
    def rmse(self) -> float:
        """What the fit leaves, RMS."""
        return float(np.sqrt(np.mean(self.error**2)))

    def inner(self, columns: Floats) -> Floats:
        """Return u for a table of columns."""
        weights = np.concatenate((self.slopes, self.gains))
        return times(columns[:, : len(weights)], weights) + self.offset

    def predict(self, columns: Floats) -> Floats:
        """Return the output without drift."""
        return times(travelled(self.inner(columns), len(self.curve)), self.curve)


def times(table: Floats, weights: Floats) -> Floats:
    """Return the weighted sum of columns; its bits do not depend on the number of threads."""
    sums: Floats = np.einsum("ij,j->i", table, weights)
    return sums


def travelled(u: Floats, segments: int) -> Floats:
    """Return the part of each segment of [0, 1] that lies below u; the outer ones go on; (rows, segments)."""
    width = 1.0 / segments
    fraction = np.clip(u[:, None] - width * np.arange(segments), 0.0, width)
    fraction[:, 0] += np.minimum(u, 0.0)
    fraction[:, -1] += np.maximum(u - 1.0, 0.0)
    return fraction


def bending(columns: Floats) -> Floats:
    """Return the products of all pairs of columns' second differences."""
    bends = np.diff(columns, 2, axis=0)
    return bends.T @ bends


def nonnegative(table: Floats, target: Floats) -> Floats:
    """Return the x >= 0 that minimises |table x - target|.

    Raises
    ------
    FitError
        The solver does not end.
    """
    try:
        x, _ = nnls(table, target, maxiter=NNLS_ITERATIONS * table.shape[1])
    except RuntimeError as problem:
        raise FitError(NOT_SOLVED) from problem
    return np.asarray(x)


def minimum(
    matrix: Floats, right: Floats, bounded: Booleans, guess: Booleans
) -> Floats:
    """Minimise x'Hx/2 - g'x with x >= 0 where it is ``bounded``; return x.

    With H = U'U this is |U x - c| for U'c = g. With the free unknowns first, the lower
    rows of U hold bounded ones alone: non-negative least squares. ``guess`` are unknowns
    that are tried first as the only ones that are not 0.

    Raises
    ------
    FitError
        H is not positive definite, or the solver does not end.
    """
    scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled, target = matrix * scale * scale[:, None], right * scale
    x = _guessed(scaled, target, bounded, guess)
    if x is not None:
        return x * scale
    order = np.argsort(bounded, kind="stable")
    free = len(bounded) - int(np.count_nonzero(bounded))
    factor = factor_of(scaled[np.ix_(order, order)])
    target = solve_triangular(factor, target[order], trans=1)
    positive = nonnegative(factor[free:, free:], target[free:])
    remainder = target[:free] - factor[:free, free:] @ positive
    x = np.empty(len(right))
    x[order] = np.append(solve_triangular(factor[:free, :free], remainder), positive)
    if not np.isfinite(x).all():
        raise FitError(NOT_SOLVED)
    return x * scale


def _guessed(
    matrix: Floats, right: Floats, bounded: Booleans, guess: Booleans
) -> Floats | None:
    """Return the minimum, found by turns of which unknowns are not 0, begun at a guess; else None.

    Block principal pivoting (Portugal, Judice and Vicente, 1994): all that are on the wrong side
    of their bound change sides at once. It ends within a few turns, or it may cycle. Without it
    an identification takes 1.3 times as long.
    """
    slack = EXACT * float(np.abs(right).max())
    for _ in range(TURNS):
        x, some = np.zeros(len(right)), np.flatnonzero(guess)
        _, x[some], failed = dposv(matrix[np.ix_(some, some)], right[some])
        if failed or not np.isfinite(x).all():
            return None
        gradient = matrix @ x - right
        wrong = bounded & np.where(guess, x < 0.0, gradient < -slack)
        if not wrong.any():
            return x
        guess = guess ^ wrong
    return None


def factor_of(matrix: Floats) -> Floats:
    """Return Cholesky's upper factor of a matrix of unit diagonal, damped as little as it needs.

    Raises
    ------
    FitError
        It is not positive definite, either, with what rounding explains.
    """
    for damped in (0.0, DAMPED, 1e2 * DAMPED, 1e4 * DAMPED):
        try:
            factor: Floats = cholesky(matrix + damped * np.eye(len(matrix)))
        except (LinAlgError, ValueError):
            continue
        return factor
    raise FitError(NOT_SOLVED)


class Equations:
    """The least-squares problem of one structure: tables, penalties and bounds.

    Unknowns in order: slopes (steps where they grow or fall), gains, curve, u0, drift.
    """

    def __init__(self, rows: FittedRows, structure: Structure) -> None:
        self.rows, self.structure = rows, structure
        self.cells = len(rows.widths)
        terms = (rows.columns.shape[1] - self.cells) // 2
        self.inner = self.cells + terms * len(structure.memories)
        self.segments = structure.segments if np.isfinite(structure.smooth_curve) else 1
        self.curved = self.segments > 1
        self.free = self.inner + self.segments * self.curved
        self.size = self.free + 1 + rows.drift.shape[1]
        self.columns = rows.columns[:, : self.inner]
        self.roots = np.sqrt(rows.weights)
        centre = float(rows.weights @ rows.output)
        self.variance = max(float(rows.weights @ (rows.output - centre) ** 2), 1e-24)
        self.slope_map = self._slope_map()
        self._stepped = self.columns @ self.slope_map
        self.unseen = self._unseen()
        self.gain_costs = np.zeros(self.inner - self.cells)
        self.penalty = self._penalty()
        self.bounded = np.arange(self.size) < self.free
        self.positive = np.ones(self.size, bool)
        self._products: Floats | None = None

    def _slope_map(self) -> Floats:
        """Return the matrix that makes slopes and gains of their unknowns.

        Unknown are steps where slopes grow or fall. A mean slope of 1, gains included,
        raises all slopes by a floor.
        """
        cells = self.cells
        matrix = np.eye(self.inner)
        if self.structure.slopes == "growing":
            matrix[:cells, :cells] = np.tril(np.ones((cells, cells)))
        elif self.structure.slopes == "falling":
            matrix[:cells, :cells] = np.triu(np.ones((cells, cells)))
        mean = np.ones(self.inner)
        mean[:cells] = self.rows.widths @ matrix[:cells, :cells]
        lowest = LEAST_WITH_NEGATIVE if "r" in self.structure.memories else LEAST_SLOPE
        matrix[:cells] += lowest / (1.0 - lowest) * mean
        return matrix

    def _unseen(self) -> Floats:
        """Return var(x)/var(L) of the drive x and each memory L, beside offsets, drift and past."""
        engaged, memories = np.split(self.columns, [self.cells], axis=1)
        shown = np.column_stack((engaged.sum(axis=1), memories)) * self.roots[:, None]
        nuisance = np.column_stack((np.ones(len(shown)), self.rows.drift))
        nuisance *= self.roots[:, None]
        shown -= nuisance @ np.linalg.lstsq(nuisance, shown, rcond=EXACT)[0]
        squares = np.sum(shown**2, axis=0)
        ratios: Floats = squares[0] / np.maximum(squares[1:], RIDGE * squares[0])
        return ratios

    def believe(self, fit: Solution) -> Solution:
        """Set what gains cost beside the error of a fit; return the fit so measured.

        A gain is believed as far as the logs show it: the more a fit leaves and the less
        the logs show of a memory, the smaller is its gain.
        """
        square = float(self.rows.weights @ fit.error**2) / self.variance
        costs = BELIEF * square * self.unseen
        gains = np.arange(self.cells, self.inner)
        self.penalty[gains, gains] += costs - self.gain_costs
        self.gain_costs = costs
        return self._priced(fit)

    def _penalty(self) -> Floats:
        """Return the matrix of what smoothness costs, in units of the output's variance."""
        cells = self.cells
        matrix = np.zeros((self.size, self.size))
        slopes = self.slope_map[:cells, :cells]
        matrix[:cells, :cells] = self.structure.smooth_slopes * bending(slopes)
        if self.curved:
            index = slice(self.inner, self.free)
            bent = bending(np.eye(self.segments))
            matrix[index, index] = self.structure.smooth_curve * bent
            matrix[index, index] += HOLD / self.segments**2
        costs = np.full(self.size, RIDGE)
        costs[self.size - self.rows.past :] += PAST_COST
        matrix[np.diag_indices(self.size)] += costs
        return matrix

    # --- fits ---

    def fit_of(self, x: Floats) -> Solution:
        """Return the unknowns with their names, and what they leave."""
        curve = x[self.inner : self.free] if self.curved else np.ones(1)
        slopes, gains = np.split(times(self.slope_map, x[: self.inner]), [self.cells])
        offset, drift = float(x[self.free]), x[self.free + 1 :]
        fit = Solution(self.structure, slopes, gains, curve, offset, drift)
        return self._measured(fit)

    def _measured(self, fit: Solution) -> Solution:
        """Return the fit with what it leaves."""
        error = self.rows.output - fit.predict(self.columns)
        error -= times(self.rows.drift, fit.drift)
        return self._priced(replace(fit, error=error))

    def _priced(self, fit: Solution) -> Solution:
        """Return the fit with the penalised squares of what it leaves."""
        squares = float(self.rows.weights @ fit.error**2) / self.variance
        cost = self.structure.smooth_slopes * _bent(fit.slopes)
        cost += float(self.gain_costs @ fit.gains**2)
        past = fit.drift[len(fit.drift) - self.rows.past :]
        cost += PAST_COST * float(past @ past)
        if self.curved:
            cost += self.structure.smooth_curve * _bent(fit.curve)
        return replace(fit, penalised=squares + cost)

    def between(self, fit: Solution, full_step: Solution, fraction: float) -> Solution:
        """Return a fit a part of the way to another one."""
        values = {}
        for name in ("slopes", "gains", "curve", "offset", "drift"):
            here, there = getattr(fit, name), getattr(full_step, name)
            values[name] = here + fraction * (there - here)
        return self._measured(replace(fit, **values))

    def start(self, first: Solution | None) -> Solution:
        """Return where Gauss-Newton begins: at a straight line, or at another fit's unknowns."""
        curve = np.ones(self.segments)
        if first is not None:
            if len(first.curve) == self.segments:
                curve = first.curve
            return self._measured(replace(first, structure=self.structure, curve=curve))
        slopes, gains = np.ones(self.cells), np.zeros(self.inner - self.cells)
        drive = self.columns[:, : self.cells].sum(axis=1)
        offset = float(self.rows.weights @ (self.rows.output - drive))
        drift = np.zeros(self.rows.drift.shape[1])
        fit = Solution(self.structure, slopes, gains, curve, offset, drift)
        return self._measured(fit)

    def table(self, fit: Solution) -> Floats:
        """Return the linearised rows at a fit, weighted, the target last: (rows, unknowns + 1)."""
        u = fit.inner(self.columns)
        table = np.empty((len(u), self.size + 1))
        index = np.clip((u * self.segments).astype(np.int64), 0, self.segments - 1)
        steepness = fit.curve[index]
        np.multiply(self._stepped, steepness[:, None], out=table[:, : self.inner])
        if self.curved:
            table[:, self.inner : self.free] = travelled(u, self.segments)
        table[:, self.free] = steepness
        table[:, self.free + 1 : -1] = self.rows.drift
        table[:, -1] = self.rows.output + steepness * u
        if not self.curved:
            table[:, -1] = self.rows.output
        table *= self.roots[:, None]
        return table

    def products(self, fit: Solution) -> Floats:
        """Return the products of all pairs of linearised columns: without a curve those of any fit."""
        if self.curved or self._products is None:
            table = self.table(fit)
            self._products = table.T @ table
        return self._products

    def step(self, gram: Floats) -> Floats:
        """Return the unknowns of least penalised squares of linearised rows."""
        matrix = gram[:-1, :-1] / self.variance + self.penalty
        right = gram[:-1, -1] / self.variance
        if self.curved:
            right[self.inner : self.free] += HOLD / self.segments
        lowest = np.zeros(self.size)
        lowest[self.inner : self.free] = LEAST_CURVE
        x = minimum(matrix, right - matrix @ lowest, self.bounded, self.positive)
        self.positive = (x > 0.0) | ~self.bounded
        return x + lowest

    def solve(self, first: Solution | None = None) -> Solution:
        """Return the fit at the least penalised squares that Gauss-Newton reaches."""
        fit = self.start(first)
        for number in range(STEPS):
            fit = self.believe(fit)
            full_step = self.fit_of(self.step(self.products(fit)))
            before = fit.penalised
            fit = self._shortened(fit, full_step, forced=number == 0 and first is None)
            if number and not fit.penalised < before * (1.0 - ENOUGH):
                break
            if number and not self.curved and not self.structure.memories:
                break
        return fit

    def _shortened(self, fit: Solution, full_step: Solution, forced: bool) -> Solution:
        """Return the first fit on the way back from a goal that is better than where it began."""
        if forced or full_step.penalised < fit.penalised:
            return full_step
        for halving in range(1, HALVINGS):
            trial = self.between(fit, full_step, 0.5**halving)
            if trial.penalised < fit.penalised:
                return trial
        return fit


def _bent(values: Floats) -> float:
    """Return the sum of squared second differences."""
    return float(np.sum(np.diff(values, 2) ** 2))
