"""What a command says on standard error: its lines, its warnings, and how far it has come.

Data alone goes to standard output. A command says at most three lines by default:
what was read, what came out, what to expect. Warnings follow.
"""

from __future__ import annotations

import re
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar, TypeVar

from dbo_cli.errors import DboWarning, warn

ERASE = "\r\x1b[K"
_PARAMETER = re.compile(r"`([a-z]\w*)`")
_CONTROL = re.compile(
    "[\x00-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufeff]+"
)
_FOLDER = re.compile(r"^.*?[/\\](?=[^/\\]*?(::|: ))")
WIDTH = 115  # characters of a default line, behind ``dbo: ``
_PAUSE = 0.2  # seconds between two updates of a progress line
_Block = TypeVar("_Block")


class Level:
    """How much a command prints, set once by its options; and the pending warnings."""

    quiet = False
    verbose = False
    debug = False
    warnings: ClassVar[list[str]] = []


def say(text: str) -> None:
    """Print a line that everybody needs, at most ``WIDTH`` characters of it without ``--verbose``.

    The folder of a file goes first, since the figures stand behind it.
    """
    if len(text) > WIDTH and not Level.verbose:
        text = _FOLDER.sub("…/", text)
    if len(text) > WIDTH and not Level.verbose:
        text = text[: WIDTH - 1] + "…"
    if not Level.quiet and text:
        print_line(text)


def say_output(output: str, text: str) -> None:
    """Print what is in an output."""
    say(f"{'stdout' if output == '-' else output}: {text}")


def say_logs(logs: Sequence[Any], rows: int, behind: str = "") -> None:
    """Print what was read: a line a log, of more than two one line for all."""
    lines = [log.line() + behind for log in logs]
    if len(lines) > 2:
        detail(*lines)
        lines = [f"{len(logs)} logs, {rows:,} rows{behind}"]
    for line in lines:
        say(line)
    for log in logs:
        detail(*log.remarks)


def say_log(log: Any) -> None:
    """Print what was read; warn of rows that were left out, cut or guessed."""
    for doubt in log.doubtful:
        warn(f"{log.name}: {doubt}")
    say_logs([log], 0)


def present(*values: Any) -> list[Any]:
    """Return the values that are not None."""
    return [value for value in values if value is not None]


def detail(*texts: str) -> None:
    """Print lines for ``--verbose`` alone."""
    if Level.verbose and not Level.quiet:
        for text in texts:
            print_line(text)


def print_line(text: str) -> None:
    """Print one line on standard error; a broken standard error changes nothing."""
    erase = ERASE if sys.stderr.isatty() else ""
    try:
        print(f"{erase}dbo: {shell_line(text)}", file=sys.stderr, flush=True)
    except OSError:
        pass


def shell_line(text: str) -> str:
    """Return a message as the shell shows it: one line, parameters as options, no control characters."""
    text = _CONTROL.sub(" ", text)
    return _PARAMETER.sub(
        lambda name: "--" + name[1].strip("_").replace("_", "-"), text
    )


def hear_warnings() -> None:
    """Keep each ``DboWarning`` for the end; what libraries warn programmers of stays unsaid."""
    Level.warnings.clear()
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", DboWarning)
    warnings.showwarning = _show  # type: ignore[assignment]


def _show(message: Any, category: Any, *_: Any) -> None:
    text = str(message)
    if issubclass(category, DboWarning) and text not in Level.warnings:
        Level.warnings.append(text)


def say_warnings() -> None:
    """Print the warnings, behind what the command said."""
    for text in Level.warnings:
        if not Level.quiet:
            print_line(f"warning: {text}")
    Level.warnings.clear()


def progress(blocks: Iterable[_Block], what: str) -> Iterator[_Block]:
    """Hand blocks on, and say on a terminal how many rows have passed.

    A block is anything with a length.
    """
    shown = sys.stderr.isatty() and not Level.quiet
    rows, last = 0, time.monotonic()
    for block in blocks:
        yield block
        rows += len(block)  # type: ignore[arg-type]
        if shown and time.monotonic() - last > _PAUSE:
            last = time.monotonic()
            print(
                f"{ERASE}dbo: {what} {rows:,} rows", end="", file=sys.stderr, flush=True
            )
    if shown:
        print(ERASE, end="", file=sys.stderr, flush=True)


def working(what: str) -> None:
    """Say on a terminal what takes a while; the next line takes its place."""
    if sys.stderr.isatty() and not Level.quiet:
        print(f"{ERASE}dbo: {what} ...", end="", file=sys.stderr, flush=True)
