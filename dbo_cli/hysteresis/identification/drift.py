"""Drift of a sensor: a polynomial in time, taken off only where nothing that the actuator does explains it.

A drift that is always fitted eats creep, which then is missing from the model; a drift that is never fitted
passes a warming sensor for creep. So both are tried beside memories of all time constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.hysteresis.identification.normal_equations import Structure, solve, squared_error
from dbo_cli.hysteresis.identification.recordings import DriveShape, Floats
from dbo_cli.hysteresis.identification.regressors import Basis
from dbo_cli.hysteresis.identification.statistics import PreparedLog, fewer_rows, gather

HIGHEST_ORDER = 4
"""Follows a warm-up with a time constant of a quarter of the log to a tenth of its size."""

CYCLES_PER_ORDER = 3

DRIFT_GAIN = 1.15
"""Drift must lower the RMSE by this factor. Measured on invented recordings: without drift at most 1.1 with
order 1 (1.2 with higher orders and strong creep), a drift of 1 % of the range 1.3 to 1.7, 5 % 2.7 or more."""

TRIAL_SLOPES, TRIAL_SPLIT, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS = 64, 8, 8, 1e-8
TRIAL_RATIO = 3.0  # between the time constants of the memories that drift has to compete with


LEVEL_MOVES = 0.02
"""Scatter of the cycles' mean levels, over the drive's range, from which creep can be told from drift."""


def level_moves(shape: DriveShape, voltage: Floats) -> bool:
    """Whether the mean level of the drive differs from cycle to cycle."""
    if shape.cycle_count < CYCLES_PER_ORDER:
        return False
    begins = shape.cycles
    sums = np.add.reduceat(voltage[: begins[-1]], begins[:-1])
    return float(np.std(sums / np.diff(begins))) > LEVEL_MOVES * float(np.ptp(voltage))


def drift_order(shape: DriveShape, has_clock: bool, moving_level: bool) -> int:
    """Highest order of the drift polynomial that a log of so many cycles can tell from anything else."""
    if not has_clock or shape.cycle_count < CYCLES_PER_ORDER:
        return 0
    highest = HIGHEST_ORDER if moving_level else 2 if shape.one_amplitude else 1
    return min(highest, shape.cycle_count // CYCLES_PER_ORDER)


def with_drift_needed(
    logs: Sequence[PreparedLog], low: float, high: float, one_level: bool
) -> list[PreparedLog]:
    """Return the logs with as many drift columns as they ask for.

    With one mean level of the drive, slow creep after the first cycle cannot be told from drift; the drift
    then stays, since a creep that is none does more harm on the next recording (measured on a warm-up of 3 %:
    0.38 % of the range instead of 0.12).
    """
    highest = max(log.drift_order for log in logs)
    if highest == 0 or one_level or any(log.seconds is None for log in logs):
        return list(logs)
    some = fewer_rows(logs)
    values = np.concatenate([log.output[log.used] for log in some])
    bottom, height = float(values.min()), float(np.ptp(values))
    some = [replace(log, output=(log.output - bottom) / height) for log in some]
    basis = Basis(TRIAL_SLOPES, low, high, TRIAL_SPLIT, _time_constants(some))
    errors = [_error([log.with_drift_of(order) for log in some], basis) for order in range(highest + 1)]
    wanted = next(order for order in range(highest + 1) if errors[order] <= DRIFT_GAIN * min(errors[order:]))
    return [log.with_drift_of(wanted) for log in logs]


def _time_constants(logs: Sequence[PreparedLog]) -> tuple[float, ...]:
    """Time constants in seconds from two samples to half of the longest log."""
    clocks = [log.seconds for log in logs if log.seconds is not None]
    steps = np.concatenate([np.diff(clock) for clock in clocks])
    tau = 2.0 * float(np.median(steps[steps > 0.0]))
    found = []
    while tau <= max(float(clock[-1]) for clock in clocks) / 2.0:
        found.append(tau)
        tau *= TRIAL_RATIO
    return tuple(found)


def _error(logs: Sequence[PreparedLog], basis: Basis) -> float:
    """RMS equation error with all memories, the better of growing and falling slopes."""
    statistics = gather(logs, basis, TRIAL_SEGMENTS)
    gram, rows = statistics.total()
    everything = tuple(range(len(basis.time_constants)))
    squares = []
    for slopes in ("growing", "falling"):
        structure = Structure(slopes, everything, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS)
        squares.append(squared_error(gram, solve(gram, statistics.columns, structure, rows).vector) / rows)
    return float(np.sqrt(min(squares)))
