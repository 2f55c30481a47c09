"""A zero-phase low-pass: what rounds the corners of a trajectory and bounds what is learned."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis import kernel
from dbo_cli.hysteresis.dynamics import with_future

Floats = NDArray[np.float64]
Payload = TypeVar("Payload")

LEFT_OVER = 1e-10  # of the weight in the middle, at which the weights are cut off
LONGEST_REACH = 20_000  # samples on either side; the work of a sample grows with them


class ZeroPhaseLowPass:
    """A symmetric low-pass of gain 1/(1 + (f/f_c)^2n): a Butterworth filter of order n, run both ways.

    Its weights are the two-sided impulse response, the sum over the stable poles s of Re(-s e^(s|t|)), taken
    at the samples and made to add up to 1. A constant comes through unchanged, to the last bit. Of order 2
    nothing overshoots a step by more than 3.4 % of it.

    Parameters
    ----------
    cutoff : float
        f_c in Hz, where half of the amplitude is left.
    time_step : float
        Seconds between samples.
    order : int
        n, an even number.

    Raises
    ------
    UsageError
        The cut-off is above half the sampling rate, or so low that a sample would need 20,000 neighbours.
    """

    def __init__(self, cutoff: float, time_step: float, order: int = 2) -> None:
        rate = 1.0 / time_step
        if not 0.0 < cutoff <= 0.5 * rate:
            raise UsageError(
                f"`bandwidth` {cutoff:g}: above half the sampling rate of {rate:.6g} Hz (at most "
                f"{0.5 * rate:.6g})"
            )
        angles = [math.pi * (2 * k + 1 + order) / (2 * order) for k in range(order // 2)]
        poles = [2.0 * math.pi * cutoff * time_step * cmath.exp(1j * angle) for angle in angles]
        self.reach = math.ceil(math.log(LEFT_OVER) / max(pole.real for pole in poles))
        if self.reach > LONGEST_REACH:
            lowest = cutoff * self.reach / LONGEST_REACH
            raise UsageError(
                f"`bandwidth` {cutoff:g}: too low for a sampling rate of {rate:.6g} Hz (at least "
                f"{lowest:.3g}, or `resample` at a lower rate)"
            )
        at, middle = np.arange(1.0, self.reach + 1.0), -sum(pole.real for pole in poles)
        weight = sum(((-pole * np.exp(pole * at)).real for pole in poles), np.zeros(self.reach)) / middle
        self.cutoff, self.weight = cutoff, weight / (1.0 + 2.0 * math.fsum(weight.tolist()))

    def run(self, x: Floats) -> Floats:
        """Return all but the first and the last ``reach`` samples, smoothed."""
        y = np.empty(x.size - 2 * self.reach)
        kernel.CHOSEN.smooth(self.weight, np.ascontiguousarray(x), y)
        return y

    def whole(self, x: Floats) -> Floats:
        """Return a whole signal smoothed; the first and the last value hold beyond its ends."""
        return self.run(np.pad(x, self.reach, mode="edge"))

    def loop(self, x: Floats) -> Floats:
        """Return one period of a signal that repeats, smoothed."""
        return self.run(np.pad(x, self.reach, mode="wrap"))

    def blocks(self, blocks: Iterable[tuple[Payload, Floats]]) -> Iterator[tuple[Payload, Floats]]:
        """Smooth a signal block by block; the bits do not depend on how it is cut. See ``whole``."""
        past: Floats | None = None
        for payload, values in with_future(blocks, self.reach):
            if past is None:
                past = np.full(self.reach, values[0])
            known = np.concatenate([past, values])
            count = values.size - self.reach
            yield payload, self.run(known)
            past = known[count : count + self.reach]
