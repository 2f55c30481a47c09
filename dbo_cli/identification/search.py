"""A short list of structures, then neighbours of the best."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.identification.basis import SEGMENTS, Structure
from dbo_cli.identification.judge import judge, least_score
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Options
from dbo_cli.identification.solve import Equations, Fit, solve

CURVES = (np.inf, 1e-1, 1e-4, 1e-7)
SLOPE_SMOOTHNESS = (2e-1, 2e-4)
CORNERS = 1e-8  # of slopes that only grow or fall: springs slip at a few forces
ONE_AMPLITUDE_SMOOTHNESS = 1e5  # times what a first fit leaves of the output's variance
BENDS = (-0.4, -0.25, -0.12, 0.12, 0.25, 0.4)
DRIFTS = (1, 3)
DELAYS = (0.003, 0.01, 0.03, 0.08)  # of a swing
COARSE_DELAYS = ((0.6, 0.8, 1.25, 1.6), (0.9, 1.1))
FINE_DELAYS = ((0.95, 1.05), (0.98, 1.02))
HOPELESS = 1.0  # of the score: a fit that is worse at best weighs nothing
WITHIN_REACH = 0.7  # of the score: worse delays are not refined
FEWEST_SWINGS = 4  # with fewer a bend cannot be told from the loop
ONE_WAY = 2  # swings, up and down once: a curve cannot be told from the loop, either
SWINGS_FOR_DRIFT = 4  # of each log, for each order
SLOWEST = 3.0  # swings: the slowest memory that a log of one amplitude can tell
OTHER_SMOOTHNESS = (0.01, 0.1, 1.0, 10.0, 100.0)  # of the candidates of one amplitude
REFINED = 2  # kinds of structures whose neighbours are tried


@dataclass(frozen=True)
class Choices:
    """What is offered to the search."""

    slopes: tuple[str, ...] = ("growing", "falling", "free")
    memories: tuple[str, ...] = ("", "t", "tr")
    smoothness: tuple[float, ...] = SLOPE_SMOOTHNESS
    curves: tuple[float, ...] = CURVES
    bends: tuple[float, ...] = BENDS
    drifts: tuple[int, ...] = DRIFTS
    corners: bool = True
    segments: int = SEGMENTS
    delay: float | None = None


def choices_for(problem: Problem, options: Options) -> tuple[Problem, Choices]:
    """Return what a log can tell, and the problem without memories that it cannot."""
    choices = Choices(drifts=_drifts(problem))
    if problem.swings < FEWEST_SWINGS:
        choices = replace(choices, bends=())
    if problem.swings <= ONE_WAY:
        choices = replace(choices, curves=CURVES[:1])
    if problem.one_amplitude:
        problem, choices = _for_one_amplitude(problem, choices)
    elif problem.smaller_swings == 1:
        choices = replace(choices, slopes=("growing", "falling"))
    if not len(problem.taus):
        choices = replace(choices, memories=("",))
    return problem, _fixed(choices, options)


def _drifts(problem: Problem) -> tuple[int, ...]:
    """Return the orders of a drift that the logs can tell from anything else."""
    if not problem.clock:
        return ()
    swings = problem.swings_of_log
    return tuple(order for order in DRIFTS if swings >= SWINGS_FOR_DRIFT * order)


def _for_one_amplitude(problem: Problem, choices: Choices) -> tuple[Problem, Choices]:
    """Return what logs of one amplitude can tell: what cannot be left out cannot be judged.

    Slopes as smooth as can be, in the loop's sense, and no memory slower than three
    swings: where the level stays, that is one with a moving zero.
    """
    rules = ("growing", "falling")
    errors = []
    for rule in rules:
        trial = Structure(rule, "", SLOPE_SMOOTHNESS[0], 1e-1)
        errors.append(solve(problem.rows(trial), trial).rmse)
    smooth = ONE_AMPLITUDE_SMOOTHNESS * min(errors) ** 2 / float(np.var(problem.output))
    problem = problem.without_memories_from(SLOWEST * problem.swing)
    choices = replace(
        choices,
        slopes=(rules[int(np.argmin(errors))],),
        memories=("", "t"),
        smoothness=(smooth,),
        corners=False,
        curves=CURVES[:3],
        drifts=choices.drifts[:1],
    )
    return problem, choices


def _fixed(choices: Choices, options: Options) -> Choices:
    """Return the choices that the user left."""
    if options.slopes != "auto":
        choices = replace(choices, slopes=(options.slopes,))
    if options.delay != "auto":
        choices = replace(choices, delay=options.delay)
    if options.taus:
        some = tuple(kind for kind in choices.memories if kind) or ("t",)
        choices = replace(choices, memories=some)
    if options.points == "auto":
        return choices
    choices = replace(choices, bends=())
    if options.points <= 1:
        return replace(choices, curves=choices.curves[:1])
    return replace(choices, curves=choices.curves[1:], segments=options.points)


class Search:
    """The fits of one identification, all judged."""

    def __init__(self, problem: Problem, choices: Choices) -> None:
        self.problem, self.choices = problem, choices
        self.fits: list[Fit] = []
        self.best = np.inf

    def run(self) -> list[Fit]:
        """Return all fits."""
        choices = self.choices
        for memories in choices.memories:
            for slopes in choices.slopes:
                for smooth in self._smoothness(slopes):
                    base = Structure(
                        slopes, memories, smooth, delay=choices.delay or 0.0
                    )
                    base = replace(base, segments=choices.segments)
                    self._path(base, choices.curves)
        for kinds, factors in ((REFINED, COARSE_DELAYS), (1, FINE_DELAYS)):
            for fit in self._best_kinds()[:kinds]:
                self._neighbours(fit)
            for some in factors:
                self._finer_delay(some)
        return self.fits

    def _smoothness(self, slopes: str) -> tuple[float, ...]:
        """Return the smoothness of slopes that are tried; steps of one sign are few by themselves."""
        if self.choices.corners and slopes != "free":
            return (*self.choices.smoothness, CORNERS)
        return self.choices.smoothness

    def _path(self, base: Structure, curves: Iterable[float]) -> None:
        """Fit a structure with rougher and rougher curves, each begun at the one before."""
        first = None
        for smooth in curves:
            structure = replace(base, smooth_curve=smooth)
            equations = Equations(self.problem.rows(structure), structure)
            try:
                first = equations.solve(first)
            except FitError:
                continue
            if least_score(self.problem, first) > self.best + HOPELESS:
                continue
            judged = judge(self.problem, first, equations)
            if judged.left:
                self.best = min(self.best, judged.score)
                self.fits.append(judged)

    def as_smooth(self, best: Fit) -> list[Fit]:
        """Return fits of a structure with other smoothness of the slopes.

        Of one amplitude they explain the logs alike, and differ where the logs show
        nothing: in smaller loops.
        """
        fits = []
        for factor in OTHER_SMOOTHNESS:
            smooth = factor * best.structure.smooth_slopes
            structure = replace(best.structure, smooth_slopes=smooth)
            fits.append(solve(self.problem.rows(structure), structure))
        return fits

    def _best_kinds(self) -> Sequence[Fit]:
        """Return the best fit of each of the best kinds of slopes and memories."""
        best: dict[tuple[str, str], Fit] = {}
        for fit in sorted(self.fits, key=lambda fit: fit.score):
            best.setdefault((fit.structure.slopes, fit.structure.memories), fit)
        return list(best.values())

    def _neighbours(self, fit: Fit) -> None:
        """Fit what differs from a good fit in one thing."""
        structure, choices = fit.structure, self.choices
        curves = [structure.smooth_curve]
        if np.isfinite(structure.smooth_curve):
            curves.insert(0, min(structure.smooth_curve * 100.0, 1e9))
        trials = [replace(structure, bend=bend) for bend in (0.0, *choices.bends)]
        trials += [replace(structure, drift=order) for order in (0, *choices.drifts)]
        for trial in trials:
            if trial != structure:
                self._path(trial, curves)
        if choices.delay is None and self.problem.clock:
            for delay in self._delays():
                self._path(replace(structure, delay=delay), curves)

    def _delays(self) -> list[float]:
        """Return the delays tried first, in seconds: whole steps."""
        dt, swing = self.problem.dt, self.problem.swing
        steps = {max(round(swing * part / dt), 1) for part in DELAYS}
        return [step * dt for step in sorted(steps)]

    def _finer_delay(self, factors: Sequence[float]) -> None:
        """Try delays around the best one."""
        if self.choices.delay is not None or not self.problem.clock:
            return
        late = [fit for fit in self.fits if fit.structure.delay > 0.0]
        best = min(late, key=lambda fit: fit.score, default=None)
        if (
            best is None
            or best.score > min(fit.score for fit in self.fits) + WITHIN_REACH
        ):
            return
        for factor in factors:
            delay = best.structure.delay * factor
            self._path(
                replace(best.structure, delay=delay), [best.structure.smooth_curve]
            )
