"""``dbo export``."""

from __future__ import annotations

from typing import Annotated, Literal

from typer import Option

from dbo_cli.cli.options import MaxSlew, ModelFile, Text, VMax, VMin, count, hertz
from dbo_cli.cli.say import say
from dbo_cli.errors import UsageError


def export(
    model: ModelFile,
    output: Annotated[
        str, Option("-o", "--output", metavar="DIR", help="The folder that is written.")
    ],
    name: Annotated[
        str, Option(help="Begins the names of files, types and functions.")
    ] = "actuator",
    arithmetic: Annotated[
        Literal["double", "q31"],
        Option(
            help="double: the bits of compensate; q31: whole numbers, with a bound."
        ),
    ] = "double",
    sample_rate: Annotated[
        Text,
        Option(metavar="HZ", help="Steps a second; needed where time matters."),
    ] = None,
    gears: Annotated[
        Text, Option(metavar="N", help="Fewer gears than the model has.")
    ] = None,
    lookup: Annotated[
        bool,
        Option("--lookup", help="A plain table of all states; 12 gears at most."),
    ] = False,
    v_min: VMin = None,
    v_max: VMax = None,
    max_slew: MaxSlew = None,
) -> None:
    """Write the drive of a model as C99 for a controller, with a self-test.

    No allocation, no recursion, no library. The folder appears whole or not at all.

    Example: dbo export model.json --sample-rate 10000 --v-min 0 --v-max 100 -o firmware
    """
    from dbo_cli.drive import Limits
    from dbo_cli.export import export_model, write_folder
    from dbo_cli.model import read_model

    if output == "-":
        raise UsageError("`output` -: an export is a folder: give its name")
    actuator = read_model(model).forward()
    made = export_model(
        actuator,
        Limits.within(actuator.input, v_min, v_max, max_slew),
        name=name,
        arithmetic=arithmetic,
        sample_rate=hertz("sample_rate", sample_rate),
        gears=count("gears", gears),
        lookup=lookup,
    )
    write_folder(output, made.files, made.figures)
    figures = made.figures
    line = f"{output}: {figures['gears']} gears in {arithmetic}"
    if figures["ahead"]:
        line += f", {figures['ahead']} samples ahead"
    if "bounds" in figures:
        bounds, unit = figures["bounds"], actuator.input.suffix
        line += (
            f"; within {bounds['same']:.3g}{unit} ({bounds['same_percent']:.2g} %) of compensate,"
            f" {bounds['close']:.3g}{unit} after a turn on a gear's end"
        )
    say(line)
    if "loss" in figures:
        lost = figures["loss"]
        say(
            f"fewer gears: {lost['rms']:.3g}{actuator.output.suffix} RMS on test moves,"
            f" {lost['max']:.3g} at most"
        )
