"""Recordings of an actuator, from files, frames and arrays alike.

Whatever brings them, columns get their roles, units and clock from ``open_log``: a frame
is read as a file is, and two arrays are a table of two columns.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.logs import Block, Column, Reading, Table, open_log, open_table
from dbo_cli.logs.frame import (
    clock_of,
    column_in_memory,
    floats,
    frame_table,
    is_frame,
    seconds_of,
    stated_unit,
    table_of,
)
from dbo_cli.model import Cascade, Quantity, State, steps_of
from dbo_cli.units import (
    multiplied,
    quantity_name,
    ratio,
    split_header,
    to_model_unit,
    warn_unstated,
)
from dbo_cli.version import __version__

if TYPE_CHECKING:
    from dbo_cli.drive.learning import Tracked
    from dbo_cli.identification import Options, Recording
    from dbo_cli.logs import Log
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
    titles: Mapping[str, str] = {}  # in the file that a frame was read from
    if is_frame(source):
        titles = getattr(source, "attrs", {}).get("columns", {})
        source = frame_table(source)
    elif not isinstance(source, (str, Path, Table)):
        raise InputError("give a file, or a frame of pandas or polars")
    with open_log(source, columns, reading, units, optional) as log:
        table = log.read()
    for doubt in log.doubtful:
        warn(f"{log.name}: {doubt}")
    for role, column in log.columns.items():
        name = titles.get(column.name, column.name)
        log.columns[role] = replace(column, name=name)
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
        drive, sensor = (log.columns[role].unit for role in RECORDING_ROLES)
        units = {"voltage": drive, "displacement": sensor}
        units = {role: unit for role, unit in units.items() if unit}
        recording = Recording(
            short_name(log.name),
            table["voltage"],
            table["displacement"],
            table.time,
            input=(quantity_name("voltage", drive), drive),
            output=(quantity_name("displacement", sensor), sensor),
        )
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


def arrays_table(
    signals: Mapping[str, Any],
    unit_options: Units,
    units: Units,
    time: Any = None,
    sample_rate: float | None = None,
) -> tuple[Table, dict[str, str | None]]:
    """Return arrays as a table, and which of its columns has which role.

    Parameters
    ----------
    signals : mapping
        By role, the values; the name of a Series is that of its column.
    unit_options : mapping
        By role, the unit that the user gives.
    units : mapping
        By role, the unit of a model that they are for.
    time, sample_rate
        As of ``clock_of``.
    """
    table, arrays = "the arrays", list[Column]()
    columns: dict[str, str | None] = {"time": None}
    for role, values in signals.items():
        label = "voltage" if role == "voltage" else "displacement"
        array = floats(values, role)
        unit, unit_option = stated_unit(values, label), unit_options[role]
        to_model_unit(label, unit, unit_option, units.get(role, unit_option))
        name = str(getattr(values, "name", None) or role)
        if unit_option:  # goes before that of the name
            name = split_header(name)[0]
        unit = unit_option or unit or units.get(role)
        arrays.append(column_in_memory(table, name, array, unit))
        columns[role] = f"number={len(arrays)}"
    clock = clock_of(signals, time, sample_rate, arrays[0].length)
    if isinstance(clock, np.ndarray):
        arrays.append(column_in_memory(table, "time", clock, "s"))
        columns["time"] = f"number={len(arrays)}"
    return table_of(table, arrays), columns


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
        common = {"voltage": model.input.unit, "measured": model.output.unit}
    pairs, logs = [], []
    for source in sources:
        log, table = read_table(source, columns, reading, common, optional)
        warn_of_assumed(log)
        measured = table["measured"]
        desired = table.values.get("desired", measured)
        stated = {role: column.unit for role, column in log.columns.items()}
        if "desired" in columns:
            measured = _in_desired_unit(measured, log, stated)
            stated["measured"] = stated["desired"] or stated["measured"]
        for role, unit in stated.items():
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


def warn_of_assumed(log: Log) -> None:
    """Warn of columns whose unit is assumed, where no line says what was read."""
    for label in log.assumed:
        warn(f"{log.name}: {label}: state its unit in its name, or by `scale`")


def tracked_of(
    sources: Sequence[Any], columns: Columns, reading: Reading, model: Cascade
) -> list[Tracked]:
    """Read recordings of the last pass of a move, in the units of a model.

    Parameters
    ----------
    sources, columns, reading
        As of ``recordings_of``; the roles are ``time``, ``voltage`` and ``measured``.
    model : Cascade
        A forward model.
    """
    if not sources:  # nothing is loaded for it
        return []
    from dbo_cli.drive.learning import Tracked

    units = {"voltage": model.input.unit, "measured": model.output.unit}
    recordings = []
    for source in sources:
        log, table = read_table(source, columns, reading, units)
        warn_of_assumed(log)
        recordings.append(
            Tracked(log.name, table["voltage"], table["measured"], table.time)
        )
    return recordings


def short_name(name: str) -> str:
    """Return a log's name without its folder, so that a model does not depend on where its logs were."""
    file, mark, inside = name.partition("::")
    return os.path.basename(file) + mark + inside


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
        rows = len(recording.voltage)
        names = {role: column.name for role, column in log.columns.items()}
        sources.append({"name": recording.name, "rows": rows, **names})
    provenance = {"program": f"dbo {__version__}", "logs": sources}
    return replace(model, provenance=provenance)


# --- arrays ---


def signal_of(
    data: Any,
    roles: tuple[str, str],
    quantity: Quantity,
    time: Any,
    sample_rate: float | None,
    unit: str | None,
) -> Block:
    """Return a signal that a user hands over in the unit of a model, a frame as the command reads a log.

    Parameters
    ----------
    data
        An array, a Series or a frame.
    roles
        What it is, and the role of its column in a log, under which the block has it.
    quantity
        Of the model.
    time, sample_rate, unit
        As of ``Model.simulate``, the rate in Hz.
    """
    if is_frame(data):
        if unit is not None:
            raise UsageError("`unit` is of arrays: a frame has its own units")
        source = frame_table(data, seconds_of(time))
        columns = dict.fromkeys(("time", roles[1]))
        units = {roles[1]: quantity.unit}
        return read_table(source, columns, Reading(sample_rate=sample_rate), units)[1]
    values, stated = floats(data, roles[0]), stated_unit(data, roles[0])
    factor = to_model_unit(roles[0], stated, unit, quantity.unit)
    warn_unstated(roles[0], stated, quantity.unit)
    values = multiplied(values, factor)
    clock = clock_of({roles[0]: data}, time, sample_rate, len(values))
    if isinstance(clock, np.ndarray):
        return Block(clock, {roles[1]: values}, steps_of(clock))
    return Block(None, {roles[1]: values}, clock)
