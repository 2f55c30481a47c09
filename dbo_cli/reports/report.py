"""What a report says about one or several logs, as values; ``render`` turns them into text."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dbo_cli.errors import InputError, LimitError, UsageError
from dbo_cli.reports.expected import Expected
from dbo_cli.reports.merits import Merits, merits, percent_of, root_mean_square
from dbo_cli.reports.pair import Pair, RowRange, predict, scored
from dbo_cli.reports.render import short_name

if TYPE_CHECKING:
    import pandas

    from dbo_cli.model import Model

BEYOND_EXPECTED = 2.0
"""Times the expected error, from which on a warning says so."""
OFFSET_ALONE = 1.0 / 3.0
"""Part of the RMSE that is left without the mean, below which a note speaks of the sensor's zero."""


@dataclass(frozen=True)
class LogReport:
    """The figures of one log; lengths in the report's unit.

    Attributes
    ----------
    name
        Of the log.
    merits
        The figures.
    pair
        The rows that were compared.
    lag
        Rows by which measured was taken later.
    ratio_to_first
        RMSE over that of the first log; None where that is 0.
    """

    name: str
    merits: Merits
    pair: Pair
    lag: int = 0
    ratio_to_first: float | None = None

    @property
    def expected_rmse(self) -> float | None:
        """The error that was to be expected; None where it is not known."""
        if self.pair.expected is None:
            return None
        return self.pair.expected.rmse

    @property
    def percent_of_range(self) -> float | None:
        """The RMSE in percent of the model's output range; None where no model is known."""
        if self.pair.expected is None or self.pair.expected.span is None:
            return None
        return percent_of(self.merits.rmse, self.pair.expected.span)

    @property
    def largest_row(self) -> int:
        """Row of the largest error in the file."""
        assert self.pair.numbers is not None
        return int(self.pair.numbers[self.merits.max_abs_place])

    @property
    def largest_time(self) -> float | None:
        """Time of the largest error (s); None where no clock is known."""
        if self.pair.time is not None:
            return float(self.pair.time[self.merits.max_abs_place])
        if self.pair.dt is not None:
            return (self.largest_row - 1) * self.pair.dt
        return None

    def record(self) -> dict[str, Any]:
        """Return the figures as plain values under the keys of the JSON form."""
        figures, step = self.merits, self.pair.step()
        return {
            "name": self.name,
            "samples": figures.samples,
            "rmse": figures.rmse,
            "nrmse_percent": figures.nrmse_percent,
            "max_abs": figures.max_abs,
            "max_abs_row": self.largest_row,
            "max_abs_time_s": self.largest_time,
            "mean": figures.mean,
            "p95_abs": figures.p95_abs,
            "loop_width": figures.loop_width,
            "loop_width_percent": figures.loop_width_percent,
            "lag_left_samples": figures.lag,
            "lag_left_s": _seconds(figures.lag, step),
            "desired_min": figures.desired_min,
            "desired_max": figures.desired_max,
            "lag_samples": self.lag,
            "lag_s": _seconds(self.lag, step),
            "offset_removed": figures.offset,
            "sample_period_s": step,
            "not_finite": self.pair.missing,
            "clock_offset_s": self.pair.clock_offset,
            "ratio_to_first": self.ratio_to_first,
            "rmse_percent_of_range": self.percent_of_range,
            "expected_rmse": self.expected_rmse,
        }


def _seconds(samples: float | None, step: float | None) -> float | None:
    if samples is None or step is None:
        return None
    return samples * step


@dataclass(frozen=True)
class Verdict:
    """Whether a log keeps a limit.

    Attributes
    ----------
    name
        Of the log.
    figure
        ``rmse`` or ``nrmse_percent``.
    value, limit
        None: the value is undefined, which keeps no limit.
    unit
        Behind the numbers in a sentence.
    """

    name: str
    figure: str
    value: float | None
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the limit is kept."""
        return self.value is not None and self.value <= self.limit

    def words(self) -> str:
        """Say what came of it."""
        name = short_name(self.name)
        if self.value is None:
            return f"{name}: the move has no range, so `max_{self.figure}` is missed"
        relation = "is within" if self.passed else "is above"
        return (
            f"{name}: RMSE {self.value:.4g}{self.unit} {relation} the limit of "
            f"{self.limit:g}{self.unit}"
        )

    def record(self) -> dict[str, Any]:
        """Return it as plain values under the keys of the JSON form."""
        return {
            "name": self.name,
            "figure": self.figure,
            "limit": self.limit,
            "value": self.value,
            "passed": self.passed,
        }


@dataclass(frozen=True)
class Report:
    """What was compared, and the figures of every log in the order they were given.

    Attributes
    ----------
    logs
        One or more.
    unit, voltage_unit
        Of all lengths, and of the drive in the figures; None: not known.
    labels
        What is compared with what.
    remove_offset
        Whether the mean of each error was taken off.
    verdicts
        The limits that were set, for each log.
    model, model_name
        The model that was compared, for the figures and the footer.
    limits, command
        The drive's limits and the command line, for the footer of the page.
    spell
        How notes and warnings name a parameter: as they are, or as the shell's option.
    """

    logs: tuple[LogReport, ...]
    unit: str | None = None
    voltage_unit: str | None = None
    labels: tuple[str, str] = ("desired", "measured")
    remove_offset: bool = False
    verdicts: tuple[Verdict, ...] = ()
    model: Model | None = None
    model_name: str | None = None
    limits: Mapping[str, Any] | None = None
    command: str | None = None
    spell: Callable[[str], str] = str

    @classmethod
    def of(
        cls,
        pairs: Sequence[Pair],
        *,
        unit: str | None = None,
        voltage_unit: str | None = None,
        lag: int = 0,
        remove_offset: bool = False,
        labels: tuple[str, str] = ("desired", "measured"),
        model: Model | None = None,
        model_name: str | None = None,
        expected: Expected | None = None,
        max_rmse: float | None = None,
        max_nrmse_percent: float | None = None,
        limits: Mapping[str, Any] | None = None,
        command: str | None = None,
        spell: Callable[[str], str] = str,
    ) -> Report:
        """Compare the signals of one or several logs, and put the logs side by side.

        Parameters
        ----------
        pairs
            One a log.
        unit, voltage_unit
            Of the two signals, and of the drive.
        lag
            Rows by which measured is taken later than desired.
        remove_offset
            Take the mean of each error off first (a sensor's arbitrary zero).
        labels
            ("desired", "measured"), or ("model", "measured").
        model, model_name
            What predicted, for the figures and the footer.
        expected
            The error that was to be expected, of pairs that have none of their own.
        max_rmse, max_nrmse_percent
            Limits for each log, in the unit and in percent of the move.
        limits, command
            For the footer of the page.
        spell
            How notes and warnings name a parameter.

        Raises
        ------
        InputError
            There is nothing to compare.
        UsageError
            The lag is not a whole number, or a limit is not a number of 0 or more.
        """
        if isinstance(lag, bool) or not isinstance(lag, int):
            raise UsageError(f"`lag` {lag}: give a whole number of rows")
        if not pairs:
            raise UsageError("a report needs at least one log")
        logs: list[LogReport] = []
        for pair in pairs:
            if pair.expected is None:
                pair = replace(pair, expected=expected)
            log = _evaluated(pair, lag, remove_offset)
            first = logs[0] if logs else log
            ratio = None
            if first.merits.rmse > 0.0:
                ratio = log.merits.rmse / first.merits.rmse
            logs.append(replace(log, ratio_to_first=ratio))
        verdicts = _verdicts(logs, unit, max_rmse, max_nrmse_percent)
        return cls(
            logs=tuple(logs),
            unit=unit or None,
            voltage_unit=voltage_unit or None,
            labels=labels,
            remove_offset=remove_offset,
            verdicts=verdicts,
            model=model,
            model_name=model_name,
            limits=limits,
            command=command,
            spell=spell,
        )

    @property
    def rmse(self) -> float:
        """The RMSE of the first log."""
        return self.logs[0].merits.rmse

    @property
    def passed(self) -> bool | None:
        """Whether all limits are kept; None where none was set."""
        if not self.verdicts:
            return None
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def notes(self) -> list[str]:
        """What a reader of the figures must know, all logs together."""
        return [self.spell(note) for log in self.logs for note in log.pair.notes]

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the logs, all of them together."""
        return [self.spell(text) for log in self.logs for text in log.pair.warnings]

    def require_passed(self) -> None:
        """Raise LimitError where a limit is missed."""
        missed = [verdict for verdict in self.verdicts if not verdict.passed]
        if not missed:
            return
        words = missed[0].words()
        if len(missed) > 1:
            words += f"; {len(missed) - 1} more missed"
        raise LimitError(words)

    def line(self) -> str:
        """Return the least error and, of several logs, what it is beside the first."""
        from dbo_cli.reports.render import headline

        return headline(self)

    def render(self, form: str) -> str:
        """Return the report as ``text``, ``json``, ``csv`` or ``html``."""
        from dbo_cli.reports import render

        if form == "text":
            return render.to_text(self)
        if form == "json":
            return render.to_json(self)
        if form == "csv":
            return render.to_csv(self)
        if form == "html":
            return render.to_html(self)
        raise UsageError(f"`format` {form}: give text, json, csv or html")

    def text(self) -> str:
        """Return a verdict and an aligned table."""
        return self.render("text")

    def json(self) -> str:
        """Return the JSON form, ``dbo-report`` version 1."""
        return self.render("json")

    def csv(self) -> str:
        """Return a line a log under the keys of the JSON form."""
        return self.render("csv")

    def html(self) -> str:
        """Return a page that needs no other file."""
        return self.render("html")

    def to_html(self) -> str:
        """Return the same as ``html``, under pandas' name for it."""
        return self.render("html")

    def _repr_html_(self) -> str:
        """Show a notebook the page in a frame of its own."""
        from html import escape

        page = escape(self.html())
        return (
            f'<iframe srcdoc="{page}" style="width:100%;height:40em;border:0"></iframe>'
        )

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a log under the keys of the JSON form, the name as index."""
        import pandas as pd

        return pd.DataFrame([log.record() for log in self.logs]).set_index("name")

    def figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Draw the figures into a folder, PNG and SVG; return the files."""
        from dbo_cli.reports.plots import plots_of_report, save

        return save(plots_of_report(self), folder)


def report(
    desired: ArrayLike,
    measured: ArrayLike,
    time: ArrayLike | None = None,
    *,
    sample_rate: float | None = None,
    voltage: ArrayLike | None = None,
    model: Model | None = None,
    state: Any = "auto",
    rows: RowRange | None = None,
    lag: int = 0,
    remove_offset: bool = False,
    unit: str | None = None,
    name: str = "log",
    expected: Expected | None = None,
    max_rmse: float | None = None,
    max_nrmse_percent: float | None = None,
) -> Report:
    """Report how well what was measured follows what was desired, or what a model predicts.

    Parameters
    ----------
    desired : array of shape (rows,)
        The desired displacement; with ``model`` the drive voltage.
    measured : array of shape (rows,)
        The measured displacement.
    time : array of shape (rows,), optional
        Seconds; or ``sample_rate`` in Hz.
    voltage : array of shape (rows,), optional
        The drive, for the figures.
    model, state
        A forward model, and what was before the first row.
    rows : (first, last), optional
        The rows that count, from 1, both ends included.
    lag, remove_offset, unit, name, expected, max_rmse, max_nrmse_percent
        See ``Report.of``.

    Raises
    ------
    InputError
        Lengths differ, or there is nothing to compare.
    UsageError
        An option is not what it must be.
    """
    dt = None
    if sample_rate is not None:
        if time is not None or not sample_rate > 0.0:
            raise UsageError("`sample_rate`: give a rate above 0 Hz, or `time`")
        dt = 1.0 / sample_rate
    if model is not None:
        pair = predict(
            model,
            desired,
            measured,
            name=name,
            time=time,
            dt=dt,
            state=state,
            rows=rows,
        )
        unit = model.output.unit
    else:
        columns = [None if a is None else np.asarray(a) for a in (time, voltage)]
        pair = Pair(
            name,
            np.asarray(desired),
            np.asarray(measured),
            time=columns[0],
            dt=dt,
            voltage=columns[1],
            rows=rows,
        )
    return Report.of(
        [pair],
        unit=unit,
        voltage_unit=None if model is None else model.input.unit,
        lag=lag,
        remove_offset=remove_offset,
        labels=("desired" if model is None else "model", "measured"),
        model=model,
        expected=expected,
        max_rmse=max_rmse,
        max_nrmse_percent=max_nrmse_percent,
    )


def _evaluated(pair: Pair, lag: int, remove_offset: bool) -> LogReport:
    """Return the figures of one log, with what is to be said about them."""
    if not len(pair):
        raise InputError(f"{pair.name}: has no rows to compare")
    chosen = scored(pair, lag)
    figures = merits(chosen.desired, chosen.measured, remove_offset)
    notes = list(chosen.notes)
    if figures.nrmse_percent is None:
        notes.append(f"{pair.name}: the move has no range, so no percentage is known")
    warnings = [*chosen.warnings, *_beyond_expected(chosen, figures)]
    left = math.sqrt(max(figures.rmse**2 - figures.mean**2, 0.0))
    if left < OFFSET_ALONE * figures.rmse and not warnings:
        notes.append(
            f"{pair.name}: most of the error is its mean: `remove_offset` takes a sensor's zero off"
        )
    chosen = replace(chosen, notes=tuple(notes), warnings=tuple(warnings))
    return LogReport(pair.name, figures, chosen, lag)


def _beyond_expected(pair: Pair, figures: Merits) -> list[str]:
    """Return warnings where the error is far above the expected one, or that is another move's."""
    expected = pair.expected
    if expected is None:
        return []
    if not expected.is_of(figures.desired_min, figures.desired_max):
        assert expected.move is not None
        low, high = expected.move
        return [
            f"{pair.name}: the expected error is of a move from {low:.4g} to {high:.4g}, this one goes from "
            f"{figures.desired_min:.4g} to {figures.desired_max:.4g}: give its own summary"
        ]
    if expected.rmse is None or figures.rmse <= BEYOND_EXPECTED * expected.rmse:
        return []
    times = figures.rmse / expected.rmse
    warning = f"{pair.name}: the error is {times:.2g} times the expected one"
    error = pair.measured - pair.desired
    without_mean = root_mean_square(error - np.mean(error))
    if figures.offset == 0.0 and without_mean <= BEYOND_EXPECTED * expected.rmse:
        return [f"{warning}: most of it is the mean (`remove_offset`)"]
    return [f"{warning}: drive with `condition`, or identify again"]


def _verdicts(
    logs: Sequence[LogReport],
    unit: str | None,
    max_rmse: float | None,
    max_nrmse_percent: float | None,
) -> tuple[Verdict, ...]:
    """Return what comes of the limits that are set."""
    suffix = f" {unit}" if unit else ""
    for name, limit in (
        ("max_rmse", max_rmse),
        ("max_nrmse_percent", max_nrmse_percent),
    ):
        if limit is not None and not 0.0 <= limit < math.inf:
            raise UsageError(f"`{name}` {limit:g}: give a number of 0 or more")
    verdicts = []
    for log in logs:
        figures = log.merits
        if max_rmse is not None:
            verdicts.append(Verdict(log.name, "rmse", figures.rmse, max_rmse, suffix))
        if max_nrmse_percent is not None:
            value = figures.nrmse_percent
            verdict = Verdict(
                log.name, "nrmse_percent", value, max_nrmse_percent, " % of the move"
            )
            verdicts.append(verdict)
    return tuple(verdicts)
