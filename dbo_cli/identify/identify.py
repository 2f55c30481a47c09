"""Identification of a model from recordings: the whole story on one screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dbo_cli.errors import FitError, warn
from dbo_cli.identify.clean import clean
from dbo_cli.identify.distill import Average, distill, invented_log
from dbo_cli.identify.judge import kind_errors
from dbo_cli.identify.problem import Problem, prepare
from dbo_cli.identify.recording import Floats, Options, Recording
from dbo_cli.identify.search import Search, choices_for
from dbo_cli.identify.stages import model_of
from dbo_cli.model import Model, steps_of
from dbo_cli.model.expect import expected_error, fastest_drive, longest_rest

CANDIDATES = 5  # that travel in the model file


def identify(
    recordings: Sequence[Recording],
    options: Options | None = None,
    validation: Sequence[Recording] = (),
) -> Model:
    """Identify a model from logs of one actuator.

    Parameters
    ----------
    recordings : the logs
    options : what the user fixed
    validation : logs that the model is tried on

    Raises
    ------
    FitError
        No model better than a straight line can be identified.
    """
    options = options or Options()
    logs, notes = clean(recordings, options)
    if options.method == "paper" or options.prior is not None:
        model = _without_search(logs, options)
    else:
        model = _searched(logs, options)
    model = _measured(model, logs, options, notes)
    model = _validated(model, validation)
    for text in model.fit["warnings"]:
        warn(text)
    return model


def _without_search(logs: Sequence[Recording], options: Options) -> Model:
    """Return the paper's model, or a prior brought to these logs."""
    if options.method == "paper":
        from dbo_cli.identify.paper import identify_paper

        return identify_paper(logs[0], options)
    from dbo_cli.identify.prior import rescale

    assert options.prior is not None
    return rescale(options.prior, logs, options)


def _searched(logs: Sequence[Recording], options: Options) -> Model:
    """Return the average of the structures that explain the logs, as one model with its candidates."""
    problem, choices = choices_for(prepare(logs, options), options)
    fits = Search(problem, choices).run()
    if not fits:
        raise FitError("no model can be fitted to the logs; leave out bad rows")
    average = Average.of(fits)
    fit = distill(problem, average)
    others = list(zip(average.weights, average.fits, strict=True))[:CANDIDATES]
    total = sum(weight for weight, _ in others)
    others = [(weight / total, other) for weight, other in others]
    model = model_of(problem, fit, logs[0], options, others)
    left = left_out_rmse(problem, average)
    model = replace(model, fit={"left_out_rmse": left})
    invented = invented_log(problem)
    drive = problem.low + (problem.high - problem.low) * np.clip(invented.drive, 0.0, 1.0)
    expected = expected_error(model, drive, problem.dt)
    return replace(
        model,
        fit={
            "method": "least-squares",
            "expected_rmse": expected,
            "left_out_rmse": left,
            "one_amplitude": problem.one_amplitude,
        },
    )


def left_out_rmse(problem: Problem, average: Average) -> float:
    """Return the RMS over kinds of what the mean prediction leaves of parts left out, in the output's unit."""
    left = []
    for number in range(len(problem.parts)):
        parts = [fit.left[number] for fit in average.fits]
        left.append(np.einsum("k,kr->r", average.weights, np.stack(parts)))
    errors = kind_errors(problem.parts, tuple(left))
    mean = float(np.mean([error**2 for error in errors.values()]))
    return abs(problem.scale) * math.sqrt(mean)


# --- figures of the fit ---


@dataclass(frozen=True)
class Residual:
    """What a model leaves of a log: RMS of the error less offset, in the displacement's unit."""

    name: str
    rows: int
    rmse: float
    drift: float


def _measured(
    model: Model, logs: Sequence[Recording], options: Options, notes: Sequence[str]
) -> Model:
    """Return the model with its figures on the logs; refuse what is no better than a straight line."""
    residuals = [residual_of(model, log) for log in logs]
    rmse = _pooled(residuals)
    line = line_rmse(logs)
    warnings = []
    if rmse > line:
        text = (
            f"the model (RMSE {rmse:.4g}) is no better than a straight line (RMSE {line:.4g}); record more"
            " amplitudes and cycles, or check columns and sensor"
        )
        if not options.force:
            raise FitError(f"{text} (`force` keeps the model)")
        warnings.append(text)
    speeds, rests = [], []
    for log in logs:
        if log.time is not None:
            steps = np.diff(log.time)
            speeds.append(fastest_drive(log.voltage, steps))
            rests.append(longest_rest(log.voltage, steps))
    figures: dict[str, Any] = {
        "sign": model.sign,
        "rmse": rmse,
        "line_rmse": line,
        "fastest": max(speeds, default=None),
        "longest_rest": max(rests, default=None),
        "logs": [
            {"name": log.name, "rows": log.rows, "rmse": log.rmse, "drift": log.drift}
            for log in residuals
        ],
        "warnings": warnings,
        "notes": list(notes),
    }
    return replace(model, fit={**model.fit, **figures})


def predicted(model: Model, log: Recording) -> Floats:
    """Return what a model makes of a log's drive."""
    steps: float | Floats | None = None
    if log.time is not None:
        steps = steps_of(log.time)
    y, _ = model.simulate(log.voltage, dt=steps)
    return y


def residual_of(model: Model, log: Recording) -> Residual:
    """Return what a model leaves of a log, offset and a straight drift in time aside."""
    rows = log.usable
    error = (log.displacement - predicted(model, log))[rows]
    place = np.linspace(-1.0, 1.0, len(error))
    drift = 3.0 * float(np.mean(place * error)) / 1.0
    left = error - error.mean()
    return Residual(log.name, len(error), float(np.sqrt(np.mean(left**2))), 2.0 * drift)


def _pooled(residuals: Sequence[Residual]) -> float:
    """Return the RMS over all rows."""
    squares = sum(log.rows * log.rmse**2 for log in residuals)
    return math.sqrt(squares / sum(log.rows for log in residuals))


def line_rmse(logs: Sequence[Recording]) -> float:
    """Return what one straight line, with an offset for each log, leaves of the logs."""
    slopes = [0.0, 0.0]
    for log in logs:
        v, y = log.voltage[log.usable], log.displacement[log.usable]
        slopes[0] += float((v - v.mean()) @ (y - y.mean()))
        slopes[1] += float((v - v.mean()) @ (v - v.mean()))
    gain = slopes[0] / max(slopes[1], 1e-300)
    squares, rows = 0.0, 0
    for log in logs:
        left = log.displacement[log.usable] - gain * log.voltage[log.usable]
        squares += float(((left - left.mean()) ** 2).sum())
        rows += len(left)
    return math.sqrt(squares / rows)


def _validated(model: Model, validation: Sequence[Recording]) -> Model:
    """Return the model with its errors on logs that it was not made from."""
    entries = []
    for log in validation:
        error = (log.displacement - predicted(model, log))[log.usable]
        entries.append(
            {
                "name": log.name,
                "rmse": float(np.sqrt(np.mean(error**2))),
                "offset_free_rmse": float(np.std(error)),
            }
        )
    return replace(model, fit={**model.fit, "validation": entries})


def describe(model: Model) -> str:
    """Return in one line what to expect of a model."""
    fit, unit = model.fit, model.output.suffix
    expected = fit.get("expected_rmse")
    if expected is None:
        return f"fit RMSE {fit['rmse']:.3g}{unit}; what to expect on new moves is not known"
    percent = 100.0 * expected / model.output.span
    return (
        f"expected error {expected:.3g}{unit} ({percent:.2g} % of range);"
        f" a straight line would leave {fit['line_rmse']:.3g}{unit}"
    )
