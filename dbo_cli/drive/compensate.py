"""Compensation: the drive that makes an actuator follow a trajectory, within its limits.

``plan`` takes a whole trajectory and gives all rows; ``stream`` takes blocks and gives
blocks, in constant memory. Both run the loop of ``drive/stream.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats
from dbo_cli.drive.drive import Drive, OnLimit
from dbo_cli.drive.lead import Lead, Seconds, standing_at
from dbo_cli.drive.limits import Limits
from dbo_cli.drive.stream import Block, Rows, drive_blocks, require_numbers
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import Cascade, State, Steps, steps_of

if TYPE_CHECKING:
    from dbo_cli.drive.learning import PassRecord, Tracked

Clock = float | ArrayLike | None

BLOCK_ROWS = 65_536  # that are driven at once: what they take stays in caches


def plan(
    model: Cascade,
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
    before = Lead(state, start, approach, condition, lead)
    if passes and not periodic:
        raise UsageError("`passes` needs `periodic`")
    if history and not tracked:
        raise UsageError("`history` needs `tracked` LOG")
    drive = Drive(model, limits, on_limit, name)
    drive.gate.last = standing_at(limits, before)
    values = np.ascontiguousarray(desired, dtype=np.float64).reshape(-1)
    require_numbers(name, values)
    time, dt = _clock(clock, values.size, name)
    request = values
    if tracked or periodic or bandwidth is not None:
        seconds, step = _even(time, dt, name)
    if tracked:
        from dbo_cli.drive.learning import RepeatedMove

        move = RepeatedMove(drive, values, seconds, step, state, periodic, absolute)
        request = move.lesson(tracked, history, bandwidth)
    elif bandwidth is not None:
        from dbo_cli.drive.lowpass import low_pass

        request = low_pass(values, bandwidth, step, periodic)
    if periodic:
        from dbo_cli.drive.loops import plan_loop

        if return_to is not None:
            raise UsageError(
                "`periodic` excludes `condition`, `lead` and `return`: use `passes` N"
            )
        plan_loop(drive, values, request, seconds, step, before, passes)
    else:
        blocks = _blocks(time, dt, values, request)
        parts = list(drive_blocks(drive, blocks, before, return_to))
        if time is not None:
            drive.time = np.concatenate([stamps for stamps, _, _ in parts])
        drive.desired = np.concatenate([rows for _, rows, _ in parts])
        drive.voltage = np.concatenate([rows for _, _, rows in parts])
        drive.move = slice(drive.lead_rows, drive.lead_rows + drive.move_rows)
    if tracked:  # the model's own error is what was learned
        drive.expected_error = drive.expected_known = None
    return drive


def stream(
    model: Cascade,
    blocks: Iterable[tuple[Floats | None, Steps, Floats]],
    limits: Limits,
    *,
    state: str | State = "auto",
    start: float | None = None,
    approach: Seconds = None,
    condition: bool = False,
    lead: Seconds = None,
    return_to: float | None = None,
    on_limit: OnLimit = "auto",
    name: str = "trajectory",
) -> tuple[Drive, Iterator[Rows]]:
    """Return the drive of a trajectory that comes in blocks, and its rows: seconds, displacement, voltage.

    The figures of the drive are complete once all rows have been taken.

    Parameters
    ----------
    blocks
        Times (s; None without a clock), seconds since the row before (one number where
        they are even, None without a clock), and displacements. The values do not
        depend on how a trajectory is cut.

    The other parameters are those of ``plan``. With ``on_limit`` auto a move that loses
    more than one percent is refused at the end of the iteration.
    """
    before = Lead(state, start, approach, condition, lead)
    drive = Drive(model, limits, on_limit, name)
    drive.gate.last = standing_at(limits, before)
    moves = ((time, dt, desired, desired) for time, dt, desired in blocks)
    return drive, drive_blocks(drive, moves, before, return_to)


def _blocks(
    time: Floats | None, dt: Steps, desired: Floats, request: Floats
) -> Iterator[Block]:
    """Cut a trajectory into blocks."""
    for begin in range(0, desired.size, BLOCK_ROWS):
        rows = slice(begin, begin + BLOCK_ROWS)
        stamps = None if time is None else time[rows]
        steps = dt[rows] if isinstance(dt, np.ndarray) else dt
        yield stamps, steps, desired[rows], request[rows]


def _clock(clock: Clock, count: int, name: str) -> tuple[Floats | None, Steps]:
    """Return the time of each row, and the seconds between rows; None of both without a clock.

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
        return np.asarray(step * np.arange(count), dtype=np.float64), step
    time = np.ascontiguousarray(clock, dtype=np.float64).reshape(-1)
    if time.size != count:
        raise InputError(f"{name}: {time.size:,} times for {count:,} rows")
    if not np.isfinite(time).all():
        raise InputError(f"{name}: one time is not a number")
    try:
        return time, steps_of(time)
    except InputError as problem:
        raise InputError(f"{name}: {problem}") from None


def _even(time: Floats | None, dt: Steps, name: str) -> tuple[Floats, float]:
    """Return the time of each row and the step of an even clock (InputError: it is uneven)."""
    if time is None or not isinstance(dt, float):
        raise InputError(
            f"{name}: `tracked`, `periodic` and `bandwidth` need an even clock (`sample_rate` HZ, or "
            "`resample` HZ)"
        )
    return time, dt
