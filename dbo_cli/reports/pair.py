"""One log to compare: two signals side by side, with what is known of their rows.

``predict`` makes one of a model's prediction and a measurement, ``match`` (beside
this module) of a recording and a trajectory that lie in two files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.errors import InputError
from dbo_cli.reports.merits import Floats

if TYPE_CHECKING:
    from dbo_cli.model import Model, State
    from dbo_cli.reports.expected import Expected

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
        In one unit. NaN: no number; such a row takes no part.
    time : array of shape (rows,), optional
        Seconds.
    voltage : array of shape (rows,), optional
        The drive, for the figures.
    rows : (first, last), optional
        The rows that count, by the numbers of ``numbers``, both ends included.
    numbers : array, optional
        Row numbers in the file; 1, 2, 3 ... where not given.
    expected : Expected, optional
        The error that was to be expected.
    clock_offset : float, optional
        Seconds that the recorder's clock was found to be ahead, and that were taken off.
    on_drive_clock
        Whether the times are those of the drive.
    missing
        Rows without a number that were left out.
    notes, warnings : tuple of str
        What a reader of the figures must know.
    """

    name: str
    desired: Floats
    measured: Floats
    time: Floats | None = None
    voltage: Floats | None = None
    rows: RowRange | None = None
    numbers: Floats | None = None
    expected: Expected | None = None
    clock_offset: float | None = None
    on_drive_clock: bool = False
    missing: int = 0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Turn the columns into arrays of one length (InputError)."""
        count = len(np.atleast_1d(self.desired))
        if self.numbers is None:
            object.__setattr__(self, "numbers", np.arange(1.0, count + 1.0))
        for key in ("desired", "measured", "time", "voltage", "numbers"):
            values = getattr(self, key)
            if values is None:
                continue
            column = np.asarray(values, dtype=np.float64)
            if column.shape != (count,):
                raise InputError(
                    f"{self.name}: {key} has the shape {column.shape}, desired has {count:,} rows"
                )
            object.__setattr__(self, key, column)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.desired)

    def taken(self, which: slice | NDArray[np.bool_]) -> Pair:
        """Return the rows that a mask or a slice chooses."""
        assert self.numbers is not None
        return replace(
            self,
            desired=self.desired[which],
            measured=self.measured[which],
            time=None if self.time is None else self.time[which],
            voltage=None if self.voltage is None else self.voltage[which],
            numbers=self.numbers[which],
        )

    def noted(self, note: str) -> Pair:
        """Return the pair with a further note."""
        return replace(self, notes=(*self.notes, f"{self.name}: {note}"))

    def step(self) -> float | None:
        """Return the seconds from row to row; None where no clock is known."""
        return mean_step(self.time)


def rows_text(count: int) -> str:
    """Return a number of rows in words."""
    return "1 row" if count == 1 else f"{count:,} rows"


def mean_step(time: Floats | None) -> float | None:
    """Return the seconds from row to row of a clock; None without one."""
    if time is None or len(time) < 2:
        return None
    step = float(np.median(np.diff(time)))
    return step if 0.0 < step < math.inf else None


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
            f"{pair.name}: has {rows_text(len(pair))}; give a smaller `lag` than {lag}"
        )
    late, early = max(lag, 0), max(-lag, 0)
    shifted = replace(
        pair.taken(slice(early, early + count)),
        measured=pair.measured[late : late + count],
    )
    chosen = _chosen_rows(shifted)
    finite = np.isfinite(chosen.desired) & np.isfinite(chosen.measured)
    if not finite.any():
        raise InputError(f"{pair.name}: no row has a number in both columns")
    missing = int(len(chosen) - np.count_nonzero(finite))
    if missing:
        chosen = replace(chosen.taken(finite), missing=missing)
        chosen = chosen.noted(f"{rows_text(missing)} without a number left out")
    return chosen


def _chosen_rows(pair: Pair) -> Pair:
    """Return the rows of ``rows``; without it those of the move, if rows stand before or behind it."""
    assert pair.numbers is not None
    if pair.rows is not None:
        first, last = pair.rows
        low = 1.0 if first is None else float(first)
        high = math.inf if last is None else float(last)
        inside = (pair.numbers >= low) & (pair.numbers <= high)
        if not inside.any():
            raise InputError(
                f"{pair.name}: has no row from {low:g} to {high:g}: choose other `rows`"
            )
        return pair.taken(inside)
    if pair.time is None:
        return pair
    begin, end = 0.0, math.inf
    move_time = None if pair.expected is None else pair.expected.move_time
    if pair.on_drive_clock and move_time is not None:
        slack = 0.5 * (pair.step() or 0.0)
        begin, end = move_time[0] - slack, move_time[1] + slack
    inside = (pair.time >= begin) & (pair.time <= end)
    count = int(np.count_nonzero(~inside))
    if count in (0, len(pair)):
        return pair
    return pair.taken(inside).noted(
        f"{rows_text(count)} before or after the move left out"
    )


def predict(
    model: Model,
    voltage: ArrayLike,
    measured: ArrayLike,
    *,
    name: str = "log",
    time: ArrayLike | None = None,
    state: str | State = "auto",
    rows: RowRange | None = None,
    model_name: str = "the model",
) -> Pair:
    """Put a model's prediction in the place of the desired signal.

    The model runs from the first row on, whatever ``rows`` count.

    Parameters
    ----------
    model
        Forward.
    voltage, measured : array of shape (rows,)
        In the model's units.
    time : array of shape (rows,), optional
        Seconds.
    state
        What was before the first row.
    rows : (first, last), optional
        The rows that are scored.

    Raises
    ------
    ModelError
        The model is inverse.
    InputError
        Lengths differ, a drive is no number, or the model needs a clock.
    """
    from dbo_cli.reports.expected import expected_of_drive

    model.require("forward", model_name)
    drive = np.asarray(voltage, dtype=np.float64)
    clock = None if time is None else np.asarray(time, dtype=np.float64)
    predicted, _ = model.simulate(drive, time=clock, state=state)
    steps = None
    if clock is not None and len(clock) > 1:
        steps = np.diff(clock, prepend=2.0 * clock[0] - clock[1])
    expected = expected_of_drive(model, drive, steps, model_name)
    column = np.asarray(measured, dtype=np.float64)
    return Pair(name, predicted, column, clock, drive, rows, expected=expected)
