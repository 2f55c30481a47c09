"""Compensation: the drive that makes an actuator follow a trajectory, within its limits.

``plan`` takes a whole trajectory and gives all rows; ``stream`` takes blocks and gives
blocks, in constant memory. Both run the loop of ``drive/stream.py``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drive import loops
from dbo_cli.drive.drive import Drive
from dbo_cli.drive.lead import Around, Seconds
from dbo_cli.drive.learning import Lesson, PassRecord, Tracked, lesson_of
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.stream import Block, OnLimit, Rows, Stream
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
        raise UsageError("`history` keeps the passes that `tracked` recorded: give both")
    values = np.ascontiguousarray(desired, dtype=np.float64).reshape(-1)
    time, step = read_clock(clock, values.size, name)
    request = values
    lesson: Lesson | None = None
    if tracked or periodic or bandwidth is not None:
        step = _require_step(step, name, "`tracked`, `periodic` and `bandwidth` need an even clock")
    if tracked:
        assert step is not None
        begin = 0.0 if time is None else float(time[0])
        lesson = lesson_of(
            model, values, begin, step, tracked, history, around.state, bandwidth, periodic, absolute
        )
        request = lesson.request
    if periodic:
        assert step is not None
        if bandwidth is not None and lesson is None:
            request = ZeroPhaseLowPass(bandwidth, step).loop(values)
        loop = loops.Loop(model, values, request, time, step, limits, around, on_limit, name)
        return _learned(loop.plan(passes), lesson)
    blocks = [Block(time, values, request)]
    if bandwidth is not None and lesson is None:
        assert step is not None
        blocks = _rounded(time, values, ZeroPhaseLowPass(bandwidth, step))
    rows = Stream(model, blocks, step, limits, around, on_limit, name, keeps=True)
    return _learned(_whole(rows), lesson)


class stream:
    """Placeholder."""


def read_clock(clock: Clock, count: int, name: str) -> tuple[Floats | None, float | None]:
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
