"""``dbo trajectory``."""

from __future__ import annotations

from typing import Annotated

from typer import Argument, Option

from dbo_cli.cli.identify import named
from dbo_cli.cli.options import Output, Text, count, hertz, quantity
from dbo_cli.cli.say import say
from dbo_cli.errors import UsageError

UNIT = "um"  # without a model


def trajectory(
    shape: Annotated[
        str,
        Argument(metavar="SHAPE", help="raster, spiral, staircase, sine or triangle."),
    ],
    rate: Annotated[str, Option(metavar="HZ", help="Rows a second.")],
    range_: Annotated[
        str,
        Option(
            "--range",
            metavar="LOW:HIGH",
            help="From where to where, every axis; in the model's unit, else um, or typed: 0:5mrad.",
        ),
    ],
    output: Output = "-",
    frequency: Annotated[
        Text,
        Option(metavar="HZ", help="Lines, turns of a spiral, or cycles a second."),
    ] = None,
    lines: Annotated[Text, Option(metavar="N", help="Of a raster.")] = None,
    steps: Annotated[
        Text, Option(metavar="N", help="Of a staircase: up, and as many down.")
    ] = None,
    dwell: Annotated[
        Text, Option(metavar="SECONDS", help="At each level of a staircase.")
    ] = None,
    duration: Annotated[
        Text,
        Option(
            metavar="SECONDS",
            help="Of a spiral, sine or triangle: whole turns or cycles; one if not given.",
        ),
    ] = None,
    loop: Annotated[
        bool,
        Option(
            "--loop",
            help="One period that closes, for compensate --periodic; a raster: up and down.",
        ),
    ] = False,
    bandwidth: Annotated[
        Text,
        Option(
            metavar="HZ",
            help="Each turn, step, start and stop takes one period of it; sharp if not known.",
        ),
    ] = None,
    model: Annotated[
        list[str] | None,
        Option(
            metavar="MODEL",
            help="Refuse what it does not reach, round to what it is trusted to; twice: x and y.",
        ),
    ] = None,
) -> None:
    """Write a move to be followed: raster, spiral, staircase, sine or triangle.

    It starts and stops softly. Columns: time and displacement, or time, x and y
    (compensate takes one with --displacement x_um).

    Example: dbo trajectory raster --rate 10000 --range 2:9 --lines 64 --frequency 5
    --model model.json -o scan.csv
    """
    from dbo_cli.logs import create
    from dbo_cli.model import read_model
    from dbo_cli.moves import check_reach, trusted_frequency
    from dbo_cli.moves import trajectory as make

    models = [read_model(path) for path in model or []]
    for path, actuator in zip(model or [], models, strict=True):
        actuator.require("forward", path)
    units = {actuator.output.unit for actuator in models} or {_typed_unit(range_)}
    if len(units) > 1:
        raise UsageError("`model`: the models have different units; write an axis each")
    unit = units.pop()
    ends = span("range", range_, unit)
    limit = hertz("bandwidth", bandwidth)
    if limit is None:
        limit = trusted_frequency(models)
    made = make(
        shape,
        rate=hertz("rate", rate) or 0.0,
        range=ends,
        frequency=hertz("frequency", frequency),
        lines=count("lines", lines),
        steps=count("steps", steps),
        dwell=quantity("dwell", dwell, "s"),
        duration=quantity("duration", duration, "s"),
        loop=loop,
        bandwidth=limit,
    )
    if len(models) > len(made.axes):
        raise UsageError(
            f"`model`: a {shape} has {len(made.axes)} axis; give one model"
        )
    if models:
        check_reach(made, ends, models)
    names = ("displacement",) if len(made.axes) == 1 else ("x", "y")
    columns = [("time", "s"), *((name, unit) for name in names)]
    with create(output, columns) as table:
        table.write(made.time, *made.axes)
    rounded = "corners sharp (--bandwidth HZ rounds them)"
    if limit is not None:
        rounded = f"rounded to {limit:.4g} Hz"
    say(f"{named(output)}: {made.time.size:,} rows, {made.note}; {rounded}")


def span(name: str, text: str, unit: str | None) -> tuple[float, float]:
    """Return the two numbers of ``LOW:HIGH``; a unit behind the second is that of both."""
    from dbo_cli.units import parse_quantity

    low, colon, high = text.partition(":")
    if not colon:
        raise UsageError(f"`{name}` {text}: type LOW:HIGH, for example 0:5")
    own = _unit_behind(high)
    if own and not _unit_behind(low):
        low += own
    return parse_quantity(low, unit, name), parse_quantity(high, unit, name)


def _unit_behind(text: str) -> str:
    return text.strip().lstrip("+-.0123456789eE").strip()


def _typed_unit(text: str) -> str:
    """Return the unit behind a typed range; um where there is none."""
    return _unit_behind(text.rpartition(":")[2]) or UNIT
