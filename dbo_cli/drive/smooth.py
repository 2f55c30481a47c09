"""Signals that are smooth: half-cosine swings of a voltage, a soft rise, a low-pass without phase."""

import math
from collections.abc import Sequence

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.limits import rounded_down
from dbo_cli.errors import UsageError

REACH = 10.0
"""Periods of the cut-off, over which what a sample does to others dies away."""
MOST_SIGNAL_ROWS = 100_000_000  # of a swing, or that the ends of a signal are held for

OPEN_SEAM = 3.0  # times the largest step inside, from which on a loop does not close
ROUNDED = 1e-9  # of a row: what rounding may add to a number of rows


def swings(turns: Sequence[float], rows: Sequence[int]) -> Floats:
    """Return half-cosine swings through ``turns``, in order; swing i takes ``rows[i]`` steps."""
    voltage = np.empty(1 + sum(rows))
    voltage[0] = turns[0]
    row = 1
    for begin, end, count in zip(turns[:-1], turns[1:], rows, strict=True):
        swing = voltage[row : row + count]
        phase = np.pi * np.arange(1, count + 1) / count
        swing[:] = begin + (end - begin) * (0.5 - 0.5 * np.cos(phase))
        np.clip(swing, min(begin, end), max(begin, end), out=swing)
        swing[-1:] = end
        row += count
    return voltage


def swing_rows(
    distance: float, dt: float, seconds: float, slew: float | None = None
) -> int:
    """Return the steps of a swing that takes ``seconds``, or longer where the slew is limited.

    The steepest part of a swing rises by pi/2 times its mean slope.

    Raises
    ------
    UsageError
        They are more than any memory holds.
    """
    if slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / slew)
    rows = max(math.ceil(seconds / dt - ROUNDED), 1)
    if rows > MOST_SIGNAL_ROWS:
        raise UsageError(
            f"a way of {rows:.4g} rows, at most {MOST_SIGNAL_ROWS:,}: lower `approach`, `lead` or the rate,"
            " or raise `max_slew`"
        )
    return rows


def soft_rise(t: Floats) -> Floats:
    """Return a rise from 0 at t = 0 to 1 at t = 1; speed and acceleration are zero at either end."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t)


def open_seam(period: Floats) -> str:
    """Say by how much the last row of a period does not meet its first; empty where it does."""
    inside = float(np.abs(np.diff(period)).max(initial=0.0))
    seam = abs(float(period[0] - period[-1]))
    if seam <= OPEN_SEAM * inside:
        return ""
    return (
        f"the loop is open: its seam is a step of {seam:.3g}, the largest inside {inside:.3g}: give one "
        "whole period (`rows` A:B leaves a run-in out)"
    )


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
    lowest = 0.0 if loop else REACH * rate / MOST_SIGNAL_ROWS
    if not lowest < cutoff <= 0.5 * rate:
        raise UsageError(
            f"`bandwidth` {cutoff:g}: must be above {lowest:g} and at most half the sample rate, "
            f"{rounded_down(0.5 * rate, 6):.6g}"
        )
    reach = 0 if loop else math.ceil(REACH * rate / cutoff)
    signal = np.pad(x - x[0], reach, mode="edge")
    frequency = np.fft.rfftfreq(signal.size, dt)
    gain = 1.0 / (1.0 + (frequency / cutoff) ** (2 * order))
    smooth = np.fft.irfft(np.fft.rfft(signal) * gain, signal.size)
    result: Floats = x[0] + smooth[reach : reach + x.size]
    return result
