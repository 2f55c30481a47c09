"""A model refreshed from a short log: gain, offset and lag are found again, the shape of the loop is kept.

After a change of temperature, load or mounting the loop of an actuator is mostly scaled
and shifted, and its electronics are a little later or earlier. Three numbers need
seconds of a log where a shape needs minutes: displacement = g · prior(v, t − d) + o.
Whether the shape has changed, too, shows in what is left over.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.identification.cleaning import (
    LONGEST_DELAY,
    Sensor,
    mended,
    without_voltage_glitches,
)
from dbo_cli.hysteresis.identification.evaluation import (
    FOLDS,
    STUDENT,
    beyond_noise,
    known_rows,
    predict,
    rated_warnings,
    validated,
    validations_of,
    with_its_error,
)
from dbo_cli.hysteresis.identification.identify import BROKEN, Identification
from dbo_cli.hysteresis.identification.preparation import STARTS, drift_order
from dbo_cli.hysteresis.identification.recordings import (
    FEWEST_ROWS,
    MOST,
    Booleans,
    Floats,
    IdentificationOptions,
    Recording,
    drive_shape,
    first_wiped_row,
    median_cycle_seconds,
)
from dbo_cli.hysteresis.identification.statistics import (
    drift_columns,
    row_weights,
    weighted,
)
from dbo_cli.hysteresis.model import ActuatorModel, DelayStage, ScaleStage
from dbo_cli.hysteresis.move_error import ZERO_STAYS, Alternative, alternatives_of

WITHIN_STATED = 1.4
"""Times the stated error: 1.96 standard deviations of an error that comes at 0.72 of it, in the middle of
many moves (benchmarks/foreign_plants.py).
"""
# delays tried within an eighth of a cycle to either side; parabolas refine the best
TRIALS = 41
KEPT = ("gears", "different_slopes", "points", "drive_bend", "slopes", "smoothness", "loop_width_percent",
        "relaxation_seconds", "fastest_drive", "swings", "dynamics", "trusted_hz",
        "interpretation")  # fmt: skip
"""What a prior's file says of its shape."""


OF_OTHERS = "of_other_actuators"
"""Key of a prior's ``fit``: it is the shape of several actuators, so that no number of it is an old one."""


@dataclass(frozen=True)
class _Moved:
    """What moved, and by how much the log may err: gain, offset, and the change of the lag in s.

    The errors are half widths of 95 % intervals, widened by what the prior's own error
    can feign. ``fitted_gain`` and ``fitted_lag`` fit the log best, whether or not they
    can be told from the old ones.
    """

    gain: float
    gain_error: float
    offset: float
    lag: float
    lag_error: float
    fitted_gain: float
    fitted_lag: float

    def delay_behind(self, prior: ActuatorModel) -> float:
        """Return the delay of the refreshed model (s), none below 0."""
        return max(prior.delay_seconds + self.lag, 0.0)


@dataclass(frozen=True)
class _Log:
    """One log beside what the prior predicts without its delay; ``keep`` are the rows that count.

    ``levels_apart`` is how far the history before the log can shift the prediction's
    mean; ``weights`` are the roots of the weights of the rows that count, None where
    they count alike.
    """

    name: str
    seconds: Floats | None
    predicted: Floats
    measured: Floats
    drift: Floats
    keep: Booleans
    levels_apart: float
    weights: Floats | None

    def late(self, delay: float) -> Floats:
        """Return the prediction ``delay`` seconds later, for the rows that count."""
        if self.seconds is None or delay == 0.0:
            return self.predicted[self.keep]
        late: Floats = np.interp(self.seconds - delay, self.seconds, self.predicted)
        return late[self.keep]

    def shifted_by(self, seconds: float) -> float:
        """Return how far a delay of ``seconds`` moves the prediction, RMS."""
        return float(np.sqrt(np.mean((self.late(seconds) - self.late(0.0)) ** 2)))

    def free_of_drift(self, values: Floats) -> Floats:
        """Return values of the rows that count without offset and drift, weighted."""
        columns = weighted(self.drift[self.keep], self.weights)
        values = weighted(values, self.weights)
        terms = np.linalg.lstsq(columns, values, rcond=None)[0]
        free: Floats = values - columns @ terms
        return free

    def products(self, delay: float) -> Floats:
        """Return the products of prediction and measurement, both free of drift; shape (FOLDS, 2, 2)."""
        predicted = self.free_of_drift(self.late(delay))
        measured = self.free_of_drift(self.measured[self.keep])
        table = np.column_stack((predicted, measured))
        return np.array([part.T @ part for part in np.array_split(table, FOLDS)])


def refresh(
    prior: ActuatorModel,
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording] = (),
) -> Identification:
    """Return the prior with gain, offset and delay of recordings that were checked (see ``identify``).

    Raises
    ------
    FitError
        The prior's shape does not follow the recordings.
    UsageError
        Options that fix what the prior has, or a prior that needs a clock where there
        is none.
    """
    options.check_prior()
    prior.require("forward", "the prior")
    clocked = all(log.seconds() is not None for log in recordings)
    if prior.needs_time and not clocked:
        raise UsageError(
            "`prior` has a lag, which needs a clock: name the time column (`time`) or give `sample_rate`"
        )
    cycle = median_cycle_seconds(recordings)
    sensor = Sensor.of(options) or _sensor_of(prior.fit)
    sensor.check(cycle)

    notes: list[str] = []
    recordings = [sensor.taken_off(log) for log in recordings]
    recordings = [without_voltage_glitches(log, notes) for log in recordings]
    logs = _beside(prior, recordings, options.skip_seconds, notes)
    moved = _moved(prior, logs, recordings, cycle)
    model = _refreshed(prior, moved)

    unit = prior.output.suffix
    covered = _covered(recordings)
    warnings = _check_shape(prior, logs, moved, unit, options.force)
    warnings += _warnings(prior, logs, moved, unit)
    warnings += rated_warnings(*covered, options.rated)
    checks = validations_of(model, validation, sensor, options.skip_seconds)
    validation_figures, lines = validated(checks, model.output.span, unit)
    figures = _figures(prior, moved, logs) | validation_figures
    summary = [*notes, *_summary(figures, moved, prior, clocked, covered), *lines]
    figures["alternatives"] = [
        _moved_along(other, moved).values() for other in alternatives_of(prior)
    ]
    if sensor:
        figures["sensor"] = {"delay": sensor.delay, "lag": sensor.lag}
    figures["warnings"] = list(warnings)
    model = dataclasses.replace(model, fit=figures)
    return Identification(model, figures, summary, warnings)


def _covered(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the least and the greatest voltage of the logs."""
    lowest = min(float(log.voltage.min()) for log in recordings)
    highest = max(float(log.voltage.max()) for log in recordings)
    return lowest, highest


def _refreshed(prior: ActuatorModel, moved: _Moved) -> ActuatorModel:
    """Return the prior with the gain, offset and delay that were found."""
    bare = _with_delay(prior, 0.0)
    return _with_delay(
        _scaled(bare, moved.gain, moved.offset), moved.delay_behind(prior)
    )


def _sensor_of(fit: Mapping[str, object]) -> Sensor:
    """Return the sensor whose lag was taken off the prior's own logs."""
    sensor = fit.get("sensor")
    if not isinstance(sensor, Mapping):
        return Sensor()
    return Sensor(float(sensor["delay"]), float(sensor["lag"]))


def _rows_that_count(log: Recording, skip_seconds: float) -> Booleans:
    """Return the rows of a log that tell what moved (FitError where they are too few)."""
    keep = known_rows(log, skip_seconds)
    if log.faulty is not None:
        keep &= ~log.faulty
    wiped = first_wiped_row(log.voltage)
    if wiped <= MOST * len(keep):
        keep[:wiped] = False  # on a way up from rest no start may follow the actuator
    if int(keep.sum()) < FEWEST_ROWS:
        raise FitError(
            f"{log.name}: {int(keep.sum())} usable rows are too few: record longer, or skip less"
        )
    return keep


def _beside(
    prior: ActuatorModel,
    recordings: Sequence[Recording],
    skip_seconds: float,
    notes: list[str],
) -> list[_Log]:
    """Return the logs, their faults mended, beside what the prior predicts without its delay."""
    bare = _with_delay(prior, 0.0)
    mended_logs = [mended(log, notes) for log in recordings]
    rows = [_rows_that_count(log, skip_seconds) for log in mended_logs]
    weights = row_weights([log.uncertainty for log in mended_logs], rows)
    return [
        _from_best_start(bare, log, keep, roots)
        for log, keep, roots in zip(mended_logs, rows, weights, strict=True)
    ]


def _from_best_start(
    prior: ActuatorModel, log: Recording, keep: Booleans, weights: Floats | None
) -> _Log:
    """Return a log beside the prediction from the start that explains it best."""
    seconds = log.seconds()
    roots = None if weights is None else weights[keep]
    known: Floats | None = None
    clock = np.arange(len(keep), dtype=float)
    if seconds is not None:
        known = clock = np.maximum.accumulate(seconds)
    order = min(drift_order(drive_shape(log.voltage), seconds is not None, False), 1)
    drift = drift_columns(clock, order)
    logs, errors = [], []
    for start in STARTS:
        predicted = predict(prior, log, start)
        beside = _Log(
            log.name, known, predicted, log.displacement, drift, keep, 0.0, roots
        )
        logs.append(beside)
        errors.append(_gain_and_error(beside.products(0.0).sum(axis=0))[1])
    levels = [float(beside.late(0.0).mean()) for beside in logs]
    best = logs[errors.index(min(errors))]
    return dataclasses.replace(best, levels_apart=max(levels) - min(levels))


def _gain_and_error(products: Floats) -> tuple[float, float]:
    """Return the gain of least squares and the sum of squares that it leaves."""
    gain = float(products[0, 1] / products[0, 0])
    return gain, max(float(products[1, 1] - gain * products[0, 1]), 0.0)


def _products(logs: Sequence[_Log], delay: float) -> Floats:
    """Return the products of all logs, block by block."""
    together: Floats = np.sum([log.products(delay) for log in logs], axis=0)
    return together


def _interval(parts: Sequence[float]) -> float:
    """Return the half width of the jackknife's 95 % interval, from fits without one block each."""
    return STUDENT * float(np.sqrt(FOLDS - 1.0) * np.std(parts))


def _own_error(prior: ActuatorModel) -> float:
    """Return the error (RMS) that the prior states of itself; 0 where it does not."""
    for key in ("expected_rmse", "rmse"):
        stated = prior.fit.get(key)
        if isinstance(stated, float):
            return stated
    return 0.0


def _moved(
    prior: ActuatorModel,
    logs: Sequence[_Log],
    recordings: Sequence[Recording],
    cycle: float | None,
) -> _Moved:
    """Return gain, offset and change of the prior's lag; no change of it without a clock.

    An old number holds unless the log speaks against it by more than it can know: the
    interval of its own blocks, and what the prior's own error can feign: that of a gain
    whose swings err apart (``_gain_of_shape``), and where all err alike. Of a prior that
    is the shape of others (``OF_OTHERS``) no number is an old one: those that fit best
    are taken.

    Raises
    ------
    FitError
        The displacement goes the other way.
    """
    may_hold = not prior.fit.get(OF_OTHERS, False)
    own_error, delay = _own_error(prior), prior.delay_seconds
    lag, lag_error = 0.0, 0.0
    if cycle is not None:
        lag, lag_error = _lag(logs, delay, LONGEST_DELAY / 2.0 * cycle)
    fitted_lag = lag
    if may_hold and max(log.shifted_by(lag) for log in logs) <= own_error:
        lag = 0.0
    products = _products(logs, max(delay + lag, 0.0))
    total = products.sum(axis=0)
    gain = fitted_gain = _gain_and_error(total)[0]
    interval = _interval([_gain_and_error(total - part)[0] for part in products])
    gain_error = math.hypot(interval, _gain_of_shape(prior, logs, recordings))
    rows = sum(int(log.keep.sum()) for log in logs)
    feigned = own_error / math.sqrt(total[0, 0] / rows)
    gain_holds = may_hold and abs(gain - 1.0) <= max(gain_error, feigned)
    if gain_holds:
        gain = 1.0
    offset = _offset(logs[0], gain, max(delay + lag, 0.0))
    if gain_holds and abs(offset) <= own_error:
        offset = 0.0
    if gain <= 0.0:
        raise FitError(
            f"the displacement runs against the prior's (gain {gain:.3g}): check `voltage` and "
            "`displacement`"
        )
    return _Moved(gain, gain_error, offset, lag, lag_error, fitted_gain, fitted_lag)


def _offset(log: _Log, gain: float, delay: float) -> float:
    """Return the mean distance of a log from the prediction, by the weights of its rows."""
    apart = log.measured[log.keep] - gain * log.late(delay)
    weights = None if log.weights is None else log.weights**2
    return float(np.average(apart, weights=weights))


def _gain_of_shape(
    prior: ActuatorModel, logs: Sequence[_Log], recordings: Sequence[Recording]
) -> float:
    """Return the half width of 95 % that the prior's own error adds to the gain; 0 where it states none.

    That error is no noise: it is the same in every log. In a swing it may look like a
    gain, of its size over the prediction's and of one sign or the other; over the
    swings of the logs it averages out.
    """
    error = prior.fit.get("expected_shape_rmse", prior.fit.get("expected_rmse"))
    if not isinstance(error, float):
        return 0.0
    squares = [float(np.sum(log.free_of_drift(log.late(0.0)) ** 2)) for log in logs]
    rows = sum(int(log.keep.sum()) for log in logs)
    swings = sum(len(drive_shape(log.voltage).turns) + 1 for log in recordings)
    return WITHIN_STATED * error / math.sqrt(sum(squares) / rows * swings)


def _lag(logs: Sequence[_Log], delay: float, longest: float) -> tuple[float, float]:
    """Return the change of the delay (s) that fits best, 0 where it scatters by as much, and its interval."""
    trials = np.linspace(-longest, longest, TRIALS)
    errors = [
        _gain_and_error(_products(logs, delay + at).sum(axis=0))[1] for at in trials
    ]
    middle = float(trials[np.clip(int(np.argmin(errors)), 1, TRIALS - 2)])
    step = 2.0 * longest / (TRIALS - 1)
    parts: list[float] = []
    # parabolas over the neighbours, over a quarter of that and a sixteenth
    for _ in range(3):
        around = np.array(
            [_products(logs, delay + middle + at) for at in (-step, 0.0, step)]
        )
        totals = np.array([each.sum(axis=0) for each in around])
        parts = [step * _least_at(totals - around[:, k]) for k in range(FOLDS)]
        middle += step * _least_at(totals)
        step /= 4.0
    error = _interval(parts)
    return (middle if abs(middle) > error else 0.0), error


def _least_at(products: Floats) -> float:
    """Return where, of three delays with these products, the error is least."""
    return _vertex([_gain_and_error(each)[1] for each in products])


def _vertex(errors: Sequence[float]) -> float:
    """Return where the parabola through errors at -1, 0 and 1 is least, at most 1 away."""
    before, at, after = errors
    curvature = before - 2.0 * at + after
    if not curvature > 0.0:
        return 0.0
    return float(np.clip((before - after) / (2.0 * curvature), -1.0, 1.0))


def _scaled(model: ActuatorModel, gain: float, offset: float) -> ActuatorModel:
    """Return a model whose displacement is ``gain`` times as large and shifted by ``offset``."""
    stages = list(model.stages)
    last = stages.index(model.backlash) + len(model.tail)
    scale = stages[last]
    if isinstance(scale, ScaleStage):
        stages[last] = ScaleStage(gain * scale.gain, gain * scale.offset + offset)
    else:
        stages.insert(last + 1, ScaleStage(gain, offset))
    ends = model.output
    output = dataclasses.replace(
        ends, minimum=gain * ends.minimum + offset, maximum=gain * ends.maximum + offset
    )
    return dataclasses.replace(model, stages=tuple(stages), output=output)


def _with_delay(model: ActuatorModel, seconds: float) -> ActuatorModel:
    """Return a model with this delay in the place of its own."""
    bare = model.without(model.delay)
    if seconds <= 0.0:
        return bare
    return dataclasses.replace(bare, stages=(*bare.stages, DelayStage(seconds)))


def _moved_along(other: Alternative, moved: _Moved) -> Alternative:
    """Return another model that explained the prior's logs, with the same gain, offset and change of lag."""
    bare = _scaled(_with_delay(other.model, 0.0), moved.gain, moved.offset)
    delay = max(other.model.delay_seconds + moved.lag, 0.0)
    return dataclasses.replace(other, model=_with_delay(bare, delay))


def _figures(
    prior: ActuatorModel, moved: _Moved, logs: Sequence[_Log]
) -> dict[str, object]:
    """Return what the prior's file says of its fit, brought up to date; what no longer holds is left out."""
    span = moved.gain * prior.output.span
    delay = moved.delay_behind(prior)
    parts = [_left_over(log, moved.gain, delay) for log in logs]
    rows = np.array([len(part) for part in parts], dtype=float)
    errors = np.array([float(np.sqrt(np.mean(part**2))) for part in parts])
    rmse = float(np.sqrt(rows @ errors**2 / rows.sum()))
    figures = {key: value for key, value in prior.fit.items() if key in KEPT}
    expected = _expected(prior, moved.gain)
    if expected is not None:
        expected = max(expected, rmse)  # no new move is followed better than this log
        known = prior.fit.get("left_out_rmse")
        if isinstance(known, float):
            figures["left_out_rmse"] = max(moved.gain * known, rmse)
        figures["expected_from"] = (
            "the prior's expectation, or what is left on these logs where that is more"
        )
        figures |= _parts_of_prior(prior, moved.gain, rmse)
    figures |= {
        "method": "prior",
        "rmse": rmse,
        "rmse_percent": 100.0 * rmse / span,
        "expected_rmse": expected,
        "expected_percent": None if expected is None else 100.0 * expected / span,
        "samples": int(rows.sum()),
        "delay_seconds": delay,
        "delay_interval_seconds": None,
        "prior": _change_figures(prior, moved),
        "logs": [
            {"name": log.name, "samples": len(part), "rmse": float(error)}
            for log, part, error in zip(logs, parts, errors, strict=True)
        ],
    }
    return figures


def _change_figures(prior: ActuatorModel, moved: _Moved) -> dict[str, object]:
    """Return by how much the prior's numbers have moved, and its own errors."""
    gain, gain_error = moved.gain, moved.gain_error
    lag, lag_error = moved.lag, moved.lag_error
    return {
        "gain": gain,
        "gain_interval": [gain - gain_error, gain + gain_error],
        "offset": moved.offset,
        "delay_seconds": moved.delay_behind(prior) - prior.delay_seconds,
        "delay_interval_seconds": [lag - lag_error, lag + lag_error],
        "rmse": prior.fit.get("rmse"),
        "expected_rmse": prior.fit.get("expected_rmse"),
    }


def _parts_of_prior(
    prior: ActuatorModel, gain: float, rmse: float
) -> dict[str, object]:
    """Return shape and zero of the prior's expected error, and what bounds them, in the new displacement."""
    parts: dict[str, object] = {}
    for key in ("expected_zero", "line_left_out_rmse", "zero_drift", "zero_drift_rate"):
        value = prior.fit.get(key)
        if isinstance(value, float):
            parts[key] = gain * value
    shape = prior.fit.get("expected_shape_rmse")
    if isinstance(shape, float):
        parts["expected_shape_rmse"] = max(gain * shape, rmse)
        parts["zero_from"] = prior.fit.get("zero_from", ZERO_STAYS)
    return parts


def _expected(prior: ActuatorModel, gain: float) -> float | None:
    """Return the error that the prior states for new moves, in the refreshed displacement, or None."""
    stated = prior.fit.get("expected_rmse")
    return gain * stated if isinstance(stated, float) else None


def _left_over(log: _Log, gain: float, delay: float) -> Floats:
    """Return what gain, offset, lag and drift leave of a log's rows that count."""
    return log.free_of_drift(log.measured[log.keep] - gain * log.late(delay))


def _check_shape(
    prior: ActuatorModel, logs: Sequence[_Log], moved: _Moved, unit: str, force: bool
) -> list[str]:
    """Refuse logs that the prior's shape does not follow, the sensor's noise aside; warn where forced.

    What is left is held against the prior's own fit, both without what gain and lag
    explain. Four invented actuators, logs of 2 to 4 s over a fifth to the whole of the
    range: the same shape left at most 1.1 times the prior's fit, noise and all; where
    it was at rest before (Bouc and Wen), up to 2.1 times. A loop 1.25 or 1.4 times as
    wide left 1.6 to 9 times, another bend 0.8 (over a fifth of the range) to 11. A lag
    below none, which no model has, takes part: it has a warning of its own.
    """
    own_fit = prior.fit.get("rmse")
    if not isinstance(own_fit, float):
        return [
            "the prior does not say how well it fitted, so whether its shape has changed is not known"
        ]
    worst, why = BROKEN * moved.fitted_gain * own_fit, ""
    for log in logs:
        left = _left_over(
            log, moved.fitted_gain, prior.delay_seconds + moved.fitted_lag
        )
        structure = float(np.sqrt(beyond_noise([left])))
        if structure > worst:
            worst = structure
            why = (
                f"{log.name}: the shape has changed: with gain, offset and lag found again the prior leaves "
                f"{structure:.4g}{unit} beside noise, where its own fit left {own_fit:.4g}{unit}; identify "
                "again from a whole log, without `prior`, or begin with a sweep over the whole range: what "
                "was before the log may be to blame"
            )
    if why and not force:
        raise FitError(f"{why} (`force` keeps the shape)")
    return [why] if why else []


def _warnings(
    prior: ActuatorModel, logs: Sequence[_Log], moved: _Moved, unit: str
) -> list[str]:
    """Return what to be careful about: an unknown past or a lag below none that matter beside the rest."""
    warnings = []
    lag = prior.delay_seconds + moved.lag
    rmse = float(
        np.sqrt(
            np.mean(
                np.concatenate([_left_over(log, moved.gain, lag) for log in logs]) ** 2
            )
        )
    )
    apart = moved.gain * max(log.levels_apart for log in logs)
    if apart > rmse:
        warnings.append(
            f"what was before the logs can shift the offset by {apart:.3g}{unit}: begin with a sweep over "
            "the whole range"
        )
    if lag < 0.0 and moved.gain * max(log.shifted_by(lag) for log in logs) > rmse:
        warnings.append(
            f"the displacement comes {-1e3 * lag:.3g} ms earlier than the prior's without any delay: its "
            "other lag is too long now; identify again without `prior`"
        )
    return warnings


def _summary(
    figures: Mapping[str, Any],
    moved: _Moved,
    prior: ActuatorModel,
    clocked: bool,
    covered: tuple[float, float],
) -> list[str]:
    """Return lines for the person at the terminal."""
    unit = prior.output.suffix
    lag = "no clock, so the lag is the prior's"
    if clocked:
        change = 1e3 * figures["prior"]["delay_seconds"]
        late, within_late = with_its_error(change, 1e3 * moved.lag_error, sign=True)
        lag = f"lag {late} ms (within {within_late})"
        if not change:
            lag = f"lag as it was (within {within_late} ms)"
    drive = prior.input.suffix
    ends = prior.input.minimum, prior.input.maximum
    gain, within_gain = with_its_error(moved.gain, moved.gain_error)
    lines = [
        f"the prior's shape was kept; moved: gain {gain} times the prior's (within {within_gain}), offset "
        f"{moved.offset:+.4g}{unit}, {lag}",
        f"fit RMSE {figures['rmse']:.4g}{unit} ({figures['rmse_percent']:.2f} % of the model's range) on "
        f"{figures['samples']:,} rows from {covered[0]:g} to {covered[1]:g}{drive}; the prior covers "
        f"{ends[0]:g} to {ends[1]:g}{drive}",
    ]
    if figures["expected_rmse"] is not None:
        lines.append(
            f"expected on new moves inside the range: {figures['expected_rmse']:.4g}{unit} "
            f"({figures['expected_percent']:.2f} % of the model's range), from {figures['expected_from']}"
        )
    return lines
