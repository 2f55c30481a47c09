"""Parsers of option values, and their error messages.

A parser takes the parameter's name and the text; its complaint names the parameter in
backticks, which the shell shows as the option.
"""

from __future__ import annotations

import glob
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import UsageError
from dbo_cli.logs.plain_text import pattern

if TYPE_CHECKING:
    from dbo_cli.logs.request import Address

Parser = Callable[[str, str], Any]


def number(option: str, text: str) -> float:
    """Return a finite number; raise ``UsageError`` for anything else."""
    try:
        value = float(text) if len(text) < 400 else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"`{option}`: not a number: '{shown(text)}'")
    return value


def text(option: str, word: str) -> str:
    """Return the text itself."""
    return word


def positive(option: str, text: str) -> float:
    """Return a number above zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value <= 0.0:
        raise UsageError(f"`{option}`: must be above 0, not {text}")
    return value


_WITH_UNIT = pattern(r"(.*[\d.])\s*[^\W\d][^\d]*")


def with_unit(parse: Parser) -> Parser:
    """Return a parser of figures that may have a unit (``1.2kV``): a text then, to be converted."""

    def parse_figure(option: str, text: str) -> float | str:
        match = _WITH_UNIT.fullmatch(text.strip())
        value: float = parse(option, match[1] if match else text)
        return text if match else value

    return parse_figure


def not_negative(option: str, text: str) -> float:
    """Return a number of at least zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value < 0.0:
        raise UsageError(f"`{option}`: must not be below 0, not {text}")
    return value


def percentage(option: str, text: str) -> float:
    """Return a share in %, from a plain number, one with ``%`` or one in ``ppm``."""
    plain = text.strip()
    if plain.endswith("ppm"):
        return 1e-4 * not_negative(option, plain.removesuffix("ppm").strip())
    return not_negative(option, plain.removesuffix("%").strip())


def whole(least: int) -> Parser:
    """Return a parser of whole numbers of at least ``least``."""

    def parse(option: str, text: str) -> int:
        try:
            value = int(text) if len(text) < 400 else None
        except ValueError:
            value = None
        if value is None:
            raise UsageError(f"`{option}`: not a whole number: '{shown(text)}'")
        if value < least:
            raise UsageError(f"`{option}`: must be at least {least}, not {value}")
        return value

    return parse


@dataclass(frozen=True)
class choice:
    """A parser of texts that are one of ``choices``, which a shell offers."""

    choices: Sequence[str]

    def __call__(self, option: str, text: str) -> str:
        """Return the text; raise ``UsageError`` for any other."""
        if text not in self.choices:
            # an argument has no name to be found by
            place = f"`{option}`: " if option else ""
            raise UsageError(
                f"{place}'{shown(text)}' is none of {', '.join(self.choices)}"
            )
        return text


def auto_or(parse: Parser) -> Parser:
    """Return a parser that gives None for ``auto``, else what ``parse`` makes of the text."""
    return lambda option, text: None if text == "auto" else parse(option, text)


def times(option: str, text: str) -> tuple[float, ...]:
    """Return time constants in seconds, given as ``T1,T2,…``; ``0`` means none."""
    values = tuple(
        not_negative(option, in_seconds(option, part)) for part in text.split(",")
    )
    if values == (0.0,):
        return ()
    if 0.0 in values or len(set(values)) < len(values):
        raise UsageError(
            f"`{option}`: time constants must differ and be above 0: '{shown(text)}'"
        )
    return tuple(sorted(values))


def span(option: str, text: str) -> tuple[float, float]:
    """Return two numbers, ``LOW:HIGH``, the lower one first."""
    low, colon, high = text.partition(":")
    if not colon:
        raise UsageError(f"`{option}` {shown(text)}: give LOW:HIGH")
    ends = number(option, low), number(option, high)
    if not ends[0] < ends[1]:
        raise UsageError(f"`{option}` {shown(text)}: {low} is not below {high}")
    return ends


def address(option: str, text: str) -> Address:
    """Return a file, a group of an HDF5 file or a standard stream, taken apart once and for all."""
    from dbo_cli.logs.request import parse_address

    return parse_address(text)


def expanded(words: Sequence[str]) -> list[str]:
    """Return files with patterns (``run*.csv``) expanded, in order, where the shell did not.

    PowerShell never does. What is a file's own name, or fits no file, stays as it is.
    """
    found: list[str] = []
    for word in words:
        path, separator, inner = word.partition("::")
        if os.path.exists(path) or not any(sign in path for sign in "*?["):
            found.append(word)
            continue
        files = sorted(glob.glob(path))
        found.extend(f"{file}{separator}{inner}" for file in files)
        if not files:
            found.append(word)
    return found


def rows(option: str, text: str) -> tuple[int, int | None]:
    """Return the first and the last data row of ``A:B``."""
    from dbo_cli.logs.request import parse_rows

    return parse_rows(text)


def seconds_or_auto(option: str, text: str) -> float | str:
    """Return seconds above 0, or ``auto``."""
    return text if text == "auto" else positive(option, in_seconds(option, text))


def offset(option: str, text: str) -> float | str:
    """Return seconds of either sign, or ``auto``."""
    return text if text == "auto" else number(option, in_seconds(option, text))


_FIGURE_AND_UNIT = pattern(
    r"\s*([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^\W\d][^\d]*|/s)\s*"
)


def in_seconds(option: str, text: str) -> str:
    """Return a time with a unit (``2.4ms``) as a figure in seconds; a figure alone as it is.

    Raises
    ------
    UsageError
        The unit is none of time.
    """
    match = _FIGURE_AND_UNIT.fullmatch(text)
    if match is None:
        return text
    from dbo_cli.logs.units import FACTORS, time_unit

    unit = time_unit(match[2].strip())
    if unit is None:
        raise UsageError(
            f"`{option}` {shown(text)}: '{match[2]}' is no unit of time (s, ms, us, ns, min, h, d)"
        )
    factor = FACTORS[unit]
    return repr(number(option, match[1]) * factor.numerator / factor.denominator)


def in_hertz(option: str, text: str) -> str:
    """Return a rate with a unit (``5kHz``) as a figure in hertz; a figure alone as it is.

    Raises
    ------
    UsageError
        The unit is none of a rate.
    """
    match = _FIGURE_AND_UNIT.fullmatch(text)
    if match is None:
        return text
    from dbo_cli.logs.clock import hertz

    factor = hertz(match[2])
    if factor is None:
        raise UsageError(
            f"`{option}` {shown(text)}: '{match[2]}' is no unit of a rate (Hz, kHz, MHz, S/s)"
        )
    return repr(number(option, match[1]) * factor)


def of_unit(parse: Parser, in_unit: Callable[[str, str], str]) -> Parser:
    """Return a parser of figures that may have a unit, which is converted."""
    return lambda option, text: parse(option, in_unit(option, text))


def names(option: str, text: str) -> tuple[str, ...]:
    """Return names that commas divide."""
    words = tuple(name.strip() for name in text.split(","))
    if not all(words):
        raise UsageError(
            f"`{option}` {shown(text)}: give names with commas between them"
        )
    return words


def header_lines(option: str, text: str) -> int:
    """Return a number of header lines: 0, 1 or 2."""
    return int(choice(("0", "1", "2"))(option, text))


def zero(option: str, text: str) -> str | float:
    """Return what displacement counts as zero: a rule's name or a value."""
    rules = ("none", "mean", "first")
    if text in rules:
        return text
    try:
        return number(option, text)
    except UsageError:
        raise UsageError(
            f"`{option}`: '{shown(text)}' is none of {', '.join(rules)} and not a number"
        ) from None


def number_or_word(kind: Callable[[str], float]) -> Parser:
    """Return a parser that leaves a text that is no number as it is; the record that takes it refuses it."""

    def parse(option: str, text: str) -> float | str:
        try:
            value = kind(text) if len(text) < 400 else math.inf
        except ValueError:
            value = math.inf
        return value if math.isfinite(value) else shown(text)

    return parse


def shown(text: str) -> str:
    """Return a value as a message repeats it: whole, or its beginning where it is long."""
    return text if len(text) <= 60 else text[:57] + "..."


figure, figure_above_0, limit = (
    with_unit(number),
    with_unit(positive),
    with_unit(not_negative),
)
PARSERS: dict[str, Parser] = {
    "A:B": rows, "AMPERE": figure_above_0, "DRIVE": address, "FACTOR": number, "FARAD": figure_above_0,
    "FILE": address, "HZ": of_unit(positive, in_hertz), "LOG": address, "LOW:HIGH": span,
    "M|auto|0": auto_or(whole(0)),
    "N": whole(1), "N|auto": auto_or(whole(1)), "NAME,...": names, "PERCENT": not_negative,
    "PERCENT|PPM": percentage,
    "SECONDS": of_unit(not_negative, in_seconds), "SECONDS|auto": seconds_or_auto,
    "SECONDS|auto|0": auto_or(of_unit(not_negative, in_seconds)),
    "TRAJECTORY": address, "VALUE": not_negative, "VOLT": figure, "VOLT/S": figure_above_0,
    "0|1|2": header_lines, "auto|0|1|2": auto_or(whole(0)), "auto|0|T1,T2,...": auto_or(times),
    "auto|growing|falling|free": auto_or(choice(("auto", "growing", "falling", "free"))),
    "cycles|SECONDS": number_or_word(float), "none|mean|first|VALUE": zero,
}  # fmt: skip
"""How the text of an option is read, by what its value is called."""
