"""The report as one HTML file: no script, no network, the figures inside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from dbo_cli.reports import renderers
from dbo_cli.reports.drawing import Plot, draw
from dbo_cli.reports.figures import shown_unit
from dbo_cli.reports.report import Report

UNBROKEN = 28  # letters of a name that stay together: nine columns beside it fit into 1,000 pixels


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
        For every log of the report, in its order, the figures to show (``figures.plots_of_log``); a log
        that has neither figures nor segments has no section.
    comparison_plots : sequence of Plot
        The figures of all logs together (``figures.plots_of_comparison``); they stand before those of each,
        and before the tables where there are no others: the tables of channels are long.
    model_plots : sequence of Plot
        The figures of the model, where one was compared (``models.plots_of_model``).
    title, program : str
        Heading of the page, and who made it (program and version), for the footer.
    """
    report = replace(report, unit=shown_unit(report.unit) or None)
    found = " ".join(map(breakable, renderers.headline(report).split()))
    errors, left = renderers.log_tables(report)
    together = drawn_figures(comparison_plots, "all")
    parts = [f"<h1>{escape(title)}</h1>", f'<p class="headline">{found}.</p>']
    parts += [
        f"<p>{escape(renderers.settings_line(report).replace(' - ', ' − ', 1))}.</p>",
        *([] if any(plots) else [together]),
        _table(errors, report.logs),
    ]
    parts += ["<h2>What is left of hysteresis and delay</h2>", _table(left, report.logs, chief=1)]
    first, second = map(escape, report.options.labels)
    parts.append(filled("glossary.html", first=first, second=second))
    if report.notes:
        parts.append(
            '<div class="notes">' + "".join(f"<p>{escape(note)}</p>" for note in report.notes) + "</div>"
        )
    if any(plots):
        parts.append(together)
    for number, (log, figures) in enumerate(zip(report.logs, plots, strict=True)):
        if not (figures or log.segments):
            continue
        parts.append(f"<section><h2>{breakable(log.name)}</h2>{drawn_figures(figures, f'l{number}')}")
        if log.segments:
            parts.append(f"<h3>{escape(renderers.segment_words(report).capitalize())}</h3>")
            parts.append(_table(renderers.segment_table(report), log.segments))
        parts.append("</section>")
    if model_plots:
        parts.append(f"<section><h2>The model</h2>{drawn_figures(model_plots, 'model')}</section>")
    if program:
        parts.append(f"<footer>{escape(program)}</footer>")
    return page_of(title, parts)


def page_of(title: str, parts: Sequence[str]) -> str:
    """Return a whole page of parts that are HTML already."""
    return filled("page.html", title=escape(title), style=filled("page.css"), body="\n".join(parts))


def filled(name: str, **values: str) -> str:
    """Return a file that lies beside this module, its ``$names`` replaced."""
    return Template(Path(__file__).with_name(name).read_text("utf-8")).substitute(values)


def _table(columns: Sequence[renderers.Column], parts: Sequence[Any], chief: int = 2) -> str:
    shown = [column for column in columns if column.long]
    return table([column.long for column in shown], [[c.cell(part) for c in shown] for part in parts], chief)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], chief: int) -> str:
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
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{body}\n</tbody></table>"


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
