"""From a trajectory and what is asked of its drive to the run that makes it."""

from __future__ import annotations

from collections.abc import Sequence

from dbo_cli.drives.compensation import Compensation
from dbo_cli.drives.history import PassRecord, read_history
from dbo_cli.drives.learning import Tracked, learned_source
from dbo_cli.drives.loops import LoopCompensation
from dbo_cli.drives.options import DriveOptions
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs.sources import Source
from dbo_cli.remarks import Remarks


def compensation(
    model: ActuatorModel,
    source: Source,
    options: DriveOptions,
    tracked: Sequence[Tracked] = (),
    last_row: int | None = None,
) -> Compensation:
    """Return the run of a forward model's inverse over a trajectory.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    options
        What is asked of the drive.
    tracked
        Recordings of the last pass of this trajectory, to learn from.
    last_row
        The last row that is answered; rows after it are only read ahead.

    Raises
    ------
    UsageError
        The limits are not in order, or options exclude each other.
    ModelError
        The model is an inverse one.
    InputError
        A recording is not of this trajectory, or the error grew.
    """
    model.require("forward")
    remarks, desired = Remarks(), None
    passes: list[PassRecord] = []
    if options.history is not None and not tracked:
        raise UsageError("`history` keeps the error of the passes that `tracked` recorded: give both")
    if tracked:
        passes = [] if options.history is None else read_history(options.history)
        source, desired, lesson = learned_source(model, source, tracked, options, passes)
        remarks.add(lesson.remarks)
        passes = lesson.passes
    make = LoopCompensation if options.periodic else Compensation
    return make(
        model,
        source,
        last_row=last_row,
        why_time="`tracked` depends on it" if tracked else None,
        options=options,
        desired=desired,
        passes=passes,
        remarks_before=remarks,
    )
