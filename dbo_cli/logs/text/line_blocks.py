"""Files, gzip and standard input as plain text, in blocks of whole lines and in constant memory."""

from __future__ import annotations

import codecs
import io
import os
import stat
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, TypeVar, cast

from dbo_cli import extensions
from dbo_cli.errors import InputError
from dbo_cli.logs.request import CHANGED, Request

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
# read ahead: longer than the header of any instrument, and some thousand rows
HEAD_BYTES = 1 << 18
LONGEST_LINE = 1 << 24  # a row of a million columns; what is longer has no line ends
NEIGHBOUR_BYTES = 1 << 14  # kept of the text above: some hundred rows of a usual log

_PIPE_BYTES = 1 << 18  # a reading of a pipe: four of what Linux keeps in one
_UNREADABLE = (EOFError, zlib.error, OSError)  # what reading and unpacking raise
_GZIP_MAGIC = b"\x1f\x8b"  # RFC 1952, 2.3.1
_UTF16 = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
HDF5 = b"\x89HDF\r\n\x1a\n"  # HDF5 file format specification, II.A
_UNPACK = "unpack it, or compress it with gzip"
# First bytes of files that are not read, by the file(1) database, and what messages say
# of them.
_UNREAD = {
    b"PK\x03\x04": "a zip archive: a workbook ends in .xlsx, a NumPy archive in .npz",
    b"BZh": f"compressed with bzip2: {_UNPACK}",
    b"\xfd7zXZ": f"compressed with xz: {_UNPACK}",
    b"(\xb5/\xfd": f"compressed with zstd: {_UNPACK}",
    b"7z\xbc\xaf": f"a 7z archive: {_UNPACK}",
    b"%PDF": "a PDF document: give the measured data as CSV",
}


def _no_text(start: bytes) -> str:
    """Return what a file is whose first bytes are not those of a text log, and the remedy; else nothing."""
    for magic, remedy in _UNREAD.items():
        if start.startswith(magic):
            return remedy
    name = ""
    if start.startswith(HDF5):
        name = "HDF5"
    else:
        kind_of = extensions.find_installed("reader", "by content")
        kind = None if kind_of is None else kind_of(start, "")
        if kind is not None:
            name = kind.name
    if not name:
        return ""
    return f"{name}: give it as a file, not through a pipe or compressed"


class _Hashing(io.RawIOBase):
    """A raw stream that hashes what passes through it."""

    def __init__(self, inner: IO[bytes], digest: Any) -> None:
        self._inner = inner
        self._digest = digest

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data: bytes = self._inner.read1(len(buffer))  # type: ignore[attr-defined]
        buffer[: len(data)] = data
        self._digest.update(data)
        return len(data)


def _hashed(stream: IO[bytes], digest: Any) -> IO[bytes]:
    """Return a stream that hashes what is read from it."""
    return cast(IO[bytes], io.BufferedReader(_Hashing(stream, digest), 1 << 20))


class ByteSource:
    """The bytes of one text log, decompressed and in UTF-8 (or a superset of ASCII) with plain line ends.

    Parameters
    ----------
    request
        What is to be read; without a codec forced by the user a byte-order mark
        decides, else it is UTF-8.

    Raises
    ------
    InputError
        The file is missing, is a folder, cannot be read, or is plainly no text.
    """

    def __init__(self, request: Request) -> None:
        address = request.address
        self.name = address.name
        self.is_regular = not address.is_stream and os.path.isfile(address.path)
        self.is_compressed = False
        self._live = request.live
        self._at_start = True
        self._classic_mac = False
        self._hash: Any = None
        if request.digest and address.is_stream:
            import hashlib

            self._hash = hashlib.sha256()
        self._file = self._open(request)
        self._owned = []
        if not address.is_stream:
            self._owned.append(self._file)
        self._begun = self._now()  # how a regular file was when it was opened
        self._largest = 0  # bytes that it has had since
        if self._begun is not None:
            self._largest = self._begun.st_size
        try:
            self._stream, start = self._unpacked()
            self._decode = self._decoder(request.options.encoding, start)
        except BaseException:
            self.close()
            raise

    @property
    def sha256(self) -> str | None:
        """The digest of everything read so far, when it was asked for."""
        return self._hash.hexdigest() if self._hash else None

    def read(self, size: int) -> bytes:
        """Read up to ``size`` bytes (what has arrived, when live); empty at the end."""
        while data := self._arrived(size):
            try:
                if self._decode is not None:
                    data = self._decode(data)
            except UnicodeError as problem:
                raise InputError(
                    f"{self.name}: the text does not fit its encoding: {problem}"
                ) from None
            if self._at_start and data:
                data = data.removeprefix(codecs.BOM_UTF8)
                self._classic_mac = b"\n" not in data and b"\r" in data[:-1]
                self._at_start = False
            if self._classic_mac:
                data = data.replace(b"\r", b"\n")
            if data:
                return data
        return b""

    def _arrived(self, size: int) -> bytes:
        """Read bytes as they are stored."""
        try:
            if self._live:
                data: bytes = self._stream.read1(size)  # type: ignore[attr-defined]
            elif self.is_regular:
                data = self._stream.read(size)
            else:
                data = self._patiently(size)
        except _UNREADABLE as problem:
            raise self._why_unreadable(problem) from None
        self._refuse_change(ended=not data)
        return data

    def _why_unreadable(self, problem: BaseException) -> InputError:
        self._refuse_change(ended=True)
        # gzip's own complaint
        if not isinstance(problem, OSError) or problem.errno is None:
            return InputError(f"{self.name}: the gzip data are damaged or end early")
        return InputError(f"{self.name}: cannot be read: {problem.strerror or problem}")

    def _first_bytes(self, stream: IO[bytes]) -> bytes:
        try:
            return cast(bytes, stream.peek(64)[:64])  # type: ignore[attr-defined]
        except _UNREADABLE as problem:
            raise self._why_unreadable(problem) from None

    def _refuse_change(self, ended: bool) -> None:
        """Refuse a file that was cut or written over; one that a recorder appends to is read on."""
        now = self._now()
        if now is None or self._begun is None:
            return
        is_shorter = now.st_size < self._largest
        same_size = now.st_size == self._begun.st_size
        written_since = now.st_mtime_ns != self._begun.st_mtime_ns
        if is_shorter or (ended and same_size and written_since):
            raise InputError(f"{self.name}: {CHANGED}")
        self._largest = now.st_size

    def _now(self) -> os.stat_result | None:
        """Look at the open file; None for a stream and for text in memory."""
        try:
            status = os.fstat(self._file.fileno())
        except (OSError, ValueError):
            return None
        return status if stat.S_ISREG(status.st_mode) else None

    def _patiently(self, size: int) -> bytes:
        """Read a full block from a pipe in pieces: an interrupt is served between them."""
        pieces = []
        while size > 0:
            piece = self._stream.read1(min(size, _PIPE_BYTES))  # type: ignore[attr-defined]
            if not piece:
                break
            pieces.append(piece)
            size -= len(piece)
        return b"".join(pieces)

    def unfinished(self) -> str | None:
        """Return why a last line without its end must be taken for a cut record; None where it need not."""
        if self.is_compressed:
            return "in compressed data"
        now = self._now()
        if now is None or self._begun is None:
            return "in a stream"
        if now.st_size != self._begun.st_size:
            return "in a file that is still growing"
        return None

    def close(self) -> None:
        """Close what was opened here (never standard input)."""
        for stream in reversed(self._owned):
            stream.close()
        self._owned.clear()

    def _open(self, request: Request) -> IO[bytes]:
        address = request.address
        if request.content is not None:
            return cast(
                IO[bytes], io.BufferedReader(cast(Any, io.BytesIO(request.content)))
            )
        if address.is_stream:
            return sys.stdin.buffer
        try:
            if os.path.isdir(address.path):
                raise InputError(f"{address.path}: this is a folder, not a log")
            return open(address.path, "rb", buffering=1 << 20)
        except FileNotFoundError:
            raise InputError(f"{address.path}: no such file") from None
        except (OSError, ValueError) as problem:
            reason = getattr(problem, "strerror", None) or problem
            raise InputError(f"{address.path}: cannot be read: {reason}") from None

    def _unpacked(self) -> tuple[IO[bytes], bytes]:
        """Return the stream of the text itself, and how it starts; refuse what is plainly no text."""
        stream = self._file
        if self._hash is not None:
            stream = _hashed(stream, self._hash)
        start = self._first_bytes(stream)
        if start.startswith(_GZIP_MAGIC):
            import gzip

            self.is_compressed = True
            unpacked = gzip.GzipFile(fileobj=stream, mode="rb")
            self._owned.append(cast(IO[bytes], unpacked))
            stream = cast(IO[bytes], io.BufferedReader(cast(Any, unpacked), 1 << 20))
            start = self._first_bytes(stream)
        if what := _no_text(start):
            raise InputError(f"{self.name}: this is not a text log but {what}")
        return stream, start

    def _decoder(self, encoding: str | None, start: bytes) -> Any:
        if encoding is None:
            encoding = self._encoding_of(start)
        if encoding is None:
            return None
        decoder = codecs.getincrementaldecoder(encoding)(errors="replace")
        return lambda data: decoder.decode(data).encode("utf-8")

    def _encoding_of(self, start: bytes) -> str | None:
        """Return the encoding that first bytes show; None for UTF-8 and supersets of ASCII."""
        for mark, name in _UTF16.items():
            if start.startswith(mark):
                return name
        if b"\0" not in start:
            return None
        # Text of 16 bits has its NULs in every second place, and elsewhere none.
        even = any(start[0:40:2])
        odd = any(start[1:40:2])
        if len(start) >= 4 and even != odd:
            return "utf-16-le" if even else "utf-16-be"
        raise InputError(
            f"{self.name}: this is a binary file, not a text log: export it as CSV or HDF5"
        )


# --- blocks of whole lines ---


@dataclass
class LineBlocks:
    """Blocks of whole lines of a source; the first one can be looked at before it is taken.

    ``above`` is the end of the text given out so far, for a look back from the last
    line; ``empty_lines`` counts those that were left out at the start; ``ended`` tells
    that the source has been read to its end.
    """

    source: ByteSource
    block_bytes: int
    above: bytes = b""
    empty_lines: int = 0
    ended: bool = False
    _pending: bytes = b""

    def head(self, enough: Any) -> bytes:
        """Read ahead HEAD_BYTES and at least two lines, or less once ``enough(text)`` holds.

        ``enough`` is asked after every arrival. Empty lines at the very start are left
        out and counted.
        """
        while not self.ended:
            read = len(self._pending)
            two_lines = self._pending.count(b"\n") > 1
            if read >= HEAD_BYTES and (two_lines or read > LONGEST_LINE):
                break
            self._append(self._read(HEAD_BYTES - read % HEAD_BYTES))
            if len(self._pending) >= HEAD_BYTES:
                self._leave_out_empty_lines()
            if enough(self._pending[: self._pending.rfind(b"\n") + 1]):
                break
        return self._pending

    def _leave_out_empty_lines(self) -> None:
        """Leave out empty lines where nothing else was read: a billion, in compressed data."""
        text = self._pending
        if text[:HEAD_BYTES].strip():
            return
        blank = len(text) - len(text.lstrip())
        self.empty_lines += text.count(b"\n", 0, blank)
        self._pending = text[text.rfind(b"\n", 0, blank) + 1 :]

    def longer_head(self) -> bytes | None:
        """Read twice as far ahead as before; None at the end of the source or at LONGEST_LINE."""
        wanted = 2 * len(self._pending)
        if self.ended or wanted > LONGEST_LINE:
            return None
        while len(self._pending) < wanted and not self.ended:
            self._append(self._read(wanted - len(self._pending)))
        return self._pending

    def __iter__(self) -> Iterator[bytes]:
        """Yield blocks of whole lines; a last line without its line end comes alone, after all others."""
        text = self._pending
        start = 0
        last = text.rfind(b"\n") + 1
        self._pending = text[last:]
        # What was read ahead is cut where it is much; the usual case is what one
        # reading brought.
        most = last
        if last > 2 * self.block_bytes:
            most = self.block_bytes
        while start < last:
            limit = min(last, start + most)
            end = text.rfind(b"\n", start, limit) + 1 or text.index(b"\n", limit) + 1
            yield self._noted(text[start:end])
            start = end
        while not self.ended:
            data = self._read(self.block_bytes)
            end = data.rfind(b"\n") + 1
            if end:
                # the only copy of most of the text
                block = b"".join((self._pending, memoryview(data)[:end]))
                self._pending = data[end:]
                yield self._noted(block)
            else:
                self._append(data)
        if self._pending:
            text = self._pending
            self._pending = b""
            yield text

    def _noted(self, block: bytes) -> bytes:
        self.above = (self.above + block[-NEIGHBOUR_BYTES:])[-NEIGHBOUR_BYTES:]
        return block

    def _read(self, size: int) -> bytes:
        data = self.source.read(size)
        self.ended = not data
        return data

    def _append(self, data: bytes) -> None:
        self._pending += data
        if len(self._pending) > LONGEST_LINE and b"\n" not in self._pending:
            raise InputError(
                f"{self.source.name}: no line end in the first {LONGEST_LINE >> 20} MB: is this a text log?"
            )


def one_ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Give the items of an iterator, each made in a thread while the one before is worked on.

    Only for regular files: a thread that waits for a pipe could not be interrupted.
    None is no item. An exception of the iterator is raised here, after the items before
    it.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        coming: Future[Item | None] = pool.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = pool.submit(next, items, None)
            yield item
