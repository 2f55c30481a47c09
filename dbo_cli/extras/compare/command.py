"""The command ``compare``: its options, one call, its messages."""

from __future__ import annotations

from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import (
    DISPLACEMENT,
    FIGURES,
    LOGS,
    OUTPUT,
    READING_OF_LOGS,
    REPORT_FORMAT,
    REPORTING,
    SKIP,
    VALIDATE,
    VOLTAGE,
    Option,
)  # fmt: skip

MODEL_NAMES = Option(
    "--models NAME,...",
    "Only these of dbo, line, pi, rate, singularity-free, asymmetric, same-stages.",
)
NO_TIMINGS = Option("--no-timings", "Measure no times: the table repeats to the byte.")
SAVE_MODELS = Option(
    "--save-models DIR",
    "Also write every model that was fitted, NAME.json, into this folder.",
)


def compare(arguments: Arguments) -> None:
    """Compare the DBO with its relatives: each fitted to the same logs, in one table.

    The relatives are a straight line and the Prandtl-Ishlinskii operators that the
    paper names. All get the same rows, start, drift and search for a delay; one that
    cannot be fitted has a row that says why. The last, same-stages, is the DBO's own
    model with plays for gears: what the operator is worth. Times differ from run to
    run: with --no-timings the same logs give the same bytes.

    Writes
    ------
    A table as text, JSON, CSV or an HTML page, by the name of the output; with
    --figures pictures.

    Usual options
    -------------
    --models --validate --figures --save-models -o

    Examples
    --------
    Fitted to one log, judged on another:
        dbo compare recorded.csv --validate other.csv --figures figures
    Two of them, the same bytes every time:
        dbo compare recorded.csv --models dbo,pi --no-timings -o table.csv
    """
    from dbo_cli.extras.compare.run import TableOptions, compare_logs
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun

    logs = (
        arguments.log,
        arguments.validate or [],
        arguments.reading,
        IdentificationOptions(),
    )
    table = TableOptions(
        arguments.models,
        arguments.skip,
        not arguments.no_timings,
        arguments.format,
        arguments.figures,
        arguments.save_models,
    )
    run = IdentifyRun(*logs, arguments.voltage, arguments.displacement)
    reporter = arguments.reporter
    reporter.remarks(compare_logs(run, arguments.output, table, reporter))


COMPARE = Command(
    compare,
    (
        LOGS, *READING_OF_LOGS, *REPORTING, MODEL_NAMES, VALIDATE, SKIP, NO_TIMINGS, SAVE_MODELS, FIGURES,
        REPORT_FORMAT, VOLTAGE, DISPLACEMENT, OUTPUT,
    ),
)  # fmt: skip
