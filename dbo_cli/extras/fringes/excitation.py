"""The drive whose fringes can be counted: slow enough for the sampling, its turns spread over a fringe."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any

import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.extras.fringes.swings import Floats
from dbo_cli.hysteresis.excitation import Excitation, swing_samples, swings
from dbo_cli.logs.units import in_unit

SAMPLES_A_FRINGE = 20.0
"""In the fastest fringe: benchmarks/fringes.py has what fewer cost."""
STEEPEST = 1.5
"""Of the mean slope: how steep displacement over voltage may be somewhere."""
SLOWEST = 0.6
"""Decades by which swings may be slower than the fastest: lag and creep come apart from hysteresis."""
FEWEST_TURNS = 6
"""Besides the sweeps, so that each turn's branch is foretold by others."""
GOLDEN = 0.6180339887498949
"""Steps of it spread evenly over a fringe, however many there are."""
REST = 0.5
"""Periods at rest at the end."""


def drive_for_fringes(
    excitation: Excitation, brought: Mapping[str, Any], points: int | None
) -> tuple[Floats, dict[str, Floats]]:
    """Return time (s) and voltage of a drive for an interferometer without a second photodiode.

    Two sweeps of the whole range, then turns at random levels whose phases are spread
    evenly over a fringe (as far as displacement follows voltage on a line), at speeds
    of a decade's part; back, and a rest.

    Parameters
    ----------
    excitation
        Limits, rate, duration, pace and seed.
    brought
        ``fringes``: the wavelength, and ``stroke``: displacement of the whole range,
        both in um or as texts.
    points
        Must be None: a generator's memory asks for another rate.

    Raises
    ------
    UsageError
        The rate is too low for the stroke, or the duration too short, or options
        exclude each other.
    """
    wavelength = brought.get("fringes")
    stroke = brought.get("stroke")
    if wavelength is None or stroke is None:
        raise UsageError("`fringes` WAVELENGTH and `stroke` LENGTH belong together")
    if (
        points is not None
        or brought.get("channels") is not None
        or excitation.sweep_to is not None
    ):
        raise UsageError("`fringes` excludes `points`, `channels` and `sweep_to`")
    fringes = in_unit("stroke", stroke, "um") / (
        0.5 * in_unit("fringes", wavelength, "um")
    )
    if not 0.0 < fringes < math.inf:
        raise UsageError("`fringes` and `stroke`: give lengths above 0")
    needed = math.pi * excitation.frequency * fringes * SAMPLES_A_FRINGE * STEEPEST
    rate = excitation.sample_rate
    if rate < needed:
        raise UsageError(
            f"`sample_rate` {rate:g}: a sweep of {fringes:.3g} fringes at {excitation.frequency:g} Hz needs "
            f"{needed:.4g} rows a second for {SAMPLES_A_FRINGE:g} in the fastest fringe (that, or "
            f"`frequency` {excitation.frequency * rate / needed:.3g})"
        )
    turns, counts = _turns(excitation, fringes)
    part = swings(turns, counts)
    voltage = np.clip(
        excitation.v_min + excitation.span * part, excitation.v_min, excitation.v_max
    )
    return np.arange(voltage.size) / rate, {"voltage": voltage}


def _turns(drive: Excitation, fringes: float) -> tuple[list[float], list[int]]:
    """Return turns in parts of the range, and the steps from each to the next."""
    chance = random.Random(drive.seed).random
    slew = None if drive.max_slew is None else drive.max_slew / drive.span
    step = 1.0 / drive.sample_rate
    half = 0.5 / drive.frequency

    def steps(distance: float, slowness: float = 1.0) -> int:
        """Return the steps of a swing at the sweep's greatest speed, or slower."""
        return max(swing_samples(distance, step, half * distance * slowness, slew), 10)

    rest = max(round(REST / drive.frequency / step), 1)
    turns = [0.0, 1.0, 0.0]
    counts = [steps(1.0), steps(1.0)]
    left = round(drive.duration * drive.sample_rate) - 1 - sum(counts) - rest
    place = 0
    while True:
        place += 1
        fringe = math.floor(chance() * max(fringes - 1.0, 0.0))
        level = min((fringe + (place * GOLDEN) % 1.0) / fringes, 1.0)
        count = steps(abs(level - turns[-1]), 10.0 ** (SLOWEST * chance()))
        if count + steps(level) > left:
            break
        if abs(level - turns[-1]) * fringes < 0.5:
            continue
        turns.append(level)
        counts.append(count)
        left -= count
    if len(turns) - 3 < FEWEST_TURNS:
        least = drive.duration * (FEWEST_TURNS + 5.0) / len(turns)
        raise UsageError(
            f"`duration` {drive.duration:g}: room for {len(turns) - 3} turns besides the sweeps, and at "
            f"least {FEWEST_TURNS} are needed (some {math.ceil(least)})"
        )
    back = steps(turns[-1])
    return [*turns, 0.0, 0.0], [*counts, back, rest]
