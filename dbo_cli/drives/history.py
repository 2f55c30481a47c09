"""The history of a repeated move: the error of each pass, in a small JSON file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

from dbo_cli.errors import InputError
from dbo_cli.logs.whole_output import write_whole

FORMAT, VERSION = "dbo-history", 1


class PassRecord(NamedTuple):
    """A pass in a history: the digest of its drive, and the RMS of its error in the output's unit."""

    drive_sha256: str
    rmse: float


def read_history(path: str) -> list[PassRecord]:
    """Return the passes of a history, the oldest first; none where there is no file yet.

    Raises
    ------
    InputError
        The file cannot be read, or is no history.
    """
    if not os.path.exists(path):
        return []
    try:
        with open(path, encoding="utf-8") as file:
            content = json.load(file)
    except (OSError, ValueError) as problem:
        raise InputError(f"{path}: cannot be read as a history: {problem}") from None
    if not isinstance(content, dict) or (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise InputError(f'{path}: is no history ("format": "{FORMAT}", "version": {VERSION})')
    passes = content.get("passes")
    return [_record(path, one) for one in passes] if isinstance(passes, list) else []


def _record(path: str, one: Any) -> PassRecord:
    rmse = one.get("rmse") if isinstance(one, dict) else None
    if isinstance(rmse, bool) or not isinstance(rmse, int | float) or not 0.0 <= rmse < math.inf:
        raise InputError(f"{path}: a pass has no `rmse`, a number of at least 0")
    return PassRecord(str(one.get("drive_sha256", "")), float(rmse))


def write_history(path: str, passes: Sequence[PassRecord]) -> None:
    """Write a history, whole or not at all."""
    content = {"format": FORMAT, "version": VERSION, "passes": [one._asdict() for one in passes]}
    write_whole(path, (json.dumps(content, indent=2) + "\n").encode())
