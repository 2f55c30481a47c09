"""``dbo export``."""

from typing import Literal

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, flag, option
from dbo_cli.cli.say import say, say_output
from dbo_cli.errors import UsageError, prefixed
from dbo_cli.units import quantity


def export(
    model: str = opt.MODEL,
    output: str = option("DIR", "Output folder.", None, "-o", "--output", default=...),
    name: str = option(None, "First word of all names in C.", default="actuator"),
    arithmetic: Literal["double", "q31"] = option(
        None, "double: exact (default); q31: integers, bounded error.", default="double"
    ),
    sample_rate: Text = option("HZ", "Steps per second, for a model that needs time."),
    gears: int | None = option("N", "Use so many gears, fewer than the model.", min=0),
    lookup: bool = flag("--lookup", "Table of all states; at most 12 gears."),
    v_min: Text = opt.V_MIN,
    v_max: Text = opt.V_MAX,
    max_slew: Text = opt.MAX_SLEW,
) -> None:
    """Write C99 that computes a model's drive, with a self-test.

    No allocation, no recursion, no library. The folder appears whole or not at all.

    Example: dbo export model.json --sample-rate 10000 --v-min 0 --v-max 100 -o firmware
    """
    from dbo_cli.drive import Limits
    from dbo_cli.export import export_model, write_folder
    from dbo_cli.model import read_cascade

    if output == "-":
        raise UsageError("`output` -: give the name of a folder")
    actuator = read_cascade(model).forward()
    limits = Limits.within(actuator.input, v_min, v_max, max_slew)
    rate = quantity("sample_rate", sample_rate, "Hz")
    with prefixed(model):
        result = export_model(
            actuator,
            limits,
            name=name,
            arithmetic=arithmetic,
            sample_rate=rate,
            gears=gears,
            lookup=lookup,
        )
    write_folder(output, result.files, result.figures)
    figures = result.figures
    line = f"{figures['gears']:,} gears in {arithmetic}"
    if figures["ahead"]:
        line += f", {figures['ahead']} samples ahead"
    say_output(output, line)
    if "bounds" in figures:
        bounds, unit = figures["bounds"], actuator.input.suffix
        say(
            f"within {bounds['same']:.3g}{unit} ({bounds['same_percent']:.2g} %) of compensate;"
            f" {bounds['close']:.3g}{unit} after a turn on a gear's end"
        )
    if "loss" in figures:
        lost, unit = figures["loss"], actuator.output.suffix
        say(
            f"fewer gears: {lost['rms']:.3g}{unit} RMS on test moves, {lost['max']:.3g} at most"
        )
