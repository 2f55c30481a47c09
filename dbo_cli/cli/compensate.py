"""``dbo compensate``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from typer import Argument

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import LIMITS, MOVE, OUTPUT, READING, Text, flag, option, rare
from dbo_cli.cli.say import detail, progress, say, say_log, say_output

if TYPE_CHECKING:
    from dbo_cli.arrays import Floats
    from dbo_cli.drive import Drive, Driver
    from dbo_cli.files import Outputs
    from dbo_cli.logs import Log
    from dbo_cli.model import Cascade, State

Columns = dict[str, str | None]


def compensate(
    model: opt.ModelFile,
    trajectory: Annotated[
        str, Argument(metavar="TRAJECTORY", help="Desired displacement; - is stdin.")
    ],
    reading: opt.Reading,
    output: opt.Output = "-",
    summary: opt.Summary = None,
    v_min: opt.VMins = None,
    v_max: opt.VMaxs = None,
    max_slew: opt.MaxSlews = None,
    extrapolate: Annotated[
        bool,
        rare(None, "Use the range beyond the logs' range.", LIMITS, "--extrapolate"),
    ] = False,
    on_limit: Annotated[
        Literal["auto", "clip", "error"],
        option(
            None,
            "auto: clip if the tracking error stays under 1 % of the move, otherwise exit 3.",
            LIMITS,
        ),
    ] = "auto",
    start: opt.Froms = None,
    approach: Annotated[
        Text, option("SECONDS|auto", "Time of a ramp from there to row 1.", MOVE)
    ] = None,
    condition: Annotated[
        bool, flag("--condition", "Sweep the range first: makes the past known.", MOVE)
    ] = False,
    lead: Annotated[
        Text, rare("SECONDS|auto", "Hold row 1 before the move.", MOVE)
    ] = None,
    return_to: Annotated[
        opt.Texts, option("VOLT", "Voltage to end at.", MOVE, "--return")
    ] = None,
    periodic: Annotated[
        bool, flag("--periodic", "The trajectory is one period of a loop.", MOVE)
    ] = False,
    passes: Annotated[
        int, rare("N", "With --periodic: passes before it.", MOVE, min=0)
    ] = 0,
    tracked: Annotated[
        list[str] | None, option("LOG", "Learn from recordings of the last pass.", MOVE)
    ] = None,
    history: Annotated[
        Text, rare("FILE", "With --tracked: errors of all passes.", OUTPUT)
    ] = None,
    absolute: Annotated[
        bool,
        rare(None, "With --tracked: learn the mean error, too.", MOVE, "--absolute"),
    ] = False,
    bandwidth: Annotated[
        Text, rare("HZ", "Zero-phase low-pass of the trajectory.", MOVE)
    ] = None,
    state: opt.State = "auto",
    save_state: opt.SaveState = None,
    time: opt.Time = None,
    displacement: opt.Displacement = None,
    voltage: Annotated[
        Text, rare("COLUMN", "Drive of a --tracked log.", READING)
    ] = None,
    measured: Annotated[
        Text, rare("COLUMN", "Displacement of a --tracked log.", READING)
    ] = None,
) -> None:
    """Write the drive that makes an actuator follow a displacement.

    Example: dbo compensate model.json move.csv --max-slew 2000 -o drive.csv
    """
    from dbo_cli import channels
    from dbo_cli.files import check_outputs

    columns = {"time": time, "displacement": displacement}
    learning = {"tracked": tracked, "history": history, "absolute": absolute}
    whole = {"bandwidth": bandwidth, "periodic": periodic, "passes": passes, **learning}
    opt.require(
        "tracked", tracked, {**learning, "voltage": voltage, "measured": measured}
    )
    opt.require("periodic", periodic, {"passes": passes})
    check_outputs(output, summary, state=save_state, history=history)
    ranges = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew}
    around = {"from": start, "return": return_to}
    move = Move(
        trajectory,
        {name: values or [] for name, values in {**ranges, **around}.items()},
        extrapolate,
        on_limit,
        approach,
        condition,
        lead,
        whole if any(whole.values()) else {},
        {"time": time, "voltage": voltage, "measured": measured},
        reading,
    )
    written = Written(output, summary, save_state, history)
    if channels.is_pattern(columns):
        compensate_set(model, move, columns, state, written)
    else:
        compensate_one(model, move, columns, state, written)


class Written(NamedTuple):
    """Where a drive, its figures, its state and its history are written."""

    output: str
    summary: str | None
    state: str | None
    history: str | None


@dataclass(frozen=True)
class Move:
    """What was typed of a move, for one channel or for several.

    Attributes
    ----------
    name
        The trajectory's file.
    voltages
        What was typed of `v_min`, `v_max`, `max_slew`, `from` and `return`.
    extrapolate, on_limit, approach, condition, lead
        As typed.
    whole
        Options that need the whole trajectory; empty where it may come in blocks.
    columns, reading
        Of the recordings that are learned from.
    """

    name: str
    voltages: dict[str, list[str]]
    extrapolate: bool
    on_limit: Literal["auto", "clip", "error"]
    approach: Text
    condition: bool
    lead: Text
    whole: dict[str, Any]
    columns: dict[str, str | None]
    reading: opt.Reading

    def driver(
        self,
        actuator: Cascade,
        state: State | str,
        channels_of_set: Sequence[str] = (),
        channel: str | None = None,
        hold: int = 0,
    ) -> Driver:
        """Return what drives one actuator."""
        from dbo_cli import channels
        from dbo_cli.drive import Driver, Lead, Limits, voltage_in

        typed, voltages = {}, {}
        for name, values in self.voltages.items():
            typed[name] = channels.value_for(name, values, channel, channels_of_set)
        for name in ("v_min", "v_max", "from", "return"):
            voltages[name] = voltage_in(name, typed[name], actuator.input)
        for name in ("v_min", "v_max"):
            bound = voltages[name]
            if channel is not None and bound is not None:
                values = self.voltages[name]
                channels.require_own_limit(name, values, channel, bound, actuator)
        ranges = typed["v_min"], typed["v_max"], typed["max_slew"]
        limits = Limits.within(actuator.input, *ranges, self.extrapolate)
        lead = Lead(state, voltages["from"], self.approach, self.condition, self.lead)
        name = self.name if channel is None else f"channel {channel}"
        on_limit, end = self.on_limit, voltages["return"]
        return Driver(actuator, limits, lead, on_limit, end, name, hold)

    def in_memory(
        self, actuator: Cascade, history: Any, channel: str | None = None
    ) -> dict[str, Any]:
        """Return the options that need the whole trajectory; nothing where it may come in blocks."""
        from dbo_cli import channels
        from dbo_cli.recordings import tracked_of

        if not self.whole:
            return {}
        columns, typed = self.columns, self.whole
        if channel is not None:
            columns = channels.columns_for(columns, channel)
        return {
            "bandwidth": opt.quantity("bandwidth", typed["bandwidth"], "Hz"),
            "periodic": typed["periodic"],
            "passes": typed["passes"],
            "absolute": typed["absolute"],
            "tracked": tracked_of(
                typed["tracked"] or [], columns, self.reading, actuator
            ),
            "history": history,
        }


def compensate_one(
    model: str, move: Move, columns: Columns, state: str, written: Written
) -> None:
    """Write the drive of one actuator, and say what to expect."""
    from dbo_cli.drive.learning import dumps_history, read_history
    from dbo_cli.files import Outputs
    from dbo_cli.logs import open_log
    from dbo_cli.model import dumps_state, read_model, state_of

    actuator = read_model(model)
    actuator.require("forward", model)
    history = () if written.history is None else read_history(written.history)
    in_memory = move.in_memory(actuator, history)
    if written.output == "-" and move.on_limit == "auto" and not in_memory:
        move = replace(move, on_limit="clip")  # rows that were sent stay sent
    driver = move.driver(actuator, state_of(state, actuator))
    units = opt.units_of(displacement=actuator.output)
    with open_log(move.name, columns, move.reading, units) as log, Outputs() as outputs:
        drive = write_drive(driver, log, outputs, written.output, in_memory)
        if written.summary is not None:
            outputs.write_text(written.summary, summary_of(drive, log))
        if written.state is not None and drive.state is not None:
            text = dumps_state(drive.state, actuator)
            outputs.write_text(written.state, text, "state")
        if written.history is not None:
            text = dumps_history(drive.history)
            outputs.write_text(written.history, text, "history")
    say_log(log)
    say_output(written.output, drive.line())
    say(drive.expected_line())
    detail(*drive.notes)


def compensate_set(
    model: str, move: Move, columns: Columns, state: str, written: Written
) -> None:
    """Write the drives of channels side by side: equally long, the shorter ones hold."""
    from dbo_cli import channels

    known = channels.names([move.name], move.reading, columns)
    models = channels.models_of(model, known)
    for name, actuator in models.items():
        actuator.require("forward", f"{model}::{name}")
    outputs_of = {name: actuator.output for name, actuator in models.items()}
    roles = {"displacement": outputs_of}
    tables = channels.read(move.name, move.reading, columns, roles)
    states = channels.states_of(state, models)
    histories = channels.histories_of(written.history, known)
    in_memory = {}
    for name, actuator in models.items():
        with channels.naming(name):
            in_memory[name] = move.in_memory(actuator, histories[name], name)

    def drive_of(name: str, hold: int, behind: int) -> Drive:
        table = tables[name]
        driver = move.driver(models[name], states[name], known, name, hold)
        desired, options = table["displacement"], in_memory[name]
        return driver.whole(
            desired, table.dt, table.time, return_rows=behind, **options
        )

    write_set(channels.together(drive_of, known), written)


def write_set(drives: dict[str, Drive], written: Written) -> None:
    """Write the drives of channels side by side, and what belongs to them; say a line for each."""
    from dbo_cli import channels
    from dbo_cli.drive.learning import dumps_history
    from dbo_cli.files import Outputs
    from dbo_cli.logs import add_table
    from dbo_cli.model import dumps_state

    time = next(iter(drives.values())).time
    results = channels.columns_of_drives(drives, time)
    limits = {name: drive.limits.as_dict() for name, drive in drives.items()}
    digests = {name: drive.model.digest for name, drive in drives.items()}
    said_of: dict[str, str | float] = {
        "model": json.dumps(digests),
        "limits": json.dumps(limits),
    }
    with Outputs() as outputs:
        names = [(name, unit) for name, unit, _ in results]
        add_table(outputs, written.output, names, said_of).write(
            *(c for _, _, c in results)
        )
        if written.summary is not None:
            texts = {name: json.dumps(d.summary()) for name, d in drives.items()}
            outputs.write_text(written.summary, channels.dumps_files("summary", texts))
        if written.state is not None:
            texts = {
                name: dumps_state(d.state, d.model)
                for name, d in drives.items()
                if d.state is not None
            }
            text = channels.dumps_files("state", texts)
            outputs.write_text(written.state, text, "state")
        if written.history is not None:
            texts = {name: dumps_history(d.history) for name, d in drives.items()}
            text = channels.dumps_files("history", texts)
            outputs.write_text(written.history, text, "history")
    say_output(written.output, f"{len(drives)} channels, {results[0][2].size:,} rows")
    for name, drive in drives.items():
        expected = drive.expected_line()
        say(f"{name}: {drive.line()}{'; ' if expected else ''}{expected}")


def write_drive(
    driver: Driver,
    wanted: Log,
    outputs: Outputs,
    output: str,
    in_memory: dict[str, Any],
) -> Drive:
    """Drive a trajectory and write it: as a whole where loops or learning need that, else by blocks."""
    from dbo_cli.drive.simulate import Rows
    from dbo_cli.logs import add_table

    if in_memory:
        read = wanted.read()
        drive = driver.whole(read["displacement"], read.dt, read.time, **in_memory)
        table = add_table(outputs, output, *table_of(driver, read.time))
        Rows(drive.time, drive.desired, drive.voltage).send(table.write)
        return drive
    blocks = progress(wanted.blocks(), "driven")
    first = next(blocks)
    table = add_table(outputs, output, *table_of(driver, first.time))
    for block in chain([first], blocks):
        rows = driver.rows(block.values["displacement"], block.dt, block.time)
        rows.send(table.write)
    rows, drive = driver.finish()
    rows.send(table.write)
    return drive


def table_of(driver: Driver, time: Floats | None) -> tuple[Any, Any]:
    """Return names and units of the columns of a drive, and what an HDF5 file says of it."""
    columns: list[tuple[str, str | None]] = [] if time is None else [("time", "s")]
    model, limits = driver.model, json.dumps(driver.limits.as_dict())
    columns.append(("desired", model.output.unit))
    columns.append((model.input.quantity, model.input.unit))
    return columns, {"model": model.digest, "limits": limits}


def summary_of(drive: Drive, wanted: Log) -> str:
    """Return the figures of a drive and its trajectory as JSON."""
    figures = {**drive.summary(), "trajectory": wanted.name}
    if wanted.provided("time"):
        figures["move_time"] = [wanted.clock.first, wanted.clock.last]
    return json.dumps(figures, indent=2) + "\n"
