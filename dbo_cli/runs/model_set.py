"""Model sets in Python: a model of each channel, used together."""

from __future__ import annotations

import contextlib
import functools
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli.drives.bank import Bank
from dbo_cli.errors import DboError, InputError, UsageError
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model_set import Coupling, read_set, set_to_bytes
from dbo_cli.hysteresis.model_set import ModelSet as SetFile
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.logs.addresses import check_document, parse_address
from dbo_cli.logs.channels import ChannelReader, channels_of
from dbo_cli.logs.columns import TIME_NAMES, column_info
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.sources import TABLE, is_file, is_table
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.remarks import DboWarning
from dbo_cli.runs.channels import Columns, common_rows
from dbo_cli.runs.coupled import Recordings, recordings_apart
from dbo_cli.runs.identifying import Identified, RecordedLog, arguments_of, chosen_of, identify_recordings
from dbo_cli.runs.jobs import Outcome, Work, good_ones, run_jobs, summed_up
from dbo_cli.runs.model import Model
from dbo_cli.runs.shared_shape import options_of_channel, shared_shape

Floats = NDArray[np.float64]


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
        models = {channel: one.actuator for channel, one in self.items()}
        limits = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew, "from_": from_}
        return Bank(models, sample_rate, states=states, dac=dac, coupling=self.coupling, **limits)

    def _over(self, verb: str, name: str, signals: ArrayLike, options: Mapping[str, Any]) -> Floats:
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


def identify_set(
    logs: Sequence[Any],
    validation: Sequence[Any],
    columns: tuple[str | None, str | None],
    time: Any,
    sample_rate: float | None,
    options: IdentificationOptions,
    prior: Any,
    jobs: int,
    *,
    record: Callable[..., RecordedLog],
    common_shape: bool = False,
    coupled: bool = False,
) -> ModelSet:
    """Identify a model of each channel that patterns of columns name; ``record`` reads one of a log.

    Raises
    ------
    DboError
        As ``identify``, with the channel's name.
    """
    patterns = Columns.of(voltage=columns[0] or "", displacement=columns[1] or "")
    if common_shape and prior is not None:
        raise UsageError("`shared_shape` and `prior` exclude each other: each is where the shape comes from")
    reading = ReadingOptions(time=time if isinstance(time, str) else None, sample_rate=sample_rate)
    known = read_model_set(prior) if prior is not None and not isinstance(prior, Mapping) else prior
    more = {"shared_shape": common_shape, "coupling": coupled}
    chosen = chosen_of(options) | {key: True for key, on in more.items() if on}
    with contextlib.ExitStack() as stack:
        opened = _opened([*logs, *validation], reading, patterns, stack)
        channels = opened[0].channels

        def read(channel: str) -> Recordings:
            own, kept = tuple(patterns.of_channel(channel).values()), kept_of(channel)
            made = [record((one.of(channel),), time, sample_rate, kept, columns=own) for one in opened]
            return made[: len(logs)], made[len(logs) :]

        def kept_of(channel: str) -> Any:
            return shape if known is None else known[channel].actuator

        def calls() -> Iterator[tuple[str, Callable[[], Identified]]]:
            for channel in channels:
                fit, checks = recordings(channel)
                arguments = arguments_of(_names(fit), _names(checks), chosen | patterns.of_channel(channel))
                words = (fit, options, checks, arguments, kept_of(channel))
                yield channel, functools.partial(identify_recordings, *words)

        shape: Any = None
        recordings: Callable[[str], Recordings] = read
        coupling = None
        if coupled:
            coupling, apart = recordings_apart({channel: read(channel) for channel in channels})
            recordings = apart.__getitem__
        if common_shape:
            arguments = arguments_of(_names(recordings(channels[0])[0]), [], chosen | dict(patterns.patterns))
            shape = shared_shape(channels, lambda one: recordings(one)[0], options, arguments, jobs).model
            options = options_of_channel(options)
        done = good_ones(run_jobs(calls(), jobs), Work(jobs), "channel", Outcome(), len(channels))
        found = {one.name: one.value for one in done if one.value is not None}
    models = {name: Model(one.model, one.summary, one.remarks) for name, one in found.items()}
    said = {name: model.warnings for name, model in models.items()}
    for text in summed_up(said, "channel"):
        warnings.warn(text, DboWarning, stacklevel=3)
    return ModelSet(models, coupling)


def _opened(
    logs: Sequence[Any], reading: ReadingOptions, patterns: Columns, stack: contextlib.ExitStack
) -> list[_Log]:
    """Open logs that all have the same channels (InputError where one has not)."""
    opened = [_Log(one, reading, patterns, stack) for one in logs]
    if any(set(one.channels) != set(opened[0].channels) for one in opened):
        raise InputError("the logs have other channels than the first one")
    return opened


def _names(logs: Sequence[RecordedLog]) -> list[str]:
    return [str(one.record["name"]) for one in logs]


class _Log:
    """A table or a file as the channels that patterns name."""

    def __init__(
        self, log: Any, reading: ReadingOptions, patterns: Columns, stack: contextlib.ExitStack
    ) -> None:
        self._log = log
        self._reader: ChannelReader | None = None
        if is_table(log):
            infos = [column_info(str(name), number) for number, name in enumerate(log.columns, 1)]
            taken = {one.number for one in infos if one.quantity.lower() in TIME_NAMES}
            self.channels = list(channels_of(TABLE, infos, patterns.patterns, taken))
        elif is_file(log):
            self._reader = ChannelReader(parse_address(log), reading, patterns.patterns, True)
            stack.callback(self._reader.close)
            self.channels = list(self._reader.channels)
        else:
            raise InputError("a log with many channels is a table or a file's name")

    def of(self, channel: str) -> Any:
        """Return what one channel is read from."""
        return self._log if self._reader is None else self._reader.log(channel)


def read_model_set(path: str | os.PathLike[str]) -> ModelSet:
    """Read a model set; every model of it is checked.

    Raises
    ------
    InputError, ModelError
        The file cannot be read, is no set, or contradicts itself; the message names file and key.
    """
    found: SetFile = read_set(os.fspath(path))
    return ModelSet({channel: Model(found[channel]) for channel in found}, found.coupling)
