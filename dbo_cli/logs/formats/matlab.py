"""MATLAB files before version 7.3: vectors, and columns of matrices.

A file of version 5 is a row of elements, each behind a tag of its type and size. The
tags are walked here, for scipy ends the process at a damaged one; what they say of a
matrix of numbers is all that is needed to read it.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.logs.formats.stored import FileFormat, StoredTable, fenced, refuse_part
from dbo_cli.logs.table import Reading, Table

_HEADER = 128  # bytes of text, version and byte order
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
"""NumPy's names of the types of elements that hold numbers."""
_CLASSES = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function", 17: "table",
}  # fmt: skip
"""Classes of matrices that hold no plain numbers; tables are objects without a public form."""
_NUMBERS = range(6, 16)  # classes: double, single, and integers
_IS_COMPLEX = 0x0800


@dataclass
class Variable:
    """A variable: its name, its class, its size, and its values where they are plain numbers."""

    name: str
    kind: str
    shape: tuple[int, ...]
    fields: tuple[str, ...] = ()
    values: NDArray[Any] | None = None

    def describe(self) -> str:
        """Return what messages say of it."""
        size = "x".join(map(str, self.shape))
        names = f" of {', '.join(self.fields)}" if self.fields else ""
        return f"{self.name} ({size} {self.kind}{names})".replace("( ", "(")

    def advice(self) -> str:
        """Return a line of MATLAB that saves what is in it as columns; empty for texts."""
        name = self.name
        if self.kind == "struct" and all(length == 1 for length in self.shape):
            return f"save('flat.mat', '-struct', '{name}')"
        if self.kind == "struct":
            return f"writetable(struct2table({name}), 'flat.csv')"
        if self.kind == "cell":
            names = f"compose('c%d', 1:numel({name}))"
            return f"s = cell2struct({name}(:), {names}, 1); save('flat.mat', '-struct', 's')"
        if self.kind == "table":
            return f"writetable({name}, 'flat.csv')"
        return ""


class Elements:
    """The elements in some bytes, with the byte order of the file (ValueError where they end early)."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data = data
        self.order = order
        self.position = 0

    def next(self) -> tuple[int, bytes]:
        """Return the type and the bytes of the next element."""
        start = self.position
        tag = np.frombuffer(self.data, self.order + "u4", 2, start)
        kind, size = map(int, tag)
        begin = start + 8
        self.position = begin + size
        if kind >> 16:  # four bytes at most stand in the tag
            kind, size, begin = kind & 0xFFFF, kind >> 16, start + 4
            self.position = start + 8
        elif kind != _COMPRESSED:
            self.position += -size % 8
        if begin + size > len(self.data) or (begin == start + 4 and size > 4):
            raise ValueError("it ends early")
        return kind, self.data[begin : begin + size]

    def numbers(self) -> NDArray[Any]:
        """Return the numbers of the next element."""
        kind, data = self.next()
        if kind not in _TYPES:
            raise ValueError(f"{kind} is no type of numbers")
        return np.frombuffer(data, self.order + _TYPES[kind])

    def text(self) -> str:
        """Return the text of the next element."""
        return self.next()[1].decode("utf-8", "replace")


def variables_of(data: bytes) -> Iterator[Variable]:
    """Walk through the variables of a file of version 5 (ValueError where it is damaged)."""
    order = {b"IM": "<", b"MI": ">"}.get(data[_HEADER - 2 : _HEADER])
    if order is None:
        raise ValueError("it states no byte order")
    elements = Elements(data[_HEADER:], order)
    while elements.position < len(elements.data):
        kind, content = elements.next()
        if kind == _COMPRESSED:
            kind, content = Elements(zlib.decompress(content), order).next()
        if kind != _MATRIX:
            raise ValueError(f"{kind} is no variable")
        yield _variable_of(Elements(content, order))


def _variable_of(elements: Elements) -> Variable:
    """Read a variable from its elements: flags, size, name, values."""
    flags = elements.numbers()
    number = int(flags[0]) & 0xFF if len(flags) else 0
    if number == 17:
        return Variable(elements.text(), _CLASSES[17], ())
    shape = tuple(int(length) for length in elements.numbers())
    name = elements.text()
    if number not in _NUMBERS or int(flags[0]) & _IS_COMPLEX:
        kind = _CLASSES.get(number, "complex")
        return Variable(name, kind, shape, _fields_of(elements, kind))
    values = elements.numbers()
    if np.prod(shape, dtype=object) != len(values):
        raise ValueError(f"{name} has another size than its values")
    return Variable(name, "double", shape, (), values.reshape(shape, order="F"))


def _fields_of(elements: Elements, kind: str) -> tuple[str, ...]:
    """Return the names of a struct's fields."""
    if kind != "struct":
        return ()
    lengths = elements.numbers()
    names = elements.next()[1]
    length = max(int(lengths[0]), 1) if len(lengths) else 1
    cells = [names[k : k + length] for k in range(0, len(names), length)]
    return tuple(cell.partition(b"\0")[0].decode("utf-8", "replace") for cell in cells)


def _read(path: str, inner: str, reading: Reading) -> Table:
    """Read the vectors and matrices of a file of version 5 to 7 (InputError)."""
    refuse_part(path, inner)
    with open(path, "rb") as file, fenced(path, "MATLAB"):
        data = file.read()
        if 0 in data[:4]:
            raise InputError(f"{path}: MATLAB before version 5: save(..., '-v7') again")
        variables = [variable for variable in variables_of(data) if variable.name]
    table = StoredTable(path)
    lines = [variable.advice() for variable in variables if variable.advice()]
    table.hint = f": in MATLAB, {lines[0]}" if lines else ""
    arrays = {}
    for variable in variables:
        if variable.values is not None:
            arrays[variable.name] = np.squeeze(variable.values)
    table.add_arrays(arrays)
    return table.require_numbers(variable.describe() for variable in variables)


MATLAB = FileFormat((b"MATLAB",), _read, (".mat",))
