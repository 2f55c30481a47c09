"""What is asked of a drive, in one record, and what a drive may therefore do.

Limits cut the range on which a model was identified; they only narrow it. Beyond it a
drive goes where that was asked for by name (``extrapolate``), and only as far as the
typed limits say.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, Quantity, StartName
from dbo_cli.logs.units import UnitFactor, in_unit, unit_factor, without_prefix

Figure = float | str | None
"""A limit: a number in the unit of the drive, or a text with a unit of its own (``1.2kV``, ``2V/ms``)."""

Seconds = float | Literal["auto"] | None
NEED_TIME = (
    "max_slew", "max_current", "condition", "approach", "lead", "return_", "bandwidth"
)  # fmt: skip

WRONG_UNIT = 10.0
"""Times the largest voltage of a model; a plain limit beyond that is taken for one in another unit.

A prefix is a factor of a thousand, and this is far from it and from one; chosen.
"""


@dataclass(frozen=True)
class DriveOptions:
    """What is asked of the drive that makes an actuator follow a trajectory.

    Voltages are in the unit of the model's input, or texts with their own
    (``"1.2kV"``); times in seconds.

    Attributes
    ----------
    v_min, v_max : float, optional
        The least and the greatest drive. They cut the range on which the model was
        identified.
    extrapolate : bool
        Go beyond that range, as far as ``v_min`` and ``v_max`` say.
    max_slew : float, optional
        Fastest change of the drive, per second (``"2V/ms"``).
    max_current, capacitance : float, optional
        What the amplifier can deliver (A) into which load (F): a slew limit of their
        ratio, converted from volts a second.
    on_limit : {"auto", "clip", "error"}
        Where a limit is met: ``auto`` cuts off and counts what costs at most a
        hundredth of the move (RMS of what it misses, over the difference between its
        largest and its least value; where it does not move, over the model's range),
        and raises LimitError for more; ``clip`` cuts off whatever it costs; ``error``
        raises LimitError at the first row.
    state : str or ModelState
        ``auto``, ``empty``, ``full``, ``settled``, or a state to go on from.
    from_ : float, optional
        What the amplifier stands at before the first row; a state knows it.
    approach : float or "auto", optional
        Seconds of a ramp from there to the first row; auto: within the slew limit, 0.1
        s at least, without a limit a second for the whole range.
    condition : bool
        Sweep the actuator into a known state first.
    lead : float or "auto", optional
        Seconds at the first value before a move that begins in motion; auto: what
        dynamics and delay need.
    return_ : float or "auto", optional
        Seconds of a ramp at the end, back to where the drive came from (to 0, where
        that is not known).
    bandwidth : float, optional
        Cut-off (Hz) of a zero-phase low-pass that rounds the trajectory's corners
        first.

    Raises
    ------
    UsageError
        A value is none, or two exclude each other.
    """

    v_min: Figure = None
    v_max: Figure = None
    extrapolate: bool = False
    max_slew: Figure = None
    max_current: Figure = None
    capacitance: Figure = None
    on_limit: Literal["auto", "clip", "error"] = "auto"
    state: StartName | ModelState = "auto"
    from_: Figure = None
    approach: Seconds = None
    condition: bool = False
    lead: Seconds = None
    return_: Seconds = None
    bandwidth: float | None = None

    def __post_init__(self) -> None:
        """Check every value, and what excludes what, before anything is read."""
        if self.on_limit not in ("auto", "clip", "error"):
            raise UsageError(
                f"`on_limit`: '{self.on_limit}' is none of auto, clip, error"
            )
        self._check_limits()
        for name in ("approach", "lead", "return_"):
            check_seconds(name, getattr(self, name))
        self._check_pieces()

    def _check_limits(self) -> None:
        if self.bandwidth is not None and not 0.0 < self.bandwidth < math.inf:
            raise UsageError(
                f"`bandwidth` {self.bandwidth:g}: give a positive number of Hz"
            )
        for name in ("max_slew", "max_current", "capacitance"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str) and not value > 0.0:
                raise UsageError(f"`{name}` {value:g}: give a number above 0")
        for name in ("v_min", "v_max"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str) and math.isnan(value):
                raise UsageError(f"`{name}`: is not a number")
        if isinstance(self.from_, int | float) and not math.isfinite(self.from_):
            raise UsageError(
                f"`from_` {self.from_:g}: give the voltage that the amplifier stands at"
            )
        if (self.max_current is None) != (self.capacitance is None):
            raise UsageError(
                "`max_current` and `capacitance` belong together: the one is the other's limit"
            )
        if not isinstance(self.v_min, str) and not isinstance(self.v_max, str):
            check_range(self.v_min, self.v_max)

    def _check_pieces(self) -> None:
        if self.condition and self.state != "auto":
            named = self.state if isinstance(self.state, str) else "a state"
            raise UsageError(
                f"`condition` and `state` {named} exclude each other: the sweep makes its own state"
            )

    def limits(self, model: ActuatorModel) -> DriveLimits:
        """Return the limits of the drive of a forward model."""
        limits = drive_limits(
            model.input,
            self.v_min,
            self.v_max,
            self.max_slew,
            extrapolate=self.extrapolate,
        )
        farad = self.farad
        if self.max_current is None or farad is None:
            return limits
        # a second
        volts = np.array(in_unit("max_current", self.max_current, "A") / farad)
        slew = float(volts_a_unit(model).inverse.apply(volts))
        return dataclasses.replace(
            limits, max_slew=min(slew, limits.max_slew or math.inf)
        )

    def require_one_unit(self, units: Mapping[str, str | None]) -> None:
        """Refuse plain numbers as limits of channels whose drives have different units (UsageError)."""
        require_one_unit(units, **self.typed_limits)

    @property
    def typed_limits(self) -> dict[str, float | str]:
        """The limits that were typed, by their names."""
        typed = {
            "v_min": self.v_min,
            "v_max": self.v_max,
            "max_slew": self.max_slew,
            "from_": self.from_,
        }
        return {name: limit for name, limit in typed.items() if limit is not None}

    @property
    def farad(self) -> float | None:
        """The load, where it is known."""
        if self.capacitance is None:
            return None
        return in_unit("capacitance", self.capacitance, "F")

    @property
    def why_time(self) -> str | None:
        """Why the time between samples is needed, where it is."""
        for name in NEED_TIME:
            value = getattr(self, name)
            if value in (None, False):
                continue
            if name == "max_slew" and self.max_slew == math.inf:
                continue  # no limit
            return f"`{name}` depends on it"
        return None

    @property
    def rounding(self) -> float | None:
        """Cut-off (Hz) with which the corners of the trajectory are rounded, where they are."""
        return self.bandwidth

    @property
    def has_pieces(self) -> bool:
        """Whether rows may stand before or after the trajectory's own."""
        around = (self.from_, self.approach, self.lead, self.return_)
        return self.condition or any(option is not None for option in around)


def check_seconds(name: str, value: Seconds) -> None:
    """Refuse what is neither a time nor ``auto`` (UsageError)."""
    if value is not None and value != "auto":
        if (
            not isinstance(value, int | float)
            or isinstance(value, bool)
            or not 0.0 < value < math.inf
        ):
            raise UsageError(f"`{name}` {value}: give seconds above 0, or auto")


def volts_a_unit(model: ActuatorModel) -> UnitFactor:
    """Return how many volts a unit of the drive is, one where it has no unit (UsageError)."""
    factor = unit_factor(model.input.unit, "V")
    if factor is None:
        raise UsageError(
            f"`max_current` and `capacitance`: the drive is in {model.input.unit}, no voltage"
        )
    return factor


def limits_in(
    unit: str | None, v_min: Figure, v_max: Figure, max_slew: Figure
) -> DriveLimits:
    """Return limits in the unit of a drive, infinite where not given (UsageError)."""
    low, high, slew = -math.inf, math.inf, None
    if v_min is not None:
        low = in_unit("v_min", v_min, unit)
    if v_max is not None:
        high = in_unit("v_max", v_max, unit)
    check_range(low, high)
    if max_slew is not None:
        slew = in_unit("max_slew", max_slew, unit, "s")
    return DriveLimits(low, high, slew)


def plain_in(unit: str | None, *limits: Figure) -> str:
    """Say in which unit plain limits are read, where that is not volts."""
    if unit in (None, "V") or all(
        isinstance(limit, str) or not limit for limit in limits
    ):
        return ""
    return f"limits without a unit are read in {unit}, the drive's (1.2kV, 2000V/s are converted)"


def check_gain(gain: float) -> None:
    """Refuse an amplifier of no gain (UsageError)."""
    if gain == 0.0:
        raise UsageError(
            "`gain` 0: an amplifier of no gain moves nothing (give its volts out per volt in)"
        )


def check_range(v_min: float | None, v_max: float | None) -> None:
    """Refuse limits that leave nothing between them (UsageError)."""
    if v_min is not None and v_max is not None and v_min >= v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")


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
    low, high, slew = drive.minimum, drive.maximum, None
    if v_min is not None:
        low = voltage_in("v_min", v_min, drive)
    if v_max is not None:
        high = voltage_in("v_max", v_max, drive)
    if max_slew is not None:
        slew = slew_in("max_slew", max_slew, drive)
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
