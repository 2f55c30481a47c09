"""Faults of sensors and loggers, mended or left out before anything is fitted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Booleans, Floats
from dbo_cli.errors import FitError, UsageError, warn
from dbo_cli.identification.recording import Options, Recording
from dbo_cli.model.expect import SWING
from dbo_cli.signals import NORMAL_MEDIAN, turns, without_delay

SPIKE_WINDOW = 7  # rows: longer ones have turns of the drive in them
SPIKE_SIGMAS = 8.0
SPIKE_SPREAD = 2.0  # a spike leaves its neighbours by so many times their spread
LEAST_SPIKE = 1e-3  # of the range
MOST_SPIKES = 0.2  # of the rows: more are no spikes
STUCK_PATH = 0.08  # of the drive's range: a sensor of 5 bits repeats itself so far
TURNS_BACK = 0.01  # of the drive's range


def clean(
    recordings: Sequence[Recording], options: Options
) -> tuple[list[Recording], list[str]]:
    """Return the logs without what sensors and loggers did to them, and what was done in words.

    Raises
    ------
    FitError
        Too few rows are left, or a voltage stands alone.
    UsageError
        Seconds are asked for, and a log has no clock.
    """
    notes: list[str] = []
    logs = []
    for log in recordings:
        if not options.force:
            refuse_wrong_voltage(log)
        log = without_late_and_skipped_rows(log, options)
        good = log.usable
        faults = {
            "spikes of the displacement": spiked_rows(log.displacement),
            "the displacement stands still while the drive moves": stuck_rows(log),
        }
        for words, faulty in faults.items():
            rows = np.flatnonzero(faulty & good)
            if rows.size:
                notes.append(
                    f"{log.name}: {rows.size} rows left out (first: row {rows[0] + 1}): {words}"
                )
                warn(notes[-1])
            good = good & ~faulty
        logs.append(replace(log, good=good))
    if not any(
        len(turns(log.voltage, TURNS_BACK * np.ptp(log.voltage))) > 2 for log in logs
    ):
        raise FitError(
            f"{logs[0].name}: the voltage never turns back; record a drive that goes up and down"
        )
    return logs, notes


def refuse_wrong_voltage(log: Recording) -> None:
    """Refuse (FitError) a voltage that stands alone beyond all others: the range would be that of a fault."""
    wrong = spiked_rows(log.voltage)
    low, high = float(log.voltage[~wrong].min()), float(log.voltage[~wrong].max())
    alone = SWING * (high - low)
    wrong &= (log.voltage < low - alone) | (log.voltage > high + alone)
    wrong &= log.usable
    if wrong.any():
        row = int(np.argmax(wrong))
        raise FitError(
            f"{log.name}: row {row + 1}: voltage {log.voltage[row]:g} stands alone, all others are "
            f"{low:g} to {high:g}: correct that row (`force` keeps it)"
        )


def without_late_and_skipped_rows(log: Recording, options: Options) -> Recording:
    """Return the log as a sensor without delay would have made it, without the rows that are skipped."""
    displacement, good = log.displacement, log.usable
    skip, delay = options.skip, options.known_sensor_delay
    if log.time is None:
        if skip or delay:
            raise UsageError(
                f"{log.name}: `skip` and `sensor_delay` need a clock: add `time` COLUMN or `sample_rate` HZ"
            )
        return log
    if delay:
        displacement, measured = without_delay(log.time, displacement, delay)
        good = good & measured
    good = good & (log.time - log.time[0] >= skip)
    return replace(log, displacement=displacement, good=good)


def spiked_rows(displacement: Floats) -> Booleans:
    """Return rows that leave their neighbours and come back, further than these differ among themselves."""
    half = SPIKE_WINDOW // 2
    padded = np.pad(displacement, half, mode="edge")
    around = np.sort(
        np.lib.stride_tricks.sliding_window_view(padded, SPIKE_WINDOW), axis=1
    )
    deviation = np.abs(displacement - around[:, half])
    spread = around[:, -1 - SPIKE_WINDOW // 3] - around[:, SPIKE_WINDOW // 3]
    sigma = 0.0
    if (deviation > 0.0).any():
        sigma = float(np.median(deviation[deviation > 0.0])) / NORMAL_MEDIAN
    spiked = (deviation > SPIKE_SIGMAS * sigma) & (deviation > SPIKE_SPREAD * spread)
    low, high = np.percentile(displacement, [1.0, 99.0])
    spiked &= deviation > LEAST_SPIKE * float(high - low)
    if spiked.mean() > MOST_SPIKES:
        return np.zeros(len(displacement), bool)
    return spiked


def stuck_rows(log: Recording) -> Booleans:
    """Return rows of runs of one displacement over which the drive travels far: a stuck or clipped sensor."""
    edges = np.flatnonzero(np.diff(log.displacement) != 0.0) + 1
    begins = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(log.displacement)]))
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(log.voltage)))))
    travelled = path[ends - 1] - path[begins]
    typical = float(np.percentile(travelled, 90.0))
    far = travelled > max(STUCK_PATH * float(np.ptp(log.voltage)), 4.0 * typical)
    return np.repeat(far, ends - begins)
