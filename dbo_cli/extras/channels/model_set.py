"""Sets of models: one file with the model of every channel of a mirror, a stage or a bank of actuators.

A set is ``{"format": "dbo-model-set", "version": 1, "models": {CHANNEL: a model file's object, ...}}``
(docs/model-file.md); where the channels were found to be coupled, version 2, with ``"coupling"``.
``FILE::CHANNEL`` names one model of it wherever a model is asked for.

Coupling: what each actuator moves shows, in part, in the displacement of others. ``y - r = C (u - r)``: y is
what the sensors of all channels show, u what each actuator would show if the others stood at their reference
r, and C has ones on its diagonal. It is static: a frame has no memory.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import model_file
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import MODEL_FORMAT, SET_FORMAT, Node

MOST_CONDITION = 100.0
"""Of the matrix, in strokes of the channels: undoing it may make a model's error and the sensors' noise
larger by so much, and of an error of 0.1 % of the stroke that leaves 10 %."""


@dataclass(frozen=True)
class Coupling:
    """Static gains between channels.

    Attributes
    ----------
    channels : tuple of str
        In the order of the arrays.
    gains : array of shape (channels, channels)
        Row: the channel in which it shows; column: the actuator that moves; ones on the diagonal.
    reference : array of shape (channels,)
        Displacement of each channel at which it shows in no other.
    strokes : array of shape (channels,)
        What each channel reaches, for the condition number alone.

    Raises
    ------
    ModelError
        The matrix cannot be undone, or only with errors that grow more than ``MOST_CONDITION`` times.
    """

    channels: tuple[str, ...]
    gains: Floats
    reference: Floats
    strokes: Floats

    def __post_init__(self) -> None:
        """Refuse what cannot be undone."""
        if not self.condition <= MOST_CONDITION:
            size = f"{self.condition:.3g}" if self.condition < 1e15 else "infinite: it is singular"
            raise ModelError(
                f"coupling: the condition number of the gains is {size}; above {MOST_CONDITION:g} solving "
                "for all channels makes their errors as much larger (leave out one that moves like others)"
            )

    @cached_property
    def condition(self) -> float:
        """Condition number of the gains, each in strokes of its channels."""
        return float(np.linalg.cond(self.gains / self.strokes[:, None] * self.strokes))

    @cached_property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.inv(self.gains), dtype=np.float64)

    def apart(self, together: Floats) -> Floats:
        """Return what each actuator does alone where the sensors show ``together`` (..., channels)."""
        return self.reference + (together - self.reference) @ self._inverse.T

    def together(self, apart: Floats) -> Floats:
        """Return what the sensors show of what each actuator does alone (..., channels)."""
        return self.reference + (apart - self.reference) @ self.gains.T

    def of(self, channels: Sequence[str]) -> Coupling:
        """Return the same in another order of the channels; all have to be there (InputError)."""
        missing = [channel for channel in self.channels if channel not in set(channels)]
        if missing:
            more = f" and {len(missing) - 1:,} more" if len(missing) > 1 else ""
            raise InputError(
                f"the models are coupled, so that all {len(self.channels):,} channels are needed at once: "
                f"channel {missing[0]}{more} is missing"
            )
        place = {channel: number for number, channel in enumerate(self.channels)}
        order = [place[channel] for channel in channels]
        return Coupling(
            tuple(channels), self.gains[np.ix_(order, order)], self.reference[order], self.strokes[order]
        )

    @cached_property
    def largest(self) -> tuple[float, str, str]:
        """The gain farthest from 0 off the diagonal, the channel that moves and the one in which it shows."""
        size = np.abs(self.gains / self.strokes[:, None] * self.strokes) * ~np.eye(
            len(self.channels), dtype=bool
        )
        row, column = np.unravel_index(int(np.argmax(size)), size.shape)
        return float(self.gains[row, column]), self.channels[column], self.channels[row]

    @property
    def count(self) -> int:
        """Pairs of channels of which one shows in the other."""
        return int(np.count_nonzero(self.gains)) - len(self.channels)

    def summary(self) -> str:
        """Say in one line what it is."""
        if not self.count:
            return "coupling: no channel shows in another"
        gain, moving, seen = self.largest
        pairs = len(self.channels) * (len(self.channels) - 1)
        return (
            f"coupling: {self.count:,} of {pairs:,} gains are not 0; largest: "
            f"{moving} shows in {seen}, {100.0 * gain:.3g} %; condition number {self.condition:.3g}"
        )

    def values(self) -> dict[str, Any]:
        """Return the keys and values of a file: the gains in each channel by the actuators that move."""
        shown = {
            channel: {
                other: float(self.gains[row, column])
                for column, other in enumerate(self.channels)
                if column != row and self.gains[row, column]
            }
            for row, channel in enumerate(self.channels)
        }
        reference = dict(zip(self.channels, self.reference.tolist(), strict=True))
        return {"reference": reference, "gains": {channel: own for channel, own in shown.items() if own}}


def read_coupling(root: Any, strokes: Mapping[str, float]) -> Coupling:
    """Return the coupling that a node of a set's file describes (ModelError, with the key that is wrong).

    Parameters
    ----------
    root
        The node (``model_file.Node``).
    strokes
        Of the set's channels, in their order.
    """
    root.only(("reference", "gains"))
    order = {channel: number for number, channel in enumerate(strokes)}

    def known(node: Any, place: str) -> Any:
        for channel in node.values:
            if channel not in order:
                raise root.refuse(place, f"there is no model of channel {json.dumps(channel)}")
        return node

    reference = known(root.node("reference"), "reference")
    reference.only(tuple(strokes))
    gains = np.eye(len(strokes))
    rows = known(root.node("gains"), "gains")
    for channel in rows.values:
        shown = known(rows.node(channel), f"gains.{channel}")
        for other in shown.values:
            if other == channel:
                raise shown.refuse(other, "is the gain of a channel in itself, which is 1")
            gains[order[channel], order[other]] = shown.number(other)
    at_rest = np.array([reference.number(channel) for channel in strokes])
    found: Coupling = root.build(
        lambda: Coupling(tuple(strokes), gains, at_rest, np.array(list(strokes.values())))
    )
    return found


SET_VERSION = 2  # of a set with a coupling; 1 of one without, which older programs read, too
_LISTED = 10  # channels that a message names at most


class ModelSet(Mapping[str, ActuatorModel]):
    """The models of a file by their channels, in the file's order; each is checked when it is asked for."""

    def __init__(self, root: Node) -> None:
        self.file = root.file
        self._models = root.node("models")
        self._coupling = root.node("coupling") if "coupling" in root.values else None
        self._last: tuple[str, ActuatorModel] | None = None  # asked for a thousand times by as many files

    def __getitem__(self, channel: str) -> ActuatorModel:
        """Return the model of a channel (InputError where there is none, ModelError where it is wrong)."""
        if self._last is not None and self._last[0] == channel:
            return self._last[1]
        if channel not in self._models.values:
            raise InputError(
                f"{self.file}: there is no model of channel '{channel}' ({shortened(list(self))})"
            )
        # A channel may hold any sign: the place is spelled as JSON spells the key.
        node = Node(self.file, f"models[{json.dumps(channel)}]", self._models.node(channel).values)
        if node.values.get("format") != MODEL_FORMAT:
            raise node.refuse("format", f'must be "{MODEL_FORMAT}"')
        self._last = channel, model_file.model_of(model_file.checked_version(node))
        return self._last[1]

    @functools.cached_property
    def coupling(self) -> Coupling | None:
        """How the channels show in each other, where that was identified (ModelError where it is wrong)."""
        if self._coupling is None:
            return None
        return read_coupling(self._coupling, {channel: one.output.span for channel, one in self.items()})

    def __contains__(self, channel: object) -> bool:
        """Tell whether there is a model of a channel."""
        return channel in self._models.values

    def __iter__(self) -> Iterator[str]:
        """Return the channels."""
        return iter(self._models.values)

    def __len__(self) -> int:
        """Count the channels."""
        return len(self._models.values)


def read_set(path: str) -> ModelSet:
    """Read a model set; a file that has not changed is not read again.

    Raises
    ------
    InputError, ModelError
        As for ``read_model``.
    """
    try:
        found = os.stat(path)
    except OSError as problem:
        raise InputError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    return _parsed(path, found.st_mtime_ns, found.st_size)


@functools.lru_cache(maxsize=1)
def _parsed(path: str, changed: int, size: int) -> ModelSet:
    root = model_file.load_document(path, SET_FORMAT, "model set", SET_VERSION)
    root.only(("format", "version", "models"), ("coupling",) if root.values["version"] > 1 else ())
    if not root.node("models").values:
        raise root.refuse("models", "holds no model")
    return ModelSet(root)


def set_to_bytes(models: Mapping[str, ActuatorModel], coupling: Coupling | None = None) -> bytes:
    """Return the file of a set of models, and how they are coupled: the same models give the same bytes.

    Raises
    ------
    ModelError
        There are none.
    """
    if not models:
        raise ModelError("a set of no models would be written")
    held = {channel: model_file.model_values(model) for channel, model in models.items()}
    if coupling is None:
        return model_file.document_bytes({"format": SET_FORMAT, "version": 1, "models": held})
    shown = coupling.of(list(models)).values()
    return model_file.document_bytes(
        {"format": SET_FORMAT, "version": SET_VERSION, "models": held, "coupling": shown}
    )


def shortened(channels: list[str]) -> str:
    """Name channels in a message: all of a few, the first and the number of many."""
    if len(channels) <= _LISTED:
        return ", ".join(channels)
    return f"{', '.join(channels[: _LISTED - 2])}, … {channels[-1]}: {len(channels):,} in all"
