"""Units: how they are spelled, what they measure, and how one becomes another.

A unit is carried, never guessed. SI prefixes of one unit are converted, unlike units
are not. Units are shown in ASCII (``um``).
"""

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

from dbo_cli.errors import InputError, UsageError

Typed = float | str
"""What a user types: a number, a text with a unit (``"1.2kV"``, ``"2V/ms"``), or ``auto``."""


@dataclass(frozen=True)
class Unit:
    """A known unit: its ASCII text, what it measures, and its size in the base unit."""

    text: str
    kind: str
    size: Fraction


# what instruments write, and what it measures; each with the SI prefixes
_BASES = {
    "V": "voltage", "A": "current", "m": "length", "N": "force", "Hz": "frequency", "s": "time",
    "rad": "angle", "Pa": "pressure", "T": "induction", "g": "mass", "C": "charge", "W": "power",
    "ohm": "resistance", "F": "capacitance", "Nm": "torque", "A/m": "field",
}  # fmt: skip
_PREFIXES = {"": 0, "p": -12, "n": -9, "u": -6, "m": -3, "k": 3, "M": 6, "G": 9}
# units without prefixes by what they measure, and their size in the base unit
_UNPREFIXED: dict[str, dict[str, float | Fraction]] = {
    "length": {"cm": Fraction(1, 100), "angstrom": Fraction(1, 10**10)},
    "time": {"min": 60, "h": 3600, "d": 86400},
    "angle": {"deg": math.pi / 180.0, "arcsec": math.pi / 648000.0},
    "pressure": {"bar": 10**5, "mbar": 100, "psi": Fraction("6894.757293168")},
    "temperature": {"K": 1},
    "temperature in degC": {"degC": 1},
    "temperature in degF": {"degF": 1},
    "field in Oe": {"Oe": 1},
    "share": {"%": 1},
    "strain": {"ppm": Fraction(1, 10**6)},
    "level": {"dB": 1},
    "count": {"counts": 1},
    "number of samples": {"samples": 1},
}
_BASE_OF = {kind: base for base, kind in _BASES.items()}
_SPELLINGS = {
    "V": "volt volts vdc vac в 伏", "mV": "millivolt millivolts мв", "uV": "microvolt microvolts",
    "kV": "kilovolt kilovolts кв", "m": "meter meters metre metres",
    "um": "um micron microns micrometer micrometers micrometre micrometres mikrometer мкм 微米",
    "nm": "nanometer nanometers nanometre nanometres нм 纳米",
    "mm": "millimeter millimeters millimetre millimetres мм 毫米", "angstrom": "ångström å",
    "A": "ampere amperes amp amps", "mA": "milliampere", "N": "newton", "Pa": "pascal", "Hz": "hertz",
    "rad": "radian radians", "deg": "degree degrees °", "%": "percent",
    "counts": "count cts lsb bit a.u. au", "samples": "sample",
    "s": "sec secs second seconds", "ms": "msec msecs millisec millisecs millisecond milliseconds",
    "us": "usec usecs microsec microsecs microsecond microseconds",
    "ns": "nsec nsecs nanosec nanosecs nanosecond nanoseconds", "ps": "picosecond picoseconds",
    "min": "minutes", "h": "hours",
}  # fmt: skip
# spellings that count for a time column only, where capitals do not matter either
_TIME_SPELLINGS = {
    "s": "s sek sekunde sekunden seconde secondes segundo segundos secondo secondi с сек 秒",
    "ms": "ms milli millis millisekunde millisekunden millisecondes milisegundos millisecondi мс 毫秒 ミリ秒",
    "us": "us micros mikrosekunde mikrosekunden microsecondes mus mcs мкс 微秒",
    "ns": "ns nanos nanosekunden нс", "ps": "ps psec psecs",
    "min": "min mins minute minuten minutos minuti мин",
    "h": "h hr hrs hour stunde stunden std heure heures horas ore",
    "d": "d day days tag tage jour jours dias giorni",
}  # fmt: skip
# what drives actuators besides a voltage, and what they give besides a displacement
DRIVING_KINDS = frozenset(
    ("pressure", "current", "force", "field", "temperature", "charge", "power")
)
MOVED_KINDS = frozenset(("strain", "force", "torque", "induction"))
_VALUE_KINDS = DRIVING_KINDS | MOVED_KINDS | {"voltage", "length", "angle"}


_UNITS: dict[str, Unit] = {}
for _kind, _sizes in _UNPREFIXED.items():
    for _text, _size in _sizes.items():
        _UNITS[_text] = Unit(_text, _kind, Fraction(_size))
for _base, _kind in _BASES.items():
    for _prefix, _power in _PREFIXES.items():
        _text = _prefix + _base
        _UNITS[_text] = Unit(_text, _kind, Fraction(10) ** _power)
_WORDS = {word: unit for unit, text in _SPELLINGS.items() for word in text.split()}
_TIME_WORDS = {w: unit for unit, text in _TIME_SPELLINGS.items() for w in text.split()}

_MICRO = re.compile(r"[µμ](?=[^\W\d])")  # before a unit, nowhere else
_BRACKETED = re.compile(r"(?P<name>.*?)\s*[\[(<{](?P<unit>[^\[\](){}<>]*)[\])>}]")
# voltage_V, Weg/nm, CH1 in V, "Drive voltage, V", field_kA/m
_SEPARATOR = re.compile(r"[\s_,/]+(?:in\s+)?")
# "milli volts" is "millivolts"
_PREFIX_WORD = re.compile(r"(milli|micro|nano|pico|kilo)[\s_-]+(?=\w)", re.IGNORECASE)
# data[2], x(1), Voltage (CH1), Position (raw): no units
_REMARK = re.compile(
    r"[-+]?\d+([.:,]\s*\d+)*|ch(an(nel)?)?[ _]?\w|:|raw|measured|actual|filtered|calibrated|corrected|"
    r"desired|target|setpoint|command(ed)?|sensor|feedback|monitor|smoothed|mean|avg|average|drive|piezo|pzt|stage"
)
_NODE = re.compile(r"[A-SU-Za-su-z]\([^()]*\)")  # V(drive), as simulators write it
_LETTERED = frozenset("channel ch chan kanal canal canale voie input probe".split())
"""Words in front of a letter that is no unit: Channel A counts no amperes."""
_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_QUANTITY = re.compile(
    rf"\s*(?P<number>{_NUMBER})\s*(?P<unit>[^\s\d./][^\s\d]*)?\s*", re.ASCII
)


def spell(text: str | None) -> str | None:
    """Spell a unit plainly: ``µm`` and ``microns`` are ``um``; None for an empty text."""
    plain = (text or "").strip().strip("[](){}<>").strip()
    plain = plain.replace("°C", "degC").replace("°F", "degF").replace("Ω", "ohm")
    plain = _MICRO.sub("u", plain)
    return _WORDS.get(plain.lower(), plain) or None


def parse_unit(text: str | None) -> Unit | None:
    """Read a unit in any known spelling; None where it is not known."""
    return _UNITS.get(spell(text) or "")


def kind_of(text: str | None) -> str | None:
    """Return what a unit measures (``voltage``, ``length``), or None where that is not known."""
    unit = parse_unit(text)
    return None if unit is None else unit.kind


def ratio(from_text: str | None, to_text: str | None) -> Fraction:
    """Return by what figures are multiplied to be in another unit, as an exact fraction.

    Raises
    ------
    InputError
        The units measure different things, or one of two unlike units is not known.
    """
    start, end = spell(from_text), spell(to_text)
    if start == end or start is None or end is None:
        return Fraction(1)
    before, after = parse_unit(start), parse_unit(end)
    if before is None or after is None or before.kind != after.kind:
        raise InputError(f"{start} cannot be converted to {end}")
    return before.size / after.size


def unit_of_array(
    label: str, stated: str | None, given: str | None, model_unit: str | None
) -> str | None:
    """Return the unit that numbers are in: that given, else that stated or the model's.

    Parameters
    ----------
    label
        What the numbers are, for messages.
    stated
        The unit that they state of themselves, None for none. It never converts: pandas
        keeps ``attrs`` through arithmetic.
    given
        The unit that the user gives, None for none.
    model_unit
        The unit of the model, None where it states none.

    Raises
    ------
    InputError
        They state another unit than the model's.
    UsageError
        The unit that is given cannot be converted.
    """
    if given is not None and model_unit is None:
        raise UsageError(f"`unit` {given}: the model states no unit: leave it out")
    if given is not None:
        is_same = spell(given) == spell(model_unit)
        kind = kind_of(given)
        if not is_same and (kind is None or kind != kind_of(model_unit)):
            raise UsageError(
                f"`unit` {given}: not convertible to {model_unit}, the unit of the model"
            )
        return given
    if stated is None or model_unit is None or spell(stated) == spell(model_unit):
        return stated or model_unit
    numbers = f"`.to_numpy()` for numbers in {model_unit}"
    if kind_of(stated) != kind_of(model_unit):
        numbers = f"give another signal, or {numbers}"
    else:
        numbers = f'pass `unit="{stated}"`, or {numbers}'
    raise InputError(f"{label} is in {stated}, the model in {model_unit}: {numbers}")


def multiplied(values: Any, factor: Fraction) -> Any:
    """Multiply numbers or arrays; by 1/1000 as a division, which is exact to the last digit."""
    if factor == 1:
        return values
    if factor.numerator == 1:
        return values / float(factor.denominator)
    return values * float(factor)


@lru_cache(maxsize=1024)
def time_unit(text: str | None) -> str | None:
    """Return a unit of time (``s``, ``ms``, ``us``, ...) in plain spelling; None for any other.

    Capitals do not matter: ``mS`` in a time column is no conductance.
    """
    plain = (text or "").strip().strip("[](){}<>").strip().rstrip(".")
    plain = plain.replace("µ", "u").replace("μ", "u").lower()
    plain = _PREFIX_WORD.sub(r"\1", plain)
    unit = _TIME_WORDS.get(plain) or _WORDS.get(plain)
    return unit if kind_of(unit) == "time" else None


def is_unit(text: str | None) -> bool:
    """Return whether a text is a known unit, of time in any capitals."""
    return parse_unit(text) is not None or time_unit(text) is not None


@lru_cache(maxsize=1024)  # arrays in memory ask for the same few names at each call
def split_header(text: str) -> tuple[str, str | None]:
    """Split a header at its unit: ``voltage_V``, ``Weg/nm``, ``time (ms)``, ``CH1 in V``.

    A suffix counts as a unit only where it is a known one; what stands in brackets
    counts unless it is an index or a word such as ``raw``. Where the name ends in no
    known unit, the one that stands in it counts: ``Voltage [mV] (CH1)``.
    """
    plain = _PREFIX_WORD.sub(r"\1", " ".join(text.split()))
    name, unit = _split_at_end(plain)
    if unit and (is_unit(unit) or "/" in unit):
        return name, unit
    inside = units_in(plain)
    return (plain, inside.pop()) if len(inside) == 1 else (name, unit)


def units_in(name: str) -> set[str]:
    """Return the known units that stand in a name, in brackets or else between its words."""
    inner = re.findall(r"[\[(<{]([^\[\](){}<>]*)[\])>}]", name)
    units = {spell(text) for text in inner if len(text) > 1 or text == "V"}
    units = {unit for unit in units if parse_unit(unit)}
    if not units:
        words = re.split(r"[\s_.:;,'-]+", _MICRO.sub("u", name))
        units = {word for word in words if len(word) > 1 and word in _UNITS}
        units = {word for word in units if kind_of(word) in _VALUE_KINDS}
    return {unit for unit in units if unit}


def value_units_like(text: str) -> list[str]:
    """Return the known units of drives and displacements that differ from a text in capitals alone."""
    alike = [unit for unit in _UNITS if unit.lower() == text.lower()]
    return sorted(unit for unit in alike if kind_of(unit) in _VALUE_KINDS)


def _split_at_end(plain: str) -> tuple[str, str | None]:
    """Split a header at the unit at its end."""
    is_torn = any(plain.count(a) != plain.count(b) for a, b in ("()", "[]", "{}"))
    match = _BRACKETED.fullmatch(plain)
    if match and match["name"] and not is_torn:
        inner = match["unit"].strip()
        is_node = _NODE.fullmatch(plain) and parse_unit(inner) is None
        if is_node or _REMARK.fullmatch(inner.lower()):
            return plain, None
        return match["name"].strip().rstrip("_,"), spell(inner)
    for mark in _SEPARATOR.finditer(plain):
        name, unit = plain[: mark.start()], plain[mark.end() :]
        *before, word = re.split(r"[\s_,/]+", name)
        word = re.split("[:.;-]", word)[-1]
        is_ratio = before and mark[0] == "/" and (is_unit(word) or word.isdigit())
        is_bare = unit.strip("[](){}<>") == unit and not is_ratio
        if name and name.lower() not in _LETTERED and is_bare and parse_unit(unit):
            return name.strip(), spell(unit)
    return plain, None


def parse_quantity(
    text: Typed, unit: str | None, name: str = "value", largest: float = math.inf
) -> float:
    """Return a typed figure in ``unit``: a number is in it already, ``"1.2kV"`` is converted.

    Parameters
    ----------
    text
        A number, or a text with or without a unit.
    unit
        What the result is in; with a stroke and a unit of time it is a speed
        (``V/s``: ``"2V/ms"`` gives 2000). None: nothing states a unit.
    name
        The parameter, for messages.
    largest
        A plain number beyond it was meant in another unit, where ``unit`` has a prefix.

    Raises
    ------
    UsageError
        It is no finite number; or its unit cannot be converted, or is missing.
    """
    value, figure_unit = split_quantity(text, name)
    if figure_unit is None:
        _require_plain(value, unit, f"`{name}` {text}", largest)
        return value
    if unit is None:
        raise UsageError(
            f"`{name}` {text}: the log or model states no unit: type a plain number"
        )
    try:
        return float(multiplied(value, _ratio_of_speeds(figure_unit, unit)))
    except InputError:
        raise UsageError(
            f"`{name}` {text}: not convertible; give a number in {unit}"
        ) from None


def quantity(
    name: str, value: Any, unit: str | None, *words: str, largest: float = math.inf
) -> Any:
    """Return a typed figure in ``unit`` (``parse_quantity``); None, and some words, as they are."""
    if value is None or (isinstance(value, str) and value in words):
        return value
    try:
        return parse_quantity(value, unit, name, largest)
    except UsageError as problem:
        raise UsageError(" or ".join([str(problem), *words])) from None


def split_quantity(text: Typed, name: str = "value") -> tuple[float, str | None]:
    """Return the number of a typed figure and the unit behind it, None for a plain number.

    Raises
    ------
    UsageError
        It is no finite number; True and False are none.
    """
    number, unit = text, None
    if isinstance(text, str):
        match = _QUANTITY.fullmatch(text)
        number, unit = (match["number"], match["unit"]) if match else ("nan", None)
    is_number = not type(text).__name__.startswith("bool")  # numpy's is no bool
    try:
        value = float(number) if is_number else math.nan
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(
            f"`{name}` {text}: give a finite number, alone or with its unit"
        )
    return value, unit


def _require_plain(value: float, unit: str | None, label: str, largest: float) -> None:
    """Refuse (UsageError) a plain number beyond ``largest`` in a unit with a prefix."""
    above, time = (None, None) if unit is None else _without_time(unit)
    parsed = parse_unit(above)
    if parsed is None or abs(value) <= largest:
        return
    base = _BASE_OF.get(parsed.kind, parsed.text)
    if base == parsed.text or not parsed.text.endswith(base):  # bar
        return
    per = f"/{time}" if time else ""
    raise UsageError(
        f"{label}: the drive is in {above}: type the unit, {value:.9g}{base}{per} or "
        f"{value:.9g}{unit}"
    )


def _ratio_of_speeds(from_unit: str, to_unit: str) -> Fraction:
    """Return the ratio of two units, each with or without a unit of time behind a stroke."""
    above, time = _without_time(from_unit)
    to_above, to_time = _without_time(to_unit)
    if (time is None) != (to_time is None):
        return ratio(from_unit, to_unit)  # which refuses them
    return ratio(above, to_above) / ratio(time, to_time)


def _without_time(unit: str) -> tuple[str, str | None]:
    if parse_unit(unit):
        return unit, None
    above, stroke, below = unit.rpartition("/")
    if stroke and kind_of(below) == "time":
        return above, below
    return unit, None


def quantity_name(role: str, unit: str | None) -> str:
    """Return what a signal is called: by what its unit measures, else by its role.

    A voltage in N is a force and a displacement in ppm a strain; in V, um, deg, % and
    unknown units the role says it.
    """
    kinds = {"voltage": DRIVING_KINDS, "displacement": MOVED_KINDS}
    kind = kind_of(unit)
    if kind is not None and kind in kinds.get(role, ()):
        return kind
    return role


def drive_unit(figure: str | float) -> str:
    """Return the unit of a drive that goes up to a figure: bar for ``4bar``; V for volts and numbers."""
    unit = spell(split_quantity(figure, "v_max")[1])
    if kind_of(unit) in DRIVING_KINDS:
        return unit or "V"
    return "V"
