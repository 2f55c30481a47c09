"""Every option of every command, spelled once: its name, its value, its meaning, how its text is parsed.

A command takes from here what it needs, as keyword parameters; ``typer_adapter`` hands it parsed values.
"""

from __future__ import annotations

import inspect
from typing import Annotated, Any, Literal

import typer

from dbo_cli.cli import values

READING = "Reading logs"
COMMON = "Output and messages"
STATE = "State"
COLUMN = "COLUMN"
REQUIRED = inspect.Parameter.empty  # the default of an option that must be given
FORMATS = ("csv", "tsv", "hdf5")

Beyond = Literal["extend", "hold", "error"]


def _argument(metavar: str, meaning: str) -> Any:
    """Declare a positional argument."""
    return typer.Argument(metavar=metavar, show_default=False, help=meaning)


def _option(
    name: str,
    metavar: str | None,
    meaning: str,
    short: str | None = None,
    *,
    panel: str | None = None,
    default: Any = None,
    parse: values.Parser | None = None,
) -> Any:
    """Declare an option; without ``metavar`` it is a switch. ``default`` is what a user would have typed."""
    names = (name,) if short is None else (name, short)
    option = typer.Option(*names, metavar=metavar, help=meaning, rich_help_panel=panel)
    option.__dict__.update(parse=parse, typed_default=default)
    return option


def _reading(name: str, metavar: str | None, meaning: str, parse: values.Parser | None = None) -> Any:
    """Declare an option that says how a log is read."""
    return _option(name, metavar, meaning, panel=READING, parse=parse)


def _starting(name: str, metavar: str | None, meaning: str, default: str | None = None) -> Any:
    """Declare an option about the operator's state."""
    return _option(name, metavar, meaning, panel=STATE, default=default)


def _common(
    name: str,
    metavar: str | None,
    meaning: str,
    short: str | None = None,
    default: str | None = None,
    parse: values.Parser | None = None,
) -> Any:
    """Declare an option that every command has."""
    return _option(name, metavar, meaning, short, panel=COMMON, default=default, parse=parse)


# --- arguments ---
Logs = Annotated[list[str], _argument("LOG", "One or more logs; FILE::/group in HDF5; - is stdin.")]
Log = Annotated[str, _argument("LOG", "The input signal; FILE::/group in HDF5; - is stdin.")]
Trajectory = Annotated[
    str,
    _argument("TRAJECTORY", "The desired displacement; FILE::/group in HDF5; - is stdin."),
]
Model = Annotated[str, _argument("MODEL", "The model file; - is stdin.")]

# --- every command ---
Output = Annotated[str, _common("--output", "FILE", "Where the result goes; - is stdout.", "-o", default="-")]
Quiet = Annotated[bool, _common("--quiet", None, "Say nothing but errors.", "-q")]
Verbose = Annotated[bool, _common("--verbose", None, "Also say what was detected and assumed.")]
Debug = Annotated[bool, _common("--debug", None, "Show the traceback of an error.")]
Flush = Annotated[bool, _common("--flush", None, "Write each row as soon as it is there (live streams).")]

# --- columns: a header name, a dataset path, or a number counted from 1 ---
Voltage = Annotated[str | None, _reading("--voltage", COLUMN, "The drive voltage; guessed by name.")]
ReportVoltage = Annotated[
    str | None,
    _reading("--voltage", COLUMN, "The drive voltage, for --model and the figures; guessed by name."),
]
Displacement = Annotated[str | None, _reading("--displacement", COLUMN, "Displacement; guessed by name.")]
Input = Annotated[str | None, _reading("--input", COLUMN, "The model's input; guessed by name.")]
Desired = Annotated[str | None, _reading("--desired", COLUMN, "What was wanted; guessed by name.")]
Measured = Annotated[str | None, _reading("--measured", COLUMN, "What came out; guessed by name.")]
Time = Annotated[
    str | None,
    _reading(
        "--time",
        COLUMN,
        "Time. Every column: a header name, a dataset path, a number from 1, or FILE::COLUMN; else guessed.",
    ),
]

# --- how a log is read ---
SampleRate = Annotated[
    float | None,
    _reading("--sample-rate", "HZ", "Rate of a log without a time column.", parse=values.positive),
]
Rows = Annotated[
    tuple[int, int | None] | None,
    _reading(
        "--rows",
        "A:B",
        "Data rows to take, from 1, both ends included; either may be left out.",
        parse=values.rows,
    ),
]
TimeUnit = Annotated[
    str | None,
    _reading("--time-unit", "UNIT", "What time counts: s, ms, us, ns, min, h, d, 10us; before the header."),
]
Scale = Annotated[
    list[str] | None,
    _reading("--scale", "ROLE=FACTOR", "Multiply: voltage=20, or displacement=10um/V; repeatable."),
]
SkipBad = Annotated[bool, _reading("--skip-bad", None, "Drop rows that hold no number, and count them.")]
Resample = Annotated[
    float | None,
    _reading("--resample", "HZ", "Interpolate to an even sampling first.", parse=values.positive),
]
FileFormat = Annotated[
    str | None,
    _reading("--format", "csv|tsv|hdf5", "Where no file name tells.", parse=values.choice(FORMATS)),
]
LogFormat = Annotated[
    str | None,
    _reading("--log-format", "csv|tsv|hdf5", "Where no file name tells.", parse=values.choice(FORMATS)),
]
Delimiter = Annotated[
    str | None,
    _reading("--delimiter", "NAME", "comma, semicolon, tab, blanks, pipe or a character, if guessed wrong."),
]
Decimal = Annotated[str | None, _reading("--decimal", "point|comma", "The decimal sign, if guessed wrong.")]
Comment = Annotated[
    str | None, _reading("--comment", "CHARS", "What comment lines start with, if not # or %.")
]
HeaderLines = Annotated[
    int | None,
    _reading(
        "--header-lines",
        "0|1|2",
        "None, names, or names and units, if guessed wrong.",
        parse=values.header_lines,
    ),
]
SkipLines = Annotated[
    int | None, _reading("--skip-lines", "N", "Lines to pass over before the header.", parse=values.whole(0))
]
Encoding = Annotated[str | None, _reading("--encoding", "NAME", "The text encoding, if not UTF-8.")]
BlockRows = Annotated[
    int | None,
    _reading(
        "--block-rows", "N", "Rows held at a time; changes no digit of a result.", parse=values.whole(1)
    ),
]

# --- identify ---
Gears = Annotated[
    int | None,
    _option(
        "--gears",
        "N|auto",
        "Gears: steps into which the loop is cut; more are finer and cost nothing.",
        default="auto",
        parse=values.auto_or(values.whole(1)),
    ),
]
Points = Annotated[
    int | None,
    _option(
        "--points",
        "M|auto|0",
        "Segments of the asymmetry: straight pieces that make the loop's ends unlike; 0 for none.",
        default="auto",
        parse=values.auto_or(values.whole(0)),
    ),
]
RelaxationTimes = Annotated[
    tuple[float, ...] | None,
    _option(
        "--relaxation",
        "auto|0|T1,T2,...",
        "Time constants in s of lag and creep; 0 for none.",
        default="auto",
        parse=values.auto_or(values.times),
    ),
]
DelaySeconds = Annotated[
    float | None,
    _option(
        "--delay",
        "SECONDS|auto|0",
        "Pure delay of the displacement behind the drive.",
        default="auto",
        parse=values.auto_or(values.not_negative),
    ),
]
SensorDelay = Annotated[
    float,
    _option(
        "--sensor-delay",
        "SECONDS",
        "Pure delay of the sensor: taken off the logs before the fit, kept in the model, not compensated.",
        default="0",
        parse=values.not_negative,
    ),
]
SensorLag = Annotated[
    float,
    _option(
        "--sensor-lag",
        "SECONDS",
        "First-order time constant of the sensor or its filter: taken off likewise.",
        default="0",
        parse=values.not_negative,
    ),
]
Dynamics = Annotated[
    int | None,
    _option(
        "--dynamics",
        "auto|0|1|2",
        "Resonances of the actuator, from a log with a small sweep or a fast log beside a slow one.",
        default="auto",
        parse=values.auto_or(values.whole(0)),
    ),
]
Skip = Annotated[
    float,
    _option(
        "--skip",
        "SECONDS",
        "Leave the beginning of every log out of the fit.",
        default="0",
        parse=values.not_negative,
    ),
]
Validate = Annotated[
    list[str] | None,
    _option("--validate", "LOG", "Another log, to say how well the model predicts; repeatable."),
]
Method = Annotated[
    str,
    _option(
        "--method",
        "least-squares|paper",
        "paper: gears by the rule of the 2018 publication.",
        default="least-squares",
        parse=values.choice(("least-squares", "paper")),
    ),
]
Zero = Annotated[
    str | float,
    _option(
        "--zero",
        "none|mean|first|VALUE",
        "What displacement counts as 0: as logged, its mean, its first sample, or a value.",
        default="none",
        parse=values.zero,
    ),
]
Slopes = Annotated[
    str | None,
    _option(
        "--slopes",
        "auto|growing|falling|free",
        "How the gears' slopes may run.",
        default="auto",
        parse=values.auto_or_choice(("growing", "falling", "free")),
    ),
]
Force = Annotated[bool, _option("--force", None, "Keep a model that is no better than a straight line.")]

RatedMin = Annotated[
    float | None,
    _option(
        "--v-min",
        "VOLT",
        "The rating's lower end, with --v-max; logs of another range are warned of.",
        parse=values.number,
    ),
]
RatedMax = Annotated[
    float | None, _option("--v-max", "VOLT", "The rating's upper end, with --v-min.", parse=values.number)
]

# --- simulate, compensate ---
State = Annotated[
    str,
    _starting(
        "--state",
        "auto|empty|full|settled|FILE",
        "What was before the first sample: empty (it came from the lower end), full, settled (a swing died "
        "away there), auto (empty at the lower end, else settled; for a log that the model was identified "
        "from, as the fit found it), or a saved state.",
        default="auto",
    ),
]
SaveState = Annotated[str | None, _starting("--save-state", "FILE", "Write the state after the last row.")]
Outside = Annotated[
    Beyond,
    _option(
        "--outside",
        "extend|hold|error",
        "What happens outside the model's input range.",
        default="extend",
        parse=values.choice(("extend", "hold", "error")),
    ),
]
VoltageMin = Annotated[
    float | None,
    _option("--v-min", "VOLT", "Lowest drive voltage [default: the model's].", parse=values.number),
]
VoltageMax = Annotated[
    float | None,
    _option("--v-max", "VOLT", "Highest drive voltage [default: the model's].", parse=values.number),
]
OnLimit = Annotated[
    str,
    _option(
        "--on-limit",
        "clip|error",
        "clip and count, or exit 3, where a limit is met.",
        default="clip",
        parse=values.choice(("clip", "error")),
    ),
]
MaxSlew = Annotated[
    float | None, _option("--max-slew", "VOLT/S", "Fastest change of the drive.", parse=values.positive)
]
MaxCurrent = Annotated[
    float | None,
    _option(
        "--max-current",
        "AMPERE",
        "What the amplifier can deliver, with --capacitance: a slew limit of their ratio.",
        parse=values.positive,
    ),
]
Capacitance = Annotated[
    float | None,
    _option("--capacitance", "FARAD", "Of the actuator, with --max-current.", parse=values.positive),
]
From = Annotated[
    float | None,
    _option(
        "--from", "VOLT", "What the amplifier stands at before the first row.", parse=values.number
    ),
]
Approach = Annotated[
    float | Literal["auto"] | None,
    _option(
        "--approach",
        "SECONDS|auto",
        "Ramp from there to the first row (time < 0); auto: as fast as the slew allows.",
        parse=values.seconds_or_auto,
    ),
]
Lead = Annotated[
    float | Literal["auto"] | None,
    _option(
        "--lead",
        "SECONDS|auto",
        "The drive that dynamics and delay need before a move that begins in motion (time < 0).",
        parse=values.seconds_or_auto,
    ),
]
Return = Annotated[
    float | Literal["auto"] | None,
    _option(
        "--return",
        "SECONDS|auto",
        "Ramp back at the end, to where the drive came from, else to 0; its rows have no desired value.",
        parse=values.seconds_or_auto,
    ),
]
Summary = Annotated[
    str | None, _common("--summary", "FILE", "Also write what was done as JSON (dbo-summary).")
]
Drive = Annotated[str, _argument("DRIVE", "The drive to be checked; FILE::/group in HDF5; - is stdin.")]
DriveColumn = Annotated[str | None, _reading("--voltage", COLUMN, "The drive; guessed by name.")]
CheckMin = Annotated[
    float | None, _option("--v-min", "VOLT", "Lowest voltage allowed.", parse=values.number)
]
CheckMax = Annotated[
    float | None, _option("--v-max", "VOLT", "Highest voltage allowed.", parse=values.number)
]
Loop = Annotated[bool, _option("--loop", None, "The drive is looped: from its last row to its first, too.")]
Against = Annotated[
    str | None, _option("--against", "FILE", "Was this drive what was played? Rows, lag, gain, offset.")
]
Tolerance = Annotated[
    float | None,
    _option(
        "--tolerance",
        "VOLT",
        "With --against, the largest difference allowed [default: a thousandth of the range].",
        parse=values.positive,
    ),
]
Condition = Annotated[
    bool,
    _option(
        "--condition",
        None,
        "Prepend the sweep that puts the actuator into the starting state (time < 0).",
    ),
]

Bandwidth = Annotated[
    float | None,
    _option(
        "--bandwidth",
        "HZ",
        "Round the trajectory's corners with a zero-phase low-pass first; with --tracked, learn so far up.",
        parse=values.positive,
    ),
]
TrackedLogs = Annotated[
    list[str] | None,
    _option(
        "--tracked",
        "LOG",
        "The last pass of this trajectory, recorded: write the next, better drive; repeatable.",
    ),
]
Absolute = Annotated[
    bool,
    _option(
        "--absolute",
        None,
        "With --tracked, learn the mean of the error, too (else it is taken for the sensor's zero).",
    ),
]
History = Annotated[
    str | None,
    _option(
        "--history",
        "FILE",
        "With --tracked, keep the error of each pass there (JSON), so that growth is seen.",
    ),
]
Settle = Annotated[
    float | None,
    _option(
        "--settle",
        "DISTANCE",
        "Say how long after a step over the move creep and ringing stay within it (the model's unit).",
        parse=values.positive,
    ),
]
Periodic = Annotated[
    bool,
    _option("--periodic", None, "The trajectory is one period of a loop: write the settled loop's drive."),
]
Passes = Annotated[
    int,
    _option(
        "--passes",
        "N",
        "With --periodic, passes of run-in before it (time < 0).",
        "-n",
        default="0",
        parse=values.whole(0),
    ),
]
TrackedVoltage = Annotated[
    str | None, _reading("--voltage", COLUMN, "The drive in a --tracked log; guessed by name.")
]
TrackedMeasured = Annotated[
    str | None, _reading("--measured", COLUMN, "What was measured in a --tracked log; guessed by name.")
]

# --- report ---
Lag = Annotated[
    int | Literal["auto"],
    _option(
        "--lag",
        "N|auto",
        "Samples by which measured is taken later than desired.",
        default="0",
        parse=values.lag,
    ),
]
RemoveOffset = Annotated[
    bool,
    _option("--remove-offset", None, "Take the mean of the error off before anything else."),
]
ReportModel = Annotated[
    str | None,
    _option("--model", "MODEL", "Compare this model's prediction with the measurement."),
]
ReportTrajectory = Annotated[
    str | None,
    _option("--trajectory", "FILE", "Where the desired signal lies, if not in the logs themselves."),
]
Match = Annotated[
    Literal["auto", "time", "rows"],
    _option(
        "--match",
        "auto|time|rows",
        "How logs and --trajectory belong together; auto: by time where both have one.",
        default="auto",
        parse=values.choice(("auto", "time", "rows")),
    ),
]
CountSweep = Annotated[
    bool,
    _option(
        "--count-sweep",
        None,
        "Let a conditioning sweep (rows before time 0) take part; so do --rows that cover it.",
    ),
]
Figures = Annotated[
    str | None,
    _option("--figures", "DIR", "Draw the figures, PNG and SVG, into this folder."),
]
MaxRmse = Annotated[
    float | None,
    _option(
        "--max-rmse", "VALUE", "Exit 3 where the RMSE of a log is above this.", parse=values.not_negative
    ),
]
MaxAbs = Annotated[
    float | None,
    _option("--max-abs", "VALUE", "Exit 3 where the largest error is above this.", parse=values.not_negative),
]
MaxNrmse = Annotated[
    float | None,
    _option(
        "--max-nrmse-percent",
        "VALUE",
        "Exit 3 where the RMSE in % of range is above this.",
        parse=values.not_negative,
    ),
]
Segment = Annotated[
    float | Literal["cycles"] | None,
    _option(
        "--segment",
        "cycles|SECONDS",
        "Also report every cycle, or every so many seconds.",
        parse=values.segment,
    ),
]
ReportFormat = Annotated[
    str | None,
    _option(
        "--format",
        "text|json|csv|html",
        "Form of the report [default: by the output's name].",
        parse=values.choice(("text", "json", "csv", "html")),
    ),
]

# --- show ---
ShowFormat = Annotated[
    str | None,
    _option(
        "--format",
        "text|json",
        "Form of what is shown [default: by the output's name, else text].",
        parse=values.choice(("text", "json")),
    ),
]
ModelFigures = Annotated[
    str | None,
    _option("--figures", "DIR", "Draw the model's curves, PNG and SVG, into this folder."),
]

# --- compare ---
ModelNames = Annotated[
    tuple[str, ...] | None,
    _option(
        "--models",
        "NAME,...",
        "Only these of dbo, line, pi, rate, singularity-free, asymmetric.",
        parse=values.names,
    ),
]
NoTimings = Annotated[bool, _option("--no-timings", None, "Measure no times: the table repeats to the byte.")]
SaveModels = Annotated[
    str | None,
    _option("--save-models", "DIR", "Also write every model that was fitted, NAME.json, into this folder."),
]

# --- excite ---
ExciteMin = Annotated[
    float, _option("--v-min", "VOLT", "Lowest drive voltage.", default="0", parse=values.number)
]
ExciteMax = Annotated[
    float,
    _option(
        "--v-max",
        "VOLT",
        "Highest drive voltage: the actuator's rating.",
        default=REQUIRED,
        parse=values.number,
    ),
]
ExciteRate = Annotated[
    float, _option("--sample-rate", "HZ", "Rows per second.", default="1000", parse=values.positive)
]
Duration = Annotated[
    float, _option("--duration", "SECONDS", "Length of the drive.", default="15", parse=values.positive)
]
Frequency = Annotated[
    float, _option("--frequency", "HZ", "Full cycles per second.", default="1", parse=values.positive)
]
Seed = Annotated[
    int,
    _option("--seed", "N", "Another number, another drive.", default="1", parse=values.whole(0)),
]
SweepTo = Annotated[
    float | None,
    _option(
        "--sweep-to",
        "HZ",
        "Append a small sweep up to this frequency, for the dynamics of the actuator.",
        parse=values.positive,
    ),
]
SweepAmplitude = Annotated[
    float | None,
    _option("--sweep-amplitude", "VOLT", "Of that sweep [default: 1 % of the range].", parse=values.positive),
]
OutputFormat = Annotated[
    str | None,
    _common(
        "--format",
        "csv|tsv|hdf5",
        "Form of the output where no file name tells.",
        parse=values.choice(FORMATS),
    ),
]

# --- export ---
Folder = Annotated[
    str, _common("--output", "DIR", "The folder to write; appears whole or not at all.", "-o", REQUIRED)
]
Name = Annotated[
    str, _option("--name", "NAME", "Begins the names of files, types, functions.", default="actuator")
]
Direction = Annotated[
    str,
    _option(
        "--direction",
        "inverse|forward",
        "Displacement to drive, or drive to displacement.",
        default="inverse",
        parse=values.choice(("inverse", "forward")),
    ),
]
Arithmetic = Annotated[
    str,
    _option(
        "--arithmetic",
        "double|float|q31",
        "double: the bits of dbo compensate; float32 or 32-bit fixed point: with a bound on the error.",
        default="double",
        parse=values.choice(("double", "float", "q31")),
    ),
]
ControllerRate = Annotated[
    float | None, _option("--sample-rate", "HZ", "Steps per second of the controller.", parse=values.positive)
]
FewerGears = Annotated[
    int | None, _option("--gears", "N", "Fewer gears; says what is lost.", parse=values.whole(1))
]
Lookup = Annotated[bool, _option("--lookup", None, "A table of all states: 12 gears at most, double.")]
Arduino = Annotated[bool, _option("--arduino", None, "Lay the files out as an Arduino library.")]
Fmu = Annotated[bool, _option("--fmu", None, "Add an FMI 2.0 co-simulation unit for this computer; double.")]
Shared = Annotated[bool, _option("--shared", None, "Add a flat C library for this computer; double.")]
Overwrite = Annotated[bool, _option("--overwrite", None, "Replace a folder that an export wrote.")]
