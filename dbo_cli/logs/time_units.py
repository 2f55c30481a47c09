"""What the figures of a time column count: seconds, milliseconds, days, or time since some date."""

from __future__ import annotations

import re
from typing import NamedTuple

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import contradicted_unit, is_torn
from dbo_cli.logs.sample_block import ColumnInfo
from dbo_cli.logs.units import ONE, UnitFactor, kind_of_unit, parse_factor, shortened

_SIZES = {
    "s": (1, 1), "ms": (1, 10**3), "us": (1, 10**6), "ns": (1, 10**9), "ps": (1, 10**12),
    "min": (60, 1), "h": (3600, 1), "d": (86400, 1),
}  # fmt: skip
TIME_UNIT_NAMES = tuple(_SIZES)

SPELLINGS = {
    "s": ("s", "sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden", "seconde", "secondes",
          "segundo", "segundos", "secondo", "secondi", "с", "сек", "秒"),
    "ms": ("ms", "msec", "msecs", "milli", "millis", "millisec", "millisecs", "millisecond", "milliseconds",
           "millisekunde", "millisekunden", "millisecondes", "milisegundos", "millisecondi", "мс",
           "毫秒", "ミリ秒"),
    "us": ("us", "usec", "usecs", "micros", "microsec", "microsecs", "microsecond", "microseconds",
           "mikrosekunde", "mikrosekunden", "microsecondes", "mus", "mcs", "мкс", "微秒"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds",
           "nanosekunden", "нс"),
    "ps": ("ps", "psec", "psecs", "picosecond", "picoseconds"),
    "min": ("min", "mins", "minute", "minutes", "minuten", "minutos", "minuti", "мин"),
    "h": ("h", "hr", "hrs", "hour", "hours", "stunde", "stunden", "std", "heure", "heures", "horas", "ore"),
    "d": ("d", "day", "days", "tag", "tage", "jour", "jours", "dias", "giorni"),
}  # fmt: skip
"""Every known spelling of a unit of time; capitals do not matter (mS in a time column is no conductance)."""

_UNIT_OF = {spelling: unit for unit, spellings in SPELLINGS.items() for spelling in spellings}
_WORDS = frozenset(word for word in _UNIT_OF if len(word) > 1) - {"min", "mins", "std", "ore", "milli"}
"""Spellings that count as the unit wherever they stand in a time column's name (min may be a minimum)."""

_COUNTED = frozenset(
    ("tick", "ticks", "sample", "samples", "frame", "frames", "count", "counts", "cycle", "cycles", "index",
     "idx", "step", "steps", "point", "points", "pulses", "clocks", "jiffies", "row", "rows", "number", "no")
)  # fmt: skip
"""Words that, behind the name of a time column, say that it counts something other than time."""

_NO_UNIT = frozenset(
    ("relative", "rel", "absolute", "abs", "raw", "local", "utc", "gmt", "cet", "elapsed", "iso", "iso8601",
     "start", "since start", "float", "double", "-")
)  # fmt: skip
"""What is written in the brackets of a time column where other columns have their unit."""

_OTHER_HALVES = frozenset(("date", "time", "datum", "zeit", "uhrzeit", "fecha", "hora", "clock", "day"))
_STATED = re.compile(r"(?P<left>.+?)(?:\s*/\s*|\s+in\s+)(?P<right>\S+)", re.IGNORECASE)
_SINCE = re.compile(r"(?P<unit>\S+)\s+since\s+(?P<origin>\d.*)", re.IGNORECASE)
_COUNT = re.compile(r"(?P<number>\d+(?:\.\d+)?)\s*(?P<unit>[^\d\s.].*)")


def time_unit(text: str) -> str | None:
    """Return how a unit of time is spelled here (``s``, ``ms``, …), or None where it is not known."""
    plain = text.strip().strip("[](){}<>").strip().rstrip(".").replace("µ", "u").replace("μ", "u")
    return _UNIT_OF.get(plain.lower().replace("milli ", "milli").replace("micro ", "micro"))


def parse_time_unit(text: str) -> tuple[str, UnitFactor]:
    """Read what ``time_unit`` may be: a unit of time, or a number of them (``10us``).

    Raises
    ------
    UsageError
        It is none.
    """
    found = _COUNT.fullmatch(text.strip())
    unit = time_unit(found["unit"] if found else text)
    count = parse_factor(found["number"]) if found else ONE
    if unit is None or count is None or not count.numerator:
        names = ", ".join(TIME_UNIT_NAMES[:-1])
        raise UsageError(
            f"`time_unit` {shortened(text)}: give {names} or {TIME_UNIT_NAMES[-1]}, or a number of them such "
            "as 10us"
        )
    return text.strip() if found else unit, count.times(*_SIZES[unit])


class StatedTime(NamedTuple):
    """What a time column's header says of its figures; ``unit`` is None where it says nothing."""

    unit: str | None
    factor: UnitFactor = ONE
    origin: str | None = None


def stated_time(place: str, column: ColumnInfo, given: str | None = None) -> StatedTime:
    """Find the unit of a time column of numbers.

    Parameters
    ----------
    place
        The log's name, for messages.
    column
        The time column.
    given
        ``time_unit`` as the user gave it; goes before the header.

    Raises
    ------
    InputError
        The header states a unit that is no known unit of time.
    """
    if given is not None:
        return StatedTime(*parse_time_unit(given))
    if column.unit is None and is_torn(column.quantity):
        raise InputError(_unknown(place, column, column.quantity))
    words = re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column.quantity).lower())
    units = _named_units(words)
    behind = _behind(column.quantity)
    units |= {unit for word in behind if (unit := time_unit(word))}
    if column.unit is not None and column.unit.lower() not in _NO_UNIT:
        since = _SINCE.fullmatch(column.unit)
        unit = time_unit(since["unit"] if since else column.unit)
        if unit is None:
            raise InputError(_unknown(place, column, column.unit))
        own = contradicted_unit(column)
        units |= {_UNIT_OF[own]} if own in _UNIT_OF else set()
        if units - {unit} and not since:
            raise InputError(
                f"{place}: the time column '{column.name}' is in {(units - {unit}).pop()} by its name and in "
                f"{unit} by its unit (`time_unit` says which is right)"
            )
        return StatedTime(unit, UnitFactor(*_SIZES[unit]), since["origin"].strip() if since else None)
    if len(units) == 1:
        unit = units.pop()
        return StatedTime(unit, UnitFactor(*_SIZES[unit]))
    counted = [word for word in words[1:] if word in _COUNTED] or sorted(units) or behind
    if counted:
        raise InputError(_unknown(place, column, counted[0]))
    return StatedTime(None)


def _named_units(words: list[str]) -> set[str]:
    """Find the units among the words of a name, ``nano seconds`` in two words, too."""
    units = set()
    for before, word in zip(["", *words], words, strict=False):
        if word in _WORDS:
            units.add(_UNIT_OF.get(before + word, _UNIT_OF[word]))
    return units


def _behind(quantity: str) -> list[str]:
    """Find what a name states behind ``in`` or a slash, where units stand (Date/Time states none)."""
    found = _STATED.fullmatch(quantity.strip())
    if found is None or found["right"].lower() in _NO_UNIT | _OTHER_HALVES:
        return []
    return [found["right"]]


def is_other_kind(unit: str | None) -> bool:
    """Tell whether a unit measures something that is plainly no time (a temperature called T)."""
    kind = kind_of_unit(unit)
    return kind not in (None, "time", "count", "number of samples") and time_unit(unit or "") is None


def _unknown(place: str, column: ColumnInfo, unit: str) -> str:
    return (
        f"{place}: the time column '{column.name}' counts '{unit}', which is no known unit of time "
        f"(`time_unit` {', '.join(TIME_UNIT_NAMES)} or a number of them such as 10us, or `sample_rate` HZ)"
    )
