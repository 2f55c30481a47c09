"""Igor Pro's text files: waves between BEGIN and END, and the scales that commands state below them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source
from dbo_cli.logs.plain_text import decoded
from dbo_cli.logs.stated_clock import FACTORS, Statement, time_unit
from dbo_cli.logs.text.lines import to_number

_NAME = r"'[^']{1,255}'|\w+"
_BLOCK = re.compile(
    r"^WAVES(?:\s*/\w(?:=\(?[\d,]+\)?)?)*[ \t]+(?P<names>[^\n]+)\n"
    r"\s*BEGIN[ \t]*\n(?P<rows>.*?)^\s*(?P<end>END\b|\Z)",
    re.IGNORECASE | re.MULTILINE | re.DOTALL,
)
_SCALE = re.compile(
    rf'SetScale\s*(?P<how>/[PI])?\s+(?P<axis>[xdy])\s*,?\s*(?P<first>[^,\n]+),(?P<second>[^,\n]+),\s*"(?P<unit>[^"\n]*)"'
    rf"\s*,\s*(?P<names>(?:{_NAME})(?:\s*,\s*(?:{_NAME}))*)",
    re.IGNORECASE,
)


def open_igor(request: Request) -> ColumnTable:
    """Open an Igor text file: every wave is a column, with its unit and its step in time.

    Raises
    ------
    InputError
        A line between BEGIN and END has another number of cells than there are waves, or no numbers.
    """
    with open(request.address.path, "rb") as file:
        text = decoded(re.sub(rb"\r\n?", b"\n", file.read()))
    sources: dict[str, ColumnSource] = {}
    for block in _BLOCK.finditer(text):
        if not block["end"]:
            raise InputError(f"{request.place}: the last wave has no END: the file was cut")
        names = _names(block["names"])
        first = text.count("\n", 0, block.start("rows")) + 1
        lines = [line for line in enumerate(block["rows"].split("\n"), start=first) if line[1].strip()]
        width = len(lines[0][1].split()) if lines else 0
        if len(names) == 1 and width > 1:  # a matrix
            names = [f"{names[0]}[{number}]" for number in range(1, width + 1)]
        rows = [_row(f"{request.place}:{number}", line, len(names)) for number, line in lines]
        columns = np.array(rows).reshape(len(rows), len(names)).T
        sources |= {name: array_source(name, one) for name, one in zip(names, columns, strict=True)}
    for found in _SCALE.finditer(text):
        names = _names(found["names"])
        for label in (label for label in sources if label.partition("[")[0] in names):
            sources[label] = _scaled(sources[label], found)
    if not sources:
        raise request.no_columns(())
    return ColumnTable(request, "Igor text", list(sources.values()))


def _names(text: str) -> list[str]:
    return [name.strip("'") for name in re.findall(_NAME, text)]


def _row(place: str, line: str, width: int) -> list[float]:
    cells = line.split()
    values = [float("nan") if cell.upper() == "NAN" else to_number(cell, ".") for cell in cells]
    numbers = [value for value in values if value is not None]
    if len(numbers) != width or len(cells) != width:
        plural = "s" if width != 1 else ""
        raise InputError(f"{place}: not one number for each of {width} wave{plural}: '{line[:40]}'")
    return numbers


def _scaled(source: ColumnSource, found: re.Match[str]) -> ColumnSource:
    """Take a unit (axis d, or y), or start and step (axis x, in seconds) from a ``SetScale``."""
    first, second = to_number(found["first"].strip(), "."), to_number(found["second"].strip(), ".")
    if found["axis"].lower() != "x":
        return replace(source, unit=found["unit"] or None)
    unit = time_unit(found["unit"])
    if first is None or second is None or unit is None:
        return source
    step = second if (found["how"] or "").upper() == "/P" else (second - first) / max(1, source.length - 1)
    if not step > 0.0:
        return source
    start, step = FACTORS[unit].apply(np.array([first, step])).tolist()
    return replace(source, start=start, clock=(Statement(f"'SetScale' {step:g} s", 1.0 / step),))
