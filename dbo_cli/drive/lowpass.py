"""A low-pass without phase."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import UsageError

REACH = 10.0
"""Periods of the cut-off, over which what a sample does to others dies away."""
MOST_ROWS = 100_000_000  # that the ends of a signal are held for


def low_pass(
    x: Floats, cutoff: float, dt: float, loop: bool = False, order: int = 2
) -> Floats:
    """Return a signal smoothed by the gain 1/(1 + (f/cutoff)^2n): a Butterworth filter, run both ways.

    Parameters
    ----------
    x
        The signal; its first and last value hold beyond its ends.
    cutoff
        Hz, where half of the amplitude is left.
    dt
        Seconds between samples.
    loop
        The signal is one period of one that repeats.
    order
        n. Of order 2 nothing overshoots a step by more than 3.4 % of it.

    Raises
    ------
    UsageError
        The cut-off is above half the sampling rate, or too low for it.
    """
    rate = 1.0 / dt
    if not 0.0 < cutoff <= 0.5 * rate:
        raise UsageError(
            f"`bandwidth` {cutoff:g}: must be above 0 and at most half the sample rate, {0.5 * rate:.6g}"
        )
    reach = 0 if loop else math.ceil(REACH * rate / cutoff)
    if reach > MOST_ROWS:
        raise UsageError(
            f"`bandwidth` {cutoff:g}: too low for a sample rate of {rate:.6g} Hz"
        )
    signal = np.pad(x - x[0], reach, mode="edge")
    frequency = np.fft.rfftfreq(signal.size, dt)
    gain = 1.0 / (1.0 + (frequency / cutoff) ** (2 * order))
    smooth = np.fft.irfft(np.fft.rfft(signal) * gain, signal.size)
    result: Floats = x[0] + smooth[reach : reach + x.size]
    return result
