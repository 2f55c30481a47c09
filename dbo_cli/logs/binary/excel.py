"""Excel workbooks (and OpenDocument sheets) as a table of columns, read with fastexcel.

A sheet is turned into tab-separated text and read as text is: header, line of units, dates and bad cells
follow the same rules, and the line numbers of messages are the sheet's row numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.libraries import host, import_extra, keep_interrupts
from dbo_cli.logs.text.lines import is_number
from dbo_cli.logs.text.text_table import TextTable

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
    place, address = request.place, request.address
    fastexcel = import_extra("fastexcel", place)
    # BaseException: whatever the damaged bytes lead to; a panic is no Exception
    with request.reading("workbook", (BaseException,)), host().contained(place, "workbook"):
        book = fastexcel.read_excel(address.path)
        content = _as_text(book, _choose(place, address, book))
    plain = replace(request.options, delimiter="tab", encoding=None)
    return TextTable(replace(request, options=plain, content=content))


def _choose(place: str, address: Address, book: Any) -> str:
    wanted = (address.group or "").strip("/")
    names = [str(name) for name in book.sheet_names]
    found = names if wanted else [name for name in names if _has_numbers(book, name)]
    listed = ", ".join(f"'{name}'" for name in found)
    if wanted and wanted not in names:
        raise InputError(f"{place}: there is no sheet '{wanted}': the sheets are: {listed}")
    if not found:
        raise InputError(f"{place}: no sheet holds rows of numbers")
    if not wanted and len(found) > 1:
        raise InputError(
            f"{place}: {len(found)} sheets hold numbers, {listed}: which one? "
            f"(write {address.path}::{found[0]})"
        )
    return wanted or found[0]


def _has_numbers(book: Any, name: str) -> bool:
    sheet = book.load_sheet(name, header_row=None, skip_rows=0, n_rows=_LOOKED_AT, dtypes="string")
    rows = sheet.to_polars().rows() if sheet.width else []
    return any(sum(is_number(cell, ".") for cell in row if cell) >= min(2, sheet.width) for row in rows)


def _as_text(book: Any, name: str) -> bytes:
    """Write a sheet as tab-separated text, its numbers with all their digits."""
    import polars

    keep_interrupts()
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
    written: str = polars.DataFrame(columns).write_csv(
        include_header=False, separator="\t", null_value="", quote_style="never"
    )
    return written.encode("utf-8")
