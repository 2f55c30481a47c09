"""Parquet and Feather (Arrow) files as a table of columns, read in blocks with polars."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import polars

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, from_first_row, statements_in
from dbo_cli.logs.libraries import host, keep_interrupts

_ROWS = 1 << 20  # read at once: a row group is decoded whole, and pandas writes a million rows into one
_INDEX = "__index_level_0__"  # what pandas calls an index without a name


def open_parquet(request: Request) -> ColumnTable:
    """Open a Parquet file.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    return _open(request, "Parquet", polars.scan_parquet, _parquet_metadata)


def open_feather(request: Request) -> ColumnTable:
    """Open a Feather (Arrow) file; see :func:`open_parquet`."""
    return _open(request, "Feather", polars.scan_ipc, lambda path: {})


def open_old_feather(request: Request) -> ColumnTable:
    """Refuse the first version of Feather, which nothing at hand reads (InputError)."""
    raise InputError(
        f"{request.place}: Feather version 1 is not read: write it again with version 2, or as Parquet"
    )


def _open(
    request: Request, kind: str, scan: Callable[..., Any], metadata_of: Callable[[str], dict[str, str]]
) -> ColumnTable:
    keep_interrupts()
    damaged = (polars.exceptions.PolarsError, polars.exceptions.PanicException, OSError, ValueError)
    with request.reading(kind, damaged), host().contained(request.place, kind):
        metadata = metadata_of(request.address.path)
        frame = scan(request.address.path)
        schema = frame.collect_schema()
        length = int(frame.select(polars.len()).collect().item())
    attributes = _pandas_attributes(metadata)
    units = attributes.get("units")
    reader = _Reader(frame, request.place, kind)
    sources = []
    for name, kind_of in schema.items():
        source = _column(reader, name, kind_of, length)
        if source is not None:
            unit = units.get(name) if isinstance(units, dict) else None
            sources.append(replace(source, unit=source.unit or (str(unit) if unit else None)))
    if not sources:
        raise request.no_columns(f"{name} ({kind_of})" for name, kind_of in schema.items())
    clock = statements_in(metadata) + statements_in(attributes)
    return ColumnTable(request, kind, sources, clock=clock, damaged=damaged)


class _Reader:
    """Reads stretches of a file for all its columns, keeping the last one of each."""

    def __init__(self, frame: Any, place: str, kind: str) -> None:
        self._frame, self._place, self._kind = frame, place, kind
        self._kept: dict[str, tuple[int, Any]] = {}

    def fetch(self, name: str, start: int, stop: int) -> Any:
        """Give rows start..stop of a column as an array; nulls become NaN."""
        pieces = []
        while start < stop:
            base = start // _ROWS * _ROWS
            if self._kept.get(name, (-1, None))[0] != base:
                self._kept[name] = (base, self._read(name, base))
            values = self._kept[name][1]
            piece = values[start - base : stop - base]
            if not len(piece):
                raise ValueError(f"column '{name}' ends early")
            pieces.append(piece)
            start += len(piece)
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)

    def _read(self, name: str, base: int) -> Any:
        column = polars.col(name)
        kind = self._frame.collect_schema()[name]
        physical = column.to_physical() if kind.is_temporal() else column.cast(polars.Float64)
        with host().contained(self._place, self._kind):
            return self._frame.slice(base, _ROWS).select(physical).collect().to_series().to_numpy()


def _column(reader: _Reader, name: str, kind: Any, length: int) -> ColumnSource | None:
    source = ColumnSource(name, length, lambda start, stop: reader.fetch(name, start, stop))
    if kind.is_numeric() or str(kind) == "Boolean":
        return None if name == _INDEX and kind.is_integer() else source
    unit = getattr(kind, "time_unit", None)
    if unit is None or not length:
        return None
    return from_first_row(replace(source, label="time" if name == _INDEX else name), unit)


def _parquet_metadata(path: str) -> dict[str, str]:
    read = getattr(polars, "read_parquet_metadata", None)  # newer than the oldest polars that is supported
    try:
        return {str(key): str(value) for key, value in read(path).items()} if read is not None else {}
    except (Exception, polars.exceptions.PanicException):
        return {}  # a damaged file is complained about when its columns are looked up


def _pandas_attributes(metadata: dict[str, str]) -> dict[str, Any]:
    """Give ``DataFrame.attrs`` as pandas stores them: ``units`` by column, a rate."""
    try:
        found = json.loads(metadata.get("PANDAS_ATTRS", "{}"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
