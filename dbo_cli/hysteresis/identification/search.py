"""The search for a structure: one list of candidates, each judged on data left out."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.cleaning import LONGEST_DELAY
from dbo_cli.hysteresis.identification.normal_equations import (
    KNOT_SMOOTHNESS,
    Structure,
)
from dbo_cli.hysteresis.identification.preparation import (
    LEVEL_MOVES,
    LONGEST_MEMORY,
    TRIAL_SMOOTHNESS,
    Prepared,
)
from dbo_cli.hysteresis.identification.recordings import IdentificationOptions
from dbo_cli.hysteresis.identification.statistics import (
    ALL_GEARS,
    EARNED,
    INDIFFERENCE,
    LENGTHS,
    SLOPE_CHOICES,
    TIME_CONSTANT_RATIO,
    Basis,
    PreparedLog,
    Score,
    Statistics,
    cross_validate,
    fewer_rows,
    fitted_rmse,
    fitted_squares,
    gather,
    groupings,
    groups_left_out,
    no_worse,
    relaxed_drive,
    simplest_of,
    swings_of,
    usual_basis,
)

FINER_GEARS = 4
"""Times as many gears are tried, and taken where they surely lower the error on data left out. Measured:
docs/choices.md.
"""
ROWS_PER_SLOPE = 8  # fewer usable rows than this for each unknown slope is not safe
SEGMENTS = (
    *((count, KNOT_SMOOTHNESS) for count in (1, 2, 4, 8, 16)), (16, 1e-7), (32, 1e-7), (32, 1e-8), (32, 1e-9)
)  # fmt: skip
"""Segments and smoothness of the asymmetry, simplest first. A log of one amplitude may not choose from the
rougher ones: loop and asymmetry then stand in for each other. Measured:
docs/choices.md.
"""

FINE_INDIFFERENCE = 0.005
"""The same where the logs hold several amplitudes and can tell. Measured: docs/choices.md."""
SMOOTHNESS_CHOICES = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-14, 1e-16)
"""Smoothness of the slopes, from the smoothest on; the roughest serve springs that slip at a few forces.
Measured: docs/choices.md.
"""
# of the range, refined by half: 0.05 and 0.2 changed one of eight logs, by 5 %
BEND_STEP = 0.1
BEND_TRIALS = 4
"""Steps to either side, outwards while the fit gets better. Measured: docs/choices.md."""
SPEEDS_APART = 1.5
"""Times the speed of the slower swings: less, and time and way are one, so that no log tells them apart.
Measured: docs/choices.md.
"""

FINEST_DELAY_STEP = 0.25  # of a sample: what a fit to noisy cycles can tell
# sample periods
DELAY_TRIALS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
FEWEST_DELAYS = 4  # tried before the trials may end
FEWEST_WINDOWS = 4  # of a cycle each: fewer means tell nothing of how a level moves
FAR_BEYOND = 1.5  # times the least squared error; chosen


@dataclass(frozen=True)
class Choice:
    """What the search settled on.

    ``score`` is the cross-validated error of the choice; ``delay_interval`` (seconds)
    holds the delays with which the fit is no worse, fold by fold; ``clockwise`` how
    much worse growing slopes do than falling ones.
    """

    basis: Basis
    structure: Structure
    score: Score
    delay_interval: tuple[float, float] | None
    clockwise: float


def sample_period(logs: Sequence[PreparedLog]) -> float | None:
    """Median time between samples in seconds, None where a log has no clock."""
    clocks = [log.seconds for log in logs if log.seconds is not None]
    if len(clocks) < len(logs):
        return None
    steps = np.concatenate([np.diff(clock) for clock in clocks])
    moving = steps[steps > 0.0]
    return float(np.median(moving)) if len(moving) else None


def time_constant_grid(
    prepared: Prepared, period: float, cycle: float
) -> tuple[float, ...]:
    """Time constants in seconds, from the sample period to the longest that the logs can tell from drift.

    A memory much slower than a cycle only shows where the drive's mean level moves:
    with one level and one frequency it is confounded with the loop's width and the
    offset, and such a model predicts nonsense as soon as the level changes. Slow
    memories are therefore offered only where they move by a stated share of the range
    once drift is taken off.
    """
    lengths = [
        float(log.seconds[-1]) for log in prepared.logs if log.seconds is not None
    ]
    longest = max(lengths) * LONGEST_MEMORY
    count = max(int(np.log(longest / period) / np.log(TIME_CONSTANT_RATIO)), 0)
    grid = [*(period * TIME_CONSTANT_RATIO**k for k in range(count)), longest]
    fast = [tau for tau in grid if tau <= slowest_lag(cycle)]
    return (*fast, *_moving_slowly(prepared, tuple(grid[len(fast) :]), cycle))


def slowest_lag(cycle: float | None) -> float:
    """Return the time constant in seconds from which a memory is creep: slower than a cycle turns."""
    return np.inf if cycle is None else cycle / (2.0 * np.pi)


def _moving_slowly(
    prepared: Prepared, taus: tuple[float, ...], cycle: float
) -> list[float]:
    """Return the memories (by seconds) that, averaged over cycles and freed of drift, move noticeably."""
    moving = np.zeros(len(taus), bool)
    if not taus:
        return []
    for log in prepared.logs:
        if log.seconds is None:
            continue
        used = log.used
        drift = np.linalg.qr(log.drift[used])[0]
        memories = relaxed_drive(
            (log.voltage - prepared.low) / prepared.span, log.seconds, taus
        )
        _, window, rows = np.unique(
            np.floor(log.seconds[used] / cycle), return_inverse=True, return_counts=True
        )
        if len(rows) < FEWEST_WINDOWS:
            continue
        for place in np.flatnonzero(~moving):
            memory = memories[used, place]
            means = np.bincount(window, memory - drift @ (drift.T @ memory)) / rows
            moving[place] = float(means.std()) > LEVEL_MOVES
    return [tau for tau, moves in zip(taus, moving, strict=True) if moves]


def choose(
    prepared: Prepared, options: IdentificationOptions, cycle: float | None
) -> Choice:
    """Choose among all structures that the logs can tell apart; what the user fixed stays fixed.

    One list of rules for the slopes, segments of the asymmetry and memories is judged
    together on data left out, at each bend of the drive; then the lag is looked for,
    the list is judged again with it, now by the smoothness of the slopes too, and last
    come the gears.

    Parameters
    ----------
    prepared : the logs
    options : what the user fixed
    cycle : median duration of a cycle in seconds, None without a clock
    """
    logs = fewer_rows(prepared.logs)
    period = sample_period(logs)
    grid: tuple[float, ...] = ()
    if period is not None and cycle is not None:
        if options.relaxation is None:
            grid = time_constant_grid(prepared, period, cycle)
        else:
            grid = tuple(options.relaxation)
    search = _Search(logs, options, prepared.one_amplitude, len(grid), period, cycle)
    basis = replace(
        usual_basis(prepared.low, prepared.high, grid), delay=options.delay or 0.0
    )
    if options.gears is not None:
        if options.gears <= 2 * basis.gears:
            basis = replace(basis, gears=options.gears, split=1)
        else:
            split = math.ceil(options.gears / basis.gears)
            basis = replace(basis, split=split)
    if options.delay is None and period is not None:
        basis = replace(basis, delay=search.evident_delay(basis))
    rule, clockwise = search.direction(basis)
    basis, structure = search.bend(basis, rule)
    basis, structure, interval = search.lag(basis, structure)
    structure = replace(structure, slopes=search.rule(basis, structure))
    again = search.bend_again(basis, structure)
    if again != basis and basis.delay != options.delay:
        again, interval = search.delayed(replace(again, delay=0.0), structure)
    basis, structure, score = search.gears(again, structure)
    if (
        options.relaxation is None
        and structure.memories
        and search.forgets(basis, structure, score)
    ):
        return choose(prepared, replace(options, relaxation=()), cycle)
    return Choice(basis, structure, score, interval, clockwise)


def swings_of_two_kinds(logs: Sequence[PreparedLog], basis: Basis) -> bool:
    """Return whether the smaller swings are of two amplitudes or two levels, so that one can be left out."""
    for name, grouped in groupings(logs, basis):
        labels = np.unique(np.concatenate([log.fold for log in grouped]))
        if name != "speeds" and np.count_nonzero(labels > 0) > 1:
            return True
    return False


class _Search:
    """The candidates of one identification, and what is known of them.

    Parameters
    ----------
    logs : the rows that structures are chosen on
    options : what the user fixed
    one_amplitude : whether the logs go over one range only: then the simpler model is
        right more often
    memories : the number of time constants
    period, cycle : sample period and duration of a cycle in seconds, None without a
        clock
    """

    def __init__(
        self,
        logs: Sequence[PreparedLog],
        options: IdentificationOptions,
        one_amplitude: bool,
        memories: int,
        period: float | None,
        cycle: float | None,
    ) -> None:
        self._logs, self._options, self._one = logs, options, one_amplitude
        self._period, self._cycle = period or 0.0, cycle
        self._all = tuple(range(memories))
        self._segments = SEGMENTS
        if one_amplitude:
            self._segments = tuple(
                step for step in SEGMENTS if step[1] == KNOT_SMOOTHNESS
            )
        if options.points is not None:
            self._segments = ((max(options.points, 1), KNOT_SMOOTHNESS),)
        self._finest = self._segments[-1][0]
        self._indifference = INDIFFERENCE if one_amplitude else FINE_INDIFFERENCE
        self._gathered: dict[Basis, Statistics] = {}

    def _statistics(self, basis: Basis) -> Statistics:
        if basis not in self._gathered:
            self._gathered[basis] = gather(self._logs, basis, self._finest)
        return self._gathered[basis]

    def _memories(self) -> list[tuple[int, ...]]:
        """Return the choices of memories, simplest first; those that the user gave are not a choice."""
        if self._options.relaxation is not None or not self._all:
            return [self._all]
        return [(), self._all]

    def _listed(
        self,
        slopes: str,
        memories: Sequence[tuple[int, ...]],
        smoothness: float = TRIAL_SMOOTHNESS,
    ) -> list[Structure]:
        """Return the list of candidates, simplest first."""
        structures = []
        for segments, kinks in self._segments:
            for some in memories:
                structure = Structure(slopes, some, segments, smoothness, kinks)
                structures.append(structure)
        return structures

    def _best(
        self, basis: Basis, candidates: Sequence[Structure]
    ) -> tuple[Structure, Score]:
        """Return the simplest candidate that is no worse than the best, and its error on data left out."""
        statistics = self._statistics(basis)
        judged: list[tuple[Structure, Score]] = []
        least = np.inf
        for structure in reversed(candidates):
            # What is left out is predicted no better than what is fitted: most need not
            # be left out at all.
            try:
                if fitted_rmse(statistics, structure) <= least * (1.0 + INDIFFERENCE):
                    judged.insert(0, (structure, cross_validate(statistics, structure)))
                    least = min(least, judged[0][1].rmse)
            except (
                FitError
            ):  # one candidate that cannot be solved is no reason to refuse the log
                if structure == candidates[0] and not judged:
                    raise
        return judged[simplest_of([score for _, score in judged], self._indifference)]

    def _least(self, basis: Basis, candidates: Sequence[Structure]) -> float:
        """Return the least error on data left out among candidates; infinite where none can be solved."""
        statistics = self._statistics(basis)
        least = np.inf
        for structure in reversed(candidates):
            with contextlib.suppress(FitError):
                if fitted_rmse(statistics, structure) <= least * (1.0 + INDIFFERENCE):
                    least = min(least, cross_validate(statistics, structure).rmse)
        return least

    def direction(self, basis: Basis) -> tuple[str, float]:
        """Return the rule for the slopes that the loop's sense asks for, and how much worse the other is.

        A loop whose output lags needs slopes that grow, one that leads slopes that
        fall. Memories and a delay make loops, too, at the logs' own frequency, so none
        take part.
        """
        errors = {
            slopes: self._least(basis, self._listed(slopes, [()]))
            for slopes in ("growing", "falling")
        }
        ratio = errors["growing"] / max(errors["falling"], np.finfo(float).tiny)
        return self._options.slopes or ("growing" if ratio <= 1.0 else "falling"), ratio

    def rule(self, basis: Basis, structure: Structure) -> str:
        """Return 'free' slopes where they are far better on cycles and on swings of a kind left out.

        Among the cycles of one amplitude, and of few, free slopes always win, and lose
        on another amplitude. So they do where the smaller swings are all of one kind:
        after two amplitudes from one end three of eleven plants took them, and erred by
        3.3, 6.3 and 10.8 % on new moves instead of 2.2, 1.0 and 9.8.
        """
        if self._options.slopes is not None or self._one:
            return structure.slopes
        if not swings_of_two_kinds(self._logs, basis):
            return structure.slopes
        ruled, score = self._best(
            basis, self._listed(structure.slopes, [structure.memories])
        )
        free, free_score = self._best(basis, self._listed("free", [structure.memories]))
        if free_score.rmse >= EARNED * score.rmse or no_worse(score, free_score):
            return structure.slopes
        groups_error, groups = groups_left_out(self._logs, basis, ruled, score.rmse)
        free_groups_error, _ = groups_left_out(self._logs, basis, free, free_score.rmse)
        if groups and free_groups_error < EARNED * groups_error:
            return "free"
        return structure.slopes

    def evident_delay(self, basis: Basis) -> float:
        """Delay in seconds that is seen at first sight, else 0: with it in the way, all is chosen wrong.

        (25 ms at 200 samples a second: 2 segments of asymmetry instead of 16, and 0.20
        % of error for 0.03.) A loop that leads turns around behind a delay, so slopes
        of both kinds are tried with each: springs that slip, behind a sensor late by 25
        samples, were taken for loops that lag (errors of 14 and 21 %). On one amplitude
        a wide loop is as well one that leads, late by a quarter of a cycle: there it
        lags.
        """
        rules = ("growing",) if self._one else ("growing", "falling")
        either = [
            Structure(slopes, self._all, self._finest, TRIAL_SMOOTHNESS)
            for slopes in rules
        ]
        errors: dict[float, float] = {}
        for step in self._steps_within(DELAY_TRIALS):
            late = self._late(basis, step)
            errors[step] = min(fitted_rmse(late, structure) for structure in either)
            if _far_beyond(errors[step], errors.values()):
                break
        best = min(errors, key=lambda step: errors[step])
        if errors[best] >= EARNED * errors[0.0]:
            return 0.0
        return best * self._period

    def _steps_within(self, samples: Sequence[float]) -> list[float]:
        """Return the delays, in samples, that are within a quarter of a cycle."""
        assert self._cycle is not None
        longest = LONGEST_DELAY * self._cycle
        return list(
            itertools.takewhile(lambda step: step * self._period <= longest, samples)
        )

    def _late(self, basis: Basis, samples: float) -> Statistics:
        return self._statistics(replace(basis, delay=samples * self._period))

    def bend(self, basis: Basis, slopes: str) -> tuple[Basis, Structure]:
        """Asymmetry that acts on the drive, beyond the paper: taken where it clearly helps on data left out.

        The asymmetry after the gears bends both branches alike; what differs between
        rising and falling drive twice a cycle it cannot follow, and lag and loop width
        are found wrong in its place.
        """
        memories = self._memories()[0] if self._one else self._all
        listed = self._listed(slopes, [memories])
        structure, score = self._best(basis, listed)
        if self._options.points is not None:
            return basis, structure
        bent, bent_structure, least = self._bent(basis, structure, score, listed)
        if least.rmse > EARNED * score.rmse or no_worse(score, least):
            return basis, structure
        return bent, bent_structure

    def _bent(
        self,
        basis: Basis,
        structure: Structure,
        score: Score,
        listed: Sequence[Structure],
    ) -> tuple[Basis, Structure, Score]:
        """Return the bend that does best on data left out, of those whose fit is clearly better than without.

        Steps lead to either side while the fit gets better, then half a step from the
        best; no bend where none of them fits so well. ``structure`` and ``score`` are
        those without a bend.
        """
        trials = structure, listed[-1]
        tried = [(basis, structure, score)]
        needed = EARNED * score.rmse

        def fit_error(bent: Basis) -> float:
            return min(fitted_rmse(self._statistics(bent), trial) for trial in trials)

        def attempt(bend: float) -> float:
            bent = replace(basis, bend=bend)
            error = fit_error(bent)
            if error <= needed:
                tried.append((bent, *self._best(bent, listed)))
            return error

        for side in (-BEND_STEP, BEND_STEP):
            errors = [fit_error(basis)]
            while len(errors) <= BEND_TRIALS and errors[-1] <= min(errors):
                errors.append(attempt(side * len(errors)))
        best = min(tried, key=lambda item: item[2].rmse)
        if not best[0].bend:
            return best
        for side in (-BEND_STEP, BEND_STEP):
            bend = best[0].bend + side / 2.0
            if abs(bend) < BEND_TRIALS * BEND_STEP:
                attempt(bend)
        return min(tried, key=lambda item: item[2].rmse)

    def bend_again(self, basis: Basis, structure: Structure) -> Basis:
        """Return the bend, or one of its neighbours, that does best beside the lag."""
        if not basis.bend:
            return basis
        near = []
        for side in (0, -1, 1):
            bend = basis.bend + side * BEND_STEP / 2.0
            near.append(replace(basis, bend=bend))
        scores = [self._score(bent, structure).rmse for bent in near]
        return near[int(np.argmin(scores))]

    def lag(
        self, basis: Basis, structure: Structure
    ) -> tuple[Basis, Structure, tuple[float, float] | None]:
        """Delay and relaxation: none where the data left out do not ask for any, a delay alone before both.

        The delay is the middle of those that explain the logs no worse than the best
        one does. A log with one amplitude and one frequency hardly tells a delay from a
        lag or a wider loop; the middle bounds what that costs on the next recording.
        """
        choices = [replace(structure, memories=some) for some in self._memories()]
        if self._cycle is None:
            return basis, choices[0], None
        tried: list[tuple[Basis, Structure, tuple[float, float] | None]] = []
        # else the fit without any delay was far worse
        if self._options.delay is not None or not basis.delay:
            tried.append((basis, choices[0], None))
        for choice in choices:
            late, interval = self.delayed(basis, choice)
            tried.append((late, choice, interval))
        scores = [self._score(late, choice) for late, choice, _ in tried]
        best = simplest_of(scores)
        if self._one and len(choices) > 1 and best == len(tried) - 1:
            # Memories make loops, too, at the logs' one frequency.
            short = simplest_of(scores[:-1])
            if not _earned(scores[best], scores[short]):
                best = short
        basis, structure, interval = tried[best]
        return basis, structure, interval or tried[-len(choices)][2]

    def delayed(
        self, basis: Basis, structure: Structure
    ) -> tuple[Basis, tuple[float, float] | None]:
        """Return the basis with the delay that the logs ask for beside these memories, and its interval."""
        if self._options.delay is not None:
            return basis, None
        interval = _interval(self._delays(basis, structure))
        finest = FINEST_DELAY_STEP * self._period
        middle = round((interval[0] + interval[1]) / 2.0 / finest) * finest
        return replace(basis, delay=middle), interval

    def _delays(self, basis: Basis, structure: Structure) -> dict[float, Score]:
        """Return the error by fold of the fit with each delay (seconds) tried."""
        tried: dict[float, Score] = {}

        def attempt(step: float) -> None:
            statistics = self._late(basis, step)
            tried[step] = Score.of(
                fitted_squares(statistics, structure), statistics.rows
            )

        for step in self._steps_within(DELAY_TRIALS):
            attempt(step)
            if _far_beyond(tried[step].rmse, [score.rmse for score in tried.values()]):
                break
        # halve the gaps beside the best until they are a quarter of a sample
        while True:
            best = min(tried, key=lambda step: tried[step].rmse)
            below = max((step for step in tried if step < best), default=best)
            above = min((step for step in tried if step > best), default=best)
            between = []
            for step in (below, above):
                if abs(step - best) > FINEST_DELAY_STEP:
                    between.append((best + step) / 2.0)
            if not between:
                return {step * self._period: score for step, score in tried.items()}
            for step in between:
                attempt(step)

    def gears(
        self, basis: Basis, structure: Structure
    ) -> tuple[Basis, Structure, Score]:
        """Smoothest slopes that are no worse, then how many of them, then finer gears where they show.

        Never fewer gears: they cost nothing per sample, and a turn inside a gear
        retraces it, an error that the logs do not show where they turn at few levels,
        on the gears' own edges perhaps (128 gears looked as good as 1024 on two
        amplitudes of a tendon: 0.18 % of error on new moves instead of 0.05).
        """
        listed = self._listed(structure.slopes, [structure.memories])
        structure, _ = self._best(basis, listed)
        structure, score = self._shaped(basis, structure)
        if self._options.gears is not None:
            return basis, structure, score
        usable = sum(int(log.used.sum()) for log in self._logs)
        candidates = [basis]
        for count in SLOPE_CHOICES[1:]:
            if count * ROWS_PER_SLOPE <= usable:
                candidates.append(replace(basis, gears=count, split=ALL_GEARS // count))
        scores = [self._score(candidate, structure) for candidate in candidates]
        best = simplest_of(scores, FINE_INDIFFERENCE)
        basis, score = candidates[best], scores[best]
        finer = replace(basis, split=FINER_GEARS * basis.split)
        if not no_worse(score, self._score(finer, structure), FINE_INDIFFERENCE):
            return finer, *self._shaped(finer, structure)
        return basis, structure, score

    def forgets(self, basis: Basis, structure: Structure, score: Score) -> bool:
        """Return whether memories of the way gone do far better on data left out than those of the time."""
        slow, fast = np.percentile(
            np.concatenate([swings_of(log, basis).speed for log in self._logs]),
            [10, 90],
        )
        if fast - slow < np.log(SPEEDS_APART):
            return False
        count = len(basis.time_constants)
        forgetful = replace(
            structure, memories=tuple(range(count, count + len(LENGTHS)))
        )
        by_way = self._score(replace(basis, lengths=LENGTHS), forgetful)
        return _earned(by_way, score)

    def _score(self, basis: Basis, structure: Structure) -> Score:
        """Return the error on data left out; without bound where the candidate cannot be solved."""
        statistics = self._statistics(basis)
        try:
            return cross_validate(statistics, structure)
        except (
            FitError
        ):  # one candidate that cannot be solved is no reason to refuse the log
            return Score.of(np.full(len(statistics.rows), np.inf), statistics.rows)

    def _shaped(self, basis: Basis, structure: Structure) -> tuple[Structure, Score]:
        """Smoothest slopes that are no worse on data left out, then the segments again, beside them.

        Beside slopes as smooth as in a trial, those of springs that slip, any segments
        look alike.
        """
        smoothed = [
            replace(structure, smoothness=smoothness)
            for smoothness in SMOOTHNESS_CHOICES
        ]
        best, _ = self._best(basis, smoothed)
        listed = self._listed(best.slopes, [best.memories], best.smoothness)
        return self._best(basis, listed)


def _earned(score: Score, other: Score) -> bool:
    """Return whether a candidate does so much better than another that a larger model is worth it."""
    return bool(score.excess_over(other).mean() < np.log(EARNED))


def _far_beyond(error: float, errors: Collection[float]) -> bool:
    """Return whether the last delay tried is so far off the best that no longer one is worth a trial."""
    return len(errors) > FEWEST_DELAYS and error**2 > FAR_BEYOND * min(errors) ** 2


def _interval(tried: dict[float, Score]) -> tuple[float, float]:
    """Delays whose error is within one standard error (over folds) of the best one's."""
    none = next(iter(tried.values()))
    best = min(tried.values(), key=lambda score: float(score.excess_over(none).mean()))
    as_good = [delay for delay, score in tried.items() if no_worse(score, best)]
    return min(as_good), max(as_good)
