"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from typing import TYPE_CHECKING, Annotated, Any, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import OUTPUT, Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say
from dbo_cli.errors import InputError, UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Block
    from dbo_cli.model import Model
    from dbo_cli.reports import Pair

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
    from dbo_cli.logs import parse_rows, write_text
    from dbo_cli.model import read_model
    from dbo_cli.reports import Report, expected_in

    if model is not None and trajectory is not None:
        raise UsageError("give either `model` or `trajectory`")
    opt.require("model", model, {"state": state != "auto"})
    opt.require("trajectory", trajectory, {"match": match != "auto"})
    opt.quantity("max_rmse", max_rmse, None)  # a wrong word is refused before any work
    most_percent = opt.number("max_nrmse_percent", max_nrmse_percent, float)
    # a lag, a model and a match by rows need the rows around those that count
    rows = None if reading.rows is None else parse_rows(reading.rows)
    reading = dataclasses.replace(reading, rows=None)
    roles = {"time": time, "measured": measured, "voltage": voltage}
    actuator = None
    if model is not None:
        actuator = read_model(model)
        actuator.require("forward", model)
        start = opt.state_of(state, actuator)
        pairs, units = predicted(logs, reading, roles, actuator, start, model)
    elif trajectory is not None:
        pairs, units = followed(logs, reading, roles, trajectory, desired, match)
    else:
        roles["desired"] = desired
        pairs, units = side_by_side(logs, reading, roles)
    for number, pair in enumerate(pairs):
        name = short_name(pair.name, logs)
        pairs[number] = dataclasses.replace(pair, name=name, rows=rows)
    unit = units.get("measured")
    result = Report.of(
        pairs,
        unit=unit,
        lag=lag,
        remove_offset=remove_offset,
        expected=None if expected is None else expected_in(expected, unit),
        max_rmse=opt.quantity("max_rmse", max_rmse, unit),
        max_nrmse_percent=most_percent,
        voltage_unit=units.get("voltage"),
        labels=("desired" if actuator is None else "model", "measured"),
        model=actuator,
        command=shlex.join(["dbo", *sys.argv[1:]]),
    )
    write_text(output, result.render(opt.form_of(form, output)))
    if figures is not None:
        detail(*map(str, result.figures(figures)))
    if output != "-":
        say(result.line())
    detail(*result.notes)
    for text in result.warnings:
        warn(text)
    result.require_passed()


def read(
    path: str, reading: opt.Reading, roles: Columns, units: Units, *optional: str
) -> tuple[Block, Units]:
    """Return a whole log, and the units of its columns."""
    from dbo_cli.logs import open_log

    with open_log(path, roles, reading, units, ("time", *optional)) as log:
        table = log.read()
        columns = {role: entry for role, entry in log.columns.items() if role != "time"}
    for doubt in log.doubtful:
        warn(f"{path}: {doubt}")
    detail(*log.remarks)
    return table, opt.units_of(**columns)


def predicted(
    logs: list[str],
    reading: opt.Reading,
    roles: Columns,
    actuator: Model,
    state: Any,
    name: str,
) -> tuple[list[Pair], Units]:
    """Read logs of drive and displacement, and run the model over the drive."""
    from dbo_cli.reports import predict

    units = opt.units_of(voltage=actuator.input, measured=actuator.output)
    pairs = []
    for log in logs:
        table, _ = read(log, reading, roles, units)
        pair = predict(
            actuator,
            table["voltage"],
            table["measured"],
            name=log,
            time=table.time,
            state=state,
            model_name=name,
        )
        pairs.append(pair)
    return pairs, units


def followed(
    logs: list[str],
    reading: opt.Reading,
    roles: Columns,
    trajectory: str,
    desired: str | None,
    match_by: str,
) -> tuple[list[Pair], Units]:
    """Read measured logs and the trajectory that they should have followed."""
    from dbo_cli.logs import Reading
    from dbo_cli.reports import match

    wish = {"time": None, "trajectory": desired}
    wanted, wish_units = read(trajectory, Reading(), wish, {})
    units = {}
    if "trajectory" in wish_units:
        units["measured"] = wish_units["trajectory"]
    pairs = []
    for log in logs:
        table, log_units = read(log, reading, roles, units, "voltage")
        units = log_units
        pair = match(
            log,
            table["measured"],
            wanted["trajectory"],
            measured_time=table.time,
            desired_time=wanted.time,
            match=match_by,
            trajectory_name=trajectory,
            voltage=table.values.get("voltage"),
        )
        pairs.append(pair)
    return pairs, units


def side_by_side(
    logs: list[str], reading: opt.Reading, roles: Columns
) -> tuple[list[Pair], Units]:
    """Read logs of desired and measured displacement, in the unit of the first desired one."""
    from dbo_cli.reports import Pair
    from dbo_cli.units import conversion

    units: Units = {}
    pairs = []
    for log in logs:
        table, log_units = read(log, reading, roles, units, "voltage")
        unit = log_units.get("desired", log_units.get("measured"))
        try:
            factor = conversion(log_units.get("measured"), unit)
        except InputError as problem:
            raise InputError(
                f"{log}: measured and desired: {problem}: choose `measured` and `desired`"
            ) from None
        if unit is not None:
            log_units["measured"] = unit
        units = units or log_units
        moved, drive = factor * table["measured"], table.values.get("voltage")
        pairs.append(Pair(log, table["desired"], moved, table.time, drive))
    return pairs, units


def short_name(log: str, logs: list[str]) -> str:
    """Return the name of a file without its folder, where the names of all logs differ then."""
    names = {os.path.basename(path) or path for path in logs}
    return os.path.basename(log) or log if len(names) == len(logs) else log
