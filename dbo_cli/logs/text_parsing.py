"""From blocks of lines to arrays: fast where a block is regular, careful where it is not.

Three readers, one meaning.  ``_parse_plain`` (pure Python, no import to pay for) and ``_parse_fast`` (polars)
take a block only when every line is a row of the usual width and every wanted cell a finite number;
``_parse_slowly`` takes whatever they refuse, and knows the line, the column and the value of what is wrong.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dbo_cli.errors import InputError
from dbo_cli.logs.cell_grammar import (
    BLANKS,
    SKIP_REMEDY,
    complain,
    decode_line,
    remedy,
    split_cells,
    to_number,
)
from dbo_cli.logs.columns import column_label
from dbo_cli.logs.interrupts import keep_interrupts
from dbo_cli.logs.reading_options import ALL_ROWS, Rows
from dbo_cli.logs.sample_block import ColumnInfo, FloatArray, SampleBlock
from dbo_cli.logs.text_dialect import Dialect, is_comment

PLAIN_BYTES = 1 << 20  # below this, importing polars costs more than it saves (benchmarks/text_speed.py)


@dataclass
class BlockParser:
    """Turns blocks of lines into arrays of the wanted columns, counting rows and lines as it goes.

    ``rows`` limits what is read to data rows first..last (from 1); ``dropped`` counts rows left out by
    ``skip_bad``, ``first_dropped`` keeps the first one's message.
    """

    place: str
    dialect: Dialect
    picks: Mapping[str, ColumnInfo]
    rows: Rows = ALL_ROWS
    skip_bad: bool = False
    dropped: int = 0
    first_dropped: str = ""
    next_row: int = 1
    next_line: int = 1

    def parse(self, blocks: Iterator[bytes], small: bool) -> Iterator[SampleBlock]:
        """Parse blocks of whole lines, starting with the first data row.

        Raises
        ------
        InputError
            A row has another width than the rest, or a wanted cell holds no finite number.
        """
        for block in blocks:
            if self.rows[1] is not None and self.next_row > self.rows[1]:
                return
            if block:
                yield self._in_range(self._parse_block(block, small))

    def _parse_block(self, block: bytes, small: bool) -> SampleBlock:
        # numpy counts what is frequent five times faster than bytes.count
        lines = int(np.count_nonzero(np.frombuffer(block, dtype=np.uint8) == 10)) + (
            not block.endswith(b"\n")
        )
        columns = [pick.number - 1 for pick in self.picks.values()]
        regular = self._regular(block)
        arrays = None
        if regular is not None:
            plain = small or (len(block) < PLAIN_BYTES // 16 and "polars" not in sys.modules)
            read = _parse_plain if plain else _parse_fast
            arrays = read(regular, lines, columns, self.dialect)
        if arrays is None:
            return self._parse_slowly(block)
        found = SampleBlock(
            range(self.next_row, self.next_row + lines),
            range(self.next_line, self.next_line + lines),
            None,
            dict(zip(self.picks, arrays, strict=True)),
        )
        self.next_row += lines
        self.next_line += lines
        return found

    def _regular(self, block: bytes) -> bytes | None:
        """Bring a block into the form that the fast readers take; None where only careful reading will do."""
        mark = self.dialect.delimiter
        if not mark.isascii():
            return None  # the fast readers know single bytes only
        if any(comment.encode() in block for comment in self.dialect.comments):
            return None
        if b"\r" in block:
            block = block.replace(b"\r\n", b"\n")
        if mark == BLANKS:
            return None if b'"' in block else _single_blanks(block)
        if b" " in block:
            delimiter = mark.encode()
            while b" " + delimiter in block:
                block = block.replace(b" " + delimiter, delimiter)
            while b" \n" in block:
                block = block.replace(b" \n", b"\n")
        return block

    def _parse_slowly(self, block: bytes) -> SampleBlock:
        rows: list[int] = []
        lines: list[int] = []
        values: list[list[float]] = []
        text = block.split(b"\n")
        if not text[-1]:
            text.pop()
        for raw in text:
            line = decode_line(raw.removesuffix(b"\r"))
            if not is_comment(line, self.dialect.comments):
                row = self._parse_row(line)
                if row is not None:
                    rows.append(self.next_row)
                    lines.append(self.next_line)
                    values.append(row)
                self.next_row += 1
            self.next_line += 1
        table = np.array(values, dtype=np.float64).reshape(len(values), len(self.picks))
        columns = {role: np.ascontiguousarray(table[:, number]) for number, role in enumerate(self.picks)}
        return SampleBlock(np.array(rows, dtype=np.int64), np.array(lines, dtype=np.int64), None, columns)

    def _parse_row(self, line: str) -> list[float] | None:
        """Read the wanted cells of one line; None for a row that is out of range or dropped."""
        first, last = self.rows
        if self.next_row < first or (last is not None and self.next_row > last):
            return None
        cells = split_cells(line, self.dialect.delimiter)
        problem, help = _wrong_width(cells, self.dialect.width), SKIP_REMEDY
        row: list[float] = []
        if not problem:
            for pick in self.picks.values():
                cell = cells[pick.number - 1] if pick.number <= len(cells) else ""
                value = to_number(cell, self.dialect.decimal)
                if value is None:
                    problem = f"{column_label(pick)} {complain(cell, self.dialect.decimal)}"
                    help = remedy(cell)
                    break
                row.append(value)
        if not problem:
            return row
        message = f"{self.place}:{self.next_line}: {problem}"
        if not self.skip_bad:
            raise InputError(f"{message} {help}")
        self.dropped += 1
        self.first_dropped = self.first_dropped or message
        return None

    def _in_range(self, block: SampleBlock) -> SampleBlock:
        first, last = self.rows
        if len(block.rows) == 0 or (block.rows[0] >= first and (last is None or block.rows[-1] <= last)):
            return block
        rows = np.asarray(block.rows)
        start = int(np.searchsorted(rows, first))
        stop = len(rows) if last is None else int(np.searchsorted(rows, last, side="right"))
        return block.part(start, max(start, stop))


def _wrong_width(cells: list[str], width: int) -> str:
    """Say what is wrong with a row's length; an empty cell more at the end is a trailing delimiter."""
    if len(cells) == width or (len(cells) == width + 1 and not cells[-1]):
        return ""
    plural = "s" if len(cells) != 1 else ""
    return f"{len(cells)} cell{plural} where the other rows have {width}"


def _single_blanks(block: bytes) -> bytes:
    """Collapse runs of blanks and tabs to one blank, and take off those at the ends of lines."""
    if b"\t" in block:
        block = block.replace(b"\t", b" ")
    text = np.frombuffer(block, dtype=np.uint8)
    blank = text == 32
    end = text == 10
    superfluous = blank.copy()
    superfluous[1:] &= blank[:-1] | end[:-1]  # after another blank, or at the start of a line
    superfluous[:-1] |= blank[:-1] & end[1:]  # at the end of a line
    if not superfluous.any():
        return block
    collapsed: bytes = text[~superfluous].tobytes()
    return collapsed.replace(b" \n", b"\n")  # the one blank left of a run at the end of a line


def _is_rectangular(block: bytes, lines: int, dialect: Dialect) -> bool:
    """Check that delimiters and line ends alternate as in a table of ``width`` columns without quotes."""
    text = np.frombuffer(block, dtype=np.uint8)
    marks = text[(text == ord(dialect.delimiter)) | (text == 10)]
    if not block.endswith(b"\n"):
        marks = np.append(marks, np.uint8(10))
    if len(marks) != lines * dialect.width:
        return False
    ends = marks.reshape(lines, dialect.width) == 10
    return bool(ends[:, -1].all()) and np.count_nonzero(ends) == lines


def _parse_plain(block: bytes, lines: int, columns: list[int], dialect: Dialect) -> list[FloatArray] | None:
    """Parse a small regular block without any library; None where it is not regular after all."""
    if b'"' in block or b"_" in block or not block.isascii() or not _is_rectangular(block, lines, dialect):
        return None
    mark = dialect.delimiter.encode()
    cells = block.removesuffix(b"\n").replace(b"\n", mark)
    if dialect.decimal == ",":
        if b"." in cells:
            return None
        cells = cells.replace(b",", b".")
    words = cells.split(mark)
    try:
        arrays = [np.array(list(map(float, words[column :: dialect.width]))) for column in columns]
    except ValueError:
        return None
    return arrays if all(np.isfinite(array).all() for array in arrays) else None


def _parse_fast(block: bytes, lines: int, columns: list[int], dialect: Dialect) -> list[FloatArray] | None:
    """Parse a large block with polars; None where it is not regular after all."""
    import polars

    keep_interrupts()

    whole = len(set(columns)) == dialect.width  # then polars refuses long rows, and short ones leave a null
    if not whole and not _is_rectangular(block, lines, dialect):
        return None
    if dialect.decimal == "," and b"." in block:
        return None
    wanted = sorted(set(columns))
    schema = {
        f"column_{n + 1}": polars.Float64 if n in wanted else polars.String for n in range(dialect.width)
    }
    try:
        table = polars.read_csv(
            block,
            has_header=False,
            schema=schema,
            columns=None if whole else wanted,
            separator=dialect.delimiter,
            decimal_comma=dialect.decimal == ",",
            quote_char='"' if b'"' in block else None,
            encoding="utf8" if block.isascii() else "utf8-lossy",
        )
    except polars.exceptions.PolarsError:
        return None
    if len(table) != lines:
        return None
    series = [table.get_column(f"column_{column + 1}") for column in columns]
    if any(one.null_count() for one in series):
        return None
    arrays = [one.to_numpy() for one in series]
    return arrays if all(np.isfinite(array).all() for array in arrays) else None
