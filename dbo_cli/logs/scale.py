"""A column with a role: its figures are multiplied so that they are in the unit that is wanted."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs.table import Column
from dbo_cli.units import (
    parse_unit,
    ratio,
    spell,
    split_header,
    split_quantity,
    units_in,
    value_units_like,
)


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
    capitals = unit if unit in ("MV", "Mv", "MM", "Mm") else None
    if not unit:  # PV is a process value
        written = re.search(r"[\s_/](?!PV$)([A-Z]{2,4})$|[a-z]([KMN][mv]|Uv)$", title)
        capitals = written and (written[1] or written[2])
    if capitals:
        return [*value_units_like(capitals), "another unit"]
    return sorted(units_in(title)) if parse_unit(unit) is None else []
