"""Files that are no text, each read by the library that owns its format.

A reader is a function ``open_X(path, part, reading) -> Source``; ``part`` is what stands
behind ``::``. Its library is imported when such a file is opened. A plain table of
columns is read: vectors, columns of a matrix, fields of records. A reader of another
package joins as an entry point of the group ``dbo_cli.readers``, named by the suffix of
its files (``.xyz``).
"""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.settings import Statement, is_clock_setting, stated_clock
from dbo_cli.logs.source import BLOCK_ROWS, NOT_A_TIME, Column, Reading, Source
from dbo_cli.units import spell, split_header

Reader = Callable[[str, str, Reading], Source]
Fetch = Callable[[int, int], Any]

PLAIN_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".lvm", ".gz", "")
STRETCH = 1 << 19  # rows that polars hands out at once
MATLAB_NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16",
                  "uint32", "uint64", "logical")  # fmt: skip
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


def reader_of(path: str, start: bytes) -> Reader | None:
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
    if suffix not in PLAIN_SUFFIXES:
        from importlib.metadata import entry_points

        for point in entry_points(group="dbo_cli.readers", name=suffix):
            foreign: Reader = point.load()
            return foreign
    if HDF5_MAGIC in (start[:8], start[512:520]):
        from dbo_cli.logs.hdf5 import open_hdf5

        return open_hdf5
    if suffix in _REFUSED or start[:2] in _PICKLES:
        raise InputError(f"{path}: {_REFUSED.get(suffix, _REFUSED['.pkl'])}")
    for magic, reader in _BY_MAGIC.items():
        if start.startswith(magic):
            return reader
    if suffix == ".mat":  # version 4 has no mark
        return open_matlab
    return None


def import_extra(module: str, extra: str, path: str) -> Any:
    """Import a library that is not always installed (InputError)."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{path}: needs {module}: pip install 'dbo-cli[{extra}]'"
        ) from None


@contextlib.contextmanager
def fenced(path: str, kind: str) -> Iterator[None]:
    """Turn whatever a library raises at damaged bytes into one line (InputError)."""
    try:
        yield
    except (DboError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as problem:  # a panic of polars is no Exception
        reason = str(problem).strip().splitlines() or [type(problem).__name__]
        raise InputError(f"{path}: cannot be read as {kind}: {reason[0]}") from None


# --- columns ---


@dataclass(frozen=True)
class StoredColumn:
    """A column that was found: its rows come from ``fetch(start, stop)``, counted from 0.

    ``fetch`` is None where they are stored in other files; ``problem`` says why they may
    not be what they are taken for.
    """

    name: str
    length: int
    fetch: Fetch | None
    unit: str | None = None
    kind: str = "number"
    problem: str = ""


class ArraySource(Source):
    """Columns that a library hands out by rows.

    Parameters
    ----------
    path
        The file, for messages.
    members
        Its columns.
    statements
        What it states beside them of the sample rate and the first row's time.
    close
        Called at the end.
    """

    def __init__(
        self,
        path: str,
        members: Sequence[StoredColumn],
        statements: Sequence[Statement] = (),
        close: Callable[[], object] = lambda: None,
    ) -> None:
        super().__init__(path, (), stated_clock(statements))
        self._members: list[StoredColumn] = []
        self._close = close
        for column in members:
            self.add(column)

    def add(self, stored: StoredColumn) -> Column:
        """Add a column."""
        unit = spell(stored.unit) or split_header(stored.name.rsplit("/", 1)[-1])[1]
        column = Column(len(self.columns) + 1, stored.name, unit, stored.kind)
        self.columns.append(column)
        self._members.append(stored)
        return column

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Source``.

        Raises
        ------
        InputError
            The columns are of unequal length, or the library fails.
        """
        lengths = [self._members[column.number - 1].length for column in chosen]
        if len(set(lengths)) > 1:
            pairs = zip(chosen, lengths, strict=True)
            listed = ", ".join(f"{column.label} {rows}" for column, rows in pairs)
            raise InputError(
                f"{self.name}: the columns are of unequal length: {listed}"
            )
        for start in range(0, lengths[0], BLOCK_ROWS):
            stop = min(lengths[0], start + BLOCK_ROWS)
            self.first_row = start + 1
            for column in chosen:
                self.last_block[column.number] = self._read(column, start, stop)
            yield [self.last_block[column.number] for column in chosen]

    def _read(self, column: Column, start: int, stop: int) -> NDArray[Any]:
        """Read rows of one column as float64, or dates as int64 nanoseconds."""
        fetch = self._members[column.number - 1].fetch
        if fetch is None:
            raise InputError(
                f"{self.name}: {column.label} is stored in other files: copy them into one with h5repack"
            )
        with fenced(self.name, column.label):
            stored = np.asarray(fetch(start, stop))
            if stored.dtype.kind == "M":
                stored = stored.astype("datetime64[ns]").astype(np.int64)
            elif column.kind == "number":
                stored = np.ascontiguousarray(stored, dtype=np.float64)
        if len(stored) != stop - start:
            raise InputError(f"{self.name}: {column.label} ends early: damaged?")
        return stored

    def close(self) -> None:
        """Close the file."""
        self._close()


def array_columns(name: str, array: Any) -> list[StoredColumn]:
    """Take a vector, a matrix (its longer axis is time) or records apart; nothing for text."""
    columns: list[StoredColumn] = []
    if array.dtype.names is not None:
        for label in array.dtype.names:
            columns += array_columns(label, array[label])
        return columns
    if array.dtype.kind not in "fiubM" or array.ndim not in (1, 2) or not array.size:
        return []
    table = array[:, None] if array.ndim == 1 else array
    if table.shape[0] < table.shape[1]:
        table = table.T
    rows, width = table.shape
    kind = "stamp" if array.dtype.kind == "M" else "number"
    for number in range(width):
        label = f"{name}[{number + 1}]" if name and width > 1 else name
        fetch = rows_of(table[:, number])
        columns.append(StoredColumn(label, rows, fetch, kind=kind))
    return columns


def rows_of(stored: Any) -> Fetch:
    """Return what fetches rows of an array, a dataset or a channel."""
    return lambda start, stop: stored[start:stop]


def source_of(path: str, arrays: Mapping[str, Any]) -> Source:
    """Return a source of arrays by name; a single value beside longer ones is a statement."""
    members: list[StoredColumn] = []
    statements: list[Statement] = []
    for name, array in arrays.items():
        columns = array_columns(name, np.asarray(array))
        if is_clock_setting(name) and np.size(array) == 1:
            statements.append((name, np.ravel(array)[0].item(), ""))
        elif columns and columns[0].length > 1:
            members += columns
    if not members:
        contents = [
            f"{name} ({np.asarray(array).dtype})" for name, array in arrays.items()
        ]
        raise no_columns(path, contents)
    return ArraySource(path, members, statements)


def no_columns(path: str, contents: Iterable[str], advice: str = "") -> InputError:
    """Return the refusal of a file without columns of numbers."""
    listed = ", ".join(contents) or "nothing"
    return InputError(f"{path}: no columns of numbers: it has {listed[:300]}{advice}")


def _refuse_part(path: str, part: str) -> None:
    if part:
        raise InputError(f"{path}::{part}: this format has no parts: type {path}")


# --- NumPy ---


def open_npy(path: str, part: str, reading: Reading) -> Source:
    """Open an array: the fields of records, or the columns of a matrix by number (InputError)."""
    _refuse_part(path, part)
    with fenced(path, "NumPy"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    members = array_columns("", array)
    if not members:
        raise no_columns(path, [f"{array.dtype} {array.shape}"])
    return ArraySource(path, members)


def open_zip(path: str, part: str, reading: Reading) -> Source:
    """Open a zip archive: NumPy's arrays, or a workbook (InputError)."""
    import zipfile

    with fenced(path, "a zip archive"), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    if any(name.startswith("xl/") or name == "content.xml" for name in names):
        return open_excel(path, part, reading)
    if not any(name.endswith(".npy") for name in names):
        raise InputError(f"{path}: this is a zip archive: unpack it")
    _refuse_part(path, part)
    with fenced(path, "NumPy"), np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return source_of(path, arrays)


# --- MATLAB ---


def open_matlab(path: str, part: str, reading: Reading) -> Source:
    """Open a MATLAB file before version 7.3: vectors, and columns of matrices (InputError).

    Structs and objects are not even loaded: scipy ends the process at damaged ones.
    """
    import scipy.io

    _refuse_part(path, part)
    arrays: dict[str, Any] = {}
    with fenced(path, "MATLAB"):
        try:
            contents = scipy.io.whosmat(path)
            names = [name for name, _, kind in contents if kind in MATLAB_NUMBERS]
            if names:
                arrays = scipy.io.loadmat(path, squeeze_me=True, variable_names=names)
        except (IndexError, EOFError):
            raise ValueError("it ends early") from None
    if not arrays:
        listed = [f"{name} ({kind})" for name, _, kind in contents]
        advice = ": save('run.mat', '-struct', 'NAME') saves the fields of a struct"
        raise no_columns(path, listed, advice)
    return source_of(path, {n: a for n, a in arrays.items() if n[:2] != "__"})


# --- Parquet and Feather ---


class ArrowSource(Source):
    """The columns of a Parquet or Feather file, read in stretches of rows (InputError)."""

    def __init__(self, path: str, part: str, reading: Reading) -> None:
        import polars as pl

        _refuse_part(path, part)
        super().__init__(path, ())
        with fenced(path, "Parquet or Feather"):
            with open(path, "rb") as file:
                is_parquet = file.read(4) == b"PAR1"
            self._scan = pl.scan_parquet(path) if is_parquet else pl.scan_ipc(path)
            schema = self._scan.collect_schema()
            self._rows = int(self._scan.select(pl.len()).collect().item())
        for number, (name, stored) in enumerate(schema.items(), start=1):
            kind = "text"
            if stored in (pl.Datetime, pl.Time):
                kind = "stamp"
            elif stored.is_numeric() or stored == pl.Boolean:
                kind = "number"
            self.columns.append(Column(number, name, split_header(name)[1], kind))

    def blocks(self, chosen: Sequence[Column]) -> Iterator[list[NDArray[Any]]]:
        """Return all rows of the chosen columns; see ``Source``."""
        names = [column.name for column in chosen]
        for start in range(0, self._rows, STRETCH):
            with fenced(self.name, "Parquet or Feather"):
                frame = self._scan.select(names).slice(start, STRETCH).collect()
                arrays = [_arrow_array(frame[name]) for name in names]
            self.first_row = start + 1
            for column, array in zip(chosen, arrays, strict=True):
                self.last_block[column.number] = array
            yield arrays


def _arrow_array(series: Any) -> NDArray[Any]:
    """Return a series as float64, or as int64 nanoseconds."""
    import polars as pl

    if series.dtype == pl.Datetime:  # in UTC, whatever zone it is shown in
        series = series.dt.cast_time_unit("ns")
    if series.dtype in (pl.Datetime, pl.Time):
        stamps = series.to_physical().fill_null(NOT_A_TIME)
        return np.asarray(stamps.to_numpy())
    return np.asarray(series.cast(pl.Float64).to_numpy())


# --- Excel ---


def open_excel(path: str, part: str, reading: Reading) -> Source:
    """Open the only sheet of a workbook, or ``FILE::SHEET`` (InputError).

    The sheet becomes text with tabs, which is read as any text.
    """
    from dbo_cli.logs.stream import ByteStream
    from dbo_cli.logs.text import TextSource

    fastexcel = import_extra("fastexcel", "excel", path)
    with fenced(path, "a workbook"):
        book = fastexcel.read_excel(path)
        names = list(book.sheet_names)
        if (part or len(names) > 1) and part not in names:
            raise InputError(
                f"{path}: several sheets, {', '.join(names)}: type {path}::{names[0]}"
            )
        content = _sheet_as_text(book, part or names[0])
    stream = ByteStream(path, content)
    return TextSource(stream, replace(reading, delimiter="tab", encoding=None))


def _sheet_as_text(book: Any, name: str) -> bytes:
    """Write a sheet as text with tabs; its numbers keep all their digits."""
    import polars as pl

    plain = {"header_row": None, "skip_rows": 0}
    shown = book.load_sheet(name, dtypes="string", **plain).to_polars()
    exact = book.load_sheet(name, dtypes="float", **plain).to_polars()
    columns = []
    for text, number in zip(shown.get_columns(), exact.get_columns(), strict=True):
        words = text.str.replace_all(r"[\t\r\n]", " ")
        figures = number.cast(pl.String).fill_null(words)
        is_date = text.str.contains(r"^\d{4}-\d\d-\d\d").fill_null(False)
        columns.append(figures.zip_with(~is_date, words))
    table = pl.DataFrame(columns)
    written: str = table.write_csv(
        include_header=False, separator="\t", quote_style="never"
    )
    return written.encode()


# --- TDMS ---


def open_tdms(path: str, part: str, reading: Reading) -> Source:
    """Open a TDMS file, or one group of it (``FILE::GROUP``), read in blocks (InputError)."""
    nptdms = import_extra("nptdms", "tdms", path)
    stream = open(path, "rb")
    try:
        with fenced(path, "TDMS"):
            file = nptdms.TdmsFile.open(stream)
            groups = [group for group in file.groups() if part in ("", group.name)]
            members, statements = _channels(groups)
        if not members:
            raise no_columns(path, [f"::{group.name}" for group in file.groups()])
    except BaseException:
        stream.close()
        raise
    source = ArraySource(path, members, statements, stream.close)
    if len(groups) > 1:
        source.hint = f" (or one group alone: {path}::{groups[0].name})"
    return source


def _channels(groups: Sequence[Any]) -> tuple[list[StoredColumn], list[Statement]]:
    """Return the channels of numbers, and what they state of their rate."""
    members: list[StoredColumn] = []
    statements: list[Statement] = []
    for group in groups:
        for channel in group.channels():
            if not len(channel) or channel.dtype.kind not in "fiubM":
                continue
            stated = channel.properties
            unit = stated.get("unit_string") or stated.get("NI_UnitDescription")
            name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
            kind = "stamp" if channel.dtype.kind == "M" else "number"
            rows = rows_of(channel)
            members.append(StoredColumn(name, len(channel), rows, unit, kind))
            if str(stated.get("wf_xname") or "Time").lower() == "time":  # no spectrum
                for key in ("wf_increment", "wf_start_offset"):
                    if isinstance(stated.get(key), int | float):
                        statements.append((key, stated[key], "s"))
                if isinstance(stated.get("wf_start_time"), np.datetime64):
                    start = stated["wf_start_time"].astype("datetime64[us]")
                    statements.append(("wf_start_time", start.astype(int) / 1e6, "s"))
    return members, statements


_BY_MAGIC: dict[bytes, Reader] = {
    b"\x93NUMPY": open_npy,
    b"PK\x03\x04": open_zip,
    b"\xd0\xcf\x11\xe0": open_excel,  # Excel before 2007
    b"MATLAB": open_matlab,
    b"PAR1": ArrowSource,
    b"ARROW1": ArrowSource,
    b"TDSm": open_tdms,
}
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
