"""MATLAB files before version 7.3 (v4, v6, v7) as a table of columns; v7.3 is HDF5."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source, brief
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.stated_clock import Statement, is_clock_name, read_statement

_START_NAMES = ("tstart", "t0", "x0")
_LABELS = ("Name", "name", "label", "Label", "title")
_VALUES = ("Data", "data", "values", "value", "Values", "Y")
_UNITS = ("Unit", "unit", "Units", "units")
_OBJECTS = (
    "MATLAB objects (table, timetable, timeseries, string) can be taken apart by MATLAB only: save plain "
    "vectors, t, voltage and displacement, with save('run.mat', 't', 'voltage', 'displacement')"
)


def open_matlab(address: Address, selectors: Sequence[str], options: ReadingOptions) -> ColumnTable:
    """Open a MATLAB file: vectors, columns of matrices, fields of structs (one struct, or ``FILE::struct``).

    Single values called ``fs``, ``Ts``, ``dt``, ``Tinterval`` and the like give the sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    import scipy.io

    place = address.text
    try:
        stored = scipy.io.loadmat(address.path, simplify_cells=True)
    except Exception as problem:  # scipy raises whatever the damaged bytes lead to
        why = "it ends early" if isinstance(problem, IndexError | EOFError) else brief(problem)
        raise InputError(f"{place}: damaged MATLAB file: {why}") from None
    variables = {name: value for name, value in stored.items() if not name.startswith("__")}
    objects = "__function_workspace__" in stored or any(map(_is_object, variables.values()))
    group, trail = _struct(place, variables, address.group)
    sources = _columns(group)
    if not sources:
        inner = [
            (name, found)
            for name, value in group.items()
            if isinstance(value, dict) and (found := _columns(value))
        ]
        if len(inner) == 1:
            trail, sources = [*trail, group[inner[0][0]]], inner[0][1]
        elif inner:
            names = ", ".join(name for name, _ in inner)
            raise InputError(f"{place}: columns in {len(inner)} structs, {names}: which one? "
                             f"(write {address.path}::{inner[0][0]})")  # fmt: skip
    sources += [source for path in selectors for source in _by_path(variables, path) if path not in group]
    if not sources:
        listed = ", ".join(f"{name} ({_shape(value)})" for name, value in group.items()) or "nothing"
        raise InputError(
            f"{place}: no columns of numbers: it holds {listed}" + (f" ({_OBJECTS})" if objects else "")
        )
    clock = next((said for level in reversed(trail) if (said := list(_statements(level)))), [])
    starts = [value for level in trail for name, value in level.items() if name.lower() in _START_NAMES]
    start = (
        float(starts[-1]) if starts and np.ndim(starts[-1]) == 0 and not isinstance(starts[-1], str) else 0.0
    )
    return ColumnTable(place, "MATLAB", sources, clock=clock, start=start)


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
    if _is_channel(group) and not _is_channel_list(
        group
    ):  # Simulink's "structure with time": time beside signals
        sources += [
            source for source in _channels("", group) if source.label not in {s.label for s in sources}
        ]
    longest = max((source.length for source in sources), default=0)
    sources = [source for source in sources if source.length > 1 or longest <= 1]
    return [_with_unit(group, source) for source in sources]


def _arrays(name: str, value: Any) -> list[ColumnSource]:
    """Take a variable apart: a vector is a column, and the longer axis of a matrix is time."""
    array = np.asarray(value) if isinstance(value, np.ndarray) else None
    if array is None or array.dtype.kind not in "fiub" or array.ndim not in (1, 2) or not array.size:
        return []
    if array.ndim == 1:
        return [array_source(name, array)]
    table = array if array.shape[0] >= array.shape[1] else array.T
    return [array_source(f"{name}[{index + 1}]", table[:, index]) for index in range(table.shape[1])]


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


def _with_unit(group: dict[str, Any], source: ColumnSource) -> ColumnSource:
    """Take a unit from a text beside the column (``voltage_unit``) where it has none itself."""
    if source.unit:
        return source
    texts = (group.get(f"{source.label}{end}") for end in ("_units", "_unit", "Unit"))
    return replace(source, unit=next((text for text in texts if isinstance(text, str) and text), None))


def _by_path(variables: dict[str, Any], path: str) -> list[ColumnSource]:
    """Find what the user named by a path through structs (``run.voltage``)."""
    value: Any = variables
    for part in path.replace("/", ".").split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return _arrays(path, value)


def _statements(level: dict[str, Any]) -> Iterator[Statement]:
    for name, value in level.items():
        if is_clock_name(name) and not isinstance(value, dict) and np.size(value) == 1:
            unit = level.get(f"{name}_units", level.get(f"{name}_unit"))
            found = read_statement(name, value, unit)
            if found is not None:
                yield found


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
