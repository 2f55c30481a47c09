"""HDF5 files that claim, loop or point elsewhere are read in bounded time, or refused with the reason."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import open_log

X = np.arange(100.0)


def read(path: Path | str, column: str = "voltage_V") -> list[float]:
    with open_log(str(path), {"voltage": ColumnWish(column)}, ReadingOptions()) as log:
        return log.read().values["voltage"].tolist()


def virtual(
    file: Any, name: str, *sources: tuple[str, str, int], length: int = 100
) -> None:
    layout = h5py.VirtualLayout(shape=(length,), dtype="f8")
    start = 0
    for other, inner, count in sources:
        layout[start : start + count] = h5py.VirtualSource(other, inner, shape=(count,))
        start += count
    file.create_virtual_dataset(name, layout)


def claimed(file: Any) -> None:
    file.create_dataset("y", shape=(10**12,), dtype="f8")


def claimed_in_chunks(file: Any) -> None:
    file.create_dataset("y", shape=(10**12,), chunks=(1000,), dtype="f8")[:5] = 1.0


def huge_chunks(file: Any) -> None:
    file.create_dataset(
        "y", shape=(200_000_000,), chunks=(200_000_000,), dtype="f8", compression="gzip"
    )


def made_of_itself(file: Any) -> None:
    virtual(file, "y", (".", "y", 100))


def made_of_each_other(file: Any) -> None:
    virtual(file, "y", (".", "z", 100))
    virtual(file, "z", (".", "y", 100))


def missing_file(file: Any) -> None:
    virtual(file, "y", ("nowhere.h5", "y", 100))


def missing_dataset(file: Any) -> None:
    virtual(file, "y", (".", "nowhere", 100))


def missing_half(file: Any) -> None:
    virtual(file, "y", (".", "voltage_V", 50))


def stored_elsewhere(file: Any) -> None:
    file.create_dataset("y", shape=(100,), dtype="u1", external=[(__file__, 0, 100)])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            claimed,
            "claims 1,000,000,000,000 samples and holds none of them: the recording was not finished",
        ),
        (
            claimed_in_chunks,
            "claims 1,000,000,000,000 samples and holds 1e-07 % of them",
        ),
        (huge_chunks, "is stored in pieces of more than 1 GB"),
        (made_of_itself, "is a virtual one made of itself: it holds no samples"),
        (made_of_each_other, "is a virtual one made of itself: it holds no samples"),
        (
            missing_file,
            "is a virtual one, and its source 'y' in 'nowhere.h5' is missing",
        ),
        (
            missing_dataset,
            "is a virtual one, and its source 'nowhere' is missing there",
        ),
        (missing_half, "is a virtual one with sources for 50 of its 100 samples"),
        (stored_elsewhere, "takes its bytes from another file"),
    ],
)
def test_what_is_not_there_is_not_read(
    make: Callable[[Any], None], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["voltage_V"] = X
        make(file)
    with pytest.raises(InputError) as raised:
        read(path, "y")
    assert f"{path}: dataset '/y' {said}" in str(raised.value)


def test_virtual_datasets_and_links_that_are_sound_are_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "part.h5", "w") as file:
        file["g/v"] = X
        virtual(file, "again", (".", "g/v", 100))
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["voltage_V"] = X
        virtual(
            file, "joined", ("part.h5", "g/v", 100), (".", "voltage_V", 100), length=200
        )
        virtual(file, "deep", ("part.h5", "again", 100))
        file["linked"] = h5py.ExternalLink("part.h5", "/g/v")
        file["soft"] = h5py.SoftLink("/voltage_V")
    assert read(tmp_path / "run.h5", "joined") == [*X, *X]
    for name in ("deep", "linked", "soft"):
        assert read(tmp_path / "run.h5", name) == X.tolist()


def test_a_link_that_leads_nowhere_harms_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["voltage_V"] = X
        file["a"], file["b"] = h5py.SoftLink("/b"), h5py.SoftLink("/a")
        file["gone"], file["out"] = (
            h5py.SoftLink("/nowhere"),
            h5py.ExternalLink("nowhere.h5", "/y"),
        )
        file["self"] = h5py.ExternalLink("run.h5", "/self")
        file["g/up"] = file["/"]
    assert read(path) == X.tolist()
    assert read(f"{path}::/g/up/g/up") == X.tolist()
    with pytest.raises(InputError, match="there is no group '/a'"):
        read(f"{path}::/a")


@pytest.mark.skipif(os.name != "posix", reason="needs named pipes")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["voltage_V"] = X
        file["y"] = h5py.ExternalLink("pipe.h5", "/y")
    with pytest.raises(
        InputError, match=r"a link in '/' leads to 'pipe\.h5', which is no regular file"
    ):
        read(tmp_path / "run.h5")
    with pytest.raises(InputError, match="this is no regular file, and HDF5 needs one"):
        read(tmp_path / "pipe.h5")


def test_a_place_kept_for_something_else_harms_nothing(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["voltage_V"] = X
        file.create_dataset("kept", shape=(1_000_000,), dtype="f8")
    assert read(tmp_path / "run.h5") == X.tolist()
