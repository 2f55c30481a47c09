"""Make a move within what models can follow, and write it."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli.drives.gate import Floats
from dbo_cli.drives.model_run import FAST_PART, FASTER
from dbo_cli.drives.options import DriveOptions, Figure
from dbo_cli.errors import Remarks, UsageError, suffix_of
from dbo_cli.extras.moves.shapes import TrajectoryOptions, move
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.hysteresis.model_state import DriveLimits
from dbo_cli.hysteresis.move_error import trusted_frequency
from dbo_cli.logs.columns import header_of
from dbo_cli.logs.request import check_format
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_writer import signal_writer
from dbo_cli.logs.whole_output import all_or_none
from dbo_cli.runs.api import Model, require_known
from dbo_cli.runs.files import Destination, shown_name, summary_of_values, write_summary

if TYPE_CHECKING:
    import os

    import pandas

REACH_SLACK = 1e-9  # of the range: rounding reaches no further
AT_REST = 1e12  # s: creep of any model has died away
ONE_AXIS, TWO_AXES = ("displacement",), ("x", "y")


@dataclass(frozen=True)
class Trajectory:
    """A move with its clock: seconds, a signal by the name of each axis, their unit, and notes on it."""

    time: Floats
    axes: dict[str, Floats]
    unit: str | None
    notes: list[str]


def make_trajectory(
    options: TrajectoryOptions,
    models: Sequence[tuple[str, ActuatorModel]] = (),
    unit: str | None = None,
    drive: DriveOptions | None = None,
) -> Trajectory:
    """Return a move, its corners rounded to what the models can be trusted to.

    Parameters
    ----------
    options
        What is asked for; ``bandwidth`` goes before what the models say of themselves.
    models
        Name and forward model of each axis, the last one also for the axes after it;
        none, and neither reach nor speed is checked.
    unit
        What the figures are in; the models' unit where not given.
    drive
        Limits of the drives (``v_min``, ``v_max``, ``extrapolate``), within which the
        move has to be reached.

    Raises
    ------
    UsageError
        The move is faster than its bandwidth, leaves what a model reaches within the
        limits, or has neither unit nor model.
    """
    for name, model in models:
        model.require("forward", name)
        if model.output.unit != (unit or models[0][1].output.unit):
            raise UsageError(
                f"`unit`: {name} is in {model.output.unit or 'no unit'}: give that"
            )
    drive = drive or DriveOptions()
    _require_limits(models, drive)
    unit = unit or (models[0][1].output.unit if models else None)
    if unit is None and not models:
        raise UsageError(
            "`unit` UNIT: say what the figures are in (um, nm, mrad), or give `model`"
        )
    options, notes = _trusted(options, [model for _, model in models])
    made = move(options)
    names = ONE_AXIS if len(made.axes) == 1 else TWO_AXES
    axes = dict(zip(names, made.axes, strict=True))
    if len(models) > len(axes):
        raise UsageError(
            f"`model`: {len(models)} of them, and a {options.shape} has {len(axes)} (one an axis)"
        )
    if models:
        for number, (axis, values) in enumerate(axes.items()):
            name, model = models[min(number, len(models) - 1)]
            _require_reach(axis, values, name, model, drive.limits(model))
            notes += _speed(axis, values * options.rate, name, model)
    rows = made.axes[0].size
    size = f"{rows:,} rows, {rows / options.rate:.6g} s"
    ranges = []
    for axis, values in axes.items():
        ends = f"{values.min():.6g} to {values.max():.6g}"
        ranges.append(f"{axis} {ends}{suffix_of(unit)}")
    first_note = f"{', '.join(ranges)}; {size}"
    remarks = [f"{options.shape}: {note}" for note in [first_note, *made.notes, *notes]]
    return Trajectory(np.arange(rows) / options.rate, axes, unit, remarks)


def _trusted(
    options: TrajectoryOptions, models: Sequence[ActuatorModel]
) -> tuple[TrajectoryOptions, list[str]]:
    """Return options with the bandwidth of the models, where none is given, and a note on it."""
    if options.bandwidth is not None:
        return options, []
    known = []
    for model in models:
        frequency = trusted_frequency(model)
        if frequency is not None:
            known.append(frequency)
    trusted = min(known, default=None)
    why = "the model does not know how fast it can be trusted: " if models else ""
    note = f"{why}corners are not rounded (`bandwidth` HZ)"
    if trusted is not None:
        note = f"turns and steps take {1e3 / trusted:.4g} ms: the model can be trusted to {trusted:.4g} Hz"
    cornered = options.shape not in ("sine", "spiral")
    return dataclasses.replace(options, bandwidth=trusted), [note] if cornered else []


def _require_limits(
    models: Sequence[tuple[str, ActuatorModel]], drive: DriveOptions
) -> None:
    """Refuse limits without a model, and plain numbers where the models' drives have different units."""
    if models:
        drive.require_one_unit({name: model.input.unit for name, model in models})
    elif drive != DriveOptions():
        raise UsageError(
            "`v_min`, `v_max` and `extrapolate` are limits of a drive: give its `model`"
        )


def _require_reach(
    axis: str, values: Floats, name: str, model: ActuatorModel, limits: DriveLimits
) -> None:
    low, high = _reach(model, limits)
    suffix, slack = model.output.suffix, REACH_SLACK * model.output.span
    if values.min() < low - slack or values.max() > high + slack:
        raise UsageError(
            f"{axis} goes from {values.min():.6g} to {values.max():.6g}{suffix}, turns included, and "
            f"{name} reaches {low:.6g} to {high:.6g} (another `range`, a lower `frequency` or less "
            "`overscan`)"
        )


def _reach(model: ActuatorModel, limits: DriveLimits) -> tuple[float, float]:
    """Return the least and the greatest displacement that a slow drive within the limits leads to."""
    if (limits.v_min, limits.v_max) == (model.input.minimum, model.input.maximum):
        return model.output.minimum, model.output.maximum
    slow = model.without_lag
    ends = [limits.v_max, limits.v_min]
    reached = slow.simulate(
        ends, slow.start(limits.v_max, "empty"), time_step=AT_REST
    ).y
    return float(reached.min()), float(reached.max())


def _speed(axis: str, values: Floats, name: str, model: ActuatorModel) -> list[str]:
    """Say where a move (``values`` times rows a second) is faster than what a model has seen."""
    fastest = model.fit.get("fastest_drive")
    if not isinstance(fastest, float) or model.dynamics is not None:
        return []
    speed = (
        float(np.quantile(np.abs(np.diff(values)), 1.0 - FAST_PART))
        * model.input.span
        / model.output.span
    )
    if speed <= FASTER * fastest:
        return []
    return [
        f"{axis} needs a drive of some {speed:.3g} {model.input.unit or 'V'}/s; the logs of {name} show at "
        f"most {fastest:.3g}, so how late the actuator is at that speed is a guess (up to "
        f"{FASTER * fastest / speed:.2g} times the speed it is known)"
    ]


def write_trajectory(
    destination: Destination,
    options: TrajectoryOptions,
    models: Sequence[str],
    unit: str | None,
    form: str | None,
    drive: DriveOptions | None = None,
) -> list[str]:
    """Write a move, one column an axis, and what was done; return what is to be said of it, and what next."""
    output, summary = destination.output, destination.summary
    check_format(form, [output])
    destination.check()
    made = make_trajectory(
        options, [(shown_name(path), read_model(path)) for path in models], unit, drive
    )
    columns = [
        Column("time", "s"),
        *(Column(name, made.unit) for name in made.axes),
    ]
    with all_or_none():
        with signal_writer(
            output.or_format(form),
            columns,
            attributes=lambda: {"sample_rate": options.rate},
        ) as writer:
            writer.write(made.time, *made.axes.values())
        if summary is not None:
            behind = (destination.command, None, Remarks(made.notes))
            write_summary(
                summary,
                [summary_of_values(axis, *behind) for axis in made.axes.values()],
            )
    if output.is_stream:
        return made.notes
    words = ["dbo", "compensate", *(models[:1] or ["MODEL"]), output.text]
    then = shlex.join(words)
    two_axes = len(made.axes) > 1
    if two_axes:
        then += f" `displacement` {shlex.quote(header_of(columns[1]))}"
    if options.loop:
        then += " `periodic`"
    then += " -o drive.csv makes the drive"
    if two_axes:
        then += f", {header_of(columns[2])} that of the second axis"
    return [*made.notes, then]


def trajectory(
    shape: str,
    *,
    model: Model
    | str
    | os.PathLike[str]
    | Sequence[Model | str | os.PathLike[str]] = (),
    unit: str | None = None,
    v_min: Figure = None,
    v_max: Figure = None,
    extrapolate: bool = False,
    **options: Any,
) -> pandas.DataFrame:
    """Return a move as a table: ``time``, and ``displacement`` or ``x`` and ``y``.

    Parameters
    ----------
    shape : {"raster", "spiral", "staircase", "sine", "triangle"}
        What is moved along.
    model : Model or file, or one for each axis
        Corners are rounded to what it can be trusted to; what it does not reach is
        refused.
    unit : str, optional
        What the figures are in; the model's unit where not given.
    v_min, v_max, extrapolate
        Limits of the drive, as in ``Model.compensate``: what it does not reach within
        them is refused.
    **options
        What ``TrajectoryOptions`` knows: ``rate``, ``range``, ``slow_range``,
        ``frequency``, ``lines``, ``pixels``, ``overscan``, ``one_way``, ``turns``,
        ``steps``, ``dwell``, ``cycles``, ``rest``, ``loop``, ``bandwidth``.

    Returns
    -------
    DataFrame
        ``attrs``: ``units`` (by column), ``sample_rate`` (Hz), ``notes``.

    Raises
    ------
    UsageError
        An option is missing or senseless, or the model cannot follow.
    """
    import pandas as pd

    require_known(TrajectoryOptions, options, "is no parameter of trajectory")
    for name in ("rate", "range"):
        if name not in options:
            raise UsageError(f"a {shape} needs `{name}`")
    if isinstance(model, Model | str) or hasattr(model, "__fspath__"):
        model = [model]
    models = [_named_model(source) for source in model]
    drive = DriveOptions(v_min=v_min, v_max=v_max, extrapolate=extrapolate)
    made = make_trajectory(TrajectoryOptions(shape, **options), models, unit, drive)
    frame = pd.DataFrame({"time": made.time, **made.axes})
    frame.attrs |= {
        "units": {"time": "s"} | dict.fromkeys(made.axes, made.unit),
        "sample_rate": options["rate"],
        "notes": list(made.notes),
    }
    return frame


def _named_model(source: Any) -> tuple[str, ActuatorModel]:
    if isinstance(source, Model):
        return "the model", source.actuator
    return str(source), read_model(str(source))
