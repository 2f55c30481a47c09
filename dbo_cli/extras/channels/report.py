"""Reports over channels: a line each, and how their errors are spread, as a line and as figures."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dbo_cli.errors import Listener, Remarks, UsageError
from dbo_cli.extras.channels.signals import (
    columns_of,
    models_by_channel,
    opened_readers,
    patterns_of,
    sum_up_remarks,
)
from dbo_cli.hysteresis.model_file import is_set, read_model, read_set
from dbo_cli.logs.request import Address, Given, ReadingOptions
from dbo_cli.logs.whole_output import all_or_none
from dbo_cli.reports import renderers
from dbo_cli.reports.drawing import Plot, save
from dbo_cli.reports.report import LogReport, Report, common_unit
from dbo_cli.runs.files import short_names
from dbo_cli.runs.jobs import Outcome, Work, spread_line
from dbo_cli.runs.reporting import (
    ReportRun,
    TrackingOptions,
    TrackingReport,
    TrackingRun,
)
from dbo_cli.version import program_version_string


@all_or_none()
def report_channels(run: ReportRun, work: Work, listener: Listener) -> Outcome:
    """Report on each channel of logs, a line each, and say how the channels' errors are spread."""
    logs, options = run.logs, run.options
    if options.trajectory is not None:
        raise UsageError(
            "`trajectory` holds one desired signal: a pattern takes `desired` from the log itself"
        )
    wanted = None if options.model is not None else options.desired or ""
    drive = (options.voltage or "") if options.model is not None else options.voltage
    patterns = patterns_of(
        desired=wanted, measured=options.measured or "", voltage=drive
    )
    chosen, inputs = run.prepared()
    outcome = Outcome()
    merits: list[LogReport] = []
    units: list[tuple[str, str | None]] = []
    texts: dict[str, Remarks] = {}
    short = short_names(logs)
    with opened_readers(logs, run.reading, patterns) as readers:
        channels = list(readers[0].channels)
        models = None
        if options.model is not None:
            models = models_by_channel(options.model, channels)
            _warn_of_coupling(options.model, outcome.remarks)

        def jobs() -> Iterator[tuple[str, Callable[[], tuple[Report, Remarks]]]]:
            for reader, address in zip(readers, logs, strict=True):
                for channel in channels:
                    name = channel
                    if len(logs) > 1:
                        name = f"{short.get(address, address.text)} {channel}"
                    fields: dict[str, Any] = columns_of(patterns, channel)
                    fields |= {"model": models(channel) if models else None}
                    of_channel = dataclasses.replace(options, **fields)
                    yield (
                        name,
                        functools.partial(
                            _reported,
                            reader.log(channel),
                            name,
                            run.reading,
                            of_channel,
                        ),
                    )

        count = len(channels) * len(logs)
        for done in outcome.good(jobs(), work, "channel", count, listener):
            merits_of_channel, texts[done.name] = done.value
            merits += merits_of_channel.logs
            units.append((done.name, merits_of_channel.unit))
    report = Report.of(
        merits, options.scoring(options.model is not None), common_unit(units)
    )
    report = report.judged(**run.limits)
    if merits:
        _write(run, report, chosen, inputs)
    sum_up_remarks(texts, patterns["measured"], outcome.remarks)
    drawn = run.figures is not None or chosen == "html"
    outcome.remarks.notes += _summary(
        merits, patterns if drawn and len(logs) == 1 else None
    )
    return run.judged(report, chosen, outcome)


def _warn_of_coupling(model: Any, remarks: Remarks) -> None:
    """Warn where a set's models are compared by themselves though they are coupled."""
    if is_set(model) and read_set(model).coupling:
        remarks.warn(
            f"the models of {model} are coupled, and each is compared by itself: what the others "
            "show is in the error (simulate takes the coupling into account)"
        )


def _summary(
    merits: Sequence[LogReport], drawn: Mapping[str, str] | None
) -> Iterator[str]:
    """Return how the errors are spread, and how the figures of the worst are made where all were drawn."""
    percents = {
        log.name: x for log in merits if (x := log.figures.nrmse_percent) is not None
    }
    if percents:
        yield spread_line(percents, "channel", "RMSE of the move", {})
    if percents and drawn is not None:
        worst = max(percents, key=percents.__getitem__)
        columns = ", ".join(
            f"`{option}` '{name}'" for option, name in columns_of(drawn, worst).items()
        )
        yield f"the figures are of all channels; for those of one name its columns: {columns}"


def _write(run: ReportRun, report: Report, form: str, inputs: Sequence[Given]) -> None:
    """Write the report; a page and figures show all channels together."""
    plots: list[Plot] = []
    if run.figures is not None or form == "html":
        from dbo_cli.reports.figures import plots_of_channels

        plots = plots_of_channels(report)
    if run.figures is not None:
        save(plots, Path(run.figures), "channels")
    report = run.for_readers(report, form)
    if form == "html":
        none, program = [()] * len(report.logs), program_version_string()
        page = renderers.to_html(
            report, none, comparison_plots=plots, program=program
        ).encode()
    else:
        page = TrackingReport(report, (), None, Remarks()).rendered(form)
    run.write(page, inputs)


def _reported(
    log: Address, name: str, reading: ReadingOptions, options: TrackingOptions
) -> tuple[Report, Remarks]:
    """Compare one channel, in whichever process."""
    model = None if options.model is None else read_model(options.model)
    tracking = TrackingRun(
        options.scoring(model is not None), model, str(options.model)
    )
    tracking.add(log, reading, options, name)
    result = tracking.result()
    return result.report, result.remarks
