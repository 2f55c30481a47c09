"""What a drive may do: the range on which a model was identified, cut by the limits that were typed.

Limits only narrow. Beyond the identified range a drive goes where that was asked for by
name (``extrapolate``), and only as far as the typed limits say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model_state import DriveLimits, Quantity
from dbo_cli.logs.units import in_unit, without_prefix

Figure = float | str | None
"""A limit: a number in the unit of the drive, or a text with a unit of its own (``1.2kV``, ``2V/ms``)."""

WRONG_UNIT = 10.0
"""Times the largest voltage of a model; a plain limit beyond that is taken for one in another unit.

A prefix is a factor of a thousand, and this is far from it and from one; chosen.
"""


def drive_limits(
    drive: Quantity,
    v_min: Figure = None,
    v_max: Figure = None,
    max_slew: Figure = None,
    *,
    extrapolate: bool = False,
) -> DriveLimits:
    """Return what a drive may do.

    Parameters
    ----------
    drive : Quantity
        The voltages of a model: their unit, and the range on which it was identified.
    v_min, v_max, max_slew : float or str, optional
        The limits as they were typed: numbers in the drive's unit, or texts with a
        unit.
    extrapolate : bool
        Take ``v_min`` and ``v_max`` as they are, where they lie beyond the range, too.

    Raises
    ------
    UsageError
        A limit cannot be read, is probably in another unit, or leaves nothing of the
        range.
    """
    low = drive.minimum if v_min is None else voltage_in("v_min", v_min, drive)
    high = drive.maximum if v_max is None else voltage_in("v_max", v_max, drive)
    slew = None if max_slew is None else slew_in("max_slew", max_slew, drive)
    if extrapolate:
        if v_min is None and v_max is None:
            raise UsageError(
                "`extrapolate` goes as far as `v_min` and `v_max` say: give one of them"
            )
    else:
        _require_overlap(drive, low, high)
        low, high = max(low, drive.minimum), min(high, drive.maximum)
    if not low < high:
        raise UsageError(f"`v_min` {low:g} must be below `v_max` {high:g}")
    return DriveLimits(low, high, slew)


def voltage_in(name: str, typed: float | str, drive: Quantity) -> float:
    """Return a voltage that was typed, in the unit of a model's drive.

    Raises
    ------
    UsageError
        It cannot be read, or it is a plain number that was probably meant in another
        unit: the drive's unit has a prefix, and it lies far beyond the model's range.
    """
    value = in_unit(name, typed, drive.unit)
    if math.isnan(value):
        raise UsageError(f"`{name}`: is not a number")
    base = without_prefix(drive.unit)
    largest = max(abs(drive.minimum), abs(drive.maximum))
    far = WRONG_UNIT * largest < abs(value) < math.inf
    if base is None or not far or not _is_plain(typed):
        return value
    raise UsageError(
        f"`{name}` {_shown(typed)}: plain numbers are read in {drive.unit}, and the model goes from "
        f"{drive.minimum:.6g} to {drive.maximum:.6g} {drive.unit}: give its unit "
        f"({value:.9g}{base}, {value:.9g}{drive.unit})"
    )


def slew_in(name: str, typed: float | str, drive: Quantity) -> float:
    """Return a slew limit that was typed, in the unit of a model's drive per second.

    Raises
    ------
    UsageError
        It cannot be read, or it is a plain number and the drive's unit has a prefix:
        nothing tells whether volts or kilovolts per second were meant.
    """
    value = in_unit(name, typed, drive.unit, "s")
    base = without_prefix(drive.unit)
    if base is None or math.isinf(value) or not _is_plain(typed):
        return value
    raise UsageError(
        f"`{name}` {_shown(typed)}: the model's drive is in {drive.unit}: give its unit "
        f"({value:.9g}{base}/s, {value:.9g}{drive.unit}/s)"
    )


def _shown(typed: float | str) -> str:
    """Return a limit as it is shown in a message."""
    return typed if isinstance(typed, str) else f"{typed:.9g}"


def _is_plain(typed: float | str) -> bool:
    """Tell whether a limit was typed without a unit."""
    if not isinstance(typed, str):
        return True
    try:
        float(typed)
    except ValueError:
        return False
    return True


def _require_overlap(drive: Quantity, low: float, high: float) -> None:
    """Refuse limits between which nothing of the identified range lies (UsageError)."""
    if low >= drive.maximum:
        wrong = f"`v_min` {low:.6g}"
    elif high <= drive.minimum:
        wrong = f"`v_max` {high:.6g}"
    else:
        return
    raise UsageError(
        f"{wrong}{drive.suffix} leaves nothing of the range on which the model was identified, "
        f"{drive.minimum:.6g} to {drive.maximum:.6g}{drive.suffix} (another limit, or `extrapolate` with "
        "`v_min` and `v_max` to go beyond it)"
    )


def limits_note(
    drive: Quantity, limits: DriveLimits, v_min: Figure, v_max: Figure
) -> str:
    """Say which limits held, where some were typed; nothing where none were."""
    if v_min is None and v_max is None:
        return ""
    return (
        f"the drive may go from {limits.v_min:.6g} to {limits.v_max:.6g}{drive.suffix} (identified: "
        f"{drive.minimum:.6g} to {drive.maximum:.6g}{drive.suffix})"
    )


def beyond_range(drive: Quantity, low: float, high: float) -> str:
    """Say by how much voltages from ``low`` to ``high`` leave the identified range, where they do."""
    below, above = drive.minimum - low, high - drive.maximum
    parts = []
    if below > 0.0:
        parts.append(f"{below:.3g}{drive.suffix} below")
    if above > 0.0:
        parts.append(f"{above:.3g}{drive.suffix} above")
    if not parts:
        return ""
    return (
        f"{' and '.join(parts)} the {drive.minimum:.6g} to {drive.maximum:.6g}{drive.suffix} on which the "
        "model was identified; it extrapolates there"
    )


def require_one_unit(units: Mapping[str, str | None], **typed: Figure) -> None:
    """Refuse a plain number as a limit of channels whose drives have different units (UsageError).

    Parameters
    ----------
    units : mapping of str to str
        The unit of each channel's drive.
    **typed : float or str, optional
        Limits for all channels, by the parameter's name.
    """
    first = next(iter(units))
    different = [channel for channel, unit in units.items() if unit != units[first]]
    if not different:
        return
    for name, limit in typed.items():
        if limit is None or not _is_plain(limit) or float(limit) == 0.0:
            continue
        raise UsageError(
            f"`{name}` {_shown(limit)}: channel {first} is driven in {units[first] or 'no unit'} and channel "
            f"{different[0]} in {units[different[0]] or 'no unit'}: give the limit's unit"
        )
