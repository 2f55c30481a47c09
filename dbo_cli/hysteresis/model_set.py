"""Sets of models: one file with the model of every channel of a mirror, a stage or a bank of actuators.

A set is ``{"format": "dbo-model-set", "version": 1, "models": {CHANNEL: a model file's object, ...}}``
(docs/model-file.md); where the channels were found to be coupled, version 2, with ``"coupling"``.
``FILE::CHANNEL`` names one model of it wherever a model is asked for.
"""

from __future__ import annotations

import functools
import json
import os
import re
from collections.abc import Iterator, Mapping

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis.coupling import Coupling, read_coupling
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import (
    MODEL_FORMAT,
    SET_FORMAT,
    Node,
    checked_version,
    document_bytes,
    load_document,
    model_of,
    model_values,
)
from dbo_cli.hysteresis.model_file import read_model as read_single_model

SET_VERSION = 2  # of a set with a coupling; 1 of one without, which older programs read, too
_LISTED = 10  # channels that a message names at most
_HEAD = re.compile(rb'(\xef\xbb\xbf)?\s*\{\s*"format":\s*"' + SET_FORMAT.encode() + rb'"')


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
        self._last = channel, model_of(checked_version(node))
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


def read_model(path: str) -> ActuatorModel:
    """Read a model file, or one model of a set (``FILE::CHANNEL``); ``-`` is standard input.

    Raises
    ------
    InputError
        The file cannot be read, or the set has no such channel.
    ModelError
        It is not a model, of a newer version, or contradicts itself; the message names file and key.
    """
    file, separator, channel = path.partition("::")
    if separator and not os.path.exists(path):
        return read_set(file)[channel]
    if not os.path.isfile(path):
        return read_single_model(path)
    found = os.stat(path)
    return _single(path, found.st_mtime_ns, found.st_size)


@functools.lru_cache(maxsize=1)  # a thousand files are run over one model
def _single(path: str, changed: int, size: int) -> ActuatorModel:
    return read_single_model(path)


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
    root = load_document(path, SET_FORMAT, "model set", SET_VERSION)
    root.only(("format", "version", "models"), ("coupling",) if root.values["version"] > 1 else ())
    if not root.node("models").values:
        raise root.refuse("models", "holds no model")
    return ModelSet(root)


def is_set(path: str) -> bool:
    """Tell whether a file begins as a model set does; a pipe is not read."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            return _HEAD.match(file.read(200)) is not None
    except OSError:
        return False


def set_to_bytes(models: Mapping[str, ActuatorModel], coupling: Coupling | None = None) -> bytes:
    """Return the file of a set of models, and how they are coupled: the same models give the same bytes.

    Raises
    ------
    ModelError
        There are none.
    """
    if not models:
        raise ModelError("a set of no models would be written")
    held = {channel: model_values(model) for channel, model in models.items()}
    if coupling is None:
        return document_bytes({"format": SET_FORMAT, "version": 1, "models": held})
    shown = coupling.of(list(models)).values()
    return document_bytes({"format": SET_FORMAT, "version": SET_VERSION, "models": held, "coupling": shown})


def shortened(channels: list[str]) -> str:
    """Name channels in a message: all of a few, the first and the number of many."""
    if len(channels) <= _LISTED:
        return ", ".join(channels)
    return f"{', '.join(channels[: _LISTED - 2])}, … {channels[-1]}: {len(channels):,} in all"
