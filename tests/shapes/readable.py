"""Logs that must read right: name, literal content, what is asked for, and what must come out.

Written by hand after what each program exports; the numbers are made up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from dbo_cli.logs.request import ReadingOptions


@dataclass(frozen=True)
class Shape:
    """A log and how it must read."""

    name: str
    content: bytes
    voltage: tuple[float, ...]
    displacement: tuple[float, ...]
    time: tuple[float, ...] | None = None
    units: tuple[str | None, str | None] = (None, None)
    ask: dict[str, str] = field(default_factory=dict)  # role to selector; "time" too
    sample_rate: float | None = None
    options: ReadingOptions = field(default_factory=ReadingOptions)
    ending: str = ".csv"
    first_line: int = 2


V3 = (0.0, 1.5, -2.5)
D3 = (10.25, 11.0, 9.125)
T3 = (0.0, 0.001, 0.002)
VUM = ("V", "um")
BY_NUMBER = {"voltage": "1", "displacement": "2"}


def _text(*lines: str, end: str = "\n") -> bytes:
    return (end.join(lines) + end).encode()


READABLE = [
    Shape(
        "plain CSV with units in the names",
        _text("time_s,voltage_V,displacement_um", "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "no line end after the last row",
        b"time_s,voltage_V,displacement_um\n0,0,10.25\n0.001,1.5,11\n0.002,-2.5,9.125",
        V3, D3, T3, VUM,
    ),
    Shape(
        "Windows line ends and a byte-order mark (Excel, CSV UTF-8)",
        b"\xef\xbb\xbf" + _text("time_s,voltage_V,displacement_um", "0,0,10.25", "0.001,1.5,11",
                                "0.002,-2.5,9.125", end="\r\n"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "German Excel: semicolons, decimal commas",
        _text("Time (s);Voltage (V);Displacement (µm)", "0;0;10,25", "0,001;1,5;11", "0,002;-2,5;9,125",
              end="\r\n"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "semicolons and decimal points",
        _text("t;u;y", "0;0;10.25", "0.001;1.5;11", "0.002;-2.5;9.125"),
        V3, D3, T3,
    ),
    Shape(
        "Excel 'Unicode text': UTF-16 with a mark, tabs",
        "Time [s]\tVoltage [V]\tPosition [µm]\r\n0\t0\t10.25\r\n0.001\t1.5\t11\r\n0.002\t-2.5\t9.125\r\n".encode(
            "utf-16"),
        V3, D3, T3, VUM, ending=".txt",
    ),
    Shape(
        "UTF-16 big-endian without a mark",
        "time_s,voltage_V,position_um\n0,0,10.25\n0.001,1.5,11\n0.002,-2.5,9.125\n".encode("utf-16-be"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "µ in the Western code page of an old instrument",
        "Time (s),Voltage (V),Displacement (µm)\n0,0,10.25\n0.001,1.5,11\n0.002,-2.5,9.125\n".encode("cp1252"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "Greek mu instead of the micro sign",
        _text("time,voltage [V],displacement [μm]", "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "the authors' logs: tabs, no header",
        _text("0.000000\t0.000000\t10.250000\t-317.2", "1.500000\t0.000000\t11.000000\t-317.2",
              "-2.500000\t0.000000\t9.125000\t-317.2"),
        V3, D3, (0.0, 0.005, 0.01), ask={"voltage": "1", "displacement": "3"}, sample_rate=200.0,
        ending=".dat", first_line=1,
    ),
    Shape(
        "numpy.savetxt: blanks, exponents, header as a comment",
        _text("# time voltage displacement", "0.000000000000000000e+00 0.000000000000000000e+00 1.025000000000000000e+01",
              "1.000000000000000021e-03 1.500000000000000000e+00 1.100000000000000000e+01",
              "2.000000000000000042e-03 -2.500000000000000000e+00 9.125000000000000000e+00"),
        V3, D3, T3, ending=".txt",
    ),
    Shape(
        "numpy.savetxt with a comma header over blank-separated rows",
        _text("# time_s, voltage_V, displacement_um", "0 0 10.25", "0.001 1.5 11", "0.002 -2.5 9.125"),
        V3, D3, T3, VUM, ending=".txt",
    ),
    Shape(
        "COMSOL table: % comments, the last one holds the names",
        _text("% Model:              piezo.mph", "% Version:            COMSOL", "% Date:               Jan 1 2024",
              "% Time (s)              Voltage (V)             Displacement (um)",
              "0                       0                       10.25",
              "0.001                   1.5                     11",
              "0.002                   -2.5                    9.125"),
        V3, D3, T3, VUM, ending=".txt", first_line=5,
    ),
    Shape(
        "right-aligned columns, blanks before the first",
        _text("     t_s       v_V      y_um", "   0.000     0.000    10.250", "   0.001     1.500    11.000",
              "   0.002    -2.500     9.125"),
        V3, D3, T3, VUM, ending=".dat",
    ),
    Shape(
        "blanks and tabs mixed, trailing blanks",
        _text("time_s \t voltage_V  displacement_um ", "0 \t 0   10.25  ", "0.001\t1.5   11 ", "0.002 -2.5\t\t9.125"),
        V3, D3, T3, VUM, ending=".txt",
    ),
    Shape(
        "blank-separated, units in brackets in the header",
        _text("Time [s] Voltage [V] Displacement [um]", "0 0 10.25", "0.001 1.5 11", "0.002 -2.5 9.125"),
        V3, D3, T3, VUM, ending=".dat",
    ),
    Shape(
        "blanks with decimal commas",
        _text("t u y", "0 0 10,25", "0,001 1,5 11", "0,002 -2,5 9,125"),
        V3, D3, T3, ending=".dat",
    ),
    Shape(
        "tabs with decimal commas",
        _text("t\tu\ty", "0\t0\t10,25", "0,001\t1,5\t11", "0,002\t-2,5\t9,125"),
        V3, D3, T3, ending=".txt",
    ),
    Shape(
        "blanks around the commas",
        _text("time_s , voltage_V , displacement_um", "0 , 0 , 10.25", "0.001 , 1.5 , 11", "0.002 , -2.5 , 9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "two header lines: names, then units in brackets (PicoScope)",
        _text("Time,Channel A,Channel B", "(ms),(V),(mV)", "", "0.00000000,0.00000000,10.25000000",
              "1.00000000,1.50000000,11.00000000", "2.00000000,-2.50000000,9.12500000", end="\r\n"),
        V3, D3, T3, ("V", "mV"), ask={"voltage": "Channel A", "displacement": "Channel B"}, first_line=4,
    ),
    Shape(
        "two header lines, bare units",
        _text("time\tdrive\tsensor", "s\tV\tum", "0\t0\t10.25", "0.001\t1.5\t11", "0.002\t-2.5\t9.125"),
        V3, D3, T3, VUM, ending=".txt", first_line=3,
    ),
    Shape(
        "Origin: long name, units, comments",
        _text("Time\tVoltage\tDisplacement", "s\tV\tµm", "\tamplifier\tcapacitive", "0\t0\t10.25", "0.001\t1.5\t11",
              "0.002\t-2.5\t9.125"),
        V3, D3, T3, VUM, ending=".txt", first_line=4,
    ),
    Shape(
        "Keysight oscilloscope: axis line, then units line",
        _text("x-axis,1,2", "second,Volt,Volt", "+0.00E+00,+0.00E+00,+1.025E+01", "+1.00E-03,+1.50E+00,+1.100E+01",
              "+2.00E-03,-2.50E+00,+9.125E+00"),
        V3, D3, T3, ("V", "V"), ask={"time": "x-axis", "voltage": "number=2", "displacement": "name=2"}, first_line=3,
    ),
    Shape(
        "Rigol oscilloscope: increment in the header, trailing commas",
        _text("X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,0.000000e+00,1.000000e-03", "0,0.00e+00,1.025e+01,,",
              "1,1.50e+00,1.100e+01,,", "2,-2.50e+00,9.125e+00,,"),
        V3, D3, (0.0, 0.01, 0.02), ask={"voltage": "2", "displacement": "3"}, sample_rate=100.0,
        options=ReadingOptions(skip_lines=2, header_lines=0), first_line=3,
    ),
    Shape(
        "Tektronix: settings beside the first rows, by number",
        _text("Record Length,3,,0.000,0.00,10.25,", "Sample Interval,1e-3,,0.001,1.50,11.0,", ",,,0.002,-2.50,9.125,"),
        V3, D3, T3, ask={"time": "4", "voltage": "5", "displacement": "6"}, first_line=1,
    ),
    Shape(
        "Tektronix MSO: key-value lines, blank line, then the table",
        _text("Model,MSO54", "Firmware Version,1.2.3", "", "Waveform Type,ANALOG,,", "Sample Interval,1.0E-3,,",
              "Record Length,3,,", "Zero Index,0.0,,", "", "TIME,CH1,CH2", "0.0,0.0,10.25", "1e-3,1.5,11.0",
              "2e-3,-2.5,9.125"),
        V3, D3, T3, ask={"voltage": "CH1", "displacement": "CH2"}, first_line=10,
    ),
    Shape(
        "LabVIEW measurement file: two headers, a comment column without cells",
        _text("LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
              "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative", "***End_of_Header***\t", "\t\t",
              "Channels\t2\t\t", "Samples\t3\t3\t", "Date\t2024/01/01\t2024/01/01\t", "X_Dimension\tTime\tTime\t",
              "Delta_X\t0.001\t0.001\t", "***End_of_Header***\t\t\t", "X_Value\tVoltage\tDisplacement\tComment",
              "0.000\t0.000\t10.250", "0.001\t1.500\t11.000", "0.002\t-2.500\t9.125"),
        V3, D3, T3, ask={"time": "X_Value"}, ending=".lvm", first_line=18,
    ),
    Shape(
        "data logger: junk of words above the header",
        _text("Data Logger DL-7", "Serial 1234", "Operator: N. N.", "", "time_s,voltage_V,displacement_um", "0,0,10.25",
              "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, VUM, first_line=6,
    ),
    Shape(
        "key-value lines with as many cells as the table",
        _text("Device;E-709", "Rate;1000", "Range;100", "", "Voltage/V;Position/µm", "0;10.25", "1.5;11", "-2.5;9.125"),
        V3, D3, (0.0, 0.001, 0.002), VUM, sample_rate=1000.0, first_line=6,
    ),
    Shape(
        "piezo controller recorder: # comments with = and the names last",
        _text("#REM PI data recorder", "#SAMPLE_TIME = 0.001", "#NDATA = 3", "#NAME0 = Voltage", "#END_HEADER",
              "0.0\t10.25", "1.5\t11", "-2.5\t9.125"),
        V3, D3, T3, ask=BY_NUMBER, sample_rate=1000.0, ending=".dat", first_line=6,
    ),
    Shape(
        "quoted names, one of them with the delimiter inside",
        _text('"Time, s","Drive voltage, V","Displacement, um"', "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "every cell quoted",
        _text('"time_s","voltage_V","displacement_um"', '"0","0","10.25"', '"0.001","1.5","11"', '"0.002","-2.5","9.125"'),
        V3, D3, T3, VUM,
    ),
    Shape(
        "pandas to_csv: an index column without a name",
        _text(",time_s,voltage_V,displacement_um", "0,0.0,0.0,10.25", "1,0.001,1.5,11.0", "2,0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "R write.table: row names without a header",
        _text('"time_s" "voltage_V" "displacement_um"', '"1" 0 0 10.25', '"2" 0.001 1.5 11', '"3" 0.002 -2.5 9.125'),
        V3, D3, T3, VUM, ending=".txt",
    ),
    Shape(
        "empty first column",
        _text(",time_s,voltage_V,displacement_um", ",0,0,10.25", ",0.001,1.5,11", ",0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "rows end with a delimiter, the header does not",
        _text("time_s,voltage_V,displacement_um", "0,0,10.25,", "0.001,1.5,11,", "0.002,-2.5,9.125,"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "the header ends with a delimiter, the rows do not",
        _text("time_s;voltage_V;displacement_um;", "0;0;10.25", "0.001;1.5;11", "0.002;-2.5;9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "clock times and a remark beside the numbers",
        _text("Date;Clock;time_s;voltage_V;displacement_um;remark", "01.02.2024;10:15:00;0;0;10,25;start",
              "01.02.2024;10:15:00;0,001;1,5;11;", "01.02.2024;10:15:01;0,002;-2,5;9,125;end, see book"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "comment lines and blank lines among the rows",
        _text("time_s,voltage_V,displacement_um", "0,0,10.25", "# amplifier switched", "0.001,1.5,11", "",
              "0.002,-2.5,9.125", "# end"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "time in milliseconds",
        _text("t_ms,voltage_V,displacement_um", "0,0,10.25", "1,1.5,11", "2,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "time in minutes",
        _text("time [min],voltage [V],displacement [um]", "0,0,10.25", "0.5,1.5,11", "1,-2.5,9.125"),
        V3, D3, (0.0, 30.0, 60.0), VUM,
    ),
    Shape(
        "units spelled out",
        _text("Time (seconds),Voltage (volts),Position (microns)", "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "old Macintosh line ends",
        _text("time_s,voltage_V,displacement_um", "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125", end="\r"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "exponents with D (Fortran)",
        _text(" 0.0D+00 0.0D+00 1.025D+01", " 1.0D-03 1.5D+00 1.100D+01", " 2.0D-03 -2.5D+00 9.125D+00"),
        V3, D3, T3, ask={"time": "1", "voltage": "2", "displacement": "3"}, ending=".dat", first_line=1,
    ),
    Shape(
        "numbers without leading or trailing digits, plus signs",
        _text("time_s,voltage_V,displacement_um", "0.,0,+10.25", ".001,+1.5,11.", "2.E-3,-2.5,9.125"),
        V3, D3, T3, VUM,
    ),
    Shape(
        "thousands separators of every kind",
        _text("time_s;voltage_V;displacement_um", "0,5;1.000,5;10 250", "1;1.234.567;1’000,5", "2;-2,5;9.125,0"),
        (1000.5, 1234567.0, -2.5), (10250.0, 1000.5, 9125.0), (0.5, 1.0, 2.0), VUM,
    ),
    Shape(
        "pipes as delimiters",
        _text("time_s|voltage_V|displacement_um", "0|0|10.25", "0.001|1.5|11", "0.002|-2.5|9.125"),
        V3, D3, T3, VUM, ending=".txt",
    ),
    Shape(
        "a single data row",
        _text("voltage_V,displacement_um", "1.5,11"),
        (1.5,), (11.0,), None, VUM,
    ),
    Shape(
        "whole numbers first, decimal commas later",
        _text("t;u;y", *["0;0;10"] * 60, "0;1,5;11,25"),
        (0.0,) * 60 + (1.5,), (10.0,) * 60 + (11.25,), (0.0,) * 61,
    ),
    Shape(
        "columns in another order, capital names",
        _text("DISPLACEMENT_UM;TIME_S;VOLTAGE_V", "10.25;0;0", "11;0.001;1.5", "9.125;0.002;-2.5"),
        V3, D3, T3, ("V", None), ask={"displacement": "1"},
    ),
    Shape(
        "! comments, told by the option",
        _text("! bench 4", "! 2024", "time_s voltage_V displacement_um", "0 0 10.25", "0.001 1.5 11", "0.002 -2.5 9.125"),
        V3, D3, T3, VUM, options=ReadingOptions(comment="!"), ending=".dat", first_line=4,
    ),
    Shape(
        "a delimiter of its own, told by the option",
        _text("time_s:voltage_V:displacement_um", "0:0:10.25", "0.001:1.5:11", "0.002:-2.5:9.125"),
        V3, D3, T3, VUM, options=ReadingOptions(delimiter=":"),
    ),
    Shape(
        "a numeric header, told by the option",
        _text("1,2,3", "0,0,10.25", "0.001,1.5,11", "0.002,-2.5,9.125"),
        V3, D3, T3, ask={"time": "1", "voltage": "2", "displacement": "3"}, options=ReadingOptions(header_lines=1),
    ),
]  # fmt: skip
