"""``dbo compensate``."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from typer import Argument

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import LIMITS, MOVE, OUTPUT, Text, Texts, flag, option, rare
from dbo_cli.cli.say import detail, progress, say, say_log, say_output
from dbo_cli.units import quantity

if TYPE_CHECKING:
    from dbo_cli.drive import Drive, Driver
    from dbo_cli.logs import Log
    from dbo_cli.logs.write import Writer


def compensate(
    reading: opt.Reading,
    model: str = opt.MODEL,
    trajectory: str = Argument(..., metavar="TRAJECTORY", help="The move; - is stdin."),
    output: str = opt.OUTPUT_FILE,
    summary: Text = opt.SUMMARY_FILE,
    v_min: Texts = opt.V_MIN,
    v_max: Texts = opt.V_MAX,
    max_slew: Texts = opt.MAX_SLEW,
    extrapolate: bool = flag(
        "--extrapolate", "Go beyond the identified range, too.", LIMITS, hidden=True
    ),
    on_limit: Literal["auto", "clip", "error"] = option(
        None, "auto: clip up to 1 % of the move, else exit 3.", LIMITS, default="auto"
    ),
    start: Texts = opt.FROM,
    approach: Text = option("SECONDS|auto", "Go smoothly to row 1 in this time.", MOVE),
    condition: bool = flag("--condition", "Sweep first: leave the range clear.", MOVE),
    lead: Text = rare("SECONDS|auto", "Hold row 1 before the move.", MOVE),
    return_to: Texts = option("VOLT", "Go there after the move.", MOVE, "--return"),
    periodic: bool = flag("--periodic", "The trajectory is one period.", MOVE),
    passes: int = rare("N", "Run-in of a --periodic one.", MOVE, default=0, min=0),
    tracked: Texts = option("LOG", "Learn from recordings of the last pass.", MOVE),
    history: Text = rare("FILE", "With --tracked: keeps each pass's error.", OUTPUT),
    absolute: bool = flag(
        "--absolute", "With --tracked: learn the mean error, too.", MOVE, hidden=True
    ),
    bandwidth: Text = rare("HZ", "Zero-phase low-pass of the trajectory.", MOVE),
    state: str = opt.STATE,
    save_state: Text = opt.SAVE_STATE,
    time: Text = opt.TIME,
    displacement: Text = opt.DISPLACEMENT,
    voltage: Text = opt.column("Drive of a --tracked log.", hidden=True),
    measured: Text = opt.column("Displacement of a --tracked log.", hidden=True),
) -> None:
    """Write the drive that makes an actuator follow a displacement.

    Example: dbo compensate model.json move.csv --max-slew 2000 -o drive.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive import Driver, Lead, Limits
    from dbo_cli.files import Output, Outputs, check_outputs
    from dbo_cli.logs import open_log

    learning = {"history": history, "absolute": absolute}
    recorded = {"voltage": voltage, "measured": measured}
    opt.require("tracked", tracked, learning | recorded)
    opt.require("periodic", periodic, {"passes": passes})
    files = {"summary": summary, "state": save_state, "history": history}
    check_outputs(output, summary, state=save_state, history=history)
    columns = {"time": time, "displacement": displacement}
    columns_of = channels.columns_of([trajectory], reading, columns)
    models = channels.models_of(model, columns_of, columns)
    for name, actuator in models.items():
        actuator.require("forward", f"{model}::{name}" if name else model)
    starts = channels.states_of(state, models)
    is_one = "" in models
    streams = is_one and not (tracked or periodic or bandwidth)
    if streams and on_limit == "auto" and Output(output).temporary is None:
        on_limit = "clip"  # rows that were sent stay sent
    texts = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew}
    texts |= {"from": start, "return": return_to}
    typed = channels.values_for(texts, models)

    def driver(channel: str, hold: int = 0, return_rows: int = 0) -> Driver:
        actuator, state = models[channel], starts[channel]
        channels.require_own_limit("v_min", v_min, channel, actuator)
        channels.require_own_limit("v_max", v_max, channel, actuator)
        given = dict(typed[channel])
        begin, end = given.pop("from"), given.pop("return")
        bounds = Limits.within(actuator.input, **given, extrapolate=extrapolate)
        before = Lead(actuator, bounds, state, begin, approach, condition, lead, hold)
        return Driver(
            before,
            on_limit=on_limit,
            return_to=end,
            name=f"channel {channel}" if channel else trajectory,
            return_rows=return_rows,
        )

    if streams:
        units = {"displacement": models[""].output.unit}
        with open_log(trajectory, columns, reading, units) as log, Outputs() as outputs:
            driving = driver("")
            has_time = log.clock.kind != "none"
            table = channels.drive_table(outputs, output, {"": driving}, has_time)
            drive = write_stream(driving, log, table)
            channels.write_summaries(outputs, {"": drive}, {"": log}, files)
        say_one(log, output, drive)
        return
    from dbo_cli.recordings import read_table, tracked_of

    recorded["time"] = time
    reading_of_pass = reading
    if tracked:
        is_joined = "::" in (displacement or "")
        reading, reading_of_pass = readings_apart(reading, recorded, is_joined)
    histories = channels.histories_of(history, models)
    cutoff = quantity("bandwidth", bandwidth, "Hz")
    logs, tables, passes_of = {}, {}, {}
    for name, actuator in models.items():
        units = {"displacement": actuator.output.unit}
        logs[name], tables[name] = read_table(
            trajectory, columns_of[name], reading, units
        )
        if name:
            logs[name].warn_of_assumed()
        roles = channels.columns_for(recorded, name)
        with channels.naming(name):
            passes_of[name] = tracked_of(
                tracked or [], roles, reading_of_pass, actuator
            )
    channels.require_same_rows(logs)

    def drive_of(name: str, hold: int, return_rows: int) -> Drive:
        table = tables[name]
        return driver(name, hold, return_rows).whole(
            table["displacement"],
            table.dt,
            table.time,
            bandwidth=cutoff,
            periodic=periodic,
            passes=passes,
            tracked=passes_of[name],
            history=histories[name],
            absolute=absolute,
        )

    drives = channels.together(drive_of, models)
    with Outputs() as outputs:
        channels.write_drives(outputs, output, drives)
        channels.write_summaries(outputs, drives, logs, files)
    if is_one:
        say_one(logs[""], output, drives[""])
    else:
        say_set(output, drives)


def readings_apart(
    reading: opt.Reading, recorded: Collection[str], is_joined: bool
) -> tuple[opt.Reading, opt.Reading]:
    """Return how a trajectory is read, and how recordings of other roles: each has the scales of its own.

    The drive, whose clock an offset belongs to, is in the recordings; a trajectory has it where it
    is joined of two files.
    """
    scale = reading.scale
    own = {role: scale[role] for role in scale if role not in recorded}
    of_pass = {role: scale[role] for role in scale if role in recorded}
    offset = reading.clock_offset if is_joined else None
    trajectory = replace(reading, scale=own, clock_offset=offset)
    return trajectory, replace(reading, scale=of_pass)


def write_stream(driver: Driver, log: Log, table: Writer) -> Drive:
    """Drive a trajectory and write it, block by block."""
    for block in progress(log.blocks(), "driven"):
        rows = driver.rows(block["displacement"], block.dt, block.time)
        rows.send(table.write)
    rows, drive = driver.finish()
    rows.send(table.write)
    return drive


def say_one(log: Log, output: str, drive: Drive) -> None:
    """Say what was read, what came out, and what to expect."""
    say_log(log)
    say_output(output, drive.line())
    say(drive.expected_line())
    detail(*drive.notes)


def say_set(output: str, drives: dict[str, Drive]) -> None:
    """Say what came out, and a line for each channel."""
    rows = next(iter(drives.values())).rows
    say_output(output, f"{len(drives)} channels, {rows:,} rows")
    for name, drive in drives.items():
        expected = drive.expected_line()
        say(f"{name}: {drive.line()}{'; ' if expected else ''}{expected}")
