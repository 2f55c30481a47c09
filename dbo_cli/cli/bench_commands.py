"""The commands beside the bench: moves to be followed, and drives as the files that generators take."""

from __future__ import annotations

import shlex

from dbo_cli.cli import options
from dbo_cli.cli.commands import COMMANDS, Command, Given
from dbo_cli.cli.options import REQUIRED, Option
from dbo_cli.cli.values import address, choice, not_negative, number, positive, span, whole

__all__ = ["COMMANDS"]  # all of them, the two below included
GENERATOR_FILES = (
    "npy", "wav", "int16", "uint16", "tdms", "pi-gcs", "keysight-arb", "tektronix-tfw", "rigol-raf",
    "picoscope",
)  # fmt: skip
SHAPES = choice(("raster", "spiral", "staircase", "sine", "triangle"))
SHAPE = Option("SHAPE", "raster, spiral, staircase, sine or triangle.", SHAPES, REQUIRED)
MOVE = (  # the fields of ``TrajectoryOptions``
    Option("--rate HZ", "Rows a second.", positive, REQUIRED),
    Option(
        "--range LOW:HIGH", "From where to where: a raster's lines, a spiral's first axis.", span, REQUIRED
    ),
    Option("--slow-range LOW:HIGH", "The second axis of raster and spiral [default: the same].", span),
    Option("--frequency HZ", "Lines, turns or cycles a second.", positive),
    Option("--lines N", "Of a raster.", whole(1)),
    Option("--pixels N", "Of a line: each gets a whole number of rows.", whole(1)),
    Option("--overscan PERCENT", "How far lines go on at their speed beyond the range.", not_negative, "0"),
    Option("--one-way", "Lines in one direction, the way back as fast; a staircase up alone."),
    Option("--turns N", "Of a spiral.", whole(1)),
    Option("--cycles N", "Of sine and triangle [default: 1].", whole(1)),
    Option("--steps N", "Of a staircase.", whole(1)),
    Option("--dwell SECONDS", "At each level of a staircase.", positive),
    Option("--rest SECONDS", "At rest before and after the move.", not_negative, "0"),
    Option("--loop", "Whole cycles without start and stop, for compensate --periodic."),
    Option("--bandwidth HZ", "Each turn, step, start and stop takes one period of it.", positive),
)
MOVE_MODEL = Option(
    "--model MODEL",
    "Round to what it can be trusted to, refuse what it cannot reach; one an axis, or one for both.",
    repeated=True,
)
UNIT = Option("--unit UNIT", "What the figures are in: um, nm, mrad [default: the model's].")
DRIVES = Option("DRIVE", "The drive; several where the file has channels.", address, REQUIRED, repeated=True)
DRIVE_COLUMNS = options.DRIVE_COLUMN._replace(
    meaning="The drive, guessed by name; several times: columns of one file, or one a file.", repeated=True
)
WAVEFORM = (  # the fields of ``WaveformOptions``
    Option("--to FORMAT", ", ".join(GENERATOR_FILES) + ".", choice(GENERATOR_FILES), REQUIRED),
    Option("--gain FACTOR", "Of the amplifier behind the generator: divided out.", number, "1"),
    Option(
        "--points N", "Of the generator: resampled to so many; with --rate the last value fills.", whole(2)
    ),
    Option("--rate HZ", "Points a second [default: the drive's].", positive),
    Option("--codes LOW:HIGH", "The lowest and the highest code [default: the format's].", span),
    Option("--volts LOW:HIGH", "What they mean at the generator [default: the drive's ends].", span),
    Option("--loop", "The drive repeats: it must close, and stays so at another rate."),
    Option("--v-min VOLT", "Lowest drive allowed.", options.figure),
    Option("--v-max VOLT", "Highest drive allowed.", options.figure),
    options.MAX_SLEW,
    Option(
        "--tolerance VOLT",
        "By how much another rate may move the drive [default: a thousandth of its range].",
        options.figure_above_0,
    ),
)


def trajectory(given: Given) -> None:
    """Write a move to be followed: raster, spiral, staircase, sine or triangle.

    It starts and stops softly, and its turns and steps are rounded to --bandwidth or to what --model can be
    trusted to; what the model does not reach is refused.
    """
    from dbo_cli.drives.shapes import TrajectoryOptions
    from dbo_cli.runs.trajectories import write_trajectory

    asked = TrajectoryOptions(given.shape, **given.of(MOVE))
    command = shlex.join(["dbo", *given.typed])
    given.reporter.notes(
        write_trajectory(
            given.output, asked, given.model or (), given.unit, given.format, given.summary, command
        )
    )


def waveform(given: Given) -> None:
    """Write a drive as the file that a generator, a wave table or a converter takes.

    What is written is read back and passes the gate that the drive passed. One line says what to set:
    points, rate, amplitude, offset, repetitions, and by how much rounding moves the drive.
    """
    from dbo_cli.runs.waveform_files import WaveformOptions, write_waveform

    asked = WaveformOptions(**given.of(WAVEFORM), voltage=tuple(given.voltage or ()))
    command = shlex.join(["dbo", *given.typed])
    given.reporter.remarks(
        write_waveform(given.drive, given.output, given.reading, asked, given.summary, command)
    )


COMMANDS["trajectory"] = Command(
    trajectory,
    (
        SHAPE,
        *options.REPORTING,
        *MOVE,
        MOVE_MODEL,
        UNIT,
        options.OUTPUT_FORMAT,
        options.SUMMARY,
        options.OUTPUT,
    ),
)
COMMANDS["waveform"] = Command(
    waveform,
    (
        DRIVES,
        *options.READING_OF_LOGS,
        *options.REPORTING,
        *WAVEFORM,
        DRIVE_COLUMNS,
        options.SUMMARY,
        options.OUTPUT,
    ),
)
