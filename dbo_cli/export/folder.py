"""The folder of an export: it appears whole or not at all, and only ever replaces an export."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dbo_cli.errors import OutputError

MANIFEST = "export.json"
FORMAT = "dbo-export"


def check_folder(folder: str) -> None:
    """Refuse a folder that cannot be written, before the work.

    Raises
    ------
    OutputError
        It cannot be written, or there is something of that name that no export wrote.
    """
    target = Path(folder)
    if not target.parent.is_dir():
        raise OutputError(
            f"{folder}: there is no folder '{target.parent}': create it first"
        )
    if not os.access(target.parent, os.W_OK):
        raise OutputError(f"{folder}: the folder '{target.parent}' is not writable")
    if not os.path.lexists(target):
        return
    if not target.is_dir() or target.is_symlink():
        raise OutputError(f"{folder}: is no folder: choose another name")
    known = _written_by_export(target)
    for path in sorted(target.rglob("*")):
        name = path.relative_to(target).as_posix()
        if name not in known:
            raise OutputError(
                f"{folder}: holds '{name}', which no export wrote: it is not overwritten (move it, or choose"
                " another folder)"
            )


def _written_by_export(target: Path) -> set[str]:
    """Return the names of an export's files, and of what a compiler makes of them."""
    try:
        listed = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        if listed["format"] != FORMAT:
            return set()
        files = {str(name) for name in listed["files"]}
        test = f"{listed['name']}_test"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()
    objects = {f"{name.removesuffix('.c')}.o" for name in files if name.endswith(".c")}
    return files | objects | {test, MANIFEST}


def write_folder(
    folder: str, files: Mapping[str, str], figures: Mapping[str, Any]
) -> None:
    """Write files under a temporary name beside ``folder``, then rename; an old export makes way whole.

    Beside the files lie their ``figures``, for programs.

    Raises
    ------
    OutputError
        Writing failed; nothing new is left, and what stood there stays.
    """
    check_folder(folder)
    target = Path(folder)
    manifest = {
        "format": FORMAT, "version": 1, **figures, "files": [*sorted(files), MANIFEST]
    }  # fmt: skip
    text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
    mark = f"{os.getpid()}-{secrets.token_hex(4)}"
    partial = target.parent / f".{target.name[:100]}.{mark}.partial"
    old = target.parent / f".{target.name[:100]}.{mark}.old"
    try:
        partial.mkdir()
        for name, content in {**files, MANIFEST: text}.items():
            (partial / name).write_text(content, encoding="utf-8", newline="\n")
        _replace(partial, target, old)
    except OSError as problem:
        raise OutputError(
            f"{folder}: cannot be written: {problem.strerror or problem}"
        ) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _replace(partial: Path, target: Path, old: Path) -> None:
    """Put a folder in the place of another; where that fails the other one stays."""
    if target.exists():
        target.rename(old)
    try:
        partial.rename(target)
    except BaseException:
        if old.exists():
            old.rename(target)
        raise
