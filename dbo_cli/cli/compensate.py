"""``dbo compensate``."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from typer import Argument

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import (
    LIMITS,
    MOVE,
    OUTPUT,
    Text,
    Texts,
    column,
    flag,
    option,
    rare,
)
from dbo_cli.cli.say import detail, progress, say, say_log, say_output

if TYPE_CHECKING:
    from dbo_cli.arrays import Floats
    from dbo_cli.drive import Drive, Driver
    from dbo_cli.files import Outputs
    from dbo_cli.logs import Log
    from dbo_cli.model import Cascade, State
    from dbo_cli.recordings import Columns


def compensate(
    reading: opt.Reading,
    model: str = opt.MODEL,
    trajectory: str = Argument(
        ..., metavar="TRAJECTORY", help="What is desired; - is stdin."
    ),
    output: str = opt.OUTPUT_FILE,
    summary: Text = opt.SUMMARY_FILE,
    v_min: Texts = opt.V_MIN,
    v_max: Texts = opt.V_MAX,
    max_slew: Texts = opt.MAX_SLEW,
    extrapolate: bool = flag(
        "--extrapolate", "Use the range beyond the logs' range.", LIMITS, hidden=True
    ),
    on_limit: Literal["auto", "clip", "error"] = option(
        None,
        "auto: clip if the tracking error stays under 1 % of the move, otherwise exit 3.",
        LIMITS,
        default="auto",
    ),
    start: Texts = opt.FROM,
    approach: Text = option("SECONDS|auto", "Time of a ramp to row 1.", MOVE),
    condition: bool = flag("--condition", "Sweep first: the past is known.", MOVE),
    lead: Text = rare("SECONDS|auto", "Hold row 1 before the move.", MOVE),
    return_to: Texts = option("VOLT", "Voltage to end at.", MOVE, "--return"),
    periodic: bool = flag("--periodic", "The trajectory is one period.", MOVE),
    passes: int = rare("N", "Passes before a --periodic one.", MOVE, default=0, min=0),
    tracked: Texts = option("LOG", "Learn from recordings of the last pass.", MOVE),
    history: Text = rare("FILE", "With --tracked: errors of all passes.", OUTPUT),
    absolute: bool = flag(
        "--absolute", "With --tracked: learn the mean error, too.", MOVE, hidden=True
    ),
    bandwidth: Text = rare("HZ", "Zero-phase low-pass of the trajectory.", MOVE),
    state: str = opt.STATE,
    save_state: Text = opt.SAVE_STATE,
    time: Text = opt.TIME,
    displacement: Text = opt.DISPLACEMENT,
    voltage: Text = column("Drive of a --tracked log.", hidden=True),
    measured: Text = column("Displacement of a --tracked log.", hidden=True),
) -> None:
    """Write the drive that makes an actuator follow a displacement.

    Example: dbo compensate model.json move.csv --max-slew 2000 -o drive.csv
    """
    from dbo_cli import channels
    from dbo_cli.files import check_outputs

    columns = {"time": time, "displacement": displacement}
    learning = {"tracked": tracked, "history": history, "absolute": absolute}
    looped = {"bandwidth": bandwidth, "periodic": periodic, "passes": passes}
    in_memory: dict[str, Any] = {**looped, **learning}
    opt.require(
        "tracked", tracked, {**learning, "voltage": voltage, "measured": measured}
    )
    opt.require("periodic", periodic, {"passes": passes})
    check_outputs(output, summary, state=save_state, history=history)
    names = channels.names([trajectory], reading, columns)
    models = channels.models_of(model, names)
    for name, actuator in models.items():
        actuator.require("forward", f"{model}::{name}" if name else model)
    move = MoveOptions(
        trajectory,
        names,
        {
            "v_min": v_min,
            "v_max": v_max,
            "max_slew": max_slew,
            "from": start,
            "return": return_to,
        },
        extrapolate,
        on_limit,
        approach,
        condition,
        lead,
        in_memory if any(in_memory.values()) else {},
        {"time": time, "voltage": voltage, "measured": measured},
        reading,
    )
    written = Written(output, summary, save_state, history)
    starts = channels.states_of(state, models)
    histories = channels.histories_of(history, names)
    in_memory = {}
    for name, actuator in models.items():
        with channels.naming(name):
            in_memory[name] = move.in_memory(actuator, histories[name], name)
    if tuple(names) == channels.ALONE:
        compensate_one(move, models[""], starts[""], columns, in_memory[""], written)
    else:
        compensate_set(move, models, starts, columns, in_memory, written)


class Written(NamedTuple):
    """Where a drive, its figures, its state and its history are written."""

    output: str
    summary: str | None
    state: str | None
    history: str | None

    def files(
        self, outputs: Outputs, drives: dict[str, Drive], summaries: dict[str, str]
    ) -> None:
        """Write what belongs to the drives of channels."""
        from dbo_cli.channels import dumps_files
        from dbo_cli.drive.learning import dumps_history
        from dbo_cli.model import dumps_state

        if self.summary is not None:
            outputs.write_text(self.summary, dumps_files("summary", summaries))
        states, histories = {}, {}
        for name, drive in drives.items():
            histories[name] = dumps_history(drive.history)
            if drive.state is not None:
                states[name] = dumps_state(drive.state, drive.model)
        if self.state is not None and states:
            outputs.write_text(self.state, dumps_files("state", states), "state")
        if self.history is not None:
            text = dumps_files("history", histories)
            outputs.write_text(self.history, text, "history")


@dataclass(frozen=True)
class MoveOptions:
    """What was typed of a move, for one channel or for several.

    Attributes
    ----------
    name
        The trajectory's file.
    channels
        Their names.
    voltages
        What was typed of `v_min`, `v_max`, `max_slew`, `from` and `return`.
    extrapolate, on_limit, approach, condition, lead
        As typed.
    loop_options
        Options that need the whole trajectory; empty where it may come in blocks.
    columns, reading
        Of the recordings that are learned from.
    """

    name: str
    channels: list[str]
    voltages: dict[str, list[str] | None]
    extrapolate: bool
    on_limit: Literal["auto", "clip", "error"]
    approach: Text
    condition: bool
    lead: Text
    loop_options: dict[str, Any]
    columns: dict[str, str | None]
    reading: opt.Reading

    def driver(
        self, actuator: Cascade, start: State | str, channel: str = "", hold: int = 0
    ) -> Driver:
        """Return what drives the actuator of a channel."""
        from dbo_cli import channels
        from dbo_cli.drive import Driver, Lead, Limits, voltage_in

        texts = channels.values_for(self.voltages, channel, self.channels)
        drive = actuator.input
        for name in ("v_min", "v_max"):
            bound = voltage_in(name, texts[name], drive)
            values = self.voltages[name]
            channels.require_own_limit(name, values, channel, bound, actuator)
        ranges = texts["v_min"], texts["v_max"], texts["max_slew"]
        limits = Limits.within(drive, *ranges, self.extrapolate)
        begin = voltage_in("from", texts["from"], drive)
        end = voltage_in("return", texts["return"], drive)
        lead = Lead(start, begin, self.approach, self.condition, self.lead)
        name = f"channel {channel}" if channel else self.name
        return Driver(actuator, limits, lead, self.on_limit, end, name, hold)

    def in_memory(
        self, actuator: Cascade, history: Any, channel: str
    ) -> dict[str, Any]:
        """Return the options that need the whole trajectory; nothing where it may come in blocks."""
        from dbo_cli import channels
        from dbo_cli.recordings import tracked_of

        if not self.loop_options:
            return {}
        columns, options = (
            channels.columns_for(self.columns, channel),
            self.loop_options,
        )
        return {
            "bandwidth": opt.quantity("bandwidth", options["bandwidth"], "Hz"),
            "periodic": options["periodic"],
            "passes": options["passes"],
            "absolute": options["absolute"],
            "tracked": tracked_of(
                options["tracked"] or [], columns, self.reading, actuator
            ),
            "history": history,
        }


def compensate_one(
    move: MoveOptions,
    actuator: Cascade,
    start: State | str,
    columns: Columns,
    in_memory: dict[str, Any],
    written: Written,
) -> None:
    """Write the drive of one actuator, and say what to expect."""
    from dbo_cli.files import Outputs
    from dbo_cli.logs import open_log

    if written.output == "-" and move.on_limit == "auto" and not in_memory:
        move = replace(move, on_limit="clip")  # rows that were sent stay sent
    driver = move.driver(actuator, start)
    units = {"displacement": actuator.output.unit}
    with open_log(move.name, columns, move.reading, units) as log, Outputs() as outputs:
        drive = write_drive(driver, log, outputs, written.output, in_memory)
        written.files(outputs, {"": drive}, {"": drive_summary(drive, log)})
    say_log(log)
    say_output(written.output, drive.line())
    say(drive.expected_line())
    detail(*drive.notes)


def compensate_set(
    move: MoveOptions,
    models: dict[str, Cascade],
    starts: dict[str, State | str],
    columns: Columns,
    in_memory: dict[str, dict[str, Any]],
    written: Written,
) -> None:
    """Write the drives of channels side by side: equally long, the shorter ones hold."""
    from dbo_cli import channels

    roles = {"displacement": {name: model.output for name, model in models.items()}}
    tables = channels.read_channels(move.name, move.reading, columns, roles)

    def drive_of(name: str, hold: int, rows_after: int) -> Drive:
        table = tables[name]
        driver = move.driver(models[name], starts[name], name, hold)
        desired, options = table["displacement"], in_memory[name]
        return driver.whole(
            desired, table.dt, table.time, return_rows=rows_after, **options
        )

    write_set(channels.together(drive_of, models), written)


def write_set(drives: dict[str, Drive], written: Written) -> None:
    """Write the drives of channels side by side, and what belongs to them; say a line for each."""
    from dbo_cli import channels
    from dbo_cli.files import Outputs
    from dbo_cli.logs import add_table

    time = next(iter(drives.values())).time
    results = channels.columns_of_drives(drives, time)
    limits = {name: drive.limits.as_dict() for name, drive in drives.items()}
    digests = {name: drive.model.digest for name, drive in drives.items()}
    origin: dict[str, str | float] = {
        "model": json.dumps(digests),
        "limits": json.dumps(limits),
    }
    names = [(name, unit) for name, unit, _ in results]
    columns = [column for _, _, column in results]
    summaries = {name: json.dumps(drive.summary()) for name, drive in drives.items()}
    with Outputs() as outputs:
        add_table(outputs, written.output, names, origin).write(*columns)
        written.files(outputs, drives, summaries)
    say_output(written.output, f"{len(drives)} channels, {columns[0].size:,} rows")
    for name, drive in drives.items():
        expected = drive.expected_line()
        say(f"{name}: {drive.line()}{'; ' if expected else ''}{expected}")


def write_drive(
    driver: Driver,
    log: Log,
    outputs: Outputs,
    output: str,
    in_memory: dict[str, Any],
) -> Drive:
    """Drive a trajectory and write it: as a whole where loops or learning need that, else by blocks."""
    from dbo_cli.drive.simulate import Rows
    from dbo_cli.logs import add_table

    if in_memory:
        read = log.read()
        drive = driver.whole(read["displacement"], read.dt, read.time, **in_memory)
        table = add_table(outputs, output, *headings_of(driver, read.time))
        Rows(drive.time, drive.desired, drive.voltage).send(table.write)
        return drive
    blocks = progress(log.blocks(), "driven")
    first = next(blocks)
    table = add_table(outputs, output, *headings_of(driver, first.time))
    for block in chain([first], blocks):
        rows = driver.rows(block.values["displacement"], block.dt, block.time)
        rows.send(table.write)
    rows, drive = driver.finish()
    rows.send(table.write)
    return drive


def headings_of(driver: Driver, time: Floats | None) -> tuple[Any, Any]:
    """Return names and units of the columns of a drive, and what an HDF5 file says of it."""
    columns: list[tuple[str, str | None]] = [] if time is None else [("time", "s")]
    model, limits = driver.model, json.dumps(driver.limits.as_dict())
    columns.append(("desired", model.output.unit))
    columns.append((model.input.quantity, model.input.unit))
    return columns, {"model": model.digest, "limits": limits}


def drive_summary(drive: Drive, log: Log) -> str:
    """Return the figures of a drive and its trajectory as JSON."""
    figures = {**drive.summary(), "trajectory": log.name}
    if log.provided("time"):
        figures["move_time"] = [log.clock.first, log.clock.last]
    return json.dumps(figures, indent=2) + "\n"
