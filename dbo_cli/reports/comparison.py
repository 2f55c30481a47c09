"""What a report says about one or several logs, as values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import LimitError, UsageError
from dbo_cli.reports.expected import Expected
from dbo_cli.reports.merits import Merits, merits
from dbo_cli.reports.pair import Pair, scored, undelayed
from dbo_cli.reports.words import digits, shortened
from dbo_cli.signals import between, noise

if TYPE_CHECKING:
    from dbo_cli.model import Cascade

HALVED = 0.5
"""Part of the error that a cause must leave at most to be named."""
BEYOND_EXPECTED = 2.0
"""Times the expected error, from which on a warning says so."""


@dataclass(frozen=True)
class LogReport:
    """The figures of one log; lengths in the report's unit.

    Attributes
    ----------
    pair
        The rows that were compared.
    merits
        The figures.
    lag
        Rows by which measured was taken later.
    ratio_to_first
        RMSE over that of the first log; None where that is 0.
    """

    pair: Pair
    merits: Merits
    lag: int = 0
    ratio_to_first: float | None = None

    @property
    def name(self) -> str:
        """The name of the log."""
        return self.pair.name

    @property
    def expected_rmse(self) -> float | None:
        """The error that was to be expected; None where it is not known."""
        return None if self.pair.expected is None else self.pair.expected.rmse

    @property
    def largest_row(self) -> int:
        """Row of the largest error in the file."""
        return self.pair.first_row + self.merits.max_abs_index

    def seconds(self, samples: float | None, scale: float = 1.0) -> float | None:
        """Return a number of samples in seconds times ``scale``; None where no clock is known."""
        step = self.pair.step()
        return None if samples is None or step is None else scale * samples * step

    def record(self) -> dict[str, Any]:
        """Return the figures as plain values under the keys of the JSON form."""
        figures, time = self.merits, self.pair.time
        when = None if time is None else float(time[figures.max_abs_index])
        return {
            "name": self.name,
            "samples": figures.samples,
            "rmse": figures.rmse,
            "nrmse_percent": figures.nrmse_percent,
            "max_abs": figures.max_abs,
            "max_abs_row": self.largest_row,
            "max_abs_time_s": when,
            "mean": figures.mean,
            "p95_abs": figures.p95_abs,
            "loop_width": figures.loop_width,
            "loop_width_percent": figures.loop_width_percent,
            "lag_left_samples": figures.lag,
            "lag_left_s": self.seconds(figures.lag),
            "desired_min": figures.desired_min,
            "desired_max": figures.desired_max,
            "lag_samples": self.lag,
            "lag_s": self.seconds(self.lag),
            "offset_removed": figures.offset,
            "sample_period_s": self.pair.step(),
            "clock_offset_s": self.pair.clock_offset,
            "ratio_to_first": self.ratio_to_first,
            "expected_rmse": self.expected_rmse,
        }


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
        """Return the verdict as a sentence."""
        name = shortened(self.name)
        if self.value is None:
            return f"{name}: the move has no range: no percentage for the limit of {self.limit:g} %"
        relation = "is within" if self.passed else "exceeds"
        return f"{name}: RMSE {self.value:.4g}{self.unit} {relation} the limit, {self.limit:g}{self.unit}"

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
class Scores:
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
    model
        The model that was compared, for its figures.
    command
        The command line, for the footer of the page.
    """

    logs: tuple[LogReport, ...]
    unit: str | None = None
    voltage_unit: str | None = None
    labels: tuple[str, str] = ("desired", "measured")
    remove_offset: bool = False
    verdicts: tuple[Verdict, ...] = ()
    model: Cascade | None = None
    command: str | None = None

    @classmethod
    def of(
        cls,
        pairs: Sequence[Pair],
        *,
        unit: str | None = None,
        lag: int = 0,
        remove_offset: bool = False,
        expected: Expected | None = None,
        max_rmse: float | None = None,
        max_nrmse_percent: float | None = None,
        **about: Any,
    ) -> Self:
        """Compare the signals of one or several logs, and put the logs side by side.

        Parameters
        ----------
        pairs
            One or more, one a log.
        unit
            Of the two signals.
        lag
            Rows by which measured is taken later than desired.
        remove_offset
            Take the mean of each error off first (a sensor's arbitrary zero).
        expected
            The error that was to be expected, of pairs that have none of their own.
        max_rmse, max_nrmse_percent
            Limits for each log, in the unit and in percent of the move.
        **about
            ``voltage_unit, labels, model, command``: see the class.

        Raises
        ------
        InputError
            There is nothing to compare.
        UsageError
            A limit is below 0.
        """
        bounds = {"max_rmse": max_rmse, "max_nrmse_percent": max_nrmse_percent}
        for name, bound in bounds.items():
            if bound is not None and bound < 0.0:
                raise UsageError(f"`{name}` {bound:g}: give 0 or more")
        logs: list[LogReport] = []
        for pair in pairs:
            if pair.expected is None:
                pair = replace(pair, expected=expected)
            log = _evaluated(pair, lag, remove_offset)
            first = logs[0] if logs else log
            if first.merits.rmse > 0.0:
                ratio = log.merits.rmse / first.merits.rmse
                log = replace(log, ratio_to_first=ratio)
            logs.append(log)
        verdicts = _verdicts(logs, unit, max_rmse, max_nrmse_percent)
        return cls(
            tuple(logs),
            unit=unit or None,
            remove_offset=remove_offset,
            verdicts=verdicts,
            **about,
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
        return [note for log in self.logs for note in log.pair.notes]

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the logs, all of them together."""
        return [text for log in self.logs for text in log.pair.warnings]

    def require_passed(self) -> None:
        """Raise LimitError where a limit is missed."""
        missed = [verdict for verdict in self.verdicts if not verdict.passed]
        if missed:
            more = f" (and {len(missed) - 1} more)" if len(missed) > 1 else ""
            raise LimitError(missed[0].words() + more)

    def line(self) -> str:
        """Return the least error and, of several logs, what it is beside the first."""
        first = self.logs[0]
        best = min(self.logs, key=lambda log: log.merits.rmse)
        error = f"error {digits(best.merits.rmse, 3)} {self.unit or ''}".rstrip()
        line = f"{shortened(best.name)}: {error} RMS"
        if best is not first and best.merits.rmse > 0.0:
            times = digits(first.merits.rmse / best.merits.rmse, 2)
            return f"{line}, {times} times less than {shortened(first.name)}"
        if best.merits.nrmse_percent is not None:
            line += f" ({digits(best.merits.nrmse_percent, 2)} % of the move)"
        if best.expected_rmse is not None:
            line += f", {digits(best.expected_rmse, 2)} expected"
        return line


def _evaluated(pair: Pair, lag: int, remove_offset: bool) -> LogReport:
    """Return the figures of one log, with a warning where more was expected of it."""
    compared = scored(pair if lag else undelayed(pair), lag)
    figures = merits(compared.desired, compared.measured, remove_offset)
    if compared.expected is not None:
        warning = _beyond(compared.expected, compared, figures)
        if warning:
            compared = compared.warned(warning)
    return LogReport(compared, figures, lag)


def _beyond(expected: Expected, pair: Pair, figures: Merits) -> str:
    """Return a warning where the error is far above the expected one, or that is another move's.

    The sensor's noise is no error of the actuator: it is taken out first.
    """
    low, high = figures.desired_min, figures.desired_max
    if expected.move is not None and not expected.is_of(low, high):
        return (
            f"the move is {low:.4g} to {high:.4g}, the expected error is for"
            f" {expected.move[0]:.4g} to {expected.move[1]:.4g}: use the summary of this move"
        )
    white = noise(pair.measured)
    error = math.sqrt(max(figures.rmse**2 - white**2, 0.0))
    if expected.rmse is None or error <= BEYOND_EXPECTED * expected.rmse:
        return ""
    cause = _cause(pair, figures, white, expected.past_known)
    return f"the error is {error / expected.rmse:.2g} times the expected one{cause}"


def _cause(pair: Pair, figures: Merits, white: float, past_known: bool) -> str:
    """Return the largest cause of an error, what it would leave, and what to do about it."""
    error = pair.measured - pair.desired - figures.offset
    sweep = "" if past_known else "sweep the range before the move, "
    causes = [
        (
            _left(error - np.mean(error), white),
            f"its mean is {figures.mean:.3g}",
            f"set the sensor's zero, {sweep}or `remove_offset`",
        )
    ]
    lag = figures.lag
    if lag is not None and pair.step() is not None:
        rows = np.arange(float(len(error))) - lag
        inside = (rows >= 0.0) & (rows <= len(error) - 1.0)
        shifted = pair.measured[inside] - between(pair.desired, rows[inside])
        milliseconds = 1e3 * lag * (pair.step() or 0.0)
        side, remedy = "late", "identify with `sensor_delay`, or `lag`"
        if lag < 0.0:
            side, remedy = (
                "early",
                "match the clocks, or take the delay out of the model",
            )
        text = f"it is {abs(milliseconds):.3g} ms {side}"
        causes.append((_left(shifted - figures.offset, white), text, remedy))
    largest = np.argsort(np.abs(error))[: math.floor(0.99 * len(error))]
    row = pair.first_row + figures.max_abs_index
    text = f"one row in a hundred holds most of it, the largest at row {row:,}"
    causes.append(
        (_left(error[largest], white), text, "look there for a gap or a limit")
    )
    residual, text, remedy = min(causes)
    if residual > HALVED * _left(error, white):
        return f": {sweep}or identify again" if sweep else ": identify again"
    return f": {text}, without which {residual:.2g} is left: {remedy}"


def _left(error: Floats, white: float) -> float:
    """Return the RMS of an error without its white noise."""
    return math.sqrt(max(float(np.mean(np.square(error))) - white**2, 0.0))


def _verdicts(
    logs: Sequence[LogReport],
    unit: str | None,
    max_rmse: float | None,
    max_nrmse_percent: float | None,
) -> tuple[Verdict, ...]:
    """Return what comes of the limits that are set."""
    suffix = f" {unit}" if unit else ""
    limits = [
        ("rmse", max_rmse, suffix),
        ("nrmse_percent", max_nrmse_percent, " % of the move"),
    ]
    verdicts = []
    for log in logs:
        for figure, limit, unit_of_limit in limits:
            if limit is None:
                continue
            value = getattr(log.merits, figure)
            verdicts.append(Verdict(log.name, figure, value, limit, unit_of_limit))
    return tuple(verdicts)
