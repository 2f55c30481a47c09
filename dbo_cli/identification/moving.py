"""Identification with dynamics: gears from the slow rows, sections from the fast ones, in turn.

A static model of the slow rows finds the sections. They tell how late slow moves are;
with that known, memories of milliseconds and wider loops no longer stand for it, and the
slow rows are read again: with memories of the drive, and with creep behind the gears
instead. The sections are then fitted again to the better reading, with a lag before the
gears, where an amplifier has it: to slow moves it is only late, wherever it stands.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import FitError
from dbo_cli.identification.basis import Structure
from dbo_cli.identification.dynamics import figures_of, find, refine
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.identification.search import CURVES, Choices, Search, with_curves
from dbo_cli.identification.sections import FastDynamics, FastRows, Sweep
from dbo_cli.identification.solve import Solution, nonnegative
from dbo_cli.identification.stages import model_of, with_changed_stages
from dbo_cli.model import Amplifier, Cascade, Delay, Dynamics, Lag, Relaxation, Stage
from dbo_cli.model.dynamics import Inverter

FAST_LAGS = 2.0  # periods of the lowest frequency: shorter relaxation is dynamics
CREEP_ROUNDS = 8  # of gears and creep in turn
CREEP_RATIO = 1.4  # of neighbouring time constants: 3 leaves 2 % of the creep
LEAST_SHARE = 1e-5  # of the displacement: less is no creep
MOST_SHARE = 0.5  # of the displacement that creeps: more is no creep


@dataclass(frozen=True)
class Moving:
    """What fast rows told.

    Attributes
    ----------
    problem, fits
        The slow rows as read again: freed of creep where that stands behind the gears.
    amplifier
        Before the gears, where there is one.
    dynamics
        Behind them, creep first, and a delay; nothing where the fast rows ask for nothing.
    figures
        For ``fit["dynamics"]`` of the model; None where no dynamics were looked for.
    """

    problem: Problem
    fits: list[Solution]
    figures: dict[str, Any] | None = None
    amplifier: tuple[Stage, ...] = ()
    dynamics: tuple[Stage, ...] = ()

    def applied(self, model: Cascade) -> Cascade:
        """Return a model of the slow rows with these stages, in its candidates, too."""
        if self.figures is not None:
            model = replace(model, fit={"dynamics": self.figures})
        if not self.dynamics:
            return model

        def changed(stages: Sequence[Stage]) -> tuple[Stage, ...]:
            static = [stage for stage in stages if not isinstance(stage, Delay)]
            return (*self.amplifier, *static, *self.dynamics)

        return with_changed_stages(model, changed)


def moving(
    problem: Problem,
    fits: list[Solution],
    logs: Sequence[Recording],
    fast: Sequence[Sweep],
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
        The fast parts; see ``sections.split``.

    Raises
    ------
    FitError
        Resonances are asked for, and no log has fast rows.
    """
    best, order = fits[0], options.dynamics
    if order == 0 or (order == "auto" and not fast):
        return Moving(problem, fits)
    if not fast:
        raise FitError(
            f"`dynamics` {order}: no log has a sweep: record a drive of dbo excite with `sweep_to` HZ"
        )
    shortest = FAST_LAGS / min(sweep.band[0] for sweep in fast)
    slower, steeper = without_fast_memories(problem, best, shortest)
    static = model_of(slower, steeper, logs[0], options).static
    rows = FastRows(static, fast)
    found = find(rows, order)
    if not found.form.resonances:
        return Moving(problem, fits, figures_of(rows, found))
    problem, fits, creep = _read_again(slower, best, logs, options, lateness(found))
    best = min(fits, key=lambda fit: fit.score)
    static = model_of(problem, best, logs[0], options).static
    if creep:
        static = static.with_stages((*static.stages, Dynamics(creep)))
    rows = FastRows(static, fast)
    refined = refine(rows, found, order)
    dynamics: list[Stage] = [Dynamics((*creep, *rows.sections(refined)))]
    if refined.delay:
        dynamics.append(Delay(refined.delay))
    amplifier = (Amplifier(refined.amplifier),) if refined.amplifier else ()
    figures = figures_of(rows, refined)
    return Moving(problem, fits, figures, amplifier, tuple(dynamics))


def without_fast_memories(
    problem: Problem, fit: Solution, shortest: float
) -> tuple[Problem, Solution]:
    """Return problem and fit whose memories of less than ``shortest`` (s) are immediate.

    A memory of milliseconds stands in a slow fit for what dynamics say better. At once,
    it makes every gear steeper by its gain, about the middle of the range.
    """
    slow = problem.taus >= shortest
    kept = np.tile(slow, len(fit.structure.memories))
    lags = fit.gains[: len(slow)]
    added = float(lags[~kept[: len(slow)]].sum())
    steeper = replace(
        fit,
        slopes=fit.slopes + added,
        gains=fit.gains[kept],
        offset=fit.offset + added / 2.0,
    )
    return replace(problem, taus=problem.taus[slow]), steeper


def lateness(found: FastDynamics) -> float:
    """Return how late slow moves are behind a delay, a lag and resonances (s)."""
    seconds = found.delay + found.lag
    for resonance in found.resonances:
        seconds += resonance.damping / (math.pi * resonance.frequency)
        notch = resonance.antiresonance
        if notch is not None:
            seconds -= notch.damping / (math.pi * notch.frequency)
    return float(seconds)


def _read_again(
    problem: Problem,
    best: Solution,
    logs: Sequence[Recording],
    options: Options,
    delay: float,
) -> tuple[Problem, list[Solution], tuple[Lag, ...]]:
    """Return problem and fits of the slow rows with a known delay (s), and the creep behind the gears."""
    fits = _around(problem, best, delay)
    is_even = all(log.even_step for log in logs)
    if options.taus is None and len(problem.taus) and is_even:
        freed, others, creep = _with_creep(problem, logs, fits[0].structure)
        if others and min(fit.score for fit in others) < fits[0].score:
            return freed, others, creep
    return problem, fits, ()


def _around(problem: Problem, best: Solution, delay: float) -> list[Solution]:
    """Return fits of the best structure's kind with a known delay."""
    structure = best.structure
    memories = dict.fromkeys(("", "t", structure.memories))
    choices = Choices(
        slopes=(structure.slopes,),
        memories=tuple(memories) if len(problem.taus) else ("",),
        bends=(structure.bend,) if structure.bend else (),
        drift=structure.drift,
        delays=(),
        base=Structure(delay=delay, start=structure.start, level=structure.level),
    )
    return Search(problem, choices).run()


# --- creep that follows the displacement: sections behind the gears, from the slow rows ---


def _with_creep(
    problem: Problem,
    logs: Sequence[Recording],
    structure: Structure,
) -> tuple[Problem, list[Solution], tuple[Lag, ...]]:
    """Return the logs freed of creep, fits to them without memories, and the creep; no fits without creep.

    The gears' own relaxation follows the drive. Where the loop is wide the two differ by
    the loop's part of the creep, which fast moves show. In turn the logs are freed of the
    creep found so far and the gears are fitted to them, and the shares of the creep are
    fitted to what the gears predict.

    Parameters
    ----------
    problem
        Of the slow logs; ``taus`` are the time constants offered.
    logs
        The slow logs, which have even clocks.
    structure
        The best one with memories, its delay known.
    """
    shortest, longest = float(problem.taus.min()), float(problem.taus.max())
    count = 1 + int(np.ceil(np.log(longest / shortest) / np.log(CREEP_RATIO)))
    taus = np.geomspace(shortest, longest, count)
    bare = replace(structure, memories="")
    freed = problem
    creep: tuple[Lag, ...] = ()
    for _ in range(CREEP_ROUNDS):
        fit = freed.equations(bare).solve()
        creep = _lags_of(taus, _shares(problem, logs, fit, taus))
        if not creep:
            return problem, [], ()
        freed = _freed(problem, creep)
    search = Search(freed, Choices())
    search.fit(with_curves(bare, CURVES))
    return freed, search.fits, creep


def _freed(problem: Problem, creep: tuple[Lag, ...]) -> Problem:
    """Return the problem of displacements that have not crept."""
    logs = []
    for log in problem.logs:
        output, _ = Inverter(Dynamics(creep), None, log.dt).run(log.output)
        logs.append(replace(log, output=output))
    return replace(problem, logs=tuple(logs))


def _shares(
    problem: Problem, logs: Sequence[Recording], fit: Solution, taus: Floats
) -> Floats:
    """Return the shares of creep with which a fit comes nearest to the logs, one for each time constant."""
    model = model_of(problem, fit, logs[0], Options())
    count = len(taus)
    lag = Relaxation(0.0, tuple(taus.tolist()), (0.0,) * count)
    tables, targets = [], []
    for log, prepared in zip(logs, problem.logs, strict=True):
        bare, _ = model.simulate(log.voltage, dt=prepared.dt)
        lagged, _ = lag.lags(bare, prepared.dt)
        table = np.ones((len(bare), count + 3))
        table[:, :count] = lagged - bare[:, None]
        table[:, count] = bare
        table[:, -1] = -1.0
        tables.append(table[prepared.rows])
        targets.append(log.displacement[prepared.rows])
    stacked = np.vstack(tables) / abs(problem.scale)
    target = np.concatenate(targets) / abs(problem.scale)
    gains = nonnegative(stacked, target)
    return gains[:count] / max(float(gains[count]), 1e-300)


def _lags_of(taus: Floats, shares: Floats) -> tuple[Lag, ...]:
    """Return 1 - sum c + sum c / (1 + tau s) as a product of sections (1 + lead s) / (1 + tau s)."""
    large = shares > LEAST_SHARE
    taus, shares = taus[large], shares[large]
    if not taus.size or float(shares.sum()) >= MOST_SHARE:
        return ()
    numerator = (1.0 - shares.sum()) * np.poly(-1.0 / taus)
    for index, share in enumerate(shares):
        others = np.poly(-1.0 / np.delete(taus, index))
        numerator[1:] += share / taus[index] * others
    leads = np.sort(-1.0 / np.roots(numerator).real)
    pairs = zip(np.sort(taus).tolist(), leads.tolist(), strict=True)
    return tuple(Lag(tau, lead) for tau, lead in pairs)
