"""What ``simulate`` and ``compensate`` share: a stream of blocks through a model into an output file."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

from dbo_cli.cli import signals
from dbo_cli.cli.bundles import Reading
from dbo_cli.cli.messages import RowCounter, Voice
from dbo_cli.cli.streams import STATES, ModelStream
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.hysteresis.initial_states import StartName
    from dbo_cli.hysteresis.model import ActuatorModel, Quantity
    from dbo_cli.hysteresis.model_state import ModelState
    from dbo_cli.logs.sample_block import FloatArray, SampleBlock
    from dbo_cli.logs.signal_writer import OutColumn


@dataclass(frozen=True)
class Destination:
    """Where a response goes: the file, what must not be overwritten, and how it is written."""

    output: str
    save_state: str | None
    protect: Sequence[str]
    file_format: str | None
    flush: bool
    command_line: Sequence[str]

    def check(self) -> None:
        """Refuse outputs that cannot be written, or that are inputs or each other, before the long work."""
        from dbo_cli.logs.whole_output import check_output

        check_output(self.output, self.protect)
        if self.save_state is not None:
            check_output(self.save_state, self.protect)
            if self.save_state == self.output:
                raise UsageError(f"--save-state and --output are both '{self.output}'")


def start_of(state: str, model: ActuatorModel) -> StartName | ModelState:
    """Return the state that ``--state`` asks for: a name as it is, anything else as a file."""
    if state in STATES:
        return state  # type: ignore[return-value]
    from dbo_cli.hysteresis.model_file import read_state

    if not os.path.exists(state):
        raise UsageError(f"--state: '{state}' is none of {', '.join(STATES)}, and there is no such file")
    return read_state(state, model)


def write_response(
    stream: ModelStream,
    blocks: Iterable[tuple[SampleBlock, FloatArray]],
    result: Quantity,
    reading: Reading,
    voice: Voice,
    destination: Destination,
    prelude: Sequence[FloatArray] | None = None,
) -> None:
    """Feed every block to the stream and write time (when known), input and result, then the state.

    ``blocks`` are the log's, each with what goes into the model, which may be the log's signal read ahead;
    ``prelude`` are rows to write before them.
    """
    from dbo_cli.logs.signal_writer import signal_writer
    from dbo_cli.logs.whole_output import write_whole

    counter = RowCounter(voice, "written")
    columns = _columns(stream, result)
    responses = _responses(stream, blocks)
    # Computed before anything is opened: a log that is bad from the start leaves not even a header.
    first = next(responses)
    with signal_writer(
        destination.output,
        columns if stream.log.has_time else columns[1:],
        format=signals.format_for(destination.output, destination.file_format),
        attributes=_attributes(stream, reading, destination),
        flush=destination.flush,
        protect=destination.protect,
    ) as writer:
        if prelude is not None:
            writer.write(*prelude)
        for arrays in chain([first], responses):
            writer.write(*arrays)
            counter.add(len(arrays[0]))
        counter.clear()
    if destination.save_state is not None and stream.state is not None:
        from dbo_cli.hysteresis.model_file import state_to_bytes

        write_whole(destination.save_state, state_to_bytes(stream.state, stream.model))
    voice.notes(stream.log.notes)
    stream.tell(voice)


def _responses(
    stream: ModelStream, blocks: Iterable[tuple[SampleBlock, FloatArray]]
) -> Iterator[list[FloatArray]]:
    """Yield time (when known), input and result of each block."""
    role = stream.taken.quantity
    for block, x in blocks:
        y = stream.feed(block, x)
        yield [*([] if block.time is None else [block.time]), block.values[role], y]


def _columns(stream: ModelStream, result: Quantity) -> list[OutColumn]:
    """Return time, the input column under its own name, and the result under the model's."""
    from dbo_cli.logs.signal_writer import OutColumn

    taken = stream.taken
    column = stream.log.columns[taken.quantity]
    name = column.name if column.quantity else taken.quantity
    given = OutColumn(name, column.unit or taken.unit, taken.quantity)
    out = OutColumn(result.quantity, result.unit)
    if out.header == given.header:
        out = OutColumn(f"model_{result.quantity}", result.unit)
    return [OutColumn("time", "s"), given, out]


def _attributes(stream: ModelStream, reading: Reading, destination: Destination) -> dict[str, str | float]:
    """Return what an HDF5 output says about itself."""
    attributes: dict[str, str | float] = {
        "model_sha256": stream.model.digest,
        "command": shlex.join(["dbo", *destination.command_line]),
    }
    rate = reading.resample or stream.log.sample_rate
    if rate is not None:
        attributes["sample_rate"] = rate
    return attributes
