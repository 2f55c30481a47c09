"""Comparison: how well the measured displacement follows the desired one, or a model the measurement."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs.column_names import wish
from dbo_cli.logs.columns import ColumnWish
from dbo_cli.logs.provenance import program_version_string
from dbo_cli.reports.report import LogReport, Report, ReportOptions, common_unit, evaluate
from dbo_cli.reports.sample_pairs import PairBlock, check_alike
from dbo_cli.runs.model_run import ModelRun
from dbo_cli.runs.remarks import SILENT, Listener, Remarks
from dbo_cli.runs.roles import check_unit
from dbo_cli.runs.source import Source

if TYPE_CHECKING:
    import pandas

    from dbo_cli.reports.thinned_curves import Traces

FORMS = ("text", "json", "csv", "html")


def comparison_wishes(
    desired: str | None, measured: str | None, voltage: str | None, with_model: bool
) -> dict[str, ColumnWish]:
    """Return the columns that a comparison reads, as named or to be guessed."""
    want = {"measured": wish("measured", measured, option="measured")}
    if not with_model:
        want["desired"] = wish("desired", desired, option="desired")
    needed = with_model or voltage is not None
    want["voltage"] = wish("voltage", voltage, required=needed, option="voltage")
    return want


@dataclass
class Comparison:
    """Sources compared one after the other, and what the report and its figures need of each.

    Attributes
    ----------
    options
        How signals are compared.
    model, model_name
        With a model, its prediction takes the place of the desired signal.
    traced
        Keep what figures are drawn from.
    """

    options: ReportOptions
    model: ActuatorModel | None = None
    model_name: str = "the model"
    traced: bool = False
    remarks: Remarks = field(default_factory=Remarks)
    _merits: list[LogReport] = field(default_factory=list)
    _units: list[tuple[str, str | None]] = field(default_factory=list)
    _traces: list[Traces] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Refuse a model that predicts no displacement."""
        if self.model is not None:
            self.model.require("forward", self.model_name)

    def add(self, source: Source, name: str | None = None, listener: Listener = SILENT) -> None:
        """Compare one source, block by block; ``name`` is what the report calls it."""
        self._note_units(source)
        traces = self._new_traces(source) if self.traced else None
        run = None if self.model is None else ModelRun(self.model, source)
        self._merits.append(
            evaluate(
                name or source.name,
                self._pairs(source, run, listener),
                self.options,
                sample_rate=source.stated_rate,
                traces=traces,
            )
        )
        listener.finished()
        self.remarks.add(Remarks(list(source.notes), list(source.warnings)) if run is None else run.remarks())

    def result(self) -> ComparisonReport:
        """Return the report on all sources."""
        report = Report.of(self._merits, self.options, common_unit(self._units))
        return ComparisonReport(report, tuple(self._traces), self.model, self.remarks)

    def _note_units(self, source: Source) -> None:
        """Keep the units, and refuse a pair (or a log and a model) that speaks two."""
        measured = source.columns["measured"].unit
        if self.model is None:
            other = source.columns["desired"].unit
        else:
            other = self.model.output.unit
            check_unit(source, "voltage", self.model.input, self.model_name)
        check_alike(source.name, self.options.labels, (other, measured))
        self._units.append((source.name, measured or other))

    def _new_traces(self, source: Source) -> Traces:
        from dbo_cli.reports.thinned_curves import Traces

        drive = source.columns.get("voltage")
        self._traces.append(Traces(None if drive is None else drive.unit))
        return self._traces[-1]

    def _pairs(self, source: Source, run: ModelRun | None, listener: Listener) -> Iterator[PairBlock]:
        for block in source.blocks():
            drive = block.values.get("voltage")
            wanted = block.values["desired"] if run is None else run.feed(block, block.values["voltage"])
            yield PairBlock(block.rows, wanted, block.values["measured"], block.time, drive)
            listener.progressed(len(block))


@dataclass(frozen=True)
class ComparisonReport:
    """A report, in every form; ``report`` holds the numbers.

    Raises
    ------
    UsageError
        A page or figures are asked for, and the comparison kept nothing to draw from.
    """

    report: Report
    traces: tuple[Traces, ...]
    model: ActuatorModel | None
    remarks: Remarks

    @property
    def rmse(self) -> float:
        """RMSE of the (first) log, in the report's unit."""
        return self.report.logs[0].figures.rmse

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the log's name as index."""
        return self.report.to_frame()

    def to_text(self) -> str:
        """Return the report as a text for a terminal."""
        from dbo_cli.reports.renderers import to_text

        return to_text(self.report)

    def to_json(self) -> str:
        """Return the report as JSON (``dbo-report``)."""
        from dbo_cli.reports.renderers import to_json

        return to_json(self.report)

    def to_csv(self) -> str:
        """Return the report as CSV, a line a log."""
        from dbo_cli.reports.renderers import to_csv

        return to_csv(self.report)

    def to_html(self) -> str:
        """Return the report as one self-contained page with its figures."""
        from dbo_cli.reports.figures import plots_of_log
        from dbo_cli.reports.model_figures import plots_of_model
        from dbo_cli.reports.page import to_html

        return to_html(
            self.report,
            [plots_of_log(self.report, log, traces) for log, traces in self._drawn()],
            model_plots=() if self.model is None else plots_of_model(self.model),
            program=program_version_string(),
        )

    def rendered(self, form: str) -> bytes:
        """Return the report in one of ``FORMS``."""
        return str(getattr(self, f"to_{form}")()).encode()

    def figures(self, folder: str | Path) -> None:
        """Draw every figure into a folder, PNG and SVG.

        Raises
        ------
        OutputError
            The folder cannot be written to.
        """
        from dbo_cli.reports.drawing import check_folder, file_stems, save
        from dbo_cli.reports.figures import plots_of_log
        from dbo_cli.reports.model_figures import plots_of_model

        target = check_folder(str(folder))
        stems = file_stems([log.name for log in self.report.logs])
        for stem, (log, traces) in zip(stems, self._drawn(), strict=True):
            save(plots_of_log(self.report, log, traces), target, stem, log.name)
        if self.model is not None:
            save(plots_of_model(self.model), target, "model")

    def _drawn(self) -> list[tuple[LogReport, Traces]]:
        if len(self.traces) != len(self.report.logs):
            raise UsageError("nothing was kept to draw from: compare with `traced`")
        return list(zip(self.report.logs, self.traces, strict=True))
