"""``dbo trajectory``."""

from typer import Argument

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, Texts, flag, option
from dbo_cli.cli.say import say_output
from dbo_cli.errors import UsageError
from dbo_cli.units import quantity

UNIT = "um"  # without a model
TWO_AXES = ("raster", "spiral")  # whose models may be those of a set


def trajectory(
    shape: str = Argument(
        ..., metavar="SHAPE", help="raster, spiral, staircase, sine or triangle."
    ),
    rate: str = option("HZ", "Rows per second.", default=...),
    range_: str = option(
        "LOW:HIGH",
        "Range of each axis in um, or with unit.",
        None,
        "--range",
        default=...,
    ),
    output: str = opt.OUTPUT_FILE,
    frequency: Text = option("HZ", "Lines, turns or cycles per second."),
    lines: int | None = option("N", "Lines of a raster.", min=0),
    steps: int | None = option("N", "Steps of a staircase: up, then down.", min=0),
    dwell: Text = option("SECONDS", "Time at each level of a staircase."),
    duration: Text = option("SECONDS", "Length of other shapes; default one cycle."),
    loop: bool = flag("--loop", "One closed period, for compensate --periodic."),
    bandwidth: Text = option("HZ", "Round corners, start and stop to this bandwidth."),
    model: Texts = option(
        "MODEL", "Keep its range and bandwidth; a set, or two: x, y."
    ),
) -> None:
    """Write a move: raster, spiral, staircase, sine or triangle.

    It starts and stops softly. Columns: time and displacement, or time, x and y
    (compensate takes one with --displacement x_um).

    Example: dbo trajectory raster --rate 10kHz --range 2:9 --lines 64 --frequency 5
    """
    from dbo_cli.logs import create
    from dbo_cli.model import read_cascade, read_cascades
    from dbo_cli.moves import check_reach
    from dbo_cli.moves import trajectory as make
    from dbo_cli.units import kind_of, parse_unit, spell

    paths = model or []
    if shape in TWO_AXES and len(paths) == 1:
        models = list(read_cascades(paths[0]).values())
    else:
        models = [read_cascade(path) for path in paths]
    for actuator in models:
        actuator.require("forward", " ".join(paths))
    typed_unit = spell(opt.unit_behind(range_.rpartition(":")[2]))
    if parse_unit(typed_unit or UNIT) is None:
        raise UsageError(f"`range` {range_}: that is no unit: type LOW:HIGHum")
    units = {actuator.output.unit for actuator in models} or {typed_unit or UNIT}
    if len(units) > 1:
        raise UsageError("`model`: the units differ; write one axis at a time")
    unit = units.pop()
    if typed_unit is None and kind_of(unit) == kind_of(UNIT) and unit != UNIT:
        raise UsageError(
            f"`range` {range_}: the model is in {unit}: type {range_}{unit} or {range_}{UNIT}"
        )
    ends = opt.span("range", range_, unit)
    limit = quantity("bandwidth", bandwidth, "Hz")
    if limit is None:
        trusted = [actuator.trusted_frequency for actuator in models]
        limit = min((each for each in trusted if each is not None), default=None)
    move = make(
        shape,
        rate=quantity("rate", rate, "Hz"),
        range=ends,
        frequency=quantity("frequency", frequency, "Hz"),
        lines=lines,
        steps=steps,
        dwell=quantity("dwell", dwell, "s"),
        duration=quantity("duration", duration, "s"),
        loop=loop,
        bandwidth=limit,
    )
    if len(models) > len(move.axes):
        raise UsageError(
            f"`model`: {len(models)} models, a {shape} has {len(move.axes)} axes: name one, MODEL::CHANNEL"
        )
    if models:
        check_reach(move, models)
    names = ("displacement",) if len(move.axes) == 1 else ("x", "y")
    columns = [("time", "s"), *((name, unit) for name in names)]
    with create(output, columns) as table:
        table.write(move.time, *move.axes)
    rounded = "sharp corners" if limit is None else f"rounded to {limit:.4g} Hz"
    say_output(output, f"{move.time.size:,} rows, {move.note}; {rounded}")
