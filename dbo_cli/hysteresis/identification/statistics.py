"""What the logs say about the unknowns, gathered once by folds so that any of them can be left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.identification.normal_equations import Columns
from dbo_cli.hysteresis.identification.regressors import BLOCK_ROWS, Basis, DriveRows, hat_functions
from dbo_cli.hysteresis.initial_states import StartName

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0
SELECTION_ROWS = 60_000  # orders are chosen on at most so many rows; the final fit uses all

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

    @property
    def used(self) -> NDArray[np.bool_]:
        """Rows that take part in the fit; shape (samples,)."""
        return self.fold >= 0


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


def fewer_rows(logs: Sequence[PreparedLog], limit: int = SELECTION_ROWS) -> list[PreparedLog]:
    """Keep about ``limit`` rows, short stretches spread evenly over all logs, for choosing orders on.

    Which stretches follows from multiples of the golden ratio, which fill the log without gaps or rhythm.
    """
    total = sum(int(log.used.sum()) for log in logs)
    if total <= limit:
        return list(logs)
    length = min(BLOCK_ROWS, max(1, limit // 40))
    kept = []
    for log in logs:
        stretch = np.arange(len(log.fold)) // length
        chosen = (stretch * GOLDEN_RATIO) % 1.0 < limit / total
        kept.append(replace(log, fold=np.where(chosen, log.fold, -1)))
    return kept


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
    columns = Columns(basis.gears, len(basis.time_constants), segments, drift)
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
        mine = {int(k): np.zeros((own, own)) for k in np.unique(log.fold[log.used])}
        rows_made = DriveRows(basis, log.voltage, log.seconds, log.start, log.used)
        for first, last, drive in rows_made.blocks():
            fold = log.fold[first:last]
            known, target = rows_of(drive, log.output[first:last])
            table = np.hstack((known, log.drift[first:last], target[:, None]))
            for k in np.unique(fold[fold >= 0]):
                part = table[fold == k]
                mine[int(k)] += part.T @ part
                rows[k] += len(part)
        picked = np.ix_(*2 * [np.r_[0:shared, begin:end, size - 1]])
        for k, gram in mine.items():
            grams[k][picked] += gram
            nuisance[k] = slice(begin if len(mine) < 2 else end - log.stretches, end)
        begin = end
    return Statistics(columns=columns, grams=tuple(grams), rows=tuple(rows), nuisance=tuple(nuisance))
