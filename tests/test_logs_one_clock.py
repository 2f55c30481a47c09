"""One reader of time for every container: the same stamps give the same seconds, however they are stored."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.signal_log import open_log

ROWS, RATE = 40, 50.0
T = np.arange(ROWS) / RATE
V = 50.0 - 50.0 * np.cos(2.0 * np.pi * T)
BEGIN = datetime.datetime(2024, 5, 1, 12, tzinfo=datetime.UTC)
EPOCH = int(BEGIN.timestamp())
ISO = [
    f"{BEGIN + datetime.timedelta(milliseconds=20 * k):%Y-%m-%dT%H:%M:%S.%f}"[:23]
    for k in range(ROWS)
]
COMPOUND = [("voltage_V", "f8"), ("position_um", "f8")]


def signals(group: Any) -> None:
    """Write the two signals, their units as attributes of either name."""
    group.create_dataset("hv_monitor", data=V).attrs["units"] = "V"
    group.create_dataset("position", data=V / 10.0).attrs["unit"] = "um"


def beside(
    name: str, values: Any, units: str | None = None, **known: Any
) -> Callable[[Any], None]:
    """Return what writes a dataset of times beside the signals."""

    def write(file: Any) -> None:
        signals(file)
        times = file.create_dataset(name, data=values, **known)
        if units is not None:
            times.attrs["units"] = units

    return write


def compound(kind: Any, stamps: Any) -> Callable[[Any], None]:
    """Return what writes one dataset of rows with a field of stamps."""

    def write(file: Any) -> None:
        rows = list(zip(stamps, V, V / 10.0, strict=True))
        file["log"] = np.array(rows, dtype=[("time", kind), *COMPOUND])

    return write


def rate_of_file(file: Any) -> None:
    signals(file)
    file.attrs["sample_rate"] = RATE


def rate_of_columns(file: Any) -> None:
    signals(file)
    for name in ("hv_monitor", "position"):
        file[name].attrs["sample_rate"] = "0.05 kHz"


SINCE_1970, FROM_0 = float(EPOCH), 0.0
CONTAINERS: dict[str, tuple[Callable[[Any], None], float]] = {
    "texts": (beside("timestamps", ISO, dtype=h5py.string_dtype()), SINCE_1970),
    "bytes": (beside("timestamps", np.array(ISO, dtype="S")), SINCE_1970),
    "texts with a zone": (beside("time", [f"{stamp}Z" for stamp in ISO]), SINCE_1970),
    "field of bytes": (compound("S23", ISO), SINCE_1970),
    "field of texts": (compound(h5py.string_dtype(), ISO), SINCE_1970),
    "whole nanoseconds": (beside("t", np.arange(ROWS) * 20_000_000, "ns"), FROM_0),
    "whole milliseconds": (beside("t", np.arange(ROWS) * 20, "ms"), FROM_0),
    "field of milliseconds": (compound("f8", T), FROM_0),
    "epoch in s": (beside("time", EPOCH + T), SINCE_1970),
    "epoch in ms": (beside("time", EPOCH * 1000 + np.arange(ROWS) * 20), SINCE_1970),
    "epoch in us": (
        beside("timestamp", EPOCH * 10**6 + np.arange(ROWS) * 20_000),
        SINCE_1970,
    ),
    "epoch in ns": (
        beside("timestamp", EPOCH * 10**9 + np.arange(ROWS) * 20_000_000),
        SINCE_1970,
    ),
    "rate of the file": (rate_of_file, FROM_0),
    "rate of the columns": (rate_of_columns, FROM_0),
}


@pytest.mark.parametrize("container", CONTAINERS)
def test_times_are_read_from_every_container(container: str, tmp_path: Path) -> None:
    write, zero = CONTAINERS[container]
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        write(file)
    wishes = {
        "voltage": ColumnWish(None, ("voltage",), option="voltage"),
        "displacement": ColumnWish(
            None, ("displacement", "position"), option="displacement"
        ),
    }
    for block_rows in (7, 1000):
        with open_log(str(path), wishes, ReadingOptions(block_rows=block_rows)) as log:
            block = log.read()
        assert block.time is not None
        np.testing.assert_allclose(block.time - zero, T, rtol=0.0, atol=3e-7)
        assert block.values["voltage"].tolist() == V.tolist()


def test_a_csv_and_an_hdf5_file_with_the_same_stamps_are_one_clock(
    tmp_path: Path,
) -> None:
    sensor = tmp_path / "sensor.csv"
    rows = [
        f"{stamp},{value / 10!r}" for stamp, value in zip(ISO, V.tolist(), strict=True)
    ]
    sensor.write_text("\n".join(["time,displacement_um", *rows]))
    drive = tmp_path / "drive.h5"
    with h5py.File(drive, "w") as file:
        stamps = [f"{stamp}Z" for stamp in ISO[10:]]
        file["timestamps"] = stamps
        file["voltage"] = V[10:]
    wishes = {
        "voltage": ColumnWish(f"{drive}::voltage", ("voltage",), option="voltage"),
        "displacement": ColumnWish(None, ("displacement",), option="displacement"),
    }
    with open_log(str(sensor), wishes, ReadingOptions()) as log:
        block = log.read()
        assert list(block.rows) == list(range(11, ROWS + 1))
        assert block.values["voltage"].tolist() == V[10:].tolist()
        assert (
            f"{sensor}: 10 rows are left out: {drive} has none before it begins"
            in log.notes
        )
