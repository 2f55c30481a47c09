"""Cells of a text log: split, numbers and time stamps; one line at a time, without any library.

``text.py`` reads whole blocks by polars and comes here for what polars refuses.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from dbo_cli.logs.source import NOT_A_TIME

_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[-+]?(\d+,?\d*|,\d+)([eEdD][-+]?\d+)?", re.ASCII)
_NOT_FINITE = ("nan", "inf", "infinity", "∞", "1.#qnan", "1.#ind", "1.#inf")
MISSING = ("", "na", "n/a", "null", "none", "-", "--", *_NOT_FINITE)
"""Cells that stand where a number is missing, in lower case."""

_DATES = {
    "%Y-%m-%d": r"(?P<Y>\d{4})-(?P<m>\d\d?)-(?P<d>\d\d?)",
    "%Y/%m/%d": r"(?P<Y>\d{4})/(?P<m>\d\d?)/(?P<d>\d\d?)",
    "%d.%m.%Y": r"(?P<d>\d\d?)\.(?P<m>\d\d?)\.(?P<Y>\d{4})",
}
_CLOCK = r"(?P<H>\d\d?):(?P<M>\d\d):(?P<S>\d\d)(?:[.,](?P<f>\d{1,9}))?"
_ZONE = r"(?P<z>Z|[+-]\d\d:?\d\d)"


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
"""The formats of time stamps that are read, and how their cells look."""


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line at the delimiter; a blank stands for any run of blanks and tabs.

    Quotes around a cell are taken off; inside them the delimiter is a character like
    any other.
    """
    if '"' in line:
        return _split_quoted(line, delimiter)
    if delimiter == " ":
        return re.findall(r"[^ \t\r]+", line)  # no-break blanks stand between thousands
    return [cell.strip() for cell in line.split(delimiter)]


def _split_quoted(line: str, delimiter: str) -> list[str]:
    """Split a line in which cells may stand in quotes; a quote anywhere else is a letter of its cell."""
    if delimiter == " ":
        cells = re.findall(r'"([^"]*)"(?=\s|$)|(\S+)', line)
        return [inner or plain for inner, plain in cells]
    mark = re.escape(delimiter)
    pattern = re.compile(rf'\s*"([^"]*)"\s*(?={mark}|$)|([^{mark}]*)')
    cells, place = [], 0
    while place <= len(line):
        match = pattern.match(line, place)
        if match is None:
            break
        cells.append((match[2] if match[1] is None else match[1]).strip())
        place = match.end() + 1
    return cells


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


def to_stamp(cell: str, form: str) -> int:
    """Read a time stamp as nanoseconds since 1970, or since midnight where it has no date."""
    match = STAMPS[form].fullmatch(cell)
    if match is None:
        return NOT_A_TIME
    part = match.groupdict()
    seconds = int(part["H"]) * 3600 + int(part["M"]) * 60 + int(part["S"])
    if int(part["H"]) > 23 or int(part["M"]) > 59 or int(part["S"]) > 59:
        return NOT_A_TIME
    if "Y" in part:
        try:
            day = date(int(part["Y"]), int(part["m"]), int(part["d"]))
        except ValueError:
            return NOT_A_TIME
        if not 1700 < day.year < 2250:  # int64 counts nanoseconds so far
            return NOT_A_TIME
        seconds += (day.toordinal() - date(1970, 1, 1).toordinal()) * 86400
    zone = part.get("z") or "Z"
    if zone != "Z":
        minutes = int(zone[1:3]) * 60 + int(zone[-2:])
        seconds -= minutes * 60 if zone[0] == "+" else -minutes * 60
    fraction = (part["f"] or "").ljust(9, "0")
    return seconds * 10**9 + int(fraction)
