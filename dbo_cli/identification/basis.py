"""What follows from the drive alone: columns that the output is a weighted sum of.

A log's drive is brought to 0..1 (``PreparedLog``). Its columns are the engaged part of
each slope cell (the difference of neighbouring plays: a cell is some gears that share a
slope), the lags L_j of the drive, and what is left of it, x - L_j. Cells are finer for
small distances since the turn. Everything may be delayed, and the drive may be bent
before it by ``bend * x * (1 - x)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dbo_cli.arrays import Floats, Integers
from dbo_cli.identification.recording import Swings
from dbo_cli.model import Points, Relaxation, kernel

GEARS = 2048  # of a model inside its range, all of one width
SPARE = 0.125  # of the drive's range: gears beyond either end
SPARE_BEYOND = 1.0  # the same, where the drive came from beyond its range
CELLS = 96  # different slopes among them
CELL_GROWTH = 1.5  # a cell's upper edge grows with its number to this power
SEGMENTS = 24  # of the curve behind the gears
BEND_SEGMENTS = 32  # of the points before the gears
TAU_RATIO = 3.0  # of neighbouring time constants
RISING = 1e-6  # of a step: what a clock that repeats stamps rises by at least
BLOCK_ROWS = 256  # of the full rate: their sums stay in a near cache
LANES = 8  # plays in a group of the kernel
PAST_GROUPS = 5  # of cells, each with a past of its own
LEAST_PAST = 1e-3  # of the range: a past that adds less is none


@dataclass(frozen=True)
class Structure:
    """What is not linear, or not fitted: chosen on parts left out.

    Attributes
    ----------
    slopes : "growing", "falling" or "free", over the distance since the turn
    memories : "", "t" (lags) or "tr" (lags, and the drive less its lags)
    smooth_slopes, smooth_curve : weights of squared second differences; an infinite
        ``smooth_curve`` is a straight line
    delay : seconds
    bend : of the drive
    segments : of the curve
    drift : whether a straight drift in time is fitted beside the model
    past : whether the unknown past of the gears is fitted beside it
    start : of the gears before the logs: "settled", "empty" (the drive came up from the lower
        end), "full" (down from the upper), "below" or "above" (from far beyond that end)
    level : of the drive, where memories stood before the logs; None: at the first value
    """

    slopes: str = "growing"
    memories: str = "t"
    smooth_slopes: float = 1e-4
    smooth_curve: float = np.inf
    delay: float = 0.0
    bend: float = 0.0
    segments: int = SEGMENTS
    drift: bool = False
    past: bool = False
    start: str = "settled"
    level: float | None = None


@dataclass(frozen=True)
class PreparedLog:
    """A cleaned log in units of the fit.

    Attributes
    ----------
    drive, output : shape (n,), 0 to 1 over the range of all logs; the output rises with
        the drive
    time : shape (n,), seconds (rows where there is no clock)
    steps : seconds since the sample before, a number where the clock is even
    rows, ends : shape (k,): row k of the fit is the mean over rows[k] to ends[k]
    """

    drive: Floats
    output: Floats
    time: Floats
    steps: float | Floats
    rows: Integers
    ends: Integers

    @property
    def dt(self) -> float:
        """The usual step in seconds."""
        return float(np.median(self.steps))

    @cached_property
    def swings(self) -> Swings:
        """The swings of the drive."""
        return Swings.of(self.drive)

    def fitted(self, values: Floats) -> Floats:
        """Return the means of drive or output that are the fitted rows."""
        sums = np.concatenate(([0.0], np.cumsum(values - values[0])))
        counts = self.ends - self.rows
        averages: Floats = values[0] + (sums[self.ends] - sums[self.rows]) / counts
        return averages


@dataclass(frozen=True)
class Cells:
    """Gears of one width that share slopes in groups.

    Attributes
    ----------
    gears : shape (cells,), how many gears inside the range each cell holds
    spare : how many gears go on beyond either end of the range; they are the last cell's
    """

    gears: Integers
    spare: int

    @staticmethod
    def of(gears: int | None = None, spare: float = SPARE) -> Cells:
        """Return groups of gears, finer for small distances; with spare ones unless they are counted."""
        count = GEARS if gears is None else gears
        fraction = np.linspace(0.0, 1.0, min(CELLS, count) + 1) ** CELL_GROWTH
        edges = np.unique(np.round(count * fraction).astype(np.int64))
        return Cells(np.diff(edges), int(spare * count) if gears is None else 0)

    @property
    def count(self) -> int:
        """How many slopes there are."""
        return len(self.gears)

    @property
    def inside(self) -> int:
        """How many gears span the range."""
        return int(self.gears.sum())

    @property
    def overshoot(self) -> float:
        """How far the gears go beyond either end, in units of the range."""
        return self.spare / self.inside

    @property
    def widths(self) -> Floats:
        """Width of each cell inside the range, in its units; shape (cells,)."""
        return self.gears / float(self.inside)

    @property
    def counts(self) -> Integers:
        """How many gears each cell holds, the spare ones among them; shape (cells,)."""
        counts = self.gears.copy()
        counts[-1] += 2 * self.spare
        return counts

    @property
    def shares(self) -> Floats:
        """Width of each cell as a share of all gears; shape (cells,)."""
        return self.counts / float(self.counts.sum())

    @property
    def reach(self) -> Floats:
        """Reach of the plays at the cells' edges: half the distance; shape (cells + 1,)."""
        reach: Floats = np.concatenate(([0.0], np.cumsum(self.widths))) / 2.0
        reach[-1] = 0.5 + self.overshoot
        return reach


def plays_at_start(first: float, reach: Floats, start: str = "settled") -> Floats:
    """Return where plays of these reaches stand before the first drive value.

    Settled is what an oscillation leaves that decays from the whole range to ``first``;
    at the ends of the range no past within it differs from that. A drive that came from the
    lower end at once is "empty" at the start, from the upper end "full", and "below" or
    "above" where it came from so far beyond that end that no play stands still on the way.
    No drive inside the range moves the last play.
    """
    if start == "below":
        plays = first - reach
    elif start == "above":
        plays = first + reach
    elif start == "empty":
        plays = np.maximum(reach, first - reach)
    elif start == "full":
        plays = np.minimum(1.0 - reach, first + reach)
    elif first <= 0.5:
        plays = np.maximum(reach, first)
    else:
        plays = np.minimum(1.0 - reach, first)
    plays[-1] = 0.5
    return plays


def points_of(bend: float, low: float = 0.0, span: float = 1.0) -> Points:
    """Return points that bend a drive of ``low`` to ``low + span`` by bend * x * (1 - x), x its part."""
    grid = np.linspace(0.0, 1.0, BEND_SEGMENTS + 1)
    curve = grid + bend * grid * (1.0 - grid)
    widths = np.full(BEND_SEGMENTS, span / BEND_SEGMENTS)
    return Points(widths, span * np.diff(curve), low, low)


def time_constants(logs: Sequence[PreparedLog]) -> Floats:
    """Return the time constants (s) from the shortest step in threes to half the longest log."""
    shortest = min(log.dt for log in logs)
    longest = max(float(log.time[-1] - log.time[0]) for log in logs) / 2.0
    count = max(int(np.ceil(np.log(longest / shortest) / np.log(TAU_RATIO))), 0)
    return np.append(shortest * TAU_RATIO ** np.arange(count), longest)


def fitted_columns(
    log: PreparedLog, sums: Floats, cells: Cells, delay: float
) -> Floats:
    """Return the table (rows, cells + 2 terms): engaged parts, lags, and drive less its lags.

    A mean is a difference of ``sums``; a delay (s) shifts both ends.
    """
    position = _late(log, delay, np.concatenate((log.rows, log.ends)))
    inside = np.maximum(position, 0.0)
    index = np.minimum(inside.astype(np.int64), len(log.drive) - 1)
    before, after = sums[index], sums[index + 1]
    shifted = before + (inside - index)[:, None] * (after - before)
    shifted += np.minimum(position, 0.0)[:, None] * sums[1]
    started, ended = np.split(shifted, 2)
    first_rows, last_rows = np.split(position, 2)
    table = (ended - started) / (last_rows - first_rows)[:, None]
    plays = cells.count + 1
    lags, overshoot = table[:, plays:-1], table[:, -1:]
    engaged = table[:, : plays - 1] - table[:, 1:plays]
    engaged[:, -1:] += overshoot
    return np.hstack((engaged, lags, table[:, :1] + overshoot - lags))


def past_columns(log: PreparedLog, cells: Cells) -> Floats:
    """Return what another past than the settled one may add to a log's output; (rows, k).

    A play of reach r that begins at z0 is clip(z0, M - r, m + r), with the highest and
    lowest drive M and m so far, until these are 2 r apart; then z0 is forgotten. A column
    is the engaged parts of a group of cells after a drive from far below, or from far
    above, less those of the settled start: a mean slope of 1 is the most that it can be
    multiplied by. What stays to the end is an offset, which is taken off.
    """
    settled = plays_at_start(float(log.drive[0]), cells.reach)
    group = np.arange(cells.count) * PAST_GROUPS // cells.count
    columns = []
    for start in ("below", "above"):
        plays = plays_at_start(float(log.drive[0]), cells.reach, start)
        added = _unswept(log, cells.reach, plays) - _unswept(log, cells.reach, settled)
        engaged = -np.diff(added, axis=1)
        for number in range(PAST_GROUPS):
            column = engaged[:, group == number].sum(axis=1)
            column -= column[-1]
            if np.abs(column).max() > LEAST_PAST:
                columns.append(column)
    return np.array(columns).reshape(-1, len(log.rows)).T


def _unswept(log: PreparedLog, reach: Floats, start: Floats) -> Floats:
    """Return plays of these reaches at the fitted rows, from a start; 0 once the drive has swept them."""
    highest = np.maximum.accumulate(log.drive)[log.rows, None]
    lowest = np.minimum.accumulate(log.drive)[log.rows, None]
    unknown = highest - lowest < 2.0 * reach
    plays = np.minimum(np.maximum(start, highest - reach), lowest + reach)
    return np.where(unknown, plays, 0.0)


def sums_of(
    log: PreparedLog,
    cells: Cells,
    taus: Floats,
    bend: float,
    start: str = "settled",
    sums: Floats | None = None,
) -> Floats:
    """Return the sums of plays, lags and what is beyond the gears over the rows before each row.

    Earlier ``sums`` are written over: a long log's new memory takes as long as its sums.
    """
    compiled = kernel.extension
    drive, reach = log.drive, cells.reach
    if bend:
        drive = points_of(bend)(drive)
    inside = np.clip(drive, -cells.overshoot, 1.0 + cells.overshoot)
    padded = -(-len(reach) // LANES) * LANES
    table, state = np.zeros((3, padded)), np.zeros(padded)
    table[:2] = np.inf
    table[:2, : len(reach)] = reach
    state[: len(reach)] = plays_at_start(float(inside[0]), reach, start)
    seconds = tuple(taus.tolist()) or (1.0,)  # the kernel wants one at least
    lag = Relaxation(0.0, seconds, (0.0,) * len(seconds))
    memory: Sequence[float] | None = None
    if sums is None:
        sums = np.zeros((len(drive) + 1, len(reach) + len(taus) + 1))
    for first in range(0, len(drive), BLOCK_ROWS):
        rows = slice(first, first + BLOCK_ROWS)
        x = np.ascontiguousarray(inside[rows])
        plays = np.empty((len(x), len(reach)))
        compiled.plays_rows(len(reach), table, state, x, plays)
        steps = log.steps if isinstance(log.steps, float) else log.steps[rows]
        lags, memory = lag.lags(drive[rows], steps, memory)
        outside = (drive[rows] - x)[:, None]
        block = np.hstack((plays, lags[:, : len(taus)], outside))
        block[0] += sums[first]
        np.cumsum(block, axis=0, out=sums[first + 1 : first + 1 + len(x)])
    return sums


def _late(log: PreparedLog, delay: float, places: Integers) -> Floats:
    """Return where the drive of these places, which lie between rows, was earlier; before the log below 0."""
    if delay == 0.0 or isinstance(log.steps, float):
        return places.astype(np.float64) - delay / log.dt
    clock = np.append(log.time, log.time[-1] + log.dt)
    clock = clock + RISING * log.dt * np.arange(len(clock))
    shifted = clock[places] - delay
    within: Floats = np.interp(shifted, clock, np.arange(len(clock), dtype=float))
    position: Floats = within + np.minimum(shifted - clock[0], 0.0) / log.dt
    return position
