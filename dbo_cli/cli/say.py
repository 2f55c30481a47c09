"""What a command says on standard error: its lines, and how far it has come.

Data alone goes to standard output. A command says at most three lines by default:
what was read, what came out, what to expect. Warnings follow (``cli/app.py``).
"""

import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

ERASE = "\r\x1b[K"
PARAMETER = re.compile(r"`([a-z]\w*)`")
UPDATE_SECONDS = 0.2  # seconds between two updates of a progress line
Counted = TypeVar("Counted")


class Level:
    """How much a command prints, set once by its options."""

    quiet = False
    verbose = False
    debug = False


def say(text: str) -> None:
    """Print a line that everybody needs."""
    if text and not Level.quiet:
        print_line(text)


def say_output(output: str, text: str) -> None:
    """Print what is in an output."""
    say(f"{'stdout' if output == '-' else output}: {text}")


def say_logs(logs: Sequence[Any], suffix: str = "") -> None:
    """Print what was read: a line a log, of more than two one line for all."""
    lines = [log.line() + suffix for log in logs]
    if len(lines) > 2:
        detail(*lines)
        rows = sum(log.row_count for log in logs)
        lines = [f"{len(logs)} logs, {rows:,} rows{suffix}"]
    for line in lines:
        say(line)
    for log in logs:
        detail(*log.remarks)


def say_log(log: Any) -> None:
    """Print what was read, and warn of rows that were left out, cut or guessed."""
    say_logs([log])
    log.warn_of_doubts()


def detail(*texts: str) -> None:
    """Print lines for ``--verbose`` alone."""
    if Level.verbose and not Level.quiet:
        for text in texts:
            print_line(text)


def with_options(text: str) -> str:
    """Return a text with the options of the shell in place of parameters in backticks."""
    return PARAMETER.sub(lambda name: "--" + name[1].strip("_").replace("_", "-"), text)


def print_line(text: str) -> None:
    """Print one line on standard error; a broken standard error changes nothing.

    Parameters in backticks become options, and no control character reaches a terminal.
    """
    text = "".join(sign if sign.isprintable() else " " for sign in text)
    text = with_options(text)
    erase = ERASE if sys.stderr.isatty() else ""
    try:
        print(f"{erase}dbo: {text}", file=sys.stderr, flush=True)
    except OSError:
        pass


def working(task: str) -> None:
    """Say on a terminal what takes a while; the next line takes its place."""
    if sys.stderr.isatty() and not Level.quiet:
        print(f"{ERASE}dbo: {task} ...", end="", file=sys.stderr, flush=True)


def progress(blocks: Iterable[Counted], task: str) -> Iterator[Counted]:
    """Hand blocks on, and say on a terminal how many rows have passed; a block has a length."""
    rows, last = 0, time.monotonic()
    for block in blocks:
        yield block
        rows += len(block)  # type: ignore[arg-type]
        if time.monotonic() - last > UPDATE_SECONDS:
            last = time.monotonic()
            working(f"{task} {rows:,} rows")
