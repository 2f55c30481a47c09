"""``dbo simulate``."""

from __future__ import annotations

from itertools import chain
from typing import Annotated, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, option
from dbo_cli.cli.say import progress, say_log, say_output
from dbo_cli.errors import ModelError


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
    from dbo_cli.drive.ahead import write
    from dbo_cli.drive.simulate import Simulator
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
    start = state_of(state, actuator)
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
        simulator = Simulator(actuator, start, outside, signal.name)
        for block in chain([first], blocks):
            write(table, simulator.rows(block.values["input"], block.dt, block.time))
        write(table, simulator.finish())
        if save_state is not None and isinstance(simulator.state, State):
            text = dumps_state(simulator.state, actuator)
            outputs.write_text(save_state, text, "state")
    moved = actuator.output
    say_log(signal)
    say_output(
        output, f"{simulator.row_count:,} rows of {moved.quantity}{moved.suffix}"
    )
