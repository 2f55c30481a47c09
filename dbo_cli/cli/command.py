"""What a command is: a function and its options; and how it hears its values and prints its messages.

Commands of the core (``commands``) and of extras are made of these.
"""

from __future__ import annotations

import inspect
import re
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from dbo_cli.cli import options
from dbo_cli.cli.options import Option
from dbo_cli.errors import Listener, Remarks, UsageError
from dbo_cli.logs.plain_text import as_options, cleaned

if TYPE_CHECKING:
    from dbo_cli.logs.request import Address, ReadingOptions
    from dbo_cli.runs.files import Destination
    from dbo_cli.runs.jobs import Outcome, Work

EXIT_CODES = (
    ("0", "Done; also when the reader of a pipe leaves early."),
    (
        "1",
        "The input, the model or the fit failed; one line on standard error says what to do.",
    ),
    ("2", "The command line is wrong."),
    ("130", "Interrupted."),
)


def shell_line(text: str) -> str:
    """Return a message of the library as the shell shows it: one line, parameters spelled as options.

    Names out of files hold no command that a terminal would obey.
    """
    return as_options(cleaned(text))


@dataclass(frozen=True)
class Reporter:
    """Prints messages on stderr: with ``quiet`` none but errors, with ``verbose`` details, too."""

    quiet: bool = False
    verbose: bool = False

    def note(self, text: str) -> None:
        """Print what is good to know."""
        if not self.quiet:
            print("dbo: " + shell_line(text), file=sys.stderr, flush=True)

    def notes(self, texts: Iterable[str]) -> None:
        """Print notes, one line each."""
        for text in texts:
            self.note(text)

    def remarks(self, remarks: Remarks) -> None:
        """Print the remarks of a run, first what was read."""
        self.notes(
            [
                *remarks.read,
                *remarks.notes,
                *(f"warning: {text}" for text in remarks.warnings),
            ]
        )

    def detail(self, text: str) -> None:
        """Print what was detected or assumed."""
        if self.verbose:
            self.note(text)


def refuse_terminal(output: Address) -> None:
    """Refuse to write a model onto a terminal, where nobody could read or keep it (UsageError)."""
    if output.is_stream and sys.stdout.isatty():
        raise UsageError(
            "the model would be written onto the terminal: name a file (-o model.json)"
        )


class Progress(Listener):
    """Prints how far a run has come: how a log was understood, then rows or seconds on a terminal.

    The number of rows of a stream is not known beforehand, so it counts instead of
    drawing a bar.
    """

    PATIENCE = 1.0  # s before the first message, and between two
    ERASE = "\r\x1b[K"

    def __init__(self, reporter: Reporter, verb: str) -> None:
        self.reporter = reporter
        self.active = not reporter.quiet and sys.stderr.isatty()
        self.verb = verb
        self.rows = 0
        self.last = time.monotonic()
        self.shown = False
        self._done = threading.Event()
        self._ticking: threading.Thread | None = None

    def opened(self, what: str) -> None:
        """Print how a log was understood."""
        self.reporter.detail(what)

    def reading(self, what: str) -> None:
        """Print what is being read."""
        self.reporter.note(what)

    def progressed(self, rows: int) -> None:
        """Count the rows of one more block."""
        self.rows += rows
        if self.active and time.monotonic() - self.last > self.PATIENCE:
            self.last = time.monotonic()
            self._show(f"{self.rows:,} rows {self.verb}")

    def working(self, what: str) -> None:
        """Count the seconds of something that gives no rows, until it is finished."""
        if self.active:
            self._done.clear()
            self._ticking = threading.Thread(
                target=self._tick, args=(what, time.monotonic()), daemon=True
            )
            self._ticking.start()

    def _tick(self, what: str, begin: float) -> None:
        while not self._done.wait(self.PATIENCE):
            self._show(f"{what}, {time.monotonic() - begin:.0f} s")

    def _show(self, text: str) -> None:
        self.shown = True
        print(f"{self.ERASE}dbo: {text}", end="", file=sys.stderr, flush=True)

    def finished(self) -> None:
        """Erase the line, so that the next message starts at the margin."""
        if self._ticking is not None:
            self._done.set()
            self._ticking.join()
            self._ticking = None
        if self.shown:
            print(self.ERASE, end="", file=sys.stderr, flush=True)
            self.shown = False


class Given(SimpleNamespace):
    """The values of a command's options, each under its ``key``.

    ``typed`` is the whole command line. ``brought`` has the values of options that
    extras bring to a command of the core, by key; those that were not typed are not in
    it.
    """

    def of(self, options: Iterable[Option]) -> dict[str, Any]:
        """Return the values of some options by their keys, as keywords of a call."""
        return {option.key: getattr(self, option.key) for option in options}

    @property
    def reporter(self) -> Reporter:
        """What prints messages, as loudly as asked for (``app.main`` sees to ``--debug``)."""
        return Reporter(self.quiet, self.verbose)

    @property
    def reading(self) -> ReadingOptions:
        """How logs are to be read; what was not given stays at its default."""
        from dbo_cli.logs.request import ReadingOptions

        values = self.of(
            options.READING_OF_LOGS if hasattr(self, "log_format") else options.READING
        )
        known = {
            name.removeprefix("log_"): value
            for name, value in values.items()
            if value is not None
        }
        return ReadingOptions(**known)


class Command(NamedTuple):
    """A command: its function, whose docstring is its help, and its options in the order of the help.

    ``brought``: the options that extras bring to a command of the core; they come last.
    """

    function: Callable[[Given], None]
    options: tuple[Option, ...]
    brought: tuple[Option, ...] = ()

    def section(self, heading: str = "") -> str:
        """Return what the docstring has under a heading; what it begins with under none."""
        parts = re.split(
            r"(?m)^(\w.*)\n-+\n", inspect.cleandoc(self.function.__doc__ or "")
        )
        return (
            dict(zip(["", *parts[1::2]], parts[::2], strict=True))
            .get(heading, "")
            .strip()
        )

    @property
    def summary(self) -> str:
        """The first line of the help."""
        return self.section().partition("\n")[0]

    @property
    def writes(self) -> str:
        """What the command writes."""
        return " ".join(self.section("Writes").split())

    @property
    def usual(self) -> list[str]:
        """The options that most need; where the docstring names none, those of the command alone."""
        named = self.section("Usual options").split()
        if named:
            return named
        return [
            option.names[-1]
            for option in self.options
            if option.names and option.heading == options.OPTIONS
        ]

    @property
    def examples(self) -> list[tuple[str, str]]:
        """What each example is for, and its command line."""
        examples: list[tuple[str, str]] = []
        for line in self.section("Examples").splitlines():
            if line.startswith(" "):
                purpose, command_line = examples.pop()
                examples.append((purpose, f"{command_line} {line.strip()}".lstrip()))
            else:
                examples.append((line, ""))
        return examples

    @property
    def exit_codes(self) -> list[tuple[str, str]]:
        """The exit codes and what they mean."""
        missed = " ".join(self.section("Exit code 3").split())
        return sorted(
            [*EXIT_CODES, *([("3", missed)] if missed else [])],
            key=lambda code: int(code[0]),
        )


def destination_of(arguments: Given, inputs: list[Any]) -> Destination:
    """Return where a command writes, as far as it has options for it, and the inputs to be protected."""
    from dbo_cli.runs.files import Destination

    values = vars(arguments)
    return Destination(
        output=arguments.output,
        save_state=values.get("save_state"),
        protect=inputs,
        live=values.get("flush", False),
        command=shlex.join(["dbo", *arguments.typed]),
        summary=arguments.summary,
        commented=values.get("header") == "comment",
    )


def work_of(arguments: Given) -> Work:
    """Return how many runs are to be worked through."""
    from dbo_cli.runs.jobs import Work

    return Work(arguments.jobs, arguments.keep_going)


def finish(arguments: Given, outcome: Outcome) -> None:
    """Print what is to be said of many runs, and end with their error, if there is one."""
    arguments.reporter.remarks(outcome.remarks)
    arguments.reporter.notes(outcome.last)
    if outcome.failure is not None:
        raise outcome.failure
