"""Drives with a purpose: conditioning and excitation.

Every drive here is a chain of half-cosine swings between turning points: its speed is zero at each turn, so
it turns exactly where it says, and a slew limit is a matter of making a swing long enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState

Floats = NDArray[np.float64]

JOINING_TURNS = 30
MOST_SAMPLES = 100_000_000
_WHOLE = 1e-9  # a time this close, in samples, to that of a sample is that of the sample


def swings(turns: Sequence[float], samples: Sequence[int]) -> Floats:
    """Return half-cosine swings through ``turns``, in order; swing i takes ``samples[i]`` steps."""
    parts = [np.array(turns[:1], dtype=np.float64)]
    for begin, end, count in zip(turns[:-1], turns[1:], samples, strict=True):
        phase = np.pi * np.arange(1, count + 1) / count
        part = begin + (end - begin) * (0.5 - 0.5 * np.cos(phase))
        part[-1] = end
        parts.append(np.clip(part, min(begin, end), max(begin, end)))
    return np.concatenate(parts)


def swing_samples(distance: float, time_step: float, seconds: float, max_slew: float | None = None) -> int:
    """Return how many steps a half-cosine swing takes: ``seconds``, or longer where the slew is limited.

    The steepest part of the swing rises by pi/2 times its mean slope.
    """
    if max_slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / max_slew)
    return max(math.ceil(seconds / time_step - _WHOLE), 1)


class Conditioned(NamedTuple):
    """A conditioning drive: its times (s, below 0), its voltages, and the state it leaves behind."""

    time: Floats
    voltage: Floats
    state: ModelState


def condition(
    model: ActuatorModel,
    first_desired: float,
    limits: DriveLimits,
    time_step: float,
    sweep_seconds: float = 1.0,
) -> Conditioned:
    """Return the drive that puts an actuator into a known state before a trajectory, and that state.

    It goes from the lower limit over the whole range and back, which wipes out whatever was before (a drive
    at or below X_0 clears every bit), and then up the loading branch to the voltage of ``first_desired``.
    ``compensate`` goes on from the state; the last time is one ``time_step`` before 0.
    """
    model.require("forward")
    operator = model.forward_backlash
    loading = model.inverse().start(first_desired, "empty")
    wanted = model.inverse().simulate([first_desired], loading, time_step=time_step).y[0]
    target = float(min(max(wanted, limits.v_min), limits.v_max))
    low = limits.v_min
    high = min(max(operator.x_range[1], target), limits.v_max)
    # What lags remembers the sweep, so the voltage that the trajectory begins with depends on the sweep, and
    # the sweep shall end at that voltage: a fixed point, found in a few turns since the memory is weak.
    for _ in range(JOINING_TURNS):
        turns = [low, high, low, target]
        counts = [
            swing_samples(
                end - begin, time_step, sweep_seconds * abs(end - begin) / (high - low), limits.max_slew
            )
            for begin, end in pairwise(turns)
        ]
        voltage = swings(turns, counts)
        done = model.simulate(voltage, model.start(low), time_step=time_step)
        follows = model.compensate([first_desired], done.state, limits=limits, time_step=time_step)
        begins = float(follows.y[0])
        if abs(begins - target) <= _WHOLE * (high - low):
            break
        target = begins
    time: Floats = -time_step * np.arange(voltage.size, 0, -1, dtype=np.float64)
    return Conditioned(time, voltage, done.state)


def excitation(
    v_min: float,
    v_max: float,
    sample_rate: float,
    duration: float,
    frequency: float,
    max_slew: float | None = None,
) -> tuple[Floats, Floats]:
    """Return time (s) and voltage of a drive from which a model can be identified well.

    Why this shape. (1) It begins at the lower end and sweeps the whole range twice: that wipes out the past,
    so the state of every gear is known from the first sample on. (2) Amplitudes then decay towards the middle
    of the range: every gear turns at many places, and with several amplitudes at one frequency lag and loop
    width, which one amplitude confounds, come apart. (3) Minor loops hang from the upper and stand on the
    lower end, since the middle alone says little about asymmetry. (4) It ends where it began, so that drift
    of the sensor shows as a difference between equal voltages. Never outside [v_min, v_max].

    Raises
    ------
    UsageError
        The limits are not in order, or the duration holds fewer than six cycles, or a cycle fewer than 20
        samples, or the slew limit does not allow the frequency over the whole range.
    """
    if not (math.isfinite(v_min) and math.isfinite(v_max) and v_min < v_max):
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")
    if not sample_rate / frequency >= 20.0:
        raise UsageError(
            f"`frequency` {frequency!r}: fewer than 20 samples a cycle (raise `sample_rate` or lower it)"
        )
    if duration * sample_rate > MOST_SAMPLES:
        raise UsageError(
            f"`duration` {duration!r} at `sample_rate` {sample_rate!r}: {duration * sample_rate:.3g} "
            "rows are more "
            f"than the {MOST_SAMPLES:,} that are written at most"
        )
    cycles = math.floor(duration * frequency + _WHOLE)
    if cycles < 6:
        raise UsageError(
            f"`duration` {duration!r}: {cycles} cycles of {frequency!r} Hz, at least 6 are needed"
        )
    fastest = math.pi * frequency * (v_max - v_min)
    if max_slew is not None and fastest > max_slew:
        raise UsageError(
            f"`max_slew` {max_slew!r}: the whole range at {frequency!r} Hz needs {fastest:.6g} V/s"
            f" (at most {max_slew / (math.pi * (v_max - v_min)):.6g} Hz)"
        )
    turns = np.array(_excitation_turns(cycles))
    levels = v_min + (v_max - v_min) * turns
    levels[turns == 1.0] = v_max
    ends = np.rint(np.arange(1, turns.size) * sample_rate / (2.0 * frequency)).astype(int)
    counts = np.diff(ends, prepend=0)
    voltage = swings(levels.tolist(), counts.tolist())
    count = max(round(duration * sample_rate), 1)
    voltage = np.concatenate([voltage[:count], np.full(max(count - voltage.size, 0), voltage[-1])])
    return np.arange(count) / sample_rate, np.clip(voltage, v_min, v_max)


def _excitation_turns(cycles: int) -> list[float]:
    """Return the turning points as fractions of the range, two for each cycle, beginning and ending at 0."""
    turns = [0.0, 1.0, 0.0, 1.0, 0.0]
    rest = cycles - 3
    decaying, anchored = rest - rest // 2, rest // 2
    for k in range(decaying):
        amplitude = 0.5 * (1.0 - k / decaying)
        turns += [0.5 + amplitude, 0.5 - 0.5 * (amplitude + 0.5 * (1.0 - (k + 1) / decaying))]
    depths = [0.85 * (1.0 - k / anchored) + 0.1 for k in range(anchored)]
    for depth in depths[::2]:
        turns += [1.0, 1.0 - depth]
    turns += [1.0, 0.0]
    for depth in depths[1::2]:
        turns += [depth, 0.0]
    return turns
