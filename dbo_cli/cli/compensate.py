"""``dbo compensate``: a forward model and a desired displacement into the feedforward drive."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice

if TYPE_CHECKING:
    from dbo_cli.drives.options import DriveOptions
    from dbo_cli.logs.reading_options import ReadingOptions


def compensate(
    *,
    model: options.Model,
    trajectory: options.Trajectory,
    reading: ReadingOptions,
    asked: DriveOptions,
    voice: Voice,
    typed: Sequence[str],
    tracked: options.TrackedLogs,
    voltage: options.TrackedVoltage,
    measured: options.TrackedMeasured,
    state: options.State,
    save_state: options.SaveState,
    displacement: options.Displacement,
    flush: options.Flush,
    summary: options.Summary,
    output: options.Output,
) -> None:
    """Write the drive voltage that makes the actuator follow a desired displacement.

    The forward model is inverted exactly and started in the state in which dbo simulate of the drive starts;
    a delay is made up for by reading the trajectory ahead. What the drive cannot reach within its limits is
    clipped, counted and said; no row ever breaks a limit. Written are time (when known), the desired
    displacement and the drive.

    Example: dbo compensate model.json trajectory.csv --max-slew 2000 --from 0 --approach auto -o drive.csv
    """
    from dbo_cli.runs.drive_files import compensate_trajectory
    from dbo_cli.runs.files import Destination

    inputs = [model, trajectory, state, *(tracked or ())]
    command = shlex.join(["dbo", *typed])
    remarks = compensate_trajectory(
        model,
        trajectory,
        Destination(output, save_state, inputs, flush, command, summary),
        reading,
        asked,
        column=displacement,
        state=state,
        tracked=tracked or (),
        voltage=voltage,
        measured=measured,
        listener=Progress(voice, "written"),
    )
    voice.remarks(remarks)
