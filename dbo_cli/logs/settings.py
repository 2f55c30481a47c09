"""What a file states beside its rows: settings by key, and the sample rate among them.

One table of keys serves oscilloscopes, LabVIEW, PI and whoever writes ``key: value``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from dbo_cli.errors import InputError
from dbo_cli.logs.cells import is_number, split_cells, to_number
from dbo_cli.logs.table import Statement
from dbo_cli.units import ratio, split_header, time_unit

# keys without blanks and signs, in lower case
_RATES = frozenset(
    "samplerate samplingrate samplingfrequency samplefrequency samplingfreq samplefreq acqrate fs srate "
    "sfreq acquisitionrate acquisitionfrequency abtastrate abtastfrequenz messfrequenz messrate "
    "framerate framespersecond samplespersecond bildrate".split()
)
_STEPS = frozenset(
    "wfincrement sampleperiod samplingperiod sampleinterval samplinginterval sampletime timestep dt ts "
    "deltat deltax timeincrement tinterval xincrement xinc tinc increment abtastintervall abtastzeit "
    "abtastperiode timeinterval timeresolution hresolution".split()
)
_STARTS = frozenset(
    "x0 hoffset xorg t0 start xorigin tstart wfstartoffset wfstarttime".split()
)
NAME_KEYS = frozenset("tracename name source channelname label".split())
UNIT_KEYS = frozenset(
    "vunit yunitlabel verticalunits verticalunit unit units yunits yunit".split()
)
TIME_UNIT_KEYS = frozenset("hunit horizontalunits horizontalunit xunits xunit".split())
_IN_TIME_UNIT = ("xinc", "hresolution", "xincrement")
_BARE = {"rate": "rate", "sampling": "rate", "interval": "step"}  # with a unit only
_DIVIDERS = frozenset(
    "decimation decimationfactor downsampling downsamplingfactor downsample".split()
)
_HERTZ = frozenset(
    "hz hertz s/s sa/s sps samples/s sample/s samples/sec samples/second scans/s 1/s s^-1 s-1 /s fps "
    "frames/s".split()
)
_ASSUMED = {"rate": "Hz", "step": "s"}
_LARGE = {"k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
# rates that differ by less were rounded when the file was written (0.000333333 s, 3000 Hz)
_SAME = 1e-6
_SLOWEST = 1e-12  # Hz; times at a rate below may not be finite
_SLOW = 1.0  # Hz; whoever logs a hysteresis loop so slowly states the unit
_LATEST_START = 1e6  # s; a start beyond counts from a date in the past
_LOOKED_AT = 200  # lines in which settings are looked for
_LONGEST = 300  # characters of a line that holds one

_KEYED = re.compile(
    r"[\s#%!;/*\"]*([^\W\d_][^:=,;\t]{0,60}?)[\s\"]*([:=,;\t])[:=,;\t]*(.*)"
)
_AMOUNT = re.compile(r"([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\d,;]*)")
_THOUSANDS = {
    ".": re.compile(r"[1-9]\d{0,2},\d{3}\D*"),
    ",": re.compile(r"[1-9]\d{0,2}[.,]\d{3}\D*"),
}


def plain_key(key: str) -> str:
    """Return a key without blanks, signs and capitals: ``Sample Interval`` is ``sampleinterval``."""
    return re.sub(r"[\s_\-.]+", "", key).lower()


def is_clock_setting(key: str) -> bool:
    """Return whether a key states a rate, a step or the time of the first row."""
    return _kind_of(key)[0] != "" or plain_key(key) in _STARTS


def is_channel_key(key: str) -> bool:
    """Return whether a line with this key has the names or the units of the channels."""
    return plain_key(key) in NAME_KEYS | UNIT_KEYS | TIME_UNIT_KEYS


def is_setting(key: str) -> bool:
    """Return whether a line that begins with a key is a setting and no row."""
    return is_channel_key(key) or is_clock_setting(key)


def _kind_of(key: str) -> tuple[str, str]:
    """Return ``rate``, ``step`` or nothing for a key, and the unit that it carries."""
    name, unit = split_header(key)
    plain = plain_key(name)
    if plain.endswith("hz") and plain.removesuffix("hz") in _RATES:
        return "rate", unit or "Hz"
    if plain in _RATES:
        return "rate", unit or ""
    if plain in _STEPS:
        return "step", unit or ""
    return _BARE.get(plain, ""), unit or ""


# --- the rate ---


def stated_rate(
    name: str, statements: Sequence[Statement], decimal: str = "."
) -> tuple[float | None, float, str]:
    """Return the one sample rate (Hz) that is stated, the time of the first row (s), and what is assumed.

    Parameters
    ----------
    name
        The file, for messages.
    statements
        Key, value (a number or a text such as ``10 kHz``), and a unit given beside it
        (or an empty text).
    decimal
        The decimal sign of the rows.

    Raises
    ------
    InputError
        A rate is not clear, or two rates or starts differ.
    """
    rates: dict[str, float] = {}
    remark = ""
    for key, value, unit_beside in statements:
        text = f"{value} {unit_beside}".strip()
        kind, unit = _kind_of(key)
        match = _AMOUNT.fullmatch(text)
        if not kind or match is None:
            continue  # a text under such a name is no statement (ts: a time stamp)
        unit = match[2].strip(' []()"') or unit
        if plain_key(split_header(key)[0]) in _BARE and not unit:
            continue
        statement = f"'{key}' {text}"
        rate = _rate(kind, float(match[1].replace(",", ".")), unit)
        if rate is None or _THOUSANDS[decimal].fullmatch(text):
            raise _unclear(name, statement)
        if not _SLOWEST <= rate < math.inf:
            continue  # what an instrument writes when it does not know
        if not unit and rate <= _SLOW:
            raise _unclear(name, f"{statement} without a unit makes {rate:.4g} Hz")
        if not unit:
            remark = f"{statement} has no unit: {_ASSUMED[kind]} is assumed"
        rates[statement] = rate
    start, divider = _stated_start(name, statements)
    if rates and max(rates.values()) > (1.0 + _SAME) * min(rates.values()):
        raise _unclear(name, " and ".join(rates))
    if rates and divider:
        raise _unclear(name, f"'{divider}' beside a rate")
    return next(iter(rates.values()), None), start, remark


def _stated_start(name: str, statements: Sequence[Statement]) -> tuple[float, str]:
    """Return the time of the first row (s), and the key by which a rate is divided (InputError)."""
    starts: dict[str, float] = {}
    start, divider = 0.0, ""
    for key, value, _ in statements:
        number = to_number(str(value).replace(",", "."), ".")
        if plain_key(key) in _STARTS and not math.isnan(number):
            if starts.setdefault(key, number) != number:
                raise _unclear(name, f"'{key}' {number:.9g} and {starts[key]:.9g}")
            start = number if abs(number) < _LATEST_START else start
        if plain_key(key) in _DIVIDERS and number > 1.0:
            divider = key
    return start, divider


def _unclear(name: str, statement: str) -> InputError:
    return InputError(
        f"{name}: {statement}: the sample rate is not clear: type `sample_rate` HZ, or export each "
        "channel to a file"
    )


def _rate(kind: str, amount: float, unit: str) -> float | None:
    """Return a rate (Hz) by an amount of a rate or a step; None for an unknown unit, 0 for no rate."""
    plain = unit.replace(" ", "")
    if kind == "rate":
        if not plain or plain.lower() in _HERTZ:
            return amount
        if plain[0] in _LARGE and plain[1:].lower() in _HERTZ:
            return amount * _LARGE[plain[0]]
        return None
    for suffix in ("/sample", "/Sample", "/S", "/Sa"):
        plain = plain.removesuffix(suffix)
    spelling = time_unit(plain) if plain else "s"
    if spelling is None:
        return None
    # 0.1 ms is 10,000 Hz exactly
    return float(ratio("s", spelling)) / amount if amount > 0.0 else 0.0


# --- settings ---


def read_settings(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """Read lines of a key and its values, ``Rate: 500 Hz`` and ``VUnit,V,um``; and keys above values."""
    settings: dict[str, list[str]] = {}
    before: list[str] = []
    for line in lines[:_LOOKED_AT]:
        if len(line) > _LONGEST:
            continue
        cells = split_cells(line, delimiter)
        for n, key in enumerate(before[: len(cells)]):
            if is_clock_setting(key) and is_number(cells[n], "."):
                settings.setdefault(key, [cells[n]])  # Increment above its value
        for cell in cells[1:]:
            match = _KEYED.fullmatch(cell)
            if match and match[2] == "=":
                settings.setdefault(match[1].strip(), [match[3].strip()])
        match = _KEYED.fullmatch(line)
        is_scan = match and plain_key(match[1]) == "increment"  # of what it steps
        if match and match[3].strip() and not is_scan:
            key, values = match[1].strip(), _values(match[3], match[2], delimiter)
            if is_clock_setting(key):  # two that differ are refused
                values = settings.pop(key, []) + values
            settings.setdefault(key, values)
        before = cells
    return settings


def _values(text: str, mark: str, delimiter: str) -> list[str]:
    """Split the values of a setting; behind ``:`` and ``=`` a decimal comma separates nothing."""
    if mark in ":=":
        mark = delimiter if delimiter in text and delimiter != " " else ";"
        if mark == "," and re.fullmatch(r"\s*\d+,\d+\s*[^\d,]*", text):
            return [text.strip()]
    return [cell.strip() for cell in split_cells(text, mark)]


def statements_of(settings: dict[str, list[str]]) -> list[Statement]:
    """Return what settings state, with the unit that stands beside a value or is stated for all times."""
    time_units = []
    for key, values in settings.items():
        if plain_key(key) in TIME_UNIT_KEYS:
            time_units.append(values[0].strip('" '))
    statements: list[Statement] = []
    for key, values in settings.items():
        nonempty = [value for value in dict.fromkeys(values) if value and value != key]
        unit = time_units[0] if time_units and plain_key(key) in _IN_TIME_UNIT else ""
        if len(nonempty) == 2 and re.fullmatch(r"[^\d=:\[]{1,12}", nonempty[1]):
            unit = nonempty.pop()  # 1,kHz
        statements += [(key, value, unit) for value in nonempty]
    return statements
