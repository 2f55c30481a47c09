"""``dbo compensate``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Option

from dbo_cli.cli.identify import named
from dbo_cli.cli.options import (
    Displacement,
    From,
    MaxSlew,
    ModelFile,
    Output,
    SaveState,
    State,
    Summary,
    Text,
    Time,
    VMax,
    VMin,
    column,
    count,
    hertz,
    reads_logs,
    seconds_or_auto,
)
from dbo_cli.cli.say import detail, progress, say
from dbo_cli.cli.simulate import START_NAMES, present, warn_doubts
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.drive import Drive, Limits
    from dbo_cli.logs import Block, Log, Outputs, Reading
    from dbo_cli.model import Model

BEFORE, LOOPS = "Before and after the move", "Loops and learning"


@reads_logs
def compensate(
    model: ModelFile,
    trajectory: Annotated[
        str, Argument(metavar="TRAJECTORY", help="The wanted displacement; - is stdin.")
    ],
    reading: Reading,
    output: Output = "-",
    summary: Summary = None,
    v_min: VMin = None,
    v_max: VMax = None,
    max_slew: MaxSlew = None,
    extrapolate: Annotated[
        bool,
        Option(
            "--extrapolate",
            help="Leave the identified range, as far as the limits say.",
            hidden=True,
            rich_help_panel="Limits",
        ),
    ] = False,
    on_limit: Annotated[
        Literal["auto", "clip", "error"],
        Option(
            help="auto: clip up to 1 % of the move, else exit 3.",
            rich_help_panel="Limits",
        ),
    ] = "auto",
    start: From = None,
    approach: Annotated[
        Text,
        Option(
            metavar="SECONDS|auto",
            help="Time for the way from there to the first row.",
            rich_help_panel=BEFORE,
        ),
    ] = None,
    condition: Annotated[
        bool,
        Option(
            "--condition",
            help="Sweep the range first: the past is known then.",
            rich_help_panel=BEFORE,
        ),
    ] = False,
    lead: Annotated[
        Text,
        Option(
            metavar="SECONDS|auto",
            help="Begin earlier, for a model with dynamics or a delay.",
            hidden=True,
            rich_help_panel=BEFORE,
        ),
    ] = None,
    return_to: Annotated[
        Text,
        Option(
            "--return",
            metavar="VOLT",
            help="Go to this voltage at the end.",
            rich_help_panel=BEFORE,
        ),
    ] = None,
    periodic: Annotated[
        bool,
        Option(
            "--periodic",
            help="The trajectory is one period of a loop.",
            rich_help_panel=LOOPS,
        ),
    ] = False,
    passes: Annotated[
        str,
        Option(
            metavar="N",
            help="With --periodic: passes before the settled one.",
            hidden=True,
            rich_help_panel=LOOPS,
        ),
    ] = "0",
    tracked: Annotated[
        list[str] | None,
        Option(
            metavar="LOG",
            help="The last pass, recorded: write a better drive; repeatable.",
            rich_help_panel=LOOPS,
        ),
    ] = None,
    history: Annotated[
        Text,
        Option(
            metavar="FILE",
            help="With --tracked: keep the error of each pass there.",
            hidden=True,
            rich_help_panel=LOOPS,
        ),
    ] = None,
    absolute: Annotated[
        bool,
        Option(
            "--absolute",
            help="With --tracked: learn the mean of the error, too.",
            hidden=True,
            rich_help_panel=LOOPS,
        ),
    ] = False,
    bandwidth: Annotated[
        Text,
        Option(
            metavar="HZ",
            help="Round the corners of the trajectory by a zero-phase low-pass.",
            hidden=True,
        ),
    ] = None,
    state: State = "auto",
    save_state: SaveState = None,
    time: Time = None,
    displacement: Displacement = None,
    voltage: Annotated[Text, column("The drive in a --tracked log", rare=True)] = None,
    measured: Annotated[
        Text, column("The displacement in a --tracked log", rare=True)
    ] = None,
) -> None:
    """Write the drive voltage that makes the actuator follow a displacement.

    No row leaves the identified range, cut by --v-min and --v-max.

    Example: dbo compensate model.json move.csv --max-slew 2000 --from 0 -o drive.csv
    """
    from dbo_cli import channels
    from dbo_cli.drive import Limits, voltage_in
    from dbo_cli.model import dumps_state, read_model, read_state

    columns = {"time": time, "displacement": displacement}
    pieces = {"start": start, "approach": approach, "lead": lead, "return": return_to}
    if channels.is_pattern(columns):
        channels.refuse(pieces, condition=condition, periodic=periodic, tracked=tracked)
        chosen = {
            "v_min": v_min,
            "v_max": v_max,
            "max_slew": max_slew,
            "extrapolate": extrapolate,
        }
        done = channels.compensate(
            model, trajectory, output, reading, columns, chosen, on_limit, state
        )
        say(f"{named(output)}: {done}")
        return
    actuator = read_model(model)
    actuator.require("forward", model)
    limits = Limits.within(actuator.input, v_min, v_max, max_slew, extrapolate)
    options: dict[str, Any] = {
        "start": None if start is None else voltage_in("`from`", start, actuator.input),
        "approach": seconds_or_auto("approach", approach),
        "condition": condition,
        "lead": seconds_or_auto("lead", lead),
        "return_to": None
        if return_to is None
        else voltage_in("`return`", return_to, actuator.input),
        "on_limit": on_limit,
        "state": state if state in START_NAMES else read_state(state, actuator),
        "name": trajectory,
    }
    whole: dict[str, Any] = {
        "bandwidth": hertz("bandwidth", bandwidth),
        "periodic": periodic,
        "passes": count("passes", passes),
        "absolute": absolute,
    }
    if tracked:
        recorded = {"time": time, "voltage": voltage, "measured": measured}
        whole["tracked"] = [
            read_tracked(path, reading, recorded, actuator) for path in tracked
        ]
        whole["history"] = read_history(history)
    elif history or absolute:
        raise UsageError("`history` and `absolute` belong to `tracked` LOG")
    units = {"displacement": actuator.output.unit} if actuator.output.unit else {}
    from dbo_cli.logs import Outputs, check_outputs, open_log

    kept = history if tracked else None
    check_outputs(*present(output, summary, save_state, kept))
    with open_log(trajectory, columns, reading, units) as wanted, Outputs() as outputs:
        if whole["bandwidth"] or periodic or tracked:
            options.update(whole)
            drive = drive_whole(actuator, wanted, limits, outputs, output, options)
        else:
            drive = drive_stream(actuator, wanted, limits, outputs, output, options)
        if summary is not None:
            figures = {**drive.summary(), "trajectory": wanted.name}
            outputs.write_text(summary, json.dumps(figures, indent=2) + "\n")
        if save_state is not None and drive.state is not None:
            outputs.write_text(save_state, dumps_state(drive.state, actuator))
        if kept is not None:
            from dbo_cli.drive.learning import dumps_history

            outputs.write_text(kept, dumps_history(drive.history))
    warn_doubts(wanted)
    say(wanted.line())
    detail(*wanted.remarks)
    say(f"{named(output)}: {drive.line()}")
    say(drive.expected_line())
    detail(drive.lead_line())


def drive_stream(
    actuator: Model,
    wanted: Log,
    limits: Limits,
    outputs: Outputs,
    output: str,
    options: dict[str, Any],
) -> Drive:
    """Drive a trajectory block by block."""
    from dbo_cli.drive import stream

    if output == "-" and options["on_limit"] == "auto":
        options = {**options, "on_limit": "clip"}  # rows that were sent stay sent
    blocks = progress(wanted.blocks(), "driven")
    first = next(blocks, None)
    clocked = first is not None and first.time is not None
    rows = stream(actuator, rows_of(first, blocks), limits, **options)
    table = outputs.create(
        output, drive_columns(actuator, clocked), about(actuator, limits)
    )
    for time, desired, voltage in rows:
        table.write(*present(time, desired, voltage))
    assert rows.drive is not None
    return rows.drive


def drive_whole(
    actuator: Model,
    wanted: Log,
    limits: Limits,
    outputs: Outputs,
    output: str,
    options: dict[str, Any],
) -> Drive:
    """Drive a trajectory that has to be known as a whole."""
    from dbo_cli.drive import plan

    read = wanted.read()
    clock = read.dt if isinstance(read.dt, float) else read.time
    drive = plan(actuator, read["displacement"], clock, limits, **options)
    clocked = drive.time is not None
    table = outputs.create(
        output, drive_columns(actuator, clocked), about(actuator, limits)
    )
    table.write(*present(drive.time, drive.desired, drive.voltage))
    return drive


def rows_of(first: Block | None, blocks: Iterable[Block]) -> Iterator[Any]:
    """Yield time, time steps and displacement of each block."""
    if first is None:
        return
    for block in chain([first], blocks):
        yield block.time, block.dt, block.values["displacement"]


def drive_columns(actuator: Model, clocked: bool) -> list[tuple[str, str | None]]:
    """Return names and units of the columns of a drive."""
    columns: list[tuple[str, str | None]] = [("time", "s")] if clocked else []
    columns.append(("desired", actuator.output.unit))
    columns.append((actuator.input.quantity, actuator.input.unit))
    return columns


def about(actuator: Model, limits: Limits) -> dict[str, str | float]:
    """Return what an HDF5 drive says of itself: its model and its limits."""
    return {"model": actuator.digest, "limits": json.dumps(limits.as_dict())}


def read_tracked(
    path: str, reading: Reading, columns: dict[str, str | None], actuator: Model
) -> Any:
    """Read a recorded pass in the model's units."""
    from dbo_cli.drive.learning import Tracked
    from dbo_cli.logs import open_log

    units = {}
    if actuator.input.unit:
        units["voltage"] = actuator.input.unit
    if actuator.output.unit:
        units["measured"] = actuator.output.unit
    with open_log(path, columns, reading, units) as log:
        table = log.read()
    return Tracked(path, table["voltage"], table["measured"], table.time)


def read_history(path: str | None) -> list[Any]:
    """Return the passes so far; none where there is no file yet."""
    from dbo_cli.drive.learning import parse_history

    if path is None or not Path(path).exists():
        return []
    return parse_history(Path(path).read_text(encoding="utf-8"), path)
