"""Parquet and Feather files, read by polars in stretches of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.logs.formats.stored import FileFormat, fenced, refuse_part
from dbo_cli.logs.table import NOT_A_TIME, Column, Reading, Table

_STRETCH = 1 << 19  # rows that polars hands out at once
_KIND = "Parquet or Feather"


class ArrowTable(Table):
    """The columns of a Parquet or Feather file (InputError)."""

    def __init__(self, path: str) -> None:
        import polars as pl

        super().__init__(path)
        with fenced(path, _KIND):
            with open(path, "rb") as file:
                is_parquet = file.read(4) == b"PAR1"
            scan = pl.scan_parquet if is_parquet else pl.scan_ipc
            self._scan = scan(path, glob=False)  # brackets in a name are no pattern
            schema = self._scan.collect_schema()
            self._rows = int(self._scan.select(pl.len()).collect().item())
        self._names = list(schema)
        for name, stored in schema.items():
            kind = "text"
            if stored in (pl.Datetime, pl.Time):
                kind = "stamp"
            elif stored.is_numeric() or stored == pl.Boolean:
                kind = "number"
            self.add_column(name, kind=kind)

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns; see ``Table``."""
        names = [self._names[column.number - 1] for column in columns]
        for start in range(0, self._rows, _STRETCH):
            with fenced(self.name, _KIND):
                frame = self._scan.select(names).slice(start, _STRETCH).collect()
                arrays = [_array_of(frame[name]) for name in names]
            yield arrays


def _array_of(series: Any) -> NDArray[Any]:
    """Return a series as float64, or as int64 nanoseconds."""
    import polars as pl

    if series.dtype == pl.Datetime:  # in UTC, whatever zone it is shown in
        series = series.dt.cast_time_unit("ns")
    if series.dtype in (pl.Datetime, pl.Time):
        stamps = series.to_physical().fill_null(NOT_A_TIME)
        return np.asarray(stamps.to_numpy())
    return np.asarray(series.cast(pl.Float64).to_numpy())


def _read(path: str, inner: str, reading: Reading) -> Table:
    """Read a Parquet or Feather file (InputError)."""
    refuse_part(path, inner)
    return ArrowTable(path)


ARROW = FileFormat(_KIND, (b"PAR1", b"ARROW1"), (), _read)
