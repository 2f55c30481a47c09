"""A log that changes while it is read: an error, and nothing is written; a text log may grow."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars
import pytest
import scipy.io

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import open_log

ROWS = 300_000  # more than text that is read ahead, and several blocks
WANT = {"voltage": column_wish("voltage"), "displacement": column_wish("displacement")}
VALUES = {
    "time_s": np.arange(ROWS) / 1000,
    "voltage_V": np.sin(np.arange(ROWS)),
    "displacement_um": np.cos(np.arange(ROWS)),
}


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, values in VALUES.items():
            file[name] = values


def npy(path: Path) -> None:
    record = np.empty(ROWS, [(name, "f8") for name in VALUES])
    for name, values in VALUES.items():
        record[name] = values
    np.save(path, record)


def csv(path: Path) -> None:
    polars.DataFrame(VALUES).write_csv(path)


def csv_gz(path: Path) -> None:
    csv(path.with_suffix(".plain"))
    path.write_bytes(gzip.compress(path.with_suffix(".plain").read_bytes(), 1))


def parquet(path: Path) -> None:
    polars.DataFrame(VALUES).write_parquet(path)


def matlab(path: Path) -> None:
    scipy.io.savemat(path, VALUES)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 3)


def cut_to_nothing(path: Path) -> None:
    os.truncate(path, 0)


def grow(path: Path) -> None:
    with open(path, "ab") as file:
        file.write(b"\0" * 4096)


def overwrite(path: Path) -> None:
    """Write the same number of bytes, at a later time."""
    before = path.stat()
    with open(path, "r+b") as file:
        file.seek(before.st_size - 9)
        file.write(b"1")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns + 1_000_000))


def replace(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    os.replace(other, path)


def said(path: Path) -> str:
    return f"{path}: the file changed while it was read: read it when its writer is done, or read a copy"


WRITERS: dict[str, Callable[[Path], None]] = {
    "log.h5": hdf5, "log.npy": npy, "log.parquet": parquet, "log.mat": matlab,
    "log.csv": csv, "log.csv.gz": csv_gz,
}  # fmt: skip


def read_on(path: Path, change: Callable[[Path], None]) -> None:
    """Read the first block, let the file change, and read on to the end."""
    with open_log(str(path), WANT, ReadingOptions(block_rows=4096)) as log:
        blocks = log.blocks()
        next(blocks)
        change(path)
        for _ in blocks:
            pass


@pytest.mark.whole
@pytest.mark.parametrize("change", [cut, cut_to_nothing, overwrite, grow, replace])
@pytest.mark.parametrize("name", ["log.h5", "log.npy", "log.parquet", "log.mat"])
def test_a_binary_log_that_changes(
    tmp_path: Path, name: str, change: Callable[[Path], None]
) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    with pytest.raises(InputError) as raised:
        read_on(path, change)
    assert str(raised.value) == said(path)


@pytest.mark.parametrize("change", [cut, cut_to_nothing, overwrite])
@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_a_text_log_that_is_cut_or_written_over(
    tmp_path: Path, name: str, change: Callable[[Path], None]
) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    with pytest.raises(InputError) as raised:
        read_on(path, change)
    assert str(raised.value) == said(path)


@pytest.mark.parametrize("live", [False, True])
def test_a_text_log_may_grow(tmp_path: Path, live: bool) -> None:
    path = tmp_path / "log.csv"
    csv(path)
    with open_log(str(path), WANT, live=live) as log:
        blocks, rows = log.blocks(), 0
        for number, block in enumerate(blocks):
            rows += len(block)
            if number == 0:
                with open(path, "ab") as file:
                    file.write(b"300.0,0.5,0.25\n")
    assert rows == ROWS + 1


def test_a_log_that_is_replaced_by_another_is_read_to_its_own_end(
    tmp_path: Path,
) -> None:
    """What rotates logs renames the old one: it stays what it was."""
    path = tmp_path / "log.csv"
    csv(path)
    with open_log(str(path), WANT) as log:
        blocks = log.blocks()
        rows = len(next(blocks))
        os.rename(path, tmp_path / "log.csv.1")
        path.write_text("time_s,voltage_V,displacement_um\n")
        assert rows + sum(map(len, blocks)) == ROWS


@pytest.mark.parametrize("link", [True, False])
def test_a_file_behind_a_link_is_watched_too(tmp_path: Path, link: bool) -> None:
    hdf5(tmp_path / "there.h5")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in VALUES:
            if link:
                file[name] = h5py.ExternalLink("there.h5", name)
            else:
                layout = h5py.VirtualLayout((ROWS,), "f8")
                layout[:] = h5py.VirtualSource("there.h5", name, (ROWS,))
                file.create_virtual_dataset(name, layout)
    with pytest.raises(InputError) as raised:
        read_on(tmp_path / "log.h5", lambda path: cut(path.with_name("there.h5")))
    assert str(raised.value) == said(tmp_path / "log.h5")


@pytest.mark.whole
@pytest.mark.parametrize("name", ["log.h5", "log.npy", "log.csv"])
def test_nothing_is_written(
    tmp_path: Path,
    name: str,
    dbo: Any,
    model_file: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from dbo_cli.logs.hdf5.store import Hdf5Writer

    path = tmp_path / name
    WRITERS[name](path)
    write = Hdf5Writer.write

    def write_and_cut(self: Any, *arrays: Any) -> None:
        write(self, *arrays)
        cut_to_nothing(path)

    monkeypatch.setattr(Hdf5Writer, "write", write_and_cut)
    before = set(os.listdir(tmp_path))
    done = dbo(
        "simulate", model_file, path, "-o", "out.h5", "--save-state", "state.json"
    )
    assert (done.code, done.out) == (1, "")
    assert done.err.splitlines()[-1] == "dbo: error: " + said(path)
    assert set(os.listdir(tmp_path)) == before


def test_a_record_that_its_recorder_goes_on_writing_is_refused(tmp_path: Path) -> None:
    """Single writer, multiple readers: its file grows while it is read."""
    path = tmp_path / "log.h5"
    with h5py.File(path, "w", libver="latest") as file:
        columns = [
            file.create_dataset(name, data=values, maxshape=(None,), chunks=(8192,))
            for name, values in VALUES.items()
        ]
        file.swmr_mode = True

        def record(path: Path) -> None:
            for column in columns:
                column.resize((ROWS + 8192,))
                column[ROWS:] = 1.0
                column.flush()

        with pytest.raises(InputError) as raised:
            read_on(path, record)
    assert str(raised.value) == said(path)
