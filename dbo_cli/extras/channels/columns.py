"""Channels: columns that a pattern names, and a log that is read once for all of them.

``V{}`` (or ``V{channel}``) stands for V1, V2, …; ``voltages[{}]`` for the columns of a
matrix. Several patterns have to name the same channels. What comes out of one channel
is what its columns alone would give: one whose rows cannot be read together with the
others' is read by itself.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.clock import Clock, find_clock
from dbo_cli.logs.columns import (
    MORE_TIME_NAMES,
    PLACE,
    TIME_NAMES,
    column_label,
    list_columns,
)
from dbo_cli.logs.request import ALL_ROWS, Address, ReadingOptions, Request, Rows
from dbo_cli.logs.sample_block import (
    Column,
    DroppedRows,
    SampleBlock,
    Table,
    joined,
)
from dbo_cli.logs.signal_log import file_sha256, open_table
from dbo_cli.logs.text.text_table import TextTable

_LISTED = 5  # channels that a message names at most


def column_of(pattern: str, channel: str) -> str:
    """Return the column that a pattern means for a channel, as one would name it."""
    name = PLACE.sub(lambda place: channel, pattern)
    return f"name={name}" if re.fullmatch(r"[+-]?\d+", name) else name


def is_matrix(pattern: str) -> bool:
    """Tell whether a pattern names the columns of a matrix."""
    return pattern.endswith("[{}]") or pattern.endswith("[{channel}]")


def channels_of(
    place: str,
    columns: Sequence[Column],
    patterns: Mapping[str, str],
    taken: Collection[int] = (),
) -> dict[str, dict[str, Column]]:
    """Find the channels of a log: for each, the column of every pattern, in the order of the log.

    Parameters
    ----------
    place
        The log's name, for messages.
    columns
        What the log has.
    patterns
        By the parameter that each was given as.
    taken
        Numbers of columns that no pattern means (the time).

    Raises
    ------
    UsageError
        A pattern has several places for the channel's name, or some parameters are
        patterns and others not.
    InputError
        A pattern matches nothing, two columns are one channel's, or a channel lacks a
        column.
    """
    for option, pattern in patterns.items():
        if len(PLACE.findall(pattern)) != 1:
            raise UsageError(
                f"`{option}` '{pattern}': put {{}} once where the channel's name stands, as in every pattern"
                " beside it"
            )
    matches: dict[str, dict[str, Column]] = {}
    names: dict[str, None] = {}  # in the order of the log, each once
    for option, pattern in patterns.items():
        matches[option] = _matches(place, columns, option, pattern, taken)
        names |= dict.fromkeys(matches[option])
    for option, by_channel in matches.items():
        missing = [channel for channel in names if channel not in by_channel]
        if missing:
            first = missing[0]
            counts = ", ".join(f"`{key}` {len(matches[key]):,}" for key in matches)
            raise InputError(
                f"{place}: no column '{column_of(patterns[option], first)}' (`{option}`) for channel"
                f" '{first}'{_and_more(missing)} (columns found: {counts})"
            )
    channels = {}
    for channel in names:
        channels[channel] = {option: matches[option][channel] for option in matches}
    return channels


def _and_more(missing: Sequence[str]) -> str:
    """Name the channels behind the first one that lack a column, too: a few, and how many there are."""
    behind = list(missing[1:])
    if not behind:
        return ""
    shown = behind[: _LISTED - 1]
    if len(behind) >= _LISTED:
        shown.append("…")
    return f" nor for {', '.join(shown)} ({len(missing):,} channels)"


def _matches(
    place: str,
    columns: Sequence[Column],
    option: str,
    pattern: str,
    taken: Collection[int],
) -> dict[str, Column]:
    """Return the columns of one pattern by channel: by the name without its unit, else the whole name."""
    before, after = PLACE.split(pattern)
    free = [
        column for column in columns if column.quantity and column.number not in taken
    ]
    for fold in (str, str.lower):
        shape = re.compile(
            re.escape(fold(before)) + "(.+)" + re.escape(fold(after)), re.DOTALL
        )
        for whole in (False, True):
            by_channel: dict[str, Column] = {}
            for column in free:
                name = column.name if whole else column.quantity
                match = shape.fullmatch(fold(name))
                if match is None:
                    continue
                channel = name[match.start(1) : match.end(1)]
                if channel in by_channel:
                    first = column_label(by_channel[channel])
                    raise InputError(
                        f"{place}: `{option}` '{pattern}': {first} and {column_label(column)} are both "
                        f"channel '{channel}' (rename one, or make the pattern longer)"
                    )
                by_channel[channel] = column
            if by_channel:
                return by_channel
    alone = _only_column(before, after, free)
    if alone is not None:
        return {"1": alone}
    raise InputError(
        f"{place}: `{option}` '{pattern}' matches no column: {list_columns(columns)}"
    )


def _only_column(before: str, after: str, free: Sequence[Column]) -> Column | None:
    """Return the column of a matrix that has no other, and so no number behind its name."""
    if not before.endswith("[") or after != "]":
        return None
    matrix = before.removesuffix("[").lower()
    columns = []
    for column in free:
        if matrix in (column.name.lower(), column.quantity.lower()):
            columns.append(column)
    if len(columns) != 1:
        return None
    return columns[0]


@dataclass(kw_only=True)
class HeldTable(Table):
    """Some columns of a table in memory.

    Attributes
    ----------
    place, columns, described
        As the table that was read has them; only the columns that are held.
    block
        All rows; the values by column number, as text.
    ready_clock
        The clock, found among all columns of the log.
    stated_rate
        The rate (Hz) and the first row's time (s) that the file states, or the refusal.
    digest
        Of the file.
    """

    place: str
    columns: list[Column]
    described: str
    block: SampleBlock
    ready_clock: Clock
    stated_rate: tuple[float | None, float] | InputError
    digest: str | None
    remarks: tuple[str, ...] = ()
    rows: Rows = ALL_ROWS
    notes: list[str] = field(default_factory=list)
    dropped: DroppedRows = field(default_factory=DroppedRows)
    doubtful: list[str] = field(default_factory=list)

    def opened(self, options: ReadingOptions) -> HeldTable:
        """Return a table to read from, whose notes and clock are its own."""
        clock = replace(self.ready_clock, notes=list(self.ready_clock.notes))
        return replace(
            self, rows=options.rows, ready_clock=clock, notes=list(self.remarks)
        )

    def even_clock(self, columns: Collection[Column]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) that the file states, and the first row's time (s)."""
        if isinstance(self.stated_rate, InputError):
            raise self.stated_rate
        return self.stated_rate

    def describe(self) -> str:
        """Describe in one line how the log is written."""
        return self.described

    def blocks(self, picks: Mapping[str, Column]) -> Iterator[SampleBlock]:
        """Return the rows asked for as one block; none of them is bad."""
        values = {
            role: self.block.values[str(pick.number)] for role, pick in picks.items()
        }
        block = replace(self.block, values=values).within(self.rows)
        if len(block):
            yield block

    @property
    def sha256(self) -> str | None:
        """The digest of what was read."""
        return self.digest


@dataclass
class ChannelReader:
    """A log whose channels are read together, and handed on one by one.

    Text is read whole, once; of formats whose columns can be read alone, one channel is
    held at a time.

    Parameters
    ----------
    address
        The log.
    options
        How it is to be read.
    patterns
        By the parameter that each was given as.
    digest
        Hash the file, for the provenance of models.

    Raises
    ------
    InputError, UsageError
        As for ``channels_of``, or the log cannot be read.
    """

    address: Address
    options: ReadingOptions
    patterns: Mapping[str, str]
    digest: bool = False
    channels: dict[str, dict[str, Column]] = field(init=False)
    _held: dict[str, HeldTable | None] = field(default_factory=dict)
    _sha256: str | None = None

    def __post_init__(self) -> None:
        """Open the log and find its channels."""
        if any(
            "::" in name for name in (*self.patterns.values(), self.options.time or "")
        ):
            all_of_one = (
                "takes all of them, and the time, from one log: no FILE::COLUMN"
            )
            raise UsageError(f"a pattern of columns {all_of_one}")
        self._table = self._open()
        self._first_notes = list(self._table.notes)
        try:
            columns = self._table.columns
            times = set()
            for column in columns:
                if column.quantity.lower() in (*TIME_NAMES, *MORE_TIME_NAMES):
                    times.add(column.number)
            self.channels = channels_of(
                self._table.place, columns, self.patterns, times
            )
            named: list[Column] = []
            for columns_of_channel in self.channels.values():
                named += columns_of_channel.values()
            self._clock = find_clock(self._table.place, columns, self.options, named)
            self._timed = self._clock.picks
        except BaseException:
            self._table.close()
            raise

    def __iter__(self) -> Iterator[str]:
        """Return the channels in the order of the log."""
        return iter(self.channels)

    def close(self) -> None:
        """Close the log."""
        self._table.close()

    def log(self, channel: str) -> Address:
        """Return the log of one channel, by the log's address: read already, or where it is bad the file."""
        if isinstance(self._table, TextTable):
            if not self._held:
                self._hold(list(self.channels))
            table = self._held.get(channel)
        else:
            self._table.notes[:] = self._first_notes
            table = self._read([channel])[channel]
        if table is None:
            return self.address
        return replace(self.address, table=table)

    def _open(self) -> Table:
        address = self.address.or_format(self.options.format)
        # Read to the end, whatever rows are asked for: a channel's log takes its own
        # rows of what is held.
        whole = replace(self.options, rows=(self.options.rows[0], None), skip_bad=False)
        return open_table(
            Request(address, whole, list(self.patterns.values()), digest=self.digest)
        )

    def _hold(self, channels: Sequence[str]) -> None:
        """Read channels together, or in two halves where a row is bad in one of them."""
        read = self._read(channels)
        if None not in read.values() or len(channels) == 1 or self.address.is_stream:
            self._held |= read
            return
        half = len(channels) // 2
        for part in (channels[:half], channels[half:]):
            self._table.close()
            self._table = self._open()
            self._hold(part)

    def _read(self, channels: Sequence[str]) -> dict[str, HeldTable | None]:
        """Return what channels hold; None for each where any of their rows is bad."""
        picked: dict[int, Column] = {}
        for channel in channels:
            for column in self.channels[channel].values():
                picked[column.number] = column
        picks = {str(number): column for number, column in picked.items()}
        try:
            parts = list(self._table.blocks(picks | self._timed))
        except InputError:
            if self.address.is_stream:
                raise
            return dict.fromkeys(channels)
        if not parts:
            return dict.fromkeys(channels)
        block = joined(parts)
        times = {
            str(column.number): block.values[role]
            for role, column in self._timed.items()
        }
        values = dict(block.values) | times
        return {
            channel: self._table_of(channel, replace(block, values=values))
            for channel in channels
        }

    def _table_of(self, channel: str, block: SampleBlock) -> HeldTable:
        """Return the columns of one channel, and the time, as a table."""
        if self._sha256 is None and self.digest:
            self._sha256 = self._table.sha256 or file_sha256(self.address.path)
        columns = [*self._timed.values(), *self.channels[channel].values()]
        values = {
            str(column.number): block.values[str(column.number)] for column in columns
        }
        return HeldTable(
            place=self._table.place,
            columns=columns,
            described=self._table.describe(),
            block=replace(block, values=values),
            ready_clock=self._clock,
            stated_rate=self._stated_rate(channel),
            digest=self._sha256,
            remarks=tuple(self._table.notes),
        )

    def _stated_rate(self, channel: str) -> tuple[float | None, float] | InputError:
        if self._clock.is_known:
            return None, 0.0
        try:
            return self._table.even_clock(self.channels[channel].values())
        except InputError as problem:
            return problem
