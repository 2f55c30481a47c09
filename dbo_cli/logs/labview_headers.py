"""The header of LabVIEW's measurement files (.lvm), after National Instruments' specification."""

from __future__ import annotations

import re

from dbo_cli.errors import InputError
from dbo_cli.logs.cell_grammar import split_cells
from dbo_cli.logs.header_parts import HeaderReading, make_dialect, to_float
from dbo_cli.logs.stated_clock import Statement

_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}


def read_lvm(place: str, lines: list[str]) -> HeaderReading | None:
    """Read an .lvm header: separator, decimal sign, and by channel the unit, ``X0`` and ``Delta_X``.

    Raises
    ------
    InputError
        Every channel has its own X column, and they cannot be told to be the same.
    """
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        return None
    ends = [number for number, line in enumerate(lines) if line.startswith(_END)]
    if len(ends) < 2 or ends[1] + 2 >= len(lines):
        return None
    file = _file_header(lines[: ends[0]])
    delimiter = _SEPARATORS.get(file.get("Separator", "Tab").lower(), "\t")
    rows = [split_cells(line, delimiter) for line in lines[ends[0] + 1 : ends[1] + 3]]
    channels = {cells[0]: cells[1:] for cells in rows[:-2] if cells[0]}
    names = rows[-2]
    while names and names[-1] in ("", "Comment"):
        names.pop()
    x_columns = file.get("X_Columns", "One").lower()
    if x_columns == "multi":
        raise InputError(
            f"{place}: every channel has its own X column (X_Columns Multi): write it with X_Columns One "
            "or No"
        )
    units = ["", *channels.get("Y_Unit_Label", [])]
    timed = all(one.lower() == "time" for one in channels.get("X_Dimension", []) if one)
    if x_columns == "no":
        names = ["", *names[1:]]  # the X column is there, but its cells are empty
    elif timed:
        units[0] = "s"
    relative = (
        file.get("Time_Pref", "Relative").lower() == "relative"
    )  # else X0 counts from a day in the past
    start = to_float(next((one for one in channels.get("X0", []) if one), "")) if relative else None
    decimal = "," if file.get("Decimal_Separator") == "," else "."
    width = max(len(names), len(rows[-1]))
    dialect = make_dialect(delimiter, decimal, ends[1] + 3, names, units, width)
    return HeaderReading(dialect, _clock(channels) if timed else (), start or 0.0)


def _file_header(lines: list[str]) -> dict[str, str]:
    """Read the keys of the file as a whole; the separator that is stated already separates them."""
    found = {}
    for line in lines:
        match = re.match(r"(\w+)([\t,;])(.*)", line)
        if match is not None:
            found[match[1]] = match[3].rstrip("\t ").removesuffix(match[2]) or match[3].strip("\t ")
    return found


def _clock(channels: dict[str, list[str]]) -> tuple[Statement, ...]:
    found = []
    for value in channels.get("Delta_X", []):
        step = to_float(value) if value else None
        if step is not None and step > 0.0:
            found.append(Statement(f"'Delta_X' {value}", 1.0 / step))
    return tuple(dict.fromkeys(found))
