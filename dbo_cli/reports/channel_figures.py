"""Figures of a report over channels: how their errors are spread, and which channels they are."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.reports import drawing as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import BARS, axis_label, label_decades, mark_curves, shown_unit
from dbo_cli.reports.renderers import digits, short_name
from dbo_cli.reports.report import Report
from dbo_cli.reports.running_statistics import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMED = 20  # channels up to which bars are drawn, so that each has its name, though they are numbers
LETTERS = 52  # of 9 points, in a row below the axes
DECADES = 30.0  # times the least RMSE, from which on even steps would put all but the worst into one bar


def plots_of_channels(report: Report) -> list[Plot]:
    """Return histograms of the channels' RMSE, in % of range and in the unit, and a map of it.

    Numbered channels stand in the order of their numbers. Without any range the map is in the unit.
    """
    names = [log.name for log in report.logs]
    numbers = [int(name) for name in names] if all(n.isascii() and n.isdigit() for n in names) else []
    order = sorted(range(len(names)), key=numbers.__getitem__) if numbers else range(len(names))
    names, numbers = [names[k] for k in order], sorted(numbers)
    figures = [report.logs[k].figures for k in order]
    rmse = np.array([one.rmse for one in figures])
    percent = np.array([one.nrmse_percent for one in figures], dtype=np.float64)  # None becomes NaN
    found: dict[str, tuple[Floats, str]] = {
        "percent": (percent, "% of range"),
        "rmse": (rmse, report.unit or ""),
    }
    found = {key: one for key, one in found.items() if np.isfinite(one[0]).any()}
    words = "Number of channels against their RMSE, {}; median and worst are marked."
    plots = []
    for key, (values, unit) in found.items():
        title = f"RMSE of the channels{f', {shown_unit(unit)}' if unit else ''}"
        paint = partial(_histogram, names, values, unit)
        plots.append(Plot(f"histogram-{key}", title, words.format(unit), style.WIDE, paint))
    values, unit = next(iter(found.values()))
    worst = int(np.nanargmax(values))
    head = f"worst: {short_name(names[worst], 20)}, {_amount(values[worst], unit)}"
    if unit != (report.unit or ""):
        head += f", {_amount(rmse[worst], report.unit or '')}"
    if len(names) > NAMED and numbers and len(set(numbers)) == len(names) > (numbers[-1] - numbers[0]) / 2:
        width = row_width(numbers[-1] - min(numbers[0], 1) + 1)
        title = f"RMSE by channel, {width} numbers a row (not their places on a device)"
        paint = partial(_grid, numbers, width, values, unit, head)
        return [*plots, Plot("map", title, f"{title}; {head}.", style.TALL, paint)]
    paint = partial(_bars, names, values, unit, head)
    return [*plots, Plot("map", "RMSE by channel", f"A bar a channel; {head}.", style.WIDE, paint)]


def row_width(count: int) -> int:
    """Return how many numbers stand in a row: about square, up to 2:1 where that fills all rows."""
    least = math.ceil(math.sqrt(count))
    return next((width for width in range(least, 2 * least) if count % width == 0), least)


def _amount(value: float, unit: str) -> str:
    return f"{digits(value, 3)} {shown_unit(unit.removesuffix(' of range'))}".rstrip()


def _histogram(names: list[str], values: Floats, unit: str, axes: Axes) -> None:
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    bins = min(max(math.ceil(math.sqrt(known.size)), 5), 40)
    wide = 0.0 < DECADES * low < high
    margin = 0.0 if high - low > 1e-9 * high else 0.05 * high or 1.0  # one value alone
    ends = (low - margin, high + margin)
    edges = np.geomspace(low, high, bins + 1) if wide else np.linspace(*ends, bins + 1)
    counts, _ = np.histogram(known.clip(edges[0], edges[-1]), edges)
    axes.bar(edges[:-1], counts, np.diff(edges), align="edge", **BARS)
    if wide:
        axes.set_xscale("log")
        label_decades(axes.xaxis)
    middle, worst = float(np.median(known)), int(np.nanargmax(values))
    axes.axvline(middle, label=f"median {_amount(middle, unit)}", **style.SOLID)
    label = f"worst: {short_name(names[worst], 20)}, {_amount(high, unit)}"
    axes.axvline(high, label=label, **style.DASHED)
    axes.locator_params(axis="y", integer=True)
    axes.set(xlabel=axis_label("RMSE", unit), ylabel="Channels")
    mark_curves(axes)


def _bars(names: list[str], values: Floats, unit: str, head: str, axes: Axes) -> None:
    """Paint a bar a channel; of the names below, as many as there is room for."""
    places, worst = np.arange(len(names)), int(np.nanargmax(values))
    for shown, color in ((places != worst, style.FILL), (places == worst, style.SECOND)):
        tops = np.column_stack([np.where(shown, np.nan_to_num(values), 0.0), np.zeros(len(names))]).ravel()
        edges = np.append(np.column_stack([places - 0.4, places + 0.4]).ravel(), len(names) - 0.4)
        axes.stairs(tops, edges, fill=True, color=color, label=None if color == style.FILL else head)
    labels = [short_name(name, max(LETTERS // len(names) - 1, 8)) for name in names]
    step = math.ceil(len(names) * (max(map(len, labels)) + 1) / LETTERS)
    below: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "top"}
    for place in places[::step]:
        axes.text(place, -0.025, labels[place], **below)
    axes.grid(False, axis="x")
    axes.set_xticks(places[::step], [""] * len(places[::step]))
    axes.set(xlim=(-0.6, len(names) - 0.4), ylim=(0.0, None), ylabel=axis_label("RMSE", unit))
    axes.set_xlabel("Channel", labelpad=11.0)
    mark_curves(axes)


def _grid(numbers: list[int], width: int, values: Floats, unit: str, head: str, axes: Axes) -> None:
    """Paint rows of squares, the least number at the top left; what has no value stays blank."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    first = min(numbers[0], 1)
    rows = (numbers[-1] - first) // width + 1
    cells = np.full(rows * width, np.nan)
    cells[np.array(numbers) - first] = values
    colors = LinearSegmentedColormap.from_list("rmse", ["#e6eef6", style.FIRST])
    shown = np.ma.masked_invalid(cells.reshape(rows, width))
    image = axes.imshow(shown, cmap=colors, aspect="auto", interpolation="nearest")
    row, column = divmod(numbers[int(np.nanargmax(values))] - first, width)
    square: dict[str, Any] = {"fill": False, "edgecolor": style.SECOND, "linewidth": 1.8, "label": head}
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, clip_on=False, **square))
    axes.set_xlim(-0.5, 1.25 * width - 0.5)  # a fifth for the scale
    for axis, places, start, step in ((axes.xaxis, width, 0, 1), (axes.yaxis, rows, first, width)):
        ticks = range(0, places, math.ceil(places / 16))
        axis.set_ticks(ticks, [str(start + step * tick) for tick in ticks])
    axes.grid(False)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("Added to the number at the left", x=0.4)
    axes.set_ylabel("First channel of the row")
    scale = axes.inset_axes((0.85, 0.0, 0.035, 1.0))
    axes.figure.colorbar(image, cax=scale, label=axis_label("RMSE", unit)).outline.set_visible(False)
    mark_curves(axes)
