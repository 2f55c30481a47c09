"""The table where the core and the extras meet: what each extra brings, and where it is found.

An extra is one thing that the program can do besides its core: a folder of
``dbo_cli/extras``, or a package of somebody else that announces an ``Extra`` under the
entry point ``dbo_cli.extras``. The core asks this table for a thing by its kind and
key, and the module that has it is imported then. Nothing else in the core knows what
extras there are, so that an installation without ``dbo_cli/extras`` is a whole program.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal

from dbo_cli.errors import UsageError

ENTRY_POINTS = "dbo_cli.extras"
"""The group of entry points under which other packages announce an ``Extra``."""

Kind = Literal["command", "option", "api", "run", "model", "reader", "generator"]
"""What an extra can bring:

- ``command``: a ``cli.commands.Command``; the key is its name.
- ``option``: a ``cli.options.Option`` of a command of the core; the key is ``COMMAND
  --OPTION``.
- ``api``: a public name of ``dbo_cli``, or, as ``Model.NAME``, a method of a class of
  the Python API.
- ``run``: what takes part in a use case of the core. ``compensate NAME`` makes the run
  where the option NAME is given, ``files of compensate NAME`` is a ``SignalRun`` for
  it, ``watch NAME`` makes a ``Watcher`` of the rows; ``show --NAME`` and ``excite
  --NAME`` do the same for these commands. Other keys are named where the core asks for
  them.
- ``model``: a ``hysteresis.model_file.StageInFiles``, the key is the ``type`` of its
  stage; or what reads a file of another ``format``.
- ``reader``: what opens a kind of log file, a function of a ``Request`` that returns a
  ``Table``; the key is the ending of its name, with the point. (Makers' headers and
  what is told by its first bytes have keys of their own.)
- ``generator``: a ``GeneratorFormat`` of ``dbo waveform``; the key is its name.
"""

Place = str
"""Where a thing is found: ``module:name``."""


@dataclass(frozen=True)
class Extra:
    """What an extra brings.

    Attributes
    ----------
    name : str
        How messages call it.
    purpose : str
        What it is for, in half a line.
    brings : mapping of kinds to mappings of keys to places
        Everything that the core can ask for.
    """

    name: str
    purpose: str
    brings: Mapping[Kind, Mapping[str, Place]] = field(default_factory=dict)

    @functools.cached_property
    def is_installed(self) -> bool:
        """Whether the folder of one of this program's own extras is there."""
        return (
            find_spec("dbo_cli.extras") is not None
            and find_spec(f"dbo_cli.extras.{self.name}") is not None
        )

    def things(self, kind: Kind) -> Iterator[tuple[str, Any]]:
        """Give the key of each thing of a kind, and the thing, imported."""
        for key, place in self.brings.get(kind, {}).items():
            yield key, _imported(self, place, key)


OWN = (
    Extra(
        "export",
        "a model as C for a controller",
        {"command": {"export": "dbo_cli.extras.export.command:EXPORT"}},
    ),
    Extra(
        "compare",
        "the model beside the operators that it is related to",
        {
            "command": {"compare": "dbo_cli.extras.compare.command:COMPARE"},
            "model": {
                "plays": "dbo_cli.extras.compare.play_model:IN_FILES",
                "rate-plays": "dbo_cli.extras.compare.play_model:IN_FILES",
                "singular-plays": "dbo_cli.extras.compare.play_model:IN_FILES",
                "one-sided-plays": "dbo_cli.extras.compare.play_model:IN_FILES",
            },
        },
    ),
    Extra(
        "channels",
        "many channels: sets of models, patterns of columns, coupling",
        {
            "model": {"dbo-model-set": "dbo_cli.extras.channels.model_set:read_set"},
            "run": {
                "signals of channels": "dbo_cli.extras.channels.signals:signals_of_channels",
                "excite --channels": "dbo_cli.extras.channels.excitation:drives_of_channels",
                "identify channels": "dbo_cli.extras.channels.models:identify_channels",
                "report channels": "dbo_cli.extras.channels.report:report_channels",
                "show a set": "dbo_cli.extras.channels.show:set_text",
                "identify a set": "dbo_cli.extras.channels.api:identify_set",
                "set from Python": "dbo_cli.extras.channels.api:set_of",
            },
            "option": {
                "identify --shared-shape": "dbo_cli.extras.channels.options:SHARED_SHAPE",
                "identify --coupling": "dbo_cli.extras.channels.options:COUPLING",
                "excite --channels": "dbo_cli.extras.channels.options:CHANNELS",
            },
            "api": {"ModelSet": "dbo_cli.extras.channels.api:ModelSet"},
        },
    ),
    Extra(
        "repeat",
        "moves that are repeated: loops, and learning from recordings of the last pass",
        {
            "option": {
                "compensate --periodic": "dbo_cli.extras.repeat.command_options:PERIODIC",
                "compensate --passes": "dbo_cli.extras.repeat.command_options:PASSES",
                "compensate --tracked": "dbo_cli.extras.repeat.command_options:TRACKED",
                "compensate --absolute": "dbo_cli.extras.repeat.command_options:ABSOLUTE",
                "compensate --history": "dbo_cli.extras.repeat.command_options:HISTORY",
                "compensate --voltage": "dbo_cli.extras.repeat.command_options:VOLTAGE",
                "compensate --measured": "dbo_cli.extras.repeat.command_options:MEASURED",
            },
            "run": {
                "compensate periodic": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate periodic": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate passes": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate passes": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate tracked": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate tracked": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate absolute": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate absolute": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate history": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate history": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate voltage": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate voltage": "dbo_cli.extras.repeat.run:RepeatedRun",
                "compensate measured": "dbo_cli.extras.repeat.run:repeated",
                "files of compensate measured": "dbo_cli.extras.repeat.run:RepeatedRun",
            },
        },
    ),
    Extra(
        "live",
        "one row at a time, of one actuator or of many",
        {
            "run": {
                "control a model": "dbo_cli.extras.live.controller:Controller",
                "control a set": "dbo_cli.extras.live.bank:Bank",
            },
        },
    ),
    Extra(
        "instruments",
        "files of instruments: makers' headers, binary formats, texts that are read as a whole",
        {
            "reader": {
                "by content": "dbo_cli.extras.instruments.kinds:kind_of",
                "header": "dbo_cli.extras.instruments.headers:read_instrument_header",
                "rows of values": "dbo_cli.extras.instruments.whole_texts:rows_of_values",
            },
        },
    ),
    Extra(
        "fringes",
        "displacement from the fringes of an interferometer",
        {
            "command": {"fringes": "dbo_cli.extras.fringes.command:COMMAND"},
            "run": {
                "excite --fringes": "dbo_cli.extras.fringes.excitation:drive_for_fringes",
                "excite --stroke": "dbo_cli.extras.fringes.excitation:drive_for_fringes",
            },
            "option": {
                "excite --fringes": "dbo_cli.extras.fringes.command:EXCITE_FRINGES",
                "excite --stroke": "dbo_cli.extras.fringes.command:EXCITE_STROKE",
            },
        },
    ),
    Extra(
        "moves",
        "trajectories, settling times and generators' files",
        {
            "command": {
                "trajectory": "dbo_cli.extras.moves.command:TRAJECTORY",
                "waveform": "dbo_cli.extras.moves.command:WAVEFORM",
            },
            "run": {
                "watch settle": "dbo_cli.extras.moves.settling:StepTimes",
                "show --settle": "dbo_cli.extras.moves.settling:settling_shown",
            },
            "option": {
                "compensate --settle": "dbo_cli.extras.moves.options:COMPENSATE_SETTLE",
                "show --settle": "dbo_cli.extras.moves.options:SHOW_SETTLE",
            },
            "api": {"trajectory": "dbo_cli.extras.moves.trajectory:trajectory"},
        },
    ),
)
"""The extras of this program, in the order in which help lists what they bring."""


def find(kind: Kind, key: str) -> Any:
    """Return what an extra brings under a key, imported; None where no extra, installed or not, knows it.

    Raises
    ------
    UsageError
        One of this program's own extras brings it, and its folder is not there.
    """
    for extra in OWN:
        place = extra.brings.get(kind, {}).get(key)
        if place is not None:
            return _imported(extra, place, key)
    for extra in others():
        place = extra.brings.get(kind, {}).get(key)
        if place is not None:
            return _imported(extra, place, key)
    return None


def find_installed(kind: Kind, key: str) -> Any:
    """Return what one of this program's own extras brings, imported; None where it is not there."""
    for extra in OWN:
        place = extra.brings.get(kind, {}).get(key)
        if place is not None and extra.is_installed:
            return _imported(extra, place, key)
    return None


def keys(kind: Kind) -> Iterator[str]:
    """Give the keys of all that the installed extras bring of a kind."""
    for extra in installed():
        yield from extra.brings.get(kind, {})


def every(kind: Kind) -> Iterator[tuple[str, Any]]:
    """Give the key and the thing, imported, of all that the installed extras bring of a kind."""
    for extra in installed():
        yield from extra.things(kind)


def own() -> Iterator[Extra]:
    """Give this program's own extras that are there."""
    for extra in OWN:
        if extra.is_installed:
            yield extra


def installed() -> Iterator[Extra]:
    """Give the extras that are there: this program's own ones, then those of other packages."""
    yield from own()
    yield from others()


@functools.cache
def others() -> tuple[Extra, ...]:
    """Return the extras that other installed packages announce.

    Raises
    ------
    UsageError
        An entry point does not lead to an ``Extra``.
    """
    from importlib.metadata import entry_points

    extras = []
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            extra = entry.load()
        except Exception as problem:  # of another package: anything may go wrong there
            raise UsageError(
                f"the extra '{entry.name}' ({entry.value}) cannot be imported: "
                f"{type(problem).__name__}: {problem}"
            ) from None
        if not isinstance(extra, Extra):
            raise UsageError(
                f"the extra '{entry.name}' ({entry.value}) is no dbo_cli.extensions.Extra"
            )
        extras.append(extra)
    return tuple(extras)


def _imported(extra: Extra, place: Place, key: str) -> Any:
    """Return what stands at a place (UsageError where the extra is missing)."""
    module, _, name = place.partition(":")
    if extra in OWN and not extra.is_installed:
        raise UsageError(
            f"'{key}' belongs to the part '{extra.name}' ({extra.purpose}), which this installation lacks "
            f"(dbo_cli/extras/{extra.name})"
        )
    return getattr(import_module(module), name)
