"""Files that people bring from laboratories: what programs for experiments, data bases and small boards write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tests.shapes.format_files import (
    HAND,
    NO_UNITS,
    D,
    FormatFile,
    T,
    V,
    hdf5,
    mat,
    rows,
    text,
)

MS = tuple(range(4))
MV, NM = tuple(1000.0 * v for v in V), tuple(1000.0 * d for d in D)
SCALED: dict[str, object] = {"units": ("mV", "nm"), "voltage": MV, "displacement": NM}
STAMPS_NS = tuple(999_000_000 + 1_000_000 * n for n in range(4))
PARTS = [f"{1_767_323_045 + ns // 10**9},{ns % 10**9}" for ns in STAMPS_NS]
SINCE = tuple(1_767_323_045 + ns / 1e9 for ns in STAMPS_NS)
HHMMSS = ("120059.998", "120059.999", "120100.000", "120100.001")
BOARD = f"{HAND} (a microcontroller's print-outs)"
QCODES, QUDI = f"{HAND} (QCoDeS' GNUPlotFormat)", f"{HAND} (qudi-core's datastorage)"
QUDI_HEAD = [
    "# [General]", "# timestamp=2026-01-02T03:04:05.123456", "# comments='# '", "# delimiter='\\t'",
    "# column_headers='Voltage (V);;Position (um)'", "# ", "# [Metadata]", "# sample_rate=1000.0", "# ",
    "# ---- END HEADER ----",
]  # fmt: skip

STAMPS = [f"2026-01-02T03:04:05.{n:03d}Z" for n in range(4)]
SPAN = "2026-01-02T03:00:00Z,2026-01-02T04:00:00Z"
FLUX_HEAD = [
    "#group,false,false,true,true,false,false,true,true",
    "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string",
    "#default,_result,,,,,,,", ",result,table,_start,_stop,_time,_value,_field,_measurement",
]  # fmt: skip
GRAFANA, FLUX = f"{HAND} (Grafana's export)", f"{HAND} (InfluxDB's annotated CSV)"
STAMPED: dict[str, Any] = {"time": tuple(1_767_323_045 + n / 1000 for n in range(4)), "units": NO_UNITS}
LABVIEW = f"{HAND} (LabVIEW's Export Waveforms to Spreadsheet File)"
LABVIEW_HEAD = ["t0\t01/02/2026 03:04:05.000000\t01/02/2026 03:04:05.000000", "delta t\t0.001000\t0.001000", ""]
LABVIEW_ROWS = [f"01/02/2026 03:04:05.000\t{row}" for row in rows("\t", (V, D))]
JSON, UFF = "Python's json", "pyuff"
IGOR = f"{HAND} (igorwriter's, Igor Pro's)"
NAMED = ("time_s", "voltage_V", "displacement_um")


def flux(table: int, field: str, values: tuple[float, ...], measurement: str = "stage") -> list[str]:
    return [f",,{table},{SPAN},{stamp},{value:g},{field},{measurement}"
            for stamp, value in zip(STAMPS, values, strict=True)]  # fmt: skip


def records(*names: str) -> list[dict[str, float]]:
    return [dict(zip(names or NAMED, row, strict=True)) for row in zip(T, V, D, strict=True)]


def uff(path: Path) -> None:
    import pyuff

    sets = [
        pyuff.prepare_58(
            binary=0, func_type=1, id1=name, rsp_node=1, rsp_dir=3, ref_node=0, ref_dir=0, data=np.array(values),
            x=np.array(T), abscissa_spacing=1, abscissa_min=0.0, abscissa_inc=0.001, abscissa_spec_data_type=17,
            abscissa_axis_units_lab="s", ordinate_spec_data_type=8, ordinate_axis_units_lab=unit,
            orddenom_spec_data_type=0, return_full_dict=True,
        )
        for name, values, unit in (("Voltage", V, "V"), ("Displacement", D, "um"))
    ]  # fmt: skip
    pyuff.UFF(str(path)).write_sets([{key: 0 if value is None else value for key, value in one.items()} for one in sets])


def pymodaq(*scans: str) -> Any:
    def fill(file: Any) -> None:
        file.attrs["pymodaq_version"] = "5.3.0"
        for scan in scans:
            pymodaq_tree(file.require_group(f"RawData/{scan}"))

    return hdf5(fill)


def pymodaq_tree(group: Any) -> None:
    """A tree as ``pymodaq_data`` 5.3 writes it; attributes are JSON with the text quoted as in Python."""
    for place, kind, label, unit, values in (
        ("Detector000/NavAxes/Axis00", "axis", "time", "s", np.array(T)),
        ("Detector000/Data0D/CH00/EnlData00", "data_enlargeable", "displacement", "um", np.array(D)[:, None]),
        ("Detector000/Data0D/CH01/EnlData00", "data_enlargeable", "voltage", "V", np.array(V)[:, None]),
    ):
        data = group.create_dataset(place, data=values)
        for name, said in (("data_type", kind), ("label", label), ("units", unit)):
            data.attrs[name] = json.dumps({"module": "builtins", "type": "str", "data": repr(said)})


def labber(traces: bool) -> Any:
    def fill(file: Any) -> None:
        import h5py

        text_type = h5py.string_dtype()
        named = [("name", text_type), ("instrument", text_type), ("unitPhys", text_type), ("gain", "f8")]
        channels = [("Piezo - Voltage", "Piezo", "V", 1.0), ("Sensor - Displacement", "Sensor", "um", 1.0)]
        file["Channels"] = np.array(channels, dtype=named)
        file["Log list"] = np.array([("Sensor - Displacement",)], dtype=[("channel_name", text_type)])
        file["Data/Channel names"] = np.array(
            [(name, "") for name, *_ in channels], dtype=[("name", text_type), ("info", text_type)]
        )
        file["Data/Data"] = np.array([V, D]).T[:, :, None]
        for (name, *_), values in zip(channels if traces else [], (V, D), strict=False):
            file[f"Traces/{name}"] = np.array(values)[:, None, None]
            file[f"Traces/{name}"].attrs["x_unit"] = "s"
            file[f"Traces/{name}_t0dt"] = np.array([[0.0, 0.001]])

    return hdf5(fill)


def units_apart(name: str, *head: str, mark: str = ",") -> FormatFile:
    return FormatFile(name, HAND, ".csv", text(*head, *rows(mark, (MS, MV, NM))), **SCALED)  # type: ignore[arg-type]


def stated(line: str) -> FormatFile:
    return FormatFile(f"A rate above the data: {line}", HAND, ".csv",
                      text(line, "", "voltage_V,displacement_um", *rows(",", (V, D))))  # fmt: skip


LABORATORY_FILES = [
    FormatFile("QCoDeS, names and labels behind #, and a count", QCODES, ".dat",
               text("# time\tdac_ch1\tsensor", '# "Time (s)"\t"Voltage (V)"\t"Position (um)"', "# 4", *rows("\t"), end="\n")),
    FormatFile("Qudi, names and a rate behind #", QUDI, ".dat", text(*QUDI_HEAD, *rows("\t", (V, D))),
               notes=(": 'sample_rate' 1000.0 has no unit: Hz is assumed",)),
    FormatFile("JPK, text of a force curve", f"{HAND} (JPK's export)", ".txt",
               text("# segmentIndex: 0", "# columns: seriesTime piezoVoltage measuredHeight",
                    '# fancyNames: "Series Time" "Piezo Voltage" "Height (measured)"', "# units: s V um", *rows(" "))),
    FormatFile("A simulator's V(drive)", f"{HAND} (LTspice's export)", ".txt",
               text("time\tV(drive)\tV(sensor)", *rows("\t")), units=NO_UNITS),
    units_apart("Units in a comment", "# units: ms, mV, nm", "time,voltage,displacement"),
    units_apart("Units in a comment below the names", "time,voltage,displacement", "", "# (ms),(mV),(nm)"),
    units_apart("Units above the names", "ms,mV,nm", "time,voltage,displacement"),
    units_apart("Units and names with labels", "Channels: time,voltage,displacement", "Units: ms,mV,nm"),
    units_apart("Units below a line of dashes", "time voltage displacement", "---- ------- ------------", "ms mV nm", mark=" "),
    units_apart("Units line by line", "Time unit: ms", "Voltage unit: mV", "Displacement unit: nm", "",
                "time,voltage,displacement"),
    *map(stated, ("Interval (ms): 1", "Time interval: 0.001 s", "Frame Rate: 1000 fps", "Sampling (Hz): 1000")),
    FormatFile("Seconds and nanoseconds in two columns", f"{HAND} (ROS 2's stamps)", ".csv",
               text("header.stamp.sec,header.stamp.nanosec,voltage_V,position_um",
                    *[f"{stamp},{row}" for stamp, row in zip(PARTS, rows(",", (V, D)), strict=True)]), time=SINCE),
    FormatFile("Seconds and milliseconds that are no part of one", BOARD, ".csv",
               text("seconds,milliseconds,voltage_V,position_um", *rows(",", ((5, 5, 5, 5), (5000, 5001, 5002, 5003), V, D))),
               refusal=": the time column 'seconds' has a part of a second in 'milliseconds', which holds more than one "
                       "(`sample_rate` HZ gives the time instead)"),
    FormatFile("hhmmss.sss", f"{HAND} (NMEA's clock)", ".csv",
               text("time (hhmmss.sss),voltage_V,position_um",
                    *[f"{stamp},{row}" for stamp, row in zip(HHMMSS, rows(",", (V, D)), strict=True)]),
               time=(43259.998, 43259.999, 43260.0, 43260.001)),
    FormatFile("A counter of milliseconds that wraps", BOARD, ".csv",
               text("time_ms,voltage_V,position_um", *rows(",", ((*range(65500, 65536), 0, 1), V[:1] * 38, D[:1] * 38))),
               refusal=": the time begins anew after 65.536 s at line 38 (from 65.535 s to 0 s): its counter wraps "
                       "(`sample_rate` HZ gives the time instead)"),
    FormatFile("Thousands separators", f"{HAND} (a spreadsheet)", ".csv",
               text("time_ms,voltage_mV,displacement_nm", '0,0.0,"10,250.0"', '1,"1,500.0","11,000.0"',
                    '2,"-2,500.0","9,125.0"', '3,"4,000.0","8,000.0"'), **SCALED),  # type: ignore[arg-type]
    FormatFile("Thousands separators that may be decimal commas", f"{HAND} (a spreadsheet)", ".txt",
               text("time_ms\tvoltage_mV\tdisplacement_nm", "0\t0\t10,250", "1\t1,500\t11,000", "2\t-2,500\t9,125"),
               refusal=": '10,250' may be 10250 or 10.250 (`decimal` point or comma)"),
    FormatFile("JSON lines", JSON, ".jsonl", text(*map(json.dumps, records()), end="\n")),
    FormatFile("JSON lines, values in an object, stamps", JSON, ".jsonl",
               text(*(json.dumps({"ts_utc": None, "time": stamp, "fields": {"voltage": v, "displacement": d}})
                      for stamp, v, d in zip(STAMPS, V, D, strict=True))), time=T, units=NO_UNITS),
    FormatFile("JSON lines, the last one cut", JSON, ".jsonl", text('{"voltage": 1, "displacement": 2}', '{"voltage":'),
               refusal=":2: this is not JSON: Expecting value"),
    FormatFile("JSON, an array of records", JSON, ".json", text(json.dumps(records(), indent=1))),
    FormatFile("JSON, an object of arrays and a rate", JSON, ".json",
               text(json.dumps({"run": {"voltage_V": V, "displacement_um": D}, "fs": 1000})),
               notes=(": 'fs' 1000 has no unit: Hz is assumed",)),
    FormatFile("JSON, columns and data", "pandas (orient='split')", ".json",
               text(json.dumps({"columns": NAMED, "index": [0, 1, 2, 3], "data": list(zip(T, V, D, strict=True))}))),
    FormatFile("UFF, data sets 58", UFF, ".uff", uff),
    FormatFile("Igor text, a wave each", IGOR, ".itx",
               text("IGOR", "WAVES /D /N=(4) 'voltage'", "BEGIN", *rows(",", (V,)), "END", 'X SetScale d,0,0,"V",\'voltage\'',
                    'X SetScale /P x,0.0,0.001,"s",\'voltage\'', "WAVES /D /N=(4) 'displacement'", "BEGIN",
                    *rows(",", (D,)), "END", 'X SetScale /P x,0,0.001,"s",\'displacement\'; SetScale d,0,0,"um",\'displacement\'',
                    end="\n")),
    FormatFile("Igor text, waves side by side", IGOR, ".itx",
               text("IGOR", "WAVES/D\ttime\tvoltage\tdisplacement", "BEGIN", *rows("\t"), "END",
                    'X SetScale d 0,0,"V", voltage; SetScale d 0,0,"um", displacement', end="\r")),
    FormatFile("Igor text, cut", IGOR, ".itx", text("IGOR", "WAVES/D\tvoltage", "BEGIN", "1", "2"),
               refusal=": the last wave has no END: the file was cut"),
    FormatFile("PyMoDAQ", f"{HAND} (h5py, after pymodaq_data)", ".h5", pymodaq("Scan000")),
    FormatFile("PyMoDAQ, two scans", f"{HAND} (h5py, after pymodaq_data)", ".h5", pymodaq("Scan000", "Scan001"),
               refusal=": 2 scans: which one? (write {file}::/RawData/Scan000)"),
    FormatFile("PyMoDAQ, one of two scans", f"{HAND} (h5py, after pymodaq_data)", ".h5", pymodaq("Scan000", "Scan001"),
               group="::/RawData/Scan001"),
    FormatFile("Labber, by steps", f"{HAND} (h5py, after Labber's readers)", ".hdf5", labber(False), time=None),
    FormatFile("Labber, traces", f"{HAND} (h5py, after Labber's readers)", ".hdf5", labber(True)),
    FormatFile("MATLAB, structs in a struct, the time above the signals", "scipy.io.savemat", ".mat",
               mat({"exp": {"run": {"t": np.array(T), "signals": {"voltage": np.array(V), "displacement": np.array(D)}}}}),
               units=NO_UNITS),
    FormatFile("MATLAB, two structs, deeper", "scipy.io.savemat", ".mat",
               mat({"exp": {key: {"voltage": np.array(V), "displacement": np.array(D)} for key in "ab"}}),
               refusal=": columns in 2 structs, exp.a, exp.b: which one? (write {file}::exp.a)"),
    FormatFile("MATLAB, one of two structs, deeper", "scipy.io.savemat", ".mat",
               mat({"exp": {"a": {"voltage": np.array(V)}, "b": {"voltage": np.array(V), "displacement": np.array(D)}}}),
               group="::exp.b", time=None, units=NO_UNITS),
    FormatFile("Grafana, series below each other", GRAFANA, ".csv",
               text('"Series";"Time";"Value"',
                    *(f'"{name}";"{stamp}";{value:g}' for name, values in (("voltage", V), ("displacement", D))
                      for stamp, value in zip(STAMPS, values, strict=True))), units=NO_UNITS, time=T),
    FormatFile("Grafana, several rows a stamp", GRAFANA, ".csv",
               text('"Time","voltage","displacement"',
                    *(row for n in range(4) for row in (f"{1767323045000 + n},{V[n]:g},", f"{1767323045000 + n},,{D[n]:g}"))),
               **STAMPED),
    FormatFile("Grafana, units in the cells", GRAFANA, ".csv",
               text('"Time","voltage","displacement"', *(f"{s},{v:g} V,{d:g} µm" for s, v, d in zip(STAMPS, V, D, strict=True))),
               refusal=": no line holds plain numbers, but '4 V' (write them without units and labels; "
                       "Grafana: without Formatted data)"),
    FormatFile("Numbers with labels", f"{HAND} (the Arduino's plotter)", ".txt",
               text("ready", *(f"V:{v:g} D:{d:g}" for v, d in zip(V, D, strict=True))),
               refusal=": no line holds plain numbers, but 'V:4' (write them without units and labels; Grafana: without Formatted data)"),
    FormatFile("Flux, a row a value", FLUX, ".csv", text(*FLUX_HEAD, *flux(0, "voltage", V), *flux(1, "displacement", D)),
               units=NO_UNITS, time=T),
    FormatFile("Flux, a table a signal, told apart by the measurement", FLUX, ".csv",
               text(*FLUX_HEAD, *flux(0, "value", V, "voltage"), "", *FLUX_HEAD, *flux(1, "value", D, "displacement")),
               units=NO_UNITS, time=T),
    FormatFile("Flux, a signal twice", FLUX, ".csv",
               text(*FLUX_HEAD, *flux(0, "voltage", V), *flux(0, "voltage", D), *flux(0, "displacement", D)),
               refusal=":9: 'voltage' has two values at one time, 2026-01-02T03:04:05.000Z (narrow the query down to one source)"),
    FormatFile("SQL, time, channel, value", f"{HAND} (a data base)", ".csv",
               text("time,channel,value", *(row for n in range(4) for row in (f"{T[n]},voltage,{V[n]:g}", f"{T[n]},displacement,{D[n]:g}"))),
               units=NO_UNITS),
    FormatFile("PlotJuggler", f"{HAND} (PlotJuggler's CSV)", ".csv",
               text("__time,/stage/voltage,/stage/displacement", *(f"{s:.3f},{row}" for s, row in zip(STAMPED["time"], rows(",", (V, D)), strict=True))),
               **STAMPED),
    FormatFile("PlotJuggler, signals with times of their own", f"{HAND} (PlotJuggler's CSV)", ".csv",
               text("__time,/stage/voltage,/stage/displacement", *(row for n in range(30) for row in (f"{n}.0,1.5,", f"{n}.5,,2.5"))),
               refusal=":2: column '/stage/displacement' is empty (and so on in 59 of the next 59 rows: bring the signals to "
                       "common times first (pandas: interpolate(method='index'), dropna))"),
    FormatFile("LabVIEW, waveforms in a spreadsheet", LABVIEW, ".txt",
               text("waveform\t[0]\t[1]", *LABVIEW_HEAD, "time\tY[0]\tY[1]", *LABVIEW_ROWS),
               ask={"voltage": "Y[0]", "displacement": "Y[1]"}, units=NO_UNITS),
    FormatFile("LabVIEW, waveforms with names", LABVIEW, ".txt",
               text("waveform\tVoltage\tDisplacement", *LABVIEW_HEAD, "time\tY[0]\tY[1]", *LABVIEW_ROWS), units=NO_UNITS),
    FormatFile("LabVIEW, waveforms that begin apart", LABVIEW, ".txt",
               text("waveform\t[0]\t[1]", LABVIEW_HEAD[0][:-1] + "1", *LABVIEW_HEAD[1:], "time\tY[0]\tY[1]", *LABVIEW_ROWS),
               refusal=": the waveforms have different t0 or delta t, and rows of different times stand beside each other: "
                       "write a file for each, and name the other's column as FILE::COLUMN"),
    FormatFile("JPK, a segment with other columns", f"{HAND} (JPK's export)", ".txt",
               text("# columns: time voltage height", "# units: s V um", *rows(" "), "",
                    "# columns: time height voltage", "# units: s um V", *rows(" ", (T, D, V))), ask={"displacement": "height"},
               refusal=":8: the columns change here, from time voltage height to time height voltage "
                       "(`rows` :4 reads what is above)"),
    FormatFile("JSON lines, numbers as text, milliseconds since 1970", JSON, ".jsonl",
               text(*(json.dumps({"ts": 1767323045000 + n, "voltage": str(V[n]), "displacement": str(D[n])}) for n in range(4))),
               **STAMPED),
    FormatFile("JSON lines, text among the numbers", JSON, ".jsonl",
               text('{"voltage": 1, "displacement": 2}', '{"voltage": "off", "displacement": 2}', '{"voltage": 1, "displacement": 2}'),
               refusal=": column 'voltage' is not a number in record 2: 'off' (leave it out)"),
    FormatFile("JSON, channels with names and units", JSON, ".json",
               text(json.dumps({"meta": {"fs": "1 kHz"}, "channels": [
                   {"name": "voltage", "unit": "V", "data": V}, {"name": "displacement", "unit": "um", "data": D}]}))),
    FormatFile("JSON, pairs of time and value", f"{HAND} (Prometheus' API)", ".json",
               text(json.dumps({"data": {"result": [{"metric": {"name": "voltage"}, "values": [[0, "1"], [1, "2"]]}]}})),
               refusal=": no columns of numbers: it holds data/result/metric/name, data/result/values "
                       '(write a line a row: {"time": 0, "voltage": 1.5})'),
    FormatFile("Igor text, a matrix, its rows in ms", IGOR, ".itx",
               text("IGOR", "WAVES/D/N=(4,2)\trun", "BEGIN", *rows("\t", (V, D)), "END", 'X SetScale/P x 0,1,"ms", run'),
               ask={"voltage": "run[1]", "displacement": "run[2]"}, units=NO_UNITS),
    FormatFile("MATLAB, a struct a signal, with its times", "scipy.io.savemat", ".mat",
               mat({name: {"Time": np.array(T), "Data": np.array(one)} for name, one in (("voltage", V), ("displacement", D))}),
               units=NO_UNITS),
    FormatFile("MATLAB, a struct a signal, with times of its own", "scipy.io.savemat", ".mat",
               mat({name: {"Time": np.array(T) + at, "Data": np.array(V)} for at, name in enumerate(("voltage", "displacement"))}),
               refusal=": which column is the time, 'voltage/time' or 'displacement/time'? (choose with `time` NAME or NUMBER)"),
    FormatFile("SQL, time, sensor, value, unit", f"{HAND} (a data base)", ".csv",
               text("time,sensor,value,unit", *(row for n in range(4) for row in (
                   f"{T[n]},voltage,{MV[n]:g},mV", f"{T[n]},displacement,{NM[n]:g},nm"))), **SCALED),  # type: ignore[arg-type]
    FormatFile("Grafana, series with times of their own", GRAFANA, ".csv",
               text("Series,Time,Value", *(f"voltage,{stamp},1" for stamp in STAMPS), *(f"displacement,{stamp[:-1]}5Z,1" for stamp in STAMPS)),
               refusal=": each signal has times of its own: put them side by side, then bring the signals to common times "
                       "first (pandas: interpolate(method='index'), dropna)"),
    FormatFile("Two columns called time", f"{HAND} (an oscilloscope's viewer)", ".csv",
               text("Time (s),CH1 (V),Time (s),CH2 (um)", *rows(",", (T, V, T, D))),
               refusal=": which column is the time, 1 'Time (s)' or 3 'Time (s)'? (choose with `time` NAME or NUMBER)"),
    FormatFile("Samples along the lines", HAND, ".csv",
               text(*(f"{name},{','.join(['1.5'] * 99)}" for name in NAMED)),
               refusal=": the samples run along the lines, 99 in each: turn it round (pandas: read_csv(FILE, header=None, "
                       "index_col=0).T)"),
]  # fmt: skip
