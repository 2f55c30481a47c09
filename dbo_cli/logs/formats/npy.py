"""An array of NumPy: records, or a matrix whose columns have numbers."""

from __future__ import annotations

import numpy as np

from dbo_cli.logs.stored import StoredTable, fenced, refuse_part
from dbo_cli.logs.table import Reading, Table


def read_npy(path: str, inner: str, reading: Reading) -> Table:
    """Read an array, mapped into memory (InputError)."""
    refuse_part(path, inner)
    with fenced(path, "NumPy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    table = StoredTable(path)
    table.add_arrays({"": array})
    return table.require_numbers([f"{array.dtype} {array.shape}"])
