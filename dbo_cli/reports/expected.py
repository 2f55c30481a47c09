"""What error was to be expected of a log: from a model, or from a summary of ``compensate``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dbo_cli.errors import InputError, ModelError
from dbo_cli.model import fields

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
    sensor_delay
        Seconds by which the sensor is late, which is no error.
    past_known
        Whether a sweep or a state made the past of the drive known.
    """

    rmse: float | None
    move: Ends | None = None
    move_time: Ends | None = None
    sensor_delay: float = 0.0
    past_known: bool = False


def expected_in(
    source: str | Mapping[str, Any] | None, unit: str | None = None
) -> Expected | None:
    """Return the expected error that a summary of ``compensate`` or a model states; None of none.

    Parameters
    ----------
    source
        The file, ``-`` is standard input; or ``Drive.summary()``.
    unit
        Of what is compared.

    Raises
    ------
    InputError
        It is in another unit than what is compared.
    ModelError
        It is neither, or states no expected error.
    """
    if source is None:
        return None
    if isinstance(source, str):
        name, content = _read(source)
    else:
        name, content = "the summary", source
    try:
        if "expected_rmse" not in content:
            raise ModelError(
                "states no expected error: give a summary of compensate, or a model"
            )
        own_unit = _value(content, "unit", fields.text)
        rmse = _value(content, "expected_rmse", fields.magnitude)
        move = _value(content, "move_range", fields.interval)
        move_time = _value(content, "move_time", fields.interval)
        delay = _value(content, "sensor_delay", fields.magnitude)
        past_known = content.get("past_known") is True
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None
    if own_unit and unit and own_unit != unit:
        raise InputError(f"{name}: is in {own_unit}, the comparison in {unit}")
    # an error of exactly 0 was never measured: it states nothing
    return Expected(rmse or None, move, move_time, delay or 0.0, past_known)


def _read(path: str) -> tuple[str, Mapping[str, Any]]:
    """Return the name of a file, and its figures: those of a summary, or of a model's fit (ModelError)."""
    from dbo_cli.model.file import parse_model

    name, values = fields.load(path, "summary")
    if isinstance(values, dict) and values.get("format") == "dbo-model":
        model = parse_model(values, name).forward()
        return name, {**model.fit, "unit": model.output.unit}
    try:
        return name, fields.contents(values, "", "dbo-summary", "a summary")
    except ModelError as problem:
        raise ModelError(f"{name}: {problem}") from None


def _value(values: Mapping[str, Any], key: str, read: fields.Reader) -> Any:
    """Return what a key holds; None where it is null or missing."""
    return fields.unless_null(read)(values.get(key), key)
