"""Drift of a sensor: taken off only where nothing that the actuator does explains it as well.

A drift that is always fitted eats creep, which then is missing from the model; a drift that is never fitted
passes a warming sensor for creep. So polynomials in time and the exponential of a warm-up are tried beside
memories of all time constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.hysteresis.identification.normal_equations import Structure, solve, squared_error
from dbo_cli.hysteresis.identification.recordings import DriveShape, Floats
from dbo_cli.hysteresis.identification.regressors import Basis, relaxed_drive
from dbo_cli.hysteresis.identification.statistics import PreparedLog, Statistics, fewer_rows, gather
from dbo_cli.records import dataclass

HIGHEST_ORDER = 4  # of the polynomial: chosen; on eight invented logs 2 and 8 changed no model

WARM_UPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the log's length: time constants of a sensor that warms up
ORDERS_OF_A_WARM_UP = 2  # offered where a polynomial of this order is: it has a size and a time constant
SLOW = 1 / 32  # of the log's length: memories longer than this can stand in for a drift
LONGEST = 0.7
"""Of the log's length: the slowest memory that drift has to compete with. Half of it let slow creep pass for
drift (3 of the 70 logs below); all of it let a steady drift of 1 % be found in 12 logs instead of 24: so slow
a memory of any drive that begins at one end is a ramp."""

CYCLES_PER_ORDER = 3  # chosen: with fewer the drift is what the model learns; 2 and 6 changed none of those

DRIFT_GAIN = 1.2  # see below
INSTEAD_GAIN = 1.03  # see below
CREEP_LEFT = 0.8
"""A drift must lower the RMSE by the first factor, or by the second where it takes the place of creep: leaves
so little of the slow memories' gain. Creep with little error more passes for a drift that rises with the
log, since most drives begin at rest at one end; a drift where there is only creep makes an imperfect creep
fit better, and the creep beside it grows. Measured on 70 logs of actuators that only creep (0.5 to 60 s,
0.5 to 4 %, ten kinds of actuators, 15 to 60 s of two kinds of drive, with noise and without): at most 1.12,
and 1.013 in the place of creep. With a warm-up of 3 %, its time constant a quarter of the log, 55 of the 70
pass, and the other 15 are doubtful; with a steady drift of 1 % 24 and 31."""

AS_GOOD = 1.003
"""Of two drifts whose errors differ by less, the one that leaves less creep: the error on new moves of a
creeping actuator after a warm-up of 3 % was 0.11 % with it, 0.41 and 0.79 with the others."""

DOUBTFUL = 0.007
"""Of the range: a drift this large that could be in the place of creep is worth a word. Of the 70 logs of
actuators that only creep it is in 2."""

TRIAL_SLOPES, TRIAL_SPLIT, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS = 64, 8, 8, 1e-8
"""Slopes and gears of each, in a trial and in any probing fit, segments and smoothness. Chosen: on eight
invented logs half and double, and a tenth and ten times the smoothness, led to the same models."""
# Half and double of these two, and of SLOW, changed none of ten models (benchmarks/halved_constants.py).
SLOW_MEMORIES = 4  # of the displacement: from the 27th part of the slowest up
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
) -> tuple[list[PreparedLog], float]:
    """Return the logs with the columns of the drift they ask for, and the size of one they may have had.

    With one mean level of the drive, slow creep after the first cycle cannot be told from drift; the drift
    then stays, since a creep that is none does more harm on the next recording (measured on a warm-up of 3 %:
    0.38 % of the range instead of 0.12). With several levels creep stays where both explain the logs; what
    drift could be in its place is the second answer, as a share of the range, 0 where that is little.
    """
    highest = max(_order(log) for log in logs)
    if highest == 0 or one_level or any(log.seconds is None for log in logs):
        return list(logs), 0.0
    offered = [_Drift(order) for order in range(highest + 1)]
    if highest >= ORDERS_OF_A_WARM_UP:
        offered += [_Drift(0, part) for part in WARM_UPS]
    wanted, doubtful = _wanted(_trials(logs, low, high, offered), _trials(logs, low, high, offered, True))
    return [replace(log, drift=_columns(log)[:, _places(log, wanted)]) for log in logs], doubtful


@dataclass(frozen=True)
class _Drift:
    """A polynomial of this order in time, and a warm-up with this time constant (of the log's length)."""

    order: int
    warm_up: float | None = None


@dataclass(frozen=True)
class _Trial:
    """A fit with a drift: its RMS error, the gains of the slow memories together, the drift's size.

    The size is the largest of the logs', peak to peak; both in units of the range.
    """

    error: float
    creep: float
    size: float


def _evident(trials: dict[_Drift, _Trial]) -> _Drift:
    """Return the simplest drift without which the error is evidently larger."""
    least = min(trial.error for trial in trials.values())
    return next(one for one, trial in trials.items() if trial.error <= DRIFT_GAIN * least)


def _wanted(trials: dict[_Drift, _Trial], creeping: dict[_Drift, _Trial]) -> tuple[_Drift, float]:
    """Return the drift that the logs ask for, and the size of one that could be in the place of creep.

    ``creeping`` has the same fits beside creep that follows the displacement, not the drive. Where the sensor
    is so good that the two differ by more than its noise, a drift stood in for the difference (0.3 % of the
    range on a stage that only creeps, in noise of 0.006 %). The highest order bends to whatever the gears
    leave over, and is no evidence there.
    """
    none = _Drift(0)
    few = {one: trial for one, trial in creeping.items() if one.order < HIGHEST_ORDER}
    wanted = none if _evident(few) == none else _evident(trials)
    # A polynomial of many orders bends to whatever the model leaves over.
    simple = [one for one in trials if one.warm_up is not None or one.order == 1]
    if wanted == none:
        simple = [one for one in simple if trials[one].creep <= CREEP_LEFT * trials[none].creep]
    best = min(simple, key=lambda one: trials[one].error, default=none)
    as_good = [one for one in simple if trials[one].error <= AS_GOOD * trials[best].error]
    best = min(as_good, key=lambda one: trials[one].creep, default=none)
    if wanted != none:
        return (best if trials[best].error < trials[wanted].error else wanted), 0.0
    if trials[none].error >= INSTEAD_GAIN * trials[best].error:
        return best, 0.0
    return none, trials[best].size if trials[best].size >= DOUBTFUL else 0.0


def _order(log: PreparedLog) -> int:
    """Order of the polynomial among the columns of drift; 0 for an offset alone."""
    return int(log.drift.shape[1]) - log.stretches - 1


def _columns(log: PreparedLog) -> Floats:
    """Columns of all drifts: the log's own polynomial, warm-ups, offsets of stretches; (samples, columns)."""
    own = _order(log) + 1
    assert log.seconds is not None
    parts = np.asarray(WARM_UPS if own > ORDERS_OF_A_WARM_UP else ()) * float(log.seconds.max())
    left = np.exp(-log.seconds[:, None] / parts)
    return np.hstack((log.drift[:, :own], left - left.mean(axis=0), log.drift[:, own:]))


def _places(log: PreparedLog, drift: _Drift) -> list[int]:
    """Which of a log's columns make up the drift, of no higher order than the log's own."""
    own = _order(log) + 1
    warm_ups = WARM_UPS if own > ORDERS_OF_A_WARM_UP else ()
    places = list(range(min(drift.order + 1, own)))
    if drift.warm_up in warm_ups:
        places.append(own + warm_ups.index(drift.warm_up))
    first = own + len(warm_ups)
    return [*places, *range(first, first + log.stretches)]


def _time_constants(logs: Sequence[PreparedLog]) -> tuple[float, ...]:
    """Time constants in seconds from two samples to a share of the longest log."""
    clocks = [log.seconds for log in logs if log.seconds is not None]
    steps = np.concatenate([np.diff(clock) for clock in clocks])
    least = 2.0 * float(np.median(steps[steps > 0.0]))
    tau = LONGEST * max(float(clock.max()) for clock in clocks)
    found = []
    while tau >= least:
        found.append(tau)
        tau /= TRIAL_RATIO
    return tuple(found[::-1])


def _scaled(logs: Sequence[PreparedLog]) -> list[PreparedLog]:
    """Return the logs with outputs from 0 to 1."""
    values = np.concatenate([log.output[log.used] for log in logs])
    bottom, height = float(values.min()), float(np.ptp(values))
    return [replace(log, output=(log.output - bottom) / height) for log in logs]


def _trials(
    logs: Sequence[PreparedLog], low: float, high: float, offered: Sequence[_Drift], creeping: bool = False
) -> dict[_Drift, _Trial]:
    """Fit each drift beside all memories, from statistics gathered once.

    ``creeping``: also beside memories of the displacement, by the measured one, as regressors of each log.
    """
    basis = Basis(TRIAL_SLOPES, low, high, TRIAL_SPLIT, _time_constants(logs))
    # Of a log much shorter than a memory the memory is its own negative, and explains whatever is in it.
    shortest = min(float(log.seconds[-1]) for log in logs if log.seconds is not None)
    offered_memories = [tau for tau in basis.time_constants if tau <= LONGEST * shortest]
    slow = tuple(offered_memories[-SLOW_MEMORIES:]) if creeping else ()
    some = _scaled(fewer_rows(logs))
    together = [replace(log, drift=np.hstack((_columns(log), _crept(log, slow)))) for log in some]
    statistics = gather(together, basis, TRIAL_SEGMENTS)
    return {drift: _trial(statistics, basis, some, drift, len(slow)) for drift in offered}


def _crept(log: PreparedLog, slow: tuple[float, ...]) -> Floats:
    """Return how far the displacement is from its own average over each time constant, free of offset."""
    crept = relaxed_drive(log.output, log.seconds, slow) - log.output[:, None]
    free: Floats = crept - crept.mean(axis=0)
    return free


def _trial(
    statistics: Statistics, basis: Basis, logs: Sequence[PreparedLog], drift: _Drift, crept: int
) -> _Trial:
    """Fit one drift with all memories, the better of growing and falling slopes."""
    gram, rows = statistics.total()
    begin = statistics.columns.total - statistics.columns.drift
    kept = [np.arange(begin)]
    tables = []
    for log in logs:
        table, places = _columns(log), _places(log, drift)
        memories = range(table.shape[1], table.shape[1] + crept)
        kept.append(begin + np.asarray([*places, *memories]))
        tables.append(table[:, places[1 : len(places) - log.stretches]])
        begin += table.shape[1] + crept
    chosen = np.concatenate([*kept, [begin]])
    gram = gram[np.ix_(chosen, chosen)]
    columns = replace(statistics.columns, drift=len(chosen) - len(kept[0]) - 1)
    everything = tuple(range(len(basis.time_constants)))
    structures = [Structure(s, everything, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS) for s in ("growing", "falling")]
    solutions = [solve(gram, columns, structure, rows) for structure in structures]
    errors = [squared_error(gram, solution.vector) for solution in solutions]
    best = solutions[int(np.argmin(errors))]
    slow = np.asarray(basis.time_constants) > SLOW / LONGEST * basis.time_constants[-1]
    sizes, first = [0.0], 0
    for place, table in zip(kept[1:], tables, strict=True):
        sizes.append(float(np.ptp(table @ best.drift[first + 1 : first + 1 + table.shape[1]])))
        first += len(place)
    return _Trial(float(np.sqrt(min(errors) / rows)), float(best.gains[slow].sum()), max(sizes))
