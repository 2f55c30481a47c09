"""Where a signal is read from or written to: a file, a group of an HDF5 file, or a standard stream."""

from __future__ import annotations

import os
from dataclasses import dataclass

from dbo_cli.errors import UsageError

TEXT_ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".prn", ".log")
HDF5_ENDINGS = (".h5", ".hdf5", ".hdf", ".he5", ".mat", ".nxs")
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
FORMATS = {"csv": "text", "tsv": "text", "txt": "text", "dat": "text", "h5": "hdf5", "hdf5": "hdf5"}


@dataclass(frozen=True)
class Address:
    """A parsed address.

    ``path`` is ``-`` for a standard stream, ``group`` what stands after ``::``; ``kind`` is ``text`` or
    ``hdf5`` by the name or by ``format``, or None where only the content can tell.
    """

    text: str
    path: str
    group: str | None
    kind: str | None

    @property
    def is_stream(self) -> bool:
        """Whether this is standard input or output."""
        return self.path == "-"

    @property
    def compressed(self) -> bool:
        """Whether the name asks for gzip."""
        return self.path.lower().endswith(".gz")

    @property
    def name(self) -> str:
        """The name shown in messages."""
        return "standard input" if self.is_stream else self.text


def parse_address(text: str, format: str | None = None) -> Address:
    """Take an address apart.

    Raises
    ------
    UsageError
        The address is empty, the format is unknown, or a group is asked of a text file.
    """
    if not text:
        raise UsageError("an empty file name was given")
    if format is not None and format not in FORMATS:
        raise UsageError(f"`format` {format}: the formats are {', '.join(FORMATS)}")
    path, separator, group = text.partition("::")
    if separator and os.path.exists(text):
        path, separator, group = text, "", ""  # a file whose name holds the separator
    kind = _kind(path, format)
    if separator and kind is None:
        kind = "hdf5"
    if separator and kind == "text":
        raise UsageError(f"{text}: '::' names a group of an HDF5 file, and this is a text file")
    return Address(text, path, (group or "/") if separator else None, kind)


def _kind(path: str, format: str | None) -> str | None:
    if format is not None:
        return FORMATS[format]
    lower = path.lower().removesuffix(".gz")
    if lower.endswith(HDF5_ENDINGS):
        return "hdf5"
    return "text" if lower.endswith(TEXT_ENDINGS) else None


def format_for(address: str, named: str | None) -> str | None:
    """Return the format that was asked for where an address's own name does not tell it, else None."""
    return named if named is not None and parse_address(address).kind is None else None
