"""Matrices as an output: one HDF5 dataset a quantity, rows of samples, a column of each channel."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence

import h5py
import numpy as np

from dbo_cli.errors import UsageError
from dbo_cli.logs.addresses import Address, Given
from dbo_cli.logs.hdf5.store import MARK, StoreOutput, group_path
from dbo_cli.logs.out_column import OutColumn, require_finite
from dbo_cli.logs.output_files import check_output
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.sample_block import FloatArray
from dbo_cli.logs.whole_output import replacing

_CHUNK_ROWS = 1 << 14  # of one channel: 128 kB, so that a channel is written, and read again, by itself

WriteChannel = Callable[[int, Sequence[FloatArray]], None]


@contextlib.contextmanager
def matrix_writer(
    target: Address,
    columns: Sequence[OutColumn],
    channels: Sequence[str],
    time: FloatArray | None,
    rows: int,
    *,
    attributes: Mapping[str, str | float],
    protect: Sequence[Given] = (),
) -> Iterator[WriteChannel]:
    """Open a file for matrices; gives a function that writes one channel's column of each.

    A channel that is not written is NaN, so that no other's numbers are taken for its own.

    Raises
    ------
    UsageError
        The output is an input, or a stream.
    OutputError
        It cannot be written.
    """
    check_output(target, protect)
    if target.is_stream:
        raise UsageError("HDF5 cannot be written to a pipe: name a file (-o FILE.h5)")
    store = StoreOutput(target.path, group_path(target.group))
    store.check()
    with replacing(target.path, store.publishing) as path, h5py.File(path, "w") as file:
        group = file.require_group(store.group)
        for key, value in attributes.items():
            group.attrs[key] = cleaned(value) if isinstance(value, str) else value
        group.attrs[MARK] = [*(["time_s"] if time is not None else []), *(one.name for one in columns)]
        if time is not None:
            group["time_s"] = time
            group["time_s"].attrs["units"] = "s"
        datasets = []
        for column in columns:
            dataset = group.create_dataset(
                column.name,
                (rows, len(channels)),
                "<f8",
                chunks=(min(rows, _CHUNK_ROWS), 1),
                fillvalue=np.nan,
            )
            dataset.attrs["quantity"] = cleaned(column.quantity or column.name)
            dataset.attrs["channel_of_column"] = list(channels)
            if column.unit:
                dataset.attrs["units"] = cleaned(column.unit)
            datasets.append(dataset)

        def write(place: int, arrays: Sequence[FloatArray]) -> None:
            require_finite(columns, [one.header for one in columns], arrays)
            for dataset, array in zip(datasets, arrays, strict=True):
                dataset[:, place] = array

        yield write
