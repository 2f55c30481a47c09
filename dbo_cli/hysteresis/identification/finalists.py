"""The last choice: candidates at their least error of the output, judged by it on parts left out.

The search (``search``) is convex and quick, and ranks by the equation error. What it chose stands here beside
simpler and other models: without its delay, without memories, with other rules for the slopes, from gears
alone to many segments. What it chose holds unless another does better by more than the error bar; among
those as good as the best the simplest is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import KNOT_SMOOTHNESS, Structure
from dbo_cli.hysteresis.identification.output_error import (
    TINY,
    Judged,
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
SEGMENTS = ((1, KNOT_SMOOTHNESS), (2, KNOT_SMOOTHNESS), (4, KNOT_SMOOTHNESS), (8, KNOT_SMOOTHNESS),
            (16, KNOT_SMOOTHNESS), (32, 1e-7))  # fmt: skip
"""Segments and smoothness of the asymmetry; each begins where the one before ended."""
SMOOTHNESS = (1e-6, 1e-8, 1e-10, 1e-12, 1e-16)  # of the slopes


@dataclass(frozen=True)
class Finalist:
    """What is delivered: basis, structure, and the unknowns from which the last refinement begins."""

    basis: Basis
    structure: Structure
    vector: Floats


def best_of(prepared: Prepared, choice: Choice, options: IdentificationOptions) -> Finalist:
    """Return the candidate that predicts best what was left out; the simplest of those as good.

    Raises
    ------
    FitError
        No candidate can be solved.
    """
    return _Finalists(prepared, choice, options).best()


class _Finalists:
    """The candidates beside a choice, on some rows of the logs."""

    def __init__(self, prepared: Prepared, choice: Choice, options: IdentificationOptions) -> None:
        self._logs: Sequence[PreparedLog] = fewer_rows(prepared.logs, JUDGED_ROWS)
        self._one_amplitude = prepared.one_amplitude
        self._choice, self._options = choice, options
        self._problems: dict[Basis, OutputProblem] = {}

    def _problem(self, basis: Basis) -> OutputProblem:
        if basis not in self._problems:
            self._problems[basis] = OutputProblem(judged_rows(self._logs, basis))
        return self._problems[basis]

    def best(self) -> Finalist:
        """Return the winner."""
        chosen = self._judged_choice()
        if self._at_noise(chosen):
            return Finalist(chosen.basis, chosen.structure, chosen.candidate.vector)
        refined: list[Refined] = []
        basis = chosen.basis  # the delay has been judged
        for structure in self._starts(basis):
            try:
                refined += self._chain(basis, structure)
            except FitError:  # a candidate that cannot be solved is no reason to refuse the log
                continue
        # What is left out is predicted no better than what is fitted: most need not be left out at all.
        refined.sort(key=lambda one: one.squares)
        judged = [chosen]
        least = chosen.score
        for candidate in refined:
            if 0.5 * np.log(candidate.squares / self._problem(basis).count + TINY) > least:
                break
            try:
                one = self._problem(basis).judged(candidate)
            except FitError:
                continue
            judged.append(one)
            least = min(least, one.score)
        winner = self._winner(judged)
        return Finalist(winner.basis, winner.structure, winner.candidate.vector)

    def _needed(self) -> float:
        """Return the share of the error by which another candidate has to do better."""
        return 1.0 / EARNED - 1.0 if self._one_amplitude else INDIFFERENCE

    def _at_noise(self, chosen: Judged) -> bool:
        """Return whether the choice leaves so little beyond white noise that none could do so much better."""
        noise = self._problem(chosen.basis).noise(chosen.candidate)
        return chosen.score - 0.5 * math.log(noise + TINY) <= math.log1p(self._needed())

    def _winner(self, judged: Sequence[Judged]) -> Judged:
        """Return the simplest candidate within the error bar of the best; the choice where it is as good.

        What cannot be left out cannot be judged: among the cycles of one amplitude the larger model always
        wins, so there another one has to earn its place.
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
        *_, last = self._chain(basis, structure, upto=structure)
        return self._problem(basis).judged(last)

    def _starts(self, basis: Basis) -> Iterator[Structure]:
        """Yield gears alone of every chain of candidates."""
        every = tuple(range(len(basis.time_constants)))
        memories = [every] if self._options.relaxation is not None or not every else [(), every]
        rules: tuple[str, ...] = ("growing", "falling")
        if swings_of_two_kinds(self._logs, basis):
            rules = (*rules, "free")
        if self._options.slopes is not None or self._one_amplitude:
            rules = (self._choice.structure.slopes,)
        for slopes in rules:
            for some in memories:
                alone = Structure(slopes, some, 1, self._choice.structure.smoothness)
                try:
                    yield self._problem(basis).smoothest(alone, SMOOTHNESS)
                except FitError:
                    continue

    def _chain(self, basis: Basis, structure: Structure, upto: Structure | None = None) -> Iterator[Refined]:
        """Yield the refined candidates of more and more segments, each begun where the last one ended."""
        problem = self._problem(basis)
        segments: tuple[tuple[int, float], ...] = SEGMENTS
        if upto is not None:
            segments = (*(one for one in SEGMENTS if upto.segments % one[0] == 0 and one[0] < upto.segments),
                        (upto.segments, upto.knot_smoothness))  # fmt: skip
        elif self._options.points is not None:
            segments = ((1, KNOT_SMOOTHNESS), (max(self._options.points, 1), KNOT_SMOOTHNESS))
        vector = np.zeros(problem.rows.columns(1).total)
        before = 1
        for count, kinks in segments:
            some = replace(structure, segments=count, knot_smoothness=kinks)
            start = finer(vector, problem.rows.columns(before), before, count)
            refined = problem.refined(some, start)
            vector, before = refined.vector, count
            if self._options.points is None or count == max(self._options.points, 1):
                yield refined


def _complexity(one: Judged) -> float:
    """Return how much a candidate has: halvings of its segments, memories, delay, bend, free slopes."""
    structure = one.structure
    parts = [bool(structure.memories), bool(one.basis.delay), bool(one.basis.bend)]
    free = structure.slopes == "free"
    return math.log2(structure.segments) + sum(parts) + 2.0 * free
