"""How logs are to be read, as far as the user gave it; checked once, when the value is made."""

from __future__ import annotations

import dataclasses
import math
import numbers
import re
from functools import cached_property
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import UsageError
from dbo_cli.logs.addresses import FORMATS
from dbo_cli.records import dataclass

if TYPE_CHECKING:
    from dbo_cli.logs.units import Scale

Rows = tuple[int, int | None]
"""The first and the last data row that take part, counted from 1; None: to the end."""

ALL_ROWS: Rows = (1, None)
BLOCK_ROWS = 1 << 17  # a megabyte a column: half costs a tenth more time in all, twice as much is no faster
PIPE_ROWS = 1 << 16  # of a pipe: what comes slowly is not waited for any longer
_LOWEST_RATE, _HIGHEST_RATE = 1e-9, 1e12  # beyond them a step of time is lost in rounding, or the rows are

FEWEST_TO_JUDGE = 20  # rows after a bad one, from which on it is said how many of them are bad, too


FILL_GAPS = "bring the signals to common times first (pandas: interpolate(method='index'), dropna)"


def remedy_for(bad: int, rows: int, cause: str = "") -> str:
    """Return what to do about a bad row, of whose next ``rows`` rows ``bad`` are bad, too.

    To drop them is no remedy where most of a log would go; ``cause`` is what to do instead.
    """
    if rows < FEWEST_TO_JUDGE or 2 * bad <= rows:
        return "(`skip_bad` drops such rows)"
    cause = cause or "name another column, or take good `rows` A:B"
    return f"(and so on in {bad:,} of the next {rows:,} rows: {cause})"


BLANKS = " "  # the delimiter that stands for any run of blanks and tabs
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": BLANKS, "space": BLANKS, "pipe": "|"}
DECIMALS = {"point": ".", "comma": ",", ".": ".", ",": ","}


@dataclass(frozen=True)
class ReadingOptions:
    """How a log is to be read; what is None is detected.

    Attributes
    ----------
    time : str, optional
        The time column: a header name, a dataset path, or a number counted from 1.
    time_unit : str, optional
        What the figures of the time column count (``ms``, ``10us``); goes before what the header states.
    scale : tuple of str
        Factors by role, ``voltage=20`` or ``displacement=10um/V``.
    sample_rate : float, optional
        Samples a second (Hz) of a log without a time column; replaces a column that was only guessed.
    rows : tuple of int
        The first and the last data row to take, counted from 1 (last None: to the end).
    skip_bad : bool
        Drop and count rows with bad cells instead of refusing them.
    resample : float, optional
        Interpolate linearly to this rate (Hz).
    format : str, optional
        ``csv``, ``tsv`` or ``hdf5``, where no file name shows it.
    delimiter, decimal, comment : str, optional
        Of text: a name of ``DELIMITERS`` or a single character; ``point`` or ``comma``; the characters that
        start a comment line.
    skip_lines, header_lines : int, optional
        Of text: lines of junk above the header; 0 (no header), 1 (names) or 2 (names, then units).
    encoding : str, optional
        Of text: a codec's name.
    block_rows : int
        The most rows held at a time; changes no digit.

    Raises
    ------
    UsageError
        An option is senseless, or two exclude each other.
    """

    time: str | None = None
    time_unit: str | None = None
    scale: tuple[str, ...] = ()
    sample_rate: float | None = None
    rows: Rows = ALL_ROWS
    skip_bad: bool = False
    resample: float | None = None
    format: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    comment: str | None = None
    skip_lines: int | None = None
    header_lines: int | None = None
    encoding: str | None = None
    block_rows: int = BLOCK_ROWS

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        object.__setattr__(self, "scale", (self.scale,) if isinstance(self.scale, str) else tuple(self.scale))
        object.__setattr__(self, "rows", parse_rows(self.rows))
        self._check_time()
        self.scales  # noqa: B018 - parsed once; refuses what is none
        if self.format is not None and self.format not in FORMATS:
            raise UsageError(f"`format` {self.format}: the formats are {', '.join(FORMATS)}")
        if self.header_lines is not None and self.header_lines not in (0, 1, 2):
            raise UsageError(f"`header_lines`: '{self.header_lines}' is none of 0, 1, 2")
        for name, least in (("skip_lines", 0), ("block_rows", 1)):
            count = getattr(self, name)
            if count is not None and count < least:
                raise UsageError(f"`{name}`: must be at least {least}, not {count}")
        for name in ("delimiter", "comment"):
            if any("\ud800" <= letter <= "\udfff" for letter in getattr(self, name) or ""):
                raise UsageError(f"`{name}`: holds a byte that is no character in this terminal's encoding")
        self.delimiter_character  # noqa: B018
        self.decimal_sign  # noqa: B018
        try:
            # refuses codecs that are no text encodings, too
            "".encode("utf-8" if self.encoding is None else self.encoding)
        except (LookupError, ValueError):
            raise UsageError(f"`encoding` {self.encoding}: there is no such text encoding") from None

    def _check_time(self) -> None:
        """Refuse rates and units of time that are none, or that exclude each other."""
        for name in ("sample_rate", "resample"):
            object.__setattr__(self, name, checked_rate(getattr(self, name), name))
        if self.time is not None and self.sample_rate is not None:
            raise UsageError(
                "`time` and `sample_rate` exclude each other: the log has the one or needs the other"
            )
        if self.time_unit is not None:
            from dbo_cli.logs.stated_clock import parse_time_unit

            parse_time_unit(self.time_unit)
            if self.sample_rate is not None:
                raise UsageError(
                    "`time_unit` and `sample_rate` exclude each other: the time column is read or replaced"
                )

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """The factors by role (UsageError where one is none)."""
        if not self.scale:
            return ()
        from dbo_cli.logs.units import parse_scale

        return tuple(parse_scale(text) for text in self.scale)

    def chosen(self) -> dict[str, object]:
        """Return what the user gave, under its parameter's name; how many rows are held changes nothing."""
        own = [field for field in dataclasses.fields(self) if field.name != "block_rows"]
        given = {one.name: value for one in own if (value := getattr(self, one.name)) != one.default}
        if "rows" in given:
            first, last = self.rows
            given["rows"] = f"{first if first > 1 else ''}:{'' if last is None else last}"
        return given

    @cached_property
    def delimiter_character(self) -> str | None:
        """The delimiter asked for, or None where it is to be detected.

        Raises
        ------
        UsageError
            It is neither a known name nor a single character.
        """
        if self.delimiter is None:
            return None
        found = DELIMITERS.get(self.delimiter.lower(), self.delimiter.replace("\\t", "\t"))
        if len(found) != 1 or found.isalnum() or found in '."\n\r':
            names = ", ".join(DELIMITERS)
            raise UsageError(f"`delimiter` {self.delimiter}: give a single character or one of {names}")
        return found

    @cached_property
    def decimal_sign(self) -> str | None:
        """The decimal sign asked for, or None where it is to be detected.

        Raises
        ------
        UsageError
            It is neither ``point`` nor ``comma``.
        """
        if self.decimal is None:
            return None
        found = DECIMALS.get(self.decimal.lower())
        if found is None:
            raise UsageError(f"`decimal` {self.decimal}: give point or comma")
        return found


def checked_rate(rate: float | None, name: str = "sample_rate") -> float | None:
    """Return samples a second (Hz), or refuse what is no rate (UsageError); ``name`` is the parameter's."""
    if rate is None:
        return None
    if not isinstance(rate, numbers.Real) or isinstance(rate, bool):
        raise UsageError(f"`{name}` {rate!r}: give a positive number of samples a second")
    if not 0.0 < rate < math.inf:
        raise UsageError(f"`{name}` {rate:g}: give a positive number of samples a second")
    if not _LOWEST_RATE <= rate <= _HIGHEST_RATE:
        limits = f"{_LOWEST_RATE:g} and {_HIGHEST_RATE:g}"
        raise UsageError(f"`{name}` {rate:g}: give between {limits} samples a second")
    return float(rate)


def parse_rows(given: object) -> Rows:
    """Read ``A:B``, or a pair of numbers: data rows counted from 1, both ends included.

    Raises
    ------
    UsageError
        It is not of that form, or B is before A.
    """
    rows = given
    if isinstance(given, str):
        found = re.fullmatch(r"([0-9]{0,18}):([0-9]{0,18})", given.strip())
        rows = None if found is None else (int(found[1] or 1), int(found[2]) if found[2] else None)
    pair: Any = rows if isinstance(rows, tuple | list) and len(rows) == 2 else ("", "")
    if not all(type(number) is int for number in (pair[0], pair[1] or 1)):
        raise UsageError(f"`rows` {given}: give A:B, data rows counted from 1, both ends included")
    first, last = pair
    if first < 1 or (last is not None and last < first):
        text = given if isinstance(given, str) else f"{first}:{'' if last is None else last}"
        raise UsageError(f"`rows` {text}: rows are counted from 1, and the last is not before the first")
    return first, last
