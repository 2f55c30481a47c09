"""Tables of data bases that hold a sample in several rows: a row for each value, or several rows a stamp.

Grafana's series, Flux' annotated CSV and what SQL gives name the signal in one column and its value in
another (a long table); joins of signals leave rows with one value each. Both are put side by side here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import ByteSource, Request
from dbo_cli.logs.column_names import MORE_TIME_NAMES, TIME_NAMES
from dbo_cli.logs.column_table import ColumnTable, listed_source
from dbo_cli.logs.plain_text import decoded
from dbo_cli.logs.reading_options import FILL_GAPS
from dbo_cli.logs.text.dialect import Dialect, is_comment
from dbo_cli.logs.text.lines import split_cells, to_number

_TIMES = (*TIME_NAMES, *MORE_TIME_NAMES)
_VALUES = ("value",)
SIGNALS = ("field", "series", "channel", "variable", "metric", "signal", "topic", "parameter", "sensor",
            "tag", "name", "measurement", "table")  # fmt: skip
_MOST = 256  # signals; more, and the column is none of names
_READ = 1 << 20  # bytes at a time


def side_by_side(request: Request, dialect: Dialect) -> ColumnTable | None:
    """Read a long table as a whole, its signals as columns; None where each row turns out to be a sample.

    Raises
    ------
    InputError
        A signal has two values at one time or two units, or the signals have times of their own.
    """
    names = [name.strip().strip("_%").lower() for name in dialect.headers]
    times, values = ([name for name in wanted if name in names] for wanted in (_TIMES, _VALUES))
    named = [names.index(name) for name in SIGNALS if name in names] if values else []
    if not times or not (dialect.sparse or named):
        return None
    rows, time = list(_rows(request, dialect)), names.index(times[0])
    stamps = dict.fromkeys(cells[time] for _, cells in rows)
    refusal = None
    for column in named:
        place = names.index(values[0])
        signals, clash = _signals(
            (number, cells[time], [(cells[column], cells[place])]) for number, cells in rows
        )
        if not 1 < len(signals) <= min(_MOST, len(rows) // 2):
            continue
        if clash is None:
            units = _units(request.place, names, column, rows)
            return _table(request, dialect, time, list(stamps), signals, units)
        refusal = refusal or clash
    if refusal is not None:
        raise InputError(f"{request.place}:{refusal} (narrow the query down to one source)")
    if not dialect.sparse or len(stamps) == len(rows):
        return None
    heads = [*enumerate(dialect.headers)]
    signals, clash = _signals(
        (number, cells[time], [(name, cells[n]) for n, name in heads if cells[n] and n != time])
        for number, cells in rows
    )
    return None if clash else _table(request, dialect, time, list(stamps), signals, {})


def _signals(
    rows: Iterable[tuple[int, str, list[tuple[str, str]]]],
) -> tuple[dict[str, dict[str, str]], str | None]:
    """Sort values by signal and stamp; also say where a signal has two values at one time."""
    signals: dict[str, dict[str, str]] = {}
    clash = None
    for number, stamp, held in rows:
        for name, cell in held:
            if signals.setdefault(name, {}).setdefault(stamp, cell) is not cell:
                clash = clash or f"{number}: '{name}' has two values at one time, {stamp}"
    return signals, clash


def _units(place: str, names: list[str], signal: int, rows: list[tuple[int, list[str]]]) -> dict[str, str]:
    """Give the unit of each signal, where a column holds it."""
    column = next((names.index(name) for name in ("unit", "units") if name in names), None)
    units: dict[str, str] = {}
    for number, cells in rows if column is not None else ():
        if units.setdefault(cells[signal], cells[column or 0]) != cells[column or 0]:
            raise InputError(f"{place}:{number}: '{cells[signal]}' changes its unit (bring it to one first)")
    return units


def _table(
    request: Request,
    dialect: Dialect,
    time: int,
    stamps: list[str],
    signals: dict[str, dict[str, str]],
    units: dict[str, str],
) -> ColumnTable:
    whole = {name: cells for name, cells in signals.items() if 2 * len(cells) > len(stamps)}
    if len(whole) < 2:
        raise InputError(
            f"{request.place}: each signal has times of its own: put them side by side, then {FILL_GAPS}"
        )
    numbers = [to_number(stamp, dialect.decimal) for stamp in stamps]
    columns: dict[str, list[Any]] = {dialect.headers[time]: stamps if None in numbers else numbers}
    for name, cells in whole.items():
        columns[name] = [to_number(cells.get(stamp, ""), dialect.decimal) for stamp in stamps]
    found = [listed_source(name, values) for name, values in columns.items()]
    sources = [replace(one, unit=units.get(one.label) or one.unit) for one in found if one is not None]
    return ColumnTable(request, "a long table", sources)


def _rows(request: Request, dialect: Dialect) -> Iterator[tuple[int, list[str]]]:
    """Give the rows of data with their line numbers; names that stand again are left out."""
    source = ByteSource(request)
    try:
        text = b"".join(iter(lambda: source.read(_READ), b""))
    finally:
        source.close()
    for number, line in enumerate(text.split(b"\n"), start=1):
        words = decoded(line.removesuffix(b"\r"))
        if number < dialect.first_line or is_comment(words, dialect.comments):
            continue
        cells = split_cells(words, dialect.delimiter)
        if len(cells) >= dialect.width and cells[: dialect.width] != list(dialect.headers):
            yield number, cells
