"""Identification as in the paper's Section V: one cycle, K, X_0 and Y_0 by its rule, few gears, no lag.

K is the range of the cycle's output over that of its drive,
Y_0 the output's minimum, X_0 the drive's; the gears then map volts to volts. The paper
does not say how its 25 gears were placed and fitted beyond "least squares". Here their
edges are spaced as a sine is in time, narrow where the drive turns. A turn inside a
gear retraces it; fitted to the one full cycle alone, so few gears therefore predict
smaller loops badly (0.76 against 0.67 um on the authors' other log). So a fine operator
is fitted to the cycle first, and the few gears to what it does on the cycle and on the
cycle shrunk about its middle. Slopes may only grow, so that the model can be inverted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from dbo_cli.errors import FitError, UsageError
from dbo_cli.hysteresis.identification.evaluation import (
    loop_width_percent,
    residual_of,
    validated,
    validation_of,
)
from dbo_cli.hysteresis.identification.finalists import zero_shift
from dbo_cli.hysteresis.identification.identify import Identification
from dbo_cli.hysteresis.identification.normal_equations import Structure
from dbo_cli.hysteresis.identification.output_error import corners
from dbo_cli.hysteresis.identification.recordings import (
    Floats,
    IdentificationOptions,
    Recording,
)
from dbo_cli.hysteresis.identification.statistics import (
    Basis,
    PreparedLog,
    gather,
    usual_basis,
)
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    PointStage,
    Quantity,
    ScaleStage,
    Stage,
    slow_output_range,
)

GEARS = 25  # the paper's
# on its cycle 1, 2, 4 fit to 0.38, 0.22, 0.23 um and leave 0.89, 0.90, 1.04 um on the
# other log
SEGMENTS = 2
# of the fine slopes; 1e-9 to 1e-13: 0.233 to 0.213 um on the cycle, 0.90 on the other
# log
SMOOTHNESS = 1e-11
# amplitudes, over the cycle's own; the first is it
SHRUNK = tuple(part / 20 for part in range(20, 5, -1))

CYCLE_WEIGHT = 10.0
"""Weight of the cycle's own amplitude, over each smaller one. Measured: docs/choices.md."""

LEAST_SLOPE = 0.3
"""Least slope of a gear, of the mean slope. Measured: docs/choices.md."""


def identify_by_paper(
    recordings: Sequence[Recording],
    options: IdentificationOptions,
    validation: Sequence[Recording],
) -> Identification:
    """Identify as in the paper's Section V."""
    if len(recordings) > 1:
        raise UsageError(
            "`method` paper takes one log of one cycle (`rows` A:B cuts it out)"
        )
    log = recordings[0]
    if log.uncertainty is not None:
        raise UsageError(
            "`uncertainty` does not go with `method` paper, where all rows count alike"
        )
    model, cycle = identify_as_in_paper(
        log, options.gears, options.points, options.zero
    )
    again = dataclasses.replace(
        log,
        time=None,
        sample_period=None,
        voltage=cycle.voltage,
        displacement=np.tile(log.displacement, 2),
    )
    drift = np.ones((len(cycle.voltage), 1))
    residual = residual_of(model, again, dataclasses.replace(cycle, drift=drift))
    span = float(np.ptp(log.displacement))
    checks = [validation_of(model, check, options.skip_seconds) for check in validation]
    figures: dict[str, object] = {
        "method": "paper",
        "rmse": residual.rmse,
        "rmse_percent": 100.0 * residual.rmse / span,
        "samples": len(residual.values),
        "gears": len(model.backlash.dx),
        "loop_width_percent": loop_width_percent(model),
    }
    unit = model.output.suffix
    percent = f"{figures['rmse_percent']:.2f} % of the model's range"
    summary = [f"fit RMSE {residual.rmse:.4g}{unit} ({percent}) on one cycle"]
    of_checks, lines = validated(checks, span, unit)
    figures |= of_checks
    summary += lines
    return Identification(dataclasses.replace(model, fit=figures), figures, summary, [])


def twice_over(recording: Recording, low: float, scale: float) -> PreparedLog:
    """Return the cycle played twice, the first time to bring the gears into the state in which it begins."""
    samples = len(recording.voltage)
    output = (recording.displacement - low) / scale
    return PreparedLog(
        recording.name,
        np.tile(recording.voltage, 2),
        np.tile(output, 2),
        None,
        np.repeat([-1, 0], samples),
        np.empty((2 * samples, 0)),
        "empty",
    )


def identify_as_in_paper(
    recording: Recording, gears: int | None, segments: int | None, zero: str | float
) -> tuple[ActuatorModel, PreparedLog]:
    """Identify from one cycle; returns the model and the cycle as it was fitted (played twice).

    Raises
    ------
    FitError
        The displacement falls where the voltage rises: the paper's rule takes K > 0.
    """
    voltage, displacement = recording.voltage, recording.displacement
    if float(np.cov(voltage, displacement)[0, 1]) < 0.0:
        raise FitError(
            f"{recording.name}: the displacement falls as the voltage rises; `method` paper knows positive "
            "gains only: use `method` least-squares"
        )
    x0, swing = float(voltage.min()), float(np.ptp(voltage))
    gain = float(np.ptp(displacement)) / swing
    y0 = float(displacement.min())
    basis = usual_basis(x0, x0 + swing)
    log = twice_over(recording, y0, gain * swing)
    fine, knots = _fine_heights(
        log, basis, max(SEGMENTS if segments is None else segments, 1)
    )
    count = gears or GEARS
    edges = 0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / count)
    widths = np.diff(edges) * swing
    heights = _few_heights(voltage, basis, fine, widths)
    stages: list[Stage] = [BacklashStage(widths, heights * swing, x0, 0.0)]
    parts = len(knots) - 1
    if parts > 1:
        stages.append(
            PointStage(np.diff(knots) * swing, np.full(parts, swing / parts), 0.0, 0.0)
        )
    stages.append(ScaleStage(gain, y0 - zero_shift(recording, zero)))
    low, high = slow_output_range(stages, x0, x0 + swing)
    model = ActuatorModel(
        direction="forward",
        input=Quantity(
            recording.voltage_quantity, recording.voltage_unit, x0, x0 + swing
        ),
        output=Quantity(
            recording.displacement_quantity, recording.displacement_unit, low, high
        ),
        stages=tuple(stages),
    )
    return model, log


def _fine_heights(
    log: PreparedLog, basis: Basis, segments: int
) -> tuple[Floats, Floats]:
    """Heights of the fine operator (a slope's gears together) and the corners of the asymmetry."""
    solution, _ = gather([log], basis, segments).solved(
        Structure("growing", (), segments, SMOOTHNESS)
    )
    return solution.heights, corners(solution.knots, segments)


def _few_heights(cycle: Floats, basis: Basis, fine: Floats, widths: Floats) -> Floats:
    """Heights of gears of the given widths that do what the fine operator does, over all amplitudes.

    Each amplitude has an offset of its own. The first of two cycles of each only sets
    the state.
    """
    from scipy.optimize import nnls

    middle = 0.5 * (basis.low + basis.high)
    drive = np.concatenate(
        [np.tile(middle + part * (cycle - middle), 2) for part in SHRUNK]
    )
    judged = np.tile(np.repeat([False, True], len(cycle)), len(SHRUNK))
    operator = basis.operator()
    engaged, _ = operator.engagement(drive, operator.empty(), group_size=basis.split)
    target = (engaged @ fine)[judged]
    few = BacklashStage(widths, widths, basis.low, 0.0)
    parts, _ = few.engagement(drive, few.empty())
    shares = widths / basis.span
    floor = LEAST_SLOPE * shares
    growing = (parts * shares)[judged] @ np.tril(np.ones((len(widths), len(widths))))
    amplitude = np.repeat(np.eye(len(SHRUNK)), len(cycle), axis=0)
    table = np.hstack((growing, amplitude, -amplitude))
    weight = np.sqrt(np.repeat([CYCLE_WEIGHT] + [1.0] * (len(SHRUNK) - 1), len(cycle)))
    goal = weight * (target - parts[judged] @ floor)
    increments, _ = nnls(weight[:, None] * table, goal, maxiter=100 * table.shape[1])
    heights: Floats = floor + shares * np.cumsum(increments[: len(widths)])
    return heights
