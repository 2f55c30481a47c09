"""Whether a desired signal was sampled more slowly than the log and held in between."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.reports.direction import NoiseLevel
from dbo_cli.reports.running_statistics import Floats

_ALIKE = 0.8  # of all plateaus have about the same length: held; those of a rounded sine differ severalfold
_ABOUT = 0.2  # of the length: a program that polls a setpoint is not punctual
_FEWEST_PLATEAUS = 8
# Where the measurement moves evenly through a plateau, no part of it does more than this much of the mean. A
# measurement that steps with the desired signal, or follows within the plateau, does several times as much.
_EVENLY = 1.5
_DEVIATIONS = 3.0  # of the noise in such a sum


def hold_length(desired: Floats, measured: Floats) -> float | None:
    """Return the samples between new values of a desired signal that is held while the measurement goes on.

    Of such a log only the samples at which the desired signal is new belong together: a value held for L
    samples is late by up to L - 1 of them, although nobody asked for that. Where the measurement moves in
    steps as the desired signal does, the hold is part of what was asked for, and every sample counts. A
    coarsely rounded triangle cannot be told from a held one, and counts as held.

    Returns 1 where every sample counts and None where the desired signal moves too little to tell.
    """
    changes = np.flatnonzero(np.diff(desired)) + 1
    if len(changes) <= _FEWEST_PLATEAUS:
        return None
    lengths = np.diff(changes)
    typical = float(np.median(lengths))
    alike = np.abs(lengths - typical) <= _ABOUT * typical
    if typical < 2.0 or np.mean(alike) < _ALIKE:
        return 1.0
    starts = changes[:-1][alike]
    way = np.sign(desired[starts] - desired[starts - 1])
    # How far the measurement goes the desired signal's way in the 1st, 2nd ... sample of all plateaus.
    steps = np.diff(measured)
    places = range(int(lengths[alike].min()))
    moved = np.array([float((way * steps[starts - 1 + place]).sum()) for place in places])
    noise = NoiseLevel()
    noise.add(measured)
    unsure = _DEVIATIONS * noise.deviation * math.sqrt(2.0 * len(starts))
    evenly = unsure < moved.sum() and moved.max() <= _EVENLY * moved.mean() + unsure
    return float(lengths[alike].mean()) if evenly else 1.0
