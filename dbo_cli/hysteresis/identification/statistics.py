"""What the logs say about the unknowns: the rows of the least-squares problem, and their products by folds.

For fixed gear widths the operator's output is linear in everything that is unknown
(design, section "Lag and creep beside the gears"): with phi_i the engaged fraction of
gear i and L_j the relaxed drive,

    sum_i phi_i dY_i + sum_j c_j L_j - S^-1(y) - drift = 0,

where S^-1 is the inverse of the discrete point operator, written as a piecewise-linear
function of the measured output (Kuhnen's arrangement, reference [6] of the paper). Rows
are made in blocks, so that memory does not grow with the log, and gathered once, by
folds, so that cycles or swings can be left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    CHOSEN,
    Columns,
    SignedUnknowns,
    Solution,
    States,
    Structure,
    minimum,
    solve,
    squared_error,
    squared_error_free_of,
)
from dbo_cli.hysteresis.identification.recordings import (
    EVEN,
    FEWEST_ROWS,
    SMALL_SWING,
    Floats,
    Integers,
    drive_shape,
)
from dbo_cli.hysteresis.model_state import StartName, start_state
from dbo_cli.hysteresis.move_error import travelled
from dbo_cli.hysteresis.operators import (
    DiscreteBacklashOperator,
    DiscretePointOperator,
    Relaxation,
)

BLOCK_ROWS = 256  # a block without a wanted row is passed over, so blocks are short
# that follow each other: fewer and larger products take half the time
JOINED_BLOCKS = 4
# of the parabola; 16 and 64 changed the errors of one of eight invented logs, by 2 %
BEND_SEGMENTS = 32
# with 6 a log of creep alone was followed four times worse, with 2 by 7 % worse
TIME_CONSTANT_RATIO = 3.0
ALL_GEARS = 1024
"""Gears of the finest model, however many slopes they share. Measured: docs/choices.md."""
SLOPE_CHOICES = (64, 128, 256)
"""Different slopes among the gears, simplest first. Measured: docs/choices.md."""
# of memories that fade with the way gone, in units of the range; see ``expectation``
LENGTHS = (0.15, 0.5)


@dataclass(frozen=True)
class Basis:
    """What is fixed before the problem is solved: the gears' edges, the time constants, the delay.

    ``low`` and ``high`` bound the gears on the voltage axis, which ``gears * split``
    equal widths divide; ``split`` neighbours share one slope, so that ``gears`` heights
    are unknown. A turn inside a gear retraces it: splitting makes that error of the
    operator small without a single unknown more. ``time_constants`` in seconds;
    ``delay`` in seconds, of the output behind the drive. ``bend`` is the asymmetry that
    acts on the drive before the gears: at a share s of the range it adds bend s (1 -
    s). ``lengths`` are of memories that fade with the way gone, in units of the range;
    no model has them.
    """

    gears: int
    low: float
    high: float
    split: int = 1
    time_constants: tuple[float, ...] = ()
    delay: float = 0.0
    bend: float = 0.0
    lengths: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        """Width of all gears together, in the unit of the voltage."""
        return self.high - self.low

    def bend_points(self) -> DiscretePointOperator:
        """Return the asymmetry that acts on the drive: a parabola in straight segments, ends held."""
        at = np.arange(BEND_SEGMENTS + 1) / BEND_SEGMENTS
        bent = at + self.bend * at * (1.0 - at)
        return DiscretePointOperator(
            np.diff(at) * self.span, np.diff(bent) * self.span, self.low, self.low
        )

    def drive(self, voltage: Floats) -> Floats:
        """Return what reaches the gears, in the unit of the voltage."""
        return self.bend_points().run(voltage) if self.bend else voltage

    def lags(self, voltage: Floats, seconds: Floats | None) -> Floats:
        """Return what each memory holds of the drive, as shares of the range; see ``relaxed_drive``."""
        lags = relaxed_drive(
            (self.drive(voltage) - self.low) / self.span, seconds, self.time_constants
        )
        if self.lengths:
            way = travelled(voltage, self.span) / self.span
            lags = np.hstack(
                (
                    lags,
                    relaxed_drive((voltage - self.low) / self.span, way, self.lengths),
                )
            )
        return lags

    def operator(self) -> DiscreteBacklashOperator:
        """Return an operator of these gears with equal heights that sum to one."""
        count = self.gears * self.split
        return DiscreteBacklashOperator(
            np.full(count, self.span / count),
            np.full(count, 1.0 / count),
            self.low,
            0.0,
        )


def usual_basis(
    low: float, high: float, time_constants: tuple[float, ...] = ()
) -> Basis:
    """Return the gears that everything but their own number is chosen with."""
    return Basis(
        SLOPE_CHOICES[0], low, high, ALL_GEARS // SLOPE_CHOICES[0], time_constants
    )


def relaxed_drive(
    drive: Floats, seconds: Floats | None, time_constants: tuple[float, ...]
) -> Floats:
    """Exponentially forgetting averages of the drive, one column a time constant.

    L_k = a_k L_k-1 + (1 - a_k) u_k with a_k = exp(-dt_k / tau); L_0 = u_0, at rest
    before the first sample.

    Parameters
    ----------
    drive : shape (samples,), in any unit
    seconds : shape (samples,), time of each sample; may be None where there are no time
        constants
    time_constants : in seconds

    Returns
    -------
    shape (samples, time constants), in the unit of ``drive``
    """
    if not time_constants or seconds is None:
        return np.empty((len(drive), 0))
    steps = np.maximum(np.diff(seconds, prepend=seconds[0]), 0.0)
    terms = Relaxation(0.0, time_constants, (0.0,) * len(time_constants))
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 0.0
    # A clock that is even but for the digits it was written with need not be looked at
    # step by step.
    even = usual > 0.0 and float(np.abs(steps[1:] - usual).max()) <= EVEN * usual
    return terms.lags(drive, usual if even else steps)[0]


def hat_functions(position: Floats, segments: int) -> Floats:
    """Piecewise-linear hats on the inner knots of ``segments`` equal segments of 0..1; outside, straight on.

    Returns shape (samples, segments - 1). The end segments are extended, as the point
    operator's are.
    """
    if segments < 2:
        return np.empty((len(position), 0))
    place = np.clip(np.floor(position * segments).astype(np.int64), 0, segments - 1)
    fraction = position * segments - place
    full = np.zeros((len(position), segments + 1))
    rows = np.arange(len(position))
    full[rows, place] = 1.0 - fraction
    full[rows, place + 1] = fraction
    return full[:, 1:-1]


def drift_columns(seconds: Floats, order: int) -> Floats:
    """Legendre polynomials of time from order 0, the sensor's offset; shape (samples, order + 1)."""
    length = float(seconds[-1] - seconds[0]) or 1.0
    centred = 2.0 * (seconds - seconds[0]) / length - 1.0
    return legendre.legvander(centred, order)


def drive_rows(
    basis: Basis,
    voltage: Floats,
    seconds: Floats | None,
    start: StartName,
    wanted: NDArray[np.bool_] | None = None,
    lags: Floats | None = None,
) -> Iterator[tuple[int, int, Floats]]:
    """Yield gear engagement and relaxed drive of one log, delayed, block by block.

    Parameters
    ----------
    basis : the gears and time constants
    voltage : shape (samples,)
    seconds : shape (samples,), or None where the log has no clock (then neither delay
        nor relaxation)
    start : 'empty', 'full' or 'settled': the state before the first sample
    wanted : shape (samples,), bool: blocks without a wanted row are passed over (their
        states are not)
    lags : what ``basis.lags`` gives for this log, where it is known

    Yields
    ------
    first row, row after the last, and columns of shape (rows, gears + memories)
    """
    drive, samples, split = basis.drive(voltage), len(voltage), basis.split
    memory = basis.lags(voltage, seconds) if lags is None else lags
    blocks = list(_wanted_rows(np.ones(samples, bool) if wanted is None else wanted))
    made = np.zeros(samples, bool)
    for first, last in blocks:
        made[first : last + 1] = True
    before, share = _delayed_rows(seconds, made, basis.delay)
    operator = basis.operator()
    state = start_state(operator, float(drive[0]), start)
    done = 0  # rows that the operator has seen so far
    for first, last in blocks:
        begin = int(before[first])
        if begin > done:
            _, state, _ = operator.run(drive[done:begin], state)
            done = begin
        # The next block begins at row ``keep``, whose state is kept: rows from there on
        # are made again.
        end = min(int(before[last - 1]) + 2, samples)
        keep = min(max(int(before[min(last, samples - 1)]), done), end)
        early, state = operator.engagement(drive[done:keep], state, group_size=split)
        late, _ = operator.engagement(drive[keep:end], state, group_size=split)
        columns = np.empty((end - begin, early.shape[1] + memory.shape[1]))
        columns[: keep - begin, : early.shape[1]] = early
        columns[keep - begin :, : early.shape[1]] = late
        columns[:, early.shape[1] :] = memory[begin:end]
        done = keep
        if basis.delay > 0.0:
            columns = _between(
                columns, before[first:last] - begin, share[first:last, None]
            )
        yield first, last, columns[: last - first]


def _between(columns: Floats, rows: Integers, part: Floats) -> Floats:
    """Return columns a share ``part`` behind some rows, on the straight line to the next one."""
    made: Floats = columns[rows]
    if part.any():
        made *= 1.0 - part
        late = columns[np.minimum(rows + 1, len(columns) - 1)]
        late *= part
        made += late
    return made


def _wanted_rows(wanted: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield (first row, row after the last) of blocks with a wanted row, a few neighbours at a time."""
    edges = np.arange(0, len(wanted), BLOCK_ROWS)
    begin: int | None = None
    for block, has_wanted in enumerate(
        [*np.logical_or.reduceat(wanted, edges).tolist(), False]
    ):
        if begin is not None and (not has_wanted or block - begin == JOINED_BLOCKS):
            yield begin * BLOCK_ROWS, min(block * BLOCK_ROWS, len(wanted))
            begin = None
        if has_wanted and begin is None:
            begin = block


def _delayed_rows(
    seconds: Floats | None, made: NDArray[np.bool_], delay: float
) -> tuple[Integers, Floats]:
    """For each row made, the row at or before the moment ``delay`` ago, and the share of the row after it."""
    samples = len(made)
    if delay <= 0.0 or seconds is None:
        return np.arange(samples), np.zeros(samples)
    if (np.diff(seconds) < 0.0).any():
        # a search among times that fall depends on what was searched before
        made = np.ones(samples, bool)
    rows, both = np.flatnonzero(made), (np.zeros(samples, np.int64), np.zeros(samples))
    ago = np.maximum(seconds[rows] - delay, seconds[0])
    before = np.clip(np.searchsorted(seconds, ago, side="right") - 1, 0, samples - 2)
    gap = seconds[before + 1] - seconds[before]
    share = np.divide(
        ago - seconds[before], gap, out=np.zeros(len(rows)), where=gap > 0.0
    )
    both[0][rows] = np.maximum.accumulate(before)
    both[1][rows] = np.clip(share, 0.0, 1.0)
    return both


GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0  # its multiples fill an interval most evenly
# for choosing orders: more rows move the error left out by less than 1 %
SELECTION_ROWS = 20_000
# for the model itself: five hundred for each unknown, which scatter by 4 % of the noise
FIT_ROWS = 50_000
# between turns, on average, are kept: the fastest swings of a drive then have 50
SWING_ROWS = 500


def row_weights(
    uncertainties: Sequence[Floats | None], used: Sequence[NDArray[np.bool_]]
) -> list[Floats | None]:
    """Return the roots of the weights of logs' rows, 1 over each standard deviation, in one scale.

    Their mean square over the used rows is 1, so that a weighted error is one of the
    displacement. Where all used rows are equally uncertain there are no weights: they
    count alike.
    """
    alike: list[Floats | None] = [None] * len(uncertainties)
    present = [deviations for deviations in uncertainties if deviations is not None]
    if len(present) < len(alike):
        return alike
    together = np.concatenate(
        [deviations[rows] for deviations, rows in zip(present, used, strict=True)]
    )
    if float(np.ptp(together)) == 0.0:
        return alike
    scale = float(np.mean(together**-2.0)) ** -0.5
    return [scale / deviations for deviations in present]


def equal_rows(roots: Floats) -> float:
    """Return how many rows of equal weight tell as much as rows of these: (sum w)^2 / sum w^2."""
    weights = roots**2
    return float(np.sum(weights)) ** 2 / float(np.sum(weights**2))


def weighted(values: Floats, weights: Floats | None) -> Floats:
    """Return rows of values times the roots of their weights; the values where all count alike."""
    if weights is None:
        return values
    product: Floats = values * (weights if values.ndim == 1 else weights[:, None])
    return product


@dataclass(frozen=True)
class PreparedLog:
    """One log made ready for the fit.

    ``voltage`` in its unit; ``output`` the displacement with its sign and scale taken
    out (0..1 over all logs); ``seconds`` from the first sample or None; ``fold`` the
    fold of each row, -1 where the row is left out; ``drift`` the columns of offset and
    drift, shape (samples, terms); ``start`` the state before the first sample; ``rows``
    the numbers of the samples in the file, None from 1 on. The last ``stretches`` of
    the drift's columns are offsets of stretches of a history left open, not drift.
    ``weights`` are the roots of the rows' weights, None where all rows count alike. All
    arrays have shape (samples, ...). The last three numbers are of rows left out: before
    their history was known, faulty or far from a fit, and of a clipped sensor.
    """

    name: str
    voltage: Floats
    output: Floats
    seconds: Floats | None
    fold: Integers
    drift: Floats
    start: StartName
    stretches: int = 0
    weights: Floats | None = None
    rows: Integers | None = None
    transient_rows: int = 0
    outlier_rows: int = 0
    clipped_rows: int = 0
    _lags: dict[object, Floats] = field(default_factory=dict, repr=False, compare=False)

    def row(self, index: int) -> int:
        """Return the number in the file, from 1, of a sample, from 0."""
        return index + 1 if self.rows is None else int(self.rows[index])

    @property
    def used(self) -> NDArray[np.bool_]:
        """Rows that take part in the fit; shape (samples,)."""
        return self.fold >= 0

    def weights_at(self, rows: slice | NDArray[np.bool_] | Integers) -> Floats | None:
        """Return the roots of the weights of some rows, None where all count alike."""
        return None if self.weights is None else self.weights[rows]

    def lags(self, basis: Basis) -> Floats:
        """Return the drive as the memories of a basis see it (``basis.lags``).

        The last ones are kept: few of the many bases that are tried differ in what
        these depend on. A log that is made of this one shares them, unless its voltage
        is another.
        """
        key = basis.time_constants, basis.lengths, basis.bend, basis.low, basis.high
        if key not in self._lags:
            self._lags.clear()
            self._lags[key] = basis.lags(self.voltage, self.seconds)
        return self._lags[key]


@dataclass(frozen=True, kw_only=True)
class FoldProducts:
    """Products of the columns and (last) the target, one symmetric matrix a fold, with the rows that went in.

    ``nuisance`` are the columns that a fold, when it is left out, still has to itself:
    the offsets of stretches of an open history, or offset and drift altogether where no
    other fold is of the same log.
    """

    grams: tuple[Floats, ...]
    rows: tuple[int, ...]
    nuisance: tuple[slice, ...]

    def total(self, leave_out: int | None = None) -> tuple[Floats, int]:
        """Sum over the folds, all or all but one: the products and the number of rows."""
        keep = [k for k in range(len(self.grams)) if k != leave_out]
        gram = np.sum([self.grams[k] for k in keep], axis=0)
        return gram, sum(self.rows[k] for k in keep)


@dataclass(frozen=True, kw_only=True)
class Statistics(FoldProducts):
    """The products of one structure of gears; ``columns`` tells what each column is."""

    columns: Columns

    @cached_property
    def _whole(self) -> tuple[Floats, int]:
        return self.total()

    @cached_property
    def _whole_signed(self) -> dict[tuple[str, int], tuple[SignedUnknowns, Floats]]:
        return {}

    @cached_property
    def _without(self) -> dict[tuple[str, int], dict[int, Floats]]:
        return {}

    @cached_property
    def _signed(self) -> dict[tuple[str, int], tuple[SignedUnknowns, list[Floats]]]:
        return {}

    def _signed_whole(self, structure: Structure) -> tuple[SignedUnknowns, Floats]:
        """Return the unknowns that have a sign, and the products of all rows in them."""
        key = structure.slopes, structure.segments
        if key not in self._whole_signed:
            unknowns = SignedUnknowns(self.columns, *key)
            self._whole_signed[key] = unknowns, unknowns.products(self._whole[0])
        return self._whole_signed[key]

    def _signed_folds(
        self, structure: Structure
    ) -> tuple[SignedUnknowns, list[Floats]]:
        """Return the unknowns that have a sign, and the products of each fold in them."""
        key = structure.slopes, structure.segments
        if key not in self._signed:
            unknowns = SignedUnknowns(self.columns, *key)
            self._signed[key] = (
                unknowns,
                [unknowns.products(gram) for gram in self.grams],
            )
        return self._signed[key]

    def minimum(self, structure: Structure) -> tuple[Floats, States]:
        """Return the signed unknowns fitted to all rows, and which of them are zero."""
        unknowns, products = self._signed_whole(structure)
        guess = unknowns.states(structure.memories)
        return minimum(products, unknowns, structure, self._whole[1], guess), guess

    def _minimum_without(
        self, structure: Structure, states: States, fold: int
    ) -> Floats:
        """Return the signed unknowns fitted to all folds but one; ``states`` are a guess."""
        unknowns, folds = self._signed_folds(structure)
        others = [k for k in range(len(folds)) if k != fold]
        key = structure.slopes, structure.segments
        if key not in self._without:
            # candidates alike in these follow each other; keeping all took 13 MB more
            self._without.clear()
            self._without[key] = {}
        sums = self._without[key]
        if fold not in sums:
            sums[fold] = np.add.reduce([folds[k] for k in others], axis=0)
        rows = sum(self.rows[k] for k in others)
        return minimum(sums[fold], unknowns, structure, rows, states.copy())

    def solved(self, structure: Structure) -> tuple[Solution, float]:
        """Return the unknowns fitted to all rows, and the mean square of the equation error left."""
        gram, rows = self._whole
        found, _ = self.minimum(structure)
        solution = self._signed_whole(structure)[0].solution(found)
        return solution, squared_error(gram, solution.vector) / rows

    def left_out(self, structure: Structure, fold: int, states: States) -> float:
        """Return the sum of squared errors on a fold of a fit to the others; ``states`` are a guess."""
        unknowns, folds = self._signed_folds(structure)
        signed = self._minimum_without(structure, states, fold)
        moved = unknowns.total - self.columns.total
        nuisance = slice(
            self.nuisance[fold].start + moved, self.nuisance[fold].stop + moved
        )
        return squared_error_free_of(folds[fold], signed, nuisance, 1.0)


def fewer_rows(
    logs: Sequence[PreparedLog], limit: int = SELECTION_ROWS
) -> list[PreparedLog]:
    """Keep about ``limit`` rows: slow logs are thinned, of others short stretches are kept, spread evenly.

    Which stretches follows from multiples of the golden ratio, which fill the log
    without gaps or rhythm.
    """
    total = sum(int(log.used.sum()) for log in logs)
    if total <= limit:
        return list(logs)
    swing = min(
        len(log.fold) / (len(drive_shape(log.voltage).turns) + 1) for log in logs
    )
    every = int(min(total / limit, swing / SWING_ROWS))
    if every > 1:
        logs = [_thinned(log, every) for log in logs]
        total = sum(int(log.used.sum()) for log in logs)
    length = min(BLOCK_ROWS, max(1, limit // 40))
    folds = []
    for log in logs:
        stretch = np.arange(len(log.fold)) // length
        chosen = (stretch * GOLDEN_RATIO) % 1.0 < limit / total
        folds.append(np.where(chosen, log.fold, -1))
    return with_folds(logs, folds)


def with_folds(
    logs: Sequence[PreparedLog], folds: Sequence[Integers]
) -> list[PreparedLog]:
    """Return the logs with these folds, numbered anew: one of a short cycle may have lost all its rows."""
    left = np.unique(np.concatenate([fold[fold >= 0] for fold in folds]))
    return [
        replace(log, fold=np.where(fold >= 0, np.searchsorted(left, fold), -1))
        for log, fold in zip(logs, folds, strict=True)
    ]


def _thinned(log: PreparedLog, every: int) -> PreparedLog:
    """Return one in so many rows, those in which the voltage turns among them: all that the gears see."""
    length = 3 * every
    blocks = log.voltage[: len(log.voltage) // length * length].reshape(-1, length)
    begins = length * np.arange(len(blocks))
    chosen = np.zeros(len(log.voltage), bool)
    chosen[
        np.r_[begins, begins + blocks.argmin(axis=1), begins + blocks.argmax(axis=1)]
    ] = True
    chosen[length * len(blocks) :] = True
    rows = np.flatnonzero(chosen)
    seconds = None if log.seconds is None else log.seconds[rows]
    return replace(
        log,
        voltage=log.voltage[rows],
        output=log.output[rows],
        seconds=seconds,
        fold=log.fold[rows],
        drift=log.drift[rows],
        weights=log.weights_at(rows),
        _lags={},
    )


def gather(logs: Sequence[PreparedLog], basis: Basis, segments: int) -> Statistics:
    """Run over all logs in blocks and gather the products of their rows, fold by fold.

    They are rows of the equation error: the asymmetry is a function of the *measured*
    output.
    """
    drift = sum(log.drift.shape[1] for log in logs)
    columns = Columns(
        basis.gears, len(basis.time_constants) + len(basis.lengths), segments, drift
    )
    shared = columns.total - drift
    folds = 1 + max(int(log.fold.max(initial=-1)) for log in logs)
    size = columns.total + 1
    grams = [np.zeros((size, size)) for _ in range(folds)]
    rows = [0] * folds
    nuisance = [slice(shared, shared)] * folds
    begin = shared
    for log in logs:
        end = begin + log.drift.shape[1]
        of_log = _products_of_log(log, basis, segments, rows)
        picked = np.ix_(*2 * [np.r_[0:shared, begin:end, size - 1]])
        for k, gram in of_log.items():
            grams[k][picked] += np.triu(gram) + np.triu(gram, 1).T
            first = begin
            if len(of_log) > 1:  # offset and drift are common to the log's folds
                first = end - log.stretches
            nuisance[k] = slice(first, end)
        begin = end
    return Statistics(
        columns=columns, grams=tuple(grams), rows=tuple(rows), nuisance=tuple(nuisance)
    )


def _products_of_log(
    log: PreparedLog, basis: Basis, segments: int, rows: list[int]
) -> dict[int, Floats]:
    """Return the upper triangles of one log's products by folds, and count the folds' rows in ``rows``.

    The columns are those of gears and memories, of the asymmetry, of the log's own
    drift, and (last) the target.
    """
    folds = np.flatnonzero(np.bincount(log.fold[log.used]))
    memories = len(basis.time_constants) + len(basis.lengths)
    own = Columns(basis.gears, memories, segments, log.drift.shape[1])
    size = own.total + 1
    products = {int(k): np.zeros((size, size)) for k in folds}
    for first, last, drive in drive_rows(
        basis, log.voltage, log.seconds, log.start, log.used, log.lags(basis)
    ):
        output = log.output[first:last]
        hats = hat_functions(output, segments)
        table = np.hstack((drive, -hats, log.drift[first:last], output[:, None]))
        table = weighted(table, log.weights_at(slice(first, last)))
        for k, part in _runs(log.fold[first:last]):
            CHOSEN.add_products(table[part], size, products[k])
            rows[k] += part.stop - part.start
    return products


def _runs(fold: Integers) -> Iterator[tuple[int, slice]]:
    """Yield the folds of a block's rows, -1 aside, and where each run of rows of one fold lies."""
    edges = [0, *(np.flatnonzero(np.diff(fold)) + 1).tolist(), len(fold)]
    for begin, end in itertools.pairwise(edges):
        if fold[begin] >= 0:
            yield int(fold[begin]), slice(begin, end)


INDIFFERENCE = 0.02
"""A gain in RMSE below this share is not worth a larger model where the logs cannot tell. Measured:
docs/choices.md.
"""

EARNED = 0.9
"""What clearly makes a model larger must lower the error on data left out to this share: free slopes, an
asymmetry on the drive, memories of the way, one more resonance. Measured:
docs/choices.md.
"""


@dataclass(frozen=True)
class Score:
    """Errors of one candidate on parts left out in turn, the folds of cycles or others.

    ``squares`` are the sums of squared errors, shape (parts,), in the square of the
    normalised output; ``rows`` the numbers of their rows.
    """

    squares: Floats
    rows: Floats

    @staticmethod
    def of(squares: Sequence[float] | Floats, rows: Sequence[int]) -> Score:
        """Return the score of sums of squares by parts, and the parts' rows."""
        return Score(np.asarray(squares, dtype=float), np.asarray(rows, dtype=float))

    @property
    def mean_squares(self) -> Floats:
        """Mean square of each part; shape (parts,)."""
        means: Floats = self.squares / np.maximum(self.rows, 1.0)
        return means

    @property
    def mean_square(self) -> float:
        """Mean square over all rows left out in turn."""
        return float((self.rows / self.rows.sum()) @ self.mean_squares)

    @property
    def rmse(self) -> float:
        """Root of the mean square over all rows left out in turn."""
        return float(np.sqrt(self.mean_square))

    def excess_over(self, other: Score) -> Floats:
        """Logarithm of the ratio of the root mean squares, fold by fold; shape (folds,).

        Ratios let a small loop count as much as a large one, and a short log as much as
        a long one's part.
        """
        tiny = np.finfo(float).tiny
        with np.errstate(invalid="ignore"):  # of two candidates that cannot be solved
            ratios: Floats = 0.5 * np.log(
                (self.mean_squares + tiny) / (other.mean_squares + tiny)
            )
        return ratios


def cross_validate(statistics: Statistics, structure: Structure) -> Score:
    """Leave out each fold in turn, fit the others, and measure the error on the fold left out."""
    _, states = statistics.minimum(structure)
    squares = [
        statistics.left_out(structure, fold, states)
        for fold in range(len(statistics.rows))
    ]
    return Score.of(squares, statistics.rows)


def fitted_squares(statistics: Statistics, structure: Structure) -> Floats:
    """Sum of squared errors on each fold of a fit to all of them; shape (folds,)."""
    solution, _ = statistics.solved(structure)
    return np.array([squared_error(gram, solution.vector) for gram in statistics.grams])


def fitted_rmse(statistics: Statistics, structure: Structure) -> float:
    """RMS error over all rows of a fit to all of them."""
    return float(np.sqrt(statistics.solved(structure)[1]))


def no_worse(candidate: Score, best: Score, indifference: float = INDIFFERENCE) -> bool:
    """Whether ``candidate`` is within one standard error, or within the indifference, of ``best``.

    The standard error is that of the paired ratios between folds, which have most of
    their scatter in common. With few or uneven folds it says little, so it excuses a
    loss only up to INDIFFERENCE.
    """
    excess = candidate.excess_over(best)
    mean = float(excess.mean())
    if np.isinf(mean):  # one of them cannot be solved
        return mean < 0.0
    error = float(excess.std()) / np.sqrt(max(len(excess) - 1, 1))
    return bool(mean <= max(min(error, INDIFFERENCE), float(np.log1p(indifference))))


def simplest_of(scores: Sequence[Score], indifference: float = INDIFFERENCE) -> int:
    """Index of the first (simplest first) candidate that is no worse than the best of all."""
    least = min(scores, key=lambda score: score.rmse)
    best = min(scores, key=lambda score: float(score.excess_over(least).mean()))
    near = (no_worse(score, best, indifference) for score in scores)
    # the simplest where none can be solved
    return next((k for k, close in enumerate(near) if close), 0)


MAX_RATIO = 2.0
"""Times the error of cycles left out: a group without which the fit falls apart counts no more than this.
Measured: docs/choices.md.
"""

# of the drive's range: without the swings above, the last gears would never be seen
LARGE = 0.75


def groups_left_out(
    logs: Sequence[PreparedLog], basis: Basis, structure: Structure, cycles: float
) -> tuple[float, tuple[str, ...]]:
    """RMS error of groups of swings left out, the worst of three ways to group, and the ways there were."""
    worst, names = cycles**2, []
    for name, grouped in groupings(logs, basis):
        statistics = gather(grouped, basis, structure.segments)
        errors: list[tuple[float, int]] = []
        for group in range(1, len(statistics.grams)):
            rest, rows = statistics.total(leave_out=group)
            mine = statistics.rows[group]
            if mine < FEWEST_ROWS or rows < max(FEWEST_ROWS, mine / 5):
                continue
            try:
                vector = solve(rest, statistics.columns, structure, rows).vector
            except FitError:
                continue
            gram, nuisance = statistics.grams[group], statistics.nuisance[group]
            left = squared_error_free_of(gram, vector, nuisance) / mine
            errors.append((min(left, (MAX_RATIO * cycles) ** 2), mine))
        if errors:
            names.append(name)
            squares = sum(error * mine for error, mine in errors)
            worst = max(worst, squares / sum(mine for _, mine in errors))
    return float(np.sqrt(worst)), tuple(names)


def groupings(
    logs: Sequence[PreparedLog], basis: Basis
) -> Iterator[tuple[str, list[PreparedLog]]]:
    """Yield each way to group swings: its name, and the logs with the groups as folds, 0 for none."""
    swings = [swings_of(log, basis) for log in logs]
    speeds = np.concatenate([np.repeat(of_log.speed, of_log.rows) for of_log in swings])
    slow, fast = np.quantile(speeds, [1 / 3, 2 / 3])
    for name in ("amplitudes", "levels", "speeds"):
        grouped = []
        any_group = False
        for log, of_log in zip(logs, swings, strict=True):
            if name == "amplitudes":
                groups = np.where(of_log.amplitude < SMALL_SWING, 1, 2)
            elif name == "levels":
                # thirds of the range
                groups = 1 + np.clip(3.0 * of_log.level, 0.0, 2.0).astype(np.int64)
            else:
                groups = np.where(of_log.speed > fast, 2, 0)
                groups[of_log.speed < slow] = 1
            groups[of_log.amplitude >= LARGE] = 0
            label = np.repeat(groups, of_log.rows)
            any_group = any_group or bool(label.any())
            grouped.append(replace(log, fold=np.where(log.used, label, -1)))
        if any_group:
            yield name, grouped


@dataclass(frozen=True)
class Swings:
    """Swings between turns: amplitude and level in units of the range, speed as a logarithm, rows of each."""

    amplitude: Floats
    level: Floats
    speed: Floats
    rows: Integers


def swings_of(log: PreparedLog, basis: Basis) -> Swings:
    """Return the swings of one log; the rows before the first turn are one, those after the last another."""
    edges = np.concatenate(([0], drive_shape(log.voltage).turns, [len(log.voltage)]))
    ends = log.voltage[np.minimum(edges, len(log.voltage) - 1)]
    amplitude = np.abs(np.diff(ends)) / basis.span
    rows = np.diff(edges)
    if log.seconds is None:
        durations = rows.astype(float)
    else:
        durations = np.diff(log.seconds[np.minimum(edges, len(log.seconds) - 1)])
    speed = np.log(np.maximum(amplitude, 1e-3) / np.maximum(durations, 1e-9))
    return Swings(
        amplitude, (0.5 * (ends[1:] + ends[:-1]) - basis.low) / basis.span, speed, rows
    )
