"""HDF5 logs: groups, compound datasets, matrices either way round, MATLAB's files, and what is refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbo_cli.errors import InputError, OutputError
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.hdf5.store import shuffled_deflated
from dbo_cli.logs.request import ReadingOptions
from dbo_cli.logs.sample_block import Column
from dbo_cli.logs.signal_log import SignalLog, open_log
from dbo_cli.logs.signal_writer import signal_writer

V = [0.0, 1.5, -2.5, 4.0]
D = [10.25, 11.0, 9.125, 8.0]
T = [0.0, 0.001, 0.002, 0.003]
TABLE = np.array([T, V, D])


def opened(
    path: Path | str,
    voltage: str | None = None,
    displacement: str | None = None,
    **more: Any,
) -> SignalLog:
    want = {
        "voltage": ColumnWish(voltage, ("voltage", "drive", "u"), option="voltage"),
        "displacement": ColumnWish(
            displacement, ("displacement", "position", "y"), option="displacement"
        ),
    }
    return open_log(str(path), want, ReadingOptions(**more))


def plain(file: Any) -> None:
    file["time_s"], file["voltage"], file["displacement"] = T, V, D
    file["voltage"].attrs["units"] = "V"
    file["displacement"].attrs["units"] = b"\xc2\xb5m"


def compound(file: Any) -> None:
    kind = [("time", "f8"), ("voltage", "f4"), ("displacement", "f8"), ("remark", "S4")]
    rows = [(t, v, d, b"ok") for t, v, d in zip(T, V, D, strict=True)]
    file["log"] = np.array(rows, dtype=kind)
    file["log"].attrs["units"] = ["s", "V", "um", ""]


def tall(file: Any) -> None:
    file["data"] = TABLE.T
    file["data"].attrs["columns"] = ["time", "voltage", "displacement"]
    file["data"].attrs["units"] = "s,V,um"


def wide(file: Any) -> None:
    file["data"] = np.array(TABLE)
    file["data"].attrs["columns"] = np.array([b"time", b"voltage", b"displacement"])
    file["data"].attrs["units"] = np.array([b"s", b"V", b"um"])


def matlab(file: Any) -> None:
    """Column vectors are stored as 1 x N, scalars as 1 x 1."""
    for name, values in (("t", T), ("u", V), ("y", D)):
        file[name] = np.array([values])
        file[name].attrs["MATLAB_class"] = np.bytes_(b"double")
        file[name].attrs["units"] = {"t": "s", "u": "V", "y": "microns"}[name]
    file["fs"] = np.array([[1000.0]])
    file["note"] = np.array([[104], [105]], dtype=np.uint16)


def grouped(file: Any) -> None:
    plain(file.require_group("run/first"))
    file["run/first"].attrs["sample_rate"] = 5.0


def squeezed(file: Any) -> None:
    for name, values, unit in (
        ("time_s", T, "s"),
        ("drive", V, "V"),
        ("position", D, "um"),
    ):
        data = file.create_dataset(
            name,
            data=values,
            chunks=(3,),
            compression="gzip",
            shuffle=True,
            fletcher32=True,
        )
        data.attrs["unit"] = unit


def whole_numbers(file: Any) -> None:
    file["time_s"] = T
    file["voltage_V"] = np.array([v * 2 for v in V], dtype=np.int16)
    file["displacement_um"] = np.array(D, dtype=">f8")


SHAPES: dict[str, tuple[Callable[[Any], None], str]] = {
    "datasets of the root": (plain, ""),
    "fields of a compound dataset": (compound, ""),
    "fields of a compound dataset, addressed": (compound, "::/log"),
    "columns of a matrix": (tall, "::/data"),
    "rows of a matrix": (wide, "::data"),
    "a matrix alone in the file": (wide, ""),
    "MATLAB v7.3": (matlab, ""),
    "a group": (grouped, "::/run/first"),
    "a group with one group inside": (grouped, "::/run"),
    "chunked and compressed": (squeezed, ""),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("block_rows", [1, 3, 1 << 18])
def test_shape_reads_right(name: str, block_rows: int, tmp_path: Path) -> None:
    fill, group = SHAPES[name]
    path = tmp_path / ("log.mat" if fill is matlab else "log.h5")
    with h5py.File(path, "w") as file:
        fill(file)
    with opened(f"{path}{group}", block_rows=block_rows) as log:
        block = log.read()
    assert block.values["voltage"].tolist() == V
    assert block.values["displacement"].tolist() == D
    assert block.time is not None
    assert block.time.tolist() == T
    assert (log.columns["voltage"].unit, log.columns["displacement"].unit) == (
        "V",
        "um",
    )
    assert list(block.rows) == [1, 2, 3, 4]
    assert block.lines is None


def test_other_number_types(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        whole_numbers(file)
    with opened(tmp_path / "log.h5") as log:
        assert log.read().values["voltage"].tolist() == [0.0, 3.0, -5.0, 8.0]


@pytest.mark.parametrize("group", ["run/2024", "raw"])
def test_a_column_by_its_path(group: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        plain(file)
        file[f"{group}/sensor"] = np.array(D) * 2
    for path in (f"/{group}/sensor", f"{group}/sensor"):
        with opened(tmp_path / "log.h5", displacement=path) as log:
            assert log.read().values["displacement"].tolist() == [2 * d for d in D]


def test_the_sample_rate_of_an_attribute(tmp_path: Path) -> None:
    for attribute, value, rate in (
        ("sample_rate", 500.0, 500.0),
        ("Fs", 200, 200.0),
        ("dt", 0.01, 100.0),
    ):
        with h5py.File(tmp_path / "log.h5", "w") as file:
            file["voltage"], file["displacement"] = V, D
            file.attrs[attribute] = value
        with opened(tmp_path / "log.h5") as log:
            block = log.read()
            assert log.sample_rate == rate
        assert block.time is not None
        assert block.time[1] == pytest.approx(1 / rate, rel=1e-15)
        # what the user says goes first
        with opened(tmp_path / "log.h5", sample_rate=8.0, rows=(2, 3)) as log:
            block = log.read()
        assert block.time is not None
        assert block.time.tolist() == [0.125, 0.25]


def test_an_hdf5_file_of_another_name(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.dat", "w") as file:
        plain(file)
    with opened(tmp_path / "log.dat") as log:
        assert log.read().values["voltage"].tolist() == V


def test_bad_values_are_refused_or_dropped(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["voltage"], file["displacement"] = [1.0, np.nan, 3.0, np.inf], D
    for block_rows in (1, 2, 100):
        with (
            pytest.raises(InputError) as raised,
            opened(path, block_rows=block_rows) as log,
        ):
            log.read()
        assert (
            str(raised.value)
            == f"{path}: row 2: column 'voltage' is not finite: 'nan' (`skip_bad` drops such rows)"
        )
        with opened(path, skip_bad=True, block_rows=block_rows) as log:
            block = log.read()
        assert block.values["voltage"].tolist() == [1.0, 3.0]
        assert list(block.rows) == [1, 3]
        assert log.notes == [
            f"{path}: row 2: column 'voltage' is not finite: 'nan' and 1 more: 2 rows dropped"
        ]


def unequal(file: Any) -> None:
    file["voltage"], file["displacement"] = V, D[:3]


def words(file: Any) -> None:
    file["remark"] = ["a", "b"]


def nothing(file: Any) -> None:
    file.attrs["owner"] = "bench 4"


def cube(file: Any) -> None:
    file["data"] = np.zeros((2, 3, 4))


def twins(file: Any) -> None:
    plain(file.require_group("a"))
    plain(file.require_group("b"))


def camera(file: Any) -> None:
    for name, columns in (
        ("camera", ("frame", "exposure")),
        ("piezo", ("drive", "interferometer")),
    ):
        for column in columns:
            file[f"{name}/{column}"] = np.arange(4.0)


def dangling(file: Any) -> None:
    file["voltage"] = h5py.SoftLink("/nowhere")


REFUSALS: dict[str, tuple[Callable[[Any], None], str, str]] = {
    "columns of unequal length": (
        unequal, "", "{log}: the columns are of unequal length: 'voltage' 4, 'displacement' 3"),
    "no such group": (
        plain, "::/run", "{log}::/run: there is no group '/run': it has /displacement, /time_s, /voltage"),
    "words alone": (words, "", "{log}: no columns of numbers in this group: it has /remark"),
    "an empty file": (nothing, "", "{log}: no columns of numbers in this group: it is empty"),
    "three dimensions": (cube, "", "{log}: no columns of numbers in this group: it has /data"),
    "three dimensions, addressed": (
        cube, "::/data", "{log}::/data: this dataset holds no columns of numbers (2x3x4, float64)"),
    "two groups": (
        twins, "", "{log}: no columns of numbers in this group: it has /a/displacement, /a/time_s, "
        "/a/voltage, /b/displacement, /b/time_s, /b/voltage (write {log}::/a for the first of 2 tables)"),
    "a camera beside a drive": (
        camera, "", "{log}: no columns of numbers in this group: it has /camera/exposure, /camera/frame, "
        "/piezo/drive, /piezo/interferometer (write {log}::/piezo)"),
    "a link that leads nowhere": (dangling, "", "{log}: no columns of numbers in this group: it is empty"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSALS)
def test_refusal_is_told_exactly(name: str, tmp_path: Path) -> None:
    fill, group, message = REFUSALS[name]
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        fill(file)
    with pytest.raises(InputError) as raised, opened(f"{path}{group}") as log:
        log.read()
    assert str(raised.value) == message.replace("{log}", str(path))


def test_a_dataset_without_numbers_can_not_be_asked_for(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        plain(file)
        file["remark"] = ["a"] * 4
    with (
        pytest.raises(InputError) as raised,
        opened(tmp_path / "log.h5", voltage="remark"),
    ):
        pass
    assert str(raised.value) == (
        f"{tmp_path}/log.h5: there is no column 'remark': it has 1 displacement, 2 time_s, 3 voltage"
    )


def test_files_that_are_cut_off_or_absent(tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        opened(tmp_path / "none.h5")
    assert str(raised.value) == f"{tmp_path}/none.h5: no such file"
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        plain(file)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError) as raised:
        opened(path)
    assert str(raised.value).startswith(
        f"{path}: cannot be read as HDF5: truncated file"
    )
    with pytest.raises(InputError) as raised:
        opened("-", format="hdf5")
    assert (
        str(raised.value)
        == "standard input: HDF5 cannot be read from a pipe: give the file's name"
    )


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 70_000))
def test_chunks_put_together_by_hand_are_what_hdf5_undoes(seed: int, rows: int) -> None:
    random = np.random.default_rng(seed)
    values = random.choice(
        [
            random.normal(size=rows),
            np.arange(rows) / 2000,
            np.round(random.normal(size=rows), 2),
            np.zeros(rows),
        ]
    )
    with h5py.File("chunk", "w", driver="core", backing_store=False) as file:
        data = file.create_dataset(
            "x",
            shape=(rows,),
            chunks=(rows,),
            dtype="<f8",
            compression="gzip",
            shuffle=True,
        )
        data.id.write_direct_chunk((0,), shuffled_deflated(values))
        assert data[()].tobytes() == values.tobytes()


def test_a_group_is_added_to_a_file_and_nothing_else_in_it_is_lost(
    tmp_path: Path,
) -> None:
    path = tmp_path / "bench.h5"
    with h5py.File(path, "w") as file:
        file["run/A"] = np.arange(5.0)
        file.create_group("new")
    for value in (1.0, 2.0):  # the second replaces the group, whole
        with signal_writer(f"{path}::/new", [Column("time", "s")]) as writer:
            writer.write(np.full(4, value))
    with h5py.File(path) as file:
        assert file["run/A"][:].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert list(file["new"]) == ["time_s"]
        assert file["new/time_s"][:].tolist() == [2.0] * 4
    before = path.read_bytes()
    with (
        pytest.raises(RuntimeError),
        signal_writer(f"{path}::/new", [Column("time", "s")]) as writer,
    ):
        writer.write(np.zeros(9))
        raise RuntimeError
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["bench.h5"]
    (tmp_path / "text.h5").write_text("no HDF5")
    with (
        pytest.raises(
            OutputError,
            match=r"text\.h5: this is no HDF5 file, so no group can be added to it",
        ),
        signal_writer(f"{tmp_path / 'text.h5'}::/new", [Column("time", "s")]),
    ):
        pass
