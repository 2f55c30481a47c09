"""The folder of an export: its files appear together or not at all, and only ever replace an export."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dbo_cli.errors import OutputError
from dbo_cli.files import telling, write_all
from dbo_cli.reports.words import json_text

MANIFEST = "export.json"


def write_folder(
    folder: str, files: Mapping[str, str], figures: Mapping[str, Any]
) -> None:
    """Write files, and their ``figures`` as export.json, into a folder; an older export is replaced.

    Raises
    ------
    OutputError
        Writing failed, or the folder holds something else; what stood there stays.
    """
    names = [*sorted(files), MANIFEST]
    manifest = {"format": "dbo-export", "version": 1, **figures, "files": names}
    target, older = Path(folder), set()
    if target.is_dir():
        older = _files_of_export(target)
    contents = {**files, MANIFEST: json_text(manifest)}
    write_all(folder, {name: data.encode() for name, data in contents.items()})
    with telling(folder):
        for name in older - set(names):
            (target / name).unlink()


def _files_of_export(target: Path) -> set[str]:
    """Return what is in the folder of an older export; refuse what is neither its nor built from it."""
    names: set[str] = set()
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        manifest = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        if manifest["format"] == "dbo-export":
            names = {*manifest["files"], f"{manifest['name']}_test"}
    present = set(os.listdir(target))
    for name in sorted(present - names):
        if not name.endswith(".o"):
            raise OutputError(
                f"{target}: holds '{name}', which is not of an export: choose another folder"
            )
    return present
