"""Blocks of regular text by polars; None wherever a block is not regular.

polars makes null rows of blank lines and nulls of short rows, takes ``2.5`` under a
decimal comma, passes long rows where it reads some columns only, and panics at a lone
quote. So it reads all columns, and nothing is believed that it does not check.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from dbo_cli.logs.cells import GROUPED_CELL, STAMPS, WHOLE_CELL, Layout, Marks
from dbo_cli.logs.dialect import ERROR
from dbo_cli.logs.table import LONGEST_CELL, NOT_A_TIME, Column

_Arrays = list[NDArray[Any]]
_STRETCHES = 1024  # that are looked at at once
_STRETCH = 96  # bytes; where each stretch holds a line end, no line is longer than LONGEST_CELL


def read_fast(
    text: bytes,
    layout: Layout,
    columns: Sequence[Column],
    marks: Mapping[int, Marks],
    first_row: int,
) -> tuple[_Arrays, int] | None:
    """Read whole lines; None where a line or a cell of them is not regular.

    Parameters
    ----------
    text
        The lines.
    layout
        How they are written.
    columns
        The columns that are read.
    marks
        By the number of a column, what its cells have shown of decimals.
    first_row
        The number of the first row.

    Returns
    -------
    arrays, lines
        float64, or int64 nanoseconds, for each column; the number of lines.
    """
    if has_long_cell(text, layout.delimiter):
        return None
    plain = _single_blanks(text) if layout.delimiter == " " else text
    if 0 in layout.numeric:  # else a comment may pass as a row
        arrays = _arrays(plain, layout, columns, marks, first_row)
        if arrays is not None:
            return arrays, len(arrays[0])
    plain = _cleaned(plain, layout.delimiter)
    arrays = _arrays(plain, layout, columns, marks, first_row)
    return None if arrays is None else (arrays, text.count(b"\n"))


def has_long_cell(text: bytes, delimiter: str) -> bool:
    """Return whether a cell has more than ``LONGEST_CELL`` bytes."""
    letters = np.frombuffer(text, np.uint8)
    if _has_short_lines(letters):
        return False
    is_end = (letters == ord("\n")) | (letters == ord(delimiter))
    ends = np.flatnonzero(is_end)
    return bool(np.diff(ends, prepend=-1, append=len(text)).max() > LONGEST_CELL + 1)


def _has_short_lines(letters: NDArray[np.uint8]) -> bool:
    """Return whether every stretch holds a line end; looked at by what stays in caches."""
    for start in range(0, len(letters), _STRETCHES * _STRETCH):
        is_end = letters[start : start + _STRETCHES * _STRETCH] == ord("\n")
        ends = is_end[: len(is_end) // _STRETCH * _STRETCH].view(np.uint64)
        ends = ends[0::2] | ends[1::2]  # of 16 bytes
        ends = ends[0::2] | ends[1::2]  # of 32 bytes
        ends = ends[0::3] | ends[1::3] | ends[2::3]
        if not ends.all():
            return False
    return True


def _arrays(
    text: bytes,
    layout: Layout,
    columns: Sequence[Column],
    marks: Mapping[int, Marks],
    first_row: int,
) -> _Arrays | None:
    """Read the columns; None where polars refuses, or a cell or a line is not regular."""
    unclear = [number for number, mark in marks.items() if not mark.is_clear]
    schema: dict[str, Any] = {}
    for n in range(layout.width):
        is_plain = n in layout.numeric and n + 1 not in unclear
        schema[f"{n + 1}"] = pl.Float64 if is_plain else pl.String
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
    for number in unclear:
        cells = frame[f"{number}"]
        figures = cells.str.replace(layout.decimal, ".", literal=True)
        if layout.decimal == "," and cells.str.contains(".", literal=True).any():
            return None
        figures = figures.cast(pl.Float64, strict=False)
        if figures.null_count():
            return None
        frame = frame.with_columns(figures.alias(f"{number}"))
        _watch(marks[number], cells, first_row)
    if not _is_regular(text, layout, frame):
        return None
    arrays: _Arrays = []
    for column in columns:
        series = frame[f"{column.number}"]
        if series.null_count():
            return None
        if column.kind == "stamp":
            arrays.append(read_stamps(series, column.sample))
        else:
            arrays.append(series.to_numpy())
    return arrays


def _watch(marks: Marks, cells: pl.Series, first_row: int) -> None:
    """Take the cells of a column into account: of each kind the first."""
    is_whole = cells.str.contains(f"^{WHOLE_CELL}$")
    is_grouped = cells.str.contains(f"^{GROUPED_CELL}$")
    rows = []
    for is_kind in (is_whole, is_grouped, ~(is_whole | is_grouped)):
        row = is_kind.arg_max()
        if row is not None and is_kind[row]:
            rows.append(row)
    for row in sorted(rows):
        marks.watch(first_row + row, cells[row])


def _is_regular(text: bytes, layout: Layout, frame: pl.DataFrame) -> bool:
    """Return whether polars took no line with too few cells, no quoted delimiter, and no wrong sign."""
    if layout.width > len(layout.numeric) and b'"' in text:
        return False
    if frame.to_series(-1).null_count():
        # no line has too many cells, so the delimiters in all tell whether one has too few
        marks = text.count(layout.delimiter.encode())
        if marks != (layout.width - 1) * len(frame):
            return False
    if layout.decimal == "," and b"." in text:
        texts = frame.select(pl.selectors.string().str.count_matches(".", literal=True))
        return text.count(b".") == sum(map(sum, texts.fill_null(0).iter_columns()))
    return True


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


def _single_blanks(text: bytes) -> bytes:
    """Leave one blank between cells, and none at the ends of lines."""
    text = text.replace(b"\t", b" ")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


def _cleaned(text: bytes, delimiter: str) -> bytes:
    """Leave out comments, blank lines, blanks around cells, and quotes around cells without a delimiter.

    A run of blanks is entered at its begin only: else the time grows as its square.
    """
    mark = re.escape(delimiter.encode())
    if b'"' in text:
        cell = rb'"([^"\n' + mark + rb']*)"'
        pattern = rb"(?m)(?:^|(?<=" + mark + rb"))" + cell + rb"(?=" + mark + rb"|$)"
        text = re.sub(pattern, rb"\1", text)
    comment = rb"(?m)^[ \t]*(?:(?!" + ERROR.encode() + rb")[#%].*|EOF[ \t]*$)\n?"
    text = re.sub(comment, b"", text)
    if delimiter != " " and b" " in text:
        text = re.sub(rb"(?<! ) *+" + mark + rb" *", lambda _: delimiter.encode(), text)
        text = re.sub(rb"(?m)^ +|(?<! ) +$", b"", text)
    return re.sub(rb"\n\n+", b"\n", text).lstrip(b"\n")
