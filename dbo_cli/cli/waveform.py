"""``dbo waveform``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from dbo_cli.cli import options as opt
from dbo_cli.cli.check import limits_in, read_drive, step_of
from dbo_cli.cli.options import Text, option
from dbo_cli.cli.say import detail, say, say_output
from dbo_cli.errors import InputError

if TYPE_CHECKING:
    pass


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
    from dbo_cli.units import kind_of, multiplied, ratio

    signal, log = read_drive(drive, reading, {"time": time, "voltage": voltage}, None)
    unit = log.columns["voltage"].unit
    volt = None if unit is None else "V"  # of limits: a unit needs one in the file
    if kind_of(unit) not in (None, "voltage"):
        raise InputError(
            f"{drive}: the drive is in {unit}, not V: add `scale` voltage=FACTORV/{unit}"
        )
    step = step_of(signal)
    if step is None:
        raise InputError(
            f"{drive}: needs an even clock: add `resample` HZ, or `sample_rate` HZ if it has none"
        )
    made = make(
        multiplied(signal["voltage"], ratio(unit, "V")),
        1.0 / step,
        to,
        limits_in(volt, v_min, v_max, max_slew),
        name=drive,
        gain=gain,
        points=points,
        rate=opt.quantity("rate", rate, "Hz"),
        codes=None if codes is None else opt.span("codes", codes, None),
        volts=None if volts is None else opt.span("volts", volts, "V"),
        max_rounding=max_rounding,
        doubts=log.doubtful,
    )
    with Outputs() as outputs:
        outputs.write_bytes(output, made.data)
    detail(*log.doubtful)
    say_output(output, made.line)
    say(made.codes)
