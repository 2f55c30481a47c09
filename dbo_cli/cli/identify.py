"""``dbo identify``."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import READING, Text, flag, option, rare
from dbo_cli.cli.say import detail, say, say_logs, say_output, working
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.identification import Options, Recording
    from dbo_cli.logs import Log
    from dbo_cli.model import Cascade

STRUCTURE = "Structure of the model"


def identify(
    logs: opt.LogFiles,
    reading: opt.Reading,
    output: opt.Output = "-",
    summary: opt.Summary = None,
    time: opt.Time = None,
    voltage: opt.Voltage = None,
    displacement: opt.Displacement = None,
    validate: Annotated[
        list[str] | None, option("LOG", "Log to test the model on; repeatable.")
    ] = None,
    prior: Annotated[
        Text, option("MODEL", "Keep its shape; identify gain, offset, delay.")
    ] = None,
    sign: Annotated[
        Literal["rising", "falling"] | None,
        option(None, "Expected direction; exit 3 if the log differs."),
    ] = None,
    skip: opt.Skip = "0",
    zero: Annotated[
        str, rare("none|mean|first|VALUE", "Displacement to call 0.")
    ] = "none",
    sensor_delay: Annotated[
        str, rare("SECONDS", "Delay of the sensor, taken off.", READING)
    ] = "0",
    gears: Annotated[str, rare("N|auto", "Number of gears.", STRUCTURE)] = "auto",
    points: Annotated[
        str, rare("M|auto", "Segments of the asymmetry; 0 for none.", STRUCTURE)
    ] = "auto",
    relaxation: Annotated[
        str,
        rare("auto|0|T1,T2,...", "Creep's time constants in s; 0: none.", STRUCTURE),
    ] = "auto",
    delay: Annotated[
        str, rare("SECONDS|auto", "Delay behind the drive.", STRUCTURE)
    ] = "auto",
    dynamics: Annotated[
        str, rare("auto|0|1|2", "Resonances; needs a sweep in the log.", STRUCTURE)
    ] = "auto",
    slopes: Annotated[
        Literal["auto", "growing", "falling", "free"],
        rare(None, "Slopes of the gears.", STRUCTURE),
    ] = "auto",
    method: Annotated[
        Literal["least-squares", "paper"],
        rare(None, "paper: the procedure of the 2018 paper.", STRUCTURE),
    ] = "least-squares",
    force: Annotated[
        bool, flag("--force", "Keep a model no better than a straight line.")
    ] = False,
) -> None:
    """Identify a model from logs of drive voltage and displacement.

    All logs are of one actuator. {} in the column names stands for a channel's name:
    with --voltage 'V{}' --displacement 'D{}' every channel gets a model.

    Example: dbo identify run.csv --voltage CH1 --scale displacement=10um/V -o model.json
    """
    from dbo_cli import channels
    from dbo_cli.files import Outputs, check_outputs
    from dbo_cli.identification import Options, describe, describe_validation, leads
    from dbo_cli.model import dumps_model, dumps_set, is_set, read_model
    from dbo_cli.reports import ShownModel

    check_outputs(output, summary)
    options = Options(
        prior=None if prior is None or is_set(prior) else read_model(prior),
        sign=sign,
        skip=opt.quantity("skip", skip, "s"),
        zero=opt.number("zero", zero, float, "none", "mean", "first"),
        sensor_delay=opt.quantity("sensor_delay", sensor_delay, "s"),
        gears=opt.number("gears", gears, int, "auto"),
        points=opt.number("points", points, int, "auto"),
        relaxation=relaxation_of(relaxation),
        delay=opt.quantity("delay", delay, "s", "auto"),
        dynamics=opt.number("dynamics", dynamics, int, "auto"),
        slopes=slopes,
        method=method,
        force=force,
    )
    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    tests = validate or []
    if channels.is_pattern(columns):
        known = channels.names(logs, reading, columns)
        shapes = {} if prior is None else channels.models_of(prior, known)
        models, lines = {}, []
        for name in known:
            chosen = channels.columns_for(columns, name)
            own = replace(options, prior=shapes.get(name))
            with channels.naming(name):
                model, recordings, _ = identified(logs, tests, reading, chosen, own)
            models[name] = model
            lines.append(f"{name}: {describe(model, recordings)}")
            lines += [f"{name}: {line}" for line in describe_validation(model)]
        with Outputs() as outputs:
            outputs.write_text(output, dumps_set(models))
            if summary is not None:
                texts = {name: summary_of(model) for name, model in models.items()}
                outputs.write_text(summary, channels.dumps_files("summary", texts))
        say_output(output, f"{len(models)} models")
        for line in lines:
            say(line)
        return
    model, recordings, read = identified(logs, tests, reading, columns, options)
    with Outputs() as outputs:
        outputs.write_text(output, dumps_model(model))
        if summary is not None:
            outputs.write_text(summary, summary_of(model))
    rows = sum(log["rows"] for log in model.provenance["logs"])
    sense = f"{model.sign}, leads the drive" if leads(recordings) else model.sign
    say_logs(read, rows, f" ({sense})")
    detail(*ShownModel(model).text().splitlines()[1:])
    say_output(output, describe(model, recordings))
    for line in describe_validation(model):
        say(line)


def identified(
    paths: list[str],
    validate: list[str],
    reading: opt.Reading,
    columns: dict[str, str | None],
    options: Options,
) -> tuple[Cascade, list[Recording], list[Log]]:
    """Return the model of one actuator, and the recordings and logs that it was identified from."""
    from dbo_cli.recordings import fitted, recordings_of

    units = {}
    if options.prior is not None:
        into, out = options.prior.input, options.prior.output
        units = {"voltage": into.unit, "displacement": out.unit}
    recordings, logs = recordings_of([*paths, *validate], columns, reading, units)
    count = len(paths)
    working("identifying")
    model = fitted(recordings[:count], logs[:count], options, recordings[count:])
    return model, recordings[:count], logs[:count]


def summary_of(model: Cascade) -> str:
    """Return the figures of the fit as JSON."""
    values = {
        "format": "dbo-summary",
        "version": 1,
        "command": "identify",
        "unit": model.output.unit,
    }
    return json.dumps({**values, **model.fit}, indent=2) + "\n"


def relaxation_of(text: str) -> Any:
    """Return time constants in s, 0 for none, or ``auto``."""
    if text == "auto":
        return "auto"
    constants = [
        opt.quantity("relaxation", constant, "s") for constant in text.split(",")
    ]
    if len(constants) > 1 and 0.0 in constants:
        raise UsageError(f"`relaxation` {text}: give times above 0 s, or 0 alone")
    return tuple(constants)
