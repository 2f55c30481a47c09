"""Files that people bring from laboratories: what programs for experiments, data bases and small boards write."""

from __future__ import annotations

from tests.shapes.format_files import HAND, NO_UNITS, D, FormatFile, V, rows, text

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
]  # fmt: skip
