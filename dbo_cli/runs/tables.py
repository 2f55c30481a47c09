"""Arrays, tables and files as sources, so that a function takes whichever is at hand."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.logs.columns import ColumnWish, choose_columns, column_info, find_column
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray
from dbo_cli.logs.time_column import find_time_column
from dbo_cli.runs.source import ArraySource

if TYPE_CHECKING:
    import pandas

TABLE = "the table"


def is_table(data: object) -> bool:
    """Tell whether something is a DataFrame, without importing pandas for it."""
    return hasattr(data, "columns") and hasattr(data, "iloc")


def is_file(data: object) -> bool:
    """Tell whether something names a file."""
    return isinstance(data, str | os.PathLike)


def table_source(
    table: pandas.DataFrame,
    want: Mapping[str, ColumnWish],
    time: str | ArrayLike | None = None,
    sample_rate: float | None = None,
) -> ArraySource:
    """Return the wanted columns of a DataFrame as a source.

    Units come from ``attrs["units"]`` (as ``read_log`` leaves them) or from the column names
    (``voltage_V``); the time from a column that is named or guessed, or from ``time`` as an array.

    Raises
    ------
    InputError
        A column is not there, not to be told, or holds no finite numbers.
    """
    units: Mapping[str, str | None] = table.attrs.get("units", {})
    infos = [column_info(str(name), k, units.get(name)) for k, name in enumerate(table.columns, start=1)]
    given = table.attrs.get("sample_rate") if sample_rate is None and time is None else sample_rate
    warnings: list[str] = []
    taken: list[ColumnInfo] = []
    if sample_rate is None and (time is None or isinstance(time, str)):
        named = [find_column(TABLE, infos, one.selector, one.option) for one in want.values() if one.selector]
        found = find_time_column(TABLE, infos, ReadingOptions(time=time), named)
        taken = found.taken
        if found.clock is not None:
            stamps = _figures(table.iloc[:, found.clock.column.number - 1])
            time, given = found.clock.whole(stamps, warnings), None
    columns = choose_columns(TABLE, infos, want, taken)
    values = {role: table.iloc[:, column.number - 1].to_numpy() for role, column in columns.items()}
    stamped = None if time is None or isinstance(time, str) else time
    source = ArraySource(values, stamped, given if stamped is None else None, columns, TABLE)
    source.warnings.extend(warnings)
    source.clock_was_judged = isinstance(time, str) or bool(taken)
    return source


def _figures(column: pandas.Series) -> FloatArray:
    """Return a column of time stamps as numbers: pandas' dates as ns since 1970, its durations as s."""
    kind = column.dtype.kind
    if kind in "mM":
        whole = np.asarray(column, dtype=f"{kind}8[ns]").astype(np.int64).astype(np.float64)
        return whole / 1e9 if kind == "m" else whole
    return np.asarray(column, dtype=np.float64)
