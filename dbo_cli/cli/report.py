"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from typing import TYPE_CHECKING, Annotated, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import OUTPUT, Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say, say_doubts
from dbo_cli.errors import UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Block
    from dbo_cli.reports import Report

COMPARED, BOUNDS = "Comparison", "Bounds (exit 3)"
Columns = dict[str, str | None]
Units = dict[str, str]


def report(
    logs: opt.LogFiles,
    reading: opt.Reading,
    output: opt.Output = "-",
    form: Annotated[
        Literal["text", "json", "csv", "html"] | None,
        option(None, "Default: by the name of the output.", OUTPUT, "--format"),
    ] = None,
    figures: opt.Figures = None,
    desired: Annotated[Text, column("Desired displacement.")] = None,
    measured: Annotated[Text, column("Measured displacement.")] = None,
    voltage: Annotated[Text, column("The drive, for --model and the figures.")] = None,
    time: opt.Time = None,
    trajectory: Annotated[
        Text, option("FILE", "The desired displacement, if in a file.", COMPARED)
    ] = None,
    match: Annotated[
        Literal["auto", "time", "rows"],
        rare(None, "How rows of log and --trajectory match.", COMPARED),
    ] = "auto",
    model: Annotated[
        Text, option("MODEL", "Compare with the prediction of a model.", COMPARED)
    ] = None,
    state: Annotated[
        str, option("NAME|FILE", "With --model: auto, empty, full, settled.", COMPARED)
    ] = "auto",
    expected: Annotated[
        Text, option("SUMMARY", "Expected error: a --summary, or a model.", COMPARED)
    ] = None,
    lag: Annotated[
        int, rare("N", "Rows by which measured is taken later.", COMPARED)
    ] = 0,
    remove_offset: Annotated[
        bool, flag("--remove-offset", "Subtract the mean error.", COMPARED)
    ] = False,
    max_rmse: Annotated[
        Text, option("VALUE", "Largest RMS error, such as 10nm.", BOUNDS)
    ] = None,
    max_nrmse_percent: Annotated[
        Text, option("PERCENT", "Largest RMS error, in % of the move.", BOUNDS)
    ] = None,
) -> None:
    """Report how well a displacement follows the desired one.

    Several logs are put side by side.

    Examples: dbo report uncompensated.csv compensated.csv -o report.html;
    dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1
    """
    from dbo_cli.logs import parse_rows
    from dbo_cli.model import read_model, state_of
    from dbo_cli.recordings import pair_of
    from dbo_cli.reports import Report, expected_in, predict
    from dbo_cli.reports import match as matched
    from dbo_cli.units import split_quantity

    if model is not None and trajectory is not None:
        raise UsageError("give either `model` or `trajectory`")
    opt.require("model", model, {"state": state != "auto"})
    opt.require("trajectory", trajectory, {"match": match != "auto"})
    largest = None
    if max_rmse is not None:  # a wrong word is refused before any work
        largest, _ = split_quantity(max_rmse, "max_rmse")
    percent_bound = opt.number("max_nrmse_percent", max_nrmse_percent, float)
    for name, bound in (("max_rmse", largest), ("max_nrmse_percent", percent_bound)):
        if bound is not None and bound < 0.0:
            raise UsageError(f"`{name}` {bound:g}: give 0 or more")
    # a lag, a model and a match by rows need the rows around those that count
    rows = None if reading.rows is None else parse_rows(reading.rows)
    reading = dataclasses.replace(reading, rows=None)
    roles: Columns = {"time": time, "measured": measured, "voltage": voltage}
    units: Units = {}
    actuator = None if model is None else read_model(model)
    if actuator is not None:
        actuator.require("forward", model or "")
        units = opt.units_of(voltage=actuator.input, measured=actuator.output)
        start = state_of(state, actuator)
    elif trajectory is not None:
        desired_rows, unit = read_trajectory(trajectory, desired)
        units = {} if unit is None else {"measured": unit}
    else:
        roles["desired"] = desired
    pairs = []
    for log in logs:
        has_model = actuator is not None
        pair, log_units, source = pair_of(log, roles, reading, units, has_model)
        detail(*source.remarks)
        units = {**log_units, **units}
        if actuator is not None:
            pair = predict(pair, actuator, start, model or "")
        elif trajectory is not None:
            pair = matched(
                pair,
                desired_rows["trajectory"],
                desired_rows.time,
                match,
                trajectory,
                desired_rows.values.get("voltage"),
            )
        pairs.append(dataclasses.replace(pair, name=short_name(log, logs), rows=rows))
    unit = units.get("measured")
    result = Report.of(
        pairs,
        unit=unit,
        lag=lag,
        remove_offset=remove_offset,
        expected=None if expected is None else expected_in(expected, unit),
        max_rmse=opt.quantity("max_rmse", max_rmse, unit),
        max_nrmse_percent=percent_bound,
        voltage_unit=units.get("voltage"),
        labels=("desired" if actuator is None else "model", "measured"),
        model=actuator,
        command=shlex.join(["dbo", *sys.argv[1:]]),
    )
    publish(result, output, opt.form_of(form, output), figures)


def publish(result: Report, output: str, form: str, figures: str | None) -> None:
    """Write a report and its figures, say what came out, and refuse a bound that is missed."""
    from dbo_cli.files import check_outputs, write_text

    check_outputs(output)
    if figures is not None:
        detail(*map(str, result.figures(figures)))
    write_text(output, result.render(form))
    if output != "-":
        say(result.line())
    detail(*result.notes)
    for text in result.warnings:
        warn(text)
    result.require_passed()


def read_trajectory(path: str, column: str | None) -> tuple[Block, str | None]:
    """Read the desired displacement of a file of its own, with its drive if it has one; and its unit."""
    from dbo_cli.logs import open_log

    roles: Columns = {"time": None, "trajectory": column, "voltage": None}
    with open_log(path, roles, optional=("time", "voltage")) as log:
        table = log.read()
    say_doubts(log)
    return table, log.columns["trajectory"].unit


def short_name(log: str, logs: list[str]) -> str:
    """Return the name of a file without its folder, where the names of all logs differ then."""
    names = {os.path.basename(path) or path for path in logs}
    return os.path.basename(log) or log if len(names) == len(logs) else log
