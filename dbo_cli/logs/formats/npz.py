"""Zip archives: of NumPy's arrays by name, and workbooks."""

import zipfile

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.fence import fenced, refuse_part
from dbo_cli.logs.formats.excel import read_excel
from dbo_cli.logs.formats.npy import table_of_arrays
from dbo_cli.logs.table import Reading, Table


def read_npz(path: str, inner: str, reading: Reading) -> Table:
    """Read the arrays of an archive, or the sheet of a workbook (InputError)."""
    with fenced(path, "a zip archive"), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.startswith("xl/") or name == "content.xml" for name in names):
        return read_excel(path, inner, reading)
    if not any(name.endswith(".npy") for name in names):
        raise InputError(f"{path}: this is a zip archive: unpack it")
    refuse_part(path, inner)
    with fenced(path, "NumPy"), np.load(path, allow_pickle=False) as stored:
        return table_of_arrays(path, stored).require_numbers(names)
