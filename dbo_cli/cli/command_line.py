"""Command lines of the usual form, read without the command-line library, which takes a fifth of the start.

Whatever is not usual (help, completion, anything wrong or written in another way) is left to the library.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

from dbo_cli.cli.commands import COMMANDS, Given
from dbo_cli.cli.options import ASKED, REQUIRED, Option
from dbo_cli.errors import DboError


def run(words: Sequence[str]) -> bool:
    """Run the command that a usual line names; tell whether it was one."""
    if ASKED in os.environ or not words or words[0] not in COMMANDS:
        return False
    command = COMMANDS[words[0]]
    values = read(words[1:], command.options)
    if values is not None:
        command.function(Given(typed=tuple(words), **values))
    return values is not None


def read(words: Sequence[str], declared: Sequence[Option]) -> dict[str, Any] | None:
    """Return the value of each option by its key; None where the library has to look at the line."""
    given = _texts(iter(words), {name: option for option in declared for name in option.names})
    if given is None:
        return None
    loose, values = given.pop("", []), {}
    for option in declared:
        if option.names:
            texts = given.get(option.key, [])
        else:  # an argument; one that may be repeated is the last
            count = len(loose) if option.repeated else 1
            texts, loose = loose[:count], loose[count:]
        if texts:
            found = texts if option.repeated else texts[-1]
        elif option.default is REQUIRED or not option.names:
            return None
        else:
            found = False if option.metavar is None else option.default
        try:
            values[option.key] = option.value(found)
        except DboError:
            return None
    return None if loose else values


def _texts(words: Iterator[str], known: dict[str, Option]) -> dict[str, list[Any]] | None:
    """Return the texts of the options that are there by their keys, those of arguments by no key."""
    given: dict[str, list[Any]] = {}
    for word in words:
        name, joined, text = word.partition("=") if word.startswith("--") else (word, "", "")
        option = known.get(name)
        if option is None:
            if word.startswith("-") and word != "-":
                return None
            given.setdefault("", []).append(word)
        elif option.metavar is None and not joined:
            given[option.key] = [True]
        else:
            value = text if joined else next(words, None)
            if option.metavar is None or value is None:
                return None
            given.setdefault(option.key, []).append(value)
    return given
