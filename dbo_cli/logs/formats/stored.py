"""What the formats share: columns that a library hands out by rows, and a fence around libraries."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.settings import Statement, is_clock_setting, stated_clock
from dbo_cli.logs.table import BLOCK_ROWS, Column, Reading, Table

TableReader = Callable[[str, str, Reading], Table]
"""Takes a path, the part behind ``::`` and how to read."""
Fetch = Callable[[int, int], Any]
"""Returns rows from a start to a stop, counted from 0."""


@dataclass(frozen=True)
class FileFormat:
    """A format: its name, how its files are known, and what reads them.

    Attributes
    ----------
    magics
        First bytes, at one of the ``offsets``.
    suffixes
        What is enough where the first bytes say nothing.
    """

    name: str
    magics: tuple[bytes, ...]
    suffixes: tuple[str, ...]
    read: TableReader
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


@dataclass(frozen=True)
class StoredColumn:
    """A column whose rows come from ``fetch(start, stop)``, counted from 0.

    ``fetch`` is None where they are stored in other files; ``problem`` says why they may
    not be what they are taken for.
    """

    name: str
    length: int
    fetch: Fetch | None
    unit: str | None = None
    kind: str = "number"
    problem: str = ""


class StoredTable(Table):
    """Columns that a library hands out by rows.

    Parameters
    ----------
    path
        The file, for messages.
    stored
        Its columns.
    statements
        What it states beside them of the sample rate and the first row's time.
    close
        Called at the end.

    Attributes
    ----------
    doubt
        What is remarked behind the last row.
    """

    has_paths = True
    doubt = ""

    def __init__(
        self,
        path: str,
        stored: Sequence[StoredColumn],
        statements: Sequence[Statement] = (),
        close: Callable[[], object] = lambda: None,
    ) -> None:
        super().__init__(path, stated_clock(statements))
        self._stored: list[StoredColumn] = []
        self._close = close
        for column in stored:
            self.add(column)

    def add(self, stored: StoredColumn) -> Column:
        """Add a column."""
        self._stored.append(stored)
        return self.add_column(stored.name, stored.unit, stored.kind)

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns; see ``Table``.

        Raises
        ------
        InputError
            The columns are of unequal length, or the library fails.
        """
        lengths = [self._stored[column.number - 1].length for column in columns]
        if len(set(lengths)) > 1:
            pairs = zip(columns, lengths, strict=True)
            text = ", ".join(f"{column.label} {rows}" for column, rows in pairs)
            raise InputError(f"{self.name}: the columns are of unequal length: {text}")
        for start in range(0, lengths[0], BLOCK_ROWS):
            stop = min(lengths[0], start + BLOCK_ROWS)
            yield [self._rows(column, start, stop) for column in columns]
        if self.doubt:
            self.remarks.append(self.doubt)

    def _rows(self, column: Column, start: int, stop: int) -> NDArray[Any]:
        """Read rows of one column as float64, or dates as int64 nanoseconds."""
        fetch = self._stored[column.number - 1].fetch
        if fetch is None:
            raise InputError(
                f"{self.name}: {column.label} is stored in other files: copy them into one with h5repack"
            )
        with fenced(self.name, column.label):
            stored = np.asarray(fetch(start, stop))
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


def array_columns(name: str, array: Any) -> list[StoredColumn]:
    """Take a vector, a matrix (its longer axis is time) or records apart; nothing for text."""
    columns: list[StoredColumn] = []
    if array.dtype.names is not None:
        for label in array.dtype.names:
            columns += array_columns(label, array[label])
        return columns
    if array.dtype.kind not in "fiubM" or array.ndim not in (1, 2) or not array.size:
        return []
    matrix = array[:, None] if array.ndim == 1 else array
    if matrix.shape[0] < matrix.shape[1]:
        matrix = matrix.T
    rows, width = matrix.shape
    kind = "stamp" if array.dtype.kind == "M" else "number"
    for number in range(width):
        label = f"{name}[{number + 1}]" if name and width > 1 else name
        fetch = rows_of(matrix[:, number])
        columns.append(StoredColumn(label, rows, fetch, kind=kind))
    return columns


def rows_of(stored: Any) -> Fetch:
    """Return what fetches rows of an array, a dataset or a channel."""
    return lambda start, stop: stored[start:stop]


def arrays_as_table(path: str, arrays: Mapping[str, Any], hint: str = "") -> Table:
    """Return a table of arrays by name; a single value beside longer ones is a statement.

    Parameters
    ----------
    hint
        What refusals say of the rest of the file.
    """
    columns: list[StoredColumn] = []
    statements: list[Statement] = []
    for name, array in arrays.items():
        stored = array_columns(name, np.asarray(array))
        if is_clock_setting(name) and np.size(array) == 1:
            statements.append((name, np.ravel(array)[0].item(), ""))
        elif stored and stored[0].length > 1:
            columns += stored
    if not columns:
        names = [
            f"{name} ({np.asarray(array).dtype})" for name, array in arrays.items()
        ]
        raise no_columns(path, names, hint)
    table = StoredTable(path, columns, statements)
    table.hint = hint
    return table


def no_columns(path: str, contents: Iterable[str], hint: str = "") -> InputError:
    """Return the refusal of a file without columns of numbers."""
    text = ", ".join(contents) or "nothing"
    return InputError(f"{path}: no columns of numbers: it has {text[:300]}{hint}")
