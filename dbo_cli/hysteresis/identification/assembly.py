"""From fitted numbers to a model: stages in the actuator's own units."""

from __future__ import annotations

import numpy as np

from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Recording
from dbo_cli.hysteresis.identification.refinement import Fitted
from dbo_cli.hysteresis.model import (
    ActuatorModel,
    BacklashStage,
    DelayStage,
    PointStage,
    Quantity,
    Relaxation,
    ScaleStage,
    Stage,
    slow_output_range,
)

MARGIN = 0.125  # of the range, in gears beyond its top


def zero_shift(recording: Recording, zero: str | float) -> float:
    """Displacement that counts as zero: 'none' (as logged), 'mean' or 'first' of the log, or a value.

    Returns it in the unit of the displacement.
    """
    if zero == "none":
        return 0.0
    if zero == "mean":
        return float(recording.displacement.mean())
    if zero == "first":
        return float(recording.displacement[0])
    return float(zero)


def stages_of(
    fitted: Fitted, prepared: Prepared, shift: float, gears: int | None = None
) -> tuple[Stage, ...]:
    """Stages of the forward cascade: points on the drive, backlash with relaxation, point, scale, delay.

    Gears are in the unit of the voltage on their input and without a unit on their output (sum about 1);
    the scale stage carries the displacement's unit. ``shift`` is taken off the displacement. ``gears``: their
    number where the user fixed it.
    """
    basis = fitted.basis
    relaxation = None
    if fitted.gains.any():
        acting = fitted.gains > 0.0
        relaxation = Relaxation(
            basis.low,
            tuple(float(tau) for tau, on in zip(basis.time_constants, acting, strict=True) if on),
            tuple((fitted.gains[acting] / basis.span).tolist()),
        )
    count = gears or basis.gears * basis.split
    slope = np.minimum((np.arange(count) + 0.5) * basis.gears / count, basis.gears - 1).astype(np.int64)
    heights = fitted.heights[slope] * basis.gears / count
    x0, y0 = basis.low, fitted.origin
    spare = 0 if gears is not None else int(MARGIN * count)
    # A drive that goes a little further than the logs did shall turn there as it does inside.
    heights = np.append(heights, np.full(2 * spare, heights[-1]))
    widths = np.full(len(heights), basis.span / count)
    x0, y0 = x0 - spare * widths[0], y0 - spare * heights[-1]
    stages: list[Stage] = [basis.bend_points()] if basis.bend else []
    stages.append(BacklashStage(widths, heights, x0, y0, relaxation))
    segments = len(fitted.knots) - 1
    if segments > 1:
        stages.append(PointStage(np.diff(fitted.knots), np.full(segments, 1.0 / segments), 0.0, 0.0))
    level = float(fitted.drift[0])  # the first log's offset; the later terms are its drift
    stages.append(ScaleStage(prepared.scale, prepared.offset + prepared.scale * level - shift))
    if basis.delay > 0.0:
        stages.append(DelayStage(basis.delay))
    return tuple(stages)


def model_of(
    fitted: Fitted, prepared: Prepared, recording: Recording, zero: str | float, gears: int | None = None
) -> ActuatorModel:
    """Build the forward model; its input range is what the logs cover."""
    stages = stages_of(fitted, prepared, zero_shift(recording, zero), gears)
    low, high = slow_output_range(stages, prepared.low, prepared.high)
    return ActuatorModel(
        direction="forward",
        input=Quantity("voltage", recording.voltage_unit, prepared.low, prepared.high),
        output=Quantity("displacement", recording.displacement_unit, low, high),
        stages=stages,
    )
