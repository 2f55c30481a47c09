"""Which column has which role: the one that the user names, else by its name, else by its unit.

Where none or several may be meant, all columns are listed with the complete option to
type. The figures of a column with a role are multiplied so that they are in the unit that
is wanted.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs.table import Column, Table
from dbo_cli.units import (
    DRIVING_KINDS,
    MOVED_KINDS,
    kind_of,
    parse_unit,
    ratio,
    spell,
    split_header,
    split_quantity,
    time_unit,
    units_in,
    value_units_like,
)

_LISTED = 20  # names of columns that a message holds at most
_BESIDE = (
    "temperature temp temperatur température temperatura temperatuur teplota 温度 thermocouple thermistor "
    "status enable"
)
TIME_NAMES = frozenset(
    "time t x_value zeit timestamp time_stamp timestamps elapsed seconds sec secs millis micros milliseconds "
    "microseconds nanoseconds nanosec msec usec nsec sekunden datetime zeitstempel uhrzeit temps tiempo "
    "tempo date datum datenum tijd tid czas čas cas время 时间 時間 x-axis utc ts epoch clock".split()
)
_ORDERS = (
    "desired target setpoint commanded wanted demand demanded reference soll sollwert sollposition consigne "
    "command cmd nominal trajectory"
)
_PLACES = frozenset(("length", "angle", "voltage", "share", "count"))


def _set(words: str) -> frozenset[str]:
    return frozenset(words.split())


@dataclass(frozen=True)
class Role:
    """What is known of the columns of a role.

    Attributes
    ----------
    names
        Names that are enough.
    against
        Words that give a column another role.
    proving
        What its unit measures where the unit alone may be enough.
    more
        What it may measure where no column of the proving kinds is there.
    allowed
        What the unit of a column with a known name may measure.
    preferred
        Names that go before all others.
    """

    names: frozenset[str]
    against: frozenset[str]
    allowed: frozenset[str]
    proving: frozenset[str] = frozenset()
    more: frozenset[str] = frozenset()
    preferred: frozenset[str] = frozenset()


_VOLTAGE = Role(
    names=_set(
        "voltage drive command u v volt volts spannung steuerspannung piezospannung stellspannung voltaje "
        "tensione tensão tensao spanning spänning napięcie napiecie napětí напряжение 电压 電圧 vpiezo "
        "upiezo vdrive vpzt"
    ),
    against=_set(
        "sensor position displacement feedback photodiode interferometer supply "
        + _BESIDE
    ),
    allowed=frozenset(("voltage", "share", "count")),
    proving=frozenset(("voltage",)),
    more=DRIVING_KINDS,
)
_DISPLACEMENT = Role(
    names=_set(
        "displacement position measured sensor y disp pos weg auslenkung verschiebung hub istposition "
        "deplacement déplacement desplazamiento spostamento posición posizione verplaatsing przemieszczenie "
        "перемещение 位移 変位 deflection stroke elongation interferometer encoder capacitive lvdt"
    ),
    against=_set(_ORDERS + " error fehler digits " + _BESIDE),
    allowed=_PLACES,
    proving=frozenset(("length", "angle")),
    more=MOVED_KINDS,
)
_DESIRED = Role(
    names=_set(
        "desired reference setpoint target trajectory wanted ref soll sollwert sollposition sollweg consigne "
        "demand commanded"
    ),
    against=_set(_BESIDE),
    allowed=_PLACES,
)
ROLES = {
    "voltage": _VOLTAGE,
    "displacement": _DISPLACEMENT,
    "measured": _DISPLACEMENT,
    "desired": _DESIRED,
    "trajectory": replace(
        _DISPLACEMENT,
        names=_DISPLACEMENT.names | _DESIRED.names,
        against=_DESIRED.against,
        preferred=_DESIRED.names,
    ),
}
"""``trajectory`` is a displacement that may be called desired."""
KNOWN_NAMES = TIME_NAMES.union(*(role.names for role in ROLES.values()))
"""Words that say what a column is."""


def role_of(role: str, unit: str | None) -> Role:
    """Return what is known of a role's columns; a unit of a model says what they measure.

    ``input`` is a voltage, or a trajectory where the unit is one of length or angle.
    """
    kind = kind_of(unit)
    if role == "input":
        role = "trajectory" if kind in ("length", "angle", *MOVED_KINDS) else "voltage"
    definition = ROLES.get(role)
    if definition is None:
        raise UsageError(f"`{role}`: no such role; give one of {', '.join(ROLES)}")
    if kind is None or kind in definition.allowed:
        return definition
    return replace(
        definition,
        names=definition.names | {kind},
        proving=frozenset((kind,)),
        more=frozenset(),
        allowed=frozenset((kind,)),
    )


def words(name: str) -> set[str]:
    """Return the words of a name in lower case; ``driveVoltage`` has two."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return {word.lower() for word in re.findall(r"[^\W\d_]+", spaced)}


def listing_of(columns: Sequence[Column]) -> str:
    """List columns as messages do."""
    if not any(column.name for column in columns):
        s = "" if len(columns) == 1 else "s"
        return f"it has {len(columns)} column{s} without names"
    shown = []
    for column in columns[:_LISTED]:
        shown.append(f"{column.number} {column.name}".strip())
        if column.kind in ("text", "empty"):
            sample = f": '{column.sample}'" if column.sample else ""
            shown[-1] += f" (no numbers{sample})"
        if column.kind == "stamp":
            shown[-1] += " (dates or clock times)"
    more = f", ... ({len(columns)} in all)" if len(columns) > _LISTED else ""
    return f"it has {', '.join(shown)}{more}"


def named(source: Table, selector: str, option: str) -> Column:
    """Return the column that the user names: by its header, its quantity, its path or its number.

    Raises
    ------
    InputError
        There is none, there are several, or it holds no numbers.
    """
    number = selector.removeprefix("number=")
    matches = _by_name(source.columns, selector) if number == selector else []
    if re.fullmatch(r"0*[1-9]\d{0,8}", number):
        numbered = source.columns[int(number) - 1 : int(number)]
        matches += [column for column in numbered if column not in matches]
    found = None if matches else source.find(selector)
    matches += [] if found is None else [found]
    kinds = ("number", "stamp") if option == "time" else ("number",)
    if len(matches) == 1 and matches[0].kind in kinds:
        return matches[0]
    problem = f"`{option}` {selector} is not one column of numbers:"
    raise _question(source, problem, [option])


def _by_name(columns: Sequence[Column], selector: str) -> list[Column]:
    """Return the columns of a name; else those of a path, a quantity or other capitals."""
    plain = " ".join(selector.split())
    exact = [c for c in columns if plain and " ".join(c.name.split()) == plain]
    if exact:
        return exact
    lower = plain.lower().lstrip("/")
    matches = []
    for column in columns:
        name = " ".join(column.name.split()).lower().lstrip("/")
        if name and lower in (name, name.rsplit("/", 1)[-1], column.quantity.lower()):
            matches.append(column)
    return matches


def choose(
    table: Table,
    roles: Sequence[str],
    picks: dict[str, Column],
    clock_columns: Sequence[Column],
    units: Mapping[str, str | None],
    optional: Sequence[str],
) -> dict[str, Column]:
    """Give every role its column; optional roles take what the required ones leave.

    Parameters
    ----------
    table
        The columns.
    roles
        What columns are wanted for.
    picks
        Those that the user named; receives the others.
    clock_columns
        The columns of the clock.
    units
        What roles are wanted in.
    optional
        Roles that may be absent.

    Raises
    ------
    InputError
        Several columns may be meant for a role, or none; or two roles share one.
    """
    used = [*clock_columns, *picks.values()]
    unclear: list[str] = []
    untyped = [role for role in roles if role not in picks]
    for role in sorted(untyped, key=lambda role: role in optional):
        if role in optional:
            used = [*used, *picks.values()]
        free = [column for column in table.columns if column not in used]
        matches = _candidates(free, role_of(role, units.get(role)))
        if len(matches) == 1:
            picks[role] = matches[0]
        elif role not in optional:
            unclear.append(role)
    columns = list(picks.values())
    shared = [role for role, column in picks.items() if columns.count(column) > 1]
    if shared or unclear:
        problem = f"which column is {' and which '.join(shared or unclear)}?"
        raise _question(table, problem, shared or unclear)
    return {role: picks[role] for role in roles if role in picks}


def _question(table: Table, problem: str, roles: Sequence[str]) -> InputError:
    """Return the refusal that lists all columns, with the options to type; no column is proposed."""
    example = "NAME" if any(column.name for column in table.columns) else "NUMBER"
    # a trajectory is typed as what its file holds
    names = ["desired" if role == "trajectory" else role for role in roles]
    options = " ".join(f"`{name}` {example}" for name in names)
    return InputError(
        f"{table.name}: {problem} {listing_of(table.columns)} (for example {options}); number=N, or "
        f"FILE::COLUMN of another file, are taken, too{table.hint}"
    )


def fitting(columns: Sequence[Column], role: str) -> list[Column]:
    """Return the columns that may have a role and are no time."""
    free = [column for column in columns if not is_time(column)]
    return _candidates(free, role_of(role, None))


def is_time(column: Column) -> bool:
    """Return whether a column is a time by its name or its unit."""
    return bool(words(column.quantity) & TIME_NAMES or time_unit(column.unit))


def _candidates(columns: Sequence[Column], role: Role) -> list[Column]:
    """Return the columns that may have a role, by the surest reason that there is.

    A preferred name; a whole name; a word or a letter of the name, beside which every
    column counts whose unit fits; the unit alone.
    """
    free = [column for column in columns if column.kind == "number"]
    free = [column for column in free if not words(column.name) & role.against]
    kinds = {None, *role.allowed, *role.proving}
    fitting = [column for column in free if kind_of(column.unit) in kinds]
    preferred = [c for c in fitting if words(c.quantity) & role.preferred]
    if preferred:
        return preferred
    exact = [c for c in fitting if c.quantity.lower() in role.names]
    if any(len(c.quantity) > 1 for c in exact):
        return exact
    partial = [c for c in fitting if words(c.quantity) & role.names]
    proved = [c for c in fitting if kind_of(c.unit) in role.proving]
    if partial:
        return [c for c in fitting if c in partial or c in proved]
    if any(words(c.quantity) & role.names for c in free):
        return []  # the column of that name is in a unit that cannot be meant
    return proved or [c for c in free if kind_of(c.unit) in role.more]


# --- the unit that is wanted ---


def scaled_column(
    name: str,
    role: str,
    column: Column,
    scale: Mapping[str, str | float],
    units: Mapping[str, str | None],
) -> Column:
    """Scale a column of a file by what the user types for its role, then to the unit that is wanted.

    Raises
    ------
    InputError
        A unit is not clear, or cannot be converted.
    UsageError
        The scale is malformed.
    """
    factor, unit = Fraction(1), column.unit
    if role in scale:
        factor, unit = _typed_scale(name, role, column, str(scale[role]))
    elif doubt := column.doubt or _doubt_of_unit(column):
        doubt = doubt.replace("ROLE", role)
        raise InputError(f"{name}: {column.label} {doubt}")
    target = units.get(role)
    if role in units and target is None and unit is not None:
        warn(
            f"{name}: {column.label} is in {unit}, model or trajectory states no unit: its numbers are taken "
            "as they are"
        )
    if target is not None:
        try:
            factor *= ratio(unit, target)
        except InputError:
            raise InputError(
                f"{name}: {column.label} is in {unit}, not {target}: add `scale` "
                f"{role}=FACTOR{target}/{unit}"
            ) from None
        unit = spell(target)
    title = column.name or f"column {column.number} ({role})"
    if column.unit and split_header(title)[1] is None:
        title += f" ({column.unit})"
    elif unit and column.unit is None and role not in scale:
        title += f" ({unit} assumed)"
    return replace(column, unit=unit, factor=factor, title=title)


def _typed_scale(
    name: str, role: str, column: Column, text: str
) -> tuple[Fraction, str | None]:
    """Return the factor that the user types, and the unit behind it: ``20``, or ``10um/V``."""
    number, unit = split_quantity(text, "scale")
    after, stroke, before = (unit or "").partition("/")
    if not 0.0 < abs(number) < 1e250 or (unit and not (after and before)):
        raise UsageError(
            f"`scale` {role}={text}: give a factor other than 0, such as 20 or 10um/V"
        )
    factor = Fraction(repr(number))
    if not stroke:
        return factor, column.unit
    try:
        return factor * ratio(column.unit, before), spell(after)
    except InputError:
        raise InputError(
            f"{name}: {column.label} is in {column.unit}, `scale` {role}={text} expects {before}"
        ) from None


def _doubt_of_unit(column: Column) -> str:
    """Return why a column's unit is not clear; empty where it is."""
    units = _units_of(column)
    if len(units) < 2:
        return ""
    return f"may be in {' or '.join(units)}: type `scale` ROLE=1UNIT/{column.unit or units[0]}"


def _units_of(column: Column) -> list[str]:
    """Return the units that a column may be in: one or none where that is clear.

    Several where an amount of its unit stands in its name (``at 100 V``, ``in 1/10 V``,
    ``kV x 1000``), where its capitals are those of the name (``VOLTAGE (MV)``,
    ``DISPLACEMENT_MM``, ``VoltageMv``), and where the name holds several.
    """
    unit, title = column.unit, column.name
    if unit and split_header(title)[1] == unit and not re.search(r"[\[(]", title):
        for amount in re.findall(r"(?<![^\s/*])\d[\d.,]*(?:\s+(\S+)|$)", title):
            if spell(amount) in (unit, None):
                return [unit, "another unit"]
    capitals = unit if unit and re.fullmatch("M[VvMmAaNn]", unit) else None
    if not unit:  # PV is a process value
        written = re.search(r"[\s_/](?!PV$)([A-Z]{2,4})$|[a-z]([KMN][mv]|Uv)$", title)
        capitals = written and (written[1] or written[2])
    if capitals:
        return [*value_units_like(capitals), "another unit"]
    return sorted(units_in(title)) if parse_unit(unit) is None else []
