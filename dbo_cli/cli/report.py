"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import OUTPUT, Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say, say_doubts
from dbo_cli.errors import UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Block
    from dbo_cli.model import Cascade, State
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
    from dbo_cli import channels
    from dbo_cli.logs import parse_rows
    from dbo_cli.model import read_model, state_of
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
    if model is None:
        roles["desired"] = desired
    asked = Asked(logs, reading, rows, trajectory, match, lag, remove_offset, max_rmse,
                  percent_bound)  # fmt: skip
    kind = opt.form_of(form, output)
    if not channels.is_pattern(roles):
        actuator = None if model is None else read_model(model)
        start = "auto" if actuator is None else state_of(state, actuator)
        result = reported(asked, roles, actuator, model or "", start, expected)
        publish(result, output, kind, figures)
        return
    known = channels.names([logs[0]], reading, in_logs(roles, trajectory))
    actuators = {} if model is None else channels.models_of(model, known)
    starts = channels.states_of(state, actuators)
    summaries = dict.fromkeys(known, expected)
    if expected is not None and channels.is_file_set(expected):
        summaries = channels.read_files(expected, "summary", known)
    results = {}
    for name in known:
        chosen = channels.columns_for(roles, name)
        own, begin = actuators.get(name), starts.get(name, "auto")
        with channels.naming(name):
            results[name] = reported(
                asked, chosen, own, f"{model}::{name}", begin, summaries[name]
            )
    publish_set(results, output, kind, figures)


def in_logs(roles: Columns, trajectory: str | None) -> Columns:
    """Return the columns of the logs: the desired displacement may be in a file of its own."""
    if trajectory is None:
        return roles
    return {role: name for role, name in roles.items() if role != "desired"}


class Asked(NamedTuple):
    """What was asked of a report, of every channel alike."""

    logs: list[str]
    reading: opt.Reading
    rows: Any
    trajectory: str | None
    match: Literal["auto", "time", "rows"]
    lag: int
    remove_offset: bool
    max_rmse: str | None
    max_nrmse_percent: float | None


def reported(
    asked: Asked,
    roles: Columns,
    actuator: Cascade | None,
    model: str,
    state: State | str,
    expected: Any,
) -> Report:
    """Return the report of one actuator.

    Parameters
    ----------
    roles
        The columns of the logs; `desired` is that of the trajectory, where it is in a
        file.
    actuator, model, state
        The model to compare with, its name, and what was before the first row.
    expected
        The file of what was to be expected, or its values.
    """
    from dbo_cli.recordings import pair_of
    from dbo_cli.reports import Report, expected_in, expected_of, predict
    from dbo_cli.reports import match as matched

    units: Units = {}
    if actuator is not None:
        actuator.require("forward", model)
        units = opt.units_of(voltage=actuator.input, measured=actuator.output)
    elif asked.trajectory is not None:
        desired_rows, unit = read_trajectory(asked.trajectory, roles["desired"])
        roles = in_logs(roles, asked.trajectory)
        units = {} if unit is None else {"measured": unit}
    pairs = []
    for log in asked.logs:
        has_model = actuator is not None
        pair, log_units, source = pair_of(log, roles, asked.reading, units, has_model)
        detail(*source.remarks)
        units = {**log_units, **units}
        if actuator is not None:
            pair = predict(pair, actuator, state, model)
        elif asked.trajectory is not None:
            pair = matched(
                pair,
                desired_rows["trajectory"],
                desired_rows.time,
                asked.match,
                asked.trajectory,
                desired_rows.values.get("voltage"),
            )
        name = short_name(log, asked.logs)
        pairs.append(dataclasses.replace(pair, name=name, rows=asked.rows))
    unit = units.get("measured")
    if isinstance(expected, str):
        expected = expected_in(expected, unit)
    elif expected is not None:
        expected = expected_of(expected, unit)
    return Report.of(
        pairs,
        unit=unit,
        lag=asked.lag,
        remove_offset=asked.remove_offset,
        expected=expected,
        max_rmse=opt.quantity("max_rmse", asked.max_rmse, unit),
        max_nrmse_percent=asked.max_nrmse_percent,
        voltage_unit=units.get("voltage"),
        labels=("desired" if actuator is None else "model", "measured"),
        model=actuator,
        command=shlex.join(["dbo", *sys.argv[1:]]),
    )


def publish_set(
    results: dict[str, Report], output: str, form: str, figures: str | None
) -> None:
    """Write the reports of channels: text and JSON in one file, others a file a channel."""
    from dbo_cli import channels
    from dbo_cli.files import check_outputs, write_text

    check_outputs(output)
    texts = {name: result.render(form) for name, result in results.items()}
    if form == "json":
        write_text(output, channels.dumps_files("report", texts))
    elif form == "text":
        parts = [f"channel {name}\n{text}" for name, text in texts.items()]
        write_text(output, "\n".join(parts))
    else:
        for name, path in channels.paths_of(output, texts).items():
            write_text(path, texts[name])
    for name, result in results.items():
        if figures is not None:
            detail(*map(str, result.figures(os.path.join(figures, name))))
        if output != "-":
            say(f"{name}: {result.line()}")
        for text in result.warnings:
            warn(f"channel {name}: {text}")
    for result in results.values():
        result.require_passed()


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
    from dbo_cli.logs import columns_of, open_log

    drive = None
    if (
        column is not None and "desired" in column
    ):  # of a channel, as compensate names it
        typed = column.replace("desired", "voltage", 1)
        names = [each.quantity for each in columns_of(path)]
        drive = next((name for name in names if typed.startswith(name)), None)
    roles: Columns = {"time": None, "trajectory": column, "voltage": drive}
    with open_log(path, roles, optional=("time", "voltage")) as log:
        table = log.read()
    say_doubts(log)
    return table, log.columns["trajectory"].unit


def short_name(log: str, logs: list[str]) -> str:
    """Return the name of a file without its folder, where the names of all logs differ then."""
    names = {os.path.basename(path) or path for path in logs}
    return os.path.basename(log) or log if len(names) == len(logs) else log
