"""What can go wrong, each kind with the exit code of the process that shows it.

Every message is one line: where (file, row or key), which value, and what to do. The
library raises these; the command line prints them in one place (``cli/app.py``). A
parameter of the library stands in backticks, and the command line shows it as its
option (`` `skip_bad` `` becomes ``--skip-bad``).
"""

import inspect
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType


class DboError(Exception):
    """An error that a user can understand and mend."""

    exit_code = 1


class UsageError(DboError):
    """The command line contradicts itself or asks for something that does not exist."""

    exit_code = 2


class InputError(DboError):
    """A log, trajectory or array cannot be read or does not hold what is needed."""


class ModelError(DboError):
    """A model is malformed, of the wrong direction, or cannot do what is asked of it."""


class FitError(DboError):
    """No trustworthy model can be identified from the given recordings."""


class OutputError(DboError):
    """An output cannot be written; what stood there before is left as it was."""


class LimitError(DboError):
    """Something lies outside a limit that was set, or the move cannot be driven."""

    exit_code = 3


def require_none(problems: Sequence[str]) -> None:
    """Refuse what has problems: the first of them, and how many more there are (LimitError)."""
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise LimitError(problems[0] + more)


class DboWarning(UserWarning):
    """Something that may spoil the result; the text says what to do about it."""


@contextmanager
def prefixed(name: str) -> Iterator[None]:
    """Put a name, if there is one, before the message of an error: of a file, or of a channel."""
    prefix = f"{name}: " if name else ""
    try:
        yield
    except DboError as problem:
        raise type(problem)(prefix + str(problem).removeprefix(prefix)) from problem


def warn(text: str) -> None:
    """Warn the user: the command line prints it, the library leaves it to ``warnings``.

    A warning points at the line that called this package.
    """
    level = 1
    frame = inspect.currentframe()
    while frame is not None and _is_ours(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, DboWarning, stacklevel=level)


def _is_ours(frame: FrameType) -> bool:
    """Return whether a line of this package runs in a frame."""
    module: str = frame.f_globals.get("__name__", "")
    return module.partition(".")[0] == __name__.partition(".")[0]


def require_positive(**figures: float | None) -> None:
    """Refuse numbers of options that are not above 0 and finite; None was not typed (UsageError)."""
    for name, value in figures.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f"`{name}` {value:g}: give a number above 0")
