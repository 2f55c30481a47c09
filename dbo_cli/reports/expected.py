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


@dataclass(frozen=True)
class Expected:
    """What error was to be expected; lengths in the report's unit.

    Attributes
    ----------
    rmse
        The expected error (RMS); None where it is not known.
    span
        Range of the model's output; None where it is not known.
    source
        Who says so.
    move
        Least and greatest desired value of the move it is stated for; None: any move.
    """

    rmse: float | None
    span: float | None
    source: str
    move: tuple[float, float] | None = None

    def is_of(self, low: float, high: float) -> bool:
        """Return whether it is stated for a move of this range."""
        if self.move is None:
            return True
        slack = SAME_MOVE * (high - low)
        return abs(self.move[0] - low) <= slack and abs(self.move[1] - high) <= slack


def expected_of_drive(
    model: Model, voltage: Floats, dt: Floats | float | None, name: str
) -> Expected:
    """Return what a model states for this very drive; unknown where the drive leaves its range.

    Parameters
    ----------
    model
        Forward.
    voltage : array of shape (rows,)
        In the model's unit.
    dt
        Seconds since the row before; None: no clock.
    name
        How the report calls the model.
    """
    from dbo_cli.model.expect import expected_error

    span = float(model.output.span)
    slack = SLACK * model.input.span
    low, high = float(voltage.min()), float(voltage.max())
    rmse = None
    if model.input.min - slack <= low and high <= model.input.max + slack:
        rmse = expected_error(model, voltage, dt)
    return Expected(rmse, span, f"{name} for this drive")


def expected_in(
    source: str | os.PathLike[str] | Mapping[str, Any], unit: str | None = None
) -> Expected:
    """Return the expected error that a summary of ``compensate`` or a model file states.

    Parameters
    ----------
    source
        A file name, or what is in it.
    unit
        Of what is compared.

    Raises
    ------
    InputError
        It is neither, or it is in another unit.
    """
    if isinstance(source, Mapping):
        name, content = "expected", dict(source)
    else:
        name = os.fspath(source)
        content = _read(name)
    kind = content.get("format")
    if kind == "dbo-summary":
        stated_unit = content.get("unit")
        move = _ends(name, content.get("move_range"))
        rmse = _error(name, content.get("expected_rmse"))
        expected = Expected(rmse, None, f"{name} for its move", move)
    elif kind == "dbo-model":
        output = content.get("output", {})
        stated_unit = output.get("unit")
        rmse = _error(name, content.get("fit", {}).get("expected_rmse"))
        ends = _ends(name, [output.get("min"), output.get("max")])
        span = ends[1] - ends[0] if ends else None
        expected = Expected(rmse, span, f"{name} for any move in its range")
    else:
        raise InputError(
            f"{name}: states no expected error: give the `summary` of compensate, or a model"
        )
    if stated_unit and unit and stated_unit != unit:
        raise InputError(f"{name}: is in {stated_unit}, the comparison in {unit}")
    return expected


def _read(name: str) -> dict[str, Any]:
    try:
        content = json.loads(Path(name).read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as problem:
        reason = getattr(problem, "strerror", None) or "it is not JSON"
        raise InputError(
            f"{name}: cannot be read as a summary or a model: {reason}"
        ) from None
    if not isinstance(content, dict):
        raise InputError(f"{name}: is neither a summary nor a model")
    return content


def _error(name: str, value: object) -> float | None:
    """Return a stated error, None where there is none (InputError: it is no number above 0)."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name}: expected_rmse is {value!r}, and not a number")
    if not 0.0 < value < math.inf:
        raise InputError(f"{name}: expected_rmse is {value!r}, and not above 0")
    return float(value)


def _ends(name: str, value: object) -> tuple[float, float] | None:
    """Return the two ends of a range; None where there is none."""
    if value is None:
        return None
    if isinstance(value, list) and len(value) == 2:
        low, high = value
        numbers = isinstance(low, int | float) and isinstance(high, int | float)
        if numbers and low <= high:
            return float(low), float(high)
    raise InputError(f"{name}: {value!r} is not a range [least, greatest]")
