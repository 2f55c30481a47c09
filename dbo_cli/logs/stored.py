"""What the formats share: a table of named arrays, and a fence around the libraries that read them."""

from __future__ import annotations

import contextlib
import importlib
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.settings import is_clock_setting
from dbo_cli.logs.table import ROWS_A_BLOCK, Column, Fetch, Table

_KINDS = defaultdict(
    lambda: "text", f="number", i="number", u="number", b="number", M="stamp"
)
"""The kind of a column by NumPy's letter of its type."""


def import_extra(module: str, extra: str, path: str) -> Any:
    """Import a library that is not always installed (InputError)."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{path}: needs {module}: pip install 'dbo-cli[{extra}]'"
        ) from None


@contextlib.contextmanager
def fenced(path: str, kind: str) -> Iterator[None]:
    """Turn whatever a library raises at damaged bytes into one line (InputError)."""
    try:
        yield
    except (DboError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except Exception as problem:
        reason = str(problem).strip().splitlines() or [type(problem).__name__]
        raise InputError(f"{path}: cannot be read as {kind}: {reason[0]}") from None
    except BaseException:  # a panic of polars
        raise InputError(
            f"{path}: cannot be read as {kind}: damaged: write it again"
        ) from None


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep off standard error what a library writes there: a log, or where it panicked."""
    try:
        stderr = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def refuse_part(path: str, inner: str) -> None:
    """Refuse a part of a file that has none (InputError)."""
    if inner:
        raise InputError(f"{path}::{inner}: this format has no parts: type {path}")


class StoredTable(Table):
    """A table of named arrays, in memory or handed out by a library.

    Parameters
    ----------
    path
        The file, for messages.
    close
        Called at the end.

    Attributes
    ----------
    block_rows
        Rows of a block.
    doubt
        What is remarked behind the last row.
    """

    block_rows = ROWS_A_BLOCK
    doubt = ""

    def __init__(self, path: str, close: Callable[[], object] = lambda: None) -> None:
        super().__init__(path)
        self._close = close

    def add_arrays(self, arrays: Mapping[str, Any]) -> None:
        """Add arrays by name; a single value is no column, but may state the clock."""
        for name, array in arrays.items():
            if np.size(array) > 1:
                for column in columns_in(name, np.asarray(array)):
                    self.add(column)
            elif is_clock_setting(name) and np.size(array):
                self.state(name, np.ravel(array)[0].item())

    def require_numbers(self, contents: Iterable[str]) -> StoredTable:
        """Return the table; refuse (InputError) one without columns of numbers, whose contents are these."""
        if any(column.kind == "number" for column in self.columns):
            return self
        text = ", ".join(contents) or "nothing"
        raise InputError(
            f"{self.name}: no columns of numbers: it has {text[:300]}{self.hint}"
        )

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns; see ``Table``.

        Raises
        ------
        InputError
            The columns are of unequal length, or the library fails.
        """
        lengths = [column.length for column in columns]
        if len(set(lengths)) > 1:
            pairs = zip(columns, lengths, strict=True)
            text = ", ".join(f"{column.label} {rows:,} rows" for column, rows in pairs)
            raise InputError(f"{self.name}: the columns are of unequal length: {text}")
        for start in range(0, lengths[0], self.block_rows):
            stop = min(lengths[0], start + self.block_rows)
            yield [self._rows(column, start, stop) for column in columns]
        if self.doubt:
            self.remarks.append(self.doubt)

    def _rows(self, column: Column, start: int, stop: int) -> NDArray[Any]:
        """Read rows of one column as float64, or dates as int64 nanoseconds."""
        with fenced(self.name, column.label):
            stored = np.asarray(column.fetch(start, stop))
            if stored.dtype.kind == "M":
                stored = stored.astype("datetime64[ns]").astype(np.int64)
            elif column.kind == "number":
                stored = np.ascontiguousarray(stored, dtype=np.float64)
        if len(stored) != stop - start:
            raise InputError(f"{self.name}: {column.label} ends early: damaged?")
        return stored

    def close(self) -> None:
        """Close the file."""
        self._close()


def columns_in(name: str, stored: Any) -> Iterator[Column]:
    """Take an array or a dataset apart: a vector, a matrix whose longer axis is time, or records.

    There are no parts of what holds neither numbers, nor dates, nor a row of texts.
    """
    kind, shape = stored.dtype, stored.shape
    if kind.names is not None and len(shape) == 1:
        for label in kind.names:
            if not kind[label].shape:
                yield column_of(label, kind[label], shape[0], _field_of(stored, label))
    elif len(shape) == 1:
        yield column_of(name, kind, shape[0], rows_of(stored))
    elif len(shape) == 2 and _KINDS[kind.kind] != "text":
        along = 0 if shape[0] >= shape[1] else 1
        width = shape[1 - along]
        for number in range(width):
            label = f"{name}[{number + 1}]" if name and width > 1 else name
            fetch = _column_of(stored, along, number)
            yield column_of(label, kind, shape[along], fetch)


def column_of(name: str, kind: Any, rows: int, fetch: Fetch) -> Column:
    """Return a column of so many rows of a type of NumPy's."""
    return Column(0, name, kind=_KINDS[kind.kind], length=rows, fetch=fetch)


def rows_of(stored: Any) -> Fetch:
    """Return what fetches rows of an array."""
    return lambda start, stop: stored[start:stop]


def _field_of(stored: Any, label: str) -> Fetch:
    return lambda start, stop: stored[start:stop][label]


def _column_of(stored: Any, along: int, number: int) -> Fetch:
    if along == 0:
        return lambda start, stop: stored[start:stop, number]
    return lambda start, stop: stored[number, start:stop]
