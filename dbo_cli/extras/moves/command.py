"""The commands ``trajectory`` and ``waveform``: their options, one call each, their messages."""

from __future__ import annotations

from dbo_cli import extensions
from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import (
    DRIVE_COLUMN,
    EXTRAPOLATE,
    MAX_SLEW,
    OUTPUT,
    OUTPUT_FORMAT,
    READING_OF_LOGS,
    REPORTING,
    REQUIRED,
    SUMMARY,
    VOLTAGE_MAX,
    VOLTAGE_MIN,
    Option,
    figure_above_0,
    one_of,
    positive,
    whole,
)  # fmt: skip

GENERATOR_FILES = (
    "npy", "wav", "int16", "uint16", "tdms", "pi-gcs", "keysight-arb", "tektronix-tfw", "rigol-raf",
    "picoscope",
)  # fmt: skip


def generator_file(option: str, text: str) -> str:
    """Return the name of a format, also of one that another package brings (else ``UsageError``)."""
    if text not in GENERATOR_FILES and extensions.find("generator", text) is not None:
        return text
    name: str = one_of(GENERATOR_FILES)(option, text)
    return name


SHAPE = Option(
    "SHAPE",
    "raster, spiral, staircase, sine or triangle.",
    choices=("raster", "spiral", "staircase", "sine", "triangle"),
)
MOVE = (  # the fields of ``TrajectoryOptions``
    Option("--rate HZ", "Rows a second.", REQUIRED),
    Option(
        "--range LOW:HIGH",
        "From where to where: a raster's lines, a spiral's first axis.",
        REQUIRED,
    ),
    Option(
        "--slow-range LOW:HIGH",
        "The second axis of raster and spiral [default: the same].",
    ),
    Option("--frequency HZ", "Lines, turns or cycles a second."),
    Option("--lines N", "Of a raster."),
    Option("--pixels N", "Of a line: each gets a whole number of rows."),
    Option(
        "--overscan PERCENT",
        "How far lines go on at their speed beyond the range.",
        "0",
    ),
    Option(
        "--one-way",
        "Lines in one direction, the way back as fast; a staircase up alone.",
    ),
    Option("--turns N", "Of a spiral."),
    Option("--cycles N", "Of sine and triangle [default: 1]."),
    Option("--steps N", "Of a staircase."),
    Option("--dwell SECONDS", "At each level of a staircase.", parse=positive),
    Option("--rest SECONDS", "At rest before and after the move.", "0"),
    Option("--loop", "Whole cycles without start and stop, for compensate --periodic."),
    Option("--bandwidth HZ", "Each turn, step, start and stop takes one period of it."),
)
MOVE_MODEL = Option(
    "--model MODEL",
    "Round to what it can be trusted to, refuse what it cannot reach; one an axis, or one for both.",
    repeated=True,
)
MOVE_LIMITS = (VOLTAGE_MIN, VOLTAGE_MAX, EXTRAPOLATE)
UNIT = Option(
    "--unit UNIT", "What the figures are in: um, nm, mrad [default: the model's]."
)
DRIVES = Option(
    "DRIVE", "The drive; several where the file has channels.", repeated=True
)
DRIVE_COLUMNS = DRIVE_COLUMN._replace(
    meaning="The drive, guessed by name; several times: columns of one file, or one a file.",
    repeated=True,
)
GENERATOR = (  # the fields of ``WaveformOptions``
    Option(
        "--to FORMAT",
        ", ".join(GENERATOR_FILES) + ".",
        REQUIRED,
        parse=generator_file,
        choices=GENERATOR_FILES,
    ),
    Option("--gain FACTOR", "Of the amplifier behind the generator: divided out.", "1"),
    Option(
        "--points N",
        "Of the generator: resampled to so many; with --rate the last value fills.",
        parse=whole(2),
    ),
    Option("--rate HZ", "Points a second [default: the drive's]."),
    Option(
        "--codes LOW:HIGH", "The lowest and the highest code [default: the format's]."
    ),
    Option(
        "--volts LOW:HIGH",
        "What they mean at the generator [default: the drive's ends].",
    ),
    Option("--loop", "The drive repeats: it must close, and stays so at another rate."),
    Option("--v-min VOLT", "Lowest drive allowed."),
    Option("--v-max VOLT", "Highest drive allowed."),
    MAX_SLEW,
    Option(
        "--tolerance VOLT",
        "By how much another rate may move the drive [default: a thousandth of its range].",
        parse=figure_above_0,
    ),
    Option(
        "--max-rounding PERCENT",
        "By how much rounding may move it, of its range; more: exit 3.",
        "1",
    ),
)


def trajectory(arguments: Arguments) -> None:
    """Write a move to be followed: raster, spiral, staircase, sine or triangle.

    It starts and stops softly, and its turns and steps are rounded to --bandwidth or to
    what --model can be trusted to; what the model does not reach is refused.

    Writes
    ------
    Time and displacement, or time, x and y: dbo compensate --displacement x_um takes
    one of them.

    Usual options
    -------------
    --rate --range --frequency --lines --turns --cycles --steps --dwell --bandwidth
    --model -o

    Examples
    --------
    A raster that a model can follow:
        dbo trajectory raster --rate 10000 --range 2:9 --lines 64 --frequency 5 --model
        m.json -o s.csv
    Levels up and down:
        dbo trajectory staircase --rate 500 --range 1:9 --steps 9 --dwell 1 --model
        m.json -o s.csv
    """
    from dbo_cli.drives.options import DriveOptions
    from dbo_cli.extras.moves.shapes import TrajectoryOptions
    from dbo_cli.extras.moves.trajectory import write_trajectory

    shape = TrajectoryOptions(arguments.shape, **arguments.of(MOVE))
    models = arguments.model or []
    destination = arguments.destination(models)
    drive = DriveOptions(**arguments.of(MOVE_LIMITS))
    arguments.reporter.notes(
        write_trajectory(
            destination, shape, models, arguments.unit, arguments.format, drive
        )
    )


def waveform(arguments: Arguments) -> None:
    """Write a drive as the file that a generator, a wave table or a converter takes.

    What is written is read back and passes the gate that the drive passed. One line
    says what to set: points, rate, amplitude, offset, repetitions, and by how much
    rounding moves the drive.

    Writes
    ------
    The generator's file; one line on standard error says what to set there.

    Usual options
    -------------
    --to --gain --points --rate --volts --v-min --v-max --max-slew -o

    Examples
    --------
    For a generator before an amplifier of gain 20:
        dbo waveform drive.csv --to keysight-arb --gain 20 --v-min 0 --v-max 100 -o
        drive.arb
    Codes of a 16-bit converter from 0 to 5 V:
        dbo waveform drive.csv --to uint16 --gain 20 --volts 0:5 -o drive.bin

    Exit code 3
    -----------
    The drive breaks a limit, or the generator's rate or range would change it by more
    than allowed.
    """
    from dbo_cli.extras.moves.waveform import WaveformOptions, write_waveform

    generator = WaveformOptions(
        **arguments.of(GENERATOR), voltage=tuple(arguments.voltage or ())
    )
    destination = arguments.destination(arguments.drive)
    arguments.reporter.remarks(
        write_waveform(arguments.drive, destination, arguments.reading, generator)
    )


TRAJECTORY = Command(
    trajectory,
    (
        SHAPE,
        *REPORTING,
        *MOVE,
        MOVE_MODEL,
        *MOVE_LIMITS,
        UNIT,
        OUTPUT_FORMAT,
        SUMMARY,
        OUTPUT,
    ),
)
WAVEFORM = Command(
    waveform,
    (DRIVES, *READING_OF_LOGS, *REPORTING, *GENERATOR, DRIVE_COLUMNS, SUMMARY, OUTPUT),
)
