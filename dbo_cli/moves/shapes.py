"""Moves that people write by hand: raster, spiral, staircase, sine, triangle.

Everything is made of four pieces: a line of constant speed, a turn, a start or stop,
and a rise from level to level. Their accelerations are sines that begin and end at
zero, so that nothing jumps but what no rounding was asked for; each turn and each rise
takes one period of the bandwidth.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dbo_cli.arrays import Floats, Range
from dbo_cli.drive.limits import rounded_down
from dbo_cli.errors import UsageError, require_positive
from dbo_cli.model import Cascade

Axes = tuple[Floats, ...]
"""One signal an axis."""

RANGE_ROUNDING = 1e-8  # of the range: rounding reaches no further
START = 2.0 / math.pi
"""Of a turn's rows: a start of so many reaches as far outside a line as a turn does, more gently than it."""
FEWEST_CYCLE_ROWS = 4
"""Of a line or cycle: a triangle of fewer has no rows between its turns."""


class Trajectory(NamedTuple):
    """A move with its clock.

    Attributes
    ----------
    time : array of shape (rows,)
        Seconds, even, from 0.
    axes : tuple of array of shape (rows,)
        One signal an axis: the displacement, or x and y.
    note : str
        What became of it, in words.
    """

    time: Floats
    axes: tuple[Floats, ...]
    note: str


class _Plan(NamedTuple):
    """What is asked for, in rows: of a line, cycle or dwell, of a turn or rise, and how many of them."""

    ends: Range
    period: int
    turn: int
    cycles: int
    loop: bool


def trajectory(
    shape: str,
    *,
    rate: float,
    range: Range,
    frequency: float | None = None,
    lines: int | None = None,
    steps: int | None = None,
    dwell: float | None = None,
    duration: float | None = None,
    loop: bool = False,
    bandwidth: float | None = None,
) -> Trajectory:
    """Return a move that starts and stops softly.

    Parameters
    ----------
    shape : {"raster", "spiral", "staircase", "sine", "triangle"}
        What is moved along. Raster and spiral have two axes.
    rate : float
        Rows a second (Hz).
    range : (float, float)
        From where to where, every axis. The turns of a raster lie beyond it.
    frequency : float
        Lines, turns of a spiral, or cycles a second (Hz).
    lines : int
        Of a raster.
    steps, dwell : int, float
        Of a staircase: steps up, and as many down; seconds at each level.
    duration : float
        Seconds of a spiral, sine or triangle, which make a whole number of turns or
        cycles; one cycle where not given. The soft start and stop come on top.
    loop : bool
        One period that closes and repeats, without start and stop: whole cycles; of a
        raster one frame up and one frame down.
    bandwidth : float, optional
        Each turn, rise, start and stop takes one period of it (Hz); sharp where not
        given.

    Raises
    ------
    UsageError
        An option is missing, senseless, or of another shape; or the move is too fast
        for its rate or its bandwidth. The message says which number would fit.
    """
    figures = {
        "frequency": frequency, "lines": lines, "steps": steps, "dwell": dwell, "duration": duration,
    }  # fmt: skip
    form = SHAPES.get(shape)
    if form is None:
        raise UsageError(f"SHAPE {shape}: give one of {', '.join(SHAPES)}")
    for name, value in {**figures, "loop": loop or None}.items():
        takes = name in form.needed
        if takes is (value is None) and name not in form.possible:
            needed = "needs" if takes else "does not take"
            raise UsageError(f"`{name}`: a {shape} {needed} it")
    low, high = range
    if not -math.inf < low < high < math.inf:
        raise UsageError(
            f"`range` {low:g}:{high:g}: give two finite numbers, the lower first"
        )
    require_positive(rate=rate, bandwidth=bandwidth, **figures)
    turn = 0 if bandwidth is None else math.ceil(rate / bandwidth)
    if shape == "staircase":
        assert steps is not None
        assert dwell is not None
        plan = _Plan(range, round(dwell * rate), max(turn, 1), steps, loop)
    else:
        assert frequency is not None
        count = lines or max(round((duration or 0.0) * frequency), 1)
        period = round(rate / frequency)
        fewest = max(FEWEST_CYCLE_ROWS, form.turns * turn + 2)
        if period < fewest:
            highest = rounded_down(rate / fewest, 4)
            raise UsageError(
                f"`frequency` {frequency:g}: too fast for `rate` and `bandwidth`: give {highest:.4g}"
            )
        plan = _Plan(range, period, turn, count, loop)
    axes = form.make(plan)
    noun = form.noun if plan.cycles > 1 else form.noun.removesuffix("s")
    note = f"{plan.cycles:,} {noun}, {plan.period / rate:.6g} s each"
    least, greatest = float(axes[0].min()), float(axes[0].max())
    if least < low or greatest > high:
        note += f", turns from {least:.6g} to {greatest:.6g}"
    return Trajectory(np.arange(axes[0].size) / rate, axes, note)


def check_reach(move: Trajectory, models: Sequence[Cascade]) -> None:
    """Refuse a move that a model does not reach, its turns included.

    Parameters
    ----------
    move
        The move.
    models
        The model of each axis, the last one also of the axes after it.

    Raises
    ------
    UsageError
        The move leaves what a model reaches.
    """
    for number, axis in enumerate(move.axes):
        output = models[min(number, len(models) - 1)].output
        slack = RANGE_ROUNDING * output.span
        lowest, highest = float(axis.min()), float(axis.max())
        if lowest < output.min - slack or highest > output.max + slack:
            raise UsageError(
                f"the move goes from {lowest:.6g} to {highest:.6g}, the model from {output.min:.6g} to "
                f"{output.max:.6g}{output.suffix}: narrow `range`"
            )


# --- the pieces: rows after the one that they begin at ---


def _steps(count: int) -> Floats:
    return np.arange(1.0, count + 1.0)


def _turned(center: float, speed: float, count: int) -> Floats:
    """Return a turn at ``center`` from ``speed`` (a row) to its opposite, count speed/pi beyond."""
    angle = math.pi * _steps(count) / max(count, 1)
    return center + speed * count / math.pi * np.sin(angle)


def _started(end: float, speed: float, count: int) -> Floats:
    """Return a start from rest that arrives at ``end`` with ``speed``, the row at rest included."""
    row = np.arange(count + 1.0)
    bend = np.sin(math.pi * row / max(count, 1))
    distance: Floats = 0.5 * row - 0.5 * count / math.pi * bend
    return end + speed * (distance - 0.5 * count)


def _risen(count: int) -> Floats:
    """Return the way from 0 to 1: its acceleration is one period of a sine."""
    phase = _steps(count) / max(count, 1)
    share: Floats = phase - np.sin(2.0 * math.pi * phase) / (2.0 * math.pi)
    share[-1:] = 1.0
    return share


def _strokes(ends: Range, flat: int, turn: int, count: int, loop: bool) -> Floats:
    """Return ``count`` lines there and back between two ends, ``flat`` rows each, with start and stop.

    Without them in a loop, whose first row follows on its last.
    """
    low, high = ends
    speed = (high - low) / flat
    share = _steps(flat) / flat
    up = [low + (high - low) * share, _turned(high, speed, turn)]
    back = [high - (high - low) * share, _turned(low, -speed, turn)]
    pair = np.concatenate(up + back)
    lines = np.tile(pair, (count + 1) // 2)[: count * (flat + turn)]
    if loop:
        return np.roll(lines, 1)
    soft_rows = math.floor(START * turn)
    end, pace = low, -speed
    if count % 2:
        end, pace = high, speed
    # a stop is a start played backwards
    stop = _started(end, -pace, soft_rows)[::-1][1:]
    begin = _started(low, speed, soft_rows)
    return np.concatenate([begin, lines[: lines.size - turn], stop])


def _eased(period: int, count: int, loop: bool) -> Floats:
    """Return a phase from 0 to ``count``, ``period`` rows each; the first and last half are half as fast."""
    if loop:
        return np.arange(float(count * period)) / period
    begin = _started(0.5, 1.0 / period, period)
    line = 0.5 + _steps((count - 1) * period) / period
    return np.concatenate([begin, line, count - begin[::-1][1:]])


def _between(ends: Range, share: Floats) -> Floats:
    low, high = ends
    return np.clip(low + (high - low) * share, low, high)


# --- the shapes ---


def _raster(plan: _Plan) -> Axes:
    """Return a line axis and a slow one, which stands still while a line is drawn."""
    turn, count = plan.turn, plan.cycles
    flat = plan.period - turn
    levels = np.linspace(*plan.ends, count)
    if count == 1:
        levels = np.array([plan.ends[0]])
    if plan.loop:
        levels = np.concatenate([levels, levels[::-1]])
    fast = _strokes(plan.ends, flat, turn, levels.size, plan.loop)
    # a line at one level, and the way to the next in its turn
    profile = np.concatenate([np.zeros(flat), _risen(turn)])
    following = np.append(levels[1:], levels[0])
    blocks = levels[:, None] + (following - levels)[:, None] * profile
    if plan.loop:
        slow = np.roll(blocks.ravel(), 1)
    else:
        soft_rows = math.floor(START * turn)
        begin = np.full(soft_rows + 1, levels[0])
        end = np.full(flat + soft_rows, levels[-1])
        slow = np.concatenate([begin, blocks[:-1].ravel(), end])
    return fast, slow


def _triangle(plan: _Plan) -> Axes:
    """Return a triangle whose tips are turns that reach the ends of the range."""
    low, high = plan.ends
    half, turn = plan.period // 2, plan.turn
    flat = half - turn
    tip = (high - low) * turn / math.pi / (flat + 2.0 * turn / math.pi)
    waves = _strokes((low + tip, high - tip), flat, turn, 2 * plan.cycles, plan.loop)
    return (np.clip(waves, low, high),)


def _sine(plan: _Plan) -> Axes:
    """Return cycles that begin and end at the lower end, at rest."""
    phase = _eased(plan.period, plan.cycles, plan.loop)
    wave = 0.5 - 0.5 * np.cos(2.0 * math.pi * phase)
    return (_between(plan.ends, wave),)


def _spiral(plan: _Plan) -> Axes:
    """Return an Archimedean spiral from the middle outwards, at a constant number of turns a second."""
    phase = _eased(plan.period, plan.cycles, False)
    angle = 2.0 * math.pi * phase
    radius = 0.5 * phase / plan.cycles
    x = _between(plan.ends, 0.5 + radius * np.cos(angle))
    y = _between(plan.ends, 0.5 + radius * np.sin(angle))
    return x, y


def _staircase(plan: _Plan) -> Axes:
    """Return levels that are held, up and down again: a dwell is a period, a rise a turn."""
    steps, dwell, rise = plan.cycles, plan.period, plan.turn
    up = np.arange(steps + 1.0) / steps
    levels = np.concatenate([up, up[-2::-1]])
    profile = np.concatenate([_risen(rise), np.ones(dwell)])
    blocks = levels[:-1, None] + np.diff(levels)[:, None] * profile
    stairs = np.concatenate([np.zeros(dwell + 1), blocks.ravel()])
    return (_between(plan.ends, stairs),)


class _Shape(NamedTuple):
    """How a shape is made, of what, what it needs and takes besides, and the turns in a period."""

    make: Callable[[_Plan], Axes]
    noun: str
    needed: tuple[str, ...]
    possible: tuple[str, ...] = ()
    turns: int = 1


SHAPES = {
    "raster": _Shape(_raster, "lines", ("frequency", "lines"), ("loop",)),
    "spiral": _Shape(_spiral, "turns", ("frequency", "duration")),
    "staircase": _Shape(_staircase, "steps up and down", ("steps", "dwell")),
    "sine": _Shape(_sine, "cycles", ("frequency",), ("duration", "loop")),
    "triangle": _Shape(_triangle, "cycles", ("frequency",), ("duration", "loop"), 2),
}
