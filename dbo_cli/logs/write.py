"""Columns as text or HDF5; a file appears whole or not at all (``dbo_cli/files.py``).

Standard output, pipes and devices are written at once, block by block::

    with create("drive.csv", [("time", "s"), ("voltage", "V")]) as out:
        out.write(time, voltage)
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.arrays import Floats
from dbo_cli.errors import OutputError, UsageError
from dbo_cli.files import Output, Outputs, telling
from dbo_cli.logs.table import ROWS_A_BLOCK
from dbo_cli.units import split_header

Named = tuple[str, str | None]  # a column's name and its unit
Attributes = dict[str, str | float]
Append = Callable[[Sequence[Floats], int], None]

# Cells that Python formats sooner than polars is imported (0.1 s, measured).
_PLAIN_CELLS = 1 << 16
_GZIP_LEVEL = 1  # three times as fast as 6, and 8 % larger (measured)
_HDF5_SUFFIXES = (".h5", ".hdf5")
_DELIMITERS = {"": ",", ".csv": ",", ".txt": ",", ".dat": ",", ".tsv": "\t"}


@contextlib.contextmanager
def create(path: str | os.PathLike[str], columns: Sequence[Named]) -> Iterator[Writer]:
    """Open an output for columns; it appears when the block is left without an error.

    Parameters
    ----------
    path
        ``-`` is standard output. The suffix decides: ``.csv``, ``.txt``, ``.dat`` or
        none is text with commas, ``.tsv`` with tabs (both also ``.gz``), ``.h5`` and
        ``.hdf5`` are HDF5.
    columns
        Name and unit of each; ``("voltage", "V")`` becomes the header ``voltage_V``.

    Raises
    ------
    UsageError
        The suffix is of no format that is written.
    OutputError
        It cannot be written; what stood there before is left as it was.
    """
    with Outputs() as outputs:
        yield add_table(outputs, path, columns)


def add_table(
    outputs: Outputs,
    path: str | os.PathLike[str],
    columns: Sequence[Named],
    attributes: Attributes | None = None,
) -> Writer:
    """Return a writer of columns, whose file appears with the other ``outputs``; see :func:`create`.

    ``attributes`` are what an HDF5 file states beside its columns.
    """
    path = os.fspath(path)
    suffix = _suffix_of(path)
    file = outputs.add(path)
    if suffix in _HDF5_SUFFIXES:
        append = _hdf5_appender(file, columns, attributes or {})
    else:
        append = _text_appender(file, columns, _DELIMITERS[suffix])
    return Writer(path, columns, append)


def _suffix_of(path: str) -> str:
    """Return the suffix that decides the format; refuse one that is of none (UsageError)."""
    file, inner, _ = path.partition("::")
    is_packed = file.lower().endswith(".gz")
    stem, suffix = os.path.splitext(file[:-3] if is_packed else file)
    suffix = suffix.lower()
    is_written = suffix in _DELIMITERS or (suffix in _HDF5_SUFFIXES and not is_packed)
    if is_written and not inner:
        return suffix
    if os.path.exists(path) and not os.path.isfile(path):
        return ""  # a pipe or a device
    raise UsageError(f"{path}: no format that is written: type {stem}.csv, .tsv or .h5")


# --- columns ---


@dataclass
class Writer:
    """Takes rows as one array a column.

    ``append`` gets some of them, and the number of those before.
    """

    path: str
    columns: Sequence[Named]
    append: Append
    rows: int = 0

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows: one array of numbers a column, all of one length, all finite.

        Raises
        ------
        OutputError
            A number is not finite, or the rows cannot be written.
        """
        values = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
        for (name, _), array in zip(self.columns, values, strict=True):
            finite = np.isfinite(array)
            if not finite.all():
                row = int(np.argmin(finite))
                raise OutputError(
                    f"{self.path}: row {self.rows + row + 1}: {name} would be {array[row]}: check the input "
                    "there"
                )
        with telling(self.path):
            for start in range(0, len(values[0]), ROWS_A_BLOCK):
                block = [array[start : start + ROWS_A_BLOCK] for array in values]
                self.append(block, self.rows)
                self.rows += len(block[0])


def _text_appender(file: Output, columns: Sequence[Named], delimiter: str) -> Append:
    """Return what appends rows of delimited text; each number is the shortest that reads back."""
    stream = target = file.open()
    if file.path.lower().endswith(".gz"):
        # no name and no time: the same numbers give the same bytes
        packed = gzip.GzipFile("", "wb", _GZIP_LEVEL, target, 0)
        file.closing.callback(packed.close)
        stream = packed  # type: ignore[assignment]

    def send(data: bytes | memoryview) -> None:
        stream.write(data)
        if file.temporary is None:
            stream.flush()
            target.flush()

    def append(block: Sequence[Floats], rows: int) -> None:
        if rows == 0:  # not before there are rows: a pipe keeps what it got
            names = [header_cell(name, unit, delimiter) for name, unit in columns]
            send((delimiter.join(names) + "\n").encode())
        cells = (rows + len(block[0])) * len(block)
        if cells < _PLAIN_CELLS and "polars" not in sys.modules:
            texts = [map(repr, array.tolist()) for array in block]
            lines = map(delimiter.join, zip(*texts, strict=True))
            send(("\n".join(lines) + "\n").encode())
            return
        import polars as pl

        frame = pl.DataFrame({str(n): array for n, array in enumerate(block)})
        buffer = io.BytesIO()
        frame.write_csv(buffer, include_header=False, separator=delimiter)
        send(buffer.getbuffer())

    return append


def header_cell(name: str, unit: str | None, delimiter: str) -> str:
    """Return a header that is read back as this name and unit: ``voltage_V``."""
    text = name
    if unit:
        text = f"{name}_{unit}"
        if split_header(text) != (name, unit):
            text = f"{name} [{unit}]"
    if delimiter in text or '"' in text or "\n" in text or text[:1] in ("#", "%"):
        text = '"' + text.replace('"', '""') + '"'
    return text


def _hdf5_appender(
    file: Output, columns: Sequence[Named], attributes: Attributes
) -> Append:
    """Return what appends rows to one dataset a column of a new HDF5 file."""
    if file.temporary is None:
        raise UsageError(f"{file.path}: HDF5 cannot go down a pipe: give a file name")
    import h5py

    with telling(file.path):
        stream = file.closing.enter_context(PatientFile(file.begin(), "xb+"))
    store = h5py.File(stream, "w")
    store.attrs.update(attributes)
    datasets: list[Any] = []
    for name, unit in columns:
        dataset = store.create_dataset(
            name.replace("/", "_"), (0,), "f8", maxshape=(None,), chunks=(ROWS_A_BLOCK,),
            shuffle=True, compression="gzip", compression_opts=1,
        )  # fmt: skip
        dataset.attrs["units"] = unit or ""
        datasets.append(dataset)

    def append(block: Sequence[Floats], rows: int) -> None:
        for dataset, array in zip(datasets, block, strict=True):
            dataset.resize(rows + len(array), axis=0)
            dataset[rows:] = array
        stream.tell_problem()

    def complete() -> None:
        for dataset in datasets:  # the same order gives the same bytes
            dataset.flush()
        store.close()
        stream.tell_problem()

    file.closing.callback(complete)
    return append


class PatientFile(io.FileIO):
    """A file for HDF5 that keeps what goes wrong for later.

    HDF5 ends the process when it cannot write while it closes a file (a full disk).
    """

    problem: BaseException | None = None

    def write(self, data: Any) -> int:
        """Write, or pretend to after a failure."""
        if self._tried(super().write, data) != len(data) and self.problem is None:
            self.problem = OSError(errno.ENOSPC, "the disk is full")
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Give the file a size."""
        self._tried(super().truncate, size)
        return size or 0

    def tell_problem(self) -> None:
        """Raise what went wrong."""
        if self.problem is not None:
            raise self.problem

    def _tried(self, function: Callable[[Any], int], value: Any) -> int:
        if self.problem is None:
            try:
                return function(value)
            except BaseException as problem:  # Ctrl-C, too
                self.problem = problem
        return 0
