"""Moves that people write by hand, as pure functions: raster, spiral, staircase, sine, triangle.

Everything is made of four pieces: a line of constant speed, a turn, a start or stop,
and a rise from level to level. Their accelerations are sines that begin and end at
zero, so that nothing jumps but what no rounding was asked for; each turn and each rise
takes one period of the bandwidth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dbo_cli.drives.gate import Floats
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.excitation import MOST_SAMPLES

Range = tuple[float, float]
START = 2.0 / math.pi
"""Of a turn's rows: a start of so many reaches as far outside a line as a turn does, more gently than it."""
TAKES = {  # what each shape needs, and what it takes besides
    "raster": (("frequency", "lines"), ("slow_range", "pixels", "overscan", "one_way")),
    "spiral": (("frequency", "turns"), ("slow_range",)),
    "staircase": (("steps", "dwell"), ("one_way",)),
    "sine": (("frequency",), ("cycles", "loop")),
    "triangle": (("frequency",), ("cycles", "loop")),
}

ABOVE_0 = (
    "rate",
    "frequency",
    "bandwidth",
    "dwell",
    "lines",
    "pixels",
    "turns",
    "steps",
    "cycles",
)


@dataclass(frozen=True)
class TrajectoryOptions:
    """What is asked of a move.

    Attributes
    ----------
    shape : str
        A key of ``TAKES``.
    rate : float
        Rows a second (Hz).
    range : (float, float)
        From where to where: of a raster's lines, of a spiral's first axis, of
        everything else the whole move.
    slow_range : (float, float), optional
        The same of the second axis of raster and spiral; as ``range`` where not given.
    frequency : float, optional
        Lines, turns or cycles a second (Hz).
    lines, turns, steps, cycles : int, optional
        How many; cycles one where not given.
    pixels : int, optional
        A whole number of rows belongs to each of so many pixels of a line.
    overscan : float
        How far a line goes on at its speed beyond the range, at either end, in percent
        of the range.
    one_way : bool
        A raster's lines in one direction, the way back as fast; a staircase up without
        the way down.
    dwell : float, optional
        Seconds at each level of a staircase.
    rest : float
        Seconds at rest before and after the move.
    loop : bool
        Whole cycles without start and stop, to be repeated.
    bandwidth : float, optional
        Each turn, rise, start and stop takes one period of it (Hz); sharp where not
        given.

    Raises
    ------
    UsageError
        Something is missing, senseless, or belongs to another shape.
    """

    shape: str
    rate: float
    range: Range
    slow_range: Range | None = None
    frequency: float | None = None
    lines: int | None = None
    pixels: int | None = None
    overscan: float = 0.0
    one_way: bool = False
    turns: int | None = None
    steps: int | None = None
    dwell: float | None = None
    cycles: int | None = None
    rest: float = 0.0
    loop: bool = False
    bandwidth: float | None = None

    def __post_init__(self) -> None:
        """Check what is needed, and what excludes what."""
        if self.shape not in TAKES:
            raise UsageError(f"'{self.shape}' is none of {', '.join(TAKES)}")
        self._check_shape()
        self._check_values()
        if self.loop and self.rest:
            raise UsageError("`loop` and `rest` exclude each other: a loop goes on")
        if self.bandwidth and (self.frequency or 0.0) >= self.bandwidth:
            raise UsageError(
                f"`frequency` {self.frequency:g}: a {self.shape} as fast as the bandwidth of "
                f"{self.bandwidth:g} Hz is all turns (below {self.bandwidth:g}, or a higher `bandwidth`)"
            )

    def _check_shape(self) -> None:
        needs, takes = TAKES[self.shape]
        for name in needs:
            if getattr(self, name) is None:
                raise UsageError(f"a {self.shape} needs `{name}`")
        for needs_of_other, takes_of_other in TAKES.values():
            for option in needs_of_other + takes_of_other:
                if getattr(self, option) and option not in needs + takes:
                    raise UsageError(
                        f"`{option}` belongs to another shape than {self.shape}"
                    )

    def _check_values(self) -> None:
        for low, high in (self.range, self.slow_range or self.range):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise UsageError(
                    f"`range` {low:g}:{high:g}: give the lower end first, both finite"
                )
        for name in ABOVE_0:
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise UsageError(f"`{name}` {value:g}: give a number above 0")
        for name in ("overscan", "rest"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise UsageError(
                    f"`{name}` {getattr(self, name):g}: must not be below 0"
                )

    @property
    def seconds(self) -> float:
        """About how long the move takes, in s."""
        standing = self.rest
        if self.steps:
            each = (self.dwell or 0.0) + 1.0 / (self.bandwidth or self.rate)
            standing = self.steps * each + self.rest
        count = self.lines or self.turns or self.cycles or 1
        if self.one_way:
            count *= 2
        moving = count / self.frequency if self.frequency else 0.0
        return 2.0 * standing + moving

    @property
    def turn(self) -> int:
        """Rows of a turn or a rise."""
        if self.bandwidth is None:
            return 0
        return math.ceil(self.rate / self.bandwidth)

    @property
    def period(self) -> int:
        """Rows of a line, a turn of a spiral, or a cycle."""
        assert self.frequency is not None
        rows = round(self.rate / self.frequency)
        if rows < 4:  # a triangle of fewer has no rows between its turns
            raise UsageError(
                f"`frequency` {self.frequency:g}: {rows} rows each at a `rate` of {self.rate:g} (at most "
                f"{self.rate / 4.0:g})"
            )
        return rows


@dataclass(frozen=True)
class Move:
    """A move as it was made.

    Attributes
    ----------
    axes : tuple of array
        One signal an axis, each of shape (rows,).
    notes : list of str
        What became of it, in words.
    """

    axes: tuple[Floats, ...]
    notes: list[str]


def move(options: TrajectoryOptions) -> Move:
    """Return the move that is asked for.

    Raises
    ------
    UsageError
        It is too fast for its rate or its bandwidth, or too long.
    """
    if options.seconds * options.rate > MOST_SAMPLES:
        raise UsageError(
            f"the move takes {options.seconds:.4g} s, more than the {MOST_SAMPLES:,} rows that are written "
            "at most (a lower `rate`, or a shorter move)"
        )
    made = _MAKERS[options.shape](options)
    rest = round(options.rest * options.rate)
    return Move(
        tuple(np.pad(axis, rest, mode="edge") for axis in made.axes), made.notes
    )


# --- the pieces: rows after the one that they begin at ---


def _steps(count: int) -> Floats:
    return np.arange(1.0, count + 1.0)


def turned(place: float, speed: float, count: int) -> Floats:
    """Return a turn at ``place`` from ``speed`` (a row) to its opposite, count speed/pi beyond."""
    return place + speed * count / math.pi * np.sin(
        math.pi * _steps(count) / max(count, 1)
    )


def started(place: float, speed: float, count: int) -> Floats:
    """Return a start from rest that arrives at ``place`` with ``speed``, the row at rest included."""
    k, n = np.arange(count + 1.0), max(count, 1)
    distance: Floats = 0.5 * k - 0.5 * n / math.pi * np.sin(math.pi * k / n)
    return place + speed * (distance - 0.5 * count)


def risen(count: int) -> Floats:
    """Return the way from 0 to 1: its acceleration is one period of a sine."""
    part = _steps(count) / max(count, 1)
    share: Floats = part - np.sin(2.0 * math.pi * part) / (2.0 * math.pi)
    share[-1:] = 1.0
    return share


def strokes(
    ends: Range, flat: int, turn: int, count: int, loop: bool = False
) -> Floats:
    """Return ``count`` lines there and back between two ends, ``flat`` rows each, with start and stop.

    Without them in a loop, whose first row follows on its last.
    """
    low, high = ends
    speed, part = (high - low) / flat, _steps(flat) / flat
    up = [low + (high - low) * part, turned(high, speed, turn)]
    back = [high - (high - low) * part, turned(low, -speed, turn)]
    lines = np.tile(np.concatenate(up + back), (count + 1) // 2)[
        : count * (flat + turn)
    ]
    if loop:
        return np.roll(lines, 1)
    lead = math.floor(START * turn)
    end, pace = (high, speed) if count % 2 else (low, -speed)
    stop = started(end, -pace, lead)[::-1][1:]  # a stop is a start played backwards
    return np.concatenate([started(low, speed, lead), lines[: lines.size - turn], stop])


def eased(period: int, count: int, loop: bool = False) -> Floats:
    """Return a phase from 0 to ``count``, ``period`` rows each; the first and last half are half as fast."""
    if loop:
        return np.arange(float(count * period)) / period
    begin = started(0.5, 1.0 / period, period)
    line = 0.5 + _steps((count - 1) * period) / period
    return np.concatenate([begin, line, count - begin[::-1][1:]])


# --- the shapes ---


def _between(ends: Range, part: Floats) -> Floats:
    low, high = ends
    return np.clip(low + (high - low) * part, low, high)


def _raster(options: TrajectoryOptions) -> Move:
    """Return a line axis and a slow one, which stands still while a line is drawn.

    With pixels a line may become slower than asked for, by less than a row a pixel;
    never faster.
    """
    low, high = options.range
    lines, turn, period = options.lines or 1, options.turn, options.period
    over, pixels = options.overscan / 100.0, options.pixels or 1
    room = (period - turn) / (1.0 + 2.0 * over)
    inside = math.floor(room)
    if options.pixels:
        inside = math.ceil(room / pixels) * pixels
    if room < max(2, pixels):
        fewest = math.ceil(max(2, pixels) * (1.0 + 2.0 * over)) + turn
        raise UsageError(
            f"`frequency` {options.frequency:g}: a line of {period} rows has no room for {pixels} pixels and "
            f"a turn of {turn} rows (at most {options.rate / fewest:.4g} lines a second)"
        )
    extra = math.ceil(over * inside)
    flat, beyond = inside + 2 * extra, (high - low) * extra / inside
    ends = (low - beyond, high + beyond)
    count, gap = lines, turn
    if options.one_way:  # a way back stands between two lines
        count, gap = 2 * lines - 1, 2 * turn + flat
    fast = strokes(ends, flat, turn, count)
    slow_low, slow_high = options.slow_range or options.range
    levels = np.linspace(slow_low, slow_high, lines)
    profile = np.concatenate([np.zeros(flat), risen(gap)])
    blocks = levels[:-1, None] + np.diff(levels)[:, None] * profile
    lead = math.floor(START * turn)
    slow = np.concatenate(
        [np.full(lead + 1, levels[0]), blocks.ravel(), np.full(flat + lead, levels[-1])]
    )
    line = flat + turn
    seconds = line / options.rate
    every = 2 * seconds if options.one_way else seconds
    note = (
        f"{lines} lines, one in {every:.6g} s; of a line's "
        f"{seconds:.6g} s {100.0 * inside / line:.3g} % are linear and inside the range"
    )
    if options.pixels:
        note += f", {options.pixels} pixels of {inside // pixels} rows"
    return Move((fast, slow), [note])


def _triangle(options: TrajectoryOptions) -> Move:
    """Return a triangle whose tips are turns that reach the ends of the range."""
    low, high = options.range
    half, turn = options.period // 2, options.turn
    flat = half - turn
    if flat < 1:
        raise UsageError(
            f"`frequency` {options.frequency:g}: a flank of {half} rows has no room for a turn of {turn} "
            f"(below {0.5 * options.rate / (turn + 1):.4g})"
        )
    tip = (high - low) * turn / math.pi / (flat + 2.0 * turn / math.pi)
    waves = strokes(
        (low + tip, high - tip), flat, turn, 2 * (options.cycles or 1), options.loop
    )
    percent = 100.0 * flat / half
    note = f"a cycle in {2 * half / options.rate:.6g} s, {percent:.3g} % of it linear"
    return Move((np.clip(waves, low, high),), [note])


def _sine(options: TrajectoryOptions) -> Move:
    """Return cycles that begin and end at the lower end, at rest."""
    phase = eased(options.period, options.cycles or 1, options.loop)
    note = f"a cycle in {options.period / options.rate:.6g} s"
    if not options.loop:
        note += "; the first half and the last take twice as long each"
    return Move(
        (_between(options.range, 0.5 - 0.5 * np.cos(2.0 * math.pi * phase)),), [note]
    )


def _spiral(options: TrajectoryOptions) -> Move:
    """Return an Archimedean spiral from the middle outwards, at a constant number of turns a second."""
    turns = options.turns or 1
    phase = eased(options.period, turns)
    angle, radius = 2.0 * math.pi * phase, 0.5 * phase / turns
    first = _between(options.range, 0.5 + radius * np.cos(angle))
    second = _between(options.slow_range or options.range, 0.5 + radius * np.sin(angle))
    return Move(
        (first, second),
        [f"{turns} turns, one in {options.period / options.rate:.6g} s"],
    )


def _staircase(options: TrajectoryOptions) -> Move:
    """Return levels that are held, up and, unless one way, down again."""
    count, rise = options.steps or 1, max(options.turn, 1)
    dwell = round((options.dwell or 0.0) * options.rate)
    up = np.arange(count + 1.0) / count
    levels = up if options.one_way else np.concatenate([up, up[-2::-1]])
    profile = np.concatenate([risen(rise), np.ones(dwell)])
    blocks = levels[:-1, None] + np.diff(levels)[:, None] * profile
    stairs = np.concatenate([np.zeros(dwell + 1), blocks.ravel()])
    note = (
        f"{levels.size} levels, each held for {dwell / options.rate:.6g} s"
        f" after {rise / options.rate:.3g} s"
    )
    return Move((_between(options.range, stairs),), [note])


_MAKERS = {
    "raster": _raster, "spiral": _spiral, "staircase": _staircase, "sine": _sine, "triangle": _triangle,
}  # fmt: skip
