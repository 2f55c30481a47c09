"""Logs of an actuator as the arrays that ``identify`` and ``compare`` work on."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.arrays import Floats
from dbo_cli.errors import warn
from dbo_cli.logs import Reading, open_log
from dbo_cli.units import quantity_name
from dbo_cli.version import __version__

if TYPE_CHECKING:
    from dbo_cli.identification import Recording
    from dbo_cli.logs import Log

Units = Mapping[str, str | None]


def read_recordings(
    paths: Sequence[str], reading: Reading, columns: dict[str, str | None]
) -> tuple[list[Recording], list[Log]]:
    """Read logs of one actuator; all get the units of the first.

    Parameters
    ----------
    paths : sequence of str
        The logs, as typed.
    reading : Reading
        How they are read.
    columns : dict
        What was typed for the roles time, voltage and displacement.

    Returns
    -------
    recordings, logs
        Arrays in seconds and the log's units, and the logs for what they have to say.

    Raises
    ------
    InputError
        A log cannot be read, or it is not clear which column is which.
    """
    recordings, logs = [], []
    units: Units = {}
    for path in paths:
        wanted = {role: unit for role, unit in units.items() if unit}
        with open_log(path, columns, reading, wanted) as log:
            table = log.read()
        units = {role: log.columns[role].unit for role in ("voltage", "displacement")}
        name, signals = short_name(log.name), (table["voltage"], table["displacement"])
        recording = recording_of(name, *signals, table.time, units)
        for doubt in log.doubtful:
            warn(f"{path}: {doubt}")
        recordings.append(recording)
        logs.append(log)
    return recordings, logs


def recording_of(
    name: str, voltage: Floats, displacement: Floats, time: Floats | None, units: Units
) -> Recording:
    """Return two signals as a recording, with what their units measure."""
    from dbo_cli.identification import Recording

    quantities: dict[str, Any] = {}
    for role, unit in units.items():
        quantities[role] = quantity_name(role, unit), unit
    return Recording(
        name,
        voltage,
        displacement,
        time,
        input=quantities["voltage"],
        output=quantities["displacement"],
    )


def short_name(name: str) -> str:
    """Return a log's name without its folder, so that a model does not depend on where its logs were."""
    file, mark, part = name.partition("::")
    return os.path.basename(file) + mark + part


def provenance(recordings: Sequence[Recording], logs: Sequence[Log]) -> dict[str, Any]:
    """Return where a model comes from: the program and its logs, and no time of day."""
    sources = []
    for recording, log in zip(recordings, logs, strict=True):
        source: dict[str, Any] = {
            "name": recording.name,
            "rows": len(recording.voltage),
        }
        for role, column in log.columns.items():
            source[role] = column.name
        sources.append(source)
    return {"program": f"dbo {__version__}", "logs": sources}
