"""Runs of moves that are repeated: in Python, and from files to files."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from dbo_cli.drives.compensation import Compensation
from dbo_cli.drives.options import DriveOptions
from dbo_cli.errors import Listener, UsageError
from dbo_cli.extras.repeat.learned_drive import LearnedCompensation
from dbo_cli.extras.repeat.learning import Lesson, Tracked, learned_source
from dbo_cli.extras.repeat.loop_drive import LED_IN, LoopCompensation
from dbo_cli.extras.repeat.options import repeat_options
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs import request
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ALL_ROWS, Address
from dbo_cli.logs.sample_block import joined
from dbo_cli.logs.signal_log import Source, open_log
from dbo_cli.logs.sources import is_log
from dbo_cli.logs.whole_output import check_outputs
from dbo_cli.runs.files import (
    Destination,
    SignalRun,
    bring_to,
    quantity_wish,
    source_of,
)


def repeated(
    model: ActuatorModel,
    source: Source,
    options: DriveOptions,
    brought: Mapping[str, Any],
    last_row: int | None = None,
) -> Compensation:
    """Return the run of a loop, or of a move that learns from recordings of its last pass.

    Parameters
    ----------
    model
        A forward model.
    source
        The trajectory, under the name of the model's output.
    options
        What is asked of any drive.
    brought
        What the options of this extra were given: ``periodic``, ``passes``,
        ``absolute``, ``history``, and ``tracked``, the recordings of the last pass, in
        any form that ``recordings_of`` takes.
    last_row
        The last row that is answered; rows after it are only read ahead.

    Raises
    ------
    UsageError
        Options exclude each other.
    InputError
        A recording is not of this trajectory, or the error grew.
    """
    recordings = recordings_of(brought.get("tracked", ()), model)
    options_of_repeat = repeat_options(options, {**brought, "tracked": recordings})
    lesson: Lesson | None = None
    if recordings:
        source, lesson = learned_source(model, source, recordings, options_of_repeat)
    if not options_of_repeat.periodic:
        return LearnedCompensation(
            model, source, last_row=last_row, options=options_of_repeat, lesson=lesson
        )
    if options_of_repeat.lead is not None:
        options_of_repeat = dataclasses.replace(
            options_of_repeat, passes=max(options_of_repeat.passes, LED_IN)
        )
    return LoopCompensation(
        model, source, last_row=last_row, options=options_of_repeat, lesson=lesson
    )


def recordings_of(recorded: Any, model: ActuatorModel) -> list[Tracked]:
    """Return recordings of a pass: of a table, a file's name or a pair of arrays, or of several of these."""
    is_pair = (
        isinstance(recorded, tuple)
        and len(recorded) == 2
        and not any(map(is_log, recorded))
    )
    several = [recorded] if is_pair or is_log(recorded) else list(recorded)
    recordings = []
    for number, recording in enumerate(several, start=1):
        if isinstance(recording, Tracked):
            recordings.append(recording)
            continue
        signals = [recording] if is_log(recording) else recording
        source = source_of(tracked_wishes(model), *signals, name=f"`tracked` {number}")
        with closing(source):
            recordings.append(tracked_of(source, model))
    return recordings


def tracked_wishes(
    model: ActuatorModel, voltage: str | None = None, measured: str | None = None
) -> dict[str, ColumnWish]:
    """Return the columns of a recording of a pass."""
    return {
        "voltage": quantity_wish(model.input, voltage, option="voltage"),
        "measured": quantity_wish(model.output, measured, option="measured"),
    }


def tracked_of(source: Source, model: ActuatorModel) -> Tracked:
    """Read a recording whole, in the units of the model."""
    bring_to(source, "voltage", model.input, "the model")
    bring_to(source, "measured", model.output, "the model")
    block = joined(list(source.blocks()))
    return Tracked(
        source.name, block.values["voltage"], block.values["measured"], block.time
    )


@dataclass(frozen=True)
class RepeatedRun(SignalRun):
    """A ``compensate`` from files to files with options of this extra among ``brought``."""

    @property
    def recordings(self) -> Sequence[Address]:
        """The recordings of the last pass."""
        recordings: Sequence[Address] = self.brought.get("tracked", ())
        return recordings

    @property
    def may_read_ahead(self) -> bool:
        """Whether rows after the last one asked for may serve: a loop and what was learned have none."""
        return not (self.recordings or self.brought.get("periodic"))

    def refuse_many(self) -> None:
        """Refuse to learn several trajectories at once (UsageError)."""
        if self.recordings:
            raise UsageError(
                "`tracked` learns one trajectory at a time: one log, one column and one output"
            )

    def protected(self) -> Destination:
        """Return where the result goes; recordings and history are protected from it and from each other."""
        destination = super().protected()
        columns = (self.brought.get("voltage"), self.brought.get("measured"))
        destination = destination._replace(
            protect=[*destination.protect, *self.recordings]
        ).beside(*columns)
        history = self.brought.get("history")
        if history is not None:
            request.check_document(history, "a history", "json")
            check_outputs([destination.output, history], destination.protect)
        return destination

    def brought_to(self, model: ActuatorModel, listener: Listener) -> dict[str, Any]:
        """Return what was brought, the recordings read; ``rows`` are the trajectory's."""
        brought = dict(self.brought)
        for name in ("voltage", "measured"):
            brought.pop(name, None)
        if self.recordings:
            brought["tracked"] = [
                self._recorded(address, model, listener) for address in self.recordings
            ]
        return brought

    def _recorded(
        self, address: Address, model: ActuatorModel, listener: Listener
    ) -> Tracked:
        want = tracked_wishes(
            model, self.brought.get("voltage"), self.brought.get("measured")
        )
        with open_log(
            address, want, dataclasses.replace(self.reading, rows=ALL_ROWS)
        ) as log:
            listener.opened(log.describe())
            return tracked_of(log, model)
