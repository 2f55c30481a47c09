"""``dbo excite``."""

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import LIMITS, Text, option
from dbo_cli.cli.say import say_output
from dbo_cli.units import quantity


def excite(
    v_max: str = option("VOLT", "Highest voltage; or with a unit: 4bar.", default=...),
    v_min: str = option("VOLT", "Lowest voltage; default 0.", LIMITS, default="0"),
    max_slew: Text = opt.MAX_SLEW,
    sample_rate: str = option("HZ", "Rows per second; default 1000.", default="1000"),
    duration: Text = option("SECONDS", "Length of the swings; default 30, or longer."),
    rest: Text = option("SECONDS", "Rest after the swings: as long as moves hold."),
    sweep_to: Text = option("HZ", "Append a small sweep up to this frequency."),
    sweep_amplitude: Text = option("VOLT", "Of the sweep; default 1 % of the range."),
    output: str = opt.OUTPUT_FILE,
) -> None:
    """Write a drive from which a model is identified well.

    Play it, record drive and displacement, and pass the log to dbo identify.

    Example: dbo excite --v-max 100 --max-slew 2000 --sample-rate 5000 -o excite.csv
    """
    from dbo_cli.drive.excite import excite as make
    from dbo_cli.logs import create
    from dbo_cli.units import drive_unit, quantity_name

    unit = drive_unit(v_max)
    low = quantity("v_min", v_min, unit)
    high = quantity("v_max", v_max, unit)
    time, voltage = make(
        low,
        high,
        sample_rate=quantity("sample_rate", sample_rate, "Hz"),
        duration=quantity("duration", duration, "s"),
        rest=quantity("rest", rest, "s"),
        max_slew=quantity("max_slew", max_slew, f"{unit}/s"),
        sweep_to=quantity("sweep_to", sweep_to, "Hz"),
        sweep_amplitude=quantity("sweep_amplitude", sweep_amplitude, unit),
    )
    columns = [("time", "s"), (quantity_name("voltage", unit), unit)]
    with create(output, columns) as table:
        table.write(time, voltage)
    ends = f"{low:g} to {high:g} {unit}; begins and ends at {low:g} {unit}"
    say_output(output, f"{len(voltage):,} rows, {time[-1]:.4g} s, {ends}")
