"""What a log gives: blocks of samples, each row with its place in the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Places = range | NDArray[np.int64]


@dataclass(frozen=True)
class ColumnInfo:
    """One column of a log.

    ``name`` is the header as written (or the number where there is none), ``quantity`` the header without its
    unit, ``unit`` the normalised unit or None (units are never guessed), ``number`` counts from 1.
    """

    name: str
    unit: str | None
    quantity: str
    number: int


@dataclass(frozen=True)
class RawBlock:
    """Parsed rows before any meaning is given to them.

    ``rows`` are data row numbers from 1 (a gap where bad rows were dropped), ``lines`` the line numbers in
    the file (None for HDF5, which has none), ``arrays`` one float64 array a requested column.
    """

    rows: Places
    lines: Places | None
    arrays: list[FloatArray]

    def part(self, start: int, stop: int) -> RawBlock:
        """Rows ``start`` to ``stop`` (counted from 0, ``stop`` not included) as a block of views."""
        lines = None if self.lines is None else self.lines[start:stop]
        return RawBlock(self.rows[start:stop], lines, [array[start:stop] for array in self.arrays])


@dataclass(frozen=True)
class Block:
    """Consecutive samples of a log.

    ``time`` is in seconds, or None where the log has neither a time column nor a sample rate; ``values``
    holds one float64 array of the same length a role; ``rows`` and ``lines`` say where each sample stands.
    """

    rows: Places
    lines: Places | None
    time: FloatArray | None
    values: Mapping[str, FloatArray]

    @property
    def first_row(self) -> int:
        """The data row, counted from 1, of the block's first sample (0 for an empty block)."""
        return int(self.rows[0]) if len(self.rows) else 0

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.rows)


def join_places(parts: list[Places]) -> Places:
    """Concatenate runs of row or line numbers; a range where they are gapless."""
    if not parts:
        return range(1, 1)
    first = int(parts[0][0]) if len(parts[0]) else 1
    following = first
    for part in parts:
        if not isinstance(part, range) or part.step != 1 or (len(part) and part[0] != following):
            return np.concatenate([np.asarray(part, dtype=np.int64) for part in parts])
        following += len(part)
    return range(first, following)
