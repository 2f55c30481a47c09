"""Text headers that carry the answer: names, units, rate and start as an instrument or controller wrote them.

Written after the makers' manuals and files published with them.  A maker is recognised
by words that only its files have; everything else is left to ``text.dialect``.  What a
header states of the sample rate is read whoever wrote it (``Sampling rate: 10 kHz``),
and used where the log has no time column.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from dbo_cli.errors import InputError, decoded
from dbo_cli.logs.clock import Statement, is_clock_name, read_statements
from dbo_cli.logs.request import BLANKS, ReadingOptions
from dbo_cli.logs.text.dialect import COMMENTS, SAMPLE_LINES, Dialect, detect
from dbo_cli.logs.text.lines import (
    END_OF_HEADER,
    find_repeated_header,
    is_number,
    split_cells,
)

_LOOKED_AT = 400  # lines; no instrument's header is half as long
_NEAR = 100  # lines; makers that write a few settings begin their table above
_LONGEST = 300  # characters of a line that states something
_MARK = re.compile(r"[=:;,\t]")


def read_instrument_header(place: str, head: bytes, options: ReadingOptions) -> Dialect:
    """Read the header of a text log.

    Parameters
    ----------
    place
        The log's name, for messages.
    head
        The first lines.
    options
        Where the user gives the way the text is written, no maker's layout is assumed.

    Raises
    ------
    InputError
        The header is a known maker's and contradicts itself; or there is no line of
        numbers.
    """
    raw_lines = head.split(b"\n", _LOOKED_AT)[:_LOOKED_AT]
    lines = [decoded(line.removesuffix(b"\r")) for line in raw_lines]
    lines[0] = lines[0].removeprefix("\ufeff")
    forced = (
        options.delimiter,
        options.decimal,
        options.comment,
        options.skip_lines,
        options.header_lines,
    )
    if all(option is None for option in forced):
        header = _makers_header(place, lines)
        if header is not None:
            above = lines[: header.first_line - 1]
            return replace(header, clock=header.clock or tuple(_stated(above)))
    return replace(detect(place, head, options), clock=tuple(_stated(lines)))


def _makers_header(place: str, lines: list[str]) -> Dialect | None:
    """Read the header of the first maker whose mark it has; None for a maker that is not known."""
    for maker in _MAKERS:
        for index, line in enumerate(lines[: maker.within]):
            if maker.mark.match(line[:_LONGEST]):
                header = maker.read(place, lines, index)
                if header is not None:
                    return header
                break
    return None


def _stated(lines: Sequence[str]) -> Iterator[Statement]:
    """Find the lines above the data that state a rate or a step: ``key = value``, ``key: value``."""
    for line in lines:
        if len(line) > _LONGEST:
            continue
        mark = _MARK.search(line)
        if mark is None:
            continue
        key = line[: mark.start()].strip().lstrip("#%;!/*").strip()
        # a row of data is the usual case
        if not key[:1].isalpha() or not is_clock_name(key):
            continue
        value = _first_value(line[mark.end() :].strip(" ,;\t"), mark[0])
        thousands = re.fullmatch(r"(\d{1,3}),(\d{3})(\D*)", value)
        if thousands is not None:
            text = f"'{key}' {value}"
            either = f"{thousands[1]} or {thousands[1]}{thousands[2]}"
            yield Statement(text, None, f"{text} may be {either}")
        else:
            yield from read_statements(key, value)


def _first_value(text: str, mark: str) -> str:
    """Take the first channel's value of a line, with its unit where that has a cell of its own."""
    value = re.split(r"[\t;]|,\s*(?=,|$)", text)[0].strip()
    if mark != "," and re.fullmatch(r"\d+,\d+\s*\D*", value):
        # 1,000 is 1 to some and 1000 to others
        if re.fullmatch(r"\d{1,3},\d{3}\D*", value):
            return value
        return value.replace(",", ".")
    cells = [cell.strip() for cell in value.split(",")]
    if len(cells) == 2 and is_number(cells[0], ".") and not is_number(cells[1], "."):
        return f"{cells[0]} {cells[1]}"
    return cells[0] if len(set(cells)) == 1 else value


# What the makers' readers share.


def _header(
    lines: Sequence[str],
    first: int,
    names: Sequence[str],
    units: Sequence[str],
    width: int | None = None,
    delimiter: str = ",",
    decimal: str = ".",
    **stated: Any,
) -> Dialect:
    """Describe a table whose rows begin at index ``first``; names and units are filled up to its width.

    ``stated`` are further fields of the dialect.
    """
    width = len(split_cells(lines[first], delimiter)) if width is None else width
    filled = [tuple([*cells, *[""] * width][:width]) for cells in (names, units)]
    rows = [split_cells(line, delimiter) for line in lines[first:][-SAMPLE_LINES:]]
    rows = [row for row in rows if len(row) >= width]
    counts = [sum(is_number(row[n], decimal) for row in rows) for n in range(width)]
    return Dialect(
        delimiter, decimal, COMMENTS, width, first + 1, filled[0], filled[1] if any(units) else (),
        numeric=frozenset(n for n, count in enumerate(counts) if count and 2 * count >= len(rows)),
        repeated_header=find_repeated_header(lines, first, delimiter),
        **stated,
    )  # fmt: skip


def _number_row(
    lines: Sequence[str], start: int, delimiter: str = ",", decimal: str = "."
) -> int | None:
    """Find the first line from index ``start`` on whose filled cells are all numbers."""
    for index in range(start, len(lines)):
        cells = [cell for cell in split_cells(lines[index], delimiter) if cell]
        if cells and all(is_number(cell, decimal) for cell in cells):
            return index
    return None


def _number(text: str) -> float | None:
    """Read a number with either decimal sign; None for anything else."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        return None


def _step(name: str, value: str, unit: str = "") -> tuple[Statement, ...]:
    """Read a step, in seconds by the maker's definition, under the name that it has in the file."""
    step = _number(value.strip().removesuffix("s"))
    if step is None or not step > 0.0:
        return ()
    return (Statement(f"'{name}' {value.strip()}{unit}", 1.0 / step),)


def _settings(lines: Sequence[str]) -> dict[str, list[str]]:
    """Read lines of comma-separated settings: a key, and a value for each channel."""
    settings = {}
    for line in lines:
        key, *values = split_cells(line, ",")
        if key:
            settings[key.lower()] = values
    return settings


# One reader for each maker: the file's lines, and the index of the line that gave it
# away.


def _pi_array(place: str, lines: list[str], end: int) -> Dialect | None:
    """Read a GCS array of PI's data recorder: ``SAMPLE_TIME`` in s, ``SEPARATOR`` as a code, names.

    Raises
    ------
    InputError
        The rows have another number of columns than the header states.
    """
    pattern = re.compile(r"\s*#\s*([A-Z_]+\s?\d*)\s*=\s*(.*?)\s*")
    settings = {}
    for line in lines[:end]:
        match = pattern.fullmatch(line[:_LONGEST])
        if match is not None:
            settings[match[1].replace(" ", "")] = match[2]
    if end + 1 >= len(lines) or not {"SAMPLE_TIME", "NDATA", "DIM"} & settings.keys():
        return None
    code = _number(settings.get("SEPARATOR", "9"))
    delimiter = "\t"
    if code is not None and 0 < code < 127:
        delimiter = chr(int(code))
    first_row = lines[end + 1]
    if delimiter not in first_row:
        delimiter = BLANKS
    width = len(list(filter(None, split_cells(first_row.rstrip(), delimiter))))
    stated = _number(settings.get("DIM", ""))
    if stated is not None and int(stated) != width:
        raise InputError(
            f"{place}:{end + 2}: {width} cells where the header states DIM = {int(stated)} columns "
            f"(`skip_lines` {end + 1} and `header_lines` 0 read it without the header)"
        )
    names = [settings.get(f"NAME{number}", "") for number in range(width)]
    clock = _step("SAMPLE_TIME", settings.get("SAMPLE_TIME", ""), " s")
    return _header(lines, end + 1, names, [], width, delimiter, clock=clock)


_LVM_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}


def _lvm(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read LabVIEW's .lvm: separator, decimal sign, and by channel the unit, ``X0`` and ``Delta_X``.

    Raises
    ------
    InputError
        Every channel has its own X column, and whether they are the same is not known.
    """
    ends = []
    for number, line in enumerate(lines):
        if line.startswith(END_OF_HEADER):
            ends.append(number)
    if len(ends) < 2 or ends[1] + 2 >= len(lines):
        return None
    file = _lvm_settings(lines[: ends[0]])
    delimiter = _LVM_SEPARATORS.get(file.get("Separator", "Tab").lower(), "\t")
    rows = [split_cells(line, delimiter) for line in lines[ends[0] + 1 : ends[1] + 3]]
    channels = _lvm_channels(rows[:-2])
    names = rows[-2]
    remarks = names[-1] == "Comment"  # which a row has or leaves out
    while names and names[-1] in ("", "Comment"):
        names.pop()
    x_columns = file.get("X_Columns", "One").lower()
    if x_columns == "multi":
        raise InputError(
            f"{place}: every channel has its own X column (X_Columns Multi): write it with X_Columns One "
            "or No"
        )
    dimensions = filter(None, channels.get("X_Dimension", []))
    timed = all(dimension.lower() == "time" for dimension in dimensions)
    x_unit = "s" if timed else ""
    if x_columns == "no":
        names = ["", *names[1:]]  # the X column is there, but its cells are empty
        x_unit = ""
    units = [x_unit, *channels.get("Y_Unit_Label", [])]
    start = 0.0
    # Where X0 is not relative, it counts from a day in the past.
    if file.get("Time_Pref", "Relative").lower() == "relative":
        starts = filter(None, channels.get("X0", []))
        start = _number(next(starts, "")) or 0.0
    clock: list[Statement] = []
    for value in channels.get("Delta_X", []):
        clock += _step("Delta_X", value)
    decimal = "," if file.get("Decimal_Separator") == "," else "."
    first_row = rows[-1]
    width = len(names)
    if not (remarks and first_row[-1]):
        width = max(width, len(first_row))
    header = _header(
        lines,
        ends[1] + 2,
        names,
        units,
        width,
        delimiter,
        decimal,
        clock=tuple(dict.fromkeys(clock)) if timed else (),
        start=start,
    )
    return replace(header, remarks=remarks)


def _lvm_settings(lines: Sequence[str]) -> dict[str, str]:
    """Read what the file's own header states: a key, the separator, a value."""
    settings = {}
    for line in lines:
        match = re.match(r"(\w+)([\t,;])(.*)", line)
        if match is not None:
            key, mark, value = match.groups()
            value = value.rstrip("\t ").removesuffix(mark) or value.strip("\t ")
            settings[key] = value
    return settings


def _lvm_channels(rows: Sequence[Sequence[str]]) -> dict[str, Sequence[str]]:
    """Read what the segment's header states: a key, and a value for each channel."""
    channels = {}
    for cells in rows:
        if cells[0]:
            channels[cells[0]] = cells[1:]
    return channels


def _labview_waveforms(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read LabVIEW's waveforms in a spreadsheet file: ``t0`` and ``delta t`` by channel, stamps and values.

    Raises
    ------
    InputError
        The waveforms begin at different times, or have different steps.
    """
    rows = [
        [cell for cell in split_cells(line, "\t") if cell] for line in lines[:_NEAR]
    ]
    stated = {cells[0].lower(): cells[1:] for cells in rows if cells}
    at = next(
        (
            n
            for n, cells in enumerate(rows)
            if cells and re.match(r"time|Y(\[|$)", cells[0])
        ),
        None,
    )
    if at is None or at + 1 >= len(rows) or "delta t" not in stated:
        return None
    if len(set(stated["delta t"])) > 1 or len(set(stated.get("t0", []))) > 1:
        raise InputError(
            f"{place}: the waveforms have different t0 or delta t, and rows of different times stand beside "
            "each other: write a file for each, and name the other's column as FILE::COLUMN"
        )
    named = iter(
        [name for name in stated["waveform"] if not re.fullmatch(r"\[\d+\]", name)]
    )
    cells = split_cells(lines[at], "\t")  # the stamps have fewer digits than delta t
    names = [next(named, cell) if cell.startswith("Y[") else "" for cell in cells]
    if not any(names):
        names = ["", *named]
    decimal = "," if _has_decimal_commas(lines[at + 1 : at + 50], "\t") else "."
    clock = _step("delta t", stated["delta t"][0])
    return _header(lines, at + 1, names, [], None, "\t", decimal, clock=clock)


def _yokogawa(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read the DL series' files: names, units, ``HResolution`` and ``HOffset`` by channel above the rows."""
    rows = [(n, split_cells(line, ",")) for n, line in enumerate(lines)]
    begins = (
        n for n, cells in rows if not cells[0] and is_number("".join(cells[1:2]), ".")
    )
    first = next(begins, None)
    settings = _settings(lines[:first])
    if first is None or "hresolution" not in settings:
        return None
    names, units, steps, offsets, x_units = (
        [*settings.get(key, []), ""]
        for key in ("tracename", "vunit", "hresolution", "hoffset", "hunit")
    )
    clock = dict.fromkeys(
        step
        for value in steps
        for step in _step("HResolution", value)
        if x_units[0] == "s"
    )
    start = _number(offsets[0]) or 0.0
    return _header(
        lines, first, ["", *names], ["", *units], clock=tuple(clock), start=start
    )


# counts of 100 ns since 1601 are above, milliseconds since the start of a recording
# below
_FILETIME = 1e16
_TWINCAT_KEYS = frozenset(
    (
        "Name",
        "SymbolName",
        "SymbolComment",
        "Unit",
        "SampleTime[ms]",
        "ScaleFactor",
        "Offset",
        "Data-Type",
    )
)


def _twincat_channels(names: Sequence[str]) -> list[int]:
    """Return the columns of the channels, by the line that names them."""
    keys = [n for n, cell in enumerate(names) if cell == "Name"]
    named = [cell for cell in names if cell]
    if len(keys) > 1 or len(named) == 2:  # each channel behind its own stamps
        return [n + 1 for n in keys]
    # all behind the stamps of the first column
    return [n for n in range(1, len(names)) if names[n]]


def _twincat(place: str, lines: list[str], at: int) -> Dialect | None:
    """Read TwinCAT Scope's text export: a block of keys by channel, then time stamps (ms) and values.

    Raises
    ------
    InputError
        The channels are sampled at different times, so that the rows do not belong
        together.
    """
    delimiter = lines[at][len("SampleTime[ms]")]
    keyed = [
        (number, split_cells(line, delimiter))
        for number, line in enumerate(lines[:_NEAR])
    ]
    keyed = [(number, cells) for number, cells in keyed if cells[0] in _TWINCAT_KEYS]
    # of two lines "Name" the channels', not the project's
    rows = {cells[0]: cells for _, cells in keyed}
    at = keyed[-1][0] + 1
    commas = delimiter != "," and _has_decimal_commas(lines[at : at + 50], delimiter)
    decimal = "," if commas else "."
    first = _number_row(lines, at, delimiter, decimal)
    if "Name" not in rows:
        return None
    names = rows["Name"]
    channels = _twincat_channels(names)
    steps = {
        rows["SampleTime[ms]"][n] for n in channels if n < len(rows["SampleTime[ms]"])
    }
    if len(steps) > 1:
        raise InputError(
            f"{place}: the channels are sampled every {' and '.join(sorted(steps))} ms, and rows of "
            "different times stand beside each other: export channels of one sample time"
        )
    if first is None:
        return None
    cells = split_cells(lines[first], delimiter)
    row_of_units = rows.get("Unit", [])
    labels = [names[n] if n in channels else "" for n in range(len(cells))]
    units = [
        row_of_units[n] if n in channels and n < len(row_of_units) else ""
        for n in range(len(cells))
    ]
    stamp = _number(cells[0])
    if stamp is not None and stamp < _FILETIME:
        labels[0], units[0] = "time", "ms"
    step = _number(steps.pop()) if steps else None
    clock: tuple[Statement, ...] = ()
    if step is not None and step > 0.0:
        clock = (Statement(f"'SampleTime[ms]' {step:g}", 1000.0 / step),)
    notes = _scale_notes(rows, channels)
    return _header(
        lines,
        first,
        labels,
        units,
        None,
        delimiter,
        decimal,
        clock=clock,
        notes=notes,
        end_mark=b"EOF",
    )


def _has_decimal_commas(lines: Sequence[str], delimiter: str) -> bool:
    cells = [cell for line in lines for cell in split_cells(line, delimiter)]
    commas = any("," in cell and is_number(cell, ",") for cell in cells)
    return commas and not any("." in cell and is_number(cell, ".") for cell in cells)


def _scale_notes(rows: dict[str, list[str]], channels: list[int]) -> tuple[str, ...]:
    """Note which channels have a scale that the export may or may not have applied."""
    notes = []
    for key, plain in (("ScaleFactor", 1.0), ("Offset", 0.0)):
        for n in (n for n in channels if n < len(rows.get(key, []))):
            value = _number(rows[key][n])
            if value is not None and value != plain:
                notes.append(
                    f"channel '{rows['Name'][n]}' has {key} {value:g}, and the file does not say whether its "
                    "values are scaled already (Scope: 'Scale values before export')"
                )
    return tuple(notes)


def _tektronix_rows(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read the TDS series' files: settings in two columns, beside the first rows of time and volts."""
    first = split_cells(lines[0], ",")
    if len(first) < 5 or not all(is_number(cell, ".") for cell in first[3:5]):
        return None
    beside = next(
        (n for n, line in enumerate(lines) if not split_cells(line, ",")[0]), len(lines)
    )
    settings = _settings(lines[:beside])
    width = len(first) - (not first[-1])
    keys = ("source", "horizontal units", "vertical units", "sample interval")
    source, horizontal, vertical, interval = (
        [*settings.get(key, []), ""][0] for key in keys
    )
    names, units = ["", "", "", "time"], ["", "", "", horizontal]
    if width == 5:
        names, units = [*names, source], [*units, vertical]
    clock = read_statements("Sample Interval", interval, sure=True)
    return _header(lines, 0, names, units, width, clock=clock)


def _tektronix_table(place: str, lines: list[str], header: int) -> Dialect | None:
    """Read the MSO, DPO and MDO series' files: settings by channel, then ``TIME,CH1,CH2`` and the rows."""
    settings = _settings(lines[:header])
    first = _number_row(lines, header + 1)
    if not {"sample interval", "horizontal units"} & settings.keys() or first is None:
        return None
    names, width = split_cells(lines[header], ","), len(split_cells(lines[first], ","))
    if abs(width - len(names)) > 1:
        return None
    keys = ("horizontal units", "sample interval")
    horizontal, interval = ([*settings.get(key, []), ""][0] for key in keys)
    vertical = settings.get("vertical units", [])
    if len(names) == 2 and len([unit for unit in vertical if unit]) == 1:
        vertical = vertical[:1]
    units = [horizontal or "s", *vertical]  # the maker's unit of time is the second
    clock = read_statements("Sample Interval", interval, sure=True)
    return _header(lines, first, names, units, clock=clock)


def _rigol_ds(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read the DS series' files: ``X,CH1,Start,Increment`` over units, start and step, then the rows."""
    names = [cell.lower() for cell in split_cells(lines[0], ",")]
    if len(lines) < 3 or not {"start", "increment"} <= set(names):
        return None
    second, at, channels = (
        split_cells(lines[1], ","),
        names.index("increment"),
        names.index("start"),
    )
    start = _number(second[channels]) if len(second) > max(at, channels) else None
    counts = {"second": ("time", "s"), "sequence": ("sequence", "")}.get(
        second[0].lower()
    )
    if start is None or counts is None or len(split_cells(lines[2], ",")) < channels:
        return None
    labels = [counts[0], *split_cells(lines[0], ",")[1:channels]]
    units = [counts[1], *second[1:channels]]
    return _header(
        lines, 2, labels, units, clock=_step("Increment", second[at]), start=start
    )


def _rigol_mso(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read the MSO series' files: ``CH1(V),t0 = -1e-3, tInc = 1e-6`` over the rows."""
    match = re.search(
        r"t0\s*=\s*([^,\s]+)\s*,\s*tInc\s*=\s*([^,\s]+)", lines[0][:_LONGEST]
    )
    if match is None or len(lines) < 2:
        return None
    cells = [cell for cell in split_cells(lines[0], ",") if cell]
    cells = [cell for cell in cells if not cell.lower().startswith(("t0", "tinc"))]
    channels = [re.fullmatch(r"(.+?)\(?([mu]?V|A)\)?", cell) for cell in cells]
    names = [
        match[1] if match else cell for match, cell in zip(channels, cells, strict=True)
    ]
    units = [match[2] if match else "" for match in channels]
    return _header(
        lines,
        1,
        names,
        units,
        clock=_step("tInc", match[2]),
        start=_number(match[1]) or 0.0,
    )


def _infiniium(place: str, lines: list[str], _: int) -> Dialect | None:
    """Read Keysight's Infiniium files: ``XInc``, ``XOrg``, ``YUnits`` and more above ``Data``."""
    setting = re.compile(r"([A-Za-z][A-Za-z ]*)[:,\t](.*)")
    settings: dict[str, str] = {}
    first = None
    for index, line in enumerate(lines[:_NEAR]):
        match = setting.match(line[:_LONGEST].strip())
        if line.strip().lower().rstrip(":,") == "data" and "xinc" in settings:
            first = _number_row(lines, index + 1)
            break
        if match is None:
            first = index if _number_row([line], 0) == 0 else None
            break
        settings[match[1].strip().lower()] = match[2].strip(" :,\t")
    if first is None or not {"xinc", "xorg"} <= settings.keys():
        return None
    unit, measured = settings.get("xunits", ""), settings.get("yunits", "")
    width = len(split_cells(lines[first].rstrip(", "), ","))
    names, units = (
        (["time", "signal"], [unit, measured])
        if width == 2
        else (["signal"], [measured])
    )
    if width > 2:
        names, units = (
            ["time", *[f"signal {number}" for number in range(1, width)]],
            [unit],
        )
    clock = read_statements("XInc", settings["xinc"], unit or None, sure=True)
    return _header(
        lines,
        first,
        names,
        units,
        width,
        clock=clock,
        start=_number(settings["xorg"]) or 0.0,
    )


class _Maker(NamedTuple):
    """Where the line stands that gives a maker away (one of the first ``within``), and who reads the rest."""

    mark: re.Pattern[str]
    within: int
    read: Callable[[str, list[str], int], Dialect | None]


_MAKERS = (
    _Maker(re.compile(r"\s*#\s*END_HEADER"), _LOOKED_AT, _pi_array),
    _Maker(re.compile("LabVIEW Measurement"), 1, _lvm),
    _Maker(re.compile(r'"?TraceName'), _NEAR, _yokogawa),
    _Maker(re.compile(r"waveform\t"), 1, _labview_waveforms),
    _Maker(re.compile(r"SampleTime\[ms\][\t,;]"), _NEAR, _twincat),
    _Maker(re.compile("Record Length,"), 1, _tektronix_rows),
    _Maker(re.compile(r"TIME,\s*[A-Z]"), _NEAR, _tektronix_table),
    _Maker(re.compile(r"\s*x\s*,", re.IGNORECASE), 1, _rigol_ds),
    _Maker(re.compile(r".*t0\s*=.*tInc\s*="), 1, _rigol_mso),
    _Maker(re.compile(r"\s*[A-Za-z][A-Za-z ]*[:,\t]"), 1, _infiniium),
)
