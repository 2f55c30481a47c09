"""Arrays, tables and files as sources, so that a function takes whichever is at hand."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError
from dbo_cli.logs.clock import to_seconds
from dbo_cli.logs.columns import (
    TIME_GUESSES,
    ColumnWish,
    choose_columns,
    column_info,
    find_column,
    guess_columns,
)
from dbo_cli.logs.sample_block import ColumnInfo
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
    clock = None if sample_rate is not None else _clock_of(infos, time)
    columns = choose_columns(TABLE, infos, want, [clock] if clock else [])
    if clock is not None:
        stamps = np.asarray(table.iloc[:, clock.number - 1], dtype=np.float64)
        time, given = to_seconds(stamps, clock.unit), None
    values = {role: table.iloc[:, column.number - 1].to_numpy() for role, column in columns.items()}
    stamped = None if time is None or isinstance(time, str) else time
    return ArraySource(values, stamped, given if stamped is None else None, columns, TABLE)


def _clock_of(infos: list[ColumnInfo], time: Any) -> ColumnInfo | None:
    """Return the time column, named or guessed; None where the time is an array or not there."""
    if isinstance(time, str):
        return find_column(TABLE, infos, time, "time")
    if time is not None:
        return None
    found = guess_columns(infos, TIME_GUESSES)
    if len(found) > 1:
        names = " or ".join(f"'{column.name}'" for column in found)
        raise InputError(f"{TABLE}: which column is the time, {names}? (choose with `time` NAME or NUMBER)")
    return found[0] if found else None
