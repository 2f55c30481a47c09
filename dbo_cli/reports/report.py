"""The report of one or several logs: its values, as text, JSON, CSV, page, table and figures.

All forms show the figures of ``merits``: the same values, the same bytes every time.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import UsageError, require_none
from dbo_cli.files import write_all
from dbo_cli.reports import page, plots
from dbo_cli.reports.expected import UNKNOWN, Expected
from dbo_cli.reports.merits import excess, merits
from dbo_cli.reports.pair import Pair, scored, undelayed
from dbo_cli.reports.words import digits, json_text, text_table
from dbo_cli.version import __version__

if TYPE_CHECKING:
    import pandas

    from dbo_cli.model import Cascade

REPORT_VERSION = 1  # of the form dbo-report


def kept(bound: float, figure: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether a log keeps a limit of a figure; an undefined one keeps none."""
    value = figures[figure]
    is_kept = value is not None and value <= bound
    values = {"name": figures["name"], "figure": figure, "limit": bound, "value": value}
    return {**values, "passed": is_kept}


class Report:
    """What was compared, and the figures of every log in the order they were given.

    Parameters
    ----------
    pairs
        One or more, one a log; as attribute the rows that were compared.
    unit, voltage_unit
        Of all lengths, and of the drive in the figures; None: not known.
    lag
        Rows by which measured is taken later than desired.
    remove_offset
        Take the mean of each error off first (a sensor's arbitrary zero).
    expected
        The error that was to be expected, of pairs that have none of their own.
    max_rmse, max_nrmse_percent
        Limits for each log, in the unit and in percent of the move.
    model
        The model whose prediction was compared, if one was.
    command
        The command line, for the footer of the page.

    Attributes
    ----------
    logs
        The figures of each log, as ``merits`` returns them; ``ratio_to_first`` is the
        RMSE over that of the first log, None where that is 0.
    limits
        What comes of the limits that were set, for each log: ``name``, ``figure``
        (``rmse`` or ``nrmse_percent``), ``limit``, ``value`` (None: undefined, which
        keeps no limit) and ``passed``.

    Raises
    ------
    InputError
        There is nothing to compare.
    UsageError
        A limit is below 0, or ``lag`` is no whole number.
    """

    def __init__(
        self,
        pairs: Sequence[Pair],
        *,
        unit: str | None = None,
        voltage_unit: str | None = None,
        lag: int = 0,
        remove_offset: bool = False,
        expected: Expected = UNKNOWN,
        max_rmse: float | None = None,
        max_nrmse_percent: float | None = None,
        model: Cascade | None = None,
        command: str | None = None,
    ) -> None:
        self.unit, self.voltage_unit = unit or None, voltage_unit
        self.remove_offset, self.model, self.command = remove_offset, model, command
        self.first = "desired" if model is None else "model"  # measured beside it
        self.pairs: list[Pair] = []
        self.logs: list[dict[str, Any]] = []
        self.limits: list[dict[str, Any]] = []
        if not isinstance(lag, Integral):
            raise UsageError(f"`lag` {lag}: give a whole number of rows")
        bounds = {"rmse": max_rmse, "nrmse_percent": max_nrmse_percent}
        for figure, bound in bounds.items():
            if bound is not None and bound < 0.0:
                raise UsageError(f"`max_{figure}` {bound:g}: give 0 or more")
        for pair in pairs:
            if pair.expected is UNKNOWN:
                pair = replace(pair, expected=expected)
            pair = scored(pair if lag else undelayed(pair), lag)
            figures = merits(pair, lag, remove_offset)
            warning = excess(pair, figures)
            self.pairs.append(pair.warned(warning) if warning else pair)
            self.logs.append(figures)
            if self.rmse > 0.0:
                figures["ratio_to_first"] = figures["rmse"] / self.rmse
            for figure, bound in bounds.items():
                if bound is not None:
                    self.limits.append(kept(bound, figure, figures))

    @property
    def rmse(self) -> float:
        """The RMSE of the first log."""
        return float(self.logs[0]["rmse"])

    @property
    def passed(self) -> bool | None:
        """Whether all limits are kept; None where none was set."""
        if not self.limits:
            return None
        return all(limit["passed"] for limit in self.limits)

    @property
    def notes(self) -> list[str]:
        """What a reader of the figures must know, all logs together."""
        return [note for pair in self.pairs for note in pair.notes]

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the logs, all of them together."""
        return [text for pair in self.pairs for text in pair.warnings]

    def require_passed(self) -> None:
        """Raise LimitError where a limit is missed."""
        missed = [limit for limit in self.limits if not limit["passed"]]
        require_none([self._verdict(limit) for limit in missed])

    def line(self) -> str:
        """Return the least error and, of several logs, what it is beside the first."""
        first = self.logs[0]
        best = min(self.logs, key=lambda log: float(log["rmse"]))
        error = f"error {digits(best['rmse'], 3)} {self.unit or ''}".rstrip()
        line = f"{best['name']}: {error} RMS"
        if best is not first and best["rmse"] > 0.0:
            times = digits(first["rmse"] / best["rmse"], 2)
            return f"{line}, {times} times less than {first['name']}"
        if best["nrmse_percent"] is not None:
            line += f" ({digits(best['nrmse_percent'], 2)} % of the move)"
        if best["expected_rmse"] is not None:
            line += f", {digits(best['expected_rmse'], 2)} expected"
        return line

    def _verdict(self, limit: Mapping[str, Any]) -> str:
        """Return in a sentence whether a log keeps a limit."""
        name, value, bound = limit["name"], limit["value"], limit["limit"]
        rmse = "(the move has no range)" if value is None else f"{value:.4g}"
        unit = " % of the move"
        if limit["figure"] == "rmse":
            unit = f" {self.unit}" if self.unit else ""
        relation = "is within" if limit["passed"] else "exceeds"
        return f"{name}: RMSE {rmse}{unit} {relation} the limit, {bound:g}{unit}"

    # --- forms ---

    def to_json(self) -> str:
        """Return the report as JSON text, ``dbo-report`` version 1; numbers read back exactly.

        The keys are always all there, in this order: ``format``, ``version``, ``unit``,
        ``compared`` (the error is the second less the first), ``offset_removed``,
        ``logs`` (see ``merits``), ``notes``, ``limits``, ``passed`` (null where no limit
        was set) and ``warnings``. Keys may be added within a version; none changes its
        meaning.
        """
        content = {
            "format": "dbo-report",
            "version": REPORT_VERSION,
            "unit": self.unit,
            "compared": [self.first, "measured"],
            "offset_removed": self.remove_offset,
            "logs": self.logs,
            "notes": self.notes,
            "limits": self.limits,
            "passed": self.passed,
            "warnings": self.warnings,
        }
        return json_text(content)

    def to_csv(self) -> str:
        """Return a line a log: the keys of the JSON form and the unit; what is undefined is empty."""
        rows = [{**log, "unit": self.unit} for log in self.logs]
        out = io.StringIO()
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return out.getvalue()

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the name as index."""
        import pandas as pd

        return pd.DataFrame(self.logs).set_index("name")

    def to_text(self) -> str:
        """Return the verdict, an aligned table and at most a few lines."""
        lines = [self._verdict(limit) for limit in self.limits]
        if lines:
            lines = ["PASSED" if self.passed else "FAILED", *lines, ""]
        lines += [text_table(*self._table()), "", self._settings()]
        lines += [f"warning: {warning}" for warning in self.warnings]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join(lines) + "\n"

    def to_html(self) -> str:
        """Return a page that needs no other file: verdict, table, figures, footer."""
        parts = []
        if self.passed is not None:
            word = "passed" if self.passed else "failed"
            lines = [f"<strong>{word.capitalize()}</strong>"]
            lines += [escape(self._verdict(limit)) for limit in self.limits]
            parts.append(f'<p class="verdict {word}">{"<br>".join(lines)}</p>')
        parts.append(page.paragraph("headline", self.line()))
        parts += [page.paragraph("warning", f"Warning: {w}") for w in self.warnings]
        parts.append(page.table(*self._table()))
        parts += [page.paragraph("muted", n) for n in (self._settings(), *self.notes)]
        for title, drawn in self._sections():
            parts.append(f"<h2>{escape(title)}</h2>{page.figures(drawn)}")
        made_by = [f"dbo {__version__}", self.command or ""]
        parts.append(
            f"<footer>{'<br>'.join(map(escape, filter(None, made_by)))}</footer>"
        )
        return page.framed(parts)

    def figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw the figures into a folder, PNG and SVG; return the files."""
        return write_all(folder, self.drawn())

    def drawn(self) -> dict[str, bytes]:
        """Draw the figures, PNG and SVG; return the files by name."""
        sections = [section for _, section in self._sections()]
        return plots.drawn([plot for section in sections for plot in section])

    def _table(self) -> tuple[list[str], list[list[str]]]:
        """Return the headings of the table and a row a log; what is not known of any is left out."""
        clocked = any(log["sample_period_s"] for log in self.logs)
        expected = any(log["expected_rmse"] for log in self.logs)
        rows = []
        for log in self.logs:
            cells = {
                "log": log["name"],
                "rows": f"{log['samples']:,}",
                "RMSE": digits(log["rmse"]),
            }
            if expected:
                cells["expected"] = digits(log["expected_rmse"])
            cells["% of move"] = digits(log["nrmse_percent"], 3)
            cells["largest"] = digits(log["max_abs"])
            cells["at row"] = f"{log['max_abs_row']:,}"
            if self.remove_offset:
                cells["offset"] = digits(log["offset_removed"])
            else:
                cells["mean"] = digits(log["mean"])
            cells["loop"] = digits(log["loop_width"], 3)
            if clocked:
                seconds = log["lag_left_s"]
                lag_ms = None if seconds is None else 1000.0 * seconds
                cells["lag (ms)"] = digits(lag_ms, 3)
            else:
                cells["lag (rows)"] = digits(log["lag_left_samples"], 3)
            if len(self.logs) > 1:
                cells["ratio"] = digits(log["ratio_to_first"], 3)
            rows.append(cells)
        return list(rows[0]), [list(cells.values()) for cells in rows]

    def _settings(self) -> str:
        """Return what was compared, and what the figures mean."""
        line = f"error = measured - {self.first}"
        if self.unit:
            line += f" in {self.unit}"
        if self.remove_offset:
            line += ", mean removed"
            if any(log["expected_rmse"] for log in self.logs):
                line += ", which the expected error counts"
        lag = self.logs[0]["lag_samples"]
        if lag:
            line += f", measured taken {lag} rows later"
        return f"{line}; move: range of {self.first}; loop: error falling less error rising"

    def _sections(self) -> list[tuple[str, list[plots.Plot]]]:
        """Return the figures with their headings: each log's, then the model's."""
        sections = []
        stems = plots.file_stems([pair.name for pair in self.pairs])
        for pair, log, stem in zip(self.pairs, self.logs, stems, strict=True):
            units = self.unit, self.voltage_unit
            drawn = plots.plots_of_log(pair, log, self.first, units, stem)
            sections.append((pair.name, drawn))
        if self.model is not None:
            sections.append(("The model", plots.model_plots(self.model)))
        return sections
