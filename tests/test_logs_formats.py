"""Formats of libraries and instruments: each file reads right or is refused in the words of the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.signal_log import SignalLog, open_log
from tests.shapes.format_files import LIBRARY_FILES, FormatFile
from tests.shapes.instrument_files import INSTRUMENT_FILES

FILES = LIBRARY_FILES + INSTRUMENT_FILES
NEEDED = {"pandas (PyTables)": "tables", "pandas (pyarrow)": "pyarrow", "npTDMS": "nptdms", "openpyxl": "openpyxl",
          "xarray (netCDF4)": "netCDF4", "xarray (scipy)": "xarray", "nexusformat": "nexusformat"}  # fmt: skip


def written(case: FormatFile, folder: Path) -> str:
    if case.writer in NEEDED:
        pytest.importorskip(NEEDED[case.writer])
    path = folder / f"run{case.ending}"
    case.write(path)
    return f"{path}{case.group}"


def opened(case: FormatFile, address: str) -> SignalLog:
    want = {
        "voltage": ColumnWish(case.ask.get("voltage"), ("voltage", "drive", "u"), option="voltage"),
        "displacement": ColumnWish(
            case.ask.get("displacement"), ("displacement", "position", "y"), option="displacement"
        ),
    }
    return open_log(address, want, case.options)


@pytest.mark.parametrize("case", FILES, ids=lambda case: case.name)
def test_format(case: FormatFile, tmp_path: Path) -> None:
    address = written(case, tmp_path)
    file = address.partition("::")[0]
    if case.refusal:
        with pytest.raises(InputError) as raised, opened(case, address) as log:
            log.read()
        assert str(raised.value) == address + case.refusal.replace("{file}", file)
        return
    with opened(case, address) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == list(case.voltage)
    assert block.values["displacement"].tolist() == list(case.displacement)
    if case.time is None:
        assert block.time is None
    else:
        assert block.time is not None
        np.testing.assert_allclose(block.time, case.time, rtol=1e-12, atol=1e-15)
    assert (log.columns["voltage"].unit, log.columns["displacement"].unit) == case.units
    assert log.notes == [address + note for note in case.notes]
