"""The columns of a log that a use case asks for, what unit they must be in, and the log opened for them."""

from __future__ import annotations

import os
from collections.abc import Sequence

from dbo_cli.drives.learning import Tracked
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import Quantity
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.column_names import wish
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.sample_block import joined
from dbo_cli.logs.sources import Source


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


def short_names(addresses: Sequence[Address]) -> dict[Address, str]:
    """Return the names of logs without their folders, where these differ."""
    short = {one: cleaned(os.path.basename(one.text)) for one in addresses if not one.is_stream}
    return short if len(set(short.values())) == len(short) else {}


def bring_to(source: Source, role: str, wanted: Quantity, model: str) -> None:
    """Take a column in the model's unit: prefixes are converted, unlike units refused (InputError)."""
    source.convert(role, wanted.unit, f"{model} takes {wanted.quantity}")


def tracked_wishes(
    model: ActuatorModel, voltage: str | None = None, measured: str | None = None
) -> dict[str, ColumnWish]:
    """Return the columns of a recording of a pass."""
    return {
        "voltage": quantity_wish(model.input, voltage, option="voltage"),
        "measured": quantity_wish(model.output, measured, option="measured"),
    }


def tracked_of(source: Source, model: ActuatorModel) -> Tracked:
    """Read a recording whole, in the units of the model."""
    bring_to(source, "voltage", model.input, "the model")
    bring_to(source, "measured", model.output, "the model")
    block = joined(list(source.blocks()))
    return Tracked(source.name, block.values["voltage"], block.values["measured"], block.time)
