"""A recording of an actuator as arrays, what the user may fix, and the swings of a drive."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np

from dbo_cli.arrays import Booleans, Floats, Integers
from dbo_cli.errors import FitError, InputError, UsageError
from dbo_cli.model import Cascade
from dbo_cli.model.expect import SWING
from dbo_cli.model.fields import MOST_WIDTHS
from dbo_cli.signals import even, turns, usual_step

FEWEST_ROWS = 20  # fewer tell nothing of a loop
AT_REST, SLOWER = 0.01, 3.0
"""A drive at rest takes three times as long for a hundredth of its range as in its first swing."""
SAME_LEVEL = 0.1  # of the range: turns that are nearer are alike
MOST_FITTED_POINTS = 1000  # that are fitted: more than rows of the search tell nothing


@dataclass(frozen=True)
class Recording:
    """Drive voltage and displacement of one log.

    Attributes
    ----------
    name : what messages call it
    voltage, displacement : shape (n,)
    time : shape (n,), seconds, or None without a clock
    input, output : quantity and unit of each; None: no unit is stated
    good : shape (n,), which rows count; None: all
    """

    name: str
    voltage: Floats
    displacement: Floats
    time: Floats | None = None
    input: tuple[str, str | None] = ("voltage", None)
    output: tuple[str, str | None] = ("displacement", None)
    good: Booleans | None = None

    def __post_init__(self) -> None:
        """Refuse (InputError, FitError) arrays that hold no recording."""
        rows = int(self.usable.sum())
        if rows < FEWEST_ROWS:
            raise FitError(
                f"{self.name}: {rows} usable rows are too few; record at least {FEWEST_ROWS}, or skip less"
            )
        if float(np.ptp(self.voltage)) == 0.0:
            raise FitError(
                f"{self.name}: voltage never changes; record a drive that goes up and down"
            )
        if float(np.ptp(self.displacement)) == 0.0:
            raise FitError(f"{self.name}: displacement never changes; check the sensor")
        if self.time is not None and float(np.median(np.diff(self.time))) == 0.0:
            raise InputError(
                f"{self.name}: most time stamps repeat: replace them with `sample_rate` HZ"
            )

    @property
    def dt(self) -> float | None:
        """The usual step in seconds, None without a clock."""
        if self.time is None:
            return None
        return usual_step(np.diff(self.time))

    @property
    def even_step(self) -> float | None:
        """The step in seconds of an even clock, None without one."""
        return None if self.time is None else even(self.time)

    @property
    def usable(self) -> Booleans:
        """Which rows count; shape (n,)."""
        if self.good is None:
            return np.ones(len(self.voltage), bool)
        return self.good


def _are_seconds(*values: Any) -> bool:
    """Return whether all values are numbers of 0 or more, or "auto"."""
    for value in values:
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if value != "auto" and not (is_number and value >= 0.0):
            return False
    return True


def _is_count(value: Any, least: int, most: int) -> bool:
    """Return whether a value is a whole number within bounds, or "auto"."""
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    return value == "auto" or (is_whole and least <= int(value) <= most)


Slopes = Literal["auto", "growing", "falling", "free"]
Method = Literal["least-squares", "paper"]


@dataclass(frozen=True)
class Options:
    """What the user fixed of an identification, by the names of ``identify``'s options."""

    prior: Cascade | None = None
    sign: Literal["rising", "falling"] | None = None
    skip: float = 0.0
    zero: float | Literal["none", "mean", "first"] = "none"
    sensor_delay: float = 0.0
    gears: int | Literal["auto"] = "auto"
    points: int | Literal["auto"] = "auto"
    relaxation: tuple[float, ...] | Literal["auto"] = "auto"
    delay: float | Literal["auto"] = "auto"
    dynamics: int | Literal["auto"] = "auto"
    slopes: Slopes = "auto"
    method: Method = "least-squares"
    force: bool = False

    def __post_init__(self) -> None:
        """Refuse (UsageError) what makes no sense."""
        taus = () if self.relaxation == "auto" else self.relaxation
        rules = {
            "zero": (not isinstance(self.zero, bool), "none, mean, first or a number"),
            "skip": (_are_seconds(self.skip), "seconds, 0 or more"),
            "sensor_delay": (_are_seconds(self.sensor_delay), "seconds, 0 or more"),
            "gears": (
                _is_count(self.gears, 1, MOST_WIDTHS),
                f"a whole number from 1 to {MOST_WIDTHS:,}, or auto",
            ),
            "points": (
                _is_count(self.points, 0, MOST_FITTED_POINTS),
                f"a whole number from 0 to {MOST_FITTED_POINTS:,}, or auto",
            ),
            "relaxation": (_are_seconds(*taus), "seconds, 0 or more, or auto"),
            "delay": (_are_seconds(self.delay), "seconds, 0 or more, or auto"),
            "dynamics": (self.dynamics in ("auto", 0, 1, 2), "auto, 0, 1 or 2"),
            "sign": (self.sign in (None, "rising", "falling"), "rising or falling"),
            "slopes": (
                self.slopes in get_args(Slopes),
                "auto, growing, falling or free",
            ),
            "method": (self.method in get_args(Method), "least-squares or paper"),
        }
        for name, (is_right, needed) in rules.items():
            if not is_right:
                raise UsageError(f"`{name}` {getattr(self, name)}: give {needed}")

    @property
    def known_sensor_delay(self) -> float:
        """Seconds by which the sensor is late: as given, else as the prior has it."""
        if self.sensor_delay or self.prior is None:
            return self.sensor_delay
        return self.prior.sensor_delay

    @property
    def taus(self) -> tuple[float, ...] | None:
        """The time constants that the user gave, () for none, None where they are looked for."""
        if self.relaxation == "auto":
            return None
        return tuple(sorted(tau for tau in self.relaxation if tau > 0.0))


def centred(logs: Sequence[Recording]) -> tuple[Floats, Floats]:
    """Return drive and displacement of the usable rows of all logs, less their means over each log."""
    voltages, displacements = [], []
    for log in logs:
        v, y = log.voltage[log.usable], log.displacement[log.usable]
        voltages.append(v - v.mean())
        displacements.append(y - y.mean())
    return np.concatenate(voltages), np.concatenate(displacements)


def falling(logs: Sequence[Recording]) -> bool:
    """Whether the displacement falls as the drive rises."""
    drive, displacement = centred(logs)
    return float(np.sum(drive * displacement)) < 0.0


def begins_in_motion(voltage: Floats, time: Floats) -> bool:
    """Whether the drive moves in the first rows as fast as it does in its first swing."""
    swings, span = Swings.of(voltage), float(np.ptp(voltage))
    speed = float(swings.sizes[0]) / float(time[swings.turns[1]] - time[0])
    row = int(np.argmax(np.abs(voltage - voltage[0]) > AT_REST * span))
    return float(time[row] - time[0]) * speed < SLOWER * AT_REST * span


def detrended(values: Floats, time: Floats | None) -> tuple[Floats, float]:
    """Return values less their mean and, with a clock, an even drift; and how far that goes along them."""
    centred_values = values - values.mean()
    if time is None:
        return centred_values, 0.0
    centred_time = time - time.mean()
    square = max(float(np.sum(centred_time**2)), 1e-300)
    rate = float(np.sum(centred_time * centred_values)) / square
    return centred_values - rate * centred_time, rate * float(np.ptp(centred_time))


def runs_of(mask: Booleans) -> Integers:
    """Return begin and end of each run of true values; (runs, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return edges.reshape(-1, 2)


@dataclass(frozen=True)
class Swings:
    """The monotone ways of a drive.

    Attributes
    ----------
    turns : rows where it turns, the first and the last row included
    sizes : shape (swings,), in units of the drive
    number : shape (n,), the swing of each row
    """

    turns: Integers
    sizes: Floats
    number: Integers

    @staticmethod
    def of(drive: Floats) -> Swings:
        """Return the swings of a drive, those below 5 % of its range passed over."""
        rows = turns(drive, SWING * float(np.ptp(drive)))
        sizes = np.abs(np.diff(drive[rows]))
        number = np.searchsorted(rows[1:-1], np.arange(len(drive)), side="right")
        return Swings(rows, sizes, number.astype(np.int64))

    def different(self, drive: Floats, span: float = 1.0) -> set[tuple[float, float]]:
        """Return the swings as pairs of levels: one that is repeated tells nothing new.

        Turns within a tenth of the range ``span`` are alike.
        """
        levels = np.round(drive[self.turns] / (SAME_LEVEL * span)).tolist()
        return set(pairwise(levels))

    @property
    def loops(self) -> Floats:
        """Sizes of the swings; a last one that the log breaks off has at least that of the one before."""
        sizes = self.sizes.copy()
        if len(sizes) > 1:
            sizes[-1] = max(sizes[-1], sizes[-2])
        return sizes

    @property
    def rows(self) -> Integers:
        """How many rows each swing takes."""
        return np.diff(self.turns)

    @property
    def usual_rows(self) -> float:
        """Rows that a swing takes, the mean weighted by rows."""
        return float(np.average(self.rows, weights=self.rows))
