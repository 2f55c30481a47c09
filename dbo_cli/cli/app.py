"""The entry of the program: commands by name, an exception as one line and an exit code."""

import importlib
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from dbo_cli.cli.options import OUTPUT, with_shared_options
from dbo_cli.cli.say import Level, print_line
from dbo_cli.errors import DboError, DboWarning
from dbo_cli.files import command, end_by_signal, missing_outputs

INTERRUPTED = 130  # 128 and the number of SIGINT, as shells report it
WRONG_COMMAND_LINE = 2

COMMANDS = tuple(
    "excite identify show invert simulate compensate check report export compare "
    "trajectory waveform".split()
)
"""In the order of a working day; each is a function of that name in a module of that name."""
HELP = ("-h, --help, --help-all", "This page; --help-all lists every option.")


class Command(TyperCommand):
    """A command whose ``-h`` is one screen, grouped; ``--help-all`` shows every option."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, unless a word is empty: a script's variable that was not set."""
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if value == "" or (isinstance(value, list | tuple) and "" in value):
                ctx.fail(
                    f"{parameter.opts[-1]} is empty: give a value, or leave it out"
                )
        return super().invoke(ctx)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, and the options under their headings, those of the output last."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        parameters: list[Any] = list(self.params)
        for parameter in parameters:
            if "--help-all" in sys.argv:
                parameter.hidden = False
            record = parameter.get_help_record(ctx)
            panel = getattr(parameter, "rich_help_panel", None) or "Options"
            if parameter.param_type_name == "argument":
                panel, record = "Arguments", (parameter.metavar, parameter.help)
            if record is not None:
                groups.setdefault(panel, []).append(record)
        groups[OUTPUT] = [*groups.pop(OUTPUT, []), HELP]
        for heading, records in groups.items():
            if records:
                with formatter.section(heading):
                    formatter.write_dl(records, col_max=30)


class Commands(TyperGroup):
    """The group behind ``dbo``: a command's module is imported when it is asked for."""

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """Return the names of the help in one order: click keeps them in a set."""
        return list(ctx.help_option_names)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of a working day, then those of other packages."""
        return [*COMMANDS, *sorted(_foreign())]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of a name, or None."""
        if cmd_name in COMMANDS:
            module = importlib.import_module(f"dbo_cli.cli.{cmd_name}")
            function = getattr(module, cmd_name)
        elif cmd_name in _foreign():
            function = _foreign()[cmd_name].load()
        else:
            return None
        app = _typer()
        app.command(cmd_name, cls=Command)(with_shared_options(function))
        return typer.main.get_command(app)


def _foreign() -> dict[str, Any]:
    """Return the commands of other packages: entry points of ``dbo_cli.commands``."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group="dbo_cli.commands")}


def _typer() -> typer.Typer:
    """Return a typer application that speaks plain text."""
    return typer.Typer(
        add_completion=False,
        rich_markup_mode=None,
        context_settings={
            "help_option_names": ["-h", "--help", "--help-all"],
            "max_content_width": 100,
        },
    )


def _root(
    ctx: typer.Context,
    version: bool = typer.Option(False, "--version", help="Print the version."),
) -> None:
    """Identify, invert and compensate the hysteresis of piezo actuators.

    The commands stand in the order of a working day; dbo COMMAND -h explains one.

    Exit codes: 0 done; 1 input, model or fit failed; 2 wrong command line; 3 outside a limit, or the
    move cannot be driven; 130 interrupted.
    """
    if version:
        from dbo_cli.version import __version__

        print(f"dbo {__version__}")
    elif ctx.invoked_subcommand is None:
        print(ctx.get_help())


def program() -> Any:
    """Return the group ``dbo``, ready to parse a command line."""
    app = _typer()
    app.callback(cls=Commands, invoke_without_command=True)(_root)
    group: Any = typer.main.get_command(app)
    group.commands = dict.fromkeys(COMMANDS)  # typer names those that are meant
    return group


def main(words: Sequence[str]) -> int:
    """Run one command line, print what it warns of and why it failed, and return its exit code."""
    with command(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")  # libraries warn programmers
        warnings.simplefilter("always", DboWarning)
        code, failure = _outcome(list(words))
    if not Level.quiet:
        for text in dict.fromkeys(str(entry.message) for entry in caught):
            print_line(f"warning: {text}")
    if failure:
        print_line(failure)
    return code


def _outcome(words: list[str]) -> tuple[int, str]:
    """Run one command line; return its exit code, and the line that says why it failed."""
    try:
        root = program()
        with root.make_context("dbo", words) as context:
            root.invoke(context)
        sys.stdout.flush()
    except typer.Exit as leaving:
        return int(leaving.exit_code), ""
    except KeyboardInterrupt:
        return INTERRUPTED, "interrupted"
    except SystemExit:
        raise
    except BaseException as problem:  # a panic of polars is no Exception
        code, text = _explained(problem, words)
        if Level.debug and code:
            traceback.print_exc()
        return code, f"error: {text}" if code else ""
    return 0, ""


def _explained(problem: BaseException, words: Sequence[str]) -> tuple[int, str]:
    """Return the exit code that belongs to an exception, and the exception in one line."""
    if isinstance(problem, DboError):
        return problem.exit_code, str(problem)
    if isinstance(problem, BrokenPipeError):  # the reader has had enough
        missing = ", ".join(missing_outputs())
        text = f"standard output: its reader has left: {missing} is not written"
        return int(missing != ""), text
    if hasattr(problem, "format_message"):  # the command line, refused by typer
        command = (
            f"{words[0]} --help-all" if words and words[0] in COMMANDS else "--help"
        )
        text = problem.format_message().rstrip(".")
        return WRONG_COMMAND_LINE, f"{text[:1].lower()}{text[1:]} (dbo {command})"
    if isinstance(problem, OSError):
        filename = f"{problem.filename}: " if problem.filename else ""
        return 1, f"{filename}{problem.strerror or problem}"
    if isinstance(problem, MemoryError):
        return 1, "out of memory: take a part of the log with `rows` A:B"
    kind = type(problem).__name__
    return 1, f"internal error: {kind}: {problem} (please report it with `debug`)"


# --- what belongs to the process ---


def run() -> None:
    """Serve the console script: ``main`` as a process."""
    # Many small factorisations: threads only wait for each other there, and one thread
    # gives the same bytes on every machine of a kind.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    os.environ["MPLBACKEND"] = (
        "Agg"  # figures go to files, whatever a notebook asks for
    )
    _open_closed_streams()
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, end_by_signal)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, end_by_signal)
    code = main(sys.argv[1:])
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        pass  # main() has said what there was to say
    os._exit(code)  # taking the interpreter apart takes a tenth of a second


def _open_closed_streams() -> None:
    """Give standard streams that a shell has closed a null device, so that no output takes their place.

    Nothing can be read from it, and writing data to it fails.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            mode = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            descriptor = os.open(os.devnull, mode)
            if descriptor != number:
                os.dup2(descriptor, number)
            stream = open(number, "r" if name == "stdin" else "w", closefd=False)
            setattr(sys, name, stream)
