"""Parquet and Feather files, read by polars in stretches of rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.logs.fence import fenced, quiet, refuse_part
from dbo_cli.logs.table import NOT_A_TIME, Column, Fetch, Reading, Table

_STRETCH = 1 << 19  # rows that polars hands out at once
_KIND = "Parquet or Feather"


def read_arrow(path: str, inner: str, reading: Reading) -> Table:
    """Read the columns of a Parquet or Feather file (InputError)."""
    import polars as pl

    refuse_part(path, inner)
    table = Table(path)
    table.block_rows = _STRETCH
    with fenced(path, _KIND), quiet():
        with open(path, "rb") as file:
            is_parquet = file.read(4) == b"PAR1"
        scan_file = pl.scan_parquet if is_parquet else pl.scan_ipc
        scan = scan_file(path, glob=False)  # brackets in a name are no pattern
        rows = int(scan.select(pl.len()).collect().item())
        for name, stored in scan.collect_schema().items():
            kind = "text"
            if stored in (pl.Datetime, pl.Time):
                kind = "stamp"
            elif stored.is_numeric():
                kind = "number"
            fetch = _fetch_of(scan, name)
            table.add(Column(0, name, kind=kind, length=rows, fetch=fetch))
    return table.require_numbers([f"{rows} rows"])


def _fetch_of(scan: Any, name: str) -> Fetch:
    """Return what fetches rows of a column as float64, or as int64 nanoseconds."""
    import polars as pl

    def fetch(start: int, stop: int) -> NDArray[Any]:
        with quiet():
            series = scan.select(name).slice(start, stop - start).collect()[name]
        if series.dtype == pl.Datetime:  # in UTC, whatever zone it is shown in
            series = series.dt.cast_time_unit("ns")
        if series.dtype in (pl.Datetime, pl.Time):
            series = series.to_physical().fill_null(NOT_A_TIME)
        else:
            series = series.cast(pl.Float64)
        return np.asarray(series.to_numpy())

    return fetch
