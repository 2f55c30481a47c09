"""What a model file says of its fit: errors on the logs, on parts left out and on new moves; warnings."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.errors import FitError, LimitError
from dbo_cli.identification.distill import Average, invented_log
from dbo_cli.identification.judge import error_left_out
from dbo_cli.identification.problem import Problem, falling
from dbo_cli.identification.recording import Options, Recording, Swings
from dbo_cli.model import Cascade
from dbo_cli.model.expect import expected_error, fastest_drive, longest_rest

NO_BETTER = 0.95  # of a straight line's error: above it there is nothing but a line
FEW_SWINGS = 4  # fewer leave nothing that the rest holds, too
LARGE_DRIFT = 0.05  # of the range: no sensor's


def refuse_other_sign(logs: Sequence[Recording], options: Options) -> None:
    """Refuse (LimitError) logs whose displacement does not go the way that the user says."""
    if options.sign is None:
        return
    sign = "falling" if falling(logs) else "rising"
    if sign != options.sign:
        raise LimitError(
            f"{logs[0].name}: displacement is {sign} with voltage, `sign` is {options.sign}: check "
            "the columns"
        )


def stated(
    model: Cascade, problem: Problem, average: Average, logs: Sequence[Recording]
) -> Cascade:
    """Return the model with the error to expect on an invented move.

    No part that was left out is predicted better than the logs are followed, row by row.
    """
    followed = pooled([residual_of(model, log) for log in logs])
    left = max(left_out_rmse(problem, average), followed)
    figures = {"method": "least-squares", **model.fit, "left_out_rmse": left}
    model = replace(model, fit=figures)
    invented = invented_log(problem)
    inside = np.clip(invented.drive, 0.0, 1.0)
    drive = problem.low + (problem.high - problem.low) * inside
    figures |= {
        "expected_rmse": expected_error(model, drive, invented.dt),
        "one_amplitude": problem.one_amplitude,
        "swings": problem.swing_count,
    }
    return replace(model, fit=figures)


def left_out_rmse(problem: Problem, average: Average) -> float:
    """Return the RMS over parts left out of what the mean prediction leaves of them, in the output's unit."""
    left = []
    for number in range(len(problem.parts)):
        parts = [fit.left[number] for fit in average.fits]
        left.append(np.einsum("k,kr->r", average.weights, np.stack(parts)))
    return abs(problem.scale) * error_left_out(left)


def measured(
    model: Cascade, logs: Sequence[Recording], options: Options, notes: Sequence[str]
) -> Cascade:
    """Return the model with its figures on the logs; refuse (FitError) what is no better than a line."""
    residuals = [residual_of(model, log) for log in logs]
    rmse, line = pooled(residuals), line_rmse(logs)
    _refuse_no_better(rmse, line, logs, options)
    speeds, rests = [], []
    for log in logs:
        if log.time is not None:
            steps = np.diff(log.time)
            speeds.append(fastest_drive(log.voltage, steps))
            rests.append(longest_rest(log.voltage, steps))
    figures: dict[str, Any] = {
        **model.fit,
        "sign": model.sign,
        "rmse": rmse,
        "line_rmse": line,
        "fastest": max(speeds, default=None),
        "longest_rest": max(rests, default=None),
        "sample_period": min((log.dt for log in logs if log.dt), default=None),
        "logs": residuals,
        "notes": list(notes),
    }
    found = [*figures.get("warnings", []), *_warnings(model, figures)]
    return replace(model, fit={**figures, "warnings": found})


def _refuse_no_better(
    rmse: float, line: float, logs: Sequence[Recording], options: Options
) -> None:
    """Refuse (FitError) a model that follows the logs no better than a straight line."""
    if rmse <= NO_BETTER * line or options.force:
        return
    names = ", ".join(os.path.basename(log.name) for log in logs)
    raise FitError(
        f"{names}: RMSE {rmse:.4g}, a straight line's is {line:.4g}: check columns and sensor, or "
        "record more amplitudes (`force` keeps it)"
    )


def _warnings(model: Cascade, figures: dict[str, Any]) -> list[str]:
    """Return what to be careful about."""
    found = []
    expected, line = figures.get("expected_rmse"), figures["line_rmse"]
    if figures.get("dynamics"):
        found += figures["dynamics"].get("warnings", [])
    if figures.get("one_amplitude"):
        found.append(
            "the logs hold one amplitude, so smaller loops are a guess: record several amplitudes "
            "(dbo excite)"
        )
    elif figures.get("swings", FEW_SWINGS) < FEW_SWINGS:
        found.append(
            "the logs go up and down less than twice: the error may be larger than stated; record "
            "more cycles"
        )
    if figures["fastest"] is None:
        found.append(
            "no clock, so no creep and no delay in the model: add `time` COLUMN or `sample_rate` HZ"
        )
    if expected is not None and expected >= line:
        found.append(
            f"expected error {expected:.3g}{model.output.suffix}, a straight line's is {line:.3g}: "
            "record several amplitudes and cycles"
        )
    for log in figures["logs"]:
        if abs(log["drift"]) > LARGE_DRIFT * model.output.span:
            found.append(
                f"{log['name']}: a drift of {log['drift']:.3g}{model.output.suffix} is left out of the "
                "model: warm up, and record again"
            )
    return found


def predicted(model: Cascade, log: Recording) -> Floats:
    """Return what a model makes of a log's drive."""
    dt = None if log.time is not None else 1.0
    played, _ = model.simulate(log.voltage, time=log.time, dt=dt)
    return played


def residual_of(model: Cascade, log: Recording) -> dict[str, Any]:
    """Return what a model leaves of a log beside an offset, and a straight drift where swings can tell it.

    Name, rows that count, RMS error, and how far the drift goes along the log, in the
    displacement's unit.
    """
    rows = log.usable
    left = (log.displacement - predicted(model, log))[rows]
    left = left - left.mean()
    drift = 0.0
    if log.time is not None and len(Swings.of(log.voltage[rows]).sizes) >= FEW_SWINGS:
        place = log.time[rows] - float(log.time[rows].mean())
        rate = float(np.sum(place * left)) / max(float(np.sum(place**2)), 1e-300)
        left = left - rate * place
        drift = rate * float(np.ptp(place))
    rmse = math.sqrt(float(np.mean(left**2)))
    name = os.path.basename(log.name)
    return {"name": name, "rows": len(left), "rmse": rmse, "drift": drift}


def pooled(residuals: Sequence[dict[str, Any]]) -> float:
    """Return the RMS over all rows."""
    squares = sum(log["rows"] * log["rmse"] ** 2 for log in residuals)
    return math.sqrt(squares / sum(log["rows"] for log in residuals))


def line_rmse(logs: Sequence[Recording]) -> float:
    """Return what one straight line, with an offset for each log, leaves of the logs."""
    voltages, displacements = [], []
    for log in logs:
        v, y = log.voltage[log.usable], log.displacement[log.usable]
        voltages.append(v - v.mean())
        displacements.append(y - y.mean())
    v, y = np.concatenate(voltages), np.concatenate(displacements)
    gain = float(np.sum(v * y)) / max(float(np.sum(v**2)), 1e-300)
    return math.sqrt(float(np.mean((y - gain * v) ** 2)))


def describe(model: Cascade, logs: Sequence[Recording]) -> str:
    """Return in one line what to expect of a model, as a part of what its logs moved."""
    fit, unit = model.fit, model.output.suffix
    expected = fit.get("expected_rmse")
    if expected is None:
        return f"fit RMSE {fit['rmse']:.3g}{unit}; error on new moves unknown"
    span = max(float(np.ptp(log.displacement[log.usable])) for log in logs)
    percent = 100.0 * expected / span
    return (
        f"expected error {expected:.3g}{unit} ({percent:.2g} % of range);"
        f" a straight line would leave {fit['line_rmse']:.3g}{unit}"
    )
