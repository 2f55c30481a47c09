"""Where results come from: the program's version and what was read, without time of day or host name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NotRequired, TypedDict

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Given, parse_address
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.version import __version__


class InputRecord(TypedDict):
    """What a model says about one of its inputs; ``joined`` are the other files that columns came from."""

    name: str
    sha256: str
    rows: int
    joined: NotRequired[list[InputRecord]]


def program_version_string() -> str:
    """Name the program and its version: ``dbo 0.1.0``."""
    return f"dbo {__version__}"


def file_sha256(path: str) -> str:
    """Hash a file's bytes (hexadecimal SHA-256).

    Raises
    ------
    InputError
        It cannot be read.
    """
    import hashlib

    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(f"{path}: cannot be read: {problem.strerror or problem}") from None


def input_record(
    address: Given, rows: int, sha256: str | None = None, others: Sequence[Given] = ()
) -> InputRecord:
    """Record an input: its name without folders (they differ between machines), its digest and the rows used.

    ``sha256`` must be given for standard input, which cannot be read twice (``SignalLog.sha256``); ``others``
    are the addresses of further files of the same log.
    """
    parsed = parse_address(address)
    name = os.path.basename(parsed.path) + (f"::{parsed.group}" if parsed.group else "")
    record = InputRecord(name=cleaned(name), sha256=sha256 or file_sha256(parsed.path), rows=rows)
    if others:
        record["joined"] = [input_record(other, rows) for other in others]
    return record
