"""The names under which columns are looked for, role by role (docs/instruments.md lists them).

A name counts where it is a column's whole name or, failing that, one of its words; a letter only as the whole
name. Of what is found this way, columns are left out whose unit measures something else, or that a word such
as ``target`` gives another role.
"""

from __future__ import annotations

from dataclasses import replace

from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.units import kind_of_unit

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
