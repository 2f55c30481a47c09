"""What the logs say about the unknowns, gathered once by folds, so that cycles or swings can be left out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis import fit_kernel
from dbo_cli.hysteresis.fit_kernel import States
from dbo_cli.hysteresis.identification.normal_equations import (
    Columns,
    SignedUnknowns,
    Structure,
    minimum,
    solve,
    squared_error_free_of,
)
from dbo_cli.hysteresis.identification.recordings import Floats, Integers, drive_shape
from dbo_cli.hysteresis.identification.regressors import BLOCK_ROWS, Basis, DriveRows, hat_functions
from dbo_cli.hysteresis.model_state import StartName
from dbo_cli.records import dataclass

GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0  # its multiples fill an interval most evenly
SELECTION_ROWS = 20_000  # for choosing orders: more rows move the error left out by less than 1 %
FIT_ROWS = 50_000  # for the model itself: five hundred for each unknown, which scatter by 4 % of the noise
SWING_ROWS = 500  # between turns, on average, are kept: the fastest swings of a drive then have 50

Linearise = Callable[[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class PreparedLog:
    """One log made ready for the fit.

    ``voltage`` in its unit; ``output`` the displacement with its sign and scale taken out (0..1 over all
    logs); ``seconds`` from the first sample or None; ``fold`` the fold of each row, -1 where the row is left
    out; ``drift`` the columns of offset and drift, shape (samples, terms); ``start`` the state before the
    first sample. The last ``stretches`` of the drift's columns are offsets of stretches of a history left
    open, not drift. All arrays have shape (samples, ...).
    """

    name: str
    voltage: Floats
    output: Floats
    seconds: Floats | None
    fold: Integers
    drift: Floats
    start: StartName
    stretches: int = 0
    _lags: dict[object, Floats] = field(default_factory=dict, repr=False, compare=False)

    @property
    def used(self) -> NDArray[np.bool_]:
        """Rows that take part in the fit; shape (samples,)."""
        return self.fold >= 0

    def lags(self, basis: Basis) -> Floats:
        """Return the drive as the memories of a basis see it (``basis.lags``).

        The last ones are kept: few of the many bases that are tried differ in what these depend on. A log
        that is made of this one shares them, unless its voltage is another.
        """
        key = basis.time_constants, basis.lengths, basis.bend, basis.low, basis.high
        if key not in self._lags:
            self._lags.clear()
            self._lags[key] = basis.lags(self.voltage, self.seconds)
        return self._lags[key]


@dataclass(frozen=True, kw_only=True)
class FoldProducts:
    """Products of the columns and (last) the target, one symmetric matrix a fold, with the rows that went in.

    ``nuisance`` are the columns that a fold, when it is left out, still has to itself: the offsets of
    stretches of an open history, or offset and drift altogether where no other fold is of the same log.
    """

    grams: tuple[Floats, ...]
    rows: tuple[int, ...]
    nuisance: tuple[slice, ...]

    def total(self, leave_out: int | None = None) -> tuple[Floats, int]:
        """Sum over the folds, all or all but one: the products and the number of rows."""
        keep = [k for k in range(len(self.grams)) if k != leave_out]
        return np.sum([self.grams[k] for k in keep], axis=0), sum(self.rows[k] for k in keep)


@dataclass(frozen=True, kw_only=True)
class Statistics(FoldProducts):
    """The products of one structure of gears; ``columns`` tells what each column is."""

    columns: Columns

    @cached_property
    def _summed(self) -> dict[tuple[str, int], dict[int | None, Floats]]:
        return {}

    @cached_property
    def _signed(self) -> dict[tuple[str, int], tuple[SignedUnknowns, list[Floats]]]:
        return {}

    def signed(self, structure: Structure) -> tuple[SignedUnknowns, list[Floats]]:
        """Return the unknowns that have a sign, and the products of each fold in them."""
        key = structure.slopes, structure.segments
        if key not in self._signed:
            unknowns = SignedUnknowns(self.columns, *key)
            self._signed[key] = unknowns, [unknowns.products(gram) for gram in self.grams]
        return self._signed[key]

    def minimum(
        self, structure: Structure, states: States | None = None, leave_out: int | None = None
    ) -> tuple[Floats, States]:
        """Return the signed unknowns fitted to all folds or all but one, and which of them are zero."""
        unknowns, folds = self.signed(structure)
        guess = unknowns.states(structure.memories) if states is None else states.copy()
        kept = [k for k in range(len(folds)) if k != leave_out]
        key = structure.slopes, structure.segments
        if key not in self._summed:
            self._summed.clear()  # candidates alike in these follow each other; keeping all took 13 MB more
            self._summed[key] = {}
        sums = self._summed[key]
        if leave_out not in sums:
            sums[leave_out] = np.add.reduce([folds[k] for k in kept], axis=0)
        rows = sum(self.rows[k] for k in kept)
        return minimum(sums[leave_out], unknowns, structure, rows, guess), guess

    def left_out(self, structure: Structure, fold: int, states: States | None = None) -> float:
        """Return the sum of squared errors on a fold of a fit to the others."""
        unknowns, folds = self.signed(structure)
        found, _ = self.minimum(structure, states, fold)
        moved = unknowns.total - self.columns.total
        own = slice(self.nuisance[fold].start + moved, self.nuisance[fold].stop + moved)
        return squared_error_free_of(folds[fold], found, own, 1.0)


def fewer_rows(logs: Sequence[PreparedLog], limit: int = SELECTION_ROWS) -> list[PreparedLog]:
    """Keep about ``limit`` rows: slow logs are thinned, of others short stretches are kept, spread evenly.

    Which stretches follows from multiples of the golden ratio, which fill the log without gaps or rhythm.
    """
    total = sum(int(log.used.sum()) for log in logs)
    if total <= limit:
        return list(logs)
    swing = min(len(log.fold) / (len(drive_shape(log.voltage).turns) + 1) for log in logs)
    every = int(min(total / limit, swing / SWING_ROWS))
    if every > 1:
        logs = [_thinned(log, every) for log in logs]
        total = sum(int(log.used.sum()) for log in logs)
    length = min(BLOCK_ROWS, max(1, limit // 40))
    kept = []
    for log in logs:
        stretch = np.arange(len(log.fold)) // length
        chosen = (stretch * GOLDEN_RATIO) % 1.0 < limit / total
        kept.append(np.where(chosen, log.fold, -1))
    return with_folds(logs, kept)


def with_folds(logs: Sequence[PreparedLog], folds: Sequence[Integers]) -> list[PreparedLog]:
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
    kept = np.zeros(len(log.voltage), bool)
    kept[np.r_[begins, begins + blocks.argmin(axis=1), begins + blocks.argmax(axis=1)]] = True
    kept[length * len(blocks) :] = True
    rows = np.flatnonzero(kept)
    seconds = None if log.seconds is None else log.seconds[rows]
    return replace(
        log,
        voltage=log.voltage[rows],
        output=log.output[rows],
        seconds=seconds,
        fold=log.fold[rows],
        drift=log.drift[rows],
        _lags={},
    )


def equation_rows(segments: int) -> Linearise:
    """Rows of the equation error: the asymmetry is a function of the *measured* output."""

    def rows(drive: Floats, output: Floats) -> tuple[Floats, Floats]:
        return np.hstack((drive, -hat_functions(output, segments))), output

    return rows


def gather(
    logs: Sequence[PreparedLog], basis: Basis, segments: int, linearise: Linearise | None = None
) -> Statistics:
    """Run over all logs in blocks and gather the products of their rows, fold by fold."""
    rows_of = linearise or equation_rows(segments)
    drift = sum(log.drift.shape[1] for log in logs)
    columns = Columns(basis.gears, len(basis.time_constants) + len(basis.lengths), segments, drift)
    shared = columns.total - drift
    folds = 1 + max(int(log.fold.max(initial=-1)) for log in logs)
    size = columns.total + 1
    grams = [np.zeros((size, size)) for _ in range(folds)]
    rows = [0] * folds
    nuisance = [slice(shared, shared)] * folds
    begin = shared
    for log in logs:
        end = begin + log.drift.shape[1]
        own = end - begin + shared + 1
        mine = {int(k): np.zeros((own, own)) for k in np.flatnonzero(np.bincount(log.fold[log.used]))}
        rows_made = DriveRows(basis, log.voltage, log.seconds, log.start, log.used, log.lags(basis))
        for first, last, drive in rows_made.blocks():
            known, target = rows_of(drive, log.output[first:last])
            table = np.hstack((known, log.drift[first:last], target[:, None]))
            for k, part in _runs(log.fold[first:last]):
                fit_kernel.CHOSEN.add_products(table[part], own, mine[k])
                rows[k] += part.stop - part.start
        picked = np.ix_(*2 * [np.r_[0:shared, begin:end, size - 1]])
        for k, gram in mine.items():
            grams[k][picked] += np.triu(gram) + np.triu(gram, 1).T
            nuisance[k] = slice(begin if len(mine) < 2 else end - log.stretches, end)
        begin = end
    return Statistics(columns=columns, grams=tuple(grams), rows=tuple(rows), nuisance=tuple(nuisance))


def _runs(fold: Integers) -> Iterator[tuple[int, slice]]:
    """Yield the folds of a block's rows, -1 aside, and where each run of rows of one fold lies."""
    edges = [0, *(np.flatnonzero(np.diff(fold)) + 1).tolist(), len(fold)]
    for begin, end in itertools.pairwise(edges):
        if fold[begin] >= 0:
            yield int(fold[begin]), slice(begin, end)


# Of ten invented logs (benchmarks/halved_constants.py) the stated errors were 0.76 to 1 of these with a
# MAX_RATIO of 1.5, 1 to 1.05 with 4; 0.93 to 1.16 with LARGE of 0.6, 0.9; 1 to 1.19 with SMALL of 0.2, 0.5.
MAX_RATIO = 2.0  # a group without which the fit falls apart says how far one cannot extrapolate, not this

LARGE = 0.75  # of the drive's range: without the swings above, the last gears would never be seen
SMALL = 0.35  # of the drive's range: divides the swings that can be left out into two amplitudes
LEVELS = (0.4, 0.6)  # of the drive's range: divide them into low, middle and high
FEWEST_GROUP_ROWS = 20  # chosen: 10 and 40 led to the same expected errors of eight invented logs
FEWEST_REST_ROWS = 100  # chosen, to fit from: so did 50 and 200


def groups_left_out(
    logs: Sequence[PreparedLog], basis: Basis, structure: Structure, cycles: float
) -> tuple[float, tuple[str, ...]]:
    """RMS error of groups of swings left out, the worst of three ways to group, and the ways there were."""
    worst, names = cycles**2, []
    for name, grouped in groupings(logs, basis):
        statistics = gather(grouped, basis, structure.segments)
        found: list[tuple[float, int]] = []
        for group in range(1, len(statistics.grams)):
            rest, rows = statistics.total(leave_out=group)
            mine = statistics.rows[group]
            if mine < FEWEST_GROUP_ROWS or rows < max(FEWEST_REST_ROWS, mine / 5):
                continue
            try:
                vector = solve(rest, statistics.columns, structure, rows).vector
            except FitError:
                continue
            left = squared_error_free_of(statistics.grams[group], vector, statistics.nuisance[group]) / mine
            found.append((min(left, (MAX_RATIO * cycles) ** 2), mine))
        if found:
            names.append(name)
            worst = max(worst, sum(error * mine for error, mine in found) / sum(mine for _, mine in found))
    return float(np.sqrt(worst)), tuple(names)


def groupings(logs: Sequence[PreparedLog], basis: Basis) -> Iterator[tuple[str, list[PreparedLog]]]:
    """Yield each way to group swings: its name, and the logs with the groups as folds, 0 for none."""
    swings = [swings_of(log, basis) for log in logs]
    counts = np.concatenate([one.rows for one in swings])
    speeds = np.repeat(np.concatenate([one.speed for one in swings]), counts)
    slow, fast = np.quantile(speeds, [1 / 3, 2 / 3])
    for name in ("amplitudes", "levels", "speeds"):
        labels = []
        for one in swings:
            small = one.amplitude < LARGE
            if name == "amplitudes":
                label = np.where(one.amplitude < SMALL, 1, 2)
            elif name == "levels":
                label = 1 + np.searchsorted(LEVELS, one.level)
            else:
                label = np.where(one.speed < slow, 1, np.where(one.speed > fast, 2, 0))
            labels.append(np.repeat(np.where(small, label, 0), one.rows))
        if any(label.any() for label in labels):
            folds = [np.where(log.used, label, -1) for log, label in zip(logs, labels, strict=True)]
            yield name, [replace(log, fold=fold) for log, fold in zip(logs, folds, strict=True)]


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
    return Swings(amplitude, (0.5 * (ends[1:] + ends[:-1]) - basis.low) / basis.span, speed, rows)
