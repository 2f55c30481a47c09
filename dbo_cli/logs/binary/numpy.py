"""NumPy's ``.npy`` and ``.npz`` files as a table of columns; pickled objects are never loaded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.column_table import ColumnSource, ColumnTable, array_source, brief
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.stated_clock import is_clock_name, read_statement


def open_npy(address: Address, selectors: Sequence[str], options: ReadingOptions) -> ColumnTable:
    """Open an array, mapped into memory: fields of a structured array, or a matrix's columns (by number).

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    try:
        array = np.load(address.path, mmap_mode="r", allow_pickle=False)
    except Exception as problem:  # numpy raises whatever the damaged bytes lead to
        raise InputError(f"{address.text}: {_reason(problem)}") from None
    sources = _columns("", array)
    if not sources:
        raise InputError(f"{address.text}: no columns of numbers: it holds {_shape(array)}")
    return ColumnTable(address.text, "NumPy array", sources)


def open_npz(address: Address, selectors: Sequence[str], options: ReadingOptions) -> ColumnTable:
    """Open an archive of arrays; single numbers called ``fs``, ``dt`` and the like give the sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    arrays: dict[str, Any] = {}
    try:
        with open(address.path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            for name in archive.files:
                arrays[name] = _member(archive, name)
    except Exception as problem:  # zipfile and numpy raise whatever the damaged bytes lead to
        raise InputError(f"{address.text}: damaged NumPy archive: {brief(problem)}") from None
    readable = {name: array for name, array in arrays.items() if array is not None}
    sources = [source for name, array in readable.items() for source in _columns(name, array)]
    longest = max((source.length for source in sources), default=0)
    sources = [source for source in sources if source.length > 1 or longest <= 1]
    if not sources:
        listed = ", ".join(f"{name} ({_shape(array)})" for name, array in arrays.items()) or "nothing"
        raise InputError(f"{address.text}: no columns of numbers: it holds {listed}")
    clock = []
    for name, array in readable.items():
        if is_clock_name(name) and array.size == 1:
            statement = read_statement(name, array.ravel()[0], _text(readable, name))
            clock += [statement] if statement is not None else []
    return ColumnTable(address.text, "NumPy archive", sources, clock=clock)


def _reason(problem: Exception) -> str:
    if "allow_pickle" in str(problem) or "Object arrays" in str(problem) or "Python objects" in str(problem):
        return "it holds pickled Python objects, which are not loaded: save arrays of numbers"
    return f"damaged NumPy file: {brief(problem)}"


def _member(archive: Any, name: str) -> Any:
    """Read one array; None for pickled objects, which are left out as text is."""
    try:
        return archive[name]
    except ValueError as problem:
        if "allow_pickle" in str(problem):
            return None
        raise


def _text(arrays: dict[str, Any], name: str) -> str | None:
    for other in (f"{name}_unit", f"{name}_units"):
        if other in arrays and arrays[other].dtype.kind == "U" and arrays[other].size == 1:
            return str(arrays[other].ravel()[0])
    return None


def _columns(name: str, array: Any) -> list[ColumnSource]:
    if array.dtype.names is not None and array.ndim == 1:
        prefix = f"{name}/" if name else ""
        fields = [field for field in array.dtype.names if array.dtype[field].kind in "fiub"]
        return [array_source(f"{prefix}{field}", array[field]) for field in fields]
    if array.dtype.kind not in "fiub" or not array.size:
        return []
    if array.ndim == 1:
        return [array_source(name, array)]
    if array.ndim != 2:
        return []
    table = array if array.shape[0] >= array.shape[1] else array.T
    labels = [f"{name}[{index + 1}]" if name else "" for index in range(table.shape[1])]
    if table.shape[1] == 1:
        labels = [name]
    return [array_source(label, table[:, index]) for index, label in enumerate(labels)]


def _shape(array: Any) -> str:
    if array is None:
        return "pickled objects"
    return f"{'x'.join(map(str, array.shape)) or 'one value'}, {array.dtype}"
