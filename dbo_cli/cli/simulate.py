"""``dbo simulate``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from dbo_cli.cli.identify import named
from dbo_cli.cli.options import (
    LogFile,
    ModelFile,
    Output,
    SaveState,
    State,
    Text,
    Time,
    column,
    reads_logs,
)
from dbo_cli.cli.say import detail, progress, say
from dbo_cli.errors import ModelError, warn

if TYPE_CHECKING:
    from dbo_cli.drive.simulate import Simulation
    from dbo_cli.logs import Block, Log, Reading
    from dbo_cli.model import Model

START_NAMES = ("auto", "empty", "full", "settled")


@reads_logs
def simulate(
    model: ModelFile,
    log: LogFile,
    reading: Reading,
    output: Output = "-",
    time: Time = None,
    input: Annotated[Text, column("The model's input")] = None,
    state: State = "auto",
    save_state: SaveState = None,
    outside: Annotated[
        Literal["extend", "hold", "error"],
        Option(help="What happens beyond the model's input range."),
    ] = "extend",
) -> None:
    """Run a model over its input signal and write its output.

    A forward model turns a drive into the displacement, an inverse model a displacement
    into the drive. The log is read block by block; it may be larger than memory.

    Example: dbo simulate model.json drive.csv -o predicted.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive.simulate import Simulation, simulate_blocks
    from dbo_cli.logs import Outputs, check_outputs, open_log
    from dbo_cli.model import dumps_state, read_model, read_state

    columns = {"time": time, "input": input}
    if channels.is_pattern(columns):
        done = channels.simulate(model, log, output, reading, columns, state, outside)
        say(f"{named(output)}: {done}")
        return
    actuator = read_model(model)
    run = Simulation()
    if state not in START_NAMES:
        run.state = read_state(state, actuator)
        state = "auto"
    check_outputs(*present(output, save_state))
    last_time = None
    with (
        open_log(log, columns, reading, input_unit(actuator)) as signal,
        Outputs() as outputs,
    ):
        blocks = progress(signal.blocks(), "simulated")
        first = next(blocks, None)
        if actuator.needs_time and first is not None and first.time is None:
            raise ModelError(
                f"{signal.name}: no clock, and this model depends on time (`time` COLUMN or `sample_rate` HZ)"
            )
        table = outputs.create(output, output_columns(actuator, signal, first))
        fed = feed(first, blocks, run)
        name = signal.name
        for block, y in simulate_blocks(actuator, fed, run, state, outside, name):
            table.write(*present(block.time, block.values["input"], y))
            last_time = None if block.time is None else float(block.time[-1])
        if save_state is not None and run.state is not None:
            after = dataclasses.replace(run.state, time=last_time)
            outputs.write_text(save_state, dumps_state(after, actuator))
    warn_outside(run, actuator)
    warn_doubts(signal)
    say(signal.line())
    detail(*signal.remarks)
    say(
        f"{named(output)}: {run.rows:,} rows of {actuator.output.quantity}{actuator.output.suffix}"
    )


def feed(
    first: Block | None, blocks: Iterator[Block], run: Simulation
) -> Iterator[tuple[Block, Any, Any]]:
    """Yield blocks with their input and time steps; a saved state knows when it was."""
    if first is None:
        return
    dt = first.dt
    saved = None if run.state is None else run.state.time
    if saved is not None and first.time is not None:
        dt = steps_from(saved, first)
    yield first, first.values["input"], dt
    for block in blocks:
        yield block, block.values["input"], block.dt


def steps_from(saved: float, block: Block) -> Any:
    """Return the time steps (s) of a block that goes on from a saved time."""
    import numpy as np

    if block.time is None or block.time[0] <= saved:
        return block.dt
    return np.diff(block.time, prepend=saved)


def present(*values: Any) -> list[Any]:
    """Return the values that are there."""
    return [value for value in values if value is not None]


def input_unit(model: Model) -> dict[str, str]:
    """Return the unit in which a model wants its input."""
    return {"input": model.input.unit} if model.input.unit else {}


def output_columns(
    model: Model, log: Log, first: Block | None
) -> list[tuple[str, str | None]]:
    """Return names and units of the columns that are written."""
    names: list[tuple[str, str | None]] = []
    if first is not None and first.time is not None:
        names.append(("time", "s"))
    names.append((model.input.quantity, log.columns["input"].unit))
    names.append((model.output.quantity, model.output.unit))
    return names


def warn_doubts(log: Log) -> None:
    """Warn of what is odd about the rows of a log."""
    for doubt in log.doubtful:
        warn(f"{log.name}: {doubt}")


def warn_outside(run: Simulation, model: Model) -> None:
    """Warn where the input left the range on which the model was identified."""
    if run.outside:
        quantity = model.input
        warn(
            f"{run.outside:,} of {run.rows:,} rows (the first is row {run.first_outside}) lie outside"
            f" {quantity.min:.6g} to {quantity.max:.6g}{quantity.suffix}, where the model was identified"
        )
