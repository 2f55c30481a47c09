"""Logs that must be refused: name, literal content, what is asked for, and the exact words.

``{log}`` in a message stands for the file's name.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Refusal:
    """A log, how it is opened, and the one line that must come of it (exit code 1 for the log, 2 for the call)."""

    name: str
    content: bytes | None
    message: str
    ask: dict[str, str] = field(default_factory=dict)
    call: dict[str, Any] = field(default_factory=dict)
    code: int = 1
    ending: str = ".csv"


HEAD = b"time_s,voltage_V,displacement_um\n"
GOOD = b"0,0,10.25\n0.001,1.5,11\n0.002,-2.5,9.125\n"
SKIP = " (`skip_bad` drops such rows)"
THERE = "it has 1 time_s, 2 voltage_V, 3 displacement_um"

REFUSABLE = [
    Refusal("missing file", None, "{log}: no such file"),
    Refusal("empty file", b"", "{log}: the file is empty"),
    Refusal("blank lines only", b"\n\n  \n", "{log}: the file is empty"),
    Refusal("only a byte-order mark", b"\xef\xbb\xbf", "{log}: the file is empty"),
    Refusal("header only", HEAD, "{log}: no data rows: no line holds numbers"),
    Refusal("comments only", b"# a log\n# 1,2,3\n", "{log}: no data rows: no line holds numbers"),
    Refusal("prose", b"Dear colleague,\nplease find the log attached.\n", "{log}: no data rows: no line holds numbers"),
    Refusal(
        "a word in a number column", HEAD + GOOD + b"0.003,1.0,OVLD\n0.004,1,2\n",
        "{log}:5: column 'displacement_um' is not a number: 'OVLD'" + SKIP,
    ),
    Refusal(
        "a word in the first row", HEAD + b"0,OVLD,1\n" + GOOD,
        "{log}:2: column 'voltage_V' is not a number: 'OVLD'" + SKIP,
    ),
    Refusal(
        "a word in the time column", HEAD + b"0,1,1\n0.001,1,1\nlater,1,1\n",
        "{log}:4: column 'time_s' is not a number: 'later'" + SKIP,
    ),
    Refusal("an empty cell", HEAD + GOOD + b"0.003,,2\n", "{log}:5: column 'voltage_V' is empty" + SKIP),
    Refusal("a blank cell", HEAD + GOOD + b"0.003,  ,2\n", "{log}:5: column 'voltage_V' is empty" + SKIP),
    Refusal("an empty last cell", HEAD + GOOD + b"0.003,1,\n", "{log}:5: column 'displacement_um' is empty" + SKIP),
    Refusal("NaN", HEAD + GOOD + b"0.003,NaN,2\n", "{log}:5: column 'voltage_V' is not finite: 'NaN'" + SKIP),
    Refusal("nan in the first row", HEAD + b"0,nan,2\n" + GOOD, "{log}:2: column 'voltage_V' is not finite: 'nan'" + SKIP),
    Refusal("infinity", HEAD + GOOD + b"0.003,1,-inf\n", "{log}:5: column 'displacement_um' is not finite: '-inf'" + SKIP),
    Refusal("too large for a float64", HEAD + GOOD + b"0.003,1e400,1\n", "{log}:5: column 'voltage_V' is not finite: '1e400'" + SKIP),
    Refusal("Microsoft's not-a-number", HEAD + GOOD + b"0.003,1.#QNAN,1\n", "{log}:5: column 'voltage_V' is not finite: '1.#QNAN'" + SKIP),
    Refusal("NA as R writes it", HEAD + GOOD + b"0.003,NA,1\n", "{log}:5: column 'voltage_V' is not a number: 'NA'" + SKIP),
    Refusal("a dash", HEAD + GOOD + b"0.003,-,1\n", "{log}:5: column 'voltage_V' is not a number: '-'" + SKIP),
    Refusal("two decimal points", HEAD + GOOD + b"0.003,1.2.3,1\n", "{log}:5: column 'voltage_V' is not a number: '1.2.3'" + SKIP),
    Refusal("a thousand or one among decimal commas", b"t;u;y\n0,1;1,5;2\n0,2;1.000;2\n", "{log}:3: column 'u' is not a number: '1.000'" + SKIP),
    Refusal("a point among decimal commas", b"t;u;y\n0,1;1,5;2\n0,2;1.5;2\n", "{log}:3: column 'u' is not a number: '1.5'" + SKIP),
    Refusal("an underscore", HEAD + GOOD + b"0.003,1_000,1\n", "{log}:5: column 'voltage_V' is not a number: '1_000'" + SKIP),
    Refusal("hexadecimal", HEAD + GOOD + b"0.003,0x1F,1\n", "{log}:5: column 'voltage_V' is not a number: '0x1F'" + SKIP),
    Refusal("digits of another script", HEAD + GOOD + "0.003,١,1\n".encode(), "{log}:5: column 'voltage_V' is not a number: '١'" + SKIP),
    Refusal("a number with its unit", HEAD + GOOD + b"0.003,1.5 V,1\n", "{log}:5: column 'voltage_V' is not a number: '1.5 V'" + SKIP),
    Refusal("a cell out of a spreadsheet", HEAD + GOOD + b"0.003,#DIV/0!,1\n", "{log}:5: column 'voltage_V' is not a number: '#DIV/0!'" + SKIP),
    Refusal("a very long cell", HEAD + GOOD + b"0.003," + b"x" * 500 + b",1\n", "{log}:5: column 'voltage_V' is not a number: '" + "x" * 37 + "...'" + SKIP),
    Refusal("a short row", HEAD + GOOD + b"0.003,1\n0.004,1,1\n", "{log}:5: 2 cells where the other rows have 3" + SKIP),
    Refusal("a long row", HEAD + GOOD + b"0.003,1,2,3\n0.004,1,1\n", "{log}:5: 4 cells where the other rows have 3" + SKIP),
    Refusal("a short row after a long one", HEAD + GOOD + b"0.003,1,2,3\n0.004,1\n", "{log}:5: 4 cells where the other rows have 3" + SKIP),
    Refusal("a row cut off at the end", HEAD + GOOD + b"0.003", "{log}:5: 1 cell where the other rows have 3" + SKIP),
    Refusal("a second header in the middle (files joined)", HEAD + GOOD + HEAD + GOOD, "{log}:5: column 'voltage_V' is not a number: 'voltage_V'" + SKIP),
    Refusal("a closing remark", HEAD + GOOD + b"End of data\n", "{log}:5: 1 cell where the other rows have 3" + SKIP),
    Refusal("a quote that is never closed", HEAD + GOOD + b'0.003,"1,2\n', "{log}:5: column 'voltage_V' is not a number: '\"1'" + SKIP),
    Refusal("a bad cell right after comments", HEAD + b"# on\n\n0,0,10\n# off\n0.001,x,1\n", "{log}:6: column 'voltage_V' is not a number: 'x'" + SKIP),
    Refusal("a bad cell in a log without header", b"0,0,1\n1,1,2\n2,off,3\n", "{log}:3: column 2 is not a number: 'off'" + SKIP, {"voltage": "2", "displacement": "3"}),
    Refusal("names for other columns than there are", b"a,b,c,d,e\n1,2,3\n4,5,6\n", "{log}: there is no column 'a': it has 3 columns without names", {"voltage": "a"}),
    Refusal("named column absent", HEAD + GOOD, "{log}: there is no column 'volts': " + THERE, {"voltage": "volts"}),
    Refusal("named column in a log without names", b"1,2\n3,4\n", "{log}: there is no column 'voltage': it has 2 columns without names", {"voltage": "voltage"}),
    Refusal("column number past the end", HEAD + GOOD, "{log}: there is no column 4: it has 3 columns", {"voltage": "4"}),
    Refusal("column number 0", HEAD + GOOD, "`voltage` 0: columns are counted from 1", {"voltage": "0"}, code=2),
    Refusal("negative column number", HEAD + GOOD, "`voltage` -1: columns are counted from 1", {"voltage": "-1"}, code=2),
    Refusal("a name that occurs twice", b"t,u,u,y\n0,1,2,3\n1,2,3,4\n", "{log}: column 'u' occurs more than once: give its number (`voltage` 2 or 3)", {"voltage": "u"}),
    Refusal("a guess that finds two", b"t,drive,u,y\n0,1,2,3\n1,2,3,4\n", "{log}: which column is the voltage, 'drive' or 'u'? (choose with `voltage` NAME or NUMBER)"),
    Refusal("a guess that finds none", b"t,ch1,ch2\n0,1,2\n1,2,3\n", "{log}: no column is recognised as the voltage nor as the displacement: it has 1 t, 2 ch1, 3 ch2 (`voltage` 'ch1' `displacement` 'ch2', or `voltage` 'ch2' `displacement` 'ch1')"),
    Refusal("no names to guess from", b"0,1,2\n1,2,3\n", "{log}: it has 3 columns without names: which is the voltage, which the displacement? (such as `time` 1 `voltage` 2 `displacement` 3)"),
    Refusal("two time columns", b"t,time,u,y\n0,0,1,2\n1,1,2,3\n", "{log}: which column is the time, 't' or 'time'? (choose with `time` NAME or NUMBER)"),
    Refusal("a clock time cut off", b"time,u,y\n10:15:00,1,2\n10:15:01,2,3\n10:15,3,4\n", "{log}:4: column 'time' is not a time stamp like the others: '10:15'" + SKIP),
    Refusal("a time column that is absent", HEAD + GOOD, "{log}: there is no column 'zeit': " + THERE, call={"time": "zeit"}),
    Refusal("a sample rate beside a time column", HEAD + GOOD, "`time` and `sample_rate` exclude each other: the log has the one or needs the other", call={"time": "1", "sample_rate": 10.0}, code=2),
    Refusal("a negative sample rate", HEAD + GOOD, "`sample_rate` -1: give a positive number of samples a second", call={"sample_rate": -1.0}, code=2),
    Refusal("rows beyond the end", HEAD + GOOD, "{log}: `rows` 7:9 is beyond the last data row", call={"rows": "7:9"}),
    Refusal("rows back to front", HEAD + GOOD, "`rows` 9:7: rows are counted from 1, and the last is not before the first", call={"rows": "9:7"}, code=2),
    Refusal("rows that are no range", HEAD + GOOD, "`rows` 5: give A:B, data rows counted from 1, both ends included", call={"rows": "5"}, code=2),
    Refusal("nothing left after dropping", HEAD + b"0,x,1\n1,y,2\n", "{log}: no good data row", call={"skip_bad": True}),
    Refusal("an unknown delimiter", HEAD + GOOD, "`delimiter` colons: give a single character or one of comma, semicolon, tab, blanks, space, pipe", call={"delimiter": "colons"}, code=2),
    Refusal("an unknown decimal sign", HEAD + GOOD, "`decimal` dot: give point or comma", call={"decimal": "dot"}, code=2),
    Refusal("an unknown encoding", HEAD + GOOD, "`encoding` klingon: there is no such text encoding", call={"encoding": "klingon"}, code=2),
    Refusal("an unknown format", HEAD + GOOD, "`format` xml: the formats are csv, tsv, txt, dat, h5, hdf5", call={"format": "xml"}, code=2),
    Refusal("an Excel workbook", b"PK\x03\x04rest", "{log}: this is not a text log but a zip archive: a workbook ends in .xlsx, a NumPy archive in .npz"),
    Refusal("an old MATLAB file", b"MATLAB 5.0 MAT-file, Platform", "{log}: damaged MATLAB file: it ends early", ending=".dat"),
    Refusal("a binary file", b"\x00\x01\x02\x03\xff\x00\x10" * 50, "{log}: this is a binary file, not a text log: export it as CSV or HDF5", ending=".dat"),
    Refusal("a binary file that begins like text", HEAD + GOOD + b"\x00" * 50, "{log}:5: 1 cell where the other rows have 3" + SKIP),
    Refusal("a gzip file cut off", gzip.compress(HEAD + GOOD * 2000)[:-30], "{log}: the gzip data are damaged or end early", ending=".csv.gz"),
    Refusal("garbage called gzip", b"\x1f\x8bgarbage garbage", "{log}: the gzip data are damaged or end early", ending=".csv.gz"),
    Refusal("text called HDF5", HEAD + GOOD, "{log}: cannot be read as HDF5: file signature not found", ending=".h5"),
    Refusal("a group of a text file", HEAD + GOOD, "{log}::/a: '::' names a group of an HDF5 file, and this is a text file", call={"suffix": "::/a"}, code=2),
]  # fmt: skip
