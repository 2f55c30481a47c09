"""Tables in memory as logs: pandas and polars frames, and arrays side by side.

Columns are read as those of a CSV file are: by their names and the units in them. A
frame of ``read_log`` states its units in ``attrs["units"]``, by column. A masked row is
a missing row.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError
from dbo_cli.logs.columns import TIME_NAMES, words
from dbo_cli.logs.table import Table, columns_in
from dbo_cli.units import spell, split_header, time_unit

Entry = tuple[str, Any, str | None]
"""A column: its name, its values, and its unit."""


def table_of(name: str, entries: Iterable[Entry]) -> Table:
    """Return columns in memory as a table, which is read as one block.

    Parameters
    ----------
    name
        How messages call the table.
    entries
        Its columns.
    """
    table = Table(name)
    table.cure, table.block_rows = "leave such rows out", sys.maxsize
    for title, values, unit in entries:
        cells = cells_of(values)
        if cells.ndim != 1:
            raise InputError(
                f"{name}: column '{title}': give one row of numbers, shape (n,)"
            )
        unit = "s" if dtype_kind(values) == "m" else unit
        for column in columns_in(title, cells):
            table.add(replace(column, unit=unit))
    return table


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
        The time of each row (s), in the place of what the frame has.
    """
    attrs = getattr(frame, "attrs", {})
    units = attrs.get("units", {})
    entries: list[Entry] = []
    if hasattr(frame, "items"):
        for title, values in frame.items():
            entries.append((str(title), values, units.get(title)))
    else:  # polars
        entries += [(values.name, values, None) for values in frame.iter_columns()]
    has_clock = any(map(_is_clock, entries))
    index = getattr(frame, "index", None)
    if time is not None:
        entries = [entry for entry in entries if not _is_clock(entry)]
        entries.append(("time", time, "s"))
    elif not has_clock and index is not None and dtype_kind(index) in "fmM":
        title = str(index.name or "time")
        entries.insert(0, (title, index, split_header(title)[1] or "s"))
    table = table_of(str(attrs.get("name", "the frame")), entries)
    table.has_found_offset = bool(attrs.get("holds_delay"))
    for index, column in enumerate(table.columns):
        is_clock = _is_clock((column.name, None, column.unit))
        if units and column.name not in units and not column.unit and not is_clock:
            doubt = (
                "has no unit, others have one in `attrs`: call it "
                f"'{column.name} (UNIT)', or keep its name"
            )
            table.columns[index] = replace(column, doubt=doubt)
    return table


def _is_clock(entry: Entry) -> bool:
    """Return whether a column is a time by its name or its unit."""
    title, _, unit = entry
    is_named = bool(words(title) & TIME_NAMES)
    return is_named or time_unit(unit or split_header(title)[1]) is not None


# --- values ---


def dtype_kind(values: Any) -> str:
    """Return numpy's letter for what values are: f, i, u, b, M, m, O, U, c."""
    kind = getattr(getattr(values, "dtype", None), "kind", None)
    return str(kind or np.asarray(values).dtype.kind)


def as_numbers(values: Any) -> Floats:
    """Return values as numbers, NaN where one is missing or masked.

    Raises
    ------
    InputError
        They are texts, dates, truth values or complex.
    """
    kind = dtype_kind(values)
    if kind not in "iufO":
        raise InputError("no numbers")
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    elif hasattr(values, "isna"):
        values = values.to_numpy(na_value=np.nan)
    try:
        if kind == "O" and any(isinstance(value, str) for value in values):
            raise InputError("no numbers")
        return np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError("no numbers") from None


def cells_of(values: Any) -> NDArray[Any]:
    """Return values as an array of numbers (durations in s), of dates, or of texts."""
    kind = dtype_kind(values)
    if kind == "M":
        return np.asarray(values, "M8[ns]")
    if kind == "m":
        return np.asarray(values) / np.timedelta64(1, "s")
    try:
        return as_numbers(values)
    except InputError:
        return np.asarray(values, dtype=object)


def stated_unit(values: Any, role: str) -> str | None:
    """Return the unit that values state of themselves; None where they state none.

    A Series states it in ``attrs`` (that of its column, or of its role where arithmetic
    took the name) or in its name, as the header of a CSV file does; an array of another
    library as its ``unit`` or ``units``.
    """
    attrs = getattr(values, "attrs", None)
    title = str(getattr(values, "name", None) or "")
    header = split_header(title)[1]
    if attrs is None:
        unit = (
            None if title else getattr(values, "units", getattr(values, "unit", None))
        )
        return spell(header if unit is None else str(unit))
    units = attrs.get("units", attrs.get("unit"))
    if isinstance(units, Mapping):
        units = units[title] if title in units else header or units.get(role)
    return header if units is None else spell(str(units))
