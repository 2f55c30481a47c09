"""The options that several commands share, each with its help in one place.

A command is a typer function. ``with_shared_options`` appends the options that say how
much is printed; a parameter ``reading`` stands for the options that say how a log is
read.
"""

import functools
import inspect
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

from typer import Argument, Option

from dbo_cli.cli.say import Level
from dbo_cli.errors import UsageError
from dbo_cli.units import parse_quantity

if TYPE_CHECKING:
    from dbo_cli.logs import Reading as Reading
else:
    Reading = Any  # the help imports no log

Text = str | None
Texts = list[str] | None
TextOrJson = Literal["text", "json"] | None
LIMITS, MOVE, READING, OUTPUT = "Limits", "Move", "Log", "Output"
FORM_OF_ENDING = {".json": "json", ".csv": "csv", ".html": "html", ".htm": "html"}


def option(
    metavar: str | None,
    text: str,
    panel: str | None = None,
    *names: str,
    default: Any = None,
    **more: Any,
) -> Any:
    """Return an option under a heading of the help; a default of ``...`` makes it required."""
    more |= {"metavar": metavar, "help": text, "rich_help_panel": panel}
    return Option(default, *names, show_default=False, **more)


def rare(metavar: str | None, text: str, *words: str, **more: Any) -> Any:
    """Return an option that ``--help-all`` alone shows."""
    return option(metavar, text, *words, hidden=True, **more)


def flag(name: str, text: str, panel: str | None = None, **more: Any) -> Any:
    """Return an option without a value."""
    return option(None, text, panel, name, default=False, **more)


def column(text: str, **more: Any) -> Any:
    """Return the option of a column's role: a header name, a dataset path, a number or FILE::COLUMN."""
    return option("COLUMN", text, READING, **more)


# --- arguments ---

MODEL = Argument(
    ..., metavar="MODEL", help="Model file; - is stdin, FILE::x one of a set."
)
LOG = Argument(..., metavar="LOG", help="The log; FILE::/group in HDF5; - is stdin.")
LOGS = Argument(..., metavar="LOG...", help="Logs; FILE::/group in HDF5; - is stdin.")
DRIVE = Argument(..., metavar="DRIVE", help="The drive; - is stdin.")

# --- output ---

OUTPUT_FILE = option(
    "FILE",
    "Output file; - is stdout, the default.",
    OUTPUT,
    "-o",
    "--output",
    default="-",
)
SUMMARY_FILE = option("FILE", "Write the figures as JSON, too.", OUTPUT)
FIGURES_DIR = option("DIR", "Write PNG and SVG figures there.", OUTPUT)
FORM = option(None, "Form of the output; default: by its name.", OUTPUT, "--format")

# --- columns ---

TIME = column("The time.")
VOLTAGE = column("The drive voltage: name, number or FILE::COLUMN.")
DISPLACEMENT = column("The displacement: name, number or FILE::COLUMN.")

# --- limits; a command that takes channels takes several, such as x=120V ---

V_MIN = option("VOLT", "Lowest voltage of the amplifier.", LIMITS)
V_MAX = option("VOLT", "Highest voltage of the amplifier.", LIMITS)
MAX_SLEW = option("VOLT/S", "Largest slew rate, such as 2000 or 2V/ms.", LIMITS)
FROM = option("VOLT", "Voltage of the amplifier before row 1.", MOVE, "--from")

# --- state ---

STATE = option(
    "NAME|FILE", "Start: auto, empty, full, settled or a file.", MOVE, default="auto"
)
SAVE_STATE = rare("FILE", "Write the state after the last row.", OUTPUT)
SKIP = option("SECONDS", "Leave out the start of each log.", READING, default="0")

# --- options that are appended ---


def read_as(
    *,
    sample_rate: Text = option("HZ", "Rate of a log without a time column.", READING),
    scale: Texts = option("ROLE=FACTOR", "Convert: displacement=10um/V.", READING),
    rows: Text = rare("A:B", "Only data rows A to B, counted from 1.", READING),
    time_unit: Text = rare("UNIT", "Unit of the time: s, ms, us, min, h.", READING),
    skip_bad: bool = flag(
        "--skip-bad", "Drop and count rows that hold no number.", READING, hidden=True
    ),
    resample: Text = rare("HZ", "Interpolate the log to this rate first.", READING),
    delimiter: Text = rare("NAME", "comma, semicolon, tab, blanks or pipe.", READING),
    decimal: Text = rare("point|comma", "Decimal sign.", READING),
    skip_lines: int | None = rare("N", "Lines before the header.", READING, min=0),
    encoding: Text = rare("NAME", "Text encoding, if not UTF-8.", READING),
    clock_offset: Text = rare("SECONDS|auto", "Added to the drive's clock.", READING),
) -> Reading:
    """Return how a log is to be read."""
    typed = dict(locals(), scale=_scales(scale or []))
    from dbo_cli.logs import Reading

    return Reading.of_options(typed)


def _scales(texts: list[str]) -> dict[str, str | float]:
    """Return the factors of ``--scale ROLE=FACTOR`` by role."""
    factors: dict[str, str | float] = {}
    for text in texts:
        role, _, factor = text.partition("=")
        if not factor:
            raise UsageError(f"`scale` {text}: type ROLE=FACTOR, such as voltage=20")
        factors[role] = factor
    return factors


def speak(
    *,
    quiet: bool = option(
        None, "Print no messages but errors.", OUTPUT, "-q", "--quiet", default=False
    ),
    verbose: bool = flag("--verbose", "Print details.", OUTPUT),
    debug: bool = flag("--debug", "Print a traceback, too.", OUTPUT, hidden=True),
) -> None:
    """Set how much a command says."""
    Level.quiet, Level.verbose, Level.debug = quiet, verbose, debug


def with_shared_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of ``speak``, and those of ``read_as`` for a ``reading``."""
    named = dict(inspect.signature(command, eval_str=True).parameters)
    spoken = inspect.signature(speak, eval_str=True).parameters
    read = dict(inspect.signature(read_as, eval_str=True).parameters)
    if named.pop("reading", None) is None:
        read.clear()

    @functools.wraps(command)
    def run(**values: Any) -> None:
        speak(**{name: values.pop(name) for name in spoken})
        if read:
            values["reading"] = read_as(**{name: values.pop(name) for name in read})
        command(**values)

    signature = []
    for parameter in [*named.values(), *read.values(), *spoken.values()]:
        signature.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    run.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    return run


# --- values ---


def require(partner: str, partner_value: object, options: dict[str, Any]) -> None:
    """Refuse options that say nothing without another one."""
    for name, value in options.items():
        if value and not partner_value:
            raise UsageError(f"`{name}` needs `{partner}`")


def span(name: str, text: str, unit: str | None) -> tuple[float, float]:
    """Return the two numbers of ``LOW:HIGH``; a unit behind the second is that of both."""
    low, colon, high = text.partition(":")
    if not colon:
        raise UsageError(f"`{name}` {text}: type LOW:HIGH, such as 0:5")
    if not unit_behind(low):
        low += unit_behind(high)
    return parse_quantity(low, unit, name), parse_quantity(high, unit, name)


def unit_behind(text: str) -> str:
    """Return the unit behind a number; empty where there is none."""
    return text.strip().lstrip("+-.0123456789eE").strip()


def form_of(form: str | None, output: str) -> str:
    """Return the form of a result: by ``--format``, else by the name of the output."""
    return form or FORM_OF_ENDING.get(os.path.splitext(output.lower())[1], "text")
