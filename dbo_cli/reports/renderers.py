"""The report as text in 80 columns, JSON, CSV and an HTML page: the same values, always the same bytes."""

from __future__ import annotations

import csv
import io
import json
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from dbo_cli.reports.drawing import Plot, draw, short_name, text_width
from dbo_cli.reports.report import Judgement, Report, digits

JSON_VERSION = 1  # of the form dbo-report; a change of meaning would need another
WIDTH = 80  # columns of the narrowest usual terminal
# limits that are kept are listed, at most: of a hundred channels nobody reads them
MOST_PASSED = 8
# letters of a name that stay together: nine columns beside it fit into 1,000 pixels of
# a page
UNBROKEN = 28
LEFT = "Left over: hysteresis (loop: error going down less going up) and delay (lag)"


def to_json(report: Report) -> str:
    """Return the report as JSON text: ``dbo-report`` version 1, numbers that read back exactly.

    Keys, always all of them and in this order: ``format``, ``version``, ``unit`` (null:
    not known), ``compared`` (what was compared with what; the error is the second less
    the first), ``offset_removed``, ``logs``, ``notes``, ``limits`` (a list of ``name``,
    ``figure``, ``limit``, ``value``, ``passed``), ``passed`` (whether all limits are
    kept; null where none was set) and ``warnings``. Each log: ``name``, ``samples``,
    ``rmse``, ``nrmse_percent`` (of desired_max - desired_min; null for a constant),
    ``max_abs``, ``max_abs_row`` (data row from 1), ``max_abs_time_s``, ``mean``,
    ``p95_abs`` (95 % of all |errors| are no larger), ``loop_width`` (signed, see
    ``figures_of_merit.LoopWidth``), ``loop_width_percent``, ``lag_left_samples``,
    ``lag_left_s``, ``phase_left_degrees``, ``desired_min``, ``desired_max``,
    ``lag_samples`` (taken out beforehand), ``lag_s``, ``offset_removed`` (subtracted
    from the error), ``sample_period_s``, ``not_finite`` (rows left out),
    ``ratio_to_first`` (of the RMSE), ``loop_noise`` (what noise alone would show as
    ``loop_width``), ``rmse_percent_of_move`` (``nrmse_percent`` under the name of its
    denominator), ``rmse_percent_of_range`` (of the range of the model's output; null
    where no model is known), ``expected_rmse`` (that the model states for this drive,
    null where it is not known; where the mean error is taken off, without the mean),
    ``half_of_error_first_row``, ``half_of_error_last_row`` and
    ``half_of_error_percent_of_rows`` (the shortest piece of the log that makes half of
    the squared error), ``rmse_elsewhere`` (of all other rows), ``segments``: a list of
    ``number``, ``first_row``, ``last_row``, the keys from ``samples`` to
    ``desired_max``, ``offset_removed`` (the segment's own), ``loop_noise`` and
    ``frequency_hz`` (of the desired signal). New keys may come in later releases; none
    will change its meaning within version 1.
    """
    content = {
        "format": "dbo-report",
        "version": JSON_VERSION,
        "unit": report.unit,
        "compared": list(report.options.labels),
        "offset_removed": report.options.remove_offset,
        "logs": [
            log.record() | {"segments": [part.record() for part in log.segments]}
            for log in report.logs
        ],
        "notes": report.notes,
        "limits": [judgement.record() for judgement in report.judgements],
        "passed": not report.missed if report.judgements else None,
        "warnings": report.warnings,
    }
    return json_text(content)


def to_csv(report: Report) -> str:
    """Return one line a log: the keys of the JSON form, then the unit; what is undefined is left empty.

    Where there are segments, each log's follow its line, and three columns more tell
    them: ``segment`` (the number; empty for the whole log), ``first_row`` and
    ``last_row``. No name is a formula to a spreadsheet.
    """
    unit = None if report.unit is None else no_formula(report.unit)
    rows = []
    for log in report.logs:
        whole = log.record() | {"name": no_formula(log.name)}
        rows.append(whole | {"unit": unit})
        for segment in log.segments:
            figures = segment.record()
            place = {
                "segment": figures.pop("number"),
                "first_row": figures.pop("first_row"),
                "last_row": figures.pop("last_row"),
            }
            row: dict[str, Any] = dict.fromkeys(whole)
            row |= {"name": whole["name"], **figures, "unit": unit, **place}
            rows.append(row)
    return csv_text(rows)


def json_text(content: Mapping[str, Any]) -> str:
    """Return plain values as JSON text."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return one line a row; the longest row has all columns, what another lacks is left empty."""
    out = io.StringIO()
    writer = csv.DictWriter(
        out, max(map(list[str], rows), key=len), lineterminator="\n"
    )
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def no_formula(name: str) -> str:
    """Put an apostrophe before a text that a spreadsheet would calculate instead of showing."""
    begins_formula = name.startswith(("=", "+", "@"))
    if begins_formula or (name.startswith("-") and name != "-"):
        return f"'{name}"
    return name


def to_text(report: Report) -> str:
    """Return one sentence and tables of at most 80 columns, four significant digits, for a terminal."""
    errors = _columns_of_errors(report)
    left = _columns_of_what_is_left(report)
    parts = ["\n".join(wrapped(line)) for line in verdict_lines(report)]
    parts += ["\n".join(wrapped(headline(report)))]
    parts += ["\n".join(wrapped(line)) for line in expected_lines(report)]
    parts += ["\n".join(wrapped(f"Warning: {warning}")) for warning in report.warnings]
    parts += ["\n".join(wrapped(settings_line(report)))]
    parts += [_table_of(errors, report.logs), f"{LEFT}\n{_table_of(left, report.logs)}"]
    for log in report.logs:
        if log.segments:
            title = "\n".join(wrapped(f"{log.name}, {segment_words(report)}"))
            parts.append(f"{title}\n{_table_of(segment_table(report), log.segments)}")
    if report.notes:
        notes = ["\n".join(wrapped(f"Note: {note}")) for note in report.notes]
        parts.append("\n".join(notes))
    return "\n\n".join(parts) + "\n"


def verdict_lines(report: Report) -> list[str]:
    """Return whether the limits are kept, and each that is missed; no line where none was set."""
    if not report.judgements:
        return []
    missed = report.missed
    if missed and len(report.judgements) == 1:
        return [f"FAILED: {_judgement_words(report, missed[0])}"]
    if missed:
        count = f"{len(missed)} of {len(report.judgements)} limits missed"
        return [
            f"FAILED: {count}",
            *[_judgement_words(report, judgement) for judgement in missed],
        ]
    words = [_judgement_words(report, judgement) for judgement in report.judgements]
    if len(words) == 1:
        return [f"PASSED: {words[0]}"]
    return [f"PASSED: all {len(words)} limits", *words[:MOST_PASSED]]


def _judgement_words(report: Report, judgement: Judgement) -> str:
    """Return figure, limit and what comes of it; the log's name where there are several."""
    name = _name_among(report, judgement.name)
    if judgement.value is None:
        value = "undefined"
        relation = "not comparable with"
    else:
        value = f"{digits(judgement.value, 4)}{judgement.unit}"
        relation = "within" if judgement.passed else "above"
    return f"{name}{judgement.title} {value}, {relation} the limit of {judgement.limit:g}{judgement.unit}"


def _name_among(report: Report, name: str) -> str:
    """Return a log's name as it begins a line; nothing where it is the only log."""
    if len(report.logs) == 1:
        return ""
    return f"{name}: "


def expected_lines(report: Report) -> list[str]:
    """Return for each log whose expected error is known that one beside the actual one."""
    lines = []
    for log in report.logs:
        expected = log.expected_rmse
        if expected is None or log.expected is None:
            continue
        name = _name_among(report, log.name)
        unit = _unit(report)
        line = (
            f"{name}Expected {digits(expected, 2)}{unit} RMSE (by {log.expected.source}), actual "
            f"{digits(log.figures.rmse, 2)}{unit}"
        )
        if expected > 0.0:
            times = digits(log.figures.rmse / expected, 2)
            line += f", {times} times as much came"
        lines.append(line)
    return lines


def headline(report: Report) -> str:
    """Return what was found in one sentence: of several logs the least error, and that of the first one."""
    first, *others = report.logs
    best = min(others, key=lambda log: log.figures.rmse, default=first)
    figures = best.figures
    line = f"{best.name}: {digits(figures.rmse, 2)}{_unit(report)} RMSE"
    if best is first and figures.nrmse_percent is None:
        return line
    if best is first:
        return f"{line}, {digits(figures.nrmse_percent, 2)} % of the move"
    if not figures.rmse > 0.0 or not first.figures.rmse > 0.0:
        return (
            f"{line}; {first.name}: {digits(first.figures.rmse, 2)}{_unit(report)} RMSE"
        )
    times = first.figures.rmse / figures.rmse
    factor = digits(max(times, 1.0 / times), 2)
    if factor == "1.0":
        return f"{line}, as much as {first.name}"
    direction = "less" if times > 1.0 else "more"
    return f"{line}, {factor} times {direction} than {first.name}"


class ReportColumn(NamedTuple):
    """One column of a table: its heading in text and on a page (empty: not there), and its cells."""

    short: str
    long: str
    cell: Callable[[Any], str]


NAME = ReportColumn("log", "Log", lambda log: str(log.name))


def _columns_of_errors(report: Report) -> list[ReportColumn]:
    """Return the columns of the table of errors; some are there only where their figures are known."""
    unit = _unit(report, " ({})")
    columns = [
        NAME,
        ReportColumn("samples", "Samples", lambda log: str(log.figures.samples)),
        *_errors(report, 4),
    ]
    if any(log.expected is not None for log in report.logs):
        columns.insert(
            4,
            ReportColumn(
                "% range",
                "% of the model's range",
                lambda log: digits(log.percent_of_range),
            ),
        )
    if any(log.expected_rmse is not None for log in report.logs):
        expected = ReportColumn(
            "expected", f"Expected{unit}", lambda log: digits(log.expected_rmse)
        )
        columns.insert(3, expected)
    if len(report.logs) > 1:
        columns.append(
            ReportColumn(
                "ratio", "Times the first", lambda log: digits(log.ratio_to_first)
            )
        )
    return columns


def _columns_of_what_is_left(report: Report) -> list[ReportColumn]:
    """Return the columns of the table of loop and lag."""
    unit = _unit(report, " ({})")
    return [
        NAME,
        ReportColumn(
            "loop left",
            f"Hysteresis left{unit}",
            lambda log: digits(log.figures.loop_width),
        ),
        ReportColumn(
            "% move",
            "the same, % of the move",
            lambda log: digits(log.figures.loop_width_percent),
        ),
        ReportColumn(
            "by noise",
            f"Noise alone{unit}",
            lambda log: digits(log.figures.loop_noise, 2),
        ),
        ReportColumn(
            "lag left",
            "Delay left (samples)",
            lambda log: digits(log.figures.lag_left, 3),
        ),
        ReportColumn(
            "seconds", "", lambda log: digits(log.figures.lag_left_seconds, 3)
        ),
        ReportColumn(
            "",
            "Delay left (ms)",
            lambda log: digits(log.figures.lag_left_seconds, 3, 1000.0),
        ),
        ReportColumn(
            "phase",
            "Phase left (360° a cycle)",
            lambda log: digits(log.figures.phase_left, 3) + "°",
        ),
        ReportColumn("largest at row", "", lambda log: str(log.figures.max_abs_row)),
    ]


def segment_table(report: Report) -> list[ReportColumn]:
    """Return the columns of a table of segments."""
    return [
        ReportColumn("part", "Part", lambda part: str(part.number)),
        ReportColumn("rows", "Rows", lambda part: f"{part.first_row}:{part.last_row}"),
        *_errors(report, 3),
        ReportColumn(
            "loop", "Hysteresis left", lambda part: digits(part.figures.loop_width, 3)
        ),
        ReportColumn(
            "lag", "Delay left (samples)", lambda part: digits(part.figures.lag_left, 3)
        ),
    ]


def segment_words(report: Report) -> str:
    """Return how the segments were cut."""
    segment = report.options.segment
    if segment == "cycles":
        return "by cycle"
    return f"by {segment:g} s"


def _errors(report: Report, places: int) -> list[ReportColumn]:
    unit = _unit(report, " ({})")
    mean = "offset" if report.options.remove_offset else "mean"
    return [
        ReportColumn(
            "RMSE", f"RMSE{unit}", lambda part: digits(part.figures.rmse, places)
        ),
        ReportColumn(
            "% move",
            "% of the move",
            lambda part: digits(part.figures.nrmse_percent, places),
        ),
        ReportColumn(
            "95 %",
            f"95 % below{unit}",
            lambda part: digits(part.figures.p95_abs, places),
        ),
        ReportColumn(
            "largest",
            f"Largest{unit}",
            lambda part: digits(part.figures.max_abs, places),
        ),
        ReportColumn("", "at row", lambda part: str(part.figures.max_abs_row)),
        ReportColumn(
            mean,
            f"{mean.capitalize()}{unit}",
            lambda part: digits(getattr(part.figures, mean), places),
        ),
    ]


def _unit(report: Report, form: str = " {}") -> str:
    return form.format(report.unit) if report.unit else ""


def _table_of(columns: Sequence[ReportColumn], parts: Sequence[Any]) -> str:
    shown = [column for column in columns if column.short]
    rows = [[column.cell(part) for column in shown] for part in parts]
    return text_table([column.short for column in shown], rows)


def settings_line(report: Report) -> str:
    """Return what was compared, in a phrase."""
    first, second = report.options.labels
    line = f"Error = {second} - {first}"
    if report.unit:
        line += f" in {report.unit}"
    else:
        line += " (unit not known)"
    if report.options.remove_offset:
        line += ", mean error removed"
    lags = sorted({log.lag for log in report.logs})
    if lags != [0]:
        samples = "sample" if lags == [1] else "samples"
        count = " or ".join(str(lag) for lag in lags)
        line += f", {second} taken {count} {samples} after {first}"
    return line


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return columns two blanks apart, the first to the left, numbers to the right.

    Where that is too wide: one blank, then every name on a line of its own above its
    numbers.
    """
    widths = [max(map(text_width, column)) for column in zip(head, *rows, strict=True)]
    gap = "  " if sum(widths) + 2 * (len(widths) - 1) <= WIDTH else " "
    room = WIDTH - sum(widths[1:]) - len(gap) * (len(widths) - 1)
    widths[0] = min(widths[0], max(room, text_width(head[0])))
    lines = []
    for cells in [head, *rows]:
        name = cells[0]
        if text_width(name) > widths[0]:
            lines.append(short_name(name, WIDTH))
            name = ""
        numbers = [
            cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)
        ]
        lines.append(
            gap.join([name + " " * (widths[0] - text_width(name)), *numbers]).rstrip()
        )
    return "\n".join(lines)


def wrapped(text: str) -> list[str]:
    """Return a text as lines of at most 80 columns, the later ones indented."""
    return textwrap.wrap(
        text,
        WIDTH,
        subsequent_indent=" " * 6,
        break_long_words=False,
        break_on_hyphens=False,
    )


def shown_unit(unit: str | None) -> str:
    """Return a unit as people write it: ``um`` is spelled with the Greek letter."""
    return {"um": "µm", "us": "µs"}.get(unit or "", unit or "")


# --- the report as one HTML file: no script, no network, the figures inside it ---


def to_html(
    report: Report,
    plots: Sequence[Sequence[Plot]],
    *,
    comparison_plots: Sequence[Plot] = (),
    model_plots: Sequence[Plot] = (),
    program: str,
    title: str = "Tracking report",
) -> str:
    """Return the whole page.

    Parameters
    ----------
    report : Report
        The values.
    plots : sequence of sequences of Plot
        For every log of the report, in its order, the figures to show
        (``figures.plots_of_log``); a log that has neither figures nor segments has no
        section.
    comparison_plots : sequence of Plot
        The figures of all logs together (``figures.plots_of_comparison``); they stand
        before those of each, and before the tables where there are no others: the
        tables of channels are long.
    model_plots : sequence of Plot
        The figures of the model, where one was compared (``models.plots_of_model``).
    program, title : str
        Who made the page (program and version), for the footer, and its heading.
    """
    report = replace(report, unit=shown_unit(report.unit) or None)
    sentence = " ".join(map(breakable, headline(report).split()))
    errors = _columns_of_errors(report)
    left = _columns_of_what_is_left(report)
    together = drawn_figures(comparison_plots, "all")
    parts = [_html_verdict(report), f'<p class="headline">{sentence}.</p>']
    parts += [f"<p>{escape(line)}.</p>" for line in expected_lines(report)]
    for warning in report.warnings:
        parts.append(
            f'<div class="notes"><p><strong>Warning:</strong> {escape(warning)}</p></div>'
        )
    settings = settings_line(report).replace(" - ", " − ", 1)
    parts.append(f"<p>{escape(settings)}.</p>")
    if not any(plots):
        parts.append(together)
    parts.append(_html_table(errors, report.logs))
    parts.append("<h2>What is left of hysteresis and delay</h2>")
    parts.append(_html_table(left, report.logs, chief=1))
    first, second = map(escape, report.options.labels)
    parts.append(filled("glossary.html", first=first, second=second))
    if report.notes:
        notes = "".join(f"<p>{escape(note)}</p>" for note in report.notes)
        parts.append(f'<div class="notes">{notes}</div>')
    if any(plots):
        parts.append(together)
    for number, (log, figures) in enumerate(zip(report.logs, plots, strict=True)):
        if not (figures or log.segments):
            continue
        parts.append(
            f"<section><h2>{breakable(log.name)}</h2>{drawn_figures(figures, f'l{number}')}"
        )
        if log.segments:
            parts.append(f"<h3>{escape(segment_words(report).capitalize())}</h3>")
            parts.append(_html_table(segment_table(report), log.segments))
        parts.append("</section>")
    if model_plots:
        parts.append(
            f"<section><h2>The model</h2>{drawn_figures(model_plots, 'model')}</section>"
        )
    return page_of(title, parts, program)


def _html_verdict(report: Report) -> str:
    """Return the verdict on the limits as the first line of a page; nothing where no limit was set."""
    lines = verdict_lines(report)
    if not lines:
        return ""
    outcome = "failed" if report.missed else "passed"
    rest = "".join(f"<br>{escape(line)}" for line in lines[1:])
    return f'<p class="verdict {outcome}"><strong>{escape(lines[0])}</strong>{rest}</p>'


def page_of(title: str, parts: Sequence[str], program: str) -> str:
    """Return a whole page of parts that are HTML already, between its heading and the program's name."""
    body = "\n".join(
        [f"<h1>{escape(title)}</h1>", *parts, f"<footer>{escape(program)}</footer>"]
    )
    return filled("page.html", title=escape(title), style=filled("page.css"), body=body)


def filled(name: str, **values: str) -> str:
    """Return a file that lies beside this module, its ``$names`` replaced."""
    return Template(Path(__file__).with_name(name).read_text("utf-8")).substitute(
        values
    )


def _html_table(
    columns: Sequence[ReportColumn], parts: Sequence[Any], chief: int = 2
) -> str:
    shown = [column for column in columns if column.long]
    rows = [[column.cell(part) for column in shown] for part in parts]
    return html_table([column.long for column in shown], rows, chief)


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], chief: int) -> str:
    """Return a table whose cells know their heading, so that a narrow screen can show a row as a card."""
    cells = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = []
    for row in rows:
        line = ""
        for number, (title, cell) in enumerate(zip(head, row, strict=True)):
            mark = ""
            if number == chief:
                mark = ' class="chief"'
            content = escape(cell)
            if number == 0:
                content = breakable(cell)
            line += f'<td{mark} data-label="{escape(title)}">{content}</td>'
        lines.append(f"<tr>{line}</tr>")
    body = "\n".join(lines)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{body}\n</tbody></table>"


def breakable(name: str) -> str:
    """Return a name as HTML that breaks, where it must, behind a separator; a short one does not break."""
    if len(name) <= UNBROKEN:
        return f'<span class="name">{escape(name)}</span>'
    pieces = []
    for part in re.split(r"(?<=[/\\_. -])", name):
        for start in range(0, len(part), UNBROKEN):
            piece = escape(part[start : start + UNBROKEN])
            pieces.append(f'<span class="name">{piece}</span>')
    return "<wbr>".join(pieces)


def drawn_figures(plots: Sequence[Plot], scope: str) -> str:
    """Return figures as part of a page; ``scope`` keeps their ids apart."""
    drawn = []
    for plot in plots:
        image = draw(plot, "inline", scope=scope).decode()
        drawn.append(
            f"<figure><figcaption>{escape(plot.title)}</figcaption>{image}</figure>"
        )
    if not drawn:
        return ""
    return '<div class="figures">' + "\n".join(drawn) + "</div>"
