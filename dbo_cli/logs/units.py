"""Units: how they are spelled, what they measure, and how one becomes another.

A unit is carried, never guessed.  SI prefixes of one unit are converted, unlike units
are not: ``unit_factor`` gives the number.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dbo_cli.errors import InputError, UsageError, shortened
from dbo_cli.logs.sample_block import Column, FloatArray

# SI units and prefixes as instruments spell them; below, other spellings that
# lower-case names have in use.
_BASES = {
    "V": "voltage", "A": "current", "m": "length", "N": "force", "Hz": "frequency", "s": "time",
    "rad": "angle", "Pa": "pressure", "T": "induction", "g": "mass", "C": "charge", "W": "power",
    "ohm": "resistance",
}  # fmt: skip
_PREFIXES = {"": 0, "p": -12, "n": -9, "u": -6, "m": -3, "k": 3, "M": 6, "G": 9}
KNOWN_UNITS = frozenset(prefix + unit for prefix in _PREFIXES for unit in _BASES) | {
    "min", "h", "deg", "arcsec", "K", "%", "degC", "counts", "cts", "LSB", "bit", "a.u.", "au", "cm", "dB",
    "samples", "sample", "bar", "mbar", "psi", "A/m", "kA/m", "Oe", "ppm", "Nm", "mNm",
}  # fmt: skip
TIME_WORDS = {
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "msecs", "millisec", "millisecs", "millisecond", "milliseconds"),
    "us": ("usec", "usecs", "microsec", "microsecs", "microsecond", "microseconds"),
    "ns": ("nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
    "ps": ("picoseconds",),
    "min": ("minutes",),
    "h": ("hours",),
}
"""Spellings of units of time that count in any header; ``SPELLINGS`` has more of them."""

_SPELLED = {
    "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV", "micron": "um", "microns": "um",
    "micrometer": "um", "micrometers": "um", "micrometre": "um", "micrometres": "um", "nanometer": "nm",
    "nanometers": "nm", "meter": "m", "meters": "m", "microvolt": "uV", "microvolts": "uV", "kilovolt": "kV",
    "kilovolts": "kV", "nanometre": "nm", "nanometres": "nm", "millimeter": "mm", "millimeters": "mm",
    "millimetre": "mm", "millimetres": "mm", "metre": "m", "metres": "m", "mikrometer": "um",
    "ångström": "angstrom", "å": "angstrom", "ampere": "A", "amperes": "A", "amp": "A", "amps": "A",
    "milliampere": "mA", "newton": "N", "pascal": "Pa", "hertz": "Hz", "radian": "rad", "radians": "rad",
    "degrees": "deg", "degree": "deg", "percent": "%", "в": "V", "мв": "mV", "кв": "kV", "мкм": "um",
    "нм": "nm", "мм": "mm", "微米": "um", "纳米": "nm", "毫米": "mm", "伏": "V",
} | {word: unit for unit, words in TIME_WORDS.items() for word in words}  # fmt: skip

# what it measures, and its size as a fraction in base units
_SIZES: dict[str, tuple[str, int, int]] = {
    prefix + unit: (kind, 10 ** max(power, 0), 10 ** max(-power, 0))
    for prefix, power in _PREFIXES.items()
    for unit, kind in _BASES.items()
} | {
    "cm": ("length", 1, 100),
    "angstrom": ("length", 1, 10**10),
    "min": ("time", 60, 1),
    "h": ("time", 3600, 1),
    "deg": ("angle", *(math.pi / 180.0).as_integer_ratio()),
    "arcsec": ("angle", *(math.pi / 648000.0).as_integer_ratio()),
    "F": ("capacitance", 1, 1),
    "uF": ("capacitance", 1, 10**6),
    "nF": ("capacitance", 1, 10**9),
    "pF": ("capacitance", 1, 10**12),
    "bar": ("pressure", 10**5, 1),
    "mbar": ("pressure", 100, 1),
    "psi": ("pressure", 6_894_757_293_168, 10**9),
    "K": ("temperature", 1, 1),
    "A/m": ("field", 1, 1),
    "kA/m": ("field", 1000, 1),
    "ppm": ("strain", 1, 10**6),
    "mNm": ("torque", 1, 1000),
    "Nm": ("torque", 1, 1),
}
_OTHER_KINDS = {
    "degC": "temperature", "°F": "temperature", "degF": "temperature", "%": "share", "dB": "level",
    "counts": "count", "cts": "count", "LSB": "count", "bit": "count", "a.u.": "count", "au": "count",
    "samples": "number of samples", "sample": "number of samples", "Oe": "field",
}  # fmt: skip


class UnitFactor(NamedTuple):
    """Multiplies (or divides) a signal so that it comes out in another unit.

    The factor is a fraction of whole numbers.  Dividing by 1000 gives the float64
    nearest to the true quotient, multiplying by 0.001 need not: so the inverse of a
    whole number is applied as a division.
    """

    numerator: int = 1
    denominator: int = 1

    @property
    def inverse(self) -> UnitFactor:
        """The way back."""
        return UnitFactor(self.denominator, self.numerator)

    def times(self, numerator: int, denominator: int) -> UnitFactor:
        """Return this factor times a fraction, in lowest terms."""
        above, below = self.numerator * numerator, self.denominator * denominator
        common = math.gcd(above, below)
        return UnitFactor(above // common, below // common)

    def apply(self, values: FloatArray) -> FloatArray:
        """Return the signal in the other unit; the same array where nothing changes."""
        if self.numerator == self.denominator:
            return values
        if abs(self.numerator) == 1:
            return values / float(self.denominator * self.numerator)
        return values * float(self)

    def __float__(self) -> float:
        """Return the factor as a number."""
        return self.numerator / self.denominator


ONE = UnitFactor()


_MICRO = re.compile(r"[µμ](?=[^\W\d])")  # before a unit, nowhere else


def normalise_unit(text: str) -> str | None:
    """Spell a unit plainly: ``µm`` and ``microns`` are ``um``, ``Volts`` is ``V``; None for an empty one."""
    plain = (
        text.strip().strip("[](){}<>").strip().replace("°C", "degC").replace("Ω", "ohm")
    )
    plain = _MICRO.sub("u", plain)
    return _SPELLED.get(plain.lower(), plain) or None


def is_known_unit(text: str) -> bool:
    """Return whether a header suffix is a unit and not a part of the name."""
    return normalise_unit(text) in KNOWN_UNITS


def kind_of_unit(unit: str | None) -> str | None:
    """Return what a unit measures (``voltage``, ``length``, …), or None where that is not known."""
    if unit is None:
        return None
    size = _SIZES.get(unit)
    return size[0] if size else _OTHER_KINDS.get(unit)


DRIVING_KINDS = frozenset(
    ("pressure", "current", "force", "field", "temperature", "charge", "power")
)
"""What drives actuators besides a voltage."""
MOVED_KINDS = frozenset(("strain", "force", "torque", "induction"))
"""What actuators give besides a displacement, which may be a length or an angle."""


def quantity_name(role: str, unit: str | None) -> str:
    """Return what a signal is called: by what its unit measures, else by its role.

    Parameters
    ----------
    role
        ``voltage`` or ``displacement``.
    unit
        A drive in N is a force, an output in ppm a strain; in V, um, deg, % and units
        that are not known the role says it.
    """
    kinds = {"voltage": DRIVING_KINDS, "displacement": MOVED_KINDS}.get(
        role, frozenset()
    )
    kind = kind_of_unit(unit)
    return kind if kind in kinds else role


def drive_unit(figure: float | str) -> str:
    """Return the unit of a drive that goes up to a figure: bar for ``4bar``; V for volts and numbers."""
    match = _FIGURE.fullmatch(figure) if isinstance(figure, str) else None
    unit, _ = _unit_and_time(match)
    if unit is not None and kind_of_unit(unit) in DRIVING_KINDS:
        return unit
    return "V"


def without_prefix(unit: str | None) -> str | None:
    """Return a unit without its SI prefix (``V`` for ``kV``), or None where it has none."""
    if unit is None or unit in _BASES or unit not in _SIZES:
        return None
    base = unit[1:]
    return base if base in _SIZES and unit[0] in _PREFIXES else None


def require_unit(
    name: str, figure: float | str | None, unit: str | None, per: str | None = None
) -> None:
    """Refuse a plain number where the unit that it would be read in has a prefix, as kV has.

    Parameters
    ----------
    name
        The parameter, for messages.
    given
        A figure; 0 means the same in all units, and a text with a unit of its own is
        taken.
    unit, per
        What it would be read in, and the unit of time of a speed.

    Raises
    ------
    UsageError
        100 may mean 100 V where the drive is in kV.
    """
    plain = without_prefix(unit)
    value = _plain_number(figure)
    if plain is None or value is None or value == 0.0 or not math.isfinite(value):
        return
    factor = unit_factor(plain, unit)
    assert factor is not None
    behind = f"/{per}" if per else ""
    smaller = float(factor.apply(np.array(value)))
    raise UsageError(
        f"`{name}` {value:.9g}: the drive is in {unit}, and a plain number may be meant in {plain} (`{name}` "
        f"{smaller:.9g}{unit}{behind} or `{name}` {value:.9g}{unit}{behind})"
    )


def _plain_number(figure: float | str | None) -> float | None:
    """Return a figure that has no unit of its own as a number; None for any other."""
    if not isinstance(figure, str):
        return figure
    try:
        return float(figure)
    except ValueError:
        return None


def unit_factor(unit: str | None, wanted: str | None) -> UnitFactor | None:
    """Return by what figures in ``unit`` are multiplied to be in ``wanted``; None for unlike units.

    Where either is None nothing is known, and the factor is one.
    """
    if unit == wanted or unit is None or wanted is None:
        return ONE
    size, wanted_size = _SIZES.get(unit), _SIZES.get(wanted)
    if size is None or wanted_size is None or size[0] != wanted_size[0]:
        return None
    return UnitFactor(size[1], size[2]).times(wanted_size[2], wanted_size[1])


@dataclass(frozen=True)
class Scale:
    """A factor that the user gives for one role: ``voltage=20``, ``displacement=10um/V``.

    ``factor`` multiplies; with units, figures in ``unit_in`` become figures in
    ``unit_out``.
    """

    role: str
    factor: UnitFactor
    unit_out: str | None = None
    unit_in: str | None = None

    def __str__(self) -> str:
        """Spell it as it is given."""
        units = f"{self.unit_out}/{self.unit_in}" if self.unit_out else ""
        return f"{self.role}={float(self.factor):.15g}{units}"

    def applied_to(self, place: str, column: Column) -> tuple[UnitFactor, Column]:
        """Return the whole factor, and the column as it is afterwards.

        Raises
        ------
        InputError
            The column's unit is another than the one that the factor takes.
        """
        if self.unit_out is None:
            return self.factor, column
        before = unit_factor(column.unit, self.unit_in)
        if before is None:
            stated = f"column '{column.name}' is in {column.unit}"
            raise InputError(
                f"{place}: {stated}, but `scale` {self} takes {self.unit_in}"
            )
        return self.factor.times(before.numerator, before.denominator), replace(
            column, unit=self.unit_out
        )


_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_SCALE = re.compile(
    rf"\s*(?P<role>[^=\s]+)\s*=\s*(?P<factor>{_NUMBER})"
    r"\s*(?:(?P<out>[^\s/\d.][^\s/]*)\s*/\s*(?P<in>[^\s/]+))?\s*"
)
_FIGURE = re.compile(
    rf"\s*(?P<number>{_NUMBER})\s*(?P<unit>[^\s\d./][^\s\d/]*)?(?:/(?P<per>[^\s\d/]+(?:/[^\s\d/]+)?))?\s*"
)
# of ten; float64 ends at 308, and a conversion of units besides takes up to 42 of them
_LARGEST_POWER = 250


def parse_factor(text: str) -> UnitFactor | None:
    """Read a decimal number as an exact fraction; None where it is beyond the range of float64."""
    from decimal import Decimal

    try:
        number = Decimal(text)
    except ArithmeticError:  # an exponent that no machine counts
        return None
    return (
        UnitFactor(*number.as_integer_ratio())
        if abs(number.adjusted()) <= _LARGEST_POWER
        else None
    )


def in_unit(
    name: str, figure: float | str, unit: str | None, per: str | None = None
) -> float:
    """Return a figure in ``unit``: a number is in it already, a text such as ``1.2kV`` is converted.

    With ``per``, a unit of time, it is a speed: ``2V/ms``. ``name`` is the parameter,
    for messages.

    Raises
    ------
    UsageError
        It is no finite number, or its unit cannot be converted.
    """
    if not isinstance(figure, str):
        return figure
    match = _FIGURE.fullmatch(figure)
    own_unit, per_time = _unit_and_time(match)
    value = float(match["number"]) if match else math.nan
    if match is None or not math.isfinite(value) or (own_unit is None and per_time):
        example = f"5{unit or 'V'}{f'/{per}' if per else ''}"
        raise UsageError(
            f"`{name}` {shortened(figure)}: give a number, or one with its unit such as {example}"
        )
    if own_unit is None:
        return value
    above = (
        unit_factor(own_unit, unit)
        if unit is not None and kind_of_unit(own_unit) is not None
        else None
    )
    below = unit_factor(per_time, per)
    if above is None or below is None or bool(per_time) != bool(per):
        wanted = f"in {unit}{f'/{per}' if per else ''}" if unit else "without a unit"
        raise UsageError(
            f"`{name}` {figure}: cannot be converted; a figure {wanted} is needed"
        )
    return float(above.times(below.denominator, below.numerator).apply(np.array(value)))


def _unit_and_time(figure: re.Match[str] | None) -> tuple[str | None, str | None]:
    """Return the unit of a figure, and the unit of time behind its stroke: ``kA/m/s`` has both."""
    if figure is None or figure["unit"] is None:
        return None, None if figure is None else figure["per"]
    unit, behind = figure["unit"], figure["per"] or ""
    whole, _, time = behind.partition("/")
    if whole and is_known_unit(f"{unit}/{whole}"):
        unit, behind = f"{unit}/{whole}", time
    return normalise_unit(unit), normalise_unit(behind)


def parse_scale(text: str) -> Scale:
    """Read ``ROLE=FACTOR[UNIT/UNIT]``.

    Raises
    ------
    UsageError
        It is not of that form, or the factor is zero or no float64.
    """
    match, called = _SCALE.fullmatch(text), f"`scale` {shortened(text)}"
    if match is None:
        raise UsageError(
            f"{called}: give ROLE=FACTOR or ROLE=FACTORUNIT/UNIT, such as voltage=20 or displacement=10um/V"
        )
    if not re.search("[1-9]", re.split("[eE]", match["factor"])[0]):
        raise UsageError(f"{called}: a factor of 0 leaves nothing of the signal")
    factor = parse_factor(match["factor"])
    if factor is None:
        raise UsageError(f"{called}: the factor is too large or too small")
    units = normalise_unit(match["out"] or ""), normalise_unit(match["in"] or "")
    return Scale(match["role"].lower(), factor, *units)


# --- units of time ---

FACTORS = {
    "s": ONE, "ms": UnitFactor(1, 10**3), "us": UnitFactor(1, 10**6), "ns": UnitFactor(1, 10**9),
    "ps": UnitFactor(1, 10**12), "min": UnitFactor(60), "h": UnitFactor(3600), "d": UnitFactor(86400),
}  # fmt: skip
"""Every unit of time, in seconds."""
HHMMSS = "hhmmss"
"""How figures such as 120059.500 are called: hours, minutes and seconds in one number."""

_MORE_WORDS = {
    "s": ("s", "sek", "sekunde", "sekunden", "seconde", "secondes", "segundo", "segundos", "secondo",
          "secondi", "с", "сек", "秒"),
    "ms": ("ms", "milli", "millis", "millisekunde", "millisekunden", "millisecondes", "milisegundos",
           "millisecondi", "мс", "毫秒", "ミリ秒"),
    "us": ("us", "micros", "mikrosekunde", "mikrosekunden", "microsecondes", "mus", "mcs", "мкс", "微秒"),
    "ns": ("ns", "nanos", "nanosekunden", "нс"),
    "ps": ("ps", "psec", "psecs", "picosecond"),
    "min": ("min", "mins", "minute", "minuten", "minutos", "minuti", "мин"),
    "h": ("h", "hr", "hrs", "hour", "stunde", "stunden", "std", "heure", "heures", "horas", "ore"),
    "d": ("d", "day", "days", "tag", "tage", "jour", "jours", "dias", "giorni"),
}  # fmt: skip
SPELLINGS = {
    unit: (*TIME_WORDS.get(unit, ()), *words) for unit, words in _MORE_WORDS.items()
}
"""Every known spelling of a unit of time; capitals do not matter (mS in a time column is no conductance)."""

UNIT_OF = {
    spelling: unit for unit, spellings in SPELLINGS.items() for spelling in spellings
}
_COUNT = re.compile(r"(?P<number>\d+(?:\.\d+)?)\s*(?P<unit>[^\d\s.].*)")


def time_unit(text: str) -> str | None:
    """Return how a unit of time is spelled here (``s``, ``ms``, …), or None where it is not known."""
    plain = (
        text.strip()
        .strip("[](){}<>")
        .strip()
        .rstrip(".")
        .replace("µ", "u")
        .replace("μ", "u")
    )
    return UNIT_OF.get(
        plain.lower().replace("milli ", "milli").replace("micro ", "micro")
    )


def parse_time_unit(text: str) -> tuple[str, UnitFactor]:
    """Read what ``time_unit`` may be: a unit of time, or a number of them (``10us``).

    Raises
    ------
    UsageError
        It is none.
    """
    if text.strip().lower().startswith(HHMMSS):
        return HHMMSS, ONE
    match = _COUNT.fullmatch(text.strip())
    unit = time_unit(match["unit"] if match else text)
    count = parse_factor(match["number"]) if match else ONE
    if unit is None or count is None or not count.numerator:
        names = ", ".join(FACTORS).replace(", d", " or d")
        raise UsageError(
            f"`time_unit` {shortened(text)}: give {names}, or a number of them such as 10us"
        )
    return text.strip() if match else unit, count.times(*FACTORS[unit])
