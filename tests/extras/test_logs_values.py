"""Values that stand for none, and columns that a library adds: what netCDF and pandas mean by them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.request import ReadingOptions, parse_address
from dbo_cli.logs.signal_log import open_log

WANT = {"voltage": column_wish("voltage"), "displacement": column_wish("displacement")}
FORMATS = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF4"]


def netcdf(
    path: Path, format: str, kind: str, fill: float | None, stored: list[float]
) -> None:
    """Write rows of which those with NaN are left to the library's own fill value."""
    library = pytest.importorskip("netCDF4")
    with library.Dataset(path, "w", format=format) as file:
        file.createDimension("row", len(stored))
        voltage = file.createVariable("voltage", "f8", ("row",))
        voltage[:] = np.arange(len(stored))
        displacement = file.createVariable(
            "displacement", kind, ("row",), fill_value=fill
        )
        for row, value in enumerate(stored):
            if value == value:
                displacement[row] = value


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("fill", [None, -1.0, -9999.5])
@pytest.mark.parametrize("format", FORMATS)
def test_what_was_never_written_to_netcdf_is_no_number(
    tmp_path: Path, format: str, kind: str, fill: float | None
) -> None:
    netcdf(tmp_path / "log.nc", format, kind, fill, [0.5, np.nan, 2.5])
    with pytest.raises(InputError) as raised:
        open_log(str(tmp_path / "log.nc"), WANT).read()
    assert str(raised.value).startswith(
        f"{tmp_path}/log.nc: row 2: column 'displacement' is not finite: 'nan'"
    )
    with open_log(str(tmp_path / "log.nc"), WANT, ReadingOptions(skip_bad=True)) as log:
        block = log.read()
    assert block.values["displacement"].tolist() == [0.5, 2.5]
    assert list(block.rows) == [1, 3]


@pytest.mark.parametrize("format", FORMATS)
def test_what_was_never_written_to_packed_netcdf_is_no_number(
    tmp_path: Path, format: str
) -> None:
    """The fill value is compared as stored, before it is scaled."""
    library = pytest.importorskip("netCDF4")
    netcdf(tmp_path / "log.nc", format, "i2", -7, [1, np.nan, 3])
    with library.Dataset(tmp_path / "log.nc", "a") as file:
        file["displacement"].scale_factor, file["displacement"].add_offset = 0.5, 10.0
    with open_log(str(tmp_path / "log.nc"), WANT, ReadingOptions(skip_bad=True)) as log:
        assert log.read().values["displacement"].tolist() == [10.5, 11.5]


@pytest.mark.parametrize("format", FORMATS)
def test_a_value_that_another_file_would_fill_with_is_a_number(
    tmp_path: Path, format: str
) -> None:
    netcdf(tmp_path / "log.nc", format, "f8", -1.0, [0.5, 9.969209968386869e36, 2.5])
    with open_log(str(tmp_path / "log.nc"), WANT) as log:
        assert log.read().values["displacement"].tolist() == [
            0.5,
            9.969209968386869e36,
            2.5,
        ]


def test_row_numbers_of_pandas_are_no_column(tmp_path: Path) -> None:
    """An index without a name is called ``__index_level_0__`` in Parquet."""
    rows = pd.DataFrame({"voltage_V": [1.0, 2.0], "displacement_um": [3.0, 4.0]})
    rows.set_axis([7, 9]).to_parquet(tmp_path / "log.parquet")
    assert b"__index_level_0__" in (tmp_path / "log.parquet").read_bytes()
    with open_log(str(tmp_path / "log.parquet"), WANT) as log:
        assert (log.time, log.read().time) == (None, None)
        with pytest.raises(InputError, match=r"it has 1 voltage_V, 2 displacement_um$"):
            open_log(
                str(tmp_path / "log.parquet"),
                {"voltage": column_wish("voltage", "nothing")},
            )


def test_stamps_of_pandas_are_the_time(tmp_path: Path) -> None:
    rows = pd.DataFrame({"voltage_V": [1.0, 2.0], "displacement_um": [3.0, 4.0]})
    stamps = pd.to_datetime(["2024-01-01 00:00:00.5", "2024-01-01 00:00:02.0"])
    rows.set_axis(stamps).to_parquet(tmp_path / "log.parquet")
    with open_log(str(tmp_path / "log.parquet"), WANT) as log:
        block = log.read()
        assert block.time is not None and block.time.tolist() == [0.0, 1.5]
        assert log.time is not None and (log.time.name, log.time.unit) == ("time", "s")


def test_files_that_begin_at_different_times_are_joined_at_their_own(
    tmp_path: Path,
) -> None:
    """Two logs of one rate, the drive's 2 ms later: its first row belongs to the sensor's third."""
    mat = pytest.importorskip("scipy.io")
    sensor, drive = tmp_path / "sensor.mat", tmp_path / "drive.mat"
    mat.savemat(
        sensor, {"displacement_um": np.arange(8.0), "Tinterval": 1e-3, "Tstart": 0.0}
    )
    mat.savemat(
        drive, {"voltage_V": 10.0 + np.arange(8.0), "Tinterval": 1e-3, "Tstart": 2e-3}
    )
    wishes = {
        "displacement": column_wish("displacement"),
        "voltage": column_wish("voltage", f"{drive}::voltage_V"),
    }
    with open_log(parse_address(str(sensor)), wishes, ReadingOptions()) as log:
        block = log.read()
    assert block.time is not None and block.time.tolist() == pytest.approx(
        np.arange(2, 8) / 1000.0
    )
    assert block.values["displacement"].tolist() == [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert block.values["voltage"].tolist() == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]
