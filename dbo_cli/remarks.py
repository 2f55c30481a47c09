"""What must be said of a run: returned as data, said by whoever called."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol


class DboWarning(UserWarning):
    """Something that may spoil the result; the text says what to do about it."""


class Listener(Protocol):
    """Hears how far a run has come."""

    def opened(self, what: str) -> None:
        """Learn how a log was understood."""

    def reading(self, what: str) -> None:
        """Learn what is being read of a stream that may never end."""

    def progressed(self, rows: int) -> None:
        """Learn that so many rows more are done."""

    def working(self, what: str) -> None:
        """Learn of something long that gives no rows, such as a fit."""

    def finished(self) -> None:
        """Learn that all rows are done, or the work."""


class _Silence:
    """Hears, and says nothing."""

    def opened(self, what: str) -> None:
        """Say nothing."""

    def reading(self, what: str) -> None:
        """Say nothing."""

    def progressed(self, rows: int) -> None:
        """Say nothing."""

    def working(self, what: str) -> None:
        """Say nothing."""

    def finished(self) -> None:
        """Say nothing."""


SILENT: Listener = _Silence()


def plain(text: str) -> str:
    """Return a message for readers outside the program: parameters without their backticks."""
    return text.replace("`", "")


@dataclass
class Remarks:
    """Lines in the library's words.

    ``read`` says what was read of which log, ``notes`` are good to know, ``warnings`` may spoil the result.
    """

    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    read: list[str] = field(default_factory=list)

    def note(self, texts: Iterable[str]) -> None:
        """Add notes."""
        self.notes.extend(texts)

    def add(self, other: Remarks) -> None:
        """Add all that another run had to say."""
        self.read.extend(other.read)
        self.notes.extend(other.notes)
        self.warnings.extend(other.warnings)

    def warn(self, text: str) -> None:
        """Add a warning."""
        self.warnings.append(text)
