"""The stages of a model from a fit in normalised units."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.identification.basis import SPARE, points_of
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.solve import LEAST_WITH_NEGATIVE, Solution
from dbo_cli.model import (
    Candidate,
    Cascade,
    Delay,
    Gears,
    Points,
    Quantity,
    Relaxation,
    Scale,
    Stage,
)

LAST = 0.05  # of the gears inside the range: those beyond it have their mean slope
FLATTEST = 1e-9  # of the mean slope of the range: a gear must rise


def stages_of(problem: Problem, fit: Solution, zero: float = 0.0) -> tuple[Stage, ...]:
    """Return the stages of a fit; ``zero`` is taken off the displacement.

    The gears' output is in the displacement's unit, but for sign and offset.
    """
    stages: list[Stage] = []
    structure, height = fit.structure, abs(problem.scale)
    offset = problem.offset - zero
    rising = problem.scale > 0.0
    straight = len(fit.curve) == 1
    base = offset if rising else 0.0
    if structure.bend:
        span = problem.high - problem.low
        stages.append(points_of(structure.bend, problem.low, span))
    stages.append(_gears_of(problem, fit, height, base if straight else 0.0))
    if not straight:
        width = height / len(fit.curve)
        widths = np.full(len(fit.curve), width)
        stages.append(Points(widths, width * fit.curve, 0.0, base))
    if not rising:
        stages.append(Scale(-1.0, offset))
    if structure.delay > 0.0:
        stages.append(Delay(structure.delay))
    return tuple(stages)


def _gears_of(problem: Problem, fit: Solution, height: float, base: float) -> Gears:
    """Return the gears and their relaxation: output is ``base + height * u``."""
    cells, span = problem.cells, problem.high - problem.low
    terms = len(problem.taus)
    both = np.zeros(2 * terms)
    both[: fit.gains.size] = fit.gains
    lags, rests = both[:terms], both[terms:]
    fitted = np.repeat(fit.slopes, cells.counts)
    # few rows show the last cell, which a curve may hide
    if 0.0 < cells.overshoot <= SPARE:
        last = fitted[round((1.0 - LAST) * cells.inside) : cells.inside]
        fitted[cells.inside :] = last.mean()
    mean = float(fitted.mean()) + float(rests.sum())
    lowest = float(rests.sum()) + LEAST_WITH_NEGATIVE * mean * bool(rests.any())
    slopes = np.maximum(fitted + rests.sum(), max(lowest, FLATTEST))
    empty = fit.offset - float(fit.slopes @ cells.widths) / 2.0
    empty -= cells.overshoot * float(slopes[-1])
    gains = height * (lags - rests) / span
    used = gains != 0.0
    relaxation = None
    if used.any():
        taus = tuple(problem.taus[used].tolist())
        relaxation = Relaxation(problem.low, taus, tuple(gains[used].tolist()))
    return Gears(
        np.full(len(slopes), span / cells.inside),
        slopes * (height / cells.inside),
        problem.low - cells.overshoot * span,
        base + height * empty,
        relaxation,
    )


def model_of(
    problem: Problem,
    fit: Solution,
    log: Recording,
    options: Options,
    others: Sequence[Solution] = (),
) -> Cascade:
    """Return the forward model of a fit, with ``others`` as candidates."""
    zero = zero_of(log, options)
    candidates = []
    for other in others:
        candidates.append(Candidate(other.weight, stages_of(problem, other, zero)))
    model = Cascade(
        "forward",
        Quantity(*log.input, problem.low, problem.high),
        Quantity(*log.output, 0.0, 1.0),
        stages_of(problem, fit, zero),
        candidates=tuple(candidates),
    )
    return with_reach(model)


def with_reach(model: Cascade) -> Cascade:
    """Return a model with its output's range: empty at the least voltage, full at the greatest."""
    ends = []
    for voltage, state in ((model.input.min, "empty"), (model.input.max, "full")):
        reached, _ = model.static.simulate(np.asarray([voltage]), dt=1.0, state=state)
        ends.append(float(reached[0]))
    return replace(model, output=replace(model.output, min=min(ends), max=max(ends)))


def with_changed_stages(
    model: Cascade, changed: Callable[[Sequence[Stage]], tuple[Stage, ...]]
) -> Cascade:
    """Return a model whose stages, and those of its candidates, are changed alike."""
    candidates = []
    for candidate in model.candidates:
        candidates.append(replace(candidate, stages=changed(candidate.stages)))
    stages = changed(model.stages)
    return replace(model, stages=stages, candidates=tuple(candidates))


def zero_of(log: Recording, options: Options) -> float:
    """Return what the user wants to be zero, in the log's unit."""
    rows: Floats = log.displacement[log.usable]
    if options.zero == "none":
        return 0.0
    if options.zero == "mean":
        return float(rows.mean())
    if options.zero == "first":
        return float(rows[0])
    return float(options.zero)
