"""Delimited text as a table of columns: from blocks of lines to arrays, fast where a block is regular.

Three readers, one meaning.  ``_parse_plain`` (pure Python, no import to pay for) and
``_parse_fast`` (polars) take a block only when every line is a row of the usual width
and every wanted cell a finite number; ``_parse_slowly`` takes whatever they refuse, and
knows the line, the column and the value of what is wrong.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli import extensions
from dbo_cli.errors import InputError, counted, decoded, shortened
from dbo_cli.logs.clock import agreed_rate
from dbo_cli.logs.columns import column_label
from dbo_cli.logs.request import (
    ALL_ROWS,
    BLANKS,
    PIPE_ROWS,
    ReadingOptions,
    Request,
    Rows,
    import_polars,
    remedy_for,
)
from dbo_cli.logs.sample_block import (
    MOST_NAMED,
    TIME,
    BadRow,
    Column,
    DroppedRows,
    FloatArray,
    Places,
    SampleBlock,
    Table,
    are_measured,
)
from dbo_cli.logs.text.dialect import Dialect, cause_of, detect, has_data
from dbo_cli.logs.text.line_blocks import ByteSource, LineBlocks, one_ahead
from dbo_cli.logs.text.lines import (
    RepeatedHeader,
    complain,
    is_text,
    looks_cut,
)

# below this, importing polars costs more than it saves (benchmarks/text_speed.py)
PLAIN_BYTES = 1 << 20
_NEIGHBOURS = 100  # rows above the last: enough to see how many digits a column has
# bytes; 8 MB in memory twice, whatever ``block_rows`` asks for
_LARGEST_BLOCK = 1 << 23
# One line of names above nothing but numbers: no instrument's header, so its readers
# need not be loaded. A rate in the names (tInc = 2e-6) is theirs.
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
        options = request.options
        live = request.live
        self.place = request.address.name
        self._options = options
        self.notes: list[str] = []
        self.dropped = DroppedRows()
        self.source = ByteSource(request)
        try:
            self._lines = LineBlocks(self.source, _LARGEST_BLOCK)
            head = self._lines.head(lambda text: live and has_data(text, options))
            self.dialect = self._detected(head, options, live)
        except BaseException:
            self.source.close()
            raise
        self.doubtful = []
        for line, text in self.dialect.passed:
            number = line + self._lines.empty_lines
            self.doubtful.append(
                f"line {number}: {shortened(text)!r} is neither a row nor a header"
            )
        self.columns = [self.dialect.column(n) for n in range(self.dialect.width)]
        self._small = live or (self._lines.ended and len(head) < PLAIN_BYTES)
        self._bytes_per_row = max(8, len(head) // max(1, head.count(b"\n")))
        self._ahead = self.source.is_regular and not (live or self._lines.ended)

    def _detected(
        self, head: bytes | None, options: ReadingOptions, live: bool
    ) -> Dialect:
        """Detect the dialect and what the instrument states above it, perhaps below pages of remarks."""
        above = self._lines.empty_lines
        if options.skip_lines:
            options = replace(options, skip_lines=max(0, options.skip_lines - above))
        while head is not None:
            complete = head
            if not self._lines.ended:
                complete = head[: head.rfind(b"\n") + 1]
            try:
                if _PLAIN.fullmatch(complete):
                    return detect(self.place, complete, options)
                read_header = extensions.find_installed("reader", "header") or detect
                dialect: Dialect = read_header(self.place, complete, options)
                return dialect
            except InputError as problem:
                refusal = problem
            if live:
                break
            head = self._lines.longer_head()
        raise refusal

    def describe(self) -> str:
        """Describe in one line how the log is written, for ``verbose``."""
        return f"{self.place}: {self.dialect.describe()}"

    def even_clock(self, columns: Collection[Column]) -> tuple[float | None, float]:
        """Return the sample rate (Hz) and the first row's time (s) that an instrument's header states."""
        rate = agreed_rate(self.place, self.dialect.clock, self.notes)
        return rate, self.dialect.start

    def blocks(self, picks: Mapping[str, Column]) -> Iterator[SampleBlock]:
        """Read the wanted columns in blocks of about ``block_rows`` rows.

        Raises
        ------
        InputError
            At the first bad row, unless ``skip_bad``.
        """
        options = self._options
        rows = options.block_rows
        if not self.source.is_regular:
            rows = min(rows, PIPE_ROWS)
        wanted_bytes = max(64, rows * self._bytes_per_row)
        self._lines.block_bytes = min(_LARGEST_BLOCK, wanted_bytes)
        parser = BlockParser(
            self.place,
            self.dialect,
            picks,
            options.rows,
            options.skip_bad,
            self.dropped,
        )
        blocks = parser.parse(self._data(parser), self._small)
        if self._ahead:
            blocks = one_ahead(blocks)
        if self.dialect.width == 1:
            blocks = self._watched(blocks)
        yield from blocks
        if parser.repeated is not None and parser.repeated.count:
            self.notes.append(parser.repeated.note(TIME in picks))
        if self.dropped.count:
            self.notes.append(self.dropped.note())

    def _watched(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock]:
        """Note empty lines between rows of one column: each may be a cell that is empty."""
        last_row = 0
        last_line = 0
        for block in blocks:
            if len(block) and block.lines is not None:
                rows = np.concatenate([[last_row], block.rows])
                lines = np.concatenate([[last_line], block.lines])
                passed = np.diff(lines) - np.diff(rows)
                if not last_row:
                    passed[0] = 0  # what stands above the data
                left = MOST_NAMED - len(self.doubtful)
                for place in np.flatnonzero(passed)[:left].tolist():
                    self.doubtful.append(
                        f"line {lines[place + 1] - 1}: holds no number between two rows"
                    )
                last_row = int(rows[-1])
                last_line = int(lines[-1])
            yield block

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    @property
    def sha256(self) -> str | None:
        """The digest of what was read, where it was asked for."""
        return self.source.sha256

    def _data(self, parser: BlockParser) -> Iterator[bytes]:
        """Skip the lines above the data, and the instrument's mark of the end."""
        self.notes.extend(f"{self.place}: {remark}" for remark in self.dialect.notes)
        mark = self.dialect.end_mark
        parser.next_line += self._lines.empty_lines
        first = self.dialect.first_line + self._lines.empty_lines
        for block in self._lines:
            if mark and block.rstrip().endswith(mark):
                block = block.rstrip().removesuffix(mark)
            start = 0
            while parser.next_line < first and start < len(block):
                start = block.find(b"\n", start) + 1 or len(block)
                parser.next_line += 1
            rest = block
            if start:
                rest = block[start:]
            if rest and (rest.endswith(b"\n") or self._is_whole(rest, parser)):
                yield rest

    def _is_whole(self, last: bytes, parser: BlockParser) -> bool:
        """Judge a last line without its end: True with a note, False where it is dropped, or refuse it."""
        line = decoded(last.removesuffix(b"\r"))
        row = parser.next_row
        dialect = self.dialect
        if dialect.is_comment(line) or not parser.is_wanted(row):
            return True
        place = f"{self.place}:{parser.next_line}"
        cell = dialect.cells(line)[-1]
        above = []  # the last cells of the rows above
        for raw in self._lines.above.split(b"\n")[1:-1][-_NEIGHBOURS:]:
            text = decoded(raw)
            cells = dialect.cells(text)
            if len(cells) == dialect.width and not dialect.is_comment(text):
                above.append(cells[-1])
        why = self.source.unfinished()
        if why is None and not looks_cut(cell, above, dialect.decimal):
            self.notes.append(
                f"{place}: the last line has no line end: was the record cut there?"
            )
            return True
        if why is None:
            why = f"and its last cell {cell[:40]!r} is shorter than those above ({above[-1][:40]!r})"
        bad = BadRow(
            row,
            place,
            f"the last line has no line end, {why}: the record was cut there",
        )
        if not parser.skip_bad:
            out = f"`skip_bad` or `rows` :{max(1, row - 1)} leaves it out"
            raise InputError(f"{bad} ({out}; end the line if it is whole)")
        parser.dropped.add(bad)
        return False


# --- blocks of lines to arrays ---

_DIGIT = re.compile(r"\d")
# bytes; what fits the cache is looked through three times as fast as 8 MB
_AT_ONCE = 1 << 17


@dataclass
class BlockParser:
    """Turns blocks of lines into arrays of the wanted columns, counting rows and lines as it goes.

    ``rows`` limits what is read to data rows first..last (from 1); ``dropped`` are the
    rows that ``skip_bad`` left out.
    """

    place: str
    dialect: Dialect
    picks: Mapping[str, Column]
    rows: Rows = ALL_ROWS
    skip_bad: bool = False
    dropped: DroppedRows = field(default_factory=DroppedRows)
    next_row: int = 1
    next_line: int = 1
    repeated: RepeatedHeader | None = None
    # The lines that follow in a block that is taken line by line.
    ahead: Iterator[bytes] = field(default_factory=lambda: iter(()))

    def __post_init__(self) -> None:
        """Prepare for headers among the data."""
        if self.dialect.repeated_header is not None:
            self.repeated = replace(self.dialect.repeated_header, place=self.place)

    def parse(self, blocks: Iterator[bytes], small: bool) -> Iterator[SampleBlock]:
        """Parse blocks of whole lines, starting with the first data row.

        Raises
        ------
        InputError
            A row has another width than the rest, or a wanted cell holds no finite
            number.
        """
        for block in blocks:
            if self.rows[1] is not None and self.next_row > self.rows[1]:
                return
            if block[:1] == b"\n" and not block.strip(b"\n"):
                # a compressed megabyte may unpack to a billion empty lines
                self.next_line += len(block)
            elif block:
                parsed = self._parse_regularly(block, small)
                if parsed is None:
                    parsed = self._parse_slowly(block)
                yield parsed.within(self.rows)

    def is_wanted(self, row: int) -> bool:
        """Return whether a data row (from 1) is among those that are read."""
        first, last = self.rows
        return first <= row and (last is None or row <= last)

    def _parse_regularly(self, block: bytes, small: bool) -> SampleBlock | None:
        """Take a block at once where every line of it is a good row or empty; else None."""
        mark = self.dialect.delimiter
        comments = self.dialect.comments
        if not mark.isascii() or any(comment.encode() in block for comment in comments):
            return None  # the fast readers know single bytes only, and no comments
        text = block
        if b"\r" in text:
            text = text.replace(b"\r\n", b"\n")
        if mark == BLANKS:
            if b'"' in text:
                return None
            text = text.replace(b"\t", b" ")
        if b" " in text:
            text = _without_blanks(text, mark)
        ends, marks, has_empty_line = _counts(text, ord(mark))
        lines = ends + (not text.endswith(b"\n"))
        numbers: Places = range(self.next_line, self.next_line + lines)
        if has_empty_line:
            text, filled = _without_empty_lines(text)
            numbers = self.next_line + filled
        if marks > 2 * len(numbers) * self.dialect.width + 100:
            # polars takes hundreds of bytes for every cell of a line of delimiters
            return None
        if not text:
            return None
        arrays = self._columns(text, len(numbers), small)
        if arrays is None:
            return None
        rows = range(self.next_row, self.next_row + len(numbers))
        self.next_row += len(numbers)
        self.next_line += lines
        return SampleBlock(
            rows, numbers, None, dict(zip(self.picks, arrays, strict=True))
        )

    def _columns(self, text: bytes, lines: int, small: bool) -> list[FloatArray] | None:
        """Read the wanted columns of a regular block; None where it is not regular after all."""
        picks = list(self.picks.values())
        plain = small or (len(text) < PLAIN_BYTES // 16 and "polars" not in sys.modules)
        stamped = {pick.written for pick in picks} != {"numbers"}
        read = _parse_plain if plain or stamped else _parse_fast
        if self.dialect.decimal == "," and b"." in text:
            return None
        # With all columns wanted polars itself refuses long rows, and short ones leave
        # a null.
        whole = (
            read is _parse_fast
            and len({pick.number for pick in picks}) == self.dialect.width
        )
        if not whole and not _is_rectangular(text, lines, self.dialect):
            return None
        if _has_text_in(self._unpicked, text, self.dialect):
            return None
        arrays = read(text, lines, picks, self.dialect)
        if arrays is not None and self.repeated is not None and TIME in self.picks:
            at = list(self.picks).index(TIME)
            arrays[at] = self.repeated.continued(arrays[at])
        return arrays

    def _parse_slowly(self, block: bytes) -> SampleBlock:
        """Take a block line by line."""
        time = None  # the place of the time among the picks
        if TIME in self.picks:
            time = list(self.picks).index(TIME)
        places: list[tuple[int, int]] = []
        values: list[list[float]] = []
        self.ahead = iter(block.removesuffix(b"\n").split(b"\n"))
        for number, raw in enumerate(self.ahead, start=self.next_line):
            self.next_line = number
            line = decoded(raw.removesuffix(b"\r"))
            if raw and self.repeated is not None and self.repeated.takes(line, number):
                continue
            if raw and self.dialect.is_comment(line):
                self._refuse_other_columns(line)
            elif raw:
                row = self._parse_row(line)
                if row is not None:
                    if time is not None and self.repeated is not None:
                        stamp = np.array([row[time]])
                        row[time] = float(self.repeated.continued(stamp)[0])
                    places.append((self.next_row, self.next_line))
                    values.append(row)
                self.next_row += 1
        self.next_line += 1
        rows, lines = np.array(places, dtype=np.int64).reshape(-1, 2).T
        table = np.array(values, dtype=np.float64).reshape(len(values), len(self.picks))
        columns = np.ascontiguousarray(table.T)
        return SampleBlock(
            rows, lines, None, dict(zip(self.picks, columns, strict=True))
        )

    def _refuse_other_columns(self, line: str) -> None:
        """Refuse a comment that names other columns than the one above the data (InputError)."""
        change = self.dialect.renamed(line)
        if change is not None and self.next_row <= (self.rows[1] or sys.maxsize):
            raise InputError(
                f"{self.place}:{self.next_line}: the columns change here, from {change[0]} to {change[1]} "
                f"(`rows` :{self.next_row - 1} reads what is above)"
            )

    def _parse_row(self, line: str) -> list[float] | None:
        """Read the wanted cells of one line; None for a row that is out of range, blank or dropped."""
        if not self.is_wanted(self.next_row):
            return None
        cells = self.dialect.cells(line)
        width = self.dialect.width
        row: list[float] = []
        cell = "-"
        blank = False
        problem = ""
        trailing = len(cells) == width + 1 and (self.dialect.remarks or not cells[-1])
        if len(cells) != width and not trailing:
            problem = f"{counted(len(cells), 'cell')} where the other rows have {width}"
        else:
            for pick in self.picks.values():
                cell = cells[pick.number - 1]
                if not cell and pick.may_be_blank:
                    blank = True
                    continue
                value = self.dialect.value(cell, pick.written)
                if value is None:
                    wrong = complain(cell, self.dialect.decimal, pick.written)
                    problem = f"{column_label(pick)} {wrong}"
                    break
                row.append(value)
        problem = problem or self._text_among_numbers(cells)
        if not problem:
            return None if blank else row
        bad = BadRow(self.next_row, f"{self.place}:{self.next_line}", problem)
        if not self.skip_bad:
            raise InputError(f"{bad} {self._remedy(cell)}")
        self.dropped.add(bad)
        return None

    def _remedy(self, cell: str) -> str:
        """Return what to do about the row being taken, by how many of the block's next rows are bad, too."""
        twin = replace(self, skip_bad=True, rows=ALL_ROWS, dropped=DroppedRows())
        rows = 0
        for raw in filter(None, self.ahead):
            text = decoded(raw.removesuffix(b"\r"))
            if not self.dialect.is_comment(text):
                twin._parse_row(text)
                rows += 1
        return remedy_for(twin.dropped.count, rows, cause_of(cell))

    def _text_among_numbers(self, cells: list[str]) -> str:
        """Describe where text stands in a column of numbers that nobody asked for: no sample has it."""
        for column in self._unpicked:
            numeric = column in self.dialect.numeric
            if column < len(cells) and _is_text_in(
                cells[column], numeric, self.dialect
            ):
                label = column_label(self.dialect.column(column))
                written = self.dialect.written(column)
                wrong = complain(cells[column], self.dialect.decimal, written)
                return f"{label} {wrong}"
        return ""

    @cached_property
    def _unpicked(self) -> list[int]:
        """The columns of numbers or time stamps (from 0) that are not read."""
        writings = enumerate(self.dialect.writings)
        stamps = {index for index, written in writings if written != "numbers"}
        picked = {pick.number - 1 for pick in self.picks.values()}
        return sorted((self.dialect.numeric | stamps) - picked)


def _without_empty_lines(block: bytes) -> tuple[bytes, NDArray[np.int64]]:
    """Leave out empty lines; return the rest and which lines (from 0) it holds."""
    text = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(text == 10)
    empty = np.diff(ends, prepend=-1) == 1
    stays = np.ones(len(text), dtype=bool)
    stays[ends[empty]] = False
    filled = np.flatnonzero(~empty)
    if not block.endswith(b"\n"):
        filled = np.append(filled, len(ends))
    return text[stays].tobytes(), filled.astype(np.int64)


def _without_blanks(block: bytes, delimiter: str) -> bytes:
    """Make one blank of every run of them, and take off those before a delimiter or the end of a line.

    Polars and float() do without those after a delimiter. The time does not depend on
    how long the runs are.
    """
    if b"  " in block:
        text = np.frombuffer(block, dtype=np.uint8)
        blank = text == 32
        blank[1:] &= blank[:-1]
        blank[0] = False
        block = text[~blank].tobytes()
    block = block.replace(b" \n", b"\n")
    if delimiter == BLANKS:
        return block.replace(b"\n ", b"\n").removeprefix(b" ")
    return block.replace(b" " + delimiter.encode(), delimiter.encode())


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


def _counts(block: bytes, mark: int) -> tuple[int, int, bool]:
    """Count line ends and another letter, and tell whether a line end stands first or behind another.

    Numpy counts what is frequent five times faster than bytes.count, and ``in`` looks
    ten times as long.
    """
    text = np.frombuffer(block, dtype=np.uint8)
    lines = 0
    marks = 0
    empty = block[:1] == b"\n"
    for start in range(0, len(text), _AT_ONCE):
        part = text[start : start + _AT_ONCE]
        ends = part == 10
        lines += int(np.count_nonzero(ends))
        marks += int(np.count_nonzero(part == mark))
        empty = empty or bool(
            (ends[1:] & ends[:-1]).any() or block[start - 1 : start + 1] == b"\n\n"
        )
    return lines, marks, empty


def _has_text_in(columns: Sequence[int], block: bytes, dialect: Dialect) -> bool:
    """Return whether one of the columns (from 0) holds text somewhere in a rectangular block."""
    if not columns:
        return False
    text = np.frombuffer(block, dtype=np.uint8)
    # no digit, sign or blank; nor an exponent's e (101) or a delimiter
    letters = np.flatnonzero(text >= 64)
    characters = text[letters]
    letters = letters[
        ((characters | 32) != 101) & (characters != ord(dialect.delimiter))
    ]
    if not len(letters):
        return False
    ends = np.flatnonzero((text == ord(dialect.delimiter)) | (text == 10))
    wanted, numeric = np.zeros((2, dialect.width), dtype=bool)
    wanted[columns] = True
    numeric[list(dialect.numeric)] = True
    cells = np.searchsorted(ends, letters)
    # each cell once
    cells = cells[(np.diff(cells, prepend=-1) > 0) & wanted[cells % dialect.width]]
    starts = np.where(cells > 0, ends[cells - 1] + 1, 0)
    digit = (text[starts] >= 48) & (text[starts] <= 57)
    # time stamps with a T are many, and no text
    doubtful = numeric[cells % dialect.width] | ~digit
    stops = np.append(ends, len(block))[cells]
    places = np.stack([starts, stops, cells % dialect.width])[:, doubtful]
    # each text once, with whether its column holds numbers
    words = {
        (block[start:stop], column in dialect.numeric)
        for start, stop, column in places.T.tolist()
    }
    for word, is_numeric in words:
        if _is_text_in(decoded(word).strip(), is_numeric, dialect):
            return True
    return False


def _is_text_in(cell: str, numeric: bool, dialect: Dialect) -> bool:
    """Return whether a cell holds words where its column has numbers, or time stamps (which have digits)."""
    return (numeric or not _DIGIT.search(cell)) and is_text(cell, dialect.decimal)


def _parse_plain(
    block: bytes, lines: int, picks: list[Column], dialect: Dialect
) -> list[FloatArray] | None:
    """Parse a small rectangular block without any library; None where a cell needs a careful look."""
    if b'"' in block or b"_" in block or not block.isascii():
        return None
    mark = dialect.delimiter.encode()
    cells = block.removesuffix(b"\n").replace(b"\n", mark)
    if dialect.decimal == ",":
        cells = cells.replace(b",", b".")
    words = cells.split(mark)
    try:
        arrays = []
        for pick in picks:
            column = words[pick.number - 1 :: dialect.width]
            numbers = list(map(_reader(pick, dialect), column))
            arrays.append(np.array(numbers, dtype=np.float64))
    except (
        ValueError,
        TypeError,
    ):  # a cell that is none: float() raises, a reader of stamps gives None
        return None
    for array in arrays:
        if not are_measured(array).all():
            return None
    return arrays


def _reader(pick: Column, dialect: Dialect) -> Callable[[bytes], float | None]:
    """Return what reads the cells of a column."""
    if pick.written == "numbers":
        return float
    return lambda cell: dialect.value(cell.decode().strip(), pick.written)


def _parse_fast(
    block: bytes, lines: int, picks: list[Column], dialect: Dialect
) -> list[FloatArray] | None:
    """Parse a large rectangular block with polars; None where a cell needs a careful look."""
    polars = import_polars()
    columns = sorted({pick.number - 1 for pick in picks})
    schema: dict[str, Any] = {
        f"column_{n + 1}": polars.String for n in range(dialect.width)
    }
    schema |= {f"column_{n + 1}": polars.Float64 for n in columns}
    try:
        table = polars.read_csv(
            block,
            has_header=False,
            schema=schema,
            columns=columns
            if len(columns) < dialect.width
            else None,  # all: short rows leave a null
            separator=dialect.delimiter,
            decimal_comma=dialect.decimal == ",",
            quote_char='"' if b'"' in block else None,
            encoding="utf8" if block.isascii() else "utf8-lossy",
        )
    except polars.exceptions.PolarsError:
        return None
    if len(table) != lines:
        return None
    arrays = []
    for pick in picks:
        read = table.get_column(f"column_{pick.number}")
        array = read.to_numpy()
        if read.null_count() or not are_measured(array).all():
            return None
        arrays.append(array)
    return arrays
