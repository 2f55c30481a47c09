"""The names under which columns are looked for, role by role (docs/instruments.md lists them).

A name counts where it is a column's whole name or, failing that, one of its words; a letter only as the whole
name. Of what is found this way, columns are left out whose unit measures something else, or that a word such
as ``target`` gives another role.
"""

from __future__ import annotations

from typing import NamedTuple

from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.units import kind_of_unit

TIME_NAMES = ("time", "t", "x_value", "zeit")  # x_value: what LabVIEW writes
MORE_TIME_NAMES = (
    "timestamp", "time_stamp", "timestamps", "elapsed", "seconds", "millis", "micros", "milliseconds",
    "microseconds", "nanoseconds", "msec", "usec", "datetime", "zeitstempel", "uhrzeit", "temps", "tiempo",
    "tempo", "date", "datum", "datenum", "tijd", "tid", "czas", "čas", "cas", "время", "时间", "時間",
    "x-axis",
)  # fmt: skip


class RoleNames(NamedTuple):
    """How the columns of one role are called.

    Attributes
    ----------
    names, letters
        What is looked for; letters only where nothing has a name, and never by themselves as a word.
    kinds
        What the column's unit may measure, where it has one.
    contrary
        Words that give a column another role.
    by_unit
        Names that say too little by themselves: they count with a unit that measures one of
        ``channel_kinds``; ``ch`` stands for all names of channels (``CH1 (V)``).
    """

    names: tuple[str, ...]
    letters: tuple[str, ...]
    kinds: frozenset[str]
    contrary: frozenset[str]
    by_unit: tuple[str, ...]
    channel_kinds: frozenset[str]


_ORDERS = frozenset(
    ("desired", "target", "setpoint", "commanded", "wanted", "demand", "demanded", "reference", "soll",
     "sollwert", "sollposition", "consigne", "command", "nominal", "trajectory")
)  # fmt: skip
_PLACES = frozenset(("length", "angle", "voltage", "share", "count"))  # a sensor may well give volts

VOLTAGE = RoleNames(
    ("voltage", "drive", "command", "u", "v", "volt", "volts", "spannung", "steuerspannung", "piezospannung",
     "stellspannung", "voltaje", "tensione", "tensão", "tensao", "spanning", "spänning",
     "napięcie", "napiecie", "napětí", "напряжение", "电压", "電圧", "vpiezo", "upiezo", "vdrive", "vpzt"),
    (),
    frozenset(("voltage", "share", "count")),
    frozenset(("sensor", "position", "displacement", "feedback", "photodiode", "interferometer", "supply")),
    ("tension", "piezo", "pzt", "control", "vin", "uin", "ch"),
    frozenset(("voltage",)),
)  # fmt: skip
DISPLACEMENT = RoleNames(
    ("displacement", "position", "measured", "sensor", "y", "disp", "pos", "weg", "auslenkung",
     "verschiebung", "hub", "istposition", "deplacement", "déplacement", "desplazamiento", "spostamento",
     "posición", "posizione", "verplaatsing", "przemieszczenie", "перемещение", "位移", "変位", "deflection",
     "stroke", "elongation", "interferometer", "encoder", "capacitive", "lvdt"),
    ("x", "z"),
    _PLACES,
    _ORDERS,
    ("actual", "current", "ist", "istwert", "feedback", "readback", "laser", "ldv", "vibrometer", "meas",
     "travel", "ch"),
    frozenset(("length", "angle")),
)  # fmt: skip
DESIRED = RoleNames(
    ("desired", "reference", "setpoint", "target", "trajectory", "wanted", "ref", "soll", "sollwert",
     "sollposition", "sollweg", "consigne", "demand", "commanded"),
    (),
    _PLACES,
    frozenset(),
    ("command",),
    frozenset(("length", "angle")),
)  # fmt: skip
TRAJECTORY = RoleNames(
    (*DISPLACEMENT.names, *DESIRED.names),
    DISPLACEMENT.letters,
    _PLACES,
    frozenset(),
    (*DESIRED.by_unit, *DISPLACEMENT.by_unit),
    DISPLACEMENT.channel_kinds,
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
    """
    known = ROLES.get(role)
    own = (quantity or role).lower()
    kind = kind_of_unit(unit)
    if known is None:
        kinds = None if kind is None else frozenset((kind,))
        return ColumnWish(selector, (own,), required, option, kinds=kinds)
    return ColumnWish(
        selector,
        (own, *(name for name in known.names if name != own)) if quantity else known.names,
        required,
        option,
        letters=known.letters,
        kinds=known.kinds | ({kind} if kind else set()),
        contrary=known.contrary,
        by_unit=known.by_unit,
        channel_kinds=known.channel_kinds,
        preferred=DESIRED.names if role == "trajectory" else (),
        foreign=frozenset(name for other in ROLES.values() for name in other.names) - frozenset(known.names),
    )
