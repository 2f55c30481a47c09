"""What users are told: errors, each with the exit code of the process that shows it, warnings and notes.

Warnings and notes are returned as data; the caller prints them. Every message is one
line that names the place, what is wrong there, and what to do about it. It speaks the
library's words: a parameter stands in backticks, and the command line, when it shows
it, spells it as its option (``--skip-bad``).
"""

from __future__ import annotations

from collections.abc import Iterable


class DboError(Exception):
    """An error that is told in one line and ends the process with ``exit_code``."""

    exit_code = 1


class UsageError(DboError):
    """The command line contradicts itself or asks for something that does not exist."""

    exit_code = 2


class InputError(DboError):
    """A log, trajectory or other input cannot be read or does not hold what is needed."""


class ModelError(DboError):
    """A model is malformed, of the wrong direction, or cannot do what is asked of it."""


class FitError(DboError):
    """No trustworthy model can be identified from the given recordings."""


class OutputError(DboError):
    """An output cannot be written; what stood there before is left as it was."""


class LimitError(DboError):
    """The result was computed, but lies outside a limit that the user set."""

    exit_code = 3


class DboWarning(UserWarning):
    """Something that may spoil the result; the text says what to do about it."""


class Listener:
    """Is called while a run goes on; this one does nothing."""

    def opened(self, what: str) -> None:
        """Take how a log was understood."""

    def reading(self, what: str) -> None:
        """Take what is being read of a stream that may never end."""

    def progressed(self, rows: int, verb: str) -> None:
        """Take the number of rows that were ``read``, ``written``, ... since the last call."""

    def working(self, what: str) -> None:
        """Take the name of something long that gives no rows, such as a fit."""

    def finished(self) -> None:
        """Take note that all rows are done, or the work."""


SILENT = Listener()


def plain(text: str) -> str:
    """Return a message for readers outside the program: parameters without their backticks."""
    return text.replace("`", "")


class Remarks:
    """Messages that name parameters in backticks.

    ``read``: what was read of which log, ``notes`` are good to know, ``warnings`` may
    spoil the result.
    """

    def __init__(
        self,
        notes: Iterable[str] = (),
        warnings: Iterable[str] = (),
        read: Iterable[str] = (),
    ) -> None:
        self.notes, self.warnings, self.read = list(notes), list(warnings), list(read)

    def note(self, texts: Iterable[str]) -> None:
        """Add notes."""
        self.notes.extend(texts)

    def add(self, other: Remarks) -> None:
        """Add the messages of another run."""
        self.read.extend(other.read)
        self.notes.extend(other.notes)
        self.warnings.extend(other.warnings)

    def warn(self, text: str) -> None:
        """Add a warning."""
        self.warnings.append(text)
