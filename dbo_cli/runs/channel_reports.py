"""Reports over channels: a line a channel, and how their errors are spread, as a line and as figures."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model_set import is_set, read_model, read_set
from dbo_cli.logs.addresses import Address, Given, check_document
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.whole_output import all_or_none, check_outputs, write_whole
from dbo_cli.remarks import Listener, Remarks
from dbo_cli.reports.drawing import Plot, save
from dbo_cli.reports.report import LogReport, Report, common_unit
from dbo_cli.runs.channels import Columns, models_by_channel, opened_readers, sum_up_remarks
from dbo_cli.runs.jobs import Outcome, Work, good_ones, run_jobs, spread_line
from dbo_cli.runs.reporting import (
    ReportRun,
    TrackingOptions,
    TrackingReport,
    TrackingRun,
    Written,
    add_log,
    prepare_folder,
    report_form,
)
from dbo_cli.runs.roles import short_names
from dbo_cli.version import program_version_string


@all_or_none()
def report_channels(asked: ReportRun, work: Work, listener: Listener) -> Written:
    """Report on each channel of logs, a line each, and say how the channels' errors are spread."""
    logs, output, options, figures = asked.logs, asked.output, asked.options, asked.figures
    chosen = report_form(output, asked.form)
    check_document(output, "a report", chosen)
    if options.trajectory is not None:
        raise UsageError(
            "`trajectory` holds one desired signal: a pattern takes `desired` from the log itself"
        )
    wanted = None if options.model is not None else options.desired or ""
    drive = (options.voltage or "") if options.model is not None else options.voltage
    columns = Columns.of(desired=wanted, measured=options.measured or "", voltage=drive)
    inputs: list[Given] = [*logs, *([] if options.model is None else [options.model])]
    check_outputs([output], inputs)
    if figures is not None:
        prepare_folder(figures)
    outcome = Outcome()
    merits: list[LogReport] = []
    units: list[tuple[str, str | None]] = []
    texts: dict[str, Remarks] = {}
    short = short_names(logs)
    with opened_readers(logs, asked.reading, columns) as readers:
        channels = list(readers[0].channels)
        models = None if options.model is None else models_by_channel(options.model, channels)
        if options.model is not None and is_set(options.model) and read_set(options.model).coupling:
            outcome.remarks.warn(
                f"the models of {options.model} are coupled, and each is compared by itself: what the others "
                "show is in the error (simulate takes the coupling into account)"
            )

        def jobs() -> Iterator[tuple[str, Callable[[], tuple[Report, Remarks]]]]:
            for reader, address in zip(readers, logs, strict=True):
                for channel in channels:
                    name = channel if len(logs) == 1 else f"{short.get(address, address.text)} {channel}"
                    own: dict[str, Any] = columns.of_channel(channel)
                    own |= {"model": models(channel) if models else None}
                    one = dataclasses.replace(options, **own)
                    yield name, functools.partial(_reported, reader.log(channel), name, asked.reading, one)

        count = len(channels) * len(logs)
        for one in good_ones(run_jobs(jobs(), work.processes), work, "channel", outcome, count, listener):
            assert one.value is not None
            found, texts[one.name] = one.value
            merits += found.logs
            units.append((one.name, found.unit))
    report = Report.of(merits, options.scoring(options.model is not None), common_unit(units))
    if merits:
        _write(report, output, chosen, figures, inputs)
    sum_up_remarks(texts, columns.patterns["measured"], outcome.remarks)
    drawn = figures is not None or chosen == "html"
    outcome.remarks.notes += _summary(merits, columns if drawn and len(logs) == 1 else None)
    return Written(report, chosen, outcome.remarks, outcome.failure)


def _summary(merits: Sequence[LogReport], drawn: Columns | None) -> Iterator[str]:
    """Return how the errors are spread, and how the figures of the worst are made where all were drawn."""
    percents = {log.name: x for log in merits if (x := log.figures.nrmse_percent) is not None}
    if percents:
        yield spread_line(percents, "channel", "RMSE of range", {})
    if percents and drawn is not None:
        worst = max(percents, key=percents.__getitem__)
        own = ", ".join(f"`{option}` '{name}'" for option, name in drawn.of_channel(worst).items())
        yield f"the figures are of all channels; for those of one name its columns: {own}"


def _write(report: Report, output: Address, form: str, figures: str | None, inputs: Sequence[Given]) -> None:
    """Write the report; a page and figures show all channels together."""
    plots: list[Plot] = []
    if figures is not None or form == "html":
        from dbo_cli.reports.figures import plots_of_channels

        plots = plots_of_channels(report)
    if figures is not None:
        save(plots, Path(figures), "channels")
    if form == "html":
        from dbo_cli.reports.page import to_html

        none = [()] * len(report.logs)
        page = to_html(report, none, comparison_plots=plots, program=program_version_string()).encode()
    else:
        page = TrackingReport(report, (), None, Remarks()).rendered(form)
    try:
        write_whole(output, page, protect=inputs)
    except BrokenPipeError:  # the reader has seen enough; the figures were asked for all the same
        if figures is None:
            raise


def _reported(
    log: Address, name: str, reading: ReadingOptions, options: TrackingOptions
) -> tuple[Report, Remarks]:
    """Compare one channel, in whichever process."""
    model = None if options.model is None else read_model(options.model)
    tracking = TrackingRun(options.scoring(model is not None), model, str(options.model))
    add_log(tracking, log, reading, options, name)
    result = tracking.result()
    return result.report, result.remarks
