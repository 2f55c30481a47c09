"""A recording and a trajectory that lie in two files: which rows belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.reports.pair import Pair, mean_step, rows_text, stretch

SAME_RATE = 1e-3
"""Part by which two rates may differ: clocks of two recorders do, by some 1e-4."""
ACTUATOR_LAG = 0.05
"""Seconds that an actuator, its amplifier and its sensor may be late; more is a recorder's start."""
CLEARLY_BETTER = 0.5
"""Part of the error that must be left at most for another start of the clock to be believed."""
SEARCHED = 1 << 17
"""Rows of the longer signal at most in the search for the start of a clock."""
FEWEST = 16
"""Rows that the search needs."""
STEPS, FURTHEST = 8, 20.0
"""Steps of the refinement at most, and rows that one may go."""
PLAYS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Half widths, in parts of the range, of the plays that explain a loop beside a lag."""


def match(
    recording: Pair,
    desired: Floats,
    desired_time: Floats | None = None,
    match: str = "auto",
    trajectory_name: str = "the trajectory",
) -> Pair:
    """Give every row of a recording the desired value that belongs to it.

    Parameters
    ----------
    recording
        The measured values, perhaps with a clock.
    desired : array of shape (other rows,)
        The trajectory, perhaps with rows before the move at negative times.
    desired_time : array, optional
        Seconds.
    match : {"auto", "time", "rows"}
        "rows": the first belongs to the first. "time": by two clocks that agree.
        "auto": by time where both have one, else by rows; a recorder that was started
        earlier or later is found, taken off and noted.
    trajectory_name
        How messages call the trajectory.

    Raises
    ------
    InputError
        The rates differ where rows are matched, a clock is missing, or no row of one
        belongs to a row of the other.
    """
    name, recording = recording.name, replace(recording, on_drive_clock=True)
    clocked = recording.time is not None and desired_time is not None
    if match == "rows" or (match == "auto" and not clocked):
        return _by_rows(recording, desired, desired_time, trajectory_name)
    if recording.time is None or desired_time is None:
        lacking = name if recording.time is None else trajectory_name
        raise InputError(f"{lacking}: has no time: add `sample_rate`, or `match` rows")
    if match == "auto":
        recording = _on_one_clock(recording, desired, desired_time, trajectory_name)
    pair = _by_time(recording, desired, desired_time)
    if not len(pair):
        raise InputError(
            f"{name}: no row lies within the time of {trajectory_name}: try `match` rows"
        )
    beyond = len(recording) - len(pair)
    if beyond:
        pair = pair.noted(
            f"{rows_text(beyond)} outside the time of {trajectory_name} left out"
        )
    return pair


def _by_rows(
    recording: Pair, wanted: Floats, clock: Floats | None, trajectory: str
) -> Pair:
    """Match row by row; the time is the trajectory's."""
    step, wanted_step = recording.step(), mean_step(clock)
    if step is not None and wanted_step is not None:
        if abs(step / wanted_step - 1.0) > SAME_RATE:
            raise InputError(
                f"{recording.name}: {1.0 / step:.5g} Hz, {trajectory}: {1.0 / wanted_step:.5g} Hz:"
                " rows do not correspond; type `match` time"
            )
    count = min(len(recording), len(wanted))
    pair = replace(recording.taken(slice(0, count)), desired=wanted[:count])
    if clock is not None:
        pair = replace(pair, time=clock[:count])
    surplus = len(recording) - len(wanted)
    if surplus:
        relation = "more" if surplus > 0 else "fewer"
        pair = pair.noted(f"{rows_text(abs(surplus))} {relation} than in {trajectory}")
    return pair


def _by_time(recording: Pair, wanted: Floats, clock: Floats) -> Pair:
    """Match by time: the desired signal is interpolated at the recording's times."""
    assert recording.time is not None
    slack = 1e-6 * (mean_step(clock) or 0.0)
    begin, end = clock[0] - slack, clock[-1] + slack
    pair = recording.taken(stretch((recording.time >= begin) & (recording.time <= end)))
    assert pair.time is not None
    return replace(pair, desired=np.interp(pair.time, clock, wanted))


def _on_one_clock(
    recording: Pair, wanted: Floats, clock: Floats, trajectory: str
) -> Pair:
    """Take off by how much the recorder was started earlier or later, where that is evident.

    A lag that an actuator may have stays: it is part of the error. So does whatever
    explains less than half of the error.
    """
    offset = _clock_ahead(recording, wanted, clock)
    step = recording.step() or 0.0
    if offset is None or -0.5 * step <= offset <= ACTUATOR_LAG:
        return recording
    assert recording.time is not None
    shifted = replace(recording, time=recording.time - offset, clock_offset=offset)
    before = _scatter(_by_time(recording, wanted, clock))
    if _scatter(_by_time(shifted, wanted, clock)) > CLEARLY_BETTER * before:
        return recording
    side = "ahead of" if offset > 0.0 else "behind"
    return shifted.noted(
        f"its clock is {abs(offset):.4g} s {side} that of {trajectory}; this is taken off"
    )


def _scatter(pair: Pair) -> float:
    """Return the RMS of the error without its mean; infinite for fewer than two rows."""
    if len(pair) < 2:
        return np.inf
    return float(np.std(pair.measured - pair.desired))


def _clock_ahead(recording: Pair, wanted: Floats, clock: Floats) -> float | None:
    """Return how far the recorder's clock is ahead (s), from the two signals; None where they do not tell.

    The coarse shift is that of greatest correlation. What is left of it is the weight
    of the derivative beside plays, which explain the loop that looks like a lag.
    """
    from dbo_cli.drive.check import lag_of

    time = recording.time
    assert time is not None
    longest = max(np.ptp(time), np.ptp(clock))
    step = max(recording.step() or 0.0, mean_step(clock) or 0.0, longest / SEARCHED)
    if not step > 0.0:
        return None
    grid = np.arange(clock[0], clock[-1], step)
    desired = np.interp(grid, clock, wanted)
    stamps = np.arange(time[0], time[-1], step)
    measured = np.interp(stamps, time, recording.measured)
    if min(len(grid), len(stamps)) < FEWEST or not np.ptp(measured) * np.ptp(desired):
        return None
    rows, _ = lag_of(desired, measured)
    offset = float(stamps[0] - grid[0] + rows * step)
    columns = [np.ones_like(desired), desired, np.gradient(desired, step)]
    for part in PLAYS:
        columns.append(_play(desired, 0.5 * part * float(np.ptp(desired))))
    for _ in range(STEPS):
        times = stamps - offset
        inside = (times >= grid[0]) & (times <= grid[-1])
        if np.count_nonzero(inside) < FEWEST:
            return None
        shifted = [np.interp(times[inside], grid, column) for column in columns]
        table = np.column_stack(shifted)
        weights = np.linalg.lstsq(table, measured[inside], rcond=None)[0]
        gain = weights[1] + weights[3:].sum()
        late = np.clip(-weights[2] / gain, -FURTHEST * step, FURTHEST * step)
        offset += float(late)
        if abs(late) < 1e-3 * step:
            break
    return offset


def _play(x: Floats, radius: float) -> Floats:
    """Return the play of a signal: it follows at a distance of ``radius``, and rests in between."""
    y = np.empty_like(x)
    state = float(x[0])
    for place, value in enumerate(x.tolist()):
        state = min(max(state, value - radius), value + radius)
        y[place] = state
    return y
