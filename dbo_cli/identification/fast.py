"""Fast parts of logs: small sweeps, and logs ten times as fast as another.

Gears, curve and creep are told from the slow rows; resonances from the fast ones, which
a fit without resonances would take for hysteresis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.arrays import Booleans
from dbo_cli.identification.recording import Recording, runs_of
from dbo_cli.signals import turns

FEWEST_SLOW_ROWS = 40  # of a slow part
NOTICEABLE = 3e-4  # of the range: a smaller reversal of the drive is no turn
SMALL_SWING = 0.35  # of the range: a sweep's largest swing
FEWEST_TURNS = 6  # of slow rows, to tell how fast they are
FEWEST_IN_SWEEP = 40  # in a sweep
SWEPT = 5.0  # highest over lowest frequency of a sweep, at least
SMOOTH = 0.7  # of the logarithms of neighbouring half periods: a sweep is gradual
FEWEST_A_PERIOD = 6  # samples of the highest frequency
WIDER = 2.0  # periods of the lowest frequency that belong to a sweep on either side
FASTER = 10.0  # half periods of a slow log over those of a fast one

Band = tuple[float, float]  # lowest and highest frequency of a drive, Hz


@dataclass(frozen=True)
class FastPart:
    """Rows of a log in which the drive is fast; those before them tell the state of the gears.

    Attributes
    ----------
    recording
        The whole log.
    rows
        The fast rows.
    dt
        Time step (s).
    band
        Lowest and highest frequency of the drive there (Hz).
    """

    recording: Recording
    rows: slice
    dt: float
    band: Band


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[FastPart]]:
    """Return the logs with only their slow rows usable, and their fast parts."""
    span = max(float(np.ptp(log.voltage)) for log in recordings)
    sweeps = [_sweep(log, span) for log in recordings]
    halves = []
    for log, sweep in zip(recordings, sweeps, strict=True):
        halves.append(_median_half_period(log, sweep, span))
    slowest = max((half for half in halves if half is not None), default=0.0)
    slow: list[Recording] = []
    fast: list[FastPart] = []
    for log, sweep, half in zip(recordings, sweeps, halves, strict=True):
        step = even_step(log)
        if step is not None and half is not None and FASTER * half <= slowest:
            rows = slice(0, len(log.voltage))
            fast.append(FastPart(log, rows, step, _band(log, span, step)))
        elif sweep is not None:
            fast.append(sweep)
            usable = log.usable.copy()
            usable[sweep.rows] = False  # driven through, but they do not count
            slow.append(replace(log, good=usable))
        else:
            slow.append(log)
    return slow, fast


def even_step(log: Recording) -> float | None:
    """Return the step (s) of an even clock to whose grid each row is nearest, or None."""
    if log.time is None:
        return None
    time = np.asarray(log.time, dtype=np.float64)
    step = float(time[-1] - time[0]) / (time.size - 1)
    if not step > 0.0:
        return None
    deviation = np.abs(time - (time[0] + step * np.arange(time.size)))
    return step if float(deviation.max()) <= 0.5 * step else None


def _median_half_period(
    log: Recording, sweep: FastPart | None, span: float
) -> float | None:
    """Return the median time between turns outside a sweep (s), None where there are too few."""
    rows = turns(log.voltage, NOTICEABLE * span)
    slow = np.ones(len(rows), bool)
    if sweep is not None:
        slow = (rows < sweep.rows.start) | (rows >= sweep.rows.stop)
    if log.time is None or np.count_nonzero(slow) < FEWEST_TURNS:
        return None
    return float(np.median(np.diff(log.time[rows[slow]])))


def _band(log: Recording, span: float, step: float) -> Band:
    """Return the lowest and highest frequency of a fast log's drive (Hz), by its turns."""
    halves = step * np.diff(turns(log.voltage, NOTICEABLE * span))[1:-1]
    shortest, longest = np.quantile(halves[halves > 0.0], (0.02, 0.98))
    return 0.5 / float(longest), 0.5 / max(float(shortest), step)


def _sweep(log: Recording, span: float) -> FastPart | None:
    """Return the longest run of small swings whose frequency changes gradually over a wide band."""
    step = even_step(log)
    if step is None:
        return None
    rows = turns(log.voltage, NOTICEABLE * span)
    halves = np.diff(rows).astype(np.float64)
    small = np.abs(np.diff(log.voltage[rows])) <= SMALL_SWING * span
    gradual = np.abs(np.diff(np.log(np.maximum(halves, 1.0)))) <= SMOOTH
    quick = np.minimum(halves[1:], halves[:-1]) <= FEWEST_A_PERIOD
    first, last = _longest_run(small[1:] & small[:-1] & (gradual | quick))
    if last - first < FEWEST_IN_SWEEP:
        return None
    periods = 2.0 * step * halves[first : last + 1]
    fastest, slowest = np.quantile(periods, (0.05, 0.98)).tolist()
    if slowest < SWEPT * fastest or fastest < 0.5 * FEWEST_A_PERIOD * step:
        return None
    wider = round(WIDER * slowest / step)
    begin = max(int(rows[first]) - wider, 0)
    end = min(int(rows[last + 1]) + wider, len(log.voltage))
    if begin + len(log.voltage) - end < FEWEST_SLOW_ROWS:
        return None  # nothing else is left to tell the gears from
    band = 1.0 / slowest, 1.0 / float(periods.min())
    return FastPart(log, slice(begin, end), step, band)


def _longest_run(mask: Booleans) -> tuple[int, int]:
    """Return begin and end of the longest run of true values."""
    runs = runs_of(mask)
    if not len(runs):
        return 0, 0
    first, last = runs[np.argmax(runs[:, 1] - runs[:, 0])].tolist()
    return first, last
