"""Delimited text: bytes to blocks of whole lines, and these to arrays.

polars reads a block at once (``fast_text.py``). A block that is not regular is read
line by line. A small file is read line by line at once, and does without polars.
"""

from __future__ import annotations

import codecs
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.cells import split_cells, to_number
from dbo_cli.logs.names import begins_run, describe_columns
from dbo_cli.logs.sniff import is_no_row, sniff
from dbo_cli.logs.stream import ByteStream
from dbo_cli.logs.table import Column, Reading, Table

_HEAD = 1 << 16  # bytes from which the layout is found; longer than any header
_BLOCK = 1 << 22  # bytes of text at a time; of 1 to 8 MB the fastest
_LONGEST_LINE = 1 << 24  # what is longer has no line ends
_SMALL = 1 << 18  # bytes that are read faster in Python than polars is imported
_TINY = 1 << 12  # bytes that are read faster in Python than by polars
_COMMENT = re.compile(rb"(?m)^[ \t]*[#%].*\n?")
_ASCII = ("utf-8", "cp1252", "ascii", "iso8859-1")  # their digits and signs are ASCII's


def text_table(path: str, reading: Reading, content: bytes) -> TextTable:
    """Read text in memory (InputError)."""
    return TextTable(ByteStream(path, content), reading)


def open_text(name: str, part: str, reading: Reading) -> TextTable:
    """Open a text log; see ``Table``.

    Raises
    ------
    InputError
        It cannot be read, or it is not clear how it is written.
    """
    if part:
        raise UsageError(
            f"{name}::{part}: '::' names a part of a file, and this is a text file"
        )
    return TextTable(ByteStream(name), reading)


class TextTable(Table):
    """A text log: its columns at once, its rows in blocks.

    ``layout`` is how it is written.
    """

    def __init__(self, stream: ByteStream, reading: Reading) -> None:
        super().__init__(stream.name)
        self._stream = stream
        self._encoding = ""
        self._decoder: Any = None
        self._ends_in_cr = False
        self._ended = False
        self._seen = 0  # bytes of rows
        try:
            head, lines = self._read_head(reading)
            self.layout = sniff(self.name, lines, reading)
            describe_columns(self, self.layout)
        except BaseException:
            stream.close()
            raise
        self.stated = self.layout.clock
        if self.columns[0].kind in ("number", "stamp"):
            self.guard = self.columns[0]
        self._line = self.layout.first + 1  # of the first row in the text
        self._text = head.split(b"\n", self.layout.first)[-1]

    # --- bytes to whole lines ---

    def _read_head(self, reading: Reading) -> tuple[bytes, list[str]]:
        """Read the first lines; from a pipe what has arrived once it holds a row."""
        head = b""
        while len(head) < _HEAD:
            data = self._stream.read(_HEAD - len(head))
            self._ended = not data
            head += data
            if self._ended or (self._stream.is_pipe and self._is_enough(head, reading)):
                break
        self._ends_in_cr = b"\r" in head[:-1] and b"\n" not in head  # Igor's do
        self._encoding = _find_encoding(self.name, head, reading.encoding)
        if self._encoding not in _ASCII:
            self._decoder = codecs.getincrementaldecoder(self._encoding)("replace")
        head = self._plain(head.removeprefix(codecs.BOM_UTF8))
        lines = self._lines_of(head)
        if not self._ended and len(lines) > 2:
            lines.pop()  # perhaps not whole
        return head, lines

    def _is_enough(self, head: bytes, reading: Reading) -> bool:
        """Return whether a pipe has paused behind a row."""
        if self._stream.has_more() or not head.endswith(b"\n"):
            return False
        try:
            encoding = _find_encoding(self.name, head, reading.encoding)
            sniff(self.name, head.decode(encoding, "replace").split("\n"), reading)
        except InputError:
            return False
        return True

    def _plain(self, data: bytes) -> bytes:
        """Turn bytes into a superset of ASCII with plain line ends."""
        if self._decoder is not None:
            data = self._decoder.decode(data, final=self._ended).encode()
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n")
        return data.replace(b"\r", b"\n") if self._ends_in_cr else data

    def _lines_of(self, text: bytes) -> list[str]:
        encoding = "utf-8" if self._decoder else self._encoding
        return text.decode(encoding, errors="replace").split("\n")

    def _next(self) -> bytes:
        """Return the next bytes; none at the end."""
        data = self._stream.read(_BLOCK)
        self._ended = not data
        return self._plain(data)

    def _texts(self) -> Iterator[bytes]:
        """Return the rows in blocks of whole lines, without those of delimiters at the end of the file."""
        tail, data = b"", self._text
        if not self._ended and not self._stream.is_pipe:
            data += self._next()
        while not self._ended:
            end = _last_row_end(data, data.rfind(b"\n") + 1)
            if end:
                yield data[:end] if not tail else tail + data[:end]
                tail = b""
            tail += data[end:]
            if len(tail) > _LONGEST_LINE:
                raise InputError(
                    f"{self.name}: a line is longer than 16 MB: no text log?"
                )
            data = self._next()
        text = tail + data
        text = text[: _last_row_end(text, len(text))]
        if text:
            yield text

    # --- lines to arrays ---

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Table``."""
        for text in self._texts():
            self._text = text
            if not text.endswith(b"\n"):
                self._doubt_last_line(text)
            arrays, lines = self._read_block(text, chosen)
            if len(arrays[0]):
                yield arrays
            self.first_row += len(arrays[0])
            self._line += lines

    def _doubt_last_line(self, text: bytes) -> None:
        """Say that a row at the end has no line end."""
        if not is_no_row(self._lines_of(text[text.rfind(b"\n") + 1 :])[0]):
            number = self._line + text.count(b"\n")
            self.remarks.append(
                f"line {number}, the last one, has no line end: was the record cut there?"
            )

    def _read_block(
        self, text: bytes, chosen: Sequence[Column]
    ) -> tuple[list[NDArray[Any]], int]:
        """Read a block by polars, or line by line where it is small or not regular; count its lines."""
        self._seen += len(text)
        self.torn = ()
        is_small = self._seen <= _SMALL and "polars" not in sys.modules
        is_plain = True
        if b"#" in text or b"%" in text:
            comments = self._lines_of(b"".join(_COMMENT.findall(text)))
            is_plain = all(map(self._is_passed, comments))
        if is_plain and not is_small and len(text) > _TINY:
            from dbo_cli.logs.fast_text import read_fast

            block = read_fast(text, self.layout, chosen)
            if block is not None:
                return block
        return self._read_lines(text, chosen), text.count(b"\n")

    def _is_passed(self, line: str) -> bool:
        """Return whether a line among the rows is blank, a comment, or a row that is commented out."""
        comment = line.strip("#% \t")
        is_comment = self.layout.partly_fits(comment) or not begins_run(comment)
        return is_no_row(line) and is_comment

    def _read_lines(self, text: bytes, chosen: Sequence[Column]) -> list[NDArray[Any]]:
        """Read a block in Python; cells that are no numbers become NaN."""
        width = self.layout.width
        rows = []
        for line in self._lines_of(text):
            if not self._is_passed(line):
                rows.append(split_cells(line, self.layout.delimiter))
        torn = [k for k, cells in enumerate(rows) if len(cells) != width]
        self.torn = [self.first_row + k for k in torn]
        for k in torn:
            rows[k] = [""] * width
        arrays: list[NDArray[Any]] = []
        for column in chosen:
            cells = [row[column.number - 1] for row in rows]
            if column.kind == "stamp":
                import polars as pl

                from dbo_cli.logs.fast_text import read_stamps

                form = self.layout.stamps[column.number - 1]
                arrays.append(read_stamps(pl.Series(cells, dtype=pl.String), form))
            else:
                sign = self.layout.decimal
                arrays.append(np.array([to_number(cell, sign) for cell in cells]))
        return arrays

    def where(self, row: int, column: Column) -> str:
        """Say in which line a row of the last block is, and what stands in a column of it."""
        lines = self._lines_of(self._text)
        places = [k for k, line in enumerate(lines) if not self._is_passed(line)]
        place = places[row - self.first_row]
        at = f"{self.name}:{self._line + place}"
        if is_no_row(lines[place]):
            return f"{at}: a comment as above another run: cut with `rows` :{row - 1}"
        cells = split_cells(lines[place], self.layout.delimiter)
        if len(cells) != self.layout.width:
            s = "" if len(cells) == 1 else "s"
            return f"{at}: {len(cells)} cell{s} where the other rows have {self.layout.width}"
        cell = cells[column.number - 1]
        if not cell:
            return f"{at}: {column.label} is empty"
        wanted = "a known time stamp" if column.kind == "stamp" else "a measured number"
        advice = " (`decimal` comma?)" if "," in cell else ""
        return f"{at}: {column.label} is not {wanted}: '{cell[:40]}'{advice}"

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def _last_row_end(text: bytes, end: int) -> int:
    """Return where the last row ends: comments and lines of delimiters may end a table."""
    while end:
        begin = text.rfind(b"\n", 0, end - 1) + 1
        line = text[begin:end].decode("latin-1")
        if line.strip("\t ;,|\r\n") and not is_no_row(line):
            break
        end = begin
    return end


def _find_encoding(name: str, head: bytes, typed: str | None) -> str:
    """Return the encoding: by a mark, by what the user types, UTF-8, else Western.

    Raises
    ------
    InputError
        The file is binary, or UTF-16 without a mark.
    UsageError
        The encoding that the user names is not known.
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8"
    if typed is not None:
        try:
            head[:4].decode(typed, "replace")
        except (LookupError, UnicodeError):
            raise UsageError(
                f"`encoding` {typed}: there is no such text encoding"
            ) from None
        encoding = codecs.lookup(typed).name
        if encoding in ("utf-16", "utf-32"):
            raise InputError(
                f"{name}: has no byte order mark: type `encoding` {encoding}-le or {encoding}-be"
            )
        return encoding
    if b"\0" in head[:200]:
        raise InputError(
            f"{name}: no text: export it as CSV or HDF5; if it is one, type `encoding` utf-16-le, utf-16-be "
            "or utf-8"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"
