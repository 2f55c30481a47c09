"""Blocks of regular text by polars; None wherever a block is not regular.

polars makes null rows of blank lines and nulls of short rows, takes ``2.5`` under a
decimal comma, passes long rows where it reads some columns only, and panics at a lone
quote. So it reads all columns, and nothing is believed that it does not check.
"""

import re
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dbo_cli.arrays import Floats
from dbo_cli.logs.cells import STAMPS, Layout
from dbo_cli.logs.table import LONGEST_CELL, NOT_A_TIME, Column

_COMMENT = re.compile(rb"(?m)^[ \t]*[#%]")


def read_frame(
    text: bytes, layout: Layout, columns: Sequence[Column], unclear: Collection[int]
) -> pl.DataFrame | None:
    """Read whole lines; None where a line or a cell of them is not regular.

    Parameters
    ----------
    text
        The lines.
    layout
        How they are written.
    columns
        Those that are wanted.
    unclear
        The numbers of columns whose cells are wanted as texts, as those of stamps are.

    Returns
    -------
    DataFrame
        A column for each of the layout, named by its number.
    """
    has_comments = (b"#" in text or b"%" in text) and _COMMENT.search(text)
    if has_comments or b'"' in text or has_long_cell(text, layout.delimiter):
        return None
    text = _tidied(text, layout.delimiter)
    schema: dict[str, Any] = {}
    for number, (kind, _) in enumerate(layout.kinds, start=1):
        is_plain = kind == "number" and number not in unclear
        schema[str(number)] = pl.Float64 if is_plain else pl.String
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
    frame = frame.with_columns(pl.selectors.string().str.strip_chars())
    if layout.has_blank_front:
        frame = frame.with_columns(pl.col("1").fill_null(""))
    has_nulls = any(frame[str(column.number)].null_count() for column in columns)
    return None if has_nulls or not _is_regular(text, layout, frame) else frame


def has_long_cell(text: bytes, delimiter: str) -> bool:
    """Return whether a cell has more than ``LONGEST_CELL`` bytes."""
    letters = np.frombuffer(text, np.uint8)
    is_end = letters == ord("\n")
    # a longer cell fills a whole window of half its length
    window = LONGEST_CELL // 2
    windows = is_end[: len(text) // window * window].reshape(-1, window)
    if windows.any(axis=1).all():
        return False
    is_end |= letters == ord(delimiter)
    lengths = np.diff(np.flatnonzero(is_end), prepend=-1, append=len(text))
    return bool(lengths.max() > LONGEST_CELL + 1)


def _is_regular(text: bytes, layout: Layout, frame: pl.DataFrame) -> bool:
    """Return whether polars took no line with too few cells, and no wrong sign."""
    if frame.to_series(-1).null_count():
        # no line has too many cells, so the delimiters in all tell whether one has too few
        marks = text.count(layout.delimiter.encode())
        if marks != (layout.width - 1) * len(frame):
            return False
    if layout.decimal == "," and b"." in text:
        texts = frame.select(pl.selectors.string().str.count_matches(".", literal=True))
        return text.count(b".") == sum(map(sum, texts.fill_null(0).iter_columns()))
    return True


def read_numbers(cells: pl.Series, decimal: str) -> Floats | None:
    """Read texts as numbers; None where one is not regular."""
    if decimal == "," and cells.str.contains(".", literal=True).any():
        return None
    cells = cells.str.replace(decimal, ".", literal=True).cast(pl.Float64, strict=False)
    return None if cells.null_count() else np.asarray(cells.to_numpy())


def read_stamps(cells: pl.Series, form: str) -> NDArray[np.int64]:
    """Read time stamps as nanoseconds since 1970, or since midnight; ``NOT_A_TIME`` for other cells."""
    is_stamp = cells.str.contains(f"^(?:{STAMPS[form]})$")
    text = cells.str.replace(",", ".", literal=True)
    if form == "%H:%M:%S%.f":
        text, form = "1970-01-01 " + text, f"%Y-%m-%d {form}"
    if form.endswith("%z"):
        text = text.str.replace("Z$", "+00:00")
    stamps = text.str.to_datetime(form, strict=False, time_unit="ns", exact=True)
    counts = pl.select(pl.when(is_stamp).then(stamps.dt.epoch("ns"))).to_series()
    return np.asarray(counts.fill_null(NOT_A_TIME).to_numpy())


def _tidied(text: bytes, delimiter: str) -> bytes:
    """Leave no blanks around cells, and one where blanks are the delimiter."""
    if delimiter == " ":
        text = text.replace(b"\t", b" ")
    if b" " not in text:
        return text
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    for mark in {delimiter.encode(), b"\n"} - {b" "}:
        text = text.replace(b" " + mark, mark).replace(mark + b" ", mark)
    return text.strip(b" ")
