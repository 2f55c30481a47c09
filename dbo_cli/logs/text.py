"""Delimited text: whole lines become arrays.

How they are written is found by ``dialect.py``. polars reads a block at once
(``fast_text.py``); a block that is not regular is read line by line, and so is a small
file, which does without polars.
"""

import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError
from dbo_cli.logs.cells import DATE, Layout, Marks, split_cells, to_number
from dbo_cli.logs.dialect import find_layout, is_no_row
from dbo_cli.logs.fence import closed_on_error
from dbo_cli.logs.names import are_names, begins_run
from dbo_cli.logs.stream import TextStream
from dbo_cli.logs.table import Column, Reading, Table, parse_rows

_LONGEST_LINE = 1 << 24  # bytes; what is longer has no line ends
_SMALL = 1 << 18  # bytes that are read faster in Python than polars is imported
_TINY = 1 << 12  # bytes that are read faster in Python than by polars


class TextTable(Table):
    """A text log: its columns at once, its rows in blocks.

    ``layout`` is how it is written.
    """

    def __init__(self, stream: TextStream, reading: Reading) -> None:
        super().__init__(stream.name, stream.close)
        self._stream = stream
        self._reading = reading
        self._marks: dict[int, Marks] = {}
        self._size = 0  # bytes of rows
        self._first_row = 1  # of the last block
        self._block_lines = 0  # that it was read from
        with closed_on_error(stream.close):
            self.layout, start = self._find_layout()
        columns = zip(
            self.layout.names, self.layout.units, self.layout.kinds, strict=True
        )
        for name, unit, (kind, sample) in columns:
            self.add(Column(0, name, unit, kind, sample))
        self.settings = self.layout.settings
        self.decimal = self.layout.decimal
        kind, sample = self.layout.kinds[0]
        is_guard = kind in ("number", "stamp") or DATE.search(sample)
        if is_guard or self.layout.has_blank_front:
            self.guard = self.columns[0]
        self._line = self.layout.first + 1  # of the first row in the text
        self._text = start.split(b"\n", self.layout.first)[-1]

    def _find_layout(self) -> tuple[Layout, bytes]:
        """Find the layout on the first text, or (InputError) on all that a pipe brings before it ends."""
        problem = InputError(f"{self.name}: is empty")
        for start in self._stream.heads():
            lines = self._stream.lines(start)
            if not self._stream.ended and len(lines) > 2:
                lines.pop()  # perhaps not whole
            try:
                return find_layout(self.name, lines, self._reading), start
            except InputError as error:
                problem = error
        raise problem

    def blocks(self, columns: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of some columns; see ``Table``."""
        for column in columns:
            if column.kind == "number" and self._reading.decimal is None:
                label = f"{self.name}: {column.label}"
                self._marks[column.number] = Marks(label)
        for text in self._texts():
            self._text = text
            last = self._stream.lines(text[text.rfind(b"\n") + 1 :])[0]
            if not is_no_row(last):
                number = self._line + text.count(b"\n")
                self.remarks.append(
                    f"line {number}, the last one, has no line end: was the record cut there?"
                )
            arrays = self._read_block(text, columns)
            for marks in self._marks.values():
                marks.require_clear(self._first_row + len(arrays[0]) - 1)
            if len(arrays[0]):
                yield arrays
            self._first_row += len(arrays[0])
            self._line += self._block_lines
        for marks in self._marks.values():
            marks.require_clear(self._first_row, limit=0)

    def _texts(self) -> Iterator[bytes]:
        """Return the rows in blocks of whole lines, without those of delimiters at the end of the file."""
        tail, data = b"", self._text
        while not self._stream.ended:
            end = _last_row_end(data, data.rfind(b"\n") + 1)
            if end:
                yield tail + data[:end]
                tail = b""
            tail += data[end:]
            if len(tail) > _LONGEST_LINE:
                raise InputError(
                    f"{self.name}: a line is longer than 16 MB: no text log?"
                )
            data = self._stream.next()
        text = tail + data
        text = text[: _last_row_end(text, len(text))]
        if text:
            yield text

    def _read_block(self, text: bytes, columns: Sequence[Column]) -> list[NDArray[Any]]:
        """Read a block by polars, or line by line where it is small or not regular."""
        self._size += len(text)
        self.torn = []
        frame = None
        is_small = self._size <= _SMALL and "polars" not in sys.modules
        if not is_small and len(text) > _TINY:
            from dbo_cli.logs.fast_text import read_frame

            unclear = [n for n, marks in self._marks.items() if not marks.is_clear]
            frame = read_frame(text, self.layout, columns, unclear)
        if frame is not None:
            self._block_lines = len(frame)
            return [self._array_of(c, frame[str(c.number)]) for c in columns]
        rows, self._block_lines = self._rows_of(text), text.count(b"\n")
        return [self._array_of(c, [row[c.number - 1] for row in rows]) for c in columns]

    def _array_of(self, column: Column, cells: Any) -> NDArray[Any]:
        """Return the cells of a column, texts or a series, as numbers or stamps; NaN for others."""
        if column.kind == "stamp":
            import polars as pl

            from dbo_cli.logs.fast_text import read_stamps

            return read_stamps(pl.Series(cells, dtype=pl.String), column.sample)
        if column.kind == "empty":  # nothing is what it should hold
            return np.array([np.nan if cell else 0.0 for cell in cells])
        if column.kind == "text":
            return np.array([0.0 if DATE.search(cell) else np.nan for cell in cells])
        sign = self.layout.decimal
        marks = self._marks.get(column.number, Marks("", is_clear=True))
        if isinstance(cells, list):
            marks.watch(self._first_row, cells, range(len(cells)))
        else:
            from dbo_cli.logs.fast_text import read_numbers

            if cells.dtype.is_float():
                return np.asarray(cells.to_numpy())
            marks.watch(self._first_row, cells, sorted(cells.arg_unique()))
            numbers = read_numbers(cells, sign)
            if numbers is not None:
                return numbers
        return np.array([to_number(cell, sign) for cell in cells])

    def _is_passed(self, line: str) -> bool:
        """Return whether a line among the rows is blank, a comment, or a row that is commented out."""
        if not is_no_row(line):
            return False
        comment = line.strip("#% \t")
        return self.layout.partly_fits(comment) or not begins_run(comment)

    def _rows_of(self, text: bytes) -> list[list[str]]:
        """Split a block in Python; a row of another width becomes empty cells, another table is refused."""
        rows: list[list[str]] = []
        last = parse_rows(self._reading.rows)[1]
        heads = (self.layout.names, self.layout.units)
        for number, line in enumerate(self._stream.lines(text), self._line):
            if self._is_passed(line):
                continue
            row = self._first_row + len(rows)
            cells = split_cells(line, self.layout.delimiter)
            is_text = line.strip('0123456789+-.,; \t|"') and not is_no_row(line)
            if is_text and are_names(cells) and cells not in heads and row <= last:
                raise InputError(
                    f"{self.name}:{number}: another table begins: cut with `rows` :{row - 1}"
                )
            if len(cells) != self.layout.width:
                self.torn.append(row)
                cells = [""] * self.layout.width
            rows.append(cells)
        return rows

    def where(self, row: int, column: Column, value: object) -> str:
        """Say in which line a row of the last block is, and what stands in a column of it."""
        lines = self._stream.lines(self._text)
        numbers = [k for k, line in enumerate(lines) if not self._is_passed(line)]
        number = numbers[row - self._first_row]
        at = f"{self.name}:{self._line + number}"
        if is_no_row(lines[number]):
            return f"{at}: a comment as above another run: cut with `rows` :{row - 1}"
        cells = split_cells(lines[number], self.layout.delimiter)
        if len(cells) != self.layout.width:
            s = "" if len(cells) == 1 else "s"
            return f"{at}: {len(cells)} cell{s} where the other rows have {self.layout.width}"
        cell = cells[column.number - 1]
        advice = " (`decimal` comma?)" if "," in cell else ""
        noun = "time stamp" if column.kind == "stamp" else "finite number"
        return f"{at}: {column.label} is no {noun}: '{cell[:40]}'{advice}"


def _last_row_end(text: bytes, end: int) -> int:
    """Return where the last row ends: comments and lines of delimiters may end a table."""
    while end:
        begin = text.rfind(b"\n", 0, end - 1) + 1
        line = text[begin:end].decode("latin-1")
        if line.strip("\t ;,|\r\n") and not is_no_row(line):
            break
        end = begin
    return end
