"""Candidates refined and judged by the error of the output, on rows that are held in memory.

The equation error asks S^-1 of the *measured* output: sound to search with, but it
counts an error where the asymmetry is flat many times over, and the model that it
prefers may be worse than a straight line. Here every candidate is brought to the least
error of its *output*, y = S(Gamma(v) + sum c L + w0) + drift, and is judged by that
error on parts of the logs that are left out: cycles, blocks of time, and swings of one
amplitude, level or speed, where the logs have them.

With S piecewise linear and given by where its knots X_k stand,

    dy = S'(w) (dw - sum_k hat_k(y) dX_k),

exactly on each segment: a Gauss-Newton step is the bounded least-squares problem of the
search with other rows. Steps that do not lower the error are halved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    CHOSEN,
    Columns,
    SignedUnknowns,
    States,
    Structure,
    least_squares,
    minimum,
    penalties,
    quadratic,
    squared_error_free_of,
    sum_of_squares,
)
from dbo_cli.hysteresis.identification.recordings import FEWEST_ROWS, Floats, Integers
from dbo_cli.hysteresis.identification.statistics import (
    Basis,
    PreparedLog,
    Score,
    drive_rows,
    groupings,
    hat_functions,
    weighted,
)

TINY = 1e-30  # beside squares of the normalised output: a logarithm of nothing
STEPS = 6  # of Gauss and Newton, at most
HALVINGS = 3  # of a step that does not lower the error
ENOUGH = 1e-3  # of the squared error: a step that gains less is the last one
BLOCKS = 4  # of time of every log, left out in turn


def corners(deviation: Floats, segments: int) -> Floats:
    """Corners of the asymmetry on its input axis from the inner knots' deviation from the diagonal."""
    at = np.arange(segments + 1) / segments
    at[1:-1] += deviation
    return at


def asymmetry(w: Floats, knots: Floats) -> tuple[Floats, Floats]:
    """Output and slope of the piecewise-linear asymmetry at ``w``; the end segments go straight on."""
    segments = len(knots) - 1
    place = np.clip(np.searchsorted(knots, w, side="right") - 1, 0, segments - 1)
    slope = 1.0 / (segments * np.diff(knots))
    return place / segments + slope[place] * (w - knots[place]), slope[place]


@dataclass(frozen=True)
class Part:
    """Rows that are left out together: the cells they are, and the drift columns that are theirs alone."""

    cells: Integers
    rows: Integers
    nuisance: slice


@dataclass(frozen=True)
class Candidate:
    """A basis and a structure with their numbers, and the errors of the output that these leave.

    Attributes
    ----------
    vector : Floats
        All unknowns: heights of the gears, gains of the memories, deviations of the
        asymmetry's inner knots, w0 (the gears' output with all bits cleared), drift.
    squares, penalised : float
        Sum of the squared errors on the rows that were fitted, in the square of the
        normalised output; and with what smoothness adds.
    rows : int
        Number of these rows.
    errors : mapping of str to Score
        Errors on parts left out, of every kind that the logs have; empty before it is
        judged.
    beaten : str
        What predicts parts left out better than all candidates do, in words; empty
        where nothing does.
    """

    basis: Basis
    structure: Structure
    vector: Floats
    squares: float = 0.0
    penalised: float = 0.0
    rows: int = 1
    errors: Mapping[str, Score] = field(default_factory=dict)
    beaten: str = ""

    @property
    def heights(self) -> Floats:
        """Heights of the gears, their sum about 1."""
        return self.vector[: self.basis.gears]

    @property
    def gains(self) -> Floats:
        """Gains of the memories of the time."""
        first = self.basis.gears
        return self.vector[first : first + len(self.basis.time_constants)]

    @property
    def knots(self) -> Floats:
        """Corners of the asymmetry on its input axis, from 0 to 1; shape (segments + 1,)."""
        segments = self.structure.segments
        first = self._after_memories
        return corners(self.vector[first : first + segments - 1], segments)

    @property
    def origin(self) -> float:
        """The gears' output with all bits cleared, w0."""
        return float(self.vector[self._after_memories + self.structure.segments - 1])

    @property
    def _after_memories(self) -> int:
        basis = self.basis
        return basis.gears + len(basis.time_constants) + len(basis.lengths)

    @property
    def score(self) -> float:
        """Logarithm of the RMS error left out, mean over the kinds; of the fit where nothing could be."""
        if not self.errors:
            return self.least_score
        kinds = [np.log(kind.mean_square + TINY) for kind in self.errors.values()]
        return 0.5 * float(np.mean(kinds))

    @property
    def least_score(self) -> float:
        """Logarithm of the RMS error on all rows: what is left out is predicted no better."""
        return 0.5 * float(np.log(self.squares / self.rows + TINY))

    def beaten_by(self, rival: Candidate, least: float) -> bool:
        """Return whether a rival does better by more than the error bar, and by this share of the error."""
        bars = self._error_bars(rival)
        bar = float(np.sqrt(np.sum(np.square(bars)))) / max(len(bars), 1)
        return self.score - rival.score > max(bar, math.log1p(least))

    def surely_beaten_by(self, rival: Candidate) -> bool:
        """Return whether a rival does better by more than two standard errors.

        All kinds leave out parts of the same rows, so their errors are taken as one.
        """
        bars = self._error_bars(rival)
        if not bars:
            return False
        return self.score - rival.score > 2.0 * float(np.mean(bars))

    def _error_bars(self, rival: Candidate) -> list[float]:
        """Return one standard error of the difference of the scores for each kind."""
        return [
            _error_bar(score, rival.errors[kind]) for kind, score in self.errors.items()
        ]


def _error_bar(mine: Score, rival: Score) -> float:
    """Return one standard error of the logarithm of a ratio of RMS errors, from its scatter between parts.

    Of a kind with a single part the scatter is not known: its whole difference may be
    chance.
    """
    count = len(mine.rows)
    if count == 1:
        ratio = (mine.mean_square + TINY) / (rival.mean_square + TINY)
        return 0.5 * abs(math.log(ratio))
    share = mine.squares / (mine.squares.sum() + TINY)
    rival_share = rival.squares / (rival.squares.sum() + TINY)
    scatter = float(np.sum((share - rival_share) ** 2))
    return 0.5 * math.sqrt(scatter * count / (count - 1.0))


@dataclass(frozen=True)
class OutputProblem:
    """The used rows of all logs for one basis: candidates are refined on them, and judged there.

    The rows are sorted by cells: what is left out together lies together. ``drive`` has
    shape (rows, gears + memories), ``drift`` (rows, terms of all logs); ``kinds`` maps
    each way to leave parts out to its parts; ``in_time`` puts the rows into the order in
    which they were recorded; ``weights`` are the roots of the rows' weights, None where
    all count alike.
    """

    basis: Basis
    drive: Floats
    output: Floats
    drift: Floats
    cells: tuple[slice, ...]
    kinds: dict[str, tuple[Part, ...]]
    in_time: Integers
    weights: Floats | None = None
    _bending: dict[tuple[int, float, float], Floats] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.output)

    def weighted(self, values: Floats, rows: Integers | slice = slice(None)) -> Floats:
        """Return values of some rows times the roots of the rows' weights."""
        return weighted(values, None if self.weights is None else self.weights[rows])

    def columns(self, segments: int) -> Columns:
        """Return where the unknowns of a candidate with so many segments stand."""
        memories = self.drive.shape[1] - self.basis.gears
        return Columns(self.basis.gears, memories, segments, self.drift.shape[1])

    def predicted(self, vector: Floats, segments: int) -> Floats:
        """Return what the unknowns predict of the rows, drift and all."""
        shared, drift = self.drive.shape[1], self.drift.shape[1]
        origin = len(vector) - drift
        y: Floats = np.einsum("ij,j->i", self.drive, vector[:shared]) + vector[origin]
        if segments > 1:
            y, _ = asymmetry(y, corners(vector[shared:origin], segments))
        if drift > 1:
            y = y + np.einsum("ij,j->i", self.drift[:, 1:], vector[origin + 1 :])
        return y

    def left_over(self, vector: Floats, segments: int) -> Floats:
        """Return the weighted errors of the output; shape (rows,)."""
        return self.weighted(self.output - self.predicted(vector, segments))

    def squares(self, vector: Floats, segments: int) -> float:
        """Return the sum of the squared errors of the output."""
        return sum_of_squares(self.left_over(vector, segments))

    def noise(self, candidate: Candidate) -> float:
        """Return the mean square of what is white in what a candidate leaves, by its second differences."""
        left = self.left_over(candidate.vector, candidate.structure.segments)
        bends = np.diff(left[self.in_time], 2)
        return float(np.sum(bends * bends)) / (6.0 * max(len(bends), 1))

    def table(self, vector: Floats, segments: int) -> Floats:
        """Return the rows of the problem linearised about a vector; the target is the last column."""
        shared, drift = self.drive.shape[1], self.drift.shape[1]
        origin = len(vector) - drift
        table = np.empty((self.count, len(vector) + 1))
        table[:, origin + 1 : -1] = self.drift[:, 1:]
        if segments == 1:
            table[:, :shared] = self.drive
            table[:, origin] = 1.0
            table[:, -1] = self.output
            return self.weighted(table)
        moved = vector[shared:origin]
        w = np.einsum("ij,j->i", self.drive, vector[:shared]) + vector[origin]
        y, slope = asymmetry(w, corners(moved, segments))
        hats = hat_functions(y, segments) * slope[:, None]
        table[:, :shared] = self.drive * slope[:, None]
        table[:, shared:origin] = -hats
        table[:, origin] = slope
        table[:, -1] = self.output - y + slope * w - np.einsum("ij,j->i", hats, moved)
        return self.weighted(table)

    def products(self, table: Floats, rows: slice = slice(None)) -> Floats:
        """Return the products of the columns over some rows."""
        size = table.shape[1]
        gram = np.zeros((size, size))
        CHOSEN.add_products(table[rows], size, gram)
        return np.triu(gram) + np.triu(gram, 1).T

    def solved(
        self,
        gram: Floats,
        structure: Structure,
        count: int,
        states: States | None = None,
    ) -> tuple[Floats, States]:
        """Return the unknowns of least penalised error of linearised rows, and which of them are zero."""
        unknowns = SignedUnknowns(
            self.columns(structure.segments), structure.slopes, structure.segments
        )
        guess = unknowns.states(structure.memories) if states is None else states.copy()
        signed = minimum(unknowns.products(gram), unknowns, structure, count, guess)
        return unknowns.solution(signed).vector, guess

    def penalty(self, vector: Floats, structure: Structure) -> float:
        """Return what the smoothness of slopes and asymmetry adds to the squares."""
        key = structure.segments, structure.smoothness, structure.knot_smoothness
        if key not in self._bending:
            slopes, kinks = penalties(self.columns(structure.segments))
            self._bending[key] = (
                structure.smoothness * slopes + structure.knot_smoothness * kinks
            )
        return self.count * quadratic(self._bending[key], np.append(vector, -1.0))

    def refined(
        self, structure: Structure, start: Floats, steps: int = STEPS
    ) -> Candidate:
        """Return the candidate at the least error that Gauss-Newton steps from ``start`` reach."""
        segments = structure.segments
        vector = start
        squares = self.squares(vector, segments)
        error = squares + self.penalty(vector, structure)
        for _ in range(steps):
            gram = self.products(self.table(vector, segments))
            try:
                goal, _ = self.solved(gram, structure, self.count)
            except FitError:
                break
            before = error
            for halving in range(HALVINGS + 1):
                trial = vector + 0.5**halving * (goal - vector)
                left = self.squares(trial, segments)
                total = left + self.penalty(trial, structure)
                if total < error:
                    vector, squares, error = trial, left, total
                    break
            if error > before * (1.0 - ENOUGH):
                break
        return Candidate(self.basis, structure, vector, squares, error, self.count)

    def levelled(self, vector: Floats, structure: Structure) -> Candidate:
        """Return other unknowns with w0 and drift fitted to the output."""
        segments = structure.segments
        gram = self.products(self.table(vector, segments))
        first = len(vector) - self.drift.shape[1]
        free = slice(first, len(vector))
        rest = np.append(vector, -1.0)
        rest[free] = 0.0
        products = np.einsum("ij,j->i", gram[free], rest)
        vector = vector.copy()
        vector[free] = -least_squares(gram[free, free], products)
        squares = self.squares(vector, segments)
        penalised = squares + self.penalty(vector, structure)
        return Candidate(self.basis, structure, vector, squares, penalised, self.count)

    def judged(self, candidate: Candidate) -> Candidate:
        """Return the candidate with its errors on parts left out; raises FitError where it cannot be solved.

        The fit without a part is one step from the fit to all rows.
        """
        structure = candidate.structure
        grams = self._products_of_cells(
            self.table(candidate.vector, structure.segments)
        )
        total = np.add.reduce(grams)
        _, states = self.solved(total, structure, self.count)
        left = self.left_over(candidate.vector, structure.segments)
        errors: dict[str, Score] = {}
        for kind, parts in self.kinds.items():
            squares = [
                self._left_out(candidate, part, total, grams, states, left)
                for part in parts
            ]
            errors[kind] = Score.of(squares, [len(part.rows) for part in parts])
        return replace(candidate, errors=errors)

    def _products_of_cells(self, table: Floats) -> list[Floats]:
        """Return the products of the columns over the rows of each cell."""
        return [self.products(table, cell) for cell in self.cells]

    def _left_out(
        self,
        candidate: Candidate,
        part: Part,
        total: Floats,
        grams: Sequence[Floats],
        states: States,
        left_of_all: Floats,
    ) -> float:
        """Return the sum of squared errors on a part of the fit without it.

        ``left_of_all`` is what the candidate, fitted to all rows, leaves of them.
        """
        segments = candidate.structure.segments
        rest = total - np.add.reduce([grams[k] for k in part.cells])
        rows = self.count - len(part.rows)
        try:
            vector, _ = self.solved(rest, candidate.structure, rows, states)
        except FitError:
            vector = candidate.vector
        if segments > 1:
            left = self._shortened(vector, candidate, part, left_of_all)
        else:
            left = self.left_over(vector, segments)
        return self._squares_on(part, left[part.rows])

    def _squares_on(self, part: Part, left: Floats) -> float:
        """Return the sum of squares on a part, what its own drift takes aside."""
        drift = self.drift[part.rows, part.nuisance]
        return _free_of(left, self.weighted(drift, part.rows))

    def line(self) -> Candidate:
        """Return a straight line with the same offset and drift, judged: gears of equal heights."""
        gears = self.basis.gears
        drive = self.drive[:, :gears].sum(axis=1)
        constant = np.ones(self.count)
        columns = (drive, constant, self.drift[:, 1:], self.output)
        table = self.weighted(np.column_stack(columns))
        grams = [
            np.einsum("ij,ik->jk", table[cell], table[cell]) for cell in self.cells
        ]
        total = np.add.reduce(grams)
        errors: dict[str, Score] = {}
        for kind, parts in self.kinds.items():
            squares = []
            for part in parts:
                rest = total - np.add.reduce([grams[k] for k in part.cells])
                left = _left_by_line(table[part.rows], _line_of(rest))
                squares.append(self._squares_on(part, left))
            errors[kind] = Score.of(squares, [len(part.rows) for part in parts])
        line = _line_of(total)
        least = sum_of_squares(_left_by_line(table, line))
        memories = np.zeros(self.drive.shape[1] - gears)
        vector = np.concatenate((np.full(gears, line[0]), memories, line[1:]))
        structure = Structure("free", (), 1, 0.0)
        return Candidate(
            self.basis, structure, vector, least, least, self.count, errors
        )

    def smoothest(self, structure: Structure, tried: Sequence[float]) -> Structure:
        """Return gears without an asymmetry with the smoothness that does best on parts left out."""
        table = self.table(np.zeros(self.columns(1).total), 1)
        grams = self._products_of_cells(table)
        total = np.add.reduce(grams)
        unknowns = SignedUnknowns(self.columns(1), structure.slopes, 1)
        parts: list[Part] = []
        shares: list[float] = []
        for parts_of_kind in self.kinds.values():
            parts += parts_of_kind
            rows = [len(part.rows) for part in parts_of_kind]
            shares += [count / len(parts_of_kind) for count in rows]
        left_out = [np.add.reduce([grams[k] for k in part.cells]) for part in parts]
        rests = [unknowns.products(total - gram) for gram in left_out]
        errors = []
        for smoothness in tried:
            trial = replace(structure, smoothness=smoothness)
            error = 0.0
            for part, gram, products, share in zip(
                parts, left_out, rests, shares, strict=True
            ):
                states = unknowns.states(structure.memories)
                weight = self.count - len(part.rows)
                signed = minimum(products, unknowns, trial, weight, states)
                vector = unknowns.solution(signed).vector
                left = squared_error_free_of(gram, vector, self._own_columns(part))
                error += share * left / len(part.rows)
            errors.append(error)
        return replace(structure, smoothness=tried[int(np.argmin(errors))])

    def _own_columns(self, part: Part) -> slice:
        """Return where the drift that a part has to itself stands among the columns of gears alone."""
        first = self.drive.shape[1]
        return slice(first + part.nuisance.start, first + part.nuisance.stop)

    def _shortened(
        self,
        vector: Floats,
        candidate: Candidate,
        part: Part,
        left_of_all: Floats,
    ) -> Floats:
        """Return what the step without a part leaves, shortened where it leaves more of the rows kept.

        ``left_of_all`` is what the candidate leaves.
        """
        structure = candidate.structure
        fitted_rows = np.ones(self.count, bool)
        fitted_rows[part.rows] = False
        penalty = self.penalty(candidate.vector, structure)
        least = sum_of_squares(left_of_all[fitted_rows]) + penalty
        for halving in range(HALVINGS + 1):
            trial = candidate.vector + 0.5**halving * (vector - candidate.vector)
            left = self.left_over(trial, structure.segments)
            squares = sum_of_squares(left[fitted_rows])
            if squares + self.penalty(trial, structure) < least:
                return left
        return left_of_all


def output_problem(logs: Sequence[PreparedLog], basis: Basis) -> OutputProblem:
    """Return the used rows of the logs with what the gears and memories make of the drive."""
    terms = [log.drift.shape[1] for log in logs]
    begins = np.concatenate(([0], np.cumsum(terms)))
    drives, outputs, drifts, owner = [], [], [], []
    weights: list[Floats] = []
    for place, log in enumerate(logs):
        used = log.used
        for first, last, drive in drive_rows(
            basis, log.voltage, log.seconds, log.start, used, log.lags(basis)
        ):
            drives.append(drive[used[first:last]])
        outputs.append(log.output[used])
        if log.weights is not None:
            weights.append(log.weights[used])
        table = np.zeros((int(used.sum()), int(begins[-1])))
        table[:, begins[place] : begins[place + 1]] = log.drift[used]
        drifts.append(table)
        owner.append(np.full(len(table), place))
    labels = _labels(logs, basis)
    owners = np.concatenate(owner)
    order, cells = _cells(np.column_stack([*labels.values(), owners]))
    owners = owners[order]
    kinds: dict[str, tuple[Part, ...]] = {}
    for name, label in labels.items():
        parts = _parts(label[order], cells, owners, begins, logs)
        if len(parts) > 1 or (parts and name not in ("cycles", "blocks")):
            kinds[name] = parts
    return OutputProblem(
        basis,
        np.vstack(drives)[order],
        np.concatenate(outputs)[order],
        np.vstack(drifts)[order],
        cells,
        kinds,
        np.argsort(order, kind="stable"),
        np.concatenate(weights)[order] if weights else None,
    )


def _cells(labels: Integers) -> tuple[Integers, tuple[slice, ...]]:
    """Return the order in which rows of the same labels lie together, and where those rows are in it."""
    codes = np.unique(labels, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(codes, kind="stable")
    edges = np.concatenate(([0], np.cumsum(np.bincount(codes)))).tolist()
    return order, tuple(slice(a, b) for a, b in itertools.pairwise(edges))


def _parts(
    label: Integers,
    cells: tuple[slice, ...],
    owners: Integers,
    begins: Integers,
    logs: Sequence[PreparedLog],
) -> tuple[Part, ...]:
    """Return the parts that a label names from 1 on, those that can be left out."""
    parts = []
    for k in range(1, int(label.max(initial=0)) + 1):
        part = _part(label, k, cells, owners, begins, logs)
        if part is not None:
            parts.append(part)
    return tuple(parts)


def _labels(logs: Sequence[PreparedLog], basis: Basis) -> dict[str, Integers]:
    """Return for each way to leave parts out the part of each used row, 0 where it is always kept."""
    labels = {"cycles": np.concatenate([log.fold[log.used] + 1 for log in logs])}
    sizes = [int(log.used.sum()) for log in logs]
    labels["blocks"] = np.concatenate(
        [1 + np.arange(size) * BLOCKS // max(size, 1) for size in sizes]
    )
    for name, grouped in groupings(logs, basis):
        labels[name] = np.concatenate([log.fold[log.used] for log in grouped])
    return labels


def _part(
    label: Integers,
    k: int,
    cells: tuple[slice, ...],
    owners: Integers,
    begins: Integers,
    logs: Sequence[PreparedLog],
) -> Part | None:
    """Return one part, or None where it is too small, or most of the logs."""
    of_part = np.array([label[cell.start] == k for cell in cells])
    rows = np.flatnonzero(label == k)
    if len(rows) < min(FEWEST_ROWS, len(label) // 20) or len(rows) > 0.85 * len(label):
        return None
    mine = np.unique(owners[rows])
    nuisance = slice(0, 0)
    if len(mine) == 1:
        place = int(mine[0])
        only = bool((owners == place).sum() == len(rows))
        end = int(begins[place + 1])
        first = int(begins[place]) if only else end - logs[place].stretches
        nuisance = slice(first, end)
    return Part(np.flatnonzero(of_part), rows, nuisance)


def _line_of(gram: Floats) -> Floats:
    """Return the coefficients of a straight line; the target is the last column of the products."""
    return least_squares(gram[:-1, :-1], gram[:-1, -1])


def _left_by_line(table: Floats, line: Floats) -> Floats:
    """Return what a straight line leaves of the last column."""
    left: Floats = table[:, -1] - np.einsum("ij,j->i", table[:, :-1], line)
    return left


def _free_of(left: Floats, columns: Floats) -> float:
    """Return the sum of squares that these columns leave."""
    if not columns.shape[1]:
        return sum_of_squares(left)
    gram = np.einsum("ij,ik->jk", columns, columns)
    products = np.einsum("ij,i->j", columns, left)
    rest = left - np.einsum("ij,j->i", columns, least_squares(gram, products))
    return sum_of_squares(rest)


def finer(vector: Floats, columns: Columns, segments: int, to: int) -> Floats:
    """Return the same unknowns with the asymmetry on ``to`` segments, a multiple."""
    at = columns.gears + columns.memories
    coarse = corners(vector[at : at + segments - 1], segments)
    inner = np.arange(1, to) / to
    moved = np.interp(inner, np.arange(segments + 1) / segments, coarse) - inner
    return np.concatenate((vector[:at], moved, vector[at + segments - 1 :]))
