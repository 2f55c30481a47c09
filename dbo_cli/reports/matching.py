"""A recording and a trajectory that lie in two files: which rows belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, UsageError
from dbo_cli.reports.merits import Floats, root_mean_square
from dbo_cli.reports.pair import Pair, RowRange, mean_step, rows_text

SAME_RATE = 1e-3
"""Part by which two rates may differ: clocks of two recorders do, by some 1e-4."""
OWN_LAG = 0.05
"""Seconds that an actuator, its amplifier and its sensor may be late; more is a recorder's start."""
CLEARLY_BETTER = 0.5
"""Part of the error that must be left at most for another start of the clock to be believed."""
SEARCHED = 1 << 17
"""Rows of the longer signal at most in the search for the start of a clock."""
STEPS, FURTHEST = 8, 20.0
"""Steps of the refinement at most, and rows that one may go."""
PLAYS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Half widths, in parts of the range, of the plays that explain a loop beside a lag."""


def match(
    name: str,
    measured: ArrayLike,
    desired: ArrayLike,
    *,
    measured_time: ArrayLike | None = None,
    desired_time: ArrayLike | None = None,
    dt: float | None = None,
    desired_dt: float | None = None,
    match: str = "auto",
    trajectory_name: str = "the trajectory",
    voltage: ArrayLike | None = None,
    rows: RowRange | None = None,
) -> Pair:
    """Give every row of a recording the desired value that belongs to it.

    Parameters
    ----------
    name, trajectory_name
        How messages call the two.
    measured, voltage : array of shape (rows,)
        The recording.
    desired : array of shape (other rows,)
        The trajectory, perhaps with rows before the move at negative times.
    measured_time, desired_time : array, optional
        Seconds; or ``dt`` and ``desired_dt``, seconds a row.
    match
        "rows": the first belongs to the first. "time": by two clocks that agree.
        "auto": by time where both have one, else by rows; a recorder that was started
        earlier or later is found, taken off and said.
    rows : (first, last), optional
        Rows of the recording that count.

    Raises
    ------
    InputError
        The rates differ where rows are matched, a clock is missing, or no row of one
        belongs to a row of the other.
    UsageError
        ``match`` is none of the three.
    """
    if match not in ("auto", "time", "rows"):
        raise UsageError(f"`match` {match}: give auto, time or rows")
    recording = Pair(
        name,
        np.asarray(measured, dtype=np.float64),
        np.asarray(measured, dtype=np.float64),
        time=_clock(measured_time, dt, len(np.atleast_1d(measured))),
        voltage=None if voltage is None else np.asarray(voltage, dtype=np.float64),
        rows=rows,
    )
    wanted = np.asarray(desired, dtype=np.float64)
    wanted_time = _clock(desired_time, desired_dt, len(wanted))
    timed = recording.time is not None and wanted_time is not None
    if match == "rows" or (match == "auto" and not timed):
        return _by_rows(recording, wanted, wanted_time, trajectory_name)
    if recording.time is None or wanted_time is None:
        lacking = name if recording.time is None else trajectory_name
        raise InputError(f"{lacking}: has no time: give `sample_rate`, or `match` rows")
    if len(wanted_time) < 2 or not (np.diff(wanted_time) > 0.0).all():
        raise InputError(f"{trajectory_name}: its time does not increase: `match` rows")
    if match == "auto":
        recording = _on_one_clock(recording, wanted, wanted_time, trajectory_name)
    return _by_time(recording, wanted, wanted_time, trajectory_name)


def _clock(time: ArrayLike | None, dt: float | None, count: int) -> Floats | None:
    """Return the times of all rows (s); None where no clock is known."""
    if time is not None:
        return np.asarray(time, dtype=np.float64)
    if dt is not None:
        return dt * np.arange(float(count))
    return None


def _by_rows(
    recording: Pair, wanted: Floats, wanted_time: Floats | None, trajectory: str
) -> Pair:
    """Match row by row; the time is the trajectory's."""
    step, wanted_step = mean_step(recording.time), mean_step(wanted_time)
    if step is not None and wanted_step is not None:
        if abs(step / wanted_step - 1.0) > SAME_RATE:
            raise InputError(
                f"{recording.name}: is recorded at {1.0 / step:.5g} Hz, {trajectory} is at "
                f"{1.0 / wanted_step:.5g} Hz: rows do not belong together (`match` time)"
            )
    count = min(len(recording), len(wanted))
    pair = replace(recording.taken(slice(count)), desired=wanted[:count])
    if wanted_time is not None:
        pair = replace(pair, time=wanted_time[:count])
    if len(recording) > count:
        return _noted(
            pair, f"{rows_text(len(recording) - count)} more than in {trajectory}"
        )
    if len(wanted) > count:
        return _noted(
            pair, f"{rows_text(len(wanted) - count)} fewer than in {trajectory}"
        )
    return pair


def _noted(pair: Pair, note: str) -> Pair:
    return replace(pair, notes=(*pair.notes, f"{pair.name}: {note}"))


def _by_time(recording: Pair, wanted: Floats, clock: Floats, trajectory: str) -> Pair:
    """Match by time: the desired signal is interpolated at the recording's times."""
    assert recording.time is not None
    slack = 1e-6 * (clock[-1] - clock[-2])
    inside = (recording.time >= clock[0] - slack) & (
        recording.time <= clock[-1] + slack
    )
    if not inside.any():
        raise InputError(
            f"{recording.name}: no row lies within the time of {trajectory}: `match` rows"
        )
    pair = recording.taken(inside)
    assert pair.time is not None
    pair = replace(pair, desired=np.interp(pair.time, clock, wanted))
    left_out = len(recording) - len(pair)
    if not left_out:
        return pair
    return _noted(
        pair, f"{rows_text(left_out)} outside the time of {trajectory} left out"
    )


def _on_one_clock(
    recording: Pair, wanted: Floats, clock: Floats, trajectory: str
) -> Pair:
    """Take off by how much the recorder was started earlier or later, where that is evident.

    A lag that an actuator may have stays: it is part of the error. So does whatever
    explains less than half of the error.
    """
    offset = _clock_ahead(recording, wanted, clock)
    if offset is None:
        return recording
    step = mean_step(recording.time) or 0.0
    if -0.5 * step <= offset <= OWN_LAG:
        return recording
    assert recording.time is not None
    shifted = replace(recording, time=recording.time - offset)
    before = _scatter(recording, wanted, clock)
    after = _scatter(shifted, wanted, clock)
    if after is None or (before is not None and after > CLEARLY_BETTER * before):
        return recording
    side = "later" if offset > 0.0 else "earlier"
    note = (
        f"its clock reads {abs(offset):.4g} s {side} than that of {trajectory}, which is taken off "
        "(`match` time leaves the clocks as they are)"
    )
    return _noted(replace(shifted, clock_offset=offset), note)


def _scatter(recording: Pair, wanted: Floats, clock: Floats) -> float | None:
    """Return the RMS of the error without its mean where both signals are; None where they are not."""
    assert recording.time is not None
    inside = (recording.time >= clock[0]) & (recording.time <= clock[-1])
    inside &= np.isfinite(recording.measured)
    if np.count_nonzero(inside) < 2:
        return None
    error = recording.measured - np.interp(recording.time, clock, wanted)
    error = error[inside & np.isfinite(error)]
    if len(error) < 2:
        return None
    return root_mean_square(error - np.mean(error))


def _clock_ahead(recording: Pair, wanted: Floats, clock: Floats) -> float | None:
    """Return how far the recorder's clock is ahead (s), from the two signals; None where they do not tell.

    The coarse shift is that of greatest correlation. What is left of it is the weight
    of the derivative beside plays, which explain the loop that looks like a lag.
    """
    time = recording.time
    assert time is not None
    step = max(mean_step(time) or 0.0, mean_step(clock) or 0.0)
    longest = max(time[-1] - time[0], clock[-1] - clock[0])
    if not step > 0.0 or not np.isfinite(recording.measured).all():
        return None
    if not np.isfinite(wanted).all():
        return None
    step = max(step, longest / SEARCHED)
    grid = np.arange(clock[0], clock[-1], step)
    desired = np.interp(grid, clock, wanted)
    seen = np.arange(time[0], time[-1], step)
    measured = np.interp(seen, time, recording.measured)
    if len(grid) < 16 or len(seen) < 16 or not np.ptp(measured) or not np.ptp(desired):
        return None
    rows = _rows_ahead(desired, measured)
    offset = float(seen[0] - grid[0] + rows * step)
    for _ in range(STEPS):
        change = _refined(seen - offset, measured, clock, wanted, step)
        offset += change
        if abs(change) < 1e-3 * step:
            break
    return offset


def _rows_ahead(desired: Floats, measured: Floats) -> int:
    """Return by how many rows measured is later, where at least half of the shorter one is covered."""
    n, m = len(desired), len(measured)
    size = 1 << (n + m).bit_length()
    d = desired - np.mean(desired)
    x = measured - np.mean(measured)
    spectrum = np.conj(np.fft.rfft(d, size)) * np.fft.rfft(x, size)
    correlation = np.fft.irfft(spectrum, size)
    lags = np.arange(-(n - 1), m)
    covered = np.minimum(n + lags, m) - np.maximum(lags, 0)
    products = correlation[lags] / np.sqrt(np.maximum(covered, 1))
    products[covered < 0.5 * min(n, m)] = -np.inf
    return int(lags[np.argmax(products)])


def _refined(
    seen: Floats, measured: Floats, clock: Floats, wanted: Floats, step: float
) -> float:
    """Return by how much later measured still is (s): the weight of the derivative beside a loop."""
    inside = (seen >= clock[0] + step) & (seen <= clock[-1] - step)
    if np.count_nonzero(inside) < 16:
        return 0.0
    at, y = seen[inside], measured[inside]
    x = np.interp(at, clock, wanted)
    after = np.interp(at + step, clock, wanted)
    before = np.interp(at - step, clock, wanted)
    span = float(np.ptp(x))
    if not span > 0.0:
        return 0.0
    columns = [np.ones_like(x), x, (after - before) / (2.0 * step)]
    for part in PLAYS:
        columns.append(_play(x, 0.5 * part * span))
    weights = np.linalg.lstsq(np.column_stack(columns), y, rcond=None)[0]
    gain = float(weights[1] + weights[3:].sum())
    if not gain:
        return 0.0
    return -float(np.clip(weights[2] / gain, -FURTHEST * step, FURTHEST * step))


def _play(x: Floats, radius: float) -> Floats:
    """Return the play of a signal: it follows at a distance of ``radius``, and rests in between."""
    y = np.empty_like(x)
    state = float(x[0])
    for place, value in enumerate(x.tolist()):
        state = min(max(state, value - radius), value + radius)
        y[place] = state
    return y
