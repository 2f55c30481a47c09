"""Several models of one actuator side by side: a table as text, JSON, CSV or a page, and two figures."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.relatives.comparison import Row, without_lateness
from dbo_cli.reports import figure_style as style
from dbo_cli.reports.drawing import Plot
from dbo_cli.reports.figures import axis_label, label_decades, mark_curves, shown_unit
from dbo_cli.reports.model_figures import slow_loop
from dbo_cli.reports.page import drawn_figures, page_of, table
from dbo_cli.reports.renderers import digits, no_formula, wrapped
from dbo_cli.reports.renderers import table as text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JSON_VERSION = 1
LOOP_POINTS = 201
LEGEND_COLUMNS, LEGEND_LINE = 3, 0.17  # inches

MEANINGS = (
    ("Fit", "RMSE on the logs that the model was fitted to, each log's offset and drift taken off."),
    (
        "Expected",
        "RMSE to expect on new moves; of the DBO as identify says it, else from data left out alone.",
    ),
    ("Validation", "RMSE on logs that took no part in the fit, the offset taken off."),
    ("Numbers", "How many numbers were fitted."),
    ("s to fit", "Seconds from prepared logs to the model; what is chosen on data left out is included."),
    (
        "ns forward, ns inverse",
        "Nanoseconds a sample on the first log's own drive, the whole model but delay and dynamics.",
    ),
    (
        "Round trip",
        "The largest difference between what is wanted and what the model does with its inverse's drive.",
    ),
)


@dataclass(frozen=True)
class ModelComparison:
    """The rows of a comparison, and what they are from.

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
            text = json.dumps(self._content(provenance), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        elif form == "csv":
            text = self._csv()
        elif form == "html":
            text = self._page(program)
        else:
            text = self._text()
        return text.encode()

    def _content(self, provenance: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "format": "dbo-compare",
            "version": JSON_VERSION,
            "unit": self.unit,
            "logs": list(self.logs),
            "validation": list(self.validation),
            "models": [record(row) for row in self.rows],
            "provenance": dict(provenance),
        }

    def _csv(self) -> str:
        out = io.StringIO()
        records = [record(row) | {"unit": self.unit and no_formula(self.unit)} for row in self.rows]
        writer = csv.DictWriter(out, list(records[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
        return out.getvalue()

    def _heading(self) -> str:
        checked = f"; validation on {', '.join(self.validation)}" if self.validation else ""
        unit = f", RMSE in {self.unit}" if self.unit else ""
        return f"Models fitted to {', '.join(self.logs)}{checked}{unit}"

    def _text(self) -> str:
        head = ["model", "fit", "expected", "valid.", "numbers", "fit s", "ns fwd", "ns inv", "trip"]
        rows = [_cells(row, row.name, "{:.0e}") for row in self.rows if row.refused is None]
        parts = ["\n".join(wrapped(self._heading()))]
        if rows:
            parts.append(text_table(head, rows))
        said = [f"{row.name}: {row.refused}" for row in self.rows if row.refused is not None]
        said += [f"{row.name}: {inexact(row)}" for row in self.rows if row.invertible is False]
        parts += ["\n".join(wrapped(line)) for line in said]
        return "\n\n".join(parts) + "\n"

    def _page(self, program: str) -> str:
        unit = f" ({shown_unit(self.unit)})" if self.unit else ""
        head = ["Model", f"Fit{unit}", f"Expected{unit}", f"Validation{unit}", "Numbers", "s to fit"]
        head += ["ns forward", "ns inverse", f"Round trip{unit}", "Remark"]
        rows = []
        for row in self.rows:
            remark = row.refused or (inexact(row) if row.invertible is False else "")
            rows.append([*_cells(row, row.words, "{:.1e}"), remark])
        meanings = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in MEANINGS)
        parts = [
            "<h1>Models side by side</h1>",
            f"<p>{escape(self._heading())}.</p>",
            table(head, rows, chief=3 if self.validation else 1),
            drawn_figures(self.plots(), "models"),
            f"<section><h2>What the columns mean</h2><dl>{meanings}</dl></section>",
            f"<footer>{escape(program)}</footer>",
        ]
        return page_of("Models side by side", parts)

    def plots(self) -> list[Plot]:
        """Return the figures: error against cost where that was measured, and the loops."""
        fitted = [row for row in self.rows if row.model is not None]
        plots = []
        if any(row.inverse_ns is not None for row in fitted):
            words = "RMSE of each model against the nanoseconds a sample of its inverse takes."
            paint = partial(_paint_cost, self, fitted)
            plots.append(Plot("cost", "Error against cost", words, style.WIDE, paint, head=_head(fitted)))
        bent = [row for row in fitted if row.name != "line"]
        if bent:
            words = "Slow loop of each model, a straight line taken off, against the drive."
            paint = partial(_paint_loops, self, bent)
            title = "The loops, a straight line taken off"
            plots.append(Plot("loops", title, words, style.TALL, paint, head=_head(bent)))
        return plots


def record(row: Row) -> dict[str, Any]:
    """Return a row as plain values, in the order of the JSON form."""
    return {
        "name": row.name,
        "rmse": row.rmse,
        "expected_rmse": row.expected_rmse,
        "validation_rmse": row.validation_rmse,
        "parameters": row.parameters,
        "fit_seconds": row.fit_seconds,
        "forward_ns": row.forward_ns,
        "inverse_ns": row.inverse_ns,
        "round_trip": row.round_trip,
        "refused": row.refused,
        "words": row.words,
        "invertible": row.invertible,
    }


def inexact(row: Row) -> str:
    """Say why an inverse is not exact."""
    return (
        "its inverse takes the drive's rate from that of what is wanted, so it is not exact"
        if row.name == "rate"
        else "its inverse is not exact to rounding"
    )


def _head(rows: Sequence[Row]) -> float:
    """Return the inches that a legend of more than one line needs above a figure."""
    return LEGEND_LINE * (math.ceil(len(rows) / LEGEND_COLUMNS) - 1)


def _cells(row: Row, name: str, trip: str) -> list[str]:
    cells = [name]
    cells += [digits(value) for value in (row.rmse, row.expected_rmse, row.validation_rmse)]
    cells.append("-" if row.parameters is None else str(row.parameters))
    cells += [digits(value, 3) for value in (row.fit_seconds, row.forward_ns, row.inverse_ns)]
    return [*cells, "-" if row.round_trip is None else trip.format(row.round_trip)]


def _paint_cost(shown: ModelComparison, rows: Sequence[Row], axes: Axes) -> None:
    error = "Validation RMSE" if shown.validation else "Expected RMSE"
    for number, row in enumerate(rows):
        y = row.validation_rmse if shown.validation else row.expected_rmse
        look = style.SEVERAL[number % len(style.SEVERAL)]
        assert row.inverse_ns is not None and y is not None
        axes.plot([row.inverse_ns], [y], label=row.name, color=look["color"], linestyle="none", marker="o")
    axes.margins(0.08)
    axes.set(xscale="log", yscale="log", xlabel="Inverse (ns a sample)", ylabel=axis_label(error, shown.unit))
    label_decades(axes.xaxis)
    label_decades(axes.yaxis)
    mark_curves(axes, columns=LEGEND_COLUMNS)


def _paint_loops(shown: ModelComparison, rows: Sequence[Row], axes: Axes) -> None:
    line = None
    for number, row in enumerate(rows):
        assert row.model is not None
        drive, rising, falling = slow_loop(without_lateness(row.model), LOOP_POINTS)
        if line is None:
            line = np.polyfit(np.tile(drive, 2), np.concatenate((rising, falling)), 1)
        taken = np.polyval(line, drive)
        look = style.SEVERAL[number % len(style.SEVERAL)]
        around = np.concatenate((rising - taken, (falling - taken)[::-1]))
        pattern = {"linestyle": (0, (3.2, 1.4))} if number % 2 else {}
        axes.plot(
            np.concatenate((drive, drive[::-1])), around - around.mean(), label=row.name, **(look | pattern)
        )
    model: ActuatorModel | None = rows[0].model
    assert model is not None
    axes.set(xlabel=axis_label("Drive voltage", model.input.unit))
    axes.set(ylabel=axis_label("Displacement less a line", shown.unit))
    mark_curves(axes, columns=LEGEND_COLUMNS)
