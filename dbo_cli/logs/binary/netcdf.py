"""NetCDF's classic format (version 3) as a table of columns; version 4 is HDF5."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dbo_cli.logs.column_table import (
    ColumnSource,
    ColumnTable,
    Request,
    array_source,
    number_in,
    statements_in,
    unpacked,
)
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import read_statements


def open_netcdf(request: Request) -> ColumnTable:
    """Open a classic netCDF file: its one-dimensional variables, scaled as the conventions say.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    from scipy.io import netcdf_file

    # Without a map everything is read here; scipy raises whatever the damaged bytes lead to.
    with request.reading("netCDF"), netcdf_file(request.address.path, "r", mmap=False) as file:
        variables = dict(file.variables)
        sources = [
            _column(clean_text(name), variable)
            for name, variable in variables.items()
            if len(variable.shape) == 1 and variable.data.dtype.kind in "fiu"
        ]
        clock = statements_in(file._attributes)
        for name, variable in variables.items():
            if not variable.shape:
                clock += read_statements(name, variable.data, variable._attributes.get("units"))
    if not sources:
        raise request.no_columns(f"{name} {variable.shape}" for name, variable in variables.items())
    return ColumnTable(request, "netCDF", sources, clock=clock)


def _column(label: str, variable: Any) -> ColumnSource:
    data, attributes = variable.data, variable._attributes
    unit = clean_text(attributes["units"]) if "units" in attributes else None
    source = replace(array_source(label, data, unit), clock=tuple(statements_in(attributes)))
    unsigned = clean_text(attributes.get("_Unsigned", "")).lower() == "true"
    return unpacked(
        source, lambda name: number_in(attributes.get(name)), unsigned, filled=data.dtype.kind == "f"
    )
