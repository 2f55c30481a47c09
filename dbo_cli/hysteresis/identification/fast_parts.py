"""Where in the logs an actuator's dynamics can be seen: small sweeps, and fast logs beside slow ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.hysteresis.identification.recordings import FEWEST_ROWS, Floats, Recording
from dbo_cli.hysteresis.move_error import turning_points

SMALLEST_SWING = 5e-4  # of the log's range: smaller reversals of the drive are converter steps and noise
LARGEST_SWING = 0.35  # of the range, in a sweep: larger swings are loops
FEWEST_SWINGS = 40  # in a sweep
SWEPT = 5.0  # the highest frequency of a sweep over its lowest, at least
SMOOTH = 0.7  # of neighbouring half periods, the larger over the smaller, as a logarithm: a sweep is gradual
FASTER = 10.0  # the half periods of a slow log over those of a fast one (medians), at least
FEWEST_A_PERIOD = 6  # samples, of the highest frequency taken
WIDER = 2.0  # periods of a sweep's lowest frequency that belong to it before and after


@dataclass(frozen=True)
class FastPart:
    """Rows of a log in which the drive is fast, with those before them, which tell the state of the gears.

    Attributes
    ----------
    recording : Recording
        The whole log.
    rows : slice
        The fast ones.
    time_step : float
        Seconds.
    lowest, highest : float
        Frequencies that the drive has there, Hz.
    """

    recording: Recording
    rows: slice
    time_step: float
    lowest: float
    highest: float


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[FastPart]]:
    """Return the logs without their fast parts, and these; no fast parts where none are to be told."""
    slow: list[Recording] = []
    fast: list[FastPart] = []
    span = max(float(np.ptp(log.voltage)) for log in recordings)
    steps = [grid_step(log) for log in recordings]
    sweeps = [
        None if step is None else _sweep(log, span, step) for log, step in zip(recordings, steps, strict=True)
    ]
    # A log that is a sweep from end to end has nothing else to tell the gears from.
    sweeps = [
        found if found is None or _without(log, found.rows).voltage.size >= FEWEST_ROWS else None
        for log, found in zip(recordings, sweeps, strict=True)
    ]
    # Beside loops, a sweep's many swings do not make a log a fast one.
    loops = [
        log if found is None else _without(log, found.rows)
        for log, found in zip(recordings, sweeps, strict=True)
    ]
    halves = [_median_half_period(rest, span) for rest in loops]
    halves = [_median_half_period(log, span) if half is None else half
              for log, half in zip(recordings, halves, strict=True)]  # fmt: skip
    slowest = max((half for half in halves if half is not None), default=None)
    for log, step, found, rest, half in zip(recordings, steps, sweeps, loops, halves, strict=True):
        if step is not None and half is not None and slowest is not None and FASTER * half <= slowest:
            fast.append(FastPart(log, slice(0, log.voltage.size), step, *_band(log, span, step)))
        elif found is not None:
            fast.append(found)
            slow.append(rest)
        else:
            slow.append(log)
    return slow, fast


def grid_step(log: Recording) -> float | None:
    """Return the step (s) of an even grid of which each sample is nearest to its own place, or None."""
    if log.sample_period is not None and log.time is None:
        return log.sample_period
    if log.time is None or log.time.size < 2:
        return None
    step = float(log.time[-1] - log.time[0]) / (log.time.size - 1)
    if not step > 0.0:
        return None
    away = np.abs(log.time - (log.time[0] + step * np.arange(log.time.size)))
    return step if float(away.max()) <= 0.5 * step else None


def _swings(voltage: Floats, span: float) -> tuple[Floats, Floats]:
    """Return the rows where the drive turns, the ends included, and the voltage there."""
    turns = turning_points(voltage, SMALLEST_SWING * span).astype(np.float64)
    rows = np.concatenate([[0.0], turns, [voltage.size - 1.0]])
    return rows, voltage[rows.astype(np.int64)]


def _median_half_period(log: Recording, span: float) -> float | None:
    """Return the median time between turns (s), None where there are too few."""
    seconds = log.seconds()
    rows, _ = _swings(log.voltage, span)
    if seconds is None or rows.size < 6:
        return None
    return float(np.median(np.diff(seconds[rows.astype(np.int64)])))


def _band(log: Recording, span: float, step: float) -> tuple[float, float]:
    """Return the lowest and highest frequency of a fast log's drive (Hz), by its turns."""
    rows, _ = _swings(log.voltage, span)
    halves = np.diff(rows)[1:-1] * step
    halves = halves[halves > 0.0]
    return 0.5 / float(np.quantile(halves, 0.98)), 0.5 / max(float(np.quantile(halves, 0.02)), step)


def _sweep(log: Recording, span: float, step: float) -> FastPart | None:
    """Return the longest run of small swings whose frequency changes gradually over a wide band."""
    rows, levels = _swings(log.voltage, span)
    halves, heights = np.diff(rows), np.abs(np.diff(levels))
    near = np.abs(np.diff(np.log(np.maximum(halves, 1.0)))) <= SMOOTH
    small = heights <= LARGEST_SWING * span
    good = small[1:] & small[:-1] & (near | (np.minimum(halves[1:], halves[:-1]) <= FEWEST_A_PERIOD))
    best = (0, 0)
    begin = None
    for k, fine in enumerate([*good.tolist(), False]):
        if fine and begin is None:
            begin = k
        if not fine and begin is not None:
            if k - begin > best[1] - best[0]:
                best = (begin, k)
            begin = None
    first, last = best
    if last - first < FEWEST_SWINGS:
        return None
    periods = 2.0 * step * halves[first : last + 1]
    fastest, slowest = float(np.quantile(periods, 0.05)), float(np.quantile(periods, 0.98))
    if slowest < SWEPT * fastest or fastest < FEWEST_A_PERIOD * step * 0.5:
        return None
    wider = round(WIDER * slowest / step)
    start = max(int(rows[first]) - wider, 0)
    stop = min(int(rows[last + 1]) + wider, log.voltage.size)
    return FastPart(log, slice(start, stop), step, 1.0 / slowest, 1.0 / float(periods.min()))


def _without(log: Recording, rows: slice) -> Recording:
    """Return a log up to its fast rows, or from behind them where that is the longer part."""
    keep = slice(0, rows.start) if rows.start >= log.voltage.size - rows.stop else slice(rows.stop, None)
    return replace(
        log,
        voltage=log.voltage[keep],
        displacement=log.displacement[keep],
        time=None if log.time is None else log.time[keep],
    )
