"""What the limits of a drive cut off a move: by how much the displacement misses what is wanted."""

from __future__ import annotations

import math

import numpy as np

from dbo_cli.hysteresis.dynamics import SectionStates
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel

ALLOWED_PART = 0.01
"""Of the move: so much of it (RMS) may be cut off without being asked for. The order of the error that is
left where a model is good; chosen."""


STREAMED_ROWS = 100
"""Rows: what a stream has lost is a mean over at least so many, so that one row does not end it; chosen."""


class CutOff:
    """Adds up by how much a move misses what is wanted.

    Parameters
    ----------
    model : ActuatorModel
        A forward model.

    Attributes
    ----------
    squares : float
        The sum of the squares of what each row misses, in the displacement's unit.
    most : float
        The most that a row misses.
    """

    def __init__(self, model: ActuatorModel) -> None:
        self._dynamics = model.dynamics
        self._sections: SectionStates | None = None
        self.squares = 0.0
        self.most = 0.0

    def add(self, missed: Floats, time_step: float | Floats | None) -> Floats:
        """Add consecutive rows, from the first one on that is clipped; return what they miss.

        Parameters
        ----------
        missed
            What the gears and the points were to reach, less what they do; what lies behind them answers as
            it answers everything else.
        time_step
            Seconds since the row before.
        """
        if self._dynamics is not None and time_step is not None:
            if self._sections is None:
                self._sections = self._dynamics.run(np.zeros(1), 1.0, None)[1]
            missed, self._sections = self._dynamics.run(missed, time_step, self._sections)
        self.add_displacement(missed)
        return missed

    def add_displacement(self, missed: Floats) -> None:
        """Add rows of which the displacement itself is known to miss so much."""
        self.squares += float(missed @ missed)
        self.most = max(self.most, float(np.abs(missed).max(initial=0.0)))

    def rms(self, rows: int) -> float:
        """Return the root of the mean square over the rows of a move."""
        return math.sqrt(self.squares / max(rows, 1))


def first_beyond(squares: float, rows: int, missed: Floats, allowed: float) -> int | None:
    """Return the first of the rows ``missed`` at which the RMS of a stream so far is more than ``allowed``.

    Parameters
    ----------
    squares, rows
        The sum of squares, and the rows, before these.
    """
    sums = squares + np.cumsum(missed * missed)
    counts = np.maximum(rows + np.arange(1.0, missed.size + 1.0), STREAMED_ROWS)
    beyond = sums > allowed * allowed * counts
    return int(np.argmax(beyond)) if beyond.any() else None
