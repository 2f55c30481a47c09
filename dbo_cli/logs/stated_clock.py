"""What a file states of its clock: what the time column counts, and the sample rate or step.

A rate is used only where its meaning is plain.  An attribute called ``sample_rate`` of ``10 kHz`` is 10,000
samples a second; one without a unit is taken in the unit that its name implies (hertz for a rate, seconds
for a step), with a note; a unit that is none of a rate or a step, or two statements that disagree, are
refused as soon as the rate is needed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import contradicted_unit, is_torn, split_header
from dbo_cli.logs.plain_text import clean_text, pattern, shortened
from dbo_cli.logs.sample_block import ColumnInfo
from dbo_cli.logs.units import ONE, TIME_WORDS, UnitFactor, kind_of_unit, parse_factor
from dbo_cli.records import dataclass

FACTORS = {
    "s": ONE, "ms": UnitFactor(1, 10**3), "us": UnitFactor(1, 10**6), "ns": UnitFactor(1, 10**9),
    "ps": UnitFactor(1, 10**12), "min": UnitFactor(60), "h": UnitFactor(3600), "d": UnitFactor(86400),
}  # fmt: skip
"""Every unit of time, in seconds."""
HHMMSS = "hhmmss"
"""How figures such as 120059.500 are called: hours, minutes and seconds in one number."""

_MORE_WORDS = {
    "s": ("s", "sek", "sekunde", "sekunden", "seconde", "secondes", "segundo", "segundos", "secondo",
          "secondi", "с", "сек", "秒"),
    "ms": ("ms", "milli", "millis", "millisekunde", "millisekunden", "millisecondes", "milisegundos",
           "millisecondi", "мс", "毫秒", "ミリ秒"),
    "us": ("us", "micros", "mikrosekunde", "mikrosekunden", "microsecondes", "mus", "mcs", "мкс", "微秒"),
    "ns": ("ns", "nanos", "nanosekunden", "нс"),
    "ps": ("ps", "psec", "psecs", "picosecond"),
    "min": ("min", "mins", "minute", "minuten", "minutos", "minuti", "мин"),
    "h": ("h", "hr", "hrs", "hour", "stunde", "stunden", "std", "heure", "heures", "horas", "ore"),
    "d": ("d", "day", "days", "tag", "tage", "jour", "jours", "dias", "giorni"),
}  # fmt: skip
SPELLINGS = {unit: (*TIME_WORDS.get(unit, ()), *words) for unit, words in _MORE_WORDS.items()}
"""Every known spelling of a unit of time; capitals do not matter (mS in a time column is no conductance)."""

_UNIT_OF = {spelling: unit for unit, spellings in SPELLINGS.items() for spelling in spellings}
_WORDS = frozenset(word for word in _UNIT_OF if len(word) > 1) - {"min", "mins", "std", "ore", "milli"}
"""Spellings that count as the unit wherever they stand in a time column's name (min may be a minimum)."""

_COUNTED = frozenset(
    ("tick", "ticks", "sample", "samples", "frame", "frames", "count", "counts", "cycle", "cycles", "index",
     "idx", "step", "steps", "point", "points", "pulses", "clocks", "jiffies", "row", "rows", "number", "no")
)  # fmt: skip
"""Words that, behind the name of a time column, show that it counts something other than time."""

_NO_UNIT = frozenset(
    ("relative", "rel", "absolute", "abs", "raw", "local", "utc", "gmt", "cet", "elapsed", "iso", "iso8601",
     "start", "since start", "float", "double", "-")
)  # fmt: skip
"""What is written in the brackets of a time column where other columns have their unit."""

_OTHER_HALVES = frozenset(("date", "time", "datum", "zeit", "uhrzeit", "fecha", "hora", "clock", "day"))
# ``Time / ms``, ``ms since 2026-01-02``, ``10us``.
_STATED = pattern(r"(?P<left>.+?)(?:\s*/\s*|\s+in\s+)(?P<right>\S+)", re.IGNORECASE)
_SINCE = pattern(r"(?P<unit>\S+)\s+since\s+(?P<origin>\d.*)", re.IGNORECASE)
_COUNT = pattern(r"(?P<number>\d+(?:\.\d+)?)\s*(?P<unit>[^\d\s.].*)")

# Names of rates and steps without blanks and signs, from the formats and manuals in docs/instruments.md.
_RATES = {"samplerate", "samplingrate", "samplingfrequency", "samplefrequency", "samplingfreq", "samplefreq",
          "acquisitionrate", "acquisitionfrequency", "fs", "srate", "sfreq", "scanrate", "abtastrate",
          "abtastfrequenz", "messfrequenz", "messrate", "framerate", "framespersecond", "samplespersecond",
          "acqrate", "bildrate"}  # fmt: skip
_STEPS = {"wfincrement", "sampleperiod", "samplingperiod", "sampleinterval", "samplinginterval", "sampletime",
          "timestep", "timeincrement", "dt", "deltat", "ts", "tinterval", "xincrement", "xinc", "tinc",
          "abtastintervall", "abtastzeit", "abtastperiode", "timeinterval", "timeresolution"}  # fmt: skip
_BARE = {"rate": "rate", "sampling": "rate", "interval": "step"}  # of what? only the unit shows it
_PER_SECOND = ("Hz", "hz", "HZ", "Hertz", "hertz", "S/s", "Sa/s", "sps", "SPS", "Sps", "samples/s",
               "Samples/s", "sample/s", "samples/sec", "samples/second", "samplespersecond", "scans/s",
               "1/s", "s^-1", "s-1", "/s", "fps", "FPS", "frames/s")  # fmt: skip
_LARGE = {"": 1.0, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
# Hertz for each unit: the SI's prefixes, of the small ones only that of mHz, which nothing else is called.
_HERTZ = {prefix + unit: factor for prefix, factor in _LARGE.items() for unit in _PER_SECOND} | {"mHz": 1e-3}
_AMOUNT = pattern(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(1/s|s\^?-1|[^\d]*?)\s*")
_LONGEST = 80  # characters of a name or of an amount with its unit; the patterns' time grows with the square
_SAME = 1e-6  # rates that differ by less were rounded when the file was written (0.000333333 s, 3000 Hz)


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
    if text.strip().lower().startswith(HHMMSS):
        return HHMMSS, ONE
    found = _COUNT.fullmatch(text.strip())
    unit = time_unit(found["unit"] if found else text)
    count = parse_factor(found["number"]) if found else ONE
    if unit is None or count is None or not count.numerator:
        names = ", ".join(FACTORS).replace(", d", " or d")
        raise UsageError(f"`time_unit` {shortened(text)}: give {names}, or a number of them such as 10us")
    return text.strip() if found else unit, count.times(*FACTORS[unit])


class StatedTime(NamedTuple):
    """What a time column's header states of its figures; ``unit`` is None where it states nothing."""

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
    words = re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column.quantity).lower())
    behind = _behind(column.quantity)
    units = _named_units(words) | {unit for word in behind if (unit := time_unit(word))}
    unknown = ""
    if HHMMSS in column.name.lower():
        return StatedTime(HHMMSS)
    if column.unit is not None and column.unit.lower() not in _NO_UNIT:
        since = _SINCE.fullmatch(column.unit)
        unit = time_unit(since["unit"] if since else column.unit)
        if unit is not None:
            own = contradicted_unit(column)
            units = (units | ({_UNIT_OF[own]} if own in _UNIT_OF else set())) - {unit}
            if units and not since:
                raise InputError(
                    f"{place}: the time column '{column.name}' is in {units.pop()} by its name and in {unit} "
                    "by its unit (`time_unit` says which is right)"
                )
            return StatedTime(unit, FACTORS[unit], since["origin"].strip() if since else None)
        unknown = column.unit
    elif column.unit is None and is_torn(column.quantity):
        unknown = column.quantity
    elif len(units) == 1:
        unit = units.pop()
        return StatedTime(unit, FACTORS[unit])
    else:
        unknown = next(iter([word for word in words[1:] if word in _COUNTED] or sorted(units) or behind), "")
    if unknown:
        raise InputError(
            f"{place}: the time column '{column.name}' counts '{unknown}', which is no known unit of time "
            f"(`time_unit` {', '.join(FACTORS)} or a number of them such as 10us, or `sample_rate` HZ)"
        )
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
    """Return whether a unit measures something that is plainly no time (a temperature called T)."""
    kind = kind_of_unit(unit)
    return kind not in (None, "time", "count", "number of samples") and time_unit(unit or "") is None


@dataclass(frozen=True)
class Statement:
    """What one place of a file states of the clock: samples a second, or why it cannot be used.

    ``assumed`` is the unit that was taken where none was given.
    """

    text: str
    rate: float | None
    problem: str = ""
    assumed: str = ""


def is_clock_name(name: str) -> bool:
    """Return whether an attribute, variable or header line of this name states a rate or a step."""
    return bool(_kind_of(name)[0])


def _kind_of(name: str) -> tuple[str, str, str | None]:
    """Give ``rate``, ``step`` or nothing for a name, its plain spelling, and the unit that it carries."""
    if len(name) > _LONGEST:
        return "", "", None
    quantity, unit = split_header(name)
    key = re.sub(r"[\s_\-.]+", "", quantity).lower()
    if key.endswith("hz") and key.removesuffix("hz") in _RATES:
        key, unit = key.removesuffix("hz"), unit or "Hz"
    return ("rate" if key in _RATES else "step" if key in _STEPS else _BARE.get(key, "")), key, unit


def read_statements(name: str, value: object, unit: object = None, *, sure: bool = False) -> list[Statement]:
    """Read an attribute, variable or header line as a statement of rate or step; none where it is none.

    Parameters
    ----------
    name
        How the file calls it (``sample_rate``, ``fs``, ``SampleTime[ms]``, ``dt_us``).
    value
        A number, one in an array, or text such as ``10 kHz``.
    unit
        A unit that the file gives beside it.
    sure
        The format itself defines the unit (seconds or hertz), so that nothing is assumed without one.
    """
    kind, key, own = _kind_of(name)
    if not kind:
        return []
    count, amount, written, shown = _taken_apart(value)
    stated = clean_text(unit).strip() if unit is not None else ""
    stated = stated or written or own or ""
    if key in _BARE and (not stated or _factor(kind, stated) is None):
        return []
    text = f"'{name}' {shown}" + (f" {stated}" if stated and stated not in shown else "")
    if amount is None:
        # Text and lists under the name of a step are time stamps (``ts``) more often than steps.
        return [Statement(text, None, f"{text} is no single number")] if kind == "rate" and count > 1 else []
    if not amount > 0.0 or not math.isfinite(amount):
        return []  # what an instrument writes when it does not know
    factor = _factor(kind, stated)
    if factor is None:
        proper = "a rate (Hz, kHz, S/s)" if kind == "rate" else "a time step (s, ms, us)"
        return [Statement(text, None, f"{text} is not in a unit of {proper}")]
    rate = amount * factor if kind == "rate" else factor / amount
    return [Statement(text, rate, assumed="" if stated or sure else "Hz" if kind == "rate" else "s")]


def agreed_rate(place: str, statements: Iterable[Statement], notes: list[str]) -> float | None:
    """Return the one sample rate (Hz) that all statements give; None without any.

    Raises
    ------
    InputError
        A statement cannot be read, or two disagree; ``sample_rate`` is the remedy.
    """
    found = list(dict.fromkeys(statements))
    for one in sorted(found, key=lambda one: one.rate is not None):  # what cannot be read goes first
        if one.rate is None:
            raise InputError(f"{place}: {one.problem} (`sample_rate` HZ gives the rate instead)")
        rate = found[0].rate or 0.0
        if abs(one.rate - rate) > _SAME * rate:
            raise InputError(
                f"{place}: two sample rates are stated, {found[0].text} and {one.text}: which one holds? "
                "(`sample_rate` HZ decides)"
            )
    if not found:
        return None
    chosen = next((one for one in found if not one.assumed), found[0])
    if chosen.assumed:
        notes.append(f"{place}: {chosen.text} has no unit: {chosen.assumed} is assumed")
    return chosen.rate


def _taken_apart(value: object) -> tuple[int, float | None, str, str]:
    """Count a value, and return its one number (or None), the unit behind it, and how it is shown."""
    if isinstance(value, str | bytes):
        text = clean_text(value).strip()
        found = _AMOUNT.fullmatch(text) if len(text) <= _LONGEST else None
        return 1, float(found[1]) if found else None, found[2] if found else "", shortened(text)
    try:
        array = np.asarray(value).ravel()
    except ValueError:  # a list of lists of unlike lengths
        return 2, None, "", "(several values)"
    if array.size == 1 and isinstance(array[0], str | bytes):
        return _taken_apart(array[0])
    numbers = array.size > 0 and array.dtype.kind in "fiub"
    amount = float(array[0]) if numbers and not np.any(array != array[0]) else None
    if array.size != 1:
        return array.size, amount, "", f"({array.size} values)"
    return 1, amount, "", f"{array[0]:g}" if numbers else shortened(clean_text(array[0]))


def _factor(kind: str, unit: str) -> float | None:
    """Give samples a second per unit of a rate, or units a second of a step; None for an unknown unit."""
    plain = unit.strip().strip("[]()").strip()
    if not plain:
        return 1.0
    if kind == "rate":
        return _HERTZ.get(plain.replace(" ", ""))
    plain = plain.replace(" ", "").replace("µ", "u").replace("μ", "u")
    for suffix in ("/sample", "/S", "/Sa", "persample"):
        plain = plain.removesuffix(suffix)
    size = FACTORS.get(time_unit(plain) or "")  # dividing keeps 0.1 ms at exactly 10,000 samples a second
    return None if size is None else size.denominator / size.numerator


# ---- dates and clock times in cells, read as seconds
#
# Dates count from 1970-01-01 (no zone given: as if UTC), clock times from midnight. The arithmetic is on
# whole numbers, so that a stamp becomes the float64 nearest to it.

DAY = 86400  # s
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_MONTH_FIRST = pattern(r"(?P<month>\d{1,2})/(?P<day>\d{1,2})/(?P<year>\d{4}|\d\d)")
_DATES = (
    pattern(r"(?P<year>\d{4})([-/.])(?P<month>\d{1,2})\2(?P<day>\d{1,2})"),
    pattern(r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)"),
    pattern(r"(?P<day>\d{1,2})([-.])(?P<month>\d{1,2})\2(?P<year>\d{4}|\d\d)"),
    _MONTH_FIRST,
    pattern(r"(?P<day>\d{1,2})[- ](?P<month>[A-Za-z]{3})[- ](?P<year>\d{4})"),
)
_CLOCK = pattern(
    r"(?:(?P<days>\d{1,5}) days?,? )?(?P<hours>\d{1,3}):(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]?\d)"
    r"(?:[.,](?P<fraction>\d{1,20})|:(?P<millis>\d{3}))?(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_MINUTES = pattern(r"(?P<minutes>\d{1,3}):(?P<seconds>[0-5]\d)[.,](?P<fraction>\d{1,20})")
_STAMP = pattern(
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
    if found.re.pattern == _MONTH_FIRST.pattern and month > 12:
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
