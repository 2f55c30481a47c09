"""MATLAB files before version 7.3: vectors, and columns of matrices.

A file of version 5 is a row of elements, each behind a tag of its type and size. The
tags are walked here, for scipy ends the process at a damaged one; what they say of a
matrix of numbers is all that is needed to read it.
"""

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.logs.fence import fenced, refuse_part
from dbo_cli.logs.formats.npy import table_of_arrays
from dbo_cli.logs.table import Reading, Table

_HEADER = 128  # bytes of text, version and byte order
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
"""NumPy's names of the types of elements that hold numbers."""
_NUMBERS = range(6, 16)  # classes of matrices: double, single, and integers
_TABLE = 17  # and other objects without a public form
_NO_NUMBERS = 0x0A00  # flags: complex, logical


Elements = Iterator[tuple[int, bytes]]
"""The types and the bytes of elements."""


def elements_of(data: bytes, order: str) -> Elements:
    """Walk through the elements in some bytes, in a byte order (ValueError where they end early)."""
    start = 0
    while start < len(data):
        kind, size = map(int, np.frombuffer(data, order + "u4", 2, start))
        begin, stop = start + 8, start + 8 + size
        if kind >> 16:  # four bytes at most stand in the tag
            kind, size = kind & 0xFFFF, kind >> 16
            begin, stop = start + 4, start + 8
        elif kind != _COMPRESSED:
            stop += -size % 8
        if begin + size > min(len(data), stop):
            raise ValueError("it ends early")
        yield kind, data[begin : begin + size]
        start = stop


def variables_of(data: bytes) -> Iterator[tuple[str, NDArray[Any] | None]]:
    """Walk through the variables of a file of version 5: names, and values where they are plain numbers.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[_HEADER - 2 : _HEADER])
    if order is None:
        raise ValueError("it states no byte order")
    for kind, content in elements_of(data[_HEADER:], order):
        if kind == _COMPRESSED:
            packed = elements_of(zlib.decompress(content), order)
            kind, content = next(packed, (0, b""))
        if kind != _MATRIX:
            raise ValueError(f"{kind} is no variable")
        yield _variable_of(elements_of(content, order), order)


def _variable_of(elements: Elements, order: str) -> tuple[str, NDArray[Any] | None]:
    """Read a variable from its elements: flags, size, name, values."""

    def numbers() -> NDArray[Any]:
        kind, data = next(elements, (0, b""))
        if kind not in _TYPES:
            raise ValueError(f"{kind} is no type of numbers")
        return np.frombuffer(data, order + _TYPES[kind])

    flags = int(numbers()[0])
    # the name of a table has no size in front
    shape = () if flags & 0xFF == _TABLE else tuple(numbers().tolist())
    name = next(elements, (0, b""))[1].decode("utf-8", "replace")
    if flags & 0xFF not in _NUMBERS or flags & _NO_NUMBERS:
        return name, None
    values = numbers()
    if np.prod(shape, dtype=object) != len(values):
        raise ValueError(f"{name} has another size than its values")
    return name, values.reshape(shape, order="F")


def read_matlab(path: str, inner: str, reading: Reading) -> Table:
    """Read the vectors and matrices of a file of version 5 to 7 (InputError)."""
    refuse_part(path, inner)
    with open(path, "rb") as file, fenced(path, "MATLAB"):
        variables = {name: array for name, array in variables_of(file.read()) if name}
    arrays, others = {}, []
    for name, array in variables.items():
        if array is None:
            others.append(name)
        else:
            arrays[name] = np.squeeze(array)
    table = table_of_arrays(path, arrays)
    if others:
        table.hint = (
            f"; {', '.join(others)} is no array of numbers: in MATLAB, of a struct "
            "save('flat.mat', '-struct', 'NAME'), of a table or a cell array writetable"
        )
    return table.require_numbers(variables)
