"""Everything that stands between the command-line library and this program's commands, and what it saves.

- The library checks values with a validation package whose import takes longer than a
  short command (measured: 90 ms a process), and words its errors differently from
  version to version. Here the text of each option goes to the parser that ``options``
  has beside its name, and a command gets parsed values.
- It reads options from the signatures of functions. Here they come from the table in
  ``options``.
- Its help knows no order. Here columns come before the other reading options, headings
  always alike.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import inspect
import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from dbo_cli.cli import commands, options
from dbo_cli.cli.commands import Arguments, Command
from dbo_cli.cli.options import Option
from dbo_cli.errors import DboError, UsageError
from dbo_cli.version import __version__

SHELLS = ("bash", "zsh", "fish")
PLAIN = {
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
}
HEADINGS = (
    "Arguments",
    options.OPTIONS,
    options.STARTING,
    options.READING_LOGS,
    options.MESSAGES,
)
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}  # columns

TYPED = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
"""Where those scripts put the words typed so far: bash, and zsh and fish."""

WORDS: ContextVar[tuple[str, ...]] = ContextVar("WORDS", default=())
"""The words that were typed, set by ``run``."""

WHOLE_HELP: ContextVar[bool] = ContextVar("WHOLE_HELP", default=False)
"""Whether a page of help has everything, or what most need; set by ``run``."""

ALL_OPTIONS = "--help-all"
READING = "reading"
"""``dbo help reading``: the options that say how a log is read, alone."""


class ParsedValues:
    """Hands every value to the command as its own parser understands it."""

    declared: Mapping[str, Option] = {}

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, each set to leave its value to this program."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            option = self.declared.get(parameter.name)
            parameter.process_value = functools.partial(_parsed, parameter, option)
        return parameters


class TableCommand(ParsedValues, TyperCommand):
    """A command whose help says what it writes, gives examples, and lists its options under headings."""

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the command does, writes and needs: in full, or a line of it and the examples."""
        command = command_of(self.name or "")
        if WHOLE_HELP.get():
            super().format_help_text(ctx, formatter)
            with formatter.section("Writes"):
                formatter.write_text(command.writes)
        else:
            formatter.write(f"\n  {command.summary}\n")
        with formatter.section("Examples"):
            for purpose, line in command.examples:
                formatter.write(f"  {purpose}\n    {line}\n")

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options and the exit codes, or the usual options and where the others stand."""
        command = command_of(self.name or "")
        if WHOLE_HELP.get():
            sections = [*self.sections(ctx), ("Exit codes", command.exit_codes)]
        else:
            sections = self.usual_sections(ctx)
        for heading, rows in sections:
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=28)
        if not WHOLE_HELP.get():
            formatter.write_paragraph()
            formatter.write_text(_where_the_rest_stands(command, self.name or ""))

    def usual_sections(self, ctx: Any) -> list[tuple[str, list[tuple[str, str]]]]:
        """Return the arguments, and the options that most need in the order of the command's own list."""
        arguments = []
        by_name = {}
        for parameter in self.get_params(ctx):
            if parameter.param_type_name == "argument":
                arguments.append(_explained(parameter, ctx))
            for name in parameter.opts:
                by_name[name] = parameter
        usual = []
        for name in command_of(self.name or "").usual:
            if name in by_name:  # an extra that brings it may be missing
                usual.append(_explained(by_name[name], ctx))
        sections = []
        if arguments:
            sections.append(("Arguments", arguments))
        if usual:
            sections.append(("Usual options", usual))
        return sections

    def sections(self, ctx: Any) -> list[tuple[str, list[tuple[str, str]]]]:
        """Return each heading with its options and what they mean; columns come before the rest."""
        sections: dict[str, list[Any]] = {heading: [] for heading in HEADINGS}
        for parameter in self.get_params(ctx):
            # the library's own --help has none
            heading = getattr(parameter, "rich_help_panel", None) or options.OPTIONS
            if parameter.param_type_name == "argument":
                heading = "Arguments"
            sections[heading].append(parameter)
        for parameters in sections.values():
            parameters.sort(key=lambda parameter: parameter.metavar != options.COLUMN)
        explained = []
        for heading, listed in sections.items():
            if listed:
                rows = [_explained(option, ctx) for option in listed]
                explained.append((heading, rows))
        return explained


class Commands(ParsedValues, TyperGroup):
    """The group behind ``dbo``: knows the names, builds a command when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of a working day."""
        return commands.names()

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Build the command of a name, or return None."""
        command = commands.find(cmd_name, WORDS.get())
        return None if command is None else _build(cmd_name, command)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the first word names, or say which there are."""
        if not args[0].startswith("-") and commands.find(args[0]) is None:
            names = commands.names()
            near = difflib.get_close_matches(args[0], names, 1)
            meant = commands.MEANT.get(args[0].lower()) or next(iter(near), "")
            suggestion = f": dbo {meant}?" if meant else ""
            raise UsageError(
                f"no such command: '{args[0]}'{suggestion}; there are: {', '.join(names)}"
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each command with the first line of its documentation."""
        rows = [(name, command_of(name).summary) for name in commands.names()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def root_command() -> Any:
    """Return the group ``dbo``, ready to parse a command line."""
    app = typer.Typer(
        cls=Commands,
        no_args_is_help=False,
        context_settings=CONTEXT,
        **PLAIN,  # type: ignore[arg-type]
    )
    app.callback(invoke_without_command=True)(_root)
    return typer.main.get_command(app)


def completions() -> int:
    """Answer a shell that asks what could be typed next, or print the script that asks."""
    from typer.completion import completion_init  # type: ignore[attr-defined]

    completion_init()
    without_help()
    try:
        root_command().main(args=[], prog_name="dbo", standalone_mode=True)
    except SystemExit as leaving:
        return int(leaving.code or 0)
    return 0


def run(words: Sequence[str]) -> int:
    """Parse a command line and run the command it names; its exceptions come through."""
    if options.ASKED in os.environ:
        return completions()
    words = _asking_for_help(list(words))
    if words == [READING, "--help"]:
        typer.echo(_reading_page())
        return 0
    WORDS.set(tuple(words))
    command = root_command()
    try:
        # Not command.main(): it words errors its own way and turns an interrupt into
        # something else.
        with command.make_context("dbo", list(words)) as context:
            command.invoke(context)
    except typer.Exit as leaving:
        return int(leaving.exit_code)
    return 0


def _asking_for_help(words: list[str]) -> list[str]:
    """Return the words with ``help`` and ``--help-all`` as ``--help``, and note how much was asked for."""
    whole = words[:1] == ["help"] or ALL_OPTIONS in words
    WHOLE_HELP.set(whole)
    if not whole:
        return words
    command = words[1:] if words[0] == "help" else words
    return [*(word for word in command if word != ALL_OPTIONS), "--help"]


def _reading_page() -> str:
    """Return the page of the options that say how a log is read, and which commands have them."""
    context: Any = root_command().make_context("dbo", [], resilient_parsing=True)
    formatter = context.make_formatter()
    readers = []
    for name, command in commands.every().items():
        if any(option.names == ["--time"] for option in command.options):
            readers.append(name)
    formatter.write("How a log is read: what these commands have in common.\n\n")
    formatter.write_text(
        f"{', '.join(readers[:-1])} and {readers[-1]} find out what a file is, how its text is written and "
        "which columns are meant, and say what they took for what. Where that is wrong, or not clear, these "
        "options say it. docs/instruments-formats.md goes through the formats."
    )
    rows = []
    for option in (options.VOLTAGE, options.DISPLACEMENT, *options.READING):
        written = ", ".join(option.names)
        if option.metavar:
            written += f" {option.metavar}"
        rows.append((written, option.meaning))
    with formatter.section(options.READING_LOGS):
        formatter.write_dl(rows, col_max=28)
    page: str = formatter.getvalue().rstrip("\n")
    return page


def _where_the_rest_stands(command: Command, name: str) -> str:
    """Return what a short page of help says of the options that it leaves out."""
    declared = (*command.options, *command.brought)
    number = sum(1 for option in declared if option.names)
    reading = any(option.heading == options.READING_LOGS for option in declared)
    text = f"dbo help {name} (or --help-all) has all {number} options, what is written and the exit codes"
    if reading:
        text += "; dbo help reading: how a log of any kind is read"
    return f"{text}."


def complaint(problem: BaseException) -> tuple[str, int] | None:
    """Return text and exit code of the library's own complaints, whatever their class is called."""
    wording = getattr(problem, "format_message", None)
    if wording is None:
        return None
    text = str(wording()).rstrip(".")
    return f"{text[:1].lower()}{text[1:]}", int(getattr(problem, "exit_code", 2))


def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.")
    ] = False,
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

    A log of drive voltage and displacement becomes a model (identify), the model and a
    trajectory become the drive that follows it (compensate), and the error is reported
    (report). Every command reads and writes - as standard input and output; data alone
    goes there, everything else to standard error. dbo COMMAND --help has what most need
    of a command, dbo help COMMAND everything, dbo help reading how logs are read.
    """
    if version:
        typer.echo(f"dbo {__version__}")
    elif show_completion is not None:
        if show_completion not in SHELLS:
            raise UsageError(
                f"`show_completion`: '{show_completion}' is none of {', '.join(SHELLS)}"
            )
        os.environ[options.ASKED] = f"source_{show_completion}"
        completions()
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


def command_of(name: str) -> Command:
    """Return a command that is known to be there."""
    command = commands.find(name)
    assert command is not None, name
    return command


def _build(name: str, made_of: Command) -> Any:
    """Turn a command of the table into one of the command-line library."""
    declared = (*made_of.options, *made_of.brought)

    def command(**values: Any) -> None:
        brought = {}
        for option in made_of.brought:
            value = values.pop(option.key)
            if value:
                brought[option.key] = value
        made_of.function(Arguments(typed=WORDS.get(), brought=brought, **values))

    command.__doc__ = made_of.section()
    parameters = [_parameter(option) for option in declared]
    # The library takes the options from the signature.
    command.__dict__["__signature__"] = inspect.Signature(parameters)
    command.__annotations__ = {
        parameter.name: parameter.annotation for parameter in parameters
    }
    app = typer.Typer(**PLAIN)  # type: ignore[arg-type]
    app.command(name, cls=TableCommand, context_settings=CONTEXT)(command)
    built = typer.main.get_command(app)
    assert isinstance(built, TableCommand)
    built.declared = {option.key: option for option in declared}
    return built


def _parameter(option: Option) -> inspect.Parameter:
    """Return an option as the library reads it: a text, several or a switch, without its parser."""
    kind: Any = list[str] if option.repeated else str
    default: Any = option.default if option.names else options.REQUIRED
    if option.metavar is None:
        kind, default = bool, False
    elif default is None:
        kind = kind | None
    words: dict[str, Any] = {"metavar": option.metavar, "help": option.meaning}
    words["autocompletion"] = offers(option)
    if option.names:
        panel = None if option.heading == options.OPTIONS else option.heading
        info: Any = typer.Option(*option.names, rich_help_panel=panel, **words)
    else:
        info = typer.Argument(show_default=False, **words)
    key, keyword_only = option.key, inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(
        key, keyword_only, annotation=Annotated[kind, info], default=default
    )


def _explained(parameter: Any, context: Any) -> tuple[str, str]:
    """Return how a parameter is written and what it means."""
    if parameter.param_type_name == "argument":
        return parameter.metavar, parameter.help or ""
    written, meaning = parameter.get_help_record(context)
    return written, meaning


def _parsed(parameter: Any, option: Option | None, context: Any, value: Any) -> Any:
    """Return what an option's own parser makes of its text; refuse it where it is missing."""
    is_option = parameter.param_type_name == "option"
    name = max(parameter.opts, key=len) if is_option else parameter.metavar
    if parameter.required and value in (None, (), []) and not context.resilient_parsing:
        raise UsageError(
            f"{name} is missing ({context.command_path} --help lists what there is)"
        )
    if option is not None:
        value = option.value(value)
    if parameter.callback:
        return parameter.callback(context, parameter, value)
    return value


# --- what a shell offers for the word that is typed ---


def offers(option: Option) -> Callable[[str], list[str]] | None:
    """Return what finds the words to offer, from the beginning of one; None where files are offered."""
    if option.metavar == options.COLUMN:
        return columns_beginning
    words = option.words
    if not words:
        return None
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def without_help() -> None:
    """Take ``help`` out of the words typed: ``dbo help COMMAND`` is completed as ``dbo COMMAND`` is."""
    for name in TYPED:
        line, taken = re.subn(r"^(\s*\S+\s+)help\s+", r"\1", os.environ.get(name, ""))
        if taken:
            os.environ[name] = line
            os.environ["COMP_CWORD"] = str(int(os.environ.get("COMP_CWORD", "1")) - 1)


def columns_beginning(incomplete: str) -> list[str]:
    """Return the columns, of the logs in the words typed, whose names begin so.

    Of a name with a blank only what stands before the unit is offered, and nothing
    where that has one too: the shells do not agree on how to quote it.
    """
    from dbo_cli.logs.request import ReadingOptions, Request, parse_address
    from dbo_cli.logs.signal_log import open_table

    line = next((os.environ[name] for name in TYPED if name in os.environ), "")
    names: dict[str, None] = {}
    with contextlib.suppress(ValueError):  # a quotation mark that is still open
        for word in shlex.split(line):
            with contextlib.suppress(DboError, OSError):
                address = parse_address(word)
                if os.path.isfile(address.path):
                    table = open_table(Request(address, ReadingOptions()))
                    names |= dict.fromkeys(
                        _typed(column.name or "") for column in table.columns
                    )
                    table.close()
    offered = []
    for name in names:
        if name and name.startswith(incomplete) and " " not in name:
            offered.append(name)
    return offered


def _typed(name: str) -> str:
    """Return what has to be typed for a column: ``Drive`` for ``Drive (V)``."""
    from dbo_cli.logs.columns import split_header

    return split_header(name)[0] if " " in name else name
