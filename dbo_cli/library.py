"""The public library: pandas objects and arrays in, arrays and models out.

The work is done by the rooms; here a frame becomes arrays, with its units and its
time, and back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dbo_cli import model as room
from dbo_cli.arrays import Floats
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model.state import START_NAMES

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from dbo_cli.drive import Drive
    from dbo_cli.drive.live import Controller
    from dbo_cli.identification import Recording
    from dbo_cli.reports import Report

Clock = float | Floats | None
"""Seconds a sample, or the time of each sample (s)."""
SHOWN = "direction input output stages fit sign provenance digest"
"""What a model shows of its actuator."""


class Model:
    """A model of an actuator.

    Parameters
    ----------
    actuator : dbo_cli.model.Cascade
        The cascade of stages that computes.

    Attributes
    ----------
    direction, input, output, stages, fit, sign, provenance, digest
        Of the actuator: what goes in and comes out (quantity, unit, range), the stages,
        and the figures of its identification.
    """

    def __init__(self, actuator: room.Cascade) -> None:
        self.actuator = actuator

    def __getattr__(self, name: str) -> Any:
        """Return what the actuator has under a public name."""
        if name in SHOWN.split():
            return getattr(self.actuator, name)
        raise AttributeError(f"a dbo Model has no attribute {name!r}")

    def __eq__(self, other: object) -> bool:
        """Return whether two models have the same direction and stages."""
        if not isinstance(other, Model) or self.direction != other.direction:
            return False
        return bool(self.digest == other.digest)

    __hash__ = None  # type: ignore[assignment]

    def save(self, path: str | Path) -> None:
        """Write the model file, whole or not at all."""
        from dbo_cli.files import write_text

        write_text(str(path), room.dumps_model(self.actuator))

    def inverse(self) -> Model:
        """Return the exact inverse model."""
        return Model(self.actuator.inverse())

    def simulate(
        self,
        x: Any,
        time: Any = None,
        *,
        sample_rate: float | None = None,
        state: str | room.State = "auto",
        outside: Any = "extend",
        return_state: bool = False,
    ) -> Any:
        """Return the model's output.

        Parameters
        ----------
        x : array_like
            The input, in the unit of ``input``. The time index of a Series counts as
            its time.
        time, sample_rate
            Time in s, or a rate in Hz; needed where the model depends on time.
        state : str or State
            ``auto``, ``empty``, ``full``, ``settled``, a state that was returned, or
            the name of a state file.
        outside : {"extend", "hold", "error"}
            What happens beyond the model's input range.
        return_state : bool
            Also return the state after the last sample.

        Returns
        -------
        ndarray, or (ndarray, State)
        """
        values = floats(x, "x")
        dt = clock = clock_of(x, time, sample_rate, len(values))
        begun, last = self._state(state), None
        if isinstance(clock, np.ndarray):
            dt, last = room.steps_of(clock), float(clock[-1])
            if isinstance(begun, room.State):
                dt = room.steps_behind(begun.time, clock, dt)
        y, after = self.actuator.simulate(values, dt=dt, state=begun, outside=outside)
        if return_state:
            return y, dataclasses.replace(after, time=last)
        return y

    def compensate(
        self,
        wanted: Any,
        time: Any = None,
        *,
        sample_rate: float | None = None,
        v_min: float | str | None = None,
        v_max: float | str | None = None,
        max_slew: float | str | None = None,
        extrapolate: bool = False,
        from_: float | str | None = None,
        return_: float | str | None = None,
        state: str | room.State = "auto",
        details: bool = False,
        **options: Any,
    ) -> Any:
        """Return the drive that makes the actuator follow a displacement.

        Parameters
        ----------
        wanted : array_like
            The displacement, in the unit of ``output``. The time index of a Series
            counts as its time.
        time, sample_rate
            Time in s, or a rate in Hz.
        v_min, v_max, max_slew, extrapolate
            Limits, as numbers in the drive's unit or as text (``"2V/ms"``).
        from_, return_ : float or str, optional
            Where the amplifier stands before the move, and where it goes after it; as
            limits are.
        state : str or State
            What was before the first sample.
        details : bool
            Return a ``Drive``: times, drive, clipped rows, expected error, state.
        **options
            ``on_limit, approach, condition, lead, bandwidth, periodic, passes``.

        Returns
        -------
        ndarray, or Drive

        Raises
        ------
        LimitError
            A start outside the limits, or a move that they do not allow.
        """
        from dbo_cli.drive import Limits, plan, voltage_in

        self.actuator.require("forward")
        values = floats(wanted, "wanted")
        clock = clock_of(wanted, time, sample_rate, len(values))
        limits = Limits.within(self.input, v_min, v_max, max_slew, extrapolate)
        start = None if from_ is None else voltage_in("from", from_, self.input)
        end = None if return_ is None else voltage_in("return", return_, self.input)
        drive: Drive = plan(
            self.actuator,
            values,
            clock,
            limits,
            start=start,
            return_to=end,
            state=self._state(state),
            **options,
        )
        return drive if details else drive.voltage

    def controller(self, sample_rate: float, **options: Any) -> Controller:
        """Return a live controller: one sample at a time; see ``Controller``."""
        from dbo_cli.drive.live import Controller

        return Controller(self.actuator, sample_rate, **options)

    def plot(self) -> Figure:
        """Return a figure of the model's loop, with units."""
        from dbo_cli.reports.plots import plot_model

        return plot_model(self.actuator)

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        from dbo_cli.reports.plots import draw, model_plots

        picture = draw(model_plots(self.actuator)[0], "inline").decode()
        return f"<p>{self!r}</p>{picture}"

    def __repr__(self) -> str:
        """Return the model in one line."""
        into, out = self.input, self.output
        return (
            f"<dbo Model, {self.direction}: {into.quantity} {into.min:g} to {into.max:g}{into.suffix}"
            f" to {out.quantity} {out.min:g} to {out.max:g}{out.suffix}, {self.actuator.gears.n} gears>"
        )

    def save_state(self, state: room.State, path: str | Path) -> None:
        """Write a state file."""
        from dbo_cli.files import write_text

        write_text(str(path), room.dumps_state(state, self.actuator))

    def _state(self, state: str | room.State | Path) -> Any:
        """Return a state, or the name of a start."""
        if isinstance(state, room.State) or state in START_NAMES:
            return state
        return room.read_state(str(state), self.actuator)


class ModelSet(dict[str, Model]):
    """Models by the name of their channel."""

    def save(self, path: str | Path) -> None:
        """Write all models into one file."""
        from dbo_cli.files import write_text

        actuators = {name: model.actuator for name, model in self.items()}
        write_text(str(path), room.dumps_set(actuators))


def read_model(path: str | Path) -> Any:
    """Read a model file, ``FILE::NAME`` of a set, or a whole set.

    Raises
    ------
    ModelError
        The file is no model of version 1; the message names the key.
    """
    name = str(path)
    if "::" in name or not room.is_set(name):
        return Model(room.read_model(name))
    models = room.read_models(name)
    return ModelSet({key: Model(actuator) for key, actuator in models.items()})


# --- logs ---


def read_log(
    path: str | Path,
    *,
    time: str | int | None = None,
    voltage: str | int | None = None,
    displacement: str | int | None = None,
    **reading: Any,
) -> pd.DataFrame:
    """Read a log into a DataFrame.

    Parameters
    ----------
    path
        Any log that the commands read.
    time, voltage, displacement
        Names or numbers of the columns; found by name and unit where not given.
    **reading
        ``sample_rate, time_unit, scale, rows, skip_bad, resample, delimiter, decimal,
        skip_lines, encoding, clock_offset``; a column of a second file is
        ``FILE::COLUMN``.

    Returns
    -------
    DataFrame
        The columns ``time`` (s), ``voltage``, ``displacement``, as far as there are
        any; ``attrs["units"]`` holds their units, ``attrs["notes"]`` what is odd, and
        ``attrs["holds_delay"]`` whether the actuator's delay is in a clock offset that was
        found.

    Raises
    ------
    InputError
        The log cannot be read, or it is not clear which column is which.
    """
    import pandas as pd

    from dbo_cli.logs import Reading, open_log

    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    roles = {
        role: None if name is None else str(name) for role, name in columns.items()
    }
    absent = tuple(role for role, name in roles.items() if name is None)
    with open_log(str(path), roles, Reading(**reading), None, absent) as log:
        known = [role for role in ("voltage", "displacement") if log.provided(role)]
        if not known:
            raise InputError(
                f"{path}: no column is named voltage or displacement: give `voltage` NAME"
            )
        table = log.read()
    frame = pd.DataFrame()
    units: dict[str, str | None] = {}
    if table.time is not None:
        frame["time"], units["time"] = table.time, "s"
    for role in known:
        frame[role], units[role] = table[role], log.columns[role].unit
    frame.attrs.update(name=str(path), units=units, notes=list(log.remarks))
    frame.attrs["holds_delay"] = log.has_found_offset
    return frame


def identify(
    data: Any,
    displacement: Any = None,
    *,
    time: Any = None,
    sample_rate: float | None = None,
    voltage_unit: str | None = "V",
    displacement_unit: str | None = "um",
    validate: Any = None,
    prior: Model | str | Path | None = None,
    **options: Any,
) -> Model:
    """Identify a model of an actuator.

    Parameters
    ----------
    data
        A frame, a file's name, an array of voltages, or a list of frames or files of
        one actuator.
    displacement : array_like
        With an array of voltages, the displacement.
    time, sample_rate
        Time in s, or a rate in Hz. A time index of a frame counts as its time.
    voltage_unit, displacement_unit : str
        Units of arrays.
    validate
        Logs that say how well the model predicts.
    prior : Model or file
        Keep its shape; find gain, offset and delay again.
    **options
        As of the command: ``sign, skip, zero, sensor_delay, gears, points, relaxation,
        delay, dynamics, slopes, method, force``.

    Returns
    -------
    Model

    Raises
    ------
    FitError
        No trustworthy model can be identified.
    """
    from dbo_cli.identification import Options
    from dbo_cli.identification import identify as fit

    if displacement is None:
        recordings = _recordings(data, time, sample_rate)
        frames = data if isinstance(data, list) else [data]
        holds_delay = any(getattr(f, "attrs", {}).get("holds_delay") for f in frames)
        if holds_delay and options.get("delay", "auto") == "auto":
            options["delay"] = 0.0
    else:
        units = {"voltage": voltage_unit, "displacement": displacement_unit}
        clock = clock_of(data, time, sample_rate, len(data))
        recordings = [_recording("the arrays", data, displacement, clock, units)]
    left_out = [] if validate is None else _recordings(validate, None, sample_rate)
    if isinstance(prior, (str, Path)):
        prior = Model(room.read_model(str(prior)))
    shape = None if prior is None else prior.actuator
    return Model(fit(recordings, Options(prior=shape, **options), left_out))


def _recordings(data: Any, time: Any, sample_rate: float | None) -> list[Recording]:
    """Return a frame, a file, or a list of them as recordings."""
    recordings = []
    for source in data if isinstance(data, list) else [data]:
        frame = read_log(source) if isinstance(source, (str, Path)) else source
        frame, units = columns_by_role(frame)
        stamps = frame.get("time") if time is None and sample_rate is None else time
        clock = clock_of(frame, stamps, sample_rate, len(frame))
        name = str(frame.attrs.get("name", "the frame"))
        columns = frame["voltage"], frame["displacement"]
        recordings.append(_recording(name, *columns, clock, units))
    return recordings


def _recording(
    name: str, v: Any, x: Any, clock: Clock, units: Mapping[str, str | None]
) -> Recording:
    """Return two signals as a recording."""
    from dbo_cli.recordings import recording_of

    voltage = floats(v, "voltage")
    return recording_of(
        name, voltage, floats(x, "displacement"), _times(clock, len(voltage)), units
    )


def columns_by_role(frame: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str | None]]:
    """Return a frame with its columns named by role, and their units.

    A frame of ``read_log`` has both; in others columns are found as in a log.

    Raises
    ------
    InputError
        It is not clear which column is which.
    """
    from dbo_cli.logs import columns_of_names

    if {"voltage", "displacement"} <= set(frame.columns):
        usual = {"voltage": "V", "displacement": "um"}
        return frame, frame.attrs.get("units", usual)
    roles = dict.fromkeys(("time", "voltage", "displacement"))
    columns = columns_of_names([str(name) for name in frame.columns], roles)
    names = {frame.columns[column.number - 1]: role for role, column in columns.items()}
    units = {role: column.unit for role, column in columns.items()}
    return frame.rename(columns=names), units


def report(
    desired: Any,
    measured: Any,
    time: Any = None,
    *,
    sample_rate: float | None = None,
    model: Model | None = None,
    state: str | room.State = "auto",
    rows: tuple[int | None, int | None] | None = None,
    voltage: Any = None,
    expected: Any = None,
    unit: str | None = None,
    name: str = "log",
    **options: Any,
) -> Report:
    """Report how well a measured displacement follows a desired one, or what a model predicts.

    Parameters
    ----------
    desired, measured : array_like
        Both displacements in one unit; with ``model`` the first is the drive.
    time, sample_rate
        Time in s, or a rate in Hz; the time index of a Series counts.
    model, state
        A forward model, and what was before the first row.
    rows : (first, last), optional
        The rows that count, from 1, both ends included.
    voltage : array_like, optional
        The drive, for the figures.
    expected : mapping, optional
        The summary of the drive, ``drive.summary()``: the error that was to be expected.
    unit, name : str
        Of both signals, and of the log.
    **options
        ``lag, remove_offset, max_rmse, max_nrmse_percent``.

    Returns
    -------
    Report
        With ``rmse``, ``to_frame()``, ``to_html()``, ``figures(folder)``.

    Raises
    ------
    InputError
        Lengths differ, or there is nothing to compare.
    """
    from dbo_cli.reports import Pair, Report, expected_of, predict

    values, moved = floats(desired, "desired"), floats(measured, "measured")
    clock = _times(clock_of(desired, time, sample_rate, len(values)), len(values))
    if expected is not None:
        options["expected"] = expected_of(expected, unit)
    if model is None:
        drive = None if voltage is None else floats(voltage, "voltage")
        pair = Pair(name, values, moved, clock, drive, rows)
        return Report.of([pair], unit=unit, **options)
    actuator = model.actuator
    recording = Pair(name, moved, moved, clock, values, rows)
    pair = predict(recording, actuator, model._state(state))
    return Report.of(
        [pair],
        unit=actuator.output.unit,
        voltage_unit=actuator.input.unit,
        labels=("model", "measured"),
        model=actuator,
        **options,
    )


# --- arrays ---


def floats(values: Any, name: str) -> Floats:
    """Return a one-dimensional array of finite numbers.

    Raises
    ------
    InputError
        It has another shape, or holds a value that is not a number.
    """
    try:
        array = np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 1 or array.size == 0:
        raise InputError(f"`{name}`: give one row of numbers, shape (n,)")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InputError(f"`{name}`[{bad[0]}]: {array[bad[0]]} is not a finite number")
    return array


def clock_of(data: Any, time: Any, sample_rate: float | None, rows: int) -> Clock:
    """Return the seconds between samples, or the time of each in s; None where neither is known.

    The time index of a pandas object counts where neither is given: seconds if it
    holds numbers other than a plain count, else durations or dates.

    Raises
    ------
    UsageError
        Both are given, or the rate is not above 0.
    InputError
        The time has another length.
    """
    if time is not None and sample_rate is not None:
        raise UsageError("`time` and `sample_rate` are both given: give one of them")
    if sample_rate is not None:
        if not sample_rate > 0.0:
            raise UsageError(f"`sample_rate`: {sample_rate!r} is not above 0")
        return 1.0 / sample_rate
    if time is None:
        time = getattr(data, "index", None)
        if getattr(getattr(time, "dtype", None), "kind", "O") not in "fmM":
            return None
    seconds = _seconds(time)
    if len(seconds) != rows:
        raise InputError(f"`time`: {len(seconds)} times for {rows} samples")
    return seconds


def _times(clock: Clock, rows: int) -> Floats | None:
    """Return the time of each row (s), of an even clock too."""
    return clock * np.arange(float(rows)) if isinstance(clock, float) else clock


def _seconds(time: Any) -> Floats:
    """Return times as seconds; dates count from the first."""
    kind = getattr(getattr(time, "dtype", None), "kind", "f")
    if kind == "M":
        dates = np.asarray(time, "M8[ns]")
        time = (dates - dates[:1]) / np.timedelta64(1, "s")
    elif kind == "m":
        time = np.asarray(time) / np.timedelta64(1, "s")
    return floats(time, "time")
