"""Cells of a text log, one line at a time: split, numbers, and how time stamps look.

``text.py`` has whole blocks read by polars and comes here for what polars refuses.
"""

from __future__ import annotations

import contextlib
import csv
import re
from collections.abc import Sequence

import numpy as np

_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[-+]?(\d+,?\d*|,\d+)([eEdD][-+]?\d+)?", re.ASCII)
_NOT_FINITE = ("nan", "inf", "infinity", "∞", "1.#qnan", "1.#ind", "1.#inf")
MISSING = ("", "na", "n/a", "null", "none", "-", "--", *_NOT_FINITE)
"""Cells that stand where a number is missing, in lower case."""

_DATES = {
    "%Y-%m-%d": r"(?:1[7-9]|20|21)\d\d-\d\d?-\d\d?",  # nanoseconds reach no farther
    "%Y/%m/%d": r"(?:1[7-9]|20|21)\d\d/\d\d?/\d\d?",
    "%d.%m.%Y": r"\d\d?\.\d\d?\.(?:1[7-9]|20|21)\d\d",
}
_CLOCK = r"\d\d?:\d\d:\d\d(?:[.,]\d{1,9})?"
_ZONE = r"(?:Z|[+-]\d\d:?\d\d)"


def _stamp_patterns() -> dict[str, re.Pattern[str]]:
    patterns = {}
    for form, pattern in _DATES.items():
        for between in "T ":
            stamp = pattern + between + _CLOCK
            patterns[f"{form}{between}%H:%M:%S%.f"] = re.compile(stamp, re.ASCII)
            zoned = stamp + _ZONE
            patterns[f"{form}{between}%H:%M:%S%.f%z"] = re.compile(zoned, re.ASCII)
    patterns["%H:%M:%S%.f"] = re.compile(_CLOCK, re.ASCII)
    return patterns


STAMPS = _stamp_patterns()
"""The formats of time stamps that are read, as polars writes them, and how their cells look."""


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line at the delimiter; a blank stands for any run of blanks and tabs.

    Quotes around a cell are taken off; inside them the delimiter is a character like
    any other.
    """
    if delimiter == " ":  # no-break blanks stand between thousands
        return [word.strip('"') for word in re.findall(r'"[^"]*"|[^ \t\r]+', line)]
    cells = line.split(delimiter)
    if '"' in line:  # blanks may stand in front of a quote
        reader = csv.reader(
            [line.strip(" \r")],
            delimiter=delimiter,
            skipinitialspace=True,
            strict=True,
        )
        with contextlib.suppress(csv.Error):  # else quotes are letters of their cells
            cells = next(reader)
    return [cell.strip() for cell in cells]


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is written as a number, or as one that is not finite."""
    pattern = _POINT if decimal == "." else _COMMA
    return bool(pattern.fullmatch(cell)) or cell.lstrip("+-").lower() in _NOT_FINITE


def to_number(cell: str, decimal: str) -> float:
    """Read a cell as a number; NaN for other text."""
    pattern = _POINT if decimal == "." else _COMMA
    if not pattern.fullmatch(cell):
        return np.nan
    if decimal == ",":
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:  # Fortran's 1.0D+00
        return float(cell.replace("D", "e").replace("d", "e"))


def stamp_format(cells: Sequence[tuple[str, float]]) -> str | None:
    """Return the format in which most cells, each with its weight, are time stamps; else None."""
    total = sum(weight for cell, weight in cells if cell)
    for form, pattern in STAMPS.items():
        fitting = sum(weight for cell, weight in cells if pattern.fullmatch(cell))
        if 2.0 * fitting > total:
            return form
    return None
