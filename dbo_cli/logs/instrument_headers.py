"""Text headers that carry the answer: names, units, rate and start as an instrument wrote them.

A maker is recognised by words that only its files have; everything else is left to ``text_dialect``.  What a
header says of the sample rate is read whoever wrote it (``Sampling rate: 10 kHz``), and used where the log
has no time column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from dbo_cli.logs.cell_grammar import decode_line, is_number
from dbo_cli.logs.controller_headers import read_pi_array, read_twincat
from dbo_cli.logs.header_parts import HeaderReading, completed
from dbo_cli.logs.labview_headers import read_lvm
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.scope_headers import (
    read_infiniium,
    read_infiniivision,
    read_rigol,
    read_rohde_schwarz,
    read_tektronix_rows,
    read_tektronix_table,
)
from dbo_cli.logs.stated_clock import Statement, is_clock_name, read_statement
from dbo_cli.logs.text_dialect import Dialect

_MAKERS = (
    read_pi_array,
    read_lvm,
    read_twincat,
    read_tektronix_rows,
    read_tektronix_table,
    read_rigol,
    read_infiniivision,
    read_infiniium,
    read_rohde_schwarz,
)
_LOOKED_AT = 400  # lines; no instrument's header is half as long
_LONGEST_STATEMENT = 300  # characters
_MARK = re.compile(r"[=:;,\t]")


@dataclass(frozen=True)
class InstrumentHeader:
    """What a header says.

    Attributes
    ----------
    dialect
        How the log is written, where the maker is known; None leaves it to be detected.
    clock
        What is said of the sample rate.
    start
        The time (s) of the first row.
    remarks
        What has to be said.
    end_mark
        What the program writes behind the last row.
    """

    dialect: Dialect | None = None
    clock: tuple[Statement, ...] = ()
    start: float = 0.0
    remarks: tuple[str, ...] = ()
    end_mark: bytes = b""


def read_instrument_header(place: str, head: bytes, options: ReadingOptions) -> InstrumentHeader:
    """Read the header of a text log.

    Parameters
    ----------
    place
        The log's name, for messages.
    head
        The first lines.
    options
        Where the user says how the text is written, no maker's layout is assumed.

    Raises
    ------
    InputError
        The header is a known maker's and contradicts itself.
    """
    lines = [decode_line(line.removesuffix(b"\r")) for line in head.split(b"\n", _LOOKED_AT)[:_LOOKED_AT]]
    if lines and lines[0].startswith("\ufeff"):
        lines[0] = lines[0][1:]
    forced = (options.delimiter, options.decimal, options.comment, options.skip_lines, options.header_lines)
    found: HeaderReading | None = None
    if all(one is None for one in forced):
        found = next((reading for read in _MAKERS if (reading := read(place, lines)) is not None), None)
    if found is None:
        return InstrumentHeader(clock=tuple(_stated(lines)))
    dialect = completed(found.dialect, lines)
    clock = found.clock or tuple(_stated(lines[: dialect.first_line - 1]))
    return InstrumentHeader(dialect, clock, found.start, found.remarks, found.end_mark)


def _stated(lines: list[str]) -> Iterator[Statement]:
    """Find the lines above the data that state a rate or a step: ``key = value``, ``key: value``."""
    for line in lines:
        mark = _MARK.search(line) if len(line) <= _LONGEST_STATEMENT else None
        if mark is None:
            continue
        key = line[: mark.start()].strip().lstrip("#%;!/*").strip()
        if not key[:1].isalpha() or not is_clock_name(key):  # a row of data is the usual case
            continue
        value = _first_value(line[mark.end() :].strip(" ,;\t"), mark[0])
        thousands = re.fullmatch(r"(\d{1,3}),(\d{3})(\D*)", value)
        if thousands is not None:
            said = f"'{key}' {value}"
            yield Statement(said, None, f"{said} may be {thousands[1]} or {thousands[1]}{thousands[2]}")
            continue
        statement = read_statement(key, value)
        if statement is not None:
            yield statement


def _first_value(text: str, mark: str) -> str:
    """Take the first channel's value of a line, with its unit where that has a cell of its own."""
    value = re.split(r"[\t;]|,\s*(?=,|$)", text)[0].strip()
    if mark != "," and re.fullmatch(r"\d+,\d+\s*\D*", value):
        grouped = re.fullmatch(r"\d{1,3},\d{3}\D*", value)  # 1,000 is 1 to some and 1000 to others
        return value if grouped else value.replace(",", ".")
    cells = [cell.strip() for cell in value.split(",")]
    if len(cells) == 2 and is_number(cells[0], ".") and not is_number(cells[1], "."):
        return f"{cells[0]} {cells[1]}"
    return cells[0] if len(set(cells)) == 1 else value
