"""What a report says about one or several logs, as values; ``renderers`` and ``page`` turn them into text.

A stream of ``PairBlock`` is all it needs: logs larger than memory are fine, and so is a prediction that a
model makes block by block (then ``labels`` is ``("model", "measured")``). To compare, for each log::

    merit = evaluate(name, blocks, options, unit="um", sample_rate=None, figure_data=FigureData() or None)
    report = Report.of([merit, ...], options, unit="um")
    check_limits(report, max_rmse=0.5)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.logs.plain_text import cleaned
from dbo_cli.logs.reading_options import Rows
from dbo_cli.reports.figures_of_merit import TrackingFigures, TrackingMetrics
from dbo_cli.reports.running_statistics import ErrorDistribution, Floats
from dbo_cli.reports.sample_pairs import BeforeZero, PairBlock, batched, find_lag, lagged, scored
from dbo_cli.reports.segments import cycles, spans

if TYPE_CHECKING:
    import pandas

MOST_SEGMENTS = 10_000


class Collector(Protocol):
    """What looks at every block on its way, e.g. the figure_data that figures are drawn from."""

    def begin(self, labels: tuple[str, str]) -> None:
        """Learn what is compared with what, and forget what came before."""

    def add(self, block: PairBlock) -> None:
        """Take one block."""

    def finish(self, figures: TrackingFigures, distribution: ErrorDistribution) -> None:
        """Take the figures of the whole log and the distribution of its error."""


@dataclass(frozen=True)
class ReportOptions:
    """How logs are compared.

    Attributes
    ----------
    lag : int or "auto"
        Measured is taken so many samples after desired.
    remove_offset : bool
        Take the mean error off first; of a segment, its own.
    segment : "cycles", seconds or None
        Also report every cycle of the desired signal, or every so many seconds.
    labels : pair of str
        What is compared with what: ``("desired", "measured")`` or ``("model", "measured")``.
    """

    lag: int | Literal["auto"] = 0
    remove_offset: bool = False
    segment: float | Literal["cycles"] | None = None
    labels: tuple[str, str] = ("desired", "measured")


@dataclass(frozen=True)
class Segment:
    """The figures of one cycle or span; its rows are data rows of the desired signal."""

    number: int
    first_row: int
    last_row: int
    figures: TrackingFigures

    def record(self) -> dict[str, Any]:
        """Return the segment as plain values under the keys of the JSON form."""
        rows = {"number": self.number, "first_row": self.first_row, "last_row": self.last_row}
        figures = self.figures
        own = {"offset_removed": figures.offset, "loop_noise": figures.loop_noise}
        own["frequency_hz"] = figures.frequency
        return rows | _record(figures) | own


@dataclass(frozen=True)
class LogReport:
    """The figures of one log; lengths in the report's unit."""

    name: str
    figures: TrackingFigures
    lag: int
    ratio_to_first: float | None = None
    segments: tuple[Segment, ...] = ()
    notes: tuple[str, ...] = ()

    def record(self) -> dict[str, Any]:
        """Return the log's figures as plain values under the keys of the JSON form, segments aside."""
        figures = self.figures
        period = figures.sample_period
        return {
            "name": self.name,
            **_record(figures),
            "lag_samples": self.lag,
            "lag_s": None if period is None else _finite(self.lag * period),
            "offset_removed": figures.offset,
            "sample_period_s": period,
            "not_finite": figures.not_finite,
            "ratio_to_first": self.ratio_to_first,
            "loop_noise": figures.loop_noise,
        }


@dataclass(frozen=True)
class Report:
    """What was compared, and the figures of every log in the order they were given."""

    unit: str | None
    options: ReportOptions
    logs: tuple[LogReport, ...]

    @classmethod
    def of(cls, logs: Sequence[LogReport], options: ReportOptions, unit: str | None) -> Report:
        """Put the logs side by side, each with its RMSE as a ratio to the first."""
        unit = None if unit is None else cleaned(unit)
        first = logs[0].figures.rmse if logs else 0.0
        rated = tuple(
            replace(log, ratio_to_first=_finite(log.figures.rmse / first) if first > 0.0 else None)
            for log in logs
        )
        return cls(unit, options, rated)

    @property
    def notes(self) -> list[str]:
        """What a reader of the figures has to know, a line each, all logs together."""
        return [note for log in self.logs for note in log.notes]

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the log's name as index."""
        import pandas as pd

        return pd.DataFrame([log.record() for log in self.logs]).set_index("name")

    def segments_to_frame(self) -> pandas.DataFrame:
        """Return one row a segment; index: the log's name and the segment's number."""
        import pandas as pd

        rows = [{"name": log.name, **part.record()} for log in self.logs for part in log.segments]
        keys = ["name", "number"]
        return pd.DataFrame(rows, columns=None if rows else keys).set_index(keys)


def common_unit(units: Sequence[tuple[str, str | None]]) -> str | None:
    """Return the one unit of several logs, given as (name, unit); InputError where they differ."""
    known = [(name, unit) for name, unit in units if unit is not None]
    for name, unit in known[1:]:
        if unit != known[0][1]:
            raise InputError(
                f"{name}: is in {unit}, but {known[0][0]} in {known[0][1]} (one report speaks one unit:"
                " convert one of them)"
            )
    return known[0][1] if known else None


def evaluate(
    name: str,
    blocks: Iterable[PairBlock],
    options: ReportOptions,
    *,
    sample_rate: float | None = None,
    figure_data: Collector | None = None,
    score_rows: Rows | None = None,
    count_sweep: bool = False,
) -> LogReport:
    """Compare one log, read once and never held whole.

    Parameters
    ----------
    name : str
        What the log is called in messages and in the report.
    blocks : iterable of PairBlock
        The rows in order. To compare the rows A to B of two recorded signals, read
        ``rows_to_read((A, B), lag)``, so that the last desired rows find their measured ones too. A model's
        prediction depends on all that came before: run the model from the first row and give ``score_rows``.
    sample_rate : float, optional
        Samples a second, where the blocks carry no time.
    figure_data : Collector, optional
        Sees every pair, lag taken out; see ``thinned_curves.FigureData``.
    score_rows : (int, int or None), optional
        First and last desired row that count, of the rows that come; reading ends behind the last one.
    count_sweep : bool
        Let rows before time 0, where a conditioning sweep stands, take part though others follow. They always
        do where ``score_rows`` asks for them.

    Raises
    ------
    InputError
        Nothing to compare: no rows, a lag longer than the log, or no sample that is a number.
    UsageError
        ``segment`` in seconds where no time is known; more than 10,000 segments.
    """
    comparison = _Comparison(cleaned(name), options, sample_rate, figure_data, score_rows)
    if score_rows is not None or count_sweep:
        return comparison.run(blocks)
    parts = BeforeZero(blocks)
    try:
        log = comparison.run(parts.before())
    except InputError:
        if not parts.found:
            raise
    if not parts.found:
        return log
    log = comparison.run(parts.after())
    note = f"{comparison.name}: {_counted(parts.count, 'row')} before time 0, a conditioning sweep, left out"
    return replace(log, notes=(note, *log.notes))


def check_limits(
    report: Report,
    *,
    max_rmse: float | None = None,
    max_abs: float | None = None,
    max_nrmse_percent: float | None = None,
) -> None:
    """Raise LimitError, one line, for the first log that misses a limit; the others are counted in it.

    A log whose NRMSE is undefined misses ``max_nrmse_percent``: a gate that cannot be judged is not passed.
    """
    unit = f" {report.unit}" if report.unit else ""
    limits: list[tuple[str, str, str, float | None]] = [
        ("RMSE", "rmse", unit, max_rmse),
        ("largest error", "max_abs", unit, max_abs),
        ("NRMSE", "nrmse_percent", " % of the range", max_nrmse_percent),
    ]
    missed = []
    for log in report.logs:
        for title, key, suffix, limit in limits:
            value = getattr(log.figures, key)
            if limit is None:
                continue
            if value is None:
                missed.append(
                    f"{log.name}: {title} is undefined, so `max_nrmse_percent` {limit:g} is not met"
                )
            elif not value <= limit:
                option = f"`max_{key.removeprefix('max_')}`"
                missed.append(
                    f"{log.name}: {title} {value:.6g}{suffix} is above the limit of {limit:g}{suffix}"
                    f" by {value - limit:.3g} ({option})"
                )
    if missed:
        more = f"; {len(missed) - 1} more missed" if len(missed) > 1 else ""
        raise LimitError(missed[0] + more)


@dataclass(frozen=True)
class _Comparison:
    """How one log is compared; each ``run`` begins anew."""

    name: str
    options: ReportOptions
    sample_rate: float | None
    figure_data: Collector | None
    score_rows: Rows | None

    def run(self, blocks: Iterable[PairBlock]) -> LogReport:
        """Take all blocks and return the figures."""
        name, options, figure_data = self.name, self.options, self.figure_data
        blocks, lag, notes = self._paired(blocks)
        if figure_data is not None:
            figure_data.begin(options.labels)
        whole = TrackingMetrics(remove_offset=options.remove_offset)
        segments = _SegmentFigures(name, options, self.sample_rate)
        for part in _segmented(batched(blocks), options.segment, self.sample_rate):
            if part is None:
                segments.close()
                continue
            rows = part.row_numbers()
            whole.add(part.desired, part.measured, row=rows, time=part.time)
            if options.segment is not None:
                segments.add(part, rows)
            if figure_data is not None:
                figure_data.add(part)
        figures = whole.result()
        if figures is None:
            raise InputError(_nothing(name, options.labels, whole.missing))
        segments.close()
        figures = _with_rate(figures, self.sample_rate)
        if figure_data is not None:
            figure_data.finish(figures, whole.distribution)
        notes += _notes(name, options.labels, figures)
        return LogReport(name, figures, lag, segments=tuple(segments.done), notes=tuple(notes))

    def _paired(self, blocks: Iterable[PairBlock]) -> tuple[Iterator[PairBlock], int, list[str]]:
        """Return the pairs that count, their lag taken out, the lag and what is to be said of it."""
        lag = self.options.lag
        rows = self.score_rows
        if lag == "auto":
            if rows is not None:  # the lag of the rows that count, from these rows alone
                blocks, rows = scored(blocks, rows), None
            lag, blocks = find_lag(self.name, blocks)
            notes = [f"{self.name}: measured follows best at a lag of {_counted(lag, 'sample')}"]
        else:
            notes = []
        pairs = lagged(self.name, blocks, lag)
        return (pairs if rows is None else scored(pairs, rows)), lag, notes


class _SegmentFigures:
    """The figures of the segments, one accumulator at a time; ``done`` grows with every ``close``."""

    def __init__(self, name: str, options: ReportOptions, sample_rate: float | None) -> None:
        self._name = name
        self._remove_offset = options.remove_offset
        self._sample_rate = sample_rate
        self._metrics: TrackingMetrics | None = None
        self._rows = (0, 0)
        self.done: list[Segment] = []

    def add(self, part: PairBlock, rows: Floats) -> None:
        if not len(part):
            return
        if self._metrics is None:
            self._metrics = TrackingMetrics(remove_offset=self._remove_offset)
            self._rows = (int(rows[0]), int(rows[-1]))
        self._rows = (self._rows[0], int(rows[-1]))
        self._metrics.add(part.desired, part.measured, row=rows, time=part.time)

    def close(self) -> None:
        figures = self._metrics.result() if self._metrics is not None else None
        self._metrics = None
        if figures is None:
            return
        if len(self.done) == MOST_SEGMENTS:
            raise UsageError(
                f"{self._name}: more than {MOST_SEGMENTS} segments (`segment` with more SECONDS)"
            )
        figures = _with_rate(figures, self._sample_rate)
        self.done.append(Segment(len(self.done) + 1, *self._rows, figures))


def _segmented(
    blocks: Iterator[PairBlock], segment: float | Literal["cycles"] | None, sample_rate: float | None
) -> Iterator[PairBlock | None]:
    if segment is None:
        yield from blocks
    elif segment == "cycles":
        yield from cycles(blocks)
    else:
        yield from spans(blocks, segment, sample_rate)


def _with_rate(figures: TrackingFigures, sample_rate: float | None) -> TrackingFigures:
    if figures.sample_period is not None or sample_rate is None:
        return figures
    return replace(figures, sample_period=1.0 / sample_rate)


def _record(figures: TrackingFigures) -> dict[str, Any]:
    lag, period = figures.lag_left, figures.sample_period
    return {
        "samples": figures.samples,
        "rmse": figures.rmse,
        "nrmse_percent": figures.nrmse_percent,
        "max_abs": figures.max_abs,
        "max_abs_row": figures.max_abs_row,
        "max_abs_time_s": figures.max_abs_time,
        "mean": figures.mean,
        "p95_abs": figures.p95_abs,
        "loop_width": figures.loop_width,
        "loop_width_percent": figures.loop_width_percent,
        "lag_left_samples": lag,
        "lag_left_s": None if lag is None or period is None else _finite(lag * period),
        "phase_left_degrees": figures.phase_left,
        "desired_min": figures.desired_min,
        "desired_max": figures.desired_max,
    }


def _finite(value: float) -> float | None:
    """Return a number as it is, None for one that is none: a report holds nothing that JSON cannot."""
    return value if math.isfinite(value) else None


def _nothing(name: str, labels: tuple[str, str], missing: list[int]) -> str:
    total = max(missing)
    empty = [label for label, count in zip(labels, missing, strict=True) if count == total]
    if len(empty) == 1 and min(missing) < total:
        column = f"another column with `{empty[0]}`" if empty[0] != "model" else "other columns or `rows`"
        return f"{name}: {empty[0]} holds no number in {total} rows (choose {column})"
    return f"{name}: no row has a number in both {labels[0]} and {labels[1]} (choose other columns or `rows`)"


def _notes(name: str, labels: tuple[str, str], figures: TrackingFigures) -> list[str]:
    notes = []
    if figures.not_finite:
        count = _counted(figures.not_finite, "sample")
        notes.append(f"{name}: {count} without a number in {labels[0]} or {labels[1]} left out")
    if figures.nrmse_percent is None:
        notes.append(f"{name}: {labels[0]} never changes, so NRMSE, loop width and lag are undefined")
    return notes


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}" if abs(count) == 1 else f"{count} {thing}s"
