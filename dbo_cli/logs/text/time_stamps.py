"""Time stamps written as text: dates, clock times, and both in one cell, read as seconds.

Dates count from 1970-01-01 (no zone given: as if UTC), clock times from midnight.  The arithmetic is on whole
numbers, so that a stamp becomes the float64 nearest to it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache

DAY = 86400  # s
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_MONTH_FIRST = re.compile(r"(?P<month>\d{1,2})/(?P<day>\d{1,2})/(?P<year>\d{4}|\d\d)")
_DATES = (
    re.compile(r"(?P<year>\d{4})([-/.])(?P<month>\d{1,2})\2(?P<day>\d{1,2})"),
    re.compile(r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)"),
    re.compile(r"(?P<day>\d{1,2})([-.])(?P<month>\d{1,2})\2(?P<year>\d{4}|\d\d)"),
    _MONTH_FIRST,
    re.compile(r"(?P<day>\d{1,2})[- ](?P<month>[A-Za-z]{3})[- ](?P<year>\d{4})"),
)
_CLOCK = re.compile(
    r"(?:(?P<days>\d{1,5}) days?,? )?(?P<hours>\d{1,3}):(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]?\d)"
    r"(?:[.,](?P<fraction>\d{1,20})|:(?P<millis>\d{3}))?(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_MINUTES = re.compile(r"(?P<minutes>\d{1,3}):(?P<seconds>[0-5]\d)[.,](?P<fraction>\d{1,20})")
_STAMP = re.compile(
    r"(?P<date>\d{4}([-/.])\d{1,2}\2\d{1,2}|\d{8}|\d{1,2}[-./]\d{1,2}[-./]\d{2,4}"
    r"|\d{1,2}[- ][A-Za-z]{3}[- ]\d{4})(?:T|[ _]+|, ?)"
    r"(?P<clock>\d{1,2}:\d\d:\d\d(?:[.,]\d{1,20})?(?: ?[AaPp]\.?[Mm]\.?)?|\d{6}(?:\.\d{1,20})?)"
    r" ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?"
)


@lru_cache(maxsize=64)
def date_days(text: str) -> int | None:
    """Return the days from 1970-01-01 to a written date, or None.

    ``2024-03-31``, ``2024/3/31``, ``31.03.2024``, ``31-03-2024``, ``31-Mar-2024``; with slashes and the year
    last the month stands first (as in the United States) unless it cannot.
    """
    import datetime

    found = next((found for pattern in _DATES if (found := pattern.fullmatch(text))), None)
    if found is None:
        return None
    year, day, name = int(found["year"]), int(found["day"]), found["month"].lower()
    month = _MONTHS.index(name) + 1 if name in _MONTHS else int(name) if name.isdecimal() else 0
    if found.re is _MONTH_FIRST and month > 12:
        month, day = day, month
    try:
        date = datetime.date(year + 2000 if year < 100 else year, month, day)
    except ValueError:
        return None
    return date.toordinal() - datetime.date(1970, 1, 1).toordinal()


def _exact(whole: int, fraction: str | None) -> float:
    """Return a whole number of seconds and the digits after it as the nearest float64."""
    if not fraction:
        return float(whole)
    size: int = 10 ** len(fraction)
    return (whole * size + int(fraction)) / size


def _clock_parts(text: str) -> tuple[int, str | None] | None:
    found = _CLOCK.fullmatch(text)
    if found is None:
        return None
    hours = int(found["hours"])
    if found["half"]:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + (12 if found["half"] in "pP" else 0)
    whole = int(found["days"] or 0) * DAY + hours * 3600
    return whole + int(found["minutes"]) * 60 + int(found["seconds"]), found["fraction"] or found["millis"]


def date_seconds(text: str) -> float | None:
    """Read a date as seconds since 1970, or give None."""
    days = date_days(text)
    return None if days is None else float(days * DAY)


def clock_seconds(text: str) -> float | None:
    """Read ``hh:mm:ss.sss`` (also with days in front, or am and pm behind) as seconds, or give None."""
    parts = _clock_parts(text)
    return None if parts is None else _exact(*parts)


def minute_seconds(text: str) -> float | None:
    """Read ``mm:ss.s``, a spreadsheet's habit, as seconds of the hour, or give None."""
    found = _MINUTES.fullmatch(text)
    if found is None:
        return None
    return _exact(int(found["minutes"]) * 60 + int(found["seconds"]), found["fraction"])


def stamp_seconds(text: str) -> float | None:
    """Read a date and a clock time in one cell (ISO 8601 and its relatives) as seconds since 1970."""
    found = _STAMP.fullmatch(text)
    if found is None:
        return None
    days, clock, zone = date_days(found["date"]), found["clock"], found["zone"]
    if ":" not in clock:
        clock = f"{clock[:2]}:{clock[2:4]}:{clock[4:]}"
    parts = _clock_parts(clock)
    if days is None or parts is None:
        return None
    whole = days * DAY + parts[0]
    if zone and zone[0] in "+-":
        ahead = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        whole += -ahead if zone[0] == "+" else ahead
    return _exact(whole, parts[1])


READERS: dict[str, Callable[[str], float | None]] = {
    "stamp": stamp_seconds,
    "clock": clock_seconds,
    "minutes": minute_seconds,
    "date": date_seconds,
}
"""How a column of time stamps may be written, and what reads its cells."""


def writing_of(cells: Sequence[str]) -> str | None:
    """Return how most cells of a column write time stamps, or None where they are none."""
    for writing, read in READERS.items():
        if 2 * sum(read(cell) is not None for cell in cells) > len(cells):
            return writing
    return None
