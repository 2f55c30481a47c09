"""What the formats share: a table of named arrays, and a fence around the libraries that read them."""

from __future__ import annotations

import contextlib
import importlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.settings import Statement, is_clock_setting, stated_clock
from dbo_cli.logs.table import ROWS_A_BLOCK, Column, Reading, Table

TableReader = Callable[[str, str, Reading], Table]
"""Takes a path, the part behind ``::`` and how to read."""
Fetch = Callable[[int, int], Any]
"""Returns rows from a start to a stop, counted from 0."""
_KINDS = defaultdict(
    lambda: "text", f="number", i="number", u="number", b="number", M="stamp"
)
"""The kind of a column by NumPy's letter of its type."""


@dataclass(frozen=True)
class FileFormat:
    """A format: how its files are known, and what reads them.

    Attributes
    ----------
    magics
        First bytes, at one of the ``offsets``.
    suffixes
        What is enough where the first bytes say nothing.
    """

    magics: tuple[bytes, ...]
    read: TableReader
    suffixes: tuple[str, ...] = ()
    offsets: tuple[int, ...] = (0,)

    def has_magic(self, start: bytes) -> bool:
        """Return whether the first bytes of a file are those of the format."""
        return any(start.startswith(self.magics, offset) for offset in self.offsets)


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
    except BaseException as problem:  # a panic of polars is no Exception
        reason = str(problem).strip().splitlines() or [type(problem).__name__]
        raise InputError(f"{path}: cannot be read as {kind}: {reason[0]}") from None


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

    has_paths = True
    block_rows = ROWS_A_BLOCK
    doubt = ""

    def __init__(self, path: str, close: Callable[[], object] = lambda: None) -> None:
        super().__init__(path)
        self._lengths: list[int] = []
        self._fetches: list[Fetch] = []
        self._close = close

    def add(
        self,
        name: str,
        length: int,
        fetch: Fetch,
        unit: str | None = None,
        kind: str = "number",
    ) -> Column:
        """Add a column of so many rows."""
        self._lengths.append(length)
        self._fetches.append(fetch)
        return self.add_column(name, unit, kind)

    def add_array(self, name: str, stored: Any, unit: str | None = None) -> None:
        """Add the columns of an array; see ``parts_of``."""
        for label, length, fetch, kind in parts_of(name, stored):
            self.add(label, length, fetch, unit, kind)

    def add_arrays(self, arrays: Mapping[str, Any]) -> None:
        """Add arrays by name; a single value is no column, but may state the clock."""
        statements: list[Statement] = []
        for name, array in arrays.items():
            if np.size(array) > 1:
                self.add_array(name, np.asarray(array))
            elif is_clock_setting(name) and np.size(array):
                statements.append((name, np.ravel(array)[0].item(), ""))
        self.stated = stated_clock(statements)

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
        lengths = [self._lengths[column.number - 1] for column in columns]
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
            stored = np.asarray(self._fetches[column.number - 1](start, stop))
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


def parts_of(name: str, stored: Any) -> Iterator[tuple[str, int, Fetch, str]]:
    """Take an array or a dataset apart: a vector, a matrix whose longer axis is time, or records.

    Yields
    ------
    label, length, fetch, kind
        Of each column; nothing of what holds neither numbers, nor dates, nor a row of texts.
    """
    kind, shape = stored.dtype, stored.shape
    if kind.names is not None and len(shape) == 1:
        for label in kind.names:
            if not kind[label].shape:
                yield (
                    label,
                    shape[0],
                    _field_of(stored, label),
                    _KINDS[kind[label].kind],
                )
    elif len(shape) == 1:
        yield name, shape[0], lambda start, stop: stored[start:stop], _KINDS[kind.kind]
    elif len(shape) == 2 and _KINDS[kind.kind] != "text":
        along = 0 if shape[0] >= shape[1] else 1
        width = shape[1 - along]
        for number in range(width):
            label = f"{name}[{number + 1}]" if name and width > 1 else name
            fetch = _column_of(stored, along, number)
            yield label, shape[along], fetch, _KINDS[kind.kind]


def _field_of(stored: Any, label: str) -> Fetch:
    return lambda start, stop: stored[start:stop][label]


def _column_of(stored: Any, along: int, number: int) -> Fetch:
    if along == 0:
        return lambda start, stop: stored[start:stop, number]
    return lambda start, stop: stored[number, start:stop]
