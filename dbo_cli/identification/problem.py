"""Logs made ready for the fit: normalised, some of their rows, and parts of these to leave out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np
from scipy.linalg import block_diag

from dbo_cli.arrays import Booleans, Floats, Integers
from dbo_cli.identification.basis import (
    Cells,
    PreparedLog,
    Structure,
    fitted_columns,
    past_columns,
    sums_of,
    time_constants,
)
from dbo_cli.identification.recording import (
    Options,
    Recording,
    Swings,
    falling,
    runs_of,
)
from dbo_cli.identification.solve import Equations, FittedRows
from dbo_cli.signals import noise

SEARCH_ROWS = 900  # of all logs: means of more
STEADY = 0.02  # of a swing's rows, over which a mean is taken at most
MOST_ROWS = 100_000  # of all logs at full rate: a longer log is thinned by means
BLOCKS = 6  # of time, each left out in turn
SMALL = 0.75  # of the largest swing: swings below are left out together
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
BOTH_WAYS = 2  # swings, up and down: less shows no loop
ROUNDING = 1e-9  # of the range: smaller noise of a drive is that of numbers
ROWS_WITH_NOISE = 20  # of a swing: with fewer, the drive's motion looks like noise
MOST_DEVIATIONS = 4.0  # of the noise that a drive's range is drawn in by
KNOWN = 0.005  # of the range: an unknown past that adds more lessens the row's weight
LEAST_PART, MOST_PART = 0.08, 0.9  # of the way, of small swings that are left out


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
    """

    logs: tuple[PreparedLog, ...]
    low: float
    high: float
    offset: float
    scale: float
    cells: Cells
    taus: Floats
    clock: bool
    _columns: dict[object, Floats] = field(default_factory=dict, init=False)
    _sums: tuple[object, list[Floats]] = field(default=(None, []), init=False)

    @property
    def dt(self) -> float:
        """The usual step in seconds."""
        return min(log.dt for log in self.logs)

    @property
    def owner(self) -> Integers:
        """The log of each fitted row."""
        counts = [len(log.rows) for log in self.logs]
        return np.repeat(np.arange(len(self.logs)), counts)

    @cached_property
    def output(self) -> Floats:
        """The normalised output of the fitted rows."""
        return np.concatenate([log.fitted(log.output) for log in self.logs])

    @property
    def swing_count(self) -> int:
        """How many swings there are in fitted rows: those of a fast part tell nothing of loops."""
        return sum(len(np.unique(log.swings.number[log.rows])) for log in self.logs)

    @cached_property
    def different_swings(self) -> int:
        """How many swings differ in a turn: one that is repeated tells nothing new."""
        different: set[tuple[float, float]] = set()
        for log in self.logs:
            different |= log.swings.different(log.drive)
        return len(different)

    @cached_property
    def swing(self) -> float:
        """Seconds that a swing usually takes, the mean over all logs weighted by rows."""
        seconds = [log.swings.usual_rows * log.dt for log in self.logs]
        weights = [len(log.drive) for log in self.logs]
        return float(np.average(seconds, weights=weights))

    @cached_property
    def smaller(self) -> Booleans:
        """Which of the fitted rows belong to loops of less than three quarters of the largest."""
        sizes = [log.swings.loops[log.swings.number[log.rows]] for log in self.logs]
        size = np.concatenate(sizes)
        small: Booleans = size < SMALL * size.max()
        return small

    @cached_property
    def smaller_share(self) -> float:
        """The share of the smaller loops in the way of the drive: a rest is no way."""
        ways = []
        for log in self.logs:
            drive = log.drive[log.rows]
            ways.append(np.abs(np.diff(drive, prepend=drive[0])))
        way = np.concatenate(ways)
        return float(way[self.smaller].sum() / way.sum())

    @cached_property
    def past(self) -> Floats:
        """What an unknown past of each log may add to the fitted rows; (rows, k)."""
        tables = [past_columns(log, self.cells) for log in self.logs]
        return np.asarray(block_diag(*tables))

    @cached_property
    def known(self) -> Floats:
        """The weight of each fitted row, the less the more another past of the gears would change it."""
        squares = np.sum(self.past**2, axis=1)
        return np.asarray(KNOWN**2 / (KNOWN**2 + squares))

    @cached_property
    def parts(self) -> list[Booleans]:
        """What is left out in turn, masks over the fitted rows: blocks of time, and the smaller loops.

        Smaller loops stay where the rest would show no way up and down.
        """
        count = len(self.output)
        block = np.arange(count) * BLOCKS // count
        parts = [block == number for number in range(BLOCKS)]
        many = LEAST_PART < self.smaller_share < MOST_PART
        if many and self.swing_count > BOTH_WAYS:
            parts.append(self.smaller)
        return parts

    @cached_property
    def groups(self) -> tuple[Booleans, Integers]:
        """The parts that each group of rows belongs to, (groups, parts), and the group of each row."""
        labels = np.column_stack(self.parts)
        groups, of_row = np.unique(labels, axis=0, return_inverse=True)
        return groups, of_row.reshape(-1)

    @property
    def one_amplitude(self) -> bool:
        """Whether all swings go over one range, so that other amplitudes cannot be left out and judged."""
        few = self.smaller_share <= LEAST_PART
        return few and self.swing_count >= BOTH_WAYS

    def columns(self, structure: Structure) -> Floats:
        """Return the columns of the fitted rows; stored for each delay, bend, start and level.

        Lags begin with what they still hold of a level, the drive less its lags without.
        """
        key = structure.delay, structure.bend, structure.start, structure.level
        if key not in self._columns:
            tables = []
            all_sums = self._sums_of(structure.bend, structure.start)
            for log, sums in zip(self.logs, all_sums, strict=True):
                table = fitted_columns(log, sums, self.cells, structure.delay)
                if structure.level is not None:
                    time = log.time[log.rows] - log.time[0]
                    held = np.exp(-time[:, None] / self.taus)
                    held *= structure.level - log.drive[0]
                    table[:, self.cells.count :] += np.hstack((held, -held))
                tables.append(table)
            self._columns[key] = np.vstack(tables)
        return self._columns[key]

    def _sums_of(self, bend: float, start: str) -> list[Floats]:
        """Return the sums that columns of all delays are made of, the last ones stored."""
        if (bend, start) != self._sums[0]:
            sums = []
            for log, last in zip_longest(self.logs, self._sums[1]):
                sums.append(sums_of(log, self.cells, self.taus, bend, start, last))
            self._sums = (bend, start), sums
        return self._sums[1]

    def drift(self, straight: bool) -> Floats:
        """Return offsets of all logs but the first, and straight drifts where asked for; (rows, k)."""
        tables = []
        for index, log in enumerate(self.logs):
            clock = log.time[log.rows]
            ramp = 2.0 * (clock - clock.mean()) / max(np.ptp(clock), 1e-300)
            table = np.column_stack((np.ones(len(clock)), ramp))
            tables.append(table[:, int(index == 0) : 1 + straight])
        return np.asarray(block_diag(*tables))

    def equations(self, structure: Structure) -> Equations:
        """Return the least-squares problem of a structure."""
        drift = self.drift(structure.drift)
        past = self.past if structure.past else np.zeros((len(drift), 0))
        rows = FittedRows(
            self.columns(structure),
            self.output,
            np.full(len(self.output), 1.0 / len(self.output)),
            np.hstack((drift, past)),
            self.cells.shares,
            past.shape[1],
        )
        return Equations(rows, structure)


def prepare(recordings: Sequence[Recording], options: Options) -> Problem:
    """Return the logs in units of the fit, with the rows of the search."""
    ranges = [drive_range(log.voltage[log.usable]) for log in recordings]
    low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
    scale, offset = output_scale(recordings)
    recordings = thinned(recordings)
    total = sum(int(log.usable.sum()) for log in recordings)
    stride = max(math.ceil(total / SEARCH_ROWS), 1)
    logs = []
    for log in recordings:
        drive = (log.voltage - low) / (high - low)
        time = np.arange(len(drive), dtype=float) if log.time is None else log.time
        gaps = np.diff(time)
        steps: float | Floats = float(np.median(gaps))
        if float(np.abs(gaps - steps).max()) > 1e-6 * steps:
            steps = np.concatenate(([0.0], gaps))
        output = (log.displacement - offset) / scale
        limit = max(round(STEADY * Swings.of(drive).usual_rows), 1)
        rows, ends = groups_of(log.usable, stride, min(stride, limit))
        logs.append(PreparedLog(drive, output, time, steps, rows, ends))
    clock = all(log.time is not None for log in recordings)
    taus = np.zeros(0)
    if options.taus is not None:
        taus = np.asarray(options.taus)
    elif clock:
        taus = time_constants(logs)
    cells = Cells.of(None if options.gears == "auto" else options.gears)
    return Problem(tuple(logs), low, high, offset, scale, cells, taus, clock)


def drive_range(voltage: Floats) -> tuple[float, float]:
    """Return the range of a drive that was read back: its extremes less what its noise explains of them.

    The greatest of n values of noise is expected at sqrt(2 ln n) standard deviations; at
    most four are taken off. Noise below the resolution is rounding, and motion that is as
    fast as the samples is no noise; nor are the steps of a drive that is held for some rows.
    """
    low, high = float(voltage.min()), float(voltage.max())
    changing = voltage[np.append(True, np.diff(voltage) != 0.0)]
    deviation = min(noise(voltage), noise(changing))
    steps = np.diff(np.unique(voltage))
    resolution = max(float(steps.min()), ROUNDING * (high - low))
    if deviation <= resolution or Swings.of(voltage).usual_rows < ROWS_WITH_NOISE:
        return low, high
    ends = []
    for distance in (voltage - low, high - voltage):
        rows = int(np.count_nonzero(distance <= MOST_DEVIATIONS * deviation))
        deviations = min(math.sqrt(2.0 * math.log(rows)), MOST_DEVIATIONS)
        ends.append(deviations * deviation)
    return low + ends[0], high - ends[1]


def thinned(logs: Sequence[Recording]) -> list[Recording]:
    """Return very long logs by the means of some rows each."""
    size = sum(len(log.voltage) for log in logs) // MOST_ROWS
    if size <= 1:
        return list(logs)

    def mean(values: Floats) -> Floats:
        complete = len(values) // size * size
        averages: Floats = values[:complete].reshape(-1, size).mean(axis=1)
        return averages

    return [
        replace(
            log,
            voltage=mean(log.voltage),
            displacement=mean(log.displacement),
            time=None if log.time is None else mean(log.time),
            good=mean(log.usable.astype(float)) == 1.0,
        )
        for log in logs
    ]


def groups_of(rows: Booleans, stride: int, size: int) -> tuple[Integers, Integers]:
    """Return begin and end of groups of up to ``size`` rows that are true, one in every ``stride`` of these.

    Where in a stride a group begins changes by the golden ratio: a log that holds each
    value for some rows would else be seen at one phase of its steps.
    """
    begins, ends = [], []
    for begin, end in runs_of(rows).tolist():
        places = np.arange(begin, end, stride)
        fraction = np.arange(len(places)) * GOLDEN % 1.0
        places = np.minimum(
            places + (fraction * (stride - size + 1)).astype(int), end - 1
        )
        begins.append(places)
        ends.append(np.minimum(places + size, end))
    return np.concatenate(begins), np.concatenate(ends)


def output_scale(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return scale and offset that bring the displacement to 0..1 and let it rise with the drive."""
    ends = [
        np.percentile(log.displacement[log.usable], [1.0, 99.0]) for log in recordings
    ]
    low, high = float(np.min(ends)), float(np.max(ends))
    if high == low:
        high = low + 1.0
    return (low - high, high) if falling(recordings) else (high - low, low)
