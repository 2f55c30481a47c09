"""The figures of logs and of channels; ``drawing`` turns them into PNG and SVG, nothing is drawn before.

In the numbers of the paper: ``drive`` is Fig. 5, ``tracking`` 6, 8 and 11, ``loop`` 7,
``error`` 9 and 12, ``output`` 10 and 13. ``frequency`` is drawn where segments differ
in theirs. Those of channels show how their errors are spread, and which channels they
are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.logs.units import quantity_name
from dbo_cli.reports import drawing as style
from dbo_cli.reports.accumulators import Band, Curve, FigureData, Raster
from dbo_cli.reports.drawing import Plot, short_name
from dbo_cli.reports.renderers import shown_unit
from dbo_cli.reports.report import LogReport, Report, digits
from dbo_cli.reports.sample_pairs import Floats

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.legend import Legend

# of an axes' height: so far a curve that leaves it is drawn beyond; chosen
OUTSIDE = 0.02
FINER = 10.0  # times, what is drawn about the largest error
WIDE_BAND = 1.5  # times the lowest frequency, up to which segments are of one frequency
LENGTH_UNITS = ("m", "mm", "um", "nm", "pm")
# letters of 9 points in 4.3 inches of legend; names that need more stand below each
# other
WIDEST = 52
LEGEND_LINE = 0.17  # inches
# of a histogram
BARS: dict[str, Any] = {"color": style.FILL, "edgecolor": style.INK, "linewidth": 0.4}
# channels up to which bars are drawn, so that each has its name, though they are
# numbers
NAMED = 20
LETTERS = 52  # of 9 points, in a row below the axes
# times the least RMSE, from which on even steps would put all but the worst into one
# bar
DECADES = 30.0


RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""The signs of an exponent, set small and high."""


def axis_label(quantity: str, unit: str | None) -> str:
    """Return a quantity with its unit in brackets."""
    if not unit:
        return quantity
    return f"{quantity} ({shown_unit(unit)})"


def decade(value: float, _: float = 0.0) -> str:
    """Return the label of a power of ten: plain from 0.01 to 1000, else 10 with a raised exponent.

    Set as plain letters, which a page can select and which take a tenth of the time of
    set formulas.
    """
    if 0.005 < value < 5000.0:
        return f"{value:g}"
    exponent = f"{math.log10(value):.0f}"
    return "10" + exponent.translate(RAISED)


def label_decades(*axes: Axis) -> None:
    """Label logarithmic axes: every power of ten, 2, 3 and 5 where it spans less than two, all within one.

    Matplotlib's own labels between are formulas, which are not set here (a dollar in a
    name is a dollar).
    """

    def between(axis: Axis, value: float, _: float = 0.0) -> str:
        low, high = sorted(axis.get_view_interval())
        if high < 10.0 * low:
            return f"{value:.6g}"
        lead, exponent = f"{value:.0e}".split("e")
        if high > 100.0 * low or lead not in {"2", "3", "5"}:
            return ""
        if 0.0005 < value < 5000.0:
            return f"{value:g}"
        return f"{lead}·{decade(10.0 ** int(exponent))}"

    for axis in axes:
        axis.set_major_formatter(decade)
        axis.set_minor_formatter(partial(between, axis))


def plots_of_comparison(
    report: Report, figure_data: Sequence[FigureData]
) -> list[Plot]:
    """Return what shows all logs of a report at once: their errors in one figure; nothing for a single log.

    Of more logs than there are colours, the first ones. Where the logs begin at
    different times, each counts from its own first sample.
    """
    if len(report.logs) < 2:
        return []
    shown = list(zip(report.logs, figure_data, style.SEVERAL, strict=False))
    names = [short_name(log.name, WIDEST) for log, _, _ in shown]
    columns = max(1, min(3, len(names), WIDEST // (max(map(len, names)) + 6)))
    head = legend_head(len(names), columns)
    first, second = report.options.labels
    whole = "all logs"
    if len(shown) < len(report.logs):
        whole = f"the first {len(shown)} of {len(report.logs)} logs"
    words = f"{second.capitalize()} less {first} displacement against time, a line for each log."

    def paint(axes: Axes) -> None:
        timed = all(data.has_time for _, data, _ in shown)
        starts = {data.start for _, data, _ in shown}
        apart = timed and len(starts) > 1
        x_label = "Time (s)" if timed else "Row"
        if apart:
            x_label = "Time since each log began (s)"
        handles = []
        for log, data, look in shown:
            shape = data.against_time("error")
            if apart:
                shape = replace(shape, x=shape.x - data.start)
            _against_time(axes, shape, look, log.figures.offset)
            handles += axes.plot([], [], **(look | {"linewidth": 1.6}))
        axes.set(xlabel=x_label, ylabel=axis_label("Error", report.unit))
        legend = mark_curves(axes, handles, ["log"] * len(handles), columns)
        for text, name in zip(legend.get_texts(), names, strict=True):
            # as a label, a name that begins with "_" would be left out
            text.set_text(name)

    return [
        Plot("errors", f"Error of {whole} against time", words, style.WIDE, paint, head)
    ]


def plots_of_log(report: Report, log: LogReport, figure_data: FigureData) -> list[Plot]:
    """Return the figures of one log, drawn from what ``figure_data`` gathered while it was evaluated."""
    view = _LogView(report, log, figure_data)
    wide, tall = style.WIDE, style.TALL
    plots = _plots_of_signals(view, log, *report.options.labels)
    if figure_data.has_drive:
        loop = f"Hysteresis loop: {view.quantity.lower()} against {view.drive_name.lower()}"
        plots.append(Plot("loop", loop, f"{loop}.", tall, view.loop))
    plots.append(
        Plot(
            "histogram",
            "Distribution of the error",
            "Share of all samples against their error.",
            wide,
            view.histogram,
        )
    )
    if figure_data.spectrum.density(1.0) is not None:
        plots.append(
            Plot(
                "spectrum",
                "Spectrum of the error",
                "Amplitude density of the error against frequency, both axes logarithmic.",
                wide,
                view.spectrum,
            )
        )
    if figure_data.has_drive:
        words = f"{view.drive_name} against time."
        plots.append(Plot("drive", "Drive against time", words, wide, view.drive))
    if view.by_frequency is not None:
        plots.append(
            Plot(
                "frequency",
                "Error against frequency",
                "RMS error of each segment against the frequency of the desired signal, both logarithmic.",
                wide,
                view.frequency,
            )
        )
    return plots


def _plots_of_signals(
    view: _LogView, log: LogReport, first: str, second: str
) -> list[Plot]:
    """Return the figures of both signals and of their difference, which every log has."""
    wide, tall = style.WIDE, style.TALL
    both = f"{first.capitalize()} and {second}"
    difference = f"{second.capitalize()} less {first} displacement"
    output = f"{second.capitalize()} against {first}"
    error_words = f"{difference} against time, with a band of one RMSE"
    if log.concentrated is not None:
        error_words += ", and the rows that make half of the squared error"
    return [
        Plot(
            "tracking",
            f"{both} against time",
            f"{both} against time, the first as a solid line, the second dashed.",
            wide,
            view.tracking,
        ),
        Plot(
            "worst",
            "The same about the largest error, ten times finer",
            f"{both} about the largest error, both axes ten times finer.",
            wide,
            view.worst,
        ),
        Plot("error", "Error against time", f"{error_words}.", wide, view.error),
        Plot("output", output, f"{output}, beside the identity.", tall, view.output),
    ]


class _LogView:
    """Paint the figures of one log."""

    def __init__(self, report: Report, log: LogReport, figure_data: FigureData) -> None:
        self._report = report
        self._log = log
        self._figures = log.figures
        self._figure_data = figure_data
        self._offset = log.figures.offset
        self.by_frequency = _errors_by_frequency(log)
        self.drive_name = f"Drive {quantity_name('voltage', figure_data.drive_unit)}"
        self.quantity = "Signal"
        if report.unit is None or report.unit in LENGTH_UNITS:
            self.quantity = "Displacement"
        elif report.unit == "V":
            self.quantity = "Voltage"

    def drive(self, axes: Axes) -> None:
        _against_time(axes, self._figure_data.against_time("drive"), style.SOLID)
        axes.set(
            xlabel=self._time(),
            ylabel=axis_label(self.drive_name, self._figure_data.drive_unit),
        )

    def tracking(self, axes: Axes) -> None:
        first, second = self._report.options.labels
        _against_time(
            axes, self._figure_data.against_time("desired"), style.SOLID, label=first
        )
        measured = self._figure_data.against_time("measured")
        _against_time(axes, measured, style.DASHED, self._offset, label=second)
        (left, right), (low, high) = self._finer(axes)
        corners = [left, right, right, left, left], [low, low, high, high, low]
        axes.plot(*corners, label="drawn finer", **style.DOTTED)
        finish(axes, self._time(), self._length(self.quantity))

    def worst(self, axes: Axes) -> None:
        first, second = self._report.options.labels
        desired = self._figure_data.against_time("desired")
        measured = self._figure_data.against_time("measured")
        _against_time(axes, desired, style.SOLID)
        _against_time(axes, measured, style.DASHED, self._offset)
        across, up = self._finer(axes)
        axes.clear()
        up_measured = up[0] + self._offset, up[1] + self._offset
        _against_time(axes, cut_out(desired, across, up), style.SOLID, label=first)
        cut = cut_out(measured, across, up_measured)
        _against_time(axes, cut, style.DASHED, self._offset, label=second)
        finish(axes, self._time(), self._length(self.quantity))
        axes.set(xlim=across, ylim=up)

    def _finer(self, axes: Axes) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return a tenth of the time and of the displacement that axes show, about the largest error.

        Where the error itself is larger than that, it fits in.
        """
        time, low, high = self._figure_data.at_largest(self._offset)
        left, right = axes.get_xlim()
        bottom, top = axes.get_ylim()
        half_width = (right - left) / (2.0 * FINER)
        half_height = max((top - bottom) / (2.0 * FINER), 0.7 * (high - low))
        # the log, and nothing beside
        time = min(max(time, left + half_width), right - half_width)
        middle = 0.5 * (low + high)
        across = (time - half_width, time + half_width)
        up = (middle - half_height, middle + half_height)
        return across, up

    def error(self, axes: Axes) -> None:
        rmse = self._figures.rmse
        band = f"± RMSE {digits(rmse)} {shown_unit(self._report.unit)}".rstrip()
        axes.axhspan(
            -rmse, rmse, color=style.FILL, alpha=0.35, linewidth=0.0, label=band
        )
        half = self._log.concentrated
        if half is not None:
            share = "half of the squared error"
            first_row, first_time = half.first
            last_row, last_time = half.last
            begin: float | None = first_row
            end: float | None = last_row
            if self._figure_data.has_time:
                begin, end = first_time, last_time
            if begin is not None and end is not None:
                axes.axvspan(begin, end, color=style.SECOND, alpha=0.25, label=share)
        _against_time(
            axes, self._figure_data.against_time("error"), style.ALONE, self._offset
        )
        finish(axes, self._time(), self._length("Error"))

    def output(self, axes: Axes) -> None:
        first, second = self._report.options.labels
        ends = [self._figures.desired_min, self._figures.desired_max]
        axes.plot(ends, ends, label="identity", zorder=3, **style.DOTTED)
        self._curve(
            axes,
            "desired",
            "measured",
            style.DASHED | {"linestyle": "-"},
            second,
            self._offset,
        )
        quantity = self.quantity.lower()
        x_label = self._length(f"{first.capitalize()} {quantity}")
        y_label = self._length(f"{second.capitalize()} {quantity}")
        finish(axes, x_label, y_label)

    def loop(self, axes: Axes) -> None:
        first, second = self._report.options.labels
        modelled = first == "model"
        look = style.DASHED
        if not modelled:
            look = style.DASHED | {"linestyle": "-"}
        self._curve(axes, "drive", "measured", look, second, self._offset)
        if modelled:
            self._curve(
                axes, "drive", "desired", style.SOLID | {"linewidth": 0.9}, first, 0.0
            )
        finish(
            axes,
            axis_label(self.drive_name, self._figure_data.drive_unit),
            self._length(self.quantity),
        )

    def histogram(self, axes: Axes) -> None:
        values, counts = self._figure_data.distribution.values()
        bins = int(min(max(math.sqrt(self._figures.samples), 12), 60))
        low, high = float(values[0]) - self._offset, float(values[-1]) - self._offset
        margin = max(1e-9 * max(abs(low), abs(high)), 1e-290)
        if high - low < margin:  # one value, or as good as one: no room for bins
            low, high = low - margin, high + margin
        share, edges = np.histogram(
            np.clip(values - self._offset, low, high),
            bins,
            range=(low, high),
            weights=counts,
        )
        axes.bar(
            edges[:-1],
            100.0 * share / self._figures.samples,
            np.diff(edges),
            align="edge",
            **BARS,
        )
        if self._figures.max_abs > 3.0 * self._figures.p95_abs > 0.0:
            # or a spike of one sample in a million is not to be seen
            axes.set_yscale("log")
            label_decades(axes.yaxis)
        axes.set(xlabel=self._length("Error"), ylabel="Share of samples (%)")

    def spectrum(self, axes: Axes) -> None:
        period = self._figures.sample_period
        curve = self._figure_data.spectrum.density(period or 1.0)
        assert curve is not None
        floor = 1e-30
        if curve.y.max() > 0.0:
            floor = curve.y.max() * 1e-9
        axes.loglog(curve.x, np.maximum(curve.y, floor), **style.ALONE)
        label_decades(axes.xaxis, axes.yaxis)
        frequency = "Frequency (cycles a sample)"
        unit = shown_unit(self._report.unit)
        density = unit
        if period:
            frequency = "Frequency (Hz)"
            density = f"{unit}/√Hz"
        axes.set_xlabel(frequency)
        axes.set_ylabel(f"Error density ({density})" if unit else "Error density")

    def frequency(self, axes: Axes) -> None:
        assert self.by_frequency is not None
        at, errors = self.by_frequency
        axes.loglog(
            at,
            np.maximum(errors, errors.max() * 1e-9),
            **(style.POINTS | {"color": style.FIRST}),
        )
        label_decades(axes.xaxis, axes.yaxis)
        axes.set(
            xlabel="Frequency of the desired signal (Hz)",
            ylabel=self._length("RMS error of a segment"),
        )

    def _curve(
        self, axes: Axes, x: str, y: str, look: dict[str, Any], label: str, shift: float
    ) -> None:
        shape = self._figure_data.against(x, y)
        if isinstance(shape, Curve):
            axes.plot(shape.x, shape.y - shift, label=label, **look)
        else:
            _paint_raster(axes, shape, look["color"], shift)
            axes.plot([], [], label=label, **(look | {"linestyle": "-"}))

    def _time(self) -> str:
        return "Time (s)" if self._figure_data.has_time else "Row"

    def _length(self, quantity: str) -> str:
        return axis_label(quantity, self._report.unit)


def _errors_by_frequency(log: LogReport) -> tuple[Floats, Floats] | None:
    """Return frequency (Hz) and RMS error of the segments; None where they are all about as fast."""
    frequencies = []
    errors = []
    for segment in log.segments:
        figures = segment.figures
        if figures.frequency is not None and figures.rmse > 0.0:
            frequencies.append(figures.frequency)
            errors.append(figures.rmse)
    if not errors or max(frequencies) < WIDE_BAND * min(frequencies):
        return None
    return np.array(frequencies), np.array(errors)


def _against_time(
    axes: Axes,
    shape: Curve | Band,
    look: dict[str, Any],
    shift: float = 0.0,
    label: str | None = None,
) -> None:
    """Paint a curve, or of many samples the band between least and greatest, its edges as lines."""
    if isinstance(shape, Curve):
        axes.plot(shape.x, shape.y - shift, label=label, **look)
        return
    thin = look | {"linewidth": 0.8}
    axes.fill_between(
        shape.x,
        shape.low - shift,
        shape.high - shift,
        color=look["color"],
        alpha=0.3,
        linewidth=0.0,
    )
    axes.plot(shape.x, shape.high - shift, label=label, **thin)
    axes.plot(shape.x, shape.low - shift, **thin)


def cut_out(
    shape: Curve | Band, across: tuple[float, float], up: tuple[float, float]
) -> Curve | Band:
    """Return what of a curve lies in a piece of its axes; beyond that it runs along the frame, just outside.

    A browser counts what a clipped path would cover, so that it must not go far beyond.
    """
    inside = (shape.x >= across[0]) & (shape.x <= across[1])
    margin = OUTSIDE * (up[1] - up[0])
    low, high = up[0] - margin, up[1] + margin
    x = shape.x[inside]
    if isinstance(shape, Curve):
        return Curve(x, np.clip(shape.y[inside], low, high))
    return Band(
        x, np.clip(shape.low[inside], low, high), np.clip(shape.high[inside], low, high)
    )


def _paint_raster(axes: Axes, raster: Raster, color: str, shift: float) -> None:
    """Paint the passed pixels, cut to those in use and as thick as a line, in one colour on nothing."""
    from matplotlib.colors import ListedColormap, NoNorm

    rows, columns = (np.flatnonzero(raster.passed.any(axis=axis)) for axis in (1, 0))
    inner = raster.passed[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    passed = np.pad(inner, 1)
    for axis in (0, 1):
        passed = passed | np.roll(passed, 1, axis) | np.roll(passed, -1, axis)
    left, right, bottom, top = raster.extent
    across, up = (
        (right - left) / raster.passed.shape[1],
        (top - bottom) / raster.passed.shape[0],
    )
    extent = (
        left + across * (columns[0] - 1),
        left + across * (columns[-1] + 2),
        bottom + up * (rows[0] - 1) - shift,
        bottom + up * (rows[-1] + 2) - shift,
    )
    axes.use_sticky_edges = False
    # numbers of colours, scaled before they become colours, take a tenth of the memory
    # of colours in floats
    look: dict[str, Any] = {"cmap": ListedColormap(["none", color]), "norm": NoNorm()}
    look |= {"interpolation_stage": "data", "interpolation": "nearest"}
    look |= {"origin": "lower", "aspect": "auto", "zorder": 2}
    axes.imshow(passed.astype(np.uint8), extent=extent, **look)
    axes.autoscale(enable=True)


def mark_curves(
    axes: Axes,
    handles: Sequence[Artist] = (),
    labels: Sequence[str] = (),
    columns: int = 3,
) -> Legend:
    """Set the legend above the axes, where it hides nothing; it names every curve that has a label."""
    if not handles:
        handles, labels = axes.get_legend_handles_labels()
    return axes.legend(
        handles,
        labels,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        columnspacing=1.6,
    )


def finish(axes: Axes, x: str, y: str, columns: int = 3) -> None:
    """Name both axes, and the curves that have a label."""
    axes.set(xlabel=x, ylabel=y)
    mark_curves(axes, columns=columns)


def legend_head(curves: int, columns: int) -> float:
    """Return the inches that a legend of more than one line needs above a figure."""
    return LEGEND_LINE * (math.ceil(curves / columns) - 1)


def plots_of_channels(report: Report) -> list[Plot]:
    """Return histograms of the channels' RMSE, in % of range and in the unit, and a map of it.

    Numbered channels stand in the order of their numbers. Without any range the map is
    in the unit.
    """
    logs = list(report.logs)
    numbers: list[int] = []
    if all(log.name.isascii() and log.name.isdigit() for log in logs):
        logs.sort(key=lambda log: int(log.name))
        numbers = [int(log.name) for log in logs]
    names = [log.name for log in logs]
    rmse = np.array([log.figures.rmse for log in logs])
    # None becomes NaN
    percent = np.array([log.figures.nrmse_percent for log in logs], dtype=np.float64)
    shown = [("rmse", rmse, report.unit or "")]
    if np.isfinite(percent).any():
        shown.insert(0, ("percent", percent, "% of the move"))
    words = "Number of channels against their RMSE, {}; median and worst are marked."
    plots = []
    for key, values, unit in shown:
        title = "RMSE of the channels"
        if unit:
            title += f", {shown_unit(unit)}"
        paint = partial(_histogram, names, values, unit)
        plots.append(
            Plot(f"histogram-{key}", title, words.format(unit), style.WIDE, paint)
        )
    _, values, unit = shown[0]
    worst = int(np.nanargmax(values))
    head = f"worst: {short_name(names[worst], 20)}, {_amount(values[worst], unit)}"
    if unit != (report.unit or ""):
        head += f", {_amount(rmse[worst], report.unit or '')}"
    if (
        len(names) > NAMED
        and numbers
        and len(set(numbers)) == len(names) > (numbers[-1] - numbers[0]) / 2
    ):
        width = row_width(numbers[-1] - min(numbers[0], 1) + 1)
        title = f"RMSE by channel, {width} numbers a row (not their places on a device)"
        paint = partial(_grid, numbers, width, values, unit, head)
        return [*plots, Plot("map", title, f"{title}; {head}.", style.TALL, paint)]
    paint = partial(_bars, names, values, unit, head)
    return [
        *plots,
        Plot("map", "RMSE by channel", f"A bar a channel; {head}.", style.WIDE, paint),
    ]


def row_width(count: int) -> int:
    """Return how many numbers stand in a row: about square, up to 2:1 where that fills all rows."""
    least = math.ceil(math.sqrt(count))
    for width in range(least, 2 * least):
        if count % width == 0:
            return width
    return least


def _amount(value: float, unit: str) -> str:
    return (
        f"{digits(value, 3)} {shown_unit(unit.removesuffix(' of the move'))}".rstrip()
    )


def _histogram(names: list[str], values: Floats, unit: str, axes: Axes) -> None:
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    bins = min(max(math.ceil(math.sqrt(known.size)), 5), 40)
    wide = 0.0 < DECADES * low < high
    margin = 0.0
    if high - low <= 1e-9 * high:  # one value alone
        margin = 0.05 * high or 1.0
    edges = np.linspace(low - margin, high + margin, bins + 1)
    if wide:
        edges = np.geomspace(low, high, bins + 1)
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
    finish(axes, axis_label("RMSE", unit), "Channels")


def _bars(names: list[str], values: Floats, unit: str, head: str, axes: Axes) -> None:
    """Paint a bar a channel; of the names below, as many as there is room for."""
    places, worst = np.arange(len(names)), int(np.nanargmax(values))
    for shown, color, label in (
        (places != worst, style.FILL, None),
        (places == worst, style.SECOND, head),
    ):
        tops = np.column_stack(
            [np.where(shown, np.nan_to_num(values), 0.0), np.zeros(len(names))]
        ).ravel()
        edges = np.append(
            np.column_stack([places - 0.4, places + 0.4]).ravel(), len(names) - 0.4
        )
        axes.stairs(
            tops,
            edges,
            fill=True,
            color=color,
            label=label,
        )
    labels = [short_name(name, max(LETTERS // len(names) - 1, 8)) for name in names]
    step = math.ceil(len(names) * (max(map(len, labels)) + 1) / LETTERS)
    below: dict[str, Any] = {
        "transform": axes.get_xaxis_transform(),
        "ha": "center",
        "va": "top",
    }
    for place in places[::step]:
        axes.text(place, -0.025, labels[place], **below)
    axes.grid(False, axis="x")
    axes.set_xticks(places[::step], [""] * len(places[::step]))
    axes.set(
        xlim=(-0.6, len(names) - 0.4), ylim=(0.0, None), ylabel=axis_label("RMSE", unit)
    )
    axes.set_xlabel("Channel", labelpad=11.0)
    mark_curves(axes)


def _grid(
    numbers: list[int], width: int, values: Floats, unit: str, head: str, axes: Axes
) -> None:
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
    square: dict[str, Any] = {
        "fill": False,
        "edgecolor": style.SECOND,
        "linewidth": 1.8,
        "label": head,
    }
    axes.add_patch(
        Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, clip_on=False, **square)
    )
    axes.set_xlim(-0.5, 1.25 * width - 0.5)  # a fifth for the scale
    for axis, places, start, step in (
        (axes.xaxis, width, 0, 1),
        (axes.yaxis, rows, first, width),
    ):
        ticks = range(0, places, math.ceil(places / 16))
        axis.set_ticks(ticks, [str(start + step * tick) for tick in ticks])
    axes.grid(False)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("Added to the number at the left", x=0.4)
    axes.set_ylabel("First channel of the row")
    scale = axes.inset_axes((0.85, 0.0, 0.035, 1.0))
    axes.figure.colorbar(
        image, cax=scale, label=axis_label("RMSE", unit)
    ).outline.set_visible(False)
    mark_curves(axes)
