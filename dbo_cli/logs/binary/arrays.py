"""Arrays as a table of columns: NumPy's files, MATLAB's before version 7.3, netCDF 3 (newer ones are HDF5).

NumPy reads the first, scipy the others. Pickled objects are never loaded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import (
    MATLAB_OBJECTS,
    ColumnSource,
    ColumnTable,
    Fetch,
    array_source,
    matrix_sources,
    number_in,
    statements_in,
    unpacked,
    with_unit,
    without_scalars,
)
from dbo_cli.logs.columns import TIME_NAMES
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement, is_clock_name, read_statements

_PIECE = 1 << 23  # bytes read at once: a matrix is read by whole rows, whatever its width
# What the exports of PicoScope (Tstart), Simulink (values, label) and dSPACE (X, Y, Data, Unit) call these.
_START_NAMES = ("tstart", "t0", "x0")
_LABELS = ("Name", "name", "label", "Label", "title")
_VALUES = ("Data", "data", "values", "value", "Values", "Y")
_UNITS = ("Unit", "unit", "Units", "units")


# --- NumPy -------------------------------------------------------------------------------------------------


def open_npy(request: Request) -> ColumnTable:
    """Open an array: fields of a structured array, or a matrix's columns (by number), read in blocks.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    with request.reading("NumPy file"):
        try:
            # Mapped for its header alone: reading a map of a file that is cut meanwhile ends the process.
            array = np.load(request.address.path, mmap_mode="r", allow_pickle=False)
        except ValueError as problem:
            if any(word in str(problem) for word in ("allow_pickle", "Object arrays", "Python objects")):
                raise InputError(
                    f"{request.place}: it holds pickled Python objects, which are not loaded: save arrays of "
                    "numbers"
                ) from None
            raise
        sources = list(_file_array_columns(request.address.path, array))
    return ColumnTable(request, "NumPy array", sources, held=[_array_shape(array)])


def open_npz(request: Request) -> ColumnTable:
    """Open an archive of arrays; single numbers called ``fs``, ``dt`` and the like give the sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    arrays: dict[str, Any] = {}
    with (
        request.reading("NumPy archive"),  # zipfile and numpy raise whatever the damaged bytes lead to
        open(request.address.path, "rb") as stream,
        np.load(stream, allow_pickle=False) as archive,
    ):
        for name in archive.files:
            arrays[name] = _member(archive, name)
    readable = {name: array for name, array in arrays.items() if array is not None}
    sources = without_scalars(
        [one for name, array in readable.items() for one in _array_columns(name, array)]
    )
    single = {name: array.ravel()[0] for name, array in readable.items() if array.size == 1}
    stated = {name: value for name, value in single.items() if is_clock_name(name) or isinstance(value, str)}
    held = (f"{name} ({_array_shape(array)})" for name, array in arrays.items())
    return ColumnTable(request, "NumPy archive", sources, clock=statements_in(stated), held=held)


def _member(archive: Any, name: str) -> Any:
    """Read one array; None for pickled objects, which are left out as text is."""
    try:
        return archive[name]
    except ValueError as problem:
        if "allow_pickle" in str(problem):
            return None
        raise


def _array_columns(name: str, array: Any) -> list[ColumnSource]:
    if array.dtype.names is not None and array.ndim == 1:
        return [array_source(f"{name}/{field}", array[field]) for field in _numbers_in(array.dtype)]
    return matrix_sources(name, array)


def _numbers_in(kind: Any) -> list[str]:
    return [field for field in kind.names if kind[field].kind in "fiub"]


def _file_array_columns(path: str, array: Any) -> Iterator[ColumnSource]:
    """List the columns of an array of which only the place in the file is used."""
    kind, shape = array.dtype, array.shape
    if kind.names is not None and array.ndim == 1:
        for name in _numbers_in(kind):
            yield ColumnSource(name, len(array), _stretches(path, kind, array.offset, name))
    elif kind.kind in "fiub" and array.size and array.ndim in (1, 2):
        length, width = (shape[0], 1) if array.ndim == 1 else (max(shape), min(shape))
        by_rows = width > 1 and (shape[0] >= shape[1]) == array.flags.c_contiguous
        row = np.dtype((kind, (width,)))
        for index in range(width):
            place = array.offset + index * length * kind.itemsize
            own = _stretches(path, row, array.offset, (slice(None), index)) if by_rows else None
            yield ColumnSource("", length, own or _stretches(path, kind, place, ...))


def _stretches(path: str, record: Any, offset: int, column: Any) -> Fetch:
    """Read stretches of consecutive records, in pieces; ``column`` is the index of what is wanted of them."""
    most = max(1, _PIECE // record.itemsize)

    def fetch(start: int, stop: int) -> Any:
        pieces = []
        for first in range(start, stop, most):
            count = min(most, stop - first)
            rows = np.fromfile(path, record, count, offset=offset + first * record.itemsize)
            if len(rows) < count:
                raise ValueError("it ends early")
            pieces.append(rows[column])
        return np.concatenate(pieces)

    return fetch


def _array_shape(array: Any) -> str:
    if array is None:
        return "pickled objects"
    return f"{'x'.join(map(str, array.shape)) or 'one value'}, {array.dtype}"


# --- MATLAB ------------------------------------------------------------------------------------------------


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
    trail = _struct(place, variables, request.address.group or "")
    group, sources, level = trail[-1], _columns(trail[-1]), {"": trail}
    while not sources and level:  # the shallowest structs that have any
        level = {
            f"{name}.{member}".lstrip("."): [*above, value]
            for name, above in level.items()
            for member, value in above[-1].items()
            if isinstance(value, dict)
        }
        inner = {name: found for name, above in level.items() if (found := _columns(above[-1]))}
        if len(inner) > 1:
            raise InputError(
                f"{place}: columns in {len(inner)} structs, {', '.join(inner)}: which one? "
                f"(write {request.address.path}::{next(iter(inner))})"
            )
        for name, found in inner.items():
            trail, sources = level[name], found
    for path in request.named:
        if path not in group:
            sources += _by_path(variables, path)
    objects = "__function_workspace__" in stored or any(map(_is_object, variables.values()))
    held = (f"{name} ({_shape(value)})" for name, value in group.items())
    clock = next((stated for level in reversed(trail) if (stated := _statements(level))), [])
    starts = [value for level in trail for name, value in level.items() if name.lower() in _START_NAMES]
    start = number_in(starts[-1]) if starts and np.ndim(starts[-1]) == 0 else None
    remedy = MATLAB_OBJECTS if objects else ""
    return ColumnTable(request, "MATLAB", sources, clock, start or 0.0, held=held, remedy=remedy)


def _struct(place: str, variables: dict[str, Any], path: str) -> list[dict[str, Any]]:
    """Go down to the struct that ``FILE::a.b`` names; returns it behind all above, the variables first."""
    trail = [variables]
    for part in filter(None, path.replace("/", ".").split(".")):
        value = trail[-1].get(part)
        if not isinstance(value, dict):
            names = ", ".join(name for name, one in trail[-1].items() if isinstance(one, dict)) or "none"
            raise InputError(f"{place}: there is no struct '{part}': the structs are: {names}")
        trail.append(value)
    return trail


def _columns(group: dict[str, Any]) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    for name, value in group.items():
        sources += _channels(name, value) if _is_channel_list(value) else _arrays(name, value)
    if _is_channel(group) and not _is_channel_list(group):  # Simulink's "structure with time"
        known = {source.label for source in sources}
        sources += [source for source in _channels("", group) if source.label not in known]
    structs = {name: one for name, one in group.items() if isinstance(one, dict)}
    single = {name: one for name, one in structs.items() if not _is_channel_list(one)}
    channels = {name: one for name, one in single.items() if np.ndim(_first(one, _VALUES)) == 1}
    if len(channels) > 1:
        sources += _with_their_times(channels)
    elif all(source.label.lower() in TIME_NAMES for source in sources) and sources:  # its signals lie below
        sources += [one for one in _below(group) if one.length == sources[0].length]
    return [with_unit(source, group.get) for source in without_scalars(sources)]


def _below(group: dict[str, Any]) -> Iterator[ColumnSource]:
    """List the columns of the structs in a struct, at any depth, by their paths."""
    for name, value in group.items():
        if isinstance(value, dict):
            for one in [*_columns(value), *_below(value)]:
                yield replace(one, label=f"{name}/{one.label}")


def _with_their_times(channels: dict[str, dict[str, Any]]) -> Iterator[ColumnSource]:
    """List structs that hold a signal each, and their times (once, where all have the same)."""
    times: dict[str, Any] = {}
    for name, value in channels.items():
        yield from _channels(name, {_LABELS[0]: name} | value)
        for key in (key for key in value if key.lower() in TIME_NAMES and np.ndim(value[key]) == 1):
            times[name] = value[key]
    first: Any = next(iter(times.values()), None)
    same = len(times) == len(channels) and all(np.array_equal(one, first) for one in times.values())
    for name in list(times)[:1] if same else times:
        yield array_source("time" if same else f"{name}/time", times[name])


def _arrays(name: str, value: Any) -> list[ColumnSource]:
    return matrix_sources(name, value) if isinstance(value, np.ndarray) else []


def _is_channel(value: Any) -> bool:
    return isinstance(value, dict) and _first(value, _VALUES) is not None


def _is_channel_list(value: Any) -> bool:
    """Recognise an array of structs with a name and values each (dSPACE's Y, Simulink's signals)."""
    items = value if isinstance(value, list | np.ndarray) else [value]
    structs = isinstance(items, list) or items.dtype == object
    return structs and len(items) > 0 and all(_is_channel(one) and _first(one, _LABELS) for one in items)


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
    plain = {name: one for name, one in level.items() if not isinstance(one, dict | list)}
    return statements_in({name: one for name, one in plain.items() if np.size(one) == 1})


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


# --- netCDF ------------------------------------------------------------------------------------------------


def open_netcdf(request: Request) -> ColumnTable:
    """Open a classic netCDF file: its one-dimensional variables, scaled by the conventions.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    from scipy.io import netcdf_file

    # Without a map everything is read here; scipy raises whatever the damaged bytes lead to.
    with request.reading("netCDF"), netcdf_file(request.address.path, "r", mmap=False) as file:
        variables = dict(file.variables)
        vectors = [(name, one) for name, one in variables.items() if len(one.shape) == 1]
        sources = [_variable(clean_text(name), one) for name, one in vectors if one.data.dtype.kind in "fiu"]
        clock = statements_in(file._attributes)
        for name, variable in variables.items():
            if not variable.shape:
                clock += read_statements(name, variable.data, variable._attributes.get("units"))
    held = (f"{name} {variable.shape}" for name, variable in variables.items())
    return ColumnTable(request, "netCDF", sources, clock=clock, held=held)


def _variable(label: str, variable: Any) -> ColumnSource:
    data, attributes = variable.data, variable._attributes
    unit = clean_text(attributes["units"]) if "units" in attributes else None
    source = replace(array_source(label, data, unit), clock=tuple(statements_in(attributes)))
    unsigned = clean_text(attributes.get("_Unsigned", "")).lower() == "true"
    filled = data.dtype.kind == "f"
    return unpacked(source, lambda name: number_in(attributes.get(name)), unsigned, filled)
