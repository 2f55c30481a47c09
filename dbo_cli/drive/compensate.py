"""Compensation: the drive that makes an actuator follow a trajectory, within its limits.

``plan`` takes a whole trajectory and gives all rows; ``stream`` takes blocks and gives
blocks, in constant memory. Both run the loop of ``drive/stream.py``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Around, Seconds
from dbo_cli.drive.learning import Lesson, PassRecord, RepeatedMove, Tracked
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.loops import Loop
from dbo_cli.drive.stream import BLOCK_ROWS, Block, OnLimit, Stream
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import Model, State, ZeroPhaseLowPass

Floats = NDArray[np.float64]
Clock = float | ArrayLike | None

JITTER = 0.05  # of a step: stamps this near to an even clock are those of one; chosen


def plan(
    model: Model,
    desired: ArrayLike,
    clock: Clock,
    limits: Limits,
    *,
    state: str | State = "auto",
    start: float | None = None,
    approach: Seconds = None,
    condition: bool = False,
    lead: Seconds = None,
    return_to: float | None = None,
    bandwidth: float | None = None,
    periodic: bool = False,
    passes: int = 0,
    on_limit: OnLimit = "auto",
    tracked: Sequence[Tracked] = (),
    history: Sequence[PassRecord] = (),
    absolute: bool = False,
    name: str = "trajectory",
) -> Drive:
    """Return the drive of a whole trajectory.

    Parameters
    ----------
    model : Model
        A forward model.
    desired : array, shape (n,)
        Displacement, in the unit of the model's output.
    clock : float, array of shape (n,), or None
        Seconds a row, or the time of each row (s).
    limits : Limits
        What the drive may do.
    state : str or State
        ``auto``, ``empty``, ``full``, ``settled``, or the state to go on from.
    start : float, optional
        Voltage at which the amplifier stands.
    approach, lead : float or "auto", optional
        Seconds of the way to the first value, and of a rest there.
    condition : bool
        Sweep the move's range first, so that the past is known.
    return_to : float, optional
        Voltage to go to after the move.
    bandwidth : float, optional
        Cut-off (Hz) of a zero-phase low-pass on the trajectory; with ``tracked``, on
        what is learned.
    periodic : bool
        The trajectory is one period of a loop; the drive is that of the settled loop.
    passes : int
        Passes of run-in before that period.
    on_limit : {"auto", "clip", "error"}
        auto: clip while that costs at most one percent of the move (RMS).
    tracked, history : sequence
        Recordings of the last pass, and the passes so far: the move is learned.
    absolute : bool
        Learn the mean of the error, too.
    name : str
        Of the trajectory, in messages.

    Raises
    ------
    LimitError
        The move cannot be driven within the limits, or costs too much of it.
    InputError
        The trajectory, its clock or a recording is bad.
    UsageError
        Options exclude each other.
    """
    around = Around(state, start, approach, condition, lead, return_to)
    if passes and not periodic:
        raise UsageError("`passes` is the run-in of a loop (`periodic`)")
    if history and not tracked:
        raise UsageError(
            "`history` keeps the passes that `tracked` recorded: give both"
        )
    values = np.ascontiguousarray(desired, dtype=np.float64).reshape(-1)
    time, step = read_clock(clock, values.size, name)
    request = values
    lesson: Lesson | None = None
    if not (tracked or periodic or bandwidth is not None):
        blocks = [Block(time, values, values)]
        return _whole(Stream(model, blocks, step, limits, around, on_limit, name))
    even = _require_step(
        step, name, "`tracked`, `periodic` and `bandwidth` need an even clock"
    )
    if tracked:
        begin = 0.0 if time is None else float(time[0])
        move = RepeatedMove(model, values, begin, even, state, periodic, absolute)
        lesson = move.lesson(tracked, history, bandwidth)
        request = lesson.request
    low_pass = None
    if bandwidth is not None and lesson is None:
        low_pass = ZeroPhaseLowPass(bandwidth, even)
    if periodic:
        if low_pass is not None:
            request = low_pass.loop(values)
        loop = Loop(model, values, request, time, even, limits, around, on_limit, name)
        return _learned(loop.plan(passes), lesson)
    blocks = [Block(time, values, request)]
    if low_pass is not None:
        blocks = _rounded(time, values, low_pass)
    return _learned(
        _whole(Stream(model, blocks, even, limits, around, on_limit, name)),
        lesson,
    )


def stream(
    model: Model,
    blocks: Iterable[tuple[Floats | None, Floats]],
    step: float | None,
    limits: Limits,
    *,
    state: str | State = "auto",
    start: float | None = None,
    approach: Seconds = None,
    condition: bool = False,
    lead: Seconds = None,
    return_to: float | None = None,
    on_limit: OnLimit = "auto",
    block_rows: int = BLOCK_ROWS,
    name: str = "trajectory",
) -> Stream:
    """Return the drive of a trajectory that comes in blocks; iterate over it once.

    Parameters
    ----------
    blocks
        Pairs of times (s; None without a clock) and displacements.
    step
        Seconds a row of an even clock; None: uneven, or no clock.
    block_rows
        Blocks are cut to so many rows; the values stay the same to rounding.

    The other parameters are those of ``plan``. With ``on_limit`` auto a move that loses
    more than one percent is refused at the end of the iteration.
    """
    around = Around(state, start, approach, condition, lead, return_to)
    moves = (Block(time, desired, desired) for time, desired in blocks)
    return Stream(model, moves, step, limits, around, on_limit, name, block_rows)


def _whole(stream: Stream) -> Drive:
    """Return all rows of a stream, with its figures."""
    parts = list(stream)
    drive = stream.drive
    assert drive is not None
    before = drive.lead.rows
    time = None
    if all(part.time is not None for part in parts):
        time = np.concatenate([part.time for part in parts])
    return dataclasses.replace(
        drive,
        time=time,
        desired=np.concatenate([part.desired for part in parts]),
        voltage=np.concatenate([part.voltage for part in parts]),
        move=slice(before, before + stream.loss.move.rows),
    )


def _learned(drive: Drive, lesson: Lesson | None) -> Drive:
    """Return a drive with what a lesson said and the history with its pass."""
    if lesson is None:
        return drive
    return dataclasses.replace(
        drive,
        history=lesson.history,
        notes=(*lesson.notes, *drive.notes),
        warnings=(*lesson.warnings, *drive.warnings),
        expected_error=None,
        expected_known=None,
    )


def _rounded(
    time: Floats | None, desired: Floats, low_pass: ZeroPhaseLowPass
) -> list[Block]:
    """Return a rounded trajectory, and behind it the rows in which it comes to rest, to be read ahead."""
    rest = np.full(low_pass.reach, desired[-1])
    rounded = low_pass.whole(np.concatenate([desired, rest]))
    tail = rounded[desired.size :]
    return [
        Block(time, desired, rounded[: desired.size]),
        Block(None, tail, tail, "tail"),
    ]


def _require_step(step: float | None, name: str, why: str) -> float:
    """Return the step of an even clock (InputError: there is none)."""
    if step is None:
        raise InputError(f"{name}: {why} (`sample_rate` HZ, or `resample` HZ)")
    return step


def read_clock(
    clock: Clock, count: int, name: str
) -> tuple[Floats | None, float | None]:
    """Return the time of each row (None: not given) and the step of an even clock (None: uneven).

    Raises
    ------
    InputError
        There are more or fewer times than rows, or a step is not above 0.
    """
    if clock is None:
        return None, None
    if np.ndim(clock) == 0:
        step = float(np.asarray(clock))
        if not 0.0 < step < np.inf:
            raise InputError(f"{name}: {step:g} s between rows: give seconds above 0")
        return None, step
    time = np.ascontiguousarray(clock, dtype=np.float64).reshape(-1)
    if time.size != count:
        raise InputError(f"{name}: {time.size:,} times for {count:,} rows")
    if not np.isfinite(time).all():
        raise InputError(f"{name}: a time is no number")
    return time, even_step(time)


def even_step(time: Floats) -> float | None:
    """Return the step (s) of stamps on an even clock; None where they are not even."""
    if time.size < 2:
        return None
    step = float(time[-1] - time[0]) / (time.size - 1)
    if not step > 0.0:
        return None
    away = np.abs(time - (time[0] + step * np.arange(time.size)))
    return step if away.max() <= JITTER * step else None
