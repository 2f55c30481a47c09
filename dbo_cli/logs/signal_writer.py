"""Signals written row by row: delimited text (also gzipped) or HDF5, to a file or to standard output."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import repeat
from typing import IO, TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import cleaned
from dbo_cli.logs.columns import require_finite, unique_headers
from dbo_cli.logs.request import BLOCK_ROWS, Address, Given, import_polars, parse_output
from dbo_cli.logs.sample_block import Column, FloatArray
from dbo_cli.logs.whole_output import (
    KEPT,
    KeptOutputs,
    KeptSignal,
    check_output,
    is_replaceable,
    opened,
)
from dbo_cli.version import program_version_string

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

# with fewer cells importing polars costs more than it saves (benchmarks/text_speed.py)
PLAIN_CELLS = 1 << 16
_FORMULA_SIGNS = ("=", "+", "-", "@")  # what begins a formula in Excel and LibreOffice
_WORTH_A_THREAD = 1 << 14  # rows of a block; chosen


class SignalWriter(Protocol):
    """Takes rows as one array a column."""

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows."""


@dataclass
class TextWriter:
    """Appends rows of delimited text to a binary stream.

    With ``behind``, where nothing is to be flushed, formatting and writing go on in a
    thread while the caller works on the next rows; the arrays must not change after
    they were handed in.
    """

    stream: IO[bytes]
    columns: Sequence[Column]
    delimiter: str
    flush: bool
    behind: bool
    comment: str = ""
    _pool: ThreadPoolExecutor | None = None
    _running: Future[None] | None = None

    def __post_init__(self) -> None:
        """Write the header."""
        self._headers = unique_headers(self.columns)
        self._blanks = any(column.may_be_blank for column in self.columns)
        self._own = (
            self.behind
            and not self.flush
            and isinstance(self.stream, io.BufferedWriter)
        )  # gzip's is none
        cells = [header_cell(header, self.delimiter) for header in self._headers]
        self.stream.write((self.comment + self.delimiter.join(cells) + "\n").encode())
        if self.flush:
            self.stream.flush()

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows, one float64 array a column; flushed at once where that was asked for."""
        self.finish()
        if self.behind and not self.flush and np.size(arrays[0]) >= _WORTH_A_THREAD:
            if self._pool is None:
                from concurrent.futures import ThreadPoolExecutor

                self._pool = ThreadPoolExecutor(1)
            self._running = self._pool.submit(self._append, arrays)
            return
        self._append(arrays)
        if self.flush:
            self.stream.flush()

    def finish(self) -> None:
        """Wait until the rows so far are handed to the stream.

        Raises
        ------
        OSError
            They could not be written.
        """
        running, self._running = self._running, None
        if running is not None:
            running.result()

    def close(self) -> None:
        """End the thread; called whether or not the writing succeeded."""
        if self._pool is not None:
            self._pool.shutdown()

    def _append(self, arrays: Sequence[ArrayLike]) -> None:
        if np.size(arrays[0]):
            require_finite(self.columns, self._headers, arrays)
            for start in range(0, np.size(arrays[0]), BLOCK_ROWS):
                rows = [
                    np.asarray(array)[start : start + BLOCK_ROWS] for array in arrays
                ]
                write_rows(
                    self.stream,
                    rows,
                    self.delimiter,
                    blanks=self._blanks,
                    own_file=self._own,
                )


class _Keeper:
    """Keeps rows in memory."""

    def __init__(self, columns: Sequence[Column]) -> None:
        self._columns = columns
        self._headers = unique_headers(columns)
        self._parts: list[list[FloatArray]] = [[] for _ in columns]

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows."""
        require_finite(self._columns, self._headers, arrays)
        for parts, array in zip(self._parts, arrays, strict=True):
            parts.append(np.array(array, dtype=np.float64))

    def signal(
        self,
        address: Address,
        format: str | None,
        attributes: Mapping[str, str | float],
        commented: bool,
    ) -> KeptSignal:
        """Return all rows, with what they would have been written with."""
        arrays = []
        for parts in self._parts:
            arrays.append(parts[0] if len(parts) == 1 else np.concatenate(parts))
        return KeptSignal(
            address, self._columns, format, attributes, tuple(arrays), commented
        )


@contextlib.contextmanager
def _kept_signal(
    outputs: KeptOutputs,
    address: Address,
    columns: Sequence[Column],
    format: str | None,
    attributes: Callable[[], Mapping[str, str | float]],
    commented: bool,
) -> Iterator[SignalWriter]:
    """Keep a signal among outputs that are written later or elsewhere."""
    keeper = _Keeper(columns)
    yield keeper
    outputs.signals.append(keeper.signal(address, format, attributes(), commented))


@contextlib.contextmanager
def signal_writer(
    address: Given,
    columns: Sequence[Column],
    *,
    format: str | None = None,
    attributes: Callable[[], Mapping[str, str | float]] = dict,
    flush: bool = False,
    protect: Sequence[Given] = (),
    commented: bool = False,
) -> Iterator[SignalWriter]:
    """Open an output for signals; it appears when the block is left without an error, and not otherwise.

    Parameters
    ----------
    address
        A file, ``FILE::/group`` of an HDF5 file, or ``-`` for standard output.
    columns
        What the columns are called.
    format
        ``csv``, ``tsv`` or ``hdf5``, where the name does not tell.
    attributes
        Finds what an HDF5 output carries beside the columns (``sample_rate``,
        ``model_sha256``, ``command``).
    flush
        Hand every write on at once.
    protect
        The command's inputs, which must not be overwritten.
    commented
        Text begins with a comment line that has the attributes, too.

    Raises
    ------
    UsageError
        The output is an input, HDF5 is to go down a pipe, or the name is that of
        another format.
    OutputError
        It cannot be written.
    """
    target = parse_output(address, format)
    outputs = KEPT.get()
    if outputs is not None:
        with _kept_signal(
            outputs, target, columns, format, attributes, commented
        ) as keeper:
            yield keeper
        return
    check_output(target, protect)
    if target.kind == "hdf5":
        from dbo_cli.logs.hdf5.store import hdf5_writer

        with hdf5_writer(target, columns, attributes()) as hdf5:
            yield hdf5
        return
    comment = _comment(attributes()) if commented else ""
    with _text_writer(target, columns, flush, comment) as writer:
        yield writer


@contextlib.contextmanager
def _text_writer(
    target: Address, columns: Sequence[Column], flush: bool, comment: str
) -> Iterator[TextWriter]:
    """Open an output for delimited text."""
    with opened(target.path, 1 << 20) as file, _packed(file, target) as stream:
        writer = TextWriter(
            stream,
            columns,
            target.delimiter,
            flush,
            is_replaceable(target.path),
            comment,
        )
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()


def _comment(attributes: Mapping[str, str | float]) -> str:
    """Return the line that states where an output comes from."""
    stated = [f"{key}: {value}" for key, value in attributes.items()]
    return f"# {cleaned('; '.join([program_version_string(), *stated]))}\n"


# --- rows as text ---


def header_cell(text: str, delimiter: str) -> str:
    """Write a header as a cell of delimited text.

    A header that a spreadsheet would take for a formula (``=cmd|...``, ``-V``) gets an
    apostrophe before it, the spreadsheet's own sign for text.
    """
    if text.startswith(_FORMULA_SIGNS):
        text = "'" + text
    if delimiter in text or '"' in text or text[:1] in ("#", "%"):
        return '"' + text.replace('"', '""') + '"'
    return text


def shortest(value: float) -> str:
    """Write one number with the fewest digits that read back exactly, as polars spells it; NaN is empty."""
    text = repr(value)
    if "e" not in text:
        return text if text != "nan" else ""
    digits, exponent = text.split("e")
    if exponent == "-05":  # polars writes exponents only below 1e-5
        sign = "-" if digits[0] == "-" else ""
        return f"{sign}0.0000{digits.lstrip('-').replace('.', '')}"
    return f"{digits}e{'+' if exponent[0] == '+' else '-'}{exponent[1:].lstrip('0')}"


def write_rows(
    stream: IO[bytes],
    arrays: Sequence[ArrayLike],
    delimiter: str,
    *,
    blanks: bool = True,
    own_file: bool = False,
) -> None:
    """Write columns as lines of delimited text; the bytes do not depend on which way is taken.

    Parameters
    ----------
    stream, arrays, delimiter
        What is written where.
    blanks
        Whether a NaN may be among the numbers, which is an empty cell.
    own_file
        The stream is a file that nobody else knows: polars writes into it by itself,
        and no byte is copied. It would do so to standard output, too, but there a
        closed pipe and Ctrl-C are Python's to hear of.
    """
    if "polars" not in sys.modules and len(arrays) * np.size(arrays[0]) < PLAIN_CELLS:
        stream.write(_plain_rows(arrays, delimiter))
        return
    names = map(str, range(len(arrays)))
    columns = map(np.ascontiguousarray, arrays, repeat(np.float64))
    table = import_polars().DataFrame(
        dict(zip(names, columns, strict=False)), nan_to_null=blanks
    )
    if own_file:
        stream.flush()
        table.write_csv(stream, include_header=False, separator=delimiter)
    else:
        buffer = io.BytesIO()
        table.write_csv(buffer, include_header=False, separator=delimiter)
        stream.write(buffer.getbuffer())


def _plain_rows(arrays: Sequence[ArrayLike], delimiter: str) -> bytes:
    numbers = [np.asarray(array, dtype=np.float64).tolist() for array in arrays]
    columns = [[shortest(value) for value in column] for column in numbers]
    lines = [delimiter.join(cells) for cells in zip(*columns, strict=True)]
    return ("\n".join(lines) + "\n").encode() if lines else b""


def _packed(file: IO[bytes], target: Address) -> AbstractContextManager[IO[bytes]]:
    """Return a stream that compresses where the name asks for it."""
    if not target.compressed:
        return contextlib.nullcontext(file)
    import gzip

    # no name and no time in the gzip header: the same signal gives the same bytes
    packed = gzip.GzipFile(
        filename="", mode="wb", compresslevel=6, fileobj=file, mtime=0
    )
    return cast(AbstractContextManager[IO[bytes]], packed)
