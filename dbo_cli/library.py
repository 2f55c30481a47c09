"""The public library: frames, Series and arrays in, arrays and models out.

The work is done by the rooms; here what a user hands over becomes arrays in the units
of a model, with their time, and back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypedDict, Unpack, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli import model as room
from dbo_cli.arrays import Floats
from dbo_cli.channels import histories_of
from dbo_cli.drive import Drive, Driver, Lead, Limits
from dbo_cli.drive.compensate import OnLimit
from dbo_cli.drive.drive import PassRecord
from dbo_cli.drive.learning import dumps_history
from dbo_cli.drive.live import Controller
from dbo_cli.drive.simulate import Simulator
from dbo_cli.errors import InputError, UsageError, warn
from dbo_cli.files import write_text
from dbo_cli.logs import Reading, is_frame, open_log, parse_rows, table_in_memory
from dbo_cli.recordings import (
    RECORDING_COLUMNS,
    RECORDING_ROLES,
    TRACKED_COLUMNS,
    Units,
    identified,
    options_of,
    pairs_of,
    recordings_of,
    signal_of,
    tracked_of,
    units_of,
)
from dbo_cli.units import Typed, quantity

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from dbo_cli.reports import Report

Signal = ArrayLike
"""An array, a Series of pandas or polars, or one of their frames, which is read as a file is."""
Logs = Signal | Path | Sequence[Signal | Path]
"""A file, a frame, or a list of them."""
StateLike = str | Path | room.State
"""``auto``, ``empty``, ``full``, ``settled``, a state that was returned, or a state file."""


class Fit(TypedDict, total=False):
    """The figures of an identification; lengths in the unit of the model's output.

    ``rmse`` on the logs, ``left_out_rmse`` on parts left out, ``expected_rmse`` on a new
    move whose past is known, ``noise_rms`` of the sensor, which is in none of these two;
    ``scale_rmse`` of a refreshed prior's gain and zero, which is in both;
    ``line_rmse`` of a straight line on the logs, ``left_out_line_rmse`` on parts left
    out; ``unexplained`` share of the displacement within swings. ``fastest`` drive per s,
    ``longest_rest`` and ``longest_swing`` (s) of the logs.
    """

    method: str
    sign: str
    rmse: float
    line_rmse: float
    left_out_rmse: float
    left_out_line_rmse: float
    unexplained: float
    noise_rms: float
    scale_rmse: float
    expected_rmse: float | None
    fastest: float | None
    longest_rest: float | None
    longest_swing: float | None
    sample_period: float | None
    one_amplitude: bool
    swings: float
    logs: list[dict[str, object]]
    validation: list[dict[str, object]]
    dynamics: dict[str, object]
    prior: dict[str, object]
    notes: list[str]
    warnings: list[str]


class Move(TypedDict, total=False):
    """The arguments of ``Model.compensate`` behind the displacement and its time."""

    sample_rate: Typed | None
    unit: str | None
    v_min: Typed | None
    v_max: Typed | None
    max_slew: Typed | None
    extrapolate: bool
    on_limit: OnLimit
    from_: Typed | None
    return_: Typed | None
    approach: Typed | None
    condition: bool
    lead: Typed | None
    bandwidth: Typed | None
    periodic: bool
    passes: int
    tracked: Logs | None
    history: str | Path | Sequence[PassRecord]
    absolute: bool
    state: StateLike


class Model:
    """A model of an actuator: voltage to displacement (forward), or back (inverse).

    Parameters
    ----------
    actuator : dbo_cli.model.Cascade
        The cascade of stages that computes.

    Attributes
    ----------
    direction : {"forward", "inverse"}
        Whether a voltage goes in (forward), or a displacement (inverse).
    input : Quantity
        What goes in: its name, its unit, and the range that was identified.
    output : Quantity
        What comes out: its name, its unit, and the range that is reached slowly.
    stages : tuple
        The stages, in the order in which a signal passes them.
    fit : Fit
        The figures of the identification.
    sign : {"rising", "falling"}
        Whether the displacement rises or falls as the voltage rises.
    provenance : mapping
        The program and the logs that the model comes from.
    digest : str
        A name for the model: states and drives are of one with the same digest.
    """

    def __init__(self, actuator: room.Cascade) -> None:
        self.actuator: Final = actuator
        self.direction: Final = actuator.direction
        self.input: Final = actuator.input
        self.output: Final = actuator.output
        self.stages: Final = actuator.stages
        self.fit: Final = cast(Fit, dict(actuator.fit))
        self.sign: Final = actuator.sign
        self.provenance: Final = actuator.provenance

    @property
    def digest(self) -> str:
        """A name for the model: states and drives are of one with the same digest."""
        return self.actuator.digest

    def __eq__(self, other: object) -> bool:
        """Return whether two models have the same direction and stages."""
        if not isinstance(other, Model) or self.direction != other.direction:
            return False
        return self.digest == other.digest

    __hash__ = None  # type: ignore[assignment]

    def save(self, path: str | Path) -> None:
        """Write the model file, whole or not at all."""
        write_text(str(path), room.dumps_model(self.actuator))

    def inverse(self) -> Model:
        """Return the exact inverse model."""
        return Model(self.actuator.inverse())

    @overload
    def simulate(
        self,
        x: Signal,
        time: Signal | None = None,
        *,
        sample_rate: Typed | None = None,
        unit: str | None = None,
        state: StateLike = "auto",
        outside: room.Outside = "extend",
        return_state: Literal[False] = False,
    ) -> Floats: ...

    @overload
    def simulate(
        self,
        x: Signal,
        time: Signal | None = None,
        *,
        sample_rate: Typed | None = None,
        unit: str | None = None,
        state: StateLike = "auto",
        outside: room.Outside = "extend",
        return_state: Literal[True],
    ) -> tuple[Floats, room.State]: ...

    def simulate(
        self,
        x: Signal,
        time: Signal | None = None,
        *,
        sample_rate: Typed | None = None,
        unit: str | None = None,
        state: StateLike = "auto",
        outside: room.Outside = "extend",
        return_state: bool = False,
    ) -> Floats | tuple[Floats, room.State]:
        """Return the model's output.

        Parameters
        ----------
        x : array_like or frame
            The input, in the unit of ``input``. A frame is read as the command reads a
            log, and the time index of a Series counts as its time.
        time, sample_rate
            Time in s, or a rate in Hz; needed where the model depends on time.
        unit : str, optional
            The unit of ``x``, where that is not the model's.
        state : str, Path or State
            ``auto``, ``empty``, ``full``, ``settled``, a state that was returned, or
            the name of a state file.
        outside : {"extend", "hold", "error"}
            What happens beyond the model's input range.
        return_state : bool
            Also return the state after the last sample.

        Returns
        -------
        ndarray, or (ndarray, State)

        Raises
        ------
        InputError
            The input is in another unit, or holds what is no number.
        ModelError
            The model needs time and there is none, or the state is of another model.
        """
        role = "voltage" if self.direction == "forward" else "displacement"
        signal = signal_of(x, (role, "input"), self.input, time, sample_rate, unit)
        begin = room.state_of(state, self.actuator)
        simulator = Simulator(self.actuator, begin, outside)
        first = simulator.rows(*signal)
        y = np.concatenate([first.y, simulator.finish().y])
        return (y, cast(room.State, simulator.state)) if return_state else y

    @overload
    def compensate(
        self,
        wanted: Signal,
        time: Signal | None = None,
        *,
        details: Literal[False] = False,
        **move: Unpack[Move],
    ) -> Floats: ...

    @overload
    def compensate(
        self,
        wanted: Signal,
        time: Signal | None = None,
        *,
        details: Literal[True],
        **move: Unpack[Move],
    ) -> Drive: ...

    def compensate(
        self,
        wanted: Signal,
        time: Signal | None = None,
        *,
        sample_rate: Typed | None = None,
        unit: str | None = None,
        v_min: Typed | None = None,
        v_max: Typed | None = None,
        max_slew: Typed | None = None,
        extrapolate: bool = False,
        on_limit: OnLimit = "auto",
        from_: Typed | None = None,
        return_: Typed | None = None,
        approach: Typed | None = None,
        condition: bool = False,
        lead: Typed | None = None,
        bandwidth: Typed | None = None,
        periodic: bool = False,
        passes: int = 0,
        tracked: Logs | None = None,
        history: str | Path | Sequence[PassRecord] = (),
        absolute: bool = False,
        state: StateLike = "auto",
        details: bool = False,
    ) -> Floats | Drive:
        """Return the drive that makes the actuator follow a displacement.

        Parameters
        ----------
        wanted : array_like or frame
            The displacement, in the unit of ``output``. A frame is read as the command
            reads a trajectory, and the time index of a Series counts as its time.
        time, sample_rate
            Time in s, or a rate in Hz.
        unit : str, optional
            The unit of ``wanted``, where that is not the model's.
        v_min, v_max, max_slew, extrapolate
            Limits, as numbers in the drive's unit or as text (``"2V/ms"``).
        on_limit : {"auto", "clip", "error"}
            auto: clip while that costs at most one percent of the move (RMS).
        from_, return_ : float or str, optional
            Where the amplifier stands before the move, and where it goes after it; as
            limits are.
        approach, lead : float, str or "auto", optional
            Seconds of the way to the first value, and of a rest there.
        condition : bool
            Sweep the move's range first, so that the past is known.
        bandwidth : float or str, optional
            Cut-off (Hz) of a zero-phase low-pass on the trajectory; with ``tracked``, on
            what is learned.
        periodic, passes
            The trajectory is one period of a loop, after so many passes of run-in.
        tracked : frame, file, or a list of them, optional
            Recordings of the last pass, with its drive: the move is learned.
        history : file, or sequence of PassRecord
            With ``tracked``: the passes so far, ``drive.history`` of the last drive. A
            file is read if there is one, and written with the last pass, as by the
            command.
        absolute : bool
            With ``tracked``: learn the mean of the error, too.
        state : str, Path or State
            What was before the first sample.
        details : bool
            Return a ``Drive``: times, drive, clipped rows, expected error, state.

        Returns
        -------
        ndarray, or Drive

        Raises
        ------
        InputError
            The trajectory is in another unit, or it or a recording cannot be used.
        LimitError
            A start outside the limits, or a move that they do not allow.
        """
        self.actuator.require("forward")
        roles = ("displacement", "displacement")
        signal = signal_of(wanted, roles, self.output, time, sample_rate, unit)
        start = room.state_of(state, self.actuator)
        limits = Limits.within(self.input, v_min, v_max, max_slew, extrapolate)
        before = Lead(self.actuator, limits, start, from_, approach, condition, lead)
        driver = Driver(before, on_limit=on_limit, return_to=return_)
        file = None
        if history and tracked is None:
            raise UsageError("`history` needs `tracked` LOG")
        if isinstance(history, (str, Path)):
            file = str(history)
            history = histories_of(file)[""]
        drive: Drive = driver.whole(
            *signal,
            bandwidth=quantity("bandwidth", bandwidth, "Hz"),
            periodic=periodic,
            passes=passes,
            tracked=tracked_of(
                _listed("tracked", tracked), TRACKED_COLUMNS, Reading(), self.actuator
            ),
            history=history,
            absolute=absolute,
        )
        if file is not None:
            write_text(file, dumps_history(drive.history))
        return drive if details else drive.voltage

    def controller(
        self,
        sample_rate: Typed,
        *,
        v_min: Typed | None = None,
        v_max: Typed | None = None,
        max_slew: Typed | None = None,
        extrapolate: bool = False,
        state: StateLike = "auto",
        from_: Typed | None = None,
        lookahead: Typed | None = None,
    ) -> Controller:
        """Return a live controller: one sample at a time; see ``Controller``.

        Parameters
        ----------
        sample_rate
            Samples a second (Hz).
        v_min, v_max, max_slew, extrapolate, from_, state
            As of ``compensate``.
        lookahead : float, str or "auto", optional
            Seconds by which what is passed is wanted later.
        """
        self.actuator.require("forward")
        reading = Reading.of_options({"sample_rate": sample_rate})
        return Controller(
            self.actuator,
            cast(float, reading.sample_rate),
            Limits.within(self.input, v_min, v_max, max_slew, extrapolate),
            state=room.state_of(state, self.actuator),
            from_=from_,
            lookahead=quantity("lookahead", lookahead, "s", "auto"),
        )

    def plot(self) -> Figure:
        """Return a figure of the model's loop, with units."""
        from dbo_cli.reports.plots import plot_model

        return plot_model(self.actuator)

    def __repr__(self) -> str:
        """Return the model in one line."""
        into, out = self.input, self.output
        return (
            f"<dbo Model, {self.direction}: {into.quantity} {into.min:g} to {into.max:g}{into.suffix}"
            f" to {out.quantity} {out.min:g} to {out.max:g}{out.suffix}, {self.actuator.gears.n} gears>"
        )

    def save_state(self, state: room.State, path: str | Path) -> None:
        """Write a state file; ModelError where the state is of another model."""
        checked = room.state_of(state, self.actuator)
        assert isinstance(checked, room.State)
        write_text(str(path), room.dumps_state(checked, self.actuator))


class ModelSet(dict[str, Model]):
    """Models by the name of their channel."""

    def save(self, path: str | Path) -> None:
        """Write all models into one file."""
        actuators = {name: model.actuator for name, model in self.items()}
        write_text(str(path), room.dumps_set(actuators))


def read_model(path: str | Path) -> Model:
    """Read a model file, or ``FILE::NAME`` of a set.

    Raises
    ------
    ModelError
        The file is no model of version 1; the message names the key.
    """
    return Model(room.read_cascade(str(path)))


def read_models(path: str | Path) -> ModelSet:
    """Read a set of models, by the name of their channel; a single model has no name.

    Raises
    ------
    ModelError
        The file is no set of models, and no model.
    """
    cascades = room.read_cascades(str(path))
    return ModelSet({name: Model(cascade) for name, cascade in cascades.items()})


# --- logs ---


def read_log(
    path: str | Path,
    *,
    time: str | int | None = None,
    voltage: str | int | None = None,
    displacement: str | int | None = None,
    sample_rate: Typed | None = None,
    time_unit: str | None = None,
    scale: Mapping[str, str | float] | None = None,
    rows: str | None = None,
    skip_bad: bool = False,
    resample: Typed | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    skip_lines: int | None = None,
    encoding: str | None = None,
    clock_offset: Typed | None = None,
) -> pd.DataFrame:
    """Read a log into a DataFrame.

    Parameters
    ----------
    path
        Any log that the commands read.
    time, voltage, displacement
        Names or numbers of the columns, or ``FILE::COLUMN`` of a second file; found by
        name and unit where not given.
    sample_rate, resample
        Rates in Hz: of a log without a time column, and to interpolate to.
    time_unit
        Unit of the time column: ``ms``, ``10us``.
    scale
        By role, a factor: ``{"displacement": "10um/V"}``.
    rows
        Data rows A to B, counted from 1: ``"100:2000"``.
    skip_bad
        Drop rows that hold no number.
    delimiter, decimal, skip_lines, encoding
        How a text is written.
    clock_offset
        Seconds that are added to the clock of a second file, or ``auto``.

    Returns
    -------
    DataFrame
        The columns ``time`` (s), ``voltage``, ``displacement``, as far as there are
        any; ``attrs["units"]`` holds their units, ``attrs["columns"]`` their names in the
        file, ``attrs["notes"]`` what is odd, and ``attrs["holds_delay"]`` whether the
        actuator's delay is in a clock offset that was found.

    Raises
    ------
    InputError
        The log cannot be read, or it is not clear which column is which.
    """
    arguments = dict(locals())
    import pandas as pd

    roles = {}
    for role in RECORDING_COLUMNS:
        name = arguments[role]
        roles[role] = None if name is None else str(name)
    absent = tuple(role for role, name in roles.items() if name is None)
    with open_log(str(path), roles, Reading.of_options(arguments), None, absent) as log:
        present = [role for role in RECORDING_ROLES if role in log.columns]
        if not present:
            raise InputError(
                f"{path}: no column is named voltage or displacement: give `voltage` NAME"
            )
        table = log.read()
    frame = pd.DataFrame()
    units: dict[str, str | None] = {}
    if table.time is not None:
        frame["time"], units["time"] = table.time, "s"
    for role in present:
        frame[role], units[role] = table[role], log.columns[role].unit
    names = {role: log.columns[role].name for role in present}
    frame.attrs.update(name=str(path), units=units, columns=names)
    frame.attrs.update(notes=list(log.remarks), holds_delay=log.clock.holds_delay)
    return frame


def identify(
    data: Logs,
    displacement: Signal | None = None,
    *,
    time: Signal | None = None,
    sample_rate: Typed | None = None,
    voltage_unit: str | None = None,
    displacement_unit: str | None = None,
    validate: Logs | None = None,
    prior: Model | str | Path | None = None,
    sign: Literal["rising", "falling"] | None = None,
    skip: Typed = 0.0,
    zero: float | Literal["none", "mean", "first"] = "none",
    sensor_delay: Typed = 0.0,
    gears: int | Literal["auto"] = "auto",
    points: int | Literal["auto"] = "auto",
    relaxation: Sequence[Typed] | Typed = "auto",
    delay: Typed = "auto",
    dynamics: Literal["auto", 0, 1, 2] = "auto",
    slopes: Literal["auto", "growing", "falling", "free"] = "auto",
    method: Literal["least-squares", "paper"] = "least-squares",
    force: bool = False,
) -> Model:
    """Identify a model of an actuator.

    Parameters
    ----------
    data
        A frame, a file's name, an array of voltages, or a list of frames or files of
        one actuator. Frames are read as files are: columns by name, units in names.
    displacement : array_like
        With an array of voltages, the displacement.
    time, sample_rate
        Time in s of arrays or of one frame, or a rate in Hz. A time index counts as the time.
    voltage_unit, displacement_unit : str, optional
        Units of arrays; without, those that Series state of themselves, if any.
    validate
        Logs that say how well the model predicts.
    prior : Model or file
        Keep its shape; find gain, offset and delay again.
    sign : {"rising", "falling"}
        Refuse logs whose displacement goes the other way.
    skip, sensor_delay, delay
        Seconds, or a text with a unit; ``delay`` may be ``auto``.
    zero : {"none", "mean", "first"} or float
        The displacement to call 0, in its unit.
    gears, points, dynamics
        How many, or ``auto``.
    relaxation : float, str, a sequence of them, or "auto"
        Time constants of the creep in s; empty for none.
    slopes, method, force
        As of the command.

    Returns
    -------
    Model

    Raises
    ------
    InputError
        A log cannot be read, or is in another unit than the prior.
    FitError
        No trustworthy model can be identified.
    """
    arguments = dict(locals())
    if isinstance(prior, (str, Path)):
        prior = read_model(prior)
    shape = None if prior is None else prior.actuator
    units = units_of(shape, "displacement")
    given = {"voltage": voltage_unit, "displacement": displacement_unit}
    reading = Reading.of_options(arguments)
    columns: Mapping[str, str | None] = RECORDING_COLUMNS
    sources = _listed("data", data)
    if displacement is not None or is_frame(data):
        signals = {"voltage": data, "displacement": displacement}
        source, columns = table_in_memory(signals, given, units, time, reading)
        sources = [source]
    elif time is not None or voltage_unit or displacement_unit:
        raise UsageError(
            "`time`, `voltage_unit`, `displacement_unit` are of two arrays or a frame: give each frame of "
            "a list a time column, or `sample_rate`; a file has its own"
        )
    if not sources:
        raise InputError("no log: give a file, a frame, or two arrays")
    recordings, logs = recordings_of(sources, columns, reading, units)
    options = options_of({**arguments, "prior": shape})
    units = {"voltage": recordings[0].input[1], "displacement": recordings[0].output[1]}
    tests, _ = recordings_of(
        _listed("validate", validate), RECORDING_COLUMNS, Reading(), units
    )
    return Model(identified(recordings, logs, options, tests))


def _listed(name: str, data: Logs | None) -> list[Any]:
    """Return one source or several as a list; None as none; an empty list is refused (InputError)."""
    if data is None:
        return []
    sources = list(data) if isinstance(data, (list, tuple)) else [data]
    if not sources:
        raise InputError(f"`{name}`: an empty list holds no log: give one, or None")
    return sources


def report(
    desired: Signal,
    measured: Signal | None = None,
    time: Signal | None = None,
    *,
    sample_rate: Typed | None = None,
    model: Model | None = None,
    state: StateLike = "auto",
    rows: str | tuple[int | None, int | None] | None = None,
    voltage: Signal | None = None,
    expected: Mapping[str, object] | None = None,
    unit: str | None = None,
    voltage_unit: str | None = None,
    name: str = "log",
    lag: int = 0,
    remove_offset: bool = False,
    max_rmse: Typed | None = None,
    max_nrmse_percent: Typed | None = None,
) -> Report:
    """Report how well a measured displacement follows a desired one, or what a model predicts.

    Parameters
    ----------
    desired, measured : array_like
        Both displacements in one unit; with ``model`` the first is the drive. A frame in
        the place of both is read as the command reads a log.
    time, sample_rate
        Time in s, or a rate in Hz; the time index of a Series counts.
    model, state
        A forward model, and what was before the first row.
    rows : str or (first, last), optional
        The rows that count, from 1, both ends included: ``"100:2000"``.
    voltage : array_like, optional
        The drive, for the figures.
    expected : mapping, optional
        The summary of the drive, ``drive.summary()``: the error that was to be expected. A
        time that covers its move is taken for the drive's: rows beside the move do not count.
    unit, voltage_unit : str, optional
        Of the displacements and of the drive; without, those that Series state of
        themselves, else those of the model.
    name : str
        Of the log.
    lag : int
        Rows by which measured is taken later.
    remove_offset : bool
        Take the mean of the error off.
    max_rmse, max_nrmse_percent
        Largest error, in the unit or as a text (``"10nm"``), and in percent of the move.

    Returns
    -------
    Report
        With ``rmse``, ``to_frame()``, ``to_html()``, ``figures(folder)``.

    Raises
    ------
    InputError
        Lengths or units differ, or there is nothing to compare.
    """
    from dbo_cli.reports import Report, expected_in

    reading = Reading.of_options({"sample_rate": sample_rate})
    if isinstance(rows, str):
        rows = parse_rows(rows)
    if model is None and state != "auto":
        raise UsageError("`state` needs `model`")
    if model is not None and voltage is not None:
        raise UsageError("`voltage`: with `model` the first argument is the drive")
    if model is None and voltage is None and voltage_unit is not None:
        raise UsageError("`voltage_unit` needs `voltage`")
    actuator = None if model is None else model.actuator
    start = "auto" if actuator is None else room.state_of(state, actuator)
    signals = {"desired": desired, "measured": measured, "voltage": voltage}
    options = {"desired": unit, "measured": unit, "voltage": voltage_unit}
    units: Units = units_of(actuator)
    if actuator is not None:
        signals = {"voltage": desired, "measured": measured}
    if measured is None and not is_frame(desired):
        raise UsageError("report: give `desired` and `measured`, or a frame")
    table, columns = table_in_memory(signals, options, units, time, reading)
    names = [column.unit or "no unit" for column in table.columns[:2]]
    if measured is not None and actuator is None and names[0] != names[1]:
        raise InputError(
            f"desired is in {names[0]}, measured in {names[1]}: convert one, and pass `unit` of both"
        )
    pairs, units, _ = pairs_of([table], columns, reading, actuator, start)
    unit = units.get("measured")
    expected_error = expected_in(expected, unit)
    move_time = expected_error.move_time  # of the drive: rows beside it do not count
    counted = []
    for pair in pairs:
        is_drive = pair.covers(move_time)
        counted.append(
            dataclasses.replace(pair, rows=rows, name=name, on_drive_clock=is_drive)
        )
    made = Report(
        counted,
        unit=unit,
        voltage_unit=units.get("voltage"),
        lag=lag,
        remove_offset=remove_offset,
        expected=expected_error,
        max_rmse=quantity("max_rmse", max_rmse, unit),
        max_nrmse_percent=quantity("max_nrmse_percent", max_nrmse_percent, "%"),
        model=actuator,
    )
    for text in made.warnings:
        warn(text)
    return made
