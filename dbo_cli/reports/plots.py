"""Figures that one can put into a paper, as PNG and SVG; same values, same bytes.

The look is in ``figures.mplstyle``. The two colours of a comparison differ in lightness
as well as in hue (they survive a grey print and the common colour blindnesses), and in
the pattern of the line. Matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import OutputError
from dbo_cli.files import Outputs
from dbo_cli.reports.words import digits, shown_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dbo_cli.model import Cascade, Quantity
    from dbo_cli.reports.comparison import LogReport, Scores

INK, MUTED, RULE = "#1b1d22", "#5d646f", "#d5d9df"
FIRST, SECOND, FILL = "#00508f", "#e0751a", "#7fa8cc"

SOLID: dict[str, Any] = {"color": FIRST, "linewidth": 1.3}
DASHED: dict[str, Any] = {
    "color": SECOND,
    "linestyle": (0, (3.2, 1.4)),
    "linewidth": 1.3,
}
THIN: dict[str, Any] = {"color": INK, "linewidth": 0.9}
WIDE = (5.0, 2.8)  # inches: two side by side fill a page in print, one a phone
TALL = (5.0, 4.0)  # inches: as wide as those; for loops
FIGURE_COLUMNS = 1000  # a curve keeps the least and the greatest value in each
MOST_POINTS = 20_000  # of a loop that stays lines in an SVG; more become a picture
LOOP_POINTS = 501  # each way of a model's loop

ImageKind = Literal["png", "svg"]


@dataclass(frozen=True)
class Plot:
    """One figure.

    Attributes
    ----------
    key
        Stem of its file name.
    title
        What it shows, in words.
    size
        Width and height in inches.
    paint
        Draws into axes.
    """

    key: str
    title: str
    size: tuple[float, float]
    paint: Callable[[Axes], None]


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Draw in this program's look, whatever the user's own configuration says."""
    from matplotlib import style as styles

    look = Path(__file__).with_name("figures.mplstyle")
    with styles.context(look, after_reset=True):
        yield


def draw(plot: Plot, kind: ImageKind) -> bytes:
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
    plot.paint(axes)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        legend = {"loc": "outside upper left", "columnspacing": 1.6}
        figure.legend(handles, labels, ncols=_legend_columns(labels), **legend)
    return figure


def _legend_columns(labels: Sequence[str]) -> int:
    """Return how many names fit side by side."""
    longest = max(len(label) for label in labels)
    return max(1, min(len(labels), 56 // (longest + 7)))


def save(plots: Sequence[Plot], folder: str | os.PathLike[str]) -> list[Path]:
    """Write every figure as ``KEY.png`` and ``KEY.svg``, all or none; return the files (OutputError)."""
    target = Path(folder)
    is_new = not target.exists()
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise OutputError(
            f"{folder}: {problem.strerror}: `figures` needs a folder"
        ) from None
    kinds: tuple[ImageKind, ...] = ("png", "svg")
    written = []
    try:
        with Outputs() as outputs:
            for plot in plots:
                for kind in kinds:
                    path = target / f"{plot.key}.{kind}"
                    outputs.write_bytes(path, draw(plot, kind))
                    written.append(path)
    except BaseException:
        if is_new:
            with contextlib.suppress(OSError):
                target.rmdir()
        raise
    return written


# --- a report ---


def sections_of_report(report: Scores) -> list[tuple[str, list[Plot]]]:
    """Return the figures of a report with their headings: each log's, then the model's."""
    sections = []
    stems = file_stems([log.name for log in report.logs])
    for log, stem in zip(report.logs, stems, strict=True):
        sections.append((log.name, plots_of_log(report, log, stem)))
    if report.model is not None:
        sections.append(("The model", model_plots(report.model)))
    return sections


def plots_of_report(report: Scores) -> list[Plot]:
    """Return all figures of a report."""
    plots = []
    for _, section in sections_of_report(report):
        plots += section
    return plots


def plots_of_log(report: Scores, log: LogReport, stem: str) -> list[Plot]:
    """Return the figures of one log: both signals, the error, the loop and the spectrum."""
    first, second = report.labels
    error = "Residual of the model" if first == "model" else "Error"
    loop = "Hysteresis loop"
    if log.pair.voltage is None:
        loop = f"{second.capitalize()} against {first}"
    painted = [
        ("follow", f"{first.capitalize()} and {second}", WIDE, _paint_follow),
        ("error", error, WIDE, _paint_error),
        ("loop", loop, TALL, _paint_loop),
    ]
    if spectrum_of(log) is not None:
        painted.append(("spectrum", "Spectrum of the error", WIDE, _paint_spectrum))
    plots = []
    for key, title, size, paint in painted:
        plots.append(Plot(f"{stem}-{key}", title, size, partial(paint, report, log)))
    return plots


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


def _clock_of(log: LogReport) -> tuple[Floats, str]:
    """Return the places of the rows along the axis, and its name."""
    pair = log.pair
    if pair.time is not None:
        return pair.time, "Time (s)"
    return pair.first_row + np.arange(float(len(pair))), "Row"


def envelope(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return a curve as its least and greatest value in each of many columns; a short one as it is."""
    if len(x) <= 4 * FIGURE_COLUMNS:
        return x, y
    edges = np.linspace(0, len(x), FIGURE_COLUMNS + 1).astype(np.int64)[:-1]
    low, high = np.minimum.reduceat(y, edges), np.maximum.reduceat(y, edges)
    heights = np.column_stack([low, high]).ravel()
    return np.repeat(x[edges], 2), heights


def _paint_follow(report: Scores, log: LogReport, axes: Axes) -> None:
    first, second = report.labels
    time, clock = _clock_of(log)
    measured = log.pair.measured - log.merits.offset
    axes.plot(*envelope(time, log.pair.desired), label=first, **SOLID)
    axes.plot(*envelope(time, measured), label=second, **DASHED)
    axes.set(xlabel=clock, ylabel=axis_label("Displacement", report.unit))


def _error_of(log: LogReport) -> Floats:
    """Return measured less desired, the mean taken off where that was asked for."""
    return log.pair.measured - log.pair.desired - log.merits.offset


def _paint_error(report: Scores, log: LogReport, axes: Axes) -> None:
    time, clock = _clock_of(log)
    rmse = log.merits.rmse
    band = f"± RMSE, {digits(rmse, 3)} {shown_unit(report.unit)}".rstrip()
    axes.axhspan(-rmse, rmse, color=FILL, alpha=0.35, linewidth=0.0, label=band)
    axes.plot(*envelope(time, _error_of(log)), **THIN)
    name = "Residual" if report.labels[0] == "model" else "Error"
    axes.set(xlabel=clock, ylabel=axis_label(name, report.unit))


def _paint_loop(report: Scores, log: LogReport, axes: Axes) -> None:
    """Paint measured over the drive; over the desired signal, its own line, where no drive is known."""
    first, second = report.labels
    measured = log.pair.measured - log.merits.offset
    x, name = log.pair.voltage, axis_label("Drive voltage", report.voltage_unit)
    compared = first == "model" or x is None
    if x is None:
        x = log.pair.desired
        name = axis_label(f"{first.capitalize()} displacement", report.unit)
    # many points become a picture inside the SVG, or the file takes megabytes
    as_picture = len(measured) > MOST_POINTS
    if compared:
        axes.plot(x, log.pair.desired, rasterized=as_picture, label=first, **SOLID)
        axes.plot(x, measured, rasterized=as_picture, label=second, **DASHED)
    else:
        axes.plot(x, measured, rasterized=as_picture, **SOLID)
    axes.set(xlabel=name, ylabel=axis_label("Displacement", report.unit))


def spectrum_of(log: LogReport) -> tuple[Floats, Floats] | None:
    """Return frequencies (Hz) and the amplitude density of the error (unit/sqrt(Hz)).

    By Welch's method, the mean of each piece taken off. None without an even clock, with
    fewer than 64 rows, or where the error is constant.
    """
    step, error = log.pair.step(), _error_of(log)
    if step is None or len(error) < 64 or not np.ptp(error):
        return None
    time = log.pair.time
    if time is not None and np.ptp(np.diff(time)) > 0.01 * step:
        return None
    from scipy.signal import welch

    rows = 2 ** int(math.log2(len(error) / 2.0))
    frequency, power = welch(error, 1.0 / step, nperseg=rows)
    return frequency[1:], np.sqrt(power[1:])


def _paint_spectrum(report: Scores, log: LogReport, axes: Axes) -> None:
    curve = spectrum_of(log)
    assert curve is not None
    axes.loglog(*curve, **THIN)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    unit = f"{shown_unit(report.unit)}/√Hz" if report.unit else "1/√Hz"
    axes.set(xlabel="Frequency (Hz)", ylabel=f"Error density ({unit})")


# --- a model ---


def model_plots(model: Cascade) -> list[Plot]:
    """Return the figures of a model: its loop, and what is bent and wide in it."""
    drive = model.input if model.is_forward else model.output
    title = f"The model's loop, {quantity_range(drive)}"
    straight = "Deviation from a straight line"
    return [
        Plot("model-loop", title, TALL, partial(_paint_model, model, False)),
        Plot("model-hysteresis", straight, WIDE, partial(_paint_model, model, True)),
    ]


def quantity_range(quantity: Quantity) -> str:
    """Return a range with its unit."""
    unit = f" {shown_unit(quantity.unit)}" if quantity.unit else ""
    return f"{quantity.min:.4g} to {quantity.max:.4g}{unit}"


def slow_loop(model: Cascade) -> tuple[Floats, Floats, Floats]:
    """Return the drive on the way up, and the displacement there and on the way down.

    Slowly: creep has come to rest; dynamics and delay take no part. Of an inverse model
    the loop of the actuator that it undoes.
    """
    forward = model.forward().static
    drive = forward.input
    up = np.linspace(drive.min, drive.max, LOOP_POINTS)
    walk = np.concatenate([up, up[::-1], up])
    dt = 1e9 if forward.needs_time else None
    y, _ = forward.simulate(walk, dt=dt, state="empty")
    rising = y[2 * LOOP_POINTS :]
    falling = y[LOOP_POINTS : 2 * LOOP_POINTS][::-1]
    return up, rising, falling


def _paint_model(model: Cascade, deviation: bool, axes: Axes) -> None:
    """Paint both ways of the loop, or by how much they deviate from a straight line."""
    forward = model.forward()
    drive, rising, falling = slow_loop(model)
    name = forward.output.quantity.capitalize()
    if deviation:
        line = np.polyfit(drive, 0.5 * (rising + falling), 1)
        rising = rising - np.polyval(line, drive)
        falling = falling - np.polyval(line, drive)
        name = "Deviation"
    axes.plot(drive, rising, label="rising", **SOLID)
    axes.plot(drive, falling, label="falling", **DASHED)
    axes.set(
        xlabel=axis_label(forward.input.quantity.capitalize(), forward.input.unit),
        ylabel=axis_label(name, forward.output.unit),
    )


def plot_model(model: Cascade) -> Figure:
    """Return the model's loop as a figure of matplotlib, for a notebook."""
    with style():
        return figure_of(model_plots(model)[0])
