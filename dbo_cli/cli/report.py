"""``dbo report``: how well the measured displacement follows the desired one, or a model the measurement."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def report(
    *,
    logs: options.Logs,
    log_reading: ReadingOptions,
    voice: Voice,
    lag: options.Lag,
    remove_offset: options.RemoveOffset,
    segment: options.Segment,
    model: options.ReportModel,
    trajectory: options.ReportTrajectory,
    match: options.Match,
    count_sweep: options.CountSweep,
    max_rmse: options.MaxRmse,
    max_abs: options.MaxAbs,
    max_nrmse_percent: options.MaxNrmse,
    figures: options.Figures,
    form: options.ReportFormat,
    desired: options.Desired,
    measured: options.Measured,
    voltage: options.ReportVoltage,
    output: options.Output,
) -> None:
    """Report how well the measured displacement follows the desired one.

    Several logs are put side by side, each with the ratio of its RMSE to the first log's: uncompensated
    first, compensated after it. With --model the model's prediction takes the place of the desired signal:
    it is run from the first row on, and --rows says which rows count. With --trajectory the desired signal
    comes from a file of its own.
    Where a limit (--max-...) is missed the report is written all the same, and the exit code is 3.

    Example: dbo report uncompensated.csv compensated.csv --figures figures -o report.html
    """
    from dbo_cli.runs.reporting import Limits, report_logs

    written = report_logs(
        logs,
        output,
        log_reading,
        form=form,
        model_file=model,
        lag=lag,
        remove_offset=remove_offset,
        segment=segment,
        figures=figures,
        desired=desired,
        measured=measured,
        voltage=voltage,
        trajectory=trajectory,
        match=match,
        count_sweep=count_sweep,
        listener=Progress(voice, "compared"),
    )
    voice.remarks(written.remarks)
    if written.form != "text":
        voice.notes(written.report.notes)
    written.check(Limits(max_rmse, max_abs, max_nrmse_percent))
