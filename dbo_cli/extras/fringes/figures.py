"""Figures of fringes: intensity with the fitted fringes, displacement, turns with their odds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from dbo_cli.extras.fringes.assessment import ENOUGH_ODDS
from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.swings import Floats
from dbo_cli.extras.fringes.track import Track
from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import finish, label_decades

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AROUND = 3.0
"""Fringes to either side of the turn that the intensity is shown at."""
MOST_POINTS = 4000
"""Of a curve; more cannot be seen."""


class Recorded(Protocol):
    """The signals of a log."""

    @property
    def time(self) -> Floats:
        """Seconds."""

    @property
    def drive(self) -> Floats:
        """Volts."""

    @property
    def signal(self) -> Floats:
        """The photodiode's."""


def plots_of_track(
    recorded: Recorded, values: Floats, deviation: Floats, track: Track
) -> list[Plot]:
    """Return the figures of one log.

    Parameters
    ----------
    recorded
        Time, drive and photodiode.
    values, deviation
        The displacement and its standard deviation, um.
    track
        The phase that it comes from.
    """
    view = _View(recorded, values, deviation, track)
    signal = "The photodiode's signal as points and the fitted fringes as a line, against time."
    marked = "Displacement against time, with a point at each turn of the drive."
    loop = "Displacement against drive voltage: the hysteresis loop."
    spread = "Standard deviation of the displacement against time."
    odds = "Odds of the branch taken at each turn of the drive, logarithmic, with a line at 100."
    around = "Intensity and fitted fringes around the turn of the least odds"
    plots = [
        Plot("intensity", around, signal, style.WIDE, view.intensity),
        Plot(
            "displacement",
            "Displacement against time",
            marked,
            style.WIDE,
            view.displacement,
        ),
        Plot("loop", "Displacement against drive voltage", loop, style.TALL, view.loop),
        Plot(
            "deviation",
            "Standard deviation against time",
            spread,
            style.WIDE,
            view.spread,
        ),
    ]
    if track.turns:
        plots.append(
            Plot("odds", "Odds at the turns of the drive", odds, style.WIDE, view.odds)
        )
    return plots


class _View:
    """What the figures of a log are painted from."""

    def __init__(
        self, recorded: Recorded, values: Floats, deviation: Floats, track: Track
    ) -> None:
        self.recorded = recorded
        self.values = values
        self.deviation = deviation
        self.track = track
        self.few = slice(None, None, max(values.size // MOST_POINTS, 1))

    def intensity(self, axes: Axes) -> None:
        """Paint the photodiode's rows and the fitted fringes."""
        rows = _shown_rows(self.track)
        time = self.recorded.time[rows]
        fitted = self.track.channels[0].shown(self.track.phase)[rows]
        axes.plot(time, self.recorded.signal[rows], label="recorded", **style.POINTS)
        axes.plot(time, fitted, label="fitted", **style.SOLID)
        finish(axes, "Time (s)", "Signal")

    def displacement(self, axes: Axes) -> None:
        """Paint the displacement, and its turns as points."""
        time = self.recorded.time
        axes.plot(
            time[self.few], self.values[self.few], label="displacement", **style.SOLID
        )
        sure = [turn.row for turn in self.track.turns if turn.odds >= ENOUGH_ODDS]
        doubtful = [turn.row for turn in self.track.turns if turn.odds < ENOUGH_ODDS]
        dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.2}
        if sure:
            axes.plot(
                time[sure], self.values[sure], label="turns", color=style.INK, **dots
            )
        if doubtful:
            name = f"odds below {ENOUGH_ODDS:g}:1"
            axes.plot(
                time[doubtful],
                self.values[doubtful],
                label=name,
                color=style.SECOND,
                **dots,
            )
        finish(axes, "Time (s)", "Displacement (µm)")

    def loop(self, axes: Axes) -> None:
        """Paint displacement against drive."""
        axes.plot(self.recorded.drive[self.few], self.values[self.few], **style.SOLID)
        finish(axes, "Drive voltage (V)", "Displacement (µm)")

    def spread(self, axes: Axes) -> None:
        """Paint the standard deviation."""
        axes.plot(
            self.recorded.time[self.few],
            1000.0 * self.deviation[self.few],
            **style.SOLID,
        )
        finish(axes, "Time (s)", "Standard deviation (nm)")

    def odds(self, axes: Axes) -> None:
        """Paint the odds at the turns."""
        rows = [turn.row for turn in self.track.turns]
        axes.semilogy(
            self.recorded.time[rows],
            [turn.odds for turn in self.track.turns],
            **style.POINTS,
        )
        axes.axhline(ENOUGH_ODDS, **style.DOTTED)
        label_decades(axes.yaxis)
        finish(axes, "Time (s)", "Odds of the branch taken")


def _shown_rows(track: Track) -> slice:
    """Return the rows around the turn of the least odds; without turns, around the slowest row."""
    if track.turns:
        row = min(track.turns, key=lambda turn: turn.odds).row
    else:
        row = int(np.argmin(np.abs(np.gradient(track.phase))))
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.phase)))]) / TURN
    begin = int(np.searchsorted(travel, travel[row] - AROUND))
    end = int(np.searchsorted(travel, travel[row] + AROUND))
    return slice(begin, min(end + 1, begin + MOST_POINTS))
