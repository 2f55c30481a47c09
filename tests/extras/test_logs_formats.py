"""Formats of libraries and instruments: each file reads right or is refused in the words of the table."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.errors import InputError, UsageError
from dbo_cli.logs.columns import column_wish
from dbo_cli.logs.signal_log import SignalLog, open_log
from tests.shapes.format_files import LIBRARY_FILES, D, FormatFile, T, V
from tests.shapes.format_table import page
from tests.shapes.instrument_files import INSTRUMENT_FILES
from tests.shapes.laboratory_files import LABORATORY_FILES

FILES = LIBRARY_FILES + LABORATORY_FILES + INSTRUMENT_FILES
NEEDED = {
    "pandas (PyTables)": "tables",
    "pandas (pyarrow)": "pyarrow",
    "npTDMS": "nptdms",
    "pyuff": "pyuff",
    "openpyxl": "openpyxl",
    "xarray (netCDF4)": "netCDF4",
    "xarray (scipy)": "xarray",
    "nexusformat": "nexusformat",
}


def written(case: FormatFile, folder: Path) -> str:
    if case.writer in NEEDED:
        pytest.importorskip(NEEDED[case.writer])
    path = folder / f"run{case.ending}"
    case.write(path)
    return f"{path}{case.group}"


def opened(case: FormatFile, address: str) -> SignalLog:
    roles = ("voltage", "displacement")
    return open_log(
        address,
        {role: column_wish(role, case.ask.get(role), option=role) for role in roles},
        case.options,
    )


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


def test_the_page_says_what_the_tests_hold() -> None:
    kept = Path(__file__).parents[2] / "docs" / "instruments-formats.md"
    remedy = "python -m tests.shapes.format_table > docs/instruments-formats.md"
    assert kept.read_text(encoding="utf-8") == page(), remedy


@pytest.mark.parametrize("block_rows", [1, 3])
@pytest.mark.parametrize(
    "case", [case for case in FILES if not case.refusal], ids=lambda case: case.name
)
def test_block_size_changes_nothing(
    case: FormatFile, block_rows: int, tmp_path: Path
) -> None:
    address = written(case, tmp_path)
    with opened(case, address) as log:
        whole = log.read()
    with opened(replace(case, block_rows=block_rows), address) as log:
        parts = log.read()
    assert {role: values.tobytes() for role, values in parts.values.items()} == {
        role: values.tobytes() for role, values in whole.values.items()
    }
    assert (None if parts.time is None else parts.time.tobytes()) == (
        None if whole.time is None else whole.time.tobytes()
    )


@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("Excel", "fastexcel"),
        ("TDMS waveforms", "nptdms"),
        ("UFF, data sets 58", "pyuff"),
    ],
)
def test_an_extra_that_is_not_installed_is_named(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = next(one for one in FILES if one.name == name)
    address = written(case, tmp_path)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError) as raised:
        opened(case, address)
    assert (
        str(raised.value)
        == f"{address}: reading it needs the library {library}: pip install {library}"
    )


HEAVY = {
    "h5py",
    "scipy",
    "polars",
    "pandas",
    "pyarrow",
    "nptdms",
    "fastexcel",
    "xarray",
    "netCDF4",
}
OWN = {
    "MATLAB v7, column vectors": "scipy",
    "NumPy, an archive with a rate": "",
    "Parquet": "polars",
    "TDMS waveforms": "nptdms",
    "HDF5, a step in ms": "h5py",
    "Rigol DS1000, Start and Increment": "",
    "JSON lines": "",
    "Igor text, a wave each": "",
}


@pytest.mark.parametrize("name", OWN)
def test_only_the_library_that_a_file_needs_is_loaded(
    name: str, tmp_path: Path
) -> None:
    case = next(one for one in FILES if one.name == name)
    address = written(case, tmp_path)
    script = (
        "import sys; from dbo_cli.logs.columns import ColumnWish\n"
        "from dbo_cli.logs.signal_log import open_log\n"
        f"log = open_log({address!r}, {{'x': ColumnWish('2')}}); log.read()\n"
        f"print(*sorted(set({sorted(HEAVY)!r}) & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [OWN[name]] * bool(OWN[name])


@cache
def content_of(name: str) -> bytes:
    """Write a file once: a zip archive holds the time of its writing."""
    with tempfile.TemporaryDirectory() as folder:
        return Path(
            written(next(one for one in FILES if one.name == name), Path(folder))
        ).read_bytes()


DAMAGED = [
    "MATLAB v7, column vectors",
    "MATLAB v4",
    "NumPy, a structured array",
    "NumPy, an archive with a rate",
    "Parquet",
    "Arrow with time stamps",
    "netCDF-3, packed",
    "TDMS waveforms",
    "Excel",
    "JSON lines",
    "JSON, an object of arrays and a rate",
    "UFF, data sets 58",
    "Igor text, a wave each",
    "Grafana, series below each other",
]


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.data())
def test_a_damaged_file_reads_as_written_or_is_refused(data: st.DataObject) -> None:
    """A byte changed or a tail cut off: an error of one line, or finite samples; never another exception."""
    name = data.draw(st.sampled_from(DAMAGED))
    case = next(one for one in FILES if one.name == name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run{case.ending}"
        content = bytearray(content_of(name))
        place = data.draw(st.integers(0, len(content) - 1))
        if data.draw(st.booleans()):
            content[place] = data.draw(st.integers(0, 255))
        else:
            del content[place:]
        path.write_bytes(content)
        try:
            with opened(case, str(path)) as log:
                block = log.read()
        except (InputError, UsageError) as refused:
            assert "\n" not in str(refused)
        else:
            assert all(np.isfinite(values).all() for values in block.values.values())


def test_a_list_of_unlike_values_states_no_rate() -> None:
    from dbo_cli.extras.instruments.binary import _statements

    stated = _statements({"signals": [{}, np.zeros(4)], "fs": 1000.0})
    assert [one.rate for one in stated] == [1000.0]


def test_a_rate_of_unlike_lists_is_refused_in_words() -> None:
    from dbo_cli.logs.clock import read_statements

    (stated,) = read_statements("fs", [1.0, [2.0, 3.0]])
    assert stated.problem == "'fs' (several values) is no single number"


def test_a_struct_whose_label_is_no_text_is_no_channel(tmp_path: Path) -> None:
    import scipy.io

    path = tmp_path / "run.mat"
    calibration = {"Data": np.arange(3.0), "label": np.arange(3.0)}
    signals = {"t": np.array(T), "voltage": np.array(V), "displacement": np.array(D)}
    scipy.io.savemat(path, signals | {"calibration": calibration})
    with open_log(
        str(path), {role: column_wish(role) for role in ("voltage", "displacement")}
    ) as log:
        assert log.read().values["voltage"].tolist() == list(V)
