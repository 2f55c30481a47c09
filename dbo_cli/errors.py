"""What users are told: errors, each with the exit code of the process that shows it, warnings and notes.

Warnings and notes are returned as data; the caller prints them. Every message is one
line that names the place, what is wrong there, and what to do about it. It speaks the
library's words: a parameter stands in backticks, and the command line, when it shows
it, spells it as its option (``--skip-bad``).
"""

from __future__ import annotations

import re
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


def suffix_of(unit: str | None) -> str:
    """Return a unit behind a blank, as messages write it; nothing where there is none."""
    return f" {unit}" if unit else ""


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


# --- names, units and paths of any bytes as text that is safe to show ---

# C0 and C1 controls (among them the escape that begins a terminal's commands), the
# marks that turn the direction of writing round, and halves of surrogate pairs, which
# no encoding takes.
_UNSAFE = re.compile(
    "[\x00-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufeff]"
)


_SHOWN = 40  # characters of what a user or a file gave are enough for a message


def shortened(text: str) -> str:
    """Return what a user or a file gave as messages show it."""
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def counted(count: int, noun: str) -> str:
    """Return so many of something: ``1 cell``, ``3 cells``, ``-1 sample``."""
    return f"{count} {noun}{'' if abs(count) == 1 else 's'}"


def decoded(data: bytes) -> str:
    """Turn bytes of unknown origin into text: UTF-8, or else the Western code page of old instruments."""
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _unescaped(text: str) -> str:
    """Decode the bytes that Python or h5py could not, and handed on as lone surrogates."""
    try:
        return decoded(text.encode("utf-8", "surrogateescape"))
    except UnicodeEncodeError:  # surrogates that stand for no bytes
        return text


def cleaned(text: str) -> str:
    """Return text that any output takes and no terminal obeys, on one line.

    Bytes that were no UTF-8 (a file's name, an HDF5 attribute) are read as the Western
    code page; control characters become blanks, and runs of blanks one.
    """
    if text.isascii() and text.isprintable() and "  " not in text:
        return text.strip()
    return " ".join(_UNSAFE.sub(" ", _unescaped(text)).split())


def clean_text(value: object) -> str:
    """Turn what another program stored (a name, a unit, a remark) into text, in whatever encoding it is."""
    text = decoded(value) if isinstance(value, bytes) else str(value)
    return (text if text.isascii() else _unescaped(text)).rstrip("\0")


_PARAMETER = re.compile(r"`([a-z]\w*)`")


def as_options(text: str) -> str:
    """Return a message with its parameters spelled as the shell's options."""
    return _PARAMETER.sub(
        lambda match: "--" + match[1].rstrip("_").replace("_", "-"), text
    )
