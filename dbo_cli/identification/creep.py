"""Creep that follows the displacement: sections behind the gears, from the slow rows.

The gears' own relaxation follows the drive. Where the loop is wide the two differ by the
loop's part of the creep, which fast moves show. In turn the logs are freed of the creep
found so far and the gears are fitted to them, and the shares of the creep are fitted to
what the gears predict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from dbo_cli.identification.basis import Structure
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Floats, Options, Recording
from dbo_cli.identification.search import Choices, Search
from dbo_cli.identification.solve import Fit
from dbo_cli.identification.stages import model_of
from dbo_cli.model import Dynamics, Lag, Relaxation
from dbo_cli.model.undoing import Inverter

ROUNDS = 8  # of gears and creep in turn
TAU_RATIO = 1.4  # of neighbouring time constants: 3 leaves 2 % of the creep
LEAST_SHARE = 1e-5  # of the displacement: less is no creep
MOST_SHARE = 0.5  # of the displacement that creeps: more is no creep


def with_creep(
    problem: Problem,
    logs: Sequence[Recording],
    structure: Structure,
    curves: Sequence[float],
) -> tuple[Problem, list[Fit], tuple[Lag, ...]]:
    """Return the logs freed of creep, fits to them without memories, and the creep; no fits without creep.

    Parameters
    ----------
    problem
        Of the slow logs; ``taus`` are the time constants offered.
    logs
        The slow logs, which have even clocks.
    structure
        The best one with memories, its delay known.
    curves
        Smoothness of the curve behind the gears, from a straight line on.
    """
    shortest, longest = float(problem.taus.min()), float(problem.taus.max())
    count = 1 + int(np.ceil(np.log(longest / shortest) / np.log(TAU_RATIO)))
    taus = np.geomspace(shortest, longest, count)
    bare = replace(structure, memories="")
    freed = problem
    creep: tuple[Lag, ...] = ()
    for _ in range(ROUNDS):
        found = _fits(freed, bare, [bare.smooth_curve])
        if not found:
            return problem, [], ()
        creep = lags_of(taus, _shares(problem, logs, found[0], taus))
        if not creep:
            return problem, [], ()
        freed = _freed(problem, creep)
    return freed, _fits(freed, bare, curves), creep


def _fits(problem: Problem, structure: Structure, curves: Sequence[float]) -> list[Fit]:
    """Return judged fits over the smoothness of the curve."""
    search = Search(problem, Choices())
    search.path(structure, curves)
    return search.fits


def _freed(problem: Problem, creep: tuple[Lag, ...]) -> Problem:
    """Return the problem of displacements that have not crept."""
    logs = []
    for log in problem.logs:
        output, _ = Inverter(Dynamics(creep), None, log.dt).run(log.output)
        logs.append(replace(log, output=output))
    return replace(problem, logs=tuple(logs))


def _shares(
    problem: Problem, logs: Sequence[Recording], fit: Fit, taus: Floats
) -> Floats:
    """Return the shares of creep with which a fit comes nearest to the logs, one for each time constant."""
    model = model_of(problem, fit, logs[0], Options())
    count = len(taus)
    tables, targets = [], []
    for log, prepared in zip(logs, problem.logs, strict=True):
        bare, _ = model.simulate(log.voltage, dt=prepared.dt)
        table = np.empty((len(prepared.rows), count + 3))
        for place, tau in enumerate(taus.tolist()):
            lag = Relaxation(0.0, (tau,), (0.0,))
            late, _ = lag.lags(bare, prepared.dt)
            table[:, place] = (late[:, 0] - bare)[prepared.rows]
        table[:, count] = bare[prepared.rows]
        table[:, count + 1 :] = 1.0, -1.0
        size = abs(problem.scale)
        tables.append(table / size)
        targets.append(log.displacement[prepared.rows] / size)
    whole = np.vstack(tables)
    gains, _ = nnls(whole, np.concatenate(targets), maxiter=100 * whole.shape[1])
    shares: Floats = gains[:count] / max(float(gains[count]), 1e-300)
    return shares


def lags_of(taus: Floats, shares: Floats) -> tuple[Lag, ...]:
    """Return 1 - sum c + sum c / (1 + tau s) as a product of sections (1 + lead s) / (1 + tau s)."""
    large = shares > LEAST_SHARE
    taus, shares = taus[large], shares[large]
    if not taus.size or float(shares.sum()) >= MOST_SHARE:
        return ()
    numerator = (1.0 - shares.sum()) * np.poly(-1.0 / taus)
    for place, share in enumerate(shares):
        others = np.poly(-1.0 / np.delete(taus, place))
        numerator[1:] += share / taus[place] * others
    leads = np.sort(-1.0 / np.roots(numerator).real)
    pairs = zip(np.sort(taus).tolist(), leads.tolist(), strict=True)
    return tuple(Lag(tau, lead) for tau, lead in pairs)
