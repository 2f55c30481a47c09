"""Files that a library of their own reads: Parquet and Feather, workbooks, LabVIEW's TDMS, universal files.

A workbook's sheet is turned into tab-separated text and read as text is: header, line of units, dates and bad
cells follow the same rules, and the line numbers of messages are the sheet's row numbers.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source, from_first_row, statements_in
from dbo_cli.logs.libraries import host, import_extra, import_polars
from dbo_cli.logs.plain_text import clean_text
from dbo_cli.logs.stated_clock import Statement, read_statements
from dbo_cli.logs.text.lines import is_number
from dbo_cli.logs.text.text_table import TextTable

# --- Parquet and Feather (Arrow), read in blocks with polars ---------------------------------------------

_ROWS = 1 << 20  # read at once: a row group is decoded whole, and pandas writes a million rows into one
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
    damaged = (polars.exceptions.PolarsError, polars.exceptions.PanicException, OSError, ValueError)
    with request.reading(kind, damaged), host().contained(request.place, kind):
        metadata = _parquet_metadata(request.address.path) if kind == "Parquet" else {}
        frame = scan(request.address.path)
        schema = frame.collect_schema()
        length = int(frame.select(polars.len()).collect().item())
    attributes = _pandas_attributes(metadata)
    units = attributes.get("units")
    sources = []
    for name, stored in schema.items():
        source = _arrow_column(ColumnSource(name, length, _stretches(request, kind, frame, name)), stored)
        if source is not None:
            unit = units.get(name) if isinstance(units, dict) else None
            sources.append(replace(source, unit=source.unit or (str(unit) if unit else None)))
    clock = statements_in(metadata) + statements_in(attributes)
    held = (f"{name} ({stored})" for name, stored in schema.items())
    return ColumnTable(request, kind, sources, clock=clock, damaged=damaged, held=held)


def _stretches(request: Request, kind: str, frame: Any, name: str) -> Callable[[int, int], Any]:
    """Read rows of a column as an array, nulls as NaN; the last stretch is kept for the next rows."""

    @lru_cache(maxsize=1)
    def stretch(base: int) -> Any:
        polars = import_polars()
        column, stored = polars.col(name), frame.collect_schema()[name]
        physical = column.to_physical() if stored.is_temporal() else column.cast(polars.Float64)
        with host().contained(request.place, kind):
            return frame.slice(base, _ROWS).select(physical).collect().to_series().to_numpy()

    def fetch(start: int, stop: int) -> Any:
        bases = range(start // _ROWS * _ROWS, stop, _ROWS)
        values = np.concatenate([stretch(base)[max(0, start - base) : stop - base] for base in bases])
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
    read = getattr(polars, "read_parquet_metadata", None)  # newer than the oldest polars that is supported
    try:
        return {str(key): str(value) for key, value in read(path).items()} if read is not None else {}
    except (Exception, polars.exceptions.PanicException):
        return {}  # a damaged file is complained about when its columns are looked up


def _pandas_attributes(metadata: dict[str, str]) -> dict[str, Any]:
    """Give ``DataFrame.attrs`` as pandas stores them: ``units`` by column, a rate."""
    try:
        found = json.loads(metadata.get("PANDAS_ATTRS", "{}"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


# --- Excel workbooks and OpenDocument sheets, read with fastexcel -----------------------------------------

_LOOKED_AT = 200  # rows that tell whether a sheet holds a table; instruments' headers are shorter
# As fastexcel writes dates in its column of texts.
_DATE = r"^\d{4}-\d\d-\d\d"
_DAY_ZERO = r"^1899-12-3[01] "  # before a time of day without a date


def open_excel(request: Request) -> TextTable:
    """Open a workbook's only sheet with numbers, or the one that ``FILE::SHEET`` names.

    Raises
    ------
    InputError
        fastexcel is not installed, the workbook is damaged, or which sheet is meant is not clear.
    """
    place = request.place
    fastexcel = import_extra("fastexcel", place)
    # BaseException: whatever the damaged bytes lead to; a panic is no Exception
    with request.reading("workbook", (BaseException,)), host().contained(place, "workbook"):
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
    found = names if wanted else [name for name in names if _has_numbers(book, name)]
    listed = ", ".join(f"'{name}'" for name in found)
    if wanted and wanted not in names:
        raise InputError(f"{place}: there is no sheet '{wanted}': the sheets are: {listed}")
    if not found:
        raise InputError(f"{place}: no sheet holds rows of numbers")
    if not wanted and len(found) > 1:
        one = f"{request.address.path}::{found[0]}"
        raise InputError(f"{place}: {len(found)} sheets hold numbers, {listed}: which one? (write {one})")
    return wanted or found[0]


def _has_numbers(book: Any, name: str) -> bool:
    sheet = book.load_sheet(name, header_row=None, skip_rows=0, n_rows=_LOOKED_AT, dtypes="string")
    rows = sheet.to_polars().rows() if sheet.width else []
    return any(sum(is_number(cell, ".") for cell in row if cell) >= min(2, sheet.width) for row in rows)


def _sheet_as_text(book: Any, name: str) -> bytes:
    """Write a sheet as tab-separated text, its numbers with all their digits."""
    polars = import_polars()
    shown = book.load_sheet(name, header_row=None, skip_rows=0, dtypes="string").to_polars()
    exact = book.load_sheet(name, header_row=None, skip_rows=0, dtypes="float").to_polars()
    if shown.shape != exact.shape:
        raise ValueError("the sheet cannot be read twice alike")
    columns = []
    for text, number in zip(shown.get_columns(), exact.get_columns(), strict=True):
        frame = polars.DataFrame({"text": text, "number": number})
        usable = polars.col("number").is_not_null() & ~polars.col("text").str.contains(_DATE)
        plain = polars.col("text").str.replace_all(r"[\t\r\n]", " ").str.replace(_DAY_ZERO, "")
        cells = polars.when(usable).then(polars.col("number").cast(polars.String)).otherwise(plain)
        columns.append(frame.select(cells.alias("cell")).to_series().rename(text.name))
    table = polars.DataFrame(columns)
    written: str = table.write_csv(include_header=False, separator="\t", null_value="", quote_style="never")
    return written.encode("utf-8")


# --- LabVIEW's TDMS, read in blocks with npTDMS -----------------------------------------------------------


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
        with request.reading("TDMS"):  # npTDMS raises whatever the damaged bytes lead to
            file = nptdms.TdmsFile.open(stream)
        groups = _groups(request, file)
        channels = [(group, one) for group in groups for one in group.channels()]
        numeric = [(group, one) for group, one in channels if len(one) > 0 and one.dtype.kind in "fiubM"]
        several = len({group.name for group, _ in numeric}) > 1
        sources = [_tdms_column(group if several else None, channel) for group, channel in numeric]
        if not sources:
            listed = ", ".join(f"{group.name}/{one.name}" for group, one in channels) or "nothing"
            raise InputError(f"{request.place}: no channels of numbers: it holds {listed}")
        levels = [*(groups if len(groups) == 1 else ()), file]
        clock = next((found for level in levels if (found := _tdms_statements(level))), [])
        close = opened.pop_all().close
    return ColumnTable(request, "TDMS", sources, clock=clock, at_close=close, damaged=(Exception,))


def _groups(request: Request, file: Any) -> list[Any]:
    groups, wanted = list(file.groups()), _wanted_part(request)
    found = [group for group in groups if group.name == wanted] if wanted else groups
    if wanted and not found:
        names = ", ".join(f"'{group.name}'" for group in groups) or "none"
        raise InputError(f"{request.place}: there is no group '{wanted}': the groups are: {names}")
    return found


def _tdms_column(group: Any, channel: Any) -> ColumnSource:
    label = clean_text(channel.name)
    label = label if group is None else f"{clean_text(group.name)}/{label}"
    properties = channel.properties
    unit = clean_text(properties.get("unit_string") or properties.get("NI_UnitDescription") or "") or None
    if channel.dtype.kind == "M":
        stamps = channel[:]
        return array_source(label, (stamps - stamps[0]).astype("timedelta64[us]").astype("int64") / 1e6, "s")
    offset = properties.get("wf_start_offset", 0.0)  # LabVIEW defines it in seconds
    offset = float(offset) if isinstance(offset, int | float) else 0.0
    source = ColumnSource(label, len(channel), lambda start, stop: channel[start:stop], unit)
    return replace(source, clock=tuple(_tdms_statements(channel)), start=offset)


def _tdms_statements(node: Any) -> list[Statement]:
    properties = node.properties
    if clean_text(properties.get("wf_xname") or "Time").strip().lower() not in ("time", "zeit", "temps", ""):
        return []  # a spectrum: its increment is no time
    found = []
    for name, value in properties.items():
        own = name == "wf_increment"  # LabVIEW defines it in seconds
        unit = properties.get("wf_xunit_string" if own else f"{name}_unit")
        found += read_statements(name, value, unit or None, sure=own)
    return found


# --- universal files (UFF, UNV) of modal analysis: data sets 58, read with pyuff --------------------------

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
            sources += _function_columns(one, {source.label for source in sources})
    held = (f"data set {one['type']}" for one in sets)
    return ColumnTable(request, "UFF", sources, held=held, remedy=" (functions of time, 58)")


def _function_columns(one: dict[str, Any], taken: set[str]) -> list[ColumnSource]:
    """Make a column of a function; its stamps become another where they are not evenly spaced."""
    names = (clean_text(one[key]).strip() for key in ("id1", "ordinate_axis_lab"))
    name = next((name for name in names if name not in ("", "NONE")), "")
    name = f"{name} {one['rsp_node']}" if name in taken or not name else name
    unit = clean_text(one["ordinate_axis_units_lab"]).strip()
    values, step = np.asarray(one["data"]), float(one["abscissa_inc"])
    if values.dtype.kind != "f":
        return []
    source = array_source(name, values, None if unit in ("", "NONE") else unit)
    if one["abscissa_spacing"] == _UNEVEN or not step > 0.0:
        return [array_source("time", np.asarray(one["x"]), "s"), source][("time" in taken) :]
    clock = (Statement(f"'abscissa_inc' {step:g} s", 1.0 / step),)
    return [replace(source, clock=clock, start=float(one["abscissa_min"]))]
