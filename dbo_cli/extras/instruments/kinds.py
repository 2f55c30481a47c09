"""Which files are no tables of text: told by their first bytes, or by the ending of an archive's name."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from dbo_cli.logs.request import Request
    from dbo_cli.logs.sample_block import Table

_MODULES = "dbo_cli.extras.instruments"
_ZIP = b"PK\x03\x04"  # APPNOTE.TXT 4.3.7


class FileKind(NamedTuple):
    """A kind of file.

    Attributes
    ----------
    name : str
        What messages call it.
    module, function : str
        What opens it.
    """

    name: str
    module: str
    function: str

    def open(self, request: Request) -> Table:
        """Open a file of this kind (InputError where that fails)."""
        read = getattr(import_module(f"{_MODULES}.{self.module}"), self.function)
        table: Table = read(request)
        return table


_MATLAB = FileKind("a MATLAB file", "binary", "open_matlab")
_NETCDF = FileKind("netCDF", "binary", "open_netcdf")
_EXCEL = FileKind("an Excel workbook", "binary", "open_excel")
_UFF = FileKind("UFF", "binary", "open_uff")
_IGOR = FileKind("an Igor text file", "whole_texts", "open_igor")
_JSON = FileKind("JSON", "whole_texts", "open_json")

# First bytes; the signatures are those of the file(1) database.
BY_START = {
    b"MATLAB 5.0 MAT-file": _MATLAB,
    b"\x93NUMPY": FileKind("a NumPy array", "binary", "open_npy"),
    b"PAR1": FileKind("Parquet", "binary", "open_parquet"),
    b"ARROW1": FileKind("Feather", "binary", "open_feather"),
    b"FEA1": FileKind("Feather", "binary", "open_old_feather"),
    b"TDSm": FileKind("TDMS", "binary", "open_tdms"),
    b"CDF\x01": _NETCDF,
    b"CDF\x02": _NETCDF,
    b"\xd0\xcf\x11\xe0": FileKind("an old Excel workbook", "binary", "open_excel"),
    b"    -1\n": _UFF,
    b"    -1\r\n": _UFF,
    b"IGOR\n": _IGOR,
    b"IGOR\r": _IGOR,
    b'{"': _JSON,
    b"{\n": _JSON,
    b"{\r\n": _JSON,
    b"[{": _JSON,
    b"[[": _JSON,
    b'["': _JSON,
    b"[\n": _JSON,
    b"[\r\n": _JSON,
}
_ZIP_ENDINGS = {
    ".npz": FileKind("a NumPy archive", "binary", "open_npz"),
    ".xlsx": _EXCEL,
    ".xlsm": _EXCEL,
    ".xlsb": _EXCEL,
    ".ods": _EXCEL,
}


def kind_of(head: bytes, path: str) -> FileKind | None:
    """Return the kind of a file; None for a table of text.

    Parameters
    ----------
    head
        The first bytes: 20 or more where the file has as many.
    path
        The file's name; its ending tells archives apart. Empty for a stream.
    """
    ending = os.path.splitext(path.lower())[1]
    if head.startswith(_ZIP):
        return _ZIP_ENDINGS.get(ending)
    for start, kind in BY_START.items():
        if head.startswith(start):
            return kind
    if ending == ".mat" and _is_matlab_4(head):
        return _MATLAB
    return None


def _is_matlab_4(head: bytes) -> bool:
    """Check the five whole numbers that begin every matrix of a MATLAB v4 file."""
    for order in ("little", "big"):
        numbers = [
            int.from_bytes(head[at : at + 4], order, signed=True)
            for at in range(0, 20, 4)
        ]
        kind, rows, columns, imaginary, name = numbers
        if (
            0 <= kind < 5000
            and min(rows, columns) >= 0
            and imaginary in (0, 1)
            and 0 < name < 512
        ):
            return len(head) >= 20
    return False
