"""Reports: how well what was measured follows what was wanted, or a model what was measured.

``TrackingRun`` compares sources, ``TrackingReport`` shows what came of it,
``report_logs`` reads and writes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dbo_cli.drives.model_run import ModelRun
from dbo_cli.errors import (
    SILENT,
    InputError,
    LimitError,
    Listener,
    Remarks,
    UsageError,
    shortened,
)
from dbo_cli.hysteresis.model import ActuatorModel
from dbo_cli.hysteresis.model_file import read_model
from dbo_cli.hysteresis.model_state import START_NAMES, ModelState, StartName
from dbo_cli.hysteresis.move_error import MOST_ROWS, move_error
from dbo_cli.logs import request
from dbo_cli.logs.columns import ColumnWish, column_wish
from dbo_cli.logs.request import (
    ALL_ROWS,
    Address,
    Given,
    ReadingOptions,
    Rows,
    selected_files,
)
from dbo_cli.logs.sample_block import FloatArray, SampleBlock
from dbo_cli.logs.signal_log import SignalLog, Source, open_log, remarks_of
from dbo_cli.logs.whole_output import all_or_none, check_output, write_whole
from dbo_cli.reports import renderers
from dbo_cli.reports.accumulators import FigureData
from dbo_cli.reports.drawing import (
    Plot,
    check_folder,
    file_stems,
    require_display,
    save,
    show_in_windows,
)
from dbo_cli.reports.report import (
    Expected,
    LogReport,
    Report,
    ReportOptions,
    SummaryExpected,
    check_limits,
    common_unit,
    evaluate,
    judged_by_expected,
)
from dbo_cli.reports.sample_pairs import TrajectoryMatch, rows_to_read, with_values
from dbo_cli.runs.files import bring_to, opened, short_names, start_of
from dbo_cli.runs.jobs import Outcome
from dbo_cli.version import program_version_string

if TYPE_CHECKING:
    import pandas

Match = Literal["auto", "time", "rows"]
ELSEWHERE = "`trajectory` FILE where it lies elsewhere, or `model` MODEL to compare with a model"
SLACK = 1e-9  # of the range: what rounding may add to a drive that ends at its limit


Judge = functools.partial[LogReport]
"""``evaluate``, to which only the blocks are missing."""


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
        Only rows at which the desired signal has been held for so many seconds count:
        pixels and stairs.
    state : str or ModelState
        With ``model``, what was before the first row: ``auto``, ``empty``, ``full``,
        ``settled``, a state or a state file.
    expected : str, optional
        What states the error to expect and the model's range: a summary of
        ``compensate``, or a model. With ``model`` that one states both.
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
    state: StartName | ModelState | str = "auto"
    expected: Address | None = None

    def __post_init__(self) -> None:
        """Refuse a lag or a segment that is none (UsageError)."""
        lag, segment = self.lag, self.segment
        if lag != "auto" and (not isinstance(lag, int) or isinstance(lag, bool)):
            raise UsageError(
                f"`lag` {lag}: neither a whole number of samples nor 'auto'"
            )
        if self.dwell is not None and not 0.0 <= self.dwell < float("inf"):
            raise UsageError(f"`dwell` {self.dwell:g}: give seconds, 0 or more")
        if segment not in (None, "cycles"):
            if not isinstance(segment, int | float) or not 0.0 < segment < float("inf"):
                shown = segment if isinstance(segment, str) else f"{segment:g}"
                raise UsageError(
                    f"`segment` {shown}: neither 'cycles' nor a number of seconds above 0"
                )

    def scoring(self, with_model: bool) -> ReportOptions:
        """Return how signals are compared."""
        labels = ("model" if with_model else "desired", "measured")
        if not with_model and self.state != "auto":
            raise UsageError("`state` is where a model starts (`model`)")
        if with_model and self.expected is not None:
            raise UsageError(
                "`expected` and `model` exclude each other: the model states what to expect of it"
            )
        segment = self.segment
        if isinstance(segment, int):
            segment = float(segment)
        if with_model and self.trajectory is not None:
            raise UsageError(
                "`trajectory` and `model` exclude each other: compare with what was wanted, or with what the "
                "model predicts"
            )
        if with_model and self.dwell is not None:
            raise UsageError(
                "`dwell` and `model` exclude each other: a model's prediction is held nowhere"
            )
        return ReportOptions(self.lag, self.remove_offset, segment, labels, self.dwell)

    def wishes(self, model: ActuatorModel | None) -> dict[str, ColumnWish]:
        """Return the columns to be read of a log, as named or to be guessed.

        The drive is needed for a model alone; without one it is drawn where it is
        clear.
        """
        want = {"measured": column_wish("measured", self.measured, option="measured")}
        if model is None and self.trajectory is None:
            desired = column_wish(
                "desired", self.desired, option="desired", may_be_blank=True
            )
            want["desired"] = dataclasses.replace(desired, instead=ELSEWHERE)
        if model is not None:
            quantity, unit = model.input.quantity, model.input.unit
            want["voltage"] = column_wish(
                "voltage", self.voltage, option="voltage", quantity=quantity, unit=unit
            )
        else:
            needed = self.voltage is not None
            drive = column_wish(
                "voltage", self.voltage, required=needed, option="voltage"
            )
            want["voltage"] = dataclasses.replace(drive, by_quantity=True)
        return want


def trajectory_wishes(desired: str | None) -> dict[str, ColumnWish]:
    """Return the column of a trajectory in a file of its own: what was wanted, whatever it is called."""
    return {
        "desired": column_wish(
            "trajectory", desired, option="desired", may_be_blank=True
        )
    }


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
        log: Any,
        reading: ReadingOptions,
        options: TrackingOptions,
        name: str | None = None,
        listener: Listener = SILENT,
        time: Any = None,
    ) -> None:
        """Compare one log, block by block.

        Parameters
        ----------
        log, reading, asked
            An address, table or arrays, how it is read, and what is asked of it.
        name
            What the report calls it.
        listener
            Called after every block.
        time
            The column or the seconds of a table from Python.
        """
        trajectory = options.trajectory
        from_first = self.model is not None or trajectory is not None
        reading_of_trajectory = reading
        if trajectory is not None:
            reading, reading_of_trajectory = _scaled_apart(reading)
        reading_of_log, score_rows = rows_to_score(
            reading, options.lag, from_first=from_first
        )
        with contextlib.ExitStack() as stack:
            want = options.wishes(self.model)
            source = stack.enter_context(
                contextlib.closing(
                    opened(log, want, reading_of_log, listener, time=time)
                )
            )
            wished = None
            if trajectory is not None:
                wished = stack.enter_context(
                    open_trajectory(trajectory, options.desired, reading_of_trajectory)
                )
                listener.opened(wished.describe())
            self._bring_to_one_unit(source, wished or source)
            judge = functools.partial(
                evaluate,
                name or source.name,
                options=self.options,
                sample_rate=source.stated_rate,
                figure_data=self._new_figure_data(source) if self.traced else None,
                score_rows=score_rows,
                count_sweep=options.count_sweep or reading.rows != ALL_ROWS,
            )
            blocks = _counted(source, listener)
            if self.model is not None:
                merits, remarks = self._beside_model(
                    self.model, source, blocks, options.state, judge
                )
            else:
                merits = _beside_desired(source, blocks, wished, options.match, judge)
                remarks = remarks_of(source)
                if options.expected is not None:
                    merits = self._judged_by(options.expected, merits)
            self._merits.append(merits)
            listener.finished()
            self.remarks.add(remarks)
            self.remarks.add(Remarks(warnings=list(merits.warnings)))

    def _beside_model(
        self,
        model: ActuatorModel,
        source: Source,
        blocks: Iterator[SampleBlock],
        state: StartName | ModelState | str,
        judge: Judge,
    ) -> tuple[LogReport, Remarks]:
        """Compare what was measured with what a model makes of the drive."""
        run = ModelRun(model, source, start_of(state, model))
        run.remedies = "`rows` leaves rows out, "
        asked = judge.keywords
        drive = PredictedDrive(run, asked["count_sweep"])
        merits = judge(drive.predicted(blocks))
        expected = drive.expected(self.model_name, asked["score_rows"])
        return judged_by_expected(merits, expected), run.remarks()

    def result(self) -> TrackingReport:
        """Return the report on all sources."""
        report = Report.of(self._merits, self.options, common_unit(self._units))
        return TrackingReport(
            report, tuple(self._figure_data), self.model, self.remarks
        )

    def _bring_to_one_unit(self, source: Source, wanted: Source) -> None:
        """Compare in one unit: the model's, else that of the first log's measurement.

        ``wanted`` has the desired signal, where that lies elsewhere.
        """
        if self.model is not None:
            unit = self.model.output.unit
            bring_to(source, "voltage", self.model.input, self.model_name)
            source.convert(
                "measured",
                unit,
                f"{self.model_name} gives {self.model.output.quantity}",
            )
        else:
            unit = source.columns["measured"].unit or wanted.columns["desired"].unit
            for _, known in self._units:
                if known is not None:
                    unit = known
                    break
            source.convert("measured", unit, "the comparison is")
            wanted.convert("desired", unit, "the comparison is")
        self._units.append((source.name, unit or source.columns["measured"].unit))

    def _judged_by(self, summary_or_model: Address, merits: LogReport) -> LogReport:
        """Return a log with what a file states of its error."""
        unit = self._units[-1][1]
        return judged_by_expected(merits, stated_in(summary_or_model.text, unit), unit)

    def _new_figure_data(self, source: Source) -> FigureData:
        drive = source.columns.get("voltage")
        self._figure_data.append(FigureData(None if drive is None else drive.unit))
        return self._figure_data[-1]


def _scaled_apart(reading: ReadingOptions) -> tuple[ReadingOptions, ReadingOptions]:
    """Return how a log and its trajectory are read; a scale of what was wanted is the trajectory's."""
    of_log: list[str] = []
    of_trajectory: list[str] = []
    for scale in reading.scale:
        role = scale.partition("=")[0].strip().lower()
        if role == "desired":
            of_trajectory.append(scale)
        else:
            of_log.append(scale)
    return (
        dataclasses.replace(reading, scale=tuple(of_log)),
        dataclasses.replace(reading, scale=tuple(of_trajectory)),
    )


def _matched(
    source: Source, blocks: Iterator[SampleBlock], trajectory: Source, match: Match
) -> TrajectoryMatch:
    """Join a recording and a trajectory: by ``time``, by ``rows``, or by time where both have one."""
    by_time = match == "time" or (
        match == "auto" and source.has_time and trajectory.has_time
    )
    wanted = trajectory.blocks()
    if by_time:
        for log in (source, trajectory):
            log.require_time("`match` by time depends on it")
        if match == "auto":
            recorded, blocks = _first_time(blocks)
            begin, wanted = _first_time(wanted)
            _refuse_two_clocks(source.name, recorded, trajectory.name, begin)
    return TrajectoryMatch(
        source.name, trajectory.name, blocks, wanted, by_time=by_time
    )


def _first_time(
    blocks: Iterator[SampleBlock],
) -> tuple[float | None, Iterator[SampleBlock]]:
    """Return the time of the first sample (s; None where nothing comes), and all blocks again."""
    for block in blocks:
        if len(block):
            assert block.time is not None
            return float(block.time[0]), itertools.chain([block], blocks)
    return None, blocks


def _refuse_two_clocks(
    name: str, recorded: float | None, wanted_name: str, begin: float | None
) -> None:
    """Refuse to match by time where a recorder seems to have started its own clock with the drive.

    A drive with rows before the move begins below time 0; a recording of it that begins
    at 0 has either left these rows out or counts from the first of them. Which, nobody
    can tell.

    Raises
    ------
    InputError
        It is so.
    """
    if recorded is None or begin is None or begin >= 0.0 or recorded < 0.0:
        return
    raise InputError(
        f"{name}: it begins at {recorded:g} s, and {wanted_name} at {begin:g} s, with rows before the move: "
        "did the recorder start its clock with the first of them (`match` rows), or do both have one clock "
        "(`match` time)?"
    )


class PredictedDrive:
    """A model's prediction of a log, and of its first rows the error that the model states for them.

    Parameters
    ----------
    run
        Of the forward model over the log's drive.
    counts_before_zero
        Whether rows before time 0 take part though others follow.
    """

    def __init__(self, run: ModelRun, counts_before_zero: bool) -> None:
        self._run = run
        self._counts_before_zero = counts_before_zero
        self._drives: list[FloatArray] = []
        self._steps: list[FloatArray] = []
        self._rows = 0
        self._before_zero = 0

    def predicted(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock]:
        """Give the blocks with what the model predicts as the desired signal."""
        for block in blocks:
            drive = block.values["voltage"]
            predicted = self._run.feed(block, drive).y
            room = MOST_ROWS - self._rows
            if room > 0:
                self._keep(block, drive[:room])
            yield with_values(block, desired=predicted)

    def _keep(self, block: SampleBlock, drive: FloatArray) -> None:
        self._drives.append(drive.copy())
        steps = self._run.time_step
        if steps is not None:
            self._steps.append(np.broadcast_to(steps, len(block))[: drive.size].copy())
        if block.time is not None:
            self._before_zero += int(np.count_nonzero(block.time[: drive.size] < 0.0))
        self._rows += drive.size

    def expected(self, name: str, score_rows: Rows | None) -> Expected:
        """Return what the model states for the rows that count, of those it was shown first."""
        model = self._run.model
        span, source = model.output.span, f"{name} for this drive"
        if not self._drives:
            return Expected(None, None, span, source)
        drive = np.concatenate(self._drives)
        steps = np.concatenate(self._steps) if self._steps else None
        covered, slack = model.input, SLACK * model.input.span
        inside = (
            covered.minimum - slack <= drive.min()
            and drive.max() <= covered.maximum + slack
        )
        begin = 0
        if score_rows is not None:
            begin = score_rows[0] - 1
        elif not self._counts_before_zero and self._before_zero < drive.size:
            begin = self._before_zero
        error = move_error(model, drive, steps, begin) if inside else None
        if error is None:
            return Expected(None, None, span, source)
        return Expected(error.rmse, error.shape, span, source)


def stated_in(path: str, unit: str | None) -> Expected:
    """Return the error to expect and the model's range out of a file.

    Parameters
    ----------
    path
        A summary that ``compensate`` wrote, or a model.
    unit
        Of what is compared.

    Raises
    ------
    InputError
        The file is neither, does not say what to expect, or speaks another unit.
    """
    try:
        content = json.loads(Path(path).read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as problem:
        raise InputError(
            f"{path}: cannot be read as a summary or a model: {problem}"
        ) from None
    if isinstance(content, dict) and content.get("format") == "dbo-summary":
        stated_unit, expected = content.get("unit"), _stated_by_summary(path, content)
    else:
        model = read_model(path)
        stated_unit, span = model.output.unit, model.output.span
        rmse, shape = (
            model.fit.get("expected_rmse"),
            model.fit.get("expected_shape_rmse"),
        )
        rmse = rmse if isinstance(rmse, float) else None
        shape = shape if isinstance(shape, float) else None
        expected = Expected(rmse, shape, span, f"{path} for any move inside its range")
    if stated_unit != unit:
        raise InputError(
            f"{path}: is in {stated_unit or 'no unit'}, the comparison in {unit or 'no unit'}"
        )
    return expected


def _stated_by_summary(path: str, content: Mapping[str, Any]) -> Expected:
    """Return what a summary of ``compensate`` says of its move (InputError where it says nonsense)."""
    if content.get("version") != 1:
        raise InputError(
            f"{path}: 'version' is {_shown(content.get('version'))}, this program reads 1 "
            "(write the summary again, or update the program)"
        )
    unit = content.get("unit")
    if unit is not None and not isinstance(unit, str):
        raise InputError(f"{path}: 'unit' is {_shown(unit)}, a text is needed")
    ends = _ends_in(path, content, "model_range")
    if ends is None or ends[0] == ends[1]:
        raise InputError(
            f"{path}: 'model_range' is {_shown(content.get('model_range'))}, two different numbers are "
            "needed (a summary of compensate has them)"
        )
    rmse = _error_in(path, content, "expected_rmse")
    if rmse == 0.0:
        raise InputError(
            f"{path}: 'expected_rmse' is 0, a number above 0 or null is needed"
        )
    shape = _error_in(path, content, "expected_shape_rmse")
    percent = _error_in(path, content, "expected_percent_of_move")
    span = None
    if rmse is not None and percent:
        span = 100.0 * rmse / percent
    return SummaryExpected(
        rmse,
        shape,
        ends[1] - ends[0],
        path,
        _ends_in(path, content, "move_range"),
        span,
    )


def _ends_in(
    path: str, content: Mapping[str, Any], key: str
) -> tuple[float, float] | None:
    """Return the two ends of a range in a summary, None where it has none."""
    if key not in content:
        return None
    ends = content[key]
    if (
        isinstance(ends, list)
        and len(ends) == 2
        and all(map(_is_number, ends))
        and ends[0] <= ends[1]
    ):
        return float(ends[0]), float(ends[1])
    raise InputError(
        f"{path}: '{key}' is {_shown(ends)}, two numbers are needed, the lesser one first"
    )


def _error_in(path: str, content: Mapping[str, Any], key: str) -> float | None:
    """Return an error in a summary, None where it is null or absent."""
    value = content.get(key)
    if value is None:
        return None
    if not _is_number(value) or value < 0.0:
        raise InputError(
            f"{path}: '{key}' is {_shown(value)}, a number of at least 0 or null is needed"
        )
    return float(value)


def _is_number(value: object) -> bool:
    """Return whether a value of a JSON file is a finite number; true and false are none."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) < 1e300
    )


def _shown(value: object) -> str:
    """Return a value of a JSON file as a message repeats it."""
    return shortened(json.dumps(value))


def _beside_desired(
    source: Source,
    blocks: Iterator[SampleBlock],
    trajectory: Source | None,
    match: Match,
    judge: Judge,
) -> LogReport:
    """Compare what was measured with what was desired, in the log itself or in a trajectory."""
    if trajectory is None:
        return judge(blocks)
    matched = _matched(source, blocks, trajectory, match)
    merits = judge(matched.pairs())
    return dataclasses.replace(merits, notes=(*matched.notes(), *merits.notes))


def _counted(source: Source, listener: Listener) -> Iterator[SampleBlock]:
    """Return the blocks of a source, each counted once it is done with."""
    for block in source.blocks():
        yield block
        listener.progressed(len(block), "compared")


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
        return renderers.to_text(self.report)

    def to_json(self) -> str:
        """Return the report as JSON (``dbo-report``)."""
        return renderers.to_json(self.report)

    def to_csv(self) -> str:
        """Return the report as CSV, a line a log."""
        return renderers.to_csv(self.report)

    def to_html(self) -> str:
        """Return the report as one self-contained page with its figures."""
        of_logs, together, of_model = self._plots()
        program = program_version_string()
        return renderers.to_html(
            self.report,
            of_logs,
            comparison_plots=together,
            model_plots=of_model,
            program=program,
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
        target = check_folder(str(folder))
        of_logs, together, of_model = self._plots()
        stems = file_stems([log.name for log in self.report.logs])
        for stem, log, plots in zip(stems, self.report.logs, of_logs, strict=True):
            save(plots, target, stem, log.name)
        save(together, target, "all-logs")
        save(of_model, target, "model")

    def show(self) -> None:
        """Open matplotlib's own window for each figure, to zoom in; returns when all are closed.

        Raises
        ------
        UsageError
            There is no display, or nothing that opens windows is installed.
        """
        of_logs, together, of_model = self._plots()
        show_in_windows([*itertools.chain.from_iterable(of_logs), *together, *of_model])

    def _plots(self) -> tuple[list[list[Plot]], list[Plot], list[Plot]]:
        """Return the figures of each log, of all together, and of the model."""
        from dbo_cli.reports.figures import plots_of_comparison, plots_of_log
        from dbo_cli.reports.models import plots_of_model

        report, figure_data = self.report, self.figure_data
        if len(figure_data) != len(report.logs):
            raise UsageError("nothing was kept to draw from: compare with `traced`")
        of_logs = [
            plots_of_log(report, log, data)
            for log, data in zip(report.logs, figure_data, strict=True)
        ]
        of_model = [] if self.model is None else plots_of_model(self.model)
        return of_logs, plots_of_comparison(report, figure_data), of_model


ENDINGS = {".json": "json", ".csv": "csv", ".html": "html", ".htm": "html"}


@dataclass(frozen=True)
class ReportRun:
    """What is asked of ``report``: logs, the report's file and form, a folder for ``figures``, and limits.

    ``limits`` are the parameters of ``Report.judged``; ``show`` opens a window for each
    figure in the end. ``spelled`` spells the parameters that notes name, in reports for
    people: a shell has options instead.
    """

    logs: Sequence[Address]
    output: Address
    reading: ReadingOptions
    options: TrackingOptions
    form: str | None
    figures: str | None
    limits: Mapping[str, Any]
    show: bool = False
    spelled: Callable[[str], str] = str

    def prepared(self) -> tuple[str, list[Given]]:
        """Return the report's form and the inputs; what cannot be written is refused before the long work."""
        options, chosen = self.options, report_form(self.output, self.form)
        request.check_document(self.output, "a report", chosen)
        places = (options.model, options.trajectory, options.expected)
        inputs: list[Given] = list(self.logs)
        for place in places:
            if place is not None:
                inputs.append(place)
        if isinstance(options.state, str) and options.state not in START_NAMES:
            inputs.append(options.state)
        inputs += selected_files(
            options.desired, options.measured, options.voltage, self.reading.time
        )
        check_output(self.output, inputs)
        if self.figures is not None:
            check_folder(self.figures)
        if self.show:
            require_display()
        return chosen, inputs

    def for_readers(self, report: Report, form: str) -> Report:
        """Return what is written in a form: text and pages spell parameters as the caller does."""
        return report.spelled(self.spelled) if form in ("text", "html") else report

    def write(self, content: bytes, inputs: Sequence[Given]) -> None:
        """Write the report; a reader who has seen enough of it does not do without the figures."""
        try:
            write_whole(self.output, content, protect=inputs)
        except BrokenPipeError:
            if self.figures is None:
                raise

    def judged(self, report: Report, form: str, outcome: Outcome) -> Outcome:
        """Add what the report notes, and the first limit that a log misses, unless a channel failed."""
        outcome.last = [] if form == "text" else report.notes
        try:
            check_limits(report)
        except LimitError as missed:
            outcome.failure = outcome.failure or missed
        return outcome


@all_or_none()
def report_logs(run: ReportRun, listener: Listener = SILENT) -> Outcome:
    """Compare logs and write the report, by default in the form of the output's ending, else text."""
    options, figures = run.options, run.figures
    scoring = options.scoring(options.model is not None)
    chosen, inputs = run.prepared()
    model = None if options.model is None else read_model(options.model)
    traced = figures is not None or chosen == "html" or run.show
    tracking = TrackingRun(scoring, model, str(options.model), traced)
    names = short_names(run.logs)
    for address in run.logs:
        tracking.add(address, run.reading, options, names.get(address), listener)
    result = tracking.result()
    result = dataclasses.replace(result, report=result.report.judged(**run.limits))
    if figures is not None:
        result.figures(figures)
    shown = dataclasses.replace(result, report=run.for_readers(result.report, chosen))
    run.write(shown.rendered(chosen), inputs)
    if run.show:
        result.show()
    return run.judged(result.report, chosen, Outcome(result.remarks))


def report_form(output: Address, form: str | None) -> str:
    """Return the form of a report: as asked for, by the output's ending, else text.

    Raises
    ------
    UsageError
        The ending says another form than the one asked for.
    """
    named = ENDINGS.get(Path(output.text).suffix.lower())
    if form is not None and named not in (None, form):
        raise UsageError(
            f"{output.text}: `format` {form} contradicts this name: leave one of them out"
        )
    return form or named or "text"


def rows_to_score(
    reading: ReadingOptions, lag: int | Literal["auto"], *, from_first: bool
) -> tuple[ReadingOptions, Rows | None]:
    """Return how to read a log for the desired rows asked for, and which rows count of those that come.

    Parameters
    ----------
    reading
        As asked for; its rows are desired rows.
    lag
        Each desired row's measured one is that much further on.
    from_first
        What the log is compared with depends on all that came before (a model's
        prediction) or is found by going along (a trajectory elsewhere): read from the
        first row on, and let some of them count.

    Raises
    ------
    UsageError
        Rows of a resampled log are to count: there, rows are numbered anew.
    """
    samples = 0 if lag == "auto" else lag
    if not from_first:
        return dataclasses.replace(
            reading, rows=rows_to_read(reading.rows, samples)
        ), None
    if reading.rows == ALL_ROWS:
        return reading, None
    if reading.resample is not None:
        raise UsageError(
            "`rows` are those that were recorded, and after `resample` there are others (give one of them)"
        )
    return dataclasses.replace(
        reading, rows=(1, rows_to_read(reading.rows, samples)[1])
    ), reading.rows


def open_trajectory(
    address: Address, desired: str | None, reading: ReadingOptions
) -> SignalLog:
    """Open the file with the desired signal, on its own clock where it has one."""
    whole = dataclasses.replace(reading, rows=ALL_ROWS, time=None, sample_rate=None)
    log = open_log(address, trajectory_wishes(desired), whole)
    if log.has_time or reading.sample_rate is None:
        return log
    log.close()
    timed = dataclasses.replace(whole, sample_rate=reading.sample_rate)
    return open_log(address, trajectory_wishes(desired), timed)
