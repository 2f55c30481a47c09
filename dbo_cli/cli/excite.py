"""``dbo excite``."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from dbo_cli.cli.identify import named
from dbo_cli.cli.options import MaxSlew, Output, Text, VMin, hertz, quantity
from dbo_cli.cli.say import say


def excite(
    v_max: Annotated[
        str,
        Option(
            metavar="VOLT",
            help="Highest voltage; with a unit for another drive (4bar).",
        ),
    ],
    v_min: VMin = "0",
    max_slew: MaxSlew = None,
    sample_rate: Annotated[str, Option(metavar="HZ", help="Rows a second.")] = "1000",
    duration: Annotated[
        Text,
        Option(
            metavar="SECONDS",
            help="Of the swings; 30 s, or longer where the slew is limited.",
        ),
    ] = None,
    sweep_to: Annotated[
        Text,
        Option(
            metavar="HZ",
            help="Append a small sweep up to this frequency, for the dynamics.",
        ),
    ] = None,
    sweep_amplitude: Annotated[
        Text,
        Option(
            metavar="VOLT",
            help="Amplitude of the sweep; 1 % of the range where not given.",
        ),
    ] = None,
    output: Output = "-",
) -> None:
    """Write a drive from which a model is identified well.

    Play it, record drive and displacement, and give the log to dbo identify.

    Example: dbo excite --v-max 100 --max-slew 2000 --sample-rate 5000 -o excitation.csv
    """
    from dbo_cli.drive.excite import SAMPLE_RATE
    from dbo_cli.drive.excite import excite as make
    from dbo_cli.logs import create
    from dbo_cli.units import drive_unit, quantity_name

    unit = drive_unit(v_max)
    low = quantity("v_min", v_min, unit) or 0.0
    high = quantity("v_max", v_max, unit) or 0.0
    time, voltage = make(
        low,
        high,
        sample_rate=hertz("sample_rate", sample_rate) or SAMPLE_RATE,
        duration=quantity("duration", duration, "s"),
        max_slew=quantity("max_slew", max_slew, f"{unit}/s"),
        sweep_to=hertz("sweep_to", sweep_to),
        sweep_amplitude=quantity("sweep_amplitude", sweep_amplitude, unit),
    )
    with create(
        output, [("time", "s"), (quantity_name("voltage", unit), unit)]
    ) as table:
        table.write(time, voltage)
    say(
        f"{named(output)}: {len(voltage):,} rows, {time[-1]:.4g} s, {low:g} to {high:g} {unit}"
    )
