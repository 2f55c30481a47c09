"""``dbo compare``: the DBO and its relatives, fitted to the same logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def compare(
    *,
    logs: options.Logs,
    log_reading: ReadingOptions,
    voice: Voice,
    models: options.ModelNames,
    validate: options.Validate,
    skip: options.Skip,
    no_timings: options.NoTimings,
    save_models: options.SaveModels,
    figures: options.Figures,
    form: options.ReportFormat,
    voltage: options.Voltage,
    displacement: options.Displacement,
    output: options.Output,
) -> None:
    """Compare the DBO with its relatives: each fitted to the same logs, in one table.

    The relatives are a straight line and the Prandtl-Ishlinskii operators that the paper names. All get the
    same rows, start, drift and search for a delay; one that cannot be fitted has a row that says why. Times
    differ from run to run: with --no-timings the same logs give the same bytes.

    Example: dbo compare recorded.csv --validate other.csv --figures figures
    """
    from dbo_cli.runs.comparing import ComparisonOptions, compare_logs

    asked = ComparisonOptions(models, skip, not no_timings, form, figures, save_models)
    voice.remarks(
        compare_logs(
            logs,
            validate or [],
            output,
            log_reading,
            asked,
            voltage=voltage,
            displacement=displacement,
            listener=Progress(voice, "read"),
        )
    )
