"""What a model can follow: how fast its corners may be, and how far it reaches."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dbo_cli.errors import UsageError
from dbo_cli.model import Model
from dbo_cli.moves.shapes import Range, Trajectory

RESONANCE_PART = 3.0
"""A model is trusted to its lowest resonance over this. Measured on invented benches."""
REACH_SLACK = 1e-8  # of the range: rounding reaches no further
DIGITS = 6  # of a range that is proposed
ROUNDING = 1e-3  # of such a last digit


def trusted_frequency(models: Sequence[Model]) -> float | None:
    """Return the frequency (Hz) to which all models can be trusted; None where none has a resonance."""
    lowest = []
    for model in models:
        if model.dynamics is not None and model.dynamics.resonances:
            lowest.append(model.dynamics.resonances[0].frequency / RESONANCE_PART)
    return min(lowest, default=None)


def check_reach(move: Trajectory, ends: Range, models: Sequence[Model]) -> None:
    """Refuse a move that a model does not reach, its turns included.

    Parameters
    ----------
    move, ends
        The move, and the range that was asked for.
    models
        The model of each axis, the last one also of the axes after it.

    Raises
    ------
    UsageError
        The move leaves what a model reaches; the message has the range that fits.
    """
    for number, axis in enumerate(move.axes):
        model = models[min(number, len(models) - 1)]
        low, high = model.output.min, model.output.max
        slack = REACH_SLACK * model.output.span
        least, most = float(axis.min()), float(axis.max())
        if least >= low - slack and most <= high + slack:
            continue
        # turns reach beyond a range by a part of it
        span = ends[1] - ends[0]
        below = max(ends[0] - least, 0.0) / span
        above = max(most - ends[1], 0.0) / span
        room = (high - low) / (1.0 + below + above)
        first, last = low + below * room, high - above * room
        if max(first, ends[0]) < min(last, ends[1]):
            first, last = max(first, ends[0]), min(last, ends[1])
        fitting = _rounded_inwards(first, last)
        raise UsageError(
            f"`range` {ends[0]:g}:{ends[1]:g}: the move, {least:.6g} to {most:.6g}, exceeds the "
            f"model, {low:.6g} to {high:.6g}{model.output.suffix}: {fitting} fits"
        )


def _rounded_inwards(low: float, high: float) -> str:
    """Return a range as text with few digits, no wider."""
    size = max(abs(low), abs(high))
    unit = 10.0 ** (math.floor(math.log10(size)) + 1 - DIGITS) if size > 0.0 else 1.0
    low = math.ceil(low / unit - ROUNDING) * unit
    high = math.floor(high / unit + ROUNDING) * unit
    return f"{low:.{DIGITS}g}:{high:.{DIGITS}g}"
