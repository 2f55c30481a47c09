"""``dbo identify``."""

import json
from dataclasses import replace
from typing import Any, Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import READING, Text, Texts, flag, option, rare
from dbo_cli.cli.say import detail, say, say_logs, say_output, working


def structure(metavar: str | None, text: str, default: str = "auto") -> Any:
    """Return an option of the model's structure."""
    return rare(metavar, text, "Structure of the model", default=default)


def identify(
    reading: opt.Reading,
    logs: list[str] = opt.LOGS,
    output: str = opt.OUTPUT_FILE,
    summary: Text = opt.SUMMARY_FILE,
    time: Text = opt.TIME,
    voltage: Text = opt.VOLTAGE,
    displacement: Text = opt.DISPLACEMENT,
    validate: Texts = option("LOG", "Log to test the model on; repeatable."),
    prior: Text = option("MODEL", "Keep its shape; identify gain, offset, delay."),
    sign: Literal["rising", "falling"] | None = option(
        None, "Expected direction; exit 3 if the log differs."
    ),
    skip: str = opt.SKIP,
    zero: str = rare("none|mean|first|VALUE", "What counts as 0.", default="none"),
    sensor_delay: str = rare("SECONDS", "Delay of the sensor.", READING, default="0"),
    gears: str = structure("N|auto", "Number of gears."),
    points: str = structure("M|auto", "Segments of the curve; 0 for none."),
    relaxation: str = structure("auto|0|T1,T2,...", "Time constants of creep in s."),
    delay: str = structure("SECONDS|auto", "Delay from drive to displacement."),
    dynamics: str = structure("auto|0|1|2", "Resonances; needs a sweep in the log."),
    slopes: Literal["auto", "growing", "falling", "free"] = structure(
        None, "Whether the gears' slopes grow or fall."
    ),
    method: Literal["least-squares", "paper"] = structure(
        None, "paper: the procedure of the 2018 paper.", "least-squares"
    ),
    force: bool = flag("--force", "Keep a model no better than a straight line."),
) -> None:
    """Identify a model from logs of drive voltage and displacement.

    All logs are of one actuator. {} in the column names stands for a channel's name:
    with --voltage 'V{}' --displacement 'D{}' every channel gets a model.

    Example: dbo identify run.csv --voltage CH1 --scale displacement=10um/V -o model.json
    """
    typed = dict(locals())
    from dbo_cli import channels
    from dbo_cli.files import Outputs, check_outputs
    from dbo_cli.identification import describe
    from dbo_cli.model import dumps_model, dumps_set
    from dbo_cli.recordings import identified, options_of, recordings_of, units_of
    from dbo_cli.reports.show import shown_text

    check_outputs(output, summary)
    options = options_of({**typed, "prior": None})
    columns = {"time": time, "voltage": voltage, "displacement": displacement}
    columns_of = channels.columns_of(logs, reading, columns)
    priors = {} if prior is None else channels.models_of(prior, columns_of, columns)
    models, lines, read = {}, [], []
    for name, roles in columns_of.items():
        shape = priors.get(name)
        units = units_of(shape, "displacement")
        with channels.naming(name):
            every, opened = recordings_of(
                [*logs, *(validate or [])], roles, reading, units
            )
            recordings, tests = every[: len(logs)], every[len(logs) :]
            working("identifying")
            asked, own = replace(options, prior=shape), opened[: len(logs)]
            models[name] = identified(recordings, own, asked, tests)
        read += own
        texts = describe(models[name], recordings)
        lines += [f"{name}: {text}" if name else text for text in texts]
    with Outputs() as outputs:
        is_set = "" not in models
        text = dumps_set(models) if is_set else dumps_model(models[""])
        outputs.write_text(output, text)
        if summary is not None:
            figures = {}
            values = {"format": "dbo-summary", "version": 1, "command": "identify"}
            for name, fitted in models.items():
                figure = {**values, "unit": fitted.output.unit, **fitted.fit}
                figures[name] = json.dumps(figure, indent=2) + "\n"
            outputs.write_text(summary, channels.dumps_files("summary", figures))
    model = next(iter(models.values()))
    if is_set:
        lines.insert(0, f"{len(models)} models")
        say_logs(read)
    else:
        say_logs(read, f" ({model.sign})")
        detail(*shown_text(model, "").splitlines()[1:])
    say_output(output, lines.pop(0))
    for line in lines:
        say(line)
