"""Every option of every command, spelled once.

All values arrive as text (see ``commands``); ``values`` checks them. A command takes from here what it needs.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer

READING = "Reading logs"
COMMON = "Output and messages"
STATE = "State"
COLUMN = "COLUMN"


def _argument(metavar: str, meaning: str) -> Any:
    """Declare a positional argument."""
    return typer.Argument(metavar=metavar, show_default=False, help=meaning)


def _option(
    name: str, metavar: str | None, meaning: str, short: str | None = None, *, panel: str | None = None
) -> Any:
    """Declare an option; without ``metavar`` it is a switch."""
    names = (name,) if short is None else (name, short)
    return typer.Option(*names, metavar=metavar, help=meaning, rich_help_panel=panel)


def _reading(name: str, metavar: str | None, meaning: str) -> Any:
    """Declare an option that says how a log is read."""
    return _option(name, metavar, meaning, panel=READING)


def _starting(name: str, metavar: str | None, meaning: str) -> Any:
    """Declare an option about the operator's state."""
    return _option(name, metavar, meaning, panel=STATE)


def _common(name: str, metavar: str | None, meaning: str, short: str | None = None) -> Any:
    """Declare an option that every command has."""
    return _option(name, metavar, meaning, short, panel=COMMON)


# --- arguments ---
Logs = Annotated[list[str], _argument("LOG", "One or more logs; FILE::/group in HDF5; - is stdin.")]
Log = Annotated[str, _argument("LOG", "The input signal; FILE::/group in HDF5; - is stdin.")]
Trajectory = Annotated[
    str,
    _argument("TRAJECTORY", "The desired displacement; FILE::/group in HDF5; - is stdin."),
]
Model = Annotated[str, _argument("MODEL", "The model file; - is stdin.")]

# --- every command ---
Output = Annotated[str, _common("--output", "FILE", "Where the result goes; - is stdout.", "-o")]
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
        "Time, as every column a header name, a dataset path, or a number counted from 1; guessed by name.",
    ),
]

# --- how a log is read ---
SampleRate = Annotated[str | None, _reading("--sample-rate", "HZ", "Rate of a log without a time column.")]
Rows = Annotated[
    str | None,
    _reading("--rows", "A:B", "Data rows to take, from 1, both ends included; either may be left out."),
]
SkipBad = Annotated[bool, _reading("--skip-bad", None, "Drop rows that hold no number, and count them.")]
Resample = Annotated[str | None, _reading("--resample", "HZ", "Interpolate to an even sampling first.")]
FileFormat = Annotated[str | None, _reading("--format", "csv|tsv|hdf5", "Where no file name tells.")]
LogFormat = Annotated[str | None, _reading("--log-format", "csv|tsv|hdf5", "Where no file name tells.")]
Delimiter = Annotated[
    str | None,
    _reading("--delimiter", "NAME", "comma, semicolon, tab, blanks, pipe or a character, if guessed wrong."),
]
Decimal = Annotated[str | None, _reading("--decimal", "point|comma", "The decimal sign, if guessed wrong.")]
Comment = Annotated[
    str | None, _reading("--comment", "CHARS", "What comment lines start with, if not # or %.")
]
HeaderLines = Annotated[
    str | None, _reading("--header-lines", "0|1|2", "None, names, or names and units, if guessed wrong.")
]
SkipLines = Annotated[str | None, _reading("--skip-lines", "N", "Lines to pass over before the header.")]
Encoding = Annotated[str | None, _reading("--encoding", "NAME", "The text encoding, if not UTF-8.")]
BlockRows = Annotated[
    str | None, _reading("--block-rows", "N", "Rows held at a time; changes no digit of a result.")
]

# --- identify ---
Gears = Annotated[str, _option("--gears", "N|auto", "Gears of the backlash operator.")]
Points = Annotated[
    str,
    _option("--points", "M|auto|0", "Segments of the point operator that makes the loop uneven."),
]
RelaxationTimes = Annotated[
    str,
    _option("--relaxation", "auto|0|T1,T2,...", "Time constants in s of lag and creep; 0 for none."),
]
DelaySeconds = Annotated[
    str,
    _option("--delay", "SECONDS|auto|0", "Pure delay of the displacement behind the drive."),
]
Skip = Annotated[str, _option("--skip", "SECONDS", "Leave the beginning of every log out of the fit.")]
Validate = Annotated[
    list[str] | None,
    _option("--validate", "LOG", "Another log, to say how well the model predicts; repeatable."),
]
Method = Annotated[
    str,
    _option("--method", "least-squares|paper", "paper: gears by the rule of the 2018 publication."),
]
Zero = Annotated[
    str,
    _option(
        "--zero",
        "none|mean|first|VALUE",
        "What displacement counts as 0: as logged, its mean, its first sample, or a value.",
    ),
]
Slopes = Annotated[str, _option("--slopes", "auto|growing|falling|free", "How the gears' slopes may run.")]
Force = Annotated[bool, _option("--force", None, "Keep a model that is no better than a straight line.")]

RatedMin = Annotated[
    str | None,
    _option("--v-min", "VOLT", "The rating's lower end, with --v-max; logs of another range are warned of."),
]
RatedMax = Annotated[str | None, _option("--v-max", "VOLT", "The rating's upper end, with --v-min.")]

# --- simulate, compensate ---
State = Annotated[
    str,
    _starting(
        "--state",
        "auto|empty|full|settled|FILE",
        "Where the operator starts; auto: empty from the lower end, else settled.",
    ),
]
SaveState = Annotated[str | None, _starting("--save-state", "FILE", "Write the state after the last row.")]
Outside = Annotated[
    str,
    _option("--outside", "extend|hold|error", "What happens outside the model's input range."),
]
VoltageMin = Annotated[str | None, _option("--v-min", "VOLT", "Lowest drive voltage [default: the model's].")]
VoltageMax = Annotated[
    str | None,
    _option("--v-max", "VOLT", "Highest drive voltage [default: the model's]."),
]
OnLimit = Annotated[
    str,
    _option("--on-limit", "clip|error", "clip and count, or exit 3, where a limit is met."),
]
MaxSlew = Annotated[str | None, _option("--max-slew", "VOLT/S", "Fastest change of the drive.")]
Condition = Annotated[
    bool,
    _option(
        "--condition",
        None,
        "Prepend the sweep that puts the actuator into the starting state (time < 0).",
    ),
]

# --- report ---
Lag = Annotated[str, _option("--lag", "N|auto", "Samples by which measured is taken later than desired.")]
RemoveOffset = Annotated[
    bool,
    _option("--remove-offset", None, "Take the mean of the error off before anything else."),
]
ReportModel = Annotated[
    str | None,
    _option("--model", "MODEL", "Compare this model's prediction with the measurement."),
]
Figures = Annotated[
    str | None,
    _option("--figures", "DIR", "Draw the figures, PNG and SVG, into this folder."),
]
MaxRmse = Annotated[
    str | None,
    _option("--max-rmse", "VALUE", "Exit 3 where the RMSE of a log is above this."),
]
MaxAbs = Annotated[str | None, _option("--max-abs", "VALUE", "Exit 3 where the largest error is above this.")]
MaxNrmse = Annotated[
    str | None,
    _option("--max-nrmse-percent", "VALUE", "Exit 3 where the RMSE in % of range is above this."),
]
Segment = Annotated[
    str | None,
    _option("--segment", "cycles|SECONDS", "Also report every cycle, or every so many seconds."),
]
ReportFormat = Annotated[
    str | None,
    _option("--format", "text|json|csv|html", "Form of the report [default: by the output's name]."),
]

# --- excite ---
ExciteMin = Annotated[str, _option("--v-min", "VOLT", "Lowest drive voltage.")]
ExciteMax = Annotated[str, _option("--v-max", "VOLT", "Highest drive voltage: the actuator's rating.")]
ExciteRate = Annotated[str, _option("--sample-rate", "HZ", "Rows per second.")]
Duration = Annotated[str, _option("--duration", "SECONDS", "Length of the drive.")]
Frequency = Annotated[str, _option("--frequency", "HZ", "Full cycles per second.")]
OutputFormat = Annotated[
    str | None, _common("--format", "csv|tsv|hdf5", "Form of the output where no file name tells.")
]
