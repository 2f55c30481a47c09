"""Messages on stderr beside the data: notes, warnings, and how far a long run has come."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

from dbo_cli.errors import UsageError
from dbo_cli.logs.plain_text import cleaned, pattern
from dbo_cli.records import dataclass
from dbo_cli.remarks import Listener, Remarks

if TYPE_CHECKING:
    from dbo_cli.logs.request import Address

_PARAMETER = pattern(r"`([a-z]\w*)`")


def shell_line(text: str) -> str:
    """Return a message of the library as the shell shows it: one line, parameters spelled as options.

    Names out of files hold no command that a terminal would obey.
    """
    return _PARAMETER.sub(lambda found: "--" + found[1].rstrip("_").replace("_", "-"), cleaned(text))


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
        self.notes([*remarks.read, *remarks.notes, *(f"warning: {text}" for text in remarks.warnings)])

    def detail(self, text: str) -> None:
        """Print what was detected or assumed."""
        if self.verbose:
            self.note(text)


def refuse_terminal(output: Address) -> None:
    """Refuse to write a model onto a terminal, where nobody could read or keep it (UsageError)."""
    if output.is_stream and sys.stdout.isatty():
        raise UsageError("the model would be written onto the terminal: name a file (-o model.json)")


class Progress(Listener):
    """Prints how far a run has come: how a log was understood, then rows or seconds on a terminal.

    The number of rows of a stream is not known beforehand, so it counts instead of drawing a bar.
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
            self._ticking = threading.Thread(target=self._tick, args=(what, time.monotonic()), daemon=True)
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
