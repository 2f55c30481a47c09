"""Lines of a text, in blocks: cells, which of them are numbers, and header blocks among the data.

The fast parsers accept a subset of this grammar; whatever they refuse is decided here,
so both always agree.
"""

from __future__ import annotations

import datetime
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from dbo_cli.errors import InputError, shortened
from dbo_cli.logs.request import BLANKS
from dbo_cli.logs.sample_block import FloatArray, is_overflow

# Numbers with either decimal sign; d is Fortran's exponent.
_POINT = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(?:\d+(?:,\d*)?|,\d+)(?:[eEdD][+-]?\d+)?")
# Groups of three digits whose mark can be nothing else: 1,234.5 or 1'234 or 1,234,567.
# A lone 1,234 is taken for a group where the decimal sign of the log is known to be a
# point (``text.dialect`` asks).
_BLANK_MARKS = "'\u2019\u00a0\u202f\u2009 "
_GROUPED = {
    sign: re.compile(
        rf"([+-]?[1-9]\d{{0,2}})([{mark}{_BLANK_MARKS}])(\d{{3}}(?:\2\d{{3}})*)([{sign}]\d*)?"
    )
    for sign, mark in ((".", ","), (",", "."))
}
NOT_FINITE = frozenset({"nan", "inf", "infinity", "1.#qnan", "1.#inf", "1.#ind"})


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line into stripped cells; quotes are honoured, and blanks count as one delimiter."""
    if '"' not in line:
        if delimiter == BLANKS:
            return line.split()
        return [cell.strip() for cell in line.split(delimiter)]
    if delimiter == BLANKS:
        words = re.findall(r'"([^"]*)"|([^\s"]+)', line)
        return [quoted or plain for quoted, plain in words]
    mark = re.escape(delimiter)
    cells = re.findall(
        rf'(?:\s*"((?:[^"]|"")*)"\s*|([^{mark}]*)){mark}', line + delimiter
    )
    return [(quoted.replace('""', '"') or plain).strip() for quoted, plain in cells]


def to_number(cell: str, decimal: str) -> float | None:
    """Read a cell as a finite number, or give None."""
    pattern = _POINT if decimal == "." else _COMMA
    if not cell.isascii() or pattern.fullmatch(cell) is None:
        if not (cell := _ungrouped(cell, decimal)):
            return None
    value = float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))
    if abs(value) == float("inf") or is_overflow(value):
        return None
    return value


def _ungrouped(cell: str, decimal: str) -> str:
    """Return a number without the marks between its thousands; empty where it has none."""
    match = _GROUPED[decimal].fullmatch(cell)
    if match is None or (
        decimal == "," and match[2] == "." and len(match[3]) == 3 and not match[4]
    ):
        return ""  # 1.234 among decimal commas is no whole number for sure
    return re.sub(r"[^\d+-]", "", match[1] + match[3]) + (match[4] or "")


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is written as a number (NaN and inf count: they are numbers that went wrong)."""
    if not cell:
        return False
    pattern = _POINT if decimal == "." else _COMMA
    if pattern.fullmatch(cell) is not None:
        return cell.isascii()
    return (len(cell) > 4 and _ungrouped(cell, decimal) != "") or cell.lstrip(
        "+-"
    ).lower() in NOT_FINITE


MISSING = frozenset({"na", "n/a", "nan", "null", "none", "nil", "missing"})
"""What programs write where a number is missing: no sign that a row is no row of data."""


def is_text(cell: str, decimal: str) -> bool:
    """Return whether a cell holds words where others of its column hold numbers (an e alone is none)."""
    if not any(character >= "@" and character not in "eE" for character in cell):
        return False
    return not is_number(cell, decimal) and cell.lower() not in MISSING


def complain(cell: str, decimal: str, written: str = "numbers") -> str:
    """Describe what is wrong with a cell that holds no finite number, or none of its column's time stamps."""
    if not cell:
        return "is empty"
    shown = repr(shortened(cell))
    if written != "numbers":
        return f"is not a time stamp like the others: {shown}"
    if is_number(cell, decimal):
        if to_number(cell, decimal) is None and "37" in cell:
            return f"is the instrument's overflow: {shown}"
        return f"is not finite: {shown}"
    return f"is not a number: {shown}"


# --- dates and clock times in cells, read as seconds ---
#
# Dates count from 1970-01-01 (no zone given: as if UTC), clock times from midnight. The
# arithmetic is on whole numbers, so that a stamp becomes the float64 nearest to it.

DAY = 86400  # s
_MONTHS = (
    "jan",
    "feb",
    "mar",
    "apr",
    "may",
    "jun",
    "jul",
    "aug",
    "sep",
    "oct",
    "nov",
    "dec",
)

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
_MINUTES = re.compile(
    r"(?P<minutes>\d{1,3}):(?P<seconds>[0-5]\d)[.,](?P<fraction>\d{1,20})"
)
_STAMP = re.compile(
    r"(?P<date>\d{4}([-/.])\d{1,2}\2\d{1,2}|\d{8}|\d{1,2}[-./]\d{1,2}[-./]\d{2,4}"
    r"|\d{1,2}[- ][A-Za-z]{3}[- ]\d{4})(?:T|[ _]+|, ?)"
    r"(?P<clock>\d{1,2}:\d\d:\d\d(?:[.,]\d{1,20})?(?: ?[AaPp]\.?[Mm]\.?)?|\d{6}(?:\.\d{1,20})?)"
    r" ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?"
)


@lru_cache(maxsize=64)
def date_seconds(text: str) -> int | None:
    """Read a date as seconds since 1970, or give None.

    ``2024-03-31``, ``2024/3/31``, ``31.03.2024``, ``31-03-2024``, ``31-Mar-2024``; with
    slashes and the year last the month stands first (as in the United States) unless it
    cannot.
    """
    match = _date_match(text)
    if match is None:
        return None
    year = int(match["year"])
    if year < 100:
        year += 2000
    month = _month_number(match["month"].lower())
    day = int(match["day"])
    if match.re.pattern == _MONTH_FIRST.pattern and month > 12:
        month, day = day, month
    try:
        date = datetime.date(year, month, day)
    except ValueError:
        return None
    return (date.toordinal() - datetime.date(1970, 1, 1).toordinal()) * DAY


def _date_match(text: str) -> re.Match[str] | None:
    """Match a date in the first of the known orders that it fits."""
    for order in _DATES:
        match = order.fullmatch(text)
        if match is not None:
            return match
    return None


def _month_number(month: str) -> int:
    """Return a month, as digits or as three letters, as a number from 1; 0 where it is none."""
    if month in _MONTHS:
        return _MONTHS.index(month) + 1
    if month.isdecimal():
        return int(month)
    return 0


def _exact(whole: int, fraction: str | None) -> float:
    """Return a whole number of seconds and the digits after it as the nearest float64."""
    if not fraction:
        return float(whole)
    size: int = 10 ** len(fraction)
    return (whole * size + int(fraction)) / size


def _clock_parts(text: str) -> tuple[int, str | None] | None:
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    hours = int(match["hours"])
    if match["half"]:
        if not 1 <= hours <= 12:
            return None
        hours %= 12
        if match["half"] in "pP":
            hours += 12
    whole = int(match["days"] or 0) * DAY + hours * 3600
    return whole + int(match["minutes"]) * 60 + int(match["seconds"]), match[
        "fraction"
    ] or match["millis"]


def clock_seconds(text: str) -> float | None:
    """Read ``hh:mm:ss.sss`` (also with days in front, or am and pm behind) as seconds, or give None."""
    parts = _clock_parts(text)
    if parts is None:
        return None
    return _exact(*parts)


def minute_seconds(text: str) -> float | None:
    """Read ``mm:ss.s``, a spreadsheet's habit, as seconds of the hour, or give None."""
    match = _MINUTES.fullmatch(text)
    if match is None:
        return None
    return _exact(int(match["minutes"]) * 60 + int(match["seconds"]), match["fraction"])


def stamp_seconds(text: str) -> float | None:
    """Read a date and a clock time in one cell (ISO 8601 and its relatives) as seconds since 1970."""
    match = _STAMP.fullmatch(text)
    if match is None:
        return None
    date = date_seconds(match["date"])
    clock = match["clock"]
    zone = match["zone"]
    if ":" not in clock:
        clock = f"{clock[:2]}:{clock[2:4]}:{clock[4:]}"
    parts = _clock_parts(clock)
    if date is None or parts is None:
        return None
    whole = date + parts[0]
    if zone and zone[0] in "+-":
        ahead = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        if zone[0] == "+":
            whole -= ahead
        else:
            whole += ahead
    return _exact(whole, parts[1])


READERS: dict[str, Callable[[str], float | None]] = {
    "stamp": stamp_seconds,
    "clock": clock_seconds,
    "minutes": minute_seconds,
    "date": date_seconds,
}
"""How a column of time stamps may be written, and what reads its cells."""


def value_of(cell: str, decimal: str, written: str) -> float | None:
    """Read a cell of a column as a number or a time stamp (s), as it is written; None for neither."""
    if written == "numbers":
        return to_number(cell, decimal)
    return READERS[written](cell)


def writing_of(cells: Sequence[str]) -> str | None:
    """Return how most cells of a column write time stamps, or None where they are none."""
    for writing, read in READERS.items():
        if 2 * sum(read(cell) is not None for cell in cells) > len(cells):
            return writing
    return None


# --- is the last number of a log whole? ---

# a change this many times the largest one above is not the next sample
_USUAL_STEPS = 3.0
_NUMBER = re.compile(
    r"[+-]?(?P<whole>\d*)(?P<rest>[.,]\d*)?(?:[eEdD](?P<exponent>[+-]?\d*))?"
)


def _digits(cell: str) -> tuple[int, int, int] | None:
    """Count a number's digits before and after the decimal sign (-1: no sign) and in the exponent."""
    match = _NUMBER.fullmatch(cell)
    if match is None:
        return None
    decimals = -1
    if match["rest"] is not None:
        decimals = len(match["rest"]) - 1
    return len(match["whole"]), decimals, len(match["exponent"] or "")


def looks_cut(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Return whether a number has visibly fewer digits than all the numbers above it.

    Fewer decimals, or fewer digits in the exponent, than any number above: cut, unless
    it ends in ``.0`` as whole numbers do among numbers of varying length, and goes on
    from the one above. Fewer digits before the decimal sign alone mean nothing (99
    follows 100), unless the value leaps as well.
    """
    counts = _digits(cell)
    counts_above = list(filter(None, map(_digits, above)))
    if counts is None or not counts_above:
        return False
    whole, decimals, exponent = map(min, zip(*counts_above, strict=True))
    if counts[2] < exponent:
        return True
    if counts[1] < decimals:
        varying = len({digits[1] for digits in counts_above}) > 1
        return not (
            varying and cell[-2:] in (".0", ",0") and not _leaps(cell, above, decimal)
        )
    shorter = len(cell) < min(map(len, above)) or counts[0] < whole
    return shorter and _leaps(cell, above, decimal)


def _leaps(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Return whether the last number is further from the one above than numbers above are from each other."""
    value = to_number(cell, decimal)
    numbers = []
    for cell_above in above:
        number = to_number(cell_above, decimal)
        if number is not None:
            numbers.append(number)
    if value is None or len(numbers) < 2:
        return False
    steps = [abs(later - earlier) for earlier, later in itertools.pairwise(numbers)]
    return abs(value - numbers[-1]) > _USUAL_STEPS * max(steps)


# --- header blocks that stand again, one before each segment (LabVIEW's Multi_Headings) ---

END_OF_HEADER = "***End_of_Header***"  # as LabVIEW writes it


def find_repeated_header(
    lines: Sequence[str], first: int, delimiter: str
) -> RepeatedHeader | None:
    """Find the block above the data (which begin at index ``first``) that each segment repeats.

    Such a file has two ends of a header: that of the file's and that of the first
    segment's.
    """
    ends = []
    for number in range(first):
        if lines[number].strip().startswith(END_OF_HEADER):
            ends.append(number)
    if len(ends) < 2 or first - ends[-1] != 2:
        return None
    between = lines[ends[-2] + 1 : ends[-1]]
    inner = [line for line in between if line.strip()]
    if not inner:
        return None
    word = split_cells(inner[0], delimiter)[0]
    if not word:
        return None
    start = _stated_start(inner, delimiter)
    return RepeatedHeader(word, lines[first - 1].strip(), delimiter, start)


def _stated_start(lines: Sequence[str], delimiter: str) -> tuple[float, float] | None:
    """Return when a segment began: the date and the time that its header states, each in seconds."""
    stated = {}
    for line in lines:
        cells = split_cells(line, delimiter)
        if len(cells) > 1:
            stated[cells[0]] = cells[1]
    date = date_seconds(stated.get("Date", ""))
    clock = clock_seconds(stated.get("Time", "").replace(",", "."))
    if date is None or clock is None:
        return None
    return date, clock


@dataclass
class RepeatedHeader:
    """Takes header blocks out of the data, and lets the time go on where a segment begins it again.

    A segment's time is shifted by what its header's date and time are later than the
    first one's; where that is not stated, it begins one step after the last row.

    Attributes
    ----------
    first_word, names
        What begins and ends each header block.
    delimiter
        Of the log.
    start
        The date and the time that the first header states (each s), or None.
    place
        The log's name, for messages.
    count
        Headers that were taken out so far.
    guessed
        Segments that began one step after the last row.
    """

    first_word: str
    names: str
    delimiter: str
    start: tuple[float, float] | None = None
    place: str = ""
    count: int = 0
    guessed: int = 0
    _lines: list[str] | None = None
    _begins: bool = False
    _segment_start: tuple[float, float] | None = None
    _shift: float = 0.0
    _last: float | None = None
    _step: float = 0.0

    def takes(self, line: str, number: int) -> bool:
        """Return whether a line belongs to a header block and not to the data.

        Raises
        ------
        InputError
            The block names other columns than the first one.
        """
        if self._lines is None:
            if split_cells(line, self.delimiter)[0] != self.first_word:
                return False
            self._lines = []
        ended = bool(self._lines) and self._lines[-1].strip().startswith(END_OF_HEADER)
        if ended and line.strip():
            if line.strip() != self.names:
                raise InputError(
                    f"{self.place}:{number}: a header in the middle of the data names other columns than the "
                    "first one (cut the log with `rows` A:B)"
                )
            self._segment_start = _stated_start(self._lines, self.delimiter)
            self._lines = None
            self._begins = True
            self.count += 1
        else:
            self._lines.append(line)
        return True

    def continued(self, time: FloatArray) -> FloatArray:
        """Return the time stamps (s) of rows that follow each other without a header between them."""
        if not len(time):
            return time
        if self._begins:
            self._begins = False
            self._shift = self._shift_for(float(time[0]))
        if self._shift:
            time = time + self._shift
        before = float(time[-2]) if len(time) > 1 else self._last
        if before is not None:
            self._step = float(time[-1]) - before
        self._last = float(time[-1])
        return time

    def _shift_for(self, first: float) -> float:
        if self._last is None or first > self._last:
            return 0.0  # this writer lets the time go on by itself
        if self._segment_start is not None and self.start is not None:
            date, clock = self._segment_start
            first_date, first_clock = self.start
            shift = date - first_date + clock - first_clock
            if first + shift > self._last:
                return shift
        self.guessed += 1
        return self._last + self._step - first

    def note(self, timed: bool) -> str:
        """Describe what was found; without a time column (``timed``) rows alone give the time."""
        plural = "s" if self.count > 1 else ""
        how = "their time goes on by the dates and times stated there"
        if not timed:
            how = "no column gives their time, so the rows go on as if there had been no pause"
        elif self.guessed:
            how = "the time goes on one step after the last row, for no date and time say more"
        return f"{self.place}: {self.count} more header{plural} among the data: {how}"
