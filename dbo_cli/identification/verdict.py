"""What a user should know beside the model: how it does on other logs, and which signal leads."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dbo_cli.arrays import Floats
from dbo_cli.identification.figures import residuals_of
from dbo_cli.identification.recording import Recording
from dbo_cli.model import Cascade

BEYOND_STATED = 2.0
"""Times the stated error: from there on a validation log is another case than the logs, and a prior's shape
has changed. On four invented actuators the same shape left at most 1.1 times, a loop 1.25 times as wide 1.6
to 9 times."""
LEADING = 0.4
"""Of -1 to 1: sense of a loop from which the output leads; 60 of 62 logs are beyond (measured)."""
CURVE_ORDER = 3
"""Of the polynomial without memory that a loop is seen against."""


def judged(
    model: Cascade, logs: Sequence[Recording], validation: Sequence[Recording]
) -> Cascade:
    """Return the model with its errors on validation logs, and warnings of them and of exchanged columns.

    Parameters
    ----------
    model
        Identified from ``logs``.
    logs, validation
        As they were read.
    """
    expected = model.fit.get("expected_rmse")
    entries, warnings = [], list(model.fit.get("warnings", []))
    residuals = residuals_of(model, validation)
    for log, error in zip(validation, residuals, strict=True):
        name = os.path.basename(log.name)
        rmse, spread = math.sqrt(float(np.mean(error**2))), float(np.std(error))
        entries.append({"name": name, "rmse": rmse, "offset_free_rmse": spread})
        if any(np.array_equal(log.displacement, own.displacement) for own in logs):
            warnings.append(
                f"{name}: a log of the fit validates nothing: record another one"
            )
        if expected and spread >= BEYOND_STATED * expected:
            warnings.append(
                f"{name}: {spread / expected:.2g} times the stated error: identify from a log like it, too, "
                "or check that it is of this actuator"
            )
    if leads(logs):
        warnings.append(
            "the displacement leads the drive, as that of a damper or motor does: else check `voltage` and "
            "`displacement` (exchanged?) and the clocks (`clock_offset`)"
        )
    fit = {**model.fit, "warnings": warnings}
    if entries:
        fit["validation"] = entries
    return replace(model, fit=fit)


def describe_validation(model: Cascade) -> list[str]:
    """Return a line for each log that the model was tried on."""
    unit, lines = model.output.suffix, []
    for log in model.fit.get("validation", []):
        lines.append(
            f"{log['name']}: error {log['rmse']:.3g}{unit}, {log['offset_free_rmse']:.3g} without its mean"
        )
    return lines


def leads(logs: Sequence[Recording]) -> bool:
    """Return whether the displacement leads the drive: dampers do, and exchanged columns."""
    senses = []
    for log in logs:
        drive, output = log.voltage[log.usable], log.displacement[log.usable]
        senses.append(loop_sense(drive, output))
    return float(np.mean(senses)) > LEADING


def loop_sense(drive: Floats, output: Floats) -> float:
    """Return the sense of loops: -1 where the output lags, 1 where it leads, 0 without loops.

    The area of output against drive, the sum of r du with r what a curve without memory
    leaves of the output, over the sum of |r du|.

    Parameters
    ----------
    drive, output : array of shape (rows,)
        In any units; the output may rise or fall with the drive.
    """
    u, y = drive - drive.mean(), output - output.mean()
    residual = y - np.polynomial.Polynomial.fit(u, y, CURVE_ORDER)(u)
    area = 0.5 * (residual[1:] + residual[:-1]) * np.diff(u)
    size = max(float(np.abs(area).sum()), 1e-300)
    return float(np.sign(u @ y) * area.sum()) / size
