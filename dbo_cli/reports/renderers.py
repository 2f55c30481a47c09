"""The report as text in 80 columns, as JSON and as CSV: the same values, and always the same bytes."""

from __future__ import annotations

import csv
import io
import json
import textwrap
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any

from dbo_cli.reports.report import LogReport, Report

JSON_VERSION = 1
WIDTH = 80
NAME_WIDTH = 20


def to_json(report: Report, provenance: Mapping[str, Any] | None = None) -> str:
    """Return the report as JSON text: ``dbo-report`` version 1, numbers that read back exactly.

    Keys, always all of them and in this order: ``format``, ``version``, ``unit`` (null: not known),
    ``compared`` (what was compared with what; the error is the second less the first), ``offset_removed``,
    ``logs``, ``notes`` and, where given, ``provenance``. Each log: ``name``, ``samples``, ``rmse``,
    ``nrmse_percent`` (of desired_max - desired_min; null for a constant), ``max_abs``, ``max_abs_row``
    (data row from 1), ``max_abs_time_s``, ``mean``, ``p95_abs`` (95 % of all |errors| are no larger),
    ``loop_width`` (signed, see ``loop_width.LoopWidth``), ``loop_width_percent``, ``lag_left_samples``,
    ``lag_left_s``, ``phase_left_degrees``, ``desired_min``, ``desired_max``, ``lag_samples`` (taken out
    beforehand), ``lag_s``, ``offset_removed`` (subtracted from the error), ``sample_period_s``,
    ``not_finite`` (rows left out), ``ratio_to_first`` (of the RMSE), ``loop_noise`` (what noise alone would
    show as ``loop_width``), ``segments``: a list of ``number``, ``first_row``, ``last_row``, the keys from
    ``samples`` to ``desired_max``, ``offset_removed`` (the segment's own), ``loop_noise`` and
    ``frequency_hz`` (of the desired signal). New keys may come in later releases; none will change its
    meaning within version 1.
    """
    content: dict[str, Any] = {
        "format": "dbo-report",
        "version": JSON_VERSION,
        "unit": report.unit,
        "compared": list(report.options.labels),
        "offset_removed": report.options.remove_offset,
        "logs": [
            log.record() | {"segments": [part.record() for part in log.segments]} for log in report.logs
        ],
        "notes": report.notes,
    }
    if provenance is not None:
        content["provenance"] = dict(provenance)
    return json_text(content)


def to_csv(report: Report) -> str:
    """Return one line a log: the keys of the JSON form, then the unit; what is undefined is left empty.

    Where there are segments, each log's follow its line, and three columns more tell them: ``segment`` (the
    number; empty for the whole log), ``first_row`` and ``last_row``. No name is a formula to a spreadsheet.
    """
    unit = {"unit": None if report.unit is None else no_formula(report.unit)}
    rows = []
    for log in report.logs:
        whole = log.record() | {"name": no_formula(log.name)}
        rows.append(whole | unit)
        for part in log.segments:
            own = part.record()
            place = {"segment": own.pop("number"), **{key: own.pop(key) for key in ("first_row", "last_row")}}
            rows.append(dict.fromkeys(whole) | {"name": whole["name"]} | own | unit | place)
    return csv_text(rows)


def json_text(content: Mapping[str, Any]) -> str:
    """Return plain values as JSON text."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return one line a row; the longest row has all columns, what another lacks is left empty."""
    out = io.StringIO()
    writer = csv.DictWriter(out, max(map(list[str], rows), key=len), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def no_formula(name: str) -> str:
    """Put an apostrophe before a text that a spreadsheet would calculate instead of showing."""
    return f"'{name}" if name[:1] in ("=", "+", "@") or (name[:1] == "-" and len(name) > 1) else name


def to_text(report: Report) -> str:
    """Return tables of at most 80 columns, four significant digits, for a terminal or a notebook."""
    parts = ["\n".join(_headline(report)), _error_table(report), _loop_table(report)]
    parts += [_segment_table(report, log) for log in report.logs if log.segments]
    if report.notes:
        parts.append("\n".join(line for note in report.notes for line in wrapped(f"Note: {note}")))
    return "\n\n".join(parts) + "\n"


def digits(value: float | None, places: int = 4) -> str:
    """Return a number to ``places`` significant digits, without an exponent in 1e-3 to 1e6; None is ``-``."""
    if value is None:
        return "-"
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e6:
        text = f"{value:#.{places}g}"
        if "e" in text:
            return f"{value:.0f}"
        return text.rstrip(".")
    return f"{value:.{places - 1}e}"


def settings_line(report: Report) -> str:
    """Return what was compared, in a phrase."""
    first, second = report.options.labels
    unit = f" in {report.unit}" if report.unit else " (unit not known)"
    offset = ", mean error removed" if report.options.remove_offset else ""
    lags = sorted({log.lag for log in report.logs})
    lag = ""
    if lags != [0]:
        said = " or ".join(str(value) for value in lags)
        lag = f", {second} taken {said} sample{'' if lags == [1] else 's'} after {first}"
    return f"Error = {second} - {first}{unit}{offset}{lag}"


def _headline(report: Report) -> list[str]:
    return wrapped(settings_line(report))


def _mean_title(report: Report) -> str:
    return "offset" if report.options.remove_offset else "mean"


def _error_table(report: Report) -> str:
    several = len(report.logs) > 1
    head = ["log", "samples", "RMSE", "% range", "95 %", "largest", _mean_title(report)]
    rows = []
    for log in report.logs:
        figures = log.figures
        shown = figures.offset if report.options.remove_offset else figures.mean
        numbers = [figures.rmse, figures.nrmse_percent, figures.p95_abs, figures.max_abs, shown]
        ratio = [digits(log.ratio_to_first)] if several else []
        rows.append([short_name(log.name), str(figures.samples), *map(digits, numbers), *ratio])
    return table(head + ["ratio"] * several, rows)


def _loop_table(report: Report) -> str:
    head = ["log", "loop left", "% range", "noise", "lag left", "seconds", "phase", "largest at row"]
    rows = []
    for log in report.logs:
        record = log.record()
        phase = digits(log.figures.phase_left, 3)
        rows.append(
            [
                short_name(log.name),
                digits(record["loop_width"]),
                digits(record["loop_width_percent"]),
                digits(record["loop_noise"], 2),
                digits(record["lag_left_samples"], 3),
                digits(record["lag_left_s"], 3),
                phase if phase == "-" else f"{phase}°",
                str(record["max_abs_row"]),
            ]
        )
    return table(head, rows)


def _segment_table(report: Report, log: LogReport) -> str:
    head = ["part", "rows", "RMSE", "% range", "95 %", "largest", _mean_title(report), "loop", "lag"]
    rows = []
    for part in log.segments:
        figures = part.figures
        numbers = [
            figures.rmse,
            figures.nrmse_percent,
            figures.p95_abs,
            figures.max_abs,
            figures.offset if report.options.remove_offset else figures.mean,
            figures.loop_width,
        ]
        rows.append(
            [
                str(part.number),
                f"{part.first_row}:{part.last_row}",
                *(digits(number, 3) for number in numbers),
                digits(figures.lag_left, 3),
            ]
        )
    what = "cycle" if report.options.segment == "cycles" else f"{report.options.segment:g} s"
    title = f"{short_name(log.name, WIDTH - 24)}, by {what}" if report.options.segment else log.name
    return f"{title}\n{table(head, rows)}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return columns two blanks apart, the first to the left, numbers to the right.

    Where that is too wide: one blank, then shorter names.
    """
    widths = [max(_cells(row[i]) for row in [head, *rows]) for i in range(len(head))]
    gap = 2 if sum(widths) + 2 * (len(widths) - 1) <= WIDTH else 1
    excess = sum(widths) + gap * (len(widths) - 1) - WIDTH
    if excess > 0:
        widths[0] = max(widths[0] - excess, 5)
        rows = [[short_name(row[0], widths[0]), *row[1:]] for row in rows]

    def line(cells: Sequence[str]) -> str:
        first = cells[0] + " " * (widths[0] - _cells(cells[0]))
        others = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return (" " * gap).join([first, *others]).rstrip()

    return "\n".join([line(head), *map(line, rows)])


def short_name(name: str, width: int = NAME_WIDTH) -> str:
    """Return a name cut in its middle where it is too long; its end, the file, tells more than its start."""
    if _cells(name) <= width:
        return name
    tail = (width - 1) * 2 // 3
    head = width - 1 - tail
    start, end = name[:head], name[-tail:]
    while _cells(start) > head:
        start = start[:-1]
    while _cells(end) > tail:
        end = end[1:]
    return f"{start}…{end}"


def _cells(text: str) -> int:
    """Return how many columns of a terminal a text takes: Chinese and Japanese letters take two."""
    wide = sum(unicodedata.east_asian_width(sign) in "WF" for sign in text)
    return len(text) + wide - sum(unicodedata.combining(sign) > 0 for sign in text)


def wrapped(text: str) -> list[str]:
    """Return a text as lines of at most 80 columns, the later ones indented."""
    return textwrap.wrap(
        text, WIDTH, subsequent_indent=" " * 6, break_long_words=False, break_on_hyphens=False
    )
