"""Zip archives: arrays of NumPy, or a workbook."""

from __future__ import annotations

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.formats.excel import open_workbook
from dbo_cli.logs.formats.stored import FileFormat, arrays_as_table, fenced, refuse_part
from dbo_cli.logs.table import Reading, Table


def _read(path: str, inner: str, reading: Reading) -> Table:
    """Read the arrays of an archive, or the sheet of a workbook (InputError)."""
    import zipfile

    with fenced(path, "a zip archive"), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.startswith("xl/") or name == "content.xml" for name in names):
        return open_workbook(path, inner, reading)
    if not any(name.endswith(".npy") for name in names):
        raise InputError(f"{path}: this is a zip archive: unpack it")
    refuse_part(path, inner)
    with fenced(path, "NumPy"), np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return arrays_as_table(path, arrays)


ZIP = FileFormat("zip", (b"PK\x03\x04",), (), _read)
