"""By what the figures of a column are multiplied, so that they are in the unit that is wanted."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.table import Column
from dbo_cli.units import (
    parse_unit,
    ratio,
    spell,
    split_header,
    units_in,
    warn_unstated,
)

ColumnScale = tuple[Fraction, str | None]  # a factor, and the unit behind it

_FACTOR = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:([^\s/\d.][^\s/]*)\s*/\s*([^\s/]+))?\s*",
    re.ASCII,
)


def scales_of(
    name: str,
    columns: Mapping[str, Column],
    factors: Mapping[str, str | float],
    units: Mapping[str, str | None],
) -> dict[str, ColumnScale]:
    """Return the scale of every role: what the user types, then the unit that is wanted.

    Raises
    ------
    InputError
        A unit cannot be converted.
    UsageError
        A scale is typed for a role that is absent, or it is malformed.
    """
    for role in factors:
        if role not in columns:
            raise UsageError(f"`scale` {role}=...: give one of {', '.join(columns)}")
    scales = {}
    for role, column in columns.items():
        if role in factors:
            factor, unit = _typed_scale(name, role, column, str(factors[role]))
        else:
            _refuse_unclear_unit(name, role, column)
            factor, unit = Fraction(1), column.unit
        target = units.get(role)
        if role in units:
            warn_unstated(f"{name}: {column.label}", unit, target)
        if target is not None:
            try:
                factor *= ratio(unit, target)
            except InputError:
                raise InputError(
                    f"{name}: {column.label} is in {unit}, not {target}: add `scale` "
                    f"{role}=FACTOR{target}/{unit}"
                ) from None
            unit = spell(target)
        scales[role] = factor, unit
    return scales


def _typed_scale(name: str, role: str, column: Column, text: str) -> ColumnScale:
    """Return the scale that the user types: ``20``, or ``10um/V``."""
    match = _FACTOR.fullmatch(text)
    if match is None or not 0.0 < abs(float(match[1])) < 1e250:
        raise UsageError(
            f"`scale` {role}={text}: give a factor other than 0, such as 20 or 10um/V"
        )
    factor, after, before = Fraction(match[1]), match[2], match[3]
    if after is None:
        return factor, column.unit
    try:
        return factor * ratio(column.unit, before), spell(after)
    except InputError:
        raise InputError(
            f"{name}: {column.label} is in {column.unit}, `scale` {role}={text} expects {before}"
        ) from None


def _refuse_unclear_unit(name: str, role: str, column: Column) -> None:
    """Refuse a unit whose capitals are those of the name (``VOLTAGE (MV)``), and several units."""
    unit = column.unit or ""
    spellings = sorted(units_in(column.name)) if parse_unit(unit) is None else []
    if unit in ("MV", "Mv"):
        spellings = ["mV", "MV"]
    if unit in ("MM", "Mm"):
        spellings = ["mm", "Mm"]
    camel = re.search(r"[a-z]([KMN][mv]|Uv)$", column.name)
    if camel and not unit:  # VoltageMv
        spellings = [camel[1].lower().replace("v", "V"), camel[1]]
    bare = column.name if re.search(r"[\[(]", column.name) is None else ""
    amounts = re.findall(r"(?<!\S)\d[\d.,]*(?:\s+(\S+)|$)", bare)  # at 100 V, kV x 1000
    for amount in amounts if split_header(bare)[1] == unit else ():
        if spell(amount) in (unit, None):
            raise InputError(
                f"{name}: is {column.label} in {unit}? add `scale` {role}=FACTORUNIT/{unit}"
            )
    if len(spellings) > 1:
        raise InputError(
            f"{name}: {column.label} may be in {' or '.join(spellings)}: add `scale` "
            f"{role}=1{spellings[0]}/{unit or spellings[0]}"
        )
