"""NumPy arrays: the fields of records, or the columns of a matrix by number."""

from __future__ import annotations

import numpy as np

from dbo_cli.logs.formats.stored import (
    FileFormat,
    StoredTable,
    array_columns,
    fenced,
    no_columns,
    refuse_part,
)
from dbo_cli.logs.table import Reading, Table


def _read(path: str, inner: str, reading: Reading) -> Table:
    """Read an array in memory of the system (InputError)."""
    refuse_part(path, inner)
    with fenced(path, "NumPy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    columns = array_columns("", array)
    if not columns:
        raise no_columns(path, [f"{array.dtype} {array.shape}"])
    return StoredTable(path, columns)


NUMPY = FileFormat("NumPy", (b"\x93NUMPY",), (), _read)
