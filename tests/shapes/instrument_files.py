"""Text files of instruments, by hand after their makers' manuals and files published with them."""

from __future__ import annotations

from tests.shapes.format_files import HAND, NO_UNITS, D, FormatFile, T, V, rows, text

BY_CHANNEL = {"voltage": "CH1", "displacement": "CH2"}
VV = ("V", "V")
LATER = (-0.001, 0.0, 0.001, 0.002)

_LVM = ["LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
        "Multi_Headings\tNo", "X_Columns\t{x}", "Time_Pref\tRelative", "Operator\tN. N.", "Date\t2026/01/02",
        "Time\t03:04:05.000", "***End_of_Header***\t", "\t", "Channels\t2\t\t", "Samples\t4\t4\t",
        "Date\t2026/01/02\t2026/01/02\t", "Time\t03:04:05.0\t03:04:05.0\t", "Y_Unit_Label\tVolts\tµm\t",
        "X_Dimension\tTime\tTime\t", "X0\t{x0}\t{x0}\t", "Delta_X\t{dx}\t{dx}\t", "***End_of_Header***\t\t\t",
        "X_Value\tVoltage\tDisplacement\tComment"]  # fmt: skip
_TEK = ["Record Length,4.000000e+00,,", "Sample Interval,1.000000e-03,,", "Trigger Point,1.0e+00,,", "Source,CH1,,",
        "Vertical Units,V,,", "Horizontal Units,s,,"]  # fmt: skip


def lvm(x: str, x0: str = "0.0E+0", dx: str = "0.001000") -> list[str]:
    return [line.format(x=x, x0=x0, dx=dx) for line in _LVM]


def beside(settings: list[str], data: list[str]) -> list[str]:
    """Settings beside the first rows, and rows without settings below."""
    longer = max(len(settings), len(data))
    left = settings + [",,,"] * (longer - len(settings))
    return [f"{a}{b}," for a, b in zip(left, data, strict=False)]


TEK_T = tuple(0.001 * n for n in range(8))
TEK_V = (0.0, 1.5, -2.5, 4.0, 3.0, 2.0, 1.0, 0.5)
_TWINCAT = ["Name\tYT Scope Project", "File\tC:\\run.tcscopex", "Starttime of export\t134000000000000000\t2 January",
            "Endtime of export\t134000000000030000\t2 January", ""]  # fmt: skip


def twincat(steps: str = "1\tSampleTime[ms]\t1", scale: str = "1", end: tuple[str, ...] = ("EOF",)) -> list[str]:
    return [*_TWINCAT, "Name\tVoltage\tName\tPosition", "SymbolComment\t\tSymbolComment\t",
            "Data-Type\tREAL64\tData-Type\tREAL64", f"SampleTime[ms]\t{steps}",
            "SymbolName\tMAIN.fVoltage\tSymbolName\tMAIN.fPosition", "Offset\t0\tOffset\t0",
            f"ScaleFactor\t{scale}\tScaleFactor\t1", "Unit\tV\tUnit\tµm", "",
            *[f"{n}\t{v}\t{n}\t{d}".replace(".", ",") for n, (v, d) in enumerate(zip(V, D, strict=True))],
            *end]  # fmt: skip


INSTRUMENT_FILES = [
    FormatFile("PI GCS array (data recorder)", f"{HAND} (PI's GCS manual)", ".dat",
               text("# REM E-709", "#", "# VERSION = 1", "# TYPE = 1", "# SEPARATOR = 32", "# DIM = 2", "# NDATA = 4",
                    "# SAMPLE_TIME = 0.001000", "# NAME0 = Output Voltage of Channel 1",
                    "# NAME1 = Current Position of Axis 1", "# END_HEADER", *rows(" ", (V, D))), units=NO_UNITS),
    FormatFile("PI GCS array, tabs, three columns", f"{HAND} (PI's GCS manual)", ".dat",
               text("#TYPE=1", "#SEPARATOR=9", "#DIM=3", "#NDATA=4", "#SAMPLE_TIME=0.001", "#NAME0=Target Position",
                    "#NAME1=Piezo Voltage", "#NAME2=Current Position", "#END_HEADER", *rows("\t", (D, V, D))),
               ask={"displacement": "Current Position"}, units=NO_UNITS),
    FormatFile("PI GCS array, another number of columns than stated", f"{HAND} (PI's GCS manual)", ".dat",
               text("# DIM = 3", "# NDATA = 4", "# SAMPLE_TIME = 0.001", "# END_HEADER", *rows("\t", (V, D))),
               refusal=":5: 2 cells where the header states DIM = 3 columns (`skip_lines` 4 and `header_lines` 0 read it "
                       "without the header)"),
    FormatFile("LabVIEW .lvm, one X column, units", f"{HAND} (NI's specification)", ".lvm",
               text(*lvm("One"), *rows("\t"))),
    FormatFile("LabVIEW .lvm, a comment in its first row", f"{HAND} (NI's specification)", ".lvm",
               text(*lvm("One"), rows("\t")[0] + "\tbegin", *rows("\t")[1:])),
    FormatFile("LabVIEW .lvm, no X column, X0 and Delta_X", f"{HAND} (NI's specification)", ".lvm",
               text(*lvm("No", "-0.001"), *["\t" + row for row in rows("\t", (V, D))]), time=LATER),
    FormatFile("LabVIEW .lvm, no X column, its header again before the third row", f"{HAND} (NI's specification)",
               ".lvm", text(*lvm("No"), *["\t" + row for row in rows("\t", (V[:2], D[:2]))], *lvm("No")[12:],
                            *["\t" + row for row in rows("\t", (V[2:], D[2:]))]),
               notes=(": 1 more header among the data: no column gives their time, so the rows go on as if there had been "
                      "no pause",)),
    FormatFile("LabVIEW .lvm, two Delta_X", f"{HAND} (NI's specification)", ".lvm",
               text(*[line.replace("Delta_X\t0.001000\t0.001000", "Delta_X\t0.001\t0.002") for line in lvm("No")],
                    *["\t" + row for row in rows("\t", (V, D))]),
               refusal=": two sample rates are stated, 'Delta_X' 0.001 and 'Delta_X' 0.002: which one holds? "
                       "(`sample_rate` HZ decides)"),
    FormatFile("LabVIEW .lvm, an X column a channel", f"{HAND} (NI's specification)", ".lvm",
               text(*lvm("Multi"), *rows("\t")),
               refusal=": every channel has its own X column (X_Columns Multi): write it with X_Columns One or No"),
    FormatFile("Tektronix TDS, settings beside the rows, one channel a file",
               f"{HAND} (Tektronix TDS2000 manual)", ".csv",
               text(*beside(_TEK, rows(",", (TEK_T, TEK_V)))), ask={"voltage": "CH1", "displacement": "CH1"},
               units=VV, time=TEK_T, voltage=TEK_V, displacement=TEK_V),
    FormatFile("Tektronix MSO, settings by channel", f"{HAND} (Tektronix MSO5 manual)", ".csv",
               text("Model,MSO54", "Firmware Version,1.2.3", "", "Waveform Type,ANALOG,,", "Point Format,Y,,",
                    "Horizontal Units,s,,", "Sample Interval,1.0E-3,,", "Record Length,4,,", "Vertical Units,V,um,",
                    "Label,,,", "TIME,CH1,CH2", *rows()), ask=BY_CHANNEL),
    FormatFile("Rigol DS1000, Start and Increment", f"{HAND} (files of a DS1054Z)", ".csv",
               text("X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,-1.000000e-03,1.000000e-03",
                    *rows(",", (range(4), V, D), ",")), ask=BY_CHANNEL, units=VV, time=LATER),
    FormatFile("Rigol MSO5000, t0 and tInc", f"{HAND} (Rigol's MSO5000 manual)", ".csv",
               text("CH1V,CH2V,t0 =-1.000000e-03, tInc = 1.000000e-03,", *rows(",", (V, D), ",,")), ask=BY_CHANNEL,
               units=VV, time=LATER),
    FormatFile("Keysight InfiniiVision", f"{HAND} (Keysight 3000 X-Series manual)", ".csv",
               text("x-axis,1,2", "second,Volt,Volt", *rows()), ask={"voltage": "number=2", "displacement": "number=3"},
               units=VV),
    FormatFile("Keysight InfiniiVision, a number that is a name, too", f"{HAND} (Keysight 3000 X-Series manual)", ".csv",
               text("x-axis,1,2", "second,Volt,Volt", *rows()), ask={"voltage": "1", "displacement": "number=3"},
               refusal=": `voltage` 1: column 1, 'x-axis', or column 2, which is named '1'? (`voltage` number=1 or name=1)"),
    FormatFile("Keysight Infiniium, X and Y", f"{HAND} (Keysight Infiniium manual)", ".csv",
               text("Revision:,0", "Type:,raw", "Points:,4", "XInc:,1.0E-03", "XOrg:,-1.0E-03", "YUnits:,Volt",
                    "XUnits:,second", "Data:,", *rows(",", (LATER, V))),
               ask={"voltage": "signal", "displacement": "2"}, units=VV, time=LATER, displacement=V),
    FormatFile("Keysight Infiniium, Y only", f"{HAND} (Keysight Infiniium manual)", ".csv",
               text("Revision,0", "Type,raw", "Points,4", "XInc,1.0", "XOrg,0", "YUnits,Volt", "XUnits,ms", "Data,",
                    *rows(",", (V,))), ask={"voltage": "1", "displacement": "1"}, units=VV, displacement=V),
    FormatFile("Rohde & Schwarz RTB", f"{HAND} (R&S RTB2000 manual)", ".csv",
               text("in s,CH1 in V,CH2 in V", *rows()), ask=BY_CHANNEL, units=VV),
    FormatFile("Rohde & Schwarz, in ms, decimal commas", f"{HAND} (R&S RTB2000 manual)", ".csv",
               text("in ms;CH1 in V;CH2 in mV",
                    *[row.replace(".", ",") for row in rows(";", (range(4), V, D))]), ask=BY_CHANNEL,
               units=("V", "mV")),
    FormatFile("attocube IDS, a rate in kHz above the names", f"{HAND} (layout of attocube's WAVE export)", ".csv",
               text("# Device: IDS3010", "# Sampling rate: 1.0 kHz", "# Displacement Axis 1 [um], Voltage AUX [V]",
                    *rows(",", (D, V))), ask={"voltage": "2", "displacement": "1"}),
    FormatFile("SIOS, Abtastrate with a decimal comma", f"{HAND} (layout of SIOS' export)", ".txt",
               text("Messung;1", "Abtastrate;1,0 kHz", "", "Voltage [V];Displacement [um]",
                    *[row.replace(".", ",") for row in rows(";", (V, D))])),
    FormatFile("A rate without a unit above the data", HAND, ".csv",
               text("Sample rate: 1000", "Operator: N. N.", "", "voltage_V,displacement_um", *rows(",", (V, D))),
               notes=(": 'Sample rate' 1000 has no unit: Hz is assumed",)),
    FormatFile("A rate in an unknown unit above the data", HAND, ".csv",
               text("Sample rate: 1000 rpm", "voltage_V,displacement_um", *rows(",", (V, D))),
               refusal=": 'Sample rate' 1000 rpm is not in a unit of a rate (Hz, kHz, S/s) (`sample_rate` HZ gives the "
                       "rate instead)"),
    FormatFile("A rate that may be 1 or 1000", HAND, ".csv",
               text("Sample rate: 1,000 Hz", "voltage_V,displacement_um", *rows(",", (V, D))),
               refusal=": 'Sample rate' 1,000 Hz may be 1 or 1000 (`sample_rate` HZ gives the rate instead)"),
    FormatFile("TwinCAT Scope, a time column a channel, EOF", f"{HAND} (Beckhoff's TE13xx manual)", ".csv",
               text(*twincat())),
    FormatFile("TwinCAT Scope, a scale", f"{HAND} (Beckhoff's TE13xx manual)", ".csv", text(*twincat(scale="0.1")),
               notes=(": channel 'Voltage' has ScaleFactor 0.1, and the file does not say whether its values are "
                      "scaled already (Scope: 'Scale values before export')",)),
    FormatFile("TwinCAT Scope, two sample times", f"{HAND} (Beckhoff's TE13xx manual)", ".csv",
               text(*twincat(steps="1\tSampleTime[ms]\t2")),
               refusal=": the channels are sampled every 1 and 2 ms, and rows of different times stand beside each "
                       "other: export channels of one sample time"),
    FormatFile("TwinCAT Scope, one time column", f"{HAND} (Beckhoff's TE13xx manual)", ".csv",
               text("Name,YT Scope Project,", "Name,Voltage,Position", "SampleTime[ms],1,1", "Unit,V,um", "", *rows(
                   ",", (range(4), V, D)), "EOF")),
    FormatFile("Yokogawa DL, keys by channel above rows with an empty first cell", f"{HAND} (Yokogawa's DLM3000 manual)", ".csv",
               text('"Header Size   ",12', '"Model Name    ","DLM3000"', '"BlockNumber   ",1', '"TraceName     ","CH1","CH2"',
                    '"BlockSize     ",4,4', '"VUnit         ","V","um"', '"SampleRate    ",1.0E+03,1.0E+03',
                    '"HResolution   ",1.0E-03,1.0E-03', '"HOffset       ",-1.0E-03,-1.0E-03', '"HUnit         ","s","s"', "",
                    *("," + row for row in rows(",", (V, D)))),
               ask=BY_CHANNEL, units=("V", "um"), time=(-0.001, 0.0, 0.001, 0.002)),
]  # fmt: skip
assert T == (0.0, 0.001, 0.002, 0.003)
