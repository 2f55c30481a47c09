"""Several models of one actuator side by side: a table, as text, JSON, CSV or HTML, and two figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.extras.compare.judging import Row
from dbo_cli.reports import drawing as style
from dbo_cli.reports import renderers
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import axis_label, finish, label_decades, legend_head
from dbo_cli.reports.models import slow_loop
from dbo_cli.reports.report import digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JSON_VERSION = 1  # of the form dbo-compare; a change of meaning would need another
LOOP_POINTS = 201  # each way: half a percent of the range, finer than the line is wide
LEGEND_COLUMNS = 3  # names of relatives are short; three fit above a figure
RECORD = (
    *(
        "name",
        "rmse",
        "expected_rmse",
        "validation_rmse",
        "parameters",
        "fit_seconds",
        "forward_ns",
    ),
    *("inverse_ns", "round_trip", "refused", "words"),
)


@dataclass(frozen=True)
class ModelTable:
    """Several models, a row each, and what they were fitted to.

    Attributes
    ----------
    rows : tuple of Row
        One a model.
    unit : str, or None
        Of every length.
    logs, validation : tuple of str
        Names of the logs.
    """

    rows: tuple[Row, ...]
    unit: str | None
    logs: tuple[str, ...]
    validation: tuple[str, ...]

    def rendered(self, form: str, provenance: Mapping[str, Any], program: str) -> bytes:
        """Return the table in one form: text, json, csv or html."""
        if form == "json":
            content = {
                "format": "dbo-compare",
                "version": JSON_VERSION,
                "unit": self.unit,
            }
            content |= {"logs": list(self.logs), "validation": list(self.validation)}
            content |= {
                "models": [record(row) for row in self.rows],
                "provenance": dict(provenance),
            }
            text = renderers.json_text(content)
        elif form == "csv":
            unit = {"unit": self.unit and renderers.no_formula(self.unit)}
            text = renderers.csv_text([record(row) | unit for row in self.rows])
        elif form == "html":
            text = self._page(program)
        else:
            text = self._text()
        return text.encode()

    def _heading(self) -> str:
        heading = f"Models fitted to {', '.join(self.logs)}"
        if self.validation:
            heading += f"; validation on {', '.join(self.validation)}"
        if self.unit:
            heading += f", RMSE in {self.unit}"
        return heading

    def _text(self) -> str:
        head = [
            "model",
            "fit",
            "expected",
            "valid.",
            "numbers",
            "fit s",
            "ns fwd",
            "ns inv",
            "trip",
        ]
        rows = []
        refusals = []
        remarks = []
        for row in self.rows:
            if row.refused is None:
                rows.append(_cells(row, row.name, "{:.0e}"))
            else:
                refusals.append(f"{row.name}: {row.refused}")
            if remark(row):
                remarks.append(f"{row.name}: {remark(row)}")
        parts = ["\n".join(renderers.wrapped(self._heading()))]
        if rows:
            parts.append(renderers.text_table(head, rows))
        for line in [*refusals, *remarks]:
            parts.append("\n".join(renderers.wrapped(line)))
        return "\n\n".join(parts) + "\n"

    def _page(self, program: str) -> str:
        unit = f" ({renderers.shown_unit(self.unit)})" if self.unit else ""
        head = [
            "Model",
            f"Fit{unit}",
            f"Expected{unit}",
            f"Validation{unit}",
            "Numbers",
            "s to fit",
        ]
        head += ["ns forward", "ns inverse", f"Round trip{unit}", "Remark"]
        rows = []
        for row in self.rows:
            rows.append([*_cells(row, row.words, "{:.1e}"), row.refused or remark(row)])
        parts = [
            f"<p>{escape(self._heading())}.</p>",
            renderers.html_table(head, rows, chief=3 if self.validation else 1),
            renderers.filled("glossary_models.html"),
            renderers.drawn_figures(self.plots(), "models"),
        ]
        return renderers.page_of("Models side by side", parts, program)

    def plots(self) -> list[Plot]:
        """Return the figures: error against cost where that was measured, and the loops."""
        fitted = [row for row in self.rows if row.model is not None]
        bent = [row for row in fitted if row.name != "line"]
        plots = []
        if any(row.inverse_ns is not None for row in fitted):
            title = "Error against cost"
            words = "RMSE of each model against the nanoseconds a sample of its inverse takes."
            timed = [row for row in fitted if row.inverse_ns is not None]
            paint, head = (
                partial(_paint_cost, self, timed),
                legend_head(len(timed), LEGEND_COLUMNS),
            )
            plots.append(Plot("cost", title, words, style.WIDE, paint, head))
        if bent:
            title = "The loops, a straight line taken off"
            words = (
                "Slow loop of each model, a straight line taken off, against the drive."
            )
            paint, head = (
                partial(_paint_loops, self, bent),
                legend_head(len(bent), LEGEND_COLUMNS),
            )
            plots.append(Plot("loops", title, words, style.TALL, paint, head))
        return plots


def record(row: Row) -> dict[str, Any]:
    """Return a row as plain values, in the order of the JSON form."""
    return {key: vars(row)[key] for key in RECORD} | {"invertible": row.invertible}


def remark(row: Row) -> str:
    """Say why an inverse is not exact, or not timed; empty where it is both."""
    if row.invertible is False and row.name == "rate":
        return "its inverse takes the drive's rate from that of what is wanted, so it is not exact"
    if row.invertible is False:
        return "its inverse is not exact to rounding"
    if row.forward_ns is not None and row.inverse_ns is None:
        return "its inverse is exact; beside memories it is solved in Python, so it is not timed"
    return ""


def _cells(row: Row, name: str, trip: str) -> list[str]:
    """Return the cells of a row; ``trip`` is the form of what a round trip leaves."""
    parameters = round_trip = "-"
    if row.parameters is not None:
        parameters = str(row.parameters)
    if row.round_trip is not None:
        round_trip = trip.format(row.round_trip)
    return [
        name,
        digits(row.rmse),
        digits(row.expected_rmse),
        digits(row.validation_rmse),
        parameters,
        digits(row.fit_seconds, 3),
        digits(row.forward_ns, 3),
        digits(row.inverse_ns, 3),
        round_trip,
    ]


def _paint_cost(shown: ModelTable, rows: Sequence[Row], axes: Axes) -> None:
    error = "Validation RMSE" if shown.validation else "Expected RMSE"
    for number, row in enumerate(rows):
        y = row.validation_rmse if shown.validation else row.expected_rmse
        again, place = divmod(number, len(style.SEVERAL))
        look = {"color": style.SEVERAL[place]["color"], "marker": "s" if again else "o"}
        assert row.inverse_ns is not None and y is not None
        axes.plot([row.inverse_ns], [y], label=row.name, linestyle="none", **look)
    axes.margins(0.08)
    axes.set(xscale="log", yscale="log")
    label_decades(axes.xaxis, axes.yaxis)
    finish(axes, "Inverse (ns a sample)", axis_label(error, shown.unit), LEGEND_COLUMNS)


def _paint_loops(shown: ModelTable, rows: Sequence[Row], axes: Axes) -> None:
    line = None
    for number, row in enumerate(rows):
        assert row.model is not None
        drive, rising, falling = slow_loop(row.model.without_lag, LOOP_POINTS)
        if line is None:
            line = np.polyfit(np.tile(drive, 2), np.concatenate((rising, falling)), 1)
        taken = np.polyval(line, drive)
        look = style.SEVERAL[number % len(style.SEVERAL)]
        around = np.concatenate((rising - taken, (falling - taken)[::-1]))
        pattern = {"linestyle": (0, (3.2, 1.4))} if number % 2 else {}
        there_and_back = np.concatenate((drive, drive[::-1]))
        axes.plot(
            there_and_back, around - around.mean(), label=row.name, **(look | pattern)
        )
        drive_label = axis_label("Drive voltage", row.model.input.unit)
    finish(
        axes,
        drive_label,
        axis_label("Displacement less a line", shown.unit),
        LEGEND_COLUMNS,
    )
