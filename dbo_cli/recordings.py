"""Recordings of an actuator, from files, frames and arrays alike.

Whatever brings them, columns get their roles, units and clock from ``open_log``: a frame
is read as a file is, and two arrays are a table of two columns.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.drive.simulate import Rows
from dbo_cli.errors import InputError, LimitError, UsageError, warn
from dbo_cli.logs import Block, Log, Reading, Table, open_log, open_table
from dbo_cli.logs.frame import frame_table, is_frame, table_in_memory
from dbo_cli.model import Cascade, Quantity, State, Steps
from dbo_cli.units import Typed, multiplied, quantity, quantity_name, ratio
from dbo_cli.version import __version__

if TYPE_CHECKING:
    from dbo_cli.identification import Options, Recording
    from dbo_cli.reports import Pair

RECORDING_ROLES = ("voltage", "displacement")
"""The columns of a recording, beside its time; files, frames and arrays bring these."""
Columns = Mapping[str, str | None]
"""What was typed for each role; None: found by name and unit."""
RECORDING_COLUMNS: Columns = dict.fromkeys(("time", *RECORDING_ROLES))
"""Nothing typed for the roles of a recording."""
TRACKED_COLUMNS: Columns = dict.fromkeys(("time", "voltage", "measured"))
"""Nothing typed for the roles of a recording of a pass."""
Units = Mapping[str, str | None]
"""The unit of each role; None: not known."""


def units_of(model: Cascade | None, sensor: str = "measured") -> dict[str, str | None]:
    """Return the units of a model's drive and displacement, by role; nothing without a model."""
    if model is None:
        return {}
    return {"voltage": model.input.unit, sensor: model.output.unit}


def read_table(
    source: Any,
    columns: Columns,
    reading: Reading,
    units: Units | None = None,
    optional: Sequence[str] = ("time",),
) -> tuple[Log, Block]:
    """Read a log whole, and warn of what is doubtful in it.

    Parameters
    ----------
    source : str, Path, Table, or pandas or polars frame
        The log.
    columns : mapping
        The roles that are needed.
    reading : Reading
        How it is read.
    units : mapping, optional
        By role, the unit that values are wanted in.
    optional : sequence of str
        Roles that may be absent.

    Raises
    ------
    InputError
        It cannot be read, or it is not clear which column is which.
    """
    if is_frame(source):
        source = frame_table(source)
    elif not isinstance(source, (str, Path, Table)):
        raise InputError("give a file, or a frame of pandas or polars")
    with open_log(source, columns, reading, units, optional) as log:
        table = log.read()
    log.warn_of_doubts()
    return log, table


def recordings_of(
    sources: Sequence[Any],
    columns: Columns,
    reading: Reading,
    units: Units | None = None,
) -> tuple[list[Recording], list[Log]]:
    """Read logs of one actuator; all get the units of the first.

    Parameters
    ----------
    sources : sequence
        Files, frames, and tables of arrays.
    columns, reading, units
        As of ``read_table``.

    Returns
    -------
    recordings, logs
        Arrays in seconds and in the units of the first log; and the logs, for what they
        have to say.

    Raises
    ------
    InputError
        A log cannot be read, or it is not clear which column is which.
    """
    from dbo_cli.identification import Recording

    recordings: list[Recording] = []
    logs: list[Log] = []
    for source in sources:
        log, table = read_table(source, columns, reading, units)
        if logs:
            _refuse_other_units(logs[0], log)
        log_units = {role: log.columns[role].unit for role in RECORDING_ROLES}
        units = {role: unit for role, unit in log_units.items() if unit}
        into, out = [
            (quantity_name(role, unit), unit) for role, unit in log_units.items()
        ]
        # a model does not depend on where its logs were
        file, mark, inside = log.name.partition("::")
        name = os.path.basename(file) + mark + inside
        voltage, displacement = table["voltage"], table["displacement"]
        recording = Recording(name, voltage, displacement, table.time, into, out)
        recordings.append(recording)
        logs.append(log)
    return recordings, logs


def _refuse_other_units(first: Log, other: Log) -> None:
    """Refuse (InputError) a log that states a unit where the first one states none."""
    for role in RECORDING_ROLES:
        unit = other.columns[role].unit
        if unit is not None and first.columns[role].unit is None:
            raise InputError(
                f"{other.name}: {role} is in {unit}, {first.name} states no unit: name its "
                f"column {role}_UNIT"
            )


def pairs_of(
    sources: Sequence[Any],
    columns: Columns,
    reading: Reading,
    model: Cascade | None = None,
    state: State | str = "auto",
    model_name: str = "the model",
    units: Units | None = None,
) -> tuple[list[Pair], Units, list[Log]]:
    """Return what logs measured beside what was desired or what a model predicts, the units, and the logs.

    Parameters
    ----------
    sources, columns, reading
        As of ``recordings_of``. With ``desired``, measured values come in its unit; with
        neither ``desired`` nor a model, pairs have measured values in both places.
    model, state, model_name
        A forward model, what was before the first row, and its name in messages.
    units : mapping, optional
        What all logs get, by role; the model's, else those of the first log.

    Raises
    ------
    InputError
        A log cannot be read, or its two columns measure different things.
    """
    from dbo_cli.reports import Pair, predict

    common = dict(units or {})
    optional = ["time"]
    if model is None:
        optional.append("voltage")
    else:
        model.require("forward", model_name)
        common = units_of(model)
    pairs, logs = [], []
    for source in sources:
        log, table = read_table(source, columns, reading, common, optional)
        log.warn_of_assumed()
        measured = table["measured"]
        desired = table.values.get("desired", measured)
        log_units = {role: column.unit for role, column in log.columns.items()}
        if "desired" in columns:
            measured = _in_desired_unit(measured, log, log_units)
            log_units["measured"] = log_units["desired"] or log_units["measured"]
        for role, unit in log_units.items():
            if unit is not None:
                common[role] = common.get(role) or unit
        pair = Pair(
            log.name, desired, measured, table.time, table.values.get("voltage")
        )
        if model is not None:
            pair = predict(pair, model, state, model_name)
        pairs.append(pair)
        logs.append(log)
    return pairs, common, logs


def _in_desired_unit(measured: Floats, log: Log, units: Units) -> Floats:
    """Return measured values in the unit of the desired ones; InputError where that is another kind."""
    if (units["desired"] is None) != (units["measured"] is None):
        bare = "desired" if units["desired"] is None else "measured"
        unit = units["desired"] or units["measured"]
        warn(f"{log.name}: {bare} states no unit: both are taken in {unit}")
    try:
        factor = ratio(units["measured"], units["desired"])
    except InputError as problem:
        raise InputError(
            f"{log.name}: measured and desired: {problem}: choose `measured` and `desired`"
        ) from None
    return cast(Floats, multiplied(measured, factor))


def matched(
    sources: Sequence[Any],
    columns: Columns,
    reading: Reading,
    trajectory: str,
    desired: str | None,
    by: str,
    has_summary: bool,
) -> tuple[list[Pair], Units, list[Log]]:
    """Return ``pairs_of`` logs whose desired values are in a file of their own, matched ``by`` time or rows.

    ``desired`` is the column of that file; its drive is looked for beside it. Without a
    summary, nothing tells where the move of a drive ends.
    """
    from dbo_cli.reports import Pair, match

    roles = {"time": None, "trajectory": desired}
    roles["voltage"] = _drive_beside(trajectory, desired)
    optional = ("time", "voltage")
    file, table = read_table(trajectory, roles, Reading(), optional=optional)
    trajectory_units = {"measured": file.columns["trajectory"].unit}
    pairs, units, logs = pairs_of(sources, columns, reading, units=trajectory_units)
    values, drive = table["trajectory"], table.values.get("voltage")
    move = Pair(trajectory, values, values, table.time, drive)
    matches = []
    for pair in pairs:
        matched_pair = match(pair, move, by)
        if drive is not None and not has_summary:
            matched_pair = matched_pair.noted(
                "rows of a way back count as the move: the drive's summary (`expected`) leaves them out"
            )
        matches.append(matched_pair)
    return matches, units, logs


def _drive_beside(trajectory: str, desired: str | None) -> str | None:
    """Return the drive's column beside the desired one of a channel, as compensate names it."""
    if desired is None or "desired" not in desired:
        return None
    name = desired.replace("desired", "voltage", 1)
    with open_table(trajectory, Reading()) as table:
        quantities = [column.quantity for column in table.columns]
    return next((each for each in quantities if name.startswith(each)), None)


def tracked_of(
    sources: Sequence[Any], columns: Columns, reading: Reading, model: Cascade
) -> list[tuple[str, Rows]]:
    """Read recordings of the last pass of a move, in the units of a model: names, and rows.

    Parameters
    ----------
    sources, columns, reading
        As of ``recordings_of``; the roles are ``time``, ``voltage`` and ``measured``.
    model : Cascade
        A forward model.
    """
    recordings = []
    for source in sources:
        log, table = read_table(source, columns, reading, units_of(model))
        log.warn_of_assumed()
        rows = Rows(table.time, table["voltage"], table["measured"])
        recordings.append((log.name, rows))
    return recordings


def identified(
    recordings: Sequence[Recording],
    logs: Sequence[Log],
    options: Options,
    tests: Sequence[Recording],
) -> Cascade:
    """Return the model of one actuator that logs were recorded of, with where it comes from.

    Parameters
    ----------
    recordings, logs
        As of ``recordings_of``.
    options
        Of the identification; an offset between clocks that was found holds the delay.
    tests
        Recordings that say how well the model predicts.
    """
    from dbo_cli.identification import identify

    if options.delay == "auto" and any(log.clock.holds_delay for log in logs):
        options = replace(options, delay=0.0)
    model = identify(recordings, options, tests)
    sources = []  # and no time of day: the same logs give the same file
    for recording, log in zip(recordings, logs, strict=True):
        origin = {"name": recording.name, "rows": len(recording.voltage)}
        for role, column in log.columns.items():
            origin[role] = log.titles.get(column.name, column.name)
        sources.append(origin)
    provenance = {"program": f"dbo {__version__}", "logs": sources}
    return replace(model, provenance=provenance)


def options_of(arguments: Mapping[str, Any]) -> Options:
    """Return what the user fixes of an identification, by the arguments of these names.

    Raises
    ------
    UsageError
        A value cannot be read, or makes no sense.
    """
    from dbo_cli.identification import Options

    values = {option.name: arguments[option.name] for option in fields(Options)}
    for name in ("skip", "sensor_delay"):
        values[name] = quantity(name, values[name], "s")
    values["delay"] = quantity("delay", values["delay"], "s", "auto")
    values["zero"] = quantity("zero", values["zero"], None, "none", "mean", "first")
    for name in ("gears", "points", "dynamics"):
        values[name] = _whole_number(name, values[name])
    values["relaxation"] = _time_constants(values["relaxation"])
    return Options(**values)


def _whole_number(name: str, value: int | str) -> Any:
    """Return a typed whole number, or ``auto`` (UsageError)."""
    if value == "auto" or not isinstance(value, str):
        return value
    try:
        return int(value)
    except ValueError:
        raise UsageError(f"`{name}` {value}: give auto or a whole number") from None


def _time_constants(values: Sequence[Typed] | Typed) -> Any:
    """Return typed time constants in s, 0 alone for none, or ``auto`` (UsageError)."""
    if isinstance(values, str):
        if values == "auto":
            return values
        values = values.split(",")
    typed = np.atleast_1d(values).tolist()
    constants = [quantity("relaxation", value, "s") for value in typed]
    if len(constants) > 1 and 0.0 in constants:
        raise UsageError("`relaxation`: give times above 0 s, or 0 alone")
    return tuple(constants)


def signal_of(
    data: Any,
    roles: tuple[str, str],
    of_model: Quantity,
    time: Any,
    sample_rate: Typed | None,
    unit: str | None,
) -> tuple[Floats, Steps, Floats | None]:
    """Return a signal that a user hands over, in the unit of a model, the seconds a row, and its stamps.

    Parameters
    ----------
    data
        An array, a Series, or a frame, which is read as the command reads a log.
    roles
        What it is, and the role of its column in a log.
    of_model
        What it is in the model.
    time, sample_rate, unit
        As of ``Model.simulate``.
    """
    reading = Reading.of_options({"sample_rate": sample_rate})
    role = roles[1] if is_frame(data) else roles[0]
    signals, units = {role: data}, {role: of_model.unit}
    source, columns = table_in_memory(signals, {role: unit}, units, time, reading)
    block = read_table(source, columns, reading, units)[1]
    is_stamped = is_frame(data) or sample_rate is None
    return block[role], block.dt, block.time if is_stamped else None


def read_drive(
    path: str, columns: Columns, reading: Reading, units: Units | None = None
) -> tuple[Log, Block]:
    """Read a drive whole, as strictly as it was written.

    Raises
    ------
    LimitError
        A row holds no number: an amplifier cannot play it.
    UsageError
        The drive is in another file than its time: interpolated, it is not the drive.
    """
    if "::" in (columns["voltage"] or ""):
        raise UsageError(f"`voltage` {columns['voltage']}: name that file as DRIVE")
    with open_log(path, columns, reading, units) as log:
        try:
            table = log.read()
        except InputError as problem:
            raise LimitError(str(problem)) from problem
    log.warn_of_assumed()
    return log, table


def read_meant(path: str, column: str | None, unit: str | None) -> Block:
    """Read the drive that was meant to be played (InputError): the only one of its file."""
    columns, units = {"time": None, "voltage": column}, {"voltage": unit}
    try:
        return read_drive(path, columns, Reading(), units if unit else None)[1]
    except InputError as problem:
        raise InputError(
            f"`against`: {problem} (of several columns it takes voltage_V)"
        ) from None
