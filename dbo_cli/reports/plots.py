"""Figures that one can put into a paper, as PNG and SVG; same values, same bytes.

The look is in ``figures.mplstyle``. The two colours of a comparison differ in lightness
as well as in hue (they survive a grey print and the common colour blindnesses), and in
the pattern of the line. Matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import io
import math
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.reports.pair import Pair
from dbo_cli.reports.words import digits, shown_unit
from dbo_cli.signals import even

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dbo_cli.model import Cascade

INK, MUTED, RULE = "#1b1d22", "#5d646f", "#d5d9df"
FIRST, SECOND, FILL = "#00508f", "#e0751a", "#7fa8cc"

SOLID: dict[str, Any] = {"color": FIRST, "linewidth": 1.3}
DASHED: dict[str, Any] = {**SOLID, "color": SECOND, "linestyle": (0, (3.2, 1.4))}
THIN: dict[str, Any] = {"color": INK, "linewidth": 0.9}
WIDE = (5.0, 2.8)  # inches: two side by side fill a page in print, one a phone
TALL = (5.0, 4.0)  # inches: as wide as those; for loops
MOST_POINTS = 20_000  # of a curve that stays a line in an SVG; more become a picture
LOOP_POINTS = 501  # each way of a model's loop

Line = tuple[Floats, Floats, str | None, dict[str, Any]]
"""Values along both axes, the name in the legend, and how the line looks."""


@dataclass(frozen=True)
class Plot:
    """One figure.

    Attributes
    ----------
    key
        Stem of its file name.
    title
        What it shows, in words.
    labels
        Of both axes.
    curves
        What is drawn.
    size
        Width and height in inches.
    band
        Half height of a band about 0, and its name.
    logarithmic
        Whether both axes are.
    """

    key: str
    title: str
    labels: tuple[str, str]
    curves: tuple[Line, ...]
    size: tuple[float, float] = WIDE
    band: tuple[float, str] | None = None
    logarithmic: bool = False


def style() -> AbstractContextManager[None]:
    """Draw in this program's look, whatever the user's own configuration says."""
    from matplotlib import style as styles

    look = Path(__file__).with_name("figures.mplstyle")
    return styles.context(look, after_reset=True)


def draw(plot: Plot, kind: str) -> bytes:
    """Return a figure as PNG or as SVG."""
    metadata = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    out = io.BytesIO()
    with style():
        figure_of(plot).savefig(out, format=kind, metadata=metadata)
    return out.getvalue()


def image(plot: Plot) -> str:
    """Return a figure as an element of a page, which needs no other file."""
    svg = b64encode(draw(plot, "svg")).decode()
    return f'<img alt="{escape(plot.title)}" src="data:image/svg+xml;base64,{svg}">'


def figure_of(plot: Plot) -> Figure:
    """Return a painted figure that belongs to no window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=plot.size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if plot.band is not None:
        half, name = plot.band
        axes.axhspan(-half, half, color=FILL, alpha=0.35, linewidth=0.0, label=name)
    for x, y, label, look in plot.curves:
        # many points become a picture inside the SVG, or the file takes megabytes
        axes.plot(x, y, label=label, rasterized=len(x) > MOST_POINTS, **look)
    if plot.logarithmic:
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
    axes.set(xlabel=plot.labels[0], ylabel=plot.labels[1])
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        place = {"loc": "outside upper left", "columnspacing": 1.6}
        figure.legend(handles, labels, ncols=len(labels), **place)
    return figure


def drawn(plots: Sequence[Plot]) -> dict[str, bytes]:
    """Draw every figure as ``KEY.png`` and ``KEY.svg``; return the files by name."""
    files = {}
    for plot in plots:
        for kind in ("png", "svg"):
            files[f"{plot.key}.{kind}"] = draw(plot, kind)
    return files


# --- a log ---


def plots_of_log(
    pair: Pair,
    log: Mapping[str, Any],
    first: str,
    units: tuple[str | None, str | None],
    stem: str,
) -> list[Plot]:
    """Return the figures of one log: both signals, the error, the loop and the spectrum.

    Parameters
    ----------
    pair, log
        The rows that were compared, and the figures of ``merits``.
    first
        What measured is compared with.
    units
        Of the displacements and of the drive.
    stem
        Of the names of their files.
    """
    unit, voltage_unit = units
    offset, rmse = log["offset_removed"], log["rmse"]
    desired, measured, drive = pair.desired, pair.measured - offset, pair.voltage
    error = pair.measured - desired - offset
    time, clock = pair.time, "Time (s)"
    if time is None:
        time, clock = pair.first_row + np.arange(float(len(pair))), "Row"
    residual = "Residual" if first == "model" else "Error"
    height = axis_label("Displacement", unit)
    band = f"± RMSE, {digits(rmse, 3)} {shown_unit(unit)}".rstrip()
    names = first, "measured"
    title, labels = f"{first.capitalize()} and measured", (clock, height)
    curves = both(time, desired, measured, names)
    plots = [Plot(f"{stem}-follow", title, labels, curves)]
    line, labels = (time, error, None, THIN), (clock, axis_label(residual, unit))
    plots.append(Plot(f"{stem}-error", residual, labels, (line,), band=(rmse, band)))
    # measured over the drive; over the desired signal, its own line, where no drive is known
    if drive is None:
        title = f"Measured against {first}"
        label = axis_label(f"{first.capitalize()} displacement", unit)
        curves = both(desired, desired, measured, names)
    else:
        title, label = "Hysteresis loop", axis_label("Drive voltage", voltage_unit)
        curves = ((drive, measured, None, SOLID),)
        if first == "model":
            curves = both(drive, desired, measured, names)
    plots.append(Plot(f"{stem}-loop", title, (label, height), curves, TALL))
    spectrum = spectrum_of(error, pair.time)
    if spectrum is not None:
        density = f"{shown_unit(unit) or '1'}/√Hz"
        title, line = "Spectrum of the error", (*spectrum, None, THIN)
        labels = "Frequency (Hz)", f"Error density ({density})"
        key = f"{stem}-spectrum"
        plots.append(Plot(key, title, labels, (line,), logarithmic=True))
    return plots


def both(
    x: Floats, first: Floats, second: Floats, names: tuple[str, str]
) -> tuple[Line, ...]:
    """Return two curves side by side, with their names in the legend."""
    return (x, first, names[0], SOLID), (x, second, names[1], DASHED)


def file_stems(names: Sequence[str]) -> list[str]:
    """Return a stem for the files of every log, numbered where there are several."""
    stems = []
    for number, name in enumerate(names, 1):
        base = name.replace("\\", "/").rsplit("/", 1)[-1].partition(".")[0]
        stem = re.sub(r"\W+", "_", base) or "log"
        stems.append(stem if len(names) == 1 else f"{number}-{stem}")
    return stems


def axis_label(quantity: str, unit: str | None) -> str:
    """Return a quantity with its unit in brackets."""
    if not unit:
        return quantity
    return f"{quantity} ({shown_unit(unit)})"


def spectrum_of(error: Floats, time: Floats | None) -> tuple[Floats, Floats] | None:
    """Return frequencies (Hz) and the amplitude density of the error (unit/sqrt(Hz)).

    By Welch's method, the mean of each piece taken off. None without an even clock, with
    fewer than 64 rows, or where the error is constant.
    """
    step = None if time is None else even(time)
    if step is None or len(error) < 64 or not np.ptp(error):
        return None
    from scipy.signal import welch

    rows = 2 ** int(math.log2(len(error) / 2.0))
    frequency, power = welch(error, 1.0 / step, nperseg=rows)
    return frequency[1:], np.sqrt(power[1:])


# --- a model ---


def model_plots(model: Cascade) -> list[Plot]:
    """Return the figures of a model: its loop, and by how much that deviates from a straight line."""
    forward = model.forward()
    into, out = forward.input, forward.output
    drive, rising, falling = slow_loop(forward)
    line = np.polyval(np.polyfit(drive, 0.5 * (rising + falling), 1), drive)
    ends = f"{into.min:.4g} to {into.max:.4g} {shown_unit(into.unit)}".rstrip()
    along = axis_label(into.quantity.capitalize(), into.unit)
    labels = along, axis_label(out.quantity.capitalize(), out.unit)
    names = "rising", "falling"
    curves = both(drive, rising, falling, names)
    loop = Plot("model-loop", f"The model's loop, {ends}", labels, curves, TALL)
    title = "Deviation from a straight line"
    labels = along, axis_label("Deviation", out.unit)
    curves = both(drive, rising - line, falling - line, names)
    return [loop, Plot("model-hysteresis", title, labels, curves)]


def slow_loop(model: Cascade) -> tuple[Floats, Floats, Floats]:
    """Return the drive on the way up, and the displacement there and on the way down.

    Slowly: creep has come to rest; dynamics and delay take no part.
    """
    static = model.static
    drive = static.input
    up = np.linspace(drive.min, drive.max, LOOP_POINTS)
    walk = np.concatenate([up, up[::-1], up])
    dt = 1e9 if static.needs_time else None
    y, _ = static.simulate(walk, dt=dt, state="empty")
    rising = y[2 * LOOP_POINTS :]
    falling = y[LOOP_POINTS : 2 * LOOP_POINTS][::-1]
    return up, rising, falling


def plot_model(model: Cascade) -> Figure:
    """Return the model's loop as a figure of matplotlib, for a notebook."""
    with style():
        return figure_of(model_plots(model)[0])
