"""The header of LabVIEW's measurement files (.lvm), after National Instruments' specification of the format."""

from __future__ import annotations

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
    if len(ends) < 2:
        return None
    file = {}
    for line in lines[: ends[0]]:
        key, _, value = line.replace(",", "\t", 1).partition("\t")
        file[key.strip()] = value.strip("\t, ")
    delimiter = _SEPARATORS.get(file.get("Separator", "Tab").lower(), "\t")
    channels: dict[str, list[str]] = {}
    for line in lines[ends[0] + 1 : ends[1]]:
        cells = split_cells(line, delimiter)
        if cells[0]:
            channels[cells[0]] = cells[1:]
    header = ends[1] + 1
    if header + 1 >= len(lines):
        return None
    names = split_cells(lines[header], delimiter)
    while names and names[-1] in ("", "Comment"):
        names.pop()
    columns = file.get("X_Columns", "One").lower()
    if columns == "multi":
        raise InputError(
            f"{place}: every channel has its own X column (X_Columns Multi): write it with X_Columns One or No"
        )
    width = max(len(names), len(split_cells(lines[header + 1], delimiter)))
    decimal = file.get("Decimal_Separator", ".") or "."
    first_channel = next((n for n, name in enumerate(names) if n and name), 1)
    units = ["", *_units(channels, len(names), first_channel)]
    timed = all(one.lower() == "time" for one in channels.get("X_Dimension", ["Time"]) if one)
    if columns == "no":
        names = ["", *names[1:]]  # the X column is there, but its cells are empty
    elif timed:
        units[0] = "s"
    clock = _clock(channels) if timed else ()
    start = to_float(next((one for one in channels.get("X0", []) if one), "0")) or 0.0
    if file.get("Time_Pref", "Relative").lower() != "relative":
        start = 0.0  # X0 then counts from some day in the past
    dialect = make_dialect(delimiter, "," if decimal == "," else ".", header + 2, names, units, width)
    return HeaderReading(dialect, clock, start)


def _units(channels: dict[str, list[str]], width: int, first: int) -> list[str]:
    """Give each channel's unit, in the columns behind the X column."""
    labels = channels.get("Y_Unit_Label", [])
    return ["", *labels][1:width] if len(labels) >= width - first else [*labels, *[""] * width][: width - 1]


def _clock(channels: dict[str, list[str]]) -> tuple[Statement, ...]:
    found = []
    for value in channels.get("Delta_X", []):
        step = to_float(value) if value else None
        if step is not None and step > 0.0:
            found.append(Statement(f"'Delta_X' {value}", 1.0 / step))
    return tuple(dict.fromkeys(found))
