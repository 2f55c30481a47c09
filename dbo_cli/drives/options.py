"""What is asked of a drive, in one record."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dbo_cli.drives.limits import Figure as Figure
from dbo_cli.drives.limits import drive_limits, require_one_unit
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState, StartName
from dbo_cli.logs.units import UnitFactor, in_unit, unit_factor

Seconds = float | Literal["auto"] | None
NEED_TIME = (
    "max_slew", "max_current", "condition", "approach", "lead", "return_", "bandwidth"
)  # fmt: skip


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
        return (
            None
            if self.capacitance is None
            else in_unit("capacitance", self.capacitance, "F")
        )

    @property
    def why_time(self) -> str | None:
        """Why the time between samples is needed, where it is."""
        needing = [
            name for name in NEED_TIME if getattr(self, name) not in (None, False)
        ]
        if self.max_slew == math.inf:
            needing.remove("max_slew")
        return f"`{needing[0]}` depends on it" if needing else None

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
    low = -math.inf if v_min is None else in_unit("v_min", v_min, unit)
    high = math.inf if v_max is None else in_unit("v_max", v_max, unit)
    check_range(low, high)
    return DriveLimits(
        low,
        high,
        None if max_slew is None else in_unit("max_slew", max_slew, unit, "s"),
    )


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
