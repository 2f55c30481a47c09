"""``dbo simulate``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, option
from dbo_cli.cli.say import progress, say_log, say_output
from dbo_cli.errors import ModelError, warn

if TYPE_CHECKING:
    from dbo_cli.drive.simulate import Simulation
    from dbo_cli.logs import Block


def simulate(
    model: opt.ModelFile,
    log: opt.LogFile,
    reading: opt.Reading,
    output: opt.Output = "-",
    time: opt.Time = None,
    input: Annotated[Text, column("Input of the model.")] = None,
    state: opt.State = "auto",
    save_state: opt.SaveState = None,
    outside: Annotated[
        Literal["extend", "hold", "error"],
        option(None, "Beyond the identified range; default extend."),
    ] = "extend",
) -> None:
    """Run a model over its input and write its output.

    A forward model turns a drive into the displacement, an inverse model a displacement
    into the drive. The log may be larger than memory.

    Example: dbo simulate model.json drive.csv -o predicted.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive.simulate import Simulation, simulate_blocks
    from dbo_cli.files import Outputs, check_outputs
    from dbo_cli.logs import add_table, open_log
    from dbo_cli.model import State, dumps_state, read_model, state_of

    columns = {"time": time, "input": input}
    if channels.is_pattern(columns):
        channels.refuse({"save_state": save_state})
        text = channels.simulate(model, log, output, reading, columns, state, outside)
        say_output(output, text)
        return
    actuator = read_model(model)
    run, start = Simulation(), state_of(state, actuator)
    if isinstance(start, State):
        run.state, start = start, "auto"
    check_outputs(output, state=save_state)
    units = opt.units_of(input=actuator.input)
    with open_log(log, columns, reading, units) as signal, Outputs() as outputs:
        blocks = progress(signal.blocks(), "simulated")
        first = next(blocks)
        clocked = first.time is not None
        if actuator.needs_time and not clocked:
            raise ModelError(
                f"{signal.name}: this model needs a clock: add `time` COLUMN or `sample_rate` HZ"
            )
        names: list[tuple[str, str | None]] = [("time", "s")] if clocked else []
        names.append((actuator.input.quantity, signal.columns["input"].unit))
        names.append((actuator.output.quantity, actuator.output.unit))
        table = add_table(outputs, output, names)
        last_time = None
        fed = feed(first, blocks, run)
        name = signal.name
        for block, y in simulate_blocks(actuator, fed, run, start, outside, name):
            table.write(*opt.present(block.time, block.values["input"], y))
            last_time = None if block.time is None else float(block.time[-1])
        if save_state is not None and run.state is not None:
            after = dataclasses.replace(run.state, time=last_time)
            outputs.write_text(save_state, dumps_state(after, actuator), "state")
    drive, moved = actuator.input, actuator.output
    if run.outside:
        warn(
            f"{signal.name}: {run.outside:,} of {run.rows:,} rows (first: row {run.first_outside}) leave"
            f" the identified range, {drive.min:.6g} to {drive.max:.6g}{drive.suffix}"
        )
    say_log(signal)
    say_output(output, f"{run.rows:,} rows of {moved.quantity}{moved.suffix}")


def feed(
    first: Block, blocks: Iterator[Block], run: Simulation
) -> Iterator[tuple[Block, Any, Any]]:
    """Yield blocks with their input and time steps; a saved state knows when it was."""
    from dbo_cli.model import steps_behind

    left = None if run.state is None else run.state.time
    dt = steps_behind(left, first.time, first.dt)
    yield first, first.values["input"], dt
    for block in blocks:
        yield block, block.values["input"], block.dt
