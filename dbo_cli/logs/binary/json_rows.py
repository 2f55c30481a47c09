"""JSON as a table of columns: a record a line, an array of records, or an object of arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import Request
from dbo_cli.logs.column_table import ColumnTable, listed_source, statements_in, without_scalars


def open_json(request: Request) -> ColumnTable:
    """Open JSON, read as a whole; what lies in objects is named by its path (``fields/voltage``).

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
        by_lines = len(lines) > 1 and isinstance(document, dict | list)
        document = list(_by_line(request.place, lines)) if by_lines else document
    except ValueError:
        document = _parsed(request.place, text)
    with request.reading("JSON", (OverflowError, RecursionError)):
        columns, single = _columns(document)
        found = [listed_source(name, values) for name, values in columns.items()]
    sources = without_scalars([source for source in found if source is not None])
    if not sources:
        raise request.no_columns(columns or single, ' (write a line a row: {"time": 0, "voltage": 1.5})')
    return ColumnTable(request, "JSON", sources, clock=statements_in(single))


def _by_line(place: str, lines: list[str]) -> Iterator[Any]:
    for number, line in enumerate(lines, start=1):
        if line.strip():
            yield _parsed(f"{place}:{number}", line)


def _parsed(place: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as problem:
        where = f":{problem.lineno}" if isinstance(problem, json.JSONDecodeError) and "\n" in text else ""
        raise InputError(f"{place}{where}: this is not JSON: {str(problem).partition(':')[0]}") from None


def _columns(document: Any) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Take columns and single values out of records, of rows below a row of names, or of an object."""
    if isinstance(document, dict):
        split = all(isinstance(document.get(part), list) for part in ("columns", "data"))
        if split and len(document) < 4:  # pandas' orient="split"
            document = [document["columns"], *document["data"]]
    if isinstance(document, list):
        if document and all(isinstance(row, list) for row in document):
            document = [dict(zip(map(str, document[0]), row, strict=False)) for row in document[1:]]
        records = [dict(_leaves(record)) for record in document if isinstance(record, dict)]
        names = dict.fromkeys(name for record in records for name in record)
        return {name: [record.get(name) for record in records] for name in names}, {}
    columns: dict[str, list[Any]] = {}
    single: dict[str, Any] = {}
    for name, value in _leaves(document):
        if isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            columns |= dict(_named(value)) or {
                f"{name}/{inner}": values for inner, values in _columns(value)[0].items()
            }
        elif isinstance(value, list):
            columns[name] = value
        else:
            single[name.rpartition("/")[2]] = value
    return columns, single


def _named(channels: list[dict[str, Any]]) -> Iterator[tuple[str, list[Any]]]:
    """Take channels apart that have a name, values, and perhaps a unit each."""
    for one in channels:
        held = [value for value in one.values() if isinstance(value, list)]
        name, unit = one.get("name", one.get("label")), one.get("unit", one.get("units"))
        if len(held) == 1 and isinstance(name, str):
            yield (f"{name} [{unit}]" if isinstance(unit, str) and unit else name), held[0]


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}/{key}".lstrip("/"))
    else:
        yield name, value
