"""A relative fitted to prepared logs: bounded least squares on the rows, folds, drift and starts of the DBO.

Each has its best delay searched for, its numbers of plays and of dead zones chosen on
cycles left out.

Plays that are neighbours are nearly alike, so the columns are their differences: Σ w_i
z_i = Σ W_i (z_i − z_{i+1}) + W_n z_n with W_i = Σ_{j≤i} w_j. The unknowns are then the
slopes W_i, and rules for the weights are rules for their increments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError, ModelError
from dbo_cli.extras.compare.play_model import RelativeModel
from dbo_cli.extras.compare.plays import Kind, PlayOperator
from dbo_cli.hysteresis.cascade import DelayStage, ScaleStage, Stage
from dbo_cli.hysteresis.identification import normal_equations, search, statistics
from dbo_cli.hysteresis.identification.cleaning import LONGEST_DELAY
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import FEWEST_ROWS, Recording
from dbo_cli.hysteresis.identification.statistics import PreparedLog, Score
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.hysteresis.operators import DiscretePointOperator, Floats

# what the paper and the literature take, and what the delay is searched for with
USUAL_PLAYS = 25
PLAYS = (12, 25, 50, 100)  # to choose from; chosen, each twice the one before
# of the dead zones' curve, to choose from; chosen, each twice the one before
SEGMENTS = (1, 2, 4, 8)
# sample periods
DELAY_TRIALS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
FINEST_DELAY_STEP = 0.125  # of a sample period: half of what the gears take
NOTHING_LEFT = 1e-12  # of the range: an error below it is rounding
# of all samples are slower than the rate that the second set of slopes belongs to
FASTEST_SHARE = 0.999
BLOCK_ROWS = 2048  # bounds the table in memory; 512 to 65,536 took the same time


@dataclass(frozen=True)
class Design:
    """What is fixed before the problem is solved.

    Attributes
    ----------
    kind : str
        Of the operator.
    plays : int
        Their number; the radii are spread evenly from 0 to below half the range
        (one-sided: the whole).
    low, high : float
        The drive's range over all logs.
    delay : float
        Of the output behind the drive, in seconds.
    segments : int
        Of the dead zones' curve; 1: none.
    fastest : float
        Of [7]: the rate (1/s, of the scaled drive) that the second set of slopes
        belongs to.
    falling : bool
        Whether slopes fall from play to play (loops that soften after a turn) instead
        of growing.
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

    @property
    def knots(self) -> int:
        """Number of columns that are inner knots of the dead zones' curve."""
        return self.segments - 1

    def columns(self, plays: Floats, drive: Floats, rate: Floats) -> Floats:
        """Return the columns of one block, shape (samples, slopes)."""
        if self.kind == "one-sided-plays":
            # a₁ x³ + a₂ x as parts that rise: slopes 1 − x² and x² from 0 to 1
            cube = drive**3 / 3.0
            return np.hstack(
                (_differences(plays[:, 1:]), (drive - cube)[:, None], cube[:, None])
            )
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
    rates: Floats = np.divide(
        change, steps, out=np.zeros(len(drive)), where=steps > 0.0
    )
    return rates


def rows_of(log: PreparedLog, design: Design) -> Iterator[tuple[slice, Floats]]:
    """Yield (rows of the log, columns) block by block; the delay is that of ``DelayStage``."""
    drive = design.scaled(log.voltage)
    rate = rates_of(drive, log.seconds)
    operator = design.operator()
    if log.start in ("empty", "full"):
        state = operator.after(operator.low if log.start == "empty" else 1.0)
    else:
        state = operator.settled(float(drive[0]))
    before, share = delayed_rows(log.seconds, len(drive), design.delay)
    for begin in range(0, len(drive), BLOCK_ROWS):
        end = min(begin + BLOCK_ROWS, len(drive))
        plays, held_after = operator.rows(drive[begin:end], state)
        # the sample after, that the last ones are interpolated towards
        if end < len(drive):
            plays = np.vstack(
                (plays, operator.rows(drive[end : end + 1], held_after)[0])
            )
        state = held_after
        rows = slice(
            int(np.searchsorted(before, begin)), int(np.searchsorted(before, end))
        )
        if rows.stop == rows.start or not log.used[rows].any():
            continue
        block = slice(begin, begin + len(plays))
        table = design.columns(plays, drive[block], rate[block])
        first = before[rows] - begin
        part = share[rows, None]
        if part.any():
            table = (1.0 - part) * table[first] + part * table[
                np.minimum(first + 1, len(table) - 1)
            ]
        else:
            table = table[first]
        yield rows, table


def delayed_rows(
    seconds: Floats | None, samples: int, delay: float
) -> tuple[NDArray[np.int64], Floats]:
    """Return for each row the row at or before ``delay`` seconds ago, and the share of the row after it."""
    rows = np.arange(samples)
    if seconds is None or delay <= 0.0:
        return rows, np.zeros(samples)
    place = np.interp(np.maximum(seconds - delay, seconds[0]), seconds, rows)
    before = np.maximum.accumulate(
        np.minimum(place.astype(np.int64), max(samples - 2, 0))
    )
    return before, np.clip(place - before, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Products(statistics.FoldProducts):
    """The products of one design: columns of its slopes, its knots, and of ``drift``, in that order."""

    design: Design
    drift: int

    def fitted(self) -> tuple[Floats, float]:
        """Return the unknowns fitted to all folds, and the squared error that is left."""
        gram, _ = self.total()
        solution = solve(self, gram)
        return solution, normal_equations.squared_error(gram, solution)

    def left_out(self, fold: int) -> float:
        """Return the squared error on one fold of a fit to all others."""
        rest, _ = self.total(leave_out=fold)
        gram, solution = self.grams[fold], solve(self, rest)
        return normal_equations.squared_error_free_of(
            gram, solution, self.nuisance[fold]
        )


def gather(logs: Sequence[PreparedLog], design: Design) -> Products:
    """Gather the products of Γ(v) − S⁻¹(y) = 0 over all logs, S⁻¹ on the measured side as in [6]."""
    drift = sum(log.drift.shape[1] for log in logs)
    shared = design.slopes + design.knots
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
            hats = -statistics.hat_functions(output, design.segments)
            table = np.hstack((columns, hats, log.drift[rows], output[:, None]))
            for k in np.unique(fold[fold >= 0]):
                part = table[fold == k]
                grams[k][np.ix_(picked, picked)] += part.T @ part
                counts[k] += len(part)
                nuisance[k] = slice(begin if alone else end - log.stretches, end)
        begin = end
    sums = tuple(grams), tuple(counts), tuple(nuisance)
    return Products(
        design=design, drift=drift, grams=sums[0], rows=sums[1], nuisance=sums[2]
    )


@dataclass(frozen=True)
class Relative:
    """One of the models to compare with: its name, what it is in words, and the kind of its plays."""

    name: str
    words: str
    kind: Kind
    plays: tuple[int, ...] = PLAYS
    segments: tuple[int, ...] = (1,)


RELATIVES = (
    Relative("line", "straight line", "plays", plays=(1,)),
    Relative(
        "pi",
        "Prandtl-Ishlinskii (PI), plays and dead zones [6]",
        "plays",
        segments=SEGMENTS,
    ),
    Relative(
        "rate", "rate-dependent PI and dead zones [7]", "rate-plays", segments=SEGMENTS
    ),
    Relative(
        "singularity-free",
        "singularity-free PI, dead zones [8]",
        "singular-plays",
        segments=SEGMENTS,
    ),
    Relative(
        "asymmetric", "asymmetric PI [9], in the form of Gu et al.", "one-sided-plays"
    ),
)


def solve(products: Products, gram: Floats) -> Floats:
    """Minimise the squared equation error under the rules of the kind: a quadratic programme.

    All slopes W_i are at least ``SLOPE_FLOOR`` of the mean slope, weights of further
    plays at least 0 (of loops that soften after a turn at most 0); of [8] W_0 is free.
    The dead zones' slopes are above 0. Returns the unknowns: slopes (as in
    ``Design.columns``), the dead zones' knots, drift.
    """
    design = products.design
    at, knots = design.slopes, design.knots
    total = at + knots + products.drift
    fixed, bounded, free = np.zeros(total), [], np.zeros((total, 0))
    n, one_sided = design.plays, design.kind == "one-sided-plays"
    floor = normal_equations.SLOPE_FLOOR * (1.0 if one_sided else 0.5)
    for begin, count in _slope_groups(design):
        rule = np.zeros((total, count))
        whole = np.ones((count, count))
        rule[begin : begin + count] = (
            np.triu(whole) if design.falling else np.tril(whole)
        )
        bounded.append(rule)
        if not one_sided:
            fixed[begin : begin + count] = floor
    if one_sided:
        fixed[n - 1 : n + 1] = floor
    if design.kind == "singular-plays" and not design.falling:
        free, bounded[0] = bounded[0][:, :1], bounded[0][:, 1:]
        fixed[:] = 0.0
    drift = np.zeros((total, products.drift))
    drift[at + knots :] = np.eye(products.drift)
    tie = None
    if knots:
        least, wider, spare = _widths(design.segments)
        fixed[at : at + knots] = least
        tie = sum(part.shape[1] for part in bounded), spare
        rule = np.zeros((total, design.segments))
        rule[at : at + knots] = wider
        bounded.append(rule)
    matrix, right = gram[:total, :total], gram[:total, total]
    right = right - matrix @ fixed
    unbound = np.hstack((free, drift))
    return fixed + normal_equations.bounded_minimum(
        matrix, right, np.hstack(bounded), unbound, tie
    )


def _slope_groups(design: Design) -> list[tuple[int, int]]:
    """Return (first column, columns) of slopes whose increments are at least 0."""
    n = design.plays
    if design.kind == "rate-plays":
        return [(0, n), (n, n)]
    # the plays but the first, then each part of the curve by itself
    if design.kind == "one-sided-plays":
        return [(0, n - 1), (n - 1, 1), (n, 1)] if n > 1 else [(0, 1), (1, 1)]
    return [(0, n)]


def _widths(segments: int) -> tuple[Floats, Floats, float]:
    """Return the knots with all segments at their narrowest, what each wider one adds, and what is to add."""
    narrowest = 1.0 / (normal_equations.MAX_STEEPNESS * segments)
    least: Floats = np.arange(1.0, segments) * (narrowest - 1.0 / segments)
    wider = np.hstack(
        (np.tril(np.ones((segments - 1, segments - 1))), np.zeros((segments - 1, 1)))
    )
    return least, wider, 1.0 - segments * narrowest


def cross_validated(products: Products) -> Score:
    """Leave out each fold in turn, fit the others, and measure the error on the fold left out."""
    squares = [products.left_out(fold) for fold in range(len(products.rows))]
    return Score.of(squares, products.rows)


def _held_out(logs: Sequence[PreparedLog], design: Design, cycles: float) -> float:
    """Return the RMS error on what was left out: whole cycles, or groups of swings where that is worse.

    The groups are those of the DBO's own expectation; its other part, how far models
    that explain the logs as well go apart, is not looked for here.
    """
    worst = cycles**2
    for _, grouped in statistics.groupings(
        logs, statistics.Basis(1, design.low, design.high)
    ):
        products = gather(grouped, design)
        squares, rows = 0.0, 0
        for group in range(1, len(products.grams)):
            left_out_rows = products.rows[group]
            other_rows = sum(products.rows) - left_out_rows
            if left_out_rows < FEWEST_ROWS or other_rows < max(
                FEWEST_ROWS, left_out_rows / 5
            ):
                continue
            squares += min(
                products.left_out(group),
                left_out_rows * (statistics.MAX_RATIO * cycles) ** 2,
            )
            rows += left_out_rows
        worst = max(worst, squares / rows if rows else 0.0)
    return float(np.sqrt(worst))


def best_delay(
    logs: Sequence[PreparedLog], design: Design, trials: Sequence[float], period: float
) -> tuple[float, float]:
    """Return the delay (s) with the least squared error, and that error.

    ``trials`` are in periods (s) of the whole logs: rows of thinned ones stand further
    apart than a delay.
    """
    errors: dict[float, float] = {}

    def attempt(step: float) -> None:
        errors[step] = gather(logs, replace(design, delay=step * period)).fitted()[1]

    for step in trials:
        attempt(step)
        if errors[step] > 1.5 * min(errors.values()):
            break
    while True:
        best = min(errors, key=lambda step: errors[step])
        below = max((step for step in errors if step < best), default=best)
        above = min((step for step in errors if step > best), default=best)
        between = [
            0.5 * (best + step)
            for step in (below, above)
            if abs(step - best) > FINEST_DELAY_STEP
        ]
        if not between:
            return best * period, errors[best]
        for step in between:
            attempt(step)


def fit(
    relative: Relative,
    prepared: Prepared,
    recordings: Sequence[Recording],
    cycle: float | None,
) -> RelativeModel:
    """Fit one relative to prepared logs.

    Parameters
    ----------
    relative : which
    prepared : the logs as the identification of gears prepares them
    recordings : the same logs in their units
    cycle : median duration of a cycle (s), None without a clock

    Raises
    ------
    FitError
        It cannot be fitted to these logs; the message says why.
    """
    logs = statistics.fewer_rows(prepared.logs)
    plays = USUAL_PLAYS if USUAL_PLAYS in relative.plays else relative.plays[0]
    design = Design(
        relative.kind,
        plays,
        prepared.low,
        prepared.high,
        segments=relative.segments[-1],
    )
    if relative.kind == "rate-plays":
        design = replace(design, fastest=_fastest(logs, design))
    period = search.sample_period(prepared.logs) or 1.0
    longest = LONGEST_DELAY * (cycle or 0.0)
    # without a clock 0 alone
    trials = [step for step in DELAY_TRIALS if step * period <= longest]
    delay, error = best_delay(logs, design, trials, period)
    design = replace(design, delay=delay)
    if relative.kind != "one-sided-plays" and plays > 1:
        falling = replace(design, falling=True)
        delay_falling, error_falling = best_delay(logs, falling, trials, period)
        if error_falling < error:
            delay = delay_falling
            design = replace(falling, delay=delay)
    # thinned rows alone tell the delay less well
    if trials[1:] and logs[0] is not prepared.logs[0]:
        near = [max(delay / period + step, 0.0) for step in (-1.0, 0.0, 1.0)]
        delay, _ = best_delay(prepared.logs, design, near, period)
        design = replace(design, delay=delay)
    curves = [replace(design, segments=count) for count in relative.segments]
    design = _simplest(logs, curves)
    usable = sum(int(log.used.sum()) for log in logs)
    counts = [
        count for count in relative.plays if count * search.ROWS_PER_SLOPE <= usable
    ]
    counts = counts or list(relative.plays[:1])
    design = _simplest(logs, [replace(design, plays=count) for count in counts])
    products = gather(logs, design)
    error = max(float(np.sqrt(products.fitted()[1] / sum(products.rows))), NOTHING_LEFT)
    ratio = _held_out(logs, design, max(cross_validated(products).rmse, error)) / error
    solution, _ = gather(prepared.logs, design).fitted()
    model = _model_of(solution, design, prepared, recordings[0])
    model = _levelled(model, prepared.logs[0], recordings[0])
    figures = {"method": relative.name, "operator": relative.words, "plays": design.plays,
               "points": design.segments if design.segments > 1 else 0, "delay_seconds": design.delay,
               "parameters": _parameters(design), "left_out_ratio": ratio}  # fmt: skip
    return replace(model, fit=figures)


def _simplest(logs: Sequence[PreparedLog], designs: Sequence[Design]) -> Design:
    """Return the first of several designs, simplest first, that predicts what was left out as well as any."""
    if len(designs) == 1:
        return designs[0]
    scores: list[Score] = []
    for design in designs:
        try:
            scores.append(cross_validated(gather(logs, design)))
        except FitError:  # columns too nearly alike for the solver: none finer is tried
            if not scores:
                raise
            break
    least = min(scores, key=lambda score: score.rmse)
    # No scatter excuses a coarser rival.
    losses = [float(score.excess_over(least).mean()) for score in scores]
    near = min(losses) + float(np.log1p(search.FINE_INDIFFERENCE))
    return designs[next(k for k, loss in enumerate(losses) if loss <= near)]


def _fastest(logs: Sequence[PreparedLog], design: Design) -> float:
    """Return the fastest rate of the scaled drive (1/s), the wildest samples aside."""
    if any(log.seconds is None for log in logs):
        raise FitError(
            "the rate needs a clock: name the time column (`time`) or give `sample_rate`"
        )
    rates = np.concatenate(
        [rates_of(design.scaled(log.voltage), log.seconds) for log in logs]
    )
    fastest = float(np.quantile(rates, FASTEST_SHARE))
    if not fastest > 0.0:
        raise FitError(
            "the drive stands still almost everywhere, so that its rate says nothing"
        )
    return fastest


def _parameters(design: Design) -> int:
    """Return how many numbers were fitted: weights, knots, an offset, and the delay where there is one."""
    slopes = 1 if design.plays == 1 and design.kind == "plays" else design.slopes
    return slopes + design.knots + 1 + (design.delay > 0.0)


def operator_of(slopes: Floats, design: Design) -> PlayOperator:
    """Return the plays with the slopes that were found.

    Raises
    ------
    FitError
        The slopes leave no operator that can be inverted.
    """
    n = design.plays
    more: dict[str, Any] = {}
    if design.kind == "one-sided-plays":
        weights = np.concatenate(([0.0], np.diff(slopes[: n - 1], prepend=0.0)))
        falling, rising = slopes[n - 1 :]
        more = {"cubic": float(rising - falling) / 3.0, "linear": float(falling)}
    else:
        weights = np.diff(slopes[:n], prepend=0.0)
    if design.kind == "rate-plays":
        more = {
            "by_rate": np.diff(slopes[n:], prepend=0.0) - weights,
            "fastest": design.fastest,
        }
    try:
        return PlayOperator(design.kind, np.arange(n) / n, weights, **more)
    except ModelError as problem:
        raise FitError(f"what fits best has no inverse ({problem})") from None


def _model_of(
    solution: Floats, design: Design, prepared: Prepared, recording: Recording
) -> RelativeModel:
    """Return the model in the logs' units."""
    slopes, knots, drift = np.split(
        solution, [design.slopes, design.slopes + design.knots]
    )
    operator = operator_of(slopes, design)
    width = (1.0 - operator.low) / (prepared.high - prepared.low)
    origin = float(drift[0])
    stages: list[Stage] = [
        ScaleStage(width, operator.low - width * prepared.low),
        operator,
    ]
    offset = prepared.offset
    if design.segments > 1:
        corners = np.arange(design.segments + 1) / design.segments
        corners[1:-1] += knots
        height = np.full(design.segments, 1.0 / design.segments)
        stages += [
            ScaleStage(1.0, origin),
            DiscretePointOperator(np.diff(corners), height),
        ]
    else:
        offset += prepared.scale * origin
    stages.append(ScaleStage(prepared.scale, offset))
    if design.delay > 0.0:
        stages.append(DelayStage(design.delay))
    return _ranged(stages, prepared.low, prepared.high, recording)


def _ranged(
    stages: Sequence[Stage], low: float, high: float, recording: Recording
) -> RelativeModel:
    """Return the model with the range that its output reaches slowly."""
    source = Quantity(recording.voltage_quantity, recording.voltage_unit, low, high)
    anything = Quantity(
        recording.displacement_quantity, recording.displacement_unit, 0.0, 1.0
    )
    model = RelativeModel("forward", source, anything, tuple(stages))
    still = model.without_lag
    ends = still.simulate(
        [low, high, high, low], still.start(low, "empty"), time_step=1e9
    ).y[1:]
    return replace(
        model,
        output=replace(anything, minimum=float(ends.min()), maximum=float(ends.max())),
    )


def _levelled(
    model: RelativeModel, log: PreparedLog, recording: Recording
) -> RelativeModel:
    """Return the model with the offset that the first log's displacement asks for."""
    left = (recording.displacement - predict(model, recording, log.start))[log.used]
    offset = float(np.linalg.lstsq(log.drift[log.used], left, rcond=None)[0][0])
    stages = list(model.stages)
    place = max(k for k, stage in enumerate(stages) if isinstance(stage, ScaleStage))
    last = stages[place]
    assert isinstance(last, ScaleStage)
    stages[place] = ScaleStage(last.gain, last.offset + offset)
    drive = model.input
    return _ranged(stages, drive.minimum, drive.maximum, recording)
