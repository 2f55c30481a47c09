"""Which column is meant: names, units and guesses.

A header such as ``voltage_V``, ``displacement (um)`` or ``Position [µm]`` names a
quantity and a unit.  Units are carried, never guessed: a suffix after an underscore
counts as a unit only when it is a known one.  Two columns that may be meant are asked
about, never taken by their order.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, OutputError, UsageError, cleaned, counted
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.units import (
    DRIVING_KINDS,
    MOVED_KINDS,
    is_known_unit,
    kind_of_unit,
    normalise_unit,
)

# How headers state units: ``voltage (V)``, ``voltage/V``, ``voltage_V``, ``voltage in
# milli volts``.
_BRACKETED = re.compile(
    r"^(?P<quantity>.*?)\s*[\[(<{](?P<unit>[^\[\](){}<>]*)[\])>}]\s*$", re.DOTALL
)
_SLASHED = re.compile(
    r"^(?P<quantity>.*?)\s*(?:/|\bin\b|,)\s*(?P<unit>\S{1,30})$", re.DOTALL
)
_SUFFIXED = re.compile(r"^(?P<quantity>.+)[_ ](?P<unit>[^_ ]+)$", re.DOTALL)

_PREFIXED = re.compile(
    r"(?P<quantity>.+?)[_ /-](?P<prefix>milli|micro|nano|pico|kilo|mega|centi)",
    re.IGNORECASE,
)

# data[2], x(1), Voltage (CH1)
_INDEX = re.compile(r"[-+]?\d+([.:,]\s*\d+)*|ch(an(nel)?)?[ _]?\w|:")
_BESIDES = frozenset(
    ("n", "no", "index", "idx", "row", "sample", "flag", "temp", "temperature", "loop", "cycle", "trigger",
     "status", "marker", "segment", "remark", "comment", "date", "time")
)  # fmt: skip
"""Names of columns that stand beside the signals in many logs and are none."""
# V(drive), as simulators name a node; t(ticks) has its unit
_SYMBOL = re.compile(r"[A-SU-Za-su-z]\([^()]*\)")
_CHANNEL = re.compile(
    r"(ch|chan|channel|kanal|canal|voie|ai|ao|in|out|input|output|signal|probe|column|col|data|trace)"
    r"[ _.#-]?[a-z]?\d{0,3}",
    re.IGNORECASE,
)
_READINGS = frozenset(
    ("monitor", "mon", "readback", "actual", "meas", "ist", "istwert", "laser", "read")
)
"""Words that say that a column was measured, on which scale nobody knows."""
_CARD = re.compile(r"(?:^|[/ ])(ao|ai)[ _]?\d{1,3}$", re.IGNORECASE)
_REMARKS = frozenset(
    ("raw", "measured", "actual", "filtered", "calibrated", "corrected", "desired", "target", "setpoint",
     "commanded", "command", "sensor", "feedback", "monitor", "smoothed", "mean", "avg", "average", "drive",
     "piezo", "pzt", "stage")
)  # fmt: skip
"""What stands in brackets behind a name and is no unit."""

_HASHED = re.compile(r"/#[^\W\d]")  # TIME/#secs may have been ms

_LISTED = 20  # names of columns that a message holds at most
# a column called "um" is in um; "m" and "Volts" may be anything
_NAMING = ("length", "angle")
# "Channel A" is not in amperes
_LETTERED = ("", "channel", "ch", "chan", "input", "probe")


@dataclass(frozen=True)
class ColumnWish:
    """A column that a command wants.

    Parameters
    ----------
    selector
        What the user gave (a header name, a dataset path, a number counted from 1), or
        None: the column is guessed by what follows.
    guesses
        Names of the quantity, in lower case.
    required
        Whether the absence of the column is an error. Two columns that may be meant are
        refused either way.
    option
        The parameter that messages name in the remedy.
    letters
        Names of one letter, tried as whole names where none of the ``guesses`` is
        there. They do nothing without ``proving_units``.
    kinds
        What the unit may measure (None: anything).
    contrary
        Words that give a column another role: it is not taken.
    by_unit
        Names that count only with a unit of ``proving_units``; ``ch`` stands for all
        names of channels (``CH1 (V)``).
    proving_units
        Kinds of units that prove the role: a column in such a unit needs a lesser name,
        or none where it is the only one. Empty: the ``guesses`` alone decide.
    preferred
        Names that go before all others.
    may_be_blank
        Whether this cell may be empty. A row in which it is empty is left out;
        elsewhere it is refused.
    role
        The key of ``ROLES`` that this wish was made from, if any.
    by_quantity
        Whether a wish that is not required may be met by a unit, a quantity or a card's
        channel, too.
    instead
        What a message names beside the ``option`` where no column is recognised.
    """

    selector: str | None
    guesses: tuple[str, ...] = ()
    required: bool = True
    option: str = "column"
    letters: tuple[str, ...] = ()
    kinds: frozenset[str] | None = None
    contrary: frozenset[str] = frozenset()
    by_unit: tuple[str, ...] = ()
    proving_units: frozenset[str] = frozenset()
    preferred: tuple[str, ...] = ()
    may_be_blank: bool = False
    role: str = ""
    by_quantity: bool = False
    instead: str = ""

    @property
    def foreign(self) -> frozenset[str]:
        """Names of the other roles: such a column is not taken just because no other is left."""
        return _names_of_other_roles(self.role)


@cache
def _names_of_other_roles(role: str) -> frozenset[str]:
    if role not in ROLES:
        return frozenset()
    names: set[str] = set()
    for known in ROLES.values():
        names.update(known.guesses)
    return frozenset(names.difference(ROLES[role].guesses))


# --- the names under which columns are looked for, role by role (docs/instruments.md
# lists them) -----
#
# A name counts where it is a column's whole name or, failing that, one of its words; a
# letter only as the whole name. Of what is found this way, columns are left out whose
# unit measures something else, or that a word such as ``target`` gives another role.

TIME_NAMES = ("time", "t", "x_value", "zeit")  # x_value: what LabVIEW writes
# Names below are those of the manuals and files in docs/instruments.md, in the
# languages of their software.
MORE_TIME_NAMES = (
    "timestamp", "time_stamp", "timestamps", "elapsed", "seconds", "millis", "micros", "milliseconds",
    "microseconds", "nanoseconds", "msec", "usec", "datetime", "zeitstempel", "uhrzeit", "temps", "tiempo",
    "tempo", "date", "datum", "datenum", "tijd", "tid", "czas", "čas", "cas", "время", "时间", "時間",
    "x-axis", "utc", "ts", "epoch",
)  # fmt: skip


_ORDERS = frozenset(
    ("desired", "target", "setpoint", "commanded", "wanted", "demand", "demanded", "reference", "soll",
     "sollwert", "sollposition", "consigne", "command", "nominal", "trajectory")
)  # fmt: skip
"""Words of what was wanted: such a column is no measured displacement."""
_TEMPERATURES = frozenset(
    ("temperature", "temp", "temperatur", "température", "temperatura", "temperatuur", "teplota",
     "температура", "温度", "thermocouple", "thermistor")
)  # fmt: skip
"""Words of a temperature, which is no voltage and no displacement whatever else its name says."""
_VOLTAGE_WORDS = frozenset(("voltage", "volt", "volts", "spannung"))
_DRIVING_WORDS = frozenset(
    ("pressure", "current", "force", "field", "temperature", "temp", "charge", "power", "pwm", "duty",
     "druck", "strom", "kraft", "feld", "temperatur", "ladung", "leistung")
)  # fmt: skip
"""Words of what drives actuators besides a voltage."""
_MOVED_WORDS = frozenset(
    ("strain", "angle", "torque", "elongation", "force", "flux", "induction", "flow", "magnetization",
     "polarization", "dehnung", "winkel", "drehmoment", "kraft", "durchfluss")
)  # fmt: skip
"""Words of what actuators give besides a displacement."""
# a sensor may well give volts
_PLACES = frozenset(("length", "angle", "voltage", "share", "count"))

# Each role has one table of names:
# guesses    names that are enough by themselves
# letters    names of one letter, where none of the guesses is there
# by_unit    names that need a unit of the proving kinds beside them
# preferred  names that go before all others
# contrary   words of another role, whatever else the name says

VOLTAGE = ColumnWish(
    None,
    ("voltage", "drive", "command", "u", "v", "volt", "volts", "spannung", "steuerspannung", "piezospannung",
     "stellspannung", "voltaje", "tensione", "tensão", "tensao", "spanning", "spänning",
     "napięcie", "napiecie", "napětí", "напряжение", "电压", "電圧", "vpiezo", "upiezo", "vdrive", "vpzt"),
    kinds=frozenset(("voltage", "share", "count")),
    contrary=frozenset(("sensor", "position", "displacement", "feedback", "photodiode", "interferometer",
                        "supply")) | _TEMPERATURES,
    by_unit=("tension", "piezo", "pzt", "control", "vin", "uin", "ch"),
    proving_units=frozenset(("voltage",)),
)  # fmt: skip
DISPLACEMENT = ColumnWish(
    None,
    ("displacement", "position", "measured", "sensor", "y", "disp", "pos", "weg", "auslenkung",
     "verschiebung", "hub", "istposition", "deplacement", "déplacement", "desplazamiento", "spostamento",
     "posición", "posizione", "verplaatsing", "przemieszczenie", "перемещение", "位移", "変位", "deflection",
     "stroke", "elongation", "interferometer", "encoder", "capacitive", "lvdt"),
    letters=("x", "z"),
    kinds=_PLACES,
    contrary=_ORDERS | _TEMPERATURES,
    by_unit=("actual", "current", "ist", "istwert", "feedback", "readback", "laser", "ldv", "vibrometer",
             "meas", "travel", "ch"),
    proving_units=frozenset(("length", "angle")),
)  # fmt: skip
DESIRED = ColumnWish(
    None,
    ("desired", "reference", "setpoint", "target", "trajectory", "wanted", "ref", "soll", "sollwert",
     "sollposition", "sollweg", "consigne", "demand", "commanded"),
    kinds=_PLACES,
    contrary=_TEMPERATURES,
    by_unit=("command",),
    proving_units=frozenset(("length", "angle")),
)  # fmt: skip
TRAJECTORY = replace(
    DISPLACEMENT,
    guesses=(*DISPLACEMENT.guesses, *DESIRED.guesses),
    contrary=_TEMPERATURES,
    by_unit=(*DESIRED.by_unit, *DISPLACEMENT.by_unit),
    preferred=DESIRED.guesses,
)
ROLES = {
    "voltage": VOLTAGE, "displacement": DISPLACEMENT, "measured": DISPLACEMENT, "desired": DESIRED,
    "trajectory": TRAJECTORY,
}  # fmt: skip


@lru_cache(maxsize=256)  # asked for at every call from Python
def column_wish(
    role: str,
    selector: str | None = None,
    *,
    option: str = "column",
    quantity: str | None = None,
    unit: str | None = None,
    required: bool = True,
    may_be_blank: bool = False,
) -> ColumnWish:
    """Return the wish for the column of a role.

    Parameters
    ----------
    role
        ``voltage``, ``displacement``, ``measured``, ``desired``, ``trajectory`` (a
        displacement that may be called desired), or a quantity with no names but its
        own.
    selector
        What the user named, or None to guess.
    option
        The parameter that messages name.
    quantity, unit
        What a model calls the quantity, and its unit: a column in a unit of that kind
        is not left out.
    required
        Whether its absence is an error; two columns that may be meant are refused
        either way.
    may_be_blank
        Whether this cell may be empty; a row in which it is empty is left out.
    """
    name = (quantity or role).lower()
    unit_kind = kind_of_unit(unit)
    known = ROLES.get(role)
    if known is None:
        return ColumnWish(
            selector,
            (name,),
            required,
            option,
            kinds=None if unit_kind is None else frozenset((unit_kind,)),
            may_be_blank=may_be_blank,
        )
    guesses = known.guesses
    if quantity:
        guesses = (name, *(guess for guess in guesses if guess != name))
    kinds = known.kinds or frozenset()
    if unit_kind:
        kinds |= {unit_kind}
    return replace(
        known,
        selector=selector,
        guesses=guesses,
        required=required,
        option=option,
        kinds=kinds,
        may_be_blank=may_be_blank,
        role=role,
    )


# --- headers ---


def split_header(header: str) -> tuple[str, str | None]:
    """Split a header cell into its quantity and its normalised unit (or None)."""
    text = " ".join(header.split())
    match = _BRACKETED.match(text)
    if match and match["quantity"] and not is_torn(text):
        inner = match["unit"].strip().lower()
        symbol = _SYMBOL.fullmatch(text) and not is_known_unit(match["unit"])
        if symbol or _INDEX.fullmatch(inner) or inner in _REMARKS:
            return text, None
        return match["quantity"].strip().rstrip("_,"), normalise_unit(match["unit"])
    for written in (_SLASHED, _SUFFIXED):
        match = written.match(text)
        # half a bracket is no unit
        if match is None or match["unit"].strip("[](){}<>") != match["unit"]:
            continue
        quantity = match["quantity"].strip()
        unit = match["unit"]
        apart = _PREFIXED.fullmatch(quantity)
        if apart is not None:  # milli volts
            quantity = apart["quantity"].rstrip(" /")
            unit = apart["prefix"] + unit
        if is_known_unit(unit) and quantity.lower() not in _LETTERED:
            return quantity, normalise_unit(unit)
    return text, None


def is_torn(text: str) -> bool:
    """Return whether brackets do not fit, or a # stands for a letter of the unit: it is not clear."""
    for left, right in ("()", "[]", "{}"):
        if text.count(left) != text.count(right):
            return True
    return _HASHED.search(text) is not None


@lru_cache(maxsize=256)
def parse_column(header: str | None, number: int, unit: str | None = None) -> Column:
    """Describe column ``number`` (from 1) by its header cell; a unit given apart (units line) goes first."""
    # no command for a terminal, no half a letter
    header = cleaned(header or "")
    unit = cleaned(unit or "")
    if header[:1] == "'" and header[1:2] in ("=", "+", "-", "@"):
        header = header[1:]  # what keeps a spreadsheet from taking it for a formula
    if not header:
        return Column(str(number), normalise_unit(unit or ""), "", number)
    quantity, unit_in_name = split_header(header)
    bare = header.strip(" /_")  # "/nm": the name is lost
    if (
        unit_in_name is None
        and bare != "m"
        and kind_of_unit(normalise_unit(bare)) in _NAMING
    ):
        unit_in_name = normalise_unit(bare)
    return Column(header, normalise_unit(unit or "") or unit_in_name, quantity, number)


def contradicted_unit(column: Column) -> str | None:
    """Return the unit that a column's name states where it is another than the one it was given apart."""
    if not column.quantity:
        return None
    _, unit_in_name = split_header(column.name.rsplit("/", 1)[-1])
    known = (
        unit_in_name is not None
        and column.unit is not None
        and is_known_unit(unit_in_name)
    )
    return unit_in_name if known and unit_in_name != column.unit else None


def column_label(column: Column) -> str:
    """Name a column in a message: ``column 'voltage_V'``, or ``column 2`` where the log has no header."""
    if column.quantity:
        return f"column '{column.name}'"
    return f"column {column.number}"


def list_columns(columns: Sequence[Column]) -> str:
    """List the columns of a log for an error message, shortened when there are many."""
    if not any(column.quantity for column in columns):
        return f"it has {counted(len(columns), 'column')} without names"
    shown = []
    for column in columns[:_LISTED]:
        name = f" {column.name}" if column.quantity else ""
        shown.append(f"{column.number}{name}")
    text = f"it has {', '.join(shown)}"
    if len(columns) > _LISTED:
        text += f", … ({len(columns)} in all)"
    return text


def any_of(names: Sequence[str]) -> str:
    """List what may be meant for an error message, shortened when there is much."""
    listed = " or ".join(names[:_LISTED])
    if len(names) > _LISTED:
        return f"{listed} or … ({len(names)} in all)"
    return listed


def find_column(
    place: str, columns: Sequence[Column], selector: str, option: str
) -> Column:
    """Find the column that the user named, or gave a part of the name with ``*`` for the rest.

    Raises
    ------
    InputError
        The name is absent or occurs more than once, or the number is past the end.
    UsageError
        The number is 0 or negative.
    """
    how, separator, rest = selector.partition("=")
    if separator and how in ("number", "name"):
        selector = rest
    else:
        how = ""
    if re.fullmatch(r"[+-]?\d{1,15}", selector) and how != "name":
        if not how:
            _ask_about_number(place, columns, selector, option)
        return _column_number(place, columns, int(selector), f"`{option}` {selector}")
    return _column_named(place, columns, selector, option)


def _column_number(
    place: str, columns: Sequence[Column], number: int, typed: str
) -> Column:
    if number < 1:
        raise UsageError(f"{typed}: columns are counted from 1")
    if number > len(columns):
        has = counted(len(columns), "column")
        raise InputError(f"{place}: there is no column {number}: it has {has}")
    return columns[number - 1]


def _column_named(
    place: str, columns: Sequence[Column], selector: str, option: str
) -> Column:
    """Find a column by its name, by its name in other capitals, its quantity, or a part of its name."""
    wanted = cleaned(selector)
    lower = wanted.lower()
    named = [column for column in columns if column.quantity]
    names = {column.number: " ".join(column.name.split()) for column in named}
    for matching in (
        [column for column in named if names[column.number] == wanted],
        [column for column in named if names[column.number].lower() == lower],
        [column for column in named if column.quantity.lower() == lower],
    ):
        if len(matching) == 1:
            return matching[0]
        if matching:
            numbers = any_of([str(column.number) for column in matching])
            raise InputError(
                f"{place}: column '{selector}' occurs more than once: give its number (`{option}` {numbers})"
            )
    fitting = [column for column in named if fits_pattern(names[column.number], wanted)]
    if len(fitting) > 1:
        shown = any_of([f"'{column.name}'" for column in fitting[:3]])
        raise InputError(
            f"{place}: `{option}` {selector} fits {len(fitting)} columns: {shown}? (give more of it)"
        )
    if fitting:
        return fitting[0]
    raise InputError(
        f"{place}: there is no column '{selector}': {list_columns(columns)}"
    )


def fits_pattern(name: str, pattern: str) -> bool:
    """Tell whether a name is what a pattern with ``*`` for any letters asks for, capitals aside."""
    parts = map(re.escape, pattern.split("*"))
    return (
        "*" in pattern
        and re.fullmatch(".*".join(parts), name, re.IGNORECASE | re.DOTALL) is not None
    )


def _ask_about_number(
    place: str, columns: Sequence[Column], selector: str, option: str
) -> None:
    """Refuse a number that is the name of another column than the one at that place (InputError)."""
    number = int(selector)
    named = []
    for column in columns:
        if column.quantity and column.name.strip() == selector:
            named.append(column)
    elsewhere = any(column.number != number for column in named)
    if elsewhere and 1 <= number <= len(columns):
        raise InputError(
            f"{place}: `{option}` {selector}: column {selector}, '{columns[number - 1].name}', or column "
            f"{named[0].number}, which is named '{selector}'? "
            f"(`{option}` number={selector} or name={selector})"
        )


def guess_columns(columns: Sequence[Column], guesses: Sequence[str]) -> list[Column]:
    """Find the columns whose quantity is one of ``guesses``, or else contains one as a word."""
    whole = [column for column in columns if column.quantity.lower() in guesses]
    if whole:
        return whole
    with_word = []
    for column in columns:
        if set(_words(column.quantity)) & set(guesses):
            with_word.append(column)
    return with_word


def matching_columns(columns: Sequence[Column], wish: ColumnWish) -> list[Column]:
    """Find the columns that a wish may mean; the log is clear where it is one.

    Names are tried from the surest to the weakest: preferred names, the guesses, then
    letters and names that need a unit. What is found by less than a whole name, or by a
    letter beside other axes' letters, has to stand alone: beside it, whatever has a
    unit that proves the role may be meant as well, and so may a name that is only
    misspelled.
    """
    fitting = [column for column in columns if may_be(column, wish)]
    preferred = guess_columns(fitting, wish.preferred)
    if preferred:
        return preferred
    by_name = guess_columns(fitting, wish.guesses)
    if not wish.proving_units:
        return by_name  # no unit says more than the names do
    proved = [column for column in fitting if _has_proving_unit(column, wish)]
    lettered = [column for column in fitting if column.quantity.lower() in wish.letters]
    whole = [column for column in by_name if column.quantity.lower() in wish.guesses]
    if by_name and all(_is_sure(column, wish) for column in by_name):
        other_axes = set(lettered) & set(proved)
        is_axis = any(len(column.quantity) == 1 for column in by_name)
        if len(whole) == len(by_name) and not (is_axis and other_axes):
            return by_name  # whole names beside which nothing else can be meant
        possible = {*by_name, *_misspelled(fitting, wish), *other_axes}
        return [column for column in fitting if column in possible]
    if not by_name and guess_columns(columns, wish.guesses):
        # the column of that name is in a unit that cannot be meant: no lesser name
        # replaces it
        return []
    lesser = [column for column in proved if _has_lesser_name(column, wish)]
    if not (by_name or lettered or lesser):
        return []  # a unit alone is not enough here, see `_only_candidate`
    possible = {*by_name, *lettered, *proved, *_misspelled(fitting, wish)}
    if not whole:
        possible.update(_suspects(fitting, wish, bool(by_name), [*lettered, *lesser]))
    return [column for column in fitting if column in possible]


def _has_proving_unit(column: Column, wish: ColumnWish) -> bool:
    return kind_of_unit(column.unit) in wish.proving_units


def _is_sure(column: Column, wish: ColumnWish) -> bool:
    """Return whether a column was found by a whole name, or by a word and a unit of the right kind."""
    kind = kind_of_unit(column.unit)
    whole = len(column.quantity) > 1 and column.quantity.lower() in wish.guesses
    return kind in wish.proving_units or (whole and kind is None)


def _misspelled(columns: Sequence[Column], wish: ColumnWish) -> list[Column]:
    """Find the columns of which a word is a long name but for one letter."""
    return [column for column in columns if _is_misspelled(column, wish)]


def _is_misspelled(column: Column, wish: ColumnWish) -> bool:
    """Return whether a word of a column is a long name but for one letter."""
    words = set(_words(column.quantity))
    words.update(re.findall(r"[^\W_]+", column.quantity.lower()))
    for word in words - wish.foreign:
        for name in wish.guesses:
            if len(name) >= 4 and _one_letter_off(word, name):
                return True
    return False


def _suspects(
    fitting: Sequence[Column],
    wish: ColumnWish,
    has_name: bool,
    lesser: Sequence[Column],
) -> list[Column]:
    """Find what may be meant beside a column that has no whole name: names run together, letters in words.

    Where no unit supports what was found by a lesser name, any column of an unknown
    name may be meant.
    """
    sure = has_name or all(_has_proving_unit(column, wish) for column in lesser)
    suspects = []
    for column in fitting:
        is_unknown = column.unit is None and _is_unknown(column, wish)
        if _hides_name(column, wish) or (is_unknown and not sure):
            suspects.append(column)
    return suspects


def _hides_name(column: Column, wish: ColumnWish) -> bool:
    """Return whether a name of the wish may stand in a column's, run together or torn."""
    letters = _letters(column)
    for name in wish.guesses:
        if len(name) >= 4 and name in letters:
            return True  # positionmm, Posi)tion
        if len(name) == 3 and letters.startswith(name):
            return True  # Wegccm
    if column.unit is None and is_torn(column.quantity):
        return True  # nothing of the name is left: ) (mm)
    if set(_words(column.quantity)) & set(wish.letters):
        return True
    return _runs_into_unit(column, wish)


def _letters(column: Column) -> str:
    return "".join(re.findall(r"[^\W_]+", column.quantity.lower()))


def _runs_into_unit(column: Column, wish: ColumnWish) -> bool:
    """Return whether a name and a unit of the right kind stand without anything between them: Wegµm."""
    word = _letters(column)
    for name in (*wish.guesses, *wish.letters):
        end = word.removeprefix(name)
        if not word.startswith(name) or not end:
            continue
        if kind_of_unit(normalise_unit(end)) in wish.proving_units:
            return True
    return False


def _is_unknown(column: Column, wish: ColumnWish) -> bool:
    """Return whether nothing is known of a column's name: no other role's, and no mere number or flag."""
    words = set(_words(column.quantity))
    return bool(words) and not words & (wish.foreign | _BESIDES)


def _one_letter_off(word: str, name: str) -> bool:
    """Return whether a word is a name but for one letter: put in, left out, changed, or swapped."""
    if abs(len(word) - len(name)) > 1:
        return False
    if word[0] != name[0] and word[-1] != name[-1]:
        return False  # the usual case; one slip leaves the first or the last letter
    if len(word) == len(name):
        return _one_changed_or_swapped(word, name)
    short, long = sorted((word, name), key=len)
    for place, letter in enumerate(short):
        if letter != long[place]:
            return short[place:] == long[place + 1 :]
    return True  # the last letter is the one too many


def _one_changed_or_swapped(word: str, name: str) -> bool:
    """Return whether words of one length differ in one letter, or in two neighbours that change places."""
    differing = [place for place, letter in enumerate(word) if letter != name[place]]
    if len(differing) != 2:
        return len(differing) == 1
    first, second = differing
    if second != first + 1:
        return False
    return word[first] == name[second] and word[second] == name[first]


def _has_lesser_name(column: Column, wish: ColumnWish) -> bool:
    words = set(_words(column.quantity))
    # a monitor has a scale of its own
    if words & set(wish.by_unit) and not words & {"monitor", "mon"}:
        return True
    if "ch" not in wish.by_unit:
        return False
    return (
        bool(_CHANNEL.fullmatch(column.quantity.strip()))
        or normalise_unit(column.quantity) == column.unit
    )


def may_be(column: Column, wish: ColumnWish) -> bool:
    """Return whether nothing in a column's unit and words speaks against a wish."""
    if column.written != "numbers":
        return False
    kind = kind_of_unit(column.unit)
    if wish.kinds is not None and kind is not None and kind not in wish.kinds:
        return False
    return not wish.contrary & set(_words(column.name))


def _words(quantity: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", quantity)  # driveVoltage
    return [word.lower() for word in re.findall(r"[^\W\d_]+", spaced)]


def choose_columns(
    place: str,
    columns: Sequence[Column],
    wishes: Mapping[str, ColumnWish],
    reserved: Sequence[Column] = (),
    timed: bool = True,
    notes: list[str] | None = None,
) -> dict[str, Column]:
    """Give every wished role its column.

    Parameters
    ----------
    place
        The log's name, for messages.
    columns
        What the log has.
    wishes
        Role to wish; a role that is not required and not found is left out.
    reserved
        Columns that are not to be guessed (the time column).
    timed
        Whether the samples' time is known; else the remedy names a time column, too.
    notes
        Takes what is to be said of columns that were taken for their unit or place
        alone.

    Raises
    ------
    InputError
        A named column is absent, or a guess finds none or several.
    """
    role_columns: dict[str, Column] = {}
    for role, wish in wishes.items():
        if wish.selector is not None:
            role_columns[role] = find_column(place, columns, wish.selector, wish.option)
    used = {column.number for column in [*reserved, *role_columns.values()]}
    free = [column for column in columns if column.number not in used]
    _refuse_named_away(place, columns, free, wishes, role_columns)
    reasons: dict[str, str] = {}
    unclear = _guess_roles(
        columns, free, wishes, role_columns, None if notes is None else reasons
    )
    if notes is not None:
        for role, reason in reasons.items():
            taken = f"'{role_columns[role].name}' is taken for the {_ROLE_WORDS[role]}"
            remedy = f"(`{wishes[role].option}` names another)"
            notes.append(f"{place}: {taken}: {reason} {remedy}")
    if unclear:
        numbers = [column.number for column in free]
        raise InputError(_not_unique(place, columns, wishes, unclear, numbers, timed))
    chosen = {}
    for role, wish in wishes.items():
        if role in role_columns:
            column = role_columns[role]
            chosen[role] = replace(column, may_be_blank=wish.may_be_blank)
    return chosen


def _refuse_named_away(
    place: str,
    columns: Sequence[Column],
    free: Sequence[Column],
    wishes: Mapping[str, ColumnWish],
    named: Mapping[str, Column],
) -> None:
    """Refuse, for a role that is only ever named, the column that by its name is another role's (InputError).

    A lesser column would else be guessed for the other role: the standard deviation for
    the displacement.
    """
    for role, wish in wishes.items():
        if wish.selector is None or wish.guesses:
            continue
        column = named[role]
        guessed = dict(named)
        _guess_roles(columns, [*free, column], wishes, guessed, None)
        for other in guessed.keys() - named.keys():
            if guessed[other].number == column.number:
                raise InputError(
                    f"{place}: column '{column.name}' is the {other}, not the {role} "
                    f"(`{wishes[other].option}` names another)"
                )


def _guess_roles(
    columns: Sequence[Column],
    free: list[Column],
    wishes: Mapping[str, ColumnWish],
    role_columns: dict[str, Column],
    reasons: dict[str, str] | None,
) -> dict[str, list[Column]]:
    """Give each role that has no column the only one that may be meant.

    Parameters
    ----------
    columns
        All columns of the log.
    free
        Those that have no role yet; what is found is taken out.
    wishes
        Role to wish.
    role_columns
        Takes what is found.
    reasons
        Takes why a column was taken for its unit or its place alone, by role; None
        where nobody hears it: names alone count then.

    Returns
    -------
    dict
        What may be meant for each role that is not clear.
    """
    unclear: dict[str, list[Column]] = {}
    for role, wish in wishes.items():
        if role in role_columns:
            continue
        candidates, reason = _candidates(
            free, columns, role, wish, len(wishes), reasons is not None
        )
        if len(candidates) == 1:
            role_columns[role] = candidates[0]
            free.remove(candidates[0])
            if reasons is not None and reason:
                reasons[role] = reason
        elif candidates or wish.required:
            unclear[role] = candidates
    if reasons is None or any(unclear.values()):
        return unclear
    left, reason = _by_what_is_left(free, wishes, list(unclear))
    for role, column in left.items():
        role_columns[role] = column
        reasons[role] = reason
        free.remove(column)
        del unclear[role]
    if (
        "voltage" in wishes
        and "voltage" not in role_columns
        and wishes["voltage"].by_quantity
    ):
        drive = _only_drive(free, wishes["voltage"])
        if drive is not None:
            role_columns["voltage"] = drive
            reasons["voltage"] = "no other column has such a quantity"
    return unclear


def _candidates(
    free: Sequence[Column],
    columns: Sequence[Column],
    role: str,
    wish: ColumnWish,
    wishes: int,
    by_unit: bool,
) -> tuple[list[Column], str]:
    """Find the columns that may be meant, and why, where no name says it (only with ``by_unit``)."""
    candidates = matching_columns(free, wish)
    if candidates or not (wish.required or wish.by_quantity):
        return candidates, ""
    if wishes == 1 and len(free) == 1:
        candidates = _last_column(free, wish)
    if not candidates and by_unit and role in ("voltage", *_RESULTS):
        return _only_candidate(free, columns, wish)
    return candidates, ""


def _last_column(free: Sequence[Column], wish: ColumnWish) -> list[Column]:
    """Return the column that is left for the only wish, unless its unit or name speaks against it."""
    left = []
    for column in free:
        if may_be(column, wish) and column.quantity.lower() not in wish.foreign:
            left.append(column)
    return left


def _only_candidate(
    free: Sequence[Column], columns: Sequence[Column], wish: ColumnWish
) -> tuple[list[Column], str]:
    """Find a column that no name gives away, and why it is meant: its unit, or its place on a card.

    Not beside a column of the right name whose unit cannot be meant, nor one whose name
    says something else; a monitor has a scale of its own.
    """
    if guess_columns(columns, wish.guesses):
        return [], ""
    proved = []
    for column in free:
        if may_be(column, wish) and _has_proving_unit(column, wish):
            proved.append(column)
    if len(proved) == 1:
        contrary_words = wish.foreign | _BESIDES | _READINGS
        if not contrary_words & set(_words(proved[0].quantity)):
            return (
                proved,
                f"no other column is in a unit of {kind_of_unit(proved[0].unit)}",
            )
    if proved or wish.preferred:
        return [], ""
    return _only_card_channel(free, columns, wish)


_RESULTS = frozenset(("displacement", "measured"))
"""Roles of what comes out of an actuator, whatever quantity it is; ``voltage`` is that of what drives it."""
_ROLE_WORDS = {
    "voltage": "drive",
    "displacement": "displacement",
    "measured": "measured signal",
}


def _by_what_is_left(
    free: Sequence[Column], wishes: Mapping[str, ColumnWish], absent: Sequence[str]
) -> tuple[dict[str, Column], str]:
    """Find the drive and what came out by elimination, in logs of other actuators than piezos.

    Where one role is known, the only column that is left has the other; so has the only
    one that drives actuators (a pressure, a current) or that they give (an angle, a
    strain). Of two columns left for two roles each must fit one of them alone.

    Returns
    -------
    dict, str
        The column of each role that is absent, and why it is meant; empty where that is
        not clear.
    """
    if not set(absent) <= {"voltage", *_RESULTS}:
        return {}, ""
    numbered = list(filter(_has_named_numbers, free))
    if any(_is_called_a_voltage_in_vain(column) for column in numbered):
        return {}, ""
    measured = [column for column in numbered if not _ORDERS & set(_words(column.name))]
    if len(absent) == 1:
        role = absent[0]
        rest, reason = _the_rest(numbered, wishes[role], role, len(wishes))
        return ({}, "") if rest is None else ({role: rest}, reason)
    if len(absent) != 2 or len(measured) != 2 or len(numbered) != 2:
        return {}, ""
    orders = []
    for drive, result in (measured, measured[::-1]):
        if _drives(drive) and _is_moved(result):
            orders.append(
                {role: drive if role == "voltage" else result for role in absent}
            )
    if len(orders) != 1:
        return {}, ""
    return orders[0], "of the two columns it alone can be"


def _has_named_numbers(column: Column) -> bool:
    return column.written == "numbers" and bool(column.quantity)


def _the_rest(
    numbered: Sequence[Column], wish: ColumnWish, role: str, wishes: int
) -> tuple[Column | None, str]:
    """Find the column of the only role that is absent, and why it is meant; None where that is not clear."""
    if role == "voltage":
        fits = _drives
        contrary = _is_moved
        wrong_words = wish.contrary - _TEMPERATURES | _ORDERS
    else:
        fits = _is_moved
        contrary = _drives
        wrong_words = wish.contrary | _ORDERS
    fitting = []
    rest = []
    for column in numbered:
        words = set(_words(column.name))
        if fits(column) and not words & wrong_words:
            fitting.append(column)
        elif not contrary(column) and not words & (wish.foreign | _ORDERS):
            rest.append(column)
    if len(fitting) == 1 and not rest:
        return fitting[0], "no other column has such a quantity"
    if wishes != 2 or len(numbered) != 1 or len(rest) != 1:
        return None, ""
    words = set(_words(rest[0].name))
    if words & wish.contrary:
        return None, ""
    if words & _READINGS:
        return rest[
            0
        ], "no other column is left; a monitor's scale is its own (`scale` gives it)"
    return rest[0], "no other column is left"


def _only_drive(free: Sequence[Column], wish: ColumnWish) -> Column | None:
    """Find the drive of a report, which can do without it: the only column of a quantity that drives.

    A temperature is none: it stands beside the signals of many logs.
    """
    contrary_words = wish.contrary | _ORDERS | _READINGS | _TEMPERATURES
    drives = []
    for column in free:
        if column.written != "numbers" or not _drives(column):
            continue
        if kind_of_unit(column.unit) != "temperature" and not contrary_words & set(
            _words(column.name)
        ):
            drives.append(column)
    return drives[0] if len(drives) == 1 else None


def _drives(column: Column) -> bool:
    """Return whether a column is a quantity that drives actuators besides a voltage."""
    kind = kind_of_unit(column.unit)
    if kind is not None:
        return kind in DRIVING_KINDS
    return column.quantity.lower() in _DRIVING_WORDS


def _is_called_a_voltage_in_vain(column: Column) -> bool:
    """Return whether a column is called a voltage, and its unit is that of something else."""
    called = _VOLTAGE_WORDS & set(_words(column.name))
    return bool(called) and kind_of_unit(column.unit) not in (None, "voltage")


def _is_moved(column: Column) -> bool:
    """Return whether a column is a quantity that actuators give, as displacement is."""
    kind = kind_of_unit(column.unit)
    if kind in ("length", "angle") or kind in MOVED_KINDS:
        return True
    return kind in (None, "share") and column.quantity.lower() in _MOVED_WORDS


def _only_card_channel(
    free: Sequence[Column], columns: Sequence[Column], wish: ColumnWish
) -> tuple[list[Column], str]:
    """Find the only channel of a data acquisition card without units: ao drives and ai measures.

    The card has one output; of several it is not known which one drives.
    """
    prefix = "ao" if "voltage" in wish.proving_units else "ai"
    prefixes: dict[int, str] = {}
    for column in columns:
        match = _CARD.search(column.quantity.strip())
        if column.unit is None and match is not None:
            prefixes[column.number] = match[1].lower()
    channels = [column for column in free if prefixes.get(column.number) == prefix]
    if len(channels) != 1 or list(prefixes.values()).count("ao") != 1:
        return [], ""
    return channels, f"the only analog {'output' if prefix == 'ao' else 'input'}"


def _not_unique(
    place: str,
    columns: Sequence[Column],
    wishes: Mapping[str, ColumnWish],
    unclear: Mapping[str, Sequence[Column]],
    free: Sequence[int],
    timed: bool,
) -> str:
    """Ask for every role at once which columns may be meant, or that none is, and how to choose."""
    role_names = {}
    for role in unclear:
        role_names[role] = f"{role} signal" if role in ("desired", "measured") else role
    if not any(column.quantity for column in columns) and len(free) >= len(unclear):
        options = [wishes[role].option for role in unclear]
        if not timed and len(free) > len(unclear):
            options.insert(0, "time")
        example = " ".join(
            f"`{option}` {number}"
            for option, number in zip(options, free, strict=False)
        )
        which = ", which the ".join(role_names.values())
        return f"{place}: {list_columns(columns)}: which is the {which}? (such as {example})"
    questions = []
    absent = []
    absent_roles = []
    for role, candidates in unclear.items():
        if candidates:
            names = any_of([f"'{column.name}'" for column in candidates])
            questions.append(f"which column is the {role_names[role]}, {names}?")
        else:
            absent_roles.append(role)
            absent.append(role_names[role] + _order_instead(columns, wishes[role]))
    if absent:
        nothing = f"no column is recognised as the {' nor as the '.join(absent)}"
        questions.append(f"{nothing}: {list_columns(columns)}")
    if set(absent_roles) == {"voltage", "displacement"} and len(free) == 2:
        first, second = (
            f"'{column.name}'" for column in columns if column.number in free
        )
        both_ways = f"`voltage` {first} `displacement` {second}, or `voltage` {second} `displacement` {first}"
        return f"{place}: {' '.join(questions)} ({both_ways})"
    options = [f"`{wishes[role].option}`" for role in unclear]
    remedy = f"choose with {' and '.join(options)} NAME or NUMBER"
    for role in absent_roles:
        if wishes[role].instead:
            remedy += f", or {wishes[role].instead}"
    return f"{place}: {' '.join(questions)} ({remedy})"


def _order_instead(columns: Sequence[Column], wish: ColumnWish) -> str:
    """Say that a log holds what was wanted, where what was measured is missing."""
    for column in columns:
        if is_order(column, wish):
            return (
                f": '{column.name}' is what was wanted, not what was measured (play the drive and record the "
                "sensor beside it)"
            )
    return ""


def is_order(column: Column, wish: ColumnWish) -> bool:
    """Return whether a column says what was wanted, where what was measured is looked for."""
    if not wish.contrary >= _ORDERS:
        return False  # what was wanted may be meant
    if (
        wish.kinds is not None
        and column.unit is not None
        and kind_of_unit(column.unit) not in wish.kinds
    ):
        return False
    return bool(_ORDERS & set(_words(column.name)))


# --- columns that are written ---


def header_of(column: Column) -> str:
    """Return a header cell, ``voltage_V``; a unit that no reader would know stands in brackets."""
    name, unit = cleaned(column.name), cleaned(column.unit or "")
    if not unit or split_header(name)[1] == unit:
        return name
    is_plain = is_known_unit(unit) and "/" not in unit
    return f"{name}_{unit}" if is_plain else f"{name} ({unit})"


def unique_headers(columns: Sequence[Column]) -> list[str]:
    """Return the headers of a table; the second column of a name is called ``name_2``."""
    headers: list[str] = []
    for column in columns:
        first = header_of(column)
        header = first
        number = 2
        while header in headers:
            header = f"{first}_{number}"
            number += 1
        headers.append(header)
    return headers


def require_finite(
    columns: Sequence[Column], headers: Sequence[str], arrays: Sequence[ArrayLike]
) -> None:
    """Refuse to write NaN or infinity: the model or the signal is beyond the range of the arithmetic.

    Raises
    ------
    OutputError
        An array holds one, and it is no NaN of a column that may be blank; its header
        is named.
    """
    for column, header, array in zip(columns, headers, arrays, strict=True):
        good = np.isfinite(array)
        if not (good.all() or (column.may_be_blank and (good | np.isnan(array)).all())):
            raise OutputError(
                f"column '{header}' would hold a number that is not finite: the model or the signal is "
                "beyond the range of the arithmetic"
            )


PLACE = re.compile(r"\{(?:channel)?\}")
"""Stands in the name of a column for the name of each of many channels."""


def is_pattern(selector: str | None) -> bool:
    """Tell whether the name of a column stands for many."""
    return selector is not None and PLACE.search(selector) is not None
