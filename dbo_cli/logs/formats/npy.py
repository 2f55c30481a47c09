"""Arrays of NumPy by name: records, and matrices whose columns have numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dbo_cli.logs.fence import fenced, refuse_part
from dbo_cli.logs.settings import is_clock_setting
from dbo_cli.logs.table import Reading, Table, columns_in


def read_npy(path: str, inner: str, reading: Reading) -> Table:
    """Read an array, mapped into memory (InputError)."""
    refuse_part(path, inner)
    with fenced(path, "NumPy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    table = table_of_arrays(path, {"": array})
    return table.require_numbers([f"{array.dtype} {array.shape}"])


def table_of_arrays(path: str, arrays: Mapping[str, Any]) -> Table:
    """Return arrays by name as a table; a single value is no column, but may state the clock."""
    table = Table(path)
    for name, array in arrays.items():
        if np.size(array) > 1:
            for column in columns_in(name, np.asarray(array)):
                table.add(column)
        elif is_clock_setting(name) and np.size(array):
            table.state(name, np.ravel(array)[0].item())
    return table
