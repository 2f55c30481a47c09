"""Sets of models in Python: a model of each channel, used together."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dbo_cli import extensions
from dbo_cli.drives.options import require_one_unit
from dbo_cli.errors import DboError, DboWarning, InputError
from dbo_cli.extras.channels import model_set
from dbo_cli.extras.channels.model_set import Coupling, set_to_bytes
from dbo_cli.extras.channels.models import fits_of_channels
from dbo_cli.extras.channels.signals import common_rows
from dbo_cli.hysteresis.model_state import ModelState
from dbo_cli.logs import request
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.runs.api import Floats, Model
from dbo_cli.runs.identifying import IdentifyRun
from dbo_cli.runs.jobs import Outcome, Work, summed_up

if TYPE_CHECKING:
    from dbo_cli.extras.live.bank import Bank


class ModelSet(Mapping[str, Model]):
    """The models of many channels, by the channels' names and in their order.

    Parameters
    ----------
    models : mapping of str to Model
        The models.
    coupling : Coupling, optional
        How the channels show in each other (``identify`` with ``coupling``, or a set's
        file): ``simulate``, ``compensate`` and the controller take it into account, a
        single model does not.
    """

    def __init__(
        self, models: Mapping[str, Model], coupling: Coupling | None = None
    ) -> None:
        self._models = models if isinstance(models, _ModelsOfFile) else dict(models)
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
        return set_to_bytes(
            {channel: model.actuator for channel, model in self.items()}, self.coupling
        )

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
        request.check_document(os.fspath(path), "a model", "json")
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
        results = self._over("simulate", "x", x, options)
        return results if self.coupling is None else self.coupling.together(results)

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
            With as many rows as samples, and those that ``approach``, ``lead`` and the
            like add.
        """
        self._require_one_unit(options)
        if self.coupling is not None:
            wanted = self.coupling.apart(self._matrix("wanted", wanted))
        return self._over("compensate", "wanted", wanted, options)

    def _require_one_unit(self, limits: Mapping[str, Any]) -> None:
        """Refuse plain limits for all channels where their drives have different units (UsageError)."""
        names = ("v_min", "v_max", "max_slew", "from_")
        typed = {name: limits.get(name) for name in names}
        for_all = {
            name: limit
            for name, limit in typed.items()
            if isinstance(limit, str | float | int)
        }
        units = {channel: model.actuator.drive.unit for channel, model in self.items()}
        require_one_unit(units, **for_all)

    def controller(
        self,
        sample_rate: float | None = None,
        *,
        v_min: Any = None,
        v_max: Any = None,
        max_slew: Any = None,
        extrapolate: bool = False,
        from_: Any = None,
        states: Mapping[str, ModelState] | None = None,
        dac: ArrayLike | None = None,
    ) -> Bank:
        """Return a bank that plans and commits a frame at a time, one call of the kernel for all channels.

        Parameters
        ----------
        sample_rate : float, optional
            Frames a second (Hz); needed by models with lag or creep and by
            ``max_slew``.
        v_min, v_max, max_slew, from_ : float, sequence or mapping, optional
            As in ``Model.compensate``: one for all, one a channel, or by channel.
        extrapolate : bool
            Go beyond the range on which a model was identified, as far as the limits
            say.
        states : mapping of str to ModelState, optional
            The state of each channel to go on from.
        dac : array_like, optional
            The voltage of every code of the converter that all channels have, from code
            0 on.

        Raises
        ------
        ModelError, UsageError
            As for ``Model.controller``, with the channel's name.
        """
        models = {channel: model.actuator for channel, model in self.items()}
        limits = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew, "from_": from_}
        self._require_one_unit(limits)
        limits["extrapolate"] = extrapolate
        bank: Bank = extensions.find("run", "control a set")(
            models,
            sample_rate,
            states=states,
            dac=dac,
            coupling=self.coupling,
            **limits,
        )
        return bank

    def _over(
        self, verb: str, name: str, signals: ArrayLike, options: Mapping[str, Any]
    ) -> Floats:
        matrix = self._matrix(name, signals)
        columns, times, said = [], [], {}
        for place, (channel, model) in enumerate(self.items()):
            try:
                result = getattr(model, verb)(matrix[:, place], details=True, **options)
            except DboError as problem:
                raise type(problem)(f"channel {channel}: {problem}") from None
            columns.append(result.values)
            times.append(result.time)
            said[channel] = result.warnings
        for text in summed_up(said, "channel"):
            warnings.warn(text, DboWarning, stacklevel=3)
        if len({column.size for column in columns}) > 1:
            places = common_rows(times)
            if places is None or "state" in options:
                raise InputError(
                    "the channels' drives have different rows: compensate them one by one"
                )
            columns = [
                np.pad(column, place, "edge")
                for column, place in zip(columns, places[1], strict=True)
            ]
        return np.column_stack(columns)

    def _matrix(self, name: str, signals: ArrayLike) -> NDArray[Any]:
        matrix = np.asarray(signals)
        if matrix.ndim != 2 or matrix.shape[1] != len(self):
            raise InputError(
                f"`{name}`: has the shape {matrix.shape}; give (samples, {len(self)} channels)"
            )
        return matrix


class _ModelsOfFile(Mapping[str, Model]):
    """The models of a set's file, each made when it is first asked for."""

    def __init__(self, models: model_set.ModelSet) -> None:
        self._file = models
        self._made: dict[str, Model] = {}

    def __getitem__(self, channel: str) -> Model:
        if channel not in self._made:
            if channel not in self._file:
                raise KeyError(channel)
            self._made[channel] = Model(self._file[channel])
        return self._made[channel]

    def __iter__(self) -> Iterator[str]:
        return iter(self._file)

    def __len__(self) -> int:
        return len(self._file)


def set_of(models: model_set.ModelSet) -> ModelSet:
    """Return the set of a file as Python knows it."""
    return ModelSet(_ModelsOfFile(models), models.coupling)


def identify_set(run: IdentifyRun, jobs: int) -> ModelSet:
    """Identify a model of each channel that the patterns of columns name, in so many processes."""
    fits, coupling = fits_of_channels(run, Work(jobs, all_needed=True), Outcome())
    models = {
        channel: Model(fit.model, fit.summary, fit.remarks)
        for channel, fit in fits.items()
    }
    messages = {channel: model.warnings for channel, model in models.items()}
    for text in summed_up(messages, "channel"):
        warnings.warn(text, DboWarning, stacklevel=4)
    return ModelSet(models, coupling)
