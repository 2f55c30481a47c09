"""``dbo report``."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from dbo_cli.cli.options import (
    Figures,
    LogFiles,
    Output,
    State,
    Text,
    Time,
    column,
    count,
    number,
    quantity,
    reads_logs,
)
from dbo_cli.cli.say import detail, say, shell_line
from dbo_cli.cli.simulate import START_NAMES
from dbo_cli.errors import UsageError, warn

if TYPE_CHECKING:
    from dbo_cli.logs import Reading
    from dbo_cli.model import Model
    from dbo_cli.reports import Pair

BESIDE, BOUNDS = "What is compared", "Bounds (exit 3)"
FORMS = {".json": "json", ".csv": "csv", ".html": "html", ".htm": "html"}


@reads_logs
def report(
    logs: LogFiles,
    reading: Reading,
    output: Output = "-",
    form: Annotated[
        Literal["text", "json", "csv", "html"] | None,
        Option(
            "--format", help="Form of the report; by the output's name where not given."
        ),
    ] = None,
    figures: Figures = None,
    desired: Annotated[Text, column("What was wanted")] = None,
    measured: Annotated[Text, column("What came")] = None,
    voltage: Annotated[Text, column("The drive, for --model and the figures")] = None,
    time: Time = None,
    trajectory: Annotated[
        Text,
        Option(
            metavar="FILE",
            help="Where the wanted displacement is, if elsewhere.",
            rich_help_panel=BESIDE,
        ),
    ] = None,
    match: Annotated[
        Literal["auto", "time", "rows"],
        Option(
            help="How log and --trajectory belong together.",
            hidden=True,
            rich_help_panel=BESIDE,
        ),
    ] = "auto",
    model: Annotated[
        Text,
        Option(
            metavar="MODEL",
            help="Compare this model's prediction with the log.",
            rich_help_panel=BESIDE,
        ),
    ] = None,
    state: State = "auto",
    expected: Annotated[
        Text,
        Option(
            metavar="SUMMARY",
            help="What was expected: a --summary, or a model.",
            rich_help_panel=BESIDE,
        ),
    ] = None,
    lag: Annotated[
        str,
        Option(
            metavar="N",
            help="Rows by which measured is taken later.",
            hidden=True,
            rich_help_panel=BESIDE,
        ),
    ] = "0",
    remove_offset: Annotated[
        bool,
        Option(
            "--remove-offset",
            help="Take the mean off the error.",
            rich_help_panel=BESIDE,
        ),
    ] = False,
    max_rmse: Annotated[
        Text,
        Option(
            metavar="VALUE",
            help="Greatest RMS error; 10nm as well.",
            rich_help_panel=BOUNDS,
        ),
    ] = None,
    max_nrmse_percent: Annotated[
        Text,
        Option(
            metavar="PERCENT",
            help="Greatest RMS error, in % of the move.",
            rich_help_panel=BOUNDS,
        ),
    ] = None,
) -> None:
    """Report how well the measured displacement follows the wanted one.

    Several logs are put side by side. With --model the model's prediction takes the
    place of the wanted displacement.

    Examples: dbo report uncompensated.csv compensated.csv -o report.html;
    dbo report tracked.csv --trajectory drive.csv --max-nrmse-percent 1
    """
    import dataclasses

    from dbo_cli.logs import write_text
    from dbo_cli.model import read_model
    from dbo_cli.reports import Report, expected_in

    if model is not None and trajectory is not None:
        raise UsageError(
            "`model` and `trajectory` both say what is compared: give one of them"
        )
    lag_rows = count("lag", lag) or 0
    quantity("max_rmse", max_rmse, None)  # a wrong word is refused before any work
    most_percent = number("max_nrmse_percent", max_nrmse_percent)
    actuator = None if model is None else read_model(model)
    columns = {
        "time": time,
        "desired": desired,
        "measured": measured,
        "voltage": voltage,
    }
    names = dict(zip(logs, short_names(logs), strict=True))
    pairs: list[Pair] = []
    units: dict[str, str] = {}
    for log in logs:
        if actuator is not None and model is not None:
            pair, found = predicted(log, reading, columns, actuator, model, state)
        elif trajectory is not None:
            pair, found = followed(log, reading, columns, trajectory, match, units)
        else:
            pair, found = beside(log, reading, columns, units)
        units = units or found
        pairs.append(dataclasses.replace(pair, name=names[log]))
    unit = units.get("measured")
    result = Report.of(
        pairs,
        unit=unit,
        voltage_unit=units.get("voltage"),
        lag=lag_rows,
        remove_offset=remove_offset,
        labels=("desired", "measured") if actuator is None else ("model", "measured"),
        model=actuator,
        model_name=model,
        expected=None if expected is None else expected_in(expected, unit),
        max_rmse=quantity("max_rmse", max_rmse, unit),
        max_nrmse_percent=most_percent,
        command=command_line(),
        spell=shell_line,
    )
    write_text(output, result.render(form or form_of(output)))
    if figures is not None:
        for path in result.figures(figures):
            detail(str(path))
    if output != "-":
        say(result.line())
    detail(*result.notes)
    for text in result.warnings:
        warn(text)
    result.require_passed()


def short_names(logs: list[str]) -> list[str]:
    """Return the names of files without their folders, where those differ."""
    short = [os.path.basename(log) or log for log in logs]
    return short if len(set(short)) == len(logs) else logs


def beside(
    path: str, reading: Reading, columns: dict[str, str | None], units: dict[str, str]
) -> tuple[Pair, dict[str, str]]:
    """Read wanted and measured displacement of one log."""
    from dbo_cli.logs import open_log
    from dbo_cli.reports import Pair
    from dbo_cli.units import conversion

    whole, rows = without_rows(reading)
    with open_log(path, columns, whole, units, optional=("time", "voltage")) as log:
        table = log.read()
        found = units_of(log)
    unit = found.get("desired", found.get("measured"))
    factor = conversion(found.get("measured"), unit)
    if unit is not None:
        found.update(desired=unit, measured=unit)
    pair = Pair(
        path,
        table["desired"],
        table["measured"] * factor,
        time=table.time,
        voltage=table["voltage"] if log.provided("voltage") else None,
        rows=rows,
        notes=tuple(log.remarks),
    )
    return pair, found


def without_rows(reading: Reading) -> tuple[Reading, Any]:
    """Return how a log is read whole, and the rows of it that count."""
    import dataclasses

    from dbo_cli.logs import parse_rows

    rows = None if reading.rows is None else parse_rows(reading.rows)
    return dataclasses.replace(reading, rows=None), rows


def followed(
    path: str,
    reading: Reading,
    columns: dict[str, str | None],
    trajectory: str,
    match_by: Any,
    units: dict[str, str],
) -> tuple[Pair, dict[str, str]]:
    """Read a measured log and the trajectory that it should have followed."""
    import dataclasses

    from dbo_cli.logs import open_log
    from dbo_cli.reports import match

    whole, rows = without_rows(reading)
    scale = dict(whole.scale)
    scale_of_wanted = {"trajectory": scale.pop("desired")} if "desired" in scale else {}
    whole = dataclasses.replace(whole, scale=scale)
    roles = {
        "time": columns["time"],
        "measured": columns["measured"],
        "voltage": columns["voltage"],
    }
    with open_log(path, roles, whole, units, optional=("time", "voltage")) as log:
        table = log.read()
        found = units_of(log)
    wanted_units = {"trajectory": found["measured"]} if "measured" in found else {}
    wanted_roles = {"time": None, "trajectory": columns["desired"]}
    with open_log(
        trajectory,
        wanted_roles,
        dataclasses.replace(whole, sample_rate=None, scale=scale_of_wanted),
        wanted_units,
    ) as wanted:
        desired = wanted.read()
    pair = match(
        path,
        table["measured"],
        desired["trajectory"],
        measured_time=table.time,
        desired_time=desired.time,
        match=match_by,
        trajectory_name=trajectory,
        voltage=table["voltage"] if log.provided("voltage") else None,
        rows=rows,
    )
    return pair, found


def predicted(
    path: str,
    reading: Reading,
    columns: dict[str, str | None],
    actuator: Model,
    model_name: str,
    state: str,
) -> tuple[Pair, dict[str, str]]:
    """Read a log of drive and displacement, and run the model over the drive."""
    from dbo_cli.logs import open_log
    from dbo_cli.model import read_state
    from dbo_cli.reports import predict

    actuator.require("forward", model_name)
    units = {}
    if actuator.input.unit:
        units["voltage"] = actuator.input.unit
    if actuator.output.unit:
        units["measured"] = actuator.output.unit
    roles = {
        "time": columns["time"],
        "voltage": columns["voltage"],
        "measured": columns["measured"],
    }
    whole, rows = without_rows(reading)
    with open_log(path, roles, whole, units) as log:
        table = log.read()
        found = units_of(log)
    pair = predict(
        actuator,
        table["voltage"],
        table["measured"],
        name=path,
        time=table.time,
        state=state if state in START_NAMES else read_state(state, actuator),
        rows=rows,
        model_name=model_name,
    )
    return pair, found


def units_of(log: Any) -> dict[str, str]:
    """Return the units of a log by role, of those that have one."""
    units = {}
    for role, found in log.columns.items():
        if found.unit and role != "time":
            units[role] = found.unit
    return units


def form_of(output: str) -> str:
    """Return the form of a report that its name asks for."""
    for ending, form in FORMS.items():
        if output.lower().endswith(ending):
            return form
    return "text"


def command_line() -> str:
    """Return what was typed, for the footer of a page."""
    import shlex

    return shlex.join(["dbo", *sys.argv[1:]])
