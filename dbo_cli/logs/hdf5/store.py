"""Signals and matrices written as HDF5, also into files that others use: nothing of theirs is lost.

A recorder that has a file open holds HDF5's own lock on it (``flock``). A new group is
made in a file of its own; right before the rename the store is locked in the same way,
copied, given the group, and renamed over the old one. Only what this program wrote is
ever replaced: its groups carry the attribute ``dbo_columns``, the list of the datasets
it made there.

A column is one chunked dataset, with filters that every HDF5 reader undoes. The deflate
streams are put together here instead of by the HDF5 library: of a float64 only the
bytes of sign, exponent and leading digits repeat, and squeezing the noise of the others
takes ten times longer than storing them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import struct
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import OutputError, UsageError, cleaned
from dbo_cli.logs import whole_output
from dbo_cli.logs.columns import header_of, require_finite, unique_headers
from dbo_cli.logs.request import Address, FileWatch, Given
from dbo_cli.logs.sample_block import Column, FloatArray, SampleBlock, TimeCheck

MARK = "dbo_columns"  # the attribute of a group that this program wrote
# s to wait for a lock: a program that opens, appends and closes is done by then
_PATIENCE = 2.0
# s to wait while another process of this program is adding a group: twelve at once take
# 1 s
_QUEUE = 60.0
_COPY_BYTES = 1 << 23  # at a time; an interrupt is served in between
CHUNK_ROWS = 1 << 16  # 512 kB, half of HDF5's cache for a dataset's chunks
# Names in a list in an attribute: HDF5 gives it 64 kB, 16 bytes a name; more are lines
# of one text.
MOST_NAMES = 4000
# of one channel in a chunk: 128 kB, so that channels are written and read alone
MATRIX_ROWS = 1 << 14
_PROBE = 2048  # bytes tried before a byte plane is squeezed; chosen
_WORTH = 0.9  # squeezed only where the probe shrinks to less than this; chosen
_STORED_MOST = 65535  # bytes in one stored block (RFC 1951, 3.2.4)
_ZLIB_HEADER = b"\x78\x01"  # RFC 1950: deflate, window of 32 kB, fastest
_LAST_BLOCK = b"\x03\x00"  # an empty block that ends the stream


@dataclass(frozen=True)
class StoreOutput:
    """An output into an HDF5 file: the whole file (``group`` is ``/``) or a group of it."""

    path: str
    group: str

    @contextlib.contextmanager
    def publishing(self, temporary: str) -> Iterator[bool]:
        """Make the finished file ready to take the place of the old one, which is locked until that is done.

        Gives whether there is no old file, so that the rename must fail where there is
        one after all.

        Raises
        ------
        OutputError
            As for ``refuse_foreign``, or the file is open in another program.
        """
        if not os.path.exists(self.path):
            yield True
            return
        with _locked(self.path):
            self.refuse_foreign()
            if self.group != "/":
                self._merge(temporary)
            yield False

    def _merge(self, temporary: str) -> None:
        """Make the temporary file a copy of the store with the new group in it."""
        watch = FileWatch(self.path, self.path)
        merged = whole_output.partial_path(os.path.realpath(self.path))
        try:
            with open(self.path, "rb") as old, open(merged, "wb") as new:
                shutil.copyfileobj(old, new, _COPY_BYTES)
            with h5py.File(merged, "r+") as store, h5py.File(temporary, "r") as new:
                if self.group in store:
                    del store[self.group]
                parent = store.require_group(self.group.rpartition("/")[0] or "/")
                new.copy(new[self.group], parent, name=self.group.rpartition("/")[2])
            if watch.changed():
                raise OutputError(_in_use(self.path))
            os.replace(merged, temporary)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(merged)
            raise

    def refuse_foreign(self) -> None:
        """Refuse a file that is none of HDF5 but gets a group, and a place that holds what others wrote.

        Raises
        ------
        OutputError
            The place is a dataset, or holds what this program did not write; or the
            file cannot be read.
        """
        if not h5py.is_hdf5(self.path):
            if self.group != "/":
                raise OutputError(
                    f"{self.path}: this is no HDF5 file, so no group can be added to it: name another file"
                )
            return
        try:
            with h5py.File(self.path, "r", locking=False) as store:
                node = self._node(store)
                if node is not None:
                    self._refuse_others_in(node)
        except OSError as problem:
            if "already open" in str(problem):
                raise OutputError(
                    _in_use(self.path) + " (h5clear -s if it was not closed)"
                ) from None
            raise OutputError(
                f"{self.path}: cannot be read as HDF5: {str(problem)[:100]}"
            ) from None

    def _node(self, store: Any) -> Any:
        """Return what stands at the group's path, None where there is nothing yet."""
        if self.group == "/":
            return store
        node = store
        place = ""
        for name in self.group.strip("/").split("/"):
            place += f"/{name}"
            link = node.get(name, getlink=True)
            if link is None:
                return None
            if not isinstance(link, h5py.HardLink):
                raise OutputError(
                    f"{self.path}::{place} is a link to elsewhere: {self._other()}"
                )
            node = node.get(name)
            if not isinstance(node, h5py.Group):
                raise OutputError(
                    f"{self.path}::{place} is a dataset, not a group: {self._other()}"
                )
        return node

    def _refuse_others_in(self, node: Any) -> None:
        marked = set()
        with contextlib.suppress(KeyError, OSError, TypeError, ValueError):
            marked = {str(name) for name in node.attrs.get(MARK, ())}
        foreign = sorted(name for name in node if name not in marked)
        if foreign:
            more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
            whole = "file" if self.group == "/" else "group"
            raise OutputError(
                f"{self.path}::{self.group} holds '{cleaned(foreign[0])}'{more}, which this output did not "
                f"write and would be lost: {self._other()}, or delete the {whole} first"
            )

    def _other(self) -> str:
        return f"name a group of its own ({self.path}::/NAME)"


@contextlib.contextmanager
def store_output(
    target: Address, attributes: Mapping[str, str | float]
) -> Iterator[Any]:
    """Give a new group for an HDF5 output, with its attributes; the file is published at the end.

    Raises
    ------
    UsageError
        The output is a pipe.
    OutputError
        It is no regular file, is open in another program, or as for
        ``StoreOutput.refuse_foreign``.
    """
    if target.is_stream or whole_output.descriptor_of(target.path) is not None:
        raise UsageError("HDF5 cannot be written to a pipe: name a file (-o FILE.h5)")
    # //a/./b/ is /a/b
    parts = [part for part in (target.group or "").split("/") if part not in ("", ".")]
    if ".." in parts:
        remedy = (
            "'..' is no group of an HDF5 file: give its path from the root, ::/NAME"
        )
        raise UsageError(f"::{target.group}: {remedy}")
    store = StoreOutput(target.path, "/" + "/".join(cleaned(part) for part in parts))
    if os.path.isfile(store.path):
        with _locked(store.path):
            # not held while the file is looked at: that takes time, and others wait
            pass
        store.refuse_foreign()
    if not whole_output.is_replaceable(target.path):
        raise OutputError(f"{target.path}: this is no regular file: name a file")
    with whole_output.replacing(target.path, store.publishing) as path:
        file = h5py.File(path, "w")
        try:
            group = file.require_group(store.group)
            for name, value in attributes.items():
                group.attrs[name] = cleaned(value) if isinstance(value, str) else value
            yield group
        except BaseException:
            # what led here is to be shown
            with contextlib.suppress(OSError, RuntimeError, ValueError):
                file.close()
            raise
        file.close()


def _in_use(path: str) -> str:
    return f"{path}: the file is open in another program: close it there, or write to another file"


@contextlib.contextmanager
def _locked(path: str) -> Iterator[None]:
    """Hold HDF5's lock on a file; OutputError where somebody else has it open for writing."""
    # no locks of this kind there, and a file that is open cannot be replaced
    if whole_output.WINDOWS:
        yield
        return
    start = time.monotonic()
    while True:
        handle = os.open(path, os.O_RDONLY)
        try:
            locked = whole_output.try_lock(handle)
            if locked and not _is_open_for_writing(handle) and _is_still(handle, path):
                yield
                return
        finally:
            os.close(handle)
        waited = time.monotonic() - start
        if waited > _QUEUE or (waited > _PATIENCE and not _is_being_added_to(path)):
            raise OutputError(_in_use(path))
        time.sleep(0.02)


def _is_open_for_writing(handle: int) -> bool:
    """Tell whether any process has the file open for writing, also one that locks nothing (Linux only).

    A read lease is granted only while nobody writes; it is given back at once.
    """
    import fcntl

    if not hasattr(fcntl, "F_SETLEASE"):
        return False
    try:
        fcntl.fcntl(handle, fcntl.F_SETLEASE, fcntl.F_RDLCK)
    except OSError as problem:
        # EACCES: another user's file; EINVAL: no leases there
        return problem.errno == errno.EAGAIN
    fcntl.fcntl(handle, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    return False


def _is_still(handle: int, path: str) -> bool:
    """Tell whether the locked file is still the one of that name, and not one just replaced."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except OSError:
        return False


def _is_being_added_to(path: str) -> bool:
    """Tell whether a living process of this program is writing beside the file, in all likelihood into it."""
    folder, name = os.path.split(os.path.realpath(path))
    writers = whole_output.writers_in(folder, f".{name[:30]}").values()
    return any(
        process != os.getpid() and whole_output.is_running(process)
        for process in writers
    )


@contextlib.contextmanager
def hdf5_writer(
    target: Address, columns: Sequence[Column], attributes: Mapping[str, str | float]
) -> Iterator[Hdf5Writer]:
    """Open an HDF5 output; it is complete, and published, when the block is left without an error."""
    with store_output(target, attributes) as group:
        writer = Hdf5Writer(group, columns)
        yield writer
        writer.finish()


class Hdf5Writer:
    """Appends rows to the columns of an HDF5 group.

    Parameters
    ----------
    group
        What is written to; with its attributes (``sample_rate``, ``model_sha256``,
        ``command``).
    columns
        One dataset each, named by its header, with the attributes ``units`` and
        ``quantity``.
    """

    def __init__(self, group: Any, columns: Sequence[Column]) -> None:
        # A slash would make a group, and a lone dot is the group itself.
        self._names: list[str] = []
        for number, header in enumerate(unique_headers(columns), 1):
            name = header.replace("/", "_")
            if name in ("", "."):
                name = f"column_{number}"
            self._names.append(name)
        self._group = group
        self._group.attrs[MARK] = self._names
        headers = [header_of(column) for column in columns]
        self._clock: int | None = None
        if "time_s" in headers and "sample_rate" not in group.attrs:
            self._clock = headers.index("time_s")
        self._times = TimeCheck(group.file.filename)
        self._columns = columns
        self._kept: list[list[FloatArray]] = [[] for _ in columns]
        self._kept_rows = 0
        self._rows = 0
        self._datasets: list[Any] = []

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows, one float64 array a column."""
        parts = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
        require_finite(self._columns, self._names, parts)
        for parts_of_column, part in zip(self._kept, parts, strict=True):
            parts_of_column.append(part)
        if self._clock is not None:
            rows = range(self._kept_rows, self._kept_rows + len(parts[0]))
            self._times.feed(SampleBlock(rows, None, parts[self._clock], {}))
        self._kept_rows += len(parts[0])
        if self._kept_rows >= CHUNK_ROWS:
            self._store(CHUNK_ROWS)

    def finish(self) -> None:
        """Write what is left; only now are the datasets whole."""
        self._store(
            CHUNK_ROWS if self._datasets else max(1, self._kept_rows), last=True
        )
        for dataset in self._datasets:
            dataset.resize((self._rows,))
        rate = self._times.rate()
        if rate is not None:
            # 2000, not 1999.9999999999998
            self._group.attrs["sample_rate"] = float(f"{rate:.12g}")

    def _store(self, chunk: int, last: bool = False) -> None:
        """Write the whole chunks that are kept; the ``last`` one is filled up with zeros."""
        if not self._datasets:
            self._create(chunk)
        rows = self._kept_rows
        if not last:
            rows = rows // chunk * chunk
        if not rows:
            return
        for number, dataset in enumerate(self._datasets):
            values = np.concatenate(
                [*self._kept[number], np.zeros(-rows % chunk if last else 0)]
            )
            for start in range(0, rows, chunk):
                dataset.resize((self._rows + start + chunk,))
                encoded = shuffled_deflated(values[start : start + chunk])
                dataset.id.write_direct_chunk((self._rows + start,), encoded)
            self._kept[number] = [values[rows:]]
        self._rows += rows
        self._kept_rows -= rows

    def _create(self, chunk: int) -> None:
        """Create the datasets, still without rows."""
        for name, column in zip(self._names, self._columns, strict=True):
            dataset = self._group.create_dataset(
                name, (0,), "<f8", maxshape=(None,), chunks=(chunk,), compression="gzip", compression_opts=1,
                shuffle=True,
            )  # fmt: skip
            if column.unit:
                dataset.attrs["units"] = cleaned(column.unit)
            dataset.attrs["quantity"] = cleaned(column.quantity or column.name)
            self._datasets.append(dataset)


def shuffled_deflated(values: FloatArray) -> bytes:
    """Encode a chunk as HDF5's filters ``shuffle`` and ``deflate`` would: a zlib stream of its byte planes.

    Parameters
    ----------
    values
        The chunk, float64; stored little-endian.
    """
    planes = values.astype("<f8", copy=False).view(np.uint8).reshape(-1, 8).T
    stream = [_ZLIB_HEADER]
    check = 1
    for number in range(8):
        plane = planes[number].tobytes()
        check = zlib.adler32(plane, check)
        stream.append(_squeezed(plane))
    return b"".join([*stream, _LAST_BLOCK, check.to_bytes(4, "big")])


def _squeezed(plane: bytes) -> bytes:
    """Encode a byte plane as deflate blocks, squeezed where its middle shrinks, else stored."""
    middle = max(0, (len(plane) - _PROBE) // 2)
    probe = plane[middle : middle + _PROBE]
    if len(zlib.compress(probe, 1)) < _WORTH * len(probe):
        raw = zlib.compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS)
        return raw.compress(plane) + raw.flush(zlib.Z_SYNC_FLUSH)
    pieces = [
        plane[start : start + _STORED_MOST]
        for start in range(0, len(plane), _STORED_MOST)
    ]
    # a byte that says "stored", the length and its complement, both little-endian
    return b"".join(
        struct.pack("<BHH", 0, len(piece), len(piece) ^ 0xFFFF) + piece
        for piece in pieces
    )


# --- matrices: a dataset a quantity, rows of samples, a column of each channel ---

WriteChannel = Callable[[int, Sequence[FloatArray]], None]


@contextlib.contextmanager
def matrix_writer(
    target: Address,
    columns: Sequence[Column],
    channels: Sequence[str],
    time: FloatArray | None,
    rows: int,
    *,
    attributes: Mapping[str, str | float],
    protect: Sequence[Given] = (),
) -> Iterator[WriteChannel]:
    """Open a file for matrices; gives a function that writes one channel's column of each.

    A channel that is not written is NaN, so that no other's numbers are taken for its
    own.

    Raises
    ------
    UsageError
        The output is an input, or a stream.
    OutputError
        It cannot be written.
    """
    whole_output.check_output(target, protect)
    with store_output(target, attributes) as group:
        names = [column.name for column in columns]
        if time is not None:
            names.insert(0, "time_s")
        group.attrs[MARK] = names
        if time is not None:
            group["time_s"] = time
            group["time_s"].attrs["units"] = "s"
        datasets = []
        chunks = (min(rows, MATRIX_ROWS), 1)
        for column in columns:
            shape = rows, len(channels)
            dataset = group.create_dataset(
                column.name, shape, "<f8", chunks=chunks, fillvalue=np.nan
            )
            dataset.attrs["quantity"] = cleaned(column.quantity or column.name)
            if len(channels) <= MOST_NAMES:
                dataset.attrs["channel_of_column"] = list(channels)
            else:
                dataset.attrs["channel_of_column"] = "\n".join(channels)
            if column.unit:
                dataset.attrs["units"] = cleaned(column.unit)
            datasets.append(dataset)

        def write(place: int, arrays: Sequence[FloatArray]) -> None:
            require_finite(columns, [header_of(column) for column in columns], arrays)
            for dataset, array in zip(datasets, arrays, strict=True):
                dataset[:, place] = array

        yield write
