"""Signals written as HDF5: one chunked dataset a column, with filters that every HDF5 reader undoes.

The deflate streams are put together here instead of by the HDF5 library: of a float64 only the bytes of sign,
exponent and leading digits repeat, and squeezing the noise of the others takes ten times longer than storing
them.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.logs.clock import JITTER
from dbo_cli.logs.hdf5.store import MARK
from dbo_cli.logs.out_column import OutColumn, require_finite, unique_headers
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.sample_block import FloatArray

CHUNK_ROWS = 1 << 16
_PROBE = 2048  # bytes tried before a byte plane is squeezed
_WORTH = 0.9  # squeezed only where the probe shrinks to less than this
_STORED_MOST = 65535  # bytes in one stored block (RFC 1951, 3.2.4)
_ZLIB_HEADER = b"\x78\x01"  # RFC 1950: deflate, window of 32 kB, fastest
_LAST_BLOCK = b"\x03\x00"  # an empty block that ends the stream


class Hdf5Writer:
    """Appends rows to the columns of an HDF5 group.

    Parameters
    ----------
    path
        The file to make.
    group
        The group in it, ``/`` for none.
    columns
        One dataset each, named by its header, with the attributes ``units`` and ``quantity``.
    attributes
        What the group says about itself (``sample_rate``, ``model_sha256``, ``command``).
    """

    def __init__(
        self, path: str, group: str, columns: Sequence[OutColumn], attributes: Mapping[str, str | float]
    ) -> None:
        import h5py

        self._names = _dataset_names(columns)
        self._file = h5py.File(path, "w")
        self._group = self._file.require_group(group)
        for name, value in attributes.items():
            self._group.attrs[name] = cleaned(value) if isinstance(value, str) else value
        self._group.attrs[MARK] = self._names
        clocks = [number for number, column in enumerate(columns) if column.header == "time_s"]
        self._clock = clocks[0] if clocks and "sample_rate" not in attributes else None
        self._steps = _Steps()
        self._columns = columns
        self._kept: list[list[FloatArray]] = [[] for _ in columns]
        self._kept_rows = 0
        self._rows = 0
        self._datasets: list[Any] = []

    def write(self, *arrays: ArrayLike) -> None:
        """Append rows, one float64 array a column."""
        parts = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
        require_finite(self._columns, self._names, parts)
        for kept, part in zip(self._kept, parts, strict=True):
            kept.append(part)
        if self._clock is not None:
            self._steps.feed(parts[self._clock])
        self._kept_rows += len(parts[0])
        if self._kept_rows >= CHUNK_ROWS:
            self._store(CHUNK_ROWS)

    def finish(self) -> None:
        """Write what is left and close the file; only now is it whole."""
        self._store(CHUNK_ROWS if self._datasets else max(1, self._kept_rows), last=True)
        for dataset in self._datasets:
            dataset.resize((self._rows,))
        rate = self._steps.rate()
        if rate is not None:
            self._group.attrs["sample_rate"] = rate
        self._file.close()

    def abandon(self) -> None:
        """Close a file that is about to be removed, whatever state it is in."""
        try:
            self._file.close()
        except (OSError, RuntimeError, ValueError):
            pass  # the error that led here is the one to be told

    def _store(self, chunk: int, last: bool = False) -> None:
        """Write the whole chunks that are kept; the ``last`` one is filled up with zeros."""
        self._make_datasets(chunk)
        rows = self._kept_rows if last else self._kept_rows // chunk * chunk
        if not rows:
            return
        for number, dataset in enumerate(self._datasets):
            values = np.concatenate([*self._kept[number], np.zeros(-rows % chunk if last else 0)])
            for start in range(0, rows, chunk):
                dataset.resize((self._rows + start + chunk,))
                encoded = shuffled_deflated(values[start : start + chunk])
                dataset.id.write_direct_chunk((self._rows + start,), encoded)
            self._kept[number] = [values[rows:]]
        self._rows += rows
        self._kept_rows -= rows

    def _make_datasets(self, chunk: int) -> None:
        if self._datasets:
            return
        for name, column in zip(self._names, self._columns, strict=True):
            dataset = self._group.create_dataset(
                name, (0,), "<f8", maxshape=(None,), chunks=(chunk,), compression="gzip", compression_opts=1,
                shuffle=True,
            )  # fmt: skip
            if column.unit:
                dataset.attrs["units"] = cleaned(column.unit)
            dataset.attrs["quantity"] = cleaned(column.quantity or column.name)
            self._datasets.append(dataset)


def _dataset_names(columns: Sequence[OutColumn]) -> list[str]:
    """Name the datasets by the headers; a slash would make a group, and a lone dot is the group itself."""
    names = [header.replace("/", "_") for header in unique_headers(columns)]
    return [name if name not in ("", ".") else f"column_{n}" for n, name in enumerate(names, start=1)]


class _Steps:
    """Watches time stamps (s) go by for the attribute ``sample_rate``, in constant memory."""

    def __init__(self) -> None:
        self._first = self._last = 0.0
        self._count = 0
        self._least, self._most = np.inf, 0.0

    def feed(self, time: FloatArray) -> None:
        """Look at one block."""
        if not len(time):
            return
        if self._count == 0:
            self._first = self._last = float(time[0])
        steps = np.diff(time, prepend=self._last)[0 if self._count else 1 :]
        if len(steps):
            self._least, self._most = min(self._least, steps.min()), max(self._most, steps.max())
        self._last, self._count = float(time[-1]), self._count + len(time)

    def rate(self) -> float | None:
        """Give samples a second where no step is 5 % off the mean, else None."""
        if self._count < 2 or not self._least > 0.0:
            return None
        step = (self._last - self._first) / (self._count - 1)
        if self._most - self._least > JITTER * step:
            return None
        return float(f"{1.0 / step:.12g}")  # 2000, not 1999.9999999999998


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
        stream.append(_squeezed(plane) if _is_worth_squeezing(plane) else _stored(plane))
    return b"".join([*stream, _LAST_BLOCK, check.to_bytes(4, "big")])


def _is_worth_squeezing(plane: bytes) -> bool:
    middle = max(0, (len(plane) - _PROBE) // 2)
    probe = plane[middle : middle + _PROBE]
    return len(zlib.compress(probe, 1)) < _WORTH * len(probe)


def _squeezed(plane: bytes) -> bytes:
    raw = zlib.compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS)
    return raw.compress(plane) + raw.flush(zlib.Z_SYNC_FLUSH)


def _stored(plane: bytes) -> bytes:
    pieces = [plane[start : start + _STORED_MOST] for start in range(0, len(plane), _STORED_MOST)]
    lengths = [
        (len(piece).to_bytes(2, "little"), (len(piece) ^ 0xFFFF).to_bytes(2, "little")) for piece in pieces
    ]
    return b"".join(b"\0" + one + other + piece for (one, other), piece in zip(lengths, pieces, strict=True))
