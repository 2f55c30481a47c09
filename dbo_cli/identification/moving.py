"""Identification with dynamics: gears from the slow rows, sections from the fast ones, in turn.

A static model of the slow rows finds the sections. They tell how late slow moves are;
with that known, memories of milliseconds and wider loops no longer stand for it, and the
slow rows are read again: with memories of the drive, and with creep behind the gears
instead. The sections are then fitted again to the better reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dbo_cli.identification.creep import with_creep
from dbo_cli.identification.dynamics import find, least_relaxation, refine
from dbo_cli.identification.fast import FastPart, even_step
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.search import CURVES, Choices, Search
from dbo_cli.identification.solve import Fit
from dbo_cli.identification.stages import model_of
from dbo_cli.model import Candidate, Delay, Dynamics, Lag, Model, Section, Stage


@dataclass(frozen=True)
class Moving:
    """What fast rows told.

    Attributes
    ----------
    problem, fits
        The slow rows as read again: freed of creep where that stands behind the gears.
    sections
        Behind the gears, creep first; none where the fast rows ask for none.
    delay
        Pure delay behind all (s).
    figures
        For ``fit["dynamics"]`` of the model.
    """

    problem: Problem
    fits: list[Fit]
    sections: tuple[Section, ...]
    delay: float
    figures: dict[str, Any]

    def applied(self, model: Model) -> Model:
        """Return a model of the slow rows with the sections and the delay, in its candidates, too."""
        if not self.sections:
            return model
        candidates = []
        for one in model.candidates:
            candidates.append(Candidate(one.weight, self._moving(one.stages)))
        return replace(
            model, stages=self._moving(model.stages), candidates=tuple(candidates)
        )

    def _moving(self, stages: Sequence[Stage]) -> tuple[Stage, ...]:
        """Return the static stages, the sections, and the delay."""
        kept: list[Stage] = [
            one for one in stages if not isinstance(one, Dynamics | Delay)
        ]
        kept.append(Dynamics(self.sections))
        if self.delay > 0.0:
            kept.append(Delay(self.delay))
        return tuple(kept)


def moving(
    problem: Problem,
    fits: list[Fit],
    logs: Sequence[Recording],
    fast: Sequence[FastPart],
    options: Options,
) -> Moving:
    """Return what the fast rows tell beside fits of the slow ones.

    Parameters
    ----------
    problem, fits
        Of the slow rows.
    logs
        The slow rows, cleaned.
    fast
        The fast parts; see ``fast.split``.

    Raises
    ------
    FitError
        Resonances are asked for, and there are no fast rows.
    """
    best = fits[0]
    static = model_of(problem, best, logs[0], options)
    wanted = options.dynamics
    sections, delay, figures = find(static, fast, wanted)
    if not sections:
        return Moving(problem, fits, (), 0.0, figures)
    slower = problem.taus[problem.taus >= least_relaxation(fast)]
    problem = replace(problem, taus=slower)
    late = delay + lateness(sections)
    fits = _around(problem, best, late)
    best = fits[0]
    creep: tuple[Lag, ...] = ()
    if options.taus is None and len(slower) and all(map(even_step, logs)):
        freed, others, lags = with_creep(problem, logs, best.structure, CURVES)
        if others and min(fit.score for fit in others) < best.score:
            problem, fits, creep = freed, others, lags
            best = min(fits, key=lambda fit: fit.score)
    static = model_of(problem, best, logs[0], options)
    sections, delay, figures = refine(static, fast, sections, delay, wanted, creep)
    return Moving(problem, fits, (*creep, *sections), delay, figures)


def lateness(sections: Sequence[Section]) -> float:
    """Return how late slow moves are behind sections (s)."""
    late = 0.0
    for section in sections:
        if isinstance(section, Lag):
            late += section.seconds - section.lead
            continue
        late += section.damping / (math.pi * section.frequency)
        beside = section.antiresonance
        if beside is not None:
            late -= beside.damping / (math.pi * beside.frequency)
    return late


def _around(problem: Problem, best: Fit, delay: float) -> list[Fit]:
    """Return fits of the best structure's kind with a known delay."""
    structure = best.structure
    memories = dict.fromkeys(("", "t", structure.memories))
    choices = Choices(
        slopes=(structure.slopes,),
        memories=tuple(memories) if len(problem.taus) else ("",),
        bends=(structure.bend,) if structure.bend else (),
        drifts=(structure.drift,) if structure.drift else (),
        delay=delay,
    )
    return Search(problem, choices).run()
