"""What every format gives, and all that the rest of the program knows of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Protocol

from dbo_cli.logs.reading_options import Rows
from dbo_cli.logs.sample_block import ColumnInfo, SampleBlock


class Table(Protocol):
    """A log in some format: its columns at once, its rows in blocks."""

    place: str
    columns: list[ColumnInfo]
    notes: list[str]

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Tell the sample rate (Hz) that the file states for these columns, and the first row's time (s)."""

    def describe(self) -> str:
        """Tell in one line how the log is written."""

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks."""

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for."""

    def close(self) -> None:
        """Close the file."""
