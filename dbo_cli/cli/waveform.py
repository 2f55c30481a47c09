"""``dbo waveform``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from dbo_cli.cli.check import limits_in, read_drive
from dbo_cli.cli.identify import named
from dbo_cli.cli.options import (
    MaxSlew,
    Output,
    Text,
    Time,
    VMax,
    VMin,
    Voltage,
    count,
    hertz,
    number,
    reads_logs,
)
from dbo_cli.cli.say import detail, say
from dbo_cli.cli.trajectory import span
from dbo_cli.errors import InputError

if TYPE_CHECKING:
    from dbo_cli.logs import Reading


@reads_logs
def waveform(
    drive: Annotated[str, Argument(metavar="DRIVE", help="The drive; - is stdin.")],
    reading: Reading,
    to: Annotated[
        str,
        Option(
            metavar="FORMAT",
            help="npy, wav, int16, uint16, keysight-arb or pi-gcs.",
        ),
    ],
    output: Output = "-",
    gain: Annotated[
        str,
        Option(metavar="FACTOR", help="Of the amplifier behind it: divided out."),
    ] = "1",
    rate: Annotated[
        Text, Option(metavar="HZ", help="Points a second; the drive's if not given.")
    ] = None,
    points: Annotated[
        Text, Option(metavar="N", help="Points of the generator, over the same time.")
    ] = None,
    codes: Annotated[
        Text,
        Option(
            metavar="LOW:HIGH",
            help="Lowest and highest code; the format's if not given.",
        ),
    ] = None,
    volts: Annotated[
        Text,
        Option(
            metavar="LOW:HIGH",
            help="What they mean at the generator; the drive's ends if not given.",
        ),
    ] = None,
    max_rounding: Annotated[
        str,
        Option(
            metavar="PERCENT",
            help="By how much rounding or another rate may move it, of its range; more: exit 3.",
        ),
    ] = "1",
    v_min: VMin = None,
    v_max: VMax = None,
    max_slew: MaxSlew = None,
    time: Time = None,
    voltage: Voltage = None,
) -> None:
    """Write a drive as the file that a generator, a wave table or a converter takes.

    What is written keeps the limits. One line says what to set.

    Examples: dbo waveform drive.csv --to keysight-arb --gain 20 --v-max 100 -o drive.arb;
    dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin
    """
    from dbo_cli.logs.write import write_bytes
    from dbo_cli.moves import waveform as make

    signal = read_drive(drive, reading, {"time": time, "voltage": voltage}, "V")
    if signal.step is None:
        raise InputError(
            f"{drive}: a generator plays even steps (`resample` HZ, or `sample_rate` HZ without a clock)"
        )
    made = make(
        signal.voltage,
        1.0 / signal.step,
        to,
        limits_in("V", v_min, v_max, max_slew),
        name=drive,
        gain=number("gain", gain) or 0.0,
        points=count("points", points),
        rate=hertz("rate", rate),
        codes=None if codes is None else span("codes", codes, None),
        volts=None if volts is None else span("volts", volts, "V"),
        max_rounding=number("max_rounding", max_rounding) or 0.0,
        doubts=signal.doubts,
    )
    write_bytes(output, made.data)
    detail(*signal.doubts)
    say(f"{named(output)}: {made.line}")
