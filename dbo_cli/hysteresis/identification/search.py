"""The search for a structure: slopes, asymmetry, lag, gears and smoothness, each judged on data left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.hysteresis.identification.normal_equations import Structure, solve, squared_error
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Floats
from dbo_cli.hysteresis.identification.regressors import Basis, relaxed_drive
from dbo_cli.hysteresis.identification.selection import (
    INDIFFERENCE,
    Score,
    cross_validate,
    fitted_rmse,
    no_worse,
    simplest_of,
)
from dbo_cli.hysteresis.identification.statistics import (
    PreparedLog,
    Statistics,
    fewer_rows,
    gather,
)

ALL_GEARS = 1024
FINER_GEARS = 4
FINER_INDIFFERENCE = 0.01
"""Times as many gears where that lowers the error on data left out by more than this share, surely.

A turn inside a gear retraces it. On a loop of 40 % of the range that is an error of 0.013 % with 1,280 gears
(0.0055 with 2,560, 0.004 with 5,120): more than a good sensor's noise. Stages with 0.02 % of noise then
followed moves up to f_r/10 to 0.01 to 0.03 % instead of 0.02 to 0.07. The authors' log (noise 0.2 %) tells
nothing of it and keeps the fewer gears.
"""
SLOPE_CHOICES = (64, 128, 32)  # different slopes among the gears, in the order of preference
ROWS_PER_SLOPE = 8  # fewer usable rows than this for each unknown slope is not safe
FINE_SEGMENTS = 8
SEGMENT_CHOICES = (1, 2, 4, 8)
FINER_ASYMMETRIES = ((8, 1e-6), (16, 1e-6), (16, 1e-7), (32, 1e-7), (32, 1e-8), (32, 1e-9))
"""Segments and smoothness of the asymmetry, tried where 8 segments won: the error on a saturating curve falls
from 0.69 to 0.33 % of the range, on a shape-memory wing from 0.52 to 0.21; smooth piezos stay at 8 or 16."""

FINER_ASYMMETRIES_ONE_AMPLITUDE = 2
"""How many of them a log of one amplitude may choose from: with more, loop and asymmetry stand in for each
other (three times the error on a softening loop)."""

FINE_INDIFFERENCE = 0.005  # where the logs themselves can tell
ORDER_INDIFFERENCE = 0.01  # a kink in the asymmetry is worth having for less than rougher slopes are
SMOOTHNESS_CHOICES = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
START_SMOOTHNESS = 1e-8
BEND_STEP = 0.1
BEND_TRIALS = (-0.4, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4)
BEND_GAIN = 0.1  # of the RMSE: an asymmetry on the drive must earn its place beside the one on the output
TIME_CONSTANT_RATIO = 3.0
LONGEST_DELAY = 0.125  # of a cycle
EVIDENT_DELAY_TRIALS = (0.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # sample periods
EVIDENT_DELAY_GAIN = 0.7  # of the RMSE without one
FINEST_DELAY_STEP = 0.25  # of a sample: what a fit to noisy cycles can tell
DELAY_TRIALS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # sample periods
CREEP_EVIDENCE = (
    0.02  # of the drive's range: how much a slow memory must move for creep to be told from drift
)


@dataclass(frozen=True)
class Orders:
    """What the user fixed; None stands for 'auto'. ``delay`` and ``time_constants`` in seconds."""

    gears: int | None = None
    segments: int | None = None
    time_constants: tuple[float, ...] | None = None
    delay: float | None = None
    slopes: str | None = None


@dataclass(frozen=True)
class Choice:
    """What the search settled on.

    ``score`` is the cross-validated error of the choice; ``delay_interval`` (seconds) holds the delays with
    which the fit is no worse, fold by fold; ``clockwise`` how much worse growing slopes do than falling ones.
    """

    basis: Basis
    structure: Structure
    score: Score
    delay_interval: tuple[float, float] | None
    clockwise: float


def sample_period(logs: Sequence[PreparedLog]) -> float | None:
    """Median time between samples in seconds, None where a log has no clock."""
    if any(log.seconds is None for log in logs):
        return None
    steps = np.concatenate([np.diff(log.seconds) for log in logs if log.seconds is not None])
    moving = steps[steps > 0.0]
    return float(np.median(moving)) if len(moving) else None


def time_constant_grid(prepared: Prepared, period: float, cycle: float) -> tuple[float, ...]:
    """Time constants in seconds, from the sample period to the longest that the logs can tell from drift.

    A memory much slower than a cycle only shows where the drive's mean level moves: with one level and one
    frequency it is confounded with the loop's width and the offset, and such a model predicts nonsense as
    soon as the level changes. Slow memories are therefore offered only where they move by a stated share
    of the range once drift is taken off.
    """
    grid = []
    tau = period
    longest = max(float(log.seconds[-1]) for log in prepared.logs if log.seconds is not None)
    while tau <= longest / 2.0:
        if tau <= cycle / (2.0 * np.pi) or _moves_slowly(prepared, tau, cycle):
            grid.append(tau)
        tau *= TIME_CONSTANT_RATIO
    return tuple(grid)


def _moves_slowly(prepared: Prepared, tau: float, cycle: float) -> bool:
    """Whether a memory of ``tau`` seconds, averaged over cycles and freed of drift, moves noticeably."""
    for log in prepared.logs:
        if log.seconds is None:
            continue
        used = log.used
        memory = relaxed_drive((log.voltage - prepared.low) / prepared.span, log.seconds, (tau,))[used, 0]
        drift = log.drift[used]
        left = memory - drift @ np.linalg.lstsq(drift, memory, rcond=None)[0]
        window = np.unique(np.floor(log.seconds[used] / cycle), return_inverse=True)[1]
        means = np.bincount(window, left) / np.bincount(window)
        if len(means) >= 4 and float(means.std()) > CREEP_EVIDENCE:
            return True
    return False


def choose(prepared: Prepared, orders: Orders, cycle: float | None) -> Choice:
    """Choose slopes, bend, asymmetry, lag, smoothness and gears in turn; what the user fixed stays fixed.

    Parameters
    ----------
    prepared : the logs
    orders : what the user fixed
    cycle : median duration of a cycle in seconds, None without a clock
    """
    logs = fewer_rows(prepared.logs)
    period = sample_period(logs)
    if period is None or cycle is None:
        grid: tuple[float, ...] = ()
    elif orders.time_constants is not None:
        grid = orders.time_constants
    else:
        grid = time_constant_grid(prepared, period, cycle)
    slopes_wanted, split = SLOPE_CHOICES[0], ALL_GEARS // SLOPE_CHOICES[0]
    if orders.gears is not None:
        few = orders.gears <= 2 * slopes_wanted
        slopes_wanted, split = (
            (orders.gears, 1) if few else (slopes_wanted, -(-orders.gears // slopes_wanted))
        )
    coarse = Basis(slopes_wanted, prepared.low, prepared.high, split, grid, orders.delay or 0.0)
    fine = max(FINE_SEGMENTS if orders.segments is None else orders.segments, 1)
    everything = tuple(range(len(grid)))
    if orders.delay is None and period is not None and cycle is not None:
        coarse = replace(coarse, delay=_evident_delay(logs, coarse, fine, period, cycle))
    first = gather(logs, coarse, fine)
    slopes, clockwise = _slopes(first, orders, everything, fine, prepared.one_amplitude)
    trial = Structure(slopes, everything, fine, START_SMOOTHNESS)
    if orders.segments is None:
        coarse, first = _bend(logs, coarse, trial, first)
        scores = [cross_validate(first, replace(trial, segments=m)) for m in SEGMENT_CHOICES]
        trial = replace(trial, segments=SEGMENT_CHOICES[simplest_of(scores, ORDER_INDIFFERENCE)])
        if trial.segments == SEGMENT_CHOICES[-1]:
            # Before the lag: where 8 segments leave much over, what a lag explains drowns in it (2 ms behind
            # a saturating curve were not found: 0.30 % of error on new moves instead of 0.10).
            trial, first = _finer_asymmetry(logs, coarse, trial, first, prepared.one_amplitude)
            fine = first.columns.segments
    basis, trial, interval = _lag(logs, coarse, trial, orders, first, period, cycle)
    basis, trial, score = _gears(logs, basis, trial, orders, fine, prepared.one_amplitude)
    return Choice(basis, trial, score, interval, clockwise)


def _evident_delay(
    logs: Sequence[PreparedLog], coarse: Basis, segments: int, period: float, cycle: float
) -> float:
    """Delay in seconds that is seen at first sight, else 0: with it in the way, all else is chosen wrong.

    (25 ms at 200 samples a second: 2 segments of asymmetry instead of 16, and 0.20 % of error for 0.03.)
    """
    structure = Structure("growing", tuple(range(len(coarse.time_constants))), segments, START_SMOOTHNESS)
    errors: dict[float, float] = {}
    for step in EVIDENT_DELAY_TRIALS:
        if step * period > LONGEST_DELAY * cycle:
            break
        statistics = gather(logs, replace(coarse, delay=step * period), segments)
        gram, rows = statistics.total()
        vector = solve(gram, statistics.columns, structure, rows).vector
        errors[step] = float(np.sqrt(squared_error(gram, vector)))
        if errors[step] > min(errors.values()):
            break
    best = min(errors, key=lambda step: errors[step])
    return best * period if errors[best] < EVIDENT_DELAY_GAIN * errors[0.0] else 0.0


def _finer_asymmetry(
    logs: Sequence[PreparedLog], basis: Basis, trial: Structure, first: Statistics, one_amplitude: bool
) -> tuple[Structure, Statistics]:
    """More segments, and kinks in them, where they predict what was left out; also their statistics."""
    offered = FINER_ASYMMETRIES[: FINER_ASYMMETRIES_ONE_AMPLITUDE if one_amplitude else None]
    finest = offered[-1][0]
    statistics = gather(logs, basis, finest)
    trials = [replace(trial, segments=m, knot_smoothness=smoothness) for m, smoothness in offered]
    scores = [cross_validate(statistics, one) for one in trials]
    chosen = trials[simplest_of(scores, ORDER_INDIFFERENCE)]
    return chosen, (statistics if chosen.segments > trial.segments else first)


def _slopes(
    statistics: Statistics, orders: Orders, memories: tuple[int, ...], segments: int, one_amplitude: bool
) -> tuple[str, float]:
    """Rule for the slopes by cross-validation, and the ratio of the errors: growing over falling."""
    scores = {
        rule: cross_validate(statistics, Structure(rule, memories, segments, START_SMOOTHNESS))
        for rule in ("growing", "falling", "free")
    }
    ratio = scores["growing"].rmse / max(scores["falling"].rmse, 1e-300)
    if orders.slopes is not None:
        return orders.slopes, ratio
    rule = "growing" if scores["growing"].rmse <= 1.02 * scores["falling"].rmse else "falling"
    if (
        not one_amplitude
        and scores["free"].rmse < 0.9 * scores[rule].rmse
        and not no_worse(scores[rule], scores["free"])
    ):
        rule = "free"
    return rule, ratio


def _bend(
    logs: Sequence[PreparedLog], coarse: Basis, trial: Structure, straight: Statistics
) -> tuple[Basis, Statistics]:
    """Asymmetry that acts on the drive, beyond the paper: taken where it clearly helps on data left out.

    The asymmetry after the gears bends both branches alike; what differs between rising and falling drive
    twice a cycle it cannot follow, and lag and loop width are found wrong in its place.
    """
    segments = straight.columns.segments
    found = [(coarse, straight, cross_validate(straight, trial))]
    needed = (1.0 - BEND_GAIN) * found[0][2].rmse

    def attempt(bend: float) -> None:
        basis = replace(coarse, bend=bend)
        statistics = gather(logs, basis, segments)
        # What is left out is predicted no better than what is fitted: most need not be left out at all.
        if fitted_rmse(statistics, trial) <= needed:
            found.append((basis, statistics, cross_validate(statistics, trial)))

    for bend in BEND_TRIALS:
        attempt(bend)
    best = min(found, key=lambda item: item[2].rmse)
    if best[0].bend:
        for bend in (best[0].bend - BEND_STEP / 2.0, best[0].bend + BEND_STEP / 2.0):
            if abs(bend) < max(BEND_TRIALS):
                attempt(bend)
        best = min(found, key=lambda item: item[2].rmse)
    if best[2].rmse > needed or no_worse(found[0][2], best[2]):
        best = found[0]
    return best[0], best[1]


def _lag(
    logs: Sequence[PreparedLog],
    coarse: Basis,
    trial: Structure,
    orders: Orders,
    first: Statistics,
    period: float | None,
    cycle: float | None,
) -> tuple[Basis, Structure, tuple[float, float] | None]:
    """Delay and relaxation: none where the data left out do not ask for any.

    Where they do, the delay is the middle of those that explain the logs no worse than the best one does,
    with the relaxation fitted beside it. A log with one amplitude and one frequency hardly tells a delay
    from a lag or a wider loop; the middle bounds what that costs on the next recording.
    """
    if period is None or cycle is None:
        return coarse, replace(trial, memories=()), None
    plain = trial if orders.time_constants is not None else replace(trial, memories=())
    moved, interval = coarse, None
    if orders.delay is None:
        scanned = _delays(logs, coarse, trial, first.columns.segments, period, cycle)
        interval = _interval(scanned)
        middle = round((interval[0] + interval[1]) / 2.0 / period * 4.0) / 4.0 * period
        moved = replace(coarse, delay=middle)
    lagging = gather(logs, moved, first.columns.segments) if moved != coarse else first
    if orders.delay is None and coarse.delay > 0.0:
        return moved, trial, interval  # without any delay the fit was far worse
    scores = [cross_validate(first, plain), cross_validate(lagging, trial)]
    return (coarse, plain, interval) if simplest_of(scores) == 0 else (moved, trial, interval)


def _delays(
    logs: Sequence[PreparedLog],
    coarse: Basis,
    structure: Structure,
    segments: int,
    period: float,
    cycle: float,
) -> list[tuple[float, Floats, Floats]]:
    """Squared error by fold, and the folds' rows, of the fit with each delay (seconds) tried."""
    scanned: list[tuple[float, Floats, Floats]] = []

    def error(delay: float) -> float:
        statistics = gather(logs, replace(coarse, delay=delay), segments)
        gram, rows = statistics.total()
        vector = solve(gram, statistics.columns, structure, rows).vector
        by_fold = np.array([squared_error(g, vector) for g in statistics.grams])
        scanned.append((delay, by_fold, np.asarray(statistics.rows, dtype=float)))
        return float(by_fold.sum())

    tried: dict[float, float] = {}
    for step in DELAY_TRIALS:
        if step * period > LONGEST_DELAY * cycle:
            break
        tried[step] = error(step * period)
        if len(tried) > 4 and tried[step] > 1.5 * min(tried.values()):
            break
    while True:  # halve the gaps beside the best until they are a quarter of a sample
        best = min(tried, key=lambda step: tried[step])
        beside = [step for step in tried if step != best]
        below = max((step for step in beside if step < best), default=best)
        above = min((step for step in beside if step > best), default=best)
        between = [(best + step) / 2.0 for step in (below, above) if abs(step - best) > FINEST_DELAY_STEP]
        if not between:
            break
        for step in between:
            tried[step] = error(step * period)
    return scanned


def _interval(scanned: list[tuple[float, Floats, Floats]]) -> tuple[float, float]:
    """Delays whose error is within one standard error (over folds) of the best one's."""
    scores = [(delay, Score(errors / rows, rows / rows.sum())) for delay, errors, rows in scanned]
    best = min(scores, key=lambda item: float(item[1].excess_over(scores[0][1]).mean()))[1]
    held = [delay for delay, score in scores if no_worse(score, best)]
    return min(held), max(held)


def _gears(
    logs: Sequence[PreparedLog],
    basis: Basis,
    trial: Structure,
    orders: Orders,
    segments: int,
    one_amplitude: bool,
) -> tuple[Basis, Structure, Score]:
    """Smoothest slopes that are no worse, then how many of them, then finer gears where they show.

    Never fewer gears: they cost nothing per sample, and a turn inside a gear retraces it, an error that the
    logs do not show where they turn at few levels, on the gears' own edges perhaps (128 gears looked as good
    as 1024 on two amplitudes of a tendon: 0.18 % of error on new moves instead of 0.05).
    """
    structure, score = _smoothness(gather(logs, basis, segments), trial, one_amplitude)
    if orders.gears is not None:
        return basis, structure, score
    usable = sum(int(log.used.sum()) for log in logs)
    candidates = [(basis, score)]
    for count in SLOPE_CHOICES[1:]:
        if count * ROWS_PER_SLOPE <= usable:
            other = replace(basis, gears=count, split=ALL_GEARS // count)
            candidates.append((other, cross_validate(gather(logs, other, segments), structure)))
    basis, score = candidates[simplest_of([candidate[1] for candidate in candidates], FINE_INDIFFERENCE)]
    finer = replace(basis, split=FINER_GEARS * basis.split)
    statistics = gather(logs, finer, segments)
    if not no_worse(score, cross_validate(statistics, structure), FINER_INDIFFERENCE):
        return finer, *_smoothness(statistics, trial, one_amplitude)
    return basis, structure, score


def _smoothness(statistics: Statistics, trial: Structure, one_amplitude: bool) -> tuple[Structure, Score]:
    """Smoothest slopes that are no worse on data left out."""
    smoothed = [replace(trial, smoothness=smoothness) for smoothness in SMOOTHNESS_CHOICES]
    scores = [cross_validate(statistics, structure) for structure in smoothed]
    best = simplest_of(scores, INDIFFERENCE if one_amplitude else FINE_INDIFFERENCE)
    return smoothed[best], scores[best]
