"""What a drive may do: two ranges of the voltage, how fast it may change, and the gate that holds it to them.

The *rating* is what the amplifier may be asked for: the limits that were typed, or an
end of the identified range where none was typed. The *move's range* is the rating cut
to the identified range. Rows of a move, and a sweep, stay in the move's range; the way
in and the return may use the rating; nothing leaves it.

The gate: no row leaves for an amplifier that breaks a limit, wherever it was computed.
Planning keeps the limits; the gate only looks, row by row, and knows nothing of how the
rows were made. What it finds is a fault of this program, and nothing more is written.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dbo_cli.arrays import Booleans, Floats, Range
from dbo_cli.errors import DboError, InputError, LimitError, UsageError
from dbo_cli.model import Quantity, Steps
from dbo_cli.model.gears import largest_step
from dbo_cli.units import Typed, parse_quantity

STEP_ROUNDING = 8.0 * 2.0**-52
"""Of the larger of two voltages: the last digits of a step, each voltage being rounded once or twice on its
way through points and scales. A slew limit is kept to that, a range exactly.
"""

WRONG_UNIT = 10.0
"""Times the largest identified voltage: a plain number beyond it was meant in another unit; chosen."""


class GateError(DboError):
    """The program computed a drive that breaks its own limits: exit 1, nothing more is written."""


@dataclass(frozen=True)
class Limits:
    """The limits of a drive.

    Attributes
    ----------
    rating : tuple of float
        Least and greatest voltage of any row.
    quantity : Quantity
        The voltage of a model: its unit, and the range on which it was identified.
    slew : float, optional
        Fastest change per second.
    extrapolate : bool
        Whether a move may leave the identified range.
    given : bool
        Whether anybody gave a limit; else all is the identified range.

    Raises
    ------
    UsageError
        The limits leave nothing of the identified range, or the slew is not above 0.
    """

    rating: Range
    quantity: Quantity
    slew: float | None = None
    extrapolate: bool = False
    given: bool = True

    def __post_init__(self) -> None:
        """Refuse limits that leave nothing."""
        low, high = self.move
        if not low < high:
            (low, high), (lowest, highest) = self.rating, self.identified
            raise UsageError(
                f"`v_min` {low:.6g} to `v_max` {high:.6g} leaves none of the identified range, {lowest:.6g} "
                f"to {highest:.6g}{self.suffix} (`extrapolate` goes beyond)"
            )
        if self.slew is not None and not self.slew > 0.0:
            raise UsageError(f"`max_slew` {self.slew:g}: give a number above 0")

    @classmethod
    def in_unit(cls, unit: str | None, **options: Any) -> Limits:
        """Return the limits of a drive whose identified range is not known; infinite where none was typed."""
        return cls.within(Quantity("voltage", unit, -math.inf, math.inf), **options)

    @classmethod
    def within(
        cls,
        quantity: Quantity,
        v_min: Typed | None = None,
        v_max: Typed | None = None,
        max_slew: Typed | None = None,
        extrapolate: bool = False,
    ) -> Limits:
        """Return the limits of a drive.

        Parameters
        ----------
        quantity
            The voltage of a model: its unit and its identified range.
        v_min, v_max, max_slew
            What was typed: numbers in the unit of the drive, or texts with a unit.
        extrapolate
            Let the move use the whole rating.

        Raises
        ------
        UsageError
            A limit cannot be read, is probably in another unit, or leaves nothing of
            the range.
        """
        if extrapolate and v_min is None and v_max is None:
            raise UsageError("`extrapolate` needs `v_min` or `v_max`")
        low = voltage_in("v_min", v_min, quantity)
        high = voltage_in("v_max", v_max, quantity)
        low = quantity.min if low is None else low
        high = quantity.max if high is None else high
        slew = None
        if max_slew is not None:
            per_second = None if quantity.unit is None else f"{quantity.unit}/s"
            slew = parse_quantity(max_slew, per_second, "max_slew", 0.0)
        given = any(limit is not None for limit in (v_min, v_max, max_slew))
        return cls((low, high), quantity, slew, extrapolate, given)

    @property
    def identified(self) -> Range:
        """The range on which the model was identified."""
        return self.quantity.min, self.quantity.max

    @cached_property
    def move(self) -> Range:
        """Least and greatest voltage of the rows of a move."""
        return self.rating if self.extrapolate else self.sweep

    @property
    def sweep(self) -> Range:
        """The range of a sweep: as much of the rating as is identified, if that is any."""
        (low, high), (lowest, highest) = self.rating, self.identified
        return max(low, lowest), min(high, highest)

    @property
    def suffix(self) -> str:
        """The unit behind a blank, for messages."""
        return self.quantity.suffix

    def largest_step(self, dt: Steps) -> Any:
        """Return the largest change in a time step (s), rounded down; None where any change is allowed.

        Raises
        ------
        InputError
            There is a slew limit and no clock.
        """
        if self.slew is not None and dt is None:
            raise InputError(
                "`max_slew` needs a clock: add `time` COLUMN or `sample_rate` HZ"
            )
        return largest_step(self.slew, dt)

    def require_start(self, voltage: float, name: str) -> None:
        """Refuse an amplifier that stands outside the rating.

        Raises
        ------
        LimitError
            It does.
        """
        low, high = self.rating
        if low <= voltage <= high:
            return
        raise LimitError(
            f"{name} {voltage:.6g}{self.suffix} is outside {low:.6g} to {high:.6g}{self.suffix}: "
            "bring the amplifier inside, or give its rating (`v_min`, `v_max`)"
        )

    # --- the gate ---

    def broken(
        self, voltage: Floats, last: float | None, dt: Steps, phase: str
    ) -> tuple[Booleans, str]:
        """Return which rows break a limit, and how the first one does.

        Parameters
        ----------
        voltage : array
            Consecutive rows, one at least.
        last : float or None
            Where the amplifier stands before them; None: any first row inside the range may
            come.
        dt : float, array or None
            Seconds since the row before; needed with a slew limit.
        phase : {"move", "lead", "return"}
            What the rows are: rows of a move keep the move's range, others the rating.

        Raises
        ------
        InputError
            There is a slew limit and no ``dt``.
        """
        low, high = self.move if phase == "move" else self.rating
        first = voltage[:1] if last is None else [last]
        before = np.concatenate([first, voltage[:-1]])
        bad = ~((voltage >= low) & (voltage <= high) & np.isfinite(voltage))
        largest = self.largest_step(dt)
        if largest is not None:
            digits = STEP_ROUNDING * np.maximum(np.abs(voltage), np.abs(before))
            bad |= ~(np.abs(voltage - before) <= largest + digits)
        row = int(np.argmax(bad))
        if not bad[row]:
            return bad, ""
        value, unit = float(voltage[row]), self.suffix
        if not math.isfinite(value):
            return bad, f"{value} is no voltage"
        if not low <= value <= high:
            side = f"above {high:.9g}" if value > high else f"below {low:.9g}"
            return bad, f"{value:.9g}{unit} is {side}{unit}"
        return bad, (
            f"{float(before[row]):.9g} to {value:.9g}{unit} in one row is faster than "
            f"{self.slew:g}{unit}/s"
        )

    def admit(self, voltage: Floats, last: float | None, dt: Steps, phase: str) -> None:
        """Let rows pass; see ``broken``.

        Raises
        ------
        GateError
            A row breaks a limit.
        """
        bad, reason = self.broken(voltage, last, dt, phase)
        if bad.any():
            raise GateError(
                f"internal error: a computed row breaks the limits: {reason}; the output ends here "
                "(please report it)"
            )

    def require_reachable(self, aim: Range, last: float | None, dt: Steps) -> None:
        """Refuse a first row within ``aim`` that one step from ``last``, if that is known, does not reach.

        Raises
        ------
        LimitError
            It does not.
        """
        first = float(dt[0]) if isinstance(dt, np.ndarray) else dt
        largest = self.largest_step(first)
        if last is None or largest is None:
            return
        low, high = aim
        if max(low - last, last - high) > largest:
            unit = self.suffix
            text = f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
            raise LimitError(
                f"the amplifier is at {last:.6g}{unit}; {self.slew:g}{unit}/s does not reach {text}{unit} in "
                "one row: add `approach` auto"
            )

    def as_dict(self) -> dict[str, Any]:
        """Return the limits as plain values, for summaries."""
        return {
            "unit": self.quantity.unit,
            "rating": list(self.rating),
            "move": list(self.move),
            "identified": list(self.identified),
            "max_slew": self.slew,
            "extrapolate": self.extrapolate,
        }

    def describe(self) -> str:
        """Return what a move may do: ``0 to 96 V, 200 V/s``."""
        low, high = self.move
        text = f"{low:.6g} to {high:.6g}{self.suffix}"
        if self.slew is not None:
            text += f", {self.slew:.6g}{self.suffix}/s"
        return text


def in_full(value: float, digits: int = 4) -> str:
    """Return a value to so many digits, for lines: 100000 of a drive in mV, not 1e+05."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


def voltage_in(name: str, figure: Typed | None, quantity: Quantity) -> float | None:
    """Return a typed voltage in the unit of a model's drive; None where nothing was typed.

    Raises
    ------
    UsageError
        It cannot be read; or it is a plain number far beyond the model's range, and the
        unit of the drive has a prefix.
    """
    if figure is None:
        return None
    largest = WRONG_UNIT * max(abs(quantity.min), abs(quantity.max))
    if math.isinf(largest):  # no range says which unit was meant
        largest = 0.0
    return parse_quantity(figure, quantity.unit, name, largest)


def rounded_up(value: float, digits: int = 2) -> float:
    """Return a bound to some digits, no smaller than it is."""
    if not value:
        return value
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    return math.ceil(value / unit) * unit


def rounded_down(value: float, digits: int = 2) -> float:
    """Return a bound to some digits, no larger than it is."""
    return -rounded_up(-value, digits)
