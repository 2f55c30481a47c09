"""The drives that identify many channels, and how they show in each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.excitation import (
    MOST_SAMPLES,
    Excitation,
    Floats,
    swing_samples,
    swings,
)


def drives_of_channels(
    excitation: Excitation, brought: Mapping[str, Any], points: int | None
) -> tuple[Floats, dict[str, Floats]]:
    """Return time (s) and the voltage of each channel by the name of its column.

    Raises
    ------
    UsageError
        Points of a generator are asked for, too; or the rows of all channels are too
        many.
    """
    if points is not None:
        raise UsageError(
            "`points` and `channels` exclude each other: channels that move one by one take more rows"
        )
    if brought.keys() != {"channels"}:
        raise UsageError(
            "`channels` and `fringes` exclude each other: count the fringes of one at a time"
        )
    time, voltage = channel_drives(excitation, brought["channels"])
    columns = voltage.T.copy()
    return time, {
        f"voltage_{place}": column for place, column in enumerate(columns, start=1)
    }


def channel_drives(asked: Excitation, channels: int) -> tuple[Floats, Floats]:
    """Return time (s) and the voltages of many channels, (samples, channels): all at once, then one by one.

    Together they turn at levels of their own (seeds from ``asked.seed`` on). Then each
    in turn sweeps once over the range and rests for half a period, and all others rest:
    what those show then is coupling. A small sweep (``sweep_to``) is in each channel's
    own turn.

    Raises
    ------
    UsageError
        The rows of all channels are too many.
    """
    half = swing_samples(
        asked.span, 1.0 / asked.sample_rate, 0.5 / asked.frequency, asked.max_slew
    )
    ends = [asked.v_min, asked.v_max, asked.v_min, asked.v_min]
    turn = np.concatenate([swings(ends, [half, half, half])[1:], asked.small_sweep()])
    alike = replace(asked, sweep_to=None, sweep_amplitude=None)
    drives = [
        replace(alike, seed=asked.seed + place).drive()[1] for place in range(channels)
    ]
    rows = drives[0].size + channels * turn.size
    if rows * channels > MOST_SAMPLES:
        raise UsageError(
            f"`channels` {channels:,}: {rows:,} rows of them are more than the {MOST_SAMPLES:,} values that "
            "are written at most (lower `sample_rate`, raise `frequency`)"
        )
    voltage = np.full((rows, channels), asked.v_min)
    for place, drive in enumerate(drives):
        begin = drive.size + place * turn.size
        voltage[: drive.size, place] = drive
        voltage[begin : begin + turn.size, place] = turn
    return np.arange(rows) / asked.sample_rate, voltage
