"""``dbo simulate``."""

from __future__ import annotations

from itertools import chain
from typing import Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, option
from dbo_cli.cli.say import progress, say_log, say_output
from dbo_cli.errors import ModelError


def simulate(
    reading: opt.Reading,
    model: str = opt.MODEL,
    log: str = opt.LOG,
    output: str = opt.OUTPUT_FILE,
    time: Text = opt.TIME,
    input: Text = column("Input of the model."),
    state: str = opt.STATE,
    save_state: Text = opt.SAVE_STATE,
    outside: Literal["extend", "hold", "error"] = option(
        None, "Beyond the identified range; default extend.", default="extend"
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
    from dbo_cli.logs import add_table, open_log
    from dbo_cli.model import State, dumps_state, read_model, state_of

    columns = {"time": time, "input": input}
    check_outputs(output, state=save_state)
    if channels.is_pattern(columns):
        simulate_set(model, log, output, reading, columns, state, save_state, outside)
        return
    actuator = read_model(model)
    start = state_of(state, actuator)
    units = {"input": actuator.input.unit}
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
            rows = simulator.rows(block.values["input"], block.dt, block.time)
            rows.send(table.write)
        simulator.finish().send(table.write)
        if save_state is not None and isinstance(simulator.state, State):
            text = dumps_state(simulator.state, actuator)
            outputs.write_text(save_state, text, "state")
    quantity = actuator.output
    say_log(signal)
    say_output(
        output, f"{simulator.row_count:,} rows of {quantity.quantity}{quantity.suffix}"
    )


def simulate_set(
    model: str,
    log: str,
    output: str,
    reading: opt.Reading,
    columns: dict[str, str | None],
    state: str,
    save_state: str | None,
    outside: Literal["extend", "hold", "error"],
) -> None:
    """Run the model of each channel over its input, and write all side by side."""
    from dbo_cli import channels
    from dbo_cli.drive.simulate import Simulator, stacked
    from dbo_cli.files import Outputs
    from dbo_cli.model import State, dumps_state
    from dbo_cli.recordings import read_table

    names = channels.names([log], reading, columns)
    models = channels.models_of(model, names, columns)
    states = channels.states_of(state, models)
    results: list[channels.Result] = []
    texts = {}
    for name, actuator in models.items():
        roles = channels.columns_for(columns, name)
        units = {"input": actuator.input.unit}
        _, table = read_table(log, roles, reading, units)
        simulator = Simulator(actuator, states[name], outside, f"channel {name}")
        with channels.naming(name):
            ready = simulator.rows(table["input"], table.dt, table.time)
            rows = stacked([ready, simulator.finish()])
        results += channels.columns_of_run(name, actuator, rows)
        if isinstance(simulator.state, State):
            texts[name] = dumps_state(simulator.state, actuator)
    with Outputs() as outputs:
        channels.write_results(outputs, output, table.time, results)
        if save_state is not None:
            text = channels.dumps_files("state", texts)
            outputs.write_text(save_state, text, "state")
    say_output(output, f"{len(models)} channels, {results[0][2].size:,} rows")
