"""The drive from which a model is identified well: random turns over the whole range at many speeds.

It is made of half-cosine swings between turning points, as every drive of this program
is: the speed is zero at each turn, so a drive turns exactly where it says, and a slew
limit only makes a swing longer. A small sweep about the middle of the range may follow,
from which an actuator's dynamics are identified.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError

Floats = NDArray[np.float64]

# a time this close, in samples, to that of a sample is that of the sample
_WHOLE = 1e-9
MOST_SAMPLES = 100_000_000  # a row takes some 30 bytes of text: 3 GB
# one for the sweeps and one for return and rest leave four for the random turns
FEWEST_CYCLES = 6
# with fewer, interpolation between samples no longer shows where a swing turns
SAMPLES_A_CYCLE = 20

_FASTEST, _SLOWEST = -0.9, 0.6
"""log10 of a swing's time in that of the sweep's part between the same levels. Measured: docs/choices.md."""
LARGEST = 1e60  # of a limit, in the drive's unit, as in model files
SMALLEST = 1e-60  # from limit to limit; likewise
# chance that a turn lies at an end of the range: loops that hang there tell of
# asymmetry
AT_AN_END = 0.12
_HOLD_CHANCE = 0.15  # chance that a turn is held; chosen
_HOLD = 0.4  # periods; only at rest does creep show apart from hysteresis
_REST = 0.5
"""Periods at rest at the end, where it began: equal voltages tell drift. Measured: docs/choices.md."""

# a sweep's highest frequency over that of the loops: their fastest swings have 8 times
# it
FASTER = 10.0

SWEEP_SECONDS = 2.0  # at least; chosen
SWEEP_PERIODS = 120.0
"""Periods of the highest frequency that a sweep lasts, at least. Measured: docs/choices.md."""
OCTAVES_DOWN = 100.0
"""The sweep begins at its end over this: there the gears alone answer, and the ratio of the two is known."""
AMPLITUDE = 0.01
"""Of the range, from the middle to the crest, at the lower end of the sweep. Measured: docs/choices.md."""
FADED = 0.25
"""Of the amplitude, at the upper end: it falls with the logarithm of the frequency, since what a resonance
makes of it grows and what the gears do does not.
"""
# of the sweep's highest frequency, so that a resonance there is resolved
SAMPLES_A_PERIOD = 10.0
# of the sweep at either end, over which it rises and falls: no jump that would ring;
# chosen
TAPER = 0.05
SETTLE = 0.3  # s at rest before and after it, for creep to slow down; chosen

# a turning point as a part of the range, and the steps on the way there
Leg = tuple[float, int]


def swings(turns: Sequence[float], samples: Sequence[int]) -> Floats:
    """Return half-cosine swings through ``turns``, in order; swing i takes ``samples[i]`` steps."""
    out = np.empty(1 + sum(samples))
    out[0] = turns[0]
    place = 1
    for begin, end, count in zip(turns[:-1], turns[1:], samples, strict=True):
        part = out[place : place + count]
        phase = np.pi * np.arange(1, count + 1) / count
        part[:] = begin + (end - begin) * (0.5 - 0.5 * np.cos(phase))
        np.clip(part, min(begin, end), max(begin, end), out=part)
        part[-1:] = end
        place += count
    return out


def swing_samples(
    distance: float, time_step: float, seconds: float, max_slew: float | None = None
) -> int:
    """Return how many steps a half-cosine swing takes: ``seconds``, or longer where the slew is limited.

    The steepest part of the swing rises by pi/2 times its mean slope.
    """
    if max_slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / max_slew)
    return max(math.ceil(seconds / time_step - _WHOLE), 1)


@dataclass(frozen=True)
class Excitation:
    """A drive from which a model can be identified well.

    Why this shape. (1) It begins at the lower end and sweeps the whole range: that
    wipes out the past, so the state of every gear is known. (2) Then it turns at random
    levels, some at the ends: loops of every size, nested anywhere, so that gears and
    asymmetry come apart. (3) Every swing has a speed of its own, spread evenly in its
    logarithm from eight times the sweep's to a quarter, and some turns are held: lag,
    creep and loop width, which one speed confounds, come apart. (4) It returns and
    rests where it began, so that the sensor's drift shows as a difference between equal
    voltages. Never outside [v_min, v_max].

    What the duration buys, at 1 Hz on five virtual actuators (``benchmarks/tracking.py
    --excite``), as the RMS error of compensated moves that were not in the drive,
    geometric mean in % of the stroke: 8 s 0.14, 15 s 0.058, 30 s 0.061. 30 s of
    decaying amplitudes, as this program made before, give 0.060; what was then
    identified from them gave 0.14.

    Parameters
    ----------
    v_min, v_max : float
        The drive's range, in ``unit``.
    sample_rate : float
        Rows a second.
    duration : float
        Seconds from the first row to the end of the last.
    frequency : float
        Sweeps over the whole range and back, a second; other swings are faster and
        slower than that.
    max_slew : float, optional
        Fastest change, ``unit`` per second: swings that would be faster take longer.
    seed : int
        Chooses turns, speeds and holds; the same seed gives the same drive, byte for
        byte.
    sweep_to : float, optional
        Highest frequency, Hz, of a small sweep that follows in the middle of the range,
        for the dynamics; it takes 4 s more, below 60 Hz longer (see ``sweep``).
    sweep_amplitude : float, optional
        Of the sweep, in ``unit``.
    unit : str
        Of the drive, for messages.

    Raises
    ------
    UsageError
        The limits are not in order or no drive's, or the duration holds fewer than six
        periods, or a period fewer than 20 samples, or the slew limit does not allow the
        sweep; with the values that would do.
    """

    v_min: float
    v_max: float
    sample_rate: float
    duration: float
    frequency: float
    max_slew: float | None = None
    seed: int = 1
    sweep_to: float | None = None
    sweep_amplitude: float | None = None
    unit: str = "V"

    def __post_init__(self) -> None:
        """Refuse what cannot be made."""
        self._check_range()
        for name in ("sample_rate", "duration", "frequency", "max_slew"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise UsageError(f"`{name}` {value:g}: give a number above 0")
        if self.seed < 0:
            raise UsageError(f"`seed` {self.seed}: give a whole number of at least 0")
        self._check_pace()
        self._check_sweep()

    def _check_range(self) -> None:
        """Refuse limits that are not in order, and those that no model file could hold."""
        low, high = self.with_unit(self.v_min), self.with_unit(self.v_max)
        if not self.v_min < self.v_max:
            raise UsageError(f"`v_min` {low} must be below `v_max` {high}")
        if not max(abs(self.v_min), abs(self.v_max)) <= LARGEST:
            raise UsageError(
                f"`v_min` {low} and `v_max` {high}: give limits within {LARGEST:g}{self.unit}"
            )
        if self.span < SMALLEST:
            raise UsageError(
                f"`v_min` {low} and `v_max` {high}: give limits at least {SMALLEST:g}{self.unit} apart"
            )

    def with_unit(self, value: float) -> str:
        """Return a value of the drive in its unit, as the command line takes it."""
        return f"{value:g}{self.unit}"

    def _check_pace(self) -> None:
        """Refuse loops that are too fast for the rate or the slew limit, too few, or too many rows."""
        rate, duration, frequency = self.sample_rate, self.duration, self.frequency
        if rate / frequency < SAMPLES_A_CYCLE:
            raise UsageError(
                f"`frequency` {frequency:g}: fewer than {SAMPLES_A_CYCLE} samples a cycle (raise "
                f"`sample_rate` to {SAMPLES_A_CYCLE * frequency:g}, or lower it)"
            )
        fastest = math.pi * frequency * self.span
        if self.max_slew is not None and fastest > self.max_slew:
            slowed = self.max_slew / (math.pi * self.span)
            unit = 10.0 ** (math.floor(math.log10(slowed)) - 2)
            # no larger, of three digits
            slowed = float(f"{math.floor(slowed / unit) * unit:.3g}")
            raise UsageError(
                f"`max_slew` {self.with_unit(self.max_slew)}/s: the whole range at {frequency:g} Hz needs "
                f"{fastest:.6g} {self.unit}/s "
                f"(`frequency` {slowed:g} and a `duration` of at least {math.ceil(FEWEST_CYCLES / slowed)})"
            )
        # 1e-9: rounding is no cycle missed
        if duration * frequency < FEWEST_CYCLES * (1.0 - 1e-9):
            raise UsageError(
                f"`duration` {duration:g}: {duration * frequency:.3g} cycles of {frequency:g} Hz, at least "
                f"{FEWEST_CYCLES} are needed (a `duration` of {FEWEST_CYCLES / frequency:g})"
            )
        if duration * rate > MOST_SAMPLES:
            raise UsageError(
                f"`duration` {duration:g} at `sample_rate` {rate:g}: {duration * rate:.3g} rows "
                f"are more than the {MOST_SAMPLES:,} that are written at most"
            )

    def _check_sweep(self) -> None:
        """Refuse a sweep that is hardly faster than the loops, and an amplitude of none."""
        if self.sweep_to is None:
            if self.sweep_amplitude is not None:
                raise UsageError("`sweep_amplitude` is that of a sweep (`sweep_to` HZ)")
            return
        slower = self.sweep_to / FASTER
        if 0.0 < slower < self.frequency:
            raise UsageError(
                f"`sweep_to` {self.sweep_to:g}: the loops of {self.frequency:g} Hz are nearly as fast "
                f"(a sweep to {FASTER * self.frequency:g}, or `frequency` {slower:g} and `duration` "
                f"{self.duration * self.frequency / slower:.6g})"
            )

    @property
    def span(self) -> float:
        """Length of the range, in the drive's unit."""
        return self.v_max - self.v_min

    def drive(self) -> tuple[Floats, Floats]:
        """Return time (s) and voltage."""
        legs = _legs(self, round(self.duration * self.sample_rate) - 1)
        part = swings([0.0, *(turn for turn, _ in legs)], [steps for _, steps in legs])
        voltage = np.clip(self.v_min + self.span * part, self.v_min, self.v_max)
        voltage[part == 1.0] = self.v_max
        voltage = np.concatenate([voltage, self.small_sweep()])
        return np.arange(voltage.size) / self.sample_rate, voltage

    def small_sweep(self) -> Floats:
        """Return the voltage of the sweep in the middle of the range; none where none is asked for."""
        if self.sweep_to is None:
            return np.empty(0)
        ends = (self.v_min, self.v_max)
        return sweep(
            *ends,
            self.sample_rate,
            self.sweep_to,
            self.sweep_amplitude,
            self.max_slew,
            self.unit,
        )


# rows a second where nothing is said: 50 in a swing of the fastest, at 1 Hz
SAMPLE_RATE = 1000.0


def excitation_of(
    *,
    sample_rate: float | None = None,
    points: int | None = None,
    duration: float,
    **fields: Any,
) -> Excitation:
    """Return an excitation at a rate, or of so many rows in all, whose rate follows from the duration.

    Raises
    ------
    UsageError
        Both are given, the points are too few for the frequencies, or as for
        ``Excitation``.
    """
    if points is None:
        return Excitation(
            sample_rate=sample_rate or SAMPLE_RATE, duration=duration, **fields
        )
    if sample_rate is not None:
        raise UsageError(
            "`points` and `sample_rate` exclude each other: the rate follows from the points"
        )
    sweep_to = fields.get("sweep_to")

    def swept(rate: float) -> int:
        if sweep_to is None:
            return 0
        amplitude, max_slew = fields.get("sweep_amplitude"), fields.get("max_slew")
        unit = fields.get("unit", "V")
        return sweep(
            fields["v_min"], fields["v_max"], rate, sweep_to, amplitude, max_slew, unit
        ).size

    fewest = max(
        SAMPLES_A_CYCLE * fields["frequency"], SAMPLES_A_PERIOD * (sweep_to or 0.0)
    )
    seconds = duration + swept(2.0 * fewest) / (2.0 * fewest)
    rate = points / seconds
    if rate < fewest:
        raise UsageError(
            f"`points` {points:,}: {rate:.4g} rows a second, at least {fewest:g} are needed (`points` "
            f"{math.ceil(fewest * seconds):,})"
        )
    return Excitation(
        sample_rate=rate, duration=(points - swept(rate)) / rate, **fields
    )


def _legs(drive: Excitation, steps: int) -> list[Leg]:
    """Return two sweeps, random turns and holds, the return and the rest, ``steps`` in all."""
    step, period = 1.0 / drive.sample_rate, 1.0 / drive.frequency
    slew = None if drive.max_slew is None else drive.max_slew / drive.span
    # the one generator whose numbers Python never changes
    chance = random.Random(drive.seed).random

    def swing(distance: float, slowness: float = 1.0) -> int:
        count = swing_samples(distance, step, 0.5 * period * distance * slowness, slew)
        return max(count, SAMPLES_A_CYCLE // 2)

    sweep, rest = swing(1.0), round(_REST * period / step)
    turns: list[Leg] = []
    level, used = 0.0, 0
    while True:
        turn = float(chance() < 0.5) if chance() < AT_AN_END else chance()
        slowness = 10.0 ** (_FASTEST + (_SLOWEST - _FASTEST) * chance())
        legs = [(turn, swing(abs(turn - level), slowness))]
        if chance() < _HOLD_CHANCE:
            legs.append((turn, round(_HOLD * period / step)))
        used += sum(count for _, count in legs)
        # the way back included
        if turns and used + swing(turn) > steps - 2 * sweep - rest:
            break
        turns += legs
        level = turn
    back = swing(turns[-1][0])
    turns = _stretched(turns, steps - 2 * sweep - back - rest)
    return [(1.0, sweep), (0.0, sweep), *turns, (0.0, back), (0.0, rest)]


def _stretched(legs: list[Leg], steps: int) -> list[Leg]:
    """Return the same legs, each longer by the same part, so that they take ``steps``."""
    ends = np.cumsum([count for _, count in legs])
    ends = ends * steps // ends[-1]
    return [
        (turn, int(count))
        for (turn, _), count in zip(legs, np.diff(ends, prepend=0), strict=True)
    ]


def sweep(
    v_min: float,
    v_max: float,
    sample_rate: float,
    sweep_to: float,
    amplitude: float | None = None,
    max_slew: float | None = None,
    unit: str = "V",
) -> Floats:
    """Return the voltage of a way up to the middle, a logarithmic sweep there, and the way back to ``v_min``.

    Parameters
    ----------
    v_min, v_max : float
        The drive's range, in ``unit``; the drive is at rest at ``v_min`` before and
        after.
    sample_rate : float
        Rows a second.
    sweep_to : float
        Highest frequency, Hz.
    amplitude : float, optional
        From the middle to a crest at the sweep's lower end, in ``unit``; by default 1 %
        of the range.
    max_slew : float, optional
        Fastest change, ``unit`` per second.
    unit : str
        Of the drive, for messages.

    Raises
    ------
    UsageError
        The rate does not resolve the frequency, or the amplitude is none or too large,
        or too fast; with the values that would do.
    """
    span = v_max - v_min
    crest = AMPLITUDE * span if amplitude is None else amplitude
    _check(span, sample_rate, sweep_to, crest, max_slew, unit)
    step, middle = 1.0 / sample_rate, v_min + 0.5 * span
    seconds = max(SWEEP_SECONDS, SWEEP_PERIODS / sweep_to)
    count = round(seconds * sample_rate)
    part = np.arange(count) / count
    grown = math.log(OCTAVES_DOWN)
    begin = sweep_to / OCTAVES_DOWN
    turns = begin * seconds / grown * np.expm1(grown * part)
    edge = np.clip(np.minimum(part, 1.0 - part) / TAPER, 0.0, 1.0)
    size = crest * FADED**part * (0.5 - 0.5 * np.cos(np.pi * edge))
    ramp = swing_samples(0.5 * span, step, SETTLE, max_slew)
    rest = round(SETTLE * sample_rate)
    up = swings([v_min, middle, middle], [ramp, rest])
    down = swings([middle, middle, v_min, v_min], [rest, ramp, rest])
    return np.concatenate([up[1:], middle + size * np.sin(2.0 * np.pi * turns), down])


def _check(
    span: float,
    sample_rate: float,
    sweep_to: float,
    crest: float,
    max_slew: float | None,
    unit: str,
) -> None:
    if not 0.0 < sweep_to < math.inf:
        raise UsageError(f"`sweep_to` {sweep_to:g}: give a frequency in Hz above 0")
    if sample_rate < SAMPLES_A_PERIOD * sweep_to * (1.0 - 1e-9):
        raise UsageError(
            f"`sweep_to` {sweep_to:g}: {sample_rate:g} rows a second do not resolve it (`sample_rate` "
            f"{SAMPLES_A_PERIOD * sweep_to:g}, or a sweep to {sample_rate / SAMPLES_A_PERIOD:g})"
        )
    if not 0.0 < crest <= 0.5 * span:
        raise UsageError(
            f"`sweep_amplitude` {crest:g}{unit}: give one above 0, at most {0.5 * span:g}{unit}"
        )
    fastest = 2.0 * math.pi * sweep_to * crest * FADED
    if max_slew is not None and fastest > max_slew:
        raise UsageError(
            f"`sweep_amplitude` {crest:g}{unit}: at {sweep_to:g} Hz it needs {fastest:.6g} {unit}/s, "
            f"`max_slew` allows {max_slew:g} (an amplitude of {crest * max_slew / fastest:.3g}{unit})"
        )
