"""Options that always come together, declared once and handed to a command as one value.

A command function with a parameter ``reading`` or ``voice`` gets, in its place on the command line, all
options of that bundle; the function itself sees one checked value.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from dbo_cli.cli import options, values
from dbo_cli.cli.messages import Voice


@dataclass(frozen=True)
class Reading:
    """How logs are to be read, as far as the user had to say it."""

    time: str | None
    sample_rate: float | None
    rows: str | None
    skip_bad: bool
    resample: float | None
    file_format: str | None
    delimiter: str | None
    decimal: str | None
    comment: str | None
    header_lines: int | None
    skip_lines: int | None
    encoding: str | None
    block_rows: int | None


FORMATS = ("csv", "tsv", "hdf5")

READING: dict[str, tuple[Any, Any]] = {
    "time": (options.Time, None),
    "sample_rate": (options.SampleRate, None),
    "rows": (options.Rows, None),
    "skip_bad": (options.SkipBad, False),
    "resample": (options.Resample, None),
    "file_format": (options.FileFormat, None),
    "delimiter": (options.Delimiter, None),
    "decimal": (options.Decimal, None),
    "comment": (options.Comment, None),
    "header_lines": (options.HeaderLines, None),
    "skip_lines": (options.SkipLines, None),
    "encoding": (options.Encoding, None),
    "block_rows": (options.BlockRows, None),
}
LOG_READING = READING | {"file_format": (options.LogFormat, None)}
VOICE: dict[str, tuple[Any, Any]] = {
    "quiet": (options.Quiet, False),
    "verbose": (options.Verbose, False),
    "debug": (options.Debug, False),
}


def reading_of(typed: Mapping[str, Any]) -> Reading:
    """Check the reading options of one command line."""
    return Reading(
        time=typed["time"],
        sample_rate=values.optional(values.positive, "--sample-rate", typed["sample_rate"]),
        rows=typed["rows"],
        skip_bad=typed["skip_bad"],
        resample=values.optional(values.positive, "--resample", typed["resample"]),
        file_format=values.optional(_file_format, "--format", typed["file_format"]),
        delimiter=typed["delimiter"],
        decimal=typed["decimal"],
        comment=typed["comment"],
        header_lines=values.optional(_header_lines, "--header-lines", typed["header_lines"]),
        skip_lines=values.optional(_count, "--skip-lines", typed["skip_lines"]),
        encoding=typed["encoding"],
        block_rows=values.optional(_rows, "--block-rows", typed["block_rows"]),
    )


def voice_of(typed: Mapping[str, Any]) -> Voice:
    """Return the voice that was asked for (``--debug`` is heard by ``app.main`` itself)."""
    return Voice(quiet=typed["quiet"], verbose=typed["verbose"])


COMMAND_LINE: ContextVar[tuple[str, ...]] = ContextVar("COMMAND_LINE", default=())
"""The words that were typed, set by ``app.main``; a command takes them as ``command_line``."""

Bundle = tuple[dict[str, tuple[Any, Any]], Callable[[Mapping[str, Any]], Any]]
BUNDLES: dict[str, Bundle] = {
    "reading": (READING, reading_of),
    "log_reading": (LOG_READING, reading_of),
    "voice": (VOICE, voice_of),
    "command_line": ({}, lambda typed: COMMAND_LINE.get()),
}


def bundled(function: Callable[..., None]) -> Callable[..., None]:
    """Replace each bundle in a command's signature by the options it stands for."""
    own = inspect.signature(function, eval_str=True).parameters
    parameters: dict[str, inspect.Parameter] = {}
    for name, parameter in own.items():
        declared, _ = BUNDLES.get(name, ({name: (parameter.annotation, parameter.default)}, None))
        for option, (annotation, default) in declared.items():
            parameters[option] = inspect.Parameter(
                option, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default
            )

    @functools.wraps(function)
    def command(**typed: Any) -> None:
        function(**{name: BUNDLES[name][1](typed) if name in BUNDLES else typed[name] for name in own})

    command.__dict__["__signature__"] = inspect.Signature(list(parameters.values()))
    command.__annotations__ = {name: p.annotation for name, p in parameters.items()}
    return command


def _file_format(option: str, text: str) -> str:
    return values.choice(option, text, FORMATS)


def _header_lines(option: str, text: str) -> int:
    return int(values.choice(option, text, ("0", "1", "2")))


def _rows(option: str, text: str) -> int:
    return values.whole(option, text, 1)


def _count(option: str, text: str) -> int:
    return values.whole(option, text, 0)
