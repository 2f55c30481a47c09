"""The public library: pandas objects and arrays in, arrays and models out.

The work is done by the rooms; here a frame becomes arrays, with its units and its
time, and back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli import model as room
from dbo_cli.errors import InputError, UsageError, warn

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from dbo_cli.drive import Drive
    from dbo_cli.drive.live import Controller
    from dbo_cli.identification import Recording
    from dbo_cli.reports import Report

Floats = NDArray[np.float64]
Clock = tuple["Floats | None", "float | None"]  # time in s, or seconds a sample
SLOWEST = 100.0
"""A clock this many times slower than the model's own logs is taken for another unit."""


class Model:
    """A model of an actuator.

    Parameters
    ----------
    actuator : dbo_cli.model.Model
        The cascade of stages that computes.

    Attributes
    ----------
    direction, input, output, stages, fit, sign
        Of the actuator: what goes in and comes out (quantity, unit, range), the stages,
        and the figures of its identification.
    """

    def __init__(self, actuator: room.Model) -> None:
        self.actuator = actuator

    def __getattr__(self, name: str) -> Any:
        """Return what the actuator has under a public name."""
        if name in (
            "direction",
            "input",
            "output",
            "stages",
            "fit",
            "sign",
            "provenance",
            "digest",
        ):
            return getattr(self.actuator, name)
        raise AttributeError(f"a dbo Model has no attribute {name!r}")

    def __eq__(self, other: object) -> bool:
        """Return whether two models are the same file."""
        return isinstance(other, Model) and self.actuator == other.actuator

    __hash__ = None  # type: ignore[assignment]

    def save(self, path: str | Path) -> None:
        """Write the model file, whole or not at all."""
        from dbo_cli.logs import write_text

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
        seconds, step = clock_of(x, time, sample_rate, len(values))
        begun = self._state(state)
        dt = steps(seconds, step)
        if (
            isinstance(begun, room.State)
            and begun.time is not None
            and seconds is not None
        ):
            dt = np.diff(seconds, prepend=begun.time)
        y, after = self.actuator.simulate(values, dt=dt, state=begun, outside=outside)
        if not return_state:
            return y
        last = None if seconds is None else float(seconds[-1])
        return y, dataclasses.replace(after, time=last)

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
        from_: float | None = None,
        return_: float | None = None,
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
        from_, return_ : float, optional
            Where the amplifier stands before the move, and where it goes after it.
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
        from dbo_cli.drive import Limits, plan

        self.actuator.require("forward")
        values = floats(wanted, "wanted")
        seconds, step = clock_of(wanted, time, sample_rate, len(values))
        self._require_likely(seconds, step)
        limits = Limits.within(self.input, v_min, v_max, max_slew, extrapolate)
        drive: Drive = plan(
            self.actuator,
            values,
            seconds if step is None else step,
            limits,
            start=from_,
            return_to=return_,
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
        from dbo_cli.logs import write_text

        write_text(str(path), room.dumps_state(state, self.actuator))

    def _state(self, state: str | room.State | Path) -> Any:
        """Return a state, or the name of a start."""
        if isinstance(state, room.State) or state in (
            "auto",
            "empty",
            "full",
            "settled",
        ):
            return state
        return room.read_state(str(state), self.actuator)

    def _require_likely(self, seconds: Floats | None, step: float | None) -> None:
        """Warn where a clock is so slow that another unit is likely."""
        if seconds is not None and len(seconds) > 1:
            step = float(np.median(np.diff(seconds)))
        usual = self.fit.get("sample_period")
        if step is None or not isinstance(usual, float):
            return
        if step > SLOWEST * usual:
            warn(
                f"`time`: a sample every {step:g} s, but the model's logs have one every {usual:g} s;"
                " time is taken in s, not in ms"
            )


class ModelSet(Mapping[str, Model]):
    """Models by the name of their channel."""

    def __init__(self, models: Mapping[str, Model]) -> None:
        self._models = dict(models)

    def __getitem__(self, name: str) -> Model:
        """Return the model of a channel."""
        return self._models[name]

    def __iter__(self) -> Iterator[str]:
        """Go through the names of the channels."""
        return iter(self._models)

    def __len__(self) -> int:
        """Return how many channels there are."""
        return len(self._models)

    def save(self, path: str | Path) -> None:
        """Write all models into one file."""
        from dbo_cli.logs import write_text

        write_text(
            str(path),
            room.dumps_set({name: one.actuator for name, one in self._models.items()}),
        )


def read_model(path: str | Path) -> Any:
    """Read a model file, ``FILE::NAME`` of a set, or a whole set.

    Raises
    ------
    ModelError
        The file is no model of version 1; the message names the key.
    """
    name = str(path)
    if "::" not in name and room.is_set(name):
        return ModelSet(
            {key: Model(one) for key, one in room.read_models(name).items()}
        )
    return Model(room.read_model(name))


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
        skip_lines, encoding``.

    Returns
    -------
    DataFrame
        The columns ``time`` (s), ``voltage``, ``displacement``, as far as there are
        any; ``attrs["units"]`` holds their units, ``attrs["notes"]`` what is odd.

    Raises
    ------
    InputError
        The log cannot be read, or it is not clear which column is which.
    """
    import pandas as pd

    from dbo_cli.logs import Reading, open_log

    typed = {"time": time, "voltage": voltage, "displacement": displacement}
    roles = {role: None if name is None else str(name) for role, name in typed.items()}
    absent = tuple(role for role, name in roles.items() if name is None)
    with open_log(str(path), roles, Reading(**reading), None, absent) as log:
        found = [role for role in ("voltage", "displacement") if log.provided(role)]
        if not found:
            raise InputError(
                f"{path}: no column is known as voltage or displacement (`voltage` NAME)"
            )
        table = log.read()
        columns: dict[str, Floats] = {} if table.time is None else {"time": table.time}
        units: dict[str, str | None] = {} if table.time is None else {"time": "s"}
        for role in found:
            columns[role] = table[role]
            units[role] = log.columns[role].unit
        notes = list(log.remarks)
    frame = pd.DataFrame(columns)
    frame.attrs.update(name=str(path), units=units, notes=notes)
    return frame


def recording_of(data: Any, options: Mapping[str, Any]) -> Recording:
    """Return a frame, a file or a pair of arrays as a recording."""
    from dbo_cli.identification import Recording

    if isinstance(data, (str, Path)):
        columns = {role: options.get(role) for role in ("voltage", "displacement")}
        data = read_log(data, **columns)
    if isinstance(data, tuple):
        v, x, *rest = data
        return _of_arrays(v, x, rest[0] if rest else options.get("time"), options)
    frame, units = columns_by_role(data)
    seconds, step = clock_of(
        frame, frame.get("time"), options.get("sample_rate"), len(frame)
    )
    if seconds is None and step is not None:
        seconds = np.arange(len(frame), dtype=np.float64) * step
    return Recording(
        name=str(data.attrs.get("name", "the frame")),
        voltage=floats(frame["voltage"], "voltage"),
        displacement=floats(frame["displacement"], "displacement"),
        time=seconds,
        input=_quantity("voltage", units.get("voltage")),
        output=_quantity("displacement", units.get("displacement")),
    )


def _of_arrays(v: Any, x: Any, time: Any, options: Mapping[str, Any]) -> Recording:
    """Return two arrays as a recording."""
    from dbo_cli.identification import Recording

    voltage, displacement = floats(v, "voltage"), floats(x, "displacement")
    seconds, step = clock_of(v, time, options.get("sample_rate"), len(voltage))
    if seconds is None and step is not None:
        seconds = np.arange(len(voltage), dtype=np.float64) * step
    return Recording(
        name="the arrays",
        voltage=voltage,
        displacement=displacement,
        time=seconds,
        input=_quantity("voltage", options.get("voltage_unit", "V")),
        output=_quantity("displacement", options.get("displacement_unit", "um")),
    )


def _quantity(role: str, unit: str | None) -> tuple[str, Any]:
    """Return the name and the unit of a signal."""
    from dbo_cli.units import quantity_name

    return quantity_name(role, unit), unit


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
        return frame, dict(
            frame.attrs.get("units", {"voltage": "V", "displacement": "um"})
        )
    found = columns_of_names(
        [str(name) for name in frame.columns],
        dict.fromkeys(("time", "voltage", "displacement")),
    )
    names = {frame.columns[column.number - 1]: role for role, column in found.items()}
    units = {role: column.unit for role, column in found.items()}
    return frame.rename(columns=names), units


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
    displacement : array_like, or str
        With an array of voltages, the displacement; with files the name of its column.
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

    about: dict[str, Any] = {
        "sample_rate": sample_rate,
        "voltage_unit": voltage_unit,
        "displacement_unit": displacement_unit,
        "time": time,
    }
    if displacement is not None and not isinstance(displacement, str):
        recordings = [_of_arrays(data, displacement, time, about)]
    else:
        about["displacement"] = displacement
        recordings = [recording_of(one, about) for one in _listed(data)]
    others = (
        []
        if validate is None
        else [recording_of(one, about) for one in _listed(validate)]
    )
    shape = None
    if isinstance(prior, Model):
        shape = prior.actuator
    elif prior is not None:
        shape = read_model(prior).actuator
    return Model(fit(recordings, Options(prior=shape, **options), others))


def _listed(data: Any) -> Sequence[Any]:
    """Return one thing as a list of it."""
    return data if isinstance(data, list) else [data]


def report(
    desired: Any, measured: Any = None, time: Any = None, **options: Any
) -> Report:
    """Report how well a measured displacement follows a wanted one.

    Parameters
    ----------
    desired, measured : array_like
        Both displacements in one unit; with ``model=`` the first is the drive.
    time
        Time in s; the time index of a Series counts.
    **options
        ``sample_rate, model, state, rows, lag, remove_offset, unit, name, expected,
        max_rmse, max_nrmse_percent``.

    Returns
    -------
    Report
        With ``rmse``, ``to_frame()``, ``to_html()``, ``figures(folder)``.
    """
    from dbo_cli.reports import report as compared

    values = floats(desired, "desired")
    seconds, step = clock_of(
        desired, time, options.pop("sample_rate", None), len(values)
    )
    rate = None if step is None else 1.0 / step
    return compared(
        values, floats(measured, "measured"), seconds, sample_rate=rate, **options
    )


# --- arrays ---


def floats(values: Any, name: str) -> Floats:
    """Return a one-dimensional array of finite numbers.

    Raises
    ------
    InputError
        It is of another shape, or holds what is no number.
    """
    try:
        array = np.ascontiguousarray(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError(f"`{name}`: not an array of numbers") from None
    if array.ndim != 1 or array.size == 0:
        raise InputError(
            f"`{name}`: has the shape {array.shape}; a single row of numbers is needed"
        )
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InputError(f"`{name}`[{bad[0]}]: {array[bad[0]]} is not a finite number")
    return array


def clock_of(data: Any, time: Any, sample_rate: float | None, rows: int) -> Clock:
    """Return the time of samples in s, or the seconds between them.

    The time index of a pandas object counts where neither is given: seconds if it
    holds numbers other than a plain count, else durations or dates.

    Raises
    ------
    UsageError
        Both are given, or the rate is not above 0.
    InputError
        The time has another length, or does not increase.
    """
    if time is not None and sample_rate is not None:
        raise UsageError("`time` and `sample_rate` are both given: give one of them")
    if sample_rate is not None:
        if not sample_rate > 0.0:
            raise UsageError(f"`sample_rate`: {sample_rate!r} is not above 0")
        return None, 1.0 / sample_rate
    seconds = _index_seconds(data) if time is None else _seconds(time)
    if seconds is None:
        return None, None
    if len(seconds) != rows:
        raise InputError(f"`time`: {len(seconds)} times for {rows} samples")
    back = np.flatnonzero(np.diff(seconds) < 0.0)
    if back.size:
        raise InputError(
            f"`time`[{back[0] + 1}]: {seconds[back[0] + 1]!r} s goes backwards"
        )
    return seconds, None


def steps(seconds: Floats | None, step: float | None) -> float | Floats | None:
    """Return what a model takes as dt."""
    return step if seconds is None else room.steps_of(seconds)


def _index_seconds(data: Any) -> Floats | None:
    """Return the time index of a pandas object in s; None where it has none."""
    index = getattr(data, "index", None)
    if index is None or callable(index):
        return None
    import pandas as pd

    if isinstance(index, pd.RangeIndex) or index.dtype.kind in "iuObOUT":
        return None
    if isinstance(index, pd.Index) and index.dtype == object:
        return None
    return _seconds(index)


def _seconds(time: Any) -> Floats:
    """Return times as seconds; dates count from the first."""
    import pandas as pd

    values = np.asarray(time)
    if values.dtype.kind == "M" or isinstance(time, pd.DatetimeIndex):
        stamps = pd.to_datetime(pd.Series(time))
        return np.ascontiguousarray(
            (stamps - stamps.iloc[0]).dt.total_seconds(), dtype=np.float64
        )
    if values.dtype.kind == "m":
        return np.ascontiguousarray(
            pd.Series(time).dt.total_seconds(), dtype=np.float64
        )
    return floats(values, "time")
