"""Files of other libraries: values to the bit, units, rates, and refusals that say what to do."""

import datetime
import importlib.metadata
import pickle

import h5py
import nptdms
import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

from dbo_cli.errors import InputError
from dbo_cli.logs import fence, frame_table, open_log
from dbo_cli.logs.formats import npy, reader_of
from dbo_cli.logs.settings import stated_rate
from dbo_cli.logs.table import Reading

T = (0.0, 0.001, 0.002, 0.003)
V = (0.0, 1.5, -2.5, 4.0)
D = (10.25, 11.0, 9.125, 8.0)
NAMED = {"time_s": T, "voltage_V": V, "displacement_um": D}
STAMPS = [datetime.datetime(2026, 1, 2, 3, 4, 5, 1000 * n) for n in range(4)]
FIRST = 1_767_323_045_000_000_000  # of STAMPS, ns since 1970


def opened(path, part=""):
    reader = reader_of(str(path), path.read_bytes()[:1024])
    return reader(str(path), part, Reading())


def read(source):
    try:
        blocks = list(source.blocks(source.columns))
    finally:
        source.close()
    found = {}
    for place, column in enumerate(source.columns):
        values = np.concatenate([block[place] for block in blocks])
        found[column.name or str(column.number)] = values
    return found


# --- what libraries write ---

FRAME = pd.DataFrame(NAMED)
ARRAYS = {name: np.array([values]).T for name, values in NAMED.items()}


def workbook(path):
    FRAME.to_excel(path, sheet_name="Run 1", index=False)


def segments(path, *channels):
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.RootObject(), *channels])


def tdms(path):
    channels = []
    for (title, values), unit in zip(NAMED.items(), ("s", "V", "µm"), strict=True):
        name, stated = title.partition("_")[0], {"unit_string": unit}
        channels.append(nptdms.ChannelObject("Run", name, np.array(values), stated))
    segments(path, *channels)


def hdf5(path):
    with h5py.File(path, "w") as file:
        for name, values in NAMED.items():
            file.create_dataset(name, data=values, chunks=(2,), compression="gzip")


WRITTEN = {
    "NumPy, records": (".npy", lambda p: np.save(p, FRAME.to_records(index=False))),
    "NumPy, an archive": (".npz", lambda p: np.savez(p, **ARRAYS, note="N. N.")),
    "MATLAB v5": (".mat", lambda p: scipy.io.savemat(p, ARRAYS)),
    "Parquet by pandas": (".parquet", FRAME.to_parquet),
    "Parquet by polars": (".parquet", pl.DataFrame(NAMED).write_parquet),
    "Feather": (".feather", FRAME.to_feather),
    "Excel": (".xlsx", workbook),
    "TDMS": (".tdms", tdms),
    "TDMS by another name": (".bin", tdms),
    "HDF5": (".h5", hdf5),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_values_and_units_come_back(name, tmp_path):
    suffix, write = WRITTEN[name]
    path = tmp_path / f"run{suffix}"
    write(path)
    source = opened(path)
    units = {column.quantity: column.unit for column in source.columns}
    assert units == {"time": "s", "voltage": "V", "displacement": "um"}
    read_back = read(source)
    for column, values in zip(source.columns, read_back.values(), strict=True):
        expected = {"s": T, "V": V, "um": D}[str(column.unit)]
        np.testing.assert_array_equal(values, expected)
        assert values.dtype == np.float64


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_matrix_is_read_along_its_longer_axis(tmp_path, order, turned):
    table = np.random.default_rng(0).normal(size=(150_000, 3))
    stored = np.asarray(table.T if turned else table, order=order)
    np.save(tmp_path / "a.npy", stored)
    source = opened(tmp_path / "a.npy")
    assert [column.number for column in source.columns] == [1, 2, 3]
    assert max(len(block[0]) for block in source.blocks(source.columns)) <= 65_536
    np.testing.assert_array_equal(np.column_stack(list(read(source).values())), table)


DATES = np.array(STAMPS, dtype="M8[us]")
UTC = pl.Series("t", STAMPS).dt.replace_time_zone("UTC")
TOKYO = UTC.dt.convert_time_zone("Asia/Tokyo")


def stamped_tdms(path):
    columns = {"t": DATES, "v": np.array(V)}
    segments(path, *(nptdms.ChannelObject("g", *each) for each in columns.items()))


@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        (".parquet", pd.DataFrame({"v": V}, index=pd.DatetimeIndex(STAMPS)).to_parquet),
        (".parquet", pl.DataFrame({"t": TOKYO, "v": V}).write_parquet),
        (".npz", lambda path: np.savez(path, t=DATES, v=V)),
        (".tdms", stamped_tdms),
    ],
)
def test_stamps_are_nanoseconds(tmp_path, suffix, write):
    path = tmp_path / f"run{suffix}"
    write(path)
    source = opened(path)
    (column,) = [column for column in source.columns if column.kind == "stamp"]
    stamps = read(source)[column.name]
    assert stamps.dtype == np.int64
    np.testing.assert_array_equal(stamps, FIRST + 1_000_000 * np.arange(4))


def test_rates_that_files_state(tmp_path):
    np.savez(tmp_path / "a.npz", voltage_V=V, sample_rate_kHz=2.0)
    columns = {"A": np.array([V]).T, "Tinterval": 0.0005, "Tstart": -0.001}
    scipy.io.savemat(tmp_path / "a.mat", columns)
    timing = {"wf_increment": 0.0005, "wf_start_offset": -0.001}
    segments(tmp_path / "a.tdms", nptdms.ChannelObject("g", "v", np.array(V), timing))
    starts = {"a.npz": 0.0, "a.mat": -0.001, "a.tdms": -0.001}
    for name, start in starts.items():
        source = opened(tmp_path / name)
        assert stated_rate(name, source.settings)[:2] == (2000.0, start)
        assert len(source.columns) == 1
        source.close()


def test_parts_are_chosen_or_asked_for(tmp_path):
    with pd.ExcelWriter(tmp_path / "a.xlsx") as book:
        for sheet, values in (("Run 1", V), ("Run 2", D)):
            frame = pd.DataFrame({"t_s": T, "u": values})
            frame.to_excel(book, sheet_name=sheet, index=False)
    with pytest.raises(InputError, match=r"Run 1, Run 2.*a\.xlsx::Run 1"):
        opened(tmp_path / "a.xlsx")
    np.testing.assert_array_equal(read(opened(tmp_path / "a.xlsx", "Run 2"))["u"], D)
    with pytest.raises(InputError, match="Run 1, Run 2"):
        opened(tmp_path / "a.xlsx", "Run 3")
    FRAME.to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="no parts"):
        opened(tmp_path / "a.parquet", "x")


ON = np.array([True, False, True, True])
SWITCHED = pd.DataFrame({"time_s": T, "voltage_V": ON})


def switched_hdf5(path):
    with h5py.File(path, "w") as file:
        file.update({"time_s": T, "voltage_V": ON})


@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        (".npy", lambda p: np.save(p, SWITCHED.to_records(index=False))),
        (".mat", lambda p: scipy.io.savemat(p, {"time_s": T, "voltage_V": ON})),
        (".parquet", SWITCHED.to_parquet),
        (".h5", switched_hdf5),
        (".tdms", lambda p: segments(p, nptdms.ChannelObject("g", "voltage_V", ON))),
    ],
)
def test_truth_values_are_no_numbers(suffix, write, tmp_path):
    path = tmp_path / f"run{suffix}"
    write(path)
    roles = {"voltage": "voltage_V"}
    with pytest.raises(InputError, match=r"voltage_V|no columns of numbers"):
        open_log(path, roles)


def test_a_truth_value_in_a_workbook_or_among_objects_is_no_number(tmp_path):
    cells = [0.5, True, 1.5, 2.0]
    frame = pd.DataFrame({"time_s": T, "voltage_V": pd.Series(cells, dtype=object)})
    frame.to_excel(tmp_path / "a.xlsx", index=False)
    with (
        pytest.raises(InputError, match=r"a\.xlsx:3: column 'voltage_V' .* 'true'"),
        open_log(tmp_path / "a.xlsx", {"voltage": None}) as log,
    ):
        log.read()
    for odd in (True, np.True_, 1j):
        frame["voltage_V"] = pd.Series([0.5, odd, 1.5, 2.0], dtype=object)
        with pytest.raises(InputError, match="which column is voltage"):
            open_log(frame_table(frame), {"voltage": None})


def test_a_cell_of_a_workbook_keeps_all_its_digits(tmp_path):
    values = [0.1, 3.333333333333333e-08, -2.5, 123456.789012345]
    pd.DataFrame({"t_s": T, "u": values}).to_excel(tmp_path / "a.xlsx", index=False)
    np.testing.assert_array_equal(read(opened(tmp_path / "a.xlsx"))["u"], values)


# --- refusals ---


class Explosive:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_pickles_are_never_loaded(tmp_path):
    trap = Explosive(tmp_path / "exploded")
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(trap))
    (tmp_path / "b.bin").write_bytes(pickle.dumps(trap))
    np.save(tmp_path / "c.npy", np.array([trap], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "d.npz", a=np.array([trap], dtype=object))
    for name in ("a.pkl", "b.bin", "c.npy", "d.npz"):
        with pytest.raises(InputError, match=r"Parquet|allow_pickle|Python objects"):
            read(opened(tmp_path / name))
    assert not (tmp_path / "exploded").exists()


def test_a_library_that_is_absent_is_named(tmp_path, monkeypatch):
    importing = importlib.import_module

    def absent(name):
        if name in ("nptdms", "fastexcel"):
            raise ImportError(name)
        return importing(name)

    tdms(tmp_path / "a.tdms")
    workbook(tmp_path / "a.xlsx")
    monkeypatch.setattr(fence.importlib, "import_module", absent)
    for name, extra in (("a.tdms", "tdms"), ("a.xlsx", "excel")):
        with pytest.raises(InputError, match=rf"pip install 'dbo-cli\[{extra}\]'"):
            opened(tmp_path / name)


def test_a_reader_of_another_package_joins(tmp_path, monkeypatch):
    path = tmp_path / "a.npy"
    np.save(path, np.array(V))

    class Point:
        def load(self):
            return npy.read_npy

    def entry_points(group, name):
        return [Point()] if (group, name) == ("dbo_cli.readers", ".xyz") else []

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    assert reader_of("run.xyz", b"anything") is npy.read_npy
    assert reader_of("run.abc", b"anything") is None


@pytest.mark.parametrize(
    "name", [name for name in WRITTEN if name != "TDMS by another name"]
)
def test_damaged_files_end_in_one_line(name, tmp_path, capfd):
    """And polars, which panics at some of them, tells nothing of that on standard error."""
    suffix, write = WRITTEN[name]
    path = tmp_path / f"run{suffix}"
    write(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(7)
    for number in range(24):
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
    assert capfd.readouterr().err == ""


def test_a_parquet_file_without_columns_is_refused(tmp_path):
    pl.DataFrame().write_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="no columns of numbers"):
        opened(tmp_path / "a.parquet")
