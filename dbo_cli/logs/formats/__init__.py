"""Files that are no text: a module a format, each read by the library that owns it.

A module has one reader, ``read_hdf5(path, part, reading)`` in ``hdf5``; it is imported when such a file
is opened, and so is its library. A reader of another package joins as an entry point of
the group ``dbo_cli.readers``, named by the suffix of its files (``.xyz``).
"""

import importlib
import os
from collections.abc import Callable

from dbo_cli.errors import InputError
from dbo_cli.logs.table import Reading, Table

TableReader = Callable[[str, str, Reading], Table]
"""Takes a path, the part behind ``::`` and how to read."""

_FORMATS = (
    (b"\x89HDF\r\n\x1a\n", 0, "hdf5"),
    (b"\x89HDF\r\n\x1a\n", 512, "hdf5"),  # MATLAB 7.3
    (b"\x93NUMPY", 0, "npy"),
    (b"PK\x03\x04", 0, "npz"),
    (b"MATLAB", 0, "matlab"),
    (b"PAR1", 0, "arrow"),
    (b"ARROW1", 0, "arrow"),
    (b"\xd0\xcf\x11\xe0", 0, "excel"),  # before 2007
    (b"TDSm", 0, "tdms"),
)
"""Bytes, where they stand in the file, and the module that reads it."""
_TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".lvm", ".gz", "")
_PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
_REFUSED = ".pkl .pickle .json .jsonl .uff .unv .itx .h5 .hdf5 .mat".split()
"""Suffixes of files that are no text, whatever their first bytes look like."""


def reader_of(path: str, start: bytes) -> TableReader | None:
    """Return what reads a file; None for text.

    Parameters
    ----------
    path
        The file; a reader of another package is known by its suffix.
    start
        Its first bytes, 1,024 or all that there are.

    Raises
    ------
    InputError
        The format is not read; the message says what to do.
    """
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in _TEXT_SUFFIXES:
        from importlib.metadata import entry_points

        for point in entry_points(group="dbo_cli.readers", name=suffix):
            foreign: TableReader = point.load()
            return foreign
    for mark, offset, name in _FORMATS:
        if start.startswith(mark, offset):
            module = importlib.import_module(f"dbo_cli.logs.formats.{name}")
            reader: TableReader = getattr(module, f"read_{name}")
            return reader
    if suffix in _REFUSED or start[:2] in _PICKLES:
        raise InputError(
            f"{path}: no format that is read, or damaged: export it as CSV, HDF5 or Parquet"
        )
    return None
