"""What the readers of instruments' headers share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dbo_cli.logs.cell_grammar import is_number, split_cells
from dbo_cli.logs.header_blocks import find_header_block
from dbo_cli.logs.stated_clock import Statement
from dbo_cli.logs.text_dialect import COMMENTS, Dialect

_SAMPLE_LINES = 40  # as many as text_dialect looks at


@dataclass(frozen=True)
class HeaderReading:
    """A known maker's header: how the log is written, its clock, and what has to be said."""

    dialect: Dialect
    clock: tuple[Statement, ...] = ()
    start: float = 0.0
    remarks: tuple[str, ...] = ()
    end_mark: bytes = b""


def make_dialect(
    delimiter: str, decimal: str, first_line: int, names: Sequence[str], units: Sequence[str], width: int
) -> Dialect:
    """Describe a table whose header is known; names and units are filled up to ``width`` cells."""
    filled = [*names, *[""] * width][:width]
    measured = [*units, *[""] * width][:width] if any(units) else []
    return Dialect(delimiter, decimal, COMMENTS, width, first_line, tuple(filled), tuple(measured))


def number_row(lines: Sequence[str], start: int, delimiter: str, decimal: str) -> int | None:
    """Find the first line from index ``start`` on whose filled cells are all numbers."""
    for index in range(start, len(lines)):
        cells = [cell for cell in split_cells(lines[index], delimiter) if cell]
        if cells and all(is_number(cell, decimal) for cell in cells):
            return index
    return None


def decimal_of(lines: Sequence[str], start: int, delimiter: str) -> str:
    """Tell the decimal sign of the rows from index ``start`` on, where commas do not separate."""
    if delimiter == ",":
        return "."
    rows = [cell for line in lines[start : start + 50] for cell in split_cells(line, delimiter)]
    commas = sum("," in cell and is_number(cell, ",") for cell in rows)
    return "," if commas and not any("." in cell and is_number(cell, ".") for cell in rows) else "."


def to_float(text: str) -> float | None:
    """Read a number with either decimal sign; None for anything else."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        return None


def completed(dialect: Dialect, lines: Sequence[str]) -> Dialect:
    """Add what the rows tell: which columns hold numbers, and a header that stands again among them."""
    rows = [split_cells(line, dialect.delimiter) for line in lines[dialect.first_line - 1 :][-_SAMPLE_LINES:]]
    rows = [row for row in rows if len(row) >= dialect.width]
    counts = [sum(is_number(row[n], dialect.decimal) for row in rows) for n in range(dialect.width)]
    numeric = frozenset(n for n, count in enumerate(counts) if count and 2 * count >= len(rows))
    block = find_header_block(lines, dialect.first_line - 1, dialect.delimiter)
    return replace(dialect, numeric=numeric, header_block=block)
