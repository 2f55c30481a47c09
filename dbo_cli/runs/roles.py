"""The columns of a log that a use case asks for, and what unit they must be in."""

from __future__ import annotations

import os
from collections.abc import Sequence

from dbo_cli.errors import InputError
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.logs.column_names import wish
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.runs.source import Source


def quantity_wish(
    quantity: Quantity, selector: str | None = None, *, option: str, trajectory: bool = False
) -> ColumnWish:
    """Return the wish for a model's quantity; a ``trajectory`` of it may also be called desired."""
    role = "trajectory" if trajectory else quantity.quantity
    return wish(role, selector, option=option, quantity=quantity.quantity, unit=quantity.unit)


def recording_wishes(voltage: str | None, displacement: str | None) -> dict[str, ColumnWish]:
    """Return the columns that an identification reads, as named or to be guessed."""
    return {
        "voltage": wish("voltage", voltage, option="voltage"),
        "displacement": wish("displacement", displacement, option="displacement"),
    }


def short_names(addresses: Sequence[str]) -> dict[str, str]:
    """Return the names of logs without their folders, where that tells them apart."""
    short = {address: os.path.basename(address) for address in addresses if address != "-"}
    return short if len(set(short.values())) == len(short) else {}


def check_unit(source: Source, role: str, wanted: Quantity, model: str) -> None:
    """Refuse a column whose unit is known and differs from the model's (InputError)."""
    column = source.columns[role]
    if column.unit is not None and wanted.unit is not None and column.unit != wanted.unit:
        raise InputError(
            f"{source.name}: column '{column.name}' is in {column.unit}, but {model} takes {wanted.quantity} "
            f"in {wanted.unit} (convert the column)"
        )
