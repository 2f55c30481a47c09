"""What to expect of a model on new moves inside the range: the figure that a user relies on.

Two things are added as squares. What the logs themselves can tell: the error on amplitudes, levels and speeds
left out of the fit in turn. And what they cannot tell: other models, with another delay, memory, bend or
asymmetry, may explain the logs as well and yet predict other things; how far they go apart on invented moves
(random nested turns over the whole range, at the speeds of the logs) is what a log of one amplitude hides.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import (
    Solution,
    Structure,
    solve,
    squared_error,
    squared_error_free_of,
)
from dbo_cli.hysteresis.identification.recordings import Floats, Integers, drive_shape
from dbo_cli.hysteresis.identification.refinement import asymmetry, corners
from dbo_cli.hysteresis.identification.regressors import Basis, DriveRows
from dbo_cli.hysteresis.identification.statistics import PreparedLog, Statistics, fewer_rows, gather

# Fitted together on 61 invented recordings of seed 1 (benchmarks/invented_actuators.py): with these two the
# actual error over the expected one is 0.95 in the median after drives of many amplitudes, 0.9 after others.
SPREAD_WEIGHT = 0.6
LIKELIHOOD_WIDTH = 0.1  # a model whose RMSE is this share above the chosen one's counts exp(-1)
MAX_RATIO = 2.0  # a group without which the fit falls apart says how far one cannot extrapolate, not this

LARGE = 0.75  # of the drive's range: without the swings above, the last gears would never be seen
SMALL = 0.35  # of the drive's range: divides the swings that can be left out into two amplitudes
LEVELS = (0.4, 0.6)  # of the drive's range: divide them into low, middle and high
FEWEST_SWINGS = 4  # twice up and down: of fewer the error that came was up to ten times the one expected
FEWEST_GROUP_ROWS = 20
FEWEST_REST_ROWS = 100
MOVES = 26  # swings of the invented drive: enough that another seed changes the spread by a few per cent
MOVE_ROWS = 3000
MOVE_SEED = 20180701


@dataclass(frozen=True)
class Expectation:
    """The expected error and its parts, in the normalised output.

    ``held_out`` is the equation error on what was left out, ``fitted`` that on what was fitted, ``spread``
    how far other models go apart; ``left_out`` names what was left out; ``swings`` are those of the logs.
    """

    held_out: float
    fitted: float
    spread: float
    left_out: tuple[str, ...]
    swings: int

    def rmse(self, delivered: float) -> float | None:
        """Return the expected RMSE of a model whose output error on its own logs is ``delivered``.

        None where the logs have no way up and down that another one could predict. The equation error counts
        on the wrong side of the asymmetry; their ratio brings it over.
        """
        if self.swings < FEWEST_SWINGS:
            return None
        return float(np.hypot(delivered * self.held_out / self.fitted, self.spread))

    def words(self) -> str:
        """Say what the figure rests on, or why there is none."""
        if self.swings < FEWEST_SWINGS:
            return "the logs go up and down less than twice, so nothing could be left out: record more"
        spread = "how far other models that explain the logs as well go apart"
        if not self.left_out:
            return f"nothing but whole cycles could be left out of the fit, and {spread}"
        return f"{' and '.join(self.left_out)} left out of the fit in turn, and {spread}"


def expect(
    logs: Sequence[PreparedLog],
    basis: Basis,
    structure: Structure,
    cycles: float,
    delays: tuple[float, float] | None,
) -> Expectation:
    """Estimate the error on new moves.

    Parameters
    ----------
    logs : as they were fitted
    basis, structure : what the model was fitted with
    cycles : cross-validated equation error over whole cycles, in the normalised output
    delays : the delays in seconds that explain the logs as well, None where none was looked for
    """
    some = fewer_rows(logs)
    statistics = gather(some, basis, structure.segments)
    gram, rows = statistics.total()
    own = solve(gram, statistics.columns, structure, rows)
    fitted = max(float(np.sqrt(squared_error(gram, own.vector) / rows)), 1e-12)
    held_out, left_out = groups_left_out(some, basis, structure, max(cycles, fitted))
    spread = _spread(some, basis, structure, statistics, own, fitted, delays)
    swings = sum(len(drive_shape(log.voltage).turns) + 1 for log in logs)
    return Expectation(held_out, fitted, spread, left_out, swings)


# --- what the logs can tell ---


def groups_left_out(
    logs: Sequence[PreparedLog], basis: Basis, structure: Structure, cycles: float
) -> tuple[float, tuple[str, ...]]:
    """RMS error of groups of swings left out, the worst of three ways to group, and the ways there were."""
    worst, names = cycles**2, []
    for name, labels in groupings(logs, basis):
        grouped = [
            replace(log, fold=np.where(log.used, label, -1)) for log, label in zip(logs, labels, strict=True)
        ]
        statistics = gather(grouped, basis, structure.segments)
        found: list[tuple[float, int]] = []
        for group in range(1, len(statistics.grams)):
            rest, rows = statistics.total(leave_out=group)
            mine = statistics.rows[group]
            if mine < FEWEST_GROUP_ROWS or rows < max(FEWEST_REST_ROWS, mine / 5):
                continue
            try:
                vector = solve(rest, statistics.columns, structure, rows).vector
            except FitError:
                continue
            left = squared_error_free_of(statistics.grams[group], vector, statistics.nuisance[group]) / mine
            found.append((min(left, (MAX_RATIO * cycles) ** 2), mine))
        if found:
            names.append(name)
            worst = max(worst, sum(error * mine for error, mine in found) / sum(mine for _, mine in found))
    return float(np.sqrt(worst)), tuple(names)


def groupings(logs: Sequence[PreparedLog], basis: Basis) -> Iterator[tuple[str, list[Integers]]]:
    """Yield each way to group swings: its name, and for each log the group of every row, 0 for none."""
    swings = [_swings(log, basis) for log in logs]
    counts = np.concatenate([one.rows for one in swings])
    speeds = np.repeat(np.concatenate([one.speed for one in swings]), counts)
    slow, fast = np.quantile(speeds, [1 / 3, 2 / 3])
    for name in ("amplitudes", "levels", "speeds"):
        labels = []
        for one in swings:
            small = one.amplitude < LARGE
            if name == "amplitudes":
                label = np.where(one.amplitude < SMALL, 1, 2)
            elif name == "levels":
                label = 1 + np.searchsorted(LEVELS, one.level)
            else:
                label = np.where(one.speed < slow, 1, np.where(one.speed > fast, 2, 0))
            labels.append(np.repeat(np.where(small, label, 0), one.rows))
        if any(label.any() for label in labels):
            yield name, labels


@dataclass(frozen=True)
class _Swings:
    """Swings between turns: amplitude and level in units of the range, speed as a logarithm, rows of each."""

    amplitude: Floats
    level: Floats
    speed: Floats
    rows: Integers


def _swings(log: PreparedLog, basis: Basis) -> _Swings:
    """Return the swings of one log; the rows before the first turn are one, those after the last another."""
    edges = np.concatenate(([0], drive_shape(log.voltage).turns, [len(log.voltage)]))
    ends = log.voltage[np.minimum(edges, len(log.voltage) - 1)]
    amplitude = np.abs(np.diff(ends)) / basis.span
    rows = np.diff(edges)
    if log.seconds is None:
        durations = rows.astype(float)
    else:
        durations = np.diff(log.seconds[np.minimum(edges, len(log.seconds) - 1)])
    speed = np.log(np.maximum(amplitude, 1e-3) / np.maximum(durations, 1e-9))
    return _Swings(amplitude, (0.5 * (ends[1:] + ends[:-1]) - basis.low) / basis.span, speed, rows)


# --- what the logs cannot tell ---


def _spread(
    logs: Sequence[PreparedLog],
    basis: Basis,
    structure: Structure,
    statistics: Statistics,
    own: Solution,
    fitted: float,
    delays: tuple[float, float] | None,
) -> float:
    """RMS distance, on invented moves, of the models that explain the logs about as well.

    Of each kind of change the one that goes farthest counts, weighted by how well it explains the logs.
    """
    moves = _invented_moves(logs, basis)
    mine = _predicted(moves, basis, own, structure.segments)
    farthest: dict[str, float] = {}
    at_hand = {(basis, structure.segments): statistics}
    for kind, other, changed in _alternatives(basis, structure, delays):
        key = (other, max(changed.segments, structure.segments))
        if key not in at_hand:
            at_hand[key] = gather(logs, other, key[1])
        gram, rows = at_hand[key].total()
        try:
            solution = solve(gram, at_hand[key].columns, changed, rows)
        except FitError:
            continue
        ratio = float(np.sqrt(squared_error(gram, solution.vector) / rows)) / fitted
        weight = float(np.exp(-max(ratio - 1.0, 0.0) / LIKELIHOOD_WIDTH))
        apart = _rms(_predicted(moves, other, solution, key[1]) - mine)
        farthest[kind] = max(farthest.get(kind, 0.0), weight * apart)
    scatter = _scatter_of_folds(moves, basis, structure, statistics, mine)
    return SPREAD_WEIGHT * float(np.sqrt(sum(value**2 for value in farthest.values()) + scatter**2))


def _rms(values: Floats) -> float:
    """Root of the mean square, an offset included: the next move's zero is the model's."""
    return float(np.sqrt(np.mean(values**2)))


def _alternatives(
    basis: Basis, structure: Structure, delays: tuple[float, float] | None
) -> Iterator[tuple[str, Basis, Structure]]:
    """Yield models that differ from the chosen one in one thing: (the thing, basis, structure)."""
    for delay in delays or ():
        if delay != basis.delay:
            yield "delay", replace(basis, delay=delay), structure
    for factor in (0.01, 100.0):
        yield "smoothness", basis, replace(structure, smoothness=factor * structure.smoothness)
    for changed in _other_asymmetries(structure):
        yield "asymmetry", basis, changed
    for bend in (-0.1, 0.1):
        if abs(basis.bend + bend) < 1.0:
            yield "bend", replace(basis, bend=basis.bend + bend), structure
    if basis.time_constants:
        yield "memory", basis, replace(structure, memories=())
        longer = tuple(1.7 * tau for tau in basis.time_constants)  # halfway to the next of the grid
        yield "memory", replace(basis, time_constants=longer), structure
    if structure.slopes != "free":
        yield "slopes", basis, replace(structure, slopes="free")


def _other_asymmetries(structure: Structure) -> Iterator[Structure]:
    """Yield more and fewer segments, smoother and rougher."""
    yield replace(structure, segments=2 * structure.segments)
    if structure.segments % 2 == 0:
        yield replace(structure, segments=structure.segments // 2)
    if structure.segments > 1:
        for factor in (0.1, 10.0):
            yield replace(structure, knot_smoothness=factor * structure.knot_smoothness)


def _scatter_of_folds(
    moves: tuple[Floats, Floats], basis: Basis, structure: Structure, statistics: Statistics, mine: Floats
) -> float:
    """Jackknife standard error of the prediction: the scatter of models fitted without one fold each."""
    found = []
    for fold in range(len(statistics.grams)):
        gram, rows = statistics.total(leave_out=fold)
        if rows < FEWEST_REST_ROWS:
            continue
        try:
            solution = solve(gram, statistics.columns, structure, rows)
        except FitError:
            continue
        found.append(_rms(_predicted(moves, basis, solution, structure.segments) - mine) ** 2)
    return float(np.sqrt((len(found) - 1) * np.mean(found))) if len(found) > 1 else 0.0


def _predicted(moves: tuple[Floats, Floats], basis: Basis, solution: Solution, segments: int) -> Floats:
    """Normalised output on invented moves, without the first two swings, which wipe out the start."""
    voltage, seconds = moves
    rows = np.vstack([part for _, _, part in DriveRows(basis, voltage, seconds, "empty").blocks()])
    inner = rows @ np.concatenate((solution.heights, solution.gains)) + solution.drift[0]
    output, _ = asymmetry(inner, corners(solution.knots, segments))
    begin = int(np.argmax(voltage >= basis.high - 1e-9 * basis.span))
    return output[2 * begin :]


def _invented_moves(logs: Sequence[PreparedLog], basis: Basis) -> tuple[Floats, Floats]:
    """Voltage and seconds of random nested turns over the whole range, as fast as the logs' own swings."""
    rng = np.random.default_rng(MOVE_SEED)
    speeds = np.concatenate([_swings(log, basis).speed for log in logs])
    slow, fast = np.percentile(speeds, [10.0, 90.0])
    turns = [0.0, 1.0, 0.0]
    turns += [
        float(rng.choice((0.0, 1.0))) if rng.random() < 0.12 else rng.random() for _ in range(MOVES - 2)
    ]
    total = float(np.abs(np.diff(turns)).sum())
    voltage, seconds = [np.zeros(1)], [np.zeros(1)]
    for begin, end in itertools.pairwise(turns):
        distance = abs(end - begin)
        duration = max(distance, 0.02) / float(np.exp(rng.uniform(slow, fast)))
        count = max(int(MOVE_ROWS * distance / total), 6)
        part = np.arange(1, count + 1) / count
        voltage.append(begin + (end - begin) * (0.5 - 0.5 * np.cos(np.pi * part)))
        seconds.append(seconds[-1][-1] + duration * part)
    return basis.low + basis.span * np.concatenate(voltage), np.concatenate(seconds)
