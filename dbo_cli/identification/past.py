"""The unknown past of a log: rows at its beginning that tell of it, not of the actuator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.identification.basis import PreparedLog, Structure
from dbo_cli.identification.problem import Problem
from dbo_cli.identification.recording import Booleans
from dbo_cli.identification.solve import solve, times

NEAR_END = 0.02  # of the log's range
MOST_EARLY = 0.25  # of a log's rows: of a shorter rest less is learnt than is lost
STRANGE = 4.0  # mean square of early rows over that of the others
PROBE = Structure("free", "t", smooth_slopes=2e-3, smooth_curve=1e-1)


def without_unknown_past(problem: Problem, notes: list[str]) -> Problem:
    """Return the problem without early rows that a fit to all others does not follow.

    Until the drive has been at both ends of its range, the gears stand where an earlier
    drive has left them.
    """
    early = [early_rows(log) for log in problem.logs]
    if not any(rows.any() for rows in early):
        return problem
    later = _without(problem, early)
    probe = PROBE if len(problem.taus) else replace(PROBE, memories="")
    try:
        fit = solve(later.rows(probe), probe)
    except FitError:
        return problem
    columns = problem.columns(probe)[:, : problem.cells.count + len(fit.gains)]
    error = problem.output - fit.predict(columns) - times(problem.drift(0), fit.drift)
    usual = float(np.mean(fit.error**2))
    strange = []
    for place, rows in enumerate(early):
        left = error[problem.owner == place][rows]
        if not rows.any() or float(np.mean(left**2)) <= STRANGE * usual:
            strange.append(np.zeros(len(rows), bool))
            continue
        strange.append(rows)
        log = problem.logs[place]
        last = int(log.rows[rows][-1]) + 1
        notes.append(
            f"{log.name}: rows 1 to {last} left out: unknown past, before the drive was at both ends "
            "of its range"
        )
    return _without(problem, strange)


def early_rows(log: PreparedLog) -> Booleans:
    """Return which fitted rows come before the drive has been at both ends; none where they are too many."""
    drive = log.drive[log.rows]
    low, high = float(drive.min()), float(drive.max())
    near = NEAR_END * (high - low)
    both = max(
        int(np.argmax(drive <= low + near)), int(np.argmax(drive >= high - near))
    )
    early = np.arange(len(drive)) < both
    again = np.ptp(drive[both:]) >= (1.0 - 2.0 * NEAR_END) * (high - low)
    if both > MOST_EARLY * len(drive) or not again:
        early[:] = False
    return early


def _without(problem: Problem, early: list[Booleans]) -> Problem:
    """Return the problem without these of its fitted rows."""
    logs = []
    for log, rows in zip(problem.logs, early, strict=True):
        logs.append(replace(log, rows=log.rows[~rows], ends=log.ends[~rows]))
    return replace(problem, logs=tuple(logs))
