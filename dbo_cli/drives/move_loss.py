"""What a move loses where its drive is clipped: by how much the displacement misses what is wanted."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.hysteresis.dynamics import SectionStates
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be lost without being asked for. The order of the error that is
left where a model is good; chosen.
"""


STREAMED_ROWS = 100
"""Rows: what a stream has lost is a mean over at least so many, so that one row does not end it; chosen."""


class MoveLoss:
    """Adds up what a move loses.

    It knows only of the rows added: those from the block of the first clipped row on,
    whatever rows of that block come before it. All rows before lose nothing; they count
    in ``rms`` by their number.

    Parameters
    ----------
    model : ActuatorModel
        A forward model.

    Attributes
    ----------
    squares : float
        The sum of the squares of what each row loses, in the displacement's unit.
    most : float
        The most that a row loses, in the same unit.
    """

    def __init__(self, model: ActuatorModel) -> None:
        self._dynamics = model.dynamics
        self._sections: SectionStates | None = None
        self.squares = 0.0
        self.most = 0.0

    def add(self, lost: Floats, time_step: float | Floats | None) -> Floats:
        """Add consecutive rows; return what they lose.

        The first call brings the whole block of the first clipped row, the next ones
        every block after it.

        Parameters
        ----------
        lost
            What the gears and the points were to reach, less what they do; what lies
            behind them answers as it answers everything else.
        time_step
            Seconds since the row before.
        """
        if self._dynamics is not None and time_step is not None:
            if self._sections is None:
                self._sections = self._dynamics.run(np.zeros(1), 1.0, None)[1]
            lost, self._sections = self._dynamics.run(lost, time_step, self._sections)
        self.add_displacement(lost)
        return lost

    def add_displacement(self, lost: Floats) -> None:
        """Add rows of which it is known how much displacement they lose."""
        self.squares += float(lost @ lost)
        self.most = max(self.most, float(np.abs(lost).max(initial=0.0)))

    def rms(self, rows: int) -> float:
        """Return the root of the mean square over all rows of a move, clipped or not."""
        return math.sqrt(self.squares / max(rows, 1))


def first_beyond(squares: float, rows: int, lost: Floats, allowed: float) -> int | None:
    """Return the first of the rows ``lost`` at which the RMS of a stream so far is more than ``allowed``.

    Parameters
    ----------
    squares, rows
        The sum of squares, and the rows, before these.
    """
    sums = squares + np.cumsum(lost * lost)
    counts = np.maximum(rows + np.arange(1.0, lost.size + 1.0), STREAMED_ROWS)
    beyond = sums > allowed * allowed * counts
    return int(np.argmax(beyond)) if beyond.any() else None
