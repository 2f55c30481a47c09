"""Reports from logs to files: text, JSON, CSV or a page, and figures."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dbo_cli.errors import DboError, OutputError, UsageError
from dbo_cli.hysteresis.model_set import read_model
from dbo_cli.logs.addresses import Address, Given, check_document, selected_files
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions, Rows
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.whole_output import all_or_none, check_output, make_folder, write_whole
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.reports.drawing import check_folder, refuse_picture
from dbo_cli.reports.report import Report, check_limits
from dbo_cli.reports.sample_pairs import rows_to_read
from dbo_cli.runs.roles import short_names
from dbo_cli.runs.tracking import TrackingOptions, TrackingRun, refuse_both, trajectory_wishes

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
    failure: DboError | None = None

    def check(self, limits: Limits) -> None:
        """Raise LimitError for the first log that misses a limit; the others are counted in it.

        A ``failure`` of channels that are not in the report is raised before.
        """
        if self.failure is not None:
            raise self.failure
        check_limits(self.report, **dataclasses.asdict(limits))


@dataclass(frozen=True)
class ReportRun:
    """What is asked of ``report``: logs, the report's file and form, and a folder for ``figures``."""

    logs: Sequence[Address]
    output: Address
    reading: ReadingOptions
    options: TrackingOptions
    form: str | None = None
    figures: str | None = None


@all_or_none()
def report_logs(asked: ReportRun, listener: Listener = SILENT) -> Written:
    """Compare logs and write the report, by default in the form of the output's ending, else text."""
    logs, output, reading, options, figures = (
        asked.logs, asked.output, asked.reading, asked.options, asked.figures
    )  # fmt: skip
    if options.model is not None and options.trajectory is not None:
        refuse_both()
    chosen = report_form(output, asked.form)
    check_document(output, "a report", chosen)
    inputs: list[Given] = [*logs, *(name for name in (options.model, options.trajectory) if name is not None)]
    inputs += selected_files(options.desired, options.measured, options.voltage, reading.time)
    check_output(output, inputs)
    if figures is not None:
        prepare_folder(figures)
    model = None if options.model is None else read_model(options.model)
    traced = figures is not None or chosen == "html"
    tracking = TrackingRun(options.scoring(model is not None), model, str(options.model), traced)
    names = short_names(logs)
    for address in logs:
        add_file(tracking, address, reading, options, names.get(address), listener)
    result = tracking.result()
    if figures is not None:
        result.figures(figures)
    try:
        write_whole(output, result.rendered(chosen), protect=inputs)
    except BrokenPipeError:  # the reader has seen enough; the figures were asked for all the same
        if figures is None:
            raise
    return Written(result.report, chosen, result.remarks)


def report_form(output: Address, form: str | None) -> str:
    """Return the form of a report: as asked for, by the output's ending, else text.

    Raises
    ------
    UsageError
        The ending says another form than the one asked for.
    """
    named = ENDINGS.get(Path(output.text).suffix.lower())
    if form is not None and named not in (None, form):
        raise UsageError(f"{output.text}: `format` {form} contradicts this name: leave one of them out")
    return form or named or "text"


def prepare_folder(folder: str) -> None:
    """Make a folder for outputs where there is none, and refuse one that cannot be written to."""
    refuse_picture(folder)
    with contextlib.suppress(OutputError):  # check_folder has the better message
        make_folder(folder)
    check_folder(folder)


def add_file(
    tracking: TrackingRun,
    address: Address,
    reading: ReadingOptions,
    options: TrackingOptions,
    name: str | None = None,
    listener: Listener = SILENT,
) -> None:
    """Compare one log."""
    with_model, trajectory = tracking.model is not None, options.trajectory
    from_first = with_model or trajectory is not None
    own, score_rows = rows_to_score(reading, options.lag, from_first=from_first)
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(open_log(address, options.wishes(with_model), own))
        listener.opened(log.describe())
        wished = None
        if trajectory is not None:
            wished = stack.enter_context(open_trajectory(trajectory, options.desired, reading))
            listener.opened(wished.describe())
        tracking.add(
            log,
            name,
            listener,
            score_rows=score_rows,
            count_sweep=options.count_sweep or reading.rows != ALL_ROWS,
            trajectory=wished,
            match=options.match,
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


def open_trajectory(address: Address, desired: str | None, reading: ReadingOptions) -> SignalLog:
    """Open the file with the desired signal, on its own clock where it has one."""
    own = dataclasses.replace(reading, rows=ALL_ROWS, time=None, sample_rate=None)
    log = open_log(address, trajectory_wishes(desired), own)
    if log.has_time or reading.sample_rate is None:
        return log
    log.close()
    timed = dataclasses.replace(own, sample_rate=reading.sample_rate)
    return open_log(address, trajectory_wishes(desired), timed)
