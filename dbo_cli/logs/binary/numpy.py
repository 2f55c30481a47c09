"""NumPy's ``.npy`` and ``.npz`` files as a table of columns; pickled objects are never loaded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.column_table import (
    ColumnSource,
    ColumnTable,
    Fetch,
    Request,
    array_source,
    matrix_sources,
    statements_in,
    without_scalars,
)
from dbo_cli.logs.stated_clock import is_clock_name

_PIECE = 1 << 23  # bytes read at once: a matrix is read by whole rows, whatever its width


def open_npy(request: Request) -> ColumnTable:
    """Open an array: fields of a structured array, or a matrix's columns (by number), read in blocks.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    with request.reading("NumPy file"):
        try:
            # Mapped for its header alone: reading a map of a file that is cut meanwhile ends the process.
            array = np.load(request.address.path, mmap_mode="r", allow_pickle=False)
        except ValueError as problem:
            if any(word in str(problem) for word in ("allow_pickle", "Object arrays", "Python objects")):
                raise InputError(
                    f"{request.place}: it holds pickled Python objects, which are not loaded: save arrays of "
                    "numbers"
                ) from None
            raise
        sources = list(_columns_in_file(request.address.path, array))
    if not sources:
        raise request.no_columns([_shape(array)])
    return ColumnTable(request, "NumPy array", sources)


def open_npz(request: Request) -> ColumnTable:
    """Open an archive of arrays; single numbers called ``fs``, ``dt`` and the like give the sample rate.

    Raises
    ------
    InputError
        The file is damaged, or holds no columns of numbers.
    """
    arrays: dict[str, Any] = {}
    with (
        request.reading("NumPy archive"),  # zipfile and numpy raise whatever the damaged bytes lead to
        open(request.address.path, "rb") as stream,
        np.load(stream, allow_pickle=False) as archive,
    ):
        for name in archive.files:
            arrays[name] = _member(archive, name)
    readable = {name: array for name, array in arrays.items() if array is not None}
    sources = without_scalars([one for name, array in readable.items() for one in _columns(name, array)])
    if not sources:
        raise request.no_columns(f"{name} ({_shape(array)})" for name, array in arrays.items())
    single = {name: array.ravel()[0] for name, array in readable.items() if array.size == 1}
    stated = {name: value for name, value in single.items() if is_clock_name(name) or isinstance(value, str)}
    return ColumnTable(request, "NumPy archive", sources, clock=statements_in(stated))


def _member(archive: Any, name: str) -> Any:
    """Read one array; None for pickled objects, which are left out as text is."""
    try:
        return archive[name]
    except ValueError as problem:
        if "allow_pickle" in str(problem):
            return None
        raise


def _columns(name: str, array: Any) -> list[ColumnSource]:
    if array.dtype.names is not None and array.ndim == 1:
        return [array_source(f"{name}/{field}", array[field]) for field in _numbers_in(array.dtype)]
    single = array.ndim == 2 and 1 in array.shape
    return matrix_sources(name, array, "{name}" if single else "{name}[{number}]")


def _numbers_in(kind: Any) -> list[str]:
    return [field for field in kind.names if kind[field].kind in "fiub"]


def _columns_in_file(path: str, array: Any) -> Iterator[ColumnSource]:
    """List the columns of an array of which only the place in the file is used."""
    kind, shape = array.dtype, array.shape
    if kind.names is not None and array.ndim == 1:
        for name in _numbers_in(kind):
            yield ColumnSource(name, len(array), _stretches(path, kind, array.offset, name))
    elif kind.kind in "fiub" and array.size and array.ndim in (1, 2):
        length, width = (shape[0], 1) if array.ndim == 1 else (max(shape), min(shape))
        by_rows = width > 1 and (shape[0] >= shape[1]) == array.flags.c_contiguous
        row = np.dtype((kind, (width,)))
        for index in range(width):
            place = array.offset + index * length * kind.itemsize
            own = _stretches(path, row, array.offset, (slice(None), index)) if by_rows else None
            yield ColumnSource("", length, own or _stretches(path, kind, place, ...))


def _stretches(path: str, record: Any, offset: int, column: Any) -> Fetch:
    """Read stretches of consecutive records, in pieces; ``column`` is the index of what is wanted of them."""
    most = max(1, _PIECE // record.itemsize)

    def fetch(start: int, stop: int) -> Any:
        pieces = []
        for first in range(start, stop, most):
            count = min(most, stop - first)
            rows = np.fromfile(path, record, count, offset=offset + first * record.itemsize)
            if len(rows) < count:
                raise ValueError("it ends early")
            pieces.append(rows[column])
        return np.concatenate(pieces)

    return fetch


def _shape(array: Any) -> str:
    if array is None:
        return "pickled objects"
    return f"{'x'.join(map(str, array.shape)) or 'one value'}, {array.dtype}"
