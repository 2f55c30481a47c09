"""Which column is meant: names, units and guesses.

A header such as ``voltage_V``, ``displacement (um)`` or ``Position [µm]`` names a quantity and a unit.  Units
are carried, never guessed: a suffix after an underscore counts as a unit only when it is a known one.  Two
columns that may be meant are asked about, never taken by their order.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, OutputError, UsageError
from dbo_cli.logs.plain_text import cleaned, counted, pattern
from dbo_cli.logs.sample_block import ColumnInfo
from dbo_cli.logs.units import is_known_unit, kind_of_unit, normalise_unit
from dbo_cli.records import dataclass

# How headers state units: ``voltage (V)``, ``voltage/V``, ``voltage_V``, ``voltage in milli volts``.
_BRACKETED = pattern(r"^(?P<quantity>.*?)\s*[\[(<{](?P<unit>[^\[\](){}<>]*)[\])>}]\s*$", re.DOTALL)
_SLASHED = pattern(r"^(?P<quantity>.*?)\s*(?:/|\bin\b|,)\s*(?P<unit>\S{1,30})$", re.DOTALL)
_SUFFIXED = pattern(r"^(?P<quantity>.+)[_ ](?P<unit>[^_ ]+)$", re.DOTALL)

_PREFIXED = pattern(
    r"(?P<quantity>.+?)[_ /-](?P<prefix>milli|micro|nano|pico|kilo|mega|centi)", re.IGNORECASE
)

_INDEX = pattern(r"[-+]?\d+([.:,]\s*\d+)*|ch(an(nel)?)?[ _]?\w|:")  # data[2], x(1), Voltage (CH1)
_BESIDES = frozenset(
    ("n", "no", "index", "idx", "row", "sample", "flag", "temp", "temperature", "loop", "cycle", "trigger",
     "status", "marker", "segment", "remark", "comment", "date", "time")
)  # fmt: skip
"""Names of columns that stand beside the signals in many logs and are none."""
_SYMBOL = pattern(r"[A-SU-Za-su-z]\([^()]*\)")  # V(drive), as simulators name a node; t(ticks) has its unit
_CHANNEL = pattern(
    r"(ch|chan|channel|kanal|canal|voie|ai|ao|in|out|input|output|signal|probe|column|col|data|trace)"
    r"[ _.#-]?[a-z]?\d{0,3}",
    re.IGNORECASE,
)
_READINGS = frozenset(("monitor", "mon", "readback", "actual", "meas", "ist", "istwert", "laser", "read"))
"""Words that say that a column was measured, on which scale nobody knows."""
_CARD = pattern(r"(?:^|[/ ])(ao|ai)[ _]?\d{1,3}$", re.IGNORECASE)
_REMARKS = frozenset(
    ("raw", "measured", "actual", "filtered", "calibrated", "corrected", "desired", "target", "setpoint",
     "commanded", "command", "sensor", "feedback", "monitor", "smoothed", "mean", "avg", "average", "drive",
     "piezo", "pzt", "stage")
)  # fmt: skip
"""What stands in brackets behind a name and is no unit."""

_HASHED = pattern(r"/#[^\W\d]")  # TIME/#secs may have been ms

_LISTED = 20  # names of columns that a message holds at most
_NAMING = ("length", "angle")  # a column called "um" is in um; "m" and "Volts" may be anything
_LETTERED = ("", "channel", "ch", "chan", "input", "probe")  # "Channel A" is not in amperes


@dataclass(frozen=True)
class ColumnWish:
    """A column that a command wants.

    ``selector`` is what the user gave (a header name, a dataset path, a number counted from 1) or None; then
    ``guesses`` are tried, quantity names in lower case.  ``option`` is the parameter named in the remedy.

    What is guessed is held against the rest: ``letters`` are tried as whole names where no name is found,
    ``kinds`` are what the unit may measure (None: anything), ``contrary`` are words that give a column
    another role, ``by_unit`` are names that count only with a unit of ``channel_kinds`` (``ch`` stands for
    all names of channels: ``CH1 (V)``), a column with one of the ``preferred`` names goes before the others,
    and one with a ``foreign`` name is not taken just because no other is left.

    Rows without a value are left out where the column ``may_be_blank``, and refused elsewhere.
    """

    selector: str | None
    guesses: tuple[str, ...] = ()
    required: bool = True
    option: str = "column"
    letters: tuple[str, ...] = ()
    kinds: frozenset[str] | None = None
    contrary: frozenset[str] = frozenset()
    by_unit: tuple[str, ...] = ()
    channel_kinds: frozenset[str] = frozenset()
    preferred: tuple[str, ...] = ()
    foreign: frozenset[str] = frozenset()
    may_be_blank: bool = False


# --- the names under which columns are looked for, role by role (docs/instruments.md lists them) -----
#
# A name counts where it is a column's whole name or, failing that, one of its words; a letter only as the
# whole name. Of what is found this way, columns are left out whose unit measures something else, or that a
# word such as ``target`` gives another role.

TIME_NAMES = ("time", "t", "x_value", "zeit")  # x_value: what LabVIEW writes
# Names below are those of the manuals and files in docs/instruments.md, in the languages of their software.
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
_PLACES = frozenset(("length", "angle", "voltage", "share", "count"))  # a sensor may well give volts

VOLTAGE = ColumnWish(
    None,
    ("voltage", "drive", "command", "u", "v", "volt", "volts", "spannung", "steuerspannung", "piezospannung",
     "stellspannung", "voltaje", "tensione", "tensão", "tensao", "spanning", "spänning",
     "napięcie", "napiecie", "napětí", "напряжение", "电压", "電圧", "vpiezo", "upiezo", "vdrive", "vpzt"),
    kinds=frozenset(("voltage", "share", "count")),
    contrary=frozenset(("sensor", "position", "displacement", "feedback", "photodiode", "interferometer",
                        "supply")),
    by_unit=("tension", "piezo", "pzt", "control", "vin", "uin", "ch"),
    channel_kinds=frozenset(("voltage",)),
)  # fmt: skip
DISPLACEMENT = ColumnWish(
    None,
    ("displacement", "position", "measured", "sensor", "y", "disp", "pos", "weg", "auslenkung",
     "verschiebung", "hub", "istposition", "deplacement", "déplacement", "desplazamiento", "spostamento",
     "posición", "posizione", "verplaatsing", "przemieszczenie", "перемещение", "位移", "変位", "deflection",
     "stroke", "elongation", "interferometer", "encoder", "capacitive", "lvdt"),
    letters=("x", "z"),
    kinds=_PLACES,
    contrary=_ORDERS,
    by_unit=("actual", "current", "ist", "istwert", "feedback", "readback", "laser", "ldv", "vibrometer",
             "meas", "travel", "ch"),
    channel_kinds=frozenset(("length", "angle")),
)  # fmt: skip
DESIRED = ColumnWish(
    None,
    ("desired", "reference", "setpoint", "target", "trajectory", "wanted", "ref", "soll", "sollwert",
     "sollposition", "sollweg", "consigne", "demand", "commanded"),
    kinds=_PLACES,
    by_unit=("command",),
    channel_kinds=frozenset(("length", "angle")),
)  # fmt: skip
TRAJECTORY = replace(
    DISPLACEMENT,
    guesses=(*DISPLACEMENT.guesses, *DESIRED.guesses),
    contrary=frozenset(),
    by_unit=(*DESIRED.by_unit, *DISPLACEMENT.by_unit),
    preferred=DESIRED.guesses,
)
ROLES = {
    "voltage": VOLTAGE, "displacement": DISPLACEMENT, "measured": DISPLACEMENT, "desired": DESIRED,
    "trajectory": TRAJECTORY,
}  # fmt: skip


def wish(
    role: str,
    selector: str | None = None,
    *,
    option: str = "column",
    quantity: str | None = None,
    unit: str | None = None,
    required: bool = True,
    may_be_blank: bool = False,
) -> ColumnWish:
    """Wish for the column of a role.

    Parameters
    ----------
    role
        ``voltage``, ``displacement``, ``measured``, ``desired``, ``trajectory`` (a displacement that may be
        called desired), or a quantity with no names but its own.
    selector
        What the user named, or None to guess.
    option
        The parameter that messages name.
    quantity, unit
        What a model calls the quantity, and its unit: a column in a unit of that kind is not left out.
    required
        Whether its absence is an error.
    may_be_blank
        Whether rows without a value are left out.
    """
    own, kind = (quantity or role).lower(), kind_of_unit(unit)
    known = ROLES.get(role)
    if known is None:
        kinds = None if kind is None else frozenset((kind,))
        return ColumnWish(selector, (own,), required, option, kinds=kinds, may_be_blank=may_be_blank)
    others = frozenset(name for other in ROLES.values() for name in other.guesses)
    return replace(
        known,
        selector=selector,
        guesses=(own, *(name for name in known.guesses if name != own)) if quantity else known.guesses,
        required=required,
        option=option,
        kinds=(known.kinds or frozenset()) | ({kind} if kind else set()),
        foreign=others - frozenset(known.guesses),
        may_be_blank=may_be_blank,
    )


# --- headers -----------------------------------------------------------------------------------------


def split_header(header: str) -> tuple[str, str | None]:
    """Split a header cell into its quantity and its normalised unit (or None)."""
    text = " ".join(header.split())
    found = _BRACKETED.match(text)
    if found and found["quantity"] and not is_torn(text):
        inner = found["unit"].strip().lower()
        symbol = _SYMBOL.fullmatch(text) and not is_known_unit(found["unit"])
        if symbol or _INDEX.fullmatch(inner) or inner in _REMARKS:
            return text, None
        return found["quantity"].strip().rstrip("_,"), normalise_unit(found["unit"])
    for written in (_SLASHED, _SUFFIXED):
        found = written.match(text)
        if found is None or found["unit"].strip("[](){}<>") != found["unit"]:  # half a bracket is no unit
            continue
        quantity, unit = found["quantity"].strip(), found["unit"]
        apart = _PREFIXED.fullmatch(quantity)
        if apart is not None:  # milli volts
            quantity, unit = apart["quantity"].rstrip(" /"), apart["prefix"] + unit
        if is_known_unit(unit) and quantity.lower() not in _LETTERED:
            return quantity, normalise_unit(unit)
    return text, None


def is_torn(text: str) -> bool:
    """Return whether brackets do not fit, or a # stands for a letter of the unit: it is not clear."""
    unlike = any(text.count(left) != text.count(right) for left, right in ("()", "[]", "{}"))
    return unlike or _HASHED.search(text) is not None


def column_info(header: str | None, number: int, unit: str | None = None) -> ColumnInfo:
    """Describe column ``number`` (from 1) by its header cell; a unit given apart (units line) goes first."""
    header, unit = cleaned(header or ""), cleaned(unit or "")  # no command for a terminal, no half a letter
    if header[:1] == "'" and header[1:2] in ("=", "+", "-", "@"):
        header = header[1:]  # what keeps a spreadsheet from taking it for a formula
    if not header:
        return ColumnInfo(str(number), normalise_unit(unit or ""), "", number)
    quantity, own = split_header(header)
    bare = header.strip(" /_")  # "/nm": the name is lost
    if own is None and bare != "m" and kind_of_unit(normalise_unit(bare)) in _NAMING:
        own = normalise_unit(bare)
    return ColumnInfo(header, normalise_unit(unit or "") or own, quantity, number)


def contradicted_unit(column: ColumnInfo) -> str | None:
    """Return the unit that a column's name states where it is another than the one it was given apart."""
    own = split_header(column.name.rsplit("/", 1)[-1])[1] if column.quantity else None
    known = own is not None and column.unit is not None and is_known_unit(own)
    return own if known and own != column.unit else None


def column_label(column: ColumnInfo) -> str:
    """Name a column in a message: ``column 'voltage_V'``, or ``column 2`` where the log has no header."""
    return f"column '{column.name}'" if column.quantity else f"column {column.number}"


def list_columns(columns: Sequence[ColumnInfo]) -> str:
    """List the columns of a log for an error message, shortened when there are many."""
    if not any(column.quantity for column in columns):
        return f"it has {counted(len(columns), 'column')} without names"
    shown = [f"{one.number} {one.name}" if one.quantity else str(one.number) for one in columns[:_LISTED]]
    more = f", … ({len(columns)} in all)" if len(columns) > _LISTED else ""
    return f"it has {', '.join(shown)}{more}"


def any_of(names: Sequence[str]) -> str:
    """List what may be meant for an error message, shortened when there is much."""
    more = f" or … ({len(names)} in all)" if len(names) > _LISTED else ""
    return " or ".join(names[:_LISTED]) + more


def find_column(place: str, columns: Sequence[ColumnInfo], selector: str, option: str) -> ColumnInfo:
    """Find the column that the user named, or gave a part of the name with ``*`` for the rest.

    Raises
    ------
    InputError
        The name is absent or occurs more than once, or the number is past the end.
    UsageError
        The number is 0 or negative.
    """
    how, given, rest = selector.partition("=")
    how = how if given and how in ("number", "name") else ""
    selector = rest if how else selector
    if re.fullmatch(r"[+-]?\d{1,15}", selector) and how != "name":
        number = int(selector)
        if not how:
            _ask_about_number(place, columns, selector, option)
        if number < 1:
            raise UsageError(f"`{option}` {selector}: columns are counted from 1")
        if number > len(columns):
            has = counted(len(columns), "column")
            raise InputError(f"{place}: there is no column {number}: it has {has}")
        return columns[number - 1]
    wanted = cleaned(selector)
    named = [(one, " ".join(one.name.split()), one.quantity) for one in columns if one.quantity]
    for found in (
        [column for column, name, _ in named if name == wanted],
        [column for column, name, _ in named if name.lower() == wanted.lower()],
        [column for column, _, quantity in named if quantity.lower() == wanted.lower()],
    ):
        if len(found) == 1:
            return found[0]
        if found:
            numbers = any_of([str(column.number) for column in found])
            raise InputError(
                f"{place}: column '{selector}' occurs more than once: give its number (`{option}` {numbers})"
            )
    fitting = [column for column, name, _ in named if fits_pattern(name, wanted)]
    if len(fitting) > 1:
        names = any_of([f"'{column.name}'" for column in fitting[:3]])
        raise InputError(
            f"{place}: `{option}` {selector} fits {len(fitting)} columns: {names}? (give more of it)"
        )
    if fitting:
        return fitting[0]
    raise InputError(f"{place}: there is no column '{selector}': {list_columns(columns)}")


def fits_pattern(name: str, pattern: str) -> bool:
    """Tell whether a name is what a pattern with ``*`` for any letters asks for, capitals aside."""
    parts = map(re.escape, pattern.split("*"))
    return "*" in pattern and re.fullmatch(".*".join(parts), name, re.IGNORECASE | re.DOTALL) is not None


def _ask_about_number(place: str, columns: Sequence[ColumnInfo], selector: str, option: str) -> None:
    """Refuse a number that is the name of another column than the one at that place (InputError)."""
    number = int(selector)
    named = [one for one in columns if one.quantity and one.name.strip() == selector]
    if any(one.number != number for one in named) and 1 <= number <= len(columns):
        raise InputError(
            f"{place}: `{option}` {selector}: column {selector}, '{columns[number - 1].name}', or column "
            f"{named[0].number}, which is named '{selector}'? "
            f"(`{option}` number={selector} or name={selector})"
        )


def guess_columns(columns: Sequence[ColumnInfo], guesses: Sequence[str]) -> list[ColumnInfo]:
    """Find the columns whose quantity is one of ``guesses``, or else contains one as a word."""
    exact = [column for column in columns if column.quantity.lower() in guesses]
    return exact or [column for column in columns if set(_words(column.quantity)) & set(guesses)]


def matching_columns(columns: Sequence[ColumnInfo], wish: ColumnWish) -> list[ColumnInfo]:
    """Find the columns that a wish may mean: by name, by word, by letter, or by a lesser name and the unit.

    What is found by less than a whole name, or by a letter beside other axes' letters, has to stand alone:
    beside it, whatever has a unit of the kind
    that is looked for may be meant as well, and so may a name that is only misspelled. Where the only column
    of a name is in a unit that cannot be meant, no lesser name is taken in its place.
    """
    fitting = [column for column in columns if may_be(column, wish)]
    preferred = guess_columns(fitting, wish.preferred)
    found = preferred or guess_columns(fitting, wish.guesses)
    whole = [column for column in found if column.quantity.lower() in wish.guesses]
    sure = bool(found) and all(_is_sure(column, wish) for column in found)
    measuring = [one for one in fitting if kind_of_unit(one.unit) in wish.channel_kinds]
    letters = [column for column in fitting if column.quantity.lower() in wish.letters]
    axes = any(len(one.quantity) == 1 for one in found) and any(one in measuring for one in letters)
    if preferred or not wish.channel_kinds or (sure and len(whole) == len(found) and not axes):
        return found
    if sure:
        meant = {*found, *_misspelled(fitting, wish), *(set(letters) & set(measuring))}
        return [column for column in fitting if column in meant]
    lesser = [column for column in measuring if _has_lesser_name(column, wish)]
    if not (found or letters or lesser) or (not found and guess_columns(columns, wish.guesses)):
        return []
    slips = _misspelled(fitting, wish)
    if not whole:
        slips += _suspects(fitting, wish, bool(found), [*letters, *lesser])
    meant = {*found, *letters, *measuring, *slips}
    return [column for column in fitting if column in meant]


def _is_sure(column: ColumnInfo, wish: ColumnWish) -> bool:
    """Return whether a column was found by a whole name, or by a word and a unit of the right kind."""
    kind = kind_of_unit(column.unit)
    whole = len(column.quantity) > 1 and column.quantity.lower() in wish.guesses
    return kind in wish.channel_kinds or (whole and kind is None)


def _misspelled(columns: Sequence[ColumnInfo], wish: ColumnWish) -> list[ColumnInfo]:
    """Find the columns of which a word is a long name but for one letter."""
    names = [name for name in wish.guesses if len(name) >= 4]

    def is_slip(column: ColumnInfo) -> bool:
        words = {*_words(column.quantity), *re.findall(r"[^\W_]+", column.quantity.lower())} - wish.foreign
        return any(_one_letter_off(word, name) for word in words for name in names)

    return [column for column in columns if is_slip(column)]


def _suspects(
    fitting: Sequence[ColumnInfo], wish: ColumnWish, found: bool, others: Sequence[ColumnInfo]
) -> list[ColumnInfo]:
    """Find what may be meant beside a column that has no whole name: names run together, letters in words.

    Where no unit supports what was found by a lesser name, any column of an unknown name may be meant.
    """
    sure = found or all(kind_of_unit(column.unit) in wish.channel_kinds for column in others)
    long_names = [name for name in wish.guesses if len(name) >= 4]
    return [
        column
        for column in fitting
        if any(name in _letters(column) for name in long_names)  # positionmm, Posi)tion
        or any(_letters(column).startswith(name) for name in wish.guesses if len(name) == 3)  # Wegccm
        or _runs_into_unit(column, wish)
        or (column.unit is None and is_torn(column.quantity))  # nothing of the name is left: ) (mm)
        or set(_words(column.quantity)) & set(wish.letters)
        or (not sure and column.unit is None and _is_unknown(column, wish))
    ]


def _letters(column: ColumnInfo) -> str:
    return "".join(re.findall(r"[^\W_]+", column.quantity.lower()))


def _runs_into_unit(column: ColumnInfo, wish: ColumnWish) -> bool:
    """Return whether a name and a unit of the right kind stand without anything between them: Wegµm."""
    word = _letters(column)
    ends = [word[len(name) :] for name in (*wish.guesses, *wish.letters) if word.startswith(name)]
    return any(kind_of_unit(normalise_unit(end)) in wish.channel_kinds for end in ends if end)


def _is_unknown(column: ColumnInfo, wish: ColumnWish) -> bool:
    """Return whether nothing is known of a column's name: no other role's, and no mere number or flag."""
    words = set(_words(column.quantity))
    return bool(words) and not words & (wish.foreign | _BESIDES)


def _one_letter_off(one: str, other: str) -> bool:
    """Return whether two words of three letters or more differ by one: put in, left out, changed, swapped."""
    if abs(len(one) - len(other)) > 1 or (one[0] != other[0] and one[-1] != other[-1]):
        return False  # the usual case; one slip leaves the first or the last letter
    short, long = sorted((one, other), key=len)
    same = next((k for k, letter in enumerate(short) if letter != long[k]), len(short))
    if len(short) < len(long):
        return short[same:] == long[same + 1 :]
    rest = one[same + 1 :], other[same + 1 :]
    swapped = one[same : same + 2] == other[same : same + 2][::-1] and rest[0][1:] == rest[1][1:]
    return one != other and (rest[0] == rest[1] or swapped)


def _has_lesser_name(column: ColumnInfo, wish: ColumnWish) -> bool:
    words = set(_words(column.quantity))
    if words & set(wish.by_unit) and not words & {"monitor", "mon"}:  # a monitor has a scale of its own
        return True
    if "ch" not in wish.by_unit:
        return False
    return bool(_CHANNEL.fullmatch(column.quantity.strip())) or normalise_unit(column.quantity) == column.unit


def may_be(column: ColumnInfo, wish: ColumnWish) -> bool:
    """Return whether nothing in a column's unit and words speaks against a wish."""
    kind = kind_of_unit(column.unit)
    unlike = wish.kinds is not None and kind is not None and kind not in wish.kinds
    return column.written == "numbers" and not unlike and not wish.contrary & set(_words(column.name))


def _words(quantity: str) -> list[str]:
    return [word.lower() for word in re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", quantity))]


def choose_columns(
    place: str,
    columns: Sequence[ColumnInfo],
    want: Mapping[str, ColumnWish],
    taken: Sequence[ColumnInfo] = (),
    timed: bool = True,
    notes: list[str] | None = None,
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
    timed
        Whether the samples' time is known; else the remedy names a time column, too.
    notes
        Takes what is to be said of columns that were taken for their unit or place alone.

    Raises
    ------
    InputError
        A named column is absent, or a guess finds none or several.
    """
    chosen = {}
    for role, wish in want.items():
        if wish.selector is not None:
            chosen[role] = find_column(place, columns, wish.selector, wish.option)
    missing: dict[str, list[ColumnInfo]] = {}
    used = {column.number for column in [*taken, *chosen.values()]}
    free = [column for column in columns if column.number not in used]
    for role, wish in want.items():
        if wish.selector is not None:
            continue
        found = matching_columns(free, wish)
        if not found and len(want) == 1 and len(free) == 1 and wish.required:  # the only one left is meant
            found = [one for one in free if may_be(one, wish) and one.quantity.lower() not in wish.foreign]
        if not found and wish.required and notes is not None and role in ("voltage", "displacement"):
            found, why = _only_one(free, columns, wish)
            notes.extend(
                f"{place}: '{one.name}' is taken for the {role}: {why} (`{wish.option}` names another)"
                for one in found
            )
        if len(found) == 1:
            chosen[role] = found[0]
            free = [column for column in free if column.number != found[0].number]
        elif found or wish.required:
            missing[role] = found
    if missing:
        raise InputError(_not_unique(place, columns, want, missing, [one.number for one in free], timed))
    return {
        role: replace(chosen[role], may_be_blank=want[role].may_be_blank) for role in want if role in chosen
    }


def _only_one(
    free: Sequence[ColumnInfo], columns: Sequence[ColumnInfo], wish: ColumnWish
) -> tuple[list[ColumnInfo], str]:
    """Find a column that no name gives away: the only one in a unit of the kind, or a card's only channel.

    Not beside a column of the right name whose unit cannot be meant, nor one whose name says something else;
    a monitor has a scale of its own. Of a data acquisition card, ao drives and ai measures (no trajectory).
    """
    if guess_columns(columns, wish.guesses):
        return [], ""
    told = wish.foreign | _BESIDES | _READINGS
    measuring = [one for one in free if may_be(one, wish) and kind_of_unit(one.unit) in wish.channel_kinds]
    if len(measuring) == 1 and not told & set(_words(measuring[0].quantity)):
        return measuring, f"no other column is in a unit of {kind_of_unit(measuring[0].unit)}"
    own = "ao" if "voltage" in wish.channel_kinds else "ai"
    card = {one.number: _CARD.search(one.quantity.strip()) for one in columns if one.unit is None}
    found = [one for one in free if (match := card.get(one.number)) is not None and match[1].lower() == own]
    outputs = [match for match in card.values() if match is not None and match[1].lower() == "ao"]
    only = len(found) == 1 and len(outputs) == 1 and not measuring and not wish.preferred
    return (found, f"the only analog {'output' if own == 'ao' else 'input'}") if only else ([], "")


def _not_unique(
    place: str,
    columns: Sequence[ColumnInfo],
    want: Mapping[str, ColumnWish],
    missing: Mapping[str, Sequence[ColumnInfo]],
    free: Sequence[int],
    timed: bool,
) -> str:
    """Ask for every role at once which columns may be meant, or that none is, and how to choose."""
    calls = {role: f"{role} signal" if role in ("desired", "measured") else role for role in missing}
    if not any(column.quantity for column in columns) and len(free) >= len(missing):
        options = [want[role].option for role in missing]
        options = ["time", *options] if not timed and len(free) > len(missing) else options
        example = " ".join(f"`{option}` {number}" for option, number in zip(options, free, strict=False))
        which = ", which the ".join(calls.values())
        return f"{place}: {list_columns(columns)}: which is the {which}? (such as {example})"
    questions, absent = [], []
    for role, found in missing.items():
        if found:
            names = any_of([f"'{column.name}'" for column in found])
            questions.append(f"which column is the {calls[role]}, {names}?")
            continue
        wanted = next((one.name for one in columns if is_order(one, want[role])), None)
        order = f": '{wanted}' is what was wanted, not what was measured (play the drive and record the "
        absent.append(calls[role] + (f"{order}sensor beside it)" if wanted is not None else ""))
    if absent:
        nothing = f"no column is recognised as the {' nor as the '.join(absent)}"
        questions.append(f"{nothing}: {list_columns(columns)}")
    options = [f"`{want[role].option}`" for role in missing]
    return f"{place}: {' '.join(questions)} (choose with {' and '.join(options)} NAME or NUMBER)"


def is_order(column: ColumnInfo, wish: ColumnWish) -> bool:
    """Return whether a column says what was wanted, where what was measured is looked for."""
    unit_fits = wish.kinds is None or column.unit is None or kind_of_unit(column.unit) in wish.kinds
    return "desired" in wish.contrary and unit_fits and bool(wish.contrary & set(_words(column.name)))


# --- columns that are written ---------------------------------------------------------------------------


@dataclass(frozen=True)
class OutColumn:
    """A column to be written: name, unit, and what it measures (for HDF5 alone; the name by default).

    NaN in a column that ``may_be_blank`` is written as an empty cell (HDF5: as NaN).
    """

    name: str
    unit: str | None = None
    quantity: str | None = None
    may_be_blank: bool = False

    @property
    def header(self) -> str:
        """The header cell, ``voltage_V``; a unit that no reader would know stands in brackets."""
        name, unit = cleaned(self.name), cleaned(self.unit or "")
        if not unit or split_header(name)[1] == unit:
            return name
        return f"{name}_{unit}" if is_known_unit(unit) else f"{name} ({unit})"


def unique_headers(columns: Sequence[OutColumn]) -> list[str]:
    """Return the headers of a table; the second column of a name is called ``name_2``."""
    headers: list[str] = []
    for column in columns:
        header, number = column.header, 2
        while header in headers:
            header, number = f"{column.header}_{number}", number + 1
        headers.append(header)
    return headers


def require_finite(columns: Sequence[OutColumn], headers: Sequence[str], arrays: Sequence[ArrayLike]) -> None:
    """Refuse to write NaN or infinity: the model or the signal is beyond the range of the arithmetic.

    Raises
    ------
    OutputError
        An array holds one, and it is no NaN of a column that may be blank; its header is named.
    """
    for column, header, array in zip(columns, headers, arrays, strict=True):
        good = np.isfinite(array)
        if not (good.all() or (column.may_be_blank and (good | np.isnan(array)).all())):
            raise OutputError(
                f"column '{header}' would hold a number that is not finite: the model or the signal is "
                "beyond the range of the arithmetic"
            )


PLACE = pattern(r"\{(?:channel)?\}")
"""Stands in the name of a column for the name of each of many channels."""


def is_pattern(selector: str | None) -> bool:
    """Tell whether the name of a column stands for many."""
    return selector is not None and PLACE.search(selector) is not None
