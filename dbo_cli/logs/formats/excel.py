"""Workbooks: a sheet becomes text with tabs, which is read as any text."""

from dataclasses import replace
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.fence import fenced, import_extra
from dbo_cli.logs.stream import TextStream
from dbo_cli.logs.table import Reading, Table
from dbo_cli.logs.text import TextTable


def read_excel(path: str, inner: str, reading: Reading) -> Table:
    """Read the only sheet of a workbook, or ``FILE::SHEET`` (InputError)."""
    fastexcel = import_extra("fastexcel", "excel", path)
    with fenced(path, "a workbook"):
        book = fastexcel.read_excel(path)
        names = list(book.sheet_names)
        if (inner or len(names) > 1) and inner not in names:
            raise InputError(
                f"{path}: several sheets, {', '.join(names)}: type {path}::{names[0]}"
            )
        content = _sheet_as_text(book, inner or names[0])
    stream = TextStream(path, content=content)
    return TextTable(stream, replace(reading, delimiter="tab", encoding=None))


def _sheet_as_text(book: Any, name: str) -> bytes:
    """Write a sheet as text with tabs; its numbers keep all their digits."""
    import polars as pl

    plain = {"header_row": None, "skip_rows": 0}
    shown = book.load_sheet(name, dtypes="string", **plain).to_polars()
    exact = book.load_sheet(name, dtypes="float", **plain).to_polars()
    columns = []
    for text, number in zip(shown.get_columns(), exact.get_columns(), strict=True):
        words = text.str.replace_all(r"[\t\r\n]", " ")
        figures = number.cast(pl.String).fill_null(words)
        is_other = text.str.contains(r"^(\d{4}-\d\d-\d\d|true|false)").fill_null(False)
        columns.append(figures.zip_with(~is_other, words))
    frame = pl.DataFrame(columns)
    written: str = frame.write_csv(
        include_header=False, separator="\t", quote_style="never"
    )
    return written.encode()
