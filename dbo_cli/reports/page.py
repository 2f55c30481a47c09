"""The report as one HTML file: no script, no network, the figures inside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template

from dbo_cli.reports.drawing import Plot, draw
from dbo_cli.reports.figures import shown_unit
from dbo_cli.reports.renderers import digits, settings_line
from dbo_cli.reports.report import LogReport, Report

UNBROKEN = 28  # letters of a name that stay together; 13 columns beside it fit into 1,280 pixels

MEANINGS = (
    ("RMSE", "Root of the mean square of the error."),
    ("% of range", "The same in percent of the range that {first} covers (NRMSE)."),
    ("95 %", "95 % of all samples have an error no larger than this."),
    ("Largest", "The largest error, and the data row of the log where it is."),
    ("Mean", "Mean of the error; where it was taken off beforehand, the offset that was taken off."),
    (
        "Loop left",
        "The hysteresis that is left: for equal values of {first}, the error on the way down less the"
        " error on the way up, averaged over the log, where it differs most. Negative: compensated too much."
        " A pure delay and a drift of the sensor open a loop, too.",
    ),
    ("Loop noise", "What noise alone would show as a loop; a loop no wider than that says nothing."),
    (
        "Lag left",
        "The delay by which {second} still follows {first}, from a fit of {first} and its slope;"
        " hysteresis shows in it too.",
    ),
    ("Ratio", "RMSE as a ratio to that of the first log."),
)


def to_html(
    report: Report,
    plots: Sequence[Sequence[Plot]],
    *,
    comparison_plots: Sequence[Plot] = (),
    model_plots: Sequence[Plot] = (),
    title: str = "Tracking report",
    program: str = "",
) -> str:
    """Return the whole page.

    Parameters
    ----------
    report : Report
        The values.
    plots : sequence of sequences of Plot
        For every log of the report, in its order, the figures to show (``figures.plots_of_log``).
    comparison_plots : sequence of Plot
        The figures of all logs together (``figures.plots_of_comparison``); they stand first.
    model_plots : sequence of Plot
        The figures of the model, where one was compared (``model_figures.plots_of_model``).
    title, program : str
        Heading of the page, and who made it (program and version), for the footer.
    """
    several = len(report.logs) > 1
    parts = [f"<h1>{escape(title)}</h1>", f"<p>{escape(_settings(report))}.</p>", _summary(report, several)]
    if report.notes:
        parts.append(
            '<div class="notes">' + "".join(f"<p>{escape(note)}</p>" for note in report.notes) + "</div>"
        )
    parts.append(drawn_figures(comparison_plots, "all"))
    for number, (log, figures) in enumerate(zip(report.logs, plots, strict=True)):
        parts.append(f"<section><h2>{breakable(log.name)}</h2>{drawn_figures(figures, f'l{number}')}")
        parts.append(_segments(report, log) + "</section>")
    if model_plots:
        parts.append(f"<section><h2>The model</h2>{drawn_figures(model_plots, 'model')}</section>")
    parts.append(_meanings(report, several))
    if program:
        parts.append(f"<footer>{escape(program)}</footer>")
    return page_of(title, parts)


def page_of(title: str, parts: Sequence[str]) -> str:
    """Return a whole page of parts that are HTML already."""
    skeleton, sheet = (
        Path(__file__).with_name(name).read_text("utf-8") for name in ("page.html", "page.css")
    )
    return Template(skeleton).substitute(title=escape(title), style=sheet, body="\n".join(parts))


def _settings(report: Report) -> str:
    line = settings_line(report)
    return line.replace(f" in {report.unit}", f" in {shown_unit(report.unit)}", 1).replace(" - ", " − ", 1)


def _summary(report: Report, several: bool) -> str:
    unit = shown_unit(report.unit)
    in_unit = f" ({unit})" if unit else ""
    removed = report.options.remove_offset
    head = ["Log", "Samples", f"RMSE{in_unit}", "% of range", f"95 %{in_unit}", f"Largest{in_unit}", "at row"]
    head += [f"{'Offset' if removed else 'Mean'}{in_unit}", f"Loop left{in_unit}", "Loop noise"]
    head += ["Lag left (samples)", "Lag left (ms)", "Phase left"]
    head += ["Ratio"] if several else []
    rows = []
    for log in report.logs:
        figures, record = log.figures, log.record()
        row = [
            log.name,
            str(figures.samples),
            digits(figures.rmse),
            digits(figures.nrmse_percent),
            digits(figures.p95_abs),
            digits(figures.max_abs),
            str(figures.max_abs_row),
            digits(figures.offset if removed else figures.mean),
            digits(figures.loop_width),
            digits(figures.loop_noise, 2),
            digits(figures.lag_left, 3),
            digits(None if record["lag_left_s"] is None else 1000.0 * record["lag_left_s"], 3),
            "-" if figures.phase_left is None else f"{digits(figures.phase_left, 3)}°",
        ]
        rows.append(row + ([digits(log.ratio_to_first)] if several else []))
    return table(head, rows, chief=2)


def _segments(report: Report, log: LogReport) -> str:
    if not log.segments:
        return ""
    removed = report.options.remove_offset
    what = "cycle" if report.options.segment == "cycles" else f"{report.options.segment:g} s"
    head = ["Part", "Rows", "RMSE", "% of range", "95 %", "Largest", "Offset" if removed else "Mean"]
    head += ["Loop left", "Lag left"]
    rows = []
    for part in log.segments:
        figures = part.figures
        numbers = [figures.rmse, figures.nrmse_percent, figures.p95_abs, figures.max_abs]
        numbers += [figures.offset if removed else figures.mean, figures.loop_width, figures.lag_left]
        place = f"{part.first_row}–{part.last_row}"
        rows.append([f"{part.number}", place, *(digits(number, 3) for number in numbers)])
    return f"<h3>By {escape(what)}</h3>{table(head, rows, chief=2, name='segments')}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], chief: int, name: str = "summary") -> str:
    """Return a table whose cells know their heading, so that a narrow screen can show a row as a card."""
    cells = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = []
    for row in rows:
        line = ""
        for number, (title, cell) in enumerate(zip(head, row, strict=True)):
            mark = ' class="chief"' if number == chief else ""
            content = breakable(cell) if number == 0 else escape(cell)
            line += f'<td{mark} data-label="{escape(title)}">{content}</td>'
        lines.append(f"<tr>{line}</tr>")
    body = "\n".join(lines)
    return f'<table class="{name}"><thead><tr>{cells}</tr></thead><tbody>\n{body}\n</tbody></table>'


def breakable(name: str) -> str:
    """Return a name as HTML that breaks, where it must, behind a separator; a short one does not break."""
    if len(name) <= UNBROKEN:
        return f'<span class="name">{escape(name)}</span>'
    pieces = []
    for piece in re.split(r"(?<=[/\\_. -])", name):
        pieces += [piece[start : start + UNBROKEN] for start in range(0, len(piece), UNBROKEN)]
    return "<wbr>".join(f'<span class="name">{escape(piece)}</span>' for piece in pieces if piece)


def drawn_figures(plots: Sequence[Plot], scope: str) -> str:
    """Return figures as part of a page; ``scope`` keeps their ids apart."""
    drawn = []
    for plot in plots:
        image = draw(plot, "inline", scope=scope).decode()
        drawn.append(f"<figure><figcaption>{escape(plot.title)}</figcaption>{image}</figure>")
    return '<div class="figures">' + "\n".join(drawn) + "</div>" if drawn else ""


def _meanings(report: Report, several: bool) -> str:
    first, second = report.options.labels
    chosen = MEANINGS if several else MEANINGS[:-1]
    items = "".join(
        f"<dt>{escape(term)}</dt><dd>{escape(text.format(first=first, second=second))}</dd>"
        for term, text in chosen
    )
    return f"<section><h2>What the figures mean</h2><dl>{items}</dl></section>"
