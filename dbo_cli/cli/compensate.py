"""``dbo compensate``: a forward model and a desired displacement into the feedforward drive."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.cli import options
from dbo_cli.cli.messages import Progress, Voice

if TYPE_CHECKING:
    from dbo_cli.logs.reading_options import ReadingOptions


def compensate(
    *,
    model: options.Model,
    trajectory: options.Trajectory,
    reading: ReadingOptions,
    voice: Voice,
    typed: Sequence[str],
    v_min: options.VoltageMin,
    v_max: options.VoltageMax,
    max_slew: options.MaxSlew,
    on_limit: options.OnLimit,
    condition: options.Condition,
    bandwidth: options.Bandwidth,
    tracked: options.TrackedLogs,
    periodic: options.Periodic,
    passes: options.Passes,
    voltage: options.TrackedVoltage,
    measured: options.TrackedMeasured,
    state: options.State,
    save_state: options.SaveState,
    displacement: options.Displacement,
    flush: options.Flush,
    output: options.Output,
) -> None:
    """Write the drive voltage that makes the actuator follow a desired displacement.

    The forward model is inverted exactly and started in the state in which dbo simulate of the drive starts;
    a delay is made up for by reading the trajectory ahead. What the drive cannot reach within its limits is
    clipped, counted and said. Written are time (when known), the desired displacement and the drive.

    Example: dbo compensate model.json trajectory.csv --max-slew 2000 -o drive.csv
    """
    from dbo_cli.runs.drive_files import compensate_trajectory
    from dbo_cli.runs.files import Destination

    remarks = compensate_trajectory(
        model,
        trajectory,
        Destination(
            output,
            save_state,
            [model, trajectory, state, *(tracked or ())],
            flush,
            shlex.join(["dbo", *typed]),
        ),
        reading,
        column=displacement,
        v_min=v_min,
        v_max=v_max,
        max_slew=max_slew,
        refuse_clipping=on_limit == "error",
        state=state,
        condition=condition,
        bandwidth=bandwidth,
        tracked=tracked or (),
        periodic=periodic,
        passes=passes,
        voltage=voltage,
        measured=measured,
        listener=Progress(voice, "written"),
    )
    voice.remarks(remarks)
