"""The report as text, JSON, CSV and an HTML page: the same values, the same bytes every time."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from importlib import resources
from string import Template

from dbo_cli.reports.comparison import Scores
from dbo_cli.reports.plots import Plot, image, sections_of_report
from dbo_cli.reports.words import (
    digits,
    json_text,
    shortened,
    shown_unit,
    text_table,
)
from dbo_cli.version import __version__

REPORT_VERSION = 1  # of the form dbo-report
LENGTHS = ("RMSE", "expected", "largest", "mean", "offset", "loop")


def to_json(report: Scores) -> str:
    """Return the report as JSON text, ``dbo-report`` version 1; numbers read back exactly.

    The keys are always all there, in this order: ``format``, ``version``, ``unit``,
    ``compared`` (the error is the second less the first), ``offset_removed``, ``logs``
    (``LogReport.record``), ``notes``, ``limits`` (``Verdict.record``), ``passed`` (null
    where no limit was set) and ``warnings``. Keys may be added within a version; none
    changes its meaning. Rows count from 1, in the file.
    """
    content = {
        "format": "dbo-report",
        "version": REPORT_VERSION,
        "unit": report.unit,
        "compared": list(report.labels),
        "offset_removed": report.remove_offset,
        "logs": [log.record() for log in report.logs],
        "notes": report.notes,
        "limits": [verdict.record() for verdict in report.verdicts],
        "passed": report.passed,
        "warnings": report.warnings,
    }
    return json_text(content)


def to_csv(report: Scores) -> str:
    """Return a line a log: the keys of the JSON form and the unit; what is undefined is empty."""
    rows = [{**log.record(), "unit": report.unit} for log in report.logs]
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def report_table(report: Scores) -> tuple[list[str], list[list[str]]]:
    """Return the headings of the table and a row a log; what is not known of any is left out."""
    clocked = any(log.pair.step() for log in report.logs)
    expected = any(log.expected_rmse for log in report.logs)
    rows = []
    for log in report.logs:
        figures = log.merits
        cells = {
            "log": shortened(log.name),
            "rows": f"{figures.samples:,}",
            "RMSE": digits(figures.rmse),
        }
        if expected:
            cells["expected"] = digits(log.expected_rmse)
        cells["% of move"] = digits(figures.nrmse_percent, 3)
        cells["largest"] = digits(figures.max_abs)
        cells["at row"] = f"{log.largest_row:,}"
        if report.remove_offset:
            cells["offset"] = digits(figures.offset)
        else:
            cells["mean"] = digits(figures.mean)
        cells["loop"] = digits(figures.loop_width, 3)
        if clocked:
            cells["lag (ms)"] = digits(log.seconds(figures.lag, 1000.0), 3)
        else:
            cells["lag (rows)"] = digits(figures.lag, 3)
        if len(report.logs) > 1:
            cells["ratio"] = digits(log.ratio_to_first, 3)
        rows.append(cells)
    return list(rows[0]), [list(cells.values()) for cells in rows]


def to_text(report: Scores) -> str:
    """Return the verdict, an aligned table and at most a few lines."""
    lines = [verdict.words() for verdict in report.verdicts]
    if lines:
        lines.insert(0, "PASSED" if report.passed else "FAILED")
        lines.append("")
    lines.append(text_table(*report_table(report)))
    lines += ["", settings_line(report)]
    lines += [f"warning: {warning}" for warning in report.warnings]
    lines += [f"note: {note}" for note in report.notes]
    return "\n".join(lines) + "\n"


def settings_line(report: Scores) -> str:
    """Return what was compared, and what the figures mean."""
    first, second = report.labels
    line = f"error = {second} - {first}"
    if report.unit:
        line += f" in {report.unit}"
    if report.remove_offset:
        line += ", mean removed"
    lag = report.logs[0].lag
    if lag:
        line += f", {second} taken {lag} rows later"
    line += f"; move: range of {first}; loop: error falling less error rising"
    return line


# --- the page: no script, no network, the figures inside it ---


def to_html(report: Scores) -> str:
    """Return a page that needs no other file: verdict, table, figures, footer."""
    unit = shown_unit(report.unit)
    report = replace(report, unit=unit or None)
    titles, rows = report_table(report)
    headings = []
    for title in titles:
        length = unit and title in LENGTHS
        headings.append(f"{title} ({unit})" if length else title)
    parts = [_verdict(report), f'<p class="headline">{escape(report.line())}</p>']
    for warning in report.warnings:
        parts.append(f'<p class="warning">Warning: {escape(warning)}</p>')
    parts.append(html_table(headings, rows, chief=2))
    parts.append(f'<p class="muted">{escape(settings_line(report))}</p>')
    parts += [f'<p class="muted">{escape(note)}</p>' for note in report.notes]
    for title, plots in sections_of_report(report):
        parts.append(f"<h2>{escape(title)}</h2>{html_figures(plots)}")
    parts.append(f"<footer>{'<br>'.join(map(escape, footer_lines(report)))}</footer>")
    folder = resources.files("dbo_cli.reports")
    frame = Template(folder.joinpath("page.html").read_text("utf-8"))
    style = folder.joinpath("page.css").read_text("utf-8")
    return frame.substitute(style=style, body="\n".join(filter(None, parts)))


def _verdict(report: Scores) -> str:
    """Return whether the limits are kept; nothing where none was set."""
    if report.passed is None:
        return ""
    word = "passed" if report.passed else "failed"
    lines = [f"<strong>{word.capitalize()}</strong>"]
    lines += [escape(verdict.words()) for verdict in report.verdicts]
    return f'<p class="verdict {word}">{"<br>".join(lines)}</p>'


def footer_lines(report: Scores) -> list[str]:
    """Return who made the page, and how: version and command; no time of day."""
    lines = [f"dbo {__version__}"]
    if report.command:
        lines.append(report.command)
    return lines


def html_table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], chief: int
) -> str:
    """Return a table whose cells know their heading: a narrow screen shows a row as a card."""
    cells = "".join(f'<th scope="col">{escape(title)}</th>' for title in headings)
    lines = []
    for row in rows:
        line = ""
        for number, (title, cell) in enumerate(zip(headings, row, strict=True)):
            mark = ' class="chief"' if number == chief else ""
            line += f'<td{mark} data-label="{escape(title)}">{escape(cell)}</td>'
        lines.append(f"<tr>{line}</tr>")
    body = "\n".join(lines)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{body}\n</tbody></table>"


def html_figures(plots: Sequence[Plot]) -> str:
    """Return figures as part of a page."""
    drawn = []
    for plot in plots:
        caption = f"<figcaption>{escape(plot.title)}</figcaption>"
        drawn.append(f"<figure>{caption}{image(plot)}</figure>")
    return '<div class="figures">' + "\n".join(drawn) + "</div>"


FORMS: dict[str, Callable[[Scores], str]] = {
    "text": to_text,
    "json": to_json,
    "csv": to_csv,
    "html": to_html,
}
