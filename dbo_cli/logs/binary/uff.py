"""Universal files (UFF, UNV) of modal analysis: their data sets 58 as columns, read with pyuff."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source
from dbo_cli.logs.libraries import import_extra
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement

_TIME, _UNEVEN = 17, 0  # of the dataset's definition: the kind of its abscissa, and its spacing


def open_uff(request: Request) -> ColumnTable:
    """Open a universal file: one column for each function of time.

    Raises
    ------
    InputError
        pyuff is not installed, the file is damaged, or holds no functions of time.
    """
    pyuff = import_extra("pyuff", request.place)
    with request.reading("UFF"):  # pyuff raises whatever the damaged text leads to
        found = pyuff.UFF(request.address.path).read_sets()
        sets = found if isinstance(found, list) else [found]
        functions = [one for one in sets if one["type"] == 58 and one["abscissa_spec_data_type"] == _TIME]
        sources: list[ColumnSource] = []
        for one in functions:
            sources += _columns(one, {source.label for source in sources})
    if not sources:
        raise request.no_columns((f"data set {one['type']}" for one in sets), " (functions of time, 58)")
    return ColumnTable(request, "UFF", sources)


def _columns(one: dict[str, Any], taken: set[str]) -> list[ColumnSource]:
    """Make a column of a function; its stamps become another where they are not evenly spaced."""
    names = (clean_text(one[key]).strip() for key in ("id1", "ordinate_axis_lab"))
    name = next((name for name in names if name not in ("", "NONE")), "")
    name = f"{name} {one['rsp_node']}" if name in taken or not name else name
    unit = clean_text(one["ordinate_axis_units_lab"]).strip()
    values, step = np.asarray(one["data"]), float(one["abscissa_inc"])
    if values.dtype.kind != "f":
        return []
    source = ColumnSource(
        name, len(values), lambda start, stop: values[start:stop], None if unit in ("", "NONE") else unit
    )
    if one["abscissa_spacing"] == _UNEVEN or not step > 0.0:
        return [array_source("time", np.asarray(one["x"]), "s"), source][("time" in taken) :]
    clock = (Statement(f"'abscissa_inc' {step:g} s", 1.0 / step),)
    return [replace(source, clock=clock, start=float(one["abscissa_min"]))]
