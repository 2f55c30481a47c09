"""Blocks of regular text by polars; None wherever a block is not regular.

Nothing is believed that polars does not check: see ``text.py`` for what it lets pass.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dbo_cli.logs.cells import STAMPS
from dbo_cli.logs.sniff import Layout
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
    if layout.decimal == "," and b"." in text and not layout.stamps:
        return None  # polars takes 2.5 for a number under a decimal comma, too
    if layout.delimiter == " ":
        text = _single_blanks(text)
    if b'"' in text:
        text = _unquoted(text, layout.delimiter)
        if b'"' in text:
            return None  # polars panics at a lone quote
    if cleaned:
        text = _cleaned(text, layout.delimiter)
    return _parsed(text, layout, chosen)


def _parsed(
    text: bytes, layout: Layout, chosen: Sequence[Column]
) -> list[NDArray[Any]] | None:
    """Read lines as they are; None where polars refuses or a cell is missing."""
    wanted = {column.number - 1 for column in chosen}
    schema: dict[str, Any] = {}
    for n in range(layout.width):
        schema[f"column_{n + 1}"] = pl.Float64 if n in layout.numeric else pl.String
    names = None
    if len(wanted) < layout.width:
        names = [f"column_{n + 1}" for n in sorted(wanted | {layout.width - 1})]
    try:
        frame = pl.read_csv(
            text,
            has_header=False,
            separator=layout.delimiter,
            schema=schema,
            columns=names,
            quote_char=None,
            decimal_comma=layout.decimal == ",",
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, ValueError):
        return None
    # polars counts the cells of a line itself where it reads all of them as numbers
    checked = names is None and len(layout.numeric) == layout.width
    if not checked and not _has_all_cells(text, layout, len(frame)):
        return None
    arrays: list[NDArray[Any]] = []
    for column in chosen:
        series = frame[f"column_{column.number}"]
        if column.kind == "stamp":
            series = _stamps(series, layout.stamps[column.number - 1])
            arrays.append(series.fill_null(NOT_A_TIME).to_numpy())
            continue
        if series.null_count():
            return None
        arrays.append(series.to_numpy())
    if checked and layout.width - 1 not in wanted:
        return arrays if not frame[:, -1].null_count() else None
    return arrays


def _has_all_cells(text: bytes, layout: Layout, rows: int) -> bool:
    """Return whether every line has a cell for each column, by the count of delimiters in all.

    A short line and a long one together could pass: each line is counted where the sum
    is right and lines differ.
    """
    letters = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(letters == 10)
    marks = letters == ord(layout.delimiter)
    total = int(np.count_nonzero(marks))
    if total != (layout.width - 1) * rows:
        return False
    counts = np.add.reduceat(
        marks, np.concatenate(([0], ends[:-1] + 1)), dtype=np.int64
    )
    return bool((counts[: len(ends)] == layout.width - 1).all())


def _stamps(series: pl.Series, form: str) -> pl.Series:
    """Read time stamps as nanoseconds since 1970, or since midnight; null for what is none."""
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
    pattern = (
        rb"(?m)(?:(?<=^)|(?<="
        + mark
        + rb'))"([^"\n'
        + mark
        + rb']*)"(?='
        + mark
        + rb"|$)"
    )
    return re.sub(pattern, rb"\1", text)


def _cleaned(text: bytes, delimiter: str) -> bytes:
    """Leave out comments, blank lines, and blanks around cells."""
    text = re.sub(rb"(?m)^[ \t]*(?:[#%].*|EOF[ \t]*$)\n?", b"", text)
    if delimiter != " " and b" " in text:
        mark = re.escape(delimiter.encode())
        text = re.sub(rb" *" + mark + rb" *", lambda _: delimiter.encode(), text)
        text = re.sub(rb"(?m)^ +| +$", b"", text)
    return re.sub(rb"\n\n+", b"\n", text).lstrip(b"\n")
