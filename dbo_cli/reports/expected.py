"""What error was to be expected of a log: from a summary of ``compensate``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dbo_cli.arrays import Range
from dbo_cli.errors import ModelError, prefixed
from dbo_cli.model import fields
from dbo_cli.units import ratio

SUMMARY_KEYS: dict[str, fields.Reader] = {
    "unit": fields.text,
    "expected_rmse": fields.magnitude,
    "move_range": fields.interval,
    "move_time": fields.interval,
    "sensor_delay": fields.magnitude,
}
"""Of a summary, what is read here; each may be null or missing."""


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
        First and last time (s) of the move in its drive; nothing tells where it ends by default.
    sensor_delay
        Seconds by which the sensor is late, which is no error.
    """

    rmse: float | None
    move: Range | None = None
    move_time: Range = (0.0, math.inf)
    sensor_delay: float = 0.0


UNKNOWN = Expected(None)
"""Nothing was expected."""


def expected_in(
    source: Mapping[str, Any] | None, unit: str | None, name: str = "the summary"
) -> Expected:
    """Return the expected error that a summary of ``compensate`` states; unknown without one.

    Parameters
    ----------
    source
        ``Drive.summary()``, or what is in a file of one.
    unit
        Of what is compared.
    name
        What messages call it.

    Raises
    ------
    InputError
        Its unit measures something else than what is compared.
    ModelError
        It is no summary, or states no expected error.
    """
    if source is None:
        return UNKNOWN
    with prefixed(name):
        content = fields.contents(source, "", "dbo-summary", "a summary")
        if "expected_rmse" not in content:
            raise ModelError("states no expected error: give a summary of compensate")
        values = {}
        for key, read in SUMMARY_KEYS.items():
            values[key] = fields.unless_null(read)(content.get(key), key)
        factor = float(ratio(values["unit"] or None, unit or None))
    rmse, move = values["expected_rmse"], values["move_range"]
    # an error of exactly 0 was never measured: it states nothing
    return Expected(
        factor * rmse if rmse else None,
        None if move is None else (factor * move[0], factor * move[1]),
        values["move_time"] or UNKNOWN.move_time,
        values["sensor_delay"] or 0.0,
    )
