"""What stands above the rows of a log: names, units, and a maker's statements of the sample rate.

One table of keys serves oscilloscopes, LabVIEW, PI and whoever writes ``key: value``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from dbo_cli.errors import InputError
from dbo_cli.logs.cells import is_number, split_cells
from dbo_cli.units import conversion, parse_unit, split_header, time_unit

# keys without blanks and signs, in lower case
RATES = frozenset(
    "samplerate samplingrate samplingfrequency samplefrequency samplingfreq samplefreq acquisitionrate "
    "acquisitionfrequency acqrate fs srate sfreq scanrate abtastrate abtastfrequenz messfrequenz messrate "
    "framerate framespersecond samplespersecond bildrate".split()
)
STEPS = frozenset(
    "wfincrement sampleperiod samplingperiod sampleinterval samplinginterval sampletime timestep timeincrement "
    "dt deltat deltax ts tinterval xincrement xinc tinc increment abtastintervall abtastzeit abtastperiode "
    "timeinterval timeresolution hresolution".split()
)
_BARE = {"rate": "rate", "sampling": "rate", "interval": "step"}  # with a unit only
_STARTS = frozenset("x0 hoffset xorg t0 start xorigin".split())
_NAME_KEYS = frozenset("tracename name source channelname channels label".split())
_UNIT_KEYS = frozenset(
    "vunit yunitlabel verticalunits verticalunit unit units yunits yunit".split()
)
_TIME_UNIT_KEYS = frozenset("hunit horizontalunits horizontalunit xunits xunit".split())
_HERTZ = frozenset(
    "hz hertz s/s sa/s sps samples/s sample/s samples/sec samples/second scans/s 1/s s^-1 s-1 /s fps "
    "frames/s".split()
)
_LARGE = {"": 1.0, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
# rates that differ by less were rounded when the file was written (0.000333333 s, 3000 Hz)
_SAME = 1e-6
# s; a start beyond counts from a date in the past
_LATEST_START = 1e6
_LOOKED_AT = 200  # lines in which statements are looked for
_LONGEST = 300  # characters of a line that states something

_KEYED = re.compile(r"[\s#%!;/*\"]*([^\W\d_][^:=,;\t]{0,60}?)[\s\"]*[:=,;\t]+(.*)")
_AMOUNT = re.compile(r"([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\d,;]*)")
_LABEL = re.compile(
    r"(?:column[ _]?(?:names|headers)?|columns|names|fields|header|(?P<unit>units?))\s*[:=]\s*",
    re.IGNORECASE,
)


@dataclass
class Header:
    """What stands above the rows: a name and a unit for each column, and the statements.

    ``rate_problem`` says why a stated rate cannot be used where one is needed.
    """

    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    rate: float | None = None
    rate_problem: str = ""
    start: float = 0.0
    remarks: list[str] = field(default_factory=list)


def plain_key(key: str) -> str:
    """Return a key without blanks, signs and capitals: ``Sample Interval`` is ``sampleinterval``."""
    return re.sub(r"[\s_\-.]+", "", key).lower()


def is_clock_key(key: str) -> bool:
    """Return whether a key, with or without a unit, states a rate or a step."""
    return _kind_of(key)[0] != ""


def _kind_of(key: str) -> tuple[str, str, str]:
    """Return ``rate``, ``step`` or nothing for a key; its plain spelling, and its unit."""
    name, unit = split_header(key)
    plain = plain_key(name)
    if plain.endswith("hz") and plain.removesuffix("hz") in RATES:
        return "rate", plain.removesuffix("hz"), unit or "Hz"
    if plain in RATES:
        return "rate", plain, unit or ""
    if plain in STEPS:
        return "step", plain, unit or ""
    return _BARE.get(plain, ""), plain, unit or ""


def stated_rate(
    statements: Iterable[tuple[str, object, str]], remarks: list[str]
) -> float | None:
    """Return the one sample rate (Hz) that statements give; None where none does.

    Parameters
    ----------
    statements
        Key, value (a number or a text such as ``10 kHz``), and a unit given beside it
        (or an empty text).
    remarks
        Receives what is assumed.

    Raises
    ------
    InputError
        Two statements differ, or one cannot be read. The message has no file in front.
    """
    rates: dict[str, float] = {}
    assumed = ""
    for key, value, beside in statements:
        kind, plain, in_key = _kind_of(key)
        text = str(value).strip()
        if not kind:
            continue
        match = _AMOUNT.fullmatch(text)
        if match is None:
            continue  # a text under such a name is no statement (ts: a time stamp)
        if re.fullmatch(r"[1-9]\d{0,2},\d{3}\D*", text):
            raise InputError(
                f"'{key}' {text} may be {text.split(',')[0]} or {text.replace(',', '')} "
                "(`sample_rate` HZ gives the rate)"
            )
        amount = float(match[1].replace(",", "."))
        unit = (beside or match[2] or in_key).strip(' []()"')
        if plain in _BARE and not unit:
            continue
        if not amount > 0.0 or not math.isfinite(amount):
            continue  # what an instrument writes when it does not know
        size = _hertz(unit) if kind == "rate" else _seconds(unit)
        if size is None:
            raise InputError(
                f"'{key}' {text} is not in a unit of a {kind} (`sample_rate` HZ gives the rate)"
            )
        shown = f"'{key}' {text}" if not beside else f"'{key}' {text} {beside}"
        rates[shown] = amount * size if kind == "rate" else 1.0 / (amount * size)
        if kind == "step" and size < 1.0:  # 0.1 ms is 10,000 Hz exactly
            rates[shown] = round(1.0 / size) / amount
        if not unit:
            assumed = (
                f"{shown} has no unit: {'Hz' if kind == 'rate' else 's'} is assumed"
            )
    if not rates:
        return None
    if max(rates.values()) > (1.0 + _SAME) * min(rates.values()):
        listed = " and ".join(rates)
        raise InputError(
            f"two sample rates are stated, {listed} (`sample_rate` HZ decides)"
        )
    if assumed:
        remarks.append(assumed)
    return next(iter(rates.values()))


def _hertz(unit: str) -> float | None:
    """Return how many hertz a unit of a rate is; 1 for none."""
    plain = unit.replace(" ", "")
    if not plain or plain.lower() in _HERTZ:
        return 1.0
    if plain[0] in _LARGE and plain[1:].lower() in _HERTZ:
        return _LARGE[plain[0]]
    return None


def _seconds(unit: str) -> float | None:
    """Return how many seconds a unit of a step is; 1 for none."""
    plain = unit.replace(" ", "")
    for suffix in ("/sample", "/Sample", "/S", "/Sa"):
        plain = plain.removesuffix(suffix)
    if not plain:
        return 1.0
    known = time_unit(plain)
    return None if known is None else conversion(known, "s")


def find_header(
    name: str,
    lines: Sequence[str],
    skipped: int,
    first: int,
    delimiter: str,
    numeric: frozenset[int],
    width: int,
) -> Header:
    """Read names, units and statements of the lines above the rows.

    Parameters
    ----------
    name
        The file, for messages.
    lines
        The first lines of the file.
    skipped, first
        The lines between these indices are the header.
    delimiter, numeric, width
        How the rows are written.

    Raises
    ------
    InputError
        The line of names has another number of cells than the rows.
    """
    header = Header([""] * width, [""] * width)
    settings = _settings(lines[skipped : min(len(lines), first + 60)], delimiter)
    _read_clock(header, settings)
    above = list(lines[skipped:first])
    below = split_cells(lines[first], delimiter)
    found = _header_lines(above, delimiter, numeric, width, below)
    units = next((k for k, cells in enumerate(found) if _are_units(cells)), None)
    if units is not None:
        header.units = found[units]
        if units + 1 < len(found):
            header.names = found[units + 1]
        elif units > 0:
            header.names = found[0]
        else:
            header.names = found[units]  # units in the place of names
    elif found:
        header.names = found[0]
    else:
        _refuse_other_width(name, above, delimiter, width, first)
    _fill_from_settings(header, settings, numeric, bool(found))
    return header


def _header_lines(
    above: Sequence[str],
    delimiter: str,
    numeric: frozenset[int],
    width: int,
    below: Sequence[str],
) -> list[list[str]]:
    """Return the lines right above the rows that have a cell for each column, the nearest first."""
    found: list[list[str]] = []
    for line in reversed(above[-_LOOKED_AT:]):
        plain = line.strip()
        if not plain.strip("#%,;\t| "):
            if found and not plain.strip("#%"):
                break  # what stands above a blank line is no header
            continue
        cells = _as_header(plain, delimiter, numeric, width, below)
        if cells is None:
            if found:
                break
            if plain[0] in "#%":
                continue
            return []
        found.append(cells)
        if len(found) == 3:
            break
    return found


def _as_header(
    line: str, delimiter: str, numeric: frozenset[int], width: int, below: Sequence[str]
) -> list[str] | None:
    """Split a line above the rows into as many cells as they have; None where that cannot be done."""
    is_comment = line[0] in "#%"
    if is_comment:
        line = line.lstrip("#% \t")
        if re.match(r"[\w .]+=", line) and not _LABEL.match(line):
            return None  # a setting
    label = _LABEL.match(line)
    if label:
        line = line[label.end() :]
    ways = [split_cells(line, delimiter)]
    if is_comment or delimiter == " ":  # a comment may be separated otherwise
        ways += [split_cells(line, mark) for mark in "\t;," if mark in line]
        ways.append([cell.strip() for cell in re.split(r"\s{2,}|\t", line)])
        ways.append(re.findall(r"[^\s(\[]+(?:\s*[(\[][^)\]]*[)\]])?", line))
        if is_comment:
            ways.append(line.split())
    for cells in ways:
        cells = [cell.strip("'") for cell in cells]
        while len(cells) > width and cells[-1].lower() in ("", "comment"):
            cells.pop()
        if len(cells) == width - 1 and width > 1:
            if not below[-1]:
                cells = [*cells, ""]  # the rows end in a delimiter
            elif below[0] in ("1", "0") and len(cells) > 1:
                cells = ["", *cells]  # the rows are numbered by a column without a name
        words = [cell for cell in cells if cell and not is_number(cell, ".")]
        if len(cells) == width and words and not _is_row(cells, numeric):
            return cells
    return None


def _is_row(cells: Sequence[str], numeric: frozenset[int]) -> bool:
    """Return whether most of the columns of numbers have one."""
    numbers = [n for n in numeric if is_number(cells[n], ".")]
    return 2 * len(numbers) > max(2, len(numeric))


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether every filled cell is a known unit (``a.u.`` and a label in front aside)."""
    filled = [cell for cell in cells if cell.strip("()[]- ")]
    if filled and re.fullmatch(r"units?:?", filled[0].lower()):
        filled = filled[1:]
    plain = [cell for cell in filled if cell.lower() != "sequence"]
    return bool(plain) and all(parse_unit(c) or time_unit(c) for c in plain)


def _refuse_other_width(
    name: str, above: Sequence[str], delimiter: str, width: int, first: int
) -> None:
    """Refuse a last line above the rows that names another number of columns than they have."""
    number = len(above)
    while number and not above[number - 1].strip():
        number -= 1
    if not number or above[number - 1].strip()[0] in "#%":
        return
    cells = split_cells(above[number - 1], delimiter)
    while cells and not cells[-1]:
        cells.pop()
    if len(cells) > 1 and delimiter != " " and not _KEYED.fullmatch(above[number - 1]):
        pass
    if len(cells) > 1 and not any(is_number(cell, ".") for cell in cells):
        raise InputError(
            f"{name}:{first + 1}: {width} cells where line {number} has {len(cells)} (`delimiter`, `decimal`, or "
            f"`skip_lines` {first} to go by column numbers)"
        )


def _settings(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """Read lines of a key and its values, ``Rate: 500 Hz`` and ``VUnit,V,um``; and keys above values."""
    settings: dict[str, list[str]] = {}
    before: list[str] = []
    for line in lines[:_LOOKED_AT]:
        if len(line) > _LONGEST:
            continue
        cells = split_cells(line, delimiter)
        for n, key in enumerate(before[: len(cells)]):
            if _is_setting(key) and is_number(cells[n], "."):
                settings.setdefault(key, [cells[n]])  # Increment above its value
        for cell in cells[1:]:
            match = _KEYED.fullmatch(cell)
            if match and "=" in cell:
                settings.setdefault(match[1].strip(), [match[2].strip()])
        match = _KEYED.fullmatch(line)
        if match and match[2].strip():
            settings.setdefault(match[1].strip(), _values(match[2], delimiter))
        before = cells
    return settings


def _is_setting(key: str) -> bool:
    return plain_key(key) in STEPS | _STARTS


def _values(text: str, delimiter: str) -> list[str]:
    """Split the values of a setting; a decimal comma separates nothing."""
    mark = delimiter if delimiter in text and delimiter != " " else "\t"
    if mark == "," and re.fullmatch(r"\s*\d+,\d+\s*[^\d,]*", text):
        return [text.strip()]
    return [cell.strip() for cell in split_cells(text, mark)]


def _read_clock(header: Header, settings: dict[str, list[str]]) -> None:
    """Take the rate and the time of the first row from the settings."""
    units = [_first(v) for k, v in settings.items() if plain_key(k) in _TIME_UNIT_KEYS]
    statements = []
    for key, values in settings.items():
        if not is_clock_key(key):
            continue
        filled = list(dict.fromkeys(value for value in values if value))
        beside = ""
        if plain_key(key) in ("xinc", "hresolution", "xincrement") and units:
            beside = units[0]
        if len(filled) > 1 and not is_number(filled[1].replace(",", "."), "."):
            beside, filled = filled[1], filled[:1]  # 1,kHz
        statements += [(key, value, beside) for value in filled]
    try:
        header.rate = stated_rate(statements, header.remarks)
    except InputError as problem:
        header.rate_problem = str(problem)
    for key, values in settings.items():
        if plain_key(key) in _STARTS and is_number(
            _first(values).replace(",", "."), "."
        ):
            start = float(_first(values).replace(",", "."))
            if abs(start) < _LATEST_START:
                header.start = start


def _first(values: Sequence[str]) -> str:
    return values[0].strip('" ') if values else ""


def _fill_from_settings(
    header: Header, settings: dict[str, list[str]], numeric: frozenset[int], named: bool
) -> None:
    """Take names and units that are stated by channel where no line above the rows has them."""
    places = sorted(numeric)
    names: list[str] = []
    units: list[str] = []
    time = ""
    for key, values in settings.items():
        plain = plain_key(key)
        filled = [value.strip('"') for value in values if value]
        if re.fullmatch(r"name\d+", plain):
            names.append(filled[0])
        elif plain in _NAME_KEYS:
            names = filled
        elif plain in _UNIT_KEYS:
            units = filled
        elif plain in _TIME_UNIT_KEYS:
            time = filled[0]
    if not named:
        _give(header.names, names, places)
    if not any(header.units) and not any(
        split_header(name)[1] for name in header.names
    ):
        _give(header.units, units, places)
        if units and len(units) == len(places) - 1 and time_unit(time):
            header.units[places[0]] = time


def _give(cells: list[str], stated: Sequence[str], places: Sequence[int]) -> None:
    """Give what is stated by channel to the columns of numbers; the first may be the time."""
    if stated and len(stated) in (len(places), len(places) - 1):
        for place, text in zip(places[-len(stated) :], stated, strict=True):
            cells[place] = text
