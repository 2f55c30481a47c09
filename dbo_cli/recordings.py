"""Logs of an actuator as the arrays that ``identify`` and ``compare`` work on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.errors import LimitError, warn
from dbo_cli.logs import Reading, open_log
from dbo_cli.units import quantity_name

CLEAR = 0.3
"""Correlation of voltage and displacement from which on it is clear which way they go together."""

if TYPE_CHECKING:
    from dbo_cli.identification import Recording
    from dbo_cli.logs import Log
    from dbo_cli.model import Model


def read_recordings(
    paths: Sequence[str],
    reading: Reading,
    columns: dict[str, str | None],
    units: dict[str, str] | None = None,
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
    units : dict, optional
        The units of voltage and displacement; those of the first log if not given.

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
    for path in paths:
        recording, log = read_recording(path, reading, columns, units)
        units = {"voltage": recording.input[1], "displacement": recording.output[1]}
        units = {role: unit for role, unit in units.items() if unit}
        recordings.append(recording)
        logs.append(log)
    return recordings, logs


def read_recording(
    path: str,
    reading: Reading,
    columns: dict[str, str | None],
    units: dict[str, str] | None,
) -> tuple[Recording, Log]:
    """Read one log of an actuator; see ``read_recordings``."""
    from dbo_cli.identification import Recording

    with open_log(path, columns, reading, units) as log:
        table = log.read()
        drive, moved = log.columns["voltage"], log.columns["displacement"]
        recording = Recording(
            name=short_name(log.name),
            voltage=table["voltage"],
            displacement=table["displacement"],
            time=table.time,
            input=(quantity_name("voltage", drive.unit), drive.unit),  # type: ignore[arg-type]
            output=(quantity_name("displacement", moved.unit), moved.unit),  # type: ignore[arg-type]
        )
    for doubt in log.doubtful:
        warn(f"{path}: {doubt}")
    return recording, log


def short_name(name: str) -> str:
    """Return a log's name without its folder, so that a model does not depend on where its logs were."""
    file, mark, part = name.partition("::")
    return os.path.basename(file) + mark + part


def require_sign(recordings: Sequence[Recording], wanted: str | None) -> None:
    """Refuse logs in which the displacement goes the other way than was said.

    Raises
    ------
    LimitError
        It does.
    """
    for recording in recordings:
        shared = float(np.corrcoef(recording.voltage, recording.displacement)[0, 1])
        sign = "rising" if shared > 0.0 else "falling"
        if wanted not in (None, sign) and abs(shared) > CLEAR:
            raise LimitError(
                f"{recording.name}: displacement is {sign} with voltage, `sign` is {wanted}: check "
                "columns, or `scale` displacement=-1"
            )


def provenance(recordings: Sequence[Recording], logs: Sequence[Log]) -> dict[str, Any]:
    """Return where a model comes from: the program and its logs, and no time of day."""
    from dbo_cli.version import __version__

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


def with_provenance(
    model: Model, recordings: Sequence[Recording], logs: Sequence[Log]
) -> Model:
    """Return a model that names its logs."""
    import dataclasses

    return dataclasses.replace(model, provenance=provenance(recordings, logs))
