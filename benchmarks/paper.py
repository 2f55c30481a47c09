"""Section V of Aye and Ang (2018) from the authors' own recordings: published beside ours, Figs. 5 to 13.

    python benchmarks/paper.py FOLDER OUT

FOLDER holds ``identification.dat`` and ``uncompensated.dat``, or, as the authors
publish them, ``Model_Vi_Do.dat`` and ``Test_Vi_Do_Di.dat`` (repository
yan9a/DiscreteBacklashOperator on GitHub, folder MatLabCode/DiscreteBacklashModel, MIT
licence). The compensated part (Figs. 11 to 13) is at the end of the latter, rows 11152
to 12151. Writes the figures and ``report.html`` to OUT; exit code 1 where a figure of
ours is not the published one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dbo_cli.errors import DboError, InputError
from dbo_cli.hysteresis.identification import (
    Identification,
    IdentificationOptions,
    Recording,
    identify,
)
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.request import ReadingOptions, Rows
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.logs.signal_log import open_log
from dbo_cli.logs.whole_output import write_whole
from dbo_cli.reports.accumulators import FigureData
from dbo_cli.reports.drawing import Plot, check_folder, save
from dbo_cli.reports.figures import plots_of_log
from dbo_cli.reports.models import plots_of_model
from dbo_cli.reports.renderers import to_html
from dbo_cli.reports.report import LogReport, Report, ReportOptions, evaluate
from dbo_cli.reports.sample_pairs import Floats, rows_to_read, with_values
from dbo_cli.version import program_version_string

RATE = 200.0
CYCLE = (3152, 3351)
UNCOMPENSATED = (5052, 6051)
COMPENSATED = (11152, 12151)
LAG = 1
COLUMNS = {"voltage": "1", "measured": "5", "desired": "9"}


@dataclass(frozen=True)
class Line:
    """One published figure: what it is, what the paper says, what we find, how far it may be off."""

    what: str
    published: float
    found: float | None
    tolerance: float
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether ours is the published one; what is not at hand does not count against it."""
        return self.found is None or abs(self.found - self.published) <= self.tolerance

    def text(self) -> str:
        """Return the line as it is printed."""
        found = "not at hand" if self.found is None else f"{self.found:.4f} {self.unit}"
        mark = "" if self.found is None else "   ok" if self.holds else "   DIFFERS"
        return f"{self.what:<48}{f'{self.published:g} {self.unit}':>11}{found:>14}{mark}".rstrip()


def read(path: Path, roles: tuple[str, ...], rows: Rows) -> SampleBlock:
    """Return the wanted columns of the wanted rows."""
    wish = {role: ColumnWish(COLUMNS[role]) for role in roles}
    with open_log(str(path), wish, ReadingOptions(sample_rate=RATE, rows=rows)) as log:
        return log.read()


def existing(folder: Path, *names: str) -> Path:
    """Return the first of several names that is there."""
    for name in names:
        if (folder / name).is_file():
            return folder / name
    raise InputError(
        f"{folder}: neither {' nor '.join(names)} is there (README.md says where they are public)"
    )


def identified(path: Path) -> Identification:
    """Identify as the paper does: 25 gears, one cycle, the mean of the sensor as zero."""
    block = read(path, ("voltage", "measured"), CYCLE)
    recording = Recording(
        path.name,
        block.values["voltage"],
        block.values["measured"],
        None,
        1.0 / RATE,
        "V",
        "um",
    )
    options = IdentificationOptions(gears=25, method="paper", zero="mean")
    return identify([recording], options, [])


def modelled(path: Path, model: ActuatorModel) -> Iterator[SampleBlock]:
    """Yield one cycle of the identification log beside the model, which has seen the cycle before."""
    first = CYCLE[0] - 200
    block = read(path, ("voltage", "measured"), (first, CYCLE[1]))
    voltage = block.values["voltage"]
    state = model.start(float(voltage[0]), "auto")
    output = model.simulate(voltage, state, time_step=1.0 / RATE).y
    whole = with_values(block, desired=output)
    yield whole.part(200, len(whole))


def tracked(path: Path, rows: Rows) -> Iterator[SampleBlock]:
    """Yield desired and measured displacement of the test log."""
    yield read(path, ("desired", "measured", "voltage"), rows_to_read(rows, LAG))


def has_rows(path: Path, last: int) -> bool:
    """Return whether a text log reaches a row."""
    with path.open("rb") as lines:
        return sum(1 for _ in lines) >= last


def numbered(
    plots: list[Plot], numbers: dict[str, int], folder: Path, note: str
) -> list[Plot]:
    """Save the figures that the paper has, under its numbers, and return them."""
    chosen = [plot for plot in plots if plot.key in numbers]
    for plot in chosen:
        save([plot], folder, f"fig{numbers[plot.key]:02d}", note)
    return chosen


def evaluated(
    name: str, blocks: Iterator[SampleBlock], options: ReportOptions
) -> tuple[LogReport, FigureData]:
    """Compare one log and keep what its figures need."""
    figure_data = FigureData("V")
    return evaluate(
        name, blocks, options, sample_rate=RATE, figure_data=figure_data
    ), figure_data


def main(argv: list[str] | None = None) -> int:
    """Print the table, write figures and page; 1 where a figure is not the published one."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args(argv)
    try:
        return reproduce(given.folder, check_folder(str(given.out)))
    except DboError as problem:
        print(f"paper: {problem}", file=sys.stderr)
        return problem.exit_code


def reproduce(folder: Path, out: Path) -> int:
    """Do the work of ``main``."""
    first = existing(folder, "identification.dat", "Model_Vi_Do.dat")
    second = existing(folder, "uncompensated.dat", "Test_Vi_Do_Di.dat")
    model = identified(first).model
    scale = model.stages[-1]
    drive = read(first, ("voltage",), (CYCLE[0], CYCLE[1] + 600)).values["voltage"]
    modelling = ReportOptions(remove_offset=True, labels=("model", "measured"))
    fit, fit_traces = evaluated("identification", modelled(first, model), modelling)
    tracking = ReportOptions(lag=LAG, remove_offset=True)
    pairs = [evaluated("uncompensated", tracked(second, UNCOMPENSATED), tracking)]
    if has_rows(second, 12152):
        pairs.append(evaluated("compensated", tracked(second, COMPENSATED), tracking))
    found = [log.figures.rmse for log, _ in pairs] + [None]
    lines = [
        Line(
            "Control input, peak to peak (Fig. 5)", 3.6, float(np.ptp(drive)), 5e-4, "V"
        ),
        Line("Control input, period", 1.0, period_of(drive), 1e-3, "s"),
        Line(
            "K of the identified model (n = 25)",
            12.53,
            getattr(scale, "gain", None),
            5e-3,
            "um/V",
        ),
        Line("X_0", 0.0, model.backlash.x0, 1e-6, "V"),
        Line("Y_0", -22.97, getattr(scale, "offset", None), 5e-3, "um"),
        Line("RMSE without compensation (Figs. 8 to 10)", 1.68, found[0], 5e-3, "um"),
        Line("RMSE with compensation (Figs. 11 to 13)", 0.58, found[1], 5e-3, "um"),
    ]
    print("Section V of Aye and Ang (2018), from the authors' recordings\n")
    print(f"{'':<48}{'published':>11}{'here':>14}")
    print("\n".join(line.text() for line in lines))
    print(
        f"\nOur fit of that cycle with 25 gears (Figs. 6 and 7): RMSE {fit.figures.rmse:.4f} um"
    )

    fits = Report.of([fit], modelling, "um")
    fit_plots = plots_of_log(fits, fit, fit_traces)
    numbered(
        fit_plots, {"drive": 5, "tracking": 6, "loop": 7}, out, "identification log"
    )
    report = Report.of([log for log, _ in pairs], tracking, "um")
    drawn = []
    for number, (log, (_, figure_data)) in enumerate(
        zip(report.logs, pairs, strict=True)
    ):
        plots = plots_of_log(report, log, figure_data)
        start = 8 + 3 * number
        numbered(
            plots,
            {"tracking": start, "error": start + 1, "output": start + 2},
            out,
            f"{log.name} log",
        )
        drawn.append(plots)
    save(plots_of_model(model), out, "model")
    page = to_html(
        report,
        drawn,
        model_plots=[*fit_plots, *plots_of_model(model)],
        title="Section V, from the authors' recordings",
        program=program_version_string(),
    )
    write_whole(str(out / "report.html"), page.encode())
    print(
        f"{len(list(out.glob('*.png')))} figures (PNG and SVG) and report.html are in {out}"
    )
    return 0 if all(line.holds for line in lines) else 1


def period_of(drive: Floats) -> float:
    """Return the mean time between two rises through the middle of the range, in seconds."""
    high = drive >= 0.5 * (drive.min() + drive.max())
    rises = np.flatnonzero(high[1:] & ~high[:-1])
    return float(np.mean(np.diff(rises))) / RATE


if __name__ == "__main__":
    sys.exit(main())
