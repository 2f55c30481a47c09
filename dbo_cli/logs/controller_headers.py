"""The headers of controllers' recorders: PI's GCS arrays and Beckhoff's TwinCAT Scope."""

from __future__ import annotations

import re

from dbo_cli.errors import InputError
from dbo_cli.logs.cell_grammar import BLANKS, split_cells
from dbo_cli.logs.header_parts import HeaderReading, decimal_of, make_dialect, number_row, to_float
from dbo_cli.logs.stated_clock import Statement

_FILETIME = 1e16  # counts of 100 ns since 1601 are above, milliseconds since the start of a recording below
_TWINCAT_KEYS = (
    "Name",
    "SymbolName",
    "SymbolComment",
    "Unit",
    "SampleTime[ms]",
    "ScaleFactor",
    "Offset",
    "Data-Type",
)


def read_pi_array(place: str, lines: list[str]) -> HeaderReading | None:
    """Read a GCS array of PI's data recorder: ``SAMPLE_TIME`` in s, ``SEPARATOR`` as a code, names.

    Raises
    ------
    InputError
        The rows have another number of columns than the header states.
    """
    marked = (n for n, line in enumerate(lines) if "END_HEADER" in line)
    end = next((n for n in marked if re.match(r"\s*#\s*END_HEADER", lines[n])), None)
    if end is None or end + 1 >= len(lines):
        return None
    settings: dict[str, str] = {}
    for line in lines[:end]:
        found = re.fullmatch(r"\s*#\s*([A-Z_]+\s?\d*)\s*=\s*(.*?)\s*", line[:300])
        if found is not None:
            settings[found[1].replace(" ", "")] = found[2]
    if not {"SAMPLE_TIME", "NDATA", "DIM"} & set(settings):
        return None
    code = to_float(settings.get("SEPARATOR", "9"))
    delimiter = chr(int(code)) if code is not None and 0 < code < 127 else "\t"
    delimiter = BLANKS if delimiter == " " or delimiter not in lines[end + 1] else delimiter
    width = len([cell for cell in split_cells(lines[end + 1].rstrip(), delimiter) if cell])
    names = [settings.get(f"NAME{number}", "") for number in range(width)]
    stated = to_float(settings.get("DIM", ""))
    if stated is not None and int(stated) != width:
        raise InputError(
            f"{place}:{end + 2}: {width} cells where the header states DIM = {int(stated)} columns "
            "(`skip_lines` and `header_lines` 0 read it without the header)"
        )
    step = to_float(settings.get("SAMPLE_TIME", ""))
    clock = (
        (Statement(f"'SAMPLE_TIME' {settings['SAMPLE_TIME']} s", 1.0 / step),) if step and step > 0.0 else ()
    )
    return HeaderReading(make_dialect(delimiter, ".", end + 2, names, [], width), clock)


def read_twincat(place: str, lines: list[str]) -> HeaderReading | None:
    """Read TwinCAT Scope's text export: a block of keys by channel, then time stamps (ms) and values.

    Raises
    ------
    InputError
        The channels are sampled at different times, so that the rows do not belong together.
    """
    at = next((n for n, line in enumerate(lines[:100]) if line.startswith("SampleTime[ms]")), None)
    if at is None:
        return None
    delimiter = lines[at][len("SampleTime[ms]") : len("SampleTime[ms]") + 1]
    if delimiter not in ("\t", ",", ";"):
        return None
    rows: dict[str, list[str]] = {}
    for number, line in enumerate(lines[:100]):
        cells = split_cells(line, delimiter)
        if cells[0] in _TWINCAT_KEYS:
            at = number
            rows[cells[0]] = cells  # the first "Name" is the project's; the channels' comes after it
    if "Name" not in rows:
        return None
    names = rows["Name"]
    channels = _channels(names)
    step = _sample_time(place, rows["SampleTime[ms]"], channels)
    decimal = decimal_of(lines, at + 1, delimiter)
    first = number_row(lines, at + 1, delimiter, decimal)
    if first is None:
        return None
    cells = split_cells(lines[first], delimiter)
    labels, units = [""] * len(cells), [""] * len(cells)
    for n in (n for n in channels if n < len(cells)):
        labels[n] = names[n]
        units[n] = rows["Unit"][n] if "Unit" in rows and n < len(rows["Unit"]) else ""
    stamp = to_float(cells[0])
    if stamp is not None and stamp < _FILETIME:
        labels[0], units[0] = "time", "ms"
    clock = (Statement(f"'SampleTime[ms]' {step:g}", 1000.0 / step),) if step and step > 0.0 else ()
    dialect = make_dialect(delimiter, decimal, first + 1, labels, units, len(cells))
    return HeaderReading(dialect, clock, remarks=_scales(rows, names, channels), end_mark=b"EOF")


def _channels(names: list[str]) -> list[int]:
    """Tell in which columns the values are: each behind its own stamps, or all behind the first column's."""
    keys = [n for n, cell in enumerate(names) if cell == "Name"]
    if len(keys) > 1 or len([cell for cell in names if cell]) == 2:
        return [n + 1 for n in keys]
    return [n for n in range(1, len(names)) if names[n]]


def _sample_time(place: str, cells: list[str], channels: list[int]) -> float | None:
    steps = {cells[n] for n in channels if n < len(cells)}
    if len(steps) > 1:
        raise InputError(
            f"{place}: the channels are sampled every {' and '.join(sorted(steps))} ms, and rows of "
            "different times stand beside each other: export channels of one sample time"
        )
    return to_float(steps.pop()) if steps else None


def _scales(rows: dict[str, list[str]], names: list[str], channels: list[int]) -> tuple[str, ...]:
    """Say which channels have a scale that the export may or may not have applied."""
    found = []
    for key, plain in (("ScaleFactor", 1.0), ("Offset", 0.0)):
        for n in channels:
            value = to_float(rows[key][n]) if key in rows and n < len(rows[key]) else None
            if value is not None and value != plain:
                found.append(
                    f"channel '{names[n]}' has {key} {value:g}, and the file does not say whether its "
                    "values are scaled already (Scope: 'Scale values before export')"
                )
    return tuple(found)
