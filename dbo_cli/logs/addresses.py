"""Where a signal is read from or written to: a file, a group of an HDF5 file, or a standard stream."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import field, replace
from typing import Any

from dbo_cli.errors import UsageError
from dbo_cli.records import dataclass

# What loggers, oscilloscopes and LabVIEW call delimited text, and HDF5 by its users (HDF-EOS, MATLAB, NeXus).
TEXT_ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".prn", ".log")
HDF5_ENDINGS = (".h5", ".hdf5", ".hdf", ".he5", ".mat", ".nxs")
# Endings of files that hold something else; a signal under such a name would not be what it is called.
_NOT_WRITTEN = {
    ".mat": "MATLAB's own files are not written: call it .h5, and MATLAB's h5read reads it",
    ".nxs": "NeXus is not written: call it .h5",
    ".he5": "HDF-EOS is not written: call it .h5",
    ".h5.gz": "HDF5 is compressed inside: leave out .gz",
    ".hdf5.gz": "HDF5 is compressed inside: leave out .gz",
    ".hdf.gz": "HDF5 is compressed inside: leave out .gz",
    ".lvm": "LabVIEW's own files are not written: call it .txt",
} | {
    ending: f"{ending} is a generator's file, which dbo waveform writes: call this one .csv"
    for ending in (".arb", ".tfw", ".raf", ".i16", ".u16", ".gcs", ".npy", ".wav", ".tdms", ".bin", ".raw")
} | {
    ending: f"{ending} files of generators and oscilloscopes are not written: call it .csv"
    for ending in (".wfm", ".isf", ".awg", ".rdf", ".bsv", ".trc", ".wvf", ".ota")
} | {
    ending: f"{ending} files are not written: .csv, .tsv, .txt, .dat (also with .gz) and .h5 are"
    for ending in (
        ".xlsx", ".xls", ".xlsm", ".xlsb", ".ods", ".parquet", ".pq", ".feather", ".arrow", ".ipc", ".orc",
        ".avro", ".npz", ".pkl", ".pickle", ".tdm", ".nc", ".nc4", ".netcdf", ".cdf",
        ".fits", ".zarr", ".sqlite", ".db", ".dta", ".sav", ".rds", ".rdata",
        ".msgpack", ".json", ".jsonl", ".ndjson", ".yaml", ".yml", ".toml", ".xml", ".html", ".htm", ".pdf",
        ".doc", ".docx", ".tex", ".png", ".svg", ".jpg", ".zip", ".tar", ".tgz", ".tar.gz", ".bz2", ".xz",
        ".zst", ".lz4", ".7z",
    )
}  # fmt: skip
# What a model, a state or a report is written as; every other known ending is that of something else.
_DOCUMENTS = {"json": (".json",), "csv": (".csv",), "html": (".html", ".htm"), "text": ()}
# What ``format`` may be, and the kind of file that it is.
FORMATS = {"csv": "text", "tsv": "text", "txt": "text", "dat": "text", "h5": "hdf5", "hdf5": "hdf5"}


@dataclass(frozen=True)
class Address:
    """What the text of a file's name means; made once, where a text comes in, and handed on as it is.

    ``path`` is ``-`` for a standard stream, ``group`` what stands after ``::``; ``format`` was asked for
    beside the name, and ``kind`` is ``text`` or ``hdf5`` by either, or None where only the content can tell.
    ``table`` holds the columns of a log that is in memory already (``channels.HeldTable``).
    """

    text: str
    path: str
    group: str | None
    kind: str | None
    format: str | None = None
    table: Any = field(default=None, compare=False, repr=False)

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

    @property
    def delimiter(self) -> str:
        """The delimiter of text that is written there."""
        tabs = _plain(self.path).endswith(".tsv") if self.format is None else self.format == "tsv"
        return "\t" if tabs else ","

    def or_format(self, named: str | None) -> Address:
        """Return this address with the format that was asked for, where its own name does not tell one."""
        if named is None or self.kind is not None:
            return self
        return replace(self, kind=FORMATS[named], format=named)

    def refuse_other(self, named: str, shown: str | None = None) -> None:
        """Refuse a format that contradicts the name (UsageError); a name without a known ending does not."""
        own, unlike = _kind_by_name(self.path), {"csv": ".tsv", "tsv": ".csv"}.get(named, "::")
        if own is not None and (own != FORMATS[named] or _plain(self.path).endswith(unlike)):
            raise UsageError(
                f"{shown or self.text}: `format` {named} contradicts this name: leave one of them out"
            )


Given = str | os.PathLike[str] | Address
"""What functions at the door take: a name as a caller gives it, or an address."""


def _plain(path: str) -> str:
    return path.lower().removesuffix(".gz")


def _kind_by_name(path: str) -> str | None:
    if _plain(path).endswith(HDF5_ENDINGS):
        return "hdf5"
    return "text" if _plain(path).endswith(TEXT_ENDINGS) else None


def parse_address(given: Given, format: str | None = None) -> Address:
    """Take the text of a name apart; an address is returned as it is.

    Raises
    ------
    UsageError
        The text is empty, the format is unknown, or a group is asked of a text file.
    """
    if isinstance(given, Address) and format in (None, given.format):
        return given
    text = given.text if isinstance(given, Address) else os.fspath(given)
    if not text:
        raise UsageError("an empty file name was given")
    if format is not None and format not in FORMATS:
        raise UsageError(f"`format` {format}: the formats are {', '.join(FORMATS)}")
    path, separator, group = text.partition("::")
    if separator and os.path.exists(text):
        path, separator, group = text, "", ""  # a file whose name holds the separator
    kind = _kind_by_name(path) if format is None else FORMATS[format]
    if not separator:
        return Address(text, path, None, kind, format)
    if kind == "text":
        raise UsageError(f"{text}: '::' names a group of an HDF5 file, and this is a text file")
    return Address(text, path, group or "/", kind or "hdf5", format)


def parse_output(given: Given, format: str | None = None) -> Address:
    """Take the name of a signal to be written apart; its ending chooses the format.

    Raises
    ------
    UsageError
        As for :func:`parse_address`; or the name belongs to a format that is not written, or contradicts
        ``format``.
    """
    target = parse_address(given, format)
    lower = target.path.lower()
    for ending, reason in _NOT_WRITTEN.items():
        if lower.endswith((ending, ending + ".gz")):
            raise UsageError(f"{target.path}: {reason}")
    if target.format is not None:
        target.refuse_other(target.format, target.path)
    return target


def check_document(address: Given, what: str, form: str) -> None:
    """Refuse a name that is of another format than that of a model, a state or a report.

    Parameters
    ----------
    address
        Where it goes; a stream and a name without a known ending are good.
    what
        How messages call it: ``a model``.
    form
        What it is written as: ``json``, ``csv``, ``html`` or ``text``.

    Raises
    ------
    UsageError
        The name ends in what belongs to another format.
    """
    own, path = _DOCUMENTS[form], parse_address(address).path
    known = {".csv", ".tsv", ".gz", *HDF5_ENDINGS, *_NOT_WRITTEN} - set(own)
    named = _longest_ending(path, known)
    if named:
        stem = path
        while ending := _longest_ending(stem, known | {*own, ".txt"}):
            stem = stem[: -len(ending)]
        kind = "text" if form == "text" else form.upper()
        better = stem + (own[0] if own else ".txt")
        raise UsageError(f"{path}: {what} is written as {kind}, not as {named}: call it {better}")


def _longest_ending(path: str, endings: Collection[str]) -> str:
    return max((one for one in endings if path.lower().endswith(one)), key=len, default="")


def check_format(named: str | None, addresses: Sequence[Address]) -> None:
    """Refuse a format that no address can take and that contradicts the name of one.

    Raises
    ------
    UsageError
        Every name has a format of its own, and one of them another than ``named``.
    """
    if named is not None and all(one.kind is not None for one in addresses):
        for one in addresses:
            one.refuse_other(named)


def other_file(selector: str | None) -> tuple[str, str] | None:
    """Take ``FILE::COLUMN`` or ``FILE::GROUP::COLUMN`` apart; None for a plain column name."""
    if selector is None or "::" not in selector:
        return None
    path, _, rest = selector.partition("::")
    if not os.path.isfile(path):
        return None
    inner, separator, column = rest.rpartition("::")
    return (f"{path}::{inner}", column) if separator else (path, rest)


def selected_files(*selectors: str | None) -> list[str]:
    """List the files that ``FILE::COLUMN`` names: no output may overwrite them."""
    named = [other_file(selector) for selector in selectors]
    return [found[0].partition("::")[0] for found in named if found is not None]


def without_folder(selector: str) -> str:
    """Take the folder off ``FILE::COLUMN``: it differs between machines."""
    if other_file(selector) is None:
        return selector
    path, _, rest = selector.partition("::")
    return f"{os.path.basename(path)}::{rest}"
