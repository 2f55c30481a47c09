"""The table of formats as a page: ``python -m tests.shapes.format_table > docs/instruments-formats.md``."""

from __future__ import annotations

import shlex

from tests.shapes.format_files import LIBRARY_FILES, FormatFile
from tests.shapes.instrument_files import INSTRUMENT_FILES
from tests.shapes.laboratory_files import LABORATORY_FILES

HEAD = """# Formats: what is read, how, and what is refused

Each line is a file that the tests write and read (`tests/extras/test_logs_formats.py`); this page is made from the same
list (`python -m tests.shapes.format_table > docs/instruments-formats.md`), so it cannot say anything else: what is read
right comes out bit for bit, what is refused is refused in these words, and the remedy that is named is followed by
`tests/extras/test_logs_remedies.py`. "By hand" means after public descriptions, "after" a library: as a file that it wrote. A file says by its first bytes what it is, whatever its name. Where a command
stands, time, voltage, displacement and their units come out right with it; what is said on the way stands behind it. In messages a parameter stands in backticks: `sample_rate` is
`--sample-rate` on the command line.

Excel needs `pip install fastexcel`, TDMS `pip install npTDMS`, UFF `pip install pyuff`, in the environment of `dbo`; all three come
with `pip install -e ".[formats]"` in a checkout;
everything else is read by what `dbo` needs anyway.

JSON, UFF, Igor's text and tables of data bases (a row for each value, several rows a stamp) are read as a whole, and
not through a pipe.

`FILE::NAME` addresses a part: an HDF5 group or dataset, a MATLAB struct, a workbook's sheet, a TDMS group. Where
drive and displacement were recorded by two instruments, give one file as the log and name the other's column as
`FILE::COLUMN` (`dbo identify sensor.csv --voltage drive.csv::CH1`): rows are matched by number, clocks must agree,
and the files must be equally long. The time may lie in a file of its own, too (`--time clock.csv::t`). The model keeps
the name and digest of every file.

A rate that a file states (`sample_rate`, `fs`, `dt`, `Ts`, `SAMPLE_TIME`, `Delta_X`, `Increment`, `wf_increment`, …)
is used where the log has no time column. Its unit is converted (kHz, ms, S/s); an unknown unit, or two statements
that disagree, are refused; without a unit Hz or s is assumed, and that is said. netCDF's `scale_factor`,
`add_offset` and `_FillValue` are applied, an HDF5 attribute `scale` is applied and said, and attributes such as
`gain` or `offset` are not applied, which is said.
"""


def table(title: str, files: list[FormatFile]) -> str:
    """Write one table."""
    lines = [f"## {title}", "", "| file | written by | outcome |", "|---|---|---|"]
    lines += [f"| {one.name} (`{one.ending}`) | {one.writer} | {outcome(one)} |" for one in files]
    return "\n".join(lines)


def outcome(one: FormatFile) -> str:
    """Say what comes of reading a file."""
    if one.refusal:
        return f"refused: {_shown(one, one.refusal)}"
    asked = [f" --{role} {shlex.quote(name)}" for role, name in one.ask.items()]
    asked += [f" --sample-rate {one.sample_rate:g}"] if one.sample_rate else []
    command = f"dbo identify {shlex.quote(f'run{one.ending}{one.group}')}{''.join(asked)}"
    told = f"; says: {' '.join(_shown(one, note) for note in one.notes)}" if one.notes else ""
    return f"`{command}`{told}"


def _shown(one: FormatFile, words: str) -> str:
    return words.replace("{file}", f"run{one.ending}").removeprefix(": ").replace("|", "\\|")


def page() -> str:
    """Write the whole page."""
    files = table("Written by libraries and programs", LIBRARY_FILES)
    laboratory = table("From laboratories, data bases and boards", LABORATORY_FILES)
    return f"{HEAD}\n{files}\n\n{laboratory}\n\n{table('Text of instruments', INSTRUMENT_FILES)}\n"


if __name__ == "__main__":
    print(page(), end="")
