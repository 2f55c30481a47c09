"""Cells of a text log: how lines are split, what is a number, how time stamps look, how rows are laid out."""

import contextlib
import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.table import LONGEST_CELL, TOO_LONG, Settings

_NUMBER = r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][-+]?\d+)?"
_NUMBERS = {
    signs: re.compile(_NUMBER.replace(".,", signs), re.ASCII)
    for signs in (".", ",", ".,")
}
"""How numbers are written, by the decimal signs that may stand in them."""
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


DATE = re.compile(r"\d[/:-]\d", re.ASCII)
"""What a date or a clock time holds, whether or not its format is read."""
STAMPS = {"%H:%M:%S%.f": _CLOCK}
"""The formats of time stamps that are read, as polars writes them, and how their cells look."""
for _form, _pattern in _DATES.items():
    for _between in "T ":
        STAMPS[f"{_form}{_between}%H:%M:%S%.f"] = _pattern + _between + _CLOCK
        STAMPS[f"{_form}{_between}%H:%M:%S%.f%z"] = _pattern + _between + _CLOCK + _ZONE


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line at the delimiter; a blank stands for any run of blanks and tabs.

    Quotes around a cell are taken off; inside them the delimiter is a character like
    any other. A cell that is too long to be anything becomes ``TOO_LONG``.
    """
    if delimiter == " ":  # no-break blanks stand between thousands
        cells = [word.strip('"') for word in re.findall(r'"[^"]*"|[^ \t\r]+', line)]
    else:
        cells = line.split(delimiter)
        if '"' in line:  # blanks may stand in front of a quote
            lines = [line.strip(" \r")]
            reader = csv.reader(
                lines, delimiter=delimiter, skipinitialspace=True, strict=True
            )
            # quotes that do not close are letters of their cells
            with contextlib.suppress(csv.Error):
                cells = next(reader)
    if len(line) > LONGEST_CELL:
        cells = [cell if len(cell) <= LONGEST_CELL else TOO_LONG for cell in cells]
    return [cell.strip() for cell in cells]


def is_number(cell: str, decimal: str = ".,") -> bool:
    """Return whether a cell is written as a number, or as one that is not finite."""
    is_finite = _NUMBERS[decimal].fullmatch(cell) is not None
    return is_finite or cell.lstrip("+-").lower() in _NOT_FINITE


def to_number(cell: str, decimal: str) -> float:
    """Read a cell as a number; NaN for other text."""
    if not _NUMBERS[decimal].fullmatch(cell):
        return np.nan
    # Fortran writes 1.0D+00
    return float(cell.replace(",", ".").replace("D", "e").replace("d", "e"))


def is_stamp(cell: str, form: str) -> bool:
    """Return whether a cell is a time stamp of a format."""
    # most cells hold no colon, and a pattern costs something to compile
    return ":" in cell and re.fullmatch(STAMPS[form], cell, re.ASCII) is not None


def stamp_format(cells: Sequence[tuple[str, float]]) -> str | None:
    """Return the format in which most cells, each with its weight, are time stamps; else None."""
    total = sum(weight for cell, weight in cells if cell)
    for form in STAMPS:
        fitting = sum(weight for cell, weight in cells if is_stamp(cell, form))
        if 2.0 * fitting > total:
            return form
    return None


# --- rows ---


@dataclass
class Layout:
    """How a text log is written.

    Attributes
    ----------
    delimiter, decimal
        The signs.
    kinds
        What each column holds, as ``Column.kind`` and ``Column.sample`` say it.
    first
        The index of the line of the first row.
    first_line
        That line.
    names, units, settings
        What the lines above the rows say.
    is_headed
        Whether one of these lines holds names or units.
    """

    delimiter: str
    decimal: str
    kinds: list[tuple[str, str]] = field(default_factory=list)
    first: int = 0
    first_line: str = ""
    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    settings: Settings = field(default_factory=dict)
    is_headed: bool = False

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self.kinds)

    @property
    def numeric(self) -> list[int]:
        """The columns of numbers (from 0)."""
        return [n for n, (kind, _) in enumerate(self.kinds) if kind == "number"]

    @property
    def has_blank_front(self) -> bool:
        """Whether one blank cell stands before the numbers of a row: no room for a key and its value."""
        return self.kinds[0][0] == "empty" and self.numeric[0] == 1

    def partly_fits(self, line: str) -> bool:
        """Return whether half of the numbers stand where the rows have theirs.

        A word in front is none of the rows that begin with nothing.
        """
        cells = split_cells(line, self.delimiter)
        if self.has_blank_front and any(map(str.isalpha, cells[0])):
            return False
        numeric = self.numeric
        places = [n for n in numeric if n < len(cells)]
        numbers = [n for n in places if is_number(cells[n], self.decimal)]
        return bool(numbers) and 2 * len(numbers) >= len(numeric)


# --- thousands or decimals ---

WHOLE_CELL = r"[-+]?(?:0|[1-9]\d{0,2})"
GROUPED_CELL = r"[-+]?[1-9]\d{0,2}[.,]\d{3}"
_WHOLE = re.compile(WHOLE_CELL, re.ASCII)
_GROUPED = re.compile(GROUPED_CELL, re.ASCII)
_MOST_DOUBTFUL = 400  # rows; written by decimals, other numbers of them come sooner


@dataclass
class Marks:
    """Whether the marks in a column stand before decimals or between thousands.

    ``999`` beside ``1.000`` may be either, until another number of decimals shows; judged
    by the order of the rows alone, so that blocks of any size give one verdict.

    Attributes
    ----------
    name
        How messages call the column.
    is_clear
        Whether a cell has shown that they stand before decimals.
    plain, grouped
        The first cells of either kind.
    doubtful_from
        The row from which on there are both.
    """

    name: str
    is_clear: bool = False
    plain: str = ""
    grouped: str = ""
    doubtful_from: float = math.inf

    def watch(self, first_row: int, cells: Any, rows: Iterable[int]) -> None:
        """Take cells of some rows into account, until one is clear."""
        for index in rows:
            if self.is_clear:
                return
            cell, row = cells[index], first_row + index
            if _WHOLE.fullmatch(cell):
                self.plain = self.plain or cell
            elif _GROUPED.fullmatch(cell):
                self.grouped = self.grouped or cell
            elif is_number(cell):
                self.is_clear = row - self.doubtful_from <= _MOST_DOUBTFUL
            if self.plain and self.grouped:
                self.doubtful_from = min(self.doubtful_from, row)

    def require_clear(self, row: int, limit: int = _MOST_DOUBTFUL) -> None:
        """Refuse (InputError) what is still doubtful by more than so many rows above a row."""
        if not self.is_clear and row - self.doubtful_from > limit:
            raise InputError(
                f"{self.name}: {self.grouped} beside {self.plain}: thousands or decimals? Type `decimal` "
                "point or comma, or write them without the mark"
            )
