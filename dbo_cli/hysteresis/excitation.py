"""The drive from which a model is identified well: random turns over the whole range at many speeds."""

from __future__ import annotations

import math
import random

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.sweep import sweep
from dbo_cli.hysteresis.swings import Floats, swing_samples, swings

MOST_SAMPLES = 100_000_000
FEWEST_CYCLES = 6  # one for the sweeps and one for return and rest leave four for the random turns
SAMPLES_A_CYCLE = 20  # with fewer, interpolation between samples no longer shows where a swing turns

# Tried on five virtual actuators, two unseen moves, 15 s at 1 kHz, five or six seeds: no holds or longer
# ones, holds of log-uniform length, a second sweep, speeds or levels that fill their range evenly, distances
# between turns that are log-uniform. None was better by more than the seeds scatter, a tenth of the mean.
_FASTEST, _SLOWEST = -0.9, 0.6  # log10 of a swing's time in that of the sweep's part between the same levels
_AT_AN_END = 0.12  # chance that a turn lies at an end of the range: loops that hang there tell of asymmetry
_HOLD_CHANCE = 0.15
_HOLD = 0.4  # periods; only at rest does creep show apart from hysteresis
# Periods at rest at the end, where it began: equal voltages tell drift. Without it, the geometric mean of the
# error was 0.121 % of the stroke, with it 0.113 % (30 runs each).
_REST = 0.5

FASTER = 10.0  # a sweep's highest frequency over that of the loops: their fastest swings have 8 times it

Leg = tuple[float, int]  # a turning point as a part of the range, and the steps on the way there


def excitation(
    v_min: float,
    v_max: float,
    sample_rate: float,
    duration: float,
    frequency: float,
    max_slew: float | None = None,
    seed: int = 1,
    sweep_to: float | None = None,
    sweep_amplitude: float | None = None,
) -> tuple[Floats, Floats]:
    """Return time (s) and voltage of a drive from which a model can be identified well.

    Why this shape. (1) It begins at the lower end and sweeps the whole range: that wipes out the past, so the
    state of every gear is known. (2) Then it turns at random levels, some at the ends: loops of every size,
    nested anywhere, so that gears and asymmetry come apart. (3) Every swing has a speed of its own, spread
    evenly in its logarithm from eight times the sweep's to a quarter, and some turns are held: lag, creep and
    loop width, which one speed confounds, come apart. (4) It returns and rests where it began, so that the
    sensor's drift shows as a difference between equal voltages. Never outside [v_min, v_max].

    What the duration buys, at 1 Hz on five virtual actuators (``benchmarks/tracking.py --excite``), as the
    RMS error of compensated moves that were not in the drive, geometric mean in % of the stroke: 8 s 0.14,
    15 s 0.058, 30 s 0.061. 30 s of decaying amplitudes, as this program made before, give 0.060; what was
    then identified from them gave 0.14.

    Parameters
    ----------
    v_min, v_max : float
        The drive's range, V.
    sample_rate : float
        Rows a second.
    duration : float
        Seconds from the first row to the end of the last.
    frequency : float
        Sweeps over the whole range and back, a second; other swings are faster and slower than that.
    max_slew : float, optional
        Fastest change, V/s: swings that would be faster take longer.
    seed : int
        Chooses turns, speeds and holds; the same seed gives the same drive, byte for byte.
    sweep_to : float, optional
        Highest frequency, Hz, of a small sweep that follows in the middle of the range, for the dynamics; it
        takes 4 s more, below 60 Hz longer (see ``sweep``).
    sweep_amplitude : float, optional
        Of the sweep, V.

    Raises
    ------
    UsageError
        The limits are not in order, or the duration holds fewer than six periods, or a period fewer than 20
        samples, or the slew limit does not allow the sweep; with the values that would do.
    """
    span = _checked(v_min, v_max, sample_rate, duration, frequency, max_slew, seed)
    slew = None if max_slew is None else max_slew / span
    count = round(duration * sample_rate)
    legs = _Planner(1.0 / sample_rate, frequency, slew, seed).legs(count - 1)
    part = swings([0.0, *(turn for turn, _ in legs)], [steps for _, steps in legs])
    voltage = np.clip(v_min + span * part, v_min, v_max)
    voltage[part == 1.0] = v_max
    if sweep_to is not None:
        slower = sweep_to / FASTER
        if 0.0 < slower < frequency:
            raise UsageError(
                f"`sweep_to` {sweep_to:g}: the loops of {frequency:g} Hz are nearly as fast (a sweep to "
                f"{FASTER * frequency:g}, or `frequency` {slower:g} and `duration` "
                f"{duration * frequency / slower:.6g})"
            )
        small = sweep(v_min, v_max, sample_rate, sweep_to, sweep_amplitude, max_slew)
        voltage = np.concatenate([voltage, small])
    elif sweep_amplitude is not None:
        raise UsageError("`sweep_amplitude` is that of a sweep (`sweep_to` HZ)")
    return np.arange(voltage.size) / sample_rate, voltage


class _Planner:
    """Chooses turning points and the steps between them; voltages are parts of the range."""

    def __init__(self, time_step: float, frequency: float, max_slew: float | None, seed: int) -> None:
        self._time_step = time_step
        self._period = 1.0 / frequency
        self._max_slew = max_slew
        self._chance = random.Random(seed).random  # the one generator whose numbers Python never changes

    def legs(self, steps: int) -> list[Leg]:
        """Return two sweeps, random turns, the return and the rest, ``steps`` in all."""
        sweep = self._swing(1.0)
        rest = round(_REST * self._period / self._time_step)
        turns = self._random_turns(steps - 2 * sweep - rest)
        back = self._swing(turns[-1][0])
        turns = _stretched(turns, steps - 2 * sweep - back - rest)
        return [(1.0, sweep), (0.0, sweep), *turns, (0.0, back), (0.0, rest)]

    def _random_turns(self, steps: int) -> list[Leg]:
        """Return turns and holds that take no more than ``steps``, the way back from the last included."""
        turns: list[Leg] = []
        here, used = 0.0, 0
        while True:
            turn = float(self._chance() < 0.5) if self._chance() < _AT_AN_END else self._chance()
            slowness = 10.0 ** (_FASTEST + (_SLOWEST - _FASTEST) * self._chance())
            found = [(turn, self._swing(abs(turn - here), slowness))]
            if self._chance() < _HOLD_CHANCE:
                found.append((turn, round(_HOLD * self._period / self._time_step)))
            used += sum(count for _, count in found)
            if turns and used + self._swing(turn) > steps:
                return turns
            turns += found
            here = turn

    def _swing(self, distance: float, slowness: float = 1.0) -> int:
        seconds = 0.5 * self._period * distance * slowness
        steps = swing_samples(distance, self._time_step, seconds, self._max_slew)
        return max(steps, SAMPLES_A_CYCLE // 2)


def _stretched(legs: list[Leg], steps: int) -> list[Leg]:
    """Return the same legs, each longer by the same part, so that they take ``steps``."""
    ends = np.cumsum([count for _, count in legs])
    ends = ends * steps // ends[-1]
    return [(turn, int(count)) for (turn, _), count in zip(legs, np.diff(ends, prepend=0), strict=True)]


def _checked(
    v_min: float,
    v_max: float,
    sample_rate: float,
    duration: float,
    frequency: float,
    max_slew: float | None,
    seed: int,
) -> float:
    """Return the range, or refuse what cannot be made (UsageError)."""
    span = v_max - v_min
    if not v_min < v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")
    if not math.isfinite(span):
        raise UsageError(f"`v_min` {v_min:g} and `v_max` {v_max:g}: give finite limits")
    given = {"sample_rate": sample_rate, "duration": duration, "frequency": frequency, "max_slew": max_slew}
    for name, value in given.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"`{name}` {value:g}: give a number above 0")
    if seed < 0:
        raise UsageError(f"`seed` {seed}: give a whole number of at least 0")
    if sample_rate / frequency < SAMPLES_A_CYCLE:
        raise UsageError(
            f"`frequency` {frequency:g}: fewer than {SAMPLES_A_CYCLE} samples a cycle (raise `sample_rate` "
            f"to {SAMPLES_A_CYCLE * frequency:g}, or lower it)"
        )
    fastest = math.pi * frequency * span
    if max_slew is not None and fastest > max_slew:
        slowed = _digits_down(max_slew / (math.pi * span))
        raise UsageError(
            f"`max_slew` {max_slew:g}: the whole range at {frequency:g} Hz needs {fastest:.6g} V/s "
            f"(`frequency` {slowed:g} and a `duration` of at least {math.ceil(FEWEST_CYCLES / slowed)})"
        )
    if duration * frequency < FEWEST_CYCLES * (1.0 - 1e-9):
        raise UsageError(
            f"`duration` {duration:g}: {duration * frequency:.3g} cycles of {frequency:g} Hz, at least "
            f"{FEWEST_CYCLES} are needed (a `duration` of {FEWEST_CYCLES / frequency:g})"
        )
    if duration * sample_rate > MOST_SAMPLES:
        raise UsageError(
            f"`duration` {duration:g} at `sample_rate` {sample_rate:g}: {duration * sample_rate:.3g} rows "
            f"are more than the {MOST_SAMPLES:,} that are written at most"
        )
    return span


def _digits_down(value: float) -> float:
    """Return a number no larger, of three digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / unit) * unit:.3g}")
