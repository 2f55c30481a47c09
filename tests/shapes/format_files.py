"""Files in the formats of libraries and instruments: who writes them, and what must come of reading them.

What a library writes is written by that library; what an instrument writes is written by hand after its maker's
manual or files published with it.  The table in ``docs/instruments-formats.md`` is made from these lists (``tests/shapes/format_table.py``).
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dbo_cli.logs.request import ReadingOptions

V = (0.0, 1.5, -2.5, 4.0)
D = (10.25, 11.0, 9.125, 8.0)
T = (0.0, 0.001, 0.002, 0.003)
HAND = "by hand"


@dataclass(frozen=True)
class FormatFile:
    """A file and what reading it gives: the samples, or the words of a refusal (without the file's name)."""

    name: str
    writer: str  # the library that writes it, or HAND and after what
    ending: str
    write: Callable[[Path], None]
    group: str = ""
    ask: dict[str, str] = field(default_factory=dict)
    sample_rate: float | None = None
    units: tuple[str | None, str | None] = ("V", "um")
    time: tuple[float, ...] | None = T
    voltage: tuple[float, ...] = V
    displacement: tuple[float, ...] = D
    notes: tuple[str, ...] = ()  # after the file's name
    refusal: str = ""
    block_rows: int = 1 << 16

    @property
    def options(self) -> ReadingOptions:
        time = self.ask.get("time")
        return ReadingOptions(sample_rate=self.sample_rate, time=time, block_rows=self.block_rows)


def frame(**more: Any) -> Any:
    import pandas

    return pandas.DataFrame({"time_s": T, "voltage_V": V, "displacement_um": D} | more)


def stamped_frame() -> Any:
    import pandas

    stamps = pandas.to_datetime([f"2026-01-02T03:04:05.{n:03d}" for n in range(4)])
    return pandas.DataFrame({"voltage_V": V, "displacement_um": D}, index=stamps)


def hdf5(fill: Callable[[Any], None]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import h5py

        with h5py.File(path, "w") as file:
            fill(file)

    return write


def text(*lines: str, end: str = "\r\n", encoding: str = "utf-8") -> Callable[[Path], None]:
    return lambda path: Path(path).write_bytes((end.join(lines) + end).encode(encoding)) and None


def mat(variables: dict[str, Any], **more: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import scipy.io

        scipy.io.savemat(path, variables, **more)

    return write


def rows(mark: str = ",", columns: tuple[Any, ...] = (T, V, D), tail: str = "") -> list[str]:
    return [mark.join(f"{value:.6g}" for value in row) + tail for row in zip(*columns, strict=True)]


# --- what libraries write ---


def numpy_file(array: Any) -> Callable[[Path], None]:
    return lambda path: np.save(path, array, allow_pickle=True)


def numpy_archive(**arrays: Any) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **arrays)


def parquet(make: Callable[[], Any], **more: Any) -> Callable[[Path], None]:
    return lambda path: make().to_parquet(path, **more)


def frame_with_attributes() -> Any:
    table = frame().rename(columns={"voltage_V": "voltage", "displacement_um": "displacement"})
    table = table.drop(columns="time_s")
    table.attrs = {"units": {"voltage": "V", "displacement": "µm"}, "sample_rate": 1000.0, "sample_rate_unit": "Hz"}
    return table


def polars_stamps(path: Path) -> None:
    import polars

    stamps = polars.Series("time", [1_767_323_045_000_000 + 1000 * n for n in range(4)], dtype=polars.Int64)
    table = polars.DataFrame({"time": stamps.cast(polars.Datetime("us")), "voltage_V": V, "displacement_um": D})
    table.write_ipc(path)


def excel(*head: list[Any], columns: tuple[Any, ...] = (T, V, D), sheets: int = 1) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import openpyxl

        book = openpyxl.Workbook()
        for number in range(sheets):
            sheet = book.active if number == 0 else book.create_sheet()
            sheet.title = f"Run {number + 1}"
            for cells in [*head, *zip(*columns, strict=True)]:
                sheet.append(list(cells))
        book.create_sheet("Remarks").append(["bench 4"])
        book.save(path)

    return write


def tdms(path: Path, groups: dict[str, dict[str, tuple[Any, dict[str, Any]]]], root: dict[str, Any] | None = None) -> None:
    import nptdms

    objects: list[Any] = [nptdms.RootObject(root or {})]
    for group, channels in groups.items():
        for name, (values, properties) in channels.items():
            objects.append(nptdms.ChannelObject(group, name, np.array(values), properties))
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(objects)


def tdms_waveforms(path: Path) -> None:
    timing = {"wf_increment": 0.001, "wf_start_offset": 0.0, "wf_xunit_string": "s", "wf_xname": "Time"}
    tdms(path, {"Run": {"Voltage": (V, timing | {"unit_string": "V"}), "Position": (D, timing | {"unit_string": "µm"})}})


def tdms_two_rates(path: Path) -> None:
    slow, fast = {"wf_increment": 0.002}, {"wf_increment": 0.001}
    tdms(path, {"Drive": {"Voltage": (V, slow)}, "Sensor": {"Position": (D, fast)}})


def tdms_time(path: Path) -> None:
    tdms(path, {"Run": {"Time": (T, {"unit_string": "s"}), "Voltage": (V, {"unit_string": "V"}),
                        "Position": (D, {"NI_UnitDescription": "um"})}})  # fmt: skip


def dataset(scaled: bool = False) -> Any:
    import xarray

    table = xarray.Dataset(
        {"voltage": ("time", list(V), {"units": "V"}), "displacement": ("time", list(D), {"units": "um"})},
        coords={"time": ("time", list(T), {"units": "s"})},
    )
    return table


PACKED = {"displacement": {"dtype": "int16", "scale_factor": 0.125, "add_offset": 10.0, "_FillValue": -32768}}


def netcdf(engine: str) -> Callable[[Path], None]:
    return lambda path: dataset().to_netcdf(path, engine=engine, encoding=PACKED) and None


def netcdf_rows(path: Path) -> None:
    """Write a table whose dimension has no variable: HDF5 shows one full of zeros."""
    table = dataset().drop_vars("time").rename_dims(time="row")
    table.attrs = {"sample_rate": 1.0, "sample_rate_units": "kHz"}
    table.to_netcdf(path, engine="netcdf4")


def nexus(path: Path) -> None:
    import nexusformat.nexus as nx

    voltage = nx.NXfield(V, name="voltage", units="V")
    position = nx.NXfield(D, name="displacement", units="um")
    time = nx.NXfield(T, name="time", units="s")
    other = nx.NXdata(nx.NXfield(np.zeros(7), name="counts"), nx.NXfield(np.arange(7.0), name="time", units="s"))
    entry = nx.NXentry(other=other, data=nx.NXdata(position, time, voltage=voltage))
    root = nx.NXroot(entry)
    root.attrs["default"], entry.attrs["default"] = "entry", "data"
    root.save(str(path), mode="w")


def nexus_logs(file: Any) -> None:
    """One NXlog a signal, as beamlines record sample environment."""
    file.attrs["NX_class"] = "NXroot"
    entry = file.create_group("entry")
    entry.attrs["NX_class"] = "NXentry"
    for name, values, unit in (("voltage", V, "V"), ("displacement", D, "um")):
        log = entry.create_group(name)
        log.attrs["NX_class"] = "NXlog"
        log["value"], log["time"] = values, T
        log["value"].attrs["units"], log["time"].attrs["units"] = unit, "s"


def bluesky(shift: float) -> Callable[[Any], None]:
    """The streams of apstools' NeXus writer: value, time and EPOCH by signal."""

    def fill(file: Any) -> None:
        primary = file.create_group("entry/instrument/bluesky/streams/primary")
        for number, (name, values, unit) in enumerate((("voltage", V, "V"), ("displacement", D, "um"))):
            signal = primary.create_group(name)
            signal["value"] = values
            signal["value"].attrs["units"] = unit
            signal["time"] = np.array(T) + number * shift
            signal["EPOCH"] = 1.7e9 + np.array(T) + number * shift

    return fill


def labone(base: bool) -> Callable[[Any], None]:
    """LabOne's HDF5: stamps in ticks of the instrument's clock (60 MHz here)."""

    def fill(file: Any) -> None:
        sample = file.create_group("000/dev4321/demods/0/sample")
        sample["timestamp"] = np.array([60_000 * n for n in range(4)], dtype=np.uint64)
        sample["auxin0"], sample["x"], sample["y"] = V, D, np.zeros(4)
        sample["auxin0"].attrs["units"], sample["x"].attrs["units"] = "V", "V"
        if base:
            file["000/dev4321/clockbase"] = 60e6

    return fill


def matlab73(fill: Callable[[Any, Callable[..., Any]], None]) -> Callable[[Path], None]:
    """A file as MATLAB's -v7.3 writes it: a user block of 512 bytes, matrices transposed, classes as attributes."""

    def write(path: Path) -> None:
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:

            def put(group: Any, name: str, values: Any, kind: str = "double") -> Any:
                group[name] = values
                group[name].attrs["MATLAB_class"] = np.bytes_(kind.encode())
                return group[name]

            fill(file, put)
        with open(path, "r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")

    return write


def v73_rows(file: Any, put: Callable[..., Any]) -> None:
    for name, values in (("t", T), ("voltage", V), ("displacement", D)):
        put(file, name, np.array(values)[:, None])  # 1 x N in MATLAB
    put(file, "operator", np.array([[78], [46]], dtype=np.uint16), "char")
    put(file, "voltage_unit", np.array([[86]], dtype=np.uint16), "char")
    put(file, "displacement_unit", np.array([[181], [109]], dtype=np.uint16), "char")
    put(file, "empty", np.array([0, 0], dtype=np.uint64)).attrs["MATLAB_empty"] = np.int32(1)


def v73_struct(file: Any, put: Callable[..., Any]) -> None:
    run = file.create_group("run")
    run.attrs["MATLAB_class"] = np.bytes_(b"struct")
    put(run, "voltage", np.array([V]))
    put(run, "displacement", np.array([D]))
    put(run, "note", np.array([[104], [105], [33], [33]], dtype=np.uint16), "char")
    put(file, "Ts", np.array([[0.001]]))


def v73_object(file: Any, put: Callable[..., Any]) -> None:
    put(file, "tt", np.zeros((1, 6), dtype=np.uint32), "timetable").attrs["MATLAB_object_decode"] = np.int32(3)
    file.create_group("#subsystem#")


def scaled(file: Any) -> None:
    file["voltage"], file["displacement"] = np.array(V) / 20, D
    file["voltage"].attrs.update({"units": "V", "scale": 20.0})
    file["displacement"].attrs.update({"units": "um", "fs": "1 kHz"})
    file["voltage"].attrs["fs"] = "1 kHz"


def scale_and_offset(file: Any) -> None:
    file["voltage"], file["displacement"] = V, D
    file["voltage"].attrs.update({"scale": 20.0, "offset": 1.0})


def rate_of(**attributes: Any) -> Callable[[Any], None]:
    def fill(file: Any) -> None:
        file["voltage"], file["displacement"] = V, D
        file["voltage"].attrs["units"], file["displacement"].attrs["units"] = "V", "um"
        file.attrs.update(attributes)

    return fill


def latin_1(file: Any) -> None:
    """Units in Latin-1, in a string type that claims UTF-8, as old LabVIEW and MATLAB programs leave them."""
    import h5py

    file["time_s"], file["voltage_V"], file["displacement"] = T, V, D
    kind = h5py.string_dtype("utf-8", 2)
    file["displacement"].attrs.create("units", np.array(b"\xb5m", dtype="S2"), dtype=kind)


def matrix(file: Any) -> None:
    file["data"] = np.array([V, D]).T


SIMULINK = {
    "simout": {
        "time": np.array([T]).T,
        "signals": np.array(
            [{"values": np.array([V]).T, "label": "voltage_V"}, {"values": np.array([D]).T, "label": "displacement_um"}]
        ),
    }
}
DSPACE = {
    "run1": {
        "X": np.array([{"Name": "time", "Data": np.array(T), "Unit": "s"}]),
        "Y": np.array([{"Name": "Voltage", "Data": np.array(V), "Unit": "V"},
                       {"Name": "Position", "Data": np.array(D), "Unit": "um"}]),
    }
}  # fmt: skip
COLUMNS = {"t": np.array([T]).T, "voltage": np.array([V]).T, "displacement": np.array([D]).T}
STAMPS = tuple(datetime.datetime(2026, 1, 2, 3, 4, 5, 1000 * n) for n in range(4))
STAMPED = tuple(1_767_323_045.0 + 0.001 * n for n in range(4))  # s since 1970
NO_UNITS: tuple[None, None] = (None, None)
PANDAS, XARRAY, SCIPY, H5PY, NUMPY = "pandas", "xarray", "scipy.io.savemat", "h5py", "NumPy"
OBJECTS = (
    "MATLAB objects (table, timetable, timeseries, string) can be taken apart by MATLAB only: save plain vectors, "
    "t, voltage and displacement, with save('run.mat', 't', 'voltage', 'displacement')"
)

LIBRARY_FILES = [
    FormatFile("MATLAB v7, column vectors", SCIPY, ".mat", mat(COLUMNS, do_compression=True), units=NO_UNITS),
    FormatFile("MATLAB v6, row vectors and text", SCIPY, ".mat",
               mat({"t": T, "voltage": V, "displacement": D, "operator": "N. N.", "voltage_unit": "V",
                    "displacement_unit": "um"})),
    FormatFile("MATLAB v4", SCIPY, ".mat", mat(COLUMNS, format="4"), units=NO_UNITS),
    FormatFile("MATLAB, a struct and fs", SCIPY, ".mat",
               mat({"run": {"voltage": V, "displacement": D, "note": "first"}, "fs": 1000.0}), units=NO_UNITS,
               notes=(": 'fs' 1000 has no unit: Hz is assumed",)),
    FormatFile("MATLAB, PicoScope's Tinterval and Tstart", SCIPY, ".mat",
               mat({"A": np.array([V]).T, "B": np.array([D]).T, "Tinterval": 0.001, "Tstart": -0.001}, format="4"),
               ask={"voltage": "A", "displacement": "B"}, time=(-0.001, 0.0, 0.001, 0.002), units=NO_UNITS,
               notes=(": 'Tinterval' 0.001 has no unit: s is assumed",)),
    FormatFile("MATLAB, Simulink's structure with time", SCIPY, ".mat", mat(SIMULINK)),
    FormatFile("MATLAB, dSPACE ControlDesk", SCIPY, ".mat", mat(DSPACE)),
    FormatFile("MATLAB, two structs", SCIPY, ".mat", mat({"a": COLUMNS, "b": COLUMNS}),
               refusal=": columns in 2 structs, a, b: which one? (write {file}::a)"),
    FormatFile("MATLAB, one of two structs", SCIPY, ".mat", mat({"a": COLUMNS, "b": COLUMNS}), group="::b",
               units=NO_UNITS),
    FormatFile("MATLAB, a matrix alone", SCIPY, ".mat", mat({"data": np.array([T, V, D]).T}), units=NO_UNITS,
               ask={"time": "1", "voltage": "2", "displacement": "3"}),
    FormatFile("MATLAB v7.3, row vectors, text, an empty matrix", f"{HAND} (h5py, after MATLAB's own files)", ".mat",
               matlab73(v73_rows)),
    FormatFile("MATLAB v7.3, a struct and Ts", f"{HAND} (h5py, after MATLAB's own files)", ".mat",
               matlab73(v73_struct), units=NO_UNITS, notes=(": 'Ts' 0.001 has no unit: s is assumed",)),
    FormatFile("MATLAB v7.3, a timetable", f"{HAND} (h5py, after MATLAB's own files)", ".mat", matlab73(v73_object),
               refusal=f": no columns of numbers in this group: it has /tt ({OBJECTS})"),
    FormatFile("NumPy, a structured array", NUMPY, ".npy",
               numpy_file(np.array(list(zip(T, V, D, strict=True)),
                                   dtype=[("time_s", "f8"), ("voltage_V", "f8"), ("displacement_um", "f8")]))),
    FormatFile("NumPy, a matrix", NUMPY, ".npy", numpy_file(np.array([T, V, D])), units=NO_UNITS,
               ask={"time": "1", "voltage": "2", "displacement": "3"}),
    FormatFile("NumPy, pickled objects", NUMPY, ".npy", numpy_file(np.array([{"v": 1}, None], dtype=object)),
               refusal=": it holds pickled Python objects, which are not loaded: save arrays of numbers"),
    FormatFile("NumPy, an archive with a rate", NUMPY, ".npz",
               numpy_archive(voltage_V=V, displacement_um=D, sample_rate_kHz=1.0, operator="N. N.")),
    FormatFile("Parquet", f"{PANDAS} (pyarrow)", ".parquet", parquet(frame)),
    FormatFile("Parquet, units and rate in DataFrame.attrs", f"{PANDAS} (pyarrow)", ".parquet",
               parquet(frame_with_attributes)),
    FormatFile("Parquet, an index of time stamps", f"{PANDAS} (pyarrow)", ".parquet", parquet(stamped_frame)),
    FormatFile("Feather", f"{PANDAS} (pyarrow)", ".feather", lambda path: frame().to_feather(path)),
    FormatFile("Arrow with time stamps", "polars", ".arrow", polars_stamps),
    FormatFile("Excel", "openpyxl", ".xlsx", excel(["time_s", "voltage_V", "displacement_um"])),
    FormatFile("Excel, remarks above, a line of units, decimals of every length", "openpyxl", ".xlsx",
               excel(["Bench", 4], [], ["Time", "Voltage", "Displacement"], ["s", "V", "µm"],
                     columns=(T, (0.1, 1e-7 / 3, -2.5, 4.0), D)),
               voltage=(0.1, 3.333333333333333e-08, -2.5, 4.0)),
    FormatFile("Excel, dates and times of day as time", "openpyxl", ".xlsx",
               excel(["Time", "voltage_V", "displacement_um"], columns=(STAMPS, V, D)), time=STAMPED),
    FormatFile("Excel, text among the numbers", "openpyxl", ".xlsx",
               excel(["t_s", "voltage_V", "displacement_um"], columns=(T, (0.0, "off", -2.5, 4.0), D)),
               refusal=":3: column 'voltage_V' is not a number: 'off' (`skip_bad` drops such rows)"),
    FormatFile("Excel, two sheets of numbers", "openpyxl", ".xlsx", excel(["t", "u", "y"], sheets=2),
               refusal=": 2 sheets hold numbers, 'Run 1', 'Run 2': which one? (write {file}::Run 1)"),
    FormatFile("Excel, one of two sheets", "openpyxl", ".xlsx", excel(["t", "u", "y"], sheets=2), group="::Run 2",
               units=NO_UNITS),
    FormatFile("TDMS waveforms", "npTDMS", ".tdms", tdms_waveforms),
    FormatFile("TDMS with a time channel", "npTDMS", ".tdms", tdms_time),
    FormatFile("TDMS, two rates", "npTDMS", ".tdms", tdms_two_rates,
               refusal=": two sample rates are stated, 'wf_increment' 0.002 and 'wf_increment' 0.001: which one "
                       "holds? (`sample_rate` HZ decides)"),
    FormatFile("netCDF-4, packed (scale_factor, add_offset)", f"{XARRAY} (netCDF4)", ".nc", netcdf("netcdf4")),
    FormatFile("netCDF-4, a dimension without a variable, a rate in kHz", f"{XARRAY} (netCDF4)", ".nc", netcdf_rows),
    FormatFile("netCDF-3, packed", f"{XARRAY} (scipy)", ".nc", netcdf("scipy")),
    FormatFile("pandas HDF5, table", f"{PANDAS} (PyTables)", ".h5",
               lambda path: frame().to_hdf(path, key="log", format="table")),
    FormatFile("pandas HDF5, table with data columns", f"{PANDAS} (PyTables)", ".h5",
               lambda path: frame().to_hdf(path, key="log", format="table", data_columns=True)),
    FormatFile("pandas HDF5, table indexed by time", f"{PANDAS} (PyTables)", ".h5",
               lambda path: frame().set_index("time_s").to_hdf(path, key="log", format="table")),
    FormatFile("pandas HDF5, table indexed by time stamps", f"{PANDAS} (PyTables)", ".h5",
               lambda path: stamped_frame().to_hdf(path, key="log", format="table")),
    FormatFile("pandas HDF5, fixed", f"{PANDAS} (PyTables)", ".h5",
               lambda path: frame().to_hdf(path, key="log", format="fixed")),
    FormatFile("pandas HDF5, fixed, indexed by time stamps", f"{PANDAS} (PyTables)", ".h5",
               lambda path: stamped_frame().to_hdf(path, key="log", format="fixed")),
    FormatFile("NeXus, default, signal and axes", "nexusformat", ".nxs", nexus),
    FormatFile("NeXus, one NXlog a signal", f"{HAND} (h5py, after the NeXus manual)", ".nxs", hdf5(nexus_logs)),
    FormatFile("Bluesky streams (apstools' NXWriter)", f"{HAND} (h5py, after apstools' manual)", ".hdf",
               hdf5(bluesky(0.0))),
    FormatFile("Bluesky streams, signals stamped apart", f"{HAND} (h5py, after apstools' manual)", ".hdf",
               hdf5(bluesky(0.0004)),
               refusal=": which column is the time, 'displacement/time' or 'voltage/time'? (choose with `time` NAME "
                       "or NUMBER)"),
    FormatFile("LabOne, with its clock base", f"{HAND} (h5py, after Zurich Instruments' manual)", ".h5",
               hdf5(labone(True)), ask={"time": "timestamp", "voltage": "auxin0", "displacement": "x"},
               units=("V", "V")),
    FormatFile("LabOne, without its clock base", f"{HAND} (h5py, after Zurich Instruments' manual)", ".h5",
               hdf5(labone(False)), ask={"time": "timestamp", "voltage": "auxin0", "displacement": "x"},
               refusal=": the time column 'timestamp' counts 'ticks', which is no known unit of time (`time_unit` s, ms, "
                       "us, ns, ps, min, h, d or a number of them such as 10us, or `sample_rate` HZ)"),
    FormatFile("LabOne, without its clock base, with the rate given",
               f"{HAND} (h5py, after Zurich Instruments' manual)", ".h5", hdf5(labone(False)), sample_rate=1000.0,
               ask={"voltage": "auxin0", "displacement": "x"}, units=("V", "V"),
               notes=(": `sample_rate` replaces the column 'timestamp'",)),
    FormatFile("HDF5, scale and a rate in kHz", H5PY, ".h5", hdf5(scaled),
               notes=(": column 'voltage' is multiplied by its attribute scale, 20",)),
    FormatFile("HDF5, scale and offset", H5PY, ".h5", hdf5(scale_and_offset),
               refusal=": column 'voltage' has the attributes scale 20 and offset 1, and nothing says in which order "
                       "they apply (write scale_factor and add_offset, which mean value · scale_factor + add_offset)"),
    FormatFile("HDF5, a step in ms", H5PY, ".h5", hdf5(rate_of(dt=1.0, dt_units="ms"))),
    FormatFile("HDF5, a rate without a unit", H5PY, ".h5", hdf5(rate_of(sample_rate=1000.0)),
               notes=(": 'sample_rate' 1000 has no unit: Hz is assumed",)),
    FormatFile("HDF5, a rate in an unknown unit", H5PY, ".h5", hdf5(rate_of(sample_rate="10 furlongs")),
               refusal=": 'sample_rate' 10 furlongs is not in a unit of a rate (Hz, kHz, S/s) (`sample_rate` HZ gives "
                       "the rate instead)"),
    FormatFile("HDF5, a rate and a step that disagree", H5PY, ".h5", hdf5(rate_of(fs="1 kHz", dt="2 ms")),
               refusal=": two sample rates are stated, 'dt' 2 ms and 'fs' 1 kHz: which one holds? (`sample_rate` HZ "
                       "decides)"),
    FormatFile("HDF5, units in Latin-1", H5PY, ".h5", hdf5(latin_1)),
    FormatFile("HDF5, a matrix without names", H5PY, ".h5", hdf5(matrix), ask={"voltage": "1", "displacement": "2"},
               units=NO_UNITS, time=None),
]  # fmt: skip
