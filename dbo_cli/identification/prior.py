"""A model refreshed from a short log: gain, offset and delay are found again, its shape is kept.

After a change of temperature, load or mounting, a loop is mostly scaled and shifted.
Three numbers need seconds of a log where a shape needs minutes: displacement = gain *
prior(v, t - delay) + offset. They come from weighted least squares. The past before the
log is a fourth unknown, of known size: between the prediction from an empty and from a
full start. The prior's own error is no noise: it is alike within a swing and may feign a
change. So each number is shrunk by its own uncertainty, and an actuator that did not
change keeps the prior's numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbo_cli.errors import FitError, UsageError
from dbo_cli.identification.recording import Options, Recording, Swings
from dbo_cli.model import (
    Candidate,
    Delay,
    Dynamics,
    Model,
    Quantity,
    Scale,
    steps_of,
)

Floats = NDArray[np.float64]

FEWEST_ROWS = 20
STUDENT = 2.0  # standard errors of a 95 % interval
BROKEN = 2.0
"""Times the prior's own error: a shape that leaves more, noise aside, has changed. On four invented actuators
the same shape left at most 1.1 times, a loop 1.25 times as wide 1.6 to 9 times."""
LEAST_KNOWN = 0.5  # of the rows: those behind the first way over the log's range
SAME_LEVEL = 0.1  # of the log's range
STEPS = 8  # of Gauss and Newton: the prediction is not linear in the delay
LONGEST_DELAY = 0.25  # of the usual swing, to either side
EXACT = 1e-6  # of the output's range: the least error that a prior may state


@dataclass(frozen=True)
class Beside:
    """A log beside what the prior predicts without its delay.

    Attributes
    ----------
    predicted
        In the middle between an empty and a full start; shape (n,).
    past
        How far the past before the log may shift it: half the distance of the two.
    rows
        The rows that count.
    swings
        How many different swings the drive makes.
    """

    log: Recording
    predicted: Floats
    past: Floats
    rows: NDArray[np.intp]
    swings: float

    def late(self, signal: Floats, delay: float) -> Floats:
        """Return a signal ``delay`` seconds later, for the rows that count."""
        time = self.log.time
        if time is None or delay == 0.0:
            return signal[self.rows]
        return np.interp(time[self.rows] - delay, time, signal)

    def columns(self, delay: float) -> tuple[Floats, Floats]:
        """Return the prediction, and the columns of gain, offset, delay, drift and past; shape (rows, 5)."""
        late = self.late(self.predicted, delay)
        table = np.zeros((late.size, 5))
        table[:, 0] = late
        table[:, 1] = 1.0
        if self.log.time is not None:
            speed = np.gradient(self.predicted, np.maximum(self.log.time, 0.0))
            table[:, 2] = -self.late(np.nan_to_num(speed), delay)
        table[:, 3] = np.linspace(-1.0, 1.0, late.size)
        table[:, 4] = self.late(self.past, delay)
        return late, table


@dataclass(frozen=True)
class Change:
    """The gain's factor, the offset about ``middle`` and the delay (s) that are new; their errors."""

    gain: float
    offset: float
    delay: float
    middle: float
    errors: tuple[float, float, float]

    @property
    def shift(self) -> float:
        """What is added to the scaled output."""
        return self.offset + self.middle * (1.0 - self.gain)


def rescale(prior: Model, recordings: Sequence[Recording], options: Options) -> Model:
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
    clocked = all(log.time is not None for log in recordings)
    if prior.needs_time and not clocked:
        raise UsageError(
            "the prior has dynamics or relaxation, which need a clock: name the time column (`time`) or give "
            "`sample_rate`"
        )
    beside = [_beside(prior, log) for log in recordings]
    fitted = _fitted(prior, beside, clocked)
    change = _shrunk(prior, beside, fitted)
    left = _left_over(beside, fitted, prior.delay_seconds)
    warnings = _check_shape(prior, fitted, left, recordings[0].name, options.force)
    warnings += _past_matters(prior, beside)
    left = _left_over(beside, change, prior.delay_seconds)
    return _refreshed(prior, change, left, recordings, warnings)


def _beside(prior: Model, log: Recording) -> Beside:
    """Return a log beside the predictions from both ends of what was before it."""
    lower = _predicted(prior, log, prior.input.min)
    upper = _predicted(prior, log, prior.input.max)
    rows = np.flatnonzero(log.usable)
    known = rows[rows >= _wiped_row(log.voltage)]
    if known.size >= LEAST_KNOWN * rows.size:
        rows = known
    if rows.size < FEWEST_ROWS:
        raise FitError(
            f"{log.name}: {rows.size} usable rows are too few: record longer, or skip less"
        )
    swings = _different_swings(log.voltage)
    middle, past = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return Beside(log, middle, past, rows, swings)


def _different_swings(voltage: Floats) -> float:
    """Return how many different swings a drive makes: in equal ones an error of the shape is the same."""
    turns = voltage[Swings.of(voltage).turns]
    levels = np.round(turns / (SAME_LEVEL * float(np.ptp(voltage))))
    return float(len(set(zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True))))


def _predicted(prior: Model, log: Recording, before: float) -> Floats:
    """Return a prediction without delay, after a long rest at a voltage and a jump to the log's first."""
    voltage = np.concatenate([[before], log.voltage])
    steps = None
    if log.time is not None:
        since = np.diff(log.time, prepend=log.time[0])
        steps = np.concatenate([[0.0], since])
    start = "empty" if before == prior.input.min else "full"
    moved, _ = prior.static.simulate(voltage, dt=steps, state=start)
    moved = moved[1:]
    if prior.dynamics is not None and log.time is not None:
        moved, _ = prior.dynamics.run(moved, steps_of(log.time))
    return moved


def _wiped_row(voltage: Floats) -> int:
    """Return the row by which a drive has been at both ends of its own range.

    From there on the past shifts the displacement, and no longer changes its shape.
    """
    return max(int(np.argmin(voltage)), int(np.argmax(voltage)))


def _stated(prior: Model) -> float:
    """Return the error (RMS) that the prior states of itself, at least ``EXACT``."""
    least = EXACT * prior.output.span
    for key in ("expected_rmse", "rmse"):
        value = prior.fit.get(key)
        if isinstance(value, float):
            return max(value, least)
    return least


def _fitted(prior: Model, beside: Sequence[Beside], clocked: bool) -> Change:
    """Return the numbers of least squares, the past an unknown of its own size.

    Errors are alike within a swing and in its like, so n rows with s different swings
    count as s. Their size is
    what the prior states of itself, or what is left where that is more.

    Raises
    ------
    FitError
        The displacement runs against the prior's.
    """
    old = prior.delay_seconds
    longest = LONGEST_DELAY * min(_usual_swing(one) for one in beside)
    delay, known = 0.0, _stated(prior)
    middle = float(np.mean([one.predicted[one.rows].mean() for one in beside]))
    active = [0, 1, 2, 3, 4] if clocked else [0, 1, 4]
    for _ in range(STEPS):
        square, along = np.zeros((5, 5)), np.zeros(5)
        total, rows, swings = 0.0, 0, 0.0
        for one in beside:
            late, table = one.columns(old + delay)
            table[:, 0] -= middle
            target = one.log.displacement[one.rows] - late
            square += table.T @ table
            along += table.T @ target
            total += float(target @ target)
            rows, swings = rows + late.size, swings + one.swings
        change, covariance = _solved(square, along, total, rows, swings, known, active)
        moved = float(np.clip(delay + change[2], -longest, longest)) - delay
        delay += moved
        if abs(moved) < 1e-4 * longest:
            break
    gain = 1.0 + float(change[0])
    if gain <= 0.0:
        raise FitError(
            f"the displacement runs against the prior's (gain {gain:.3g}): check `voltage` and "
            "`displacement`"
        )
    errors = np.sqrt(np.diag(covariance)).tolist()
    return Change(
        gain, float(change[1]), delay, middle, (errors[0], errors[1], errors[2])
    )


def _solved(
    square: Floats, along: Floats, total: float, rows: int, swings: float,
    known: float, active: list[int],
) -> tuple[Floats, Floats]:  # fmt: skip
    """Solve the normal equations of (gain, offset, delay, drift, past).

    The past lies anywhere between both ends, -1 and 1: its variance is a third. Returns
    the numbers, shape (5,), and their covariance; 0 for what is not active.
    """
    size = known**2
    change, covariance = np.zeros(5), np.zeros((5, 5))
    place = np.ix_(active, active)
    for _ in range(2):
        weight = swings / rows / size
        curvature = weight * square[place]
        curvature[-1, -1] += 3.0
        covariance[place] = np.linalg.pinv(curvature, hermitian=True)
        change[active] = covariance[place] @ (weight * along[active])
        left = total - 2.0 * change @ along + change @ square @ change
        size = max(known**2, float(left) / rows)
    return change, covariance


def _usual_swing(one: Beside) -> float:
    """Return the seconds that a swing takes; 0 without a clock."""
    dt = one.log.dt
    return 0.0 if dt is None else dt * Swings.of(one.log.voltage).usual_rows


def _shrunk(prior: Model, beside: Sequence[Beside], fitted: Change) -> Change:
    """Return each number moved by what its interval leaves of its change.

    A change d with a standard error u becomes d (1 - (2 u / d)^2), 0 within the
    interval (James and Stein's positive part). The delay first, then gain and offset
    again with that delay.
    """
    delay = _kept(fitted.delay, fitted.errors[2])
    late = prior.delay_seconds
    if delay != fitted.delay:
        again = dataclasses.replace(
            prior, stages=_with_delay(prior.stages, late + delay)
        )
        numbers = _fitted(again, beside, clocked=False)
    else:
        numbers = fitted
    gain = 1.0 + _kept(numbers.gain - 1.0, numbers.errors[0])
    offset = _kept(numbers.offset, numbers.errors[1])
    return Change(gain, offset, delay, numbers.middle, fitted.errors)


def _kept(change: float, error: float) -> float:
    """Return what is kept of a change with this standard error."""
    if abs(change) <= STUDENT * error:
        return 0.0
    return change * (1.0 - (STUDENT * error / change) ** 2)


def _left_over(
    beside: Sequence[Beside], change: Change, old_delay: float
) -> list[Floats]:
    """Return what a change leaves of each log, the past fitted within its size."""
    left = []
    for one in beside:
        late, table = one.columns(max(old_delay + change.delay, 0.0))
        rest = one.log.displacement[one.rows] - change.gain * late - change.shift
        past = table[:, 4]
        share = float(past @ rest) / max(float(past @ past), 1e-300)
        rest -= min(max(share, -1.0), 1.0) * past
        left.append(
            rest - float(table[:, 3] @ rest / (table[:, 3] @ table[:, 3])) * table[:, 3]
        )
    return left


def _check_shape(
    prior: Model, fitted: Change, left: Sequence[Floats], name: str, force: bool
) -> list[str]:
    """Refuse logs that the prior's shape does not follow, the sensor's noise aside; warn where forced."""
    own = fitted.gain * _stated(prior)
    unit = prior.output.suffix
    squares = np.mean(np.concatenate(left) ** 2)
    noise = np.mean(np.concatenate([np.diff(part, 2) for part in left]) ** 2) / 6.0
    shape = float(np.sqrt(max(squares - noise, 0.0)))
    if shape <= BROKEN * own:
        return []
    text = (
        f"{name}: the shape has changed: with gain, offset and delay found again the prior leaves "
        f"{shape:.4g}{unit}, where it stated {own:.4g}{unit}; identify again from a whole log, without "
        "`prior`"
    )
    if not force:
        raise FitError(f"{text} (`force` keeps the shape)")
    return [text]


def _past_matters(prior: Model, beside: Sequence[Beside]) -> list[str]:
    """Return a warning where the past before the logs hides a change of offset."""
    shifts = [float(np.abs(one.past[one.rows]).mean()) for one in beside]
    if min(shifts) <= BROKEN * _stated(prior):
        return []
    return [
        f"what was before the log may shift its displacement by {min(shifts):.3g}{prior.output.suffix}, so a "
        "smaller change of offset is not seen: begin with a sweep over the whole range"
    ]


# --- the refreshed model ---


def _refreshed(
    prior: Model,
    change: Change,
    left: Sequence[Floats],
    recordings: Sequence[Recording],
    warnings: list[str],
) -> Model:
    """Return the prior's model, candidates and figures with the change."""
    candidates = []
    for one in prior.candidates:
        candidates.append(Candidate(one.weight, _moved(one.stages, change)))
    gain = change.gain
    low, high = prior.output.min, prior.output.max
    output = Quantity(
        prior.output.quantity,
        prior.output.unit,
        gain * low + change.shift,
        gain * high + change.shift,
    )
    rmse = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
    fit = dict(prior.fit)
    for key in ("expected_rmse", "left_out_rmse"):
        if isinstance(fit.get(key), float):
            fit[key] = max(gain * fit[key], rmse)
    if isinstance(fit.get("line_rmse"), float):
        fit["line_rmse"] = gain * fit["line_rmse"]
    logs: list[dict[str, Any]] = []
    for log, part in zip(recordings, left, strict=True):
        error = float(np.sqrt(np.mean(part**2)))
        logs.append({"name": log.name, "rows": part.size, "rmse": error})
    gain_error, offset_error, delay_error = change.errors
    fit |= {
        "method": "prior",
        "rmse": rmse,
        "logs": logs,
        "validation": [],
        "warnings": warnings,
        "notes": [],
        "prior": {
            "gain": gain,
            "offset": change.shift,
            "delay_seconds": change.delay,
            "gain_within": STUDENT * gain_error,
            "offset_within": STUDENT * offset_error,
            "delay_within": STUDENT * delay_error,
            "digest": prior.digest,
        },
    }
    stages = _moved(prior.stages, change)
    return dataclasses.replace(
        prior, stages=stages, output=output, fit=fit, candidates=tuple(candidates)
    )


def _moved(stages: Sequence[Any], change: Change) -> tuple[Any, ...]:
    """Return stages with another gain, offset and delay."""
    old = sum(stage.seconds for stage in stages if isinstance(stage, Delay))
    moved = list(_with_delay(stages, max(old + change.delay, 0.0)))
    place = len(moved)
    while isinstance(moved[place - 1], Dynamics | Delay):
        place -= 1
    last = moved[place - 1]
    if isinstance(last, Scale):
        offset = change.gain * last.offset + change.shift
        moved[place - 1] = Scale(change.gain * last.gain, offset)
    elif change.gain != 1.0 or change.shift != 0.0:
        moved.insert(place, Scale(change.gain, change.shift))
    return tuple(moved)


def _with_delay(stages: Sequence[Any], seconds: float) -> tuple[Any, ...]:
    """Return stages with this delay in the place of their own."""
    bare = [stage for stage in stages if not isinstance(stage, Delay)]
    if seconds > 0.0:
        bare.append(Delay(seconds))
    return tuple(bare)
