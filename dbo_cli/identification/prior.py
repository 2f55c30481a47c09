"""A model refreshed from a short log: gain, offset and delay are identified again, its shape is kept.

After a change of temperature, load or mounting, a loop is mostly scaled and shifted.
Three numbers need seconds of a log where a shape needs minutes: displacement = gain *
prior(v, t - delay) + offset. They come from weighted least squares. The past before the
log is a fourth unknown, of known size: between the prediction from an empty and from a
full start. The prior's own error is no noise: it is alike within a swing and may feign a
change. So each number is shrunk by its own uncertainty, and an actuator that did not
change keeps the prior's numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from dbo_cli.arrays import Floats, Integers
from dbo_cli.errors import FitError, UsageError
from dbo_cli.identification.figures import BEYOND_STATED
from dbo_cli.identification.recording import (
    FEWEST_ROWS,
    Options,
    Recording,
    Swings,
    noise_variance,
)
from dbo_cli.identification.stages import with_changed_stages
from dbo_cli.model import Cascade, Delay, Dynamics, Scale, State, steps_of
from dbo_cli.model.expect import expected_error

STUDENT = 2.0  # standard errors of a 95 % interval
LEAST_KNOWN = 0.5  # of the rows: those behind the first way over the log's range
DELAY_STEPS = 8  # of Gauss and Newton: the prediction is not linear in the delay
LONGEST_DELAY = 0.25  # of the usual swing, to either side
NOISE_CHANCE = 4.0
"""Over the root of the rows: two standard errors of the noise's variance, which is no change of the shape."""
LEAST_STATED = 1e-6  # of the output's range: the least error that a prior may state


class Prediction(NamedTuple):
    """What the prior predicts for a log, without its delay.

    Attributes
    ----------
    middle : shape (n,), between the predictions from an empty and from a full start
    past : shape (n,), half the distance of the two
    rows : which rows count
    """

    log: Recording
    middle: Floats
    past: Floats
    rows: Integers

    @property
    def displacement(self) -> Floats:
        """What was measured in the rows that count."""
        return self.log.displacement[self.rows]

    def columns(self, delay: float) -> Floats:
        """Return the columns of gain, offset, delay, drift and past in the rows that count; (rows, 5)."""
        time = self.log.time
        speed, drift = np.zeros(len(self.middle)), np.zeros(len(self.rows))
        if time is not None:
            speed = np.nan_to_num(np.gradient(self.middle, time))
            drift = np.linspace(-1.0, 1.0, len(drift))
        signals = [self.middle, -speed, self.past]
        if time is not None and delay != 0.0:
            signals = [np.interp(time - delay, time, signal) for signal in signals]
        gain, delayed, past = (signal[self.rows] for signal in signals)
        return np.column_stack((gain, np.ones(len(drift)), delayed, drift, past))


class Change(NamedTuple):
    """What is new: displacement = gain * prior + offset, ``delay`` (s) later than the prior's."""

    gain: float
    offset: float
    delay: float


def rescale(
    prior: Cascade, recordings: Sequence[Recording], options: Options
) -> Cascade:
    """Return the prior with gain, offset and delay of cleaned recordings; its candidates go along.

    Raises
    ------
    FitError
        The prior's shape does not follow the recordings, or the displacement goes the
        other way.
    UsageError
        The prior needs a clock and there is none.
    """
    prior.require("forward", "the prior")
    if prior.needs_time and any(log.time is None for log in recordings):
        raise UsageError(
            "the prior needs a clock: add `time` COLUMN or `sample_rate` HZ"
        )
    predictions = [_predicted(prior, log) for log in recordings]
    fitted, shrunk = _changes(prior, predictions)
    warnings = _shape_warnings(prior, fitted, predictions)
    if warnings and not options.force:
        raise FitError(f"{warnings[0]} (`force` keeps the shape)")
    residuals = [_residual(prior, shrunk, each) for each in predictions]
    rmse = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
    return _refreshed(prior, shrunk, rmse, warnings)


def _shape_warnings(
    prior: Cascade, change: Change, predictions: Sequence[Prediction]
) -> list[str]:
    """Return a warning where a change leaves more than noise and the error that the prior states."""
    residuals = [_residual(prior, change, each) for each in predictions]
    squares = float(np.mean(np.concatenate(residuals) ** 2))
    rows = sum(map(len, residuals))
    noise = noise_variance(residuals) * (1.0 + NOISE_CHANCE / np.sqrt(rows))
    shape = float(np.sqrt(max(squares - noise, 0.0)))
    stated_error = change.gain * _stated_of_logs(prior, predictions)
    if shape <= BEYOND_STATED * stated_error:
        return []
    return [
        f"{predictions[0].log.name}: error {shape:.4g}{prior.output.suffix}, the prior states "
        f"{stated_error:.4g}: its shape has changed; identify again without it"
    ]


def _predicted(prior: Cascade, log: Recording) -> Prediction:
    """Return what the prior predicts for a log, from an empty and from a full start."""
    empty = _simulated(prior, log, prior.input.min, "empty")
    full = _simulated(prior, log, prior.input.max, "full")
    return Prediction(log, 0.5 * (empty + full), 0.5 * (full - empty), _rows_of(log))


def _rows_of(log: Recording) -> Integers:
    """Return the usable rows, if many those by which the drive has been at both ends of its range.

    From there on the past only shifts the displacement.
    """
    rows = np.flatnonzero(log.usable)
    ends = int(np.argmin(log.voltage)), int(np.argmax(log.voltage))
    settled = rows[rows >= max(ends)]
    if settled.size >= max(LEAST_KNOWN * rows.size, FEWEST_ROWS):
        return settled
    return rows


def _simulated(prior: Cascade, log: Recording, before: float, start: str) -> Floats:
    """Return a prediction without delay, after a long rest at a voltage and a jump to the log's first."""
    voltage = np.concatenate([[before], log.voltage])
    steps = None
    if log.time is not None:
        steps = np.concatenate([[0.0, 0.0], np.diff(log.time)])
    output, _ = prior.static.simulate(voltage, dt=steps, state=start)
    output = output[1:]
    if prior.dynamics is not None and log.time is not None:
        output = prior.dynamics.run(output, State(), steps_of(log.time)).y
    return output


def _stated_error(prior: Cascade) -> float:
    """Return the error (RMS) that the prior states of itself, at least ``LEAST_STATED``."""
    stated_error = prior.fit.get("expected_rmse") or prior.fit.get("rmse") or 0.0
    return max(float(stated_error), LEAST_STATED * prior.output.span)


def _stated_of_logs(prior: Cascade, predictions: Sequence[Prediction]) -> float:
    """Return the error (RMS) that the prior states of these very logs, their past aside."""
    squares = []
    for each in predictions:
        log = each.log
        steps = None if log.time is None else steps_of(log.time)
        expected = expected_error(prior, log.voltage, steps)
        error = _stated_error(prior) if expected is None else expected.known
        squares.append(error**2)
    return max(float(np.sqrt(np.mean(squares))), LEAST_STATED * prior.output.span)


def _changes(
    prior: Cascade, predictions: Sequence[Prediction]
) -> tuple[Change, Change]:
    """Return the change of least squares, and what its uncertainty leaves of it.

    A number with a standard error u becomes d (1 - (2 u / d)^2), 0 within the interval
    (James and Stein's positive part).
    """
    longest, swings, means = np.inf, 0, []
    for log, predicted, _, rows in predictions:
        ways = Swings.of(log.voltage)
        swings += len(ways.different(log.voltage, float(np.ptp(log.voltage))))
        longest = min(longest, LONGEST_DELAY * (log.dt or 0.0) * ways.usual_rows)
        means.append(predicted[rows].mean())
    middle = float(np.mean(means))
    delay = 0.0
    displacement = np.concatenate([each.displacement for each in predictions])
    for _ in range(DELAY_STEPS):
        total = prior.delay_seconds + delay
        table = np.vstack([each.columns(total) for each in predictions])
        target = displacement - table[:, 0]
        table[:, 0] -= middle
        numbers, errors = _solved(table, target, swings, _stated_error(prior))
        delay = float(np.clip(delay + numbers[2], -longest, longest))
    numbers[2] = delay
    if numbers[0] <= -1.0:
        raise FitError(
            f"the displacement runs against the prior (gain {1.0 + numbers[0]:.3g}): check the columns"
        )
    within = STUDENT * errors
    shrunk = np.zeros(5)
    sure = np.abs(numbers) > within
    shrunk[sure] = numbers[sure] - within[sure] ** 2 / numbers[sure]
    changes = []
    for gain, offset, extra in (numbers[:3].tolist(), shrunk[:3].tolist()):
        changes.append(Change(1.0 + gain, offset - gain * middle, extra))
    return changes[0], changes[1]


def _solved(
    table: Floats, target: Floats, swings: int, stated_error: float
) -> tuple[Floats, Floats]:
    """Return the unknowns of least squares and their standard errors; 0 for a column of zeros.

    Errors are alike within a swing and in its like, so n rows with s different swings
    count as s. Their size is what the prior states of itself, or what is left where that
    is more. The past lies anywhere between both ends, -1 and 1: its variance is a third.
    """
    rows, size = len(target), stated_error**2
    for _ in range(2):
        weight = swings / rows / size
        curvature = weight * (table.T @ table)
        curvature[-1, -1] += 3.0
        covariance = np.linalg.pinv(curvature, hermitian=True)
        numbers: Floats = covariance @ (weight * (table.T @ target))
        size = max(stated_error**2, float(np.mean((target - table @ numbers) ** 2)))
    return numbers, np.sqrt(np.diag(covariance))


def _residual(prior: Cascade, change: Change, prediction: Prediction) -> Floats:
    """Return what a change leaves of a log, drift and past aside."""
    table = prediction.columns(max(prior.delay_seconds + change.delay, 0.0))
    scaled = change.gain * table[:, 0] + change.offset
    residual = prediction.displacement - scaled
    nuisance = np.linalg.lstsq(table[:, 3:], residual, rcond=None)[0]
    nuisance[1] = min(max(nuisance[1], -1.0), 1.0)
    return np.asarray(residual - table[:, 3:] @ nuisance)


def _refreshed(
    prior: Cascade, change: Change, rmse: float, warnings: list[str]
) -> Cascade:
    """Return the prior's model, candidates and figures with the change."""
    gain, offset = change.gain, change.offset
    fit: dict[str, Any] = dict(prior.fit)
    for key in ("expected_rmse", "left_out_rmse"):
        if isinstance(fit.get(key), float):
            fit[key] = max(gain * fit[key], rmse)
    fit |= {
        "method": "prior",
        "validation": [],
        "warnings": warnings,
        "prior": {
            "gain": gain,
            "offset": offset,
            "delay_seconds": change.delay,
            "digest": prior.digest,
        },
    }
    low, high = gain * prior.output.min + offset, gain * prior.output.max + offset
    output = replace(prior.output, min=low, max=high)
    refreshed = replace(prior, output=output, fit=fit)
    return with_changed_stages(refreshed, lambda stages: _changed(stages, change))


def _changed(stages: Sequence[Any], change: Change) -> tuple[Any, ...]:
    """Return stages with another gain, offset and delay."""
    seconds = sum((s.seconds for s in stages if isinstance(s, Delay)), change.delay)
    static = [stage for stage in stages if not isinstance(stage, Delay | Dynamics)]
    moving: list[Any] = [stage for stage in stages if isinstance(stage, Dynamics)]
    scale = static.pop() if isinstance(static[-1], Scale) else Scale(1.0, 0.0)
    gain, offset = change.gain * scale.gain, change.gain * scale.offset + change.offset
    if (gain, offset) != (1.0, 0.0):
        static.append(Scale(gain, offset))
    if seconds > 0.0:
        moving.append(Delay(seconds))
    return (*static, *moving)
