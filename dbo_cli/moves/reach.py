"""How far a model reaches."""

from __future__ import annotations

from collections.abc import Sequence

from dbo_cli.errors import UsageError
from dbo_cli.model import Cascade
from dbo_cli.moves.shapes import Trajectory

RANGE_ROUNDING = 1e-8  # of the range: rounding reaches no further


def check_reach(move: Trajectory, models: Sequence[Cascade]) -> None:
    """Refuse a move that a model does not reach, its turns included.

    Parameters
    ----------
    move
        The move.
    models
        The model of each axis, the last one also of the axes after it.

    Raises
    ------
    UsageError
        The move leaves what a model reaches.
    """
    for number, axis in enumerate(move.axes):
        output = models[min(number, len(models) - 1)].output
        slack = RANGE_ROUNDING * output.span
        lowest, highest = float(axis.min()), float(axis.max())
        if lowest < output.min - slack or highest > output.max + slack:
            raise UsageError(
                f"the move goes from {lowest:.6g} to {highest:.6g}, the model from {output.min:.6g} to "
                f"{output.max:.6g}{output.suffix}: narrow `range`"
            )
