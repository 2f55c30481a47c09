"""Texts that are read as a whole: JSON, Igor Pro's waves, and tables that hold a sample in several rows.

Grafana's series, Flux' annotated CSV and what SQL gives name the signal in one column
and its value in another (a long table); joins of signals leave rows with one value
each. Both are put side by side here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.errors import InputError, counted, decoded
from dbo_cli.logs.clock import Statement
from dbo_cli.logs.column_table import (
    ColumnSource,
    ColumnTable,
    array_source,
    listed_source,
    statements_in,
    without_scalars,
)
from dbo_cli.logs.columns import MORE_TIME_NAMES, TIME_NAMES
from dbo_cli.logs.request import FILL_GAPS, Request
from dbo_cli.logs.sample_block import Table
from dbo_cli.logs.text.dialect import Dialect
from dbo_cli.logs.text.line_blocks import ByteSource
from dbo_cli.logs.text.lines import to_number
from dbo_cli.logs.text.text_table import TextTable
from dbo_cli.logs.units import FACTORS, time_unit

# --- JSON: a record a line, an array of records, or an object of arrays ---


def open_json(request: Request) -> ColumnTable:
    """Open JSON; what lies in objects is named by its path (``fields/voltage``).

    Raises
    ------
    InputError
        A line or the document is not JSON, or holds no columns of numbers.
    """
    with open(request.address.path, encoding="utf-8", errors="replace") as file:
        text = file.read()
    lines = text.splitlines()
    try:
        document = json.loads(lines[0])
        if len(lines) > 1 and isinstance(document, dict | list):
            numbered = enumerate(lines, start=1)
            document = [
                _parsed(f"{request.place}:{n}", line)
                for n, line in numbered
                if line.strip()
            ]
    except (ValueError, RecursionError):
        document = _parsed(request.place, text)
    with request.reading("JSON", (OverflowError, RecursionError)):
        columns, single = _columns(document)
        listed = [listed_source(name, values) for name, values in columns.items()]
    sources = without_scalars([source for source in listed if source is not None])
    remedy = ' (write a line a row: {"time": 0, "voltage": 1.5})'
    clock, keys = statements_in(single), columns or single
    return ColumnTable(request, "JSON", sources, clock=clock, held=keys, remedy=remedy)


def _parsed(place: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as problem:
        where = (
            f":{problem.lineno}"
            if isinstance(problem, json.JSONDecodeError) and "\n" in text
            else ""
        )
        raise InputError(
            f"{place}{where}: this is not JSON: {str(problem).partition(':')[0]}"
        ) from None


def _columns(document: Any) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Take columns and single values out of records, of rows below a row of names, or of an object."""
    if isinstance(document, dict):
        split = all(
            isinstance(document.get(part), list) for part in ("columns", "data")
        )
        if split and len(document) < 4:  # pandas' orient="split"
            document = [document["columns"], *document["data"]]
    if isinstance(document, list):
        if document and all(isinstance(row, list) for row in document):
            document = [
                dict(zip(map(str, document[0]), row, strict=False))
                for row in document[1:]
            ]
        records = [
            dict(_leaves(record)) for record in document if isinstance(record, dict)
        ]
        names = dict.fromkeys(name for record in records for name in record)
        return {name: [record.get(name) for record in records] for name in names}, {}
    columns: dict[str, list[Any]] = {}
    single: dict[str, Any] = {}
    for name, value in _leaves(document):
        if not isinstance(value, list):
            single[name.rpartition("/")[2]] = value
        elif value and all(isinstance(item, dict) for item in value):
            inner = _columns(value)[0]
            columns |= dict(_named(value)) or {
                f"{name}/{key}": values for key, values in inner.items()
            }
        else:
            columns[name] = value
    return columns, single


def _named(channels: list[dict[str, Any]]) -> Iterator[tuple[str, list[Any]]]:
    """Take channels apart that have a name, values, and perhaps a unit each."""
    for channel in channels:
        lists = [value for value in channel.values() if isinstance(value, list)]
        name, unit = (
            channel.get("name", channel.get("label")),
            channel.get("unit", channel.get("units")),
        )
        if len(lists) == 1 and isinstance(name, str):
            yield (
                (f"{name} [{unit}]" if isinstance(unit, str) and unit else name),
                lists[0],
            )


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if not isinstance(value, dict):
        yield name, value
        return
    for key, inner in value.items():
        yield from _leaves(inner, f"{name}/{key}".lstrip("/"))


# --- Igor Pro: waves between BEGIN and END, and the scales that commands state below
# them ------------------

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
        A line between BEGIN and END has another number of cells than there are waves,
        or no numbers.
    """
    with open(request.address.path, "rb") as file:
        text = decoded(re.sub(rb"\r\n?", b"\n", file.read()))
    sources: dict[str, ColumnSource] = {}
    for block in _BLOCK.finditer(text):
        if not block["end"]:
            raise InputError(
                f"{request.place}: the last wave has no END: the file was cut"
            )
        names = _names(block["names"])
        first = text.count("\n", 0, block.start("rows")) + 1
        lines = [
            line
            for line in enumerate(block["rows"].split("\n"), start=first)
            if line[1].strip()
        ]
        width = len(lines[0][1].split()) if lines else 0
        if len(names) == 1 and width > 1:  # a matrix
            names = [f"{names[0]}[{number}]" for number in range(1, width + 1)]
        rows = [
            _row(f"{request.place}:{number}", line, len(names))
            for number, line in lines
        ]
        columns = np.array(rows).reshape(len(rows), len(names)).T
        sources |= {
            name: array_source(name, column)
            for name, column in zip(names, columns, strict=True)
        }
    for match in _SCALE.finditer(text):
        names = _names(match["names"])
        for label in (label for label in sources if label.partition("[")[0] in names):
            sources[label] = _scaled(sources[label], match)
    return ColumnTable(request, "Igor text", list(sources.values()))


def _names(text: str) -> list[str]:
    return [name.strip("'") for name in re.findall(_NAME, text)]


def _row(place: str, line: str, width: int) -> list[float]:
    cells = line.split()
    values = [
        float("nan") if cell.upper() == "NAN" else to_number(cell, ".")
        for cell in cells
    ]
    numbers = [value for value in values if value is not None]
    if len(numbers) != width or len(cells) != width:
        raise InputError(
            f"{place}: not one number for each of {counted(width, 'wave')}: '{line[:40]}'"
        )
    return numbers


def _scaled(source: ColumnSource, match: re.Match[str]) -> ColumnSource:
    """Take a unit (axis d, or y), or start and step (axis x, in seconds) from a ``SetScale``."""
    first, second = (
        to_number(match["first"].strip(), "."),
        to_number(match["second"].strip(), "."),
    )
    if match["axis"].lower() != "x":
        return replace(source, unit=match["unit"] or None)
    unit = time_unit(match["unit"])
    if first is None or second is None or unit is None:
        return source
    step = (
        second
        if (match["how"] or "").upper() == "/P"
        else (second - first) / max(1, source.length - 1)
    )
    if not step > 0.0:
        return source
    start, step = FACTORS[unit].apply(np.array([first, step])).tolist()
    return replace(
        source, start=start, clock=(Statement(f"'SetScale' {step:g} s", 1.0 / step),)
    )


# --- tables of data bases: a row for each value, or several rows a stamp ---

_TIMES = (*TIME_NAMES, *MORE_TIME_NAMES)
SIGNALS = ("field", "series", "channel", "variable", "metric", "signal", "topic", "parameter", "sensor",
            "tag", "name", "measurement", "table")  # fmt: skip
_MOST = 256  # signals; more, and the column is none of names
_READ = 1 << 20  # bytes at a time; chosen


def rows_of_values(request: Request, table: TextTable) -> Table:
    """Return a table of a data base that has a row for each value, side by side; any other as it is.

    Raises
    ------
    InputError
        It is one, and comes through a pipe.
    """
    names = {name.strip("_").lower() for name in table.dialect.headers}
    if not (table.dialect.sparse or "value" in names):
        return table
    opened, close = None, True
    try:
        if table.source.is_regular:
            opened = side_by_side(request, table.dialect)
        elif names & set(SIGNALS) and not request.named:
            raise InputError(
                f"{table.place}: a row for each value: give it as a file, not through a pipe"
            )
        close = opened is not None
    finally:
        if close:
            table.close()
    return opened or table


def side_by_side(request: Request, dialect: Dialect) -> ColumnTable | None:
    """Read a long table as a whole, its signals as columns; None where each row turns out to be a sample.

    Raises
    ------
    InputError
        A signal has two values at one time or two units, or the signals have times of
        their own.
    """
    names = [name.strip().strip("_%").lower() for name in dialect.headers]
    time = next((names.index(name) for name in _TIMES if name in names), None)
    named = (
        [names.index(name) for name in SIGNALS if name in names]
        if "value" in names
        else []
    )
    if time is None or not (dialect.sparse or named):
        return None
    rows = list(_rows(request, dialect))
    stamps = list(dict.fromkeys(cells[time] for _, cells in rows))
    refusal = None
    for column in named:
        readings = (
            (n, cells[time], cells[column], cells[names.index("value")])
            for n, cells in rows
        )
        signals, clash = _signals(readings)
        if not 1 < len(signals) <= min(_MOST, len(rows) // 2):
            continue
        if clash is None:
            units = _units(request.place, names, column, rows)
            return _table(request, dialect, time, stamps, signals, units)
        refusal = refusal or clash
    if refusal is not None:
        raise InputError(
            f"{request.place}:{refusal} (narrow the query down to one source)"
        )
    if not dialect.sparse or len(stamps) == len(rows):
        return None
    heads = [(n, name) for n, name in enumerate(dialect.headers) if n != time]
    signals, clash = _signals(
        (number, cells[time], name, cells[n])
        for number, cells in rows
        for n, name in heads
        if cells[n]
    )
    return None if clash else _table(request, dialect, time, stamps, signals, {})


def _signals(
    values: Iterable[tuple[int, str, str, str]],
) -> tuple[dict[str, dict[str, str]], str | None]:
    """Sort values (line, stamp, signal, cell) by signal and stamp; also tell where two have one stamp."""
    signals: dict[str, dict[str, str]] = {}
    clash = None
    for number, stamp, name, cell in values:
        if signals.setdefault(name, {}).setdefault(stamp, cell) is not cell:
            clash = clash or f"{number}: '{name}' has two values at one time, {stamp}"
    return signals, clash


def _units(
    place: str, names: list[str], signal: int, rows: list[tuple[int, list[str]]]
) -> dict[str, str]:
    """Give the unit of each signal, where a column holds it."""
    column = next(
        (names.index(name) for name in ("unit", "units") if name in names), None
    )
    units: dict[str, str] = {}
    for number, cells in rows if column is not None else ():
        if units.setdefault(cells[signal], cells[column or 0]) != cells[column or 0]:
            raise InputError(
                f"{place}:{number}: '{cells[signal]}' changes its unit (bring it to one first)"
            )
    return units


def _table(
    request: Request,
    dialect: Dialect,
    time: int,
    stamps: list[str],
    signals: dict[str, dict[str, str]],
    units: dict[str, str],
) -> ColumnTable:
    whole = {
        name: cells for name, cells in signals.items() if 2 * len(cells) > len(stamps)
    }
    if len(whole) < 2:
        raise InputError(
            f"{request.place}: each signal has times of its own: put them side by side, then {FILL_GAPS}"
        )
    numbers = [to_number(stamp, dialect.decimal) for stamp in stamps]
    columns: dict[str, list[Any]] = {
        dialect.headers[time]: stamps if None in numbers else numbers
    }
    for name, cells in whole.items():
        columns[name] = [
            to_number(cells.get(stamp, ""), dialect.decimal) for stamp in stamps
        ]
    listed = [listed_source(name, values) for name, values in columns.items()]
    sources = [
        replace(source, unit=units.get(source.label) or source.unit)
        for source in listed
        if source is not None
    ]
    return ColumnTable(request, "a long table", sources)


def _rows(request: Request, dialect: Dialect) -> Iterator[tuple[int, list[str]]]:
    """Give the rows of data with their line numbers; names that stand again are left out."""
    with closing(ByteSource(request)) as source:
        text = b"".join(iter(lambda: source.read(_READ), b""))
    for number, line in enumerate(text.split(b"\n"), start=1):
        words = decoded(line.removesuffix(b"\r"))
        if number < dialect.first_line or dialect.is_comment(words):
            continue
        cells = dialect.cells(words)
        if len(cells) >= dialect.width and cells[: dialect.width] != list(
            dialect.headers
        ):
            yield number, cells
