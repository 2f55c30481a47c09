"""Recordings of drive voltage and displacement, and what can be said of them before any model is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.move_error import SMALLEST_TURN, turning_points

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FEWEST_ROWS = 40
LARGEST = 1e30  # in any unit: beyond this the squares of the fit would overflow
AMPLITUDE_SCATTER = 0.1  # swings that differ by less than this share count as one amplitude


@dataclass(frozen=True)
class Recording:
    """One log of an actuator: what was applied and what was measured.

    ``voltage`` and ``displacement`` have shape (samples,), in the units named; ``time`` is in seconds with
    the same shape, or None where the log has no clock; ``sample_period`` in seconds serves in its place.
    """

    name: str
    voltage: Floats
    displacement: Floats
    time: Floats | None = None
    sample_period: float | None = None
    voltage_unit: str | None = None
    displacement_unit: str | None = None

    def seconds(self) -> Floats | None:
        """Time of each sample in seconds from the first, or None where the log has no clock."""
        if self.time is not None:
            elapsed: Floats = self.time - self.time[0]
            return elapsed
        if self.sample_period is not None:
            even: Floats = self.sample_period * np.arange(len(self.voltage), dtype=np.float64)
            return even
        return None


@dataclass(frozen=True)
class DriveShape:
    """What the drive voltage of one log does: where it turns, how often and how widely.

    ``turns`` are the rows of the turning points; ``cycles`` the rows where whole cycles begin (and the last
    one ends); ``amplitudes`` the peak-to-peak voltage between neighbouring turning points.
    """

    turns: Integers
    cycles: Integers
    amplitudes: Floats

    @property
    def one_amplitude(self) -> bool:
        """Whether all swings are the same, but for a small scatter."""
        if len(self.amplitudes) < 2:
            return True
        return float(np.ptp(self.amplitudes)) <= AMPLITUDE_SCATTER * float(self.amplitudes.max())

    @property
    def cycle_count(self) -> int:
        """Number of whole cycles."""
        return max(len(self.cycles) - 1, 0)


def drive_shape(voltage: Floats) -> DriveShape:
    """Find turning points, whole cycles and amplitudes of one log's drive."""
    turns = turning_points(voltage, SMALLEST_TURN * float(np.ptp(voltage)))
    heights = voltage[turns]
    amplitudes = np.abs(np.diff(heights))
    if len(turns) >= 2:
        first_is_low = heights[0] < heights[1]
        cycles = turns[0 if first_is_low else 1 :: 2]
    else:
        cycles = turns
    return DriveShape(turns, cycles, amplitudes)


def check_recordings(recordings: Sequence[Recording]) -> None:
    """Refuse logs from which nothing can be identified, naming the log and the remedy.

    Raises
    ------
    FitError
        Too few rows, a time that does not advance, constant voltage or displacement, a voltage that never
        turns, or units that differ.
    """
    if not recordings:
        raise FitError("no log given: identify needs at least one log of voltage and displacement")
    first = recordings[0]
    for log in recordings:
        if len(log.voltage) < FEWEST_ROWS:
            raise FitError(
                f"{log.name}: {len(log.voltage)} rows are too few to identify from: record at least one "
                f"whole cycle with {FEWEST_ROWS} rows or more"
            )
        _check_sizes(log)
        if log.time is not None and not log.time[-1] > log.time[0]:
            raise FitError(
                f"{log.name}: time does not advance from the first row ({log.time[0]:.6g} s) to the last "
                f"({log.time[-1]:.6g} s): repair the clock, or give `sample_rate` HZ instead"
            )
        if np.ptp(log.voltage) == 0.0:
            raise FitError(
                f"{log.name}: the voltage is constant ({log.voltage[0]:g}): record a drive that moves over "
                "the range ('dbo excite' writes one)"
            )
        if np.ptp(log.displacement) == 0.0:
            raise FitError(
                f"{log.name}: the displacement is constant ({log.displacement[0]:g}): check the sensor and "
                "the column chosen"
            )
        if len(drive_shape(log.voltage).turns) == 0:
            raise FitError(
                f"{log.name}: the voltage never turns back, so the log shows no loop: record at least one "
                "whole cycle up and down ('dbo excite' writes a drive that does)"
            )
        for mine, other, what in (
            (log.voltage_unit, first.voltage_unit, "voltage"),
            (log.displacement_unit, first.displacement_unit, "displacement"),
        ):
            if mine != other:
                raise FitError(
                    f"{log.name}: its {what} is in {mine or 'no unit'}, that of {first.name} in "
                    f"{other or 'no unit'}: bring the logs to one unit"
                )


def _check_sizes(log: Recording) -> None:
    """Refuse numbers that no instrument measured, naming the first."""
    for values, what in ((log.voltage, "voltage"), (log.displacement, "displacement")):
        huge = np.abs(values) > LARGEST
        if huge.any():
            row = int(np.argmax(huge))
            raise FitError(
                f"{log.name}: the {what} in row {row + 1} is {values[row]:g}, which no instrument measured: "
                "correct it, or cut the log with `rows`"
            )


def without_voltage_glitches(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Replace single samples of the voltage that jump away and back by the mean of their neighbours.

    The drive was not there, but one such sample would stretch the gears over a range that was never driven.
    A jump counts where it is three times the most that the drive, such samples aside, does between samples.
    """
    cleaned, notes = [], []
    for log in recordings:
        v = log.voltage
        middle = np.median((v[:-2], v[1:-1], v[2:]), axis=0)
        jump = np.abs(v[1:-1] - middle)
        usual = float(np.abs(np.diff(middle)).max())
        rows = np.flatnonzero(jump > max(3.0 * usual, SMALLEST_TURN * float(np.ptp(middle)))) + 1
        if len(rows) and usual > 0.0:
            repaired = v.copy()
            repaired[rows] = (v[rows - 1] + v[rows + 1]) / 2.0
            notes.append(
                f"{log.name}: {len(rows)} single voltages that jump away and back replaced by the mean of "
                f"their neighbours (first at row {rows[0] + 1}: {v[rows[0]]:g})"
            )
            log = replace(log, voltage=repaired)
        cleaned.append(log)
    return cleaned, notes


def first_wiped_row(voltage: Floats) -> int:
    """First row from which the operator's state no longer depends on the history before the log.

    Once the drive has been at both ends of the range it ever visits, every gear inside that range has been
    set and cleared (wiping-out), so whatever was remembered before is gone.
    """
    low, high = float(voltage.min()), float(voltage.max())
    near = SMALLEST_TURN / 4 * (high - low)
    at_low = int(np.argmax(voltage <= low + near))
    at_high = int(np.argmax(voltage >= high - near))
    return max(at_low, at_high)


def median_cycle_seconds(recordings: Sequence[Recording]) -> float | None:
    """Duration in seconds of the cycle in which the logs' middle second lies, None without clock or cycle.

    Cycles count by their duration: of a drive with many small quick turns, the full sweeps say how late an
    actuator may be.
    """
    durations: list[Floats] = []
    for log in recordings:
        seconds = log.seconds()
        turns = drive_shape(log.voltage).turns
        if seconds is not None and len(turns) >= 2:
            durations.append(2.0 * np.diff(seconds[turns]))
        elif seconds is not None and len(turns) == 1:
            durations.append(np.array([seconds[-1]]))
    if not durations:
        return None
    ordered = np.sort(np.maximum(np.concatenate(durations), 0.0))
    past = np.cumsum(ordered)
    return float(ordered[np.searchsorted(past, past[-1] / 2.0)])
