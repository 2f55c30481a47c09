"""What scipy reads as a table of columns: MATLAB before version 7.3 and netCDF 3; newer ones are HDF5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.column_table import (
    MATLAB_OBJECTS,
    ColumnSource,
    ColumnTable,
    Request,
    array_source,
    matrix_sources,
    number_in,
    statements_in,
    unpacked,
    with_unit,
    without_scalars,
)
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement, read_statements

_START_NAMES = ("tstart", "t0", "x0")
_LABELS = ("Name", "name", "label", "Label", "title")
_VALUES = ("Data", "data", "values", "value", "Values", "Y")
_UNITS = ("Unit", "unit", "Units", "units")


def open_matlab(request: Request) -> ColumnTable:
    """Open a MATLAB file: vectors, columns of matrices, fields of structs (one struct, or ``FILE::struct``).

    Single values called ``fs``, ``Ts``, ``dt``, ``Tinterval`` and the like give the sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    import scipy.io

    place = request.place
    with request.reading("MATLAB file"):  # scipy raises whatever the damaged bytes lead to
        try:
            stored = scipy.io.loadmat(request.address.path, simplify_cells=True)
        except (IndexError, EOFError):
            raise ValueError("it ends early") from None
    variables = {name: value for name, value in stored.items() if not name.startswith("__")}
    group, trail = _struct(place, variables, request.address.group)
    sources = _columns(group)
    if not sources:
        structs = {name: value for name, value in group.items() if isinstance(value, dict)}
        inner = {name: found for name, value in structs.items() if (found := _columns(value))}
        if len(inner) > 1:
            first = next(iter(inner))
            raise InputError(
                f"{place}: columns in {len(inner)} structs, {', '.join(inner)}: which one? "
                f"(write {request.address.path}::{first})"
            )
        for name in inner:
            trail, sources = [*trail, structs[name]], inner[name]
    for path in request.named:
        if path not in group:
            sources += _by_path(variables, path)
    if not sources:
        objects = "__function_workspace__" in stored or any(map(_is_object, variables.values()))
        held = (f"{name} ({_shape(value)})" for name, value in group.items())
        raise request.no_columns(held, MATLAB_OBJECTS if objects else "")
    clock = next((stated for level in reversed(trail) if (stated := _statements(level))), [])
    starts = [value for level in trail for name, value in level.items() if name.lower() in _START_NAMES]
    start = number_in(starts[-1]) if starts and np.ndim(starts[-1]) == 0 else None
    return ColumnTable(request, "MATLAB", sources, clock=clock, start=start or 0.0)


def _struct(
    place: str, variables: dict[str, Any], path: str | None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Go down to the struct that ``FILE::a.b`` names; the variables themselves without one."""
    group, trail = variables, [variables]
    for part in [part for part in (path or "").replace("/", ".").split(".") if part]:
        value = group.get(part)
        if not isinstance(value, dict):
            names = ", ".join(name for name, one in group.items() if isinstance(one, dict)) or "none"
            raise InputError(f"{place}: there is no struct '{part}': the structs are: {names}")
        group, trail = value, [*trail, value]
    return group, trail


def _columns(group: dict[str, Any]) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    for name, value in group.items():
        sources += _channels(name, value) if _is_channel_list(value) else _arrays(name, value)
    if _is_channel(group) and not _is_channel_list(group):  # Simulink's "structure with time"
        known = {source.label for source in sources}
        sources += [source for source in _channels("", group) if source.label not in known]
    return [with_unit(source, group.get) for source in without_scalars(sources)]


def _arrays(name: str, value: Any) -> list[ColumnSource]:
    return matrix_sources(name, value) if isinstance(value, np.ndarray) else []


def _is_channel(value: Any) -> bool:
    return isinstance(value, dict) and _first(value, _VALUES) is not None


def _is_channel_list(value: Any) -> bool:
    """Recognise an array of structs with a name and values each (dSPACE's Y, Simulink's signals)."""
    items = value if isinstance(value, list | np.ndarray) else [value]
    return (
        (not isinstance(items, np.ndarray) or items.dtype == object)
        and len(items) > 0
        and all(_is_channel(one) and _first(one, _LABELS) for one in items)
    )


def _channels(name: str, value: Any) -> Iterator[ColumnSource]:
    for number, one in enumerate(value if isinstance(value, list | np.ndarray) else [value], start=1):
        label = str(_first(one, _LABELS) or name or number).strip('"')
        unit = _first(one, _UNITS)
        for source in _arrays(label, np.atleast_1d(_first(one, _VALUES))):
            yield replace(source, unit=unit if isinstance(unit, str) and unit else None)


def _first(struct: dict[str, Any], names: Sequence[str]) -> Any:
    return next((struct[name] for name in names if name in struct), None)


def _by_path(variables: dict[str, Any], path: str) -> list[ColumnSource]:
    """Find what the user named by a path through structs (``run.voltage``)."""
    value: Any = variables
    for part in path.replace("/", ".").split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return _arrays(path, value)


def _statements(level: Mapping[str, Any]) -> list[Statement]:
    return statements_in(
        {name: one for name, one in level.items() if not isinstance(one, dict) and np.size(one) == 1}
    )


def _is_object(value: Any) -> bool:
    return type(value).__name__ in ("MatlabOpaque", "MatlabFunction", "MatlabObject")


def _shape(value: Any) -> str:
    if isinstance(value, dict):
        return "a struct"
    if isinstance(value, str):
        return "text"
    if _is_object(value):
        return "an object"
    return "x".join(map(str, np.shape(value))) or "one value"


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
            _variable(clean_text(name), variable)
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


def _variable(label: str, variable: Any) -> ColumnSource:
    data, attributes = variable.data, variable._attributes
    unit = clean_text(attributes["units"]) if "units" in attributes else None
    source = replace(array_source(label, data, unit), clock=tuple(statements_in(attributes)))
    unsigned = clean_text(attributes.get("_Unsigned", "")).lower() == "true"
    return unpacked(
        source, lambda name: number_in(attributes.get(name)), unsigned, filled=data.dtype.kind == "f"
    )
