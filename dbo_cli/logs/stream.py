r"""Plain text of a file, a gzip file, standard input, or content in memory.

Whatever the encoding and the line ends are, what is handed on is a superset of ASCII in
which ``\n`` ends a line.
"""

import codecs
import contextlib
import gzip
import io
import os
import select
import stat
import sys
import zlib
from collections.abc import Iterator
from typing import IO, Any, cast

from dbo_cli.errors import InputError, UsageError

_HEAD = 1 << 16  # bytes from which the layout is found; longer than any header
_BLOCK = 1 << 22  # bytes of text at a time; of 1 to 8 MB the fastest
_ASCII = ("utf-8", "cp1252", "ascii", "iso8859-1")  # their digits and signs are ASCII's


class TextStream:
    """The text of a log in blocks that end anywhere.

    Attributes
    ----------
    name
        How messages call it.
    is_pipe
        Whether reading waits for whoever writes.
    ended
        Whether all has been read.
    """

    def __init__(
        self, path: str, encoding: str | None = None, content: bytes | None = None
    ) -> None:
        """Open a file; ``-`` is standard input, ``content`` stands for what is in a file.

        Raises
        ------
        InputError
            It cannot be opened.
        """
        self.name = "standard input" if path == "-" else path
        self.ended = False
        self._is_stdin = path == "-"
        self._typed_encoding = encoding
        self._encoding = ""
        self._decoder: Any = None
        self._ends_in_cr = False
        self._file = io.BytesIO(content) if content is not None else _opened(path)
        self._descriptor = -1
        with contextlib.suppress(OSError, ValueError):  # text in memory
            descriptor = self._file.fileno()
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                self._descriptor = descriptor
        self.is_pipe = self._descriptor >= 0

    def heads(self) -> Iterator[bytes]:
        """Return the first text; from a pipe that pauses what has arrived so far, and more and more of it.

        Raises
        ------
        InputError
            It cannot be read, or it is no text.
        """
        start = b""
        while len(start) < _HEAD:
            data = self._read(_HEAD - len(start))
            self.ended = not data
            start += data
            if self.ended:
                break
            if self.is_pipe and start.endswith(b"\n") and not self._has_more():
                yield self._first_text(start)
        yield self._first_text(start)

    def _first_text(self, start: bytes) -> bytes:
        """Find out how the first bytes are written, and make them plain."""
        self._ends_in_cr = b"\r" in start[:-1] and b"\n" not in start  # Igor's do
        self._encoding = _find_encoding(self.name, start, self._typed_encoding)
        if self._encoding not in _ASCII:
            self._decoder = codecs.getincrementaldecoder(self._encoding)("replace")
        return self._plain(start.removeprefix(codecs.BOM_UTF8))

    def next(self) -> bytes:
        """Return the next text; none at the end (InputError)."""
        data = self._read(_BLOCK)
        self.ended = not data
        return self._plain(data)

    def lines(self, text: bytes) -> list[str]:
        """Return the lines of what was read."""
        encoding = "utf-8" if self._decoder else self._encoding
        return text.decode(encoding, errors="replace").split("\n")

    def close(self) -> None:
        """Close the file (never standard input)."""
        if not self._is_stdin:
            self._file.close()

    def _plain(self, data: bytes) -> bytes:
        """Turn bytes into a superset of ASCII with plain line ends."""
        if self._decoder is not None:
            data = self._decoder.decode(data, final=self.ended).encode()
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n")
        return data.replace(b"\r", b"\n") if self._ends_in_cr else data

    def _read(self, size: int) -> bytes:
        """Read a size and on to the end of the line; from a pipe what has arrived; empty at the end.

        Raises
        ------
        InputError
            The file cannot be read, or packed data are damaged.
        """
        try:
            if self.is_pipe:
                return self._arrived(size)
            return self._file.read(size) + self._file.readline(size)
        except (EOFError, zlib.error, OSError) as problem:
            reason = getattr(problem, "strerror", None) or "damaged, or it ends early"
            raise InputError(f"{self.name}: cannot be read: {reason}") from None

    def _arrived(self, size: int) -> bytes:
        """Read what a pipe has; wait for the first byte only."""
        # A signal ends this wait; libraries may have asked for reads to be restarted.
        select.select([self._descriptor], [], [])
        data = chunk = os.read(self._descriptor, size)
        while chunk and len(data) < size and self._has_more():
            chunk = os.read(self._descriptor, size - len(data))
            data += chunk
        return data

    def _has_more(self) -> bool:
        """Return whether a pipe has bytes (or its end) to be read now."""
        return bool(select.select([self._descriptor], [], [], 0.0)[0])


def _opened(path: str) -> IO[bytes]:
    if path == "-":
        return sys.stdin.buffer
    try:
        if path.lower().endswith(".gz"):
            return cast(IO[bytes], gzip.open(path))
        return open(path, "rb")
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise InputError(f"{path}: cannot be read: {reason}") from None


def _find_encoding(name: str, start: bytes, requested: str | None) -> str:
    """Return the encoding: by a mark, by what the user types, UTF-8, else Western.

    Raises
    ------
    InputError
        The file is binary, or UTF-16 without a mark.
    UsageError
        The encoding that the user names is not known.
    """
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if start.startswith(codecs.BOM_UTF8):
        return "utf-8"
    if requested is not None:
        try:
            start[:4].decode(requested, "replace")
        except (LookupError, UnicodeError):
            raise UsageError(
                f"`encoding` {requested}: there is no such text encoding"
            ) from None
        encoding = codecs.lookup(requested).name
        if encoding not in ("utf-16", "utf-32"):
            return encoding
    if requested is not None or b"\0" in start[:200]:
        raise InputError(
            f"{name}: no text, or without a mark of its byte order: export it as CSV or HDF5, or type "
            "`encoding` utf-16-le, utf-16-be or utf-8"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"
