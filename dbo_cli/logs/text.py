"""Delimited text: bytes to blocks of whole lines, and these to arrays.

polars reads a block at once (``fast_text.py``). A block that is not regular is read
line by line. A small file is read line by line at once, and does without polars.
"""

from __future__ import annotations

import codecs
import sys
from collections.abc import Iterator, Sequence
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.cells import is_number, split_cells, to_number, to_stamp
from dbo_cli.logs.sniff import (
    describe_columns,
    is_blank_row,
    is_comment,
    is_no_row,
    sniff,
)
from dbo_cli.logs.source import NOT_A_TIME, Column, Reading, Source
from dbo_cli.logs.stream import ByteStream

_HEAD = 1 << 16  # bytes from which the layout is found; longer than any header
_BLOCK = 1 << 22  # bytes of text at a time; of 1 to 4 MB the fastest
_EDGE = 1 << 14  # bytes in which labelled rows are looked for
_LONGEST_LINE = 1 << 24  # what is longer has no line ends
_SMALL = 1 << 18  # bytes that are read faster in Python than polars is imported
_TINY = 1 << 12  # bytes that are read faster in Python than by polars
_MARKS = {
    codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be",
}  # fmt: skip
_ASCII = ("utf-8", "cp1252", "ascii", "iso8859-1")  # their digits and signs are ASCII's


def open_text(name: str, part: str, reading: Reading) -> TextSource:
    """Open a text log; see ``Source``.

    Raises
    ------
    InputError
        It cannot be read, or it is not clear how it is written.
    """
    if part:
        raise UsageError(
            f"{name}::{part}: '::' names a part of a file, and this is a text file"
        )
    return TextSource(ByteStream(name), reading)


class TextSource(Source):
    """A text log: its columns at once, its rows in blocks."""

    def __init__(self, stream: ByteStream, reading: Reading) -> None:
        super().__init__(stream.name, ())
        self._stream = stream
        self._encoding = ""
        self._decoder: Any = None
        self._mac = False
        self._reading = reading
        self._ended = False
        self._text = b""  # the last block, and the number of its first line
        self._line = 1
        self._seen = 0  # bytes of rows
        try:
            self._open()
        except BaseException:
            stream.close()
            raise

    def _open(self) -> None:
        """Read the first lines, and find out how the text is written."""
        self._head = self._read_head()
        lines = self._lines_of(self._head)
        if not self._ended and len(lines) > 2:
            lines.pop()  # perhaps not whole
        self.layout = sniff(self.name, lines, self._reading)
        self.columns = describe_columns(self.name, self.layout)
        self.stated = self.layout.clock

    # --- bytes to whole lines ---

    def _read_head(self) -> bytes:
        """Read the first lines; from a pipe what has arrived once it holds a row."""
        head = b""
        while len(head) < _HEAD:
            data = self._stream.read(_HEAD - len(head))
            self._ended = not data
            head += data
            if self._ended or (self._stream.is_pipe and self._is_enough(head)):
                break
        self._encoding = self._find_encoding(head)
        for mark in _MARKS:
            if head.startswith(mark):
                head = head.removeprefix(mark)
        if self._encoding not in _ASCII:
            self._decoder = codecs.getincrementaldecoder(self._encoding)(
                errors="replace"
            )
        self._mac = b"\r" in head[:-1] and b"\n" not in head
        return self._plain(head)

    def _is_enough(self, head: bytes) -> bool:
        """Return whether a pipe has paused behind a row."""
        if self._stream.has_more() or not head.endswith(b"\n"):
            return False
        try:
            self._encoding = self._find_encoding(head)
            sniff(self.name, self._lines_of(head), self._reading)
        except InputError:
            return False
        return True

    def _find_encoding(self, head: bytes) -> str:
        """Return the encoding: by a mark, by NULs (UTF-16), UTF-8, else Western.

        Raises
        ------
        InputError
            The file is binary.
        UsageError
            The encoding that the user names is not known.
        """
        if self._reading.encoding is not None:
            try:
                named = codecs.lookup(self._reading.encoding).name
            except LookupError:
                raise UsageError(
                    f"`encoding` {self._reading.encoding}: there is no such text encoding"
                ) from None
            if named not in ("utf-16", "utf-32"):  # else the mark tells more
                return named
        for mark, name in _MARKS.items():
            if head.startswith(mark):
                return name
        even, odd = head[0:200:2].count(0), head[1:200:2].count(0)
        if even or odd:
            if min(even, odd) == 0 and max(even, odd) > 0.4 * len(head[0:200:2]):
                return "utf-16-be" if even else "utf-16-le"
            raise InputError(
                f"{self.name}: this is a binary file, not a text log: export it as CSV or HDF5"
            )
        try:
            codecs.getincrementaldecoder("utf-8")().decode(head)
        except UnicodeDecodeError:
            return "cp1252"
        return "utf-8"

    def _plain(self, data: bytes) -> bytes:
        """Turn bytes into a superset of ASCII with plain line ends."""
        if self._decoder is not None:
            data = self._decoder.decode(data, final=self._ended).encode()
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n")
            if self._mac:
                data = data.replace(b"\r", b"\n")
        return data

    def _lines_of(self, text: bytes) -> list[str]:
        encoding = self._encoding if self._encoding == "cp1252" else "utf-8"
        return text.decode(encoding, errors="replace").split("\n")

    def _texts(self) -> Iterator[bytes]:
        """Return the whole text in blocks of whole lines."""
        data, tail = self._head, b""
        self._head = b""
        if not self._ended and not self._stream.is_pipe:
            data += self._next(_BLOCK)
        while True:
            # the last rows must be known as such, where nobody waits for them
            ahead = None
            if not self._ended and self._stream.has_more():
                ahead = self._next(_BLOCK)
            end = data.rfind(b"\n") + 1
            if self._ended:
                end = len(data)
            if end or self._ended:
                yield b"".join((tail, memoryview(data)[:end]))
                tail = data[end:]
            else:
                tail += data
            if self._ended:
                return
            if len(tail) > _LONGEST_LINE:
                raise InputError(
                    f"{self.name}: a line is longer than 16 MB: no text log?"
                )
            data = self._next(_BLOCK) if ahead is None else ahead

    def _next(self, size: int) -> bytes:
        data = self._stream.read(size)
        self._ended = not data
        return self._plain(data)

    # --- lines to arrays ---

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Source``."""
        for text in self._texts():
            if self._line <= self.layout.first:
                text = self._below_header(text)
            if not text:
                continue
            if self._ended:
                text = self._without_blank_rows(text)
                self._doubt_last_line(text)
            self._text = text
            arrays, lines = self._read_block(text, chosen)
            arrays = self._without_labelled(text, arrays)
            if len(arrays[0]):
                yield arrays
            self.first_row += len(arrays[0])
            self._line += lines

    def _doubt_last_line(self, text: bytes) -> None:
        """Say that a row at the end has no line end."""
        last = self._lines_of(text[text.rfind(b"\n") + 1 :])[0]
        if not is_comment(last):
            number = self._line + text.count(b"\n")
            self.remarks.append(
                f"line {number}, the last one, has no line end: was the record cut there?"
            )

    def _below_header(self, text: bytes) -> bytes:
        """Return the rows of a text that begins above them."""
        parts = text.split(b"\n", self.layout.first + 1 - self._line)
        self._line += len(parts) - 1
        return parts[-1] if self._line > self.layout.first else b""

    def _without_blank_rows(self, text: bytes) -> bytes:
        """Leave out rows of delimiters at the end of a file."""
        while b"\n" in text:
            last = text.rfind(b"\n", 0, len(text) - 1) + 1
            line = self._lines_of(text[last:])[0]
            if not line.strip() or not is_blank_row(line):
                break
            text = text[:last]
        return text

    def _without_labelled(
        self, text: bytes, arrays: list[NDArray[Any]]
    ) -> list[NDArray[Any]]:
        """Make bad the rows of settings and statistics above and below all others (``Max;95;12,6``)."""
        first = self._data_lines(text[:_EDGE]) if self.first_row == 1 else []
        last = self._data_lines(text[-_EDGE:]) if self._ended else []
        bad = self._count_labelled(first), self._count_labelled(last[::-1])
        if not any(bad):
            return arrays
        arrays = [array.copy() for array in arrays]
        for array in arrays:
            missing = NOT_A_TIME if array.dtype.kind == "i" else np.nan
            array[: bad[0]] = missing
            array[len(array) - bad[1] :] = missing
        return arrays

    def _count_labelled(self, lines: Sequence[str]) -> int:
        """Count the lines before the first one that does not begin with a label."""
        rows = (split_cells(line, self.layout.delimiter) for line in lines)
        return sum(1 for _ in takewhile(self.layout.is_labelled, rows))

    def _read_block(
        self, text: bytes, chosen: Sequence[Column]
    ) -> tuple[list[NDArray[Any]], int]:
        """Read a block by polars, or line by line where it is small or not regular; count its lines."""
        self._seen += len(text)
        if len(text) <= _TINY or (self._seen <= _SMALL and "polars" not in sys.modules):
            return self._read_lines(text, chosen), text.count(b"\n")
        from dbo_cli.logs.fast_text import read_fast

        if 0 in self.layout.numeric:  # a comment is no row
            arrays = read_fast(text, self.layout, chosen)
            if arrays is not None:
                return arrays, len(arrays[0])
        arrays = read_fast(text, self.layout, chosen, cleaned=True)
        if arrays is None:
            arrays = self._read_lines(text, chosen)
        return arrays, text.count(b"\n")

    def _data_lines(self, text: bytes) -> list[str]:
        return [line for line in self._lines_of(text) if not is_no_row(line)]

    def _read_lines(self, text: bytes, chosen: Sequence[Column]) -> list[NDArray[Any]]:
        """Read a block in Python; other cells become NaN."""
        sign = self.layout.decimal
        width, delimiter = self.layout.width, self.layout.delimiter
        lines = self._data_lines(text)
        arrays: list[NDArray[Any]] = []
        rows = [split_cells(line, delimiter) for line in lines]
        for column in chosen:
            n = column.number - 1
            values: NDArray[Any] = np.full(len(rows), np.nan)
            if column.kind == "stamp":
                values = np.full(len(rows), NOT_A_TIME, dtype=np.int64)
            for k, cells in enumerate(rows):
                if len(cells) == width and column.kind == "stamp":
                    values[k] = to_stamp(cells[n], self.layout.stamps[n])
                elif len(cells) == width:
                    values[k] = to_number(cells[n], sign)
            arrays.append(values)
        return arrays

    def where(self, row: int, column: Column) -> str:
        """Say in which line a row of the last block is, and what stands in a column of it."""
        lines = self._lines_of(self._text)
        places = [k for k, line in enumerate(lines) if not is_no_row(line)]
        place = places[row - self.first_row]
        at = f"{self.name}:{self._line + place}"
        cells = split_cells(lines[place], self.layout.delimiter)
        if len(cells) != self.layout.width:
            s = "" if len(cells) == 1 else "s"
            return f"{at}: {len(cells)} cell{s} where the other rows have {self.layout.width}"
        cell = cells[column.number - 1]
        if is_number(cell, self.layout.decimal) and self.layout.is_labelled(cells):
            return f"{at}: '{cells[0]}' stands where the other rows have a number or a time"
        if not cell:
            return f"{at}: {column.label} is empty"
        wanted = "a known time stamp" if column.kind == "stamp" else "a measured number"
        advice = " (`decimal` comma?)" if "," in cell else ""
        return f"{at}: {column.label} is not {wanted}: '{cell[:40]}'{advice}"

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
