"""What is asked for: where a signal is read from or written to, and how a log is to be read.

An address is a file, a group of an HDF5 file, or a standard stream. Options are checked
once, when they are made. A ``Request`` hands both to the reader of a format.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import math
import numbers
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeGuard

from dbo_cli.errors import DboError, InputError, UsageError

if TYPE_CHECKING:
    from dbo_cli.logs.units import Scale

# What loggers, oscilloscopes and LabVIEW call delimited text, and HDF5 by its users
# (HDF-EOS, MATLAB, NeXus).
TEXT_ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm", ".prn", ".log")
HDF5_ENDINGS = (".h5", ".hdf5", ".hdf", ".he5", ".mat", ".nxs")
# Endings of files that hold something else; a signal under such a name would not be
# what it is called.
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
# What a model, a state or a report is written as; every other known ending is that of
# something else.
_DOCUMENTS = {
    "json": (".json",),
    "csv": (".csv",),
    "html": (".html", ".htm"),
    "text": (),
}
# What ``format`` may be, and the kind of file that it is.
FORMATS = {
    "csv": "text",
    "tsv": "text",
    "txt": "text",
    "dat": "text",
    "h5": "hdf5",
    "hdf5": "hdf5",
}


@dataclass(frozen=True)
class Address:
    """What the text of a file's name means; made once, where a text comes in, and handed on as it is.

    ``path`` is ``-`` for a standard stream, ``group`` what stands after ``::``;
    ``format`` was asked for beside the name, and ``kind`` is ``text`` or ``hdf5`` by
    either, or None where only the content can tell. ``table`` holds the columns of a
    log that is in memory already (``channels.HeldTable``).
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
        tabs = self.format == "tsv"
        if self.format is None:
            tabs = _plain(self.path).endswith(".tsv")
        return "\t" if tabs else ","

    def or_format(self, named: str | None) -> Address:
        """Return this address with the format that was asked for, where its own name does not tell one."""
        if named is None or self.kind is not None:
            return self
        return replace(self, kind=FORMATS[named], format=named)

    def refuse_other(self, named: str, shown: str | None = None) -> None:
        """Refuse a format that contradicts the name (UsageError); a name without a known ending does not."""
        kind = _kind_by_name(self.path)
        if kind is None:
            return
        contrary = {"csv": ".tsv", "tsv": ".csv"}.get(named)
        is_contrary = contrary is not None and _plain(self.path).endswith(contrary)
        if kind != FORMATS[named] or is_contrary:
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
    if _plain(path).endswith(TEXT_ENDINGS):
        return "text"
    return None


def parse_address(source: Given, format: str | None = None) -> Address:
    """Take the text of a name apart; an address is returned as it is.

    Raises
    ------
    UsageError
        The text is empty, the format is unknown, or a group is asked of a text file.
    """
    if isinstance(source, Address) and format in (None, source.format):
        return source
    text = source.text if isinstance(source, Address) else os.fspath(source)
    if not text:
        raise UsageError("an empty file name was given")
    if format is not None and format not in FORMATS:
        raise UsageError(f"`format` {format}: the formats are {', '.join(FORMATS)}")
    path, separator, group = text.partition("::")
    if separator and os.path.exists(text):  # a file whose name holds the separator
        path = text
        separator = ""
    kind = _kind_by_name(path) if format is None else FORMATS[format]
    if not separator:
        return Address(text, path, None, kind, format)
    if kind == "text":
        raise UsageError(
            f"{text}: '::' names a group of an HDF5 file, and this is a text file"
        )
    return Address(text, path, group or "/", kind or "hdf5", format)


def parse_output(source: Given, format: str | None = None) -> Address:
    """Take the name of a signal to be written apart; its ending chooses the format.

    Raises
    ------
    UsageError
        As for :func:`parse_address`; or the name belongs to a format that is not
        written, or contradicts ``format``.
    """
    target = parse_address(source, format)
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
    path = parse_address(address).path
    endings = _DOCUMENTS[form]
    others = {".csv", ".tsv", ".gz", *HDF5_ENDINGS, *_NOT_WRITTEN} - set(endings)
    named = _longest_ending(path, others)
    if not named:
        return
    stem = path
    while ending := _longest_ending(stem, others | {*endings, ".txt"}):
        stem = stem[: -len(ending)]
    kind = form.upper()
    better = stem + ".txt"
    if form == "text":
        kind = "text"
    else:
        better = stem + endings[0]
    raise UsageError(
        f"{path}: {what} is written as {kind}, not as {named}: call it {better}"
    )


def _longest_ending(path: str, endings: Collection[str]) -> str:
    longest = ""
    for ending in endings:
        if path.lower().endswith(ending) and len(ending) > len(longest):
            longest = ending
    return longest


def check_format(named: str | None, addresses: Sequence[Address]) -> None:
    """Refuse a format that no address can take and that contradicts the name of one.

    Raises
    ------
    UsageError
        Every name has a format of its own, and one of them another than ``named``.
    """
    if named is not None and all(address.kind is not None for address in addresses):
        for address in addresses:
            address.refuse_other(named)


def other_file(selector: str | None) -> tuple[str, str] | None:
    """Take ``FILE::COLUMN`` or ``FILE::GROUP::COLUMN`` apart; None for a plain column name."""
    if selector is None or "::" not in selector:
        return None
    path, _, rest = selector.partition("::")
    if not os.path.isfile(path):
        return None
    inner, separator, column = rest.rpartition("::")
    if separator:
        return f"{path}::{inner}", column
    return path, rest


def selected_files(*selectors: str | None) -> list[str]:
    """List the files that ``FILE::COLUMN`` names: no output may overwrite them."""
    with_column = []
    alone = []
    for selector in selectors:
        named = other_file(selector)
        if named is not None:
            with_column.append(named[0].partition("::")[0])
        if selector is not None and os.path.isfile(selector):
            alone.append(selector)
    return [*with_column, *alone]


def without_folder(selector: str) -> str:
    """Take the folder off ``FILE::COLUMN``: it differs between machines."""
    if other_file(selector) is None:
        return selector
    path, _, rest = selector.partition("::")
    return f"{os.path.basename(path)}::{rest}"


# --- how a log is to be read ---

Rows = tuple[int, int | None]
"""The first and the last data row that take part, counted from 1; None: to the end."""

ALL_ROWS: Rows = (1, None)
# a megabyte a column: half costs a tenth more time in all, twice as much is no faster
BLOCK_ROWS = 1 << 17
PIPE_ROWS = 1 << 16  # of a pipe: what comes slowly is not waited for any longer
# beyond them a step of time is lost in rounding, or the rows are
_LOWEST_RATE, _HIGHEST_RATE = 1e-9, 1e12

# rows after a bad one, from which on it is said how many of them are bad, too
FEWEST_TO_JUDGE = 20


FILL_GAPS = "bring the signals to common times first (pandas: interpolate(method='index'), dropna)"


def remedy_for(bad: int, rows: int, cause: str = "") -> str:
    """Return what to do about a bad row, of whose next ``rows`` rows ``bad`` are bad, too.

    To drop them is no remedy where most of a log would go; ``cause`` is what to do
    instead.
    """
    if rows < FEWEST_TO_JUDGE or 2 * bad <= rows:
        return "(`skip_bad` drops such rows)"
    cause = cause or "name another column, or take good `rows` A:B"
    return f"(and so on in {bad:,} of the next {rows:,} rows: {cause})"


BLANKS = " "  # the delimiter that stands for any run of blanks and tabs
DELIMITERS = {
    "comma": ",",
    "semicolon": ";",
    "tab": "\t",
    "blanks": BLANKS,
    "space": BLANKS,
    "pipe": "|",
}
DECIMALS = {"point": ".", "comma": ",", ".": ".", ",": ","}


@dataclass(frozen=True)
class ReadingOptions:
    """How a log is to be read; what is None is detected.

    Attributes
    ----------
    time : str, optional
        The time column: a header name, a dataset path, or a number counted from 1.
    time_unit : str, optional
        What the figures of the time column count (``ms``, ``10us``); goes before what
        the header states.
    scale : tuple of str
        Factors by role, ``voltage=20`` or ``displacement=10um/V``.
    sample_rate : float, optional
        Samples a second (Hz) of a log without a time column; replaces a column that was
        only guessed.
    clock_offset : float or "auto", optional
        Seconds to be added to the clock of the drive's file where columns of several
        files are joined by time; auto: found from what both recorded.
    rows : tuple of int
        The first and the last data row to take, counted from 1 (last None: to the end).
    skip_bad : bool
        Drop and count rows with bad cells instead of refusing them.
    resample : float, optional
        Interpolate to this rate (Hz).
    format : str, optional
        ``csv``, ``tsv`` or ``hdf5``, where no file name shows it.
    delimiter, decimal, comment : str, optional
        Of text: a name of ``DELIMITERS`` or a single character; ``point`` or ``comma``;
        the characters that start a comment line.
    skip_lines, header_lines : int, optional
        Of text: lines of junk above the header; 0 (no header), 1 (names) or 2 (names,
        then units).
    encoding : str, optional
        Of text: a codec's name.
    block_rows : int
        The most rows held at a time; changes no digit.

    Raises
    ------
    UsageError
        An option is senseless, or two exclude each other.
    """

    time: str | None = None
    time_unit: str | None = None
    scale: tuple[str, ...] = ()
    sample_rate: float | None = None
    clock_offset: float | str | None = None
    rows: Rows = ALL_ROWS
    skip_bad: bool = False
    resample: float | None = None
    format: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    comment: str | None = None
    skip_lines: int | None = None
    header_lines: int | None = None
    encoding: str | None = None
    block_rows: int = BLOCK_ROWS

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        object.__setattr__(
            self,
            "scale",
            (self.scale,) if isinstance(self.scale, str) else tuple(self.scale),
        )
        object.__setattr__(self, "rows", parse_rows(self.rows))
        self._check_time()
        self.scales  # noqa: B018 - parsed once; refuses what is none
        if self.format is not None and self.format not in FORMATS:
            raise UsageError(
                f"`format` {self.format}: the formats are {', '.join(FORMATS)}"
            )
        if self.header_lines is not None and self.header_lines not in (0, 1, 2):
            raise UsageError(
                f"`header_lines`: '{self.header_lines}' is none of 0, 1, 2"
            )
        for name, least in (("skip_lines", 0), ("block_rows", 1)):
            count = getattr(self, name)
            if count is not None and count < least:
                raise UsageError(f"`{name}`: must be at least {least}, not {count}")
        for name in ("delimiter", "comment"):
            if any(
                "\ud800" <= letter <= "\udfff" for letter in getattr(self, name) or ""
            ):
                raise UsageError(
                    f"`{name}`: holds a byte that is no character in this terminal's encoding"
                )
        self.delimiter_character  # noqa: B018
        self.decimal_sign  # noqa: B018
        try:
            # refuses codecs that are no text encodings, too
            "".encode("utf-8" if self.encoding is None else self.encoding)
        except (LookupError, ValueError):
            raise UsageError(
                f"`encoding` {self.encoding}: there is no such text encoding"
            ) from None

    def _check_time(self) -> None:
        """Refuse rates and units of time that are none, or that exclude each other."""
        for name in ("sample_rate", "resample"):
            object.__setattr__(self, name, checked_rate(getattr(self, name), name))
        if self.time is not None and self.sample_rate is not None:
            raise UsageError(
                "`time` and `sample_rate` exclude each other: the log has the one or needs the other"
            )
        if self.time_unit is not None:
            from dbo_cli.logs.units import parse_time_unit

            parse_time_unit(self.time_unit)
            if self.sample_rate is not None:
                raise UsageError(
                    "`time_unit` and `sample_rate` exclude each other: the time column is read or replaced"
                )

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """The factors by role (UsageError where one is none)."""
        if not self.scale:
            return ()
        from dbo_cli.logs.units import parse_scale

        return tuple(parse_scale(text) for text in self.scale)

    def chosen(self) -> dict[str, object]:
        """Return what the user gave, under its parameter's name; how many rows are held changes nothing."""
        chosen = {}
        for option in dataclasses.fields(self):
            value = getattr(self, option.name)
            if option.name != "block_rows" and value != option.default:
                chosen[option.name] = value
        if "rows" in chosen:
            first, last = self.rows
            from_row = str(first) if first > 1 else ""
            chosen["rows"] = f"{from_row}:{last or ''}"
        return chosen

    @cached_property
    def delimiter_character(self) -> str | None:
        """The delimiter asked for, or None where it is to be detected.

        Raises
        ------
        UsageError
            It is neither a known name nor a single character.
        """
        if self.delimiter is None:
            return None
        character = DELIMITERS.get(
            self.delimiter.lower(), self.delimiter.replace("\\t", "\t")
        )
        if len(character) != 1 or character.isalnum() or character in '."\n\r':
            names = ", ".join(DELIMITERS)
            raise UsageError(
                f"`delimiter` {self.delimiter}: give a single character or one of {names}"
            )
        return character

    @cached_property
    def decimal_sign(self) -> str | None:
        """The decimal sign asked for, or None where it is to be detected.

        Raises
        ------
        UsageError
            It is neither ``point`` nor ``comma``.
        """
        if self.decimal is None:
            return None
        sign = DECIMALS.get(self.decimal.lower())
        if sign is None:
            raise UsageError(f"`decimal` {self.decimal}: give point or comma")
        return sign


def checked_rate(rate: float | None, name: str = "sample_rate") -> float | None:
    """Return samples a second (Hz), or refuse what is no rate (UsageError); ``name`` is the parameter's."""
    if rate is None:
        return None
    if not isinstance(rate, numbers.Real) or isinstance(rate, bool):
        raise UsageError(
            f"`{name}` {rate!r}: give a positive number of samples a second"
        )
    if not 0.0 < rate < math.inf:
        raise UsageError(
            f"`{name}` {rate:g}: give a positive number of samples a second"
        )
    if not _LOWEST_RATE <= rate <= _HIGHEST_RATE:
        limits = f"{_LOWEST_RATE:g} and {_HIGHEST_RATE:g}"
        raise UsageError(f"`{name}` {rate:g}: give between {limits} samples a second")
    return float(rate)


def parse_rows(rows: object) -> Rows:
    """Read ``A:B``, or a pair of numbers: data rows counted from 1, both ends included.

    Raises
    ------
    UsageError
        It is not of that form, or B is before A.
    """
    pair = _split_rows(rows) if isinstance(rows, str) else rows
    if not _is_pair_of_rows(pair):
        raise UsageError(
            f"`rows` {rows}: give A:B, data rows counted from 1, both ends included"
        )
    first, last = pair
    if first < 1 or (last is not None and last < first):
        text = (
            rows if isinstance(rows, str) else f"{first}:{'' if last is None else last}"
        )
        raise UsageError(
            f"`rows` {text}: rows are counted from 1, and the last is not before the first"
        )
    return first, last


def _split_rows(text: str) -> Rows | None:
    """Return the two numbers of ``A:B``, None where it is not of that form."""
    match = re.fullmatch(r"([0-9]{0,18}):([0-9]{0,18})", text.strip())
    if match is None:
        return None
    return int(match[1] or 1), int(match[2]) if match[2] else None


def _is_pair_of_rows(pair: object) -> TypeGuard[Rows]:
    """Return whether these are a first row and a last one, or None for the end."""
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        return False
    return type(pair[0]) is int and type(pair[1] or 1) is int


# --- what a reader of a format is given ---

CHANGED = "the file changed while it was read: read it when its writer is done, or read a copy"


class FileWatch:
    """The size and time of files that are read in pieces: a change in between is an error.

    Parameters
    ----------
    place
        How messages call the log.
    path
        The file; ``add`` takes further ones that its samples come from.
    """

    def __init__(self, place: str, path: str) -> None:
        self._place = place
        self._seen: dict[str, tuple[int, int, int] | None] = {}
        self.add(path)

    def add(self, path: str) -> None:
        """Watch another file."""
        self._seen.setdefault(path, _state_of(path))

    def changed(self) -> bool:
        """Tell whether a file is no longer what it was."""
        return any(_state_of(path) != before for path, before in self._seen.items())

    def check(self) -> None:
        """Refuse what was read so far where a file has changed (InputError)."""
        if self.changed():
            raise InputError(f"{self._place}: {CHANGED}")


def _state_of(path: str) -> tuple[int, int, int] | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


@dataclass(frozen=True)
class Request:
    """What a reader of a format is given.

    Attributes
    ----------
    address, options
        Where the log is, and how it is to be read.
    named
        The columns that the user named.
    live
        Hand on what has arrived instead of waiting for a full block.
    digest
        Hash the bytes of a stream as they are read: it cannot be read again.
    content
        The text itself, where another format has been turned into text (a workbook's
        sheet).
    watch
        Of the file, from now on.
    """

    address: Address
    options: ReadingOptions
    named: Sequence[str] = ()
    live: bool = False
    digest: bool = False
    content: bytes | None = None
    watch: FileWatch = field(init=False)

    def __post_init__(self) -> None:
        """Watch the file from now on."""
        object.__setattr__(self, "watch", FileWatch(self.place, self.address.path))

    @property
    def place(self) -> str:
        """How messages call the log."""
        return self.address.text

    @contextlib.contextmanager
    def reading(
        self, kind: str, errors: tuple[type[BaseException], ...] = (Exception,)
    ) -> Iterator[None]:
        """Turn whatever a library raises at damaged bytes into one line (InputError).

        ``kind`` is what the file should be, as messages call it (``Parquet``).
        """
        try:
            yield
            self.watch.check()
        except (DboError, KeyboardInterrupt, SystemExit):
            raise
        except errors as problem:
            self.watch.check()
            raise InputError(
                f"{self.place}: damaged {kind}: {brief(problem)}"
            ) from None


def brief(problem: BaseException) -> str:
    """Keep the reason in brackets of a library's message, or its first line."""
    if type(problem).__name__ == "PanicException":  # describes the library's own lines
        return GAVE_UP
    if not str(problem):
        return type(problem).__name__
    text = str(problem).strip("'\"").splitlines()[0]
    if "(" in text and text.endswith(")"):
        return text[text.find("(") + 1 : text.rfind(")")]
    return text


# --- compiled libraries and the process they run in ---
#
# Some of them change what belongs to the whole process: polars puts a handler of its own
# before Python's, and the libraries behind Parquet and workbooks write pages to standard
# error at damaged bytes, or end the process. Whether anything is done about that is for
# the process to decide: a ``Host`` does nothing, and ``dbo`` as a process sets one of its
# own (``cli.app``).

GAVE_UP = "the library that reads it gave up"


class Host:
    """The process as any program has it: left alone."""

    def imported(self, module: str) -> None:
        """Take note that a library has been imported."""

    def contained(
        self, place: str, kind: str
    ) -> contextlib.AbstractContextManager[None]:
        """Surround a call that reads the file ``place``, which should be of a ``kind`` (``Parquet``)."""
        return contextlib.nullcontext()

    def signals_held(self) -> contextlib.AbstractContextManager[None]:
        """Surround renames that belong together; a signal may wait until they are done."""
        return contextlib.nullcontext()


_host = Host()


def set_host(chosen: Host) -> Host:
    """Choose what is done about libraries in this process; returns what was chosen before."""
    global _host
    before = _host
    _host = chosen
    import_polars.cache_clear()
    return before


def host() -> Host:
    """Return what was chosen."""
    return _host


@functools.cache
def import_polars() -> Any:
    """Import polars, and tell the host of it once: polars puts a handler of its own before Python's."""
    library = importlib.import_module("polars")
    _host.imported("polars")
    return library


def import_extra(module: str, place: str) -> Any:
    """Import the library of an optional extra.

    Raises
    ------
    InputError
        It is not installed; the line says how to get it.
    """
    try:
        library = importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{place}: reading it needs the library {module}: pip install {module}"
        ) from None
    _host.imported(module)
    return library
