"""Models and sets as programs in Python meet them: arrays in and out, with all that a command would do."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drives.compensation import Compensation
from dbo_cli.drives.model_run import ModelRun
from dbo_cli.errors import DboError, InputError, UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import model_to_bytes, read_state, state_to_bytes
from dbo_cli.hysteresis.model_set import Coupling, read_set, set_to_bytes
from dbo_cli.hysteresis.model_set import read_model as read_model_file
from dbo_cli.hysteresis.model_state import ModelState, Quantity, StartName
from dbo_cli.hysteresis.operators import Outside
from dbo_cli.logs.request import ALL_ROWS, Rows, check_document, parse_rows
from dbo_cli.logs.sources import is_log
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.records import dataclass
from dbo_cli.remarks import DboWarning, Remarks
from dbo_cli.runs.files import bring_to, quantity_wish, source_of, start_of, tracked_of, tracked_wishes
from dbo_cli.runs.jobs import Outcome, Work, summed_up

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from dbo_cli.drives.bank import Bank
    from dbo_cli.drives.controller import Controller
    from dbo_cli.drives.learning import Tracked
    from dbo_cli.runs.identifying import IdentifyRun

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
        Samples in which the drive's limits were met, or which lie outside the model's range.
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
        self, actuator: ActuatorModel, summary: list[str] | None = None, remarks: Remarks | None = None
    ) -> None:
        self.actuator = actuator
        self.summary = summary or []
        self.remarks = remarks or Remarks()

    def __repr__(self) -> str:
        """Return what the model turns into what."""
        a, b = self.input, self.output
        return f"<dbo Model, {self.direction}: {_named(a)} to {_named(b)}, {self.actuator.size}>"

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
        check_document(path, "a model", "json")
        write_whole(path, self.to_json())

    def save_state(self, state: ModelState, path: str | os.PathLike[str]) -> None:
        """Write a state of this model, for a later run to go on from.

        Parameters
        ----------
        state, path
            What a run returned or ``Controller.state`` holds, and where to, ``state.json``.
        """
        check_document(path, "a state", "json")
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
            The input, in the unit of ``input``; an inverse model reads it ahead by its delay.
        time, sample_rate
            Seconds of shape (samples,) or a column's name, or samples a second (Hz); needed by a model with
            lag, creep or delay.
        rows : str
            ``A:B``: the rows to answer, from 1; an inverse model reads what stands after them ahead.
        state
            ``auto``, ``empty``, ``full``, ``settled``, a state returned before, or a state file.
        outside : {"extend", "hold", "error"}
            Beyond the model's range: go on with the last slope, hold, or refuse.
        return_state : bool
            Also return the state after the last sample.
        details : bool
            Return a ``Result``; otherwise warnings go the way of Python's own (``DboWarning``).

        Returns
        -------
        array of shape (samples,), a pair of it and the state, or a Result

        Raises
        ------
        InputError
            The signal is no array of finite numbers, time is missing or goes backwards, or a sample is
            outside and that is refused.
        ModelError
            The state is of another model.
        UsageError
            No state is called so.
        """
        read, last = _rows_of(rows, self.direction == "inverse")
        want = {self.input.quantity: quantity_wish(self.input, option="x")}
        source = source_of(want, x, time=time, sample_rate=sample_rate, rows=read)
        bring_to(source, self.input.quantity, self.input, "the model")
        if outside not in OUTSIDE:
            raise UsageError(f"`outside`: '{outside}' is none of {', '.join(OUTSIDE)}")
        run = ModelRun(self.actuator, source, start_of(state, self.actuator), outside, last)
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

        Delay, limits and start are seen to: ``simulate`` of the drive gives the trajectory back, to rounding.

        Parameters
        ----------
        wanted : array_like of shape (samples,), DataFrame or file name
            The desired displacement, in the unit of ``output``.
        time, sample_rate
            As in ``simulate``; needed by ``max_slew``, too.
        rows : str
            ``A:B``: the rows to answer, from 1; what stands after them is only read ahead.
        tracked : table, file name, or pair of arrays (voltage, measured); or a list of these
            The last pass of this trajectory, recorded once or several times: the drive becomes the next one
            of a repeated move, better by what the recording shows.
        return_state, details
            As in ``simulate``.
        **options
            What ``DriveOptions`` knows: ``v_min``, ``v_max``, ``max_slew``, ``state``, ``periodic``, … With
            rows before or after the trajectory the drive is longer than it, and ``details`` has the times.

        Returns
        -------
        array of shape (samples,), a pair of it and the state, or a Result

        Raises
        ------
        InputError, ModelError, UsageError
            As in ``simulate``; the model is an inverse one; the limits are not in order.
        LimitError
            A limit was met and ``on_limit`` is ``error``, or the drive cannot begin within its limits.
        """
        from dbo_cli.drives.loops import compensation
        from dbo_cli.drives.options import DriveOptions

        state = start_of(options.get("state", "auto"), self.actuator)
        asked = record_of(DriveOptions, options | {"state": state}, "is no parameter of compensate")
        self.actuator.require("forward")
        read, last = _rows_of(rows, not (asked.periodic or np.size(tracked)))
        want = {self.output.quantity: quantity_wish(self.output, option="wanted", trajectory=True)}
        source = source_of(want, wanted, time=time, sample_rate=sample_rate, rows=read)
        bring_to(source, self.output.quantity, self.output, "the model")
        run = compensation(self.actuator, source, asked, _tracked(tracked, self.actuator), last)
        return _finished(run, return_state, details)

    def controller(self, sample_rate: float | None = None, **options: Any) -> Controller:
        """Return a controller that plans and commits one sample at a time.

        Parameters
        ----------
        sample_rate : float, optional
            Samples a second (Hz); needed by a model with lag or creep and by ``max_slew``.
        **options
            ``v_min``, ``v_max``, ``max_slew``, ``state`` and ``from_`` as in ``compensate``, and:
        dac : array_like, optional
            The voltage of every code of a digital-to-analogue converter, from code 0 on; codes are then
            planned, and the state follows the voltage of the code.
        ahead : bool
            A model with a delay needs what is wanted later; with ``ahead`` the caller passes that.
        lookahead : float or "auto"
            Seconds by which what is passed is wanted later, no less than the model needs (auto): dynamics
            and delay are undone from it. The controller's ``lookahead`` has the samples.

        Raises
        ------
        ModelError
            The model is an inverse one, or has a delay or dynamics and ``lookahead`` is not given.
        UsageError
            The rate is missing, the limits or the converter's curve are not in order, or ``lookahead`` is
            shorter than the model needs.
        """
        from dbo_cli.drives.controller import Controller

        options["state"] = start_of(options.get("state", "auto"), self.actuator)
        return Controller(self.actuator, sample_rate, **options)


OUTSIDE = ("extend", "hold", "error")


def read_model(path: str | os.PathLike[str]) -> Model:
    """Read a model file.

    Parameters
    ----------
    path
        The file, ``FILE::CHANNEL`` of a set, or ``-`` for standard input.

    Raises
    ------
    InputError, ModelError
        The file cannot be read, is no model, or contradicts itself; the message names file and key.
    """
    actuator = read_model_file(os.fspath(path))
    kept = actuator.fit.get("warnings")
    return Model(actuator, remarks=Remarks(warnings=list(kept) if isinstance(kept, list) else []))


def record_of(record: type[Record], given: Mapping[str, Any], what: str) -> Record:
    """Return a record of options, made of keywords that it knows (see ``require_known``)."""
    require_known(record, given, what)
    return record(**given)


def require_known(record: type[DataclassInstance], given: Mapping[str, Any], what: str) -> None:
    """Refuse keywords that are no fields of a record of options (UsageError, which lists the fields)."""
    known = {field.name for field in dataclasses.fields(record)}
    for name in given:
        if name not in known:
            raise UsageError(f"`{name}` {what}; there are: {', '.join(sorted(known))}")


def _rows_of(rows: str | None, ahead: bool) -> tuple[Rows, int | None]:
    """Return the rows to read and the last one to answer, where those after it are read ahead."""
    taken = ALL_ROWS if rows is None else parse_rows(rows)
    return ((taken[0], None), taken[1]) if ahead else (taken, None)


def _tracked(given: Any, model: ActuatorModel) -> list[Tracked]:
    """Return recordings of a pass, whatever form they have."""
    pair = isinstance(given, tuple) and len(given) == 2 and not any(map(is_log, given))
    found = []
    for number, one in enumerate([given] if pair or is_log(given) else given, start=1):
        signals = [one] if is_log(one) else one
        source = source_of(tracked_wishes(model), *signals, name=f"`tracked` {number}")
        with closing(source):
            found.append(tracked_of(source, model))
    return found


def _finished(run: ModelRun, return_state: bool, details: bool) -> Any:
    """Run to the end and return what was asked for."""
    with closing(run.source):
        responses = list(run.responses())
    if isinstance(run, Compensation):
        run.keep_history()
    values = np.concatenate([response.y for response in responses])
    remarks = run.remarks()
    assert run.state is not None
    run.state = dataclasses.replace(run.state, model=run.model.digest)
    if details:
        times = [response.time for response in responses if response.time is not None]
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
    return (values, run.state) if return_state else values


def _named(quantity: Quantity) -> str:
    return f"{quantity.quantity} {quantity.minimum:g} to {quantity.maximum:g}{quantity.suffix}"


# --- sets: a model of each channel, used together ---


class ModelSet(Mapping[str, Model]):
    """The models of many channels, by the channels' names and in their order.

    Parameters
    ----------
    models : mapping of str to Model
        The models.
    coupling : Coupling, optional
        How the channels show in each other (``identify`` with ``coupling``, or a set's file): ``simulate``,
        ``compensate`` and the controller take it into account, a single model does not.
    """

    def __init__(self, models: Mapping[str, Model], coupling: Coupling | None = None) -> None:
        self._models = dict(models)
        self.coupling = None if coupling is None else coupling.of(list(self._models))

    def __getitem__(self, channel: str) -> Model:
        """Return the model of a channel."""
        return self._models[channel]

    def __iter__(self) -> Iterator[str]:
        """Return the channels in their order."""
        return iter(self._models)

    def __len__(self) -> int:
        """Count the channels."""
        return len(self._models)

    def __repr__(self) -> str:
        """Return how many models there are."""
        return f"<dbo ModelSet of {len(self)} channels>"

    def to_json(self) -> bytes:
        """Return the file of the set (docs/model-file.md): the same models give the same bytes."""
        return set_to_bytes({channel: one.actuator for channel, one in self.items()}, self.coupling)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file of the set, whole or not at all.

        Parameters
        ----------
        path
            Where to, ``mirror.json``.

        Raises
        ------
        UsageError
            The name says another format.
        OutputError
            It cannot be written.
        """
        check_document(os.fspath(path), "a model", "json")
        write_whole(os.fspath(path), self.to_json())

    def simulate(self, x: ArrayLike, **options: Any) -> Floats:
        """Run each model over its column: ``Model.simulate`` of each.

        Parameters
        ----------
        x : array_like of shape (samples, channels)
            The inputs, in the order of the channels.
        **options
            As ``Model.simulate`` has them, the same for all.

        Returns
        -------
        array of shape (samples, channels)
        """
        found = self._over("simulate", "x", x, options)
        return found if self.coupling is None else self.coupling.together(found)

    def compensate(self, wanted: ArrayLike, **options: Any) -> Floats:
        """Return the drives that make every actuator follow its column: ``Model.compensate`` of each.

        Parameters
        ----------
        wanted : array_like of shape (samples, channels)
            The desired displacements, in the order of the channels.
        **options
            As ``Model.compensate`` has them, the same for all.

        Returns
        -------
        array of shape (rows, channels)
            With as many rows as samples, and those that ``approach``, ``lead`` and the like add.
        """
        if self.coupling is not None:
            wanted = self.coupling.apart(self._matrix("wanted", wanted))
        return self._over("compensate", "wanted", wanted, options)

    def controller(
        self,
        sample_rate: float | None = None,
        *,
        v_min: Any = None,
        v_max: Any = None,
        max_slew: Any = None,
        from_: Any = None,
        states: Mapping[str, ModelState] | None = None,
        dac: ArrayLike | None = None,
    ) -> Bank:
        """Return a bank that plans and commits a frame at a time, one call of the kernel for all channels.

        Parameters
        ----------
        sample_rate : float, optional
            Frames a second (Hz); needed by models with lag or creep and by ``max_slew``.
        v_min, v_max, max_slew, from_ : float, sequence or mapping, optional
            As in ``Model.compensate``: one for all, one a channel, or by channel.
        states : mapping of str to ModelState, optional
            The state of each channel to go on from.
        dac : array_like, optional
            The voltage of every code of the converter that all channels have, from code 0 on.

        Raises
        ------
        ModelError, UsageError
            As for ``Model.controller``, with the channel's name.
        """
        from dbo_cli.drives.bank import Bank

        models = {channel: one.actuator for channel, one in self.items()}
        limits = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew, "from_": from_}
        return Bank(models, sample_rate, states=states, dac=dac, coupling=self.coupling, **limits)

    def _over(self, verb: str, name: str, signals: ArrayLike, options: Mapping[str, Any]) -> Floats:
        from dbo_cli.runs.channels import common_rows

        matrix = self._matrix(name, signals)
        columns, times, said = [], [], {}
        for place, (channel, model) in enumerate(self.items()):
            try:
                found = getattr(model, verb)(matrix[:, place], details=True, **options)
            except DboError as problem:
                raise type(problem)(f"channel {channel}: {problem}") from None
            columns.append(found.values)
            times.append(found.time)
            said[channel] = found.warnings
        for text in summed_up(said, "channel"):
            warnings.warn(text, DboWarning, stacklevel=3)
        if len({column.size for column in columns}) > 1:
            places = common_rows(times)
            if places is None or "state" in options:
                raise InputError("the channels' drives have different rows: compensate them one by one")
            columns = [np.pad(one, place, "edge") for one, place in zip(columns, places[1], strict=True)]
        return np.column_stack(columns)

    def _matrix(self, name: str, signals: ArrayLike) -> NDArray[Any]:
        matrix = np.asarray(signals)
        if matrix.ndim != 2 or matrix.shape[1] != len(self):
            raise InputError(f"`{name}`: has the shape {matrix.shape}; give (samples, {len(self)} channels)")
        return matrix


def identify_set(asked: IdentifyRun, jobs: int) -> ModelSet:
    """Identify a model of each channel that patterns of columns name.

    Raises
    ------
    DboError
        As ``identify``, with the channel's name.
    """
    from dbo_cli.runs.channel_models import fits_of_channels

    found, coupling = fits_of_channels(asked, Work(jobs, all_needed=True), Outcome())
    models = {name: Model(one.model, one.summary, one.remarks) for name, one in found.items()}
    for text in summed_up({name: model.warnings for name, model in models.items()}, "channel"):
        warnings.warn(text, DboWarning, stacklevel=4)
    return ModelSet(models, coupling)


def read_model_set(path: str | os.PathLike[str]) -> ModelSet:
    """Read a model set; every model of it is checked.

    Raises
    ------
    InputError, ModelError
        The file cannot be read, is no set, or contradicts itself; the message names file and key.
    """
    found = read_set(os.fspath(path))
    return ModelSet({channel: Model(found[channel]) for channel in found}, found.coupling)
