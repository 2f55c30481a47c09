"""Delimited text as a table of columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from dbo_cli.logs.addresses import Address
from dbo_cli.logs.background_io import one_ahead
from dbo_cli.logs.byte_source import ByteSource, LineBlocks
from dbo_cli.logs.cell_grammar import decode_line, is_number, split_cells
from dbo_cli.logs.columns import column_info
from dbo_cli.logs.reading_options import ReadingOptions, Rows
from dbo_cli.logs.sample_block import ColumnInfo, SampleBlock
from dbo_cli.logs.text_dialect import COMMENTS, detect, is_comment
from dbo_cli.logs.text_parsing import PLAIN_BYTES, BlockParser

_LARGEST_BLOCK = 1 << 23


class TextTable:
    """A delimited text log: its dialect and columns at once, its rows in blocks.

    Parameters
    ----------
    address
        Where to read from.
    options
        What the user forces about the dialect.
    live
        Give each row as it arrives.
    digest
        Hash what is read.

    Raises
    ------
    InputError
        The log cannot be read, is empty, or holds no numbers.
    """

    def __init__(
        self, address: Address, options: ReadingOptions, *, live: bool = False, digest: bool = False
    ) -> None:
        self.place = address.name
        self.sample_rate: float | None = None
        self.notes: list[str] = []
        self.source = ByteSource(address, live=live, digest=digest, encoding=options.encoding)
        try:
            self._lines = LineBlocks(self.source, _LARGEST_BLOCK)
            head = self._lines.head(lambda text: live and _has_data(text, options))
            complete = head if self._lines.whole_in_head else head[: head.rfind(b"\n") + 1]
            self.dialect = detect(self.place, complete, options)
        except BaseException:
            self.source.close()
            raise
        self.columns = self._describe_columns()
        self._small = not live and self._lines.whole_in_head and len(head) < PLAIN_BYTES
        self._bytes_per_row = max(8, len(head) // max(1, head.count(b"\n")))
        self._live = live
        self._ahead = self.source.is_regular and not (live or self._lines.whole_in_head)

    def describe(self) -> str:
        """Tell in one line how the log is written, for ``verbose``."""
        return f"{self.place}: {self.dialect.describe()}"

    def blocks(
        self, picks: Mapping[str, ColumnInfo], rows: Rows, skip_bad: bool, block_rows: int
    ) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of about ``block_rows`` rows.

        Raises
        ------
        InputError
            At the first bad row, unless ``skip_bad``.
        """
        self._lines.block_bytes = min(_LARGEST_BLOCK, max(64, block_rows * self._bytes_per_row))
        parser = BlockParser(self.place, self.dialect, picks, rows, skip_bad)
        found = parser.parse(self._data(parser), self._small or self._live)
        yield from one_ahead(found) if self._ahead else found
        if parser.dropped:
            rest = f" and {parser.dropped - 1} more" if parser.dropped > 1 else ""
            plural = "s" if parser.dropped > 1 else ""
            self.notes.append(f"{parser.first_dropped}{rest}: {parser.dropped} row{plural} dropped")

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for."""
        return self.source.sha256

    def _data(self, parser: BlockParser) -> Iterator[bytes]:
        """Skip the lines above the data."""
        for block in self._lines:
            rest = block
            while parser.next_line < self.dialect.first_line and rest:
                rest = rest[rest.find(b"\n") + 1 :] if b"\n" in rest else b""
                parser.next_line += 1
            if rest:
                yield rest

    def _describe_columns(self) -> list[ColumnInfo]:
        names = self.dialect.headers or ("",) * self.dialect.width
        units = self.dialect.units or ("",) * self.dialect.width
        described = zip(names, units, strict=True)
        return [column_info(name, number, unit) for number, (name, unit) in enumerate(described, start=1)]


def _has_data(text: bytes, options: ReadingOptions) -> bool:
    """Tell whether a line of numbers has arrived, so that a live log can begin."""
    forced = options.delimiter_character
    comments = COMMENTS if options.comment is None else options.comment
    for raw in text.split(b"\n")[-2::-1]:
        line = decode_line(raw)
        if not is_comment(line, comments):
            marks = [forced] if forced else ["\t", ";", ",", " ", "|"]
            if any(
                all(is_number(x, sign) for x in split_cells(line, mark)) for mark in marks for sign in ".,"
            ):
                return True
    return False
