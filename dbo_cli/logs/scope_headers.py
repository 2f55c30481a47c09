"""The headers of oscilloscopes: Tektronix, Rigol, Keysight, Rohde & Schwarz.

Written after the makers' manuals and files published with them; each reader gives None for any other file.
"""

from __future__ import annotations

import re

from dbo_cli.logs.cell_grammar import is_number, split_cells
from dbo_cli.logs.header_parts import HeaderReading, make_dialect, number_row, to_float
from dbo_cli.logs.stated_clock import Statement, read_statement

_LONGEST = 300  # characters of a line of settings
_SETTING = re.compile(r"([A-Za-z][A-Za-z ]*)[:,\t](.*)")


def _statement(name: str, value: str, unit: str | None = None) -> tuple[Statement, ...]:
    found = read_statement(name, value, unit, sure=True)
    return (found,) if found is not None else ()


def read_tektronix_rows(place: str, lines: list[str]) -> HeaderReading | None:
    """Read the TDS series' files: settings in two columns, beside the first rows of time and volts."""
    if not lines or not lines[0].startswith("Record Length,"):
        return None
    first = split_cells(lines[0], ",")
    if len(first) < 5 or not all(is_number(cell, ".") for cell in first[3:5]):
        return None
    settings = {}
    for line in lines:
        cells = split_cells(line, ",")
        if len(cells) < 2 or not cells[0]:
            break
        settings[cells[0].lower()] = cells[1]
    width = len(first) - (not first[-1])
    source = settings.get("source", "")
    names = ["", "", "", "time", source if width == 5 else ""]
    units = [
        "",
        "",
        "",
        settings.get("horizontal units", ""),
        settings.get("vertical units", "") if width == 5 else "",
    ]
    dialect = make_dialect(",", ".", 1, names, units, width)
    return HeaderReading(dialect, _statement("Sample Interval", settings.get("sample interval", "")))


def read_tektronix_table(place: str, lines: list[str]) -> HeaderReading | None:
    """Read the MSO, DPO and MDO series' files: settings by channel, then ``TIME,CH1,CH2`` and the rows."""
    header = next((n for n, line in enumerate(lines[:100]) if re.match(r"TIME,\s*[A-Z]", line)), None)
    if header is None:
        return None
    settings = {}
    for line in lines[:header]:
        cells = split_cells(line, ",")
        if cells[0]:
            settings[cells[0].lower()] = cells[1:]
    if "sample interval" not in settings and "horizontal units" not in settings:
        return None
    first = number_row(lines, header + 1, ",", ".")
    if first is None:
        return None
    names = split_cells(lines[header], ",")
    width = len(split_cells(lines[first], ","))
    if abs(width - len(names)) > 1:
        return None
    horizontal = (settings.get("horizontal units") or ["s"])[
        0
    ] or "s"  # the maker's unit of time is the second
    vertical = settings.get("vertical units") or []
    if len(vertical) == 1 or len([one for one in vertical if one]) == 1:
        vertical = [vertical[0]] if len(names) == 2 else vertical
    dialect = make_dialect(",", ".", first + 1, names, [horizontal, *vertical], width)
    interval = (settings.get("sample interval") or [""])[0]
    return HeaderReading(dialect, _statement("Sample Interval", interval))


def read_rigol(place: str, lines: list[str]) -> HeaderReading | None:
    """Read the files of the DS series (``Start,Increment``) and of the MSO series (``t0, tInc``)."""
    if not lines:
        return None
    first = split_cells(lines[0], ",")
    lower = [cell.lower() for cell in first]
    if lower and lower[0] == "x" and "start" in lower and "increment" in lower and len(lines) > 2:
        second = split_cells(lines[1], ",")
        at = lower.index("increment")
        start = to_float(second[lower.index("start")]) if len(second) > at else None
        channels = lower.index("start")
        width = len(split_cells(lines[2], ","))
        if start is None or width < channels or second[0].lower() not in ("sequence", "second"):
            return None
        names = ["time" if second[0].lower() == "second" else "sequence", *first[1:channels]]
        units = ["s" if names[0] == "time" else "", *second[1:channels]]
        dialect = make_dialect(",", ".", 3, names, units, width)
        return HeaderReading(dialect, _step("Increment", second[at]), start)
    found = re.search(r"t0\s*=\s*([^,\s]+)\s*,\s*tInc\s*=\s*([^,\s]+)", lines[0][:_LONGEST])
    if found is None or len(lines) < 2:
        return None
    named = [cell for cell in lower if not cell.startswith(("t0", "tinc"))]
    names, units = [], []
    for cell in [first[lower.index(one)] for one in named if one]:
        channel = re.fullmatch(r"(.+?)\(?([mu]?V|A)\)?", cell)
        names.append(channel[1] if channel else cell)
        units.append(channel[2] if channel else "")
    dialect = make_dialect(",", ".", 2, names, units, len(split_cells(lines[1], ",")))
    return HeaderReading(dialect, _step("tInc", found[2]), to_float(found[1]) or 0.0)


def _step(name: str, value: str) -> tuple[Statement, ...]:
    """Read a step in seconds under the name that the maker gives it."""
    step = to_float(re.sub(r"s$", "", value.strip()))
    if step is None or not step > 0.0:
        return ()
    return (Statement(f"'{name}' {value.strip()}", 1.0 / step),)


def read_infiniivision(place: str, lines: list[str]) -> HeaderReading | None:
    """Read Keysight's and Agilent's InfiniiVision files: ``x-axis,1,2`` over ``second,Volt,Volt``."""
    if len(lines) < 3 or not lines[0].lower().startswith("x-axis,"):
        return None
    names, units = split_cells(lines[0], ","), split_cells(lines[1], ",")
    first = number_row(lines, 2, ",", ".")
    if first is None or len(units) != len(names) or is_number(units[0], "."):
        return None
    width = len(split_cells(lines[first], ","))
    return HeaderReading(make_dialect(",", ".", first + 1, names, units, width))


def read_infiniium(place: str, lines: list[str]) -> HeaderReading | None:
    """Read Keysight's Infiniium files: ``XInc``, ``XOrg``, ``YUnits`` and more above ``Data``."""
    settings: dict[str, str] = {}
    first = None
    for index, line in enumerate(lines[:100]):
        found = _SETTING.match(line[:_LONGEST].strip())
        if line.strip().lower().rstrip(":,") == "data" and "xinc" in settings:
            first = number_row(lines, index + 1, ",", ".")
            break
        if found is None:
            if "xinc" in settings and number_row([line], 0, ",", ".") == 0:
                first = index
            break
        settings[found[1].strip().lower()] = found[2].strip(" :,\t")
    if first is None or not {"xinc", "xorg"} <= set(settings):
        return None
    unit, measured = settings.get("xunits", ""), settings.get("yunits", "")
    width = len(split_cells(lines[first].rstrip(", "), ","))
    names, units = (["time", "signal"], [unit, measured]) if width == 2 else (["signal"], [measured])
    if width > 2:
        names, units = ["time", *[f"signal {number}" for number in range(1, width)]], [unit]
    dialect = make_dialect(",", ".", first + 1, names, units, width)
    clock = read_statement("XInc", settings["xinc"], unit or None, sure=True)
    return HeaderReading(dialect, (clock,) if clock else (), to_float(settings["xorg"]) or 0.0)


def read_rohde_schwarz(place: str, lines: list[str]) -> HeaderReading | None:
    """Read the RTB, RTM and RTA series' files: ``in s,CH1 in V,CH2 in V``."""
    if not lines or not re.match(r"in (?:[munp]?s)\s*[,;]", lines[0]):
        return None
    delimiter = "," if "," in lines[0] else ";"
    cells = split_cells(lines[0], delimiter)
    parts = [cell.rsplit(" in ", 1) for cell in cells[1:]]
    names = ["time", *(part[0] for part in parts)]
    units = [cells[0].removeprefix("in "), *(part[1] if len(part) == 2 else "" for part in parts)]
    decimal = "," if delimiter == ";" and re.search(r"\d,\d", lines[1] if len(lines) > 1 else "") else "."
    return HeaderReading(make_dialect(delimiter, decimal, 2, names, units, len(names)))
