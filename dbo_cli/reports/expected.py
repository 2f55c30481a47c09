"""What error was to be expected of a log: from a model, or from a summary of ``compensate``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import InputError

if TYPE_CHECKING:
    from dbo_cli.model import Model
    from dbo_cli.reports.merits import Floats

SAME_MOVE = 0.01
"""Part of the move by which the ends of a summary's move may differ from the log's."""
SLACK = 1e-9
"""Part of the range that rounding may add to a drive which ends at its limit."""

Ends = tuple[float, float]


@dataclass(frozen=True)
class Expected:
    """What error was to be expected; lengths in the report's unit.

    Attributes
    ----------
    rmse
        The expected error (RMS); None where it is not known.
    move
        Least and greatest desired value of the move it is stated for; None: any move.
    move_time
        First and last time (s) of the move in its drive; None where they are not known.
    footer
        What the page says of the drive.
    """

    rmse: float | None
    move: Ends | None = None
    move_time: Ends | None = None
    footer: str = ""

    def is_of(self, low: float, high: float) -> bool:
        """Return whether it is stated for a move of this range."""
        if self.move is None:
            return True
        slack = SAME_MOVE * (high - low)
        return abs(self.move[0] - low) <= slack and abs(self.move[1] - high) <= slack


def expected_of_drive(
    model: Model, voltage: Floats, dt: Floats | None, name: str
) -> Expected:
    """Return what a model states for this very drive; unknown where the drive leaves its range.

    Parameters
    ----------
    model
        Forward.
    voltage : array of shape (rows,)
        In the model's unit.
    dt : array of shape (rows,), optional
        Seconds since the row before.
    name
        How the report calls the model.
    """
    from dbo_cli.model.expect import expected_error

    slack = SLACK * model.input.span
    low, high = float(voltage.min()), float(voltage.max())
    rmse = None
    if model.input.min - slack <= low and high <= model.input.max + slack:
        rmse = expected_error(model, voltage, dt)
    footer = f"Model {name} ({model.digest[:12]})"
    return Expected(rmse, footer=footer)


def expected_in(path: str | os.PathLike[str], unit: str | None = None) -> Expected:
    """Return the expected error that a summary of ``compensate`` or a model file states.

    Parameters
    ----------
    path
        The file.
    unit
        Of what is compared.

    Raises
    ------
    InputError, ModelError
        It is neither, or it is in another unit.
    """
    from dbo_cli.model import read_model

    name = os.fspath(path)
    try:
        content = json.loads(Path(name).read_text("utf-8"))
        kind = content.get("format")
    except (OSError, ValueError, AttributeError, RecursionError) as problem:
        reason = getattr(problem, "strerror", None) or "no JSON object"
        raise InputError(f"{name}: {reason}") from None
    if kind == "dbo-model":
        model = read_model(name).forward()
        rmse, stated_unit = model.fit.get("expected_rmse"), model.output.unit
        expected = Expected(rmse)
    elif kind == "dbo-summary":
        stated_unit = content.get("unit")
        expected = _of_summary(name, content)
    else:
        raise InputError(
            f"{name}: states no expected error: give a summary of compensate, or a model"
        )
    if stated_unit and unit and stated_unit != unit:
        raise InputError(f"{name}: is in {stated_unit}, the comparison in {unit}")
    return expected


def _of_summary(name: str, content: Mapping[str, Any]) -> Expected:
    rmse = content.get("expected_rmse")
    if rmse is not None and (type(rmse) not in (int, float) or not rmse > 0.0):
        raise InputError(f"{name}: expected_rmse: {rmse!r} is not above 0")
    move, move_time = (_ends(name, content, key) for key in ("move_range", "move_time"))
    limits = content.get("limits") or {}
    footer, rating = "", _ends(name, limits, "rating")
    if rating is not None:
        unit = limits.get("unit") or ""
        footer = f"Limits {rating[0]:g} to {rating[1]:g} {unit}"
        if limits.get("max_slew"):
            footer += f", {limits['max_slew']} {unit}/s"
        footer += f"; drive of model {str(content.get('model'))[:12]}"
    return Expected(rmse, move, move_time, footer)


def _ends(name: str, content: Mapping[str, Any], key: str) -> Ends | None:
    """Return the two ends of a range; None where there is none."""
    value = content.get(key)
    if value is None:
        return None
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low <= high:
        raise InputError(f"{name}: {key}: {value!r} is not [least, greatest]")
    return low, high
