"""The rows of a relative's least-squares problem, and their products, fold by fold.

Plays that are neighbours are nearly alike, so the columns are their differences: Σ w_i z_i =
Σ W_i (z_i − z_{i+1}) + W_n z_n with W_i = Σ_{j≤i} w_j. The unknowns are then the slopes W_i, and rules for
the weights are rules for their increments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dbo_cli.hysteresis.identification.regressors import hat_functions
from dbo_cli.hysteresis.identification.statistics import FoldProducts, PreparedLog
from dbo_cli.relatives.plays import Kind, PlayOperator

Floats = NDArray[np.float64]

BLOCK_ROWS = 2048


@dataclass(frozen=True)
class Design:
    """What is fixed before the problem is solved.

    Attributes
    ----------
    kind : str
        Of the operator.
    plays : int
        Their number; the radii are spread evenly from 0 to below half the range (one-sided: the whole).
    low, high : float
        The drive's range over all logs.
    delay : float
        Of the output behind the drive, in seconds.
    segments : int
        Of the dead zones' curve; 1: none.
    fastest : float
        Of [7]: the rate (1/s, of the scaled drive) that the second set of slopes belongs to.
    falling : bool
        Whether slopes fall from play to play (loops that soften after a turn) instead of growing.
    """

    kind: Kind
    plays: int
    low: float
    high: float
    delay: float = 0.0
    segments: int = 1
    fastest: float = 0.0
    falling: bool = False

    def operator(self) -> PlayOperator:
        """Return plays of weight 1, for their rows."""
        kind: Kind = "one-sided-plays" if self.kind == "one-sided-plays" else "plays"
        ones = np.ones(self.plays)
        return PlayOperator(kind, np.arange(self.plays) / self.plays, ones, linear=0.0)

    def scaled(self, voltage: Floats) -> Floats:
        """Return the drive scaled to the operator's range."""
        share: Floats = (voltage - self.low) / (self.high - self.low)
        return share if self.kind == "one-sided-plays" else 2.0 * share - 1.0

    @property
    def slopes(self) -> int:
        """Number of columns that are slopes (and, of [9], of the two parts of the curve)."""
        if self.kind == "rate-plays":
            return 2 * self.plays
        return self.plays + 1 if self.kind == "one-sided-plays" else self.plays

    def columns(self, plays: Floats, drive: Floats, rate: Floats) -> Floats:
        """Return the columns of one block, shape (samples, slopes)."""
        if self.kind == "one-sided-plays":
            cube = drive**3 / 3.0  # a₁ x³ + a₂ x as parts that rise: slopes 1 − x² and x² from 0 to 1
            return np.hstack((_differences(plays[:, 1:]), (drive - cube)[:, None], cube[:, None]))
        steps = _differences(plays)
        if self.kind != "rate-plays":
            return steps
        share = np.minimum(rate / self.fastest, 1.0)[:, None]
        return np.hstack(((1.0 - share) * steps, share * steps))


def _differences(plays: Floats) -> Floats:
    steps = plays.copy()
    steps[:, :-1] -= plays[:, 1:]
    return steps


def rates_of(drive: Floats, seconds: Floats | None) -> Floats:
    """Return the rate of the scaled drive (1/s) since the sample before; 0 at first and without a clock."""
    if seconds is None:
        return np.zeros(len(drive))
    steps = np.diff(seconds, prepend=seconds[0])
    change = np.abs(np.diff(drive, prepend=drive[0]))
    rates: Floats = np.divide(change, steps, out=np.zeros(len(drive)), where=steps > 0.0)
    return rates


def rows_of(log: PreparedLog, design: Design) -> Iterator[tuple[slice, Floats]]:
    """Yield (rows of the log, columns) block by block; the delay is that of ``DelayStage``."""
    drive = design.scaled(log.voltage)
    rate = rates_of(drive, log.seconds)
    operator = design.operator()
    if log.start in ("empty", "full"):
        held = operator.after(operator.low if log.start == "empty" else 1.0)
    else:
        held = operator.settled(float(drive[0]))
    before, share = delayed_rows(log.seconds, len(drive), design.delay)
    for begin in range(0, len(drive), BLOCK_ROWS):
        end = min(begin + BLOCK_ROWS, len(drive))
        plays, held_after = operator.rows(drive[begin:end], held)
        if end < len(drive):  # the sample after, that the last ones are interpolated towards
            plays = np.vstack((plays, operator.rows(drive[end : end + 1], held_after)[0]))
        held = held_after
        rows = slice(int(np.searchsorted(before, begin)), int(np.searchsorted(before, end)))
        if rows.stop == rows.start or not log.used[rows].any():
            continue
        some = slice(begin, begin + len(plays))
        table = design.columns(plays, drive[some], rate[some])
        first = before[rows] - begin
        part = share[rows, None]
        if part.any():
            table = (1.0 - part) * table[first] + part * table[np.minimum(first + 1, len(table) - 1)]
        else:
            table = table[first]
        yield rows, table


def delayed_rows(seconds: Floats | None, samples: int, delay: float) -> tuple[NDArray[np.int64], Floats]:
    """Return for each row the row at or before ``delay`` seconds ago, and the share of the row after it."""
    rows = np.arange(samples)
    if seconds is None or delay <= 0.0:
        return rows, np.zeros(samples)
    place = np.interp(np.maximum(seconds - delay, seconds[0]), seconds, rows)
    before = np.maximum.accumulate(np.minimum(place.astype(np.int64), max(samples - 2, 0)))
    return before, np.clip(place - before, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Products(FoldProducts):
    """The products of one design: ``slopes``, ``knots`` and ``drift`` columns, in that order."""

    slopes: int
    knots: int
    drift: int


def gather(logs: Sequence[PreparedLog], design: Design) -> Products:
    """Gather the products of Γ(v) − S⁻¹(y) = 0 over all logs, S⁻¹ on the measured side as in [6]."""
    drift = sum(log.drift.shape[1] for log in logs)
    shared = design.slopes + design.segments - 1
    size = shared + drift + 1
    folds = 1 + max(int(log.fold.max(initial=-1)) for log in logs)
    grams, counts = [np.zeros((size, size)) for _ in range(folds)], [0] * folds
    nuisance = [slice(shared, shared)] * folds
    begin = shared
    for log in logs:
        end = begin + log.drift.shape[1]
        alone = len(np.unique(log.fold[log.used])) < 2
        picked = np.r_[0:shared, begin:end, size - 1]
        for rows, columns in rows_of(log, design):
            output, fold = log.output[rows], log.fold[rows]
            hats = -hat_functions(output, design.segments)
            table = np.hstack((columns, hats, log.drift[rows], output[:, None]))
            for k in np.unique(fold[fold >= 0]):
                part = table[fold == k]
                grams[k][np.ix_(picked, picked)] += part.T @ part
                counts[k] += len(part)
                nuisance[k] = slice(begin if alone else end - log.stretches, end)
        begin = end
    return Products(
        slopes=design.slopes,
        knots=design.segments - 1,
        drift=drift,
        grams=tuple(grams),
        rows=tuple(counts),
        nuisance=tuple(nuisance),
    )
