"""The last refinement of what was chosen, and stages in the actuator's own units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dbo_cli.errors import FitError
from dbo_cli.hysteresis.identification.finalists import Finalist
from dbo_cli.hysteresis.identification.normal_equations import SLOPE_FLOOR, Structure
from dbo_cli.hysteresis.identification.output_error import (
    OutputProblem,
    Refined,
    corners,
    judged_rows,
)
from dbo_cli.hysteresis.identification.preparation import Prepared
from dbo_cli.hysteresis.identification.recordings import Floats, Recording
from dbo_cli.hysteresis.identification.statistics import (
    FIT_ROWS,
    INDIFFERENCE,
    Basis,
    PreparedLog,
    fewer_rows,
    gather,
)
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


@dataclass(frozen=True)
class Fitted:
    """A fitted cascade in normalised terms: gears and memories, then the asymmetry, then offset and drift.

    ``origin`` is w0, the gears' output with all bits cleared; ``knots`` the corners of
    the asymmetry on its input axis, shape (segments + 1,), from 0 to 1; ``drift`` the
    output's drift coefficients of all logs in turn.
    """

    basis: Basis
    heights: Floats
    gains: Floats
    origin: float
    knots: Floats
    drift: Floats


def fit(logs: Sequence[PreparedLog], finalist: Finalist) -> Fitted:
    """Refine a finalist on ``FIT_ROWS`` rows, without the memories that do nothing.

    Raises
    ------
    FitError
        The solver failed.
    """
    basis, structure, vector = finalist.basis, finalist.structure, finalist.vector
    heights = vector[: basis.gears]
    count = len(basis.time_constants)
    gains = vector[basis.gears : basis.gears + count]
    kept = tuple(
        k for k in structure.memories if gains[k] > SLOPE_FLOOR * heights.sum()
    )
    if kept != tuple(range(count)):
        basis = replace(
            basis, time_constants=tuple(basis.time_constants[k] for k in kept)
        )
        structure = replace(structure, memories=tuple(range(len(kept))))
        vector = np.concatenate(
            (heights, gains[list(kept)], vector[basis.gears + count :])
        )
    some = fewer_rows(logs, FIT_ROWS)
    problem = OutputProblem(judged_rows(some, basis))
    best = problem.refined(structure, vector)
    convex = _convex(some, problem, structure)
    if convex is not None and convex.penalised * (1.0 - INDIFFERENCE) <= best.penalised:
        best = convex
    return fitted_of(basis, structure, best.vector)


def _convex(
    logs: Sequence[PreparedLog], problem: OutputProblem, structure: Structure
) -> Refined | None:
    """Return the solution of the equation error, which holds where the output's own gains too little.

    Where noise is small beside what no model of this class can follow, the two errors
    differ by their weights alone, and the convex problem's solution predicts as well or
    better.
    """
    try:
        solution, _ = gather(logs, problem.rows.basis, structure.segments).solved(
            structure
        )
    except FitError:
        return None
    return problem.levelled(solution.vector, structure)


def fitted_of(basis: Basis, structure: Structure, vector: Floats) -> Fitted:
    """Return the unknowns of a candidate as what they are."""
    after_gears = basis.gears + len(basis.time_constants)
    origin = after_gears + structure.segments - 1
    drift = vector[origin:].copy()
    drift[0] = 0.0  # the level is that of the gears
    return Fitted(
        basis,
        vector[: basis.gears],
        vector[basis.gears : after_gears],
        float(vector[origin]),
        corners(vector[after_gears:origin], structure.segments),
        drift,
    )


# of the range, in gears beyond its top; half and double: the same errors
MARGIN = 0.125


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

    Gears are in the unit of the voltage on their input and without a unit on their
    output (sum about 1); the scale stage carries the displacement's unit. ``shift`` is
    taken off the displacement. ``gears``: their number where the user fixed it.
    """
    basis = fitted.basis
    relaxation = None
    if fitted.gains.any():
        acting = fitted.gains > 0.0
        relaxation = Relaxation(
            basis.low,
            tuple(
                float(tau)
                for tau, on in zip(basis.time_constants, acting, strict=True)
                if on
            ),
            tuple((fitted.gains[acting] / basis.span).tolist()),
        )
    count = gears or basis.gears * basis.split
    slope = np.minimum(
        (np.arange(count) + 0.5) * basis.gears / count, basis.gears - 1
    ).astype(np.int64)
    heights = fitted.heights[slope] * basis.gears / count
    x0, y0 = basis.low, fitted.origin
    spare = 0 if gears is not None else int(MARGIN * count)
    # A drive that goes a little further than the logs did shall turn there as it does
    # inside.
    heights = np.append(heights, np.full(2 * spare, heights[-1]))
    widths = np.full(len(heights), basis.span / count)
    x0, y0 = x0 - spare * widths[0], y0 - spare * heights[-1]
    stages: list[Stage] = [basis.bend_points()] if basis.bend else []
    stages.append(BacklashStage(widths, heights, x0, y0, relaxation))
    segments = len(fitted.knots) - 1
    if segments > 1:
        stages.append(
            PointStage(
                np.diff(fitted.knots), np.full(segments, 1.0 / segments), 0.0, 0.0
            )
        )
    # the first log's offset; the later terms are its drift
    level = float(fitted.drift[0])
    stages.append(
        ScaleStage(prepared.scale, prepared.offset + prepared.scale * level - shift)
    )
    if basis.delay > 0.0:
        stages.append(DelayStage(basis.delay))
    return tuple(stages)


def model_of(
    fitted: Fitted,
    prepared: Prepared,
    recording: Recording,
    zero: str | float,
    gears: int | None = None,
) -> ActuatorModel:
    """Build the forward model; its input range is what the logs cover."""
    stages = stages_of(fitted, prepared, zero_shift(recording, zero), gears)
    low, high = slow_output_range(stages, prepared.low, prepared.high)
    return ActuatorModel(
        direction="forward",
        input=Quantity(
            recording.voltage_quantity,
            recording.voltage_unit,
            prepared.low,
            prepared.high,
        ),
        output=Quantity(
            recording.displacement_quantity, recording.displacement_unit, low, high
        ),
        stages=stages,
    )
