"""The command ``export``: its options, one call, its messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import (
    EXTRAPOLATE,
    FOLDER,
    MAX_SLEW,
    MODEL,
    REPORTING,
    VOLTAGE_MAX,
    VOLTAGE_MIN,
    Option,
)

if TYPE_CHECKING:
    from dbo_cli.extras.export.project_files import ExportSummary

EXPORTING = (
    Option("--name NAME", "Begins the names of files, types, functions.", "actuator"),
    Option(
        "--direction inverse|forward",
        "Displacement to drive, or drive to displacement.",
        "inverse",
    ),
    Option(
        "--arithmetic double|float|q31",
        "double: the bits of dbo compensate; float32 or 32-bit fixed point: with a bound on the error.",
        "double",
    ),
    Option("--sample-rate HZ", "Steps per second of the controller."),
    Option("--gears N", "Fewer gears; says what is lost."),
    VOLTAGE_MIN,
    VOLTAGE_MAX,
    EXTRAPOLATE,
    MAX_SLEW,
    Option("--lookup", "A table of all states: 12 gears at most, double."),
    Option("--arduino", "Lay the files out as an Arduino library."),
    Option("--fmu", "Add an FMI 2.0 co-simulation unit for this computer; double."),
    Option("--shared", "Add a flat C library for this computer; double."),
    Option("--overwrite", "Replace a folder that an export wrote."),
)


def export(arguments: Arguments) -> None:
    """Write a model as C for a controller, with the tables, a self-test and a page to read.

    C99 without allocation, recursion or library calls. double gives the bits of dbo
    compensate; float and q31 (32-bit fixed point) come with a derived bound on their
    error. A set goes to one folder with one kernel, tables of each channel and calls
    that step all, or (-o 'c/{channel}') to a folder each.

    Writes
    ------
    A folder with NAME.h, NAME.c, NAME_test.c, the kernel, build files and README.md; it
    appears whole or not at all.

    Usual options
    -------------
    --sample-rate --arithmetic --direction --v-min --v-max --max-slew --name -o

    Examples
    --------
    For a controller of 10 kHz:
        dbo export model.json -o firmware --sample-rate 10000
    In 32-bit floats, with a bound on the error:
        dbo export model.json -o firmware --arithmetic float --sample-rate 10000
    """
    from dbo_cli.errors import Remarks
    from dbo_cli.extras.export.run import export_models
    from dbo_cli.runs.jobs import summed_up

    remarks = Remarks()
    made = export_models(
        arguments.model, arguments.output, remarks, **arguments.of(EXPORTING)
    )
    remarks.note(
        summed_up(
            {channel: _summary_lines(summary) for channel, summary in made.items()},
            "channel",
        )
    )
    warnings = {channel: list(summary.warnings) for channel, summary in made.items()}
    remarks.warnings += summed_up(warnings, "channel")
    arguments.reporter.remarks(remarks)


def _summary_lines(summary: ExportSummary) -> list[str]:
    """Return the messages about an export."""
    lines = [
        f"{summary.folder}: {summary.direction} model '{summary.name}' in {summary.arithmetic},"
        f" {summary.gears} gears in {summary.table_rows} rows; {summary.table_bytes} bytes of tables,"
        f" {summary.state_bytes} of state; {summary.vectors} samples of self-test"
    ]
    if summary.bounds:
        same, close = (
            summary.bounds[f"{key}_percent"]
            for key in ("same_gears", "after_close_turn")
        )
        lines.append(
            f"error at most {same:.2g} % of the range while both cross the same gears, {close:.2g} % after a "
            f"turn within {100.0 * summary.bounds['close_turn_fraction']:.2g} % of a gear's width from an end"
        )
    return lines + list(summary.notes)


EXPORT = Command(export, (MODEL, *REPORTING, FOLDER, *EXPORTING))
