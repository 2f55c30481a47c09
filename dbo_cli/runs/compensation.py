"""Compensation: the drive that makes an actuator follow a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.initial_states import StartName
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_state import DriveLimits, ModelState
from dbo_cli.runs.compensation_run import Compensation
from dbo_cli.runs.remarks import Remarks
from dbo_cli.runs.source import Source

if TYPE_CHECKING:
    from dbo_cli.runs.learning import Tracked


def compensation(
    model: ActuatorModel,
    source: Source,
    *,
    v_min: float | None = None,
    v_max: float | None = None,
    max_slew: float | None = None,
    refuse_clipping: bool = False,
    start: StartName | ModelState = "auto",
    condition: bool = False,
    last_row: int | None = None,
    bandwidth: float | None = None,
    tracked: Sequence[Tracked] = (),
    periodic: bool = False,
    passes: int = 0,
) -> Compensation:
    """Return the run of a forward model's inverse over a trajectory.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    v_min, v_max, max_slew
        What the drive may do, in the unit of the model's input (and per second); the model's range where
        not given.
    refuse_clipping, start, last_row
        See ``ModelRun``.
    condition
        Sweep the actuator into a known state first.
    bandwidth
        Cut-off (Hz) of a zero-phase low-pass that rounds the trajectory's corners first; with ``tracked``
        that of what is learned.
    tracked
        Recordings of the last pass of this trajectory, to learn from.
    periodic
        The trajectory is one period of a loop; the drive is that of the settled loop.
    passes
        With ``periodic``, so many passes of run-in stand before it, in negative time.

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
    check_bandwidth(bandwidth)
    if condition and start != "auto":
        named = start if isinstance(start, str) else "a state"
        raise UsageError(f"`condition` and `state` {named} exclude each other: the sweep makes its own state")
    drive = model.input
    low = drive.minimum if v_min is None else v_min
    high = drive.maximum if v_max is None else v_max
    check_range(low, high)
    _check_loop(periodic, passes, condition)
    why = "`max_slew` depends on it" if max_slew is not None else None
    for asked, name in ((condition, "condition"), (periodic, "periodic"), (bool(tracked), "tracked")):
        why = why or (f"`{name}` depends on it" if asked else None)
    limits = DriveLimits(low, high, max_slew)
    told, desired = Remarks(), None
    if tracked:
        from dbo_cli.runs.learning import learned_source

        source, desired, lesson = learned_source(model, source, tracked, start, bandwidth, periodic)
        told.note(lesson.notes)
        bandwidth = None
    given: dict[str, Any] = {
        "start": start,
        "limits": limits,
        "refuse_clipping": refuse_clipping,
        "last_row": last_row,
        "why_time": why,
        "bandwidth": bandwidth,
        "condition": condition,
        "desired": desired,
        "remarks_before": told,
    }
    if periodic:
        from dbo_cli.runs.periodic import LoopCompensation

        return LoopCompensation(model, source, **given, passes=passes)
    return Compensation(model, source, **given)


def _check_loop(periodic: bool, passes: int, condition: bool) -> None:
    if passes and not periodic:
        raise UsageError("`passes` is the run-in of a loop (`periodic`)")
    if passes < 0:
        raise UsageError(f"`passes` {passes}: give a whole number of passes")
    if periodic and condition:
        raise UsageError("`periodic` and `condition` exclude each other (`passes` N runs a loop in)")


def check_range(v_min: float | None, v_max: float | None) -> None:
    """Refuse limits that leave nothing between them (UsageError)."""
    if v_min is not None and v_max is not None and v_min >= v_max:
        raise UsageError(f"`v_min` {v_min:g} must be below `v_max` {v_max:g}")


def check_bandwidth(bandwidth: float | None) -> None:
    """Refuse a cut-off that is none (UsageError)."""
    if bandwidth is not None and not 0.0 < bandwidth < float("inf"):
        raise UsageError(f"`bandwidth` {bandwidth:g}: give a positive number of Hz")
