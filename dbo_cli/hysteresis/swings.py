"""Half-cosine swings between turning points: what every drive of this program is made of.

The speed is zero at each turn, so a drive turns exactly where it says, and a slew limit is a matter of making
a swing long enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_WHOLE = 1e-9  # a time this close, in samples, to that of a sample is that of the sample


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


def swing_samples(distance: float, time_step: float, seconds: float, max_slew: float | None = None) -> int:
    """Return how many steps a half-cosine swing takes: ``seconds``, or longer where the slew is limited.

    The steepest part of the swing rises by pi/2 times its mean slope.
    """
    if max_slew is not None:
        seconds = max(seconds, 0.5 * math.pi * abs(distance) / max_slew)
    return max(math.ceil(seconds / time_step - _WHOLE), 1)
