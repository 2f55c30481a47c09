"""The clock of a log: the time column as seconds, the sample rate that a file states, and what is doubtful.

Figures whose unit is not stated are read as seconds, unless they can only be a
calendar's (milliseconds since 1970, a spreadsheet's days). What is read without being
stated is warned of, with the remedy.

A rate is used only where its meaning is plain. An attribute called ``sample_rate`` of
``10 kHz`` is 10,000 samples a second; one without a unit is taken in the unit that its
name implies (hertz for a rate, seconds for a step), with a note; a unit that is none of
a rate or a step, or two statements that disagree, are refused as soon as the rate is
needed.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, NoReturn

import numpy as np

from dbo_cli.errors import InputError, clean_text, shortened
from dbo_cli.logs.columns import (
    MORE_TIME_NAMES,
    TIME_NAMES,
    any_of,
    contradicted_unit,
    find_column,
    guess_columns,
    is_torn,
    split_header,
)
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import (
    TIME,
    Column,
    FloatArray,
    Places,
    SampleBlock,
    TimeCheck,
)
from dbo_cli.logs.units import (
    FACTORS,
    HHMMSS,
    ONE,
    UNIT_OF,
    UnitFactor,
    kind_of_unit,
    parse_time_unit,
    time_unit,
)

# --- what a file states ---

_WORDS = frozenset(word for word in UNIT_OF if len(word) > 1) - {
    "min",
    "mins",
    "std",
    "ore",
    "milli",
}
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

_OTHER_HALVES = frozenset(
    ("date", "time", "datum", "zeit", "uhrzeit", "fecha", "hora", "clock", "day")
)
# ``Time / ms``, ``ms since 2026-01-02``, ``10us``.
_STATED = re.compile(r"(?P<left>.+?)(?:\s*/\s*|\s+in\s+)(?P<right>\S+)", re.IGNORECASE)
_SINCE = re.compile(r"(?P<unit>\S+)\s+since\s+(?P<origin>\d.*)", re.IGNORECASE)

# Names of rates and steps without blanks and signs, from the formats and manuals in
# docs/instruments.md.
_RATES = {"samplerate", "samplingrate", "samplingfrequency", "samplefrequency", "samplingfreq", "samplefreq",
          "acquisitionrate", "acquisitionfrequency", "fs", "srate", "sfreq", "scanrate", "abtastrate",
          "abtastfrequenz", "messfrequenz", "messrate", "framerate", "framespersecond", "samplespersecond",
          "acqrate", "bildrate"}  # fmt: skip
_STEPS = {"wfincrement", "sampleperiod", "samplingperiod", "sampleinterval", "samplinginterval", "sampletime",
          "timestep", "timeincrement", "dt", "deltat", "ts", "tinterval", "xincrement", "xinc", "tinc",
          "abtastintervall", "abtastzeit", "abtastperiode", "timeinterval", "timeresolution"}  # fmt: skip
# of what? only the unit shows it
_BARE = {"rate": "rate", "sampling": "rate", "interval": "step"}
_PER_SECOND = ("Hz", "hz", "HZ", "Hertz", "hertz", "S/s", "Sa/s", "sps", "SPS", "Sps", "samples/s",
               "Samples/s", "sample/s", "samples/sec", "samples/second", "samplespersecond", "scans/s",
               "1/s", "s^-1", "s-1", "/s", "fps", "FPS", "frames/s")  # fmt: skip
_LARGE = {"": 1.0, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
# Hertz for each unit: the SI's prefixes, of the small ones only that of mHz, which
# nothing else is called.
_HERTZ = {
    prefix + unit: factor for prefix, factor in _LARGE.items() for unit in _PER_SECOND
} | {"mHz": 1e-3}
_AMOUNT = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(1/s|s\^?-1|[^\d]*?)\s*"
)
# characters of a name or of an amount with its unit; the patterns' time grows with the
# square
_LONGEST = 80
# rates that differ by less were rounded when the file was written (0.000333333 s, 3000
# Hz)
_SAME = 1e-6


def _with_stated_unit(clock: Clock, column: Column) -> Clock:
    """Return a clock whose figures are in the unit that their header states.

    Raises
    ------
    InputError
        The header states a unit that is no known unit of time.
    """
    if HHMMSS in column.name.lower():
        return replace(clock, unit=HHMMSS)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column.quantity)
    words = re.findall(r"[^\W_]+", spaced.lower())
    behind = _behind(column.quantity)
    units = _named_units(words)
    units.update(filter(None, map(time_unit, behind)))
    if column.unit is not None and column.unit.lower() not in _NO_UNIT:
        return _with_unit_of_column(clock, column, column.unit, units)
    if column.unit is None and is_torn(column.quantity):
        _refuse_unit(clock, column.quantity)
    if len(units) == 1:
        unit = units.pop()
        return replace(clock, unit=unit, factor=FACTORS[unit])
    counted = [word for word in words[1:] if word in _COUNTED]
    unclear = counted or sorted(units) or behind
    if unclear:
        _refuse_unit(clock, unclear[0])
    return clock


def _with_unit_of_column(
    clock: Clock, column: Column, stated: str, named: set[str]
) -> Clock:
    """Return a clock in the unit that a column has; ``named`` are those that its name holds."""
    since = _SINCE.fullmatch(stated)
    if since is not None:
        unit = time_unit(since["unit"])
        if unit is None:
            _refuse_unit(clock, stated)
        origin = since["origin"].strip()
        return replace(clock, unit=unit, factor=FACTORS[unit], origin=origin)
    unit = time_unit(stated)
    if unit is None:
        _refuse_unit(clock, stated)
    contrary = named - {unit}
    in_name = contradicted_unit(column)
    if in_name in UNIT_OF and UNIT_OF[in_name] != unit:
        contrary.add(UNIT_OF[in_name])
    if contrary:
        raise InputError(
            f"{clock._called} is in {contrary.pop()} by its name and in {unit} "
            "by its unit (`time_unit` says which is right)"
        )
    return replace(clock, unit=unit, factor=FACTORS[unit])


def _refuse_unit(clock: Clock, unit: str) -> NoReturn:
    """Refuse a unit that is no known one of time (InputError)."""
    raise InputError(
        f"{clock._called} counts '{unit}', which is no known unit of time "
        f"(`time_unit` {', '.join(FACTORS)} or a number of them such as 10us, or `sample_rate` HZ)"
    )


def _named_units(words: list[str]) -> set[str]:
    """Find the units among the words of a name, ``nano seconds`` in two words, too."""
    units = set()
    for before, word in zip(["", *words], words, strict=False):
        if word in _WORDS:
            units.add(UNIT_OF.get(before + word, UNIT_OF[word]))
    return units


def _behind(quantity: str) -> list[str]:
    """Find what a name states behind ``in`` or a slash, where units stand (Date/Time states none)."""
    match = _STATED.fullmatch(quantity.strip())
    if match is None or match["right"].lower() in _NO_UNIT | _OTHER_HALVES:
        return []
    return [match["right"]]


def is_other_kind(unit: str | None) -> bool:
    """Return whether a unit measures something that is plainly no time (a temperature called T)."""
    kind = kind_of_unit(unit)
    return (
        kind not in (None, "time", "count", "number of samples")
        and time_unit(unit or "") is None
    )


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
        key = key.removesuffix("hz")
        unit = unit or "Hz"
    if key in _RATES:
        return "rate", key, unit
    if key in _STEPS:
        return "step", key, unit
    return _BARE.get(key, ""), key, unit


def read_statements(
    name: str, value: object, unit: object = None, *, sure: bool = False
) -> list[Statement]:
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
        The format itself defines the unit (seconds or hertz), so that nothing is
        assumed without one.
    """
    kind, key, unit_in_name = _kind_of(name)
    if not kind:
        return []
    count, amount, unit_in_value, shown = _taken_apart(value)
    stated = "" if unit is None else clean_text(unit).strip()
    stated = stated or unit_in_value or unit_in_name or ""
    if key in _BARE and (not stated or _factor(kind, stated) is None):
        return []
    text = f"'{name}' {shown}"
    if stated and stated not in shown:
        text = f"{text} {stated}"
    if amount is None:
        # Text and lists under the name of a step are time stamps (``ts``) more often
        # than steps.
        if kind != "rate" or count <= 1:
            return []
        return [Statement(text, None, f"{text} is no single number")]
    if not amount > 0.0 or not math.isfinite(amount):
        return []  # what an instrument writes when it does not know
    factor = _factor(kind, stated)
    if kind == "rate":
        proper = "a rate (Hz, kHz, S/s)"
        assumed = "Hz"
    else:
        proper = "a time step (s, ms, us)"
        assumed = "s"
    if factor is None:
        return [Statement(text, None, f"{text} is not in a unit of {proper}")]
    rate = amount * factor if kind == "rate" else factor / amount
    if stated or sure:
        assumed = ""
    return [Statement(text, rate, assumed=assumed)]


def agreed_rate(
    place: str, statements: Iterable[Statement], notes: list[str]
) -> float | None:
    """Return the one sample rate (Hz) that all statements give; None without any.

    Raises
    ------
    InputError
        A statement cannot be read, or two disagree; ``sample_rate`` is the remedy.
    """
    unlike = list(dict.fromkeys(statements))
    for statement in unlike:
        if statement.rate is None:
            raise InputError(
                f"{place}: {statement.problem} (`sample_rate` HZ gives the rate instead)"
            )
    for statement in unlike:
        first = unlike[0].rate or 0.0
        if abs((statement.rate or 0.0) - first) > _SAME * first:
            raise InputError(
                f"{place}: two sample rates are stated, {unlike[0].text} and {statement.text}: "
                "which one holds? (`sample_rate` HZ decides)"
            )
    if not unlike:
        return None
    with_unit = [statement for statement in unlike if not statement.assumed]
    chosen = (with_unit or unlike)[0]
    if chosen.assumed:
        notes.append(f"{place}: {chosen.text} has no unit: {chosen.assumed} is assumed")
    return chosen.rate


def hertz(unit: str) -> float | None:
    """Return how many hertz a unit of a rate is (``kHz``, ``S/s``), or None where it is none."""
    return _HERTZ.get(unit.strip().replace(" ", ""))


def _taken_apart(value: object) -> tuple[int, float | None, str, str]:
    """Count a value, and return its one number (or None), the unit behind it, and how it is shown."""
    if isinstance(value, str | bytes):
        text = clean_text(value).strip()
        match = _AMOUNT.fullmatch(text) if len(text) <= _LONGEST else None
        if match is None:
            return 1, None, "", shortened(text)
        return 1, float(match[1]), match[2], shortened(text)
    try:
        array = np.asarray(value).ravel()
    except ValueError:  # a list of lists of unlike lengths
        return 2, None, "", "(several values)"
    if array.size == 1 and isinstance(array[0], str | bytes):
        return _taken_apart(array[0])
    numbers = array.size > 0 and array.dtype.kind in "fiub"
    amount = None
    if numbers and not np.any(array != array[0]):
        amount = float(array[0])
    if array.size != 1:
        return array.size, amount, "", f"({array.size} values)"
    if numbers:
        return 1, amount, "", f"{array[0]:g}"
    return 1, amount, "", shortened(clean_text(array[0]))


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
    # dividing keeps 0.1 ms at exactly 10,000 samples a second
    size = FACTORS.get(time_unit(plain) or "")
    if size is None:
        return None
    return size.denominator / size.numerator


# --- the time column ---

DATE = "the date"  # the place among the roles of the column of dates beside clock times

_TEN_MILLION = 10**7  # ticks a second of clocks that count 100 ns
_SECONDS = ("sec", "secs", "second", "seconds")


class _Calendar(NamedTuple):
    """Figures between ``low`` and ``high`` that count ``factor`` seconds each from a known date."""

    name: str
    low: float
    high: float
    factor: UnitFactor
    offset: float = 0.0  # s, added to count from 1970


# Each range spans the years 2000 to about 2050 (1e9 s after 1970 was in 2001): no log
# is older than the instruments that write such stamps, and the ranges of neighbouring
# units lie a factor of 250 apart.
_CALENDARS = (
    _Calendar("s since 1970", 1e9, 4.1e9, ONE),
    _Calendar("ms since 1970", 9e11, 4.1e12, UnitFactor(1, 10**3)),
    _Calendar("us since 1970", 9e14, 4.1e15, UnitFactor(1, 10**6)),
    _Calendar(
        "100 ns since 1601",
        1.25e17,
        1.45e17,
        UnitFactor(1, _TEN_MILLION),
        -11_644_473_600.0,
    ),
    _Calendar(
        "100 ns since year 1",
        6.3e17,
        6.5e17,
        UnitFactor(1, _TEN_MILLION),
        -62_135_596_800.0,
    ),
    _Calendar("ns since 1970", 9e17, 4.1e18, UnitFactor(1, 10**9)),
)
# Excel's and LibreOffice's serial dates, and MATLAB's datenum.
_DAY_CALENDARS = (
    _Calendar(
        "days since 1899-12-30",
        36_526.0,
        55_153.0,
        UnitFactor(86_400),
        -25_569.0 * 86_400.0,
    ),
    _Calendar(
        "days since year 0",
        730_486.0,
        749_113.0,
        UnitFactor(86_400),
        -719_529.0 * 86_400.0,
    ),
)
# Stamps near 45,000 are a spreadsheet's days or the seconds of a day. 2e-5 s would be
# 50,000 samples a second by a clock that has run for half a day; 2e-5 days are 1.7 s,
# slower than any log of a hysteresis loop. Up to ten times as much, either may be
# meant.
_DAY_STEP = 2e-5
# After how many seconds a clock begins anew, and how that moment is called.
_BITS = (8, 16, 24, 31, 32)  # of the counters of microcontrollers and cards
_PERIODS = {"clock": (86_400.0, "midnight"), "minutes": (3_600.0, "the full hour")}
_WRITTEN_AS = {
    "stamp": "dates and clock times",
    "clock": "clock times",
    "minutes": "minutes and seconds",
}
_PLAIN_NAMES = frozenset(TIME_NAMES) - {"t"}  # T is a temperature as often as a time
_DATE_WORDS = (
    "date",
    "datum",
    "timestamp",
    "datetime",
    "serial",
    "datenum",
    "excel",
    "zeitstempel",
)

# A loop takes seconds and holds hundreds of samples: whoever logs one each second or
# slower states it.
LONG_STEP = 1.0
# No loop is recorded at less than a sample an hour, whatever the header states.
LONGEST_STEP = 3600.0
# 1e8 s are three years; a clock that counts seconds of a run never gets there.
LATEST_STAMP = 1e8
# A piezo under load does not pass its range in a millisecond: figures that end before
# count hours or days.
SHORTEST_LOG = 1e-3
# A sensor's column taken for the time goes back in about half of its rows, a clock set
# by a server once.
BACKWARD_SHARE = 0.05


def _calendar_at(stamp: float) -> _Calendar | None:
    """Return the calendar that a first stamp without a unit can only belong to."""
    for calendar in (*_CALENDARS, *_DAY_CALENDARS):
        if calendar.low <= stamp < calendar.high:
            return calendar
    return None


@dataclass
class Clock:
    """Where the times of a log's rows come from: a column of stamps, a rate, or nothing.

    Attributes
    ----------
    place
        The log's name, for messages.
    column
        The column of stamps; None where a rate makes the times, or nothing does.
    date
        The column of dates beside a column of clock times, or of parts of a second
        beside one of seconds; or None.
    unit, factor
        What the stamps are counted in, and how they become seconds; ``unit`` is None
        where nothing states it.
    origin
        From when they count, as the header writes it.
    given
        The unit is certain, so that nothing is doubted: the user gave it, or the cells
        say it.
    part
        Seconds in one count of ``date``, where that is a part of a second.
    described
        How the figures are read, for the line on what was read: ``ms``, ``clock
        times``.
    rate, start
        Without a column: samples a second (Hz), and the time (s) of the first row.
    taken
        The columns that no other role may take.
    notes
        What is worth knowing about the clock.
    """

    place: str
    column: Column | None = None
    date: Column | None = None
    unit: str | None = None
    factor: UnitFactor = ONE
    origin: str = ""
    given: bool = False
    part: UnitFactor | None = None
    described: str = ""
    rate: float | None = None
    start: float = 0.0
    taken: list[Column] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _calendar: _Calendar | None = None
    _last: float | None = None
    _carried: float = 0.0
    _whole: bool = True
    _doubt: str = ""

    @property
    def is_known(self) -> bool:
        """Whether rows have times."""
        return self.column is not None or self.rate is not None

    @property
    def picks(self) -> dict[str, Column]:
        """The columns to be read, by their places among the roles."""
        picks = {}
        if self.column is not None:
            picks[TIME] = self.column
        if self.date is not None:
            picks[DATE] = self.date
        return picks

    @property
    def written(self) -> str:
        """How the stamps are written (``Column.written``); empty without a column."""
        return "" if self.column is None else self.column.written

    @property
    def bare(self) -> bool:
        """Whether figures stand without a unit."""
        return self.written == "numbers" and self.unit is None

    @property
    def _called(self) -> str:
        """How messages call the column of stamps."""
        assert self.column is not None
        return f"{self.place}: the time column '{self.column.name}'"

    def reading(self) -> str:
        """Return how the column is read: its unit, or that there is none."""
        if self.described:
            return self.described
        if self.unit is None:
            return "no unit, read as s"
        if self.origin:
            return f"{self.unit} since {self.origin}"
        return self.unit

    def held_back(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock]:
        """Keep blocks until it is known what the figures count: at most until the second time stamp."""
        if not self.bare:
            return blocks
        waiting: list[SampleBlock] = []
        figures = np.empty(0)
        for block in blocks:
            waiting.append(block)
            figures = np.concatenate([figures, block.values[TIME]])
            if self._decide(figures, last=False):
                break
        else:
            self._decide(figures, last=True)
        return itertools.chain(waiting, blocks)

    def whole(self, figures: FloatArray, warnings: list[str]) -> FloatArray:
        """Return a whole column in seconds; what is doubtful about it is added to ``warnings``."""
        if self.bare:
            self._decide(figures, last=True)
        seconds = self.seconds({TIME: figures})
        check = TimeCheck(self.place)
        check.feed(SampleBlock(range(1, len(seconds) + 1), None, seconds, {}))
        check.notes()  # brings the last of the stamps into the account
        warnings.extend(self.warnings(check))
        return seconds

    def seconds(self, values: dict[str, FloatArray]) -> FloatArray:
        """Take the stamps out of a block's columns and return them in seconds."""
        raw = values.pop(TIME)
        dates = values.pop(DATE, None)
        if dates is not None:
            return raw + self._dates(dates)
        if self.written in _PERIODS:
            return self._unrolled(raw, *_PERIODS[self.written])
        if self.written != "numbers" or not len(raw):
            return raw
        if self.unit == HHMMSS:
            return self._unrolled(self._since_midnight(raw), *_PERIODS["clock"])
        self._whole = self._whole and bool((raw == np.rint(raw)).all())
        if self._calendar is not None:
            return self._calendar.factor.apply(raw) + self._calendar.offset
        return self.factor.apply(raw)

    def _dates(self, dates: FloatArray) -> FloatArray:
        """Return in seconds what the column of dates (or of parts of a second) adds to the stamps."""
        if self.part is None or self.date is None:
            return dates
        dates = self.part.apply(dates)
        inside = bool(((dates >= 0.0) & (dates < 1.0)).all())
        odd = f"has a part of a second in '{self.date.name}', which holds more than one"
        self._require(inside, odd)
        return dates

    def _since_midnight(self, figures: FloatArray) -> FloatArray:
        """Return figures such as 142530 (14:25:30) in seconds."""
        minutes, seconds = np.divmod(figures, 100.0)
        hours, minutes = np.divmod(minutes, 100.0)
        below_60 = bool((seconds < 60.0).all() and (minutes < 60.0).all())
        self._require(below_60, f"is no {HHMMSS}")
        return hours * 3600.0 + minutes * 60.0 + seconds

    def times(self, rows: Places, values: dict[str, FloatArray]) -> FloatArray | None:
        """Return the times (s) of rows, and take the stamps out of the columns; None where they have none."""
        if self.column is not None:
            return self.seconds(values)
        if self.rate is None:
            return None
        numbers = np.asarray(rows, dtype=np.float64)
        return self.start + (numbers - 1.0) / self.rate

    def _require(self, right: bool, problem: str) -> None:
        """Refuse figures that are not what the header states (InputError)."""
        if not right:
            raise InputError(
                f"{self._called} {problem} (`sample_rate` HZ gives the time instead)"
            )

    def periods(self) -> tuple[float, ...]:
        """Return after how many seconds a counter begins anew: of bits, or of a minute, an hour, a day."""
        if self.written != "numbers" or self._calendar is not None:
            return ()
        count = float(self.factor.apply(np.ones(1))[0])
        return (*(2.0**bits * count for bits in _BITS), 1.0, 60.0, 3600.0, 86400.0)

    def _decide(self, figures: FloatArray, last: bool) -> bool:
        """Look for a calendar in the first stamps; False where a second one is needed."""
        first = float(figures[0]) if len(figures) else 0.0
        calendar = _calendar_at(first)
        if calendar is None:
            return True
        if calendar in _DAY_CALENDARS and not self._is_called_a_date():
            later = figures[figures != first]
            if not len(later) and not last:
                return False
            step = abs(float(later[0]) - first) if len(later) else np.inf
            if step >= _DAY_STEP:
                if step < 10.0 * _DAY_STEP:
                    self._doubt = calendar.name
                return True
        self._calendar = calendar
        self.described = f"no unit, read as {calendar.name}"
        return True

    def _is_called_a_date(self) -> bool:
        """Return whether the column's name says that it counts days of a calendar."""
        name = "" if self.column is None else self.column.name.lower()
        return any(word in name for word in _DATE_WORDS)

    def _unrolled(self, raw: FloatArray, period: float, what: str) -> FloatArray:
        """Let a clock go on where it passes midnight (or, of minutes alone, the full hour)."""
        if not len(raw):
            return raw
        before = raw[0] if self._last is None else self._last
        steps = np.diff(raw, prepend=before)
        self._last = float(raw[-1])
        passed = steps < -period / 2.0
        if not passed.any() and not self._carried:
            return raw
        if not self._carried:
            self.notes.append(f"{self.place}: the clock passes {what} and goes on")
        carried = self._carried + period * np.cumsum(passed)
        self._carried = float(carried[-1])
        return raw + carried

    def warnings(self, check: TimeCheck) -> list[str]:
        """Return what is doubtful about the figures, with the remedy, once all of them have gone by."""
        doubts = []
        rows = check.rows
        if self.bare and not self.given and rows > 1:
            doubts.append(self._of_figures(check))
        if check.backward.count > BACKWARD_SHARE * rows:
            doubts.append(
                f"goes backwards in {check.backward.count:,} of {rows:,} rows: is it a clock? "
                "(`time` COLUMN or `sample_rate` HZ)"
            )
        elif check.repeat.count > rows / 2:
            doubts.append(
                f"repeats its stamps in {check.repeat.count:,} of {rows:,} rows: they have too few "
                "digits for the rate of the log (`sample_rate` HZ gives the time instead)"
            )
        if self.written == "numbers" and not self.bare and not self.given:
            doubts.append(self._of_stated(check))
        return [f"{self._called} {doubt}" for doubt in filter(None, doubts)]

    def _of_stated(self, check: TimeCheck) -> str:
        """Return why figures can hardly be in the unit that is stated."""
        first = check.first
        last = check.last or 0.0
        step = check.step
        if abs(last) > _CALENDARS[0].high:
            odd = f"its stamps would be {last:.3g} s"
        elif check.rows > 1 and 0.0 < abs(last - first) < SHORTEST_LOG:
            odd = f"the whole log would last {abs(last - first):.3g} s"
        elif LONGEST_STEP < step < np.inf:
            odd = f"its usual step would be {step:.3g} s"
        else:
            return ""
        return f"is stated in {self.unit}, but {odd} (`time_unit` says what it counts)"

    def _of_figures(self, check: TimeCheck) -> str:
        """Return why figures without a unit can hardly be seconds."""
        first = check.first
        last = check.last or 0.0
        step = check.step
        remedy = (
            "(`time_unit` ms, us, … or s says what they count, or `sample_rate` HZ)"
        )
        if self._doubt:
            return (
                f"has no unit: stamps from {first:.6g} on are read as seconds of a day, but may be "
                f"{self._doubt} (`time_unit` s or d)"
            )
        if self._calendar is not None:
            if LONG_STEP < step < np.inf:
                return (
                    f"has {self.described}, and a usual step of {step:.4g} s {remedy}"
                )
            if self._calendar in _DAY_CALENDARS:
                return (
                    f"has {self.described} (`time_unit` s if they are seconds of a day)"
                )
            return ""
        if self._whole and step == 1.0:
            return (
                "has no unit and counts whole numbers one by one: read as seconds, though it may count rows "
                f"or milliseconds {remedy}"
            )
        before = check.gap.before
        after = check.gap.after
        if check.gap.count and _turns_a_minute(before, after):
            asked = "are these hours, minutes and seconds?"
            return (
                f"goes from {before:.7g} to {after:.7g}: {asked} (`time_unit` {HHMMSS})"
            )
        if LONG_STEP <= step < np.inf:
            odd = f"its usual step is {step:.6g} s"
        elif max(abs(first), abs(last)) > LATEST_STAMP:
            odd = f"its stamps reach {last:.6g} s"
        elif 0.0 < abs(last - first) < SHORTEST_LOG:
            odd = f"the whole log lasts {abs(last - first):.3g} s"
        else:
            return ""
        return f"has no unit: read as seconds, {odd} {remedy}"


def _turns_a_minute(before: float, after: float) -> bool:
    """Return whether a jump is one from 142559 to 142600 or from 145959 to 150000."""
    ends = before % 100.0 >= 59.0 and after % 100.0 < 1.0
    return ends and after - before < 4041.0


def clock_of(
    place: str,
    column: Column,
    columns: Sequence[Column],
    given: str | None = None,
) -> Clock:
    """Return the clock of a column of stamps; the dates beside clock times are looked for.

    Parameters
    ----------
    place
        The log's name, for messages.
    column
        The column that holds the time.
    columns
        All columns of the log.
    given
        ``time_unit`` as the user gave it; goes before the header.

    Raises
    ------
    InputError
        Its unit is no known unit of time, or it holds dates without a time of day.
    """
    clock = Clock(place, column)
    if column.written != "numbers":
        clock = _clock_of_texts(clock, column, columns, given)
    elif given is not None:
        unit, factor = parse_time_unit(given)
        clock = replace(clock, unit=unit, factor=factor, given=True)
    else:
        clock = _clock_of_figures(clock, column, columns)
    clock.taken = list(clock.picks.values())
    return clock


def _clock_of_figures(clock: Clock, column: Column, columns: Sequence[Column]) -> Clock:
    """Return the clock of a column of numbers, with the parts of a second beside it."""
    beside = _part_beside(column, columns)
    if beside is None:
        return _with_stated_unit(clock, column)
    part, unit = beside
    return replace(
        clock,
        date=part,
        unit="s",
        given=True,
        part=FACTORS[unit],
        described=f"s and {unit} in '{part.name}'",
    )


def _clock_of_texts(
    clock: Clock,
    column: Column,
    columns: Sequence[Column],
    given: str | None,
) -> Clock:
    """Return the clock of a column of dates, clock times or both."""
    if given is not None:
        raise InputError(
            f"{clock._called} holds dates or clock times, which say by themselves "
            "what they count (leave out `time_unit`)"
        )
    if column.written == "date":
        raise InputError(
            f"{clock.place}: column '{column.name}' holds dates without a time of day "
            "(`time` the column of clock times, whose dates are taken from here)"
        )
    date = None
    described = _WRITTEN_AS[column.written]
    dates = [beside for beside in columns if beside.written == "date"]
    if column.written == "clock" and len(dates) == 1:
        date = dates[0]
        described = f"clock times, dates in '{date.name}'"
    return replace(
        clock,
        column=replace(column, unit=None),
        date=date,
        unit="s",
        given=True,
        described=described,
    )


def find_clock(
    place: str,
    columns: list[Column],
    options: ReadingOptions,
    named: Sequence[Column],
) -> Clock:
    """Find the time column; a sample rate given by the user replaces one that was only guessed.

    Parameters
    ----------
    place
        The log's name, for messages.
    columns
        What the log has.
    options
        How it is to be read: ``time``, ``time_unit``, ``sample_rate``.
    named
        The columns that the user named for other roles.

    Raises
    ------
    InputError
        Several columns may be meant, or what the column's figures count is not known.
    """
    if options.time is not None:
        candidates = [find_column(place, columns, options.time, "time")]
    else:
        used = {column.number for column in named}
        candidates = _time_candidates(
            [column for column in columns if column.number not in used]
        )
    if options.sample_rate is not None:
        clock = Clock(place, rate=options.sample_rate)
        if candidates:
            replaced = candidates[0].name
            clock.notes.append(
                f"{place}: `sample_rate` replaces the column '{replaced}'"
            )
        if len(candidates) == 1:
            clock.taken = candidates
        return clock
    if len(candidates) > 1:
        names = any_of(_told_apart(candidates))
        raise InputError(
            f"{place}: which column is the time, {names}? (choose with `time` NAME or NUMBER)"
        )
    if not candidates:
        return Clock(place)
    return clock_of(place, candidates[0], columns, options.time_unit)


def _told_apart(columns: Sequence[Column]) -> list[str]:
    """Return the names of columns as messages list them, with numbers where two have one name."""
    names = {column.name for column in columns}
    if len(names) == len(columns):
        return [f"'{column.name}'" for column in columns]
    return [f"{column.number} '{column.name}'" for column in columns]


def _part_beside(
    column: Column, columns: Sequence[Column]
) -> tuple[Column, str] | None:
    """Find the parts of a second beside a column of seconds (``sec``, ``nanosec``), and their unit."""
    start, word = _last_word(column.name)
    if word not in _SECONDS:
        return None
    parts = []
    for beside in columns:
        start_beside, word_beside = _last_word(beside.name)
        unit = time_unit(word_beside)
        if beside.written != "numbers" or start_beside != start:
            continue
        if unit in ("ms", "us", "ns"):
            parts.append((beside, unit))
    return parts[0] if len(parts) == 1 else None


def _last_word(name: str) -> tuple[str, str]:
    match = re.fullmatch(r"(.*?)[._/ ]?([a-z]+)", name.strip().lower(), re.DOTALL)
    if match is None:
        return name, ""
    return match[1], match[2]


def _pairs_of_seconds(columns: Sequence[Column]) -> list[tuple[Column, Column]]:
    """Find columns of seconds, each with the one of its parts of a second."""
    pairs = []
    for column in columns:
        beside = _part_beside(column, columns)
        if beside is not None:
            pairs.append((column, beside[0]))
    return pairs


def _stamps_in(called: Sequence[Column], columns: Sequence[Column]) -> list[Column]:
    """Find columns of dates with clock times, or else of clock times: by their names, or else any."""
    for writings in (("stamp",), ("clock", "minutes")):
        for group in (called, columns):
            stamps = [column for column in group if column.written in writings]
            if stamps:
                return stamps
    return []


def _time_candidates(columns: list[Column]) -> list[Column]:
    """Find the columns that may hold the time: figures by name, then stamps by name, then stamps."""
    fitting = []
    for column in columns:
        plain = column.quantity.lower() in _PLAIN_NAMES
        if plain or not is_other_kind(column.unit):
            fitting.append(column)
    called = guess_columns(fitting, TIME_NAMES) or guess_columns(
        fitting, MORE_TIME_NAMES
    )
    figures = [column for column in called if column.written == "numbers"]
    pairs = _pairs_of_seconds(fitting)
    if len(pairs) == 1 and set(figures) <= set(pairs[0]):
        return [pairs[0][0]]
    stamps = figures or _stamps_in(called, columns)
    if stamps or called or not columns:
        return stamps or called
    first = columns[0]
    if first.written == "numbers" and time_unit(first.unit or ""):
        # an oscilloscope's "Source" in Second
        return [column for column in columns if time_unit(column.unit or "")]
    return called
