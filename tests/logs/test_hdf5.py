"""HDF5 logs: what is found, what is refused, and that nothing leads out of the file."""

import os

import h5py
import numpy as np
import pytest

from dbo_cli.errors import InputError
from dbo_cli.logs import open_log
from dbo_cli.logs.columns import named
from dbo_cli.logs.formats.hdf5 import read_hdf5
from dbo_cli.logs.table import Reading

T = np.arange(200.0) / 1000.0
V = np.sin(40.0 * T)
D = np.cos(40.0 * T)


def made(path, fill):
    with h5py.File(path, "w") as file:
        fill(file)
    return path


def opened(path, fill, part=""):
    return read_hdf5(str(made(path / "run.h5", fill)), part, Reading())


def values(source, name):
    (column,) = [column for column in source.columns if column.name == name]
    return np.concatenate([block[0] for block in source.blocks([column])])


def names(source):
    return [column.name for column in source.columns]


COLUMNS = (("time", T, "s"), ("voltage", V, "V"), ("displacement", D, "µm"))
NAMES, UNITS = "time,voltage,displacement", ["s", "V", "um"]


def plain(group, **options):
    for name, array, unit in COLUMNS:
        group.create_dataset(name, data=array, **options)
        group[name].attrs["units"] = unit


def matrix(file):
    file["data"] = np.column_stack([T, V, D])
    file["data"].attrs.update({"columns": NAMES, "units": UNITS})


def wide(file):
    file["data"] = np.vstack([T, V, D])
    file["data"].attrs.update({"columns": NAMES, "units": UNITS})


def compound(file):
    kind = [("time", "f8"), ("voltage", "f4"), ("displacement", "f8"), ("note", "S4")]
    rows = np.zeros(T.size, dtype=kind)
    rows["time"], rows["voltage"], rows["displacement"] = T, V.astype("f4"), D
    file["data"] = rows
    file["data"].attrs["units"] = [*UNITS, ""]


def column_vectors(file):
    for name, array, unit in COLUMNS:
        file[name] = array[:, None]
        file[name].attrs["unit"] = unit


def deeper(file):
    plain(file.create_group("entry/run"))
    file["entry/note"] = "first"
    file["entry/camera/frames"] = np.zeros((4, 3, 3))


def soft_links(file):
    plain(file.create_group("store/raw"))
    for name in ("time", "voltage", "displacement"):
        file[name] = h5py.SoftLink(f"/store/raw/{name}")
    file["gone"] = h5py.SoftLink("/nowhere")
    file["circle"] = h5py.SoftLink("/circle")
    file["store/up"] = file["/"]  # a circle of hard links


@pytest.mark.parametrize(
    "fill", [plain, matrix, wide, compound, column_vectors, deeper, soft_links]
)
def test_columns_names_units_and_values(tmp_path, fill):
    source = opened(tmp_path, fill)
    read = [column for column in source.columns if column.kind == "number"]
    by_name = {column.name: column.unit for column in read}
    assert by_name == {"time": "s", "voltage": "V", "displacement": "um"}
    np.testing.assert_array_equal(values(source, "time"), T)
    np.testing.assert_allclose(values(source, "voltage"), V, atol=1e-7)
    np.testing.assert_array_equal(values(source, "displacement"), D)
    source.close()


def test_parts_and_paths(tmp_path):
    def fill(file):
        plain(file.create_group("a"))
        plain(file.create_group("b/c"))
        file["b/c/voltage"][...] = 2.0 * V
        file["b/camera/voltage"] = V[:50]

    source = opened(tmp_path, fill)
    assert names(source) == ["displacement", "time", "voltage"]  # the shallowest's
    assert source.find("b/c/voltage") is not None
    np.testing.assert_array_equal(values(source, "b/c/voltage"), 2.0 * V)
    assert source.find("/b/c/time") is not None
    assert source.find("/b/none") is None
    source.close()
    for part in ("b/c", "/b/c/"):
        source = read_hdf5(str(tmp_path / "run.h5"), part, Reading())
        np.testing.assert_array_equal(values(source, "voltage"), 2.0 * V)
        source.close()
    source = read_hdf5(str(tmp_path / "run.h5"), "b/c/voltage", Reading())
    assert names(source) == ["voltage"]
    source.close()
    with pytest.raises(InputError, match=r"::x: .*/a/voltage"):
        read_hdf5(str(tmp_path / "run.h5"), "x", Reading())


def test_a_rate_in_an_attribute_is_no_clock(tmp_path):
    def fill(file):
        file.attrs["sample_rate"] = 2000.0
        file["run/voltage"], file["run/displacement"], file["run/fs"] = V, D, 3000.0

    path = str(made(tmp_path / "run.h5", fill))
    with open_log(path, {"voltage": None}) as log:
        assert log.read().time is None
        assert "no clock" in log.line()
    with open_log(path, {"voltage": None}, Reading(sample_rate=2000.0)) as log:
        assert log.read().dt == 1.0 / 2000.0


def test_groups_side_by_side(tmp_path):
    """A single value is no column; unlike lengths are refused."""

    def fill(file):
        plain(file.create_group("run1"))
        plain(file.create_group("run2"))
        file["run1/short"], file["run1/fs"], file["run1/count"] = V[:-1], 4000.0, 3

    source = opened(tmp_path, fill)
    assert {"run1/voltage", "run2/voltage", "run1/short"} < set(names(source))
    assert not {"fs", "count"} & set(names(source))
    assert "run.h5::run1" in source.hint
    with pytest.raises(InputError, match=r"unequal length.*199|unequal length"):
        list(source.blocks(source.columns))
    source.close()


def test_a_missing_number_may_be_rounded(tmp_path):
    def fill(file):
        file["x"] = np.array([1.0, 1e20, 3.0], dtype="f4")
        file["x"].attrs["missing_value"] = 1e20

    source = opened(tmp_path, fill)
    np.testing.assert_array_equal(values(source, "x"), [1.0, np.nan, 3.0])
    source.close()


def test_a_scale_for_each_column_is_not_passed_over(tmp_path):
    def fill(file):
        matrix(file)
        file["data"].attrs["scale_factor"] = [1.0, 20.0, 1.0]

    path = str(made(tmp_path / "run.h5", fill))
    with pytest.raises(InputError, match=r"scale_factor.*`scale` voltage=FACTOR"):
        open_log(path, {"voltage": None}, Reading(sample_rate=10.0))


def test_a_unit_that_is_stated_twice_is_stated_alike(tmp_path):
    def fill(file):
        for name, unit in (("t_ms", "s"), ("voltage_mV", "V"), ("x_um", "um")):
            file[name] = T
            file[name].attrs["units"] = unit

    path, rate = str(made(tmp_path / "run.h5", fill)), Reading(sample_rate=10.0)
    roles = {"voltage": None, "displacement": None}
    advice = r"'voltage_mV' is in mV by its name, in V beside it: .*1UNIT/V"
    with pytest.raises(InputError, match=advice):
        open_log(path, roles, rate)
    for unit in ("mV", "V"):
        reading = Reading(sample_rate=10.0, scale={"voltage": f"1{unit}/V"})
        with open_log(path, roles, reading) as log:
            assert log.columns["voltage"].unit == unit
            np.testing.assert_array_equal(log.read()["voltage"], T)
    with pytest.raises(InputError, match=r"'t_ms', is in ms by its name.*`time_unit`"):
        open_log(path, {"time": None, "displacement": None})
    reading = Reading(time_unit="ms")
    with open_log(path, {"time": None, "displacement": None}, reading) as log:
        np.testing.assert_allclose(log.read().time, T / 1000.0)


@pytest.mark.parametrize("units", [["V", "um"], ["s", "V", "um", "V"]])
def test_units_of_a_matrix_are_as_many_as_its_columns(tmp_path, units):
    def fill(file):
        matrix(file)
        file["data"].attrs["units"] = units

    path, roles = str(made(tmp_path / "run.h5", fill)), {"displacement": None}
    with pytest.raises(InputError, match=r"one of the units .*V, um.*`scale`"):
        open_log(path, roles, Reading(sample_rate=10.0))
    reading = Reading(sample_rate=10.0, scale={"displacement": "1um/um"})
    with open_log(path, roles, reading) as log:
        assert log.columns["displacement"].unit == "um"


def test_two_attributes_that_state_another_unit_are_refused(tmp_path):
    def fill(file):
        plain(file)
        file["voltage"].attrs["unit"] = "mV"

    path = str(made(tmp_path / "run.h5", fill))
    with pytest.raises(InputError, match=r"one of the units mV, V: .*`scale` voltage"):
        open_log(path, {"voltage": None})


def test_a_scale_beside_a_dataset_is_not_passed_over(tmp_path):
    def fill(file):
        file["x"], file["x_scaling_factor"] = np.arange(3.0), 0.001
        file["y"] = np.array([0, -32768, 2], dtype="i2")
        file["y"].attrs["missing_value"] = np.int16(-32768)
        file["z"] = np.array([0, 100, -1], dtype="i2")
        file["z"].attrs.update({"conversion": 0.001, "_FillValue": -1})
        for key in keys:
            file[key] = np.arange(3.0)
            file[key].attrs[key] = 2.0

    keys = ("scale_factor", "Scale", "Scale Factor", "GAIN", "slope", "intercept")
    source = opened(tmp_path, fill)
    np.testing.assert_array_equal(values(source, "y"), [0.0, np.nan, 2.0])
    source.close()
    path = str(tmp_path / "run.h5")
    pairs = {"x": "x_scaling_factor", "z": "conversion"} | {key: key for key in keys}
    for name, key in pairs.items():
        with pytest.raises(InputError, match=f"{key}.*`scale` voltage=FACTOR"):
            open_log(path, {"voltage": name})
        with pytest.raises(InputError, match=f"{key}.*`time_unit`"):
            open_log(path, {"voltage": "y", "time": name})
    scaled = Reading(scale={"voltage": "0.125"}, skip_bad=True)
    with open_log(path, {"voltage": "z"}, scaled) as log:
        np.testing.assert_array_equal(log.read()["voltage"], [0.0, 12.5])


# --- what leads out of the file ---


def secret(folder):
    return made(folder / "secret.h5", plain)


def external_link(file, other):
    file["voltage"] = h5py.ExternalLink(str(other), "/voltage")


def virtual(file, other):
    layout = h5py.VirtualLayout(shape=(T.size,), dtype="f8")
    layout[:] = h5py.VirtualSource(str(other), "voltage", shape=(T.size,))
    file.create_virtual_dataset("voltage", layout)


def external_storage(file, other):
    file.create_dataset(
        "voltage", (T.size,), "f8", external=[(str(other), 0, 8 * T.size)]
    )


@pytest.mark.parametrize("fill", [external_link, virtual, external_storage])
def test_no_other_file_is_read(tmp_path, fill, monkeypatch):
    other = secret(tmp_path)

    def both(file):
        fill(file, other)
        file["displacement"], file["time"] = D, T

    path = made(tmp_path / "run.h5", both)
    os.truncate(other, 0)  # whoever opens it fails otherwise than by a refusal
    with pytest.raises(InputError, match=r"other file|not one column"):
        source = read_hdf5(str(path), "", Reading())
        list(source.blocks([named(source, "voltage", "voltage")]))


@pytest.mark.parametrize("part", ["run", "/run/voltage", "soft"])
def test_a_part_behind_a_link_is_refused(tmp_path, part):
    def fill(file):
        file["run"] = h5py.ExternalLink(str(secret(tmp_path)), "/")
        file["soft"] = h5py.SoftLink("/run/voltage")

    with pytest.raises(InputError, match=r"or a link"):
        opened(tmp_path, fill, part)


def test_a_file_with_none_of_the_optional_columns_is_refused(tmp_path):
    def fill(file):
        file["temperature"] = T

    path = str(made(tmp_path / "run.h5", fill))
    with open_log(path, {"voltage": None}, optional=("voltage",)) as log:
        with pytest.raises(InputError, match="none of its"):
            log.read()
