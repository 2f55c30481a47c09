"""The errors that users meet, each with the exit code of the process that shows it.

Every message is one line that names the place, what is wrong there, and what to do about it. It speaks
the library's words: a parameter stands in backticks, and the command line, when it shows it, spells it as
its option (``--skip-bad``).
"""

from __future__ import annotations


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
