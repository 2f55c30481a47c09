"""What a file states beside its rows: settings by key, and the sample rate among them.

One table of keys serves oscilloscopes, LabVIEW, PI and whoever writes ``key: value``.
"""

import math
import re
from collections.abc import Iterator, Sequence

from dbo_cli.errors import InputError
from dbo_cli.logs.cells import is_number, split_cells
from dbo_cli.logs.table import Settings
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
NAME_KEYS = frozenset("tracename name names source channelname label".split())
UNIT_KEYS = frozenset(
    "vunit yunitlabel verticalunits verticalunit unit units yunits yunit".split()
)
TIME_UNIT_KEYS = frozenset("hunit horizontalunits horizontalunit xunits xunit".split())
_IN_TIME_UNIT = ("xinc", "hresolution", "xincrement")
_BARE = {"rate": "rate", "sampling": "rate", "interval": "step"}  # with a unit only
_KINDS = {**dict.fromkeys(_RATES, "rate"), **dict.fromkeys(_STEPS, "step"), **_BARE}
_DIVIDERS = frozenset(
    "decimation decimationfactor downsampling downsamplingfactor downsample".split()
)
_HERTZ = re.compile(
    r"([kKMG]?)(?i:hz|hertz|(s|sa|samples?|scans|frames)/s|samples?/sec(ond)?|sps|fps|1/s|s\^-1|s-1|/s)"
)
_LARGE = {"": 1.0, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}
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
    return _KINDS.get(plain, ""), unit or ""


# --- the rate ---


def stated_rate(
    name: str, settings: Settings, decimal: str = "."
) -> tuple[float | None, float, str]:
    """Return the one sample rate (Hz) that is stated, the time of the first row (s), and what is assumed.

    Parameters
    ----------
    name
        The file, for messages.
    settings
        What the file states, such as ``10 kHz``.
    decimal
        The decimal sign of the rows.

    Raises
    ------
    InputError
        A rate is not clear, or two rates or starts differ.
    """
    rates: dict[str, float] = {}
    starts: dict[str, float] = {}
    start, remark, divider = 0.0, "", ""
    for key, text in _amounts_of(settings):
        match = _AMOUNT.fullmatch(text)
        if match is None:
            continue  # a text under such a name states nothing (ts: a time stamp)
        amount, unit = float(match[1].replace(",", ".")), match[2].strip(' []()"')
        if plain_key(key) in _STARTS and unit in ("", "s"):
            if starts.setdefault(key, amount) != amount:
                raise _unclear(name, f"'{key}' {starts[key]} and {amount}")
            start = amount if abs(amount) < _LATEST_START else start
        if plain_key(key) in _DIVIDERS and amount > 1.0:
            divider = f"'{key}' {text}"
        rate, assumed = _rate(name, key, text, amount, unit, decimal)
        if rate is not None:
            rates[f"'{key}' {text}"] = rate
            remark = assumed or remark
    if rates and max(rates.values()) > (1.0 + _SAME) * min(rates.values()):
        raise _unclear(name, " and ".join(rates))
    if rates and divider:
        raise _unclear(name, f"{divider} beside a rate")
    return next(iter(rates.values()), None), start, remark


def _amounts_of(settings: Settings) -> Iterator[tuple[str, str]]:
    """Return every value with its key and its unit: that in the next cell, or that of all times."""
    unit_of_times = ""
    for key, values in settings.items():
        if plain_key(key) in TIME_UNIT_KEYS:
            unit_of_times = unit_of_times or values[0].strip('" ')
    for key, values in settings.items():
        texts = [value for value in dict.fromkeys(values) if value and value != key]
        unit = unit_of_times if plain_key(key) in _IN_TIME_UNIT else ""
        if len(texts) == 2 and re.fullmatch(r"[^\d=:\[]{1,12}", texts[1]):
            unit = texts.pop()  # 1,kHz
        for text in texts:
            yield key, f"{text} {unit}".strip()


def _unclear(name: str, statement: str) -> InputError:
    return InputError(
        f"{name}: {statement}: the sample rate is not clear: type `sample_rate` HZ, or export each "
        "channel to a file"
    )


def _rate(
    name: str, key: str, text: str, amount: float, unit: str, decimal: str
) -> tuple[float | None, str]:
    """Return the rate (Hz) that a rate or a step makes, and what is assumed; None for no rate.

    Raises
    ------
    InputError
        It may mean several rates.
    """
    kind, unit_in_key = _kind_of(key)
    unit = unit or unit_in_key
    is_bare = plain_key(split_header(key)[0]) in _BARE
    if not kind or (is_bare and not unit):
        return None, ""
    size = _size(kind, unit)
    if size is None or _THOUSANDS[decimal].fullmatch(text):
        raise _unclear(name, f"'{key}' {text}")
    # 0.1 ms is 10,000 Hz exactly
    rate = amount * size if kind == "rate" else size / amount if amount > 0.0 else 0.0
    if not _SLOWEST <= rate < math.inf:
        return None, ""  # what an instrument writes when it does not know
    if unit:
        return rate, ""
    if rate <= _SLOW:
        raise _unclear(name, f"'{key}' {text} without a unit makes {rate:.4g} Hz")
    assumed = "Hz" if kind == "rate" else "s"
    return rate, f"'{key}' {text} has no unit: {assumed} is assumed"


def _size(kind: str, unit: str) -> float | None:
    """Return how many Hz a unit of a rate is, or how many of a unit of a step make a second."""
    plain = unit.replace(" ", "")
    if kind == "rate":
        match = _HERTZ.fullmatch(plain)
        return _LARGE[match[1]] if match else None if plain else 1.0
    plain = re.sub(r"/([sS]ample|S|Sa)$", "", plain)
    spelling = time_unit(plain) if plain else "s"
    return None if spelling is None else float(ratio("s", spelling))


# --- settings ---


def read_settings(lines: Sequence[str], delimiter: str) -> Settings:
    """Read lines of a key and its values, ``Rate: 500 Hz`` and ``VUnit,V,um``; and keys above values."""
    settings: Settings = {}
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
            is_numbered = re.fullmatch(r"name\d+", key.lower())
            if is_numbered:  # NAME0: a line a channel
                key = "names"
            # all that are stated: two rates that differ are refused
            if is_numbered or is_clock_setting(key):
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
