"""A log at an even rate, by linear interpolation in memory."""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.log import Log
from dbo_cli.logs.table import Block

MOST_ROWS = 100_000_000  # some gigabytes


def resampled(log: Log, rate: float) -> Log:
    """Return a log at an even rate (Hz), by linear interpolation between its rows.

    Raises
    ------
    InputError
        It has no clock, or lasts less than a step.
    UsageError
        The rate is not above 0.
    """
    with log:
        if not 0.0 < rate < np.inf:
            raise UsageError(f"`resample` {rate:g}: give a rate above 0 Hz")
        table = log.read()
    if table.time is None:
        raise InputError(
            f"{log.name}: `resample` needs a clock (`time` COLUMN or `sample_rate` HZ)"
        )
    first = float(table.time[0])
    span = float(table.time[-1]) - first
    count = int(np.floor(span * rate * (1.0 + 1e-12))) + 1
    if count < 2 or count > MOST_ROWS:
        raise InputError(f"{log.name}: `resample` {rate:g}: the log lasts {span:.4g} s")
    time = first + np.arange(count) / rate
    values = {}
    for role, array in table.values.items():
        values[role] = np.interp(time, table.time, array)
    clock = Clock(log.name, "rate", rate=rate, start=first, origin=log.clock.origin)
    clock.step = 1.0 / rate
    clock.rows, clock.first, clock.last = count, first, float(time[-1])
    log.remarks.append(
        f"{table.rows:,} rows are interpolated to {count:,} at {rate:g} Hz"
    )
    even = Block(time, values, dt=clock.step)
    table_log = Log.in_memory(log.name, log.columns, even, clock, log.remarks)
    table_log.doubtful = log.doubtful
    table_log.clock_offset = log.clock_offset
    return table_log
