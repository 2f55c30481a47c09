"""Creep that follows the displacement: sections behind the gears, from the slow rows.

The gears' own relaxation follows the drive. Where the loop is wide the two differ by the loop's part of the
creep: measured on four stages of 1.6 % creep and loops of 30 to 45 %, moves at f_r/1000 to f_r/30 were 0.03
to 0.07 % off in the mean with the one, and 0.00 to 0.02 with the other. In turn, the displacement is freed
of the creep found so far and the gears are identified from it, and the creep is fitted to what they predict.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag
from dbo_cli.hysteresis.identification.evaluation import predict
from dbo_cli.hysteresis.identification.options import IdentificationOptions
from dbo_cli.hysteresis.identification.recordings import Floats, Recording, first_wiped_row
from dbo_cli.hysteresis.identification.static import Identification, identify_static
from dbo_cli.hysteresis.model import BacklashStage

ROUNDS = 3  # of gears and creep in turn; from the memories' gains two bring it to 2 % of itself
LEAST_SHARE = 1e-5  # of the displacement: less is no creep


def creep_behind(
    found: Identification,
    logs: Sequence[Recording],
    steps: Sequence[float],
    options: IdentificationOptions,
) -> tuple[Identification, tuple[Lag, ...]] | None:
    """Return what the logs tell when creep stands behind the gears, and its sections; None without creep.

    Parameters
    ----------
    found
        What ``identify_static`` found with creep beside the gears.
    logs, steps
        Slow logs, the lag of their drive known, and their even time steps (s).
    options
        Of ``identify``.
    """
    gears = found.model.backlash
    taus, shares = _memories(gears)
    if not taus.size:
        return None
    again, sections = None, _sections(taus, shares)
    asked = dataclasses.replace(options, relaxation=(), slopes=str(found.fit["slopes"]))
    for _ in range(ROUNDS):
        if not sections:
            return None
        try:
            again = identify_static(
                [_freed(log, sections, step) for log, step in zip(logs, steps, strict=True)], asked
            )
        except FitError:
            return None
        used = sections
        shares = _fitted_shares(again, logs, steps, taus)
        sections = _sections(taus, shares)
    return None if again is None else (again, used)


def _memories(gears: BacklashStage) -> tuple[Floats, Floats]:
    """Return the time constants of an operator's memories, and their shares of its displacement."""
    terms = gears.relaxation
    if terms is None:
        return np.zeros(0), np.zeros(0)
    taus, gains = np.array(terms.tau), np.array(terms.gain) * float(gears.dx.sum())
    return taus, gains / (float(gears.dy.sum()) + float(gains.sum()))


def _sections(taus: Floats, shares: Floats) -> tuple[Lag, ...]:
    """Return 1 - Σ c + Σ c/(1 + τs) as a product of sections (1 + λs)/(1 + τs), λ < τ."""
    kept = shares > LEAST_SHARE
    taus, shares = taus[kept], shares[kept]
    if not taus.size or float(shares.sum()) >= 0.5:
        return ()
    numerator = (1.0 - shares.sum()) * np.poly(-1.0 / taus)
    for k, share in enumerate(shares):
        others = np.poly(-1.0 / np.delete(taus, k)) if taus.size > 1 else np.ones(1)
        numerator[1:] += share / taus[k] * others
    leads = np.sort(-1.0 / np.roots(numerator).real)
    return tuple(Lag(float(tau), float(lead)) for tau, lead in zip(np.sort(taus), leads, strict=True))


def _freed(log: Recording, sections: tuple[Lag, ...], step: float) -> Recording:
    """Return a log whose displacement has not crept."""
    inverter = DynamicsStage(sections).inverter(step)
    freed, _ = inverter.run(log.displacement, inverter.rest(float(log.displacement[0])))
    return dataclasses.replace(log, displacement=freed)


def _fitted_shares(
    found: Identification, logs: Sequence[Recording], steps: Sequence[float], taus: Floats
) -> Floats:
    """Return the shares of creep with which the gears' prediction comes nearest to the logs."""
    count = taus.size
    square, along = np.zeros((count + 2, count + 2)), np.zeros(count + 2)
    for log, step in zip(logs, steps, strict=True):
        bare = predict(found.model, log)
        late = [DynamicsStage((Lag(float(tau)),)).run(bare, step, None)[0] - bare for tau in taus]
        rows = slice(first_wiped_row(log.voltage), None)
        columns = np.column_stack([*late, bare, -bare])[rows]
        offset = columns.mean(axis=0)
        measured = log.displacement[rows] - log.displacement[rows].mean()
        square += (columns - offset).T @ (columns - offset)
        along += (columns - offset).T @ measured
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    scaled = square / size / size[:, None]
    root = np.linalg.cholesky(scaled + 1e-10 * np.eye(count + 2))
    gains = nnls(root.T, np.linalg.solve(root, along / size))[0] / size
    shares: Floats = gains[:count] / max(float(gains[count] - gains[count + 1]), 1e-300)
    return shares
