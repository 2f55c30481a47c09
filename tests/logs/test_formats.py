"""Files of other libraries: values to the bit, units, rates, and refusals that say what to do."""

from __future__ import annotations

import datetime
import importlib.metadata
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

from dbo_cli.errors import InputError
from dbo_cli.logs.formats import arrow, reader_of, stored
from dbo_cli.logs.formats.npy import NUMPY
from dbo_cli.logs.table import Reading, Table

T = (0.0, 0.001, 0.002, 0.003)
V = (0.0, 1.5, -2.5, 4.0)
D = (10.25, 11.0, 9.125, 8.0)
NAMED = {"time_s": T, "voltage_V": V, "displacement_um": D}
STAMPS = [datetime.datetime(2026, 1, 2, 3, 4, 5, 1000 * n) for n in range(4)]
FIRST = 1_767_323_045_000_000_000  # of STAMPS, ns since 1970


def opened(path: Path, part: str = "") -> Table:
    reader = reader_of(str(path), path.read_bytes()[:1024])
    assert reader is not None
    return reader(str(path), part, Reading())


def read(source: Table) -> dict[str, np.ndarray]:
    try:
        blocks = list(source.blocks(source.columns))
    finally:
        source.close()
    found = {}
    for place, column in enumerate(source.columns):
        found[column.name or str(column.number)] = np.concatenate(
            [b[place] for b in blocks]
        )
    return found


# --- what libraries write ---


def npy_records(path: Path) -> None:
    rows = list(zip(T, V, D, strict=True))
    np.save(path, np.array(rows, dtype=[(name, "f8") for name in NAMED]))


def npz(path: Path) -> None:
    np.savez(
        path, **{name: np.array(values) for name, values in NAMED.items()}, note="N. N."
    )


def matlab(path: Path) -> None:
    scipy.io.savemat(
        path, {name: np.array([values]).T for name, values in NAMED.items()}
    )


def matlab4(path: Path) -> None:
    scipy.io.savemat(
        path, {name: np.array(values) for name, values in NAMED.items()}, format="4"
    )


def parquet(path: Path) -> None:
    pd.DataFrame(NAMED).to_parquet(path)


def parquet_by_polars(path: Path) -> None:
    pl.DataFrame(NAMED).write_parquet(path)


def feather(path: Path) -> None:
    pd.DataFrame(NAMED).to_feather(path)


def workbook(path: Path) -> None:
    with pd.ExcelWriter(path) as book:
        pd.DataFrame(NAMED).to_excel(book, sheet_name="Run 1", index=False)


def tdms(path: Path) -> None:
    import nptdms

    units = {"time_s": "s", "voltage_V": "V", "displacement_um": "µm"}
    channels = []
    for name, values in NAMED.items():
        stated = {"unit_string": units[name]}
        channels.append(
            nptdms.ChannelObject(
                "Run", name.partition("_")[0], np.array(values), stated
            )
        )
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.RootObject(), *channels])


WRITTEN: dict[str, tuple[str, Callable[[Path], None]]] = {
    "NumPy, records": (".npy", npy_records),
    "NumPy, an archive": (".npz", npz),
    "MATLAB v5": (".mat", matlab),
    "MATLAB v4": (".mat", matlab4),
    "Parquet by pandas": (".parquet", parquet),
    "Parquet by polars": (".parquet", parquet_by_polars),
    "Feather": (".feather", feather),
    "Excel": (".xlsx", workbook),
    "TDMS": (".tdms", tdms),
    "TDMS by another name": (".bin", tdms),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_values_and_units_come_back(name: str, tmp_path: Path) -> None:
    suffix, write = WRITTEN[name]
    path = tmp_path / f"run{suffix}"
    write(path)
    source = opened(path)
    assert [column.unit for column in source.columns] == ["s", "V", "um"]
    assert [column.quantity for column in source.columns] == [
        "time",
        "voltage",
        "displacement",
    ]
    for values, wanted in zip(read(source).values(), (T, V, D), strict=True):
        np.testing.assert_array_equal(values, wanted)
        assert values.dtype == np.float64


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_matrix_is_read_along_its_longer_axis(
    tmp_path: Path, order: Any, turned: bool
) -> None:
    table = np.random.default_rng(0).normal(size=(150_000, 3))
    stored = np.asarray(table.T if turned else table, order=order)
    np.save(tmp_path / "a.npy", stored)
    source = opened(tmp_path / "a.npy")
    assert [column.number for column in source.columns] == [1, 2, 3]
    assert max(len(block[0]) for block in source.blocks(source.columns)) <= 65_536
    np.testing.assert_array_equal(np.column_stack(list(read(source).values())), table)


def test_long_tables_come_in_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrow, "_STRETCH", 100_000)
    values = np.random.default_rng(0).normal(size=330_000)
    frame = pl.DataFrame({"x": values, "n": np.arange(330_000)})
    frame.write_parquet(tmp_path / "a.parquet", row_group_size=70_000)
    frame.write_ipc(tmp_path / "a.arrow")
    for name in ("a.parquet", "a.arrow"):
        found = read(opened(tmp_path / name))
        np.testing.assert_array_equal(found["x"], values)
        np.testing.assert_array_equal(found["n"], np.arange(330_000.0))


def stamped_parquet(path: Path) -> None:
    pd.DataFrame({"voltage_V": V}, index=pd.DatetimeIndex(STAMPS)).to_parquet(path)


def stamped_zone(path: Path) -> None:
    zone = (
        pl.Series("time", STAMPS)
        .dt.replace_time_zone("UTC")
        .dt.convert_time_zone("Asia/Tokyo")
    )
    pl.DataFrame({"time": zone, "voltage_V": V}).write_parquet(path)


def stamped_npz(path: Path) -> None:
    np.savez(path, time=np.array(STAMPS, dtype="M8[us]"), voltage_V=V)


def stamped_tdms(path: Path) -> None:
    import nptdms

    stamps = np.array(STAMPS, dtype="M8[us]")
    channels = [
        nptdms.ChannelObject("g", "time", stamps),
        nptdms.ChannelObject("g", "v", np.array(V)),
    ]
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(channels)


@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        (".parquet", stamped_parquet),
        (".parquet", stamped_zone),
        (".npz", stamped_npz),
        (".tdms", stamped_tdms),
    ],
)
def test_stamps_are_nanoseconds(
    tmp_path: Path, suffix: str, write: Callable[[Path], None]
) -> None:
    path = tmp_path / f"run{suffix}"
    write(path)
    source = opened(path)
    (column,) = [column for column in source.columns if column.kind == "stamp"]
    stamps = read(source)[column.name]
    assert stamps.dtype == np.int64
    np.testing.assert_array_equal(stamps, FIRST + 1_000_000 * np.arange(4))


def test_rates_that_files_state(tmp_path: Path) -> None:
    import nptdms

    np.savez(tmp_path / "a.npz", voltage_V=V, sample_rate_kHz=2.0)
    columns = {"A": np.array([V]).T, "Tinterval": 0.0005, "Tstart": -0.001}
    scipy.io.savemat(tmp_path / "a.mat", columns)
    timing = {"wf_increment": 0.0005, "wf_start_offset": -0.001}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment([nptdms.ChannelObject("g", "v", np.array(V), timing)])
    starts = {"a.npz": 0.0, "a.mat": -0.001, "a.tdms": -0.001}
    for name, start in starts.items():
        source = opened(tmp_path / name)
        assert source.stated.rate == 2000.0
        assert source.stated.start == start
        assert len(source.columns) == 1
        source.close()


def test_parts_are_chosen_or_asked_for(tmp_path: Path) -> None:
    with pd.ExcelWriter(tmp_path / "a.xlsx") as book:
        for sheet, values in (("Run 1", V), ("Run 2", D)):
            pd.DataFrame({"t_s": T, "u": values}).to_excel(
                book, sheet_name=sheet, index=False
            )
    with pytest.raises(InputError, match=r"Run 1, Run 2.*a\.xlsx::Run 1"):
        opened(tmp_path / "a.xlsx")
    np.testing.assert_array_equal(read(opened(tmp_path / "a.xlsx", "Run 2"))["u"], D)
    with pytest.raises(InputError, match="Run 1, Run 2"):
        opened(tmp_path / "a.xlsx", "Run 3")
    parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="no parts"):
        opened(tmp_path / "a.parquet", "x")


def test_a_cell_of_a_workbook_keeps_all_its_digits(tmp_path: Path) -> None:
    values = [0.1, 3.333333333333333e-08, -2.5, 123456.789012345]
    pd.DataFrame({"t_s": T, "u": values}).to_excel(tmp_path / "a.xlsx", index=False)
    np.testing.assert_array_equal(read(opened(tmp_path / "a.xlsx"))["u"], values)


# --- refusals ---


class Explosive:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return open, (str(self.path), "w")


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    trap = Explosive(tmp_path / "exploded")
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(trap))
    (tmp_path / "b.bin").write_bytes(pickle.dumps(trap))
    np.save(tmp_path / "c.npy", np.array([trap], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "d.npz", a=np.array([trap], dtype=object))
    for name in ("a.pkl", "b.bin", "c.npy", "d.npz"):
        with pytest.raises(InputError, match=r"to_parquet|allow_pickle|Python objects"):
            read(opened(tmp_path / name))
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.h5", b"time,voltage\n", "no HDF5"),
        ("a.json", b"{}", "to_csv"),
        ("a.uff", b"    -1\n    58\n", "CSV"),
        ("a.zip", b"PK\x03\x04" + 18 * b"\0", "zip"),
    ],
)
def test_formats_that_are_not_read_say_what_to_do(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        opened(tmp_path / name)


def test_a_library_that_is_absent_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(name: str) -> Any:
        raise ImportError(name)

    tdms(tmp_path / "a.tdms")
    workbook(tmp_path / "a.xlsx")
    monkeypatch.setattr(stored.importlib, "import_module", absent)
    for name, extra in (("a.tdms", "tdms"), ("a.xlsx", "excel")):
        with pytest.raises(InputError, match=rf"pip install 'dbo-cli\[{extra}\]'"):
            opened(tmp_path / name)


def test_a_reader_of_another_package_joins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array(V))

    class Point:
        def load(self) -> Any:
            return NUMPY.read

    def entry_points(group: str, name: str) -> list[Point]:
        return [Point()] if (group, name) == ("dbo_cli.readers", ".xyz") else []

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    assert reader_of("run.xyz", b"anything") is NUMPY.read
    assert reader_of("run.abc", b"anything") is None


@pytest.mark.parametrize(
    "name", [name for name in WRITTEN if name != "TDMS by another name"]
)
def test_damaged_files_end_in_one_line(name: str, tmp_path: Path) -> None:
    suffix, write = WRITTEN[name]
    path = tmp_path / f"run{suffix}"
    write(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(7)
    for number in range(12):
        data = bytearray(whole)
        if number % 2:
            del data[int(rng.integers(8, len(data))) :]
        # scipy ends the process at some wrong bytes of a MATLAB file
        for place in rng.integers(8, len(data), 0 if suffix == ".mat" else 6):
            data[place] = int(rng.integers(256))
        path.write_bytes(data)
        try:
            read(opened(path))
        except InputError as problem:
            assert "\n" not in str(problem)
