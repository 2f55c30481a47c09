"""Sets of models: one file with the model of every channel of a mirror, a stage or a bank of actuators.

A set is ``{"format": "dbo-model-set", "version": 1, "models": {CHANNEL: a model file's
object, ...}}`` (docs/model-file.md); where the channels were found to be coupled,
version 2, with ``"coupling"``. ``FILE::CHANNEL`` names one model of it wherever a model
is asked for.

Coupling: what each actuator moves shows, in part, in the displacement of others. ``y -
r = C (u - r)``: y is what the sensors of all channels show, u what each actuator would
show if the others stood at their reference r, and C has ones on its diagonal. It is
static: a frame has no memory.
"""

from __future__ import annotations

import functools
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np

from dbo_cli.errors import InputError, ModelError
from dbo_cli.hysteresis import model_file
from dbo_cli.hysteresis.kernel import Floats
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import MODEL_FORMAT, SET_FORMAT, Node

MOST_CONDITION = 100.0
"""Of the matrix, in strokes of the channels: undoing it may make a model's error and the sensors' noise
larger by so much, and of an error of 0.1 % of the stroke that leaves 10 %.
"""


@dataclass(frozen=True)
class Coupling:
    """Static gains between channels.

    Attributes
    ----------
    channels : tuple of str
        In the order of the arrays.
    gains : array of shape (channels, channels)
        Row: the channel in which it shows; column: the actuator that moves; ones on the
        diagonal.
    reference : array of shape (channels,)
        Displacement of each channel at which it shows in no other.
    strokes : array of shape (channels,)
        What each channel reaches, for the condition number alone.

    Raises
    ------
    ModelError
        The matrix cannot be undone, or only with errors that grow more than
        ``MOST_CONDITION`` times.
    """

    channels: tuple[str, ...]
    gains: Floats
    reference: Floats
    strokes: Floats

    def __post_init__(self) -> None:
        """Refuse what cannot be undone."""
        if not self.condition <= MOST_CONDITION:
            size = (
                f"{self.condition:.3g}"
                if self.condition < 1e15
                else "infinite: it is singular"
            )
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
            tuple(channels),
            self.gains[np.ix_(order, order)],
            self.reference[order],
            self.strokes[order],
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
        gain, moving, where = self.largest
        pairs = len(self.channels) * (len(self.channels) - 1)
        return (
            f"coupling: {self.count:,} of {pairs:,} gains are not 0; largest: "
            f"{moving} shows in {where}, {100.0 * gain:.3g} %; condition number {self.condition:.3g}"
        )

    def values(self) -> dict[str, Any]:
        """Return the keys and values of a file: the gains in each channel by the actuators that move."""
        shown = {
            channel: {
                moving: float(self.gains[row, column])
                for column, moving in enumerate(self.channels)
                if column != row and self.gains[row, column]
            }
            for row, channel in enumerate(self.channels)
        }
        reference = dict(zip(self.channels, self.reference.tolist(), strict=True))
        return {
            "reference": reference,
            "gains": {channel: gains for channel, gains in shown.items() if gains},
        }


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
                raise root.refuse(
                    place, f"there is no model of channel {json.dumps(channel)}"
                )
        return node

    reference = known(root.node("reference"), "reference")
    reference.only(tuple(strokes))
    gains = np.eye(len(strokes))
    rows = known(root.node("gains"), "gains")
    for channel in rows.values:
        shown = known(rows.node(channel), f"gains.{channel}")
        for moving in shown.values:
            if moving == channel:
                raise shown.refuse(
                    moving, "is the gain of a channel in itself, which is 1"
                )
            gains[order[channel], order[moving]] = shown.number(moving)
    at_rest = np.array([reference.number(channel) for channel in strokes])
    coupling: Coupling = root.build(
        lambda: Coupling(
            tuple(strokes), gains, at_rest, np.array(list(strokes.values()))
        )
    )
    return coupling


# of a set with a coupling; 1 of one without, which older programs read, too
SET_VERSION = 2
_LISTED = 10  # channels that a message names at most


class ModelSet(Mapping[str, ActuatorModel]):
    """The models of a file by their channels, in the file's order.

    A model is made when it is asked for. The file is read as a whole when something
    else is asked for, or a channel that ``member_text`` does not find.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        # asked for a thousand times by as many files
        self._last: tuple[str, ActuatorModel] | None = None

    @functools.cached_property
    def _root(self) -> Node:
        """The file, read as a whole (InputError, ModelError)."""
        root = model_file.load_document(self.file, SET_FORMAT, "model set", SET_VERSION)
        root.only(
            ("format", "version", "models"),
            ("coupling",) if root.values["version"] > 1 else (),
        )
        if not root.node("models").values:
            raise root.refuse("models", "holds no model")
        return root

    @functools.cached_property
    def _models(self) -> Node:
        """The models, not yet checked."""
        return self._root.node("models")

    def __getitem__(self, channel: str) -> ActuatorModel:
        """Return the model of a channel (InputError where there is none, ModelError where it is wrong)."""
        if self._last is not None and self._last[0] == channel:
            return self._last[1]
        # A channel may hold any sign: the place is spelled as JSON spells the key.
        node = Node(
            self.file, f"models[{json.dumps(channel)}]", self._values_of(channel)
        )
        if node.values.get("format") != MODEL_FORMAT:
            raise node.refuse("format", f'must be "{MODEL_FORMAT}"')
        self._last = channel, model_file.model_of(model_file.checked_version(node))
        return self._last[1]

    def _values_of(self, channel: str) -> Any:
        """Return the object of a channel's model, as the file has it."""
        if "_root" not in self.__dict__:
            text = member_text(self.file, channel)
            if text is not None:
                return model_file.parsed(self.file, text)
        if channel not in self._models.values:
            raise InputError(
                f"{self.file}: there is no model of channel '{channel}' ({shortened(list(self))})"
            )
        return self._models.node(channel).values

    @functools.cached_property
    def coupling(self) -> Coupling | None:
        """How the channels show in each other, where that was identified (ModelError where it is wrong)."""
        if "coupling" not in self._root.values:
            return None
        strokes = {channel: model.output.span for channel, model in self.items()}
        return read_coupling(self._root.node("coupling"), strokes)

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
        status = os.stat(path)
    except OSError as problem:
        raise InputError(
            f"{path}: cannot be read: {problem.strerror or problem}"
        ) from None
    return _unchanged(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=1)
def _unchanged(path: str, changed: int, size: int) -> ModelSet:
    return ModelSet(path)


# --- one model of a large file ---

_HEAD = re.compile(
    rb'\{\n  "format": "dbo-model-set",\n  "version": 1,\n  "models": \{(?=\n)'
)
_TAIL = b"\n  }\n}\n"
_MEMBER = re.compile(
    rb'\n    ("(?:[^"\\\n]|\\.)*"): (?=\{\n      "format": "dbo-model",\n)'
)
"""The beginning of a set that ``set_to_bytes`` wrote, its end, and the line with which a model begins."""

_END_OF_MEMBER = re.compile(rb"\n    \}(?:,(?=\n    \")|(?=\n  \}\n\}\n))")
_PIECE = 1 << 16
"""Bytes: what is read at once of a file; a model of 80 slopes has 24,000."""


def member_text(path: str, channel: str) -> str | None:
    """Return the JSON text of one model of a set, without reading the others.

    Looks by halves in a file that ``set_to_bytes`` wrote: a line with a channel begins
    with four spaces, which no other line does, and the channels stand in their natural
    order (2 before 10). None where the file is another, or the channel is not there:
    then it has to be read as a whole.
    """
    try:
        with open(path, "rb") as file:
            return _found_by_halves(file, channel)
    except (OSError, ValueError):
        return None


def _found_by_halves(file: BinaryIO, channel: str) -> str | None:
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = _HEAD.match(file.read(200))
    file.seek(max(size - len(_TAIL), 0))
    if head is None or file.read() != _TAIL:
        return None
    begin, end, wanted = head.end(), size - len(_TAIL), _natural(channel)
    while begin < end:
        middle = (begin + end) // 2 if end - begin > _PIECE else begin
        member = _next_member(file, middle, end)
        if member is None:
            if middle == begin:
                return None
            end = middle
            continue
        name, place = member
        if name == channel:
            return _text_from(file, place)
        if middle == begin or _natural(name) < wanted:
            begin = place
        else:
            end = middle
    return None


def _next_member(file: BinaryIO, begin: int, end: int) -> tuple[str, int] | None:
    """Return the name of the first model that begins between two places, and where its object begins."""
    read, place = b"", begin
    while place < end:
        file.seek(place)
        piece = file.read(_PIECE)
        if not piece:
            return None
        read += piece
        place += len(piece)
        match = _MEMBER.search(read)
        if match is not None:
            if begin + match.start() >= end:
                return None
            return json.loads(match[1]), begin + match.end()
    return None


def _text_from(file: BinaryIO, begin: int) -> str | None:
    """Return the text of the object that begins at a place."""
    read = b""
    file.seek(begin)
    while piece := file.read(_PIECE):
        read += piece
        match = _END_OF_MEMBER.search(read)
        if match is not None:
            return read[: match.start()].decode("utf-8") + "\n    }"
    return None


def _natural(channel: str) -> list[tuple[bool, int, str]]:
    """Return what sorts names so that 2 comes before 10."""
    parts = re.split(r"([0-9]+)", channel)
    return [
        (part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts
    ]


def set_to_bytes(
    models: Mapping[str, ActuatorModel], coupling: Coupling | None = None
) -> bytes:
    """Return the file of a set of models, and how they are coupled: the same models give the same bytes.

    Raises
    ------
    ModelError
        There are none.
    """
    if not models:
        raise ModelError("a set of no models would be written")
    values = {
        channel: model_file.model_values(model) for channel, model in models.items()
    }
    if coupling is None:
        return model_file.document_bytes(
            {"format": SET_FORMAT, "version": 1, "models": values}
        )
    shown = coupling.of(list(models)).values()
    return model_file.document_bytes(
        {
            "format": SET_FORMAT,
            "version": SET_VERSION,
            "models": values,
            "coupling": shown,
        }
    )


def shortened(channels: list[str]) -> str:
    """Name channels in a message: all of a few, the first and the number of many."""
    if len(channels) <= _LISTED:
        return ", ".join(channels)
    return f"{', '.join(channels[: _LISTED - 2])}, … {channels[-1]}: {len(channels):,} in all"
