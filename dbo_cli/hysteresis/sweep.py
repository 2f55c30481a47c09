"""A small sweep about the middle of the range, from which an actuator's dynamics are identified."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.swings import Floats, swing_samples, swings

SWEEP_SECONDS = 2.0
SWEEP_PERIODS = 120.0
"""Of the highest frequency, at least: 26 periods in all. Below 60 Hz the sweep is longer than 2 s; 2 s up to
40 Hz showed no resonance at 20 Hz."""
OCTAVES_DOWN = 100.0
"""The sweep begins at its end over this: there the gears alone answer, and the ratio of the two is known."""
AMPLITUDE = 0.01
"""Of the range, from the middle to the crest, at the lower end of the sweep.

A resonance of damping 0.02 makes a quarter of the range of it, at a place where the gears hardly turn.
"""
FADED = 0.25
"""Of the amplitude, at the upper end: it falls with the logarithm of the frequency, since what a resonance
makes of it grows and what the gears do does not."""
SAMPLES_A_PERIOD = 10.0  # of the sweep's highest frequency, so that a resonance there is resolved
TAPER = 0.05  # of the sweep at either end, over which it rises and falls: no jump that would ring
SETTLE = 0.3  # s at rest before and after it, for creep to slow down


def sweep(
    v_min: float,
    v_max: float,
    sample_rate: float,
    sweep_to: float,
    amplitude: float | None = None,
    max_slew: float | None = None,
) -> Floats:
    """Return the voltage of a way up to the middle, a logarithmic sweep there, and the way back to ``v_min``.

    Parameters
    ----------
    v_min, v_max : float
        The drive's range, V; the drive is at rest at ``v_min`` before and after.
    sample_rate : float
        Rows a second.
    sweep_to : float
        Highest frequency, Hz.
    amplitude : float, optional
        From the middle to a crest at the sweep's lower end, V; by default 1 % of the range.
    max_slew : float, optional
        Fastest change, V/s.

    Raises
    ------
    UsageError
        The rate does not resolve the frequency, or the amplitude is none or too large, or too fast; with the
        values that would do.
    """
    span = v_max - v_min
    crest = AMPLITUDE * span if amplitude is None else amplitude
    _check(span, sample_rate, sweep_to, crest, max_slew)
    step, middle = 1.0 / sample_rate, v_min + 0.5 * span
    seconds = max(SWEEP_SECONDS, SWEEP_PERIODS / sweep_to)
    count = round(seconds * sample_rate)
    part = np.arange(count) / count
    grown = math.log(OCTAVES_DOWN)
    begin = sweep_to / OCTAVES_DOWN
    turns = begin * seconds / grown * np.expm1(grown * part)
    edge = np.clip(np.minimum(part, 1.0 - part) / TAPER, 0.0, 1.0)
    size = crest * FADED**part * (0.5 - 0.5 * np.cos(np.pi * edge))
    way = swing_samples(0.5 * span, step, SETTLE, max_slew)
    rest = round(SETTLE * sample_rate)
    up = swings([v_min, middle, middle], [way, rest])
    down = swings([middle, middle, v_min, v_min], [rest, way, rest])
    voltage: Floats = np.concatenate([up[1:], middle + size * np.sin(2.0 * np.pi * turns), down])
    return voltage


def _check(span: float, sample_rate: float, sweep_to: float, crest: float, max_slew: float | None) -> None:
    if not 0.0 < sweep_to < math.inf:
        raise UsageError(f"`sweep_to` {sweep_to:g}: give a frequency in Hz above 0")
    if sample_rate < SAMPLES_A_PERIOD * sweep_to * (1.0 - 1e-9):
        raise UsageError(
            f"`sweep_to` {sweep_to:g}: {sample_rate:g} rows a second do not resolve it (`sample_rate` "
            f"{SAMPLES_A_PERIOD * sweep_to:g}, or a sweep to {sample_rate / SAMPLES_A_PERIOD:g})"
        )
    if not 0.0 < crest <= 0.5 * span:
        raise UsageError(f"`sweep_amplitude` {crest:g}: give volts above 0, at most {0.5 * span:g}")
    fastest = 2.0 * math.pi * sweep_to * crest * FADED
    if max_slew is not None and fastest > max_slew:
        raise UsageError(
            f"`sweep_amplitude` {crest:g}: at {sweep_to:g} Hz it needs {fastest:.6g} V/s, `max_slew` allows "
            f"{max_slew:g} (an amplitude of {crest * max_slew / fastest:.3g})"
        )
