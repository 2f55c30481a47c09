"""The options that several commands share, each with its help in one place.

A command is a typer function. ``@reads_logs`` gives it the options that say how a log
is read, as one argument ``reading``; ``@speaks`` those that say how much is said.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, Literal

from typer import Argument, Option

from dbo_cli.cli.say import Level
from dbo_cli.errors import UsageError

COLUMNS = "Columns: a header name, a dataset path, a number from 1, or FILE::COLUMN"
READING = "Reading logs"
LIMITS, STATE, OUTPUT = "Limits", "State", "Output and messages"

Text = str | None

# --- arguments ---

ModelFile = Annotated[
    str,
    Argument(metavar="MODEL", help="The model file; - is stdin, FILE::x one of a set."),
]
LogFile = Annotated[
    str, Argument(metavar="LOG", help="The log; FILE::/group in HDF5; - is stdin.")
]
LogFiles = Annotated[
    list[str],
    Argument(
        metavar="LOG...", help="One or more logs; FILE::/group in HDF5; - is stdin."
    ),
]

# --- output ---

Output = Annotated[
    str,
    Option(
        "-o",
        "--output",
        metavar="FILE",
        help="Where the result goes; - is stdout.",
        rich_help_panel=OUTPUT,
    ),
]
Summary = Annotated[
    Text,
    Option(
        metavar="FILE", help="Also write what was done as JSON.", rich_help_panel=OUTPUT
    ),
]
Figures = Annotated[
    Text,
    Option(
        metavar="DIR",
        help="Draw the figures into this folder, PNG and SVG.",
        rich_help_panel=OUTPUT,
    ),
]
TextOrJson = Annotated[
    Literal["text", "json"] | None,
    Option(
        "--format",
        help="Form of the output; by its name where not given.",
        rich_help_panel=OUTPUT,
    ),
]

# --- columns ---


def column(meaning: str, rare: bool = False) -> Any:
    """Return the option of a column role."""
    return Option(
        metavar="COLUMN", help=f"{meaning}.", hidden=rare, rich_help_panel=COLUMNS
    )


Time = Annotated[Text, column("Time")]
Voltage = Annotated[Text, column("The drive voltage")]
Displacement = Annotated[Text, column("The displacement")]

# --- limits ---

VMin = Annotated[
    Text,
    Option(
        metavar="VOLT", help="Lowest voltage of the amplifier.", rich_help_panel=LIMITS
    ),
]
VMax = Annotated[
    Text,
    Option(
        metavar="VOLT", help="Highest voltage of the amplifier.", rich_help_panel=LIMITS
    ),
]
MaxSlew = Annotated[
    Text,
    Option(
        metavar="VOLT/S",
        help="Fastest change of the drive; 2V/ms as well.",
        rich_help_panel=LIMITS,
    ),
]
From = Annotated[
    Text,
    Option(
        "--from",
        metavar="VOLT",
        help="Where the amplifier stands before the first row.",
        rich_help_panel=LIMITS,
    ),
]

# --- state ---

State = Annotated[
    str,
    Option(
        metavar="NAME|FILE",
        help="What was before: auto, empty, full, settled or a state file.",
        rich_help_panel=STATE,
    ),
]
SaveState = Annotated[
    Text,
    Option(
        metavar="FILE",
        help="Write the state after the last row.",
        hidden=True,
        rich_help_panel=STATE,
    ),
]

# --- how a log is read ---

_READING: dict[str, tuple[Any, Any]] = {
    "time_unit": (
        Text,
        Option(
            metavar="UNIT",
            help="What the time column counts: s, ms, us, min, h.",
            hidden=True,
        ),
    ),
    "sample_rate": (
        Text,
        Option(metavar="HZ", help="Sample rate of a log without a time column."),
    ),
    "scale": (
        list[str] | None,
        Option(
            metavar="ROLE=FACTOR",
            help="Multiply: voltage=20, displacement=10um/V; repeatable.",
        ),
    ),
    "rows": (
        Text,
        Option(metavar="A:B", help="Data rows to take, from 1, both ends included."),
    ),
    "skip_bad": (
        bool,
        Option(
            "--skip-bad",
            help="Drop rows that hold no number, and count them.",
            hidden=True,
        ),
    ),
    "resample": (
        Text,
        Option(metavar="HZ", help="Interpolate to an even clock first.", hidden=True),
    ),
    "delimiter": (
        Text,
        Option(
            metavar="NAME",
            help="comma, semicolon, tab, blanks, pipe or a character.",
            hidden=True,
        ),
    ),
    "decimal": (
        Text,
        Option(metavar="point|comma", help="The decimal sign.", hidden=True),
    ),
    "skip_lines": (
        Text,
        Option(metavar="N", help="Lines to pass over before the header.", hidden=True),
    ),
    "encoding": (
        Text,
        Option(metavar="NAME", help="The text encoding, if not UTF-8.", hidden=True),
    ),
    "clock_offset": (
        Text,
        Option(
            metavar="SECONDS|auto",
            help="Added to the clock of the drive's file where there are two; auto finds it.",
            hidden=True,
        ),
    ),
}
_SPEAKING: dict[str, tuple[Any, Any]] = {
    "quiet": (bool, Option("-q", "--quiet", help="Say nothing but errors.")),
    "verbose": (bool, Option("--verbose", help="Also say what was found and assumed.")),
    "debug": (
        bool,
        Option("--debug", help="Show the traceback of an error.", hidden=True),
    ),
}


def reads_logs(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that say how a log is read, as its argument ``reading``."""

    def gather(values: dict[str, Any]) -> None:
        from dbo_cli.logs import Reading

        chosen = {name: values.pop(name) for name in _READING}
        values["reading"] = Reading(
            time_unit=chosen["time_unit"],
            sample_rate=hertz("sample_rate", chosen["sample_rate"]),
            scale=scales(chosen["scale"] or []),
            rows=chosen["rows"],
            skip_bad=chosen["skip_bad"],
            resample=hertz("resample", chosen["resample"]),
            delimiter=chosen["delimiter"],
            decimal=chosen["decimal"],
            skip_lines=count("skip_lines", chosen["skip_lines"]),
            encoding=chosen["encoding"],
            clock_offset=offset(chosen["clock_offset"]),
        )

    return _with_options(command, _READING, READING, gather, "reading")


def speaks(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command ``--quiet``, ``--verbose`` and ``--debug``."""

    def gather(values: dict[str, Any]) -> None:
        for name in _SPEAKING:
            setattr(Level, name, values.pop(name))

    return _with_options(command, _SPEAKING, OUTPUT, gather, "")


def _with_options(
    command: Callable[..., None],
    options: dict[str, tuple[Any, Any]],
    panel: str,
    gather: Callable[[dict[str, Any]], None],
    replaced: str,
) -> Callable[..., None]:
    """Return a command with further options, which ``gather`` turns into its argument ``replaced``."""
    command.__annotations__.pop(replaced, None)  # a type that is not imported for help
    signature = inspect.signature(command, eval_str=True)
    parameters = [own for own in signature.parameters.values() if own.name != replaced]
    for name, (kind, option) in options.items():
        option.rich_help_panel = panel
        default = False if kind is bool else None
        annotation = Annotated[kind, option]  # type: ignore[valid-type]
        parameters.append(
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=default,
                annotation=annotation,
            )
        )

    @functools.wraps(command)
    def run(**values: Any) -> None:
        gather(values)
        command(**values)

    keyword = inspect.Parameter.KEYWORD_ONLY
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameter.replace(kind=keyword) for parameter in parameters]
    )
    run.__annotations__ = {
        parameter.name: parameter.annotation for parameter in parameters
    }
    return run


# --- values ---


def number(name: str, text: str | None) -> float | None:
    """Return the number of an option; UsageError where it is none."""
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"`{name}` {text}: not a number") from None


def hertz(name: str, text: str | None) -> float | None:
    """Return a rate in Hz, with or without a unit (``2kHz``)."""
    return quantity(name, text, "Hz")


def quantity(name: str, text: str | None, unit: str | None) -> float | None:
    """Return a typed quantity in ``unit``: a plain number, or one with a unit of that kind."""
    from dbo_cli.units import parse_quantity

    return None if text is None else parse_quantity(text, unit, name)


def count(name: str, text: str | None) -> int | None:
    """Return a whole number of at least 0; UsageError where it is none."""
    if text is None:
        return None
    if not text.isdigit():
        raise UsageError(f"`{name}` {text}: not a whole number of at least 0")
    return int(text)


def offset(text: str | None) -> float | Literal["auto"] | None:
    """Return seconds, or ``auto``."""
    return "auto" if text == "auto" else number("clock_offset", text)


def seconds_or_auto(name: str, text: str | None) -> float | Literal["auto"] | None:
    """Return seconds (``5ms`` as well), or ``auto``."""
    return "auto" if text == "auto" else quantity(name, text, "s")


def scales(texts: list[str]) -> dict[str, str]:
    """Return the factors of ``--scale ROLE=FACTOR`` by role."""
    factors = {}
    for text in texts:
        role, equals, factor = text.partition("=")
        if not equals or not factor:
            raise UsageError(
                f"`scale` {text}: type ROLE=FACTOR, for example voltage=20"
            )
        factors[role] = factor
    return factors
