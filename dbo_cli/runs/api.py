"""The Python API, ``import dbo_cli as dbo``: models, sets and functions, with all that a command would do."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from dbo_cli import extensions
from dbo_cli.drives.compensation import Compensation, compensation
from dbo_cli.drives.model_run import ModelRun
from dbo_cli.errors import DboWarning, InputError, Remarks, UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import (
    is_set,
    model_to_bytes,
    read_set,
    read_state,
    state_to_bytes,
)
from dbo_cli.hysteresis.model_file import read_model as read_model_file
from dbo_cli.hysteresis.model_state import ModelState, Quantity, StartName
from dbo_cli.hysteresis.operators import Outside
from dbo_cli.logs import request
from dbo_cli.logs.columns import any_of, column_wish, is_pattern
from dbo_cli.logs.request import ALL_ROWS, Address, ReadingOptions, Rows
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.sources import ArraySource, is_file, is_log
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.runs import files

if TYPE_CHECKING:
    import pandas
    from _typeshed import DataclassInstance

    from dbo_cli.extras.live.controller import Controller
    from dbo_cli.runs.identifying import IdentifyRun
    from dbo_cli.runs.reporting import TrackingOptions, TrackingReport

Floats = NDArray[np.float64]
Record = TypeVar("Record", bound="DataclassInstance")
Start = StartName | ModelState | str | os.PathLike[str]


@dataclass(frozen=True)
class Result:
    """A run with all that belongs to it.

    Attributes
    ----------
    values : array of shape (samples,)
        What came out, in the unit of the model's output (of its input, for a drive).
    time : array of shape (samples,), or None
        Seconds; below 0 where a sweep stands before the trajectory.
    state : ModelState
        After the last sample, to go on from.
    notes, warnings : list of str
        What is good to know, and what may spoil the result.
    clipped, outside : int
        Samples in which the drive's limits were met, or which lie outside the model's
        range.
    """

    values: Floats
    time: Floats | None
    state: ModelState
    notes: list[str]
    warnings: list[str]
    clipped: int
    outside: int


class Model:
    """A model of an actuator, forward (voltage to displacement) or inverse.

    Parameters
    ----------
    actuator : ActuatorModel
        The cascade of stages.
    summary, remarks
        The messages of its identification.
    """

    def __init__(
        self,
        actuator: ActuatorModel,
        summary: list[str] | None = None,
        remarks: Remarks | None = None,
    ) -> None:
        self.actuator = actuator
        self.summary = summary or []
        self.remarks = remarks or Remarks()

    def __repr__(self) -> str:
        """Return what the model turns into what."""
        ends = (
            f"{q.quantity} {q.minimum:g} to {q.maximum:g}{q.suffix}"
            for q in (self.input, self.output)
        )
        return (
            f"<dbo Model, {self.direction}: {' to '.join(ends)}, {self.actuator.size}>"
        )

    @property
    def direction(self) -> str:
        """``forward`` or ``inverse``."""
        return self.actuator.direction

    @property
    def input(self) -> Quantity:
        """Name, unit and range of what goes in."""
        return self.actuator.input

    @property
    def output(self) -> Quantity:
        """Name, unit and slowly reached range of what comes out."""
        return self.actuator.output

    @property
    def fit(self) -> Mapping[str, object]:
        """Figures of the identification."""
        return self.actuator.fit

    @property
    def warnings(self) -> list[str]:
        """What the identification warned of."""
        return list(self.remarks.warnings)

    def inverse(self) -> Model:
        """Return the exact inverse (17)-(18)."""
        return Model(self.actuator.inverse())

    def to_json(self) -> bytes:
        """Return the model file (docs/model-file.md): the same model gives the same bytes."""
        return model_to_bytes(self.actuator)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model file, whole or not at all.

        Parameters
        ----------
        path
            Where to, ``model.json``.

        Raises
        ------
        UsageError
            The name says another format.
        OutputError
            It cannot be written.
        """
        request.check_document(path, "a model", "json")
        write_whole(path, self.to_json())

    def save_state(self, state: ModelState, path: str | os.PathLike[str]) -> None:
        """Write a state of this model, for a later run to go on from.

        Parameters
        ----------
        state, path
            What a run returned or ``Controller.state`` holds, and where to,
            ``state.json``.
        """
        request.check_document(path, "a state", "json")
        write_whole(path, state_to_bytes(state, self.actuator))

    def read_state(self, path: str | os.PathLike[str]) -> ModelState:
        """Read a state file of this model or its inverse.

        Parameters
        ----------
        path
            A file of ``save_state`` or of ``dbo --save-state``.

        Raises
        ------
        InputError, ModelError
            The file cannot be read, or is no state, or one of another model.
        """
        state = read_state(os.fspath(path), self.actuator)
        return dataclasses.replace(state, model=self.actuator.digest)

    @overload
    def simulate(self, x: Any, *, time: Any = ..., sample_rate: float | None = ..., rows: str | None = ...,
                 state: Start = ..., outside: Outside = ..., return_state: Literal[False] = ...,
                 details: Literal[False] = ...) -> Floats: ...  # fmt: skip
    @overload
    def simulate(self, x: Any, *, time: Any = ..., sample_rate: float | None = ..., rows: str | None = ...,
                 state: Start = ..., outside: Outside = ..., return_state: Literal[True],
                 details: Literal[False] = ...) -> tuple[Floats, ModelState]: ...  # fmt: skip
    @overload
    def simulate(self, x: Any, *, time: Any = ..., sample_rate: float | None = ..., rows: str | None = ...,
                 state: Start = ..., outside: Outside = ..., return_state: bool = ...,
                 details: Literal[True]) -> Result: ...  # fmt: skip
    def simulate(
        self,
        x: Any,
        *,
        time: Any = None,
        sample_rate: float | None = None,
        rows: str | None = None,
        state: Start = "auto",
        outside: Outside = "extend",
        return_state: bool = False,
        details: bool = False,
    ) -> Any:
        """Run the model over its input signal.

        Parameters
        ----------
        x : array_like of shape (samples,), DataFrame or file name
            The input, in the unit of ``input``; an inverse model reads it ahead by its
            delay.
        time, sample_rate
            Seconds of shape (samples,) or a column's name, or samples a second (Hz);
            needed by a model with lag, creep or delay.
        rows : str
            ``A:B``: the rows to answer, from 1; an inverse model reads what stands
            after them ahead.
        state
            ``auto``, ``empty``, ``full``, ``settled``, a state returned before, or a
            state file.
        outside : {"extend", "hold", "error"}
            Beyond the model's range: go on with the last slope, hold, or refuse.
        return_state : bool
            Also return the state after the last sample.
        details : bool
            Return a ``Result``; otherwise warnings go the way of Python's own
            (``DboWarning``).

        Returns
        -------
        array of shape (samples,), a pair of it and the state, or a Result

        Raises
        ------
        InputError
            The signal is no array of finite numbers, time is missing or goes backwards,
            or a sample is outside and that is refused.
        ModelError
            The state is of another model.
        UsageError
            No state is called so.
        """
        read, last = _rows_of(rows, self.direction == "inverse")
        want = {self.input.quantity: files.quantity_wish(self.input, option="x")}
        source = files.source_of(want, x, time=time, sample_rate=sample_rate, rows=read)
        files.bring_to(source, self.input.quantity, self.input, "the model")
        if outside not in OUTSIDE:
            raise UsageError(f"`outside`: '{outside}' is none of {', '.join(OUTSIDE)}")
        run = ModelRun(
            self.actuator, source, files.start_of(state, self.actuator), outside, last
        )
        return _finished(run, return_state, details)

    @overload
    def compensate(self, wanted: Any, *, time: Any = ..., sample_rate: float | None = ...,
                   rows: str | None = ..., tracked: Any = ..., return_state: Literal[False] = ...,
                   details: Literal[False] = ..., **options: Any) -> Floats: ...  # fmt: skip
    @overload
    def compensate(self, wanted: Any, *, time: Any = ..., sample_rate: float | None = ...,
                   rows: str | None = ..., tracked: Any = ..., return_state: Literal[True],
                   details: Literal[False] = ..., **options: Any,
                   ) -> tuple[Floats, ModelState]: ...  # fmt: skip
    @overload
    def compensate(self, wanted: Any, *, time: Any = ..., sample_rate: float | None = ...,
                   rows: str | None = ..., tracked: Any = ..., return_state: bool = ...,
                   details: Literal[True], **options: Any) -> Result: ...  # fmt: skip
    def compensate(
        self,
        wanted: Any,
        *,
        time: Any = None,
        sample_rate: float | None = None,
        rows: str | None = None,
        tracked: Any = (),
        return_state: bool = False,
        details: bool = False,
        **options: Any,
    ) -> Any:
        """Return the drive that makes the actuator follow a trajectory.

        Delay, limits and start are seen to: ``simulate`` of the drive gives the
        trajectory back, to rounding; a delay between samples leaves what its
        interpolation does (0.003 % of a sine with 20 a period).

        Parameters
        ----------
        wanted : array_like of shape (samples,), DataFrame or file name
            The desired displacement, in the unit of ``output``.
        time, sample_rate
            As in ``simulate``; needed by ``max_slew``, too.
        rows : str
            ``A:B``: the rows to answer, from 1; what stands after them is only read
            ahead.
        tracked : table, file name, or pair (voltage, measured); or a list of these
            The last pass of this trajectory, recorded once or several times: the drive
            becomes the next one of a repeated move, better by what the recording shows.
        return_state, details
            As in ``simulate``.
        **options
            What ``DriveOptions`` knows: ``v_min``, ``v_max``, ``max_slew``, ``state``,
            ``periodic``, … With rows before or after the trajectory the drive is longer
            than it, and ``details`` has the times.

        Returns
        -------
        array of shape (samples,), a pair of it and the state, or a Result

        Raises
        ------
        InputError, ModelError, UsageError
            As in ``simulate``; the model is an inverse one; the limits are not in
            order.
        LimitError
            A limit was met and ``on_limit`` is ``error``, or the drive cannot begin
            within its limits.
        """
        from dbo_cli.drives.options import DriveOptions

        state = files.start_of(options.get("state", "auto"), self.actuator)
        brought = {
            name: options.pop(name)
            for name in brought_keywords("compensate")
            if name in options
        }
        if np.size(tracked):
            brought["tracked"] = tracked
        drive = record_of(
            DriveOptions, options | {"state": state}, "is no parameter of compensate"
        )
        self.actuator.require("forward")
        read, last = _rows_of(
            rows, not (brought.get("periodic") or "tracked" in brought)
        )
        want = {
            self.output.quantity: files.quantity_wish(
                self.output, option="wanted", trajectory=True
            )
        }
        source = files.source_of(
            want, wanted, time=time, sample_rate=sample_rate, rows=read
        )
        files.bring_to(source, self.output.quantity, self.output, "the model")
        run = compensation(self.actuator, source, drive, brought, last)
        return _finished(run, return_state, details)

    def controller(
        self, sample_rate: float | None = None, **options: Any
    ) -> Controller:
        """Return a controller that plans and commits one sample at a time.

        Parameters
        ----------
        sample_rate : float, optional
            Samples a second (Hz); needed by a model with lag or creep and by
            ``max_slew``.
        **options
            ``v_min``, ``v_max``, ``extrapolate``, ``max_slew``, ``state`` and ``from_``
            as in ``compensate``, and:
        dac : array_like, optional
            The voltage of every code of a digital-to-analogue converter, from code 0
            on; codes are then planned, and the state follows the voltage of the code.
        ahead : bool
            A model with a delay needs what is wanted later; with ``ahead`` the caller
            passes that.
        lookahead : float or "auto"
            Seconds by which what is passed is wanted later, no less than the model
            needs (auto): dynamics and delay are undone from it. The controller's
            ``lookahead`` has the samples.

        Raises
        ------
        ModelError
            The model is an inverse one, or has a delay or dynamics and ``lookahead`` is
            not given.
        UsageError
            The rate is missing, the limits or the converter's curve are not in order,
            or ``lookahead`` is shorter than the model needs.
        """
        options["state"] = files.start_of(options.get("state", "auto"), self.actuator)
        controller: Controller = extensions.find("run", "control a model")(
            self.actuator, sample_rate, **options
        )
        return controller


OUTSIDE = ("extend", "hold", "error")


def record_of(record: type[Record], values: Mapping[str, Any], what: str) -> Record:
    """Return a record of options, made of keywords that it knows (see ``require_known``)."""
    require_known(record, values, what)
    return record(**values)


def brought_keywords(command: str) -> list[str]:
    """Return the keywords that the options of extras for a command are from Python (``history``)."""
    keywords = []
    for key in extensions.keys("option"):
        name, _, option = key.partition(" --")
        if name == command:
            keywords.append(option.replace("-", "_"))
    return keywords


def require_known(
    record: type[DataclassInstance], values: Mapping[str, Any], what: str
) -> None:
    """Refuse keywords that are no fields of a record of options (UsageError, which lists the fields)."""
    known = {field.name for field in dataclasses.fields(record)}
    for name in values:
        if name not in known:
            raise UsageError(f"`{name}` {what}; there are: {', '.join(sorted(known))}")


def _rows_of(rows: str | None, ahead: bool) -> tuple[Rows, int | None]:
    """Return the rows to read and the last one to answer, where those after it are read ahead."""
    first, last = _parsed_rows(rows)
    if ahead:
        return (first, None), last
    return (first, last), None


def _parsed_rows(rows: str | None) -> Rows:
    """Return the first and the last row of ``A:B``, of a whole log where there is none."""
    return ALL_ROWS if rows is None else request.parse_rows(rows)


def _finished(run: ModelRun, return_state: bool, details: bool) -> Any:
    """Run to the end and return what was asked for."""
    times: list[Floats] = []
    with closing(run.source):
        expected = run.source.count if isinstance(run.source, ArraySource) else 0
        values = _joined(_outputs(run, times if details else None), expected)
    if isinstance(run, Compensation):
        # playing other models over the move takes longer than the drive itself
        run.expecting = details
        run.finish()
    remarks = run.remarks()
    assert run.state is not None
    run.state = dataclasses.replace(run.state, model=run.model.digest)
    if details:
        return Result(
            values,
            np.concatenate(times) if times else None,
            run.state,
            remarks.notes,
            remarks.warnings,
            run.clipped.count if isinstance(run, Compensation) else 0,
            run.beyond.count,
        )
    for text in remarks.warnings:
        warnings.warn(text, DboWarning, stacklevel=3)
    if return_state:
        return values, run.state
    return values


def _outputs(run: ModelRun, times: list[Floats] | None) -> Iterator[Floats]:
    """Return the blocks of a run's output; their times are added to a list where one is given."""
    for response in run.responses():
        if times is not None and response.time is not None:
            times.append(response.time)
        yield response.y


def _joined(blocks: Iterator[Floats], expected: int) -> Floats:
    """Return blocks as one array, which is as long as expected, or longer or shorter.

    Each block is copied and given back before the next is made: memory in use would
    have to be found anew.
    """
    first = next(blocks, np.empty(0))
    if first.size >= expected:
        rest = list(blocks)
        if not rest:
            return first
        return np.concatenate([first, *rest])
    joined = np.empty(expected)
    joined[: first.size] = first
    filled = first.size
    del first
    for block in blocks:
        if filled + block.size > joined.size:
            joined = np.concatenate(
                [joined[:filled], np.empty(max(filled, block.size))]
            )
        joined[filled : filled + block.size] = block
        filled += block.size
    if filled == joined.size:
        return joined
    return joined[:filled]


# --- functions ---


def read_log(
    path: str | os.PathLike[str],
    *,
    voltage: str | None = None,
    displacement: str | None = None,
    desired: str | None = None,
    time: str | None = None,
    rows: str | None = None,
    **reading: Any,
) -> pandas.DataFrame:
    """Read a log as the commands read it.

    Parameters
    ----------
    path
        A file, or ``FILE::/group`` of an HDF5 file.
    voltage, displacement, desired, time
        The columns: a header name, a dataset path, or a number counted from 1; guessed
        where not given.
    rows
        ``A:B``, data rows counted from 1, both ends included.
    **reading
        Whatever else ``ReadingOptions`` knows: ``sample_rate``, ``skip_bad``,
        ``delimiter``, …

    Returns
    -------
    DataFrame
        Columns ``time`` (s), ``voltage``, ``displacement``, ``desired``, as far as they
        are there. ``attrs``: ``units`` (by column), ``sample_rate`` (Hz, where no
        stamps tell the time), ``notes``, and ``provenance`` (name, sha256 and rows).

    Raises
    ------
    InputError
        The log is absent, unreadable or empty, or holds neither voltage nor
        displacement.
    UsageError
        An option is senseless.
    """
    options = _reading(time, rows, reading)
    want = {
        "voltage": column_wish("voltage", voltage, required=False, option="voltage"),
        "desired": column_wish("desired", desired, required=False, option="desired"),
        "displacement": column_wish(
            "displacement", displacement, required=False, option="displacement"
        ),
    }
    with open_log(path, want, options, digest=True) as log:
        if not log.columns:  # refused by this, with what there is to choose from
            open_log(
                path, files.recording_wishes(voltage, displacement), options
            ).close()
        frame = _frame(log)
    if list(log.columns) == ["displacement"] and log.unread:
        columns = any_of([f"'{name}'" for name in log.unread])
        warnings.warn(
            f"{log.name}: no column is recognised as the voltage (`voltage` names it: {columns})",
            DboWarning,
            stacklevel=2,
        )
    return frame


def _frame(log: SignalLog) -> pandas.DataFrame:
    """Read a log whole into a table."""
    import pandas as pd

    block = log.read()
    values: dict[str, Floats] = {}
    units: dict[str, str | None] = {}
    if block.time is not None and log.even_rate is None:
        values["time"], units["time"] = block.time, "s"
    values |= block.values
    for role, column in log.columns.items():
        units[role] = column.unit
    frame = pd.DataFrame(values)
    frame.attrs |= {
        "units": units,
        "notes": list(log.notes),
        "warnings": list(log.warnings),
        "read": [log.reading_line()],
        "provenance": dict(log.record()) | {"read": log.reading_record()},
    }
    if log.even_rate is not None:
        frame.attrs["sample_rate"] = log.even_rate
    return frame


def identify(
    log: Any,
    displacement: Any = None,
    *,
    voltage: str | None = None,
    time: Any = None,
    sample_rate: float | None = None,
    validate: Any = (),
    prior: Any = None,
    voltage_unit: str | None = None,
    displacement_unit: str | None = None,
    uncertainty: Any = None,
    jobs: int = 1,
    shared_shape: bool = False,
    coupling: bool = False,
    **options: Any,
) -> Any:
    """Identify a model of an actuator from logs of its drive voltage and displacement.

    Parameters
    ----------
    log : array_like, DataFrame, file name, or a list of tables and files
        The drive voltage of shape (samples,) beside ``displacement``; or one or more
        logs of one actuator.
    displacement : array_like of shape (samples,), optional
        The measured displacement, where ``log`` is the voltage.
    voltage, displacement : str, optional
        The columns of tables and files, else guessed; patterns (``V{}``, ``D{}``) name
        many channels'.
    time, sample_rate
        Seconds of shape (samples,), of tables and files the column; or samples a second
        (Hz) without one.
    validate
        Another log, or a list of logs, to say how well the model predicts.
    prior : Model or file name, optional
        Keep the shape of this model, and find its gain, offset and lag again from a
        short log; for channels a ``ModelSet`` or the file of one.
    voltage_unit, displacement_unit : str, optional
        Units of arrays, for the model to carry.
    uncertainty : array_like of shape (samples,), or str
        The displacement's standard deviation row by row, in its unit (of tables and
        files the column): rows count by 1 over its square.
    jobs, shared_shape, coupling
        For channels: processes (change no result; a script that asks for several needs
        the usual ``if __name__ == "__main__":``); one loop shape for all; and how much
        each shows in the others, from a log in which all move (``excite --channels``).
    **options
        What ``IdentificationOptions`` knows (``gears``, ``delay``, …); all else is
        found on data left out.

    Returns
    -------
    Model, or of patterns a ModelSet
        With ``summary`` and ``warnings``; warnings also go the way of Python's own
        (``DboWarning``).

    Raises
    ------
    InputError, FitError, UsageError
        A log cannot be read; nothing trustworthy can be identified; options contradict
        each other or a log.
    """
    from dbo_cli.hysteresis.identification import IdentificationOptions
    from dbo_cli.runs.identifying import IdentifyRun

    fixed = record_of(IdentificationOptions, options, "is no parameter of identify")
    logs, columns = _given(
        log, displacement, voltage, time, sample_rate, voltage_unit, displacement_unit
    )
    if uncertainty is not None:
        uncertainty = _column_of_uncertainty(logs, uncertainty)
    reading = ReadingOptions(time=_column(time), sample_rate=sample_rate)
    switches = _chosen(shared_shape=shared_shape, coupling=coupling)
    run = IdentifyRun(
        logs,
        _addressed(validate),
        reading,
        fixed,
        *columns,
        uncertainty=uncertainty,
        prior=prior,
        brought=switches,
        time=time,
    )
    return _identify_model_or_set(run, jobs)


def _chosen(**switches: bool) -> dict[str, bool]:
    """Return the switches that are on."""
    return {name: True for name, is_on in switches.items() if is_on}


def _given(
    log: Any,
    displacement: Any,
    voltage: str | None,
    time: Any,
    sample_rate: float | None,
    *units: str | None,
) -> tuple[list[Any], tuple[str | None, str | None]]:
    """Return logs, or the one that two arrays are, and the columns that were named."""
    if displacement is None or voltage is not None or isinstance(displacement, str):
        return _addressed(log), (voltage, displacement)
    roles = ("voltage", "displacement")
    named = dict(zip(roles, units, strict=True))
    source = ArraySource(
        dict(zip(roles, (log, displacement), strict=True)),
        time,
        sample_rate,
        units=named,
    )
    return [source], (None, None)


def _column_of_uncertainty(logs: Sequence[Any], uncertainty: Any) -> str | None:
    """Return the column of logs' standard deviations; of a log of arrays, add them to it.

    Raises
    ------
    InputError
        Arrays of other lengths, or with samples that are no standard deviation.
    UsageError
        A column of arrays, or an array beside tables and files.
    """
    arrays = logs[0] if isinstance(logs[0], ArraySource) else None
    if isinstance(uncertainty, str):
        if arrays is not None:
            raise UsageError(
                "`uncertainty`: beside arrays of voltage and displacement it is an array, too"
            )
        return uncertainty
    if arrays is None:
        raise UsageError(
            "`uncertainty`: of tables and files it is the name of a column"
        )
    arrays.add("uncertainty", uncertainty, arrays.columns["displacement"].unit)
    return None


def _identify_model_or_set(run: IdentifyRun, jobs: int) -> Any:
    """Identify a model, or a set of them where the columns are patterns."""
    from dbo_cli.runs.identifying import identify_recordings

    if is_pattern(run.voltage) or is_pattern(run.displacement):
        return extensions.find("run", "identify a set")(run, jobs)
    run.refuse_channels_options()
    prior = None if run.prior is None else _model(run.prior).actuator
    fitted, checks = run.read(prior=prior)
    arguments = run.arguments({}, os.fspath(run.prior) if is_file(run.prior) else None)
    result = identify_recordings(fitted, run.options, checks, arguments, prior)
    for text in result.remarks.warnings:
        warnings.warn(text, DboWarning, stacklevel=3)
    return Model(result.model, result.summary, result.remarks)


def read_model(path: str | os.PathLike[str]) -> Any:
    """Read a model file, or a set of models.

    Parameters
    ----------
    path
        The file, ``FILE::CHANNEL`` of a set, or ``-`` for standard input.

    Returns
    -------
    Model, or of a set a ModelSet
        ``FILE::CHANNEL`` is one model of a set.

    Raises
    ------
    InputError, ModelError
        The file cannot be read, is no model, or contradicts itself; the message names
        file and key.
    """
    if is_set(os.fspath(path)):
        return extensions.find("run", "set from Python")(read_set(os.fspath(path)))
    return _model(path)


def simulate(model: Model | str | os.PathLike[str], x: Any, **options: Any) -> Any:
    """Run a model over its input signal.

    Parameters
    ----------
    model : Model or file name
        What is run.
    x, **options
        As in ``Model.simulate``.
    """
    return _model(model).simulate(x, **options)


def compensate(
    model: Model | str | os.PathLike[str], wanted: Any, **options: Any
) -> Any:
    """Return the drive that makes an actuator follow a trajectory.

    Parameters
    ----------
    model : Model or file name
        The forward model of the actuator.
    wanted, **options
        As in ``Model.compensate``.
    """
    return _model(model).compensate(wanted, **options)


def report(
    wanted: Any,
    measured: Any = None,
    *,
    time: Any = None,
    sample_rate: float | None = None,
    voltage: Any = None,
    model: Model | str | os.PathLike[str] | None = None,
    unit: str | None = None,
    name: str = "log",
    **options: Any,
) -> TrackingReport:
    """Report how well what was measured follows what was wanted, or what a model predicts.

    Parameters
    ----------
    wanted : array_like of shape (samples,), DataFrame, file name, or a list of these
        The desired displacement beside ``measured``; with ``model`` the drive voltage
        it predicts from; or one or several tables and logs that hold both columns.
    measured : array_like of shape (samples,), optional
        The measured displacement.
    time, sample_rate
        Seconds of shape (samples,), or samples a second (Hz).
    voltage : array_like or column, optional
        The drive beside the two, for the figures.
    model : Model, optional
        Compare its prediction with the measurement.
    unit, name : str, optional
        Unit and name of arrays.
    **options
        What ``TrackingOptions`` knows: ``lag``, ``remove_offset``, ``segment``,
        ``dwell``, ``trajectory``, ``match``, ``count_sweep``, ``desired``; and how
        tables and files are to be read. ``rows`` are the desired rows that count; a
        model is run from the first row on.

    Returns
    -------
    TrackingReport
        ``report`` holds the numbers; ``to_frame()``, ``to_html()``, ``figures(folder)``
        and so on show them.

    Raises
    ------
    InputError, UsageError
        There is nothing to compare, or units differ; the options contradict each other.
    """
    from dbo_cli.runs.reporting import TrackingRun

    logs = [] if measured is not None else _logs(wanted)
    tracked = _tracking_options(options, logs, voltage, time)
    predicting = None if model is None else _model(model).actuator
    tracking = TrackingRun(
        tracked.scoring(predicting is not None), predicting, traced=True
    )
    reading = _reading(
        _column(time), options.pop("rows", None), options | {"sample_rate": sample_rate}
    )
    if not logs:
        first = "desired" if predicting is None else "voltage"
        signals = {first: wanted, "measured": measured}
        logs = [_pair(signals, voltage, time, reading.sample_rate, unit)]
    names = files.short_names(logs)
    for number, log in enumerate(logs, 1):
        shown: str | None = name
        if isinstance(log, Address):
            shown = names.get(log)
        elif len(logs) > 1:
            shown = f"{name} {number}"
        tracking.add(log, reading, tracked, shown, time=time)
    return tracking.result()


def _pair(
    signals: dict[str, Any],
    drive: Any,
    time: Any,
    sample_rate: float | None,
    unit: str | None,
) -> ArraySource:
    """Return two arrays as a log, and the drive beside them; refuse one alone (InputError)."""
    if signals["measured"] is None:
        raise InputError(
            "what was measured is missing: give two arrays, or a table or file with both columns"
        )
    if drive is not None and "voltage" not in signals:
        signals["voltage"] = drive
    units = {"desired": unit, "measured": unit}
    return ArraySource(signals, time, sample_rate, units=units)


def _column(time: Any) -> str | None:
    return str(time) if isinstance(time, str | int) else None


def _tracking_options(
    options: dict[str, Any], logs: Sequence[Any], voltage: Any, time: Any
) -> TrackingOptions:
    """Take what belongs to ``TrackingOptions`` out of the options of ``report``; the others remain."""
    from dbo_cli.runs.reporting import TrackingOptions

    known = {field.name for field in dataclasses.fields(TrackingOptions)}
    values = {key: options.pop(key) for key in known & options.keys()}
    if values.get("trajectory") is not None:
        if not logs or not all(isinstance(log, Address) for log in logs):
            raise UsageError(
                "`trajectory` belongs to a log in a file; of arrays, give both signals"
            )
        values["trajectory"] = request.parse_address(values["trajectory"])
    for role, column in {"voltage": voltage, "time": time}.items():
        if logs and not isinstance(column, str | int | None):
            raise UsageError(
                f"`{role}`: beside tables and files give the name or number of their column"
            )
    values["voltage"] = voltage if logs else None
    return TrackingOptions(**values)


def _model(model: Model | str | os.PathLike[str]) -> Model:
    """Return a model, read where it is a file's name; a set is refused."""
    if isinstance(model, Model):
        return model
    actuator = read_model_file(os.fspath(model))
    remarks = Remarks()
    warnings = actuator.fit.get("warnings")
    if isinstance(warnings, list):
        remarks.warnings.extend(warnings)
    return Model(actuator, remarks=remarks)


def _reading(
    time: str | None, rows: str | None, options: dict[str, Any]
) -> ReadingOptions:
    values = options | {
        "time": time,
        "rows": _parsed_rows(rows),
    }
    return record_of(ReadingOptions, values, "says nothing about reading a log")


def _logs(logs: Any) -> list[Any]:
    """Return the tables and files that were given, one or a list of them; none of anything else."""
    several = isinstance(logs, list | tuple) and all(map(is_log, logs))
    if is_log(logs) or several:
        return _addressed(logs)
    return []


def _addressed(logs: Any) -> list[Any]:
    """Return logs, one or a list of them, the names of files taken apart."""
    addressed = []
    for log in [logs] if is_log(logs) else logs:
        addressed.append(request.parse_address(log) if is_file(log) else log)
    return addressed
