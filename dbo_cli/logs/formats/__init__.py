"""Files that are no text: a module a format, each read by the library that owns it.

The last lines of a module say what the format is, by which first bytes or suffix it is
known, and what reads it. A library is imported when such a file is opened. A reader of
another package joins as an entry point of the group ``dbo_cli.readers``, named by the
suffix of its files (``.xyz``).
"""

from __future__ import annotations

import os

from dbo_cli.errors import InputError
from dbo_cli.logs.formats.arrow import ARROW
from dbo_cli.logs.formats.excel import EXCEL
from dbo_cli.logs.formats.matlab import MATLAB
from dbo_cli.logs.formats.npy import NUMPY, ZIP
from dbo_cli.logs.formats.stored import FileFormat, TableReader
from dbo_cli.logs.formats.tdms import TDMS
from dbo_cli.logs.table import Reading, Table


def _read_hdf5(path: str, inner: str, reading: Reading) -> Table:
    """Read an HDF5 file; its library is imported here (InputError)."""
    from dbo_cli.logs.hdf5 import open_hdf5

    return open_hdf5(path, inner, reading)


_HDF5 = FileFormat((b"\x89HDF\r\n\x1a\n",), _read_hdf5, offsets=(0, 512))
_FORMATS = (_HDF5, NUMPY, ZIP, MATLAB, ARROW, EXCEL, TDMS)
"""In the order in which they are asked."""

_TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".lvm", ".gz", "")
_PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
_PICKLED = "Python pickles are not read (they can run code): df.to_parquet(), or dbo.identify(df)"
_JSON = "JSON is not read: pandas.read_json(FILE).to_csv(OUT, index=False)"
_EXPORT = "this format is not read: export it as CSV"
_NO_HDF5 = "this is no HDF5 file: write it again, or look at its name"
_REFUSED = {
    ".pkl": _PICKLED, ".pickle": _PICKLED, ".json": _JSON, ".jsonl": _JSON,
    ".uff": _EXPORT, ".unv": _EXPORT, ".itx": _EXPORT, ".h5": _NO_HDF5, ".hdf5": _NO_HDF5,
}  # fmt: skip
"""By suffix, what to do with a file of a format that is not read."""


def reader_of(path: str, start: bytes) -> TableReader | None:
    """Return what reads a file; None for text.

    Parameters
    ----------
    path
        The file; its suffix decides where its bytes do not.
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
    for file_format in _FORMATS:
        magics, offsets = file_format.magics, file_format.offsets
        if any(start.startswith(magics, offset) for offset in offsets):
            return file_format.read
    if suffix in _REFUSED or start[:2] in _PICKLES:
        raise InputError(f"{path}: {_REFUSED.get(suffix, _PICKLED)}")
    for file_format in _FORMATS:
        if suffix in file_format.suffixes:
            return file_format.read
    return None
