"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import OUTPUT, Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say
from dbo_cli.errors import UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Reading
    from dbo_cli.model import Cascade, State
    from dbo_cli.recordings import Columns, Units
    from dbo_cli.reports import Pair, Report

COMPARED, BOUNDS = "Comparison", "Bounds (exit 3)"


def report(
    reading: opt.Reading,
    logs: list[str] = opt.LOGS,
    output: str = opt.OUTPUT_FILE,
    form: Literal["text", "json", "csv", "html"] | None = option(
        None, "Default: by the name of the output.", OUTPUT, "--format"
    ),
    figures: Text = opt.FIGURES_DIR,
    desired: Text = column("Desired displacement."),
    measured: Text = column("Measured displacement."),
    voltage: Text = column("The drive, for --model and the figures."),
    time: Text = opt.TIME,
    trajectory: Text = option(
        "FILE", "The desired displacement, if in a file.", COMPARED
    ),
    match: Literal["auto", "time", "rows"] = rare(
        None, "How rows of log and --trajectory match.", COMPARED, default="auto"
    ),
    model: Text = option("MODEL", "Compare with the prediction of a model.", COMPARED),
    state: str = option(
        "NAME|FILE",
        "With --model: auto, empty, full, settled.",
        COMPARED,
        default="auto",
    ),
    expected: Text = option(
        "SUMMARY", "Expected error: a --summary, or a model.", COMPARED
    ),
    lag: int = rare("N", "Rows by which measured is taken later.", COMPARED, default=0),
    remove_offset: bool = flag("--remove-offset", "Subtract the mean error.", COMPARED),
    max_rmse: Text = option("VALUE", "Largest RMS error, such as 10nm.", BOUNDS),
    max_nrmse_percent: Text = option(
        "PERCENT", "Largest RMS error, in % of the move.", BOUNDS
    ),
) -> None:
    """Report how well a displacement follows the desired one.

    Several logs are put side by side.

    Examples: dbo report uncompensated.csv compensated.csv -o report.html;
    dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1
    """
    from dbo_cli import channels
    from dbo_cli.logs import parse_rows
    from dbo_cli.reports import Report, expected_in

    if model is not None and trajectory is not None:
        raise UsageError("give either `model` or `trajectory`")
    opt.require("model", model, {"state": state != "auto"})
    opt.require("trajectory", trajectory, {"match": match != "auto"})
    percent_bound = opt.number_of("max_nrmse_percent", max_nrmse_percent, float)
    require_bounds(max_rmse, percent_bound)
    # a lag, a model and a match by rows need the rows around those that count
    rows = None if reading.rows is None else parse_rows(reading.rows)
    reading = dataclasses.replace(reading, rows=None)
    columns = {"time": time, "measured": measured, "voltage": voltage}
    if model is None and trajectory is None:
        columns["desired"] = desired
    names = channels.names([logs[0]], reading, columns)
    models = {} if model is None else channels.models_of(model, names)
    starts = channels.states_of(state, models)
    summaries = channels.summaries_of(expected, names)
    results = {}
    for channel in names:
        roles = channels.columns_for(columns, channel)
        actuator = models.get(channel)
        with channels.naming(channel):
            if trajectory is not None:
                column = channels.columns_for({"desired": desired}, channel)["desired"]
                pairs, units = matched(logs, reading, roles, trajectory, column, match)
            elif actuator is not None:
                name = f"{model}::{channel}" if channel else model or ""
                start = starts[channel]
                pairs, units = predictions(logs, reading, roles, actuator, name, start)
            else:
                pairs, units = read_pairs(logs, reading, roles, {}, False)
            unit, summary = units.get("measured"), summaries[channel]
            results[channel] = Report.of(
                [
                    dataclasses.replace(pair, rows=rows, name=name)
                    for pair, name in zip(pairs, short_names(logs), strict=True)
                ],
                unit=unit,
                lag=lag,
                remove_offset=remove_offset,
                expected=None if summary is None else expected_in(summary, unit),
                max_rmse=opt.quantity("max_rmse", max_rmse, unit),
                max_nrmse_percent=percent_bound,
                voltage_unit=units.get("voltage"),
                labels=("desired" if actuator is None else "model", "measured"),
                model=actuator,
                command=shlex.join(["dbo", *sys.argv[1:]]),
            )
    publish(results, output, opt.form_of(form, output), figures)


def require_bounds(max_rmse: str | None, percent: float | None) -> None:
    """Refuse (UsageError) a bound that is no magnitude, before any work."""
    from dbo_cli.units import split_quantity

    largest = None if max_rmse is None else split_quantity(max_rmse, "max_rmse")[0]
    for name, bound in (("max_rmse", largest), ("max_nrmse_percent", percent)):
        if bound is not None and bound < 0.0:
            raise UsageError(f"`{name}` {bound:g}: give 0 or more")


def read_pairs(
    logs: Sequence[str],
    reading: Reading,
    roles: Columns,
    required_units: Units,
    needs_drive: bool,
) -> tuple[list[Pair], Units]:
    """Return what was measured in each log, in these units or else those of the first, and the units."""
    from dbo_cli.recordings import pair_of

    pairs, units = [], dict(required_units)
    for path in logs:
        pair, log_units, log = pair_of(path, roles, reading, units, needs_drive)
        detail(*log.remarks)
        for role, unit in log_units.items():
            units[role] = units.get(role) or unit
        pairs.append(pair)
    return pairs, units


def predictions(
    logs: Sequence[str],
    reading: Reading,
    roles: Columns,
    model: Cascade,
    name: str,
    state: State | str,
) -> tuple[list[Pair], Units]:
    """Return what a model predicts beside what was measured, and the units."""
    from dbo_cli.reports import predict

    model.require("forward", name)
    model_units = {"voltage": model.input.unit, "measured": model.output.unit}
    pairs, units = read_pairs(logs, reading, roles, model_units, True)
    return [predict(pair, model, state, name) for pair in pairs], units


def matched(
    logs: Sequence[str],
    reading: Reading,
    roles: Columns,
    trajectory: str,
    column: str | None,
    by: str,
) -> tuple[list[Pair], Units]:
    """Return what a trajectory of a file of its own desires beside what was measured, and the units."""
    from dbo_cli.logs import Reading, columns_of
    from dbo_cli.recordings import read_table
    from dbo_cli.reports import match

    named_drive = None
    if (
        column is not None and "desired" in column
    ):  # of a channel, as compensate names it
        typed = column.replace("desired", "voltage", 1)
        names = [each.quantity for each in columns_of(trajectory)]
        named_drive = next((name for name in names if typed.startswith(name)), None)
    columns = {"time": None, "trajectory": column, "voltage": named_drive}
    optional = ("time", "voltage")
    log, table = read_table(trajectory, columns, Reading(), optional=optional)
    trajectory_units = {"measured": log.columns["trajectory"].unit}
    pairs, units = read_pairs(logs, reading, roles, trajectory_units, False)
    desired, clock, drive = table["trajectory"], table.time, table.values.get("voltage")
    return [match(p, desired, clock, by, trajectory, drive) for p in pairs], units


def publish(
    results: dict[str, Report], output: str, form: str, figures: str | None
) -> None:
    """Write reports and figures, say what came out, and refuse a bound that is missed.

    Of channels, text and JSON stand in one file, other forms in a file a channel.
    """
    from dbo_cli import channels
    from dbo_cli.files import check_outputs, write_text

    check_outputs(output)
    for name, result in results.items():
        if figures is not None:
            detail(*map(str, result.figures(os.path.join(figures, name))))
    texts = {name: result.render(form) for name, result in results.items()}
    if form == "json":
        write_text(output, channels.dumps_files("report", texts))
    elif form == "text":
        pages = [f"channel {name}\n" * bool(name) + texts[name] for name in texts]
        write_text(output, "\n".join(pages))
    else:
        for name, path in channels.paths_of(output, texts).items():
            write_text(path, texts[name])
    for name, result in results.items():
        if output != "-":
            say(f"{name}: {result.line()}" if name else result.line())
        detail(*result.notes)
        for text in result.warnings:
            warn(f"channel {name}: {text}" if name else text)
    for result in results.values():
        result.require_passed()


def short_names(logs: list[str]) -> list[str]:
    """Return the names of files without their folders, where they all differ then."""
    names = [os.path.basename(path) or path for path in logs]
    return names if len(set(names)) == len(logs) else logs
