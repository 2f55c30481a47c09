"""The grammar of one line: cells, and which of them are numbers.

The fast parsers accept a subset of this grammar; whatever they refuse is decided here, so both always agree.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from dbo_cli.logs.plain_text import shortened
from dbo_cli.logs.reading_options import BLANKS
from dbo_cli.logs.sample_block import is_overflow

# Numbers with either decimal sign; d is Fortran's exponent.
_POINT = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(?:\d+(?:,\d*)?|,\d+)(?:[eEdD][+-]?\d+)?")
NOT_FINITE = frozenset({"nan", "inf", "infinity", "1.#qnan", "1.#inf", "1.#ind"})


def split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line into stripped cells; quotes are honoured, and blanks count as one delimiter."""
    if delimiter == BLANKS:
        return _split_blanks(line)
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [
        quoted.replace('""', '"').strip() if quoted is not None else plain.strip()
        for quoted, plain in _quoted_cells(line, delimiter)
    ]


def _quoted_cells(line: str, delimiter: str) -> Iterator[tuple[str | None, str]]:
    """Take a line with quotes apart: what is quoted, or else the plain text, of each cell."""
    mark = re.escape(delimiter)
    cell = re.compile(rf'\s*"((?:[^"]|"")*)"\s*(?={mark}|$)|([^{mark}]*)')
    place = 0
    while True:
        found = cell.match(line, place)
        assert found is not None  # the second way matches anything, also nothing
        yield found[1], found[2] or ""
        place = found.end() + 1
        if place > len(line):
            return


def _split_blanks(line: str) -> list[str]:
    if '"' not in line:
        return line.split()
    return [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|([^\s"]+)', line)]


def to_number(cell: str, decimal: str) -> float | None:
    """Read a cell as a finite number, or give None."""
    pattern = _POINT if decimal == "." else _COMMA
    if not cell.isascii() or pattern.fullmatch(cell) is None:
        return None
    value = float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))
    return value if abs(value) != float("inf") and not is_overflow(value) else None


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is written as a number (NaN and inf count: they are numbers that went wrong)."""
    pattern = _POINT if decimal == "." else _COMMA
    if pattern.fullmatch(cell) is not None:
        return cell.isascii()
    return cell.lstrip("+-").lower() in NOT_FINITE


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
        overflow = "the instrument's overflow" if to_number(cell, decimal) is None and "37" in cell else ""
        return f"is {overflow or 'not finite'}: {shown}"
    return f"is not a number: {shown}"
