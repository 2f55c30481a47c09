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
from dbo_cli.errors import DboError, InputError
from dbo_cli.hysteresis.identification import IdentificationOptions
from dbo_cli.hysteresis.model_set import ModelSet as SetFile
from dbo_cli.hysteresis.model_set import read_set, set_to_bytes
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.logs.addresses import check_document, parse_address
from dbo_cli.logs.channels import ChannelReader, channels_of
from dbo_cli.logs.column_names import TIME_NAMES
from dbo_cli.logs.columns import column_info
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.sources import TABLE, is_file, is_table
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.remarks import DboWarning
from dbo_cli.runs.channels import Columns
from dbo_cli.runs.identifying import Identified, RecordedLog, arguments_of, chosen_of, identify_recordings
from dbo_cli.runs.jobs import Outcome, Work, good_ones, run_jobs, summed_up
from dbo_cli.runs.model import Model

Floats = NDArray[np.float64]


class ModelSet(Mapping[str, Model]):
    """The models of many channels, by the channels' names and in their order.

    Parameters
    ----------
    models : mapping of str to Model
        The models.
    """

    def __init__(self, models: Mapping[str, Model]) -> None:
        self._models = dict(models)

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
        return set_to_bytes({channel: one.actuator for channel, one in self.items()})

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
        return self._over("simulate", "x", x, options)

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
        return Bank(models, sample_rate, states=states, dac=dac, **limits)

    def _over(self, verb: str, name: str, signals: ArrayLike, options: Mapping[str, Any]) -> Floats:
        matrix = np.asarray(signals)
        if matrix.ndim != 2 or matrix.shape[1] != len(self):
            raise InputError(f"`{name}`: has the shape {matrix.shape}; give (samples, {len(self)} channels)")
        columns, said = [], {}
        for place, (channel, model) in enumerate(self.items()):
            try:
                found = getattr(model, verb)(matrix[:, place], details=True, **options)
            except DboError as problem:
                raise type(problem)(f"channel {channel}: {problem}") from None
            columns.append(found.values)
            said[channel] = found.warnings
        for text in summed_up(said, "channel"):
            warnings.warn(text, DboWarning, stacklevel=3)
        if len({column.size for column in columns}) > 1:
            raise InputError("the channels' drives have different rows: compensate them one by one")
        return np.column_stack(columns)


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
) -> ModelSet:
    """Identify a model of each channel that patterns of columns name; ``record`` reads one of a log.

    Raises
    ------
    DboError
        As ``identify``, with the channel's name.
    """
    patterns = Columns.of(voltage=columns[0] or "", displacement=columns[1] or "")
    reading = ReadingOptions(time=time if isinstance(time, str) else None, sample_rate=sample_rate)
    known = read_model_set(prior) if prior is not None and not isinstance(prior, Mapping) else prior
    with contextlib.ExitStack() as stack:
        opened = [_Log(one, reading, patterns, stack) for one in [*logs, *validation]]
        channels = opened[0].channels
        for other in opened[1:]:
            if set(other.channels) != set(channels):
                raise InputError("the logs have other channels than the first one")

        def calls() -> Iterator[tuple[str, Callable[[], Identified]]]:
            for channel in channels:
                own = patterns.of_channel(channel)
                kept = None if known is None else known[channel].actuator
                read = [
                    record((one.of(channel),), time, sample_rate, kept, columns=tuple(own.values()))
                    for one in opened
                ]
                fit, checks = read[: len(logs)], read[len(logs) :]
                names = [str(one.record["name"]) for one in read]
                arguments = arguments_of(names[: len(logs)], names[len(logs) :], chosen_of(options) | own)
                yield channel, functools.partial(identify_recordings, fit, options, checks, arguments, kept)

        found, said = {}, {}
        for one in good_ones(run_jobs(calls(), jobs), Work(jobs), "channel", Outcome(), len(channels)):
            assert one.value is not None
            found[one.name] = Model(one.value.model, one.value.summary, one.value.remarks)
            said[one.name] = one.value.remarks.warnings
    for text in summed_up(said, "channel"):
        warnings.warn(text, DboWarning, stacklevel=3)
    return ModelSet(found)


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
    return ModelSet({channel: Model(found[channel]) for channel in found})
