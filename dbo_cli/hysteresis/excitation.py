"""The drive from which a model is identified well: random turns over the whole range at many speeds."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.swings import Floats, swing_samples, swings

MOST_SAMPLES = 100_000_000
FEWEST_CYCLES = 6  # duration in periods of the full sweep: one for the sweeps, the rest for the turns
SAMPLES_A_CYCLE = 20  # fewer, and a turn is no longer where it says for what interpolates
FASTEST, SLOWEST = -0.9, 0.6  # decimal logarithm of a swing's time over that of a full sweep, range for range
AT_AN_END = 0.12  # chance that a turn lies at an end of the range
HOLD_CHANCE = 0.15
HOLD = 0.8  # half-periods


def excitation(
    v_min: float,
    v_max: float,
    sample_rate: float,
    duration: float,
    frequency: float,
    max_slew: float | None = None,
    seed: int = 0,
) -> tuple[Floats, Floats]:
    _check(v_min, v_max, sample_rate, duration, frequency, max_slew, seed)
    count = round(duration * sample_rate)
    plan = _nested_turns(count - 1, sample_rate, frequency, max_slew, v_max - v_min, seed)
    voltage = v_min + (v_max - v_min) * swings(plan.turns, plan.samples)
    return np.arange(count) / sample_rate, np.clip(voltage, v_min, v_max)


@dataclass
class _Plan:
    """Turning points as fractions of the range, and how many steps lie between them."""

    turns: list[float] = field(default_factory=lambda: [0.0])
    samples: list[int] = field(default_factory=list)
    used: int = 0

    def go(self, turn: float, samples: int) -> None:
        self.turns.append(turn)
        self.samples.append(samples)
        self.used += samples


BLOCK = 8
SPREAD_HOLD = 0.0

def _spread(chance, size):
    """Endless numbers in 0..1, every block of ``size`` spread evenly."""
    while True:
        order = list(range(size))
        for place in range(size - 1, 0, -1):
            other = int(chance() * (place + 1))
            order[place], order[other] = order[other], order[place]
        for place in order:
            yield (place + chance()) / size


def _nested_turns(steps, sample_rate, frequency, max_slew, span, seed) -> _Plan:
    chance = random.Random(seed).random
    slew = None if max_slew is None else max_slew / span
    half = 0.5 / frequency
    levels, speeds, holds = _spread(chance, BLOCK), _spread(chance, BLOCK), _spread(chance, BLOCK)

    def swing(turn: float, logarithm: float = 0.0) -> int:
        distance = abs(turn - here)
        count = swing_samples(distance, 1.0 / sample_rate, half * distance * 10.0**logarithm, slew)
        return max(count, SAMPLES_A_CYCLE // 2)

    here = 0.0
    whole = swing(1.0)
    plan = [(1.0, whole), (0.0, whole)]
    used = 2 * whole
    while True:
        level = next(levels)
        turn = min(max((level - AT_AN_END / 2) / (1.0 - AT_AN_END), 0.0), 1.0)
        samples = swing(turn, FASTEST + (SLOWEST - FASTEST) * next(speeds))
        here = turn
        plan.append((turn, samples))
        used += samples
        if next(holds) < HOLD_CHANCE:
            hold = round(HOLD * half * sample_rate * 10.0 ** (SPREAD_HOLD * (chance() - 0.5)))
            plan.append((turn, hold))
            used += hold
        if used + swing(0.0) > steps:
            break
    plan.append((0.0, swing(0.0)))
    used += plan[-1][1]
    while used > steps:
        used -= plan.pop(-2)[1]
    here = plan[-2][0]
    used += swing(0.0) - plan[-1][1]
    plan[-1] = (0.0, swing(0.0))
    extra = steps - used
    inner = sum(n for _, n in plan[2:-1])
    out = _Plan()
    done = given = 0
    for k, (turn, n) in enumerate(plan):
        if 2 <= k < len(plan) - 1:
            done += n
            more = extra * done // inner
            n += more - given
            given = more
        out.go(turn, n)
    if out.used < steps:
        out.go(0.0, steps - out.used)
    return out


def _check(v_min, v_max, sample_rate, duration, frequency, max_slew, seed): pass
