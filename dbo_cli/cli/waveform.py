"""``dbo waveform``."""

from dbo_cli.cli import options as opt
from dbo_cli.cli.options import Text, Texts, flag, option
from dbo_cli.cli.say import detail, say, say_output
from dbo_cli.errors import InputError
from dbo_cli.units import quantity


def waveform(
    reading: opt.Reading,
    drive: str = opt.DRIVE,
    to: str = option(
        "FORMAT", "npy, wav, int16, uint16, keysight-arb or pi-gcs.", default=...
    ),
    output: str = opt.OUTPUT_FILE,
    gain: float = option("FACTOR", "Amplifier gain, divided out.", default=1.0),
    rate: Text = option("HZ", "Points per second; default: the drive's."),
    points: int | None = option("N", "Number of points, over the same time.", min=0),
    loop: bool = flag("--loop", "The drive is one period of a loop."),
    codes: Text = option("LOW:HIGH", "Range of codes; default: the format's."),
    volts: Text = option("LOW:HIGH", "Voltage at these codes; default: the drive's."),
    max_rounding: float = option(
        "PERCENT", "Largest rounding in % of the range; default 1.", default=1.0
    ),
    v_min: Texts = opt.V_MIN,
    v_max: Texts = opt.V_MAX,
    max_slew: Texts = opt.MAX_SLEW,
    time: Text = opt.TIME,
    voltage: Text = opt.VOLTAGE,
) -> None:
    """Write a drive in the format of a generator or converter.

    What is written keeps the limits. The line says what to set there.

    Example: dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin
    """
    from dbo_cli import channels
    from dbo_cli.drive import Limits
    from dbo_cli.files import Outputs
    from dbo_cli.moves import side_by_side
    from dbo_cli.moves import waveform as make
    from dbo_cli.recordings import read_drive
    from dbo_cli.units import kind_of, multiplied, ratio

    columns = {"time": time, "voltage": voltage}
    columns_of = channels.columns_of([drive], reading, columns)
    ranges = {"v_min": v_min, "v_max": v_max, "max_slew": max_slew}
    limits = channels.values_for(ranges, columns_of)
    waveforms = {}
    for channel, roles in columns_of.items():
        log, signal = read_drive(drive, roles, reading)
        unit = log.columns["voltage"].unit
        if kind_of(unit) not in (None, "voltage"):
            raise InputError(
                f"{drive}: the drive is in {unit}, not V: add `scale` voltage=FACTORV/{unit}"
            )
        volt = None if unit is None else "V"  # a limit's unit needs one in the file
        if signal.step is None:
            raise InputError(
                f"{drive}: needs an even clock: add `resample` HZ, or `sample_rate` HZ if it has none"
            )
        waveforms[channel] = make(
            multiplied(signal["voltage"], ratio(unit, "V")),
            1.0 / signal.step,
            to,
            Limits.in_unit(volt, **limits[channel]),
            name=f"{drive}: channel {channel}" if channel else drive,
            gain=gain,
            loop=loop,
            points=points,
            rate=quantity("rate", rate, "Hz"),
            codes=None if codes is None else opt.span("codes", codes, None),
            volts=None if volts is None else opt.span("volts", volts, "V"),
            max_rounding=max_rounding,
            doubts=log.doubtful,
        )
        detail(*log.doubtful)
    joined = None
    if "" not in waveforms:
        joined = side_by_side(list(waveforms.values()), to)
    if joined is not None:
        files = {output: joined}
    else:
        paths = channels.paths_of(output, waveforms)
        files = {paths[name]: written.data for name, written in waveforms.items()}
    with Outputs() as outputs:
        for path, data in files.items():
            outputs.write_bytes(path, data)
    for channel, written in waveforms.items():
        say_output(f"{output}: {channel}" if channel else output, written.line)
        say(written.codes)
