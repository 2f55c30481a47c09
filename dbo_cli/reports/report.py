"""What a report says about one or several logs, as values; ``renderers`` turns them into text.

A stream of ``SampleBlock`` with the roles of ``sample_pairs`` is all it needs: logs
larger than memory are fine, and so is a prediction that a model makes block by block
(then ``labels`` is ``("model", "measured")``). To compare, for each log::

    merit = evaluate(name, blocks, options, unit="um", sample_rate=None, figure_data=FigureData() or None)
    report = Report.of([merit, ...], options, unit="um")
    check_limits(report.judged(max_rmse=0.5))
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dbo_cli.errors import InputError, LimitError, UsageError, cleaned, counted
from dbo_cli.logs.request import Rows
from dbo_cli.logs.sample_block import SampleBlock
from dbo_cli.logs.units import in_unit
from dbo_cli.reports import sample_pairs
from dbo_cli.reports.accumulators import HalfOfError
from dbo_cli.reports.figures_of_merit import (
    TrackingFigures,
    TrackingMetrics,
    monotone_ends,
    percent_of,
)
from dbo_cli.reports.sample_pairs import Floats

if TYPE_CHECKING:
    import pandas

    from dbo_cli.reports.accumulators import FigureData

MOST_SEGMENTS = 10_000  # more are no report, and take seconds
# of the rows: fewer that make half of the squared error are said and drawn
CONCENTRATED = 0.1
PATIENCE = 1 << 18  # samples that a rest at the lowest place may last within a cycle


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
        What is compared with what: ``("desired", "measured")`` or ``("model",
        "measured")``.
    dwell : float, optional
        Only rows at which what is desired has been held for so many seconds count.
    """

    lag: int | Literal["auto"] = 0
    remove_offset: bool = False
    segment: float | Literal["cycles"] | None = None
    labels: tuple[str, str] = ("desired", "measured")
    dwell: float | None = None


@dataclass(frozen=True)
class Segment:
    """The figures of one cycle or span; its rows are data rows of the desired signal."""

    number: int
    first_row: int
    last_row: int
    figures: TrackingFigures

    def record(self) -> dict[str, Any]:
        """Return the segment as plain values under the keys of the JSON form."""
        figures = self.figures
        return {
            "number": self.number,
            "first_row": self.first_row,
            "last_row": self.last_row,
            **_record(figures),
            "offset_removed": figures.offset,
            "loop_noise": figures.loop_noise,
            "frequency_hz": figures.frequency,
        }


@dataclass(frozen=True)
class Expected:
    """What error was to be expected of a log, and the range that a model covers; in the report's unit.

    ``rmse`` is the whole error, ``shape`` that without its mean, None where they are
    not known; ``span`` the range of the model's output; ``source`` what says so.
    """

    rmse: float | None
    shape: float | None
    span: float
    source: str


@dataclass(frozen=True)
class SummaryExpected(Expected):
    """What a summary of ``compensate`` states for its move; ``source`` is the file.

    ``move_range`` holds the least and the greatest desired value of that move,
    ``move_span`` their difference where the ends are not known; None where the file
    does not say.
    """

    move_range: tuple[float, float] | None = None
    move_span: float | None = None

    def of_move(
        self, low: float, high: float, unit: str
    ) -> tuple[Expected, str | None]:
        """Return what is expected, saying of which move, and a warning where that is not this one.

        Parameters
        ----------
        low, high
            The least and the greatest desired value of what is compared.
        unit
            What follows the numbers.
        """
        compared = f"{low:.5g} to {high:.5g}{unit}"
        slack = SAME_MOVE * (high - low) + EQUAL * max(abs(low), abs(high))
        if self.move_range is not None:
            first, last = self.move_range
            same = abs(first - low) <= slack and abs(last - high) <= slack
            move = f"a move from {first:.5g} to {last:.5g}{unit}"
        elif self.move_span is not None:
            same = abs(self.move_span - (high - low)) <= slack
            move = f"a move of {self.move_span:.4g}{unit}"
            compared = f"{high - low:.4g}{unit}"
        else:
            same = False
            move = "a move that it does not describe"
        if same:
            return replace(self, source=f"{self.source} for this move"), None
        warning = (
            f"{self.source} states the error of {move}, the one compared has {compared}: "
            "the expected error may be another move's (give the summary of this move)"
        )
        return replace(self, source=f"{self.source} for {move}"), warning


@dataclass(frozen=True)
class LogReport:
    """The figures of one log; lengths in the report's unit."""

    name: str
    figures: TrackingFigures
    lag: int
    ratio_to_first: float | None = None
    segments: tuple[Segment, ...] = ()
    notes: tuple[str, ...] = ()
    expected: Expected | None = None
    warnings: tuple[str, ...] = ()

    @property
    def percent_of_range(self) -> float | None:
        """The RMSE in percent of the model's range; None where no model is known."""
        if self.expected is None:
            return None
        return percent_of(self.figures.rmse, self.expected.span)

    @property
    def expected_rmse(self) -> float | None:
        """The expected error to compare the RMSE with: with its mean, where that was not removed."""
        if self.expected is None:
            return None
        if self.figures.offset and self.expected.shape is not None:
            return self.expected.shape
        return self.expected.rmse

    @property
    def concentrated(self) -> HalfOfError | None:
        """The piece that makes half of the squared error, where it is a tenth of the rows at most."""
        half = self.figures.half
        if half is None or half.part_of_rows > CONCENTRATED:
            return None
        return half

    def record(self) -> dict[str, Any]:
        """Return the log's figures as plain values under the keys of the JSON form, segments aside."""
        figures = self.figures
        period = figures.sample_period
        record = {
            "name": self.name,
            **_record(figures),
            "lag_samples": self.lag,
            "lag_s": None if period is None else _finite(self.lag * period),
            "offset_removed": figures.offset,
            "sample_period_s": period,
            "not_finite": figures.not_finite,
            "ratio_to_first": self.ratio_to_first,
            "loop_noise": figures.loop_noise,
            "rmse_percent_of_move": figures.nrmse_percent,
            "rmse_percent_of_range": self.percent_of_range,
            "expected_rmse": self.expected_rmse,
            "half_of_error_first_row": None,
            "half_of_error_last_row": None,
            "half_of_error_percent_of_rows": None,
            "rmse_elsewhere": None,
        }
        half = figures.half
        if half is not None:
            record["half_of_error_first_row"] = half.first[0]
            record["half_of_error_last_row"] = half.last[0]
            record["half_of_error_percent_of_rows"] = 100.0 * half.part_of_rows
            record["rmse_elsewhere"] = half.rmse_elsewhere
        return record


@dataclass(frozen=True)
class Judgement:
    """Whether a log keeps a limit.

    ``title`` is the figure's name, ``value`` its value (None: undefined, which keeps no
    limit), ``unit`` what follows the numbers, and ``option`` the limit's parameter.
    """

    name: str
    title: str
    value: float | None
    limit: float
    unit: str
    option: str

    @property
    def passed(self) -> bool:
        """Whether the limit is kept."""
        return self.value is not None and self.value <= self.limit

    def words(self) -> str:
        """Say what is wrong, with the figures; of a limit that is not kept."""
        if self.value is None:
            return f"{self.name}: {self.title} is undefined, so `{self.option}` {self.limit:g} is not met"
        return (
            f"{self.name}: {self.title} {self.value:.6g}{self.unit} is above the limit of "
            f"{self.limit:g}{self.unit} by {self.value - self.limit:.3g} (`{self.option}`)"
        )

    def record(self) -> dict[str, Any]:
        """Return it as plain values for the JSON form."""
        return {
            "name": self.name,
            "figure": self.option.removeprefix("max_"),
            "limit": self.limit,
            "value": self.value,
            "passed": self.passed,
        }


@dataclass(frozen=True)
class Report:
    """What was compared, and the figures of every log in the order they were given.

    ``judgements`` are the limits that were set, of every log; none where none was.
    """

    unit: str | None
    options: ReportOptions
    logs: tuple[LogReport, ...]
    judgements: tuple[Judgement, ...] = ()

    @classmethod
    def of(
        cls, logs: Sequence[LogReport], options: ReportOptions, unit: str | None
    ) -> Report:
        """Put the logs side by side, each with its RMSE as a ratio to the first."""
        unit = None if unit is None else cleaned(unit)
        rated = []
        for log in logs:
            first = logs[0].figures.rmse
            ratio = None
            if first > 0.0:
                ratio = _finite(log.figures.rmse / first)
            rated.append(replace(log, ratio_to_first=ratio))
        return cls(unit, options, tuple(rated))

    def judged(
        self,
        *,
        max_rmse: float | str | None = None,
        max_abs: float | str | None = None,
        max_nrmse_percent: float | None = None,
        max_percent_of_range: float | None = None,
    ) -> Report:
        """Return the report with what comes of these limits.

        ``max_rmse`` and ``max_abs`` are in the report's unit, or texts with a unit of
        their own (``10nm``).

        Raises
        ------
        UsageError
            ``max_percent_of_range`` where no model says what the range is; a unit that
            cannot be converted.
        """
        unit = f" {self.unit}" if self.unit else ""
        max_rmse = self._limit("max_rmse", max_rmse)
        max_abs = self._limit("max_abs", max_abs)
        judgements = []
        for log in self.logs:
            if max_percent_of_range is not None and log.expected is None:
                raise UsageError(
                    "`max_percent_of_range` needs the range of a model (`model`, or `expected` MODEL)"
                )
            figures = log.figures
            limits = (
                ("RMSE", figures.rmse, max_rmse, unit, "max_rmse"),
                ("largest error", figures.max_abs, max_abs, unit, "max_abs"),
                (
                    "RMSE",
                    figures.nrmse_percent,
                    max_nrmse_percent,
                    " % of the move",
                    "max_nrmse_percent",
                ),
                (
                    "RMSE",
                    log.percent_of_range,
                    max_percent_of_range,
                    " % of the model's range",
                    "max_percent_of_range",
                ),
            )
            for title, value, limit, suffix, option in limits:
                if limit is not None:
                    judgements.append(
                        Judgement(log.name, title, value, limit, suffix, option)
                    )
        return replace(self, judgements=tuple(judgements))

    def _limit(self, name: str, limit: float | str | None) -> float | None:
        """Return a limit of the error in the report's unit."""
        if limit is None:
            return None
        value = in_unit(name, limit, self.unit)
        if value < 0.0:
            raise UsageError(f"`{name}`: must not be below 0, not {limit}")
        return value

    def spelled(self, spell: Callable[[str], str]) -> Report:
        """Return the report with what ``spell`` makes of its notes and warnings."""
        logs = []
        for log in self.logs:
            notes = tuple(spell(note) for note in log.notes)
            warnings = tuple(spell(warning) for warning in log.warnings)
            logs.append(replace(log, notes=notes, warnings=warnings))
        return replace(self, logs=tuple(logs))

    @property
    def missed(self) -> list[Judgement]:
        """The limits that are not kept."""
        return [judgement for judgement in self.judgements if not judgement.passed]

    @property
    def notes(self) -> list[str]:
        """What a reader of the figures has to know, a line each, all logs together."""
        return [note for log in self.logs for note in log.notes]

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the logs, a line each, all logs together."""
        return [warning for log in self.logs for warning in log.warnings]

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the log's name as index."""
        import pandas as pd

        return pd.DataFrame([log.record() for log in self.logs]).set_index("name")

    def segments_to_frame(self) -> pandas.DataFrame:
        """Return one row a segment; index: the log's name and the segment's number."""
        import pandas as pd

        rows = []
        for log in self.logs:
            for segment in log.segments:
                rows.append({"name": log.name, **segment.record()})
        keys = ["name", "number"]
        frame = pd.DataFrame(rows) if rows else pd.DataFrame(columns=keys)
        return frame.set_index(keys)


def common_unit(units: Sequence[tuple[str, str | None]]) -> str | None:
    """Return the one unit of several logs, given as (name, unit); InputError where they differ."""
    first = first_unit = None
    for name, unit in units:
        if unit is None:
            continue
        if first_unit is None:
            first = name
            first_unit = unit
        if unit != first_unit:
            raise InputError(
                f"{name}: is in {unit}, but {first} in {first_unit} (one report speaks one unit:"
                " convert one of them)"
            )
    return first_unit


def evaluate(
    name: str,
    blocks: Iterable[SampleBlock],
    options: ReportOptions,
    *,
    sample_rate: float | None = None,
    figure_data: FigureData | None = None,
    score_rows: Rows | None = None,
    count_sweep: bool = False,
) -> LogReport:
    """Compare one log, read once and never held whole.

    Parameters
    ----------
    name : str
        What the log is called in messages and in the report.
    blocks : iterable of SampleBlock
        The rows in order. To compare the rows A to B of two recorded signals, read
        ``rows_to_read((A, B), lag)``, so that the last desired rows find their measured
        ones too. A model's prediction depends on all that came before: run the model
        from the first row and give ``score_rows``.
    sample_rate : float, optional
        Samples a second, where the blocks carry no time.
    figure_data : Collector, optional
        Sees every pair, lag taken out; see ``accumulators.FigureData``.
    score_rows : (int, int or None), optional
        First and last desired row that count, of the rows that come; reading ends
        behind the last one.
    count_sweep : bool
        Let rows before time 0, where a conditioning sweep stands, take part though
        others follow. They always do where ``score_rows`` asks for them.

    Raises
    ------
    InputError
        Nothing to compare: no rows, a lag longer than the log, or no sample that is a
        number.
    UsageError
        ``segment`` in seconds where no time is known; more than 10,000 segments.
    """
    evaluation = _Evaluation(
        cleaned(name), options, sample_rate, figure_data, score_rows
    )
    if score_rows is not None or count_sweep:
        return evaluation.run(blocks)
    parts = sample_pairs.BeforeZero(blocks)
    try:
        log = evaluation.run(parts.before())
    except InputError:
        if not parts.present:
            raise
    if not parts.present:
        return log
    log = evaluation.run(parts.after())
    count = counted(parts.count, "row")
    note = f"{evaluation.name}: {count} before time 0, on the way to the move, left out"
    return replace(log, notes=(note, *log.notes))


def check_limits(report: Report, **limits: Any) -> None:
    """Raise LimitError, one line, for the first log that misses a limit; the others are counted in it.

    ``limits`` are the parameters of ``Report.judged``; without any, those it was judged
    by. A log whose figure is undefined misses its limit: a gate that cannot be judged
    is not passed.
    """
    if limits:
        report = report.judged(**limits)
    missed = report.missed
    if not missed:
        return
    words = missed[0].words()
    if len(missed) > 1:
        words += f"; {len(missed) - 1} more missed"
    raise LimitError(words)


# of the move: what the ends of a summary's move may differ by from those of the log's
SAME_MOVE = 0.01
# of the greater end besides: what figures written with few digits may differ by
EQUAL = 1e-6
# times the expected error: from which on more came than an expectation may miss
BEYOND_EXPECTED = 2.0
MOSTLY_ZERO = 0.7  # of the RMSE is the mean error: half of its square
# of the RMSE is left, at most, without the mean: nine tenths of the square are its
OFFSET_ALONE = 1.0 / 3.0


@dataclass(frozen=True)
class _Evaluation:
    """How one log is compared; each ``run`` begins anew."""

    name: str
    options: ReportOptions
    sample_rate: float | None
    figure_data: FigureData | None
    score_rows: Rows | None

    def run(self, blocks: Iterable[SampleBlock]) -> LogReport:
        """Take all blocks and return the figures."""
        name, options = self.name, self.options
        blocks, lag, notes = self._paired(blocks)
        dwells = None
        if options.dwell is not None:
            dwells = sample_pairs.Dwells(name, options.dwell, self.sample_rate)
            blocks = dwells.of(blocks)
        figures, segments = self._figures(blocks)
        if dwells is not None:
            notes.append(dwells.note())
        notes += _notes(name, options.labels, figures)
        log = LogReport(name, figures, lag, segments=segments, notes=tuple(notes))
        return _with_concentration(log)

    def _figures(
        self, blocks: Iterable[SampleBlock]
    ) -> tuple[TrackingFigures, tuple[Segment, ...]]:
        """Return the figures of all pairs, and of every segment where these are asked for."""
        options, figure_data = self.options, self.figure_data
        if figure_data is not None:
            figure_data.begin(options.labels)
        whole = self._metrics(by_parts=True)
        current = self._metrics()
        segments: list[Segment] = []
        for part in chain(self._segmented(sample_pairs.batched(blocks)), [None]):
            if part is None:
                segments += self._closed(current, len(segments) + 1)
                current = self._metrics()
                continue
            whole.add(part)
            if options.segment is not None:
                current.add(part)
            if figure_data is not None:
                figure_data.add(part)
        figures = whole.result()
        if figures is None:
            raise InputError(_nothing(self.name, options.labels, whole.missing))
        if figure_data is not None:
            figure_data.finish(whole.distribution)
        return figures, tuple(segments)

    def _paired(
        self, blocks: Iterable[SampleBlock]
    ) -> tuple[Iterator[SampleBlock], int, list[str]]:
        """Return the pairs that count, their lag taken out, the lag and the notes on it."""
        lag, rows = self.options.lag, self.score_rows
        notes = []
        if lag == "auto":
            # the lag of the rows that count, from these rows alone
            if rows is not None:
                blocks = sample_pairs.scored(blocks, rows)
                rows = None
            lag, blocks = sample_pairs.find_lag(self.name, blocks)
            notes = [
                f"{self.name}: measured follows best at a lag of {counted(lag, 'sample')}"
            ]
        pairs = sample_pairs.lagged(self.name, blocks, lag)
        if rows is not None:
            pairs = sample_pairs.scored(pairs, rows)
        return pairs, lag, notes

    def _segmented(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock | None]:
        segment = self.options.segment
        if segment is None:
            return blocks
        if segment == "cycles":
            return cycles(blocks)
        return spans(blocks, segment, self.sample_rate)

    def _metrics(self, *, by_parts: bool = False) -> TrackingMetrics:
        remove_offset, sample_rate = self.options.remove_offset, self.sample_rate
        return TrackingMetrics(
            remove_offset=remove_offset, sample_rate=sample_rate, by_parts=by_parts
        )

    def _closed(self, metrics: TrackingMetrics, number: int) -> list[Segment]:
        """Return the segment that ends here; none where it holds no number."""
        figures = metrics.result()
        if figures is None or metrics.rows is None:
            return []
        if number > MOST_SEGMENTS:
            raise UsageError(
                f"{self.name}: more than {MOST_SEGMENTS} segments (`segment` with more SECONDS)"
            )
        return [Segment(number, *metrics.rows, figures)]


def cycles(
    blocks: Iterable[SampleBlock], part: float = 0.05, patience: int = PATIENCE
) -> Iterator[SampleBlock | None]:
    """Yield the same samples, and None at the end of every cycle of the desired signal but the last.

    A cycle ends at a minimum. Turns smaller than ``part`` of the range seen so far are
    noise or rest and end none. What follows the lowest sample so far is held back until
    the signal has risen by that much, at most ``patience`` samples: a longer rest
    belongs to the cycle before it.
    """
    turns = _Turns(part)
    waiting: list[SampleBlock] = []
    start = end = 0  # stream positions of what waits
    for block in blocks:
        waiting.append(block)
        end += len(block)
        for minimum in turns.minima(block.values["desired"]):
            yield from sample_pairs.released(waiting, minimum - start)
            yield None
            start = max(start, minimum)
        sure = max(turns.candidate, end - patience)
        if sure > start:
            yield from sample_pairs.released(waiting, sure - start)
            start = sure
    yield from waiting


def spans(
    blocks: Iterable[SampleBlock], seconds: float, sample_rate: float | None
) -> Iterator[SampleBlock | None]:
    """Yield the same samples, and None at the end of every span of ``seconds`` but the last.

    Without times, a span is ``seconds * sample_rate`` samples (UsageError where that is
    not known either).
    """
    if not seconds > 0.0:
        raise UsageError(
            f"`segment` {seconds:g}: a segment must last longer than 0 seconds"
        )
    origin, current, position = math.nan, 0.0, 0
    for block in blocks:
        if block.time is not None:
            time = block.time
        elif sample_rate is not None:
            time = (position + np.arange(len(block))) / sample_rate
        else:
            raise UsageError(
                "`segment` in seconds needs a time column or `sample_rate`"
            )
        position += len(block)
        if math.isnan(origin):
            origin = float(time[0])
        # a clock that restarts or steps back must not open a segment twice: only
        # forward steps cut
        spans_gone = np.floor((time - origin) / seconds + 1e-9)
        number = np.fmax.accumulate(np.concatenate([[current], spans_gone]))
        current = float(number[-1])
        done = 0
        for place in np.flatnonzero(np.diff(number)).tolist():
            if place > done:
                yield block.part(done, place)
            yield None
            done = place
        yield block.part(done, len(block))


class _Turns:
    """Find the minima of a stream that stand deeper than a part of the range seen so far."""

    def __init__(self, part: float) -> None:
        self._part, self._samples = part, 0
        self._low, self._high = math.inf, -math.inf
        self._falling, self._extreme = True, math.inf
        # stream position before which no minimum can be found any more
        self.candidate = 0

    def minima(self, desired: Floats) -> list[int]:
        """Return the stream positions of the minima that this block confirms."""
        minima: list[int] = []
        places = monotone_ends(desired)
        places = places[np.isfinite(desired[places])]
        for place, value in zip(places.tolist(), desired[places].tolist(), strict=True):
            position = self._samples + place
            self._low, self._high = min(self._low, value), max(self._high, value)
            threshold = self._part * (self._high - self._low)
            if self._falling:
                if value <= self._extreme:
                    self._extreme = value
                    self.candidate = position
                elif value - self._extreme > threshold:
                    if self.candidate > 0:
                        minima.append(self.candidate)
                    self._falling = False
                    self._extreme = value
            elif value >= self._extreme:
                self._extreme = value
            elif self._extreme - value > threshold:
                self._falling = True
                self._extreme = value
                self.candidate = position
        self._samples += len(desired)
        if not self._falling:
            self.candidate = self._samples
        return minima


def digits(value: float | None, places: int = 4, factor: float = 1.0) -> str:
    """Return a number to ``places`` significant digits, without an exponent in 1e-3 to 1e6; None is ``-``."""
    if value is None:
        return "-"
    value *= factor
    if value == 0.0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{places - 1}e}"
    text = f"{value:#.{places}g}"
    if "e" in text:
        return f"{value:.0f}"
    return text.rstrip(".")


def judged_by_expected(
    log: LogReport, expected: Expected, unit: str | None = None
) -> LogReport:
    """Return a log with what was expected of it, and a warning where far more came, or another move.

    ``unit`` is that of the comparison.
    """
    figures = log.figures
    another = None
    if isinstance(expected, SummaryExpected):
        if expected.rmse is None:
            text = f"{log.name}: {expected.source} states no expected error"
            return replace(log, expected=expected, warnings=(*log.warnings, text))
        suffix = f" {unit}" if unit else ""
        expected, another = expected.of_move(
            figures.desired_min, figures.desired_max, suffix
        )
    log = replace(log, expected=expected)
    if another is not None:
        return replace(log, warnings=(*log.warnings, f"{log.name}: {another}"))
    rmse = log.expected_rmse
    if rmse is None or not figures.rmse > BEYOND_EXPECTED * rmse > 0.0:
        return log
    text = f"{log.name}: {digits(figures.rmse / rmse, 2)} times as much came as was expected: "
    if abs(figures.mean) > MOSTLY_ZERO * figures.rmse:
        text += (
            "most of it is the mean error: the zero has moved (`remove_offset` takes the mean off), the gain "
            "has changed (identify it again, or with `prior`), or the actuator came from elsewhere than the "
            "model takes it to (a sweep before the move, `condition`)"
        )
    else:
        text += (
            "the actuator came from elsewhere than the model takes it to (a sweep before the move, "
            "`condition`), it has changed (identify it again, or with `prior`), or the logs of the "
            "identification had no such moves"
        )
    return replace(log, warnings=(*log.warnings, text))


def _with_concentration(log: LogReport) -> LogReport:
    """Return a log with a note on the few rows that make half of its error, where they are few."""
    if log.concentrated is None:
        return log
    note = _concentrated(log.name, log.concentrated, log.figures.rmse)
    return replace(log, notes=(*log.notes, note))


def _concentrated(name: str, half: HalfOfError, rmse: float) -> str:
    """Say which rows make half of the error, and what the others have."""
    first, begin = half.first
    last, end = half.last
    rows = f"row {first}"
    if last > first:
        rows = f"rows {first} to {last}"
    if begin is not None and end is not None:
        rows += f" ({begin:.4g} to {end:.4g} s)"
    return (
        f"{name}: {rows}, {100.0 * half.part_of_rows:.2g} % of all, make "
        f"{100.0 * half.part_of_error:.0f} % of the squared error; without them the RMSE is "
        f"{half.rmse_elsewhere / rmse:.2f} of it"
    )


def _record(figures: TrackingFigures) -> dict[str, Any]:
    """Return the figures that the JSON form has of logs and of segments, in its order."""
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
        "lag_left_samples": figures.lag_left,
        "lag_left_s": figures.lag_left_seconds,
        "phase_left_degrees": figures.phase_left,
        "desired_min": figures.desired_min,
        "desired_max": figures.desired_max,
    }


def _finite(value: float) -> float | None:
    """Return a number as it is, None for one that is none: a report holds nothing that JSON cannot."""
    return value if math.isfinite(value) else None


def _nothing(name: str, labels: tuple[str, str], missing: list[int]) -> str:
    """Say why nothing can be compared: of which signal, or of which rows, no number is there."""
    total = max(missing)
    if min(missing) < total:
        empty = labels[missing.index(total)]
        choice = f"another column with `{empty}`"
        if empty == "model":
            choice = "other columns or `rows`"
        return f"{name}: {empty} holds no number in {total} rows (choose {choice})"
    return f"{name}: no row has a number in both {labels[0]} and {labels[1]} (choose other columns or `rows`)"


def _notes(name: str, labels: tuple[str, str], figures: TrackingFigures) -> list[str]:
    notes = []
    if figures.not_finite:
        count = counted(figures.not_finite, "sample")
        notes.append(
            f"{name}: {count} without a number in {labels[0]} or {labels[1]} left out"
        )
    if figures.nrmse_percent is None:
        notes.append(
            f"{name}: {labels[0]} never changes, so NRMSE, loop width and lag are undefined"
        )
    rest = math.sqrt(max(figures.rmse**2 - figures.mean**2, 0.0))
    if rest < OFFSET_ALONE * figures.rmse:
        notes.append(
            f"{name}: without the mean error {100.0 * rest / figures.rmse:.0f} % of the RMSE is left: "
            "where the mean is the sensor's zero, `remove_offset` takes it off"
        )
    return notes
