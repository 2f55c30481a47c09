"""The entry of the program: commands by name, an exception as one line and an exit code."""

from __future__ import annotations

import difflib
import importlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from dbo_cli.cli.options import OUTPUT, speaks
from dbo_cli.cli.say import Level, hear_warnings, print_line, say_warnings
from dbo_cli.errors import DboError

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

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, and the options under their headings."""
        write_options(self, ctx, formatter)


def write_options(command: Any, ctx: Any, formatter: Any) -> None:
    """Write arguments and options, each under its heading, those of the output last."""
    groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is None:
            continue  # hidden
        panel = getattr(parameter, "rich_help_panel", None) or "Options"
        if parameter.param_type_name == "argument":
            panel, record = "Arguments", (str(parameter.metavar), parameter.help or "")
        elif "--help" in parameter.opts:
            panel, record = (OUTPUT if OUTPUT in groups else "Options"), HELP
        groups.setdefault(panel, []).append(record)
    groups[OUTPUT] = groups.pop(OUTPUT, [])
    for heading, records in groups.items():
        if records:
            with formatter.section(heading):
                formatter.write_dl(records, col_max=30)


class Commands(TyperGroup):
    """The group behind ``dbo``: a command's module is imported when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of a working day, then those of other packages."""
        return [*COMMANDS, *sorted(_foreign())]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of a name, or None."""
        if cmd_name in COMMANDS:
            module = importlib.import_module(f"dbo_cli.cli.{cmd_name}")
            return _built(cmd_name, getattr(module, cmd_name))
        foreign = _foreign().get(cmd_name)
        return None if foreign is None else _built(cmd_name, foreign.load())

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the first word names."""
        word = args[0]
        if word not in COMMANDS and not word.startswith("-"):
            names = self.list_commands(ctx)
            near = difflib.get_close_matches(word, names, 1)
            if word not in names:
                hint = f"did you mean {near[0]}?" if near else f"try {', '.join(names)}"
                ctx.fail(f"no such command: {word}; {hint}")
        return super().resolve_command(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options, and each command with the first line of its documentation."""
        write_options(self, ctx, formatter)
        rows = []
        for name in self.list_commands(ctx):
            rows.append((name, self.get_command(ctx, name).get_short_help_str(100)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _foreign() -> dict[str, Any]:
    """Return the commands of other packages: entry points of ``dbo_cli.commands``."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group="dbo_cli.commands")}


def _built(name: str, function: Callable[..., None]) -> Any:
    """Make a typer command of a function."""
    app = _typer()
    app.command(name, cls=Command)(speaks(function))
    command = typer.main.get_command(app)
    if "--help-all" in sys.argv:
        for parameter in command.params:
            parameter.hidden = False  # type: ignore[attr-defined]
    return command


def _typer(completion: bool = False, **settings: Any) -> typer.Typer:
    """Return a typer application that speaks plain text."""
    return typer.Typer(
        add_completion=completion,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={
            "help_option_names": ["-h", "--help", "--help-all"],
            "max_content_width": 100,
        },
        **settings,
    )


def _root(
    ctx: typer.Context,
    version: bool = typer.Option(False, "--version", help="Print the version."),
) -> None:
    """Identify, invert and compensate the hysteresis of piezo actuators."""
    if version:
        from dbo_cli.version import __version__

        print(f"dbo {__version__}")
    elif ctx.invoked_subcommand is None:
        print(ctx.get_help())


def program() -> Any:
    """Return the group ``dbo``, ready to parse a command line."""
    app = _typer(completion=True, cls=Commands, invoke_without_command=True)
    app.callback(invoke_without_command=True)(_root)
    return typer.main.get_command(app)


def main(words: Sequence[str]) -> int:
    """Run one command line and return its exit code."""
    hear_warnings()
    try:
        _run(list(words))
        say_warnings()
        sys.stdout.flush()
        return 0
    except typer.Exit as leaving:
        return int(leaving.exit_code)
    except BrokenPipeError:
        _abandon_stdout()
        return 0
    except KeyboardInterrupt:
        print_line("interrupted")
        return INTERRUPTED
    except SystemExit:
        raise
    except BaseException as problem:  # a panic of polars is no Exception
        if Level.debug:
            import traceback

            traceback.print_exc()
        say_warnings()
        text, code = _explained(problem, words)
        print_line(f"error: {text}")
        return code


def _run(words: list[str]) -> None:
    """Parse a command line and run the command it names; every exception comes through."""
    root = program()
    if "_DBO_COMPLETE" in os.environ:
        root.main(words, prog_name="dbo")
    with root.make_context("dbo", words) as context:
        root.invoke(context)


def _explained(problem: BaseException, words: Sequence[str]) -> tuple[str, int]:
    """Return what went wrong in one line, and the exit code that belongs to it."""
    if isinstance(problem, DboError):
        return str(problem), problem.exit_code
    if hasattr(problem, "format_message"):  # the command line, refused by typer
        command = words[0] if words and words[0] in COMMANDS else ""
        listing = f"dbo {command} --help-all" if command else "dbo --help"
        return f"{_refused(problem)} ({listing})", WRONG_COMMAND_LINE
    if isinstance(problem, OSError):
        place = f"{problem.filename}: " if problem.filename else ""
        return f"{place}{problem.strerror or problem}", 1
    if isinstance(problem, MemoryError):
        return "out of memory: take a part of the log with `rows` A:B", 1
    kind = type(problem).__name__
    return f"internal error: {kind}: {problem} (please report it with `debug`)", 1


def _refused(problem: Any) -> str:
    """Return why typer refused the command line, with the option that is most like an unknown one."""
    if hasattr(problem, "possibilities"):
        unknown = problem.option_name
        near = difflib.get_close_matches(unknown, problem.possibilities or [], 1, 0.7)
        hint = f"; did you mean {near[0]}?" if near else ""
        return f"no such option: {unknown}{hint}"
    text: str = problem.format_message()
    for words in ("Invalid value for ", "Value error, ", "Input "):
        text = text.replace(words, "")
    text = text.partition(", unable to parse")[0].rstrip(".")
    return text[:1].lower() + text[1:]


# --- what belongs to the process ---


def run() -> None:
    """Serve the console script: ``main`` as a process."""
    # Many small factorisations: threads only wait for each other there, and one thread
    # gives the same bytes on every machine of a kind.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code = main(sys.argv[1:])
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        pass  # main() has said what there was to say
    os._exit(code)  # taking the interpreter apart takes a tenth of a second


def _end(number: int, frame: FrameType | None) -> None:
    """Unwind the stack, so that nothing half written is left."""
    raise SystemExit(128 + number)


def _abandon_stdout() -> None:
    """Point stdout at nothing, so that the last flush does not complain about the closed pipe."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass
