"""Rows that wait until those after them are known: undoing dynamics and delay reads ahead."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np

from dbo_cli.arrays import Floats

Column = Floats | None
Block = tuple[tuple[Column, ...], Floats]
"""The columns of rows that are ready; of the first of them, what is known: the rows and those after them."""


class Rows(NamedTuple):
    """Rows that are ready: seconds (None without a clock), what was asked for, and what came of it."""

    time: Column
    x: Floats
    y: Floats


class Table(Protocol):
    """What takes columns, block by block: a file, or a pipe."""

    def write(self, *columns: Floats) -> None:
        """Take the next rows."""


NO_ROWS = Rows(None, np.empty(0), np.empty(0))


def joined(parts: list[Rows]) -> Rows:
    """Return rows one behind the other; parts without rows do not count."""
    parts = [rows for rows in parts if rows.x.size]
    if len(parts) < 2:
        return parts[0] if parts else NO_ROWS
    time, x, y = (_behind_one_another(columns) for columns in zip(*parts, strict=True))
    assert x is not None and y is not None
    return Rows(time, x, y)


def _behind_one_another(columns: tuple[Column, ...]) -> Column:
    arrays = [column for column in columns if column is not None]
    return np.concatenate(arrays) if len(arrays) == len(columns) else None


def write(table: Table, rows: Rows) -> None:
    """Write rows, with their times where there is a clock."""
    columns = [column for column in rows if column is not None]
    if rows.x.size:
        table.write(*columns)


class Ahead:
    """Holds back blocks of rows until the ``count`` rows after them are known.

    A block is some columns of equal length; the rows of the first one are read ahead.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._waiting: deque[tuple[Column, ...]] = deque()
        self._known = np.empty(0)  # of the blocks that wait, and of those after

    def take(self, *columns: Column) -> Iterator[Block]:
        """Take a block; yield those that are ready."""
        first = columns[0]
        assert first is not None
        self._waiting.append(columns)
        if self._known.size:
            first = np.concatenate([self._known, first])
        self._known = first
        yield from self._ready()

    def remaining(self) -> Iterator[Block]:
        """Yield the blocks that are left: the last value goes on for ever."""
        after = np.repeat(self._known[-1:], self.count)
        self._known = np.concatenate([self._known, after])
        yield from self._ready()

    def _ready(self) -> Iterator[Block]:
        """Yield each block of which enough is known behind it."""
        while self._waiting:
            first = self._waiting[0][0]
            assert first is not None
            if self._known.size < first.size + self.count:
                return
            yield self._waiting.popleft(), self._known[: first.size + self.count]
            self._known = self._known[first.size :]
