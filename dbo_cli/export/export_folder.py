"""The folder of an export appears whole or not at all, and only ever replaces an export."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path

from dbo_cli.errors import OutputError

MANIFEST = "export.json"
FORMAT = "dbo-export"


def check_folder(folder: str, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, before the work.

    Raises
    ------
    OutputError
        There is something of that name and ``overwrite`` is not given, or what is there is no export.
    """
    target = Path(folder)
    if not target.parent.is_dir():
        raise OutputError(f"{folder}: there is no folder '{target.parent}': create it first")
    if not os.access(target.parent, os.W_OK):
        raise OutputError(f"{folder}: the folder '{target.parent}' is not writable")
    if not os.path.lexists(target):
        return
    if not target.is_dir() or target.is_symlink():
        raise OutputError(f"{folder}: is no folder: choose another name")
    if not overwrite:
        raise OutputError(f"{folder}: the folder exists already (`overwrite` replaces an export)")
    strangers = _not_of_an_export(target)
    if strangers:
        raise OutputError(
            f"{folder}: holds '{strangers[0]}', which no export wrote: it is not overwritten"
            " (move it, or choose another folder)"
        )


def _not_of_an_export(target: Path) -> list[str]:
    """Return what stands in a folder beside the files of the export whose list lies there."""
    try:
        listed = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        known = set(listed["files"]) if listed["format"] == FORMAT else set()
        known |= {f"{listed['name']}_test", "example"} | {
            path.removesuffix(".c") + ".o" for path in known
        }  # make's
    except (OSError, ValueError, KeyError, TypeError):
        known = set()
    found = sorted(p.relative_to(target).as_posix() for p in target.rglob("*") if not p.is_dir())
    return [path for path in found if path not in known]


def write_folder(folder: str, files: Mapping[str, bytes], overwrite: bool) -> None:
    """Write files under a temporary name beside ``folder``, then rename; an old export makes way whole.

    Raises
    ------
    OutputError
        Writing failed; nothing new is left, and what stood there stays.
    """
    check_folder(folder, overwrite)
    target = Path(folder)
    mark = f"{os.getpid()}-{secrets.token_hex(4)}"
    partial = target.parent / f".{target.name[:100]}.{mark}.partial"
    old = target.parent / f".{target.name[:100]}.{mark}.old"
    try:
        for name, content in files.items():
            path = partial / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if target.exists():
            target.rename(old)
        try:
            partial.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    except OSError as problem:
        raise OutputError(f"{folder}: cannot be written: {problem.strerror or problem}") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
