"""Reports from logs to files: text, JSON, CSV or a page, and figures."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dbo_cli.errors import OutputError, UsageError
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.logs.addresses import check_document, format_for, selected_files
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions, Rows
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.whole_output import all_or_none, check_output, make_folder, write_whole
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.reports.drawing import check_folder, refuse_picture
from dbo_cli.reports.report import Report, ReportOptions, check_limits
from dbo_cli.reports.sample_pairs import rows_to_read
from dbo_cli.runs.comparison import (
    Comparison,
    Match,
    comparison_wishes,
    refuse_both,
    trajectory_wishes,
)
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
    trajectory: str | None = None,
    match: Match = "auto",
    count_sweep: bool = False,
    listener: Listener = SILENT,
) -> Written:
    """Compare logs and write the report, by default in the form that the output's name tells, else text.

    With ``trajectory`` the desired signal lies in that file, for every log.
    """
    if model_file is not None and trajectory is not None:
        refuse_both()
    chosen = form or ENDINGS.get(Path(output).suffix.lower(), "text")
    labels = ("desired", "measured") if model_file is None else ("model", "measured")
    if form is not None and ENDINGS.get(Path(output).suffix.lower(), form) != form:
        raise UsageError(f"{output}: `format` {form} contradicts this name: leave one of them out")
    check_document(output, "a report", chosen)
    inputs = [*logs, *(name for name in (model_file, trajectory) if name is not None)]
    inputs += selected_files(desired, measured, voltage, reading.time)
    check_output(output, inputs)
    if figures is not None:
        refuse_picture(figures)
        with contextlib.suppress(OutputError):  # check_folder words it
            make_folder(figures)
        check_folder(figures)
    model = None if model_file is None else read_model(model_file)
    options = ReportOptions(lag, remove_offset, segment, labels)
    traced = figures is not None or chosen == "html"
    comparison = Comparison(options, model, str(model_file), traced)
    names = short_names(logs)
    for address in logs:
        add_file(
            comparison,
            address,
            reading,
            (desired, measured, voltage),
            trajectory=trajectory,
            match=match,
            count_sweep=count_sweep,
            name=names.get(address),
            listener=listener,
        )
    result = comparison.result()
    if figures is not None:
        result.figures(figures)
    try:
        write_whole(output, result.rendered(chosen), protect=inputs)
    except BrokenPipeError:  # the reader has seen enough; the figures were asked for all the same
        if figures is None:
            raise
    return Written(result.report, chosen, result.remarks)


def add_file(
    comparison: Comparison,
    address: str,
    reading: ReadingOptions,
    selectors: tuple[str | None, str | None, str | None],
    *,
    trajectory: str | None = None,
    match: Match = "auto",
    count_sweep: bool = False,
    name: str | None = None,
    listener: Listener = SILENT,
) -> None:
    """Compare one log; ``selectors`` are the columns desired, measured and voltage, None where guessed."""
    from_first = comparison.model is not None or trajectory is not None
    want = comparison_wishes(*selectors, comparison.model is not None, trajectory is not None)
    asked = reading.rows != ALL_ROWS
    told = dataclasses.replace(reading, format=format_for(address, reading.format))
    told, score_rows = rows_to_score(told, comparison.options.lag, from_first=from_first)
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(open_log(address, want, told))
        listener.opened(log.describe())
        wished = None
        if trajectory is not None:
            wished = stack.enter_context(open_trajectory(trajectory, selectors[0], reading))
            listener.opened(wished.describe())
        comparison.add(
            log,
            name,
            listener,
            score_rows=score_rows,
            count_sweep=count_sweep or asked,
            trajectory=wished,
            match=match,
        )


def rows_to_score(
    reading: ReadingOptions, lag: int | Literal["auto"], *, from_first: bool
) -> tuple[ReadingOptions, Rows | None]:
    """Return how to read a log for the desired rows asked for, and which rows count of those that come.

    Parameters
    ----------
    reading
        As asked for; its rows are desired rows.
    lag
        Each desired row's measured one is that much further on.
    from_first
        What the log is compared with depends on all that came before (a model's prediction) or is found by
        going along (a trajectory elsewhere): read from the first row on, and let some of them count.

    Raises
    ------
    UsageError
        Rows of a resampled log are to count: there, rows are numbered anew.
    """
    samples = 0 if lag == "auto" else lag
    if not from_first:
        return dataclasses.replace(reading, rows=rows_to_read(reading.rows, samples)), None
    if reading.rows == ALL_ROWS:
        return reading, None
    if reading.resample is not None:
        raise UsageError(
            "`rows` are those that were recorded, and after `resample` there are others (give one of them)"
        )
    return dataclasses.replace(reading, rows=(1, rows_to_read(reading.rows, samples)[1])), reading.rows


def open_trajectory(address: str, desired: str | None, reading: ReadingOptions) -> SignalLog:
    """Open the file with the desired signal, on its own clock where it has one."""
    own = dataclasses.replace(
        reading, rows=ALL_ROWS, time=None, sample_rate=None, format=format_for(address, reading.format)
    )
    log = open_log(address, trajectory_wishes(desired), own)
    if log.has_time or reading.sample_rate is None:
        return log
    log.close()
    timed = dataclasses.replace(own, sample_rate=reading.sample_rate)
    return open_log(address, trajectory_wishes(desired), timed)
