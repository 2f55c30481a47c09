"""The last choice: candidates at their least error of the output, judged by it on parts left out.

The search (``search``) is convex and quick, and ranks by the equation error. What it
chose stands here beside simpler and other models: without its delay, without memories,
with other rules for the slopes, from gears alone to many segments. What it chose holds
unless another does better by more than the error bar; among those as good as the best
the simplest is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.linear_response import linear_response
from dbo_cli.hysteresis.identification.normal_equations import (
    KNOT_SMOOTHNESS,
    Structure,
)
from dbo_cli.hysteresis.identification.output_error import (
    TINY,
    Judged,
    LeftOut,
    OutputProblem,
    Refined,
    finer,
    judged_rows,
)
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Floats, IdentificationOptions
from dbo_cli.hysteresis.identification.search import Choice, swings_of_two_kinds
from dbo_cli.hysteresis.identification.statistics import (
    EARNED,
    INDIFFERENCE,
    Basis,
    PreparedLog,
    fewer_rows,
)

JUDGED_ROWS = 4000  # of the logs
# different slopes, at most; what is delivered begins with theirs and has all
JUDGED_GEARS = 64
# times the least RMS error among candidates of as many segments: more are not tried
OUT_OF_REACH = 1.5
SEGMENTS = ((1, KNOT_SMOOTHNESS), (2, KNOT_SMOOTHNESS), (4, KNOT_SMOOTHNESS), (8, KNOT_SMOOTHNESS),
            (16, KNOT_SMOOTHNESS), (32, 1e-7))  # fmt: skip
"""Segments and smoothness of the asymmetry; each begins where the one before ended."""
FAR_BETTER = 0.5
"""Of the model's error: a linear response that leaves less shows dynamics that no gears follow. A plant whose
spring has hysteresis leaves a third; a servo with a current limit 0.7, and is followed
well enough.
"""
SMOOTHNESS = (1e-6, 1e-8, 1e-10, 1e-12, 1e-16)  # of the slopes


@dataclass(frozen=True)
class Finalist:
    """What is delivered: basis, structure, and the unknowns from which the last refinement begins.

    ``beaten`` says in words what predicts parts left out better than all candidates do,
    and what the logs lack; empty where nothing does.
    """

    basis: Basis
    structure: Structure
    vector: Floats
    beaten: str = ""


def best_of(
    prepared: Prepared, choice: Choice, options: IdentificationOptions
) -> Finalist:
    """Return the candidate that predicts best what was left out; the simplest of those as good.

    Raises
    ------
    FitError
        No candidate can be solved.
    """
    return _Finalists(prepared, choice, options).best()


class _Finalists:
    """The candidates beside a choice, on some rows of the logs."""

    def __init__(
        self, prepared: Prepared, choice: Choice, options: IdentificationOptions
    ) -> None:
        self._full_logs: Sequence[PreparedLog] = prepared.logs
        self._logs: Sequence[PreparedLog] = fewer_rows(prepared.logs, JUDGED_ROWS)
        self._one_amplitude = prepared.one_amplitude
        self._gears = choice.basis.gears
        few = replace(choice.basis, gears=min(self._gears, JUDGED_GEARS))
        few = replace(few, split=choice.basis.gears * choice.basis.split // few.gears)
        if few.gears * few.split != choice.basis.gears * choice.basis.split:
            few = choice.basis  # a number of gears that the user fixed
        self._choice, self._options = replace(choice, basis=few), options
        self._problems: dict[Basis, OutputProblem] = {}
        self._alone: dict[tuple[Basis, Structure], Judged] = {}

    def _problem(self, basis: Basis) -> OutputProblem:
        if basis not in self._problems:
            self._problems[basis] = OutputProblem(judged_rows(self._logs, basis))
        return self._problems[basis]

    def best(self) -> Finalist:
        """Return the winner."""
        chosen = self._judged_choice()
        if self._at_noise(chosen):
            return self._finalist(chosen)
        refined: list[Refined] = []
        least_squares: dict[int, float] = {}
        basis = chosen.basis  # the delay has been judged
        for structure in self._starts(basis, least_squares):
            try:
                refined += self._within_reach(
                    self._chain(basis, structure), least_squares
                )
            except (
                FitError
            ):  # a candidate that cannot be solved is no reason to refuse the log
                continue
        # What is left out is predicted no better than what is fitted: most need not be
        # left out at all.
        refined.sort(key=lambda one: one.squares)
        judged = [chosen]
        least = chosen.score
        for candidate in refined:
            if (
                0.5 * np.log(candidate.squares / self._problem(basis).count + TINY)
                > least
            ):
                break
            try:
                one = self._problem(basis).judged(candidate)
            except FitError:
                continue
            judged.append(one)
            least = min(least, one.score)
        winner = self._no_worse_than_simpler(self._winner(judged))
        return self._finalist(winner, self._beaten(winner))

    def _finalist(self, winner: Judged, beaten: str = "") -> Finalist:
        """Return the winner with all the gears that were chosen."""
        parts = self._gears // winner.basis.gears
        basis = replace(
            winner.basis, gears=self._gears, split=winner.basis.split // parts
        )
        heights, rest = np.split(winner.candidate.vector, [winner.basis.gears])
        vector = np.concatenate((np.repeat(heights / parts, parts), rest))
        return Finalist(basis, winner.structure, vector, beaten)

    def _no_worse_than_simpler(self, winner: Judged) -> Judged:
        """Return the winner, or what is simpler and has a smaller error.

        That is: itself without its delay, and gears alone; where they predict what was
        left out surely better, or fit the logs better by more than ``INDIFFERENCE``.
        """
        for structure in self._simpler(winner):
            basis = replace(winner.basis, delay=self._options.delay or 0.0)
            if structure.segments == 1:
                basis = replace(basis, bend=0.0)
            if (basis, structure) == (winner.basis, winner.structure):
                continue
            try:
                simpler = self._judged(basis, structure)
            except FitError:
                continue
            much_better = simpler.least_score < winner.least_score - math.log1p(
                INDIFFERENCE
            )
            if much_better or winner.surely_beaten_by(simpler):
                winner = simpler
        return winner

    def _simpler(self, winner: Judged) -> Iterator[Structure]:
        """Yield the structures that are tried without a delay: the winner's, and gears alone."""
        yield winner.structure
        memories = (
            winner.structure.memories if self._options.relaxation is not None else ()
        )
        alone = replace(winner.structure, segments=1, memories=memories)
        if self._options.points in (None, 0, 1):
            yield replace(alone, knot_smoothness=KNOT_SMOOTHNESS)

    def _beaten(self, winner: Judged) -> str:
        """Return what predicts parts left out better than the winner, in words; empty where nothing does."""
        straight = replace(winner.basis, delay=0.0, bend=0.0)
        line = self._problem(straight).line()
        if winner.surely_beaten_by(line):
            return (
                "parts of the logs that were left out are predicted better by a straight line "
                f"({_percent(line)}) than by any model of this class, gears alone among them "
                f"({_percent(winner)})"
            )
        quarters = winner.errors.get("blocks")
        fixed = (self._options.dynamics, self._options.delay, self._options.relaxation)
        if quarters is None or any(value is not None for value in fixed):
            return ""  # how the model behaves in time was the user's choice
        ours = math.sqrt(quarters.mean_square)
        linear = linear_response(self._full_logs, FAR_BETTER * ours)
        if linear is None or math.sqrt(linear.mean_square) > FAR_BETTER * ours:
            return ""
        return (
            "quarters of the logs that were left out are predicted far better by a linear frequency response "
            f"({100.0 * math.sqrt(linear.mean_square):.3g} % of the range) than by gears "
            f"({100.0 * ours:.3g} %): what swings is not of this class"
        )

    def _reaches(self, basis: Basis, alone: Structure, least: dict[int, float]) -> bool:
        """Return whether gears alone, of a smoothness not yet chosen, are not far worse than the best."""
        problem = self._problem(basis)
        start = np.zeros(problem.rows.columns(1).total)
        squares = problem.refined(alone, start, steps=1).squares
        return squares <= OUT_OF_REACH**2 * least.get(1, np.inf)

    def _within_reach(
        self, chain: Iterator[Refined], least: dict[int, float]
    ) -> Iterator[Refined]:
        """Yield the candidates of a chain until one is far worse than others of as many segments.

        ``least`` holds the least sum of squares of each number of segments, and is
        brought up to date.
        """
        for refined in chain:
            yield refined
            segments = refined.structure.segments
            least[segments] = min(least.get(segments, np.inf), refined.squares)
            if refined.squares > OUT_OF_REACH**2 * least[segments]:
                return

    def _needed(self) -> float:
        """Return the share of the error by which another candidate has to do better."""
        return 1.0 / EARNED - 1.0 if self._one_amplitude else INDIFFERENCE

    def _at_noise(self, chosen: Judged) -> bool:
        """Return whether the choice leaves so little beyond white noise that none could do so much better."""
        noise = self._problem(chosen.basis).noise(chosen.candidate)
        return chosen.score - 0.5 * math.log(noise + TINY) <= math.log1p(self._needed())

    def _winner(self, judged: Sequence[Judged]) -> Judged:
        """Return the simplest candidate within the error bar of the best; the choice where it is as good.

        What cannot be left out cannot be judged: among the cycles of one amplitude the
        larger model always wins, so there another one has to earn its place.
        """
        chosen = judged[0]
        best = min(judged, key=lambda one: one.score)
        if not chosen.beaten_by(best, self._needed()):
            return chosen
        as_good = [one for one in judged if not one.beaten_by(best, 0.0)]
        return min(as_good, key=lambda one: (_complexity(one), one.score))

    def _judged_choice(self) -> Judged:
        """Return what the search chose, refined and judged; without its delay where that is as good."""
        basis, structure = self._choice.basis, self._choice.structure
        chosen = self._judged(basis, structure)
        if not basis.delay or self._options.delay is not None:
            return chosen
        try:
            prompt = self._judged(replace(basis, delay=0.0), structure)
        except FitError:
            return chosen
        return chosen if prompt.beaten_by(chosen, 0.0) else prompt

    def _judged(self, basis: Basis, structure: Structure) -> Judged:
        """Return one candidate, refined from gears alone and judged."""
        key = basis, structure
        if key not in self._alone:
            *_, last = self._chain(basis, structure, upto=structure)
            self._alone[key] = self._problem(basis).judged(last)
        return self._alone[key]

    def _starts(self, basis: Basis, least: dict[int, float]) -> Iterator[Structure]:
        """Yield gears alone of every chain of candidates that is within reach of the first one's."""
        every = tuple(range(len(basis.time_constants)))
        memories = (
            [every]
            if self._options.relaxation is not None or not every
            else [every, ()]
        )
        rules: tuple[str, ...] = ("growing", "falling")
        if swings_of_two_kinds(self._logs, basis):
            rules = (*rules, "free")
        chosen = self._choice.structure.slopes
        rules = (chosen, *(rule for rule in rules if rule != chosen))
        if self._options.slopes is not None or self._one_amplitude:
            rules = (chosen,)
        for slopes in rules:
            alone = Structure(slopes, memories[0], 1, self._choice.structure.smoothness)
            if slopes != chosen and not self._reaches(basis, alone, least):
                continue
            try:
                smoothest = self._problem(basis).smoothest(alone, SMOOTHNESS)
            except FitError:
                continue
            for some in memories:
                yield replace(smoothest, memories=some)

    def _chain(
        self, basis: Basis, structure: Structure, upto: Structure | None = None
    ) -> Iterator[Refined]:
        """Yield the refined candidates of more and more segments, each begun where the last one ended."""
        problem = self._problem(basis)
        segments: tuple[tuple[int, float], ...] = SEGMENTS
        if upto is not None:
            segments = (*(one for one in SEGMENTS if upto.segments % one[0] == 0 and one[0] < upto.segments),
                        (upto.segments, upto.knot_smoothness))  # fmt: skip
        elif self._options.points is not None:
            segments = (
                (1, KNOT_SMOOTHNESS),
                (max(self._options.points, 1), KNOT_SMOOTHNESS),
            )
        vector = np.zeros(problem.rows.columns(1).total)
        before = 1
        for count, kinks in segments:
            some = replace(structure, segments=count, knot_smoothness=kinks)
            start = finer(vector, problem.rows.columns(before), before, count)
            refined = problem.refined(some, start)
            vector, before = refined.vector, count
            if self._options.points is None or count == max(self._options.points, 1):
                yield refined


def _percent(one: LeftOut) -> str:
    """Return the error left out, mean over the kinds, as a share of the range."""
    return f"{100.0 * math.exp(one.score):.3g} % of the range"


def _complexity(one: Judged) -> float:
    """Return how much a candidate has: halvings of its segments, memories, delay, bend, free slopes."""
    structure = one.structure
    parts = [bool(structure.memories), bool(one.basis.delay), bool(one.basis.bend)]
    free = structure.slopes == "free"
    return math.log2(structure.segments) + sum(parts) + 2.0 * free
