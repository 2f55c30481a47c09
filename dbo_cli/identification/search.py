"""A short list of structures, then neighbours of the best."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.identification.basis import SPARE_BEYOND, Cells, Structure, plays_at_start
from dbo_cli.identification.cross_validation import (
    DRIFT_PRICE,
    cross_validate,
    least_score,
)
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Options
from dbo_cli.identification.solve import Solution

RULES = ("growing", "falling")  # for the slopes
CURVES = (np.inf, 1e1, 1e-1, 1e-4)
SLOPE_SMOOTHNESS = (2e-1, 2e-4, 1e-8)  # the last for springs that slip at a few forces
SMOOTHER = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Of one amplitude, tried in turn: beyond, creep hides what smoothness costs."""
ONE_AMPLITUDE_CURVE = 1e-1
AS_GOOD = 1.2  # of the roughest one's error: so much may smoothness cost
BENDS = (-0.25, -0.12, 0.12, 0.25)
DELAYS = (0.003, 0.01, 0.03, 0.08)  # of a swing
REFINED = (0.6, 0.8, 1.25, 1.6)
"""Times the best delay, tried in turn."""
LEVELS = (None, 0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the range: where memories may have stood before the logs, beside the first value."""
BEGUN_LEVELS = (None, 0.0, 0.5, 1.0)
"""Of these, tried with each start: logs of a decay on an actuator that creeps need them."""
SETTLED_START = "settled"
BEGUN_STARTS = (SETTLED_START, "empty", "full", "below", "above")
"""The last two where the gears go on beyond the range."""
BETTER_START = 0.8
"""Of the settled start's error: the search begins with another one."""
ROUGHEST = Structure(smooth_slopes=2e-4, smooth_curve=1e-4)
"""Tells starts apart, with each rule for the slopes: free ones follow a log from any start."""
FINER_LEVEL = 0.125  # beside the best one, tried below and above
ROUNDS = (2, 1)  # of neighbours: of how many kinds of structures
HOPELESS = 0.5  # of the score: a fit that is worse at best weighs nothing
FEWEST_SWINGS = 4  # with fewer neither bend nor drift can be told from the loop
ONE_WAY = 2  # swings, up and down once: a curve cannot be told from the loop, either
SLOWEST = 3.0  # swings: the slowest memory that a log of one amplitude can tell
OTHER_SMOOTHNESS = (0.01, 0.1, 10.0, 100.0)  # of candidates that logs cannot judge
OTHER_BENDS = (-0.25, 0.25)  # the same


@dataclass
class Choices:
    """What is offered to the search, beside a structure that it begins with."""

    slopes: tuple[str, ...] = RULES
    memories: tuple[str, ...] = ("", "t", "tr")
    smoothness: tuple[float, ...] = SLOPE_SMOOTHNESS
    curves: tuple[float, ...] = CURVES
    bends: tuple[float, ...] = BENDS
    drift: bool = False
    delays: tuple[float, ...] = DELAYS
    base: Structure = field(default_factory=Structure)


def choices_for(problem: Problem, options: Options) -> tuple[Problem, Choices]:
    """Return what a log can tell, and the problem without memories that it cannot."""
    choices = Choices()
    if problem.clock:
        swings = min(len(log.swings.sizes) for log in problem.logs)
        choices.drift = swings >= FEWEST_SWINGS
    if problem.swing_count < FEWEST_SWINGS:
        choices.bends = ()
    if problem.swing_count <= ONE_WAY:
        choices.curves = CURVES[:1]
    if problem.one_amplitude:
        _take_one_amplitude(problem, choices)
        fast = problem.taus[problem.taus < SLOWEST * problem.swing]
        problem = replace(problem, taus=fast)
    if not len(problem.taus):
        choices.memories = ("",)
    _take_options(choices, options)
    if problem.past.size:
        choices.base = _begun(problem, choices)
    if choices.base.start in ("below", "above"):
        problem = replace(problem, cells=Cells.of(spare=SPARE_BEYOND))
    return problem, choices


def _begun(problem: Problem, choices: Choices) -> Structure:
    """Return the structure of the start of gears and memories from which all rows are followed best.

    They are compared by a rough structure; a level costs what it costs in a score, and is
    tried where there are enough swings to tell it from the loop. Settled gears and memories
    stay where nothing is clearly better.
    """
    starts: dict[bytes, str] = {}  # those that differ
    for start in BEGUN_STARTS if problem.cells.spare else BEGUN_STARTS[:3]:
        firsts, reach = [log.drive[0] for log in problem.logs], problem.cells.reach
        plays = [plays_at_start(float(first), reach, start) for first in firsts]
        starts.setdefault(np.concatenate(plays).tobytes(), start)
    levels = BEGUN_LEVELS if choices.drift and len(problem.taus) else LEVELS[:1]
    errors: dict[Structure, float] = {}
    for start, level in product(starts.values(), levels):
        base = replace(choices.base, start=start, level=level)
        rough = replace(ROUGHEST, start=start, level=level)
        trials = [replace(rough, slopes=rule) for rule in RULES]
        fits = [problem.equations(trial).solve() for trial in trials]
        price = math.exp(DRIFT_PRICE * (level is not None))
        errors[base] = price * min(fit.rmse for fit in fits)
    best = min(errors, key=lambda base: errors[base])
    is_better = errors[best] < BETTER_START * errors[choices.base]
    return best if is_better else choices.base


def _take_one_amplitude(problem: Problem, choices: Choices) -> None:
    """Leave what logs of one amplitude can tell: what cannot be left out cannot be judged.

    Slopes as smooth as can be, in the loop's sense, and beside them no curve, or one as
    rough as can be, since loop and curve are fitted by one another; and no memory slower
    than three swings: where the level stays, that is one with a moving zero.
    """
    errors = {rule: _error_of(problem, rule, SMOOTHER[0]) for rule in RULES}
    rule = min(errors, key=lambda rule: errors[rule])
    for smooth in SMOOTHER:
        if _error_of(problem, rule, smooth) <= AS_GOOD * errors[rule]:
            choices.smoothness = (smooth,)
    choices.slopes = (rule,)
    choices.memories = ("", "t")
    choices.curves = choices.curves[:1] + choices.curves[1:][-1:]


def _error_of(problem: Problem, rule: str, smooth: float) -> float:
    """Return what slopes of a smoothness leave of the logs beside a smooth curve."""
    structure = Structure(rule, "", smooth, ONE_AMPLITUDE_CURVE)
    return problem.equations(structure).solve().rmse


def _take_options(choices: Choices, options: Options) -> None:
    """Leave what the user left."""
    if options.slopes != "auto":
        choices.slopes = (options.slopes,)
    if options.delay != "auto":
        choices.delays = ()
        choices.base = replace(choices.base, delay=options.delay)
    if options.taus:
        choices.memories = ("t", "tr")
    if options.points != "auto":
        choices.bends = ()
        choices.curves = CURVES[:1]
        if options.points > 1:
            choices.curves = CURVES[1:]
            choices.base = replace(choices.base, segments=options.points)


def likelihood(fit: Solution, smallest: float, swings: int) -> float:
    """Return the likelihood of a Gaussian error of one size a swing, over that of the smallest one."""
    return float(min(smallest / max(fit.rmse, 1e-300), 1.0) ** swings)


def with_curves(structure: Structure, curves: Iterable[float]) -> list[Structure]:
    """Return a structure with curves of some smoothness."""
    return [replace(structure, smooth_curve=smooth) for smooth in curves]


class Search:
    """The fits of one identification, all judged."""

    def __init__(self, problem: Problem, choices: Choices) -> None:
        self.problem, self.choices = problem, choices
        self.fits: list[Solution] = []
        self.tried: set[Structure] = set()

    def run(self) -> list[Solution]:
        """Return all fits, the best first.

        Raises
        ------
        FitError
            No structure can be fitted.
        """
        choices = self.choices
        kinds = product(choices.memories, choices.slopes, choices.smoothness)
        for memories, slopes, smooth in kinds:
            kind = replace(choices.base, memories=memories, slopes=slopes)
            kind = replace(kind, smooth_slopes=smooth)
            self.fit(with_curves(kind, choices.curves))
        if not self.fits:
            raise FitError("no model can be fitted to the logs; leave out bad rows")
        for count in ROUNDS:
            for fit in self._best_kinds()[:count]:
                for neighbour in self._neighbours(fit.structure):
                    self.fit([neighbour])
            self._refine()
        return sorted(self.fits, key=lambda fit: fit.score)

    def fit(self, structures: Iterable[Structure]) -> None:
        """Fit and judge those of some structures that were not tried, each begun at the one before."""
        first = None
        for structure in structures:
            if structure in self.tried:
                continue
            self.tried.add(structure)
            equations = self.problem.equations(structure)
            best = min((fit.score for fit in self.fits), default=np.inf)
            try:
                first = equations.solve(first)
                if least_score(self.problem, first) > best + HOPELESS:
                    continue
                judged = cross_validate(self.problem, first, equations)
            except FitError:
                continue
            if np.isfinite(judged.score):
                self.fits.append(judged)

    def unjudged(self, best: Solution) -> list[Solution]:
        """Return weighed fits of structures that the logs cannot tell from the best one.

        They explain the logs nearly alike, and differ where these show nothing: in smaller
        loops, for one. The weight is the likelihood.
        """
        structure, problem = best.structure, self.problem
        straight = np.isinf(structure.smooth_curve)
        trials = [replace(structure, slopes=rule) for rule in RULES]
        for factor in OTHER_SMOOTHNESS:
            smooth = factor * structure.smooth_slopes
            trials.append(replace(structure, smooth_slopes=smooth))
        for bend in OTHER_BENDS:
            trials.append(replace(structure, bend=structure.bend + bend))
        curve = ONE_AMPLITUDE_CURVE if straight else np.inf
        trials.append(replace(structure, smooth_curve=curve))
        if len(problem.taus):
            other = "" if structure.memories else "t"
            trials.append(replace(structure, memories=other))
        if problem.past.size:
            trials.append(replace(structure, past=not structure.past))
        fits = []
        for trial in dict.fromkeys(trials):
            fit = problem.equations(trial).solve()
            weight = likelihood(fit, best.rmse, problem.different_swings)
            fits.append(replace(fit, weight=weight))
        return fits

    def _best_kinds(self) -> list[Solution]:
        """Return the best fit of each of the best kinds of slopes and memories."""
        best: dict[tuple[str, str, bool], Solution] = {}
        for fit in sorted(self.fits, key=lambda fit: fit.score):
            kind = fit.structure
            best.setdefault((kind.slopes, kind.memories, kind.past), fit)
        return list(best.values())

    def _neighbours(self, structure: Structure) -> list[Structure]:
        """Return what differs from a structure in one thing."""
        choices = self.choices
        trials = [replace(structure, bend=bend) for bend in (0.0, *choices.bends)]
        trials += with_curves(structure, choices.curves)
        if choices.drift:
            trials.append(replace(structure, drift=not structure.drift))
        trials += self._pasts(structure)
        if self.problem.clock:
            dt, swing = self.problem.dt, self.problem.swing
            for fraction in choices.delays:
                steps = max(round(swing * fraction / dt), 1)
                trials.append(replace(structure, delay=steps * dt))
        return trials

    def _pasts(self, structure: Structure) -> list[Structure]:
        """Return a structure with each past of the gears, known or not, and of memories at each level."""
        pasts = [(False, SETTLED_START)]
        if self.problem.past.size:
            pasts += [(True, SETTLED_START), (False, self.choices.base.start)]
        levels = LEVELS if structure.memories and self.problem.clock else LEVELS[:1]
        return [
            replace(structure, past=past, start=start, level=level)
            for (past, start), level in product(pasts, levels)
        ]

    def _refine(self) -> None:
        """Fit delays beside the best one, and levels beside the best fit's."""
        for factor in REFINED:
            delayed = [fit for fit in self.fits if fit.structure.delay > 0.0]
            if delayed and self.choices.delays:
                best = min(delayed, key=lambda fit: fit.score).structure
                self.fit([replace(best, delay=best.delay * factor)])
        for step in (-FINER_LEVEL, FINER_LEVEL):
            best = min(self.fits, key=lambda fit: fit.score).structure
            if best.level is not None:
                self.fit([replace(best, level=best.level + step)])
