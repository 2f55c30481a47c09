"""Logs made ready for the fit: sign and scale, rows left out, folds of whole cycles, drift taken off.

A drift of the sensor is taken off only where nothing that the actuator does explains it
as well. A drift that is always fitted eats creep, which then is missing from the model;
a drift that is never fitted passes a warming sensor for creep. So polynomials in time
and the exponential of a warm-up are tried beside memories of all time constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.cleaning import (
    OF_NORMAL,
    SPIKE_SIGMAS,
    SPIKE_WINDOW,
    drive_range,
    spiked_rows,
)
from dbo_cli.hysteresis.identification.normal_equations import (
    Structure,
    solve,
    squared_error,
)
from dbo_cli.hysteresis.identification.recordings import (
    FEWEST_ROWS,
    KNOWN_PAST,
    MOST,
    Booleans,
    DriveShape,
    Floats,
    Integers,
    Recording,
    drive_shape,
    first_wiped_row,
    known_behind_gaps,
    one_amplitude,
    pieces_behind_gaps,
    runs,
)
from dbo_cli.hysteresis.identification.statistics import (
    SLOPE_CHOICES,
    TIME_CONSTANT_RATIO,
    Basis,
    PreparedLog,
    Statistics,
    drift_columns,
    drive_rows,
    equal_rows,
    fewer_rows,
    gather,
    relaxed_drive,
    row_weights,
    weighted,
    with_folds,
)
from dbo_cli.hysteresis.model_state import StartName
from dbo_cli.hysteresis.move_error import SMALLEST_TURN

WARM_UPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)
"""Of the log's length: time constants of a sensor that warms up. Measured: docs/choices.md."""
HIGHEST_ORDER = 4
"""Of the polynomial that describes a drift. Measured: docs/choices.md."""
# a warm-up is offered where a polynomial of this order is: it has a size and a time
# constant
WARMING = 2
LONGEST_MEMORY = 0.5
"""Longest time constant of a memory, as a part of the longest log. Measured: docs/choices.md."""

# chosen: with fewer the drift is what the model learns; 2 and 6 changed none of those
CYCLES_PER_ORDER = 3

DRIFT_GAIN = 1.2
"""A drift must lower the RMSE by at least this factor."""
INSTEAD_GAIN = 1.03
"""The factor in place of ``DRIFT_GAIN`` for a drift that takes the place of creep (``CREEP_LEFT``)."""
CREEP_LEFT = 0.8
"""A drift takes the place of creep where it leaves at most this part of the slow memories' gain. Measured:
docs/choices.md.
"""

AS_GOOD = 1.003
"""Of two drifts whose errors differ by less than this factor, the one that leaves less creep is taken.
Measured: docs/choices.md.
"""

DOUBTFUL = 0.007
"""Of the range: a drift this large that could be in the place of creep is worth a word. Measured:
docs/choices.md.
"""

TRIAL_SPLIT, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS = 8, 8, 1e-8
"""Gears of each slope in a trial and in any probing fit, segments and smoothness. Measured:
docs/choices.md.
"""
PROBE_SEGMENTS = 4
"""Segments of the asymmetry beside free slopes, where the history before a log is looked for. Measured:
docs/choices.md.
"""
PROBE_SMOOTHNESS = 1e-9
"""Of free slopes, from which outliers and drift are told. Measured: docs/choices.md."""

# of the longest memory: longer ones are slow, and can stand in for the shortest warm-up
SLOW = WARM_UPS[0] / LONGEST_MEMORY

LEVEL_MOVES = 0.02
"""Scatter of the cycles' mean levels, of the drive or of a slow memory, over the drive's range, from which
creep can be told from drift. Measured: docs/choices.md.
"""


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
    highest = 1
    if moving_level:
        highest = HIGHEST_ORDER
    elif one_amplitude([shape]):
        highest = 2
    return min(highest, shape.cycle_count // CYCLES_PER_ORDER)


def with_drift_needed(
    logs: Sequence[PreparedLog], low: float, high: float, one_level: bool
) -> tuple[list[PreparedLog], float]:
    """Return the logs with the columns of the drift they ask for, and the size of one they may have had.

    With one mean level of the drive, slow creep after the first cycle cannot be told
    from drift; the drift then stays, since a creep that is none does more harm on the
    next recording (measured on a warm-up of 3 %: 0.38 % of the range instead of 0.12).
    With several levels creep stays where both explain the logs; what drift could be in
    its place is the second answer, as a share of the range, 0 where that is little.
    """
    highest = max(_order(log) for log in logs)
    if highest == 0 or one_level or any(log.seconds is None for log in logs):
        return list(logs), 0.0
    offered = [_Drift(order) for order in range(highest + 1)]
    if highest >= WARMING:
        offered += [_Drift(0, part) for part in WARM_UPS]
    drifts = _tried(logs, low, high, offered)
    beside_creep = _tried(logs, low, high, offered, creeping=True)
    wanted, doubtful = _wanted(drifts, beside_creep)
    with_drift = [
        replace(log, drift=_columns(log)[:, _places(log, wanted)]) for log in logs
    ]
    return with_drift, doubtful


@dataclass(frozen=True)
class _Drift:
    """A polynomial of this order in time, and a warm-up with this time constant (of the log's length).

    Once it was tried: the RMS error, the gains of the slow memories together beside it,
    and the drift's size, the largest of the logs', peak to peak; both in units of the
    range.
    """

    order: int
    warm_up: float | None = None
    error: float = 0.0
    creep: float = 0.0
    size: float = 0.0

    @property
    def simple(self) -> bool:
        """Whether it cannot bend to whatever the model leaves over, as many orders do."""
        return self.warm_up is not None or self.order == 1


def _evident(drifts: Sequence[_Drift]) -> _Drift:
    """Return the simplest drift without which the error is evidently larger."""
    least = min(drift.error for drift in drifts)
    return next(drift for drift in drifts if drift.error <= DRIFT_GAIN * least)


def _wanted(
    drifts: Sequence[_Drift], beside_creep: Sequence[_Drift]
) -> tuple[_Drift, float]:
    """Return the drift that the logs ask for, and the size of one that could be in the place of creep.

    The first of ``drifts`` is none. ``beside_creep`` has the same fits beside creep that
    follows the displacement, not the drive. Where the sensor is so good that the two
    differ by more than its noise, a drift stood in for the difference (0.3 % of the
    range on a stage that only creeps, in noise of 0.006 %). The highest order bends to
    whatever the gears leave over, and is no evidence there.
    """
    none = wanted = drifts[0]
    few = [drift for drift in beside_creep if drift.order < HIGHEST_ORDER]
    if _evident(few) is not few[0]:
        wanted = _evident(drifts)
    simple = [drift for drift in drifts if drift.simple]
    if wanted is none:
        most = CREEP_LEFT * none.creep
        simple = [drift for drift in simple if drift.creep <= most]
    best = _least_creep(simple, none)
    if wanted is not none:
        return (best if best.error < wanted.error else wanted), 0.0
    if none.error >= INSTEAD_GAIN * best.error:
        return best, 0.0
    return none, best.size if best.size >= DOUBTFUL else 0.0


def _least_creep(drifts: Sequence[_Drift], none: _Drift) -> _Drift:
    """Return the drift that leaves least creep, of those as good as the best; ``none`` of none."""
    if not drifts:
        return none
    most = AS_GOOD * min(drift.error for drift in drifts)
    as_good = [drift for drift in drifts if drift.error <= most]
    return min(as_good, key=lambda drift: drift.creep)


def _order(log: PreparedLog) -> int:
    """Order of the polynomial among the columns of drift; 0 for an offset alone."""
    return int(log.drift.shape[1]) - log.stretches - 1


def _warm_ups(log: PreparedLog) -> tuple[float, ...]:
    """Return the time constants of the warm-ups that a log can tell, as parts of its length."""
    return WARM_UPS if _order(log) >= WARMING else ()


def _columns(log: PreparedLog) -> Floats:
    """Columns of all drifts: the log's own polynomial, warm-ups, offsets of stretches; (samples, columns)."""
    terms = _order(log) + 1
    assert log.seconds is not None
    taus = np.asarray(_warm_ups(log)) * float(log.seconds.max())
    left = np.exp(-log.seconds[:, None] / taus)
    return np.hstack(
        (log.drift[:, :terms], left - left.mean(axis=0), log.drift[:, terms:])
    )


def _places(log: PreparedLog, drift: _Drift) -> list[int]:
    """Which of a log's columns make up the drift, of no higher order than the log's own."""
    terms = _order(log) + 1
    warm_ups = _warm_ups(log)
    places = list(range(min(drift.order + 1, terms)))
    if drift.warm_up in warm_ups:
        places.append(terms + warm_ups.index(drift.warm_up))
    first = terms + len(warm_ups)
    return [*places, *range(first, first + log.stretches)]


def _time_constants(logs: Sequence[PreparedLog]) -> tuple[float, ...]:
    """Time constants in seconds from two samples to a share of the longest log."""
    clocks = [log.seconds for log in logs if log.seconds is not None]
    steps = np.concatenate([np.diff(clock) for clock in clocks])
    least = 2.0 * float(np.median(steps[steps > 0.0]))
    tau = LONGEST_MEMORY * max(float(clock.max()) for clock in clocks)
    taus = []
    while tau >= least:
        taus.append(tau)
        tau /= TIME_CONSTANT_RATIO
    return tuple(taus[::-1])


def _scaled(logs: Sequence[PreparedLog]) -> list[PreparedLog]:
    """Return the logs with outputs from 0 to 1."""
    values = np.concatenate([log.output[log.used] for log in logs])
    bottom, height = float(values.min()), float(np.ptp(values))
    return [replace(log, output=(log.output - bottom) / height) for log in logs]


def _tried(
    logs: Sequence[PreparedLog],
    low: float,
    high: float,
    offered: Sequence[_Drift],
    creeping: bool = False,
) -> list[_Drift]:
    """Fit each drift beside all memories, from statistics gathered once.

    ``creeping``: also beside memories of the displacement, by the measured one, as
    regressors of each log.
    """
    basis = _trial_basis(low, high, _time_constants(logs))
    slow = _slow_memories(logs, basis) if creeping else ()
    some = _scaled(fewer_rows(logs))
    together = []
    for log in some:
        drift = np.hstack((_columns(log), _crept(log, slow)))
        together.append(replace(log, drift=drift))
    statistics = gather(together, basis, TRIAL_SEGMENTS)
    return [_trial(statistics, basis, some, drift, len(slow)) for drift in offered]


def _slow_memories(logs: Sequence[PreparedLog], basis: Basis) -> tuple[float, ...]:
    """Return the slow time constants that are short enough for each log.

    Of a log much shorter than a memory the memory is its own negative, and explains
    whatever is in it.
    """
    lengths = [float(log.seconds[-1]) for log in logs if log.seconds is not None]
    longest = LONGEST_MEMORY * min(lengths)
    possible = [tau for tau in basis.time_constants if tau <= longest]
    if not possible:
        return ()
    return tuple(tau for tau in possible if tau > SLOW * possible[-1])


def _trial_basis(
    low: float, high: float, time_constants: tuple[float, ...] = ()
) -> Basis:
    return Basis(SLOPE_CHOICES[0], low, high, TRIAL_SPLIT, time_constants)


def _crept(log: PreparedLog, slow: tuple[float, ...]) -> Floats:
    """Return how far the displacement is from its own average over each time constant, free of offset."""
    crept = relaxed_drive(log.output, log.seconds, slow) - log.output[:, None]
    free: Floats = crept - crept.mean(axis=0)
    return free


def _trial(
    statistics: Statistics,
    basis: Basis,
    logs: Sequence[PreparedLog],
    drift: _Drift,
    crept: int,
) -> _Drift:
    """Fit one drift with all memories, the better of growing and falling slopes."""
    gram, rows = statistics.total()
    begin = statistics.columns.total - statistics.columns.drift
    parts = [np.arange(begin)]
    tables = []
    for log in logs:
        table, places = _columns(log), _places(log, drift)
        memories = range(table.shape[1], table.shape[1] + crept)
        parts.append(begin + np.asarray([*places, *memories]))
        tables.append(table[:, places[1 : len(places) - log.stretches]])
        begin += table.shape[1] + crept
    chosen = np.concatenate([*parts, [begin]])
    gram = gram[np.ix_(chosen, chosen)]
    columns = replace(statistics.columns, drift=len(chosen) - len(parts[0]) - 1)
    everything = tuple(range(len(basis.time_constants)))
    solutions, errors = [], []
    for slopes in ("growing", "falling"):
        structure = Structure(slopes, everything, TRIAL_SEGMENTS, TRIAL_SMOOTHNESS)
        solution = solve(gram, columns, structure, rows)
        solutions.append(solution)
        errors.append(squared_error(gram, solution.vector))
    best = solutions[int(np.argmin(errors))]
    taus = np.asarray(basis.time_constants)
    slow = taus > SLOW * taus[-1]
    size, first = 0.0, 0
    for part, table in zip(parts[1:], tables, strict=True):
        terms = best.drift[first + 1 : first + 1 + table.shape[1]]
        size = max(size, float(np.ptp(table @ terms)))
        first += len(part)
    error = float(np.sqrt(min(errors) / rows))
    return replace(drift, error=error, creep=float(best.gains[slow].sum()), size=size)


PROBE_FOLLOWS = 0.005
"""Of the log's range, left on quarters that a probing fit was made without. Springs that slip from rest were
told from gears at their lower end (1.2 times the error with the early rows) up to
0.0027, and not where a late sensor left 0.011.
"""
EARLY_SHARE = 0.1  # of the log's rows: fewer are not worth the question
# of the rows behind an unknown history: each is predicted with that history and without
# it
QUARTERS = 4
FOLDS = 10
"""Most folds that the cycles are dealt into, and most stretches of a history that is left open. Measured:
docs/choices.md.
"""
PARTS = 8
"""Parts of a cycle with most of the rows, left out in turn. Measured: docs/choices.md."""
MOST_OUTLIERS = 0.02
"""Of the rows: more are what the actuator does. Measured: docs/choices.md."""
CLIPPED_STEEPNESS = 0.35
"""Slope just before the displacement stands still, over the mean one, above which the sensor is to blame.
Measured: docs/choices.md.
"""

STARTS: tuple[StartName, ...] = ("settled", "empty", "full")


@dataclass(frozen=True)
class Prepared:
    """All logs made ready, with what turns the normalised output back into displacement.

    displacement = offset + scale * output; ``scale`` carries the sign of the gain.
    ``doubtful_drift`` is the size of a drift that could be in the place of creep, as a
    share of the range; 0: little. ``notes`` say in words what was left out and why.
    """

    logs: tuple[PreparedLog, ...]
    shapes: tuple[DriveShape, ...]
    low: float
    high: float
    scale: float
    offset: float
    doubtful_drift: float = 0.0
    notes: list[str] = field(default_factory=list)

    @property
    def one_amplitude(self) -> bool:
        """Whether all cycles of all logs go over one and the same range."""
        return one_amplitude(self.shapes)

    @property
    def span(self) -> float:
        """Range of the drive over all logs, in its unit."""
        return self.high - self.low


def clipped_sensor(displacement: Floats, voltage: Floats) -> Booleans:
    """Rows where the displacement stands at its own extreme while the drive moves on: out of range.

    An actuator may stand still there, too (an end stop, a shape-memory wire below its
    transition). It comes to rest by and by; a clipped sensor is cut off in full motion.
    """
    stuck = np.zeros(len(displacement), bool)
    moving = np.abs(np.diff(voltage, prepend=voltage[0])) > 0.0
    usual = _steepness(displacement, voltage)
    for extreme in (displacement.min(), displacement.max()):
        runs_at_extreme: list[tuple[int, int]] = []
        before: list[float] = []
        for begin, end in runs((displacement == extreme) & moving):
            swing = float(np.ptp(voltage[begin:end]))
            if end - begin >= 5 and swing > 0.01 * float(np.ptp(voltage)):
                runs_at_extreme.append((begin, end))
                near = slice(max(begin - max((end - begin) // 5, 3), 0), begin + 1)
                if begin - near.start >= 3:
                    before.append(_steepness(displacement[near], voltage[near]))
        if runs_at_extreme and (
            not before or float(np.median(before)) > CLIPPED_STEEPNESS * usual
        ):
            for begin, end in runs_at_extreme:
                stuck[begin:end] = True
    return stuck


def _steepness(displacement: Floats, voltage: Floats) -> float:
    """Displacement travelled for each volt travelled."""
    path = float(np.abs(np.diff(voltage)).sum())
    if path == 0.0:
        return 0.0
    return float(np.abs(np.diff(displacement)).sum()) / path


def without_outliers(values: Floats) -> Floats:
    """Values cut to their middle 98 %, so that a spike turns neither sign nor scale over."""
    cut: Floats = np.clip(values, *np.percentile(values, [1.0, 99.0]))
    return cut if np.ptp(cut) > 0.0 else values


def gain_sign(recordings: Sequence[Recording]) -> float:
    """+1 or -1: whether the displacement grows or falls with the voltage, over all logs."""
    together = 0.0
    for log in recordings:
        v = log.voltage - log.voltage.mean()
        y = without_outliers(log.displacement)
        together += float(v @ (y - y.mean()))
    return -1.0 if together < 0.0 else 1.0


def signed_range(recordings: Sequence[Recording]) -> float:
    """Return the largest range of a displacement, outliers aside, with the sign of the gain."""
    return gain_sign(recordings) * max(
        float(np.ptp(without_outliers(log.displacement))) for log in recordings
    )


def _stretches(rows: Booleans, count: int) -> Integers:
    """Return the number of each row's stretch where these rows are cut into ``count`` of equal length."""
    stretch: Integers = (np.cumsum(rows) - 1) * count // max(int(rows.sum()), 1)
    return np.clip(stretch, 0, count - 1)


def folds_of(
    shape: DriveShape, usable: Booleans, first_fold: int, wanted: int
) -> Integers:
    """Fold of each row: whole cycles dealt out in turn; -1 where the row is not used.

    Rows before the first and after the last whole cycle go with their neighbour. A log
    with fewer than three cycles to use is cut into four stretches of equal length
    instead, and so is a cycle that holds most of the rows: what it alone went through
    could not be predicted without it.
    """
    samples = len(usable)
    cycle = np.searchsorted(shape.cycles, np.arange(samples), side="right") - 1
    cycle = np.clip(cycle, 0, max(shape.cycle_count - 1, 0))
    counts = np.bincount(cycle[usable], minlength=1)
    if np.count_nonzero(counts) < 3:
        fold = _stretches(usable, min(wanted, 4))
    else:
        long = cycle == int(counts.argmax())
        cut = np.where(
            long & (counts.max() > MOST * counts.sum()),
            _stretches(usable & long, PARTS),
            0,
        )
        piece = PARTS * cycle + cut
        present = np.unique(piece[usable])
        fold = np.searchsorted(present, piece) % max(min(wanted, len(present)), 1)
    return np.where(usable, fold + first_fold, -1)


def prepare(
    recordings: Sequence[Recording],
    skip_seconds: float,
    ends: tuple[float, float] | None = None,
    at_rest: bool = True,
) -> Prepared:
    """Make logs ready: sign, rows to leave out, start states, drift taken out, output scaled to 0..1.

    ``ends`` are the least and the greatest voltage of the drive, where they are known
    from before cleaning. ``at_rest``: whether a drive that begins at one of its ends
    may begin there at rest.

    Raises
    ------
    FitError
        Where too few rows are left.
    """
    low, high = drive_range(recordings) if ends is None else ends
    scale = signed_range(recordings)
    notes: list[str] = []
    opened = [_opened(log, scale, skip_seconds, at_rest, notes) for log in recordings]
    shapes = tuple(drive_shape(log.voltage) for log in recordings)
    dealt = _dealt(_weighted(opened, recordings, notes), shapes)
    parts = [
        _with_offsets_behind_gaps(recording, log, low, high)
        for recording, log in zip(recordings, dealt, strict=True)
    ]
    # Where the rows under the unknown history are left out anyway, the start state
    # makes no difference.
    begun = []
    for log in parts:
        if not log.transient_rows:
            log = _with_history(log, low, high, notes)
        begun.append(log)
    moves = [
        level_moves(shape, log.voltage)
        for shape, log in zip(shapes, begun, strict=True)
    ]
    drifting, doubtful = with_drift_needed(begun, low, high, not any(moves))
    flat = _without_drift_and_spikes(drifting, low, high, notes)
    bottom = min(float(log.output[log.used].min()) for log in flat)
    top = max(float(log.output[log.used].max()) for log in flat)
    ready = tuple(
        replace(log, output=(log.output - bottom) / (top - bottom)) for log in flat
    )
    return Prepared(
        ready,
        shapes,
        low,
        high,
        scale=scale * (top - bottom),
        offset=scale * bottom,
        doubtful_drift=doubtful,
        notes=notes,
    )


def _opened(
    recording: Recording,
    scale: float,
    skip_seconds: float,
    at_rest: bool,
    notes: list[str],
) -> PreparedLog:
    """Return a log in units of ``scale`` with the rows that can take part, all in one fold."""
    voltage, seconds = recording.voltage, recording.seconds()
    usable, transient = _known_rows(recording, skip_seconds, at_rest, notes)
    usable, faulty, clipped = _sound_rows(recording, usable, notes)
    shape = drive_shape(voltage)
    order = drift_order(shape, seconds is not None, level_moves(shape, voltage))
    clock = seconds
    if clock is None:
        clock = np.arange(len(voltage), dtype=float)
    return PreparedLog(
        recording.name,
        voltage,
        recording.displacement / scale,
        seconds,
        np.where(usable, 0, -1),
        drift_columns(clock, order),
        "settled",
        rows=recording.rows,
        transient_rows=transient,
        outlier_rows=faulty,
        clipped_rows=clipped,
    )


def _weighted(
    logs: Sequence[PreparedLog], recordings: Sequence[Recording], notes: list[str]
) -> list[PreparedLog]:
    """Return the logs with the weights of their rows, by the recordings' uncertainty."""
    used = [log.used for log in logs]
    weights = row_weights([recording.uncertainty for recording in recordings], used)
    _check_weights(weights, used, notes)
    return [
        replace(log, weights=roots) for log, roots in zip(logs, weights, strict=True)
    ]


def _dealt(
    logs: Sequence[PreparedLog], shapes: Sequence[DriveShape]
) -> list[PreparedLog]:
    """Return the logs with their cycles dealt into folds, each log in proportion to its rows."""
    total = sum(len(log.voltage) for log in logs)
    dealt = []
    first = 0
    for log, shape in zip(logs, shapes, strict=True):
        share = max(2, round(FOLDS * len(log.voltage) / total))
        folds = folds_of(shape, log.used, first, min(share, FOLDS))
        first = int(folds.max()) + 1
        dealt.append(replace(log, fold=folds))
    return dealt


def _check_weights(
    weights: Sequence[Floats | None], used: Sequence[Booleans], notes: list[str]
) -> None:
    """Say what the rows' weights come to, or refuse (FitError) where a few rows outweigh all others."""
    roots = []
    for weights_of_log, rows in zip(weights, used, strict=True):
        if weights_of_log is not None:
            roots.append(weights_of_log[rows])
    if not roots:
        return
    together = np.concatenate(roots)
    worth = equal_rows(together)
    ratio = float(together.max() / together.min())
    if worth < FEWEST_ROWS:
        raise FitError(
            f"`uncertainty`: a few rows outweigh all others ({together.size:,} rows tell as much as "
            f"{worth:.0f} of equal uncertainty): their standard deviations are {ratio:.3g} times apart"
        )
    notes.append(
        f"rows weighted by their uncertainty, which differs by up to {ratio:.3g} times: they tell as much as "
        f"{worth:,.0f} of equal uncertainty, and the fit's RMSE is weighted, too"
    )


def _known_rows(
    log: Recording, skip_seconds: float, at_rest: bool, notes: list[str]
) -> tuple[Booleans, int]:
    """Return the rows whose history is known, and how many at the beginning were left out because it is not.

    Rows that the user skips do not count.
    """
    samples = len(log.voltage)
    usable = _not_skipped(log, skip_seconds)
    skipped = samples - int(usable.sum())
    wiped = first_wiped_row(log.voltage)
    early = np.arange(samples) < wiped
    moving = samples - int(np.argmax(log.voltage != log.voltage[0]))
    mostly_known = samples - wiped >= (1.0 - KNOWN_PAST) * moving
    unknown = wiped > skipped and mostly_known
    if unknown and at_rest:
        sound = usable if log.faulty is None else usable & ~log.faulty
        unknown = not _predicts_later_rows(log, sound, early)
    transient = 0
    if unknown:
        usable &= ~early
        transient = wiped - skipped
        notes.append(
            f"{log.name}: rows {log.row(skipped)} to {log.row(wiped - 1)} left out: before the drive had "
            "been at both ends of its range, the actuator's history is unknown"
        )
    return _left_behind_gaps(log, usable, notes), transient


def _not_skipped(log: Recording, skip_seconds: float) -> Booleans:
    """Return the rows from ``skip_seconds`` on."""
    if skip_seconds <= 0.0:
        return np.ones(len(log.voltage), bool)
    seconds = log.seconds()
    if seconds is None:
        raise FitError(
            f"{log.name}: `skip` needs a clock: name the time column (`time`) or give `sample_rate`"
        )
    return seconds >= skip_seconds


def _sound_rows(
    log: Recording, usable: Booleans, notes: list[str]
) -> tuple[Booleans, int, int]:
    """Return the usable rows that are neither faulty nor clipped, and how many are either.

    Raises
    ------
    FitError
        Too few are left.
    """
    faulty = 0
    if log.faulty is not None:
        faulty = int((usable & log.faulty).sum())
        usable = usable & ~log.faulty
    clipped = clipped_sensor(log.displacement, log.voltage) & usable
    if clipped.any():
        usable = usable & ~clipped
        notes.append(
            f"{log.name}: {int(clipped.sum())} rows left out: the sensor stands at the end of its range "
            "while the drive moves (clipped); move the sensor or lower its gain and record again"
        )
    if int(usable.sum()) < FEWEST_ROWS:
        raise FitError(
            f"{log.name}: {int(usable.sum())} usable rows are too few to identify from: record longer, or "
            "skip less"
        )
    return usable, faulty, int(clipped.sum())


def _predicts_later_rows(log: Recording, usable: Booleans, early: Booleans) -> bool:
    """Return whether rows from before both ends were visited help to predict those behind.

    The drive begins at one of its ends, so all gears are known from the first row on.
    Whether the actuator was at rest there, too, is asked of quarters of the later rows,
    each predicted by a fit to the rest with the early rows and without them. A probing
    fit that follows the log badly (a sensor that is late, say) cannot tell.
    """
    start = _start_at_an_end(log.voltage)
    later = usable & ~early
    if start is None or int((usable & early).sum()) < EARLY_SHARE * len(early):
        return False
    if int(later.sum()) < FEWEST_ROWS:
        return False
    fold = np.where(usable, 0, -1)
    fold[later] = 1 + _stretches(later, QUARTERS)[later]
    low, high = float(log.voltage.min()), float(log.voltage.max())
    scale = signed_range([log])
    output, drift = log.displacement / scale, np.ones((len(fold), 1))
    roots = row_weights([log.uncertainty], [usable])[0]
    probe = PreparedLog(
        log.name, log.voltage, output, log.seconds(), fold, drift, start, weights=roots
    )
    statistics, structure = _probe(probe, low, high)
    errors = np.zeros(2)
    for quarter in range(1, QUARTERS + 1):
        for place, left_out in enumerate(([quarter], [quarter, 0])):
            fitted_folds = [k for k in range(QUARTERS + 1) if k not in left_out]
            gram = np.sum([statistics.grams[k] for k in fitted_folds], axis=0)
            rows = sum(statistics.rows[k] for k in fitted_folds)
            try:
                vector = solve(gram, statistics.columns, structure, rows).vector
            except FitError:
                return False
            errors[place] += squared_error(statistics.grams[quarter], vector)
    follows = errors[1] <= PROBE_FOLLOWS**2 * int(later.sum())
    return bool(follows and errors[0] <= errors[1])


def _start_at_an_end(voltage: Floats) -> StartName | None:
    """Return the state of gears whose drive begins at one of its ends, None where it begins between them."""
    low, high = float(voltage.min()), float(voltage.max())
    near = SMALLEST_TURN / 4.0 * (high - low)
    if voltage[0] <= low + near:
        return "empty"
    return "full" if voltage[0] >= high - near else None


def _left_behind_gaps(log: Recording, usable: Booleans, notes: list[str]) -> Booleans:
    """Return the usable rows whose history gaps in time do not hide, and say what was left out."""
    known, pieces = known_behind_gaps(log, usable), pieces_behind_gaps(log)
    lost = int(usable.sum() - known.sum())
    if pieces:
        gaps = f"{len(pieces)} gaps, the first" if len(pieces) > 1 else "a gap"
        turned = f"{log.name}: {gaps} before row {log.row(pieces[0][0])}, in which the drive may have turned"
        unknown = "the actuator's history is unknown behind it; record without pauses"
        until = (
            f"{lost} rows left out, until it had been at both ends of its range again"
        )
        notes.append(f"{turned}: {until if lost else unknown}")
    return known


def _with_offsets_behind_gaps(
    recording: Recording, log: PreparedLog, low: float, high: float
) -> PreparedLog:
    """Return the log with an offset of their own for pieces behind gaps, where that explains it much better.

    Where a piece does not reach both ends of the log's range, what was in the gap can
    leave an offset in it.
    """
    offsets = []
    for begin, known, end in pieces_behind_gaps(recording):
        reaches = np.ptp(log.voltage[begin:end]) >= (1.0 - SMALLEST_TURN) * np.ptp(
            log.voltage
        )
        if not reaches and log.used[known:end].any():
            offsets.append(
                (np.arange(len(log.fold)) >= begin) & (np.arange(len(log.fold)) < end)
            )
    if not offsets:
        return log
    opened = replace(
        log, drift=np.column_stack((log.drift, *offsets)), stretches=len(offsets)
    )
    better = _probe_error(opened, low, high) < MOST * _probe_error(log, low, high)
    return opened if better else log


def _with_history(
    log: PreparedLog, low: float, high: float, notes: list[str]
) -> PreparedLog:
    """Return the log with the start state that explains it best, or with its history left open.

    Where the drive goes further than ever before in the log, it walks on what an
    earlier history left behind; in between, that history shows as an offset alone. So
    it can be left open: rows at new extremes are left out, and each stretch between
    them has an offset of its own.
    """
    starts = [replace(log, start=start) for start in STARTS]
    errors = [_probe_error(begun, low, high) for begun in starts]
    best = int(np.argmin(errors))
    if errors[best] >= 0.99 * errors[0]:  # chosen: no evident gain
        best = 0
    opened = None if log.stretches else _left_open(log)
    if opened is not None and _probe_error(opened, low, high) < MOST * errors[best]:
        lost = int(log.used.sum() - opened.used.sum())
        notes.append(
            f"{log.name}: {lost} rows at new extremes of the drive left out: no known start explains them, "
            "so the history before the log is left open"
        )
        return opened
    return starts[best]


def _left_open(log: PreparedLog) -> PreparedLog | None:
    """Return the log without rows at new extremes, one offset a stretch; None where little would be left."""
    near = 1e-3 * float(np.ptp(log.voltage))  # chosen
    top = np.maximum.accumulate(log.voltage)
    bottom = np.minimum.accumulate(log.voltage)
    inside = (log.voltage < top - near) & (log.voltage > bottom + near)
    turns = np.diff(inside.astype(np.int8), prepend=0) > 0
    stretch = np.cumsum(turns) - 1
    fold = np.where(inside, log.fold, -1)
    present = np.unique(stretch[fold >= 0])
    if len(present) > FOLDS or (fold >= 0).sum() < max(
        0.5 * log.used.sum(), FEWEST_ROWS
    ):
        return None
    # the last stretch's offset is the model's
    offsets = (stretch[:, None] == present[:-1]).astype(float)
    return replace(
        log,
        fold=fold,
        drift=np.hstack((log.drift, offsets)),
        stretches=offsets.shape[1],
    )


def _probe_error(log: PreparedLog, low: float, high: float) -> float:
    """RMSE of a probing fit, asymmetry and all, to one log, as a share of the log's own range.

    Without memories a lag and creep passed for an unknown history, and the rows at new
    extremes were lost: after 60 logs of growing triangles new moves erred 1.1 times as
    much, after one of them 8 times.
    """
    trial, structure = _probe(log, low, high)
    _, error = trial.solved(structure)
    return float(np.sqrt(error)) * float(np.ptp(log.output[log.used]))


def _probe(log: PreparedLog, low: float, high: float) -> tuple[Statistics, Structure]:
    """Return the products of one log, its output scaled to 0..1, and the structure of a probing fit."""
    taus = () if log.seconds is None else _time_constants([log])
    values = log.output[log.used]
    scaled = replace(log, output=(log.output - values.min()) / np.ptp(values))
    trial = gather(fewer_rows([scaled]), _trial_basis(low, high, taus), PROBE_SEGMENTS)
    memories = tuple(range(trial.columns.memories))
    return trial, Structure("free", memories, PROBE_SEGMENTS, PROBE_SMOOTHNESS)


def _without_drift_and_spikes(
    logs: Sequence[PreparedLog], low: float, high: float, notes: list[str]
) -> list[PreparedLog]:
    """Fit gears and drift once, take the drift out of the outputs, and leave out rows far from the fit."""
    drifts, residuals = _drift_and_rest(logs, low, high)
    kept = [
        _without_spikes(log, residual, notes)
        for log, residual in zip(logs, residuals, strict=True)
    ]
    if any(after is not before for after, before in zip(kept, logs, strict=True)):
        drifts, _ = _drift_and_rest(kept, low, high)
    flat = [
        replace(log, output=log.output - drift)
        for log, drift in zip(kept, drifts, strict=True)
    ]
    return with_folds(flat, [log.fold for log in flat])


def _drift_and_rest(
    logs: Sequence[PreparedLog], low: float, high: float
) -> tuple[list[Floats], list[Floats]]:
    """Fit gears and drift; return the drift of each log, and what both leave (no number where none was made).

    The first log keeps its level: the model has it.
    """
    basis = _trial_basis(low, high)
    structure = Structure("free", (), 1, PROBE_SMOOTHNESS)
    solution, _ = gather(fewer_rows(logs), basis, 1).solved(structure)
    drifts = []
    residuals: list[Floats] = []
    begin = 0
    for log in logs:
        terms = solution.drift[begin : begin + log.drift.shape[1]]
        begin += log.drift.shape[1]
        fitted = log.drift @ terms
        residual = np.full(len(log.output), np.nan)
        for first, last, drive in drive_rows(
            basis, log.voltage, log.seconds, log.start, log.used
        ):
            without_gears = log.output[first:last] - drive @ solution.heights
            residual[first:last] = without_gears - fitted[first:last]
        residuals.append(residual)
        drifts.append(fitted - solution.drift[0])
    return drifts, residuals


def _without_spikes(
    log: PreparedLog, residual: Floats, notes: list[str]
) -> PreparedLog:
    """Return a log without the rows that stand far from the fit and from their own neighbours."""
    used = log.used
    residual = weighted(residual, log.weights)
    values = residual[used]
    centre = float(np.median(values))
    sigma = OF_NORMAL * float(np.median(np.abs(values - centre)))
    far = used & (np.abs(residual - centre) > SPIKE_SIGMAS * max(sigma, 1e-12))
    # No drive turns in a residual: more of them are seen together than in the
    # displacement itself (three spikes among four rows left 0.6 % of the range).
    far &= spiked_rows(np.where(used, residual, centre), 3 * SPIKE_WINDOW)
    count = int(far.sum())
    if not 0 < count <= MOST_OUTLIERS * int(used.sum()):
        return log
    notes.append(
        f"{log.name}: {count} outlying rows left out (more than {SPIKE_SIGMAS:g} standard "
        f"deviations from the fit; first at row {log.row(int(np.argmax(far)))})"
    )
    fold = np.where(far, -1, log.fold)
    return replace(log, fold=fold, outlier_rows=log.outlier_rows + count)
