"""A linear frequency response as a bar: what it explains far better than gears do is not of this class.

A mass on a spring whose restoring force has hysteresis swings: no model of gears with
memories follows it, but a linear filter does. The filter here is a finite impulse
response, fitted by least squares with a little damping, and judged on quarters of each
log left out in turn, as the candidates are (``output_error``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dbo_cli.hysteresis.identification.normal_equations import least_squares
from dbo_cli.hysteresis.identification.output_error import BLOCKS, Errors
from dbo_cli.hysteresis.identification.recordings import (
    EVEN,
    Floats,
    Integers,
    drive_shape,
)
from dbo_cli.hysteresis.identification.statistics import PreparedLog, weighted

TAPS = (16, 64, 256)  # rows of the responses tried, shortest first
ROWS_PER_TAP = 8  # fewer rows than this are no evidence of so long a response
ROWS = 8192  # of a log, at most: thirty for each tap of the longest response
# between turns: a resonance that a drive excites is sampled by about as many
SWING_ROWS = 20
DAMPING = 1e-6  # of the mean square of the drive, on every tap
# times the error to beat: a short response that is further off is not made longer
WITHIN_REACH = 4.0


def linear_response(logs: Sequence[PreparedLog], to_beat: float) -> Errors | None:
    """Return the errors on quarters left out of the best response, None where no clock is even.

    Parameters
    ----------
    logs : the logs
    to_beat : RMS error of the model on the same quarters: longer responses are tried
        within reach of it
    """
    span = max(float(np.ptp(log.voltage)) for log in logs)
    some = [_few_rows(log, span) for log in logs if _even(log)]
    if len(some) < len(logs):
        return None
    best: Errors | None = None
    for taps in TAPS:
        if min(len(log.output) for log in some) < ROWS_PER_TAP * taps:
            break
        errors = _errors(some, taps)
        if best is None or errors.mean_square < best.mean_square:
            best = errors
        if errors.mean_square > (WITHIN_REACH * to_beat) ** 2:
            break
    return best


def _even(log: PreparedLog) -> bool:
    """Return whether a log's clock has steps of one length."""
    if log.seconds is None:
        return False
    steps = np.diff(log.seconds)
    usual = float(np.median(steps))
    return usual > 0.0 and float(np.abs(steps - usual).max()) <= EVEN * usual


@dataclass(frozen=True)
class _Rows:
    """Neighbouring rows of one log: drive before the first, output, drift, quarter and weight of each row."""

    drive: Floats
    output: Floats
    drift: Floats
    quarter: Integers
    weights: Floats | None


def _few_rows(log: PreparedLog, span: float) -> _Rows:
    """Return at most ``ROWS`` rows of a log, evenly thinned to some rows between turns, then cut.

    The drive is in units of ``span``.
    """
    rows = len(log.voltage)
    swing = rows / (len(drive_shape(log.voltage).turns) + 1)
    every = max(1, int(swing / SWING_ROWS))
    chosen = np.arange(0, rows, every)[:ROWS]
    used = log.used[chosen]
    quarter = np.full(len(chosen), -1)
    count = int(used.sum())
    quarter[used] = np.arange(count) * BLOCKS // max(count, 1)
    drive = (log.voltage[chosen] - log.voltage[0]) / span
    return _Rows(
        drive, log.output[chosen], log.drift[chosen], quarter, log.weights_at(chosen)
    )


def _table(log: _Rows, taps: int) -> Floats:
    """Return the drive of the last ``taps`` rows, offset and drift, and (last) the output, weighted."""
    padded = np.concatenate((np.zeros(taps - 1), log.drive))
    past = np.lib.stride_tricks.sliding_window_view(padded, taps)[:, ::-1]
    return weighted(np.column_stack((past, log.drift, log.output)), log.weights)


def _errors(logs: Sequence[_Rows], taps: int) -> Errors:
    """Return the errors of a response of so many taps on quarters left out."""
    size = taps + sum(log.drift.shape[1] for log in logs) + 1
    grams = np.zeros((BLOCKS, size, size))
    tables: list[tuple[Floats, Integers, Integers]] = []
    begin = taps
    for log in logs:
        end = begin + log.drift.shape[1]
        columns = np.concatenate((np.arange(taps), np.arange(begin, end), [size - 1]))
        table = _table(log, taps)
        for k in range(BLOCKS):
            some = table[log.quarter == k]
            grams[k][np.ix_(columns, columns)] += some.T @ some
        tables.append((table, columns[:-1], log.quarter))
        begin = end
    squares = np.zeros(BLOCKS)
    rows = np.zeros(BLOCKS, np.int64)
    for k in range(BLOCKS):
        rest = grams.sum(axis=0) - grams[k]
        gram = rest[:-1, :-1].copy()
        gram[np.arange(taps), np.arange(taps)] += (
            DAMPING * np.trace(gram[:taps, :taps]) / taps
        )
        found = least_squares(gram, rest[:-1, -1])
        for table, columns, quarter in tables:
            some = table[quarter == k]
            left = some[:, -1] - some[:, :-1] @ found[columns]
            squares[k] += float(left @ left)
            rows[k] += len(left)
    return Errors(squares, rows)
