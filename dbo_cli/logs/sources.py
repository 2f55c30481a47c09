"""Arrays and tables in memory as sources of samples, with the same checks as files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import find_clock
from dbo_cli.logs.columns import ColumnWish, choose_columns, find_column, parse_column
from dbo_cli.logs.request import (
    ALL_ROWS,
    BLOCK_ROWS,
    ReadingOptions,
    Rows,
    checked_rate,
)
from dbo_cli.logs.sample_block import (
    Column,
    FloatArray,
    SampleBlock,
    TimeCheck,
    joined,
    require_even,
)
from dbo_cli.logs.signal_log import Source

if TYPE_CHECKING:
    import pandas

TABLE = "the table"


def samples(name: str, values: ArrayLike) -> FloatArray:
    """Return a signal as float64 of shape (samples,).

    Raises
    ------
    InputError
        It has another shape, no samples, masked ones, or one that is not a finite
        number; or it holds truth values or times.
    """
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        row = int(np.argmax(np.ma.getmaskarray(values)))
        raise InputError(
            f"`{name}`: sample {row + 1} is masked (leave it out, or fill it with what it was)"
        )
    try:
        array = np.asarray(values)
        objects = array.reshape(-1) if array.dtype.kind == "O" else ()
        if array.dtype.kind not in "iufO" or any(
            isinstance(value, bool | np.bool_) for value in objects
        ):
            raise TypeError
        signal = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"`{name}`: is no array of numbers") from None
    if signal.ndim == 0 or signal.size == 0:
        raise InputError(f"`{name}`: holds no samples")
    if signal.ndim > 1:
        raise InputError(f"`{name}`: has the shape {signal.shape}; give one dimension")
    if not (math.isfinite(signal.min()) and math.isfinite(signal.max())):
        row = int(np.argmin(np.isfinite(signal)))
        raise InputError(
            f"`{name}`: sample {row + 1} is not finite: {float(signal[row])!r} (leave it out)"
        )
    return signal


def stamps(values: ArrayLike) -> FloatArray:
    """Return time stamps in seconds: numbers as they are, dates and durations of any unit converted.

    Raises
    ------
    InputError
        See ``samples``; or a date is missing (NaT).
    """
    array = values if np.ma.isMaskedArray(values) else np.asarray(values)
    if (
        array.dtype.kind == "O"
        and array.size
        and hasattr(array.reshape(-1)[0], "isoformat")
    ):
        array = array.astype("datetime64[us]")
    elif (
        array.dtype.kind == "O"
        and array.size
        and hasattr(array.reshape(-1)[0], "total_seconds")
    ):
        array = array.astype("timedelta64[us]")
    if array.dtype.kind not in "mM":
        return samples("time", values)
    if np.isnat(array).any():
        row = int(np.argmax(np.isnat(array)))
        raise InputError(f"`time`: sample {row + 1} is missing (NaT) (leave it out)")
    count, second = (
        array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64),
        1_000_000_000,
    )
    return samples("time", count // second + (count % second) / 1e9)


def is_table(data: object) -> bool:
    """Tell whether something is a DataFrame, without importing pandas for it."""
    return hasattr(data, "columns") and hasattr(data, "iloc")


def is_file(data: object) -> bool:
    """Tell whether something names a file."""
    return isinstance(data, str | os.PathLike)


def is_log(data: object) -> bool:
    """Tell whether something is a log, a table or a file's name, and no array."""
    return is_file(data) or is_table(data)


class ArraySource(Source):
    """Arrays as a source.

    Parameters
    ----------
    values : mapping of str to array_like
        Role to signal; all of one length.
    time : array_like, optional
        Seconds (or dates, or durations), of the same length.
    sample_rate : float, optional
        Samples a second (Hz) where ``time`` is not given.
    columns : mapping, optional
        What is known of each role's column.
    units : mapping, optional
        The unit of each role's signal, where that is all that is known.
    name : str
        How messages call the arrays.
    rows : (first, last)
        The samples to hand out, counted from 1, both ends included.

    Raises
    ------
    InputError
        A signal is no array of finite numbers, or the lengths differ.
    UsageError
        Both a time and a rate are given, or the rate is none.
    """

    def __init__(
        self,
        values: Mapping[str, ArrayLike],
        time: ArrayLike | None = None,
        sample_rate: float | None = None,
        columns: Mapping[str, Column] | None = None,
        name: str = "the arrays",
        rows: Rows = ALL_ROWS,
        units: Mapping[str, str | None] = {},
    ) -> None:
        if time is not None and sample_rate is not None:
            raise UsageError(
                "`time` and `sample_rate` exclude each other: give the one or the other"
            )
        self.sample_rate = checked_rate(sample_rate)
        self.clock_was_judged = False
        self.values = {role: samples(role, signal) for role, signal in values.items()}
        self.time = None if time is None else stamps(time)
        self.rows = rows
        first, count = next((role, signal.size) for role, signal in self.values.items())
        for role, signal in [
            *self.values.items(),
            *([] if self.time is None else [("time", self.time)]),
        ]:
            if signal.size != count:
                raise InputError(
                    f"`{role}` has {signal.size} samples where `{first}` has {count}"
                )
        infos = [
            replace(parse_column(role, n), unit=units.get(role))
            for n, role in enumerate(values, start=1)
        ]
        columns = columns or dict(zip(values, infos, strict=True))
        has_time = self.time is not None or self.sample_rate is not None
        super().__init__(
            name, dict(columns), has_time, self.sample_rate, self.sample_rate
        )

    def add(self, role: str, signal: ArrayLike, unit: str | None) -> None:
        """Take one more signal (InputError where it is of another length, or not of finite numbers)."""
        values = samples(role, signal)
        if values.size != self.count:
            raise InputError(
                f"`{role}` has {values.size} samples where `{next(iter(self.values))}` has {self.count}"
            )
        self.values[role] = values
        self.columns[role] = replace(parse_column(role, len(self.values)), unit=unit)

    @property
    def count(self) -> int:
        """How many samples there are, whichever rows are handed out."""
        return next(iter(self.values.values())).size

    def blocks(self) -> Iterator[SampleBlock]:
        """Return all samples, in blocks that caches hold."""
        count = self.count
        time = self.time
        if time is None and self.sample_rate is not None:
            time = np.arange(count, dtype=np.float64)
            time /= self.sample_rate
        rows = range(1, count + 1)
        if self.time is not None:
            check = TimeCheck(self.name)
            check.feed(SampleBlock(rows, None, self.time, {}))
            self.notes.extend(check.notes())
            if check.repeat.count and not self.clock_was_judged:
                self.warnings.append(
                    f"{self.name}: `time` repeats its stamps in {check.repeat.count:,} of {count:,} samples:"
                    " too few digits for the rate (`sample_rate` HZ gives the time instead)"
                )
        first, last = self.rows
        if first > count:
            raise InputError(f"{self.name}: there is no row {first}: {count} samples")
        values = self.in_units(self.values)
        whole = SampleBlock(rows, None, time, values).part(
            first - 1, min(last or count, count)
        )
        for begin in range(0, len(whole), BLOCK_ROWS):
            yield whole.part(begin, min(begin + BLOCK_ROWS, len(whole)))


class WholeSource(Source):
    """Another source read whole: one block, which may be exchanged for what was made of it."""

    def __init__(self, source: Source) -> None:
        rates = source.even_rate, source.stated_rate
        super().__init__(source.name, dict(source.columns), source.has_time, *rates)
        self._source = source
        self.no_time = source.no_time
        self.block = joined(list(source.blocks()))
        self.notes, self.warnings = source.notes, source.warnings

    def reading_line(self) -> str | None:
        """Describe what was read."""
        return self._source.reading_line()

    def even_step(self, why: str) -> float:
        """Return the even time step (s), or refuse with the remedy (InputError)."""
        if self.even_rate is not None:
            return 1.0 / self.even_rate
        self.require_time(why)
        assert self.block.time is not None
        return require_even(self.name, self.block.time, why)

    def blocks(self) -> Iterator[SampleBlock]:
        """Return the one block, in parts: what a model makes of it then takes no memory for each row."""
        for start in range(0, max(len(self.block), 1), BLOCK_ROWS):
            part = self.block.part(start, start + BLOCK_ROWS)
            yield replace(part, values=self.in_units(part.values))


def table_source(
    table: pandas.DataFrame,
    want: Mapping[str, ColumnWish],
    time: str | ArrayLike | None = None,
    sample_rate: float | None = None,
    rows: Rows = ALL_ROWS,
) -> ArraySource:
    """Return the wanted columns of a DataFrame as a source.

    Units come from ``attrs["units"]`` (as ``read_log`` leaves them) or from the column
    names (``voltage_V``); the time from a column that is named or guessed, or from
    ``time`` as an array.

    Raises
    ------
    InputError
        A column is absent, several may be meant, or it holds no finite numbers.
    """
    units: Mapping[str, str | None] = table.attrs.get("units", {})
    infos = [
        parse_column(str(name), k, units.get(name))
        for k, name in enumerate(table.columns, start=1)
    ]
    rate = (
        table.attrs.get("sample_rate")
        if sample_rate is None and time is None
        else sample_rate
    )
    warnings: list[str] = []
    taken: list[Column] = []
    if sample_rate is None and (time is None or isinstance(time, str)):
        named = [
            find_column(TABLE, infos, wish.selector, wish.option)
            for wish in want.values()
            if wish.selector
        ]
        clock = find_clock(TABLE, infos, ReadingOptions(time=time), named)
        taken = clock.taken
        if clock.column is not None:
            rate = None
            column = table.iloc[:, clock.column.number - 1]
            if column.dtype.kind in "mMO":
                time = stamps(column.to_numpy())
            else:
                time = clock.whole(samples("time", column.to_numpy()), warnings)
    columns = choose_columns(TABLE, infos, want, taken)
    values = {
        role: table.iloc[:, column.number - 1].to_numpy()
        for role, column in columns.items()
    }
    stamped = None if time is None or isinstance(time, str) else time
    source = ArraySource(
        values, stamped, rate if stamped is None else None, columns, TABLE, rows
    )
    source.warnings.extend(warnings)
    source.clock_was_judged = isinstance(time, str) or bool(taken)
    return source
