"""``dbo waveform``."""

from __future__ import annotations

from typing import Annotated

from dbo_cli.cli import options as opt
from dbo_cli.cli.check import limits_in, read_drive, step_of
from dbo_cli.cli.options import Text, flag, option
from dbo_cli.cli.say import detail, say, say_output
from dbo_cli.errors import InputError


def waveform(
    drive: opt.DriveFile,
    reading: opt.Reading,
    to: Annotated[
        str, option("FORMAT", "npy, wav, int16, uint16, keysight-arb or pi-gcs.")
    ],
    output: opt.Output = "-",
    gain: Annotated[float, option("FACTOR", "Amplifier gain, divided out.")] = 1.0,
    rate: Annotated[
        Text, option("HZ", "Points per second; default: the drive's.")
    ] = None,
    points: Annotated[
        int | None, option("N", "Points, over the same time.", min=0)
    ] = None,
    loop: Annotated[
        bool, flag("--loop", "The drive is one period: other points keep it.")
    ] = False,
    codes: Annotated[
        Text, option("LOW:HIGH", "Range of codes; default: the format's.")
    ] = None,
    volts: Annotated[
        Text, option("LOW:HIGH", "Output voltage of the codes; default: the drive's.")
    ] = None,
    max_rounding: Annotated[
        float, option("PERCENT", "Allowed rounding, % of range; more: exit 3.")
    ] = 1.0,
    v_min: opt.VMin = None,
    v_max: opt.VMax = None,
    max_slew: opt.MaxSlew = None,
    time: opt.Time = None,
    voltage: opt.Voltage = None,
) -> None:
    """Write a drive in the format of a generator or converter.

    What is written keeps the limits. One line says what to set.

    Example: dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin
    """
    from dbo_cli.files import Outputs
    from dbo_cli.moves import waveform as make

    signal, log = read_drive(drive, reading, {"time": time, "voltage": voltage}, "V")
    step = step_of(signal)
    if step is None:
        raise InputError(
            f"{drive}: needs an even clock: add `resample` HZ, or `sample_rate` HZ if it has none"
        )
    result = make(
        signal["voltage"],
        1.0 / step,
        to,
        limits_in("V", v_min, v_max, max_slew),
        name=drive,
        gain=gain,
        loop=loop,
        points=points,
        rate=opt.quantity("rate", rate, "Hz"),
        codes=None if codes is None else opt.span("codes", codes, None),
        volts=None if volts is None else opt.span("volts", volts, "V"),
        max_rounding=max_rounding,
        doubts=log.doubtful,
    )
    with Outputs() as outputs:
        outputs.write_bytes(output, result.data)
    detail(*log.doubtful)
    say_output(output, result.line)
    say(result.codes)
