"""The commands by name, each loaded only when it is called, and how their help looks."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from dbo_cli import __version__
from dbo_cli.cli import options
from dbo_cli.errors import UsageError

COMMANDS = ("identify", "invert", "simulate", "compensate", "report", "excite")
PLAIN = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False}
HEADINGS = ("Arguments", "Options", options.STATE, options.READING, options.COMMON)
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class PlainValues:
    """Hands every value to the command as it was typed.

    The library would check values by a validation package whose import alone takes longer than a short
    command (measured: 90 ms a process), and would word its errors differently from version to version.
    Every command checks its values itself, in ``values``, before it touches a file.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, each told to leave its value alone."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            parameter.process_value = functools.partial(_as_typed, parameter)
        return parameters


class PlainCommand(PlainValues, TyperCommand):
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


class Commands(PlainValues, TyperGroup):
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
            raise UsageError(f"no such command: '{args[0]}'; there are: {', '.join(COMMANDS)}")
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


def _explained(parameter: Any, context: Any) -> tuple[str, str]:
    """Return how a parameter is written and what it means."""
    if parameter.param_type_name == "argument":
        return parameter.metavar, parameter.help or ""
    written, meaning = parameter.get_help_record(context)
    return written, meaning


def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
) -> None:
    """Identify, invert and compensate the hysteresis of piezo actuators.

    A log of drive voltage and displacement becomes a model (identify), the model and a trajectory become
    the drive that follows it (compensate), and the error is reported (report). Every command reads and
    writes - as standard input and output; data alone goes there, everything else to standard error.
    """
    if version:
        typer.echo(f"dbo {__version__}")
    elif context.invoked_subcommand is None:
        raise UsageError(f"no command given; there are: {', '.join(COMMANDS)} (dbo --help says what they do)")


def _function(name: str) -> Callable[..., None]:
    """Import the module of a command and return the function of the same name."""
    function: Callable[..., None] = getattr(importlib.import_module(f"dbo_cli.cli.{name}"), name)
    return function


def _build(name: str) -> Any:
    """Turn a command's function into a command of the command-line library."""
    app = typer.Typer(**PLAIN)  # type: ignore[arg-type]
    app.command(name, cls=PlainCommand, context_settings=CONTEXT)(_function(name))
    return typer.main.get_command(app)


def _as_typed(parameter: Any, context: Any, value: Any) -> Any:
    """Return a value unchanged, unless it is missing where one must be."""
    if parameter.required and value in (None, (), []) and not context.resilient_parsing:
        is_option = parameter.param_type_name == "option"
        name = max(parameter.opts, key=len) if is_option else parameter.metavar
        raise UsageError(f"{name} is missing ({context.command_path} --help lists what there is)")
    return parameter.callback(context, parameter, value) if parameter.callback else value
