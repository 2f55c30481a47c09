"""``dbo simulate``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, column, option
from dbo_cli.cli.say import progress, say_log, say_output
from dbo_cli.errors import prefixed

if TYPE_CHECKING:
    from dbo_cli.drive.simulate import Rows, Simulator
    from dbo_cli.logs import Log
    from dbo_cli.logs.write import Writer


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
    from dbo_cli.logs import add_table, open_log
    from dbo_cli.model import State, dumps_state

    columns = {"time": time, "input": input}
    check_outputs(output, state=save_state)
    columns_of = channels.columns_of([log], reading, columns)
    models = channels.models_of(model, columns_of, columns)
    simulators = {}
    for name, start in channels.states_of(state, models).items():
        label = f"channel {name}" if name else log
        simulators[name] = Simulator(models[name], start, outside, label)
    with Outputs() as outputs, ExitStack() as opened:
        logs, pairs = {}, {}
        for name, roles in columns_of.items():
            into, out = models[name].input, models[name].output
            signal = open_log(log, roles, reading, {"input": into.unit})
            logs[name] = opened.enter_context(signal)
            unit = signal.columns["input"].unit
            pairs[name] = [(into.quantity, unit), (out.quantity, out.unit)]
        is_clocked = all(log.clock.kind != "none" for log in logs.values())
        header = channels.named_columns(pairs, is_clocked)
        table = add_table(outputs, output, header)
        write_rows(simulators, logs, table)
        if save_state is not None:
            texts = {}
            for name, simulator in simulators.items():
                assert isinstance(simulator.state, State)
                texts[name] = dumps_state(simulator.state, models[name])
            content = channels.dumps_files("state", texts)
            outputs.write_text(save_state, content, "state")
    text = f"{len(models)} channels, {table.rows:,} rows"
    if "" in logs:
        say_log(logs[""])
        quantity = models[""].output
        text = f"{table.rows:,} rows of {quantity.quantity}{quantity.suffix}"
    else:
        for signal in logs.values():
            signal.warn_of_assumed()
            signal.warn_of_doubts()
    say_output(output, text)


def write_rows(
    simulators: dict[str, Simulator], logs: dict[str, Log], table: Writer
) -> None:
    """Write a log's rows block by block; those of channels, which read ahead unequally, at the end."""
    from dbo_cli import channels
    from dbo_cli.drive.simulate import stacked

    signals = []
    for name, simulator in simulators.items():
        with prefixed(simulator.name):
            blocks = simulated(simulator, logs[name])
            if not name:
                for rows in blocks:
                    rows.send(table.write)
                continue
            rows = stacked(list(blocks))
            time = [] if rows.time is None else [rows.time]
            signals += [rows.x, rows.y]
    channels.require_same_rows(logs)
    if signals:
        table.write(*time, *signals)


def simulated(simulator: Simulator, signal: Log) -> Iterator[Rows]:
    """Run a model over a log, block by block."""
    for block in progress(signal.blocks(), "simulated"):
        yield simulator.rows(block["input"], block.dt, block.time)
    yield simulator.finish()
