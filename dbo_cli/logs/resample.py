"""A log at an even rate, by linear interpolation in memory."""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.log import Log
from dbo_cli.logs.source import Block

MOST_ROWS = 100_000_000  # some gigabytes


def resampled(log: Log, rate: float) -> Log:
    """Return a log at an even rate, by linear interpolation between its rows.

    Raises
    ------
    InputError
        It has no clock, or lasts less than a step.
    """
    with log:
        table = log.read()
    if table.time is None:
        raise InputError(
            f"{log.name}: `resample` needs a clock (`time` COLUMN or `sample_rate` HZ)"
        )
    span = float(table.time[-1] - table.time[0])
    count = int(np.floor(span * rate * (1.0 + 1e-12))) + 1
    if count < 2 or count > MOST_ROWS:
        raise InputError(f"{log.name}: `resample` {rate:g}: the log lasts {span:.4g} s")
    time = table.time[0] + np.arange(count) / rate
    values = {}
    for role, array in table.values.items():
        values[role] = np.interp(time, table.time, array)
    first, last = float(time[0]), float(time[-1])
    step = 1.0 / rate
    clock = Clock(
        log.name, "rate", rate=rate, start=first, step=step, origin=log.clock.origin
    )
    clock.rows, clock.first, clock.last = count, first, last
    log.remarks.append(
        f"{table.rows:,} rows are interpolated to {count:,} at {rate:g} Hz"
    )
    even = Block(time, values, dt=step)
    resampled_log = Log.of_table(log.name, log.columns, even, clock, log.remarks)
    resampled_log.doubtful = log.doubtful
    resampled_log.clock_offset = log.clock_offset
    return resampled_log
