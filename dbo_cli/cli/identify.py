"""``dbo identify``."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

from dbo_cli.cli.options import (
    Displacement,
    LogFiles,
    Output,
    Summary,
    Text,
    Time,
    Voltage,
    count,
    quantity,
    reads_logs,
    seconds_or_auto,
)
from dbo_cli.cli.say import detail, say, working
from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.identification import Options
    from dbo_cli.logs import Reading
    from dbo_cli.model import Model

STRUCTURE = "Structure of the model"


def rare(metavar: str, text: str) -> Any:
    """Return an option that few need: ``--help-all`` shows it."""
    return Option(metavar=metavar, help=text, hidden=True, rich_help_panel=STRUCTURE)


@reads_logs
def identify(
    logs: LogFiles,
    reading: Reading,
    output: Output = "-",
    summary: Summary = None,
    time: Time = None,
    voltage: Voltage = None,
    displacement: Displacement = None,
    validate: Annotated[
        list[str] | None,
        Option(
            metavar="LOG",
            help="Another log, to say how well the model predicts it; repeatable.",
        ),
    ] = None,
    prior: Annotated[
        Text,
        Option(
            metavar="MODEL",
            help="Keep the shape of this model; find gain, offset and delay again.",
        ),
    ] = None,
    sign: Annotated[
        Literal["rising", "falling"] | None,
        Option(
            help="How displacement goes with voltage: exit 3 where the log shows the other."
        ),
    ] = None,
    skip: Annotated[
        str, Option(metavar="SECONDS", help="Leave out the beginning of every log.")
    ] = "0",
    zero: Annotated[
        str,
        Option(
            metavar="none|mean|first|VALUE",
            help="What displacement counts as 0.",
            hidden=True,
        ),
    ] = "none",
    sensor_delay: Annotated[
        str,
        Option(
            metavar="SECONDS",
            help="Delay of the sensor: taken off the log.",
            hidden=True,
        ),
    ] = "0",
    gears: Annotated[str, rare("N|auto", "Number of gears.")] = "auto",
    points: Annotated[
        str, rare("M|auto", "Segments of the asymmetry; 0 for none.")
    ] = "auto",
    relaxation: Annotated[
        str,
        rare("auto|0|T1,T2,...", "Time constants of lag and creep in s; 0 for none."),
    ] = "auto",
    delay: Annotated[
        str, rare("SECONDS|auto", "Delay of the displacement behind the drive.")
    ] = "auto",
    dynamics: Annotated[
        str, rare("auto|0|1|2", "Resonances, from a log with a sweep.")
    ] = "auto",
    slopes: Annotated[
        Literal["auto", "growing", "falling", "free"],
        Option(
            help="How the slopes of the gears run.",
            hidden=True,
            rich_help_panel=STRUCTURE,
        ),
    ] = "auto",
    method: Annotated[
        Literal["least-squares", "paper"],
        Option(
            help="paper: the procedure of the 2018 publication.",
            hidden=True,
            rich_help_panel=STRUCTURE,
        ),
    ] = "least-squares",
    force: Annotated[
        bool, Option("--force", help="Keep a model no better than a straight line.")
    ] = False,
) -> None:
    """Identify a model of an actuator from logs of drive voltage and displacement.

    Several logs of one actuator are fitted together. With {} in the names of columns
    (--voltage 'V{}' --displacement 'D{}') every channel of a log gets a model; one file
    holds them all.

    Examples: dbo identify recorded.csv -o model.json;
    dbo identify run.csv --voltage CH1 --displacement CH2 --scale displacement=10um/V -o model.json
    """
    from dbo_cli import channels
    from dbo_cli.identification import Options
    from dbo_cli.logs import Outputs, check_outputs, write_text
    from dbo_cli.model import dumps_model, dumps_set, read_model

    check_outputs(*[path for path in (output, summary) if path is not None])

    options = Options(
        prior=None if prior is None else read_model(prior),
        sign=sign,
        skip=quantity("skip", skip, "s") or 0.0,
        zero=zero_of(zero),
        sensor_delay=quantity("sensor_delay", sensor_delay, "s") or 0.0,
        gears=count_or_auto("gears", gears),
        points=count_or_auto("points", points),
        relaxation=relaxation_of(relaxation),
        delay="auto" if delay == "auto" else seconds_of("delay", delay),
        dynamics=count_or_auto("dynamics", dynamics),
        slopes=slopes,
        method=method,
        force=force,
    )
    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    if not channels.is_pattern(columns):
        model = one_model(logs, validate or [], reading, columns, options)
        with Outputs() as outputs:
            outputs.write_text(output, dumps_model(model))
            if summary is not None:
                outputs.write_text(summary, summary_of(model))
        say(f"{named(output)}: {expectation(model)}")
        return
    models = {}
    for name in channels.names(logs, reading, columns):
        chosen = channels.filled(columns, name)
        models[name] = one_model(
            logs, validate or [], reading, chosen, options, quiet=True
        )
    write_text(output, dumps_set(models))
    say(f"{named(output)}: {len(models)} models")
    for name, model in models.items():
        detail(f"{name}: {expectation(model)}")


def one_model(
    paths: list[str],
    validate: list[str],
    reading: Reading,
    columns: dict[str, str | None],
    options: Options,
    quiet: bool = False,
) -> Model:
    """Identify one actuator, and say what was read."""
    from dbo_cli.identification import identify as fit
    from dbo_cli.recordings import read_recordings, require_sign, with_provenance
    from dbo_cli.reports import show_model

    recordings, logs = read_recordings(paths, reading, columns)
    others, _ = read_recordings(validate, reading, columns, units_of(recordings))
    require_sign(recordings, options.sign)
    if options.delay == "auto" and any(log.has_found_offset for log in logs):
        options = replace(options, delay=0.0)  # the offset between the clocks holds it
    working("identifying")
    model = fit(recordings, options, others)
    for log in logs:
        if not quiet:
            say(f"{log.line()} ({model.sign})")
        detail(*log.remarks)
    detail(*model.fit.get("notes", ()))
    model = with_provenance(model, recordings, logs)
    detail(*show_model(model).text().splitlines()[1:])
    return model


def units_of(recordings: list[Any]) -> dict[str, str]:
    """Return the units of the logs, for those that are to be read like them."""
    first = recordings[0]
    units = {"voltage": first.input[1], "displacement": first.output[1]}
    return {role: unit for role, unit in units.items() if unit}


def expectation(model: Model) -> str:
    """Return what to expect of a model, in one line."""
    from dbo_cli.identification import describe

    return describe(model)


def summary_of(model: Model) -> str:
    """Return the figures of the fit as JSON."""
    values = {
        "format": "dbo-summary",
        "version": 1,
        "command": "identify",
        "unit": model.output.unit,
    }
    return json.dumps({**values, **model.fit}, indent=2) + "\n"


def named(output: str) -> str:
    """Return how messages call an output."""
    return "standard output" if output == "-" else output


def zero_of(text: str) -> Any:
    """Return ``--zero``: a word, or a value."""
    if text in ("none", "mean", "first"):
        return text
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"`zero` {text}: none, mean, first or a value") from None


def count_or_auto(name: str, text: str) -> Any:
    """Return a whole number, or ``auto``."""
    return "auto" if text == "auto" else count(name, text)


def seconds_of(name: str, text: str) -> Any:
    """Return seconds of at least 0."""
    seconds = seconds_or_auto(name, text)
    if isinstance(seconds, float) and seconds < 0.0:
        raise UsageError(f"`{name}` {text}: less than 0 s")
    return seconds


def relaxation_of(text: str) -> Any:
    """Return time constants in s, none for ``0``, or ``auto``."""
    if text == "auto":
        return "auto"
    constants = [quantity("relaxation", part, "s") or 0.0 for part in text.split(",")]
    if constants == [0.0]:
        return ()
    if min(constants) <= 0.0:
        raise UsageError(f"`relaxation` {text}: give times above 0")
    return tuple(constants)
