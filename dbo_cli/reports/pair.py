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
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.reports.expected import Expected
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
    expected : Expected, optional
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
    expected: Expected | None = None
    clock_offset: float | None = None
    on_drive_clock: bool = False
    delay_removed: bool = False
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.desired)

    def taken(self, rows: slice) -> Pair:
        """Return some of the rows."""
        return replace(
            self,
            desired=self.desired[rows],
            measured=self.measured[rows],
            time=None if self.time is None else self.time[rows],
            voltage=None if self.voltage is None else self.voltage[rows],
            first_row=self.first_row + rows.start,
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


def rows_text(count: int) -> str:
    """Return a number of rows in words."""
    return "1 row" if count == 1 else f"{count:,} rows"


def stretch(inside: NDArray[np.bool_]) -> slice:
    """Return the rows from the first to the last that a mask names; none where it names none."""
    places = np.flatnonzero(inside)
    if not len(places):
        return slice(0, 0)
    return slice(int(places[0]), int(places[-1]) + 1)


def scored(pair: Pair, lag: int) -> Pair:
    """Return the rows that count: measured ``lag`` rows later, ``rows`` alone, none beside the move.

    Raises
    ------
    InputError
        Nothing is left to compare.
    """
    count = len(pair) - abs(lag)
    if count < 1:
        raise InputError(
            f"{pair.name}: {rows_text(len(pair))}, `lag` {lag}: nothing is left to compare"
        )
    begin, measured_begin = max(-lag, 0), max(lag, 0)
    measured = pair.measured[measured_begin : measured_begin + count]
    shifted = replace(pair.taken(slice(begin, begin + count)), measured=measured)
    if pair.rows is None:
        return _move_of(shifted)
    first, last = pair.rows
    begin = max((first or 1) - shifted.first_row, 0)
    end = count if last is None else last + 1 - shifted.first_row
    rows = shifted.taken(slice(begin, max(end, 0)))
    if not len(rows):
        raise InputError(f"{pair.name}: no row from {first} on: choose other `rows`")
    return rows


def undelayed(pair: Pair) -> Pair:
    """Return a log as a sensor without delay would have made it; its last rows are cut off."""
    delay = 0.0 if pair.expected is None else pair.expected.sensor_delay
    if not delay or pair.delay_removed or pair.time is None:
        return pair
    values, measured = without_delay(pair.time, pair.measured, delay)
    in_time = replace(pair, measured=values, delay_removed=True)
    in_time = in_time.taken(stretch(measured))
    return in_time.noted(f"the sensor's delay, {1e3 * delay:.3g} ms, is taken off")


def _move_of(pair: Pair) -> Pair:
    """Return the rows of the move, if rows stand before or behind it."""
    if pair.time is None:
        return pair
    begin, end = 0.0, math.inf
    move_time = None if pair.expected is None else pair.expected.move_time
    if pair.on_drive_clock:
        begin, end = move_time or (begin, end)
        slack = 0.5 * (pair.step or 0.0)
        begin, end = begin - slack, end + slack
    move = pair.taken(stretch((pair.time >= begin) & (pair.time <= end)))
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
    error = None
    if model.input.min - slack <= low and high <= model.input.max + slack:
        error = expected_error(model, voltage, steps)
    rmse = None
    if error is not None:
        rmse = math.hypot(*error) if state == "auto" else error.known
    expected = Expected(rmse, sensor_delay=model.sensor_delay)
    return replace(recording, desired=predicted, expected=expected)
