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
    dt : float, optional
        Seconds a row, of a log without times.
    voltage : array of shape (rows,), optional
        The drive, for the figures.
    rows : (first, last), optional
        The rows that count, by the numbers of ``numbers``, both ends included.
    numbers : array of int, optional
        Row numbers in the file; 1, 2, 3 ... where not given.
    expected : Expected, optional
        The error that was to be expected.
    clock_offset : float, optional
        Seconds that the recorder's clock was found to be ahead, and that were taken off.
    missing
        Rows without a number that were left out.
    notes, warnings : tuple of str
        What a reader of the figures must know.
    """

    name: str
    desired: Floats
    measured: Floats
    time: Floats | None = None
    dt: float | None = None
    voltage: Floats | None = None
    rows: RowRange | None = None
    numbers: Floats | None = None
    expected: Expected | None = None
    clock_offset: float | None = None
    missing: int = 0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Turn the columns into arrays of one length (InputError)."""
        count = len(np.atleast_1d(self.desired))
        for key in ("desired", "measured", "time", "voltage", "numbers"):
            values = getattr(self, key)
            if values is None:
                continue
            column = np.asarray(values, dtype=np.float64)
            if column.ndim != 1:
                raise InputError(
                    f"{self.name}: {key} has {column.ndim} dimensions, not 1"
                )
            if len(column) != count:
                raise InputError(
                    f"{self.name}: {key} has {len(column):,} rows, desired {count:,}"
                )
            object.__setattr__(self, key, column)
        if self.numbers is None:
            object.__setattr__(self, "numbers", np.arange(1.0, count + 1.0))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.desired)

    def taken(self, which: slice | NDArray[np.bool_]) -> Pair:
        """Return the rows that an index, a mask or a slice chooses."""
        assert self.numbers is not None
        return replace(
            self,
            desired=self.desired[which],
            measured=self.measured[which],
            time=None if self.time is None else self.time[which],
            voltage=None if self.voltage is None else self.voltage[which],
            numbers=self.numbers[which],
        )

    def step(self) -> float | None:
        """Return the seconds from row to row; None where no clock is known."""
        if self.dt is not None:
            return self.dt
        return mean_step(self.time)


def rows_text(count: int) -> str:
    """Return a number of rows in words."""
    if count == 1:
        return "1 row"
    return f"{count:,} rows"


def mean_step(time: Floats | None) -> float | None:
    """Return the seconds from row to row of a clock; None where it tells none."""
    if time is None or len(time) < 2:
        return None
    step = float(np.median(np.diff(time)))
    if not math.isfinite(step) or step <= 0.0:
        return None
    return step


def scored(pair: Pair, lag: int) -> Pair:
    """Return the rows that count: measured ``lag`` rows later, ``rows`` alone, none before the move.

    Raises
    ------
    InputError
        Nothing is left to compare.
    """
    count = len(pair) - abs(lag)
    if count < 1:
        raise InputError(
            f"{pair.name}: a lag of {lag} leaves nothing of {len(pair):,} rows: "
            "give a smaller `lag`"
        )
    late, early = max(lag, 0), max(-lag, 0)
    shifted = replace(
        pair.taken(slice(early, early + count)),
        measured=pair.measured[late : late + count],
    )
    chosen = _chosen_rows(shifted)
    finite = np.isfinite(chosen.desired) & np.isfinite(chosen.measured)
    if not finite.any():
        raise InputError(
            f"{pair.name}: no row has a number in both columns: choose others or other `rows`"
        )
    missing = int(len(chosen) - np.count_nonzero(finite))
    if not missing:
        return chosen
    note = f"{pair.name}: {rows_text(missing)} without a number left out"
    return replace(chosen.taken(finite), missing=missing, notes=(*chosen.notes, note))


def _chosen_rows(pair: Pair) -> Pair:
    """Return the rows of ``rows``, or those of the move where some stand before it."""
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
    before = pair.time < 0.0
    count = int(np.count_nonzero(before))
    if count in (0, len(pair)):
        return pair
    note = f"{pair.name}: {rows_text(count)} before time 0 left out (`rows` 1: counts them)"
    return replace(pair.taken(~before), notes=(*pair.notes, note))


def predict(
    model: Model,
    voltage: ArrayLike,
    measured: ArrayLike,
    *,
    name: str = "log",
    time: ArrayLike | None = None,
    dt: float | None = None,
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
    time, dt
        Seconds of every row, or seconds a row.
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
    predicted, _ = model.simulate(drive, time=clock, dt=dt, state=state)
    pair = Pair(
        name,
        predicted,
        np.asarray(measured, dtype=np.float64),
        time=clock,
        dt=dt,
        voltage=drive,
        rows=rows,
    )
    step = _steps(clock, dt)
    return replace(pair, expected=expected_of_drive(model, drive, step, model_name))


def _steps(time: Floats | None, dt: float | None) -> Floats | float | None:
    """Return the seconds since the row before; the first row's are those of the second."""
    if time is None or len(time) < 2:
        return dt
    steps = np.diff(time)
    return np.concatenate([steps[:1], steps])
