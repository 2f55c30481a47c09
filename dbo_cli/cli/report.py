"""``dbo report``."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from typing import TYPE_CHECKING, Annotated, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import OUTPUT, Text, column, flag, option, rare
from dbo_cli.cli.say import detail, say
from dbo_cli.errors import InputError, UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Block, Reading
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
    most_percent = opt.number("max_nrmse_percent", max_nrmse_percent)
    actuator = None if model is None else read_model(model)
    roles = {"time": time, "measured": measured, "voltage": voltage}
    # a lag, a model and a match by rows need the rows around those that count
    rows = None if reading.rows is None else parse_rows(reading.rows)
    reading = dataclasses.replace(reading, rows=None)
    pairs: list[Pair] = []
    units: Units = {}
    for log in logs:
        if actuator is not None and model is not None:
            pair, read = predicted(log, reading, roles, actuator, model, state)
        elif trajectory is not None:
            roles["desired"] = desired
            pair, read = followed(log, reading, roles, trajectory, match, units)
        else:
            roles["desired"] = desired
            pair, read = side_by_side(log, reading, roles, units)
        units = units or read
        pairs.append(dataclasses.replace(pair, name=short_name(log, logs), rows=rows))
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
    path: str, reading: Reading, roles: Columns, units: Units, *optional: str
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


def side_by_side(
    path: str, reading: Reading, roles: Columns, units: Units
) -> tuple[Pair, Units]:
    """Read desired and measured displacement of one log, in the unit of the desired one."""
    from dbo_cli.reports import Pair
    from dbo_cli.units import conversion

    table, read_units = read(path, reading, roles, units, "voltage")
    unit = read_units.get("desired", read_units.get("measured"))
    try:
        factor = conversion(read_units.get("measured"), unit)
    except InputError as problem:
        raise InputError(
            f"{path}: measured and desired: {problem}: choose `measured` and `desired`"
        ) from None
    if unit is not None:
        read_units["measured"] = unit
    measured = table["measured"] * factor
    voltage = table.values.get("voltage")
    return Pair(path, table["desired"], measured, table.time, voltage), read_units


def followed(
    path: str,
    reading: Reading,
    roles: Columns,
    trajectory: str,
    match_by: str,
    units: Units,
) -> tuple[Pair, Units]:
    """Read a measured log and the trajectory that it should have followed."""
    from dbo_cli.reports import match

    roles, scale = dict(roles), dict(reading.scale)
    wanted_roles: Columns = {"time": None, "trajectory": roles.pop("desired")}
    wanted_scale = {"trajectory": scale.pop("desired")} if "desired" in scale else {}
    measured_reading = dataclasses.replace(reading, scale=scale)
    wanted_reading = dataclasses.replace(reading, scale=wanted_scale, sample_rate=None)
    table, read_units = read(path, measured_reading, roles, units, "voltage")
    wanted_units = {}
    if "measured" in read_units:
        wanted_units["trajectory"] = read_units["measured"]
    wanted, _ = read(trajectory, wanted_reading, wanted_roles, wanted_units)
    pair = match(
        path,
        table["measured"],
        wanted["trajectory"],
        measured_time=table.time,
        desired_time=wanted.time,
        match=match_by,
        trajectory_name=trajectory,
        voltage=table.values.get("voltage"),
    )
    return pair, read_units


def predicted(
    path: str,
    reading: Reading,
    roles: Columns,
    actuator: Model,
    model_name: str,
    state: str,
) -> tuple[Pair, Units]:
    """Read a log of drive and displacement, and run the model over the drive."""
    from dbo_cli.reports import predict

    actuator.require("forward", model_name)
    units = opt.units_of(voltage=actuator.input, measured=actuator.output)
    table, read_units = read(path, reading, roles, units)
    pair = predict(
        actuator,
        table["voltage"],
        table["measured"],
        name=path,
        time=table.time,
        state=opt.state_of(state, actuator),
        model_name=model_name,
    )
    return pair, read_units


def short_name(log: str, logs: list[str]) -> str:
    """Return the name of a file without its folder, where the names of all logs differ then."""
    names = {os.path.basename(path) or path for path in logs}
    return os.path.basename(log) or log if len(names) == len(logs) else log
