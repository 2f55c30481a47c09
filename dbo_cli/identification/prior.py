"""A model refreshed from a short log: gain, offset and delay are identified again, its shape is kept.

After a change of temperature, load or mounting, a loop is mostly scaled and shifted.
Three numbers need seconds of a log where a shape needs minutes: displacement = gain *
prior(v, t - delay) + offset. The delay is the lag behind what the prior predicts, gain
and offset come from least squares. The past before the log is a further unknown, of known
size: between the prediction from an empty and from a full start. The prior's own error is
no noise: it is alike within a swing and may feign a change. So each number is shrunk by
its own uncertainty, and an actuator that did not change keeps the prior's numbers.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats, Integers
from dbo_cli.errors import FitError, UsageError
from dbo_cli.identification.figures import BEYOND_STATED
from dbo_cli.identification.recording import Options, Recording, Swings
from dbo_cli.identification.stages import with_changed_stages
from dbo_cli.model import Cascade, Delay, Dynamics, Scale, Stage
from dbo_cli.model.expect import expected_error
from dbo_cli.signals import lag, noise

STUDENT = 2.0  # standard errors of a 95 % interval
LEAST_KNOWN = 0.5  # of the rows: those behind the first way over the log's range
LONGEST_DELAY = 0.25  # of the usual swing: a lag beyond is another swing's
NOISE_CHANCE = 8.0
"""Over the root of the rows: by so much medians may tell the variance of the noise too small, measured."""
LEAST_STATED = 1e-6  # of the output's range: the least error that a prior may state


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
    predicted = [_predicted(prior, log) for log in recordings]
    delay = _delay_of(prior, recordings, predicted)
    pairs = list(zip(recordings, predicted, strict=True))
    table = np.vstack([_columns(log, columns, delay) for log, columns in pairs])
    measured = np.concatenate([log.displacement[_rows_of(log)] for log in recordings])
    target, middle = measured - table[:, 0], float(table[:, 0].mean())
    table[:, 0] -= middle
    stated_error = _stated_error(prior, recordings)
    numbers, errors = _solved(table, target, _swings_of(recordings), stated_error)
    if numbers[0] <= -1.0:
        raise FitError(
            f"the displacement runs against the prior (gain {1.0 + numbers[0]:.3g}): check the columns"
        )
    residual = target - table @ numbers
    shape, stated_error = _shape_error(residual), (1.0 + numbers[0]) * stated_error
    warnings = []
    if shape > BEYOND_STATED * stated_error:
        warnings = [
            f"{recordings[0].name}: error {shape:.4g}{prior.output.suffix}, the prior states "
            f"{stated_error:.4g}: its shape has changed; identify again without it"
        ]
        if not options.force:
            raise FitError(f"{warnings[0]} (`force` keeps the shape)")
    shrunk = _shrunk(numbers, errors)
    gain, offset = shrunk[:2].tolist()
    scale = Scale(1.0 + gain, offset - gain * middle)
    rmse = float(np.sqrt(np.mean(residual**2)))
    unsure = _unsure(prior, np.hypot(errors, numbers - shrunk), middle)
    return _refreshed(prior, scale, delay, (rmse, unsure), warnings)


def _predicted(prior: Cascade, log: Recording) -> Floats:
    """Return the middle of what the prior predicts from an empty and a full start, and half their distance.

    Shape (n, 2). Before the log the drive has rested for long at that end of the range.
    """
    ends = []
    for voltage, name in ((prior.input.min, "empty"), (prior.input.max, "full")):
        _, rested = prior.simulate(np.asarray([voltage]), dt=1.0, state=name)
        output, _ = prior.simulate(log.voltage, time=log.time, state=rested)
        ends.append(output)
    empty, full = ends
    return np.column_stack((0.5 * (empty + full), 0.5 * (full - empty)))


def _delay_of(
    prior: Cascade, logs: Sequence[Recording], predicted: Sequence[Floats]
) -> float:
    """Return how much later than predicted the logs are (s), as the one says that shows it best."""
    best, deviation = 0.0, np.inf
    for log, columns in zip(logs, predicted, strict=True):
        step = log.even_step
        shift = None if step is None else lag(log.displacement, columns, step)
        if step is None or shift is None or shift.deviation >= deviation:
            continue
        longest = LONGEST_DELAY * step * Swings.of(log.voltage).usual_rows
        if -prior.delay_seconds <= shift.seconds <= longest:
            best, deviation = shift.seconds, shift.deviation
    return float(_shrunk(np.asarray([best]), np.asarray([deviation]))[0])


def _columns(log: Recording, predicted: Floats, delay: float) -> Floats:
    """Return the columns of gain, offset, past and drift in the rows that count; (rows, 4)."""
    if log.time is not None and delay:
        shifted = [np.interp(log.time - delay, log.time, each) for each in predicted.T]
        predicted = np.column_stack(shifted)
    rows = predicted[_rows_of(log)]
    drift = np.linspace(-1.0, 1.0, len(rows)) * (log.time is not None)
    return np.column_stack((rows[:, 0], np.ones(len(rows)), drift, rows[:, 1]))


def _rows_of(log: Recording) -> Integers:
    """Return the usable rows, if many those by which the drive has been at both ends of its range.

    From there on the past only shifts the displacement.
    """
    rows = np.flatnonzero(log.usable)
    ends = int(np.argmin(log.voltage)), int(np.argmax(log.voltage))
    settled = rows[rows >= max(ends)]
    return settled if settled.size >= LEAST_KNOWN * rows.size else rows


def _swings_of(logs: Sequence[Recording]) -> int:
    """Return how many swings of each log differ from each other."""
    spans = [(log.voltage, float(np.ptp(log.voltage))) for log in logs]
    return sum(len(Swings.of(drive).different(drive, span)) for drive, span in spans)


def _stated_error(prior: Cascade, logs: Sequence[Recording]) -> float:
    """Return the error (RMS) that the prior states of these very logs, their past aside."""
    squares = [(LEAST_STATED * prior.output.span) ** 2]
    for log in logs:
        steps = None
        if log.time is not None:
            steps = np.diff(log.time, prepend=log.time[0])
        expected = expected_error(prior, log.voltage, steps)
        error = prior.fit.get("rmse", 0.0) if expected is None else expected.known
        squares.append(_of_shape(prior, error) ** 2)
    return float(np.sqrt(max(squares)))


def _of_shape(prior: Cascade, error: float) -> float:
    """Return the part of a stated error (RMS) that is the shape's: what was unsure before is found again."""
    unsure = prior.fit.get("scale_rmse") or 0.0
    return float(np.sqrt(max(error**2 - unsure**2, 0.0)))


def _unsure(prior: Cascade, errors: Floats, middle: float) -> float:
    """Return what errors of gain and offset make of the displacement (RMS), anywhere in the range alike.

    The offset is that at the ``middle`` of what the prior predicted.
    """
    low, high = prior.output.min, prior.output.max
    distance = np.hypot((high - low) / np.sqrt(12.0), 0.5 * (low + high) - middle)
    return float(np.hypot(errors[0] * distance, errors[1]))


def _shape_error(residual: Floats) -> float:
    """Return what is left (RMS) beyond white noise."""
    white = noise(residual) ** 2 * (1.0 + NOISE_CHANCE / np.sqrt(len(residual)))
    return float(np.sqrt(max(float(np.mean(residual**2)) - white, 0.0)))


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


def _shrunk(numbers: Floats, errors: Floats) -> Floats:
    """Return what their standard errors u leave of numbers d: d (1 - (2 u / d)^2), 0 within the interval.

    James and Stein's positive part.
    """
    within = STUDENT * errors
    shrunk = np.zeros(len(numbers))
    sure = np.abs(numbers) > within
    shrunk[sure] = numbers[sure] - within[sure] ** 2 / numbers[sure]
    return shrunk


def _refreshed(
    prior: Cascade,
    change: Scale,
    delay: float,
    errors: tuple[float, float],
    warnings: list[str],
) -> Cascade:
    """Return the prior's model, candidates and figures behind another scale and a delay (s).

    ``errors`` (RMS) are what is left of the logs, and what gain and offset are unsure by
    over the range.
    """

    def changed(stages: Sequence[Stage]) -> tuple[Stage, ...]:
        moving = [stage for stage in stages if isinstance(stage, Dynamics)]
        delays = [stage.seconds for stage in stages if isinstance(stage, Delay)]
        static = [s for s in stages if not isinstance(s, Delay | Dynamics)]
        scale, last = change, static[-1]
        if isinstance(last, Scale):
            del static[-1]
            scale = Scale(change.gain * last.gain, change.value(last.offset))
        scales = [scale] if scale != Scale(1.0, 0.0) else []
        seconds = delay + sum(delays)
        late = [Delay(seconds)] if seconds > 0.0 else []
        return (*static, *scales, *moving, *late)

    fit: dict[str, Any] = dict(prior.fit)
    for key in ("expected_rmse", "left_out_rmse"):
        if isinstance(fit.get(key), float):
            shape = max(change.gain * _of_shape(prior, fit[key]), errors[0])
            fit[key] = float(np.hypot(shape, errors[1]))
    fit |= {
        "method": "prior",
        "scale_rmse": errors[1],
        "validation": [],
        "warnings": warnings,
        "prior": {
            "gain": change.gain,
            "offset": change.offset,
            "delay_seconds": delay,
            "digest": prior.digest,
        },
    }
    low, high = change.value(prior.output.min), change.value(prior.output.max)
    output = replace(prior.output, min=low, max=high)
    return with_changed_stages(replace(prior, output=output, fit=fit), changed)
