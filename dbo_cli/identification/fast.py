"""Fast parts of logs: small sweeps.

Gears, curve and creep are told from the slow rows; resonances from the fast ones, which
a fit without resonances would take for hysteresis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.identification.recording import Recording, runs_of
from dbo_cli.signals import turns

FEWEST_SLOW_ROWS = 40  # of a slow part
NOTICEABLE = 3e-4  # of the range: a smaller reversal of the drive is no turn
SMALL_SWING = 0.35  # of the range: a sweep's largest swing
FEWEST_IN_SWEEP = 40  # in a sweep
SWEPT = 5.0  # highest over lowest frequency of a sweep, at least
SMOOTH = 0.7  # of the logarithms of neighbouring half periods: a sweep is gradual
FEWEST_A_PERIOD = 6  # samples of the highest frequency
WIDER = 2.0  # periods of the lowest frequency that belong to a sweep on either side

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
    slow: list[Recording] = []
    fast: list[FastPart] = []
    for log in recordings:
        sweep = _sweep(log, span)
        if sweep is not None:
            fast.append(sweep)
            usable = log.usable.copy()
            usable[sweep.rows] = False  # driven through, but they do not count
            log = replace(log, good=usable)
        slow.append(log)
    return slow, fast


def even_step(log: Recording) -> float | None:
    """Return the step (s) of an even clock to whose grid each row is nearest, or None."""
    if log.time is None:
        return None
    rows = np.arange(len(log.time))
    step = float(log.time[-1] - log.time[0]) / float(rows[-1])
    deviation = np.abs(log.time - (log.time[0] + step * rows))
    return step if float(deviation.max()) <= 0.5 * step else None


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
    runs = runs_of(small[1:] & small[:-1] & (gradual | quick)).tolist()
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
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
