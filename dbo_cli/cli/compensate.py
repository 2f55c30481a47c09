"""``dbo compensate``."""

from __future__ import annotations

import json
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import LIMITS, MOVE, OUTPUT, READING, Text, flag, option, rare
from dbo_cli.cli.say import detail, progress, say, say_log, say_output

if TYPE_CHECKING:
    from dbo_cli.arrays import Floats
    from dbo_cli.drive import Drive, Driver
    from dbo_cli.files import Outputs
    from dbo_cli.logs import Log


def compensate(
    model: opt.ModelFile,
    trajectory: Annotated[
        str, Argument(metavar="TRAJECTORY", help="Desired displacement; - is stdin.")
    ],
    reading: opt.Reading,
    output: opt.Output = "-",
    summary: opt.Summary = None,
    v_min: opt.VMin = None,
    v_max: opt.VMax = None,
    max_slew: opt.MaxSlew = None,
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
    start: opt.From = None,
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
        Text, option("VOLT", "Voltage to end at.", MOVE, "--return")
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
    from dbo_cli.drive import Driver, Lead, Limits, voltage_in
    from dbo_cli.drive.learning import read_history
    from dbo_cli.files import Outputs, check_outputs
    from dbo_cli.logs import open_log
    from dbo_cli.model import dumps_state, read_model, state_of
    from dbo_cli.recordings import tracked_of

    columns = {"time": time, "displacement": displacement}
    ranges = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew}
    around = {"from": start, "approach": approach, "condition": condition, "lead": lead}
    learning = {"tracked": tracked, "history": history, "absolute": absolute}
    whole = {"bandwidth": bandwidth, "periodic": periodic, "passes": passes, **learning}
    if channels.is_pattern(columns):
        files = {"return": return_to, "summary": summary, "save_state": save_state}
        channels.refuse({**around, **whole, **files})
        limits_of = {**ranges, "extrapolate": extrapolate}
        text = channels.compensate(
            model, trajectory, output, reading, columns, limits_of, on_limit, state
        )
        say_output(output, text)
        return
    opt.require(
        "tracked", tracked, {**learning, "voltage": voltage, "measured": measured}
    )
    opt.require("periodic", periodic, {"passes": passes})
    actuator = read_model(model)
    actuator.require("forward", model)
    limits = Limits.within(actuator.input, **ranges, extrapolate=extrapolate)
    before = Lead(
        state_of(state, actuator),
        None if start is None else voltage_in("from", start, actuator.input),
        opt.quantity("approach", approach, "s", "auto"),
        condition,
        opt.quantity("lead", lead, "s", "auto"),
    )
    end = None if return_to is None else voltage_in("return", return_to, actuator.input)
    in_memory: dict[str, Any] = {}
    if any(whole.values()):
        roles = {"time": time, "voltage": voltage, "measured": measured}
        in_memory = {
            "bandwidth": opt.quantity("bandwidth", bandwidth, "Hz"),
            "periodic": periodic,
            "passes": passes,
            "absolute": absolute,
            "tracked": tracked_of(tracked or [], roles, reading, actuator),
            "history": () if history is None else read_history(history),
        }
    elif output == "-" and on_limit == "auto":
        on_limit = "clip"  # rows that were sent stay sent
    driver = Driver(actuator, limits, before, on_limit, end, trajectory)
    check_outputs(output, summary, state=save_state, history=history)
    units = opt.units_of(displacement=actuator.output)
    with open_log(trajectory, columns, reading, units) as wanted, Outputs() as outputs:
        drive = write_drive(driver, wanted, outputs, output, in_memory)
        if summary is not None:
            outputs.write_text(summary, summary_of(drive, wanted))
        if save_state is not None and drive.state is not None:
            outputs.write_text(save_state, dumps_state(drive.state, actuator), "state")
        if history is not None:
            from dbo_cli.drive.learning import dumps_history

            outputs.write_text(history, dumps_history(drive.history), "history")
    say_log(wanted)
    say_output(output, drive.line())
    say(drive.expected_line())
    detail(*drive.notes)


def write_drive(
    driver: Driver,
    wanted: Log,
    outputs: Outputs,
    output: str,
    in_memory: dict[str, Any],
) -> Drive:
    """Drive a trajectory and write it: as a whole where loops or learning need that, else by blocks."""
    from dbo_cli.drive.ahead import Rows, write
    from dbo_cli.logs import add_table

    if in_memory:
        read = wanted.read()
        clock = read.dt if isinstance(read.dt, float) else read.time
        drive = driver.whole(read["displacement"], clock, **in_memory)
        table = add_table(outputs, output, *table_of(driver, read.time))
        write(table, Rows(drive.time, drive.desired, drive.voltage))
        return drive
    blocks = progress(wanted.blocks(), "driven")
    first = next(blocks)
    table = add_table(outputs, output, *table_of(driver, first.time))
    for block in chain([first], blocks):
        write(table, driver.rows(block.values["displacement"], block.dt, block.time))
    rest, drive = driver.finish()
    write(table, rest)
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
