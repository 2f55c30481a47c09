"""Section V of Aye and Ang (2018) from the authors' own recordings: published beside ours, with figures.

    python benchmarks/paper.py FOLDER OUT

FOLDER holds ``identification.dat`` and ``uncompensated.dat``, or, as the authors
publish them, ``Model_Vi_Do.dat`` and ``Test_Vi_Do_Di.dat`` (repository
yan9a/DiscreteBacklashOperator on GitHub, folder MatLabCode/DiscreteBacklashModel, MIT
licence). The compensated part (Figs. 11 to 13) is at the end of the latter. OUT gets a
page and figures of each part. Exit code 1 where a figure of ours is not the published
one.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import DboError, InputError
from dbo_cli.files import write_text
from dbo_cli.identification import Options, Recording, identify
from dbo_cli.model import Cascade, Scale
from dbo_cli.reports import Pair, Report

Floats = NDArray[np.float64]
RATE = 200.0  # Hz
VOLTAGE, MEASURED, DESIRED = 0, 4, 8  # columns of the files
CYCLE = (3152, 3351)  # rows from 1, both included
UNCOMPENSATED = (5052, 6051)
COMPENSATED = (11152, 12151)
LAG = 1  # rows by which the sensor is late


class Line(NamedTuple):
    """A published figure, ours (None: not at hand), and by how much they may differ."""

    what: str
    published: float
    ours: float | None
    tolerance: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether ours is the published one; what is not at hand does not count against it."""
        return self.ours is None or abs(self.ours - self.published) <= self.tolerance

    def text(self) -> str:
        """Return the line as it is printed."""
        ours, mark = "not at hand", ""
        if self.ours is not None:
            ours = f"{self.ours:.4f} {self.unit}"
            mark = "   ok" if self.holds else "   DIFFERS"
        published = f"{self.published:g} {self.unit}"
        return f"{self.what:<44}{published:>12}{ours:>15}{mark}".rstrip()


def table_of(folder: Path, *names: str) -> Floats:
    """Return the rows of the first file that is there."""
    for name in names:
        if (folder / name).is_file():
            return np.loadtxt(folder / name)
    raise InputError(f"{folder}: holds neither {' nor '.join(names)}: download them")


def rows_of(table: Floats, rows: tuple[int, int], column: int) -> Floats:
    """Return some rows of a column, counted from 1."""
    return np.ascontiguousarray(table[rows[0] - 1 : rows[1], column])


def identified(table: Floats) -> Cascade:
    """Identify as the paper does: 25 gears from one cycle, the sensor's mean as zero."""
    voltage = rows_of(table, CYCLE, VOLTAGE)
    displacement = rows_of(table, CYCLE, MEASURED)
    clock = np.arange(voltage.size) / RATE
    recording = Recording("one cycle", voltage, displacement, clock)
    return identify([recording], Options(method="paper", gears=25, zero="mean"))


def fit_of(table: Floats, model: Cascade) -> Report:
    """Compare the model with its cycle; the cycle before it sets the state."""
    rows = (CYCLE[0] - 200, CYCLE[1])
    voltage = rows_of(table, rows, VOLTAGE)
    predicted, _ = model.simulate(voltage)
    pair = Pair("identification", predicted, rows_of(table, rows, MEASURED),
                time=np.arange(len(voltage)) / RATE, voltage=voltage, rows=(201, 400))  # fmt: skip
    return Report([pair], unit="um", voltage_unit="V", remove_offset=True,
                     model=model)  # fmt: skip


def tracking_of(table: Floats) -> Report:
    """Compare desired and measured displacement, uncompensated and, where it is there, compensated."""
    whole = Pair("log", table[:, DESIRED], table[:, MEASURED],
                 time=np.arange(len(table)) / RATE, voltage=table[:, VOLTAGE])  # fmt: skip
    pairs = [replace(whole, name="uncompensated", rows=UNCOMPENSATED)]
    if len(table) >= COMPENSATED[1] + LAG:
        pairs.append(replace(whole, name="compensated", rows=COMPENSATED))
    return Report(pairs, unit="um", voltage_unit="V", lag=LAG, remove_offset=True)


def period_of(drive: Floats) -> float:
    """Return the mean time between two rises through the middle of the range (s)."""
    high = drive >= 0.5 * (drive.min() + drive.max())
    rises = np.flatnonzero(high[1:] & ~high[:-1])
    return float(np.mean(np.diff(rises))) / RATE


def reproduce(folder: Path, out: Path) -> bool:
    """Print the table and write page and figures; return whether all figures are the published ones."""
    first = table_of(folder, "identification.dat", "Model_Vi_Do.dat")
    second = table_of(folder, "uncompensated.dat", "Test_Vi_Do_Di.dat")
    model = identified(first)
    [scale] = [stage for stage in model.stages if isinstance(stage, Scale)]
    drive = rows_of(first, (CYCLE[0], CYCLE[1] + 600), VOLTAGE)
    fit, tracking = fit_of(first, model), tracking_of(second)
    errors = [log["rmse"] for log in tracking.logs]
    compensated = errors[1] if len(errors) > 1 else None
    lines = [
        Line("Drive, peak to peak (Fig. 5)", 3.6, float(np.ptp(drive)), 5e-4, "V"),
        Line("Drive, period", 1.0, period_of(drive), 1e-3, "s"),
        Line("K of the model of 25 gears", 12.53, scale.gain, 5e-3, "um/V"),
        Line("X_0", 0.0, model.gears.x0, 1e-6, "V"),
        Line("Y_0", -22.97, scale.offset, 5e-3, "um"),
        Line("RMSE uncompensated (Figs. 8 to 10)", 1.68, errors[0], 5e-3, "um"),
        Line("RMSE compensated (Figs. 11 to 13)", 0.58, compensated, 5e-3, "um"),
    ]
    print(f"{'Section V of Aye and Ang (2018)':<44}{'published':>12}{'here':>15}")
    for line in lines:
        print(line.text())
    print(f"The model on its own cycle (Figs. 6 and 7): RMSE {fit.rmse:.4f} um")
    out.mkdir(parents=True, exist_ok=True)
    files = [*fit.figures(out / "fit"), *tracking.figures(out / "tracking")]
    write_text(out / "fit.html", fit.to_html())
    write_text(out / "tracking.html", tracking.to_html())
    print(f"{out}: {len(files)} figures, fit.html and tracking.html")
    return all(line.holds for line in lines)


def main() -> int:
    if len(sys.argv) != 3:
        print("usage: python benchmarks/paper.py FOLDER OUT", file=sys.stderr)
        return 2
    try:
        return 0 if reproduce(Path(sys.argv[1]), Path(sys.argv[2])) else 1
    except DboError as problem:
        print(f"paper: {problem}", file=sys.stderr)
        return problem.exit_code


if __name__ == "__main__":
    sys.exit(main())
