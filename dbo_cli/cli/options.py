"""The options: how the text of one is read, the table of all, and which command has which.

A parser takes the parameter's name and the text; its complaint names the parameter in
backticks, which the shell shows as the option.
"""

from __future__ import annotations

import glob
import inspect
import keyword
import math
import os
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from dbo_cli.errors import UsageError

if TYPE_CHECKING:
    from dbo_cli.logs.request import Address

Parser = Callable[[str, str], Any]

OPTIONS = "Options"
READING_LOGS = "Reading logs"
MESSAGES = "Output and messages"
STARTING = "State"
COLUMN = "COLUMN"
REQUIRED = inspect.Parameter.empty  # the default of an option that must be given

ASKED = "_DBO_COMPLETE"
"""The environment variable by which a shell asks for completions, as the library's scripts set it."""


# --- how the text of a value is read ---


def number(option: str, text: str) -> float:
    """Return a finite number; raise ``UsageError`` for anything else."""
    try:
        value = float(text) if len(text) < 400 else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"`{option}`: not a number: '{shown(text)}'")
    return value


def text(option: str, word: str) -> str:
    """Return the text itself."""
    return word


def positive(option: str, text: str) -> float:
    """Return a number above zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value <= 0.0:
        raise UsageError(f"`{option}`: must be above 0, not {text}")
    return value


_WITH_UNIT = re.compile(r"(.*[\d.])\s*[^\W\d][^\d]*")


def with_unit(parse: Parser) -> Parser:
    """Return a parser of figures that may have a unit (``1.2kV``): a text then, to be converted."""

    def parse_figure(option: str, text: str) -> float | str:
        match = _WITH_UNIT.fullmatch(text.strip())
        if match is None:
            value: float = parse(option, text)
            return value
        parse(option, match[1])
        return text

    return parse_figure


def not_negative(option: str, text: str) -> float:
    """Return a number of at least zero; raise ``UsageError`` for anything else."""
    value = number(option, text)
    if value < 0.0:
        raise UsageError(f"`{option}`: must not be below 0, not {text}")
    return value


def percentage(option: str, text: str) -> float:
    """Return a share in %, from a plain number, one with ``%`` or one in ``ppm``."""
    plain = text.strip()
    if plain.endswith("ppm"):
        return 1e-4 * not_negative(option, plain.removesuffix("ppm").strip())
    return not_negative(option, plain.removesuffix("%").strip())


def whole(least: int) -> Parser:
    """Return a parser of whole numbers of at least ``least``."""

    def parse(option: str, text: str) -> int:
        try:
            value = int(text) if len(text) < 400 else None
        except ValueError:
            value = None
        if value is None:
            raise UsageError(f"`{option}`: not a whole number: '{shown(text)}'")
        if value < least:
            raise UsageError(f"`{option}`: must be at least {least}, not {value}")
        return value

    return parse


def one_of(words: Sequence[str]) -> Parser:
    """Return a parser of texts that are one of some words."""

    def parse(option: str, text: str) -> str:
        if text not in words:
            # an argument has no name to be found by
            place = f"`{option}`: " if option else ""
            raise UsageError(f"{place}'{shown(text)}' is none of {', '.join(words)}")
        return text

    return parse


def auto_or(parse: Parser) -> Parser:
    """Return a parser that gives None for ``auto``, else what ``parse`` makes of the text."""
    return lambda option, text: None if text == "auto" else parse(option, text)


def times(option: str, text: str) -> tuple[float, ...]:
    """Return time constants in seconds, given as ``T1,T2,…``; ``0`` means none."""
    values = tuple(
        not_negative(option, in_seconds(option, part)) for part in text.split(",")
    )
    if values == (0.0,):
        return ()
    if 0.0 in values or len(set(values)) < len(values):
        raise UsageError(
            f"`{option}`: time constants must differ and be above 0: '{shown(text)}'"
        )
    return tuple(sorted(values))


def span(option: str, text: str) -> tuple[float, float]:
    """Return two numbers, ``LOW:HIGH``, the lower one first."""
    low, colon, high = text.partition(":")
    if not colon:
        raise UsageError(f"`{option}` {shown(text)}: give LOW:HIGH")
    ends = number(option, low), number(option, high)
    if not ends[0] < ends[1]:
        raise UsageError(f"`{option}` {shown(text)}: {low} is not below {high}")
    return ends


def address(option: str, text: str) -> Address:
    """Return a file, a group of an HDF5 file or a standard stream, taken apart once and for all."""
    from dbo_cli.logs.request import parse_address

    return parse_address(text)


def expanded(words: Sequence[str]) -> list[str]:
    """Return files with patterns (``run*.csv``) expanded, in order, where the shell did not.

    PowerShell never does. What is a file's own name, or fits no file, stays as it is.
    """
    found: list[str] = []
    for word in words:
        path, separator, inner = word.partition("::")
        if os.path.exists(path) or not any(sign in path for sign in "*?["):
            found.append(word)
            continue
        files = sorted(glob.glob(path))
        found.extend(f"{file}{separator}{inner}" for file in files)
        if not files:
            found.append(word)
    return found


def rows(option: str, text: str) -> tuple[int, int | None]:
    """Return the first and the last data row of ``A:B``."""
    from dbo_cli.logs.request import parse_rows

    return parse_rows(text)


def seconds_or_auto(option: str, text: str) -> float | str:
    """Return seconds above 0, or ``auto``."""
    return text if text == "auto" else positive(option, in_seconds(option, text))


def offset(option: str, text: str) -> float | str:
    """Return seconds of either sign, or ``auto``."""
    return text if text == "auto" else number(option, in_seconds(option, text))


_FIGURE_AND_UNIT = re.compile(
    r"\s*([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^\W\d][^\d]*|/s)\s*"
)


def in_seconds(option: str, text: str) -> str:
    """Return a time with a unit (``2.4ms``) as a figure in seconds; a figure alone as it is.

    Raises
    ------
    UsageError
        The unit is none of time.
    """
    match = _FIGURE_AND_UNIT.fullmatch(text)
    if match is None:
        return text
    from dbo_cli.logs.units import FACTORS, time_unit

    unit = time_unit(match[2].strip())
    if unit is None:
        raise UsageError(
            f"`{option}` {shown(text)}: '{match[2]}' is no unit of time (s, ms, us, ns, min, h, d)"
        )
    factor = FACTORS[unit]
    return repr(number(option, match[1]) * factor.numerator / factor.denominator)


def in_hertz(option: str, text: str) -> str:
    """Return a rate with a unit (``5kHz``) as a figure in hertz; a figure alone as it is.

    Raises
    ------
    UsageError
        The unit is none of a rate.
    """
    match = _FIGURE_AND_UNIT.fullmatch(text)
    if match is None:
        return text
    from dbo_cli.logs.clock import hertz

    factor = hertz(match[2])
    if factor is None:
        raise UsageError(
            f"`{option}` {shown(text)}: '{match[2]}' is no unit of a rate (Hz, kHz, MHz, S/s)"
        )
    return repr(number(option, match[1]) * factor)


def of_unit(parse: Parser, in_unit: Callable[[str, str], str]) -> Parser:
    """Return a parser of figures that may have a unit, which is converted."""
    return lambda option, text: parse(option, in_unit(option, text))


def names(option: str, text: str) -> tuple[str, ...]:
    """Return names that commas divide."""
    words = tuple(name.strip() for name in text.split(","))
    if not all(words):
        raise UsageError(
            f"`{option}` {shown(text)}: give names with commas between them"
        )
    return words


def header_lines(option: str, text: str) -> int:
    """Return a number of header lines: 0, 1 or 2."""
    return int(one_of(("0", "1", "2"))(option, text))


def zero(option: str, text: str) -> str | float:
    """Return what displacement counts as zero: a rule's name or a value."""
    rules = ("none", "mean", "first")
    if text in rules:
        return text
    try:
        return number(option, text)
    except UsageError:
        raise UsageError(
            f"`{option}`: '{shown(text)}' is none of {', '.join(rules)} and not a number"
        ) from None


def number_or_word(kind: Callable[[str], float]) -> Parser:
    """Return a parser that leaves a text that is no number as it is; the record that takes it refuses it."""

    def parse(option: str, text: str) -> float | str:
        try:
            value = kind(text) if len(text) < 400 else math.inf
        except ValueError:
            value = math.inf
        return value if math.isfinite(value) else shown(text)

    return parse


def shown(text: str) -> str:
    """Return a value as a message repeats it: whole, or its beginning where it is long."""
    return text if len(text) <= 60 else text[:57] + "..."


figure, figure_above_0, limit = (
    with_unit(number),
    with_unit(positive),
    with_unit(not_negative),
)
PARSERS: dict[str, Parser] = {
    "A:B": rows, "AMPERE": figure_above_0, "DRIVE": address, "FACTOR": number, "FARAD": figure_above_0,
    "FILE": address, "HZ": of_unit(positive, in_hertz), "LOG": address, "LOW:HIGH": span,
    "M|auto|0": auto_or(whole(0)),
    "N": whole(1), "N|auto": auto_or(whole(1)), "NAME,...": names, "PERCENT": not_negative,
    "PERCENT|PPM": percentage,
    "SECONDS": of_unit(not_negative, in_seconds), "SECONDS|auto": seconds_or_auto,
    "SECONDS|auto|0": auto_or(of_unit(not_negative, in_seconds)),
    "TRAJECTORY": address, "VALUE": not_negative, "VOLT": figure, "VOLT/S": figure_above_0,
    "0|1|2": header_lines, "auto|0|1|2": auto_or(whole(0)), "auto|0|T1,T2,...": auto_or(times),
    "auto|growing|falling|free": auto_or(one_of(("auto", "growing", "falling", "free"))),
    "cycles|SECONDS": number_or_word(float), "none|mean|first|VALUE": zero,
}  # fmt: skip
"""How the text of an option is read, by what its value is called."""


# --- what an option is ---


class Option(NamedTuple):
    """An option or, without dashes, an argument.

    Attributes
    ----------
    spelled : str
        Its names and what its value is called, ``-o, --output FILE``; a switch has no
        value.
    meaning : str
        What ``--help`` says of it.
    default : optional
        What a user would have typed; None for no value, ``REQUIRED`` for an option that
        must be given (an argument always must).
    parse : callable, optional
        Makes the value of the text, where what the value is called does not tell how it
        is read.
    heading : str
        Where ``--help`` lists it.
    repeated : bool
        May be given several times; the value is a list.
    choices : sequence of str
        The words that its value may be, where ``spelled`` does not list them.
    """

    spelled: str
    meaning: str
    default: Any = None
    parse: Parser | None = None
    heading: str = OPTIONS
    repeated: bool = False
    choices: Sequence[str] = ()

    @property
    def names(self) -> list[str]:
        """The names, the long one last; none of an argument."""
        return [
            word.rstrip(",") for word in self.spelled.split() if word.startswith("-")
        ]

    @property
    def metavar(self) -> str | None:
        """What the value is called; None of a switch."""
        last = self.spelled.split()[-1]
        return None if last.startswith("-") else last

    @property
    def words(self) -> Sequence[str]:
        """The words that its value may be; none where it is of another kind."""
        listed = self.metavar or ""
        if "|" in listed:
            return listed.split("|")
        return self.choices

    @property
    def parser(self) -> Parser | None:
        """What makes the value of the text: by what it is called, or one of its words; else none."""
        listed = self.metavar or ""
        if self.parse is not None:
            return self.parse
        if listed in PARSERS:
            return PARSERS[listed]
        if self.words and (listed.islower() or self.choices):
            return one_of(self.words)
        return None

    @property
    def key(self) -> str:
        """The name of the value in Python."""
        key = (self.names or [self.spelled.lower()])[-1].lstrip("-").replace("-", "_")
        return key + "_" if keyword.iskeyword(key) else key

    def value(self, typed: Any) -> Any:
        """Return what the parser makes of a text, or of each of several; None of None."""
        parse = self.parser
        name = self.key if self.names else ""  # an argument has none
        if parse is None or typed is None:
            return typed
        if not self.repeated:
            return parse(name, typed)
        words = expanded(typed) if parse is address else typed
        return [parse(name, word) for word in words]


def _reading(
    spelled: str, meaning: str, parse: Parser | None = None, repeated: bool = False
) -> Option:
    return Option(spelled, meaning, None, parse, READING_LOGS, repeated)


def _message(spelled: str, meaning: str, default: Any = None) -> Option:
    return Option(spelled, meaning, default, heading=MESSAGES)


# --- arguments ---
LOGS = Option(
    "LOG", "One or more logs; FILE::/group in HDF5; - is stdin.", repeated=True
)
INPUTS = Option(
    "LOG",
    "The input signal; FILE::/group in HDF5; - is stdin. Several: -o 'out/{file}.csv'.",
    repeated=True,
)
TRAJECTORIES = Option(
    "TRAJECTORY",
    "The desired displacement; FILE::/group in HDF5; - is stdin. Several: -o 'out/{file}.csv'.",
    repeated=True,
)
MODEL = Option("MODEL", "The model file; - is stdin.")
DRIVE = Option("DRIVE", "The drive to be checked; FILE::/group in HDF5; - is stdin.")

# --- output and messages ---
OUTPUT = _message("-o, --output FILE", "Where the result goes; - is stdout.", "-")
FOLDER = _message(
    "-o, --output DIR", "The folder to write; appears whole or not at all.", REQUIRED
)
FLUSH = _message("--flush", "Write each row as soon as it is there (live streams).")
HEADER = _message(
    "--header plain|comment",
    "comment: text begins with a # line: program, model, command.",
    "plain",
)
SUMMARY = _message("--summary FILE", "Also write what was done as JSON (dbo-summary).")
OUTPUT_FORMAT = _message(
    "--format csv|tsv|hdf5", "Form of the output where no file name tells."
)
REPORTING = (
    _message("-q, --quiet", "Say nothing but errors."),
    _message("--verbose", "Also say what was detected and assumed."),
    _message("--debug", "Show the traceback of an error."),
)

# --- columns: a header name, a dataset path, or a number counted from 1 ---
VOLTAGE = _reading("--voltage COLUMN", "The drive voltage; guessed by name.")
DRIVE_COLUMN = _reading("--voltage COLUMN", "The drive; guessed by name.")
DISPLACEMENT = _reading("--displacement COLUMN", "Displacement; guessed by name.")
INPUT = _reading("--input COLUMN", "The model's input; guessed by name.")
REPORT_COLUMNS = (
    _reading("--desired COLUMN", "What was wanted; guessed by name."),
    _reading("--measured COLUMN", "What came out; guessed by name."),
    _reading(
        "--voltage COLUMN",
        "The drive voltage, for --model and the figures; guessed by name.",
    ),
)

# --- how a log is read: the fields of ``ReadingOptions`` ---
FILE_FORMAT = _reading("--format csv|tsv|hdf5", "Where no file name tells.")
LOG_FORMAT = FILE_FORMAT._replace(spelled="--log-format csv|tsv|hdf5")
READING = (
    _reading(
        "--time COLUMN",
        "Time. Every column: a header name, a dataset path, a number from 1, or FILE::COLUMN; else guessed.",
    ),
    _reading(
        "--time-unit UNIT",
        "What time counts: s, ms, us, ns, min, h, d, 10us; before the header.",
    ),
    _reading("--sample-rate HZ", "Rate of a log without a time column."),
    _reading(
        "--clock-offset SECONDS|auto",
        "Of two recorders: added to the clock of the drive's file; auto finds it.",
        parse=offset,
    ),
    _reading(
        "--scale ROLE=FACTOR",
        "Multiply: voltage=20, or displacement=10um/V; repeatable.",
        repeated=True,
    ),
    _reading(
        "--rows A:B",
        "Data rows to take, from 1, both ends included; either may be left out.",
    ),
    _reading("--skip-bad", "Drop rows that hold no number, and count them."),
    _reading("--resample HZ", "Interpolate to an even sampling first."),
    FILE_FORMAT,
    _reading(
        "--delimiter NAME",
        "comma, semicolon, tab, blanks, pipe or a character, if guessed wrong.",
    ),
    _reading(
        "--decimal point|comma", "The decimal sign, if guessed wrong.", parse=text
    ),
    _reading("--comment CHARS", "What comment lines start with, if not # or %."),
    _reading(
        "--header-lines 0|1|2", "None, names, or names and units, if guessed wrong."
    ),
    _reading("--skip-lines N", "Lines to pass over before the header.", parse=whole(0)),
    _reading("--encoding NAME", "The text encoding, if not UTF-8."),
    _reading("--block-rows N", "Rows held at a time; changes no digit of a result."),
)
READING_OF_LOGS = tuple(
    LOG_FORMAT if option is FILE_FORMAT else option for option in READING
)

# --- identify: mostly the fields of ``IdentificationOptions`` ---
UNCERTAINTY = Option(
    "--uncertainty COLUMN",
    "Standard deviation of the displacement, row by row: weights of the fit.",
)
SCALE_UNCERTAINTY = Option(
    "--scale-uncertainty PERCENT|PPM",
    "Of the displacement's scale, common to all rows (wavelength, calibration): stated with the gain; 5ppm.",
    "0",
)
IDENTIFICATION = (
    Option(
        "--gears N|auto",
        "Gears: steps into which the loop is cut; more are finer and cost nothing.",
        "auto",
    ),
    Option(
        "--points M|auto|0",
        "Segments of the asymmetry: straight pieces that make the loop's ends unlike; 0 for none.",
        "auto",
    ),
    Option(
        "--relaxation auto|0|T1,T2,...",
        "Time constants in s of lag and creep; 0 for none.",
        "auto",
    ),
    Option(
        "--delay SECONDS|auto|0",
        "Pure delay of the displacement behind the drive.",
        "auto",
    ),
    Option(
        "--dynamics auto|0|1|2",
        "Resonances of the actuator, from a log with a small sweep or a fast log beside a slow one.",
        "auto",
    ),
    Option(
        "--sensor-delay SECONDS",
        "Pure delay of the sensor: taken off the logs before the fit, kept in the model, not compensated.",
        "0",
    ),
    Option(
        "--sensor-lag SECONDS",
        "First-order time constant of the sensor or its filter: taken off likewise.",
        "0",
    ),
    Option(
        "--slopes auto|growing|falling|free", "How the gears' slopes may run.", "auto"
    ),
    SCALE_UNCERTAINTY,
)
SIGN = Option(
    "--sign rising|falling",
    "Whether displacement rises or falls as voltage rises: exit 3 where the log shows the other.",
)
SKIP = Option("--skip SECONDS", "Leave the beginning of every log out of the fit.", "0")
ZERO = Option(
    "--zero none|mean|first|VALUE",
    "What displacement counts as 0: as logged, its mean, its first sample, or a value.",
    "none",
)
METHOD = Option(
    "--method least-squares|paper",
    "paper: gears by the rule of the 2018 publication.",
    "least-squares",
)
VALIDATE = Option(
    "--validate LOG",
    "Another log, to say how well the model predicts; repeatable.",
    repeated=True,
)
PRIOR = Option(
    "--prior MODEL",
    "Keep the shape of this model, and find its gain, offset and lag again from a short log.",
)
# of the fields of ``IdentifyRun``
FITTED = (VOLTAGE, DISPLACEMENT, UNCERTAINTY, PRIOR, SUMMARY)
RATED_MIN = Option(
    "--v-min VOLT",
    "The rating's lower end, with --v-max; logs of another range are warned of.",
)
RATED_MAX = Option("--v-max VOLT", "The rating's upper end, with --v-min.")
FORCE = Option("--force", "Keep a model that is no better than a straight line.")
FIXED = (SIGN, ZERO, METHOD, FORCE)

# --- simulate, compensate, check ---
STATE = Option(
    "--state auto|empty|full|settled|FILE",
    "What was before the first sample: empty (it came from the lower end), full, settled (a swing died "
    "away there), auto (empty at the lower end, else settled; for a log that the model was identified "
    "from, as the fit found it), or a saved state.",
    "auto",
    heading=STARTING,
)
SAVE_STATE = Option(
    "--save-state FILE", "Write the state after the last row.", heading=STARTING
)
OUTSIDE = Option(
    "--outside extend|hold|error",
    "What happens outside the model's input range.",
    "extend",
)
VOLTAGE_MIN = Option(
    "--v-min VOLT", "Lowest drive voltage; cuts the range that was identified."
)
VOLTAGE_MAX = Option(
    "--v-max VOLT", "Highest drive voltage; cuts the range that was identified."
)
EXTRAPOLATE = Option(
    "--extrapolate",
    "Go beyond the identified range, as far as --v-min and --v-max say.",
)
MAX_SLEW = Option("--max-slew VOLT/S", "Fastest change of the drive; 2V/ms as well.")
FROM = Option("--from VOLT", "What the amplifier stands at before the first row.")
# the fields of ``DriveOptions`` but for the state, which is read with the model
DRIVING = (
    VOLTAGE_MIN,
    VOLTAGE_MAX,
    EXTRAPOLATE,
    MAX_SLEW,
    Option(
        "--max-current AMPERE",
        "What the amplifier can deliver, with --capacitance: a slew limit of their ratio.",
    ),
    Option("--capacitance FARAD", "Of the actuator, with --max-current."),
    Option(
        "--on-limit auto|clip|error",
        "Where a limit is met: auto cuts off what costs up to 1 % of the move (RMS), and exits 3 for more; "
        "clip cuts off whatever it costs; error exits 3 at once.",
        "auto",
    ),
    FROM,
    Option(
        "--approach SECONDS|auto",
        "Ramp from there to the first row (time < 0); auto: within the slew limit, 0.1 s at least.",
    ),
    Option(
        "--condition",
        "Prepend the sweep that puts the actuator into the starting state (time < 0).",
    ),
    Option(
        "--lead SECONDS|auto",
        "The drive that dynamics and delay need before a move that begins in motion (time < 0); with "
        "--periodic a rest that brings the creep where the loop needs it.",
    ),
    Option(
        "--return SECONDS|auto",
        "Ramp back at the end, to where the drive came from, else to 0, within the limits; its rows have no "
        "desired value.",
    ),
    Option(
        "--bandwidth HZ",
        "Round the trajectory's corners with a zero-phase low-pass first; with --tracked, learn so far up.",
    ),
)
CHECKING = (  # the fields of ``CheckOptions``, but for ``voltage``, which is DRIVE_COLUMN
    Option("--v-min VOLT", "Lowest voltage allowed."),
    Option("--v-max VOLT", "Highest voltage allowed."),
    MAX_SLEW,
    FROM,
    Option("--loop", "The drive is looped: from its last row to its first, too."),
    Option(
        "--against FILE",
        "Was this drive what was played? Rows, lag, gain, offset, speed.",
    ),
    Option(
        "--gain FACTOR",
        "With --against, of an amplifier behind the recording's place.",
        "1",
    ),
    Option(
        "--tolerance VOLT",
        "With --against, the largest difference allowed, and by how much a recorded row may miss a "
        "limit [default: a thousandth of the range, or six times the recording's noise].",
        parse=figure_above_0,
    ),
)

# --- channels and many files: the fields of ``Work`` ---
WORK = (
    Option(
        "-j, --jobs N", "Processes, for channels or many files; changes no result.", "1"
    ),
    Option("--keep-going", "Where a channel or file fails, write the others; exit 1."),
)

# --- report, show ---
TRACKING = (  # with the columns, the fields of ``TrackingOptions``
    Option(
        "--lag N|auto",
        "Samples by which measured is taken later than desired.",
        "0",
        parse=number_or_word(int),
    ),
    Option("--remove-offset", "Take the mean of the error off before anything else."),
    Option(
        "--segment cycles|SECONDS", "Also report every cycle, or every so many seconds."
    ),
    Option(
        "--dwell SECONDS",
        "Score only the rows at which the desired signal has been held so long: pixels, stairs.",
    ),
    Option("--model MODEL", "Compare this model's prediction with the measurement."),
    Option(
        "--state auto|empty|full|settled|FILE",
        "With --model, what was before the first row: empty (it came from the lower end), full, settled, "
        "auto (empty at the lower end, else settled; for a log that the model was identified from, as the "
        "fit found it), or a saved state.",
        "auto",
    ),
    Option(
        "--expected FILE",
        "What error was to be expected, to stand beside the actual one: the --summary of compensate, or the "
        "model.",
    ),
    Option(
        "--trajectory FILE",
        "Where the desired signal lies, if not in the logs themselves.",
    ),
    Option(
        "--match auto|time|rows",
        "How logs and --trajectory belong together; auto: by time where both have one.",
        "auto",
    ),
    Option(
        "--count-sweep",
        "Let a conditioning sweep (rows before time 0) take part; so do --rows that cover it.",
    ),
)
LIMITS = (
    Option(
        "--max-rmse VALUE",
        "Exit 3 where the RMSE of a log is above this; 10nm as well.",
        parse=limit,
    ),
    Option(
        "--max-abs VALUE",
        "Exit 3 where the largest error is above this; 10nm as well.",
        parse=limit,
    ),
    Option(
        "--max-nrmse-percent VALUE",
        "Exit 3 where the RMSE is above this, in % of the move (greatest less least desired value).",
    ),
    Option(
        "--max-percent-of-range VALUE",
        "Exit 3 where the RMSE is above this, in % of the model's range, as identify and show state it; with "
        "--model or --expected.",
    ),
)
SHOW = Option("--show", "Open a window for each figure, to zoom in; needs a display.")
FIGURES = Option("--figures DIR", "Draw the figures, PNG and SVG, into this folder.")
REPORT_FORMAT = Option(
    "--format text|json|csv|html", "Form of the report [default: by the output's name]."
)
SHOW_FORMAT = Option(
    "--format text|json",
    "Form of what is shown [default: by the output's name, else text].",
)
MODEL_FIGURES = Option(
    "--figures DIR", "Draw the model's curves, PNG and SVG, into this folder."
)

# --- excite: the parameters of ``write_excitation`` ---
EXCITATION = (  # of ``excitation_of``
    Option(
        "--v-max VOLT",
        "Highest drive voltage: the actuator's rating; 4bar or 500mA as well.",
        REQUIRED,
    ),
    Option("--v-min VOLT", "Lowest drive voltage.", "0"),
    Option("--sample-rate HZ", "Rows per second [default: 1000]."),
    Option(
        "--points N",
        "So many rows in all, for a generator's memory; the rate follows.",
        parse=whole(2),
    ),
    Option("--duration SECONDS", "Length of the drive.", "15", parse=positive),
    Option("--frequency HZ", "Full cycles per second.", "1"),
    MAX_SLEW,
    Option("--seed N", "Another number, another drive.", "1", parse=whole(0)),
    Option(
        "--sweep-to HZ", "Append a small sweep up to this frequency, for the dynamics."
    ),
    Option(
        "--sweep-amplitude VOLT",
        "Of that sweep [default: 1 % of the range].",
        parse=figure_above_0,
    ),
)

# --- which command has which, in the order of the help ---
# fmt: off
OPTIONS_OF: dict[str, tuple[Option, ...]] = {
    "identify": (
        LOGS, *READING, *REPORTING, *IDENTIFICATION, SIGN, SKIP, ZERO, METHOD, VALIDATE, PRIOR,
        RATED_MIN, RATED_MAX, FORCE, *WORK, VOLTAGE, DISPLACEMENT, UNCERTAINTY, SUMMARY, OUTPUT,
    ),
    "show": (MODEL, *REPORTING, SHOW_FORMAT, MODEL_FIGURES, OUTPUT),
    "invert": (MODEL, *REPORTING, OUTPUT),
    "simulate": (
        MODEL, INPUTS, *READING, *REPORTING, OUTSIDE, *WORK, STATE, SAVE_STATE, INPUT, FLUSH, SUMMARY,
        HEADER, OUTPUT,
    ),
    "compensate": (
        MODEL, TRAJECTORIES, *READING, *DRIVING, *WORK, *REPORTING, STATE, SAVE_STATE, DISPLACEMENT,
        FLUSH, SUMMARY, HEADER, OUTPUT,
    ),
    "check": (DRIVE, *READING_OF_LOGS, *REPORTING, *CHECKING, SHOW_FORMAT, DRIVE_COLUMN, OUTPUT),
    "report": (
        LOGS, *READING_OF_LOGS, *REPORTING, *TRACKING, *LIMITS, *WORK, FIGURES, REPORT_FORMAT,
        SHOW, *REPORT_COLUMNS, OUTPUT,
    ),
    "excite": (*REPORTING, *EXCITATION, OUTPUT_FORMAT, OUTPUT),
}
# fmt: on
