"""Blocks of regular text by polars; None wherever a block is not regular.

polars makes null rows of blank lines and nulls of short rows, takes ``2.5`` under a
decimal comma, passes long rows where it reads some columns only, and panics at a lone
quote. So it reads all columns, and nothing is believed that it does not check.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import polars as pl
from numpy.typing import NDArray

from dbo_cli.logs.cells import STAMPS
from dbo_cli.logs.sniff import ERROR, Layout
from dbo_cli.logs.source import NOT_A_TIME, Column


def read_fast(
    text: bytes, layout: Layout, chosen: Sequence[Column], cleaned: bool = False
) -> list[NDArray[Any]] | None:
    """Read whole lines; None where a line or a cell of them is not regular.

    Parameters
    ----------
    text
        The lines.
    layout
        How they are written.
    chosen
        The columns that are wanted.
    cleaned
        Whether to leave out comments, blank lines and blanks first.

    Returns
    -------
    list or None
        float64, or int64 nanoseconds, for each chosen column.
    """
    if layout.delimiter == " ":
        text = _single_blanks(text)
    if b'"' in text:
        text = _unquoted(text, layout.delimiter)
        if b'"' in text:
            return None
    if cleaned:
        text = _cleaned(text, layout.delimiter)
    frame = _frame(text, layout)
    if frame is None:
        return None
    arrays: list[NDArray[Any]] = []
    for column in chosen:
        series = frame[f"{column.number}"]
        if column.kind == "stamp":
            series = _stamps(series, layout.stamps[column.number - 1])
            series = series.fill_null(NOT_A_TIME)
        if series.null_count():
            return None
        arrays.append(series.to_numpy())
    return arrays


def _frame(text: bytes, layout: Layout) -> pl.DataFrame | None:
    """Read all columns; None where polars refuses, or a line has too few cells."""
    schema: dict[str, Any] = {}
    for n in range(layout.width):
        schema[f"{n + 1}"] = pl.Float64 if n in layout.numeric else pl.String
    try:
        frame = pl.read_csv(
            text,
            has_header=False,
            separator=layout.delimiter,
            schema=schema,
            quote_char=None,
            decimal_comma=layout.decimal == ",",
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, ValueError):
        return None
    if frame.to_series(-1).null_count():
        # no line has too many cells, so the delimiters in all tell whether one has too few
        marks = text.count(layout.delimiter.encode())
        if marks != (layout.width - 1) * len(frame):
            return None
    if layout.decimal == ",":
        texts = frame.select(pl.selectors.string().str.count_matches(".", literal=True))
        if text.count(b".") != sum(map(sum, texts.fill_null(0).iter_columns())):
            return None  # a point in a cell of a number
    return frame


def _stamps(series: pl.Series, form: str) -> pl.Series:
    """Read time stamps as nanoseconds since 1970, or since midnight; null for other cells."""
    like = series.str.contains(f"^(?:{STAMPS[form].pattern})$")
    text = series.str.replace(",", ".", literal=True)
    if not form.startswith("%Y") and not form.startswith("%d"):
        text, form = "1970-01-01 " + text, f"%Y-%m-%d {form}"
    if form.endswith("%z"):
        text = text.str.replace("Z$", "+00:00")
    stamps = text.str.to_datetime(form, strict=False, time_unit="ns", exact=True)
    counts = stamps.dt.epoch("ns")
    return pl.select(pl.when(like).then(counts)).to_series()


def _single_blanks(text: bytes) -> bytes:
    """Leave one blank between cells, and none at the ends of lines."""
    text = text.replace(b"\t", b" ")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


def _unquoted(text: bytes, delimiter: str) -> bytes:
    """Take the quotes off cells that hold no delimiter; others keep theirs."""
    mark = re.escape(delimiter.encode())
    cell = rb'"([^"\n' + mark + rb']*)"'
    pattern = rb"(?m)(?:^|(?<=" + mark + rb"))" + cell + rb"(?=" + mark + rb"|$)"
    return re.sub(pattern, rb"\1", text)


def _cleaned(text: bytes, delimiter: str) -> bytes:
    """Leave out comments, blank lines, and blanks around cells."""
    comment = rb"(?m)^[ \t]*(?:(?!" + ERROR.encode() + rb")[#%].*|EOF[ \t]*$)\n?"
    text = re.sub(comment, b"", text)
    if delimiter != " " and b" " in text:
        mark = re.escape(delimiter.encode())
        text = re.sub(rb" *" + mark + rb" *", lambda _: delimiter.encode(), text)
        text = re.sub(rb"(?m)^ +| +$", b"", text)
    return re.sub(rb"\n\n+", b"\n", text).lstrip(b"\n")
