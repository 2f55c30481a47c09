"""What a shell offers for the word that is typed: the words of a choice, or columns of the logs before it."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
from collections.abc import Callable

from dbo_cli.cli.options import COLUMN, Option
from dbo_cli.errors import DboError

ASKED = "_DBO_COMPLETE"
"""The environment variable by which a shell asks for completions, as the library's scripts set it."""

TYPED = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
"""Where those scripts put the words typed so far: bash, and zsh and fish."""


def offers(option: Option) -> Callable[[str], list[str]] | None:
    """Return what finds the words to offer, from the beginning of one; None where files are offered."""
    value = option.metavar or ""
    if value == COLUMN:
        return columns_beginning
    words = value.split("|") if "|" in value else getattr(option.parse, "choices", ())
    return (lambda incomplete: [word for word in words if word.startswith(incomplete)]) if words else None


def without_help() -> None:
    """Take ``help`` out of the words typed: ``dbo help COMMAND`` is completed as ``dbo COMMAND`` is."""
    for name in TYPED:
        line, taken = re.subn(r"^(\s*\S+\s+)help\s+", r"\1", os.environ.get(name, ""))
        if taken:
            os.environ[name] = line
            os.environ["COMP_CWORD"] = str(int(os.environ.get("COMP_CWORD", "1")) - 1)


def columns_beginning(incomplete: str) -> list[str]:
    """Return the columns, of the logs in the words typed, whose names begin so.

    Of a name with a blank only what stands before the unit is offered, and nothing where that has one too:
    the shells do not agree on how to quote it.
    """
    from dbo_cli.logs.addresses import parse_address
    from dbo_cli.logs.byte_source import Request
    from dbo_cli.logs.reading_options import ReadingOptions
    from dbo_cli.logs.tables import open_table

    line = next((os.environ[name] for name in TYPED if name in os.environ), "")
    found: dict[str, None] = {}
    with contextlib.suppress(ValueError):  # a quotation mark that is still open
        for word in shlex.split(line):
            with contextlib.suppress(DboError, OSError):
                address = parse_address(word)
                if os.path.isfile(address.path):
                    table = open_table(Request(address, ReadingOptions()))
                    found |= dict.fromkeys(_typed(column.name or "") for column in table.columns)
                    table.close()
    return [name for name in found if name.startswith(incomplete) and name and " " not in name]


def _typed(name: str) -> str:
    """Return what has to be typed for a column: ``Drive`` for ``Drive (V)``."""
    from dbo_cli.logs.columns import split_header

    return split_header(name)[0] if " " in name else name
