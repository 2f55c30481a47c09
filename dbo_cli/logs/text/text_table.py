"""Delimited text as a table of columns."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dbo_cli.errors import InputError
from dbo_cli.logs.byte_source import ByteSource, Request
from dbo_cli.logs.columns import column_info
from dbo_cli.logs.plain_text import decoded
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.sample_block import TIME, ColumnInfo, SampleBlock, Table, dropped_note
from dbo_cli.logs.text.block_parser import PLAIN_BYTES, BlockParser
from dbo_cli.logs.text.dialect import COMMENTS, Dialect, detect, is_comment
from dbo_cli.logs.text.lines import LineBlocks, is_number, one_ahead, split_cells, to_number

if TYPE_CHECKING:
    from dbo_cli.logs.text.instruments import InstrumentHeader

_NEIGHBOURS = 100  # rows above the last: enough to see how many digits a column has
_USUAL_STEPS = 3.0  # a change this many times the largest one above is not the next sample
_NUMBER = re.compile(r"[+-]?(?P<whole>\d*)(?P<rest>[.,]\d*)?(?:[eEdD](?P<exponent>[+-]?\d*))?")
_LARGEST_BLOCK = 1 << 23  # bytes; 8 MB in memory twice, whatever ``block_rows`` asks for
# One line of names above nothing but numbers: no instrument's header, so its readers need not be loaded.
# A rate in the names (tInc = 2e-6) is theirs.
_PLAIN = re.compile(rb"[^\n=:]*\n[0-9eE+\-.,;\t \r\n]+")


class TextTable(Table):
    """A delimited text log: its dialect and columns at once, its rows in blocks.

    Parameters
    ----------
    request
        What is to be read; its options force parts of the dialect.

    Raises
    ------
    InputError
        The log cannot be read, is empty, or holds no numbers.
    """

    def __init__(self, request: Request) -> None:
        options, live = request.options, request.live
        self.place, self._options = request.address.name, options
        self.notes: list[str] = []
        self.source = ByteSource(request)
        try:
            self._lines = LineBlocks(self.source, _LARGEST_BLOCK)
            head = self._lines.head(lambda text: live and _has_data(text, options))
            self.dialect, self._header = self._detected(head, options, live)
        except BaseException:
            self.source.close()
            raise
        self.columns = self._describe_columns()
        self._small = not live and self._lines.whole_in_head and len(head) < PLAIN_BYTES
        self._bytes_per_row = max(8, len(head) // max(1, head.count(b"\n")))
        self._live = live
        self._ahead = self.source.is_regular and not (live or self._lines.whole_in_head)

    def _detected(
        self, head: bytes | None, options: ReadingOptions, live: bool
    ) -> tuple[Dialect, InstrumentHeader | None]:
        """Detect the dialect and what the instrument states above it, perhaps below pages of remarks."""
        above = self._lines.empty_lines
        if options.skip_lines:
            options = replace(options, skip_lines=max(0, options.skip_lines - above))
        while head is not None:
            whole = self._lines.whole_in_head
            try:
                complete = head if whole else head[: head.rfind(b"\n") + 1]
                if _PLAIN.fullmatch(complete):
                    return detect(self.place, complete, options), None
                from dbo_cli.logs.text.instruments import read_instrument_header

                header = read_instrument_header(self.place, complete, options)
                return header.dialect or detect(self.place, complete, options), header
            except InputError as problem:
                refusal = problem
            head = None if live else self._lines.longer_head()
        raise refusal

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        return f"{self.place}: {self.dialect.describe()}"

    def even_clock(self, columns: Collection[ColumnInfo]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) and the first row's time (s) that an instrument's header states."""
        if self._header is None:
            return None, 0.0
        from dbo_cli.logs.stated_clock import agreed_rate

        return agreed_rate(self.place, self._header.clock, self.notes), self._header.start

    def blocks(self, picks: Mapping[str, ColumnInfo]) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of about ``block_rows`` rows.

        Raises
        ------
        InputError
            At the first bad row, unless ``skip_bad``.
        """
        self._lines.block_bytes = min(_LARGEST_BLOCK, max(64, self._options.block_rows * self._bytes_per_row))
        parser = BlockParser(self.place, self.dialect, picks, self._options.rows, self._options.skip_bad)
        found = parser.parse(self._data(parser), self._small or self._live)
        yield from one_ahead(found) if self._ahead else found
        if parser.repeated is not None and parser.repeated.count:
            self.notes.append(parser.repeated.note(TIME in picks))
        if parser.dropped:
            self.notes.append(dropped_note(parser.first_dropped, parser.dropped))

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for."""
        return self.source.sha256

    def _data(self, parser: BlockParser) -> Iterator[bytes]:
        """Skip the lines above the data, and the instrument's mark of the end."""
        remarks, mark = (self._header.remarks, self._header.end_mark) if self._header else ((), b"")
        self.notes.extend(f"{self.place}: {remark}" for remark in remarks)
        parser.next_line += self._lines.empty_lines
        first = self.dialect.first_line + self._lines.empty_lines
        for block in self._lines:
            if mark and block.rstrip().endswith(mark):
                block = block.rstrip().removesuffix(mark)
            start = 0
            while parser.next_line < first and start < len(block):
                start = block.find(b"\n", start) + 1 or len(block)
                parser.next_line += 1
            rest = block[start:] if start else block
            if rest and (rest.endswith(b"\n") or self._is_whole(rest, parser)):
                yield rest

    def _is_whole(self, last: bytes, parser: BlockParser) -> bool:
        """Judge a last line without its end: True with a note, False where it is dropped, or refuse it."""
        line, row = decoded(last.removesuffix(b"\r")), parser.next_row
        first, final = parser.rows
        if is_comment(line, self.dialect.comments) or row < first or (final is not None and row > final):
            return True
        place = f"{self.place}:{parser.next_line}"
        cell = split_cells(line, self.dialect.delimiter)[-1]
        above = last_cells(self._lines.above, self.dialect)
        why = self.source.unfinished()
        if why is None and not looks_cut(cell, above, self.dialect.decimal):
            self.notes.append(f"{place}: the last line has no line end: was the record cut there?")
            return True
        if why is None:
            why = f"and its last cell {cell[:40]!r} is shorter than those above ({above[-1][:40]!r})"
        message = f"{place}: the last line has no line end, {why}: the record was cut there"
        if not parser.skip_bad:
            out = f"`skip_bad` or `rows` :{max(1, row - 1)} leaves it out"
            raise InputError(f"{message} ({out}; end the line if it is whole)")
        parser.drop(message)
        return False

    def _describe_columns(self) -> list[ColumnInfo]:
        units = self.dialect.units or ("",) * self.dialect.width
        written = self.dialect.writings or ("numbers",) * self.dialect.width
        names = self.dialect.headers or [
            "" if number in self.dialect.numeric or how != "numbers" else "(text)"
            for number, how in enumerate(written)
        ]
        parts = enumerate(zip(names, units, written, strict=True), start=1)
        return [replace(column_info(name, number, unit), written=how) for number, (name, unit, how) in parts]


def _has_data(text: bytes, options: ReadingOptions) -> bool:
    """Return whether a line of numbers has arrived, so that a live log can begin."""
    forced = options.delimiter_character
    comments = COMMENTS if options.comment is None else options.comment
    for raw in text.split(b"\n")[-2::-1]:
        line = decoded(raw)
        if not is_comment(line, comments):
            marks = [forced] if forced else ["\t", ";", ",", " ", "|"]
            if any(
                all(is_number(x, sign) for x in split_cells(line, mark)) for mark in marks for sign in ".,"
            ):
                return True
    return False


def _digits(cell: str) -> tuple[int, int, int] | None:
    """Count a number's digits before and after the decimal sign (-1: no sign) and in the exponent."""
    found = _NUMBER.fullmatch(cell)
    if found is None:
        return None
    decimals = len(found["rest"]) - 1 if found["rest"] is not None else -1
    return len(found["whole"]), decimals, len(found["exponent"] or "")


def last_cells(text: bytes, dialect: Dialect) -> list[str]:
    """Return the last cells of the whole rows in the text above the last line, at most a hundred."""
    cells = []
    for raw in text.split(b"\n")[1:-1][-_NEIGHBOURS:]:
        line = decoded(raw.removesuffix(b"\r"))
        if not is_comment(line, dialect.comments):
            row = split_cells(line, dialect.delimiter)
            if len(row) == dialect.width:
                cells.append(row[-1])
    return cells


def looks_cut(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Return whether a number has visibly fewer digits than all the numbers above it.

    Fewer decimals, or fewer digits in the exponent, than any number above: cut, unless it ends in ``.0`` as
    whole numbers do among numbers of varying length, and goes on from the one above. Fewer digits before the
    decimal sign alone mean nothing (99 follows 100), unless the value leaps as well.
    """
    own = _digits(cell)
    others = [one for one in map(_digits, above) if one is not None]
    if own is None or not others:
        return False
    whole, decimals, exponent = (min(counts) for counts in zip(*others, strict=True))
    if own[2] < exponent:
        return True
    if own[1] < decimals:
        varying = len({one[1] for one in others}) > 1
        return not (varying and cell[-2:] in (".0", ",0") and not _leaps(cell, above, decimal))
    shorter = len(cell) < min(map(len, above)) or own[0] < whole
    return shorter and _leaps(cell, above, decimal)


def _leaps(cell: str, above: Sequence[str], decimal: str) -> bool:
    """Return whether the last number is further from the one above than numbers above are from each other."""
    value = to_number(cell, decimal)
    numbers = [number for number in (to_number(one, decimal) for one in above) if number is not None]
    if value is None or len(numbers) < 2:
        return False
    steps = [abs(later - earlier) for earlier, later in itertools.pairwise(numbers)]
    return abs(value - numbers[-1]) > _USUAL_STEPS * max(steps)
