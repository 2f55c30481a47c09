"""The bytes of a text log: a file, a gzip file, standard input, or content in memory."""

from __future__ import annotations

import gzip
import io
import os
import select
import stat
import sys
import zlib
from typing import IO, cast

from dbo_cli.errors import InputError


class ByteStream:
    """The bytes of a file, of a gzip file (``.gz``), of standard input, or of content in memory.

    ``is_pipe``: reading waits for whoever writes.
    """

    def __init__(self, name: str, content: bytes | None = None) -> None:
        """Open a file; ``-`` is standard input.

        Raises
        ------
        InputError
            It cannot be opened.
        """
        self.name = "standard input" if name == "-" else name
        self._is_ours = name != "-"
        self._file = _opened(name) if content is None else io.BytesIO(content)
        self._descriptor = -1
        try:
            descriptor = self._file.fileno()
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                self._descriptor = descriptor
        except (OSError, ValueError):
            pass  # text in memory
        self.is_pipe = self._descriptor >= 0
        self._is_plain = not self.is_pipe and not isinstance(self._file, gzip.GzipFile)

    def read(self, size: int) -> bytes:
        """Read a size and on to the end of the line; from a pipe what has arrived; empty at the end.

        Raises
        ------
        InputError
            The file cannot be read, or packed data are damaged.
        """
        try:
            if self.is_pipe:
                return self._arrived(size)
            if not self._is_plain:
                return self._file.read(size)
            start = self._file.tell()
            self._file.seek(start + size)
            size += len(self._file.readline(size))
            self._file.seek(start)
            return self._file.read(size)
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
        # A signal ends this wait; libraries may have asked for reads to be restarted.
        select.select([self._descriptor], [], [])
        data = part = os.read(self._descriptor, size)
        while part and len(data) < size and self.has_more():
            part = os.read(self._descriptor, size - len(data))
            data += part
        return data

    def has_more(self) -> bool:
        """Return whether there are bytes (or the end) to be read now."""
        if not self.is_pipe:
            return True
        return bool(select.select([self._descriptor], [], [], 0.0)[0])

    def close(self) -> None:
        """Close the file (never standard input)."""
        if self._is_ours:
            self._file.close()


def _opened(name: str) -> IO[bytes]:
    if name == "-":
        return sys.stdin.buffer
    try:
        if name.lower().endswith(".gz"):
            return cast(IO[bytes], gzip.open(name))
        return open(name, "rb")
    except FileNotFoundError:
        raise InputError(f"{name}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{name}: is a folder, not a log") from None
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise InputError(f"{name}: cannot be read: {reason}") from None
