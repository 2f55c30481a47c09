"""The messages of a run, returned as data; the caller prints them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field


class DboWarning(UserWarning):
    """Something that may spoil the result; the text says what to do about it."""


class Listener:
    """Is called while a run goes on; this one does nothing."""

    def opened(self, what: str) -> None:
        """Take how a log was understood."""

    def reading(self, what: str) -> None:
        """Take what is being read of a stream that may never end."""

    def progressed(self, rows: int) -> None:
        """Take the number of rows that were done since the last call."""

    def working(self, what: str) -> None:
        """Take the name of something long that gives no rows, such as a fit."""

    def finished(self) -> None:
        """Take note that all rows are done, or the work."""


SILENT = Listener()


def plain(text: str) -> str:
    """Return a message for readers outside the program: parameters without their backticks."""
    return text.replace("`", "")


@dataclass
class Remarks:
    """Messages that name parameters in backticks.

    ``read``: what was read of which log, ``notes`` are good to know, ``warnings`` may spoil the result.
    """

    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    read: list[str] = field(default_factory=list)

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
