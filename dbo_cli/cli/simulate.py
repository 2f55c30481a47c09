"""``dbo simulate``."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, option
from dbo_cli.cli.say import progress, say_log, say_output
from dbo_cli.errors import ModelError

if TYPE_CHECKING:
    from dbo_cli.drive.simulate import Simulator
    from dbo_cli.files import Outputs
    from dbo_cli.logs import Log, Reading


def simulate(
    reading: opt.Reading,
    model: str = opt.MODEL,
    log: str = opt.LOG,
    output: str = opt.OUTPUT_FILE,
    time: Text = opt.TIME,
    input: Text = column("The model's input: name or number."),
    state: str = opt.STATE,
    save_state: Text = opt.SAVE_STATE,
    outside: Literal["extend", "hold", "error"] = option(
        None, "What to do beyond the range; default extend.", default="extend"
    ),
) -> None:
    """Run a model over its input and write its output.

    A forward model turns a drive into the displacement, an inverse model a displacement
    into the drive. The log may be larger than memory.

    Example: dbo simulate model.json drive.csv -o predicted.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive.simulate import Simulator
    from dbo_cli.files import Outputs, check_outputs
    from dbo_cli.logs import open_log
    from dbo_cli.model import State, dumps_state

    columns = {"time": time, "input": input}
    check_outputs(output, state=save_state)
    columns_of = channels.columns_of([log], reading, columns)
    models = channels.models_of(model, columns_of, columns)
    simulators = {}
    for name, start in channels.states_of(state, models).items():
        label = f"channel {name}" if name else log
        simulators[name] = Simulator(models[name], start, outside, label)
    is_one = "" in models
    with Outputs() as outputs:
        if is_one:
            simulator, quantity = simulators[""], models[""].output
            units = {"input": models[""].input.unit}
            with open_log(log, columns, reading, units) as signal:
                simulate_stream(simulator, signal, outputs, output)
            text = (
                f"{simulator.row_count:,} rows of {quantity.quantity}{quantity.suffix}"
            )
        else:
            rows = simulate_set(simulators, log, columns_of, reading, outputs, output)
            text = f"{len(models)} channels, {rows:,} rows"
        texts = {}
        for name, simulator in simulators.items():
            if isinstance(simulator.state, State):
                texts[name] = dumps_state(simulator.state, models[name])
        if save_state is not None and texts:
            content = channels.dumps_files("state", texts)
            outputs.write_text(save_state, content, "state")
    if is_one:
        say_log(signal)
    say_output(output, text)


def simulate_stream(
    simulator: Simulator, signal: Log, outputs: Outputs, output: str
) -> None:
    """Run a model over a log and write both, block by block."""
    from dbo_cli.logs import add_table

    model, simulator.name = simulator.model, signal.name
    blocks = progress(signal.blocks(), "simulated")
    first = next(blocks)
    clocked = first.time is not None
    if model.needs_time and not clocked:
        raise ModelError(
            f"{signal.name}: this model needs a clock: add `time` COLUMN or `sample_rate` HZ"
        )
    names: list[tuple[str, str | None]] = [("time", "s")] if clocked else []
    names.append((model.input.quantity, signal.columns["input"].unit))
    names.append((model.output.quantity, model.output.unit))
    table = add_table(outputs, output, names)
    for block in chain([first], blocks):
        rows = simulator.rows(block.values["input"], block.dt, block.time)
        rows.send(table.write)
    simulator.finish().send(table.write)


def simulate_set(
    simulators: dict[str, Simulator],
    log: str,
    columns_of: dict[str, dict[str, str | None]],
    reading: Reading,
    outputs: Outputs,
    output: str,
) -> int:
    """Run the model of each channel over its input, write all side by side, and return the number of rows."""
    from dbo_cli import channels
    from dbo_cli.drive.simulate import stacked
    from dbo_cli.logs import add_table
    from dbo_cli.recordings import read_table, warn_of_assumed

    names: list[tuple[str, str | None]] = []
    values = []
    for name, simulator in simulators.items():
        into, out = simulator.model.input, simulator.model.output
        units = {"input": into.unit}
        signal, table = read_table(log, columns_of[name], reading, units)
        warn_of_assumed(signal)
        with channels.naming(name):
            ready = simulator.rows(table["input"], table.dt, table.time)
            rows = stacked([ready, simulator.finish()])
        names.append((f"{into.quantity}_{name}", into.unit))
        names.append((f"{out.quantity}_{name}", out.unit))
        values += [rows.x, rows.y]
    if table.time is not None:
        names, values = [("time", "s"), *names], [table.time, *values]
    add_table(outputs, output, names).write(*values)
    return len(table)
