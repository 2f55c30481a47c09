"""Which column is the time, and what its figures count; or the rate that is stated instead."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import Clock
from dbo_cli.logs.columns import listed, named, words
from dbo_cli.logs.source import Column, Reading, Source
from dbo_cli.units import kind_of, ratio, time_unit

_NAMES = frozenset(
    "time t x_value zeit timestamp time_stamp timestamps elapsed seconds sec secs millis micros milliseconds "
    "microseconds nanoseconds nanosec msec usec nsec sekunden datetime zeitstempel uhrzeit temps tiempo "
    "tempo date datum datenum tijd tid czas čas cas время 时间 時間 x-axis utc ts epoch clock".split()
)
_KINDS = (None, "time", "count", "number of samples")  # what its unit may measure
# behind the name of a time column they show that it counts something else
_COUNTED = frozenset(
    "tick ticks sample samples frame frames count counts cycle cycles index idx step steps point points "
    "pulses clocks jiffies row rows number no".split()
)
# what stands in the brackets of a time column where other columns have their unit
_NO_UNIT = frozenset(
    "relative rel absolute abs raw local utc gmt elapsed iso start -".split()
)


def find_clock(
    source: Source, reading: Reading, selector: str | None, used: Sequence[Column]
) -> Clock:
    """Find the time column, or the rate that the user or the file states.

    Parameters
    ----------
    source
        The file.
    reading
        ``sample_rate`` and ``time_unit`` as the user gave them.
    selector
        What the user typed for the time, or None.
    used
        Columns that the user named for other roles.

    Raises
    ------
    InputError
        Several columns may be meant, or the unit is none of time.
    UsageError
        ``time`` and ``sample_rate`` are both given.
    """
    rate = reading.sample_rate
    if rate is not None:
        if selector is not None:
            raise UsageError(
                "`time` and `sample_rate` exclude each other: leave one out"
            )
        if not 0.0 < rate < np.inf:
            raise UsageError(f"`sample_rate` {rate:g}: give a rate above 0 Hz")
    if selector is not None:
        matches = [named(source, selector, "time")]
    else:
        matches = _time_columns(source, used, needed=rate is None)
    if rate is not None:
        clock = Clock(source.name, "rate", rate=rate)
        if len(matches) == 1:
            clock.column = matches[0]
            clock.remarks.append(f"`sample_rate` replaces {matches[0].label}")
        return clock
    if len(matches) > 1:
        which = " or ".join(
            f"`time` {column.number} ('{column.name}')" for column in matches
        )
        raise InputError(
            f"{source.name}: which column is the time? Type {which}{source.hint}"
        )
    if matches:
        clock = _clock_of(source.name, matches[0], reading.time_unit)
        clock.rate_beside = source.stated.rate
        return clock
    return _stated_clock(source, reading)


def _stated_clock(source: Source, reading: Reading) -> Clock:
    """Return the clock of a file without a time column."""
    if reading.time_unit is not None:
        raise InputError(
            f"{source.name}: `time_unit` {reading.time_unit}: no time column: "
            f"{listed(source.columns)} (`time` NAME or NUMBER)"
        )
    stated = source.stated
    if stated.problem:
        raise InputError(f"{source.name}: {stated.problem}")
    if stated.rate is None:
        return Clock(source.name)
    return Clock(
        source.name,
        "rate",
        rate=stated.rate,
        start=stated.start,
        remarks=list(stated.remarks),
    )


def _time_columns(source: Source, used: Sequence[Column], needed: bool) -> list[Column]:
    """Return the columns that may hold the time, by the surest reason that there is.

    A name; a word of the name; dates; the unit of the first column. One that cannot be
    read is refused where it is needed (InputError).
    """
    free = [column for column in source.columns if column not in used]
    fitting = [c for c in free if kind_of(c.unit) in _KINDS or time_unit(c.unit)]
    called = [c for c in fitting if c.quantity.lower() in _NAMES]
    called = called or [c for c in fitting if words(c.quantity) & _NAMES]
    figures = [c for c in called if c.kind == "number"]
    stamps = [c for c in called if c.kind == "stamp"]
    matches = figures or stamps or [c for c in free if c.kind == "stamp"]
    texts = [c for c in called if c.kind == "text"]
    if texts and not matches and needed:
        raise InputError(
            f"{source.name}: {texts[0].label} holds neither numbers nor ISO time stamps: type `time` "
            "COLUMN or `sample_rate` HZ"
        )
    if not matches and free[:1] == source.columns[:1] and time_unit(free[0].unit):
        return [column for column in free[:1] if column.kind == "number"]
    return matches


def _clock_of(name: str, column: Column, given: str | None) -> Clock:
    """Return the clock of a time column.

    Raises
    ------
    InputError
        Its figures count something that is no known unit of time.
    """
    if column.kind == "stamp":
        if given is not None:
            raise InputError(
                f"{name}: {column.label} holds time stamps: leave out `time_unit`"
            )
        return Clock(name, "stamps", column, unit="s")
    if given is not None:
        return Clock(
            name, "column", column, parse_time_unit(given), given.strip(), given=True
        )
    unit = _stated_unit(name, column)
    factor = Fraction(1) if unit is None else ratio(unit, "s")
    return Clock(name, "column", column, factor, unit)


def _stated_unit(name: str, column: Column) -> str | None:
    """Return the unit that a time column states; None where it states none."""
    stated = column.unit
    if stated is not None and stated.lower() not in _NO_UNIT:
        since = re.fullmatch(r"(\S+) since .*", stated)
        unit = time_unit(since[1] if since else stated)
        if unit is None:
            _refuse_unit(name, column, stated)
        return unit
    parts = words(column.quantity)
    units = {time_unit(part) for part in parts if len(part) > 1} - {None, "min"}
    if len(units) == 1:
        return units.pop()
    counted = sorted(parts & _COUNTED) or sorted(unit for unit in units if unit)
    if counted:
        _refuse_unit(name, column, counted[0])
    return None


def _refuse_unit(name: str, column: Column, stated: str) -> None:
    raise InputError(
        f"{name}: {column.label}: '{stated}' is not a unit of time: type `time_unit` ms, 10us, "
        "..., or `sample_rate` HZ"
    )


def parse_time_unit(text: str) -> Fraction:
    """Read ``time_unit``: a unit of time, or a number of them (``10us``), in seconds.

    Raises
    ------
    UsageError
        It is none.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)?\s*([^\d\s].*?)\s*", text)
    unit = time_unit(match[2]) if match else None
    count = Fraction((match[1] if match else None) or 1)
    if unit is None or not count:
        raise UsageError(
            f"`time_unit` {text}: give s, ms, us, ns, min, h, or a multiple such as 10us"
        )
    return count * ratio(unit, "s")
