"""The folder of an export: it appears whole or not at all, and only ever replaces an export."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dbo_cli.errors import OutputError
from dbo_cli.files import check_outputs, unfinished

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
    text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
    target = Path(folder)
    try:
        if target.exists():
            _require_export(target, [*names, f"{figures['name']}_test"])
            check_outputs(*(str(target / name) for name in names))
        with (
            tempfile.TemporaryDirectory(dir=target.parent, prefix=".") as scratch,
            unfinished(scratch),
        ):
            fresh, old = Path(scratch, "made"), Path(scratch, "old")
            fresh.mkdir()
            for name, content in {**files, MANIFEST: text}.items():
                (fresh / name).write_text(content, encoding="utf-8", newline="\n")
            if target.exists():
                target.rename(old)
            try:
                fresh.rename(target)
            except BaseException:  # the older export stays
                if old.exists():
                    old.rename(target)
                raise
    except OSError as problem:
        reason = problem.strerror or problem
        raise OutputError(f"{folder}: cannot be written: {reason}") from None


def _require_export(target: Path, names: list[str]) -> None:
    """Refuse to replace a folder that holds more than ``names``, an export's and object files."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        manifest = json.loads((target / MANIFEST).read_text(encoding="utf-8"))
        if manifest["format"] == "dbo-export":
            names = [*names, *manifest["files"], f"{manifest['name']}_test"]
    for name in sorted(os.listdir(target)):
        if name not in names and not name.endswith(".o"):
            raise OutputError(
                f"{target}: holds '{name}', which is not of an export: choose another folder"
            )
