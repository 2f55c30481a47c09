"""Logs made ready for the fit: normalised, some of their rows, and parts of these to leave out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dbo_cli.identification.basis import (
    Basis,
    Cells,
    PreparedLog,
    Structure,
    start_of,
    time_constants,
)
from dbo_cli.identification.recording import (
    SMALLEST_SWING,
    Booleans,
    Floats,
    Integers,
    Options,
    Recording,
    Swings,
    usual_swing,
)
from dbo_cli.identification.solve import Rows

STEADY = 0.02  # of the drive's range: it moves less over the rows of a mean
SEARCH_ROWS = 900  # of all logs: means of more
MOST_ROWS = 100_000  # of all logs at full rate: a longer log is thinned by means
BLOCKS = 6  # of time, each left out in turn
SMALL, TINY = 0.75, 0.4  # of the largest swing: swings below are left out together
MANY_SWINGS = 6  # of which one is rare
FEWEST_OF_SWING = 5  # fitted rows of a swing that counts
LEAST_PART, MOST_PART = 0.05, 0.9  # of the rows, of a kind of swings that is left out


@dataclass(frozen=True)
class Part:
    """Rows that are left out together: ``kind`` of part, and a mask over the fitted rows."""

    kind: str
    mask: Booleans


@dataclass
class Problem:
    """All logs of one identification.

    Attributes
    ----------
    logs : the logs, normalised
    low, high : range of the drive, in its unit
    offset, scale : displacement = offset + scale * output; ``scale`` has the gain's sign
    taus : shape (terms,), time constants in seconds; none without a clock
    clock : whether the logs have one
    swing : seconds (rows) that a swing usually takes
    parts : what is left out in turn
    """

    logs: tuple[PreparedLog, ...]
    low: float
    high: float
    offset: float
    scale: float
    cells: Cells
    taus: Floats
    clock: bool
    swing: float
    parts: tuple[Part, ...] = ()
    _columns: dict[object, Floats] = field(default_factory=dict)
    _groups: tuple[Booleans, Integers] | None = None

    @property
    def dt(self) -> float:
        """The usual step in seconds."""
        return min(log.dt for log in self.logs)

    @property
    def owner(self) -> Integers:
        """The log of each fitted row."""
        counts = [len(log.rows) for log in self.logs]
        return np.repeat(np.arange(len(self.logs)), counts)

    @property
    def output(self) -> Floats:
        """The normalised output of the fitted rows."""
        return np.concatenate([log.fitted for log in self.logs])

    @property
    def groups(self) -> tuple[Booleans, Integers]:
        """The parts that each group of rows belongs to, (groups, parts), and the group of each row."""
        if self._groups is None:
            labels = np.column_stack([part.mask for part in self.parts])
            found, of_row = np.unique(labels, axis=0, return_inverse=True)
            self._groups = found, of_row.reshape(-1)
        return self._groups

    def columns(self, structure: Structure) -> Floats:
        """Return the columns of the fitted rows; kept for each delay and bend."""
        key = structure.delay, structure.bend
        if key not in self._columns:
            basis = Basis(self.cells, self.taus)
            tables = [basis.columns(log, structure) for log in self.logs]
            self._columns[key] = np.vstack(tables)
        return self._columns[key]

    def drift(self, order: int) -> Floats:
        """Return a polynomial in time for each log, and an offset for each but the first; (rows, k)."""
        owner = self.owner
        columns = []
        for place, log in enumerate(self.logs):
            mine = (owner == place).astype(float)
            if place:
                columns.append(mine)
            time = np.zeros(len(owner))
            clock = log.time[log.rows]
            middle, half = (clock[-1] + clock[0]) / 2.0, np.ptp(clock) / 2.0
            time[owner == place] = (clock - middle) / max(half, 1e-300)
            columns += [mine * time**power for power in range(1, order + 1)]
        if not columns:
            return np.zeros((len(owner), 0))
        return np.column_stack(columns)

    def rows(self, structure: Structure) -> Rows:
        """Return the rows that a structure is fitted to."""
        output = self.output
        weights = np.full(len(output), 1.0 / len(output))
        return Rows(
            self.columns(structure),
            output,
            weights,
            self.drift(structure.drift),
            self.cells.shares,
            len(self.taus),
        )

    @property
    def swing_sizes(self) -> Floats:
        """Size of every swing that has more than a few fitted rows, as a share of the drive's range."""
        sizes = []
        for log in self.logs:
            swings = Swings.of(log.drive)
            held = np.bincount(swings.number[log.rows], minlength=len(swings.sizes))
            sizes.append(swings.sizes[held > FEWEST_OF_SWING])
        return np.concatenate(sizes)

    @property
    def swings(self) -> int:
        """How many swings there are."""
        return len(self.swing_sizes)

    @property
    def swings_of_log(self) -> int:
        """How many swings the log with the fewest has."""
        return min(len(Swings.of(log.drive[log.rows]).sizes) for log in self.logs)

    @property
    def smaller_swings(self) -> int:
        """How many swings are clearly smaller than the largest; 0 where they are rare."""
        sizes = self.swing_sizes
        small = int(((sizes < SMALL * sizes.max()) & (sizes > SMALLEST_SWING)).sum())
        if small == 1 and len(sizes) >= MANY_SWINGS:
            return 0  # the log ends within a swing
        return small if small > LEAST_PART * len(sizes) else 0

    @property
    def one_amplitude(self) -> bool:
        """Whether all swings go over one range, so that other amplitudes cannot be judged."""
        return self.smaller_swings == 0 and self.swings >= 2

    def known(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Return the recordings with the rows that could be fitted: those of an unknown past do not count."""
        logs = []
        for recording, log in zip(recordings, self.logs, strict=True):
            first = round(int(log.rows[0]) * len(recording.voltage) / len(log.drive))
            late = np.arange(len(recording.voltage)) >= first
            logs.append(replace(recording, good=recording.usable & late))
        return logs

    def without_memories_from(self, slowest: float) -> Problem:
        """Return the problem without time constants (s) from ``slowest`` on."""
        return replace(self, taus=self.taus[self.taus < slowest], _columns={})


def prepare(recordings: Sequence[Recording], options: Options) -> Problem:
    """Return the logs in units of the fit, with the rows of the search."""
    low = min(float(log.voltage.min()) for log in recordings)
    high = max(float(log.voltage.max()) for log in recordings)
    scale, offset = output_scale(recordings, options.sign)
    recordings = [thinned(log, recordings) for log in recordings]
    usable = [log.usable for log in recordings]
    total = sum(int(rows.sum()) for rows in usable)
    stride = max(math.ceil(total / SEARCH_ROWS), 1)
    size = steady_rows(recordings, stride)
    logs = []
    for log, rows in zip(recordings, usable, strict=True):
        begins, ends = groups_of(rows, stride, size)
        logs.append(_prepared(log, begins, ends, low, high, scale, offset))
    clock = all(log.time is not None for log in recordings)
    taus = np.zeros(0)
    if options.taus is not None:
        taus = np.asarray(options.taus)
    elif clock:
        taus = time_constants(logs)
    gears = None if options.gears == "auto" else options.gears
    swing = usual_swing([log.drive for log in logs], [log.dt for log in logs])
    problem = Problem(
        tuple(logs), low, high, offset, scale, Cells.of(gears), taus, clock, swing
    )
    problem.parts = parts_of(problem)
    return problem


def _prepared(
    log: Recording,
    rows: Integers,
    ends: Integers,
    low: float,
    high: float,
    scale: float,
    offset: float,
) -> PreparedLog:
    """Return one log in units of the fit."""
    drive = (log.voltage - low) / (high - low)
    time = np.arange(len(drive), dtype=float) if log.time is None else log.time
    gaps = np.diff(time)
    steps: float | Floats = float(np.median(gaps))
    if float(np.abs(gaps - steps).max()) > 1e-6 * float(np.median(gaps)):
        steps = np.concatenate(([0.0], gaps))
    output = (log.displacement - offset) / scale
    start = start_of(float(drive[0]))
    return PreparedLog(log.name, drive, output, time, steps, start, rows, ends)


def thinned(log: Recording, logs: Sequence[Recording]) -> Recording:
    """Return a very long log by the means of some rows each."""
    size = max(sum(len(other.voltage) for other in logs) // MOST_ROWS, 1)
    count = len(log.voltage) // size
    if size == 1 or count < MOST_ROWS // (20 * len(logs)):
        return log

    def mean(values: Floats) -> Floats:
        averages: Floats = values[: count * size].reshape(count, size).mean(axis=1)
        return averages

    return replace(
        log,
        voltage=mean(log.voltage),
        displacement=mean(log.displacement),
        time=None if log.time is None else mean(log.time),
        good=np.all(log.usable[: count * size].reshape(count, size), axis=1),
    )


def steady_rows(recordings: Sequence[Recording], most: int) -> int:
    """Return over how many rows, at most ``most``, the drive hardly moves: a mean of them tells no less."""
    low = min(float(log.voltage.min()) for log in recordings)
    high = max(float(log.voltage.max()) for log in recordings)
    size = most
    while size > 1:
        moved = [np.zeros(1)]
        for log in recordings:
            moved.append(np.abs(log.voltage[size - 1 :] - log.voltage[: 1 - size]))
        usual = float(np.percentile(np.concatenate(moved), 90.0))
        if usual <= STEADY * (high - low):
            return size
        size //= 2
    return 1


def groups_of(rows: Booleans, stride: int, size: int) -> tuple[Integers, Integers]:
    """Return begin and end of groups of up to ``size`` rows that are true, one every ``stride`` of these."""
    edges = np.diff(np.concatenate(([False], rows, [False])).astype(np.int8))
    begins, ends = [], []
    runs = np.column_stack((np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)))
    for begin, end in runs.tolist():
        some = np.arange(begin, end, stride)
        begins.append(some)
        ends.append(np.minimum(some + size, end))
    return np.concatenate(begins), np.concatenate(ends)


def output_scale(
    recordings: Sequence[Recording], sign: str | None
) -> tuple[float, float]:
    """Return scale and offset that bring the displacement to 0..1 and let it rise with the drive."""
    together = 0.0
    lows, highs = [], []
    for log in recordings:
        rows = log.usable
        v, y = log.voltage[rows], log.displacement[rows]
        y = np.clip(y, *np.percentile(y, [1.0, 99.0]))
        together += float(np.sum((v - v.mean()) * (y - y.mean())))
        lows.append(float(y.min()))
        highs.append(float(y.max()))
    falling = together < 0.0 if sign is None else sign == "falling"
    low, high = min(lows), max(highs)
    if high == low:
        high = low + 1.0
    return (low - high, high) if falling else (high - low, low)


def parts_of(problem: Problem) -> tuple[Part, ...]:
    """Return what is left out in turn: blocks of time, and the smaller swings."""
    sizes = []
    for log in problem.logs:
        swings = Swings.of(log.drive)
        sizes.append(swings.sizes[swings.number[log.rows]])
    size = np.concatenate(sizes)
    count = len(size)
    edges = np.linspace(0, count, BLOCKS + 1).astype(int)
    place = np.searchsorted(edges[1:-1], np.arange(count), side="right")
    parts = [Part("time", place == block) for block in range(BLOCKS)]
    small = size < SMALL * size.max()
    if LEAST_PART * count < small.sum() < MOST_PART * count:
        parts.append(Part("size", small))
        tiny = size < TINY * size.max()
        if LEAST_PART * count < tiny.sum() < 0.7 * small.sum():
            parts.append(Part("size", tiny))
    return tuple(parts)
