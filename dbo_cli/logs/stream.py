"""The bytes of a text log: a file, a gzip file, standard input, or content in memory."""

from __future__ import annotations

import gzip
import io
import os
import select
import stat
import sys
import zlib
from typing import IO, Any, cast

from dbo_cli.errors import InputError

_UNREAD = {
    b"BZh": "compressed with bzip2: unpack it, or compress it with gzip",
    b"\xfd7zXZ": "compressed with xz: unpack it, or compress it with gzip",
    b"(\xb5/\xfd": "compressed with zstd: unpack it, or compress it with gzip",
    b"PK\x03\x04": "a zip archive: unpack it",
    b"%PDF": "a PDF document: give the measured data as CSV",
}


class ByteStream:
    """The bytes of a file, of a gzip file or of standard input."""

    def __init__(self, name: str, content: bytes | None = None) -> None:
        """Open a file; ``-`` is standard input, and content in memory needs no file.

        Raises
        ------
        InputError
            It cannot be opened, or its first bytes are those of no text.
        """
        self.name = "standard input" if name == "-" else name
        self._is_ours = name != "-"
        self._pipe: int | None = None
        self._looked_ahead = True
        self._raw = self._opened(name) if content is None else io.BytesIO(content)
        self._file = self._raw
        start = self._first_bytes()
        for magic, what in _UNREAD.items():
            if start.startswith(magic):
                self.close()
                raise InputError(f"{self.name}: not a text log but {what}")
        self.is_stream = self._pipe is not None
        if start.startswith(b"\x1f\x8b"):
            self._file = cast(IO[bytes], gzip.GzipFile(fileobj=self._file))
            self._pipe = None
            self.is_stream = True

    def _opened(self, name: str) -> IO[bytes]:
        if name == "-":
            stream = sys.stdin.buffer
        else:
            try:
                stream = open(name, "rb")
            except FileNotFoundError:
                raise InputError(f"{name}: no such file") from None
            except IsADirectoryError:
                raise InputError(f"{name}: is a folder, not a log") from None
            except (OSError, ValueError) as problem:
                reason = getattr(problem, "strerror", None) or problem
                raise InputError(f"{name}: cannot be read: {reason}") from None
        try:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                self._pipe = stream.fileno()
        except (OSError, ValueError, io.UnsupportedOperation):
            pass  # text in memory
        return cast(IO[bytes], stream)

    def _first_bytes(self) -> bytes:
        if not hasattr(self._file, "peek"):
            self._file = cast(IO[bytes], io.BufferedReader(cast(Any, self._file)))
        try:
            return cast(bytes, self._file.peek(8)[:8])  # type: ignore[attr-defined]
        except OSError as problem:
            self.close()
            raise InputError(
                f"{self.name}: cannot be read: {problem.strerror}"
            ) from None

    def read(self, size: int) -> bytes:
        """Read up to a size; from a pipe what has arrived, and empty at the end.

        Raises
        ------
        InputError
            The file cannot be read, or packed data are damaged.
        """
        try:
            if self._pipe is None:
                return self._file.read(size)
            return self._arrived(size)
        except (EOFError, zlib.error, gzip.BadGzipFile):
            raise InputError(
                f"{self.name}: the gzip data are damaged or end early"
            ) from None
        except OSError as problem:
            raise InputError(
                f"{self.name}: cannot be read: {problem.strerror}"
            ) from None

    def _arrived(self, size: int) -> bytes:
        """Read what a pipe has; wait for the first byte only."""
        assert self._pipe is not None
        if self._looked_ahead:  # what came with the first bytes is in the buffer
            self._looked_ahead = False
        else:
            # A signal ends this wait; libraries may have asked for reads to be restarted.
            select.select([self._pipe], [], [])
        pieces = [self._file.read1(size)]  # type: ignore[attr-defined]
        while pieces[-1] and sum(map(len, pieces)) < size and self.has_more():
            pieces.append(self._file.read1(size))  # type: ignore[attr-defined]
        return b"".join(pieces)

    def has_more(self) -> bool:
        """Return whether a pipe has bytes (or its end) to be read now."""
        if self._pipe is None:
            return True
        return bool(select.select([self._pipe], [], [], 0.0)[0])

    def close(self) -> None:
        """Close the file (never standard input)."""
        if self._is_ours:
            self._raw.close()
