"""Arrays of NumPy: records, a matrix whose columns have numbers, or an archive of arrays by name."""

from __future__ import annotations

import zipfile

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.formats.excel import open_workbook
from dbo_cli.logs.formats.stored import FileFormat, StoredTable, fenced, refuse_part
from dbo_cli.logs.table import Reading, Table


def _read_array(path: str, inner: str, reading: Reading) -> Table:
    """Read an array, mapped into memory (InputError)."""
    refuse_part(path, inner)
    with fenced(path, "NumPy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    table = StoredTable(path)
    table.add_arrays({"": array})
    return table.require_numbers([f"{array.dtype} {array.shape}"])


def _read_archive(path: str, inner: str, reading: Reading) -> Table:
    """Read the arrays of an archive, or the sheet of a workbook, which is a zip archive, too (InputError)."""
    with fenced(path, "a zip archive"), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.startswith("xl/") or name == "content.xml" for name in names):
        return open_workbook(path, inner, reading)
    if not any(name.endswith(".npy") for name in names):
        raise InputError(f"{path}: this is a zip archive: unpack it")
    refuse_part(path, inner)
    table = StoredTable(path)
    with fenced(path, "NumPy"), np.load(path, allow_pickle=False) as stored:
        table.add_arrays(stored)
        return table.require_numbers(names)


NUMPY = FileFormat((b"\x93NUMPY",), _read_array)
ZIP = FileFormat((b"PK\x03\x04",), _read_archive)
