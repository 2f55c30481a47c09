"""Groups of swings left out of the fit: amplitudes, levels and speeds that the others have to predict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.normal_equations import Structure, solve, squared_error_free_of
from dbo_cli.hysteresis.identification.recordings import Floats, Integers, drive_shape
from dbo_cli.hysteresis.identification.regressors import Basis
from dbo_cli.hysteresis.identification.statistics import PreparedLog, gather

MAX_RATIO = 2.0  # a group without which the fit falls apart says how far one cannot extrapolate, not this

LARGE = 0.75  # of the drive's range: without the swings above, the last gears would never be seen
SMALL = 0.35  # of the drive's range: divides the swings that can be left out into two amplitudes
LEVELS = (0.4, 0.6)  # of the drive's range: divide them into low, middle and high
FEWEST_GROUP_ROWS = 20
FEWEST_REST_ROWS = 100


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
    swings = [swings_of(log, basis) for log in logs]
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
class Swings:
    """Swings between turns: amplitude and level in units of the range, speed as a logarithm, rows of each."""

    amplitude: Floats
    level: Floats
    speed: Floats
    rows: Integers


def swings_of(log: PreparedLog, basis: Basis) -> Swings:
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
    return Swings(amplitude, (0.5 * (ends[1:] + ends[:-1]) - basis.low) / basis.span, speed, rows)
