"""Columns of a log that was read once for many channels, each handed on as a log of its own.

A ``ReadLog`` is the log's address with such a table behind it: whoever opens the address opens the table
instead of the file, and everything else (clock, units, scales, rows, messages) goes the usual way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.reading_options import ALL_ROWS, ReadingOptions, Rows
from dbo_cli.logs.sample_block import ColumnInfo, SampleBlock, Table
from dbo_cli.logs.time_column import FoundTime


@dataclass
class HeldTable(Table):
    """Some columns of a table in memory.

    Attributes
    ----------
    place, columns, described
        As the table that was read has them; only the columns that are held.
    block
        All rows; the values by column number, as text.
    found_time
        The time column, found among all columns of the log.
    clock
        The rate (Hz) and the first row's time (s) that the file states, or the refusal.
    digest
        Of the file.
    """

    place: str
    columns: list[ColumnInfo]
    described: str
    block: SampleBlock
    found_time: FoundTime
    clock: tuple[float | None, float] | InputError
    digest: str | None
    remarks: tuple[str, ...] = ()
    rows: Rows = ALL_ROWS
    notes: list[str] = field(default_factory=list)

    def opened(self, options: ReadingOptions) -> HeldTable:
        """Return a table to read from, whose notes and clock are its own."""
        found = self.found_time
        if found.clock is not None:
            found = found._replace(clock=dataclasses.replace(found.clock, notes=list(found.clock.notes)))
        return dataclasses.replace(self, rows=options.rows, found_time=found, notes=list(self.remarks))

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) that the file states, and the first row's time (s)."""
        if isinstance(self.clock, InputError):
            raise self.clock
        return self.clock

    def describe(self) -> str:
        """Describe in one line how the log is written."""
        return self.described

    def blocks(self, picks: Mapping[str, ColumnInfo]) -> Iterator[SampleBlock]:
        """Return the rows asked for as one block; none of them is bad."""
        values = {role: self.block.values[str(pick.number)] for role, pick in picks.items()}
        block = dataclasses.replace(self.block, values=values).within(self.rows)
        if len(block):
            yield block

    @property
    def sha256(self) -> str | None:
        """The digest of what was read."""
        return self.digest


@dataclass(frozen=True)
class ReadLog(Address):
    """The address of a log whose columns are in memory already."""

    table: HeldTable | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of(cls, address: Address, table: HeldTable) -> ReadLog:
        """Put a table behind an address."""
        return cls(address.text, address.path, address.group, address.kind, address.format, table)
