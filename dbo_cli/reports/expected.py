"""What error was to be expected of a log: from a model, or from a summary of ``compensate``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import InputError
from dbo_cli.files import note_input

if TYPE_CHECKING:
    from dbo_cli.arrays import Floats
    from dbo_cli.model import Cascade

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
    model: Cascade, voltage: Floats, dt: Floats | None, name: str
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


def expected_in(path: str, unit: str | None = None) -> Expected:
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

    note_input(path, "summary")
    try:
        content = json.loads(Path(path).read_text("utf-8"))
        kind = content["format"]
    except OSError as problem:
        raise InputError(f"{path}: {problem.strerror}") from None
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _no_summary(path) from None
    if kind == "dbo-model":
        model = read_model(path).forward()
        content = {"unit": model.output.unit, **model.fit}
    elif kind != "dbo-summary":
        raise _no_summary(path)
    return expected_of(content, unit, path)


def expected_of(
    content: Mapping[str, Any], unit: str | None = None, name: str = "the summary"
) -> Expected:
    """Return the expected error of a summary: ``Drive.summary()``, or what a file of it holds.

    Raises
    ------
    InputError
        It is no summary, or it is in another unit than what is compared.
    """
    stated = content.get("unit")
    if stated and unit and stated != unit:
        raise InputError(f"{name}: is in {stated}, the comparison in {unit}")
    try:
        rmse = content["expected_rmse"]
        limits = content.get("limits")
        return Expected(
            None if rmse is None else float(rmse),
            _ends(content.get("move_range")),
            _ends(content.get("move_time")),
            "" if limits is None else _footer(limits, str(content["model"])),
        )
    except (ValueError, TypeError, KeyError, AttributeError):
        raise _no_summary(name) from None


def _no_summary(name: str) -> InputError:
    return InputError(
        f"{name}: states no expected error: give a summary of compensate, or a model"
    )


def _ends(ends: Any) -> Ends | None:
    """Return the two ends of a range."""
    if ends is None:
        return None
    low, high = map(float, ends)
    return low, high


def _footer(limits: Mapping[str, Any], model: str) -> str:
    """Return what the page says of a drive."""
    unit = limits["unit"] or ""
    low, high = limits["rating"]
    text = f"Limits {low:g} to {high:g} {unit}"
    if limits["max_slew"]:
        text += f", {limits['max_slew']} {unit}/s"
    return f"{text}; drive of model {model[:12]}"
