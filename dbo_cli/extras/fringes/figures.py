"""Figures of fringes: intensity with the fitted fringes, displacement, turns with their odds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from dbo_cli.extras.fringes.assessment import ENOUGH_ODDS
from dbo_cli.extras.fringes.branches import TURN
from dbo_cli.extras.fringes.swings import Floats
from dbo_cli.extras.fringes.track import Track
from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AROUND = 3.0
"""Fringes to either side of the turn that the intensity is shown at."""
MOST_POINTS = 4000


class Recorded(Protocol):
    """The signals of a log."""

    time: Floats
    drive: Floats
    signal: Floats


def plots_of_track(recorded: Recorded, values: Floats, deviation: Floats, track: Track) -> list[Plot]:
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
    shown = _shown_rows(track)
    few = max(values.size // MOST_POINTS, 1)

    def intensity(axes: Axes) -> None:
        fitted = track.channels[0].shown(track.phase)
        axes.plot(recorded.time[shown], recorded.signal[shown], label="recorded", **style.POINTS)
        axes.plot(recorded.time[shown], fitted[shown], label="fitted", **style.SOLID)
        finish(axes, "Time (s)", "Signal")

    def displacement(axes: Axes) -> None:
        axes.plot(recorded.time[::few], values[::few], label="displacement", **style.SOLID)
        for doubted, look in ((False, style.ALONE), (True, style.POINTS)):
            rows = [turn.row for turn in track.turns if (turn.odds < ENOUGH_ODDS) == doubted]
            name = f"odds below {ENOUGH_ODDS:g}:1" if doubted else "turns"
            if rows:
                points = look | {"linestyle": "none", "marker": "o", "markersize": 3.2}
                axes.plot(recorded.time[rows], values[rows], label=name, **points)
        finish(axes, "Time (s)", "Displacement (µm)")

    def against_drive(axes: Axes) -> None:
        axes.plot(recorded.drive[::few], values[::few], **style.SOLID)
        finish(axes, "Drive voltage (V)", "Displacement (µm)")

    def uncertainty(axes: Axes) -> None:
        axes.plot(recorded.time[::few], 1000.0 * deviation[::few], **style.SOLID)
        finish(axes, "Time (s)", "Standard deviation (nm)")

    def odds(axes: Axes) -> None:
        rows = [turn.row for turn in track.turns]
        axes.semilogy(recorded.time[rows], [turn.odds for turn in track.turns], **style.POINTS)
        axes.axhline(ENOUGH_ODDS, **style.DOTTED)
        finish(axes, "Time (s)", "Odds of the branch taken")

    plots = [
        Plot(
            "intensity",
            "Intensity and fitted fringes around the turn of the least odds",
            "The photodiode's signal as points and the fitted fringes as a line, against time.",
            style.WIDE,
            intensity,
        ),
        Plot(
            "displacement",
            "Displacement against time",
            "Displacement against time, with a point at each turn of the drive.",
            style.WIDE,
            displacement,
        ),
        Plot(
            "loop",
            "Displacement against drive voltage",
            "Displacement against drive voltage: the hysteresis loop.",
            style.TALL,
            against_drive,
        ),
        Plot(
            "deviation",
            "Standard deviation against time",
            "Standard deviation of the displacement against time.",
            style.WIDE,
            uncertainty,
        ),
    ]
    if track.turns:
        words = "Odds of the branch taken at each turn of the drive, logarithmic, with a line at 100."
        plots.append(Plot("odds", "Odds at the turns of the drive", words, style.WIDE, odds))
    return plots


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
