"""Tables in memory as logs: pandas and polars frames, and arrays side by side.

Columns are read as those of a CSV file are: by their names and the units in them. A
frame of ``read_log`` states its units in ``attrs["units"]``, by column. A masked row is
a missing row.
"""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import is_time
from dbo_cli.logs.table import Column, Reading, Table, columns_in
from dbo_cli.units import spell, split_header, time_unit, unit_of_array


def table_of(name: str, columns: Iterable[Column]) -> Table:
    """Return columns in memory as a table, which is read as one block.

    Parameters
    ----------
    name
        How messages call the table.
    columns
        Its columns, of one length.
    """
    table = Table(name)
    table.cure, table.block_rows = "leave such rows out", sys.maxsize
    for column in columns:
        table.add(column)
    return table


def column_in_memory(table: str, title: str, values: Any, unit: str | None) -> Column:
    """Return a column of values in memory, durations in s (InputError)."""
    cells = cells_of(values)
    if cells.ndim != 1:
        raise InputError(
            f"{table}: column '{title}': give one row of numbers, shape (n,)"
        )
    if dtype_kind(values) == "m":
        title, unit = split_header(title)[0], "s"
    return replace(next(columns_in(title, cells)), unit=unit)


def is_frame(data: object) -> bool:
    """Return whether data is a pandas or polars frame."""
    has_series = hasattr(data, "items") or hasattr(data, "iter_columns")
    return hasattr(data, "columns") and has_series


def frame_table(frame: Any, time: Any = None) -> Table:
    """Return a frame as a table; its time index is a column where it has no other time.

    Parameters
    ----------
    frame : pandas or polars frame
        The table.
    time : array_like, optional
        The time of each row, in the place of what the frame has; see ``clock_of``.
    """
    attrs = getattr(frame, "attrs", {})
    name = str(attrs.get("name", "the frame"))
    units = attrs.get("units", attrs.get("unit")) or {}
    if not isinstance(units, Mapping):
        raise InputError(
            f"{name}: `attrs` state {units} of no column: give a dict of units by column"
        )
    columns: list[Column] = []
    clocks: list[Column] = []
    if hasattr(frame, "items"):
        titled = frame.items()
    else:
        titled = [(values.name, values) for values in frame.iter_columns()]
    for title, values in titled:
        header = split_header(str(title))[1]
        unit = _one_unit(str(title), units.get(title), header)
        column = column_in_memory(name, str(title), values, unit)
        if is_time(Column(0, str(title), unit)):
            clocks.append(column)
        elif units and title not in units and not column.unit:
            doubt = (
                "has no unit, others have one in `attrs`: call it "
                f"'{title} (UNIT)', or keep its name"
            )
            column = replace(column, doubt=doubt)
        columns.append(column)
    if time is not None or not clocks:
        columns = [column for column in columns if column not in clocks]
        clock = clock_of(name, {name: frame}, time)
        if clock is not None:
            columns.append(clock)
    table = table_of(name, columns)
    table.hint = " (of a frame: rename its columns)"
    table.titles = attrs.get("columns", {})
    table.has_found_offset = bool(attrs.get("holds_delay"))
    return table


def table_in_memory(
    signals: Mapping[str, Any],
    unit_options: Mapping[str, str | None],
    units: Mapping[str, str | None],
    time: Any,
    reading: Reading,
) -> tuple[Table, dict[str, str | None]]:
    """Return arrays, or a frame in the place of all, as a table, and which of its columns has which role.

    Parameters
    ----------
    signals : mapping
        By role, the values, None for none; the name of a Series is that of its column.
    unit_options : mapping
        By role, the unit that the user gives.
    units : mapping
        By role, the unit of a model that they are for.
    time, reading
        Time in s, or how the table will be read: with a rate, or without. The time index of
        a pandas object counts where neither is given, judged as the time column of a file is.

    Raises
    ------
    UsageError
        There are other arrays or units beside a frame, or a unit cannot be converted.
    InputError
        Arrays are in another unit than the model, or are no rows of numbers.
    """
    first, *others = signals.values()
    columns: dict[str, str | None] = dict.fromkeys(("time", *signals))
    if is_frame(first):
        if any(value is not None for value in (*others, *unit_options.values())):
            raise UsageError(
                "a frame has its own columns and units: leave out other arrays, and `unit`, "
                "`voltage_unit`, `displacement_unit`"
            )
        return frame_table(first, time), columns
    if first is None:
        raise InputError(f"{next(iter(signals))}: give an array, a Series or a frame")
    table = table_of("the arrays", [])
    for role, values in signals.items():
        if values is None:
            del columns[role]
            continue
        label = "voltage" if role == "voltage" else "displacement"
        stated, given = stated_unit(values, label), unit_options[role]
        unit = unit_of_array(label, stated, given, units.get(role, given))
        name = str(getattr(values, "name", None) or role)
        if given:  # goes before that of the name
            name = split_header(name)[0]
        column = table.add(column_in_memory(table.name, name, values, unit))
        columns[role] = f"number={column.number}"
    if time is not None or reading.sample_rate is None:
        clock = clock_of(table.name, signals, time)
        if clock is not None:
            columns["time"] = f"number={table.add(clock).number}"
    return table, columns


def clock_of(table: str, signals: Mapping[str, Any], time: Any) -> Column | None:
    """Return the column of the time; None where nothing has it.

    Parameters
    ----------
    table
        How messages call the table.
    signals
        Pandas objects or others, by their names; a time index that they share counts.
    time : array_like, optional
        The time of each row, in the place of an index: in s, or dates.

    Raises
    ------
    InputError
        It is in another unit, or the signals have several times.
    """
    if time is not None:
        return column_in_memory(table, "time", seconds_of(time), "s")
    indexes = [time_index(values) for values in signals.values()]
    indexes = [index for index in indexes if index is not None]
    if any(not index.equals(indexes[0]) for index in indexes):
        raise InputError(f"{', '.join(signals)} have other times: give one `time`")
    if not indexes:
        return None
    title = str(indexes[0].name or "time")
    unit = split_header(title)[1] or time_unit(title)
    return column_in_memory(table, title, indexes[0], unit)


def time_index(data: Any) -> Any:
    """Return a pandas index that is a time by its name or its type; None of a count.

    Raises
    ------
    InputError
        It has several levels.
    """
    index: Any = getattr(data, "index", None)
    if getattr(index, "nlevels", 0) > 1:
        raise InputError("which level of the index is the time? Give `time`")
    title = str(getattr(index, "name", None) or "")
    is_called = is_time(Column(0, title, split_header(title)[1]))
    return index if is_called or dtype_kind(index) in "fmM" else None


# --- values ---


def dtype_kind(values: Any) -> str:
    """Return numpy's letter for what values are: f, i, u, b, M, m, O, U, c."""
    kind = getattr(getattr(values, "dtype", None), "kind", None)
    return str(kind or np.asarray(values).dtype.kind)


def as_numbers(values: Any) -> Floats | None:
    """Return values as numbers, NaN where one is missing or masked.

    None of texts, dates, truth values and complex numbers.
    """
    kind = dtype_kind(values)
    if kind not in "iufO":
        return None
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    elif hasattr(values, "isna"):
        values = values.to_numpy(na_value=np.nan)
    try:
        others = (str, bool, np.bool_, complex)
        if kind == "O" and any(isinstance(value, others) for value in values):
            return None
        return np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        return None


def cells_of(values: Any) -> NDArray[Any]:
    """Return values as an array of numbers (durations in s), of dates, or of texts."""
    kind = dtype_kind(values)
    if kind == "M":
        return np.asarray(values, "M8[ns]")
    if kind == "m":
        return np.asarray(values) / np.timedelta64(1, "s")
    numbers = as_numbers(values)
    return np.asarray(values, dtype=object) if numbers is None else numbers


def stated_unit(values: Any, role: str) -> str | None:
    """Return the unit that values state of themselves; None where they state none.

    A Series states it in ``attrs`` (that of its column, or of its role where arithmetic
    took the name) or in its name, as the header of a CSV file does; an array of another
    library as its ``unit`` or ``units``.
    """
    attrs = getattr(values, "attrs", None)
    title = str(getattr(values, "name", None) or "")
    header = split_header(title)[1]
    if attrs is None and title:
        return header
    if attrs is None:
        unit = getattr(values, "units", getattr(values, "unit", None))
        return None if unit is None else spell(str(unit))
    units = attrs.get("units", attrs.get("unit"))
    if isinstance(units, Mapping):
        units = units[title] if title in units else header or units.get(role)
    return _one_unit(title, units, header)


def _one_unit(title: str, stated: Any, header: str | None) -> str | None:
    """Return the unit that ``attrs`` state, else that of the name; InputError where they differ."""
    if not stated:
        return header
    unit = spell(str(stated))
    if header is not None and unit != header:
        raise InputError(
            f"'{title}': its `attrs` state {unit}: rename it, or correct `attrs`"
        )
    return unit


def seconds_of(time: Any) -> NDArray[Any]:
    """Return times as seconds; dates count from the first."""
    cells, unit = cells_of(time), stated_unit(time, "time")
    unit = unit or time_unit(str(getattr(time, "name", "")))  # an index named ms
    if dtype_kind(time) not in "mM" and unit not in (None, "s"):
        raise InputError(
            f"`time` is in {unit}: give seconds (`.to_numpy()` where the numbers are)"
        )
    if cells.dtype.kind == "M":
        cells = (cells - cells[:1]) / np.timedelta64(1, "s")
    return cells
