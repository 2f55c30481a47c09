"""``dbo report``: how well the measured displacement follows the desired one, or a model the measurement."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dbo_cli.cli import options, signals, values
from dbo_cli.cli.bundles import Reading, bundled
from dbo_cli.cli.comparison import PairReader
from dbo_cli.cli.messages import Voice

if TYPE_CHECKING:
    from dbo_cli.hysteresis.model import ActuatorModel
    from dbo_cli.reports.report import Report

FORMS = ("text", "json", "csv", "html")
ENDINGS = {".json": "json", ".csv": "csv", ".html": "html", ".htm": "html"}


@bundled
def report(
    logs: options.Logs,
    log_reading: Reading,
    voice: Voice,
    lag: options.Lag = "0",
    remove_offset: options.RemoveOffset = False,
    segment: options.Segment = None,
    model: options.ReportModel = None,
    max_rmse: options.MaxRmse = None,
    max_abs: options.MaxAbs = None,
    max_nrmse_percent: options.MaxNrmse = None,
    figures: options.Figures = None,
    form: options.ReportFormat = None,
    desired: options.Desired = None,
    measured: options.Measured = None,
    voltage: options.ReportVoltage = None,
    output: options.Output = "-",
) -> None:
    """Report how well the measured displacement follows the desired one.

    Several logs are put side by side, each with the ratio of its RMSE to the first log's: uncompensated
    first, compensated after it. With --model the model's prediction takes the place of the desired signal.
    Where a limit (--max-...) is missed the report is written all the same, and the exit code is 3.
    """
    chosen = form_of(form, output)
    limits = {
        "max_rmse": values.optional(values.not_negative, "--max-rmse", max_rmse),
        "max_abs": values.optional(values.not_negative, "--max-abs", max_abs),
        "max_nrmse_percent": values.optional(values.not_negative, "--max-nrmse-percent", max_nrmse_percent),
    }
    from dbo_cli.logs.whole_output import check_output, write_whole
    from dbo_cli.reports import report as reports
    from dbo_cli.reports.drawing import check_folder

    labels = ("desired", "measured") if model is None else ("model", "measured")
    compared = reports.ReportOptions(
        reports.parse_lag(lag), remove_offset, reports.parse_segment(segment), labels
    )
    check_output(output, logs if model is None else [*logs, model])
    folder = None if figures is None else check_folder(figures)
    operator = None if model is None else _forward(model)
    traced = folder is not None or chosen == "html"
    reader = PairReader(
        compared,
        log_reading,
        voice,
        operator,
        str(model),
        traced,
        desired,
        measured,
        voltage,
        signals.short_names(logs),
    )
    merits = [reader.evaluate(address) for address in logs]
    result = reports.Report.of(merits, compared, reports.common_unit(reader.units))
    write_whole(output, _rendered(chosen, result, reader), protect=logs)
    if chosen != "text":
        voice.notes(result.notes)
    if folder is not None:
        _draw(folder, result, reader)
    reports.check_limits(result, **limits)


def form_of(named: str | None, output: str) -> str:
    """Return the form of a report: as named, else by the output's name, else text."""
    if named is not None:
        return values.choice("--format", named, FORMS)
    return ENDINGS.get(Path(output).suffix.lower(), "text")


def _forward(address: str) -> ActuatorModel:
    from dbo_cli.hysteresis.model_file import read_model

    model = read_model(address)
    model.require("forward", address)
    return model


def _rendered(form: str, result: Report, reader: PairReader) -> bytes:
    from dbo_cli.reports import renderers

    if form == "html":
        return _page(result, reader).encode()
    texts = {"text": renderers.to_text, "json": renderers.to_json, "csv": renderers.to_csv}
    return texts[form](result).encode()


def _page(result: Report, reader: PairReader) -> str:
    from dbo_cli.logs.provenance import program_version_string
    from dbo_cli.reports.figures import plots_of_log
    from dbo_cli.reports.model_figures import plots_of_model
    from dbo_cli.reports.page import to_html

    pairs = zip(result.logs, reader.traces, strict=True)
    return to_html(
        result,
        [plots_of_log(result, log, traces) for log, traces in pairs],
        model_plots=() if reader.model is None else plots_of_model(reader.model),
        program=program_version_string(),
    )


def _draw(folder: Path, result: Report, reader: PairReader) -> None:
    from dbo_cli.reports.drawing import file_stems, save
    from dbo_cli.reports.figures import plots_of_log
    from dbo_cli.reports.model_figures import plots_of_model

    stems = file_stems([log.name for log in result.logs])
    for stem, log, traces in zip(stems, result.logs, reader.traces, strict=True):
        save(plots_of_log(result, log, traces), folder, stem, log.name)
    if reader.model is not None:
        save(plots_of_model(reader.model), folder, "model")
