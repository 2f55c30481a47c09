"""Files that are no text, each read by the library that owns its format.

A reader is a function ``open_X(path, part, reading) -> Source``; ``part`` is what stands
behind ``::``. Its library is imported when such a file is opened. A reader of another
package joins as an entry point of the group ``dbo_cli.readers``, named by the suffix of
its files (``.xyz``).
"""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from dbo_cli.errors import DboError, InputError
from dbo_cli.logs.headers import is_clock_key, stated_rate
from dbo_cli.logs.source import NOT_A_TIME, ArraySource, Column, Fetch, Reading, Source
from dbo_cli.units import spell, split_header

Reader = Callable[[str, str, Reading], Source]
Statement = tuple[str, object, str]  # what a file states: key, value, unit

PLAIN_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".lvm", ".gz", "")
STRETCH = 1 << 20  # rows of one column that polars hands out at once (8 MB)
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
PICKLES = "Python pickles are not read (they can run code): df.to_parquet(), or dbo.identify(df)"
_START_KEYS = ("tstart", "t0", "x0", "wf_start_offset")  # s, the time of the first row


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
        foreign = _foreign_reader(suffix)
        if foreign is not None:
            return foreign
    if HDF5_MAGIC in (start[:8], start[512:520]):
        return _open_hdf5
    _refuse(path, start, suffix)
    for magic, reader in _BY_MAGIC.items():
        if start.startswith(magic):
            return reader
    if suffix == ".mat":  # version 4 has no mark
        return open_matlab
    return None


def _refuse(path: str, start: bytes, suffix: str) -> None:
    """Refuse the formats that are not read, each with what to do (InputError)."""
    for magic, advice in _REFUSED.items():
        if start.startswith(magic):
            raise InputError(f"{path}: {advice}")
    if suffix in _REFUSED_SUFFIXES:
        raise InputError(f"{path}: {_REFUSED_SUFFIXES[suffix]}")
    if suffix in (".h5", ".hdf5", ".nxs"):
        raise InputError(
            f"{path}: this is no HDF5 file: write it again, or look at its name"
        )


def _foreign_reader(suffix: str) -> Reader | None:
    """Return the reader that another package has for a suffix."""
    from importlib.metadata import entry_points

    for point in entry_points(group="dbo_cli.readers", name=suffix):
        reader: Reader = point.load()
        return reader
    return None


def _open_hdf5(path: str, part: str, reading: Reading) -> Source:
    from dbo_cli.logs.hdf5 import open_hdf5

    return open_hdf5(path, part, reading)


def import_extra(module: str, extra: str, path: str) -> Any:
    """Import a library that is not always installed (InputError)."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{path}: {module} is needed to read it: pip install 'dbo-cli[{extra}]'"
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
class Found:
    """A column that was found: its rows come from ``fetch(start, stop)``."""

    name: str
    length: int
    fetch: Fetch
    unit: str | None = None
    kind: str = "number"


@dataclass
class Group:
    """A place in a file that may hold columns, and what is stated there."""

    path: str
    depth: int
    columns: list[Found] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)


class LibrarySource(ArraySource):
    """The columns of a file that a library reads.

    Attributes
    ----------
    rate_problem, rate_remarks
        Why the stated rate cannot be used where one is needed, and what it assumes.
    hint
        What else may be typed where the columns are not clear, behind a blank.
    """

    def __init__(
        self,
        path: str,
        found: Sequence[Found],
        statements: Iterable[Statement] = (),
        close: Callable[[], object] | None = None,
        remarks: Sequence[str] = (),
    ) -> None:
        columns = []
        for number, one in enumerate(found, 1):
            unit = spell(one.unit) or split_header(one.name.rsplit("/", 1)[-1])[1]
            columns.append(Column(number, one.name, unit, one.kind))
        fetch = [one.fetch for one in found]
        lengths = [one.length for one in found]
        super().__init__(path, columns, fetch, lengths, None, 0.0, remarks, close)
        self.rate_problem = ""
        self.rate_remarks: list[str] = []
        self.hint = ""
        stated = list(statements)
        try:
            self.rate = stated_rate(stated, self.rate_remarks)
        except InputError as problem:
            self.rate_problem = str(problem)
        for key, value, _ in stated:
            if key.lower() in _START_KEYS and isinstance(value, int | float):
                self.start = float(value)

    def add(self, found: Found) -> Column:
        """Add a column that the user named by its path."""
        unit = spell(found.unit) or split_header(found.name.rsplit("/", 1)[-1])[1]
        column = Column(len(self.columns) + 1, found.name, unit, found.kind)
        self.columns.append(column)
        self._fetch = [*self._fetch, found.fetch]
        self._lengths = [*self._lengths, found.length]
        return column


def choose(groups: Sequence[Group]) -> tuple[list[Group], bool]:
    """Return the groups whose columns are meant, and whether it is one group alone.

    The shallowest groups with columns count; of several the only one that has more than
    one column. Where that does not decide, all of them are returned.
    """
    longest = 0
    for group in groups:
        longest = max([longest, *(column.length for column in group.columns)])
    holding = []
    for group in groups:
        rows = max((column.length for column in group.columns), default=0)
        if rows > min(1, longest - 1):  # single values beside longer columns are none
            holding.append(group)
    if not holding:
        return [], True
    depth = min(group.depth for group in holding)
    holding = [group for group in holding if group.depth == depth]
    wide = [group for group in holding if len(group.columns) > 1]
    if len(wide) == 1:
        holding = wide
    return holding, len(holding) == 1


def chosen_columns(
    path: str, groups: Sequence[Group], separator: str
) -> tuple[list[Found], str]:
    """Return the columns that are meant, and a hint where several groups have some.

    Columns of several groups are called by their paths.
    """
    chosen, is_alone = choose(groups)
    found: list[Found] = []
    for group in chosen:
        for column in group.columns:
            name = column.name
            if not is_alone:
                name = f"{group.path}{separator}{name}".lstrip(separator)
            found.append(
                Found(name, column.length, column.fetch, column.unit, column.kind)
            )
    if is_alone:
        return found, ""
    return found, f" (or one group alone: {path}::{chosen[0].path})"


def without_single_values(found: Sequence[Found]) -> list[Found]:
    """Leave out columns of one row beside longer ones: a rate, a count."""
    longest = max((one.length for one in found), default=0)
    if longest < 2:
        return list(found)
    return [one for one in found if one.length > 1]


def array_columns(name: str, array: Any, unit: str | None = None) -> list[Found]:
    """Take a vector, a matrix (its longer axis is time) or records apart; nothing for text."""
    if array.dtype.names is not None:
        columns = []
        for label in array.dtype.names:
            path = f"{name}/{label}" if name else label
            columns += array_columns(path, array[label], unit)
        return columns
    if array.dtype.kind not in "fiubmM" or array.ndim not in (1, 2) or not array.size:
        return []
    if array.ndim == 1:
        return [_vector(name, array, unit)]
    table = array if array.shape[0] >= array.shape[1] else array.T
    if table.shape[1] == 1:
        return [_vector(name, table[:, 0], unit)]
    columns = []
    for number in range(table.shape[1]):
        label = f"{name}[{number + 1}]" if name else ""
        columns.append(_vector(label, table[:, number], unit))
    return columns


def _vector(name: str, array: Any, unit: str | None) -> Found:
    if array.dtype.kind == "m":
        array = array / np.timedelta64(1, "s")
        unit = "s"
    kind = "stamp" if array.dtype.kind == "M" else "number"
    return Found(name, len(array), lambda start, stop: array[start:stop], unit, kind)


def _nothing(path: str, held: Iterable[str]) -> InputError:
    listed = ", ".join(held) or "nothing"
    return InputError(f"{path}: no columns of numbers: it holds {listed[:300]}")


def _refuse_part(path: str, part: str) -> None:
    if part:
        raise InputError(f"{path}::{part}: this format has no parts: write {path}")


# --- NumPy ---


def open_npy(path: str, part: str, reading: Reading) -> Source:
    """Open an array: the fields of records, or the columns of a matrix by number (InputError)."""
    _refuse_part(path, part)
    with fenced(path, "NumPy"):
        columns = _mapped(path)
        if not columns:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
            raise _nothing(path, [f"{array.dtype} {array.shape}"])
    found = []
    for number, column in enumerate(columns):
        fetch = _mapped_rows(path, number)
        found.append(Found(column.name, column.length, fetch, None, column.kind))
    return LibrarySource(path, found)


def _mapped(path: str) -> list[Found]:
    """Map an array; it is mapped anew for each stretch, so its pages are given back."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except ValueError as problem:
        if "pickle" in str(problem) or "Python objects" in str(problem):
            raise InputError(f"{path}: {PICKLES}") from None
        raise
    return array_columns("", array)


def _mapped_rows(path: str, number: int) -> Fetch:
    return lambda start, stop: np.array(_mapped(path)[number].fetch(start, stop))


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
    arrays = {}
    with fenced(path, "NumPy"), np.load(path, allow_pickle=False) as stored:
        for name in stored.files:
            try:
                arrays[name] = stored[name]
            except ValueError as problem:
                if "pickle" not in str(problem):
                    raise
                arrays[name] = np.array("pickled objects")
    found = []
    for name, array in arrays.items():
        found += array_columns(name, array)
    found = without_single_values(found)
    if not found:
        raise _nothing(
            path, [f"{name} ({array.dtype})" for name, array in arrays.items()]
        )
    return LibrarySource(path, found, _single_values(arrays))


def _single_values(members: Mapping[str, Any]) -> list[Statement]:
    """Return what single values state of the sample rate and the first row's time."""
    statements: list[Statement] = []
    for name, value in members.items():
        is_key = is_clock_key(name) or name.lower() in _START_KEYS
        if is_key and not isinstance(value, dict | list) and np.size(value) == 1:
            statements.append((name, np.ravel(value)[0].item(), ""))
    return statements


# --- MATLAB ---


def open_matlab(path: str, part: str, reading: Reading) -> Source:
    """Open a MATLAB file before version 7.3: vectors, columns of matrices, fields of structs.

    ``FILE::run.first`` is one struct.

    Raises
    ------
    InputError
        It is damaged, holds no columns of numbers, or has no such struct.
    """
    import scipy.io

    with fenced(path, "MATLAB"):
        try:
            stored = scipy.io.loadmat(path, simplify_cells=True)
        except (IndexError, EOFError):
            raise ValueError("it ends early") from None
    top: dict[str, Any] = {}
    for name, value in stored.items():
        if not name.startswith("__"):
            top[name] = value
    statements = _single_values(top)
    struct: Any = top
    for step in filter(None, part.replace("/", ".").split(".")):
        struct = struct.get(step) if isinstance(struct, dict) else None
        if not isinstance(struct, dict):
            names = [name for name, value in top.items() if isinstance(value, dict)]
            raise InputError(
                f"{path}::{part}: there is no struct '{step}': it has {', '.join(names) or 'none'}"
            )
    groups = list(_structs(struct, part, 0))
    found, hint = chosen_columns(path, groups, ".")
    if not found:
        advice = ""
        if "__function_workspace__" in stored:
            advice = "; MATLAB's own objects are not read: save vectors, save('run.mat', 't', 'voltage')"
        held = [f"{name} ({type(value).__name__})" for name, value in struct.items()]
        raise InputError(f"{_nothing(path, held)}{advice}")
    nearest = choose(groups)[0][0].statements
    source = LibrarySource(path, found, nearest or statements)
    source.hint = hint
    return source


def _structs(struct: Mapping[str, Any], name: str, depth: int) -> Iterator[Group]:
    """Return a struct and all structs in it."""
    group = Group(name, depth, statements=_single_values(struct))
    for key, value in struct.items():
        if isinstance(value, np.ndarray):
            unit = _text(struct.get(f"{key}_unit", struct.get(f"{key}_units")))
            group.columns += array_columns(key, value, unit)
    group.columns = without_single_values(group.columns)
    yield group
    for key, value in struct.items():
        if isinstance(value, dict):
            yield from _structs(value, f"{name}.{key}".lstrip("."), depth + 1)


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value else None


# --- Parquet and Feather ---


def open_arrow(path: str, part: str, reading: Reading) -> Source:
    """Open a Parquet or Feather file, read in stretches of rows (InputError)."""
    import polars as pl

    _refuse_part(path, part)
    with fenced(path, "Parquet or Feather"):
        with open(path, "rb") as file:
            is_parquet = file.read(4) == b"PAR1"
        scan = pl.scan_parquet(path) if is_parquet else pl.scan_ipc(path)
        schema = scan.collect_schema()
        rows = int(scan.select(pl.len()).collect().item())
    metadata = _parquet_metadata(path) if is_parquet else {}
    units = metadata.pop("units", {})
    found = []
    for name, stored in schema.items():
        if name == "__index_level_0__" and stored.is_integer():
            continue  # pandas' row numbers
        kind = "number"
        if stored in (pl.Datetime, pl.Time):
            kind = "stamp"
        elif not stored.is_numeric() and stored not in (pl.Boolean, pl.Duration):
            continue
        unit = "s" if stored == pl.Duration else units.get(name)
        label = "time" if name == "__index_level_0__" else name
        found.append(Found(label, rows, _arrow_rows(path, scan, name), unit, kind))
    if not found:
        raise _nothing(path, [f"{name} ({stored})" for name, stored in schema.items()])
    statements: list[Statement] = []
    for key, value in metadata.items():
        statements.append((key, value, str(metadata.get(f"{key}_unit", ""))))
    return LibrarySource(path, found, statements)


def _arrow_rows(path: str, scan: Any, name: str) -> Fetch:
    """Return what reads rows of a column; the last stretch is kept for the next rows."""
    import polars as pl

    @lru_cache(maxsize=1)
    def stretch(number: int) -> Any:
        with fenced(path, "Parquet or Feather"):
            part = scan.select(pl.col(name)).slice(number * STRETCH, STRETCH)
            series = part.collect().to_series()
        if series.dtype == pl.Datetime:  # in UTC, whatever zone it is shown in
            return (
                series.dt.cast_time_unit("ns")
                .to_physical()
                .fill_null(NOT_A_TIME)
                .to_numpy()
            )
        if series.dtype == pl.Time:
            return series.to_physical().fill_null(NOT_A_TIME).to_numpy()
        if series.dtype == pl.Duration:
            return series.dt.total_nanoseconds().to_numpy() / 1e9
        return series.cast(pl.Float64).to_numpy()

    def fetch(start: int, stop: int) -> Any:
        pieces = []
        for number in range(start // STRETCH, (stop - 1) // STRETCH + 1):
            first = number * STRETCH
            pieces.append(stretch(number)[max(0, start - first) : stop - first])
        return np.concatenate(pieces)

    return fetch


def _parquet_metadata(path: str) -> dict[str, Any]:
    """Return ``DataFrame.attrs`` as pandas stores them: ``units`` by column, a rate."""
    import json

    import polars as pl

    with fenced(path, "Parquet"):
        stored = pl.read_parquet_metadata(path)
    try:
        attributes = json.loads(stored.get("PANDAS_ATTRS", "{}"))
    except ValueError:
        return {}
    if not isinstance(attributes, dict):
        return {}
    if not isinstance(attributes.get("units", {}), dict):
        attributes["units"] = {}
    return attributes


# --- Excel ---


def open_excel(path: str, part: str, reading: Reading) -> Source:
    """Open a workbook's only sheet with numbers, or ``FILE::SHEET`` (InputError).

    The sheet becomes text with tabs, which is read as any text.
    """
    from dbo_cli.logs.text import ByteStream, TextSource

    fastexcel = import_extra("fastexcel", "excel", path)
    with fenced(path, "a workbook"):
        book = fastexcel.read_excel(path)
        names = list(book.sheet_names)
        if part and part not in names:
            listed = ", ".join(f"'{name}'" for name in names)
            raise InputError(
                f"{path}: there is no sheet '{part}': the sheets are {listed}"
            )
        texts = {}
        for name in [part] if part else names:
            text = _sheet_as_text(book, name)
            if part or _has_numbers(text):
                texts[name] = text
    if len(texts) != 1:
        listed = ", ".join(f"'{name}'" for name in texts) or "none"
        example = next(iter(texts), names[0] if names else "SHEET")
        raise InputError(
            f"{path}: sheets that hold numbers: {listed}: which one? (write {path}::{example})"
        )
    stream = ByteStream(path, next(iter(texts.values())))
    return TextSource(path, stream, replace(reading, delimiter="tab", encoding=None))


def _has_numbers(text: bytes) -> bool:
    """Tell whether a sheet has a row of two numbers or more among its first."""
    for line in text.split(b"\n")[:200]:
        filled = [cell for cell in line.split(b"\t") if cell]
        numbers = [cell for cell in filled if _is_number(cell)]
        if len(numbers) > 1 or (numbers and len(filled) == 1):
            return True
    return False


def _is_number(cell: bytes) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _sheet_as_text(book: Any, name: str) -> bytes:
    """Write a sheet as text with tabs; its numbers keep all their digits."""
    import polars as pl

    plain = {"header_row": None, "skip_rows": 0}
    shown = book.load_sheet(name, dtypes="string", **plain).to_polars()
    exact = book.load_sheet(name, dtypes="float", **plain).to_polars()
    columns = []
    for text, number in zip(shown.get_columns(), exact.get_columns(), strict=True):
        frame = pl.DataFrame({"text": text, "number": number})
        is_date = pl.col("text").str.contains(r"^\d{4}-\d\d-\d\d")
        is_number = pl.col("number").is_not_null() & ~is_date
        words = pl.col("text").str.replace_all(r"[\t\r\n]", " ")
        words = words.str.replace(
            r"^1899-12-3[01] ", ""
        )  # a time of day without a date
        cell = (
            pl.when(is_number).then(pl.col("number").cast(pl.String)).otherwise(words)
        )
        columns.append(frame.select(cell.alias(text.name)).to_series())
    if not columns:
        return b""
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
            found, statements = _channels(groups)
        if not found:
            held = [group.name for group in file.groups()]
            raise _nothing(f"{path}::{part}" if part else path, held)
    except BaseException:
        stream.close()
        raise
    return LibrarySource(path, found, statements, stream.close)


def _channels(groups: Sequence[Any]) -> tuple[list[Found], list[Statement]]:
    """Return the channels of numbers, and what they state of their rate."""
    found: list[Found] = []
    statements: list[Statement] = []
    for group in groups:
        for channel in group.channels():
            if not len(channel) or channel.dtype.kind not in "fiubM":
                continue
            stated = channel.properties
            unit = stated.get("unit_string") or stated.get("NI_UnitDescription")
            name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
            kind = "stamp" if channel.dtype.kind == "M" else "number"
            found.append(Found(name, len(channel), _channel_rows(channel), unit, kind))
            if str(stated.get("wf_xname") or "Time").lower() == "time":  # no spectrum
                for key in ("wf_increment", "wf_start_offset"):
                    if isinstance(stated.get(key), int | float):
                        statements.append((key, stated[key], "s"))
    return found, statements


def _channel_rows(channel: Any) -> Fetch:
    return lambda start, stop: channel[start:stop]


_BY_MAGIC: dict[bytes, Reader] = {
    b"\x93NUMPY": open_npy,
    b"PK\x03\x04": open_zip,
    b"\xd0\xcf\x11\xe0": open_excel,  # Excel before 2007
    b"MATLAB": open_matlab,
    b"PAR1": open_arrow,
    b"ARROW1": open_arrow,
    b"TDSm": open_tdms,
}
_REFUSED = {
    b"\x80\x02": PICKLES,
    b"\x80\x03": PICKLES,
    b"\x80\x04": PICKLES,
    b"\x80\x05": PICKLES,
    b"CDF": "netCDF-3 is not read: make it netCDF-4 (nccopy -k nc4 IN OUT), which is HDF5",
    b"FEA1": "Feather version 1 is not read: df.to_feather() of today writes version 2",
    b"SQLite format 3": "data bases are not read: export the table as CSV",
}
_JSON = "JSON is not read: pandas.read_json(FILE).to_csv(OUT, index=False)"
_REFUSED_SUFFIXES = {
    ".pkl": PICKLES,
    ".pickle": PICKLES,
    ".json": _JSON,
    ".jsonl": _JSON,
    ".uff": "universal files are not read: export it as CSV",
    ".unv": "universal files are not read: export it as CSV",
    ".itx": "Igor text is not read: Save/J writes columns with tabs",
}
