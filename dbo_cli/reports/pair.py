"""One log to compare: two signals side by side, with what is known of their rows.

``predict`` makes one of a model's prediction and a measurement, ``match`` (beside
this module) of a recording and a trajectory that lie in two files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dbo_cli.arrays import Booleans, Floats, Range
from dbo_cli.errors import InputError
from dbo_cli.reports.expected import UNKNOWN, Expected
from dbo_cli.signals import step_of, without_delay

if TYPE_CHECKING:
    from dbo_cli.model import Cascade, State

SLACK = 1e-9
"""Part of the range that rounding may add to a drive which ends at its limit."""

RowRange = tuple[int | None, int | None]
"""First and last row that count, from 1, both included; None: no end."""


@dataclass(frozen=True)
class Pair:
    """Desired (or predicted) and measured values of one log, row by row.

    Attributes
    ----------
    name
        What the report calls it.
    desired, measured : array of shape (rows,)
        In one unit, all finite; a recording has measured values in both places.
    time : array of shape (rows,), optional
        Seconds.
    voltage : array of shape (rows,), optional
        The drive, for the figures.
    rows : (first, last), optional
        The rows of the file that count, both ends included.
    first_row
        The number of the first row in its file, from 1.
    expected : Expected
        The error that was to be expected.
    clock_offset : float, optional
        Seconds that the recorder's clock was found to be ahead, and that were taken off.
    on_drive_clock
        Whether the times are those of the drive.
    delay_removed
        Whether the sensor's delay was taken off, as a part of the clock's offset.
    notes, warnings : tuple of str
        What a reader of the figures must know.
    """

    name: str
    desired: Floats
    measured: Floats
    time: Floats | None = None
    voltage: Floats | None = None
    rows: RowRange | None = None
    first_row: int = 1
    expected: Expected = UNKNOWN
    clock_offset: float | None = None
    on_drive_clock: bool = False
    delay_removed: bool = False
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.desired)

    def taken(self, inside: Booleans) -> Pair:
        """Return the rows of a mask, which names a row and all behind it up to another."""
        return replace(
            self,
            desired=self.desired[inside],
            measured=self.measured[inside],
            time=None if self.time is None else self.time[inside],
            voltage=None if self.voltage is None else self.voltage[inside],
            first_row=self.first_row + int(np.argmax(inside)),
        )

    def noted(self, note: str) -> Pair:
        """Return the pair with a further note."""
        return replace(self, notes=(*self.notes, f"{self.name}: {note}"))

    def warned(self, warning: str) -> Pair:
        """Return the pair with a further warning."""
        return replace(self, warnings=(*self.warnings, f"{self.name}: {warning}"))

    @property
    def clock(self) -> Floats:
        """The time of each row (s), of a pair that has one."""
        assert self.time is not None
        return self.time

    @cached_property
    def step(self) -> float | None:
        """The seconds from row to row; None where no clock is known."""
        return None if self.time is None else step_of(self.time) or None

    def covers(self, times: Range) -> bool:
        """Return whether the log has rows from the first to the second time (s), to half a row."""
        if self.time is None:
            return False
        slack = 0.5 * (self.step or 0.0)
        begin, end = times
        return bool(self.time[0] <= begin + slack and self.time[-1] >= end - slack)


def rows_text(count: int) -> str:
    """Return a number of rows in words."""
    return "1 row" if count == 1 else f"{count:,} rows"


def scored(pair: Pair, lag: int) -> Pair:
    """Return the rows that count: measured ``lag`` rows later, ``rows`` alone, none beside the move.

    Raises
    ------
    InputError
        Nothing is left to compare.
    """
    if len(pair) <= abs(lag):
        raise InputError(
            f"{pair.name}: {rows_text(len(pair))}, `lag` {lag}: nothing is left to compare"
        )
    begin, end = max(-lag, 0), len(pair) - max(lag, 0)
    number = np.arange(len(pair))
    shifted = pair.taken((number >= begin) & (number < end))
    shifted = replace(shifted, measured=pair.measured[begin + lag : end + lag])
    if pair.rows is None:
        return _move_of(shifted)
    first, last = pair.rows
    number = shifted.first_row + np.arange(len(shifted))
    is_before_end = number <= (math.inf if last is None else last)
    rows = shifted.taken((number >= (first or 1)) & is_before_end)
    if not len(rows):
        raise InputError(f"{pair.name}: no row from {first} on: choose other `rows`")
    return rows


def undelayed(pair: Pair) -> Pair:
    """Return a log as a sensor without delay would have made it; its last rows are cut off."""
    delay = pair.expected.sensor_delay
    if not delay or pair.delay_removed or pair.time is None:
        return pair
    values, is_measured = without_delay(pair.time, pair.measured, delay)
    in_time = replace(pair, measured=values, delay_removed=True).taken(is_measured)
    return in_time.noted(f"the sensor's delay, {1e3 * delay:.3g} ms, is taken off")


def _move_of(pair: Pair) -> Pair:
    """Return the rows of the move, if rows stand before or behind it."""
    if pair.time is None:
        return pair
    begin, end, slack = 0.0, math.inf, 0.0
    if pair.on_drive_clock:
        begin, end = pair.expected.move_time
        slack = 0.5 * (pair.step or 0.0)
    move = pair.taken((pair.time >= begin - slack) & (pair.time <= end + slack))
    outside = len(pair) - len(move)
    if outside in (0, len(pair)):
        return pair
    return move.noted(f"{rows_text(outside)} before or after the move left out")


def predict(
    recording: Pair,
    model: Cascade,
    state: str | State = "auto",
    model_name: str = "the model",
) -> Pair:
    """Put a model's prediction from the drive in the place of the desired signal.

    The model runs from the first row on, whatever ``rows`` count.

    Parameters
    ----------
    recording
        Drive and displacement in the model's units.
    model
        Forward.
    state
        What was before the first row.

    Raises
    ------
    ModelError
        The model is inverse, or it needs a clock.
    """
    from dbo_cli.model.expect import expected_error

    model.require("forward", model_name)
    voltage, time = recording.voltage, recording.time
    assert voltage is not None
    predicted, _ = model.simulate(voltage, time=time, state=state)
    steps = None
    if time is not None and len(time) > 1:
        steps = np.diff(time, prepend=2.0 * time[0] - time[1])
    slack = SLACK * model.input.span
    low, high = float(voltage.min()), float(voltage.max())
    error = rmse = None
    if model.input.min - slack <= low and high <= model.input.max + slack:
        error = expected_error(model, voltage, steps)
    else:
        recording = recording.noted(
            "the drive leaves the model's range, where no error is stated"
        )
    if error is not None:
        rmse = math.hypot(*error) if state == "auto" else error.known
    expected = Expected(rmse, sensor_delay=model.sensor_delay)
    return replace(recording, desired=predicted, expected=expected)
