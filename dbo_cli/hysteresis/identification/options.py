"""What a user may fix before an identification; everything is checked when it is given."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from dataclasses import fields

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.identification.cleaning import Sensor
from dbo_cli.records import dataclass

METHODS = ("least-squares", "paper")
SLOPES = ("growing", "falling", "free")
ZEROS = ("none", "mean", "first")
NOT_FOR_PAPER = (
    "relaxation",
    "delay",
    "slopes",
    "skip_seconds",
    "rated",
    "sensor_delay",
    "sensor_lag",
    "dynamics",
)

NOT_WITH_PRIOR = ("gears", "points", "relaxation", "delay", "slopes", "method", "zero", "dynamics")

MOST_GEARS = 10_000  # the normal equations of so many take 800 MB


@dataclass(frozen=True)
class IdentificationOptions:
    """What the user asked for; None stands for 'auto'.

    Parameters
    ----------
    gears, points : int, optional
        Number of gears; number of segments of the asymmetry, 0 for none.
    relaxation : sequence of float, optional
        Time constants in seconds, () for none.
    delay : float, optional
        Of the actuator, in seconds.
    slopes : {"growing", "falling", "free"}, optional
        How the slopes of the gears may change from one to the next.
    skip_seconds : float
        Left out at the beginning of every log.
    method : {"least-squares", "paper"}
        The paper's own takes one log of one cycle, and of the other options gears, points and zero alone.
    zero : {"none", "mean", "first"} or float
        Displacement that counts as zero: as logged, the log's mean, its first, or a value.
    rated : (float, float), optional
        The drive's full range, for a warning where the logs cover less; texts have a unit (``"1.2kV"``).
    force : bool
        Keep a model that would be refused.
    dynamics : int, optional
        Number of resonances: 0, 1 or 2.
    sensor_delay, sensor_lag : float
        What the sensor adds, in seconds: taken off the logs, kept in the model's ``fit``, not compensated.

    Raises
    ------
    UsageError
        A value is not of its kind, or options contradict each other.
    """

    gears: int | None = None
    points: int | None = None
    relaxation: Sequence[float] | None = None
    delay: float | None = None
    slopes: str | None = None
    skip_seconds: float = 0.0
    method: str = "least-squares"
    zero: str | float = "none"
    rated: tuple[float | str, float | str] | None = None
    force: bool = False
    sensor_delay: float = 0.0
    sensor_lag: float = 0.0
    dynamics: int | None = None

    def __post_init__(self) -> None:
        """Refuse what is not of its kind or contradicts the rest."""
        self._check_count("gears", self.gears, 1)
        if self.gears is not None and self.gears > MOST_GEARS:
            raise UsageError(f"`gears` {self.gears}: {MOST_GEARS:,} are more than any log can tell apart")
        self._check_count("points", self.points, 0)
        self._check_count("dynamics", self.dynamics, 0)
        if self.dynamics is not None and self.dynamics > 2:
            raise UsageError(f"`dynamics` {self.dynamics}: at most two resonances are looked for")
        _seconds("skip", self.skip_seconds)
        _seconds("sensor_delay", self.sensor_delay)
        _seconds("sensor_lag", self.sensor_lag)
        if self.delay is not None:
            _seconds("delay", self.delay)
        if self.relaxation is not None:
            self._check_relaxation(self.relaxation)
        if self.slopes is not None:
            _choice("slopes", self.slopes, SLOPES)
        _choice("method", self.method, METHODS)
        if not (_is_number(self.zero) and math.isfinite(float(self.zero))):
            _choice("zero", self.zero, ZEROS, " or a displacement")
        self._check_rated()
        _choice("force", self.force, (False, True))
        if self.method == "paper":
            self._check_paper()

    @property
    def sensor(self) -> Sensor:
        """The sensor's own delay and lag."""
        return Sensor(self.sensor_delay, self.sensor_lag)

    @staticmethod
    def _check_count(name: str, value: object, least: int) -> None:
        if value is None:
            return
        if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
            raise UsageError(f"`{name}` {value!r}: is a whole number, at least {least}")

    def _check_relaxation(self, taus: object) -> None:
        if isinstance(taus, str) or not isinstance(taus, Sequence):
            raise UsageError(f"`relaxation` {taus!r}: give a list of time constants in seconds")
        for tau in taus:
            if not (_is_number(tau) and 0.0 < tau < math.inf):
                raise UsageError(f"`relaxation` {tau!r}: time constants are positive numbers of seconds")
        object.__setattr__(self, "relaxation", tuple(float(tau) for tau in taus))

    def _check_rated(self) -> None:
        if self.rated is None:
            return
        if isinstance(self.rated, str) or not (isinstance(self.rated, Sequence) and len(self.rated) == 2):
            raise UsageError(f"`rated` {self.rated!r}: give both ends of the drive's range")
        low, high = self.rated
        if isinstance(low, str) or isinstance(high, str):
            return  # checked when they are in the logs' unit
        if not (_is_number(low) and _is_number(high) and -math.inf < low < high < math.inf):
            raise UsageError(f"`rated` {self.rated!r}: the lower end must be a number below the upper one")

    def check_prior(self) -> None:
        """Refuse what a prior already has (UsageError)."""
        usual = {one.name: one.default for one in fields(self)}
        for name in NOT_WITH_PRIOR:
            if getattr(self, name) != usual[name]:
                raise UsageError(
                    f"`{name}` does not go with `prior`, whose shape is kept: leave one of them out"
                )

    def _check_paper(self) -> None:
        """Refuse what the paper's method would have to ignore."""
        usual = {one.name: one.default for one in fields(self)}
        for name in NOT_FOR_PAPER:
            value = getattr(self, name)
            nothing = name in ("relaxation", "delay", "dynamics") and not value
            if value != usual[name] and not nothing:
                shown = {"skip_seconds": "skip"}.get(name, name)
                raise UsageError(
                    f"`{shown}` does not go with `method` paper: the paper's model is fitted to one cycle "
                    "and has neither lag nor delay (`rows` A:B cuts the cycle out)"
                )


def _is_number(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and not math.isnan(float(value))


def _seconds(name: str, value: object) -> None:
    if not (isinstance(value, numbers.Real) and _is_number(value) and 0.0 <= float(value) < math.inf):
        raise UsageError(f"`{name}` {value!r}: is a time in seconds, not negative")


def _choice(name: str, value: object, choices: Sequence[object], other: str = "") -> None:
    if not any(value is one or (isinstance(value, str) and value == one) for one in choices):
        raise UsageError(f"`{name}` {value!r}: is one of {', '.join(map(str, choices))}{other}")
