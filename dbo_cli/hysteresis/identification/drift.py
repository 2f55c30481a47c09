"""Drift of a sensor: taken off only where nothing that the actuator does explains it as well.

A drift that is always fitted eats creep, which then is missing from the model; a drift that is never fitted
passes a warming sensor for creep. So polynomials in time and the exponential of a warm-up are tried beside
memories of all time constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.hysteresis.identification.normal_equations import Structure, solve, squared_error
from dbo_cli.hysteresis.identification.recordings import DriveShape, Floats
from dbo_cli.hysteresis.identification.regressors import Basis
from dbo_cli.hysteresis.identification.statistics import PreparedLog, fewer_rows, gather

HIGHEST_ORDER = 4

WARM_UPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the log's length: time constants of a sensor that warms up
ORDERS_OF_A_WARM_UP = 2  # offered where a polynomial of this order is: it has a size and a time constant
SLOW = 1 / 32  # of the log's length: memories longer than this can stand in for a warm-up
WARM_UP_GAIN = 1.045
CREEP_LEFT = 0.7
"""A warm-up passes for creep with little error more (1.02 to 1.3 times), since most drives begin at rest at
one end. But where the sensor does warm up, its column takes the creep's place; where it does not, it makes an
imperfect creep fit better, and the creep beside it mostly grows. On invented recordings, five kinds of
hysteresis and four of creep after three drives: with a warm-up of 3 % of the range 44 of 60 pass both bounds,
without any 1 of 60."""

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
    """Return the logs with as many drift columns as they ask for, or with those of a warm-up.

    With one mean level of the drive, slow creep after the first cycle cannot be told from drift; the drift
    then stays, since a creep that is none does more harm on the next recording (measured on a warm-up of 3 %:
    0.38 % of the range instead of 0.12).
    """
    highest = max(_order(log) for log in logs)
    if highest == 0 or one_level or any(log.seconds is None for log in logs):
        return list(logs)
    basis = Basis(TRIAL_SLOPES, low, high, TRIAL_SPLIT, _time_constants(logs))
    some = _scaled(fewer_rows(logs))
    trials = [_trial([_with_drift_of(log, order) for log in some], basis) for order in range(highest + 1)]
    least = min(trial.error for trial in trials)
    order = next(k for k, trial in enumerate(trials) if trial.error <= DRIFT_GAIN * least)
    if highest >= ORDERS_OF_A_WARM_UP:
        warm = {part: _trial([_with_drift_of(log, 0, part) for log in some], basis) for part in WARM_UPS}
        part = min(warm, key=lambda one: warm[one].error)
        if _warms_up(trials[0], warm[part], trials[order]):
            return [_with_drift_of(log, 0, part) for log in logs]
    return [_with_drift_of(log, order) for log in logs]


@dataclass(frozen=True)
class _Trial:
    """A fit with a drift: its RMS error, and the gains of the slow memories together."""

    error: float
    creep: float


def _warms_up(without: _Trial, warm: _Trial, polynomial: _Trial) -> bool:
    """Whether a warm-up explains the logs: better than creep alone, in its place, as well as any drift."""
    return (
        without.error >= WARM_UP_GAIN * warm.error
        and warm.creep <= CREEP_LEFT * without.creep
        and warm.error <= WARM_UP_GAIN * polynomial.error
    )


def _order(log: PreparedLog) -> int:
    """Order of the polynomial among the columns of drift; 0 for an offset alone."""
    return int(log.drift.shape[1]) - log.stretches - 1


def _with_drift_of(log: PreparedLog, order: int, warm_up: float | None = None) -> PreparedLog:
    """Return the log with a drift of at most this order and a warm-up; offsets of stretches stay."""
    own = _order(log) + 1
    parts = [log.drift[:, : min(order + 1, own)], log.drift[:, own:]]
    if warm_up is not None and own > ORDERS_OF_A_WARM_UP:
        parts.insert(1, _warmth(log, warm_up))
    return replace(log, drift=np.hstack(parts))


def _warmth(log: PreparedLog, warm_up: float) -> Floats:
    """Return exp(-t / tau) about its mean, tau in units of the log's length; shape (samples, 1)."""
    assert log.seconds is not None
    left = np.exp(-log.seconds / (warm_up * float(log.seconds.max())))
    column: Floats = (left - left.mean())[:, None]
    return column


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


def _scaled(logs: Sequence[PreparedLog]) -> list[PreparedLog]:
    """Return the logs with outputs from 0 to 1."""
    values = np.concatenate([log.output[log.used] for log in logs])
    bottom, height = float(values.min()), float(np.ptp(values))
    return [replace(log, output=(log.output - bottom) / height) for log in logs]


def _trial(logs: Sequence[PreparedLog], basis: Basis) -> _Trial:
    """Fit with all memories, the better of growing and falling slopes."""
    statistics = gather(logs, basis, TRIAL_SEGMENTS)
    gram, rows = statistics.total()
    everything = tuple(range(len(basis.time_constants)))
    longest = max(float(log.seconds.max()) for log in logs if log.seconds is not None)
    slow = np.asarray(basis.time_constants) > SLOW * longest
    found = []
    for slopes in ("growing", "falling"):
        structure = Structure(slopes, everything, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS)
        solution = solve(gram, statistics.columns, structure, rows)
        error = float(np.sqrt(squared_error(gram, solution.vector) / rows))
        found.append(_Trial(error, float(solution.gains[slow].sum())))
    return min(found, key=lambda trial: trial.error)
