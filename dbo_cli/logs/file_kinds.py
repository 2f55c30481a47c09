"""Which reader a file needs: what it is called matters less than what it is."""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dbo_cli.errors import InputError
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.held_table import ReadLog
from dbo_cli.logs.reading_options import ReadingOptions
from dbo_cli.logs.text.text_table import TextTable

if TYPE_CHECKING:
    from dbo_cli.logs.sample_block import Table

# First bytes, and the module and function that read such a file; a library is imported only then.
_SIGNATURES = {
    b"MATLAB 5.0 MAT-file": ("binary.scipy_files", "open_matlab"),
    b"\x93NUMPY": ("binary.numpy", "open_npy"),
    b"PAR1": ("binary.arrow", "open_parquet"),
    b"ARROW1": ("binary.arrow", "open_feather"),
    b"FEA1": ("binary.arrow", "open_old_feather"),
    b"TDSm": ("binary.tdms", "open_tdms"),
    b"CDF\x01": ("binary.scipy_files", "open_netcdf"),
    b"CDF\x02": ("binary.scipy_files", "open_netcdf"),
    b"\xd0\xcf\x11\xe0": ("binary.excel", "open_excel"),
}
_ZIP = b"PK\x03\x04"
_EXCEL = ("binary.excel", "open_excel")
_ZIP_ENDINGS = {
    ".npz": ("binary.numpy", "open_npz"), ".xlsx": _EXCEL, ".xlsm": _EXCEL, ".xlsb": _EXCEL, ".ods": _EXCEL
}  # fmt: skip
_HDF5 = ("hdf5.reader", "open_hdf5")
_USER_BLOCKS = (512, 1024, 2048)  # where an HDF5 file may begin instead (MATLAB v7.3: 512)


def open_table(
    address: Address, options: ReadingOptions, live: bool, digest: bool, named: Sequence[str]
) -> Table:
    """Open a log with the reader that its first bytes (or its name) ask for.

    Raises
    ------
    InputError
        The file cannot be read, or a library that reads it is not installed.
    """
    if isinstance(address, ReadLog) and address.table is not None:
        return address.table.opened()
    reader = _reader_by_content(address) or (_HDF5 if address.kind == "hdf5" else None)
    if reader is None:
        return TextTable(address, options, live=live, digest=digest)
    from dbo_cli.logs.column_table import Request

    module, function = reader
    read = getattr(importlib.import_module(f"dbo_cli.logs.{module}"), function)
    opened: Table = read(Request(address, named, options))
    return opened


def _reader_by_content(address: Address) -> tuple[str, str] | None:
    if address.is_stream or not (os.path.isfile(address.path) and os.access(address.path, os.R_OK)):
        return None
    lower = address.path.lower()
    with open(address.path, "rb") as file:
        head = file.read(2056)
    _refuse_own(address.text, head)
    if head.startswith(_ZIP):
        return _ZIP_ENDINGS.get(os.path.splitext(lower)[1])
    if any(head[at : at + 8] == b"\x89HDF\r\n\x1a\n" for at in (0, *_USER_BLOCKS)):
        return _HDF5
    for signature, reader in _SIGNATURES.items():
        if head.startswith(signature):
            return reader
    if lower.endswith(".mat") and _is_matlab_4(head):
        return "binary.scipy_files", "open_matlab"
    return None


def _refuse_own(place: str, head: bytes) -> None:
    """Refuse what this program wrote and is no log (InputError)."""
    kind = re.match(rb'\{\s*"format":\s*"dbo-(model|model-set|state|report)"', head)
    if kind is not None:
        remedy = "; a report takes a model as `model`" if kind[1] == b"model" else ""
        raise InputError(f"{place}: this is a {kind[1].decode()}, not a log (give a recording{remedy})")


def _is_matlab_4(head: bytes) -> bool:
    """Check the five whole numbers that begin every matrix of a MATLAB v4 file."""
    if len(head) < 20:
        return False
    for order in ("little", "big"):
        kind, rows, columns, imaginary, name = (
            int.from_bytes(head[at : at + 4], order, signed=True) for at in range(0, 20, 4)
        )
        if 0 <= kind < 5000 and rows >= 0 and columns >= 0 and imaginary in (0, 1) and 0 < name < 512:
            return True
    return False
