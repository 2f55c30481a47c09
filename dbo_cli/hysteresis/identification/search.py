"""The search for a structure: one list of candidates, each judged on data left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    Structure,
    quadratic,
)
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Floats
from dbo_cli.hysteresis.identification.statistics import (
    LENGTHS,
    Basis,
    PreparedLog,
    Statistics,
    fewer_rows,
    gather,
    groups_left_out,
    relaxed_drive,
)
from dbo_cli.records import dataclass

ALL_GEARS = 1024
"""However many slopes they share. On eight invented logs half as many left 0.997 to 1.42 of the error on new
moves, twice as many 0.53 (springs that slip) to 1.003."""

FINER_GEARS = 4  # see below; twice as many again would gain little
FINER_INDIFFERENCE = 0.01
"""Times as many gears where that lowers the error on data left out by more than this share, surely.

A turn inside a gear retraces it. On a loop of 40 % of the range that is an error of 0.013 % with 1,280 gears
(0.0055 with 2,560, 0.004 with 5,120): more than a good sensor's noise. Stages with 0.02 % of noise then
followed moves up to f_r/10 to 0.01 to 0.03 % instead of 0.02 to 0.07. The authors' log (noise 0.2 %) tells
nothing of it and keeps the fewer gears.
"""
SLOPE_CHOICES = (64, 128, 256)
"""Different slopes among the gears, simplest first: with 256 springs that slip were predicted with 0.6 of the
error, and fewer than 64 were never better."""
ROWS_PER_SLOPE = 8  # fewer usable rows than this for each unknown slope is not safe
KNOT_SMOOTHNESS = 1e-6  # of few segments, whose kinks are the curve; the list below goes down from it
SEGMENTS = (
    *((count, KNOT_SMOOTHNESS) for count in (1, 2, 4, 8, 16)), (16, 1e-7), (32, 1e-7), (32, 1e-8), (32, 1e-9)
)  # fmt: skip
"""Segments and smoothness of the asymmetry, simplest first: the error on a saturating curve falls from 0.69 %
of the range with 8 to 0.33, on a shape-memory wing from 0.52 to 0.21; smooth piezos stay at 8 or 16."""

SEGMENTS_ONE_AMPLITUDE = 5
"""How many of them a log of one amplitude may choose from: with more, loop and asymmetry stand in for each
other (three times the error on a softening loop)."""

FREE_GAIN = 0.9
"""Free slopes must lower the error on cycles left out, and on an amplitude, level or speed left out, to
this share. On 20 invented plants (several amplitudes) the geometric mean of the error over the best
rival's was 0.61 so; by the cycles alone 0.69."""

ONE_AMPLITUDE_MEMORY = 0.15
"""What memories must gain there over a delay alone: they make loops, too, at the logs' one frequency. Where
they took part for less, ten plants were followed 1.3 to 4 times worse on other amplitudes."""

ONE_AMPLITUDE_INDIFFERENCE = 0.05
"""A gain below this share is no evidence there while bend and lag are looked for. On 26 logs of one amplitude
the geometric mean of the error over the best rival's was 1.19 with 0.02, 1.13 with 0.05."""

# On ten invented logs (benchmarks/halved_constants.py) half and double of FINE_INDIFFERENCE changed errors on
# new moves by at most 1 %, of ORDER_INDIFFERENCE by 3, of BEND_TRIALS by 5, and of BEND_GAIN, LONGEST_DELAY,
# EVIDENT_DELAY_GAIN (0.5, 0.85), FINEST_DELAY_STEP, CREEP_EVIDENCE, INDIFFERENCE and MAX_STANDARD_ERROR none.
FINE_INDIFFERENCE = 0.005  # where the logs themselves can tell
ORDER_INDIFFERENCE = 0.01  # a kink in the asymmetry is worth having for less than rougher slopes are
SMOOTHNESS_CHOICES = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-14, 1e-16)
"""Springs that slip at a few forces have slopes with kinks: their error on new moves (four kinds of logs) was
0.36 to 0.52 of that with 1e-12 for the last; on nine other kinds it is the same or less (0.76 to 1.00)."""
START_SMOOTHNESS = 1e-8  # for comparing the other choices; 1e-7 and 1e-9 led to the same models
BEND_STEP = 0.1  # of the range, refined by half: 0.05 and 0.2 changed one of eight logs, by 5 %
BEND_TRIALS = 4  # steps to either side, outwards while the fit gets better
BEND_GAIN = 0.1  # of the RMSE: an asymmetry on the drive must earn its place beside the one on the output
FORGETTING_GAIN = 0.9
"""Memories that fade with the way gone instead of the time must leave this share of the error on data left
out: then those of the time only stand for them, and are left out. That comes to pass on 12 of 36 logs of
plants that forget so (benchmarks/foreign_plants.py, seeds 1 to 3), and new moves err by 0.57 to 0.77 of what
they did; with 1.0 on three more. Plants with memories of the time left 1.04 and more.
"""

TIME_CONSTANT_RATIO = 3.0  # with 6 a log of creep alone was followed four times worse, with 2 by 7 % worse
LONGEST_MEMORY = 0.5
"""Of the longest log, wherever the ratio leads: creep over minutes, seen through 15 s at 5 kHz, was followed
to 0.005 um instead of 0.007 so (0.9 and 0.45 of the error at 2.5 to 5 kHz); a whole log was worth no more."""

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
    longest = max(float(log.seconds[-1]) for log in prepared.logs if log.seconds is not None) * LONGEST_MEMORY
    count = max(int(np.log(longest / period) / np.log(TIME_CONSTANT_RATIO)), 0)
    grid = [*(period * TIME_CONSTANT_RATIO**k for k in range(count)), longest]
    fast = [tau for tau in grid if tau <= slowest_lag(cycle)]
    return (*fast, *_moving_slowly(prepared, tuple(grid[len(fast) :]), cycle))


def slowest_lag(cycle: float | None) -> float:
    """Return the time constant in seconds from which a memory is creep: slower than a cycle turns."""
    return np.inf if cycle is None else cycle / (2.0 * np.pi)


def _moving_slowly(prepared: Prepared, taus: tuple[float, ...], cycle: float) -> list[float]:
    """Return the memories (by seconds) that, averaged over cycles and freed of drift, move noticeably."""
    moving = np.zeros(len(taus), bool)
    for log in prepared.logs if taus else ():
        if log.seconds is None:
            continue
        used = log.used
        drift = np.linalg.qr(log.drift[used])[0]
        memories = relaxed_drive((log.voltage - prepared.low) / prepared.span, log.seconds, taus)
        _, window, rows = np.unique(
            np.floor(log.seconds[used] / cycle), return_inverse=True, return_counts=True
        )
        for place in np.flatnonzero(~moving) if len(rows) >= 4 else ():
            memory = memories[used, place]
            means = np.bincount(window, memory - drift @ (drift.T @ memory)) / rows
            moving[place] = float(means.std()) > CREEP_EVIDENCE
    return [tau for tau, moves in zip(taus, moving, strict=True) if moves]


def choose(prepared: Prepared, orders: Orders, cycle: float | None) -> Choice:
    """Choose among all structures that the logs can tell apart; what the user fixed stays fixed.

    One list of rules for the slopes, segments of the asymmetry and memories is judged together on data left
    out, at each bend of the drive; then the lag is looked for, the list is judged again with it, now by the
    smoothness of the slopes too, and last come the gears.

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
    search = _Search(logs, orders, prepared.one_amplitude, grid, period, cycle)
    basis = Basis(slopes_wanted, prepared.low, prepared.high, split, grid, orders.delay or 0.0)
    if orders.delay is None and period is not None:
        basis = replace(basis, delay=search.evident_delay(basis))
    rule, clockwise = search.direction(basis)
    basis, structure = search.bend(basis, rule)
    basis, memories, interval = search.lag(basis, structure)
    rule = search.rule(basis, structure, memories)
    settled = replace(structure, slopes=rule, memories=memories[0])
    again = search.bend_again(basis, settled)
    if again != basis and basis.delay != orders.delay:
        again, _, interval = search.delayed(replace(again, delay=0.0), settled)
    basis = again
    basis, structure, score = search.gears(basis, rule, memories)
    if orders.time_constants is None and structure.memories and search.forgets(basis, structure, score):
        return choose(prepared, replace(orders, time_constants=()), cycle)
    return Choice(basis, structure, score, interval, clockwise)


class _Search:
    """The candidates of one identification, and what is known of them.

    Parameters
    ----------
    logs : the rows that structures are chosen on
    orders : what the user fixed
    one_amplitude : whether the logs go over one range only: then the simpler model is right more often
    grid : time constants in seconds
    period, cycle : sample period and duration of a cycle in seconds, None without a clock
    """

    def __init__(
        self,
        logs: Sequence[PreparedLog],
        orders: Orders,
        one_amplitude: bool,
        grid: tuple[float, ...],
        period: float | None,
        cycle: float | None,
    ) -> None:
        self._logs, self._orders, self._one = logs, orders, one_amplitude
        self._period, self._cycle = period, cycle
        self._all = tuple(range(len(grid)))
        if orders.segments is not None:
            self._segments: tuple[tuple[int, float], ...] = ((orders.segments, KNOT_SMOOTHNESS),)
        else:
            self._segments = SEGMENTS[: SEGMENTS_ONE_AMPLITUDE if one_amplitude else None]
        self._finest = self._segments[-1][0]
        self._indifference = ONE_AMPLITUDE_INDIFFERENCE if one_amplitude else ORDER_INDIFFERENCE
        self._gathered: dict[Basis, Statistics] = {}

    def _statistics(self, basis: Basis) -> Statistics:
        if basis not in self._gathered:
            self._gathered[basis] = gather(self._logs, basis, self._finest)
        return self._gathered[basis]

    def _memories(self) -> list[tuple[int, ...]]:
        """Return the choices of memories, simplest first; those that the user gave are not a choice."""
        return [self._all] if self._orders.time_constants is not None or not self._all else [(), self._all]

    def _listed(
        self,
        slopes: str,
        memories: Sequence[tuple[int, ...]],
        smoothness: Sequence[float] = (START_SMOOTHNESS,),
    ) -> list[Structure]:
        """Return the list of candidates, simplest first."""
        return [
            Structure(slopes, some, segments, weight, kinks)
            for segments, kinks in self._segments
            for some in memories
            for weight in smoothness
        ]

    def _best(
        self, basis: Basis, candidates: Sequence[Structure], indifference: float | None = None
    ) -> tuple[Structure, Score]:
        """Return the simplest candidate that is no worse than the best, and its error on data left out."""
        statistics = self._statistics(basis)
        indifference = self._indifference if indifference is None else indifference
        scores: list[Score] = []
        kept: list[Structure] = []
        least = np.inf
        for structure in candidates:
            # What is left out is predicted no better than what is fitted: most need not be left out at all.
            try:
                if fitted_rmse(statistics, structure) <= least * (1.0 + indifference):
                    scores.append(cross_validate(statistics, structure))
                    kept.append(structure)
                    least = min(least, scores[-1].rmse)
            except FitError:  # one candidate that cannot be solved is no reason to refuse the log
                if structure == candidates[-1] and not scores:
                    raise
        best = simplest_of(scores, indifference, max(indifference, MAX_STANDARD_ERROR))
        return kept[best], scores[best]

    def direction(self, basis: Basis) -> tuple[str, float]:
        """Return the rule for the slopes that the loop's sense asks for, and how much worse the other is.

        A loop whose output lags needs slopes that grow, one that leads slopes that fall. Memories and a delay
        make loops, too, at the logs' own frequency, so none take part.
        """
        statistics = self._statistics(basis)
        errors = {
            slopes: min(cross_validate(statistics, one).rmse for one in self._listed(slopes, [()]))
            for slopes in ("growing", "falling")
        }
        ratio = errors["growing"] / max(errors["falling"], np.finfo(float).tiny)
        return self._orders.slopes or ("growing" if ratio <= 1.0 else "falling"), ratio

    def rule(self, basis: Basis, structure: Structure, memories: Sequence[tuple[int, ...]]) -> str:
        """Return 'free' slopes where they are far better on cycles and on swings of a kind left out.

        Among the cycles of one amplitude, and of few, free slopes always win, and lose on another amplitude.
        """
        if self._orders.slopes is not None or self._one:
            return structure.slopes
        ruled, score = self._best(basis, self._listed(structure.slopes, memories))
        free, other = self._best(basis, self._listed("free", memories))
        if other.rmse >= FREE_GAIN * score.rmse or no_worse(score, other):
            return structure.slopes
        mine, groups = groups_left_out(self._logs, basis, ruled, score.rmse)
        its, _ = groups_left_out(self._logs, basis, free, other.rmse)
        return "free" if groups and its < FREE_GAIN * mine else structure.slopes

    def evident_delay(self, basis: Basis) -> float:
        """Delay in seconds that is seen at first sight, else 0: with it in the way, all is chosen wrong.

        (25 ms at 200 samples a second: 2 segments of asymmetry instead of 16, and 0.20 % of error for 0.03.)
        """
        structure = Structure("growing", self._all, *self._segments[-1][:1], START_SMOOTHNESS)
        assert self._period is not None and self._cycle is not None
        errors: dict[float, float] = {}
        for step in EVIDENT_DELAY_TRIALS:
            if step * self._period > LONGEST_DELAY * self._cycle:
                break
            statistics = gather(self._logs, replace(basis, delay=step * self._period), self._finest)
            errors[step] = fitted_rmse(statistics, structure)
            if errors[step] > min(errors.values()):
                break
        best = min(errors, key=lambda step: errors[step])
        return best * self._period if errors[best] < EVIDENT_DELAY_GAIN * errors[0.0] else 0.0

    def bend(self, basis: Basis, slopes: str) -> tuple[Basis, Structure]:
        """Asymmetry that acts on the drive, beyond the paper: taken where it clearly helps on data left out.

        The asymmetry after the gears bends both branches alike; what differs between rising and falling drive
        twice a cycle it cannot follow, and lag and loop width are found wrong in its place.
        """
        listed = self._listed(slopes, [self._memories()[0] if self._one else self._all])
        found = [(basis, *self._best(basis, listed))]
        if self._orders.segments is not None:
            return found[0][:2]
        needed = (1.0 - BEND_GAIN) * found[0][2].rmse
        trials = found[0][1], listed[-1]

        def error(bent: Basis) -> float:
            return min(fitted_rmse(self._statistics(bent), one) for one in trials)

        def attempt(bend: float) -> float:
            bent = replace(basis, bend=bend)
            if error(bent) <= needed:
                found.append((bent, *self._best(bent, listed)))
            return error(bent)

        for side in (-BEND_STEP, BEND_STEP):
            errors = [error(basis)]
            while len(errors) <= BEND_TRIALS and errors[-1] <= min(errors):
                errors.append(attempt(side * len(errors)))
        best = min(found, key=lambda item: item[2].rmse)
        if best[0].bend:
            for bend in (best[0].bend - BEND_STEP / 2.0, best[0].bend + BEND_STEP / 2.0):
                if abs(bend) < BEND_TRIALS * BEND_STEP:
                    attempt(bend)
            best = min(found, key=lambda item: item[2].rmse)
        return found[0][:2] if best[2].rmse > needed or no_worse(found[0][2], best[2]) else best[:2]

    def bend_again(self, basis: Basis, structure: Structure) -> Basis:
        """Return the bend, or one of its neighbours, that does best beside the lag."""
        if not basis.bend:
            return basis
        near = [replace(basis, bend=basis.bend + side * BEND_STEP / 2.0) for side in (0, -1, 1)]
        scores = [cross_validate(self._statistics(one), structure).rmse for one in near]
        return near[int(np.argmin(scores))]

    def lag(
        self, basis: Basis, structure: Structure
    ) -> tuple[Basis, list[tuple[int, ...]], tuple[float, float] | None]:
        """Delay and relaxation: none where the data left out do not ask for any, a delay alone before both.

        The delay is the middle of those that explain the logs no worse than the best one does. A log with one
        amplitude and one frequency hardly tells a delay from a lag or a wider loop; the middle bounds what
        that costs on the next recording.
        """
        if self._period is None or self._cycle is None:
            return basis, [()], None
        found = [
            (basis, replace(structure, memories=self._memories()[0]), None),
            *(self.delayed(basis, replace(structure, memories=some)) for some in self._memories()),
        ]
        if self._orders.delay is None and basis.delay > 0.0:
            basis, structure, interval = found[-1]
            return basis, [structure.memories], interval  # without any delay the fit was far worse
        scores = [cross_validate(self._statistics(one), other) for one, other, _ in found]
        best = simplest_of(scores)
        if self._one and best == len(found) - 1 > 1:
            short = simplest_of(scores[:-1])
            if no_worse(scores[short], scores[best], ONE_AMPLITUDE_MEMORY, ONE_AMPLITUDE_MEMORY):
                best = short
        return found[best][0], [found[best][1].memories], found[max(best, 1)][2]

    def delayed(
        self, basis: Basis, structure: Structure
    ) -> tuple[Basis, Structure, tuple[float, float] | None]:
        """Return the basis with the delay that the logs ask for beside these memories, and its interval."""
        if self._orders.delay is not None:
            return basis, structure, None
        assert self._period is not None
        interval = _interval(self._delays(basis, structure))
        middle = round((interval[0] + interval[1]) / 2.0 / self._period * 4.0) / 4.0 * self._period
        return replace(basis, delay=middle), structure, interval

    def _delays(self, basis: Basis, structure: Structure) -> list[tuple[float, Floats, Floats]]:
        """Squared error by fold, and the folds' rows, of the fit with each delay (seconds) tried."""
        scanned: list[tuple[float, Floats, Floats]] = []
        assert self._period is not None and self._cycle is not None
        period = self._period

        def error(delay: float) -> float:
            statistics = self._statistics(replace(basis, delay=delay))
            by_fold = fitted_squares(statistics, structure)
            scanned.append((delay, by_fold, np.asarray(statistics.rows, dtype=float)))
            return float(by_fold.sum())

        tried: dict[float, float] = {}
        for step in DELAY_TRIALS:
            if step * period > LONGEST_DELAY * self._cycle:
                break
            tried[step] = error(step * period)
            if len(tried) > 4 and tried[step] > 1.5 * min(tried.values()):  # chosen: far beyond the least
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

    def gears(
        self, basis: Basis, slopes: str, memories: Sequence[tuple[int, ...]]
    ) -> tuple[Basis, Structure, Score]:
        """Smoothest slopes that are no worse, then how many of them, then finer gears where they show.

        Never fewer gears: they cost nothing per sample, and a turn inside a gear retraces it, an error that
        the logs do not show where they turn at few levels, on the gears' own edges perhaps (128 gears looked
        as good as 1024 on two amplitudes of a tendon: 0.18 % of error on new moves instead of 0.05).
        """
        structure, _ = self._best(
            basis, self._listed(slopes, memories), INDIFFERENCE if self._one else self._indifference
        )
        structure, score = self._smoothness(basis, structure)
        if self._orders.gears is not None:
            return basis, structure, score
        usable = sum(int(log.used.sum()) for log in self._logs)
        candidates = [(basis, score)]
        for count in SLOPE_CHOICES[1:]:
            if count * ROWS_PER_SLOPE <= usable:
                other = replace(basis, gears=count, split=ALL_GEARS // count)
                candidates.append((other, cross_validate(self._statistics(other), structure)))
        basis, score = candidates[simplest_of([one[1] for one in candidates], FINE_INDIFFERENCE)]
        finer = replace(basis, split=FINER_GEARS * basis.split)
        if not no_worse(score, cross_validate(self._statistics(finer), structure), FINER_INDIFFERENCE):
            return finer, *self._smoothness(finer, structure)
        return basis, structure, score

    def forgets(self, basis: Basis, structure: Structure, score: Score) -> bool:
        """Return whether memories of the way gone do far better on data left out than those of the time."""
        count = len(basis.time_constants)
        other = replace(structure, memories=tuple(range(count, count + len(LENGTHS))))
        try:
            way = cross_validate(self._statistics(replace(basis, lengths=LENGTHS)), other)
        except FitError:
            return False
        return bool(way.excess_over(score).mean() < np.log(FORGETTING_GAIN))

    def _smoothness(self, basis: Basis, structure: Structure) -> tuple[Structure, Score]:
        """Smoothest slopes that are no worse on data left out."""
        smoothed = [replace(structure, smoothness=smoothness) for smoothness in SMOOTHNESS_CHOICES]
        statistics = self._statistics(basis)
        scores = [cross_validate(statistics, one) for one in smoothed]
        best = simplest_of(scores, INDIFFERENCE if self._one else FINE_INDIFFERENCE)
        return smoothed[best], scores[best]


def _interval(scanned: list[tuple[float, Floats, Floats]]) -> tuple[float, float]:
    """Delays whose error is within one standard error (over folds) of the best one's."""
    scores = [(delay, Score(errors / rows, rows / rows.sum())) for delay, errors, rows in scanned]
    best = min(scores, key=lambda item: float(item[1].excess_over(scores[0][1]).mean()))[1]
    held = [delay for delay, score in scores if no_worse(score, best)]
    return min(held), max(held)


INDIFFERENCE = 0.02  # a gain in RMSE below this share is not worth a larger model, however certain

MAX_STANDARD_ERROR = 0.03  # of the RMSE: what one standard error can excuse at most


@dataclass(frozen=True)
class Score:
    """Cross-validated error of one candidate.

    ``mean_squares`` of each fold, shape (folds,), in the square of the normalised output; ``weights`` the
    folds' share of the rows.
    """

    mean_squares: Floats
    weights: Floats

    @property
    def rmse(self) -> float:
        """Root of the mean square over all rows left out in turn."""
        return float(np.sqrt(self.weights @ self.mean_squares))

    def excess_over(self, other: Score) -> Floats:
        """Logarithm of the ratio of the root mean squares, fold by fold; shape (folds,).

        Ratios let a small loop count as much as a large one, and a short log as much as a long one's part.
        """
        tiny = np.finfo(float).tiny
        ratios: Floats = 0.5 * np.log((self.mean_squares + tiny) / (other.mean_squares + tiny))
        return ratios


def cross_validate(statistics: Statistics, structure: Structure) -> Score:
    """Leave out each fold in turn, fit the others, and measure the error on the fold left out."""
    _, states = statistics.minimum(structure)
    errors = [
        statistics.left_out(structure, fold, states) / max(rows, 1)
        for fold, rows in enumerate(statistics.rows)
    ]
    rows_of = np.asarray(statistics.rows, dtype=float)
    return Score(np.asarray(errors), rows_of / rows_of.sum())


def fitted_squares(statistics: Statistics, structure: Structure) -> Floats:
    """Sum of squared errors on each fold of a fit to all of them; shape (folds,)."""
    found, _ = statistics.minimum(structure)
    full = np.append(found, 1.0)
    return np.array([max(quadratic(one, full), 0.0) for one in statistics.signed(structure)[1]])


def fitted_rmse(statistics: Statistics, structure: Structure) -> float:
    """RMS error over all rows of a fit to all of them."""
    return float(np.sqrt(fitted_squares(statistics, structure).sum() / sum(statistics.rows)))


def no_worse(
    candidate: Score,
    best: Score,
    indifference: float = INDIFFERENCE,
    max_standard_error: float = MAX_STANDARD_ERROR,
) -> bool:
    """Whether ``candidate`` is within one standard error, or within the indifference, of ``best``.

    The standard error is that of the paired ratios between folds, which have most of their scatter in
    common. With few or uneven folds it says little, so it excuses a loss only up to ``max_standard_error``.
    """
    excess = candidate.excess_over(best)
    mean = float(excess.mean())
    error = float(excess.std()) / np.sqrt(max(len(excess) - 1, 1))
    return bool(mean <= max(min(error, max_standard_error), float(np.log1p(indifference))))


def simplest_of(
    scores: Sequence[Score],
    indifference: float = INDIFFERENCE,
    max_standard_error: float = MAX_STANDARD_ERROR,
) -> int:
    """Index of the first (simplest first) candidate that is no worse than the best of all."""
    best = min(scores, key=lambda score: float(score.excess_over(scores[0]).mean()))
    return next(
        k for k, score in enumerate(scores) if no_worse(score, best, indifference, max_standard_error)
    )
