"""Bytes in: files, gzip and standard input as plain text, in constant memory."""

from __future__ import annotations

import codecs
import io
import os
import stat
import sys
import zlib
from collections.abc import Sequence
from typing import IO, Any, cast

from dbo_cli import extensions
from dbo_cli.errors import InputError, cleaned
from dbo_cli.logs.request import CHANGED, Given, Request, parse_address

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
    name = "HDF5" if start.startswith(HDF5) else ""
    kind_of = extensions.find_installed("reader", "by content")
    if not name and kind_of is not None:
        kind = kind_of(start, "")
        name = "" if kind is None else kind.name
    return (
        f"{name}: give it as a file, not through a pipe or compressed" if name else ""
    )


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
        self._live, self._at_start, self._classic_mac = request.live, True, False
        self._hash: Any = None
        if request.digest and address.is_stream:
            import hashlib

            self._hash = hashlib.sha256()
        self._file = self._open(request)
        self._owned = [] if address.is_stream else [self._file]
        self._begun = self._now()  # how a regular file was when it was opened
        # bytes that it has had since
        self._largest = 0 if self._begun is None else self._begun.st_size
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
                data = data if self._decode is None else self._decode(data)
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
            else:
                data = (
                    self._stream.read(size)
                    if self.is_regular
                    else self._patiently(size)
                )
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
        same = now.st_size == self._begun.st_size
        if now.st_size < self._largest or (
            ended and same and now.st_mtime_ns != self._begun.st_mtime_ns
        ):
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
        return (
            "in a file that is still growing"
            if now.st_size != self._begun.st_size
            else None
        )

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
            stream = cast(
                IO[bytes], io.BufferedReader(_Hashing(stream, self._hash), 1 << 20)
            )
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
            encoding = next(
                (name for mark, name in _UTF16.items() if start.startswith(mark)), None
            )
        if encoding is None and b"\0" in start:
            even, odd = start[0:40:2], start[1:40:2]
            # all NUL is no text of 16 bits either
            if len(start) >= 4 and any(even) != any(odd):
                encoding = "utf-16-le" if any(even) else "utf-16-be"
            if encoding is None:
                problem = (
                    "this is a binary file, not a text log: export it as CSV or HDF5"
                )
                raise InputError(f"{self.name}: {problem}")
        if encoding is None:
            return None
        decoder = codecs.getincrementaldecoder(encoding)(errors="replace")
        return lambda data: decoder.decode(data).encode("utf-8")


# --- where a model comes from
# ------------------------------------------------------------------------


def file_sha256(path: str) -> str:
    """Hash a file's bytes (hexadecimal SHA-256).

    Raises
    ------
    InputError
        It cannot be read.
    """
    import hashlib

    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(
            f"{path}: cannot be read: {problem.strerror or problem}"
        ) from None


def input_record(
    address: Given, rows: int, sha256: str | None = None, joined: Sequence[Given] = ()
) -> dict[str, Any]:
    """Record an input: its name without folders (they differ between machines), its digest and the rows used.

    ``sha256`` must be given for standard input, which cannot be read twice
    (``SignalLog.sha256``); ``others`` are the addresses of further files of the same
    log, whose records are ``joined``.
    """
    parsed = parse_address(address)
    name = os.path.basename(parsed.path) + (f"::{parsed.group}" if parsed.group else "")
    record = {
        "name": cleaned(name),
        "sha256": sha256 or file_sha256(parsed.path),
        "rows": rows,
    }
    return record | (
        {"joined": [input_record(address, rows) for address in joined]}
        if joined
        else {}
    )
