"""Everything that stands between the command-line library and this program's commands, and what it saves.

- The library checks values with a validation package whose import takes longer than a short command
  (measured: 90 ms a process), and words its errors differently from version to version. Here the text of each
  option goes to the parser that ``options`` declares beside its name, and a command gets parsed values.
- It imports all commands to know their names. Here a command's module is imported when it is called.
- It wants every option in every signature. Here options that always come together are one parameter:
  ``reading``, ``log_reading`` and ``voice`` stand for a bundle, ``typed`` for the words of the command line.
- Its help knows no order. Here columns come before the other reading options, headings always alike.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup

from dbo_cli.cli import options
from dbo_cli.cli.messages import Voice
from dbo_cli.errors import UsageError
from dbo_cli.version import __version__

COMMANDS = (
    "identify", "show", "invert", "simulate", "compensate", "check", "report", "excite", "export", "compare"
)  # fmt: skip
SHELLS = ("bash", "zsh", "fish")
PLAIN = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False}
HEADINGS = ("Arguments", "Options", options.STATE, options.READING, options.COMMON)
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

TYPED: ContextVar[tuple[str, ...]] = ContextVar("TYPED", default=())
"""The words that were typed, set by ``app.main``."""

READING: dict[str, Any] = {
    "time": options.Time,
    "time_unit": options.TimeUnit,
    "sample_rate": options.SampleRate,
    "scale": options.Scale,
    "rows": options.Rows,
    "skip_bad": options.SkipBad,
    "resample": options.Resample,
    "format": options.FileFormat,
    "delimiter": options.Delimiter,
    "decimal": options.Decimal,
    "comment": options.Comment,
    "header_lines": options.HeaderLines,
    "skip_lines": options.SkipLines,
    "encoding": options.Encoding,
    "block_rows": options.BlockRows,
}
VOICE: dict[str, Any] = {"quiet": options.Quiet, "verbose": options.Verbose, "debug": options.Debug}


def reading_of(values: Mapping[str, Any]) -> Any:
    """Return how logs are to be read; what was not said stays at its default."""
    from dbo_cli.logs.reading_options import ReadingOptions

    return ReadingOptions(**{name: values[name] for name in READING if values[name] is not None})


def voice_of(values: Mapping[str, Any]) -> Voice:
    """Return the voice that was asked for (``--debug`` is heard by ``app.main`` itself)."""
    return Voice(quiet=values["quiet"], verbose=values["verbose"])


DRIVE: dict[str, Any] = {
    "v_min": options.VoltageMin,
    "v_max": options.VoltageMax,
    "max_slew": options.MaxSlew,
    "max_current": options.MaxCurrent,
    "capacitance": options.Capacitance,
    "on_limit": options.OnLimit,
    "from_": options.From,
    "approach": options.Approach,
    "condition": options.Condition,
    "lead": options.Lead,
    "return_": options.Return,
    "bandwidth": options.Bandwidth,
    "absolute": options.Absolute,
    "history": options.History,
    "settle": options.Settle,
    "periodic": options.Periodic,
    "passes": options.Passes,
}


def drive_of(values: Mapping[str, Any]) -> Any:
    """Return what is asked of a drive; the state is read with the model."""
    from dbo_cli.drives.options import DriveOptions

    return DriveOptions(**{name: values[name] for name in DRIVE})


Bundle = tuple[dict[str, Any], Callable[[Mapping[str, Any]], Any]]
BUNDLES: dict[str, Bundle] = {
    "reading": (READING, reading_of),
    "log_reading": (READING | {"format": options.LogFormat}, reading_of),
    "asked": (DRIVE, drive_of),
    "voice": (VOICE, voice_of),
    "typed": ({}, lambda values: TYPED.get()),
}


class ParsedValues:
    """Hands every value to the command as its own parser understands it."""

    parsers: Mapping[str, Callable[[str, str], Any]] = {}

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, each told to leave its value to this program."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            parse = self.parsers.get(parameter.name)
            parameter.process_value = functools.partial(_parsed, parameter, parse)
        return parameters


class Command(ParsedValues, TyperCommand):
    """A command whose help lists its options under headings, in plain text."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments first, then each heading's options as declared, columns before the rest."""
        sections: dict[str, list[Any]] = {heading: [] for heading in HEADINGS}
        for parameter in self.get_params(ctx):
            is_argument = parameter.param_type_name == "argument"
            named = getattr(parameter, "rich_help_panel", None)  # the library's own --help has none
            heading = "Arguments" if is_argument else named or "Options"
            sections[heading].append(parameter)
        for heading, parameters in sections.items():
            if parameters:
                parameters.sort(key=lambda parameter: parameter.metavar != options.COLUMN)
                with formatter.section(heading):
                    formatter.write_dl([_explained(parameter, ctx) for parameter in parameters], col_max=28)


class Commands(ParsedValues, TyperGroup):
    """The group behind ``dbo``: knows the names, imports a command's module when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of a working day."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Build the command of a name, or return None."""
        return _build(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the first word names, or say which there are."""
        if args[0] not in COMMANDS and not args[0].startswith("-"):
            near = difflib.get_close_matches(args[0], COMMANDS, 1)
            meant = f": {near[0]}?" if near else ""
            raise UsageError(f"no such command: '{args[0]}'{meant}; there are: {', '.join(COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each command with the first line of its documentation."""
        rows = [(name, (inspect.getdoc(_function(name)) or "").partition("\n")[0]) for name in COMMANDS]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def root_command() -> Any:
    """Return the group ``dbo``, ready to parse a command line."""
    app = typer.Typer(cls=Commands, no_args_is_help=False, context_settings=CONTEXT, **PLAIN)  # type: ignore[arg-type]
    app.callback(invoke_without_command=True)(_root)
    return typer.main.get_command(app)


COMPLETING = "_DBO_COMPLETE"
"""The environment variable by which a shell asks for completions, as the library's scripts set it."""


def completions() -> int:
    """Answer a shell that asks what could be typed next, or print the script that asks."""
    from typer.completion import completion_init  # type: ignore[attr-defined]

    completion_init()
    try:
        root_command().main(args=[], prog_name="dbo", standalone_mode=True)
    except SystemExit as leaving:
        return int(leaving.code or 0)
    return 0


def run(words: Sequence[str]) -> int:
    """Parse a command line and run the command it names; its exceptions come through."""
    if COMPLETING in os.environ:
        return completions()
    TYPED.set(tuple(words))
    command = root_command()
    try:
        # Not command.main(): it words errors its own way and turns an interrupt into something else.
        with command.make_context("dbo", list(words)) as context:
            command.invoke(context)
    except typer.Exit as leaving:
        return int(leaving.exit_code)
    return 0


def complaint(problem: BaseException) -> tuple[str, int] | None:
    """Return text and exit code of the library's own complaints, whatever their class is called."""
    wording = getattr(problem, "format_message", None)
    if wording is None:
        return None
    text = str(wording()).rstrip(".")
    return f"{text[:1].lower()}{text[1:]}", int(getattr(problem, "exit_code", 2))


def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
    show_completion: Annotated[
        str | None,
        typer.Option(
            "--show-completion",
            metavar="bash|zsh|fish",
            help="Print the script that completes commands and options, for the shell's start file.",
        ),
    ] = None,
) -> None:
    """Identify, invert and compensate the hysteresis of piezo actuators.

    A log of drive voltage and displacement becomes a model (identify), the model and a trajectory become
    the drive that follows it (compensate), and the error is reported (report). Every command reads and
    writes - as standard input and output; data alone goes there, everything else to standard error.
    """
    if version:
        typer.echo(f"dbo {__version__}")
    elif show_completion is not None:
        if show_completion not in SHELLS:
            raise UsageError(f"`show_completion`: '{show_completion}' is none of {', '.join(SHELLS)}")
        os.environ[COMPLETING] = f"source_{show_completion}"
        completions()
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _function(name: str) -> Callable[..., None]:
    """Import the module of a command and return the function of the same name."""
    function: Callable[..., None] = getattr(importlib.import_module(f"dbo_cli.cli.{name}"), name)
    return function


def _build(name: str) -> Any:
    """Turn a command's function into a command of the command-line library."""
    function = _function(name)
    declared = _declared(function)
    app = typer.Typer(**PLAIN)  # type: ignore[arg-type]
    app.command(name, cls=Command, context_settings=CONTEXT)(_with_options(function, declared))
    command = typer.main.get_command(app)
    assert isinstance(command, Command)
    told = {key: getattr(_info(kind), "parse", None) for key, kind in declared.items()}
    command.parsers = {key: parse for key, parse in told.items() if parse is not None}
    return command


def _declared(function: Callable[..., None]) -> dict[str, Any]:
    """Return the option of each parameter, bundles taken apart."""
    declared: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name in BUNDLES:
            declared |= BUNDLES[name][0]
        else:  # one by one: the bundles' own types are not imported for a page of help
            declared[name] = eval(parameter.annotation, function.__globals__)
    return declared


def _with_options(function: Callable[..., None], declared: Mapping[str, Any]) -> Callable[..., None]:
    """Give a function the signature that the library reads: texts and switches, a parameter an option."""
    own = inspect.signature(function).parameters
    parameters = [_as_text(name, kind) for name, kind in declared.items()]

    @functools.wraps(function)
    def command(**values: Any) -> None:
        function(**{name: BUNDLES[name][1](values) if name in BUNDLES else values[name] for name in own})

    command.__dict__["__signature__"] = inspect.Signature(parameters)
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _as_text(name: str, kind: Any) -> inspect.Parameter:
    """Return a parameter as it is typed: what its parser makes of it is not the library's business."""
    value, info = get_args(kind)[0], _info(kind)
    given = getattr(info, "typed_default", inspect.Parameter.empty)
    typed: Any = str
    if value is bool:
        typed, given = bool, False
    elif get_origin(value) is list or any(get_origin(part) is list for part in get_args(value)):
        typed = list[str]
    if given is None:
        typed = typed | None
    annotation = Annotated[typed, info]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=given)


def _info(kind: Any) -> Any:
    return get_args(kind)[1]


def _explained(parameter: Any, context: Any) -> tuple[str, str]:
    """Return how a parameter is written and what it means."""
    if parameter.param_type_name == "argument":
        return parameter.metavar, parameter.help or ""
    written, meaning = parameter.get_help_record(context)
    return written, meaning


def _parsed(parameter: Any, parse: Callable[[str, str], Any] | None, context: Any, value: Any) -> Any:
    """Return what a parameter's own parser makes of its text; refuse it where it is missing."""
    is_option = parameter.param_type_name == "option"
    name = max(parameter.opts, key=len) if is_option else parameter.metavar
    if parameter.required and value in (None, (), []) and not context.resilient_parsing:
        raise UsageError(f"{name} is missing ({context.command_path} --help lists what there is)")
    if parse is not None and isinstance(value, str):
        value = parse(name.lstrip("-").replace("-", "_"), value)
    return parameter.callback(context, parameter, value) if parameter.callback else value
