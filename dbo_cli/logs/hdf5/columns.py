"""One HDF5 dataset as columns: names, units, scales, missing values and rates from its attributes.

Then, as programs for experiments arrange them: PyMoDAQ's tree of data and axes,
Labber's channels and traces (written after the files that ``pymodaq_data`` writes, and
after public readers of Labber's log files), the tables of pandas.
"""

from __future__ import annotations

import io
import json
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from dbo_cli.errors import InputError, clean_text
from dbo_cli.logs.clock import Statement, is_clock_name, read_statements
from dbo_cli.logs.column_table import (
    NETCDF_FILL,
    ColumnSource,
    Fetch,
    array_source,
    from_first_row,
    number_in,
    text_source,
    unpacked,
    without_scalars,
)

# Names in use: NeXus, CF conventions and netCDF, LabVIEW, h5py recorders; MATLAB's own
# classes of numbers.
_UNIT_ATTRIBUTES = ("units", "unit", "unit_string")
_NAME_ATTRIBUTES = (
    "columns",
    "column_names",
    "names",
    "channels",
    "channel_names",
    "labels",
    "fields",
)
_UNUSED_FACTORS = ("gain", "factor", "multiplier", "sensitivity", "calibration", "conversion",
                   "conversion_factor")  # fmt: skip
# whole numbers of 1 to 8 bytes besides
_MATLAB_NUMBERS = {"double", "single", "logical"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


# bytes of a text that may be a date and a time of day; twice what any program writes
LONGEST_STAMP = 80


def is_dataset(node: Any) -> bool:
    """Tell a dataset from a group (and from a link that leads nowhere, which is None)."""
    return hasattr(node, "shape") and hasattr(node, "attrs")


def is_group(node: Any) -> bool:
    """Tell a group."""
    return hasattr(node, "keys")


def attribute(node: Any, *names: str) -> Any:
    """Give the first attribute of these names (case aside), or None."""
    spellings = _attribute_names(node)
    for name in names:
        if name.lower() in spellings:
            return node.attrs[spellings[name.lower()]]
    return None


def _attribute_names(node: Any) -> dict[str, str]:
    return {str(name).lower(): name for name in node.attrs}


def attribute_text(node: Any, *names: str) -> str:
    """Give an attribute as text, empty where it is absent or holds no text."""
    return _only_text(attribute(node, *names))


def _only_text(value: Any) -> str:
    values = np.atleast_1d(value).ravel()
    if values.size != 1 or not isinstance(values[0], str | bytes):
        return ""
    return clean_text(values[0])


def matlab_class(node: Any) -> str:
    """Give the class of a MATLAB v7.3 variable, empty in other files."""
    return attribute_text(node, "MATLAB_class")


def columns_of(
    dataset: Any, name: str, stamps: frozenset[int] = frozenset()
) -> list[ColumnSource]:
    """Take a dataset apart into columns; the longer axis of a matrix is time, or the one that has stamps.

    Parameters
    ----------
    dataset
        Any dataset; what holds no numbers gives no columns.
    name
        What the columns are called, or empty for the dataset's own name.
    stamps
        How many time stamps stand beside the dataset: 100 frames of 128 channels are
        wider than long.
    """
    shape, kind = dataset.shape, dataset.dtype
    if shape is None or not dataset.size or not _holds_measurements(dataset):
        return []
    if kind.names is not None:
        return _fields_of(dataset, name) if len(shape) == 1 else []
    label = name or clean_text(dataset.name.rsplit("/", 1)[-1])
    if kind.kind in "SO" and len(shape) == 1 and _is_short_text(kind):
        stamps_source = text_source(label, shape[0], slicer(dataset, 0, 0))
        return [] if stamps_source is None else [stamps_source]
    if kind.kind not in "fiub" or len(shape) not in (1, 2) or 0 in shape:
        return []
    axis = _time_axis(dataset, stamps)
    sources = []
    for index, column_label in enumerate(_labels(dataset, label, axis)):
        source = ColumnSource(column_label, shape[axis], slicer(dataset, axis, index))
        sources.append(_described(source, dataset, index))
    return sources


def _labels(dataset: Any, label: str, axis: int) -> list[str]:
    """Return what the columns of a vector or a matrix are called: as an attribute says, or numbered."""
    if len(dataset.shape) == 1 or dataset.shape[1 - axis] == 1:
        return [label]
    width = dataset.shape[1 - axis]
    names = _column_names(dataset, width)
    if names is not None:
        return names
    return [f"{label}[{number}]" for number in range(1, width + 1)]


def _holds_measurements(dataset: Any) -> bool:
    """Leave out what only looks like numbers: MATLAB's text and objects, netCDF's bare dimensions."""
    if attribute_text(dataset, "NAME").startswith(
        "This is a netCDF dimension but not a netCDF variable"
    ):
        return False
    matlab = matlab_class(dataset)
    if matlab and matlab not in _MATLAB_NUMBERS:
        return False
    if matlab and attribute(dataset, "MATLAB_object_decode") is not None:
        return False
    return attribute(dataset, "MATLAB_empty") is None


def _time_axis(dataset: Any, stamps: frozenset[int]) -> int:
    shape = dataset.shape
    if len(shape) == 1:
        return 0
    if len(stamps & set(shape)) == 1 and shape[0] != shape[1]:
        return 0 if shape[0] in stamps else 1
    if shape[0] == shape[1]:
        # MATLAB stores every matrix transposed, so a square one runs the other way.
        return 1 if matlab_class(dataset) else 0
    return 0 if shape[0] > shape[1] else 1


def slicer(dataset: Any, axis: int, index: int) -> Fetch:
    """Read a vector, or column ``index`` of a matrix whose axis ``axis`` is time."""
    if len(dataset.shape) == 1:
        return lambda start, stop: dataset[start:stop]
    if axis == 0:
        return lambda start, stop: dataset[start:stop, index]
    return lambda start, stop: dataset[index, start:stop]


def _fields_of(dataset: Any, name: str) -> list[ColumnSource]:
    fields = []
    for number, field in enumerate(dataset.dtype.names):
        label = f"{name}/{clean_text(field)}" if name else clean_text(field)
        fields += [
            _described(source, dataset, number)
            for source in field_sources(dataset, field, label, None)
        ]
    return fields


def field_sources(
    dataset: Any, field: str, label: str, names: list[str] | None
) -> list[ColumnSource]:
    """Make a column of a field of a compound dataset, or one of each place (``names``) of an array in it."""
    kind, length = dataset.dtype[field], dataset.shape[0]
    if kind.subdtype is not None and len(kind.shape) == 1 and kind.base.kind in "fiub":
        width = kind.shape[0]
        if names is None or len(names) != width:
            names = [f"{label}[{number}]" for number in range(1, width + 1)]
        return [
            ColumnSource(
                column_label, length, _field(dataset, field, (slice(None), index))
            )
            for index, column_label in enumerate(names)
        ]
    if kind.kind in "SO" and _is_short_text(kind):
        stamps_source = text_source(label, length, _field(dataset, field, ...))
        return [] if stamps_source is None else [stamps_source]
    if kind.kind in "fiub":
        return [ColumnSource(label, length, _field(dataset, field, ...))]
    return []


def _is_short_text(kind: Any) -> bool:
    """Tell whether a dataset or a field holds texts that may be time stamps."""
    text = h5py.check_string_dtype(kind)
    return text is not None and (text.length is None or text.length <= LONGEST_STAMP)


def _field(dataset: Any, field: str, place: Any) -> Fetch:
    return lambda start, stop: dataset[start:stop][field][place]


def _column_names(dataset: Any, width: int) -> list[str] | None:
    value = attribute(dataset, *_NAME_ATTRIBUTES)
    if value is None:
        return None
    names = [clean_text(name) for name in np.atleast_1d(value).ravel()]
    if len(names) == 1:
        names = [name.strip() for name in names[0].split(",")]
    return names if len(names) == width else None


def _described(source: ColumnSource, dataset: Any, index: int) -> ColumnSource:
    """Add what the attributes state: unit, scale, missing values, rate."""
    scaled = _scaled(source, dataset, index)
    return replace(
        scaled,
        unit=_unit_of(dataset, index) or None,
        clock=tuple(statements_of(dataset)),
    )


def _unit_of(dataset: Any, index: int) -> str:
    """Give the unit of column ``index``; a list of units belongs to the columns in order."""
    value = attribute(dataset, *_UNIT_ATTRIBUTES)
    if value is None or type(value).__name__ == "Empty":
        return ""
    units = [clean_text(text) for text in np.atleast_1d(value).ravel()]
    if len(units) == 1 and "," in units[0]:
        units = units[0].split(",")
    if len(units) == 1:
        return units[0]
    return units[index] if index < len(units) else ""


def _scaled(source: ColumnSource, dataset: Any, index: int) -> ColumnSource:
    """Apply netCDF's conventions and a plain ``scale``; note what looks like a factor and is not used."""
    spellings = _attribute_names(dataset)

    def number(name: str) -> float | None:
        return number_in(dataset.attrs.get(spellings.get(name.lower(), "")), index)

    unsigned = attribute_text(dataset, "_Unsigned").lower() == "true"
    filled = dataset.dtype.kind == "f" and dataset.fillvalue == NETCDF_FILL
    source = unpacked(source, number, unsigned, filled)
    if source.problem:
        return source
    remarks = []
    shift = number("offset")
    scale = number("scale")
    if scale is None:
        scale = number("scaling_factor")
    if scale is not None and scale not in (0.0, 1.0) and number("scale_factor") is None:
        if shift:
            text = (
                f"column '{source.label}' has the attributes scale {scale:g} and offset {shift:g}, and "
                "nothing says in which order they apply (write scale_factor and add_offset, which mean "
                "value · scale_factor + add_offset)"
            )
            return replace(source, problem=text)
        source = replace(source, scale=scale)
        remarks.append(
            f"column '{source.label}' is multiplied by its attribute scale, {scale:g}"
        )
    elif shift and number("add_offset") is None:
        remarks.append(
            f"column '{source.label}' has an attribute offset, {shift:g}, which is not applied"
        )
    for name in _UNUSED_FACTORS:
        value = number(name)
        if value is not None and value != 1.0:
            unused = f"an attribute {name}, {value:g}, which is not applied"
            remarks.append(f"column '{source.label}' has {unused}")
    return replace(source, remarks=tuple(remarks))


def statements_of(node: Any) -> Iterator[Statement]:
    """Read what the attributes of a dataset or group state of the sample rate."""
    for name in map(clean_text, node.attrs):
        if is_clock_name(name):
            unit = attribute(node, f"{name}_units", f"{name}_unit")
            yield from read_statements(name, attribute(node, name), unit)


def scalar_statements(group: Any) -> Iterator[Statement]:
    """Read what single values in a group (``fs``, ``Ts``) state of the sample rate."""
    for name in group:
        if is_clock_name(clean_text(name)):
            node = group.get(name)
            if (
                is_dataset(node)
                and node.size == 1
                and (node.dtype.kind in "fiu" or node.dtype.kind == "O")
            ):
                yield from read_statements(
                    clean_text(name), node[()], _unit_of(node, 0) or None
                )


def stored_text(dataset: Any) -> str:
    """Read a short text: a string, or MATLAB's array of character codes."""
    if not is_dataset(dataset) or dataset.size is None or not 0 < dataset.size <= 100:
        return ""
    if matlab_class(dataset) == "char":
        return "".join(chr(int(code)) for code in np.ravel(dataset[()]))
    return _only_text(dataset[()])


# --- programs for experiments ---

# what PyMoDAQ calls arrays, beside logs and errors
_SIGNALS = ("axis", "data", "data_enlargeable")
# levels of PyMoDAQ's tree, which has six:
# RawData/Scan000/Detector000/Data0D/CH00/EnlData00
_DEEPEST = 8


def program_columns(group: Any) -> list[ColumnSource]:
    """List the columns of a group of pandas' or PyMoDAQ's, or of Labber's file; none of any other."""
    if "pandas_type" in group.attrs:
        return _pandas_columns(group)
    if all(name in group for name in ("Channels", "Log list", "Data")):
        return list(_labber_traces(group)) or list(_labber_steps(group))
    if "pymodaq_version" in group.file.attrs:
        return without_scalars(list(_pymodaq(group)))
    return []


def _pymodaq(group: Any, depth: int = 0) -> Iterator[ColumnSource]:
    """Put all data and axes below a group side by side, under their labels.

    Raises
    ------
    InputError
        There are several scans.
    """
    scans = [str(name) for name in group if re.fullmatch(r"Scan\d+", str(name))]
    if len(scans) > 1:
        path = f"{clean_text(group.file.filename)}::{clean_text(group.name).rstrip('/')}/{scans[0]}"
        raise InputError(
            f"{path.partition('::')[0]}: {len(scans)} scans: which one? (write {path})"
        )
    for name in group:
        node = group.get(name)
        if is_group(node) and depth < _DEEPEST:
            yield from _pymodaq(node, depth + 1)
        elif is_dataset(node) and _stated(node, "data_type") in _SIGNALS:
            for source in columns_of(node, _stated(node, "label") or clean_text(name)):
                yield replace(source, unit=_stated(node, "units") or None)


def _stated(node: Any, name: str) -> str:
    """Read a text attribute, also as a newer PyMoDAQ writes it: JSON with the text quoted as in Python."""
    text = attribute_text(node, name)
    try:
        return str(json.loads(text)["data"]).strip("'\"")
    except (ValueError, TypeError, KeyError, RecursionError):
        return text


def _labber_units(group: Any) -> dict[str, str]:
    rows = group["Channels"][()]
    return {clean_text(row["name"]): clean_text(row["unitPhys"]) for row in rows}


def _labber_steps(group: Any) -> Iterator[ColumnSource]:
    """Read values by step: points, channels, entries; the entries follow each other."""
    units = _labber_units(group)
    data = group["Data/Data"][()]
    for index, row in enumerate(group["Data/Channel names"][()]):
        name = clean_text(row["name"])
        if not clean_text(row["info"]):  # else a part of a complex number
            yield array_source(
                name, data[:, index, :].T.ravel(), units.get(name) or None
            )


def _labber_traces(group: Any) -> Iterator[ColumnSource]:
    """Read the traces of a log with one entry: values, and ``NAME_t0dt`` with the step along them."""
    units = _labber_units(group)
    traces = group.get("Traces", {})
    for name in traces:
        if f"{name}_t0dt" not in traces:
            continue
        values = np.asarray(traces[name][()])
        if values.ndim != 3 or values.shape[1:] != (1, 1):
            continue
        unit = units.get(clean_text(name)) or None
        source = array_source(clean_text(name), values[:, 0, 0], unit)
        start, step = np.ravel(traces[f"{name}_t0dt"][()])[:2].astype(float).tolist()
        clock: tuple[Statement, ...] = ()
        if attribute_text(traces[name], "x_unit") in ("s", "") and step > 0.0:
            clock = (Statement(f"'{name}_t0dt' {step:g} s", 1.0 / step),)
        yield replace(source, clock=clock, start=start)


# --- pandas, through PyTables: tables, with data columns or not, and blocks ---


def _pandas_columns(group: Any) -> list[ColumnSource]:
    """Read what ``DataFrame.to_hdf`` writes, in either of its formats."""
    kind = attribute_text(group, "pandas_type")
    if kind in ("frame_table", "appendable_frame", "series_table") and is_dataset(
        group.get("table")
    ):
        return _pandas_table(group, group["table"])
    if kind == "frame" and is_dataset(group.get("axis1")):
        return _pandas_blocks(group)
    if kind == "series" and is_dataset(group.get("values")):
        values = columns_of(group["values"], attribute_text(group, "name") or "values")
        return [*_index(group.get("index")), *values]
    return []


def _pandas_table(group: Any, table: Any) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    info = _harmless(attribute(group, "info"))
    for field in table.dtype.names:
        if field == "index":
            name = None
            if isinstance(info, dict):
                name = info.get("index", {}).get("index_name")
            for source in field_sources(table, field, clean_text(name or ""), None):
                sources += _as_index(source, attribute_text(table, "index_kind"))
            continue
        stored_names = _harmless(attribute(table, f"{field}_kind")) or ()
        names = [clean_text(name) for name in stored_names]
        kind = attribute_text(table, f"{field}_dtype")
        for source in field_sources(table, field, clean_text(field), names):
            sources.append(_from_stamps(source, kind) or source)
    return sources


def _pandas_blocks(group: Any) -> list[ColumnSource]:
    sources = _index(group["axis1"])
    order = group["axis0"][()].ravel() if is_dataset(group.get("axis0")) else ()
    by_name: dict[str, ColumnSource] = {}
    for number in range(int(np.ravel(attribute(group, "nblocks"))[0])):
        values = group.get(f"block{number}_values")
        items = group.get(f"block{number}_items")
        if not is_dataset(values) or not is_dataset(items):
            continue
        if values.dtype.kind not in "fiub" or values.ndim != 2:
            continue
        kind = attribute_text(values, "value_type")
        for index, name in enumerate(map(clean_text, items[()].ravel())):
            source = ColumnSource(name, values.shape[0], slicer(values, 0, index))
            by_name[name] = _from_stamps(source, kind) or source
    for name in map(clean_text, order):
        if name in by_name:
            sources.append(by_name[name])
    return sources


def _index(axis: Any) -> list[ColumnSource]:
    if not is_dataset(axis) or axis.dtype.kind not in "fiu" or len(axis.shape) != 1:
        return []
    name = attribute_text(axis, "name")
    label = "" if name in ("N.", "") else _unpickled_text(name)
    source = ColumnSource(label, axis.shape[0], slicer(axis, 0, 0))
    return _as_index(source, attribute_text(axis, "kind"))


def _as_index(source: ColumnSource, kind: str) -> list[ColumnSource]:
    """Keep an index that means something: a name, stamps of time, fractions; not pandas' own row numbers."""
    stamped = _from_stamps(source, kind)
    if stamped is not None:
        return [replace(stamped, label=source.label or "time")]
    if source.label or kind == "float":
        return [replace(source, label=source.label or "index")]
    return []


def _from_stamps(source: ColumnSource, kind: str) -> ColumnSource | None:
    """Turn dates (and durations) stored as counts into seconds from the first row on."""
    match = re.fullmatch(r"(?:datetime|timedelta)64(?:\[(s|ms|us|ns)(?:,.*)?\])?", kind)
    if match is None or not source.length:
        return None
    return from_first_row(source, match[1] or "ns")


class _NoCode(pickle.Unpickler):
    """Reads pickled lists, tuples, dicts, texts and numbers; anything that would run code is refused."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"{module}.{name}")


def _harmless(value: Any) -> Any:
    """Read the column names that PyTables pickles into attributes, without ever running what is in them."""
    if value is None or not isinstance(value, bytes | np.bytes_):
        return None
    try:
        return _NoCode(io.BytesIO(bytes(value))).load()
    except Exception:
        # whatever is no plain list of names: the columns then go by numbers
        return None


def _unpickled_text(name: str) -> str:
    plain = _harmless(name.encode())
    if isinstance(plain, str):
        return clean_text(plain)
    return "" if plain is None and name.endswith(".") else name
