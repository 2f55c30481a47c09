"""Which column is meant: names, units and guesses.

A header such as ``voltage_V``, ``displacement (um)`` or ``Position [µm]`` names a quantity and a unit.  Units
are carried, never guessed: a suffix after an underscore counts as a unit only when it is a known one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.sample_block import ColumnInfo

TIME_GUESSES = ("time", "t", "x_value", "zeit")  # x_value: what LabVIEW writes

_PREFIXED = ("V", "A", "m", "N", "Hz", "s", "rad", "Pa", "T", "g", "C", "W", "ohm")
_PREFIXES = ("", "p", "n", "u", "m", "k", "M", "G")
KNOWN_UNITS = frozenset(prefix + unit for prefix in _PREFIXES for unit in _PREFIXED) | {
    "min", "h", "deg", "arcsec", "K", "%", "degC", "counts", "cts", "LSB", "bit", "a.u.", "au", "cm", "dB",
    "samples", "sample",
}  # fmt: skip
_SPELLED = {
    "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV", "sec": "s", "secs": "s", "second": "s",
    "seconds": "s", "msec": "ms", "milliseconds": "ms", "microseconds": "us", "usec": "us", "micron": "um",
    "microns": "um", "micrometer": "um", "micrometers": "um", "micrometre": "um", "micrometres": "um",
    "nanometer": "nm", "nanometers": "nm", "meter": "m", "meters": "m", "minutes": "min", "hours": "h",
}  # fmt: skip
_BRACKETED = re.compile(r"^(?P<quantity>.*?)\s*[\[(<{](?P<unit>[^\[\](){}<>]*)[\])>}]\s*$", re.DOTALL)
_SLASHED = re.compile(r"^(?P<quantity>.*?)\s*(?:/|\bin\b|,)\s*(?P<unit>\S{1,30})$", re.DOTALL)
_SUFFIXED = re.compile(r"^(?P<quantity>.+)[_ ](?P<unit>[^_ ]+)$", re.DOTALL)

_LETTERED = ("", "channel", "ch", "chan", "input", "probe")  # "Channel A" is not in amperes

SECONDS_PER_UNIT = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class ColumnWish:
    """A column that a command wants.

    ``selector`` is what the user gave (a header name, a dataset path, a number counted from 1) or None; then
    ``guesses`` are tried, quantity names in lower case.  ``option`` is the parameter named in the remedy.
    """

    selector: str | None
    guesses: tuple[str, ...] = ()
    required: bool = True
    option: str = "column"


def normalise_unit(text: str) -> str | None:
    """Spell a unit plainly: ``µm`` and ``microns`` are ``um``, ``Volts`` is ``V``; None for an empty one."""
    plain = text.strip().strip("[](){}<>").strip().replace("µ", "u").replace("μ", "u").replace("°C", "degC")
    plain = plain.replace("Ω", "ohm")
    return _SPELLED.get(plain.lower(), plain) or None


def is_known_unit(text: str) -> bool:
    """Tell whether a header suffix is a unit and not a part of the name."""
    unit = normalise_unit(text)
    return unit in KNOWN_UNITS


def split_header(header: str) -> tuple[str, str | None]:
    """Split a header cell into its quantity and its normalised unit (or None)."""
    text = " ".join(header.split())
    found = _BRACKETED.match(text)
    if found and found["quantity"]:
        return found["quantity"].strip().rstrip("_,"), normalise_unit(found["unit"])
    for pattern in (_SLASHED, _SUFFIXED):
        found = pattern.match(text)
        if found and is_known_unit(found["unit"]) and found["quantity"].lower() not in _LETTERED:
            return found["quantity"].strip(), normalise_unit(found["unit"])
    return text, None


def column_info(header: str | None, number: int, unit: str | None = None) -> ColumnInfo:
    """Describe column ``number`` (from 1) by its header cell; a unit given apart (units line) goes first."""
    if not header:
        return ColumnInfo(str(number), normalise_unit(unit or ""), "", number)
    quantity, own = split_header(header)
    return ColumnInfo(header, normalise_unit(unit or "") or own, quantity, number)


def column_label(column: ColumnInfo) -> str:
    """Name a column in a message: ``column 'voltage_V'``, or ``column 2`` where the log has no header."""
    return f"column '{column.name}'" if column.quantity else f"column {column.number}"


def list_columns(columns: Sequence[ColumnInfo]) -> str:
    """List the columns of a log for an error message, shortened when there are many."""
    if not any(column.quantity for column in columns):
        return f"it has {len(columns)} column{'s' if len(columns) != 1 else ''} without names"
    shown = [
        f"{column.number} {column.name}" if column.quantity else str(column.number) for column in columns[:20]
    ]
    more = f", … ({len(columns)} in all)" if len(columns) > 20 else ""
    return f"it has {', '.join(shown)}{more}"


def find_column(place: str, columns: Sequence[ColumnInfo], selector: str, option: str) -> ColumnInfo:
    """Find the column that the user named.

    Raises
    ------
    InputError
        The name is absent or occurs more than once, or the number is past the end.
    UsageError
        The number is 0 or negative.
    """
    if re.fullmatch(r"[+-]?\d+", selector):
        number = int(selector)
        if number < 1:
            raise UsageError(f"`{option}` {selector}: columns are counted from 1")
        if number > len(columns):
            plural = "s" if len(columns) != 1 else ""
            raise InputError(f"{place}: there is no column {number}: it has {len(columns)} column{plural}")
        return columns[number - 1]
    wanted = " ".join(selector.split())
    for same in (_same_name, _same_name_but_case, _same_quantity):
        found = [column for column in columns if same(column, wanted)]
        if len(found) == 1:
            return found[0]
        if found:
            numbers = " or ".join(str(column.number) for column in found)
            raise InputError(
                f"{place}: column '{selector}' occurs more than once: give its number (`{option}` {numbers})"
            )
    raise InputError(f"{place}: there is no column '{selector}': {list_columns(columns)}")


def _same_name(column: ColumnInfo, wanted: str) -> bool:
    return bool(column.quantity) and " ".join(column.name.split()) == wanted


def _same_name_but_case(column: ColumnInfo, wanted: str) -> bool:
    return bool(column.quantity) and " ".join(column.name.split()).lower() == wanted.lower()


def _same_quantity(column: ColumnInfo, wanted: str) -> bool:
    return bool(column.quantity) and column.quantity.lower() == wanted.lower()


def guess_columns(columns: Sequence[ColumnInfo], guesses: Sequence[str]) -> list[ColumnInfo]:
    """Find the columns whose quantity is one of ``guesses``, or else contains one as a word."""
    exact = [column for column in columns if column.quantity.lower() in guesses]
    if exact:
        return exact
    return [column for column in columns if set(_words(column.quantity)) & set(guesses)]


def _words(quantity: str) -> list[str]:
    return [word.lower() for word in re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", quantity))]


def choose_columns(
    place: str,
    columns: Sequence[ColumnInfo],
    want: Mapping[str, ColumnWish],
    taken: Sequence[ColumnInfo] = (),
) -> dict[str, ColumnInfo]:
    """Give every wished role its column.

    Parameters
    ----------
    place
        The log's name, for messages.
    columns
        What the log has.
    want
        Role to wish; a role that is not required and not found is left out.
    taken
        Columns that are not to be guessed (the time column).

    Raises
    ------
    InputError
        A named column is absent, or a guess finds none or several.
    """
    chosen: dict[str, ColumnInfo] = {}
    for role, wish in want.items():
        if wish.selector is not None:
            chosen[role] = find_column(place, columns, wish.selector, wish.option)
    for role, wish in want.items():
        if wish.selector is None:
            used = {column.number for column in [*taken, *chosen.values()]}
            free = [column for column in columns if column.number not in used]
            found = guess_columns(free, wish.guesses)
            if not found and len(want) == 1 and len(free) == 1 and wish.required:
                found = free  # the only column left is what is meant
            if len(found) == 1:
                chosen[role] = found[0]
            elif found or wish.required:
                raise InputError(_not_unique(place, role, columns, found, wish.option))
    return {role: chosen[role] for role in want if role in chosen}


def _not_unique(
    place: str, role: str, columns: Sequence[ColumnInfo], found: Sequence[ColumnInfo], option: str
) -> str:
    if found:
        names = " or ".join(f"'{column.name}'" for column in found)
        return f"{place}: which column is the {role}, {names}? (choose with `{option}` NAME or NUMBER)"
    there = list_columns(columns)
    return f"{place}: no column is recognised as the {role}: {there} (choose with `{option}` NAME or NUMBER)"
