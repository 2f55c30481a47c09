"""Binary files as tables of columns, HDF5 aside: each is read by the library that knows its format.

NumPy reads its own files (pickled objects are never loaded), scipy MATLAB's before
version 7.3 and netCDF 3 (newer ones are HDF5), polars Parquet and Feather, optional
libraries workbooks, LabVIEW's TDMS and universal files. A workbook's sheet is turned
into tab-separated text and read as text is: header, line of units, dates and bad cells
follow the same rules, and the line numbers of messages are the sheet's row numbers.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from dbo_cli.errors import InputError, clean_text
from dbo_cli.logs.clock import Statement, is_clock_name, read_statements
from dbo_cli.logs.column_table import (
    MATLAB_OBJECTS,
    ColumnSource,
    ColumnTable,
    Fetch,
    array_source,
    from_first_row,
    matrix_sources,
    number_in,
    statements_in,
    unpacked,
    with_unit,
    without_scalars,
)
from dbo_cli.logs.columns import TIME_NAMES
from dbo_cli.logs.request import Request, host, import_extra, import_polars
from dbo_cli.logs.text.lines import is_number
from dbo_cli.logs.text.text_table import TextTable

# bytes read at once: a matrix is read by whole rows, whatever its width
_PIECE = 1 << 23
# What the exports of PicoScope (Tstart), Simulink (values, label) and dSPACE (X, Y,
# Data, Unit) call these.
_START_NAMES = ("tstart", "t0", "x0")
_LABELS = ("Name", "name", "label", "Label", "title")
_VALUES = ("Data", "data", "values", "value", "Values", "Y")
_UNIT_NAMES = ("Unit", "unit", "Units", "units")


# --- NumPy ---


def open_npy(request: Request) -> ColumnTable:
    """Open an array: fields of a structured array, or a matrix's columns (by number), read in blocks.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    with request.reading("NumPy file"):
        try:
            # Mapped for its header alone: reading a map of a file that is cut meanwhile
            # ends the process.
            array = np.load(request.address.path, mmap_mode="r", allow_pickle=False)
        except ValueError as problem:
            if any(
                word in str(problem)
                for word in ("allow_pickle", "Object arrays", "Python objects")
            ):
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
        request.reading(
            "NumPy archive"
        ),  # zipfile and numpy raise whatever the damaged bytes lead to
        open(request.address.path, "rb") as stream,
        np.load(stream, allow_pickle=False) as archive,
    ):
        for name in archive.files:
            try:
                arrays[name] = archive[name]
            except ValueError as problem:
                if "allow_pickle" not in str(problem):
                    raise
                arrays[name] = None  # pickled objects are left out, as text is
    readable = {name: array for name, array in arrays.items() if array is not None}
    sources = without_scalars(
        [
            source
            for name, array in readable.items()
            for source in _array_columns(name, array)
        ]
    )
    single = {
        name: array.ravel()[0] for name, array in readable.items() if array.size == 1
    }
    stated = {
        name: value
        for name, value in single.items()
        if is_clock_name(name) or isinstance(value, str)
    }
    listed = (f"{name} ({_array_shape(array)})" for name, array in arrays.items())
    return ColumnTable(
        request, "NumPy archive", sources, clock=statements_in(stated), held=listed
    )


def _array_columns(name: str, array: Any) -> list[ColumnSource]:
    if array.dtype.names is not None and array.ndim == 1:
        return [
            array_source(f"{name}/{field}", array[field])
            for field in _numbers_in(array.dtype)
        ]
    return matrix_sources(name, array)


def _numbers_in(kind: Any) -> list[str]:
    return [field for field in kind.names if kind[field].kind in "fiub"]


def _file_array_columns(path: str, array: Any) -> Iterator[ColumnSource]:
    """List the columns of an array of which only the place in the file is used."""
    kind, shape = array.dtype, array.shape
    if kind.names is not None and array.ndim == 1:
        for name in _numbers_in(kind):
            yield ColumnSource(
                name, len(array), _records(path, kind, array.offset, name)
            )
    elif kind.kind in "fiub" and array.size and array.ndim in (1, 2):
        length, width = (shape[0], 1) if array.ndim == 1 else (max(shape), min(shape))
        by_rows = width > 1 and (shape[0] >= shape[1]) == array.flags.c_contiguous
        row = np.dtype((kind, (width,)))
        for index in range(width):
            place = array.offset + index * length * kind.itemsize
            column = (
                _records(path, row, array.offset, (slice(None), index))
                if by_rows
                else None
            )
            yield ColumnSource("", length, column or _records(path, kind, place, ...))


def _records(path: str, record: Any, offset: int, column: Any) -> Fetch:
    """Read stretches of consecutive records, in pieces; ``column`` is the index of what is wanted of them."""
    most = max(1, _PIECE // record.itemsize)

    def fetch(start: int, stop: int) -> Any:
        pieces = []
        for first in range(start, stop, most):
            count = min(most, stop - first)
            rows = np.fromfile(
                path, record, count, offset=offset + first * record.itemsize
            )
            if len(rows) < count:
                raise ValueError("it ends early")
            pieces.append(rows[column])
        return np.concatenate(pieces)

    return fetch


def _array_shape(array: Any) -> str:
    if array is None:
        return "pickled objects"
    return f"{'x'.join(map(str, array.shape)) or 'one value'}, {array.dtype}"


# --- MATLAB ---


def open_matlab(request: Request) -> ColumnTable:
    """Open a MATLAB file: vectors, columns of matrices, fields of structs (one struct, or ``FILE::struct``).

    Single values called ``fs``, ``Ts``, ``dt``, ``Tinterval`` and the like give the
    sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    import scipy.io

    place = request.place
    # scipy raises whatever the damaged bytes lead to
    with request.reading("MATLAB file"):
        try:
            stored = scipy.io.loadmat(request.address.path, simplify_cells=True)
        except (IndexError, EOFError):
            raise ValueError("it ends early") from None
    variables = {
        name: value for name, value in stored.items() if not name.startswith("__")
    }
    trail = _struct(place, variables, request.address.group or "")
    group, sources, level = trail[-1], _matlab_columns(trail[-1]), {"": trail}
    while not sources and level:  # the shallowest structs that have any
        level = {
            f"{name}.{member}".lstrip("."): [*above, value]
            for name, above in level.items()
            for member, value in above[-1].items()
            if isinstance(value, dict)
        }
        inner = {name: _matlab_columns(above[-1]) for name, above in level.items()}
        inner = {name: columns for name, columns in inner.items() if columns}
        if len(inner) > 1:
            raise InputError(
                f"{place}: columns in {len(inner)} structs, {', '.join(inner)}: which one? "
                f"(write {request.address.path}::{next(iter(inner))})"
            )
        for name, columns in inner.items():
            trail, sources = level[name], columns
    for path in request.named:
        if path not in group:
            sources += _by_path(variables, path)
    objects = "__function_workspace__" in stored or any(
        map(_is_object, variables.values())
    )
    listed = (f"{name} ({_shape(value)})" for name, value in group.items())
    clock = next(
        (stated for level in reversed(trail) if (stated := _statements(level))), []
    )
    starts = [
        value
        for level in trail
        for name, value in level.items()
        if name.lower() in _START_NAMES
    ]
    start = number_in(starts[-1]) if starts and np.ndim(starts[-1]) == 0 else None
    remedy = MATLAB_OBJECTS if objects else ""
    return ColumnTable(
        request, "MATLAB", sources, clock, start or 0.0, held=listed, remedy=remedy
    )


def _struct(place: str, variables: dict[str, Any], path: str) -> list[dict[str, Any]]:
    """Go down to the struct that ``FILE::a.b`` names; returns it behind all above, the variables first."""
    trail = [variables]
    for part in filter(None, path.replace("/", ".").split(".")):
        value = trail[-1].get(part)
        if not isinstance(value, dict):
            names = (
                ", ".join(
                    name for name, value in trail[-1].items() if isinstance(value, dict)
                )
                or "none"
            )
            raise InputError(
                f"{place}: there is no struct '{part}': the structs are: {names}"
            )
        trail.append(value)
    return trail


def _matlab_columns(group: dict[str, Any]) -> list[ColumnSource]:
    sources: list[ColumnSource] = []
    for name, value in group.items():
        sources += (
            _channels(name, value) if _is_channel_list(value) else _arrays(name, value)
        )
    # Simulink's "structure with time"
    if _is_channel(group) and not _is_channel_list(group):
        known = {source.label for source in sources}
        sources += [
            source for source in _channels("", group) if source.label not in known
        ]
    structs = {name: value for name, value in group.items() if isinstance(value, dict)}
    single = {
        name: struct for name, struct in structs.items() if not _is_channel_list(struct)
    }
    channels = {
        name: struct
        for name, struct in single.items()
        if np.ndim(_first(struct, _VALUES)) == 1
    }
    if len(channels) > 1:
        sources += _with_their_times(channels)
    # its signals lie below
    elif all(source.label.lower() in TIME_NAMES for source in sources) and sources:
        sources += [
            source for source in _below(group) if source.length == sources[0].length
        ]
    return [with_unit(source, group.get) for source in without_scalars(sources)]


def _below(group: dict[str, Any]) -> Iterator[ColumnSource]:
    """List the columns of the structs in a struct, at any depth, by their paths."""
    for name, value in group.items():
        if isinstance(value, dict):
            for source in [*_matlab_columns(value), *_below(value)]:
                yield replace(source, label=f"{name}/{source.label}")


def _with_their_times(channels: dict[str, dict[str, Any]]) -> Iterator[ColumnSource]:
    """List structs that hold a signal each, and their times (once, where all have the same)."""
    times: dict[str, Any] = {}
    for name, value in channels.items():
        yield from _channels(name, {_LABELS[0]: name} | value)
        for key in (
            key
            for key in value
            if key.lower() in TIME_NAMES and np.ndim(value[key]) == 1
        ):
            times[name] = value[key]
    first: Any = next(iter(times.values()), None)
    same = len(times) == len(channels) and all(
        np.array_equal(time, first) for time in times.values()
    )
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
    return (
        structs
        and len(items) > 0
        and all(_is_channel(item) and _label(item) for item in items)
    )


def _channels(name: str, value: Any) -> Iterator[ColumnSource]:
    for number, channel in enumerate(
        value if isinstance(value, list | np.ndarray) else [value], start=1
    ):
        label = (_label(channel) or str(name or number)).strip('"')
        unit = _first(channel, _UNIT_NAMES)
        for source in _arrays(label, np.atleast_1d(_first(channel, _VALUES))):
            yield replace(source, unit=unit if isinstance(unit, str) and unit else None)


def _label(struct: dict[str, Any]) -> str:
    label = _first(struct, _LABELS)
    return str(label or "") if np.ndim(label) == 0 else ""


def _first(struct: dict[str, Any], names: Sequence[str]) -> Any:
    return next((struct[name] for name in names if name in struct), None)


def _by_path(variables: dict[str, Any], path: str) -> list[ColumnSource]:
    """Find what the user named by a path through structs (``run.voltage``)."""
    value: Any = variables
    for part in path.replace("/", ".").split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return _arrays(path, value)


def _statements(level: Mapping[str, Any]) -> list[Statement]:
    plain = {
        name: value
        for name, value in level.items()
        if not isinstance(value, dict | list)
    }
    return statements_in(
        {name: value for name, value in plain.items() if np.size(value) == 1}
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


# --- netCDF ---


def open_netcdf(request: Request) -> ColumnTable:
    """Open a classic netCDF file: its one-dimensional variables, scaled by the conventions.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    from scipy.io import netcdf_file

    # Without a map everything is read here; scipy raises whatever the damaged bytes
    # lead to.
    with (
        request.reading("netCDF"),
        netcdf_file(request.address.path, "r", mmap=False) as file,
    ):
        variables = dict(file.variables)
        vectors = [
            (name, variable)
            for name, variable in variables.items()
            if len(variable.shape) == 1
        ]
        sources = [
            _variable(clean_text(name), variable)
            for name, variable in vectors
            if variable.data.dtype.kind in "fiu"
        ]
        clock = statements_in(file._attributes)
        for name, variable in variables.items():
            if not variable.shape:
                clock += read_statements(
                    name, variable.data, variable._attributes.get("units")
                )
    listed = (f"{name} {variable.shape}" for name, variable in variables.items())
    return ColumnTable(request, "netCDF", sources, clock=clock, held=listed)


def _variable(label: str, variable: Any) -> ColumnSource:
    data, attributes = variable.data, variable._attributes
    unit = clean_text(attributes["units"]) if "units" in attributes else None
    source = replace(
        array_source(label, data, unit), clock=tuple(statements_in(attributes))
    )
    unsigned = clean_text(attributes.get("_Unsigned", "")).lower() == "true"
    filled = data.dtype.kind == "f"
    return unpacked(
        source, lambda name: number_in(attributes.get(name)), unsigned, filled
    )


# --- Parquet and Feather (Arrow), read in blocks with polars ---

# read at once: a row group is decoded whole, and pandas writes a million rows into one
_ROWS = 1 << 20
_INDEX = "__index_level_0__"  # what pandas calls an index without a name


def open_parquet(request: Request) -> ColumnTable:
    """Open a Parquet file.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    return _open_arrow(request, "Parquet", import_polars().scan_parquet)


def open_feather(request: Request) -> ColumnTable:
    """Open a Feather (Arrow) file; see :func:`open_parquet`."""
    return _open_arrow(request, "Feather", import_polars().scan_ipc)


def open_old_feather(request: Request) -> ColumnTable:
    """Refuse the first version of Feather, which nothing at hand reads (InputError)."""
    raise InputError(
        f"{request.place}: Feather version 1 is not read: write it again with version 2, or as Parquet"
    )


def _open_arrow(request: Request, kind: str, scan: Callable[..., Any]) -> ColumnTable:
    polars = import_polars()
    damaged = (
        polars.exceptions.PolarsError,
        polars.exceptions.PanicException,
        OSError,
        ValueError,
    )
    with request.reading(kind, damaged), host().contained(request.place, kind):
        metadata = _parquet_metadata(request.address.path) if kind == "Parquet" else {}
        frame = scan(request.address.path)
        schema = frame.collect_schema()
        length = int(frame.select(polars.len()).collect().item())
    attributes = _pandas_attributes(metadata)
    units = attributes.get("units")
    sources = []
    for name, stored in schema.items():
        source = _arrow_column(
            ColumnSource(name, length, _arrow_rows(request, kind, frame, name)), stored
        )
        if source is not None:
            unit = units.get(name) if isinstance(units, dict) else None
            sources.append(
                replace(source, unit=source.unit or (str(unit) if unit else None))
            )
    clock = statements_in(metadata) + statements_in(attributes)
    listed = (f"{name} ({stored})" for name, stored in schema.items())
    return ColumnTable(
        request, kind, sources, clock=clock, damaged=damaged, held=listed
    )


def _arrow_rows(
    request: Request, kind: str, frame: Any, name: str
) -> Callable[[int, int], Any]:
    """Read rows of a column as an array, nulls as NaN; the last stretch is kept for the next rows."""

    @lru_cache(maxsize=1)
    def stretch(base: int) -> Any:
        polars = import_polars()
        column, stored = polars.col(name), frame.collect_schema()[name]
        physical = (
            column.to_physical()
            if stored.is_temporal()
            else column.cast(polars.Float64)
        )
        with host().contained(request.place, kind):
            return (
                frame.slice(base, _ROWS)
                .select(physical)
                .collect()
                .to_series()
                .to_numpy()
            )

    def fetch(start: int, stop: int) -> Any:
        bases = range(start // _ROWS * _ROWS, stop, _ROWS)
        values = np.concatenate(
            [stretch(base)[max(0, start - base) : stop - base] for base in bases]
        )
        if len(values) < stop - start:
            raise ValueError(f"column '{name}' ends early")
        return values

    return fetch


def _arrow_column(source: ColumnSource, stored: Any) -> ColumnSource | None:
    """Return a column of numbers as it is, one of dates in seconds; None for any other, and row numbers."""
    index = source.label == _INDEX
    if stored.is_numeric() or str(stored) == "Boolean":
        return None if index and stored.is_integer() else source
    unit = getattr(stored, "time_unit", None)
    if unit is None or not source.length:
        return None
    return from_first_row(replace(source, label="time") if index else source, unit)


def _parquet_metadata(path: str) -> dict[str, str]:
    polars = import_polars()
    # newer than the oldest polars that is supported
    read = getattr(polars, "read_parquet_metadata", None)
    try:
        return (
            {str(key): str(value) for key, value in read(path).items()}
            if read is not None
            else {}
        )
    except (Exception, polars.exceptions.PanicException):
        return {}  # a damaged file is complained about when its columns are looked up


def _pandas_attributes(metadata: dict[str, str]) -> dict[str, Any]:
    """Give ``DataFrame.attrs`` as pandas stores them: ``units`` by column, a rate."""
    try:
        attributes = json.loads(metadata.get("PANDAS_ATTRS", "{}"))
    except (ValueError, RecursionError):
        return {}
    return attributes if isinstance(attributes, dict) else {}


# --- Excel workbooks and OpenDocument sheets, read with fastexcel ---

# rows that tell whether a sheet holds a table; instruments' headers are shorter
_LOOKED_AT = 200
# As fastexcel writes dates in its column of texts.
_DATE = r"^\d{4}-\d\d-\d\d"
_DAY_ZERO = r"^1899-12-3[01] "  # before a time of day without a date


def open_excel(request: Request) -> TextTable:
    """Open a workbook's only sheet with numbers, or the one that ``FILE::SHEET`` names.

    Raises
    ------
    InputError
        fastexcel is not installed, the workbook is damaged, or which sheet is meant is
        not clear.
    """
    place = request.place
    fastexcel = import_extra("fastexcel", place)
    # BaseException: whatever the damaged bytes lead to; a panic is no Exception
    with (
        request.reading("workbook", (BaseException,)),
        host().contained(place, "workbook"),
    ):
        book = fastexcel.read_excel(request.address.path)
        content = _sheet_as_text(book, _sheet(request, book))
    plain = replace(request.options, delimiter="tab", encoding=None)
    return TextTable(replace(request, options=plain, content=content))


def _wanted_part(request: Request) -> str:
    """Return the sheet or group that stands behind ``::``."""
    return (request.address.group or "").strip("/")


def _sheet(request: Request, book: Any) -> str:
    place, wanted = request.place, _wanted_part(request)
    names = [str(name) for name in book.sheet_names]
    sheets = names if wanted else [name for name in names if _has_numbers(book, name)]
    listed = ", ".join(f"'{name}'" for name in sheets)
    if wanted and wanted not in names:
        raise InputError(
            f"{place}: there is no sheet '{wanted}': the sheets are: {listed}"
        )
    if not sheets:
        raise InputError(f"{place}: no sheet holds rows of numbers")
    if not wanted and len(sheets) > 1:
        example = f"{request.address.path}::{sheets[0]}"
        raise InputError(
            f"{place}: {len(sheets)} sheets hold numbers, {listed}: which one? (write {example})"
        )
    return wanted or sheets[0]


def _has_numbers(book: Any, name: str) -> bool:
    sheet = book.load_sheet(
        name, header_row=None, skip_rows=0, n_rows=_LOOKED_AT, dtypes="string"
    )
    rows = sheet.to_polars().rows() if sheet.width else []
    return any(
        sum(is_number(cell, ".") for cell in row if cell) >= min(2, sheet.width)
        for row in rows
    )


def _sheet_as_text(book: Any, name: str) -> bytes:
    """Write a sheet as tab-separated text, its numbers with all their digits."""
    polars = import_polars()
    shown = book.load_sheet(
        name, header_row=None, skip_rows=0, dtypes="string"
    ).to_polars()
    exact = book.load_sheet(
        name, header_row=None, skip_rows=0, dtypes="float"
    ).to_polars()
    if shown.shape != exact.shape:
        raise ValueError("the sheet cannot be read twice alike")
    columns = []
    for text, number in zip(shown.get_columns(), exact.get_columns(), strict=True):
        frame = polars.DataFrame({"text": text, "number": number})
        usable = polars.col("number").is_not_null() & ~polars.col("text").str.contains(
            _DATE
        )
        plain = (
            polars.col("text")
            .str.replace_all(r"[\t\r\n]", " ")
            .str.replace(_DAY_ZERO, "")
        )
        cells = (
            polars.when(usable)
            .then(polars.col("number").cast(polars.String))
            .otherwise(plain)
        )
        columns.append(frame.select(cells.alias("cell")).to_series().rename(text.name))
    table = polars.DataFrame(columns)
    written: str = table.write_csv(
        include_header=False, separator="\t", null_value="", quote_style="never"
    )
    return written.encode("utf-8")


# --- LabVIEW's TDMS, read in blocks with npTDMS ---


def open_tdms(request: Request) -> ColumnTable:
    """Open a TDMS file; the channels of several groups are called ``group/channel``.

    Raises
    ------
    InputError
        npTDMS is not installed, the file is damaged, or holds no channels of numbers.
    """
    nptdms = import_extra("nptdms", request.place)
    with contextlib.ExitStack() as opened:
        # A stream of its own: npTDMS leaves a damaged file open.
        stream = opened.enter_context(open(request.address.path, "rb"))
        # npTDMS raises whatever the damaged bytes lead to
        with request.reading("TDMS"):
            file = nptdms.TdmsFile.open(stream)
        all_groups, wanted = list(file.groups()), _wanted_part(request)
        groups = [group for group in all_groups if wanted in ("", group.name)]
        if wanted and not groups:
            names = ", ".join(f"'{group.name}'" for group in all_groups) or "none"
            raise InputError(
                f"{request.place}: there is no group '{wanted}': the groups are: {names}"
            )
        channels = [
            (group, channel) for group in groups for channel in group.channels()
        ]
        numeric = [
            (group, channel)
            for group, channel in channels
            if len(channel) > 0 and channel.dtype.kind in "fiubM"
        ]
        several = len({group.name for group, _ in numeric}) > 1
        sources = [
            _tdms_column(group if several else None, channel)
            for group, channel in numeric
        ]
        if not sources:
            listed = (
                ", ".join(f"{group.name}/{channel.name}" for group, channel in channels)
                or "nothing"
            )
            raise InputError(
                f"{request.place}: no channels of numbers: it holds {listed}"
            )
        levels = [*(groups if len(groups) == 1 else ()), file]
        clock = next(
            (statements for level in levels if (statements := _tdms_statements(level))),
            [],
        )
        close = opened.pop_all().close
    return ColumnTable(
        request, "TDMS", sources, clock=clock, at_close=close, damaged=(Exception,)
    )


def _tdms_column(group: Any, channel: Any) -> ColumnSource:
    label = clean_text(channel.name)
    label = label if group is None else f"{clean_text(group.name)}/{label}"
    properties = channel.properties
    unit = (
        clean_text(
            properties.get("unit_string") or properties.get("NI_UnitDescription") or ""
        )
        or None
    )
    if channel.dtype.kind == "M":
        stamps = channel[:]
        return array_source(
            label,
            (stamps - stamps[0]).astype("timedelta64[us]").astype("int64") / 1e6,
            "s",
        )
    offset = properties.get("wf_start_offset", 0.0)  # LabVIEW defines it in seconds
    offset = float(offset) if isinstance(offset, int | float) else 0.0
    source = ColumnSource(
        label, len(channel), lambda start, stop: channel[start:stop], unit
    )
    return replace(source, clock=tuple(_tdms_statements(channel)), start=offset)


def _tdms_statements(node: Any) -> list[Statement]:
    properties = node.properties
    if clean_text(properties.get("wf_xname") or "Time").strip().lower() not in (
        "time",
        "zeit",
        "temps",
        "",
    ):
        return []  # a spectrum: its increment is no time
    statements = []
    for name, value in properties.items():
        is_increment = name == "wf_increment"  # LabVIEW defines it in seconds
        unit = properties.get("wf_xunit_string" if is_increment else f"{name}_unit")
        statements += read_statements(name, value, unit or None, sure=is_increment)
    return statements


# --- universal files (UFF, UNV) of modal analysis: data sets 58, read with pyuff ---

# of the dataset's definition: the kind of its abscissa, and its spacing
_TIME, _UNEVEN = 17, 0


def open_uff(request: Request) -> ColumnTable:
    """Open a universal file: one column for each function of time.

    Raises
    ------
    InputError
        pyuff is not installed, the file is damaged, or holds no functions of time.
    """
    pyuff = import_extra("pyuff", request.place)
    with request.reading("UFF"):  # pyuff raises whatever the damaged text leads to
        content = pyuff.UFF(request.address.path).read_sets()
        sets = content if isinstance(content, list) else [content]
        functions = [
            data_set
            for data_set in sets
            if data_set["type"] == 58 and data_set["abscissa_spec_data_type"] == _TIME
        ]
        sources: list[ColumnSource] = []
        for data_set in functions:
            sources += _function_columns(data_set, {source.label for source in sources})
    listed = (f"data set {data_set['type']}" for data_set in sets)
    return ColumnTable(
        request, "UFF", sources, held=listed, remedy=" (functions of time, 58)"
    )


def _function_columns(data_set: dict[str, Any], taken: set[str]) -> list[ColumnSource]:
    """Make a column of a function; its stamps become another where they are not evenly spaced."""
    names = (clean_text(data_set[key]).strip() for key in ("id1", "ordinate_axis_lab"))
    name = next((name for name in names if name not in ("", "NONE")), "")
    name = f"{name} {data_set['rsp_node']}" if name in taken or not name else name
    unit = clean_text(data_set["ordinate_axis_units_lab"]).strip()
    values, step = np.asarray(data_set["data"]), float(data_set["abscissa_inc"])
    if values.dtype.kind != "f":
        return []
    source = array_source(name, values, None if unit in ("", "NONE") else unit)
    if data_set["abscissa_spacing"] == _UNEVEN or not step > 0.0:
        return [array_source("time", np.asarray(data_set["x"]), "s"), source][
            ("time" in taken) :
        ]
    clock = (Statement(f"'abscissa_inc' {step:g} s", 1.0 / step),)
    return [replace(source, clock=clock, start=float(data_set["abscissa_min"]))]
