"""Reports from logs to files: text, JSON, CSV or a page, and figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.logs.addresses import format_for
from dbo_cli.logs.reading_options import ReadingOptions, Rows
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.whole_output import all_or_none, check_output, make_folder, write_whole
from dbo_cli.reports.drawing import check_folder
from dbo_cli.reports.report import Report, ReportOptions, check_limits
from dbo_cli.runs.comparison import Comparison, comparison_wishes
from dbo_cli.runs.remarks import SILENT, Listener, Remarks
from dbo_cli.runs.roles import short_names

ENDINGS = {".json": "json", ".csv": "csv", ".html": "html", ".htm": "html"}


@dataclass(frozen=True)
class Limits:
    """What a calibration may miss at most; None: anything."""

    max_rmse: float | None = None
    max_abs: float | None = None
    max_nrmse_percent: float | None = None


@dataclass(frozen=True)
class Written:
    """A report that was written."""

    report: Report
    form: str
    remarks: Remarks

    def check(self, limits: Limits) -> None:
        """Raise LimitError for the first log that misses a limit; the others are counted in it."""
        check_limits(self.report, **dataclasses.asdict(limits))


@all_or_none()
def report_logs(
    logs: Sequence[str],
    output: str,
    reading: ReadingOptions,
    *,
    form: str | None = None,
    model_file: str | None = None,
    lag: Any = 0,
    remove_offset: bool = False,
    segment: Any = None,
    figures: str | None = None,
    desired: str | None = None,
    measured: str | None = None,
    voltage: str | None = None,
    listener: Listener = SILENT,
) -> Written:
    """Compare logs and write the report, by default in the form that the output's name tells, else text."""
    chosen = form or ENDINGS.get(Path(output).suffix.lower(), "text")
    labels = ("desired", "measured") if model_file is None else ("model", "measured")
    if form is not None and ENDINGS.get(Path(output).suffix.lower(), form) != form:
        raise UsageError(f"{output}: `format` {form} contradicts this name: leave one of them out")
    check_output(output, logs if model_file is None else [*logs, model_file])
    if figures is not None:
        make_folder(figures)
        check_folder(figures)
    model = None if model_file is None else read_model(model_file)
    options = ReportOptions(lag, remove_offset, segment, labels)
    traced = figures is not None or chosen == "html"
    comparison = Comparison(options, model, str(model_file), traced)
    want = comparison_wishes(desired, measured, voltage, model is not None)
    names = short_names(logs)
    if isinstance(lag, int):
        reading = dataclasses.replace(reading, rows=rows_with_lag(reading.rows, lag))
    for address in logs:
        told = dataclasses.replace(reading, format=format_for(address, reading.format))
        with open_log(address, want, told) as log:
            listener.opened(log.describe())
            comparison.add(log, names.get(address), listener)
    result = comparison.result()
    if figures is not None:
        result.figures(figures)
    try:
        write_whole(output, result.rendered(chosen), protect=logs)
    except BrokenPipeError:  # the reader has seen enough; the figures were asked for all the same
        if figures is None:
            raise
    return Written(result.report, chosen, result.remarks)


def rows_with_lag(rows: Rows, lag: int) -> Rows:
    """Return the rows to read so that every desired row asked for finds its measured one ``lag`` rows on."""
    first, last = rows
    if lag > 0 and last is not None:
        last += lag
    if lag < 0:
        first = max(1, first + lag)
    return first, last
