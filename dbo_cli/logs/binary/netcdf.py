"""NetCDF's classic format (version 3) as a table of columns; version 4 is HDF5."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, brief
from dbo_cli.logs.foreign_text import clean_text
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.stated_clock import Statement, is_clock_name, read_statement

_FILL = 9.969209968386869e36  # what the library leaves where nothing was written


def open_netcdf(address: Address, selectors: Sequence[str], options: ReadingOptions) -> ColumnTable:
    """Open a classic netCDF file: its one-dimensional variables, scaled as the conventions say.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    from scipy.io import netcdf_file

    place = address.text
    try:
        file = netcdf_file(address.path, "r", mmap=False)
        variables = dict(file.variables)
        sources = [
            _column(clean_text(name), variable)
            for name, variable in variables.items()
            if len(variable.shape) == 1 and variable.data.dtype.kind in "fiu"
        ]
        clock = list(_statements(file._attributes))
        for name, variable in variables.items():
            if is_clock_name(name) and not variable.shape:
                statement = read_statement(name, variable.data, variable._attributes.get("units"))
                clock += [statement] if statement is not None else []
    except Exception as problem:  # scipy raises whatever the damaged bytes lead to
        raise InputError(f"{place}: damaged netCDF: {brief(problem)}") from None
    if not sources:
        listed = ", ".join(f"{name} {variable.shape}" for name, variable in variables.items()) or "nothing"
        raise InputError(f"{place}: no columns of numbers: it holds {listed}")
    return ColumnTable(place, "netCDF", sources, clock=clock, close=_closer(file))


def _closer(file: Any) -> Callable[[], None]:
    def close() -> None:
        with warnings.catch_warnings():  # scipy warns of views of a mapped file; nothing is mapped here
            warnings.simplefilter("ignore")
            file.close()

    return close


def _column(label: str, variable: Any) -> ColumnSource:
    data, attributes = variable.data, variable._attributes
    unit = clean_text(attributes["units"]) if "units" in attributes else None
    missing = tuple(
        float(np.ravel(attributes[name])[0])
        for name in ("_FillValue", "missing_value")
        if name in attributes and not isinstance(attributes[name], bytes | str)
    )
    missing = tuple(one for one in missing if one == one)
    if not missing and data.dtype.kind == "f":
        missing = (_FILL, float(np.float32(_FILL)))
    source = ColumnSource(label, len(data), lambda start, stop: data[start:stop], unit)
    problem = ""
    if clean_text(attributes.get("_Unsigned", "")).lower() == "true":
        problem = f"column '{label}' is stored as _Unsigned, which is not read"
    return replace(
        source,
        scale=_number(attributes, "scale_factor", 1.0),
        offset=_number(attributes, "add_offset", 0.0),
        missing=missing,
        clock=tuple(_statements(attributes)),
        problem=problem,
    )


def _number(attributes: Any, name: str, default: float) -> float:
    value = np.ravel(attributes.get(name, default))
    return float(value[0]) if value.size and value.dtype.kind in "fiu" else default


def _statements(attributes: Any) -> Iterator[Statement]:
    for name, value in attributes.items():
        if is_clock_name(name):
            found = read_statement(
                name, value, attributes.get(f"{name}_units", attributes.get(f"{name}_unit"))
            )
            if found is not None:
                yield found
