"""Tracking: how well the measured displacement follows the desired one, or a model the measurement."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NoReturn

from dbo_cli.drives.model_run import ModelRun
from dbo_cli.errors import UsageError
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.logs.addresses import Address
from dbo_cli.logs.columns import ColumnWish, wish
from dbo_cli.logs.reading_options import Rows
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.logs.sources import Source, remarks_of
from dbo_cli.remarks import SILENT, Listener, Remarks
from dbo_cli.reports.report import LogReport, Report, ReportOptions, common_unit, evaluate
from dbo_cli.reports.sample_pairs import PairBlock, TrajectoryMatch
from dbo_cli.runs.roles import bring_to
from dbo_cli.version import program_version_string

if TYPE_CHECKING:
    import pandas

    from dbo_cli.reports.thinned_curves import FigureData

Match = Literal["auto", "time", "rows"]


@dataclass(frozen=True)
class TrackingOptions:
    """What is asked of a report on logs.

    Attributes
    ----------
    lag : int or "auto"
        Samples by which measured is taken later than desired.
    remove_offset : bool
        Take the mean of the error off first.
    segment : "cycles" or float, optional
        Also report every cycle, or every so many seconds.
    desired, measured, voltage : str, optional
        The columns, guessed where not given.
    model : str, optional
        A model file: its prediction takes the place of the desired signal.
    trajectory : str, optional
        The file with the desired signal, if that is not in the logs.
    match : {"auto", "time", "rows"}
        How logs and trajectory belong together; auto: by time where both have one.
    count_sweep : bool
        Let a conditioning sweep (rows before time 0, where others follow) take part.
    dwell : float, optional
        Only rows at which the desired signal has been held for so many seconds count: pixels and stairs.
    """

    lag: int | Literal["auto"] = 0
    remove_offset: bool = False
    segment: float | Literal["cycles"] | None = None
    desired: str | None = None
    measured: str | None = None
    voltage: str | None = None
    model: str | None = None
    trajectory: Address | None = None
    match: Match = "auto"
    count_sweep: bool = False
    dwell: float | None = None

    def __post_init__(self) -> None:
        """Refuse a lag or a segment that is none (UsageError)."""
        lag, segment = self.lag, self.segment
        if lag != "auto" and (not isinstance(lag, int) or isinstance(lag, bool)):
            raise UsageError(f"`lag` {lag}: neither a whole number of samples nor 'auto'")
        if self.dwell is not None and not 0.0 <= self.dwell < float("inf"):
            raise UsageError(f"`dwell` {self.dwell:g}: give seconds, 0 or more")
        if segment not in (None, "cycles"):
            if not isinstance(segment, int | float) or not 0.0 < segment < float("inf"):
                raise UsageError(f"`segment` {segment}: neither 'cycles' nor a number of seconds above 0")

    def scoring(self, with_model: bool) -> ReportOptions:
        """Return how signals are compared."""
        labels = ("model" if with_model else "desired", "measured")
        segment = float(self.segment) if isinstance(self.segment, int) else self.segment
        if with_model and self.dwell is not None:
            raise UsageError("`dwell` and `model` exclude each other: a model's prediction is held nowhere")
        return ReportOptions(self.lag, self.remove_offset, segment, labels, self.dwell)

    def wishes(self, with_model: bool) -> dict[str, ColumnWish]:
        """Return the columns to be read of a log, as named or to be guessed."""
        want = {"measured": wish("measured", self.measured, option="measured")}
        if not with_model and self.trajectory is None:
            want["desired"] = wish("desired", self.desired, option="desired", may_be_blank=True)
        needed = with_model or self.voltage is not None
        want["voltage"] = wish("voltage", self.voltage, required=needed, option="voltage")
        return want


def trajectory_wishes(desired: str | None) -> dict[str, ColumnWish]:
    """Return the column of a trajectory in a file of its own: what was wanted, whatever it is called."""
    return {"desired": wish("trajectory", desired, option="desired", may_be_blank=True)}


@dataclass
class TrackingRun:
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
    _figure_data: list[FigureData] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Refuse a model that predicts no displacement."""
        if self.model is not None:
            self.model.require("forward", self.model_name)

    def add(
        self,
        source: Source,
        name: str | None = None,
        listener: Listener = SILENT,
        *,
        score_rows: Rows | None = None,
        count_sweep: bool = False,
        trajectory: Source | None = None,
        match: Match = "auto",
    ) -> None:
        """Compare one source, block by block.

        Parameters
        ----------
        source
            Role ``measured``; ``desired`` too, or ``voltage`` for a model to predict from.
        name
            What the report calls it.
        listener
            Called after every block.
        score_rows
            The rows that count, of all that the source gives (see ``reports.report.evaluate``).
        count_sweep
            Let rows before time 0 take part though others follow.
        trajectory
            Where the desired signal lies, if elsewhere: role ``desired``.
        match
            How the two belong together: by ``time``, by ``rows``, or by time where both have one (``auto``).
        """
        self._bring_to_one_unit(source, trajectory or source)
        figure_data = self._new_figure_data(source) if self.traced else None
        run = None if self.model is None else ModelRun(self.model, source)
        joined = None if trajectory is None else self._joined(source, trajectory, match, listener)
        log = evaluate(
            name or source.name,
            self._pairs(source, run, listener) if joined is None else joined.pairs(),
            self.options,
            sample_rate=source.stated_rate,
            figure_data=figure_data,
            score_rows=score_rows,
            count_sweep=count_sweep,
        )
        if joined is not None:
            log = dataclasses.replace(log, notes=(*joined.notes(), *log.notes))
        self._merits.append(log)
        listener.finished()
        self.remarks.add(remarks_of(source) if run is None else run.remarks())

    def result(self) -> TrackingReport:
        """Return the report on all sources."""
        report = Report.of(self._merits, self.options, common_unit(self._units))
        return TrackingReport(report, tuple(self._figure_data), self.model, self.remarks)

    def _bring_to_one_unit(self, source: Source, wanted: Source) -> None:
        """Compare in one unit: the model's, else that of the first log's measurement.

        ``wanted`` has the desired signal, where that lies elsewhere.
        """
        if self.model is not None:
            unit = self.model.output.unit
            bring_to(source, "voltage", self.model.input, self.model_name)
            source.convert("measured", unit, f"{self.model_name} gives {self.model.output.quantity}")
        else:
            known = [unit for _, unit in self._units if unit is not None]
            measured, desired = source.columns["measured"].unit, wanted.columns["desired"].unit
            unit = known[0] if known else measured or desired
            source.convert("measured", unit, "the comparison is")
            wanted.convert("desired", unit, "the comparison is")
        self._units.append((source.name, unit or source.columns["measured"].unit))

    def _new_figure_data(self, source: Source) -> FigureData:
        from dbo_cli.reports.thinned_curves import FigureData

        drive = source.columns.get("voltage")
        self._figure_data.append(FigureData(None if drive is None else drive.unit))
        return self._figure_data[-1]

    def _joined(
        self, source: Source, trajectory: Source, match: Match, listener: Listener
    ) -> TrajectoryMatch:
        """Return the pairs of a recording and a trajectory (UsageError where a model predicts)."""
        if self.model is not None:
            refuse_both()
        by_time = match == "time" or (match == "auto" and source.has_time and trajectory.has_time)
        if by_time:
            for one in (source, trajectory):
                one.require_time("`match` by time depends on it")
        return TrajectoryMatch(
            source.name, trajectory.name, counted(source, listener), trajectory.blocks(), by_time=by_time
        )

    def _pairs(self, source: Source, run: ModelRun | None, listener: Listener) -> Iterator[PairBlock]:
        for block in counted(source, listener):
            yield PairBlock.of(block, None if run is None else run.feed(block, block.values["voltage"]).y)


def refuse_both() -> NoReturn:
    """Refuse a trajectory beside a model (UsageError)."""
    raise UsageError(
        "`trajectory` and `model` exclude each other: compare with what was wanted, or with what the model"
        " predicts"
    )


def counted(source: Source, listener: Listener) -> Iterator[SampleBlock]:
    """Return the blocks of a source, each counted once it is done with."""
    for block in source.blocks():
        yield block
        listener.progressed(len(block))


@dataclass(frozen=True)
class TrackingReport:
    """A report, in every form; ``report`` holds the numbers.

    Raises
    ------
    UsageError
        A page or figures are asked for, and the comparison kept nothing to draw from.
    """

    report: Report
    figure_data: tuple[FigureData, ...]
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
        from dbo_cli.reports.figures import plots_of_comparison, plots_of_log
        from dbo_cli.reports.models import plots_of_model
        from dbo_cli.reports.page import to_html

        return to_html(
            self.report,
            [plots_of_log(self.report, log, figure_data) for log, figure_data in self._drawn()],
            comparison_plots=plots_of_comparison(self.report, self.figure_data),
            model_plots=() if self.model is None else plots_of_model(self.model),
            program=program_version_string(),
        )

    def rendered(self, form: str) -> bytes:
        """Return the report in a form.

        Parameters
        ----------
        form : {"text", "json", "csv", "html"}
            Which one; as bytes of UTF-8.
        """
        return str(getattr(self, f"to_{form}")()).encode()

    def figures(self, folder: str | Path) -> None:
        """Draw every figure, PNG and SVG.

        Parameters
        ----------
        folder
            Where to; made where it is not there.

        Raises
        ------
        OutputError
            The folder cannot be written to.
        """
        from dbo_cli.reports.drawing import check_folder, file_stems, save
        from dbo_cli.reports.figures import plots_of_comparison, plots_of_log
        from dbo_cli.reports.models import plots_of_model

        target = check_folder(str(folder))
        stems = file_stems([log.name for log in self.report.logs])
        for stem, (log, figure_data) in zip(stems, self._drawn(), strict=True):
            save(plots_of_log(self.report, log, figure_data), target, stem, log.name)
        save(plots_of_comparison(self.report, self.figure_data), target, "all-logs")
        if self.model is not None:
            save(plots_of_model(self.model), target, "model")

    def _drawn(self) -> list[tuple[LogReport, FigureData]]:
        if len(self.figure_data) != len(self.report.logs):
            raise UsageError("nothing was kept to draw from: compare with `traced`")
        return list(zip(self.report.logs, self.figure_data, strict=True))
